"""The planar machine file as validated data: a chain on a compliant base, read into a `KinematicTree`."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from flexopt.errors import Fault
from flexopt.foundation.quantities import (
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
)
from flexopt.model.kinematic_tree import EndPoint, KinematicTree, TreeBody, TreeJoint
from flexopt.model.machine import AnyMachine, Parameter
from flexopt.model.tables import FileModel, Payload, Span

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
