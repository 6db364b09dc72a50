"""All stable gains at once beside one after another, where the self-motion of a redundant arm is told apart by shape."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.loop.borders import stable_intervals
from flexopt.loop.evaluation import settings_at
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


@pytest.mark.parametrize(
    ("posture", "law", "drifts"),
    [
        ((-2.2616, -0.8434, 0.2575), {"drive": "torque", "nullspace_damping": 1500.0}, True),
        ((-2.2616, -0.8434, 0.2575), {"drive": "torque"}, True),
        ((-2.2616, -0.8434, 0.2575), {"drive": "velocity"}, True),
        (
            (-2.2616, -0.8434, 0.2575),
            {"drive": "torque", "nullspace_damping": 1500.0, "feedback": "pid", "ki": 1e6},
            False,
        ),
    ],
)
def test_the_least_stable_gains_of_an_arm_that_drifts(posture: tuple[float, ...], law: Any, drifts: bool) -> None:
    """Loops of their own on either side of the border: where the drift takes the end-point with it, or one swings."""
    machine = flexopt.load("boom-stick-bucket")
    given = law if law["drive"] == "velocity" else {"kp": 2.712e6, "kv": 4.338e5} | law
    asked: Any = {"base": [0.0], "gravity": True}
    found = flexopt.outcome(machine, posture, loop=given, **asked)
    settings = found.settings
    least = found.gain_intervals[0][0] / settings.kp.max()
    # Below that none are looked at.
    assert least > 1.1e-4
    own = {name: getattr(settings, name) for name in ("kp", "kv", "ki")}
    rest = given | {"rate": settings.rate, "servo_gain": settings.servo_gain or None}
    above, below = (
        flexopt.outcome(
            machine, posture, loop=rest | {name: factor * least * each for name, each in own.items()}, **asked
        )
        for factor in (1.02, 0.98)
    )
    assert max(found.drift) > 0
    assert above.decay > 0 > below.decay
    assert (below.frequency_hz < 1e-6) == drifts
    assert found.drifts_below == drifts
    assert ("that drift may move the end-point, too" in repr(found)) == drifts


def test_gains_that_hold_a_load_which_is_not_known_leave_no_gap() -> None:
    """Beside loops that rest with theirs, elsewhere: all from a thirtieth of the gains to six times them decay."""
    machine, posture = flexopt.load("boom-stick-bucket"), np.array((-2.2616, -0.8434, 0.2575))
    law = flexopt.Loop(kp=2.712e6, kv=4.338e5, drive="torque", rate=200.0, nullspace_damping=1500.0)
    settings, base = settings_at(machine, posture, None, None, law, gravity=True, call="test")
    p = np.array([300.0 if each.name == "payload.mass" else each.value for each in machine.parameters])
    unknown: Any = {"gravity": True, "parameters": p, "own_model": True}
    point = settings.outcome(machine, base, posture, **unknown)
    for factor in (0.03, 0.035, 0.05, 0.1, 0.5, 2.0, 6.0):
        gains = {name: (factor * getattr(settings, name)).tolist() for name in ("kp", "kv")}
        own = settings.with_rows(gains).outcome(machine, base, posture, **unknown)
        assert own.rests
        assert own.loop.growth_rate < 0
        assert any(low < factor < high for low, high in point.gain_intervals)
