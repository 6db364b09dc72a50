"""The proof where branches meet, beside the directional derivatives themselves: λ_min of [[g_11·d, g_12·d], …]."""

from __future__ import annotations

import numpy as np
import pytest

from flexopt.selection.check import (
    STATIONARITY_TOLERANCE,
    FirstOrderModel,
    Kink,
    _at_kinks,
    _unmixed,
    multipliers_of,
)


def stationarity(g11: np.ndarray, g22: np.ndarray, g12: np.ndarray) -> float:
    """As `prove_program` has it, of two branches that meet and nothing else."""
    local = FirstOrderModel(
        level=0.0, value=0.0, gradient=g11, g=np.zeros(0), equal=[], active=[], equalities=g12[None],
        inequalities=(g22 - g11)[None], names=("kink",), moving=np.ones(g11.size), kinks=(Kink(0, 0, None),),
    )  # fmt: skip
    multipliers, kept = multipliers_of(local)
    plain = float(np.linalg.norm(local.gradient - multipliers @ local.rows(kept)))
    return min(_at_kinks(local, multipliers, kept, plain), _unmixed(local))


def steepest(g11: np.ndarray, g22: np.ndarray, g12: np.ndarray) -> float:
    """The largest directional derivative over unit directions of the plane, of a fine scan."""
    angle = np.linspace(0, 2 * np.pi, 20_001)
    d = np.array([np.cos(angle), np.sin(angle)])[: g11.size]
    a, b, c = g11 @ d, g22 @ d, g12 @ d
    return float(((a + b) / 2 - np.sqrt(((a - b) / 2) ** 2 + c**2)).max())


@pytest.mark.parametrize(
    ("g11", "g22", "g12"),
    [
        # Down on both sides, however much the branches mix.
        ([1.0], [-0.5], [0.3]),
        ([1.0], [-1.0], [1e-12]),
        # Both rise along the second direction, but mixing takes more.
        ([1.0, 0.2], [-1.0, 0.2], [0.0, 1.0]),
        ([1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]),
    ],
)
def test_optima_are_proved(g11: list[float], g22: list[float], g12: list[float]) -> None:
    slopes = [np.array(each) for each in (g11, g22, g12)]
    assert steepest(*slopes) <= 1e-9
    assert stationarity(*slopes) <= STATIONARITY_TOLERANCE


@pytest.mark.parametrize("seed", range(200))
def test_what_rises_is_refused(seed: int) -> None:
    """No U proves a point from which V rises: |tr(U M)| is at least the steepest rise."""
    rng = np.random.default_rng(seed)
    slopes = [rng.normal(size=1 + seed % 2) for _ in range(3)]
    assert stationarity(*slopes) >= steepest(*slopes) - 1e-6
