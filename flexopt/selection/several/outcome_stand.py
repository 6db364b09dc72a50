"""One placement for several targets by what the real loop does at each: the worst target counts.

In: a configuration problem for each target, a loop. Out: an `OutcomeStand`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexopt.foundation.arrays import Progress, Vector
from flexopt.foundation.documents import provenance
from flexopt.plant.inverse_kinematics import low_discrepancy
from flexopt.selection.continua import unwound
from flexopt.selection.outcomes.asked import Asked
from flexopt.selection.outcomes.shared import SharedProgram
from flexopt.selection.outcomes.starting import values_at
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.several.by_loop import ByLoop, climbs_from, places_by_loop, shared_program
from flexopt.selection.several.postures import Reached, reached_from
from flexopt.selection.several.results import Stand
from flexopt.selection.several.standing import one_placement, other_placements
from flexopt.selection.several.targets import none_reaches_all

# Postures of a target that are looked at from a placement.
POSTURES = 6


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
        InputError, NoSolutionFound: as `outcome_selection`.
        UnreachableTarget: from none of the placements all targets are reached.
    """
    first = problems[0]
    n_base = len(first.machine.base_coordinates)
    found = [reached_from(problem, bases, problem.seed) for problem in problems]
    whole = np.flatnonzero(np.all([np.isfinite(reached.value).any(axis=1) for reached in found], axis=0))
    if not whole.size:
        raise none_reaches_all(len(problems))
    z = found[0].z[:, whole[0], int(np.argmax(np.isfinite(found[0].value[whole[0]])))]
    coupling = one_placement(problems, np.ones(len(problems)), weighted=False).coupling
    program = shared_program(asked, problems, coupling, np.zeros(0), z)
    looked = _looked(program, found, whole, workers)
    chosen, optima, unverified, attempts = climbs_from(program, looked, workers, progress)
    best, sign = optima[0], chosen.measure.sign
    ways = [[unwound(target.problem, target.z(part)) for target, part in chosen.parts(each.y)] for each in optima]
    own = zip(ways[0], chosen.parts(best.y), strict=True)
    y = chosen.joined([np.append(z / target.problem.scale, part[z.size :]) for z, (target, part) in own])
    found_at = [(sign * each.value, zs) for each, zs in zip(optima, ways, strict=True)]
    return OutcomeStand(
        places=places_by_loop(chosen, y),
        worth=sign * best.value,
        **other_placements(found_at, first.scale[:n_base]),
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


def _looked(program: SharedProgram, found: list[Reached], whole: Any, workers: int) -> list[Vector]:
    """Points y: placements that reach all targets, gains from their ranges, and the best of some postures for each."""
    count, measure, ranges = len(program.problems), program.measure, program.ranges
    unit = low_discrepancy(1 + len(ranges), max(1, measure.looked // count), program.problem.seed)
    ends = program.bounds
    gains = ends[0][program.n_z :] + unit[1:].T * (ends[1] - ends[0])[program.n_z :]
    numbers = whole[np.minimum((unit[0] * whole.size).astype(int), whole.size - 1)]
    picked = list[list[Vector]]()
    for target, reached in zip(program.targets, found, strict=True):
        ys, of = list[Vector](), list[int]()
        for i, j in enumerate(numbers.tolist()):
            postures = np.flatnonzero(np.isfinite(reached.value[j]))
            # Even numbers of those that are allowed.
            some = postures[np.linspace(0, len(postures) - 1, min(POSTURES, len(postures))).astype(int)]
            ys += [np.append(reached.z[:, j, c] / target.problem.scale, gains[i]) for c in some]
            of += [i] * len(some)
        values = values_at(target, ys, workers)
        best = dict[int, tuple[float, Vector]]()
        for i, value, y in zip(of, values, ys, strict=True):
            if i not in best or value > best[i][0]:
                best[i] = value, y
        picked.append([best[i][1] for i in range(len(numbers))])
    return [program.joined([own[i] for own in picked]) for i in range(len(numbers))]
