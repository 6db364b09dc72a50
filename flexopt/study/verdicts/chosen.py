"""What a verdict judges: the answer of a problem, the loop that judges it, and what is uncertain.

In: what callers of `flexopt.verdict` pass. Out: the answer with its places, a `Loop` and its ranges.
"""

from __future__ import annotations

from typing import Any, cast

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Progress
from flexopt.foundation.control import Control
from flexopt.foundation.plain import shown
from flexopt.model import AnyMachine, Problem
from flexopt.model.choices import asks_for_loop
from flexopt.model.loop import Loop, control_of, under_control
from flexopt.model.problem import judged_by
from flexopt.model.uncertainty import GROUND, Uncertainty
from flexopt.selection import Selection, SelectionProblem, select, solve_problem, solve_selection
from flexopt.selection.several import BasePlan, Stand
from flexopt.study.asked import any_problem
from flexopt.study.verdicts.place_loops import Chosen, problems_of

UNPLACED = Fault("base", "is needed: where the machine stands now, from which it may pay to move")


def judged_problem(arguments: Arguments, field: str, value: Any) -> Any:
    """A problem as for a report, its answer, or a machine."""
    if isinstance(value, AnyMachine):
        arguments.of = value
    elif isinstance(value, Selection | Stand | BasePlan):
        arguments.of = problems_of(value)[0].machine
    else:
        return any_problem(arguments, field, value)
    return value


def chosen_by(problem: Any, asked: dict[str, Any], loop: Any, ranges: Any, progress: Progress) -> Chosen:
    """The problem's answer, or that of a machine with a target; what is sought of the loop is sought of the one judged.

    `asked`: target, constraints and options of a machine.
    """
    given = {name: value for name, value in asked.items() if value is not None}
    if isinstance(problem, AnyMachine):
        missing = [Fault("target", "is needed of a machine")] if "target" not in given else []
        # Before places are sought, which takes its time.
        if problem.base_coordinates and "base" not in given and "options" not in given:
            missing.append(UNPLACED)
        raise_if_any(InputError, "verdict", missing)
        given["control"] = control_of(given.get("control"), loop, problem)
        _judging(loop, problem, given["control"])
        if asks_for_loop(given.get("objective"), given.get("constraints")):
            given |= {"loop": loop, "ranges": ranges}
        return select(problem, **given, progress=progress)
    sentence = "goes with a machine; the problem brings its own"
    faults = [Fault(name, sentence, shown(value)) for name, value in given.items()]
    raise_if_any(InputError, "verdict", faults)
    if isinstance(problem, SelectionProblem):
        raise_if_any(InputError, "verdict", [UNPLACED] if problem.present_base is None else [])
        _judging(loop, problem.machine, problem.control)
        return solve_selection(problem, progress=progress)
    if isinstance(problem, Problem):
        placed = problem.selection.base is not None or not problem.loaded_machine.base_coordinates
        raise_if_any(InputError, "verdict", [] if placed else [UNPLACED])
        real = judged_by(problem, loop, ranges)
        _judging(real.loop, real.loaded_machine, real.select_arguments()["control"])
        return solve_problem(real, progress=progress)
    return cast(Chosen, problem)


def _judging(loop: Loop | None, machine: AnyMachine, control: Control) -> Loop:
    """The loop that judges, by default the machine's, with the control of the choice; refused where it has another."""
    return under_control(loop or machine.loop or Loop(), machine, control, "verdict")


def loop_and_ranges(problem: Any, chosen: Chosen, loop: Any, ranges: Any) -> tuple[Loop, tuple[Uncertainty, ...]]:
    """The loop with the problem's control, and what is uncertain; both from where they are first given."""
    first = problems_of(chosen)[0]
    machine, control = first.machine, first.control
    own = _judging(loop or getattr(problem, "loop", None), machine, control)
    return own, ranges or getattr(problem, "uncertainty", None) or machine.uncertainty or GROUND
