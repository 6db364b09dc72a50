"""Signed distances of a segment from simple solids as graphs, m: exact, and with finite derivatives everywhere.

A segment runs from `start` to `end` (d,) and has the constant length `length` > 0, m. Less a radius they are those of a
capsule.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca

from flexopt.algebra import safe_norm

# A direction that changes by less than this share of the segment's length counts as not changing; the distance is then
# wrong by no more than that share.
PARALLEL = 1e-10
# A sliver of a face, between nearly parallel edges, counts only where it is nearer than the others by this, m: its
# normal, and with it the derivative, is only as good as the sliver is wide.
SLIVER = 1e-12


def from_sphere(ends: list[ca.SX], length: float, center: ca.SX, radius: ca.SX) -> ca.SX:
    """Distance of a segment, or of the point that is its one end, from a ball's surface; −radius through its middle."""
    start, along = ends[0], ends[-1] - ends[0]
    if len(ends) == 1:
        return safe_norm(start - center) - radius
    s = ca.fmax(0, ca.fmin(1, ca.dot(center - start, along) / length**2))
    return safe_norm(start + s * along - center) - radius


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


@lru_cache
def _box_distance(dimension: int) -> ca.Function:
    """`from_box`, written once for all pairs: most of the time that constraints take to build would go there."""
    start, end, half = (ca.SX.sym(name, dimension) for name in ("start", "end", "half"))
    length = ca.SX.sym("length")
    separation = _separation(start, end, length, half)
    at = start + _nearest(start, end, length, half) * (end - start)
    outside = safe_norm(ca.fmax(ca.fabs(at) - half, 0))
    return ca.Function("box_distance", [start, end, length, half], [ca.if_else(separation > 0, outside, separation)])


def _nearest(start: ca.SX, end: ca.SX, length: ca.SX, half: ca.SX) -> ca.SX:
    """Where on the segment, 0 to 1, the point nearest to the box is; the middle of them where there are several."""
    along = end - start

    def slope(s: ca.SX) -> ca.SX:
        at = start + s * along
        return ca.dot(along, at - ca.fmax(-half, ca.fmin(half, at)))

    low, slope_low = ca.SX(0), ca.fmin(slope(ca.SX(0)), 0)
    high, slope_high = ca.SX(1), ca.fmax(slope(ca.SX(1)), 0)
    candidates = [ca.SX(0), ca.SX(1)]
    for k in range(along.shape[0]):
        crosses = ca.fabs(along[k]) > PARALLEL * length
        by = ca.if_else(crosses, along[k], 1.0)
        candidates += [ca.fmax(0, ca.fmin(1, (side * half[k] - start[k]) / by)) for side in (-1, 1)]
    for s in candidates:
        here = slope(s)
        before = ca.logic_and(here <= 0, s >= low)
        low, slope_low = ca.if_else(before, s, low), ca.if_else(before, here, slope_low)
        after = ca.logic_and(here >= 0, s <= high)
        high, slope_high = ca.if_else(after, s, high), ca.if_else(after, here, slope_high)
    rise = slope_high - slope_low
    rises = rise > 0
    share = ca.if_else(rises, -slope_low / ca.if_else(rises, rise, 1.0), 0.5)
    return low + share * (high - low)


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
