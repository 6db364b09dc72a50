"""Where `three_links` may stand for two targets, by a scan of placements and of postures from elementary geometry."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

import flexopt
from flexopt.foundation.arrays import Vector
from flexopt.loop.many import decays
from flexopt.loop.settings import loop_settings
from flexopt.model.loop import Loop
from tests.selection.loops import STRAIGHT
from tests.study.machines import three_links

REDUNDANT: dict[str, Any] = {"base": 0.0, "objective": "decay", "loop": {"kp": 1e4, "kv": 1e3}, "workers": 1}
HIGH = [(0.0, 1.6), (-0.5, 1.7)]


def held(x: float, target: tuple[float, float], last: Vector) -> Vector:
    """Postures (3, N) of `three_links` in x, by elementary geometry: both elbows at angles of the last link."""
    data = three_links().to_dict()
    foot, rest = data["base"]["length"], data["base"]["rest_angle"]
    one, two, three = (link["length"] for link in data["links"])
    east = target[0] - three * np.cos(last) - x - foot * np.cos(rest)
    north = target[1] - three * np.sin(last) - foot * np.sin(rest)
    cosine = (east**2 + north**2 - one**2 - two**2) / (2 * one * two)
    found = list[Vector]()
    for elbow in np.arccos(np.where(np.abs(cosine) <= 1, cosine, np.nan)) * np.array([[1.0], [-1.0]]):
        boom = np.arctan2(north, east) - np.arctan2(two * np.sin(elbow), one + two * np.cos(elbow))
        found.append(np.array([boom - rest, elbow, last - boom - elbow]))
    every: Vector = np.concatenate(found, axis=1)
    bent = np.abs(np.remainder(every[1:] + np.pi, 2 * np.pi) - np.pi)
    return every[:, ((bent > STRAIGHT) & (bent < np.pi - STRAIGHT)).all(axis=0)]


@cache
def best_decays() -> Vector:
    """The best decay of each target, 1/s, from placements (2, N): angles of the last link by elbows."""
    machine = three_links()
    settings = loop_settings(machine, Loop(**REDUNDANT["loop"]), flexopt.evaluate(machine, (0.3, 2.2, 2.2)))
    last, grid = np.linspace(-np.pi, np.pi, 90, endpoint=False), np.linspace(-2.6, 3.7, 64)
    best = np.full((len(HIGH), grid.size), -np.inf)
    for k, target in enumerate(HIGH):
        for j, x in enumerate(grid.tolist()):
            postures = held(x, target, last)
            if postures.size:
                varied = {"base": np.full((1, postures.shape[1]), x), "posture": postures}
                varied |= {"p": np.tile(np.array([p.value for p in machine.parameters])[:, None], postures.shape[1])}
                best[k, j] = decays(machine, settings, varied).decay.max()
    return best
