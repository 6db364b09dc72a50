"""How a machine with other numbers than the file's stands, and is held on its target (theory: `Plant.held`)."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.plant import Plant
from flexopt.plant.statics import unsettled
from flexopt.selection.objective import Quantities

# That the machine stands with other numbers, and that its end-point is held then: to so many m.
EQUILIBRIUM, ON_TARGET, HELD_OFF = "static equilibrium", "hold of the target", 1e-5
# So many more steps than of `Plant.held` lead there, where these miss both by no more: constraints are asked where they
# end.
AGAIN, NEARLY = 5, 1e-3


def held_with(quantities: Quantities, z: Vector, p: Any) -> tuple[Vector, Vector]:
    """Base and posture of z; of a machine that sags with other numbers than the file's, the posture that holds it."""
    base, posture = quantities.at(z)[:2]
    plant = quantities.measures.plant
    if p is None or not quantities.measures.gravity or _own(plant, p):
        return base, posture
    return base, plant.held.call([base, posture, p, _held_point(quantities, z)])[0].full().ravel()


def not_standing(quantities: Quantities, z: Vector, p: Vector) -> dict[str, float]:
    """Whether a machine with the numbers p is in no static equilibrium, as it falls over, or in none on the target.

    By how much each is missed: see `unsettled`, and m.
    """
    if not quantities.measures.gravity:
        return {}
    plant, target = quantities.measures.plant, _held_point(quantities, z)
    base, posture = quantities.at(z)[:2]
    if _own(plant, p):
        # Where it hangs is where it is held.
        q = np.append(plant.deflected.call([base, posture, p])[0].full(), posture)
        return _missed(plant, q, base, p, target)
    turned, passive = plant.held.call([base, posture, p, target])
    q = np.append(passive.full(), turned.full())
    missed = _missed(plant, q, base, p, target)
    # On soft springs under a heavy load the last steps leave more than on others.
    for _ in range(AGAIN if max(missed.values(), default=0.0) <= NEARLY else 0):
        if not missed:
            break
        q = plant.held_step.call([q, base, p, target])[0].full().ravel()
        missed = _missed(plant, q, base, p, target)
    if missed.keys() == {EQUILIBRIUM, ON_TARGET}:
        # Steps that do not reach the target end nowhere: whether it falls is told by where it hangs, the arm as it was.
        hangs = np.append(plant.deflected.call([base, posture, p])[0].full(), posture)
        missed = {name: off for name, off in missed.items() if name == ON_TARGET or unsettled(plant, hangs, base, p)}
    return missed


def _own(plant: Plant, p: Any) -> bool:
    """Whether these are the file's numbers."""
    return ca.DM(p).full().tolist() == plant.parameter_values.full().tolist()


def _missed(plant: Plant, q: Vector, base: Vector, p: Vector, target: Vector) -> dict[str, float]:
    """By name what all coordinates (n_q,) miss, and by how much."""
    away = float(np.abs(plant.end_point.call([q, base, p])[0].full().ravel() - target).max())
    found = {EQUILIBRIUM: unsettled(plant, q, base, p), ON_TARGET: away if not away <= HELD_OFF else 0.0}
    return {name: off for name, off in found.items() if off != 0}


def _held_point(quantities: Quantities, z: Vector) -> Vector:
    """Where the end-point is as the machine sags with the file's numbers, (n_task,)."""
    plant, nominal = quantities.measures.plant, quantities.measures.plant.parameter_values
    base, posture = quantities.at(z)[:2]
    sagged = np.append(plant.deflected.call([base, posture, nominal])[0].full(), posture)
    return plant.end_point.call([sagged, base, nominal])[0].full().ravel()
