"""Joint rates through levers in the closed loop, sample by sample against the cylinders' speeds."""

from __future__ import annotations

import numpy as np
import pytest

import flexopt
from flexopt import InputError
from flexopt.model import AnyMachine, tree_from_dict
from flexopt.simulation import sampled_loop
from tests.oracles.cylinders import DIGGER, digger, digger_in_space, length_in_plane
from tests.oracles.spatial import in_space

# Loops here ask cylinders for more than their speed.
pytestmark = pytest.mark.filterwarnings("ignore:nothing in this run holds:flexopt.errors.FlexoptWarning")

POSTURE = [-0.2, -1.2, -0.6]
GAIN = 2e3
LENGTHS = (0.5, 2.0, 1.1)


def plane() -> AnyMachine:
    return flexopt.machine_from_dict(digger())


def space() -> AnyMachine:
    return tree_from_dict(digger_in_space(in_space(digger())))


def shares(posture: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Of the cylinders' full speeds, lever arms by central differences."""
    found = []
    for k, cylinder in enumerate(DIGGER["cylinders"]):
        ends = [length_in_plane(cylinder, LENGTHS[k], posture[k] + step) for step in (-1e-5, 1e-5)]
        moved = (ends[1] - ends[0]) / 2e-5 * rates[k]
        found.append(moved / cylinder["speed"][0 if moved < 0 else 1])
    return np.array(found)


@pytest.mark.parametrize("make", [plane, space])
@pytest.mark.parametrize("levers", ["each", "uniform"])
def test_torques_are_those_that_the_levers_leave(make, levers: str) -> None:
    machine = make()
    plant = flexopt.build_plant(machine)
    options = {
        "kp": 2e5,
        "kv": 1e4,
        "nullspace_damping": 1e3,
        "duration": 0.3,
        "base": np.zeros(len(machine.base_coordinates)),
    }
    actuator = {"levers": levers, "servo_gain": GAIN}
    run = flexopt.simulate(machine, POSTURE, actuator=actuator, **options)
    saturated = 0
    design = plant.rest(options["base"], POSTURE, plant.parameter_values).full().ravel()[: plant.n_passive]
    for q, v, error, torque in zip(run.q, run.v, run.error, run.torque, strict=True):
        p = plant.parameter_values
        posture = q[plant.n_passive :]
        jv = plant.rigid_jacobian(np.concatenate([design, posture]), options["base"], p).full()
        rate = plant.jacobian(q, options["base"], p).full() @ v
        inverse, rates = np.linalg.pinv(jv), v[plant.n_passive :]
        wanted = (inverse @ (2e5 * error - 1e4 * rate) - 1e3 * (rates - inverse @ (jv @ rates))) / GAIN
        share = shares(posture, wanted)
        saturated += bool(np.abs(share).max() > 1)
        if levers == "uniform":
            expected = wanted / max(1.0, np.abs(share).max())
        else:
            expected = wanted / np.maximum(1.0, np.abs(share))
        # Central differences of the lengths: some 1e-10.
        np.testing.assert_allclose(torque, GAIN * expected, rtol=1e-8, atol=1e-8 * GAIN * np.abs(wanted).max())
    assert 0 < saturated < len(run.time)


def test_levers_far_from_full_change_nothing() -> None:
    machine = plane()
    options = {"kp": 2e4, "kv": 1e3, "nullspace_damping": 1e3, "duration": 0.5, "offset": [0.01, -0.01, 0.01]}
    free = flexopt.simulate(machine, POSTURE, **options)
    driven = flexopt.simulate(machine, POSTURE, actuator={"levers": "each", "servo_gain": 1e9}, **options)
    # Shares below 1e-9 of full speed do not move the stick's lever out of its dead band.
    np.testing.assert_allclose(driven.q, free.q, rtol=0, atol=1e-9)
    linear = [sampled_loop(machine, POSTURE, kp=2e4, kv=1e3, actuator=a) for a in ({}, {"levers": "each"})]
    np.testing.assert_array_equal(linear[0].multipliers, linear[1].multipliers)


def test_bad_levers_are_named() -> None:
    with pytest.raises(InputError, match=r"actuator\.levers = 'each': need a cylinder or a speed of every joint"):
        flexopt.simulate(flexopt.load("excavator"), [0.9, -1.4], actuator={"levers": "each"})
    with pytest.raises(InputError, match="set joint rates, and Jacobian transpose control asks for torques"):
        flexopt.simulate(plane(), POSTURE, control="transpose", actuator={"levers": "uniform"})
    with pytest.raises(
        InputError, match=r"actuator\.levers = True: must be 'each' or 'uniform'|must be each or uniform"
    ):
        flexopt.simulate(plane(), POSTURE, actuator={"levers": True})
    with pytest.raises(InputError, match=r"actuator\.servo_gain = 0"):
        flexopt.simulate(plane(), POSTURE, actuator={"levers": "each", "servo_gain": 0})


def of_levers(run: flexopt.Trajectory) -> list[str]:
    """Warnings but that of cylinders beyond their speed: a lever's torque does not know how fast they move."""
    return [sentence for sentence in run.warnings if not sentence.startswith("nothing in this run holds")]


def crawler(**more) -> dict:
    """The digger with an effort for the bucket, whose cylinder names no force."""
    data = digger()
    data["links"][2] |= {"effort": 2e3}
    return data | more


@pytest.mark.parametrize("levers", ["each", "uniform"])
def test_without_a_gain_full_levers_ask_for_what_the_drives_can_give(levers: str) -> None:
    machine = flexopt.machine_from_dict(crawler())
    # By hand: each way force · arm / (speed / arm), and the bucket's effort over its rate.
    found = []
    for k, cylinder in enumerate(DIGGER["cylinders"]):
        ends = [length_in_plane(cylinder, LENGTHS[k], POSTURE[k] + step) for step in (-1e-5, 1e-5)]
        arm = abs(ends[1] - ends[0]) / 2e-5
        for way in (0, 1):
            effort = cylinder["force"][way] * arm if "force" in cylinder else 2e3
            found.append(effort / (cylinder["speed"][way] / arm))
    options = {"kp": 1e6, "kv": 1e4, "nullspace_damping": 1e3, "duration": 0.5}
    run = flexopt.simulate(machine, POSTURE, actuator={"levers": levers}, **options)
    gain = run.provenance["options"]["actuator"]["servo_gain"]
    # Central differences of the lengths.
    assert gain == pytest.approx(min(found), rel=1e-8)
    same = flexopt.simulate(machine, POSTURE, actuator={"levers": levers, "servo_gain": gain}, **options)
    np.testing.assert_array_equal(run.torque, same.torque)
    # Levers are full, and the arm comes nearer to its target all the same.
    assert np.linalg.norm(run.error[-1]) < 0.9 * np.linalg.norm(run.error[0])
    assert of_levers(run) == []


def test_levers_that_ask_for_next_to_nothing_say_so() -> None:
    machine = flexopt.machine_from_dict(crawler())
    options = {"kp": 1e6, "kv": 1e4, "nullspace_damping": 1e3, "duration": 0.1}
    with pytest.warns(flexopt.FlexoptWarning, match=r"with actuator\.servo_gain = 1 full levers ask for no more than"):
        run = flexopt.simulate(machine, POSTURE, actuator={"levers": "each", "servo_gain": 1.0}, **options)
    named = float(run.warnings[0].split("; ")[1].split(" ")[0])
    default = flexopt.simulate(machine, POSTURE, actuator={"levers": "each"}, **options)
    assert named == pytest.approx(default.provenance["options"]["actuator"]["servo_gain"], rel=1e-3)
    assert np.abs(run.torque).max() < 2.0 < 100.0 < np.abs(default.torque).max()
    unknown = crawler()
    for cylinder in unknown["cylinders"]:
        cylinder.pop("force", None)
    unknown["links"][2].pop("effort")
    with pytest.warns(flexopt.FlexoptWarning, match="digger names no effort from which to take a gain, so give one"):
        flexopt.simulate(flexopt.machine_from_dict(unknown), POSTURE, actuator={"levers": "each"}, **options)
    given = {"levers": "each", "servo_gain": 2e3}
    assert of_levers(flexopt.simulate(flexopt.machine_from_dict(unknown), POSTURE, actuator=given, **options)) == []


def test_the_heavy_machine_moves_behind_its_levers() -> None:
    machine = flexopt.load("slewing-excavator")
    run = flexopt.simulate(
        machine, [0.2, 0.5, -1.2, -0.5], kp=1e6, kv=3e5, nullspace_damping=1e5, actuator={"levers": "each"}, duration=4.0
    )  # fmt: skip
    assert run.warnings == ()
    assert np.linalg.norm(run.error[-1]) < 0.05 * np.linalg.norm(run.error[0])
