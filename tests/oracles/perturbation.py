"""Eigenpairs of a pencil near a known solution as one expression, which CasADi differentiates itself."""

from __future__ import annotations

import casadi as ca

from flexopt.algebra import diagonal


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
    second = (error - apart * error / 2) @ x1 - x1 @ (error - apart * error / 2)
    x = x1 + second * inverse_gap
    return values + ca.diag(error) + ca.diag(second), vectors @ normalise @ (identity + x + x1 @ x1 / 2)
