"""Rows with a kink, as distances have where nearest points change places: a climb's proof takes both sides."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flexopt.selection.outcomes.climb import _left_open, _other_sides

# Slopes of two smooth distances, and where both are 0.
ONE, OTHER = np.array([1.0, 1.0, 0.2]), np.array([1.0, -1.0, 0.1])
HERE = np.array([0.3, -0.2, 0.5])


def of_rows(value: Callable[[np.ndarray], tuple[float, np.ndarray]]) -> Any:
    return SimpleNamespace(rows=lambda y: np.array([value(y)[0]]), row_slopes=lambda y: value(y)[1][None, :])


def pieces(y: np.ndarray) -> tuple[tuple[float, np.ndarray], tuple[float, np.ndarray]]:
    """Two distances with some curvature, and their slopes."""
    away = y - HERE
    bend = 0.5 * float(away @ away)
    return (float(ONE @ away) + bend, ONE + away), (float(OTHER @ away) + bend, OTHER + away)


def lesser(y: np.ndarray) -> tuple[float, np.ndarray]:
    return min(pieces(y), key=lambda piece: piece[0])


def greater(y: np.ndarray) -> tuple[float, np.ndarray]:
    return max(pieces(y), key=lambda piece: piece[0])


def smooth(y: np.ndarray) -> tuple[float, np.ndarray]:
    """A hundred times as curved."""
    value, slope = pieces(y)[0]
    away = y - HERE
    return value + 50.0 * float(away @ away), slope + 100.0 * away


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_of_the_smaller_of_two_distances_both_slopes_count(sense: float) -> None:
    """At a lower bound of the smaller one, or an upper bound of the larger one, which is the same turned over."""
    program = of_rows(lambda y: tuple(sense * part for part in lesser(y)))  # type: ignore[arg-type, return-value]
    there = sense * program.row_slopes(HERE)[0]
    found = _other_sides(program, HERE, [(sense, 0)])
    assert found
    own, other = (ONE, OTHER) if np.allclose(there, ONE) else (OTHER, ONE)
    assert np.allclose(there, own)
    for slope in found:
        np.testing.assert_allclose(slope, other, atol=1e-5)
    # A branch that pushes against both is held by both, and by no single one.
    least, by_level = -(ONE + OTHER)[None, :], np.array([-1.0])
    assert _left_open(least, by_level, [there]) > 0.5
    assert _left_open(least, by_level, [there, *found]) < 1e-5
    # A thousandth beside the kink the other distance holds no more.
    assert not _other_sides(program, HERE + 1e-3 * own, [(sense, 0)])


def test_of_the_greater_of_two_and_of_what_is_only_curved_no_other_slope_counts() -> None:
    """Where one of two distances is enough, neither need hold."""
    assert not _other_sides(of_rows(greater), HERE, [(1.0, 0)])
    assert not _other_sides(of_rows(smooth), HERE, [(1.0, 0)])
