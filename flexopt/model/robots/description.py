"""What a robot file says, whatever its format: links on joints, frames with names, and what was left out.

Link k's frame in its parent's is pose · Π_j T_j(q_j − zero_j): hinges turn about, slides move along `axis` (in the
link's axes) through `anchor` (in the link's frame), in the order given. A link without joints is fixed to its parent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from flexopt.foundation.arrays import Array
from flexopt.model.robots.collisions import Solid
from flexopt.model.robots.elements import Element, Faults
from flexopt.model.robots.geometry import NO_MOMENT, Inertial, Pose, about, shift
from flexopt.model.robots.visuals import LinkVisual
from flexopt.model.tree_quantities import INERTIA_ROUNDING

# How far the largest principal moment may exceed the sum of the others, as a share of it: printed digits.
TRIANGLE_ROUNDING = 1e-6

JointKind = Literal["hinge", "slide", "free"]


@dataclass(frozen=True)
class Mimic:
    """q = multiplier · q of `joint` + offset."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint of one degree of freedom, or a free one (six). SI, radians; limits, effort and speed None without any."""

    name: str
    kind: JointKind
    element: Element
    axis: Array
    anchor: Array
    zero: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0
    rest: float = 0.0
    limits: tuple[float, float] | None = None
    effort: float | None = None
    speed: float | None = None
    armature: float = 0.0
    mimic: Mimic | None = None

    @property
    def unit(self) -> str:
        """Unit of its coordinate."""
        return "rad" if self.kind == "hinge" else "m"

    @property
    def stuck(self) -> str:
        """Its limits, (0 to 0 rad) say, where they leave no room to move; else empty."""
        if self.limits is None or self.limits[0] < self.limits[1]:
            return ""
        return f"({self.limits[0]:g} to {self.limits[1]:g} {self.unit})"

    @property
    def drivable(self) -> bool:
        """Whether a drive may move it, with other limits where it is `stuck`: not free, coupled or on a spring."""
        return self.kind != "free" and self.mimic is None and not self.stiffness > 0

    def displaced(self, by: float) -> Pose:
        """T_j: the link's frame after the joint has moved by `by` (rad or m)."""
        if self.kind == "slide":
            return shift(by * self.axis)
        turn = about(self.axis, by)
        return Pose(self.anchor - turn @ self.anchor, turn)


@dataclass(frozen=True, eq=False)
class RobotLink:
    """A rigid body. `inertial` is None where the file does not tell it, and `why` is the sentence.

    `solids` are its collision geometry, `visuals` what pictures draw of it.
    """

    name: str
    parent: str | None
    element: Element
    pose: Pose = field(default_factory=Pose)
    joints: tuple[Joint, ...] = ()
    inertial: Inertial | None = field(default_factory=Inertial)
    why: str = ""
    solids: tuple[Solid, ...] = ()
    visuals: tuple[LinkVisual, ...] = ()


@dataclass(frozen=True, eq=False)
class Frame:
    """A named frame fixed to a link."""

    link: str
    pose: Pose


@dataclass(frozen=True, eq=False)
class Description:
    """A robot as read: links in topological order, None as parent being the world.

    Attributes:
        sites: named frames that are no links.
        gravity: acceleration along −z, m/s², where the file says it.
        warnings: what is readable but odd.
        blockers: word -> faults that the overlay's `ignore` may lift: they change the dynamics.
    """

    name: str
    links: tuple[RobotLink, ...]
    sites: Mapping[str, Frame]
    gravity: float | None = None
    warnings: tuple[str, ...] = ()
    blockers: Mapping[str, Faults] = field(default_factory=dict[str, Faults])


def check_inertial(faults: Faults, element: Element, body: Inertial, of: Element) -> None:
    """Mass and principal moments of a rigid body.

    Files in use have moments that no body has, mostly of small parts: they are warned of. A negative one is refused
    where it remains after merging, which the warning says.
    """
    if body.mass < 0:
        faults.add(element, "mass must not be negative, in kg", of=of, value=f"{body.mass:g}")
    least, middle, most = (float(moment) for moment in body.principal_moments)
    if most - least - middle > TRIANGLE_ROUNDING * most + NO_MOMENT:
        sentence = (
            f"no rigid body has the principal moments {least:.3g}, {middle:.3g}, {most:.3g} kg m²: "
            "the largest exceeds the sum of the others"
        )
        if least < -INERTIA_ROUNDING * max(most, 0.0):
            sentence += ", and one is negative: a machine is refused in which that remains with what is fixed to it"
        faults.warn(element, sentence, of=of)


def unit_axis(faults: Faults, element: Element, key: str, stand_in: tuple[float, float, float], of: Element) -> Array:
    """A joint's axis, scaled to length 1."""
    axis = faults.numbers(element, key, 3, stand_in, None if element is of else of)
    length = float(np.linalg.norm(axis))
    if not 1e-9 < length < float("inf"):
        faults.add(of, "axis is zero" if length < 1 else "axis is too long", value=None)
        return np.array(stand_in)
    return axis / length
