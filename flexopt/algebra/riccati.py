"""A pair of dual Riccati equations, the largest eigenvalues of their solutions' product, and Lyapunov equations.

Fixed numbers of steps, so that the Functions generate to C without malloc; steps that would change nothing are left
out, unless `fixed` asks for a course that no number decides. Everything is built from two kernels, a product and an
inverse, called again and again: in C their code stays in the instruction cache, where one doubling written out has
17,000 instructions and takes several times as long. For CasADi's virtual machine it is the other way round, so there
one step is written out (`compact=False`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import TypeVar

import casadi as ca

from flexopt.algebra.dense import solve_general
from flexopt.algebra.eigen import symmetric_eigen
from flexopt.foundation.kernels import DENSE_PRODUCT, SYMMETRIC_SUM

Graph = TypeVar("Graph", ca.SX, ca.MX)
# Doublings square the convergence factor; 22 of them reach 1e-13 where the slowest closed-loop pole lies 1e-5 from the
# axis, relative to the scaled time.
DOUBLINGS = 22
# Where no element of A_k is larger, another doubling would change the results by its square, far below rounding.
# Plants whose base swings take more doublings than the first few, before which nobody looks.
SETTLED, AT_LEAST = 1e-11, 8
# The power 2⁸ of X Z leaves of the third eigenvalue, at 0.9 of the first, 2e-12.
SQUARINGS = 8
GAMMA = 3.0
# Products of larger matrices than this are loops, and their inverses are made of smaller ones: written out, they would
# not fit into an instruction cache.
WRITTEN_OUT = 12


@lru_cache(maxsize=8)
def riccati_pair(size: int, *, compact: bool = False, fixed: bool = False) -> ca.Function:
    """(A, G, H) -> X, Z, rest: stabilising solutions of AᵀX + XA − XGX + H = 0 and AZ + ZAᵀ − ZHZ + G = 0.

    Structure-preserving doubling (Chu, Fan, Lin and Wang, 2004) from a Cayley transform with γ = 3, which suits
    matrices scaled to order one. `rest` is the largest element of the last A_k, at most `SETTLED` where the iteration
    has converged.
    """
    step = _doubling(size) if compact else _doubling(size).expand()
    a, g, h = (ca.MX.sym(name, size, size) for name in ("A", "G", "H"))
    state = _repeated(step, _cayley(size).call([a, g, h]), DOUBLINGS, fixed=fixed)
    rest = ca.norm_inf(ca.vec(state[0]))
    return ca.Function("riccati_pair", [a, g, h], [state[2], state[1], rest], ["A", "G", "H"], ["X", "Z", "rest"])


@lru_cache(maxsize=8)
def lyapunov(size: int, doublings: int = DOUBLINGS, *, compact: bool = False, fixed: bool = False) -> ca.Function:
    """(A, Q) -> P of A P + P Aᵀ = −Q for a stable A and symmetric Q, by Smith's doubling from the same transform.

    Few doublings leave out what is slower than 2^−doublings of the scaled time.
    """
    step, product = _smith(size) if compact else _smith(size).expand(), _product(size)
    a, q = ca.MX.sym("A", size, size), ca.MX.sym("Q", size, size)
    resolvent = _inverse(size)(GAMMA * ca.MX.eye(size) - a)
    start = _symmetric(2 * GAMMA * product(product(resolvent, q), resolvent.T))
    state = _repeated(step, [product(GAMMA * ca.MX.eye(size) + a, resolvent), start], doublings, fixed=fixed)
    return ca.Function("lyapunov", [a, q], [state[1]], ["A", "Q"], ["P"])


@lru_cache(maxsize=8)
def top_eigenpairs(size: int, clustered: int = 2, *, compact: bool = False) -> ca.Function:
    """(X, Z) -> the two largest eigenvalues of X Z, descending (2, 1), and their vectors R (size, 2), Rᵀ Z R = I.

    X Z is self-adjoint in the inner product of Z, so the left eigenvectors are Z R. As many vectors as eigenvalues may
    nearly coincide at the top, by powers of X Z and of its deflations, then the exact small problem in their span:
    right also where they do coincide, which one vector after the other is not. `rest` is |X Z r − λ r| / λ of the
    first, in the norm of Z; λ is wrong by its square.

    Args:
        size: of X and Z.
        clustered: how many of the largest eigenvalues may lie within a tenth of each other; of a plant whose rigid part
            rules, one for each output.
        compact: whether it is for many points: powers are scaled twice, not at each squaring.
    """
    x, z = ca.MX.sym("X", size, size), ca.MX.sym("Z", size, size)
    power, times, count = _high_power(size, 4 if compact else 1), _product(size), max(2, clustered)
    product = times(x, z)
    deflated, vectors = product, list[ca.MX]()
    for k in range(count):
        raw = power(deflated) @ _generic(size, k)
        if k == count - 1:
            vectors.append(raw)
            break
        vector = _normalised(_across(raw, vectors, z), z)
        # The projection I − r (Z r)ᵀ before and after X Z leaves everything but the eigenvectors found.
        image, dual = deflated @ vector, z @ vector
        deflated = deflated - image @ dual.T
        deflated = deflated - vector @ (dual.T @ deflated)
        vectors.append(vector)
    values, top, rest = _within(size, count).call([z, product, *vectors])
    return ca.Function("top_eigenpairs", [x, z], [values, top, rest], ["X", "Z"], ["values", "R", "rest"])


@lru_cache(maxsize=8)
def _product(size: int) -> ca.Function:
    """(A, B) -> A B; of large matrices as a loop."""
    if size > WRITTEN_OUT:
        matrices = [ca.MX.sym("A", size, size), ca.MX.sym("B", size, size)]
        return ca.Function(DENSE_PRODUCT, matrices, [matrices[0] @ matrices[1]])
    a, b = ca.SX.sym("A", size, size), ca.SX.sym("B", size, size)
    return ca.Function(DENSE_PRODUCT, [a, b], [a @ b])


@lru_cache(maxsize=8)
def _symmetric_sum(size: int) -> ca.Function:
    """(A, B) -> (S + Sᵀ) / 2 of S = A + B."""
    a, b = ca.MX.sym("A", size, size), ca.MX.sym("B", size, size)
    return ca.Function(SYMMETRIC_SUM, [a, b], [_symmetric(a + b)])


@lru_cache(maxsize=8)
def _inverse(size: int) -> ca.Function:
    """A -> A⁻¹; of large matrices by blocks, from inverses of half the size."""
    if size > WRITTEN_OUT:
        matrix, k = ca.MX.sym("A", size, size), size // 2
        corner = _inverse(k)(matrix[:k, :k])
        left, right = matrix[k:, :k] @ corner, corner @ matrix[:k, k:]
        schur = _inverse(size - k)(matrix[k:, k:] - left @ matrix[:k, k:])
        below = -schur @ left
        blocks = ca.vertcat(ca.horzcat(corner - right @ below, -right @ schur), ca.horzcat(below, schur))
        return ca.Function("inverse", [matrix], [blocks])
    a = ca.SX.sym("A", size, size)
    return ca.Function("inverse", [a], [solve_general(a, ca.SX.eye(size))])


@lru_cache(maxsize=8)
def _high_power(size: int, apart: int) -> ca.Function:
    """S -> a multiple of S^(2^SQUARINGS), scaled after each so many squarings."""
    s = ca.MX.sym("S", size, size)
    power = s / ca.trace(s)
    for k in range(1, SQUARINGS + 1):
        power = _product(size)(power, power)
        if k % apart == 0:
            power = power / ca.trace(power)
    return ca.Function("high_power", [s], [power])


def _within(size: int, count: int) -> ca.Function:
    """(Z, X Z, orthonormal vectors, a raw last one) -> the two largest eigenvalues in their span, vectors, and rest."""
    z, product = ca.SX.sym("Z", size, size), ca.SX.sym("XZ", size, size)
    vectors = [ca.SX.sym(f"vector{k}", size) for k in range(count)]
    across = _across(vectors[-1], vectors[:-1], z)
    basis = ca.horzcat(*vectors[:-1], across / ca.sqrt(ca.dot(across, z @ across)))
    inner = (z @ basis).T @ (product @ basis)
    values, turn = symmetric_eigen((inner + inner.T) / 2)
    turned = basis @ turn
    first = turned[:, -1]
    left = product @ first - values[-1] * first
    rest = ca.sqrt(ca.fmax(ca.dot(left, z @ left), 0)) / values[-1]
    outputs = [ca.vertcat(values[-1], values[-2]), ca.horzcat(first, turned[:, -2]), rest]
    return ca.Function("within", [z, product, *vectors], outputs)


def _across(vector: Graph, vectors: Sequence[Graph], z: Graph) -> Graph:
    """What is left of a vector without its components along orthonormal ones, in the inner product of Z."""
    for other in vectors:
        vector = vector - other @ ((z @ other).T @ vector)
    return vector


def _doubling(size: int) -> ca.Function:
    """One doubling of (A, G, H), with V = (I + G H)⁻¹."""
    times, symmetric = _product(size), _symmetric_sum(size)
    a, g, h = (ca.MX.sym(name, size, size) for name in ("A", "G", "H"))
    across = a.T
    # The products are summed before 1 is added, beside which each alone would be rounded.
    v = _inverse(size)(ca.MX.eye(size) + times(g, h))
    va = times(v, a)
    # Averaging both triangles, rather than computing one, keeps two digits more on badly conditioned plants.
    next_g = symmetric(g, times(times(a, times(v, g)), across))
    next_h = symmetric(h, times(across, times(h, va)))
    return ca.Function("doubling", [a, g, h], [times(a, va), next_g, next_h])


def _repeated(step: ca.Function, state: list[ca.MX], times: int, *, fixed: bool) -> list[ca.MX]:
    """`step` of the state, whose first part is A_k, so many times, or until A_k has settled."""
    if fixed:
        for _ in range(times):
            state = step.call(state)
        return state
    symbols = [ca.MX.sym(f"s{k}", *step.size_in(k)) for k in range(step.n_in())]
    settled = ca.Function("settled", symbols[:1], [ca.norm_inf(ca.vec(symbols[0])) <= SETTLED])
    as_it_is = ca.Function("as_it_is", symbols, symbols)
    unless_settled = ca.Function.if_else(f"{step.name()}_unless_settled", as_it_is, step)
    for k in range(times):
        state = step.call(state) if k < AT_LEAST else unless_settled.call([*settled.call(state[:1]), *state])
    return state


def _cayley(size: int) -> ca.Function:
    """The discrete triple with the same X and Z as the continuous one."""
    times, inverse = _product(size), _inverse(size)
    a, g, h = (ca.MX.sym(name, size, size) for name in ("A", "G", "H"))
    identity = ca.MX.eye(size)
    shifted = a - GAMMA * identity
    resolvent = inverse(shifted)
    w = inverse(shifted.T + times(h, times(resolvent, g)))
    start_g = 2 * GAMMA * times(resolvent, times(g, w))
    start_h = 2 * GAMMA * times(w, times(h, resolvent))
    outputs = [identity + 2 * GAMMA * w.T, _symmetric(start_g), _symmetric(start_h)]
    return ca.Function("cayley", [a, g, h], outputs)


def _smith(size: int) -> ca.Function:
    times = _product(size)
    a, p = ca.MX.sym("A", size, size), ca.MX.sym("P", size, size)
    return ca.Function("smith", [a, p], [times(a, a), _symmetric(p + times(times(a, p), a.T))])


def _normalised(vector: ca.MX, z: ca.MX) -> ca.MX:
    return vector / ca.sqrt(ca.dot(vector, z @ vector))


def _generic(size: int, k: int) -> ca.DM:
    """A vector with no zeros and no symmetry, so that no eigenvector is missed."""
    return ca.DM([1.0 + 0.4 * math.sin(2.3 * (i + 1) * (k + 1) + 0.7 * k) for i in range(size)])


def _symmetric(matrix: ca.MX) -> ca.MX:
    return (matrix + matrix.T) / 2
