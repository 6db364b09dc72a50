"""How configurations of one program share its variables.

Data: indices and matrices; knows nothing of machines.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flexopt.foundation.arrays import Vector

# Directions that move a configuration by less than this do not.
APART = 1e-9


@dataclass(frozen=True)
class Coupling:
    """How K configurations share the variables x: where each finds its z, and which entries are near each other.

    Attributes:
        places: for each configuration the indices in x of its z, (K, n_z).
        pairs: indices (i, j) of entries of which x_j − x_i is bounded.
    """

    places: tuple[tuple[int, ...], ...]
    pairs: tuple[tuple[int, int], ...] = ()

    @property
    def count(self) -> int:
        """Number of configurations, K."""
        return len(self.places)

    @cached_property
    def n_x(self) -> int:
        """Number of variables, the level t of "worst" left out."""
        return 1 + max(max(place) for place in self.places)

    def steps(self, n_x: int) -> Vector:
        """The matrix of the differences x_j − x_i, (pairs, n_x)."""
        matrix = np.zeros((len(self.pairs), n_x))
        for row, (i, j) in enumerate(self.pairs):
            matrix[row, i], matrix[row, j] = -1.0, 1.0
        return matrix


def own_directions(free: Vector, place: Sequence[int]) -> tuple[Vector, Vector]:
    """What directions (d, n_x) move of the entries at a place, as along @ basis: (d, e), and orthonormal, (e, n_z)."""
    own = free[:, list(place)]
    _, reach, basis = np.linalg.svd(own, full_matrices=False)
    basis = basis[reach > APART]
    return own @ basis.T, basis


def widened(slopes: Vector, place: Iterable[int], n_x: int) -> Vector:
    """Slopes (…, n_x) by all x of those (…, n_z) by the entries at a place."""
    wide = np.zeros((*slopes.shape[:-1], n_x))
    wide[..., list(place)] = slopes
    return wide


def alone(n_z: int) -> Coupling:
    """The coupling of one configuration with nothing: x is its z."""
    return Coupling((tuple(range(n_z)),))
