"""What a selection assumes where nobody asks for anything: the ground, the file's joint limits, how far to drive.

Three words (`SelectionOptions.assume`), each named in the result with its number:

- `ground`, where `constraints.clearance` names none: what joints raise and lower stays above the ground on which the
  machine stands. Its height is 0, that of the anchor frame, where the machine has a support or is placed by x and y;
  without a support it is as low as the volumes of what stands still. Elsewhere (an arm on a rail, say) it is not known.
  Bodies from the end-point's on work where the target is, and targets below ground are dug for: neither is bound.
- `limits`: joints keep the limits of the machine's file; `constraints.joint_margin` asks for them by itself.
- `reach`, where `base_range` does not bound a placement coordinate and the present placement is known: it changes by no
  more than the arm reaches, or than the way to the target where that is farther. A machine on the ground of which no
  present placement is given stands at zeros.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.model import AnyMachine
from flexopt.model.choices import assumes
from flexopt.model.constraints import Clearance, Constraints
from flexopt.plant import Plant
from flexopt.plant.reach import outer_reach
from flexopt.selection.constraints.ground import kept_above, lowest, standing_height
from flexopt.selection.constraints.holding import without_effort
from flexopt.selection.constraints.self_clearance import meeting_pairs, overlapping_pairs, overlapping_told

# A capsule that is below the ground by more than this, m, is by no rounding.
SUNK = 0.01
# What is in nobody's way.
ALWAYS = ("limits", "clearance", "holding", "self_clearance", "capsules")


@dataclass(frozen=True)
class Assumption:
    """One of `flexopt.model.choices.ASSUMPTIONS` that was made; or what no word switches off.

    That is `holding` of joints without an effort, where it is asked for; and of bodies in each other's way: `clearance`
    of some without a volume, or that stand on the ground, where it is asked for, `capsules` of all without one,
    `self_clearance` where nobody asks for it, or of pairs that overlap in every posture.

    Attributes:
        name: the word that switches it;  sentence: what was assumed.
        value: its number, in `unit`: the ground's height, m; how many joints keep limits, or are not held; how far to
            drive, m; how many bodies, or pairs of capsules.
    """

    name: str
    sentence: str
    value: float
    unit: str

    def __str__(self) -> str:
        return f"assumed ({self.name}): {self.sentence}"


class Assumed(NamedTuple):
    """What a selection assumes: height of the ground, m; how far to drive, m; and the names of all."""

    ground: float | None
    drive: float | None
    named: tuple[Assumption, ...]


def in_the_way(named: tuple[Assumption, ...]) -> str:
    """What a message on a choice that was not found ends with: what may be in the way and nobody asked for."""
    listed = "; ".join(str(assumption) for assumption in named if assumption.name not in ALWAYS)
    return f"; {listed}: `assume` leaves it out" if listed else ""


def assumed(
    plant: Plant,
    assume: str,
    targets: Vector,
    constraints: Constraints,
    present: Vector | None,
    bounded: frozenset[str],
    *,
    given: bool,
) -> Assumed:
    """What holds where nothing else is asked for.

    Args:
        plant: of the machine.
        assume: the word, see `flexopt.model.choices.check_assume`.
        targets: all that are reached by one choice, (K, n_task), m.
        constraints: that were asked for.
        present: placement (n_b,), m or rad, if it is known, see `standing`.
        bounded: placement coordinates with a range of their own.
        given: whether the present placement was.
    """
    machine, named = plant.machine, list[Assumption]()
    ground = _ground(plant, targets) if assumes(assume, "ground") and not _has_ground(constraints) else None
    above = "" if ground is None else kept_above(plant)
    if ground is not None and above:
        lowered = "" if ground >= 0 else ", as low as what stands still reaches, for there is no [support]"
        sentence = f"{above} the ground, whose height is {ground:g} m{lowered}"
        named.append(Assumption("ground", sentence, ground, "m"))
    limited = sum(bool(np.isfinite(ends).any()) for ends in machine.limits)
    # A margin of the joints asks for their limits by itself.
    if assumes(assume, "limits") and limited and constraints.joint_margin is None:
        sentence = f"{limited} of {len(machine.joints)} joints keep the limits of the machine's file"
        named.append(Assumption("limits", sentence, float(limited), "joints"))
    free = [name for name in machine.base_coordinates if name != "yaw" and name not in bounded]
    drive = None
    if assumes(assume, "reach") and present is not None and free:
        drive = _drive(plant, targets, present)
        sentence = (
            f"the base moves by no more than {drive:.4g} m along {' or '.join(free)} from "
            f"{'where it stands' if given else 'zeros'}: as far as the arm reaches, or the target lies"
        )
        named.append(Assumption("reach", sentence, drive, "m"))
    named += left_out(machine, constraints)
    if not machine.capsules:
        bodies = sum(not body.massless for body in machine.kinematic_tree.bodies)
        sentence = "bodies may pass through each other, for the machine has no [[capsules]]"
        named.append(Assumption("capsules", sentence, float(bodies), "bodies"))
    elif constraints.self_clearance is None and (pairs := meeting_pairs(machine)):
        sentence = "bodies may pass through each other, for constraints.self_clearance is not given"
        named.append(Assumption("self_clearance", sentence, float(len(pairs)), "pairs of capsules"))
    elif constraints.self_clearance is not None and (without := overlapping_told(machine)):
        sentence = f"not kept apart, for they overlap in every posture: {without}"
        named.append(
            Assumption("self_clearance", sentence, float(len(overlapping_pairs(machine))), "pairs of capsules")
        )
    return Assumed(ground if above else None, drive, tuple(named))


def left_out(machine: AnyMachine, constraints: Constraints) -> Iterator[Assumption]:
    """What is asked for and the machine's file says too little of: of these bodies and joints nothing is kept."""
    if constraints.clearance is not None and constraints.clearance.bodies is None:
        filled = {capsule.body for capsule in machine.capsules}
        bare = [body.name for body in machine.kinematic_tree.bodies if not body.massless and body.name not in filled]
        if bare and filled:
            sentence = f"kept clear is what has [[capsules]] alone, so nothing of {', '.join(bare)}"
            yield Assumption("clearance", sentence, float(len(bare)), "bodies")
    near = {} if constraints.clearance is None else _near_ground(machine, constraints.clearance)
    if near:
        told = ", ".join(f"{name} ({height:+.3g} m)" for name, height in near.items())
        sentence = f"what no joint moves stands on the ground and keeps no distance from it, so not {told}"
        yield Assumption("clearance", sentence, float(len(near)), "bodies")
    free = without_effort(machine)
    if constraints.holding is not None and 0 < len(free) < len(machine.joints):
        sentence = f"held is what has an effort, or a cylinder with a force, alone, so not {', '.join(free)}"
        yield Assumption("holding", sentence, float(len(free)), "joints")


def _near_ground(machine: AnyMachine, asked: Clearance) -> dict[str, float]:
    """How high above the ground asked for stands what nobody expects there: below it, or named to keep clear, m."""
    if asked.ground is None:
        return {}
    found = dict[str, float]()
    for capsule, low in lowest(machine):
        above, named = low - asked.ground, not {capsule.called, capsule.body}.isdisjoint(asked.bodies or ())
        if above < (asked.distance if named else -SUNK):
            found[capsule.called] = min(above, found.get(capsule.called, math.inf))
    return found


def standing(plant: Plant, given: Vector | None) -> Vector | None:
    """The present placement (n_b,): as given, or zeros of a machine that stands on the ground."""
    return np.zeros(plant.n_base) if given is None and _on_ground(plant) else given


def _on_ground(plant: Plant) -> bool:
    machine = plant.machine
    return bool(machine.support_points) or {"x", "y"} <= set(machine.base_coordinates)


def _has_ground(constraints: Constraints) -> bool:
    return constraints.clearance is not None and constraints.clearance.ground is not None


def _ground(plant: Plant, targets: Vector) -> float | None:
    """The height of the ground, m; None where it is not known, or a target lies below."""
    machine = plant.machine
    if not _on_ground(plant):
        return None
    ground = standing_height(machine)
    up = machine.kinematic_tree.axes[-1]
    heights = targets[:, machine.task_rows.index(up)] if up in machine.task_rows else np.array([math.inf])
    return None if heights.min() < ground else ground


def _drive(plant: Plant, targets: Vector, present: Vector) -> float:
    """The arm's reach, or the way from the present placement to the farthest target, m."""
    rows, names = plant.machine.task_rows, plant.machine.base_coordinates
    center, outer = outer_reach(plant)
    away = [
        np.abs(targets[:, rows.index(name)] - present[names.index(name)]) for name in ("x", "y")
        if name in rows and name in names
    ]  # fmt: skip
    far = outer + math.hypot(*center[: 1 if plant.closed_form else 2])
    return max([far, *(float(a.max()) for a in away)])
