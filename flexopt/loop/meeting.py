"""Two motions of a loop that meet: their rates have no slopes there, their mean and squared half-difference have.

In: a `LoopPoint`, or one sample of a loop. Out: `Nearest`, `Meeting`.
"""

from __future__ import annotations

import cmath
import math
from itertools import combinations
from typing import NamedTuple

import numpy as np

from flexopt.foundation.arrays import ComplexArray, Vector
from flexopt.loop.loop_motions import SLOWEST_MOTIONS, Measured
from flexopt.loop.outcome import LoopPoint
from flexopt.loop.spectrum import balance

# How many times as far away as from each other two eigenvalues that meet must be from every other.
ALONE = 2.0


class Meeting(NamedTuple):
    """Two eigenvalues near to each other: ln|μ| = m ± Re √d, m and d smooth in Φ where they meet, √d not.

    Attributes:
        mean: m;  squared: d, real where the two are real or conjugate.
        by_mean: ∂m/∂Φ (n, n);  by_squared: ∂d/∂Φ (n, n).
    """

    mean: float
    squared: complex
    by_mean: Vector
    by_squared: ComplexArray


def meeting(balanced_by: tuple[Vector, Vector], one: complex, other: complex) -> Meeting | None:
    """Of two eigenvalues of Φ, as `balance` gives it; None where others cannot be told apart from them.

    With bases X and Y of their invariant subspaces, Yᴴ X = 1, and M = Yᴴ Φ X (2, 2), whose eigenvalues they are:
    m = Re tr ln M / 2, d = tr (ln M)² / 2 − (tr ln M)² / 4, ∂m = Re tr(M⁻¹ ∂M) / 2, ∂d = tr((ln M − m) M⁻¹ ∂M),
    ∂M = Yᴴ ∂Φ X.

    Source: Burke and Overton, Mathematical Programming 90(2), 2001, for what is smooth where eigenvalues meet.
    """
    from scipy.linalg import LinAlgError, schur  # noqa: PLC0415  (loads slowly)

    balanced, scale = balanced_by
    middle = (one + other) / 2
    _, within, beyond, *_ = [*np.sort(np.abs(np.linalg.eigvals(balanced) - middle)).tolist(), math.inf]
    if not (beyond > ALONE * within and middle):
        return None
    radius = math.sqrt(max(within, np.finfo(float).eps) * min(beyond, abs(middle)))
    bases = list[ComplexArray]()
    for matrix in (balanced, balanced.T):

        def chosen(value: complex, centre: complex = middle if matrix is balanced else middle.conjugate()) -> bool:
            return abs(value - centre) <= radius

        try:
            _, vectors, count = schur(matrix, output="complex", sort=chosen)
        except LinAlgError:
            return None
        if count != 2:
            return None
        bases.append(np.asarray(vectors[:, :2], dtype=np.complex128))
    x, y = bases
    y = y @ np.linalg.inv(x.conj().T @ y)
    small = y.conj().T @ balanced @ x
    half = complex(np.trace(small)) / 2
    off: ComplexArray = np.asarray(small - half * np.eye(2), dtype=np.complex128)
    inverse: ComplexArray = np.asarray(np.linalg.inv(small), dtype=np.complex128)
    # (M − c)² = −det(M − c), by Cayley and Hamilton.
    ratio = -complex(np.linalg.det(off)) / half**2
    root = cmath.sqrt(ratio)
    by_root = cmath.atanh(root) / root if abs(root) > np.finfo(float).eps else 1.0
    mean = math.log(abs(half)) + cmath.log(1 - ratio).real / 2

    outward, inward = y.conj() / scale[:, None], (scale[:, None] * x).T
    by_squared: ComplexArray = np.asarray(outward @ (by_root / half * off @ inverse).T @ inward, dtype=np.complex128)
    return Meeting(mean, by_root**2 * ratio, (outward @ inverse.T @ inward).real / 2, by_squared)


class Nearest(NamedTuple):
    """Two motions near to each other: their rates are m ± Re √d, 1/s, m and d smooth where they meet.

    Attributes:
        branches: which, as of `LoopPoint.rate`; one that just oscillates is both.
        oscillate: whether they oscillate, each with its own frequency; else d is real.
        mean: m, 1/s;  squared: Re d and Im d, 1/s².
    """

    branches: tuple[int, ...]
    oscillate: bool
    mean: Measured
    squared: tuple[Measured, Measured]


def nearest(point: LoopPoint, share: float) -> Nearest | None:
    """Of the slowest motions the two that are nearest to each other.

    None where none are nearer than a share of their rate, or the slower of them is not as slow as the slowest.
    """
    upper = point.upper[:SLOWEST_MOTIONS]
    # What is over after some samples has no logarithm.
    upper = upper[upper != 0]
    pairs = [*combinations(range(len(upper)), 2), *((k, k) for k in np.flatnonzero(upper.imag > 0).tolist())]
    rates, found = -np.log(np.abs(upper)), list[tuple[float, tuple[int, int]]]()

    def two(k: int, other: int) -> tuple[complex, complex]:
        one = complex(upper[k])
        return one, one.conjugate() if k == other else complex(upper[other])

    for pair in pairs:
        one, other = two(*pair)
        mixed = (one.imag == 0) != (other.imag == 0)
        apart = abs(one - other) / max(abs(one + other), np.finfo(float).tiny)
        slow = min(rates[list(pair)]) <= rates[0] + share * abs(rates[0])
        if slow and not mixed and apart <= share * abs(rates[pair[0]]):
            found.append((apart, pair))
    if not found:
        return None
    _, pair = min(found)
    met = meeting(balance(point.smooth.matrix), *two(*pair))
    if met is None:
        return None
    squared = [(met.squared.real, met.by_squared.real), (met.squared.imag, met.by_squared.imag)]
    real, imaginary = (_per_second(point, x, by, 2) for x, by in squared)
    oscillate = pair[0] != pair[1] and bool(upper[pair[0]].imag > 0)
    return Nearest(pair, oscillate, _per_second(point, met.mean, met.by_mean, 1), (real, imaginary))


def _per_second(point: LoopPoint, logarithm: float, by_matrix: Vector, power: int) -> Measured:
    unit = (-1 / point.period) ** power
    return Measured(unit * logarithm, point.smooth.slopes(unit * by_matrix))
