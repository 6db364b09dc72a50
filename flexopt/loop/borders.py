"""Where a growth rate changes its sign: all stable intervals of a gain, narrow ones and gaps included.

In: a growth rate as a function of the exponent of a gain's multiple. Out: intervals of the multiple.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

from flexopt.foundation.arrays import Interval
from flexopt.foundation.roots import border

# Multiples of the gains that are searched for borders, as exponents of 10, and how many at first.
LOW, HIGH, POINTS = -4.0, 4.0, 241
# Relative width to which a narrow interval between two gains is looked for, and exponents to which a border is found.
NARROW, BORDER = 1e-3, 1e-10


def stable_intervals(
    growth: Callable[[float], float], rounding: float, known: list[float] | None = None
) -> tuple[Interval, ...]:
    """Intervals of the multiple in which `growth` is negative; 10^LOW or 10^HIGH where the search met no border.

    Args:
        growth: of the exponent.
        rounding: growth down to minus this is none: of a motion that nothing damps it is rounding alone.
        known: growth at the `POINTS` exponents from LOW to HIGH, where it is known.
    """
    exponents = np.linspace(LOW, HIGH, POINTS).tolist()
    grid = _with_narrow(growth, exponents, [growth(x) for x in exponents] if known is None else known)
    stable = np.array([value < -rounding for _, value in grid])
    edges = np.flatnonzero(stable[1:] != stable[:-1])
    roots = [border(growth, grid[i][0], grid[i + 1][0], xtol=BORDER) for i in edges.tolist()]
    ends = [10**x for x in ([LOW] if stable[0] else []) + roots + ([HIGH] if stable[-1] else [])]
    return tuple(zip(ends[::2], ends[1::2], strict=True))


def highest_stable(growth: Callable[[float], float], rounding: float) -> float:
    """The multiple up to which, from 1 on, `growth` is negative; where it is not at 1 the largest below at which it is.

    As the border of an interval of `stable_intervals`, with growth, which is slow to compute, looked at from 1 on up to
    there only. 10^HIGH where no border is met, 0 where none is stable.
    """
    growth = cache(growth)
    exponents, here = np.linspace(LOW, HIGH, POINTS), POINTS // 2
    up = growth(0.0) < -rounding
    # Outward, with the one on the other side of 1 first: between it and the next there may be a gap.
    way = (exponents[here - 1 :] if up else exponents[here + 1 :: -1]).tolist()
    for three in zip(way, way[1:], way[2:], strict=False):
        ordered = sorted(three)
        seen = _with_narrow(growth, ordered, [growth(x) for x in ordered])
        outward = [(x, value < -rounding) for x, value in (seen if up else reversed(seen)) if (x >= 0) == up or x == 0]
        for (at, _), (further, stable) in pairwise(outward):
            if stable != up:
                return 10 ** border(growth, at, further, xtol=BORDER)
    return 10**HIGH if up else 0.0


def _with_narrow(growth: Callable[[float], float], grid: list[float], values: list[float]) -> list[tuple[float, float]]:
    """Exponents and growth rates, ascending, with the extremes between them that change the sign.

    An interval narrower than the grid shows as a valley above zero, or a gap as a hill below it.
    """
    from scipy.optimize import minimize_scalar  # noqa: PLC0415  (loads slowly)

    found = list(zip(grid, values, strict=True))
    for before, here, after, left, right in zip(values, values[1:], values[2:], grid, grid[2:], strict=False):
        sign = 1.0 if here > 0 else -1.0
        # A valley of |growth|, all of one sign.
        if sign * here <= sign * before and sign * here <= sign * after and sign * before > 0 and sign * after > 0:

            def size(x: float, sign: float = sign) -> float:
                return sign * growth(x)

            best: Any = minimize_scalar(
                size, bounds=(left, right), method="bounded",
                options={"xatol": math.log10(1 + NARROW) / 10},
            )  # fmt: skip
            if best.fun < 0:
                found.append((float(best.x), sign * float(best.fun)))
    return sorted(found)
