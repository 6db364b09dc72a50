"""Joints within their limits, of an arm that is turned: held on its target with other numbers than the file's.

In the posture of the variables their own bounds keep joints there; `corners` has these rows with other numbers. Of a
margin the distance of a joint from each end that it has, else the joint's coordinate, rad or m.
"""

from __future__ import annotations

import math
from typing import Any

import casadi as ca

from flexopt.foundation.arrays import Vector
from flexopt.model.constraints import Constraints
from flexopt.plant import Plant
from flexopt.plant.reach import arm_length
from flexopt.selection.constraints.kind import ConstraintKind, Group, ScaledConstraint, Scene

# Before the name of a joint: of the distance that `constraints.joint_margin` keeps from its limits, and of these.
JOINT_MARGIN, LIMITS = "joint margin of ", "limits of "


def _no_groups(_: Plant, __: Constraints) -> list[Group]:
    """They are the bounds of variables."""
    return []


def joint_groups(plant: Plant, limits: Vector, margin: float | None) -> list[Group]:
    """The rows.

    Args:
        plant: of the machine.
        limits: what joints keep, (n, 2), the margin taken off;  margin: that was asked for, or None.
    """
    machine, length = plant.machine, arm_length(plant)
    shape, constants, rows = list[tuple[int, int]](), list[float](), list[ScaledConstraint]()
    for k, (name, unit, (low, high)) in enumerate(
        zip(machine.joints, machine.joint_units, limits.tolist(), strict=True)
    ):
        scale = 1.0 if unit == "rad" else length
        if margin is None and (math.isfinite(low) or math.isfinite(high)):
            shape.append((k, 0))
            rows.append(ScaledConstraint(LIMITS + name, unit, low, high, scale))
        for sign, end in () if margin is None else ((1, low - margin), (-1, high + margin)):
            if math.isfinite(end):
                shape.append((k, sign))
                constants.append(end)
                rows.append(ScaledConstraint(JOINT_MARGIN + name, unit, margin or 0.0, math.inf, scale))
    return [Group("joint_limits", tuple(shape), tuple(constants), tuple(rows))] if rows else []


def _graph(scene: Scene, shape: Any, c: ca.SX) -> list[ca.SX]:
    ends = iter(ca.vertsplit(c)) if c.numel() else iter(())
    return [sign * (scene.posture[k] - next(ends)) if sign else scene.posture[k] for k, sign in shape]


KIND = ConstraintKind(_no_groups, _graph)
