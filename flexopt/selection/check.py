"""Proof of a solution by functions that IPOPT did not use: feasibility, first- and second-order optimality."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexopt.model.arguments import Vector
from flexopt.selection.objective import KINK
from flexopt.selection.problem import SelectionProblem

TARGET_TOLERANCE = 1e-8
BOUND_TOLERANCE = 1e-8
ACTIVE_TOLERANCE = 1e-6
STATIONARITY_TOLERANCE = 1e-6
CURVATURE_TOLERANCE = 1e-6
CURVATURE_STEP = 1e-5
KEPT_TOLERANCE = 1e-8
KINK_NAME = "kink of ε_max"


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

    local = _linearised(problem, z)
    multipliers, kept = _multipliers(local)
    stationarity = float(np.linalg.norm(local.gradient - multipliers @ local.rows(kept)))
    _note(violations, "first-order optimality", stationarity, STATIONARITY_TOLERANCE)
    for name, value in local.kept_objectives.items():
        _note(violations, name, -value, KEPT_TOLERANCE)
    curvature = _curvature(problem, z, local, multipliers, kept)
    _note(violations, "second-order optimality", curvature, CURVATURE_TOLERANCE)
    return Proof(violations, local.names, float(np.linalg.norm(residual)), stationarity, curvature)


@dataclass(frozen=True)
class _Local:
    """First-order model at a point, in x = z / scale.

    Attributes:
        gradient: of V / objective_scale.
        equalities: gradients of the target's rows, of the coupling at a kink, of fixed variables.
        inequalities: gradients of the active ones c ≥ 0;  names: theirs.
        curved: how many of them, listed first, are no bounds and so have curvature.
        kept_objectives: name -> how much an earlier objective exceeds what is to be kept, relative to its scale.
    """

    gradient: Vector
    equalities: Vector
    inequalities: Vector
    names: tuple[str, ...]
    curved: int
    kept_objectives: dict[str, float]

    def rows(self, kept: list[int]) -> Vector:
        """Gradients of the equalities and of the inequalities numbered in `kept`."""
        return np.vstack([self.equalities, self.inequalities[kept]])


def _note(violations: dict[str, float], name: str, size: float, tolerance: float) -> None:
    if not size <= tolerance:
        violations[name] = float(size)


def _linearised(problem: SelectionProblem, z: Vector) -> _Local:
    functions, plant, n_base = problem.quantities, problem.measures.plant, problem.measures.plant.n_base
    base, posture, p = z[:n_base], z[n_base:], plant.parameter_values
    rows: list[Vector] = []
    names: list[str] = []

    values, gradients = functions.branches(problem.objective, base, posture)
    coupling = np.zeros((0, z.size))
    if len(values) > 1 and values[1] - values[0] <= KINK * problem.objective_scale:
        # V is the smaller branch, so V_2 − V_1 ≥ 0 is one more inequality; where the branches really meet, their
        # coupling is one more free direction.
        rows.append((gradients[1] - gradients[0]) / problem.objective_scale)
        names.append(KINK_NAME)
        coupling = gradients[2:3] / problem.objective_scale
    sine_squared = float(plant.singularity_sine_squared(base, posture, p))
    if sine_squared - problem.constraints[-1].lower <= ACTIVE_TOLERANCE:
        rows.append(plant.singularity_gradient(base, posture, p).full()[0])
        names.append(problem.constraints[-1].name)
    kept: dict[str, float] = {}
    for objective, wanted, size in zip(problem.objectives, problem.kept, problem.objective_scales, strict=False):
        value, slope = functions.branches(objective, base, posture)
        name = f"kept {objective.name}"
        kept[name] = float(value[0] - wanted) / size
        if kept[name] <= ACTIVE_TOLERANCE:
            rows.append(slope[0] / size)
            names.append(name)
    curved = len(rows)

    equalities = np.vstack([problem.measures.gradients.call([base, posture, p])[2].full(), coupling])
    identity = np.eye(z.size)
    for i, variable in enumerate(problem.variables):
        if variable.lower == variable.upper:
            equalities = np.vstack([equalities, identity[i]])
            continue
        if z[i] - variable.lower <= ACTIVE_TOLERANCE * variable.scale:
            rows.append(identity[i])
            names.append(f"{variable.name} lower bound")
        if variable.upper - z[i] <= ACTIVE_TOLERANCE * variable.scale:
            rows.append(-identity[i])
            names.append(f"{variable.name} upper bound")
    return _Local(
        gradient=gradients[0] * problem.scale / problem.objective_scale,
        equalities=equalities * problem.scale,
        inequalities=np.array(rows).reshape(-1, z.size) * problem.scale,
        names=tuple(names),
        curved=curved,
        kept_objectives=kept,
    )


def _multipliers(local: _Local) -> tuple[Vector, list[int]]:
    """Multipliers of a maximum: gradient = λᵀ equalities − μᵀ inequalities, μ ≥ 0; wrong signs dropped."""
    kept = list(range(len(local.inequalities)))
    while True:
        multipliers: Vector = np.linalg.pinv(local.rows(kept).T) @ local.gradient
        signs = multipliers[len(local.equalities) :]
        wrong = [k for k, value in zip(kept, signs, strict=True) if value > 0]
        if not wrong:
            return multipliers, kept
        kept = [k for k in kept if k not in wrong]


def _curvature(problem: SelectionProblem, z: Vector, local: _Local, multipliers: Vector, kept: list[int]) -> float:
    """Largest curvature of V − λᵀ c on the null space of the active rows, by central differences of exact gradients.

    0 where nothing is free, and at a kink, where the branches change places within the step.
    """
    rows = local.rows(list(range(len(local.inequalities))))
    _, singular, directions = np.linalg.svd(rows)
    free = directions[int(np.sum(singular > 1e-9 * singular[0])) :]
    if not free.size or KINK_NAME in local.names:
        return 0.0
    # The curved inequalities come first; of those only the ones with a multiplier pull.
    pulls = np.zeros(len(local.inequalities))
    pulls[kept] = multipliers[len(local.equalities) :]
    names = [name for name, _ in zip(local.names, range(local.curved), strict=False)]
    hessian = np.empty((len(free), len(free)))
    for k, direction in enumerate(free):
        change = np.zeros(z.size)
        for sign in (1.0, -1.0):
            moved = z + sign * CURVATURE_STEP * direction * problem.scale
            gradient, equalities, curved = _curved_gradients(problem, moved, names)
            lagrangian = gradient - multipliers[: len(equalities)] @ equalities - pulls[: len(curved)] @ curved
            change += sign * lagrangian / (2 * CURVATURE_STEP)
        hessian[k] = free @ change
    return float(np.linalg.eigvalsh((hessian + hessian.T) / 2)[-1])


def _curved_gradients(problem: SelectionProblem, z: Vector, names: list[str]) -> tuple[Vector, Vector, Vector]:
    """Gradients of V, the target's rows and the named curved inequalities at a point nearby, in x = z / scale."""
    functions, plant, n_base = problem.quantities, problem.measures.plant, problem.measures.plant.n_base
    base, posture, p = z[:n_base], z[n_base:], plant.parameter_values
    by_name = {problem.constraints[-1].name: plant.singularity_gradient(base, posture, p).full()[0]}
    for objective, size in zip(problem.objectives[: len(problem.kept)], problem.objective_scales, strict=False):
        by_name[f"kept {objective.name}"] = functions.branches(objective, base, posture)[1][0] / size
    gradient = functions.branches(problem.objective, base, posture)[1][0] / problem.objective_scale
    targets = problem.measures.gradients.call([base, posture, p])[2].full()
    curved = np.array([by_name[name] for name in names]).reshape(-1, z.size)
    return gradient * problem.scale, targets * problem.scale, curved * problem.scale
