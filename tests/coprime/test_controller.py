"""Margins of given controllers, and the controller that attains the largest."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.linalg as sla
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from flexopt.coprime import (
    StateSpace,
    closed_loop,
    hinf_norm,
    ncf_margin,
    optimal_controller,
    robust_margin,
    state_space,
)
from tests.coprime.oracles import responses
from tests.coprime.plants import chain, margin_or_reject, near, orders, random_plant, sampled_twin, seeds

ATTAINS = 1e-8  # relative; what optimal_controller promises is 1e-6


def lqg(plant: StateSpace, seed: int) -> StateSpace:
    """Some stabilizing controller: LQG with random weights, for negative feedback."""
    rng = np.random.default_rng(seed)
    A, B, C, D = plant.A, plant.B, plant.C, plant.D
    n, m, p = A.shape[0], B.shape[1], C.shape[0]
    Q, W = (M @ M.T + 0.1 * np.eye(n) for M in rng.normal(size=(2, n, n)))
    r, v = 10.0 ** rng.uniform(-1, 1, 2)
    if plant.dt:
        X = sla.solve_discrete_are(A, B, Q, r * np.eye(m))
        F = np.linalg.solve(r * np.eye(m) + B.T @ X @ B, B.T @ X @ A)
        Y = sla.solve_discrete_are(A.T, C.T, W, v * np.eye(p))
        L = A @ Y @ C.T @ np.linalg.inv(v * np.eye(p) + C @ Y @ C.T)
    else:
        F = B.T @ sla.solve_continuous_are(A, B, Q, r * np.eye(m)) / r
        L = sla.solve_continuous_are(A.T, C.T, W, v * np.eye(p)) @ C.T / v
    return StateSpace(A - B @ F - L @ (C - D @ F), L, F, np.zeros((m, p)), plant.dt)


@pytest.mark.parametrize(("gain", "printed"), [(1.0, 0.7069), (10.0, 0.0995)])
def test_margin_printed_by_matlab(gain, printed):
    assert ncf_margin((0.001, 4.0, 1.0), gain) == pytest.approx(printed, abs=5e-5)  # printed to four digits


@pytest.mark.parametrize("k", [0.1, 0.5, 1.0, 3.0])
def test_integrator_with_a_gain_in_closed_form(k):
    """1/s with k: b = inf_ω |jω + k|/√((1 + ω²)(1 + k²)) = min(1, k)/√(1 + k²)."""
    assert ncf_margin(chain(1), k) == pytest.approx(min(1.0, k) / math.sqrt(1 + k * k), rel=1e-10)


def test_unstable_ill_posed_and_signs():
    assert ncf_margin(chain(1), -1.0) == 0.0
    assert ncf_margin(chain(1), -1.0, sign=1) == pytest.approx(math.sqrt(0.5), rel=1e-10)
    assert ncf_margin(chain(2), 1.0) == 0.0  # poles on the axis
    assert ncf_margin((-1.0, 1.0, 1.0, 1.0), -1.0) == 0.0  # I + PK singular at infinity
    assert closed_loop((-1.0, 1.0, 1.0, 1.0), -1.0) is None
    assert ncf_margin((np.diag([1.0, -1.0]), [[0.0], [1.0]], [[0.0, 1.0]]), 0.0) == 0.0  # hidden unstable mode
    assert ncf_margin(2.0, 2.0) == pytest.approx(1.0, rel=1e-14)


@pytest.mark.long
@settings(derandomize=True, max_examples=15)
@given(seeds, orders, st.sampled_from([0.0, 0.1]))
def test_margin_is_the_least_over_a_dense_grid(seed, n, dt):
    """b ≤ ‖[K; I](I + PK)⁻¹[I P]‖⁻¹ at every frequency of a grid, and close to the least of them."""
    plant = random_plant(seed, n, dt)
    margin_or_reject(plant, 1e6)
    K = lqg(plant, seed)
    margin = ncf_margin(plant, K)
    assert margin > 0
    omega = np.linspace(0, np.pi, 4000) if dt else np.concatenate([[0], np.geomspace(1e-3, 1e4, 4000)])
    P, C = responses(plant, omega), responses(K, omega)
    eye = np.eye(P.shape[1])
    inner = np.linalg.inv(eye + P @ C)
    T = np.concatenate([C, np.broadcast_to(eye, (len(omega), *eye.shape))], axis=1) @ inner
    T = T @ np.concatenate([np.broadcast_to(eye, (len(omega), *eye.shape)), P], axis=2)
    on_grid = 1 / np.max(np.linalg.norm(T, 2, axis=(1, 2)))
    assert margin <= on_grid * (1 + 1e-9)
    assert margin == pytest.approx(on_grid, rel=2e-2)  # peaks between grid points


@pytest.mark.parametrize(("k", "order"), [(1, 0), (2, 1), (3, 2), (4, 3)])
def test_controllers_of_integrators(k, order):
    epsilon = float(robust_margin(*chain(k)))
    K = optimal_controller(*chain(k))
    assert K.n_states == order
    assert ncf_margin(chain(k), K) == pytest.approx(epsilon, rel=1e-10)


def test_controllers_in_closed_form():
    assert optimal_controller(*chain(1)).D[0, 0] == pytest.approx(1.0, rel=1e-14)
    # 1/s²: the optimal controller (c s + 1)/(s + c) with c = 1 + √2, whose loop has a constant singular value.
    K = optimal_controller(*chain(2))
    s = 0.7j
    c = 1 + math.sqrt(2)
    assert complex(K.at([s])[0, 0, 0]) == pytest.approx((c * s + 1) / (s + c), rel=1e-12)
    assert pytest.approx(np.array([[3.0], [1.0]]), rel=1e-14) == optimal_controller([], [], [], [[3.0, 1.0]]).D


@pytest.mark.long
@settings(derandomize=True, max_examples=30)
@given(seeds, orders, st.sampled_from([0.0, 0.1]))
def test_optimal_controller_attains_and_is_smaller_than_the_plant(seed, n, dt):
    plant = random_plant(seed, n, dt)
    result = margin_or_reject(plant, 1e7)
    K = optimal_controller(plant)
    assert K.n_states < n
    assert K.D.shape == plant.D.shape[::-1]
    assert K.dt == plant.dt
    assert ncf_margin(plant, K) == pytest.approx(float(result), rel=ATTAINS)
    T = closed_loop(plant, K)
    assert hinf_norm(T) == pytest.approx(1 / float(result), rel=ATTAINS)


@pytest.mark.long
@settings(derandomize=True, max_examples=30)
@given(seeds, orders, st.sampled_from([0.0, 0.1]))
def test_no_controller_beats_the_optimum(seed, n, dt):
    plant = random_plant(seed, n, dt)
    result = margin_or_reject(plant, 1e7)
    for k in range(3):
        assert ncf_margin(plant, lqg(plant, seed + k)) <= float(result) * (1 + 1e-9)


@settings(derandomize=True, max_examples=12)
@given(seeds, orders)
def test_neighbours_of_the_optimal_controller_are_no_better(seed, n):
    plant = random_plant(seed, n)
    result = margin_or_reject(plant, 1e6)
    K = optimal_controller(plant)
    for k in range(3):
        assert ncf_margin(plant, near(K, seed + k, 1e-3)) <= float(result) * (1 + 1e-9)


@settings(derandomize=True, max_examples=12)
@given(seeds, orders)
def test_sampled_twins_have_the_same_margin(seed, n):
    plant = random_plant(seed, n)
    K = lqg(plant, seed)
    assume(np.min(np.abs(np.concatenate([plant.poles(), K.poles()]) - 1)) > 1e-2)
    assert ncf_margin(sampled_twin(plant), sampled_twin(K)) == pytest.approx(ncf_margin(plant, K), rel=1e-7)


@pytest.mark.parametrize(
    "plant",
    [
        (np.diag([1.0, -1.0]), [[1.0], [1.0]], [[1.0, 1.0]], 0.0, 1.0),  # poles at both real points of the circle
        (-1.0, 1.0, 1.0, 0.5, 1.0),
        (np.diag([-1.0, -1.0]), np.eye(2), np.eye(2), np.zeros((2, 2)), 1.0),
        (*chain(3), 0.0, 1.0),  # delays: A is singular
        (np.array([[0.0, -1.0], [1.0, 0.0]]), [[1.0], [0.0]], [[0.0, 1.0]], 0.0, 1.0),
    ],
)
def test_sampled_plants_with_poles_on_the_circle_or_at_zero(plant):
    K = optimal_controller(plant)
    assert ncf_margin(plant, K) == pytest.approx(float(robust_margin(plant)), rel=ATTAINS)
    assert K.n_states < state_space(plant).n_states


def test_repeated_largest_value_lowers_the_order_further():
    """Two integrators side by side: both ν are 1, and the controller is a gain."""
    K = optimal_controller(np.zeros((2, 2)), np.eye(2), np.eye(2))
    assert K.n_states == 0
    np.testing.assert_allclose(K.D, np.eye(2), atol=1e-14)


@pytest.mark.parametrize("rate", [1e-12, 1e12])
def test_controllers_in_other_units(rate):
    plant = random_plant(3, 5)
    fast = StateSpace(plant.A * rate, plant.B * rate, plant.C, plant.D)
    assert ncf_margin(fast, optimal_controller(fast)) == pytest.approx(float(robust_margin(plant)), rel=ATTAINS)
