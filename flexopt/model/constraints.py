"""What a configuration must keep besides the target, as validated data: the table [constraints] of a problem.

In: a dictionary in the table's layout. Out: frozen `Constraints`. Whether they suit a machine (bodies that it has,
coordinates in the plane or in space) is told by `flexopt.selection.constraints`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, cast

from pydantic import BeforeValidator
from pydantic_core import PydanticCustomError

from flexopt.foundation.nearest import hint
from flexopt.foundation.quantities import ANGLE_MAX, COORDINATE_MAX, LENGTH_MAX, check_number, check_numbers, checked
from flexopt.model.file_model import FileModel, read_table, validated
from flexopt.model.polygons import Corners, check_simple_polygon

Interval = tuple[float, float]
Area = Interval | Corners
MANIPULABILITY_MAX, COST_MAX = 1e12, 1e12
NORMAL_MIN = 1e-9
UNIT = 1e-14


def _entries(value: Any) -> list[Any]:
    return list(cast(list[Any], value)) if isinstance(value, list | tuple) else []


def _check_joint_margin(value: Any) -> float:
    return check_number(value, "rad or m", low=0.0, high=ANGLE_MAX)


def _check_manipulability(value: Any) -> float:
    return check_number(value, "", above=0.0, high=MANIPULABILITY_MAX)


def _check_length(value: Any) -> float:
    return check_number(value, "m", low=0.0, high=LENGTH_MAX)


def _check_radius(value: Any) -> float:
    return check_number(value, "m", above=0.0, high=LENGTH_MAX)


def _check_height(value: Any) -> float:
    return check_number(value, "m", low=-COORDINATE_MAX, high=COORDINATE_MAX)


def _check_share(value: Any) -> float:
    return check_number(value, "of each joint's effort", above=0.0, high=1.0)


def _check_yaw(value: Any) -> float:
    return check_number(value, "rad", low=-ANGLE_MAX, high=ANGLE_MAX)


def _check_cost(value: Any) -> float:
    return check_number(value, "", above=0.0, high=COST_MAX)


def _check_tool_angle(value: Any) -> Interval:
    """[lo, hi], or one number for both."""
    if not isinstance(value, list | tuple):
        angle = check_number(value, "rad", low=-ANGLE_MAX, high=ANGLE_MAX)
        return angle, angle
    if len(_entries(value)) != 2:
        raise ValueError("must be one angle or a pair [lower, upper], in rad")
    low, high = check_numbers(_entries(value), ["lower end", "upper end"], "rad", low=-ANGLE_MAX, high=ANGLE_MAX)
    if not low <= high < low + 2 * math.pi:
        raise ValueError("must be in order and less than a turn, 2π rad, wide")
    return low, high


def _check_areas(value: Any) -> tuple[Area, ...]:
    """Polygons, or for planar machines intervals [lo, hi] of x, m."""
    what = "must be a list of polygons [[x, y], …] (of a planar machine: intervals [lower, upper]), in m"
    if not _entries(value):
        raise ValueError(what)
    areas: list[Area] = []
    sentences: list[str] = []
    for index, entry in enumerate(_entries(value)):
        try:
            parts = _entries(entry)
            if parts and not any(isinstance(part, list | tuple) for part in parts):
                areas.append(_check_interval(entry))
            else:
                areas.append(check_simple_polygon(entry))
        except ValueError as error:
            sentences.append(f"entry {index} {error}")
    if sentences:
        raise ValueError("; ".join(sentences))
    return tuple(areas)


def _check_interval(value: Any) -> Interval:
    if len(_entries(value)) != 2:
        raise ValueError("must be an interval [lower, upper] or a polygon [[x, y], …], in m")
    limit = COORDINATE_MAX
    low, high = check_numbers(_entries(value), ["lower end", "upper end"], "m", low=-limit, high=limit)
    if not low < high:
        raise ValueError("is reversed or empty: the lower end must be below the upper end, in m")
    return low, high


def _check_place(value: Any) -> tuple[float, ...]:
    return _coordinates(value, "m", -COORDINATE_MAX, COORDINATE_MAX)


def _check_normal(value: Any) -> tuple[float, ...]:
    """A direction, scaled to length 1."""
    parts = _coordinates(value, "", -LENGTH_MAX, LENGTH_MAX)
    length = math.hypot(*parts)
    if length < NORMAL_MIN:
        raise ValueError("must point somewhere: its length is 0")
    if abs(length - 1) < UNIT:  # so that a direction that was scaled once stays as it is
        return parts
    return tuple(part / length for part in parts)


def _check_size(value: Any) -> tuple[float, ...]:
    sides = _coordinates(value, "m", 0.0, LENGTH_MAX)
    if not all(sides):
        raise ValueError("must be whole lengths of the sides, each greater than 0 m")
    return sides


def _coordinates(value: Any, unit: str, low: float, high: float) -> tuple[float, ...]:
    parts = _entries(value)
    if len(parts) not in (2, 3):
        in_unit = f" in {unit}" if unit else ""
        raise ValueError(f"must be numbers{in_unit}: [x, y] in the plane, [x, y, z] in space")
    return check_numbers(parts, list("xyz"[: len(parts)]), unit, low=low, high=high)


def _check_numbers(value: Any) -> tuple[float, ...]:
    """One number or several, m or rad."""
    parts = _entries(value) if isinstance(value, list | tuple) else [value]
    names = [f"entry {i + 1}" for i in range(len(parts))]
    return check_numbers(parts, names, "m or rad", low=-COORDINATE_MAX, high=COORDINATE_MAX)


def _check_bodies(value: Any) -> tuple[str, ...]:
    names = _entries(value)
    if not names or not all(isinstance(name, str) and name for name in names):
        raise ValueError("must be a list of names of bodies")
    if len(set(names)) < len(names):
        raise ValueError("names the same body twice")
    return tuple(names)


Place = Annotated[tuple[float, ...], checked(_check_place)]


class Sphere(FileModel):
    """A ball (in the plane a disc): `center` and `radius`, m, inertial frame."""

    kind: Literal["sphere"] = "sphere"
    name: str = ""
    center: Place
    radius: Annotated[float, checked(_check_radius)]


class Box(FileModel):
    """A box (in the plane a rectangle): `center` and whole sides `size`, m, turned by `yaw`, rad, about the vertical.

    In the plane `yaw` turns it in the plane.
    """

    kind: Literal["box"] = "box"
    name: str = ""
    center: Place
    size: Annotated[tuple[float, ...], checked(_check_size)]
    yaw: Annotated[float, checked(_check_yaw)] = 0.0


class HalfPlane(FileModel):
    """All on one side of a plane (in the plane: a line) through `point`, m: the side where `normal` does not point."""

    kind: Literal["half_plane"] = "half_plane"
    name: str = ""
    point: Place
    normal: Annotated[tuple[float, ...], checked(_check_normal)]


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
    return validated(OBSTACLES[kind], table, "obstacle", ())


def _sentence(sentence: str) -> PydanticCustomError:
    return PydanticCustomError("quantity", "{sentence}", {"sentence": sentence})


def _check_obstacles(value: Any) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise ValueError("must be a list of tables, [[constraints.clearance.obstacles]] in a file")
    names = [_name_of(entry) for entry in _entries(value)]
    named = [name for name in names if isinstance(name, str) and name]
    twice = next((name for name in named if named.count(name) > 1), None)
    if twice is not None:
        raise ValueError(f"has two obstacles with the name {twice!r}; names must differ")
    return tuple(_entries(value))


def _name_of(entry: Any) -> Any:
    return cast(Mapping[str, Any], entry).get("name") if isinstance(entry, Mapping) else getattr(entry, "name", "")


class Clearance(FileModel):
    """Least `distance`, m, of the machine's capsules from the ground (at height `ground`, m) and from `obstacles`.

    `bodies` are those that keep it, all that have capsules by default.
    """

    distance: Annotated[float, checked(_check_length)]
    bodies: Annotated[tuple[str, ...], checked(_check_bodies)] | None = None
    ground: Annotated[float, checked(_check_height)] | None = None
    obstacles: Annotated[
        tuple[Annotated[Obstacle, BeforeValidator(_check_obstacle)], ...], checked(_check_obstacles)
    ] = ()


class Travel(FileModel):
    """What leaving the present placement `base` and `posture` costs, as a share of the objective's scale."""

    cost: Annotated[float, checked(_check_cost)]
    base: Annotated[tuple[float, ...], checked(_check_numbers)] | None = None
    posture: Annotated[tuple[float, ...], checked(_check_numbers)] | None = None


class Constraints(FileModel):
    """What a configuration must keep, the passive coordinates at rest; what is left out does not bind.

    Attributes:
        joint_margin: kept from every joint limit, rad or m.
        manipulability: least sqrt(det(Jv Jvᵀ)).
        region: the anchor point lies in one of these polygons, m (of planar machines: intervals of x).
        keep_out: and outside these.
        clearance: least distance from ground and obstacles.
        tip_over_margin: least distance of the centre of mass from the edges of the support polygon, seen from above, m.
        holding: share of each joint's effort that gravity may take.
        tool_angle: range of the end-point's inclination, rad; one number for an exact value.
        travel: cost of leaving the present configuration.
    """

    joint_margin: Annotated[float, checked(_check_joint_margin)] = 0.0
    manipulability: Annotated[float, checked(_check_manipulability)] | None = None
    region: Annotated[tuple[Area, ...], checked(_check_areas)] | None = None
    keep_out: Annotated[tuple[Area, ...], checked(_check_areas)] | None = None
    clearance: Clearance | None = None
    tip_over_margin: Annotated[float, checked(_check_length)] | None = None
    holding: Annotated[float, checked(_check_share)] | None = None
    tool_angle: Annotated[Interval, checked(_check_tool_angle)] | None = None
    travel: Travel | None = None


def read_constraints(value: Any, *, origin: str = "constraints") -> Constraints:
    """Constraints from a dictionary in the layout of [constraints]; ready ones pass, None is none.

    Args:
        value: the table; NumPy arrays and numbers may stand for lists and numbers.
        origin: what the message calls the source.

    Raises:
        ModelError: lists every fault.
    """
    if isinstance(value, Constraints):
        return value
    table = {} if value is None else read_table(value, origin, "[constraints]")
    return validated(Constraints, table, origin, ())
