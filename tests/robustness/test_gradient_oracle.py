"""Gradients of the measures against the article's Appendix B, written independently in 45 digits."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from flexopt import build_measures, build_plant
from tests.oracles.appendix_b import AppendixB, Matrices
from tests.oracles.gradient_cases import cases, compare, matrices
from tests.oracles.machines import Structure, random_machine, regular_posture

TOLERANCE = 1e-9
BATCHES, PER_BATCH = 3, 30  # 90 machines and postures, both controllers each


@pytest.mark.long
@pytest.mark.parametrize("batch", range(BATCHES))
def test_posture_gradients_equal_appendix_b(batch):
    compared, seen = 0, set()
    for case in cases(100 + batch, PER_BATCH):
        assert case.gap >= 1e-3
        assert case.condition <= 50
        for result in compare(case):
            assert result.errors.shape == (len(result.values), len(case.machine.joints))
            assert result.errors.max() <= TOLERANCE, (case, result.control)
            # M̄ = M_pp − M_pa M̂⁻¹ M_ap cancels up to five digits for a long arm on a light base.
            assert result.values.max() <= 1e-10, (case, result.control)
            assert not result.base_gradient.any()  # x carries the whole machine along
        compared += 1
        seen.add((len(case.machine.links), len(result.values)))
    assert compared == PER_BATCH
    assert len(seen) >= 10


@pytest.mark.long("0")
@pytest.mark.parametrize("seed", range(2))
def test_parameter_gradients_equal_appendix_b(seed):
    for case in cases(500 + seed, 8, postures=1):
        for result in compare(case, "parameters"):
            assert result.errors.max() <= TOLERANCE, (case, result.control)


@pytest.mark.parametrize("gravity", [False, True])
@pytest.mark.parametrize("control", ["inverse", "transpose"])
def test_gradients_under_gravity_and_by_parameters_equal_differences(control, gravity):
    rng = np.random.default_rng(8)
    structures = [
        Structure(2, ("x", "y", "rotation"), ()),
        Structure(3, ("x", "rotation"), (1,)),
        Structure(4, ("y", "rotation"), ()),
    ]
    for structure in structures:
        _, machine = random_machine(rng, structure, frequency=(4.0, 10.0), spread=100.0)
        measures, plant = build_measures(machine, control, gravity), build_plant(machine)
        z, p = np.append(0.3, regular_posture(rng, machine, 10.0)), plant.parameter_values.full().ravel()

        def w(z, p, measures=measures):
            return measures.w(base=z[0], posture=z[1:], p=p)["w"].full().ravel()

        got = measures.gradients(base=z[0], posture=z[1:], p=p)
        scale = measures.w(base=z[0], posture=z[1:], p=p)["scale"].full().ravel()
        for k in range(len(z)):
            near(got["w_z"].full()[:, k], partial(along, w, (z, p), 0, k, 1.0), 1e-3, scale)
        for k in range(len(p)):
            size = abs(p[k]) or 1.0
            near(got["w_p"].full()[:, k] * size, partial(along, w, (z, p), 1, k, size), 1e-3, scale)


def along(function, arguments, which, index, size, step):
    """The function with one entry of one argument moved by `step` times `size`."""
    changed = list(arguments)
    changed[which] = moved(changed[which], index, step * size)
    return function(*changed)


def moved(vector, index, step):
    out = np.array(vector, dtype=float)
    out[index] += step
    return out


def near(derivative, function, step, scale):
    """Sixth-order central differences: error ~ step⁶ times the 7th derivative, and rounding 1e-13 / step."""
    weights = {1: 45, 2: -9, 3: 1}
    total = sum(c * (function(k * step) - function(-k * step)) for k, c in weights.items()) / (60 * step)
    assert np.abs(derivative - total).max() <= 1e-7 * scale.max()


def test_the_oracle_itself_reproduces_its_derivative_by_differences():
    rng = np.random.default_rng(2)
    _, machine = random_machine(rng, Structure(3, ("x", "rotation"), (0,)))
    posture = regular_posture(rng, machine)
    plant, step = build_plant(machine), 1e-5
    at, along = matrices(machine, posture, "posture")
    oracle = AppendixB(at, plant.n_passive)

    def shifted(sign):
        parts = zip(vars(at).values(), vars(along[0]).values(), strict=True)
        return AppendixB(Matrices(*(v + sign * step * d for v, d in parts)), plant.n_passive)

    plus, minus = shifted(1), shifted(-1)
    derivative = oracle.differentiate(along[0])
    for control in ("inverse", "transpose"):
        for i in range(plant.n_passive):
            difference = (plus.w(i, control) - minus.w(i, control)) / (2 * step)
            # Second-order differences in 45 digits, results rounded to doubles: 1e-16 / 1e-5, and step².
            size = derivative[control].residue_norm[i] + np.linalg.norm(oracle.residue(i, control))
            assert abs(derivative[control].w[i] - difference) <= 1e-7 * size
