"""Bounds on the solutions of the Riccati equations from what an approximation leaves over.

In: an approximate X̃, its closed loop and its residual. Out: δ and W with X̃ − δW ≤ X ≤ X̃ + δW in the order of
symmetric matrices, and from two such pairs a bound on the error of λmax(XZ).

The stabilizing solution X is the largest of all S with Ric(S) = FᵀS + SF − SGS + H ≥ 0 (the discrete case likewise),
and lies below every S with Ric(S) ≤ 0 whose feedback stabilises: X is the cost of the best feedback, S bounds that of
its own. With A_x = F − GX̃ and A_xᵀW + WA_x ≤ −¾I, W > 0, Ric(X̃ ± δW) = Ric(X̃) ± δ(A_xᵀW + WA_x) − δ²WGW, so that
δ ≥ 2‖Ric(X̃)‖ and δ‖WGW‖ ≤ ¼ give both inequalities; W also proves that F − GX̃ and F − G(X̃ + δW) are stable, so that
the plant can be stabilised. Source: Lancaster and Rodman, Algebraic Riccati Equations, 1995, theorems 9.1.1 and 9.1.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from functools import cached_property

import numpy as np

from flexopt.compiled.extended import Exact, largest, rounded
from flexopt.coprime.decimals import cholesky, unit
from flexopt.coprime.lyapunov import EPS, ExactLyapunov, Lyapunov, NotConverged
from flexopt.coprime.system import Matrix

# Below this a residual is taken for this, so that nothing underflows.
SMALLEST = 1e-200


@dataclass(frozen=True, eq=False)
class Enclosure:
    """δ and W (n, n) of X̃ − δW ≤ X ≤ X̃ + δW."""

    delta: float
    W: Matrix

    @cached_property
    def root(self) -> Matrix:
        """R with RᵀR = W."""
        return factor(self.W)


def enclose(loop: Exact, B: Exact, residual: float, lyapunov: Lyapunov, off: float, *, discrete: bool) -> Enclosure:
    """The bound for a closed loop F − GX̃ (or (I + GX̃)⁻¹F), G = BBᵀ, in decimals, and a bound on ‖Ric(X̃)‖.

    W comes from double precision where that is good enough, else from decimals. In continuous time the loop may be
    `off` (2-norm) from that of `lyapunov`.

    Raises:
        NotConverged: the residual is too large for the plant's conditioning, or the loop is not stable.
    """
    n = loop.shape[0]
    if n == 0:
        return Enclosure(0.0, np.zeros((0, 0)))
    delta = 2 * max(residual, SMALLEST)
    if not np.isfinite(delta):
        raise NotConverged("the residual is not finite")
    W = lyapunov.solve(np.eye(n))
    plain, root = rounded(loop) if discrete or off == 0.0 else lyapunov.A, rounded(B)
    size, rounding = float(np.linalg.norm(plain)), 8 * (n + 4) * EPS
    if discrete:
        defect, rounding = plain.T @ W @ plain - W + np.eye(n), rounding * (size**2 + 1) * float(np.linalg.norm(W))
    else:
        defect, rounding = plain.T @ W + W @ plain + np.eye(n), 2 * (rounding * size + off) * float(np.linalg.norm(W))
    bent = root.T @ W @ (plain if discrete else np.eye(n))
    curved = delta * float(np.linalg.norm(bent)) ** 2 * (2 if discrete else 1)
    positive = np.linalg.eigvalsh(W)[0] > n * EPS * float(np.linalg.norm(W))
    if not (positive and float(np.linalg.norm(defect)) + rounding <= 0.25):
        return _enclose_in_decimals(loop, B, delta, discrete=discrete)
    if not curved <= 0.25:
        raise NotConverged("the residual is too large for a bound")
    return Enclosure(delta, W)


def _enclose_in_decimals(loop: Exact, B: Exact, delta: float, *, discrete: bool) -> Enclosure:
    n = loop.shape[0]
    W = ExactLyapunov(loop, discrete=discrete).correct(unit(n))
    cholesky(W)
    defect = loop.T @ W @ loop - W + unit(n) if discrete else loop.T @ W + W @ loop + unit(n)
    bent = B.T @ W @ (loop if discrete else unit(n))
    curved = delta * n * largest(bent) ** 2 * bent.shape[0] * (2 if discrete else 1)
    if not (largest(defect) * n <= 0.25 and curved <= 0.25):
        raise NotConverged("the residual is too large for a bound")
    return Enclosure(delta, rounded(W + unit(n) * Decimal(largest(W) * EPS)))


def eigenvalue_bound(factor_x: Matrix, factor_z: Matrix, of_x: Enclosure, of_z: Enclosure) -> float:
    """Bound on |λmax(XZ) − λmax(X̃Z̃)|, X̃ and Z̃ by their factors.

    λmax of a product of positive semidefinite matrices grows with either, so that

    λmax((X̃ + δW)(Z̃ + δ'W')) ≤ λmax(X̃Z̃) + δ' λmax(X̃W') + δ λmax(WZ̃) + δδ' λmax(WW'), and the same from below.
    """
    first = of_z.delta * _top(factor_x, of_z.root) + of_x.delta * _top(of_x.root, factor_z)
    return 1.01 * (first + of_x.delta * of_z.delta * _top(of_x.root, of_z.root))


def _top(first: Matrix, second: Matrix) -> float:
    """λmax of the product of two positive semidefinite matrices, given by their factors."""
    return float(np.linalg.norm(first @ second.T, 2)) ** 2 if first.size else 0.0


def factor(X: Matrix) -> Matrix:
    """R (n, n) with RᵀR = X for a positive semidefinite X."""
    values, vectors = np.linalg.eigh(X)
    return np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
