"""Whether the springs hold the machine under gravity, and what its static deflection leaves over."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.errors import InputError, NoSolutionFound
from flexopt.foundation.arrays import Vector
from flexopt.plant.plant import Plant

# Of what the static deflection may leave over, relative to the weight.
STATIC_TOLERANCE = 1e-8
# The same of few steps, whose machine hangs where it does to rounding of what is told of it.
NEARLY_SETTLED = 1e-4


def left_over(plant: Plant, q: ca.SX, residual: ca.SX) -> ca.SX:
    """Force that the deflection at q (n_q,) leaves over, `residual`, relative to the weight; a graph of base and p."""
    weight = ca.norm_inf(plant.gravity(q, plant.graph.base, plant.graph.p)[: plant.n_passive])
    return ca.norm_inf(residual) / (1 + weight)


def check_settled(plant: Plant, q: Vector, base: Vector) -> None:
    """Raise `NoSolutionFound` where a configuration (n_q,) is no static equilibrium; `base`: placement (n_b,)."""
    if not np.all(np.isfinite(q)):
        raise NoSolutionFound("the static deflection under gravity diverged", violations={}, iterate={})
    left, weight = _left(plant, q, base, plant.parameter_values)
    if not left <= STATIC_TOLERANCE * (1 + weight):
        raise NoSolutionFound(
            f"the static deflection under gravity did not converge: {left:.3g} N or N m left over",
            violations={"static equilibrium": left},
            iterate=dict(zip(plant.coordinates, q.tolist(), strict=True)),
        )


def _left(plant: Plant, q: Vector, base: Vector, p: ca.DM | Vector) -> tuple[float, float]:
    """The largest force that springs and weight leave over at q (n_q,), N or N m, and that of the weight."""
    m = plant.n_passive
    weight = plant.gravity.call([q, base, p])[0].full().ravel()[:m]
    rest = plant.rest.call([base, q[m:], p])[0].full().ravel()
    left = plant.stiffness.call([p])[0].full()[:m, :m] @ (q - rest)[:m] + weight
    return float(np.abs(left).max()), float(np.abs(weight).max())


def unsettled(plant: Plant, q: Vector, base: Vector, p: Vector) -> float:
    """How far the springs are from holding the machine with the numbers p at q (n_q,), relative to its weight.

    0 at a static equilibrium, to `NEARLY_SETTLED`; 1 at one that it falls from; infinite where q is no number.
    """
    if not np.all(np.isfinite(q)):
        return np.inf
    left, weight = _left(plant, q, base, p)
    if not left <= NEARLY_SETTLED * (1 + weight):
        return left / (1 + weight)
    m = plant.n_passive
    tangent = plant.stiffness(p).full()[:m, :m] + plant.gravity_stiffness(q, base, p).full()
    return float(np.linalg.eigvalsh(tangent)[0] <= 0)


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


def holding(plant: Plant, q: Vector, bases: Vector) -> NDArray[np.bool_]:
    """At which static equilibria (n_q, N) the springs hold the machine, (N,); `bases`: placements (n_b, N)."""
    m, p, count = plant.n_passive, plant.parameter_values, q.shape[1]
    at = plant.gravity_stiffness.call([q, bases, p])[0].full().reshape(m, count, m).transpose(1, 0, 2)
    tangents = plant.stiffness.call([p])[0].full()[:m, :m] + at
    held: NDArray[np.bool_] = np.isfinite(tangents).all(axis=(1, 2))
    held[held] = np.linalg.eigvalsh(tangents[held])[:, 0] > 0
    return held


def not_held() -> InputError:
    """The error for a machine that falls over."""
    return InputError(
        "gravity: the springs do not hold the machine in this posture (K_p with gravity's stiffness is not positive "
        "definite); stiffer springs or smaller masses would"
    )
