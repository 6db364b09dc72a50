"""What arrays hold, and what public calls take, as types; points spread evenly."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Of any shape.
Array = NDArray[np.float64]
Vector = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Mask = NDArray[np.bool_]
# Lower and upper end.
Interval = tuple[float, float]
# As files give them.
Numbers = tuple[float, ...]

# What signatures of public calls say, a name for each kind; the reference has a page of them. Values are checked and
# made plain at the boundary (`boundary.py`), so that bodies hold what these are cast to.
Number = float | np.floating[Any] | np.integer[Any]
ArrayLike = Number | Sequence[Number] | NDArray[np.floating[Any] | np.integer[Any]]
MatrixLike = ArrayLike | Sequence[Sequence[Number]]
ComplexLike = complex | Sequence[complex] | NDArray[np.number[Any]]
MaskLike = Sequence[Sequence[bool]] | NDArray[np.bool_ | np.number[Any]]
PostureLike = ArrayLike
BaseLike = ArrayLike
TargetLike = ArrayLike
TargetsLike = Sequence[TargetLike] | NDArray[np.floating[Any] | np.integer[Any]]
GainLike = ArrayLike
RangeLike = Sequence[Number] | NDArray[np.floating[Any] | np.integer[Any]]
BaseRangeLike = RangeLike | Mapping[str, RangeLike]
PointsLike = Sequence[int] | NDArray[np.integer[Any]]
TableLike = Mapping[str, object]
# What a call gives as plain data: keys, and under them numbers, words, lists and tables, as JSON has them.
Document = dict[str, Any]
# Called with how much is done and how much there is in all.
Progress = Callable[[int, int], None]


def in_columns(values: Vector) -> Vector:
    """A vector (n,) as one column (n, 1), columns (n, N) as they are; n may be 0."""
    return values if values.ndim > 1 else values[:, None]


def spread(count: int, size: int) -> Array:
    """Points of the unit cube, (count, size), spread evenly by multiples of irrational numbers, always the same.

    As random ones would be; `numpy.random` takes longer to import than what needs a few of them.
    """
    return np.modf(np.outer(1.0 + np.arange(count), np.sqrt(2.0 + 3.0 * np.arange(size))))[0]
