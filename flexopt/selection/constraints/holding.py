"""Holding the machine's own weight, by every actuated joint that has an effort or a cylinder with a force.

A joint with an effort holds |g_a(q)| ≤ share · effort, N m or N. Where a cylinder with a `force` drives it, the row is
that cylinder's force F = g_a(q)/(dL/dq), −share · pull ≤ F ≤ share · push, N: what the joint can hold follows the
cylinder's lever arm.
"""

from __future__ import annotations

import math
from typing import Any

import casadi as ca

from flexopt.errors import Fault
from flexopt.model import AnyMachine
from flexopt.model.constraints import Constraints
from flexopt.plant import Plant, build_hydraulics
from flexopt.selection.constraints.kind import ConstraintKind, Group, ScaledConstraint, Scene

EFFORT_UNIT = {"rad": "N m", "m": "N"}


def _faults(plant: Plant, constraints: Constraints) -> list[Fault]:
    if constraints.holding is None or _held(plant.machine):
        return []
    sentence = (
        f"needs the joints' efforts, and {plant.machine.name} has none: add effort (N m or N) to the actuated joints "
        f"({', '.join(plant.machine.joints)}) of the machine file, or force (N) to their cylinders"
    )
    return [Fault("holding", sentence, f"{constraints.holding:g}")]


def without_effort(machine: AnyMachine) -> tuple[str, ...]:
    """Actuated joints without a row: the file does not say what they can hold."""
    held = _held(machine)
    return tuple(name for k, name in enumerate(machine.joints) if k not in held)


def _held(machine: AnyMachine) -> dict[int, int | None]:
    """Joints with a row, and of each the cylinder whose force it is, if any."""
    held: dict[int, int | None] = {k: None for k, effort in enumerate(machine.efforts) if math.isfinite(effort)}
    driven = {machine.joints.index(c.joint): i for i, c in enumerate(machine.cylinders) if c.force is not None}
    return dict(sorted((held | driven).items()))


def _groups(plant: Plant, constraints: Constraints) -> list[Group]:
    if constraints.holding is None:
        return []
    machine, share = plant.machine, constraints.holding
    held, rows = _held(machine), list[ScaledConstraint]()
    for k, i in held.items():
        force = None if i is None else machine.cylinders[i].force
        pull, push = force or (machine.efforts[k],) * 2
        unit = EFFORT_UNIT[machine.joint_units[k]] if force is None else "N"
        label = f"holding of {machine.joints[k]}" + ("" if i is None else f" by {machine.cylinders[i].name}")
        rows.append(ScaledConstraint(label, unit, -share * pull, share * push, max(pull, push)))
    return [Group("holding", tuple(held.items()), (), tuple(rows))]


def _graph(scene: Scene, shape: Any, _: ca.SX) -> list[ca.SX]:
    weight = scene.plant.gravity(scene.q, scene.base, scene.p)[scene.plant.n_passive :]
    forces = build_hydraulics(scene.plant.machine).forces(scene.posture, weight, scene.p)
    return [weight[k] if i is None else forces[i] for k, i in shape]


KIND = ConstraintKind(_groups, _graph, _faults)
