"""Named parts of one vector: how its entries lie, as graphs and as arrays."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import accumulate, pairwise
from typing import Any, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Symbolic = TypeVar("Symbolic", ca.SX, ca.MX)


class Layout:
    """Named parts of a column."""

    def __init__(self, sizes: Mapping[str, int]) -> None:
        self.sizes = dict(sizes)
        self._edges = [0, *accumulate(self.sizes.values())]
        self.total = self._edges[-1]
        self.slices = {name: slice(*ends) for name, ends in zip(sizes, pairwise(self._edges), strict=True)}

    def split(self, column: Symbolic) -> dict[str, Symbolic]:
        """The parts of a column by name."""
        parts: list[Any] = ca.vertsplit(column, self._edges)
        return dict(zip(self.sizes, parts, strict=True))

    def packed(self, parts: Mapping[str, Any]) -> NDArray[np.float64]:
        """One array (total, 1) or (total, N) from parts (size,) or (size, N), those for all members repeated."""
        columns = [np.asarray(parts[name], dtype=np.float64) for name in self.sizes]
        n = max((part.size // size for part, size in zip(columns, self.sizes.values(), strict=True) if size), default=1)
        result = np.empty((self.total, n))
        for part, where, size in zip(columns, self.slices.values(), self.sizes.values(), strict=True):
            result[where] = part.reshape(size, -1) if size else 0.0
        return result
