"""All stable gains at once beside one after another, where the self-motion of a redundant arm is told apart by shape."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.loop.borders import HIGH, highest_stable, stable_intervals
from flexopt.loop.evaluation import settings_at
from flexopt.loop.outcome import UNDAMPED
from flexopt.loop.uncertain import UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox

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


HANGING: list[tuple[str, tuple[float, ...], dict[str, Any], tuple[str, ...]]] = [
    ("excavator", (0.0448, -2.0499), {"kp": 1e4, "kv": 1e3}, ("payload.mass",)),
    ("excavator", (0.0448, -2.0499), {"kp": 1e4, "kv": 1e3}, ("payload.mass", "base.stiffness.rotation")),
    ("boom-stick-bucket", (-1.2, -1.5, -0.8), {"kp": 3.0, "kv": 0.0, "drive": "velocity", "nullspace_damping": 1e4},
     ("payload.mass",)),
]  # fmt: skip


@pytest.mark.parametrize(("name", "posture", "law", "unknown"), HANGING)
def test_the_largest_gain_of_an_arm_that_hangs_off_its_target_is_the_same_from_whatever_it_is_asked(
    name: str, posture: tuple[float, ...], law: dict[str, Any], unknown: tuple[str, ...]
) -> None:
    """Loops with gains just below it decay where these rest, those just above grow; its slope is that of differences."""
    machine, base = flexopt.load(name), np.zeros(1)
    found = []
    for factor in (1.0, 0.5):
        gains = {each: factor * law[each] for each in ("kp", "kv")}
        settings, _ = settings_at(
            machine, np.array(posture), base, None, flexopt.Loop(**law | gains, rate=100.0), gravity=True, call="test"
        )
        own = machine.parameters
        box = UncertaintyBox(
            machine,
            tuple(
                flexopt.Uncertainty(of=each, factor=(0.5, 2.0))
                if each.startswith("base")
                else flexopt.Uncertainty(of=each, value=(0.0, 600.0 + next(p.value for p in own if p.name == each)))
                for each in unknown
            ),
            settings.dead_time,
        )
        loop = UncertainLoop(settings, base, np.array(posture), True, box)
        found.append((loop, loop.outcome(u := np.full(len(unknown), 0.8)).allowed_gain()))
    (_, asked), (loop, other) = found
    assert 0 < asked.value < np.inf
    assert other.value == pytest.approx(asked.value, rel=1e-7)
    kp = loop.settings.kp.max()
    decays = loop.decays(u[None], np.array([0.999, 1.001]) * other.value / kp)
    assert decays[0] > 0 > decays[1]
    slopes, h = loop.slopes(u, loop.outcome(u), other), 1e-4
    for k in range(len(u)):
        ends = [loop.outcome(u + side * h * np.eye(len(u))[k]).allowed_gain().value for side in (-1, 1)]
        assert slopes[k] == pytest.approx((ends[1] - ends[0]) / (2 * h), rel=1e-4)
    assert np.all(slopes != 0)


@pytest.mark.parametrize(
    ("stable", "expected"),
    [
        # An arm that falls with less than 0.4 of its gains, and holds again with ten times them.
        ([(-0.4, 0.87), (1.0, 2.2)], 0.87),
        ([(-4.0, 4.0)], HIGH),
        ([(-2.0, -1.3), (0.5, 1.0)], -1.3),
        ([(0.5, 1.0)], -np.inf),
        # Gaps and an island narrower than what gains are looked at in, beside the present ones and farther.
        ([(-1.0, 0.005), (0.012, 2.0)], 0.005),
        ([(-1.0, 0.705), (0.71, 2.0)], 0.705),
        ([(-3.0, -2.0), (-1.012, -1.007), (0.5, 1.0)], -1.007),
    ],
)
def test_from_the_present_gains_the_largest_stable_ones_are_found(
    stable: list[tuple[float, float]], expected: float
) -> None:
    """Growth that jumps where the arm falls, and between islands of gains; as `stable_intervals` tells them."""

    def growth(x: float) -> float:
        inside = [min(x - low, high - x) for low, high in stable]
        return -max(inside) if max(inside) >= 0 or x > stable[0][0] else 7e4

    assert highest_stable(growth, 1e-11) == pytest.approx(10.0**expected, rel=1e-8)
    known = [interval for interval in stable_intervals(growth, 1e-11) if interval[0] <= 1.0]
    assert (known[-1][1] if known else 0.0) == pytest.approx(10.0**expected, rel=1e-8)


def test_a_gap_of_gains_with_which_a_loaded_arm_grows_ends_what_it_bears() -> None:
    """It is a tenth of a decade wide: with 1 kg more or less in the bucket it is that of the bucket of the file."""
    machine, posture = flexopt.load("boom-stick-bucket"), (-1.2039269383792974, -2.332522150516992, -2.001349182444738)
    given = {"kp": 30.0, "kv": 0.0, "drive": "velocity", "nullspace_damping": 1e4, "rate": 100.0}
    law = flexopt.Loop(**given)
    settings, _ = settings_at(machine, np.array(posture), np.zeros(1), None, law, gravity=True, call="test")
    unknown = (flexopt.Uncertainty(of="payload.mass", value=(999.0, 1001.0)),)
    loop = UncertainLoop(
        settings, np.zeros(1), np.array(posture), True, UncertaintyBox(machine, unknown, settings.dead_time)
    )
    known = flexopt.outcome(machine, posture, base=0.0, gravity=True, loop=law)
    middle, *sides = (loop.outcome(np.array([u])).allowed_gain().value for u in (0.5, 0.0, 1.0))
    assert (
        known.gain_intervals[0][1] / 30.0 < known.gain_intervals[1][0] / 30.0 < 1.3 * known.gain_intervals[0][1] / 30.0
    )
    assert middle == pytest.approx(known.gain_intervals[0][1], rel=1e-8)
    assert sides == pytest.approx([middle, middle], rel=1e-3)


def test_an_arm_that_falls_grows_with_other_gains_as_it_does() -> None:
    """With those that hold it it decays; with less it falls, which is no error."""
    machine, posture = flexopt.load("excavator"), (0.0448, -2.0499)
    law = flexopt.Loop(kp=1e3, kv=1e2, rate=100.0)
    settings, _ = settings_at(machine, np.array(posture), np.zeros(1), None, law, gravity=True, call="test")
    unknown = (flexopt.Uncertainty(of="payload.mass", value=(0.0, 600.0)),)
    box = UncertaintyBox(machine, unknown, settings.dead_time)
    point = UncertainLoop(settings, np.zeros(1), np.array(posture), True, box).outcome(np.array([1.0]))
    assert not point.rests
    assert point.growth_at(0.0) == point.growth_at(-0.5) == point.loop.growth_rate > 7e4
    assert point.growth_at(0.9) < 0
    assert point.allowed_gain().value == 0
