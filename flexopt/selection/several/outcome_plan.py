"""A way of the base along a path by what the real loop does: the worst target counts, and then the length of the way.

In: a configuration problem for each target, the steps between them, a loop. Out: an `OutcomePlan`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
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
from flexopt.selection.several.by_loop import (
    STANDS,
    ByLoop,
    climbs_from,
    most_looked,
    places_by_loop,
    reached_finer,
    shared_program,
)
from flexopt.selection.several.postures import Reached
from flexopt.selection.several.results import BasePlan, FixedPlacement
from flexopt.selection.several.standing import spread, standing_along
from flexopt.selection.several.ways import (
    Layer,
    broken_on_lines,
    coarse_ways,
    distinct,
    no_way,
    nodes_of,
    on_lines,
    travelled,
    ways_of_lengths,
)
from flexopt.selection.starts import kept_by_none

# Gains with which coarse ways are looked for, where they are chosen; ways for each.
GAINS, WAYS = 6, 3
# Postures of a placement that are looked at where the base stands still, at least.
POSTURES = 4
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
    looked = _looked(program, along, [_thinned(layer, _most(program)) for layer in layers], coarse_ways, workers)
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
        broken_between=broken_on_lines(problems, [along.of(x, k) for k in range(len(problems))]),
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
    along = replace(along, steps=steps)

    def looked_at(reached: list[Reached]) -> list[Vector]:
        most = max(POSTURES, _most(program) // max(1, len(reached[0].value)))
        return _looked(program, along, [_held_at(each, most) for each in reached], _ways_of_placements, workers)

    some = np.linspace(0, common.shape[1] - 1, min(_most(program), common.shape[1]), dtype=int)
    looked = looked_at([each.of(some.tolist()) for each, *_ in found])
    if not looked:
        return None
    best = np.unique([along.of(y[: program.n_z] * along.scale, 0)[: common.shape[0]] for y in looked], axis=0).T
    looked += looked_at(reached_finer(along.problems, best))
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


def _held_at(reached: Reached, most: int) -> Layer:
    """Of each placement so many of the postures that are allowed, at even numbers, of the next one others."""
    kept = np.zeros(reached.value.shape, dtype=bool)
    for j, allowed in enumerate(np.isfinite(reached.value)):
        postures = np.flatnonzero(allowed)
        count = min(most, postures.size)
        kept[j, postures[(j + np.arange(count) * postures.size // max(1, count)) % max(1, postures.size)]] = True
    return reached.z[:, kept], reached.value[kept]


def _gains(program: SharedProgram) -> Vector:
    """Logarithms of gains that ways are looked for with, (N, …), from their ranges."""
    lower, upper = (end[program.n_z :] for end in program.bounds)
    if not lower.size:
        return np.zeros((1, 0))
    return lower + low_discrepancy(lower.size, GAINS, program.problem.seed).T * (upper - lower)


def _most(program: SharedProgram) -> int:
    """Configurations of a target that are looked at."""
    return most_looked(program, len(_gains(program)))


def _thinned(layer: Layer, most: int) -> Layer:
    some = np.linspace(0, layer[0].shape[1] - 1, min(most, layer[0].shape[1]), dtype=int)
    return layer[0][:, some], layer[1][some]


def _ways_of_placements(along: Program, layers: list[Layer], count: int) -> list[Vector]:
    """Coarse ways on which the base stands still: the best of several lengths, so many, and of other placements."""
    n_b = along.first.measures.plant.n_base
    bases = np.unique(layers[0][0][:n_b], axis=1)
    of_placements = list[list[tuple[float, Vector]]]()
    for base in bases.T:
        there = [(z[:n_b] == base[:, None]).all(axis=0) for z, _ in layers]
        own = [(z[:, at], values[at]) for (z, values), at in zip(layers, there, strict=True)]
        of_placements.append(ways_of_lengths(along, own))
    ranked = list[list[Vector]]()
    for ways in zip(*of_placements, strict=True):
        chosen = spread(bases, np.array([worth for worth, _ in ways]), STANDS)
        ranked += [[ways[j][1] for j in chosen]] if chosen else []
    return [*distinct([ways[0] for ways in ranked])[:count], *(ranked[0][1:] if ranked else [])]


def _looked(
    program: SharedProgram,
    along: Program,
    layers: list[Layer],
    ways: Callable[[Program, list[Layer], int], list[Vector]],
    workers: int,
) -> list[Vector]:
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
        found += [np.append(x / along.scale, gains) for x in ways(along, valued, WAYS)]
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
