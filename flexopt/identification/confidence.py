"""How well a log says what was fitted to it: intervals of confidence, what it leaves open, whether the noise is white.

In: a `Fit`. Out: a `Confidence`. From the exact Jacobian P of the residuals by θ, with the first state and the offsets
eliminated: the covariance of θ is (PᵀP)⁻¹ where residuals are white. Where they are not it is (PᵀP)⁻¹ Ω (PᵀP)⁻¹ with
the sum Ω of the correlated scores (Newey and West 1987) over a tenth of the log, whatever its rate, and what so long a
sum is off by (Kiefer and Vogelsang 2005); never the smaller of the two. What moves no other poles than those of modes
that do not stand out of the noise is open.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Array, Vector
from flexopt.identification.fitting import Fit
from flexopt.identification.swing import HeldSwing, oscillations

LEVEL = 0.95
# A parameter is identified where its interval is within this factor of its value either way.
FACTOR = 2.0
# Lags and level of the test for white residuals (Ljung and Box 1978).
LAGS, WHITE = 20, 0.001
# What a singular value of P may be at least, so that a direction has a length.
SMALLEST = 1e-12
# A parameter belongs to a direction that is open where it has this share of it.
SHARE = 0.1
# Fits that differ by less, in θ, are the same.
SAME = 1e-3
# What a mode must take from the sum of squares, beyond what the strongest of N frequencies takes of mere noise, 2 ln N:
# 3 standard deviations.
SEEN = 9.0
# The chance that another fit than the best is as good, and by what its squares, in those of the noise, are then more.
BY_CHANCE, BETTER_BY = 0.001, 10.8
# Into how many stretches a log is cut, which are to know little of each other.
STRETCHES = 6
# A fit that leaves residuals so many times as large is no other that fits: of squares in as many stretches that know
# nothing of each other fewer than 1 in 100 are by chance (Fisher's F).
MUCH_LARGER = 3.0
# Of the log, over which residuals may know of each other; by what that widens an interval of 95 %.
CORRELATED, LONG = 0.1, 2.26 / 1.96
# Steps of θ in differences of poles, which themselves are known to 1e-12; the least share that is no rounding.
MOVED = 1e-5


@dataclass(frozen=True, eq=False)
class Confidence:
    """What the log says of θ.

    Attributes:
        low, high: (n_θ,) ends of the intervals of θ, by factors e^w up and 1 − w down: a damper's noise is as large
            either way; other fits that the log does not tell from this one lie within.
        deviations: (n_θ,) standard deviations of θ;  covariance: (n_θ, n_θ).
        quantile: how many of them the interval reaches either way.
        identified: (n_θ,) whether it is within `FACTOR`.
        directions: (k, n_θ) unit vectors of θ that the log leaves open, the most open first.
        white: (c,) whether each column's residuals are.
        others: other fits that the log does not tell from this one.
    """

    low: Vector
    high: Vector
    deviations: Vector
    covariance: Array
    quantile: float
    identified: NDArray[np.bool_]
    directions: Array
    white: NDArray[np.bool_]
    others: tuple[Fit, ...]

    def apart(self, theta: Vector, other: Vector) -> NDArray[np.bool_]:
        """(n_θ,) in which parameters another fit lies outside the intervals of this one."""
        return np.abs(other - theta) > np.maximum(2.0 * self.quantile * self.deviations, SAME)


def hidden(swing: HeldSwing, found: Fit, time: Vector) -> tuple[Vector, Array]:
    """Frequencies, Hz, of modes that do not stand out of the noise, and the moves of θ that they alone feel (n_θ, k).

    The noise alone has frequencies in it, and the fit finds them: such a mode's pole tells nothing of the machine. The
    moves change it by as much as its size, and the poles of the others not at all.
    """
    theta = found.theta
    roots, shapes = swing.excited(theta, found.start)
    parts = 2 * (oscillations(roots, time)[:, None, :] * (swing.linear(theta)[1] @ shapes)).real
    taken = np.sum((parts / found.sigma[:, None])[found.used] ** 2, axis=0)
    weak = taken < 2 * math.log(max(2, int(found.used.sum()))) + SEEN
    ways = MOVED * np.eye(theta.size)
    moved = swing.roots_of(np.vstack([theta + ways, theta - ways])) if weak.any() else []
    if not moved or any(each.shape != roots.shape for each in moved):
        return np.zeros(0), np.zeros((theta.size, 0))
    more, less = np.split(np.array(moved), 2)
    slopes = (more - less).T / (2 * MOVED) / np.abs(roots)[:, None]
    seen, unseen = (np.vstack([part.real, part.imag]) for part in (slopes[~weak], slopes[weak]))
    sizes, rows = np.linalg.svd(np.vstack([seen, np.zeros((1, theta.size))]))[1:]
    rank = int(np.count_nonzero(sizes > MOVED * sizes[0])) if sizes[0] > 0 else 0
    free = rows[rank:].T
    hertz: Vector = np.abs(roots[weak]) / (2 * math.pi)
    return hertz, np.asarray(free @ np.linalg.pinv(unseen @ free, rcond=MOVED), dtype=np.float64)


def confidence(found: Fit, values: Array, unseen: Array, others: Sequence[Fit] = ()) -> Confidence:
    """Of a fit to the samples `values` (N, c), beside others that fit as well; `unseen`: moves, as of `hidden`."""
    from scipy.stats import t  # noqa: PLC0415  (loads slowly)

    residual = np.where(found.used, (found.fitted - values) / found.sigma, np.nan)
    rows = (found.slopes / found.sigma[:, None])[found.used]
    m, n = found.start.size, found.theta.size
    nuisance: Array = np.delete(rows, np.arange(m, m + n), axis=1)
    nuisance = nuisance / np.maximum(np.linalg.norm(nuisance, axis=0), 1e-300)
    p: Array = rows[:, m : m + n]
    p = p - nuisance @ np.linalg.lstsq(nuisance, p, rcond=1e-12)[0]
    _, s, v = np.linalg.svd(p, full_matrices=False)
    covariance: Array = v.T @ np.diag(1.0 / np.maximum(s, SMALLEST) ** 2) @ v
    white = np.array([is_white(column[np.isfinite(column)]) for column in residual.T])
    if not white.all():
        correlated = covariance @ _scores(p, residual, found.used) @ covariance
        wider = np.maximum(1.0, LONG * np.sqrt(np.diag(correlated) / np.diag(covariance)))
        covariance = wider[:, None] * covariance * wider
    covariance = covariance + unseen @ unseen.T
    deviations = np.sqrt(np.diag(covariance))
    quantile = float(t.ppf(0.5 + 0.5 * LEVEL, max(1, len(rows) - rows.shape[1])))
    width = quantile * deviations
    squares, ways = np.linalg.eigh(covariance)
    is_open = quantile * np.sqrt(np.maximum(squares, 0.0)) > 1 - 1 / FACTOR
    directions = ways.T[is_open][::-1]
    down = -np.log1p(-np.minimum(width, 1 - SMALLEST))
    ends = [(center - down, center + width) for center in (found.theta, *(each.theta for each in others))]
    low, high = (choose([end[k] for end in ends], axis=0) for k, choose in ((0, np.min), (1, np.max)))
    identified = np.maximum(found.theta - low, high - found.theta) <= math.log(FACTOR)
    return Confidence(low, high, deviations, covariance, quantile, identified, directions, white, tuple(others))


def is_white(residual: Vector) -> bool:
    """Whether the residuals of a column know nothing of each other."""
    from scipy.stats import chi2  # noqa: PLC0415  (loads slowly)

    count = residual.size
    lags = min(LAGS, count // 4)
    centred = residual - residual.mean()
    power = float(centred @ centred)
    if lags < 1 or power == 0.0:
        return True
    rho = np.array([float(centred[k:] @ centred[:-k]) for k in range(1, lags + 1)]) / power
    statistic = count * (count + 2) * float(np.sum(rho**2 / (count - np.arange(1, lags + 1))))
    return bool(chi2.sf(statistic, lags) >= WHITE)


def told_apart(least: Fit, other: Fit, values: Array) -> bool:
    """Whether the samples `values` (N, c) say that one fit is better than another, whatever they have in common.

    The other's −2 log of the likelihood is more by more than `BETTER_BY`, and where residuals are not white its squares
    are more by Σ_t d_t, d = Σ_c (r_o² − r_l²)/σ_l², in more stretches of the log than chance has it, or its residuals
    are `MUCH_LARGER` times as large. So what no fit has, as a spring that is not linear, decides nothing by itself.
    Each stretch has the same share of the squares by which the fits differ, for a swing dies away.

    Source: Vuong, Econometrica 57 (1989), for two fits of which none need be true; Ibragimov and Müller, J. Business
    and Economic Statistics 28 (2010), for Student's t of a few stretches, however instants within them know of each
    other.
    """
    from scipy.stats import t  # noqa: PLC0415  (loads slowly)

    if other.misfit - least.misfit <= BETTER_BY:
        return False
    residual = np.where(least.used, least.fitted - values, np.nan)
    if all(is_white(column[np.isfinite(column)]) for column in residual.T):
        return True
    both, scale = least.used & other.used, least.sigma**2
    if math.exp(np.average(np.log(other.sigma / least.sigma), weights=both.sum(axis=0))) > MUCH_LARGER:
        return True
    squares = [np.where(both, (each.fitted - values) ** 2 / scale, 0.0) for each in (other, least)]
    apart = np.where(both, (other.fitted - least.fitted) ** 2 / scale, 0.0).sum(axis=1).cumsum()
    stretch = np.minimum(STRETCHES * apart / max(apart[-1], SMALLEST), STRETCHES - 1).astype(int)
    sums = np.bincount(stretch, weights=(squares[0] - squares[1]).sum(axis=1), minlength=STRETCHES)
    spread = float(sums.std(ddof=1)) / math.sqrt(STRETCHES)
    return bool(sums.mean() > float(t.isf(BY_CHANCE, STRETCHES - 1)) * spread)


def _scores(p: Array, residual: Array, used: NDArray[np.bool_]) -> Array:
    """Ω, (n_θ, n_θ): the scores of each instant with those of the instants around it, weights falling to 0."""
    from scipy.signal import fftconvolve  # noqa: PLC0415  (loads slowly)

    by_time = np.zeros((*used.shape, p.shape[1]))
    by_time[used] = p * residual[used][:, None]
    scores = by_time.sum(axis=1)
    reach = math.ceil(CORRELATED * len(scores))
    falling = 1.0 - np.abs(np.arange(-reach, reach + 1)) / (reach + 1)
    around = cast(Any, fftconvolve)(scores, falling[:, None], axes=0)[reach : reach + len(scores)]
    found: Array = scores.T @ around
    return found


def is_open_in_words(direction: Vector, names: tuple[str, ...]) -> str:
    """Which parameters a direction is made of."""
    share = direction**2
    order: list[int] = np.argsort(-share, kind="stable").tolist()
    listed = [names[k] for k in order if share[k] >= SHARE]
    if len(listed) <= 1:
        return listed[0] if listed else names[int(np.argmax(share))]
    return f"a combination of {', '.join(listed[:-1])} and {listed[-1]}"
