"""Distances between plants for feedback: the gap and the ν-gap.

In: two plants with the same inputs, outputs and sampling. Out: a number between 0 and 1.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flexopt.coprime import riccati
from flexopt.coprime.guard import guarded
from flexopt.coprime.norms import axis_peak
from flexopt.coprime.scaling import balance, compose, hamiltonian, riccati_matrices, scale_for_norm, typical
from flexopt.coprime.symbols import Symbols, graph_symbols, inverse_root
from flexopt.coprime.system import PAIR, Matrix, StateSpace, SystemLike, system_pair
from flexopt.foundation.boundary import public
from flexopt.foundation.roots import root

RESOLUTION = 1e-10
NEAR = 1e-9
UNSOLVED = 1e-6


@public(checks=PAIR)
@guarded
def gap(P1: SystemLike, P2: SystemLike) -> float:
    """δ_g(P1, P2) = max of the two directed gaps inf_{Q ∈ H∞} ‖G1 − G2 Q‖∞, to 1e-8.

    G_i are the normalized graph symbols. Each directed gap is a two-block Nehari problem: with W = G̃2 G1, it is the
    least γ > ‖W‖∞ for which the antistable part of G2*G1 Φ⁻¹, Φ*Φ = γ²I − W*W, has a Hankel norm of at most 1. The
    search starts from δ_ν ≤ δ_g ≤ δ_ν/ε_max.

    Args:
        P1: plant, anything `state_space` takes.
        P2: plant of the same size and sampling period.

    Raises:
        InputError: a system is not usable, or sizes or sampling periods differ.
        NotStabilizable: a plant is not stabilizable and detectable.
        NoSolutionFound: a Riccati equation has no numerical solution.

    Source: Georgiou, Systems & Control Letters 11, 1988; the bounds: Vinnicombe, IEEE Transactions on Automatic Control
    38(9), 1993.

    Example:
        >>> first, second = ([[-1.0]], [[1.0]], [[1.0]]), ([[-1.1]], [[1.0]], [[1.0]])
        >>> round(flexopt.gap(first, second), 4)
        0.0476
    """
    one, two = _symbol_pair(P1, P2, "gap")
    nu = _nu_gap(one, two)
    bounds = nu, min(1.0, nu / max(one.epsilon, two.epsilon))
    if bounds[0] >= 1.0 - NEAR or bounds[1] - bounds[0] <= NEAR:
        return bounds[0]
    forward = _directed_gap(one, two, bounds)
    return forward if forward >= bounds[1] else max(forward, _directed_gap(two, one, bounds))


@public(checks=PAIR)
@guarded
def nu_gap(P1: SystemLike, P2: SystemLike) -> float:
    """δ_ν(P1, P2) = ‖G̃2 G1‖∞ if det(G2*G1) has no zero on the axis and winding number 0, else 1.

    ‖G̃2 G1‖∞ is the largest chordal distance between the two responses; level sets find it, not a grid, so that no sharp
    resonance is missed. The winding number is counted from the zeros and poles of G2*G1 in the right half-plane.

    Args:
        P1: plant, anything `state_space` takes.
        P2: plant of the same size and sampling period.

    Raises:
        InputError: a system is not usable, or sizes or sampling periods differ.
        NotStabilizable: a plant is not stabilizable and detectable.
        NoSolutionFound: a Riccati equation has no numerical solution.

    Source: Vinnicombe, IEEE Transactions on Automatic Control 38(9), 1993.

    Example:
        >>> first, second = ([[-1.0]], [[1.0]], [[1.0]]), ([[-1.1]], [[1.0]], [[1.0]])
        >>> round(flexopt.nu_gap(first, second), 4)
        0.0476
    """
    return _nu_gap(*_symbol_pair(P1, P2, "nu_gap"))


def _nu_gap(one: Symbols, two: Symbols) -> float:
    """Chordal distance and winding number, as in `nu_gap`."""
    distance = min(1.0, axis_peak(scale_for_norm(_series(one.right, two.left)))[0])
    return distance if distance < 1.0 and _winds_zero(one, two) else 1.0


def _symbol_pair(P1: Any, P2: Any, call: str) -> tuple[Symbols, Symbols]:
    """Graph symbols of both plants, on one time scale, each balanced."""
    first, second = system_pair((P1, P2), ("P1", "P2"), call, feedback=False)
    scaled = [balance(first), balance(second)]
    if not first.discrete:
        values = [np.linalg.eigvals(hamiltonian(*riccati_matrices(s.system))) for s in scaled]
        rate = typical(np.abs(np.concatenate(values)))
        scaled = [compose(s, rate) for s in scaled]
    one, two = (graph_symbols(s, call) for s in scaled)
    return one, two


def _series(G: StateSpace, L: StateSpace) -> StateSpace:
    """L G, the states of G first."""
    n, k = G.n_states, L.n_states
    A = np.block([[G.A, np.zeros((n, k))], [L.B @ G.C, L.A]])
    return StateSpace(A, np.vstack([G.B, L.B @ G.D]), np.hstack([L.D @ G.C, L.C]), L.D @ G.D, 0.0)


def _winds_zero(one: Symbols, two: Symbols) -> bool:
    """Whether det(G2*G1) has as many zeros as poles in the right half-plane, and none at infinity.

    All poles of G2* are there, all of G1 are not; hidden modes count alike among zeros and poles.
    """
    G1, G2 = one.right, two.right
    n1, n2 = G1.n_states, G2.n_states
    D = G2.D.T @ G1.D
    values = np.linalg.svd(D, compute_uv=False)
    if values[-1] <= 1e-14:
        return False
    A = np.block([[G1.A, np.zeros((n1, n2))], [-G2.C.T @ G1.C, -G2.A.T]])
    B = np.vstack([G1.B, -G2.C.T @ G1.D])
    C = np.hstack([G2.D.T @ G1.C, G2.B.T])
    zeros = np.linalg.eigvals(A - B @ np.linalg.solve(D, C))
    return int(np.sum(zeros.real > 0)) == n2


def _directed_gap(one: Symbols, two: Symbols, bounds: tuple[float, float]) -> float:
    """inf_{Q ∈ H∞} ‖G1 − G2 Q‖∞, by a search over γ between the bounds."""

    def excess(gamma: float) -> float:
        # From −1 to 1, where the norm is infinite.
        return 1.0 - 2.0 / (1.0 + _hankel_norm(one.right, two, gamma))

    lowest, highest = bounds
    low, high = max(lowest * (1 + NEAR), NEAR), min(highest * (1 + NEAR), 1.0 - NEAR)
    if low >= high or excess(low) <= 0.0:
        return lowest
    if excess(high) >= 0.0:
        return highest
    found = root(excess, low, high, xtol=RESOLUTION * low, rtol=RESOLUTION)
    unsolved = excess(found * (1 - 4 * RESOLUTION)) == 1.0
    # Where Φ has no numerical solution that close to ‖W‖∞, the answer lies in between: ‖W‖∞ itself, nearly always.
    return lowest if unsolved and found - lowest < UNSOLVED else found


def _hankel_norm(G1: StateSpace, two: Symbols, gamma: float) -> float:
    """Hankel norm of the antistable part of G2*G1 Φ⁻¹, Φ*Φ = γ²I − W*W, W = G̃2 G1; infinite where Φ does not exist."""
    G2 = two.right
    if G2.n_states == 0:
        return 0.0
    A, B, C, D, C1 = _with_first(_series(G1, two.left), G1)
    Cw, Dw = C / gamma, D / gamma
    R = np.eye(D.shape[1]) - Dw.T @ Dw
    if np.linalg.eigvalsh(R)[0] <= 0.0:
        return math.inf
    Y = _bounded_real(A, B, Cw, Dw, R)
    if Y is None:
        return math.inf
    K = np.linalg.solve(R, B.T @ Y + Dw.T @ Cw)
    half = inverse_root(R)
    Av, Bv, Cv, Dv = A + B @ K, B @ half, (C1 + G1.D @ K) / gamma, G1.D @ half / gamma
    cross = _sylvester(G2.A.T, Av, G2.C.T @ Cv)
    enters = cross @ Bv + G2.C.T @ Dv
    reach = riccati.lyapunov(G2.A.T, enters @ enters.T)
    see = riccati.lyapunov(G2.A, G2.B @ G2.B.T)
    return math.sqrt(max(0.0, float(np.max(np.linalg.eigvals(reach @ see).real))))


def _with_first(W: StateSpace, G1: StateSpace) -> tuple[Matrix, Matrix, Matrix, Matrix, Matrix]:
    """A, B, C, D of W in balanced states, and G1's output matrix in the same states."""
    C1 = np.hstack([G1.C, np.zeros((G1.n_outputs, W.n_states - G1.n_states))])
    both = balance(StateSpace(W.A, W.B, np.vstack([W.C, C1]), np.vstack([W.D, G1.D]), 0.0)).system
    return both.A, both.B, both.C[: W.n_outputs], W.D, both.C[W.n_outputs :]


def _bounded_real(A: Matrix, B: Matrix, C: Matrix, D: Matrix, R: Matrix) -> Matrix | None:
    """Stabilizing Y of AᵀY + YA + CᵀC + (YB + CᵀD)R⁻¹(BᵀY + DᵀC) = 0, R = I − DᵀD; None where there is none."""
    if A.shape[0] == 0:
        return np.zeros((0, 0))
    F = A + B @ np.linalg.solve(R, D.T @ C)
    G = -B @ np.linalg.solve(R, B.T)
    H = C.T @ C + C.T @ D @ np.linalg.solve(R, D.T @ C)
    Y = riccati.subspace(F, G, (H + H.T) / 2, discrete=False)
    if Y is None:
        return None
    return riccati.refine(F, G, (H + H.T) / 2, Y, discrete=False)[0]


def _sylvester(A: Matrix, B: Matrix, Q: Matrix) -> Matrix:
    """X of AX + XB + Q = 0."""
    import scipy.linalg as sla  # noqa: PLC0415  # slow to import

    return np.asarray(sla.solve_sylvester(A, B, -Q), dtype=float) if Q.size else np.zeros(Q.shape)
