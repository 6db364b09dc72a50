"""Residue matrices of the modal decomposition P(s) = R_0/s² + Σ R_i / (s² + 2 ζ_i ω_i s + ω_i²), and w_i."""

from __future__ import annotations

import casadi as ca

from flexopt.algebra import safe_norm, solve_spd
from flexopt.algebra.dense import TINY
from flexopt.foundation.control import Control
from flexopt.plant.control import task_to_joints, task_to_joints_transposed
from flexopt.plant.plant import OperatingPoint
from flexopt.robustness.modes import ReducedPencil

# 1/kg where the force acts on the end-point; with the inverse Jacobian, torque stands for velocity.
MIXED = "mixed"
RESIDUE_UNITS = {"transpose": "1/kg", "inverse": "1/(kg m2)"}


def residue_factors(at: OperatingPoint, pencil: ReducedPencil, control: Control) -> ca.SX:
    """F = [A; B] (2 n_task, m) of the columns a_i = A φ_i = J φ_i and b_i = B φ_i of R_i = a_i b_iᵀ.

    b_i = Jv φ_a (transpose), (Jv⁺)ᵀ φ_a (inverse) or (J⁺_λ)ᵀ φ_a (damped); article, eqs. (3)–(6).
    """
    m = pencil.mass.shape[0]
    a = at.jacobian[:, :m] + at.jacobian[:, m:] @ pencil.follow
    return ca.vertcat(a, task_to_joints_transposed(at.rigid_jacobian, control, pencil.follow))


def rigid_residue(at: OperatingPoint, pencil: ReducedPencil, control: Control) -> ca.SX:
    """R_0 = Jv M̂⁻¹ Jvᵀ (transpose), Jv M̂⁻¹ Jv⁺ (inverse) or Jv M̂⁻¹ J⁺_λ (damped), (n_task, n_task)."""
    jv = at.rigid_jacobian
    return jv @ solve_spd(pencil.actuated_mass, task_to_joints(jv, control, ca.SX(ca.DM.eye(jv.shape[0]))))


def summed_residue(a: ca.SX, b: ca.SX, row: ca.SX) -> ca.SX:
    """Σ_j row_j a_j b_jᵀ (n_task, n_task), `row` (1, m) that of a mode in its clusters: R_i where it stands alone."""
    return (a * ca.repmat(row, a.shape[0], 1)) @ b.T


def measure(a: ca.SX, b: ca.SX, row: ca.SX, vectors: ca.SX) -> ca.SX:
    """The first mode's w_i = λmin(R_i + R_iᵀ), eq. (7): in rank-one form where it is simple, else of its cluster's sum.

    `vectors` (n_task, n_task) are the eigenvectors of that, ascending, held constant.
    """
    residue = summed_residue(a, b, row)
    clustered = _smallest_eigenvalue(residue + residue.T, vectors)
    return ca.if_else(ca.sum(row) > 1.5, clustered, rank_one_measure(a[:, 0], b[:, 0]))


def rank_one_measure(a: ca.SX, b: ca.SX) -> ca.SX:
    """λmin(a bᵀ + b aᵀ) = a·b − |a||b|; 2ab for a single task row.

    Where a·b > 0 it is computed as −Σ_{k<l} (a_k b_l − a_l b_k)² / (|a||b| + a·b), which keeps all digits near 0.
    """
    dot = ca.dot(a, b)
    rows = a.shape[0]
    if rows == 1:
        return 2 * dot
    norms = safe_norm(a) * safe_norm(b)
    crossed = ca.SX(0)
    for k in range(rows):
        for m in range(k + 1, rows):
            crossed = crossed + (a[k] * b[m] - a[m] * b[k]) ** 2
    return ca.if_else(dot > 0, -crossed / (norms + ca.fabs(dot) + TINY), dot - norms)


def _smallest_eigenvalue(symmetric: ca.SX, vectors: ca.SX) -> ca.SX:
    """λmin near known eigenvectors (ascending), exact to second order; the gradient is νᵀ dG ν (Appendix B)."""
    turned = vectors.T @ symmetric @ vectors
    smallest = turned[0, 0]
    for k in range(1, symmetric.shape[0]):
        gap = turned[0, 0] - turned[k, k]
        smallest += turned[0, k] ** 2 * gap / (gap**2 + TINY)
    return smallest


def posture_unit(joint_units: tuple[str, ...]) -> str:
    """The unit of postures; of each joint where they differ."""
    return joint_units[0] if len(set(joint_units)) == 1 else ", ".join(joint_units)


def residue_unit(control: str, joint_units: tuple[str, ...]) -> str:
    """The unit of R_i and w_i."""
    if control != "transpose" and "m" in joint_units:
        # What a force on a slide and a torque on a hinge become is not one unit.
        return "1/kg" if len(set(joint_units)) == 1 else MIXED
    return RESIDUE_UNITS.get(control, RESIDUE_UNITS["inverse"])


def unit_in_words(unit: str) -> str:
    """A unit as texts print it, that of `residue_unit` say."""
    return "mixed units" if unit == MIXED else unit


def written_unit(unit: str) -> str:
    """A unit as pages and pictures print it."""
    return unit_in_words(unit).replace("m2", "m²").replace("^2", "²").replace("^3", "³")
