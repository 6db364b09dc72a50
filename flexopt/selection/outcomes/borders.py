"""Measures of a loop that tell how far along lines of loops every motion decays.

In: as of `branches`. A gain, a dead time or a factor that a loop bears is the first place along a line of loops where
its slowest motion no longer decays. There, and where the rate comes nearest to zero before, motions are branches: that
the way to the border stays open is asked for, too, so that where another border takes over the slope knows of both.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.foundation.roots import border
from flexopt.loop.borders import HIGH
from flexopt.loop.certified.region import LARGEST, stability_radius
from flexopt.loop.loop_motions import SLOWEST_MOTIONS
from flexopt.loop.outcome import LoopPoint
from flexopt.loop.settings import LoopSettings
from flexopt.loop.small_motions import DEAD_TIME
from flexopt.loop.uncertain import UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model.choices import ALLOWED_GAIN, DELAY_MARGIN, RADIUS
from flexopt.model.loop import DELAY_MAX, GAINS
from flexopt.model.uncertainty import GROUND
from flexopt.selection.outcomes.branches import RATIO, Branches, Measure, SlopesByInput, rates_of, slopes_of

# Places before a border that count.
PLACES = 2
# Places along a line that are looked at for where the rate comes near to zero; how near to that it is found, as a share
# of the distance between them; and how near to its ends a level rests against these.
POINTS, DIP, NEAR = 24, 1e-4, 1e-3
# Decades below a border that gains are looked at in, down to the present ones.
DECADES = 3.0
# How wide a stretch of gains is that is no island, in their logarithm: a decade.
WIDE = math.log(10.0)
# Points that are looked at in each box of factors for the stability radius.
RADIUS_POINTS = 12

if TYPE_CHECKING:
    from flexopt.selection.outcomes.program import ProgramPoint


@dataclass(frozen=True)
class Line:
    """Loops one after another, each a level further.

    Attributes:
        loop: at a level;  rate: of its slowest motion there, 1/s.
        start: level at which the line begins;  own: whether that is the loop itself, which must decay, too.
        below: whether the loop itself grows, at a level further on than those that are looked at.
        by: from a derivative there by a loop's numbers, those by y's, and by the level.
    """

    loop: Callable[[float], LoopPoint]
    rate: Callable[[float], float]
    start: float
    own: bool
    by: Callable[[LoopPoint, SlopesByInput], tuple[dict[str, Any], float]]
    below: bool = False

    def border(self, level: float) -> float:
        """The first level, this one at most, at which the loop grows."""
        told = sorted(self._looked(level)[0])
        rates = np.array([rate for _, rate in told])
        grows = np.flatnonzero(rates < 0)
        if not grows.size:
            return level
        if grows[0] == 0:
            return self.start
        low, high = (told[int(k)][0] for k in (grows[0] - 1, grows[0]))
        return border(self.rate, low, high, xtol=1e-13, rtol=1e-14)

    def nearest(self, level: float) -> list[float]:
        """Levels before this one where the rate is least among its neighbours, the lowest of them.

        Where the line begins it may rise, too: of a loop that stands at a border of stability itself. On a line that
        is `below` what lies before a stretch of decays to the level is none, if that is `WIDE`: with lower gains an arm
        may fall. A narrower one is an island, on which no gain is to end.
        """
        looked, dips = self._looked(level) if level > self.start else ([], [])
        if self.below:
            grown = max((x for x, rate in looked if rate < 0 and x < level - NEAR), default=level)
            dips = [dip for dip in dips if dip[0] > min(grown, level - WIDE)]
        return [x for x, _ in sorted(dips, key=lambda dip: dip[1])[:PLACES]]

    def _looked(self, level: float) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
        """Levels up to this one with the rates there; and of these where the rate is least among its neighbours."""
        from scipy.optimize import minimize_scalar  # noqa: PLC0415  (loads slowly)

        levels = np.linspace(self.start, level, POINTS)
        rates = np.array([self.rate(float(x)) for x in levels])
        # At a border the rate falls to zero, which hides where another motion comes near to it just before.
        last = POINTS - 2
        # Where the arm falls it does at one rate, which is no dip.
        beside = [(rates[k - 1], rates[k + 1]) for k in range(1, last)]
        inner = [k for k, near in enumerate(beside, 1) if rates[k] <= min(near) and rates[k] < max(near)]
        found, dips = list(zip(levels.tolist(), rates.tolist(), strict=True)), list[tuple[float, float]]()
        for k in [*sorted(inner, key=lambda k: rates[k])[:PLACES], last]:
            low, high = float(levels[k - 1]), float(levels[k + 1])
            best: Any = minimize_scalar(
                self.rate, bounds=(low, high), method="bounded", options={"xatol": DIP * (high - low)}
            )
            found.append((float(best.x), float(best.fun)))
            beside = [float(best.x) + side * 2 * DIP * (high - low) for side in (-1, 1)]
            if low < beside[0] < beside[1] < high and best.fun < min(map(self.rate, beside)):
                dips.append(found[-1])
        if self.own and rates[0] <= min(rates[1], self.rate(self.start + DIP * float(levels[1] - self.start))):
            dips.append(found[0])
        return found, dips


class Border(Measure):
    """How far along lines of loops every motion decays."""

    @abstractmethod
    def lines(self, at: ProgramPoint, point: LoopPoint, level: float) -> list[Line]:
        """From a member, up to a level."""

    def slack(self, point: LoopPoint, level: float) -> tuple[float, SlopesByInput] | None:  # noqa: ARG002
        """By how much a member's own level is above this one, with slopes; None where that is told by its lines."""
        return None

    def branches(self, at: ProgramPoint, level: float) -> Branches:
        """The slowest rates at the level, and where they come near to zero before."""
        found = list[tuple[float, Vector, float]]()
        for point in at.points:
            if (slack := self.slack(point, level)) is not None:
                found.append((slack[0], at.by_y(slack[1]), -1.0))
                continue
            known = set[float]()
            for line in self.lines(at, point, level):
                near = [x for x in line.nearest(level) if x not in known]
                # A loop that decays keeps a level before it, whatever those there do.
                kept = line.own and level < line.start
                places = [(line.start, 0.0)] if kept else [(level, 1.0), *((x, 0.0) for x in near)]
                if line.own and line.start in near:
                    known.add(line.start)  # further lines begin alike
                for place, moves in places:
                    there = line.loop(place)
                    for k, value in enumerate(rates_of(there)[: SLOWEST_MOTIONS if moves or kept else 1]):
                        slopes = slopes_of(there, k)
                        # The loop itself moves as it does.
                        itself = line.own and not moves and place == line.start
                        by, by_level = (slopes, 0.0) if itself else line.by(there, slopes)
                        found.append((value, at.by_y(by), moves * by_level))
        _, high = self.ends(at)
        if level >= high - NEAR:
            found.append((high - level, np.zeros(at.count), -1.0))
        found.sort(key=lambda entry: entry[0])
        values, slopes, by_level = zip(*found[: 2 * SLOWEST_MOTIONS], strict=True)
        return Branches(np.array(values), np.array(slopes), np.array(by_level))


class AllowedGain(Border):
    """The largest Kp along the present ratio of all gains, up to 1e4 times the present one."""

    name, unit = ALLOWED_GAIN, ""

    def unit_of(self, settings: LoopSettings) -> str:
        """See the class."""
        return settings.gain_units[0]

    def value(self, loop: UncertainLoop, point: LoopPoint) -> float:  # noqa: ARG002
        """See the class."""
        found = min(point.allowed_gain().value, 10.0**HIGH * _first(point))
        return found if found > 0 else -math.inf

    def ends(self, at: ProgramPoint) -> tuple[float, float]:
        """Of the logarithm of Kp."""
        return -math.inf, HIGH * math.log(10) + math.log(_first(at.points[0]))

    def lines(self, at: ProgramPoint, point: LoopPoint, level: float) -> list[Line]:  # noqa: ARG002
        """All gains together."""
        kp = _first(point)

        def loop(x: float) -> LoopPoint:
            return point.with_gains(math.exp(x) / kp)

        def by(there: LoopPoint, slopes: SlopesByInput) -> tuple[dict[str, Any], float]:
            of = {name: float(slopes[name] @ there.numbers[name]) for name in GAINS}
            total = sum(of.values())
            # The gain that the level is told in stays, whatever the present one is; the others follow their ratio.
            return {**slopes, RATIO: {"kp": of["kp"] - total, "kv": of["kv"]}}, total

        # What lower gains than present ones that decay do is nothing to it: with those an arm may fall.
        now, start, stable = math.log(kp), level - DECADES * math.log(10), point.loop.stable
        own = stable and start <= now
        first = now if own else start
        return [Line(loop, lambda x: -point.growth_at((x - now) / math.log(10)), first, own, by, below=not stable)]

    def slack(self, point: LoopPoint, level: float) -> tuple[float, SlopesByInput] | None:
        """Where the loop grows with its present gains: with lower ones than the largest that it bears it may, too."""
        if point.loop.stable:
            return None
        most = point.allowed_gain()
        above = math.log(most.value) - level if 0 < most.value < math.inf else 0.0
        if above <= NEAR:
            return None
        return above, {name: slope / most.value for name, slope in point.gradient(most).items()}


class DelayMargin(Border):
    """Dead time that may be added before the loop grows, s, up to 100 samples in all."""

    name, unit = DELAY_MARGIN, "s"

    def value(self, loop: UncertainLoop, point: LoopPoint) -> float:  # noqa: ARG002
        """See the class."""
        found = point.delay_margin().value
        return -math.inf if math.isnan(found) else min(found, DELAY_MAX * point.period - point.dead_time)

    def level(self, value: float, size: float) -> float:
        """In units of the size."""
        return value / size

    def ends(self, at: ProgramPoint) -> tuple[float, float]:
        """No less than none."""
        point = at.points[0]
        return 0.0, (DELAY_MAX * point.period - point.dead_time) / at.size

    def lines(self, at: ProgramPoint, point: LoopPoint, level: float) -> list[Line]:  # noqa: ARG002
        """Later and later."""
        most = DELAY_MAX * point.period - point.dead_time

        def loop(x: float) -> LoopPoint:
            return replace(point, dead_time=point.dead_time + min(max(x, 0.0) * at.size, most))

        def by(there: LoopPoint, slopes: SlopesByInput) -> tuple[dict[str, Any], float]:  # noqa: ARG001
            return dict(slopes), float(slopes[DEAD_TIME][0]) * at.size

        return [Line(loop, lambda x: rates_of(loop(x))[0], 0.0, True, by)]


class Radius(Border):
    """Up to which s every factor may be anywhere within [1/s, s], 10 at most: along the diagonals of their box."""

    name, unit = RADIUS, ""

    def value(self, loop: UncertainLoop, point: LoopPoint) -> float:
        """See the class."""
        if not point.loop.stable:
            return -math.inf
        loop = _of_springs(loop)
        borders = [line.border(math.log(LARGEST)) for line in self._diagonals(loop, point)]
        found = math.exp(min(borders))
        if len(borders) == 2:
            return found
        # Of several factors the first place may lie beside the diagonals; it is known less exactly.
        inside = stability_radius(loop, RADIUS_POINTS)
        return inside if inside < found * (1 - NEAR) else found

    def ends(self, at: ProgramPoint) -> tuple[float, float]:  # noqa: ARG002
        """Of the logarithm."""
        return 0.0, math.log(LARGEST)

    def lines(self, at: ProgramPoint, point: LoopPoint, level: float) -> list[Line]:  # noqa: ARG002
        """Towards every corner."""
        return self._diagonals(_of_springs(at.loop), point)

    def _diagonals(self, loop: UncertainLoop, point: LoopPoint) -> list[Line]:
        entries = loop.box.entries
        return [self._towards(entries, point, signs) for signs in product((1.0, -1.0), repeat=len(entries))]

    def _towards(self, entries: list[list[int]], point: LoopPoint, signs: tuple[float, ...]) -> Line:
        ways = np.zeros(len(point.numbers["p"]))
        for own, sign in zip(entries, signs, strict=True):
            ways[own] = sign
        given = {name: value for name, value in point.numbers.items() if name != "held"}

        def loop(x: float) -> LoopPoint:
            return replace(point, numbers=point.motions.numbers(given | {"p": point.numbers["p"] * np.exp(x * ways)}))

        def by(there: LoopPoint, slopes: SlopesByInput) -> tuple[dict[str, Any], float]:
            return dict(slopes), float(slopes["p"] @ (ways * there.numbers["p"]))

        return Line(loop, lambda x: rates_of(loop(x))[0], 0.0, True, by)


def _of_springs(loop: UncertainLoop) -> UncertainLoop:
    """The loop with one factor of all springs where nothing is said of factors."""
    box = loop.box
    return loop if box.uncertainty else replace(loop, box=UncertaintyBox(box.machine, GROUND, box.nominal_dead_time))


def _first(point: LoopPoint) -> float:
    """The gain that allowed gains are told in: of the first row that has one."""
    kp = point.numbers["kp"]
    return float(kp[int(np.argmax(kp > 0))])
