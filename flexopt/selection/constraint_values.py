"""What constraints are at a configuration, in numbers and in a sentence.

In: values and bounds by name. Out: names by kind, and of each kind that which is nearest to its bound.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from flexopt.foundation.plain import counted
from flexopt.foundation.rounding import apart, without_rounding
from flexopt.model.constraints import Constraints
from flexopt.selection.constraints import KINDS

# Beyond its bound by more than this share of it, or of one unit, is no rounding.
BEYOND = 1e-6


@dataclass(frozen=True)
class ConstraintValue:
    """What a constraint lower ≤ value ≤ upper is at a candidate, in `unit`."""

    value: float
    lower: float
    upper: float
    unit: str

    @property
    def shown(self) -> float:
        """The value in texts: 0 where it is rounding, of its bounds or of one unit."""
        return float(without_rounding(self.value, self._size))

    @property
    def room(self) -> float:
        """How far it is from its nearer bound, in `unit`; negative beyond it."""
        return min(self.value - self.lower, self.upper - self.value)

    @property
    def least_room(self) -> float:
        """`room`, below all others where the value is no number."""
        return -worst_size(-self.room)

    @property
    def beyond_allowed(self) -> float:
        """How far it is beyond its nearer bound, as a share of half of what lies between two bounds, or of the one.

        0 of what keeps them; infinite where that is 0, or the value is no number.
        """
        size = max(0.0, -self.least_room)
        ends = [abs(bound) for bound in (self.lower, self.upper) if math.isfinite(bound)]
        much = (self.upper - self.lower) / 2 if len(ends) > 1 else max(ends, default=0.0)
        return 0.0 if size == 0 else size / much if much > 0 else math.inf

    @property
    def nearness(self) -> float:
        """What rows of one kind are compared by: between two bounds the room as a share of them, else in `unit`.

        A joint that may hold 10 N m is nearer to its bound with 3 left than one that may hold 70 with 15 left.
        """
        between = self.upper - self.lower
        return self.room / between if math.isfinite(between) and between > 0 else self.room

    def allowed(self, number: Callable[[float], str], unit: str) -> str:
        """Its bounds in words, numbers and unit written as asked for."""
        if math.isfinite(self.lower) and math.isfinite(self.upper):
            ends = dict.fromkeys(map(number, (self.lower, self.upper)))
            return f"{' to '.join(ends)} {unit}".rstrip()
        low = math.isfinite(self.lower)
        return f"at {'least' if low else 'most'} {number(self.lower if low else self.upper)} {unit}".rstrip()

    def __str__(self) -> str:
        number = "{:z.4g}".format
        if math.isnan(self.value):
            return f"no number ({self.allowed(number, self.unit)})"
        if -self.room > BEYOND * self._size:
            # What breaks a bound is not told as the bound itself.
            number = apart(self.shown, (self.lower, self.upper))
        return f"{f'{number(self.shown)} {self.unit}'.rstrip()} ({self.allowed(number, self.unit)})"

    @property
    def _size(self) -> float:
        """The greatest of its bounds and one unit."""
        return max([1.0, *(abs(bound) for bound in (self.lower, self.upper) if math.isfinite(bound))])


def by_kind(names: Iterable[str], cornerless: Mapping[str, str]) -> dict[str, list[str]]:
    """Names of constraints by what they are the same of: "clearance" of every body, at every corner.

    `cornerless`: as of `flexopt.selection.broken.cornerless`.
    """
    kinds: dict[str, list[str]] = {}
    for name in names:
        kinds.setdefault(re.split(" of | from |, ", cornerless.get(name, name))[0], []).append(name)
    return kinds


def resting_told(names: Sequence[str], cornerless: Mapping[str, str]) -> list[str]:
    """Names of what a configuration rests on, one for all corners of `constraints.within` at which it does.

    `cornerless`: as of `flexopt.selection.broken.cornerless`.
    """
    told = list[str]()
    kinds = [cornerless.get(name, name) for name in names]
    for kind in dict.fromkeys(kinds):
        of_kind = [name for name, own in zip(names, kinds, strict=True) if own == kind]
        corners = len([name for name in of_kind if name != kind])
        also = "at" if corners == len(of_kind) else "also at"
        many = f"{kind} ({also} {counted(corners, 'corner')} of within)"
        told.append(of_kind[0] if len(of_kind) == 1 else many)
    return told


def worst_size(size: float) -> float:
    """By how much a bound is broken, to compare: what is no number is broken most."""
    return math.inf if math.isnan(size) else size


def violations_told(
    violations: Mapping[str, float], cornerless: Mapping[str, str], units: Mapping[str, str], most: int | None = None
) -> str:
    """Which constraints are broken by how much, of one at several corners of `constraints.within` the worst alone.

    Args:
        violations: sizes by name.
        cornerless: as of `flexopt.selection.broken.cornerless`.
        units: by name, where there is one.
        most: so many are named; None: all.
    """
    worst = dict[str, str]()
    for name in violations:
        of = cornerless.get(name, name)
        worst[of] = max(worst.get(of, name), name, key=lambda each: worst_size(violations[each]))
    told = [(name, violations[name], units.get(name, "")) for name in worst.values()][:most]
    return "; ".join(
        f"{name}, no number" if math.isnan(size) else f"{name} by {size:.3g} {unit}".rstrip()
        for name, size, unit in told
    )


def nearest_told(
    asked: Constraints, places: Sequence[dict[str, ConstraintValue]], cornerless: Mapping[str, str]
) -> str:
    """A sentence on the constraint of each kind that is nearest to its bound, over all targets.

    Empty where nobody asked for any.

    Args:
        asked: the constraints as they were given.
        places: at each target, by name; the same names at all.
        cornerless: as of `flexopt.selection.broken.cornerless`.
    """
    if not any(getattr(asked, field, None) is not None for field in (*KINDS, "joint_margin", "own")):
        return ""
    told = list[str]()
    for names in by_kind(places[0], cornerless).values():
        _, k, name = min((values[name].nearness, k, name) for k, values in enumerate(places) for name in names)
        at = f" at target {k + 1}" if len(places) > 1 else ""
        told.append(f"{name} {places[k][name]}{at}")
    return f"constraints, of each kind that nearest to its bound: {'; '.join(told)}"
