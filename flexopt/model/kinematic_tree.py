"""What every machine comes down to: a tree of rigid bodies, each on one joint of one degree of freedom.

Readers of machine files end here and the plant starts here. Units are SI and angles radians. A body's frame is that of
its joint at zero: the joint stands at `position`, turned by `rotation`, in the parent's frame, and moves the body along
or about `axis`. The ground's frame is the anchor frame, which the placement moves over the ground.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal

from pydantic import Field

from flexopt.foundation.quantities import (
    ARMATURE,
    EFFORT,
    JOINT_DAMPING,
    JOINT_STIFFNESS,
    JOINT_VALUE,
    SPEED,
    Length,
    MassOrZero,
)
from flexopt.model.file_model import FileModel
from flexopt.model.tree_quantities import (
    UNTURNED,
    InertiaSix,
    JointAxis,
    JointInterval,
    Point3,
    Rotation,
    Square,
)

TaskRow = Literal["x", "y", "z", "roll", "pitch", "yaw"]
Placement = Literal["x", "y", "yaw"]
ORIENTATION_ROWS: tuple[TaskRow, ...] = ("roll", "pitch", "yaw")
INERTIA_ENTRIES = ("xx", "yy", "zz", "xy", "xz", "yz")


class TreeJoint(FileModel):
    """A hinge or a slide. Passive: spring, damper, rest value; else actuated: limits, effort, speed and friction.

    A passive joint has a `stiffness` unless the tree's `stiffness_matrix` names it. Units follow `kind`: N m/rad,
    N m s/rad and rad, or N/m, N s/m and m. `effort` (N m or N) and `speed` (rad/s or m/s) bound it either way;
    where a cylinder with a force drives the joint, that takes the place of the effort.
    `armature` (kg m² or kg) is inertia that turns with the joint alone, such as a geared rotor's: it is added to the
    joint's entry on the diagonal of M. `axis` (3,) is scaled to length 1.
    """

    name: str = Field(min_length=1)
    kind: Literal["hinge", "slide"]
    axis: JointAxis
    passive: bool = False
    stiffness: Annotated[float, JOINT_STIFFNESS] | None = None
    damping: Annotated[float, JOINT_DAMPING] = 0.0
    rest: Annotated[float, JOINT_VALUE] = 0.0
    limits: JointInterval | None = None
    effort: Annotated[float, EFFORT] | None = None
    speed: Annotated[float, SPEED] | None = None
    armature: Annotated[float, ARMATURE] = 0.0
    joint_damping: Annotated[float, JOINT_DAMPING] = 0.0


class TreeBody(FileModel):
    """A rigid body and the joint that carries it on `parent` (None: on the ground).

    `rotation` is a matrix of three rows, or three numbers (roll, pitch, yaw): Rz(yaw) Ry(pitch) Rx(roll). `com` (3,)
    and `inertia` (xx, yy, zz, xy, xz, yz; about the centre of mass) are in the body's axes. A body may have no mass:
    a joint of several degrees of freedom is a series of such bodies.
    """

    name: str = Field(min_length=1)
    parent: str | None = None
    joint: TreeJoint
    position: Point3 = (0.0, 0.0, 0.0)
    rotation: Rotation = UNTURNED
    mass: MassOrZero = 0.0
    com: Point3 = (0.0, 0.0, 0.0)
    inertia: InertiaSix = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def massless(self) -> bool:
        """Whether the body has neither mass nor inertia."""
        return self.mass == 0 and not any(self.inertia)


class EndPoint(FileModel):
    """The frame on `body` that does the work, and which of its coordinates are the task.

    Position rows (x, y, z) are in m, inertial axes. Orientation rows (roll, pitch, yaw) are the components of the
    rotation vector that leads from the frame `reference`, fixed to the inertial axes, to the end-point's, in the axes
    of `reference`, times `length`, so that they are in m too.
    """

    body: str = Field(min_length=1)
    position: Point3 = (0.0, 0.0, 0.0)
    rotation: Rotation = UNTURNED
    rows: tuple[TaskRow, ...] = Field(default=("x", "y", "z"))
    reference: Rotation = UNTURNED
    length: Length = 1.0


class JointMatrix(FileModel):
    """A symmetric matrix over passive joints, in the order of `joints`: stiffness or damping that couples them."""

    joints: tuple[str, ...]
    matrix: Square


@dataclass(frozen=True)
class KinematicTree:
    """Bodies in topological order (each after its parent), compliance, end-point, placement.

    Attributes:
        bodies: of the tree.
        end_point: the frame that does the work.
        placement: coordinates of the anchor frame that the operator chooses.
        axes: inertial axes that points are given in, the last one pointing up: all three, or those of a plane.
        entries: which parameter of the machine each number of the tree is; one without is 0. By body i: `offset{i}.x` …
            (its position), `mass{i}`, `com{i}.x` …, `inertia{i}.xx` …, `armature{i}`, `rest{i}`; of joints
            `stiffness{i}.{j}`, `damping{i}.{j}`; `tip.x` … (the end-point's position), `payload`, `gravity`.
        drawn: bodies whose origins make a picture, None for the anchor frame's, from the ground outwards.
        held: bodies whose joint stays at its rest value: it is passive, but no coordinate.
        coupled_springs, coupled_dampers: groups of bodies whose joints have a common matrix.
    """

    bodies: tuple[TreeBody, ...]
    end_point: EndPoint
    placement: tuple[Placement, ...]
    axes: tuple[str, ...] = ("x", "y", "z")
    entries: Mapping[str, str] = field(default_factory=dict[str, str])
    drawn: tuple[int | None, ...] = ()
    held: frozenset[int] = frozenset()
    coupled_springs: tuple[int, ...] = ()
    coupled_dampers: tuple[int, ...] = ()

    @property
    def passive(self) -> tuple[TreeBody, ...]:
        """Bodies on passive joints that move, in order."""
        return tuple(body for i, body in enumerate(self.bodies) if body.joint.passive and i not in self.held)

    @property
    def actuated(self) -> tuple[TreeBody, ...]:
        """Bodies on actuated joints, in order."""
        return tuple(body for body in self.bodies if not body.joint.passive)

    @property
    def frames(self) -> tuple[int, ...]:
        """Bodies that a machine file names: those that are drawn."""
        return tuple(i for i in self.drawn if i is not None)

    @property
    def up(self) -> int:
        """Which of x, y, z points up."""
        return "xyz".index(self.axes[-1])


def units_of(bodies: tuple[TreeBody, ...]) -> tuple[str, ...]:
    """Unit of each body's joint, rad or m."""
    return tuple("rad" if body.joint.kind == "hinge" else "m" for body in bodies)
