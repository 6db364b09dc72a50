"""Non-negative least squares for a few unknowns.

Not SciPy's: to import `scipy.optimize` takes 0.24 s, in each process anew, and the excavator's whole selection 0.06 s.

In: a matrix and a right-hand side. Out: the solution. Pure NumPy; knows nothing of selections.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector


def nonnegative_least_squares(matrix: Vector, right: Vector) -> Vector:
    """The x ≥ 0 (n,) with the least |A x − b|, A (m, n), b (m,): Lawson and Hanson's active set method, NNLS (1974).

    Columns enter one by one, the one along which the residual falls fastest first; those whose unconstrained
    coefficient is negative leave again. Where columns depend on each other one of the solutions is given.
    """
    n = int(matrix.shape[1])
    lengths: Vector = np.sqrt(np.sum(matrix**2, axis=0))
    lengths[lengths == 0] = 1.0
    matrix = matrix / lengths
    x: Vector = np.zeros(n)
    inside: NDArray[np.bool_] = np.zeros(n, dtype=bool)
    useless: NDArray[np.bool_] = np.zeros(n, dtype=bool)
    tolerance = 10 * max(matrix.shape) * float(np.finfo(float).eps) * float(np.linalg.norm(right))
    for _ in range(10 * n):
        slope: Vector = np.where(inside | useless, -np.inf, matrix.T @ (right - matrix @ x))
        if slope.max(initial=-np.inf) <= tolerance:
            break
        entering = int(np.argmax(slope))
        inside[entering] = True
        wanted = _on(matrix, right, inside)
        if wanted[entering] <= 0:
            # By rounding, where it depends on those inside.
            inside[entering], useless[entering] = False, True
            continue
        useless[:] = False
        while wanted[inside].min(initial=1.0) <= 0:
            # As far towards it as nothing turns negative; what becomes zero leaves.
            falls = np.flatnonzero(inside & (wanted <= 0))
            shares: Vector = x[falls] / np.maximum(x[falls] - wanted[falls], np.finfo(float).tiny)
            x = np.maximum(x + shares.min() * (wanted - x), 0.0)
            leaving = falls[shares <= shares.min()]
            x[leaving], inside[leaving] = 0.0, False
            wanted = _on(matrix, right, inside)
        x = wanted
    return x / lengths


def _on(matrix: Vector, right: Vector, inside: NDArray[np.bool_]) -> Vector:
    """Least squares in the columns that are inside, the other coefficients zero."""
    x: Vector = np.zeros(inside.size)
    x[inside] = np.linalg.lstsq(matrix[:, inside], right, rcond=None)[0]
    return x
