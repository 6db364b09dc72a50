"""Collision geometry of robot files as capsules that enclose it.

In: <collision> of URDF, <geom> of MJCF. Out: a `Solid` for each, in its link's frame. Spheres and capsules are enclosed
exactly; a cylinder gets caps, a box the cylinder round its longest edges with caps, an ellipsoid its longest axis and
its middle radius. What is no such shape keeps the sentence that says why; it matters only to who asks for capsules.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from flexopt.foundation.arrays import Array
from flexopt.model.robots.elements import Element, Faults
from flexopt.model.robots.geometry import Pose
from flexopt.model.robots.mjcf_geoms import SIZES, WITHOUT_MASS, geom_size
from flexopt.model.robots.mjcf_settings import Settings

# A URDF shape and the attributes that give its half-sizes, with their factors.
URDF_SHAPES = {"sphere": (("radius", 1.0),), "cylinder": (("radius", 1.0), ("length", 0.5)),
               "capsule": (("radius", 1.0), ("length", 0.5))}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Solid:
    """Points within `radius` of the segment from `start` to `end`, m, in the link's frame; or `why` there are none."""

    element: Element
    start: Array = field(default_factory=lambda: np.zeros(3))
    end: Array = field(default_factory=lambda: np.zeros(3))
    radius: float = 0.0
    why: str = ""


def urdf_solids(link: Element, origin: Callable[[Faults, Element, Element], Pose]) -> tuple[Solid, ...]:
    """Those of a URDF link.

    Args:
        link: the element.
        origin: reads the <origin> of an element that is part of another.
    """
    return tuple(_urdf_solid(link, collision, origin) for collision in link.all("collision"))


def _urdf_solid(link: Element, collision: Element, origin: Callable[[Faults, Element, Element], Pose]) -> Solid:
    faults = Faults()
    holder = collision.first("geometry")
    shape = holder.children[0] if holder is not None and holder.children else None
    if shape is None or shape.tag not in (*URDF_SHAPES, "box"):
        return Solid(
            collision,
            why="has no shape" if shape is None else f"is a <{shape.tag}>, which is not read: write [[capsules]]",
        )
    if shape.tag == "box":
        size = faults.numbers(shape, "size", 3, (0.0, 0.0, 0.0), link) / 2
    else:
        size = np.array([factor * faults.number(shape, key, 0.0, link) for key, factor in URDF_SHAPES[shape.tag]])
    pose = origin(faults, collision, link)
    if faults.faults or min(size) <= 0:
        sentence = faults.faults[0].sentence if faults.faults else "is not positive"
        return Solid(collision, why=f"<{shape.tag}> has a size or an origin that {sentence}")
    return _enclosing(collision, shape.tag, [float(part) for part in size], pose)


def mjcf_solid(settings: Settings, geom: Element, frame: Pose, of: Element) -> Solid | None:
    """That of a geom with its defaults, `frame` being where its `pos` starts from; None where it never collides."""
    quiet = replace(settings, faults=Faults())
    types = [quiet.faults.number(geom, key, 1.0) for key in ("contype", "conaffinity")]
    shape = geom.attributes.get("type", "sphere")
    if not any(types) or shape in WITHOUT_MASS:
        return None
    if shape not in SIZES or "mesh" in geom.attributes:
        return Solid(geom, why=f"is a {shape}, which is not read")
    size, pose = geom_size(quiet, geom, shape, of), frame @ quiet.pose(geom, of)
    if size is None or quiet.faults.faults:
        return Solid(geom, why=quiet.faults.faults[0].sentence)
    return _enclosing(geom, shape, size, pose)


def _enclosing(element: Element, shape: str, size: list[float], pose: Pose) -> Solid:
    """Round a shape of these half-sizes, centred in `pose`; of cylinders and capsules the axis is z."""
    axis, half, radius = 2, 0.0, size[0]
    if shape in ("cylinder", "capsule"):
        half = size[1]
    elif shape in ("box", "ellipsoid"):
        axis = int(np.argmax(size))
        across = sorted(size[:axis] + size[axis + 1 :])
        half, radius = (size[axis], math.hypot(*across)) if shape == "box" else (size[axis] - across[1], across[1])
    along = half * pose.rotation[:, axis]
    return Solid(element, pose.position - along, pose.position + along, radius)
