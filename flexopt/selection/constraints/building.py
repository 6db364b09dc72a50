"""Every kind of constraint, and the rows of all that a problem asks for in one Function."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import casadi as ca

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arrays import Vector
from flexopt.foundation.kept import by_structure
from flexopt.model import AnyMachine
from flexopt.model.constraints import Constraints
from flexopt.model.uncertainty import parameters_of
from flexopt.plant import Plant, build_plant
from flexopt.selection.constraints import (
    areas,
    clearance,
    corners,
    ground,
    holding,
    joint_limits,
    manipulability,
    self_clearance,
    tip_over,
    tool_angle,
)
from flexopt.selection.constraints.kind import ConstraintKind, Group, ScaledConstraint, Scene

# A further kind is a module with a `ConstraintKind`, a field of `Constraints`, and a line here; rows are in this order.
KINDS: dict[str, ConstraintKind] = {
    "manipulability": manipulability.KIND,
    "region": areas.REGION,
    "keep_out": areas.KEEP_OUT,
    "clearance": clearance.KIND,
    "self_clearance": self_clearance.KIND,
    "ground": ground.KIND,
    "tip_over_margin": tip_over.KIND,
    "holding": holding.KIND,
    "tool_angle": tool_angle.KIND,
    "joint_limits": joint_limits.KIND,
}
# In a structure: the machine sags.
WEIGHT = "weight"
# Kinds that are the same wherever the machine stands; a clearance is where it is from the ground.
EVERYWHERE = (
    WEIGHT,
    "manipulability",
    "self_clearance",
    "ground",
    "tip_over_margin",
    "holding",
    "tool_angle",
    "joint_limits",
)
Structure = tuple[tuple[str, Any, int], ...]


@dataclass(frozen=True, eq=False)
class ConstraintSet:
    """Rows lower ≤ g(base, posture, p, c) ≤ upper, (k,), the machine standing still: under gravity as it then sags.

    Attributes:
        rows: what each is called, and its unit, bounds and scale.
        constants: the numbers c of the problem, such as places of obstacles.
        function: base, posture, p, c -> g (k,), in a form that suits a solver.
        report: base, posture, p, c -> value (k,): the same rows as quantities with the same units and bounds.
        structure: what decides `function` besides the machine; sets with equal ones have the same two Functions.
    """

    rows: tuple[ScaledConstraint, ...]
    constants: ca.DM
    function: ca.Function = field(repr=False)
    report: ca.Function = field(repr=False)
    structure: Structure = field(repr=False)

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def placed(self) -> bool:
        """Whether places in the inertial frame enter other than heights."""
        parts = [part for group in self.structure for part in corners.kinds_of(group)]
        return any(
            kind not in EVERYWHERE and not (kind == "clearance" and shape[0] == "ground") for kind, shape in parts
        )


def constraint_faults(
    plant: Plant, constraints: Constraints, *, gravity: bool = False, limits: Vector | None = None
) -> list[Fault]:
    """What stands in the way of these constraints for a machine; fields are those of `Constraints`.

    `gravity`, `limits`: as of `build_constraints`.
    """
    found = [fault for kind in KINDS.values() for fault in kind.faults(plant, constraints)]
    within = constraints.within or ()
    wrong = corners.within_faults(plant, within)
    if within and not found and not wrong:
        groups = [*_asked(plant, constraints), *_of_joints(plant, constraints, limits)]
        on = {entry for group in groups for _, entry in _dependence(plant, group, gravity=gravity)}
        # That it stands, and is held on its target.
        on |= {*ca.jacobian_sparsity(plant.held_rows, plant.graph.p).get_triplet()[1]} if gravity else set()
        sentence = (
            "no constraint of flexopt's that was asked for depends on it; holding and tip_over_margin do on masses, "
            "under gravity all but region and keep_out, and the hold of the target, on masses and springs"
        )
        sentence += "; constraints of your own are kept with the file's numbers" if constraints.own else ""
        wrong += [
            Fault(f"within[{k}].of", sentence, each.name)
            for k, each in enumerate(within)
            if not on & set(parameters_of(each.of, plant.machine))
        ]
    return found + wrong


def constraint_labels(plant: Plant, constraints: Constraints) -> list[str]:
    """What the rows of constraints without faults are called."""
    return [row.name for group in _groups(plant, constraints) for row in group.rows]


def _asked(plant: Plant, constraints: Constraints) -> list[Group]:
    """With the machine's own numbers."""
    return [group for kind in KINDS.values() for group in kind.groups(plant, constraints)]


def _of_joints(plant: Plant, constraints: Constraints, limits: Vector | None) -> list[Group]:
    """Of the limits that joints keep, for corners alone."""
    return [] if limits is None else joint_limits.joint_groups(plant, limits, constraints.joint_margin)


def _groups(
    plant: Plant,
    constraints: Constraints,
    assumed_ground: float | None = None,
    *,
    gravity: bool = False,
    limits: Vector | None = None,
) -> list[Group]:
    """All of constraints without faults."""
    groups = _asked(plant, constraints)
    if assumed_ground is not None:
        groups += ground.ground_groups(plant, assumed_ground)
    within = constraints.within or ()
    others = [*groups, *_of_joints(plant, constraints, limits)]
    return groups + corners.corner_groups(plant, others, within, partial(_dependence, plant, gravity=gravity))


def _dependence(plant: Plant, group: Group, *, gravity: bool = False) -> list[tuple[int, int]]:
    """Which rows of a group depend on which entries of p: where the machine sags, with the arm held as at corners."""
    g, (name, shape, count) = plant.graph, group.structure
    other = ca.SX.sym("p", g.p.shape)
    scene = Scene(plant, g.base, g.posture, g.p, gravity).with_numbers(other)
    rows, _ = _made(scene, name, shape, ca.SX.sym("c", count))
    return list(zip(*ca.jacobian_sparsity(ca.vertcat(ca.SX(0, 1), *rows), other).get_triplet(), strict=True))


def build_constraints(
    plant: Plant,
    constraints: Constraints,
    assumed_ground: float | None = None,
    *,
    gravity: bool = False,
    limits: Vector | None = None,
) -> ConstraintSet:
    """The rows that a configuration of this machine must keep.

    `joint_margin` and `travel` give no rows with the file's numbers: they belong to bounds and objective.

    Args:
        plant: of the machine.
        constraints: from `flexopt.model.constraints.read_constraints`.
        assumed_ground: its height, m; see `flexopt.selection.assumed`.
        gravity: whether the machine sags under its weight.
        limits: what joints keep, (n, 2), the margin taken off: where an arm is held with other numbers, too.

    Raises:
        InputError: the machine lacks what a kind needs, or bodies and coordinates do not suit it; lists every fault.
    """
    raise_if_any(InputError, "constraints", constraint_faults(plant, constraints, gravity=gravity, limits=limits))
    groups = _groups(plant, constraints, assumed_ground, gravity=gravity, limits=limits)
    rows = tuple(row for group in groups for row in group.rows)
    structure = tuple(group.structure for group in groups)
    function, report = _functions(plant.machine, structure, gravity)
    assert function.size1_out(0) == len(rows)
    return ConstraintSet(
        rows=rows,
        constants=ca.DM([number for group in groups for number in group.constants]),
        function=function,
        report=report,
        structure=structure + ((WEIGHT, None, 0),) * gravity,
    )


def without_corners(machine: AnyMachine, constraints: ConstraintSet) -> ConstraintSet:
    """The rows with the machine's own numbers alone, which come before those at corners."""
    structure = tuple(group for group in constraints.structure if group[0] not in {corners.KIND, WEIGHT})
    weight = tuple(group for group in constraints.structure if group[0] == WEIGHT)
    function, report = _functions(machine, structure, bool(weight))
    return ConstraintSet(
        rows=tuple(row for row in constraints.rows if not row.corner),
        constants=constraints.constants[: sum(count for _, _, count in structure)],
        function=function,
        report=report,
        structure=structure + weight,
    )


@by_structure
def _functions(machine: AnyMachine, structure: Structure, gravity: bool) -> tuple[ca.Function, ca.Function]:
    """The rows as a solver sees them, and as people do."""
    plant = build_plant(machine)
    g = plant.graph
    c = ca.SX.sym("c", sum(count for _, _, count in structure))
    scene = Scene(plant, g.base, g.posture, g.p, gravity)
    rows: list[ca.SX] = []
    reported: list[ca.SX] = []
    start = 0
    for name, shape, count in structure:
        made, told = _made(scene, name, shape, c[start : start + count])
        rows += made
        reported += told
        start += count
    # What is called a few times for people is not worth the search for equal parts.
    report = _function("constraint_values", scene, c, reported, "value", cse=False)
    return _function("constraints", scene, c, rows, "g", cse=True), report


def _made(scene: Scene, name: str, shape: Any, numbers: ca.SX) -> tuple[list[ca.SX], list[ca.SX]]:
    """The rows of a group as a solver sees them, and as people do."""
    if name == corners.KIND:
        entries, parts = shape
        start, found = len(entries), (list[ca.SX](), list[ca.SX]())
        other = corners.at_corner(scene, entries, numbers[:start])
        for kind, (own, kept), count in parts:
            made = _made(other, kind, own, numbers[start : start + count])
            for all_rows, rows in zip(found, made, strict=True):
                all_rows += [rows[k] for k in kept]
            start += count
        return found
    kind = KINDS[name]
    rows = kind.graph(scene, shape, numbers)
    return rows, rows if kind.report is None else kind.report(scene, shape, numbers)


def _function(name: str, scene: Scene, c: ca.SX, rows: list[ca.SX], output: str, *, cse: bool) -> ca.Function:
    inputs, names = [scene.base, scene.posture, scene.p, c], ["base", "posture", "p", "c"]
    stacked = ca.densify(ca.vertcat(*rows)) if rows else ca.SX(0, 1)
    return ca.Function(name, inputs, [stacked], names, [output], {"cse": cse})
