"""A pair of dual Riccati equations, the largest eigenvalues of their solutions' product, and Lyapunov equations.

Fixed numbers of steps and no branches, so that the Functions generate to C without malloc. One doubling is one
Function, called in a loop.
"""

from __future__ import annotations

import math
from functools import lru_cache

import casadi as ca

from flexopt.algebra.dense import solve_general
from flexopt.algebra.eigen import symmetric_eigen

# Doublings square the convergence factor; 22 of them reach 1e-13 where the slowest closed-loop pole lies 1e-5 from the
# axis, relative to the scaled time.
DOUBLINGS = 22
# The power 2⁸ of X Z leaves of the third eigenvalue, at 0.9 of the first, 2e-12.
SQUARINGS = 8
GAMMA = 3.0


@lru_cache(maxsize=8)
def riccati_pair(size: int, doublings: int = DOUBLINGS) -> ca.Function:
    """(A, G, H) -> X, Z, rest: stabilising solutions of AᵀX + XA − XGX + H = 0 and AZ + ZAᵀ − ZHZ + G = 0.

    Structure-preserving doubling (Chu, Fan, Lin and Wang, 2004) from a Cayley transform with γ = 3, which suits
    matrices scaled to order one. `rest` is the largest element of the last A_k, zero where the iteration has converged.
    """
    step = _doubling(size)
    a, g, h = (ca.MX.sym(name, size, size) for name in ("A", "G", "H"))
    state = _cayley(size).call([a, g, h])
    for _ in range(doublings):
        state = step.call(state)
    rest = ca.norm_inf(ca.vec(state[0]))
    return ca.Function("riccati_pair", [a, g, h], [state[2], state[1], rest], ["A", "G", "H"], ["X", "Z", "rest"])


@lru_cache(maxsize=8)
def lyapunov(size: int) -> ca.Function:
    """(A, Q) -> P of A P + P Aᵀ = −Q for a stable A and symmetric Q, by Smith's doubling from the same transform."""
    step = _smith(size)
    a, q = ca.MX.sym("A", size, size), ca.MX.sym("Q", size, size)
    state = _smith_start(size).call([a, q])
    for _ in range(DOUBLINGS):
        state = step.call(state)
    return ca.Function("lyapunov", [a, q], [state[1]], ["A", "Q"], ["P"])


@lru_cache(maxsize=8)
def top_eigenpairs(size: int) -> ca.Function:
    """(X, Z) -> the two largest eigenvalues of X Z, descending (2, 1), and their vectors R (size, 2), Rᵀ Z R = I.

    X Z is self-adjoint in the inner product of Z, so the left eigenvectors are Z R. Two vectors, by powers of X Z and
    of its deflation, then the exact 2 × 2 problem in their span: right also where the two nearly coincide, which one
    vector alone is not.
    """
    x, z = ca.MX.sym("X", size, size), ca.MX.sym("Z", size, size)
    power, first_step, second_step = _high_power(size), _first_vector(size), _second_vector(size)
    product, first = first_step.call([x, z, *power.call([x @ z])])
    deflation = ca.MX.eye(size) - first @ (z @ first).T
    second = power.call([deflation @ product @ deflation])
    values, vectors = second_step.call([z, product, first, *second])
    return ca.Function("top_eigenpairs", [x, z], [values, vectors], ["X", "Z"], ["values", "R"])


@lru_cache(maxsize=8)
def _high_power(size: int) -> ca.Function:
    """S -> a multiple of S^(2^SQUARINGS)."""
    s = ca.SX.sym("S", size, size)
    product = s @ s
    square = ca.Function("square", [s], [product / ca.trace(product)])
    matrix = ca.MX.sym("S", size, size)
    power = matrix / ca.trace(matrix)
    for _ in range(SQUARINGS):
        power = square(power)
    return ca.Function("high_power", [matrix], [power])


def _first_vector(size: int) -> ca.Function:
    """(X, Z, power of X Z) -> X Z and its first vector."""
    x, z, power = (ca.SX.sym(name, size, size) for name in ("X", "Z", "power"))
    return ca.Function("first_vector", [x, z, power], [x @ z, _normalised(power @ _generic(size, 0), z)])


def _second_vector(size: int) -> ca.Function:
    """(Z, X Z, first vector, power of the deflated X Z) -> both eigenvalues and vectors."""
    z, product, power = (ca.SX.sym(name, size, size) for name in ("Z", "XZ", "power"))
    first = ca.SX.sym("first", size)
    second = power @ _generic(size, 1)
    second = _normalised(second - first @ ((z @ first).T @ second), z)
    basis = ca.horzcat(first, second)
    inner = (z @ basis).T @ (product @ basis)
    values, turn = symmetric_eigen((inner + inner.T) / 2)
    vectors = basis @ turn
    outputs = [ca.vertcat(values[1], values[0]), ca.horzcat(vectors[:, 1], vectors[:, 0])]
    return ca.Function("second_vector", [z, product, first, power], outputs)


def _doubling(size: int) -> ca.Function:
    """One doubling of (A, G, H)."""
    a, g, h = (ca.SX.sym(name, size, size) for name in ("A", "G", "H"))
    solved = solve_general(ca.SX.eye(size) + g @ h, ca.horzcat(a, g))
    wa, wg = solved[:, :size], solved[:, size:]
    # Averaging both triangles, rather than computing one, keeps two digits more on badly conditioned plants.
    outputs = [a @ wa, _symmetric(g + a @ wg @ a.T), _symmetric(h + a.T @ h @ wa)]
    return ca.Function("doubling", [a, g, h], outputs, ["A", "G", "H"], ["A_next", "G_next", "H_next"])


def _cayley(size: int) -> ca.Function:
    """The discrete triple with the same X and Z as the continuous one."""
    a, g, h = (ca.SX.sym(name, size, size) for name in ("A", "G", "H"))
    identity = ca.SX.eye(size)
    shifted = a - GAMMA * identity
    inverse = solve_general(shifted, identity)
    w = solve_general(shifted.T + h @ inverse @ g, ca.horzcat(identity, h @ inverse))
    start_a = identity + 2 * GAMMA * w[:, :size].T
    start_g = 2 * GAMMA * inverse @ g @ w[:, :size]
    outputs = [start_a, _symmetric(start_g), _symmetric(2 * GAMMA * w[:, size:])]
    return ca.Function("cayley", [a, g, h], outputs, ["A", "G", "H"], ["A_0", "G_0", "H_0"])


def _smith(size: int) -> ca.Function:
    a, p = ca.SX.sym("A", size, size), ca.SX.sym("P", size, size)
    return ca.Function("smith", [a, p], [a @ a, _symmetric(p + a @ p @ a.T)], ["A", "P"], ["A_next", "P_next"])


def _smith_start(size: int) -> ca.Function:
    a, q = ca.SX.sym("A", size, size), ca.SX.sym("Q", size, size)
    identity = ca.SX.eye(size)
    resolvent = solve_general(GAMMA * identity - a, identity)
    outputs = [(GAMMA * identity + a) @ resolvent, _symmetric(2 * GAMMA * resolvent @ q @ resolvent.T)]
    return ca.Function("smith_start", [a, q], outputs, ["A", "Q"], ["A_0", "P_0"])


def _normalised(vector: ca.SX, z: ca.SX) -> ca.SX:
    return vector / ca.sqrt(ca.dot(vector, z @ vector))


def _generic(size: int, k: int) -> ca.DM:
    """A vector with no zeros and no symmetry, so that no eigenvector is missed."""
    return ca.DM([1.0 + 0.4 * math.sin(2.3 * (i + 1) * (k + 1) + 0.7 * k) for i in range(size)])


def _symmetric(matrix: ca.SX) -> ca.SX:
    return (matrix + matrix.T) / 2
