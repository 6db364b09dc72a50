"""The nullspace law for machines in space: V climbs, the end-point stays, rates and ends are kept."""

from __future__ import annotations

import numpy as np
import pytest

import flexopt
from flexopt import nullspace_trajectory
from flexopt.selection.nullspace.base_trajectory import Stop
from tests.oracles.spatial import pinocchio_tree, random_tree

START = {"base": [0.0, 0.0, 0.1], "rate": 20.0, "duration": 12.0}
POSTURE = [0.3, 0.5, -1.3, -0.4]


@pytest.fixture(scope="module")
def excavator() -> flexopt.Tree:
    machine = flexopt.load("slewing-excavator")
    assert isinstance(machine, flexopt.Tree)
    return machine


@pytest.mark.long
def test_climbs_and_keeps_the_end_point(excavator: flexopt.Tree) -> None:
    t = nullspace_trajectory(excavator, POSTURE, objective="V", weights=[1.0] * 6, **START)
    assert np.all(np.diff(t.V) >= 0)
    assert t.V[-1] > 0.6 * t.V[0]
    target = flexopt.evaluate(excavator, POSTURE, base=START["base"]).end_point
    for k in range(0, t.time.size, 10):
        e = flexopt.evaluate(excavator, t.posture[k], base=t.base[k])
        assert np.abs(e.end_point - target).max() < 1e-9
        assert e.w.sum() == pytest.approx(t.V[k], rel=1e-9)
    assert np.linalg.norm(t.base_rate[:, :2], axis=1).max() <= 0.25 + 1e-12
    assert np.abs(t.base_rate[:, 2]).max() <= 0.25 + 1e-12
    assert np.abs(np.diff(t.posture, axis=0)).max() * 20.0 <= 1.0 + 1e-2


def test_ends_at_the_end_of_the_range(excavator: flexopt.Tree) -> None:
    ranges = {"yaw": (0.0, 0.2), "x": (-1.0, 1.0)}
    t = nullspace_trajectory(excavator, POSTURE, objective="V", weights=[1.0] * 6, base_range=ranges, **START)
    assert t.stop is Stop.BASE_RANGE
    assert t.base[-1, 2] == 0.2
    assert np.all(t.base[:, 2] <= 0.2)


@pytest.mark.long
def test_turning_has_its_own_rate_and_ends_at_rest(excavator: flexopt.Tree) -> None:
    options = START | {"max_turn_rate": 0.02, "max_base_rate": 0.05, "max_base_acceleration": 0.02}
    t = nullspace_trajectory(excavator, POSTURE, objective="w1", **options)
    speed = np.linalg.norm(t.base_rate[:, :2], axis=1)
    assert np.abs(t.base_rate[:, 2]).max() <= 0.02 * (1 + 1e-6)
    assert speed.max() <= 0.05 + 1e-9
    assert np.abs(np.diff(speed)).max() * 20.0 <= 0.02 * 1.05 + 1e-6
    assert t.end_point_error.max() < 1e-9
    assert t.plot().axes


@pytest.mark.parametrize("seed", [3, 13, 14])
def test_random_tree(seed: int) -> None:
    """The end-point by Pinocchio, at every sample."""
    data = random_tree(seed, counts=(2, 5))
    machine, oracle = flexopt.tree_from_dict(data), pinocchio_tree(data)
    rest = [body.joint.rest for body in machine.passive_bodies]
    posture = np.random.default_rng(seed).uniform(-0.5, 0.5, 5)
    t = nullspace_trajectory(machine, posture, rate=20.0, duration=5.0, singularity_margin_deg=0.5)
    assert np.all(np.diff(t.V) >= 0)
    points = [oracle.task(np.array([*rest, *q]), b)[0] for q, b in zip(t.posture, t.base, strict=True)]
    assert np.abs(np.array(points) - t.target).max() < 1e-9
    assert t.time.size > 1


def test_bad_range(excavator: flexopt.Tree) -> None:
    with pytest.raises(flexopt.InputError) as caught:
        nullspace_trajectory(
            excavator, POSTURE, base=[0.0, 0.0, 1.0], base_range={"yaw": (0.0, 0.2)}, max_turn_rate=0.0
        )
    assert "base_range, yaw 0 to 0.2 rad" in str(caught.value)
    assert "max_turn_rate" in str(caught.value)
