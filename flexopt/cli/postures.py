"""A configuration as options of a command: a posture, or the end-point that it reaches, the base, the control."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from flexopt.cli.common import BASE, CONTROL, ELBOW, END_POINT, GRAVITY, numbers, typed, value
from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.model import AnyMachine
from flexopt.model.choices import ELBOWS
from flexopt.plant import build_plant, inverse_kinematics

POSTURE = value("--posture", "A,B,…", "Actuated joints, rad (slides: m).", numbers)


def configuration(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options of a command that looks at one configuration."""
    for option in (GRAVITY, CONTROL, BASE, ELBOW, END_POINT, POSTURE):
        command = option(command)
    return command


def asked_posture(call: str, machine: AnyMachine, options: dict[str, Any]) -> Any:
    """The posture given, or the one that reaches the end-point given."""
    posture, end_point, base = options["posture"], options["end_point"], options["base"]
    faults: list[Fault] = []
    if (posture is None) == (end_point is None):
        faults.append(Fault("--posture, --end-point", "give one of the two"))
    if posture is not None and options["elbow"] is not None:
        faults.append(Fault("--elbow", "goes with --end-point only", options["elbow"]))
    joints, closed_form = machine.joints, build_plant(machine).closed_form
    if end_point is not None and len(joints) > len(machine.task_rows):
        sentence = f"does not name one posture of {len(joints)} actuated joints; use select, or --posture"
        faults.append(Fault("--end-point", sentence, typed(end_point)))
    if options["elbow"] is not None and not closed_form:
        faults.append(Fault("--elbow", "names a branch of planar arms only", options["elbow"]))
    raise_if_any(InputError, call, faults)
    if posture is not None:
        return posture
    arguments = Arguments(call)
    elbow = arguments.choice("elbow", options["elbow"] or "up", ELBOWS) if closed_form else None
    point = arguments.point(end_point, "end-point", machine)
    if base is not None:
        arguments.base(machine, base)
    arguments.control(options["control"] or "inverse")
    arguments.done()
    return inverse_kinematics(machine, point, base=base, gravity=options["gravity"], elbow=elbow)[0]
