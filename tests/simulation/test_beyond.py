"""Runs that ask a machine for more than it can: what is told is what the recorded samples show."""

from __future__ import annotations

import re
import warnings
from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.model import machine_from_dict
from flexopt.model.parameter_values import with_parameters
from tests.simulation.loops import EXCAVATOR, POSTURE_A

DIGGER, STAND = flexopt.load("slewing-excavator"), (0.2, 0.5, -1.2, -0.5)
NUMBER = r"(-?[\d.]+(?:e[+-]\d+)?)"


def told(run: flexopt.Trajectory) -> str:
    return next((each for each in run.warnings if each.startswith("nothing in this run holds")), "")


@pytest.mark.filterwarnings("ignore::flexopt.errors.FlexoptWarning")
def test_joints_of_a_machine_with_cylinders_are_told_as_recorded() -> None:
    """Limits by strokes, efforts by pistons at the lever arms that the postures have then."""
    run = flexopt.simulate(DIGGER, STAND, kp=3e7, kv=3e5, duration=4.0)
    sentence, m = told(run), run.n_passive
    joints, rates = run.q[:, m:], run.v[:, m:]
    hydraulics = flexopt.build_hydraulics(DIGGER)
    p = hydraulics.plant.parameter_values
    least, most = np.moveaxis([hydraulics.joint_efforts(q, p).full() for q in joints], -1, 0)
    low, high = np.array(DIGGER.limits).T
    for i, joint in enumerate(DIGGER.joints):
        part = re.search(rf"(?:: |, ){joint} (.*?)(?:, (?:{'|'.join(DIGGER.joints)}) |; )", sentence)
        for word, values, lower, upper in (
            ("came to", joints[:, i], low[i], high[i]),
            ("took up to", run.torque[:, i], least[:, i], most[:, i]),
            ("moved at up to", rates[:, i], -DIGGER.speeds[i], DIGGER.speeds[i]),
        ):
            past = np.maximum(values - upper, lower - values)
            number = re.search(rf"{word} {NUMBER}", part[1] if part else "")
            assert (number is not None) == (past.max() > 0), (joint, word)
            if number is not None:
                assert abs(float(number[1])) == pytest.approx(abs(values[past.argmax()]), rel=1e-3)
    assert sentence.endswith("; actuator.torque_limit lets drives saturate")


@pytest.mark.filterwarnings("ignore::flexopt.errors.FlexoptWarning")
def test_an_effort_is_no_torque_limit() -> None:
    data = EXCAVATOR.to_dict()
    links = [link | {"effort": 300.0} for link in data["links"]]
    feeble = machine_from_dict(data | {"links": links})
    loop: dict[str, Any] = {"kp": 1e4, "kv": 1e3, "duration": 2.0}
    run = flexopt.simulate(feeble, POSTURE_A, **loop)
    assert abs(run.torque).max() > 300.0
    assert re.search(rf"boom took up to {NUMBER} N m \(effort 300\)", told(run))
    held = flexopt.simulate(feeble, POSTURE_A, actuator={"torque_limit": 300.0}, **loop)
    assert abs(held.torque).max() == 300.0
    assert told(held) == ""
    assert told(flexopt.simulate(EXCAVATOR, POSTURE_A, **loop)) == ""
    real = flexopt.simulate(feeble, POSTURE_A, loop={"kp": 1e4, "kv": 1e3}, duration=2.0)
    assert told(real).endswith("; loop.torque_limit lets drives saturate")


@pytest.mark.filterwarnings("ignore::flexopt.errors.FlexoptWarning")
def test_a_run_that_leaves_the_finite_numbers_has_no_extremes() -> None:
    run = flexopt.simulate(DIGGER, STAND, kp=1e11, kv=1e9, duration=4.0)
    assert any("left the finite numbers" in each for each in run.warnings)
    assert told(run) == ""


@pytest.mark.filterwarnings("ignore::flexopt.errors.FlexoptWarning")
def test_cylinders_are_told_of_as_their_lengths_change() -> None:
    """Rates by differences of the lengths at the recorded postures; those within their speeds are not told of."""
    run = flexopt.simulate(DIGGER, STAND, kp=3e7, kv=3e5, duration=2.0)
    hydraulics = flexopt.build_hydraulics(DIGGER)
    p, joints = hydraulics.plant.parameter_values, run.q[:, run.n_passive :]
    lengths = np.array([hydraulics.lengths(q, p).full().ravel() for q in joints])
    # Of the second order in the sample, by what the rates' slopes change.
    rates = np.gradient(lengths, run.time, axis=0)
    for i, cylinder in enumerate(DIGGER.cylinders):
        past = np.maximum(rates[:, i] - cylinder.speed[1], -cylinder.speed[0] - rates[:, i])
        number = re.search(rf"{cylinder.name} moved at up to {NUMBER} m/s", told(run))
        if past.max() > 0.02:
            assert number is not None
            assert float(number[1]) == pytest.approx(np.abs(rates[past.argmax(), i]), rel=0.05)
        elif past.max() < -0.02:
            assert number is None


def test_a_torque_limit_below_the_weight_is_told() -> None:
    """Nothing holds the arm then, whatever the base does while it falls; a limit above it says nothing."""
    machine, posture = flexopt.load("boom-stick-bucket"), (-1.5, -0.5, -0.5)
    plant = flexopt.build_plant(machine)
    q = plant.rest([0.0], posture, plant.parameter_values)
    # To the sag, which turns the arm by some thousandths.
    weight = float(np.abs(plant.gravity(q, [0.0], plant.parameter_values).full().ravel()[-3:]).max())
    options: dict[str, Any] = {"kp": 1e5, "kv": 3e4, "nullspace_damping": 3e3, "gravity": True, "duration": 20.0}
    for share, told in ((0.95, True), (1.1, False)):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            run = flexopt.simulate(
                machine, posture, actuator=flexopt.Actuator(torque_limit=share * weight), offset=[1e-4] * 3, **options
            )
        assert any("the arm is not held: " in str(each.message) for each in caught) == told
        # In its fall the base comes to rest, and the linear loop, which knows no limit, settles.
        assert run.linear_growth_rate is not None
        assert run.linear_growth_rate < 0
        assert run.verdict == ("undecided" if told else "converges")
        assert ("the arm is not held: " in run.verdict_reason) == told


@pytest.mark.filterwarnings("ignore::flexopt.errors.FlexoptWarning")
def test_members_too_heavy_for_a_torque_limit_do_not_converge() -> None:
    """Each by its own weight."""
    machine, posture = flexopt.load("boom-stick-bucket"), (-1.5, -0.5, -0.5)
    masses = np.array([0.0, 500.0, 1000.0, 1500.0])
    weights = list[float]()
    for mass in masses:
        plant = flexopt.build_plant(with_parameters(machine, {"payload.mass": float(mass)}))
        q = plant.rest([0.0], posture, plant.parameter_values)
        weights.append(float(np.abs(plant.gravity(q, [0.0], plant.parameter_values).full().ravel()[-3:]).max()))
    limit = (weights[1] + weights[2]) / 2
    told = r"2 of 4 members, member 2 first: the arm is not held: boom bears \S+ N m at rest, and actuator.torque_limit"
    with pytest.warns(flexopt.FlexoptWarning, match=told):
        ensemble = flexopt.simulate_ensemble(
            machine, posture, vary={"payload.mass": masses}, actuator=flexopt.Actuator(torque_limit=limit),
            gravity=True, kp=1e5, kv=3e4, nullspace_damping=3e3, duration=20.0, offset=[1e-4] * 3,
        )  # fmt: skip
    assert ensemble.verdict[:2].tolist() == ["converges"] * 2
    assert "converges" not in ensemble.verdict[2:]


@pytest.mark.filterwarnings("ignore::flexopt.errors.FlexoptWarning")
def test_members_on_softer_springs_are_weighed_where_they_rest() -> None:
    """Farther down than the nominal machine: as runs without a limit end."""
    machine, posture = flexopt.load("excavator"), (0.4, -1.4)
    vary = {"base.stiffness.rotation": 1.112e6 * np.array([1.0, 0.3, 0.2, 0.1])}
    asked: dict[str, Any] = {"kp": 1e4, "kv": 1e3, "gravity": True, "duration": 20.0, "offset": [1e-4] * 2}
    free = flexopt.simulate_ensemble(machine, posture, vary=vary, keep="trajectories", **asked)
    bears = np.abs(free.dataset["torque"].isel(time=slice(-400, None)).mean("time").to_numpy()).max(axis=-1)
    limit = float(bears[:2].mean())
    limited = flexopt.simulate_ensemble(machine, posture, vary=vary, actuator={"torque_limit": limit}, **asked)
    assert (bears > limit).tolist() == [False, True, True, True]
    assert limited.verdict[0] == "converges"
    assert "converges" not in limited.verdict[1:]


@pytest.mark.filterwarnings("ignore::flexopt.errors.FlexoptWarning")
def test_a_target_that_moves_to_where_the_arm_is_heavier() -> None:
    """It bears 2754 N m there, and 2673 N m where it begins."""
    machine, posture = flexopt.load("excavator"), (0.4, -1.4)
    ends = [flexopt.evaluate(machine, each, base=0.0, gravity=True).end_point for each in (posture, (0.4, -1.6))]
    path = {"times": [0.0, 4.0], "points": [each.tolist() for each in ends]}
    asked: dict[str, Any] = {"kp": 1e4, "kv": 1e3, "gravity": True, "duration": 40.0, "target_path": path}
    for limit, told in ((2720.0, True), (2900.0, False)):
        run = flexopt.simulate(machine, posture, actuator={"torque_limit": limit}, **asked)
        assert any("the arm is not held: stick bears 2754 N m" in each for each in run.warnings) == told
        assert run.verdict == ("undecided" if told else "converges")


def test_no_run_of_a_verdict_confirms_an_arm_that_is_not_held() -> None:
    machine, posture = flexopt.load("excavator"), (0.4, -1.4)
    plant = flexopt.build_plant(machine)
    q = plant.rest([0.0], posture, plant.parameter_values)
    weight = float(np.abs(plant.gravity(q, [0.0], plant.parameter_values).full().ravel()[-2:]).max())
    loop = {"kp": 1e4, "kv": 1e3, "rate": 200.0, "torque_limit": 0.9 * weight}
    end = flexopt.evaluate(machine, posture, base=0.0, gravity=True).end_point
    found = flexopt.verdict(
        machine, end, base=0.0, posture=posture, gravity=True, loop=loop, starts=1, members=2, runs=1, duration=1.0
    )
    assert found.stay is not None
    assert found.stay.runs is not None
    assert all("the arm is not held: " in why for why in found.stay.runs.reasons)
    assert found.word == "cannot tell" or found.place != "stay"
    # Without runs, and of members that none is made of, it is told beside the word, of others below the table.
    found = flexopt.verdict(
        machine, end, base=0.0, posture=posture, gravity=True, loop=loop, starts=2, members=2, runs=0
    )
    assert found.word == "move"
    for place in found.places:
        told = f"in {'the present place' if place.name == 'stay' else place.name} the arm is not held: "
        assert place.too_weak.startswith("the arm is not held: ")
        assert (told in found.drawbacks) == (place.name == found.place)
        assert repr(found).count(told) == 1
    loop |= {"torque_limit": 1e6}
    found = flexopt.verdict(
        machine, end, base=0.0, posture=posture, gravity=True, loop=loop, starts=1, members=2, runs=0
    )
    assert "not held" not in repr(found)


@pytest.mark.parametrize(
    ("actuator", "gives"),
    [({"torque_limit": 0.0}, "0 N m"), ({"torque_limit": 3000.0, "dead_band": 1000.0}, "2000 N m")],
)
def test_what_drives_give_at_most(actuator: dict[str, float], gives: str) -> None:
    """The stick bears 2681 N m, the boom less: with nothing both lack all, and the stick more."""
    machine = flexopt.load("excavator")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        flexopt.simulate(machine, (0.4, -1.4), actuator=flexopt.Actuator(**actuator), gravity=True, duration=0.1)
    less = " less the dead band" * ("dead_band" in actuator)
    told = [str(each.message) for each in caught if "not held" in str(each.message)]
    assert told == [
        f"the arm is not held: stick bears 2681 N m at rest, and actuator.torque_limit{less} gives it {gives}"
    ]
    assert not any(each.category is RuntimeWarning for each in caught)
