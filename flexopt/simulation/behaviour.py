"""What a run shows in a few numbers: does the base's oscillation grow, when does the end-point settle.

In: maxima over short windows of the squared end-point error, of the oscillation's energy in the springs and of the
squared base rotation, one column for each member. Out: `Behaviour`, one entry for each member. The same code judges one
trajectory, recorded at every sample, and an ensemble that keeps nothing but window maxima.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from flexopt.model.arguments import Vector

Verdict = Literal["converges", "grows"]
SETTLED = 0.02  # share of the error at the start
# Oscillation energy below this share of its largest value is rounding.
ROUNDING = 1e-24
FEWEST_WINDOWS = 4


@dataclass(frozen=True)
class Behaviour:
    """Measures of N runs.

    Attributes:
        grows: the verdict: it left the finite numbers, or the fit below says so (N,).
        growth_rate: of the base oscillation's amplitude, 1/s: half the slope of the logarithm of the energy's maxima
            over periods of the slowest mode, least squares over the second half of the run (N,); NaN where the base
            never moved.
        growth_rate_error: standard error of that slope (N,). `grows` where the rate exceeds twice it, or where the
            oscillation does not decay by twice it and ends no smaller than it began.
        settling_time: after which the end-point error stays below 2 % of what it was at the start, s; NaN where it does
            not (N,).
        peak_error, end_error: largest and last |e|, m (N,).
        peak_base_rotation: rad (N,); NaN for a base that cannot turn.
        finite_until: time up to which every state was a finite number, s (N,).
    """

    grows: NDArray[np.bool_]
    growth_rate: Vector
    growth_rate_error: Vector
    settling_time: Vector
    peak_error: Vector
    end_error: Vector
    peak_base_rotation: Vector
    finite_until: Vector

    def verdict(self, member: int = 0) -> Verdict:
        """The verdict in the command line's word."""
        return "grows" if self.grows[member] else "converges"


def behaviour(times: Vector, monitors: Vector, end_error: Vector, slowest_hz: float, *, turns: bool) -> Behaviour:
    """Judge N runs.

    Args:
        times: (windows + 1,) edges of the windows, s.
        monitors: (windows, 3 or more, N) maxima: squared error, oscillation energy, squared base rotation.
        end_error: |e| at the end, (N,).
        slowest_hz: frequency of the slowest flexible mode.
        turns: whether the base can turn.
    """
    squared_error, energy, rotation = monitors[:, 0], monitors[:, 1], monitors[:, 2]
    alive = np.logical_and.accumulate(np.isfinite(squared_error) & np.isfinite(energy), axis=0)
    finite = np.where(np.all(alive, axis=0), times[-1], times[np.sum(alive, axis=0)])
    rate, error, first, last = _growth(times, np.where(alive, energy, np.nan), slowest_hz)
    diverged = ~np.all(alive, axis=0) | ~np.isfinite(end_error)
    stays = (last >= first) & (rate > -2 * error)
    with np.errstate(invalid="ignore"):
        grows = diverged | (rate > 2 * error) | stays
    loud = squared_error > SETTLED**2 * squared_error[:1]
    loud |= ~np.isfinite(squared_error)
    last_loud = len(loud) - 1 - np.argmax(loud[::-1], axis=0)
    settling = np.where(np.any(loud, axis=0), times[1:][last_loud], times[0])
    settling = np.where(loud[-1], np.nan, settling)
    peak = np.sqrt(np.max(np.where(alive, squared_error, -np.inf), axis=0, initial=0.0))
    turn = np.sqrt(np.max(np.where(alive, rotation, -np.inf), axis=0, initial=0.0))
    return Behaviour(
        grows=grows,
        growth_rate=rate,
        growth_rate_error=error,
        settling_time=settling,
        peak_error=np.where(diverged, np.inf, peak),
        end_error=np.where(diverged, np.inf, end_error),
        peak_base_rotation=turn if turns else np.full_like(turn, np.nan),
        finite_until=finite,
    )


def _growth(times: Vector, energy: Vector, slowest_hz: float) -> tuple[Vector, Vector, Vector, Vector]:
    """Growth rate, its standard error, and the amplitudes in the first and the last period, each (N,)."""
    step = float(times[-1] - times[0]) / len(energy)
    per_period = max(1, math.ceil(1 / (slowest_hz * step) - 1e-9)) if slowest_hz > 0 else 1
    per_period = min(per_period, max(1, len(energy) // FEWEST_WINDOWS))
    # Whole periods, counted from the end: what is left over at the start is the transient's.
    count = len(energy) // per_period
    whole = energy[len(energy) - count * per_period :]
    peaks = np.max(whole.reshape(count, per_period, -1), axis=1)
    centres = times[-1] - step * per_period * (np.arange(count)[::-1] + 0.5)

    floor = ROUNDING * np.nanmax(np.where(np.isfinite(peaks), peaks, np.nan), axis=0, initial=0.0)
    used = np.logical_and.accumulate(np.isfinite(peaks) & (peaks > floor), axis=0)
    length = np.sum(used, axis=0)
    used &= np.arange(count)[:, None] >= length // 2
    weight = used.astype(float)
    n = np.sum(weight, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        logarithm = np.where(used, 0.5 * np.log(peaks), 0.0)
        mean_t = weight.T @ centres / n
        mean_y = np.sum(logarithm, axis=0) / n
        dt = np.where(used, centres[:, None] - mean_t, 0.0)
        dy = np.where(used, logarithm - mean_y, 0.0)
        spread = np.sum(dt**2, axis=0)
        rate = np.sum(dt * dy, axis=0) / spread
        residual = np.sum((dy - rate * dt) ** 2, axis=0)
        error = np.sqrt(np.maximum(residual, 0.0) / np.maximum(n - 2, 1) / spread)
        first = np.sqrt(peaks[0])
        last = np.sqrt(np.take_along_axis(peaks, np.maximum(length - 1, 0)[None], axis=0)[0])
    still = length < 2
    return (np.where(still, np.nan, rate), np.where(still, np.nan, error),
            np.where(still, 0.0, first), np.where(still, -1.0, last))  # fmt: skip
