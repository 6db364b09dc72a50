"""Physical quantities as validated types: unit, allowed range, and the sentence that says so.

A `Checked` is called with a value and gives it as it is kept, or raises `ValueError` with the whole sentence. The same
object stands in the annotation of a file's field, behind an argument of a call and behind the range of a parameter, so
that a unit and a bound are written once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Annotated, Any, Generic, TypeVar, cast

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError
from pydantic_core.core_schema import no_info_before_validator_function

from flexopt.errors import FAULTS_SHOWN
from flexopt.foundation.plain import plain

T = TypeVar("T")
JsonSchema = dict[str, Any]
SUPPORTED_SCHEMA = 1
ANGLE_MAX = 4 * math.pi
DEGREES_MAX = 720.0
# The upper ends are far beyond any machine; they keep squares and products of the numbers finite.
LENGTH_MAX, COORDINATE_MAX = 1e4, 1e6
# Dead times last so long at most, s; runs may last longer.
SHORT = 10.0
# A loop whose dead time is too long may have it in ms where it is this much, s.
LATE_MIN = 0.5
# Smallest positive normal number in single precision: what must be greater than 0 is at least this.
POSITIVE = 1.1754944e-38
KINDS: dict[type, str] = {
    str: "text", bool: "true/false", list: "a list", tuple: "a list", dict: "a table", complex: "a complex number",
    type(None): "nothing",
}  # fmt: skip


class Checked(Generic[T]):
    """A check as a function and as the annotation of a field; decorates what raises `ValueError` with the sentence.

    `accepts` is what it takes in a file, as JSON Schema; without it that of the annotated type.
    """

    def __init__(self, check: Callable[[Any], T], accepts: JsonSchema | None = None) -> None:
        self.check, self.__doc__, self.accepts = check, check.__doc__, accepts

    def __call__(self, value: Any) -> T:
        """The value as it is kept."""
        return self.check(value)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        def validate(value: Any) -> T:
            try:
                return self.check(value)
            except ValueError as error:
                raise PydanticCustomError("quantity", "{sentence}", {"sentence": str(error)}) from None

        return no_info_before_validator_function(validate, handler(source))

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchema:
        return handler(core) if self.accepts is None else dict(self.accepts)


def accepting(accepts: JsonSchema) -> Callable[[Callable[[Any], T]], Checked[T]]:
    """As the decorator `Checked`, of what takes in files something else than its annotated type says."""
    return lambda check: Checked(check, accepts)


def a_list(of: JsonSchema, least: int | None = None, most: float | None = None) -> JsonSchema:
    """A list as JSON Schema."""
    counts = {"minItems": least, "maxItems": int(most) if most is not None and math.isfinite(most) else None}
    return {"type": "array", "items": of} | {word: count for word, count in counts.items() if count is not None}


class Quantity(Checked[float]):
    """A number in a range; `above` is an end that it does not reach."""

    def __init__(self, unit: str, *, above: float | None = None, low: float | None = None, high: float) -> None:
        ends = {"exclusiveMinimum": above, "minimum": low, "maximum": high, "x-unit": unit or None}
        accepts: JsonSchema = {"type": "number"} | {word: end for word, end in ends.items() if end is not None}
        super().__init__(self._read, accepts)
        self.unit, self.above, self.low, self.high = unit, above, low, high

    @property
    def allowed(self) -> str:
        """The allowed range in words, with its unit."""
        suffix = f" {self.unit}" if self.unit else ""
        if self.above is not None:
            return f"must be greater than {self.above:g} and at most {self.high:g}{suffix}"
        return f"must lie between {self.low:g} and {self.high:g}{suffix}"

    @property
    def range(self) -> tuple[float, float]:
        """Both ends as numbers that the quantity may have, in single precision, too."""
        return (POSITIVE if self.low is None else self.low), self.high

    def _read(self, value: Any) -> float:
        value = plain(value)
        if isinstance(value, bool) or not isinstance(value, int | float):
            kind = next((word for type_, word in KINDS.items() if type(value) is type_), "something else")
            raise ValueError(f"must be a number, not {kind}; it {self.allowed}")
        try:
            number = float(value)
        except OverflowError:
            raise ValueError(self.allowed) from None
        if not math.isfinite(number):
            raise ValueError(f"must be finite; it {self.allowed}")
        low = -math.inf if self.low is None else self.low
        if (self.above is not None and not number > self.above) or not low <= number <= self.high:
            raise ValueError(self.allowed + self._unit_hint(number))
        return number + 0.0  # −0.0 becomes 0.0, so that equal inputs have equal hashes

    def _unit_hint(self, number: float) -> str:
        """The end of a sentence about a number that is too large, where it may have been meant in another unit."""
        if self.unit == "m" and self.high == LENGTH_MAX and abs(number) > self.high:
            return "; is it in mm?"
        if self.unit == "s" and self.high <= SHORT and self.high < number <= 1e3 * self.high:
            return "; is it in ms?"
        return degrees_hint(self.unit, number)


def milliseconds_hint(value: float) -> str:
    """The end of a sentence about a dead time of a loop that is too long."""
    return "; is it in ms?" if value >= LATE_MIN else ""


def degrees_hint(unit: str, value: float) -> str:
    """The end of a sentence about an angle that is too large, where it may have been meant in degrees."""
    return "; is it in degrees?" if unit == "rad" and ANGLE_MAX < abs(value) <= DEGREES_MAX else ""


def whole_number(low: int, high: int, most: str = "", what: str = "") -> Checked[int]:
    """A whole number in that range; `most` is how the sentence calls a large `high`, `what` what is counted."""

    def check(value: Any) -> int:
        value = plain(value)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise ValueError(f"must be a whole number between {low} and {most or high}{what}")
        return value

    return Checked(check, {"type": "integer", "minimum": low, "maximum": high})


def entries(value: Any) -> list[Any]:
    """The entries of a list or tuple; none of anything else."""
    return list(cast(list[Any], value)) if isinstance(value, list | tuple) else []


def several(value: Any) -> list[Any]:
    """The entries of a list or tuple, or a value alone."""
    return entries(value) if isinstance(value, list | tuple) else [value]


def each(check: Callable[[Any], T], values: Iterable[Any], names: Iterable[str]) -> tuple[T, ...]:
    """Check each value; the sentence names the first of those that are refused (an empty name is left out)."""
    found: list[T] = []
    sentences: list[str] = []
    for value, name in zip(values, names, strict=True):
        try:
            found.append(check(value))
        except ValueError as error:
            sentences.append(f"{name} {error}".lstrip())
    if sentences:
        raise ValueError("; ".join(sentences[:FAULTS_SHOWN]))
    return tuple(found)


def each_named(check: Callable[[Any], T], values: Sequence[Any], names: Sequence[str]) -> tuple[T, ...]:
    """As `each`; a value alone needs no name."""
    return each(check, values, names if len(names) > 1 else [""] * len(names))


def vector(what: str, quantity: Quantity, *names: Sequence[str]) -> Checked[tuple[Any, ...]]:
    """A list with a number for each name; of several lists of names, that of the same length."""

    def check(value: Any) -> tuple[float, ...]:
        parts = entries(value)
        named = next((words for words in names if len(words) == len(parts)), None)
        if named is None:
            raise ValueError(f"must be {what}")
        return each_named(quantity, parts, named)

    sizes = [len(words) for words in names]
    return Checked(check, a_list(quantity.accepts or {}, min(sizes), max(sizes)))


def numbers_in(quantity: Quantity, *, least: int = 1) -> Checked[tuple[float, ...]]:
    """One number, or a list of at least so many; how many there must be is said elsewhere."""

    def check(value: Any) -> tuple[float, ...]:
        parts = several(plain(value))
        if len(parts) < least:
            unit = f", in {quantity.unit}" if quantity.unit else ""
            raise ValueError(f"must be a number or a list of numbers{unit}")
        return each_named(quantity, parts, [f"entry {k}" for k in range(1, len(parts) + 1)])

    one = quantity.accepts or {}
    return Checked(check, {"anyOf": [one, a_list(one, least)]})


def list_of(what: str, check: Callable[[Any], T], name: str, least: int, most: float) -> Checked[tuple[T, ...]]:
    """A list of as many entries; sentences call them `name` with their number, from 1."""

    def check_all(value: Any) -> tuple[T, ...]:
        parts = entries(plain(value))
        if not least <= len(parts) <= most:
            raise ValueError(f"must be a list of {what}")
        return each(check, parts, [name.format(k) for k in range(1, len(parts) + 1)])

    return Checked(check_all, a_list(getattr(check, "accepts", None) or {}, least, most))


def pair(
    quantity: Quantity, what: str = "a pair [lower, upper]", *, allow_equal: bool = False
) -> Checked[tuple[float, float]]:
    """A [lower, upper] pair, in order."""
    unit = f" in {quantity.unit}" if quantity.unit else ""

    def check(value: Any) -> tuple[float, float]:
        parts = entries(value)
        if len(parts) != 2:
            raise ValueError(f"must be {what}{unit}")
        lower, upper = each(quantity, parts, ["lower end", "upper end"])
        if upper < lower or (upper == lower and not allow_equal):
            raise ValueError(f"is reversed or empty: the lower end must be below the upper end{unit and ',' + unit}")
        return lower, upper

    return Checked(check, a_list(quantity.accepts or {}, 2, 2))


@accepting({"const": SUPPORTED_SCHEMA})
def check_schema(value: Any) -> int:
    """The version of a file's layout."""
    if type(value) is not int or value != SUPPORTED_SCHEMA:
        raise ValueError(f"unknown schema version; this flexopt reads version {SUPPORTED_SCHEMA}")
    return value


LENGTH = Quantity("m", above=0.0, high=LENGTH_MAX)
LENGTH_OR_ZERO = Quantity("m", low=0.0, high=LENGTH_MAX)
OFFSET = Quantity("m", low=-LENGTH_MAX, high=LENGTH_MAX)
MASS = Quantity("kg", above=0.0, high=1e9)
MASS_OR_ZERO = Quantity("kg", low=0.0, high=1e9)
INERTIA = Quantity("kg m²", above=0.0, high=1e15)
INERTIA_ENTRY = Quantity("kg m²", low=-1e15, high=1e15)
ANGLE = Quantity("rad", low=-ANGLE_MAX, high=ANGLE_MAX)
ACCELERATION = Quantity("m/s²", low=0.0, high=1e3)
DURATION = Quantity("s", above=0.0, high=1e6)
# A coordinate by its unit.
COORDINATE = {"m": Quantity("m", low=-COORDINATE_MAX, high=COORDINATE_MAX), "rad": ANGLE}
# Of joints that are hinges or slides; a hinge's angle is bounded further where its kind is known.
JOINT_VALUE = Quantity("rad or m", low=-COORDINATE_MAX, high=COORDINATE_MAX)
JOINT_STIFFNESS = Quantity("N m/rad or N/m", above=0.0, high=1e15)
JOINT_DAMPING = Quantity("N m s/rad or N s/m", low=0.0, high=1e12)
EFFORT = Quantity("N m or N", above=0.0, high=1e15)
SPEED = Quantity("rad/s or m/s", above=0.0, high=1e6)
ARMATURE = Quantity("kg m² or kg", low=0.0, high=1e15)
STIFFNESS, ROTATIONAL_STIFFNESS = (Quantity(unit, above=0.0, high=1e15) for unit in ("N/m", "N m/rad"))
DAMPING, ROTATIONAL_DAMPING = (Quantity(unit, low=0.0, high=1e12) for unit in ("N s/m", "N m s/rad"))

Length = Annotated[float, LENGTH]
Offset = Annotated[float, OFFSET]
Mass = Annotated[float, MASS]
MassOrZero = Annotated[float, MASS_OR_ZERO]
Inertia = Annotated[float, INERTIA]
Stiffness = Annotated[float, STIFFNESS]
RotationalStiffness = Annotated[float, ROTATIONAL_STIFFNESS]
Damping = Annotated[float, DAMPING]
RotationalDamping = Annotated[float, ROTATIONAL_DAMPING]
Angle = Annotated[float, ANGLE]
Acceleration = Annotated[float, ACCELERATION]
Schema = Annotated[int, check_schema]
BaseRange = Annotated[tuple[float, float], pair(COORDINATE["m"], allow_equal=True)]


def coordinate_max(unit: str) -> float:
    """How far a coordinate in m or rad may be from zero."""
    return COORDINATE[unit].high
