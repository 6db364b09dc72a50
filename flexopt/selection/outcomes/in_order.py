"""Objectives in order of importance, measures of the loop among them: each is best among what keeps those before.

In: a `SelectionProblem` for each objective, a loop. Out: an `OutcomeSelection` by the last.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from flexopt.errors import NoSolutionFound
from flexopt.foundation.arrays import Document, Progress
from flexopt.selection.outcomes.asked import Asked, MeasureBounds, measure_of
from flexopt.selection.outcomes.choice import outcome_selection
from flexopt.selection.outcomes.result import OutcomeSelection
from flexopt.selection.outcomes.starting import Seed
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.result import Kept
from flexopt.selection.solve import initial_evaluation, solved


def outcome_selection_in_order(
    problems: Mapping[str, SelectionProblem],
    loop: Any,
    ranges: Any,
    constraints: Any,
    workers: int | None,
    progress: Progress | None,
) -> OutcomeSelection:
    """Local optima of the last objective, the best first, of those that keep what is best of the others.

    What an objective may give up for the next ones is `slack` of its best; of a w_i or V at least of the typical
    Σ αi |a_i||b_i|, as in `flexopt.solve_selection`.

    Args:
        problems: from `build_selection`, by objective, in order; of measures of the loop its objective is not asked.
        loop, ranges, constraints, workers, progress: as of `flexopt.select`.

    Raises:
        InputError, NoSolutionFound: as `outcome_selection`, of any of the objectives; the loop does not fit.
    """
    names, bounds, kept, seeds = list(problems), MeasureBounds(), list[Kept](), list[Seed]()
    asked = Asked.of("select", problems[names[0]], loop, ranges, ",".join(names), constraints)
    initial = initial_evaluation(problems[names[0]])
    for name in names[:-1]:
        problem, measure = problems[name], measure_of(name, problems[name])
        if measure.of_modes and not bounds and asked.least is None:
            found = solved(problem, workers, progress)
            seeds += [Seed(candidate.z) for candidate in found.candidates]
        else:
            seeds += _of_modes(problem, workers) if measure.of_modes else []
            own = replace(asked, name=name)
            found = outcome_selection(problem, own, initial, workers, progress, bounds=bounds, seeds=seeds)
            seeds += _seeds(found)
        best = measure.sign * found.best.objective
        at_least = best - (problem.given_up(best) if measure.of_modes else problem.slack * abs(best))
        ends = (at_least, math.inf) if measure.sign > 0 else (-math.inf, -at_least)
        bounds = (*bounds, (measure, at_least))
        kept.append(Kept(name, found.best.objective, *ends, found.unverified, found.objective_unit))
    last, own = problems[names[-1]], replace(asked, name=names[-1])
    seeds += _of_modes(last, workers) if measure_of(names[-1], last).of_modes else []
    found = outcome_selection(last, own, initial, workers, progress, bounds=bounds, seeds=seeds, kept=tuple(kept))
    options = found.provenance["options"] | (_stated(problems) if kept else {})
    return replace(found, provenance=found.provenance | {"options": options})


def _stated(problems: Mapping[str, SelectionProblem]) -> Document:
    """What was asked of several objectives, as provenance has it."""
    of_modes = {name: problem.objective for name, problem in problems.items() if measure_of(name, problem).of_modes}
    weights = {name: {"weights": objective.weights.tolist()} for name, objective in of_modes.items()}
    return {
        "objective": ",".join(problems),
        "slack": next(iter(problems.values())).slack,
        "objectives": [{"name": name} | weights.get(name, {}) for name in problems],
    }


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
