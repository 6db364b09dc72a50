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
from flexopt.plant.inverse_kinematics import ELBOW_SIGN, branch, inside_limits, low_discrepancy
from flexopt.plant.reach import arm_length, missed, outer_reach, reach, sampled_ranges
from flexopt.robustness.evaluation import in_words
from flexopt.study.maps.follow import Followed, MapPoints, follow

Over = Literal["end_point", "posture", "base"]
AxisPair = tuple[int, int]

# Postures from which the extent of a workspace is told.
SAMPLES = 4096


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
        reachable: (n_y, n_x): within reach and inside the joint limits.
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
    machine: AnyMachine, x_range: Interval, y_range: Interval, points: tuple[int, int], elbow: Elbow
) -> Grid:
    """Postures of a two-joint arm whose end-point at rest is on each point of the workspace frame.

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
    frame = "of the end-point at rest, workspace frame (origin at the first joint at rest)"
    across, up = machine.task_rows
    axes = Axis(up, y, "m", f"{up} {frame}"), Axis(across, x, "m", f"{across} {frame}")
    return Grid(*axes, posture, reachable, np.zeros((plant.n_base, y.size, x.size)))


def first_joint_at_rest(plant: Plant) -> Vector:
    """Origin (2,) of the workspace frame of an arm with a closed form, its base at 0, m."""
    return plant.arm_segments(p=plant.parameter_values)["first_joint"].full().ravel()


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
    end_point: Vector, base: Vector, reference: Vector, told: Callable[[int], None],
) -> Grid:  # fmt: skip
    """Postures followed over a plane of the task, or over the base with the end-point held.

    The rows, or coordinates, of the indices `varies` vary, the others are those of `end_point` and `base`.

    Raises:
        InputError: over the base, the end-point is reached from `base`, but from no placement of the grid.
        UnreachableTarget: from none of both.
    """
    plant, placed = build_plant(machine), over == "base"
    x, y = (np.linspace(*span, count) for span, count in zip(ranges, points, strict=True))
    target, bases = (np.tile(each[:, None, None], (1, y.size, x.size)) for each in (end_point, base))
    start = end_point if placed else end_point_at(plant, base, reference)
    varied, here = (bases, base) if placed else (target, start)
    varied[varies[0]], varied[varies[1]] = np.meshgrid(x, y)
    distance = np.hypot(*(varied[k] - here[k] for k in varies))
    found = follow(plant, MapPoints((start, base), target, bases, distance), reference, told)
    if placed:
        _expect_reached(plant, end_point, base, found, (x, y), varies)
    names, units = (machine.base_coordinates, machine.base_units) if placed else (machine.task_rows, ("m",) * 6)
    what = "of the placement" if placed else "of the end-point at rest, inertial frame"
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


def end_point_at(plant: Plant, base: Vector, posture: Vector) -> Vector:
    """The end-point r (n_task,) at rest, m."""
    p = plant.parameter_values
    return plant.end_point(plant.rest(base, posture, p), base, p).full().ravel()
