"""What a loop does where numbers of its machine, or its dead time, are known as intervals only.

In: an `UncertaintyBox`, a loop in a configuration. Out: the decay of each member, and the slowest decay that a search
with exact gradients finds among all of them. What is searched is no proof: results say how many points they stand on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.loop.borders import HIGH
from flexopt.loop.loop_motions import Measured
from flexopt.loop.many import decays
from flexopt.loop.outcome import UNDAMPED, LoopPoint
from flexopt.loop.rest import ARRIVED
from flexopt.loop.settings import LoopSettings
from flexopt.loop.small_motions import DEAD_TIME
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model.choices import ALLOWED_GAIN, DELAY_MARGIN, SETTLING, SWING
from flexopt.model.loop import GAINS

# Searches start at so many of the slowest members, and take so many steps.
SEARCHES, STEPS = 2, 12
# So many of a member's slowest motions may come to be the slowest; of the box a step that follows one goes so far.
MOTIONS, STRIDE = 5, 0.2
# So many of the slowest members, and of the motions of each, tell where frequencies meet; so many places are followed.
MET, PAIRED, SHARP = 12, 8, 4
# Members looked at across the box through one, in each interval; more where a worst case lies in a narrow part.
ACROSS, CLOSE = 5, 20
# Rates are no straight lines: where motions come near to each other they fall more steeply than farther away.
BENT = 3.0
# Members that a worst case is looked for at.
MEMBERS = 64
# From corner to corner towards the worst of a measure.
WALK = 5
# Gains at which loops are looked at for one that grows, as far as this share of the least that is known to be allowed.
LEVELS, SHORT = 12, 0.999
# So many times members across the box are looked at, through that with the least margin of those before.
CROSSED = 3
# Intervals at whose corners a measure is looked at, 2³ at most; gradients lead to others.
FEW = 3
# Measures of `LoopPoint` whose worst is searched for: 1 where that is the least, −1 where it is the greatest.
SENSES = {ALLOWED_GAIN: 1.0, DELAY_MARGIN: 1.0, SETTLING: -1.0, SWING: -1.0}
# A measure, and the member (k,) whose it is.
ValueAt = tuple[float, Vector]
# A loop, and the member (k,) whose it is; None of the nominal one.
PointAt = tuple[LoopPoint, Vector | None]


@dataclass(frozen=True)
class UncertainLoop:
    """One loop, the same numbers for all members, in one configuration.

    Attributes:
        settings: of the loop; the controller keeps them whatever the member.
        base, posture: of the machine.
        gravity: whether under static deflection.
        box: what is not known.
    """

    settings: LoopSettings
    base: Vector
    posture: Vector
    gravity: bool
    box: UncertaintyBox

    def outcome(self, u: Vector | None = None) -> LoopPoint:
        """The loop of a member; the nominal one by default."""
        p, late = (self.box.nominal, self.settings.dead_time) if u is None else self.box.numbers(u)
        return self.settings.outcome(
            self.box.machine, self.base, self.posture,
            gravity=self.gravity, parameters=p, dead_time=late, own_model=u is not None,
        )  # fmt: skip

    def slopes(self, u: Vector, point: LoopPoint, measured: Measured) -> Vector:
        """The derivative by u (k,) of a measure of a member's loop; NaN where there is none."""
        by = point.gradient(measured)
        return self.box.slopes(u, by["p"], float(by[DEAD_TIME][0]))

    def decays(self, members: Vector, factors: Vector | None = None) -> Vector:
        """Of every member with all gains times each of the factors, one factor after the other (n_f n,), 1/s."""
        each = [self.box.numbers(u) for u in members] * (1 if factors is None else len(factors))
        varied = {"p": np.array([p for p, _ in each]).T, DEAD_TIME: np.array([[late for _, late in each]])}
        varied |= {"base": np.tile(self.base[:, None], len(each)), "posture": np.tile(self.posture[:, None], len(each))}
        if factors is not None:
            times = np.repeat(factors, len(members))
            varied |= {name: np.outer(getattr(self.settings, name), times) for name in GAINS}
        found = decays(self.box.machine, self.settings, varied, gravity=self.gravity, own_model=True).decay
        return np.where(np.abs(found) <= self._rounding, 0.0, found)

    @property
    def _rounding(self) -> float:
        """What decay of a motion that nothing damps is rounding, 1/s."""
        return UNDAMPED * self.settings.rate

    def slowest(self, members: Vector, decays: Vector) -> ValueAt:
        """The least decay found in the box, 1/s, and where: searched from the slowest members with exact gradients.

        A motion may be the slowest in a narrow part of the box that holds no member: those that may become so by their
        own gradients are followed each by itself, in the middle of the box, across it through the slowest, and where
        two motions come to the same frequency, as there one of them loses what the other gains.
        """
        order = np.argsort(decays, kind="stable")
        starts, middle = members[order[:SEARCHES]], np.full(members.shape[1], 0.5)
        best = float(decays.min()), members[int(np.argmin(decays))]
        for start in starts:
            best = min(best, self._least(LoopPoint.decay, start), key=lambda each: each[0])
        sharp = np.concatenate([self._meeting(u) for u in (middle, *members[order[:MET]])])
        sharp = sharp[np.argsort(self.decays(sharp), kind="stable")[:SHARP]] if len(sharp) else sharp
        for start in (*sharp, middle, *self.box.cross(best[1], ACROSS)):
            for motion in self._promising(start, best[0]):
                found = self._followed(start, motion)
                if found[0] < best[0]:
                    best = min(found, self._least(LoopPoint.decay, found[1]), key=lambda each: each[0])
        return (0.0 if abs(best[0]) <= self._rounding else best[0]), best[1]

    @cached_property
    def least_decay(self) -> ValueAt:
        """`slowest` of `MEMBERS` members: every worst case of one loop begins there."""
        members = self.box.members(MEMBERS)
        return self.slowest(members, self.decays(members))

    def fastest_drift(self, members: Vector, points: Sequence[LoopPoint]) -> ValueAt:
        """The largest growth rate of a redundant arm's self-motion found in the box, 1/s, and where.

        Among members (n, k), whose loops `points` are, and by a search with exact gradients from the one that drifts
        fastest. NaN where nothing acts on it. Where it moves the base so much that it is taken for a motion of the
        loop, its rate is the decay's.
        """
        middle = np.full(len(self.box.uncertainty), 0.5)
        if not self.settings.redundant:
            return math.nan, middle
        rates = [max(point.loop.drift, default=-math.inf) for point in points]
        fastest = max(rates)
        if not math.isfinite(fastest):
            return math.nan, middle
        # Steps to where it is not told apart lead nowhere.
        beyond = Measured(1.0 + abs(fastest))

        def against(point: LoopPoint) -> Measured:
            return point.drift().times(-1.0) if point.loop.drift else beyond

        first = members[rates.index(fastest)]
        found, there = self._least(against, first)
        return max((fastest, first), (-found, there), key=lambda each: each[0])

    @cached_property
    def _target(self) -> Vector:
        return self.outcome().end_point

    def off_target(self, point: LoopPoint) -> float:
        """How far beside its target feedback holds a member's end-point at rest, m; NaN where it holds it nowhere.

        Without weight, and up to what the search for rest leaves, 0.
        """
        if not self.gravity:
            return 0.0
        off = float(np.linalg.norm(point.end_point - self._target)) if point.rests else math.nan
        return 0.0 if off <= ARRIVED else off

    def slower(self, members: Vector) -> Vector:
        """Where a search with exact gradients leads from the slowest of these members (n, k): (k,)."""
        return self._least(LoopPoint.decay, members[int(np.argmin(self.decays(members)))])[1]

    def _meeting(self, u: Vector) -> Vector:
        """Members (N, k) on the lines through u along one interval each at which two motions have the same frequency.

        By the slopes of ln ω at u: those of its slowest oscillations.
        """
        at = self.outcome(u)
        motions = np.flatnonzero(at.upper_poles.imag > 0)[:PAIRED].tolist()
        # Of two that meet at the real axis the refined one may be real.
        each = [omega for omega in map(at.frequency, motions) if omega.value > 0]
        logs = np.array([math.log(omega.value) for omega in each])
        slopes = np.array([self.slopes(u, at, omega) / omega.value for omega in each]).reshape(-1, len(u))
        first, second = np.triu_indices(len(logs), 1)
        apart, by = (logs[first] - logs[second])[:, None], slopes[first] - slopes[second]
        with np.errstate(divide="ignore", invalid="ignore"):
            moved = u - apart / by
        inside = (moved >= 0) & (moved <= 1)
        found = np.tile(u, (int(inside.sum()), 1))
        found[np.arange(len(found)), np.nonzero(inside)[1]] = moved[inside]
        return found

    def _promising(self, u: Vector, least: float) -> list[complex]:
        """Of a member's slowest motions, ln μ / T of those whose rates, `BENT` times as steep, fall below `least`."""
        at, found = self.outcome(u), list[complex]()
        for k, pole in enumerate(at.upper_poles[:MOTIONS].tolist()):
            rate = at.rate(k)
            slopes = np.nan_to_num(self.slopes(u, at, rate))
            if rate.value + BENT * float(np.minimum(-slopes * u, slopes * (1.0 - u)).sum()) < least:
                found.append(pole)
        return found

    def _followed(self, u: Vector, motion: complex) -> tuple[float, Vector]:
        """The least rate of one motion, 1/s, to which steps against its gradient lead, and where.

        Steps are so short that the motion is the one whose ln μ / T is nearest to that of the step before.
        """
        stride, best, slopes = STRIDE, math.inf, np.zeros(len(u))
        there = u
        for _ in range(STEPS):
            at = self.outcome(there)
            poles = at.upper_poles
            k = int(np.argmin(np.abs(poles - motion)))
            rate = at.rate(k)
            if rate.value < best:
                u, best, motion, slopes = there, rate.value, complex(poles[k]), self.slopes(there, at, rate)
            else:
                stride /= 4
            # Along the edge of the box where the gradient leads out of it.
            free = np.where((slopes > 0) & (u <= 0) | (slopes < 0) & (u >= 1), 0.0, np.nan_to_num(slopes))
            size = float(np.abs(free).max(initial=0.0))
            if not size or stride < STRIDE / 4**2:
                break
            there = np.clip(u - stride * free / size, 0.0, 1.0)
        return best, u

    def _least(self, measure: Callable[[LoopPoint], Measured], start: Vector) -> tuple[float, Vector]:
        """The least of a measure that a search with exact gradients meets from a member, and where."""
        from scipy.optimize import minimize  # noqa: PLC0415  (loads slowly)

        def value(u: Vector) -> tuple[float, Vector]:
            outcome = self.outcome(np.clip(u, 0.0, 1.0))
            measured = measure(outcome)
            return measured.value, np.nan_to_num(self.slopes(u, outcome, measured))

        found: Any = minimize(
            value, start, jac=True, method="L-BFGS-B", bounds=[(0.0, 1.0)] * len(start), options={"maxfun": STEPS}
        )
        return float(found.fun), np.clip(found.x, 0.0, 1.0)

    def worst(
        self, measure: str, few: Sequence[PointAt], members: Vector, slowest: Vector, known: float | None = None
    ) -> tuple[list[float], list[ValueAt]]:
        """One of `SENSES`' measures at a few members, and what a search from there finds of worse ones.

        Gradients lead to corners; of gains and dead times that the loop bears all members are looked at, up to the
        least that is known; of dead times and settling lines across the box through the worst. NaN, where a loop
        grows, is as bad as can be, and ends the search.

        Args:
            measure: by name.
            few: loops whose values are told, and their members.
            members: (n, k);  slowest: the member that decays slowest.
            known: the worst that is known of other loops; of these only what is worse is looked for.
        """
        known = SENSES[measure] * math.inf if known is None else known
        values: list[float] = [getattr(point, measure)().value for point, _ in few]
        further = self.farther(measure, few, values)
        told, sense = [*values, *(value for value, _ in further), known], SENSES[measure]
        if any(map(math.isnan, told)):
            return values, further
        if measure == ALLOWED_GAIN:
            return values, further + self.lower_gains(members, min(told), slowest)
        if measure == DELAY_MARGIN:
            further += self.shorter_margins(members, min(told))
        if any(math.isnan(value) for value, _ in further):
            return values, further
        middle = np.full(members.shape[1], 0.5)
        looked: list[ValueAt] = [(x, middle if u is None else u) for x, (_, u) in zip(values, few, strict=True)]
        worst, there = min([*looked, *further], key=lambda each: sense * each[0])
        if measure in (DELAY_MARGIN, SETTLING) and sense * worst <= sense * known:
            further += self.across(measure, worst, there)
        return values, further

    def farther(self, measure: str, few: Sequence[PointAt], values: Sequence[float]) -> list[ValueAt]:
        """What one of `SENSES`' measures comes to at the corners to which its exact gradient points, and these.

        From the worst of its values on, as long as it becomes worse; NaN, where it is none, is the last.

        Args:
            measure: by name;  values: at these few.
        """
        found, sense = list[ValueAt](), SENSES[measure]
        if any(map(math.isnan, values)):
            return found
        first = min(range(len(values)), key=lambda k: sense * values[k])
        (at, u), worst = few[first], values[first]
        u = np.full(len(self.box.uncertainty), 0.5) if u is None else u
        for _ in range(WALK):
            slopes = sense * np.nan_to_num(self.slopes(u, at, getattr(at, measure)()))
            corner = np.where(slopes > 0, 0.0, np.where(slopes < 0, 1.0, u))
            if np.array_equal(corner, u):
                break
            u, at = corner, self.outcome(corner)
            found.append((getattr(at, measure)().value, u))
            if not sense * found[-1][0] < sense * worst:
                break
            worst = found[-1][0]
        return found

    def shorter_margins(self, members: Vector, least: float) -> list[ValueAt]:
        """`LoopPoint.delay_margin` of members (n, k), each less than all before; none of a loop that grows."""
        found = list[ValueAt]()
        for u in members:
            value = self.outcome(u).delay_margin(below=least).value
            if not value >= least:
                found.append((value, u))
                least = value
            if math.isnan(least):
                break
        return found

    def across(self, measure: str, worst: float, u: Vector) -> list[ValueAt]:
        """Worse values of one of `SENSES`' measures on lines across the box through a member, and where slopes lead.

        As one lies between members where another motion comes to be the first that grows, or the last that settles.

        Args:
            measure: by name;  worst: the worst that is known;  u: (k,) whose it is.
        """
        found, sense = list[ValueAt](), SENSES[measure]

        def measured(point: LoopPoint) -> Measured:
            if measure == DELAY_MARGIN:
                return point.delay_margin(below=worst)
            found: Measured = getattr(point, measure)()
            return found

        for _ in range(CROSSED):
            before = worst
            for v in self.box.cross(u, CLOSE):
                value = measured(self.outcome(v)).value
                if not sense * value >= sense * worst:
                    found.append((value, v))
                    worst, u = value, v
                if math.isnan(worst):
                    return found
            if worst == before:
                break
        if 0 < worst < math.inf:
            value, v = self._least(lambda point: measured(point).times(sense), u)
            found += [(sense * value, v)] if value < sense * worst else []
        return found

    def lower_gains(self, members: Vector, least: float, slowest: Vector) -> list[ValueAt]:
        """`LoopPoint.allowed_gain` of members (n, k), and of others across the box, each less than the one before.

        The loops of all are looked at in stacks, with gains up to the least that is known; of the one that grows first
        it is computed, and so on; from the last, and from the slowest member found, a search goes on. What is stable
        again between two of LEVELS gains is not seen.
        """
        present, found = self.settings.kp[int(np.argmax(self.settings.kp > 0))], list[ValueAt]()
        members = np.concatenate([members, self.box.cross(slowest, 2 * ACROSS)])
        while len(members) and present > 0 and least > 0:
            factor = SHORT * min(least / present, 10.0**HIGH)
            factors = cast(Vector, np.geomspace(min(1.0, factor), factor, LEVELS if factor > 1 else 1))
            grows = ~(self.decays(members, factors).reshape(len(factors), len(members)) > 0)
            members = members[grows.any(axis=0)]
            if not len(members):
                break
            # At the least of these gains that any grows with.
            first = int(np.argmin(grows[:, grows.any(axis=0)].argmax(axis=0)))
            value = self.outcome(members[first]).allowed_gain().value
            if value < least:
                found.append((value, members[first]))
                least = value
            members = np.delete(members, first, axis=0)
        starts = [slowest, found[-1][1]] if found else [slowest]
        return found + [self._least(LoopPoint.allowed_gain, start) for start in starts if present > 0 and least > 0]
