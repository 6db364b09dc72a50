"""When a master's parameters are refused: numbers that they give, and the ranges in which the model may be used.

In: a machine's plant, structure and parameters as graphs. Out: `ModelGuard`s with the graphs of their numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca

from flexopt.algebra import solve_spd
from flexopt.foundation.control import DAMPED
from flexopt.loop.structure import LoopStructure
from flexopt.model.machine import Parameter
from flexopt.plant import Plant
from flexopt.plant.singularity import CONDITION_MAX
from flexopt.plant.statics import STATIC_TOLERANCE

# Squarings of M⁻¹K: its trace then bounds the fastest mode from above, for m modes by m^(1/512).
SQUARINGS = 8
# Where RK4 leaves the imaginary axis, |R(iy)| > 1 beyond √8, and the negative real one, |R(−y)| > 1 beyond 2.785: a
# master's parameters have no poles, of which `simulate` asks this.
RK4_LIMIT, RK4_REAL_LIMIT = math.sqrt(8.0), 2.785
# The bound's excess and rounding must not refuse what `simulate` accepts.
STEP_SLACK = 1.01
# How far matrices that may be singular can be off by rounding, in units of their diagonal or of their trace.
SEMIDEFINITE, INERTIA_ROUNDING = 1e-11, 1e-9


@dataclass(frozen=True)
class ModelGuard:
    """A number that the parameters give, and the range in which the model may be used."""

    text: str
    low: float = -math.inf
    high: float = math.inf


Guarded = list[tuple[ModelGuard, ca.SX]]


@dataclass(frozen=True)
class GuardedConfiguration:
    """Where the machine is examined: q at equilibrium (n_q,), placement (n_b,) and parameters p (n_par,), as graphs."""

    plant: Plant
    structure: LoopStructure
    q: ca.SX
    base: ca.SX
    p: ca.SX

    @property
    def springs(self) -> ca.SX:
        """K_p (m, m)."""
        m = self.plant.n_passive
        return ca.sparsify(self.plant.stiffness(self.p)[:m, :m])

    def guarded(self, period: float | None, bandwidth: ca.SX | None) -> Guarded:
        """All guards.

        Args:
            period: of an integration step, s, where RK4 limits it.
            bandwidth: of the servos (n,), Hz.
        """
        found = [self._regular(), *self._matrices(), *self._held()]
        if period is not None:
            text = "RK4 is unstable for the fastest mode, damper or servo: softer springs, or export with more substeps"
            found.append((ModelGuard(text, high=STEP_SLACK), self._step(period, bandwidth)))
        return found

    def _regular(self) -> tuple[ModelGuard, ca.SX]:
        """1/(tr G tr G⁻¹) of G = Jv Jvᵀ, which lies between 1/(r cond Jv)² and 1/(cond Jv)²."""
        plant, rows = self.plant, self.plant.n_task
        if self.structure.control == DAMPED:  # its inverse exists in singular postures, too
            return ModelGuard("the posture is singular"), ca.SX(1)
        stuck = {1: "the joints do not move the task row", 2: "the end-point can only move along one line"}
        text = f"the posture is singular: {stuck.get(rows, f'the joints do not move all {rows} task rows')}"
        jacobian = plant.rigid_jacobian(self.q, self.base, self.p)
        gram = ca.densify(jacobian @ jacobian.T)
        if rows == 1:  # one number alone is compared with what moves the position
            moving = ca.jacobian(plant.graph.skeleton[:, -1], plant.graph.q)[:, plant.n_passive :]
            position = ca.substitute(ca.sumsqr(moving), _known(plant), ca.vertcat(self.q, self.base, self.p))
            return ModelGuard(text, low=(3 * CONDITION_MAX) ** -2), gram / ca.fmax(gram, position)
        value = ca.if_else(least_pivot(gram) > 0, 1 / (ca.trace(gram) * ca.trace(solve_spd(gram, ca.SX.eye(rows)))), 0)
        return ModelGuard(text, low=(rows * CONDITION_MAX) ** -2), value

    def _matrices(self) -> Guarded:
        """What no range of a single entry can hold: coupled springs and dampers, inertias with all six entries."""
        found: Guarded = []
        m = self.plant.n_passive
        if not self.springs.sparsity().is_diag():
            text = "the stiffness matrix of the springs is not positive definite"
            found.append((ModelGuard(text, low=0.0), least_pivot(_scaled(self.springs))))
        dampers = ca.sparsify(self.plant.damping(self.p)[:m, :m])
        if not dampers.sparsity().is_diag():
            text = "the damping matrix is not positive semidefinite"
            found.append((ModelGuard(text, low=0.0), least_pivot(_scaled(dampers) + SEMIDEFINITE * ca.SX.eye(m))))
        tensors = _inertias(self.plant.machine.parameters, self.p)
        if tensors:
            least = [least_pivot(i + (INERTIA_ROUNDING * ca.trace(i) + 1e-30) * ca.SX.eye(3)) for i in tensors]
            text = "the inertia of a body has a negative principal moment"
            found.append((ModelGuard(text, low=0.0), ca.mmin(ca.vertcat(*least))))
        return found

    def _held(self) -> Guarded:
        """Under gravity: the springs hold the machine, and its static deflection is found."""
        plant, m = self.plant, self.plant.n_passive
        if not self.structure.gravity:
            return []
        weight = plant.gravity(self.q, self.base, self.p)[:m]
        away = (self.q - plant.rest(self.base, self.q[m:], self.p))[:m]
        left = ca.norm_inf(self.springs @ away + weight) / (1 + ca.norm_inf(weight))
        return [
            (ModelGuard("the springs do not hold the machine in this posture", low=0.0), least_pivot(self._tangent)),
            (ModelGuard("the static deflection under gravity did not converge", high=STATIC_TOLERANCE), left),
        ]

    @property
    def _tangent(self) -> ca.SX:
        """K_p with what gravity adds (m, m)."""
        if not self.structure.gravity:
            return self.springs
        return self.springs + self.plant.gravity_stiffness(self.q, self.base, self.p)

    def _step(self, period: float, bandwidth: ca.SX | None) -> ca.SX:
        """The fastest mode, servo and damper of the joints as shares of what RK4 can take."""
        m, n = self.plant.n_passive, self.plant.n_coordinates
        right = ca.horzcat(ca.vertcat(ca.densify(self._tangent), ca.SX.zeros(n - m, m)), self.plant.damping(self.p))
        per_mass = solve_spd(self.plant.mass(self.q, self.base, self.p), right)
        mode = period * ca.sqrt(largest_eigenvalue(per_mass[:m, :m]))
        # By a little more, as of no damper at all there is no logarithm.
        damper = period * largest_eigenvalue(per_mass[m:, 2 * m :] + 1e-9 * ca.SX.eye(n - m))
        servo = 0 if bandwidth is None else ca.mmax(bandwidth) * (2 * math.pi * period)
        return ca.fmax(mode / RK4_LIMIT, ca.fmax(damper, servo) / RK4_REAL_LIMIT)


def _known(plant: Plant) -> ca.SX:
    g = plant.graph
    return ca.vertcat(g.q, g.base, g.p)


def _inertias(parameters: tuple[Parameter, ...], p: ca.SX) -> list[ca.SX]:
    """Tensors (3, 3) among the parameters."""
    at: dict[str, ca.SX] = {parameter.name: p[k] for k, parameter in enumerate(parameters)}
    owners = [name.removesuffix(".xx") for name in at if name.endswith(".inertia.xx")]
    rows = (("xx", "xy", "xz"), ("xy", "yy", "yz"), ("xz", "yz", "zz"))
    return [ca.vertcat(*(ca.horzcat(*(at[f"{owner}.{ab}"] for ab in row)) for row in rows)) for owner in owners]


def _scaled(matrix: ca.SX) -> ca.SX:
    """In units of its diagonal, where metres and radians do not show."""
    diagonal = ca.diag(ca.densify(matrix))
    scale = ca.sqrt(ca.if_else(diagonal > 0, diagonal, 1))
    return ca.densify(matrix) / (scale @ scale.T)


def least_pivot(matrix: ca.SX) -> ca.SX:
    """Of L D Lᵀ: positive where the matrix is positive definite, else negative or no number."""
    return ca.mmin(ca.ldl(ca.densify(matrix), False)[0])


def largest_eigenvalue(a: ca.SX) -> ca.SX:
    """Of a matrix whose eigenvalues are not negative, a bound from above: tr(A^k)^(1/k), k = 2^`SQUARINGS`."""
    logarithm, share = ca.SX(0), 1.0
    for _ in range(SQUARINGS):
        size = ca.trace(a)
        logarithm += share * ca.log(size)
        a = (a / size) @ (a / size)
        share *= 0.5
    return ca.exp(logarithm + share * ca.log(ca.trace(a)))
