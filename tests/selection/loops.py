"""What a loop does in configurations of the article's machine: single measures by their definitions, nothing climbed.

`flexopt.outcome` tells all measures at once; a scan wants one of them at many places.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache, lru_cache

import numpy as np

import flexopt
from flexopt.loop.certified.region import stability_radius
from flexopt.loop.lag import LaggedModes
from flexopt.loop.settings import LoopSettings, loop_settings
from flexopt.loop.uncertain import UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model.loop import Loop
from flexopt.model.uncertainty import GROUND

EXCAVATOR, TARGET, POSTURE = flexopt.load("excavator"), (0.0, 1.6), (0.0448, -2.0499)
STRAIGHT = math.radians(10.0)
SMALL = ("settling", "swing")
Posture = tuple[float, ...]


@cache
def posture_at(x: float, elbow: str, target: tuple[float, float] = TARGET) -> Posture | None:
    """How the arm is held; None where the target is out of reach or the arm too straight."""
    try:
        posture = flexopt.inverse_kinematics(EXCAVATOR, target, base=x, elbow=elbow)[0]
    except flexopt.UnreachableTarget:
        return None
    straight = not STRAIGHT <= abs(math.remainder(float(posture[1]), math.tau)) <= math.pi - STRAIGHT
    return None if straight else tuple(posture.tolist())


@lru_cache(maxsize=16)
def _settings(loop: tuple[tuple[str, float], ...]) -> LoopSettings:
    given = Loop(control="inverse", **dict(loop))
    return loop_settings(EXCAVATOR, given, flexopt.evaluate(EXCAVATOR, POSTURE))


def told(name: str, x: float, posture: Posture, loop: Mapping[str, float]) -> float:
    """A measure of a configuration or of the loop there; of the loop NaN or infinite where there is none."""
    if name in ("w1", "w2", "w3"):
        return float(flexopt.evaluate(EXCAVATOR, posture, base=x).w[int(name[1:]) - 1])
    if name == "epsilon_max":
        return flexopt.evaluate(EXCAVATOR, posture, base=x).epsilon_max or 0.0
    settings = _settings(tuple(sorted(loop.items())))
    base, held = np.array([x]), np.array(posture)
    point = settings.outcome(EXCAVATOR, base, held, gravity=False)
    if name == "radius":
        uncertain = UncertainLoop(settings, base, held, False, UncertaintyBox(EXCAVATOR, GROUND, settings.dead_time))
        return stability_radius(uncertain, 16) if point.loop.stable else -math.inf
    if name == "allowance":
        return float(np.min(LaggedModes(point.motions).at(point.numbers, 0.0)[0][name]))
    return float(getattr(point, name)().value)


def worth(name: str, x: float, posture: Posture | None, loop: Mapping[str, float]) -> float:
    """The measure such that more is better; −∞ where there is none."""
    if posture is None:
        return -math.inf
    value = told(name, x, posture, loop)
    return (-value if name in SMALL else value) if math.isfinite(value) else -math.inf
