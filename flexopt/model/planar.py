"""The planar machine file as validated data: a chain on a compliant base, read into a `KinematicTree`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from flexopt.errors import Fault
from flexopt.foundation.quantities import (
    ANGLE,
    EFFORT,
    LENGTH_OR_ZERO,
    SPEED,
    Angle,
    Damping,
    Inertia,
    Length,
    Mass,
    Offset,
    Quantity,
    RotationalDamping,
    RotationalStiffness,
    Stiffness,
    pair,
)
from flexopt.model.file_model import FileModel
from flexopt.model.kinematic_tree import EndPoint, KinematicTree, TreeBody, TreeJoint
from flexopt.model.machine import AnyMachine, NamedParameter, Parameter
from flexopt.model.planar_faults import BASE_DIRECTIONS, machine_faults
from flexopt.model.tables import Payload, Span

NORMAL = (0.0, 0.0, 1.0)
LINK_JOINT = ("passive", "stiffness", "damping", "rest", "limits", "effort", "speed", "joint_damping")


class BaseStiffness(FileModel):
    """Springs between ground and base; a direction left out is rigid.

    Attributes:
        x: along the ground.
        y: upwards.
        rotation: against turning.
    """

    x: Stiffness | None = None
    y: Stiffness | None = None
    rotation: RotationalStiffness | None = None


class BaseDamping(FileModel):
    """Dampers beside the springs.

    Attributes:
        x: along the ground.
        y: upwards.
        rotation: against turning.
    """

    x: Damping = 0.0
    y: Damping = 0.0
    rotation: RotationalDamping = 0.0


class Base(FileModel):
    """The first body, from the ground point to the arm's first joint. `com` along it, `com_offset` to its left.

    Attributes:
        length: from the ground point to the arm's first joint.
        com: of the centre of mass, along the body from the ground point.
        com_offset: of the centre of mass, to the left of that line.
        mass: of the body.
        inertia: about the centre of mass.
        rest_angle: of the body at rest, from the horizontal, counter-clockwise positive.
        stiffness: springs to the ground; a direction left out is rigid.
        damping: dampers beside the springs.
    """

    length: Annotated[float, LENGTH_OR_ZERO]
    com: Offset
    com_offset: Offset = 0.0
    mass: Mass
    inertia: Inertia
    rest_angle: Angle
    stiffness: BaseStiffness = BaseStiffness.model_construct()
    damping: BaseDamping = BaseDamping.model_construct()


class Link(FileModel):
    """A link and the hinge that carries it: actuated, or passive with a spring.

    An actuated hinge may have `limits`, rad, an `effort`, the largest torque either way, N m, and a `speed`, rad/s.

    Attributes:
        name: of the link and of its joint; numbered where left out.
        length: from its joint to the next one, or to the end-point.
        com: of the centre of mass, along the link from its joint.
        com_offset: of the centre of mass, to the left of that line.
        mass: of the link.
        inertia: about the centre of mass.
        limits: [lower, upper] of the joint's angle, relative to the body before it.
        effort: largest torque of an actuated joint, either way; of no account where a cylinder with a force drives it.
        speed: largest rate of an actuated joint, either way.
        joint_damping: friction of an actuated joint, which grows with its rate.
        passive: true makes a flexible joint: a hinge with a spring, which no drive moves.
        stiffness: of a flexible joint's spring.
        damping: of a flexible joint's damper.
        rest: angle of a flexible joint at which its spring is slack.
    """

    name: str = ""
    length: Length
    com: Offset
    com_offset: Offset = 0.0
    mass: Mass
    inertia: Inertia
    limits: Annotated[tuple[float, float], pair(ANGLE)] | None = None
    effort: Annotated[float, Quantity("N m", above=0.0, high=EFFORT.high)] | None = None
    speed: Annotated[float, Quantity("rad/s", above=0.0, high=SPEED.high)] | None = None
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
    what drives the joints, [support] span = [rear, front] what the undercarriage stands on, [loop] (`Loop`) the
    controller, [[uncertainty]] (`Uncertainty`) what nobody has measured.

    Attributes:
        base: the first body; its joints to the ground are passive.
        links: in order, from the base outwards.
        payload: a point mass at the end-point.
        support: what the undercarriage stands on.

    Example:
        >>> machine = flexopt.load("excavator")
        >>> machine.joints, machine.coordinates
        (('boom', 'stick'), ('base.x', 'base.y', 'base.rotation', 'boom', 'stick'))
        >>> machine.links[0].mass
        766.6
    """

    base: Base
    links: tuple[Link, ...] = Field(min_length=1)
    payload: Payload = Payload.model_construct()
    support: Span | None = None

    __hash__ = AnyMachine.__hash__

    def structural_faults(self) -> list[Fault]:
        """As of a file."""
        return machine_faults(self.to_dict()) or self.part_faults()

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
            entries={entry: parameter.name for entry, parameter in self.parameter_entries()},
            drawn=tuple(range(first, len(bodies))),
            held=frozenset(() if turns else (first,)),
        )

    @property
    def support_points(self) -> tuple[tuple[float, ...], ...]:
        """The two ends (x,) of what the undercarriage stands on, m, rear first; empty where none is given."""
        return () if self.support is None else tuple((x,) for x in self.support.span)

    def parameter_entries(self) -> list[NamedParameter]:
        """See `AnyMachine`. A body's length is where the next joint stands, the last one's where the end-point is."""
        base, free = self.base, self.free_base_directions
        first = sum(direction != "rotation" for direction in free)
        listed = _of_body("base", base, first, f"offset{first + 1}.x")
        listed.append((f"rest{first}", Parameter("base.rest_angle", base.rest_angle, "rad")))
        for k, direction in enumerate(free):
            units = ("N m/rad", "N m s/rad") if direction == "rotation" else ("N/m", "N s/m")
            for word, table, unit in zip(("stiffness", "damping"), (base.stiffness, base.damping), units, strict=True):
                name, value = f"base.{word}.{direction}", float(getattr(table, direction))
                listed.append((f"{word}{k}.{k}", Parameter(name, value, unit)))
        for i, link in enumerate(self.links, first + 1):
            name, last = link.name, i == first + len(self.links)
            listed += _of_body(name, link, i, "tip.x" if last else f"offset{i + 1}.x")
            if link.passive and link.stiffness is not None:
                listed += [
                    (f"stiffness{i}.{i}", Parameter(f"{name}.stiffness", link.stiffness, "N m/rad")),
                    (f"damping{i}.{i}", Parameter(f"{name}.damping", link.damping, "N m s/rad")),
                    (f"rest{i}", Parameter(f"{name}.rest", link.rest, "rad")),
                ]
            else:
                friction = Parameter(f"{name}.joint_damping", link.joint_damping, "N m s/rad")
                listed.append((f"damping{i}.{i}", friction))
        listed.append(("payload", Parameter("payload.mass", self.payload.mass, "kg")))
        return [*listed, ("gravity", Parameter("gravity", self.gravity, "m/s²"))]

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


def _of_body(name: str, of: Base | Link, i: int, end: str) -> list[NamedParameter]:
    """Geometry and inertia of body i; `end` is the entry that its length is."""
    return [
        (end, Parameter(f"{name}.length", of.length, "m")),
        (f"com{i}.x", Parameter(f"{name}.com", of.com, "m")),
        (f"com{i}.y", Parameter(f"{name}.com_offset", of.com_offset, "m")),
        (f"mass{i}", Parameter(f"{name}.mass", of.mass, "kg")),
        (f"inertia{i}.zz", Parameter(f"{name}.inertia", of.inertia, "kg m²")),
    ]
