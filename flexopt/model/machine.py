"""What every machine has, and the planar machine as validated data: bodies, joints, compliance, payload, parameters."""

from __future__ import annotations

import hashlib
from abc import abstractmethod
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.plain import shown
from flexopt.foundation.quantities import (
    COORDINATE_MAX,
    Acceleration,
    Angle,
    AngularSpeed,
    Damping,
    Inertia,
    JointLimits,
    Length,
    LengthOrZero,
    Mass,
    Offset,
    RotationalDamping,
    RotationalStiffness,
    Stiffness,
    Torque,
    check_number,
    check_schema,
    checked,
)
from flexopt.model.hydraulics import Cylinder, JointFrame
from flexopt.model.strokes import CylinderTravel, usable_range
from flexopt.model.tables import BuiltByCall, Capsule, FileModel, Payload, Span

BASE_DIRECTIONS: tuple[Literal["x", "y", "rotation"], ...] = ("x", "y", "rotation")


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
    """A link and the hinge that carries it: actuated, or passive with a spring.

    An actuated hinge may have `limits`, rad, an `effort`, the largest torque either way, N m, and a `speed`, rad/s.
    """

    name: str = ""
    length: Length
    com: Offset
    com_offset: Offset = 0.0
    mass: Mass
    inertia: Inertia
    limits: JointLimits | None = None
    effort: Torque | None = None
    speed: AngularSpeed | None = None
    joint_damping: RotationalDamping = 0.0
    passive: bool = False
    stiffness: RotationalStiffness | None = None
    damping: RotationalDamping = 0.0
    rest: Angle = 0.0


class Parameter(NamedTuple):
    """One entry of the parameter vector p."""

    name: str
    value: float
    unit: str


class AnyMachine(BuiltByCall):
    """What every machine has, planar or spatial; all that is computed downstream of the plant asks for no more."""

    schema_version: Annotated[int, checked(check_schema)] = Field(default=1, alias="schema")
    name: str = Field(min_length=1)
    description: str = ""
    source: str = ""
    gravity: Acceleration = 9.81
    capsules: tuple[Capsule, ...] = ()
    cylinders: tuple[Cylinder, ...] = ()

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
    def joint_limits(self) -> tuple[tuple[float, float], ...]:
        """Limits of the actuated joints as they were given, rad or m; infinite where none are."""

    @abstractmethod
    def joint_frame(self, joint: str) -> JointFrame:
        """How an actuated joint stands between the bodies that it joins."""

    def _check_joint(self, call: str, joint: Any) -> None:
        """Raise where that is no name of an actuated joint."""
        if not isinstance(joint, str) or joint not in self.joints:
            sentence = f"must be an actuated joint: {', '.join(self.joints)}"
            raise_if_any(InputError, call, [Fault("joint", sentence, shown(joint))])

    def travel(self, cylinder: Cylinder) -> CylinderTravel:
        """A cylinder's length over its joint's coordinate, as numbers."""
        if not isinstance(cylinder, Cylinder):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise_if_any(InputError, "travel", [Fault("cylinder", "must be one of `cylinders`", shown(cylinder))])
        return CylinderTravel(
            cylinder, self.joint_frame(cylinder.joint), {name: value for name, value, _ in self.parameters}
        )

    @property
    def joints_without_speed(self) -> tuple[str, ...]:
        """Actuated joints with neither cylinder nor speed, of which no lever can be told."""
        driven = {cylinder.joint for cylinder in self.cylinders}
        pairs = zip(self.joints, self.speeds, strict=True)
        return tuple(joint for joint, speed in pairs if joint not in driven and speed == float("inf"))

    def beyond_stroke(self, joint: str, q: Any) -> str:
        """The end of a sentence about a value that its joint cannot take, where that is its cylinder's doing."""
        self._check_joint("beyond_stroke", joint)
        try:
            q = check_number(q, "rad or m", low=-COORDINATE_MAX, high=COORDINATE_MAX)
        except ValueError as error:
            raise_if_any(InputError, "beyond_stroke", [Fault("q", str(error), shown(q))])
        return next((self.travel(c).beyond_stroke(q) for c in self.cylinders if c.joint == joint), "")

    @cached_property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """What the limits of the actuated joints and the strokes of their cylinders allow, rad or m; else infinite."""
        found = dict(zip(self.joints, self.joint_limits, strict=True))
        ranges = zip(self.cylinders, self.stroke_ranges, strict=True)
        return tuple((found | {cylinder.joint: part for cylinder, (part, _) in ranges}).values())

    @cached_property
    def stroke_ranges(self) -> tuple[tuple[tuple[float, float], list[Fault]], ...]:
        """Of each cylinder, the range that it leaves its joint within the joint's limits, and what is wrong with it."""
        given = dict(zip(self.joints, self.joint_limits, strict=True))
        return tuple(
            usable_range(self.travel(cylinder), given[cylinder.joint], f"cylinders[{index}] ({cylinder.name})")
            for index, cylinder in enumerate(self.cylinders)
        )

    def stroke_faults(self) -> list[Fault]:
        """What is wrong with the cylinders' strokes."""
        return [fault for _, faults in self.stroke_ranges for fault in faults]

    @property
    @abstractmethod
    def efforts(self) -> tuple[float, ...]:
        """Largest torque or force of the actuated joints either way, N m or N; infinite where none is given."""

    @property
    @abstractmethod
    def speeds(self) -> tuple[float, ...]:
        """Largest speed of the actuated joints either way, rad/s or m/s; infinite where none is given."""

    @property
    @abstractmethod
    def support_points(self) -> tuple[tuple[float, ...], ...]:
        """What the undercarriage stands on, m, in the anchor frame; empty where none is given.

        In the plane the two ends (x,), rear first; in space the corners (x, y) of a convex polygon, counter-clockwise.
        """

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

    @property
    @abstractmethod
    def task_rows(self) -> tuple[str, ...]:
        """Names of the end-point's coordinates: x, y, z, and in space roll, pitch, yaw."""

    @abstractmethod
    def list_parameters(self) -> list[Parameter]:
        """See `parameters`."""

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameter vector p with this machine's values: geometry, inertia, springs, dampers, payload, gravity."""
        pins = [Parameter(name, value, "m") for c in self.cylinders for name, value in c.numbers().items()]
        return (*self.list_parameters(), *pins)

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
    damper, rest value) or actuated. The placement coordinate is the position x of the undercarriage. In a file, tables
    [[capsules]] (`Capsule`; `body` is "base" or a link's name) say what the bodies fill, [[cylinders]] (`Cylinder`)
    what drives the joints, and [support] span = [rear, front] what the undercarriage stands on.
    """

    base: Base
    links: tuple[Link, ...] = Field(min_length=1)
    payload: Payload = Payload()
    support: Span | None = None

    __hash__ = AnyMachine.__hash__

    def structural_faults(self) -> list[Fault]:
        """As of a file."""
        from flexopt.model.faults import machine_faults  # noqa: PLC0415  (which knows this class)

        return machine_faults(self.to_dict()) or self.stroke_faults()

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
    def joint_limits(self) -> tuple[tuple[float, float], ...]:
        """Limits of the actuated joints as they were given, rad; infinite where none are."""
        unlimited = (-float("inf"), float("inf"))
        return tuple(link.limits or unlimited for link in self.links if not link.passive)

    def joint_frame(self, joint: str) -> JointFrame:
        """At the far end of the body that carries the joint."""
        self._check_joint("joint_frame", joint)
        bodies = ["base", *(link.name for link in self.links)]
        return JointFrame(slide=False, origin=(f"{bodies[bodies.index(joint) - 1]}.length", "", ""))

    @property
    def efforts(self) -> tuple[float, ...]:
        """Largest torque of the actuated joints either way, N m; infinite where none is given."""
        return tuple(link.effort or float("inf") for link in self.links if not link.passive)

    @property
    def speeds(self) -> tuple[float, ...]:
        """Largest speed of the actuated joints either way, rad/s; infinite where none is given."""
        return tuple(link.speed or float("inf") for link in self.links if not link.passive)

    @property
    def support_points(self) -> tuple[tuple[float, ...], ...]:
        """The two ends (x,) of what the undercarriage stands on, m, rear first; empty where none is given."""
        return () if self.support is None else tuple((x,) for x in self.support.span)

    @property
    def base_coordinates(self) -> tuple[str, ...]:
        """Names of the placement coordinates that the operator chooses."""
        return ("x",)

    @property
    def base_units(self) -> tuple[str, ...]:
        """Unit of each placement coordinate."""
        return ("m",)

    @property
    def task_rows(self) -> tuple[str, ...]:
        """Names of the end-point's coordinates."""
        return ("x", "y")

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
