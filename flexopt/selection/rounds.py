"""Starts of a further round, where those before leave it open what is best.

In: a problem, and its optima so far. Out: starts that lie between and beside the best optima, or are drawn anew,
after random steps. Two good optima often share what makes them good: with one's placement and the other's posture, or
a joint turned anew, a better one is found in a tenth of the time that fresh starts take.
"""

from __future__ import annotations

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.selection.nlp.program import values_of
from flexopt.selection.places import FEASIBLE
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.starts import apart, bounds, climbed, onto_target

# Chance that more starts would show other values from which on rounds follow the first starts; after how many in a row
# that found nothing better they end, and how many there are at most.
LEFT_OPEN, IN_VAIN, ROUNDS = 0.5, 8, 24
# Points of a round, how many of them are drawn anew, their random steps, and starts taken of the better half. With half
# as many new ones and shorter ways, four of ten seeds stayed in a basin that is five times worse.
POINTS, FRESH, STEPS, STARTS = 96, 64, 45, 8
# Optima that points lie between and beside, and from where on two count as one, in scaled variables: of one family few.
PARENTS, SAME_PARENT = 12, 0.5
# Share of the variables in which a point beside an optimum is moved, and by how much, in scaled variables; how much all
# are, so that no two points are the same.
MOVED, DISTANCES, NOISE = 0.4, (0.3, 1.0, 2.0), 0.02


def further_starts(problem: SelectionProblem, optima: list[Vector], number: int, workers: int) -> list[Vector]:
    """The starts of round `number`, the most promising first; `optima` come the best first."""
    z, off = onto_target(problem, _drawn(problem, _parents(problem, optima), number))
    points = climbed([(problem, z[:, off <= FEASIBLE])], values_of, workers, STEPS, (number,))[0]
    return apart(problem, points[:, : POINTS // 2], STARTS)


def _parents(problem: SelectionProblem, optima: list[Vector]) -> Vector:
    """The best of the optima that stand apart, (n_z, k)."""
    chosen = list[Vector]()
    for z in optima:
        if all(np.abs((z - other) / problem.scale).max() > SAME_PARENT for other in chosen):
            chosen.append(z)
    return np.array(chosen[:PARENTS]).T


def _drawn(problem: SelectionProblem, parents: Vector, number: int) -> Vector:
    """Points (n_z, N): anywhere, entry by entry of one of two parents, and a parent with some moved."""
    rng = np.random.default_rng([problem.seed, number, POINTS])
    lower, upper, free, scale = (x[:, None] for x in bounds(problem))
    shape, count = (parents.shape[0], POINTS), parents.shape[1]
    first = rng.integers(0, count, POINTS)
    other = (first + rng.integers(1, max(count, 2), POINTS)) % count
    mixed = np.where(rng.random(shape) < 1 / 2, parents[:, first], parents[:, other])
    far = rng.choice(DISTANCES, POINTS) * (rng.random(shape) < MOVED)
    beside = parents[:, first] + far * scale * free * rng.standard_normal(shape)
    z = np.where(rng.random(POINTS) < 1 / 2, mixed, beside) + NOISE * scale * free * rng.standard_normal(shape)
    low, high = problem.region.low[:, None], problem.region.high[:, None]
    z[:, :FRESH] = low + (high - low) * rng.random((shape[0], FRESH))
    return np.clip(z, lower, upper)
