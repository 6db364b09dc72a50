"""How a machine swings with its arm held, and what a log of that shows, with exact derivatives.

In: a machine, posture, placement, what is not known of it, what is measured. Out: the passive coordinates over time
from any initial state, the measured quantities, and the derivatives of both by that state and by the logarithms of the
unknown parameters' factors. The equations are the plant's, the actuated joints held: M_pp v̇ + h_p + K_p (q − q_rest) +
D_p v (+ g_p) = 0. Their integral and its derivative come from one Runge–Kutta method of order 8, applied to x and
∂x/∂(x0, θ) together, which is the exact derivative of what the method gives.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from flexopt.algebra import solve_spd
from flexopt.errors import NoSolutionFound
from flexopt.foundation.arrays import Array, ComplexArray, Vector
from flexopt.identification.measured import Channel, imu_body
from flexopt.loop.tableaus import dormand_prince
from flexopt.model import AnyMachine
from flexopt.plant import Plant, build_plant

# Largest ω h of a step: the method's phase error over a step is then below 1e-9 of a turn.
PHASE = 0.8
# Steps of one call, and of a whole log at most.
CHUNK, STEPS_MAX = 128, 400_000
# Exponents of what grows, at most.
GROWN = 50.0


def oscillations(roots: ComplexArray, time: Vector) -> ComplexArray:
    """e^{λ_k (t − t_0)} (N, k), at the times of a log."""
    exponents: ComplexArray = np.outer(time - time[0], roots)
    return np.exp(np.minimum(exponents.real, GROWN) + 1j * exponents.imag)


@dataclass(frozen=True, eq=False)
class HeldSwing:
    """The free swing of a machine whose arm is held.

    State x = [q_p; v_p] (2m,), θ (n_θ,) the logarithms of factors of `reference`.

    Attributes:
        machine: whose equations these are.
        posture, base: how its arm is held, where it stands.
        gravity: whether it swings about its static deflection.
        unknown: which parameters are not known, by their place in p;  reference: (n_θ,) what θ = 0 stands for.
        channels: what is measured.
        imu: (d,) where the inertial measurement unit sits, m, in the axes of the body that carries the arm.
    """

    machine: AnyMachine
    posture: Vector
    base: Vector
    gravity: bool
    unknown: tuple[int, ...]
    reference: Vector
    channels: tuple[Channel, ...]
    imu: Vector

    @cached_property
    def plant(self) -> Plant:
        """Its equations."""
        return build_plant(self.machine)

    @cached_property
    def m(self) -> int:
        """Passive coordinates."""
        return self.plant.n_passive

    @cached_property
    def _given(self) -> tuple[Vector, ca.DM, ca.DM]:
        """The file's p, base and posture."""
        return np.array([each.value for each in self.machine.parameters]), ca.DM(self.base), ca.DM(self.posture)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the unknown parameters."""
        return tuple(self.machine.parameters[i].name for i in self.unknown)

    def parameters(self, theta: Array) -> Array:
        """All parameters p (n_par,), or of each of θ (N, n_θ)."""
        p = np.broadcast_to(self._given[0], (*theta.shape[:-1], self._given[0].size)).copy()
        p[..., list(self.unknown)] = self.reference * np.exp(theta)
        return p

    def rest(self, theta: Vector) -> Vector:
        """The state (2m,) in which the machine stands still.

        Raises:
            NoSolutionFound: the springs do not hold the machine under gravity.
        """
        state: Vector = self._rests(theta[None])[0]
        if self.gravity and not np.all(np.isfinite(state)):
            raise NoSolutionFound(
                "identify: the springs do not hold the machine under its weight in this posture",
                violations={},
                iterate={},
            )
        return state

    def _rests(self, thetas: Array) -> Array:
        """The states (N, 2m) in which the machine stands still with each θ; NaN where its springs do not hold it."""
        find, states = self.plant.deflected if self.gravity else self.plant.rest, np.zeros((len(thetas), 2 * self.m))
        states[:, : self.m] = find.call([*self._given[1:], self.parameters(thetas).T])[0].full()[: self.m].T
        if self.gravity:
            force = self.field.call([states.T, thetas.T])[0].full().T
            states[~np.all(np.abs(force) < 1e-6, axis=1)] = np.nan
        return states

    @cached_property
    def _symbols(self) -> dict[str, ca.SX]:
        """State and θ, and the plant's arguments made of them; all other numbers are constants."""
        plant, m = self.plant, self.m
        x, theta = ca.SX.sym("x", 2 * m), ca.SX.sym("theta", len(self.unknown))
        p = ca.SX(plant.parameter_values)
        for k, i in enumerate(self.unknown):
            p[i] = float(self.reference[k]) * ca.exp(theta[k])
        held = ca.SX(ca.DM(self.posture))
        return {
            "x": x,
            "theta": theta,
            "p": p,
            "base": ca.SX(ca.DM(self.base)),
            "posture": held,
            "q": ca.vertcat(x[:m], held),
            "v": ca.vertcat(x[m:], ca.SX.zeros(plant.n_actuated)),
        }

    @cached_property
    def _acceleration(self) -> ca.SX:
        plant, s, m = self.plant, self._symbols, self.m
        q, v, base, p = (s[name] for name in ("q", "v", "base", "p"))
        force = plant.bias(q, v, base, p) + plant.stiffness(p) @ (q - plant.rest(base, s["posture"], p))
        force += plant.damping(p) @ v
        if self.gravity:
            force += plant.gravity(q, base, p)
        return solve_spd(plant.mass(q, base, p)[:m, :m], -force[:m])

    @cached_property
    def field(self) -> ca.Function:
        """v̇_p (m,) and its derivative by [x, θ], (m, 2m + n_θ). Inputs x, theta."""
        return self._with_slopes("field", self._acceleration)

    @cached_property
    def _at_rest(self) -> ca.Function:
        """∂v̇_p/∂x (m, 2m) where the machine stands still. Inputs x, theta, as of `field`, of which it is a fraction."""
        x, theta, m = self._symbols["x"], self._symbols["theta"], self.m
        still = ca.vertcat(x[:m], ca.SX.zeros(m))
        slopes = ca.substitute(ca.jacobian(self._acceleration, x), x, still)
        return ca.Function("at_rest", [x, theta], [ca.densify(slopes)], ["x", "theta"], ["slopes"], {"cse": True})

    @cached_property
    def outputs(self) -> ca.Function:
        """The measured quantities y (c,) and their derivative by [x, θ], (c, 2m + n_θ). Inputs x, theta."""
        rows = [self._quantity(channel) for channel in self.channels]
        return self._with_slopes("outputs", ca.vertcat(*rows) if rows else ca.SX.zeros(0, 1))

    def _with_slopes(self, name: str, expression: ca.SX) -> ca.Function:
        x, theta = self._symbols["x"], self._symbols["theta"]
        slopes = ca.densify(ca.jacobian(expression, ca.vertcat(x, theta)))
        outputs = [ca.densify(expression), slopes]
        return ca.Function(name, [x, theta], outputs, ["x", "theta"], ["value", "slopes"], {"cse": True})

    def _quantity(self, channel: Channel) -> ca.SX:
        x, m = self._symbols["x"], self.m
        match channel.kind:
            case "coordinate":
                return x[channel.index]
            case "rate":
                return x[m + channel.index]
            case "gyro":
                return self._body["gyro"][channel.index]
            case "acceleration":
                return self._body["force"][channel.index]
            case _:
                return self._body["tip"][channel.index]

    @cached_property
    def _body(self) -> dict[str, ca.SX]:
        """Rates and specific force that a unit on the body that carries the arm measures, and the end-point's place."""
        plant, s = self.plant, self._symbols
        g, f = plant.graph, plant.frames
        found = {"tip": f.tip}
        if imu_body(self.machine) is not None:
            k = f.names.index(str(imu_body(self.machine)))
            rotation, d = f.rotations[k], f.dimension
            spin = rotation.T @ ca.reshape(ca.jtimes(ca.vec(rotation), g.q, g.v), d, d)
            found["gyro"] = ca.vertcat(spin[2, 1], spin[0, 2], spin[1, 0]) if d == 3 else spin[1, 0]
            point = f.origins[k] + rotation @ ca.SX(ca.DM(self.imu))
            a = ca.SX.sym("a", g.q.shape[0])
            speed = ca.jtimes(point, g.q, g.v)
            up = ca.SX(ca.DM([0.0] * (d - 1) + [1.0])) * g.p[plant.parameter_names.index("gravity")]
            force = ca.jtimes(speed, ca.vertcat(g.q, g.v), ca.vertcat(g.v, a)) + up
            found["force"] = ca.substitute(
                rotation.T @ force, a, ca.vertcat(self._acceleration, ca.SX.zeros(plant.n_actuated))
            )
        function = ca.Function("body", [g.q, g.v, g.base, g.p, s["x"], s["theta"]], list(found.values()))
        values: Any = function.call([s["q"], s["v"], s["base"], s["p"], s["x"], s["theta"]])
        return dict(zip(found, values, strict=True))

    def linear(self, theta: Vector) -> tuple[Array, Array, Vector]:
        """Small motions about rest: ẋ = A x, A (2m, 2m), y = C x, C (c, 2m), and the state at rest."""
        known = self._last.get(theta.tobytes())
        if known is None:
            self._last.clear()
            known = self._last[theta.tobytes()] = self._linear(theta)
        return known

    @cached_property
    def _last(self) -> dict[bytes, tuple[Array, Array, Vector]]:
        """The small motions that were asked for last."""
        return {}

    def _linear(self, theta: Vector) -> tuple[Array, Array, Vector]:
        m, state = self.m, self.rest(theta)
        a = np.block([[np.zeros((m, m)), np.eye(m)], [self._at_rest.call([state, theta])[0].full()]])
        return a, self.outputs.call([state, theta])[1].full()[:, : 2 * m], state

    def roots(self, theta: Vector) -> ComplexArray:
        """The eigenvalues alone that `modes` gives; none where the springs do not hold the machine."""
        return self.roots_of(theta[None])[0]

    def roots_of(self, thetas: Array) -> list[ComplexArray]:
        """The `roots` of each θ (N, n_θ), in one call."""
        m, count, rests = self.m, len(thetas), self._rests(thetas)
        slopes = self._at_rest.call([rests.T, thetas.T])[0].full().reshape(m, count, 2 * m)
        matrices = np.zeros((count, 2 * m, 2 * m))
        matrices[:, :m, m:], matrices[:, m:] = np.eye(m), slopes.transpose(1, 0, 2)
        held, found = np.all(np.isfinite(matrices), axis=(1, 2)), [np.zeros(0, dtype=complex)] * count
        for k, values in zip(np.flatnonzero(held).tolist(), np.linalg.eigvals(matrices[held]), strict=True):
            turning: ComplexArray = values[values.imag > 0].astype(complex)
            found[k] = turning[np.argsort(np.abs(turning), kind="stable")]
        return found

    def modes(self, theta: Vector) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Oscillations about rest, slowest first: eigenvalues (k,), imaginary parts positive, vectors (2m, k), (k, 2m).

        The last are the rows of the inverse of all eigenvectors, which tell how much of each a state holds.
        """
        roots, v = eigen(self.linear(theta)[0])
        left: Any = np.linalg.inv(v)
        chosen = np.flatnonzero(roots.imag > 0)
        chosen = chosen[np.argsort(np.abs(roots[chosen]), kind="stable")]
        return roots[chosen], v[:, chosen], left[chosen]

    def excited(self, theta: Vector, start: Vector) -> tuple[ComplexArray, ComplexArray]:
        """The oscillations that a first state holds: λ (k,) and shapes S (2m, k), x − rest = Σ 2 Re(S_k e^{λ_k t})."""
        roots, v, left = self.modes(theta)
        return roots, v * (left @ (start - self.rest(theta)))

    @cached_property
    def _steps(self) -> ca.Function:
        """`CHUNK` steps of x and S = ∂x/∂(x0, θ); a step of length 0 changes nothing."""
        tableau, m, n = dormand_prince(), self.m, len(self.unknown)
        x, s = ca.MX.sym("x", 2 * m), ca.MX.sym("S", 2 * m, 2 * m + n)
        theta, h = ca.MX.sym("theta", n), ca.MX.sym("h")
        rates = list[tuple[ca.MX, ca.MX]]()

        def moved(weights: Vector) -> tuple[ca.MX, ca.MX]:
            used = [(h * float(w), rate) for w, rate in zip(weights, rates, strict=False) if w]
            return (
                x + sum((w * rate[0] for w, rate in used), ca.MX.zeros(2 * m, 1)),
                s + sum((w * rate[1] for w, rate in used), ca.MX.zeros(2 * m, 2 * m + n)),
            )

        for i in range(len(tableau.b)):
            now, along = moved(tableau.a[i, :i])
            a, slopes = self.field.call([now, theta])
            by_theta = ca.horzcat(ca.MX.zeros(m, 2 * m), slopes[:, 2 * m :])
            rates.append((ca.vertcat(now[m:], a), ca.vertcat(along[m:, :], slopes[:, : 2 * m] @ along + by_theta)))
        step = ca.Function("step", [x, s, theta, h], [*moved(tableau.b)], ["x", "S", "theta", "h"], ["x1", "S1"])
        return step.mapaccum("steps", CHUNK, 2)

    def run(self, start: Vector, theta: Vector, time: Vector, longest: float) -> tuple[Array, Array]:
        """The states (N, 2m) at `time`, beginning with `start`, and ∂x/∂[x0, θ] (N, 2m, 2m + n_θ).

        Args:
            start: (2m,) at the first time.
            theta: (n_θ,).
            time: (N,), s, ascending.
            longest: step, s; between samples as many equal ones as that asks for.
        """
        count = np.maximum(1, np.ceil(np.diff(time) / longest - 1e-9)).astype(int)
        h = np.repeat(np.diff(time) / count, count)
        at = np.concatenate([[0], np.cumsum(count)])
        m, n = self.m, len(self.unknown)
        wide = 2 * m + n
        states, slopes = np.empty((h.size + 1, 2 * m)), np.empty((h.size + 1, 2 * m, wide))
        states[0], slopes[0] = start, np.eye(2 * m, wide)
        repeated = ca.repmat(ca.DM(theta), 1, CHUNK)
        for first in range(0, h.size, CHUNK):
            part = np.zeros(CHUNK)
            some = h[first : first + CHUNK]
            part[: some.size] = some
            x, s = self._steps.call([states[first], slopes[first], repeated, ca.DM(part).T])
            rows = slice(first + 1, first + 1 + some.size)
            states[rows] = x.full().T[: some.size]
            slopes[rows] = s.full().reshape(2 * m, CHUNK, wide).transpose(1, 0, 2)[: some.size]
        return states[at], slopes[at]

    def observed(self, states: Array, slopes: Array, theta: Vector) -> tuple[Array, Array]:
        """The measured quantities (N, c) in these states, and their derivative by [x0, θ] (N, c, 2m + n_θ)."""
        count, m, n = len(states), self.m, len(self.unknown)
        mapped = _mapped(self.outputs, count)
        y, by = mapped.call([ca.DM(states.T), ca.repmat(ca.DM(theta), 1, count)])
        c = len(self.channels)
        by_state = by.full().reshape(c, count, 2 * m + n).transpose(1, 0, 2)
        found = by_state[:, :, : 2 * m] @ slopes
        found[:, :, 2 * m :] += by_state[:, :, 2 * m :]
        return y.full().T, found


def eigen(a: Array) -> tuple[ComplexArray, ComplexArray]:
    """Eigenvalues and eigenvectors, complex even where all are real."""
    values, vectors = np.linalg.eig(a.astype(complex))
    return values, vectors


@lru_cache(maxsize=8)
def _mapped(function: ca.Function, count: int) -> ca.Function:
    return function.map(count)
