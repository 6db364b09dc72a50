"""A machine file around a robot file (URDF or MJCF): its joints named, and proposals for what the robot file lacks.

In: a path and answers. Out: the text of the file and the machine that is read from it.
"""

from __future__ import annotations

import math
import os
import re
import shlex
import tomllib
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flexopt.errors import Fault, FlexoptWarning, InputError, ModelError, raise_if_any
from flexopt.foundation.arrays import Array
from flexopt.foundation.escapes import one_line
from flexopt.foundation.nearest import hint
from flexopt.foundation.rendering import render
from flexopt.model import AnyMachine
from flexopt.model.robots.description import Description, Joint, RobotLink
from flexopt.model.robots.geometry import Pose
from flexopt.model.robots.known import UNKNOWN
from flexopt.model.robots.reading import read_description, robot_from_dict
from flexopt.study.new_files.machine import (
    GainTexts,
    Ground,
    NewMachine,
    Springs,
    aligned,
    gains_told,
    number,
    quoted,
    regular_posture,
)

# What of the end-point can be controlled: the first of these that the joints can move.
ROWS = (("x", "y", "z"), ("x", "z"), ("x", "y"), ("y", "z"), ("x",), ("y",), ("z",))
JOINTS_SHOWN, HAND_SHOWN = 80, 4
# Folders to climb from which on a path is written from the root.
FAR_UP = 3
# Limits that are proposed where the file's leave no room: of hinges, rad, of slides of an arm without reach, m.
TURN, SLIDE = 3.14, 1.0
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
WORDS = {"hinge": "turns, rad", "slide": "slides, m", "free": "is free"}


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
        way = _way({link.name: link for link in self.robot.links}, self.end)
        return float(sum(np.linalg.norm(link.pose.position) for link in way[1:]))

    @property
    def gives(self) -> str:
        """Directions in which a base is proposed to give: of an arm that moves in a vertical plane no turn out of it.

        Its end-point would not show that turn, nor would feedback excite it, and its decay would be none of the loop's.
        """
        rotation, hinges, slides = np.eye(3), list[Array](), list[Array]()
        for link in _way({link.name: link for link in self.robot.links}, self.end):
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
        way = _way(links, name)
        wanted = {joint.name for link in way for joint in link.joints} & {*(actuated or ())}
        return len(wanted), len(_driven(way)), len(way)

    at = asked or _wrist(links, max(links, key=before))
    site = (end or "") if asked != end else _site(robot, links, at) if end is None else ""
    behind = (x for x in robot.links if end is None and x.name != at and links[at] in _way(links, x.name))
    hand = tuple(joint.name for link in behind for joint in link.joints)
    at, chosen = (at, "") if end is not None or site else _tool(links, at)
    way = _way(links, at)
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
            names = shlex.quote(",".join(joint.name for joint in stuck))
            why += f": the limits leave no room, of {_stuck_told(stuck)}; --actuated {names} writes a file that "
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


def _way(links: dict[str, RobotLink], name: str) -> list[RobotLink]:
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
        return next((link.name for link in reversed(_way(links, name)) if link.joints), "")

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
    carrier = next((link for link in reversed(_way(links, name)) if link.joints), None)
    if carrier is None:
        return name, ""
    children: dict[str, list[str]] = {each: [] for each in links}
    poses = {carrier.name: Pose()}
    for link in links.values():
        if link.parent is not None:
            children[link.parent].append(link.name)
        if not link.joints and link.parent in poses:
            poses[link.name] = poses[link.parent] @ link.pose
    nothing = FRAME * sum(_mass(links[each]) for each in poses)

    def branch(root: str) -> list[str]:
        return [root, *(each for child in children[root] if child in poses for each in branch(child))]

    def size(root: str) -> tuple[float, float, float]:
        """Number of links, mass and reach of a branch, frames on it aside."""
        parts = [each for each in branch(root) if _mass(links[each])]
        reach = max((math.dist(poses[each].position, poses[root].position) for each in parts), default=0.0)
        return float(len(parts)), sum(_mass(links[each]) for each in parts), reach

    def alike(one: str, other: str) -> bool:
        near = (abs(x - y) <= ALIKE * max(x, y) for x, y in zip(size(one), size(other), strict=True))
        return one != other and size(one)[1] > nothing and all(near)

    fingers: dict[str, str] = {}
    for palm in branch(carrier.name):
        roots = [child for child in children[palm] if child in poses]
        for root in roots:
            if any(alike(root, other) for other in roots):
                fingers = dict.fromkeys(branch(root), palm) | fingers
    frames = [each for each in poses if each not in fingers and not children[each] and _mass(links[each]) <= nothing]
    of_sensors = [each for each in frames if any(part.startswith(SENSING) for part in _parts(each))]
    if name in frames:
        # Elsewhere is the flange of what has a tool, or something else.
        there = poses[name].position
        same = (x for x in frames if math.dist(poses[x].position, there) < SAME and x not in of_sensors)
        named = _named_tool([name, *same])
        return (name, "") if named in {"", name} else (named, _as_a_tool(carrier))
    frames = [each for each in frames if each not in of_sensors]
    on_axis = [each for each in frames if _on_axis(carrier.joints[-1], poses[each].position)]
    bare = [each for each in frames if not _mass(links[each])]
    frame = _named_tool(bare) or _named_tool(frames) or (on_axis[0] if len(on_axis) == 1 else "")
    if frame:
        return frame, _as_a_tool(carrier)
    if name in fingers:
        return fingers[name], f"like branches are fixed to it, as fingers of a hand; one of them ends in {name}"
    return name, ""


def _as_a_tool(carrier: RobotLink) -> str:
    return f"a mere frame fixed to {carrier.name}, as a tool's"


def _mass(link: RobotLink) -> float:
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
    way = _way(links, name)
    # From which links of the way others part that move.
    parted = {
        [each for each in _way(links, x.name) if each in way][-1].name
        for x in links.values()
        if x not in way and x.joints and way[0] in _way(links, x.name)
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
    return finger.parent if finger.parent and _driven(_way(links, finger.parent)) else name


def _grips(link: RobotLink) -> bool:
    """Whether what moves the link is called after a gripper, and not after a wrist that turns one."""
    names = " ".join(joint.name for joint in link.joints).lower()
    return any(word in names for word in GRIPPING) and not any(word in names for word in TURNING)


def _stuck_told(joints: Sequence[Joint]) -> str:
    return ", ".join(f"{joint.name} {joint.stuck}" for joint in joints)


def _driven(way: Sequence[RobotLink]) -> list[str]:
    """Joints that can be: no spring, not coupled, not free, with some room between their limits."""
    return [joint.name for link in way for joint in link.joints if joint.drivable and not joint.stuck]


def overlay_file(chain: RobotChain, name: str, folder: Path, ground: Ground) -> NewMachine:
    """The machine file around a robot file.

    Args:
        chain: from `read_chain`.
        name: of the machine.
        folder: where the file will lie.
        ground: directions x, y, z, roll, pitch, yaw and what is known of their springs; none where the robot has some.

    Raises:
        ModelError: no machine comes of it; the message says why.
    """
    faults: list[InputError] = []
    # Either end is tried before fewer rows are.
    for rows, end in ((some, end) for some in ROWS if len(some) <= len(chain.actuated) for end in chain.ends):
        text = _Text(chain, name, folder, ground, rows, end)

        def build(springs: Springs, text: _Text = text) -> AnyMachine:
            with warnings.catch_warnings():
                # `flexopt check`, and loading the file, say all of it again.
                warnings.simplefilter("ignore", FlexoptWarning)
                return robot_from_dict(tomllib.loads(text(springs)), folder=folder, origin=name)

        try:
            bare = Springs((), ())
            found = ground.springs(build) if ground.gives else Springs((), (), regular_posture(build(bare)))
            machine = build(found)
            return NewMachine(text(found, gains_told(machine, found.posture)), machine, found.posture, text.held)
        except ModelError:
            raise
        except InputError as error:
            faults.append(error)
    raise faults[0]


@dataclass(frozen=True)
class _Text:
    """The file's text."""

    chain: RobotChain
    name: str
    folder: Path
    ground: Ground
    rows: tuple[str, ...]
    offset: tuple[float, ...]

    def __call__(self, springs: Springs, gains: GainTexts | None = None) -> str:
        chain = self.chain
        joints = [(joint, link) for link in chain.robot.links for joint in link.joints]
        shown = [self._told(joint, link) for joint, link in joints[:JOINTS_SHOWN]]
        more = len(joints) - JOINTS_SHOWN
        locked = self._locked([joint for joint, _ in joints])
        relative = _relative(chain.path.resolve(), self.folder.resolve())
        blocked = chain.robot.blockers.get("gravity")
        # Aside of a plane the end-point would leave the target, of which rows say nothing there.
        along = [row for row in ("x", "y") if row in self.rows]
        placed = ["x", "y", "yaw"] if len(along) == 2 else along

        def by_direction(values: Sequence[float]) -> str:
            parts = (f"{d} = {number(x)}" for d, x in zip(self.ground.gives, values, strict=True))
            return f"{{ {', '.join(parts)} }}" if values else ""

        values: dict[str, Any] = {
            "title": one_line(self.name),
            "name": quoted(self.name),
            "robot": quoted(relative),
            "robot_comment": one_line(chain.path.name),
            "root": chain.root and quoted(chain.root),
            "gravity": "9.81" if blocked is not None and blocked.faults else "",
            "ignore": _listed(chain.ignore) if chain.ignore else "",
            "joints": [*shown, *([f"and {more} more"] if more > 0 else [])],
            "actuated": _listed(chain.actuated),
            "actuated_note": "" if "actuated" in chain.asked else f" (proposed: {self._actuated_told()})",
            "locked": f"{{ {', '.join(f'{quoted(name)} = {x!r}' for name, x in locked.items())} }}" if locked else "",
            "locked_note": self.held and f" (proposed: {self.held})",
            "root_told": self._root(),
            "stiffness": by_direction(springs.stiffness),
            "damping": by_direction(springs.damping),
            "stiffness_note": springs.notes[0],
            "damping_note": springs.notes[1],
            "site": chain.site and quoted(chain.site),
            "on_link": one_line(chain.end),
            "link": quoted(chain.end),
            "end_note": "" if "end" in chain.asked else f" (proposed: {self._end_told()})",
            "offset": f"[{', '.join(map(repr, self.offset))}]",
            "offset_note": "the link's own origin, where its joint is"
            if not any(self.offset)
            else "twice as far as its centre of mass, as its joint does not move its origin",
            "placement": _listed(placed),
            "placement_note": "" if len(placed) > 1 else " (proposed: in the plane of end_point.rows)",
            "rows": _listed(self.rows),
            "rows_note": "" if self.rows == ROWS[0] else " (proposed: what these joints can move)",
            "stuck": self._freed(),
            "first": next((quoted(name) for name in chain.actuated if name not in self._stuck), ""),
            "gains": gains,
        }
        return aligned(render("study/templates/robot_machine.toml", **values))

    @property
    def held(self) -> str:
        """Which joints follow actuated ones in the robot file, and are held here; empty where none does."""
        told = [
            f"{joint.name}, which follows {joint.mimic.joint}"
            for link in self.chain.robot.links
            for joint in link.joints
            if joint.mimic is not None and joint.mimic.joint in self.chain.actuated
        ]
        are = "is" if len(told) == 1 else "are"
        return one_line(f"{' and '.join(told)}, {are} held: a coupling is not modelled") if told else ""

    def _end_told(self) -> str:
        """Why this link is proposed as the end-point's, and which joints are left out behind it."""
        hand, chosen = self.chain.hand, self.chain.chosen
        if not hand:
            return one_line(chosen or "the last one")
        more = f" and {len(hand) - HAND_SHOWN} more" if len(hand) > HAND_SHOWN else ""
        why = f"{chosen}; a hand's" if chosen else "the last one before a hand; its"
        return one_line(f"{why} joints are left out: {', '.join(hand[:HAND_SHOWN])}{more}")

    def _root(self) -> str:
        """The link that stands on the springs, and the mass of it and all that does not move on it, as far as told."""
        links = {link.name: link for link in self.chain.robot.links}
        root = links[self.chain.root or _way(links, self.chain.end)[0].name]
        carried = [root]
        for link in links.values():
            if link.parent in {each.name for each in carried} and not any(map(self._moves, link.joints)):
                carried.append(link)
        mass = sum(map(_mass, carried))
        rest = " and what does not move on it," if mass > _mass(root) else ""
        return one_line(f", {root.name},{rest} {mass:.4g} kg") if mass > 0 else ""

    def _moves(self, joint: Joint) -> bool:
        """Whether the machine moves in a joint; others are locked."""
        return joint.name in self.chain.actuated or joint.stiffness > 0 or joint.kind == "free"

    @staticmethod
    def _told(joint: Joint, link: RobotLink) -> str:
        limits = "" if joint.limits is None else f", {joint.limits[0]:.4g} to {joint.limits[1]:.4g}"
        spring = f", spring {joint.stiffness:g}" if joint.stiffness > 0 else ""
        mimic = "" if joint.mimic is None else f", follows {joint.mimic.joint}"
        return one_line(
            f"{joint.name}: {WORDS[joint.kind]}, {link.parent or 'the world'} → {link.name}{limits}{spring}{mimic}"
        )

    @property
    def _stuck(self) -> dict[str, Joint]:
        """Actuated joints whose limits in the robot file leave no room."""
        joints = (joint for link in self.chain.robot.links for joint in link.joints)
        return {joint.name: joint for joint in joints if joint.stuck and joint.name in self.chain.actuated}

    def _actuated_told(self) -> str:
        """Why these joints are proposed."""
        every = "all on the way to the end-point"
        if not self.chain.stuck:
            return every
        return one_line(f"{every} with room between their limits; not {_stuck_told(self.chain.stuck)}: see --actuated")

    def _freed(self) -> list[dict[str, str]]:
        """What these are given: of hinges a turn to either side, of slides the arm's reach."""
        found: list[dict[str, str]] = []
        for name, joint in self._stuck.items():
            most = number(TURN if joint.kind == "hinge" else self.chain.reach or SLIDE)
            note = f"{joint.unit} (proposed: those of the robot file, {joint.stuck[1:-1]}, leave no room)"
            found.append({"name": quoted(name), "limits": f"[-{most}, {most}]", "note": one_line(note)})
        return found

    def _locked(self, joints: Sequence[Joint]) -> dict[str, float]:
        """Joints that cannot stay where the file has them: coupled to one that moves, or that place out of limits."""
        masters = {joint.name: joint for joint in joints}
        found: dict[str, float] = {}
        for joint in joints:
            if joint.name in self.chain.actuated or joint.kind == "free" or joint.stiffness > 0:
                continue
            low, high = joint.limits or (joint.zero, joint.zero)
            inside = min(max(joint.zero, low), high) if joint.limits else joint.zero
            master, seen = joint, set[str]()
            while master.mimic is not None and master.name not in seen:
                seen.add(master.name)
                master = masters.get(master.mimic.joint, master)
            if inside != joint.zero or (joint.mimic is not None):
                found[joint.name] = inside
        return found


def _relative(path: Path, folder: Path) -> str:
    """From the folder to the file, so that both can move together; from the root where they lie far apart."""
    try:
        relative = Path(os.path.relpath(path, folder))
    except ValueError:
        return path.as_posix()
    return (path if relative.parts[:FAR_UP] == ("..",) * FAR_UP else relative).as_posix()


def _listed(words: Sequence[str]) -> str:
    return f"[{', '.join(map(quoted, words))}]"
