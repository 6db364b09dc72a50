"""A problem file's problem, solved by what its target asks for, and what stands in the way of that."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from flexopt.errors import Fault
from flexopt.foundation.arrays import Progress
from flexopt.foundation.boundary import faults_of, public
from flexopt.model import Problem
from flexopt.model.problem import TARGET_ARGUMENTS
from flexopt.model.targets import PathMotion, TargetKind
from flexopt.selection.result import Selection
from flexopt.selection.several import BasePlan, Stand, plan_base, select_stand
from flexopt.selection.solve import select

# By what its target asks for.
CALLS: dict[TargetKind, Callable[..., Any]] = {"end_point": select, "end_points": select_stand, "path": plan_base}


@public()
def solve_problem(
    problem: Problem, *, workers: int | None = None, progress: Progress | None = None
) -> Selection | Stand | BasePlan:
    """Solve a problem file's problem (`flexopt.load_problem`).

    `target.end_point` is for `flexopt.select`, `target.end_points` for `select_stand`, `target.path` for `plan_base`.

    Args:
        problem: the problem.
        workers, progress: as in these.

    Raises:
        InputError, UnreachableTarget, NoSolutionFound: as these.

    Example:
        >>> flexopt.solve_problem(flexopt.load_problem("article")).status
        '8 distinct local optima verified from 8 starts'
    """
    return CALLS[problem.target.kind](**problem.select_arguments(), workers=workers, progress=progress)


def problem_refusals(problem: Problem) -> list[Fault]:
    """What solving a problem file's problem refuses before it computes anything; fields are those of the file."""
    kind, arguments = problem.target.kind, problem.select_arguments()
    tables = {name: name for name in ("machine", "constraints", "loop")}
    tables |= {"ranges": "uncertainty", TARGET_ARGUMENTS[kind]: f"target.{kind}"}
    tables |= {key: f"motion.{key}" for key in PathMotion.model_fields}
    found: list[Fault] = []
    for fault in faults_of(CALLS[kind], **arguments):
        argument, *rest = re.split(r"\b", fault.field, maxsplit=2)[1:]
        place = tables.get(argument, f"selection.{argument}")
        found.append(Fault("".join((place, *rest)), fault.sentence, fault.value))
    real = problem.loop or problem.loaded_machine.loop
    if real is not None and real.control not in (None, arguments["control"]):
        sentence = f"is not the control of the loop by which verdicts judge, {real.control}"
        found.append(Fault("selection.control", sentence, repr(arguments["control"])))
    return found
