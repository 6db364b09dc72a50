"""What was seen before anything was solved: feasible points of the scan that no answer may be worse than.

In: a problem and what its solves found. Out: points z that keep everything and are better, on the rows to rounding.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flexopt.algebra.feasible import shortest_steps
from flexopt.foundation.arrays import Vector
from flexopt.selection.broken import beyond_bounds, falls_within
from flexopt.selection.nlp.program import row_gradients
from flexopt.selection.objective import Objective
from flexopt.selection.problem import SelectionProblem, value_at
from flexopt.selection.scan import peaks

# By how much, of the objective's scale, a point counts as better: far above what a converged solve leaves.
BETTER = 2e-8
# How near to the rows steps lead, and how near is on them, in units of the rows' scales: what V gains by being off them
# must not count, be it as steep as it may.
EXACT, ON_ROWS = 1e-14, 1e-9
# Points tried to be moved onto the rows, the best first.
TRIED = 8
# Further starts of a later objective.
PEAKS = 16
# What is kept is often a surface that no point of a scan lies on: points are moved there that are short by this share.
NEARLY_KEPT = 0.05


def seen_values(problem: SelectionProblem, short: float = 0.0) -> Vector:
    """V of the objective being solved at all points of the scan (N,), the cost of travel taken off.

    −∞ where a point breaks a constraint or is short of what is kept by more than a share of that objective's scale.
    """
    scan, allowed = problem.scan, problem.scan.feasible
    for objective, kept, size in zip(problem.objectives, problem.kept, problem.objective_scales, strict=False):
        allowed[allowed] = _values(problem, objective, allowed) >= kept - short * size
    values = np.full(scan.size, -np.inf)
    found = _values(problem, problem.objective, allowed)
    values[allowed] = np.where(np.isfinite(found), found, -np.inf)
    return values


def kept_peaks(problem: SelectionProblem) -> list[Vector]:
    """Points of the scan that keep the earlier objectives, or nearly, and are local maxima of the one being solved."""
    scan, found = problem.scan, dict[int, None]()
    for short in (0.0, NEARLY_KEPT):
        values = seen_values(problem, short)
        found |= dict.fromkeys(peaks(scan, values, np.isfinite(values))[:PEAKS].tolist())
    return [scan.z[:, k] for k in found]


def _values(problem: SelectionProblem, objective: Objective, among: NDArray[np.bool_]) -> Vector:
    """V of an objective at some of the scan's points."""
    scan, z = problem.scan, problem.scan.z[:, among]
    values = problem.quantities.smooth(objective, scan.base[:, among], scan.posture[:, among], scan.w[:, among])
    if objective.has_kinks and among.any():
        epsilon = scan.epsilon[among]
        unknown = np.flatnonzero(np.isnan(epsilon))
        if unknown.size:
            at = [*problem.quantities.at(z[:, unknown]), problem.gain]
            epsilon[unknown] = problem.quantities.margin.values.call(at)[0].full()[0]
        values = values + objective.beta * epsilon
    return values - problem.travel_cost(objective, z.T)[0]


def better_than(problem: SelectionProblem, value: float, values: Vector) -> Vector | None:
    """The best point of the scan that is better than `value`, on the rows; None where none is.

    Args:
        problem: the problem.
        value: V of the best that was found, −∞ where nothing was.
        values: from `seen_values`.
    """
    least, z = value + BETTER * problem.objective_scale, problem.scan.z
    order = np.argsort(-values, kind="stable")[:TRIED]
    points = (settled(problem, z[:, k]) for k in order if values[k] > least)
    good = [point for point in points if point is not None and _keeps(problem, point)]
    best = max(good, key=lambda point: value_at(problem, point), default=None)
    return best if best is not None and value_at(problem, best) > least else None


def _keeps(problem: SelectionProblem, z: Vector) -> bool:
    earlier = problem.objectives[: len(problem.kept)]
    values = [value_at(problem, z, objective) for objective in earlier]
    return not falls_within(problem, z) and all(value >= kept for value, kept in zip(values, problem.kept, strict=True))


def settled(problem: SelectionProblem, z: Vector) -> Vector | None:
    """A point near z on the rows, to rounding, by the shortest steps; None where they do not lead there.

    A scan's points are feasible to its own tolerance.
    """
    lower, upper, scale = problem.row_bounds
    freed = np.where(problem.lower == problem.upper, 0.0, problem.scale)

    def linear(there: Vector) -> tuple[Vector, Vector]:
        wrong = beyond_bounds(problem, there)
        pulls = (wrong != 0) | (lower == upper)
        return wrong, (row_gradients(problem, there) / scale[:, None]) * pulls[:, None]

    there, error = shortest_steps(linear, z, freed, EXACT, bounds=(problem.lower, problem.upper))
    return there if error <= ON_ROWS else None
