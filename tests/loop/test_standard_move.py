"""The standard move of the sampled loop, beside nonlinear runs of small moves."""

from __future__ import annotations

import math

import numpy as np
import pytest

import flexopt
from flexopt.loop.settings import LoopSettings, loop_settings
from flexopt.loop.standard_move import StandardMove, standard_move
from flexopt.model.loop import Loop
from flexopt.robustness import Evaluation

SMALL = 1e-4
CASES = {
    "plane": ("excavator", (0.992, -1.4056), {"kp": 1e4, "kv": 1e3}),
    "filtered": ("excavator", (0.992, -1.4056), {"kp": 1e4, "kv": 1e3, "filter_hz": 20.0}),
    "late": (
        "slewing-excavator",
        (0.2, 0.5, -1.2, -0.5),
        {"kp": 3e6, "kv": 6e5, "dead_time": 0.01, "nullspace_damping": 1e4},
    ),
}


def made(
    name: str, posture: tuple[float, ...], loop: dict[str, float]
) -> tuple[Evaluation, LoopSettings, StandardMove]:
    machine = flexopt.load(name)
    stand = flexopt.evaluate(machine, posture)
    settings = loop_settings(machine, Loop(control="inverse", **loop), stand)
    return stand, settings, standard_move(settings.outcome(machine, stand.base, stand.posture, gravity=False))


@pytest.mark.parametrize("name", CASES)
def test_moves_are_those_of_nonlinear_runs(name: str) -> None:
    """Of 0.1 mm, along each row by itself."""
    machine, posture, loop = CASES[name]
    stand, settings, move = made(machine, posture, loop)
    plant = flexopt.build_plant(flexopt.load(machine))
    at = plant.rest(stand.base, stand.posture, plant.parameter_values)
    jacobian = plant.rigid_jacobian(at, stand.base, plant.parameter_values).full()
    sensor = {"delay": settings.dead_time} | ({"filter_hz": settings.filter_hz} if settings.filter_hz else {})
    runs = [
        flexopt.simulate(
            plant.machine, posture, offset=SMALL * column, rate=settings.rate, duration=30.0, integrator="gauss",
            kp=loop["kp"], kv=loop["kv"], sensor=sensor, nullspace_damping=loop.get("nullspace_damping"),
        )
        for column in np.linalg.pinv(jacobian).T
    ]  # fmt: skip
    swing = max(run.peak_base_rotation or 0.0 for run in runs) / SMALL
    settling = max(run.settling_time or math.inf for run in runs)
    # What is not linear in a run of this size; a sample's width at the border of 2 %.
    assert move.swing == pytest.approx(swing, rel=1e-3)
    assert move.settling == pytest.approx(settling, abs=1.5 / settings.rate)


def test_a_loop_that_grows_has_no_move() -> None:
    _, _, move = made("excavator", (0.0448, -2.0499), {"kp": 1e5, "kv": 2e3, "dead_time": 0.1})
    assert math.isnan(move.settling)
    assert math.isnan(move.swing)


def test_what_does_not_settle_in_a_minute() -> None:
    _, _, move = made("excavator", (0.992, -1.4056), {"kp": 10.0, "kv": 1e3})
    assert math.isnan(move.settling)
    assert move.swing > 0
