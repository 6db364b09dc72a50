"""Least manipulability: w = sqrt(det(Jv Jvᵀ)) ≥ value (Yoshikawa, Manipulability of robotic mechanisms, 1985).

The row is w²/value, which has w's unit and its bound and, unlike w, derivatives where Jv loses rank; w is reported.
"""

from __future__ import annotations

import math
from typing import Any

import casadi as ca

from flexopt.algebra import determinant
from flexopt.model.constraints import Constraints
from flexopt.plant import Plant
from flexopt.selection.constraints.kind import ConstraintKind, Group, ScaledConstraint, Scene


def _groups(plant: Plant, constraints: Constraints) -> list[Group]:
    value = constraints.manipulability
    if value is None:
        return []
    # Columns of hinges are in m; those of slides have no unit, and the product of both has none worth a name.
    unit = f"m^{plant.n_task}" if all(unit == "rad" for unit in plant.machine.joint_units) else ""
    row = ScaledConstraint("manipulability", unit, value, math.inf, value)
    return [Group("manipulability", None, (value,), (row,))]


def _graph(scene: Scene, _: Any, c: ca.SX) -> list[ca.SX]:
    return [_squared(scene) / c[0]]


def _report(scene: Scene, _: Any, __: ca.SX) -> list[ca.SX]:
    return [ca.sqrt(ca.fmax(_squared(scene), 0.0))]


def _squared(scene: Scene) -> ca.SX:
    return squared_manipulability(scene.plant.rigid_jacobian(scene.q, scene.base, scene.p))


def squared_manipulability(jacobian: ca.SX) -> ca.SX:
    """det(Jv Jvᵀ), for a square Jv as det(Jv)², whose rounding grows with cond Jv and not with its square."""
    rows, columns = jacobian.shape
    return determinant(jacobian) ** 2 if rows == columns else determinant(jacobian @ jacobian.T)


KIND = ConstraintKind(_groups, _graph, report=_report)
