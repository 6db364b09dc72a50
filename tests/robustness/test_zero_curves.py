"""Curves on which known functions vanish: found all, whole, closed where they are closed, and no others."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from flexopt.robustness.atlas.rectangle import CellFields, Rectangle
from flexopt.robustness.atlas.tracing import Tracing
from flexopt.robustness.atlas.zero_curves import common_zeros, zero_curves

SQUARE = Rectangle(np.array([-1.0, -1.0]), np.array([1.0, 1.0]), (False, False))
TORUS = Rectangle(np.full(2, -math.pi), np.full(2, math.pi), (True, True))


def fields(*functions: Any) -> Any:
    """Functions with their slopes, by symbols of CasADi."""
    import casadi as ca  # noqa: PLC0415

    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    g = ca.vertcat(*(f(x, y) for f in functions))
    made = ca.Function("g", [ca.vertcat(x, y)], [g, ca.vec(ca.jacobian(g, ca.vertcat(x, y)))])

    def at(points: Any) -> Any:
        value, slope = (out.full() for out in made.call([ca.DM(points)]))
        n = len(functions)
        return value.reshape(n, -1), slope.reshape(n * 2, -1, order="F")[: 2 * n].reshape(2, n, -1).transpose(1, 0, 2)

    def columns(points: Any) -> Any:
        both = [at(point[:, None]) for point in points.T]
        return np.concatenate([v for v, _ in both], axis=1), np.concatenate([s for _, s in both], axis=2)

    return columns


def found(functions: Any, rectangle: Rectangle, cells: int) -> list[Any]:
    given = fields(*functions)
    curves, _ = zero_curves(given, rectangle, (cells, cells), len(functions))
    for curve in curves:
        assert np.abs(given(curve.points)[0][curve.function]).max() < 1e-13
        # No step is longer than half a cell.
        cell = (rectangle.high - rectangle.low)[:, None] / cells
        assert np.abs(rectangle.steps(curve.points) / cell).max() < 0.5
    return curves


def length(curve: Any, rectangle: Rectangle) -> float:
    return float(np.linalg.norm(rectangle.steps(curve.points), axis=0).sum())


def test_a_circle_is_one_closed_curve() -> None:
    (curve,) = found([lambda x, y: x**2 + y**2 - 0.49], SQUARE, 16)
    assert curve.closed
    assert curve.ends == ()
    np.testing.assert_array_equal(curve.points[:, 0], curve.points[:, -1])
    assert length(curve, SQUARE) == pytest.approx(2 * math.pi * 0.7, rel=1e-3)


@pytest.mark.parametrize("radius", [0.02, 1e-3, 1e-5])
def test_a_loop_between_the_lines_of_the_grid_is_found(radius: float) -> None:
    """It has an extremum inside, next to a node that is least in size."""
    (curve,) = found([lambda x, y: (x - 0.313) ** 2 + 2 * (y - 0.111) ** 2 - radius**2], SQUARE, 16)
    assert curve.closed
    assert np.ptp(curve.points[0]) == pytest.approx(2 * radius, rel=0.1)


@pytest.mark.parametrize("radius", [0.03, 1e-3])
def test_an_arc_that_an_edge_cuts_off_between_two_lines_is_found(radius: float) -> None:
    """The extremum is on the edge: a line through it beside the edge would leave no room between the two."""
    (curve,) = found([lambda x, y: (x - 0.313) ** 2 + (y - 1.0) ** 2 - radius**2], SQUARE, 16)
    assert curve.ends == ("edge", "edge")
    assert length(curve, SQUARE) == pytest.approx(math.pi * radius, rel=0.1)


@pytest.mark.parametrize("gap", [1e-2, 1e-3, -1e-4])
def test_branches_that_pass_closely_are_not_mixed_up(gap: float) -> None:
    """x y = gap² has a branch in each of two quadrants, gap/√2 from their corner."""
    curves = found([lambda x, y: (x - 0.03) * (y - 0.01) - math.copysign(gap**2, gap)], SQUARE, 16)
    assert [curve.ends for curve in curves] == [("edge", "edge")] * 2
    for curve in curves:
        for offset, values in zip((0.03, 0.01), curve.points, strict=True):
            assert len(set(np.sign(values - offset))) == 1


def test_curves_that_cross_go_straight_on() -> None:
    curves = found([lambda x, y: (x - 0.03) * (y - 0.01 + 0.3 * x)], SQUARE, 16)
    assert len(curves) == 2
    assert min(np.ptp(curve.points[0]) for curve in curves) < 1e-3
    assert all(curve.ends == ("edge", "edge") for curve in curves)


def test_curves_go_on_across_the_ends_of_a_turn() -> None:
    import casadi as ca  # noqa: PLC0415

    curves = found([lambda x, y: ca.sin(x + y - 0.3), lambda x, y: ca.cos(3 * x) * ca.sin(2 * y) + 0.1], TORUS, 32)
    # x + y = 0.3 and 0.3 + π close on themselves after a turn of both; each of 12 islands is a loop.
    assert [sum(c.function == k for c in curves) for k in range(2)] == [2, 12]
    assert all(curve.closed for curve in curves)
    assert length(curves[0], TORUS) == pytest.approx(2 * math.pi * math.sqrt(2))


def test_every_crossing_has_two_neighbours() -> None:
    """On a torus nothing ends: pieces of curves and crossings with lines make rings."""
    import casadi as ca  # noqa: PLC0415

    given = fields(lambda x, y: ca.sin(2 * x) * ca.cos(y) + 0.4 * ca.sin(x - 2 * y) + 0.05)
    scaled = CellFields(given, TORUS, (24, 24))
    lines = scaled.lines()
    tracing = Tracing(scaled, lines, scaled.at_nodes(lines), 1)
    assert all(curve.closed for curve in tracing.curves())
    ends = np.array([(piece.start, piece.end) for piece in tracing.pieces])
    assert np.bincount(ends.ravel()).tolist() == [2] * len(tracing.crossings.x)


def test_what_jumps_or_has_no_value_is_no_curve() -> None:
    jump = found([lambda x, y: np.sign(1) * (2 * (x > 0.1) - 1) + 0 * y], SQUARE, 16)
    assert jump == []
    whole = fields(lambda x, y: y - 0.2 + 0.1 * x)

    def half(points: Any) -> Any:
        """Without values left of x = −0.001."""
        value, slope = whole(points)
        left = points[0] < -0.001
        value[:, left], slope[..., left] = np.nan, np.nan
        return value, slope

    (curve,), _ = zero_curves(half, SQUARE, (16, 16), 1)
    assert sorted(curve.ends) == ["edge", "lost"]
    # To a few of the shortest steps.
    assert -0.001 <= curve.points[0].min() < -0.001 + 1e-4


def test_common_zeros() -> None:
    import casadi as ca  # noqa: PLC0415

    given = fields(lambda x, y: ca.sin(x) - y, lambda x, y: x - ca.cos(y))
    starts = np.array([[0.5, 0.5, 3.0], [0.5, -0.5, -3.0]])
    zeros, converged = common_zeros(given, TORUS, (32, 32), (0, 1), starts)
    assert converged[0]
    x, y = zeros[:, 0]
    assert abs(math.sin(x) - y) < 1e-15
    assert abs(x - math.cos(y)) < 1e-15
    # Parallel curves: no zero, and none is made up.
    parallel = fields(lambda x, y: x - y, lambda x, y: x - y - 0.1)
    assert not common_zeros(parallel, SQUARE, (32, 32), (0, 1), starts)[1].any()
