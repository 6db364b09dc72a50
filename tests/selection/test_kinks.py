"""The proof where branches meet, beside the directional derivatives themselves: λ_min of [[g_11·d, g_12·d], …]."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import minimize

from flexopt.selection.proof.multipliers import STATIONARITY_TOLERANCE, FirstOrderModel, Kink, certified


def stationarity(g11: np.ndarray, g22: np.ndarray, g12: np.ndarray) -> float:
    """As `prove_program` has it, of two branches that meet and nothing else."""
    return left_over((g11 + g22) / 2, np.array([(g11 - g22) / 2, g12]))


def left_over(gradient: np.ndarray, *corners: np.ndarray) -> float:
    """As `prove_program` has it, of V = gradient·d − Σ |C d| and nothing else."""
    ends = np.cumsum([0, *(len(corner) for corner in corners)])
    kinks = tuple(Kink("kink", slice(int(i), int(j)), None) for i, j in pairwise(ends))
    local = FirstOrderModel(
        level=0.0, value=0.0, gradient=gradient, g=np.zeros(0), equal=[], active=[], equalities=np.vstack(corners),
        inequalities=np.zeros((0, gradient.size)), names=(), moving=np.ones(gradient.size), kinks=kinks,
    )  # fmt: skip
    multipliers, kept = certified(local)
    assert all(share <= 1 + 1e-8 for share in local.shares(multipliers, kept))
    return float(np.linalg.norm(local.gradient - multipliers @ local.rows(kept)))


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


@pytest.mark.parametrize("seed", range(60))
def test_several_cones_beside_a_cone_program(seed: int) -> None:
    """The distance of 0 from gradient − Σ C_iᵀ p_i, |p_i| ≤ 1, is found by SLSQP, too."""
    rng = np.random.default_rng(seed)
    n, sizes = 4, rng.integers(1, 4, size=1 + seed % 3)
    corners = [rng.normal(size=(int(size), n)) for size in sizes]
    gradient = rng.uniform(0.2, 2.0) * rng.normal(size=n)
    stacked, edges = np.vstack(corners), np.cumsum([0, *sizes]).tolist()
    found = minimize(
        lambda p: float(np.sum((gradient - p @ stacked) ** 2)) / 2,
        np.zeros(len(stacked)),
        jac=lambda p: -stacked @ (gradient - p @ stacked),
        constraints=[
            {"type": "ineq", "fun": lambda p, i=i, j=j: 1 - float(p[i:j] @ p[i:j])} for i, j in pairwise(edges)
        ],
        options={"maxiter": 300, "ftol": 1e-14},
    )
    least = float(np.linalg.norm(gradient - found.x @ stacked))
    # Both stop where nothing more than 1e-6 is to be had; what is at most that counts as zero.
    assert left_over(gradient, *corners) == pytest.approx(least, abs=2e-4)
