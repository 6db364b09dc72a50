"""What a run shows in a few numbers: does the base's oscillation grow, when does the end-point settle.

In: maxima over short windows of the squared end-point error, of the squared base rotation and of the energy of each
flexible mode, one column for each member. Out: `Behaviour`, one entry for each member. The same code judges one
trajectory, recorded at every sample, and an ensemble that keeps nothing but window maxima.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector

RunVerdict = Literal["converges", "grows"]
SETTLED = 0.02  # share of the error at the start
# Energy of a mode below this share of the largest of all so far is rounding.
ROUNDING = 1e-20
# So is what moves by less than this, m and rad.
STILL = 1e-12
FEWEST_WINDOWS = 4
# Periods in a fit of which the error can be told.
FEWEST_FITTED = 3
# A mode whose kinetic energy stays below this share of its elastic one is bent slowly: a hundredth of its frequency.
QUASI_STATIC = 1e-4
# Where the base is bent slowly, an end-point that is not settled creeps away: by so much from one quarter to the next.
CREPT = 1.05
# An amplitude that ends so many times larger than it began has grown, whatever it does in the end.
GROWN = 3.0


@dataclass(frozen=True)
class Behaviour:
    """Measures of N runs, m flexible modes.

    Attributes:
        grows: the verdict (N,): the run left the finite numbers, or some mode's amplitude grows: its growth rate
            exceeds twice its standard error, or it ends three times as large as it began, or no smaller and without a
            decay of twice that error. A mode at rest at the start is taken to begin in the middle of its motion. So
            does one, where the base `bends`, whose end-point creeps away from its target: then that growth is told.
        grown: how many times as large as at its beginning a mode's amplitude is in the end, of those that grow the one
            with the most (N,); 1 where none does.
        growth_rate: of the mode that has the most energy in the end among those that clearly grow, or else of the one
            that decays slowest, 1/s: half the slope of the logarithm of the mode's energy, maxima over periods of the
            slowest swing, least squares over the second half of the run, three at least (N,); NaN where the base never
            moved. Where the base `bends`, it is fitted to where the base hardly swings any more, and does not know how
            fast what only bends it dies away.
        growth_rate_error: standard deviation of that slope (N,), than which one in three may be farther off, squares
            added: its standard error, by how much its halves differ beyond what scatter makes of them, and where a
            louder mode decays, by how much that one's slope does, and its own error and halves; as large as the rate
            where fewer than six periods are fitted. What is called clear is so by the standard error of each mode.
        settling_time: after which the end-point error stays below 2 % of what it was at the start, s; NaN where it does
            not (N,).
        start_error: largest |e| in the first window, m (N,);  peak_error, end_error: largest and last |e|, m (N,).
        peak_base_rotation: rad (N,); NaN for a base that cannot turn.
        residual_oscillation: largest energy of each mode in the slowest swing's last period (m, N), J.
        finite_until: time up to which every state was a finite number, s (N,).
        significant: whether the growth rate is more than twice its standard error away from 0, or the amplitude three
            times what it was, or nothing moved (N,).
        short: whether what is judged lasts less than four periods of the slowest mode.
        slowest_hz: that mode's frequency.
        duration: s.
    """

    grows: NDArray[np.bool_]
    grown: Vector
    growth_rate: Vector
    growth_rate_error: Vector
    settling_time: Vector
    start_error: Vector
    peak_error: Vector
    end_error: Vector
    peak_base_rotation: Vector
    residual_oscillation: Vector
    finite_until: Vector
    significant: NDArray[np.bool_]
    short: bool
    slowest_hz: float
    duration: float

    def verdict(self, member: int = 0) -> RunVerdict:
        """What the run shows, in a word."""
        return "grows" if self.grows[member] else "converges"

    def shown(self, member: int = 0) -> Shown:
        """What one run shows."""
        return Shown(
            word=self.verdict(member),
            grown=float(self.grown[member]),
            rate=float(self.growth_rate[member]),
            error=float(self.growth_rate_error[member]),
            ended=float(self.finite_until[member]),
            significant=bool(self.significant[member]),
            short=self.short,
            slowest_hz=self.slowest_hz,
            duration=self.duration,
        )


@dataclass(frozen=True)
class Shown:
    """What one run shows of growth; see `Behaviour`, `rate` and `error` in 1/s, `ended` in s."""

    word: RunVerdict
    grown: float
    rate: float
    error: float
    ended: float
    significant: bool
    short: bool
    slowest_hz: float
    duration: float

    @property
    def levelled(self) -> bool:
        """Whether an amplitude became far larger, but hardly in the second half, of which the rate is told."""
        if self.word != "grows" or self.ended < self.duration or self.grown < GROWN:
            return False
        return self.rate < min(self.error, 0.5 * math.log(self.grown) / self.duration)


@dataclass(frozen=True)
class Grounds:
    """What a judgement takes into account.

    Attributes:
        slowest_hz: frequency of the slowest flexible mode.
        turns: whether the base can turn.
        still: energy of each mode (m,), J, that is taken for rounding; by default only what is small beside the others.
        undisturbed_from: time from which nothing is driven any more, s; growth is judged from there.
        noisy: whether noise keeps the modes moving. Their amplitudes then wander, which a fit takes for growth, so
            that only an amplitude three times as large as at first counts.
        swing_hz: of the slowest swing of the loop, where the base comes to rest elsewhere: the arm bends it and lets it
            go in turn, so that a mode's energy rises and falls with it. None: no slower than the modes.
        bends: whether the base comes to rest elsewhere than by design (`LoopStructure.bends`), so that kinetic and
            elastic energies come apart, and a mode that is bent without moving counts as still.
    """

    slowest_hz: float
    turns: bool
    still: Vector | float = 0.0
    undisturbed_from: float = 0.0
    noisy: bool = False
    bends: bool = False
    swing_hz: float | None = None


def behaviour(
    times: Vector, monitors: Vector, end_error: Vector, grounds: Grounds, end_rotation: Vector | float = 0.0
) -> Behaviour:
    """Judge N runs.

    Args:
        times: (windows + 1,) edges of the windows, s.
        monitors: (windows, 2 + m, N) maxima of `Sample.monitor`; (windows, 2 + 2 m, N) of a base that `bends`.
        end_error, end_rotation: |e|, m, and the base's, rad, at the end, which is in no window, (N,).
        grounds: of the judgement.
    """
    squared_error, rotation, energy = monitors[:, 0], monitors[:, 1], monitors[:, 2:]
    modes = energy.shape[1] // 2 if grounds.bends else energy.shape[1]
    alive = np.logical_and.accumulate(np.isfinite(squared_error) & np.all(np.isfinite(energy), axis=1), axis=0)
    finite = np.where(np.all(alive, axis=0), times[-1], times[np.sum(alive, axis=0)])
    diverged = ~np.all(alive, axis=0) | ~np.isfinite(end_error)

    begin = int(np.sum(times[:-1] < grounds.undisturbed_from - 1e-9 * times[-1]))
    short = grounds.slowest_hz * float(times[-1] - times[min(begin, len(times) - 1)]) < FEWEST_WINDOWS
    begin = begin if len(energy) - begin >= FEWEST_WINDOWS else 0
    judged = np.where(alive[begin:, None], energy[begin:], np.nan)
    peaks, centres = _periods(times[begin:], judged, grounds.swing_hz or grounds.slowest_hz)
    peaks, elastic = peaks[:, :modes], peaks[:, modes:]
    bent = QUASI_STATIC * elastic if grounds.bends else 0.0
    rate, error, bend, first, last = _growth(peaks, centres, grounds.still, bent)
    with np.errstate(invalid="ignore", divide="ignore"):
        growing = last >= GROWN * first
        if not grounds.noisy:
            growing |= (rate > 2 * error) | ((last >= first) & (rate > -2 * error))
        wavering = np.any((np.abs(rate) <= 2 * error) & (last < GROWN * first), axis=0)
        clearly = growing & (rate > 2 * error)
        times_larger = np.where(growing & (first > 0), last / first, 1.0)
    told = _told(rate, clearly, last)
    creeps, creep, creep_error = _creeping(times[begin:], squared_error[begin:], squared_error[:1], grounds)
    creeps &= ~np.any(growing, axis=0)
    slowest = np.where(creeps, creep, np.take_along_axis(rate, told[None], axis=0)[0])
    doubt = np.where(creeps, creep_error, _doubt(rate, error, bend, last, told, np.any(clearly, axis=0)))

    loud = ~(squared_error <= np.maximum(SETTLED**2 * squared_error[:1], STILL**2))
    last_loud = len(loud) - 1 - np.argmax(loud[::-1], axis=0)
    settling = np.where(np.any(loud, axis=0), times[1:][last_loud], times[0])
    peak, turn = (
        np.fmax(np.sqrt(np.max(np.where(alive, squares, -np.inf), axis=0, initial=0.0)), end)
        for squares, end in ((squared_error, end_error), (rotation, end_rotation))
    )
    return Behaviour(
        grows=diverged | np.any(growing, axis=0) | creeps,
        grown=np.max(times_larger, axis=0, initial=1.0),
        growth_rate=slowest,
        growth_rate_error=doubt,
        settling_time=np.where(loud[-1], np.nan, settling),
        start_error=np.sqrt(squared_error[0]),
        peak_error=np.where(diverged, np.inf, peak),
        end_error=np.where(diverged, np.inf, end_error),
        peak_base_rotation=turn if grounds.turns else np.full_like(turn, np.nan),
        residual_oscillation=peaks[-1],
        finite_until=finite,
        significant=diverged | ~wavering | creeps,
        short=short,
        slowest_hz=grounds.slowest_hz,
        duration=float(times[-1]),
    )


def _creeping(
    times: Vector, squared_error: Vector, first: Vector, grounds: Grounds
) -> tuple[NDArray[np.bool_], Vector, Vector]:
    """Where the end-point creeps away (N,), at which rate, 1/s, and by how much that of the quarter before differs.

    An arm that pulls the base over, or is carried away by it, does not swing.
    """
    count = len(squared_error) // FEWEST_WINDOWS
    quarter = count * float(times[-1] - times[0]) / max(len(squared_error), 1)
    none = np.zeros(squared_error.shape[1])
    if not grounds.bends or count == 0 or quarter * (grounds.swing_hz or grounds.slowest_hz) < 1:
        return none > 0, none, none
    whole = squared_error[len(squared_error) - FEWEST_WINDOWS * count :]
    parts = np.max(whole.reshape(FEWEST_WINDOWS, count, -1), axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        rates = 0.5 * np.diff(np.log(parts), axis=0) / quarter
        away = (parts[-1] > CREPT**2 * parts[-2]) & (parts[-1] > np.maximum(SETTLED**2 * first[0], STILL**2))
        return away, rates[-1], np.abs(rates[-1] - rates[-2])


def _told(rate: Vector, growing: NDArray[np.bool_], last: Vector) -> NDArray[np.intp]:
    """Of each run the mode whose growth rate is told (N,): of those that grow the largest, else what decays slowest.

    A mode that others drag along, stiff springs at large turns say, grows at a multiple of their rate.
    """
    among = np.where(np.any(growing, axis=0), np.where(growing, last, -np.inf), np.where(np.isnan(rate), -np.inf, rate))
    told: NDArray[np.intp] = np.argmax(among, axis=0)
    return told


def _doubt(
    rate: Vector, error: Vector, bend: Vector, last: Vector, told: NDArray[np.intp], grows: NDArray[np.bool_]
) -> Vector:
    """What the growth rate that is told may be off by (N,); see `Behaviour`.

    Deviations from the line are no noise but what has not died away, and beats. The modes are those without a
    controller: a loop's motion moves several, so that a quiet mode shows for seconds what a louder one lends it.
    """
    loud = np.argmax(np.where(np.isfinite(rate), last, -np.inf), axis=0)
    (own_rate, own_error, own_bend), (loud_rate, loud_error, loud_bend) = (
        [np.take_along_axis(values, at[None], axis=0)[0] for values in (rate, error, bend)] for at in (told, loud)
    )
    lent = (loud_rate - own_rate) ** 2 + loud_error**2 + loud_bend**2
    doubt: Vector = np.sqrt(own_error**2 + own_bend**2 + np.where(grows | (told == loud), 0.0, lent))
    return doubt


def _periods(times: Vector, energy: Vector, slowest_hz: float) -> tuple[Vector, Vector]:
    """Maxima over whole periods of the slowest swing (periods, m, N), and the periods' centres, s.

    Counted from the end: what is left over at the start is the transient's. A run shorter than four periods is cut in
    four.
    """
    step = float(times[-1] - times[0]) / len(energy)
    per_period = max(1, math.ceil(1 / (slowest_hz * step) - 1e-9)) if slowest_hz > 0 else 1
    per_period = min(per_period, max(1, len(energy) // FEWEST_WINDOWS))
    count = len(energy) // per_period
    whole = energy[len(energy) - count * per_period :]
    peaks = np.max(whole.reshape(count, per_period, *energy.shape[1:]), axis=1)
    return peaks, times[-1] - step * per_period * (np.arange(count)[::-1] + 0.5)


def _growth(
    peaks: Vector, centres: Vector, still: Vector | float, bent: Vector | float
) -> tuple[Vector, Vector, Vector, Vector, Vector]:
    """Growth rate, its standard error, by how much halves differ, amplitudes in the first and last period, each (m, N).

    Of the periods from where a mode first leaves rounding and what it is bent by, to where it falls back or to the end.
    """
    largest = np.maximum.accumulate(np.max(peaks, axis=1), axis=0)[:, None]
    with np.errstate(invalid="ignore"):
        above = (
            np.isfinite(peaks) & (peaks > np.maximum(ROUNDING * largest, np.reshape(still, (-1, 1)))) & (peaks > bent)
        )
    begun = np.logical_or.accumulate(above, axis=0)
    whole = begun & ~np.logical_or.accumulate(begun & ~above, axis=0)
    begin, length = np.argmax(whole, axis=0), np.sum(whole, axis=0)
    fitted = begin + np.minimum(length // 2, np.maximum(length - FEWEST_FITTED, 0))
    used = whole & (np.arange(len(peaks))[:, None, None] >= fitted)
    n = np.sum(used, axis=0)
    rate, error, spread = _slope(peaks, centres, used)
    late = used & (np.arange(len(peaks))[:, None, None] >= fitted + n // 2)
    (late_rate, _, late_spread), (early_rate, _, early_spread) = (
        _slope(peaks, centres, half) for half in (late, used & ~late)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        scatter = error**2 * spread * (1 / late_spread + 1 / early_spread)
        bend = np.sqrt(np.maximum((late_rate - early_rate) ** 2 - scatter, 0.0))
    # Halves of too few periods are not compared; of two periods the error says it.
    bend = np.where(np.sum(used & ~late, axis=0) < FEWEST_FITTED, np.where(n < FEWEST_FITTED, 0.0, np.abs(rate)), bend)
    with np.errstate(divide="ignore", invalid="ignore"):
        # A line goes through two points whatever they are.
        error = np.where(n < FEWEST_FITTED, np.abs(rate), error)
        # What sets in later is compared with where the fit begins: it may have been pushed.
        start = np.where(begin == 0, 0, fitted)
        first, last = (
            np.sqrt(np.take_along_axis(peaks, at[None], axis=0)[0]) for at in (start, begin + np.maximum(length - 1, 0))
        )
    unmoved = length < 2
    return (np.where(unmoved, np.nan, rate), np.where(unmoved, np.nan, error), np.where(unmoved, 0.0, bend),
            np.where(unmoved, 1.0, first), np.where(unmoved, 0.0, last))  # fmt: skip


def _slope(peaks: Vector, centres: Vector, used: NDArray[np.bool_]) -> tuple[Vector, Vector, Vector]:
    """Half the slope of logarithms of maxima (periods, m, N) over the used periods, its standard error, and Σ Δt²."""
    n = np.sum(used, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        logarithm = np.where(used, 0.5 * np.log(peaks), 0.0)
        time = np.where(used, centres[:, None, None], 0.0)
        dt = np.where(used, time - np.sum(time, axis=0) / n, 0.0)
        dy = np.where(used, logarithm - np.sum(logarithm, axis=0) / n, 0.0)
        spread = np.sum(dt**2, axis=0)
        rate: Vector = np.sum(dt * dy, axis=0) / spread
        residual = np.sum((dy - rate * dt) ** 2, axis=0)
        error: Vector = np.sqrt(residual / np.maximum(n - 2, 1) / spread)
    return rate, error, spread
