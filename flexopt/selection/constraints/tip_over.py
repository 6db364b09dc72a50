"""Static stability: the centre of mass, seen from above, keeps a margin inside the support polygon.

A row for each edge (in the plane: each end): the distance of the whole machine's centre of mass, payload included, from
the edge's line, in the anchor frame; the least of them is the static stability margin (McGhee and Frank, On the
stability properties of quadruped creeping gaits, 1968).
"""

from __future__ import annotations

import math
from typing import Any

import casadi as ca

from flexopt.errors import Fault
from flexopt.model.constraints import Constraints
from flexopt.plant import Plant
from flexopt.selection.constraints.kind import ConstraintKind, Group, ScaledConstraint, Scene, lacks_support


def _faults(plant: Plant, constraints: Constraints) -> list[Fault]:
    if constraints.tip_over_margin is None or plant.machine.support_points:
        return []
    return [Fault("tip_over_margin", lacks_support(plant), f"{constraints.tip_over_margin:g}")]


def _groups(plant: Plant, constraints: Constraints) -> list[Group]:
    if constraints.tip_over_margin is None:
        return []
    points = plant.machine.support_points
    lines: list[tuple[float, ...]] = []  # inward normal and its product with a point of the edge
    names: list[str] = []
    if plant.frames.dimension == 2:
        (rear,), (front,) = points
        lines = [(1.0, rear), (-1.0, -front)]
        names = [f"tip-over margin from x = {x:g}" for x in (rear, front)]
    else:
        for (x, y), (u, v) in zip(points, [*points[1:], points[0]], strict=True):
            length = math.hypot(u - x, v - y)
            n = ((y - v) / length, (u - x) / length)
            lines.append((*n, n[0] * x + n[1] * y))
            names.append(f"tip-over margin from edge ({x:g}, {y:g})–({u:g}, {v:g})")
    rows = tuple(ScaledConstraint(name, "m", constraints.tip_over_margin, math.inf) for name in names)
    return [Group("tip_over_margin", None, tuple(number for line in lines for number in line), rows)]


def _graph(scene: Scene, _: Any, c: ca.SX) -> list[ca.SX]:
    centre = scene.from_anchor(scene.plant.centre_of_mass(scene.q, scene.base, scene.p))
    lines = ca.reshape(c, scene.dimension, -1)
    return [ca.dot(lines[:-1, k], centre) - lines[-1, k] for k in range(lines.shape[1])]


KIND = ConstraintKind(_groups, _graph, _faults)
