"""Signed distances of a segment from simple solids as graphs, m: exact, and with finite derivatives everywhere.

A distance has a kink where nearest points change places. Rows of distances, the least of which it is, have none there,
so that a solver and a proof see every side.

A segment runs from `start` to `end` (d,) and has the constant length `length` > 0, m. Less a radius they are those of a
capsule.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import casadi as ca

from flexopt.algebra import safe_norm, same_distance

# A direction that changes by less than this share of the segment's length counts as not changing; the distance is then
# wrong by no more than that share.
PARALLEL = 1e-10
# A sliver of a face, between nearly parallel edges, counts only where it is nearer than the others by this, m: its
# normal, and with it the derivative, is only as good as the sliver is wide.
SLIVER = 1e-12
# Two segments count as parallel where the square of the sine between them is below this: their ends then tell the
# distance, and where they are apart at all it is wrong by far less than rounding.
SINE_SQUARED = 1e-12
# Pieces of a segment shorter than this share of it are none.
NO_PIECE = 1e-9


def from_sphere(ends: list[ca.SX], length: float, center: ca.SX, radius: ca.SX) -> ca.SX:
    """Distance of a segment, or of the point that is its one end, from a ball's surface; −radius through its middle."""
    if len(ends) == 1:
        return safe_norm(ends[0] - center) - radius
    return _from_end(center, ends[0], ends[1] - ends[0], ca.SX(length)) - radius


def point_from_box(point: ca.SX, half: ca.SX) -> ca.SX:
    """Signed distance of a point from a box about the origin with the half sides `half` (d,)."""
    beyond = ca.fabs(point) - half
    depth = ca.mmax(beyond)
    outside = safe_norm(ca.fmax(beyond, 0))
    return ca.if_else(depth > 0, outside, depth)


def from_box(start: ca.SX, end: ca.SX, length: float, half: ca.SX) -> ca.SX:
    """Signed distance of a segment from a box about the origin with the half sides `half` (d,).

    Outside, the squared distance of the point at s is convex in s and quadratic between the places where the segment
    crosses the planes of the faces, so that its slope is piecewise linear and never falls: the minimum lies between the
    last of these places (or the start) where the slope is not positive and the first (or the end) where it is not
    negative, and there linear interpolation is exact. Inside, it is minus the shortest way out, which leads along the
    normal of a face of the box swept by the segment: normals of the box's faces and those of its edges with the segment
    (the separating axes of two convex bodies; Ericson, Real-Time Collision Detection, section 5.2).
    """
    return _box_distance(start.shape[0]).call([start, end, ca.SX(length), half])[0]


def rows_from_box(start: ca.SX, end: ca.SX, length: float, half: ca.SX) -> list[ca.SX]:
    """`from_box` as two rows whose lesser it is: it has a kink where the segment lies along a face, they have none.

    Along a face or an edge each row is the distance at one end of the part of the segment beside it: of the end of the
    segment, or of an edge or a corner of the box. Where the lesser of these is not the distance both rows are that.
    """
    return _box_distance(start.shape[0]).call([start, end, ca.SX(length), half])[1:]


@lru_cache
def _box_distance(dimension: int) -> ca.Function:
    """Both, written once for all pairs: most of the time that constraints take to build would go there."""
    start, end, half = (ca.SX.sym(name, dimension) for name in ("start", "end", "half"))
    length = ca.SX.sym("length")
    separation = _separation(start, end, length, half)
    nearest = _nearest(start, end, length, half)
    along = end - start
    outside = safe_norm(ca.fmax(ca.fabs(start + nearest.at * along) - half, 0))
    distance = ca.if_else(separation > 0, outside, separation)
    ends = _ends_beside(start, along, length, half, nearest)
    size = ca.norm_1(start) + ca.norm_1(end) + ca.norm_1(half)
    tells = ca.logic_and(separation > 0, same_distance(ca.fmin(*ends), distance, size))
    rows = [ca.if_else(tells, row, distance) for row in ends]
    return ca.Function("box_distance", [start, end, length, half], [distance, *rows])


class _Nearest(NamedTuple):
    """Where on a segment the point nearest to a box is, 0 to 1; between which of the `places` where pieces end."""

    at: ca.SX
    low: ca.SX
    high: ca.SX
    places: list[ca.SX]


def _nearest(start: ca.SX, end: ca.SX, length: ca.SX, half: ca.SX) -> _Nearest:
    """The middle of them where there are several."""
    along = end - start

    def slope(s: ca.SX) -> ca.SX:
        at = start + s * along
        return ca.dot(along, at - ca.fmax(-half, ca.fmin(half, at)))

    low, slope_low = ca.SX(0), ca.fmin(slope(ca.SX(0)), 0)
    high, slope_high = ca.SX(1), ca.fmax(slope(ca.SX(1)), 0)
    places = [ca.SX(0), ca.SX(1)]
    for k in range(along.shape[0]):
        crosses = ca.fabs(along[k]) > PARALLEL * length
        by = ca.if_else(crosses, along[k], 1.0)
        clipped = [ca.fmax(0, ca.fmin(1, (side * half[k] - start[k]) / by)) for side in (-1, 1)]
        places += [ca.if_else(crosses, s, 0.0) for s in clipped]
    for s in places:
        here = slope(s)
        before = ca.logic_and(here <= 0, s >= low)
        low, slope_low = ca.if_else(before, s, low), ca.if_else(before, here, slope_low)
        after = ca.logic_and(here >= 0, s <= high)
        high, slope_high = ca.if_else(after, s, high), ca.if_else(after, here, slope_high)
    rise = slope_high - slope_low
    rises = rise > 0
    share = ca.if_else(rises, -slope_low / ca.if_else(rises, rise, 1.0), 0.5)
    return _Nearest(low + share * (high - low), ca.fmin(low, high), ca.fmax(low, high), places)


def _ends_beside(start: ca.SX, along: ca.SX, length: ca.SX, half: ca.SX, nearest: _Nearest) -> list[ca.SX]:
    """Distances at both ends of the piece that lies most nearly along the box, of those beside the nearest point.

    Past an end the squared distance is another quadratic, whose least value counts there; past the segment's own there
    is none.
    """

    def before(s: ca.SX) -> ca.SX:
        return ca.mmax(ca.vertcat(0, *(ca.if_else(x < s - NO_PIECE, x, 0) for x in nearest.places)))

    def after(s: ca.SX) -> ca.SX:
        return ca.mmin(ca.vertcat(1, *(ca.if_else(x > s + NO_PIECE, x, 1) for x in nearest.places)))

    def of_piece(low: ca.SX, high: ca.SX) -> tuple[ca.SX, ca.SX]:
        """How far its middle is beyond each pair of faces, and how fast that changes; 0 where it is between them."""
        at = start + (low + high) / 2 * along
        beyond = ca.fabs(at) > half
        return ca.if_else(beyond, ca.fabs(at) - half, 0), ca.if_else(beyond, ca.sign(at) * along, 0)

    def least(low: ca.SX, high: ca.SX, end: ca.SX) -> ca.SX:
        away, by = of_piece(low, high)
        bend = ca.dot(by, by)
        bends = ca.logic_and(high - low > NO_PIECE, bend > (PARALLEL * length) ** 2)
        lowest = away - by * ca.dot(away, by) / ca.if_else(bends, bend, 1.0)
        at_end = ca.fmax(ca.fabs(start + end * along) - half, 0)
        return safe_norm(ca.if_else(bends, lowest, at_end))

    pieces = [(before(nearest.low), nearest.low), (nearest.low, nearest.high), (nearest.high, after(nearest.high))]
    low, high, flattest = ca.SX(0), ca.SX(1), ca.SX.inf()
    for one, other in pieces:
        by = of_piece(one, other)[1]
        bend = ca.if_else(other - one > NO_PIECE, ca.dot(by, by), ca.SX.inf())
        flatter = bend < flattest
        low, high = ca.if_else(flatter, one, low), ca.if_else(flatter, other, high)
        flattest = ca.fmin(bend, flattest)
    return [least(before(low), low, low), least(high, after(high), high)]


def _separation(start: ca.SX, end: ca.SX, length: ca.SX, half: ca.SX) -> ca.SX:
    """Largest gap between segment and box along a separating axis, negative where they meet."""
    along, middle = end - start, (start + end) / 2
    gap = ca.mmax(ca.fabs(middle) - half - ca.fabs(along) / 2)
    if along.shape[0] == 2:
        normal = ca.vertcat(-along[1], along[0]) / length
        here = ca.fabs(ca.dot(normal, middle)) - ca.dot(ca.fabs(normal), half)
        return ca.if_else(here > gap + SLIVER, here, gap)
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        size = along[i] ** 2 + along[j] ** 2
        valid = size > (PARALLEL * length) ** 2
        across = ca.sqrt(ca.if_else(valid, size, 1.0))
        reach = (ca.fabs(along[j]) * half[i] + ca.fabs(along[i]) * half[j]) / across
        here = ca.fabs(along[j] * middle[i] - along[i] * middle[j]) / across - reach
        gap = ca.if_else(ca.logic_and(valid, here > gap + SLIVER), here, gap)
    return gap


def from_segment(one: list[ca.SX], length: float, other: list[ca.SX], other_length: float) -> ca.SX:
    """Distance of two segments, or points that are one end each; in the plane minus the depth where they cross.

    It is that of an end of either from the other segment, or that of the lines where both feet of their common normal
    lie inside (Ericson, Real-Time Collision Detection, section 5.1.9). The depth is the shortest way out: an end's
    distance from the other line.
    """
    if len(one) == 1:
        return from_sphere(other, other_length, one[0], ca.SX(0))
    if len(other) == 1:
        return from_sphere(one, length, other[0], ca.SX(0))
    return _segment_distance(one[0].shape[0]).call([*one, ca.SX(length), *other, ca.SX(other_length)])[0]


def rows_from_segment(one: list[ca.SX], length: float, other: list[ca.SX], other_length: float) -> list[ca.SX]:
    """`from_segment` as rows whose least it is: of two segments two, for beside each other it has a kink, they none.

    Each is the distance at one end of where they are beside each other; both are the distance where the lesser is not.
    """
    if len(one) == 1 or len(other) == 1:
        return [from_segment(one, length, other, other_length)]
    return _segment_distance(one[0].shape[0]).call([*one, ca.SX(length), *other, ca.SX(other_length)])[1:]


@lru_cache
def _segment_distance(dimension: int) -> ca.Function:
    """Both, written once for all pairs."""
    a, b, c, d = (ca.SX.sym(name, dimension) for name in "abcd")
    one, other = ca.SX.sym("one"), ca.SX.sym("other")
    u, v, away = b - a, d - c, a - c
    of_c, of_d = (_from_end(x, a, u, one) for x in (c, d))
    of_a, of_b = (_from_end(x, c, v, other) for x in (a, b))
    across = _cross(u, v)
    size = ca.dot(across, across)
    leaning = size > SINE_SQUARED * (one * other) ** 2
    by = ca.if_else(leaning, size, 1.0)
    uv, u_away, v_away = ca.dot(u, v), ca.dot(u, away), ca.dot(v, away)
    s, t = (uv * v_away - other**2 * u_away) / by, (one**2 * v_away - uv * u_away) / by
    inside = ca.logic_and(leaning, ca.logic_and(ca.fmin(s, t) >= 0, ca.fmax(s, t) <= 1))
    if dimension == 2:
        depths = [_cross(u, x - a) / one for x in (c, d)] + [_cross(v, x - c) / other for x in (a, b)]
        lines = -ca.mmin(ca.fabs(ca.vertcat(*depths)))
    else:
        lines = ca.fabs(ca.dot(away, across)) / ca.sqrt(by)
    distance = ca.if_else(inside, lines, ca.mmin(ca.vertcat(of_c, of_d, of_a, of_b)))
    # Along `one`, in units of its length times itself, c and d lie at these.
    at_c, at_d = -u_away, uv - u_away
    first = ca.if_else(ca.fmin(at_c, at_d) > 0, ca.if_else(at_c < at_d, of_c, of_d), of_a)
    last = ca.if_else(ca.fmax(at_c, at_d) < one**2, ca.if_else(at_c < at_d, of_d, of_c), of_b)
    tells = ca.logic_and(ca.logic_not(inside), ca.fmin(first, last) <= distance)
    rows = [ca.if_else(tells, row, distance) for row in (first, last)]
    return ca.Function("segment_distance", [a, b, one, c, d, other], [distance, *rows])


def _from_end(point: ca.SX, start: ca.SX, along: ca.SX, length: ca.SX) -> ca.SX:
    s = ca.fmax(0, ca.fmin(1, ca.dot(point - start, along) / length**2))
    return safe_norm(start + s * along - point)


def _cross(u: ca.SX, v: ca.SX) -> ca.SX:
    """(3,), in the plane its only entry."""
    return ca.cross(u, v) if u.shape[0] == 3 else u[0] * v[1] - u[1] * v[0]
