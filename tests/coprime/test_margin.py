"""ε_max against closed forms, SciPy, SLICOT, Gramians and 60 digits."""

from __future__ import annotations

import json
import math
import warnings

import control
import numpy as np
import pytest
from hypothesis import assume, given, reject, settings

from flexopt.coprime import StateSpace, robust_margin, state_space
from flexopt.coprime.margin import with_bound
from flexopt.errors import FlexoptWarning, NotStabilizable
from tests.coprime.oracles import exact_epsilon, hankel_epsilon, scipy_epsilon, slicot_epsilon
from tests.coprime.plants import (
    chain,
    in_coordinates,
    margin_or_reject,
    orders,
    parts,
    random_plant,
    sampled_twin,
    seeds,
)

RELATIVE = 1e-9  # of the oracles, which do not scale the plant; on condition estimates below 1e7


@pytest.mark.parametrize(("k", "epsilon"), [(1, math.sin(math.pi / 4)), (2, math.sin(math.pi / 8))])
def test_integrators_in_closed_form(k, epsilon):
    assert float(robust_margin(*chain(k))) == pytest.approx(epsilon, rel=1e-14)


@pytest.mark.parametrize("k", [3, 4, 5, 6])
def test_longer_chains_against_sixty_digits(k):
    plant = state_space(chain(k))
    assert float(robust_margin(plant)) == pytest.approx(exact_epsilon(plant), rel=1e-13)


def test_triple_integrator_has_the_printed_value():
    assert float(robust_margin(*chain(3))) == pytest.approx(0.16910, abs=5e-6)  # printed to five digits


@pytest.mark.parametrize("decade", range(-6, 7))
def test_double_integrator_does_not_depend_on_its_gain(decade):
    assert float(robust_margin(*chain(2, 10.0**decade))) == pytest.approx(math.sin(math.pi / 8), rel=1e-13)


@pytest.mark.parametrize(("a", "b"), [(0.5, 2.0), (-0.5, 2.0), (3.0, 1e-3), (-3.0, 1e3), (1e-6, 1.0)])
def test_first_order_in_closed_form(a, b):
    """b/(s − a): X = Z = (a + c)/b with c = √(a² + b²)."""
    x = b / (math.hypot(a, b) - a) if a < 0 else (a + math.hypot(a, b)) / b
    result = robust_margin(a, b, 1.0)
    # Here B = b and C = 1, so X = x/b and Z = x b.
    assert result.X[0, 0] == pytest.approx(x / b, rel=1e-12)
    assert result.Z[0, 0] == pytest.approx(x * b, rel=1e-12)
    assert float(result) == pytest.approx(1 / math.sqrt(1 + x * x), rel=1e-12)


def test_glover_mcfarlane_example():
    s = control.tf("s")
    plant = control.ss(200 / ((10 * s + 1) * (0.05 * s + 1) ** 2) * (s + 2) / (s + 1e-6))
    assert 1 / float(robust_margin(plant)) == pytest.approx(2.34, abs=5e-3)  # printed to three digits


def test_loop_shaping_example_of_matlab():
    """P = 16/(s² + 0.16 s + 16) with (1 + 0.8/s)/(1 + s/20): MATLAB's documentation prints γ = 1.9885 and 1.9903."""
    s = control.tf("s")
    result = robust_margin(16 / (s**2 + 0.16 * s + 16) * (1 + 0.8 / s) / (s / 20 + 1))
    assert 1 / float(result) == pytest.approx(1.9885, abs=2e-4)  # the lower one; its search stops at a tolerance


def test_integral_action_on_a_resonance():
    """(s + 5)/(s² + 2 s + 10)/s; the 0.6325 once noted for it does not come out, by any of these four routes."""
    s = control.tf("s")
    plant = state_space(control.ss((s + 5) / (s**2 + 2 * s + 10) / s))
    value = float(robust_margin(plant))
    for oracle in (scipy_epsilon, slicot_epsilon, hankel_epsilon, exact_epsilon):
        assert value == pytest.approx(oracle(plant), rel=1e-11)
    assert value == pytest.approx(0.68935, abs=1e-5)


@settings(derandomize=True, max_examples=40)
@given(seeds, orders)
def test_continuous_plants_against_scipy_slicot_and_gramians(seed, n):
    plant = random_plant(seed, n)
    result = margin_or_reject(plant, 1e7)
    assert max(result.residual_x, result.residual_z) < 1e-12
    assert result.agreement < 1e-10
    assert float(result) == pytest.approx(scipy_epsilon(plant), rel=RELATIVE)
    assert float(result) == pytest.approx(slicot_epsilon(plant), rel=RELATIVE)
    # 1 − ‖·‖_H² cancels where the margin is small.
    assert float(result) == pytest.approx(hankel_epsilon(plant), rel=RELATIVE / float(result) ** 2)


@settings(derandomize=True, max_examples=40)
@given(seeds, orders)
def test_sampled_plants_against_scipy_and_slicot(seed, n):
    plant = random_plant(seed, n, dt=0.05)
    result = margin_or_reject(plant, 1e7)
    assert float(result) == pytest.approx(scipy_epsilon(plant), rel=RELATIVE)
    assert float(result) == pytest.approx(slicot_epsilon(plant), rel=RELATIVE)


@settings(derandomize=True, max_examples=15)
@given(seeds, orders)
def test_sampled_twin_has_the_same_margin_and_solutions(seed, n):
    plant = random_plant(seed, n)
    assume(np.min(np.abs(np.linalg.eigvals(plant.A) - 1)) > 1e-2)  # the twin of a pole at 1 is infinite
    here = margin_or_reject(plant, 1e6)
    there = robust_margin(sampled_twin(plant))
    assert float(there) == pytest.approx(float(here), rel=1e-8)  # the inverse of I − A costs digits
    np.testing.assert_allclose(there.X, here.X, rtol=1e-6, atol=1e-8 * np.linalg.norm(here.X))


@settings(derandomize=True, max_examples=20)
@given(seeds, orders)
def test_riccati_equations_hold_in_the_callers_coordinates(seed, n):
    plant = random_plant(seed, n)
    A, B, C, D = parts(plant)
    result = robust_margin(A, B, C, D)
    S, R = np.eye(D.shape[1]) + D.T @ D, np.eye(D.shape[0]) + D @ D.T
    F = A - B @ np.linalg.inv(S) @ D.T @ C
    G, H = B @ np.linalg.inv(S) @ B.T, C.T @ np.linalg.inv(R) @ C
    X, Z = result.X, result.Z
    for residual, size in (
        (F.T @ X + X @ F - X @ G @ X + H, np.linalg.norm(X @ G @ X) + 2 * np.linalg.norm(X @ F) + np.linalg.norm(H)),
        (F @ Z + Z @ F.T - Z @ H @ Z + G, np.linalg.norm(Z @ H @ Z) + 2 * np.linalg.norm(F @ Z) + np.linalg.norm(G)),
    ):
        assert np.linalg.norm(residual) <= 1e-10 * size


@pytest.mark.long
@settings(derandomize=True, max_examples=20)
@given(seeds)
def test_time_and_state_units_do_not_matter(seed):
    plant = random_plant(seed, 5)
    rng = np.random.default_rng(seed)
    base = margin_or_reject(plant, 1e7)
    for rate in (1e-12, 1e12):
        units = np.diag(10.0 ** rng.uniform(-12, 12, 5))
        twin = in_coordinates(plant, units)
        other = StateSpace(twin.A * rate, twin.B * rate, twin.C, twin.D)
        assert float(robust_margin(other)) == pytest.approx(float(base), rel=RELATIVE)


@pytest.mark.parametrize("seed", range(6))
def test_repeated_poles_in_disguise_against_sixty_digits(seed):
    """An integrator chain behind a dense change of coordinates: poles scatter by ε^(1/4), the margin does not."""
    rng = np.random.default_rng(seed)
    A = np.zeros((6, 6))
    A[:4, :4], A[4:, 4:] = np.diag(np.ones(3), 1), -np.eye(2)
    plain = StateSpace(A, rng.normal(size=(6, 1)), rng.normal(size=(1, 6)), np.zeros((1, 1)))
    plant = in_coordinates(plain, rng.normal(size=(6, 6)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FlexoptWarning)
        result = robust_margin(plant)
    assert float(result) == pytest.approx(exact_epsilon(plant), rel=max(1e-12, 1e-14 * result.condition))


def test_lightly_damped_machine_like_plant_against_sixty_digits():
    """Double poles at 0 beside modes at 3 … 22 Hz with ζ = 2e-4 and stiffnesses of 4e7, gain 5e5."""
    omega, gain = 2 * np.pi * np.array([3.1, 13.1, 22.4]), 5e5
    A = np.zeros((8, 8))
    A[0, 1] = 1.0
    for i, w in enumerate(omega):
        A[2 + 2 * i : 4 + 2 * i, 2 + 2 * i : 4 + 2 * i] = [[0, 1], [-(w**2), -4e-4 * w]]
    B, C = np.zeros((8, 1)), np.zeros((1, 8))
    B[1::2, 0], C[0, ::2] = gain * np.array([1e-3, 1e-4, -2e-4, 3e-5]), 1.0
    plant = StateSpace(A, B, C, np.zeros((1, 1)))
    result = robust_margin(plant)
    assert float(result) == pytest.approx(exact_epsilon(plant), rel=1e-11)
    assert result.agreement < 1e-10


def test_a_gain_has_margin_one():
    assert float(robust_margin([], [], [], [[3.0, 1.0]])) == 1.0


def test_hidden_stable_modes_do_not_matter():
    assert float(robust_margin(np.diag([0.0, -1.0]), [[1.0], [0.0]], [[1.0, 0.0]])) == pytest.approx(
        math.sin(math.pi / 4), rel=1e-14
    )


@pytest.mark.parametrize("weight", [1e-3, 1e-5, 1e-8])
def test_weakly_reached_unstable_mode(weight):
    """weight/(s − 1): ε_max = 1/√(1 + x²), x = (1 + √(1 + weight²))/weight."""
    x = (1 + math.hypot(1, weight)) / weight
    assert float(robust_margin(1.0, weight, 1.0)) == pytest.approx(1 / math.sqrt(1 + x * x), rel=1e-12)


def test_chain_of_delays():
    """z^−k is inner, so [Ñ M̃] = [z^−k, 1]/√2 has the Hankel norm 1/√2, and ε_max = sin(π/4) for every k."""
    for k in (1, 2, 3, 6):
        assert float(robust_margin(*chain(k), dt=1.0)) == pytest.approx(math.sin(math.pi / 4), rel=1e-13)


def test_result_reads_well_and_is_json_ready():
    result = robust_margin(*chain(2))
    document = json.loads(json.dumps(result.to_dict()))
    assert document["epsilon_max"] == float(result)
    assert document["method"] == "doubling"
    assert "ε_max = 0.3826834324" in repr(result)


def badly_conditioned(count):
    """Integrator chains behind dense coordinates, of which doubling and Schur vectors share few digits."""
    rng = np.random.default_rng(5)
    A = np.zeros((6, 6))
    A[:4, :4], A[4:, 4:] = np.diag(np.ones(3), 1), -np.eye(2)
    for _ in range(count):
        plain = StateSpace(A, rng.normal(size=(6, 1)), rng.normal(size=(1, 6)), np.zeros((1, 1)))
        yield in_coordinates(plain, rng.normal(size=(6, 6)))


@pytest.mark.long
def test_badly_conditioned_plants_are_within_their_bound():
    apart = 0
    for plant in badly_conditioned(60):
        try:
            result = robust_margin(plant)
        except NotStabilizable:  # the chain, within rounding
            continue
        assert result.error_bound <= 1e-6 * float(result)
        if result.agreement is None or result.agreement > 1e-7:
            apart += 1
            assert abs(exact_epsilon(plant) - float(result)) <= result.error_bound
    assert apart


@pytest.mark.long
@settings(derandomize=True, max_examples=20)
@given(seeds, orders)
def test_every_margin_is_within_its_bound(seed, n):
    """Poles and gains over six decades, half of them lightly damped."""
    rng = np.random.default_rng(seed)
    plant = random_plant(seed, n)
    units = 10.0 ** rng.uniform(-3, 3, n)
    A = plant.A * units if seed % 2 else (plant.A - plant.A.T) * units - 1e-6 * np.diag(units)
    plant = StateSpace(A, plant.B * units[:, None], plant.C, 0 * plant.D)
    try:
        result = robust_margin(plant)
    except NotStabilizable:
        reject()
    exact = exact_epsilon(plant, 80)
    assert abs(exact - float(result)) <= result.error_bound <= 1e-6 * exact


def test_a_bound_is_printed_so_that_it_holds():
    for value, bound in ((0.38268343, 3e-13), (0.3826834323650898, 2e-5), (1.25e-9, 4e-16), (0.5, 0.0), (0.1, 0.02)):
        text, printed = with_bound(value, bound).split(" ± ")
        assert abs(float(text) - value) + bound <= float(printed)
        assert float(printed) <= 2.2 * bound + 1e-10 * value
