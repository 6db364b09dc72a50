"""Checks of coordinates by their names and units: points, tasks, placements, postures, and ranges of placements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

from flexopt.foundation.quantities import COORDINATE_MAX, check_number, check_numbers, check_pair, coordinate_max


def check_point(value: Any) -> tuple[float, ...]:
    """A point in the plane, inertial frame, m."""
    if not isinstance(value, list | tuple) or len(cast(list[Any], value)) != 2:
        raise ValueError("must be two numbers x, y in m, inertial frame")
    return check_numbers(cast(list[Any], value), ["x", "y"], "m", low=-COORDINATE_MAX, high=COORDINATE_MAX)


def check_task(value: Any, rows: Sequence[str]) -> tuple[float, ...]:
    """A target for the rows of a machine's task, inertial frame, m (orientation rows: rotation vector times length)."""
    parts = cast(list[Any], value) if isinstance(value, list | tuple) else [value]
    if len(parts) != len(rows):
        numbers = {1: "one number", 2: "two numbers"}.get(len(rows), f"{len(rows)} numbers")
        raise ValueError(f"must be {numbers} {', '.join(rows)} in m, inertial frame")
    return check_numbers(list(parts), list(rows), "m", low=-COORDINATE_MAX, high=COORDINATE_MAX)


def check_placement(
    value: Any, names: Sequence[str], units: Sequence[str], *, what: str = "placed"
) -> tuple[float, ...]:
    """A number for each placement coordinate (or joint, by which the machine is held); one alone needs no list."""
    parts = list(cast(list[Any], value)) if isinstance(value, list | tuple) else [value]
    if len(parts) != len(names):
        count = "one number" if len(names) == 1 else f"{len(names)} numbers"
        listed = ", ".join(f"{name}, in {unit}" for name, unit in zip(names, units, strict=True))
        raise ValueError(f"must be {count}: the machine is {what} by {listed or 'nothing'}")
    numbers: list[float] = []
    sentences: list[str] = []
    for part, name, unit in zip(parts, names, units, strict=True):
        try:
            numbers.append(check_number(part, unit, low=-coordinate_max(unit), high=coordinate_max(unit)))
        except ValueError as error:
            sentences.append(f"{name} {error}" if len(names) > 1 else str(error))
    if sentences:
        raise ValueError("; ".join(sentences))
    return tuple(numbers)


def check_base_range(value: Any, names: Sequence[str], units: Sequence[str]) -> dict[str, tuple[float, float]]:
    """A range [lower, upper] for some of the placement coordinates, by name; of a single one the pair alone."""
    unit_of = dict(zip(names, units, strict=True))
    if not isinstance(value, Mapping):
        if len(names) != 1:
            listed = ", ".join(f"{name} = [lower, upper]" for name in names) or "nothing"
            raise ValueError(f"must be a table with ranges of the placement coordinates: {listed}")
        value = {names[0]: value}
    ranges: dict[str, tuple[float, float]] = {}
    sentences: list[str] = []
    for name, pair in cast(Mapping[Any, Any], value).items():
        if name not in unit_of:
            sentences.append(f"{name!r} is no placement coordinate; valid: {', '.join(names) or 'none'}")
            continue
        most = coordinate_max(unit_of[name])
        try:
            ranges[str(name)] = check_pair(pair, unit_of[name], -most, most, allow_equal=True)
        except ValueError as error:
            sentences.append(f"{name} {error}" if len(names) > 1 else str(error))
    if sentences:
        raise ValueError("; ".join(sentences))
    return ranges
