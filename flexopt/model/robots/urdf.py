"""URDF in, a `Description` out.

A link without <inertial> is massless, a joint without <origin> stands at its parent's frame, without <axis> along x;
what stands there for other programs (gazebo, transmission, left-over macros) is
left out with a warning, what URDF does not know is a fault. Floating joints are kept for the overlay to replace (root
link) or refuse; planar ones are refused.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np

from flexopt.errors import ModelError
from flexopt.foundation.quantities import EFFORT, SPEED
from flexopt.model.robots.collisions import urdf_solids
from flexopt.model.robots.description import Description, Joint, JointKind, Mimic, RobotLink, check_inertial, unit_axis
from flexopt.model.robots.elements import Element, Faults, unique
from flexopt.model.robots.geometry import Inertial, Pose, from_quaternion, from_rpy
from flexopt.model.robots.known import check_known
from flexopt.model.robots.visuals import urdf_visuals
from flexopt.model.tree_quantities import symmetric

KINDS: dict[str, JointKind | None] = {
    "revolute": "hinge", "continuous": "hinge", "prismatic": "slide", "fixed": None, "floating": "free",
}  # fmt: skip
# Bounds beyond these are none.
BEYOND = {"effort": EFFORT.high, "velocity": SPEED.high}
XACRO = "is xacro, a macro language; expand it to URDF first: xacro robot.urdf.xacro > robot.urdf"
# rad: beyond it, and rounding, orientations are meant in degrees.
WHOLE_TURN = 2 * np.pi + 0.01
MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def read_urdf(root: Element, folder: Path, faults: Faults, *, strict: bool = True) -> Description:
    """The robot below <robot>; what is wrong is added to `faults`.

    Args:
        root: the root element.
        folder: where paths of meshes start.
        faults: takes faults and warnings.
        strict: whether words that URDF does not have are faults.

    Raises:
        ModelError: a value is a macro's.
    """
    written = root
    root = check_known(root, "urdf", faults, strict=strict)
    _refuse_macros(root)
    links, joints = list(root.all("link")), list(root.all("joint"))
    for element in (*links, *joints):
        faults.required(element, "name")
    unique(faults, links, "link", _name)
    unique(faults, joints, "joint", _name)
    if not links:
        faults.add(root, "has no <link>")
    above = _parents(faults, links, joints)
    order = _topological(faults, root, links, above)
    read = [_link(faults, link, above.get(_name(link)), folder) for link in order]
    if faults.faults:
        for macro in [element for element in written.walk() if element.tag.startswith("xacro:")][:1]:
            faults.add(macro, XACRO)
    return Description(root.attributes.get("name", ""), tuple(read), {}, warnings=tuple(faults.warnings))


def _name(element: Element) -> str:
    return element.attributes.get("name", "").strip()


def _refuse_macros(root: Element) -> None:
    for element in root.walk():
        if any("${" in text for text in element.attributes.values()):
            raise ModelError(f"{element.place}: {element.label}: {XACRO}")


def _end(faults: Faults, joint: Element, tag: str) -> str:
    element = joint.first(tag)
    if element is None:
        faults.add(joint, f"needs <{tag} link=…>")
        return ""
    return faults.required(element, "link", of=joint)


def _parents(faults: Faults, links: list[Element], joints: list[Element]) -> dict[str, tuple[str, Element]]:
    """Link -> its parent link and the joint between; faulty joints are left out."""
    names = {_name(link) for link in links}
    above: dict[str, tuple[str, Element]] = {}
    for joint in joints:
        parent, child = _end(faults, joint, "parent"), _end(faults, joint, "child")
        for tag, name in (("parent", parent), ("child", child)):
            if name and name not in names:
                faults.add(joint, f"{tag} {name!r} is no link of this file")
        if child in above:
            sentence = f"link {child!r} is already carried by {above[child][1].label} of line {above[child][1].line}"
            faults.add(joint, f"{sentence}: closed loops are not read")
        elif parent in names and child in names:
            above[child] = (parent, joint)
    return above


def _topological(
    faults: Faults, root: Element, links: list[Element], above: dict[str, tuple[str, Element]]
) -> list[Element]:
    """Links with each after its parent, in the order of the file otherwise."""
    by_name = {_name(link): link for link in links}
    below: dict[str, list[str]] = {name: [] for name in by_name}
    for name in by_name:
        if name in above:
            below[above[name][0]].append(name)
    roots = [name for name in by_name if name not in above]
    if len(roots) > 1:
        listed = ", ".join(f"{name!r} (line {by_name[name].line})" for name in roots)
        faults.add(root, f"has several links that no joint carries: {listed}; a robot has one root link")
    order: list[str] = []
    stack = list(reversed(roots))
    while stack:
        name = stack.pop()
        order.append(name)
        stack.extend(reversed(below[name]))
    seen = set(order)
    loop = [name for name in by_name if name not in seen]
    if loop:
        joint = above[loop[0]][1]
        faults.add(
            joint, f"the links {', '.join(map(repr, loop))} hang on each other in a circle; no root carries them"
        )
    return [by_name[name] for name in order]


def _link(faults: Faults, link: Element, above: tuple[str, Element] | None, folder: Path) -> RobotLink:
    parent, element = above or (None, None)
    pose = Pose() if element is None else _origin(faults, element, element)
    joint = None if element is None else _joint(faults, element)
    return RobotLink(
        name=_name(link),
        parent=parent,
        element=link,
        pose=pose,
        joints=() if joint is None else (joint,),
        inertial=_inertial(faults, link),
        solids=urdf_solids(link, _origin),
        visuals=urdf_visuals(link, _origin, folder),
    )


def _origin(faults: Faults, holder: Element, of: Element) -> Pose:
    origin = holder.first("origin")
    if origin is None:
        return Pose()
    position = faults.numbers(origin, "xyz", 3, (0.0, 0.0, 0.0), of)
    if "quat_xyzw" in origin.attributes:
        if "rpy" in origin.attributes:
            faults.add(origin, "has rpy and quat_xyzw: one orientation is enough", of=of)
        x, y, z, w = faults.numbers(origin, "quat_xyzw", 4, (0.0, 0.0, 0.0, 1.0), of)
        if x == y == z == w == 0:
            faults.add(origin, "quat_xyzw tells no orientation: it is zero", of=of)
            return Pose(position)
        return Pose(position, from_quaternion(np.array([w, x, y, z])))
    angles = faults.numbers(origin, "rpy", 3, (0.0, 0.0, 0.0), of)
    if np.abs(angles).max() > WHOLE_TURN:
        told, meant = (" ".join(f"{x:.5g}" for x in each) for each in (angles, np.radians(angles)))
        faults.warn(origin, f"rpy {told} rad turns by more than a whole turn; in degrees it would be {meant}", of=of)
    return Pose(position, from_rpy(angles))


def _inertial(faults: Faults, link: Element) -> Inertial:
    element = link.first("inertial")
    if element is None:
        return Inertial()
    mass, moments = element.first("mass"), element.first("inertia")
    if mass is None or moments is None:
        faults.add(element, "needs <mass> and <inertia>; leave <inertial> out for a massless link", of=link)
        return Inertial()
    faults.required(mass, "value", of=link)
    for key in MOMENTS:
        faults.required(moments, key, of=link)
    entries = [faults.number(moments, key, of=link) for key in MOMENTS]
    body = Inertial(faults.number(mass, "value", of=link), np.zeros(3), symmetric(*entries))
    check_inertial(faults, element, body, link)
    if body.mass == 0 and body.tensor.any():
        faults.warn(element, "has moments of inertia and no mass", of=link)
    return body.seen_from(_origin(faults, element, link))


def _joint(faults: Faults, element: Element) -> Joint | None:
    word = faults.required(element, "type")
    if word == "planar":
        faults.add(element, "is planar: write two prismatic joints and a revolute one in its place")
    elif word and word not in KINDS:
        faults.add(element, f"type must be one of {', '.join(KINDS)}", value=repr(word))
    kind = KINDS.get(word)
    if kind is None:
        return None
    axis = element.first("axis")
    along = np.array([1.0, 0.0, 0.0])
    if axis is not None and kind != "free":
        along = unit_axis(faults, axis, "xyz", (1.0, 0.0, 0.0), element)
    dynamics = element.first("dynamics")
    damping = friction = 0.0
    if dynamics is not None:
        damping, friction = (faults.number(dynamics, key, of=element) for key in ("damping", "friction"))
        if damping < 0:
            faults.add(dynamics, "damping must not be negative", of=element, value=f"{damping:g}")
        if friction:
            faults.warn(dynamics, f"dry friction {friction:g} is left out", of=element)
    return Joint(
        name=_name(element),
        kind=kind,
        element=element,
        axis=along,
        anchor=np.zeros(3),
        damping=damping,
        limits=_limits(faults, element, word),
        effort=_most(faults, element, "effort"),
        speed=_most(faults, element, "velocity"),
        mimic=_mimic(faults, element),
    )


def _limits(faults: Faults, element: Element, word: str) -> tuple[float, float] | None:
    if word not in ("revolute", "prismatic"):
        return None
    limit = element.first("limit")
    if limit is None:
        hint = "; a hinge without limits is continuous" if word == "revolute" else ""
        faults.add(element, f"is {word} and needs <limit lower=… upper=…>{hint}")
        return None
    if not {"lower", "upper"} & limit.attributes.keys():
        faults.warn(limit, "has neither lower nor upper: read as without limits", of=element)
        return None
    lower, upper = (faults.number(limit, key, of=element) for key in ("lower", "upper"))
    if lower > upper:
        faults.add(limit, "lower exceeds upper", of=element, value=f"{lower:g}, {upper:g}")
        return None
    return lower, upper


def _most(faults: Faults, element: Element, key: str) -> float | None:
    """`effort` or `velocity` of <limit>; files in use write 0, infinity or a huge number where there is no bound."""
    limit = element.first("limit")
    if limit is None:
        return None
    with suppress(ValueError):
        if float(limit.attributes.get(key, "0")) > BEYOND[key]:
            return None
    bound = faults.number(limit, key, of=element)
    if bound < 0:
        faults.add(limit, f"{key} must not be negative", of=element, value=f"{bound:g}")
    return bound if bound > 0 else None


def _mimic(faults: Faults, element: Element) -> Mimic | None:
    mimic = element.first("mimic")
    if mimic is None:
        return None
    master = faults.required(mimic, "joint", of=element)
    multiplier = faults.number(mimic, "multiplier", 1.0, of=element)
    return Mimic(master, multiplier, faults.number(mimic, "offset", of=element))
