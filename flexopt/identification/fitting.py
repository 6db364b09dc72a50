"""The fit itself: nonlinear least squares on the simulated swing, with exact derivatives.

In: a `HeldSwing`, a log, a start. Out: a `Fit`: θ, the state at the beginning, an offset of every column, the noise of
every column as its residuals have it, samples left out because they do not belong to the others.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.errors import NoSolutionFound
from flexopt.foundation.arrays import Array, Vector
from flexopt.identification.cleaning import MEDIAN_SHARE
from flexopt.identification.log import MeasuredLog, refused
from flexopt.identification.small_swing import PRIOR
from flexopt.identification.swing import PHASE, STEPS_MAX, HeldSwing

# Residuals beyond so many times the noise are left out; passes of fit and noise; evaluations of each.
OUTLIER, PASSES, EVALUATIONS = 5.0, 5, 25
# The integrator's error may be this share of the noise; noise that changes less between passes is known.
INTEGRATION, SETTLED = 0.02, 0.01
# A column that the model meets exactly has noise of rounding, as a share of what it moves.
ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Fit:
    """Where the sum of squares is least.

    Attributes:
        theta: (n_θ,);  start: (2m,) the state at the first sample;  offset: (c,) of each column.
        sigma: (c,) noise, from the residuals.
        used: (N, c) samples that were fitted.
        fitted: (N, c) the measured quantities as the swing gives them, with offsets.
        slopes: (N, c, 2m + n_θ + c) their derivatives by [start, θ, offset].
        longest: the integrator's longest step, s;  integration: its error, of the noise.
        converged: whether the last pass came to an end.
        misfit: −2 log of the likelihood, and a constant, of all samples.
    """

    theta: Vector
    start: Vector
    offset: Vector
    sigma: Vector
    used: NDArray[np.bool_]
    fitted: Array
    slopes: Array
    longest: float
    integration: float
    converged: bool
    misfit: float


class SwingProblem:
    """Residuals of a log and their exact Jacobian, by z = [start (2m,), θ (n_θ,), offset (c,)].

    Rows: every sample used, in multiples of its column's noise, then θ / 3: the file's numbers are right within a
    factor of e³, so that what the log leaves open stays where the file has it.
    """

    def __init__(self, swing: HeldSwing, log: MeasuredLog, sigma: Vector, used: NDArray[np.bool_], longest: float):
        self.swing, self.log, self.sigma, self.used, self.longest = swing, log, sigma, used, longest
        self._known: tuple[bytes, tuple[Array, Array]] | None = None

    def parts(self, z: Vector) -> tuple[Vector, Vector, Vector]:
        """Start, θ and offsets."""
        m, n = 2 * self.swing.m, len(self.swing.names)
        return z[:m], z[m : m + n], z[m + n :]

    def simulated(self, z: Vector) -> tuple[Array, Array]:
        """What the columns should be (N, c), and the derivatives by z (N, c, n_z)."""
        key = z.tobytes()
        if self._known is None or self._known[0] != key:
            start, theta, offset = self.parts(z)
            y, by = self.swing.observed(*self.swing.run(start, theta, self.log.time, self.longest), theta)
            shift = np.broadcast_to(np.eye(offset.size), (*y.shape, offset.size))
            self._known = key, (y + offset, np.concatenate([by, shift], axis=2))
        return self._known[1]

    def residuals(self, z: Vector) -> Vector:
        """Fit minus log over noise, and the prior's rows."""
        y = self.simulated(z)[0]
        return np.concatenate([((y - self.log.values) / self.sigma)[self.used], self.parts(z)[1] / PRIOR])

    def jacobian(self, z: Vector) -> Array:
        """Of the residuals, exact."""
        by = (self.simulated(z)[1] / self.sigma[:, None])[self.used]
        n, m = len(self.swing.names), 2 * self.swing.m
        prior = np.zeros((n, z.size))
        prior[:, m : m + n] = np.eye(n) / PRIOR
        return np.concatenate([by, prior])


def longest_step(swing: HeldSwing, theta: Vector, time: Vector) -> float:
    """Of the integrator, s.

    Raises:
        InputError: the fastest mode would need too many steps.
    """
    fastest = float(np.abs(np.linalg.eigvals(swing.linear(theta)[0])).max())
    longest = PHASE / fastest
    if (time[-1] - time[0]) / longest > STEPS_MAX:
        lasts = (
            f"lasts too long, {time[-1] - time[0]:g} s, beside the machine's fastest mode, {fastest / math.tau:.4g} Hz"
        )
        raise refused(f"{lasts}: choose a window; or is t in another unit than s?")
    return longest


def fit(
    swing: HeldSwing,
    log: MeasuredLog,
    theta: Vector,
    deviation: Vector,
    sigma: Vector,
    told: Callable[[float], None],
) -> Fit:
    """The least squares from that start; noise and samples to leave out follow from the residuals, in passes.

    Args:
        swing: the machine.
        log: what was measured.
        theta: (n_θ,), deviation: (2m,) of the first state from rest: the start.
        sigma: (c,) first guess of the noise.
        told: is told which share of the passes is done.

    Raises:
        NoSolutionFound: no swing could be computed.
    """
    from scipy.optimize import least_squares  # noqa: PLC0415  (loads slowly)

    used = np.isfinite(log.values)
    longest, converged = longest_step(swing, theta, log.time), False
    z = np.concatenate([swing.rest(theta) + deviation, theta, np.zeros(len(log.channels))])
    first = SwingProblem(swing, log, sigma, used, longest).simulated(z)[0]
    if not np.all(np.isfinite(first)):
        raise NoSolutionFound("identify: the swing cannot be computed", violations={}, iterate={})
    z[z.size - sigma.size :] = np.nanmean(np.where(used, log.values - first, np.nan), axis=0)
    least = ROUNDING * np.nanstd(log.values, axis=0)
    problem = SwingProblem(swing, log, sigma, used, longest)
    for number in range(PASSES):
        problem = SwingProblem(swing, log, sigma, used, longest)
        with np.errstate(all="ignore"):
            found: Any = least_squares(
                problem.residuals, z, problem.jacobian, method="trf", x_scale="jac", max_nfev=EVALUATIONS,
                xtol=1e-9, ftol=1e-7, gtol=1e-9,
            )  # fmt: skip
        z, converged = found.x, bool(found.status > 0)
        residual = np.where(used, problem.simulated(z)[0] - log.values, np.nan)
        before, were = sigma, used
        sigma, used = _noise(log, residual, problem.simulated(z)[0], z.size, least)
        told((number + 1) / PASSES)
        settled = bool(np.all(np.abs(np.log(sigma / before)) < SETTLED)) and bool(np.array_equal(used, were))
        if number and settled:
            break
    start, theta, offset = problem.parts(z)
    fitted, slopes = problem.simulated(z)
    finer = SwingProblem(swing, log, sigma, used, 0.5 * longest).simulated(z)[0]
    error = float((np.abs(finer - fitted) / sigma).max())
    there = np.isfinite(log.values).sum(axis=0)
    misfit = float(np.sum(there * 2.0 * np.log(sigma)) + np.sum((theta / PRIOR) ** 2))
    return Fit(theta, start, offset, sigma, used, fitted, slopes, longest, error, converged, misfit)


def _noise(
    log: MeasuredLog, residual: Array, fitted: Array, unknowns: int, least: Vector
) -> tuple[Vector, NDArray[np.bool_]]:
    """Noise of each column, and which samples are within a few times of it."""
    rough = np.nanmedian(np.abs(residual), axis=0) / MEDIAN_SHARE
    away = np.abs(fitted - log.values)
    used = np.isfinite(log.values) & (away <= OUTLIER * np.maximum(rough, least))
    # What is far from all others is no spike but another motion than the machine's.
    for k in range(rough.size):
        if used[:, k].sum() < 0.95 * np.isfinite(log.values[:, k]).sum():
            used[:, k] = np.isfinite(log.values[:, k])
    count = used.sum(axis=0)
    share = max(0.5, 1.0 - unknowns / max(1, int(count.sum())))
    squares = np.where(used, away, 0.0) ** 2
    return np.maximum(np.sqrt(squares.sum(axis=0) / (share * np.maximum(count, 1))), least), used
