"""One placement for several targets by what the real loop does at each: the worst target counts.

In: a configuration problem for each target, a loop. Out: an `OutcomeStand`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Progress, Vector
from flexopt.foundation.documents import provenance
from flexopt.plant.inverse_kinematics import low_discrepancy
from flexopt.selection.continua import nearest_stand
from flexopt.selection.outcomes.asked import Asked
from flexopt.selection.outcomes.choice import EQUAL
from flexopt.selection.outcomes.shared import SharedProgram
from flexopt.selection.outcomes.starting import values_at
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.several.by_loop import (
    STANDS,
    ByLoop,
    Climbs,
    climbs_from,
    most_looked,
    places_by_loop,
    reached_finer,
    shared_program,
)
from flexopt.selection.several.postures import Reached, joined, reached_from
from flexopt.selection.several.results import Stand
from flexopt.selection.several.standing import kept_somewhere, one_placement, other_placements, spread

# Postures of a target that are looked at from a placement.
POSTURES = 6
# Points y of one placement that were looked at, the best of them first, with the worst target's measure there.
LookedAt = list[tuple[float, Vector]]


@dataclass(frozen=True, repr=False)
class OutcomeStand(ByLoop, Stand):
    """One placement for several targets by what the loop does; see `Stand` and `ByLoop`."""


def outcome_stand(
    problems: tuple[SelectionProblem, ...],
    bases: Vector,
    asked: Asked,
    workers: int,
    progress: Progress | None,
) -> OutcomeStand:
    """Local optima of the worst target's measure, verified to first order; the best.

    Args:
        problems: from `build_problems`; their objective is not asked.
        bases: placements (n_b, N) that are looked at.
        asked: of the loop.
        workers, progress: as of `flexopt.select_stand`.

    Raises:
        InputError, NoSolutionFound: as `outcome_selection`, and as `kept_somewhere`.
        UnreachableTarget: from none of the placements all targets are reached.
    """
    first = problems[0]
    chosen, optima, unverified, attempts = _climbed(problems, bases, asked, workers, progress)
    best, sign = optima[0], chosen.measure.sign
    ways = [_configurations(chosen, each.y) for each in optima]
    y = joined_at(chosen, best.y, ways[0])
    found_at = [(sign * each.value, zs) for each, zs in zip(optima, ways, strict=True)]
    return OutcomeStand(
        places=places_by_loop(chosen, y),
        worth=sign * best.value,
        **other_placements(found_at, first.scale[: len(first.machine.base_coordinates)]),
        stationarity=best.stationarity,
        kinks={},
        attempts=attempts,
        problems=problems,
        provenance=provenance(first.machine, targets=[p.target.tolist() for p in problems], **asked.stated(first)),
        asked=asked,
        criterion=chosen.measure,
        settings=chosen.at(best.y).settings,
        unverified=unverified,
    )


def held_by_loop(problems: tuple[SelectionProblem, ...], base: Vector, asked: Asked) -> list[Vector]:
    """[base, posture] at each target of the best way to stand in one placement (n_b,), which the problems hold.

    Gains are not chosen.

    Raises:
        NoSolutionFound, UnreachableTarget: as `outcome_stand`.
    """
    program, optima, *_ = _climbed(problems, base[:, None], asked, 1, None)
    return _configurations(program, optima[0].y)


def _climbed(
    problems: tuple[SelectionProblem, ...],
    bases: Vector,
    asked: Asked,
    workers: int,
    progress: Progress | None,
) -> Climbs:
    """Where climbs from the best of what was looked at lead."""
    # Of one placement there is time for more postures.
    finer = bases.shape[1] == 1
    found = reached_finer(problems, bases) if finer else [reached_from(each, bases, each.seed) for each in problems]
    if not (whole := _allowed(found)).size:
        bases, kept = kept_somewhere(problems, bases, found, workers)
        # Held otherwise there, too: what is best for the problems' own objective need not be for the loop.
        found = [joined(one, other) for one, other in zip(kept, reached_finer(problems, bases), strict=True)]
        whole, finer = _allowed(found), True
    z = found[0].z[:, whole[0], int(np.argmax(np.isfinite(found[0].value[whole[0]])))]
    coupling = one_placement(problems, np.ones(len(problems)), weighted=False).coupling
    program = shared_program(asked, problems, coupling, np.zeros(0), z)
    held = _looked(program, found, whole, workers)
    plant = problems[0].measures.plant
    # An arm that is not redundant has few postures, which have been looked at.
    if not finer and plant.n_actuated > plant.n_task:
        held += _looked_finer(program, held, workers)
    return climbs_from(program, [y for of_one in held for _, y in of_one], workers, progress)


def _allowed(found: list[Reached]) -> NDArray[np.int64]:
    """Numbers of the placements from which every target is reached, all constraints kept."""
    return np.flatnonzero(np.all([np.isfinite(reached.value).any(axis=1) for reached in found], axis=0))


def _configurations(program: SharedProgram, y: Vector) -> list[Vector]:
    """[base, posture] at each target, of those that have as much of the measure the nearest to the present ones."""
    parts, value = program.parts(y), min(program.values(y))

    def keeps(zs: list[Vector]) -> bool:
        return abs(min(program.values(joined_at(program, y, zs))) - value) <= EQUAL * abs(value)

    return nearest_stand(program.problems, [target.z(own) for target, own in parts], keeps)


def joined_at(program: SharedProgram, y: Vector, zs: list[Vector]) -> Vector:
    """The point y with these configurations [base, posture] at each target."""
    parts = zip(zs, program.parts(y), strict=True)
    return program.joined([np.append(z / target.problem.scale, own[z.size :]) for z, (target, own) in parts])


def _looked(program: SharedProgram, found: list[Reached], whole: Any, workers: int) -> list[LookedAt]:
    """Placements that reach all targets, with gains from their ranges, as `_held`.

    Of few placements without gains more postures are looked at.
    """
    count, measure, ranges = len(program.problems), program.measure, program.ranges
    unit = low_discrepancy(1 + len(ranges), max(1, measure.looked // count), program.problem.seed)
    ends = program.bounds
    gains = ends[0][program.n_z :] + unit[1:].T * (ends[1] - ends[0])[program.n_z :]
    numbers = whole[np.minimum((unit[0] * whole.size).astype(int), whole.size - 1)].tolist()
    # Without gains a placement that is drawn again is the same point.
    numbers = numbers if ranges else list(dict.fromkeys(numbers))
    more = max(1, len(gains) // (POSTURES * len(numbers)))
    return _held(program, [reached.of(numbers) for reached in found], list(gains[: len(numbers)]), more, workers)


def _looked_finer(program: SharedProgram, held: list[LookedAt], workers: int) -> list[LookedAt]:
    """The best of these placements that stand apart, with their gains, as `_held` of a finer sample of postures."""
    best = [of_one[0] for of_one in held if of_one]
    n_b = len(program.problem.machine.base_coordinates)
    bases = np.array([program.z(y)[:n_b] for _, y in best]).reshape(len(best), n_b).T
    chosen = spread(bases, np.array([worth for worth, _ in best]), STANDS)
    if not chosen:
        return []
    gains = [best[k][1][program.n_z :] for k in chosen]
    more = max(1, most_looked(program) // (POSTURES * len(chosen)))
    return _held(program, reached_finer(program.problems, bases[:, chosen]), gains, more, workers)


def _held(program: SharedProgram, found: list[Reached], gains: list[Vector], more: int, workers: int) -> list[LookedAt]:
    """For each placement with its gains the best of some postures for each target, and the second best, … so many."""
    picked = list[list[LookedAt]]()
    for target, reached in zip(program.targets, found, strict=True):
        ys, of = list[Vector](), list[int]()
        for j, own in enumerate(gains):
            postures = np.flatnonzero(np.isfinite(reached.value[j]))
            # Even numbers of those that are allowed.
            some = postures[np.linspace(0, len(postures) - 1, min(more * POSTURES, len(postures))).astype(int)]
            ys += [np.append(reached.z[:, j, c] / target.problem.scale, own) for c in some]
            of += [j] * len(some)
        values = values_at(target, ys, workers)
        best: list[LookedAt] = [[] for _ in gains]
        order: list[int] = np.argsort(-np.array(values), kind="stable").tolist()
        for k in order:
            best[of[k]].append((values[k], ys[k]))
        picked.append(best)
    each = (zip(*(own[j] for own in picked), strict=False) for j in range(len(gains)))
    return [
        [(min(value for value, _ in parts), program.joined([y for _, y in parts])) for parts in islice(ranked, more)]
        for ranked in each
    ]
