"""Problems as reports and verdicts take them, checked."""

from __future__ import annotations

from typing import Any

from flexopt.errors import Fault
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.boundary import TABLE
from flexopt.model import Problem
from flexopt.selection import SelectionProblem


def any_problem(arguments: Arguments, field: str, value: Any) -> Any:
    """A problem of one target or several."""
    if isinstance(value, SelectionProblem):
        arguments.of = value.machine
        return value
    if not isinstance(value, Problem):
        arguments.note(field, "must be a problem, from flexopt.load_problem or flexopt.build_selection", value)
        return value
    TABLE["problem"](arguments, field, value)
    return value


def one_placement(arguments: Arguments, field: str, value: Any) -> Any:
    """A problem of one target, or of several from one placement."""
    value = any_problem(arguments, field, value)
    if isinstance(value, Problem) and value.target.kind == "path":
        sentence = "must ask for one placement, by target.end_point or target.end_points, not target.path"
        arguments.faults.append(Fault(field, sentence, value.name))
    return value
