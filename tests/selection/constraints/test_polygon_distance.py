"""Signed distance from simple polygons, convex or not: Shapely's, and no NaN on the outline."""

from __future__ import annotations

import math
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from flexopt.model.polygons import check_simple_polygon
from flexopt.selection.constraints.polygon_distance import polygon_constants, polygon_distance
from tests.selection.constraints.derivatives import all_finite, difference_error, with_derivatives


def function_of(corners) -> ca.Function:
    point = ca.SX.sym("point", 2)
    return ca.Function("polygon", [point], [polygon_distance(point, ca.SX(ca.DM(polygon_constants(corners))))])


def star(rng: np.random.Generator, n: int) -> list[list[float]]:
    """A polygon around a point at random distances: simple, hardly ever convex, either way round."""
    angles = np.sort(rng.uniform(0, 2 * math.pi, n))
    radii = rng.uniform(0.3, 3, n)
    middle = rng.uniform(-5, 5, 2)
    corners = middle + radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return corners[:: rng.choice([-1, 1])].tolist()


def comb(teeth: int) -> list[list[float]]:
    """Long narrow teeth, and corners in the middle of straight edges."""
    top = [[x / 2, 2.0 if (x // 2) % 2 else 0.1] for x in range(4 * teeth)]
    return [[0.0, -1.0], [teeth * 1.0, -1.0], [2 * teeth - 0.5, -1.0], *reversed(top)]


def shapely_distance(corners, point) -> float:
    polygon, at = shapely.Polygon(corners), shapely.Point(point)
    distance = polygon.exterior.distance(at)
    return distance if polygon.contains(at) else -distance


POLYGONS = [star(np.random.default_rng(seed), n) for seed, n in enumerate([3, 3, 4, 5, 6, 8, 12, 20, 40])] + [
    comb(4),
    [[0, 0], [4, 0], [4, 4], [3, 4], [3, 1], [1, 1], [1, 4], [0, 4]],
    [[0, 0], [1, 0], [2, 0], [2, 1e-3], [1, 1e-3], [0, 1e-3]],
]


@pytest.mark.parametrize("index", range(len(POLYGONS)))
def test_signed_distance_is_shapelys(index):
    assert shapely.Polygon(POLYGONS[index]).is_valid
    corners = check_simple_polygon(POLYGONS[index])
    function = function_of(corners)
    low, high = np.min(corners, axis=0) - 1, np.max(corners, axis=0) + 1
    points = np.random.default_rng(index).uniform(low, high, (500, 2)).tolist()
    ring = np.array([*corners, corners[0]])
    # Next to the outline, and where two features are equally near: over the middle and the ends of edges.
    for a, b in pairwise(ring):
        normal = np.array([a[1] - b[1], b[0] - a[0]]) / np.linalg.norm(b - a)
        points += [a + t * (b - a) + side * normal for t in (0, 0.5, 1) for side in (-0.3, -1e-6, 1e-6, 0.3)]
    for point in points:
        # Shapely tells a point from the outline by the rounded distance, so on it only the size can be compared.
        assert abs(float(function(point)) - shapely_distance(corners, point)) <= 1e-13


@pytest.mark.parametrize("index", range(len(POLYGONS)))
def test_derivatives(index):
    corners = check_simple_polygon(POLYGONS[index])
    function = with_derivatives(function_of(corners))
    rng = np.random.default_rng(index)
    errors = [difference_error(function, [p], 1e-7) for p in rng.uniform(-3, 3, (100, 2)) + np.mean(corners, axis=0)]
    # Some lie within a step of a kink.
    assert np.quantile(errors, 0.97) <= 1e-6
    ring = np.array([*corners, corners[0]])
    for a, b in pairwise(ring):
        for t in (0.0, 0.25, 0.5, 1.0):
            at = a + t * (b - a)
            assert all_finite(function, at)
            # On an edge the distance grows inwards at the rate 1, with no kink: what a solver at its bound needs.
            if t in (0.25, 0.5):
                normal = np.array([a[1] - b[1], b[0] - a[0]]) / np.linalg.norm(b - a)
                assert np.abs(function(at)[1].full().ravel() - normal).max() <= 1e-12
            else:
                assert np.linalg.norm(function(at)[1].full()) == pytest.approx(1.0, abs=1e-9)


@settings(max_examples=200)
@given(
    st.integers(0, len(POLYGONS) - 1),
    st.tuples(*[st.one_of(st.integers(-3, 6).map(float), st.floats(-6, 6), st.floats(-1e6, 1e6))] * 2),
)
def test_no_place_gives_nan(index, point):
    assert all_finite(DERIVATIVES[index], np.array(point))


DERIVATIVES = [with_derivatives(function_of(check_simple_polygon(polygon))) for polygon in POLYGONS]
