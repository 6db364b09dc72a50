"""The same rows with other numbers of the machine: at the corners of what is uncertain.

A row g(base, posture, p, c) that depends on a number known as an interval is kept as g(base, posture, p', c), too, with
every combination p' of the intervals' ends; where the machine sags, the arm is held on its target. What is linear in
each of these numbers by itself, or a quotient of such, as the moments and the centre of mass are in every mass, is
largest and least at corners; so is, to first order in the sag, what moves as the machine sags.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import casadi as ca
import numpy as np

from flexopt.errors import Fault
from flexopt.foundation.arrays import Vector
from flexopt.model import AnyMachine
from flexopt.model.uncertainty import LATE, Uncertainty, parameters_of, told_numbers, uncertainty_faults
from flexopt.plant import Plant, moving_end_point
from flexopt.selection.constraints.kind import Group, Scene

KIND = "corner"
# In the names of rows, before the numbers.
WHERE = " where "
# Intervals; every one doubles the rows.
MOST = 4


def within_faults(plant: Plant, within: Sequence[Uncertainty]) -> list[Fault]:
    """What does not go together, or not with the machine; fields are those of `Constraints`."""
    found = uncertainty_faults(within, plant.machine, "within")
    if len(within) > MOST:
        found.append(Fault("within", f"may have at most {MOST} entries", str(len(within))))
    for k, each in enumerate(within):
        if each.of == (LATE,):
            found.append(
                Fault(f"within[{k}].of", "is a number of the loop; constraints depend on the machine", each.name)
            )
        if names := moving_end_point(plant, parameters_of(each.of, plant.machine)):
            sentence = f"moves the end-point ({names}): postures would miss"
            found.append(Fault(f"within[{k}].of", sentence, each.name))
    return found


def corner_groups(
    plant: Plant,
    groups: Sequence[Group],
    within: Sequence[Uncertainty],
    dependence: Callable[[Group], list[tuple[int, int]]],
) -> list[Group]:
    """These groups' rows at every corner that is not the machine's own numbers, those of each corner together.

    So that the arm, which is held there, is found once for all of them.

    `dependence`: which rows of a group depend on which entries of p.
    """
    machine, found = plant.machine, dict[tuple[tuple[int, ...], tuple[float, ...]], list[Group]]()
    places = [parameters_of(each.of, machine) for each in within]
    for group in groups:
        on = dependence(group)
        moving = [i for i, entries in enumerate(places) if any(entry in entries for _, entry in on)]
        entries = sorted({entry for i in moving for entry in places[i]})
        kept = tuple(sorted({row for row, entry in on if entry in entries}))
        for ends in product((0, 1), repeat=len(moving)):
            p = _with_ends(machine, [within[i] for i in moving], ends)
            if where := told_numbers(machine, p.tolist()):
                corner = WHERE + where
                rows = tuple(replace(group.rows[k], name=group.rows[k].name + corner, corner=corner) for k in kept)
                at = tuple(entries), tuple(p[entries].tolist())
                found.setdefault(at, []).append(replace(group, shape=(group.shape, kept), rows=rows))
    return [
        Group(
            KIND,
            (entries, tuple(group.structure for group in at)),
            (*numbers, *(constant for group in at for constant in group.constants)),
            tuple(row for group in at for row in group.rows),
        )
        for (entries, numbers), at in found.items()
    ]


def kinds_of(structure: tuple[str, Any, int]) -> list[tuple[str, Any]]:
    """Kind and shape of what a group's structure consists of."""
    kind, shape, _ = structure
    return [(own, part) for own, (part, _), _ in shape[1]] if kind == KIND else [(kind, shape)]


def all_corners(machine: AnyMachine, within: Sequence[Uncertainty]) -> list[tuple[str, Vector]]:
    """The machine's numbers (n_par,) with every combination of the intervals' ends, and in words; its own left out."""
    found = [_with_ends(machine, within, ends) for ends in product((0, 1), repeat=len(within))]
    return [(where, p) for p in found if (where := told_numbers(machine, p.tolist()))]


def at_corner(scene: Scene, entries: Sequence[int], numbers: ca.SX) -> Scene:
    """The scene with these numbers in place of the entries of p."""
    p = ca.SX(scene.p)
    p[list(entries)] = numbers
    return scene.with_numbers(p)


def _with_ends(machine: AnyMachine, within: Sequence[Uncertainty], ends: Sequence[int]) -> Vector:
    """The machine's numbers (n_par,) with an end of each interval."""
    p = np.array([parameter.value for parameter in machine.parameters])
    for each, end in zip(within, ends, strict=True):
        at = list(parameters_of(each.of, machine))
        p[at] = p[at] * each.factor[end] if each.factor else (each.value or ())[end]
    return p
