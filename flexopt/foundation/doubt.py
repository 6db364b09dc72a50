"""A number and what it may be off by, as text."""

from __future__ import annotations

import math

# A number with an error has two digits of it, unless it is below this share of the number; more decimals, or zeros
# before the point, are written as a power of ten.
BELOW, LONGEST = 5e-6, 8


def with_doubt(value: float, error: float | None) -> str:
    """As far as its digits are known: `0.3 ± 1.3`, `1.234 ± 0.012`; five digits where it has no error."""
    # An error that is less than what five digits leave out would claim more of them than it holds for.
    if not error or not math.isfinite(value + error) or error < BELOW * abs(value):
        return f"{value:.5g}"
    decimals = 1 - math.floor(math.log10(error))
    if not -LONGEST < decimals < LONGEST:
        digits = max(1, math.floor(math.log10(abs(value) or error)) + decimals + 1)
        return f"{value:#.{digits}g} ± {error:#.2g}"
    told, doubt = (f"{round(number, decimals):z.{max(decimals, 0)}f}" for number in (value, error))
    return f"{told} ± {doubt}"
