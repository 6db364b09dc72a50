"""Which modes escape the inputs or the outputs: the Popov–Belevitch–Hautus test with tolerances.

In: a scaled plant. Out: the modes that escape, up to what rounding leaves in doubt. A mode in doubt proves nothing:
only where the Riccati equations confirm it does `raise_escapes` say that no controller stabilises the plant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexopt.coprime.lyapunov import EPS
from flexopt.coprime.scaling import Scaled
from flexopt.coprime.system import Matrix
from flexopt.errors import Fault, NotStabilizable, sentence_list

DOUBT_SIMPLE = 1e-6  # of the norm of [A, B]
DOUBT_MULTIPLE = 1e-9
REACH = {"stabilizable": "is not reached by any input", "detectable": "is not seen in any output"}


@dataclass(frozen=True)
class Escape:
    """A mode that does not decay and may escape.

    Attributes:
        mode: eigenvalue of the scaled A.
        radius: how far rounding may have moved it.
        distance: smallest singular value of [A − λI, B] (or of its dual), relative to the norm of [A, B]: so small a
            change of A and B takes the mode out of the inputs' reach.
        kind: `"stabilizable"` or `"detectable"`.
        certain: changes of each element of A and B by some ε of itself take the mode out of reach and keep it from
            decaying. Small elements stay small in that, so a slow part of a plant is not mistaken for rounding.
    """

    mode: complex
    radius: float
    distance: float
    kind: str
    certain: bool


def eigenvalues_with_radius(A: Matrix) -> tuple[list[complex], list[float]]:
    """Eigenvalues of A (n, n), and how far rounding may have moved each: 4 n ε ‖A‖ over its |yᴴx|, at most 1e-3 ‖A‖."""
    import scipy.linalg as sla  # noqa: PLC0415  # slow to import

    n = A.shape[0]
    if n == 0:
        return [], []
    eig: Any = sla.eig  # its stubs do not know that both sides give three arrays
    values, left, right = eig(A, left=True, right=True)
    cosine = np.abs(np.sum(np.conj(left) * right, axis=0))
    size = float(np.linalg.norm(A))
    radius = np.minimum(4 * n * EPS * size / np.maximum(cosine, 1e-300), 1e-3 * size)
    return [complex(v) for v in values], [float(r) for r in radius]


def growth(value: complex, *, discrete: bool) -> float:
    """Re λ, or |λ| − 1 in discrete time: not negative for a mode that does not decay."""
    return abs(value) - 1.0 if discrete else value.real


def clusters(values: list[complex], radii: list[float]) -> list[tuple[complex, float, int]]:
    """Mean, radius and size of each group of eigenvalues that rounding cannot tell apart.

    Rounding scatters a multiple eigenvalue widely, but hardly moves the mean of its parts.
    """
    left = set(range(len(values)))
    groups: list[tuple[complex, float, int]] = []
    while left:
        front = [left.pop()]
        group = list(front)
        while front:
            i = front.pop()
            near = [j for j in left if abs(values[i] - values[j]) <= radii[i] + radii[j]]
            left -= set(near)
            front += near
            group += near
        mean = sum(values[i] for i in group) / len(group)
        groups.append((complex(mean), max(radii[i] for i in group), len(group)))
    return groups


def escaping_modes(scaled: Scaled) -> list[Escape]:
    """Modes with Re λ ≥ 0 (|λ| ≥ 1) for which [A − λI, B] or [Aᵀ − λI, Cᵀ] loses rank, up to rounding."""
    s = scaled.system
    n = s.n_states
    groups = clusters(*eigenvalues_with_radius(s.A))
    strict = 8 * n * EPS
    found: list[Escape] = []
    for kind, A, B in (("stabilizable", s.A, s.B), ("detectable", s.A.T, s.C.T)):
        size = float(np.linalg.norm(np.hstack([A, B]))) or 1.0
        for value, radius, count in groups:
            beyond = growth(value, discrete=s.discrete)
            if beyond < -radius:
                continue
            test = np.hstack([A - value * np.eye(n), B])
            distance = float(np.linalg.svd(test, compute_uv=False)[-1]) / size
            doubt = DOUBT_MULTIPLE if count > 1 else min(4 * radius / size, DOUBT_SIMPLE)
            if distance <= max(strict, doubt):
                certain = distance <= strict and count == 1 and _within_rounding(A, B, value, discrete=s.discrete)
                found.append(Escape(value, radius, distance, kind, certain))
    return found


def _within_rounding(A: Matrix, B: Matrix, mode: complex, *, discrete: bool) -> bool:
    """Whether 8 n ε of each element hides the simple `mode` from B, and may keep it from decaying."""
    import scipy.linalg as sla  # noqa: PLC0415  # slow to import

    eig: Any = sla.eig
    values, left, right = (np.asarray(part, dtype=complex) for part in eig(A, left=True, right=True))
    k = int(np.argmin(np.abs(values - mode)))
    y, x, share = left[:, k], right[:, k], 8 * A.shape[0] * EPS
    moved = share * float(np.abs(y) @ np.abs(A) @ np.abs(x)) / max(float(np.abs(np.vdot(y, x))), 1e-300)
    reached = np.linalg.norm(np.conj(y) @ B) <= share * np.linalg.norm(np.abs(y) @ np.abs(B))
    return bool(reached and growth(mode, discrete=discrete) >= -moved)


def raise_escapes(call: str, scaled: Scaled, escapes: list[Escape]) -> None:
    """Raise `NotStabilizable`, worst mode first, every one listed once; do nothing when there is none.

    To be called where extended precision has no ε_max either, one below 1e-12, or one that rounding of the plant moves.
    """
    if not escapes:
        return
    discrete = scaled.system.discrete
    ranked = sorted(escapes, key=lambda e: (e.kind != "stabilizable", -growth(e.mode, discrete=discrete)))
    faults: list[Fault] = []
    for e in ranked:
        if e.mode.imag >= 0:
            decays = growth(e.mode, discrete=discrete) < 0
            how = "decays by less than rounding can tell" if decays else "does not decay"
            fault = Fault("mode", f"{how} and {REACH[e.kind]}", pole_text(scaled.pole(e.mode), discrete=discrete))
            if fault not in faults:
                faults.append(fault)
    worst = ranked[0]
    heading = f"{call}: the plant is not {worst.kind}, so no controller stabilises it"
    raise NotStabilizable(sentence_list(heading, faults), faults, mode=scaled.pole(worst.mode), kind=worst.kind)


def pole_text(value: complex, *, discrete: bool) -> str:
    """An eigenvalue as it is quoted in a message."""
    unit = "" if discrete else " rad/s"
    if abs(value.imag) <= 1e-12 * abs(value):
        return f"{value.real:.6g}{unit}"
    return f"({value.real:.6g} ± {abs(value.imag):.6g}j){unit}"
