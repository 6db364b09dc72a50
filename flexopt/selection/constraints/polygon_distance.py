"""Signed distance of a point from a simple polygon, exact, as a graph: positive inside.

The nearest point of the outline is either inside an edge or a corner. Near an edge the signed distance is that from its
line, which is smooth across it. Near a corner the point is inside where it lies to the left of both edges that meet
there (a convex corner) or of one of them (any other): the segment to the nearest point meets no other edge.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import casadi as ca

from flexopt.algebra import safe_norm
from flexopt.model.polygons import Corner, turn

# Numbers of an edge: its first corner, direction, length, and 1 where that corner is convex.
NUMBERS = 6
FAR = 1e300


def polygon_constants(corners: Sequence[Corner]) -> tuple[float, ...]:
    """The numbers of a polygon whose corners go round counter-clockwise, `NUMBERS` for each edge."""
    numbers: list[float] = []
    n = len(corners)
    for i, (a, b) in enumerate(zip(corners, [*corners[1:], corners[0]], strict=True)):
        length = math.dist(a, b)
        convex = turn(corners[i - 1], a, b) > 0
        numbers += [*a, (b[0] - a[0]) / length, (b[1] - a[1]) / length, length, float(convex)]
    assert len(numbers) == n * NUMBERS
    return tuple(numbers)


def left_of_edges(point: ca.SX, c: ca.SX) -> list[ca.SX]:
    """How far to the left of each edge's line a point (2,) is, m, of the polygon with the constants c."""
    edges = [c[k : k + NUMBERS] for k in range(0, c.shape[0], NUMBERS)]
    return [edge[2] * (point[1] - edge[1]) - edge[3] * (point[0] - edge[0]) for edge in edges]


def corners_of(c: ca.SX) -> list[ca.SX]:
    """Corners (2,) of the polygon with the constants c."""
    return [c[k : k + 2] for k in range(0, c.shape[0], NUMBERS)]


def polygon_distance(point: ca.SX, c: ca.SX) -> ca.SX:
    """Signed distance of a point (2,) from the polygon with the constants c, m.

    Derivatives are finite everywhere, on the outline and at corners too, where those of an edge are taken.
    """
    edges = [c[k : k + NUMBERS] for k in range(0, c.shape[0], NUMBERS)]
    away = [point - edge[:2] for edge in edges]
    along = [ca.dot(edge[2:4], a) for edge, a in zip(edges, away, strict=True)]
    left = [edge[2] * a[1] - edge[3] * a[0] for edge, a in zip(edges, away, strict=True)]
    nearest, result = ca.SX(FAR), ca.SX(-FAR)
    for edge, t, offset in zip(edges, along, left, strict=True):
        size = ca.if_else(ca.logic_and(t >= 0, t <= edge[4]), ca.fabs(offset), FAR)
        closer = size < nearest
        nearest, result = ca.if_else(closer, size, nearest), ca.if_else(closer, offset, result)
    for k, edge in enumerate(edges):
        size = safe_norm(away[k])
        both = ca.if_else(edge[5] > 0, ca.fmin(left[k - 1], left[k]), ca.fmax(left[k - 1], left[k]))
        closer = size < nearest
        nearest = ca.if_else(closer, size, nearest)
        result = ca.if_else(closer, ca.if_else(both >= 0, size, -size), result)
    return result
