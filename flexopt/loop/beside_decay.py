"""What members of a box do of which their decay does not tell: where they rest, and how a redundant arm moves there.

In: a loop whose machine is uncertain, members. Out: the worst of them, and where. Each member is asked by itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.loop.outcome import LoopPoint
from flexopt.loop.uncertain import UncertainLoop

# Share of the most that a joint carries below which friction holds what drives a self-motion.
FELT = 0.01


class BesideDecay(NamedTuple):
    """The worst of members, and where: factors and values by name, empty where there is none.

    Attributes:
        drift: the largest growth rate of a redundant arm's self-motion, 1/s; see `UncertainLoop.fastest_drift`.
        unheld: what drives the self-motion the most, as of `LoopPoint`, by joint, N m or N.
        rests_off: how far beside its target feedback holds the end-point at rest, m, of members that come to rest; NaN
            where none does.
    """

    drift: float
    drift_at: dict[str, float]
    unheld: dict[str, float]
    unheld_at: dict[str, float]
    rests_off: float
    rests_off_at: dict[str, float]

    @classmethod
    def of(cls, loop: UncertainLoop, members: Vector, points: Sequence[LoopPoint] = ()) -> BesideDecay:
        """Of the members (n, k) of one loop; `points`: the loop of each, where these are known."""
        if not (loop.gravity or loop.settings.redundant):
            return cls(math.nan, {}, {}, {}, 0.0, {})
        points = points or [loop.outcome(u) for u in members]
        drift, drifting = loop.fastest_drift(members, points)
        # Friction holds less than `FELT` of the most that a joint carries on any ground.
        unheld = np.array([point.unheld for point in points])
        unheld *= np.abs(unheld).max(axis=0) > FELT * np.max([point.carried for point in points], axis=0)
        driven = int(np.argmax(np.abs(unheld).max(axis=1)))
        by_joint = dict(zip(loop.box.machine.joints, unheld[driven].tolist(), strict=True))
        # Of what grows there is a rest that it does not come to.
        grows = [point.loop.growth_rate > point.loop.rounding for point in points]
        off = np.where(grows, math.nan, [loop.off_target(point) for point in points])
        far = int(np.argmax(np.nan_to_num(off, nan=-1.0)))
        told = loop.box.told
        return cls(
            drift=drift,
            drift_at={} if math.isnan(drift) else told(drifting),
            unheld=by_joint if unheld[driven].any() else {},
            unheld_at=told(members[driven]) if unheld[driven].any() else {},
            rests_off=float(off[far]),
            rests_off_at=told(members[far]) if off[far] > 0 else {},
        )

    @classmethod
    def worst(cls, each: Sequence[BesideDecay]) -> BesideDecay:
        """Of several loops, of which those count the least where something is NaN."""
        drift = max(each, key=lambda own: -math.inf if math.isnan(own.drift) else own.drift)
        unheld = max(each, key=lambda own: max(map(abs, own.unheld.values()), default=0.0))
        off = max(each, key=lambda own: -math.inf if math.isnan(own.rests_off) else own.rests_off)
        return cls(drift.drift, drift.drift_at, unheld.unheld, unheld.unheld_at, off.rests_off, off.rests_off_at)
