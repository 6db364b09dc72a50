"""The machine file around a robot file, as validated data: TOML in, `Overlay` out. The keys are told in `reading`."""

from __future__ import annotations

from typing import Annotated, Any, Literal, cast

from pydantic import Field

from flexopt.errors import Fault
from flexopt.foundation.quantities import (
    ARMATURE,
    DAMPING,
    EFFORT,
    JOINT_DAMPING,
    JOINT_STIFFNESS,
    JOINT_VALUE,
    ROTATIONAL_DAMPING,
    ROTATIONAL_STIFFNESS,
    SPEED,
    STIFFNESS,
    Acceleration,
    Checked,
    Length,
    Quantity,
    each,
    entries,
)
from flexopt.model.file_model import Described, FileModel
from flexopt.model.hydraulics import Cylinder
from flexopt.model.kinematic_tree import UNTURNED, Placement, Row
from flexopt.model.loop import Loop
from flexopt.model.robots.elements import there_are
from flexopt.model.tables import Payload, Polygon
from flexopt.model.tree_quantities import (
    Pair,
    Point,
    Rotation,
    check_square,
)
from flexopt.model.uncertainty import Uncertainty

DIRECTIONS = ("x", "y", "z", "roll", "pitch", "yaw")
Ignorable = Literal["armature", "equality", "tendon", "gravcomp", "unknown"]

ByDirection = dict[str, float]
Matrix = tuple[tuple[float, ...], ...]


def _by_direction(linear: Quantity, turning: Quantity) -> Checked[ByDirection | Matrix]:
    """A table by direction, six numbers, or a matrix."""
    quantities = dict(zip(DIRECTIONS, [linear] * 3 + [turning] * 3, strict=True))

    def check(value: Any) -> ByDirection | Matrix:
        given = entries(value)
        if len(given) == len(DIRECTIONS):
            if all(isinstance(row, list | tuple) for row in given):
                return check_square(value)
            value = dict(zip(DIRECTIONS, given, strict=True))
        if not isinstance(value, dict):
            raise ValueError(
                f"must be a table of {', '.join(DIRECTIONS)} (one left out is rigid), six numbers in this order, "
                "or a symmetric 6 × 6 matrix"
            )

        def number(entry: tuple[str, Any]) -> tuple[str, float]:
            name, part = entry
            if name not in quantities:
                raise ValueError(f"{name!r} is no direction{there_are(name, DIRECTIONS)}")
            return name, quantities[name](part)

        table = cast(dict[str, Any], value)
        numbers = dict(each(number, table.items(), [name if name in quantities else "" for name in table]))
        return {name: numbers[name] for name in DIRECTIONS if name in numbers}

    return Checked(check)


class BaseTable(FileModel):
    """What the root link stands on."""

    stiffness: Annotated[ByDirection | Matrix, _by_direction(STIFFNESS, ROTATIONAL_STIFFNESS)]
    damping: Annotated[ByDirection | Matrix, _by_direction(DAMPING, ROTATIONAL_DAMPING)] = Field(
        default_factory=dict[str, float]
    )
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

    stiffness: Annotated[float, Quantity(JOINT_STIFFNESS.unit, low=0.0, high=JOINT_STIFFNESS.high)] | None = None
    damping: Annotated[float, JOINT_DAMPING] | None = None
    rest: Annotated[float, JOINT_VALUE] | None = None
    limits: Pair | None = None
    effort: Annotated[float, EFFORT] | None = None
    speed: Annotated[float, SPEED] | None = None
    armature: Annotated[float, ARMATURE] | None = None


class CapsuleTable(FileModel):
    """What a link fills, its ends in the link's frame; see `Capsule`."""

    link: str = Field(min_length=1)
    start: Point
    end: Point
    radius: Length


class Overlay(Described):
    """A spatial machine file."""

    robot: str = Field(min_length=1)
    root: str | None = None
    gravity: Acceleration | None = None
    actuated: tuple[str, ...]
    locked: dict[str, Annotated[float, JOINT_VALUE]] = Field(default_factory=dict[str, float])
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
    loop: Loop | None = None
    uncertainty: tuple[Uncertainty, ...] = ()

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
