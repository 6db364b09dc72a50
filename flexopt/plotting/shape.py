"""A machine in one configuration as points, lines, capsules and what it stands on; and the planes it is seen in.

In: a machine, its coordinates and placement. Out: a `Shape`, the `View`s that show it, and outlines in a view.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flexopt.model import AnyMachine
from flexopt.plant import build_plant
from flexopt.robustness.evaluation import Evaluation

Points = NDArray[np.float64]
ARC = 16
# Below this share of the machine's size an arm has no main direction to be seen from the side.
UPRIGHT = 1e-3
# What is as near to a plane as this share of its coordinates, which is rounding, touches it.
TOUCHING = 1e-9


@dataclass(frozen=True)
class Shape:
    """Points in m, inertial frame; d = 2 in the plane, 3 in space.

    Attributes:
        skeleton: (d, K), as `Plant.skeleton`.
        segments: pairs of its columns that are joined, from the ground outwards.
        capsules: (start (d,), end (d,), radius) each.
        support: what it stands on: corners (d, s), or none.
    """

    skeleton: Points
    segments: tuple[tuple[int, int], ...]
    capsules: tuple[tuple[Points, Points, float], ...] = ()
    support: Points | None = None

    @property
    def size(self) -> float:
        """Length of all segments, m."""
        points = self.skeleton
        return float(sum(np.linalg.norm(points[:, j] - points[:, i]) for i, j in self.segments))


@dataclass(frozen=True)
class View:
    """A plane on which points are projected at right angles.

    Attributes:
        name: in words.
        axes: its directions, (2, d).
        labels: of these.
        upright: whether the second is the height.
        origin: a point that the plane passes through, (d,).
    """

    name: str
    axes: Points
    labels: tuple[str, str]
    upright: bool
    origin: Points

    def of(self, points: Points) -> Points:
        """Points (d, K) as (2, K), or one (d,) as (2,)."""
        seen: Points = self.axes @ points
        return seen

    def cuts(self, points: Points, radius: float = 0.0) -> bool:
        """Whether the plane passes through or touches the hull of points (d, K) with a radius; in the plane always."""
        if self.axes.shape[1] == 2:
            return True
        depth = np.cross(self.axes[0], self.axes[1]) @ (points - self.origin[:, None])
        reach = radius + TOUCHING * max(float(np.abs(points).max()), float(np.abs(self.origin).max()), radius)
        return bool(depth.min() <= reach and depth.max() >= -reach)


def machine_segments(machine: AnyMachine) -> tuple[tuple[int, int], ...]:
    """Columns of the skeleton that are joined."""
    return build_plant(machine).graph.segments


def shape_at(machine: AnyMachine, q: Points, base: Points) -> Shape:
    """A machine at the coordinates q (n_q,) and the placement (n_b,)."""
    plant = build_plant(machine)
    at = [q, base, plant.parameter_values]
    skeleton = plant.skeleton.call(at)[0].full()
    return Shape(skeleton, machine_segments(machine), _capsules(machine, q, base), _support(machine, skeleton, base))


def shape_of(machine: AnyMachine, evaluation: Evaluation) -> Shape:
    """A machine in the configuration of an evaluation, under its static deflection."""
    plant = build_plant(machine)
    q = plant.rest(evaluation.base, evaluation.posture, plant.parameter_values).full().ravel()
    q[: plant.n_passive] += evaluation.static_deflection
    return shape_at(machine, q, evaluation.base)


def _capsules(machine: AnyMachine, q: Points, base: Points) -> tuple[tuple[Points, Points, float], ...]:
    if not machine.capsules:
        return ()
    plant = build_plant(machine)
    origins, rotations = (x.full() for x in plant.body_frames.call([q, base, plant.parameter_values]))
    d, names = origins.shape[0], plant.frames.names
    placed: list[tuple[Points, Points, float]] = []
    for capsule in machine.capsules:
        k = names.index(capsule.body)
        turn = rotations[:, d * k : d * (k + 1)]
        ends = [origins[:, k] + turn @ np.array(point) for point in (capsule.start, capsule.end)]
        placed.append((ends[0], ends[1], capsule.radius))
    return tuple(placed)


def _support(machine: AnyMachine, skeleton: Points, base: Points) -> Points | None:
    """Corners of the support where the anchor frame stands; at the height of the anchor point."""
    if not machine.support_points:
        return None
    corners = np.array(machine.support_points, dtype=np.float64).T
    coordinates = dict(zip(machine.base_coordinates, base.tolist(), strict=True))
    place = np.array([coordinates.get(name, 0.0) for name in "xy"[: corners.shape[0]]])
    if corners.shape[0] == 2:
        yaw = coordinates.get("yaw", 0.0)
        corners = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]) @ corners
    height = np.full(corners.shape[1], skeleton[-1, 0])
    return np.vstack([corners + place[:, None], height])


def views(shape: Shape) -> tuple[View, ...]:
    """One view of a planar machine; of one in space from the side, across the arm's main direction, and from above."""
    if shape.skeleton.shape[0] == 2:
        return (View("", np.eye(2), ("x, m (inertial frame)", "y, m"), upright=True, origin=shape.skeleton[:, 0]),)
    along = shape.skeleton[:2, -1] - shape.skeleton[:2, 0]
    length = float(np.hypot(*along))
    along = along / length if length > UPRIGHT * shape.size else np.array([1.0, 0.0])
    yaw = math.degrees(math.atan2(along[1], along[0]))
    label = "x, m" if abs(yaw) < 0.05 else f"along the arm, from x by {yaw:.0f}°, m".replace("-", "−")
    origin = shape.skeleton[:, 0]
    side = np.array([[along[0], along[1], 0.0], [0.0, 0.0, 1.0]])
    return (
        View("from the side", side, (f"{label} (inertial frame)", "z, m"), upright=True, origin=origin),
        View("from above", np.eye(3)[:2], ("x, m (inertial frame)", "y, m"), upright=False, origin=origin),
    )


def bar(start: Points, end: Points, thick: float, thin: float) -> Points:
    """Outline (4, 2) of a bar that tapers from start to end; one without length is a point or line."""
    along = end - start
    across = np.array([-along[1], along[0]]) / (float(np.hypot(*along)) or 1.0)
    return np.array([start + thick * across, end + thin * across, end - thin * across, start - thick * across])


def capsule_outline(start: Points, end: Points, radius: float) -> Points:
    """Outline (k, 2) of a capsule seen at right angles: two half circles and what joins them."""
    along = end - start
    angle = math.atan2(along[1], along[0])
    half = np.linspace(-math.pi / 2, math.pi / 2, ARC)
    ends = [
        center + radius * np.column_stack([np.cos(angle + turn + half), np.sin(angle + turn + half)])
        for center, turn in ((end, 0.0), (start, math.pi))
    ]
    return np.vstack(ends)


def bars_of(shape: Shape, view: View) -> list[Points]:
    """Outlines (4, 2) of the segments that have a length, thinner from the ground outwards."""
    size, points = shape.size, shape.skeleton
    before = np.zeros(points.shape[1])
    for i, j in shape.segments:
        before[j] = before[i] + float(np.linalg.norm(points[:, j] - points[:, i]))
    farthest = float(before.max()) or 1.0
    outlines: list[Points] = []
    for i, j in shape.segments:
        if before[j] - before[i] > UPRIGHT * size:
            thick, thin = (size * (0.026 - 0.015 * float(before[k]) / farthest) for k in (i, j))
            start, end = view.of(points[:, [i, j]]).T
            outlines.append(bar(start, end, thick, thin))
    return outlines
