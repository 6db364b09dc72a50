"""What arrays hold, as types; points spread evenly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Of any shape.
Array = NDArray[np.float64]
Vector = NDArray[np.float64]


def spread(count: int, size: int) -> Array:
    """Points of the unit cube, (count, size), spread evenly by multiples of irrational numbers, always the same.

    As random ones would be; `numpy.random` takes longer to import than what needs a few of them.
    """
    return np.modf(np.outer(1.0 + np.arange(count), np.sqrt(2.0 + 3.0 * np.arange(size))))[0]
