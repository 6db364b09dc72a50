"""What the places of a verdict have in common: a name, a move, how their numbers read."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from flexopt.loop.borders import LOW

# Where the machine stands now, and the best of the selection.
STAY, FIRST = "stay", "candidate 1"
# The place of a verdict with other gains, in a row of places.
NEW_GAINS = "new gains"
# How many of the places judged are told of, besides these two.
TOLD = 3
# In place of the number that stands for a decay of what feedback holds nowhere.
FALLS = "falls"
# Of an allowed gain that there is not, whose number is 0.
NO_GAIN = "none"
# And what that says, of a loop.
NO_GAIN_LOOKED_AT = (
    f"decays with no gains that were looked at, from {10**LOW:g} of these up to these, in their ratio; lower or higher "
    "ones may do"
)


def candidate_number(place: str) -> int | None:
    """Which candidate of the selection a place is, counted from 1; None where it is none."""
    number = place.removeprefix("candidate ")
    return int(number) if number != place else None


def told(value: float, factor: float, unit: str) -> str:
    """A number as text: how many `unit`s it is, – of none, and no border where it is infinite."""
    if math.isnan(value):
        return "–"
    return f"{factor * value:.4g}{unit}" if math.isfinite(value) else "no border"


def allowed(gain: float, unit: str, highest: float) -> str:
    """An allowed gain as text: above the highest one that was looked at where no border was met up to it.

    None where with all that were looked at up to the present one the loop grows.
    """
    if gain == 0:
        return NO_GAIN
    return f"above {highest:.4g} {unit}" if math.isinf(gain) else told(gain, 1.0, f" {unit}")


def gains_in_words(gains: Mapping[str, Sequence[float]], units: Sequence[str]) -> str:
    """Of each task row where they differ; `units` of kp, kv, ki."""
    told, unit_of = list[str](), dict[str, str](zip(("kp", "kv", "ki"), units, strict=False))
    for name, values in gains.items():
        each = [f"{value:.4g}" for value in values]
        rows = each[0] if len(set(each)) == 1 else f"[{', '.join(each)}]"
        told.append(f"{name} {rows} {unit_of[name]}".rstrip())
    return ", ".join(told)
