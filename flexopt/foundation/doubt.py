"""A number and what it may be off by, as text."""

from __future__ import annotations

import math
from typing import Literal

# A number with an error has two digits of it, unless it is below this share of the number; more decimals, or zeros
# before the point, are written as a power of ten.
BELOW, LONGEST = 5e-6, 8


def with_doubt(value: float, error: float | None, digits: int = 5, sign: Literal["-", "+"] = "-") -> str:
    """As far as its digits are known: `0.3 ± 1.3`, `1.234 ± 0.012`; with `sign` "+" also `+0.3`.

    `digits` where it has no error.
    """
    if error == math.inf and math.isfinite(value):
        return f"{value:{sign}z.{digits}g} ± inf"
    # An error that is less than what five digits leave out would claim more of them than it holds for.
    if not error or not math.isfinite(value + error) or error < BELOW * abs(value):
        return f"{value:{sign}z.{digits}g}"
    decimals = 1 - math.floor(math.log10(error))
    if not -LONGEST < decimals < LONGEST:
        known = max(1, math.floor(math.log10(abs(value) or error)) + decimals + 1)
        # `#` keeps zeros that are known, and a point behind a single digit.
        shown = f"{value:{sign}z#.{known}g}".replace(".e", "e").rstrip(".")
        return f"{shown} ± {error:#.2g}"
    places = max(decimals, 0)
    return f"{round(value, decimals):{sign}z.{places}f} ± {round(error, decimals):.{places}f}"


def in_degrees(angle: float, width: int, digits: int) -> str:
    """An angle, rad, as `12.3°`; where there is none, NaN, as `–`."""
    return f"{'–' if math.isnan(angle) else f'{math.degrees(angle):.{digits}f}°':>{width}}"
