"""A machine in one configuration as points, lines, capsules and what it stands on; and the planes it is seen in.

In: a machine, its coordinates and placement. Out: a `Shape`, the `View`s that show it, and outlines in a view.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.model import AnyMachine
from flexopt.model.kinematic_tree import KinematicTree
from flexopt.plant import Plant, build_plant
from flexopt.robustness.evaluation import Evaluation
from flexopt.selection.constraints.ground import standing_height

Points = NDArray[np.float64]
# q, base, p of a configuration.
Inputs = Sequence[Any]
ARC = 16
# By how much of its thickness a link is deeper between its pins.
DEEPER = 0.45
# Share of the machine's size by which the first link is cut off at the ground.
LIFTED = 0.07
# So near to x, in degrees, a direction is that of x.
STRAIGHT = 0.05
# Of itself an arm seen end-on shows less than that; of the machine's size a steep one is level by less.
END_ON, STEEP = 0.5, 0.25
# Below this share of the machine's size an arm has no main direction to be seen from the side.
UPRIGHT = 1e-3
# Level part of a unit axis below which a hinge stands upright, and from which it lies level, but for what
# springs give; sine of the angle up to which two have one direction.
LEAST_LEVEL, LEVEL, ONE_WAY = 0.1, 0.99, 0.01


@dataclass(frozen=True)
class Shape:
    """Points in m, inertial frame; d = 2 in the plane, 3 in space.

    Attributes:
        skeleton: (d, K), as `Plant.skeleton`; the anchor point, and frames between the springs of what stands on them,
            lie where they are on this.
        segments: pairs of its columns that are joined, from the ground outwards.
        foot: the point of the ground below, or above, the anchor point, (d,).
        motion: (R, t), by which what stands on springs has moved since these were unloaded: from x to R x + t.
        capsules: (start (d,), end (d,), radius) each.
        support: what it stands on: corners (d, s), or none.
        base: the segments that no actuated joint moves.
        springs: whether these stand on springs; elastic: columns of the skeleton where a joint of the arm gives.
        across: the level direction (2,) that all level hinges of an arm in space have; None where they have no one.
    """

    skeleton: Points
    segments: tuple[tuple[int, int], ...]
    foot: Points
    motion: tuple[Points, Points]
    capsules: tuple[tuple[Points, Points, float], ...] = ()
    support: Points | None = None
    base: frozenset[tuple[int, int]] = frozenset()
    springs: bool = False
    elastic: tuple[int, ...] = ()
    across: Points | None = None

    def moved(self, points: Points) -> Points:
        """Points (d, K) of what stands on springs, from where they are with these unloaded."""
        turn, shift = self.motion
        return turn @ points + shift[:, None]

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

    def depth(self, points: Points) -> Points:
        """How far points (3, K) lie before the plane, (K,)."""
        away: Points = np.cross(self.axes[0], self.axes[1]) @ (points - self.origin[:, None])
        return away


def shape_at(machine: AnyMachine, q: Points, base: Points) -> Shape:
    """A machine at the coordinates q (n_q,) and the placement (n_b,)."""
    plant = build_plant(machine)
    tree, segments, standing = machine.kinematic_tree, plant.graph.segments, _standing(plant)
    at = [q, base, plant.parameter_values]
    unloaded = [plant.rest(base, q[plant.n_passive :], plant.parameter_values), *at[1:]]
    skeleton, stood = (plant.skeleton.call(x)[0].full() for x in (at, unloaded))
    motion = _motion(plant, standing, at, unloaded)
    fixed = _fixed(tree)
    gives = {i for i, body in enumerate(tree.bodies) if body.joint.passive and i not in tree.held}
    shape = Shape(
        skeleton,
        segments,
        np.append(stood[:-1, 0], standing_height(machine)),
        motion,
        _capsules(machine, q, base),
        _support(machine, base),
        base=frozenset((i, j) for i, j in segments if tree.drawn[i] is None or tree.drawn[i] in fixed),
        springs=not gives.isdisjoint(fixed),
        elastic=tuple(k for k, body in enumerate(tree.drawn) if body in gives - fixed),
        across=_across(plant, at) if len(skeleton) == 3 else None,
    )
    stands = [k for k, body in enumerate(tree.drawn) if body is None or body in standing]
    skeleton[:, stands] = shape.moved(stood[:, stands])
    return shape


def _across(plant: Plant, at: Inputs) -> Points | None:
    """See `Shape.across`; hinges that stand nearly upright, as slews, or roll what is beyond them, have no say."""
    tree, structure = plant.machine.kinematic_tree, plant.graph.at.skeleton
    origins, rotations = (each.full() for each in plant.body_frames.call(at)[:2])
    tip, found = plant.skeleton.call(at)[0].full()[:, -1], list[Points]()
    for i in structure.way_to(structure.tip):
        joint = tree.bodies[i].joint
        k = tree.frames.index(i)
        axis = rotations[:, 3 * k : 3 * k + 3] @ np.array(joint.axis)
        level = float(np.hypot(*axis[:2]))
        if joint.passive or joint.kind != "hinge" or level < LEAST_LEVEL:
            continue
        away = tip - origins[:, k]
        if np.linalg.norm(np.cross(axis, away)) <= END_ON * np.linalg.norm(away):
            continue
        if level < LEVEL:
            return None
        found.append(axis[:2] / level)
    alike = all(abs(float(each[0] * found[0][1] - each[1] * found[0][0])) < ONE_WAY for each in found)
    return found[0] if found and alike else None


def chain(skeleton: Points) -> Shape:
    """A planar machine of which no more is known than its skeleton: the first segment stands on springs."""
    segments = tuple((k, k + 1) for k in range(skeleton.shape[1] - 1))
    unmoved = np.eye(len(skeleton)), np.zeros(len(skeleton))
    return Shape(skeleton, segments, skeleton[:, 0], unmoved, base=frozenset(segments[:1]), springs=True)


def _standing(plant: Plant) -> list[int]:
    """Bodies between the ground and what stands on its springs, the first with a mass, which is the last of them."""
    tree, structure, found = plant.machine.kinematic_tree, plant.graph.at.skeleton, list[int]()
    for i in structure.way_to(structure.tip):
        if not tree.bodies[i].joint.passive or not all(tree.bodies[k].massless for k in found):
            break
        found.append(i)
    return found


def _motion(plant: Plant, standing: Sequence[int], at: Inputs, unloaded: Inputs) -> tuple[Points, Points]:
    """See `Shape.motion`."""
    d = len(plant.machine.kinematic_tree.axes)
    if not standing:
        return np.eye(d), np.zeros(d)
    k = plant.machine.kinematic_tree.frames.index(standing[-1])
    (here, turned), (there, straight) = (
        (origins.full()[:, k], rotations.full()[:, d * k : d * (k + 1)])
        for origins, rotations in (plant.body_frames.call(x) for x in (at, unloaded))
    )
    turn = turned @ straight.T
    return turn, here - turn @ there


def _fixed(tree: KinematicTree) -> set[int]:
    """Bodies that no actuated joint moves."""
    names = [body.name for body in tree.bodies]
    found = set[int]()
    for i, body in enumerate(tree.bodies):
        if body.joint.passive and (body.parent is None or names.index(body.parent) in found):
            found.add(i)
    return found


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


def _support(machine: AnyMachine, base: Points) -> Points | None:
    """Corners of the support where the anchor frame stands."""
    if not machine.support_points:
        return None
    corners = np.array(machine.support_points, dtype=np.float64).T
    coordinates = dict(zip(machine.base_coordinates, base.tolist(), strict=True))
    place = np.array([coordinates.get(name, 0.0) for name in "xy"[: corners.shape[0]]])
    if corners.shape[0] == 2:
        yaw = coordinates.get("yaw", 0.0)
        corners = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]) @ corners
    return np.vstack([corners + place[:, None], np.full(corners.shape[1], standing_height(machine))])


def views(shape: Shape, along: Points | None = None) -> tuple[View, ...]:
    """One view of a planar machine; of one in space from the side, across the arm's upright plane, and from above.

    That plane is square to its level hinges, where they all have one direction, and that is not along the links; else
    its links are nearest to it.
    `along`: another direction, (2,), level.
    """
    if shape.skeleton.shape[0] == 2:
        return (View("", np.eye(2), ("x, m (inertial frame)", "y, m"), upright=True, origin=shape.skeleton[:, 0]),)
    arm = _arm(shape)
    if along is None:
        along = _main_direction(arm[:2])
        if shape.across is not None:
            straight = np.array([shape.across[1], -shape.across[0]])
            # A level hinge along the arm, as one that rolls its tool, would have it seen end-on.
            level = float(np.hypot(*along))
            if level < STEEP * shape.size or abs(straight @ along) > END_ON * level:
                along = float(np.copysign(shape.size, straight @ along)) * straight
    length = float(np.hypot(*along))
    along = along / length if length > UPRIGHT * shape.size else np.array([1.0, 0.0])
    yaw = math.degrees(math.atan2(along[1], along[0]))
    if abs(yaw) > 180 - STRAIGHT:
        # x goes to the right, as seen from above.
        along, yaw = -along, 0.0
    label = "x, m" if abs(yaw) < STRAIGHT else f"along the arm, from x by {yaw:.0f}°, m".replace("-", "−")
    origin = arm[:, 0]
    side = np.array([[along[0], along[1], 0.0], [0.0, 0.0, 1.0]])
    return (
        View("from the side", side, (f"{label} (inertial frame)", "z, m"), upright=True, origin=origin),
        View("from above", np.eye(3)[:2], ("x, m (inertial frame)", "y, m"), upright=False, origin=origin),
    )


def _arm(shape: Shape) -> Points:
    """Points (d, k) from where the arm begins to the end-point."""
    parents = {j: i for i, j in shape.segments if (i, j) not in shape.base}
    columns = [shape.skeleton.shape[1] - 1]
    while columns[0] in parents:
        columns.insert(0, parents[columns[0]])
    return shape.skeleton[:, columns if len(columns) > 1 else [0, -1]]


def _main_direction(points: Points) -> Points:
    """The level direction (2,) that links between points (2, k) go along most, to the last of them, as long as they."""
    links = np.diff(points, axis=1)
    lengths = np.hypot(*links)
    weighted = links / np.sqrt(np.maximum(lengths, np.finfo(float).tiny))
    main = np.linalg.svd(weighted)[0][:, 0]
    return main * np.copysign(np.abs(main @ links).sum(), main @ links.sum(axis=1))


def link_outline(start: Points, end: Points, thick: float, thin: float) -> Points:
    """Outline (k, 2) of a link: round about both its pins, deepest before its middle as booms are."""
    along = end - start
    length = float(np.hypot(*along))
    angle = math.atan2(along[1], along[0])
    half = np.linspace(math.pi / 2, 3 * math.pi / 2, ARC)
    round_start = np.column_stack([np.cos(angle + half), np.sin(angle + half)]) * thick + start
    round_end = -np.column_stack([np.cos(angle + half), np.sin(angle + half)]) * thin + end
    if length <= thick:
        return np.vstack([round_start, round_end])
    across = np.array([-along[1], along[0]]) / length
    share = np.linspace(0.0, 1.0, ARC)[1:-1]
    wide = thick + (thin - thick) * share + DEEPER * thick * np.sin(math.pi * share**0.8)
    edge = start + share[:, None] * along
    lower, upper = edge - wide[:, None] * across, (edge + wide[:, None] * across)[::-1]
    return np.vstack([round_start, lower, round_end, upper])


def tool_outline(start: Points, end: Points, thick: float) -> Points:
    """Outline (k, 2) of the last link: round about its pin, from there to the point that does the work."""
    along = end - start
    across = np.array([-along[1], along[0]])
    size = float(np.hypot(*along)) or 1.0
    deep = min(2.2 * thick, 0.45 * size) / size
    half = np.linspace(math.pi / 2, 3 * math.pi / 2, ARC) + math.atan2(along[1], along[0])
    back = np.column_stack([np.cos(half), np.sin(half)]) * thick + start
    curve = [start + 0.35 * along - deep * across, start + 0.75 * along - 0.6 * deep * across, end]
    return np.vstack([back, curve, start + 0.55 * along + 0.25 * deep * across])


def spring_line(start: Points, end: Points, amplitude: float) -> Points:
    """A spring of four turns (n, 2)."""
    share = np.concatenate([[0.0], np.linspace(0.15, 0.85, 9), [1.0]])
    side = np.concatenate([[0.0, 0.0], np.tile([1.0, -1.0], 4)[:7], [0.0, 0.0]])
    along = end - start
    across = np.array([-along[1], along[0]]) / (float(np.hypot(*along)) or 1.0)
    return start + share[:, None] * along + amplitude * side[:, None] * across


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
    """Outlines (k, 2) of the segments that have a length, in their order, thinner from the ground outwards."""
    return [outline for _, outline in links_of(shape, view, 0.0)]


def links_of(shape: Shape, view: View, lifted: float = LIFTED) -> list[tuple[tuple[int, int], Points]]:
    """The segments that have a length, each with its outline in a view; the last of the arm ends in a point.

    The first is cut off at the ground by `lifted`, a share of the machine's size.
    """
    size, points = shape.size, shape.skeleton
    before = np.zeros(points.shape[1])
    for i, j in shape.segments:
        before[j] = before[i] + float(np.linalg.norm(points[:, j] - points[:, i]))
    farthest = float(before.max()) or 1.0
    tip, found = points.shape[1] - 1, list[tuple[tuple[int, int], Points]]()
    arm = [segment for segment in shape.segments if segment not in shape.base]
    for i, j in shape.segments:
        if before[j] - before[i] <= UPRIGHT * size:
            continue
        thick, thin = (size * (0.026 - 0.015 * float(before[k]) / farthest) for k in (i, j))
        start, end = view.of(points[:, [i, j]]).T
        if i == 0:
            # What stands on the ground begins above it, on the undercarriage.
            start = start + min(0.5, lifted * size / (before[j] - before[i])) * (end - start)
        tool = j == tip and len(arm) > 1
        found.append(((i, j), tool_outline(start, end, thick) if tool else link_outline(start, end, thick, thin)))
    return found
