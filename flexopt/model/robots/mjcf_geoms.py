"""Mass and inertia of MJCF geoms: primitive solids of uniform density."""

from __future__ import annotations

import math

import numpy as np

from flexopt.model.robots.elements import Element, check_text
from flexopt.model.robots.geometry import Inertial, Pose
from flexopt.model.robots.mjcf_settings import Settings
from flexopt.model.tree_quantities import symmetric

DENSITY = 1000.0
WITHOUT_MASS = ("plane", "hfield")
SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}


def geom_inertial(settings: Settings, geom: Element, frame: Pose, of: Element) -> Inertial | str:
    """Inertia of one geom in its body's frame, or the sentence that says why it cannot be told.

    Args:
        settings: compiler settings; faults of the geom are added to theirs.
        geom: the element, with its defaults.
        frame: where its `pos` starts from.
        of: the body, for messages.
    """
    faults = settings.faults
    low, high = settings.groups
    group = faults.number(geom, "group", 0.0, of)
    mass = faults.number(geom, "mass", -1.0, of) if "mass" in geom.attributes else None
    density = faults.number(geom, "density", DENSITY, of)
    for key, value in (("mass", mass), ("density", density)):
        if value is not None and value < 0:
            faults.add(geom, f"{key} must not be negative", of=of, value=f"{value:g}")
    shape = geom.attributes.get("type", "sphere")
    if not low <= group <= high or shape in WITHOUT_MASS or mass == 0 or (mass is None and density == 0):
        return Inertial()
    if shape in ("mesh", "sdf") or "mesh" in geom.attributes:
        return f"its mass comes from a mesh (line {geom.line}), which is not read: give it an <inertial>"
    if geom.attributes.get("shellinertia", "false") != "false":
        return f"its geom of line {geom.line} is a shell, which is not read: give it an <inertial>"
    check_text(faults, geom, "type", (*SIZES, *WITHOUT_MASS, "mesh", "sdf"), "sphere")
    if shape not in SIZES:
        return Inertial()
    size = geom_size(settings, geom, shape, of)
    if size is None:
        return Inertial()
    solid = _solid(shape, size)
    solid = solid.scaled(density if mass is None else mass / solid.mass)
    return solid.seen_from(frame @ settings.pose(geom, of))


def geom_size(settings: Settings, geom: Element, shape: str, of: Element) -> list[float] | None:
    """Half-sizes, m; None after a fault."""
    faults = settings.faults
    size = [float(value) for value in faults.numbers(geom, "size", (1, 2, 3), (0.0,), of)]
    if "fromto" in geom.attributes and SIZES[shape] > 1:
        ends = faults.numbers(geom, "fromto", 6, (0.0, 0.0, 0.0, 0.0, 0.0, 1.0), of)
        # One of no length is a fault of the pose, and of any size here.
        half = float(np.linalg.norm(ends[3:] - ends[:3])) / 2 or 1.0
        size = [size[0], half] if SIZES[shape] == 2 else [size[0], size[0], half]
    size = size[: SIZES[shape]]
    if len(size) == SIZES[shape] and min(size) > 0:
        return size
    wanted = f"a {shape} needs {SIZES[shape]} positive number{'s' if SIZES[shape] > 1 else ''} as size, in m"
    faults.add(geom, wanted, of=of, value=geom.attributes.get("size", "missing"))
    return None


def _solid(shape: str, size: list[float]) -> Inertial:
    """A solid of density 1, centred, its long axis along z."""
    if shape == "box":
        a, b, c = (2 * half for half in size)
        mass = a * b * c
        moments = [mass * (b * b + c * c) / 12, mass * (a * a + c * c) / 12, mass * (a * a + b * b) / 12]
    elif shape in ("sphere", "ellipsoid"):
        a, b, c = size if shape == "ellipsoid" else size * 3
        mass = 4 / 3 * math.pi * a * b * c
        moments = [mass * (b * b + c * c) / 5, mass * (a * a + c * c) / 5, mass * (a * a + b * b) / 5]
    else:
        radius, half = size
        mass = math.pi * radius**2 * 2 * half
        across, along = mass * (3 * radius**2 + 4 * half**2) / 12, mass * radius**2 / 2
        if shape == "capsule":
            # Two half balls, their centres of mass 3/8 of the radius beyond the ends.
            ball = 4 / 3 * math.pi * radius**3
            across += ball * (2 / 5 * radius**2 + half**2 + 3 / 4 * half * radius)
            along += ball * 2 / 5 * radius**2
            mass += ball
        moments = [across, across, along]
    return Inertial(mass, np.zeros(3), symmetric(*moments))
