"""A problem file's problem, solved by what its target asks for."""

from __future__ import annotations

from flexopt.foundation.arrays import Progress
from flexopt.foundation.boundary import public
from flexopt.model import Problem
from flexopt.selection.result import Selection
from flexopt.selection.several import BasePlan, Stand, plan_base, select_stand
from flexopt.selection.solve import select


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
    calls = {"end_point": select, "end_points": select_stand, "path": plan_base}
    return calls[problem.target.kind](**problem.select_arguments(), workers=workers, progress=progress)
