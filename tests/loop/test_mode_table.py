"""Which oscillation of the loop each mode has become: against the base with its arm held, and no slow one left out."""

from __future__ import annotations

import math

import numpy as np
import pytest

import flexopt

DIGGER, STAND = flexopt.load("slewing-excavator"), (0.2, 0.5, -1.2, -0.5)
STIFF = {"drive": "velocity", "kp": 1.0, "kv": 0.1, "rate": 100.0, "dead_time": 0.03}


def held_poles(machine, posture):
    """Of the base with the arm's joints locked, rad/s, one of each pair, from M, D and K, by frequency."""
    plant = flexopt.build_plant(machine)
    p, base, m = plant.parameter_values, [0.0] * len(machine.base_coordinates), plant.n_passive
    rest = plant.rest(base, posture, p)
    full = (plant.mass(rest, base, p), plant.damping(p), plant.stiffness(p))
    mass, damping, stiffness = (matrix.full()[:m, :m] for matrix in full)
    inverse = np.linalg.inv(mass)
    a = np.block([[np.zeros((m, m)), np.eye(m)], [-inverse @ stiffness, -inverse @ damping]])
    poles = np.linalg.eigvals(a)
    return sorted(poles[poles.imag > 0], key=abs)


@pytest.mark.long
def test_stiffly_served_joints_hold_the_arm():
    """Each mode of free joints has become one of the base under a held arm, none a fast motion of servos."""
    loop = STIFF | {"kp": 1e-4, "kv": 0.0, "servo_gain": 1e11}
    found = flexopt.outcome(DIGGER, STAND, loop=loop)
    held = np.array(held_poles(DIGGER, STAND))
    assert len(held) == 6
    order = np.argsort(found.frequencies_hz)
    np.testing.assert_allclose(math.tau * found.frequencies_hz[order], np.abs(held), rtol=1e-3)
    np.testing.assert_allclose(found.damping_ratios[order], -held.real / np.abs(held), rtol=1e-3)


TOO_STRONG = "too strong for a first order"


@pytest.mark.long("loop3-")
@pytest.mark.parametrize(
    ("loop", "modes"),
    [(STIFF | {"servo_gain": 1e8}, "modes 1, 2, 3, 4, 5 and 6"),
     (STIFF | {"servo_gain": 1e6}, "modes 1 and 2"),
     ("default", ""),
     ({"kp": 1e4, "kv": 1e3, "drive": "torque"}, "")],
)  # fmt: skip
def test_where_the_first_order_does_not_tell_a_line_says_so(loop, modes):
    """More than twice an eigenvalue of a sample, or less than half of one."""
    explained = flexopt.explain(DIGGER, STAND, loop=loop)
    evaluation = explained.evaluation
    found = evaluation.outcome
    sample = found.settings.outcome(DIGGER, evaluation.base, evaluation.posture, gravity=False).sample
    poles = np.log(np.linalg.eigvals(sample.matrix).astype(complex)) * found.settings.rate
    nearest = [poles[np.argmin(np.abs(np.abs(poles) - math.tau * hertz))] for hertz in found.frequencies_hz]
    ratio = found.first_order_decay / -np.real(nearest)
    fails = (ratio > 2) | (ratio < 0.5)
    assert found.first_order_fails.tolist() == fails.tolist()
    named = [line.split(": ")[0].strip() for line in repr(evaluation).splitlines() if TOO_STRONG in line]
    assert named == [modes] * bool(modes)
    assert [TOO_STRONG in sentence for sentence in explained.sentences] == fails.tolist()
    # What a reserve below 0 means is not explained by a first order that fails.
    despite = [x for x in repr(evaluation).splitlines() if "reserve below 0: " in x]
    assert bool(despite) == bool(np.any((found.lag_reserve < 0) & (found.first_order_decay > 0) & ~fails))


def test_a_first_order_with_the_wrong_sign_does_not_tell():
    """Torques too strong for a light arm: the mode grows, and to first order it decays, or the other way round."""
    arm, posture = flexopt.load("mobile-manipulator"), (0.0, -1.2, 1.5, -0.5, 0.6, 0.0)
    found = flexopt.outcome(arm, posture, loop={"kp": 1e4, "kv": 1e3, "drive": "torque"})
    assert found.first_order_decay[0] * found.mode_decay[0] < 0
    assert found.first_order_fails[0]
    assert f"  mode 1: the feedback or the dampers are {TOO_STRONG}" in repr(found)


@pytest.mark.parametrize(("coordinate", "damper"), [("x", 2e6), ("rotation", 3e5), ("y", 50.0)])
def test_a_mode_that_a_damper_keeps_from_swinging_has_become_no_oscillation(coordinate, damper):
    """With next to no feedback the loop's oscillations are those of M, D and K; an overdamped mode is left without."""
    data = flexopt.load("excavator").to_dict()
    data["base"]["damping"][coordinate] = damper
    machine, posture = flexopt.machine_from_dict(data), (0.992, -1.4056)
    plant = flexopt.build_plant(machine)
    p, m = plant.parameter_values, plant.n_passive
    rest = plant.rest([0.0], posture, p)
    inverse = np.linalg.inv(plant.mass(rest, [0.0], p).full())
    damping, stiffness = (part(p).full() for part in (plant.damping, plant.stiffness))
    n = len(inverse)
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ damping]])
    swinging = sorted(abs(pole) / math.tau for pole in np.linalg.eigvals(a) if pole.imag > 1e-6)
    found = flexopt.outcome(machine, posture, loop={"kp": 1.0, "kv": 0.1})
    left = found.frequencies_hz[np.isfinite(found.frequencies_hz)]
    assert len(swinging) == m - (damper > 50.0)
    np.testing.assert_allclose(np.sort(left), swinging, rtol=1e-4)
    assert (repr(found).count("no oscillation is left of it") == 1) == (damper > 50.0)
    assert np.all(found.first_order_fails[np.isnan(found.frequencies_hz)])
    assert "nan" not in repr(found)


@pytest.mark.long("loop2-1")
@pytest.mark.parametrize(
    ("loop", "count"),
    [("default", 3), (STIFF | {"servo_gain": 1e7}, 0), (STIFF | {"servo_gain": 3e6, "bandwidth_hz": 4.0}, 1)],
)
def test_no_slow_oscillation_is_left_out(loop, count):
    """Of all eigenvalues of a sample: those of the modes, those beside them, and such as are faster in every way."""
    evaluation = flexopt.evaluate(DIGGER, STAND, loop=loop)
    found = evaluation.outcome
    sample = found.settings.outcome(DIGGER, evaluation.base, evaluation.posture, gravity=False).sample
    values = np.linalg.eigvals(sample.matrix)
    poles = np.log(values[values.imag > 1e-9]) * found.settings.rate
    size, decay = np.abs(poles) / math.tau, -poles.real
    told = np.concatenate([found.frequencies_hz, found.other_frequencies_hz])
    known = np.isclose(size[:, None], told, rtol=1e-8).any(axis=1)
    assert np.count_nonzero(known) == len(told)
    own = math.tau * found.frequencies_hz * found.damping_ratios
    assert np.all((size[~known] > found.frequencies_hz.max()) & (decay[~known] > own.max()))
    # Servos of joints and dead times have fast ones.
    assert np.all(known) == (loop == "default")

    others = math.tau * found.other_frequencies_hz * found.other_damping_ratios
    assert len(others) == count
    assert np.all(np.diff(others) > 0)
    line = [x for x in repr(evaluation).splitlines() if "further oscillations" in x]
    assert len(line) == bool(count)
    for size, ratio, rate in zip(found.other_frequencies_hz, found.other_damping_ratios, others, strict=True):
        # At which it swings, as the line of the sampled loop has it: √(|s|² − Re² s)/2π.
        hertz = math.sqrt(size**2 - (rate / math.tau) ** 2)
        assert f"{hertz:.4g} Hz, damping {ratio:.3g} (decay {rate:.4g}/s)" in line[0]
    if count:
        assert "further oscillations" in evaluation._repr_html_()


@pytest.mark.parametrize("filter_hz", [5.0, 8.0, 10.0, 12.0])
def test_a_double_pole_that_rounding_splits_is_no_oscillation(filter_hz: float) -> None:
    """Of what the filter forgets in both rows alike: exp(−2π f T) twice, which nothing drives and nothing sees."""
    machine = flexopt.load("excavator")
    found = flexopt.outcome(
        machine, (0.0448, -2.0499), loop={"kp": 1e4, "kv": 1e3, "rate": 200.0, "filter_hz": filter_hz}
    )
    assert len(found.other_frequencies_hz) == 2
    assert found.other_damping_ratios.max() < 0.5
