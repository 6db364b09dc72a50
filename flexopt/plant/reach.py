"""How far the arm reaches, which placements bring a target within reach, and what to say when none was found."""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np

from flexopt.errors import UnreachableTarget
from flexopt.foundation.arrays import Interval, Vector
from flexopt.foundation.kept import by_structure
from flexopt.foundation.rounding import without_rounding
from flexopt.model import AnyMachine
from flexopt.plant.plant import Plant, build_plant
from flexopt.plant.tree_task import points


@dataclass(frozen=True)
class Reach:
    """The annulus about the first actuated joint that the end-point can reach, passive coordinates at rest.

    Attributes:
        center: the first actuated joint with the base at 0, (2,), m, inertial frame.
        inner, outer: radii, m.
    """

    center: Vector
    inner: float
    outer: float

    def miss(self, target: Vector, base: Vector) -> float:
        """How far outside the annulus the target lies, m; 0 inside."""
        distance = float(np.hypot(*(target - self.center - [base[0], 0.0])))
        return max(distance - self.outer, self.inner - distance, 0.0)

    def base_intervals(self, target: Vector) -> list[Interval]:
        """Placements x, m, from which the target is within reach; empty when it is too high or too low."""
        across, rise = target - self.center
        if abs(rise) > self.outer:
            return []
        far = math.sqrt(self.outer**2 - rise**2)
        near = math.sqrt(self.inner**2 - rise**2) if abs(rise) < self.inner else 0.0
        both = [(float(across - far), float(across - near)), (float(across + near), float(across + far))]
        return both if near > 0 else [(both[0][0], both[1][1])]


def reach(plant: Plant, margin: float = 0.0) -> Reach:
    """Reach of the arm, joint limits left aside.

    Args:
        plant: the machine's plant.
        margin: rad that a two-segment arm keeps from straight and from folded; ignored for longer arms.
    """
    at = plant.arm_segments(p=plant.parameter_values)
    lengths = at["lengths"].full().ravel()
    center = at["first_joint"].full().ravel()
    outer, inner = float(lengths.sum()), float(max(0.0, 2 * lengths.max() - lengths.sum()))
    if len(lengths) == 2:
        outer = math.sqrt(max(0.0, outer**2 - 2 * lengths[0] * lengths[1] * (1 - math.cos(margin))))
        inner = math.sqrt(inner**2 + 2 * lengths[0] * lengths[1] * (1 - math.cos(margin)))
    return Reach(center, inner, outer)


def clipped(intervals: list[Interval], allowed: Interval) -> list[Interval]:
    """The parts of the intervals inside `allowed`."""
    parts = [(max(low, allowed[0]), min(high, allowed[1])) for low, high in intervals]
    return [(low, high) for low, high in parts if low <= high]


def unreachable(
    plant: Plant,
    target: Vector,
    base: Vector | None,
    why: str = "",
    margin: float = 0.0,
    sagging: float | None = None,
) -> UnreachableTarget:
    """The error for a target that no posture reaches: by how much, and which placements would do.

    Args:
        plant: the machine's plant.
        target: end-point, inertial frame, m.
        base: the placement asked for, or None when every placement was allowed.
        why: what stands in the way when the distance alone does not (joint limits).
        margin: as for `reach`.
        sagging: how far off the nearest posture of the machine as it sags was, m, where it does.
    """
    annulus = reach(plant, margin)
    intervals = annulus.base_intervals(target)
    where = f"the end-point cannot reach ({target[0]:g}, {target[1]:g}) m (inertial frame)"
    where += "" if base is None else f" with the base at {without_rounding(base, 1.0)[0]:g} m"
    if base is not None:
        miss = annulus.miss(target, base)
    else:
        rise = abs(float(target[1] - annulus.center[1]))
        miss = max(0.0, rise - annulus.outer)
    by = (
        f": it lies {miss:.4g} m outside its reach of {annulus.inner:.4g} to {annulus.outer:.4g} m from the first joint"
    )
    if margin > 0:
        by += f", {math.degrees(margin):g}° kept from singular postures"
    if sagging is not None:
        miss = sagging
        by = f": {nearest_told(miss, ' of the machine as it sags')}"
    if miss == 0.0 or (sagging is not None and why):
        by = f": {why}" if why else ""
    if intervals:
        spans = " or ".join(f"{low:.4f} to {high:.4f} m" for low, high in intervals)
        advice = f"; by distance it is within reach with the base at {spans}"
    else:
        advice = "; no base position brings it within reach"
    advice += "" if sagging is None else " with springs unloaded"
    return UnreachableTarget(where + by + advice, miss=miss, base_intervals=intervals)


@by_structure
def path_to_end_point(machine: AnyMachine) -> tuple[ca.Function, tuple[str, ...]]:
    """Where the first joint on the way to the end-point sits (3,) and how long the way is, m, from p; the slides on it.

    Joints and placement are at 0, passive coordinates at rest.
    """
    plant = build_plant(machine)
    g, bodies = plant.graph, machine.kinematic_tree.bodies
    structure = g.at.skeleton
    way = structure.way_to(structure.tip)
    while way and structure.segments[way[0]].passive:
        way.pop(0)
    corners = points(g.at, g.base)[:, [*(1 + k for k in way), structure.n + 1]]
    still = [ca.SX.zeros(plant.n_base, 1), ca.SX.zeros(plant.n_actuated, 1)]
    corners = ca.Function("corners", [g.q, g.base, g.p], [corners])(plant.rest(*still, g.p), still[0], g.p)
    length = sum((ca.norm_2(part) for part in ca.horzsplit(ca.diff(corners, 1, 1))), start=ca.SX(0))
    joints = [bodies[k].joint for k in way]
    slides = tuple(joint.name for joint in joints if joint.kind == "slide" and not joint.passive)
    outputs = [ca.densify(corners[:, 0]), length]
    return ca.Function("path", [g.p], outputs, ["p"], ["first_joint", "length"]), slides


def arm_length(plant: Plant) -> float:
    """Sum of the distances from joint to joint and to the end-point, slides at zero, m; 1 where that is nothing."""
    if plant.closed_form:
        return float(plant.arm_segments(p=plant.parameter_values)["lengths"].full().sum())
    length = path_to_end_point(plant.machine)[0].call([plant.parameter_values])[1]
    return float(length) or 1.0


def sampled_ranges(machine: AnyMachine, length: float) -> Vector:
    """Where postures are looked for, (n, 2): the joint limits.

    A missing end of a hinge is a whole turn from the other one (both: ±π), of a slide twice `length` (both: ±length).
    """
    ends: list[tuple[float, float]] = []
    for unit, (low, high) in zip(machine.joint_units, machine.limits, strict=True):
        wide = math.pi if unit == "rad" else length
        low_end = low if math.isfinite(low) else high - 2 * wide if math.isfinite(high) else -wide
        ends.append((low_end, high if math.isfinite(high) else low_end + 2 * wide))
    return np.array(ends).reshape(-1, 2)


def outer_reach(plant: Plant) -> tuple[Vector, float]:
    """Centre and radius, m, of a ball that holds every point the end-point can reach, passive coordinates at rest.

    The centre (2,) or (3,) is the first actuated joint with the base at 0; the radius is `arm_length` and what slides
    add inside `sampled_ranges`.
    """
    if plant.closed_form:
        at = reach(plant)
        return at.center, at.outer
    center = path_to_end_point(plant.machine)[0].call([plant.parameter_values])[0]
    return center.full().ravel(), arm_length(plant) + slide_reach(plant)


def slide_reach(plant: Plant) -> float:
    """What the slides on the way to the end-point add to the arm's length inside `sampled_ranges`, m."""
    ranges = sampled_ranges(plant.machine, arm_length(plant))
    ends = dict(zip(plant.machine.joints, ranges, strict=True))
    return sum(float(np.abs(ends[name]).max()) for name in path_to_end_point(plant.machine)[1])


def nearest_told(left: float, of: str = "") -> str:
    """How far off the nearest posture is, m, in words."""
    return f"the nearest posture{of} found inside the joint limits stays {left:.4g} m off in one of the task's rows"


def missed(plant: Plant, target: Vector, base: Vector | None, left: float, why: str = "") -> UnreachableTarget:
    """The error for a target that no start led to, on a machine without closed form.

    Args:
        plant: the machine's plant.
        target: the task, m.
        base: the placement asked for, or None when it was free.
        left: largest row of r − target at the best posture found, m.
        why: what stands in the way when the distance alone does not.
    """
    machine = plant.machine
    named = ", ".join(f"{row} {value:g}" for row, value in zip(machine.task_rows, target, strict=True))
    sentence = f"the end-point cannot reach {named} m (inertial frame)"
    if base is not None and base.size:
        placed = (
            f"{name} {value:g} {unit}"
            for name, value, unit in zip(
                machine.base_coordinates, without_rounding(base, 1.0), machine.base_units, strict=True
            )
        )
        sentence += f" with the base at {', '.join(placed)}"
    by = why or nearest_told(left)
    return UnreachableTarget(f"{sentence}: {by}", miss=left)
