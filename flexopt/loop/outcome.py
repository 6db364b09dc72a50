"""What a loop does in one configuration: which gains and dead times it bears, how robust it is, how it moves.

In: a loop's motions. Out: measures of the exact sampled loop by name, how fast it decays among them, each with its
exact derivative by placement, posture, parameters, gains and dead time: through eigenvectors and singular vectors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from flexopt.coprime import StateSpace
from flexopt.foundation.roots import border
from flexopt.loop.assembly import Slopes
from flexopt.loop.borders import HIGH, LOW, POINTS, highest_stable, stable_intervals
from flexopt.loop.disturbance import Disturbed
from flexopt.loop.frequency_response import PEAKS, crossings, exactly, peak, peak_at
from flexopt.loop.loop_motions import UNDEFINED, LoopMotions, Measured
from flexopt.loop.small_motions import AT_REST
from flexopt.loop.spectrum import MOSTLY, balance, poles_of, without_neutral
from flexopt.loop.standard_move import StandardMove
from flexopt.model.loop import DELAY_MAX, GAINS

# In a sample: of an undamped motion that the loop does not see this much decay may be rounding.
UNDAMPED = 1e3 * float(np.finfo(float).eps)
# Looks at longer dead times in a sample, and how many at most up to where the loop may be at a border.
CLOSE, LOOKS = 4, 16
# How far on either side of a border, in samples, eigenvalues say that it is one.
ASIDE = 1e-3
# So far below a border of stability it is looked at what grows there.
NEAR = 0.01


@dataclass(frozen=True, eq=False)
class LoopPoint(LoopMotions):
    """A loop at numbers: what it does there."""

    # Gains and dead times that it bears.

    def growth_at(self, exponent: float) -> float:
        """Growth rate with all gains times 10^exponent, 1/s."""
        return self._times(10.0**exponent).growth_rate

    @cached_property
    def gain_intervals(self) -> tuple[tuple[float, float], ...]:
        """(lower, upper) of the factors, 10^LOW to 10^HIGH, times which all gains together leave the loop stable.

        About where it rests with the present gains.
        """
        if not self.rests:
            return ()
        known, (balanced, scale) = None, balance(self.sample.matrix)
        _, kept = without_neutral(balanced, self._neutral)
        if not (self._excess and self.motions.structure.gravity):
            # One batch: what is left of a self-motion that no weight drives decays whatever the gains.
            exponents = np.linspace(LOW, HIGH, POINTS)
            opened = self.sample.open / scale[:, None] * scale
            each = opened + 10.0 ** exponents[:, None, None] * (balanced - opened)
            radius = np.abs(np.linalg.eigvals(kept @ each @ kept.T)).max(axis=1)
            known = poles_of(radius, self.period).real.tolist()
        return stable_intervals(lambda x: self._about_here(10.0**x).growth_rate, UNDAMPED / self.period, known)

    @property
    def drifts_below(self) -> bool:
        """Whether below the least gains that leave it stable what grows is mostly a self-motion, one that drifts."""
        if not (self._drifts and self.gain_intervals):
            return False
        grows = self._about_here(self.gain_intervals[0][0] * (1 - NEAR))
        return grows.growth_rate > 0 and grows.self_motion > MOSTLY

    def allowed_gain(self) -> Measured:
        """The largest Kp along the present ratio of all gains, in its unit: of the first row that has one.

        The upper end of the interval in which the present gains lie; where they lie in none the largest one below, 0
        where none is found; infinite where no border is met; NaN where no row has one. An arm whose weight its
        controller does not know rests elsewhere with other gains: then it is that of the loop about that rest.
        """
        kp = self.numbers["kp"]
        row = int(np.argmax(kp > 0))
        if not kp[row]:
            return UNDEFINED
        if self._hangs:
            return self._allowed_where_it_rests(row)
        below = [(low, high) for low, high in self.gain_intervals if low <= 1.0]
        if not below:
            return Measured(0.0)
        factor = below[-1][1]
        if factor >= 10**HIGH:
            return Measured(math.inf)
        value = self._times(factor).multipliers[0]
        _, by_matrix = self._by_multiplier(value, lambda mu: 1 / mu, factor)
        by_factor = float(np.sum(by_matrix * (self.smooth.into @ self.smooth.force)))
        more = np.zeros_like(kp)
        more[row] = factor
        if not math.isfinite(by_factor) or by_factor == 0:
            return Measured(factor * float(kp[row]))
        slopes = self.smooth.slopes(by_matrix, factor) * (-float(kp[row]) / by_factor)
        return Measured(factor * float(kp[row]), slopes, {"kp": more})

    def _allowed_where_it_rests(self, row: int) -> Measured:
        """`allowed_gain` of a loop that rests elsewhere with other gains."""
        factor = highest_stable(self.growth_at, UNDAMPED / self.period)
        if not 0 < factor < 10**HIGH:
            return Measured(math.inf if factor else 0.0)
        there, kp = self.with_gains(factor), float(self.numbers["kp"][row])
        slowest = there.rate()
        slopes = there.gradient(slowest)
        by_factor = sum(float(slopes[name] @ self.numbers[name]) for name in GAINS)
        if slowest.slopes is None or not math.isfinite(by_factor) or by_factor == 0:
            return Measured(factor * kp)
        by = {name: -kp / by_factor * slope for name, slope in slopes.items()}
        by |= {name: factor * by[name] for name in GAINS}
        by["kp"][row] += factor
        return Measured(factor * kp, by=by)

    def delay_margin(self, below: float = math.inf) -> Measured:
        """Dead time that may be added before the loop grows, s; NaN where it does already, infinite where at none.

        Infinite, too, where it is seen to be no less than `below`.

        Where it may be the frequency response says, to the error of a dead time that is taken as a pure one; where it
        is exactly, up to a dead time of 100 samples the eigenvalues, beyond the frequency response again, without a
        derivative.
        """

        def growth(more: float) -> float:
            return self.spectrum_of(self.sample.later(self.dead_time + more).matrix).growth_rate

        if not self.loop.stable:
            return UNDEFINED
        most = DELAY_MAX * self.period - self.dead_time
        met = crossings(self.sample)
        within = [crossing for crossing in met if 0 < crossing.late < most]
        late = [crossing.late for crossing in within]
        # A loop that holds has to pass the first of these to grow; where they are nearly is off by less than a sample.
        early = [crossing for crossing in within if crossing.late < late[0] + 2 * self.period]
        first = min((exactly(self.sample, crossing) for crossing in early), default=math.inf)
        aside = self.period * ASIDE
        if below <= first - aside and below < most and growth(below) < 0:
            return Measured(math.inf)
        if aside < first < most - aside and growth(first - aside) < 0 <= growth(first + aside):
            return self._border(growth, first - aside, first + aside)
        before = 0.0
        for more in _between([0.0, *late, most], self.period / CLOSE) if late else []:
            if growth(more) >= 0:
                return self._border(growth, before, more)
            before = more
            if before >= below:
                return Measured(math.inf)
        # A sample before the end, too: where it is nearly may lie on the other side.
        beyond = (exactly(self.sample, crossing) for crossing in met if crossing.late >= most - self.period)
        return Measured(next((more for more in beyond if more >= most), math.inf))

    def _border(self, growth: Callable[[float], float], low: float, high: float) -> Measured:
        """The margin between two added dead times, one stable and one not; its derivative keeps the decay at 0."""
        found = border(growth, low, high, xtol=1e-13 * self.period, rtol=1e-14)
        slopes = LoopPoint(self.motions, self.numbers, self.dead_time + found).rate().slopes
        by = slopes and slopes * (-1 / slopes.dead_time)
        return Measured(found, by and Slopes(by.parts, -1.0))

    # Peaks over frequency, the loop broken at the law's force.

    @cached_property
    def _reduced(self) -> StateSpace | None:
        """From a force beside the law's to that of the law, what nothing holds left out; None of a loop that grows."""
        if not self.loop.stable or self._drifts:
            return None
        sample = self.sample
        balanced, scale = balance(sample.matrix)
        matrix, kept = without_neutral(balanced, self._neutral)
        into, force = kept @ (sample.into / scale[:, None]), (sample.force * scale) @ kept.T
        return StateSpace(matrix, into, force, np.zeros((len(force), len(force))), self.period)

    def peak_angle(self, name: str) -> float:
        """Where a measure in `PEAKS` is attained, rad in a sample; NaN where there is none."""
        return math.nan if self._reduced is None else peak_at(self._reduced, *PEAKS[name])[1]

    def _peak(self, name: str) -> Measured:
        return UNDEFINED if self._reduced is None else Measured(*peak(self._reduced, self.smooth, *PEAKS[name]))

    def sensitivity_peak(self) -> Measured:
        """‖S‖∞ of S = (I + L)⁻¹."""
        return self._peak("sensitivity_peak")

    def complementary_peak(self) -> Measured:
        """‖T‖∞ of T = L (I + L)⁻¹ = I − S."""
        return self._peak("complementary_peak")

    def disk_margin(self) -> Measured:
        """α = 1 / ‖S − I/2‖∞, at most 2: gains may vary by (2 − α)/(2 + α) … (2 + α)/(2 − α), phases by 2 atan(α/2).

        In all task rows at once and whatever they do to each other, which is more than each by itself.

        Source: Seiler, Packard and Gahinet, IEEE Control Systems Magazine 40(5), 2020.
        """
        highest = self._peak("disk_margin")
        if not math.isfinite(highest.value):
            return UNDEFINED
        return Measured(1 / highest.value, highest.slopes and highest.slopes * (-1 / highest.value**2))

    # Forces on the base.

    @cached_property
    def disturbed(self) -> Disturbed | None:
        """The loop with noise on its base; None of one that grows."""
        if self._reduced is None:
            return None
        balanced, scale = balance(self.smooth.matrix)
        _, kept = without_neutral(balanced, self._neutral)
        of = [self.numbers[name] for name in (*AT_REST, "held")]
        return Disturbed(self.smooth, self.motions.disturbance.call(of)[0].full(), kept, scale)

    def h2_norm(self) -> Measured:
        """Root of the end-point's variance at the samples under white noise of unit intensity on every base force, m.

        E[d(t) d(t′)ᵀ] = I δ(t − t′) of the forces d on the passive coordinates, N or N m: the H2 norm from them to the
        end-point, m √s per N s and the like. NaN of a loop that grows, stands so near the border that rounding decides
        the norm, or whose self-motion grows; infinite where a task row has no gain Kp. What nothing holds and the
        end-point does not see, self-motion, is divided out.

        Source: Chen and Francis, Optimal Sampled-Data Control Systems, 1995, for what comes in within a sample.
        """
        found = self.disturbed
        if found is None:
            return UNDEFINED
        if not math.isfinite(found.norm):
            return Measured(found.norm)
        slopes, by_into = found.slopes()
        of = [self.numbers[name] for name in (*AT_REST, "held")]
        parts = self.motions.disturbance_slopes.call([*of, by_into])
        more = {name: part.full().ravel() for name, part in zip(AT_REST, parts, strict=True)}
        return Measured(found.norm, slopes, more)

    # The standard move.

    @cached_property
    def move(self) -> StandardMove | None:
        """Its motion, without what drifts of it along a self-motion; None of a loop that grows."""
        if not self.loop.stable:
            return None
        return StandardMove(self.motions, self.smooth, self._neutral, self._drifts)

    def settling(self) -> Measured:
        """After which time of the standard move |e| stays below 2 % of its start, s, exactly, between samples too.

        Of the task rows the longest; NaN of a loop that grows, and where it does not within a minute. Of a self-motion
        that drifts, which has no end, nothing counts (see `StandardMove`), nor does it in the swing. It jumps where
        an excursion begins to leave the band; there, and where two rows take as long, it has no derivative.
        """
        return UNDEFINED if self.move is None else Measured(*self.move.settling())

    def swing(self) -> Measured:
        """The base's largest turn about one of its axes for each m of the standard move, rad.

        NaN of a loop that grows. Of a base that cannot turn the deflection of a passive coordinate, m or rad. No
        derivative where two peaks are as large.
        """
        return UNDEFINED if self.move is None else Measured(*self.move.swing())


def _between(times: list[float], step: float) -> list[float]:
    """The times but the first, with a few between them, `step` apart or more, and after the last but one."""
    found: list[float] = []
    for before, after in pairwise(times):
        count = min(LOOKS, max(2, math.ceil((after - before) / step)))
        found += np.linspace(before, after, count + 1)[1:].tolist()
    return found


# Measures by name, each one number.
MEASURES: dict[str, Callable[[LoopPoint], Measured]] = {
    "decay": LoopPoint.decay,
    "allowed_gain": LoopPoint.allowed_gain,
    "delay_margin": LoopPoint.delay_margin,
    "disk_margin": LoopPoint.disk_margin,
    "h2_norm": LoopPoint.h2_norm,
    "sensitivity_peak": LoopPoint.sensitivity_peak,
    "complementary_peak": LoopPoint.complementary_peak,
    "settling": LoopPoint.settling,
    "swing": LoopPoint.swing,
}
