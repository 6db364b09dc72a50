"""Maps: frequencies, measures, in-phase regions and ε_max over a workspace.

In: a machine and a range of end-points or joint angles. Out: a `WorkspaceMap` with an xarray.Dataset inside.
"""

from __future__ import annotations

import json
from typing import Any, cast

import numpy as np

from flexopt.errors import Fault
from flexopt.model import AnyMachine, Machine
from flexopt.model.arguments import Arguments, Vector, shown
from flexopt.model.documents import provenance
from flexopt.model.problem import ELBOWS, Control, Elbow, check_gain
from flexopt.model.quantities import ANGLE_MAX, COORDINATE_MAX, check_pair, range_sentence
from flexopt.study.grid import Grid, Over, Range, default_ranges, end_point_grid, posture_grid
from flexopt.study.points import Progress, evaluate_points
from flexopt.study.workspace_map import WorkspaceMap, workspace_dataset

OVER: tuple[Over, ...] = ("end_point", "posture")
POINTS_MAX = 10_000
THREADS_MAX = 1024


def map_workspace(
    machine: AnyMachine,
    *,
    control: Control = "inverse",
    gain: float = 5e5,
    gravity: bool = False,
    over: Over = "end_point",
    x_range: Any = None,
    y_range: Any = None,
    points: Any = (400, 400),
    elbow: Elbow = "up",
    posture: Any = None,
    measures: bool = True,
    epsilon_max: bool = True,
    threads: int | None = None,
    progress: Progress | None = None,
) -> WorkspaceMap:
    """Frequencies, w_i, in-phase regions and ε_max over a grid of end-points or of two joint angles.

    End-points are those of the arm at rest in the *workspace frame*: the inertial frame's axes, origin at the first
    joint at rest. Nothing in a map depends on the placement of the base, which stands at 0. Under gravity the springs
    give way beneath the posture that belongs to the point at rest.

    Args:
        machine: from `flexopt.load`.
        control: `"inverse"` or `"transpose"`.
        gain: servo gain kr of ε_max.
        gravity: measures under static deflection.
        over: `"end_point"` (two actuated joints) or `"posture"`: the first joint along x, the second along y.
        x_range, y_range: (low, high), m, workspace frame, by default the square around the arm's reach; or rad, by
            default the joint limits, a whole turn without.
        points: numbers of points (along x, along y).
        elbow: which posture reaches an end-point.
        posture: the joints from the third on, rad, when mapping over the posture of a longer arm.
        measures: include frequencies, w_i and in-phase regions.
        epsilon_max: include ε_max.
        threads: how many to compute with; all processors by default. The numbers do not depend on it.
        progress: called with the number of postures done and of all.

    Raises:
        InputError: every unusable argument, in one message.
    """
    arguments = Arguments("map_workspace")
    machine = arguments.planar(machine)
    control = arguments.control(control)
    kr = arguments.checked("gain", gain, check_gain, 1.0)
    for name, flag in (("gravity", gravity), ("measures", measures), ("epsilon_max", epsilon_max)):
        arguments.flag(name, flag)
    noted = len(arguments.faults)
    over = arguments.choice("over", over, OVER)
    is_over = len(arguments.faults) == noted
    elbow = arguments.choice("elbow", elbow, ELBOWS)
    size = arguments.checked("points", points, _check_points, (2, 2))
    workers = arguments.checked("threads", threads, _check_threads, None)
    rest = _other_joints(arguments, machine, over, posture) if is_over else np.zeros(0)
    ranges = _ranges(arguments, machine, over, x_range, y_range)
    arguments.done()
    if over == "end_point":
        grid = end_point_grid(machine, *ranges, size, elbow)
    else:
        grid = posture_grid(machine, *ranges, size, rest)
    options: dict[str, Any] = {"control": control, "gain": kr, "gravity": gravity, "over": over}
    options |= {"x_range": ranges[0], "y_range": ranges[1], "points": size}
    options |= {"elbow": elbow} if over == "end_point" else {"posture": rest.tolist()}
    return _computed(machine, grid, options, measures=measures, margins=epsilon_max, threads=workers, progress=progress)


def _computed(
    machine: Machine,
    grid: Grid,
    options: dict[str, Any],
    *,
    measures: bool,
    margins: bool,
    threads: int | None,
    progress: Progress | None,
) -> WorkspaceMap:
    where = grid.reachable
    values = evaluate_points(
        machine, grid.posture[:, where], control=options["control"], gain=options["gain"], gravity=options["gravity"],
        epsilon_max=margins, threads=threads, progress=progress,
    )  # fmt: skip
    dataset = workspace_dataset(grid, values, machine, measures=measures, margins=margins, control=options["control"])
    dataset.attrs |= _attributes(machine, options)
    return WorkspaceMap(machine.name, options, dataset, provenance(machine, **options))


def _attributes(machine: Machine, options: dict[str, Any]) -> dict[str, Any]:
    frame = "workspace: axes of the inertial frame, origin at the first joint at rest, base at 0"
    return {
        "title": f"{machine.name}: Jacobian {options['control']} control over its {options['over'].replace('_', '-')}",
        "machine": machine.name,
        "control": options["control"],
        "gain": options["gain"],
        "gravity": str(options["gravity"]).lower(),
        "over": options["over"],
        "elbow": options.get("elbow", ""),
        "frame": frame if options["over"] == "end_point" else "joint angles, relative, counter-clockwise positive",
        "provenance": json.dumps(provenance(machine, **options)),
    }


def _check_points(value: Any) -> tuple[int, int]:
    parts = list(cast(list[Any], value)) if isinstance(value, list | tuple) else []
    whole = [part for part in parts if type(part) is int and 2 <= part <= POINTS_MAX]
    if len(parts) != 2 or len(whole) != 2:
        raise ValueError(f"must be two whole numbers between 2 and {POINTS_MAX}: points along x and along y")
    return whole[0], whole[1]


def _check_threads(value: Any) -> int | None:
    if value is not None and (type(value) is not int or not 1 <= value <= THREADS_MAX):
        raise ValueError(f"must be a whole number between 1 and {THREADS_MAX}, or None for all processors")
    return value


def _ranges(arguments: Arguments, machine: Machine, over: Over, x_range: Any, y_range: Any) -> tuple[Range, Range]:
    if arguments.faults and over == "posture" and len(machine.joints) < 2:
        return (0.0, 1.0), (0.0, 1.0)
    x, y = default_ranges(machine, over)
    unit, most = ("m", COORDINATE_MAX) if over == "end_point" else ("rad", ANGLE_MAX)

    def check(value: Any) -> Range:
        try:
            return check_pair(value, unit, -most, most)
        except ValueError as error:
            raise ValueError(f"{error}; both ends {range_sentence(unit, None, -most, most)}") from None

    x = x if x_range is None else arguments.checked("x_range", x_range, check, x)
    return x, y if y_range is None else arguments.checked("y_range", y_range, check, y)


def _note(arguments: Arguments, field: str, sentence: str, value: Any) -> None:
    arguments.faults.append(Fault(field, sentence, shown(value)))


def _other_joints(arguments: Arguments, machine: Machine, over: Over, posture: Any) -> Vector:
    """Angles of the third joint and those after it."""
    names, nothing = machine.joints, np.zeros(0)
    if over == "end_point":
        if len(names) != 2:
            sentence = f"needs two actuated joints, not {len(names)} ({', '.join(names)}): an end-point does not name "
            _note(arguments, "over", sentence + "one posture; map over the posture", over)
        if posture is not None:
            _note(arguments, "posture", "goes with over = 'posture' only", posture)
        return nothing
    if len(names) < 2:
        _note(arguments, "over", f"needs two actuated joints, not {len(names)}", over)
        return nothing
    others = names[2:]
    if posture is None and not others:
        return nothing
    given = [] if posture is None else list(np.ravel(posture).tolist())
    if len(given) != len(others):
        sentence = f"needs {len(others)} angles in rad, for the joints that do not vary ({', '.join(others) or 'none'})"
        _note(arguments, "posture", sentence, posture)
        return np.zeros(len(others))
    low = [max(limits[0], -ANGLE_MAX) for limits in machine.limits[:2]]
    return arguments.posture(machine, [*low, *given])[2:]
