"""Solves and norms as SX graphs."""

from __future__ import annotations

import casadi as ca

# Keeps derivatives of norms finite at zero; far below the square of any quantity in SI units.
TINY = 1e-300


def solve_spd(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """X with A X = B, for a symmetric positive definite A (n, n) and B (n, k), by Cholesky's factors."""
    upper = ca.chol(matrix)
    return ca.solve(upper, ca.solve(upper.T, right))


def apply_pseudo_inverse(jacobian: ca.SX, right: ca.SX) -> ca.SX:
    """J⁺ B for J (r, n) of full row rank, r ≤ n: Moore–Penrose, the plain inverse where J is square.

    From Jᵀ = Q U it is J⁺ = Q U⁻ᵀ, whose error grows with cond J and not with its square.
    """
    q, upper = ca.qr(jacobian.T)
    return q @ ca.solve(upper.T, right)


def apply_pseudo_inverse_transposed(jacobian: ca.SX, right: ca.SX) -> ca.SX:
    """(J⁺)ᵀ B for J (r, n) of full row rank."""
    q, upper = ca.qr(jacobian.T)
    return ca.solve(upper, q.T @ right)


def safe_norm(vector: ca.SX) -> ca.SX:
    """Euclidean norm whose derivatives are finite at zero."""
    return ca.sqrt(ca.dot(vector, vector) + TINY)


def diagonal(vector: ca.SX) -> ca.SX:
    """Dense square matrix with `vector` on its diagonal."""
    return ca.densify(ca.diag(vector))
