"""The H∞ norm against closed forms, SLICOT and dense grids."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest
from hypothesis import assume, given, settings

from flexopt.coprime import StateSpace, hinf_norm, hinf_peak, ncf_margin, state_space
from tests.coprime.oracles import responses
from tests.coprime.plants import in_coordinates, orders, random_plant, sampled_twin, seeds


def stable_plant(seed, n, dt=0.0):
    plant = random_plant(seed, n, dt)
    if dt:
        return StateSpace(plant.A * 0.95 / max(np.abs(plant.poles())), plant.B, plant.C, plant.D, dt)
    return StateSpace(plant.A - (max(plant.poles().real) + 0.05) * np.eye(n), plant.B, plant.C, plant.D)


@pytest.mark.parametrize("zeta", [0.5, 0.1, 2e-4, 1e-7])
@pytest.mark.parametrize("omega", [1e-9, 1.0, 138.0, 1e9])
def test_resonance_in_closed_form(zeta, omega):
    """ω²/(s² + 2ζωs + ω²) peaks at 1/(2ζ√(1 − ζ²)), at ω√(1 − 2ζ²)."""
    system = ([[0, 1.0], [-(omega**2), -2 * zeta * omega]], [[0.0], [omega**2]], [[1.0, 0.0]])
    norm, frequency = hinf_peak(state_space(system))
    # The peak moves by rounding of ζω in A, which is relative 1e-16 of ω², hence 1e-16/ζ of the peak.
    assert norm == pytest.approx(1 / (2 * zeta * math.sqrt(1 - zeta**2)), rel=max(1e-10, 1e-15 / zeta))
    assert frequency == pytest.approx(omega * math.sqrt(1 - 2 * zeta**2), rel=1e-4)  # flat top


def test_first_order_all_pass_and_gain():
    assert hinf_norm((-2.0, 1.0, 3.0)) == pytest.approx(1.5, rel=1e-12)
    assert hinf_norm((-1.0, 1.0, -2.0, 1.0)) == pytest.approx(1.0, rel=1e-10)  # (s − 1)/(s + 1)
    assert hinf_norm(np.array([[3.0, 4.0]])) == pytest.approx(5.0, rel=1e-14)
    assert hinf_norm((-1.0, 0.0, 1.0)) == 0.0
    assert hinf_peak(state_space((-1.0, -1.0, 1.0, 1.0)))[0] == pytest.approx(1.0, rel=1e-10)  # s/(s + 1), at infinity
    assert hinf_norm((0.5, 1.0, 1.0, 0.0, 1.0)) == pytest.approx(2.0, rel=1e-12)
    assert hinf_norm((-0.5, 1.0, 1.0, 0.0, 1.0)) == pytest.approx(2.0, rel=1e-12)


@pytest.mark.parametrize(
    "system", [(1.0, 1.0, 1.0), (0.0, 1.0, 1.0), (1.0, 1.0, 1.0, 0.0, 1.0), (-1.5, 1.0, 1.0, 0.0, 0.1)]
)
def test_unstable_is_infinite(system):
    assert hinf_norm(system) == math.inf


@pytest.mark.parametrize("fast", [1e2, 1e4, 1e6])
@pytest.mark.parametrize("count", [2, 4])
def test_equal_poles_behind_a_fast_one_decay(count, fast):
    """1/(s + 1)ᵏ and its like in sampled time: rounding scatters such poles, and proves nothing."""
    A = np.diag([-1.0] * count + [-fast]) + np.diag([1.0] * count, 1)
    B, C = fast * np.eye(count + 1)[:, [-1]], np.eye(count + 1)[[0]]
    assert hinf_norm((A, B, C)) == pytest.approx(1.0, rel=1e-9)
    assert ncf_margin((A, B, C), 0.0) == pytest.approx(math.sqrt(0.5), rel=1e-9)
    assert hinf_norm(sampled_twin(StateSpace(A, B, C, np.zeros((1, 1))))) == pytest.approx(1.0, rel=1e-9)
    assert hinf_norm((A + np.eye(count + 1), B, C)) == math.inf


@settings(derandomize=True, max_examples=30)
@given(seeds, orders)
def test_continuous_against_slicot_and_grid(seed, n):
    plant = stable_plant(seed, n)
    norm, where = hinf_peak(plant)
    theirs = control.linfnorm(control.ss(plant.A, plant.B, plant.C, plant.D), tol=1e-12)[0]
    assert norm == pytest.approx(theirs, rel=1e-9)
    grid = np.linalg.norm(responses(plant, np.geomspace(1e-3, 1e3, 2000)), 2, axis=(1, 2))
    assert norm >= max(grid) * (1 - 1e-12)
    if math.isfinite(where):
        assert np.linalg.norm(responses(plant, np.array([where]))[0], 2) == pytest.approx(norm, rel=1e-10)


@settings(derandomize=True, max_examples=20)
@given(seeds, orders)
def test_sampled_against_slicot(seed, n):
    plant = stable_plant(seed, n, dt=0.02)
    theirs = control.linfnorm(control.ss(plant.A, plant.B, plant.C, plant.D, 0.02), tol=1e-12)[0]
    assert hinf_norm(plant) == pytest.approx(theirs, rel=1e-9)


@settings(derandomize=True, max_examples=15)
@given(seeds, orders)
def test_units_coordinates_and_sampled_twin(seed, n):
    plant = stable_plant(seed, n)
    norm = hinf_norm(plant)
    rng = np.random.default_rng(seed)
    scaled = in_coordinates(plant, np.diag(10.0 ** rng.uniform(-12, 12, n)))
    assert hinf_norm(StateSpace(scaled.A * 1e12, scaled.B * 1e12, scaled.C, scaled.D)) == pytest.approx(norm, rel=1e-9)
    assume(np.min(np.abs(plant.poles() - 1)) > 1e-2)
    assert hinf_norm(sampled_twin(plant)) == pytest.approx(norm, rel=1e-9)
