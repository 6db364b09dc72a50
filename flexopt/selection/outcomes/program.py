"""What a loop does as a program in the configuration and, where ranges are given, in its gains.

In: a problem, a loop, members of what is uncertain. Out: the measure's value, its branches with slopes, and the rows,
in scaled variables y = [z / scale, ln kp, ln kv].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.foundation.processes import in_parallel
from flexopt.loop.loop_motions import UNDEFINED
from flexopt.loop.meeting import Nearest, nearest
from flexopt.loop.outcome import LoopPoint
from flexopt.loop.uncertain import FEW, MEMBERS, SENSES, UncertainLoop, ValueAt
from flexopt.model.choices import ALLOWED_GAIN, DECAY, DELAY_MARGIN
from flexopt.model.loop import logarithms
from flexopt.selection.continua import past_stops
from flexopt.selection.nlp.program import row_gradients
from flexopt.selection.outcomes.branches import RATIO, Branches, Measure
from flexopt.selection.outcomes.measures import MEASURES
from flexopt.selection.problem import SelectionProblem

# Share of a rate up to which two motions are near to each other; rows of those that meet are in units of the square of
# this share of the size.
TOGETHER, MEETS = 0.1, 0.1
MEETING, ALIKE = "two motions that meet", "two oscillations that decay alike"
# Share of what the loop must do at least that it may fall short by: that of steps.
SHORT = 1e-6


class Met(NamedTuple):
    """A member two of whose motions, ln|μ| / T = −m ± Re √d, are held where they decay alike: d real and at most 0.

    There m, which is smooth where the two meet, is the rate of both.

    Attributes:
        member: its number, the nominal one 0.
        oscillate: whether both do; of two that do not d is real.
    """

    member: int
    oscillate: bool


def points_of(loop: UncertainLoop, members: Vector) -> list[LoopPoint]:
    """The loop of every member (n, k) of what is uncertain, the nominal one first."""
    return [loop.outcome(), *(loop.outcome(u) for u in members)]


@dataclass(frozen=True)
class OutcomeProgram:
    """Maximise a measure of the worst member.

    Attributes:
        problem: its rows and bounds; its own objective is not asked.
        loop: with its numbers, at any configuration.
        ranges: of gains that are variables, kp or kv: (lower, upper).
        members: points of what is uncertain, (n, k); none: the nominal machine alone.
        size: what the measure is divided by, in its unit, where levels are shares of it.
        measure: what is largest.
        least: what the loop of every member must do at least, by measure.
        met: members, the nominal one 0, whose two motions nearest to each other are held where they decay alike.
    """

    problem: SelectionProblem
    loop: UncertainLoop
    ranges: dict[str, tuple[float, float]]
    members: Vector
    size: float = 1.0
    measure: Measure = MEASURES[DECAY]
    least: tuple[tuple[Measure, float], ...] = ()
    met: tuple[Met, ...] = ()

    @property
    def n_z(self) -> int:
        """Entries of z; the gains follow in y."""
        return self.problem.scale.size

    @cached_property
    def bounds(self) -> tuple[Vector, Vector]:
        """Of y."""
        ends = np.array([logarithms(ends) for ends in self.ranges.values()]).reshape(-1, 2)
        scale = self.problem.scale
        return np.append(self.problem.lower / scale, ends[:, 0]), np.append(self.problem.upper / scale, ends[:, 1])

    def z(self, y: Vector) -> Vector:
        """The configuration."""
        return y[: self.n_z] * self.problem.scale

    def wrapped(self, y: Vector) -> Vector:
        """The same point with unlimited angles near the present ones, see `SelectionProblem.wrapped`."""
        return np.append(self.problem.wrapped(self.z(y)) / self.problem.scale, y[self.n_z :])

    def past_stops(self, y: Vector) -> Vector | None:
        """The point with joints that rest at an end of their angles whole turns away; see `continua.past_stops`."""
        z = past_stops(self.problem, self.z(y))
        return None if z is None else np.append(z / self.problem.scale, y[self.n_z :])

    @cached_property
    def row_bounds(self) -> tuple[Vector, Vector, Vector]:
        """Lower and upper bounds and scales of the rows."""
        lower, upper, scale = self.problem.row_bounds
        if not self.met:
            return lower, upper, scale
        low = np.concatenate([[-np.inf, 0.0][: 1 + each.oscillate] for each in self.met])
        return np.append(lower, low), np.append(upper, np.zeros(low.size)), np.append(scale, np.ones(low.size))

    @property
    def row_names(self) -> list[str]:
        """Of the rows."""
        met = [name for each in self.met for name in (MEETING, ALIKE)[: 1 + each.oscillate]]
        return [*(constraint.name for constraint in self.problem.constraints), *met]

    @property
    def names(self) -> list[str]:
        """Of the entries of y."""
        return [*(variable.name for variable in self.problem.variables), *(f"loop.{name}" for name in self.ranges)]

    @property
    def turning(self) -> NDArray[np.bool_]:
        """Which entries of z are angles without limits."""
        return self.problem.turning

    def parts(self, y: Vector) -> list[tuple[OutcomeProgram, Vector]]:
        """The program of each target, and its y."""
        return [(self, y)]

    def gains(self, y: Vector) -> dict[str, float]:
        """Those that are variables."""
        return dict(zip(self.ranges, np.exp(y[self.n_z :]).tolist(), strict=True))

    def at(self, y: Vector) -> UncertainLoop:
        """The loop in the configuration, with the gains."""
        z, n_base = self.z(y), len(self.problem.machine.base_coordinates)
        settings = self.loop.settings.with_chosen(self.gains(y))
        return replace(self.loop, settings=settings, base=z[:n_base], posture=z[n_base:])

    def points(self, y: Vector) -> list[LoopPoint]:
        """The loop of every member there, the nominal one first."""
        return points_of(self.at(y), self.members)

    def value(self, y: Vector) -> float:
        """The measure of the worst member; −∞ where one has none, or does less than it must."""
        loop, points = self.at(y), self.points(y)
        for measure, least in self.least:
            short = SHORT * abs(least)
            if not all(measure.value(loop, point) >= least - short for point in points):
                return -math.inf
        return min(self.measure.value(loop, point) for point in points)

    def level(self, value: float) -> float:
        """As what a value of the measure is climbed."""
        return self.measure.level(value, self.size)

    def place(self, y: Vector) -> ProgramPoint:
        """For branches there, at one level after another."""
        return ProgramPoint(self, y)

    def branches(self, y: Vector, level: float) -> Branches:
        """What must not be below zero at y for the measure to be that of a level."""
        return self.place(y).branches(level)

    def rows(self, y: Vector) -> Vector:
        """Values of the problem's rows, in their scales: 0 for the target's."""
        lower, upper, scale = self.problem.row_bounds
        found: Vector = (self.problem.rows(self.z(y)) - np.where(lower == upper, lower, 0.0)) / scale
        return np.append(found, self.place(y).met_rows[0]) if self.met else found

    def row_slopes(self, y: Vector) -> Vector:
        """Their slopes, (n_rows, n_y)."""
        found = row_gradients(self.problem, self.z(y)) / self.problem.row_bounds[2][:, None] * self.problem.scale
        found = np.hstack([found, np.zeros((len(found), len(self.ranges)))])
        return np.vstack([found, self.place(y).met_rows[1]]) if self.met else found

    def meeting(self, y: Vector, level: float) -> OutcomeProgram | None:
        """The program that holds motions as `met` which nearly meet at y and decay at a level; None without any."""
        found = self.met_near(y, level)
        return replace(self, met=found) if found else None

    def met_near(self, y: Vector, level: float) -> tuple[Met, ...]:
        """Members of which motions nearly meet at y and decay at a level."""
        found = list[Met]()
        for number, point in enumerate(self.points(y)):
            near, rate = nearest(point, TOGETHER), point.rate().value
            if near is not None and self.measure.level(rate, self.size) <= level + TOGETHER:
                found.append(Met(number, near.oscillate))
        return tuple(found)


@dataclass(frozen=True, eq=False)
class ProgramPoint:
    """A program at one y: what measures ask of it."""

    program: OutcomeProgram
    y: Vector
    _known: dict[str, Any] = field(default_factory=dict[str, Any], repr=False)

    @property
    def size(self) -> float:
        """Of the program."""
        return self.program.size

    @property
    def count(self) -> int:
        """Entries of y."""
        return self.y.size

    @cached_property
    def loop(self) -> UncertainLoop:
        """The loop there."""
        return self.program.at(self.y)

    @cached_property
    def points(self) -> list[LoopPoint]:
        """Of every member."""
        return self.program.points(self.y)

    @cached_property
    def met(self) -> dict[int, Nearest]:
        """Of members that the program says so of the two motions that are held where they decay alike."""
        found = {each.member: (each, nearest(self.points[each.member], TOGETHER))
                 for each in self.program.met}  # fmt: skip
        return {number: near for number, (each, near) in found.items() if near and near.oscillate == each.oscillate}

    @cached_property
    def met_rows(self) -> tuple[Vector, Vector]:
        """Re d ≤ 0 and Im d = 0 of `Met` with their slopes by y; 1 where no two motions are near to each other."""
        values, slopes, unit = list[float](), list[Vector](), (MEETS * self.program.size) ** 2
        for each in self.program.met:
            near, point = self.met.get(each.member), self.points[each.member]
            for measured in (UNDEFINED, UNDEFINED) if near is None else near.squared:
                by = {} if near is None else point.gradient(measured)
                values.append(measured.value / unit if by else 1.0)
                slopes.append(self.by_y(by) / unit if by else np.zeros(self.count))
            if not each.oscillate:
                del values[-1], slopes[-1]
        return np.array(values), np.array(slopes)

    def branches(self, level: float) -> Branches:
        """What must not be below zero for the measure to be that of a level."""
        found = [self.program.measure.branches(self, level)]
        for measure, least in self.program.least:
            own = KeptPoint(self.program, self.y, parent=self, bound=abs(least) or 1.0)
            told = measure.branches(own, measure.level(least, own.size))
            found.append(Branches(told.values, told.slopes, np.zeros(len(told.values))))
        values, slopes, by_level = (np.concatenate([getattr(each, name) for each in found])
                                    for name in ("values", "slopes", "by_level"))  # fmt: skip
        return Branches(values, slopes, by_level).in_order

    def once(self, name: str, made: Callable[[], Any]) -> Any:
        """What is the same at every level."""
        if name not in self._known:
            self._known[name] = made()
        return self._known[name]

    def by_y(self, by: Mapping[str, Any]) -> Vector:
        """A slope by y, from those by a loop's numbers."""
        gains = self.program.gains(self.y)
        ratio: Mapping[str, float] = by.get(RATIO) or {name: float(by[name].sum()) * x for name, x in gains.items()}
        of_z = np.concatenate([by["base"], by["posture"]]) * self.program.problem.scale
        return np.append(of_z, [ratio[name] for name in gains])


@dataclass(frozen=True, eq=False)
class KeptPoint(ProgramPoint):
    """The same place for a measure that is kept, in units of what it must be at least.

    Attributes:
        parent: the place, whose loops and values these are, too.
        bound: what the measure must be at least, without its sign.
    """

    parent: ProgramPoint = field(kw_only=True)
    bound: float = field(kw_only=True)

    @property
    def size(self) -> float:
        """Of what is kept."""
        return self.bound

    @cached_property
    def points(self) -> list[LoopPoint]:
        """Of every member."""
        return self.parent.points

    def once(self, name: str, made: Callable[[], Any]) -> Any:
        """As of the place."""
        return self.parent.once(f"{name} kept by {self.bound!r}", made)


def least_over(program: OutcomeProgram, y: Vector) -> ValueAt:
    """The least found over the uncertainty of what is largest, and where."""
    every = (worst_of(part.at(own), program.measure) for part, own in program.parts(y))
    return min(every, key=lambda found: found[0])


def with_slowest(
    program: OutcomeProgram, told: Sequence[Vector], others: Sequence[Vector], workers: int
) -> OutcomeProgram:
    """The program with the members that are looked at, and those that decay slowest at points y.

    At `told` as they are found for the answer itself; at `others` a search from the slowest that is known finds them.
    """
    if not len(program.members):
        return program
    found = in_parallel(partial(_worst_at, program, told), len(told), workers, None, at_once=True)
    members = np.concatenate([program.loop.box.members(MEMBERS), found])
    more = [program.at(y).slower(members) for y in others]
    return replace(program, members=np.unique([*members, *more], axis=0))


def _worst_at(program: OutcomeProgram, ys: Sequence[Vector], number: int) -> Vector:
    return least_over(program, ys[number])[1]


def worst_of(loop: UncertainLoop, measure: Measure) -> ValueAt:
    """The least of a measure that is found over what is uncertain, and where: as verdicts look for it."""
    members = loop.box.members(MEMBERS)
    if measure.of_modes:  # of the machine's own numbers, whatever the member
        return measure.value(loop, loop.outcome()), members[0]
    slowest = loop.least_decay
    if measure.name == DECAY:
        return slowest
    looked = [slowest[1], *(loop.box.corners(FEW) if measure.name in (ALLOWED_GAIN, DELAY_MARGIN) else members)]
    few = [(loop.outcome(u), u) for u in looked]
    if measure.name not in SENSES:
        return min(((measure.value(loop, point), u) for point, u in few), key=lambda each: each[0])
    values, further = loop.worst(measure.name, few, members, slowest[1])
    told = [(measure.sign * value, u) for value, u in [*zip(values, looked, strict=True), *further]]
    _, worst = min(told, key=lambda each: -math.inf if math.isnan(each[0]) else each[0])
    return measure.value(loop, loop.outcome(worst)), worst
