"""What `simulate` refuses, and how: one `InputError` with field, value, unit and range, every fault at once."""

from __future__ import annotations

import inspect
import json
import math
from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.errors import (
    FlexoptWarning,
    InputError,
    NoSolutionFound,
    NotStabilizable,
    SingularPosture,
    UnreachableTarget,
)
from flexopt.model import machine_from_dict
from flexopt.model.simulation import LinearKeywords, SimulationKeywords
from tests.oracles.machines import NumpySource, Structure, draw_machine
from tests.simulation.loops import EXCAVATOR, POSTURE_A, POSTURE_B

pytestmark = pytest.mark.usefixtures("interpreted")

NAN, INF = math.nan, math.inf
THREE = machine_from_dict(draw_machine(NumpySource(np.random.default_rng(0)), Structure(3, ("x", "rotation"), ())))
RIGID_IN_X = machine_from_dict(draw_machine(NumpySource(np.random.default_rng(0)), Structure(2, ("y",), ())))


def refused(machine=EXCAVATOR, **options) -> str:
    with pytest.raises(InputError) as caught:
        flexopt.simulate(machine, **({"posture": POSTURE_B, "duration": 0.1} | options))
    message = str(caught.value)
    assert "[type=" not in message
    assert "casadi" not in message.lower()
    assert "\\n" not in message
    json.dumps(caught.value.to_dict(), allow_nan=False)
    return message


# Options, then what the sentence must hold: field and value, then unit or range.
FAULTS = {
    "kp NaN": ({"kp": NAN}, ["kp = nan", "finite", "N/m"]),
    "kp infinite": ({"kp": INF}, ["kp = inf", "finite", "1e+15"]),
    "kp negative": ({"kp": -1}, ["kp = -1", "between 0 and 1e+15 N/m"]),
    "kp huge": ({"kp": 1e300}, ["kp = 1e+300", "between 0 and 1e+15 N/m"]),
    "kp empty": ({"kp": []}, ["kp = []", "number"]),
    "kp of three": ({"kp": [1, 2, 3]}, ["kp = [1.0, 2.0, 3.0]", "2 task axes"]),
    "kp text": ({"kp": "big"}, ["kp = 'big'", "not text"]),
    "kp one of two NaN": ({"kp": [1.0, NAN]}, ["kp", "entry 2", "finite"]),
    "kv true": ({"kv": True}, ["kv = true", "not true/false"]),
    "ki negative": ({"ki": -1}, ["ki = -1", "between 0"]),
    "ki without pid": ({"ki": 3.0}, ["ki = [3.0]", 'goes with feedback = "pid"']),
    "integral limit without pid": ({"integral_limit": 3.0}, ["integral_limit = 3", 'goes with feedback = "pid"']),
    "integral limit": ({"integral_limit": 0}, ["integral_limit = 0", "greater than 0", "N"]),
    "gain": ({"gain": 0.0}, ["gain = 0", "greater than 0"]),
    "control": ({"control": "inv"}, ["control = 'inv'", "inverse, transpose or damped:LAMBDA"]),
    "feedback": ({"feedback": "lqr"}, ["feedback = 'lqr'", "pd, pid, robust or none"]),
    "integrator": ({"integrator": "euler"}, ["integrator = 'euler'", "rk4, dop853 or gauss"]),
    "elbow": ({"elbow": "left"}, ["elbow = 'left'", "up or down"]),
    "hold": ({"hold": 1}, ["hold = 1", "true or false"]),
    "gravity": ({"gravity": "yes"}, ["gravity = 'yes'", "true or false"]),
    "baked": ({"baked": "no"}, ["baked = 'no'", "true or false"]),
    "posture of one": ({"posture": [1.0]}, ["posture = [1.0]", "2 angles in rad", "boom, stick", "not 1"]),
    "posture empty": ({"posture": []}, ["posture = []", "rad"]),
    "posture NaN": ({"posture": [NAN, 1.0]}, ["posture", "entry 1", "finite", "rad"]),
    "posture huge": ({"posture": [100.0, 1.0]}, ["posture (boom) = 100", "between -12.5664 and 12.5664 rad"]),
    "posture text": ({"posture": "up"}, ["posture = 'up'", "not text"]),
    "posture of arrays": ({"posture": np.ones((2, 2))}, ["posture", "not a list"]),
    "offset of one": ({"offset": [0.1]}, ["offset = [0.1]", "2 angles in rad"]),
    "offset infinite": ({"offset": [0.1, INF]}, ["offset", "entry 2", "finite"]),
    "neither": ({"posture": None}, ["posture, end_point", "give one of the two"]),
    "both": ({"end_point": [1.0, 1.0]}, ["posture, end_point", "give one of the two"]),
    "end-point of one": ({"posture": None, "end_point": [1.0]}, ["end_point = [1.0]", "two numbers x, y in m"]),
    "end-point NaN": ({"posture": None, "end_point": [1.0, NAN]}, ["end_point", "entry 2 must be finite", "1e+06 m"]),
    "base of two": ({"base": [1, 2]}, ["base = [1.0, 2.0]", "one number", "m"]),
    "base NaN": ({"base": NAN}, ["base = nan", "finite"]),
    "duration zero": ({"duration": 0}, ["duration = 0", "greater than 0", "s"]),
    "duration negative": ({"duration": -3.0}, ["duration = -3", "greater than 0"]),
    "rate zero": ({"rate": 0}, ["rate = 0", "greater than 0", "Hz"]),
    "too many samples": ({"duration": 1e6, "rate": 1e5}, ["duration, rate = 1e+06 s at 100000 Hz, 1e+11", "10000000 samples"]),
    "no sample": ({"duration": 1e-9}, ["duration, rate", "between 1 and"]),
    "substeps none": ({"substeps": 0}, ["substeps = 0", "between 1 and 1000"]),
    "substeps half": ({"substeps": 1.5}, ["substeps = 1.5", "whole number"]),
    "seed": ({"seed": -1}, ["seed = -1", "whole number"]),
    "damper": ({"nullspace_damping": -1}, ["nullspace_damping = -1", "N m s/rad"]),
    "delay too long": ({"sensor": {"delay": 9.0}}, ["sensor.delay = 9", "at most 100 samples of 0.005 s"]),
    "noise negative": ({"sensor": {"noise": -1}}, ["sensor.noise = -1", "between 0 and 1000 m"]),
    "sensor misspelt": ({"sensor": {"noize": 1}}, ["sensor.noize", "did you mean 'noise'"]),
    "sensor no table": ({"sensor": 3}, ["sensor = 3", "table"]),
    "sensor without samples": ({"hold": False, "sensor": {"noise": 1e-3}}, ["sensor", "hold = true"]),
    "rate limit alone": ({"actuator": {"rate_limit": 1.0}}, ["actuator.rate_limit", "needs actuator.bandwidth_hz"]),
    "limits of three": ({"actuator": {"torque_limit": [1, 2, 3]}}, ["actuator.torque_limit", "boom, stick"]),
    "limit negative": ({"actuator": {"torque_limit": -1}}, ["actuator.torque_limit = -1", "N m"]),
    "limits empty": ({"actuator": {"dead_band": []}}, ["actuator.dead_band = []", "N m"]),
    "bandwidth zero": ({"actuator": {"bandwidth_hz": 0}}, ["actuator.bandwidth_hz = 0", "Hz"]),
    "path standing still": ({"base_path": {"times": [0, 0], "points": [[0], [1]]}}, ["base_path.times", "increase, in s"]),
    "path back in time": ({"target_path": {"times": [1, 0], "points": [[0, 0], [1, 1]]}}, ["target_path.times", "increase"]),
    "path too short": ({"base_path": {"times": [0, 1], "points": [[0]]}}, ["base_path.points = 1", "2 times"]),
    "path of pairs": ({"base_path": {"times": [0, 1], "points": [[0, 1], [1, 1]]}}, ["base_path.points", "1 coordinates", "m"]),
    "path of singles": ({"target_path": {"times": [0, 1], "points": [[0], [1]]}}, ["target_path.points", "2 coordinates"]),
    "path infinite": ({"target_path": {"times": [0, 1], "points": [[0, 0], [1, INF]]}}, ["target_path.points", "point 2: entry 2", "finite"]),
    "path empty": ({"target_path": {"times": [], "points": []}}, ["target_path.times = []", "target_path.points = []"]),
    "path incomplete": ({"target_path": {"times": [0, 1]}}, ["target_path.points", "required and missing"]),
    "path text": ({"target_path": {"times": [0, 1], "points": "ab"}}, ["target_path.points = 'ab'", "list of points"]),
}  # fmt: skip


@pytest.mark.parametrize("name", list(FAULTS))
def test_one_fault(name):
    options, words = FAULTS[name]
    message = refused(**options)
    for word in words:
        assert word in message, message
    assert message.startswith("simulate")


def test_every_fault_of_single_values_at_once():
    message = refused(kp=-1, kv="x", rate=0, control="z", sensor={"noise": -1}, duration=NAN)
    assert "6 faults" in message
    for word in ("kp = -1", "kv = 'x'", "rate = 0", "control = 'z'", "sensor.noise = -1", "duration = nan"):
        assert word in message


def test_every_fault_of_what_does_not_fit_together_at_once():
    message = refused(
        kp=[1, 2, 3], offset=[0.1], sensor={"delay": 3.3}, actuator={"rate_limit": 1.0, "torque_limit": [1, 2, 3]},
        base_path={"times": [0, 0], "points": [[0], [1]]}, end_point=[1.0, 1.0],
    )  # fmt: skip
    assert "7 faults" in message
    for word in ("kp", "offset", "sensor.delay", "rate_limit", "torque_limit", "base_path.times", "posture, end_point"):
        assert word in message


@pytest.mark.parametrize("value", [3, None, "excavator", {"name": "excavator"}])
def test_not_a_machine(value):
    with pytest.raises(InputError, match=r"machine = .*: must be a Machine"):
        flexopt.simulate(value, POSTURE_B)


def test_an_end_point_does_not_name_a_posture_of_three_joints():
    message = refused(THREE, posture=None, end_point=[1.0, 1.0])
    assert "end_point = [1.0, 1.0]" in message
    assert "3 actuated joints" in message


def test_a_base_that_cannot_give_cannot_be_driven():
    message = refused(RIGID_IN_X, posture=(0.4, 1.2), base_path={"times": [0, 1], "points": [[0], [1]]})
    assert "base_path" in message
    assert "gives in x" in message


def test_a_posture_beyond_the_joints_limits():
    data = draw_machine(NumpySource(np.random.default_rng(0)), Structure(2, ("x",), ()))
    data["links"][0]["limits"] = [-1.0, 0.5]
    message = refused(machine_from_dict(data), posture=(0.7, 1.0))
    assert "posture (joint1) = 0.7" in message
    assert "between -1 and 0.5 rad" in message


def test_a_singular_posture():
    with pytest.raises(SingularPosture, match="stick") as caught:
        flexopt.simulate(EXCAVATOR, (0.3, 0.0))
    assert caught.value.joint == "stick"


def test_an_end_point_out_of_reach():
    with pytest.raises(UnreachableTarget, match=r"9\.23 m outside") as caught:
        flexopt.simulate(EXCAVATOR, end_point=(9.0, 9.0))
    assert caught.value.miss == pytest.approx(9.23, abs=0.01)


@pytest.mark.parametrize(("rate", "need"), [(49.0, 2), (20.0, 3), (5.0, 11)])
def test_rk4_too_slow_for_the_fastest_mode(rate, need):
    """|R(iy)| passes 1 at y = √8: the message says how many substeps keep below it, and that many are taken."""
    message = refused(rate=rate, duration=1.0)
    fastest = max(flexopt.evaluate(EXCAVATOR, POSTURE_B).frequencies_hz)
    assert need == math.ceil(2 * math.pi * fastest / rate / math.sqrt(8))
    assert f"substeps of at least {need}" in message
    assert f"rate = {rate:g} Hz" in message
    assert f"{fastest:.4g} Hz" in message
    assert "dop853" in message
    low = {"kp": 1e3, "kv": 1e2}
    flexopt.simulate(EXCAVATOR, POSTURE_B, rate=rate, duration=1.0, substeps=need, **low)
    if need > 2:
        assert f"at least {need}" in refused(rate=rate, duration=1.0, substeps=need - 1)


def test_a_sample_of_more_than_a_thousand_steps():
    message = refused(rate=1e-2, duration=200.0, integrator="dop853")
    assert "rate = 0.01 Hz" in message
    assert "1000 integration steps" in message


def test_a_machine_that_falls_over():
    data = draw_machine(
        NumpySource(np.random.default_rng(1)), Structure(2, ("rotation",), ()), frequency=(0.01, 0.02), spread=1.0
    )
    data["base"] |= {"rest_angle": math.pi / 2, "com": 3.0, "length": 3.0}
    data["gravity"] = 9.81
    machine = machine_from_dict(data)
    flexopt.simulate(machine, (0.3, 0.9), duration=0.1, kp=1.0, kv=1.0)
    assert "springs do not hold the machine" in refused(machine, posture=(0.3, 0.9), gravity=True)


def test_a_mode_that_the_arm_cannot_reach():
    """An arm balanced about its joints moves no momentum sideways: the base's x mode, undamped, is out of control."""
    data = draw_machine(NumpySource(np.random.default_rng(1)), Structure(2, ("x",), ()), damping_ratio=0.0)
    data["payload"]["mass"] = 0.0
    first, second = data["links"]
    first |= {"mass": 20.0, "length": 1.0, "com": -0.5, "com_offset": 0.0}
    second |= {"mass": 10.0, "com": 0.0, "com_offset": 0.0}
    machine = machine_from_dict(data)
    with pytest.raises(NotStabilizable) as caught:
        flexopt.simulate(machine, (0.4, 1.2), feedback="robust")
    frequency = math.sqrt(data["base"]["stiffness"]["x"] / (30.0 + data["base"]["mass"]))
    assert abs(np.log(caught.value.mode) * 200.0) == pytest.approx(frequency, rel=1e-3)


def ends_as_numbers(trajectory):
    text = json.dumps(trajectory.to_dict(), allow_nan=False)
    assert "NaN" not in text
    assert "Infinity" not in text
    repr(trajectory)
    return json.loads(text)


@pytest.mark.parametrize("integrator", ["rk4", "dop853"])
@pytest.mark.parametrize("control", ["inverse", "transpose"])
def test_a_run_that_leaves_the_finite_numbers(integrator, control):
    with pytest.warns(FlexoptWarning, match="left the finite numbers at"):
        trajectory = flexopt.simulate(
            EXCAVATOR, POSTURE_A, kp=1e12, kv=1e12, control=control, integrator=integrator, duration=20.0
        )
    assert trajectory.verdict == "grows"
    assert trajectory.end_error is None
    assert trajectory.settling_time is None
    assert trajectory.overshoot is None
    assert any("left the finite numbers" in sentence for sentence in trajectory.warnings)
    document = ends_as_numbers(trajectory)
    assert document["end_error"] is None
    assert document["verdict"] == "grows"
    # Up to where it broke it is a run like any other.
    alive = np.all(np.isfinite(trajectory.q), axis=1)
    assert alive[0]
    assert not alive[-1]
    assert not np.any(np.diff(alive.astype(int)) > 0)


def test_an_arm_that_passes_close_to_a_singular_posture():
    """A target beyond the reach stretches the arm until Jv loses rank."""
    target = flexopt.simulate(EXCAVATOR, POSTURE_B, duration=0.01).target[0]
    far = target + np.array([2.0, 0.5])
    with pytest.warns(FlexoptWarning, match="close to a singular posture"):
        trajectory = flexopt.simulate(
            EXCAVATOR, POSTURE_B, control="transpose", kp=2e4, kv=1e4, duration=4.0,
            target_path={"times": [0.0, 2.0], "points": [target, far]},
        )  # fmt: skip
    stick = np.abs(np.sin(trajectory.q[:, -1]))
    at = float(trajectory.warnings[0].split(" at ")[1].split(" s")[0])
    assert at == pytest.approx(trajectory.time[np.argmin(stick)], abs=1e-3)
    assert stick.min() ** 2 < 1e-3 * stick[0] ** 2
    ends_as_numbers(trajectory)


def test_self_motion_that_nobody_damps():
    with pytest.warns(FlexoptWarning, match="does not brake the arm's self-motion"):
        flexopt.simulate(THREE, (0.3, 0.8, -0.7), duration=0.05, kp=1.0, kv=1.0, rate=1e4)


@pytest.mark.long
def test_rk4_too_slow_for_a_servo():
    """|R(−y)| passes 1 at y = 2.785, which a mode's limit would not tell."""
    servo = {"actuator": {"bandwidth_hz": 200.0}, "duration": 2.0}
    message = refused(**servo)
    assert "servo of 200 Hz" in message
    assert "substeps of at least 3" in message
    fine = [
        flexopt.simulate(EXCAVATOR, POSTURE_B, **servo, **how)
        for how in ({"substeps": 3}, {"integrator": "dop853"}, {"integrator": "gauss"})
    ]
    for run in fine[:2]:
        assert run.verdict == "converges"
        assert np.abs(run.q - fine[2].q).max() < 2e-3


def test_iterations_that_do_not_converge_are_an_error():
    """Gauss's method with a continuous controller faster than its step: refused, not returned."""
    with pytest.raises(NoSolutionFound, match="more substeps") as caught:
        flexopt.simulate(EXCAVATOR, POSTURE_B, hold=False, integrator="gauss", kp=1e7, kv=2e5, duration=0.5)
    assert caught.value.violations["implicit step"] > 1e-10


def test_a_run_that_grows_is_shown_up_to_where_the_iterations_follow_it():
    """More substeps would not help: what grows at 5/s soon has no motion left to speak of."""
    with pytest.warns(FlexoptWarning, match="grew beyond what the implicit integrator follows at"):
        run = flexopt.simulate(EXCAVATOR, POSTURE_A, integrator="gauss", kp=1e6, kv=2e4, rate=50.0, duration=3.0)
    assert run.verdict == "grows"
    assert run.linear_growth_rate > 0
    alive = np.all(np.isfinite(run.q), axis=1)
    assert np.flatnonzero(~alive)[0] > 0
    assert not np.any(np.diff(alive.astype(int)) > 0)
    assert not any("left the finite numbers" in sentence for sentence in run.warnings)
    assert ends_as_numbers(run)["verdict"] == "grows"


CALLS = [
    (flexopt.simulate, SimulationKeywords),
    (flexopt.simulate_ensemble, SimulationKeywords),
    (flexopt.export_fmu, SimulationKeywords),
    (flexopt.sampled_loop, LinearKeywords),
    (flexopt.stability_border, LinearKeywords),
]


@pytest.mark.parametrize(("call", "keywords"), CALLS)
def test_every_option_is_a_keyword_with_a_type(call: Any, keywords: type) -> None:
    parameters = inspect.signature(call).parameters
    assert parameters.keys() >= flexopt.SimulationOptions.model_fields.keys()
    assert set(keywords.__annotations__) == set(flexopt.SimulationOptions.model_fields) - {"posture"}
    assert [name for name, one in parameters.items() if one.annotation is inspect.Parameter.empty] == []


def test_options_are_one_object_or_keywords() -> None:
    """The same answer however they are given; a keyword goes before the field; faults of both come together."""
    machine, posture = flexopt.load("excavator"), [0.0448, -2.0499]
    options = flexopt.SimulationOptions(kp=1e4, kv=1e3, duration=0.1, sensor={"delay": 0.01})
    by_object = flexopt.simulate(machine, posture, options=options)
    by_keyword = flexopt.simulate(machine, posture, kp=1e4, kv=1e3, duration=0.1, sensor=flexopt.Sensor(delay=0.01))
    assert np.array_equal(by_object.q, by_keyword.q)
    assert by_object.provenance["options"] == by_keyword.provenance["options"]
    assert len(flexopt.simulate(machine, posture, options=options, duration=0.05).time) == 11
    held = flexopt.SimulationOptions(posture=posture, kp=1e4, kv=1e3)
    assert flexopt.sampled_loop(machine, options=held).growth_rate == (
        flexopt.sampled_loop(machine, posture, kp=1e4, kv=1e3).growth_rate
    )
    with pytest.raises(InputError) as caught:
        flexopt.simulate(machine, options=options, kv=-1.0)
    assert [fault.field for fault in caught.value.faults] == ["kv"]
    with pytest.raises(InputError, match=r"must be SimulationOptions"):
        flexopt.simulate(machine, posture, options=flexopt.SelectionOptions())  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match=r"sensor\.noise"):
        flexopt.SimulationOptions(sensor={"noise": -1.0})
