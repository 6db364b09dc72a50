"""The article's Appendix B in 45 digits: modes of the full problem, their derivatives after Fox and Kapoor, ∂R_i, ∂w_i.

M, K, J, Jv and their derivatives come in as double matrices and are taken as exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np

DIGITS = 45


@dataclass(frozen=True)
class Matrices:
    """M, K, J, Jv at a posture, or their derivatives along one variable."""

    mass: np.ndarray
    stiffness: np.ndarray
    jacobian: np.ndarray
    rigid_jacobian: np.ndarray


@dataclass(frozen=True)
class Derivative:
    """Along one variable: ∂w_i and the Frobenius norm of ∂R_i, vibration modes by frequency."""

    w: np.ndarray
    residue_norm: np.ndarray


class AppendixB:
    """Modes of K φ = ω² M φ, all n_q of them, and what follows from them."""

    def __init__(self, at: Matrices, n_passive: int) -> None:
        with mpmath.workdps(DIGITS):
            self.m = n_passive
            self.at = [_mp(x) for x in (at.mass, at.stiffness, at.jacobian, at.rigid_jacobian)]
            mass, stiffness, _, jv = self.at
            lower = mpmath.cholesky((mass + mass.T) / 2)
            inverse = _inverse_lower(lower)
            scaled = inverse * stiffness * inverse.T
            values, vectors = mpmath.eigsy((scaled + scaled.T) / 2)
            self.phi = inverse.T * vectors  # columns ascending in ω²: rigid modes first
            self.n = mass.rows
            self.values = [values[i] for i in range(self.n)]
            self.rigid = self.n - n_passive
            # Rigid modes are at zero exactly; eigsy leaves 1e-45 of the largest.
            self.values[: self.rigid] = [mpmath.mpf(0)] * self.rigid
            self.gram_inverse = (jv * jv.T) ** -1
            self.pseudo = jv.T * self.gram_inverse

    @property
    def omega_squared(self) -> np.ndarray:
        return np.array([float(v) for v in self.values[self.rigid :]])

    def _factors(self, i: int, control: str) -> tuple[Any, Any]:
        _, _, jacobian, jv = self.at
        phi = self.phi[:, self.rigid + i]
        actuated = phi[self.m :, 0]
        return jacobian * phi, jv * actuated if control == "transpose" else self.pseudo.T * actuated

    def residue(self, i: int, control: str) -> np.ndarray:
        with mpmath.workdps(DIGITS):
            a, b = self._factors(i, control)
            return np.array((a * b.T).tolist(), dtype=float)

    def w(self, i: int, control: str) -> float:
        with mpmath.workdps(DIGITS):
            a, b = self._factors(i, control)
            residue = a * b.T
            return float(mpmath.eigsy(residue + residue.T, eigvals_only=True)[0])

    def differentiate(self, along: Matrices) -> dict[str, Derivative]:
        """For both controllers, the derivative along one variable."""
        with mpmath.workdps(DIGITS):
            _, _, jacobian, jv = self.at
            d_mass, d_stiffness, d_jacobian, d_jv = (
                _mp(x) for x in (along.mass, along.stiffness, along.jacobian, along.rigid_jacobian)
            )
            mass_change = self.phi.T * d_mass * self.phi
            stiffness_change = self.phi.T * d_stiffness * self.phi
            d_gram = d_jv * jv.T + jv * d_jv.T
            d_pseudo = d_jv.T * self.gram_inverse - self.pseudo * d_gram * self.gram_inverse
            out: dict[str, list[tuple[float, float]]] = {"inverse": [], "transpose": []}
            for i in range(self.m):
                k = self.rigid + i
                weights = mpmath.matrix(self.n, 1)
                for j in range(self.n):
                    if j == k:
                        weights[j] = -mass_change[k, k] / 2
                    else:
                        force = stiffness_change[j, k] - self.values[k] * mass_change[j, k]
                        weights[j] = force / (self.values[k] - self.values[j])
                phi, d_phi = self.phi[:, k], self.phi * weights
                actuated, d_actuated = phi[self.m :, 0], d_phi[self.m :, 0]
                a, d_a = jacobian * phi, d_jacobian * phi + jacobian * d_phi
                of = {
                    "transpose": (jv * actuated, d_jv * actuated + jv * d_actuated),
                    "inverse": (self.pseudo.T * actuated, d_pseudo.T * actuated + self.pseudo.T * d_actuated),
                }
                for control, (b, d_b) in of.items():
                    residue, d_residue = a * b.T, d_a * b.T + a * d_b.T
                    _, directions = mpmath.eigsy(residue + residue.T)
                    nu = directions[:, 0]
                    d_w = (nu.T * (d_residue + d_residue.T) * nu)[0]
                    out[control].append((float(d_w), float(mpmath.mnorm(d_residue, "f"))))
            return {c: Derivative(*np.array(rows).T) for c, rows in out.items()}


def _mp(matrix: np.ndarray) -> Any:
    return mpmath.matrix(np.asarray(matrix, dtype=float).tolist())


def _inverse_lower(lower: Any) -> Any:
    n = lower.rows
    inverse = mpmath.matrix(n, n)
    for column in range(n):
        for row in range(column, n):
            total = mpmath.mpf(1 if row == column else 0)
            for k in range(column, row):
                total -= lower[row, k] * inverse[k, column]
            inverse[row, column] = total / lower[row, row]
    return inverse
