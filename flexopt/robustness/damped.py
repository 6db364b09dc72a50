"""Residues with damping: complex modes of the full plant, with exact first derivatives, beyond double precision.

M, D and K are symmetric, so a mode u of (λ² M + λ D + K) u = 0, scaled to uᵀ (2 λ M + D) u = 1, is its own left mode
and the residue of P(s) at λ is ρ = (J u) b(u)ᵀ. A complex pair contributes (N1 s + N0)/(s² + 2 ζ ω s + ω²) with
N1 = 2 Re ρ and N0 = −2 Re(ρ λ̄); without damping N0 = R_i and N1 = 0. The measure is λmin(N0 + N0ᵀ).

Where poles come close, modes turn fast, and doubles lose the digits of ∂w and even its sign. So poles and modes found
in doubles are refined in decimals, by Newton's method on the bordered system

    [[Q, v], [vᵀ, uᵀMu]] [du; dλ] = −[Q u; (uᵀv − 1)/2],    Q = λ² M + λ D + K,    v = (2 λ M + D) u,

and the derivatives of w come from one more solve with this symmetric matrix and one reverse sweep through the graph of
M, D, K, J and of the map from forces to joints.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, getcontext
from typing import cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.compiled.extended import Evaluated, Exact, digits, exact, extended, largest, rounded
from flexopt.coprime.decimals import Complex, solve_complex, symmetric, symmetric_eigen
from flexopt.errors import InputError, NoSolutionFound
from flexopt.foundation.arrays import Vector
from flexopt.foundation.control import Control
from flexopt.foundation.kept import by_structure
from flexopt.model import AnyMachine
from flexopt.plant import Plant, build_plant
from flexopt.plant.control import task_to_joints

# Poles closer than this, relative to their size, are one cluster: see `modes.CLUSTER_TOLERANCE`, there for ω².
CLUSTER_TOLERANCE = 5e-7
NEWTON_STEPS = 12
# Last Newton correction, relative, and the bound on ∂w beside its largest element, up to which results are told.
CONVERGED, TOLD = 1e-25, 1e-7
# A share of what N0 could be that is rounding in doubles.
UNSEEN = 1e-12
ROUNDING = 2.0**-52


@dataclass(frozen=True)
class DampedModes:
    """Measures with damping. m modes ordered by |λ|, r task rows, n_z = n_b + n.

    Attributes:
        poles: λ_i with positive imaginary part, (m,), rad/s.
        w: λmin(N0 + N0ᵀ), (m,), of the cluster's sum where poles repeat.
        n0, n1: numerators, (m, r, r).
        w_z, w_p: ∂w/∂[base, posture] (m, n_z) and ∂w/∂p (m, n_par); NaN rows where poles repeat, or where the bound on
            a derivative's error is beyond 1e-7 of the largest.
        clusters: groups of modes with equal poles, as tuples of indices.
        w_z_error, w_p_error: bounds on the errors of the derivatives, to first order, like them.
    """

    poles: NDArray[np.complex128]
    w: Vector
    n0: Vector
    n1: Vector
    w_z: Vector
    w_p: Vector
    clusters: tuple[tuple[int, ...], ...]
    w_z_error: Vector
    w_p_error: Vector

    def summed(self) -> Vector:
        """N0 (m, r, r), summed over the cluster where poles repeat."""
        total = self.n0.copy()
        for group in self.clusters:
            total[list(group)] = self.n0[list(group)].sum(axis=0)
        return total


def damped_modes(
    machine: AnyMachine, base: Vector, posture: Vector, control: Control, gravity: bool, lowest_frequency: float
) -> DampedModes:
    """Poles, numerators, measures and gradients of the damped plant; `lowest_frequency` is ω_1 undamped, rad/s.

    Raises:
        InputError: a mode is overdamped, so that it has no complex pair.
        NoSolutionFound: Newton's method does not converge to a pole found in doubles, or a linear system is singular.
    """
    plant, matrices = build_plant(machine), _matrices(machine, control, gravity)
    try:
        with digits():
            return _refined(plant, matrices, base, posture, lowest_frequency, gravity=gravity)
    except np.linalg.LinAlgError as error:
        reason = f"the damped modes could not be computed ({error})"
        raise NoSolutionFound(reason, violations={}, iterate={}) from None


def _refined(
    plant: Plant, matrices: ca.Function, base: Vector, posture: Vector, lowest_frequency: float, *, gravity: bool
) -> DampedModes:
    p = plant.parameter_values
    m, n, r = plant.n_passive, plant.n_coordinates, plant.n_task
    deflection = plant.deflected(base, posture, p).full().ravel() if gravity else np.zeros(m)
    evaluated = extended(matrices)(*(exact(x) for x in (base, posture, p.full().ravel(), deflection)))
    mass, damping, stiffness = (rounded(x) for x in evaluated.outputs[:3])
    by = 1 / np.sqrt(np.diag(mass))
    scaled = [by[:, None] * x * by for x in (mass, damping, stiffness)]
    top = cast(Vector, np.linalg.solve(scaled[0], np.hstack([-scaled[1], -scaled[2]])))
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
    modes = [_newton(evaluated.outputs, complex(values[k]), by * vectors[n:, k]) for k in upper]
    poles = np.array([mode.pole for mode in modes])
    n0, n1 = (
        np.array([rounded(x) for x in each]).reshape(m, r, r)
        for each in zip(*(mode.numerators for mode in modes), strict=True)
    )
    groups = _clusters(poles)
    _check_distinct(poles, values[upper])
    w, n_z, n_p = np.empty(m), base.size + posture.size, p.shape[0]
    w_z, w_p = np.full((m, n_z), np.nan), np.full((m, n_p), np.nan)
    z_error, p_error = w_z.copy(), w_p.copy()
    for group in groups:
        total = sum((modes[i].numerators[0] for i in group[1:]), modes[group[0]].numerators[0])
        smallest, directions = symmetric_eigen(total + total.T)
        w[list(group)] = float(smallest[-1])
        if len(group) == 1:
            i = group[0]
            row, error = modes[i].gradient(evaluated, directions[:, -1])
            # Of a mode that the end-point does not see N0 is nothing to measure errors by.
            size = max(float(np.linalg.norm(n0[i])), UNSEEN * modes[i].reach)
            if _told(row[:n_z], error[:n_z], 1.0, size) and _told(row[n_z:], error[n_z:], p.full().ravel(), size):
                w_z[i], w_p[i], z_error[i], p_error[i] = row[:n_z], row[n_z:], error[:n_z], error[n_z:]
    clusters = tuple(g for g in groups if len(g) > 1)
    return DampedModes(poles, w, n0, n1, w_z, w_p, clusters, z_error, p_error)


def _told(row: Vector, error: Vector, by: Vector | float, size: float) -> bool:
    """Whether every error is small beside the largest derivative, or beside N0, all per relative change `by`."""
    return bool(np.all(np.abs(error * by) <= TOLD * max(float(np.max(np.abs(row * by), initial=0.0)), 1e-3 * size)))


def _check_distinct(poles: NDArray[np.complex128], found: NDArray[np.complex128]) -> None:
    """Each pole found in doubles led to the refined one next to it, no two to the same."""
    for i, pole in enumerate(poles):
        if abs(pole - found[i]) > 0.3 * min(
            (abs(found[i] - other) for other in np.delete(found, i)), default=abs(pole)
        ):
            near = any(abs(pole - other) <= CLUSTER_TOLERANCE * abs(pole) for other in np.delete(poles, i))
            if not near:
                raise NoSolutionFound(
                    f"the damped modes did not converge (a pole at {found[i]:.6g} rad/s led to {pole:.6g} rad/s)",
                    violations={},
                    iterate={},
                )


def _clusters(poles: NDArray[np.complex128]) -> list[tuple[int, ...]]:
    groups: list[list[int]] = []
    for i, pole in enumerate(poles):
        near = [g for g in groups if any(abs(pole - poles[j]) <= CLUSTER_TOLERANCE * abs(pole) for j in g)]
        if near:
            near[0].append(i)
        else:
            groups.append([i])
    return [tuple(g) for g in groups]


@dataclass(frozen=True, eq=False)
class _Mode:
    """A refined pole λ and mode u; `correction` is how far they may be off, relative."""

    outputs: Sequence[Exact]
    lam: Complex
    u: Complex
    correction: float

    @property
    def pole(self) -> complex:
        """λ, rounded."""
        return complex(float(self.lam.re), float(self.lam.im))

    @property
    def numerators(self) -> tuple[Exact, Exact]:
        """N0 and N1, (r, r)."""
        _, _, _, jacobian, into = self.outputs
        rho = self.u.left(jacobian).outer(self._actuated.left(into.T))
        return (rho * self.lam.conjugate()).re * -2, rho.re * 2

    @property
    def reach(self) -> float:
        """What |N0| is at most, by the sizes of its factors."""
        _, _, _, jacobian, into = (rounded(x) for x in self.outputs)
        size = sum(float(np.linalg.norm(rounded(part))) ** 2 for part in (self.u.re, self.u.im))
        return 2 * abs(self.pole) * size * float(np.linalg.norm(jacobian) * np.linalg.norm(into))

    @property
    def _actuated(self) -> Complex:
        m = self.outputs[0].shape[0] - self.outputs[4].shape[0]
        return Complex(self.u.re[m:], self.u.im[m:])

    def gradient(self, evaluated: Evaluated, direction: Exact) -> tuple[Vector, Vector]:
        """∂(νᵀ(N0 + N0ᵀ)ν)/∂[base, posture, p] for ν = `direction`, and bounds on the errors."""
        mass, jacobian, into = self.outputs[0], *self.outputs[3:]
        n, passive = mass.shape[0], mass.shape[0] - into.shape[0]
        lam, u, conj = self.lam, self.u, self.lam.conjugate().times(-4)
        spread = np.concatenate([np.full(passive, Decimal(0), dtype=object), into @ direction])
        seen = jacobian.T @ direction
        s, t = Complex(seen @ u.re, seen @ u.im), Complex(spread @ u.re, spread @ u.im)
        by_lam = (s * t).conjugate().times(-4)
        by_u = (conj * t * Complex(seen, seen * 0)) + (conj * s * Complex(spread, spread * 0))
        right = Complex(np.append(by_u.re, by_lam.re), np.append(by_u.im, by_lam.im))
        solution = solve_complex(_bordered(self.outputs, lam, u)[0], right)
        y, eta = Complex(solution.re[:n], solution.im[:n]), Complex(solution.re[n], solution.im[n])
        yu, uu = _symmetric_part(y.outer(u)), u.outer(u)
        seeds = [
            (lam * lam * yu + eta * lam * uu).re * -1,
            (lam * yu + (eta * uu).times(Decimal("0.5"))).re * -1,
            yu.re * -1,
            np.multiply.outer(direction, (conj * t * u).re),
            np.multiply.outer((conj * s * self._actuated).re, direction),
        ]
        by_input, _ = evaluated.gradient(seeds)
        row = rounded(np.concatenate(by_input[:3]))
        off = np.concatenate(evaluated.influence([rounded(seed) for seed in seeds])[:3])
        return row, 100 * self.correction * off + ROUNDING * np.abs(row)


def _symmetric_part(x: Complex) -> Complex:
    """The symmetric part of a complex matrix."""
    return Complex(symmetric(x.re), symmetric(x.im))


def _bordered(outputs: Sequence[Exact], lam: Complex, u: Complex) -> tuple[Complex, Complex]:
    """[[Q, v], [vᵀ, uᵀMu]] and [Q u; (uᵀv − 1)/2]."""
    mass, damping, stiffness = outputs[:3]
    n, zero = mass.shape[0], mass * 0
    square = lam * lam
    Q = square * Complex(mass, zero) + lam * Complex(damping, zero) + Complex(stiffness, zero)
    mu = u.left(mass)
    v = (lam * mu).times(2) + u.left(damping)
    corner, left = u.dot(mu), u.dot(v)
    matrix: list[Exact] = []
    for block, edge, end in ((Q.re, v.re, corner.re), (Q.im, v.im, corner.im)):
        whole = np.full((n + 1, n + 1), Decimal(0), dtype=object)
        whole[:n, :n], whole[:n, n], whole[n, :n], whole[n, n] = block, edge, edge, end
        matrix.append(whole)
    q = Complex(Q.re @ u.re - Q.im @ u.im, Q.re @ u.im + Q.im @ u.re)
    rest = Complex(np.append(q.re, (left.re - 1) / 2), np.append(q.im, left.im / 2))
    return Complex(*matrix), rest


def _newton(outputs: Sequence[Exact], pole: complex, vector: NDArray[np.complex128]) -> _Mode:
    """The pole and mode near those found in doubles.

    Raises:
        NoSolutionFound: the corrections do not vanish.
    """
    mass, damping = (rounded(x) for x in outputs[:2])
    vector = vector / np.sqrt(vector @ (2 * pole * mass + damping) @ vector)
    lam, u, relative = Complex(*(np.array(Decimal(x)) for x in (pole.real, pole.imag))), Complex.of(vector), math.inf
    lam = Complex(lam.re[()], lam.im[()])
    for _ in range(NEWTON_STEPS):
        matrix, rest = _bordered(outputs, lam, u)
        step = solve_complex(matrix, rest.times(-1))
        u = u + Complex(step.re[:-1], step.im[:-1])
        lam = lam + Complex(step.re[-1], step.im[-1])
        before = relative
        relative = max(
            largest(np.append(step.re[:-1], step.im[:-1])) / largest(np.append(u.re, u.im)),
            float(abs(step.re[-1]) + abs(step.im[-1])) / abs(pole),
        )
        if relative <= 10.0 ** (10 - getcontext().prec) or (relative <= CONVERGED and relative > 0.5 * before):
            break
    if not relative <= CONVERGED:
        raise NoSolutionFound(
            f"the damped modes did not converge (the pole near {pole:.6g} rad/s moves by {relative:.1g} of itself)",
            violations={"pole": relative},
            iterate={},
        )
    # Two poles that nearly meet take up to twice seven digits from what is solved for with them.
    return _Mode(outputs, lam, u, max(relative, 10.0 ** (22 - getcontext().prec)))


@by_structure
def _matrices(machine: AnyMachine, control: Control, gravity: bool) -> ca.Function:
    """(base, posture, p, deflection) -> M, D, K, J, and the map E from forces to joints."""
    plant = build_plant(machine)
    g, deflection = plant.graph, ca.SX.sym("deflection", plant.n_passive)
    at = plant.operating_point(g.base, g.posture, g.p, deflection if gravity else None)
    into = task_to_joints(at.rigid_jacobian, control, ca.SX.eye(plant.n_task))
    outputs = [ca.densify(x) for x in (at.mass, at.damping, at.stiffness, at.jacobian, into)]
    names = ["base", "posture", "p", "deflection"]
    inputs = [g.base, g.posture, g.p, deflection]
    return ca.Function("damped_plant", inputs, outputs, names, ["M", "D", "K", "J", "E"], {"cse": True})
