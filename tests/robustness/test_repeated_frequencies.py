"""Repeated and nearly repeated frequencies: finite numbers, a warning, and the measure of the cluster's sum."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.linalg import eigh

from flexopt import FlexoptWarning, build_measures, build_plant, evaluate
from flexopt.model import machine_from_dict
from tests.oracles.gradient_cases import near_repeated
from tests.oracles.machines import NumpySource, Structure, draw_machine

# Undamped, random and nearly singular plants may leave ε_max unsolved, which is warned of; nothing here is about it.
pytestmark = pytest.mark.filterwarnings("ignore:ε_max:flexopt.errors.FlexoptWarning")
CONTROLS = pytest.mark.parametrize("control", ["inverse", "transpose"])
SEEDS = pytest.mark.parametrize("seed", range(5))


def repeated_case(seed, gap=0.0):
    return near_repeated(np.random.default_rng(seed), gap, condition=20.0)


def full_modes(machine, posture):
    """SciPy's modes of the n_q × n_q problem, and J, Jv."""
    plant = build_plant(machine)
    p = plant.parameter_values
    q = plant.rest(0.0, posture, p)
    mass, stiffness = plant.mass(q, 0.0, p).full(), plant.stiffness(p).full()
    values, modes = eigh(stiffness, mass)
    jacobian = plant.jacobian(q, 0.0, p).full()
    return plant.n_passive, values, modes, jacobian, jacobian[:, plant.n_passive :]


def cluster_sum(machine, posture, control, indices):
    """λmin(S + Sᵀ) of the sum S of the residues of `indices` (vibration modes, ascending), and the sum."""
    m, _, modes, jacobian, jv = full_modes(machine, posture)
    task = jv.T if control == "transpose" else np.linalg.pinv(jv)
    chosen = modes[:, [modes.shape[0] - m + i for i in indices]]
    total = jacobian @ chosen @ (task.T @ chosen[m:]).T
    return np.linalg.eigvalsh(total + total.T)[0], total


def rounding(machine, posture, control):
    """Size of the residues that a sum may cancel, for tolerances."""
    m, _, modes, jacobian, jv = full_modes(machine, posture)
    task = jv.T if control == "transpose" else np.linalg.pinv(jv)
    vibration = modes[:, -m:]
    return sum(np.linalg.norm(jacobian @ vibration[:, i]) * np.linalg.norm(task.T @ vibration[m:, i]) for i in range(m))


def all_finite(result):
    arrays = [result.w, result.scale, result.frequencies_hz, result.damping_ratios, result.residues]
    arrays += [result.rigid_residue, result.gradient.w, result.gradient.w_parameters]
    return all(np.isfinite(array).all() for array in arrays)


@SEEDS
@CONTROLS
def test_two_equal_frequencies_give_the_measure_of_their_sum(seed, control):
    case = repeated_case(seed)
    with pytest.warns(FlexoptWarning, match="share the frequency"):
        result = evaluate(case.machine, case.posture, control=control)
    assert all_finite(result)
    assert result.clusters == ((0, 1),)
    assert sum("share the frequency" in sentence for sentence in result.warnings) == 1
    expected, total = cluster_sum(case.machine, case.posture, control, [0, 1])
    size = rounding(case.machine, case.posture, control)
    # eigh of the full problem leaves the eigenspace mixed with the rigid modes by some 1e-16 ω_max²/ω_1², here 1e-13.
    assert np.abs(result.w - expected).max() <= 1e-10 * size
    for residue in result.residues:
        assert np.linalg.norm(residue - total) <= 1e-10 * size


# The gap decides, not the machine: further machines are in the tests above and below.
@pytest.mark.parametrize("seed", range(2))
@CONTROLS
@pytest.mark.parametrize("gap", [1e-16, 1e-14, 1e-12, 1e-10, 1e-8, 1e-7, 0.9e-6, 1.1e-6, 1e-5])
def test_nearly_equal_frequencies_never_give_nan(seed, control, gap):
    case = repeated_case(seed, gap)
    clustered = case.gap <= 1e-6
    if clustered:
        with pytest.warns(FlexoptWarning, match="share the frequency"):
            result = evaluate(case.machine, case.posture, control=control)
    else:
        with warnings.catch_warnings():
            warnings.filterwarnings("error", message="modes")
            result = evaluate(case.machine, case.posture, control=control)
    assert all_finite(result)
    assert bool(result.clusters) == clustered
    if clustered:
        expected, _ = cluster_sum(case.machine, case.posture, control, [0, 1])
        assert np.abs(result.w - expected).max() <= 1e-10 * rounding(case.machine, case.posture, control)


@SEEDS
@CONTROLS
def test_gradient_of_the_cluster_measure_equals_differences_of_the_sum(seed, control):
    case = repeated_case(seed)
    with pytest.warns(FlexoptWarning, match="share the frequency"):
        result = evaluate(case.machine, case.posture, control=control)
    # Half a step of 4e-3 rad: fourth-order differences err by 1e-10 of the fifth derivative, rounding by 1e-13 / step.
    step, variables = 2e-3, len(case.posture)
    size = rounding(case.machine, case.posture, control)
    for k in range(variables):

        def at(shift, k=k):
            posture = case.posture.copy()
            posture[k] += shift
            return cluster_sum(case.machine, posture, control, [0, 1])[0]

        difference = (8 * (at(step) - at(-step)) - (at(2 * step) - at(-2 * step))) / (12 * step)
        got = result.gradient.w[:, 1 + k]
        assert np.abs(got - difference).max() <= 1e-6 * size
    assert not result.gradient.w[:, 0].any()


@CONTROLS
def test_gradient_by_parameters_of_the_cluster_measure(control):
    case = repeated_case(1)
    machine = case.machine
    with pytest.warns(FlexoptWarning, match="share the frequency"):
        result = evaluate(machine, case.posture, control=control)
    size = rounding(machine, case.posture, control)
    for link in range(len(machine.links)):
        name = f"{machine.links[link].name}.mass"
        value = machine.links[link].mass

        def at(factor, link=link, value=value):
            data = machine.to_dict()
            links = [dict(each) for each in data["links"]]
            links[link]["mass"] = value * factor
            changed = machine_from_dict(data | {"links": links})
            return cluster_sum(changed, case.posture, control, [0, 1])[0]

        step = 2e-3
        difference = (8 * (at(1 + step) - at(1 - step)) - (at(1 + 2 * step) - at(1 - 2 * step))) / (12 * step)
        column = result.gradient.parameters.index(name)
        assert np.abs(result.gradient.w_parameters[:, column] * value - difference).max() <= 1e-6 * size


def decoupled_machine(n=2):
    """All masses of the base's rotation rigid and the arm's links without offset: with kx = ky, and straight links whose
    centres lie on their joints, x and y see one and the same mass and nothing else."""
    data = draw_machine(NumpySource(np.random.default_rng(6)), Structure(n, ("x", "y"), ()), equal_xy=True)
    for link in data["links"]:
        link |= {"com": 0.0, "com_offset": 0.0}
    data["links"][-1] |= {"length": 0.5}
    data["payload"]["mass"] = 0.0
    heavy = sum(link["mass"] for link in data["links"][1:])
    # The first link's own centre balances what hangs on its end, so that the arm's rotation moves no mass.
    data["links"][0]["com"] = -heavy * data["links"][0]["length"] / data["links"][0]["mass"]
    return machine_from_dict(data)


@CONTROLS
def test_frequencies_repeated_by_symmetry_everywhere(control):
    """A balanced arm moves no centre of mass: x and y vibrate alone, at one frequency, in every posture."""
    machine = decoupled_machine()
    for posture in ([0.3, 1.0], [-1.0, 2.0], [2.0, -0.7]):
        with pytest.warns(FlexoptWarning, match="share the frequency"):
            result = evaluate(machine, posture, control=control)
        assert all_finite(result)
        assert result.clusters == ((0, 1),)
        total = machine.base.mass + sum(link.mass for link in machine.links)
        expected = np.sqrt(machine.base.stiffness.x / total) / (2 * np.pi)
        assert np.allclose(result.frequencies_hz, expected, rtol=1e-13)
        # The arm does not follow, so the base's vibration is not excited: b = 0, R = 0 and w = 0.
        assert np.abs(result.w).max() <= 1e-12 * np.linalg.norm(result.rigid_residue)


@CONTROLS
def test_three_equal_frequencies(control):
    """Links balanced about their joints and a base that turns about its own centre: x, y and rotation do not mix."""
    machine = decoupled_machine()
    data = machine.to_dict()
    centred = dict(data["base"]) | {"com": 0.0, "com_offset": 0.0, "length": 0.0}
    springs = {"x": 1e5, "y": 1e5, "rotation": 1e5}
    machine = machine_from_dict(data | {"base": centred | {"stiffness": springs}})
    plant, posture = build_plant(machine), np.array([0.4, 1.1])
    p = plant.parameter_values
    mass = plant.mass(plant.rest(0.0, posture, p), 0.0, p).full()
    compliance = np.linalg.inv(mass)[:3, :3]
    assert np.abs(compliance - np.diag(np.diag(compliance))).max() <= 1e-12 * compliance.max()
    springs["rotation"] = float(1e5 * compliance[0, 0] / compliance[2, 2])
    machine = machine_from_dict(data | {"base": centred | {"stiffness": springs}})
    with pytest.warns(FlexoptWarning, match="modes 1 and 2 and 3"):
        result = evaluate(machine, posture, control=control)
    assert result.clusters == ((0, 1, 2),)
    assert all_finite(result)
    expected, total = cluster_sum(machine, posture, control, [0, 1, 2])
    # These modes move the arm's joint, or nothing of the arm at all: compare with the size of the whole plant.
    size = np.linalg.norm(result.rigid_residue)
    assert np.abs(result.w - expected).max() <= 1e-12 * size
    assert np.linalg.norm(result.residues[0] - total) <= 1e-12 * size


@CONTROLS
def test_value_is_continuous_across_a_cluster(control):
    """The sum that a cluster gets is the sum of what the two modes have just outside it."""
    inside, outside = repeated_case(3, 5e-7), repeated_case(3, 2e-6)
    p = build_plant(outside.machine).parameter_values
    values = build_measures(outside.machine, control).values(base=0.0, posture=outside.posture, p=p)
    total = values["a"].full() @ values["b"].full().T
    with pytest.warns(FlexoptWarning, match="share the frequency"):
        result = evaluate(inside.machine, inside.posture, control=control)
    # The springs of the two machines differ by 1.5e-6 relatively.
    assert np.linalg.norm(result.residues[0] - total) <= 1e-5 * rounding(inside.machine, inside.posture, control)
