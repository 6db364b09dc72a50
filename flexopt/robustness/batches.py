"""w at many points at once, for maps and scans.

In: `Measures` and arrays of placements and postures, one column a point. Out: arrays in the same order. The compiled
`Measures.quick` computes all points; those whose frequencies nearly meet are computed again by `Measures.w`, and those
that have no measures are marked.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.compiled.economical import Economical
from flexopt.foundation.arrays import Array, MatrixLike
from flexopt.foundation.boundary import array_of, instance, public
from flexopt.plant.singularity import singular_points
from flexopt.robustness.measures import SOLVE_TOLERANCE, Measures
from flexopt.robustness.modes import TRUSTED_GAP


@dataclass(frozen=True)
class BatchedW:
    """Measures at N points. m modes, n joints.

    Attributes:
        w: w_i, (m, N); NaN where there is none.
        w_posture: ∂w_i/∂posture_j, (m, n, N), if asked for; NaN likewise.
        repaired: how many points were computed again.
        singular: where Jv loses rank, (N,), so that `flexopt.evaluate` raises `SingularPosture`, or is no number.
        unheld: where the static deflection did not converge or the springs do not hold the machine, (N,).
    """

    w: Array
    w_posture: Array | None
    repaired: int
    singular: NDArray[np.bool_]
    unheld: NDArray[np.bool_]


@public(
    measures=instance(Measures, "a Measures, from flexopt.build_measures"),
    bases=array_of((), ("n_b",), ("n_b", "N"), finite=False),
    postures=array_of(("n",), ("n", "N"), finite=False),
    sizes=lambda measures: {"n_b": measures.plant.n_base, "n": measures.plant.n_actuated},
)
def evaluate_w(
    measures: Measures, bases: MatrixLike, postures: MatrixLike, *, threads: int = 1, gradient: bool = False
) -> BatchedW:
    """The w_i of `measures` at N points, with the machine's own parameters.

    At a singular posture there is no w, nor under gravity where no equilibrium is found: these points come back as NaN
    and are marked. So does a point that is not finite, and spoils none of the others.

    Args:
        measures: from `flexopt.build_measures`.
        bases: (n_b, N), or (n_b,) for one placement at all points.
        postures: (n, N), or (n,).
        threads: among how many the points are divided; the results do not depend on it.
        gradient: whether ∂w/∂posture is wanted.

    Raises:
        InputError: an argument is not usable, a shape does not fit.

    Example:
        >>> measures = flexopt.build_measures(flexopt.load("excavator"))
        >>> postures = [[0.9929, 0.0448], [-2.6306, -2.0499]]  # a column each
        >>> found = flexopt.evaluate_w(measures, [0.0], postures, gradient=True)
        >>> found.w.shape
        (3, 2)
        >>> found.w[0].round(7)
        array([-2.968e-04, -2.400e-06])
    """
    p = measures.plant.parameter_values.full().ravel()
    return w_at(measures, np.asarray(bases), np.asarray(postures), p, threads=threads, gradient=gradient)


def w_of_few(measures: Measures, bases: Array, postures: Array, p: Array | None = None) -> Array:
    """As `evaluate_w`, w (m, N) alone, at points that are asked for once: compiled where so many are worth it.

    Args:
        measures, bases, postures: as of `evaluate_w`.
        p: parameters (n_par,) or (n_par, N); None: the machine's.
    """
    numbers = measures.plant.parameter_values.full().ravel() if p is None else p
    quick, sound = Economical(measures.quick), Economical(measures.sound)
    for each in (quick, sound):
        each.expect(max(points.shape[-1] for points in (bases, postures, numbers) if points.ndim > 1))
    return w_at(measures, bases, postures, numbers, quick=quick, sound=sound).w


def w_at(
    measures: Measures,
    bases: Array,
    postures: Array,
    p: Array,
    *,
    threads: int = 1,
    gradient: bool = False,
    quick: Callable[..., list[Array]] | None = None,
    sound: Callable[..., list[Array]] | None = None,
) -> BatchedW:
    """As `evaluate_w`, with parameters p (n_par,) or (n_par, N).

    Args:
        quick: in place of `Measures.quick_batch` or the one with the gradient;  sound: of `Measures.sound_batch`.
    """
    quick = quick or (measures.quick_batch_with_gradient if gradient else measures.quick_batch)
    w, gap, *slopes = quick(bases, postures, p, threads=threads)
    n = measures.plant.n_actuated
    # A NaN is not trusted either.
    doubtful = np.flatnonzero(~(gap[0] >= TRUSTED_GAP))
    if doubtful.size:
        points = [_columns(given, w.shape[1])[:, doubtful] for given in (bases, postures, p)]
        points = [ca.DM(part) for part in points]
        w[:, doubtful] = measures.w.call(points)[0].full()
        if gradient:
            flat = measures.w_with_gradient.call(points)[1].full()
            each = flat.reshape(len(w), doubtful.size, n).transpose(2, 0, 1)
            slopes[0][:, doubtful] = each.reshape(len(w) * n, doubtful.size)
    w_posture = slopes[0].reshape(n, *w.shape).transpose(1, 0, 2) if gradient else None
    singular, unheld = unsound(measures, bases, postures, p, threads=threads, sound=sound)
    # Points that fit every input alone are one.
    none = np.flatnonzero(np.broadcast_to(singular | unheld, w.shape[1]))
    w[:, none] = np.nan
    if w_posture is not None:
        w_posture[..., none] = np.nan
    return BatchedW(w, w_posture, int(doubtful.size), singular, unheld)


def unsound(
    measures: Measures,
    bases: Array,
    postures: Array,
    p: Array,
    *,
    threads: int = 1,
    sound: Callable[..., list[Array]] | None = None,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which of N points have no measures: singular ones, and those that nothing holds; see `BatchedW`."""
    *jacobians, left_over, least_pivot = (sound or measures.sound_batch)(bases, postures, p, threads=threads)
    singular = singular_points(measures.plant, measures.control, *jacobians)
    unheld = np.zeros_like(singular)
    if measures.gravity:
        unheld = ~((left_over[0] <= SOLVE_TOLERANCE) & (least_pivot[0] > 0))
    return singular, unheld


def _columns(given: Array, n_points: int) -> Array:
    array = np.asarray(given, dtype=np.float64)
    array = array.reshape(-1, 1) if array.ndim < 2 else array
    return np.broadcast_to(array, (array.shape[0], n_points))
