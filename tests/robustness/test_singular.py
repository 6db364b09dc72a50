"""Singular postures are refused with the joint that leads out of them, for both controllers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from flexopt import SingularPosture, evaluate, load
from flexopt.model import machine_from_dict
from tests.oracles.machines import NumpySource, Structure, arm_at_rest, draw_machine

# Undamped, random and nearly singular plants may leave ε_max unsolved, which is warned of; nothing here is about it.
pytestmark = pytest.mark.filterwarnings("ignore:ε_max:flexopt.errors.FlexoptWarning")
CONTROLS = pytest.mark.parametrize("control", ["inverse", "transpose"])


def refused(machine, posture, control, **options):
    with pytest.raises(SingularPosture) as caught:
        evaluate(machine, posture, control=control, **options)
    error = caught.value
    assert error.joint in machine.joints
    index = machine.joints.index(error.joint)
    assert error.angle == posture[index]
    assert error.joint in str(error)
    # What is named must lead out.
    for turn in (0.3, -0.3):
        moved = np.array(posture, dtype=float)
        moved[index] += turn
        assert np.isfinite(evaluate(machine, moved, control=control, **options).w).all()
    return error


@CONTROLS
@pytest.mark.parametrize("angle", [0.0, math.pi, -math.pi, 1e-9, -1e-9, math.pi - 1e-9])
def test_two_links_straight_or_folded(control, angle):
    assert refused(load("excavator"), [0.4, angle], control).joint == "stick"


@CONTROLS
def test_damped_and_loaded_evaluations_refuse_too(control):
    refused(load("excavator"), [0.4, 0.0], control, damped=True)
    refused(load("excavator"), [0.4, math.pi], control, gravity=True)


def three_links(passive=()):
    data = draw_machine(NumpySource(np.random.default_rng(5)), Structure(3, ("x", "rotation"), passive))
    for index in passive:
        data["links"][index]["rest"] = 0.8
    return machine_from_dict(data)


@CONTROLS
@pytest.mark.parametrize("second", [0.0, math.pi])
@pytest.mark.parametrize("third", [0.0, math.pi])
def test_three_links_in_one_line(control, second, third):
    # The first joint turns the line as a whole and never leads out.
    assert refused(three_links(), [0.7, second, third], control).joint in ("joint2", "joint3")


@CONTROLS
def test_three_links_with_one_bend_are_regular(control):
    for posture in ([0.7, 0.5, 0.0], [0.7, 0.0, 0.5], [0.7, math.pi, 0.5]):
        assert np.isfinite(evaluate(three_links(), posture, control=control).w).all()


@CONTROLS
@pytest.mark.parametrize("folded", [False, True])
def test_passive_bend_between_two_joints(control, folded):
    """With a passive elbow at rest, the arm is singular where its two actuated joints and the end-point are in line."""
    machine = three_links((1,))
    joints, tip = arm_at_rest(machine, np.array([0.7, 0.0]))
    along, last = joints[1] - joints[0], tip - joints[1]
    angle = math.atan2(along[1], along[0]) - math.atan2(last[1], last[0]) + (math.pi if folded else 0.0)
    assert abs(math.sin(angle)) > 0.1
    assert refused(machine, [0.7, angle], control).joint == "joint3"


@CONTROLS
def test_nearly_singular_postures_still_evaluate(control):
    result = evaluate(load("excavator"), [0.4, 1e-4], control=control)
    assert result.condition > 1e4
    assert np.isfinite(result.gradient.w).all()
