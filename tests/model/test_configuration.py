"""Configurations: one object in place of machine, posture, base, control, gravity and loop; machines with other numbers."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

import flexopt

MACHINES = ("excavator", "boom-stick-bucket", "slewing-excavator", "truck-crane", "mobile-manipulator")
POSTURE, LOOP = (0.0448, -2.0499), {"kp": 1e4, "kv": 1e3, "rate": 100.0}
HERE = flexopt.load("excavator").at(POSTURE, base=0.3, control="transpose", gravity=True, loop=LOOP)
ARGUMENTS = {"posture": POSTURE, "base": 0.3, "control": "transpose", "gravity": True}
# What each call takes besides, short runs and small boxes.
CALLS = {
    "evaluate": {}, "outcome": {}, "explain": {}, "simulate": {"duration": 0.2},
    "simulate_ensemble": {"duration": 0.2, "vary": {"payload.mass": [0.0, 50.0]}},
    "stable_region": {"ranges": {"base.stiffness.rotation": (1e6, 1.2e6)}},
    "sensitivity": {"ranges": {"base.stiffness.rotation": (1e6, 1.2e6)}},
}  # fmt: skip


def without_time(value):
    """A document without what differs from run to run."""
    if isinstance(value, dict):
        return {k: without_time(v) for k, v in value.items() if "time" not in k and k not in ("options", "provenance")}
    return [without_time(v) for v in value] if isinstance(value, list | tuple) else value


@pytest.mark.parametrize("name", list(CALLS))
def test_calls_take_a_configuration(name: str) -> None:
    call = getattr(flexopt, name)
    by_configuration = call(HERE, **CALLS[name])
    by_arguments = call(HERE.machine, **ARGUMENTS, loop=LOOP, **CALLS[name])
    np.testing.assert_equal(without_time(by_configuration.to_dict()), without_time(by_arguments.to_dict()))


def test_a_candidate_is_run_under_its_own_control_weight_and_loop() -> None:
    """A choice under gravity by the decay: what the chosen loop does there is what was chosen."""
    options = {"objective": "decay", "loop": LOOP, "gravity": True, "control": "transpose", "starts": 4}
    best = flexopt.select(HERE.machine, (0.0, 1.6), base=0.0, **options).best
    assert flexopt.outcome(best).decay == pytest.approx(best.objective, abs=1e-9)
    run = flexopt.simulate(best, duration=0.2)
    same = flexopt.simulate(
        HERE.machine, best.z[1:], base=best.z[:1], control="transpose", gravity=True, loop=LOOP, duration=0.2
    )
    np.testing.assert_array_equal(run.q, same.q)


def test_nothing_of_a_configuration_is_ignored() -> None:
    with pytest.raises(flexopt.InputError, match=r"loop.*not used by this call"):
        flexopt.stability_border(HERE, duration=0.2)
    with pytest.raises(flexopt.InputError, match=r"base.*is part of the configuration"):
        flexopt.evaluate(HERE, base=0.0)


def test_every_fault_of_a_configuration_is_told_at_once() -> None:
    with pytest.raises(flexopt.InputError) as caught:
        HERE.machine.at((0.1,), base=np.nan, control="inverted", loop={"kp": -1.0})
    assert {fault.field for fault in caught.value.faults} == {"posture", "base", "control", "loop.kp"}


def test_calls_about_a_posture_agree_on_the_words() -> None:
    """Calls that take machine and posture name the rest of a configuration alike."""
    for name in CALLS:
        taken = inspect.signature(getattr(flexopt, name)).parameters
        assert set(HERE.arguments) <= set(taken)


@pytest.mark.parametrize("name", MACHINES)
def test_other_numbers_are_those_of_an_edited_file(name: str) -> None:
    """Each parameter by itself: this entry of p changes and no other, and the description differs there alone."""
    machine = flexopt.load(name)
    for k, (key, value, _) in enumerate(machine.parameters):
        # Products of inertia of small bodies are small, too.
        changed = 1.01 * value if value else 1e-5
        found = machine.with_values({key: changed})
        expected = [p.value for p in machine.parameters]
        expected[k] = changed
        assert [p.value for p in found.parameters] == expected
        # A coupling of two springs stands on both sides of a symmetric matrix.
        assert 1 <= differences(machine.model_dump(), found.model_dump()) <= 2


def differences(one, other) -> int:
    """Numbers that differ between two descriptions."""
    if isinstance(one, dict):
        return sum(differences(one[key], other[key]) for key in one.keys() | other.keys())
    if isinstance(one, list | tuple):
        return sum(differences(a, b) for a, b in zip(one, other, strict=True))
    return int(one != other)


def test_unknown_and_unusable_values_are_refused() -> None:
    machine = flexopt.load("excavator")
    for values in (
        {"payload.weight": 1.0},
        {"payload.mass": -1.0},
        {"payload.mass": np.nan},
        {"payload.mass": "heavy"},
    ):
        with pytest.raises(flexopt.FlexoptError, match=r"payload|weight"):
            machine.with_values(values)
