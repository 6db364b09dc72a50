"""All stable gains at once beside one after another, where the self-motion of a redundant arm is told apart by shape."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.loop.borders import stable_intervals
from flexopt.loop.outcome import UNDAMPED

CASES: list[tuple[str, tuple[float, ...], Any]] = [
    ("slewing-excavator", (0.3, 0.5, -0.9, -0.4), {"kp": 3e6, "kv": 6e5, "dead_time": 0.01}),
    ("slewing-excavator", (0.3, 0.5, -0.9, -0.4), {"kp": 3e6, "kv": 6e5, "nullspace_damping": 1e5}),
    ("slewing-excavator", (0.3, 0.5, -0.9, -0.4), {"kp": 3e6, "kv": 6e5, "feedback": "pid", "ki": 1e5}),
    ("boom-stick-bucket", (-1.0, -1.0, -0.6), "default"),
    ("mobile-manipulator", (0.3, 0.5, -0.9, -0.4, 0.2, 0.1), "default"),
]


@pytest.mark.long(
    "slewing-excavator-posture0-loop0",
    "slewing-excavator-posture1-loop1",
    "slewing-excavator-posture2-loop2",
    "mobile-manipulator-posture4-default",
)
@pytest.mark.parametrize(("name", "posture", "loop"), CASES)
def test_batch_and_one_by_one(name: str, posture: tuple[float, ...], loop: Any) -> None:
    machine = flexopt.load(name)
    settings = flexopt.outcome(machine, posture, loop=loop).settings
    point = settings.outcome(machine, np.zeros(len(machine.base_coordinates)), np.array(posture), gravity=False)
    told = stable_intervals(point.growth_at, UNDAMPED / point.period)
    np.testing.assert_allclose(point.gain_intervals, told, rtol=1e-8)
