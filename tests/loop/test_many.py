"""Many loops at once are each what one loop alone is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.loop.many import decays
from flexopt.loop.settings import LoopSettings, loop_settings
from flexopt.model.loop import Loop

# Loops by machine: dead times of whole and of parts of samples, servos, filters, an integral, levers, a damper.
LOOPS: dict[str, tuple[dict[str, Any], ...]] = {
    "excavator": (
        {"kp": 1e4, "kv": 1e3, "dead_time": 0.02},
        {"kp": 1e4, "kv": 1e3, "dead_time": 0.0123, "filter_hz": 30.0, "bandwidth_hz": 8.0},
        {"kp": 1e4, "kv": 1e3, "ki": 1e3, "feedback": "pid"},
    ),
    "boom-stick-bucket": ({"kp": 1e4, "kv": 1e3}, {"kp": 1e4, "kv": 1e3, "nullspace_damping": 1e3, "dead_time": 0.004}),
    "slewing-excavator": ({"kp": 1.0, "drive": "velocity", "servo_gain": 1e6, "dead_time": 0.05},),
}
CASES = [(name, number) for name, loops in LOOPS.items() for number in range(len(loops))]
COUNT = 12


def varied(name: str, seed: int) -> dict[str, np.ndarray]:
    machine, rng = flexopt.load(name), np.random.default_rng(seed)
    low, high = np.clip(np.array(machine.limits), -2.0, 2.0).T
    posture = (low + (high - low) * rng.uniform(0.15, 0.85, (COUNT, low.size))).T
    base = rng.uniform(-1.0, 1.0, (len(machine.base_coordinates), COUNT))
    own = np.array([parameter.value for parameter in machine.parameters])
    return {"base": base, "posture": posture, "p": own[:, None] * rng.uniform(0.9, 1.1, (own.size, COUNT))}


def settings(name: str, number: int, given: dict[str, np.ndarray], *, gravity: bool) -> LoopSettings:
    machine = flexopt.load(name)
    stand = flexopt.evaluate(machine, given["posture"][:, 0], base=given["base"][:, 0], gravity=gravity)
    return loop_settings(machine, Loop(**LOOPS[name][number]), stand, gravity=gravity)


@pytest.mark.parametrize(
    ("name", "number", "gravity"), [*((*case, bool(k % 2)) for k, case in enumerate(CASES)), (*CASES[0], True)]
)
def test_each_is_what_one_loop_is(name: str, number: int, gravity: bool) -> None:
    machine, given = flexopt.load(name), varied(name, number)
    loop = settings(name, number, given, gravity=gravity)
    rng = np.random.default_rng(number)
    given |= {"kp": loop.kp[:, None] * rng.uniform(0.5, 2.0, (loop.kp.size, COUNT))}
    # Rows that no gain holds may rest anywhere: these are other loops in one call.
    given["kp"][0, :3] = 0.0
    given["dead_time"] = loop.dead_time + np.repeat([0.0, 0.0031], [COUNT - 4, 4])[None]
    found = decays(machine, loop, given, gravity=gravity, threads=2)
    motions = loop.motions(machine, gravity=gravity)
    for k in range(COUNT):
        numbers = motions.numbers(loop.numbers | {x: v[:, k] for x, v in given.items() if x != "dead_time"})
        alone = flexopt.loop.outcome.LoopPoint(motions, numbers, float(given["dead_time"][0, k])).loop
        # An eigenvalue of a matrix of norm N is known to N times rounding, divided by how far it is from others; the
        # second part is unknown.
        close = max(1e-9, 1e3 * alone.rounding)
        assert found.decay[k] == pytest.approx(-alone.growth_rate, rel=1e-7, abs=close)
        assert found.frequency_hz[k] == pytest.approx(alone.frequency_hz, rel=1e-6, abs=1e-4)


def test_the_numbers_do_not_depend_on_threads_or_neighbours() -> None:
    name = "excavator"
    machine, given = flexopt.load(name), varied(name, 5)
    loop = settings(name, 0, given, gravity=False)
    one, two = (decays(machine, loop, given, threads=threads) for threads in (1, 2))
    np.testing.assert_array_equal(one.decay, two.decay)
    few = decays(machine, loop, {x: v[:, 3:5] for x, v in given.items()})
    np.testing.assert_allclose(few.decay, one.decay[3:5], rtol=1e-10, atol=1e-12)
