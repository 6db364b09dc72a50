"""How far the machine may be from its numbers before a loop grows: the largest box of factors that is stable.

In: a machine in a posture, its loop, ranges of what is uncertain. Out: a `Region`. It is what was found by looking and
by a search with exact gradients, no proof.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from flexopt.errors import InputError, raise_if_any
from flexopt.foundation.arrays import Vector
from flexopt.foundation.boundary import public, whole
from flexopt.foundation.control import Control
from flexopt.foundation.results import Result
from flexopt.loop.evaluation import outcome
from flexopt.loop.uncertain import UncertainLoop, UncertaintyBox
from flexopt.model import AnyMachine
from flexopt.model.loop import Loop
from flexopt.model.uncertainty import GROUND, Uncertainty

# Largest factor that a radius is looked for up to, how exactly (of its logarithm), and points looked at in each box.
LARGEST, EXACT, POINTS = 10.0, 1e-3, 64


@dataclass(frozen=True)
class Region(Result):
    """Whether a loop is stable over all that is uncertain, and how much more it would bear.

    Attributes:
        stable: whether no point looked at grows.
        guaranteed: False: what holds for all points looked at need not hold between them. What grows, grows.
        points: how many were looked at.
        decay: the slowest found within the ranges, 1/s; negative where the loop grows.
        critical: where that is: factors and values by name;  frequency_hz: of the slowest motion there.
        radius: the largest s found, 10 at most, so that nothing looked at grows with every factor within [1/s, s], what
            has values at its nominal one; NaN where no range is a factor, 1 where the nominal loop grows.
        radius_critical: the factors at which it grows first, just outside; empty where it never does.
    """

    stable: bool
    guaranteed: bool
    points: int
    decay: float
    critical: Mapping[str, float]
    frequency_hz: float
    radius: float
    radius_critical: Mapping[str, float]

    DOCUMENT = "stable guaranteed points decay[1/s] critical frequency_hz[Hz] radius radius_critical"


@public(points=whole(2, 1_000_000))
def stable_region(
    machine: AnyMachine,
    posture: Any,
    *,
    base: Any = None,
    control: Control | None = None,
    gravity: bool = False,
    loop: Loop | Mapping[str, Any] | str | None = None,
    ranges: Mapping[str, Any] | Sequence[Uncertainty | Mapping[str, Any]] | None = None,
    points: int = POINTS,
) -> Region:
    """Whether a loop stays stable over what is uncertain, the least stable point, and the radius of stability.

    Args:
        machine, posture, base, control, gravity, loop: as of `flexopt.outcome`.
        ranges: what is uncertain, as of `flexopt.verdict`; by default the machine's `[[uncertainty]]`, or where there
            is none one factor ½ to 2 of all springs.
        points: how many are looked at in each box, corners first, besides the searches from the slowest of them.

    Raises:
        InputError, SingularPosture, NoSolutionFound: as `flexopt.outcome`.

    Example:
        >>> found = flexopt.stable_region(flexopt.load("excavator"), (0.0448, -2.0499), loop={"kp": 1e4, "kv": 1e3})
        >>> found.stable, found.guaranteed
        (True, False)
    """
    known = cast("tuple[Uncertainty, ...]", ranges or machine.uncertainty or GROUND)
    found = outcome(machine, posture, base=base, control=control, gravity=gravity, loop=loop)
    where = np.zeros(len(machine.base_coordinates)) if base is None else base
    box = UncertaintyBox(machine, known, found.settings.dead_time)
    raise_if_any(InputError, "stable_region", box.faults(found.settings.rate))
    whole_box = UncertainLoop(found.settings, where, posture, gravity, box)
    slowest, at, looked = _slowest(whole_box, points)
    radius, first, more = _radius(whole_box, points)
    return Region(
        stable=slowest > 0,
        guaranteed=False,
        points=looked + more,
        decay=slowest,
        critical=box.told(at),
        frequency_hz=whole_box.outcome(at).loop.frequency_hz,
        radius=radius,
        radius_critical=first,
    )


def _slowest(loop: UncertainLoop, points: int) -> tuple[float, Vector, int]:
    """The slowest decay found in the box, where, and how many points were looked at."""
    members = loop.box.members(points)
    found, at = loop.slowest(members, loop.decays(members))
    return found, at, len(members)


def stability_radius(loop: UncertainLoop, points: int = POINTS) -> float:
    """Radius of a loop's factors, as of `Region`."""
    return _radius(loop, points)[0]


def _radius(loop: UncertainLoop, points: int) -> tuple[float, dict[str, float], int]:
    """Radius, the factors just outside at which the loop grows, and how many points were looked at."""
    factors = tuple(each for each in loop.box.uncertainty if each.factor is not None)
    if not factors:
        return math.nan, {}, 0
    if not loop.outcome().loop.stable:
        return 1.0, {}, 1

    def within(size: float) -> UncertainLoop:
        ends = math.exp(-size), math.exp(size)
        scaled = tuple(each.model_copy(update={"factor": ends}) for each in factors)
        return replace(loop, box=replace(loop.box, uncertainty=scaled))

    low, high, looked, first = 0.0, math.log(LARGEST), 0, dict[str, float]()
    tried = high
    while high - low > EXACT:
        here = within(tried)
        decay, at, count = _slowest(here, points)
        looked += count
        if decay > 0:
            low = tried
            if tried == high:
                break
        else:
            high, first = tried, here.box.told(at)
        tried = (low + high) / 2
    return math.exp(low), first, looked
