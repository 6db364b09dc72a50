"""What each joint of a robot is in the machine: actuated, passive with a spring, or locked at a value."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from flexopt.errors import Fault
from flexopt.foundation.escapes import toml_key
from flexopt.model.file_model import quoted
from flexopt.model.robots.description import Description, Joint, RobotLink
from flexopt.model.robots.elements import there_are
from flexopt.model.robots.overlay import JointTable, Overlay

# A locked value this far beyond a limit (rad or m) is at the limit.
LIMIT_ROUNDING = 1e-9


@dataclass(frozen=True)
class Role:
    """`value`: the rest value of a passive joint, the value of a locked one. SI."""

    kind: Literal["actuated", "passive", "locked"]
    value: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0
    limits: tuple[float, float] | None = None
    effort: float | None = None
    speed: float | None = None
    armature: float = 0.0


class Roles:
    """Roles by joint name; joints whose role is not clear are faults, and locked in the meantime."""

    def __init__(self, robot: Description, overlay: Overlay, links: Sequence[RobotLink]) -> None:
        self.overlay = overlay
        self.faults: list[Fault] = []
        self.of: dict[str, Role] = {}
        self._joints = {joint.name: joint for link in links for joint in link.joints}
        self._carries = {joint.name: link.name for link in links for joint in link.joints}
        self._everywhere = {joint.name for link in robot.links for joint in link.joints}
        for field, names in (("actuated", overlay.actuated), ("locked", overlay.locked), ("joints", overlay.joints)):
            self._check_names(field, list(names))
        for joint in self._joints.values():
            self._resolve(joint)

    def moves(self, joint: Joint) -> bool:
        """Whether the joint keeps its coordinate."""
        return self.of[joint.name].kind != "locked"

    def _check_names(self, field: str, names: list[str]) -> None:
        for name in names:
            if name in self._joints:
                continue
            sentence = f"is no joint that moves in the robot file{there_are(name, self._joints)}"
            if name in self._everywhere:
                sentence = "is no joint below the root link"
            self.faults.append(Fault(field, sentence, repr(name)))

    def _resolve(self, joint: Joint) -> Role:
        if joint.name not in self.of:
            self.of[joint.name] = self._role(joint)
        return self.of[joint.name]

    def _fault(self, joint: Joint, sentence: str) -> Role:
        self.faults.append(Fault(f"{joint.element.place}: {joint.element.label}", sentence))
        return Role("locked", joint.zero)

    def _role(self, joint: Joint) -> Role:
        overlay, name = self.overlay, joint.name
        if joint.kind == "free":
            root = self._carries[name]
            sentence = f'is free (six degrees of freedom): start from what it carries, root = "{root}", on a [base]'
            return self._fault(joint, sentence)
        if name in overlay.locked:
            return self._locked(joint, overlay.locked[name])
        if joint.mimic is not None:
            return self._mimicking(joint)
        table = overlay.joints.get(name, JointTable())
        stiffness = joint.stiffness if table.stiffness is None else table.stiffness
        damping = joint.damping if table.damping is None else table.damping
        limits = joint.limits if table.limits is None else table.limits
        armature = joint.armature if table.armature is None else table.armature
        if "armature" in overlay.ignore:
            armature = 0.0
        if name in overlay.actuated:
            if stiffness > 0:
                sentence = (
                    f"is actuated and has a spring ({stiffness:g}): take it out of `actuated`, or the spring away "
                    f"with stiffness = 0 in [joints.{toml_key(name)}]"
                )
                return self._fault(joint, sentence)
            if stuck := replace(joint, limits=limits).stuck:
                sentence = f"is actuated, but its limits {stuck} leave no room; say others in [joints.{toml_key(name)}]"
                return self._fault(joint, sentence)
            if table.rest is not None:
                sentence = "belongs to a joint with a spring; this one is actuated"
                self.faults.append(Fault(f"joints.{name}.rest", sentence, quoted(table.rest)))
            effort, speed = table.effort or joint.effort, table.speed or joint.speed
            return Role("actuated", 0.0, 0.0, damping, limits, effort, speed, armature)
        if stiffness > 0:
            for key in ("effort", "speed", "limits"):
                if getattr(table, key) is not None:
                    sentence = "belongs to an actuated joint; this one has a spring"
                    self.faults.append(Fault(f"joints.{name}.{key}", sentence, quoted(getattr(table, key))))
            rest = joint.rest if table.rest is None else table.rest
            return Role("passive", rest, stiffness, damping, armature=armature)
        if overlay.lock_others:
            return self._locked(joint, joint.zero)
        return self._fault(
            joint,
            f"is neither listed in `actuated`, nor has a spring (stiffness in [joints.{toml_key(name)}]), nor is in "
            "`locked`; lock_others = true locks every such joint",
        )

    def _locked(self, joint: Joint, value: float) -> Role:
        table = self.overlay.joints.get(joint.name, JointTable())
        low, high = table.limits or joint.limits or (value, value)
        if not low - LIMIT_ROUNDING <= value <= high + LIMIT_ROUNDING:
            sentence = f"is locked at {value:g} {joint.unit}, outside its limits {low:g} to {high:g}"
            return self._fault(joint, f"{sentence}; say another value in `locked`")
        return Role("locked", value)

    def _mimicking(self, joint: Joint) -> Role:
        """Follows a locked joint; coupled coordinates are refused."""
        factor, offset, seen, mimic = 1.0, 0.0, {joint.name}, joint.mimic
        while mimic is not None:
            offset, factor = offset + factor * mimic.offset, factor * mimic.multiplier
            master = self._joints.get(mimic.joint)
            if master is None or mimic.joint in seen:
                why = "follows itself" if mimic.joint in seen else f"mimics {mimic.joint!r}, which does not move here"
                return self._fault(joint, f"{why}; say its value in `locked`")
            seen.add(master.name)
            mimic = None if master.name in self.overlay.locked else master.mimic
            if mimic is None:
                role = self._resolve(master)
                if role.kind == "locked":
                    return self._locked(joint, factor * role.value + offset)
                return self._fault(
                    joint, f"mimics {master.name!r}, which moves: coupled joints are not read; lock either of them"
                )
        raise AssertionError
