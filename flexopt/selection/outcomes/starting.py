"""Where climbs of a measure of the loop start: points are looked at, the best of them make some steps.

In: an `OutcomeProgram`, configurations. Out: starts that stand apart, the best first.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from flexopt.errors import NoSolutionFound
from flexopt.foundation.arrays import Vector
from flexopt.foundation.processes import in_parallel
from flexopt.loop.uncertain import MEMBERS
from flexopt.plant.inverse_kinematics import low_discrepancy
from flexopt.selection.outcomes.climb import ahead
from flexopt.selection.outcomes.program import OutcomeProgram

# How far starts stand apart, in scaled variables, and how many climb to the end. Basins are narrow: a measure's stages,
# few steps from many starts, find more than many from few.
APART, CLIMBED = 0.5, 8
# Points nearer than this after some steps are on their way to one optimum.
ALIKE = 0.1
# Points that a process looks at together.
BLOCK = 50
# How often members are sought at the best points; two that are nearer to each other are one.
WIDENED, SAME_MEMBER = 2, 0.05
# Of points whose values are not found in stacks so many, the best, are kept when members are added.
KEPT = 128
# The program, points y that have a value, and these.
Valued = tuple[OutcomeProgram, list[Vector], list[float]]


# With gains that are chosen, so many of them for a seed that has none.
GAINS_OF_SEED = 12


class Seed(NamedTuple):
    """A configuration z to start from, and the gains that were chosen with it."""

    z: Vector
    gains: Mapping[str, float] = {}


def starting_points(
    program: OutcomeProgram, pool: Vector, workers: int, seeds: Sequence[Seed] = ()
) -> tuple[OutcomeProgram, list[Vector]]:
    """The program with the size of its values, and starts y.

    Args:
        pool: feasible configurations (N, n_z), the present one first.
        seeds: configurations that are looked at whatever is drawn from the pool.

    Raises:
        NoSolutionFound: no point has the measure, or leads to what the loop must do at least.
    """
    return starts_from(program, [*_sown(program, seeds), *_looked(program, pool)], workers)


def starts_from(program: OutcomeProgram, looked: list[Vector], workers: int) -> tuple[OutcomeProgram, list[Vector]]:
    """The like from points y that are looked at; the program then has the slowest members at the best of them, too."""
    known = _raised(program, looked, _values_of(program, looked, workers), workers)
    for _ in range(WIDENED):
        wider = None if known is None else _widened(*known, workers)
        if wider is None:
            break
        known = _raised(*wider, workers)
    if known is None:
        raise _nothing(program, f"has the measure {program.measure.name}: {program.measure.lacking}")
    program, ys, values = known
    ys, values, distance = _some_steps(program, ys, values, workers)
    return program, [ys[k] for k in _apart(program, ys, values, CLIMBED, distance)]


def _raised(program: OutcomeProgram, ys: list[Vector], values: list[float], workers: int) -> Valued | None:
    """Points that have the measure; where none does what the loop must at least, some are climbed to where it does."""
    known = _known(program, ys, values)
    if known is not None or not program.least:
        return known
    ys, nearest = lifted(program, ys, workers)
    known = _known(program, ys, _values_of(program, ys, workers))
    if known is None:
        asked = ", ".join(each.asked(x) for each, x in program.least)
        raise _nothing(program, f"leads to what it must do, {asked}{nearest}")
    return known


def _nothing(program: OutcomeProgram, what: str) -> NoSolutionFound:
    sentence = f"select: none of {program.measure.looked} configurations that were looked at {what}"
    return NoSolutionFound(sentence, violations={}, iterate={})


def _widened(program: OutcomeProgram, ys: list[Vector], values: list[float], workers: int) -> Valued | None:
    """The program with members that are the slowest at the best points y, too, and the values; None where it has them.

    Where values are not found in stacks only the best points are kept.
    """
    if not len(program.members):
        return None
    best = [ys[k] for k in _apart(program, ys, values, CLIMBED, APART)]
    found = in_parallel(partial(_slower, program, best), len(best), workers, at_once=len(best) > 1)
    members = list(program.members)
    for u in (u for each in found for u in each):
        if all(np.abs(u - other).max() > SAME_MEMBER for other in members):
            members.append(u)
    more = np.array(members[len(program.members) :])
    if not len(more):
        return None
    kept: list[int] = np.argsort(-np.array(values), kind="stable").tolist()
    kept = kept if program.measure.of_rates and not program.least else kept[:KEPT]
    ys = [ys[k] for k in kept]
    own = _values_of(replace(program, members=more), ys, workers)
    both = [min(values[k], value) for k, value in zip(kept, own, strict=True)]
    return replace(program, members=np.array(members)), ys, both


def _slower(program: OutcomeProgram, ys: list[Vector], number: int) -> list[Vector]:
    known = np.concatenate([program.members, program.loop.box.members(MEMBERS)])
    return [part.at(own).slower(known) for part, own in program.parts(ys[number])]


def _looked(program: OutcomeProgram, pool: Vector) -> list[Vector]:
    """Points y: configurations of the pool with gains from their ranges."""
    unit = low_discrepancy(1 + len(program.ranges), program.measure.looked, program.problem.seed)
    lower, upper = (end[program.n_z :] for end in program.bounds)
    # The present configuration is the first of the pool.
    places = [0, *np.minimum((unit[0, 1:] * len(pool)).astype(int), len(pool) - 1).tolist()]
    gains = lower + unit[1:].T * (upper - lower)
    return [np.append(pool[k] / program.problem.scale, own) for k, own in zip(places, gains, strict=True)]


def _sown(program: OutcomeProgram, seeds: Sequence[Seed]) -> list[Vector]:
    """Points y of seeds, with their gains or some from the ranges."""
    lower, upper = (end[program.n_z :] for end in program.bounds)
    unit = low_discrepancy(max(1, len(program.ranges)), GAINS_OF_SEED, program.problem.seed)
    found = list[Vector]()
    for seed in seeds:
        own = [np.log([seed.gains[name] for name in program.ranges])] if seed.gains else list[Vector]()
        drawn = lower + unit[: len(program.ranges)].T * (upper - lower) if program.ranges else np.zeros((1, 0))
        found += [np.append(seed.z / program.problem.scale, gains) for gains in own or list(drawn)]
    return found


def _known(program: OutcomeProgram, ys: list[Vector], values: list[float]) -> Valued | None:
    """The program with the size of its values, points that have one, and these; None where none has."""
    known = [k for k, value in enumerate(values) if math.isfinite(value)]
    if not known:
        return None
    program = replace(program, size=max(abs(max(values)), np.finfo(float).tiny))
    return program, [ys[k] for k in known], [values[k] for k in known]


def _values_of(program: OutcomeProgram, ys: list[Vector], workers: int) -> list[float]:
    # In stacks nothing is known of what the loop must do at least.
    return (_in_blocks if program.least else values_at)(program, ys, workers)


def values_at(program: OutcomeProgram, ys: list[Vector], workers: int) -> list[float]:
    """The worst member's measure at many points, in stacks or in processes."""
    values = program.measure.values(program, ys, workers) if ys else []
    return _in_blocks(program, ys, workers) if values is None else values


def _in_blocks(program: OutcomeProgram, ys: list[Vector], workers: int) -> list[float]:
    blocks = [ys[k : k + BLOCK] for k in range(0, len(ys), BLOCK)]
    found = in_parallel(partial(_values, program, blocks), len(blocks), workers)
    return [value for block in found for value in block]


def _some_steps(
    program: OutcomeProgram, ys: list[Vector], values: list[float], workers: int
) -> tuple[list[Vector], list[float], float]:
    """Where the measure's stages lead, the values there, and how far apart points then count as two."""
    distance = APART
    for part, _ in program.parts(ys[0]):
        # Made before processes part, each of which would make it for itself.
        _ = part.loop.settings.motions(part.problem.machine, gravity=part.problem.gravity).slopes
    for most, steps in program.measure.stages:
        chosen = [ys[k] for k in _apart(program, ys, values, min(most, program.problem.starts or most), distance)]
        done = in_parallel(partial(_ahead, program, chosen, steps), len(chosen), workers, at_once=len(chosen) > 1)
        ys, values = [y for y, _ in done], [value for _, value in done]
        distance = ALIKE
    return ys, values, distance


def lifted(program: OutcomeProgram, ys: list[Vector], workers: int) -> tuple[list[Vector], str]:
    """Points where the loop does what it must at least, by climbing one of these after another; none where none is.

    Then what comes nearest is told, a sentence.
    """
    for k, (measure, least) in enumerate(program.least):
        part = replace(program, measure=measure, least=program.least[:k])
        known = _known(part, ys, _values_of(part, ys, workers))
        if known is None:
            return [], ""
        ys, values, _ = _some_steps(*known, workers)
        best, unit = measure.sign * max(values), measure.unit_of(program.loop.settings)
        ys = [y for y, value in zip(ys, values, strict=True) if value >= least]
        if not ys:
            return [], f"; the nearest is {measure.told} {best:.4g} {unit}".rstrip()
    return ys, ""


def _values(program: OutcomeProgram, blocks: list[list[Vector]], number: int) -> list[float]:
    return [program.value(y) for y in blocks[number]]


def _apart(program: OutcomeProgram, ys: list[Vector], values: list[float], count: int, distance: float) -> list[int]:
    """Numbers of the best points, so many at most, none nearer to a better one than a distance."""
    chosen = list[int]()
    order: list[int] = np.argsort(-np.array(values), kind="stable").tolist()
    for k in order:
        if len(chosen) == count:
            break
        if all(separation(program, ys[k], ys[other]) > distance for other in chosen):
            chosen.append(k)
    return chosen


def separation(program: OutcomeProgram, y: Vector, other: Vector) -> float:
    """The largest scaled difference of two points, of angles without limits the short way round."""
    away, turning = other - y, program.turning
    inside = away[: program.n_z]
    inside[turning] = (inside[turning] + math.pi) % math.tau - math.pi
    return float(np.max(np.abs(away)))


def _ahead(program: OutcomeProgram, starts: list[Vector], steps: int, number: int) -> tuple[Vector, float]:
    return ahead(program, starts[number], steps)
