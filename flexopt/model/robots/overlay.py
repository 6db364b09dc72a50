"""The machine file around a robot file, as validated data: TOML in, `Overlay` out. The keys are told in `reading`."""

from __future__ import annotations

from typing import Annotated, Any, Literal, cast

from pydantic import Field

from flexopt.errors import Fault
from flexopt.foundation.quantities import Acceleration, Length, check_number, check_schema, checked
from flexopt.model.file_model import FileModel
from flexopt.model.hydraulics import Cylinder
from flexopt.model.kinematic_tree import UNTURNED, Placement, Row
from flexopt.model.robots.elements import there_are
from flexopt.model.table_quantities import check_armature_value, check_effort_value, check_speed_value
from flexopt.model.tables import Payload, Polygon
from flexopt.model.tree_quantities import (
    DAMPING_MAX,
    STIFFNESS_MAX,
    Pair,
    Point,
    Rotation,
    check_damping_value,
    check_rest_value,
    check_square,
)

DIRECTIONS = ("x", "y", "z", "roll", "pitch", "yaw")
Ignorable = Literal["armature", "equality", "tendon", "gravcomp", "unknown"]

ByDirection = dict[str, float]
Matrix = tuple[tuple[float, ...], ...]


def check_base_stiffness(value: Any) -> ByDirection | Matrix:
    """Springs of the base: positive."""
    return _by_direction(value, ("N/m", "N m/rad"), positive=True)


def check_base_damping(value: Any) -> ByDirection | Matrix:
    """Dampers of the base: not negative."""
    return _by_direction(value, ("N s/m", "N m s/rad"), positive=False)


def _by_direction(value: Any, units: tuple[str, str], *, positive: bool) -> ByDirection | Matrix:
    """A table by direction, six numbers, or a matrix."""
    entries = list(cast(tuple[Any, ...], value)) if isinstance(value, list | tuple) else []
    if len(entries) == len(DIRECTIONS):
        if all(isinstance(row, list | tuple) for row in entries):
            return check_square(value)
        value = dict(zip(DIRECTIONS, entries, strict=True))
    if not isinstance(value, dict):
        raise ValueError(
            f"must be a table of {', '.join(DIRECTIONS)} (one left out is rigid), six numbers in this order, "
            "or a symmetric 6 × 6 matrix"
        )
    sentences: list[str] = []
    numbers: ByDirection = {}
    for name, number in cast(dict[str, Any], value).items():
        if name not in DIRECTIONS:
            sentences.append(f"{name!r} is no direction{there_are(name, DIRECTIONS)}")
            continue
        unit = units[DIRECTIONS.index(name) >= 3]
        try:
            if positive:
                numbers[name] = check_number(number, unit, above=0.0, high=STIFFNESS_MAX)
            else:
                numbers[name] = check_number(number, unit, low=0.0, high=DAMPING_MAX)
        except ValueError as error:
            sentences.append(f"{name} {error}")
    if sentences:
        raise ValueError("; ".join(sentences))
    return {name: numbers[name] for name in DIRECTIONS if name in numbers}


def check_joint_stiffness(value: Any) -> float:
    """A joint's spring; 0 takes it away."""
    return check_number(value, "N m/rad or N/m", low=0.0, high=STIFFNESS_MAX)


class BaseTable(FileModel):
    """What the root link stands on."""

    stiffness: Annotated[ByDirection | Matrix, checked(check_base_stiffness)]
    damping: Annotated[ByDirection | Matrix, checked(check_base_damping)] = Field(default_factory=dict[str, float])
    point: Point = (0.0, 0.0, 0.0)
    position: Point | None = None
    rotation: Rotation | None = None


class EndPointTable(FileModel):
    """Where the work is done."""

    link: str | None = None
    site: str | None = None
    offset: Point = (0.0, 0.0, 0.0)
    rotation: Rotation = UNTURNED
    rows: tuple[Row, ...] = ("x", "y", "z")
    reference: Rotation = UNTURNED
    length: Length = 1.0


class JointTable(FileModel):
    """What the machine file says in place of the robot file."""

    stiffness: Annotated[float, checked(check_joint_stiffness)] | None = None
    damping: Annotated[float, checked(check_damping_value)] | None = None
    rest: Annotated[float, checked(check_rest_value)] | None = None
    limits: Pair | None = None
    effort: Annotated[float, checked(check_effort_value)] | None = None
    speed: Annotated[float, checked(check_speed_value)] | None = None
    armature: Annotated[float, checked(check_armature_value)] | None = None


class CapsuleTable(FileModel):
    """What a link fills, its ends in the link's frame; see `Capsule`."""

    link: str = Field(min_length=1)
    start: Point
    end: Point
    radius: Length


class Overlay(FileModel):
    """A spatial machine file."""

    schema_version: Annotated[int, checked(check_schema)] = Field(default=1, alias="schema")
    name: str = Field(min_length=1)
    description: str = ""
    source: str = ""
    robot: str = Field(min_length=1)
    root: str | None = None
    gravity: Acceleration | None = None
    actuated: tuple[str, ...]
    locked: dict[str, Annotated[float, checked(check_rest_value)]] = Field(default_factory=dict[str, float])
    lock_others: bool = False
    ignore: tuple[Ignorable, ...] = ()
    placement: tuple[Placement, ...] = ("x", "y", "yaw")
    base: BaseTable | None = None
    joints: dict[str, JointTable] = Field(default_factory=dict[str, JointTable])
    end_point: EndPointTable
    payload: Payload = Payload()
    capsules: tuple[CapsuleTable, ...] = ()
    cylinders: tuple[Cylinder, ...] = ()
    support: Polygon | None = None

    def faults(self) -> list[Fault]:
        """Faults that concern several keys."""
        found: list[Fault] = []
        if (self.end_point.link is None) == (self.end_point.site is None):
            found.append(Fault("end_point", "needs either link (a link or body) or site (a site of an MJCF file)"))
        if self.base is not None:
            springs, dampers = self.base.stiffness, self.base.damping
            free = set(springs) if isinstance(springs, dict) else set(DIRECTIONS)
            if not free:
                found.append(Fault("base.stiffness", "names no direction; leave [base] out where the base is rigid"))
            if isinstance(dampers, dict):
                found += [
                    Fault(f"base.damping.{d}", f"needs base.stiffness.{d}; without it the base is rigid")
                    for d in dampers
                    if d not in free
                ]
            elif len(free) < len(DIRECTIONS):
                found.append(Fault("base.damping", "a matrix needs stiffness in all six directions"))
        for name in sorted(set(self.actuated) & set(self.locked)):
            found.append(Fault(f"locked.{name}", "is also listed as actuated"))
        repeated = sorted({name for name in self.actuated if self.actuated.count(name) > 1})
        found += [Fault("actuated", "is listed twice", repr(name)) for name in repeated]
        return found
