"""The quick Functions and `evaluate_w` against the full measures: values, gradients, and what is left to the iteration."""

from __future__ import annotations

import os
from unittest import mock

import numpy as np
import pytest

import flexopt
from flexopt.errors import InputError
from flexopt.model import machine_from_dict
from flexopt.robustness.batches import evaluate_w
from flexopt.robustness.measures import Measures, build_measures
from flexopt.robustness.modes import TRUSTED_GAP
from tests.oracles.gradient_cases import near_repeated
from tests.oracles.machines import NumpySource, draw_machine, draw_structure, regular_posture

CONTROLS = pytest.mark.parametrize("control", ["inverse", "transpose"])
MANY = pytest.mark.parametrize("n_modes", range(1, 6))


@pytest.fixture
def _interpreted(monkeypatch):
    """No compilation, which takes seconds for each machine."""
    monkeypatch.setenv("FLEXOPT_COMPILE", "0")


def excavator_postures(n):
    rng = np.random.default_rng(0)
    return np.vstack([rng.uniform(-3, 3, n), rng.choice([-1, 1], n) * rng.uniform(0.2, 2.9, n)])


def random_measures(n_modes, seed, control):
    """Measures of a random machine with stiffnesses spread over 1e4, and 20 of its regular postures."""
    source = NumpySource(np.random.default_rng(seed))
    structure = draw_structure(source, m_max=5)
    while structure.n_passive != n_modes:
        structure = draw_structure(source, m_max=5)
    machine = machine_from_dict(draw_machine(source, structure, spread=1e4))
    postures = np.column_stack([regular_posture(source.rng, machine) for _ in range(20)])
    return build_measures(machine, control), postures


def full(measures: Measures, postures):
    """w, |a_i||b_i| (m, N), ∂w/∂posture (m, n, N) and ω² (m, N) without the closed form."""
    p, n_points = measures.plant.parameter_values, postures.shape[1]
    w, scale, _ = measures.w.call([0, postures, p])
    slopes = measures.w_with_gradient.call([0, postures, p])[1].full()
    slopes = slopes.reshape(w.shape[0], n_points, postures.shape[0]).transpose(0, 2, 1)
    squared = measures.values.call([0, postures, p])[0].full()
    return w.full(), scale.full(), slopes, squared


def smallest_gap(squared):
    if len(squared) == 1:
        return np.full(squared.shape[1], 2.0)
    return np.min(2 * np.diff(squared, axis=0) / (squared[1:] + squared[:-1]), axis=0)


def close_slopes(slopes, expected, tolerance):
    size = np.abs(expected).max(axis=(0, 1))
    return np.all(np.abs(slopes - expected) <= tolerance * size)


@pytest.mark.long("True-transpose")
@CONTROLS
@pytest.mark.parametrize("gravity", [False, True])
def test_excavator_agrees_to_1e_11_of_the_factors(control, gravity):
    measures, postures = build_measures(flexopt.load("excavator"), control, gravity), excavator_postures(200)
    w, scale, slopes, _ = full(measures, postures)
    result = evaluate_w(measures, [0.0], postures, gradient=True)
    assert result.repaired == 0
    assert np.all(np.abs(result.w - w) <= 1e-11 * scale)
    assert close_slopes(result.w_posture, slopes, 1e-11)


@CONTROLS
@MANY
@pytest.mark.parametrize("seed", range(3))
def test_random_machines_agree(n_modes, seed, control):
    measures, postures = random_measures(n_modes, seed, control)
    p = measures.plant.parameter_values
    w, scale, slopes, squared = full(measures, postures)
    quick, gap = (result.full() for result in measures.quick.call([0, postures, p]))
    same, _, flat = (result.full() for result in measures.quick_with_gradient.call([0, postures, p]))
    trusted = gap[0] >= TRUSTED_GAP
    # Where J φ cancels, |a||b| is far below the sizes that round: up to 1.2e-11 of it was seen in 18,000 cases.
    assert np.all(np.abs(quick - w)[:, trusted] <= 5e-11 * scale[:, trusted])
    assert np.array_equal(same, quick)
    quick_slopes = flat.reshape(n_modes, -1, postures.shape[0]).transpose(0, 2, 1)
    assert close_slopes(quick_slopes[..., trusted], slopes[..., trusted], 5e-11)
    ratio = gap[0] / smallest_gap(squared)
    assert np.all((ratio >= 1 - 1e-9) & (ratio <= 3 + 1e-9))


@pytest.mark.usefixtures("_interpreted")
@pytest.mark.parametrize("wanted", [1e-1, 1e-2, 1.1e-3])
@pytest.mark.parametrize("seed", range(3))
def test_close_frequencies_agree_as_long_as_they_are_trusted(wanted, seed):
    case = near_repeated(np.random.default_rng(seed), wanted, condition=20.0)
    measures, postures = build_measures(case.machine), case.posture[:, None]
    w, scale, slopes, _ = full(measures, postures)
    result = evaluate_w(measures, [0.0], postures, gradient=True)
    assert result.repaired == 0
    assert np.all(np.abs(result.w - w) <= 1e-11 * scale)
    # The slopes of the modes have the gap below the line, and rounding moves it.
    assert close_slopes(result.w_posture, slopes, 1e-11 + 2e-16 / wanted**2)


@pytest.mark.usefixtures("_interpreted")
@pytest.mark.parametrize("gradient", [False, True])
def test_no_points_have_no_measures(gradient):
    result = evaluate_w(build_measures(flexopt.load("excavator")), [0.0], np.zeros((2, 0)), gradient=gradient)
    assert result.w.shape == (3, 0)
    assert result.w_posture is None if not gradient else result.w_posture.shape == (3, 2, 0)


@pytest.mark.usefixtures("_interpreted")
@pytest.mark.parametrize("gap", [0.0, 1e-14, 1e-8, 1e-5, 0.9e-3])
def test_doubtful_points_are_computed_again(gap):
    case = near_repeated(np.random.default_rng(1), gap, condition=20.0)
    measures = build_measures(case.machine)
    # Between two others, so that it must find its way back to its own column.
    postures = case.posture[:, None] + np.array([0.3, 0.0, 0.2])
    w, scale, slopes, squared = full(measures, postures)
    doubtful = smallest_gap(squared) < TRUSTED_GAP
    result = evaluate_w(measures, [0.0], postures, gradient=True)
    assert doubtful[1]
    assert result.repaired == doubtful.sum()
    assert np.array_equal(result.w[:, doubtful], w[:, doubtful])
    assert np.array_equal(result.w_posture[..., doubtful], slopes[..., doubtful])
    assert np.all(np.abs(result.w - w) <= 1e-11 * scale)
    assert np.array_equal(evaluate_w(measures, [0.0], postures).w[:, doubtful], w[:, doubtful])


def test_gradient_agrees_with_differences():
    measures, postures = build_measures(flexopt.load("excavator")), excavator_postures(50)
    slopes = evaluate_w(measures, [0.0], postures, gradient=True).w_posture
    for j in range(2):
        step = np.zeros((2, 1))
        step[j] = 1e-5
        high, low = (evaluate_w(measures, [0.0], postures + sign * step).w for sign in (1, -1))
        differences = (high - low) / 2e-5
        assert np.abs(slopes[:, j] - differences).max() <= 1e-6 * np.abs(slopes).max()


def test_shapes_threads_and_the_virtual_machine():
    measures, postures = build_measures(flexopt.load("excavator")), excavator_postures(130)
    one = evaluate_w(measures, [0.0], postures, gradient=True)
    assert one.w.shape == (3, 130)
    assert one.w_posture.shape == (3, 2, 130)
    two = evaluate_w(measures, np.linspace(-1, 1, 130)[None], postures, gradient=True, threads=2)
    assert np.array_equal(one.w, two.w)
    assert np.array_equal(one.w_posture, two.w_posture)
    single = evaluate_w(measures, [0.0], postures[:, 0])
    assert single.w.shape == (3, 1)
    assert single.w_posture is None
    assert np.allclose(single.w[:, 0], one.w[:, 0], rtol=1e-12)
    with mock.patch.dict(os.environ, FLEXOPT_COMPILE="0"):
        interpreted = evaluate_w(Measures(measures.plant, "inverse", gravity=False), [0.0], postures, gradient=True)
    assert np.allclose(interpreted.w, one.w, rtol=1e-9, atol=1e-14)
    assert np.allclose(interpreted.w_posture, one.w_posture, rtol=1e-9, atol=1e-12)
    assert evaluate_w(measures, [0.0], np.zeros((2, 0))).w.shape == (3, 0)
    with pytest.raises(InputError):
        evaluate_w(measures, [0.0], postures[:1])


def test_a_nan_does_not_spoil_its_neighbours():
    measures, postures = build_measures(flexopt.load("excavator")), excavator_postures(20)
    expected = evaluate_w(measures, [0.0], postures).w
    postures[1, 7] = np.nan
    result = evaluate_w(measures, [0.0], postures)
    assert np.isnan(result.w[:, 7]).all()
    assert result.repaired == 1
    assert np.array_equal(np.delete(result.w, 7, axis=1), np.delete(expected, 7, axis=1))
