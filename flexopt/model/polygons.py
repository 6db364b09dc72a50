"""Polygons on the ground as validated data: any simple one, convex or not.

In: corners as a user writes them. Out: corners counter-clockwise, or a `ValueError` with the sentence. Whether edges
meet is decided in exact arithmetic.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from typing import Any

from flexopt.foundation.quantities import COORDINATE, a_list, accepting, each, entries

Corner = tuple[float, float]
Corners = tuple[Corner, ...]
CORNERS_MAX = 500
EDGE_MIN = 1e-6
# As JSON Schema.
POLYGON = a_list(a_list(COORDINATE["m"].accepts or {}, 2, 2), 3, CORNERS_MAX)


@accepting(POLYGON)
def check_simple_polygon(value: Any) -> Corners:
    """Corners [x, y] in m of a simple polygon, counter-clockwise whichever way they were given."""
    given = entries(value)
    if not 3 <= len(given) <= CORNERS_MAX:
        raise ValueError(f"must be 3 to {CORNERS_MAX} corners [x, y] in m")
    corners: list[Corner] = []
    for index, entry in enumerate(given):
        if len(entries(entry)) != 2:
            raise ValueError(f"must be corners [x, y] in m; corner {index} is not")
        x, y = each(COORDINATE["m"], entries(entry), [f"corner {index} x", f"corner {index} y"])
        corners.append((x, y))
    n = len(corners)
    for i, (a, b) in enumerate(pairwise([*corners, corners[0]])):
        if max(abs(a[0] - b[0]), abs(a[1] - b[1])) < EDGE_MIN:
            apart = f"they must be {EDGE_MIN:g} m apart or more"
            raise ValueError(f"has corners {i} and {(i + 1) % n} in one place: {apart}")
    meeting = _meeting_edges(corners)
    if meeting is not None:
        i, j = meeting
        raise ValueError(
            f"is not simple: its edge from corner {i} to corner {(i + 1) % n} meets that from corner {j} to corner "
            f"{(j + 1) % n}"
        )
    if _doubled_area(corners) > 0:
        return tuple(corners)
    return (corners[0], *reversed(corners[1:]))


@accepting(POLYGON)
def check_convex_polygon(value: Any) -> Corners:
    """Corners of a convex polygon, counter-clockwise."""
    corners = check_simple_polygon(value)
    before = (*corners[-1:], *corners[:-1])
    after = (*corners[1:], *corners[:1])
    dents = [i for i, three in enumerate(zip(before, corners, after, strict=True)) if turn(*three) <= 0]
    if dents:
        x, y = corners[dents[0]]
        raise ValueError(f"is not convex: corner [{x:g}, {y:g}] turns inwards or not at all")
    return corners


def turn(a: Corner, b: Corner, c: Corner) -> int:
    """1 where a, b, c turn to the left, −1 to the right, 0 in a line; exact."""
    (ax, ay), (bx, by), (cx, cy) = (tuple(map(Fraction, point)) for point in (a, b, c))
    cross = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    return (cross > 0) - (cross < 0)


def _doubled_area(corners: list[Corner]) -> Fraction:
    ring = [(Fraction(x), Fraction(y)) for x, y in (*corners, corners[0])]
    return sum((a[0] * b[1] - b[0] * a[1] for a, b in pairwise(ring)), Fraction(0))


def _meeting_edges(corners: list[Corner]) -> tuple[int, int] | None:
    """Two edges that touch elsewhere than at the corner that neighbours share."""
    n = len(corners)
    ends = [(corners[i], corners[(i + 1) % n]) for i in range(n)]
    for i, (a, b) in enumerate(ends):
        for j in range(i + 1, n):
            c, d = ends[j]
            if c == b and j == i + 1:
                folded = _folds_back(a, b, d)
            elif d == a and i == 0 and j == n - 1:
                folded = _folds_back(c, d, b)
            else:
                folded = _meet(a, b, c, d)
            if folded:
                return i, j
    return None


def _folds_back(a: Corner, b: Corner, c: Corner) -> bool:
    back = (b[0] - a[0]) * (c[0] - b[0]) + (b[1] - a[1]) * (c[1] - b[1]) < 0
    return back and turn(a, b, c) == 0


def _meet(a: Corner, b: Corner, c: Corner, d: Corner) -> bool:
    """Whether two segments have a point in common: their boxes overlap, and each straddles the other's line."""
    for k in (0, 1):
        if max(a[k], b[k]) < min(c[k], d[k]) or max(c[k], d[k]) < min(a[k], b[k]):
            return False
    return turn(a, b, c) * turn(a, b, d) <= 0 and turn(c, d, a) * turn(c, d, b) <= 0
