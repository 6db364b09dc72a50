"""Postures where the rigid-body Jacobian Jv loses rank."""

from __future__ import annotations

import math

import numpy as np

from flexopt.errors import SingularPosture
from flexopt.model.arguments import Vector
from flexopt.plant.plant import Plant

# Above this condition number Jv⁻¹ and its derivatives keep fewer than half of a double's digits.
CONDITION_MAX = 1e6
PROBE = 1e-3


def condition_number(plant: Plant, q: Vector, base: Vector) -> float:
    """Cond Jv(q), the ratio of its extreme singular values; infinite where the smallest is zero."""
    values = np.linalg.svd(plant.rigid_jacobian(q, base, plant.parameter_values).full(), compute_uv=False)
    return float(values[0] / values[-1]) if values[-1] > 0 else math.inf


def check_regular(plant: Plant, q: Vector, base: Vector) -> float:
    """Return cond Jv, or raise `SingularPosture` naming the joint that would lead out of the singularity and its angle.

    Args:
        plant: the machine's plant.
        q: configuration (n_q,).
        base: placement (n_b,).
    """
    condition = condition_number(plant, q, base)
    if condition <= CONDITION_MAX:
        return condition
    escape = [_smallest_singular_value(plant, q, base, i) for i in range(plant.n_passive, plant.n_coordinates)]
    index = int(np.argmax(escape))
    joint, angle = plant.machine.joints[index], float(q[plant.n_passive + index])
    raise SingularPosture(
        f"posture (joint {joint}) = {angle:.6g} rad ({math.degrees(angle):.4g}°) is singular: the "
        f"end-point can only move along one line (cond Jv = {condition:.3g}, allowed up to {CONDITION_MAX:.0e}); "
        f"bend {joint}",
        joint=joint,
        angle=angle,
    )


def _smallest_singular_value(plant: Plant, q: Vector, base: Vector, index: int) -> float:
    moved = q.copy()
    moved[index] += PROBE
    jacobian = plant.rigid_jacobian(moved, base, plant.parameter_values).full()
    return float(np.linalg.svd(jacobian, compute_uv=False)[-1])
