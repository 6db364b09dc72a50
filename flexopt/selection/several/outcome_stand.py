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
from flexopt.selection.several.by_loop import ByLoop, Climbs, climbs_from, places_by_loop, shared_program
from flexopt.selection.several.postures import Reached, joined, reached_from
from flexopt.selection.several.results import Stand
from flexopt.selection.several.standing import kept_somewhere, one_placement, other_placements

# Postures of a target that are looked at from a placement.
POSTURES = 6
# So many times the usual number of postures is reached where the base stands in one placement.
FINER = 6


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
    finer = FINER if bases.shape[1] == 1 else 1
    found = [reached_from(problem, bases, problem.seed, finer) for problem in problems]
    if not (whole := _allowed(found)).size:
        bases, kept = kept_somewhere(problems, bases, found, workers)
        # Held otherwise there, too: what is best for the problems' own objective need not be for the loop.
        again = [reached_from(problem, bases, problem.seed, FINER) for problem in problems]
        found = [joined(one, other) for one, other in zip(kept, again, strict=True)]
        whole = _allowed(found)
    z = found[0].z[:, whole[0], int(np.argmax(np.isfinite(found[0].value[whole[0]])))]
    coupling = one_placement(problems, np.ones(len(problems)), weighted=False).coupling
    program = shared_program(asked, problems, coupling, np.zeros(0), z)
    return climbs_from(program, _looked(program, found, whole, workers), workers, progress)


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


def _looked(program: SharedProgram, found: list[Reached], whole: Any, workers: int) -> list[Vector]:
    """Points y: placements that reach all targets, gains from their ranges, and the best of some postures for each.

    Of few placements without gains more postures are looked at, and the second best, … of each, too.
    """
    count, measure, ranges = len(program.problems), program.measure, program.ranges
    unit = low_discrepancy(1 + len(ranges), max(1, measure.looked // count), program.problem.seed)
    ends = program.bounds
    gains = ends[0][program.n_z :] + unit[1:].T * (ends[1] - ends[0])[program.n_z :]
    numbers = whole[np.minimum((unit[0] * whole.size).astype(int), whole.size - 1)].tolist()
    # Without gains a placement that is drawn again is the same point.
    numbers = numbers if ranges else list(dict.fromkeys(numbers))
    more = max(1, len(gains) // (POSTURES * len(numbers)))
    picked = list[list[list[Vector]]]()
    for target, reached in zip(program.targets, found, strict=True):
        ys, of = list[Vector](), list[int]()
        for i, j in enumerate(numbers):
            postures = np.flatnonzero(np.isfinite(reached.value[j]))
            # Even numbers of those that are allowed.
            some = postures[np.linspace(0, len(postures) - 1, min(more * POSTURES, len(postures))).astype(int)]
            ys += [np.append(reached.z[:, j, c] / target.problem.scale, gains[i]) for c in some]
            of += [i] * len(some)
        values = values_at(target, ys, workers)
        best: list[list[Vector]] = [[] for _ in numbers]
        order: list[int] = np.argsort(-np.array(values), kind="stable").tolist()
        for k in order:
            best[of[k]].append(ys[k])
        picked.append(best)
    each = (zip(*(own[i] for own in picked), strict=False) for i in range(len(numbers)))
    return [program.joined(list(parts)) for ranked in each for parts in islice(ranked, more)]
