"""Residues with damping: complex modes of the full plant, with exact first derivatives.

M, D and K are symmetric, so a mode u of (λ² M + λ D + K) u = 0, scaled to uᵀ (2 λ M + D) u = 1, is its own left mode
and the residue of P(s) at λ is ρ = (J u) b(u)ᵀ. A complex pair contributes (N1 s + N0)/(s² + 2 ζ ω s + ω²) with
N1 = 2 Re ρ and N0 = −2 Re(ρ λ̄); without damping N0 = R_i and N1 = 0. The measure is λmin(N0 + N0ᵀ).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.errors import InputError
from flexopt.model import AnyMachine
from flexopt.model.arguments import Vector
from flexopt.model.problem import Control
from flexopt.plant import Plant, build_plant
from flexopt.plant.control import task_to_joints_transposed

# Poles closer than this, relative to their size, are one cluster: see `modes.CLUSTER_TOLERANCE`, there for ω².
CLUSTER_TOLERANCE = 5e-7


@dataclass(frozen=True)
class DampedModes:
    """Measures with damping. m modes ordered by |λ|, r task rows, n_z = n_b + n.

    Attributes:
        poles: λ_i with positive imaginary part, (m,), rad/s.
        w: λmin(N0 + N0ᵀ), (m,), of the cluster's sum where poles repeat.
        n0, n1: numerators, (m, r, r).
        w_z, w_p: ∂w/∂[base, posture] (m, n_z) and ∂w/∂p (m, n_par); NaN rows where poles repeat.
        clusters: groups of modes with equal poles, as tuples of indices.
    """

    poles: NDArray[np.complex128]
    w: Vector
    n0: Vector
    n1: Vector
    w_z: Vector
    w_p: Vector
    clusters: tuple[tuple[int, ...], ...]


def damped_modes(
    machine: AnyMachine, base: Vector, posture: Vector, control: Control, gravity: bool, lowest_frequency: float
) -> DampedModes:
    """Poles, numerators, measures and gradients of the damped plant; `lowest_frequency` is ω_1 undamped, rad/s.

    Raises:
        InputError: a mode is overdamped, so that it has no complex pair.
    """
    graphs = _build(machine, control, gravity)
    plant = graphs.plant
    p = plant.parameter_values
    m, n, r = plant.n_passive, plant.n_coordinates, plant.n_task
    mass, damping, stiffness, deflection = (x.full() for x in graphs.point.call([base, posture, p]))
    top = cast(Vector, np.linalg.solve(mass, np.hstack([-damping, -stiffness])))
    solved = np.linalg.eig(np.vstack([top, np.eye(n, 2 * n)]))
    values, vectors = solved.eigenvalues.astype(np.complex128), solved.eigenvectors.astype(np.complex128)
    # Rigid poles are zero up to the square root of the rounding; a pair closer to the real axis than a tenth of the
    # lowest undamped frequency is damped to within half a percent of critical, or beyond.
    floor = 0.1 * lowest_frequency
    upper = [k for k in np.argsort(np.abs(values), kind="stable") if values[k].imag > floor][-m:]
    if len(upper) != m:
        raise InputError(
            f"damping: {m - len(upper)} of {m} vibration modes are overdamped and have no complex pair of poles; "
            "lower the damping of the passive coordinates, or use the undamped measures"
        )
    poles = values[upper]
    n0, n1 = np.empty((m, r, r)), np.empty((m, r, r))
    w_z, w_p = np.full((m, plant.n_base + plant.n_actuated), np.nan), np.full((m, p.shape[0]), np.nan)
    eigen: list[Vector] = []
    for i, k in enumerate(upper):
        pole, u = poles[i], vectors[n:, k]
        u = u / np.sqrt(u @ (2 * pole * mass + damping) @ u)
        eigen.append(np.concatenate([[pole.real, pole.imag], u.real, u.imag]))
        out = graphs.residue.call([base, posture, p, deflection, eigen[i]])
        n0[i], n1[i] = out[0].full(), out[1].full()
        refined = out[2].full().ravel()
        poles[i] = complex(refined[0], refined[1])
    groups = _clusters(poles)
    w = np.empty(m)
    for group in groups:
        total = n0[list(group)].sum(axis=0)
        smallest, directions = np.linalg.eigh(total + total.T)
        w[list(group)] = smallest[0]
        if len(group) == 1:
            i = group[0]
            gradient = graphs.gradient.call([base, posture, p, deflection, eigen[i], directions[:, 0]])
            w_z[i], w_p[i] = gradient[0].full().ravel(), gradient[1].full().ravel()
    return DampedModes(poles, w, n0, n1, w_z, w_p, tuple(g for g in groups if len(g) > 1))


def _clusters(poles: NDArray[np.complex128]) -> list[tuple[int, ...]]:
    groups: list[list[int]] = []
    for i, pole in enumerate(poles):
        near = [g for g in groups if any(abs(pole - poles[j]) <= CLUSTER_TOLERANCE * abs(pole) for j in g)]
        if near:
            near[0].append(i)
        else:
            groups.append([i])
    return [tuple(g) for g in groups]


@dataclass(frozen=True)
class _Graphs:
    plant: Plant
    point: ca.Function
    residue: ca.Function
    gradient: ca.Function


@lru_cache(maxsize=32)
def _build(machine: AnyMachine, control: Control, gravity: bool) -> _Graphs:
    plant = build_plant(machine)
    g, n, m = plant.graph, plant.n_coordinates, plant.n_passive
    deflection = ca.SX.sym("deflection", m)
    where = [g.base, g.posture, g.p]
    names = ["base", "posture", "p"]
    at = plant.operating_point(g.base, g.posture, g.p, deflection if gravity else None)
    solved = plant.deflected(g.base, g.posture, g.p) if gravity else ca.SX.zeros(m, 1)
    matrices = ca.substitute([at.mass, at.damping, at.stiffness], [deflection], [solved])
    point = ca.Function("point", where, [*matrices, solved], names, ["M", "D", "K", "deflection"], {"cse": True})

    eigen = ca.SX.sym("eigen", 2 + 2 * n)
    pole, u = _newton_step(at.mass, at.damping, at.stiffness, (eigen[0], eigen[1]), (eigen[2 : 2 + n], eigen[2 + n :]))
    alpha = [at.jacobian @ part for part in u]
    beta = [task_to_joints_transposed(at.rigid_jacobian, control, part[m:]) for part in u]
    real = alpha[0] @ beta[0].T - alpha[1] @ beta[1].T
    imaginary = alpha[0] @ beta[1].T + alpha[1] @ beta[0].T
    n0, n1 = -2 * (real * pole[0] + imaginary * pole[1]), 2 * real
    inputs, input_names = [*where, deflection, eigen], [*names, "deflection", "eigen"]
    residue = ca.Function(
        "damped_residue", inputs, [n0, n1, ca.vertcat(*pole)], input_names, ["N0", "N1", "pole"], {"cse": True}
    )
    direction = ca.SX.sym("direction", plant.n_task)
    w = direction.T @ (n0 + n0.T) @ direction
    derivatives = [ca.densify(ca.jacobian(w, ca.vertcat(g.base, g.posture))), ca.densify(ca.jacobian(w, g.p))]
    gradient = ca.Function(
        "damped_gradient", [*inputs, direction], derivatives, [*input_names, "direction"], ["w_z", "w_p"], {"cse": True}
    )
    return _Graphs(plant, point, residue, gradient)


def _newton_step(
    mass: ca.SX, damping: ca.SX, stiffness: ca.SX, pole: tuple[ca.SX, ca.SX], u: tuple[ca.SX, ca.SX]
) -> tuple[tuple[ca.SX, ca.SX], tuple[ca.SX, ca.SX]]:
    """One Newton step on (λ² M + λ D + K) u = 0, uᵀ (2 λ M + D) u = 1 from a solution held constant.

    Real and imaginary parts are solved side by side, rows and columns scaled by the diagonal of M and by |λ|.
    """
    re, im = pole
    size = ca.sqrt(re**2 + im**2)
    scale = 1 / ca.sqrt(ca.diag(mass))
    by = ca.diag(scale)
    m, d, k = by @ mass @ by, (by @ damping @ by) / size, (by @ stiffness @ by) / size**2
    # λ = |λ| (c + i s), u = by (x + i y) / sqrt|λ|: all entries of order one.
    c, s = re / size, im / size
    x, y = (part / scale * ca.sqrt(size) for part in u)
    q_re, q_im = (c**2 - s**2) * m + c * d + k, 2 * c * s * m + s * d
    t_re, t_im = 2 * c * m + d, 2 * s * m
    f_re, f_im = q_re @ x - q_im @ y, q_re @ y + q_im @ x
    v_re, v_im = t_re @ x - t_im @ y, t_re @ y + t_im @ x
    mx, my = m @ x, m @ y
    norm_re, norm_im = ca.dot(x, v_re) - ca.dot(y, v_im) - 1, ca.dot(x, v_im) + ca.dot(y, v_re)
    corner_re, corner_im = ca.dot(x, mx) - ca.dot(y, my), 2 * ca.dot(x, my)
    real = ca.blockcat([[q_re, v_re], [v_re.T, corner_re]])
    imaginary = ca.blockcat([[q_im, v_im], [v_im.T, corner_im]])
    matrix = ca.blockcat([[real, -imaginary], [imaginary, real]])
    right = ca.vertcat(f_re, norm_re / 2, f_im, norm_im / 2)
    step = ca.solve(ca.densify(matrix), -right)
    n = m.shape[0]
    x, y = x + step[:n], y + step[n + 1 : 2 * n + 1]
    c, s = c + step[n], s + step[2 * n + 1]
    back = scale / ca.sqrt(size)
    return (c * size, s * size), (x * back, y * back)
