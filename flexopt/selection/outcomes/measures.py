"""What of a loop a choice makes largest, as the smallest of smooth branches that all stay above zero up to a level.

In: the loop of each member in a configuration. Out: a measure's value, and its `Branches` at a level.

A gain, a dead time or a factor that a loop bears is the first place along a line of loops where its slowest motion no
longer decays. There, and where the rate comes nearest to zero before, motions are branches: that the way to the border
stays open is asked for, too, so that where another border takes over the slope knows of both.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.loop.lag import lagged_modes
from flexopt.loop.outcome import DEAD_TIME, HIGH, LoopPoint
from flexopt.loop.region import LARGEST, stability_radius
from flexopt.loop.uncertain import UncertainLoop, UncertaintyBox
from flexopt.model.choices import ALLOWANCE, ALLOWED_GAIN, DECAY, DELAY_MARGIN, RADIUS
from flexopt.model.loop import DELAY_MAX, GAINS
from flexopt.model.uncertainty import GROUND
from flexopt.selection.problem import SelectionProblem

# Motions of a loop that count, the slowest first: at an optimum several are as slow. Places before a border that count.
BRANCHES, PLACES = 6, 2
# Branches of the decay that are further above the least one than this share of its size are left out.
FAR = 1.0
# Places along a line that are looked at for where the rate comes near to zero, and how near to that it is found.
POINTS, NEAR = 24, 1e-3
# Decades below a border that gains are looked at in.
DECADES = 3.0
# Points that are looked at in each box of factors for the stability radius.
RADIUS_POINTS = 12

if TYPE_CHECKING:
    from flexopt.selection.outcomes.program import ProgramPoint

Slopes = Mapping[str, Vector]


@dataclass(frozen=True)
class Branches:
    """What must not be below zero at a configuration and a level.

    Attributes:
        values: (b,), the smallest first.
        slopes: by y (b, n_y), NaN where two multipliers meet;  by_level: (b,), ≤ 0.
    """

    values: Vector
    slopes: Vector
    by_level: Vector


class Measure(ABC):
    """A measure of a loop, the larger the better.

    Attributes:
        name: as of `flexopt.Outcome`;  unit: of it.
        looked: points that are looked at first;  stages: starts and steps of each round before the best go on.
    """

    name: ClassVar[str]
    unit: ClassVar[str]
    looked: ClassVar[int] = 300
    stages: ClassVar[tuple[tuple[int, int], ...]] = ((32, 6), (12, 10))
    of_modes: ClassVar[bool] = False

    @property
    def told(self) -> str:
        """What results call it."""
        return self.name

    @abstractmethod
    def value(self, loop: UncertainLoop, point: LoopPoint) -> float:
        """The measure of one member; −∞ where it has none."""

    @abstractmethod
    def branches(self, at: ProgramPoint, level: float) -> Branches:
        """What must stay above zero at a place of a program, a level up."""

    def level(self, value: float, size: float) -> float:  # noqa: ARG002 - of the decay
        """What is climbed: the logarithm of the measure."""
        return math.log(value) if value > 0 else -math.inf

    def ends(self, at: ProgramPoint) -> tuple[float, float]:  # noqa: ARG002 - of most
        """Between which levels are looked for."""
        return -math.inf, math.inf


class Decay(Measure):
    """How fast the slowest motion decays, 1/s."""

    name, unit = DECAY, "1/s"
    looked, stages = 1500, ((96, 6), (24, 10))

    def value(self, loop: UncertainLoop, point: LoopPoint) -> float:  # noqa: ARG002
        """See the class."""
        return _rates(point)[0]

    def level(self, value: float, size: float) -> float:
        """A share of its size."""
        return value / size

    def branches(self, at: ProgramPoint, level: float) -> Branches:
        """The slowest rates of all members, less the level."""
        values, slopes = at.once("rates", lambda: self._rates(at))
        return Branches(values - level, slopes, np.full(len(values), -1.0))

    def _rates(self, at: ProgramPoint) -> tuple[Vector, Vector]:
        each = [(value, point, k) for point in at.points for k, value in enumerate(_rates(point))]
        each.sort(key=lambda entry: entry[0])
        near = [entry for entry in each[:BRANCHES] if entry[0] <= each[0][0] + FAR * at.size]
        slopes = [at.by_y(_slopes(point, k)) for _, point, k in near]
        return np.array([value for value, _, _ in near]) / at.size, np.array(slopes) / at.size


@dataclass(frozen=True)
class OfModes(Measure):
    """A w_i, ε_max or a weighted sum of them: the objective of a problem, of the machine's own numbers.

    Of ε_max each branch, the least of which it is.
    """

    problem: SelectionProblem
    name: ClassVar[str] = "V"
    unit: ClassVar[str] = ""
    looked: ClassVar[int] = 1500
    stages: ClassVar[tuple[tuple[int, int], ...]] = ((96, 6), (24, 10))
    of_modes: ClassVar[bool] = True

    @property
    def told(self) -> str:
        """See the class."""
        return self.problem.name

    def value(self, loop: UncertainLoop, point: LoopPoint) -> float:  # noqa: ARG002
        """See the class."""
        z = np.concatenate([loop.base, loop.posture])
        value = float(self.problem.branches(self.problem.objective, z)[0].min())
        return value if math.isfinite(value) else -math.inf

    def level(self, value: float, size: float) -> float:  # noqa: ARG002
        """A share of the objective's scale."""
        return value / self.problem.objective_scale

    def branches(self, at: ProgramPoint, level: float) -> Branches:
        """V with each branch, less the level."""
        z = np.concatenate([at.loop.base, at.loop.posture])
        values, slopes = at.once(f"modes of {self.told}", lambda: self.problem.branches(self.problem.objective, z))
        count, order = len(values), np.argsort(values)
        wide = np.zeros((count, at.count))
        wide[:, : z.size] = slopes[order] * self.problem.scale / self.problem.objective_scale
        return Branches(values[order] / self.problem.objective_scale - level, wide, np.full(count, -1.0))


class Allowance(Measure):
    """The least allowance over the modes, 4 ζ_i ω_i / |w_i|, N s/m."""

    name, unit = ALLOWANCE, "N s/m"

    def value(self, loop: UncertainLoop, point: LoopPoint) -> float:  # noqa: ARG002
        """See the class."""
        found = float(np.min(_allowances(point)[0]))
        return found if found > 0 else -math.inf

    def branches(self, at: ProgramPoint, level: float) -> Branches:
        """Ln κ_i of all members, less the level."""
        values, slopes = at.once("allowances", lambda: self._told(at))
        return Branches(values - level, slopes, np.full(len(values), -1.0))

    def _told(self, at: ProgramPoint) -> tuple[Vector, Vector]:
        found = list[tuple[float, Vector]]()
        for point in at.points:
            values, slopes = _allowances(point)
            for i in np.flatnonzero(np.isfinite(values) & (values > 0)).tolist():
                by = {name: column[i] / values[i] for name, column in slopes.items()}
                found.append((math.log(values[i]), at.by_y(by)))
        found.sort(key=lambda entry: entry[0])
        return np.array([value for value, _ in found]), np.array([slope for _, slope in found])


@dataclass(frozen=True)
class Line:
    """Loops one after another, each a level further.

    Attributes:
        loop: at a level;  rate: of its slowest motion there, 1/s.
        start: level at which the line begins;  by: from a derivative there by a loop's numbers, those by y's, and by
            the level.
    """

    loop: Callable[[float], LoopPoint]
    rate: Callable[[float], float]
    start: float
    by: Callable[[LoopPoint, Slopes], tuple[dict[str, Any], float]]

    def border(self, level: float) -> float:
        """The first level, this one at most, at which the loop grows."""
        from scipy.optimize import brentq  # noqa: PLC0415  (loads slowly)

        levels, rates = self._looked(level)
        grows = np.flatnonzero(rates < 0)
        if not grows.size:
            return level
        if grows[0] == 0:
            return self.start
        return float(brentq(self.rate, *levels[grows[0] - 1 : grows[0] + 1].tolist(), xtol=1e-13, rtol=1e-14))

    def nearest(self, level: float) -> list[float]:
        """Levels before this one where the rate is least among its neighbours, the lowest of them."""
        if not level > self.start:
            return []
        levels, rates = self._looked(level)
        inner = [k for k in range(1, len(levels) - 1) if rates[k] <= min(rates[k - 1], rates[k + 1])]
        return [float(levels[k]) for k in sorted(inner, key=lambda k: rates[k])[:PLACES]]

    def _looked(self, level: float) -> tuple[Vector, Vector]:
        """Levels up to this one, ascending, with those between where the rate is least, and the rates there."""
        from scipy.optimize import minimize_scalar  # noqa: PLC0415  (loads slowly)

        levels = np.linspace(self.start, level, POINTS)
        rates = np.array([self.rate(float(x)) for x in levels])
        inner = [k for k in range(1, POINTS - 1) if rates[k] <= min(rates[k - 1], rates[k + 1])]
        more = list[tuple[float, float]]()
        for k in sorted(inner, key=lambda k: rates[k])[:PLACES]:
            ends = float(levels[k - 1]), float(levels[k + 1])
            best: Any = minimize_scalar(
                self.rate, bounds=ends, method="bounded", options={"xatol": NEAR * (ends[1] - ends[0])}
            )
            more.append((float(best.x), float(best.fun)))
        told = sorted([*zip(levels.tolist(), rates.tolist(), strict=True), *more])
        return np.array([x for x, _ in told]), np.array([rate for _, rate in told])


class Border(Measure):
    """How far along lines of loops every motion decays."""

    @abstractmethod
    def lines(self, at: ProgramPoint, point: LoopPoint, level: float) -> list[Line]:
        """From a member, up to a level."""

    def branches(self, at: ProgramPoint, level: float) -> Branches:
        """The slowest rates at the level, and where they come near to zero before."""
        found = list[tuple[float, Vector, float]]()
        for point in at.points:
            for line in self.lines(at, point, level):
                places = [(level, 1.0), *((x, 0.0) for x in line.nearest(level))]
                for place, moves in places:
                    there = line.loop(place)
                    for k, value in enumerate(_rates(there)[: BRANCHES if moves else 1]):
                        by, by_level = line.by(there, _slopes(there, k))
                        found.append((value, at.by_y(by), moves * by_level))
        _, high = self.ends(at)
        if level >= high - NEAR:
            found.append((high - level, np.zeros(at.count), -1.0))
        found.sort(key=lambda entry: entry[0])
        values, slopes, by_level = zip(*found[: 2 * BRANCHES], strict=True)
        return Branches(np.array(values), np.array(slopes), np.array(by_level))


class AllowedGain(Border):
    """The largest Kp along the present ratio of all gains, up to 1e4 times the present one."""

    name, unit = ALLOWED_GAIN, ""

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
            factor = math.exp(x) / kp
            return replace(point, numbers={**point.numbers, **{name: point.numbers[name] * factor for name in GAINS}})

        def by(there: LoopPoint, slopes: Slopes) -> tuple[dict[str, Any], float]:
            of = {name: float(slopes[name] @ there.numbers[name]) for name in GAINS}
            total = sum(of.values())
            # The gain that the level is told in stays, whatever the present one is; the others follow their ratio.
            return {**slopes, "ratio": {"kp": of["kp"] - total, "kv": of["kv"]}}, total

        start = level - DECADES * math.log(10)
        return [Line(loop, lambda x: -point.growth_at((x - math.log(kp)) / math.log(10)), start, by)]


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

        def by(there: LoopPoint, slopes: Slopes) -> tuple[dict[str, Any], float]:  # noqa: ARG001
            return dict(slopes), float(slopes[DEAD_TIME][0]) * at.size

        return [Line(loop, lambda x: _rates(loop(x))[0], 0.0, by)]


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

        def by(there: LoopPoint, slopes: Slopes) -> tuple[dict[str, Any], float]:
            return dict(slopes), float(slopes["p"] @ (ways * there.numbers["p"]))

        return Line(loop, lambda x: _rates(loop(x))[0], 0.0, by)


def _of_springs(loop: UncertainLoop) -> UncertainLoop:
    """The loop with one factor of all springs where nothing is said of factors."""
    box = loop.box
    return loop if box.uncertainty else replace(loop, box=UncertaintyBox(box.machine, GROUND, box.nominal_dead_time))


def _first(point: LoopPoint) -> float:
    """The gain that allowed gains are told in: of the first row that has one."""
    kp = point.numbers["kp"]
    return float(kp[int(np.argmax(kp > 0))])


def _rates(point: LoopPoint) -> list[float]:
    """The rates of the slowest motions, 1/s, the least first."""
    upper = point.loop.multipliers[point.loop.multipliers.imag >= 0][:BRANCHES]
    rates: list[float] = (-np.log(np.abs(upper)) / point.period).tolist()
    return rates


def _slopes(point: LoopPoint, branch: int) -> dict[str, Vector]:
    """A rate's slopes by a loop's numbers, 1/s."""
    return point.gradient(point.rate(branch))


def _allowances(point: LoopPoint) -> tuple[Vector, dict[str, Vector]]:
    """κ_i, infinite where nothing excites a mode, and their slopes."""
    values, slopes = lagged_modes(point.motions).at(point.numbers, point.dead_time)
    return values[ALLOWANCE], slopes[ALLOWANCE]


MEASURES: dict[str, Measure] = {
    measure.name: measure for measure in (Decay(), AllowedGain(), DelayMargin(), Allowance(), Radius())
}
