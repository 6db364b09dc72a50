"""What every machine has, and the planar machine as validated data: bodies, joints, compliance, payload, parameters."""

from __future__ import annotations

import hashlib
from abc import abstractmethod
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from flexopt.model.quantities import (
    Acceleration,
    Angle,
    Damping,
    Inertia,
    JointLimits,
    Length,
    LengthOrZero,
    Mass,
    MassOrZero,
    Offset,
    RotationalDamping,
    RotationalStiffness,
    Stiffness,
    check_schema,
    checked,
)

BASE_DIRECTIONS: tuple[Literal["x", "y", "rotation"], ...] = ("x", "y", "rotation")


class FileModel(BaseModel):
    """Common to every table of a file: closed (no unknown key), frozen, strict."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class BaseStiffness(FileModel):
    """Springs between ground and base; a direction left out is rigid."""

    x: Stiffness | None = None
    y: Stiffness | None = None
    rotation: RotationalStiffness | None = None


class BaseDamping(FileModel):
    """Dampers beside the springs."""

    x: Damping = 0.0
    y: Damping = 0.0
    rotation: RotationalDamping = 0.0


class Base(FileModel):
    """The first body, from the ground point to the arm's first joint. `com` along it, `com_offset` to its left."""

    length: LengthOrZero
    com: Offset
    com_offset: Offset = 0.0
    mass: Mass
    inertia: Inertia
    rest_angle: Angle
    stiffness: BaseStiffness = BaseStiffness()
    damping: BaseDamping = BaseDamping()


class Link(FileModel):
    """A link and the hinge that carries it: actuated, or passive with a spring."""

    name: str = ""
    length: Length
    com: Offset
    com_offset: Offset = 0.0
    mass: Mass
    inertia: Inertia
    limits: JointLimits | None = None
    joint_damping: RotationalDamping = 0.0
    passive: bool = False
    stiffness: RotationalStiffness | None = None
    damping: RotationalDamping = 0.0
    rest: Angle = 0.0


class Payload(FileModel):
    """A point mass at the end-point."""

    mass: MassOrZero = 0.0


class Parameter(NamedTuple):
    """One entry of the parameter vector p."""

    name: str
    value: float
    unit: str


class AnyMachine(FileModel):
    """What every machine has, planar or spatial; all that is computed downstream of the plant asks for no more."""

    schema_version: Annotated[int, checked(check_schema)] = Field(default=1, alias="schema")
    name: str = Field(min_length=1)
    description: str = ""
    source: str = ""
    gravity: Acceleration = 9.81

    @property
    @abstractmethod
    def joints(self) -> tuple[str, ...]:
        """Names of the actuated joints."""

    @property
    @abstractmethod
    def joint_units(self) -> tuple[str, ...]:
        """Unit of each actuated joint, rad or m."""

    @property
    @abstractmethod
    def limits(self) -> tuple[tuple[float, float], ...]:
        """Limits of the actuated joints, rad or m; infinite where none are given."""

    @property
    @abstractmethod
    def damped_joints(self) -> bool:
        """Whether any actuated joint has friction."""

    @property
    @abstractmethod
    def base_coordinates(self) -> tuple[str, ...]:
        """Names of the placement coordinates that the operator chooses."""

    @property
    @abstractmethod
    def base_units(self) -> tuple[str, ...]:
        """Unit of each placement coordinate, m or rad."""

    @abstractmethod
    def list_parameters(self) -> list[Parameter]:
        """See `parameters`."""

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameter vector p with this machine's values: geometry, inertia, springs, dampers, payload, gravity."""
        return tuple(self.list_parameters())

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of the validated content: the same for two descriptions that say the same."""
        return hashlib.sha256(self.model_dump_json(by_alias=True).encode()).hexdigest()

    def to_dict(self) -> dict[str, Any]:
        """The machine as a dictionary, keys at their defaults left out: what it was validated from takes it back."""
        return self.model_dump(by_alias=True, exclude_defaults=True)

    def __hash__(self) -> int:
        return hash(self.content_hash)

    def __str__(self) -> str:
        return repr(self)


class Machine(AnyMachine):
    """A planar chain on a compliant base (`flexopt.load` reads one from a file).

    Units are SI and angles radians. Bodies are rigid; each joint has one degree of freedom and is passive (spring,
    damper, rest value) or actuated. The placement coordinate is the position x of the undercarriage.
    """

    base: Base
    links: tuple[Link, ...] = Field(min_length=1)
    payload: Payload = Payload()

    __hash__ = AnyMachine.__hash__

    @property
    def free_base_directions(self) -> tuple[Literal["x", "y", "rotation"], ...]:
        """The directions in which the base gives, in the order x, y, rotation."""
        return tuple(d for d in BASE_DIRECTIONS if getattr(self.base.stiffness, d) is not None)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the actuated joints, from the base outwards."""
        return tuple(link.name for link in self.links if not link.passive)

    @property
    def joint_units(self) -> tuple[str, ...]:
        """Unit of each actuated joint: rad."""
        return ("rad",) * len(self.joints)

    @property
    def damped_joints(self) -> bool:
        """Whether any actuated joint has friction."""
        return any(link.joint_damping > 0 for link in self.links if not link.passive)

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """Limits of the actuated joints, rad; infinite where none are given."""
        unlimited = (-float("inf"), float("inf"))
        return tuple(link.limits or unlimited for link in self.links if not link.passive)

    @property
    def base_coordinates(self) -> tuple[str, ...]:
        """Names of the placement coordinates that the operator chooses."""
        return ("x",)

    @property
    def base_units(self) -> tuple[str, ...]:
        """Unit of each placement coordinate."""
        return ("m",)

    def list_parameters(self) -> list[Parameter]:
        """See `parameters`."""
        base = self.base
        listed = [
            Parameter("base.length", base.length, "m"),
            Parameter("base.com", base.com, "m"),
            Parameter("base.com_offset", base.com_offset, "m"),
            Parameter("base.mass", base.mass, "kg"),
            Parameter("base.inertia", base.inertia, "kg m²"),
            Parameter("base.rest_angle", base.rest_angle, "rad"),
        ]
        for direction in self.free_base_directions:
            turn = direction == "rotation"
            stiffness: float = getattr(base.stiffness, direction)
            damping: float = getattr(base.damping, direction)
            listed.append(Parameter(f"base.stiffness.{direction}", stiffness, "N m/rad" if turn else "N/m"))
            listed.append(Parameter(f"base.damping.{direction}", damping, "N m s/rad" if turn else "N s/m"))
        for link in self.links:
            listed += [
                Parameter(f"{link.name}.length", link.length, "m"),
                Parameter(f"{link.name}.com", link.com, "m"),
                Parameter(f"{link.name}.com_offset", link.com_offset, "m"),
                Parameter(f"{link.name}.mass", link.mass, "kg"),
                Parameter(f"{link.name}.inertia", link.inertia, "kg m²"),
            ]
            if link.passive and link.stiffness is not None:
                listed += [
                    Parameter(f"{link.name}.stiffness", link.stiffness, "N m/rad"),
                    Parameter(f"{link.name}.damping", link.damping, "N m s/rad"),
                    Parameter(f"{link.name}.rest", link.rest, "rad"),
                ]
            else:
                listed.append(Parameter(f"{link.name}.joint_damping", link.joint_damping, "N m s/rad"))
        listed += [Parameter("payload.mass", self.payload.mass, "kg"), Parameter("gravity", self.gravity, "m/s²")]
        return listed

    def __repr__(self) -> str:
        gives = ", ".join(self.free_base_directions) or "nothing"
        passive = [link.name for link in self.links if link.passive]
        flexible = f"; flexible joints: {', '.join(passive)}" if passive else ""
        return f"Machine({self.name!r}: base gives in {gives}; actuated joints: {', '.join(self.joints)}{flexible})"
