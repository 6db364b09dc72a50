"""Symmetric eigenproblems of any size as SX graphs, with derivatives that survive repeated eigenvalues.

The iteration (`symmetric_eigen`) is meant for values only. Derivatives come from `perturbed_pencil`, a second-order
expansion about a solution that is held constant: exact to second order, no iteration to differentiate, and no
division by the gaps inside a cluster of equal eigenvalues.
"""

from __future__ import annotations

import casadi as ca

from flexopt.algebra.dense import TINY, diagonal

ROUNDING = 1.1e-16


def symmetric_eigen(matrix: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Eigenvalues (m, 1), ascending, and eigenvectors (m, m) of a symmetric matrix, by cyclic Jacobi sweeps.

    Jacobi keeps the relative accuracy of small eigenvalues of graded positive definite matrices (Demmel and Veselić,
    1992), which soft and stiff base directions side by side produce. The number of sweeps is fixed, so the graph has
    no branches.
    """
    size = matrix.shape[0]
    a = ca.densify(matrix)
    vectors = ca.densify(ca.SX(ca.DM.eye(size)))
    sweeps = {1: 0, 2: 1, 3: 5, 4: 6}.get(size, 8 + size // 4)
    for _ in range(sweeps):
        for p in range(size - 1):
            for q in range(p + 1, size):
                a, vectors = _rotate(a, vectors, p, q)
    return _sorted(ca.diag(a), vectors)


def _rotate(a: ca.SX, vectors: ca.SX, p: int, q: int) -> tuple[ca.SX, ca.SX]:
    """One Jacobi rotation that zeroes a[p, q]; the smaller of the two angles, so sweeps converge."""
    # Noise below the rounding must not turn a pair of equal eigenvalues: that would refill what is already zero.
    off = ca.if_else(a[p, q] ** 2 <= ROUNDING**2 * ca.fabs(a[p, p] * a[q, q]), 0.0, a[p, q])
    half_gap = (a[q, q] - a[p, p]) / 2
    sign = ca.if_else(half_gap < 0, -1.0, 1.0)
    tangent = sign * off / (ca.fabs(half_gap) + ca.sqrt(half_gap**2 + off**2 + TINY))
    cosine = 1 / ca.sqrt(1 + tangent**2)
    sine = tangent * cosine
    rotated = ca.SX(a)
    rotated[p, p] = a[p, p] - tangent * off
    rotated[q, q] = a[q, q] + tangent * off
    rotated[p, q] = rotated[q, p] = 0
    for k in range(a.shape[0]):
        if k not in (p, q):
            rotated[k, p] = rotated[p, k] = cosine * a[k, p] - sine * a[k, q]
            rotated[k, q] = rotated[q, k] = sine * a[k, p] + cosine * a[k, q]
    turned = ca.SX(vectors)
    turned[:, p] = cosine * vectors[:, p] - sine * vectors[:, q]
    turned[:, q] = sine * vectors[:, p] + cosine * vectors[:, q]
    return rotated, turned


def _sorted(values: ca.SX, vectors: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Ascending order by a bubble of compare-and-swap steps."""
    values, vectors = ca.SX(values), ca.SX(vectors)
    size = values.shape[0]
    for end in range(size - 1, 0, -1):
        for k in range(end):
            swap = values[k + 1] < values[k]
            low, high = values[k], values[k + 1]
            values[k], values[k + 1] = ca.if_else(swap, high, low), ca.if_else(swap, low, high)
            left, right = vectors[:, k], vectors[:, k + 1]
            vectors[:, k], vectors[:, k + 1] = ca.if_else(swap, right, left), ca.if_else(swap, left, right)
    return values, vectors


def clusters(values: ca.SX, tolerance: float) -> ca.SX:
    """(m, m) matrix of ones where two of the ascending, positive `values` belong to one cluster, else zeros.

    Neighbours closer than `tolerance` relative to their mean are of one cluster, and so are their neighbours.
    """
    size = values.shape[0]
    same = ca.SX(ca.DM.ones(size, size))
    for i in range(size):
        linked = ca.SX(1)
        for j in range(i + 1, size):
            close = values[j] - values[j - 1] <= tolerance * (values[j] + values[j - 1]) / 2
            linked = linked * ca.if_else(close, 1.0, 0.0)
            same[i, j] = same[j, i] = linked
    return same


def perturbed_pencil(stiffness: ca.SX, mass: ca.SX, values: ca.SX, vectors: ca.SX, same: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Eigenpairs of K φ = λ M φ near a known solution, exact to second order in the change of K and M.

    With M⁰-normalised vectors Φ⁰ and values λ⁰ held constant, Φ⁰ᵀ M Φ⁰ = I + V is normalised by (I + V)^(−1/2), and
    the rest of Φ⁰ᵀ K Φ⁰ is rotated away by exp(X), X skew and zero inside clusters (quasi-degenerate perturbation
    theory). First derivatives are those of Fox and Kapoor (1968).

    Args:
        stiffness, mass: K and M, (m, m) symmetric.
        values, vectors: λ⁰ (m, 1) ascending and Φ⁰ (m, m).
        same: as from `clusters`. Within a cluster only symmetric functions of the result (sums) are meaningful.

    Returns:
        λ (m, 1) and Φ (m, m).
    """
    size = values.shape[0]
    identity = ca.SX(ca.DM.eye(size))
    v = vectors.T @ mass @ vectors - identity
    normalise = identity - v / 2 + 3.0 / 8.0 * (v @ v)
    error = normalise.T @ (vectors.T @ stiffness @ vectors) @ normalise - diagonal(values)
    apart = 1 - same
    inverse_gap = apart / (ca.repmat(values.T, size, 1) - ca.repmat(values, 1, size) + same)
    x1 = error * inverse_gap
    second = _commutator(error - apart * error / 2, x1)
    x = x1 + second * inverse_gap
    return values + ca.diag(error) + ca.diag(second), vectors @ normalise @ (identity + x + x1 @ x1 / 2)


def _commutator(a: ca.SX, b: ca.SX) -> ca.SX:
    return a @ b - b @ a
