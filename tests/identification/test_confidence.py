"""What residuals that know of each other say: of one fit against another, and of the width of intervals."""

from __future__ import annotations

import math

import numpy as np
import pytest

import flexopt
from flexopt.foundation.arrays import Vector
from flexopt.identification.confidence import _scores, told_apart  # pyright: ignore[reportPrivateUsage]
from flexopt.identification.fitting import Fit
from flexopt.model.parameter_values import with_parameters
from flexopt.model.uncertainty import parameters_of
from tests.oracles.free_swing import FreeSwing

RATES = (100, 1000, 5000)


def narrow(rng: np.random.Generator, time: Vector) -> Vector:
    """A motion of random phases about 3 Hz, which knows of itself for half a second."""
    hertz, phase = 3 + 0.5 * rng.standard_normal(40), rng.uniform(0, 2 * np.pi, 40)
    return np.cos(2 * np.pi * hertz[:, None] * time + phase[:, None]).sum(axis=0) / np.sqrt(20)


def with_residuals(residual: Vector) -> Fit:
    """A fit of nothing, to zeros."""
    sigma, none = np.sqrt(np.mean(residual**2)), np.zeros(0)
    misfit = 2 * residual.size * float(np.log(sigma))
    column, used = residual[:, None], np.ones((residual.size, 1), dtype=bool)
    return Fit(none, none, none, np.array([sigma]), used, column, none, 0.0, 0.0, converged=True, misfit=misfit)


def apart(one: Vector, two: Vector) -> bool:
    least, other = sorted(map(with_residuals, (one, two)), key=lambda each: each.misfit)
    return told_apart(least, other, np.zeros((one.size, 1)))


@pytest.mark.parametrize("dies_in", [math.inf, 1.5])
@pytest.mark.parametrize("rate", RATES)
def test_fits_that_are_as_wrong_are_not_told_apart_at_any_rate(rate: int, dies_in: float) -> None:
    """Of ten seconds, as a swing dies away, too; by 3 of 60 draws, of which chance has 0.1 were stretches independent."""
    time, told = np.arange(10 * rate) / rate, 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        common, *own = (narrow(rng, time) * np.exp(-time / dies_in) for _ in range(3))
        told += apart(*(common + 0.5 * each + 0.02 * rng.standard_normal(time.size) for each in own))
    assert told <= 3


@pytest.mark.parametrize("dies_in", [math.inf, 1.5])
@pytest.mark.parametrize("ratio", [2.5, 5.0, 100.0, 1e4])
def test_a_fit_that_is_far_worse_is_told(ratio: float, dies_in: float) -> None:
    """However far, and however fast the swing dies away: what it is worse by counts as no uncertainty."""
    rng, time = np.random.default_rng(0), np.arange(1000) / 100
    least = np.convolve(rng.standard_normal(time.size + 9), np.ones(10), "valid")
    more = np.sin(2 * np.pi * 2 * time) * np.exp(-time / dies_in)
    assert apart(least, least + np.sqrt(ratio**2 - 1) * least.std() / more.std() * more)


def test_intervals_are_as_wide_at_any_rate() -> None:
    """The variance of a mean of what knows of itself for half a second, sampled every 0.2 to 10 ms."""
    rng = np.random.default_rng(1)
    fine = narrow(rng, np.arange(10 * RATES[-1]) / RATES[-1])
    found = list[float]()
    for rate in RATES:
        residual = fine[:: RATES[-1] // rate, None]
        found.append(
            float(_scores(np.ones((residual.size, 1)), residual, np.ones(residual.shape, bool))[0, 0]) / rate**2
        )
    # A motion of 3 Hz nearly cancels in the sum, and what is left is that of instants 10 ms apart to 6 %.
    assert found == pytest.approx([found[-1]] * len(RATES), rel=0.1)


def test_a_sensor_that_is_not_linear_leaves_the_least_residuals_the_answer() -> None:
    """Others leave 1.7 to 3.6 times as much: the nearest of them to the file had springs 0.5 to 3.6 times the truth."""
    machine, posture = flexopt.load("boom-stick-bucket"), (-0.6, -1.2, -0.7)
    rng = np.random.default_rng(408473)
    chosen = [machine.parameters[i] for i in parameters_of(("stiffness", "damping"), machine)]
    truth = {each.name: each.value * float(np.exp(rng.uniform(-1.5, 1.5))) for each in chosen if each.value}
    swing = FreeSwing(with_parameters(machine, truth), posture, [3e-3, -4e-3, 4e-3], np.zeros(3))
    log = swing.log(("end_point.x",), np.arange(301) / 100, 0.0, 0)
    shown = np.asarray(log["end_point.x"])
    away = shown - shown[-50:].mean()
    most = np.abs(away).max()
    log["end_point.x"] = shown + 3e-4 * most * rng.standard_normal(shown.size) + 0.02 * most * (away / most) ** 3
    found = flexopt.identify(machine, log, posture=posture)
    held = {each.name: each.value for each in found.machine.parameters}
    springs = [name for name in truth if "stiffness" in name]
    assert not found.columns[0].white
    assert not found.unidentified
    assert [held[name] for name in springs] == pytest.approx([truth[name] for name in springs], rel=0.01)
