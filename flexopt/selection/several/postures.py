"""The postures that reach one target from many placements, and what they are worth.

In: a configuration problem and placements. Out: for each placement a few postures with V, −∞ where a posture does not
reach or breaks a constraint.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.plant.inverse_kinematics import (
    ELBOW_SIGN,
    REACHED,
    branch,
    held_on,
    inside_reach,
    low_discrepancy,
    solve_postures,
)
from flexopt.plant.reach import arm_length, sampled_ranges
from flexopt.selection.constraints import building
from flexopt.selection.nlp.program import values_of
from flexopt.selection.places import FEASIBLE
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.starts import LONGER, SHORTER, STEP, STEP_LEAST, STEP_MOST, moved, violated

# Postures tried from each placement: coordinates of a longer planar arm for each elbow; starts of the iteration.
REDUNDANT, NEAR, FAR = 24, 4, 3
# Of a placement from which no posture keeps every constraint so many, the nearest to these, are moved into them.
MOVED = 4
# Postures of a placement that climb at random, and their steps.
CLIMBED, STEPS = 3, 30
# How far beyond its reach with springs unloaded an arm is looked at that sags, as a share of its length.
SAG = 0.1
# Rounding on the edge of a constraint, in units of its scale.
EDGE = 1e-7


@dataclass(frozen=True)
class Reached:
    """Configurations of one target: N placements with C postures each.

    Attributes:
        z: (n_z, N, C);  value: V (N, C), the cost of travel taken off, −∞ where the configuration is not allowed.
        violation: largest violation of a constraint, in units of its scale, ∞ where the target is not reached.
    """

    z: Vector
    value: Vector
    violation: Vector

    def of(self, places: list[int]) -> Reached:
        """Those of some of the placements."""
        return Reached(self.z[:, places], self.value[places], self.violation[places])


def reached_from(problem: SelectionProblem, bases: Vector, seed: int, finer: int = 1) -> Reached:
    """Postures for placements (n_b, N); `finer` times as many of each are looked at as usual."""
    plant = problem.measures.plant
    n_b, n, count = plant.n_base, plant.n_actuated, bases.shape[1]
    if count == 0:
        return Reached(np.zeros((n_b + n, 0, 1)), np.zeros((0, 1)), np.zeros((0, 1)))
    if plant.closed_form:
        unit = low_discrepancy(n - 2, finer * REDUNDANT, seed) if n > 2 else np.zeros((0, 1))
        each = unit.shape[1]
        spread, tiled = np.repeat(bases, each, axis=1), np.tile(unit, count)
        target, off = problem.target, np.zeros(count * each)
        if problem.gravity:
            # The border of the reach is another as the machine sags.
            target, off = inside_reach(plant, target, spread)
        found = [branch(plant, target, spread, tiled, sign) for sign in ELBOW_SIGN.values()]
        near = (off <= SAG * arm_length(plant)).reshape(count, each)
        postures = np.concatenate([p.reshape(n, count, each) for p, _ in found], axis=2)
        reaches = np.concatenate([mask.reshape(count, each) & near for _, mask in found], axis=1)
        z = np.concatenate([np.repeat(bases[:, :, None], postures.shape[2], axis=2), postures])
        return _with_moved(problem, _valued(problem, z, reaches))
    return _with_moved(problem, reached_by(problem, bases, _starts(problem, bases, seed, finer)))


def _with_moved(problem: SelectionProblem, reached: Reached) -> Reached:
    """What is reached, and where postures lead that are moved into the constraints, each placement held.

    They are moved where none keeps all: what a constraint leaves may be thinner than the spacing of any sample.
    """
    lost = ~np.isfinite(reached.value).any(axis=1)
    places = np.flatnonzero(lost & np.isfinite(reached.violation).any(axis=1))
    if not places.size:
        return reached
    nearest = np.argsort(reached.violation[places], axis=1, kind="stable")[:, :MOVED]
    near = reached.z[:, places[:, None], nearest]
    there, left = _moved_inside(problem, near.reshape(len(near), -1))
    # What found no way into the constraints may have left the target.
    found = _valued(problem, there.reshape(near.shape), (left <= FEASIBLE).reshape(nearest.shape))
    shape = len(reached.value), nearest.shape[1]
    more = Reached(np.repeat(reached.z[:, :, :1], shape[1], axis=2), np.full(shape, -np.inf), np.full(shape, np.inf))
    more.z[:, places], more.value[places], more.violation[places] = found.z, found.value, found.violation
    return joined(reached, more)


def _moved_inside(problem: SelectionProblem, z: Vector) -> tuple[Vector, Vector]:
    """As `moved`, each placement held, from joints turned and brought within their bounds: steps alone need not be.

    With the machine's own numbers first: rows at corners of what is uncertain cost many times as much, and what finds
    no way into the others, as most, finds none into all.
    """
    n_b = problem.measures.plant.n_base
    lower, upper = problem.lower[n_b:, None], problem.upper[n_b:, None]
    bounded = np.isfinite(upper - lower) & (np.array(problem.machine.joint_units)[:, None] == "rad")
    middle = (np.where(bounded, lower, z[n_b:]) + np.where(bounded, upper, z[n_b:])) / 2
    turned = z[n_b:] + math.tau * np.rint((middle - z[n_b:]) / math.tau)
    there, left = moved(without_corners(problem), np.vstack([z[:n_b], np.clip(turned, lower, upper)]), standing=True)
    if any(row.corner for row in problem.constraints) and (inside := left <= FEASIBLE).any():
        there[:, inside], left[inside] = moved(problem, there[:, inside], standing=True)
    return there, left


def within_limits(problem: SelectionProblem, reached: Reached) -> Reached:
    """What is reached with no joint beyond the machine's limits, where the problem keeps them; constraints aside.

    Postures beyond are moved into the limits, and on the target, too: of a redundant arm a sample may have none inside.
    """
    bare = without_constraints(problem)
    beyond = np.isfinite(reached.violation) & (_outside(bare, reached.z) > EDGE)
    z, reaches = reached.z.copy(), np.zeros(beyond.shape, dtype=bool)
    z[:, beyond], left = _moved_inside(bare, reached.z[:, beyond])
    reaches[beyond] = left <= FEASIBLE
    every = joined(reached, _valued(problem, z, reaches))
    inside = _outside(bare, every.z) <= EDGE
    return Reached(every.z, np.where(inside, every.value, -np.inf), np.where(inside, every.violation, np.inf))


def without_constraints(problem: SelectionProblem) -> SelectionProblem:
    """The problem of reaching the target within the machine's limits alone."""
    n_b, n_task, kept = problem.measures.plant.n_base, problem.target.size, problem.asked.joint_margin or 0.0
    joints = [replace(each, lower=each.lower - kept, upper=each.upper + kept) for each in problem.variables[n_b:]]
    margin = replace(problem.constraints[n_task], lower=-math.inf)
    return replace(
        problem,
        variables=(*problem.variables[:n_b], *joints),
        constraints=(*problem.constraints[:n_task], margin),
        constraint_set=None,
    )


def without_corners(problem: SelectionProblem) -> SelectionProblem:
    """The problem with what is kept with the machine's own numbers alone."""
    kept = tuple(row for row in problem.constraints if not row.corner)
    if len(kept) == len(problem.constraints) or problem.constraint_set is None:
        return problem
    own = building.without_corners(problem.machine, problem.constraint_set)
    return replace(problem, constraints=kept, constraint_set=own if len(own) else None)


def reached_by(problem: SelectionProblem, bases: Vector, starts: Vector) -> Reached:
    """Postures to which the iteration leads from starts (n, N, C), for placements (n_b, N)."""
    plant = problem.measures.plant
    n, count, each = starts.shape
    spread = np.repeat(bases, each, axis=1)
    solved, left = solve_postures(plant, problem.target, spread, starts.reshape(n, -1))
    z = np.concatenate([spread.reshape(-1, count, each), solved.reshape(n, count, each)])
    return _valued(problem, z, (left <= REACHED).reshape(count, each))


def joined(one: Reached, other: Reached) -> Reached:
    """The postures of both, for the same placements."""
    return Reached(
        np.concatenate([one.z, other.z], axis=2),
        np.concatenate([one.value, other.value], axis=1),
        np.concatenate([one.violation, other.violation], axis=1),
    )


def climbed_held(problem: SelectionProblem, reached: Reached, seed: int) -> Reached:
    """What is reached, and where random steps lead from the best few of it that keep the target, the placement held."""
    count, plant = reached.value.shape[0], problem.measures.plant
    n_b = plant.n_base
    # Those that break a constraint least come after all that break none.
    order = np.lexsort([reached.violation, -reached.value], axis=1)[:, :CLIMBED]
    z = reached.z[:, np.arange(count)[:, None], order].reshape(reached.z.shape[0], -1)
    values, rng = np.take_along_axis(reached.value, order, axis=1).ravel(), np.random.default_rng((seed, z.shape[1]))
    step, scale, each = np.full(z.shape[1], STEP), problem.scale[n_b:, None], order.shape[1]
    for _ in range(STEPS):
        near = z[n_b:] + step * rng.standard_normal(z[n_b:].shape) * scale
        there = reached_by(problem, z[:n_b], near[:, :, None])
        better = there.value[:, 0] > values
        z, values = np.where(better, there.z[:, :, 0], z), np.where(better, there.value[:, 0], values)
        step = np.clip(step * np.where(better, LONGER, SHORTER), STEP_LEAST, STEP_MOST)
    found = values.reshape(count, each)
    return joined(reached, Reached(z.reshape(-1, count, each), found, np.where(np.isfinite(found), 0.0, np.inf)))


def _valued(problem: SelectionProblem, z: Vector, reaches: NDArray[np.bool_]) -> Reached:
    """What configurations (n_z, N, C) are worth, of which those reach the target."""
    shape, reached = z.shape[1:], reaches.ravel()
    flat = problem.wrapped(z.reshape(z.shape[0], -1).T).T
    if problem.gravity and reached.any():
        plant = problem.measures.plant
        n_b = plant.n_base
        flat[n_b:, reached], _ = held_on(plant, problem.target, flat[:n_b, reached], flat[n_b:, reached])
    off = np.where(reached, _violation(problem, flat), np.inf)
    value = np.full(off.size, -np.inf)
    good = np.flatnonzero(off <= EDGE)
    if good.size:
        worth = values_of(problem, flat[:, good])
        value[good] = np.where(np.isfinite(worth), worth, -np.inf)
    return Reached(flat.reshape(z.shape), value.reshape(shape), off.reshape(shape))


def _starts(problem: SelectionProblem, bases: Vector, seed: int, finer: int) -> Vector:
    """Postures to start from (n, N, C): those of the problem's sample that stand nearest, and some from anywhere."""
    scan, plant = problem.scan, problem.measures.plant
    low, high = sampled_ranges(plant.machine, arm_length(plant)).T
    anywhere = low[:, None] + (high - low)[:, None] * low_discrepancy(plant.n_actuated, finer * FAR, seed)
    parts = [np.repeat(anywhere[:, None, :], bases.shape[1], axis=1)]
    inside = np.flatnonzero(scan.violation <= 0)
    inside = inside if inside.size else np.arange(scan.size)
    if inside.size:
        scale = problem.scale[: plant.n_base, None, None]
        away = np.sum(((bases[:, :, None] - scan.base[:, None, inside]) / scale) ** 2, axis=0)
        nearest = inside[np.argsort(away, axis=1, kind="stable")[:, : finer * NEAR]]
        parts.insert(0, scan.posture[:, nearest])
    return np.concatenate(parts, axis=2)


def _violation(problem: SelectionProblem, z: Vector) -> Vector:
    """Largest violation of bounds and rows of z (n_z, N), in units of the scales."""
    return np.maximum(violated(problem, z), _outside(problem, z))


def _outside(problem: SelectionProblem, z: Vector) -> Vector:
    """How far z (n_z, …) is outside its bounds at most, in units of the scales; negative inside."""
    lower, upper, scale = (x.reshape(-1, *[1] * (z.ndim - 1)) for x in (problem.lower, problem.upper, problem.scale))
    return (np.maximum(lower - z, z - upper) / scale).max(axis=0)
