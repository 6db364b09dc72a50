"""Clearance of the machine's capsules from the ground, half-planes, spheres and boxes.

A row for each capsule and obstacle: the signed distance of their surfaces, m, exact, negative by the depth where they
meet. From the ground and from half-planes each end of a capsule has a row of its own, which is smooth; from a box a
capsule has two, which are where it lies along a face. Bodies that no actuated joint moves stand on the ground and keep
no distance from it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, cast

import casadi as ca

from flexopt.errors import Fault
from flexopt.foundation.nearest import hint
from flexopt.model.constraints import Box, Clearance, Constraints, Obstacle, Sphere
from flexopt.model.tables import Capsule
from flexopt.plant import Plant
from flexopt.selection.constraints.kind import ConstraintKind, Group, ScaledConstraint, Scene
from flexopt.selection.constraints.segment_distance import from_box, from_sphere, point_from_box, rows_from_box

# Capsules shorter than this are balls, m.
BALL = 1e-9
# What results call the ground that is asked for.
GROUND = "ground"
# A row for each of these parts of a capsule; of a box both are told as what is between the surfaces.
BY_END = (" (start)", " (end)")
PARTS = {"ground": BY_END, "half_plane": BY_END, "box": ("", "")}


def _faults(plant: Plant, constraints: Constraints) -> list[Fault]:
    asked, machine = constraints.clearance, plant.machine
    if asked is None:
        return []
    if not machine.capsules:
        return [without_volumes(plant, "clearance")]
    faults = _body_faults(plant, asked)
    if asked.ground is None and not asked.obstacles:
        faults.append(Fault("clearance", "names nothing to keep clear of: give ground (height, m) or obstacles"))
    for index, obstacle in enumerate(asked.obstacles):
        faults += _obstacle_faults(plant, obstacle, f"clearance.obstacles[{index}]")
    names = [*([GROUND] if asked.ground is not None else []), *_names(asked)]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        sentence = "results would tell two by one name, as what has none is called by its number; names must differ"
        faults.append(Fault("clearance.obstacles", sentence, repr(twice)))
    return faults


def without_volumes(plant: Plant, field: str) -> Fault:
    """A machine without capsules cannot keep them apart from anything."""
    ends = "[along, left]" if plant.frames.dimension == 2 else "[x, y, z]"
    shapes = "" if plant.frames.dimension == 2 else ', or capsules = "collision" where its robot file has such shapes'
    sentence = (
        f"needs the volumes of bodies, and {plant.machine.name} has none: add tables [[capsules]] with {_key(plant)}, "
        f"start = {ends}, end and radius (m, in the {_key(plant)}'s axes) to the machine file{shapes}"
    )
    return Fault(field, sentence)


def _key(plant: Plant) -> str:
    """What a file calls the body of a capsule: of a machine in space, which stands around a robot file, a link."""
    return "body" if plant.frames.dimension == 2 else "link"


def _body_faults(plant: Plant, asked: Clearance) -> list[Fault]:
    capsules = plant.machine.capsules
    with_capsules = list(dict.fromkeys(capsule.called for capsule in capsules))
    filled = {*with_capsules, *(capsule.body for capsule in capsules)}
    names = list(dict.fromkeys([*plant.frames.names, *with_capsules]))
    faults: list[Fault] = []
    for name in asked.bodies or ():
        if name not in names:
            meant = hint(name, names, f"; valid here: {', '.join(with_capsules)}")
            sentence = f"{plant.machine.name} has no body of that name{meant}"
            faults.append(Fault("clearance.bodies", sentence, repr(name)))
        elif name not in filled:
            sentence = f"has no volume: add a table [[capsules]] with {_key(plant)} = {name!r} to the machine file"
            faults.append(Fault("clearance.bodies", sentence, repr(name)))
    return faults


def _obstacle_faults(plant: Plant, obstacle: Obstacle, field: str) -> list[Fault]:
    d = plant.frames.dimension
    place = f"{field} ({obstacle.name})" if obstacle.name else field
    wanted = f"must be {'two numbers [x, y]' if d == 2 else 'three numbers [x, y, z]'}: {plant.machine.name} moves "
    wanted += "in the plane" if d == 2 else "in space"
    given: dict[str, tuple[float, ...]] = {
        key: value for key, value in obstacle.model_dump().items() if key in ("center", "size", "point", "normal")
    }
    return [Fault(f"{place}.{key}", wanted, str(list(value))) for key, value in given.items() if len(value) != d]


def _groups(plant: Plant, constraints: Constraints) -> list[Group]:
    asked = constraints.clearance
    if asked is None:
        return []
    capsules = plant.machine.capsules
    chosen = [k for k, c in enumerate(capsules) if asked.bodies is None or {c.body, c.called} & {*asked.bodies}]
    groups: list[Group] = []
    if asked.ground is not None:
        lifted = [k for k in chosen if is_moved(plant, capsules[k].body)]
        groups.append(group(capsules, "ground", lifted, (asked.ground,), GROUND, asked.distance))
    for name, obstacle in zip(_names(asked), asked.obstacles, strict=True):
        groups.append(group(capsules, obstacle.kind, chosen, _numbers(obstacle), name, asked.distance))
    return groups


def _names(asked: Clearance) -> list[str]:
    """What results call each obstacle."""
    return [obstacle.name or f"obstacle {number}" for number, obstacle in enumerate(asked.obstacles, start=1)]


def is_moved(plant: Plant, body: str) -> bool:
    """Whether an actuated joint moves the body."""
    k = plant.frames.names.index(body)
    frame = ca.veccat(plant.frames.origins[k], plant.frames.rotations[k])
    return bool(ca.depends_on(frame, plant.graph.q[plant.n_passive :]))


def capsule_names(capsules: tuple[Capsule, ...]) -> list[str]:
    """What messages call each capsule: its body or label, with a number where several are called alike."""
    called = [capsule.called for capsule in capsules]
    return [
        name if called.count(name) == 1 else f"{name} capsule {called[: k + 1].count(name)}"
        for k, name in enumerate(called)
    ]


def group(
    capsules: tuple[Capsule, ...], kind: str, chosen: list[int], numbers: tuple[float, ...], name: str, distance: float
) -> Group:
    """Rows of the chosen capsules for an obstacle of that kind with these constants."""
    rows: list[ScaledConstraint] = []
    names = capsule_names(capsules)
    for k in chosen:
        who = names[k]
        parts = ("",) if is_ball(capsules[k]) else PARTS.get(kind, ("",))
        rows += [ScaledConstraint(f"clearance of {who}{part} from {name}", "m", distance, math.inf) for part in parts]
    return Group("clearance", (kind, tuple(chosen)), numbers, tuple(rows))


def _numbers(obstacle: Obstacle) -> tuple[float, ...]:
    """Constants of an obstacle."""
    if isinstance(obstacle, Sphere):
        return (*obstacle.center, obstacle.radius)
    if isinstance(obstacle, Box):
        half = tuple(side / 2 for side in obstacle.size)
        return (*obstacle.center, *half, math.cos(obstacle.yaw), math.sin(obstacle.yaw))
    offset = sum(n * x for n, x in zip(obstacle.normal, obstacle.point, strict=True))
    return (*obstacle.normal, offset)


def _graph(scene: Scene, shape: Any, c: ca.SX) -> list[ca.SX]:
    return _rows(scene, shape, c, DISTANCES)


def _report(scene: Scene, shape: Any, c: ca.SX) -> list[ca.SX]:
    return _rows(scene, shape, c, DISTANCES | {"box": _from_box})


def _rows(scene: Scene, shape: Any, c: ca.SX, distances: dict[str, DistanceRows]) -> list[ca.SX]:
    kind, chosen = cast(tuple[str, tuple[int, ...]], shape)
    rows: list[ca.SX] = []
    for k in chosen:
        capsule = scene.plant.machine.capsules[k]
        found = distances[kind](axis_ends(scene, capsule), axis_length(capsule), c)
        rows += [distance - capsule.radius for distance in found]
    return rows


def axis_ends(scene: Scene, capsule: Capsule) -> list[ca.SX]:
    """The ends of a capsule's axis, (d,), m, inertial frame; of a ball the one point."""
    start, end = scene.point(capsule.body, capsule.start), scene.point(capsule.body, capsule.end)
    return [(start + end) / 2] if is_ball(capsule) else [start, end]


def is_ball(capsule: Capsule) -> bool:
    """Whether a capsule is a ball: one point is all of its axis."""
    return axis_length(capsule) < BALL


def axis_length(capsule: Capsule) -> float:
    """Of a capsule's axis, m."""
    return math.dist(capsule.start, capsule.end)


def _from_ground(ends: list[ca.SX], _: float, c: ca.SX) -> list[ca.SX]:
    return [end[-1] - c[0] for end in ends]


def _from_half_plane(ends: list[ca.SX], _: float, c: ca.SX) -> list[ca.SX]:
    return [ca.dot(c[:-1], end) - c[-1] for end in ends]


def _from_sphere(ends: list[ca.SX], length: float, c: ca.SX) -> list[ca.SX]:
    return [from_sphere(ends, length, c[:-1], c[-1])]


def _from_box(ends: list[ca.SX], length: float, c: ca.SX) -> list[ca.SX]:
    """Of a capsule the distance twice, for there are two rows."""
    own, half = _in_box(ends, c)
    return [from_box(own[0], own[1], length, half)] * 2 if len(own) == 2 else [point_from_box(own[0], half)]


def _beside_box(ends: list[ca.SX], length: float, c: ca.SX) -> list[ca.SX]:
    own, half = _in_box(ends, c)
    return rows_from_box(own[0], own[1], length, half) if len(own) == 2 else [point_from_box(own[0], half)]


def _in_box(ends: list[ca.SX], c: ca.SX) -> tuple[list[ca.SX], ca.SX]:
    """Points in the box's frame, and its half sides."""
    d = ends[0].shape[0]
    center, half, cosine, sine = c[:d], c[d : 2 * d], c[2 * d], c[2 * d + 1]
    away = [end - center for end in ends]
    return [ca.vertcat(cosine * a[0] + sine * a[1], cosine * a[1] - sine * a[0], a[2:]) for a in away], half


# From the ends of a capsule's axis, its length and an obstacle's constants to rows.
DistanceRows = Callable[[list[ca.SX], float, ca.SX], list[ca.SX]]
DISTANCES: dict[str, DistanceRows] = {
    "ground": _from_ground,
    "half_plane": _from_half_plane,
    "sphere": _from_sphere,
    "box": _beside_box,
}
KIND = ConstraintKind(_groups, _graph, _faults, report=_report)
