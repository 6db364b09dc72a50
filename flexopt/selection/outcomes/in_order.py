"""Objectives in order of importance, measures of the loop among them: each is best among what keeps those before.

In: a `SelectionProblem` for each objective, a loop. Out: an `OutcomeSelection` by the last.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from flexopt.errors import NoSolutionFound
from flexopt.foundation.arrays import Progress
from flexopt.model.constraints import LeastOutcomes
from flexopt.model.loop import Loop
from flexopt.model.uncertainty import Uncertainty
from flexopt.robustness import Evaluation
from flexopt.selection.outcomes.choice import MeasureBounds, measure_of, outcome_selection
from flexopt.selection.outcomes.result import OutcomeSelection
from flexopt.selection.outcomes.starting import Seed
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.result import Kept
from flexopt.selection.solve import solved


def outcome_selection_in_order(
    problems: Mapping[str, SelectionProblem],
    loop: Loop,
    uncertainty: tuple[Uncertainty, ...],
    initial: Evaluation | None,
    workers: int | None,
    progress: Progress | None,
    least: LeastOutcomes | None = None,
) -> OutcomeSelection:
    """Local optima of the last objective, the best first, of those that keep what is best of the others.

    What an objective may give up for the next ones is `slack` of its best; of a w_i or V at least of the typical
    Σ αi |a_i||b_i|, as in `flexopt.solve_selection`.

    Args:
        problems: from `build_selection`, by objective, in order; of measures of the loop its objective is not asked.
        loop, uncertainty, initial, workers, progress, least: as of `outcome_selection`.

    Raises:
        InputError, NoSolutionFound: as `outcome_selection`, of any of the objectives.
    """
    names, bounds, kept, seeds = list(problems), MeasureBounds(), list[Kept](), list[Seed]()
    for name in names[:-1]:
        problem, measure = problems[name], measure_of(name, problems[name])
        if measure.of_modes and not bounds and least is None:
            found = solved(problem, workers, progress)
            seeds += [Seed(candidate.z) for candidate in found.candidates]
        else:
            seeds += _of_modes(problem, workers) if measure.of_modes else []
            found = outcome_selection(problem, loop, uncertainty, initial, workers, progress, name, least,
                                      bounds=bounds, seeds=seeds)  # fmt: skip
            seeds += _seeds(found)
        best = measure.sign * found.best.objective
        at_least = best - (problem.given_up(best) if measure.of_modes else problem.slack * abs(best))
        ends = (at_least, math.inf) if measure.sign > 0 else (-math.inf, -at_least)
        bounds = (*bounds, (measure, at_least))
        kept.append(Kept(name, found.best.objective, *ends, found.unverified, found.objective_unit))
    last = problems[names[-1]]
    seeds += _of_modes(last, workers) if measure_of(names[-1], last).of_modes else []
    return outcome_selection(last, loop, uncertainty, initial, workers, progress, names[-1], least,
                             bounds=bounds, seeds=seeds, kept=tuple(kept))  # fmt: skip


def _of_modes(problem: SelectionProblem, workers: int | None) -> list[Seed]:
    """Where w_i or V is best whatever the loop does: often it does what it must there, too."""
    try:
        return [Seed(candidate.z) for candidate in solved(problem, workers).candidates]
    except NoSolutionFound:
        return []


def _seeds(found: OutcomeSelection) -> list[Seed]:
    """Its candidates, with their gains."""
    each: Sequence[Mapping[str, float]] = found.gains
    return [Seed(candidate.z, dict(gains)) for candidate, gains in zip(found.candidates, each, strict=True)]
