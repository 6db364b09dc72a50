"""M, h, g, J, Jv, J_B, K, D and the end-point against Lagrange's equations, MuJoCo and Pinocchio."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings

from flexopt import build_plant, load
from flexopt.model import machine_from_dict
from tests.oracles.lagrange import coordinate_names, lagrange, rest_values, springs_and_dampers
from tests.oracles.machines import (
    NumpySource,
    Structure,
    draw_machine,
    machines,
    random_posture,
    seeds,
)
from tests.oracles.mujoco_chain import mujoco_chain
from tests.oracles.pinocchio_chain import pinocchio_chain

RELATIVE = 1e-12
# One structure for each way a coordinate can be missing or added.
STRUCTURES = [
    Structure(2, ("x", "y", "rotation"), ()),
    Structure(2, ("x",), ()),
    Structure(2, ("y",), ()),
    Structure(3, ("rotation",), ()),
    Structure(3, ("x", "rotation"), (0,)),
    Structure(3, ("y", "rotation"), (1,)),
    Structure(4, ("x", "y"), (3,)),
    Structure(4, (), (0, 2)),
    Structure(5, ("x", "y", "rotation"), (1, 4)),
    Structure(5, ("x", "y", "rotation"), ()),
]


def close(actual, expected, scale=None, relative=RELATIVE):
    actual, expected = np.asarray(actual), np.asarray(expected)
    assert actual.shape == expected.shape
    size = np.linalg.norm(expected) if scale is None else scale
    assert np.linalg.norm(actual - expected) <= relative * size


def state(rng, machine):
    plant = build_plant(machine)
    n = plant.n_coordinates
    return plant, rng.uniform(-3, 3, n), rng.uniform(-2, 2, n), float(rng.uniform(-5, 5))


def from_flexopt(plant, q, v, base):
    p = plant.parameter_values
    return {
        "M": plant.mass(q, base, p).full(),
        "h": plant.bias(q, v, base, p).full().ravel(),
        "g": plant.gravity(q, base, p).full().ravel(),
        "r": plant.end_point(q, base, p).full().ravel(),
        "J": plant.jacobian(q, base, p).full(),
        "Jv": plant.rigid_jacobian(q, base, p).full(),
    }


def gravity_scale(data):
    """Weight times size: rounding in a component of g is relative to the terms that it is a sum of."""
    links = data["links"]
    weight = data["base"]["mass"] + data["payload"]["mass"] + sum(link["mass"] for link in links)
    return data["gravity"] * weight


def bias_scale(data, v):
    """Size of one centrifugal term, for the same reason; the terms of h cancel where speeds do."""
    return gravity_scale(data) / data["gravity"] * float(v @ v)


@pytest.mark.parametrize("structure", STRUCTURES, ids=str)
@pytest.mark.parametrize("seed", range(4))
def test_every_quantity_agrees_with_three_oracles(structure, seed):
    rng = np.random.default_rng(seed)
    data = draw_machine(NumpySource(rng), structure)
    machine = machine_from_dict(data)
    plant, q, v, base = state(rng, machine)
    assert list(plant.coordinates) == coordinate_names(data)
    ours, m = from_flexopt(plant, q, v, base), plant.n_passive

    mass, bias, gravity, tip, jacobian, points = (x.full() for x in lagrange(data).dynamics(q, v, base))
    close(ours["M"], mass)
    close(ours["h"], bias.ravel(), bias_scale(data, v))
    close(ours["g"], gravity.ravel(), gravity_scale(data))
    close(ours["r"], tip.ravel())
    close(ours["J"], jacobian)
    close(ours["Jv"], jacobian[:, m:])
    close(plant.skeleton(q, base, plant.parameter_values).full(), points)

    chain = mujoco_chain(data, base)
    chain.set(q, v)
    close(ours["M"], chain.mass())
    close(ours["h"], chain.bias(), bias_scale(data, v))
    close(ours["r"], chain.end_point())
    close(ours["J"], chain.jacobian())
    chain.set(q, v, gravity=data["gravity"])
    close(ours["h"] + ours["g"], chain.bias(), bias_scale(data, v) + gravity_scale(data))

    pinocchio = pinocchio_chain(data, base)
    close(ours["M"], pinocchio.mass(q))
    close(ours["g"], pinocchio.gravity(q), gravity_scale(data))
    close(ours["h"] + ours["g"], pinocchio.nonlinear_effects(q, v), bias_scale(data, v) + gravity_scale(data))
    close(ours["r"], pinocchio.end_point(q))
    close(ours["J"], pinocchio.jacobian(q))
    close(ours["Jv"], pinocchio.jacobian(q)[:, m:])


@settings(derandomize=True, max_examples=12)
@given(drawn=machines(), seed=seeds)
def test_dynamics_of_any_machine(drawn, seed):
    data, machine = drawn
    plant, q, v, base = state(np.random.default_rng(seed), machine)
    ours = from_flexopt(plant, q, v, base)
    mass, bias, gravity, tip, jacobian, _ = (x.full() for x in lagrange(data).dynamics(q, v, base))
    close(ours["M"], mass)
    close(ours["h"], bias.ravel(), bias_scale(data, v))
    close(ours["g"], gravity.ravel(), gravity_scale(data))
    close(ours["r"], tip.ravel(), 1 + np.linalg.norm(tip))
    close(ours["J"], jacobian)
    close(ours["M"], ours["M"].T, relative=1e-15)


@settings(derandomize=True, max_examples=12)
@given(drawn=machines(), seed=seeds)
def test_equations_of_motion_leave_no_residual_against_mujoco(drawn, seed):
    data, machine = drawn
    rng = np.random.default_rng(seed)
    plant, q, v, base = state(rng, machine)
    acceleration, p = rng.uniform(-5, 5, len(q)), plant.parameter_values
    rest = plant.rest(base, np.zeros(plant.n_actuated), p).full().ravel()
    stiffness, damping = plant.stiffness(p).full(), plant.damping(p).full()
    ours = from_flexopt(plant, q, v, base)
    terms = [ours["M"] @ acceleration, ours["h"], ours["g"], stiffness @ (q - rest), damping @ v]
    expected = mujoco_chain(data, base).inverse(q, v, acceleration, gravity=data["gravity"])
    close(sum(terms), expected, sum(np.linalg.norm(term) for term in terms))


@settings(derandomize=True, max_examples=8)
@given(drawn=machines(), seed=seeds)
def test_springs_dampers_and_rest(drawn, seed):
    data, machine = drawn
    rng = np.random.default_rng(seed)
    plant, posture, base = build_plant(machine), random_posture(rng, machine), float(rng.uniform(-5, 5))
    stiffness, damping = springs_and_dampers(data)
    p = plant.parameter_values
    assert np.array_equal(plant.stiffness(p).full(), stiffness)
    assert np.array_equal(plant.damping(p).full(), damping)
    assert np.array_equal(plant.rest(base, posture, p).full().ravel(), rest_values(data, base, posture))
    assert np.count_nonzero(stiffness) == plant.n_passive
    assert np.linalg.matrix_rank(stiffness[: plant.n_passive, : plant.n_passive]) == plant.n_passive


@settings(derandomize=True, max_examples=8)
@given(drawn=machines(), seed=seeds)
def test_base_jacobian_moves_anchor_and_arm(drawn, seed):
    data, machine = drawn
    rng = np.random.default_rng(seed)
    plant, posture, base = build_plant(machine), random_posture(rng, machine), float(rng.uniform(-5, 5))
    p = plant.parameter_values
    got = plant.base_jacobian(base, posture, p).full()
    # The base carries everything along x; the rest is the oracle's own Jacobian at rest.
    rest = rest_values(data, base, posture)
    jacobian = lagrange(data).dynamics(rest, np.zeros(len(rest)), base)[4].full()
    close(got, np.hstack([[[1.0], [0.0]], jacobian[:, plant.n_passive :]]))


@settings(derandomize=True, max_examples=8)
@given(drawn=machines({"n_max": 4}), seed=seeds)
def test_gravity_stiffness_is_the_passive_block_of_the_oracles(drawn, seed):
    data, machine = drawn
    plant, q, _, base = state(np.random.default_rng(seed), machine)
    expected = lagrange(data).tangent(q, base).full()[: plant.n_passive, : plant.n_passive]
    close(plant.gravity_stiffness(q, base, plant.parameter_values).full(), expected, gravity_scale(data))


def test_mass_matrix_of_a_compound_pendulum_from_the_textbook():
    # Steiner: a rod on a hinge has m L²/3; the rest of the machine is far heavier and stands still here (column of q_n).
    data = draw_machine(NumpySource(np.random.default_rng(3)), Structure(2, ("x",), ()))
    data["payload"]["mass"] = 0.0
    rod = data["links"][1]
    rod |= {"com": rod["length"] / 2, "com_offset": 0.0, "inertia": rod["mass"] * rod["length"] ** 2 / 12}
    plant = build_plant(machine_from_dict(data))
    mass = plant.mass([0.3, 0.4, 0.5], 0.0, plant.parameter_values).full()
    assert math.isclose(mass[-1, -1], rod["mass"] * rod["length"] ** 2 / 3, rel_tol=1e-14)


def test_forgotten_input_shows_as_nan():
    plant = build_plant(load("excavator"))
    assert np.isnan(plant.mass(base=0.0, p=plant.parameter_values)["M"].full()).any()
