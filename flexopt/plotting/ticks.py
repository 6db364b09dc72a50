"""Ticks of axes, and numbers beside them, where Matplotlib's own would be too few, too many or too long."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.ticker import MaxNLocator

# A range up to which an axis that is logarithmic has no powers of ten enough.
DECADES = 100.0
# Share of a number by which it differs from rounding alone.
SAME = 1e-9
# Numbers in this range are written out beside ticks.
PLAIN = 1e-4, 1e5


def shown(value: float, digits: int) -> str:
    """A number beside a tick: 13500, and a power of ten where that is longer."""
    rounded = float(f"{value:.{digits}g}")
    if rounded == 0 or PLAIN[0] <= abs(rounded) < PLAIN[1]:
        return f"{rounded:.{max(digits, 6)}g}".replace("-", "\N{MINUS SIGN}")
    power = math.floor(math.log10(abs(rounded)))
    return f"${rounded / 10.0**power:.{digits}g} \\times 10^{{{power}}}$"


def digits_of(ticks: Sequence[float]) -> int:
    """With how many digits numbers beside ticks differ, 3 at least."""
    return next((d for d in range(3, 16) if len({shown(tick, d) for tick in ticks}) == len(ticks)), 16)


def between_powers(low: float, high: float, most: int) -> list[float]:
    """Ticks of a logarithmic axis from low to high that is too short for powers of ten, at most so many."""
    first, found = math.floor(math.log10(low)), list[float]()
    for leading in ((1, 2, 5), (1, 3), (1,)):
        steps = [m * 10.0**k for k in range(first, first + 4) for m in leading]
        found = [step for step in steps if low <= step * (1 + SAME) and step <= high * (1 + SAME)]
        if len(found) <= most:
            break
    if len(found) < 2:
        found = [step for step in np.asarray(MaxNLocator(4).tick_values(low, high)).tolist() if low <= step <= high]
    return found
