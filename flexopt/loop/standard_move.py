"""A standard move in the sampled loop for small motions: when it has settled, and how far the base swings.

In: a loop in a configuration. Out: a `StandardMove`, from the loop's exact samples.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.loop.outcome import LoopPoint

# Share of the error at the start that is left when a move has settled, as in `flexopt.simulate`; how long it is
# waited for, s; samples that are looked at together.
SETTLED, LONGEST, BLOCK = 0.02, 60.0, 2048


class StandardMove(NamedTuple):
    """The end-point starts beside its target, the springs at rest, along each task row by itself; the worst is told.

    Attributes:
        settling: after which |e| stays below 2 % of what it was at the start, s; NaN where it does not in a minute.
        swing: largest deflection of a hinge by which the base turns, rad, of a base that cannot turn that of a passive
            coordinate, m, for each m of the move; NaN of a loop that grows.
    """

    settling: float
    swing: float


def standard_move(outcome: LoopPoint) -> StandardMove:
    """The standard move of a loop in a configuration.

    States x_k = Φᵏ x_0 of the exact loop; x_0 has the joints displaced by Jv⁺ times the move, and what is measured and
    filtered shows it, as at the start of `flexopt.simulate`.
    """
    if not outcome.loop.stable:
        return StandardMove(math.nan, math.nan)
    matrix, end_point, base = outcome.sample.matrix, *_shown(outcome)
    steps = math.ceil(LONGEST / outcome.period)
    block, whole = _start(outcome)[None], matrix
    while len(block) < min(BLOCK, steps):
        block, whole = np.concatenate([block, whole @ block]), whole @ whole
    quiet_from, swing, begun = 0, 0.0, 0
    while begun < steps:
        swing = max(swing, float(np.abs(base @ block).max(initial=0.0)))
        loud = np.any(np.linalg.norm(end_point @ block, axis=1) > SETTLED, axis=1)
        if np.any(loud):
            quiet_from = begun + int(np.flatnonzero(loud)[-1]) + 1
        begun += len(block)
        if not np.any(loud):
            # A block in which nothing is loud, behind which the loop, being stable, has no reason to become so.
            break
        block = whole @ block
    settled = quiet_from < begun
    return StandardMove(quiet_from * outcome.period if settled else math.nan, swing)


def _shown(outcome: LoopPoint) -> tuple[Vector, Vector]:
    """The end-point's displacement, and the base's turns (where nothing turns, shifts), as rows of x."""
    plant, to_q, size = outcome.motions.plant, outcome.motions.loop.to_q, len(outcome.sample.matrix)
    rows = list(outcome.motions.loop.shape.base_hinges) or list(range(plant.n_passive))
    end_point, base = np.zeros((plant.n_task, size)), np.zeros((len(rows), size))
    end_point[:, : len(outcome.parts.flow)] = outcome.parts.measured[: plant.n_task]
    base[:, : len(to_q)] = to_q[rows]
    return end_point, base


def _start(outcome: LoopPoint) -> Vector:
    """x_0 (n_x, r), a column for each task row: 1 m beside the target."""
    plant, to_q, parts = outcome.motions.plant, outcome.motions.loop.to_q, outcome.parts
    n, k, r = len(to_q), len(parts.law), plant.n_task
    of_joints = parts.measured[:r, :n] @ np.linalg.inv(to_q)[:, plant.n_passive :]
    away = np.zeros((n, r))
    away[plant.n_passive :] = np.linalg.pinv(of_joints)
    found = np.zeros((len(outcome.sample.matrix), r))
    found[:n] = np.linalg.solve(to_q, away)
    measured = parts.measured @ found[: len(parts.flow)]
    if outcome.motions.filtered:
        # The filter has seen the start for long; it is the last of the law's states.
        filtered = slice(len(parts.flow) + k - 2 * r, len(parts.flow) + k)
        found[filtered] = measured
    # What is on its way was asked for at the start, too.
    law = found[len(parts.flow) : len(parts.flow) + k]
    waiting = (len(found) - len(parts.flow) - k) // r
    found[len(parts.flow) + k :] = np.tile(parts.force @ np.vstack([law, measured]), (waiting, 1))
    return found
