"""The postures and placements behind the points of a map.

In: a machine, the range of the map and the number of points. Out: a `Grid` with the axes' names and units.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from flexopt.errors import Fault, InputError, UnreachableTarget, raise_if_any
from flexopt.foundation.arrays import Interval, Vector
from flexopt.model import AnyMachine
from flexopt.model.choices import Elbow
from flexopt.plant import Plant, build_plant
from flexopt.plant.inverse_kinematics import ELBOW_SIGN, branch, inside_limits, into_limits, low_discrepancy
from flexopt.plant.reach import arm_length, missed, outer_reach, reach, sampled_ranges
from flexopt.plant.statics import check_held, check_settled, not_held
from flexopt.robustness.evaluation import in_words
from flexopt.study.maps.follow import Followed, MapPoints, Solver, follow

Over = Literal["end_point", "posture", "base"]
AxisPair = tuple[int, int]

# Postures from which the extent of a workspace is told.
SAMPLES = 4096
# Rounds in which a target is lifted to by what the posture for it sags, before steps under the weight begin.
LIFTS = 10


@dataclass(frozen=True)
class Axis:
    """One axis of a map: its values (k,), name, unit and what it is."""

    name: str
    values: Vector
    unit: str
    long_name: str


@dataclass(frozen=True)
class Grid:
    """Postures and placements on a grid of n_y rows and n_x columns.

    Attributes:
        y, x: the axes.
        posture: (n, n_y, n_x), rad or m; NaN where not reachable.
        reachable: (n_y, n_x): within reach and inside the joint limits, under gravity also held by the springs.
        base: (n_b, n_y, n_x), m or rad.
    """

    y: Axis
    x: Axis
    posture: Vector
    reachable: NDArray[np.bool_]
    base: Vector


def closed_form(machine: AnyMachine) -> bool:
    """Whether an end-point and an elbow name one posture: a planar arm of two joints."""
    return build_plant(machine).closed_form and len(machine.joints) == 2


def joint_ranges(machine: AnyMachine) -> list[Interval]:
    """The joint limits; a missing end is a whole turn from the other one, of a slide twice the arm's length."""
    ends = sampled_ranges(machine, arm_length(build_plant(machine)))
    return [(float(low), float(high)) for low, high in ends]


def reach_ranges(machine: AnyMachine) -> tuple[Interval, Interval]:
    """The square around all that a planar arm reaches, workspace frame, m."""
    outer = reach(build_plant(machine)).outer
    return (-outer, outer), (-outer, outer)


def task_ranges(plant: Plant, base: Vector) -> list[Interval]:
    """What each task row takes over the joint ranges, m: a sample's extremes, climbed to where they end."""
    from scipy.optimize import minimize  # noqa: PLC0415  (loads slowly)

    q, bases, p = _sample(plant, base)
    r = plant.end_point.call([q, bases, p])[0].full()

    def end(row: int, sign: float) -> float:
        def seen(posture: Vector) -> tuple[float, Vector]:
            at = [plant.rest(base, posture, p[:, 0]), base, p[:, 0]]
            slope = plant.rigid_jacobian.call(at)[0].full()[row]
            return sign * float(plant.end_point.call(at)[0].full()[row, 0]), sign * slope

        start = q[plant.n_passive :, int(np.argmin(sign * r[row]))]
        return sign * float(minimize(seen, start, jac=True, method="L-BFGS-B", bounds=joint_ranges(plant.machine)).fun)

    return [(end(row, 1.0), end(row, -1.0)) for row in range(plant.n_task)]


def placement_ranges(plant: Plant, end_point: Vector, base: Vector, varies: AxisPair) -> list[Interval]:
    """Placements around those from which an end-point may be reached, where the indices `varies` vary.

    Not turned, as far from it as the arm reaches either way; turned, or along no row of the task, as far as it is long;
    a whole turn.
    """
    machine = plant.machine
    names, rows = machine.base_coordinates, machine.task_rows
    center, radius = outer_reach(plant)
    radius += float(np.linalg.norm(center[:2]))
    reached = {} if "yaw" in (names[k] for k in varies) else dict(zip(rows, task_ranges(plant, base), strict=True))
    ranges: list[Interval] = []
    for name, place in zip(names, base.tolist(), strict=True):
        middle = float(end_point[rows.index(name)]) if name in rows else place
        low, high = reached.get(name, (place - radius, place + radius))
        ranges.append((-math.pi, math.pi) if name == "yaw" else (middle + place - high, middle + place - low))
    return ranges


def _sample(plant: Plant, base: Vector) -> list[Vector]:
    """Configurations (n_q, SAMPLES) at rest that fill the joint ranges, their placements and parameters."""
    low, high = np.array(joint_ranges(plant.machine)).T[:, :, None]
    posture = low + (high - low) * low_discrepancy(plant.n_actuated, SAMPLES, 0)
    bases = np.repeat(base[:, None], SAMPLES, axis=1)
    p = np.repeat(plant.parameter_values.full(), SAMPLES, axis=1)
    return [plant.rest.call([bases, posture, p])[0].full(), bases, p]


def end_point_grid(
    machine: AnyMachine,
    x_range: Interval,
    y_range: Interval,
    points: tuple[int, int],
    elbow: Elbow,
    *,
    gravity: bool = False,
) -> Grid:
    """Postures of a two-joint arm whose end-point, at rest or as it sags, is on each point of the workspace frame.

    A row is one target seen from many placements: the posture depends on where the target is from the base alone.
    """
    plant = build_plant(machine)
    shoulder = first_joint_at_rest(plant)
    x, y = np.linspace(*x_range, points[0]), np.linspace(*y_range, points[1])
    posture, reachable = np.full((2, y.size, x.size), np.nan), np.zeros((y.size, x.size), dtype=bool)
    for row, height in enumerate(y):
        target = np.array([0.0, height]) + shoulder
        angles, reaches = branch(plant, target, -x[None, :], np.zeros((0, x.size)), ELBOW_SIGN[elbow])
        reachable[row] = reaches & inside_limits(machine, angles)
        posture[:, row, reachable[row]] = angles[:, reachable[row]]
    if gravity:
        targets = np.stack(np.meshgrid(x, y)).reshape(2, -1) + shoulder[:, None]
        angles, reaches = _as_it_sags(plant, targets, elbow)
        reachable = reaches.reshape(reachable.shape)
        posture = np.where(reachable, angles.reshape(posture.shape), np.nan)
    frame = f"{_of_end_point(gravity)}, workspace frame (origin at the first joint at rest)"
    across, up = machine.task_rows
    axes = Axis(up, y, "m", f"{up} {frame}"), Axis(across, x, "m", f"{across} {frame}")
    return Grid(*axes, posture, reachable, np.zeros((plant.n_base, y.size, x.size)))


def _as_it_sags(plant: Plant, targets: Vector, elbow: Elbow) -> tuple[Vector, NDArray[np.bool_]]:
    """Postures (2, N) with which a two-joint arm, its base at 0, sags onto targets (2, N), and of which there are such.

    The closed form leads to a target that is lifted by what the arm sags, where one beyond its reach has it straight;
    from there Newton's method, which leaves joint limits aside until it ends: an elbow has one posture for a target.
    """
    count, sign, free = targets.shape[1], ELBOW_SIGN[elbow], np.zeros((0, targets.shape[1]))
    at, p = np.zeros((plant.n_base, count)), plant.parameter_values
    bent = np.array([np.hypot(*plant.arm_segments(p=p)["lengths"].full().ravel()), 0.0]) + first_joint_at_rest(plant)
    solver = Solver(plant, branch(plant, bent, at[:, :1], free[:, :1], sign)[0].ravel(), gravity=True, limited=False)
    start, reaches = branch(plant, targets, at, free, sign)
    lift = np.zeros_like(targets)
    for share in (1.0, *[0.5] * LIFTS):
        at_rest = plant.end_point.call([plant.rest.call([at, start, p])[0], at, p])[0].full()
        sag = np.nan_to_num(at_rest - solver.end_point(at, start), posinf=0.0, neginf=0.0)
        # Half of it, for soft springs would have whole steps go to and fro.
        lift += share * (sag - lift)
        start, reaches = branch(plant, targets + lift, at, free, sign)
    found, held, _ = solver.solve(targets[:, reaches], at[:, reaches], start[:, reaches])
    angles = into_limits(plant.machine, found)
    start[:, reaches], reaches[reaches] = angles, held & inside_limits(plant.machine, angles)
    return start, reaches


def _of_end_point(gravity: bool) -> str:
    return "of the sagged end-point" if gravity else "of the end-point at rest"


def first_joint_at_rest(plant: Plant, base: Vector | None = None) -> Vector:
    """Origin (2,) of the workspace frame of an arm with a closed form, by default with its base at 0, m."""
    placed = np.zeros(plant.n_base) if base is None else base
    return plant.arm_segments(base=placed, p=plant.parameter_values)["first_joint"].full().ravel()


def posture_grid(
    machine: AnyMachine, x_range: Interval, y_range: Interval, points: tuple[int, int], joints: AxisPair, rest: Vector,
    base: Vector,
) -> Grid:  # fmt: skip
    """The joints of the indices `joints` along x and y, the others (n − 2,), in order, fixed at `rest`, rad or m."""
    x, y = np.linspace(*x_range, points[0]), np.linspace(*y_range, points[1])
    posture = np.empty((len(machine.joints), y.size, x.size))
    posture[[k for k in range(len(posture)) if k not in joints]] = rest[:, None, None]
    posture[joints[0]], posture[joints[1]] = np.meshgrid(x, y)
    reachable = inside_limits(machine, posture.reshape(posture.shape[0], -1)).reshape(posture.shape[1:])
    posture[:, ~reachable] = np.nan
    column, row = (_joint_axis(machine, k, values) for k, values in zip(joints, (x, y), strict=True))
    return Grid(row, column, posture, reachable, np.broadcast_to(base[:, None, None], (base.size, y.size, x.size)))


def _joint_axis(machine: AnyMachine, k: int, values: Vector) -> Axis:
    word, what = ("angle", "angle") if machine.joint_units[k] == "rad" else ("slide", "position")
    return Axis(f"{word}_{k + 1}", values, machine.joint_units[k], f"{what} of {machine.joints[k]}")


def followed_grid(
    machine: AnyMachine, over: Over, ranges: Sequence[Interval], points: tuple[int, int], varies: AxisPair,
    end_point: Vector, base: Vector, reference: Vector, told: Callable[[int], None], *, gravity: bool,
) -> Grid:  # fmt: skip
    """Postures followed over a plane of the task, or over the base with the end-point held, at rest or as it sags.

    The rows, or coordinates, of the indices `varies` vary, the others are those of `end_point` and `base`.

    Raises:
        InputError: over the base, the end-point is reached from `base`, but from no placement of the grid; under
            gravity the springs do not hold the machine where following starts.
        UnreachableTarget: from none of both.
    """
    plant, placed = build_plant(machine), over == "base"
    x, y = (np.linspace(*span, count) for span, count in zip(ranges, points, strict=True))
    target, bases = (np.tile(each[:, None, None], (1, y.size, x.size)) for each in (end_point, base))
    start = end_point if placed else end_point_at(plant, base, reference, gravity=gravity)
    varied, here = (bases, base) if placed else (target, start)
    varied[varies[0]], varied[varies[1]] = np.meshgrid(x, y)
    distance = np.hypot(*(varied[k] - here[k] for k in varies))
    found = follow(plant, MapPoints((start, base), target, bases, distance), reference, told, gravity=gravity)
    if placed:
        _expect_reached(plant, end_point, base, found, (x, y), varies)
    names, units = (machine.base_coordinates, machine.base_units) if placed else (machine.task_rows, ("m",) * 6)
    what = "of the placement" if placed else f"{_of_end_point(gravity)}, inertial frame"
    column, row = (
        Axis(f"base_{names[k]}" if placed else names[k], values, units[k], f"{names[k]} {what}")
        for k, values in zip(varies, (x, y), strict=True)
    )
    return Grid(row, column, found.posture, found.reached, bases)


def _expect_reached(
    plant: Plant, end_point: Vector, base: Vector, found: Followed, axes: tuple[Vector, Vector], varies: AxisPair
) -> None:
    """Say what to do where no placement of the grid reaches the end-point."""
    if found.reached.any():
        return
    if not np.isfinite(found.miss):
        raise not_held()
    if not found.start_reached:
        off = missed(plant, end_point, base, found.miss)
        sentence = "nor is it reached from any point of the map: ask for another end-point, or for other ranges"
        raise UnreachableTarget(f"{off}; {sentence}", miss=off.miss)
    names, units = plant.machine.base_coordinates, plant.machine.base_units
    apart = " and ".join(
        f"{(values[-1] - values[0]) / (values.size - 1):.3g} {units[k]} along {names[k]}"
        for k, values in zip(varies, axes, strict=True)
    )
    sentence = (
        f"from none of these placements, {apart} apart, is the end-point reached, though it is with the base at "
        f"{in_words(names, base, units)}: ask for more points, or for ranges closer about it"
    )
    number = ", ".join(str(values.size) for values in axes)
    raise_if_any(InputError, "map_workspace", [Fault("points", sentence, f"({number})")])


def end_point_at(plant: Plant, base: Vector, posture: Vector, *, gravity: bool) -> Vector:
    """The end-point r (n_task,) at rest, or under gravity as the machine sags, m.

    Raises:
        InputError, NoSolutionFound: under gravity, the springs do not hold the machine.
    """
    p = plant.parameter_values
    q = plant.rest(base, posture, p).full().ravel()
    if gravity:
        q[: plant.n_passive] = plant.deflected(base, posture, p).full().ravel()
        check_settled(plant, q, base)
        check_held(plant, q, base)
    return plant.end_point.call([q, base, p])[0].full().ravel()
