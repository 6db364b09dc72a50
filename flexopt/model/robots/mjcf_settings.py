"""What the rest of an MJCF file is read by: included files, compiler settings, classes of defaults, orientations."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from flexopt.errors import ModelError
from flexopt.foundation.arrays import Array
from flexopt.model.robots.elements import DEPTH_MAX, ELEMENTS_MAX, Element, Faults, check_text, parse
from flexopt.model.robots.geometry import (
    Pose,
    about,
    from_euler,
    from_quaternion,
    from_xy_axes,
    from_z_axis,
)
from flexopt.model.robots.known import known_elements

ORIENTATIONS = ("quat", "axisangle", "xyaxes", "zaxis", "euler")
MAIN = "main"
# What a default says of an actuator's gain and bias by its kind, which all kinds share: a motor's are plain.
GAINS = {
    "general": dict[str, str](),
    "motor": {"gaintype": "fixed", "gainprm": "1", "biastype": "none", "dyntype": "none"},
}
SERVO = {"biastype": "own", "gainprm": "own"}
# Far more than any model in use has.
INCLUDES_MAX = 500

Defaults = dict[str, dict[str, dict[str, str]]]


def with_includes(root: Element, folder: Path, faults: Faults) -> Element:
    """The tree with each <include> replaced by the children of the file's root; paths start from `folder`.

    As in MuJoCo, a model includes a file once, however its path is spelt; so the reading ends.

    Raises:
        ModelError: an included file cannot be read or is no XML, or there are too many of them.
    """
    return _Includes(root, folder, faults).spliced(root, 1)


class _Includes:
    def __init__(self, root: Element, folder: Path, faults: Faults) -> None:
        self.folder = folder
        self.faults = faults
        self.count = 0
        self.elements = sum(1 for _ in root.walk())
        self.seen = {identity(folder / Path(root.file).name)}

    def spliced(self, element: Element, depth: int) -> Element:
        if depth > DEPTH_MAX:
            raise ModelError(f"{element.place}: elements are nested more than {DEPTH_MAX} deep, with included files")
        children: list[Element] = []
        for child in element.children:
            if child.tag != "include":
                children.append(self.spliced(child, depth + 1))
                continue
            included = self._included(child)
            if included is not None:
                children += self.spliced(included, depth).children
        return replace(element, children=children)

    def _included(self, child: Element) -> Element | None:
        """The root of the file that an <include> names; None after a fault."""
        name = self.faults.required(child, "file")
        if not name:
            return None
        path = self.folder / name
        known = identity(path)
        if known in self.seen:
            self.faults.add(child, f"file {name!r} is included twice, or includes itself")
            return None
        self.seen.add(known)
        self.count += 1
        if self.count > INCLUDES_MAX:
            raise ModelError(f"{child.place}: the model includes more than {INCLUDES_MAX} files")
        label = str(Path(child.file).parent / name) if not Path(name).is_absolute() else name
        included = parse(path, label)
        self.elements += sum(1 for _ in included.walk())
        if self.elements > ELEMENTS_MAX:
            raise ModelError(f"{child.place}: with the included files the model has more than {ELEMENTS_MAX} elements")
        return included


def identity(path: Path) -> object:
    """What is the same for two spellings of one file; the path itself where there is none."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return str(path)
    return status.st_dev, status.st_ino


@dataclass(frozen=True, eq=False)
class Settings:
    """Compiler settings and defaults of a whole model."""

    faults: Faults
    angle: float
    euler_sequence: str
    auto_limits: bool
    inertia_from_geoms: str
    groups: tuple[float, float]
    total_mass: float
    least_mass: float
    least_inertia: float
    balance: bool
    classes: Defaults

    def resolved(self, element: Element, child_class: str) -> Element:
        """The element with the attributes that its class, or the class of the bodies around it, gives."""
        name = element.attributes.get("class", child_class)
        given = self.classes.get(name)
        if given is None:
            self.faults.add(element, f"class {name!r} is no <default> of this model")
            given = self.classes[MAIN]
        return replace(element, attributes=_over(given.get(element.tag, {}), element.attributes))

    def pose(self, element: Element, of: Element | None = None) -> Pose:
        """`pos` and the orientation in whichever way it is written; or the middle of `fromto`, z along it."""
        if "fromto" in element.attributes:
            ends = self.faults.numbers(element, "fromto", 6, (0.0, 0.0, 0.0, 0.0, 0.0, 1.0), of)
            along = ends[3:] - ends[:3]
            if np.linalg.norm(along) > 0:
                # MuJoCo's z axis points to the first end, which no geom shows.
                return Pose((ends[:3] + ends[3:]) / 2, from_z_axis(-along if element.tag == "site" else along))
            self.faults.add(element, "fromto has no length", of=of)
        return Pose(self.faults.numbers(element, "pos", 3, (0.0, 0.0, 0.0), of), self._rotation(element, of))

    def _rotation(self, element: Element, of: Element | None) -> Array:
        given = [key for key in ORIENTATIONS if key in element.attributes]
        if len(given) > 1:
            self.faults.add(element, f"has {' and '.join(given)}: one orientation is enough", of=of)
        if not given:
            return np.eye(3)
        key = given[0]
        count, neutral, build = self._ways()[key]
        values = self.faults.numbers(element, key, count, neutral, of)
        with np.errstate(divide="ignore", invalid="ignore"):
            rotation = build(values)
        if not np.isfinite(rotation).all():
            text = element.attributes[key]
            sentence = f"{key} tells no orientation: a direction in it is zero, or two are parallel"
            self.faults.add(element, sentence, of=of, value=text)
            return np.eye(3)
        return rotation

    def _ways(self) -> dict[str, tuple[int, tuple[float, ...], Callable[[Array], Array]]]:
        return {
            "quat": (4, (1.0, 0.0, 0.0, 0.0), from_quaternion),
            "axisangle": (
                4,
                (0.0, 0.0, 1.0, 0.0),
                lambda v: about(v[:3] / np.linalg.norm(v[:3]), self.angle * float(v[3])),
            ),
            "xyaxes": (6, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0), lambda v: from_xy_axes(v[:3], v[3:])),
            "zaxis": (3, (0.0, 0.0, 1.0), from_z_axis),
            "euler": (3, (0.0, 0.0, 0.0), lambda v: from_euler(self.angle * v, self.euler_sequence)),
        }


def read_settings(root: Element, faults: Faults) -> Settings:
    """Settings from every <compiler> and <default> of the model; a later one overrides an earlier."""
    merged: dict[str, str] = {}
    last = root
    for compiler in root.all("compiler"):
        merged |= compiler.attributes
        last = compiler
    element = replace(last, tag="compiler", attributes=merged, children=[])
    degrees = check_text(faults, element, "angle", ("degree", "radian"), "degree") == "degree"
    if merged.get("coordinate", "local") != "local":
        faults.add(
            element, "coordinate must be local; newer versions of MuJoCo read no other", value=merged["coordinate"]
        )
    sequence = merged.get("eulerseq", "xyz")
    if len(sequence) != 3 or set(sequence.lower()) - set("xyz"):
        faults.add(element, "eulerseq must be three letters of x, y, z, X, Y, Z", value=repr(sequence))
        sequence = "xyz"
    low, high = faults.numbers(element, "inertiagrouprange", 2, (0.0, 5.0))
    return Settings(
        faults=faults,
        angle=math.pi / 180 if degrees else 1.0,
        euler_sequence=sequence,
        auto_limits=check_text(faults, element, "autolimits", ("true", "false"), "true") == "true",
        inertia_from_geoms=check_text(faults, element, "inertiafromgeom", ("auto", "true", "false"), "auto"),
        groups=(float(low), float(high)),
        total_mass=faults.number(element, "settotalmass", -1.0),
        least_mass=faults.number(element, "boundmass"),
        least_inertia=faults.number(element, "boundinertia"),
        balance=check_text(faults, element, "balanceinertia", ("true", "false"), "false") == "true",
        classes=_classes(root, faults),
    )


def _classes(root: Element, faults: Faults) -> Defaults:
    classes: Defaults = {MAIN: {}}
    actuators = known_elements("mjcf").children["actuator"].children

    def read(default: Element, name: str, inherited: dict[str, dict[str, str]]) -> None:
        own = {tag: dict(attributes) for tag, attributes in inherited.items()}
        for child in default.children:
            if child.tag != "default":
                tag, attributes = child.tag, child.attributes
                if tag in actuators:
                    tag, attributes = "actuator", GAINS.get(tag, SERVO) | attributes
                own[tag] = _over(own.get(tag, {}), attributes)
        classes[name] = own
        for child in default.all("default"):
            inner = faults.required(child, "class")
            if inner in classes:
                faults.add(child, f"class {inner!r} is defined twice")
            elif inner:
                read(child, inner, own)

    for default in root.all("default"):
        # Whatever it is called, it holds where no class is named.
        read(default, MAIN, classes[MAIN])
        classes[default.attributes.get("class", MAIN)] = classes[MAIN]
    return classes


def _over(inherited: dict[str, str], own: dict[str, str]) -> dict[str, str]:
    """Own attributes over inherited ones: an orientation replaces any other, a shorter `size` its first numbers."""
    kept = dict(inherited)
    if any(key in own for key in ORIENTATIONS):
        kept = {key: text for key, text in kept.items() if key not in ORIENTATIONS}
    merged = kept | own
    if "size" in own and "size" in kept:
        words = own["size"].split()
        merged["size"] = " ".join(words + kept["size"].split()[len(words) :])
    return merged
