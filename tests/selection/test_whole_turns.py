"""A base that has turned once about itself stands where it stood: its ranges ask for an angle, not for turns."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.foundation.coordinates import turned_into
from flexopt.selection.broken import broken
from flexopt.selection.continua import travel

# Far from where angles are usually told, within a half turn of 0, and wider than a turn.
RANGES = [(3.0, 3.3), (-0.2, 0.2), (-4.0, 7.0)]
CASES = [("slewing-excavator", (0.2, 0.5, -1.2, -0.5)), ("mobile-manipulator", (0.3,) * 6)]


def test_an_angle_is_told_by_the_turns_that_its_range_allows() -> None:
    """Against all of its whole turns that are near."""
    rng = np.random.default_rng(3)
    turns = math.tau * np.arange(-9, 10)
    for angle in rng.uniform(-20.0, 20.0, 200):
        low = rng.uniform(-6.0, 6.0)
        high = low + rng.choice([0.0, 0.3, 3.0, 9.0, math.inf])
        (found,) = turned_into(np.array([angle]), (np.array([low]), np.array([high])), ("rad",))
        every = angle + turns
        off = np.maximum(np.maximum(low - every, every - high), 0.0)
        least = every[off <= off.min()]
        # Rounding of so many turns.
        assert found == pytest.approx(least[np.abs(least - angle).argmin()], abs=1e-12)
    with_length = turned_into(np.array([9.0, 9.0]), (np.array([0.0, 0.0]), np.array([1.0, 3.0])), ("m", "rad"))
    np.testing.assert_allclose(with_length, [9.0, 9.0 - math.tau])


@pytest.mark.parametrize(("name", "posture"), CASES)
@pytest.mark.parametrize(("low", "high"), RANGES)
def test_a_range_of_yaw_is_kept_whatever_turns_it_is_told_with(
    name: str, posture: tuple[float, ...], low: float, high: float
) -> None:
    machine, yaw = flexopt.load(name), 0.5 * (low + high)

    def built(yaw: float, **more: Any) -> flexopt.SelectionProblem:
        base = (0.3, -0.2, yaw)
        target = flexopt.evaluate(machine, posture, base=base).end_point
        return flexopt.build_selection(
            machine, target, base=base, posture=posture, base_range={"yaw": (low, high)}, **more
        )

    problem = built(yaw)
    other = np.array([1.0, 0.4, high, *posture])
    for turned in (yaw - math.tau, yaw + math.tau):
        same = built(turned)
        np.testing.assert_allclose(np.exp(1j * same.present_base[2]), np.exp(1j * yaw), atol=1e-12)
        assert low <= same.present_base[2] <= high
        assert not broken(same, np.array([0.3, -0.2, turned, *posture]), asked=True)
        if high - low < math.tau:
            assert travel(same, other) == pytest.approx(travel(problem, other), rel=1e-9)
            costly = built(turned, constraints={"travel": {"cost": 0.1}})
            assert costly.travel is not None
            np.testing.assert_allclose(costly.travel.now[:3], [0.3, -0.2, yaw], atol=1e-12)
    if high - low < math.pi:
        beside = broken(problem, np.array([0.3, -0.2, high + 0.25 + math.tau, *posture]), asked=True)
        assert beside == f"breaks base_range of yaw, {high + 0.25:.4g} rad ({low:g} to {high:g} rad)"


def test_a_way_of_the_base_starts_where_its_range_lets_it_turn() -> None:
    machine, posture = flexopt.load(CASES[0][0]), CASES[0][1]
    ways = [
        flexopt.nullspace_trajectory(
            machine, posture, base=(0.0, 0.0, yaw), base_range={"yaw": (3.0, 3.3)}, duration=0.1
        )
        for yaw in (3.1, 3.1 - math.tau)
    ]
    np.testing.assert_allclose(ways[0].base, ways[1].base, atol=1e-9)
    with pytest.raises(flexopt.InputError, match="must lie in base_range, yaw 3 to "):
        flexopt.nullspace_trajectory(machine, posture, base=(0.0, 0.0, 2.0), base_range={"yaw": (3.0, 3.3)})
