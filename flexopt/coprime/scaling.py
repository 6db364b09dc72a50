"""Scaling of time and states before any Riccati equation or eigenvalue test.

In: a system whose numbers may be many orders of magnitude apart. Out: an equivalent one near unity, and the way back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flexopt.coprime.system import Matrix, StateSpace

SWEEPS = 60


@dataclass(frozen=True, eq=False)
class Scaled:
    """A system in scaled time t τ and scaled states x = T ξ, T diagonal.

    Attributes:
        system: (T⁻¹AT/τ, T⁻¹B/√τ, CT/√τ, D); τ = 1 in discrete time.
        states: diagonal of T (n,).
        rate: τ, rad/s.
    """

    system: StateSpace
    states: Matrix
    rate: float

    def primal(self, X: Matrix) -> Matrix:
        """X of AᵀX + XA − … in the caller's coordinates: T⁻¹ X T⁻¹."""
        return X / np.outer(self.states, self.states)

    def dual(self, Z: Matrix) -> Matrix:
        """Z of AZ + ZAᵀ − … in the caller's coordinates: T Z T."""
        return Z * np.outer(self.states, self.states)

    def pole(self, value: complex) -> complex:
        """An eigenvalue in the caller's unit."""
        return complex(value) * self.rate


def riccati_matrices(system: StateSpace) -> tuple[Matrix, Matrix, Matrix]:
    """Ã = A − B S⁻¹DᵀC, G = B S⁻¹Bᵀ, H = Cᵀ R⁻¹C, each (n, n), with S = I + DᵀD and R = I + DDᵀ."""
    U, sigma, Vt = np.linalg.svd(system.D)  # S and R keep their unit part beside a huge D
    k, weight = sigma.size, 1.0 / np.hypot(1.0, sigma)
    inputs, outputs = np.ones(Vt.shape[0]), np.ones(U.shape[0])
    inputs[:k] = outputs[:k] = weight
    root_b = system.B @ Vt.T * inputs
    root_c = outputs[:, None] * (U.T @ system.C)
    F = system.A - (root_b[:, :k] * sigma) @ root_c[:k]
    G, H = root_b @ root_b.T, root_c.T @ root_c
    return F, (G + G.T) / 2, (H + H.T) / 2


def hamiltonian(F: Matrix, G: Matrix, H: Matrix) -> Matrix:
    """[[F, −G], [−H, −Fᵀ]] (2n, 2n)."""
    return np.block([[F, -G], [-H, -F.T]])


def scale_for_riccati(system: StateSpace) -> Scaled:
    """Balance the states of (A, B, C), then time by the geometric mean of the Hamiltonian's eigenvalues, twice."""
    scaled = balance(system)
    if system.discrete or system.n_states == 0:
        return scaled
    for _ in range(2):
        values = np.abs(np.linalg.eigvals(hamiltonian(*riccati_matrices(scaled.system))))
        scaled = compose(scaled, typical(values))
    return scaled


def scale_for_norm(system: StateSpace) -> Scaled:
    """Balance the states, with time by the geometric mean of the poles' moduli."""
    scaled = balance(system)
    if system.discrete or system.n_states == 0:
        return scaled
    return compose(scaled, typical(np.abs(scaled.system.poles())))


def typical(moduli: NDArray[np.float64]) -> float:
    """Geometric mean of the moduli that are not negligible, as a power of four; 1 when there is none.

    Its root, by which inputs and outputs are scaled, is a power of two then, so that nothing is rounded.
    """
    finite = moduli[np.isfinite(moduli)]
    kept = finite[finite > 1e-12 * np.max(finite, initial=0.0)]
    kept = kept[kept > 0]
    return float(4.0 ** np.round(np.mean(np.log2(kept)) / 2)) if kept.size else 1.0


def balance(system: StateSpace) -> Scaled:
    """Diagonal state scaling that makes each row of [A B] as large as the column of [A; C] of the same state.

    After Parlett and Reinsch (1969), with inputs and outputs counted in; powers of two, so that nothing is rounded.
    """
    A, B, C = system.A.copy(), system.B.copy(), system.C.copy()
    n = system.n_states
    total = np.ones(n)
    for _ in range(SWEEPS):
        changed = False
        for i in range(n):
            row = max(_norm_without(A[i], i), float(np.linalg.norm(B[i])))
            column = max(_norm_without(A[:, i], i), float(np.linalg.norm(C[:, i])))
            if row == 0.0 or column == 0.0:
                continue
            if not np.isfinite(row + column):
                raise np.linalg.LinAlgError("overflow")
            factor = 2.0 ** round(0.5 * (np.log2(row) - np.log2(column)))
            if factor == 1.0:
                continue
            changed = True
            total[i] *= factor
            A[i] /= factor
            B[i] /= factor
            A[:, i] *= factor
            C[:, i] *= factor
        if not changed:
            break
    return Scaled(StateSpace(A, B, C, system.D, system.dt), total, 1.0)


def _norm_without(vector: Matrix, i: int) -> float:
    off = np.delete(vector, i)
    return float(np.linalg.norm(off)) if off.size else 0.0


def compose(scaled: Scaled, rate: float) -> Scaled:
    """Scale time by `rate`, and balance again."""
    s, root = scaled.system, float(np.sqrt(rate))
    again = balance(StateSpace(s.A / rate, s.B / root, s.C / root, s.D, s.dt))
    return Scaled(again.system, scaled.states * again.states, scaled.rate * rate)
