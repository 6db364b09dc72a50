"""A, B, C against automatic differentiation of Lagrange's nonlinear equations; static deflection against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.optimize import root

from flexopt import build_plant
from tests.oracles.controls import task_map
from tests.oracles.lagrange import lagrange, rest_values, springs_and_dampers
from tests.oracles.machines import machines, regular_posture, seeds

STIFF = {"frequency": (4.0, 10.0)}  # stands upright under gravity


def expected_plant(oracle, q, base, rest, n_passive, control, stiffness=None, damping=None):
    """A, B, C of M v̇ = F(q, v) + E u about a configuration at rest; `stiffness` replaces −∂F/∂q."""
    n = len(q)
    mass, _, _, _, jacobian, _ = (x.full() for x in oracle.dynamics(q, np.zeros(n), base))
    force, by_q, by_v = (x.full() for x in oracle.force(q, np.zeros(n), base, rest))
    if stiffness is None:
        # F = 0 here, so ∂(M⁻¹F)/∂q = M⁻¹ ∂F/∂q without a term in ∂M/∂q.
        assert not force.any()
        stiffness = -by_q
    jv = jacobian[:, n_passive:]
    task = task_map(jv, control)
    a = np.block([[np.linalg.solve(mass, by_v), -np.linalg.solve(mass, stiffness)], [np.eye(n), np.zeros((n, n))]])
    b = np.vstack([np.linalg.solve(mass, np.vstack([np.zeros((n_passive, 2)), task])), np.zeros((n, 2))])
    return a, b, np.hstack([np.zeros((2, n)), jacobian]), mass


def compare(got, expected, mass):
    # Both sides solve with M: rounding is amplified by its condition number, which is below 1e6 for these machines.
    tolerance = 1e-15 * max(np.linalg.cond(mass), 1e3)
    for ours, theirs in zip(got, expected, strict=True):
        assert np.linalg.norm(ours - theirs) <= tolerance * np.linalg.norm(theirs)


@pytest.mark.parametrize("control", ["inverse", "transpose", "damped:0.3"])
@settings(derandomize=True, max_examples=8)
@given(drawn=machines(), seed=seeds)
def test_linear_plant_is_the_derivative_of_the_nonlinear_one(control, drawn, seed):
    data, machine = drawn
    rng = np.random.default_rng(seed)
    plant, posture, base = build_plant(machine), regular_posture(rng, machine), float(rng.uniform(-5, 5))
    got = [x.full() for x in plant.linearisation(control)(base, posture, plant.parameter_values)]
    rest = rest_values(data, base, posture)
    *expected, mass = expected_plant(lagrange(data), rest, base, rest, plant.n_passive, control)
    compare(got, expected, mass)


@settings(derandomize=True, max_examples=6)
@given(drawn=machines({"n_min": 3}), seed=seeds)
def test_redundant_arm_is_driven_by_the_moore_penrose_inverse(drawn, seed):
    _, machine = drawn
    plant, posture = build_plant(machine), regular_posture(np.random.default_rng(seed), machine)
    n, m, p = plant.n_coordinates, plant.n_passive, plant.parameter_values
    b = plant.linearisation("inverse")(0.0, posture, p)[1].full()
    q = plant.rest(0.0, posture, p)
    torque = plant.mass(q, 0.0, p).full() @ b[:n]  # E Jv⁺
    jv = plant.rigid_jacobian(q, 0.0, p).full()
    scale = np.linalg.norm(torque)
    # Multiplying M back onto M⁻¹ E Jv⁺ costs cond M, below 1e6.
    assert np.linalg.norm(torque[:m]) <= 1e-10 * scale
    assert np.linalg.norm(torque[m:] - np.linalg.pinv(jv)) <= 1e-10 * scale


@pytest.mark.parametrize("control", ["inverse", "transpose"])
@settings(derandomize=True, max_examples=6)
@given(drawn=machines(**STIFF), seed=seeds)
def test_gravity_deflects_to_equilibrium_and_stiffens_the_passive_block_only(control, drawn, seed):
    data, machine = drawn
    rng = np.random.default_rng(seed)
    plant, posture, base = build_plant(machine), regular_posture(rng, machine, 10.0), float(rng.uniform(-5, 5))
    m, p, oracle = plant.n_passive, plant.parameter_values, lagrange(data)
    rest, (stiffness, _) = rest_values(data, base, posture), springs_and_dampers(data)

    def torque(q_p):
        q = np.concatenate([q_p, posture])
        gravity = oracle.dynamics(q, np.zeros(len(q)), base)[2].full().ravel()
        # Divided by the springs, so that rows in N and N m have one size.
        return q_p - rest[:m] + gravity[:m] / np.diag(stiffness)[:m]

    # The unknown is 1 + the deflection: MINPACK's steps and tolerances are relative to it.
    solved = rest[:m] + root(lambda x: torque(rest[:m] + x - 1), np.ones(m), tol=1e-14).x - 1
    assert np.abs(torque(solved)).max() < 1e-12
    deflected = plant.deflected(base, posture, p).full().ravel()
    assert np.abs(deflected - solved).max() < 1e-11
    assert np.abs(torque(deflected)).max() < 1e-13 * (1 + abs(base))

    q = np.concatenate([deflected, posture])
    effective = stiffness.copy()
    effective[:m, :m] += oracle.tangent(q, base).full()[:m, :m]
    got = [x.full() for x in plant.linearisation(control, gravity=True)(base, posture, p)]
    *expected, mass = expected_plant(oracle, q, base, rest, m, control, effective)
    compare(got, expected, mass)
