"""A spatial machine as validated data: a tree of rigid bodies, each on one joint of one degree of freedom.

Readers of robot files end here and the spatial plant starts here. Units are SI and angles radians. A body's frame is
that of its joint at zero: the joint stands at `position`, turned by `rotation`, in the parent's frame, and moves the
body along or about `axis`. The ground's frame is the anchor frame, which the placement moves over the ground; z is up.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from flexopt.errors import Fault, ModelError
from flexopt.foundation.boundary import public
from flexopt.foundation.quantities import Length, MassOrZero, checked
from flexopt.model.cylinder_faults import check_strokes
from flexopt.model.faults import Table, read_table, validated
from flexopt.model.hydraulics import JointFrame
from flexopt.model.machine import AnyMachine, FileModel, Parameter, Payload
from flexopt.model.table_quantities import check_armature_value, check_effort_value, check_speed_value
from flexopt.model.tables import Polygon
from flexopt.model.tree_faults import tree_faults
from flexopt.model.tree_quantities import (
    Axis,
    InertiaSix,
    Pair,
    Point,
    Rotation,
    Square,
    axes_about,
    check_damping_value,
    check_rest_value,
    check_stiffness_value,
    snapped_rows,
)

Row = Literal["x", "y", "z", "roll", "pitch", "yaw"]
Placement = Literal["x", "y", "yaw"]
ORIENTATION_ROWS: tuple[Row, ...] = ("roll", "pitch", "yaw")
INERTIA_ENTRIES = ("xx", "yy", "zz", "xy", "xz", "yz")
UNTURNED = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class TreeJoint(FileModel):
    """A hinge or a slide. Passive: spring, damper, rest value; else actuated: limits, effort, speed and friction.

    A passive joint has a `stiffness` unless the tree's `stiffness_matrix` names it. Units follow `kind`: N m/rad,
    N m s/rad and rad, or N/m, N s/m and m. `effort` (N m or N) and `speed` (rad/s or m/s) bound it either way.
    `armature` (kg m² or kg) is inertia that turns with the joint alone, such as a geared rotor's: it is added to the
    joint's entry on the diagonal of M. `axis` (3,) is scaled to length 1.
    """

    name: str = Field(min_length=1)
    kind: Literal["hinge", "slide"]
    axis: Axis
    passive: bool = False
    stiffness: Annotated[float, checked(check_stiffness_value)] | None = None
    damping: Annotated[float, checked(check_damping_value)] = 0.0
    rest: Annotated[float, checked(check_rest_value)] = 0.0
    limits: Pair | None = None
    effort: Annotated[float, checked(check_effort_value)] | None = None
    speed: Annotated[float, checked(check_speed_value)] | None = None
    armature: Annotated[float, checked(check_armature_value)] = 0.0
    joint_damping: Annotated[float, checked(check_damping_value)] = 0.0


class TreeBody(FileModel):
    """A rigid body and the joint that carries it on `parent` (None: on the ground).

    `rotation` is a matrix of three rows, or three numbers (roll, pitch, yaw): Rz(yaw) Ry(pitch) Rx(roll). `com` (3,)
    and `inertia` (xx, yy, zz, xy, xz, yz; about the centre of mass) are in the body's axes. A body may have no mass:
    a joint of several degrees of freedom is a series of such bodies.
    """

    name: str = Field(min_length=1)
    parent: str | None = None
    joint: TreeJoint
    position: Point = (0.0, 0.0, 0.0)
    rotation: Rotation = UNTURNED
    mass: MassOrZero = 0.0
    com: Point = (0.0, 0.0, 0.0)
    inertia: InertiaSix = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def massless(self) -> bool:
        """Whether the body has neither mass nor inertia."""
        return self.mass == 0 and not any(self.inertia)


class EndPoint(FileModel):
    """The frame on `body` that does the work, and which of its coordinates are the task.

    Position rows (x, y, z) are in m, inertial axes. Orientation rows (roll, pitch, yaw) are the components of the
    rotation vector that leads from the frame `reference`, fixed to the inertial axes, to the end-point's, times
    `length`, so that they are in m too.
    """

    body: str = Field(min_length=1)
    position: Point = (0.0, 0.0, 0.0)
    rotation: Rotation = UNTURNED
    rows: tuple[Row, ...] = Field(default=("x", "y", "z"))
    reference: Rotation = UNTURNED
    length: Length = 1.0


class JointMatrix(FileModel):
    """A symmetric matrix over passive joints, in the order of `joints`: stiffness or damping that couples them."""

    joints: tuple[str, ...]
    matrix: Square


class Tree(AnyMachine):
    """A spatial machine: bodies in topological order (each after its parent), compliance, end-point, placement.

    Gravity acts along −z. `stiffness_matrix` and `damping_matrix` stand in for `stiffness` and `damping` of the passive
    joints that they name. `placement` lists the coordinates of the anchor frame that the operator chooses. `capsules`
    say what the bodies fill, `support` what the undercarriage stands on.
    """

    bodies: tuple[TreeBody, ...]
    end_point: EndPoint
    stiffness_matrix: JointMatrix | None = None
    damping_matrix: JointMatrix | None = None
    placement: tuple[Placement, ...] = ("x", "y", "yaw")
    payload: Payload = Payload()
    support: Polygon | None = None

    __hash__ = AnyMachine.__hash__

    def structural_faults(self) -> list[Fault]:
        """As of `tree_from_dict`."""
        return tree_faults(self.to_dict()) or self.stroke_faults()

    @property
    def passive_bodies(self) -> tuple[TreeBody, ...]:
        """Bodies on passive joints, in order."""
        return tuple(body for body in self.bodies if body.joint.passive)

    @property
    def actuated_bodies(self) -> tuple[TreeBody, ...]:
        """Bodies on actuated joints, in order."""
        return tuple(body for body in self.bodies if not body.joint.passive)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of q: the passive joints, then the actuated ones."""
        return tuple(body.joint.name for body in (*self.passive_bodies, *self.actuated_bodies))

    @property
    def coordinate_units(self) -> tuple[str, ...]:
        """Unit of each entry of q."""
        return (*_units(self.passive_bodies), *self.joint_units)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the actuated joints."""
        return tuple(body.joint.name for body in self.actuated_bodies)

    @property
    def joint_units(self) -> tuple[str, ...]:
        """Unit of each actuated joint, rad or m."""
        return _units(self.actuated_bodies)

    @property
    def damped_joints(self) -> bool:
        """Whether any actuated joint has friction."""
        return any(body.joint.joint_damping > 0 for body in self.actuated_bodies)

    @property
    def joint_limits(self) -> tuple[tuple[float, float], ...]:
        """Limits of the actuated joints as they were given, rad or m; infinite where none are."""
        unlimited = (-float("inf"), float("inf"))
        return tuple(body.joint.limits or unlimited for body in self.actuated_bodies)

    def joint_frame(self, joint: str) -> JointFrame:
        """The joint's axis is the third of its frame."""
        self._check_joint("joint_frame", joint)
        body = next(body for body in self.actuated_bodies if body.joint.name == joint)
        of_body = axes_about(body.joint.axis)
        of_parent = snapped_rows(np.array(of_body) @ np.array(body.rotation).T)
        x, y, z = (f"{body.name}.position.{axis}" for axis in "xyz")
        return JointFrame(body.joint.kind == "slide", (x, y, z), of_parent, of_body)

    @property
    def efforts(self) -> tuple[float, ...]:
        """Largest torque or force of the actuated joints either way, N m or N; infinite where none is given."""
        return tuple(body.joint.effort or float("inf") for body in self.actuated_bodies)

    @property
    def speeds(self) -> tuple[float, ...]:
        """Largest speed of the actuated joints either way, rad/s or m/s; infinite where none is given."""
        return tuple(body.joint.speed or float("inf") for body in self.actuated_bodies)

    @property
    def support_points(self) -> tuple[tuple[float, ...], ...]:
        """Corners (x, y) of the polygon that the undercarriage stands on, m, counter-clockwise; empty without one."""
        return () if self.support is None else self.support.polygon

    @property
    def base_coordinates(self) -> tuple[str, ...]:
        """Names of the placement coordinates that the operator chooses."""
        return self.placement

    @property
    def base_units(self) -> tuple[str, ...]:
        """Unit of each placement coordinate, m or rad."""
        return tuple("rad" if name == "yaw" else "m" for name in self.placement)

    @property
    def task_rows(self) -> tuple[str, ...]:
        """Names of the end-point's coordinates."""
        return self.end_point.rows

    def list_parameters(self) -> list[Parameter]:
        """See `parameters`.

        Directions (axes, rotations) are no parameters, nor are mass and inertia of a body that has none and a zero
        armature.
        """
        listed: list[Parameter] = []
        for body in self.bodies:
            listed += _vector(f"{body.name}.position", body.position)
            if not body.massless:
                listed.append(Parameter(f"{body.name}.mass", body.mass, "kg"))
                listed += _vector(f"{body.name}.com", body.com)
                entries = zip(INERTIA_ENTRIES, body.inertia, strict=True)
                listed += [Parameter(f"{body.name}.inertia.{entry}", value, "kg m²") for entry, value in entries]
            listed += self._joint_parameters(body.joint)
        for word, coupling in (("stiffness", self.stiffness_matrix), ("damping", self.damping_matrix)):
            listed += self._matrix_parameters(word, coupling)
        listed += _vector("end_point.position", self.end_point.position)
        return [*listed, Parameter("payload.mass", self.payload.mass, "kg"), Parameter("gravity", self.gravity, "m/s²")]

    def _joint_parameters(self, joint: TreeJoint) -> list[Parameter]:
        turn = joint.kind == "hinge"
        spring, damper, unit = ("N m/rad", "N m s/rad", "rad") if turn else ("N/m", "N s/m", "m")
        rotor = Parameter(f"{joint.name}.armature", joint.armature, "kg m²" if turn else "kg")
        listed = [rotor] if joint.armature else []
        if not joint.passive:
            return [*listed, Parameter(f"{joint.name}.joint_damping", joint.joint_damping, damper)]
        if joint.stiffness is not None:
            listed.append(Parameter(f"{joint.name}.stiffness", joint.stiffness, spring))
        if self.damping_matrix is None or joint.name not in self.damping_matrix.joints:
            listed.append(Parameter(f"{joint.name}.damping", joint.damping, damper))
        return [*listed, Parameter(f"{joint.name}.rest", joint.rest, unit)]

    def _matrix_parameters(self, word: str, coupling: JointMatrix | None) -> list[Parameter]:
        """The upper triangle, row by row."""
        if coupling is None:
            return []
        turns = {body.joint.name for body in self.bodies if body.joint.kind == "hinge"}
        per = " s" if word == "damping" else ""
        units = (f"N{per}/m", f"N{per}", f"N m{per}/rad")
        names = coupling.joints
        return [
            Parameter(f"{word}.{a}.{b}", coupling.matrix[i][i + j], units[(a in turns) + (b in turns)])
            for i, a in enumerate(names)
            for j, b in enumerate(names[i:])
        ]

    def __repr__(self) -> str:
        passive = ", ".join(body.joint.name for body in self.passive_bodies)
        return f"Tree({self.name!r}: passive joints: {passive}; actuated joints: {', '.join(self.joints)})"


def _units(bodies: tuple[TreeBody, ...]) -> tuple[str, ...]:
    return tuple("rad" if body.joint.kind == "hinge" else "m" for body in bodies)


def _vector(name: str, values: tuple[float, float, float]) -> list[Parameter]:
    return [Parameter(f"{name}.{axis}", value, "m") for axis, value in zip("xyz", values, strict=True)]


@public(error=ModelError)
def tree_from_dict(data: Table, *, origin: str = "tree") -> Tree:
    """Validate a dictionary in the layout of `Tree`; lists may stand for tuples.

    Args:
        data: the fields of `Tree`, nested.
        origin: what the message calls the source.

    Raises:
        ModelError: lists every fault.
    """
    frozen = read_table(data, origin, "flexopt.Tree")
    tree = validated(Tree, frozen, origin, tree_faults(frozen))
    check_strokes(tree, origin)
    return tree
