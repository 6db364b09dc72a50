"""How eigenvectors change, to second order, as explicit terms, which divide by no gap inside a cluster.

In: the changes of a pencil in the axes of its eigenvectors. Out: the terms of first and of second degree. Derivatives
of eigenvectors come from here alone; the iterations that find them are for values.
"""

from __future__ import annotations

import casadi as ca

from flexopt.algebra.dense import diagonal


def expanded_vectors(stiffness: ca.SX, mass: ca.SX, values: ca.SX, same: ca.SX) -> tuple[ca.SX, ca.SX]:
    """C_1 and C_2 (m, m) of Φ = Φ⁰ (I + C_1 + C_2), the eigenvectors of K φ = λ M φ near a known solution.

    M⁰-normalised vectors Φ⁰ and values λ⁰ are held; Φ⁰ᵀ M Φ⁰ = I + V is normalised by (I + V)^(−1/2), and the rest of
    Φ⁰ᵀ K Φ⁰ rotated away by exp(X), X skew and zero inside clusters (quasi-degenerate perturbation theory). C_1 is that
    of Fox and Kapoor (1968): (E_ij − λ_j V_ij)/(λ_j − λ_i), and −V_ij/2 inside clusters, E the change of Φ⁰ᵀ K Φ⁰.

    Args:
        stiffness, mass: the changes Φ⁰ᵀ dK Φ⁰ and Φ⁰ᵀ dM Φ⁰, (m, m) symmetric.
        values: λ⁰, (m, 1) ascending.
        same: as from `clusters`. Within a cluster only symmetric functions of the result (sums) are meaningful.
    """
    size = values.shape[0]
    e, v, scale, apart = stiffness, mass, diagonal(values), 1 - same
    inverse_gap = apart / (ca.repmat(values.T, size, 1) - ca.repmat(values, 1, size) + same)
    half, scaled = v / 2, v @ scale
    first = e - (scaled + scaled.T) / 2
    turn = first * inverse_gap
    square, product = v @ v, (first - apart * first / 2) @ turn
    weighted = square @ scale
    second = 3.0 / 8.0 * (weighted + weighted.T) + scaled @ v / 4 + product + product.T
    if e.nnz():
        mixed = v @ e
        second -= (mixed + mixed.T) / 2
    once = (e - scaled) * inverse_gap - same * half
    return once, 3.0 / 8.0 * square + (turn / 2 - half) @ turn + second * inverse_gap
