"""Proof of a solution by functions that no solver used: feasibility, first- and second-order optimality.

In: a program, of one configuration or many, and a point. Out: what the point violates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flexopt.algebra.feasible import shortest_steps
from flexopt.foundation.arrays import Vector
from flexopt.selection.nonnegative import nonnegative_least_squares
from flexopt.selection.objective import KINK
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.program import Program, single
from flexopt.selection.programs import Local

TARGET_TOLERANCE = 1e-8
BOUND_TOLERANCE = 1e-8
ACTIVE_TOLERANCE = 1e-6
STATIONARITY_TOLERANCE = 1e-6
FIRST_ORDER = "first-order optimality"
CURVATURE_TOLERANCE = 1e-6
STATIONARY_NEARLY = 1e-3
CURVATURE_STEP = 1e-5
# V this near to a value that no configuration exceeds, relative to its scale, is a maximum whatever its derivatives,
# which near a_i = 0 or b_i = 0 change without bound.
BEST_TOLERANCE = 1e-9
# Steps along a direction of positive curvature, in scaled variables, that are looked at for a larger V.
PROBES = (1e-2, 1e-3, 1e-4)
# Steps back onto the active rows, and how near they lead: what is left is taken off what V gains.
CORRECTIONS, ON_ROWS = 8, 1e-14
# A gain below this share of V's and the multipliers' size is rounding.
NOISE = 1e-12
KINK_NAME = "kink of ε_max"
# Branches meet where, to first order, they do within this distance, in scaled variables.
MEETS = 1e-3


@dataclass(frozen=True)
class Proof:
    """Residuals at a point x.

    Attributes:
        violations: constraint or bound name -> violation beyond its tolerance, in its unit.
        active: names of the bounds and constraints that hold with equality, the target's rows left out.
        target_error: |r − target|, m.
        stationarity: norm of what multipliers of the right signs leave of the objective's gradient, as in `Candidate`.
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
    return prove_program(single(problem), z)


def prove_program(program: Program, x: Vector) -> Proof:
    """Check a point x of a program from the equations, in double, by functions that no solver used."""
    local = linearised(program, x)
    violations = _infeasible(program, x, local.g)
    multipliers, kept = multipliers_of(local)
    stationarity = float(np.linalg.norm(local.gradient - multipliers @ local.rows(kept)))
    if local.kinks:
        # Which U fits best is not looked for among all: one with the coupling's free multiplier, and one without it.
        stationarity = min(_at_kinks(local, multipliers, kept, stationarity), _unmixed(local))
    bounded = program.first.bounded_by_zero and program.goal != "motion"
    unsurpassed = bounded and -local.value <= BEST_TOLERANCE
    curvature = 0.0
    if not unsurpassed:
        _note(violations, FIRST_ORDER, stationarity, STATIONARITY_TOLERANCE)
        # Far from stationary points curvatures say nothing.
        near = stationarity <= STATIONARY_NEARLY
        curvature = _curvature(program, x, local, multipliers, kept) if near else 0.0
        _note(violations, "second-order optimality", curvature, CURVATURE_TOLERANCE)
    rows, n_task = program.first.constraints, program.first.target.size
    lengths = np.array([row.scale for row in rows[:n_task]])
    of_targets = local.g[: len(rows) * program.coupling.count].reshape(-1, len(rows))[:, :n_task] * lengths
    off = float(np.sqrt(np.sum(of_targets**2, axis=1)).max())
    return Proof(violations, local.names, off, stationarity, curvature, unsurpassed)


@dataclass(frozen=True)
class Kink:
    """Where an objective's branches meet: the numbers of what stands for it.

    Attributes:
        second: of the second branch among the inequalities; of the objective that is sought less the first branch.
        coupling: of g_12 among the equalities.
        first: of the first branch among the inequalities; None of the objective that is sought.
    """

    second: int
    coupling: int
    first: int | None


@dataclass(frozen=True)
class FirstOrderModel:
    """First-order model at a point, in y = x / scale, and t last where the program has one.

    Attributes:
        level: t, the smallest V / size.
        value, gradient: of what is maximised.
        g: values of the constraints, as `Program.constraints` lists them.
        equal, active: numbers of the equalities among them; of the active inequalities, with their sense.
        equalities: gradients of equality rows, of the coupling at a kink, of fixed variables.
        inequalities: gradients of the active ones c ≥ 0;  names: theirs.
        moving: 0 for variables that are fixed or at a bound, else 1.
        kinks: where branches meet, of the objective that is sought and of those that are kept.
    """

    level: float
    value: float
    gradient: Vector
    g: Vector
    equal: list[int]
    active: list[tuple[int, float]]
    equalities: Vector
    inequalities: Vector
    names: tuple[str, ...]
    moving: Vector
    kinks: tuple[Kink, ...]

    def rows(self, kept: list[int]) -> Vector:
        """Gradients of the equalities and of the inequalities numbered in `kept`."""
        return np.vstack([self.equalities, self.inequalities[kept]])

    def weights(self, multipliers: Vector, kept: list[int]) -> Vector:
        """Multipliers of the constraints, (n_g,): the Lagrangian is V − weightsᵀ g."""
        pulls = np.zeros(len(self.inequalities))
        pulls[kept] = multipliers[len(self.equalities) :]
        weights = np.zeros(self.g.size)
        weights[self.equal] = multipliers[: len(self.equal)]
        for (number, sense), pull in zip(self.active, pulls, strict=False):
            weights[number] = sense * pull
        return weights


def _note(violations: dict[str, float], name: str, size: float, tolerance: float) -> None:
    if not size <= tolerance:
        violations[name] = max(float(size), violations.get(name, 0.0))


def infeasible(program: Program, x: Vector) -> dict[str, float]:
    """Constraints and bounds that are violated beyond their tolerances at x, in their units."""
    return _infeasible(program, x, linearised(program, x).g)


def _infeasible(program: Program, x: Vector, g: Vector) -> dict[str, float]:
    constraints, n_task = program.constraints(lowest=True), program.first.target.size
    beyond = [
        float(max(row.lower - value, value - row.upper)) * row.scale for row, value in zip(constraints, g, strict=True)
    ]
    violations: dict[str, float] = {}
    each = len(program.first.constraints)
    for k, problem in enumerate(program.problems):
        for number in range(each):
            row, size = constraints[k * each + number], beyond[k * each + number]
            _note(violations, row.name, size, TARGET_TOLERANCE if number < n_task else BOUND_TOLERANCE * row.scale)
        for variable, value in zip(problem.variables, program.of(x, k), strict=True):
            out = max(variable.lower - value, value - variable.upper)
            _note(violations, f"{program.prefix(k)}{variable.name} range", out, BOUND_TOLERANCE)
    for row, size in list(zip(constraints, beyond, strict=True))[each * len(program.problems) :]:
        _note(violations, row.name, size, BOUND_TOLERANCE)
    return violations


def linearised(program: Program, x: Vector) -> FirstOrderModel:
    """The program at x, with what is active there."""
    members = program.linear(x)
    level = float(min(member.values[-1][0] for member in members))
    local = program.local(x, members, level, lowest=True)
    equal: list[int] = []
    active: list[tuple[int, float]] = []
    rows: list[Vector] = []
    names: list[str] = []
    for k, (constraint, value) in enumerate(zip(program.constraints(lowest=True), local.g, strict=True)):
        if constraint.lower == constraint.upper:
            equal.append(k)
            continue
        sense = 1.0 if value - constraint.lower <= ACTIVE_TOLERANCE else -1.0
        if sense > 0 or constraint.upper - value <= ACTIVE_TOLERANCE:
            active.append((k, sense))
            rows.append(sense * local.jacobian[k])
            names.append(constraint.name)
    # Where branches meet the second one counts, too, and their coupling is one more free direction.
    couplings, kinks = list[Vector](), list[Kink]()
    n_objectives = len(members[0].values)
    held = len(program.first.constraints) * program.coupling.count + len(program.coupling.pairs)
    for j, (values, slopes) in enumerate(zip(members[0].values, members[0].slopes, strict=True)):
        if len(values) < 2:
            continue
        apart = float(np.hypot(np.linalg.norm(slopes[1] - slopes[0]), 2 * np.linalg.norm(slopes[2])))
        if not values[1] - values[0] <= min(KINK, MEETS * apart):
            continue
        first = None
        if j < n_objectives - 1:
            first = next((row for row, (k, _) in enumerate(active) if k == held + j * program.coupling.count), None)
            if first is None:
                continue
        kinks.append(Kink(len(rows), len(equal) + len(couplings), first))
        rows.append(slopes[1] - slopes[0] if first is None else slopes[1])
        names.append(KINK_NAME if first is None else f"{KINK_NAME} that is kept")
        couplings.append(slopes[2])

    identity, moving = np.eye(local.gradient.size), np.ones(local.gradient.size)
    fixed: list[Vector] = []
    for i, (name, lower, upper) in enumerate(zip(program.names, *program.bounds(), strict=True)):
        if lower == upper or i in program.fixed:
            fixed.append(identity[i])
            moving[i] = 0.0
            continue
        for away, sense, side in ((x[i] - lower, 1.0, "lower"), (upper - x[i], -1.0, "upper")):
            if away <= ACTIVE_TOLERANCE * program.scale[i]:
                rows.append(sense * identity[i])
                names.append(f"{name} {side} bound")
                moving[i] = 0.0
    return FirstOrderModel(
        level=level,
        value=-local.f,
        gradient=-local.gradient,
        g=local.g,
        equal=equal,
        active=active,
        equalities=np.vstack([local.jacobian[equal], *(row[None] for row in couplings), *fixed]),
        inequalities=np.array(rows).reshape(-1, local.gradient.size),
        names=tuple(names),
        moving=moving,
        kinks=tuple(kinks),
    )


def multipliers_of(local: FirstOrderModel) -> tuple[Vector, list[int]]:
    """Multipliers of a maximum: gradient = λᵀ equalities − μᵀ inequalities, μ ≥ 0, and the inequalities that pull.

    The nearest there are: non-negative least squares on what the equalities cannot take up.
    """
    every = list(range(len(local.inequalities)))
    if not np.all(np.isfinite(local.gradient)) or not np.all(np.isfinite(local.rows(every))):
        return np.full(len(local.equalities) + len(every), np.nan), every
    inverse = np.linalg.pinv(local.equalities.T)
    free = np.eye(local.gradient.size) - local.equalities.T @ inverse
    pull = nonnegative_least_squares(-free @ local.inequalities.T, free @ local.gradient)
    kept: list[int] = np.flatnonzero(pull > 0).tolist()
    of_equalities = inverse @ (local.gradient + pull @ local.inequalities)
    return np.concatenate([of_equalities, -pull[kept]]), kept


def _at_kinks(local: FirstOrderModel, multipliers: Vector, kept: list[int], stationarity: float) -> float:
    """Stationarity where branches meet, with means of their gradients and no more.

    Generalised gradients are tr(U M_z) with M_z of g_11, g_22 and g_12 and U positive semidefinite, of trace 1 for the
    objective that is sought: multipliers beyond that would make nearly equal branches out to be whatever is wanted.
    They are moved to the nearest U, all others follow.
    """
    pulls = np.zeros(len(local.inequalities))
    pulls[kept] = -multipliers[len(local.equalities) :]
    gradient, moved = local.gradient, False
    for kink in local.kinks:
        second, mixed = float(pulls[kink.second]), -float(multipliers[kink.coupling]) / 2
        first = 1.0 - second if kink.first is None else float(pulls[kink.first])
        values, vectors = np.linalg.eigh([[first, mixed], [mixed, second]])
        moved = moved or float(values[0]) < 0
        clipped = np.maximum(values, 0.0)
        if kink.first is None:
            # Of trace 1, the eigenvalues lie as far from 1/2 on either side.
            clipped = np.clip(values, 0.0, 1.0)
        nearest = (vectors * clipped) @ vectors.T
        gradient = gradient + nearest[1, 1] * local.inequalities[kink.second]
        gradient = gradient + 2 * nearest[0, 1] * local.equalities[kink.coupling]
        if kink.first is not None:
            gradient = gradient + nearest[0, 0] * local.inequalities[kink.first]
    if not moved:
        return stationarity
    taken = [k for kink in local.kinks for k in (kink.second, kink.first) if k is not None]
    plain = replace(
        local,
        gradient=gradient,
        equalities=np.delete(local.equalities, [kink.coupling for kink in local.kinks], axis=0),
        inequalities=np.delete(local.inequalities, taken, axis=0),
    )
    others, pulling = multipliers_of(plain)
    return float(np.linalg.norm(plain.gradient - others @ plain.rows(pulling)))


def _unmixed(local: FirstOrderModel) -> float:
    """The same with diagonal U alone."""
    equalities = local.equalities.copy()
    equalities[[kink.coupling for kink in local.kinks]] = 0.0
    plain = replace(local, equalities=equalities)
    multipliers, kept = multipliers_of(plain)
    stationarity = float(np.linalg.norm(plain.gradient - multipliers @ plain.rows(kept)))
    return _at_kinks(plain, multipliers, kept, stationarity)


def _curvature(program: Program, x: Vector, local: FirstOrderModel, multipliers: Vector, kept: list[int]) -> float:
    """Largest curvature of V − λᵀ c on the null space of the active rows, by central differences of exact gradients.

    0 where nothing is free, at a kink, where the branches change places within the step, and where no point nearby
    along that direction is better: differences mislead where second derivatives change within the step.
    """
    rows = local.rows(list(range(len(local.inequalities))))
    _, singular, directions = np.linalg.svd(rows)
    free = directions[int(np.sum(singular > 1e-9 * singular[0])) :] if len(rows) else np.eye(local.gradient.size)
    if not free.size or local.kinks:
        return 0.0
    weights = local.weights(multipliers, kept)
    values, vectors = np.linalg.eigh(lagrangian_hessian(program, x, free, weights))
    largest = float(values[-1])
    if largest > CURVATURE_TOLERANCE and not _rises(program, x, local, free.T @ vectors[:, -1], weights, largest):
        return 0.0
    return largest


def lagrangian_hessian(program: Program, x: Vector, free: Vector, weights: Vector) -> Vector:
    """Second derivatives of V − weightsᵀ c along the rows of `free` (d, n_x), scaled variables, (d, d)."""
    hessian = np.zeros((len(free), len(free)))
    for k, place in enumerate(program.coupling.places):
        # What the others do does not matter to this one's second derivatives, and it has few directions of its own.
        own = free[:, list(place)]
        _, reach, basis = np.linalg.svd(own, full_matrices=False)
        basis = basis[reach > 1e-9]
        along = own @ basis.T
        hessian += along @ _second_derivatives(program, k, program.of(x, k), basis, weights) @ along.T
    if program.goal == "motion":
        steps = free @ program.coupling.steps(free.shape[1]).T
        hessian -= steps @ steps.T
    return (hessian + hessian.T) / 2


def _second_derivatives(program: Program, k: int, z: Vector, basis: Vector, weights: Vector) -> Vector:
    """Second derivatives of configuration k's share in the Lagrangian along a basis (d, n_z) of z / scale, (d, d)."""
    count, kept, n_rows = program.coupling.count, len(program.first.kept), len(program.first.constraints)
    before = n_rows * count + len(program.coupling.pairs)
    weighted = before + kept * count == weights.size
    of_value = program.share[k] if weighted else -weights[before + kept * count + k]

    def pull(there: Vector) -> Vector:
        row_slopes, _, slopes = program.slopes_of(k, there)
        total = of_value * slopes[-1][0] - weights[k * n_rows : (k + 1) * n_rows] @ row_slopes
        for j in range(kept):
            total = total - weights[before + j * count + k] * slopes[j][0]
        return total

    second = np.zeros((len(basis), len(basis)))
    for row, direction in enumerate(basis):
        step = CURVATURE_STEP * direction * program.first.scale
        second[row] = basis @ (pull(z + step) - pull(z - step)) / (2 * CURVATURE_STEP)
    return second


def _rises(
    program: Program, x: Vector, local: FirstOrderModel, direction: Vector, weights: Vector, curvature: float
) -> bool:
    """Whether V is larger at some point near x along a direction, moved back onto the active rows.

    What V gains by being a rounding error off these rows, whose multipliers are `weights`, is taken off: what narrow
    slacks of earlier objectives allow is dear.
    Where earlier objectives are kept their derivatives may jump, so that no such point is found: nothing is known then.
    """
    constraints = program.constraints(lowest=True)
    numbers = [*local.equal, *(k for k, _ in local.active)]
    wanted = np.array([row.lower if value - row.lower <= row.upper - value else row.upper
                       for row, value in zip(constraints, local.g, strict=True)])[numbers]  # fmt: skip
    before = len(program.first.constraints) * program.coupling.count + len(program.coupling.pairs)
    kept = any(before <= k < before + len(program.first.kept) * program.coupling.count for k, _ in local.active)
    n_x = x.size

    def there(y: Vector) -> Local:
        at = y[:n_x] * program.scale
        return program.local(at, program.linear(at), float(y[-1]), lowest=True)

    def linear(y: Vector) -> tuple[Vector, Vector]:
        at = there(y)
        return at.g[numbers] - wanted, at.jacobian[numbers]

    landed, start = False, np.append(x / program.scale, local.level)[: local.gradient.size]
    for step in PROBES:
        for sign in (1.0, -1.0):
            near = start + sign * step * local.moving * direction
            y, error = shortest_steps(linear, near, local.moving, ON_ROWS, steps=CORRECTIONS)
            if error <= BOUND_TOLERANCE:
                landed, at = True, there(y)
                better = -at.f - local.value - weights[numbers] @ (at.g[numbers] - wanted)
                if better > max(0.1 * curvature * step**2, NOISE * (abs(at.f) + float(np.abs(weights).sum()))):
                    return True
    return kept and not landed
