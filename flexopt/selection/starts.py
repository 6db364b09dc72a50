"""Where a configuration problem is started from.

In: a problem. Out: starts z. Where postures have a closed form they are the peaks of the scan. Everywhere else, and
where other constraints leave little of the scan, points of a low-discrepancy sample are moved onto the target and into
the constraints by damped Newton steps, and the best of them that stand apart are taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from flexopt.algebra.feasible import repeated
from flexopt.foundation.arrays import Vector
from flexopt.plant.inverse_kinematics import low_discrepancy, reach_steps
from flexopt.selection.configuration import Configuration
from flexopt.selection.objective import Objective, Quantities
from flexopt.selection.scan import Scan, empty_scan, peaks, scanned

if TYPE_CHECKING:
    from flexopt.selection.problem import SelectionProblem

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


@dataclass(frozen=True)
class Region:
    """What a sample may do: bounds and scales of z, ranges that it is taken from, rows and their bounds.

    Attributes:
        lower, upper, scale: of z, (n_z,).
        low, high: finite ranges of the sample, (n_z,).
        row_lower, row_upper, row_scale: of all rows, (n_rows,), as in `Configuration`.
        constants: c of the constraint rows.
    """

    lower: Vector
    upper: Vector
    scale: Vector
    low: Vector
    high: Vector
    row_lower: Vector
    row_upper: Vector
    row_scale: Vector
    constants: Vector

    @property
    def bounds(self) -> tuple[Vector, Vector, Vector, Vector]:
        """What `feasible_steps` takes of z: bounds, what is free, scales."""
        return self.lower, self.upper, (self.lower < self.upper).astype(float), self.scale


def moved(configuration: Configuration, region: Region, z: Vector, enough: int) -> tuple[Vector, Vector]:
    """Points z (n_z, N) moved to where the rows hold, and what stays violated at most, (N,), in units of the scales.

    No more steps are made once `enough` of the points are done.
    """
    rows = (region.row_lower, region.row_upper, region.row_scale)
    others = [configuration.measures.plant.parameter_values, region.constants]
    return repeated(configuration.feasible, z, region.bounds, rows, others, FEASIBLE / 100, ROUNDS, enough)


def onto_target(configuration: Configuration, region: Region, z: Vector) -> tuple[Vector, Vector]:
    """As `moved`, for the target alone: quicker steps, made until all are done."""
    plant = configuration.measures.plant
    target, scale = region.row_lower[: plant.n_task], region.row_scale[: plant.n_task]
    steps = reach_steps(configuration.machine)
    return repeated(steps, z, region.bounds, (target, target, scale), [plant.parameter_values], FEASIBLE / 100, ROUNDS)


def sample_configurations(
    functions: Quantities, configuration: Configuration, region: Region, objective: Objective, starts: int, seed: int
) -> tuple[Scan, float]:
    """A low-discrepancy sample moved onto the target and, as far as can be, into the constraints.

    Returns:
        The points that reach the target, and the smallest violation of a target row among all, m.
    """
    plant = functions.measures.plant
    n_b = plant.n_base
    loose = region.lower < region.upper
    unit = low_discrepancy(int(loose.sum()), _count(starts), seed) if loose.any() else np.zeros((0, 1))
    z = np.repeat(region.low[:, None], unit.shape[1], axis=1)
    z[loose] += (region.high - region.low)[loose, None] * unit
    z, off = onto_target(configuration, region, z)
    reaches = off <= FEASIBLE
    if not reaches.any():
        return empty_scan(plant, reached=False), float(np.nanmin(off) * region.row_scale[0])
    z, unit = z[:, reaches], unit[:, reaches]
    left = violated(configuration, region, z)
    missing = ENOUGH * starts - int(np.sum(left <= FEASIBLE))
    if missing > 0:
        # Those that break the constraints least. Where that fails too, the point on the target shows what is broken.
        order = np.argsort(left, kind="stable")
        nearest = order[left[order] > FEASIBLE][: 2 * ENOUGH * starts]
        there, still = moved(configuration, region, z[:, nearest], missing)
        better = still <= FEASIBLE
        z[:, nearest[better]], left[nearest[better]] = there[:, better], still[better]
    if np.sum(left <= FEASIBLE) >= starts:
        z, unit, left = z[:, left <= FEASIBLE], unit[:, left <= FEASIBLE], left[left <= FEASIBLE]
    count = left.size
    violation = np.where(left <= FEASIBLE, 0.0, left)
    number = np.arange(count, dtype=np.int64)
    return scanned(functions, objective, unit, np.zeros(count), z[:n_b], z[n_b:], number, violation), 0.0


def _count(starts: int) -> int:
    return int(np.clip(SAMPLES_EACH * starts, SAMPLES_MIN, SAMPLES_MAX))


def violated(configuration: Configuration, region: Region, z: Vector) -> Vector:
    """The largest violation of any row at points z (n_z, N), in units of the scales; infinite where it is no number."""
    plant = configuration.measures.plant
    at = [z[: plant.n_base], z[plant.n_base :], plant.parameter_values, region.constants]
    rows = configuration.rows_at_rest.call(at)[0].full().T
    beyond = np.maximum(region.row_lower - rows, rows - region.row_upper) / region.row_scale
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
    there, left = moved(problem.configuration, problem.region, z[:, near], near.size)
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
