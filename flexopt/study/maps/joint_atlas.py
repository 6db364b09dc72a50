"""The atlas: every posture of a machine in which a measure w_i is zero, over two of its joints.

In: a machine, two of its joints and where the others are held. Out: an `Atlas`: curves, the points where two of them
meet and those where they end, the edges of the workspace, singular postures.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np

from flexopt.errors import Fault
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import BaseLike, PointsLike, PostureLike, RangeLike
from flexopt.foundation.boundary import anything, public
from flexopt.foundation.control import Control
from flexopt.foundation.plain import counted, shown
from flexopt.foundation.turns import available_cores
from flexopt.model import AnyMachine
from flexopt.model.loop import control_of
from flexopt.robustness.atlas import ROWS, Atlas, Rectangle, Slice, survey
from flexopt.robustness.plausibility import warn_implausible
from flexopt.study.maps.planes import Plane, read_plane, two_counts

CELLS = 128, 128
CELLS_MIN, CELLS_MAX = 8, 2000


def _together(arguments: Arguments, given: Mapping[str, Any]) -> None:
    if arguments.of is not None:
        _read(arguments, arguments.of, given)


def _read(arguments: Arguments, machine: AnyMachine, given: Mapping[str, Any]) -> tuple[Plane, Rectangle]:
    """What varies and where, with all faults noted."""
    rows = machine.task_rows
    if len(rows) not in ROWS:
        has = f"has a task of {counted(len(rows), 'row')} ({', '.join(rows)})"
        sentence = f"{has}; over two joints w_i = 0 is curves where it has two, points where it has three"
        arguments.note("machine", sentence, machine.name)
    names = ("joints", "posture", "base", "x_range", "y_range")
    # Over postures, which are given, the weight moves nothing that varies.
    passed: dict[str, Any] = dict.fromkeys(("rows", "coordinates", "end_point")) | {name: given[name] for name in names}
    passed["gravity"] = False
    plane = read_plane(arguments, machine, "posture", passed)
    # What varies is no argument here.
    machine_name = shown(machine.name)
    faults = [Fault("machine", f.sentence, machine_name) if f.field == "over" else f for f in arguments.faults]
    arguments.faults = faults
    low, high = np.array(plane.ranges).T
    rectangle = Rectangle(low, high, (False, False))
    if max(plane.varies) >= len(machine.joints):
        return plane, rectangle
    closes: list[bool] = []
    for axis, (name, k) in enumerate(zip(("x_range", "y_range"), plane.varies, strict=True)):
        limits, unit = machine.limits[k], machine.joint_units[k]
        free = unit == "rad" and not np.any(np.isfinite(limits))
        closes.append(free and given[name] is None)
        inside = max(low[axis], limits[0]), min(high[axis], limits[1])
        if given[name] is None:
            # What it is where other faults stand does not matter.
            continue
        if inside[0] >= inside[1]:
            sentence = f"is outside the limits of {machine.joints[k]}, {limits[0]:g} to {limits[1]:g} {unit}"
            arguments.note(name, sentence, given[name])
        elif free and high[axis] - low[axis] > 2 * math.pi:
            arguments.note(name, f"is more than a turn of {machine.joints[k]}, 2π rad", given[name])
        low[axis], high[axis] = inside
    return plane, replace(rectangle, periodic=(closes[0], closes[1]))


@public(
    joints=anything,  # these are `read_plane`'s: what they may be depends on the machine
    posture=anything,
    base=anything,
    x_range=anything,
    y_range=anything,
    cells=two_counts("cells", CELLS_MIN, CELLS_MAX),
    together=_together,
)
def atlas(
    machine: AnyMachine,
    *,
    control: Control | None = None,
    gravity: bool = False,
    joints: Sequence[str] | None = None,
    posture: PostureLike | None = None,
    base: BaseLike | None = None,
    x_range: RangeLike | None = None,
    y_range: RangeLike | None = None,
    cells: PointsLike = CELLS,
    threads: int | None = None,
) -> Atlas:
    """All robust postures at a glance: the curves w_i = 0 over two joints, and where two of them meet.

    w_i = a_i·b_i − |a_i||b_i| is 0 where a_i × b_i = 0 and a_i·b_i ≥ 0, with two task rows a curve. Curves are found on
    a grid, where a_i × b_i changes its sign, and followed by predictor and corrector with exact slopes, so that they
    close, part and end as they do in truth. They end at joint limits; at singular postures under inverse control;
    where a_i or b_i is 0, beyond which a_i and b_i are opposed and w_i = −2|a_i||b_i|; where two frequencies meet; and
    under gravity where nothing holds the machine any more. On a telescope whose mass lies on its line through the
    end-point the modes move the end-point across that line alone: there a_i, and with it w_i, is 0 along whole curves
    (`RobustCurve.vanishing`), beside which a_i and b_i are opposed on one side. A loop that lies between the
    lines of the grid is found where a_i × b_i has an extremum near a node that is small; else it may be missed:
    `Atlas.resolution` says how small loops can be told.

    With three task rows a_i × b_i = 0 is two equations: robust postures over two joints are points, found where two
    components of a_i × b_i are zero together; in a plane of symmetry of the machine they are curves again, or regions.

    Args:
        machine: from `flexopt.load`, with a task of two or three rows.
        control: `"inverse"`, `"transpose"` or `"damped:LAMBDA"`; by default that of the machine's loop.
        gravity: measures under static deflection.
        joints: names of the two that vary, along x and y; the first two by default.
        posture: the joints that do not vary, in order, rad or m.
        base: placement (n_b,), m or rad; 0 by default. It moves the end-points; no measure of positions depends on it.
        x_range, y_range: (low, high) of the two, rad or m; their limits, or without a whole turn or the arm's length
            either way. Hinges without limits turn all round: curves go on across the ends of the turn.
        cells: of the grid, along x and y.
        threads: how many to compute with; all processors by default. The numbers do not depend on it.

    Raises:
        InputError: every unusable argument, in one message; a task of other than two or three rows.

    Source:
        Article, eqs. (3)–(7); continuation after Allgower and Georg, Introduction to Numerical Continuation Methods
        (SIAM, 2003), chapters 2 and 15.

    Example:
        >>> machine = flexopt.load("excavator")
        >>> found = flexopt.atlas(machine, x_range=(0.5, 1.5), y_range=(-2.5, -1.0), cells=(16, 16))
        >>> len(found.curves) > 0
        True
    """
    given = {"joints": joints, "posture": posture, "base": base, "x_range": x_range, "y_range": y_range}
    plane, rectangle = _read(Arguments("atlas", machine), machine, given)
    warn_implausible(machine)
    count, size = available_cores() if threads is None else threads, cast(tuple[int, int], cells)
    chosen = control_of(control, None, machine)
    return survey(Slice(machine, chosen, gravity, plane.varies, plane.posture, plane.base, count), rectangle, size)
