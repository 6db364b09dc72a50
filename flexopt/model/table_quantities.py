"""The quantities of `tables` and of joints' drives as checks: places, spans, polygons, efforts, speeds."""

from __future__ import annotations

from typing import Any, cast

from flexopt.foundation.quantities import LENGTH_MAX, check_number, check_numbers, check_pair
from flexopt.model.polygons import Corners, check_simple_polygon, turn

EFFORT_MAX, SPEED_MAX, ARMATURE_MAX = 1e15, 1e6, 1e15


def check_place(value: Any) -> tuple[float, ...]:
    """Two or three coordinates, m."""
    entries = list(cast(list[Any], value)) if isinstance(value, list | tuple) else []
    if len(entries) not in (2, 3):
        raise ValueError("must be numbers in m: [along, left] in the plane, [x, y, z] in space")
    names = ["x", "y", "z"] if len(entries) == 3 else ["along", "left"]
    return check_numbers(entries, names, "m", low=-LENGTH_MAX, high=LENGTH_MAX)


def check_span(value: Any) -> tuple[float, float]:
    """[rear, front], m."""
    return check_pair(value, "m", -LENGTH_MAX, LENGTH_MAX)


def check_polygon(value: Any) -> Corners:
    """Corners of a convex polygon, counter-clockwise."""
    corners = check_simple_polygon(value)
    before = (*corners[-1:], *corners[:-1])
    after = (*corners[1:], *corners[:1])
    dents = [i for i, three in enumerate(zip(before, corners, after, strict=True)) if turn(*three) <= 0]
    if dents:
        x, y = corners[dents[0]]
        raise ValueError(f"is not convex: corner [{x:g}, {y:g}] turns inwards or not at all")
    return corners


def check_effort_value(value: Any) -> float:
    """N m or N."""
    return check_number(value, "N m or N", above=0.0, high=EFFORT_MAX)


def check_speed_value(value: Any) -> float:
    """Rad/s or m/s."""
    return check_number(value, "rad/s or m/s", above=0.0, high=SPEED_MAX)


def check_armature_value(value: Any) -> float:
    """Kg m² or kg."""
    return check_number(value, "kg m² or kg", low=0.0, high=ARMATURE_MAX)
