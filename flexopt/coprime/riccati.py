"""The pair of Riccati equations of normalized coprime factors, by two independent routes.

In: F, G, H of a scaled plant. Out: X and Z of

    FᵀX + XF − XGX + H = 0  and  FZ + ZFᵀ − ZHZ + G = 0            (continuous)
    X = FᵀX(I + GX)⁻¹F + H  and  Z = FZ(I + HZ)⁻¹Fᵀ + G            (discrete)

by structure-preserving doubling, and by ordered Schur vectors.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from flexopt.coprime.lyapunov import EPS, Lyapunov
from flexopt.coprime.scaling import hamiltonian
from flexopt.coprime.system import Matrix

DOUBLINGS = 60


def doubling(F: Matrix, G: Matrix, H: Matrix, *, discrete: bool) -> tuple[Matrix, Matrix, int] | None:
    """X, Z (n, n) and the number of doublings, or None where they do not converge.

    A_{k+1} = A_k W A_k, G_{k+1} = G_k + A_k W G_k A_kᵀ, H_{k+1} = H_k + A_kᵀ H_k W A_k, W = (I + G_k H_k)⁻¹; H_k → X
    and G_k → Z, quadratically.

    Source: Chu, Fan and Lin, Linear Algebra and its Applications 396, 2005 (continuous); Chu, Fan, Lin and Wang,
    International Journal of Control 77(8), 2004 (discrete).
    """
    try:
        with np.errstate(all="ignore"):
            start = (F, G, H) if discrete else _cayley(F, G, H)
            return None if start is None else _iterate(*start)
    except np.linalg.LinAlgError:
        return None


def _iterate(a: Matrix, g: Matrix, h: Matrix) -> tuple[Matrix, Matrix, int] | None:
    eye = np.eye(a.shape[0])
    for k in range(1, DOUBLINGS + 1):
        wa, wg = np.hsplit(np.linalg.solve(eye + g @ h, np.hstack([a, g])), 2)
        more_g, more_h = a @ wg @ a.T, a.T @ h @ wa
        a, g, h = a @ wa, g + (more_g + more_g.T) / 2, h + (more_h + more_h.T) / 2
        if not (np.all(np.isfinite(g)) and np.all(np.isfinite(h)) and np.all(np.isfinite(a))):
            return None
        if _small(more_g, g) and _small(more_h, h):
            return h, g, k
    return None


def _small(step: Matrix, total: Matrix) -> bool:
    return bool(np.linalg.norm(step) <= EPS * np.linalg.norm(total))


def _cayley(F: Matrix, G: Matrix, H: Matrix) -> tuple[Matrix, Matrix, Matrix] | None:
    """The discrete triple of a continuous one under s → (s + γ)/(s − γ)."""
    values = np.asarray(np.linalg.eigvals(hamiltonian(F, G, H)), dtype=complex)
    gamma = _shift(F, G, H, values)
    eye = np.eye(F.shape[0])
    shifted = F - gamma * eye
    start = shifted.T + H @ np.linalg.solve(shifted, G)
    A = eye + 2 * gamma * np.linalg.inv(start).T
    G0 = 2 * gamma * np.linalg.solve(shifted, np.linalg.solve(start.T, G.T).T)
    H0 = 2 * gamma * np.linalg.solve(start, np.linalg.solve(shifted.T, H.T).T)
    if not (np.all(np.isfinite(A)) and np.all(np.isfinite(G0)) and np.all(np.isfinite(H0))):
        return None
    return A, (G0 + G0.T) / 2, (H0 + H0.T) / 2


def _shift(F: Matrix, G: Matrix, H: Matrix, values: NDArray[np.complexfloating[Any]]) -> float:
    """γ that trades the number of doublings against the conditioning of F − γI and of the start."""
    moduli = np.abs(values)
    kept = moduli[moduli > 1e-10 * np.max(moduli, initial=0.0)]
    low, high = (float(kept.min()), float(kept.max())) if kept.size else (1.0, 1.0)
    stable = values[values.real < 0]
    gammas = np.geomspace(low, 4.0 * high, 13)
    shifted = F - gammas[:, None, None] * np.eye(F.shape[0])
    conditions = np.linalg.cond(shifted)
    usable = conditions <= 1e12
    if not usable.any():
        return high
    gammas, shifted, conditions = gammas[usable], shifted[usable], conditions[usable]
    starts = np.linalg.cond(
        shifted.transpose(0, 2, 1) + H @ np.linalg.solve(shifted, np.broadcast_to(G, shifted.shape))
    )
    rates = np.max(np.abs((stable + gammas[:, None]) / (stable - gammas[:, None])), axis=1, initial=0.0)
    slowness = np.maximum(-np.log(np.clip(rates, 1e-300, 1 - 1e-15)), 1e-15)
    costs = np.log2(1.0 + 36.0 / slowness) + 2.0 * np.log10(conditions) + 2.0 * np.log10(starts)
    return float(gammas[int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))])


def subspace(F: Matrix, G: Matrix, H: Matrix, *, discrete: bool) -> Matrix | None:
    """X from the stable invariant subspace of the Hamiltonian, or of the symplectic pencil; None where there is none.

    Source: Laub, IEEE Transactions on Automatic Control 24(6), 1979; Pappas, Laub and Sandell, ibid. 25(4), 1980.
    """
    import scipy.linalg as sla  # noqa: PLC0415  # slow to import

    n = F.shape[0]
    try:
        with np.errstate(all="ignore"):
            if discrete:
                eye, zero = np.eye(n), np.zeros((n, n))
                left, right = np.block([[F, zero], [-H, eye]]), np.block([[eye, G], [zero, F.T]])
                found = sla.ordqz(left, right, sort="iuc", output="real")
                count, vectors = int(np.sum(np.abs(found[2]) < np.abs(found[3]))), found[5]
            else:
                _, schur_vectors, count = sla.schur(hamiltonian(F, G, H), sort="lhp", output="real")
                vectors = schur_vectors
            if count != n:
                return None
            X = np.linalg.solve(vectors[:n, :n].T, vectors[n:, :n].T).T
    except (np.linalg.LinAlgError, ValueError):
        return None
    return (X + X.T) / 2 if np.all(np.isfinite(X)) else None


def residual(F: Matrix, G: Matrix, H: Matrix, X: Matrix, *, discrete: bool) -> tuple[Matrix, float]:
    """The equation's residual (n, n), and its norm relative to the sum of the terms' norms."""
    if discrete:
        next_x = F.T @ X @ np.linalg.solve(np.eye(F.shape[0]) + G @ X, F)
        terms = [(next_x + next_x.T) / 2, -X, H]
    else:
        XF = X @ F
        terms = [XF + XF.T, -X @ G @ X, H]
    total = cast(Matrix, sum(terms))
    size = float(sum(np.linalg.norm(t) for t in terms))
    return total, float(np.linalg.norm(total)) / size if size > 0 else 0.0


def closed_loop(F: Matrix, G: Matrix, X: Matrix, *, discrete: bool) -> Matrix:
    """F − GX, or (I + GX)⁻¹F in discrete time."""
    return np.linalg.solve(np.eye(F.shape[0]) + G @ X, F) if discrete else F - G @ X


def refine(F: Matrix, G: Matrix, H: Matrix, X: Matrix, *, discrete: bool) -> tuple[Matrix, float]:
    """Newton steps (Kleinman 1968, Hewer 1971) as long as each halves the residual; X and its relative residual."""
    error, relative = residual(F, G, H, X, discrete=discrete)
    best = X
    for _ in range(3):
        try:
            step = lyapunov(closed_loop(F, G, best, discrete=discrete).T, error, discrete=discrete)
            trial = best + (step + step.T) / 2
            error_new, relative_new = residual(F, G, H, trial, discrete=discrete)
        except (np.linalg.LinAlgError, ValueError):
            break
        if not relative_new < 0.5 * relative:
            break
        best, error, relative = trial, error_new, relative_new
    return best, relative


def lyapunov(A: Matrix, Q: Matrix, *, discrete: bool = False) -> Matrix:
    """P of AP + PAᵀ + Q = 0, or P = APAᵀ + Q in discrete time, for a stable A; LinAlgError where it is not."""
    return Lyapunov(A, discrete=discrete).solve(Q, transposed=True) if A.shape[0] else np.zeros((0, 0))


def condition(F: Matrix, G: Matrix, H: Matrix, X: Matrix, *, discrete: bool) -> float:
    """Bound on the relative change of X per relative change of F, G and H.

    The 2-norm of the inverse Lyapunov operator is that of its solution for the identity (after Byers, Linear Algebra
    and its Applications 66, 1985).
    """
    size = float(np.linalg.norm(X, 2)) if X.size else 0.0  # NumPy 1 refuses the norm of an empty matrix
    if size == 0.0:
        return 1.0
    try:
        loop = closed_loop(F, G, X, discrete=discrete)
        inverse = float(np.linalg.norm(lyapunov(loop.T, np.eye(F.shape[0]), discrete=discrete), 2))
    except (np.linalg.LinAlgError, ValueError):
        return float("inf")
    f, g, h = (float(np.linalg.norm(M, 2)) for M in (F, G, H))
    if discrete:
        c = float(np.linalg.norm(loop, 2))
        return inverse * (h + 2 * c * f * size + g * (c * size) ** 2) / size
    return inverse * (h + 2 * f * size + g * size**2) / size
