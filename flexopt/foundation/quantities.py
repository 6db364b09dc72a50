"""Physical quantities as validated types: unit, allowed range, and the sentence that says so."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any, cast

from pydantic import BeforeValidator
from pydantic_core import PydanticCustomError

from flexopt.foundation.plain import plain

SUPPORTED_SCHEMA = 1
ANGLE_MAX = 4 * math.pi
DEGREES_MAX = 720.0
KINDS: dict[type, str] = {
    str: "text", bool: "true/false", list: "a list", tuple: "a list", dict: "a table", complex: "a complex number",
    type(None): "nothing",
}  # fmt: skip


def range_sentence(unit: str, above: float | None, low: float | None, high: float) -> str:
    """The allowed range in words, with its unit."""
    suffix = f" {unit}" if unit else ""
    if above is not None:
        return f"must be greater than {above:g} and at most {high:g}{suffix}"
    return f"must lie between {low:g} and {high:g}{suffix}"


def check_number(value: Any, unit: str, *, above: float | None = None, low: float | None = None, high: float) -> float:
    """Return `value` as a float, or raise `ValueError` with a sentence that names unit and range."""
    allowed, value = range_sentence(unit, above, low, high), plain(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        kind = next((word for type_, word in KINDS.items() if type(value) is type_), "something else")
        raise ValueError(f"must be a number, not {kind}; it {allowed}")
    try:
        number = float(value)
    except OverflowError:
        raise ValueError(allowed) from None
    if not math.isfinite(number):
        raise ValueError(f"must be finite; it {allowed}")
    if (above is not None and not number > above) or (low is not None and number < low) or number > high:
        hint = "; is it in mm?" if unit == "m" and high == LENGTH_MAX and abs(number) > high else ""
        raise ValueError(allowed + hint + degrees_hint(unit, number))
    return number + 0.0  # −0.0 becomes 0.0, so that equal inputs have equal hashes


def check_whole(value: Any, low: int, high: int, most: str = "") -> int:
    """Return `value`, a whole number in that range; `most` is how the sentence calls a large `high`."""
    value = plain(value)
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"must be a whole number between {low} and {most or high}")
    return value


def degrees_hint(unit: str, value: float) -> str:
    """The end of a sentence about an angle that is too large, where it may have been meant in degrees."""
    return "; is it in degrees?" if unit == "rad" and ANGLE_MAX < abs(value) <= DEGREES_MAX else ""


def quantity(unit: str, *, above: float | None = None, low: float | None = None, high: float) -> BeforeValidator:
    """A number in a range, as the annotation of a field."""
    return checked(lambda value: check_number(value, unit, above=above, low=low, high=high))


def checked(check: Callable[[Any], Any]) -> BeforeValidator:
    """A validator from a function that raises `ValueError` with the whole sentence."""

    def validate(value: Any) -> Any:
        try:
            return check(value)
        except ValueError as error:
            raise PydanticCustomError("quantity", "{sentence}", {"sentence": str(error)}) from None

    return BeforeValidator(validate)


# The upper ends are far beyond any machine; they keep squares and products of the numbers finite.
LENGTH_MAX = 1e4
Length = Annotated[float, quantity("m", above=0.0, high=LENGTH_MAX)]
LengthOrZero = Annotated[float, quantity("m", low=0.0, high=LENGTH_MAX)]
Offset = Annotated[float, quantity("m", low=-LENGTH_MAX, high=LENGTH_MAX)]
Mass = Annotated[float, quantity("kg", above=0.0, high=1e9)]
MassOrZero = Annotated[float, quantity("kg", low=0.0, high=1e9)]
Inertia = Annotated[float, quantity("kg m²", above=0.0, high=1e15)]
Stiffness = Annotated[float, quantity("N/m", above=0.0, high=1e15)]
RotationalStiffness = Annotated[float, quantity("N m/rad", above=0.0, high=1e15)]
Damping = Annotated[float, quantity("N s/m", low=0.0, high=1e12)]
RotationalDamping = Annotated[float, quantity("N m s/rad", low=0.0, high=1e12)]
Torque = Annotated[float, quantity("N m", above=0.0, high=1e15)]
AngularSpeed = Annotated[float, quantity("rad/s", above=0.0, high=1e6)]
Angle = Annotated[float, quantity("rad", low=-ANGLE_MAX, high=ANGLE_MAX)]
Acceleration = Annotated[float, quantity("m/s²", low=0.0, high=1e3)]
COORDINATE_MAX = 1e6


def coordinate_max(unit: str) -> float:
    """How far a coordinate in m or rad may be from zero."""
    return ANGLE_MAX if unit == "rad" else COORDINATE_MAX


def check_numbers(
    values: list[Any], names: list[str], unit: str, *, above: float | None = None, low: float | None = None, high: float
) -> tuple[float, ...]:
    """Numbers in one range; the sentence names every one that is not."""
    checked_values: list[float] = []
    sentences: list[str] = []
    for value, name in zip(values, names, strict=True):
        try:
            checked_values.append(check_number(value, unit, above=above, low=low, high=high))
        except ValueError as error:
            sentences.append(f"{name} {error}" if len(names) > 1 else str(error))
    if sentences:
        raise ValueError("; ".join(sentences))
    return tuple(checked_values)


def check_schema(value: Any) -> int:
    """The version of a file's layout."""
    if type(value) is not int or value != SUPPORTED_SCHEMA:
        raise ValueError(f"unknown schema version; this flexopt reads version {SUPPORTED_SCHEMA}")
    return value


def check_pair(value: Any, unit: str, low: float, high: float, *, allow_equal: bool = False) -> tuple[float, float]:
    """A [lower, upper] pair of numbers in `unit`, in order."""
    if not isinstance(value, list | tuple) or len(cast(list[Any], value)) != 2:
        raise ValueError(f"must be a pair [lower, upper] in {unit}")
    lower, upper = check_numbers(cast(list[Any], value), ["lower end", "upper end"], unit, low=low, high=high)
    if upper < lower or (upper == lower and not allow_equal):
        raise ValueError(f"is reversed or empty: the lower end must be below the upper end, in {unit}")
    return lower, upper


JointLimits = Annotated[tuple[float, float], checked(lambda v: check_pair(v, "rad", -ANGLE_MAX, ANGLE_MAX))]
BaseRange = Annotated[
    tuple[float, float], checked(lambda v: check_pair(v, "m", -COORDINATE_MAX, COORDINATE_MAX, allow_equal=True))
]
