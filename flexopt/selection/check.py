"""Proof of a solution by functions that IPOPT did not use: feasibility, first- and second-order optimality."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.model import AnyMachine
from flexopt.selection.nlp import Rows
from flexopt.selection.nonnegative import nonnegative_least_squares
from flexopt.selection.objective import KINK
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.programs import Local

TARGET_TOLERANCE = 1e-8
BOUND_TOLERANCE = 1e-8
ACTIVE_TOLERANCE = 1e-6
STATIONARITY_TOLERANCE = 1e-6
CURVATURE_TOLERANCE = 1e-6
STATIONARY_NEARLY = 1e-3
CURVATURE_STEP = 1e-5
KEPT_TOLERANCE = 1e-8
# V this near to a value that no configuration exceeds, relative to its scale, is a maximum whatever its derivatives,
# which near a_i = 0 or b_i = 0 change without bound.
BEST_TOLERANCE = 1e-9
# Steps along a direction of positive curvature, in scaled variables, that are looked at for a larger V.
PROBES = (1e-2, 1e-3, 1e-4)
CORRECTIONS = 8
# A gain below this share of V's and the multipliers' size is rounding.
NOISE = 1e-12
KINK_NAME = "kink of ε_max"
# Number, sense and name: c ≥ 0 is sense · row.
ActiveRow = tuple[int, float, str]


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
        unsurpassed: whether V is a value that no configuration exceeds.
    """

    violations: dict[str, float]
    active: tuple[str, ...]
    target_error: float
    stationarity: float
    curvature: float
    unsurpassed: bool

    @property
    def holds(self) -> bool:
        """Whether the point is feasible, stationary and no saddle or minimum."""
        return not self.violations


def prove(problem: SelectionProblem, z: Vector) -> Proof:
    """Check a point z = [base, posture] from the equations, in double, without IPOPT's own numbers."""
    n_task = problem.target.size
    rows = problem.rows(z)
    violations: dict[str, float] = {}
    for constraint, value, wanted in zip(problem.constraints, rows, problem.target, strict=False):
        _note(violations, constraint.name, abs(float(value - wanted)), TARGET_TOLERANCE)
    for constraint, value in zip(problem.constraints[n_task:], rows[n_task:], strict=True):
        beyond = max(constraint.lower - value, value - constraint.upper)
        _note(violations, constraint.name, beyond, BOUND_TOLERANCE * constraint.scale)
    for variable, value in zip(problem.variables, z, strict=True):
        beyond = max(variable.lower - value, value - variable.upper)
        _note(violations, f"{variable.name} range", beyond, BOUND_TOLERANCE)

    local = _linearised(problem, z, rows)
    for name, value in local.kept_objectives.items():
        _note(violations, name, -value, KEPT_TOLERANCE)
    multipliers, kept = _multipliers(local)
    stationarity = float(np.linalg.norm(local.gradient - multipliers @ local.rows(kept)))
    if KINK_NAME in local.names:
        stationarity = _at_kink(local, multipliers, kept, stationarity)
    unsurpassed = problem.bounded_by_zero and -local.value <= BEST_TOLERANCE
    curvature = 0.0
    if not unsurpassed:
        _note(violations, "first-order optimality", stationarity, STATIONARITY_TOLERANCE)
        # Far from stationary points curvatures say nothing.
        near = stationarity <= STATIONARY_NEARLY
        curvature = _curvature(problem, z, local, multipliers, kept) if near else 0.0
        _note(violations, "second-order optimality", curvature, CURVATURE_TOLERANCE)
    off = float(np.linalg.norm(rows[:n_task] - problem.target))
    return Proof(violations, local.names, off, stationarity, curvature, unsurpassed)


@dataclass(frozen=True)
class _Linear:
    """First-order model at a point, in x = z / scale.

    Attributes:
        value, gradient: V / objective_scale and its gradient.
        equalities: gradients of equality rows, of the coupling at a kink, of fixed variables.
        inequalities: gradients of the active ones c ≥ 0;  names: theirs.
        curved: how many of each, listed first, are rows and so have curvature.
        kept_objectives: name -> how much an earlier objective exceeds what is to be kept, relative to its scale.
    """

    value: float
    gradient: Vector
    equalities: Vector
    inequalities: Vector
    names: tuple[str, ...]
    curved: tuple[int, int]
    kept_objectives: dict[str, float]

    def rows(self, kept: list[int]) -> Vector:
        """Gradients of the equalities and of the inequalities numbered in `kept`."""
        return np.vstack([self.equalities, self.inequalities[kept]])


def _note(violations: dict[str, float], name: str, size: float, tolerance: float) -> None:
    if not size <= tolerance:
        violations[name] = float(size)


@lru_cache(maxsize=32)
def _extra_slopes(machine: AnyMachine, rows: Rows) -> ca.Function:  # noqa: ARG001 - with the rows a key
    """(base, posture, p, c) -> derivatives of the constraint rows by z, (k, n_z)."""
    f = rows.function
    base, posture, p, c = (ca.SX.sym(name, f.size1_in(k)) for k, name in enumerate(f.name_in()))
    slopes = ca.jacobian(f.call([base, posture, p, c])[0], ca.vertcat(base, posture))
    return ca.Function("constraint_slopes", [base, posture, p, c], [ca.densify(slopes)])


def row_gradients(problem: SelectionProblem, z: Vector) -> Vector:
    """Derivatives of all constraints by z, (n_rows, n_z), in their units."""
    plant, n_base = problem.measures.plant, problem.measures.plant.n_base
    at = [z[:n_base], z[n_base:], plant.parameter_values]
    parts = [problem.measures.end_point_gradient.call(at)[0], plant.singularity_gradient.call(at)[0]]
    if problem.constraint_set is not None:
        extra = Rows(problem.constraint_set.structure, problem.constraint_set.function)
        slopes = _extra_slopes(problem.machine, extra)
        parts += slopes.call([*at, problem.constraint_set.constants])
    return np.vstack([part.full() for part in parts])


def stated(problem: SelectionProblem, x: Vector) -> Local:
    """The program that `SelectionProblem.solver` climbs, at its x, by functions that it does not use."""
    size, n_task, shift = problem.scale.size, problem.target.size, problem.shift[0]
    z = x[:size] * problem.scale + shift
    scales = np.array([constraint.scale for constraint in problem.constraints])
    wanted = np.concatenate([problem.target, np.zeros(len(problem.constraints) - n_task)])
    g, jacobian = [(problem.rows(z) - wanted) / scales], [row_gradients(problem, z) / scales[:, None]]
    for objective, scale in zip(problem.objectives[: len(problem.kept)], problem.objective_scales, strict=False):
        values, slopes = problem.branches(objective, z)
        g.append(values / scale)
        jacobian.append(slopes[: values.size] / scale)
    values, slopes = problem.branches(problem.objective, z)
    values, slopes = values / problem.objective_scale, slopes[: values.size] / problem.objective_scale
    if not problem.objective.has_kinks:
        return Local(
            -float(values[0]), -slopes[0] * problem.scale, np.concatenate(g), np.vstack(jacobian) * problem.scale
        )
    # The level t, last in x, below both branches.
    every = np.vstack([*jacobian, slopes]) * problem.scale
    of_level = np.zeros(len(every))
    of_level[-values.size :] = -1.0
    down = np.append(np.zeros(size), -1.0)
    return Local(-float(x[-1]), down, np.concatenate([*g, values - x[-1]]), np.column_stack([every, of_level]))


def _active_rows(problem: SelectionProblem, values: Vector) -> tuple[list[int], list[ActiveRow]]:
    """Numbers of the equality rows, and of the active inequalities."""
    equal: list[int] = []
    active: list[ActiveRow] = []
    for k, (constraint, value) in enumerate(zip(problem.constraints, values, strict=True)):
        tolerance = ACTIVE_TOLERANCE * constraint.scale
        if constraint.lower == constraint.upper:
            equal.append(k)
        elif value - constraint.lower <= tolerance:
            active.append((k, 1.0, constraint.name))
        elif constraint.upper - value <= tolerance:
            active.append((k, -1.0, constraint.name))
    return equal, active


def _linearised(problem: SelectionProblem, z: Vector, row_values: Vector) -> _Linear:
    rows: list[Vector] = []
    names: list[str] = []
    size = problem.objective_scale
    values, gradients = problem.branches(problem.objective, z)
    coupling = np.zeros((0, z.size))
    scales = np.array([constraint.scale for constraint in problem.constraints])
    gradients_of_rows = row_gradients(problem, z) / scales[:, None]
    equal, active = _active_rows(problem, row_values)
    for k, sense, name in active:
        rows.append(sense * gradients_of_rows[k])
        names.append(name)
    kept: dict[str, float] = {}
    for objective, wanted, scale in zip(problem.objectives, problem.kept, problem.objective_scales, strict=False):
        value, slope = problem.branches(objective, z)
        name = f"kept {objective.name}"
        kept[name] = float(value[0] - wanted) / scale
        if kept[name] <= ACTIVE_TOLERANCE:
            rows.append(slope[0] / scale)
            names.append(name)
    curved = len(equal), len(rows)
    if len(values) > 1 and values[1] - values[0] <= KINK * size:
        # V is the smaller branch, so V_2 − V_1 ≥ 0 is one more inequality; where the branches really meet, their
        # coupling is one more free direction.
        rows.append((gradients[1] - gradients[0]) / size)
        names.append(KINK_NAME)
        coupling = gradients[2:3] / size

    identity = np.eye(z.size)
    fixed: list[Vector] = []
    for i, variable in enumerate(problem.variables):
        if variable.lower == variable.upper:
            fixed.append(identity[i])
            continue
        if z[i] - variable.lower <= ACTIVE_TOLERANCE * variable.scale:
            rows.append(identity[i])
            names.append(f"{variable.name} lower bound")
        if variable.upper - z[i] <= ACTIVE_TOLERANCE * variable.scale:
            rows.append(-identity[i])
            names.append(f"{variable.name} upper bound")
    equalities = np.vstack([gradients_of_rows[equal], coupling, *fixed])
    return _Linear(
        value=float(values[0]) / size,
        gradient=gradients[0] * problem.scale / size,
        equalities=equalities * problem.scale,
        inequalities=np.array(rows).reshape(-1, z.size) * problem.scale,
        names=tuple(names),
        curved=curved,
        kept_objectives=kept,
    )


def _multipliers(local: _Linear) -> tuple[Vector, list[int]]:
    """Multipliers of a maximum: gradient = λᵀ equalities − μᵀ inequalities, μ ≥ 0, and the inequalities that pull."""
    kept = list(range(len(local.inequalities)))
    if not np.all(np.isfinite(local.gradient)) or not np.all(np.isfinite(local.rows(kept))):
        return np.full(len(local.equalities) + len(kept), np.nan), kept
    while True:
        multipliers: Vector = np.linalg.pinv(local.rows(kept).T) @ local.gradient
        signs = multipliers[len(local.equalities) :]
        if not kept or signs.max() <= 0:
            left = float(np.linalg.norm(local.gradient - multipliers @ local.rows(kept)))
            return (multipliers, kept) if left <= STATIONARITY_TOLERANCE else _nearest_multipliers(local)
        del kept[int(np.argmax(signs))]


def _at_kink(local: _Linear, multipliers: Vector, kept: list[int], stationarity: float) -> float:
    """Stationarity where the branches meet, with a mean of their gradients and no more.

    V's generalised gradients are (1 − μ) g_11 + μ g_22 + 2 ν g_12 with ν² ≤ μ (1 − μ): multipliers beyond that would
    make nearly equal branches out to be whatever is wanted. They are moved to the nearest mean, all others follow.
    """
    at, coupling = local.names.index(KINK_NAME), local.curved[0]
    share = -float(multipliers[len(local.equalities) + kept.index(at)]) if at in kept else 0.0
    mixed = -float(multipliers[coupling]) / 2
    away = math.hypot(share - 0.5, mixed)
    if not away > 0.5:
        return stationarity
    share, mixed = 0.5 + (share - 0.5) / (2 * away), mixed / (2 * away)
    plain = replace(
        local,
        gradient=local.gradient + share * local.inequalities[at] + 2 * mixed * local.equalities[coupling],
        equalities=np.delete(local.equalities, coupling, axis=0),
        inequalities=np.delete(local.inequalities, at, axis=0),
        names=tuple(name for name in local.names if name != KINK_NAME),
    )
    others, pulling = _multipliers(plain)
    return float(np.linalg.norm(plain.gradient - others @ plain.rows(pulling)))


def _nearest_multipliers(local: _Linear) -> tuple[Vector, list[int]]:
    """As `_multipliers`, the nearest there are: non-negative least squares on what equalities cannot take up."""
    if not len(local.inequalities):
        return np.linalg.pinv(local.equalities.T) @ local.gradient, []
    inverse = np.linalg.pinv(local.equalities.T)
    free = np.eye(local.gradient.size) - local.equalities.T @ inverse
    pull = nonnegative_least_squares(-free @ local.inequalities.T, free @ local.gradient)
    kept: list[int] = np.flatnonzero(pull > 0).tolist()
    of_equalities = inverse @ (local.gradient + pull @ local.inequalities)
    return np.concatenate([of_equalities, -pull[kept]]), kept


def _curvature(problem: SelectionProblem, z: Vector, local: _Linear, multipliers: Vector, kept: list[int]) -> float:
    """Largest curvature of V − λᵀ c on the null space of the active rows, by central differences of exact gradients.

    0 where nothing is free, at a kink, where the branches change places within the step, and where no point nearby
    along that direction is better: differences mislead where second derivatives change within the step.
    """
    rows = local.rows(list(range(len(local.inequalities))))
    _, singular, directions = np.linalg.svd(rows)
    free = directions[int(np.sum(singular > 1e-9 * singular[0])) :] if len(rows) else np.eye(z.size)
    if not free.size or KINK_NAME in local.names:
        return 0.0
    # The curved rows come first; of the inequalities among them only the ones with a multiplier pull.
    equal, inequal = local.curved
    pulls = np.zeros(len(local.inequalities))
    pulls[kept] = multipliers[len(local.equalities) :]
    weights = np.concatenate([multipliers[:equal], pulls[:inequal]])
    numbers = _active_rows(problem, problem.rows(z))
    hessian = np.empty((len(free), len(free)))
    for k, direction in enumerate(free):
        change = np.zeros(z.size)
        for sign in (1.0, -1.0):
            moved = z + sign * CURVATURE_STEP * direction * problem.scale
            gradient, curved = _curved_gradients(problem, moved, numbers, local.names)
            change += sign * (gradient - weights @ curved) / (2 * CURVATURE_STEP)
        hessian[k] = free @ change
    values, vectors = np.linalg.eigh((hessian + hessian.T) / 2)
    largest = float(values[-1])
    if largest > CURVATURE_TOLERANCE and not _rises(problem, z, local, free.T @ vectors[:, -1], weights, largest):
        return 0.0
    return largest


def _curved_gradients(
    problem: SelectionProblem,
    z: Vector,
    numbers: tuple[list[int], list[ActiveRow]],
    names: tuple[str, ...],
) -> tuple[Vector, Vector]:
    """Gradients of V and of the active curved rows at a point nearby, in x = z / scale."""
    equal, active = numbers
    scales = np.array([constraint.scale for constraint in problem.constraints])
    rows = row_gradients(problem, z) / scales[:, None]
    curved = [rows[k] for k in equal] + [sense * rows[k] for k, sense, _ in active]
    for objective, size in zip(problem.objectives[: len(problem.kept)], problem.objective_scales, strict=False):
        if f"kept {objective.name}" in names:
            curved.append(problem.branches(objective, z)[1][0] / size)
    gradient = problem.branches(problem.objective, z)[1][0] / problem.objective_scale
    return gradient * problem.scale, np.array(curved).reshape(-1, z.size) * problem.scale


def _rises(
    problem: SelectionProblem, z: Vector, local: _Linear, direction: Vector, weights: Vector, curvature: float
) -> bool:
    """Whether V is larger at some point near z along a direction, moved back onto the active rows.

    What V gains by being a rounding error off these rows, whose multipliers are `weights`, is taken off: what narrow
    slacks of earlier objectives allow is dear.
    Where earlier objectives are kept their derivatives may jump, so that no such point is found: nothing is known then.
    """
    equal, active = _active_rows(problem, problem.rows(z))
    numbers = [*equal, *(k for k, _, _ in active)]
    senses = np.array([1.0] * len(equal) + [sense for _, sense, _ in active])
    scales = np.array([constraint.scale for constraint in problem.constraints])
    wanted = np.array([c.lower if value - c.lower <= c.upper - value else c.upper
                       for c, value in zip(problem.constraints, problem.rows(z), strict=True)])  # fmt: skip
    kept = [k for k in range(len(problem.kept)) if f"kept {problem.objectives[k].name}" in local.names]
    freed: Vector = np.where(problem.lower == problem.upper, 0.0, 1.0)
    for row, name in zip(local.inequalities, local.names, strict=True):
        if name.endswith(" bound"):
            freed[row != 0] = 0.0

    def beyond(there: Vector) -> Vector:
        """How far the active rows, then the earlier objectives, are from what they shall be."""
        earlier = [
            (problem.branches(problem.objectives[k], there)[0][0] - problem.kept[k]) / problem.objective_scales[k]
            for k in kept
        ]
        return np.append(((problem.rows(there) - wanted) / scales)[numbers], earlier)

    def slopes(there: Vector) -> Vector:
        earlier = [problem.branches(problem.objectives[k], there)[1][0] / problem.objective_scales[k] for k in kept]
        rows = (row_gradients(problem, there) / scales[:, None])[numbers]
        return np.vstack([rows, *earlier]) * problem.scale * freed

    landed = False
    for step in PROBES:
        for sign in (1.0, -1.0):
            there: Vector = z + sign * step * freed * direction * problem.scale
            for _ in range(CORRECTIONS):
                correction: Vector = np.linalg.pinv(slopes(there)) @ beyond(there)
                there = there - problem.scale * correction
            off = beyond(there)
            if np.abs(off).max(initial=0.0) <= BOUND_TOLERANCE:
                landed = True
                value = problem.branches(problem.objective, there)[0][0] / problem.objective_scale
                better = value - local.value - weights @ (np.append(senses, np.ones(len(kept))) * off)
                if better > max(0.1 * curvature * step**2, NOISE * (abs(value) + float(np.abs(weights).sum()))):
                    return True
    return bool(kept) and not landed
