"""Where a configuration problem is started from.

In: a problem. Out: starts z. Where postures have a closed form they are the peaks of the scan. Everywhere else, and
where other constraints leave little of the scan, points of a low-discrepancy sample are moved onto the target and into
the constraints by damped Newton steps, and the best of them that stand apart are taken.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flexopt.algebra.feasible import repeated
from flexopt.foundation.arrays import Vector
from flexopt.plant.inverse_kinematics import low_discrepancy, reach_steps
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.scan import Scan, empty_scan, peaks, scanned

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
# Largest violation, in units of the rows' scales, of a point that counts as feasible.
FEASIBLE = 1e-7
# Starts that differ by less, in scaled variables, are one.
SAME_START = 1e-3


def _bounds(problem: SelectionProblem) -> tuple[Vector, Vector, Vector, Vector]:
    """What `feasible_steps` takes of z: bounds, what is free, scales."""
    lower, upper = problem.lower, problem.upper
    return lower, upper, (lower < upper).astype(float), problem.scale


def moved(problem: SelectionProblem, z: Vector, enough: int) -> tuple[Vector, Vector]:
    """Points z (n_z, N) moved to where the rows hold, and what stays violated at most, (N,), in units of the scales.

    No more steps are made once `enough` of the points are done.
    """
    others = [problem.measures.plant.parameter_values, problem.constants]
    steps = problem.configuration.feasible
    return repeated(steps, z, _bounds(problem), problem.row_bounds, others, FEASIBLE / 100, ROUNDS, enough)


def onto_target(problem: SelectionProblem, z: Vector) -> tuple[Vector, Vector]:
    """As `moved`, for the target alone: quicker steps, made until all are done."""
    n_task, others = problem.target.size, [problem.measures.plant.parameter_values]
    lower, upper, scale = (x[:n_task] for x in problem.row_bounds)
    steps = reach_steps(problem.machine)
    return repeated(steps, z, _bounds(problem), (lower, upper, scale), others, FEASIBLE / 100, ROUNDS)


def sample_configurations(problem: SelectionProblem, starts: int) -> tuple[Scan, float]:
    """A low-discrepancy sample moved onto the target and, as far as can be, into the constraints.

    Returns:
        The points that reach the target, and the smallest violation of a target row among all, m.
    """
    region, plant = problem.region, problem.measures.plant
    n_b = plant.n_base
    loose = problem.lower < problem.upper
    unit = low_discrepancy(int(loose.sum()), _count(starts), problem.seed) if loose.any() else np.zeros((0, 1))
    z = np.repeat(region.low[:, None], unit.shape[1], axis=1)
    z[loose] += (region.high - region.low)[loose, None] * unit
    z, off = onto_target(problem, z)
    reaches = off <= FEASIBLE
    if not reaches.any():
        return empty_scan(plant, reached=False), float(np.nanmin(off) * problem.row_bounds[2][0])
    z, unit = z[:, reaches], unit[:, reaches]
    left = violated(problem, z)
    missing = ENOUGH * starts - int(np.sum(left <= FEASIBLE))
    if missing > 0:
        # Those that break the constraints least. Where that fails too, the point on the target shows what is broken.
        order = np.argsort(left, kind="stable")
        nearest = order[left[order] > FEASIBLE][: 2 * ENOUGH * starts]
        there, still = moved(problem, z[:, nearest], missing)
        better = still <= FEASIBLE
        z[:, nearest[better]], left[nearest[better]] = there[:, better], still[better]
    if np.sum(left <= FEASIBLE) >= starts:
        z, unit, left = z[:, left <= FEASIBLE], unit[:, left <= FEASIBLE], left[left <= FEASIBLE]
    count = left.size
    violation, number = np.where(left <= FEASIBLE, 0.0, left), np.arange(count, dtype=np.int64)
    return scanned(
        problem.quantities, problem.objectives[0], unit, np.zeros(count), z[:n_b], z[n_b:], number, violation
    ), 0.0


def _count(starts: int) -> int:
    return int(np.clip(SAMPLES_EACH * starts, SAMPLES_MIN, SAMPLES_MAX))


def violated(problem: SelectionProblem, z: Vector) -> Vector:
    """The largest violation of any row at points z (n_z, N), in units of the scales; infinite where it is no number."""
    plant, (lower, upper, scale) = problem.measures.plant, problem.row_bounds
    at = [z[: plant.n_base], z[plant.n_base :], plant.parameter_values, problem.constants]
    rows = problem.configuration.rows_at_rest.call(at)[0].full().T
    beyond = np.maximum(lower - rows, rows - upper) / scale
    worst = np.maximum(beyond, 0.0).max(axis=1)
    return np.where(np.isfinite(worst), worst, np.inf)


def starting_points(problem: SelectionProblem) -> list[Vector]:
    """Starts z for a problem, the most promising first."""
    scan = problem.scan
    z = np.vstack([scan.base, scan.posture])
    if problem.measures.plant.closed_form:
        feasible = scan.violation <= FEASIBLE
        chosen = peaks(scan, among=feasible)
        points = [z[:, k] for k in chosen]
        if not feasible.all():
            points += _onto_constraints(problem, z, feasible)
        return points[: problem.starts or STARTS_OF_SCAN]
    # What breaks a constraint is started from only where nothing else is left.
    count, good = problem.starts or STARTS, scan.violation <= 0
    order = np.lexsort([-scan.objective, scan.violation])
    order = order[good[order]] if good.any() else order
    best = order[: max(count, round(BEST_SHARE * order.size))]
    return _apart(z[:, best], problem.scale, count, problem.measures.plant.n_base)


def _onto_constraints(problem: SelectionProblem, z: Vector, feasible: NDArray[np.bool_]) -> list[Vector]:
    """Points where the scan comes nearest to the constraints, moved into them; all of them where none is inside."""
    near = peaks(problem.scan, -problem.scan.violation, ~feasible)[:STARTS_OF_SCAN]
    there, left = moved(problem, z[:, near], near.size)
    good = left <= FEASIBLE
    if not good.any() and not feasible.any():
        return list(z[:, near].T)
    return list(there[:, good].T)


def _apart(z: Vector, scale: Vector, count: int, n_base: int) -> list[Vector]:
    """Up to `count` of the columns, which come in order of preference, as far apart as that many can be found.

    What counts is the posture: to turn or shift machine and target together changes no measure.
    """
    x = (z / scale[:, None]).T[:, n_base:]
    distance = np.full(x.shape[0], np.inf)
    taken: list[int] = []
    radius = float(np.median(np.abs(x - np.median(x, axis=0)).max(axis=1))) if x.size else 0.0
    while len(taken) < count and radius > SAME_START:
        for k in range(x.shape[0]):
            if distance[k] >= radius and len(taken) < count:
                taken.append(k)
                distance = np.minimum(distance, np.abs(x - x[k]).max(axis=1))
        radius /= 2
    if not taken and x.size:
        taken = [0]
    return [z[:, k] for k in sorted(taken)]
