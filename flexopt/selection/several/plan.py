"""A way of the base along a path of targets that keeps the worst measure as high as possible.

A coarse way is found by dynamic programming over placements and postures for each target, once for the highest worst
value and once for the shortest way that keeps it; IPOPT then moves all configurations together. Standing still at the
best single placement is one of the starts, so that moving is never worse than not moving, and so is driving along in
each of the best configurations for the middle target.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, Unpack, cast

import numpy as np

from flexopt.errors import Fault, FlexoptError, InputError, NoSolutionFound, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import ArrayLike, BaseLike, Document, Progress, TargetsLike, Vector
from flexopt.foundation.boundary import Keywords, by, public
from flexopt.foundation.coordinates import turned_into
from flexopt.foundation.documents import provenance
from flexopt.foundation.quantities import DURATION
from flexopt.foundation.turns import available_cores
from flexopt.model import AnyMachine
from flexopt.model.boundary import targets
from flexopt.model.choices import asks_for_loop
from flexopt.model.constraints import AnyConstraints
from flexopt.model.loop import Loop, LoopLike, control_of
from flexopt.model.own import OBJECTIVES
from flexopt.model.problem import SelectionOptions, SharedKeywords
from flexopt.model.targets import RATES, TIMES
from flexopt.model.uncertainty import RangesLike
from flexopt.robustness.plausibility import warn_implausible
from flexopt.selection.nlp.coupling import Coupling
from flexopt.selection.nlp.program import Program, values_of
from flexopt.selection.outcomes.asked import Asked
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.proof.check import infeasible
from flexopt.selection.several.outcome_plan import outcome_plan
from flexopt.selection.several.postures import Reached, reached_from
from flexopt.selection.several.results import KEPT, BasePlan, FixedPlacement
from flexopt.selection.several.solving import End, end_from, ends_from, not_below, places_at, taken_up, verified
from flexopt.selection.several.standing import best_placements, one_placement, standing_along
from flexopt.selection.several.targets import build_problems, sample_bases, single_measure
from flexopt.selection.several.ways import broken_on_lines, coarse_ways, no_way, nodes_of, on_lines, travelled
from flexopt.selection.solve import loop_notes, solved

# Placements that are looked at, for one coordinate and for more: from which all targets may be reached, and for each
# target alone.
COMMON, OWN = (401, 256), (201, 256)
# Starts of IPOPT: ways, and placements that stand still.
WAYS, STANDS = 3, 6
# Ways that follow from the middle target alone, and the starts of its selection.
CARRIED, CARRIED_STARTS = 4, 16
# Placements from which postures near to each other are looked for, with so many times the usual postures.
PLACED, FINER = 128, 16
BASE_RATE, SECONDS = 0.25, 10.0


def _together(arguments: Arguments, given: Mapping[str, Any]) -> None:
    loop_notes(arguments, given)
    single_measure(arguments, given)
    machine, path, times = arguments.of, given["path"], given["times"]
    if times is not None:
        if given["duration"] is not None:
            arguments.note("duration", "goes without times only", given["duration"])
        if path is not None and len(times) != len(path):
            arguments.note("times", f"needs {len(path)} numbers, one for each target", times)
        elif times[0] != 0.0 or any(later <= earlier for earlier, later in pairwise(times)):
            arguments.note("times", "must increase from 0, in s", times)
    if machine is not None:
        if not machine.base_coordinates:
            arguments.faults.append(Fault("machine", "has no placement coordinate that could move"))
        for field, names in (("max_base_rate", machine.base_coordinates), ("max_joint_rate", machine.joints)):
            rates = given[field]
            if rates is not None and len(rates) not in (1, len(names)):
                arguments.note(field, f"must be one number or {len(names)}: {', '.join(names)}", rates)


@public(
    path=targets(2),
    times=by(TIMES),
    duration=by(DURATION),
    max_base_rate=by(RATES),
    max_joint_rate=by(RATES),
    objective=OBJECTIVES,
    together=_together,
    keywords=Keywords(SelectionOptions, SharedKeywords),
)
def plan_base(
    machine: AnyMachine,
    path: TargetsLike,
    *,
    times: Sequence[float] | None = None,
    duration: float | None = None,
    max_base_rate: ArrayLike | None = None,
    max_joint_rate: ArrayLike | None = None,
    start: BaseLike | None = None,
    constraints: AnyConstraints | None = None,
    loop: LoopLike | None = None,
    ranges: RangesLike | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    options: SelectionOptions | None = None,  # noqa: ARG001 - its fields come as keywords
    **keywords: Unpack[SharedKeywords],
) -> BasePlan:
    """A motion of the base along a path of the end-point: max min_k V(z_k), and of those the shortest way.

    The configurations z_k = [base, posture] reach target k at time t_k, and |Δbase| ≤ max_base_rate Δt,
    |Δposture| ≤ max_joint_rate Δt from each to the next. Among the ways that keep the worst V to within 1e-4 of the
    objective's scale the one with the least Σ |Δz|² (in scaled variables) is returned.

    Args:
        machine: from `flexopt.load`.
        path: targets in order, (K, n_task), m, inertial frame, K ≥ 2.
        times: when each is due, (K,), s, increasing from 0;  duration: even times until then; 10 s by default.
        max_base_rate: of each placement coordinate, one number or (n_b,), m/s and rad/s; 0.25 by default.
        max_joint_rate: of each joint, one number or (n,), rad/s or m/s; the machine's speeds by default.
        start: where the base stands at the first target, (n_b,), and now, where no `base` says so; free by default.
        constraints, options, keywords: as in `flexopt.select_stand`, but for combine and shares.
        loop, ranges: as in `flexopt.select_stand`: with an objective of the loop the worst target counts, each as if
            the machine stood still in its configuration.
        workers: as in `flexopt.solve_selection`.
        progress: called with (starts done, starts in all).

    Raises:
        InputError: arguments of wrong shape, not finite or out of range, all in one message.
        UnreachableTarget: a target cannot be reached; says which.
        NoSolutionFound: no way passed the checks: rates too low, or constraints that no continuous way keeps.

    Source: the wish that ends ASME Letters in Dynamic Systems and Control 1(2), 021001, section 6.

    Example:
        >>> machine = flexopt.load("excavator")
        >>> plan = flexopt.plan_base(machine, [(0.0, 1.6), (0.2, 1.6)], starts=1, workers=1)
        >>> plan.base.shape, plan.time.shape
        ((2, 1), (2,))
    """
    warn_implausible(machine)
    points, begin = cast(Vector, path), cast("Vector | None", start)
    count = workers or available_cores()
    keywords["control"] = control_of(keywords.get("control"), cast("Loop | None", loop), machine)
    asked = SelectionOptions.model_construct(**keywords)
    seed = asked.seed
    even = np.linspace(0.0, SECONDS if duration is None else duration, len(points))
    due = even if times is None else np.array(times)
    base_rates = np.resize(
        BASE_RATE if max_base_rate is None else np.asarray(max_base_rate), len(machine.base_coordinates)
    )
    joint_rates = np.resize(
        machine.speeds if max_joint_rate is None else np.asarray(max_joint_rate), len(machine.joints)
    )
    now = asked.base if asked.base is not None or begin is None else begin
    alone = asked.model_copy(update={"starts": None, "base": now})
    problems = build_problems("plan_base", machine, points, "path", alone, constraints)
    if begin is not None:
        begin = turned_into(begin, (problems[0].lower, problems[0].upper), machine.base_units)
        _check_start(problems[0], begin)
    program = _along(problems, due, np.concatenate([base_rates, joint_rates]), begin)

    common = sample_bases(problems, *COMMON, seed) if begin is None else begin[:, None]
    found = [reached_from(problem, common, seed) for problem in problems]
    by_target = _with_own(problems, found, begin, seed)
    word = cast(str, asked.objective)
    if asks_for_loop(word, constraints):
        sought = Asked.of("plan_base", problems[0], loop, ranges, word, constraints)
        counted = tuple(replace(problem, starts=asked.starts) for problem in problems)
        return outcome_plan(replace(program, problems=counted), due, begin, common, by_target, sought, count, progress)
    still = _standing_still(program, common, found, begin, count)
    layers = [nodes_of(reached) for reached in by_target]
    begins = coarse_ways(program, layers, asked.starts or WAYS)
    drawn = len(begins)
    begins += _carried(program, begin, count)
    if still is not None:
        begins.append(program.packed(still))
    if not begins:
        raise no_way()
    ends = ends_from(program, begins, count, progress)
    good = verified(program, ends, "way")
    attempts = len(ends), len(good)
    good = not_below(program, good, begins, "way")
    good, unverified = taken_up(program, good, ends, "way")
    end = _shortest(program, good)
    best = program.unwound(end.x)
    places = places_at(program, best)
    stated: Document = {
        "objective": problems[0].name,
        "path": points.tolist(),
        "times": due.tolist(),
        "max_base_rate": base_rates.tolist(),
    }
    stated |= {"max_joint_rate": joint_rates.tolist(), "start": None if begin is None else begin.tolist()}
    return BasePlan(
        time=due,
        places=places,
        still=None
        if still is None
        else FixedPlacement.of(len(machine.base_coordinates), still, program.values(program.packed(still))),
        between=on_lines(
            problems, due, [program.of(best, k) for k in range(len(problems))], lambda _, z: values_of(problems[0], z)
        ),
        broken_between=broken_on_lines(problems, [program.of(best, k) for k in range(len(problems))]),
        travelled=travelled(machine, np.array([place.evaluation.base for place in places])),
        stationarity=end.stationarity,
        kinks=end.kinks,
        attempts=attempts,
        further=len(good) - attempts[1],
        beside=len(begins) - drawn,
        problems=problems,
        unverified=unverified,
        provenance=provenance(machine, **problems[0].stated | stated),
    )


def _check_start(problem: SelectionProblem, begin: Vector) -> None:
    """The start of the base must be where the first target may be worked at."""
    faults = list[Fault]()
    for v, x in zip(problem.variables, begin, strict=False):
        if not v.lower <= x <= v.upper:
            ends = f"{v.lower:g} to {v.upper:g} {v.unit}"
            sentence = f"must lie in {ends}: in base_range, and where the first target is reached from"
            faults.append(Fault(f"start ({v.name.removeprefix('base.')})", sentence, f"{x:g}"))
    raise_if_any(InputError, "plan_base", faults)


def _along(problems: tuple[SelectionProblem, ...], due: Vector, rates: Vector, begin: Vector | None) -> Program:
    """The program with a placement for each target, and steps that keep to the rates."""
    n_z, count, scale = problems[0].scale.size, len(problems), problems[0].scale
    places = tuple(tuple(range(k * n_z, (k + 1) * n_z)) for k in range(count))
    pairs = tuple((k * n_z + i, (k + 1) * n_z + i) for k in range(count - 1) for i in range(n_z))
    steps = np.concatenate([rates * seconds / scale for seconds in np.diff(due)])
    fixed = () if begin is None else tuple(range(begin.size))
    return Program(problems, Coupling(places, pairs), steps, np.full(count, 1 / count), "worst", fixed=fixed)


def _carried(program: Program, begin: Vector | None, workers: int) -> list[Vector]:
    """Ways on which the machine is driven along with its posture kept: the best configurations of the middle target."""
    middle = program.problems[len(program.problems) // 2]
    rows, coordinates = middle.machine.task_rows, middle.machine.base_coordinates
    try:
        selection = solved(replace(middle, starts=CARRIED_STARTS), workers, climbs=False)
    except NoSolutionFound:
        return []
    ways: list[Vector] = []
    for candidate in selection.candidates[:CARRIED]:
        zs: list[Vector] = []
        for problem in program.problems:
            z = candidate.z.copy()
            for k, name in enumerate(coordinates):
                if name in rows:
                    z[k] += (problem.target - middle.target)[rows.index(name)]
            zs.append(z)
        if begin is not None:
            zs[0][: begin.size] = begin
        ways.append(program.packed(zs))
    return ways


def _standing_still(
    way: Program, bases: Vector, found: list[Reached], begin: Vector | None, workers: int
) -> list[Vector] | None:
    """The configurations from the best single placement, or from `begin`; None where there is none.

    The joints keep their rates: where those of the best postures do not, others are looked for.
    """
    if not bases.shape[1]:
        return None
    fixed = () if begin is None else tuple(range(begin.size))
    coupling, steps, of_way = standing_along(way)
    still = replace(way, coupling=coupling, steps=steps, fixed=fixed)
    try:
        free = replace(one_placement(way.problems, way.share, weighted=False), fixed=fixed)
        best = best_placements(free, bases, found, STANDS, way.first.seed, workers, None)[0][0].x
        if infeasible(still, best):
            begins = _from_one_placement(way, still, of_way, bases)
            ends = ends_from(still, begins, workers, None)
            best = not_below(still, verified(still, ends, "placement"), begins, "placement")[0].x
    except FlexoptError:
        return None
    return [still.of(best, k) for k in range(len(way.problems))]


def _from_one_placement(way: Program, still: Program, of_way: Vector, bases: Vector) -> list[Vector]:
    """Starts from as many placements: those with the highest worst V among postures whose steps keep the rates."""
    seed = way.first.seed
    some = bases[:, np.linspace(0, bases.shape[1] - 1, min(PLACED, bases.shape[1]), dtype=int)]
    found = [reached_from(problem, some, seed, FINER) for problem in way.problems]
    ranked = list[tuple[float, float, Vector]]()
    for j in np.flatnonzero(np.isfinite([reached.value.max(axis=1) for reached in found]).all(axis=0)).tolist():
        at = [Reached(each.z[:, j : j + 1], each.value[j : j + 1], each.violation[j : j + 1]) for each in found]
        for x in coarse_ways(replace(way, steps=of_way), [nodes_of([reached]) for reached in at], 1):
            begin = still.packed([way.of(x, k) for k in range(len(found))])
            away = np.abs(still.coupling.steps(still.coupling.n_x) @ (begin / still.scale))
            ranked.append((float(np.maximum(away - still.steps, 0.0).max(initial=0.0)), -still.worth(begin), begin))
    ranked.sort(key=lambda each: each[:2])
    return [begin for _, _, begin in ranked[:STANDS]]


def _with_own(
    problems: tuple[SelectionProblem, ...], found: list[Reached], begin: Vector | None, seed: int
) -> list[list[Reached]]:
    """For each target what is reached from the common placements, and from others where it alone may be reached."""
    first = [] if begin is None else [[found[0]]]
    others = list(zip(problems, found, strict=True))[len(first) :]
    return first + [[both, reached_from(own, sample_bases((own,), *OWN, seed), seed)] for own, both in others]


def _shortest(program: Program, good: list[End]) -> End:
    """The shortest of the ways near the verified ones that keep the best worst V."""
    level = program.worth(good[0].x) / program.size - KEPT
    shorter = program.kept(level)
    ways: list[End] = []
    for end in good:
        if program.worth(end.x) / program.size >= level:
            moved = end_from(shorter, end.x)
            ways.append(end if moved.violations else moved)
    return min(ways, key=lambda end: program.length(end.x))
