"""Where the anchor point may stand: inside one of several areas (`region`), outside each of others (`keep_out`).

An area is a polygon on the ground; of a planar machine, whose ground is a line, an interval of x. Rows are signed
distances, exact for one area; for the union of several the largest of theirs, whose sign and zeros are right.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, cast

import casadi as ca

from flexopt.errors import Fault
from flexopt.model.constraints import Area, Constraints
from flexopt.model.polygons import Corners
from flexopt.plant import Plant
from flexopt.selection.constraints.kind import ConstraintKind, ConstraintRow, Group, Scene
from flexopt.selection.constraints.polygon_distance import polygon_constants, polygon_distance


def _faults(plant: Plant, field: str, areas: Sequence[Area] | None) -> list[Fault]:
    if areas is None:
        return []
    if not {"x", "y"} & set(plant.machine.base_coordinates):
        return [Fault(field, f"needs a placement, and {plant.machine.name} is not placed by x or y")]
    plane = plant.frames.dimension == 2
    wanted = "an interval [lower, upper] of x" if plane else "a polygon, a list of corners [x, y]"
    sentence = f"must be {wanted}, m: {plant.machine.name} moves {'in the plane' if plane else 'in space'}"
    return [
        Fault(f"{field}[{index}]", sentence, str([list(x) if isinstance(x, tuple) else x for x in area]))
        for index, area in enumerate(areas)
        if plane == isinstance(area[0], tuple)
    ]


def _numbers(area: Area) -> tuple[float, ...]:
    """Constants of one area: the ends of an interval, or those of a polygon."""
    if isinstance(area[0], tuple):
        return polygon_constants(cast(Corners, area))
    return cast(tuple[float, float], area)


def _distance(scene: Scene, c: ca.SX) -> ca.SX:
    """Signed distance of the anchor point, m, positive inside."""
    if scene.dimension == 2:
        return ca.fmin(scene.anchor - c[0], c[1] - scene.anchor)
    return polygon_distance(scene.anchor, c)


def _region_groups(_: Plant, constraints: Constraints) -> list[Group]:
    if constraints.region is None:
        return []
    numbers = [_numbers(area) for area in constraints.region]
    sizes = tuple(len(part) for part in numbers)
    return [
        Group("region", sizes, sum(numbers, start=()), (ConstraintRow("distance inside region", "m", 0.0, math.inf),))
    ]


def _region_graph(scene: Scene, shape: Any, c: ca.SX) -> list[ca.SX]:
    start, result = 0, ca.SX(-math.inf)
    for size in cast(tuple[int, ...], shape):
        inside = _distance(scene, c[start : start + size])
        result, start = inside if start == 0 else ca.fmax(result, inside), start + size
    return [result]


def _keep_out_groups(_: Plant, constraints: Constraints) -> list[Group]:
    return [
        Group(
            "keep_out", None, _numbers(area), (ConstraintRow(f"distance from keep_out[{index}]", "m", 0.0, math.inf),)
        )
        for index, area in enumerate(constraints.keep_out or ())
    ]


def _keep_out_graph(scene: Scene, _: Any, c: ca.SX) -> list[ca.SX]:
    return [-_distance(scene, c)]


REGION = ConstraintKind(_region_groups, _region_graph, lambda plant, given: _faults(plant, "region", given.region))
KEEP_OUT = ConstraintKind(
    _keep_out_groups, _keep_out_graph, lambda plant, given: _faults(plant, "keep_out", given.keep_out)
)
