"""What every machine has, and the planar machine as validated data: bodies, joints, compliance, payload, parameters."""

from __future__ import annotations

import hashlib
from abc import abstractmethod
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
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
from flexopt.model.kinematic_tree import EndPoint, KinematicTree, TreeBody, TreeJoint, units_of
from flexopt.model.strokes import CylinderTravel, usable_range
from flexopt.model.tables import BuiltByCall, Capsule, FileModel, Payload, Span
from flexopt.model.tree_quantities import axes_about, snapped_rows

NORMAL = (0.0, 0.0, 1.0)
LINK_JOINT = ("passive", "stiffness", "damping", "rest", "limits", "effort", "speed", "joint_damping")
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

    @abstractmethod
    def build_tree(self) -> KinematicTree:
        """See `kinematic_tree`."""

    @cached_property
    def kinematic_tree(self) -> KinematicTree:
        """The machine as bodies and joints: all that is computed from it starts there."""
        return self.build_tree()

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of q: the passive joints, then the actuated ones."""
        tree = self.kinematic_tree
        return tuple(body.joint.name for body in (*tree.passive, *tree.actuated))

    @property
    def coordinate_units(self) -> tuple[str, ...]:
        """Unit of each entry of q."""
        return (*units_of(self.kinematic_tree.passive), *self.joint_units)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the actuated joints, from the base outwards."""
        return tuple(body.joint.name for body in self.kinematic_tree.actuated)

    @property
    def joint_units(self) -> tuple[str, ...]:
        """Unit of each actuated joint, rad or m."""
        return units_of(self.kinematic_tree.actuated)

    @property
    def joint_limits(self) -> tuple[tuple[float, float], ...]:
        """Limits of the actuated joints as they were given, rad or m; infinite where none are."""
        unlimited = (-float("inf"), float("inf"))
        return tuple(body.joint.limits or unlimited for body in self.kinematic_tree.actuated)

    def joint_frame(self, joint: str) -> JointFrame:
        """How an actuated joint stands between the bodies that it joins; its axis is the third of its frame."""
        self._check_joint("joint_frame", joint)
        tree = self.kinematic_tree
        i = next(i for i, body in enumerate(tree.bodies) if body.joint.name == joint)
        body = tree.bodies[i]
        of_body = axes_about(body.joint.axis)
        of_parent = snapped_rows(np.array(of_body) @ np.array(body.rotation).T)
        x, y, z = (tree.entries.get(f"offset{i}.{axis}", "") for axis in "xyz")
        return JointFrame(body.joint.kind == "slide", (x, y, z), of_parent, of_body)

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
    def efforts(self) -> tuple[float, ...]:
        """Largest torque or force of the actuated joints either way, N m or N; infinite where none is given."""
        return tuple(body.joint.effort or float("inf") for body in self.kinematic_tree.actuated)

    @property
    def speeds(self) -> tuple[float, ...]:
        """Largest speed of the actuated joints either way, rad/s or m/s; infinite where none is given."""
        return tuple(body.joint.speed or float("inf") for body in self.kinematic_tree.actuated)

    @property
    @abstractmethod
    def support_points(self) -> tuple[tuple[float, ...], ...]:
        """What the undercarriage stands on, m, in the anchor frame; empty where none is given.

        In the plane the two ends (x,), rear first; in space the corners (x, y) of a convex polygon, counter-clockwise.
        """

    @property
    def damped_joints(self) -> bool:
        """Whether any actuated joint has friction."""
        return any(body.joint.joint_damping > 0 for body in self.kinematic_tree.actuated)

    @property
    def base_coordinates(self) -> tuple[str, ...]:
        """Names of the placement coordinates that the operator chooses."""
        return self.kinematic_tree.placement

    @property
    def base_units(self) -> tuple[str, ...]:
        """Unit of each placement coordinate, m or rad."""
        return tuple("rad" if name == "yaw" else "m" for name in self.base_coordinates)

    @property
    def task_rows(self) -> tuple[str, ...]:
        """Names of the end-point's coordinates: x, y, z, and in space roll, pitch, yaw."""
        return self.kinematic_tree.end_point.rows

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

    def build_tree(self) -> KinematicTree:
        """A chain in the plane of x and y, y up: slides and a hinge of the base, then a hinge for each link.

        A direction in which the base is rigid has no slide; a base that cannot turn is held at its rest angle.
        """
        free = self.free_base_directions
        slides = [_slide(direction, self.base, free[:k]) for k, direction in enumerate(free) if direction != "rotation"]
        turns = "rotation" in free
        joint = TreeJoint.model_construct(
            name="base.rotation",
            kind="hinge",
            axis=NORMAL,
            passive=True,
            stiffness=self.base.stiffness.rotation,
            damping=self.base.damping.rotation,
            rest=self.base.rest_angle,
        )
        bodies = [*slides, _body("base", self.base, joint, slides[-1].name if slides else None, 0.0)]
        first = len(slides)
        for link in self.links:
            said = {key: getattr(link, key) for key in LINK_JOINT}
            joint = TreeJoint.model_construct(name=link.name, kind="hinge", axis=NORMAL, **said)
            before = self.base if len(bodies) == first + 1 else self.links[len(bodies) - first - 2]
            bodies.append(_body(link.name, link, joint, bodies[-1].name, before.length))
        tip = (self.links[-1].length, 0.0, 0.0)
        return KinematicTree(
            bodies=tuple(bodies),
            end_point=EndPoint.model_construct(body=bodies[-1].name, position=tip, rows=("x", "y")),
            placement=("x",),
            axes=("x", "y"),
            entries=self._entries(first),
            drawn=tuple(range(first, len(bodies))),
            held=frozenset(() if turns else (first,)),
        )

    def _entries(self, first: int) -> dict[str, str]:
        """Which parameter each number of the tree is; `first` is the index of the base's body."""
        free = self.free_base_directions
        names = ["base", *(link.name for link in self.links)]
        entries = {"payload": "payload.mass", "gravity": "gravity", "tip.x": f"{names[-1]}.length"}
        entries[f"rest{first}"] = "base.rest_angle"
        for k, direction in enumerate(free):
            entries |= {f"{word}{k}.{k}": f"base.{word}.{direction}" for word in ("stiffness", "damping")}
        for i, name in enumerate(names, first):
            entries |= {f"mass{i}": f"{name}.mass", f"inertia{i}.zz": f"{name}.inertia"}
            entries |= {f"com{i}.x": f"{name}.com", f"com{i}.y": f"{name}.com_offset"}
        for i, (link, before) in enumerate(zip(self.links, names, strict=False), first + 1):
            entries[f"offset{i}.x"] = f"{before}.length"
            if link.passive:
                entries |= {f"{word}{i}.{i}": f"{link.name}.{word}" for word in ("stiffness", "damping")}
                entries[f"rest{i}"] = f"{link.name}.rest"
            else:
                entries[f"damping{i}.{i}"] = f"{link.name}.joint_damping"
        return entries

    @property
    def support_points(self) -> tuple[tuple[float, ...], ...]:
        """The two ends (x,) of what the undercarriage stands on, m, rear first; empty where none is given."""
        return () if self.support is None else tuple((x,) for x in self.support.span)

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


def _slide(direction: str, base: Base, before: tuple[str, ...]) -> TreeBody:
    """The massless body that gives in a direction."""
    joint = TreeJoint.model_construct(
        name=f"base.{direction}",
        kind="slide",
        axis=(1.0, 0.0, 0.0) if direction == "x" else (0.0, 1.0, 0.0),
        passive=True,
        stiffness=getattr(base.stiffness, direction),
        damping=getattr(base.damping, direction),
    )
    parent = f"base.{before[-1]}" if before else None
    return TreeBody.model_construct(name=f"base.{direction}", parent=parent, joint=joint)


def _body(name: str, of: Base | Link, joint: TreeJoint, parent: str | None, along: float) -> TreeBody:
    return TreeBody.model_construct(
        name=name,
        parent=parent,
        joint=joint,
        position=(along, 0.0, 0.0),
        mass=of.mass,
        com=(of.com, of.com_offset, 0.0),
        inertia=(0.0, 0.0, of.inertia, 0.0, 0.0, 0.0),
    )
