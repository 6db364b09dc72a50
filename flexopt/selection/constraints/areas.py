"""Where the machine may stand: inside one of several areas (`region`), outside each of others (`keep_out`).

All that it stands on, its `support` as the placement moves and turns it, or its anchor point alone (`holds`). An area
is a polygon on the ground; of a planar machine, whose ground is a line, an interval of x. Rows are signed distances,
exact for one area; for the union of several the largest of theirs, whose sign and zeros are right.

A footprint F is convex. It lies in an area where its corners do and, where the area is not convex, F is clear of what
the area lacks of its hull; off an area it is clear of that. What F is clear of comes as convex pieces: as a solver sees
it by the largest gap along a normal of an edge of either (the separating axes of two convex bodies; Ericson, Real-Time
Collision Detection, section 5.2), minus the depth where they meet; as people do by the distance, which has the same
sign.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, cast

import casadi as ca

from flexopt.errors import Fault
from flexopt.model.constraints import Area, Constraints
from flexopt.model.polygons import Corners
from flexopt.plant import Plant
from flexopt.selection.constraints.convex_pieces import convex_pieces, pockets
from flexopt.selection.constraints.kind import ConstraintKind, ConstraintRow, Group, Scene
from flexopt.selection.constraints.polygon_distance import (
    corners_of,
    left_of_edges,
    polygon_constants,
    polygon_distance,
)

Clear = Callable[[Scene, ca.SX], ca.SX]
INSIDE = "distance inside region"


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


def _region_faults(plant: Plant, given: Constraints) -> list[Fault]:
    faults = _faults(plant, "region", given.region)
    if given.holds == "footprint" and not plant.machine.support_points:
        wanted = "[support] span = [rear, front]" if plant.frames.dimension == 2 else "[support] polygon = [[x, y], …]"
        sentence = (
            f"needs what the undercarriage stands on, and {plant.machine.name} has none: add {wanted} (m, anchor "
        )
        faults.append(Fault("holds", f"{sentence}frame) to the machine file, or ask for 'point'", "'footprint'"))
    return faults


def _whole(plant: Plant, constraints: Constraints) -> bool:
    """Whether the whole footprint is held."""
    return constraints.holds != "point" and bool(plant.machine.support_points)


def _interval(plant: Plant, area: tuple[float, float], *, whole: bool, inside: bool) -> tuple[float, float]:
    """Where the anchor point may stand in the plane, or where not."""
    ends = [x for (x,) in plant.machine.support_points] if whole else [0.0, 0.0]
    rear, front = ends if inside else reversed(ends)
    return area[0] - rear, area[1] - front


def _in_interval(scene: Scene, c: ca.SX) -> ca.SX:
    return ca.fmin(scene.anchor - c[0], c[1] - scene.anchor)


def _own(scene: Scene) -> ca.SX:
    """The footprint's constants, in the anchor frame."""
    return ca.SX(ca.DM(polygon_constants(cast(Corners, scene.plant.machine.support_points))))


def _gap(scene: Scene, c: ca.SX) -> ca.SX:
    """Largest gap between the footprint and a convex piece along a normal of an edge, m; minus the depth."""
    around = [left_of_edges(corner, c) for corner in scene.footprint]
    within = [left_of_edges(scene.from_anchor(corner), _own(scene)) for corner in corners_of(c)]
    # Of every edge the offsets of the other's corners to its left: the deepest is in the way.
    edges: list[tuple[ca.SX, ...]] = [*zip(*around, strict=True), *zip(*within, strict=True)]
    return ca.mmax(ca.vertcat(*(-ca.mmax(ca.vertcat(*offsets)) for offsets in edges)))


def _distance(scene: Scene, c: ca.SX) -> ca.SX:
    """Distance of the footprint from a convex piece, m; minus the depth where they meet."""
    gap = _gap(scene, c)
    apart = [-polygon_distance(corner, c) for corner in scene.footprint]
    apart += [-polygon_distance(scene.from_anchor(corner), _own(scene)) for corner in corners_of(c)]
    return ca.if_else(gap > 0, ca.mmin(ca.vertcat(*apart)), gap)


def _pieces(numbers: ca.SX, sizes: Sequence[int]) -> list[ca.SX]:
    ends = [sum(sizes[:k]) for k in range(len(sizes) + 1)]
    return [numbers[a:b] for a, b in pairwise(ends)]


def _region_groups(plant: Plant, constraints: Constraints) -> list[Group]:
    if constraints.region is None:
        return []
    whole = _whole(plant, constraints)
    if plant.frames.dimension == 2:
        given = cast(tuple[tuple[float, float], ...], constraints.region)
        areas = [[_interval(plant, area, whole=whole, inside=True)] for area in given]
        shape = "interval"
    else:
        polygons = cast(tuple[Corners, ...], constraints.region)
        lacks = [pockets(polygon) if whole else [] for polygon in polygons]
        areas = [list(map(polygon_constants, (area, *lack))) for area, lack in zip(polygons, lacks, strict=True)]
        shape = "footprint" if whole else "point"
    labels = [INSIDE]
    if shape == "footprint" and len(areas) == 1:
        labels = [f"{INSIDE} of corner ({x:g}, {y:g})" for x, y in plant.machine.support_points]
        labels += [INSIDE] * (len(areas[0]) > 1)
    sizes = tuple(tuple(len(part) for part in area) for area in areas)
    numbers = tuple(number for area in areas for part in area for number in part)
    return [Group("region", (shape, sizes), numbers, tuple(ConstraintRow(x, "m", 0.0, math.inf) for x in labels))]


def _region_graph(clear: Clear, scene: Scene, shape: Any, c: ca.SX) -> list[ca.SX]:
    kind, sizes = cast(tuple[str, tuple[tuple[int, ...], ...]], shape)
    inside: list[list[ca.SX]] = []
    for area, numbers in zip(sizes, _pieces(c, [sum(area) for area in sizes]), strict=True):
        outline, *lacks = _pieces(numbers, area)
        if kind == "interval":
            rows = [_in_interval(scene, outline)]
        else:
            points = scene.footprint if kind == "footprint" else [scene.anchor]
            rows = [polygon_distance(point, outline) for point in points]
        if lacks:
            rows.append(ca.mmin(ca.vertcat(*(clear(scene, lack) for lack in lacks))))
        inside.append(rows)
    if len(inside) == 1:
        return inside[0]
    return [ca.mmax(ca.vertcat(*(ca.mmin(ca.vertcat(*rows)) for rows in inside)))]


def _keep_out_groups(plant: Plant, constraints: Constraints) -> list[Group]:
    whole, groups = _whole(plant, constraints), list[Group]()
    for index, area in enumerate(constraints.keep_out or ()):
        if plant.frames.dimension == 2:
            interval = _interval(plant, cast(tuple[float, float], area), whole=whole, inside=False)
            shape, parts = "interval", [interval]
        else:
            corners = cast(Corners, area)
            shape, parts = ("footprint", convex_pieces(corners)) if whole else ("point", [corners])
            parts = list(map(polygon_constants, parts))
        row = ConstraintRow(f"distance from keep_out[{index}]", "m", 0.0, math.inf)
        numbers = tuple(number for part in parts for number in part)
        groups.append(Group("keep_out", (shape, tuple(map(len, parts))), numbers, (row,)))
    return groups


def _keep_out_graph(clear: Clear, scene: Scene, shape: Any, c: ca.SX) -> list[ca.SX]:
    kind, sizes = cast(tuple[str, tuple[int, ...]], shape)
    if kind == "interval":
        return [-_in_interval(scene, c)]
    if kind == "point":
        return [-polygon_distance(scene.anchor, c)]
    return [ca.mmin(ca.vertcat(*(clear(scene, piece) for piece in _pieces(c, sizes))))]


REGION = ConstraintKind(
    _region_groups, partial(_region_graph, _gap), _region_faults, report=partial(_region_graph, _distance)
)
KEEP_OUT = ConstraintKind(
    _keep_out_groups,
    partial(_keep_out_graph, _gap),
    lambda plant, given: _faults(plant, "keep_out", given.keep_out),
    report=partial(_keep_out_graph, _distance),
)
