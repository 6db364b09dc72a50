"""Where the machine may stand: inside one of several areas (`region`), outside each of others (`keep_out`).

All that it stands on, its `support` as the placement moves and turns it, or its anchor point alone (`holds`). An area
is a polygon on the ground; of a planar machine, whose ground is a line, an interval of x. People see signed distances,
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
from itertools import pairwise
from typing import Any, cast

import casadi as ca
import numpy as np

from flexopt.algebra import same_distance
from flexopt.errors import Fault
from flexopt.foundation.arrays import Vector
from flexopt.model.constraints import Area, Constraints
from flexopt.model.polygons import Corners
from flexopt.plant import Plant
from flexopt.selection.constraints.convex_pieces import convex_pieces, hull, pockets
from flexopt.selection.constraints.kind import ConstraintKind, Group, ScaledConstraint, Scene, lacks_support
from flexopt.selection.constraints.polygon_distance import (
    NUMBERS,
    corners_of,
    left_of_edges,
    polygon_constants,
    polygon_distance,
)

# A constraint as people see it, and as rows for a solver.
ValueAndRows = tuple[ca.SX, list[ca.SX]]
INSIDE = "distance inside region"
Ends = tuple[float, float]
ANYWHERE: Ends = (-math.inf, math.inf)
# Rows of what has many parts, the least of all: a placement's three coordinates are held by three, and one may tie.
FEW = 4


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
        faults.append(Fault("holds", f"{lacks_support(plant)}, or ask for 'point'", "'footprint'"))
    return faults


def _whole(plant: Plant, constraints: Constraints) -> bool:
    """Whether the whole footprint is held."""
    return constraints.holds != "point" and bool(plant.machine.support_points)


def _interval(plant: Plant, area: tuple[float, float], *, whole: bool, inside: bool) -> tuple[float, float]:
    """Where the anchor point may stand in the plane, or where not."""
    ends = [x for (x,) in plant.machine.support_points] if whole else [0.0, 0.0]
    rear, front = ends if inside else reversed(ends)
    return area[0] - rear, area[1] - front


def area_ranges(plant: Plant, constraints: Constraints, low: Vector, high: Vector) -> list[tuple[Vector, Vector]]:
    """Between which placements (n_b,) each allowed area lies, of those from low to high.

    In the plane the intervals that are allowed; in space the ends of each polygon of `region`, without one all.
    """
    names, plane, whole = plant.machine.base_coordinates, plant.frames.dimension == 2, _whole(plant, constraints)
    areas: list[dict[str, tuple[float, float]]] = [{}]
    if constraints.region is not None and plane:
        areas = [{"x": _interval(plant, cast(Ends, area), whole=whole, inside=True)} for area in constraints.region]
    elif constraints.region is not None:
        corners = [np.array(area).T for area in constraints.region]
        areas = [{"x": (x.min(), x.max()), "y": (y.min(), y.max())} for x, y in corners]
    for area in (constraints.keep_out or ()) if plane else ():
        off, on = _interval(plant, cast(Ends, area), whole=whole, inside=False)
        ends = [each.get("x", ANYWHERE) for each in areas]
        areas = [{"x": part} for a, b in ends for part in ((a, min(b, off)), (max(a, on), b)) if part[0] <= part[1]]
    found = list[tuple[Vector, Vector]]()
    for area in areas:
        own = np.array([area.get(name, ANYWHERE) for name in names])
        least, most = np.maximum(low, own[:, 0]), np.minimum(high, own[:, 1])
        if np.all(least <= most):
            found.append((least, most))
    return found


def _in_interval(scene: Scene, c: ca.SX) -> ca.SX:
    return ca.fmin(scene.anchor - c[0], c[1] - scene.anchor)


def _own(scene: Scene) -> ca.SX:
    """The footprint's constants, in the anchor frame."""
    return ca.SX(ca.DM(polygon_constants(cast(Corners, scene.plant.machine.support_points))))


def _gap(footprint: list[ca.SX], own: list[ca.SX], around: ca.SX, c: ca.SX) -> ca.SX:
    """Largest gap between the footprint and a convex piece along a normal of an edge, m; minus the depth.

    Args:
        footprint: its corners;  own: those of the piece in the anchor frame.
        around: the footprint's constants in that frame;  c: the piece's.
    """
    of_piece = [left_of_edges(corner, c) for corner in footprint]
    of_footprint = [left_of_edges(corner, around) for corner in own]
    # Of every edge the offsets of the other's corners to its left: the deepest is in the way.
    edges: list[tuple[ca.SX, ...]] = [*zip(*of_piece, strict=True), *zip(*of_footprint, strict=True)]
    return ca.mmax(ca.vertcat(*(-ca.mmax(ca.vertcat(*offsets)) for offsets in edges)))


def _gaps(scene: Scene, c: ca.SX) -> list[ca.SX]:
    """The gap as two rows, at the ends of where an edge of the footprint and one of the piece face each other.

    Flush with an edge the gap is the lesser of both, and turns either way lead to another of them. An end is a corner
    of the footprint beside the piece's edge, or one of the piece beside the footprint's. Where no edges face each other
    so that this is the gap, both rows are that.
    """
    corners, own = scene.footprint, _own(scene)
    there = corners_of(c)
    from_anchor = [scene.from_anchor(corner) for corner in there]
    gap = _gap(corners, from_anchor, own, c)
    off_piece = [[-offset for offset in left_of_edges(corner, c)] for corner in corners]
    off_own = [[-offset for offset in left_of_edges(corner, own)] for corner in from_anchor]
    first, last, facing, far = gap, gap, ca.SX(0), 1 + ca.norm_1(scene.anchor)
    n, m = len(corners), len(there)
    for j in range(m):
        edge = c[j * NUMBERS : (j + 1) * NUMBERS]
        along = [ca.dot(edge[2:4], corner - edge[:2]) for corner in corners]
        for i in range(n):
            # Edges of either go round counter-clockwise, so that facing ones run against each other.
            k = (i + 1) % n
            against = (along[i] - along[k]) / own[i * NUMBERS + 4]
            low = ca.if_else(along[k] > 0, off_piece[k][j], off_own[j][i])
            high = ca.if_else(along[i] < edge[4], off_piece[i][j], off_own[(j + 1) % m][i])
            meet = ca.logic_and(ca.fmax(along[k], 0) < ca.fmin(along[i], edge[4]), against > facing)
            size = far + ca.fabs(low) + ca.fabs(high)
            meet = ca.logic_and(meet, same_distance(ca.fmin(low, high), gap, size))
            first, last = ca.if_else(meet, low, first), ca.if_else(meet, high, last)
            facing = ca.if_else(meet, against, facing)
    return [first, last]


def _distance(scene: Scene, c: ca.SX) -> ca.SX:
    """Distance of the footprint from a convex piece, m; minus the depth where they meet."""
    own, there = _own(scene), [scene.from_anchor(corner) for corner in corners_of(c)]
    gap = _gap(scene.footprint, there, own, c)
    apart = [-polygon_distance(corner, c) for corner in scene.footprint]
    apart += [-polygon_distance(corner, own) for corner in there]
    return ca.if_else(gap > 0, ca.mmin(ca.vertcat(*apart)), gap)


def _least(rows: Sequence[ca.SX], count: int) -> list[ca.SX]:
    """The least so many, in order; of fewer rows the largest repeated."""
    sorted_rows: list[ca.SX] = []
    for row in rows:
        moved, kept = row, list[ca.SX]()
        for each in sorted_rows:
            # By comparison alone, so that of equal ones each keeps its derivative.
            less = moved < each
            kept.append(ca.if_else(less, moved, each))
            moved = ca.if_else(less, each, moved)
        sorted_rows = [*kept, moved][:count]
    return [*sorted_rows, *sorted_rows[-1:] * (count - len(sorted_rows))]


def _pieces(numbers: ca.SX, sizes: Sequence[int]) -> list[ca.SX]:
    ends = [sum(sizes[:k]) for k in range(len(sizes) + 1)]
    return [numbers[a:b] for a, b in pairwise(ends)]


def _region_groups(plant: Plant, constraints: Constraints) -> list[Group]:
    if constraints.region is None:
        return []
    whole = _whole(plant, constraints)
    if plant.frames.dimension == 2:
        given = cast(tuple[tuple[float, float], ...], constraints.region)
        areas, shape = [[_interval(plant, area, whole=whole, inside=True)] for area in given], "interval"
    else:
        polygons = cast(tuple[Corners, ...], constraints.region)
        parts = [(area, hull(area), *pockets(area)) for area in polygons]
        areas, shape = [list(map(polygon_constants, each)) for each in parts], "footprint" if whole else "point"
    lacks = len(areas[0]) - 2
    labels = {"interval": [INSIDE], "point": [INSIDE] * (min(FEW, 1 + lacks) + 2 if lacks else 2)}.get(shape)
    if labels is None:
        corners = [f"{INSIDE} of corner ({x:g}, {y:g})" for x, y in plant.machine.support_points]
        labels = [corner for corner in corners for _ in range(2)] + [INSIDE] * min(FEW, 2 * lacks)
    if len(areas) > 1:
        labels = [INSIDE] * (1 if shape == "interval" else FEW)
    sizes = tuple(tuple(len(part) for part in area) for area in areas)
    numbers = tuple(number for area in areas for part in area for number in part)
    return [Group("region", (shape, sizes), numbers, tuple(ScaledConstraint(x, "m", 0.0, math.inf) for x in labels))]


def _inside(scene: Scene, kind: str, parts: list[ca.SX]) -> list[ValueAndRows]:
    """Of one area the distance inside it of what is held, corner by corner, and off what it lacks of its hull."""
    if kind == "interval":
        inside = _in_interval(scene, parts[0])
        return [(inside, [inside])]
    outline, around, *lacks = parts
    points = scene.footprint if kind == "footprint" else [scene.anchor]
    seen: list[ValueAndRows] = [(polygon_distance(x, outline), _least(left_of_edges(x, around), 2)) for x in points]
    if kind == "point":
        inside, edges = seen[0]
        return [(inside, [*edges, *(_off_all(scene.anchor, inside, lacks) if lacks else [])])]
    if lacks:
        seen.append(_off(scene, lacks))
    return seen


def _off(scene: Scene, pieces: list[ca.SX]) -> ValueAndRows:
    """The footprint off all of these convex pieces."""
    apart = ca.mmin(ca.vertcat(*(_distance(scene, piece) for piece in pieces)))
    return apart, _few([row for piece in pieces for row in _gaps(scene, piece)])


def _off_all(point: ca.SX, allowed: ca.SX, pieces: list[ca.SX]) -> list[ca.SX]:
    """A point's rows off convex pieces, and its signed distance from all of them: between two it is off each."""
    return _few([allowed, *(-polygon_distance(point, piece) for piece in pieces)])


def _few(rows: list[ca.SX]) -> list[ca.SX]:
    return _least(rows, min(FEW, len(rows)))


def _in_region(scene: Scene, shape: Any, c: ca.SX) -> list[ValueAndRows]:
    kind, sizes = cast(tuple[str, tuple[tuple[int, ...], ...]], shape)
    numbers = _pieces(c, [sum(area) for area in sizes])
    areas = [_inside(scene, kind, _pieces(own, area)) for area, own in zip(sizes, numbers, strict=True)]
    if len(areas) == 1:
        return areas[0]
    deepest = ca.mmax(ca.vertcat(*(ca.mmin(ca.vertcat(*(value for value, _ in area))) for area in areas)))
    count = 1 if kind == "interval" else FEW
    best, *others = (_least([row for _, rows in area for row in rows], count) for area in areas)
    for other in others:
        better = other[0] > best[0]
        best = [ca.if_else(better, one, each) for one, each in zip(other, best, strict=True)]
    return [(deepest, best)]


def _keep_out_groups(plant: Plant, constraints: Constraints) -> list[Group]:
    whole, groups = _whole(plant, constraints), list[Group]()
    for index, area in enumerate(constraints.keep_out or ()):
        if plant.frames.dimension == 2:
            interval = _interval(plant, cast(tuple[float, float], area), whole=whole, inside=False)
            shape, parts, count = "interval", [interval], 1
        else:
            pieces = convex_pieces(cast(Corners, area))
            shape = "footprint" if whole else "point"
            # Of a point off one piece alone its distance is one row.
            count = 2 * len(pieces) if whole else 1 + len(pieces) * (len(pieces) > 1)
            parts = [polygon_constants(part) for part in (*([] if whole else [cast(Corners, area)]), *pieces)]
        row = ScaledConstraint(f"distance from keep_out[{index}]", "m", 0.0, math.inf)
        numbers = tuple(number for part in parts for number in part)
        groups.append(Group("keep_out", (shape, tuple(map(len, parts))), numbers, (row,) * min(FEW, count)))
    return groups


def _kept_out(scene: Scene, shape: Any, c: ca.SX) -> list[ValueAndRows]:
    kind, sizes = cast(tuple[str, tuple[int, ...]], shape)
    if kind == "interval":
        outside = -_in_interval(scene, c)
        return [(outside, [outside])]
    if kind == "footprint":
        return [_off(scene, _pieces(c, sizes))]
    outline, *pieces = _pieces(c, sizes)
    outside = -polygon_distance(scene.anchor, outline)
    return [(outside, _off_all(scene.anchor, outside, pieces) if len(pieces) > 1 else [outside])]


def _kind(
    groups: Callable[[Plant, Constraints], list[Group]],
    seen: Callable[[Scene, Any, ca.SX], list[ValueAndRows]],
    faults: Callable[[Plant, Constraints], list[Fault]],
) -> ConstraintKind:
    def solved(scene: Scene, shape: Any, c: ca.SX) -> list[ca.SX]:
        return [row for _, rows in seen(scene, shape, c) for row in rows]

    def reported(scene: Scene, shape: Any, c: ca.SX) -> list[ca.SX]:
        return [value for value, rows in seen(scene, shape, c) for _ in rows]

    return ConstraintKind(groups, solved, faults, report=reported)


REGION = _kind(_region_groups, _in_region, _region_faults)
KEEP_OUT = _kind(_keep_out_groups, _kept_out, lambda plant, given: _faults(plant, "keep_out", given.keep_out))
