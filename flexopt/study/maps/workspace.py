"""Maps: frequencies, measures, in-phase regions and ε_max over a workspace.

In: a machine and a range of end-points or joint angles. Out: a `WorkspaceMap` with an xarray.Dataset inside.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import BaseLike, PointsLike, PostureLike, Progress, RangeLike, TargetLike, Vector
from flexopt.foundation.boundary import anything, flag, public, words
from flexopt.foundation.control import Control, gain_units
from flexopt.loop.evaluation import settings_at
from flexopt.loop.many import Decays, decays, expect_decays
from flexopt.loop.settings import LoopSettings
from flexopt.model import AnyMachine
from flexopt.model.choices import Elbow
from flexopt.model.loop import Loop, LoopLike, control_of
from flexopt.plant import build_plant
from flexopt.study.maps.grid import Over
from flexopt.study.maps.planes import read_plane, two_counts
from flexopt.study.maps.points import evaluate_points, expect_points
from flexopt.study.maps.workspace_map import WorkspaceMap, finished_map, import_xarray, workspace_dataset

OVER: tuple[Over, ...] = ("end_point", "posture", "base")
POINTS_MAX = 10_000
# Points by default, and of machines with more passive coordinates than the number between: each costs far more there.
POINTS, FEW_POINTS = (400, 400), (60, 60)
# Task rows of a machine in the plane, and passive coordinates: of more of either a map takes long.
IN_PLANE, MANY_PASSIVE = 2, 3
TWO_POINTS = two_counts("points", 2, POINTS_MAX)


def _together(arguments: Arguments, given: Mapping[str, Any]) -> None:
    if arguments.of is not None:
        read_plane(arguments, arguments.of, given["over"], dict(given))


@public(
    over=words(*OVER),
    joints=anything,  # these are `read_plane`'s: what they may be depends on what varies
    rows=anything,
    coordinates=anything,
    posture=anything,
    end_point=anything,
    base=anything,
    x_range=anything,
    y_range=anything,
    points=TWO_POINTS,
    measures=flag,
    epsilon_max=flag,
    together=_together,
)
def map_workspace(
    machine: AnyMachine,
    *,
    control: Control | None = None,
    gain: float = 5e5,
    gravity: bool = False,
    over: Over = "end_point",
    joints: Sequence[str] | None = None,
    rows: Sequence[str] | None = None,
    coordinates: Sequence[str] | None = None,
    posture: PostureLike | None = None,
    end_point: TargetLike | None = None,
    base: BaseLike | None = None,
    x_range: RangeLike | None = None,
    y_range: RangeLike | None = None,
    points: PointsLike | None = None,
    elbow: Elbow = "up",
    measures: bool = True,
    epsilon_max: bool = True,
    loop: LoopLike | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> WorkspaceMap:
    """Frequencies, w_i, in-phase regions, ε_max and the loop's decay over a plane of end-points, joints or placements.

    Over `"end_point"` an arm of two parallel hinges is mapped in closed form: end-points are in the *workspace frame*,
    the inertial frame's axes with the origin at the first joint at rest; nothing depends on the placement, which is 0.
    Any other machine needs a `posture` to start from, and these may have one: two task rows then vary, in the inertial
    frame, and the posture is followed from point to point: within the branch of `posture`, and of a redundant arm the
    one nearest to it. Over `"posture"` two joints vary. Over `"base"` two placement coordinates vary while the
    end-point is held, the posture followed likewise: the map tells where to stand. Under gravity all end-points, varied
    or held, are those of the machine as it sags, and a point is reached where the springs hold it.

    Args:
        machine: from `flexopt.load`.
        control: `"inverse"`, `"transpose"` or `"damped:LAMBDA"`; by default that of `loop`, else of the machine's loop.
        gain: servo gain kr of ε_max.
        gravity: measures and end-points under static deflection.
        over: `"end_point"`, `"posture"` or `"base"`: what varies, the first along x, the second along y.
        joints, rows, coordinates: names of the two that vary over the posture, the end-point, the base; the first two
            by default.
        posture: over the posture the joints that do not vary, in order, rad or m; else the one to start from, (n,).
        end_point: (n_task,), m, inertial frame: where it is held over the base; of the rows that do not vary over the
            end-point. By default where `posture` has it.
        base: placement (n_b,), m or rad: of the coordinates that do not vary, and where following starts; 0 by default.
        x_range, y_range: (low, high), in the axis' unit. By default the square around the arm's reach (closed form);
            what the task rows take over all postures at rest; the joint limits, or without a whole turn or 1 m either
            way; as far from the end-point as the arm reaches (where the base turns, or along no row of the task, as it
            is long), or a whole turn.
        points: numbers of points (along x, along y); (400, 400), of machines in space, and with more than three
            passive coordinates, (60, 60).
        elbow: which posture reaches an end-point, in closed form.
        measures: include frequencies, w_i and in-phase regions.
        epsilon_max: include ε_max.
        loop: include how fast the sampled loop of this controller decays (`decay`, 1/s, and `loop_frequency_hz`), as of
            `flexopt.evaluate`. What it leaves out follows from the machine at one point in the middle of the map, and
            is the same everywhere.
        threads: how many to compute with; all processors by default. The numbers do not depend on it.
        progress: called with the number of postures done and of all; where they are followed each counts twice.

    Raises:
        InputError: every unusable argument, in one message; over the base, so few points that the end-point is reached
            from `base` and from none of them; under gravity, the springs do not hold the machine in `posture`.
        UnreachableTarget: over the base, the end-point is reached from `base` no more than from any point.

    Example:
        >>> machine = flexopt.load("excavator")
        >>> chart = flexopt.map_workspace(machine, points=(8, 8), epsilon_max=False)
        >>> chart.array("w").shape  # mode, y, x
        (3, 8, 8)
    """
    usual = FEW_POINTS if takes_long(machine) else POINTS
    size = usual if points is None else cast(tuple[int, int], points)
    given = {"joints": joints, "rows": rows, "coordinates": coordinates, "posture": posture, "end_point": end_point}
    given |= {"base": base, "x_range": x_range, "y_range": y_range, "gravity": gravity}
    plane = read_plane(Arguments("map_workspace", machine), machine, over, given)
    own = cast("Loop | None", loop)
    control = control_of(control, own, machine)
    options: dict[str, Any] = {"control": control, "gain": gain, "gravity": gravity, "over": over}
    options |= {"x_range": plane.ranges[0], "y_range": plane.ranges[1], "points": size} | plane.options(elbow)
    if own is not None and own.control not in (None, control):
        fault = Fault("loop.control", f"is not the control of the map, {control}", repr(own.control))
        raise_if_any(InputError, "map_workspace", [fault])
    # Compilers are at work while xarray is imported and postures are followed.
    expect_points(size[0] * size[1], machine, control=control, gravity=gravity, epsilon_max=epsilon_max)
    import_xarray()
    # Postures that are followed count twice: there, and where they are computed.
    ahead = size[0] * size[1] if plane.followed else 0
    grid = plane.grid(machine, size, elbow, lambda done: None if progress is None else progress(done, 2 * ahead))
    where = grid.reachable
    values = evaluate_points(
        machine, grid.posture[:, where], bases=grid.base[:, where], control=control, gain=gain, gravity=gravity,
        epsilon_max=epsilon_max, threads=threads,
        progress=None if progress is None else lambda done, count: progress(ahead + done, ahead + count),
    )  # fmt: skip
    found, real = None, dict[str, str]()
    regular = np.isfinite(values.rigid)
    if own is not None and regular.any():
        bases, postures = grid.base[:, where][:, regular], grid.posture[:, where][:, regular]
        settings = _settings(machine, own, bases, postures, control=control, gravity=gravity)
        options["loop"] = settings.to_dict()
        real = {"loop": repr(settings).splitlines()[0]}
        found = Decays(*np.full((2, regular.size), np.nan))
        there = decays(machine, settings, {"base": bases, "posture": postures}, gravity=gravity, threads=threads)
        found.decay[regular], found.frequency_hz[regular] = there
    dataset = workspace_dataset(
        grid, values, machine, measures=measures, margins=epsilon_max, control=control, loop=found
    )
    what = {"end_point": "end-point", "posture": "posture", "base": "placement"}[plane.over]
    title = f"{machine.name}: Jacobian {control} control over its {what}"
    told = {"gain": gain, "gain_unit": gain_units(control, machine.joint_units)[0]}
    told |= {"elbow": options.get("elbow", "")}
    return finished_map(machine, options, dataset, title, plane.frame, plane.marks, told | real)


def _settings(
    machine: AnyMachine, loop: Loop, bases: Vector, postures: Vector, *, control: Control, gravity: bool
) -> LoopSettings:
    """The loop's numbers at the point whose posture is nearest to the middle one."""
    middle = np.median(postures, axis=1, keepdims=True)
    k = int(np.abs(postures - middle).max(axis=0).argmin())
    at = postures[:, k], bases[:, k]
    settings, _ = settings_at(machine, *at, control, loop, gravity=gravity, call="map_workspace")
    expect_decays(postures.shape[1], machine, settings, gravity=gravity)
    return settings


def takes_long(machine: AnyMachine) -> bool:
    """Whether a point of a map takes so long that fewer are computed where nobody says how many."""
    plant = build_plant(machine)
    return plant.n_passive > MANY_PASSIVE or plant.n_task > IN_PLANE
