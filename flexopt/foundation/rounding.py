"""What of a number is rounding, and is shown as 0. Files and documents keep it."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import ArrayLike

from flexopt.foundation.arrays import Vector

# Below this share of what its terms are like a number is 0: they cancel.
ROUNDING = 1e-13
# Ways between configurations that were solved for, m or rad: less is what solving leaves.
WAY = 1e-8


def without_rounding(values: ArrayLike, scale: ArrayLike) -> Vector:
    """Numbers as they are shown, 0 where they are rounding of `scale`: for w_i |a_i||b_i|, for places 1 m or rad."""
    given = np.asarray(values, dtype=float)
    return np.where(np.abs(given) <= ROUNDING * np.asarray(scale, dtype=float), 0.0, given)


def way(length: float) -> float:
    """A way between configurations as it is shown."""
    return 0.0 if abs(length) < WAY else length


def apart(value: float, bounds: Iterable[float]) -> Callable[[float], str]:
    """How numbers are written: to four digits, or as many more as tell the value from bounds that it is not at."""
    forms = [f"{{:z.{digits}g}}".format for digits in range(4, 18)]
    others = [bound for bound in bounds if bound != value]
    return next(form for form in forms if form(value) not in [form(bound) for bound in others])
