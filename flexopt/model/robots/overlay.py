"""The machine file around a robot file, as validated data: TOML in, `Overlay` out. The keys are told in `reading`."""

from __future__ import annotations

from typing import Annotated, Any, Literal, cast

from pydantic import ConfigDict, Field

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
    a_list,
    each,
    entries,
)
from flexopt.model.file_model import Described, FileModel
from flexopt.model.hydraulics import Cylinder
from flexopt.model.kinematic_tree import UNTURNED, Placement, TaskRow
from flexopt.model.loop import Loop
from flexopt.model.robots.elements import there_are
from flexopt.model.tables import Payload, Polygon
from flexopt.model.tree_quantities import (
    JointInterval,
    Point3,
    Rotation,
    check_square,
)
from flexopt.model.uncertainty import Uncertainty

DIRECTIONS = ("x", "y", "z", "roll", "pitch", "yaw")
Ignorable = Literal["armature", "equality", "tendon", "gravcomp", "unknown"]

ByDirection = dict[str, float]
CoupledMatrix = tuple[tuple[float, ...], ...]


def _by_direction(linear: Quantity, turning: Quantity) -> Checked[ByDirection | CoupledMatrix]:
    """A table by direction, six numbers, or a matrix."""
    quantities = dict(zip(DIRECTIONS, [linear] * 3 + [turning] * 3, strict=True))

    def check(value: Any) -> ByDirection | CoupledMatrix:
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

    sides = len(DIRECTIONS)
    numbers = {name: quantity.accepts for name, quantity in quantities.items()}
    table = {"type": "object", "properties": numbers, "additionalProperties": False}
    largest = max(linear.high, turning.high)
    six, square = a_list({"type": "number", "minimum": 0, "maximum": largest}, sides, sides), check_square.accepts or {}
    return Checked(check, {"anyOf": [table, six, square | {"minItems": sides, "maxItems": sides}]})


class BaseTable(FileModel):
    """What the root link stands on.

    Attributes:
        stiffness: by direction (x, y, z in N/m; roll, pitch, yaw in N m/rad; one left out is rigid), six
            numbers in this order, or a symmetric 6 × 6 matrix of a base that gives in all of them.
        damping: likewise, in N s/m and N m s/rad; 0 where left out.
        point: where the springs act, in the root link's frame; of axles apart from each other the elastic centre, where
            a force tilts nothing. The root link's com among the machine's parameters counts from here.
        position: of the root link at rest, springs unloaded, in the anchor frame; from the robot file where left out.
        rotation: of the root link at rest: roll, pitch, yaw in rad, or a rotation matrix.
    """

    stiffness: Annotated[ByDirection | CoupledMatrix, _by_direction(STIFFNESS, ROTATIONAL_STIFFNESS)]
    damping: Annotated[ByDirection | CoupledMatrix, _by_direction(DAMPING, ROTATIONAL_DAMPING)] = Field(
        default_factory=dict[str, float]
    )
    point: Point3 = (0.0, 0.0, 0.0)
    position: Point3 | None = None
    rotation: Rotation | None = None


class EndPointTable(FileModel):
    """Where the work is done.

    Attributes:
        link: (a body, in MJCF) that carries the end-point; or give `site`.
        site: of an MJCF file that is the end-point.
        offset: of the end-point in the link's axes.
        rotation: of its axes in the link's: roll, pitch, yaw in rad, or a rotation matrix.
        rows: coordinates of the end-point that are the task. roll, pitch and yaw are no angles one after the other, but
            the components of the rotation vector (axis times angle) from `reference` to the end-point's axes, in the
            axes of `reference`: of a turn about one of them alone the angle; where an arm slews as well the one depends
            on the other.
        reference: orientation from which roll, pitch and yaw rows are counted, in inertial axes; best one near those of
            the targets, slew included.
        length: by which roll, pitch and yaw rows are multiplied, so that they are in m, too.
    """

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": ["link"]}, {"required": ["site"]}]})

    link: str | None = None
    site: str | None = None
    offset: Point3 = (0.0, 0.0, 0.0)
    rotation: Rotation = UNTURNED
    rows: tuple[TaskRow, ...] = ("x", "y", "z")
    reference: Rotation = UNTURNED
    length: Length = 1.0


class JointTable(FileModel):
    """What the machine file says in place of the robot file.

    Attributes:
        stiffness: of a spring, which makes the joint passive.
        damping: of a passive joint's damper, or friction of an actuated joint.
        rest: value of a passive joint at which its spring is slack.
        limits: [lower, upper] of the joint.
        effort: largest torque or force either way.
        speed: largest rate either way.
        armature: inertia of a geared rotor, which turns with the joint alone.
    """

    stiffness: Annotated[float, Quantity(JOINT_STIFFNESS.unit, low=0.0, high=JOINT_STIFFNESS.high)] | None = None
    damping: Annotated[float, JOINT_DAMPING] | None = None
    rest: Annotated[float, JOINT_VALUE] | None = None
    limits: JointInterval | None = None
    effort: Annotated[float, EFFORT] | None = None
    speed: Annotated[float, SPEED] | None = None
    armature: Annotated[float, ARMATURE] | None = None


class CapsuleTable(FileModel):
    """What a link fills, its ends in the link's frame; see `Capsule`.

    Attributes:
        link: that the capsule moves with.
        start: one end of the segment, in the link's frame.
        end: its other end; equal ends make a ball.
        radius: around the segment.
    """

    link: str = Field(min_length=1)
    start: Point3
    end: Point3
    radius: Length


class Overlay(Described):
    """A spatial machine file.

    Attributes:
        robot: URDF or MJCF file; its path starts from this file's folder.
        root: link to start from; what carries it is left out.
        gravity: along −z; the MJCF file's, or 9.81, where left out.
        actuated: names of the driven joints, from the base outwards.
        locked: joints that do not move, and where they stand, rad or m.
        lock_others: true locks every joint that is neither actuated nor has a spring where the file has it.
        ignore: what of the robot file is read as if it were not there.
        placement: coordinates of the anchor frame that the operator chooses.
        base: what the root link stands on; without it the root link is fixed to the ground.
        joints: what holds in place of what the robot file says, by the joint's name.
        end_point: the frame that does the work.
        payload: a point mass at the end-point.
        capsules: what the links fill; `"collision"` takes them from the robot file's collision geometry.
        cylinders: what drives the joints.
        support: what the undercarriage stands on.
        loop: the controller that the machine has.
        uncertainty: what nobody has measured of it.
    """

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
