"""What forces on the base do to the end-point of a sampled loop: the H2 norm, with its exact derivative.

In: a loop at numbers. Out: the root of the end-point's variance at the samples under white noise of unit intensity on
every passive coordinate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.loop.assembly import OneSample, Slopes
from flexopt.loop.small_motions import Parts

# Share of what the end-point shows at all above which it sees what nothing holds.
SEEN = 1e-6
# Powers of Φ that have vanished; a loop that decays by 1e-9 in a sample needs 36 doublings until they have.
VANISHED, DOUBLINGS = 1e-20, 64


class Noise(NamedTuple):
    """White noise of unit intensity through B into ẋ = A x, over a time: doublings of a short one.

    Attributes:
        spans: e^{Ah} and W(h) = ∫₀ʰ e^{As} B Bᵀ e^{Aᵀs} ds, h the short time, then each time twice as long.
        short: h, s.
    """

    spans: list[tuple[Vector, Vector]]
    short: float

    @property
    def covariance(self) -> Vector:
        """W (n, n) over the whole time."""
        return self.spans[-1][1]


def noise_over(flow: Vector, into: Vector, span: float) -> Noise:
    """The noise that has come in over a time.

    Source: Van Loan, IEEE Transactions on Automatic Control 23(3), 1978, for the short time.
    """
    from scipy.linalg import expm  # noqa: PLC0415  (loads slowly)

    n, fastest = len(flow), float(np.abs(np.linalg.eigvals(flow)).max(initial=0.0))
    doublings = max(0, math.ceil(math.log2(max(fastest * span, 1.0))))
    short = span / 2**doublings
    whole: Vector = np.asarray(expm(_hamiltonian(flow, into) * short), dtype=np.float64)
    held = whole[:n, :n]
    spans: list[tuple[Vector, Vector]] = [(held, whole[:n, n:] @ held.T)]
    for _ in range(doublings):
        held, come = spans[-1]
        spans.append((held @ held, come + held @ come @ held.T))
    return Noise(spans, short)


def _hamiltonian(flow: Vector, into: Vector) -> Vector:
    return np.block([[flow, into @ into.T], [np.zeros_like(flow), -flow.T]])


def noise_slopes(flow: Vector, into: Vector, noise: Noise, by_covariance: Vector) -> tuple[Vector, Vector]:
    """Derivatives by A and B, from that by W."""
    from scipy.linalg import expm_frechet  # noqa: PLC0415  (loads slowly)

    n = len(flow)
    by_come, by_held = (by_covariance + by_covariance.T) / 2, np.zeros((n, n))
    for held, come in reversed(noise.spans[:-1]):
        by_held = 2 * by_come @ held @ come + by_held @ held.T + held.T @ by_held
        by_come = by_come + held.T @ by_come @ held
    held, come = noise.spans[0]
    pushed, by_whole = np.linalg.solve(held, come).T, np.zeros((2 * n, 2 * n))
    by_whole[:n, :n], by_whole[:n, n:] = by_held + by_come @ pushed, by_come @ held
    block = _hamiltonian(flow, into).T * noise.short
    found = np.real(expm_frechet(block, by_whole, compute_expm=False, check_finite=False)) * noise.short
    by_square = found[:n, n:]
    return found[:n, :n] - found[n:, n:].T, (by_square + by_square.T) @ into


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
    def _over(self) -> tuple[Noise, Noise]:
        """Over a sample, and over its part up to the measurement."""
        p, period = self.sample.parts, self.sample.period
        whole = noise_over(p.flow, self.into, period)
        return whole, noise_over(p.flow, self.into, period - self._early) if self._early else whole

    @cached_property
    def _between(self) -> Vector:
        """From the measurement to the end of the sample."""
        from scipy.linalg import expm  # noqa: PLC0415  (loads slowly)

        return np.asarray(expm(self.sample.parts.flow * self._early), dtype=np.float64)

    @cached_property
    def _joint(self) -> Vector:
        """Covariance of the noise at the end of a sample and at the measurement (2 n_s, 2 n_s)."""
        whole, part = (noise.covariance for noise in self._over)
        crossed = self._between @ part
        return np.block([[whole, crossed], [crossed.T, part]])

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
    def _solved(self) -> tuple[Vector, Vector]:
        """Covariance X of what is left, and Y of the end-point's variance by what comes in there, both (n, n)."""
        down, up = self._lifts
        matrix = down @ self.sample.matrix @ up
        shown = self._shown @ up
        entering = down @ self._entering
        return _summed(matrix, entering @ self._joint @ entering.T), _summed(matrix.T, shown.T @ shown)

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
        """The root of the variance, m for forces of unit intensity; infinite where nothing holds what it sees."""
        shown = self._shown * self.scale
        if np.linalg.norm(shown @ self._neutral) > SEEN * np.linalg.norm(shown):
            return math.inf
        shown = self._shown @ self._lifts[1]
        variance = float(np.trace(shown @ self._solved[0] @ shown.T))
        return math.sqrt(variance) if variance > 0 else math.nan

    def slopes(self) -> tuple[Slopes, Vector]:
        """Its derivative by what a sample is made of, and by B_d (n_s, n_p)."""
        p, (down, up), entering, joint = self.sample.parts, self._lifts, self._entering, self._joint
        x, y = up @ self._solved[0] @ up.T, down.T @ self._solved[1] @ down
        n, k, r, half = len(p.flow), len(p.law), len(p.force), 1 / (2 * self.norm)
        by_entering = 2 * half * y @ entering @ joint
        of_law, of_force = by_entering[n : n + k, n:], by_entering[-r:, n:]
        by_joint = half * entering.T @ y @ entering
        crossed = by_joint[:n, n:] + by_joint[n:, :n].T
        (whole, part), between = self._over, self._between
        flow, into = noise_slopes(p.flow, self.into, whole, by_joint[:n, :n])
        by_part = by_joint[n:, n:] + between.T @ crossed
        more = noise_slopes(p.flow, self.into, part, by_part)
        by_between = crossed @ part.covariance
        flow, into = flow + more[0] + self._through_between(by_between), into + more[1]
        # A later measurement: less time after it, more before.
        grown = p.flow @ part.covariance
        grown = grown + grown.T + self.into @ self.into.T
        late = float(np.sum(by_between * (p.flow @ between)) - np.sum((by_part + by_part.T) / 2 * grown))
        by_measured = p.law[:, k:].T @ of_law + p.force[:, k:].T @ of_force
        by_measured[: len(p.measured) // 2] += 2 * half * (self._shown @ x)[:, :n]
        law, force = np.zeros_like(p.law), np.zeros_like(p.force)
        law[:, k:], force[:, k:] = of_law @ p.measured.T, of_force @ p.measured.T
        untouched = {name: np.zeros_like(getattr(p, name)) for name in ("drive", "direct", "spread")}
        rest = Parts(flow=flow, force=force, law=law, measured=by_measured, **untouched)
        by_matrix = 2 * half * y @ self.sample.matrix @ x + self._through_neutral()
        return self.sample.slopes(by_matrix) + Slopes(rest, late), into

    def _through_neutral(self) -> Vector:
        """By Φ, what the norm changes because what is divided out turns with it.

        Φ V = V R, U V = 0 stay so: U dV = Z with A Z − Z R = −U dΦ V, A = U Φ Uᵀ; dA = U dΦ Uᵀ − Z Vᵀ Φ Uᵀ and
        d(U N) = U dN − Z Vᵀ N, N what comes in. The end-point sees nothing of V, before and after.
        """
        from scipy.linalg import solve_sylvester  # noqa: PLC0415  (loads slowly)

        aside, kept, (x, y) = self._neutral, self.kept, self._solved
        if not aside.size:
            return np.zeros_like(self.sample.matrix)
        whole = self.sample.matrix / self.scale[:, None] * self.scale
        entering = self._entering / self.scale[:, None]
        matrix = kept @ whole @ kept.T
        by_turn = y @ (matrix @ x @ kept @ whole.T + kept @ entering @ self._joint @ entering.T) @ aside / self.norm
        found = kept.T @ solve_sylvester(matrix.T, -(aside.T @ whole @ aside).T, by_turn) @ aside.T
        return found / self.scale[:, None] * self.scale

    def _through_between(self, by_between: Vector) -> Vector:
        from scipy.linalg import expm_frechet  # noqa: PLC0415  (loads slowly)

        if not self._early:
            return np.zeros_like(by_between)
        block = self.sample.parts.flow.T * self._early
        return np.real(expm_frechet(block, by_between, compute_expm=False, check_finite=False)) * self._early


def _summed(matrix: Vector, source: Vector) -> Vector:
    """X = Σ Aᵏ S Aᵀᵏ, the solution of X = A X Aᵀ + S, A a matrix whose powers decay: by doubling."""
    found, power = source, matrix
    for _ in range(DOUBLINGS):
        found, power = found + power @ found @ power.T, power @ power
        if not np.abs(power).max(initial=0.0) > VANISHED:
            break
    return found
