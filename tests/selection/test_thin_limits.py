"""Joints that may move little: a scan of all that reaches a target may hold none of the postures that they can take."""

from __future__ import annotations

import numpy as np
import pytest

import flexopt
from flexopt import inverse_kinematics
from flexopt.model import AnyMachine, machine_from_dict
from tests.oracles.machines import arm_at_rest

ARM = flexopt.load("boom-stick-bucket")


def held_near(posture: np.ndarray, rng: np.random.Generator) -> AnyMachine:
    """The arm with limits of 3 to 300 mrad about the posture, and no cylinders."""
    width, part = 10 ** rng.uniform(-2.5, -0.5, 3), rng.uniform(0.0, 1.0, 3)
    ends = zip(posture - part * width, posture + (1 - part) * width, strict=True)
    data = ARM.to_dict()
    links = [
        dict(link) | {"limits": (float(low), float(high))}
        for link, (low, high) in zip(data["links"], ends, strict=True)
    ]
    return machine_from_dict(data | {"links": tuple(links), "cylinders": ()})


def drawn(seed: int) -> tuple[AnyMachine, float, np.ndarray]:
    """A machine, a placement, and a target that it reaches from there within its limits."""
    rng = np.random.default_rng(seed)
    low, high = np.array(ARM.limits).T
    posture, base = rng.uniform(low + 0.3, high - 0.3), float(rng.uniform(-2.0, 2.0))
    machine = held_near(posture, rng)
    return machine, base, arm_at_rest(machine, posture, base)[1]


@pytest.mark.parametrize("seed", range(8))
def test_postures_between_narrow_limits_are_found(seed: int) -> None:
    """The target is made of one of them."""
    machine, base, target = drawn(seed)
    low, high = np.array(machine.limits).T
    for posture in inverse_kinematics(machine, target, base=base):
        assert np.abs(arm_at_rest(machine, posture, base)[1] - target).max() < 1e-9
        assert np.all((posture >= low - 1e-9) & (posture <= high + 1e-9))


def test_of_narrow_limits_the_elbow_that_is_asked_for_is_kept() -> None:
    """All postures between these bend one way."""
    machine, base, target = drawn(2)
    bent = "up" if np.sin(inverse_kinematics(machine, target, base=base)[0][-1]) < 0 else "down"
    other = "down" if bent == "up" else "up"
    assert inverse_kinematics(machine, target, base=base, elbow=bent)
    with pytest.raises(flexopt.UnreachableTarget, match=f"every posture with the elbow {other} that reaches it breaks"):
        inverse_kinematics(machine, target, base=base, elbow=other)


@pytest.mark.parametrize("seed", range(8))
def test_a_choice_with_narrow_limits_stands_where_they_reach(seed: int) -> None:
    """With the base free; whether the present posture is given or not."""
    machine, base, target = drawn(seed)
    low, high = np.array(machine.limits).T
    found = flexopt.select(machine, target, base=base, starts=4, singularity_margin_deg=0.1)
    best = found.best.evaluation
    assert np.abs(arm_at_rest(machine, best.posture, float(best.base[0]))[1] - target).max() < 1e-6
    assert np.all((best.posture >= low - 1e-6) & (best.posture <= high + 1e-6))
