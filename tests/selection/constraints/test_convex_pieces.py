"""Polygons in convex pieces: convex in exact arithmetic, and Shapely's areas and unions."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from flexopt.model.polygons import check_simple_polygon, turn
from flexopt.selection.constraints.convex_pieces import convex_pieces, pockets
from tests.selection.constraints.test_polygon_distance import POLYGONS, comb, star

CASES = [*POLYGONS, comb(8), *(star(np.random.default_rng(seed), 4 + seed % 30) for seed in range(60))]
VALID = [case for case in CASES if shapely.Polygon(case).is_valid]


@pytest.mark.parametrize("index", range(len(VALID)))
def test_pieces_make_up_the_polygon_and_its_hull(index):
    corners = check_simple_polygon(VALID[index])
    polygon, inside, lack = shapely.Polygon(corners), convex_pieces(corners), pockets(corners)
    hull = polygon.convex_hull
    for piece in (*inside, *lack):
        assert all(turn(piece[k - 1], piece[k], piece[(k + 1) % len(piece)]) > 0 for k in range(len(piece)))
    for pieces, whole in ((inside, polygon), (lack, hull.difference(polygon))):
        parts = [shapely.Polygon(piece) for piece in pieces]
        assert sum(part.area for part in parts) == pytest.approx(whole.area, abs=1e-9 * hull.area)
        assert shapely.union_all(parts).symmetric_difference(whole).area < 1e-9 * hull.area


def test_a_convex_polygon_is_one_piece_and_lacks_nothing():
    square = ((0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0))
    assert [set(piece) for piece in convex_pieces(square)] == [{(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)}]
    assert pockets(square) == []
