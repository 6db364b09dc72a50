"""How likely a further start is to end at a value that none has ended at.

In: what starts ended at. Out: the estimate and its upper bound, from how often each value was found.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.plain import counted
from flexopt.selection.problem import SelectionProblem

# Optima whose V differs by less, as a share of the scale, are of one value.
SAME_VALUE = 1e-6
# Of the bound on the chance of a value not found yet.
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Attempt:
    """One start of IPOPT and what became of it, a sentence; V of the first objective where it ended at an optimum."""

    start: tuple[float, ...]
    outcome: str
    value: float | None = None


def missed_chance(problem: SelectionProblem, attempts: Sequence[Attempt]) -> float | None:
    """As `Selection.missed_chance`, of these attempts."""
    return chance(found_how_often(problem, attempts))


def chance(counts: NDArray[np.integer[Any]]) -> float | None:
    """As `Selection.missed_chance`, of values that were found so often each."""
    return float((counts == 1).sum() / counts.sum()) if counts.size else None


def chance_at_most(counts: NDArray[np.integer[Any]]) -> float | None:
    """As `Selection.missed_chance_at_most`, of values that were found so often each."""
    if not counts.size:
        return None
    once, twice = (float((counts == k).sum()) for k in (1, 2))
    quantile = NormalDist().inv_cdf(CONFIDENCE)
    most = once + quantile**2 / 2 + quantile * math.sqrt(once + 2 * twice + quantile**2 / 4)
    return min(1.0, most / float(counts.sum()))


def chance_told(counts: NDArray[np.integer[Any]], starts: int) -> str:
    """How likely a further start is to end at a value that none has ended at, a sentence."""
    estimate, most = chance(counts) or 0.0, chance_at_most(counts) or 0.0
    return (
        f"best found in {counted(starts, 'start')}, {counts.sum()} of which ended at an optimum: "
        f"up to {math.ceil(100 * most)} % of further ones drawn alike may end at a value not found yet "
        f"(estimate {100 * estimate:.0f} %, bound with {100 * CONFIDENCE:.0f} % confidence)"
    )


def found_how_often(problem: SelectionProblem, attempts: Sequence[Attempt]) -> NDArray[np.integer[Any]]:
    """How many starts ended at each value."""
    return how_often(problem, [attempt.value for attempt in attempts if attempt.value is not None])


def how_often(problem: SelectionProblem, values: Sequence[float]) -> NDArray[np.integer[Any]]:
    """How often each value was found; empty where `Selection.missed_chance` is None.

    Values are one that differ by less than `SAME_VALUE` of the objective's scale.
    """
    if not values or (problem.redundancy < 2 and problem.measures.plant.closed_form):
        return np.zeros(0, dtype=np.int64)
    apart = np.diff(np.sort(values)) > SAME_VALUE * problem.first_scale
    return np.diff(np.flatnonzero(np.concatenate([[True], apart, [True]])))
