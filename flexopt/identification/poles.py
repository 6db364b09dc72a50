"""The poles of a log: frequencies and decays of what it swings in, before any model of the machine is asked.

In: evenly sampled columns, with holes. Out: `Poles`, with the share of each column in them. Method: the singular
vectors of windows of the log, all columns together, are shifted by one sample by the matrix whose eigenvalues are
exp(λ Δt) (matrix pencil of state space; Hua and Sarkar 1990, Juang and Pappa 1985). Windows with holes are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Array, ComplexArray, Vector
from flexopt.identification.swing import eigen, oscillations

# Windows and rows of the matrix that is decomposed, at most.
WINDOWS, ROWS = 700, 600
DAMPING_MAX = 0.7


@dataclass(frozen=True, eq=False)
class Poles:
    """What a log swings in, strongest first.

    Attributes:
        values: (k,) complex, 1/s, imaginary parts positive.
        shapes: (c, k) complex amplitudes of the columns at the beginning.
        strength: (k,) root mean square of each over the log, of columns scaled to 1.
        evidence: twice the logarithm of the likelihood by which the strongest decays rather than lasts; negative where
            it grows.
    """

    values: ComplexArray
    shapes: ComplexArray
    strength: Vector
    evidence: float


def find_poles(columns: Array, step: float, most: int) -> Poles:
    """The strongest `most` oscillations of columns (N, c), NaN where a sample is missing, every `step` s."""
    scale = np.nanstd(columns, axis=0)
    scaled = (columns - np.nanmean(columns, axis=0)) / np.where(scale > 0, scale, 1.0)
    count, c = scaled.shape
    there = ~np.isnan(scaled).any(axis=1)
    longest = max(8, min(count // 3, ROWS // c))
    lengths = sorted({max(8, int(share * longest)) for share in (1.0, 0.7, 0.5, 0.35, 0.2, 0.1)}, reverse=True)
    # Long windows tell poles apart, many of them tell them from noise.
    length = max(lengths, key=lambda size: size * min(size, np.count_nonzero(_unbroken(there, size))))
    whole = np.flatnonzero(_unbroken(there, length))
    if whole.size < 4 * most:
        return _none(c)
    chosen = whole[np.unique(np.linspace(0, whole.size - 1, WINDOWS).astype(int))]
    windows = np.stack([scaled[k : k + length].ravel() for k in chosen], axis=1)
    u = np.linalg.svd(windows, full_matrices=False)[0]
    order = min(2 * most + 4, u.shape[1] - 1)
    shift = np.linalg.lstsq(u[:-c, :order], u[c:, :order], rcond=None)[0]
    roots: Any = np.log(eigen(shift)[0]) / step
    top = math.pi / step
    swings = roots[(roots.imag > 1e-3 * top) & (roots.imag < 0.97 * top)]
    swings = swings[(-swings.real < DAMPING_MAX * np.abs(swings)) & (swings.real < 0.05 * np.abs(swings))]
    return _weighed(scaled, scale, step, swings, most) if swings.size else _none(c)


def _none(columns: int) -> Poles:
    return Poles(np.zeros(0, complex), np.zeros((columns, 0), complex), np.zeros(0), 0.0)


def _unbroken(there: NDArray[np.bool_], length: int) -> NDArray[np.bool_]:
    """Where a window of that length begins in which nothing is missing."""
    if there.size < length:
        return np.zeros(0, dtype=bool)
    total = np.concatenate([[0], np.cumsum(there)])
    return total[length:] - total[:-length] == length


def _weighed(scaled: Array, scale: Vector, step: float, roots: ComplexArray, most: int) -> Poles:
    """Amplitudes by least squares, and the strongest of the poles."""
    t: Vector = step * np.arange(float(len(scaled)))
    waves = oscillations(roots, t)
    basis: Array = np.column_stack([waves.real, -waves.imag, np.ones(t.size)])
    k = roots.size
    shapes: ComplexArray = np.zeros((scaled.shape[1], k), complex)
    power = np.zeros(k)
    for j, column in enumerate(scaled.T):
        there = np.isfinite(column)
        weights = cast(Vector, np.linalg.lstsq(basis[there], column[there], rcond=None)[0])
        shapes[j] = weights[:k] + 1j * weights[k : 2 * k]
        power += np.mean((waves * shapes[j]).real ** 2, axis=0)
    order = np.argsort(-power, kind="stable")[:most]
    amplitudes: ComplexArray = scale[:, None].astype(complex) * shapes[:, order]
    evidence = math.copysign(_decay(scaled, t, roots[order]), -roots[order[0]].real)
    return Poles(roots[order], amplitudes, np.sqrt(power[order]), evidence)


def _decay(scaled: Array, t: Vector, roots: ComplexArray) -> float:
    """What the columns lose in likelihood, as twice its logarithm, where the first pole is held at the axis."""

    def left(poles: ComplexArray) -> Vector:
        waves = oscillations(poles, t)
        basis: Array = np.column_stack([waves.real, -waves.imag, np.ones(t.size)])
        squares = list[float]()
        for column in scaled.T:
            there = np.isfinite(column)
            rest = cast(
                Vector, column[there] - basis[there] @ np.linalg.lstsq(basis[there], column[there], rcond=None)[0]
            )
            squares.append(float(rest @ rest) / int(there.sum()))
        return np.array(squares)

    steady = roots.copy()
    steady[0] = 1j * steady[0].imag
    return float(len(t) * np.sum(np.log(left(steady) / left(roots))))
