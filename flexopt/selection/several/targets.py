"""Several targets of one machine: read, made into configuration problems of one scale, and where the base may stand.

In: arguments. Out: a `SelectionProblem` for each target, and placements to look at.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from flexopt.errors import Fault, InputError, UnreachableTarget, raise_if_any, sentence_list
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Vector
from flexopt.foundation.plain import shown
from flexopt.model import AnyMachine
from flexopt.model.choices import asks_for_loop, of_loop
from flexopt.model.constraints import AnyConstraints
from flexopt.model.problem import SelectionOptions
from flexopt.selection.build import build_one
from flexopt.selection.places import even_places, places_left_out
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.solve import without_loop


def build_problems(
    call: str,
    machine: AnyMachine,
    points: Vector,
    field: str,
    options: SelectionOptions,
    constraints: AnyConstraints | None,
) -> tuple[SelectionProblem, ...]:
    """A configuration problem for each target, all with the same scale of the objective.

    Args:
        call: the function that asks;  field: its argument that the targets are.
        machine: a machine.
        points: targets (K, n_task), m.
        options, constraints: arguments of `flexopt.build_selection`, checked; what of them is the loop's is left out.

    Raises:
        InputError: several objectives, or ε_max among them.
        UnreachableTarget: lists every target that cannot be reached.
    """
    names = set(SelectionOptions.of("path"))
    asked = SelectionOptions.model_construct(
        **{name: getattr(options, name) for name in options.model_fields_set & names}
    )
    if of_loop(options.objective):
        asked = asked.model_copy(update={"objective": "w1", "weights": None})
    problems: list[SelectionProblem] = []
    missed: list[tuple[Fault, UnreachableTarget]] = []
    for k, point in enumerate(points):
        try:
            problems.append(build_one(machine, point, without_loop(constraints), asked, points))
        except UnreachableTarget as error:
            missed.append((Fault(f"{field}[{k}]", str(error)), error))
    if missed:
        faults = [fault for fault, _ in missed]
        sentence = sentence_list("targets that cannot be reached", faults)
        raise UnreachableTarget(sentence, miss=max(error.miss for _, error in missed))
    first = problems[0].objective
    if len(problems[0].sought) > 1 or first.has_kinks:
        sentence = "must be a single one of the w_i or V without ε_max, where several configurations belong together"
        raise_if_any(InputError, call, [Fault("objective", sentence, shown(options.objective))])
    sizes = tuple(np.median([problem.objective_scales for problem in problems], axis=0).tolist())
    return tuple(replace(problem, objective_scales=sizes) for problem in problems)


def single_measure(arguments: Arguments, given: Mapping[str, Any]) -> None:
    """Where the loop is asked, there must be one objective."""
    objective = given["objective"]
    by_loop = asks_for_loop(objective, given["constraints"])
    if by_loop and isinstance(objective, str) and "," in objective:
        arguments.note("objective", "must be a single one where several targets belong together", objective)


def sample_bases(problems: tuple[SelectionProblem, ...], on_line: int, elsewhere: int, seed: int) -> Vector:
    """Placements (n_b, N) within the ranges of all problems, N = 0 where they have no point in common.

    Even ones, see `even_places`, and more in areas of a region that these leave out.
    """
    first = problems[0]
    plant = first.measures.plant
    n_b = plant.n_base
    low = np.max([problem.region.low[:n_b] for problem in problems], axis=0)
    high = np.min([problem.region.high[:n_b] for problem in problems], axis=0)
    if np.any(low > high):
        return np.zeros((n_b, 0))
    bases = even_places(low, high, on_line, elsewhere, seed)
    return np.concatenate([bases, places_left_out(plant, first.asked, low, high, bases, seed)], axis=1)


def none_reaches_all(count: int, missing: list[int] | None = None) -> UnreachableTarget:
    """The error where no placement reaches all targets; `missing`: which the best one leaves out."""
    sentence = f"no placement reaches all of the {count} targets"
    if missing:
        sentence += f": the best reaches all but number {', '.join(str(k + 1) for k in missing)}"
    return UnreachableTarget(f"{sentence}; a wider base_range, fewer targets, or `plan_base`, which moves", miss=0.0)
