"""From a `[loop]` table to numbers: what it leaves out follows from the machine, and every source is named.

In: a machine, its `Loop`, a configuration. Out: `LoopSettings`, the numbers that the loop for small motions takes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, cast

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.foundation.control import RATE_GAIN_UNITS, Control, damping_unit, gain_units, limit_unit
from flexopt.foundation.results import Result
from flexopt.loop.borders import HIGH, LOW
from flexopt.loop.gains import DAMPING_RATIO, SHARE, rigid_gains
from flexopt.loop.levers import servo_gain_of_efforts
from flexopt.loop.outcome import LoopPoint
from flexopt.loop.small_motions import SmallMotions, damping_entries
from flexopt.model import AnyMachine
from flexopt.model.loop import DEFAULT_LOOP, Drive, Loop, drive_of, rate_of
from flexopt.plant import build_plant
from flexopt.robustness import Evaluation

# Of velocity-served joints, where no gain is given: that of teleoperated excavators, 1/s. How often the corner of other
# gains is halved in search of a stable loop.
VELOCITY_KP = 1.0
HALVINGS = 6
USUAL = "usual of velocity-served joints"
# How the sources of numbers begin that follow from a posture.
SUITING, SERVING = "suits the arm's masses", "the largest at which no full lever asks a joint here"
# The source of gains that a choice by the loop took from their ranges.
CHOSEN = "chosen with the configuration"
# What a loop may say of each joint's drive.
OF_DRIVES = ("bandwidth_hz", "torque_limit", "rate_limit")


@dataclass(frozen=True)
class LoopSettings(Result):
    """A loop's numbers. r task rows, n joints; SI, what a loop lacks is None.

    Attributes:
        control, feedback, drive: as in `flexopt.model.Loop`.
        kp, kv, ki: (r,), in `gain_units`; where they make a force of the end-point's error these are `force_units`.
        rate: Hz;  dead_time: s;  filter_hz: Hz;  bandwidth_hz: (n,), Hz.
        servo_gain: N m s/rad or N s/m, of velocity-served joints.
        nullspace_damping: N m s/rad or N s/m.
        torque_limit: N m or N, and rate_limit, N m/s or N/s, (n,): of the drives; small motions do not feel them.
        joint_units: rad or m, (n,).
        sources: where each value comes from that `[loop]` does not give, in words.
    """

    control: Control
    feedback: Literal["pd", "pid"]
    drive: Drive
    kp: Vector
    kv: Vector
    ki: Vector
    rate: float
    dead_time: float
    filter_hz: float | None
    bandwidth_hz: Vector | None
    servo_gain: float | None
    nullspace_damping: float
    torque_limit: Vector | None
    rate_limit: Vector | None
    joint_units: tuple[str, ...]
    sources: Mapping[str, str]

    @property
    def redundant(self) -> bool:
        """Whether the arm has more joints than task rows."""
        return len(self.joint_units) > self.kp.size

    @property
    def lets_drift(self) -> bool:
        """Whether the arm has a self-motion that the loop does not brake: drives that follow rates hold it."""
        return self.redundant and not self.nullspace_damping and self.drive != "velocity"

    @property
    def braking(self) -> float:
        """By which a drive that serves rates brakes its joint, N m s/rad or N s/m; 0 of one that serves torques."""
        return float(self.servo_gain or 1.0) if self.drive == "velocity" else 0.0

    DOCUMENT = """
    control feedback drive kp kv ki rate[Hz] dead_time[s] filter_hz[Hz] bandwidth_hz[Hz] servo_gain nullspace_damping
    torque_limit rate_limit joint_units gain_units force_units position_held sources
    """

    @property
    def force_units(self) -> tuple[str, str, str]:
        """See the class."""
        return gain_units(self.control, self.joint_units)

    @property
    def gain_units(self) -> tuple[str, str, str]:
        """See the class."""
        return RATE_GAIN_UNITS if self.drive == "velocity" else self.force_units

    @property
    def first_kp(self) -> float:
        """Kp of the first row that has one, of which an allowed gain is; 1 where none has."""
        return next((x for x in self.kp.tolist() if x > 0), 1.0)

    @property
    def position_held(self) -> tuple[bool, ...]:
        """By task row, whether a gain on the position, Kp or Ki, holds the end-point on its target."""
        return tuple(((self.kp > 0) | (self.ki > 0)).tolist())

    @property
    def lowest_kp(self) -> float:
        """From which Kp on a border of `allowed_gain` is looked for."""
        return self.first_kp * 10**LOW

    @property
    def highest_kp(self) -> float:
        """Up to which."""
        return self.first_kp * 10**HIGH

    @property
    def even(self) -> bool:
        """Whether all task rows have the same gains, and all joints the same servo."""
        each = (self.kp, self.kv, self.ki, () if self.bandwidth_hz is None else self.bandwidth_hz)
        return all(len(set(values)) <= 1 for values in each)

    @property
    def damping_unit(self) -> str:
        """Of `servo_gain` and `nullspace_damping`: of arms of hinges, of slides, of both."""
        return damping_unit(self.joint_units)

    @property
    def fixed(self) -> Loop:
        """The `Loop` of these numbers: with nothing left out it is the same in every posture."""
        each = {name: getattr(self, name) for name in ("kp", "kv", "ki", *OF_DRIVES)}
        return Loop(
            control=self.control, feedback=self.feedback, drive=self.drive, rate=self.rate, dead_time=self.dead_time,
            filter_hz=self.filter_hz, servo_gain=self.servo_gain, nullspace_damping=self.nullspace_damping,
            **{name: value.tolist() for name, value in each.items() if value is not None},
        )  # fmt: skip

    def with_chosen(self, gains: Mapping[str, float]) -> LoopSettings:
        """The same with gains, alike in all rows, that a choice took from their ranges."""
        each = {name: np.full(self.kp.size, gain) for name, gain in gains.items()}
        return replace(self, **each, sources={**self.sources, **dict.fromkeys(gains, CHOSEN)}) if gains else self

    def with_rows(self, gains: Mapping[str, Sequence[float]]) -> LoopSettings:
        """The same with gains that are given, of each row."""
        sources = {name: why for name, why in self.sources.items() if name not in gains}
        return replace(self, **{name: np.array(each) for name, each in gains.items()}, sources=sources)

    def motions(self, machine: AnyMachine, *, gravity: bool, own_model: bool = False) -> SmallMotions:
        """The Functions of this loop; `own_model` says something under gravity alone."""
        return SmallMotions(
            machine, self.control, gravity=gravity, integral=self.feedback == "pid",
            filtered=self.filter_hz is not None, lagging=self.bandwidth_hz is not None,
            damped=self.nullspace_damping > 0, served=self.drive == "velocity", own_model=gravity and own_model,
        )  # fmt: skip

    @property
    def numbers(self) -> dict[str, Vector]:
        """Inputs of the Functions but those of the configuration."""
        given = {name: getattr(self, name) for name in ("kp", "kv", "ki", "nullspace_damping")}
        given |= {"period": 1 / self.rate, "servo_gain": self.servo_gain, "filter_hz": self.filter_hz}
        given["bandwidth_hz"] = self.bandwidth_hz
        return {name: np.atleast_1d(np.asarray(x, dtype=np.float64)) for name, x in given.items() if x is not None}

    def outcome(
        self,
        machine: AnyMachine,
        base: Vector,
        posture: Vector,
        *,
        gravity: bool,
        parameters: Vector | None = None,
        dead_time: float | None = None,
        own_model: bool = False,
    ) -> LoopPoint:
        """This loop in a configuration; of the machine with other `parameters`, which it knows or not, or dead time."""
        motions = self.motions(machine, gravity=gravity, own_model=own_model)
        p = build_plant(machine).parameter_values.full().ravel() if parameters is None else parameters
        numbers = motions.numbers(self.numbers | {"base": base, "posture": posture, "p": p})
        return LoopPoint(motions, numbers, self.dead_time if dead_time is None else dead_time)

    @property
    def proposed(self) -> list[str]:
        """Lines on what nobody gave, and on joints that it hardly drives; none where all was given."""
        own = {name: why for name, why in self.sources.items() if why != CHOSEN}
        names = ", ".join(f"drive ({why})" if name == "drive" else name for name, why in own.items())
        lines = [f"not given of the loop, so proposed: {names}", self.hardly_served] if names else []
        return [f"  {line}" for line in lines if line]

    @property
    def hardly_served(self) -> str:
        """Which joints brake themselves more than the proposed servo gain drives them; empty where none does."""
        return self.sources.get("servo_gain", "").partition("; ")[2]

    @property
    def of_posture(self) -> list[str]:
        """Names of the numbers that follow from the posture of a place, which would be others elsewhere."""
        return [name for name, source in self.sources.items() if source.startswith((SUITING, SERVING))]

    @property
    def in_calls(self) -> str:
        """How calls are given this loop, all of it: gains alone would be those of another drive."""
        given = self.fixed.model_dump(exclude_defaults=True)
        given = {name: each for name, each in given.items() if each != "inverse" and (name != "ki" or any(each))}
        told = {name: _in_call(number) for name, number in given.items()}
        table = ", ".join(f'"{name}": {number}' for name, number in told.items())
        plain = {name: number.strip('[]"').replace(" ", "") for name, number in told.items()}
        # As a table in a call, in place of the file's own: what is not named there is its default.
        options = [f"--loop {DEFAULT_LOOP}", *(f"--loop {name}={number}" for name, number in plain.items())]
        return f"loop={{{table}}}, in the shell {' '.join(options)}"

    def __repr__(self) -> str:
        gains = [f"{name} {_numbers(getattr(self, name.lower()))}{unit and ' ' + unit}"
                 for name, unit in zip(("Kp", "Kv", "Ki"), self.gain_units, strict=True)
                 if name != "Ki" or self.feedback == "pid"]  # fmt: skip
        served = "" if self.servo_gain is None else f" (servo gain {self.servo_gain:.4g} {self.damping_unit})"
        parts = [f"{self.drive}-served joints{served}", *gains, f"{self.rate:g} Hz", f"dead time {self.dead_time:g} s"]
        parts += [] if self.filter_hz is None else [f"filter {self.filter_hz:g} Hz"]
        parts += [] if self.bandwidth_hz is None else [f"servo {_numbers(self.bandwidth_hz)} Hz"]
        for limit, name, per in ((self.torque_limit, "torque", ""), (self.rate_limit, "rate", "/s")):
            parts += [] if limit is None else [f"{name} limit {_numbers(limit)} {limit_unit(self.joint_units, per)}"]
        if self.nullspace_damping > 0:
            parts.append(f"damper of the self-motion {self.nullspace_damping:.4g} {self.damping_unit}")
        lines = [f"{self.feedback.upper()}, Jacobian {self.control} control, {', '.join(parts)}"]
        return "\n".join(lines + [f"  {name}: {source}" for name, source in self.sources.items()])


def _numbers(values: Vector) -> str:
    """One number where all are the same."""
    listed = [f"{x:.4g}" for x in values]
    return listed[0] if len(set(listed)) == 1 else f"[{', '.join(listed)}]"


def _in_call(given: object) -> str:
    """A number, several or a word as Python has them; equal numbers once."""
    if isinstance(given, str):
        return f'"{given}"'
    if isinstance(given, float):
        return f"{given:.10g}"
    each = [f"{number:.10g}" for number in cast("Sequence[float]", given)]
    return each[0] if len(set(each)) == 1 else f"[{', '.join(each)}]"


def loop_settings(machine: AnyMachine, loop: Loop, stand: Evaluation, *, gravity: bool = False) -> LoopSettings:
    """The numbers of a loop that is known to be good, in a configuration that was evaluated.

    Args:
        machine: the machine.
        loop: its `[loop]`.
        stand: the configuration, and the control that was evaluated.
        gravity: whether under static deflection.
    """
    rows, drive, rate, sources = (
        len(machine.task_rows),
        drive_of(loop, machine),
        rate_of(loop, machine),
        dict[str, str](),
    )
    if loop.drive is None:
        sources["drive"] = _why_drive(loop, drive)
    if loop.rate is None:
        sources["rate"] = f"{rate:g} Hz, {USUAL if drive == 'velocity' else 'as in the article'}"
    gain = loop.servo_gain
    if drive == "velocity" and gain is None:
        gain = servo_gain_of_efforts(machine, stand.posture)
        cylinder = any(cylinder.force is not None for cylinder in machine.cylinders)
        counts = ", or where a cylinder with a force drives it, than that gives" if cylinder else ""
        # Without cylinders efforts and rates are those of every posture.
        asks = SERVING if machine.cylinders else SERVING.removesuffix(" here")
        sources["servo_gain"] = f"{asks} for more than its effort{counts}{_hardly_served(machine, gain or 0.0)}"
    gains: dict[str, float] = {}
    for name in ("kp", "kv"):
        given, allowed = getattr(loop, name), getattr(loop, f"{name}_range")
        if given is None and allowed is not None:
            gains[name] = _middle(allowed)
            sources[name] = f"the middle of {name}_range"
    chosen = {name for name in ("kp", "kv") if getattr(loop, name) is None and name not in gains}
    told = gains | {name: max(getattr(loop, name)) for name in ("kp", "kv") if getattr(loop, name) is not None}
    if chosen:
        usual = {"kp": VELOCITY_KP, "kv": 0.0} if drive == "velocity" else _suiting(machine, stand, rate, told, 1.0)
        gains |= {name: usual[name] for name in chosen}
    why = USUAL
    if drive == "torque":
        how = "beside the other gain" if any(told.values()) else f"corner at {SHARE:g} of the lowest mode"
        why = f"{SUITING}: {how}, damping ratio {DAMPING_RATIO:g} on a rigid base"
    sources |= dict.fromkeys(sorted(chosen), why)
    if loop.feedback == "pid" and "ki" not in loop.model_fields_set:
        sources["ki"] = "none is given, without which pid is pd"
    if "dead_time" not in loop.model_fields_set:
        sources["dead_time"] = "none is given"

    def spread(name: str, size: int) -> Vector:
        value = getattr(loop, name)
        return np.broadcast_to(gains[name] if value is None else value, size).astype(np.float64)

    found = LoopSettings(
        control=stand.control,
        feedback=loop.feedback,
        drive=drive,
        kp=spread("kp", rows),
        kv=spread("kv", rows),
        ki=spread("ki", rows),
        rate=rate,
        dead_time=loop.dead_time,
        filter_hz=loop.filter_hz,
        **{name: None if getattr(loop, name) is None else spread(name, len(machine.joints)) for name in OF_DRIVES},
        servo_gain=gain if drive == "velocity" else None,
        nullspace_damping=loop.nullspace_damping,
        joint_units=tuple(machine.joint_units),
        sources=sources,
    )
    return found if drive == "velocity" or len(chosen) < 2 else _stable(machine, found, stand, gravity=gravity)


def _stable(machine: AnyMachine, settings: LoopSettings, stand: Evaluation, *, gravity: bool) -> LoopSettings:
    """The settings with a corner that is halved until the loop is stable; as they are where it never is."""
    for halvings in range(HALVINGS + 1):
        gains = _suiting(machine, stand, settings.rate, {}, 0.5**halvings)
        tried = replace(settings, **{name: np.full(len(machine.task_rows), value) for name, value in gains.items()})
        if tried.outcome(machine, stand.base, stand.posture, gravity=gravity).loop.stable:
            note = f", halved {halvings} times until it is stable" if halvings else ""
            return replace(tried, sources={x: w + note if x in gains else w for x, w in settings.sources.items()})
    return settings


def _hardly_served(machine: AnyMachine, gain: float) -> str:
    """Joints that brake themselves more than the servo drives them, in words: the gain is one number for all."""
    own = build_plant(machine).parameter_values.full().ravel()[list(damping_entries(machine))]
    joints = zip(machine.joints, machine.joint_units, own.tolist(), strict=True)
    told = [
        f"{joint} brakes itself by {damping:.4g} {damping_unit((unit,))} and makes "
        f"{100 * gain / (gain + damping):.2g} % of the rate asked for"
        for joint, unit, damping in joints
        if damping > gain > 0
    ]
    return f"; {'; '.join(told)}: give servo_gain" if told else ""


def _why_drive(loop: Loop, drive: Drive) -> str:
    if drive == "velocity":
        return (
            "there is a servo gain"
            if loop.servo_gain is not None
            else "the machine names its drives' efforts and speeds"
        )
    if any(each is not None for each in (loop.kp, loop.kv, loop.kp_range, loop.kv_range)):
        return "gains without a drive are those of torques"
    if loop.control == "transpose":
        return "transpose control asks for torques"
    return "the machine does not name the efforts and speeds of its drives"


def _middle(allowed: tuple[float, float]) -> float:
    """The geometric mean of a range; half of one that starts at 0."""
    low, high = allowed
    return math.sqrt(low * high) if low > 0 else high / 2


def _suiting(
    machine: AnyMachine, stand: Evaluation, rate: float, given: Mapping[str, float], share: float
) -> dict[str, float]:
    """Gains of the arm's masses; beside one that is given, and not 0, the other of the same damping ratio."""
    found = rigid_gains(machine, stand, rate, share)
    if kp := given.get("kp"):
        found["kv"] *= math.sqrt(kp / found["kp"])
    elif kv := given.get("kv"):
        found["kp"] *= (kv / found["kv"]) ** 2
    return {name: found[name] for name in ("kp", "kv")}
