"""The robust stability margin ε_max of a machine's posture, and its exact gradient, as CasADi Functions.

ε_max = (1 + λmax(X Z))^(−1/2) of the plant (A, kr B, C); article, Appendix A. A change of state coordinates changes
nothing, so the plant is written in modal coordinates, balanced and with scaled time; these numbers are held constant
like the eigenvectors of `measures`. The gradient comes from two adjoint Lyapunov equations and one reverse sweep,
whatever the number of variables: with X Z r = λ r, rᵀ Z r = 1, l = Z r it is dλ = lᵀ dX l + λ rᵀ dZ r, and

    A_x P_X + P_X A_xᵀ = −l lᵀ,  A_x = A − B Bᵀ X;      A_z P_Z + P_Z A_zᵀ = −λ r rᵀ,  A_z = Aᵀ − Cᵀ C Z;
    ∂λ = ∂ [tr(P_X F_X) + tr(P_Z F_Z)]   with X, Z, P held and F the residuals of the two Riccati equations.

For the same reason tr(P_X F_X) + tr(P_Z F_Z) is what rounding in X and Z has taken from λ: where the gradient is
computed, ε_max is given with that added, which on badly conditioned plants is worth two digits and more.

These are the graphs for many postures, for optimisation and for C, in double precision. Single postures whose numbers
are told, with bounds on their errors, go through `posture_margin`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any

import casadi as ca

from flexopt import compiled
from flexopt.algebra import apply_pseudo_inverse, diagonal, safe_norm, solve_spd
from flexopt.algebra.riccati import lyapunov, riccati_pair, top_eigenpairs
from flexopt.foundation.control import Control
from flexopt.foundation.kept import Structural, by_machine, structural_property
from flexopt.model import AnyMachine
from flexopt.plant.control import task_to_joints
from flexopt.plant.plant import OperatingPoint, Plant, build_plant
from flexopt.robustness.expansion import Expansion
from flexopt.robustness.modes import WRITTEN_OUT, called_modes, modes_function
from flexopt.robustness.residues import rigid_residue

# A direction that the input or the output hardly touches is balanced as if it did by this share of the strongest one.
WEAKEST = 1e-4


@dataclass(frozen=True)
class Margin(Structural):
    """ε_max of one machine under one controller.

    Functions take base (n_b,), posture (n,), p (n_par,) and kr (1,). The state is [velocities; positions], passive
    coordinates and then the end-point itself in place of the arm's joints: the self-motion of a redundant arm, an
    undamped double pole at 0 that the end-point neither sees nor moves, is left out that way. With the end-point as
    state the products X_ii Z_ii, by which rounding grows, are some thirty times smaller than with the arm's
    contribution Jv q_a to it.

    Attributes:
        plant, control, gravity: as in `Measures`.
        keeps_joint_rates: whether all joint rates stay states, because joint damping couples a redundant arm's
            self-motion to the rest (and stabilises it).
        compact: whether the Functions are meant for C rather than for CasADi's virtual machine (same results).
    """

    plant: Plant
    control: Control
    gravity: bool
    keeps_joint_rates: bool
    compact: bool = False

    @property
    def n_rates(self) -> int:
        """Number of velocity states."""
        return self.plant.n_passive + (self.plant.n_actuated if self.keeps_joint_rates else self.plant.n_task)

    @property
    def n_states(self) -> int:
        """Number of states."""
        return self.n_rates + self.plant.n_passive + self.plant.n_task

    @cached_property
    def _expansion(self) -> Expansion:
        return Expansion(self.plant, self.control, self.gravity, compact=self.compact)

    @structural_property
    def hold(self) -> ca.Function:
        """(base, posture, p, kr) -> held: deflection, time scale, and the scales of the state (see `_scaling`)."""
        expansion, pencil, m = self._expansion, self._expansion.pencil, self.plant.n_passive
        names, symbols = self._symbols()
        at: list[Any] = symbols
        modes = called_modes(m)
        if not self.compact and m <= WRITTEN_OUT:
            at = [*list(expansion.inputs.values())[:3], ca.SX.sym("kr")]
            modes = modes_function(m)
        rigid = safe_norm(ca.vec(rigid_residue(expansion.point, pencil, self.control)))
        outputs = [*expansion.graphs, rigid, ca.diag(pencil.actuated_mass)]
        deflection = expansion.deflection(at[:3])
        y = expansion.of_machine("reduce", [], outputs).call([*at[:3], *deflection])
        parts, _ = expansion.solved(deflection, y[:3], modes)
        held = self._scales.call([at[3], *deflection, parts["omega_squared"], parts["modes"], *y[1:]])
        return ca.Function("hold_margin", at, held, names, ["held"], {"is_diff_out": [False]})

    @structural_property
    def _scales(self) -> ca.Function:
        """(kr, deflection under gravity, ω², Φ, M̄, F, |R_0|, diagonal of M̂) -> what is held."""
        m, r, n = self.plant.n_passive, self.plant.n_task, self.plant.n_actuated
        sizes = {"kr": (1, 1), "deflection": (m, 1), "omega_squared": (m, 1), "modes": (m, m), "mass": (m, m)}
        sizes |= {"factors": (2 * r, m), "rigid": (1, 1), "inertia": (n, 1)}
        symbols = {name: ca.SX.sym(name, *size) for name, size in sizes.items()}
        if not self.gravity:
            del symbols["deflection"]
        kr, *_, omega_squared, modes, mass, factors, rigid_size, inertia = symbols.values()
        f, rigid, deflection = factors @ modes, kr * rigid_size, symbols.get("deflection", ca.SX.zeros(m, 1))
        # The geometric mean of the modes' frequencies and of where the rigid part crosses gain one.
        logarithms = ca.sum(ca.log(omega_squared)) + r * ca.log(rigid)
        rate = ca.exp(logarithms / (2 * (m + r)))
        out, into = (ca.sqrt(ca.sum1(x**2)).T for x in (f[:r, :], f[r:, :]))
        out, into = (x + WEAKEST * ca.mmax(x) for x in (out, into))
        size = ca.sqrt(kr * into / out) / rate
        vibration, back = modes @ diagonal(size), diagonal(1 / size) @ modes.T @ mass
        arm = ca.sqrt(rigid) / rate * ca.SX.ones(r, 1)
        arm_rate = ca.sqrt(rigid * ca.sum(inertia) / inertia) / rate if self.keeps_joint_rates else arm
        held = ca.veccat(deflection, rate, vibration, back, arm, arm_rate)
        return ca.Function("scales", list(symbols.values()), [held], {"cse": self.compact})

    @property
    def _held_sizes(self) -> list[int]:
        m = self.plant.n_passive
        return [m, 1, m * m, m * m, self.plant.n_task, self.n_rates - m]

    def _scaling(self, held: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Deflection (m,), time scale, T and T⁻¹ (n_states, n_states) with physical state = T · scaled state.

        The passive coordinates are modal ones, so big that the gains in and out of each mode are alike; the end-point's
        rows are scaled alike by the rigid part.
        """
        m = self.plant.n_passive
        edges = [0, *accumulate(self._held_sizes)]
        deflection, rate, vibration, back, arm, arm_rate = (held[i:j] for i, j in pairwise(edges))
        v, v_back = ca.reshape(vibration, m, m), ca.reshape(back, m, m)
        forward = ca.diagcat(rate * v, ca.diag(rate * arm_rate), v, ca.diag(arm))
        backward = ca.diagcat(v_back / rate, ca.diag(1 / (rate * arm_rate)), v_back, ca.diag(1 / arm))
        return deflection, rate, forward, backward

    @structural_property
    def scaled_plant(self) -> ca.Function:
        """(base, posture, p, kr, held) -> A, B, C of the scaled plant, kr in B; differentiable."""
        g, kr = self.plant.graph, ca.SX.sym("kr")
        held = ca.SX.sym("held", sum(self._held_sizes))
        deflection, rate, forward, backward = self._scaling(held)
        at = self.plant.operating_point(g.base, g.posture, g.p, deflection if self.gravity else None)
        a, b, c = self._state_space(at)
        outputs = [ca.densify(x) for x in (backward @ (a / rate) @ forward, backward @ (kr * b / rate), c @ forward)]
        names = ["base", "posture", "p", "kr", "held"]
        return ca.Function(
            "scaled_plant", [g.base, g.posture, g.p, kr, held], outputs, names, list("ABC"), {"cse": True}
        )

    def _state_space(self, at: OperatingPoint) -> tuple[ca.SX, ca.SX, ca.SX]:
        """A, B, C in physical units without the gain."""
        plant = self.plant
        m, r, n = plant.n_passive, plant.n_task, plant.n_actuated
        jv, passive = at.rigid_jacobian, ca.SX.eye(m + n)[:m, :]
        into = task_to_joints(jv, self.control, ca.SX.eye(r))
        # [passive rates; ṙ] = seen q̇, and q̇ = spread ν, ν = gather q̇ for the rates ν that are states.
        seen = ca.vertcat(passive, at.jacobian)
        if self.keeps_joint_rates:
            spread, gather, rates = ca.SX.eye(m + n), ca.SX.eye(m + n), seen
        else:
            back = apply_pseudo_inverse(jv, ca.horzcat(-at.jacobian[:, :m], ca.SX.eye(r)))
            spread, gather, rates = ca.vertcat(ca.SX.eye(m + r)[:m, :], back), seen, ca.SX.eye(m + r)
        springs = ca.vertcat(at.stiffness[:m, :m], ca.SX.zeros(n, m))
        right = ca.horzcat(-at.damping @ spread, -springs, ca.vertcat(ca.SX.zeros(m, r), into))
        accelerations = gather @ solve_spd(at.mass, right)
        k = self.n_rates
        a = ca.vertcat(
            ca.horzcat(accelerations[:, : k + m], ca.SX.zeros(k, r)), ca.horzcat(rates, ca.SX.zeros(m + r, m + r))
        )
        b = ca.vertcat(accelerations[:, k + m :], ca.SX.zeros(m + r, r))
        c = ca.horzcat(ca.SX.zeros(r, k + m), ca.SX.eye(r))
        return a, b, c

    @structural_property
    def plant_at(self) -> ca.Function:
        """(base, posture, p, deflection) -> A, B, C in physical units without the gain; differentiable.

        `deflection` (m,) is that of `hold`; without gravity it is not looked at.
        """
        g, deflection = self.plant.graph, ca.SX.sym("deflection", self.plant.n_passive)
        at = self.plant.operating_point(g.base, g.posture, g.p, deflection if self.gravity else None)
        outputs = [ca.densify(x) for x in self._state_space(at)]
        names = ["base", "posture", "p", "deflection"]
        return ca.Function("plant_at", [g.base, g.posture, g.p, deflection], outputs, names, list("ABC"), {"cse": True})

    @structural_property
    def physical_plant(self) -> ca.Function:
        """(base, posture, p) -> A, B, C in physical units, self-motion left out, without the gain."""
        plant, g = self.plant, self.plant.graph
        given = [g.base, g.posture, g.p]
        deflection = plant.deflected(*given) if self.gravity else ca.SX.zeros(plant.n_passive)
        outputs = self.plant_at.call([*given, deflection])
        return ca.Function("physical_plant", given, outputs, ["base", "posture", "p"], list("ABC"), {"cse": True})

    @structural_property
    def coordinates(self) -> ca.Function:
        """From held: deflection (m,), time scale, and T (n_states, n_states), physical state = T · scaled state."""
        held = ca.SX.sym("held", sum(self._held_sizes))
        deflection, rate, forward, _ = self._scaling(held)
        return ca.Function("coordinates", [held], [deflection, rate, ca.densify(forward)])

    @structural_property
    def values(self) -> ca.Function:
        """(base, posture, p, kr) -> epsilon (2, 1), rest, residual.

        `epsilon` holds (1 + λ)^(−1/2) of the two largest eigenvalues λ of X Z, ε_max first; `rest` is what the doubling
        had left to do, at most 1e-11 where it converged, and `residual` the largest relative residual of the Riccati
        equations and of the eigenvalue, near 1e-14.
        """
        symbols, (a, b, c), x, z, rest = self._solved()
        values, _, away = top_eigenpairs(self.n_states, self.plant.n_task, compact=self.compact).call([x, z])
        residuals = [_relative(*riccati_residual(a, b, c, x)), _relative(*riccati_residual(a.T, c.T, b.T, z))]
        residual = ca.fmax(ca.fmax(*residuals), away)
        return self._function(
            "margin", symbols, [1 / ca.sqrt(1 + values), rest, residual], ["epsilon", "rest", "residual"]
        )

    @cached_property
    def compacted(self) -> Margin:
        """The same in the form for C."""
        return replace(self, compact=True)

    @structural_property
    def batched(self) -> compiled.Batch:
        """`values` at many points at once, (rows, N) each: the form made for C, or this one where nothing compiles."""
        compact = compiled.batch(self.compacted.values)
        return compact if compact.compiled else compiled.batch(self.values)

    @structural_property
    def gradients(self) -> ca.Function:
        """(base, posture, p, kr) -> epsilon (2, 1) and its exact derivatives, three rows each.

        `epsilon` is that of `values`, freed to first order from what rounding left in X and Z; derivatives are
        `epsilon_z` by [base, posture] (3, n_b + n), `epsilon_p` (3, n_par), `epsilon_kr` (3, 1). Rows 1 and 2
        are the gradients g_11, g_22 of the two branches, row 3 is g_12. Where the two eigenvalues meet, ε_max has a
        kink: along a direction d the branches change by the eigenvalues of [[g_11·d, g_12·d], [g_12·d, g_22·d]], and
        ε_max by the smaller one.
        """
        symbols, (a, b, c), x, z, _ = self._solved()
        n = self.n_states
        values, vectors = top_eigenpairs(n, self.plant.n_task, compact=self.compact).call([x, z])[:2]
        solve, sweep, held = lyapunov(n, compact=self.compact), self._reverse_sweep, self.hold.call(symbols)[0]
        loop_x, loop_z = a - b @ (b.T @ x), a.T - c.T @ (c @ z)
        left = riccati_residual(a, b, c, x)[0], riccati_residual(a.T, c.T, b.T, z)[0]
        rows: list[ca.MX] = []
        lost: list[ca.MX] = []
        for i, j in ((0, 0), (1, 1), (0, 1)):
            right = (vectors[:, i] @ vectors[:, j].T + vectors[:, j] @ vectors[:, i].T) / 2
            value = (values[i] + values[j]) / 2
            p_x = solve.call([loop_x, z @ right @ z])[0]
            p_z = solve.call([loop_z, value * right])[0]
            lost.append(ca.dot(p_x, left[0]) + ca.dot(p_z, left[1]))
            slope = sweep.call([*symbols, held, x, z, p_x, p_z])[0]
            rows.append(slope * (-0.5) * (1 + value) ** (-1.5))
        stacked = ca.vertcat(*rows)
        n_z, n_p = self.plant.n_base + self.plant.n_actuated, len(self.plant.parameter_names)
        first, second = values[0] + lost[0], values[1] + lost[1]
        apart = ca.sqrt(((first - second) / 2) ** 2 + lost[2] ** 2)
        exact = (first + second) / 2 + ca.vertcat(apart, -apart)
        outputs = [1 / ca.sqrt(1 + exact), stacked[:, :n_z], stacked[:, n_z : n_z + n_p], stacked[:, n_z + n_p :]]
        names = ["epsilon", "epsilon_z", "epsilon_p", "epsilon_kr"]
        return self._function("margin_gradients", symbols, outputs, names)

    @structural_property
    def _reverse_sweep(self) -> ca.Function:
        """(base, posture, p, kr, held, X, Z, P_X, P_Z) -> gradient of tr(P_X F_X) + tr(P_Z F_Z), a row."""
        n, g, kr = self.n_states, self.plant.graph, ca.SX.sym("kr")
        held = ca.SX.sym("held", sum(self._held_sizes))
        x, z, p_x, p_z = (ca.SX.sym(name, n, n) for name in ("X", "Z", "P_X", "P_Z"))
        a, b, c = self.scaled_plant.call([g.base, g.posture, g.p, kr, held])
        # tr(P F) with symmetric X, Z, P, written so that no n × n product of the graph's own matrices is formed.
        scalar = 2 * ca.dot(x @ p_x, a) - ca.dot(b, x @ p_x @ x @ b) + ca.dot(c, c @ p_x)
        scalar = scalar + 2 * ca.dot(p_z @ z, a) - ca.dot(c, c @ z @ p_z @ z) + ca.dot(b, p_z @ b)
        row = ca.densify(ca.gradient(scalar, ca.vertcat(g.base, g.posture, g.p, kr)).T)
        inputs = [g.base, g.posture, g.p, kr, held, x, z, p_x, p_z]
        return ca.Function("margin_sweep", inputs, [row])

    def _symbols(self) -> tuple[list[str], list[ca.MX]]:
        g = self.plant.graph
        names = ["base", "posture", "p", "kr"]
        sizes = [g.base.shape[0], g.posture.shape[0], g.p.shape[0], 1]
        return names, [ca.MX.sym(name, size) for name, size in zip(names, sizes, strict=True)]

    def _solved(self) -> tuple[list[ca.MX], tuple[ca.MX, ca.MX, ca.MX], ca.MX, ca.MX, ca.MX]:
        """Symbols, scaled A, B, C, the solutions X and Z and what the doubling left."""
        _, symbols = self._symbols()
        a, b, c = self.scaled_plant.call([*symbols, *self.hold.call(symbols)])
        x, z, rest = riccati_pair(self.n_states, compact=self.compact).call([a, b @ b.T, c.T @ c])
        return symbols, (a, b, c), x, z, rest

    def _function(self, name: str, symbols: list[ca.MX], outputs: list[ca.MX], names: list[str]) -> ca.Function:
        return ca.Function(name, symbols, outputs, self._symbols()[0], names)


@by_machine
def build_margin(
    machine: AnyMachine,
    control: Control = "inverse",
    gravity: bool = False,
    compact: bool = False,
) -> Margin:
    """The margin of a machine (built once for each machine and set of options, and kept)."""
    plant = build_plant(machine)
    redundant = plant.n_actuated > plant.n_task
    return Margin(plant, control, gravity, redundant and machine.damped_joints, compact)


def riccati_residual(a: ca.MX, b: ca.MX, c: ca.MX, x: ca.MX) -> tuple[ca.MX, list[ca.MX]]:
    """AᵀX + XA − XBBᵀX + CᵀC and its terms; BBᵀ, whose rounding counts, is not formed."""
    linear, quadratic, constant = a.T @ x, (x @ b) @ (x @ b).T, c.T @ c
    return linear + linear.T - quadratic + constant, [linear, quadratic, constant]


def _relative(residual: ca.MX, terms: list[ca.MX]) -> ca.MX:
    """Largest element, relative to those of the terms."""
    return ca.norm_inf(ca.vec(residual)) / sum(ca.norm_inf(ca.vec(term)) for term in terms)
