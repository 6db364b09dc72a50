"""The choice by a measure of the loop: points are looked at, the best climb, what the uncertainty finds is added.

In: a `SelectionProblem` whose own objective is not asked, a loop. Out: an `OutcomeSelection`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from flexopt.errors import NoSolutionFound
from flexopt.foundation.arrays import Progress, Vector
from flexopt.foundation.documents import provenance
from flexopt.foundation.plain import counted
from flexopt.foundation.processes import in_parallel
from flexopt.foundation.turns import available_cores
from flexopt.loop.certified.region import stability_radius
from flexopt.loop.evaluation import with_outcome
from flexopt.loop.settings import LoopSettings
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model.uncertainty import GROUND
from flexopt.robustness import Evaluation
from flexopt.selection.broken import broken
from flexopt.selection.chances import Attempt
from flexopt.selection.constraint_values import ConstraintValue
from flexopt.selection.continua import grouped, nearest, travel
from flexopt.selection.optima import SAME_POINT
from flexopt.selection.outcomes.asked import LESS, Asked, MeasureBounds, least_values
from flexopt.selection.outcomes.borders import RADIUS_POINTS
from flexopt.selection.outcomes.climb import Climbed, climbed, first_order
from flexopt.selection.outcomes.program import OutcomeProgram, least_over, worst_of
from flexopt.selection.outcomes.result import OutcomeSelection
from flexopt.selection.outcomes.starting import ALIKE, Seed, lifted, separation, starting_points
from flexopt.selection.places import FEASIBLE
from flexopt.selection.problem import SelectionProblem, chosen_configuration, reached
from flexopt.selection.result import Candidate, Kept
from flexopt.selection.solve import constraint_values, solved
from flexopt.selection.starts import between_points, violated

# How often the worst member that is found behind a climb is added and climbed again.
ROUNDS = 10
UNDONE = "where others of what is uncertain make the loop grow"
# How often a climb goes on from where only ends of joints stopped it.
ONWARD = 3
# Of the value, by which two are equal.
EQUAL = 1e-6
# Of the value, by which a member that is slower than those that were climbed with is new.
NEW = 1e-3


def outcome_selection(
    problem: SelectionProblem,
    asked: Asked,
    initial: Evaluation | None,
    workers: int | None,
    progress: Progress | None,
    *,
    bounds: MeasureBounds = (),
    seeds: Sequence[Seed] = (),
    kept: tuple[Kept, ...] = (),
) -> OutcomeSelection:
    """Local optima of a measure of the loop, verified to first order, the best first.

    Args:
        problem: from `build_selection`; its objective is not asked.
        asked: of the loop.
        initial: the present configuration.
        workers, progress: as of `flexopt.solve_selection`.
        bounds: what further measures must be at least.
        seeds: configurations to start from, besides those that were scanned.
        kept: what is said of the bounds.

    Raises:
        InputError: the uncertainty does not go with the loop or the measure; a measure of gains without one.
        NoSolutionFound: no climb ended at a feasible, stationary point.
    """
    thin = [z for z in between_points(problem) if violated(problem, z[:, None])[0] <= FEASIBLE]
    pool, machine = _feasible(problem, thin, initial, workers), problem.machine
    stand = initial or problem.quantities.evaluated(pool[0])
    program = OutcomeProgram(**asked.parts(problem, stand, bounds))
    count = workers or available_cores()
    program, starts = starting_points(program, pool, count, [*seeds, *map(Seed, thin)])
    if initial is not None and not program.ranges:
        now = initial.z / problem.scale
        if math.isfinite(program.value(now)) and all(separation(program, now, y) > ALIKE for y in starts):
            starts.append(now)
    found = climbs(program, starts, count, progress)
    attempts = tuple(_attempt(program, start, each) for start, each in zip(starts, found, strict=True))
    ends, unverified = distinct_optima(program, found, starts)
    groups = _continua(program, ends)
    # What is as fast goes by the way there.
    best = groups[0][0].value
    level = best - EQUAL * abs(best)
    alike = [group for group in groups if group[0].value >= level]
    groups[: len(alike)] = sorted(alike, key=lambda group: travel(problem, program.z(group[0].y)))
    distinct = [group[0] for group in groups]
    loops = [program.at(each.y).settings for each in distinct]
    candidates = [_candidate(program, group, chosen) for group, chosen in zip(groups, loops, strict=True)]
    springs = UncertaintyBox(machine, GROUND, program.loop.settings.dead_time)
    settings = asked.present_settings(loops[0])
    now = None if initial is None else with_outcome(machine, initial, settings, gravity=problem.gravity)
    broken = () if initial is None else asked.broken(problem, settings, initial.base, initial.posture, bounds)
    return OutcomeSelection(
        best=candidates[0],
        candidates=tuple(candidates),
        initial=now,
        attempts=attempts,
        kept=kept,
        problem=problem,
        provenance=provenance(machine, target=problem.target.tolist(), **asked.stated(problem)),
        asked=asked,
        criterion=program.measure,
        present=None if initial is None else _present(program, initial, settings),
        present_broken=broken,
        radii=tuple(stability_radius(replace(program.at(each.y), box=springs), RADIUS_POINTS) for each in distinct),
        settings=tuple(loops),
        unverified=unverified,
    )


def climbs(
    program: OutcomeProgram, starts: list[Vector], workers: int, progress: Progress | None
) -> list[Climbed | None]:
    """Where each start leads, in processes where that pays."""
    return in_parallel(partial(_climbed, program, starts), len(starts), workers, progress, at_once=len(starts) > 1)


def distinct_optima(
    program: OutcomeProgram, found: list[Climbed | None], starts: Sequence[Vector] = ()
) -> tuple[list[Climbed], float | None]:
    """Ends that hold, the best first, those at the same place once; and what an end that does not hold has more.

    `starts`: of one configuration's climbs, whose constraints are told where none leads anywhere.

    Raises:
        NoSolutionFound: there is none.
    """
    ends = sorted((each for each in found if each is not None and each.holds), key=lambda each: -each.value)
    distinct = list[Climbed]()
    for each in ends:
        if all(separation(program, each.y, other.y) > SAME_POINT for other in distinct):
            distinct.append(each)
    if not distinct:
        raise _none(program, found, starts)
    worth = distinct[0].value + NEW * abs(distinct[0].value)
    more = [each.value for each in found if each is not None and not each.holds and each.value > worth]
    return distinct, program.measure.sign * max(more) if more else None


def _continua(program: OutcomeProgram, ends: list[Climbed]) -> list[list[Climbed]]:
    """The ends, best first, those of one continuum together: the nearest to the present configuration leads.

    Of one continuum are those that `flexopt.selection.continua` joins, with the same gains, and as much of the measure.
    """
    near = list[Climbed]()
    for each in (_nearest(program, end) for end in ends):
        if not any(separation(program, each.y, other.y) <= SAME_POINT for other in near):
            near.append(each)
    found = list[list[Climbed]]()
    for group in grouped(program.problem, [program.z(each.y) for each in near]):
        members = [near[k] for k in group]
        while members:
            first, rest = members[0], list[Climbed]()
            own = [first]
            for each in members[1:]:
                (own if _as_much(program, first, each) else rest).append(each)
            found.append(own)
            members = rest
    return sorted(found, key=lambda group: -group[0].value)


def _nearest(program: OutcomeProgram, end: Climbed) -> Climbed:
    """Of what nothing tells from an end, its loop neither, the nearest to the present configuration."""
    # The motions of members that were added on the way count, too.
    program = program if end.members is None else replace(program, members=end.members)
    z, value = program.z(end.y), program.value(end.y)

    def at(other: Vector) -> Vector:
        return np.append(other / program.problem.scale, end.y[program.n_z :])

    near = nearest(program.problem, z, lambda other: abs(program.value(at(other)) - value) <= EQUAL * abs(value))
    if near is z:
        return end
    y = at(near)
    stationarity, active = first_order(program, y, program.value(y))
    # On what it may rest at its new place it does not rest.
    active = tuple(name for name in active if name in end.active)
    moved = replace(end, y=y, stationarity=stationarity, active=active)
    return moved if moved.holds else end


def _as_much(program: OutcomeProgram, end: Climbed, other: Climbed) -> bool:
    same = np.abs(end.y[program.n_z :] - other.y[program.n_z :]).max(initial=0.0) <= SAME_POINT
    return bool(same) and abs(end.value - other.value) <= EQUAL * abs(end.value)


def _feasible(problem: SelectionProblem, thin: list[Vector], initial: Evaluation | None, workers: int | None) -> Vector:
    """Feasible configurations (N, n_z): the present one, if it is, and those that were scanned, or lie between these.

    Where none of these is, the best by the problem's own objective, whose solver goes along constraints to where all
    are kept.

    Raises:
        NoSolutionFound: it finds none, and the present one is not feasible either; what is short is named.
    """
    pool = np.concatenate([problem.scan.z[:, problem.scan.feasible].T, *(z[None] for z in thin)])
    now = [each.z for each in [initial] if each is not None and violated(problem, each.z[:, None])[0] <= FEASIBLE]
    if not len(pool):
        try:
            pool = np.array([each.z for each in solved(problem, workers, climbs=False).candidates])
        except NoSolutionFound:
            if not now:
                raise
    return np.concatenate([*(z[None] for z in now), pool])


def _climbed(program: OutcomeProgram, starts: list[Vector], number: int) -> Climbed | None:
    """The optimum from a start; from where only a joint's end stopped it, which is whole turns away, it goes on."""
    found = _climbed_once(program, starts[number])
    for _ in range(ONWARD):
        there = None if found is None else program.past_stops(found.y)
        again = None if there is None else _climbed_once(program, there)
        if found is None or again is None or not again.holds or again.value <= found.value + EQUAL * abs(found.value):
            break
        found = replace(again, steps=found.steps + again.steps)
    return found and replace(found, y=program.wrapped(found.y))


def _climbed_once(program: OutcomeProgram, start: Vector) -> Climbed | None:
    """The optimum from a start, members added for which it is not one; without end where some are left."""
    found: Climbed | None = climbed(program, start)
    if found is None or not len(program.members):
        return found
    for left in reversed(range(ROUNDS + 1)):
        value, at = least_over(program, found.y)
        broken = _broken(program, found.y)
        if value >= found.value - NEW * abs(found.value):
            if broken is None:
                return replace(found, value=min(found.value, value), members=program.members)
            at = broken
        more = replace(program, members=np.concatenate([program.members, at[None]]))
        # Where a member breaks what the loop must do at least, that is climbed first.
        begun = [found.y] if broken is None or not left else lifted(more, [found.y], 1)[0]
        again = climbed(more, begun[0]) if left and begun else None
        if again is None:
            return None if broken is not None else replace(found, value=value, undone=True)
        program, found = more, again
    return found


def _broken(program: OutcomeProgram, y: Vector) -> Vector | None:
    """A member whose loop does less than it must."""
    for part, own in program.parts(y) if program.least else []:
        loop = part.at(own)
        for measure, least in program.least:
            value, at = worst_of(loop, measure)
            if value < least - LESS * abs(least):
                return at
    return None


def kept_values(program: OutcomeProgram, y: Vector) -> dict[str, ConstraintValue]:
    """What the worst member's loop does of what it must at least."""
    return least_values(program.least, program.at(y), worst=len(program.members) > 0)


def _attempt(program: OutcomeProgram, start: Vector, end: Climbed | None) -> Attempt:
    told = "led off the constraints" if end is None else _ended(program, end)
    value = None if end is None or not end.holds else program.measure.sign * end.value
    return Attempt(tuple(program.z(start).tolist()), told, value)


def _ended(program: OutcomeProgram, end: Climbed) -> str:
    value = program.measure.sign * end.value
    if math.isinf(value):
        return f"led to {UNDONE}"
    if end.holds:
        return "verified to first order"
    if end.undone:
        return f"came to {value:.6g}, which others of what is uncertain undo"
    if math.isinf(end.stationarity):
        return f"came to {value:.6g}, where it has no slope, as where two motions meet"
    return f"came to {value:.6g}, where the gradient is not zero, {end.stationarity:.1e}"


def _none(program: OutcomeProgram, found: list[Climbed | None], starts: Sequence[Vector]) -> NoSolutionFound:
    ends = [each for each in found if each is not None]
    best = max(ends, key=lambda each: each.value, default=None)
    names = program.names[: program.n_z]
    iterate = {} if best is None else dict(zip(names, program.z(best.y).tolist(), strict=True))
    slope = best is not None and not best.undone and math.isfinite(best.stationarity)
    left = {"first-order optimality": best.stationarity} if best and slope else {}
    why = ""
    if any(math.isinf(each.value) for each in ends):
        why = f": some led to {UNDONE}; a least decay beside it, constraints.outcome.decay, keeps them from there"
    elif best is not None:
        why = f": the best {_ended(program, best)}; more starts may end at one"
    elif len(starts):
        breaks = broken(program.problem, program.z(starts[0]))
        why = f": no step led onto the constraints; the first began where it {breaks}" if breaks else ""
    return NoSolutionFound(
        f"select: none of {counted(len(found), 'climb')} ended at a stationary point{why}",
        violations=left, iterate=iterate,
    )  # fmt: skip


def _present(program: OutcomeProgram, initial: Evaluation, settings: LoopSettings) -> float | None:
    """The measure of the present configuration with its loop, as of candidates; None where it has none."""
    program = replace(program, loop=replace(program.loop, settings=settings), ranges={})
    y = initial.z / program.problem.scale
    value = program.value(y)
    if len(program.members) and math.isfinite(value):
        value = min(value, least_over(program, y)[0])
    return program.measure.sign * value if math.isfinite(value) else None


def _candidate(program: OutcomeProgram, group: list[Climbed], settings: LoopSettings) -> Candidate:
    """The first of a continuum, and where its base stands in the others."""
    problem, (end, *others) = program.problem, group
    n_base, z = len(problem.machine.base_coordinates), program.z(end.y)
    places = [program.z(each.y)[:n_base] for each in others if separation(program, end.y, each.y) > SAME_POINT]

    def evaluate() -> Evaluation:
        return with_outcome(problem.machine, problem.quantities.evaluated(z), settings, gravity=problem.gravity)

    return Candidate(
        configuration=chosen_configuration(problem, z, settings.fixed),
        z=z,
        w=problem.quantities.w_at(z).ravel(),
        objective=program.measure.sign * end.value,
        active=tuple(dict.fromkeys(end.active)),
        constraints=constraint_values(problem, z) | kept_values(program, end.y),
        target_error=float(np.linalg.norm(reached(problem, z) - problem.target)),
        stationarity=end.stationarity,
        iterations=end.steps,
        kinks={},
        unsurpassed=False,
        evaluate=evaluate,
        continuum=tuple(tuple(place.tolist()) for place in places),
    )
