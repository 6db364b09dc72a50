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
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field

from flexopt.foundation.quantities import (
    LENGTH,
    LENGTH_OR_ZERO,
    OFFSET,
    SPEED,
    Length,
    Offset,
    Quantity,
    a_list,
    accepting,
    pair,
    vector,
)
from flexopt.model.file_model import FileModel
from flexopt.model.tables import BodyPoint
from flexopt.model.tree_quantities import UNTURNED, Matrix3

AXES = "xyz"
FORCE_MAX = 1e12
DEAD_BAND_MAX = 0.9

_SPEEDS = vector(
    "a pair [retracting, extending] in m/s", Quantity("m/s", above=0.0, high=SPEED.high), ("retracting", "extending")
)
_FORCE = vector("a pair [pull, push] in N", Quantity("N", low=0.0, high=FORCE_MAX), ("pull", "push"))


@accepting(a_list(LENGTH.accepts or {}, 2, 2))
def check_stroke(value: Any) -> tuple[float, float]:
    """[retracted, extended], m, both positive."""
    low, high = pair(LENGTH_OR_ZERO)(value)
    if low <= 0:
        raise ValueError(f"{LENGTH.allowed} at both ends")
    return low, high


@accepting(_FORCE.accepts or {})
def check_cylinder_force(value: Any) -> tuple[float, float]:
    """[pull, push], N; a cylinder that acts one way has one zero."""
    pull, push = _FORCE(value)
    if pull == push == 0:
        raise ValueError("must not be zero both ways; leave it out where it is not known")
    return pull, push


class Rocker(FileModel):
    """The four-bar linkage between a cylinder's rod and a hinge.

    The rocker turns about `pivot` on the body that carries the joint; its end, at `length`, is joined by a link of
    length `coupler`, pin to pin, to `coupler_point` on the body that the joint moves. Of the two places where the
    rocker's end can be, `branch` +1 is the one to the left of the line from pivot to coupler point, seen along the
    hinge's axis (in the plane: counter-clockwise). The rod is pinned to the rocker's end or, with `rod_offset` =
    [along, left], to a point that far from it, in the rocker's axes. Units m. In space the rocker's axis is parallel to
    the hinge's, and its end and the rod's pin lie in the plane of `pivot`.

    Attributes:
        pivot: about which the rocker turns, on the body that carries the joint.
        length: from the pivot to the rocker's end.
        coupler: length of the link between the rocker's end and the body that the joint moves, pin to pin.
        coupler_point: its pin on the body that the joint moves.
        branch: 1 where the rocker's end lies to the left of the line from pivot to coupler point, −1 to its right.
        rod_offset: [along, left], from the rocker's end to the rod's pin, in the rocker's axes.
    """

    pivot: BodyPoint
    length: Length
    coupler: Length
    coupler_point: BodyPoint
    branch: Literal[-1, 1]
    rod_offset: Annotated[tuple[float, float], vector("a pair [along, left] in m", OFFSET, ("along", "left"))] = (
        0.0,
        0.0,
    )


class Cylinder(FileModel):
    """A hydraulic cylinder and the actuated joint that it drives, in m, m/s and N.

    The pins (2,) in the plane are [along, left], from the joint that carries the body; (3,) in space in its frame.

    Attributes:
        name: of the cylinder, in results and among the parameters.
        joint: that it drives, an actuated one.
        base_point: pin on the body that carries the joint, in its axes (of a robot file: on the link, in that link's
            axes, whatever it is fixed to); a slide has none.
        rod_point: pin on the body that the joint moves, in its axes; a slide or a linkage has none.
        rocker: the linkage in place of `rod_point`.
        offset: of a slide, the cylinder's length where the joint is at 0.
        length: pin to pin, [retracted, extended].
        speed: at full lever, [retracting, extending].
        force: greatest [pull, push], in place of the effort of its joint; where left out, the effort counts, if any.
        lever_sign: −1 where a positive lever retracts.
        dead_band: share of the lever that does nothing.
    """

    name: str = Field(min_length=1)
    joint: str = Field(min_length=1)
    base_point: BodyPoint | None = None
    rod_point: BodyPoint | None = None
    rocker: Rocker | None = None
    offset: Offset = 0.0
    length: Annotated[tuple[float, float], check_stroke]
    speed: Annotated[tuple[float, float], _SPEEDS]
    force: Annotated[tuple[float, float], check_cylinder_force] | None = None
    lever_sign: Literal[-1, 1] = 1
    dead_band: Annotated[float, Quantity("", low=0.0, high=DEAD_BAND_MAX)] = 0.0

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
    of_parent: Matrix3 = UNTURNED
    of_body: Matrix3 = UNTURNED


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


def _seen(rows: Matrix3, vector: list[Any]) -> list[Any]:
    """Components along unit vectors; what is exactly 0 or 1 leaves no trace in a graph."""
    found: list[Any] = []
    for row in rows:
        terms = [part if entry == 1 else entry * part for entry, part in zip(row, vector, strict=True) if entry != 0]
        found.append(sum(terms[1:], start=terms[0]))
    return found


def _distance(a: list[Any], b: list[Any]) -> Any:
    x, y, z = ((p - q) * (p - q) for p, q in zip(a, b, strict=True))
    return (x + y + z) ** 0.5
