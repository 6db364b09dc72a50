"""What forces on the base do to the end-point of a sampled loop: the H2 norm, with its exact derivative.

In: a loop at numbers. Out: the root of the end-point's variance at the samples under white noise of unit intensity on
every passive coordinate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from flexopt.compiled.extended import digits, exact, rounded
from flexopt.foundation.arrays import Vector
from flexopt.loop.assembly import OneSample, Slopes, through_held
from flexopt.loop.small_motions import Parts
from flexopt.loop.spectrum import balance

# Share of what the end-point shows at all above which it sees what nothing holds.
SEEN = 1e-6
# Powers of Φ that have vanished, and that will not: a loop that decays by 1e-9 in a sample needs 36 doublings.
VANISHED, GROWN, DOUBLINGS = 1e-20, 1e60, 64
# Of the noise within a short time: terms of the Taylor series of e^{As}, ‖A s‖ ≤ 1, and nodes of the quadrature over s.
TERMS, NODES = 20, 12
# Rounding of the entries of Φ, relative, and the largest doubt about the norm, relative, with which it is told.
ROUNDING, DOUBTED = 16 * float(np.finfo(np.float64).eps), 1e-4
# Whether NumPy's long doubles have more digits than doubles; decimals' digits in their place; and the largest
# correction, relative, that is one.
WIDE, CARRIED, CORRECTED = bool(np.finfo(np.longdouble).eps < 1e-18), 34, 1e-3


class Noise(NamedTuple):
    """White noise of unit intensity through B into ẋ = A x, over a time: doublings of a short one.

    Factors G of the covariances, W(h) = ∫₀ʰ e^{As} B Bᵀ e^{Aᵀs} ds = G Gᵀ: what little of it the end-point sees is lost
    in the rounding of W, not in that of G.

    Attributes:
        terms: (A h)ᵏ B / k!, k = 0, 1, …, h the short time.
        spans: e^{Ah} and G, of the short time, then each time twice as long.
        short: h, s.
    """

    terms: list[Vector]
    spans: list[tuple[Vector, Vector]]
    short: float

    @property
    def factor(self) -> Vector:
        """G (n, n) over the whole time."""
        return self.spans[-1][1]

    @property
    def grown(self) -> Vector:
        """What a longer time adds to W is this times its transpose: e^{Ah} B."""
        return self.spans[-1][0] @ self.terms[0]


def noise_over(flow: Vector, into: Vector, span: float) -> Noise:
    """The noise that has come in over a time: within the short time by Gauss's quadrature of a Taylor series."""
    from scipy.linalg import expm  # noqa: PLC0415  (loads slowly)

    balanced, _ = balance(flow)
    size = float(np.abs(balanced).sum(axis=0).max(initial=0.0)) * span
    doublings = max(0, math.ceil(math.log2(max(size, 1.0))))
    short = span / 2**doublings
    terms = [into]
    for k in range(1, TERMS):
        terms.append(flow @ terms[-1] * (short / k))
    held: Vector = np.asarray(expm(flow * short), dtype=np.float64)
    factor = _joined(*np.asarray(np.tensordot(_quadrature(short), np.array(terms), 1), dtype=np.float64))
    spans = [(held, factor)]
    for _ in range(doublings):
        held, factor = spans[-1]
        spans.append((held @ held, _joined(factor, held @ factor)))
    return Noise(terms, spans, short)


@lru_cache(maxsize=1)
def _rule() -> tuple[Vector, Vector]:
    """Powers of Gauss's nodes in (0, 1), (nodes, TERMS), and weights."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    return ((1 + nodes) / 2)[:, None] ** np.arange(TERMS), weights / 2


def _quadrature(short: float) -> Vector:
    """Of the terms of a Taylor series its value at each node, with the root of the node's weight."""
    powers, weights = _rule()
    return powers * np.sqrt(weights * short)[:, None]


def _joined(*factors: Vector) -> Vector:
    """A factor (n, n) of the sum of Gᵢ Gᵢᵀ, every row as exact as it was."""
    columns: Vector = np.hstack(factors)
    if columns.shape[1] <= len(columns):
        return columns
    triangle: Vector = np.asarray(np.linalg.qr(columns.T, mode="r"), dtype=np.float64)
    return triangle.T


def noise_slopes(flow: Vector, noise: Noise, seen: Vector) -> tuple[Vector, Vector]:
    """Derivatives of tr(E W Eᵀ) by A and B, E (r, n) what is seen of the noise."""
    by_held = np.zeros_like(flow)
    for held, factor in reversed(noise.spans[:-1]):
        later = seen @ held
        by_held = 2 * seen.T @ (later @ factor) @ factor.T + by_held @ held.T + held.T @ by_held
        seen = _joined(seen.T, later.T).T
    found = through_held(flow, noise.short, by_held) if len(noise.spans) > 1 else np.zeros_like(flow)
    terms, at_nodes = np.array(noise.terms), _quadrature(noise.short)
    by_values = 2 * seen.T @ (seen @ np.tensordot(at_nodes, terms, 1))
    by_terms = np.tensordot(at_nodes.T, by_values, 1)
    by_term = by_terms[-1]
    for k in range(TERMS - 1, 0, -1):
        found += by_term @ terms[k - 1].T * (noise.short / k)
        by_term = by_terms[k - 1] + flow.T @ by_term * (noise.short / k)
    return found, by_term


@dataclass(frozen=True)
class Disturbed:
    """A sampled loop that decays, with noise on its base.

    Attributes:
        sample: one of the loop, as derivatives are taken of it.
        into: B_d (n_s, n_p): what unit forces on the passive coordinates make of ṡ.
        kept: orthonormal rows U of what is left of the balanced loop's states when what nothing holds is divided out.
        scale: the diagonal by which its states are balanced.
    """

    sample: OneSample
    into: Vector
    kept: Vector
    scale: Vector

    @property
    def _early(self) -> float:
        """How long before the end of a sample it is measured, s."""
        return self.sample.waiting[1]

    @cached_property
    def _over(self) -> tuple[Noise, Noise | None]:
        """Over the sample up to the measurement, and over what is left of it; None where that is nothing."""
        flow, period = self.sample.parts.flow, self.sample.period
        late = noise_over(flow, self.into, self._early) if self._early else None
        return noise_over(flow, self.into, period - self._early), late

    @cached_property
    def _between(self) -> Vector:
        """From the measurement to the end of the sample."""
        from scipy.linalg import expm  # noqa: PLC0415  (loads slowly)

        return np.asarray(expm(self.sample.parts.flow * self._early), dtype=np.float64)

    @cached_property
    def _joint(self) -> Vector:
        """A factor of the covariance of the noise at the end of a sample and at the measurement, (2 n_s, …)."""
        early, late = self._over
        first = np.vstack([self._between @ early.factor, early.factor])
        if late is None:
            return first
        return np.hstack([first, np.vstack([late.factor, np.zeros_like(late.factor)])])

    @cached_property
    def _entering(self) -> Vector:
        """N (n_x, 2 n_s): where that noise goes: into the state, and by the measurement into law and force."""
        p, n, k = self.sample.parts, len(self.sample.parts.flow), len(self.sample.parts.law)
        found = np.zeros((len(self.sample.matrix), 2 * n))
        found[:n, :n] = np.eye(n)
        found[n : n + k, n:] = p.law[:, k:] @ p.measured
        found[-len(p.force) :, n:] = p.force[:, k:] @ p.measured
        return found

    @property
    def _lifts(self) -> tuple[Vector, Vector]:
        """From states to what is left of them (n, n_x), and back."""
        return self.kept / self.scale, (self.kept * self.scale).T

    @cached_property
    def _left(self) -> tuple[Vector, Vector, Vector]:
        """A, G and C of what is left: its motion in a sample, the noise that comes in, the end-point."""
        down, up = self._lifts
        return down @ self.sample.matrix @ up, down @ self._entering @ self._joint, self._shown @ up

    @cached_property
    def _solved(self) -> tuple[Vector, Vector]:
        """Z and F: Z Zᵀ is the covariance of what is left, Fᵀ F the end-point's variance by what comes in there."""
        matrix, come, shown = self._left
        return summed(matrix, come), summed(matrix.T, shown.T).T

    @cached_property
    def _products(self) -> tuple[Vector, Vector]:
        """Z Zᵀ and Fᵀ F to rounding: where slow motions lie close, factors summed in doubles leave derivatives 1e-7."""
        (matrix, come, shown), (z, f) = self._left, self._solved
        return summed_to_rounding(matrix, come, z @ z.T), summed_to_rounding(matrix.T, shown.T, f.T @ f)

    @cached_property
    def _neutral(self) -> Vector:
        """Orthonormal columns V of what was divided out, of balanced states."""
        return np.linalg.svd(self.kept)[2][len(self.kept) :].T

    @cached_property
    def _shown(self) -> Vector:
        """The end-point's displacement as rows of the states (r, n_x)."""
        p = self.sample.parts
        rows = p.measured[: len(p.measured) // 2]
        return np.hstack([rows, np.zeros((len(rows), len(self.sample.matrix) - rows.shape[1]))])

    @cached_property
    def norm(self) -> float:
        """The root of the variance, m for forces of unit intensity; infinite where nothing holds what it sees.

        NaN at a border of stability, and so near it that rounding decides the value.
        """
        shown = self._shown * self.scale
        if np.linalg.norm(shown @ self._neutral) > SEEN * np.linalg.norm(shown):
            return math.inf
        found = float(np.linalg.norm(self._shown @ self._lifts[1] @ self._solved[0]))
        return found if 0 < found < math.inf and self.doubt < DOUBTED else math.nan

    @cached_property
    def doubt(self) -> float:
        """By how much of itself the norm changes, to first order, where all motions decay by rounding less in a sample.

        d‖·‖² = 2 tr(FᵀF dΦ Z Zᵀ Φᵀ) with dΦ = ROUNDING Φ. What is lost beyond that is less, except beside a border.
        """
        (matrix, _, shown), (z, f) = self._left, self._solved
        return ROUNDING * float(np.sum((f @ matrix @ z) ** 2) / np.sum((shown @ z) ** 2))

    def slopes(self) -> tuple[Slopes, Vector]:
        """Its derivative by what a sample is made of, and by B_d (n_s, n_p)."""
        p, (down, up), entering, joint = self.sample.parts, self._lifts, self._entering, self._joint
        z_z, f_f, f = up @ self._products[0] @ up.T, down.T @ self._products[1] @ down, self._solved[1] @ down
        n, k, r, half = len(p.flow), len(p.law), len(p.force), 1 / (2 * self.norm)
        seen = f @ entering
        by_entering = 2 * half * f_f @ (entering @ joint) @ joint.T
        of_law, of_force = by_entering[n : n + k, n:], by_entering[-r:, n:]
        at_end, between = seen[:, :n], self._between
        (early, late), at_measured = self._over, at_end @ between + seen[:, n:]
        flow, into = noise_slopes(p.flow, early, at_measured)
        by_between = 2 * at_end.T @ (at_measured @ early.factor) @ early.factor.T
        # A later measurement: less time after it, more before.
        later = float(np.sum(by_between * (p.flow @ between))) - float(np.sum((at_measured @ early.grown) ** 2))
        if late is None:
            later += float(np.sum((at_end @ self.into) ** 2))
        else:
            more = noise_slopes(p.flow, late, at_end)
            flow, into = flow + more[0] + through_held(p.flow, self._early, by_between), into + more[1]
            later += float(np.sum((at_end @ late.grown) ** 2))
        by_measured = p.law[:, k:].T @ of_law + p.force[:, k:].T @ of_force
        by_measured[: len(p.measured) // 2] += 2 * half * (self._shown @ z_z)[:, :n]
        law, force = np.zeros_like(p.law), np.zeros_like(p.force)
        law[:, k:], force[:, k:] = of_law @ p.measured.T, of_force @ p.measured.T
        untouched = {name: np.zeros_like(getattr(p, name)) for name in ("drive", "direct", "spread")}
        rest = Parts(flow=half * flow, force=force, law=law, measured=by_measured, **untouched)
        by_matrix = 2 * half * f_f @ self.sample.matrix @ z_z + self._through_neutral()
        return self.sample.slopes(by_matrix) + Slopes(rest, half * later), half * into

    def _through_neutral(self) -> Vector:
        """By Φ, what the norm changes because what is divided out turns with it.

        Φ V = V R, U V = 0 stay so: U dV = Z with A Z − Z R = −U dΦ V, A = U Φ Uᵀ; dA = U dΦ Uᵀ − Z Vᵀ Φ Uᵀ and
        d(U N) = U dN − Z Vᵀ N, N what comes in. The end-point sees nothing of V, before and after.
        """
        from scipy.linalg import solve_sylvester  # noqa: PLC0415  (loads slowly)

        aside, kept, (z, f) = self._neutral, self.kept, self._solved
        if not aside.size:
            return np.zeros_like(self.sample.matrix)
        whole = self.sample.matrix / self.scale[:, None] * self.scale
        entering = self._entering / self.scale[:, None]
        matrix = kept @ whole @ kept.T
        come = entering @ self._joint
        moved = (f @ matrix @ z) @ z.T @ kept @ whole.T + (f @ kept @ come) @ come.T
        by_turn = f.T @ moved @ aside / self.norm
        found = kept.T @ solve_sylvester(matrix.T, -(aside.T @ whole @ aside).T, by_turn) @ aside.T
        return found / self.scale[:, None] * self.scale


def summed(matrix: Vector, factor: Vector) -> Vector:
    """Z of Z Zᵀ = Σ Aᵏ G Gᵀ Aᵀᵏ, the solution of X = A X Aᵀ + G Gᵀ, by doubling; NaN where A's powers do not decay.

    So they do not at a border of stability, which is on this side of it by rounding alone.
    """
    found, power = _joined(factor), matrix
    for _ in range(DOUBLINGS):
        size = np.abs(power).max(initial=0.0)
        if size <= VANISHED:
            return found
        if not size < GROWN:
            break
        found, power = _joined(found, power @ found), power @ power
    return np.full_like(found, math.nan)


def summed_to_rounding(matrix: Vector, factor: Vector, found: Vector) -> Vector:
    """X = A X Aᵀ + G Gᵀ (n, n), from X in doubles: by what it leaves over, exactly, summed in doubles."""
    more, power = left_over(matrix, factor, found), matrix
    for _ in range(DOUBLINGS):
        more, power = more + power @ more @ power.T, power @ power
        if not np.abs(power).max(initial=0.0) > VANISHED:
            break
    return found + more if np.linalg.norm(more) < CORRECTED * np.linalg.norm(found) else found


def left_over(matrix: Vector, factor: Vector, found: Vector, *, wide: bool = WIDE) -> Vector:
    """G Gᵀ + A X Aᵀ − X: in wider numbers where the processor has them, else in decimals, tens of times as slow."""
    if wide:
        a, g, x = (m.astype(np.longdouble) for m in (matrix, factor, found))
        return np.asarray(g @ g.T + a @ x @ a.T - x, dtype=np.float64)
    with digits(CARRIED):
        a, g, x = exact(matrix), exact(factor), exact(found)
        return rounded(g @ g.T + a @ x @ a.T - x)
