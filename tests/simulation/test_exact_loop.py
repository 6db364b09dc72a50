"""The linear loop that is exact between samples: against SciPy and python-control, fine steps, theory's table of gains."""

from __future__ import annotations

import numpy as np
import pytest

import flexopt
from flexopt.errors import InputError
from flexopt.model import machine_from_dict, tree_from_dict
from tests.oracles.machines import NumpySource, Structure, draw_machine, regular_posture
from tests.oracles.sampled_loop import growth_rate, multipliers
from tests.oracles.spatial import grounded
from tests.simulation.loops import EXCAVATOR, POSTURE_A, POSTURE_B
from tests.simulation.test_linear import STRUCTURES, apart

THIRD = (0.992, -1.4056)
DIGGER, STAND = flexopt.load("slewing-excavator"), (0.2, 0.5, -1.2, -0.5)
HEAVY = {"kp": 3e6, "kv": 6e5}


def random_case(structure: Structure, seed: int):
    """A machine, a regular posture and gains as heavy as its links."""
    rng = np.random.default_rng(seed)
    data = draw_machine(NumpySource(rng), structure, spread=30.0, joint_damping=False)
    mass = sum(link["mass"] for link in data["links"])
    machine = machine_from_dict(data)
    return machine, regular_posture(rng, machine, condition=8.0), {"kp": 3.0 * mass, "kv": mass}


@pytest.mark.parametrize(
    ("structure", "control"),
    [
        (structure, control)
        for k, structure in enumerate(STRUCTURES)
        for control in ("inverse", ("transpose", "damped:0.3")[k % 2])
    ],
    ids=str,
)
def test_any_dead_time(structure, control):
    """Whole samples and parts of them; the oracle delays the command, the loop the measurement."""
    machine, posture, gains = random_case(structure, STRUCTURES.index(structure))
    for dead_time in (0.0, 0.0031, 0.005, 0.0125, 0.02, 0.0499):
        loop = flexopt.sampled_loop(machine, posture, control=control, sensor={"delay": dead_time}, **gains)
        expected = multipliers(machine, posture, control=control, period=0.005, dead_time=dead_time, **gains)
        # Zeros, of which queues of forces and of measurements have different numbers, come out as roots of rounding.
        ours, other = (values[np.abs(values) > 0.3] for values in (loop.multipliers, expected))
        assert ours.shape == other.shape
        assert apart(ours, other) < 1e-9
        rate = growth_rate(machine, posture, control=control, period=0.005, dead_time=dead_time, **gains)
        assert loop.growth_rate == pytest.approx(rate, rel=1e-9, abs=1e-8)
        assert loop.neutral == 2 * (len(posture) - 2)


def test_a_tree_with_self_motion():
    tree, posture = tree_from_dict(grounded(4, 3)), (0.3, 0.9, -1.4, 0.5)
    for dead_time in (0.0, 0.0125):
        given = {"kp": 2e4, "kv": 1e4, "control": "inverse"}
        loop = flexopt.sampled_loop(tree, posture, sensor={"delay": dead_time}, **given)
        expected = growth_rate(tree, np.array(posture), period=0.005, dead_time=dead_time, **given)
        assert loop.growth_rate == pytest.approx(expected, rel=1e-9)


PARTS = {
    "lag and delay": {"actuator": {"bandwidth_hz": [3.0, 8.0]}, "sensor": {"delay": 0.01}},
    "rate limit and dead band": {"actuator": {"bandwidth_hz": 5.0, "rate_limit": 1e6, "dead_band": 10.0}},
    "pid": {"feedback": "pid", "ki": [3e4, 1e4]},
    "continuous pid behind a lag": {"feedback": "pid", "ki": 2e4, "hold": False, "actuator": {"bandwidth_hz": 20.0}},
    "robust": {"feedback": "robust"},
    "robust, continuous": {"feedback": "robust", "hold": False},
    "weight": {"gravity": True, "sensor": {"resolution": 1e-4}},
    "none": {"feedback": "none"},
}


@pytest.mark.parametrize("part", list(PARTS))
def test_every_part_of_the_loop(part):
    """Against an integrator of order 8 at a tenth of the step: what it adds by itself is below 1e-10 of a period."""
    given = {"kp": 2e4, "kv": 2e3} | PARTS[part]
    exact = flexopt.sampled_loop(EXCAVATOR, POSTURE_B, **given)
    fine = flexopt.sampled_loop(EXCAVATOR, POSTURE_B, integrator="dop853", substeps=30, **given)
    assert (exact.integrator, fine.integrator) == ("exact", "dop853")
    # Of a queue's multiple zero rounding leaves a root.
    ours, other = (values[np.abs(values) > 1e-3] for values in (exact.multipliers, fine.multipliers))
    assert ours.shape == other.shape
    assert apart(ours, other) < 1e-8
    assert exact.growth_rate == pytest.approx(fine.growth_rate, rel=1e-7, abs=1e-7)


def test_levers_do_not_exist_for_small_motions():
    machine, posture = flexopt.load("boom-stick-bucket"), (-1.0, -1.2, -0.5)
    given = {"kp": 2e6, "kv": 3e5, "nullspace_damping": 6e3}
    plain, through = (flexopt.sampled_loop(machine, posture, actuator=a, **given) for a in ({}, {"levers": "each"}))
    np.testing.assert_allclose(plain.multipliers, through.multipliers, atol=1e-12)


def test_what_an_integrator_hides():
    """RK4 at 5 ms calls a loop stable that grows; where none is stable at 100 ms, it finds some."""
    late = {"kp": 1e4, "kv": 1e3, "sensor": {"delay": 0.02}}
    assert flexopt.sampled_loop(EXCAVATOR, POSTURE_B, **late).growth_rate == pytest.approx(7.718e-4, rel=1e-3)
    by_rk4 = flexopt.sampled_loop(EXCAVATOR, POSTURE_B, integrator="rk4", **late)
    assert by_rk4.growth_rate == pytest.approx(-4.774e-3, rel=1e-3)
    assert "stable by rk4" in repr(by_rk4)
    assert flexopt.sampled_loop(EXCAVATOR, POSTURE_B, integrator="exact", **late) is not None
    # A mode too fast for RK4's step is none for the exact loop.
    assert flexopt.sampled_loop(EXCAVATOR, POSTURE_B, rate=20.0, kp=1e3, kv=1e2).period == 0.05
    with pytest.raises(InputError, match="RK4 is unstable"):
        flexopt.sampled_loop(EXCAVATOR, POSTURE_B, rate=20.0, integrator="rk4")


@pytest.mark.parametrize(("method", "orders"), [("rk4", 3.5), ("gauss", 4.0)])
def test_integrators_measure_within_a_sample(method: str, orders: float) -> None:
    """Their loops come to the exact one with their order, wherever in a sample the measurement falls.

    Steps on its two sides are of different length, so that orders between two counts scatter.
    """
    given = {"kp": 1e4, "kv": 1e3, "sensor": {"delay": 0.0131}}

    def slowest(**options: object) -> np.ndarray:
        found = flexopt.sampled_loop(EXCAVATOR, POSTURE_B, **given, **options).multipliers
        return found[np.abs(found) > 0.2]  # the queue's own are zero, of which rounding makes 1e-5

    exact = slowest()
    off = [np.abs(slowest(integrator=method, substeps=steps) - exact).max() for steps in (1, 16)]
    assert off[1] < 1e-7
    assert np.log2(off[0] / max(off[1], 1e-14)) / 4 > orders - 0.3


# Stable Kp in 10 … 1e9 to three digits; `python -m benchmarks.verdicts` prints the whole table.
TABLE = [
    (0.0, POSTURE_A, 1e3, []),
    (0.005, POSTURE_A, 1e3, [(1.28e5, 1.32e5)]),
    (0.005, THIRD, 1e3, [(10, 7.78e4), (8.57e4, 1.32e5)]),
    (0.02, POSTURE_B, 1e3, [(10, 5.34e3)]),
    (0.05, THIRD, 2e3, [(2.58e4, 3.14e4)]),
]


@pytest.mark.parametrize(("dead_time", "posture", "kv", "expected"), TABLE)
def test_intervals_of_stable_gains(dead_time, posture, kv, expected):
    """Of an independent computation, its three digits; and stable inside, unstable outside, by the oracle."""
    # Searched from 10 N m on, as there.
    border = flexopt.stability_border(EXCAVATOR, posture, kp=1e5, kv=kv, sensor={"delay": dead_time})
    assert len(border.intervals) == len(expected)
    for (low, high), printed in zip(border.intervals, expected, strict=True):
        assert (low, high) == pytest.approx(printed, rel=5e-3)
        for kp, stable in ((low * 1.001, True), (high * 0.999, True), (low * 0.999, False), (high * 1.001, False)):
            rate = growth_rate(
                EXCAVATOR, np.array(posture), control="inverse", kp=kp, kv=kv, period=0.005, dead_time=dead_time
            )
            assert (rate < 0) == stable or kp < 10


def test_an_interval_narrower_than_the_search_is_found(monkeypatch):
    """At 5 ms and Kv 1e3 posture A is stable over 3 % of Kp alone, and a grid in steps of 20 % misses it."""
    from flexopt.loop import borders  # noqa: PLC0415

    monkeypatch.setattr(borders, "POINTS", 101)
    border = flexopt.stability_border(EXCAVATOR, POSTURE_A, kv=1e3, sensor={"delay": 0.005})
    assert border.intervals[0] == pytest.approx((1.28e5, 1.32e5), rel=5e-3)


@pytest.mark.long
def test_self_motion_is_told_apart():
    free = flexopt.sampled_loop(DIGGER, STAND, **HEAVY)
    assert (free.neutral, free.drift, free.stable) == (2, (), True)
    assert free.growth_rate == pytest.approx(-1.434, abs=1e-3)
    # Weight tilts the base as the arm drifts, and the drift feeds itself: slow, real, and no oscillation.
    weighed = flexopt.sampled_loop(DIGGER, STAND, gravity=True, **HEAVY)
    assert weighed.stable
    assert weighed.drift[0] == pytest.approx(0.0205, abs=5e-4)
    assert len(weighed.multipliers) == len(free.multipliers)
    # A damper that is too strong for its samples is an instability of the loop.
    assert flexopt.sampled_loop(DIGGER, STAND, nullspace_damping=1e4, **HEAVY).stable
    assert not flexopt.sampled_loop(DIGGER, STAND, nullspace_damping=1e7, **HEAVY).stable
    # Nothing holds what has no gain: it may rest anywhere, and the base decays by itself.
    assert flexopt.sampled_loop(DIGGER, STAND, kp=0.0, kv=6e5).neutral == 5
    assert flexopt.sampled_loop(DIGGER, STAND, feedback="pid", **HEAVY).growth_rate == pytest.approx(free.growth_rate)
    still = flexopt.sampled_loop(DIGGER, STAND, feedback="none")
    assert (still.neutral, still.stable) == (8, True)
