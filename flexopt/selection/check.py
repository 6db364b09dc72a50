"""Proof of a solution by functions that no solver used: feasibility, first- and second-order optimality.

In: a program, of one configuration or many, and a point. Out: what the point violates.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from flexopt.algebra.feasible import shortest_steps
from flexopt.foundation.arrays import Vector
from flexopt.selection.ascent_model import Cone
from flexopt.selection.cones import SHARED, Parallel, mode_cones, name_of, smooth_slope
from flexopt.selection.multipliers import STATIONARITY_TOLERANCE, FirstOrderModel, Held, Kink, certified
from flexopt.selection.objective import KINK
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.program import Linearisation, Program, margin_noise, single
from flexopt.selection.programs import Local

TARGET_TOLERANCE = 1e-8
BOUND_TOLERANCE = 1e-8
ACTIVE_TOLERANCE = 1e-6
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
# How many times as much as ε_max's rounding may be missing of one that is kept.
NOISY = 4.0
# Singular values of rows below this share of the largest are rounding.
DEPENDENT = 1e-9
# Slopes of the equations of a_i parallel to b_i, in scaled variables, that count as none.
VANISHING = 1e-7
# A gain below this share of V's and the multipliers' size is rounding.
NOISE = 1e-12
KINK_NAME = "kink of ε_max"
# Branches meet where, to first order, they do within this distance, in scaled variables; a_i or b_i is zero within TIP.
MEETS, TIP = 1e-3, 1e-6


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
        kinks: of every kink that the point stands on its multiplier, as a share of the largest one that an optimum has.
        unsurpassed: whether V is a value that no configuration exceeds.
        dimension: of the set of optima about the point: how many directions lead along optima as good; None where that
            is not known: on kinks of ε_max, where a_i or b_i vanishes, and of several configurations together.
    """

    violations: dict[str, float]
    active: tuple[str, ...]
    target_error: float
    stationarity: float
    curvature: float
    kinks: dict[str, float]
    unsurpassed: bool
    dimension: int | None

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
    multipliers, kept = certified(local)
    stationarity = float(np.linalg.norm(local.gradient - multipliers @ local.rows(kept)))
    for name, size in _undecided(program, x):
        _note(violations, name, size, STATIONARITY_TOLERANCE)
    bounded = program.first.bounded_by_zero and program.goal != "motion"
    unsurpassed = bounded and -local.value <= BEST_TOLERANCE
    curvature, dimension = 0.0, _dimension(program, x, local) if unsurpassed else None
    if not unsurpassed:
        _note(
            violations,
            FIRST_ORDER,
            stationarity,
            STATIONARITY_TOLERANCE * _pull_of_kept(program, local, multipliers, kept),
        )
        # Far from stationary points curvatures say nothing.
        near = stationarity <= STATIONARY_NEARLY
        curvature, dimension = _curvature(program, x, local, multipliers, kept) if near else (0.0, None)
        _note(violations, "second-order optimality", curvature, CURVATURE_TOLERANCE)
    rows, n_task = program.first.constraints, program.first.target.size
    lengths = np.array([row.scale for row in rows[:n_task]])
    of_targets = local.g[: len(rows) * program.coupling.count].reshape(-1, len(rows))[:, :n_task] * lengths
    off = float(np.sqrt(np.sum(of_targets**2, axis=1)).max())
    kinks = dict(zip((kink.name for kink in local.kinks), local.shares(multipliers, kept), strict=True))
    if program.coupling.count > 1:
        dimension = None
    return Proof(violations, (*local.names, *kinks), off, stationarity, curvature, kinks, unsurpassed, dimension)


def _note(violations: dict[str, float], name: str, size: float, tolerance: float) -> None:
    if not size <= tolerance:
        violations[name] = max(float(size), violations.get(name, 0.0))


def infeasible(program: Program, x: Vector, g: Vector | None = None) -> dict[str, float]:
    """Constraints and bounds that are violated beyond their tolerances at x, in their units; g, the rows there."""
    return _infeasible(program, x, linearised(program, x).g if g is None else g)


def _infeasible(program: Program, x: Vector, g: Vector) -> dict[str, float]:
    constraints, n_task = program.constraints(), program.first.target.size
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
    rest = list(zip(constraints, beyond, strict=True))[each * len(program.problems) :]
    first, noise = program.first, 0.0
    pairs = zip(first.objectives[: len(first.kept)], first.objective_scales, strict=False)
    share = max((objective.beta / size for objective, size in pairs), default=0.0)
    if share > 0 and program.coupling.count == 1 and any(size > BOUND_TOLERANCE for _, size in rest):
        noise = share * margin_noise(program.first, program.first.quantities.margin.values, program.of(x, 0))
    for row, size in rest:
        _note(violations, row.name, size, BOUND_TOLERANCE + NOISY * noise)
    return violations


def linearised(program: Program, x: Vector) -> FirstOrderModel:
    """The program at x, with what is active there."""
    members = program.linear(x)
    level = float(min(member.values[-1][0] for member in members))
    local = program.local(x, members, level)
    equal: list[int] = []
    active: list[tuple[int, float]] = []
    rows: list[Vector] = []
    names: list[str] = []
    for k, (constraint, value) in enumerate(zip(program.constraints(), local.g, strict=True)):
        if constraint.lower == constraint.upper:
            equal.append(k)
            continue
        sense = 1.0 if value - constraint.lower <= ACTIVE_TOLERANCE else -1.0
        if sense > 0 or constraint.upper - value <= ACTIVE_TOLERANCE:
            active.append((k, sense))
            rows.append(sense * local.jacobian[k])
            names.append(constraint.name)
    gradient = -local.gradient
    corners, kinks = list[Vector](), list[Kink]()
    n_objectives = len(members[0].values)
    held = len(program.first.constraints) * program.coupling.count + len(program.coupling.pairs)
    for j, name, cone, number, alpha in _tips(program, x, members[0]):
        first = None
        if j < n_objectives - 1:
            first = next((row for row, (k, _) in enumerate(active) if k == held + j * program.coupling.count), None)
            if first is None:
                continue
            rows[first] = rows[first] + cone.unit @ cone.slopes
        else:
            gradient = gradient + cone.unit @ cone.slopes
        begin = len(equal) + sum(len(corner) for corner in corners)
        corners.append(cone.axes @ cone.slopes)
        full = name if first is None else f"{name} that is kept"
        kinks.append(Kink(full, slice(begin, begin + len(corners[-1])), first, number, cone.axes, alpha))

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
        gradient=gradient,
        g=local.g,
        equal=equal,
        active=active,
        equalities=np.vstack([local.jacobian[equal], *corners, *fixed]),
        inequalities=np.array(rows).reshape(-1, local.gradient.size),
        names=tuple(names),
        moving=moving,
        kinks=tuple(kinks),
    )


def _tips(program: Program, x: Vector, member: Linearisation) -> Iterator[tuple[int, str, Cone, int | None, float]]:
    """Of every objective the cones at whose tips x stands, in units of V / size: j, name, −|c|, number, α / size."""
    for j, (values, slopes) in enumerate(zip(member.values, member.slopes, strict=True)):
        if len(values) < 2:
            continue
        apart = float(np.hypot(np.linalg.norm(slopes[1] - slopes[0]), 2 * np.linalg.norm(slopes[2])))
        if values[1] - values[0] <= min(KINK, MEETS * apart):
            halves = np.vstack([(slopes[0] - slopes[1]) / 2, slopes[2]])
            yield j, KINK_NAME, Cone(np.zeros(2), halves, np.ones(1), np.array([-1.0, 0.0])), None, 0.0
    # How several share what they stand on is not looked at.
    if program.coupling.count > 1 or program.goal == "motion":
        return
    first = program.first
    alphas = _pulls_of_w(program, 0, x)
    if not alphas.any():
        return
    f, f_z, same = first.factors(program.of(x, 0))
    for number, cone in enumerate(mode_cones(f, f_z * first.scale, alphas)):
        for j, size in enumerate(cone.sizes.tolist()):
            if size > 0 and same[number // 2] < SHARED and cone.distance <= TIP:
                scaled = Cone(size * cone.value, size * cone.slopes, np.ones(1), cone.unit)
                alpha = float(alphas[j, number // 2])
                yield j, f"kink of w{number // 2 + 1}: {name_of(number)}", scaled, number, alpha


def _pulls_of_w(program: Program, k: int, x: Vector) -> Vector:
    """∂V_j/∂w_i / size of configuration k's objectives up to the one being solved, (j, m)."""
    problem, z = program.problems[k], program.of(x, k)
    n_base, count = problem.measures.plant.n_base, len(problem.kept) + 1
    pulls = [problem.quantities.pulls(o, z[:n_base], z[n_base:]).ravel() for o in problem.objectives[:count]]
    return np.array(pulls) / np.array(program.first.objective_scales[:count])[:, None]


def _undecided(program: Program, x: Vector) -> Iterator[tuple[str, float]]:
    """What own objectives and constraints make of x that first and second derivatives do not tell, and its size.

    A pull at w_i below 0 turns its kink over: V rises from there in two directions. Of several configurations kinks are
    not looked at, and frequencies have no slopes where two are one.
    """
    first, least = program.first, (*program.first.kept, -np.inf)
    if all(objective.own is None for objective in first.objectives[: len(least)]):
        return
    for k, problem in enumerate(program.problems):
        z = program.of(x, k)
        own = np.zeros((len(least), 1), dtype=bool)
        for j, (objective, kept) in enumerate(zip(problem.objectives, least, strict=False)):
            if objective.own is None:
                continue
            # What is kept and has more than it needs does not matter.
            value, size = float(problem.branches(objective, z)[0][0]), first.objective_scales[j]
            own[j] = kept == -np.inf or not value > kept + ACTIVE_TOLERANCE * size
        (f, f_z, same), alphas = problem.factors(z), _pulls_of_w(program, k, x)
        for objective, matters in zip(problem.objectives, own[:, 0], strict=False):
            one = bool(matters) and same.max() > SHARED
            if one and objective.own is not None and problem.quantities.own(objective.own).takes_frequencies:
                yield f"frequencies of {objective.name} that are one", np.inf
        for number, cone in enumerate(mode_cones(f, f_z * first.scale, np.maximum(-alphas, 0.0) * own)):
            if cone.sizes.any() and (cone.distance <= TIP or same[number // 2] > SHARED):
                yield f"kink of w{number // 2 + 1}, on which V falls with it", float(cone.sizes.max()) * cone.length


def _pull_of_kept(program: Program, local: FirstOrderModel, multipliers: Vector, kept: list[int]) -> float:
    """The largest slope, of V / size, with which an objective that is kept, or its kink, holds V's; at least 1.

    What may be given up is little, so that these are thousands that cancel: what is left is told relative to them.
    """
    first = len(program.first.constraints) * program.coupling.count + len(program.coupling.pairs)
    pulls = local.pulls(multipliers, kept)
    sizes = [
        abs(float(pull)) * float(np.linalg.norm(row))
        for (number, _), pull, row in zip(local.active, pulls, local.inequalities, strict=False)
        if number >= first
    ]
    sizes += [
        float(np.linalg.norm(multipliers[kink.rows] @ local.equalities[kink.rows]))
        for kink in local.kinks
        if kink.first is not None
    ]
    return max(1.0, *sizes) if sizes else 1.0


def surface_at(problem: SelectionProblem, z: Vector) -> Parallel | None:
    """The equations, about z, of what makes V = 0 there: a_i parallel to b_i; None where both of a mode vanish."""
    modes = tuple(i for i, alpha in enumerate(problem.objective.alpha) if alpha > 0)
    if not modes:
        return None
    f, f_z, same = problem.factors(z)
    slopes = f_z * problem.scale
    reach = np.linalg.norm(slopes, 2, axis=(2, 3))
    sizes = np.maximum(np.linalg.norm(f, axis=2), reach)
    away = (np.linalg.norm(f, axis=2) > TIP * reach).any(axis=1)
    told = sizes.prod(axis=1) * np.array(problem.objective.alpha) > TIP * problem.objective_scale
    if not all(same[i] < SHARED and away[i] and told[i] for i in modes):
        return None
    return Parallel.at(f, slopes, modes)


def _dimension(program: Program, x: Vector, local: FirstOrderModel) -> int | None:
    """Of the set V = 0 about x, which inequalities may bound: V's own slope and curvature vanish along it."""
    if program.first.kept or program.coupling.count > 1:
        return None
    surface = surface_at(program.first, x)
    if surface is None:
        return None
    f, f_z, _ = program.first.factors(x)
    equations = np.ones(len(local.equalities), dtype=bool)
    for kink in local.kinks:
        equations[kink.rows] = False
    across = surface.slopes(f, f_z * program.first.scale)[: surface.equations]
    # Where equations lose their slopes, as on an edge in a plane of symmetry, sets may cross.
    if np.linalg.svd(across, compute_uv=False)[-1] <= VANISHING:
        return None
    return x.size - _rank(np.vstack([local.equalities[equations], across]))


def _rank(rows: Vector) -> int:
    singular = np.linalg.svd(rows, compute_uv=False)
    return int(np.sum(singular > DEPENDENT * singular[0])) if singular.size else 0


def _curvature(
    program: Program, x: Vector, local: FirstOrderModel, multipliers: Vector, kept: list[int]
) -> tuple[float, int | None]:
    """Largest curvature of V − λᵀ c on the null space of the active rows, by central differences of exact gradients.

    0 where nothing is free, at a kink, where the branches change places within the step, and where no point nearby
    along that direction is better: differences mislead where second derivatives change within the step. And along how
    many directions there is none; None at a kink of ε_max.
    """
    rows = local.rows(list(range(len(local.inequalities))))
    _, singular, directions = np.linalg.svd(rows)
    free = directions[int(np.sum(singular > DEPENDENT * singular[0])) :] if len(rows) else np.eye(local.gradient.size)
    if any(kink.number is None for kink in local.kinks):
        return 0.0, None
    if not free.size:
        return 0.0, 0
    weights, held = local.weights(multipliers, kept), local.held(multipliers, kept)
    values, vectors = np.linalg.eigh(lagrangian_hessian(program, x, free, weights, held))
    largest, flat = float(values[-1]), int(np.sum(values >= -CURVATURE_TOLERANCE))
    if largest > CURVATURE_TOLERANCE and not _rises(program, x, local, free.T @ vectors[:, -1], weights, largest):
        return 0.0, flat
    return largest, flat


def lagrangian_hessian(program: Program, x: Vector, free: Vector, weights: Vector, held: Held) -> Vector:
    """Second derivatives of V − weightsᵀ c along the rows of `free` (d, n_x), scaled variables, (d, d).

    `held`, from `FirstOrderModel.held`: where w_i have kinks what is left of them that is smooth.
    """
    hessian = np.zeros((len(free), len(free)))
    for k, place in enumerate(program.coupling.places):
        # What the others do does not matter to this one's second derivatives, and it has few directions of its own.
        own = free[:, list(place)]
        _, reach, basis = np.linalg.svd(own, full_matrices=False)
        basis = basis[reach > 1e-9]
        along = own @ basis.T
        hessian += along @ _second_derivatives(program, k, program.of(x, k), basis, weights, held) @ along.T
    if program.goal == "motion":
        steps = free @ program.coupling.steps(free.shape[1]).T
        hessian -= steps @ steps.T
    return (hessian + hessian.T) / 2


def _second_derivatives(program: Program, k: int, z: Vector, basis: Vector, weights: Vector, held: Held) -> Vector:
    """Second derivatives of configuration k's share in the Lagrangian along a basis (d, n_z) of z / scale, (d, d)."""
    count, kept, n_rows = program.coupling.count, len(program.first.kept), len(program.first.constraints)
    before = n_rows * count + len(program.coupling.pairs)
    weighted = before + kept * count == weights.size
    of_value = program.share[k] if weighted else -weights[before + kept * count + k]

    smooth = program.without_modes({number // 2 for number in held})

    def pull(there: Vector) -> Vector:
        row_slopes, _, slopes = smooth.slopes_of(k, there)
        total = of_value * slopes[-1][0] - weights[k * n_rows : (k + 1) * n_rows] @ row_slopes
        for j in range(kept):
            total = total - weights[before + j * count + k] * slopes[j][0]
        if held:
            f, f_z, _ = program.problems[k].factors(there)
            total = total + smooth_slope(f, f_z * program.first.scale, held)
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
    constraints = program.constraints()
    numbers = [*local.equal, *(k for k, _ in local.active)]
    wanted = np.array([row.lower if value - row.lower <= row.upper - value else row.upper
                       for row, value in zip(constraints, local.g, strict=True)])[numbers]  # fmt: skip
    before = len(program.first.constraints) * program.coupling.count + len(program.coupling.pairs)
    kept = any(before <= k < before + len(program.first.kept) * program.coupling.count for k, _ in local.active)
    n_x = x.size

    def there(y: Vector) -> Local:
        at = y[:n_x] * program.scale
        return program.local(at, program.linear(at), float(y[-1]))

    tips = [kink for kink in local.kinks if kink.number is not None]

    def linear(y: Vector) -> tuple[Vector, Vector]:
        at = there(y)
        values, slopes = [at.g[numbers] - wanted], [at.jacobian[numbers]]
        f, f_z, _ = program.first.factors(y[:n_x] * program.scale) if tips else (np.zeros(0),) * 3
        for kink in tips:
            i, side = divmod(kink.number or 0, 2)
            size = float(np.linalg.norm(f_z[i, side] * program.scale, 2))
            values.append(kink.axes @ f[i, side] / size)
            slopes.append(kink.axes @ f_z[i, side] * program.scale / size)
        return np.concatenate(values), np.vstack(slopes)

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
