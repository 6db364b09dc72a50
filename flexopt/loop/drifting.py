"""A sampled loop without what drifts of it, and derivatives through that.

In: Φ of x_{k+1} = Φ x_k, of which only a redundant arm's self-motion grows. Out: Φ (1 − P), P the projector along all
other motions onto those that grow. What was taken out never comes back, not by rounding either.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.loop.spectrum import balance, without_neutral


class _Growing(NamedTuple):
    """Φ X = X M, Yᵀ Φ = M Yᵀ, Yᵀ X = 1, balanced; of what grows, in real numbers, however near its motions are."""

    right: Vector
    inner: Vector
    left: Vector


@dataclass(frozen=True, eq=False)
class WithoutDrift:
    """One sample of a loop without its motions that grow.

    Attributes:
        whole: Φ (n, n).
        neutral: in how many directions it may rest elsewhere, as of `neutral_directions`; these stay.
    """

    whole: Vector
    neutral: int

    @cached_property
    def _balanced(self) -> tuple[Vector, Vector]:
        return balance(self.whole)

    @cached_property
    def _growing(self) -> _Growing:
        from scipy.linalg import null_space, schur  # noqa: PLC0415  (loads slowly)

        ordered: Any = schur
        balanced, _ = self._balanced
        held, kept = without_neutral(balanced, self.neutral)
        triangular, basis, count = ordered(held, output="real", sort="ouc")
        inner, right = triangular[:count, :count], basis[:, :count]
        aside = _sylvester(inner, -triangular[count:, count:], triangular[:count, count:])
        left = kept.T @ (right + basis[:, count:] @ aside.T)
        # What rests anywhere is moved along: of that the motions that are left know nothing.
        resting: Vector = null_space(kept) if len(held) < len(balanced) else np.zeros((len(balanced), 0))
        right = kept.T @ right
        along = _sylvester(-resting.T @ balanced @ resting, inner, resting.T @ balanced @ right)
        return _Growing(right + resting @ along, inner, left)

    @cached_property
    def remains(self) -> Vector:
        """1 − P (n, n): of a state what does not drift."""
        _, scale = self._balanced
        return self._scaled(self._remains, scale)

    @property
    def _remains(self) -> Vector:
        right, _, left = self._growing
        return np.eye(len(self.whole)) - right @ left.T

    @staticmethod
    def _scaled(matrix: Vector, scale: Vector) -> Vector:
        """D A D⁻¹."""
        return scale[:, None] * matrix / scale

    @cached_property
    def matrix(self) -> Vector:
        """Φ (1 − P) (n, n)."""
        return self.whole @ self.remains

    def through(self, by_matrix: Vector, by_remains: Vector) -> Vector:
        """A derivative by Φ, from those by `matrix` and by `remains`.

        dP = Z Yᵀ + X W, Z M − Φ (1 − P) Z = (1 − P) dΦ X, M W − W Φ (1 − P) = Yᵀ dΦ (1 − P).
        """
        (balanced, scale), (right, inner, left), remains = self._balanced, self._growing, self._remains
        by = -self._scaled(by_remains + self.whole.T @ by_matrix, scale)
        decaying = balanced @ remains
        columns = _sylvester(-decaying.T, inner.T, by @ left)
        rows = _sylvester(inner.T, -decaying.T, right.T @ by)
        found = remains.T @ columns @ right.T + left @ rows @ remains.T
        return by_matrix @ self.remains.T + self._scaled(found, 1 / scale)


def _sylvester(first: Vector, second: Vector, total: Vector) -> Vector:
    """X of A X + X B = C, which may have no rows or columns."""
    from scipy.linalg import solve_sylvester  # noqa: PLC0415  (loads slowly)

    solved: Any = solve_sylvester
    return solved(first, second, total) if total.size else np.zeros_like(total)
