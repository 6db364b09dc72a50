"""Where a configuration problem is started from.

In: a problem. Out: starts z. Where postures have a closed form they are the peaks of the scan. Everywhere else, and
where other constraints leave little of the scan, points of a low-discrepancy sample are moved onto the target and into
the constraints by damped Newton steps. With one degree of redundancy the peaks along the curve that the sample lies on
come first; with more the best points climb at random, and those that then stand apart are taken.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import zip_longest
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from flexopt.algebra.feasible import repeated
from flexopt.foundation.arrays import Vector
from flexopt.foundation.plain import listed
from flexopt.foundation.processes import in_parallel
from flexopt.model.constraints import Constraints
from flexopt.plant.inverse_kinematics import held_on, led_from_nearest, low_discrepancy, reach_steps
from flexopt.selection.nlp.program import values_of
from flexopt.selection.places import FEASIBLE, places_left_out
from flexopt.selection.problem import SelectionProblem, own_held
from flexopt.selection.scan import POSTURES_EACH, Scan, empty_scan, peaks, scanned

# Enough for every peak of a curve; the redundancy of longer arms has maxima without end.
STARTS_OF_SCAN = 64
STARTS = 32
# Points of the sample for each start, and in all at least.
SAMPLES_EACH, SAMPLES_MIN, SAMPLES_MAX = 48, 256, 40_000
# Calls of `feasible_steps`; what is not done then is a start only where nothing better is found.
ROUNDS = 4
# Feasible points for each start that are enough to choose from.
ENOUGH = 3
# Share of the sample, the best of it, that starts are taken from.
BEST_SHARE = 1 / 3
# Values of a joint about which a machine may be symmetric; points that tell, how far beside, and how even w_i are
# there, relative to |a_i||b_i|. Starts from each plane of symmetry.
PLANES = (0.0, math.pi, -math.pi, math.pi / 2, -math.pi / 2)
SYMMETRIC, ASIDE, EVEN = 8, 0.3, 1e-9
# Turns of a joint by which it is told whether anything depends on it, rad.
TURNS = np.array([0.0, 0.4, -1.1, 2.0])
INSIDE = 4
# Along a curve: of how many of a point's nearest the neighbour on its other side is one, and how far the curve may bend
# there (cosine).
NEAREST, BEND = 16, -0.5
# Points for each start that climb at random; steps, and the first one and the bounds of all, in scaled variables; by
# how much a step grows after one that helped, and shrinks after others.
CLIMBING, STEPS, STEP, STEP_LEAST, STEP_MOST, LONGER, SHORTER = 6, 60, 0.3, 1e-4, 0.5, 1.6, 0.8
# Ends of climbs over a surface that are looked at.
SUMMITS = 16
# Points that one process climbs with.
BLOCK = 32
# The violation of an own constraint that is no number.
NO_NUMBER = 1e100
# Starts that differ by less, in scaled variables, are one.
SAME_START = 1e-3

ValuesAt = Callable[[SelectionProblem, Vector], Vector]
SeedNumbers = tuple[int, ...]


def bounds(problem: SelectionProblem, *, standing: bool = False) -> tuple[Vector, Vector, Vector, Vector]:
    """What `feasible_steps` takes of z: bounds, what is free, scales. `standing`: the base stays where each has it."""
    lower, upper = problem.lower, problem.upper
    free = (lower < upper).astype(float)
    free[: problem.measures.plant.n_base * standing] = 0.0
    return lower, upper, free, problem.scale


def moved(
    problem: SelectionProblem, z: Vector, enough: int | None = None, *, standing: bool = False
) -> tuple[Vector, Vector]:
    """Points z (n_z, N) moved to where the rows hold, and what stays violated at most, (N,), in units of the scales.

    No more steps are made once `enough` of the points are done. `standing`: as of `bounds`.
    """
    others = [problem.measures.plant.parameter_values, problem.constants]
    of_z, steps = bounds(problem, standing=standing), problem.configuration.feasible
    return repeated(steps, z, of_z, problem.row_bounds, others, FEASIBLE / 100, ROUNDS, enough)


def onto_target(problem: SelectionProblem, z: Vector, *, standing: bool = False) -> tuple[Vector, Vector]:
    """As `moved`, for the target alone: quicker steps, made until all are done."""
    n_task, others = problem.target.size, [problem.measures.plant.parameter_values]
    lower, upper, scale = (x[:n_task] for x in problem.row_bounds)
    of_z, steps = bounds(problem, standing=standing), reach_steps(problem.machine)
    return repeated(steps, z, of_z, (lower, upper, scale), others, FEASIBLE / 100, ROUNDS)


def sample_configurations(problem: SelectionProblem, starts: int, areas: Constraints) -> tuple[Scan, float]:
    """A low-discrepancy sample moved onto the target and, as far as can be, into the constraints.

    Where the sample leaves out areas that the machine may stand in, more is looked at there.

    Returns:
        The points that reach the target, and the smallest violation of a target row among all, m.
    """
    region, plant = problem.region, problem.measures.plant
    n_b = plant.n_base
    loose = problem.lower < problem.upper
    size = int(np.clip(SAMPLES_EACH * starts, SAMPLES_MIN, SAMPLES_MAX))

    def sampled(count: int) -> tuple[Vector, Vector]:
        unit = low_discrepancy(int(loose.sum()), count, problem.seed) if loose.any() else np.zeros((0, 1))
        z = np.repeat(region.low[:, None], unit.shape[1], axis=1)
        z[loose] += (region.high - region.low)[loose, None] * unit
        return z, unit

    z, unit = sampled(size)
    if problem.present_base is not None and problem.present_posture is not None:
        # Where few postures reach the target the present one may be near one that does.
        now = np.concatenate([problem.present_base, problem.present_posture]).clip(problem.lower, problem.upper)
        size, z = size + 1, np.column_stack([z, now])
        unit = np.column_stack([unit, ((now - region.low)[loose] / (region.high - region.low)[loose])])
    z, off = onto_target(problem, z)
    there = z[:n_b, off <= FEASIBLE]
    places = places_left_out(plant, areas, region.low[:n_b], region.high[:n_b], there, problem.seed)
    if places.size and loose.any():
        more, of_more = sampled(places.shape[1] * POSTURES_EACH)
        more[:n_b] = np.tile(places, POSTURES_EACH)
        more, far = onto_target(problem, more, standing=True)
        z, unit, off = (np.concatenate(pair, axis=-1) for pair in ((z, more), (unit, of_more), (off, far)))
    reaches = off <= FEASIBLE
    if problem.gravity:
        z, unit, reaches, off = _sagging(problem, z, unit, off)
    if not reaches.any():
        return empty_scan(plant, reached=False), float(np.nanmin(off) * problem.row_bounds[2][0])
    z, unit = z[:, reaches], unit[:, reaches]
    left = violated(problem, z)
    # Those of areas that were left out are beside these.
    missing = ENOUGH * starts - int(np.sum(left[: int(reaches[:size].sum())] <= FEASIBLE))
    if missing > 0:
        # Those that break the constraints least. Where that fails too, the point on the target shows what is broken.
        order = np.argsort(left, kind="stable")
        nearest = order[left[order] > FEASIBLE][: 2 * ENOUGH * starts]
        there, still = moved(problem, z[:, nearest], missing)
        better = still <= FEASIBLE
        z[:, nearest[better]], left[nearest[better]] = there[:, better], violated(problem, there[:, better])
    if np.sum(left <= FEASIBLE) >= starts:
        z, unit, left = z[:, left <= FEASIBLE], unit[:, left <= FEASIBLE], left[left <= FEASIBLE]
    count = left.size
    violation, number = np.where(left <= FEASIBLE, 0.0, left), np.arange(count, dtype=np.int64)
    return scanned(
        problem.quantities, problem.sought[0], unit, np.zeros(count), z[:n_b], z[n_b:], number, violation
    ), 0.0


def _sagging(
    problem: SelectionProblem, z: Vector, unit: Vector, at_rest: Vector
) -> tuple[Vector, Vector, NDArray[np.bool_], Vector]:
    """Points as the machine sags: those that reach the target at rest, held on it, where any can be.

    Else those to which the nearest lead, base and arm: the border of the reach is another then. `at_rest`: how far off
    each is with springs unloaded, in units of the scale. Besides points and their coordinates: which are to be looked
    at, and how far off each is as it sags.
    """
    plant, n_b, n_task = problem.measures.plant, problem.measures.plant.n_base, problem.target.size
    reaches = at_rest <= FEASIBLE
    if reaches.any():
        # What is turned beyond a limit misses the target, and may be moved.
        held, _ = held_on(plant, problem.target, z[:n_b, reaches], z[n_b:, reaches])
        z[n_b:, reaches] = np.clip(held.T, problem.lower[n_b:], problem.upper[n_b:]).T
        off = np.full(reaches.size, math.inf)
        off[reaches] = np.nan_to_num(beyond_rows(problem, z[:, reaches])[:, :n_task].max(axis=1), nan=math.inf)
        if off.min() <= FEASIBLE:
            return z, unit, reaches, off
    ends = problem.lower, problem.upper
    chosen, led, off = led_from_nearest(plant, problem.target, z, at_rest, problem.seed, ends)
    off = off / problem.row_bounds[2][0]
    return led, unit[:, chosen], off <= FEASIBLE, off


def violated(problem: SelectionProblem, z: Vector, *, target: bool = True) -> Vector:
    """The largest violation of any row at points z (n_z, N), in units of the scales; infinite where it is no number.

    `target`: those of the target, too.
    """
    rows = beyond_rows(problem, z)[:, 0 if target else problem.target.size :]
    worst = np.maximum(rows.max(axis=1), _short(problem, z))
    return np.where(np.isfinite(worst), worst, np.inf)


def beyond_rows(problem: SelectionProblem, z: Vector) -> Vector:
    """The violation of every row at points z (n_z, N), in units of the scales, (N, rows): ∞, no number."""
    lower, upper, scale = problem.row_bounds
    rows = rows_at(problem, z)
    found = np.maximum(np.maximum(lower - rows, rows - upper) / scale, 0.0)
    return np.where(np.isnan(found), np.inf, found)


def rows_at(problem: SelectionProblem, z: Vector) -> Vector:
    """Every row at points z (n_z, N), (N, rows)."""
    return problem.configuration.rows_alone.call([*problem.quantities.at(z), problem.constants])[0].full().T


def kept_by_none(problem: SelectionProblem) -> str:
    """Which constraints, each by itself, no configuration of the scan keeps, in words; empty where none is so."""
    if not problem.scan.size:
        return ""
    configurations = f"{problem.scan.size} configurations at the target"
    return short_told(problem, beyond_rows(problem, problem.scan.z), configurations)


def short_told(problem: SelectionProblem, beyond: Vector, what: str) -> str:
    """Which rows are violated by all of `what`, in words; empty where none is so.

    `beyond`: the violation of every row by each of them, in units of the scales, (N, rows).
    """
    least, short = beyond.min(axis=0), dict[str, tuple[float, str]]()
    for row, size in zip(problem.constraints, least.tolist(), strict=True):
        if size > FEASIBLE:
            # Several rows, of corners, too, may be one constraint, which is short by the most of them.
            name = row.name.removesuffix(row.corner)
            short[name] = max(short.get(name, (0.0, "")), (size * row.scale, row.unit))
    told = [
        f"{name}, {off:.3g} {unit}".rstrip() + " short at best" if math.isfinite(off) else f"{name}, no number"
        for name, (off, unit) in short.items()
    ]
    return f"of {what} that were looked at none keeps {listed(told)}" if told else ""


def _short(problem: SelectionProblem, z: Vector) -> Vector:
    """The largest violation of an own constraint at points z (n_z, N), in units of the scales."""
    worst = np.zeros(z.shape[1])
    if not problem.bounding or not worst.size:
        return worst
    base, posture, _ = problem.quantities.at(z)
    w = np.zeros((problem.measures.plant.n_passive, worst.size))
    for objective, least, size in zip(
        problem.objectives[: problem.bounding], problem.kept, problem.objective_scales, strict=False
    ):
        values = problem.quantities.smooth(objective, base, posture, w)
        worst = np.maximum(worst, np.where(np.isfinite(values), (least - values) / size, NO_NUMBER))
    return worst


def with_kept(problem: SelectionProblem, scan: Scan) -> Scan:
    """A scan that knows of own constraints, too."""
    if not problem.bounding or not scan.size:
        return scan
    short = _short(problem, scan.z)
    return replace(scan, violation=np.maximum(scan.violation, np.where(short <= FEASIBLE, 0.0, short)))


def starting_points(problem: SelectionProblem, workers: int = 1) -> list[Vector]:
    """Starts z for a problem, the most promising first; the same for any number of `workers`."""
    scan, z = problem.scan, problem.scan.z
    if problem.measures.plant.closed_form:
        points = [z[:, k] for k in peaks(scan, among=scan.feasible)]
        points += between_points(problem)
        # Those that break the constraints least show what is broken.
        points = points or list(_nearest_to_constraints(problem).T)
        return points[: problem.starts or STARTS_OF_SCAN]
    # What breaks a constraint is started from only where nothing else is left.
    count, good = problem.starts or STARTS, scan.violation <= 0
    cost = problem.travel_cost(problem.sought[0], z.T)[0]
    order = np.lexsort([cost - scan.objective, scan.violation])
    order = order[good[order]] if good.any() else order
    if good.any() and problem.redundancy == 1:
        return _along_curve(problem, z[:, order], (scan.objective - cost)[order], count)
    best = z[:, order[: max(count, round(BEST_SHARE * order.size))]]
    if not good.any() or not climbs(problem):
        found = apart(problem, best, count)
        # What was moved onto a limit may be one point many times: the best of the sample, all of it.
        return found if len(found) == count else apart(problem, z[:, order], count)
    return _in_turn(problem, best[:, : CLIMBING * count], count, values_of, workers)


def _along_curve(problem: SelectionProblem, z: Vector, values: Vector, count: int) -> list[Vector]:
    """Starts from points (n_z, N) of curves, which come best first: their peaks, and others far from these."""
    first = curve_peaks(problem, z, values)[:count]
    found = list[Vector]()
    # What was moved onto a limit may be one point many times: then of the whole sample.
    for among in (max(count, round(BEST_SHARE * values.size)), values.size):
        others = np.setdiff1d(np.arange(min(among, values.size)), first)
        found = apart(problem, z[:, [*first, *others]], count, first.size)
        if len(found) == count:
            break
    return found


def curve_peaks(problem: SelectionProblem, z: Vector, values: Vector) -> NDArray[np.int64]:
    """Which points (n_z, N) of curves are peaks, as no neighbour has a larger V, in the order they come in.

    A point's neighbours are the nearest one, and the nearest of those that lie on the other side of it; at the end of a
    curve there is none such. Where V is the same all along there is no peak.
    """
    from scipy.spatial import KDTree  # noqa: PLC0415  (slow to import, needed for curves in space only)

    seen, turn = _telling(problem, z[:, 0]), _turns(problem)
    if not seen:
        return np.zeros(0, dtype=np.int64)
    x, around = (z / problem.scale[:, None])[seen].T, turn[seen]
    x = np.where(around > 0, np.mod(x, np.where(around > 0, around, 1.0)), x)
    # Of what is below 0 by rounding alone the remainder is a whole turn.
    x = np.where((around > 0) & (x >= around), 0.0, x)
    one = np.sort(np.unique(np.round(x / SAME_START), axis=0, return_index=True)[1])
    x, z, values = x[one], z[:, one], values[one]
    if one.size < 2:
        return one
    tree = cast(Any, KDTree(x, boxsize=around))
    near: NDArray[np.int64] = tree.query(x, k=min(1 + NEAREST, one.size))[1][:, 1:]
    away = _back(x[near] - x[:, None], around)
    away /= np.linalg.norm(away, axis=2, keepdims=True)
    opposite = np.einsum("nki,ni->nk", away, away[:, 0]) < BEND
    beside = np.stack([near[:, 0], near[np.arange(one.size), opposite.argmax(axis=1)]])
    higher = values[beside] > values - EVEN * problem.objective_scale
    higher[1] &= opposite.any(axis=1)
    # What is higher beyond a gap, where the curve breaks a constraint, is no neighbour.
    asked = np.flatnonzero(higher.sum(axis=0) == 1)
    other = beside[np.argmax(higher[:, asked], axis=0), asked]
    way = _back(((z[:, other] - z[:, asked]) / problem.scale[:, None]).T, turn).T * problem.scale[:, None]
    middle, off = onto_target(problem, z[:, asked] + way / 2)
    higher[:, asked[(off <= FEASIBLE) & (violated(problem, middle) > FEASIBLE)]] = False
    peak: NDArray[np.int64] = one[~higher.any(axis=0)]
    return peak


def climbs(problem: SelectionProblem) -> bool:
    """Whether points climb at random: not for ε_max, which costs more, and not along curves, which are seen whole."""
    return problem.redundancy > 1 and not problem.measures.plant.closed_form and not problem.sought[0].has_kinks


def climbed_anywhere(problem: SelectionProblem, workers: int = 1) -> list[Vector]:
    """Where points of a surface, taken evenly, lead that climb at random, apart from each other, the best first.

    The best points of a sample are often of one wide hill, and a higher, narrow one shows in none. Curves are seen
    whole, and without a closed form starts come from such climbs.
    """
    good = problem.scan.feasible
    if problem.redundancy < 2 or not problem.measures.plant.closed_form or not good.any():
        return []
    z, count = problem.scan.z[:, good], CLIMBING * (problem.starts or STARTS_OF_SCAN)
    each = max(1, z.shape[1] // count)
    return apart(problem, climbed([(problem, z[:, ::each])], values_with_margin, workers)[0], SUMMITS)


def values_with_margin(problem: SelectionProblem, z: Vector) -> Vector:
    """V (N,) of points (n_z, N), ε_max too, the cost of travel taken off."""
    values, n_base = values_of(problem, z), problem.measures.plant.n_base
    if problem.objective.has_kinks:
        values = values + problem.objective.beta * problem.quantities.epsilon_max(z[:n_base], z[n_base:])
    return values


def _in_turn(problem: SelectionProblem, z: Vector, count: int, values_at: ValuesAt, workers: int) -> list[Vector]:
    """Where the points lead that climb at random, freely and in the planes of symmetry, in turn, the best first."""
    sets = [(problem, z), *((plane, _into(plane, z[:, ::2])) for plane in _planes(problem))]
    first, *others = climbed(sets, values_at, workers)
    free = apart(problem, first, count)
    inside = [point for points in others for point in apart(problem, points, INSIDE)]
    pairs = zip_longest(free[: len(inside)], inside)
    return [*(start for pair in pairs for start in pair if start is not None), *free[len(inside) :]][:count]


def _planes(problem: SelectionProblem) -> list[SelectionProblem]:
    """The problem with a joint held where the machine is symmetric about it: all w_i are even in that joint.

    Optima like to stand there, on kinks that no random step leads to exactly.
    """
    sample, found = problem.scan.z[:, :SYMMETRIC], list[SelectionProblem]()
    for k in range(problem.measures.plant.n_base, sample.shape[0]):
        variable, before = problem.variables[k], list[float]()
        for value in PLANES:
            whole_turns = any(abs(math.remainder(value - other, math.tau)) < EVEN for other in before)
            if variable.unit != "rad" or not variable.lower <= value <= variable.upper or whole_turns:
                continue
            z = np.tile(sample, 3)
            z[k] = value + ASIDE * np.repeat([-1.0, 0.0, 1.0], sample.shape[1])
            w, size = (out.full() for out in problem.measures.w.call(problem.quantities.at(z))[:2])
            left, middle, right = np.split(w, 3, axis=1)
            rounding = EVEN * np.split(size, 3, axis=1)[2]
            if np.all(np.abs(right - left) <= rounding) and np.any(np.abs(right - middle) > rounding):
                before.append(value)
                held = list(problem.variables)
                held[k] = replace(variable, lower=value, upper=value)
                found.append(replace(problem, variables=tuple(held)))
    return found


def _into(plane: SelectionProblem, z: Vector) -> Vector:
    """The points (n_z, N) that reach the target with what is held."""
    there, off = onto_target(plane, np.clip(z, plane.lower[:, None], plane.upper[:, None]))
    return there[:, off <= FEASIBLE]


def worst_starts(problem: SelectionProblem, count: int, workers: int = 1) -> list[Vector]:
    """Points where the worst of all w_i is large, apart from each other, the best first; random steps lead there."""
    z = problem.scan.z[:, problem.scan.feasible]
    if not z.size:
        return []
    order = np.argsort(-_worst(problem, z), kind="stable")[: CLIMBING * count]
    return _in_turn(problem, z[:, order], count, _worst, workers)


def _worst(problem: SelectionProblem, z: Vector) -> Vector:
    """The smallest w_i (N,) of points (n_z, N)."""
    least: Vector = problem.quantities.w_at(z).min(axis=0)
    return least


def climbed(
    sets: list[tuple[SelectionProblem, Vector]],
    values_at: ValuesAt,
    workers: int,
    steps: int = STEPS,
    seed: SeedNumbers = (),
) -> list[Vector]:
    """Of every problem its points (n_z, N) after random steps, the best first; in blocks, over processes."""
    blocks = [
        (k, z[:, first : first + BLOCK], (problem.seed, *seed, k, first))
        for k, (problem, z) in enumerate(sets)
        for first in range(0, z.shape[1], BLOCK)
    ]
    task = partial(_climbing, [problem for problem, _ in sets], blocks, values_at, steps)
    ends = in_parallel(task, len(blocks), workers, at_once=True)
    found: list[Vector] = []
    for k, (_, z) in enumerate(sets):
        ours = [out for (number, _, _), out in zip(blocks, ends, strict=True) if number == k]
        points, values = (np.concatenate(each, axis=-1) for each in zip((z[:, :0], np.zeros(0)), *ours, strict=True))
        found.append(points[:, np.argsort(-values, kind="stable")])
    return found


def _climbing(
    problems: list[SelectionProblem],
    blocks: list[tuple[int, Vector, SeedNumbers]],
    values_at: ValuesAt,
    steps: int,
    number: int,
) -> tuple[Vector, Vector]:
    """A block's points after random steps along the target, taken where they keep all constraints and V grows.

    No slope is asked for, so that kinks and narrow valleys stop it less than a solver. A block: the number of its
    problem, points (n_z, N), and a seed. `values_at`: of the problem and points, what grows.

    Returns:
        The points, and what grew there (N,).
    """
    k, z, seed = blocks[number]
    problem = problems[k]
    rng, none = np.random.default_rng(seed), np.full(z.shape[1], -np.inf)
    lower, upper, free, scale = (x[:, None] for x in bounds(problem))
    values, step = _feasible(problem, z, values_at, none), np.full(z.shape[1], STEP)
    for _ in range(steps):
        there = np.clip(z + step * rng.standard_normal(z.shape) * scale * free, lower, upper)
        there, off = onto_target(problem, there)
        found = _feasible(problem, there, values_at, np.where(off <= FEASIBLE, values, np.inf))
        better = found > values
        z, values = np.where(better, there, z), np.where(better, found, values)
        step = np.clip(step * np.where(better, LONGER, SHORTER), STEP_LEAST, STEP_MOST)
    return z, values


def _feasible(problem: SelectionProblem, z: Vector, values_at: ValuesAt, above: Vector) -> Vector:
    """Values (N,) at points that reach the target; −∞ where they break a constraint, or are no more than `above`."""
    values: Vector = np.full(above.size, -np.inf)
    asked = np.flatnonzero(above < np.inf)
    if asked.size:
        values[asked] = values_at(problem, z[:, asked])
    more = np.isfinite(values) & (values > above)
    asked = np.flatnonzero(more)
    if asked.size:
        more[asked] = violated(problem, z[:, asked]) <= FEASIBLE
    values[~more] = -np.inf
    return values


def between_points(problem: SelectionProblem) -> list[Vector]:
    """Configurations where the scan comes nearest to the constraints, moved into them: what they leave may be thin."""
    near = _nearest_to_constraints(problem)
    if not near.size:
        return []
    there, left = moved(problem, near)
    return list(there[:, left <= FEASIBLE].T)


def _nearest_to_constraints(problem: SelectionProblem) -> Vector:
    scan = problem.scan
    return scan.z[:, peaks(scan, -scan.violation, ~scan.feasible)[:STARTS_OF_SCAN]]


def idle_joints(problem: SelectionProblem, z: Vector, *, constrained: bool = False) -> list[int]:
    """Joints that neither the end-point nor a measure depends on; `constrained`: nor what constraints keep there."""
    found = list[int]()
    for k in range(problem.measures.plant.n_base, z.size):
        at = np.repeat(z[:, None], TURNS.size, axis=1)
        at[k] += TURNS
        w, size, r = (x.full() for x in problem.measures.w.call(problem.quantities.at(at))[:3])
        turns_nothing = np.all(np.abs(w - w[:, :1]) <= EVEN * size) and np.all(np.abs(r - r[:, :1]) <= EVEN)
        if turns_nothing and not (constrained and _constrained(problem, at)):
            found.append(k)
    return found


def _constrained(problem: SelectionProblem, z: Vector) -> bool:
    """Whether constraints, the user's own, too, tell points z (n_z, N) apart."""
    rows = (rows_at(problem, z) / problem.row_bounds[2])[:, problem.target.size :]
    n_base, sizes = problem.measures.plant.n_base, [each.scale for each in problem.own_constraints]
    own = np.array([own_held(problem, each[:n_base], each[n_base:], None) for each in z.T]) / sizes
    return not np.all(np.ptp(np.hstack([rows, own]), axis=0) <= EVEN)


def apart(problem: SelectionProblem, z: Vector, count: int, before: int = 0) -> list[Vector]:
    """Up to `count` of the columns, which come in order of preference, as far apart as that many can be found.

    The first `before` are among them wherever they are.
    """
    if not z.size:
        return []
    seen = _telling(problem, z[:, 0])
    x, turn = (z / problem.scale[:, None])[seen].T, _turns(problem)[seen]
    distance, taken = np.full(x.shape[0], np.inf), list[int]()

    def take(k: int) -> None:
        nonlocal distance
        taken.append(k)
        distance = np.minimum(distance, np.abs(_back(x - x[k], turn)).max(axis=1))

    for k in range(before if seen else 0):
        take(k)
    radius = float(np.median(np.abs(x - np.median(x, axis=0)).max(axis=1))) if seen else 0.0
    while len(taken) < count and radius > SAME_START:
        for k in range(x.shape[0]):
            if distance[k] >= radius and len(taken) < count:
                take(k)
        radius /= 2
    return [z[:, k] for k in sorted(taken or [0])]


def _telling(problem: SelectionProblem, z: Vector) -> list[int]:
    """The variables that tell points apart.

    What counts is the posture: to turn or shift machine and target together changes no measure, nor do whole turns of
    joints that may make them, nor joints on which nothing depends; own Functions may depend on all of it.
    """
    idle, n_base = idle_joints(problem, z), problem.measures.plant.n_base
    return [k for k in range(z.size) if _own(problem) or (k >= n_base and k not in idle)]


def _turns(problem: SelectionProblem) -> Vector:
    """A whole turn of each scaled variable that may make one, else 0."""
    spans = zip(problem.variables, problem.upper - problem.lower, strict=True)
    whole = np.array([variable.unit == "rad" and span > math.tau and not _own(problem) for variable, span in spans])
    turns: Vector = whole * math.tau / problem.scale
    return turns


def _own(problem: SelectionProblem) -> bool:
    return any(objective.own is not None for objective in problem.objectives)


def _back(away: Vector, turn: Vector) -> Vector:
    """Differences (…, k), whole turns taken off."""
    back: Vector = away - turn * np.round(away / np.where(turn > 0, turn, 1.0))
    return back
