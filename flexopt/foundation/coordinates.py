"""Checks of coordinates by their names and units: points, tasks, placements, and ranges of placements."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.foundation.quantities import COORDINATE, each, each_named, pair, several, vector

# Of a machine that stands where it is built.
NO_PLACEMENT = "must be left out: the machine has no placement coordinates"
# A point in the plane, inertial frame, m.
check_point = vector("two numbers x, y in m, inertial frame", COORDINATE["m"], "xy")


def check_task(value: Any, rows: Sequence[str]) -> tuple[float, ...]:
    """A target for the rows of a machine's task, inertial frame, m (orientation rows: rotation vector times length)."""
    parts = several(value)
    if len(parts) != len(rows):
        numbers = {1: "one number", 2: "two numbers"}.get(len(rows), f"{len(rows)} numbers")
        raise ValueError(f"must be {numbers} {', '.join(rows)} in m, inertial frame")
    return each_named(COORDINATE["m"], parts, rows)


def check_placement(
    value: Any, names: Sequence[str], units: Sequence[str], *, what: str = "placed"
) -> tuple[float, ...]:
    """A number for each placement coordinate (or joint, by which the machine is held); one alone needs no list."""
    parts = several(value)
    if len(parts) != len(names):
        count = "one number" if len(names) == 1 else f"{len(names)} numbers"
        listed = ", ".join(f"{name}, in {unit}" for name, unit in zip(names, units, strict=True))
        raise ValueError(f"must be {count}: the machine is {what} by {listed}" if names else NO_PLACEMENT)
    return each_named(lambda part: COORDINATE[part[0]](part[1]), list(zip(units, parts, strict=True)), names)


def check_base_range(value: Any, names: Sequence[str], units: Sequence[str]) -> dict[str, tuple[float, float]]:
    """A range [lower, upper] for some of the placement coordinates, by name; of a single one the pair alone."""
    if not isinstance(value, Mapping):
        if len(names) != 1:
            listed = ", ".join(f"{name} = [lower, upper]" for name in names)
            ranges = f"must be a table with ranges of the placement coordinates: {listed}"
            raise ValueError(ranges if names else NO_PLACEMENT)
        value = {names[0]: value}
    unit_of, table = dict(zip(names, units, strict=True)), cast(Mapping[Any, Any], value)

    def check(entry: tuple[Any, Any]) -> tuple[str, tuple[float, float]]:
        name, ends = entry
        if name not in unit_of:
            raise ValueError(f"{name!r} is no placement coordinate; valid: {', '.join(names) or 'none'}")
        return str(name), pair(COORDINATE[unit_of[name]], allow_equal=True)(ends)

    return dict(each(check, table.items(), [name if name in unit_of and len(names) > 1 else "" for name in table]))


def turned_into(placement: Vector, ends: tuple[Vector, Vector], units: Sequence[str]) -> Vector:
    """The same placement (n_b, …) with its angles whole turns away, as near as can be, where they are between two ends.

    Where none of them is, the one that misses the ends by the least.
    """
    turned = np.array(placement, dtype=np.float64)
    for k, unit in enumerate(units):
        if unit != "rad":
            continue
        first: Vector = np.ceil((ends[0][k] - placement[k]) / math.tau)
        last: Vector = np.floor((ends[1][k] - placement[k]) / math.tau)
        over, under = placement[k] + math.tau * first - ends[1][k], ends[0][k] - placement[k] - math.tau * last
        missed: Vector = np.where(over < under, first, last)
        turned[k] += math.tau * np.where(first <= last, np.clip(0.0, first, last), missed)
    return turned
