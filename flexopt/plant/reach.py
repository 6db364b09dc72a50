"""How far the arm reaches, which placements bring a target within reach, and what to say when none was found."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flexopt.errors import UnreachableTarget
from flexopt.model.arguments import Vector
from flexopt.plant.plant import Plant

Interval = tuple[float, float]


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
    plant: Plant, target: Vector, base: Vector | None, why: str = "", margin: float = 0.0
) -> UnreachableTarget:
    """The error for a target that no posture reaches: by how much, and which placements would do.

    Args:
        plant: the machine's plant.
        target: end-point, inertial frame, m.
        base: the placement asked for, or None when every placement was allowed.
        why: what stands in the way when the distance alone does not (joint limits).
        margin: as for `reach`.
    """
    annulus = reach(plant, margin)
    intervals = annulus.base_intervals(target)
    where = f"the end-point cannot reach ({target[0]:g}, {target[1]:g}) m (inertial frame)"
    where += "" if base is None else f" with the base at {base[0]:g} m"
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
    if miss == 0.0:
        by = f": {why}" if why else ""
    if intervals:
        spans = " or ".join(f"{low:.4f} to {high:.4f} m" for low, high in intervals)
        advice = f"; by distance it is within reach with the base at {spans}"
    else:
        advice = "; no base position brings it within reach"
    return UnreachableTarget(where + by + advice, miss=miss, base_intervals=intervals)
