"""One solve of problems that belong together, and what its end is worth.

In: a `Program` and a start. Out: a point with everything that it violates; the configurations there; the error
where no start led to one that violates nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from flexopt.errors import NoSolutionFound
from flexopt.foundation.arrays import Progress, Vector
from flexopt.foundation.plain import counted
from flexopt.foundation.processes import in_parallel
from flexopt.selection.assumed import in_the_way
from flexopt.selection.broken import cornerless
from flexopt.selection.constraint_values import violations_told, worst_size
from flexopt.selection.continua import past_stops
from flexopt.selection.nlp.program import SOLVED, Program
from flexopt.selection.optima import (
    SAME_POINT,
    SolveOutcome,
    accepted,
    climbed_from,
    finished,
    nearly_feasible,
    promising,
    solved_once,
    taken_up_again,
)
from flexopt.selection.proof.check import infeasible, prove_program
from flexopt.selection.seen import BETTER
from flexopt.selection.several.results import TargetConfiguration
from flexopt.selection.solve import constraint_values
from flexopt.selection.starts import kept_by_none

# Points that were seen and are better than every optimum: how many are tried. Ends that pass no proof, and are behind
# the best optimum or off the rows: how many of either are climbed from.
TRIED = BEHIND = 4
# Of what an end violates.
NAMED = 8


@dataclass(frozen=True)
class End:
    """Where a solve ended.

    Attributes:
        x: the point;  violations: what it violates, by name, beyond tolerances.
        stationarity: as in `Proof`, 0 where no configuration is better;  kinks: as in `Proof`.
        status: the solver's.
    """

    x: Vector
    violations: dict[str, float]
    stationarity: float
    kinks: dict[str, float]
    status: str


def ends_from(program: Program, starts: list[Vector], workers: int, progress: Progress | None) -> list[End]:
    """One end for each start, in order; those that pass no proof are climbed from where they may lead to more."""

    def lost(number: int, sentence: str) -> SolveOutcome:
        return starts[number], None, 0, sentence

    solved = in_parallel(partial(_solved, program, starts), len(starts), workers, progress, lost=lost)
    stopped = list[int]()
    for k, (x, proof, iterations, status) in enumerate(solved):
        if proof is not None and not proof.holds:
            stopped.append(k)
            # A solver may leave what was feasible.
            if not nearly_feasible(program, x) and nearly_feasible(program, starts[k]):
                solved[k] = starts[k], prove_program(program, starts[k]), iterations, status
    # Some lie off the rows, where the objective tells nothing: the first few are tried.
    off = [k for k in stopped if not nearly_feasible(program, solved[k][0])]
    chosen = sorted({*promising(program, solved, stopped, BEHIND), *off[:BEHIND]})
    points = [solved[k][0] for k in chosen]

    def left(number: int, _: str) -> SolveOutcome:
        return solved[chosen[number]]

    climbed = in_parallel(partial(taken_up_again, program, points), len(points), workers, lost=left)
    for k, found in zip(chosen, climbed, strict=True):
        solved[k] = found
    return [_told(program, found) for found in solved]


def _solved(program: Program, starts: list[Vector], number: int) -> SolveOutcome:
    """Where the solver leads; once more from there where only itself accepts it."""
    found = solved_once(program, starts[number])
    x, proof, _, status = found
    if proof is None or proof.holds or status not in SOLVED:
        return found
    again = solved_once(program, x)
    return again if again[1] is not None and again[1].holds else found


def end_from(program: Program, start: Vector) -> End:
    """Where a start leads, and what the equations say of its end; once more from there where only IPOPT accepts it."""
    end = _end(program, start)
    again = _end(program, end.x) if end.violations and end.status in SOLVED else end
    return end if again.violations else again


def past_ends_of_joints(program: Program, good: list[End]) -> list[End]:
    """The optima; of one that rests at a joint's end, a turn from where it may go on, what is there; each once."""
    kept = list[End]()
    for end in good:
        there = end
        # The joint of another target may come to its end next.
        for _ in range(program.coupling.count):
            zs = [program.of(there.x, k) for k in range(program.coupling.count)]
            turned = [past_stops(problem, z) for problem, z in zip(program.problems, zs, strict=True)]
            if all(z is None for z in turned):
                break
            again = end_from(program, program.packed([z if t is None else t for z, t in zip(zs, turned, strict=True)]))
            least = program.worth(there.x) + BETTER * program.first.objective_scale
            if again.violations or program.worth(again.x) <= least:
                break
            there = again
        if all(np.abs((there.x - other.x) / program.scale).max() > SAME_POINT for other in kept):
            kept.append(there)
    return kept


def _end(program: Program, start: Vector) -> End:
    return _told(program, finished(program, start))


def _told(program: Program, found: SolveOutcome) -> End:
    x, proof, _, status = found
    if proof is None:
        return End(x, {"solver": np.inf}, np.inf, {}, status)
    violations = dict(proof.violations)
    if proof.holds and not accepted(program, proof, status):
        violations["solver"] = 0.0
    return End(x, violations, 0.0 if proof.unsurpassed else proof.stationarity, proof.kinks, status)


def verified(program: Program, ends: list[End], what: str, short: Callable[[], str] = str) -> list[End]:
    """The ends that violate nothing, best first.

    Raises:
        NoSolutionFound: there is none; `what` was looked for, and `short` tells what none keeps that was looked at.
    """
    good = sorted((end for end in ends if not end.violations), key=lambda end: -program.worth(end.x))
    if good:
        return good
    nearest = min(ends, key=lambda end: max(map(worst_size, end.violations.values()), default=0.0))
    prefixes = [program.prefix(k) for k in range(program.coupling.count)]
    at_corners = {k + name: k + of for k in prefixes for name, of in cornerless(program.first).items()}
    units = {row.name: row.unit for row in program.constraints()}
    units |= {f"{k}{each.name} range": each.unit for k in prefixes for each in program.first.variables}
    sizes = violations_told(nearest.violations, at_corners, units, NAMED)
    names = [variable.name for variable in program.first.variables]
    iterate = {
        f"target {k + 1}: {name}": float(value)
        for k in range(program.coupling.count)
        for name, value in zip(names, program.of(nearest.x, k), strict=True)
    }
    outcomes = ", ".join(sorted({end.status for end in ends}))
    missed = [f"target {k}: {each}" for k, each in enumerate(map(kept_by_none, program.problems), start=1) if each]
    missed = "".join(f"; {sentence}" for sentence in (missed or [short()]) if sentence)
    raise NoSolutionFound(
        f"no {what} passed the checks in {counted(len(ends), 'start')} ({outcomes}); the best iterate violates {sizes}"
        f"{missed}{in_the_way(program.first.assumed)}",
        violations=nearest.violations,
        iterate=iterate,
    )


def not_below(program: Program, good: list[End], seen: list[Vector], what: str) -> list[End]:
    """The verified ends, and those of solves from points that were seen and are better than all of them.

    Args:
        program: the problem.
        good: from `verified`.
        seen: points x, feasible or not.
        what: is looked for.

    Raises:
        NoSolutionFound: a feasible point is better than every end.
    """
    least = program.worth(good[0].x) + BETTER * program.size
    better = [x for x in seen if program.worth(x) > least and not infeasible(program, x)]
    better = sorted(better, key=lambda x: -program.worth(x))[:TRIED]
    if not better:
        return good
    # An ascent never leads below its start.
    found = verified(program, [*good, *(_told(program, climbed_from(program, x)) for x in better)], what)
    short = program.worth(better[0]) - program.worth(found[0].x)
    if short > BETTER * program.size:
        raise NoSolutionFound(
            f"the best {what} found, V = {program.worth(found[0].x):.6g}, is worse than a feasible one seen, by "
            f"{short:.3g}, from which no solve came to a point that passes the checks",
            violations={"below what was seen": short},
            iterate={},
        )
    return found


def taken_up(program: Program, good: list[End], ends: list[End], what: str) -> tuple[list[End], float | None]:
    """The verified ends, with more from ends that break nothing and are better; what the best that fails is worth.

    Args:
        program: the problem.
        good: from `not_below`.
        ends: of all starts.
        what: is looked for.
    """

    def ahead(among: list[End]) -> list[End]:
        least = program.worth(good[0].x) + BETTER * program.size
        better = [end for end in among if end.violations and program.worth(end.x) > least]
        return sorted((end for end in better if not infeasible(program, end.x)), key=lambda end: -program.worth(end.x))

    further = [_told(program, climbed_from(program, end.x)) for end in ahead(ends)[:TRIED]]
    good = verified(program, [*good, *further], what)
    left = ahead([*ends, *further])
    return good, program.worth(left[0].x) if left else None


def places_at(program: Program, x: Vector) -> tuple[TargetConfiguration, ...]:
    """The configuration at every target."""
    places: list[TargetConfiguration] = []
    for k, (problem, value) in enumerate(zip(program.problems, program.values(x), strict=True)):
        z = program.of(x, k)
        evaluation, constraints = problem.quantities.evaluated(z), constraint_values(problem, z)
        places.append(TargetConfiguration(problem.target, evaluation, float(value), constraints))
    return tuple(places)
