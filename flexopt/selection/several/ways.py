"""Ways through samples of configurations, one sample for each target, by dynamic programming; what is between them.

In: a program with bounded steps from target to target, and layers of nodes. Out: ways x that solves start from: each is
the shortest of those with the highest worst V.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from flexopt.errors import NoSolutionFound
from flexopt.foundation.arrays import Vector
from flexopt.model import AnyMachine
from flexopt.plant.inverse_kinematics import REACHED, solve_held, solve_postures
from flexopt.selection.broken import broken_on
from flexopt.selection.nlp.program import Program
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.several.postures import Reached

# Nodes for each target: the best postures of as many placements.
NODES = 400
# Points looked at between two targets.
BETWEEN = 8
# Points there at which constraints are looked at, which cost less.
WATCHED = 63
# A sample is too coarse for steps as short as the rates ask for, so longer ones are looked at, too.
LONGER = (1.0, 3.0, 10.0, 1e9)
# Configurations z (n_z, N) of one target and their V (N,).
Layer = tuple[Vector, Vector]


def nodes_of(found: list[Reached]) -> Layer:
    """Up to NODES of the configurations of one target that are allowed."""
    z = np.concatenate([reached.z.reshape(reached.z.shape[0], -1) for reached in found], axis=1)
    value = np.concatenate([reached.value.ravel() for reached in found])
    good = np.flatnonzero(np.isfinite(value))
    if good.size > NODES:
        # The better half, and of the others every so many.
        order = good[np.argsort(-value[good], kind="stable")]
        rest = order[NODES // 2 :]
        good = np.concatenate([order[: NODES // 2], rest[:: max(1, rest.size // (NODES // 2))]])
    return z[:, good], value[good]


def coarse_ways(program: Program, layers: list[Layer], count: int) -> list[Vector]:
    """Up to `count` ways x, for several lengths of the longest step; none where a layer is empty."""
    return distinct([way for worth, way in ways_of_lengths(program, layers) if np.isfinite(worth)])[:count]


def ways_of_lengths(program: Program, layers: list[Layer]) -> list[tuple[float, Vector]]:
    """For each length of the longest step the worst V of the best way and it, x; −∞ where there is none."""
    first = program.first
    n_z = first.scale.size
    nothing = -np.inf, np.zeros(0)
    if any(values.size == 0 for _, values in layers):
        return [nothing] * len(LONGER)
    limits = np.full((len(layers) - 1, n_z), np.inf)
    for (i, _), limit in zip(program.coupling.pairs, program.steps, strict=True):
        limits[i // n_z, i % n_z] = limit
    scaled = [(z / first.scale[:, None], values) for z, values in layers]
    ways = [_best_way(scaled, limits * longer, first.turning) or nothing for longer in LONGER]
    return [(worth, way * program.scale if way.size else way) for worth, way in ways]


def distinct(ways: list[Vector]) -> list[Vector]:
    """Each of the ways once."""
    return [way for k, way in enumerate(ways) if not any(np.array_equal(way, other) for other in ways[:k])]


def no_way() -> NoSolutionFound:
    """The error where there is none."""
    sentence = "with these rates no configurations of neighbouring targets are near enough"
    return NoSolutionFound(f"no way was found to start from: {sentence}", violations={}, iterate={})


def _best_way(layers: list[Layer], limits: Vector, turns: NDArray[np.bool_]) -> tuple[float, Vector] | None:
    """The highest worst V and the shortest of the ways with it, or None where steps cannot join the layers."""
    steps = [
        _lengths(before[0], after[0], limit, turns)
        for (before, after), limit in zip(pairwise(layers), limits, strict=True)
    ]
    level = layers[0][1]
    for (_, value), length in zip(layers[1:], steps, strict=True):
        level = np.minimum(value, np.where(np.isfinite(length), level[:, None], -np.inf).max(axis=0))
    if not np.isfinite(level).any():
        return None
    floor = float(level.max())
    cost = np.where(layers[0][1] >= floor, 0.0, np.inf)
    came: list[NDArray[np.int64]] = []
    for (_, value), length in zip(layers[1:], steps, strict=True):
        total = cost[:, None] + length
        came.append(total.argmin(axis=0))
        cost = np.where(value >= floor, total.min(axis=0), np.inf)
    at = int(cost.argmin())
    way = [at]
    for origin in reversed(came):
        at = int(origin[at])
        way.insert(0, at)
    points = [x[:, k] for (x, _), k in zip(layers, way, strict=True)]
    for k in range(1, len(points)):
        step = points[k] - points[k - 1]
        points[k] = points[k - 1] + np.where(turns, _shortest_turn(step), step)
    return floor, np.concatenate(points)


def _lengths(before: Vector, after: Vector, limit: Vector, turns: NDArray[np.bool_]) -> Vector:
    """Squared lengths of all steps (N, N'), ∞ of those that are too long."""
    total = np.zeros((before.shape[1], after.shape[1]))
    for i, most in enumerate(limit):
        step = after[i][None, :] - before[i][:, None]
        size = np.abs(_shortest_turn(step) if turns[i] else step)
        total += np.where(size <= most, size**2, np.inf)
    return total


def _shortest_turn(step: Vector) -> Vector:
    """Angles within half a turn; angles are not scaled, so these are rad."""
    return (step + np.pi) % (2 * np.pi) - np.pi


def on_lines(
    problems: Sequence[SelectionProblem], due: Vector, zs: list[Vector], values: Callable[[int, Vector], Vector]
) -> tuple[float, float]:
    """The smallest value on straight lines between the targets, and when; `values` of z (n_z, N) towards target k.

    −∞ where it is no number, or the end-point cannot be kept on its line.
    """
    worst, when = np.inf, float(due[0])
    along = np.linspace(0.0, 1.0, BETWEEN + 1)
    for k in range(len(zs) - 1):
        z, reached = _line(problems, zs, k, along)
        if not reached.all():
            return -np.inf, float(due[k] + (due[k + 1] - due[k]) * along[int(np.argmin(reached))])
        found = np.nan_to_num(values(k, z), nan=-np.inf, posinf=np.inf, neginf=-np.inf)
        low = int(found.argmin())
        if found[low] < worst:
            worst, when = float(found[low]), float(due[k] + (due[k + 1] - due[k]) * along[low])
    return worst, when


def broken_on_lines(problems: Sequence[SelectionProblem], zs: list[Vector]) -> tuple[str, ...]:
    """What is broken on the straight lines between targets, where the constraints that hold at these are not kept."""
    along, told = np.linspace(0.0, 1.0, WATCHED + 2)[1:-1], list[str]()
    for k in range(len(zs) - 1):
        if breaks := broken_on(_of_both(*problems[k : k + 2]), partial(_line, problems, zs, k), along):
            told.append(f"on the straight way from target {k + 1} to target {k + 2} it {breaks}")
    return tuple(told)


def _of_both(one: SelectionProblem, other: SelectionProblem) -> SelectionProblem:
    """The first of two targets' problems, where the base may stand for either: their own bounds are its reach."""
    pairs = zip(one.variables, other.variables, strict=True)
    spans = (replace(a, lower=min(a.lower, b.lower), upper=max(a.upper, b.upper)) for a, b in pairs)
    return replace(one, variables=tuple(spans))


def _line(
    problems: Sequence[SelectionProblem], zs: list[Vector], k: int, along: Vector
) -> tuple[Vector, NDArray[np.bool_]]:
    """Configurations (n_z, N) at shares of the way to the target after k, base and end-point on lines; which are."""
    plant = problems[0].measures.plant
    z = zs[k][:, None] + (zs[k + 1] - zs[k])[:, None] * along
    ends = problems[k].target, problems[k + 1].target
    targets = ends[0][:, None] + (ends[1] - ends[0])[:, None] * along
    solve = solve_held if problems[0].gravity else solve_postures
    postures, left = solve(plant, targets, z[: plant.n_base], z[plant.n_base :])
    return np.vstack([z[: plant.n_base], postures]), left <= REACHED


def travelled(machine: AnyMachine, bases: Vector) -> tuple[float, float]:
    """The length of a way of the base (K, n_b), m, and its turning, rad."""
    moved = np.diff(bases, axis=0)
    lengths = np.array([unit == "m" for unit in machine.base_units])
    return float(np.linalg.norm(moved[:, lengths], axis=1).sum()), float(np.abs(moved[:, ~lengths]).sum())
