"""Vibration modes by the reduced problem: m passive coordinates, whatever the length of the arm."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from flexopt.algebra import clusters, perturbed_pencil, solve_spd, symmetric_eigen
from flexopt.plant.plant import OperatingPoint

# Eigenvalues ω² closer than this, relative to their mean, are one cluster: below it the modes themselves, not the sums
# over the cluster, lose the digits that the measures are quoted with.
CLUSTER_TOLERANCE = 1e-6


@dataclass(frozen=True)
class ReducedPencil:
    """K_p φ_p = ω² M̄ φ_p after the actuated coordinates are eliminated.

    The actuated rows of K φ = ω² M φ have no stiffness, so φ_a = −M̂⁻¹ M_ap φ_p and M̄ = M_pp − M_pa M̂⁻¹ M_ap.

    Attributes:
        stiffness, mass: K_p and M̄, (m, m).
        follow: −M̂⁻¹ M_ap, (n, m).
        actuated_mass: M̂ = M_aa, (n, n).
    """

    stiffness: ca.SX
    mass: ca.SX
    follow: ca.SX
    actuated_mass: ca.SX


def reduced_pencil(at: OperatingPoint, n_passive: int) -> ReducedPencil:
    """The pencil of the passive coordinates at an operating point."""
    m = n_passive
    actuated, coupling = at.mass[m:, m:], at.mass[m:, :m]
    follow = -solve_spd(actuated, coupling)
    return ReducedPencil(at.stiffness[:m, :m], at.mass[:m, :m] + coupling.T @ follow, follow, actuated)


def solve_modes(pencil: ReducedPencil) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Squared frequencies (m, 1) ascending, M̄-normalised modes (m, m), and their clusters (m, m). Values only.

    With K_p = L Lᵀ the symmetric S = Lᵀ M̄⁻¹ L has S z = ω² z and φ_p = M̄⁻¹ L z / ω: soft and stiff directions
    side by side leave S graded, and Jacobi's rotations keep its small eigenvalues to full relative accuracy.
    NaN where K_p is not positive definite.
    """
    lower = ca.chol(pencil.stiffness).T
    compliance = solve_spd(pencil.mass, lower)
    symmetric = lower.T @ compliance
    values, z = symmetric_eigen((symmetric + symmetric.T) / 2)
    vectors = compliance @ z / ca.repmat(ca.sqrt(values).T, z.shape[0], 1)
    return values, vectors, clusters(values, CLUSTER_TOLERANCE)


def continue_modes(pencil: ReducedPencil, values: ca.SX, vectors: ca.SX, same: ca.SX) -> tuple[ca.SX, ca.SX]:
    """ω² (m, 1) and φ_p (m, m) as graphs of the pencil, exact to second order about the modes given."""
    return perturbed_pencil(pencil.stiffness, pencil.mass, values, vectors, same)
