"""Simple polygons as unions of convex ones, and what they lack of being convex themselves; exact.

In: corners, counter-clockwise, from `flexopt.model.polygons`. Out: convex polygons, counter-clockwise. Ears are cut off
one by one (Meisters, Polygons have ears, 1975) and put together again where the union is convex (Hertel and Mehlhorn,
1983).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from flexopt.model.polygons import Corner, Corners, turn

# Decimals hardly ever lie on a line in binary: a corner in the middle of an edge that is as straight as this is none.
STRAIGHT = 1e-12


def convex_pieces(corners: Sequence[Corner]) -> list[Corners]:
    """Convex polygons that meet in edges at most and make up the polygon."""
    ring, pieces = _without_straight(corners, STRAIGHT), list[Corners]()
    while len(ring) > 3:
        k = next(k for k in range(len(ring)) if _is_ear(ring, k))
        _add(pieces, (ring[k - 1], ring[k], ring[(k + 1) % len(ring)]))
        ring = _without_straight([*ring[:k], *ring[k + 1 :]])
    _add(pieces, tuple(ring))
    return pieces


def pockets(corners: Sequence[Corner]) -> list[Corners]:
    """What the polygon lacks of its convex hull, as convex polygons; none where it is convex."""
    ring = _without_straight(corners, STRAIGHT)
    on_hull = _on_hull(ring)
    found: list[Corners] = []
    for a, b in zip(on_hull, [*on_hull[1:], on_hull[0] + len(ring)], strict=True):
        if b > a + 1:
            found += convex_pieces([ring[k % len(ring)] for k in range(b, a - 1, -1)])
    return found


def hull(corners: Sequence[Corner]) -> Corners:
    """The polygon's convex hull."""
    ring = _without_straight(corners, STRAIGHT)
    return tuple(ring[k % len(ring)] for k in _on_hull(ring))


def _without_straight(corners: Sequence[Corner], share: float = 0.0) -> list[Corner]:
    """The same polygon without corners in the middle of edges that are straight, to a share of their lengths."""
    n, kept = len(corners), list[Corner]()
    for k, at in enumerate(corners):
        before, after = kept[-1] if kept else corners[k - 1], corners[(k + 1) % n]
        if turn(before, at, after) != 0 and not _is_straight(before, at, after, share):
            kept.append(at)
    return kept if len(kept) > 2 or not share else list(corners)


def _is_straight(a: Corner, b: Corner, c: Corner, share: float) -> bool:
    cross = (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
    return abs(cross) < share * math.dist(a, b) * math.dist(b, c)


def _is_ear(ring: list[Corner], k: int) -> bool:
    """Whether the triangle at corner k lies inside, no other corner in it or on its edges."""
    a, b, c = ring[k - 1], ring[k], ring[(k + 1) % len(ring)]
    if turn(a, b, c) <= 0:
        return False
    others = [p for p in ring if p not in (a, b, c)]
    return not any(turn(a, b, p) >= 0 and turn(b, c, p) >= 0 and turn(c, a, p) >= 0 for p in others)


def _on_hull(ring: list[Corner]) -> list[int]:
    """Numbers of the corners of the convex hull, in order, from the lowest of the leftmost on."""
    n = len(ring)
    first = min(range(n), key=lambda k: ring[k])
    hull = [first]
    for k in range(first + 1, first + n):
        while len(hull) > 1 and turn(ring[hull[-2] % n], ring[hull[-1] % n], ring[k % n]) <= 0:
            hull.pop()
        hull.append(k)
    while len(hull) > 2 and turn(ring[hull[-2] % n], ring[hull[-1] % n], ring[first]) <= 0:
        hull.pop()
    return hull


def _add(pieces: list[Corners], piece: Corners) -> None:
    """Put a piece together with one beside it where that stays convex; else add it."""
    for index, other in enumerate(pieces):
        joined = _joined(other, piece)
        if joined is not None:
            pieces[index] = joined
            return
    pieces.append(piece)


def _joined(one: Corners, other: Corners) -> Corners | None:
    """The union of convex polygons with a common edge, where it is convex; else None."""
    for k, a in enumerate(one):
        b = one[(k + 1) % len(one)]
        if a in other and other[other.index(a) - 1] == b:
            i = other.index(a)
            rest = [other[(i + 1 + j) % len(other)] for j in range(len(other) - 2)]
            ring = [*one[: k + 1], *rest, *one[k + 1 :]]
            turns = [turn(ring[j - 1], ring[j], ring[(j + 1) % len(ring)]) for j in range(len(ring))]
            return None if min(turns) < 0 else tuple(_without_straight(ring))
    return None
