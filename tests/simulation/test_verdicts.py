"""Verdicts: run and eigenvalues together, undecided where they differ; of single runs, ensembles and driven bases."""

from __future__ import annotations

import pickle
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import flexopt
from benchmarks import verdicts
from flexopt.loop.loop_motions import FALLS
from flexopt.model.parameter_values import with_parameters
from flexopt.simulation.behaviour import Shown
from flexopt.simulation.ensemble import judged_beside
from flexopt.simulation.linear import SampledLoop
from flexopt.simulation.verdict import Arrived, beating, judge
from tests.oracles.sampled_loop import growth_rate
from tests.simulation.loops import EXCAVATOR, POSTURE_A, POSTURE_B

pytestmark = pytest.mark.filterwarnings("ignore::flexopt.errors.FlexoptWarning")
THIRD = (0.992, -1.4056)
SLOW = {"kp": 1e3, "kv": 2e3, "sensor": {"delay": 0.02}}
DIGGER, STAND = flexopt.load("slewing-excavator"), (0.2, 0.5, -1.2, -0.5)
HEAVY = {"kp": 3e6, "kv": 6e5}


def shown(**changes) -> Shown:
    """A run of 10 s that decays clearly."""
    usual = {
        "word": "converges", "grown": 1.0, "rate": -0.5, "error": 0.01, "ended": 10.0, "significant": True, "short": False,
        "slowest_hz": 3.0, "duration": 10.0,
    }  # fmt: skip
    return Shown(**usual | changes)


def loop(rate: float, rounding: float = 1e-10) -> SampledLoop:
    return SampledLoop(np.array([np.exp(0.005 * (rate + 20j))]), 0.005, rounding=rounding)


def test_a_run_that_alternates_from_sample_to_sample_is_told_why() -> None:
    """In the words of `flexopt.outcome`; a mode of the base that grows has other causes."""
    cause = "at 100 Hz, half the sampling rate: the velocity gain is too much for 200 Hz"
    steep = flexopt.simulate(EXCAVATOR, POSTURE_B, kp=1e4, kv=5e5, duration=1.0)
    assert cause in str(steep).splitlines()[0]
    assert cause in steep.verdict_reason
    # Kv = 8e4 alone does not alternate, and with Kp = 1e8 no lower Kv helps.
    stiff = flexopt.simulate(EXCAVATOR, (0.6, -1.6), kp=1e8, kv=8e4, duration=0.1)
    both = flexopt.simulate(EXCAVATOR, (0.6, -1.6), kp=1e9, kv=1.2e5, duration=0.1)
    assert "at 100 Hz, half the sampling rate: the position gain is too much for 200 Hz" in str(stiff).splitlines()[0]
    assert "the velocity gain and the position gain are too much for 200 Hz" in both.verdict_reason
    grows = flexopt.simulate(EXCAVATOR, POSTURE_B, kp=1e6, kv=1e3, duration=1.0)
    assert "half the sampling rate" not in str(grows) + grows.verdict_reason


GROWN = {"word": "grows", "rate": 0.5, "grown": float(np.exp(5.0))}


@pytest.mark.parametrize(
    ("run", "linear", "verdict", "words"),
    [
        ({}, loop(-0.5), "converges", "the linear loop decays (decay +0.5/s"),
        (GROWN, loop(0.4), "grows", "the linear loop grows (decay -0.4/s"),
        ({}, loop(1e-3), "undecided", "but the linear loop grows"),
        (GROWN, loop(-0.1), "undecided", "but the linear loop decays"),
        ({"short": True}, loop(-0.5), "undecided", "too short to tell: it takes four periods"),
        (GROWN | {"short": True, "ended": 0.4}, loop(9.0), "grows", "out of the finite numbers at 0.4 s"),
        (GROWN | {"ended": 4.0}, loop(-0.1), "undecided", "out of the finite numbers"),
        ({}, loop(-1e-12), "undecided", "neither grows nor decays"),
        (
            GROWN | {"rate": -0.02, "grown": 1.5, "significant": False},
            loop(0.2),
            "grows",
            "does not clearly decay (decay +0.020 ± 0.010",
        ),
        (GROWN | {"rate": -0.2}, loop(0.2), "grows", "grows to 1.5e+02 times its first amplitude, hardly further"),
        (
            GROWN | {"rate": 0.02, "error": 0.2},
            loop(0.2),
            "grows",
            "grows to 1.5e+02 times its first amplitude, hardly",
        ),
        # Of few periods the doubt is as large as the rate.
        (GROWN | {"error": 0.5}, loop(0.2), "grows", "grows (decay -0.50 ± 0.50/s)"),
        ({"rate": 0.1, "error": 0.03}, loop(0.005), "undecided", "does not clearly grow (decay -0.100 ± 0.030"),
        ({"rate": np.nan, "error": np.nan}, loop(0.1), "undecided", "never moves the base"),
        ({"rate": np.nan, "error": np.nan}, loop(-0.1), "converges", "never moves the base"),
        ({}, "nothing rests", "converges", "no eigenvalues beside it: nothing rests"),
        ({"significant": False}, "nothing rests", "undecided", "nothing rests"),
        ({"short": True}, "nothing rests", "undecided", "nothing rests"),
        (
            {"rate": -1.03, "error": 2.2},
            "nothing rests",
            "undecided",
            "neither clearly grows nor decays (decay +1.0 ± 2.2/s)",
        ),
        # Only what decays can be damped, and only what nothing brakes draws the base along.
        (GROWN, loop(-0.2), "undecided", "too short to show it, or too large for a linear loop"),
        (GROWN, replace(loop(-0.2), neutral=2), "undecided", "linear loop, or drawn along by the arm's self-motion"),
        (
            GROWN,
            replace(loop(-0.2), neutral=1, own=np.array([0.2 + 0.0j])),
            "undecided",
            "too short to show it, or too large for a linear loop",
        ),
        ({}, replace(loop(0.2), neutral=2), "undecided", "linear loop, or damped by its own integrator"),
        # What grows by e^103, or is out of the finite numbers, has had its time; what never began does not show.
        (
            {},
            loop(10.3),
            "undecided",
            "the run is too large for a linear loop, damped by its own integrator, or without",
        ),
        (GROWN | {"ended": 4.0}, loop(-0.2), "undecided", ": the run is too large for a linear loop"),
        # What falls does so at no rate.
        (
            {},
            SampledLoop(FALLS, 0.01),
            "undecided",
            "falls: the feedback is not found to hold the weight, which the controller does not know, anywhere near",
        ),
        (
            GROWN,
            SampledLoop(FALLS, 0.01),
            "grows",
            "the linear loop falls: the feedback is not found to hold the weight",
        ),
    ],
)
def test_every_pair_of_run_and_eigenvalues(run, linear, verdict, words):
    judged = judge(shown(**run), linear)
    assert judged.verdict == verdict
    assert words in judged.reason


@pytest.mark.parametrize(
    ("there", "words"), [(-0.2, "decays (decay +0.2/s)"), (0.3, "the run is too short to show it")]
)
def test_another_posture_is_a_reason_where_its_loop_does_as_the_run(there: float, words: str) -> None:
    class Ran:
        integrator, too_weak = "rk4", ""

        def integrated(self) -> float:
            return 0.1

        def arrived(self) -> Arrived:
            return Arrived("stick by -0.4 rad", loop(there))

    reason = judge(shown(), loop(0.1), ran=Ran()).reason
    assert words in reason
    assert ("along its self-motion the arm ends in another posture, stick by -0.4 rad, about which" in reason) == (
        there < 0
    )
    assert "integrator" not in reason


@pytest.mark.parametrize(("drift", "integrators"), [((), True), ((2e-3,), False), ((-0.1,), True)])
def test_the_drift_of_a_self_motion_is_no_doing_of_the_integrator(drift: tuple[float, ...], integrators: bool) -> None:
    class Ran:
        integrator, too_weak = "gauss", ""

        def integrated(self) -> float:
            return 7.8e-5

        def arrived(self) -> None:
            return None

    own = np.exp(np.array(drift) * 0.01).astype(complex)
    reason = judge(shown(**GROWN), replace(loop(-0.4), own=own), ran=Ran()).reason
    assert ("the integrator gauss makes the decay -7.8e-05/s" in reason) == integrators
    assert ("the run is too" in reason) != integrators


@pytest.mark.long
def test_a_redundant_arm_that_growth_moves_to_another_posture_says_so() -> None:
    """Along its self-motion, on which the end-point is where it was; there the loop decays as the run does."""
    machine, posture = flexopt.load("boom-stick-bucket"), (-1.407, -2.139, -2.012)
    gains = {"kp": 6.965e5, "kv": 4.4775e5}
    law = {"drive": "torque", "nullspace_damping": 1.6823e4, "rate": 100.0, "dead_time": 0.02} | gains
    run = flexopt.simulate(machine, posture, loop=law, duration=20.0)
    assert run.verdict == "undecided"
    assert run.growth_rate < 0 < 1 < run.linear_growth_rate
    end = run.q[-1, run.n_passive :]
    moved = end - posture
    k = int(np.argmax(np.abs(moved)))
    told = f"along its self-motion the arm ends in another posture, {machine.joints[k]} by {moved[k]:+.3g} rad, about which"
    assert told in run.verdict_reason
    assert run.end_error < 1e-6
    there = flexopt.outcome(machine, end, loop=law).decay
    assert float(run.verdict_reason.split()[-1].removesuffix("/s)")) == pytest.approx(there, rel=1e-3)
    assert there == pytest.approx(-run.growth_rate, abs=3 * run.growth_rate_error)
    vary = {name: [value] for name, value in gains.items()}
    many = flexopt.simulate_ensemble(machine, posture, loop=law, duration=20.0, vary=vary)
    (member,) = judged_beside(many, many.linear_loops)
    assert member.reason.split(": ")[1] == run.verdict_reason.split(": ")[1]


def test_a_large_swing_that_drives_cannot_hold_up_is_no_matter_of_time() -> None:
    """Of a loop that grows within a second and drives of little torque: the swing comes down to what these keep up."""
    many = flexopt.simulate_ensemble(
        EXCAVATOR, POSTURE_A, vary={"deflection": [[0.0, 0.0, 0.3]]}, offset=(0.0, 0.0), kp=1e6, kv=2e4, duration=20.0,
        actuator={"torque_limit": [30.0, 30.0]},
    )  # fmt: skip
    (member,) = judged_beside(many, many.linear_loops)
    assert (member.verdict, many.linear_growth_rate[0] > 1) == ("undecided", True)
    assert member.reason.endswith(": the run is too large for a linear loop, or without any of that motion")


def test_members_say_what_their_integrator_makes_of_the_decay() -> None:
    """That of the same loop alone; one that damps no 4/s is no reason."""
    fast = {"kp": 1e4, "kv": 1e3, "sensor": {"delay": 0.02}, "duration": 10.0}
    many = flexopt.simulate_ensemble(EXCAVATOR, POSTURE_B, vary={"offset": [[1e-4, -1e-4]]}, **fast)
    made = flexopt.sampled_loop(EXCAVATOR, POSTURE_B, integrator="rk4", kp=1e4, kv=1e3, sensor={"delay": 0.02})
    (member,) = judged_beside(many, many.linear_loops)
    assert f"the integrator rk4 makes the decay {-made.growth_rate:+.4g}/s" in member.reason


def test_a_mode_that_ten_seconds_do_not_show():
    """The loop grows by 0.0086/s at 13 Hz, which RK4 makes 0.0012; the run decays first, by a faster mode."""
    truth = growth_rate(EXCAVATOR, np.array(THIRD), control="inverse", kp=1e3, kv=2e3, period=0.005, dead_time=0.02)
    assert truth > 0
    short, long = (flexopt.simulate(EXCAVATOR, THIRD, duration=seconds, **SLOW) for seconds in (10.0, 60.0))
    assert (short.run.word, short.verdict) == ("converges", "undecided")
    assert (long.run.word, long.verdict) == ("grows", "grows")
    for run in (short, long):
        assert run.linear_growth_rate == pytest.approx(truth, rel=1e-9)
        assert run.to_dict()["verdict"] == run.verdict
    assert "undecided: the run of 10 s neither clearly grows nor decays" in repr(short)
    assert short.verdict_reason.endswith("the run is too short to show it, or too large for a linear loop")
    assert pickle.loads(pickle.dumps(short)).verdict == "undecided"


@pytest.mark.long
def test_self_motion_is_no_oscillation():
    """It bends the base slowly, ever more; the end-point settles in 2.2 s and the base is still."""
    for seconds in (10.0, 60.0):
        run = flexopt.simulate(DIGGER, STAND, duration=seconds, **HEAVY)
        assert run.verdict == "converges"
        assert run.growth_rate == pytest.approx(-1.4, abs=0.05)
        assert run.settling_time == pytest.approx(2.18, abs=0.01)
        assert run.self_motion_rate > 0.01
        assert f"{run.self_motion_rate:.3g} rad/s\n" in repr(run)
    assert flexopt.simulate(DIGGER, STAND, nullspace_damping=1e4, **HEAVY).self_motion_rate < 1e-6
    assert flexopt.simulate(EXCAVATOR, POSTURE_B, duration=1.0).self_motion_rate is None


@pytest.mark.long
def test_an_integrator_that_damps_a_growing_loop_decides_nothing():
    """At B, Kp 1e4, Kv 1e3 and 20 ms the loop grows; a minute of RK4 decays, one of order 8 does not say either yet."""
    late = {"kp": 1e4, "kv": 1e3, "sensor": {"delay": 0.02}, "offset": (1e-4, -1e-4), "duration": 60.0}
    damped = flexopt.simulate(EXCAVATOR, POSTURE_B, **late)
    assert (damped.run.word, damped.verdict) == ("converges", "undecided")
    assert "the integrator rk4 makes the decay +0.004774/s" in damped.verdict_reason
    assert flexopt.simulate(EXCAVATOR, POSTURE_B, integrator="dop853", **late | {"duration": 2000.0}).verdict == "grows"


def test_a_run_says_what_its_integrator_makes_of_the_decay():
    """RK4 damps the 22 Hz mode: a run of many periods grows as the loop does that RK4 makes, not as the exact one."""
    fast = {"kp": 1e5, "kv": 2e3, "offset": [1e-4, 0.0], "duration": 30.0}
    damped = flexopt.simulate(EXCAVATOR, (-1.35, -2.8), **fast)
    assert damped.growth_rate == pytest.approx(damped.integrated_growth_rate, rel=0.02)
    assert damped.growth_rate < 0.5 * damped.linear_growth_rate
    assert f"integrator rk4: makes the linear loop's decay {-damped.integrated_growth_rate:+.4g}/s" in repr(damped)
    true = flexopt.simulate(EXCAVATOR, (-1.35, -2.8), integrator="dop853", **fast)
    assert true.growth_rate == pytest.approx(true.linear_growth_rate, rel=0.02)
    assert "integrator dop853" not in repr(true)


def test_a_driven_base_is_judged_where_it_ends():
    """From A, which grows, to B, which does not."""
    climb = flexopt.nullspace_trajectory(EXCAVATOR, POSTURE_A, base_range=(-1.5, 0.0))
    run = flexopt.simulate(EXCAVATOR, POSTURE_A, base_path=climb.path, duration=climb.time[-1] + 10.0)
    assert run.verdict == "converges"
    there = flexopt.sampled_loop(EXCAVATOR, climb.posture[-1], base=climb.base[-1])
    assert run.linear_growth_rate == pytest.approx(there.growth_rate, rel=1e-4)
    stepped = flexopt.sampled_loop(EXCAVATOR, climb.posture[-1], base=climb.base[-1], integrator="rk4")
    assert run.integrated_growth_rate == pytest.approx(stepped.growth_rate, rel=1e-4)
    # Driven to the last moment there is nothing undisturbed to judge.
    driven = flexopt.simulate(EXCAVATOR, POSTURE_A, base_path=climb.path, duration=climb.time[-1])
    assert driven.verdict == "undecided"
    many = flexopt.simulate_ensemble(
        EXCAVATOR, POSTURE_A, base_path=climb.path, duration=climb.time[-1] + 10.0,
        vary={"offset": [[0.05, -0.05], [0.01, 0.02]]},
    )  # fmt: skip
    assert many.verdict.tolist() == ["converges", "converges"]
    np.testing.assert_allclose(many.linear_growth_rate, there.growth_rate, rtol=1e-4)


def test_members_are_judged_as_single_runs():
    rng = np.random.default_rng(2)
    kp, mass = 10 ** rng.uniform(3, 6, 12), rng.uniform(0.0, 400.0, 12)
    many = flexopt.simulate_ensemble(EXCAVATOR, THIRD, vary={"kp": kp}, kv=1e3, duration=20.0, sensor={"delay": 0.02})
    for k, gain in enumerate(kp):
        one = flexopt.simulate(EXCAVATOR, THIRD, kp=gain, kv=1e3, duration=20.0, sensor={"delay": 0.02})
        assert many.verdict[k] == one.verdict
        assert many.linear_growth_rate[k] == pytest.approx(one.linear_growth_rate, rel=1e-9)
    assert set(many.verdict) == {"grows", "undecided"}
    shares = many.to_dict()["verdicts"]
    assert sum(shares.values()) == pytest.approx(1.0)
    assert shares["undecided"] == many.share("undecided") > 0
    # Where the machine is not what the controller takes it for, the loop of the true machine counts, hanging in its
    # springs with a payload that nobody told it of.
    loaded = flexopt.simulate_ensemble(EXCAVATOR, POSTURE_B, vary={"payload.mass": mass}, duration=10.0)
    data = EXCAVATOR.to_dict()
    for k in (0, 5):
        data["payload"] = {"mass": mass[k]}
        own = flexopt.sampled_loop(flexopt.model.machine_from_dict(data), POSTURE_B)
        assert loaded.linear_growth_rate[k] == pytest.approx(own.growth_rate, rel=1e-9)
    hanging = flexopt.simulate_ensemble(EXCAVATOR, POSTURE_B, vary={"payload.mass": mass}, duration=10.0, gravity=True)
    assert np.all(np.isfinite(hanging.linear_growth_rate))


def test_verdicts_are_in_the_file(tmp_path):
    import xarray as xr  # noqa: PLC0415

    many = flexopt.simulate_ensemble(EXCAVATOR, THIRD, vary={"kp": [1e3, 1e4, 1e6]}, kv=1e3, duration=5.0)
    many.to_netcdf(tmp_path / "many.nc")
    with xr.open_dataset(tmp_path / "many.nc") as data:
        meanings = data["verdict"].attrs["flag_meanings"].split()
        assert [meanings[code] for code in data["verdict"].to_numpy()] == many.verdict.tolist()
        np.testing.assert_array_equal(data["linear_growth_rate"], many.linear_growth_rate)


def test_eigenvalues_are_computed_when_asked_for(monkeypatch):
    """A run costs two milliseconds; so would its eigenvalues."""
    from flexopt.simulation import members, verdict  # noqa: PLC0415

    calls = []
    original = verdict.about
    for module in (verdict, members):
        monkeypatch.setattr(module, "about", lambda *given: calls.append(1) or original(*given))
    run = flexopt.simulate(EXCAVATOR, (0.3, -1.9), duration=2.0, kp=1.234e4)
    many = flexopt.simulate_ensemble(EXCAVATOR, (0.3, -1.9), duration=2.0, vary={"offset": [[0.1, 0.0], [0.0, 0.1]]})
    assert calls == []
    assert (run.verdict, run.verdict_reason, run.linear_growth_rate) is not None
    assert len(calls) == 1
    assert len(many.verdict) == 2
    assert len(calls) == 2


@pytest.mark.long
@pytest.mark.usefixtures("interpreted")
def test_random_machines_are_never_contradicted():
    """A part of `python -m benchmarks.verdicts`: against eigenvalues by SciPy and python-control, and long runs."""
    found = verdicts.count(12)
    assert found.contradictions == []
    assert max(found.off) < 1e-9
    assert found.true.keys() <= {"as the eigenvalues", "too slow to look"}
    decided = found.verdicts["converges", "converges"] + found.verdicts["grows", "grows"]
    assert decided > 6
    assert found.verdicts["converges", "converges"] > 0 < found.verdicts["grows", "grows"]
    assert found.redundant > 1


@pytest.mark.long("40.0")
@pytest.mark.filterwarnings("ignore::flexopt.FlexoptWarning")
@pytest.mark.parametrize("duration", [20.0, 40.0])
def test_a_slow_swing_of_an_arm_that_drifts_is_no_growth(duration: float) -> None:
    """At 0.13 Hz the arm bends its base and lets it go; the base's own swing dies away within a second.

    Largest deflections over whole swings judge it, which get smaller throughout.
    """
    run = flexopt.simulate(flexopt.load("boom-stick-bucket"), (-0.8, -1.5, -0.5), duration=duration)
    swing = round(1 / 0.134 * 200)
    largest = [np.abs(run.deflection[k : k + swing]).max() for k in range(0, len(run.time) - swing, swing)]
    assert all(later < sooner for sooner, later in pairwise(largest))
    assert run.run.word == "converges"
    assert run.growth_rate < 2 * run.growth_rate_error
    assert run.verdict == "converges"


@pytest.mark.long("slewing-excavator-posture2", "truck-crane-posture1")
@pytest.mark.parametrize(
    ("name", "posture"),
    [
        ("boom-stick-bucket", (-0.9, -1.2, -0.4)),
        ("truck-crane", (0.1, 0.47, -0.355, 0.6)),
        ("slewing-excavator", (0.2, 0.5, -1.2, -0.5)),
    ],
)
@pytest.mark.filterwarnings("ignore::flexopt.FlexoptWarning")
def test_an_arm_whose_self_motion_creeps_under_its_weight_is_no_growth(name: str, posture: tuple[float, ...]) -> None:
    """The damper brakes it and holds it nowhere: the base stays bent, a little more each minute, and does not swing."""
    machine = flexopt.load(name)
    loop = {"kp": 1e6, "kv": 3e5, "nullspace_damping": 1e4, "rate": 100.0, "drive": "torque"}
    options = {"base": (0.0,) * len(machine.base_coordinates), "gravity": True}
    run = flexopt.simulate(machine, posture, duration=30.0, loop=loop, **options)
    decay = flexopt.outcome(machine, posture, loop=loop, **options).decay
    assert decay > 0
    assert run.verdict == run.run.word == "converges"
    assert abs(-run.growth_rate - decay) < 3 * run.growth_rate_error
    # The base hangs, and what it has of speed is nothing beside that.
    last = np.abs(np.diff(run.deflection[-200:], axis=0)).max()
    assert np.abs(run.deflection[-1]).max() > 1e3 * last > 0


@pytest.mark.filterwarnings("ignore::flexopt.FlexoptWarning")
@pytest.mark.parametrize(
    ("posture", "shown"),
    [((-0.9, -1.2, -0.4), True), ((-0.5, -1.9, -1.0), False)],  # of 20 s, two of its swings, the other shows nothing
)
def test_the_self_motion_is_told_apart_where_the_arm_comes_to_rest(posture: tuple[float, ...], *, shown: bool) -> None:
    """A load that the controller knows wrong moves the arm along its self-motion, which is another there.

    Of its energy little lies in that of the design posture. The motion itself changes nothing at the end-point.
    """
    machine = flexopt.load("boom-stick-bucket")
    payload = next(each.value for each in machine.parameters if each.name == "payload.mass")
    ensemble = flexopt.simulate_ensemble(
        machine, posture, base=[0.0], gravity=True, loop="default", duration=20.0,
        vary={"payload.mass": [0.9 * payload, payload]},
    )  # fmt: skip
    nominal = flexopt.outcome(machine, posture, base=[0.0], gravity=True, loop="default")
    known = [loop for loop in ensemble.linear_loops if not isinstance(loop, str)]
    assert known
    for loop in known:
        assert len(loop.drift) == 1
        assert abs(loop.drift[0]) < 1e-2 * nominal.decay < -loop.growth_rate
    if shown:
        assert "converges" in ensemble.verdict


@pytest.mark.long("1.0-truck-crane-posture1")
@pytest.mark.parametrize(
    ("name", "posture"), [("boom-stick-bucket", (-0.9, -1.2, -0.4)), ("truck-crane", (-0.5, 1.0, -0.8, 0.6))]
)
@pytest.mark.parametrize("mass", [1.0, 2000.0])
def test_the_self_motion_of_a_member_is_told_apart_with_its_own_masses(
    name: str, posture: tuple[float, ...], mass: float
) -> None:
    """Without weight a load that the controller does not know changes nothing of its law: the loop is that of a machine
    that has the load in its file."""
    machine = flexopt.load(name)
    law = {"drive": "torque", "kp": 9e4, "kv": 4e4, "rate": 100.0, "nullspace_damping": 3000.0}
    ensemble = flexopt.simulate_ensemble(machine, posture, loop=law, duration=0.1, vary={"payload.mass": [mass]})
    (member,) = ensemble.linear_loops
    loaded = with_parameters(machine, {"payload.mass": mass})
    (own,) = flexopt.simulate_ensemble(loaded, posture, loop=law, duration=0.1, vary={"kp": [9e4]}).linear_loops
    assert member.growth_rate == pytest.approx(own.growth_rate, rel=1e-6)  # of matrices that rounding tells apart
    assert member.self_motion == pytest.approx(own.self_motion, rel=1e-6)


@pytest.mark.long("20000.0")
@pytest.mark.filterwarnings("ignore::flexopt.FlexoptWarning")
@pytest.mark.parametrize("gain", [1e4, 2e4])
def test_a_base_that_tips_over_slowly_does_not_converge(gain: float) -> None:
    """A hundredth of the tilting spring: it hardly swings, and takes the end-point ever farther from its target.

    With the lower gain the linear loop has a real pole to the right; with the other what takes the base with it is
    the self-motion.
    """
    data = flexopt.load("boom-stick-bucket").to_dict()
    data["base"]["stiffness"]["rotation"] *= 0.01
    run = flexopt.simulate(
        flexopt.machine_from_dict(data), (-0.9, -1.2, -0.4), base=[0.0], gravity=True, gravity_compensation=True,
        kp=gain, kv=gain, nullspace_damping=1e4, rate=100.0, duration=120.0,
    )  # fmt: skip
    away = np.linalg.norm(run.error, axis=1)
    later, last = (away[int(share * (len(away) - 1))] for share in (0.75, 1.0))
    assert last > 1.2 * later > 1.0 * away[len(away) // 2]
    assert run.run.word == "grows"
    if run.linear is not None and run.linear.growth_rate > 0:
        assert run.verdict == "grows"
        assert run.growth_rate == pytest.approx(run.linear.growth_rate, rel=0.15)
    else:
        assert run.verdict == "undecided"
        assert run.verdict_reason.endswith(
            "the arm's self-motion, which the controller does not hold, takes the base with it"
        )
    assert (gain == 1e4) == (run.verdict == "grows")


@pytest.mark.filterwarnings("ignore::flexopt.FlexoptWarning")
def test_an_arm_that_leaves_its_posture_within_the_run_does_not_converge() -> None:
    """Its weight drives the self-motion, which little brakes: the bucket turns by a radian, and the base is quiet."""
    data = flexopt.load("boom-stick-bucket").to_dict()
    data["base"]["stiffness"] = {name: 0.4 * value for name, value in data["base"]["stiffness"].items()}
    run = flexopt.simulate(
        flexopt.machine_from_dict(data), (-2.267, -2.219, -1.855), base=[0.0], gravity=True, gravity_compensation=True,
        kp=1e6, kv=3e5, nullspace_damping=100.0, rate=100.0, duration=100.0,
    )  # fmt: skip
    assert np.abs(run.q[-1] - run.q[0])[3:].max() > 1.0
    assert run.linear is not None
    assert run.linear.growth_rate < 0 < run.linear.drift[0]
    assert run.verdict == "undecided"
    assert run.verdict_reason.endswith("within the run the arm leaves its posture along it")


@pytest.mark.parametrize(("beat", "least"), [(0.05, 0.9), (0.3, 0.8), (0.9, 0.4)])
def test_what_a_beat_that_a_fit_sees_in_part_makes_of_its_slope_is_in_the_doubt(beat: float, least: float) -> None:
    """Beside slopes of ln|1 + e^{jΔω t}/2| fitted to half a run, of all phases, which the more of the beat it sees are less.

    Whole beats do not count, nor what is gone.
    """
    half, period, decay = 5.0, 0.01, 1.4
    poles = np.array([-decay + 20j, -decay + (20.0 + beat) * 1j, -decay - 9.0 + 20.5j])
    loop = SampledLoop(np.exp(np.concatenate([poles, poles.conj()]) * period), period)
    time = np.linspace(0.0, half, 501)
    phases = np.linspace(0.0, 2 * np.pi, 400, endpoint=False)
    logarithms = np.log(np.abs(1 + 0.5 * np.exp(1j * (beat * time[:, None] + phases))))
    slopes = np.polyfit(time, logarithms, 1)[0]
    rms = float(np.sqrt(np.mean(slopes**2)))
    assert least * beating(loop, 2 * half) < rms < 1.2 * beating(loop, 2 * half)
    # More than one beat within the fit.
    assert beating(loop, 2 * 6.3 / beat) == 0.0
    assert beating("no linear loop", 10.0) == 0.0
