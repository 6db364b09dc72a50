"""How a program bends about a point: its curvature along what is free, and how many directions lead along optima.

In: a program, a point and its multipliers. Out: second derivatives of the Lagrangian; the dimension of the optimal set.
"""

from __future__ import annotations

import numpy as np

from flexopt.algebra.feasible import shortest_steps
from flexopt.foundation.arrays import Vector
from flexopt.selection.ascent.model import halves, turn
from flexopt.selection.cones import SHARED, Parallel, farther, smooth_slope
from flexopt.selection.nlp.coupling import own_directions, widened
from flexopt.selection.nlp.program import Linearisation, Program, row_gradients
from flexopt.selection.nlp.solvers import Local
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.proof.first_order import TIP
from flexopt.selection.proof.multipliers import FirstOrderModel, HeldCones, HeldMargins

# How far a point may be off the rows that it is moved onto.
LANDED = 1e-8
CURVATURE_TOLERANCE = 1e-6
CURVATURE_STEP = 1e-5
# Steps along a direction of positive curvature, in scaled variables, that are looked at for a larger V.
PROBES = (1e-2, 1e-3, 1e-4)
# Steps back onto the active rows, and how near they lead: what is left is taken off what V gains.
CORRECTIONS, ON_ROWS = 8, 1e-14
# Singular values of rows below this share of the largest are rounding.
DEPENDENT = 1e-9
# Slopes of the equations of a_i parallel to b_i, in scaled variables, that count as none.
VANISHING = 1e-7
# Slopes of a_i or b_i where it is 0, as a share of its largest, along which it may stay so; and how long the steps are,
# in scaled variables, that show whether it does.
FLAT, ASIDE = 1e-5, 1e-2
# A gain below this share of V's and the multipliers' size is rounding.
NOISE = 1e-12


def surface_at(problem: SelectionProblem, z: Vector) -> Parallel | None:
    """The equations, about z, of what makes V = 0 there: a_i parallel to b_i; None where both of a mode vanish.

    Where one of them vanishes and goes on to do so along more than an edge of that, its own equations.
    """
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
    sides = {i: 1 - farther(f[i], slopes[i]) for i in modes}
    tips = {i: side for i, side in sides.items() if np.linalg.norm(f[i, side]) <= TIP * reach[i, side]}
    resting = {i: _resting(problem, z, i, side) for i, side in tips.items()}
    return Parallel.at(f, slopes, modes, {i: axes for i, axes in resting.items() if axes is not None})


def _resting(problem: SelectionProblem, z: Vector, i: int, side: int) -> Vector | None:
    """Axes e_k (k, r) of a_i or b_i, 0 at z, that are 0 where all of it is, fewer than r; None where there are none.

    It then depends on fewer numbers than it has entries, as beyond a slide that a mode finds free: no force passes
    along it. To first order that may be chance; so steps are made to where the e_k are 0, and all of it must be.
    """
    lower, upper, sizes = problem.row_bounds
    n_task, scale, fixed = problem.target.size, problem.scale, problem.lower == problem.upper
    equal = (lower == upper) | (np.arange(lower.size) < n_task)
    wanted = np.append(problem.target, lower[n_task:])

    def held(y: Vector) -> tuple[Vector, Vector]:
        off, slopes = (problem.rows(y * scale) - wanted) / sizes, row_gradients(problem, y * scale) / sizes[:, None]
        return np.append(off[equal], (y - start)[fixed]), np.vstack([slopes[equal] * scale, np.eye(y.size)[fixed]])

    def tip(y: Vector) -> tuple[Vector, Vector]:
        f, f_z, _ = problem.factors(y * scale)
        return f[i, side] / reach, f_z[i, side] * scale / reach

    start, reach = z / scale, 1.0
    reach = float(np.linalg.norm(tip(start)[1], 2))
    free = _null_space(held(start)[1])
    across, singular, along = np.linalg.svd(tip(start)[1] @ free.T)
    rank = int(np.sum(singular > FLAT))
    axes, ways = across.T[:rank], along[rank:] @ free

    def onto(y: Vector) -> tuple[Vector, Vector]:
        (off, rows), (value, slopes) = held(y), tip(y)
        return np.append(off, axes @ value), np.vstack([rows, axes @ slopes])

    if rank == len(across) or not len(ways):
        return None
    for way in ways:
        there, error = shortest_steps(onto, start + ASIDE * way, np.ones(z.size), ON_ROWS, steps=CORRECTIONS)
        if not (error <= LANDED and np.linalg.norm(tip(there)[0]) <= DEPENDENT):
            return None
    return axes


def dimension_of(program: Program, x: Vector, local: FirstOrderModel) -> int | None:
    """Of the set V = 0 about x, which inequalities may bound: V's own slope and curvature vanish along it."""
    if program.first.kept or program.goal != "weighted":
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
    if np.linalg.svd(across, compute_uv=False).min(initial=np.inf) <= VANISHING:
        return None
    return x.size - _rank(np.vstack([local.equalities[equations], across]))


def _null_space(rows: Vector) -> Vector:
    """An orthonormal basis (d, n) of what the rows (k, n) leave free."""
    _, singular, directions = np.linalg.svd(rows)
    free: Vector = directions[int(np.sum(singular > DEPENDENT * singular[0])) :]
    return free


def _rank(rows: Vector) -> int:
    singular = np.linalg.svd(rows, compute_uv=False)
    return int(np.sum(singular > DEPENDENT * singular[0])) if singular.size else 0


def largest_curvature(
    program: Program, x: Vector, local: FirstOrderModel, multipliers: Vector, kept: list[int]
) -> tuple[float, int | None]:
    """Largest curvature of V − λᵀ c on the null space of the active rows, by central differences of exact gradients.

    0 where nothing is free, and where no point nearby along that direction is better: differences mislead where second
    derivatives change within the step. And along how many directions there is none.
    """
    rows = local.rows(list(range(len(local.inequalities))))
    free = _null_space(rows) if len(rows) else np.eye(local.gradient.size)
    if not free.size:
        return 0.0, 0
    weights = local.weights(multipliers, kept)
    values, vectors = np.linalg.eigh(lagrangian_hessian(program, x, free, local, multipliers, kept))
    largest, flat = float(values[-1]), int(np.sum(values >= -CURVATURE_TOLERANCE))
    if largest > CURVATURE_TOLERANCE and not _rises(program, x, local, free.T @ vectors[:, -1], weights, largest):
        return 0.0, flat
    return largest, flat


def lagrangian_hessian(
    program: Program, x: Vector, free: Vector, local: FirstOrderModel, multipliers: Vector, kept: list[int]
) -> Vector:
    """Second derivatives of V − weightsᵀ c along the rows of `free` (d, n_x), scaled variables, (d, d).

    At kinks of what is left of w_i and ε_max that is smooth, with the multipliers of the kinks.
    """
    weights, held = local.weights(multipliers, kept), local.held(multipliers, kept)
    margins = local.held_margins(multipliers)
    hessian = np.zeros((len(free), len(free)))
    for k, place in enumerate(program.coupling.places):
        # What the others do does not matter to this one's second derivatives, and it has few directions of its own.
        along, basis = own_directions(free, place)
        second = _second_derivatives(program, k, program.of(x, k), basis, weights, held, margins)
        hessian += along @ second @ along.T
    if program.goal == "motion":
        steps = free @ program.coupling.steps(free.shape[1]).T
        hessian -= steps @ steps.T
    return (hessian + hessian.T) / 2


def _second_derivatives(
    program: Program, k: int, z: Vector, basis: Vector, weights: Vector, held: HeldCones, margins: HeldMargins
) -> Vector:
    """Second derivatives of configuration k's share in the Lagrangian along a basis (d, n_z) of z / scale, (d, d)."""
    count, kept, n_rows = program.coupling.count, len(program.first.kept), len(program.first.constraints)
    before = n_rows * count + len(program.coupling.pairs)
    weighted = before + kept * count == weights.size
    of_value = program.share[k] if weighted else -weights[before + kept * count + k]
    shares = [*(-weights[before + j * count + k] for j in range(kept)), of_value]

    tips = {number: pull for (member, number), pull in held.items() if member == k}
    smooth = program.without_modes({number // 2 for number in tips})
    # The p of a kink of what is sought is told per share of the configuration.
    pulls = {j: p * (of_value if weighted and j == kept else 1.0) for (member, j), p in margins.items() if member == k}
    by = {j: halves(slopes) for j, slopes in enumerate(smooth.slopes_of(k, z)[2]) if j in pulls} if pulls else {}

    def pull(there: Vector) -> Vector:
        row_slopes, _, slopes = smooth.slopes_of(k, there)
        total = -weights[k * n_rows : (k + 1) * n_rows] @ row_slopes
        for j, (share, own) in enumerate(zip(shares, slopes, strict=True)):
            if j not in pulls:
                total = total + share * own[0]
                continue
            cone = halves(own)
            total = total + share * (own[0] + own[1]) / 2 - pulls[j] @ turn(cone, by[j]) @ cone
        if tips:
            f, f_z, _ = program.problems[k].factors(there)
            total = total + smooth_slope(f, f_z * program.first.scale, tips)
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

    def there(y: Vector) -> tuple[Local, list[Linearisation]]:
        at = y[:n_x] * program.scale
        members = program.linear(at)
        return program.local(at, members, float(y[-1])), members

    tips = [kink for kink in local.kinks if kink.number is not None]
    margins = [kink for kink in local.kinks if kink.number is None]

    def linear(y: Vector) -> tuple[Vector, Vector]:
        at, members = there(y)
        values, slopes = [at.g[numbers] - wanted], [at.jacobian[numbers]]
        for kink in margins:
            branches = members[kink.member].values[kink.objective]
            own = halves(members[kink.member].slopes[kink.objective])
            size = float(np.linalg.norm(own))
            values.append(np.array([(branches[0] - branches[1]) / 2, 0.0]) / size)
            slopes.append(widened(own / size, program.coupling.places[kink.member], y.size))
        z = [program.of(y[:n_x] * program.scale, k) for k in range(program.coupling.count)]
        factors = {k: program.problems[k].factors(z[k]) for k in {kink.member for kink in tips}}
        for kink in tips:
            (f, f_z, _), (i, side) = factors[kink.member], divmod(kink.number or 0, 2)
            own = f_z[i, side] * program.first.scale
            size = float(np.linalg.norm(own, 2))
            values.append(kink.axes @ f[i, side] / size)
            slopes.append(widened(kink.axes @ own / size, program.coupling.places[kink.member], y.size))
        return np.concatenate(values), np.vstack(slopes)

    landed, start = False, np.append(x / program.scale, local.level)[: local.gradient.size]
    for step in PROBES:
        for sign in (1.0, -1.0):
            near = start + sign * step * local.moving * direction
            y, error = shortest_steps(linear, near, local.moving, ON_ROWS, steps=CORRECTIONS)
            if error <= LANDED:
                landed, (at, _) = True, there(y)
                better = -at.f - local.value - weights[numbers] @ (at.g[numbers] - wanted)
                if better > max(0.1 * curvature * step**2, NOISE * (abs(at.f) + float(np.abs(weights).sum()))):
                    return True
    return kept and not landed
