"""Clearance of the machine's capsules from each other.

For each pair of capsules whose bodies an actuated joint moves against each other, neighbours aside (those share the
joint between them), the distance of their surfaces, m, exact; where the axes of two capsules meet minus both radii (in
the plane less the depth). It counts as two rows, which are where they lie beside each other; with a ball as one. Pairs
that overlap in every posture, as hulls across a shoulder may, have no row: no posture could keep them apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, cast

import casadi as ca
import numpy as np

from flexopt.errors import Fault
from flexopt.foundation.kept import by_machine
from flexopt.model import AnyMachine
from flexopt.model.constraints import Constraints
from flexopt.model.tables import Capsule
from flexopt.plant import Plant, build_plant
from flexopt.plant.inverse_kinematics import low_discrepancy
from flexopt.plant.reach import arm_length, sampled_ranges
from flexopt.selection.constraints.clearance import (
    axis_ends,
    axis_length,
    capsule_names,
    is_ball,
    without_volumes,
)
from flexopt.selection.constraints.kind import ConstraintKind, Group, ScaledConstraint, Scene
from flexopt.selection.constraints.segment_distance import from_segment, rows_from_segment

Pairs = tuple[tuple[int, int], ...]
# Postures in which a pair must overlap to have no row.
LOOKED = 512


@by_machine
def meeting_pairs(machine: AnyMachine) -> Pairs:
    """Numbers of capsules that a choice of posture may bring together."""
    bodies = {body.name: body for body in machine.kinematic_tree.bodies}
    filled = {capsule.body for capsule in machine.capsules}

    def upwards(name: str | None) -> list[str]:
        """The body and those that carry it, outwards in."""
        found: list[str] = []
        while name is not None:
            found.append(name)
            name = bodies[name].parent
        return found

    def carrier(name: str) -> str | None:
        """The next body inwards that is more than a part of a joint."""
        above = upwards(name)[1:]
        return next((other for other in above if other in filled or not bodies[other].massless), None)

    def meet(one: str, other: str) -> bool:
        if carrier(one) == other or carrier(other) == one:
            return False
        between = set(upwards(one)) ^ set(upwards(other))
        return any(not bodies[name].joint.passive for name in between)

    names = [capsule.body for capsule in machine.capsules]
    return tuple((i, j) for j in range(len(names)) for i in range(j) if meet(names[i], names[j]))


@by_machine
def overlapping_pairs(machine: AnyMachine) -> Pairs:
    """Those of `meeting_pairs` that overlap in each of `LOOKED` postures, spread evenly over the limits."""
    pairs = meeting_pairs(machine)
    if not pairs:
        return ()
    plant = build_plant(machine)
    g = plant.graph
    rows = ca.vertcat(*(row for (row,) in _rows(Scene(plant, g.base, g.posture, g.p), pairs, _distance)))
    distances = ca.Function("distances", [g.base, g.posture, g.p], [rows], ["base", "posture", "p"], ["distances"])
    low, high = sampled_ranges(machine, arm_length(plant)).T
    postures = low[:, None] + (high - low)[:, None] * low_discrepancy(plant.n_actuated, LOOKED, 0)
    p = np.repeat(plant.parameter_values.full(), LOOKED, axis=1)
    found = distances.call([np.zeros((plant.n_base, LOOKED)), postures, p])[0].full()
    return tuple(pair for pair, most in zip(pairs, found.max(axis=1).tolist(), strict=True) if most < 0)


def _kept_apart(machine: AnyMachine) -> Pairs:
    without = overlapping_pairs(machine)
    return tuple(pair for pair in meeting_pairs(machine) if pair not in without)


def overlapping_told(machine: AnyMachine) -> str:
    """Names of the pairs that overlap in every posture; empty where none does."""
    names = capsule_names(machine.capsules)
    return ", ".join(f"{names[j]} from {names[i]}" for i, j in overlapping_pairs(machine))


def _faults(plant: Plant, constraints: Constraints) -> list[Fault]:
    if constraints.self_clearance is None:
        return []
    if not plant.machine.capsules:
        return [without_volumes(plant, "self_clearance")]
    if not _kept_apart(plant.machine):
        without, filled = overlapping_told(plant.machine), ", ".join(_filled(plant.machine))
        without = f" ({without} overlap in every posture)" if without else ""
        sentence = (
            "needs two bodies with capsules that an actuated joint moves against each other and that are no "
            f"neighbours, and {plant.machine.name} has none: its capsules are of {filled}{without}"
        )
        return [Fault("self_clearance", sentence, f"{constraints.self_clearance:g}")]
    return []


def _filled(machine: AnyMachine) -> list[str]:
    return list(dict.fromkeys(capsule.called for capsule in machine.capsules))


def _groups(plant: Plant, constraints: Constraints) -> list[Group]:
    least = constraints.self_clearance
    if least is None:
        return []
    names, pairs = capsule_names(plant.machine.capsules), _kept_apart(plant.machine)
    labels = [f"self-clearance of {names[j]} from {names[i]}" for i, j in pairs]
    rows = tuple(
        ScaledConstraint(label, "m", least, math.inf)
        for label, pair in zip(labels, pairs, strict=True)
        for _ in range(_count(plant.machine.capsules, pair))
    )
    return [Group("self_clearance", pairs, (), rows)]


def _count(capsules: tuple[Capsule, ...], pair: tuple[int, int]) -> int:
    """How many rows a pair has."""
    return 1 if any(is_ball(capsules[k]) for k in pair) else 2


def _graph(scene: Scene, shape: Any, _: ca.SX) -> list[ca.SX]:
    return [row for rows in _rows(scene, shape, rows_from_segment) for row in rows]


def _report(scene: Scene, shape: Any, _: ca.SX) -> list[ca.SX]:
    capsules, pairs = scene.plant.machine.capsules, cast(Pairs, shape)
    distances = zip(_rows(scene, shape, _distance), pairs, strict=True)
    return [distance for (distance,), pair in distances for _ in range(_count(capsules, pair))]


def _distance(*segments: Any) -> list[ca.SX]:
    return [from_segment(*segments)]


def _rows(scene: Scene, shape: Any, of_pair: Callable[..., list[ca.SX]]) -> list[list[ca.SX]]:
    """Of each pair."""
    capsules = scene.plant.machine.capsules
    ends = [axis_ends(scene, capsule) for capsule in capsules]
    lengths, radii = [axis_length(capsule) for capsule in capsules], [capsule.radius for capsule in capsules]
    return [
        [row - radii[i] - radii[j] for row in of_pair(ends[i], lengths[i], ends[j], lengths[j])]
        for i, j in cast(Pairs, shape)
    ]


KIND = ConstraintKind(_groups, _graph, _faults, report=_report)
