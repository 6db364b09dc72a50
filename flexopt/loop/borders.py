"""Where a growth rate changes its sign: all stable intervals of a gain, narrow ones and gaps included.

In: a growth rate as a function of the exponent of a gain's multiple. Out: intervals of the multiple.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from flexopt.foundation.arrays import Interval
from flexopt.foundation.roots import border

# Multiples of the gains that are searched for borders, as exponents of 10, and how many at first.
LOW, HIGH, POINTS = -4.0, 4.0, 241
# Relative width to which a narrow interval between two gains is looked for, and exponents to which a border is found.
NARROW, BORDER = 1e-3, 1e-10
# The first step, of exponents, from a border to that of a loop much like it.
STEP = 0.01


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


def followed(
    growth: Callable[[float], float], rounding: float, intervals: tuple[Interval, ...]
) -> tuple[Interval, ...]:
    """Intervals whose ends are moved to where `growth`, of another loop much like theirs, changes its sign.

    Each end into its interval while the loop grows, and out of it, as far as the next one, while it decays.
    """

    def grows(x: float) -> bool:
        return not growth(x) < -rounding

    found, ends = list[Interval](), [math.log10(end) for interval in intervals for end in interval]
    beyond = [LOW, *ends, HIGH]
    for k in range(0, len(ends), 2):
        low, high = (
            _walked(growth, grows, end, inward=inward, outward=outward)
            for end, inward, outward in (
                (ends[k], ends[k + 1], beyond[k]),
                (ends[k + 1], ends[k], beyond[k + 3]),
            )
        )
        if low < high:
            found.append((10**low, 10**high))
    return tuple(found)


def _walked(
    growth: Callable[[float], float], grows: Callable[[float], bool], end: float, *, inward: float, outward: float
) -> float:
    """Where the sign changes, looked for from an end in steps that double; the last that is looked at where nowhere."""
    into = grows(end)
    last = inward if into else outward
    step, at = STEP, end
    while at != last:
        further = at + math.copysign(min(step, abs(last - at)), last - at)
        if grows(further) != into:
            return border(growth, at, further, xtol=BORDER)
        at, step = further, 2 * step
    return last


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
