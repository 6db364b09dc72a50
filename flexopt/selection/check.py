"""Proof of a solution by functions that IPOPT did not use: feasibility, first- and second-order optimality."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexopt.model.arguments import Vector
from flexopt.selection.problem import SelectionProblem

TARGET_TOLERANCE = 1e-8
BOUND_TOLERANCE = 1e-8
ACTIVE_TOLERANCE = 1e-6
STATIONARITY_TOLERANCE = 1e-6
CURVATURE_TOLERANCE = 1e-6
CURVATURE_STEP = 1e-5


@dataclass(frozen=True)
class Proof:
    """Residuals at a point z.

    Attributes:
        violations: constraint or bound name -> violation beyond its tolerance, in its unit.
        active: names of the bounds and constraints that hold with equality, the target's rows left out.
        target_error: |r − target|, m.
        stationarity: as in `Candidate`.
        curvature: largest curvature of the Lagrangian along the feasible directions, in the same units; positive
            where the point is no maximum.
    """

    violations: dict[str, float]
    active: tuple[str, ...]
    target_error: float
    stationarity: float
    curvature: float

    @property
    def holds(self) -> bool:
        """Whether the point is feasible, stationary and no saddle or minimum."""
        return not self.violations


def prove(problem: SelectionProblem, z: Vector) -> Proof:
    """Check a point z = [base, posture] from the equations, in double, without IPOPT's own numbers."""
    n_base = problem.measures.plant.n_base
    base, posture = z[:n_base], z[n_base:]
    plant, p = problem.measures.plant, problem.measures.plant.parameter_values
    residual = problem.measures.w.call([base, posture, p])[2].full().ravel() - problem.target
    sine_squared = float(plant.singularity_sine_squared(base, posture, p))
    margin = problem.constraints[-1]

    violations: dict[str, float] = {}
    for constraint, error in zip(problem.constraints, residual, strict=False):
        _note(violations, constraint.name, abs(float(error)), TARGET_TOLERANCE)
    for variable, value in zip(problem.variables, z, strict=True):
        _note(
            violations, f"{variable.name} range", max(variable.lower - value, value - variable.upper), BOUND_TOLERANCE
        )
    _note(violations, margin.name, margin.lower - sine_squared, BOUND_TOLERANCE)

    gradient, equalities, inequalities, names = _linearised(problem, z, sine_squared)
    multipliers, kept = _multipliers(gradient, equalities, inequalities)
    stationarity = float(np.linalg.norm(gradient - multipliers @ np.vstack([equalities, inequalities[kept]])))
    _note(violations, "first-order optimality", stationarity, STATIONARITY_TOLERANCE)
    margin_multiplier = multipliers[len(equalities)] if margin.name in names and 0 in kept else 0.0
    rows = np.vstack([equalities, inequalities])
    curvature = _curvature(problem, z, rows, multipliers[: len(residual)], float(margin_multiplier))
    _note(violations, "second-order optimality", curvature, CURVATURE_TOLERANCE)
    return Proof(violations, names, float(np.linalg.norm(residual)), stationarity, curvature)


def _note(violations: dict[str, float], name: str, size: float, tolerance: float) -> None:
    if not size <= tolerance:
        violations[name] = float(size)


def _scaled_derivatives(problem: SelectionProblem, z: Vector) -> tuple[Vector, Vector, Vector]:
    """∂V / objective_scale (n_z,), ∂r (n_task, n_z), ∂ sin² (1, n_z), all by x = z / scale."""
    measures, n_base = problem.measures, problem.measures.plant.n_base
    p = measures.plant.parameter_values
    out = measures.gradients.call([z[:n_base], z[n_base:], p])
    objective = problem.weights @ out[0].full() / problem.objective_scale
    sine = measures.plant.singularity_gradient(z[:n_base], z[n_base:], p).full()
    return objective * problem.scale, out[2].full() * problem.scale, sine * problem.scale


def _linearised(
    problem: SelectionProblem, z: Vector, sine_squared: float
) -> tuple[Vector, Vector, Vector, tuple[str, ...]]:
    """Gradients of V, of the equalities (target, fixed variables), of the active inequalities c ≥ 0; their names."""
    gradient, targets, sine = _scaled_derivatives(problem, z)
    rows: list[Vector] = []
    names: list[str] = []
    if sine_squared - problem.constraints[-1].lower <= ACTIVE_TOLERANCE:
        rows.append(sine[0])
        names.append(problem.constraints[-1].name)
    identity = np.eye(z.size)
    for i, variable in enumerate(problem.variables):
        if variable.lower == variable.upper:
            targets = np.vstack([targets, identity[i]])
            continue
        if z[i] - variable.lower <= ACTIVE_TOLERANCE * variable.scale:
            rows.append(identity[i])
            names.append(f"{variable.name} lower bound")
        if variable.upper - z[i] <= ACTIVE_TOLERANCE * variable.scale:
            rows.append(-identity[i])
            names.append(f"{variable.name} upper bound")
    return gradient, targets, np.array(rows).reshape(-1, z.size), tuple(names)


def _multipliers(gradient: Vector, equalities: Vector, inequalities: Vector) -> tuple[Vector, list[int]]:
    """Multipliers of a maximum: gradient = λᵀ equalities − μᵀ inequalities, μ ≥ 0; wrong signs dropped."""
    kept = list(range(len(inequalities)))
    while True:
        rows = np.vstack([equalities, inequalities[kept]])
        multipliers: Vector = np.linalg.pinv(rows.T) @ gradient
        signs = multipliers[len(equalities) :]
        wrong = [k for k, value in zip(kept, signs, strict=True) if value > 0]
        if not wrong:
            return multipliers, kept
        kept = [k for k in kept if k not in wrong]


def _curvature(problem: SelectionProblem, z: Vector, rows: Vector, multipliers: Vector, margin: float) -> float:
    """Largest curvature of V − λᵀ c on the null space of the active rows, by central differences of exact gradients.

    Of the inequalities only the singularity margin bends; `margin` is its multiplier.
    """
    _, singular, directions = np.linalg.svd(rows)
    free = directions[int(np.sum(singular > 1e-9 * singular[0])) :]
    if not free.size:
        return 0.0
    hessian = np.empty((len(free), len(free)))
    for k, direction in enumerate(free):
        change = np.zeros(z.size)
        for sign in (1.0, -1.0):
            gradient, targets, sine = _scaled_derivatives(
                problem, z + sign * CURVATURE_STEP * direction * problem.scale
            )
            change += sign * (gradient - multipliers @ targets - margin * sine[0]) / (2 * CURVATURE_STEP)
        hessian[k] = free @ change
    return float(np.linalg.eigvalsh((hessian + hessian.T) / 2)[-1])
