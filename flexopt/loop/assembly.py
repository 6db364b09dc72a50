"""One sample of the linear loop from its parts, exactly, for any dead time, and derivatives back through it.

In: `Parts`, a period, a dead time. Out: Φ = Φ₀ + Γ F of x_{k+1} = Φ₀ x_k + Γ f_k, f_k = F x_k, and what a derivative by
Φ₀, Γ and F is by the parts: through the matrix exponential by its Fréchet derivative, which is exact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.loop.small_motions import Parts
from flexopt.loop.tangent import exponential
from flexopt.model.simulation import PART_OF_SAMPLE

# States and inputs up to which the exponential's derivative is taken from one of twice the size.
SMALL = 20


@dataclass(frozen=True)
class Slopes:
    """A derivative by what a sample is made of: by the parts, and by the dead time, 1/s."""

    parts: Parts
    dead_time: float

    def __add__(self, other: Slopes) -> Slopes:
        pairs = {f.name: getattr(self.parts, f.name) + getattr(other.parts, f.name) for f in fields(Parts)}
        return Slopes(Parts(**pairs), self.dead_time + other.dead_time)

    def __mul__(self, factor: float) -> Slopes:
        scaled = {f.name: factor * getattr(self.parts, f.name) for f in fields(Parts)}
        return Slopes(Parts(**scaled), factor * self.dead_time)


@dataclass(frozen=True)
class OneSample:
    """One sample of a loop, states x = [s, law, forces on their way, oldest first].

    Dead time stands behind the law: what is delayed is its force f, which commutes with a law that does not change.

    Attributes:
        parts: of the loop; of N loops, with matrices (N, …, …), all but derivatives then are (N, …, …), too.
        period: of a sample, s.
        dead_time: from the end-point's measurement to the command, s.
        differentiable: whole samples of dead time are taken as one more, less nothing, so that derivatives by it exist;
            they are those of a longer dead time, from which those of a shorter one differ there.
    """

    parts: Parts
    period: float
    dead_time: float = 0.0
    differentiable: bool = False

    @cached_property
    def waiting(self) -> tuple[int, float]:
        """Forces on their way, and how long before the end of the sample the newest measurement is taken, s."""
        samples = self.dead_time / self.period
        whole = round(samples)
        if abs(samples - whole) <= PART_OF_SAMPLE:
            return (whole + 1, 0.0) if self.differentiable else (whole, 0.0)
        return int(samples) + 1, self.dead_time - math.floor(samples) * self.period

    @property
    def _early(self) -> bool:
        """Whether measurements are taken within the sample."""
        return self.waiting[1] > 0 or self.differentiable

    @cached_property
    def _places(self) -> tuple[slice, slice, slice, int]:
        """Where s, the law's states and the oldest force stand in x, and how many states there are."""
        n, k, r = (matrix.shape[-2] for matrix in (self.parts.flow, self.parts.law, self.parts.force))
        waiting = self.waiting[0]
        return slice(n), slice(n, n + k), slice(n + k, n + k + r * min(waiting, 1)), n + k + r * waiting

    @cached_property
    def _spans(self) -> list[tuple[float, Vector, Vector]]:
        """Of the whole sample, and of its part up to the newest measurement: length, e^{Ah}, Γ(h)."""
        whole = self.period, *exponential(self.parts.flow, self.parts.drive, self.period)
        part = self.period - self.waiting[1]
        return [whole, whole if part == self.period else (part, *exponential(self.parts.flow, self.parts.drive, part))]

    @cached_property
    def _measured(self) -> tuple[Vector, Vector]:
        """The newest measurement of s and of the oldest force."""
        p, (_, held, push) = self.parts, self._spans[1]
        r = self._places[2].stop - self._places[2].start
        if not self._early:
            return p.measured, np.zeros((*p.measured.shape[:-1], r))
        return p.measured @ (held + push @ p.direct), p.measured @ push @ p.spread

    @cached_property
    def open(self) -> Vector:
        """Φ₀ (n_x, n_x): the loop whose law asks for nothing more."""
        p, (s, law, oldest, size), (_, held, push) = self.parts, self._places, self._spans[0]
        (of_state, of_force), k, r = self._measured, p.law.shape[-2], p.force.shape[-2]
        found, asked = np.zeros((*p.flow.shape[:-2], size, size)), p.law[..., k:]
        found[..., s, s] = held + push @ p.direct
        found[..., law, s], found[..., law, law] = asked @ of_state, p.law[..., :k]
        if self.waiting[0]:
            found[..., s, oldest], found[..., law, oldest] = push @ p.spread, asked @ of_force
            found[..., oldest.start : size - r, oldest.stop :] = np.eye(size - oldest.stop)
        return found

    @cached_property
    def into(self) -> Vector:
        """Γ (n_x, r): where the law's force goes."""
        p, (s, _, _, size), (_, _, push) = self.parts, self._places, self._spans[0]
        r = p.force.shape[-2]
        found = np.zeros((*p.flow.shape[:-2], size, r))
        if self.waiting[0]:
            found[..., -r:, :] = np.eye(r)
        else:
            found[..., s, :] = push @ p.spread
        return found

    @cached_property
    def force(self) -> Vector:
        """F (r, n_x)."""
        p, (s, law, oldest, size), (of_state, of_force) = self.parts, self._places, self._measured
        found, k = np.zeros((*p.force.shape[:-1], size)), p.law.shape[-2]
        found[..., s], found[..., law] = p.force[..., k:] @ of_state, p.force[..., :k]
        found[..., oldest] = p.force[..., k:] @ of_force
        return found

    @cached_property
    def matrix(self) -> Vector:
        """Φ (n_x, n_x)."""
        return self.open + self.into @ self.force

    def later(self, dead_time: float) -> OneSample:
        """The same loop with another dead time."""
        return replace(self, dead_time=dead_time)

    def slopes(self, by_matrix: Vector, factor: float = 1.0) -> Slopes:
        """A derivative by the parts and the dead time, from that by Φ₀ + factor · Γ F."""
        return self.all_slopes(by_matrix, factor * by_matrix @ self.force.T, factor * self.into.T @ by_matrix)

    def all_slopes(self, by_open: Vector, by_into: Vector, by_force: Vector) -> Slopes:
        """The like from derivatives by Φ₀, Γ and F, each of its own; by the dead time NaN unless `differentiable`."""
        p, (s, law, oldest, _), (of_state, of_force) = self.parts, self._places, self._measured
        (span, _, push), (part, held_part, push_part) = self._spans
        k = len(p.law)
        asked, drawn = p.law[:, k:], p.force[:, k:]
        by_law = np.hstack([by_open[law, law], by_open[law, s] @ of_state.T + by_open[law, oldest] @ of_force.T])
        by_f = np.hstack([by_force[:, law], by_force[:, s] @ of_state.T + by_force[:, oldest] @ of_force.T])
        by_state = asked.T @ by_open[law, s] + drawn.T @ by_force[:, s]
        by_old = asked.T @ by_open[law, oldest] + drawn.T @ by_force[:, oldest]
        by_held, by_driven = by_open[s, s], by_open[s, oldest] if self.waiting[0] else by_into[s]
        direct, spread = push.T @ by_held, push.T @ by_driven
        by_push = by_held @ p.direct.T + by_driven @ p.spread.T
        flow, drive = through_exponential(p.flow, p.drive, span, by_held, by_push)
        if not self._early:
            return Slopes(Parts(flow, drive, direct, spread, by_f, by_law, by_state), math.nan)
        by_measured = by_state @ (held_part + push_part @ p.direct).T + by_old @ (push_part @ p.spread).T
        by_held, by_driven = p.measured.T @ by_state, p.measured.T @ by_old
        direct, spread = direct + push_part.T @ by_held, spread + push_part.T @ by_driven
        by_push = by_held @ p.direct.T + by_driven @ p.spread.T
        more = through_exponential(p.flow, p.drive, part, by_held, by_push)
        dead_time = -float(np.sum(by_held * (p.flow @ held_part)) + np.sum(by_push * (held_part @ p.drive)))
        parts = Parts(flow + more[0], drive + more[1], direct, spread, by_f, by_law, by_measured)
        return Slopes(parts, dead_time)


def through_exponential(
    flow: Vector, drive: Vector, span: float, by_held: Vector, by_push: Vector
) -> tuple[Vector, Vector]:
    """Derivatives by A and B from those by e^{Ah} and Γ(h): the adjoint of the exponential's Fréchet derivative.

    Source: Higham, Functions of Matrices, 2008, section 10.6.
    """
    from scipy.linalg import expm  # noqa: PLC0415  (loads slowly)

    n, m = drive.shape
    block, by = np.zeros((n + m, n + m)), np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:], by[:n, :n], by[:n, n:] = flow, drive, by_held, by_push
    found: Vector
    if n + m <= SMALL:
        # The upper right block of one exponential of twice the size: quicker where calls cost more than arithmetic.
        doubled = np.zeros((2 * (n + m), 2 * (n + m)))
        doubled[: n + m, : n + m] = doubled[n + m :, n + m :] = span * block.T
        doubled[: n + m, n + m :] = by
        found = expm(doubled)[: n + m, n + m :] * span
    else:
        found = through_held(block, span, by)
    return found[:n, :n], found[:n, n:]


def through_held(flow: Vector, span: float, by_held: Vector) -> Vector:
    """The derivative by A from that by e^{Ah} alone."""
    from scipy.linalg import expm_frechet  # noqa: PLC0415  (loads slowly)

    found: Vector = np.real(expm_frechet(span * flow.T, by_held, compute_expm=False, check_finite=False)) * span
    return found
