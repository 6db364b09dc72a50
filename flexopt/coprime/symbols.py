"""Normalized graph symbols of a plant, and the maps that leave margins and gaps unchanged.

In: a plant. Out: [N; M] with P = N M⁻¹ and N*N + M*M = I, [M̃, −Ñ] with P = M̃⁻¹Ñ, all stable; the bilinear transform;
rotations of the graph.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexopt.coprime.margin import RiccatiPair, solve_pairs
from flexopt.coprime.scaling import Scaled
from flexopt.coprime.system import Matrix, StateSpace


@dataclass(frozen=True, eq=False)
class Symbols:
    """Graph symbols in continuous time; sampled plants come through the bilinear transform.

    Attributes:
        right: G = [N; M] ((p + m) × m), inner: G*G = I.
        left: G̃ = [M̃, −Ñ] (p × (p + m)), co-inner, with G̃ G = 0.
        epsilon: the plant's ε_max.
    """

    right: StateSpace
    left: StateSpace
    epsilon: float


def graph_symbols(scaled: Scaled, call: str) -> Symbols:
    """Both symbols of a scaled plant, from the better of its Riccati pairs.

    Source: Vidyasagar, IEEE Transactions on Automatic Control 33(1), 1988 (continuous); Bongers and Bosgra, 1990
    (discrete).
    """
    pair = solve_pairs(scaled, call)[0]
    right, left = right_symbol(scaled.system, pair), left_symbol(scaled.system, pair)
    if scaled.system.discrete:
        right, left = to_continuous(right), to_continuous(left)
    return Symbols(right, left, pair.epsilon)


def right_symbol(s: StateSpace, pair: RiccatiPair) -> StateSpace:
    """[N; M] = (A + BF, B S^(−1/2), [C + DF; F], [D; I] S^(−1/2)), F = −S⁻¹(DᵀC + BᵀX[A]), S = I + DᵀD [+ BᵀXB]."""
    A, B, C, D = s.A, s.B, s.C, s.D
    S = np.eye(D.shape[1]) + D.T @ D + (B.T @ pair.X @ B if s.discrete else 0.0)
    F = -np.linalg.solve(S, D.T @ C + B.T @ pair.X @ (A if s.discrete else np.eye(s.n_states)))
    root = inverse_root(S)
    return StateSpace(A + B @ F, B @ root, np.vstack([C + D @ F, F]), np.vstack([D, np.eye(D.shape[1])]) @ root, s.dt)


def left_symbol(s: StateSpace, pair: RiccatiPair) -> StateSpace:
    """[M̃, −Ñ] = (A + LC, [L, −(B + LD)], R^(−1/2)C, R^(−1/2)[I, −D]), L = −(BDᵀ + [A]ZCᵀ)R⁻¹, R = I + DDᵀ [+ CZCᵀ]."""
    A, B, C, D = s.A, s.B, s.C, s.D
    R = np.eye(D.shape[0]) + D @ D.T + (C @ pair.Z @ C.T if s.discrete else 0.0)
    L = -np.linalg.solve(R, (B @ D.T + (A if s.discrete else np.eye(s.n_states)) @ pair.Z @ C.T).T).T
    root = inverse_root(R)
    return StateSpace(
        A + L @ C, np.hstack([L, -(B + L @ D)]), root @ C, root @ np.hstack([np.eye(D.shape[0]), -D]), s.dt
    )


def inverse_root(S: Matrix) -> Matrix:
    """S^(−1/2) of a symmetric positive definite S."""
    values, vectors = np.linalg.eigh((S + S.T) / 2)
    return (vectors / np.sqrt(values)) @ vectors.T


def to_continuous(s: StateSpace) -> StateSpace:
    """Continuous system whose response at s is the sampled one's at z = (1 + s)/(1 − s); no pole may be z = −1."""
    eye, root2 = np.eye(s.n_states), np.sqrt(2.0)
    shifted = s.A + eye
    AB = np.linalg.solve(shifted, np.hstack([s.A - eye, root2 * s.B]))
    A, B = AB[:, : s.n_states], AB[:, s.n_states :]
    return StateSpace(A, B, root2 * np.linalg.solve(shifted.T, s.C.T).T, s.D - s.C @ B / root2, 0.0)


def to_discrete(s: StateSpace, dt: float) -> StateSpace:
    """Inverse of `to_continuous`: the sampled system whose response at z is the continuous one's at (z − 1)/(z + 1)."""
    eye, root2 = np.eye(s.n_states), np.sqrt(2.0)
    shifted = eye - s.A
    AB = np.linalg.solve(shifted, np.hstack([s.A + eye, root2 * s.B]))
    A, B = AB[:, : s.n_states], AB[:, s.n_states :]
    return StateSpace(A, B, root2 * np.linalg.solve(shifted.T, s.C.T).T, s.D + s.C @ B / root2, dt)


def rotation(p: int, m: int, angle: float) -> Matrix:
    """Orthogonal (p + m, p + m) matrix that turns the plant's graph in every channel by `angle`, rad.

    b_{P,K} and the gaps do not change when every graph is turned by the same orthogonal matrix (Qiu and Davison, 1992),
    but poles do: the way round a pole at z = −1.
    """
    k = min(p, m)
    seeded = np.random.default_rng(1)
    U = np.linalg.qr(seeded.normal(size=(p, p)))[0][:, :k]
    V = np.linalg.qr(seeded.normal(size=(m, m)))[0][:, :k]
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.block(
        [
            [np.eye(p) + (cosine - 1) * U @ U.T, sine * U @ V.T],
            [-sine * V @ U.T, np.eye(m) + (cosine - 1) * V @ V.T],
        ]
    )


def turn_plant(P: StateSpace, Q: Matrix) -> StateSpace:
    """P′ whose graph is Q times the graph {(P u, u)} of P."""
    C = Q @ np.vstack([P.C, np.zeros((P.n_inputs, P.n_states))])
    D = Q @ np.vstack([P.D, np.eye(P.n_inputs)])
    p = P.n_outputs
    return _quotient(P.A, P.B, (C[:p], D[:p]), (C[p:], D[p:]), P.dt)


def turn_controller(K: StateSpace, Q: Matrix) -> StateSpace:
    """K′ (negative feedback) whose graph is Q times the graph {(y, −K y)} of K."""
    p = K.n_inputs
    C = Q @ np.vstack([np.zeros((p, K.n_states)), -K.C])
    D = Q @ np.vstack([np.eye(p), -K.D])
    return _quotient(K.A, K.B, (-C[p:], -D[p:]), (C[:p], D[:p]), K.dt)


def _quotient(A: Matrix, B: Matrix, over: tuple[Matrix, Matrix], under: tuple[Matrix, Matrix], dt: float) -> StateSpace:
    """(C₁, D₁)(C₂, D₂)⁻¹ of two systems that share A and B."""
    (C1, D1), (C2, D2) = over, under
    BC = np.linalg.solve(D2.T, np.vstack([B, D1]).T).T
    n = A.shape[0]
    return StateSpace(A - BC[:n] @ C2, BC[:n], C1 - BC[n:] @ C2, BC[n:], dt)
