"""Gap and ν-gap against closed forms, finite sections, dense grids and their theorems."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from flexopt.coprime import StateSpace, gap, ncf_margin, nu_gap, optimal_controller
from tests.coprime.oracles import chordal, responses, section_gap
from tests.coprime.plants import (
    chain,
    in_coordinates,
    margin_or_reject,
    near,
    orders,
    random_plant,
    sampled_twin,
    seeds,
)

GAP = 1e-8  # absolute: what gap promises
GAINS = (1.0, 0.3, 0.05)


def pair(seed: int, n: int, dt: float = 0.0) -> tuple[StateSpace, StateSpace]:
    one = random_plant(seed, n, dt)
    return one, near(one, seed + 1, float(np.random.default_rng(seed).choice([0.3, 0.1, 0.01])))


def solvable(*plants: StateSpace, limit: float = 1e6) -> None:
    for plant in plants:
        margin_or_reject(plant, limit)


@pytest.mark.parametrize("a", [1e-3, 0.3, 0.9])
def test_two_slow_poles_in_closed_form(a):
    """1/(s ∓ a): the chordal distance is largest at ω = 0, 2a/(1 + a²), and the gap does not exceed it."""
    one, two = (a, 1.0, 1.0), (-a, 1.0, 1.0)
    assert nu_gap(one, two) == pytest.approx(2 * a / (1 + a * a), rel=1e-10)
    assert gap(one, two) == pytest.approx(2 * a / (1 + a * a), abs=GAP)


def test_values_printed_by_matlab():
    """0.0021 for the gap is an upper end of MATLAB's search, whose tolerance is 1e-3 of 1; 0.0020 for the ν-gap."""
    one, two = (0.001, 1.0, 1.0), (-0.001, 1.0, 1.0)
    assert nu_gap(one, two) == pytest.approx(0.0020, abs=5e-5)
    assert gap(one, two) == pytest.approx(0.0021, abs=1.5e-4)


def test_example_of_matlabs_ncfmargin():
    """(s + 2)/(s² + 5s + 10) with 4.4/s, and its gap to (s + 1)/(s² + 3s + 10), as printed to four digits."""
    first = ([[0, 1], [-10, -5]], [[0], [1]], [[2, 1]])
    second = ([[0, 1], [-10, -3]], [[0], [1]], [[1, 1]])
    assert ncf_margin(first, ([[0.0]], [[1.0]], [[4.4]])) == pytest.approx(0.1961, abs=1e-4)
    assert gap(first, second) == pytest.approx(0.1391, abs=1e-4)


def test_gains_in_closed_form():
    expected = 2 / math.sqrt(10 * 2)
    assert gap(3.0, 1.0) == pytest.approx(expected, rel=1e-12)
    assert nu_gap(3.0, 1.0) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("k", GAINS)
def test_integrator_against_a_gain_times_it(k):
    """1/s and k/s: (1 − k)ω/√((1 + ω²)(k² + ω²)) is largest at ω² = k: (1 − k)/(1 + k)."""
    assert nu_gap(chain(1), chain(1, k)) == pytest.approx((1 - k) / (1 + k), abs=1e-10)


def test_sign_change_and_added_right_half_plane_zero_are_far():
    assert nu_gap(chain(1), chain(1, -1.0)) == 1.0
    assert gap(chain(1), chain(1, -1.0)) == 1.0
    # 1/(s − 1) and −1/(s + 1) are 0.7071 apart at most pointwise and have a winding number: no controller serves both.
    assert nu_gap((2.0, 1.0, 1.0), (-2.0, 1.0, -1.0)) == 1.0


@pytest.mark.parametrize("seed", range(12))
def test_gap_against_finite_sections(seed):
    """‖(I − Π₂)Π₁‖ on signals of finite length grows to the directed gap: fast to an eigenvalue, like 1/N² otherwise."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    one, two = (sampled_twin(p) for p in pair(seed, n))
    mine, theirs = gap(one, two), max(section_gap(one, two), section_gap(two, one))
    assert mine >= theirs - 1e-9
    assert mine == pytest.approx(theirs, abs=2e-4 if mine - nu_gap(one, two) < 1e-3 else 1e-8)


@pytest.mark.long
@settings(derandomize=True, max_examples=20)
@given(seeds, orders, st.sampled_from([0.0, 0.1]))
def test_order_symmetry_and_zero(seed, n, dt):
    one, two = pair(seed, n, dt)
    solvable(one, two)
    nu, full = nu_gap(one, two), gap(one, two)
    assert 0.0 <= nu <= full <= 1.0
    assert nu == pytest.approx(nu_gap(two, one), abs=1e-9)
    assert full == pytest.approx(gap(two, one), abs=GAP)
    twin = in_coordinates(one, np.random.default_rng(seed).normal(size=(n, n)) + 3 * np.eye(n))
    assert nu_gap(one, twin) < 1e-7  # the realisations differ by rounding times the condition numbers
    assert gap(one, twin) < 1e-7
    assert gap(one, one) < 1e-9
    assert nu_gap(one, one) < 1e-9


@pytest.mark.long
@settings(derandomize=True, max_examples=20)
@given(seeds, orders)
def test_triangle_inequality(seed, n):
    one, two = pair(seed, n)
    three = near(two, seed + 2, 0.1)
    solvable(one, two, three)
    assert nu_gap(one, three) <= nu_gap(one, two) + nu_gap(two, three) + 1e-9


@pytest.mark.long
@settings(derandomize=True, max_examples=20)
@given(seeds, orders)
def test_robust_stabilization(seed, n):
    """arcsin b(P2, K) ≥ arcsin b(P1, K) − arcsin δ_ν(P1, P2), and gap ≤ δ_ν/ε_max (Vinnicombe)."""
    one, two = pair(seed, n)
    solvable(one, two)
    K, nu = optimal_controller(one), nu_gap(one, two)
    here, there = ncf_margin(one, K), ncf_margin(two, K)
    assert math.asin(there) >= math.asin(here) - math.asin(nu) - 1e-7
    if nu < here:
        assert there > 0
    assert gap(one, two) <= nu / here + 1e-8


@pytest.mark.long
@settings(derandomize=True, max_examples=20)
@given(seeds, orders, st.sampled_from([0.0, 0.1]))
def test_chordal_distance_against_a_grid(seed, n, dt):
    one, two = pair(seed, n, dt)
    solvable(one, two)
    nu = nu_gap(one, two)
    omega = np.linspace(0, np.pi, 1500) if dt else np.concatenate([[0], np.geomspace(1e-3, 1e3, 1500)])
    on_grid = float(np.max(chordal(one, two, omega)))
    assert nu >= on_grid - 1e-9
    if nu < 1:
        assert nu == pytest.approx(on_grid, abs=2e-2)  # peaks between grid points


@pytest.mark.long("1e-05-1.0", "1e-05-0.0001")
@pytest.mark.parametrize(("shift", "gain"), [(1e-5, 1.0), (1e-5, 1e-4), (1e-4, 1e-2), (1e-3, 1.0), (1e-3, 1e-4)])
def test_sharp_resonances_are_not_missed(shift, gain):
    """Two modes at 138 rad/s with ζ = 2e-4, frequencies apart by `shift`: the peak is narrower than any coarse grid."""

    def mode(w: float) -> StateSpace:
        A = np.array([[0.0, w], [-w, -4e-4 * w]])
        return StateSpace(A, np.array([[0.0], [1.0]]), np.array([[gain * w, 0.0]]), np.zeros((1, 1)))

    one, two = mode(138.0), mode(138.0 * (1 + shift))
    omega = 138.0 * np.concatenate([1 + np.linspace(-5e-4, 1.5e-3, 8001), np.linspace(0, 3, 2001)])
    nu, peak = nu_gap(one, two), float(np.max(chordal(one, two, omega)))
    assert nu >= peak - 1e-10
    if nu < 1:
        assert nu == pytest.approx(peak, rel=1e-6)  # the grid's own resolution


@pytest.mark.long
@settings(derandomize=True, max_examples=20)
@given(seeds, st.integers(1, 5))
def test_winding_number_against_a_phase_count(seed, n):
    """δ_ν < 1 exactly where (zeros − poles of det(I + P2*P1) in Re s > 0) + η(P1) − η(P2) = 0 (Vinnicombe 1993).

    The difference of counts is minus the turns of the determinant's phase along the axis.
    """
    one = random_plant(seed, n)
    two = near(one, seed + 1, 0.7)
    solvable(one, two)
    assume(min(abs(np.concatenate([one.poles(), two.poles()]).real)) > 1e-2)
    omega = np.tan(np.linspace(-np.pi / 2, np.pi / 2, 20001)[1:-1])
    product = responses(two, omega).conj().transpose(0, 2, 1) @ responses(one, omega)
    phase = np.angle(np.linalg.det(np.eye(product.shape[1]) + product))
    steps = (np.diff(np.append(phase, phase[0])) + np.pi) % (2 * np.pi) - np.pi
    assume(np.max(np.abs(steps)) < 2)  # the grid follows the phase
    turns = -round(float(np.sum(steps)) / (2 * np.pi))
    unstable = [int(np.sum(p.poles().real > 0)) for p in (one, two)]
    assert (nu_gap(one, two) < 1) == (turns + unstable[0] - unstable[1] == 0)


@pytest.mark.long
@settings(derandomize=True, max_examples=15)
@given(seeds, orders)
def test_sampled_twins_are_as_far_apart(seed, n):
    one, two = pair(seed, n)
    solvable(one, two)
    assume(np.min(np.abs(np.concatenate([one.poles(), two.poles()]) - 1)) > 1e-2)
    assert nu_gap(sampled_twin(one), sampled_twin(two)) == pytest.approx(nu_gap(one, two), abs=1e-8)
    assert gap(sampled_twin(one), sampled_twin(two)) == pytest.approx(gap(one, two), abs=1e-7)


@pytest.mark.parametrize("rate", [1e-12, 1e12])
def test_units_do_not_matter(rate):
    one, two = pair(4, 5)
    fast = [StateSpace(p.A * rate, p.B * rate, p.C, p.D) for p in (one, two)]
    assert nu_gap(*fast) == pytest.approx(nu_gap(one, two), rel=1e-8)
    assert gap(*fast) == pytest.approx(gap(one, two), abs=GAP)
