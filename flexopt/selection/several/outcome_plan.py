"""A way of the base along a path by what the real loop does: the worst target counts, and then the length of the way.

In: a configuration problem for each target, the steps between them, a loop. Out: an `OutcomePlan`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np

from flexopt.errors import NoSolutionFound
from flexopt.foundation.arrays import Progress, Vector
from flexopt.foundation.documents import provenance
from flexopt.plant.inverse_kinematics import low_discrepancy
from flexopt.selection.assumed import in_the_way
from flexopt.selection.nlp.program import Program
from flexopt.selection.outcomes.asked import Asked
from flexopt.selection.outcomes.climb import Climbed, climbed
from flexopt.selection.outcomes.program import least_over
from flexopt.selection.outcomes.shared import SharedProgram, ShortestWay
from flexopt.selection.outcomes.starting import values_at
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.several.by_loop import ByLoop, climbs_from, places_by_loop, shared_program
from flexopt.selection.several.postures import Reached
from flexopt.selection.several.results import BasePlan, FixedPlacement
from flexopt.selection.several.standing import standing_along
from flexopt.selection.several.ways import Layer, coarse_ways, no_way, nodes_of, on_lines, travelled
from flexopt.selection.starts import kept_by_none

# Gains with which coarse ways are looked for, where they are chosen; ways for each.
GAINS, WAYS = 6, 3
# Configurations of a target that these are made of: as many times the points that a measure looks at, together, but not
# fewer for a target than so many.
NODES, FEWEST = 4, 60
# Of the best value, what the shortest way may give up.
SLACK = 1e-4


@dataclass(frozen=True, repr=False)
class OutcomePlan(ByLoop, BasePlan):
    """A motion of the base along a path by what the loop does; see `BasePlan` and `ByLoop`."""

    @property
    def standing(self) -> float:
        """The worst of the base that stands still, NaN where none reaches all targets at the joints' rates."""
        sign = self.criterion.sign
        return math.nan if self.still is None else sign * float((sign * self.still.V).min())

    @property
    def _ways(self) -> str:
        still = (
            "no placement reaches them all at these rates"
            if self.still is None
            else f"{self._told(self.standing)} standing still"
        )
        bound = "least" if self.criterion.sign > 0 else "most"
        between = f"between the targets at {bound} {self._told(self.between[0])}"
        return f"worst {self.measure} {self._told(self.worth)} ({still}); {between}"

    def _told(self, value: float) -> str:
        return f"{value:.4g} {self.unit}".rstrip()


def outcome_plan(
    along: Program,
    due: Vector,
    begin: Vector | None,
    common: Vector,
    found: list[list[Reached]],
    asked: Asked,
    workers: int,
    progress: Progress | None,
) -> OutcomePlan:
    """The shortest of the ways that keep the best of the worst target's measure, verified to first order.

    Args:
        along: the program of the modes' objective on these targets; its objective is not asked.
        due: when each target is due, (K,), s.
        begin: where the base stands at the first target, (n_b,).
        common: placements (n_b, N) from which all may be reached;  found: for each target what is reached.
        asked: of the loop.
        workers, progress: as of `flexopt.plan_base`.

    Raises:
        InputError, NoSolutionFound: as `outcome_selection`; or no way was found to start from.
    """
    problems = along.problems
    layers = [nodes_of(reached) for reached in found]
    if any(not values.size for _, values in layers):
        raise _kept_nowhere(problems, layers)
    program = shared_program(asked, problems, along.coupling, along.steps, layers[0][0][:, 0], begin)
    still = _standing(program, along, common, found, workers)
    looked = _looked(program, along, [_thinned(layer, _most(program)) for layer in layers], workers)
    looked += [] if still is None else [program.joined([own for _, own in still[0].parts(still[1].y)])]
    if not looked:
        raise no_way()
    chosen, optima, unverified, attempts = climbs_from(program, looked, workers, progress)
    best = _shortest(chosen, optima[0])
    x = along.unwound(chosen.z(best.y))
    y = np.append(x / along.scale, best.y[chosen.n_z :])
    places, sign = places_by_loop(chosen, y), chosen.measure.sign
    gains = y[chosen.n_z :]

    def worth(k: int, z: Vector) -> Vector:
        # Of the measure itself: what the loop must do at least is asked at the targets.
        target = replace(chosen.targets[k], least=())
        return np.array(values_at(target, [np.append(own / first.scale, gains) for own in z.T], workers))

    first = problems[0]
    between, when = on_lines(problems, due, [along.of(x, k) for k in range(len(problems))], worth)
    return OutcomePlan(
        time=due,
        places=places,
        still=None if still is None else _fixed(*still),
        between=(sign * between, when),
        travelled=travelled(first.machine, np.array([place.evaluation.base for place in places])),
        stationarity=best.stationarity,
        kinks={},
        attempts=attempts,
        problems=problems,
        provenance=provenance(
            first.machine, path=[p.target.tolist() for p in problems], times=due.tolist(),
            start=None if begin is None else begin.tolist(), **asked.stated(first),
        ),
        asked=asked,
        criterion=chosen.measure,
        settings=chosen.at(y).settings,
        unverified=unverified,
    )  # fmt: skip


def _kept_nowhere(problems: tuple[SelectionProblem, ...], layers: list[Layer]) -> NoSolutionFound:
    """The error where a target has no configuration that keeps every constraint; which are short is told of each."""
    told = list[str]()
    for k, (problem, (_, values)) in enumerate(zip(problems, layers, strict=True), start=1):
        if not values.size:
            short = kept_by_none(problem) or "no configuration that was looked at keeps every constraint"
            told.append(f"target {k}: {short}")
    sentence = f"plan_base: {'; '.join(told)}{in_the_way(problems[0].assumed)}"
    return NoSolutionFound(sentence, violations={}, iterate={})


def _standing(
    program: SharedProgram, along: Program, common: Vector, found: list[list[Reached]], workers: int
) -> tuple[SharedProgram, Climbed] | None:
    """The program of one placement whose joints keep their rates, and its best; None where there is none.

    `program`: that of the way, whose loop and beginning these are, too.
    """
    coupling, joints, steps = standing_along(along)
    still = replace(program, coupling=coupling, steps=joints)
    some = np.linspace(0, common.shape[1] - 1, min(_most(program), common.shape[1]), dtype=int)
    layers = [_allowed(first.z[:, some], first.value[some]) for first, *_ in found]
    looked = _looked(program, replace(along, steps=steps), layers, workers)
    if not looked:
        return None
    ys = [still.joined([own for _, own in program.parts(y)]) for y in looked]
    try:
        found_there = climbs_from(still, ys, workers)
    except NoSolutionFound:
        return None
    return found_there.program, found_there.optima[0]


def _fixed(program: SharedProgram, end: Climbed) -> FixedPlacement:
    zs = [target.z(own) for target, own in program.parts(end.y)]
    values = program.measure.sign * np.array(program.values(end.y))
    return FixedPlacement.of(len(program.problem.machine.base_coordinates), zs, values)


def _allowed(z: Vector, value: Vector) -> Layer:
    """Those of configurations (n_z, N, C) that are allowed."""
    good = np.isfinite(value).ravel()
    return z.reshape(len(z), -1)[:, good], value.ravel()[good]


def _gains(program: SharedProgram) -> Vector:
    """Logarithms of gains that ways are looked for with, (N, …), from their ranges."""
    lower, upper = (end[program.n_z :] for end in program.bounds)
    if not lower.size:
        return np.zeros((1, 0))
    return lower + low_discrepancy(lower.size, GAINS, program.problem.seed).T * (upper - lower)


def _most(program: SharedProgram) -> int:
    """Configurations of a target that are looked at."""
    return max(FEWEST, NODES * program.measure.looked // (len(program.problems) * len(_gains(program))))


def _thinned(layer: Layer, most: int) -> Layer:
    some = np.linspace(0, layer[0].shape[1] - 1, min(most, layer[0].shape[1]), dtype=int)
    return layer[0][:, some], layer[1][some]


def _looked(program: SharedProgram, along: Program, layers: list[Layer], workers: int) -> list[Vector]:
    """Coarse ways y through configurations of every target; none where a target has none."""
    found = list[Vector]()
    if not all(values.size for _, values in layers):
        return found
    for gains in _gains(program):
        valued = list[Layer]()
        for target, (z, _) in zip(program.targets, layers, strict=True):
            ys = [np.append(own / target.problem.scale, gains) for own in z.T]
            values = np.array(values_at(target, ys, workers))
            valued.append((z[:, np.isfinite(values)], values[np.isfinite(values)]))
        found += [np.append(x / along.scale, gains) for x in coarse_ways(along, valued, WAYS)]
    return found


def _shortest(program: SharedProgram, best: Climbed) -> Climbed:
    """The shortest way near the best one that keeps what it has."""
    kept = best.value - SLACK * abs(best.value)
    way = ShortestWay(**{each.name: getattr(program, each.name) for each in fields(program)}, kept=kept)
    found = climbed(way, best.y)
    if found is None or not found.holds or way.length(found.y) >= way.length(best.y):
        return best
    value = least_over(program, found.y)[0] if len(program.members) else program.value(found.y)
    return replace(found, value=value) if value >= kept - SLACK * abs(kept) else best
