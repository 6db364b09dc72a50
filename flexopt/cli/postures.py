"""A configuration as options of a command: a posture, or the end-point that it reaches, the base, the control."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from flexopt.cli.common import BASE, CONTROL, ELBOW, END_POINT, GRAVITY, numbers, say, together, value
from flexopt.cli.terminal import VOICE
from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Vector
from flexopt.foundation.control import Control
from flexopt.model import AnyMachine
from flexopt.model.choices import ELBOWS
from flexopt.model.loop import control_of
from flexopt.plant import build_plant, inverse_kinematics
from flexopt.robustness import build_measures

POSTURE = value("--posture", "A,B,…", "Actuated joints, rad (slides: m).", numbers)
# The options of a command that looks at one configuration.
configuration = together(POSTURE, END_POINT, ELBOW, BASE, CONTROL, GRAVITY)


def elbow_faults(machine: AnyMachine, options: Mapping[str, Any], posture: Any = None) -> list[Fault]:
    """That --elbow is given beside a posture, or of a machine whose postures do not come in two branches."""
    elbow, faults = options["elbow"], list[Fault]()
    if elbow is not None and posture is not None:
        faults.append(Fault("--elbow", "goes with --end-point only", elbow))
    if elbow is not None and not build_plant(machine).closed_form:
        faults.append(Fault("--elbow", "names a branch of planar arms only", elbow))
    return faults


def asked_posture(
    call: str, machine: AnyMachine, options: dict[str, Any], loop: Mapping[str, Any] | None = None
) -> Any:
    """The posture given, or the one that reaches the end-point given; `loop`: the table of the loop that was given."""
    posture, end_point, base = options["posture"], options["end_point"], options["base"]
    faults: list[Fault] = []
    if (posture is None) == (end_point is None):
        faults.append(Fault("--posture, --end-point", "give one of the two"))
    closed_form = build_plant(machine).closed_form
    faults += elbow_faults(machine, options, posture)
    raise_if_any(InputError, call, faults)
    if posture is not None:
        return posture
    arguments = Arguments(call)
    point = arguments.point(end_point, "end-point", machine)
    redundant = len(machine.joints) > len(machine.task_rows)
    # One of two is the answer where there are no more; of a redundant arm's the best of all is taken.
    elbow = options["elbow"] or (None if redundant else "up")
    elbow = arguments.choice("elbow", elbow, ELBOWS) if closed_form and elbow else None
    if base is not None:
        arguments.base(machine, base)
    whose = "control" if options["control"] else "--loop control"
    control: Control = arguments.control(control_of(options["control"], loop, machine), whose)
    arguments.done()
    postures = inverse_kinematics(machine, point, base=base, gravity=options["gravity"], elbow=elbow)
    return _best(machine, postures, elbow, base, control, options) if redundant else postures[0]


def _best(
    machine: AnyMachine,
    postures: list[Vector],
    elbow: str | None,
    base: Any,
    control: Control,
    options: Mapping[str, Any],
) -> Vector:
    """Of a redundant arm's sampled postures the one with the greatest w_1, which is said; the first where none has."""
    from flexopt.robustness.batches import w_of_few  # noqa: PLC0415  (a posture that is given does not need it)

    measures = build_measures(machine, control, options["gravity"])
    placement = np.zeros(len(machine.base_coordinates)) if base is None else np.atleast_1d(base)
    first = w_of_few(measures, placement, np.array(postures).T)[0]
    if not VOICE.quiet:
        those = f" with the elbow {elbow} (--elbow names the other)" if elbow else ""
        told = f"of {len(postures)} postures found that reach it{those}, the one with the greatest w1 is taken"
        say(f"flexopt: --end-point: {told}; --posture names another, `flexopt select` seeks the best", err=True)
    return postures[int(np.argmax(np.where(np.isnan(first), -np.inf, first)))]
