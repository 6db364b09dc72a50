"""Machine files to begin with: springs from a first frequency, a posture to look at first, and the planar file.

In: answers about a machine, as plain data. Out: the text of its file, the machine that is read from it, a posture.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from flexopt.errors import FlexoptError, InputError
from flexopt.foundation.arrays import Vector
from flexopt.foundation.control import CONTROLS, gain_units
from flexopt.foundation.escapes import one_line
from flexopt.foundation.rendering import render
from flexopt.loop.evaluation import settings_at
from flexopt.model import AnyMachine, machine_from_dict
from flexopt.model.loop import Loop
from flexopt.model.plausibility import SAG
from flexopt.plant import Plant, build_plant
from flexopt.plant.inverse_kinematics import low_discrepancy
from flexopt.plant.reach import arm_length, sampled_ranges
from flexopt.robustness.plausibility import modes_at

POSTURES = 256
# Of the ranges of the joints, for a posture to look at first.
INNER = (0.15, 0.85)
# Least over largest singular value of Jv below which no posture is regular.
REGULAR = 1e-3
# Points whose heights differ by less are level, m.
SAME_HEIGHT = 1e-9
DIGITS = 6
# Of springs that make 1 rad/s of each direction alone, Hz.
FREQUENCY_MAX = 1e4
# A value, with the number signs inside its texts, and the comment behind it; the column where that begins.
BEHIND = re.compile(r'((?:[^#"]|"(?:[^"\\]|\\.)*")+?)\s+# (.*)')
COMMENTS = 32
UPRIGHT = "1.5707963"
# Of the loop that files have as a comment, Hz and s.
RATE, DEAD_TIME = 100.0, 0.01
# Hz, of the swing of a machine of some metres; of its reach, how far a smaller one sinks on its springs at most.
USUAL, SINKS = 2.0, SAG / 2
PLANAR_UNITS = {"x": ("N/m", "N s/m"), "y": ("N/m", "N s/m"), "rotation": ("N m/rad", "N m s/rad")}


@dataclass(frozen=True)
class NewMachine:
    """The text of a machine file, the machine that it is, and a regular posture of it, rad or m.

    `held`: a sentence on what the machine leaves out of its robot file; empty without any.
    """

    text: str
    machine: AnyMachine
    posture: tuple[float, ...]
    held: str = ""


@dataclass(frozen=True)
class Springs:
    """Stiffness and damping of each direction, a regular posture, rad or m, and where the numbers come from."""

    stiffness: tuple[float, ...]
    damping: tuple[float, ...]
    posture: tuple[float, ...] = ()
    notes: tuple[str, str] = ("", "")


Build = Callable[[Springs], AnyMachine]
# The values of `templates/loop.toml`.
GainTexts = Mapping[str, str]


@dataclass(frozen=True)
class Ground:
    """What is known of the springs of a base: numbers, or frequency, Hz, and damping ratio of its swing, the arm held.

    `gives` names the directions; `stiffness` and `damping` are of each of them, None where they follow from the mode.
    `alone`: the machine has other springs, too, and frequency and ratio are of each direction with all else held.
    `proposed`: which of frequency and ratio nobody gave.
    """

    gives: tuple[str, ...]
    stiffness: tuple[float, ...] | None = None
    damping: tuple[float, ...] | None = None
    frequency: float = USUAL
    ratio: float = 0.02
    alone: bool = False
    proposed: tuple[str, ...] = ()

    def springs(self, build: Build) -> Springs:
        """What follows for the machine that `build` makes of springs.

        K = s diag(M_p), with which each direction alone has one frequency; with the arm held ω_1² is proportional to s.
        D = β K, which makes ζ_1 = β ω_1 / 2.
        """
        ones, nothing = (1.0,) * len(self.gives), (0.0,) * len(self.gives)
        machine = build(Springs(self.stiffness or ones, self.damping or nothing))
        posture, plant = regular_posture(machine), build_plant(machine)
        held = ", ".join(f"{x:g}" for x in posture)
        base, p, omega = np.zeros(plant.n_base), plant.parameter_values, math.tau * self.frequency
        mass: Vector = plant.mass(plant.rest(base, posture, p), base, p).full()
        names = plant.coordinates[: plant.n_passive]
        each = np.array([mass[k, k] for k in (names.index(f"base.{word}") for word in self.gives)])
        which = "each direction alone, all else held," if self.alone else "the machine, its arm held,"
        notes = ["", ""]

        def note(word: str, what: str) -> str:
            return f" ({'proposed: ' if word in self.proposed else ''}so that {which} {what} at posture {held})"

        def first(stiffness: tuple[float, ...]) -> float:
            return _first_mode(build_plant(build(Springs(stiffness, nothing))), posture)

        stiffness = self.stiffness
        if stiffness is None:
            scale = 1.0 if self.alone else (omega / first(tuple(each.tolist()))) ** 2
            stiffness = tuple(rounded(k) for k in each * (omega**2 if self.alone else scale))
            notes[0] = note("frequency", f"swings at {self.frequency:g} Hz")
        damping = self.damping
        if damping is None:
            notes[1] = note("ratio", f"has the damping ratio {self.ratio:g}")
            if self.alone:
                critical = (2 * math.sqrt(k * m) for k, m in zip(stiffness, each, strict=True))
            else:
                critical = (2 * k / first(stiffness) for k in stiffness)
            damping = tuple(rounded(self.ratio * d) for d in critical)
        return Springs(stiffness, damping, posture, (notes[0], notes[1]))


def usual_frequency(reach: float) -> float:
    """Of a swing that nobody has timed, Hz: the usual one, or of a machine of small `reach`, m, a higher one.

    A spring that swings slowly gives far under its load, by g/ω², however small the machine is that stands on it.
    """
    sinking = math.sqrt(9.81 / (SINKS * reach)) / math.tau if reach > 0 else 0.0
    return max(USUAL, math.ceil(10 * sinking) / 10)


def _first_mode(plant: Plant, posture: Sequence[float]) -> float:
    """Its frequency with the arm held, rad/s.

    Raises:
        InputError: there is none, for what gives carries nothing that the joints do not carry, too.
    """
    try:
        free, first = (float(modes_at(plant, np.array(posture), held=held)[0][0]) for held in (False, True))
    except np.linalg.LinAlgError:
        free = first = math.nan
    if not (0 < free < FREQUENCY_MAX and first > 0):
        raise InputError(
            "new: the base has no modes of its own in the directions in which it gives, as where joints move all that "
            "has mass in the same ways: give others, --gives, or actuate other joints, --actuated"
        )
    return math.tau * first


def gains_told(machine: AnyMachine, posture: Sequence[float]) -> GainTexts:
    """Gains that follow from the machine where a loop leaves them out, here of one that is stable, and their units.

    Without numbers where there is no such loop.
    """
    loop = Loop(drive="torque", rate=RATE, dead_time=DEAD_TIME)
    told = {"kp": "", "kv": "", "note": "", "rate": f"{RATE}", "dead_time": f"{DEAD_TIME}"}
    by_control = (gain_units(control, machine.joint_units) for control in CONTROLS)
    for name, unit, other in zip(("kp", "kv"), *by_control, strict=False):
        also = "" if other == unit else f'; {other}, another number, under "{CONTROLS[1]}"'
        told[f"{name}_unit"] = f'{unit} under control = "{CONTROLS[0]}", the default{also}'
    with suppress(FlexoptError, np.linalg.LinAlgError):
        at = np.array(posture)
        settings, base = settings_at(machine, at, None, None, loop, gravity=False, call="new")
        if settings.outcome(machine, base, at, gravity=False).loop.stable:
            told |= {name: number(float(getattr(settings, name)[0])) for name in ("kp", "kv")}
            told["note"] = f"suits the arm's masses at posture {', '.join(f'{x:g}' for x in posture)}"
    return told


def rounded(value: float) -> float:
    """To the digits that are written."""
    return float(f"{value:.{DIGITS}g}")


def quoted(text: str) -> str:
    """Text as TOML has it."""
    return json.dumps(one_line(text), ensure_ascii=False)


def number(value: float) -> str:
    """A number as TOML has it."""
    return f"{value:.{DIGITS}g}"


def aligned(text: str) -> str:
    """Comments behind values under each other."""
    return "\n".join(
        f"{found[1]:<{COMMENTS}} # {found[2]}" if (found := BEHIND.match(line)) else line for line in text.split("\n")
    )


def regular_posture(machine: AnyMachine) -> tuple[float, ...]:
    """Well inside the joint limits, above the ground where a sample has such, and there the best conditioned Jv.

    The ground is at 0, or as low as what the arm does not move.

    Raises:
        InputError: every one is singular.
    """
    plant = build_plant(machine)
    low, high = sampled_ranges(machine, arm_length(plant)).T
    share = INNER[0] + (INNER[1] - INNER[0]) * low_discrepancy(len(low), POSTURES, 0)
    middle: Vector = (low + high) / 2
    sample: list[Vector] = [middle, *(low[:, None] + (high - low)[:, None] * share).T]
    at = [_at_rest(plant, posture) for posture in sample]
    heights: Vector = np.array([points[-1] for points, _ in at])
    moved = np.ptp(heights, axis=0) > SAME_HEIGHT
    ground = float(heights[:, ~moved].min(initial=0.0))
    best, quality, stands = middle, 0.0, False
    for posture, (points, conditioned) in zip(sample, at, strict=True):
        free = bool((points[-1][moved] >= ground - SAME_HEIGHT).all())
        if conditioned < REGULAR or free < stands:
            continue
        if free > stands or conditioned > quality * 1.01:
            best, quality, stands = posture, conditioned, free
    if quality < REGULAR:
        rows = ", ".join(machine.task_rows)
        raise InputError(
            f"new: the actuated joints do not move the end-point in all of its rows ({rows}) in any posture"
        )
    # Two decimals, where the range is wide enough for them to stay inside; no minus zero.
    kept: Vector = np.where(high - low > 0.1, np.round(best, 2), best) + 0.0
    return tuple(kept.tolist())


def _at_rest(plant: Plant, posture: Vector) -> tuple[Vector, float]:
    """Where joints and end-point are, a column each, m, and least over largest singular value of Jv, 0 of no square."""
    base, p = np.zeros(plant.n_base), plant.parameter_values
    q = plant.rest(base, posture, p)
    points: Vector = cast(Any, plant.skeleton)(q, base, p).full()
    jacobian: Vector = cast(Any, plant.rigid_jacobian)(q, base, p).full()
    sizes = np.linalg.svd(jacobian, compute_uv=False)
    square = plant.n_task <= plant.n_actuated and sizes[0] > 0
    return points, float(sizes[-1] / sizes[0]) if square else 0.0


def planar_file(
    *,
    name: str,
    lengths: Sequence[float],
    masses: Sequence[float],
    inertias: Sequence[float] | None,
    limits: Sequence[tuple[float, float]] | None,
    base_length: float,
    base_mass: float,
    base_inertia: float | None,
    ground: Ground,
) -> NewMachine:
    """A planar machine: what is None is proposed, a link's inertia as that of a slender rod."""
    rods = [rounded(m * length**2 / 12) for m, length in zip(masses, lengths, strict=True)]
    body = rounded(base_mass * (lengths[0] / 4) ** 2)
    link_names = _link_names(len(lengths))
    links: list[dict[str, Any]] = [
        {
            "name": quoted(link_names[k]),
            "note": "the arm's first link and the joint that carries it" if k == 0 else "the next one",
            "length": number(length),
            "com": number(length / 2),
            "mass": number(masses[k]),
            "inertia": number((inertias or rods)[k]),
            "inertia_note": " (proposed: a slender rod)" if inertias is None else "",
            "limits": "" if limits is None else f"[{number(limits[k][0])}, {number(limits[k][1])}]",
        }
        for k, length in enumerate(lengths)
    ]
    base = {
        "length": number(base_length),
        "com": number(base_length / 2),
        "com_note": " (proposed: half its length)",
        "mass": number(base_mass),
        "inertia": number(base_inertia or body),
        "inertia_note": " (proposed: radius of gyration a quarter of the first link)" if base_inertia is None else "",
        "rest_angle": UPRIGHT,
    }

    def text(springs: Springs, gains: GainTexts | None = None) -> str:
        rows: dict[str, Any] = {
            word: [{"key": d, "value": number(x), "unit": PLANAR_UNITS[d][k]}
                   for d, x in zip(ground.gives, getattr(springs, word), strict=True)]
            for k, word in enumerate(("stiffness", "damping"))
        }  # fmt: skip
        told = {"stiffness_note": springs.notes[0], "damping_note": springs.notes[1]}
        values = {"title": one_line(name), "name": quoted(name), "base": base, "links": links, **rows, **told}
        values["gains"] = gains
        return aligned(render("study/templates/planar_machine.toml", **values))

    def build(springs: Springs) -> AnyMachine:
        return machine_from_dict(tomllib.loads(text(springs)), origin=name)

    found = ground.springs(build)
    machine = build(found)
    return NewMachine(text(found, gains_told(machine, found.posture)), machine, found.posture)


def _link_names(count: int) -> tuple[str, ...]:
    return ("boom", "stick", "bucket")[:count] if count <= 3 else tuple(f"link{k + 1}" for k in range(count))
