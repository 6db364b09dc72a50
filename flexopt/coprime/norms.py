"""The H∞ norm by level sets.

In: a system. Out: the supremum of its largest singular value over frequency, and where it is attained.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.coprime.guard import guarded
from flexopt.coprime.lyapunov import proven_stable
from flexopt.coprime.scaling import Scaled, scale_for_norm
from flexopt.coprime.stabilizability import eigenvalues_with_radius, growth
from flexopt.coprime.system import Matrix, StateSpace, state_space
from flexopt.errors import InputError

STEP = 1e-11
ROUNDS = 60
FLOOR = 1e-15  # of the realisation's own size: below it the response is rounding


@guarded
def hinf_norm(system: Any) -> float:
    """‖G‖∞ = sup_ω σmax(G(jω)) (G(e^{jω}) in discrete time), to 1e-10 relative; infinite if a pole does not decay.

    The pole may be hidden from inputs and outputs: stability is that of the realisation.

    Args:
        system: anything `state_space` takes.

    Raises:
        InputError: the system is not usable (all faults in one message).

    Source: Boyd, Balakrishnan and Kabamba, Mathematics of Control, Signals and Systems 2, 1989; Bruinsma and
    Steinbuch, Systems & Control Letters 14, 1990.
    """
    return hinf_peak(state_space(system, call="hinf_norm"))[0]


def hinf_peak(system: StateSpace) -> tuple[float, float]:
    """The H∞ norm and the frequency (rad/s) at which it is attained, perhaps infinite; (inf, nan) if unstable."""
    scaled = scale_for_norm(system)
    if not is_stable(scaled):
        return math.inf, math.nan
    return axis_peak(scaled)


def is_stable(scaled: Scaled) -> bool:
    """Whether every mode decays, beyond the doubt that rounding leaves."""
    A, discrete = scaled.system.A, scaled.system.discrete
    values, radii = eigenvalues_with_radius(A)
    # Of poles that nearly repeat these radii are far too large.
    apart = all(growth(v, discrete=discrete) < -r / 4 for v, r in zip(values, radii, strict=True))
    return apart or proven_stable(A, discrete=discrete)


def axis_peak(scaled: Scaled) -> tuple[float, float]:
    """Largest σmax over the imaginary axis or the unit circle, and its frequency (rad/s); no pole may lie there.

    Each round finds where σmax crosses a level just above the best value (eigenvalues of a Hamiltonian or symplectic
    pencil), evaluates σmax there and midway, and raises the level. Every eigenvalue serves as a candidate, near the
    axis or not, so that no tolerance decides what lies on it.
    """
    system = scaled.system
    best, where = _best_of(system, _first_candidates(system))
    size = _size(system)
    for _ in range(ROUNDS):
        if best <= FLOOR * size:
            break
        level = best * (1 + STEP)
        value, frequency = _best_of(system, _crossings(system, level))
        if value > best:
            where = frequency
        best = max(best, value)
        if value <= level:
            break
    return best, where * (1.0 / system.dt if system.discrete else scaled.rate)


def _size(system: StateSpace) -> float:
    B, C, D = (float(np.linalg.norm(M)) for M in (system.B, system.C, system.D))
    return B * C + D


def _first_candidates(system: StateSpace) -> Matrix:
    values = system.poles()
    if system.discrete:
        return np.concatenate([np.linspace(0.0, math.pi, 9), np.abs(np.angle(values))])
    moduli = np.abs(values)
    spread = np.geomspace(1e-2, 1e2, 9)
    return np.concatenate([[0.0, math.inf], moduli, np.abs(values.imag), spread])


def _best_of(system: StateSpace, frequencies: Matrix) -> tuple[float, float]:
    """The largest σmax over `frequencies` (k,), and where."""
    gains = gain_at(system, frequencies)
    i = int(np.argmax(gains))
    return float(gains[i]), float(frequencies[i])


def gain_at(system: StateSpace, frequencies: Matrix) -> Matrix:
    """σmax(G) (k,) at `frequencies` (k,), rad/s or rad per sample, infinite ones allowed in continuous time."""
    gains = np.full(frequencies.shape, np.linalg.norm(system.D, 2))
    finite = np.isfinite(frequencies)
    if system.n_states and np.any(finite):
        points = np.exp(1j * frequencies[finite]) if system.discrete else 1j * frequencies[finite]
        try:
            with np.errstate(all="ignore"):
                response = system.at(points)
        except np.linalg.LinAlgError:
            raise InputError("a pole lies on the frequency axis: the response there is infinite") from None
        values = np.linalg.norm(np.where(np.isfinite(response), response, 0.0), 2, axis=(1, 2))
        gains[finite] = values
    return gains


def _crossings(system: StateSpace, level: float) -> Matrix:
    """Frequencies at which σmax may equal `level`, and the points between them."""
    values = _pencil_eigenvalues(system, level)
    if system.discrete:
        edges = np.unique(np.concatenate([[0.0, math.pi], np.abs(np.angle(values))]))
        return np.concatenate([edges, (edges[1:] + edges[:-1]) / 2])
    edges = np.unique(np.concatenate([[0.0], np.abs(values.imag)]))
    edges = edges[edges < 1e100]
    low, high = edges[:-1], edges[1:]
    return np.concatenate([edges, (low + high) / 2, np.sqrt(low * high)])


def _pencil_eigenvalues(system: StateSpace, level: float) -> NDArray[np.complex128]:
    """Finite eigenvalues λ of the pencil that is singular at s = jω (z = e^{jω}) exactly where some σ(G) = level.

    The unknowns are x, its adjoint y, the input u and the scaled output v, with C x + D u = level·v and its adjoint; no
    inverse of level² I − DᵀD is formed.
    """
    import scipy.linalg as sla  # noqa: PLC0415  # slow to import

    n, m, p = system.n_states, system.n_inputs, system.n_outputs
    root = math.sqrt(level)
    A, B, C, D = system.A, system.B / root, system.C / root, system.D / level
    left, right = np.zeros((2 * n + m + p, 2 * n + m + p)), np.zeros((2 * n + m + p, 2 * n + m + p))
    x, y, u, v = (slice(a, b) for a, b in ((0, n), (n, 2 * n), (2 * n, 2 * n + m), (2 * n + m, 2 * n + m + p)))
    left[x, x], left[x, u], right[x, x] = A, B, np.eye(n)
    if system.discrete:
        left[y, y], right[y, y], right[y, v] = np.eye(n), A.T, C.T
    else:
        left[y, y], left[y, v], right[y, y] = -A.T, -C.T, np.eye(n)
    rows_v, rows_u = slice(2 * n, 2 * n + p), slice(2 * n + p, 2 * n + p + m)
    left[rows_v, x], left[rows_v, u], left[rows_v, v] = C, D, -np.eye(p)
    left[rows_u, y], left[rows_u, v], left[rows_u, u] = B.T, D.T, -np.eye(m)
    with np.errstate(all="ignore"):
        values = np.asarray(sla.eigvals(left, right), dtype=complex)
    return values[np.isfinite(values)]
