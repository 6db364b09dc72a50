"""Placements that are looked at: even ones, and more in areas that these leave out.

In: ranges of the placement coordinates, constraints. Out: placements. Where a machine may stand (`region`, `keep_out`)
is known before anything is solved, and an area may be narrower than the spacing of any sample.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.algebra.feasible import feasible_steps, repeated
from flexopt.foundation.arrays import Vector
from flexopt.foundation.kept import by_structure
from flexopt.model.constraints import Constraints
from flexopt.plant import Plant
from flexopt.plant.inverse_kinematics import low_discrepancy
from flexopt.selection.constraints import ConstraintSet, build_constraints
from flexopt.selection.constraints.areas import area_ranges
from flexopt.selection.nlp.configuration import ConstraintRows

# Placements in each area.
EACH = 65
# Largest violation, in units of the rows' scales, of what counts as feasible.
FEASIBLE = 1e-7


def even_places(low: Vector, high: Vector, on_line: int, elsewhere: int, seed: int) -> Vector:
    """Points (n, N) from low to high (n,).

    Evenly spaced, `on_line` of them, where one coordinate is free; a low-discrepancy sample where more are.
    """
    loose = low < high
    free = int(loose.sum())
    if free == 0:
        return low[:, None]
    unit = np.linspace(0.0, 1.0, on_line)[None, :] if free == 1 else low_discrepancy(free, elsewhere, seed)
    places = np.repeat(low[:, None], unit.shape[1], axis=1)
    places[loose] += (high - low)[loose, None] * unit
    return places


def placed(asked: Constraints) -> bool:
    """Whether there are areas that the machine may stand in, or may not."""
    return asked.region is not None or asked.keep_out is not None


def places_left_out(plant: Plant, asked: Constraints, low: Vector, high: Vector, known: Vector, seed: int) -> Vector:
    """Allowed placements (n_b, N) between low and high (n_b,) in areas that hold few of those that are known.

    Without areas, or where enough are known in each, there are none.
    """
    none = np.zeros((plant.n_base, 0))
    if not placed(asked):
        return none
    areas = build_constraints(plant, Constraints(region=asked.region, keep_out=asked.keep_out, holds=asked.holds))
    inside, enough = known[:, _kept(plant, areas, known)], EACH if (low < high).any() else 1
    found = [none]
    for least, most in area_ranges(plant, asked, low, high):
        there = np.all((inside >= least[:, None]) & (inside <= most[:, None]), axis=0)
        if there.sum() < enough:
            found.append(even_places(least, most, EACH, EACH, seed))
    places, free = np.concatenate(found, axis=1), (low < high).astype(float)
    if not places.size:
        return none
    # What lies in the ranges of an area need not lie in it.
    steps = _steps(plant, ConstraintRows(areas.structure, areas.function))
    at = [plant.parameter_values, areas.constants]
    places = repeated(steps, places, (low, high, free, np.ones(low.size)), _bounds(areas), at, FEASIBLE / 100)[0]
    return places[:, _kept(plant, areas, places)]


def _kept(plant: Plant, areas: ConstraintSet, places: Vector) -> NDArray[np.bool_]:
    """Which placements (n_b, N) are allowed."""
    # A Function takes no columns for one.
    if not places.shape[1]:
        return np.zeros(0, dtype=bool)
    postures, (lower, upper, scale) = np.zeros((plant.n_actuated, places.shape[1])), _bounds(areas)
    rows = areas.function.call([places, postures, plant.parameter_values, areas.constants])[0].full().T
    kept: NDArray[np.bool_] = (np.maximum(lower - rows, rows - upper) / scale <= FEASIBLE).all(axis=1)
    return kept


def _bounds(areas: ConstraintSet) -> tuple[Vector, Vector, Vector]:
    lower, upper, scale = np.array([(row.lower, row.upper, row.scale) for row in areas.rows]).T
    return lower, upper, scale


@by_structure
def _steps(plant: Plant, areas: ConstraintRows) -> ca.Function:
    """`feasible_steps` of the placement into areas, which no posture matters to; its last inputs are p and c."""
    g, c = plant.graph, ca.SX.sym("c", areas.function.size1_in(3))
    (rows,) = areas.function.call([g.base, ca.SX.zeros(plant.n_actuated), g.p, c])
    return feasible_steps(rows, g.base, [g.p, c])
