"""The article's closed loops (Figs. 9, 11, 12): which posture's oscillation grows, how fast, and what RK4 adds to it."""

from __future__ import annotations

import numpy as np
import pytest

import flexopt
from flexopt.simulation.linear import sampled_loop
from tests.oracles.closed_loop_ode import Loop
from tests.simulation.loops import EXCAVATOR, POSTURE_A, POSTURE_B

HIGH = {"kp": 1e5, "kv": 2e3}
LOW = {"kp": 1e4, "kv": 1e3}


def linear(posture, gains, method):
    loop = Loop(EXCAVATOR, np.array(posture), kp=np.full(2, gains["kp"]), kv=np.full(2, gains["kv"]))
    return loop.growth_rate(0.005, method)


@pytest.mark.parametrize("integrator", ["rk4", "dop853", "gauss"])
def test_high_gains_part_the_postures(integrator):
    a, b = (flexopt.simulate(EXCAVATOR, posture, integrator=integrator, **HIGH) for posture in (POSTURE_A, POSTURE_B))
    assert (a.verdict, b.verdict) == ("grows", "converges")
    assert a.peak_base_rotation > 0.03 > b.peak_base_rotation
    swing = np.abs(a.deflection[:, 2])
    assert 1.0 < a.time[np.argmax(swing > 0.03)] < 10.0
    assert a.growth_rate > 0.2
    assert b.growth_rate < 0
    assert a.settling_time is None
    assert b.end_error < 0.2 * a.end_error
    # What grows is the slowest mode, 3.07 Hz.
    assert np.argmax(a.residual_oscillation) == 0


def test_the_defaults_are_the_articles_run():
    """RK4 at 200 Hz, inverse control, 10 s, (+0.05, −0.05) rad off."""
    default = flexopt.simulate(EXCAVATOR, POSTURE_A)
    spelled = flexopt.simulate(
        EXCAVATOR, POSTURE_A, control="inverse", feedback="pd", integrator="rk4", rate=200.0, duration=10.0,
        offset=(0.05, -0.05), hold=True, gravity=False, base=0.0, substeps=1, **HIGH,
    )  # fmt: skip
    np.testing.assert_array_equal(default.q, spelled.q)
    assert len(default.time) == 2001
    assert default.time[-1] == 10.0
    np.testing.assert_allclose(default.q[0, 3:], np.add(POSTURE_A, [0.05, -0.05]), atol=1e-15)


@pytest.mark.parametrize(
    ("posture", "integrator", "expected", "digit"),
    [
        # Printed with two digits as +.07 and −.013; the third is what the linear loop gives.
        (POSTURE_A, "dop853", 0.0701, 2e-4),
        (POSTURE_A, "gauss", 0.0701, 2e-4),
        (POSTURE_B, "dop853", -0.0134, 2e-4),
        (POSTURE_B, "gauss", -0.0134, 2e-4),
        # RK4 damps the 22 Hz mode, B's slowest, on its own; the 3 Hz mode is left as the slowest.
        (POSTURE_B, "rk4", -0.0161, 2e-4),
    ],
)
def test_low_gains_over_a_minute(posture, integrator, expected, digit):
    trajectory = flexopt.simulate(EXCAVATOR, posture, duration=60.0, integrator=integrator, **LOW)
    assert trajectory.verdict == ("grows" if expected > 0 else "converges")
    assert trajectory.growth_rate == pytest.approx(expected, abs=digit)
    # The motion is not quite small (θ1 up to 1.3 mrad at B), hence 1 %.
    assert trajectory.growth_rate == pytest.approx(linear(posture, LOW, integrator), rel=0.01)


@pytest.mark.parametrize("posture", [POSTURE_A, POSTURE_B], ids="AB")
@pytest.mark.parametrize("gains", [HIGH, LOW], ids=["high", "low"])
@pytest.mark.parametrize("method", ["rk4", "dop853"])
def test_the_linear_loop_is_that_of_the_matrices(posture, gains, method):
    """Eigenvalues of the simulator's own step against equation (2), held and fed back by hand."""
    ours = sampled_loop(EXCAVATOR, posture, integrator=method, **gains)
    # DOP853 leaves 1e-8 of the fastest mode's period in a step.
    assert ours.growth_rate == pytest.approx(linear(posture, gains, method), abs=1e-9 if method == "rk4" else 1e-6)


def test_rk4_differs_by_what_it_damps():
    """At B with low gains the 22 Hz mode decays at 0.0134/s; at 5 ms RK4 lets it vanish and 0.0161/s at 3 Hz is left."""
    exact, rk4 = (linear(POSTURE_B, LOW, method) for method in ("exact", "rk4"))
    assert exact == pytest.approx(-0.01337, abs=1e-5)
    assert rk4 == pytest.approx(-0.01606, abs=1e-5)
    # In the run: the energy of the 22 Hz mode after a minute, beside that of an accurate one.
    left = [
        flexopt.simulate(EXCAVATOR, POSTURE_B, duration=60.0, **LOW, **how).residual_oscillation[2]
        for how in ({}, {"substeps": 4}, {"integrator": "dop853"})
    ]
    assert left[0] < 1e-4 * left[2]
    assert left[1] == pytest.approx(left[2], rel=0.03)
