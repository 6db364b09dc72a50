"""Measures of a loop's standard move: when it has settled, and how far the base swings; the less the better.

In: as of `branches`. That a move has settled at a time asks for the error then, and for every later peak of it, to lie
within the band: which excursion is the last may change, and slopes know of all that could be.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.loop.outcome import LoopPoint
from flexopt.loop.standard_move import LONGEST, SETTLED, Peak, StandardMove
from flexopt.loop.uncertain import UncertainLoop
from flexopt.model.choices import SETTLING, SWING
from flexopt.selection.outcomes.branches import Branches, Measure, rates_of, slopes_of

# Peaks that count, the largest first, and motions beside them: a move is told of a loop that decays.
PEAKS, MOTIONS = 4, 2
# The best move is often at the border where some motion that it hardly shows decays no more; a climb may end a step of
# rounding beyond its branches, and keeps this rate from there, 1/s.
LEAST = 1e-6
# What lies within the band by more than this factor's logarithm is left out.
FAR = 1.0

if TYPE_CHECKING:
    from flexopt.selection.outcomes.program import ProgramPoint

Branch = tuple[float, Vector, float]


class OfMove(Measure):
    """A measure of the standard move, which is the better the less it is; values are its negative."""

    sign = -1.0
    looked, stages = 1000, ((64, 6), (20, 10))

    def level(self, value: float, size: float) -> float:  # noqa: ARG002 - logarithms need none
        """Minus the logarithm of the measure."""
        return -math.log(-value) if -math.inf < value < 0 else -math.inf


class Settling(OfMove):
    """After which time the end-point's error stays below 2 % of its start, s."""

    name, unit = SETTLING, "s"
    lacking = "every loop grows, or takes more than a minute"

    def value(self, loop: UncertainLoop, point: LoopPoint) -> float:  # noqa: ARG002
        """See the class."""
        times = [math.nan] if point.move is None else point.move.settled
        return -math.inf if any(math.isnan(time) for time in times) else -max(*times, point.period)

    def ends(self, at: ProgramPoint) -> tuple[float, float]:
        """From a minute down to one sample."""
        return -math.log(LONGEST), -math.log(at.points[0].period)

    def branches(self, at: ProgramPoint, level: float) -> Branches:
        """Ln(band / |e|) at the time, and at later peaks."""
        found, time = list[Branch](), math.exp(-level)
        for point in at.points:
            found += _decays(at, point)
            move = point.move
            if move is None:
                continue
            for row in range(point.motions.plant.n_task):
                here = move.local(time, row)
                by, share = point.slopes_by(here.slopes), math.log(SETTLED / here.size)
                if share < FAR:
                    found.append((share, at.by_y(by) * (-1 / here.size), time * here.rate / here.size))
            found += [_of_peak(at, point, move, peak, SETTLED) for peak in move.peaks((0,), time, PEAKS)[:PEAKS]]
        return _joined(found)


class Swing(OfMove):
    """The base's largest turn about one of its axes for each m of the move, rad; where it cannot turn its shift, m."""

    name, unit = SWING, "rad/m or m/m"

    def value(self, loop: UncertainLoop, point: LoopPoint) -> float:  # noqa: ARG002
        """See the class."""
        value = 0.0 if point.move is None else point.move.swung[0]
        return -value if value > 0 else -math.inf

    def branches(self, at: ProgramPoint, level: float) -> Branches:
        """Minus the logarithms of the largest peaks, less the level."""
        told: list[Branch] = at.once("swings", lambda: self._told(at))
        return _joined([(value - level if moves else value, slope, -moves) for value, slope, moves in told])

    def _told(self, at: ProgramPoint) -> list[Branch]:
        found = list[Branch]()
        for point in at.points:
            found += _decays(at, point)
            if point.move is not None:
                peaks = point.move.peaks(point.move.of_base, most=PEAKS)[:PEAKS]
                found += [(*_of_peak(at, point, point.move, peak, 1.0)[:2], 1.0) for peak in peaks]
        return found


def _of_peak(at: ProgramPoint, point: LoopPoint, move: StandardMove, peak: Peak, band: float) -> Branch:
    """Ln(band / peak): by the time of it there is no slope."""
    here = move.local(peak.time, peak.row, peak.signal)
    return math.log(band / here.size), at.by_y(point.slopes_by(here.slopes)) * (-1 / here.size), 0.0


def _decays(at: ProgramPoint, point: LoopPoint) -> list[Branch]:
    """How far the rates of the slowest motions, 1/s, are above the least."""
    return [(rate - LEAST, at.by_y(slopes_of(point, k)), 0.0) for k, rate in enumerate(rates_of(point)[:MOTIONS])]


def _joined(found: list[Branch]) -> Branches:
    values, slopes, by_level = zip(*found, strict=True)
    return Branches(np.array(values), np.array(slopes), np.array(by_level)).in_order
