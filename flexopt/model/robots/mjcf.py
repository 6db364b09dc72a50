"""MJCF (MuJoCo's XML) in, a `Description` out.

Read: nested bodies and frames, hinges and slides with stiffness, damping, springref, ref, range and armature,
inertials, the inertia of primitive geoms, what pictures draw, sites, defaults, includes, compiler settings, and what
actuators give at most. All else of actuators, contacts, sensors and keyframes is left out. What would change
the dynamics without having a place here (ball joints, flexible bodies, springs that are not linear) is a fault;
equality constraints, tendons that pull, gravity compensation are `blockers`, which the overlay may ignore by name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from flexopt.foundation.arrays import Array
from flexopt.model.robots.collisions import Solid, mjcf_solid
from flexopt.model.robots.description import Description, Frame, Joint, RobotLink, check_inertial
from flexopt.model.robots.elements import Element, Faults, unique
from flexopt.model.robots.geometry import Inertial, Pose
from flexopt.model.robots.known import check_known
from flexopt.model.robots.mjcf_actuators import drive_efforts
from flexopt.model.robots.mjcf_geoms import geom_inertial
from flexopt.model.robots.mjcf_joints import read_joint
from flexopt.model.robots.mjcf_settings import MAIN, Settings, read_settings, with_includes
from flexopt.model.robots.visuals import LinkVisual, mjcf_meshes, mjcf_visuals
from flexopt.model.tree_quantities import symmetric

IN_A_BODY = ("body", "frame", "inertial", "joint", "freejoint", "geom", "site", "camera", "light")
PULLS = ("stiffness", "damping", "frictionloss", "armature", "range")


def read_mjcf(root: Element, folder: Path, faults: Faults, *, strict: bool = True) -> Description:
    """The robot below <mujoco>; what is wrong is added to `faults`.

    Args:
        root: the root element.
        folder: where paths of included files and of meshes start.
        faults: takes faults and warnings.
        strict: whether words that MJCF does not have are faults.

    Raises:
        ModelError: an included file cannot be read or is no XML.
    """
    root = check_known(with_includes(root, folder, faults), "mjcf", faults, strict=strict)
    settings = read_settings(root, faults)
    named = {body.attributes.get("name", "") for body in root.walk() if body.tag == "body"}
    reader = _MjcfReader(settings, mjcf_meshes(root, settings, folder), named)
    for world in root.all("worldbody"):
        reader.children(world, None, Pose(), world.attributes.get("childclass", MAIN), _Body())
    if not reader.links:
        faults.add(root, "has no <body> in a <worldbody>")
    for key in ("body", "joint", "site"):
        elements = [e for w in root.all("worldbody") for e in w.walk() if e.tag in (key, f"free{key}")]
        unique(faults, elements, key, lambda element: element.attributes.get("name", ""))
    blockers = {word: Faults() for word in ("equality", "tendon", "gravcomp", "gravity")}
    _constraints(root, reader, blockers)
    gravity = _gravity(root, faults, blockers["gravity"])
    return Description(
        name=root.attributes.get("model", ""),
        links=_with_efforts(reader.scaled_links(), drive_efforts(root, reader.settings)),
        sites=reader.sites,
        gravity=gravity,
        warnings=tuple(faults.warnings),
        blockers=blockers,
    )


class _Body:
    """What is gathered about one body while its children are read."""

    def __init__(self) -> None:
        self.joints: list[Joint] = []
        self.explicit: Inertial | None = None
        self.solid = Inertial()
        self.why = ""
        self.has_geoms = False
        self.solids: list[Solid] = []
        self.visuals: list[LinkVisual] = []


class _MjcfReader:
    def __init__(self, settings: Settings, meshes: Mapping[str, LinkVisual], named: set[str]) -> None:
        self.settings = settings
        self.meshes = meshes
        self.named = named
        self.faults = settings.faults
        self.links: list[RobotLink] = []
        self.sites: dict[str, Frame] = {}
        self.gravity_compensated: list[Element] = []

    def children(self, element: Element, name: str | None, pose: Pose, child_class: str, body: _Body) -> None:
        """Read the children of a body, a frame or the world; `pose` is the frame in the body (None: the world)."""
        for child in element.children:
            if child.tag not in IN_A_BODY:
                self.faults.add(child, f"<{child.tag}> is not read in a body: write out what it stands for", of=element)
            elif child.tag == "frame":
                inner = child.attributes.get("childclass", child_class)
                self.children(child, name, pose @ self.settings.pose(child), inner, body)
            elif child.tag == "body":
                self._body(child, name, pose, child_class)
            elif name is not None:
                self._part(child, element, name, pose, child_class, body)

    def _body(self, element: Element, parent: str | None, frame: Pose, child_class: str) -> None:
        index = len(self.links)
        name = element.attributes.get("name") or self._title(index + 1)
        link = RobotLink(name, parent, element)
        self.links.append(link)
        if self.faults.number(element, "gravcomp"):
            self.gravity_compensated.append(element)
        body = _Body()
        self.children(element, name, Pose(), element.attributes.get("childclass", child_class), body)
        inertial, why = self._inertial(body)
        self.links[index] = replace(
            link,
            pose=frame @ self.settings.pose(element),
            joints=tuple(body.joints),
            inertial=None if why else inertial,
            why=why,
            solids=tuple(body.solids),
            visuals=tuple(body.visuals),
        )

    def _title(self, number: int) -> str:
        """What a body without a name is called, as no other is."""
        while f"body{number}" in self.named:
            number += 1
        self.named.add(f"body{number}")
        return f"body{number}"

    def _part(self, child: Element, of: Element, name: str, pose: Pose, child_class: str, body: _Body) -> None:
        element = self.settings.resolved(child, child_class)
        if child.tag == "site":
            if "name" in child.attributes:
                self.sites[child.attributes["name"]] = Frame(name, pose @ self.settings.pose(element))
        elif child.tag == "inertial":
            body.explicit = self._explicit(child, of).seen_from(pose)
        elif child.tag == "geom":
            body.has_geoms = True
            shape = mjcf_solid(self.settings, element, pose, of)
            body.solids += [] if shape is None else [shape]
            body.visuals += mjcf_visuals(self.settings, element, pose, of, self.meshes)
            solid = geom_inertial(self.settings, element, pose, of)
            if isinstance(solid, str):
                body.why = solid
            else:
                body.solid = body.solid + solid
        elif child.tag in ("joint", "freejoint"):
            free = child.tag == "freejoint"
            title = child.attributes.get("name") or f"{name}.joint{len(body.joints) + 1}"
            joint = read_joint(self.settings, replace(element, tag="joint"), title, pose, free=free)
            if joint is not None:
                body.joints.append(joint)

    def _explicit(self, element: Element, of: Element) -> Inertial:
        """An <inertial>, its tensor in its own axes or, as fullinertia, in them too."""
        faults = self.faults
        for key in ("pos", "mass"):
            faults.required(element, key, of)
        given = [key for key in ("diaginertia", "fullinertia") if key in element.attributes]
        if len(given) != 1:
            faults.add(element, "needs either diaginertia or fullinertia", of=of)
        moments = faults.numbers(element, "diaginertia", 3, (0.0, 0.0, 0.0), of)
        if given == ["fullinertia"]:
            moments = faults.numbers(element, "fullinertia", 6, (0.0,) * 6, of)
        own = Inertial(faults.number(element, "mass", 0.0, of), np.zeros(3), symmetric(*(float(m) for m in moments)))
        check_inertial(faults, element, own, of)
        return own.seen_from(self.settings.pose(element, of))

    def _inertial(self, body: _Body) -> tuple[Inertial, str]:
        """The body's inertia as the compiler settings have it, or why it cannot be told."""
        settings = self.settings
        from_geoms = {"true": body.has_geoms, "false": False, "auto": body.explicit is None}
        if from_geoms[settings.inertia_from_geoms]:
            inertial, why = body.solid, body.why
        else:
            inertial, why = body.explicit or Inertial(), ""
        if settings.balance or settings.least_inertia > 0:
            inertial = replace(inertial, tensor=_adjusted(inertial.tensor, settings))
        return replace(inertial, mass=max(inertial.mass, settings.least_mass)), why

    def scaled_links(self) -> tuple[RobotLink, ...]:
        """The links, with `settotalmass` applied."""
        wanted = self.settings.total_mass
        known = [link.inertial for link in self.links if link.inertial is not None]
        total = sum(inertial.mass for inertial in known)
        if wanted <= 0 or total <= 0:
            return tuple(self.links)
        if len(known) < len(self.links):
            link = next(link for link in self.links if link.inertial is None)
            self.faults.add(link.element, f"settotalmass needs the mass of every body, but {link.why}")
        return tuple(
            link if link.inertial is None else replace(link, inertial=link.inertial.scaled(wanted / total))
            for link in self.links
        )


def _with_efforts(links: tuple[RobotLink, ...], efforts: Mapping[str, float]) -> tuple[RobotLink, ...]:
    """Joints bounded by what drives them, too."""
    return tuple(
        replace(
            link,
            joints=tuple(
                replace(joint, effort=min(efforts[joint.name], joint.effort or float("inf")))
                if joint.name in efforts
                else joint
                for joint in link.joints
            ),
        )
        for link in links
    )


def _adjusted(matrix: Array, settings: Settings) -> Array:
    """Principal moments averaged where no body has them (balanceinertia), and at least boundinertia."""
    moments, axes = np.linalg.eigh(matrix)
    if settings.balance and moments[2] > moments[0] + moments[1]:
        moments = np.full(3, moments.mean())
    return axes @ np.diag(np.maximum(moments, settings.least_inertia)) @ axes.T


def _constraints(root: Element, reader: _MjcfReader, blockers: dict[str, Faults]) -> None:
    """What couples or drives coordinates beside the tree of joints."""
    for section in root.all("equality"):
        for element in section.children:
            resolved = reader.settings.resolved(replace(element, tag="equality"), MAIN)
            if resolved.attributes.get("active", "true") == "true":
                blockers["equality"].add(element, "an equality constraint changes the dynamics and is not read")
    for section in root.all("tendon"):
        for element in section.children:
            resolved = reader.settings.resolved(replace(element, tag="tendon"), MAIN)
            pulls = [key for key in PULLS if set(resolved.attributes.get(key, "0").split()) - {"0", "0.0"}]
            if pulls:
                blockers["tendon"].add(element, f"a tendon with {' and '.join(pulls)} is not read")
    for element in reader.gravity_compensated:
        blockers["gravcomp"].add(element, "gravcomp takes weight off the body and is not read")
    for section in root.all("deformable"):
        for element in section.all("flex"):
            reader.faults.add(element, "flexible bodies are not read")


def _gravity(root: Element, faults: Faults, blocker: Faults) -> float:
    """Acceleration along −z, m/s²."""
    gravity, last, off = np.array([0.0, 0.0, -9.81]), root, False
    for option in root.all("option"):
        if "gravity" in option.attributes:
            gravity, last = faults.numbers(option, "gravity", 3, (0.0, 0.0, -9.81)), option
        for flag in option.all("flag"):
            for key in ("spring", "damper", "passive"):
                if flag.attributes.get(key) == "disable":
                    faults.add(flag, f"{key} is disabled, and with it what makes joints passive", of=option)
            off = flag.attributes.get("gravity", "disable" if off else "enable") == "disable"
        for key in ("density", "viscosity", "wind"):
            if np.any(faults.numbers(option, key, 3 if key == "wind" else 1, (0.0,) * (3 if key == "wind" else 1))):
                faults.warn(option, f"the medium's {key} is left out")
    if off:
        return 0.0
    if gravity[0] or gravity[1] or gravity[2] > 0:
        text = " ".join(f"{float(part):g}" for part in gravity)
        blocker.add(last, "gravity must point along -z; else say `gravity` in the machine file, in m/s²", value=text)
        return 0.0
    return -float(gravity[2]) + 0.0
