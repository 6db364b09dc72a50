"""Postures followed from cell to cell over a grid of targets and placements, where no closed form names them.

In: a plant, a target and a placement for each cell, and a reference posture. Out: a posture for each cell, with which
the machine at rest, or under gravity as it sags, has its end-point on the target.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.compiled import Economical
from flexopt.foundation.arrays import Mask, Vector
from flexopt.foundation.kept import by_structure
from flexopt.model import AnyMachine
from flexopt.plant import Plant, build_plant
from flexopt.plant.inverse_kinematics import solve_postures
from flexopt.plant.statics import STATIC_TOLERANCE, left_over

ITERATIONS = 60
# Largest step of a coordinate, rad or m; what is left over where a cell counts as reached, and of the nearest posture.
STEP, TOLERANCE, STILL = 0.3, 1e-11, 1e-9
# Singular values below this share of the largest count as lost directions.
LOST = 1e-10
# How many of the cells nearest to the start are tried at once as the first, then twice as many, and so on.
SEEDS = 64
# Axis of the grid, and which way along it.
Side = tuple[int, int]
SIDES: tuple[Side, ...] = ((1, 1), (1, -1), (0, 1), (0, -1))


@dataclass(frozen=True)
class MapPoints:
    """Where the end-point and the base are at the start and in each cell of n_y rows and n_x columns.

    Attributes:
        start: target (n_task,), m, and placement (n_b,), m or rad, from which cells are followed.
        target: (n_task, n_y, n_x), m.
        base: (n_b, n_y, n_x), m or rad.
        distance: from the start, by which the first cell is chosen (n_y, n_x).
    """

    start: tuple[Vector, Vector]
    target: Vector
    base: Vector
    distance: Vector


@dataclass(frozen=True)
class Followed:
    """What was found.

    Attributes:
        posture: (n, n_y, n_x), rad or m; NaN where none was found.
        reached: where one was (n_y, n_x).
        start_reached: whether the start's target is reached from its placement.
        miss: at the start, largest row of r − target, m.
    """

    posture: Vector
    reached: Mask
    start_reached: bool
    miss: float


def follow(
    plant: Plant,
    cells: MapPoints,
    reference: Vector,
    told: Callable[[int], None] = lambda _: None,
    *,
    gravity: bool = False,
) -> Followed:
    """The posture of each cell: inside the joint limits, the end-point on its target, at rest or as the machine sags.

    The reference leads to the start, that to the nearest cell that is reached; every other starts from a neighbour
    that is done. An arm without redundancy stays in the reference's branch: the sign of det Jv is kept. A redundant arm
    takes the posture nearest to the reference, |q_a − q_ref|² least over the postures on the target (rad and m alike),
    at least locally: each step is J⁺ (r_d − r) + α (I − J⁺ J)(q_ref − q_a), joints that rest against their limits left
    out, where J = ∂r/∂q_a is Jv at rest, and under gravity has the springs give way as the arm turns. `told` is called
    with how many cells are done.
    """
    shape = cells.distance.shape
    solver = Solver(plant, reference, gravity=gravity)
    posture, done = np.full((reference.size, *shape), np.nan), np.zeros(shape, dtype=bool)
    target, base = (part[:, None] for part in cells.start)
    held, held_there, miss = solver.solve(target, base, reference[:, None])
    start = held if held_there[0] else reference[:, None]
    for nearest in _nearest_first(cells.distance):
        starts = np.repeat(start, nearest[0].size, axis=1)
        found, reached, _ = solver.solve(cells.target[:, *nearest], cells.base[:, *nearest], starts)
        if reached.any():
            first = int(np.argmax(reached))
            at = nearest[0][first : first + 1], nearest[1][first : first + 1]
            posture[:, *at], done[at] = found[:, first : first + 1], True
            break

    tried: dict[Side, Mask] = {side: done.copy() for side in SIDES}

    def spread(of: Mask, sides: Sequence[Side]) -> Mask:
        """Cells beside these that are reached from there."""
        rows, columns, starts = _beside(of, done, posture, {side: tried[side] for side in sides})
        fresh = np.zeros(shape, dtype=bool)
        if rows.size:
            found, reached, _ = solver.solve(cells.target[:, rows, columns], cells.base[:, rows, columns], starts)
            fresh[rows[reached], columns[reached]] = True
            posture[:, rows[reached], columns[reached]] = found[:, reached]
            np.logical_or(done, fresh, out=done)
            told(int(done.sum()))
        return fresh

    fresh = done.copy()
    while fresh.any():
        while fresh.any():
            fresh = spread(fresh, SIDES)
        # A cell beside several fresh ones was tried from one of them, which may stand at a joint's limit.
        fresh = np.any([spread(done, [side]) for side in SIDES], axis=0)
    return Followed(posture, done, bool(held_there[0]), float(miss[0]))


def _nearest_first(distance: Vector) -> Iterator[tuple[NDArray[np.int64], ...]]:
    """Rows and columns of all cells, the nearest first: `SEEDS` of them, then twice as many, and so on."""
    order = np.argsort(distance, axis=None, kind="stable")
    done, size = 0, SEEDS
    while done < order.size:
        yield np.unravel_index(order[done : done + size], distance.shape)
        done, size = done + size, 2 * size


def _beside(
    fresh: Mask, done: Mask, posture: Vector, tried: Mapping[Side, Mask]
) -> tuple[NDArray[np.int64], NDArray[np.int64], Vector]:
    """Rows and columns of cells beside fresh ones that are not done, and postures of those neighbours (n, k).

    `tried`: by side, which cells were from there already; those that are now become so.
    """
    start = np.full_like(posture, np.nan)
    wanted = np.zeros_like(done)
    for (axis, shift), before in tried.items():
        towards = np.roll(fresh, shift, axis)
        # What was rolled over the edge is no neighbour.
        towards[(slice(None),) * axis + (0 if shift == 1 else -1,)] = False
        new = towards & ~done & ~wanted & ~before
        np.logical_or(before, new, out=before)
        start[:, new] = np.roll(posture, shift, axis + 1)[:, new]
        wanted |= new
    rows, columns = np.nonzero(wanted)
    return rows, columns, start[:, rows, columns]


class Solver:
    """Many targets at once, N columns each, none of which depends on another."""

    def __init__(self, plant: Plant, reference: Vector, *, gravity: bool, limited: bool = True) -> None:
        """`limited`: whether joints keep their limits."""
        self.plant, self.reference, self.gravity = plant, reference, gravity
        self.p = plant.parameter_values.full().ravel()
        self.function = _task_as_it_sags(plant.machine) if gravity else _task_at_rest(plant.machine)
        low, high = np.array(plant.machine.limits).T if limited else np.inf * np.outer([-1, 1], np.ones(reference.size))
        self.low, self.high = low[:, None], high[:, None]
        self.redundant = plant.n_actuated > plant.n_task
        # Of the placement it has the sign of no determinant.
        self.sign = 0.0 if self.redundant else float(self._branch(np.zeros((plant.n_base, 1)), reference[:, None])[0])

    def _task(self, base: Vector, posture: Vector) -> list[Vector]:
        """Of N columns: r, ∂r/∂q_a, and under gravity what tells whether springs hold, see `_task_as_it_sags`."""
        self.function.expect(posture.shape[1])
        r, slopes, *more = self.function(base, posture, self.p)
        return [r, self._matrices(slopes), *more]

    def _matrices(self, flat: Vector) -> Vector:
        """(N, n_task, n) from columns below each other."""
        return flat.T.reshape(-1, self.plant.n_actuated, self.plant.n_task).transpose(0, 2, 1)

    def _branch(self, base: Vector, posture: Vector) -> Vector:
        """The sign of det Jv, (N,)."""
        _, slopes, *more = self._task(base, posture)
        return np.sign(np.linalg.det(self._matrices(more[0]) if self.gravity else slopes))

    def end_point(self, base: Vector, posture: Vector) -> Vector:
        """The end-point r (n_task, N), m; no number where no equilibrium is found."""
        return self._task(base, posture)[0]

    def solve(self, target: Vector, base: Vector, start: Vector) -> tuple[Vector, Mask, Vector]:
        """Postures (n, N), which of them reach, and the errors left over (N,), m."""
        near = self._moved(target, base, start, pulled=True) if self.redundant else start
        if self.gravity:
            q = self._moved(target, base, near, pulled=False)
            left = self._left(target, base, q)
        else:
            q, left = solve_postures(self.plant, target, base, near)
        reached = left <= 100 * TOLERANCE * (1 + np.abs(target).max(axis=0))
        if self.sign:
            reached &= self._branch(base, q) == self.sign
        return q, reached, left

    def _left(self, target: Vector, base: Vector, q: Vector) -> Vector:
        """The largest row of r − target, (N,), m; infinite where the springs do not hold the machine."""
        r, _, _, left_over, pivot = self._task(base, q)
        held = (left_over[0] <= STATIC_TOLERANCE) & (pivot[0] > 0)
        return np.where(held, np.abs(r - target).max(axis=0), np.inf)

    def _moved(self, target: Vector, base: Vector, start: Vector, *, pulled: bool) -> Vector:
        """Postures (n, N) about the targets; `pulled`: those nearest to the reference."""
        q, share = start.clip(self.low, self.high), np.full(target.shape[1], float(pulled))
        pull = np.full(target.shape[1], np.inf)
        scale = 1 + np.abs(target).max(axis=0)
        active = np.arange(target.shape[1], dtype=np.int64)
        for _ in range(ITERATIONS):
            r, jacobian = self._task(base[:, active], q[:, active])[:2]
            if not (np.isfinite(r).all() and np.isfinite(jacobian).all()):
                # What falls has no equilibrium.
                known = np.isfinite(r).all(axis=0) & np.isfinite(jacobian).all(axis=(1, 2))
                active, r, jacobian = active[known], r[:, known], jacobian[known]
            error = target[:, active] - r
            towards, along = self._step(jacobian, error, q[:, active])
            size = pulled * np.abs(along).max(axis=0)
            # A pull towards the reference that grows was too strong for the curvature of the way there.
            share[active] = np.where(size > pull[active], np.maximum(0.5 * share[active], 0.02), share[active])
            pull[active] = size
            step = towards + share[active] * along
            step *= np.minimum(1.0, STEP / np.maximum(np.abs(step).max(axis=0), 1e-300))
            off = np.abs(error).max(axis=0) > TOLERANCE * scale[active]
            moving: NDArray[np.int64] = np.flatnonzero(off | (size > STILL))
            if moving.size == 0:
                break
            active, step = active[moving], step[:, moving]
            q[:, active] = (q[:, active] + step).clip(self.low, self.high)
        return q

    def _step(self, jacobian: Vector, error: Vector, q: Vector) -> tuple[Vector, Vector]:
        """The shortest step to the targets, and the one towards the reference that leaves the end-point, (n, N)."""
        free = np.ones(q.shape, dtype=bool)
        towards, along = np.zeros_like(q), np.zeros_like(q)
        for _ in range(q.shape[0]):
            left = jacobian * free.T[:, None, :]
            inverse = np.linalg.pinv(left, rcond=LOST)
            towards = np.einsum("knr,rk->nk", inverse, error)
            wish = np.where(free, self.reference[:, None] - q, 0.0)
            along = wish - np.einsum("knr,krm,mk->nk", inverse, left, wish)
            step = towards + along
            stuck = free & (((q <= self.low) & (step < 0)) | ((q >= self.high) & (step > 0)))
            if not stuck.any():
                break
            free &= ~stuck
        return towards, along


@by_structure
def _task_at_rest(machine: AnyMachine) -> Economical:
    """(base, posture, p) -> r and the stacked columns of Jv."""
    plant = build_plant(machine)
    g = plant.graph
    inputs = [g.base, g.posture, g.p]
    rest = plant.rest(*inputs)
    outputs = [plant.end_point(rest, g.base, g.p), ca.vec(plant.rigid_jacobian(rest, g.base, g.p))]
    dense = [ca.densify(output) for output in outputs]
    return Economical(ca.Function("task_at_rest", inputs, dense, ["base", "posture", "p"], ["r", "Jv"], {"cse": True}))


@by_structure
def _task_as_it_sags(machine: AnyMachine) -> Economical:
    """(base, posture, p) -> r and the stacked columns of ∂r/∂q_a and Jv under the weight, and what tells that it holds.

    What the static deflection leaves over, relative to the weight, and the least pivot of the stiffness against it.
    """
    plant = build_plant(machine)
    g, m = plant.graph, plant.n_passive
    inputs = [g.base, g.posture, g.p]
    at = plant.operating_point(g.base, g.posture, g.p, plant.deflected(g.base, g.posture, g.p))
    outputs = {
        "r": at.end_point,
        "J": ca.vec(plant.sagging_jacobian(at.q, g.base, g.p)),
        "Jv": ca.vec(at.rigid_jacobian),
        "left_over": left_over(plant, at.q, at.static_residual),
        "pivot": ca.mmin(ca.ldl(ca.densify(at.stiffness[:m, :m]))[0]),
    }
    dense = [ca.densify(output) for output in outputs.values()]
    function = ca.Function("task_as_it_sags", inputs, dense, ["base", "posture", "p"], list(outputs), {"cse": True})
    return Economical(function)
