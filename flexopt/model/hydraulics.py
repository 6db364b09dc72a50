"""Hydraulic cylinders that drive joints, as validated data, and their length from pin to pin.

In: tables `[[cylinders]]` of a machine file. Out: frozen `Cylinder` objects; `pin_to_pin`, which is written once, for
numbers and for graphs.

    [[cylinders]]
    name = "boom cylinder"
    joint = "boom"                       # an actuated hinge
    base_point = [0.35, -0.25]           # on the body that carries the joint, in its axes, m; three numbers in space
    rod_point = [0.85, 0.30]             # on the body that the joint moves, in its axes, m
    length = [1.10, 1.75]                # pin to pin, retracted and extended, m
    speed = [0.30, 0.22]                 # retracting and extending at full lever, m/s
    force = [9e4, 1.4e5]                 # greatest pull and push, N; optional
    lever_sign = 1                       # −1 where a positive lever retracts; optional
    dead_band = 0.05                     # share of the lever that does nothing; optional

In place of `rod_point` a four-bar linkage may lie between rod and joint, as at an excavator's bucket:

    rocker = { pivot = [0.9, 0.0], length = 0.35, coupler = 0.33, coupler_point = [-0.1, 0.2], branch = 1 }

The cylinder of a slide has neither point; its length is `offset` + q.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple, cast

from pydantic import Field

from flexopt.foundation.quantities import LENGTH_MAX, Length, Offset, check_number, check_numbers, check_pair, checked
from flexopt.model.file_model import FileModel
from flexopt.model.table_quantities import SPEED_MAX, check_place

AXES = "xyz"
FORCE_MAX = 1e12
DEAD_BAND_MAX = 0.9
Rows = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
UNTURNED: Rows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def check_stroke(value: Any) -> tuple[float, float]:
    """[retracted, extended], m, both positive."""
    low, high = check_pair(value, "m", 0.0, LENGTH_MAX)
    if low <= 0:
        raise ValueError(f"must be greater than 0 and at most {LENGTH_MAX:g} m at both ends")
    return low, high


def check_cylinder_speed(value: Any) -> tuple[float, float]:
    """[retracting, extending], m/s, both positive."""
    entries = _two(value, "[retracting, extending] in m/s")
    retract, extend = (check_number(entry, "m/s", above=0.0, high=SPEED_MAX) for entry in entries)
    return retract, extend


def check_cylinder_force(value: Any) -> tuple[float, float]:
    """[pull, push], N; a cylinder that acts one way has one zero."""
    names = ["pull", "push"]
    pull, push = check_numbers(_two(value, "[pull, push] in N"), names, "N", low=0.0, high=FORCE_MAX)
    if pull == push == 0:
        raise ValueError("must not be zero both ways; leave it out where it is not known")
    return pull, push


def check_rod_offset(value: Any) -> tuple[float, float]:
    """[along, left], m."""
    entries, names = _two(value, "[along, left] in m"), ["along", "left"]
    along, left = check_numbers(entries, names, "m", low=-LENGTH_MAX, high=LENGTH_MAX)
    return along, left


def check_dead_band(value: Any) -> float:
    """Share of the lever."""
    return check_number(value, "", low=0.0, high=DEAD_BAND_MAX)


def _two(value: Any, what: str) -> list[Any]:
    entries = list(cast(list[Any], value)) if isinstance(value, list | tuple) else []
    if len(entries) != 2:
        raise ValueError(f"must be a pair {what}")
    return entries


Pin = Annotated[tuple[float, ...], checked(check_place)]


class Rocker(FileModel):
    """The four-bar linkage between a cylinder's rod and a hinge.

    The rocker turns about `pivot` on the body that carries the joint; its end, at `length`, is joined by a link of
    length `coupler`, pin to pin, to `coupler_point` on the body that the joint moves. Of the two places where the
    rocker's end can be, `branch` +1 is the one to the left of the line from pivot to coupler point, seen along the
    hinge's axis (in the plane: counter-clockwise). The rod is pinned to the rocker's end or, with `rod_offset` =
    [along, left], to a point that far from it, in the rocker's axes. Units m. In space the rocker's axis is parallel to
    the hinge's, and its end and the rod's pin lie in the plane of `pivot`.
    """

    pivot: Pin
    length: Length
    coupler: Length
    coupler_point: Pin
    branch: Literal[-1, 1]
    rod_offset: Annotated[tuple[float, float], checked(check_rod_offset)] = (0.0, 0.0)


class Cylinder(FileModel):
    """A hydraulic cylinder and the actuated joint that it drives. Keys and units are those of the module's docstring.

    The pins (2,) in the plane are [along, left], from the joint that carries the body; (3,) in space in its frame.
    """

    name: str = Field(min_length=1)
    joint: str = Field(min_length=1)
    base_point: Pin | None = None
    rod_point: Pin | None = None
    rocker: Rocker | None = None
    offset: Offset = 0.0
    length: Annotated[tuple[float, float], checked(check_stroke)]
    speed: Annotated[tuple[float, float], checked(check_cylinder_speed)]
    force: Annotated[tuple[float, float], checked(check_cylinder_force)] | None = None
    lever_sign: Literal[-1, 1] = 1
    dead_band: Annotated[float, checked(check_dead_band)] = 0.0

    def numbers(self) -> dict[str, float]:
        """The geometry, m, by the names that it has among the machine's parameters."""
        found = _pin(f"{self.name}.base_point", self.base_point) | _pin(f"{self.name}.rod_point", self.rod_point)
        if self.rocker is not None:
            at, rocker = f"{self.name}.rocker", self.rocker
            found |= _pin(f"{at}.pivot", rocker.pivot) | _pin(f"{at}.coupler_point", rocker.coupler_point)
            found |= {f"{at}.length": rocker.length, f"{at}.coupler": rocker.coupler}
            found |= _pin(f"{at}.rod_offset", rocker.rod_offset)
        return found or {f"{self.name}.offset": self.offset}


def _pin(name: str, values: tuple[float, ...] | None) -> dict[str, float]:
    return {f"{name}.{axis}": value for axis, value in zip(AXES, values or (), strict=False)}


@dataclass(frozen=True)
class JointFrame:
    """How a joint stands between the body that carries it and the body that it moves.

    Attributes:
        slide: whether it is a slide.
        origin: parameters that say where it stands in the carrying body's axes, three names; an empty one is 0.
        of_parent, of_body: unit vectors of a right-handed frame, the third along the joint's axis, as rows in the axes
            of the carrying and of the moved body; the same directions where q = 0.
    """

    slide: bool
    origin: tuple[str, str, str]
    of_parent: Rows = UNTURNED
    of_body: Rows = UNTURNED


class CylinderLength(NamedTuple):
    """Length of a cylinder, m. `closure` is negative where its linkage does not close; None without a linkage."""

    length: Any
    closure: Any


def pin_to_pin(
    cylinder: Cylinder, frame: JointFrame, value: Mapping[str, Any], coordinate: tuple[Any, Any, Any]
) -> CylinderLength:
    """The length L(q) of a cylinder from pin to pin.

    Direct: |base point − rod point|. With a rocker its end is where the circles of radius `length` about the pivot and
    `coupler` about the coupler point meet: with d from the pivot to the coupler point, n = d turned left by 90°,
    a = (length² − coupler² + |d|²)/(2|d|²) and b = ± sqrt(length²/|d|² − a²) it stands at pivot + a d + b n.

    Args:
        cylinder: the cylinder.
        frame: of the joint that it drives.
        value: parameters by name: numbers, arrays or graphs.
        coordinate: (q, cos q, sin q), of the same kind.
    """
    if frame.slide:
        return CylinderLength(value[f"{cylinder.name}.offset"] + coordinate[0], None)
    _, cosine, sine = coordinate

    def on_parent(name: str) -> list[Any]:
        pin = [
            value.get(f"{cylinder.name}.{name}.{axis}", 0.0) - (value[origin] if origin else 0.0)
            for axis, origin in zip(AXES, frame.origin, strict=True)
        ]
        return _seen(frame.of_parent, pin)

    def on_body(name: str) -> list[Any]:
        x, y, z = _seen(frame.of_body, [value.get(f"{cylinder.name}.{name}.{axis}", 0.0) for axis in AXES])
        return [cosine * x - sine * y, sine * x + cosine * y, z]

    base = on_parent("base_point")
    if cylinder.rocker is None:
        return CylinderLength(_distance(base, on_body("rod_point")), None)
    pivot, joined = on_parent("rocker.pivot"), on_body("rocker.coupler_point")
    radius, coupler = value[f"{cylinder.name}.rocker.length"], value[f"{cylinder.name}.rocker.coupler"]
    dx, dy, dz = (b - a for a, b in zip(pivot, joined, strict=True))
    squared = dx * dx + dy * dy
    along = (radius * radius - coupler * coupler + dz * dz + squared) / (2 * squared)
    closure = radius * radius / squared - along * along
    left = cylinder.rocker.branch * closure**0.5
    # Unit vector along the rocker.
    ux, uy = (along * dx - left * dy) / radius, (along * dy + left * dx) / radius
    forward = radius + value[f"{cylinder.name}.rocker.rod_offset.x"]
    aside = value[f"{cylinder.name}.rocker.rod_offset.y"]
    rod = [pivot[0] + forward * ux - aside * uy, pivot[1] + forward * uy + aside * ux, pivot[2]]
    return CylinderLength(_distance(base, rod), closure)


def _seen(rows: Rows, vector: list[Any]) -> list[Any]:
    """Components along unit vectors; what is exactly 0 or 1 leaves no trace in a graph."""
    found: list[Any] = []
    for row in rows:
        terms = [part if entry == 1 else entry * part for entry, part in zip(row, vector, strict=True) if entry != 0]
        found.append(sum(terms[1:], start=terms[0]))
    return found


def _distance(a: list[Any], b: list[Any]) -> Any:
    x, y, z = ((p - q) * (p - q) for p, q in zip(a, b, strict=True))
    return (x + y + z) ** 0.5
