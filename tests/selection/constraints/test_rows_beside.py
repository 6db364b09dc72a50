"""Distances as rows: their lesser is the distance, and together they know every direction beside a box or a segment."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from flexopt.algebra.dense import SAME
from flexopt.selection.constraints.segment_distance import rows_from_box, rows_from_segment
from tests.selection.constraints.derivatives import all_finite, with_derivatives
from tests.selection.constraints.test_segment_distance import box_distance, numbers, oracle, pair_oracle

STEP = 1e-6


def derived(symbols: list[ca.SX], rows: list[ca.SX]) -> list[ca.Function]:
    """Value, gradient and Hessian of each row."""
    return [with_derivatives(ca.Function("row", symbols, [row])) for row in rows]


def of_box(d: int) -> list[ca.Function]:
    start, end, half = (ca.SX.sym(name, d) for name in ("start", "end", "half"))
    return derived([start, end, half], rows_from_box(start, end, ca.norm_2(end - start), half))


def of_pair(d: int) -> list[ca.Function]:
    a, b, c, e = (ca.SX.sym(name, d) for name in "abce")
    return derived([a, b, c, e], rows_from_segment([a, b], ca.norm_2(b - a), [c, e], ca.norm_2(e - c)))


BOX = {d: of_box(d) for d in (2, 3)}
PAIR = {d: of_pair(d) for d in (2, 3)}


def values(rows: list[ca.Function], *at: np.ndarray) -> list[float]:
    return [float(row(*at)[0]) for row in rows]


@pytest.mark.parametrize("d", [2, 3])
def test_the_lesser_is_the_distance_from_a_box(d: int) -> None:
    """Of random ones, some nearly parallel; of many of those that are outside the rows differ."""
    rng = np.random.default_rng(d)
    two = outside = 0
    for _ in range(600):
        half, start = rng.uniform(0.1, 1, d), rng.uniform(-2, 2, d)
        end = start + rng.uniform(-2, 2, d) * rng.choice([0.0, 1.0, 1e-7, 1.0], d)
        if np.linalg.norm(end - start) < 1e-6:
            continue
        expected = oracle(start, end, half)
        found = values(BOX[d], start, end, half)
        assert min(found) == pytest.approx(expected, abs=1e-13)
        outside += expected > 0
        two += expected > 0 and abs(found[0] - found[1]) > 1e-9
    assert two > outside / 2 > 100


@pytest.mark.parametrize("d", [2, 3])
def test_no_place_beside_a_box_gives_nan(d: int) -> None:
    @settings(max_examples=200)
    @given(st.lists(numbers, min_size=d, max_size=d), st.lists(numbers, min_size=d, max_size=d))
    @example([0.0, 1.0, 1.0][:d], [2.0] + [0.0] * (d - 1))  # along an edge of the box
    @example([1.0, 1.0, 1.0][:d], [1.0, -1.0, 0.0][:d])  # through a corner
    @example([0.0, 2.0, 2.0][:d], [4.0] + [0.0] * (d - 1))  # beside it, longer than it
    @example([1.5, 1.5, 1.5][:d], [1.0] + [0.0] * (d - 1))
    @example([0.5, 0.5, 0.5][:d], [0.0, 1e-8, 0.0][:d])  # hardly longer than a point
    def check(middle: list[float], along: list[float]) -> None:
        start, end = np.array(middle) - np.array(along) / 2, np.array(middle) + np.array(along) / 2
        if np.linalg.norm(end - start) < 1e-9:
            return
        for row in BOX[d]:
            assert all_finite(row, start, end, np.ones(d))
        # Rows tell where the lesser is the distance to `SAME` of the coordinates; the direction of a short axis has the
        # digits that its ends leave.
        size = np.abs(start).sum() + np.abs(end).sum() + d
        allowed = 2 * SAME * size + np.finfo(float).eps * size**2 / np.linalg.norm(end - start)
        expected = box_distance(start, end, np.ones(d))
        assert abs(min(values(BOX[d], start, end, np.ones(d))) - expected) <= allowed

    check()


@pytest.mark.parametrize("d", [2, 3])
def test_beside_a_face_the_rows_have_the_slopes_of_every_side(d: int) -> None:
    """Where a segment lies along a face the distance has a slope for each direction: that of the lesser row."""
    rng, checked = np.random.default_rng(30 + d), 0
    for _ in range(200):
        half, k = rng.uniform(0.2, 1, d), int(rng.integers(d))
        start, end = rng.uniform(-1.5, 1.5, (2, d))
        start[k] = end[k] = half[k] + rng.uniform(0.1, 0.5)
        over = np.abs(start + np.linspace(0, 1, 101)[:, None] * (end - start)) < half
        over[:, k] = True
        if over.all(axis=1).sum() < 20:
            continue
        slopes = np.array([row(start, end, half)[1].full().ravel()[: 2 * d] for row in BOX[d]])
        here = start[k] - half[k]
        assert values(BOX[d], start, end, half) == pytest.approx([here, here], abs=1e-14)
        for move in rng.normal(size=(6, 2 * d)):
            there = oracle(start + STEP * move[:d], end + STEP * move[d:], half)
            # Curvature of a distance of a tenth of a metre or more.
            assert (there - here) / STEP == pytest.approx(min(slopes @ move), abs=2e2 * STEP)
        checked += np.linalg.norm(slopes[0] - slopes[1]) > 0.1
    assert checked > 40


@pytest.mark.long("2", "3")
@pytest.mark.parametrize("d", [2, 3])
def test_beside_each_other_segments_have_the_slopes_of_every_side(d: int) -> None:
    """In space for motions in their plane: out of it the distance of parallel lines is no function of first order."""
    rng, checked = np.random.default_rng(40 + d), 0
    for _ in range(200):
        a, along, off = rng.uniform(-1, 1, d), rng.normal(size=d), rng.normal(size=d)
        along /= np.linalg.norm(along)
        off -= off @ along * along
        off *= 0.3 / np.linalg.norm(off)
        b, c = a + rng.uniform(0.5, 1.5) * along, a + rng.uniform(-0.5, 0.5) * along + off
        e = c + rng.choice([-1, 1]) * rng.uniform(0.5, 1.5) * along
        low, high = sorted([(c - a) @ along, (e - a) @ along])
        if min(high, (b - a) @ along) - max(low, 0.0) < 0.1:
            continue
        at = np.array([a, b, c, e])
        slopes = np.array([row(*at)[1].full().ravel() for row in PAIR[d]])
        assert values(PAIR[d], *at) == pytest.approx([0.3, 0.3], abs=1e-14)
        moves = rng.normal(size=(6, 4, d))
        if d == 3:
            across = np.cross(along, off) / 0.3
            moves -= (moves @ across)[..., None] * across
        for move in moves:
            there = pair_oracle(*(at + STEP * move))
            assert (there - 0.3) / STEP == pytest.approx(min(slopes @ move.ravel()), abs=2e2 * STEP)
        checked += np.linalg.norm(slopes[0] - slopes[1]) > 0.1
    assert checked > 80


@pytest.mark.parametrize("d", [2, 3])
def test_the_lesser_is_the_distance_of_segments(d: int) -> None:
    rng = np.random.default_rng(50 + d)
    two = 0
    for _ in range(300):
        at = rng.uniform(-1, 1, (4, d))
        found = values(PAIR[d], *at)
        assert min(found) == pytest.approx(pair_oracle(*at), abs=1e-8)
        assert all(all_finite(row, *at) for row in PAIR[d])
        two += found[0] != found[1]
    assert two > 100
