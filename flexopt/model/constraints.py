"""What a configuration must keep besides the target, as validated data: the table [constraints] of a problem.

In: a dictionary in the table's layout. Out: frozen `Constraints`. Whether they suit a machine (bodies that it has,
coordinates in the plane or in space) is told by `flexopt.selection.constraints`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, cast

from pydantic import BeforeValidator, field_serializer
from pydantic_core import PydanticCustomError

from flexopt.errors import Fault, ModelError, raise_if_any
from flexopt.foundation.arrays import Interval
from flexopt.foundation.nearest import hint
from flexopt.foundation.plain import Unreadable, plain_table
from flexopt.foundation.quantities import (
    ANGLE,
    COORDINATE,
    JOINT_VALUE,
    LENGTH,
    LENGTH_MAX,
    LENGTH_OR_ZERO,
    Checked,
    Quantity,
    a_list,
    accepting,
    each,
    entries,
    pair,
    several,
    vector,
)
from flexopt.model.file_model import FileModel, read_table, validated
from flexopt.model.own import Constraint, check_own_constraints, is_function
from flexopt.model.polygons import POLYGON, Corners, check_simple_polygon
from flexopt.model.targets import PLACEMENT, SOME_COORDINATES
from flexopt.model.tree_quantities import scaled_direction
from flexopt.model.uncertainty import Uncertainty, ranges_by_place

Area = Interval | Corners
_IN_M = "numbers in m: [x, y] in the plane, [x, y, z] in space"
_PLACE, _SIDES = (vector(_IN_M, quantity, "xy", "xyz") for quantity in (COORDINATE["m"], LENGTH_OR_ZERO))
_DIRECTION = vector(_IN_M.replace(" in m", ""), Quantity("", low=-LENGTH_MAX, high=LENGTH_MAX), "xy", "xyz")
_INTERVAL = pair(COORDINATE["m"], "an interval [lower, upper] or a polygon [[x, y], …],")
_POSITIVE = Quantity("", above=0.0, high=1e12)
_RATE, _TIME = (Quantity(unit, low=-1e6, high=1e6) for unit in ("1/s", "s"))


@accepting({"anyOf": [ANGLE.accepts, a_list(ANGLE.accepts or {}, 2, 2)]})
def _check_tool_angle(value: Any) -> Interval:
    """[lo, hi], or one number for both."""
    if not isinstance(value, list | tuple):
        angle = ANGLE(value)
        return angle, angle
    if len(entries(value)) != 2:
        raise ValueError("must be one angle or a pair [lower, upper], in rad")
    low, high = each(ANGLE, entries(value), ["lower end", "upper end"])
    if not low <= high < low + 2 * math.pi:
        raise ValueError("must be in order and less than a turn, 2π rad, wide")
    return low, high


@accepting(a_list({"anyOf": [_INTERVAL.accepts, POLYGON]}, 1))
def _check_areas(value: Any) -> tuple[Area, ...]:
    """Polygons, or for planar machines intervals [lo, hi] of x, m."""

    def check(entry: Any) -> Area:
        straight = not any(isinstance(part, list | tuple) for part in entries(entry))
        return _INTERVAL(entry) if straight else check_simple_polygon(entry)

    areas = entries(value)
    if not areas or not any(isinstance(area, list | tuple) for area in areas):
        forms = "polygons [[[x, y], …], …] or, of a planar machine, intervals of x, [[lower, upper], …]"
        raise ValueError(f"must be a list of areas, m: {forms}")
    return each(check, areas, [f"entry {index}" for index in range(len(areas))])


@accepting(_DIRECTION.accepts or {})
def _check_normal(value: Any) -> tuple[float, ...]:
    """A direction, scaled to length 1."""
    return scaled_direction(_DIRECTION(value))


@accepting(_SIDES.accepts or {})
def _check_size(value: Any) -> tuple[float, ...]:
    sides = _SIDES(value)
    if not all(sides):
        raise ValueError("must be whole lengths of the sides, each greater than 0 m")
    return sides


@accepting(a_list({"type": "string", "minLength": 1}, 1))
def _check_bodies(value: Any) -> tuple[str, ...]:
    names = entries(value)
    if not names or not all(isinstance(name, str) and name for name in names):
        raise ValueError("must be a list of names of bodies")
    if len(set(names)) < len(names):
        raise ValueError("names the same body twice")
    return tuple(names)


Position = Annotated[tuple[float, ...], _PLACE]


class Sphere(FileModel):
    """A ball (in the plane a disc): `center` and `radius`, m, inertial frame.

    Attributes:
        kind: `"sphere"`.
        name: in results; names differ.
        center: in the inertial frame.
        radius: of the ball.
    """

    kind: Literal["sphere"] = "sphere"
    name: str = ""
    center: Position
    radius: Annotated[float, LENGTH]


class Box(FileModel):
    """A box (in the plane a rectangle): `center` and whole sides `size`, m, turned by `yaw`, rad, about the vertical.

    In the plane `yaw` turns it in the plane.

    Attributes:
        kind: `"box"`.
        name: in results; names differ.
        center: in the inertial frame.
        size: whole lengths of the sides.
        yaw: about the vertical; in the plane, within it.
    """

    kind: Literal["box"] = "box"
    name: str = ""
    center: Position
    size: Annotated[tuple[float, ...], _check_size]
    yaw: Annotated[float, ANGLE] = 0.0


class HalfPlane(FileModel):
    """All on one side of a plane (in the plane: a line) through `point`, m: the side where `normal` does not point.

    Attributes:
        kind: `"half_plane"`.
        name: in results; names differ.
        point: on the plane, in the inertial frame.
        normal: out of what is filled, of any length.
    """

    kind: Literal["half_plane"] = "half_plane"
    name: str = ""
    point: Position
    normal: Annotated[tuple[float, ...], _check_normal]


Obstacle = Sphere | Box | HalfPlane
OBSTACLES: dict[str, type[Obstacle]] = {"sphere": Sphere, "box": Box, "half_plane": HalfPlane}


def _check_obstacle(value: Any) -> Obstacle:
    if isinstance(value, Sphere | Box | HalfPlane):
        return value
    if not isinstance(value, Mapping):
        raise _sentence(f"must be a table with kind = {' or '.join(OBSTACLES)}")
    table = dict(cast(Mapping[str, Any], value))
    kind = table.get("kind")
    if not isinstance(kind, str) or kind not in OBSTACLES:
        meant = hint(kind, OBSTACLES) if isinstance(kind, str) else ""
        raise _sentence(f"kind must be {' or '.join(OBSTACLES)}{meant}")
    return validated(OBSTACLES[kind], table, "obstacle")


def _sentence(sentence: str) -> PydanticCustomError:
    return PydanticCustomError("quantity", "{sentence}", {"sentence": sentence})


@Checked
def _check_obstacles(value: Any) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise ValueError("must be a list of tables, [[constraints.clearance.obstacles]] in a file")
    names = [_name_of(entry) for entry in entries(value)]
    named = [name for name in names if isinstance(name, str) and name]
    twice = next((name for name in named if named.count(name) > 1), None)
    if twice is not None:
        raise ValueError(f"has two obstacles with the name {twice!r}; names must differ")
    return tuple(entries(value))


def _name_of(entry: Any) -> Any:
    return cast(Mapping[str, Any], entry).get("name") if isinstance(entry, Mapping) else getattr(entry, "name", "")


class Clearance(FileModel):
    """Least `distance`, m, of the machine's capsules from the ground (at height `ground`, m) and from `obstacles`.

    Bodies that no actuated joint moves stand on the ground: they keep the distance from obstacles alone.

    Attributes:
        distance: least one of the capsules from ground and obstacles.
        bodies: that keep it, or labels of capsules that do; all that have capsules by default.
        ground: its height; what no actuated joint moves stands on it and keeps no distance from it; no ground is kept
            from where left out.
        obstacles: spheres, boxes and half-planes.
    """

    distance: Annotated[float, LENGTH_OR_ZERO]
    bodies: Annotated[tuple[str, ...], _check_bodies] | None = None
    ground: Annotated[float, COORDINATE["m"]] | None = None
    obstacles: Annotated[tuple[Annotated[Obstacle, BeforeValidator(_check_obstacle)], ...], _check_obstacles] = ()


class Travel(FileModel):
    """What leaving the present placement `base` and `posture` costs, as a share of the objective's scale.

    Attributes:
        cost: of leaving the present configuration, as a share of the objective's scale.
        base: present placement; that of [selection] by default.
        posture: present posture; that of [selection] by default.
    """

    cost: Annotated[float, _POSITIVE]
    base: Annotated[tuple[float, ...], PLACEMENT] | None = None
    posture: Annotated[tuple[float, ...], SOME_COORDINATES] | None = None


class LeastOutcomes(FileModel):
    """What the real loop must do at least, or at most, as of `flexopt.Outcome` (keys of `[constraints.outcome]`).

    Attributes:
        decay: of its slowest motion, 1/s.
        allowed_gain: largest Kp, in its unit.
        delay_margin: further dead time that it bears, s.
        allowance: largest velocity gain that damps every mode, in the unit of Kv.
        radius: the stability radius, of all springs together.
        settling: of the standard move, at most, s.
        swing: of the base in the standard move, at most, rad (of a base that cannot turn m) for each m of the move.
    """

    decay: Annotated[float, _RATE] | None = None
    allowed_gain: Annotated[float, _POSITIVE] | None = None
    delay_margin: Annotated[float, _TIME] | None = None
    allowance: Annotated[float, _POSITIVE] | None = None
    radius: Annotated[float, Quantity("", low=1.0, high=10.0)] | None = None
    settling: Annotated[float, Quantity("s", above=0.0, high=60.0)] | None = None
    swing: Annotated[float, _POSITIVE] | None = None


@Checked
def _check_within(value: Any) -> tuple[Any, ...]:
    """Entries of a list, or of a table from names to (lower, upper)."""
    if not isinstance(value, Mapping | list | tuple) or not value:
        raise ValueError("must be a list of tables, [[constraints.within]] in a file, as of [[uncertainty]]")
    return tuple(ranges_by_place(value).values())


class Constraints(FileModel):
    """What a configuration must keep, under `gravity` as the machine sags; what is left out does not bind.

    Attributes:
        joint_margin: kept from every joint limit, rad or m; 0 asks for the limits themselves, which are assumed else.
        manipulability: least sqrt(det(Jv Jvᵀ)).
        region: the machine stands in one of these polygons, m (of planar machines: intervals of x).
        keep_out: and outside these.
        holds: what does: `"footprint"`, all that the undercarriage stands on, turned with the machine; `"point"`, the
            anchor point. By default the footprint where the machine's file has a `support`.
        clearance: least distance from ground and obstacles.
        self_clearance: least distance between capsules of bodies that joints move against each other, neighbours and
            pairs that overlap in every posture aside, m.
        tip_over_margin: least distance of the centre of mass from the edges of the support polygon, seen from above, m.
        holding: share of each joint's effort that gravity may take, with the file's payload; of others see `within`.
        tool_angle: range of the end-point's inclination, rad; one number for an exact value. In the plane the angle of
            its link from the horizontal, anticlockwise; in space atan2 of the heights of the tips of its frame's first
            and last axis: how far the first axis points above the horizontal while the last one points up.
        travel: cost of leaving the present configuration.
        outcome: what the real loop must do at least, or at most, over all that is uncertain; with `flexopt.select`'s
            `loop`.
        within: numbers of the machine that may be others, as of `[[uncertainty]]`, four at most: whatever depends on
            them, as `holding` and `tip_over_margin` on the payload, under `gravity` everything on masses and springs,
            is kept at all corners of these intervals, too. What is `own` is kept with the file's numbers.
        own: `flexopt.Constraint`s of the user's own, which files cannot have.
    """

    joint_margin: Annotated[float, Quantity(JOINT_VALUE.unit, low=0.0, high=ANGLE.high)] | None = None
    manipulability: Annotated[float, _POSITIVE] | None = None
    region: Annotated[tuple[Area, ...], _check_areas] | None = None
    keep_out: Annotated[tuple[Area, ...], _check_areas] | None = None
    holds: Literal["footprint", "point"] | None = None
    clearance: Clearance | None = None
    self_clearance: Annotated[float, LENGTH_OR_ZERO] | None = None
    tip_over_margin: Annotated[float, LENGTH_OR_ZERO] | None = None
    holding: Annotated[float, Quantity("of each joint's effort", above=0.0, high=1.0)] | None = None
    tool_angle: Annotated[Interval, _check_tool_angle] | None = None
    travel: Travel | None = None
    outcome: LeastOutcomes | None = None
    within: Annotated[tuple[Uncertainty, ...], _check_within] | None = None
    own: Annotated[tuple[Any, ...], check_own_constraints] | None = None

    @field_serializer("own")
    def _own_as_data(self, own: tuple[Constraint, ...] | None) -> list[dict[str, Any]] | None:
        return None if own is None else [constraint.to_dict() for constraint in own]


# What calls take as constraints: a `casadi.Function`, too, alone or in the list.
AnyConstraints = Constraints | Mapping[str, Any] | Constraint | Sequence[Any]


def read_constraints(value: Any, *, origin: str = "constraints") -> Constraints:
    """Constraints from a dictionary in the layout of [constraints]; ready ones pass, None is none.

    Args:
        value: the table; NumPy arrays and numbers may stand for lists and numbers. Or a `casadi.Function` or
            `flexopt.Constraint`, or a list of them, in which the table may stand, too.
        origin: what the message calls the source.

    Raises:
        ModelError: lists every fault.
    """
    if isinstance(value, Constraints):
        return value
    if is_function(value) or isinstance(value, Constraint | list | tuple):
        listed = plain_table(value)
        value = listed if isinstance(listed, Unreadable) else _with_own(listed)
    table = {} if value is None else read_table(value, origin, "[constraints]")
    return validated(Constraints, table, origin)


def _with_own(value: Any) -> dict[str, Any]:
    """A table of a list: what is no table in it are own constraints."""
    table: dict[str, Any] = {}
    own: list[Any] = []
    for part in several(value):
        ready = isinstance(part, Constraints)
        given: Any = {name: getattr(part, name) for name in part.model_fields_set} if ready else part
        if not isinstance(given, Mapping):
            own.append(part)
            continue
        named = dict(cast(Mapping[str, Any], given))
        own += several(named.pop("own", None) or [])
        twice = [Fault(str(key), "stands in two tables of the list") for key in named if key in table]
        raise_if_any(ModelError, "constraints", twice)
        table |= named
    return table | {"own": own}
