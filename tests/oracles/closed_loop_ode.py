"""A closed loop in NumPy around Plant's Functions: every sensor, actuator and law written out in q, one at a time."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import root

from flexopt import build_plant
from flexopt.model import Machine
from tests.oracles.controls import task_map

Vector = np.ndarray


@dataclass
class Loop:
    """What is simulated; the words are those of `flexopt.simulate`, the numbers arrays of full length.

    Attributes:
        law: A, B, C, D of ż = A z + B e, f = C z + D e, or of its sampled twin.
        delay, early: measurements on their way, and how long before a sample the newest is taken, s.
        noise: (samples, 4) on position and rate.
        base_path, target_path: functions of time.
    """

    machine: Machine
    posture: Vector
    base: float = 0.0
    control: str = "inverse"
    kp: Any = 1e5
    kv: Any = 2e3
    ki: Any = None
    integral_limit: float = np.inf
    law: tuple[Vector, Vector, Vector, Vector] | None = None
    open: bool = False
    gravity: bool = False
    compensated: bool = True
    nullspace_damping: float = 0.0
    torque_limit: Any = np.inf
    dead_band: Any = 0.0
    bandwidth: Any = None  # rad/s
    rate_limit: Any = np.inf
    delay: int = 0
    early: float = 0.0
    filter: float | None = None  # rad/s
    resolution: float = 0.0
    rate_resolution: float = 0.0
    noise: Vector | None = None
    base_path: Any = None
    target_path: Any = None

    def __post_init__(self) -> None:
        plant = build_plant(self.machine)
        g, p = plant.graph, plant.parameter_values
        self.m, self.n = plant.n_passive, plant.n_actuated
        fixed = [ca.substitute(graph, g.p, ca.SX(p)) for graph in (g.mass, g.bias, g.gravity)]
        self._terms = ca.Function("terms", [g.q, g.v, g.base], [ca.densify(graph) for graph in fixed])
        point = ca.substitute(g.end_point, g.p, ca.SX(p))
        jacobian = ca.densify(ca.jacobian(point, g.q))
        self._tip = ca.Function("tip", [g.q, g.base], [point, jacobian])
        self.stiffness, self.damping = plant.stiffness(p).full(), plant.damping(p).full()
        self.moves_in_x = "x" in self.machine.free_base_directions
        self.rest = plant.rest(0.0, self.posture, p).full().ravel()
        self.q_design = self._equilibrium()
        self.target = self.tip(self.q_design, self.base)[0]

    def terms(self, q: Vector, v: Vector, base: float) -> tuple[Vector, Vector, Vector]:
        """M, h, g."""
        mass, bias, gravity = (x.full() for x in self._terms(q, v, base))
        return mass, bias.ravel(), gravity.ravel() * self.gravity

    def tip(self, q: Vector, base: float) -> tuple[Vector, Vector]:
        """End-point and J."""
        point, jacobian = (x.full() for x in self._tip(q, base))
        return point.ravel(), jacobian

    def anchor(self, base: float) -> Vector:
        rest = self.rest.copy()
        rest[0] += base * self.moves_in_x
        return rest

    def _equilibrium(self) -> Vector:
        """Passive coordinates where springs carry the weight."""
        rest, m = self.anchor(self.base), self.m
        if not self.gravity:
            return rest

        def residual(passive: Vector) -> Vector:
            q = np.concatenate([passive, rest[m:]])
            return ((self.stiffness @ (q - rest)) + self.terms(q, 0 * q, self.base)[2])[:m]

        found = root(residual, rest[:m], method="hybr", options={"xtol": 1e-15})
        return np.concatenate([found.x, rest[m:]])

    def base_at(self, t: float) -> float:
        return self.base if self.base_path is None else float(self.base_path(t))

    def acceleration(self, q: Vector, v: Vector, torque: Vector, t: float, base_rate: float) -> Vector:
        base = self.base_at(t)
        mass, bias, gravity = self.terms(q, v, base)
        relative = v.copy()
        relative[0] -= base_rate * self.moves_in_x
        force = -bias - gravity - self.stiffness @ (q - self.anchor(base)) - self.damping @ relative
        force[self.m :] += torque
        return np.linalg.solve(mass, force)

    def believed(self, q: Vector) -> Vector:
        """Measured joints on a base in its design place."""
        return np.concatenate([self.q_design[: self.m], q[self.m :]])

    def command(self, force: Vector, q: Vector, v: Vector) -> Vector:
        """Torques asked for."""
        belief = self.believed(q)
        rigid = self.tip(belief, self.base)[1][:, self.m :]
        torque = np.zeros(self.n)
        if not self.open:
            torque = task_map(rigid, self.control) @ force
        if self.gravity and self.compensated:
            torque = torque + self.terms(belief, 0 * v, self.base)[2][self.m :]
        if self.nullspace_damping:
            joints = v[self.m :]
            torque = torque - self.nullspace_damping * (joints - np.linalg.pinv(rigid) @ (rigid @ joints))
        torque = np.clip(torque, -np.asarray(self.torque_limit), self.torque_limit)
        band = np.asarray(self.dead_band)
        return np.where(np.abs(torque) <= band, 0.0, torque - np.sign(torque) * band)

    def matrices(self) -> tuple[Vector, Vector, Vector]:
        """A, B, C of equation (2) at the design posture, x = [v; q − q_design], input f, output r."""
        q, m, n_q = self.q_design, self.m, self.m + self.n
        inverse, jacobian = np.linalg.inv(self.terms(q, 0 * q, self.base)[0]), self.tip(q, self.base)[1]
        rigid = jacobian[:, m:]
        drive = np.vstack([np.zeros((m, 2)), task_map(rigid, self.control)])
        a = np.block([[-inverse @ self.damping, -inverse @ self.stiffness], [np.eye(n_q), np.zeros((n_q, n_q))]])
        return a, np.vstack([inverse @ drive, 0 * drive]), np.hstack([0 * jacobian, jacobian])

    def growth_rate(self, period: float, method: str) -> float:
        """Largest ln|μ| / T of the linear loop with held PD feedback, integrated exactly or by one step of RK4."""
        a, b, c = self.matrices()
        rate = np.roll(c, -(self.m + self.n), axis=1)
        n, zero = len(a), np.zeros((2, len(a) + 2))
        whole = np.vstack([np.hstack([a, b]), zero]) * period
        power, advanced = np.eye(n + 2), np.eye(n + 2)
        for k in range(1, 5 if method == "rk4" else 30):
            power = power @ whole / k
            advanced = advanced + power
        held, driven = advanced[:n, :n], advanced[:n, n:]
        closed = held - driven @ (np.diag(self.kp) @ c + np.diag(self.kv) @ rate)
        return float(np.log(np.abs(np.linalg.eigvals(closed)).max()) / period)

    def error(self, q: Vector, v: Vector, t: float, target_rate: Vector) -> tuple[Vector, Vector]:
        point, jacobian = self.tip(q, self.base_at(t))
        target = self.target if self.target_path is None else self.target_path(t)
        return target - point, target_rate - jacobian @ v

    def force(self, e: Vector, e_rate: Vector, z: Vector) -> Vector:
        if self.law is not None:
            return self.law[2] @ z + self.law[3] @ e
        return self.kp * e + self.kv * e_rate + (z if self.ki is not None else 0.0)

    def start(self, offset: Vector) -> tuple[Vector, Vector, Vector, Vector]:
        """q, v, lagging torques, the law's states."""
        q = self.q_design.copy()
        q[self.m :] += offset
        torque = np.zeros(0)
        if self.bandwidth is not None:
            weight = self.terms(q, 0 * q, self.base)[2][self.m :]
            torque = weight if self.compensated else 0 * weight
        z = np.zeros(2 if self.ki is not None else 0)
        return q, 0 * q, torque, np.zeros(len(self.law[0])) if self.law is not None else z

    def rates(self, t: float, y: Vector, held: Vector | None, base_rate: float, target_rate: Vector) -> Vector:
        """Of y = [q, v, lagging torques, the law's states]; `held` is the command, None where it is continuous."""
        n_q, lag = len(self.rest), 0 if self.bandwidth is None else self.n
        q, v, torque, z = np.split(y, [n_q, 2 * n_q, 2 * n_q + lag])
        command, z_rate = held, 0 * z
        if command is None:
            e, e_rate = self.error(q, v, t, target_rate)
            command, z_rate = self.command(self.force(e, e_rate, z), q, v), self._law_rate(e, z)
        swift = np.zeros(0)
        if lag:
            swift = np.clip(self.bandwidth * (command - torque), -np.asarray(self.rate_limit), self.rate_limit)
        acceleration = self.acceleration(q, v, torque if lag else command, t, base_rate)
        return np.concatenate([v, acceleration, swift, z_rate])

    def run(
        self,
        offset: Any,
        *,
        period: float,
        samples: int,
        substeps: int = 1,
        after: int = 0,
        hold: bool = True,
        exact: bool = False,
    ) -> Vector:
        """States [q, v] (samples + 1, 2 n_q); by the classical Runge–Kutta method, or `exact` to the 13th digit.

        `after` of the substeps lie behind a measurement that is taken within the sample.
        """
        q, v, torque, z = self.start(np.asarray(offset))
        y = np.concatenate([q, v, torque, z])
        n_q, lag = len(q), len(torque)
        states = [y[: 2 * n_q]]
        self.torques: list[Vector] = []  # that act at the start of each sample
        smooth = (self.tip(q, self.base_at(0.0))[0], np.zeros(2))
        waiting = [smooth] * self.delay

        def measured(k: int, t: float, y: Vector, here: Loop) -> tuple[Vector, Vector]:
            point, jacobian = self.tip(y[:n_q], here.base_at(t))
            rate = jacobian @ y[n_q : 2 * n_q]
            if self.noise is not None:
                point, rate = point + self.noise[k, :2], rate + self.noise[k, 2:]
            return _rounded(point, self.resolution), _rounded(rate, self.rate_resolution)

        for k in range(samples):
            t = k * period
            here, base_rate, target_rate = self._within(t, period)
            held = None
            if hold:
                q, v, torque, z = np.split(y, [n_q, 2 * n_q, 2 * n_q + lag])
                target = here.target if here.target_path is None else here.target_path(t)
                if not self.early:
                    waiting.append(measured(k, t, y, here))
                point, rate = waiting.pop(0)
                if self.filter is not None:
                    new = 1 - np.exp(-self.filter * period)
                    smooth = point, rate = tuple(y + new * (m - y) for y, m in zip(smooth, (point, rate), strict=True))
                e = target - point
                held = self.command(self.force(e, target_rate - rate, z), q, v)
                self.torques.append(torque if lag else held)
                y = np.concatenate([q, v, torque, self._law_next(e, z, period)])

            def rates(t: float, y: Vector, here: Loop = here, given: tuple = (held, base_rate, target_rate)) -> Vector:
                return here.rates(t, y, *given)

            first = period - self.early
            for begin, length, steps in ((t, first, substeps - after), (t + first, self.early, after)):
                if begin > t and self.early:
                    waiting.append(measured(k, begin, y, here))
                if exact and length:
                    span = (begin, begin + length)
                    y = solve_ivp(rates, span, y, method="DOP853", rtol=2.3e-14, atol=1e-14).y[:, -1]
                for i in range(0 if exact else steps):
                    y = _runge_kutta(rates, begin + i * length / steps, y, length / steps)
            states.append(y[: 2 * n_q])
        return np.array(states)

    def _within(self, t0: float, period: float) -> tuple[Loop, float, Vector]:
        """The loop with straight paths within a sample, and their rates."""
        here, base_rate, target_rate = copy(self), 0.0, np.zeros(2)
        if self.base_path is not None:
            base_rate = (self.base_path(t0 + period) - self.base_path(t0)) / period
            here.base_path = lambda t: self.base_path(t0) + (t - t0) * base_rate
        if self.target_path is not None:
            target_rate = (self.target_path(t0 + period) - self.target_path(t0)) / period
            here.target_path = lambda t: self.target_path(t0) + (t - t0) * target_rate
        return here, base_rate, target_rate

    def _law_rate(self, e: Vector, z: Vector) -> Vector:
        if self.law is not None:
            return self.law[0] @ z + self.law[1] @ e
        if self.ki is None:
            return 0 * z
        rate = self.ki * e
        return np.where((np.abs(z) >= self.integral_limit) & (z * rate > 0), 0.0, rate)

    def _law_next(self, e: Vector, z: Vector, period: float) -> Vector:
        if self.law is not None:
            return self.law[0] @ z + self.law[1] @ e
        if self.ki is None:
            return z
        return np.clip(z + period * self.ki * e, -self.integral_limit, self.integral_limit)


def _rounded(values: Vector, size: float) -> Vector:
    return np.floor(values / size + 0.5) * size if size else values


def _runge_kutta(rates: Any, t: float, y: Vector, h: float) -> Vector:
    k1 = rates(t, y)
    k2 = rates(t + h / 2, y + h / 2 * k1)
    k3 = rates(t + h / 2, y + h / 2 * k2)
    k4 = rates(t + h, y + h * k3)
    return y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
