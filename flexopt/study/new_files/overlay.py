"""A machine file around a robot file (URDF or MJCF): its joints named, and proposals for what the robot file lacks.

In: a path and answers. Out: the text of the file and the machine that is read from it.
"""

from __future__ import annotations

import os
import tomllib
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexopt.errors import FlexoptWarning, InputError, ModelError
from flexopt.foundation.escapes import one_line
from flexopt.foundation.rendering import render
from flexopt.model import AnyMachine
from flexopt.model.robots.description import Joint, RobotLink
from flexopt.model.robots.reading import robot_from_dict
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
from flexopt.study.new_files.robot_chain import RobotChain, mass_of_link, stuck_told, way_to_link

# What of the end-point can be controlled: the first of these that the joints can move.
ROWS = (("x", "y", "z"), ("x", "z"), ("x", "y"), ("y", "z"), ("x",), ("y",), ("z",))
JOINTS_SHOWN, HAND_SHOWN = 80, 4
# Folders to climb from which on a path is written from the root.
FAR_UP = 3
# Limits that are proposed where the file's leave no room: of hinges, rad, of slides of an arm without reach, m.
TURN, SLIDE = 3.14, 1.0
WORDS = {"hinge": "turns, rad", "slide": "slides, m", "free": "is free"}


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
        root = links[self.chain.root or way_to_link(links, self.chain.end)[0].name]
        carried = [root]
        for link in links.values():
            if link.parent in {each.name for each in carried} and not any(map(self._moves, link.joints)):
                carried.append(link)
        mass = sum(map(mass_of_link, carried))
        rest = " and what does not move on it," if mass > mass_of_link(root) else ""
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
        return one_line(f"{every} with room between their limits; not {stuck_told(self.chain.stuck)}: see --actuated")

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
