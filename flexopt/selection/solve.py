"""Solve a configuration problem: its optima, one of each continuum, ranked."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Unpack, cast

import numpy as np

from flexopt.errors import FlexoptError
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Progress, TargetLike, Vector
from flexopt.foundation.boundary import Keywords, instance, public
from flexopt.foundation.documents import provenance
from flexopt.foundation.later import later
from flexopt.foundation.turns import available_cores
from flexopt.model import AnyMachine
from flexopt.model.choices import OUTCOMES, asks_for_loop, of_loop
from flexopt.model.constraints import AnyConstraints, Constraints, LeastOutcomes
from flexopt.model.loop import Loop, LoopLike, control_of
from flexopt.model.own import OBJECTIVES
from flexopt.model.problem import SelectionKeywords, SelectionOptions
from flexopt.model.uncertainty import RangesLike
from flexopt.plant.inverse_kinematics import inverse_kinematics
from flexopt.robustness.evaluation import Evaluation
from flexopt.robustness.plausibility import warn_implausible
from flexopt.selection.broken import joint_margins
from flexopt.selection.build import build_selection, only_notes
from flexopt.selection.constraint_values import ConstraintValue
from flexopt.selection.continua import grouped, nearest, same, travel
from flexopt.selection.nlp.program import single
from flexopt.selection.optima import SAME_POINT, first_optima, later_optima, next_stage
from flexopt.selection.problem import TIE_TOLERANCE, SelectionProblem, chosen_configuration, value_at
from flexopt.selection.proof.check import prove
from flexopt.selection.proof.newton import settled
from flexopt.selection.result import Candidate, Kept, Selection
from flexopt.selection.starts import starting_points
from flexopt.selection.surfaces import Best, along_surfaces

# Up to where values that decide between equals are equal themselves, and decimals of z that break the last ties.
EQUAL, DIGITS = 1e-6, 5
Extent = dict[str, tuple[float, float]]
# Optima named of a set, besides the candidate that stands for it.
REPRESENTATIVES = 5


def loop_notes(arguments: Arguments, given: Mapping[str, Any]) -> None:
    """As of `build_selection`; an objective of the loop is not its to check, nor what a loop must do at least."""
    least, given = least_of(given.get("constraints")), {**given, "constraints": without_loop(given.get("constraints"))}
    if of_loop(given.get("objective")):
        words = given["objective"].split(",")
        own = [word for word in words if word not in OUTCOMES]
        if given.get("weights") is not None and "V" not in words:
            arguments.note("weights", f"go with objective V only, not with {given['objective']}", given["weights"])
        named = ",".join(own) or "w1"
        given = {**given, "objective": named, "weights": given.get("weights") if "V" in words else None}
    elif least is None:
        for name in ("loop", "ranges"):
            if given.get(name) is not None:
                words = ", ".join(OUTCOMES)
                sentence = f"goes with an objective of the loop, {words}, or the constraint outcome"
                arguments.note(name, f"{sentence}; else see flexopt.verdict", given[name])
    elif not isinstance(given.get("objective"), str) or not re.fullmatch("V|epsilon_max|w[0-9]+", given["objective"]):
        loops = ", ".join(OUTCOMES)
        sentence = f"must be w1, w2, …, V, epsilon_max or, of the loop, one of {loops} beside the constraint outcome"
        arguments.note("objective", sentence, given.get("objective"))
    only_notes(arguments, given)


def least_of(constraints: Any) -> LeastOutcomes | None:
    """What the loop must do at least."""
    return constraints.outcome if isinstance(constraints, Constraints) else None


def without_loop(constraints: Any) -> Any:
    """The constraints that are the configuration's alone."""
    return constraints if least_of(constraints) is None else constraints.model_copy(update={"outcome": None})


@public(together=loop_notes, keywords=Keywords(SelectionOptions, SelectionKeywords), objective=OBJECTIVES)
def select(
    machine: AnyMachine,
    target: TargetLike,
    *,
    constraints: AnyConstraints | None = None,
    loop: LoopLike | None = None,
    ranges: RangesLike | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    options: SelectionOptions | None = None,  # noqa: ARG001 - its fields come as keywords
    **keywords: Unpack[SelectionKeywords],
) -> Selection:
    """Choose placement and posture: `build_selection` and `solve_selection` in one.

    Args:
        machine, target, constraints, options, keywords: as in `flexopt.build_selection`. Objectives of the loop, alone
            or in order with each other, w_i and V, are `"decay"`, `"allowed_gain"`, `"delay_margin"` and `"allowance"`
            (of its modes the least) of `flexopt.Outcome`, and the stability `"radius"` of `flexopt.stable_region`; of
            the standard move, `"settling"` and `"swing"`, which shall be small.
        loop: of the loop's objective: the real controller, as of `flexopt.evaluate`; by default the machine's
            `[loop]`, or where there is none what follows from the machine. With the constraint `outcome` it must do so
            much at least, also where w_i or V is the objective. Of gains with a range (`kp_range`,
            `kv_range`) the best for each configuration are chosen.
        ranges: of the loop's objective: what is uncertain, as of `flexopt.verdict`; the least over it counts. By
            default the machine's `[[uncertainty]]`, or where there is none, or a radius is asked for, its own numbers
            alone.
        workers: as in `flexopt.solve_selection`.
        progress: called with (starts done, starts in all).

    Raises:
        InputError, UnreachableTarget: as `build_selection`.
        NoSolutionFound: as `solve_selection`.

    Example:
        >>> machine = flexopt.load("excavator")
        >>> selection = flexopt.select(machine, (0.0, 1.6), base=0.0, starts=8)
        >>> selection.status
        '8 distinct local optima verified from 8 starts'
        >>> bool(abs(selection.best.w[0]) < 1e-12)  # w_1 = 0, the most there is
        True
        >>> selection.best.evaluation.joints
        ('boom', 'stick')
    """
    measure = cast("str | None", keywords.get("objective"))
    keywords["control"] = control_of(keywords.get("control"), cast("Loop | None", loop), machine)
    if asks_for_loop(measure, constraints):
        # Its room is built on this one.
        room = later("flexopt.selection.outcomes", in_order="outcome_selection_in_order")
        problems = dict[str, SelectionProblem]()
        for word in (measure or "w1").split(","):
            named: Any = {"objective": "w1", "weights": None} if word in OUTCOMES else {"objective": word}
            if word != "V":
                named["weights"] = None
            problems[word] = build_selection(machine, target, constraints=without_loop(constraints), **keywords | named)
        choose = cast(Any, room("outcome_selection_in_order"))
        return choose(problems, loop, ranges, constraints, workers, progress)
    problem = build_selection(machine, target, constraints=constraints, **keywords)
    return solve_selection(problem, workers=workers, progress=progress)


@public(problem=instance(SelectionProblem, "a SelectionProblem, from flexopt.build_selection"))
def solve_selection(
    problem: SelectionProblem, *, workers: int | None = None, progress: Progress | None = None
) -> Selection:
    """Local optima of a configuration problem, one for each start at most, each verified independently.

    Args:
        problem: from `flexopt.build_selection`.
        workers: how many processes may solve, where that is quicker; by default one for each core. With 1 all happens
            in this process. The result is the same.
        progress: called with (starts done, starts in all).

    Raises:
        NoSolutionFound: no start led to a point that passes the checks; names the violated constraints, their sizes
            and the best iterate.

    Example:
        >>> problem = flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6), starts=8)
        >>> flexopt.solve_selection(problem).status
        '8 distinct local optima verified from 8 starts'
    """
    return solved(problem, workers, progress)


def solved(
    problem: SelectionProblem, workers: int | None = None, progress: Progress | None = None, *, climbs: bool = True
) -> Selection:
    """As `solve_selection`; without `climbs` optima stay where they were found, also where they are surfaces."""
    warn_implausible(problem.machine)
    count = workers or available_cores()
    starts = starting_points(problem, count)
    problem, (found, attempts, unverified) = first_optima(problem, starts, count, progress)
    kept: list[Kept] = []
    while len(problem.kept) + 1 < len(problem.objectives):
        problem, now = next_stage(problem, found, unverified)
        kept.append(now)
        found, more, unverified = later_optima(problem, [z for z, _, _ in found], count)
        attempts += more
    if progress is not None and len(attempts) > len(starts):
        # Later objectives, and points that were seen to be better, bring starts of their own.
        progress(len(attempts), len(attempts))
    bests, climbed = along_surfaces(problem, found, count) if climbs else ([Best(item) for item in found], 0)
    groups = grouped(problem, [best.found[0] for best in bests])
    candidates = _ranked(
        problem, _merged(problem, [_candidate(problem, [bests[k] for k in group]) for group in groups])
    )
    # What may still be wrong with it shows here, not when it is first asked for.
    assert candidates[0].evaluation is not None
    options = {"target": problem.target.tolist(), "objective": problem.name, "slack": problem.slack} | problem.stated
    options |= {"weights": [objective.weights.tolist() for objective in problem.sought]}
    return Selection(
        best=candidates[0],
        candidates=tuple(candidates),
        initial=initial_evaluation(problem),
        attempts=tuple(attempts),
        kept=tuple(kept),
        problem=problem,
        provenance=provenance(problem.machine, **options),
        unverified=unverified,
        climbed=climbed,
    )


def _candidate(problem: SelectionProblem, group: list[Best]) -> Candidate:
    """The first of a continuum, its base as near as it may stand, and where it stands in the others."""
    z, proof, iterations = group[0].found
    # With one degree of redundancy solves end there anyway.
    if problem.redundancy > 1:
        z, proof = settled(single(problem), z, proof)
    places = [best.found[0] for best in group]
    near = nearest(problem, z)
    if near is not z and (turned := prove(problem, near)).holds:
        z, proof = near, turned
    n_base = problem.measures.plant.n_base
    places = [place for place in places if np.abs((place - z) / problem.scale)[:n_base].max(initial=0.0) > SAME_POINT]
    others = [other for best in group for other in best.others]
    return Candidate(
        configuration=chosen_configuration(problem, z),
        z=z,
        w=problem.quantities.w_at(z).ravel(),
        objective=value_at(problem, z, problem.sought[0]),
        active=tuple(dict.fromkeys(proof.active)),
        constraints=constraint_values(problem, z),
        target_error=proof.target_error,
        stationarity=proof.stationarity,
        iterations=iterations,
        kinks=proof.kinks,
        unsurpassed=proof.unsurpassed,
        evaluate=partial(problem.quantities.evaluated, z),
        continuum=tuple(tuple(other[:n_base].tolist()) for other in places),
        dimension=proof.dimension,
        extent=_extent(problem, [z, *others]),
        representatives=tuple(tuple(other.tolist()) for other in _spread(problem, z, others)),
    )


def _merged(problem: SelectionProblem, candidates: list[Candidate]) -> list[Candidate]:
    """The candidates, those that turned out to be one only once, with all placements and points found of each."""
    merged: list[Candidate] = []
    for candidate in candidates:
        for k, other in enumerate(merged):
            if same(problem, candidate.z, other.z):
                merged[k] = replace(
                    other,
                    continuum=(*other.continuum, *candidate.continuum),
                    extent=_joint_extent(other.extent, candidate.extent),
                    representatives=(*other.representatives, *candidate.representatives)[:REPRESENTATIVES],
                )
                break
        else:
            merged.append(candidate)
    return merged


def _joint_extent(one: Extent, other: Extent) -> Extent:
    return {
        name: (min(low, one.get(name, (low, high))[0]), max(high, one.get(name, (low, high))[1]))
        for name, (low, high) in (one | other).items()
    }


def _extent(problem: SelectionProblem, points: list[Vector]) -> Extent:
    """The least and the greatest of every variable among the points that were found of a set; nothing of a point."""
    if len(points) == 1:
        return {}
    low, high = np.min(points, axis=0).tolist(), np.max(points, axis=0).tolist()
    return dict(zip((variable.name for variable in problem.variables), zip(low, high, strict=True), strict=True))


def _spread(problem: SelectionProblem, z: Vector, others: list[Vector]) -> list[Vector]:
    """A few of the others, each as far as can be from z and from those before."""
    chosen, left = [z], list(others)
    while left and len(chosen) <= REPRESENTATIVES:
        away = [min(float(np.abs((other - each) / problem.scale).max()) for each in chosen) for other in left]
        chosen.append(left.pop(int(np.argmax(away))))
    return chosen[1:]


def constraint_values(problem: SelectionProblem, z: Vector) -> dict[str, ConstraintValue]:
    """Every constraint besides the target, an asked margin of joints among them: its value and bounds.

    Of rows of one name, such as a joint's distances from both of its limits, that with the least room.
    """
    at, n_task = problem.quantities.at(z), problem.target.size
    values = [float(problem.measures.plant.singularity_sine_squared.call(at)[0])]
    if problem.constraint_set is not None:
        reported = problem.constraint_set.report.call([*at, problem.constraint_set.constants])[0]
        values += reported.full().ravel().tolist()
    values += problem.own_values(z).tolist()
    found = joint_margins(problem, z)
    for row, value in zip((*problem.constraints[n_task:], *problem.own_constraints), values, strict=True):
        told = ConstraintValue(value, row.lower, row.upper, row.unit)
        found[row.name] = min(found.get(row.name, told), told, key=lambda each: each.least_room)
    return found


def _ranked(problem: SelectionProblem, candidates: list[Candidate]) -> list[Candidate]:
    """Best first: the last objective, those before, the worst of the w_i in none of them, ε_max, distance.

    Each is asked for only among those that all before leave equal: ε_max costs more than all else about a candidate.
    What still ties, mirrored configurations, goes by its numbers, so that chance decides nothing.
    """
    left, ranked = list(candidates), list[Candidate]()
    while left:
        among = left
        for value, tolerance in _criteria(problem):
            if len(among) == 1:
                break
            values = [value(candidate) for candidate in among]
            least = max(values) - tolerance
            among = [candidate for candidate, each in zip(among, values, strict=True) if each >= least]
        first = max(among, key=lambda candidate: tuple(np.round(candidate.z / problem.scale, DIGITS)))
        ranked.append(first)
        left = [candidate for candidate in left if candidate is not first]
    return ranked


def _criteria(problem: SelectionProblem) -> Iterator[tuple[Callable[[Candidate], float], float]]:
    """What candidates are ranked by, in order, the larger the better, and up to what they count as equal."""
    used, first = np.any([objective.uses for objective in problem.sought], axis=0), problem.bounding
    for objective, size in zip(reversed(problem.sought), reversed(problem.objective_scales[first:]), strict=True):
        yield lambda candidate, objective=objective: value_at(problem, candidate.z, objective), TIE_TOLERANCE * size
    if not used.all():
        yield lambda candidate: float(candidate.w[~used].min()), EQUAL * problem.measure_scale
    yield lambda candidate: candidate.evaluation.epsilon_max or 0.0, EQUAL
    yield lambda candidate: -travel(problem, candidate.z), EQUAL


def initial_evaluation(problem: SelectionProblem) -> Evaluation | None:
    """The present configuration; where no posture is given, one that reaches the target from the present base."""
    base, posture = problem.present_base, problem.present_posture
    if base is None:
        return None
    try:
        if posture is None:
            closed = problem.measures.plant.closed_form
            posture = inverse_kinematics(
                problem.machine,
                problem.target,
                base=base,
                gravity=problem.gravity,
                elbow=problem.elbow if closed else None,
                seed=problem.seed,
            )[0]
        return problem.quantities.evaluated(np.concatenate([base, posture]))
    except FlexoptError:
        return None
