"""Solves and norms as SX graphs."""

from __future__ import annotations

from itertools import combinations

import casadi as ca

# Keeps derivatives of norms finite at zero; far below the square of any quantity in SI units.
TINY = 1e-300
# What rounding leaves of a distance, of the coordinates.
SAME = 1e-12


def solve_spd(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """X with A X = B, for a symmetric positive definite A (n, n) and B (n, k), by Cholesky's factors."""
    upper = ca.chol(matrix)
    return ca.solve(upper, ca.solve(upper.T, right))


def solve_general(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """X with A X = B for a square A whose leading minors do not vanish, by elimination without pivoting.

    Meant for matrices like I + G H with positive semidefinite G and H and their shifts; the callers check residuals.
    """
    rows, columns = matrix.shape[0], right.shape[1]
    work = ca.densify(ca.horzcat(matrix, right))
    for _ in range(rows):
        # One Gauss–Jordan step on the first row and column, which then leave: the pivot row goes to the bottom.
        pivot = work[0, 1:] / work[0, 0]
        work = ca.vertcat(work[1:, 1:] - work[1:, 0] @ pivot, pivot)
    assert work.shape == (rows, columns)
    return work


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


def apply_damped_inverse(jacobian: ca.SX, damping: ca.SX, right: ca.SX) -> ca.SX:
    """Jᵀ (J Jᵀ + λ² I)⁻¹ B for J (r, n) of any rank and λ > 0.

    From [Jᵀ; λ I] = Q U it is Q_J U⁻ᵀ, Q_J the first n rows of Q: J Jᵀ is not formed.
    """
    q, upper = _damped_factors(jacobian, damping)
    return q @ ca.solve(upper.T, right)


def apply_damped_inverse_transposed(jacobian: ca.SX, damping: ca.SX, right: ca.SX) -> ca.SX:
    """(J Jᵀ + λ² I)⁻¹ J B for J (r, n) of any rank and λ > 0."""
    q, upper = _damped_factors(jacobian, damping)
    return ca.solve(upper, q.T @ right)


def _damped_factors(jacobian: ca.SX, damping: ca.SX) -> tuple[ca.SX, ca.SX]:
    r, n = jacobian.shape
    q, upper = ca.qr(ca.vertcat(jacobian.T, damping * ca.SX.eye(r)))
    return q[:n, :], upper


def safe_norm(vector: ca.SX) -> ca.SX:
    """Euclidean norm whose derivatives are finite at zero."""
    return ca.sqrt(ca.dot(vector, vector) + TINY)


def same_distance(one: ca.SX, other: ca.SX, size: ca.SX) -> ca.SX:
    """Whether two distances are one, but for the rounding of the coordinates, up to `size`, that they are made of."""
    return ca.fabs(one - other) <= SAME * size


def diagonal(vector: ca.SX) -> ca.SX:
    """Dense square matrix with `vector` on its diagonal."""
    return ca.densify(ca.diag(vector))


def determinant(matrix: ca.SX) -> ca.SX:
    """Determinant of a small square matrix by minors of its first rows, each made once: no division, 2ⁿ n products."""
    n = matrix.shape[0]
    minors: dict[tuple[int, ...], ca.SX] = {(): ca.SX(1)}
    for row in range(n):
        larger: dict[tuple[int, ...], ca.SX] = {}
        for columns in combinations(range(n), row + 1):
            terms = (
                (-1) ** (row + k) * matrix[row, column] * minors[columns[:k] + columns[k + 1 :]]
                for k, column in enumerate(columns)
            )
            larger[columns] = sum(terms, start=ca.SX(0))
        minors = larger
    return minors[tuple(range(n))]
