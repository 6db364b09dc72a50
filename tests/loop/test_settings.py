"""The table [loop]: read with machines, its faults, what follows from the machine, and how evaluations tell it."""

from __future__ import annotations

import json
import math
import warnings
from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.errors import FlexoptWarning, InputError, ModelError
from flexopt.loop.gains import rigid_gains
from flexopt.loop.outcome import MEASURES
from flexopt.loop.settings import loop_settings
from flexopt.model.loop import drive_of, rate_of
from tests.conftest import ROOT
from tests.simulation.loops import EXCAVATOR, POSTURE_B

GAINS = {"kp": 1e4, "kv": 1e3, "dead_time": 0.0031}
DIGGER, STAND = flexopt.load("slewing-excavator"), (0.2, 0.5, -1.2, -0.5)


def with_loop(machine, loop):
    """The machine with that table, and read again from what it writes."""
    read = flexopt.machine_from_dict if isinstance(machine, flexopt.Machine) else flexopt.tree_from_dict
    found = read(machine.to_dict() | {"loop": loop})
    assert read(found.to_dict()) == found
    return found


@pytest.mark.parametrize("machine", [EXCAVATOR, DIGGER])
def test_a_machine_with_a_loop(machine):
    found = with_loop(machine, GAINS)
    assert found.loop == flexopt.Loop(**GAINS)
    assert found != machine
    assert machine.loop is None
    assert "loop" not in machine.to_dict()


def test_files_of_both_kinds(tmp_path):
    table = "[loop]\nkp = 3e6\nkv = 6e5\ndead_time = 0.0131\n"
    for name in ("excavator", "slewing-excavator"):
        source = ROOT / "models" / f"{name}.toml"
        text = source.read_text(encoding="utf-8").replace(
            'robot = "robots/', f'robot = "{source.parent.as_posix()}/robots/'
        )
        target = tmp_path / f"{name}.toml"
        target.write_text(text + "\n" + table, encoding="utf-8")
        assert flexopt.load(target).loop == flexopt.Loop(kp=3e6, kv=6e5, dead_time=0.0131)
        target.write_text(text + "\n" + table.replace("kv = 6e5", "kv = [1, 2, 3, 4, 5]\nkq = 1"), encoding="utf-8")
        with pytest.raises(ModelError, match=r"loop\.kq: unknown key"):
            flexopt.load(target)
        target.write_text(text + "\n" + table.replace("kv = 6e5", "kv = [1, 2, 3, 4, 5]"), encoding="utf-8")
        with pytest.raises(ModelError, match=r"loop\.kv = .* one for each of the \d task axes"):
            flexopt.load(target)


FAULTS = [
    ({"kp": -1.0, "rate": 0.0, "drive": "steam"}, "kp rate drive"),
    ({"kp": [1, 2, 3], "bandwidth_hz": [1, 2, 3], "rate_limit": 1.0}, "kp bandwidth_hz"),
    ({"rate_limit": 1.0}, "rate_limit"),
    ({"drive": "velocity"}, "servo_gain"),
    ({"drive": "velocity", "control": "transpose", "servo_gain": 1.0}, "control"),
    ({"control": "transpose", "servo_gain": 1.0}, "control"),
    ({"drive": "torque", "servo_gain": 1.0, "ki": 1.0}, "servo_gain ki"),
    ({"kp": 5.0, "kp_range": [10, 20], "kv": 5.0, "kv_range": [1, 4]}, "kp kv"),
    ({"kp_range": [20, 10]}, "kp_range"),
    ({"dead_time": 1.0, "rate": 200.0}, "dead_time"),
    ({"dead_time": "soon", "speed": 1}, "dead_time speed"),
]


@pytest.mark.parametrize(("table", "fields"), FAULTS, ids=str)
def test_faults_are_named_together(table, fields):
    with pytest.raises(InputError) as of_call:
        flexopt.evaluate(EXCAVATOR, POSTURE_B, loop=table)
    assert {fault.field for fault in of_call.value.faults} == {f"loop.{field}" for field in fields.split()}
    with pytest.raises(ModelError) as of_file:
        flexopt.machine_from_dict(EXCAVATOR.to_dict() | {"loop": table})
    assert [str(fault) for fault in of_file.value.faults] == [str(fault) for fault in of_call.value.faults]


@pytest.mark.long
def test_control_is_one():
    assert flexopt.evaluate(EXCAVATOR, POSTURE_B, loop=GAINS | {"control": "transpose"}).control == "transpose"
    with pytest.raises(InputError, match=r"loop\.control = 'transpose': is not the control that is asked for, inverse"):
        flexopt.evaluate(EXCAVATOR, POSTURE_B, control="inverse", loop=GAINS | {"control": "transpose"})
    with pytest.raises(InputError, match="velocity-served joints want rates"):
        flexopt.evaluate(DIGGER, STAND, control="transpose", loop={"drive": "velocity"})
    served = flexopt.tree_from_dict(DIGGER.to_dict() | {"loop": {"drive": "velocity", "kp": 1.0}})
    named = flexopt.tree_from_dict(DIGGER.to_dict() | {"loop": {"control": "inverse"}})
    for machine in (served, named):
        with pytest.raises(InputError, match="the loop is the machine file's own, which loop = 'default' leaves out"):
            flexopt.evaluate(machine, STAND, control="transpose")
        for left_out in ("default", {}):
            assert flexopt.evaluate(machine, STAND, control="transpose", loop=left_out).control == "transpose"
    # What drives are taken for follows from the control, too.
    assert flexopt.evaluate(DIGGER, STAND, control="transpose", loop={}).outcome.settings.drive == "torque"


def settings_of(machine, posture, **table):
    loop = flexopt.Loop(**table)
    return loop_settings(machine, loop, flexopt.evaluate(machine, posture))


def test_what_is_left_out_follows_from_the_machine():
    plain = settings_of(EXCAVATOR, POSTURE_B)
    assert (plain.drive, plain.rate, plain.dead_time) == ("torque", 200.0, 0.0)
    assert set(plain.sources) == {"drive", "rate", "kp", "kv", "dead_time"}
    assert plain.outcome(EXCAVATOR, np.zeros(1), np.array(POSTURE_B), gravity=False).loop.stable
    served = settings_of(DIGGER, STAND)
    assert (served.drive, served.rate) == ("velocity", 100.0)
    np.testing.assert_array_equal(served.kp, [1.0] * 3)
    # No full lever asks a joint for more than its effort, and one for just that.
    hydraulics = flexopt.build_hydraulics(DIGGER)
    p = hydraulics.plant.parameter_values
    for lever in (-1.0, 1.0):
        rates = np.abs(hydraulics.rates(STAND, np.full(4, lever), p).full().ravel())
        assert np.all(
            served.servo_gain * rates <= np.abs(hydraulics.joint_efforts(STAND, p).full()).max(axis=1) * (1 + 1e-9)
        )
    # A gain alone brings the other along, at the same damping ratio; gains alone are those of torques.
    heavy = settings_of(DIGGER, STAND, kp=3e6)
    assert (heavy.drive, heavy.rate) == ("torque", 200.0)
    lighter = settings_of(DIGGER, STAND, kp=3e6 / 4)
    np.testing.assert_allclose(heavy.kv, 2 * lighter.kv, rtol=1e-12)
    again = settings_of(DIGGER, STAND, kv=float(heavy.kv[0]))
    np.testing.assert_allclose(again.kp, heavy.kp, rtol=1e-12)
    assert (
        set(settings_of(EXCAVATOR, POSTURE_B, kp=1.0, kv=1.0, rate=50.0, drive="torque", dead_time=0.0).sources)
        == set()
    )
    ranged = settings_of(EXCAVATOR, POSTURE_B, kp_range=[1e3, 1e5], kv_range=[0.0, 3e3])
    assert (ranged.kp[0], ranged.kv[0]) == pytest.approx((1e4, 1.5e3))


def test_a_gain_of_0_says_nothing_of_the_other():
    both = rigid_gains(EXCAVATOR, flexopt.evaluate(EXCAVATOR, POSTURE_B), 200.0)
    for zero, other in (("kp", "kv"), ("kv", "kp")):
        found = settings_of(EXCAVATOR, POSTURE_B, **{zero: 0.0})
        np.testing.assert_array_equal(getattr(found, other), both[other])
        assert "corner at 0.3" in found.sources[other]
        # Beside a gain that is given the corner is that gain's.
        assert "corner" not in settings_of(EXCAVATOR, POSTURE_B, **{zero: 1e4}).sources[other]


@pytest.mark.parametrize("gains", [{"kv": 1e3}, {"kv": 0.0, "ki": 10.0, "feedback": "pid"}])
def test_without_kp_there_are_no_intervals_of_it(gains):
    """The second grows with any gains."""
    found = flexopt.outcome(EXCAVATOR, POSTURE_B, loop={"kp": 0.0, **gains})
    assert math.isnan(found.allowed_gain)
    assert found.gain_intervals == ()
    assert "allowed gain Kp –\n" in repr(found)


def test_drive_and_rate():
    assert (drive_of(flexopt.Loop(servo_gain=3.0), EXCAVATOR), rate_of(flexopt.Loop(servo_gain=3.0), EXCAVATOR)) == (
        "velocity",
        100.0,
    )
    assert rate_of(flexopt.Loop(rate=33.0), DIGGER) == 33.0


def test_an_evaluation_tells_it():
    plain = flexopt.evaluate(EXCAVATOR, POSTURE_B)
    assert plain.outcome is None
    assert "outcome" not in plain.to_dict()
    found = flexopt.evaluate(EXCAVATOR, POSTURE_B, loop=GAINS)
    of_file = flexopt.evaluate(with_loop(EXCAVATOR, GAINS), POSTURE_B)
    document = found.to_dict()
    assert json.loads(json.dumps(document["outcome"], allow_nan=False)) == of_file.to_dict()["outcome"]
    assert {key: document[key] for key in plain.to_dict() if key != "provenance"} == {
        key: value for key, value in plain.to_dict().items() if key != "provenance"
    }
    loop = document["outcome"]
    assert loop["allowance_isotropic"][0] is None  # no gain that is the same in all directions excites the mode
    assert loop["settings"]["sources"] == {
        "drive": "gains without a drive are those of torques",
        "rate": "200 Hz, as in the article",
    }
    parameters, m = len(flexopt.build_plant(EXCAVATOR).parameter_names), len(found.w)
    for name in MEASURES:
        assert np.shape(loop["gradient"][name]["parameters"]) == (parameters,)
    for name in ("allowance", "lag", "lag_reserve", "first_order_decay", "w_lagged", "damping_ratios"):
        assert np.shape(loop["gradient"][name]["posture"]) == (m, 2)
        assert len(loop[name]) == m
    text = repr(found)
    for word in ("κ", "lag", "reserve", "delay margin", "disk margin", "allowed gain", "decays at 0.0151/s"):
        assert word in text
    assert "<table" in found._repr_html_()


def test_of_modes_that_share_a_frequency_nothing_is_said_one_by_one():
    table = EXCAVATOR.to_dict()
    # A base whose centre of mass and springs are the same in x and y, and an arm of no mass to speak of.
    table["base"] |= {"com": 0.0, "rest_angle": math.pi / 2}
    table["links"] = tuple(dict(link) | {"mass": 1e-6, "inertia": 1e-6, "com": 0.0} for link in table["links"])
    machine = flexopt.machine_from_dict(table)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FlexoptWarning)
        found = flexopt.evaluate(machine, POSTURE_B, loop={"kp": 1e-6, "kv": 1e-6})
    assert found.clusters
    shared = list(found.clusters[0])
    assert np.all(np.isnan(found.outcome.allowance[shared]))


def test_a_joint_that_brakes_itself_more_than_its_servo_drives_it_is_named() -> None:
    """One gain serves slides and hinges; what hardly follows it is told, with the share that it makes of the rate."""
    data = flexopt.load("boom-stick-bucket").to_dict()
    posture = (-1.0, -1.5, -1.0)
    free = flexopt.outcome(flexopt.machine_from_dict(data), posture, loop="default").settings
    assert "brakes itself" not in free.sources["servo_gain"]
    own = 9.0 * free.servo_gain
    data["links"] = [{**link, "joint_damping": own} if link["name"] == "stick" else link for link in data["links"]]
    told = flexopt.outcome(flexopt.machine_from_dict(data), posture, loop="default").settings
    assert told.servo_gain == pytest.approx(free.servo_gain)
    sentence = f"stick brakes itself by {own:.4g} N m s/rad and makes 10 % of the rate asked for: give servo_gain"
    assert sentence in told.sources["servo_gain"]
    # Verdicts and regions list the names of what nobody gave, and this.
    assert free.hardly_served == ""
    assert told.proposed[1] == f"  {sentence}"


def test_feedback_with_an_integral_but_no_gain_of_it_says_so() -> None:
    told = flexopt.outcome(EXCAVATOR, POSTURE_B, loop={"feedback": "pid", "kp": 1e4, "kv": 1e3}).settings
    assert told.sources["ki"] == "none is given, without which pid is pd"
    assert "ki" not in flexopt.outcome(EXCAVATOR, POSTURE_B, loop={"kp": 1e4, "kv": 1e3}).settings.sources


def test_a_servo_gain_follows_from_the_posture_where_cylinders_do() -> None:
    """Elsewhere efforts and rates are those of every posture, and nothing is to be handed on."""
    assert "servo_gain" in settings_of(DIGGER, STAND).of_posture
    arm = flexopt.load("mobile-manipulator")
    postures = ((0.0, -1.0, 1.5, -0.5, -1.57, 0.0), (0.4, -0.6, 1.1, -0.5, -1.2, 0.3))
    one, other = (settings_of(arm, posture, drive="velocity") for posture in postures)
    assert one.servo_gain == other.servo_gain
    assert one.of_posture == []


def test_limits_of_drives_are_told_with_the_controller() -> None:
    """A run that they hold back would else have nothing to show for it."""
    machine, posture = flexopt.load("truck-crane"), (0.3, 0.6, -1.0, 0.8)
    law = flexopt.Loop(
        kp=1e6, kv=1e5, drive="torque", bandwidth_hz=20.0, torque_limit=[1e5, 2e5, 2e5, 3e4], rate_limit=2e5
    )
    told = repr(loop_settings(machine, law, flexopt.evaluate(machine, posture)))
    assert "servo 20 Hz, torque limit [1e+05, 2e+05, 2e+05, 3e+04] N m or N, rate limit 2e+05 N m/s or N/s" in told
    free = repr(
        loop_settings(
            machine,
            law.model_copy(update={"torque_limit": None, "rate_limit": None}),
            flexopt.evaluate(machine, posture),
        )
    )
    assert "limit" not in free


@pytest.mark.filterwarnings("ignore::flexopt.FlexoptWarning")
@pytest.mark.parametrize("stick", [0.0, math.pi])
def test_no_gains_are_proposed_for_a_posture_that_is_singular(stick: float) -> None:
    """A damped control bears to be there with gains that are given."""
    asked: dict[str, Any] = {"control": "damped:0.2"}
    assert (
        flexopt.evaluate(EXCAVATOR, (0.5, stick), **asked, loop=GAINS | asked).outcome.settings.kp.max() == GAINS["kp"]
    )
    with pytest.raises(flexopt.SingularPosture, match="bend stick, or give kp and kv in \\[loop\\]"):
        flexopt.evaluate(EXCAVATOR, (0.5, stick), **asked, loop=asked)
