"""The chain through a robot file (URDF or MJCF) that a machine file begins with: its tool, its joints, what it lacks.

In: a path and answers. Out: a `RobotChain`.
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexopt.errors import Fault, InputError, ModelError, raise_if_any
from flexopt.foundation.arrays import Array
from flexopt.foundation.escapes import option_list
from flexopt.foundation.nearest import hint
from flexopt.model.robots.description import Description, Joint, RobotLink
from flexopt.model.robots.geometry import Pose
from flexopt.model.robots.known import UNKNOWN
from flexopt.model.robots.reading import read_description

# Of the cosine of an axis to a plane's normal, up to which an arm moves in the plane.
IN_PLANE = 1e-6
# What a hand may be of the way to a finger's tip.
SHORT = 0.2
# Of the names of joints that close a gripper, and of those that turn one.
GRIPPING = ("grip", "finger", "thumb", "jaw", "claw")
TURNING = ("roll", "pitch", "yaw", "wrist", "rot")
# Of the names of sites where a tool is, in the order in which they are proposed.
TOOLS = ("tcp", "tool", "attach", "pinch", "grasp", "grip", "end", "ee", "tip", "hand")
# Of the names of frames that are beside a tool, but none.
SENSING = ("cam", "optic", "imu", "sens", "depth", "laser", "lidar", "mark")
# A frame's mass at most, of the body's that it is part of: some files give frames a gram.
FRAME = 2e-3
# Shares by which masses and reaches of branches differ at most that are alike, and by which a frame is beside an axis.
ALIKE, ON_AXIS = 0.1, 0.01
# Frames nearer than this, m, are in one place.
SAME = 1e-3
ORIGIN = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class RobotChain:
    """A robot file and the chain through it that a machine file begins with.

    Attributes:
        path: of the file;  robot: what it says;  ignore: words that it needs to be read.
        end: the link at the end-point;  root: what stands on the base, None where the file has one.
        actuated: joints between them that can be driven.
        sprung: whether the robot has springs of its own;  floats: whether its root is free, and needs a base.
        hand: joints behind the end, as of a gripper; none where the end was asked for.
        asked: which of "end" and "actuated" the call names.
        site: of an MJCF file, which is the end-point; empty where the link's own origin is.
        chosen: why the end is another of the links fixed to the last body, in words; else empty.
        stuck: joints on the way that could be driven, but for limits that leave no room.
    """

    path: Path
    robot: Description
    ignore: tuple[str, ...]
    end: str
    root: str | None
    actuated: tuple[str, ...]
    sprung: bool
    floats: bool
    hand: tuple[str, ...] = ()
    site: str = ""
    chosen: str = ""
    asked: tuple[str, ...] = ()
    stuck: tuple[Joint, ...] = ()

    @property
    def name(self) -> str:
        """The robot's name, else the file's."""
        return self.robot.name or self.path.stem

    @property
    def reach(self) -> float:
        """Of the end-point from where the root stands, m, every step stretched out."""
        way = way_to_link({link.name: link for link in self.robot.links}, self.end)
        return float(sum(np.linalg.norm(link.pose.position) for link in way[1:]))

    @property
    def gives(self) -> str:
        """Directions in which a base is proposed to give: of an arm that moves in a vertical plane no turn out of it.

        Its end-point would not show that turn, nor would feedback excite it, and its decay would be none of the loop's.
        """
        rotation, hinges, slides = np.eye(3), list[Array](), list[Array]()
        for link in way_to_link({link.name: link for link in self.robot.links}, self.end):
            rotation = rotation @ link.pose.rotation
            for joint in link.joints:
                if joint.name in self.actuated:
                    (hinges if joint.kind == "hinge" else slides).append(rotation @ joint.axis)
        for normal, words in ((np.array([0.0, 1.0, 0.0]), "z,pitch"), (np.array([1.0, 0.0, 0.0]), "z,roll")):
            along = all(abs(axis @ normal) > 1 - IN_PLANE for axis in hinges)
            if along and all(abs(axis @ normal) < IN_PLANE for axis in slides):
                return words
        return "z,roll,pitch"

    @property
    def ends(self) -> tuple[tuple[float, ...], ...]:
        """Where the end-point may be in the end's own axes, m, what is proposed first: its origin, and its far end.

        The far end, to a millimetre, has the centre of mass in the middle; a tool has none. It is proposed where the
        link's hinge turns it about its origin, and is no roll of a wrist.
        """
        link, origin = next(link for link in self.robot.links if link.name == self.end), np.zeros(3)
        if self.site or self.chosen or link.inertial is None or not link.joints:
            return (ORIGIN,)
        joint = link.joints[-1]
        far = (2 * link.inertial.com - joint.anchor).round(3) + 0.0
        if not far.any():
            return (ORIGIN,)
        stays, swung = (np.linalg.norm(np.cross(point - joint.anchor, joint.axis)) for point in (origin, far))
        turned = joint.kind == "hinge" and not stays > ON_AXIS * swung and swung > abs(far @ joint.axis)
        return (tuple(far.tolist()), ORIGIN) if turned else (ORIGIN, tuple(far.tolist()))


def read_chain(path: Path, end: str | None, actuated: Sequence[str] | None) -> RobotChain:
    """A robot file, and the chain to a link or site: by default that with the most joints before it, asked ones first.

    Raises:
        ModelError: the file has faults.
        InputError: it has no such link or joint.
    """
    ignore: list[str] = []
    robot, faults = read_description(path, path.name)
    if faults:
        ignore.append(UNKNOWN)
        robot, left = read_description(path, path.name, strict=False)
        raise_if_any(ModelError, path.name, left)
    ignore += [word for word, blocker in robot.blockers.items() if blocker.faults and word != "gravity"]
    links = {link.name: link for link in robot.links}
    known_ends = [*links, *robot.sites]
    if end is not None and end not in known_ends:
        word = "link or site" if robot.sites else "link"
        raise InputError(f"new: --tip = {end!r}: is no {word} of {path.name}{hint(end, known_ends, '')}")
    asked = robot.sites[end].link if end is not None and end not in links else end

    def before(name: str) -> tuple[int, int, int]:
        way = way_to_link(links, name)
        wanted = {joint.name for link in way for joint in link.joints} & {*(actuated or ())}
        return len(wanted), len(_driven(way)), len(way)

    at = asked or _wrist(links, max(links, key=before))
    site = (end or "") if asked != end else _site(robot, links, at) if end is None else ""
    behind = (x for x in robot.links if end is None and x.name != at and links[at] in way_to_link(links, x.name))
    hand = tuple(joint.name for link in behind for joint in link.joints)
    at, chosen = (at, "") if end is not None or site else _tool(links, at)
    way = way_to_link(links, at)
    ground = [link for link in robot.links if link.parent is None]
    free = next((k for k, link in enumerate(way) if any(joint.kind == "free" for joint in link.joints)), None)
    root = None if free is None and len(ground) == 1 else way[free or 0].name
    way = way[free or 0 :]
    moving = way if free is None else [*way[1:]]
    driven = _driven(moving)
    if actuated is not None:
        known = {joint.name for link in robot.links for joint in link.joints}
        wrong = [
            Fault("--actuated", f"is no joint of {path.name}{hint(x, known, '')}", x)
            for x in actuated
            if x not in known
        ]
        raise_if_any(InputError, "new", wrong)
        driven = list(actuated)
    stuck = [joint for link in moving for joint in link.joints if joint.drivable and joint.stuck]
    if not driven:
        why = f"no joint between the ground and link {at!r} can be driven"
        if stuck:
            names = shlex.quote(option_list(joint.name for joint in stuck))
            why += f": the limits leave no room, of {stuck_told(stuck)}; --actuated {names} writes a file that "
            why += "proposes others, in [joints]"
        raise InputError(f"new: {path.name}: {why}")
    sprung = any(joint.stiffness > 0 for link in robot.links for joint in link.joints)
    asked_for = tuple(word for word, given in (("end", end), ("actuated", actuated)) if given is not None)
    return RobotChain(
        path,
        robot,
        tuple(ignore),
        at,
        root,
        tuple(driven),
        sprung,
        free is not None,
        hand,
        site,
        chosen,
        asked_for,
        tuple(stuck),
    )


def way_to_link(links: dict[str, RobotLink], name: str) -> list[RobotLink]:
    """The links from the ground to one."""
    found = [links[name]]
    while (parent := found[-1].parent) is not None:
        found.append(links[parent])
    return found[::-1]


def _site(robot: Description, links: dict[str, RobotLink], at: str) -> str:
    """The site on a link, or on what is fixed to it, where a tool is; empty where none is plain.

    Plain is: it is the only one, or it is named after a tool.
    """

    def carried(name: str) -> str:
        return next((link.name for link in reversed(way_to_link(links, name)) if link.joints), "")

    found = [name for name, frame in robot.sites.items() if carried(frame.link) == carried(at)]
    return found[0] if len(found) == 1 else _named_tool(found)


def _named_tool(names: Sequence[str]) -> str:
    """The one that is most plainly named after a tool; empty where none is."""
    return next((name for word in TOOLS for name in names if any(part.startswith(word) for part in _parts(name))), "")


def _parts(name: str) -> list[str]:
    """Words of a name, in small letters."""
    return re.split(r"[^a-z]+", name.lower())


def _tool(links: dict[str, RobotLink], name: str) -> tuple[str, str]:
    """Of all that is fixed to the body which a link is part of, what the end-point is on, and why it is another link.

    A frame of a tool is a link with next to no mass that carries none: named after a tool, or alone on the axis of the
    last hinge. A finger is one of several branches that are alike and fixed to the same link, which stands in for them.
    """
    carrier = next((link for link in reversed(way_to_link(links, name)) if link.joints), None)
    if carrier is None:
        return name, ""
    children: dict[str, list[str]] = {each: [] for each in links}
    poses = {carrier.name: Pose()}
    for link in links.values():
        if link.parent is not None:
            children[link.parent].append(link.name)
        if not link.joints and link.parent in poses:
            poses[link.name] = poses[link.parent] @ link.pose
    nothing = FRAME * sum(mass_of_link(links[each]) for each in poses)

    def branch(root: str) -> list[str]:
        return [root, *(each for child in children[root] if child in poses for each in branch(child))]

    def size(root: str) -> tuple[float, float, float]:
        """Number of links, mass and reach of a branch, frames on it aside."""
        parts = [each for each in branch(root) if mass_of_link(links[each])]
        reach = max((math.dist(poses[each].position, poses[root].position) for each in parts), default=0.0)
        return float(len(parts)), sum(mass_of_link(links[each]) for each in parts), reach

    def alike(one: str, other: str) -> bool:
        near = (abs(x - y) <= ALIKE * max(x, y) for x, y in zip(size(one), size(other), strict=True))
        return one != other and size(one)[1] > nothing and all(near)

    fingers: dict[str, str] = {}
    for palm in branch(carrier.name):
        roots = [child for child in children[palm] if child in poses]
        for root in roots:
            if any(alike(root, other) for other in roots):
                fingers = dict.fromkeys(branch(root), palm) | fingers
    frames = [
        each for each in poses if each not in fingers and not children[each] and mass_of_link(links[each]) <= nothing
    ]
    of_sensors = [each for each in frames if any(part.startswith(SENSING) for part in _parts(each))]
    if name in frames:
        # Elsewhere is the flange of what has a tool, or something else.
        there = poses[name].position
        same = (x for x in frames if math.dist(poses[x].position, there) < SAME and x not in of_sensors)
        named = _named_tool([name, *same])
        return (name, "") if named in {"", name} else (named, _as_a_tool(carrier))
    frames = [each for each in frames if each not in of_sensors]
    on_axis = [each for each in frames if _on_axis(carrier.joints[-1], poses[each].position)]
    bare = [each for each in frames if not mass_of_link(links[each])]
    frame = _named_tool(bare) or _named_tool(frames) or (on_axis[0] if len(on_axis) == 1 else "")
    if frame:
        return frame, _as_a_tool(carrier)
    if name in fingers:
        return fingers[name], f"like branches are fixed to it, as fingers of a hand; one of them ends in {name}"
    return name, ""


def _as_a_tool(carrier: RobotLink) -> str:
    return f"a mere frame fixed to {carrier.name}, as a tool's"


def mass_of_link(link: RobotLink) -> float:
    """Of a link, kg; 0 where the file gives it none."""
    return 0.0 if link.inertial is None else link.inertial.mass


def _on_axis(joint: Joint, point: Array) -> bool:
    """Whether a point in the link's frame lies on the axis of its hinge, away from the joint."""
    arm = point - joint.anchor
    along = abs(float(arm @ joint.axis))
    return joint.kind == "hinge" and along > 0 and float(np.linalg.norm(np.cross(arm, joint.axis))) <= ON_AXIS * along


def _wrist(links: dict[str, RobotLink], name: str) -> str:
    """The link before a gripper's fingers, else the link itself.

    A hand is where, no farther than SHORT of the whole way from the tip, the way parts into several links that move, or
    goes on through a joint that is named after what grips; the last joint may also be one that another follows.
    """
    way = way_to_link(links, name)
    # From which links of the way others part that move.
    parted = {
        [each for each in way_to_link(links, x.name) if each in way][-1].name
        for x in links.values()
        if x not in way and x.joints and way[0] in way_to_link(links, x.name)
    }
    reach = np.cumsum([float(np.linalg.norm(link.pose.position)) for link in way])
    for k, link in enumerate(way[:-1]):
        if reach[-1] - reach[k] > SHORT * reach[-1] or not _driven(way[: k + 1]):
            continue
        after = way[k + 1]
        if (link.name in parted and any(x.joints for x in way[k + 1 :])) or (after.joints and _grips(after)):
            return link.name
    elsewhere = [joint for link in links.values() if link not in way for joint in link.joints]
    followed = {joint.mimic.joint for joint in elsewhere if joint.mimic is not None}
    joints = _driven(way)
    if len(joints) < 2 or joints[-1] not in followed:
        return name
    finger = next(link for link in way if any(joint.name == joints[-1] for joint in link.joints))
    return finger.parent if finger.parent and _driven(way_to_link(links, finger.parent)) else name


def _grips(link: RobotLink) -> bool:
    """Whether what moves the link is called after a gripper, and not after a wrist that turns one."""
    names = " ".join(joint.name for joint in link.joints).lower()
    return any(word in names for word in GRIPPING) and not any(word in names for word in TURNING)


def stuck_told(joints: Sequence[Joint]) -> str:
    """Joints without room between their limits, each with these, in words."""
    return ", ".join(f"{joint.name} {joint.stuck}" for joint in joints)


def _driven(way: Sequence[RobotLink]) -> list[str]:
    """Joints that can be: no spring, not coupled, not free, with some room between their limits."""
    return [joint.name for link in way for joint in link.joints if joint.drivable and not joint.stuck]
