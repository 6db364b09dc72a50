"""Whether the springs hold the machine under gravity, and what its static deflection leaves over."""

from __future__ import annotations

import casadi as ca
import numpy as np

from flexopt.errors import InputError
from flexopt.foundation.arrays import Vector
from flexopt.plant.plant import OperatingPoint, Plant


def left_over(plant: Plant, at: OperatingPoint) -> ca.SX:
    """Force that the deflection of an operating point leaves over, relative to the weight; a graph of base and p."""
    weight = ca.norm_inf(plant.gravity(at.q, plant.graph.base, plant.graph.p)[: plant.n_passive])
    return ca.norm_inf(at.static_residual) / (1 + weight)


def check_held(plant: Plant, q: Vector, base: Vector) -> Vector:
    """Return K with gravity's stiffness in the passive block, (n_q, n_q), or raise where that block is not positive.

    Args:
        plant: the machine's plant.
        q: configuration at static equilibrium (n_q,).
        base: placement (n_b,).

    Raises:
        InputError: the machine would fall over.
    """
    m, p = plant.n_passive, plant.parameter_values
    stiffness = plant.stiffness(p).full()
    stiffness[:m, :m] += plant.gravity_stiffness(q, base, p).full()
    if not np.all(np.isfinite(stiffness)) or np.linalg.eigvalsh(stiffness[:m, :m])[0] <= 0:
        raise not_held()
    return stiffness


def not_held() -> InputError:
    """The error for a machine that falls over."""
    return InputError(
        "gravity: the springs do not hold the machine in this posture (K_p with gravity's stiffness is not positive "
        "definite); stiffer springs or smaller masses would"
    )
