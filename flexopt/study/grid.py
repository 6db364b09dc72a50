"""The postures behind the points of a map.

In: a machine, the range of the map and the number of points. Out: a `Grid` of postures with the axes' names and units.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from flexopt.model import Machine
from flexopt.model.arguments import Vector
from flexopt.model.problem import Elbow
from flexopt.plant import build_plant
from flexopt.plant.inverse_kinematics import ELBOW_SIGN, branch, inside_limits
from flexopt.plant.reach import reach

Over = Literal["end_point", "posture"]
Range = tuple[float, float]


@dataclass(frozen=True)
class Axis:
    """One axis of a map: its values (k,), name, unit and what it is."""

    name: str
    values: Vector
    unit: str
    long_name: str


@dataclass(frozen=True)
class Grid:
    """Postures on a grid of n_y rows and n_x columns.

    Attributes:
        y, x: the axes.
        posture: (n, n_y, n_x), rad; NaN where not reachable.
        reachable: (n_y, n_x): within reach and inside the joint limits.
    """

    y: Axis
    x: Axis
    posture: Vector
    reachable: NDArray[np.bool_]


def default_ranges(machine: Machine, over: Over) -> tuple[Range, Range]:
    """The square around all that the arm reaches, workspace frame, m; or the joint limits, a whole turn without."""
    if over == "posture":
        first, second = ((low, high) if math.isfinite(low) else (-math.pi, math.pi) for low, high in machine.limits[:2])
        return first, second
    outer = reach(build_plant(machine)).outer
    return (-outer, outer), (-outer, outer)


def end_point_grid(machine: Machine, x_range: Range, y_range: Range, points: tuple[int, int], elbow: Elbow) -> Grid:
    """Postures of a two-joint arm whose end-point at rest is on each point of the workspace frame.

    A row is one target seen from many placements: the posture depends on where the target is from the base alone.
    """
    plant = build_plant(machine)
    shoulder = plant.arm_segments(p=plant.parameter_values)["first_joint"].full().ravel()
    x, y = np.linspace(*x_range, points[0]), np.linspace(*y_range, points[1])
    posture, reachable = np.full((2, y.size, x.size), np.nan), np.zeros((y.size, x.size), dtype=bool)
    for row, height in enumerate(y):
        target = np.array([0.0, height]) + shoulder
        angles, reaches = branch(plant, target, -x[None, :], np.zeros((0, x.size)), ELBOW_SIGN[elbow])
        reachable[row] = reaches & inside_limits(machine, angles)
        posture[:, row, reachable[row]] = angles[:, reachable[row]]
    frame = "of the end-point at rest, workspace frame (origin at the first joint at rest)"
    return Grid(Axis("y", y, "m", f"y {frame}"), Axis("x", x, "m", f"x {frame}"), posture, reachable)


def posture_grid(machine: Machine, x_range: Range, y_range: Range, points: tuple[int, int], rest: Vector) -> Grid:
    """The first joint along x, the second along y, the others (n − 2,) fixed at `rest`, rad."""
    x, y = np.linspace(*x_range, points[0]), np.linspace(*y_range, points[1])
    first, second = np.meshgrid(x, y)
    fixed = np.broadcast_to(rest[:, None, None], (rest.size, *first.shape))
    posture = np.concatenate([first[None], second[None], fixed])
    reachable = inside_limits(machine, posture.reshape(posture.shape[0], -1)).reshape(first.shape)
    posture[:, ~reachable] = np.nan
    names = machine.joints
    return Grid(
        Axis("angle_2", y, "rad", f"angle of {names[1]}"),
        Axis("angle_1", x, "rad", f"angle of {names[0]}"),
        posture,
        reachable,
    )
