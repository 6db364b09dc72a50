"""Vibration modes by the reduced problem: m passive coordinates, whatever the length of the arm."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca

from flexopt.algebra import (
    called_eigen,
    clusters,
    direct_eigen,
    reciprocal,
    solve_spd,
    symmetric_eigen,
)
from flexopt.plant.plant import OperatingPoint

# Eigenvalues ω² closer than this, relative to their mean, are one cluster: below it the modes themselves, not the sums
# over the cluster, lose the digits that the measures are quoted with.
CLUSTER_TOLERANCE = 1e-6
# Where two ω² come closer than this, relative to their mean, the closed form is left to the iteration.
TRUSTED_GAP = 1e-3
# Up to so many modes everything is written out in one graph; with more, iterations stay calls.
WRITTEN_OUT = 3


@dataclass(frozen=True, eq=False)
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


def solve_modes(stiffness: ca.SX, mass: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Squared frequencies (m, 1) ascending, M̄-normalised modes (m, m), and their clusters (m, m). Values only.

    With K_p = L Lᵀ the symmetric S = Lᵀ M̄⁻¹ L has S z = ω² z and φ_p = M̄⁻¹ L z / ω: soft and stiff directions
    side by side leave S graded, and Jacobi's rotations keep its small eigenvalues to full relative accuracy.
    NaN where K_p is not positive definite.
    """
    before, after = _around(mass.shape[0])
    symmetric, compliance = before.call([stiffness, mass])
    values, z = symmetric_eigen(symmetric)
    modes, same = after.call([values, z, compliance])
    return values, modes, same


@lru_cache(maxsize=8)
def modes_function(size: int) -> ca.Function:
    """(K_p, M̄) -> what `solve_modes` gives: written out, or of many modes by calls."""
    if size > WRITTEN_OUT:
        return called_modes(size)
    pencil = [ca.SX.sym("K", size, size), ca.SX.sym("M", size, size)]
    return ca.Function("solve_modes", pencil, list(solve_modes(*pencil)))


@lru_cache(maxsize=8)
def called_modes(size: int) -> ca.Function:
    """(K_p, M̄) -> what `solve_modes` gives, by calls that keep its C small."""
    before, after = _around(size)
    pencil = [ca.MX.sym(name, size, size) for name in ("K", "M")]
    symmetric, solved = before.call(pencil)
    pairs = called_eigen(size).call([symmetric])
    outputs = [pairs[0], *after.call([*pairs, solved])]
    return ca.Function("solve_modes", pencil, outputs, ["K", "M"], ["omega_squared", "modes", "same"])


@lru_cache(maxsize=8)
def _around(size: int) -> tuple[ca.Function, ca.Function]:
    """What comes before and after the symmetric eigenproblem: (K_p, M̄) -> S, X = M̄⁻¹ L; (ω², z, X) -> Φ, clusters."""
    stiffness, mass = ca.SX.sym("K", size, size), ca.SX.sym("M", size, size)
    lower = ca.chol(stiffness).T
    compliance = solve_spd(mass, lower)
    symmetric = lower.T @ compliance
    outputs = [ca.densify(symmetric + symmetric.T) / 2, ca.densify(compliance)]
    before = ca.Function("symmetric_form", [stiffness, mass], outputs, {"cse": True})
    values, z, solved = ca.SX.sym("values", size), ca.SX.sym("z", size, size), ca.SX.sym("X", size, size)
    outputs = [solved @ z / ca.repmat(ca.sqrt(values).T, size, 1), clusters(values, CLUSTER_TOLERANCE)]
    return before, ca.Function("shapes", [values, z, solved], outputs, {"cse": True})


@lru_cache(maxsize=8)
def quick_modes(size: int) -> ca.Function:
    """(K_p, M̄) -> ω² ascending (m, 1), φ_p of any length (m, m), clusters, squares φ_pᵀ M̄ φ_p (m, 1), gap.

    For simple frequencies: clusters are the unit matrix. `gap` is the smallest distance of two ω² relative to their
    mean (within a factor 3): the modes' error is some 1e-15 / gap, and unless it is at least `TRUSTED_GAP` the caller
    asks `solve_modes`. Up to three modes come in closed form, from L⁻¹ M̄ L⁻ᵀ z = ω⁻² z with φ_p ∝ L⁻ᵀ z; more by
    iteration.
    """
    stiffness, mass, alone = ca.SX.sym("K", size, size), ca.SX.sym("M", size, size), ca.densify(ca.SX.eye(size))
    if size > 3:
        values, vectors, _ = solve_modes(stiffness, mass)
        gap = ca.mmin(2 * (values[1:] - values[:-1]) / (values[1:] + values[:-1]))
        outputs = [values, vectors, alone, ca.SX.ones(size, 1), gap]
    else:
        inverse = _inverse_of_lower(ca.chol(stiffness).T)
        flexible = inverse @ mass @ inverse.T
        z, gap = direct_eigen(flexible)
        squares = ca.sum1((flexible @ z) * z).T
        outputs = [ca.sum1(z**2).T / squares, inverse.T @ z, alone, squares, gap]
    return ca.Function("quick_modes", [stiffness, mass], outputs)


def _inverse_of_lower(lower: ca.SX) -> ca.SX:
    """L⁻¹ of a lower triangular L, by one division for each row."""
    size = lower.shape[0]
    inverse = ca.SX.zeros(size, size)
    for i in range(size):
        pivot = reciprocal(lower[i, i])
        inverse[i, i] = pivot
        if i:
            inverse[i, :i] = -pivot * (lower[i, :i] @ inverse[:i, :i])
    return inverse
