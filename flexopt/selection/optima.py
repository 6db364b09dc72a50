"""Local optima of a configuration problem: solves from many starts, each proved, the unfinished ones taken up again.

In: a problem whose earlier objectives are kept, and starts. Out: distinct verified optima; what became of each start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from flexopt.errors import NoSolutionFound
from flexopt.foundation.arrays import Progress, Vector
from flexopt.foundation.plain import counted
from flexopt.foundation.processes import in_parallel
from flexopt.robustness.evaluation import prepare
from flexopt.selection.ascent.steps import CUT_SHORT
from flexopt.selection.assumed import in_the_way
from flexopt.selection.broken import beyond_bounds, cornerless
from flexopt.selection.chances import SAME_VALUE, Attempt, missed_chance
from flexopt.selection.constraint_values import violations_told, worst_size
from flexopt.selection.continua import past_stops
from flexopt.selection.exchanged import kept_apart
from flexopt.selection.nlp.program import ASCENT_LONG, ASCENT_QUICK, SOLVED, Program, single
from flexopt.selection.problem import SelectionProblem, value_at
from flexopt.selection.proof.check import FIRST_ORDER, Proof, infeasible, prove, prove_program
from flexopt.selection.proof.newton import polished
from flexopt.selection.result import Kept
from flexopt.selection.rounds import IN_VAIN, LEFT_OPEN, ROUNDS, further_starts
from flexopt.selection.seen import BETTER, better_than, kept_peaks, seen_values
from flexopt.selection.starts import climbed_anywhere, climbs, kept_by_none

SAME_POINT = 1e-4
# Violation, as a share of the constraint's scale, up to which the objective of an unfinished solve tells something.
NEARLY = 1e-3
# From how many starts, the best ones, it is climbed at once: a step costs more than one of a solver, but never leads
# down and knows of kinks, on which the best optima often stand.
CLIMBED = 8
# How many of those that were cut short below the best optimum are taken up again, too: one may be on a long way.
BEHIND = 1
# How often one that was cut short and is ahead of all optima goes on: along what is kept of ε_max ways are long.
RESUMED = 4
# How often an ascent that rounding stopped short of an optimum is begun anew from where it came to: multipliers of what
# is kept are large, and the step's predicted gain is less than rounding before the slope is gone.
AGAIN = 3
# Where no optimum of a later objective is found from those of the one before: how far away, in scaled variables, it is
# tried again, and from how many points each time.
AROUND = (0.0, 1e-3, 1e-2, 1e-1)
AROUND_STARTS = 8
# How far a solve may lead from a point that was seen and is better than every optimum, in scaled variables: where
# derivatives change quickly a step of full length ends behind the hill. How often it goes on from where it came to.
WITHIN = (np.inf, 1e-1, 1e-2, 1e-3)
ONWARD = 12
# How far below the best optimum, as a share of the scale, climbs at random may have ended that are followed, too: they
# end a little below their tops, and hills of nearly one height are many.
BELOW = 1e-4
# How many of the ends that could not be verified and are better than every optimum are taken up again.
TAKEN_UP = 2

# What to do where there are feasible points, none of which can be proved the best about.
ADVICE = "more starts, or another objective{}, may lead to an optimum that can be verified"

# IPOPT's word for a point from which only rounding is left to be stepped.
NO_STEP = "Search_Direction_Becomes_Too_Small"

# A point, its proof, and IPOPT's iterations.
Found = tuple[Vector, Proof, int]
# The same with the solver's status; no proof where the point is no number.
SolveOutcome = tuple[Vector, Proof | None, int, str]
# Distinct verified optima, what became of each start, and V of the best end that could not be verified, where that is
# better than all of them.
Optima = tuple[list[Found], list[Attempt], float | None]


def first_optima(
    problem: SelectionProblem, starts: list[Vector], workers: int, progress: Progress | None
) -> tuple[SelectionProblem, Optima]:
    """The problem, and its optima from the starts.

    In the problem frequencies are kept apart where solves came near to where they meet, see `exchanged`.

    Raises:
        NoSolutionFound: there is none, or none as good as a feasible point of the scan.
    """
    found, attempts, failures = _attempted(problem, starts, workers, progress, _solve_start)
    while (apart := kept_apart(problem, [z for z, *_ in found], [z for z, _ in failures])) is not problem:
        ends, problem = [z for z, *_ in (*found, *failures)], apart
        found, attempts, failures = _attempted(problem, [*ends, *starts], workers, progress, _solve_start)
    found, attempts = _not_below_seen(problem, found, attempts, failures)
    found, attempts, more = _in_rounds(problem, found, attempts, workers, progress)
    summits = [] if any(proof.unsurpassed for _, proof, _ in found) else climbed_anywhere(problem, workers)
    found, attempts, others = _higher(problem, found, attempts, summits, workers, BELOW)
    found, attempts = _past_stops(problem, found, attempts)
    return problem, _taken_up(problem, found, attempts, failures + more + others)


def _past_stops(
    problem: SelectionProblem, found: list[Found], attempts: list[Attempt]
) -> tuple[list[Found], list[Attempt]]:
    """The optima and attempts; of one that rests at a joint's end, a turn from where it may go on, what is there."""
    kept = list[Found]()
    for item in found:
        there, new = past_stops(problem, item[0]), list[Found]()
        if there is not None:
            more, others, _ = _attempted(problem, [there], 1, None, partial(_climbed, WITHIN[1]))
            attempts = attempts + [replace(other, value=None) for other in others]
            least = value_at(problem, item[0]) + BETTER * problem.objective_scale
            new = [other for other in more if value_at(problem, other[0]) > least]
        kept += [each for each in (new or [item]) if _is_new(problem, each[0], kept)]
    return kept, attempts


def _taken_up(
    problem: SelectionProblem, found: list[Found], attempts: list[Attempt], failures: list[tuple[Vector, Proof]]
) -> Optima:
    """The optima, after more from ends that break nothing and are better, but could not be verified."""
    least = BETTER * problem.objective_scale

    def ahead(ends: list[tuple[Vector, Proof]]) -> list[tuple[float, Vector]]:
        best = max(value_at(problem, z) for z, _, _ in found)
        better = [(value, z) for z, _ in ends if (value := value_at(problem, z)) > best + least]
        good = [end for end in better if not infeasible(single(problem), end[1])]
        return sorted(good, key=lambda end: -end[0])

    ends = [z for _, z in ahead(failures)[:TAKEN_UP]]
    found, attempts, failed = _higher(problem, found, attempts, ends, 1)
    left = ahead(failures + failed)
    return found, attempts, left[0][0] if left else None


def _higher(
    problem: SelectionProblem,
    found: list[Found],
    attempts: list[Attempt],
    points: list[Vector],
    workers: int,
    below: float = -BETTER,
) -> tuple[list[Found], list[Attempt], list[tuple[Vector, Proof]]]:
    """The optima and attempts with those from points that are better than all optima, and what failed of these.

    Or as good, up to so much `below` the best, as a share of the objective's scale.
    """
    least = max(value_at(problem, z) for z, _, _ in found) - below * problem.objective_scale
    starts = [z for z in points if value_at(problem, z) > least]
    if not starts:
        return found, attempts, []
    more, others, failed = _attempted(problem, starts, workers, None, partial(_climbed, WITHIN[1]))
    # They are no draws: what is told of the chance that more starts find more leaves them out.
    others = [replace(other, value=None) for other in others]
    return [*found, *(item for item in more if _is_new(problem, item[0], found))], attempts + others, failed


def _in_rounds(
    problem: SelectionProblem, found: list[Found], attempts: list[Attempt], workers: int, progress: Progress | None
) -> tuple[list[Found], list[Attempt], list[tuple[Vector, Proof]]]:
    """The optima and attempts with those of further rounds, and what failed in these.

    There are none where a number of starts is asked for.
    """
    left_open = (missed_chance(problem, attempts) or 0.0) > LEFT_OPEN
    best, in_vain, failures = max(value_at(problem, z) for z, _, _ in found), 0, list[tuple[Vector, Proof]]()
    for number in range(ROUNDS if left_open and problem.starts is None and climbs(problem) else 0):
        if in_vain == IN_VAIN or any(proof.unsurpassed for _, proof, _ in found):
            break
        ranked = sorted(found, key=lambda item: -value_at(problem, item[0]))
        starts = further_starts(problem, [z for z, _, _ in ranked], number, workers)
        told = partial(_told_of_all, progress, len(attempts)) if progress is not None else None
        more, others, failed = _attempted(problem, starts, workers, told, _solve_start, best)
        found = found + [item for item in more if _is_new(problem, item[0], found)]
        attempts, failures = attempts + others, failures + failed
        better = max((value_at(problem, z) for z, _, _ in more), default=-np.inf)
        in_vain = 0 if better > best + SAME_VALUE * problem.objective_scale else in_vain + 1
        best = max(best, better)
    return found, attempts, failures


def _told_of_all(progress: Progress, before: int, done: int, count: int) -> None:
    progress(before + done, before + count)


def later_optima(problem: SelectionProblem, starts: list[Vector], workers: int) -> Optima:
    """The same of a later objective, from optima of the one before and what the scan knows to keep them.

    These are few, and may lie where the solver gets stuck: in a valley as narrow as what the earlier objectives may
    give up, or where derivatives jump. Where none leads to an optimum, they may be optima of this objective, too; else
    points around them are tried, further and further away.
    """
    near = [*starts, *kept_peaks(problem)]
    found, attempts, failures = _attempted(problem, near, workers, None, _solve_start)
    best = max((value_at(problem, z) for z, _, _ in found), default=-np.inf)
    proofs = [(z, prove(problem, z)) for z in starts if value_at(problem, z) > best]
    found += [(z, proof, 0) for z, proof in proofs if proof.holds and _is_new(problem, z, found)]
    for round_number, distance in enumerate(AROUND):
        if found:
            break
        near = starts if distance == 0 else _around(problem, starts, distance, round_number)
        found, more, failed = _attempted(problem, near, workers, None, _finish)
        attempts, failures = attempts + more, failures + failed
    found, attempts = _not_below_seen(problem, found, attempts, failures)
    return _taken_up(problem, *_past_stops(problem, found, attempts), failures)


def _not_below_seen(
    problem: SelectionProblem,
    found: list[Found],
    attempts: list[Attempt],
    failures: list[tuple[Vector, Proof]],
) -> tuple[list[Found], list[Attempt]]:
    """The optima, and more from every point that was seen and is better than all of them.

    Raises:
        NoSolutionFound: there is none, or such a point leads to none that is as good.
    """
    values, tried = seen_values(problem), 0
    best = max((value_at(problem, z) for z, _, _ in found), default=-np.inf)
    while (point := better_than(problem, best, values)) is not None:
        if tried == len(WITHIN):
            raise _below(problem, best, point, len(attempts)) if found else _no_solution(problem, attempts, failures)
        more, others, failed = _attempted(problem, [point], 1, None, partial(_climbed, WITHIN[tried]))
        found += [item for item in more if _is_new(problem, item[0], found)]
        attempts, failures = attempts + [replace(other, value=None) for other in others], failures + failed
        better = max((value_at(problem, z) for z, _, _ in more), default=-np.inf)
        tried, best = (0, better) if better > best else (tried + 1, best)
    if not found:
        raise _no_solution(problem, attempts, failures)
    return found, attempts


def _below(problem: SelectionProblem, best: float, point: Vector, starts: int) -> NoSolutionFound:
    iterate = _named(problem, point)
    where = ", ".join(f"{name} = {value:.6g}" for name, value in iterate.items())
    short = value_at(problem, point) - best
    return NoSolutionFound(
        f"the best optimum of {problem.objective.name} from {starts} starts, {best:.6g}, is below {best + short:.6g} "
        f"of a configuration that was seen ({where}) and leads to no verified optimum; {_advice(problem)}",
        violations={"below what was seen": short},
        iterate=iterate,
    )


def _named(problem: SelectionProblem, z: Vector) -> dict[str, float]:
    return dict(zip((v.name for v in problem.variables), z.tolist(), strict=True))


def _around(problem: SelectionProblem, starts: list[Vector], distance: float, number: int) -> list[Vector]:
    """Points about the starts, within the bounds."""
    rng = np.random.default_rng([problem.seed, number])
    steps = distance * rng.standard_normal((AROUND_STARTS, problem.scale.size)) * problem.scale
    return [np.clip(starts[k % len(starts)] + step, problem.lower, problem.upper) for k, step in enumerate(steps)]


def _attempted(
    problem: SelectionProblem,
    starts: list[Vector],
    workers: int,
    progress: Progress | None,
    solve: Callable[[SelectionProblem, list[Vector], int], SolveOutcome],
    known: float = -np.inf,
) -> tuple[list[Found], list[Attempt], list[tuple[Vector, Proof]]]:
    """The same, and the points that failed the proof; there may be no optimum. `known`: the best value before."""
    found: list[Found] = []
    failures: list[tuple[Vector, Proof]] = []
    attempts: list[Attempt] = []

    # What candidates are evaluated by is built while others solve.
    meanwhile = partial(prepare, problem.machine, problem.control, gravity=problem.gravity)
    lost = partial(_lost, starts)
    at_once = climbs(problem)
    if at_once:
        single(problem).build()
    task = partial(solve, problem, starts)
    solved = in_parallel(task, len(starts), workers, progress, meanwhile, lost, at_once=at_once)
    for behind in (BEHIND if known == -np.inf else 0, *[0] * (RESUMED - 1)):
        unfinished = _promising(problem, solved, known, behind)
        if not unfinished:
            break
        points = [solved[number][0] for number in unfinished]
        task, lost = partial(taken_up_again, single(problem), points), partial(_lost, points)
        resumed = in_parallel(task, len(points), workers, lost=lost, at_once=at_once)
        for number, (z, proof, more, status) in zip(unfinished, resumed, strict=True):
            solved[number] = z, proof, solved[number][2] + more, status
    for start, (z, proof, iterations, status) in zip(starts, solved, strict=True):
        outcome, value = f"solver: {status}", None
        if proof is not None:
            if not proof.holds:
                failures.append((z, proof))
                outcome = f"{outcome}; fails {', '.join(proof.violations)}"
            elif accepted(single(problem), proof, status):
                new, value = (
                    _is_new(problem, z, found),
                    None if len(problem.kept) > problem.bounding else value_at(problem, z),
                )
                outcome = "a new local optimum" if new else "a local optimum found before"
                if new:
                    found.append((z, proof, iterations))
        attempts.append(Attempt(tuple(start.tolist()), outcome, value))
    return found, attempts, failures


def _lost(starts: list[Vector], number: int, sentence: str) -> SolveOutcome:
    return starts[number], None, 0, sentence


def accepted(program: Program, proof: Proof, status: str) -> bool:
    """Whether a point counts as an optimum.

    At a kink the solver's own stopping test may fail where the proof, which knows of both branches, holds; so it may
    where derivatives change without bound, as they do next to a_i = 0, and where no step is left that is not rounding.
    """
    climbed = any(form.kinks for form in program.first.forms)
    return proof.holds and (status in (*SOLVED, NO_STEP) or climbed or bool(proof.kinks) or proof.unsurpassed)


def _hurried(problem: SelectionProblem) -> bool:
    """Whether solves are cut short first: with one degree of redundancy optima are points, and solves are quick."""
    return problem.redundancy > 1


def _solve_start(problem: SelectionProblem, starts: list[Vector], number: int) -> SolveOutcome:
    """A start's solution; where there is much redundancy, after a few iterations (see `_promising`)."""
    start = _lifted(problem, starts[number])
    if not _hurried(problem):
        return finished(single(problem), start)
    if number < CLIMBED:
        found = single(problem).climbed(start, ASCENT_QUICK)
        if found is not None:
            return _proved(single(problem), *found)
    z, proof, iterations, status = _proved(single(problem), *single(problem).solve(start, quick=True))
    if proof is not None and not proof.holds and status in SOLVED:
        return climbed_from(single(problem), z, iterations)
    return z, proof, iterations, status


def _lifted(problem: SelectionProblem, z: Vector) -> Vector:
    """A point where own constraints hold, by climbing those that do not, one after another; z where none is found."""
    there = z
    for j in range(problem.bounding):
        stage = replace(
            problem,
            objectives=problem.objectives[: j + 1],
            objective_scales=problem.objective_scales[: j + 1],
            kept=problem.kept[:j],
            bounding=j + 1,
        )
        if value_at(stage, there) >= problem.kept[j]:
            continue
        found = single(stage).climbed(there, ASCENT_QUICK)
        if found is None or not value_at(stage, found[0]) >= problem.kept[j]:
            return z
        there = found[0]
    return there


def _finish(problem: SelectionProblem, starts: list[Vector], number: int) -> SolveOutcome:
    return finished(single(problem), starts[number])


def finished(program: Program, start: Vector) -> SolveOutcome:
    """A start's solution; where derivatives jump, by an ascent from there on."""
    z, proof, iterations, status = solved_once(program, start)
    if proof is None or proof.holds or any(form.kinks for form in program.first.forms):
        return z, proof, iterations, status
    return climbed_from(program, z, iterations, status)


def solved_once(program: Program, start: Vector) -> SolveOutcome:
    """Where the solver leads from a start."""
    return _proved(program, *program.solve(start))


def climbed_from(program: Program, z: Vector, iterations: int = 0, status: str = CUT_SHORT) -> SolveOutcome:
    """Where an ascent leads from a point that a solver reached with this status; that point where it is on no rows."""
    z, more, status = program.climbed(z, ASCENT_LONG) or (z, 0, status)
    return _proved(program, z, iterations + more, status)


def _proved(program: Program, z: Vector, iterations: int, status: str) -> SolveOutcome:
    """Where a solve ended, with its proof; after Newton's steps where only the first-order condition fails."""
    # A solver may end where the measures are no numbers, as at a singular posture: nothing can be proven there.
    if not (np.all(np.isfinite(z)) and np.isfinite(program.worth(z))):
        return z, None, iterations, status
    proof = prove_program(program, z)
    if proof.holds or status == CUT_SHORT:
        return z, proof, iterations, status
    z, better = polished(program, z, proof)
    for _ in range(AGAIN if any(form.kinks for form in program.first.forms) else 0):
        found = None if list(better.violations) != [FIRST_ORDER] else program.climbed(z, ASCENT_QUICK)
        if found is None:
            break
        there = prove_program(program, found[0])
        if not (there.holds or there.stationarity <= better.stationarity / 2):
            break
        z, better, iterations = found[0], there, iterations + found[1]
    return z, better, iterations, SOLVED[0] if better.holds else status


def _climbed(within: float, problem: SelectionProblem, starts: list[Vector], number: int) -> SolveOutcome:
    """As `_finish`, in steps of limited length for as long as they lead up."""
    z, total, status = starts[number], 0, CUT_SHORT
    proof: Proof | None = None
    for _ in range(ONWARD if np.isfinite(within) else 1):
        there, iterations, status = single(problem).solve(z, within=within)
        total += iterations
        if not np.all(np.isfinite(there)):
            break
        ahead, proof = value_at(problem, there) > value_at(problem, z), prove(problem, there)
        z = there
        if proof.holds or not ahead:
            break
    return z, proof, total, status


def taken_up_again(program: Program, points: list[Vector], number: int) -> SolveOutcome:
    """Where a solve that was cut short, or passes no proof, leads when it goes on."""
    return climbed_from(program, points[number])


def _promising(problem: SelectionProblem, solved: list[SolveOutcome], known: float, behind: int) -> list[int]:
    """As `promising`, of the starts that were cut short."""
    short = [k for k, (_, proof, _, status) in enumerate(solved) if status == CUT_SHORT and proof is not None]
    return promising(single(problem), solved, short, behind, known) if _hurried(problem) else []


def promising(
    program: Program, solved: list[SolveOutcome], short: list[int], behind: int, known: float = -np.inf
) -> list[int]:
    """Numbers of those starts, of some that are not done, that may still lead to more than the best optimum found.

    Those that are ahead of it, and the best `behind` of all, which may be on a long way; all where no optimum is known.
    """
    good = [z for z, proof, _, status in solved if proof is not None and accepted(program, proof, status)]
    best = max((program.worth(z) for z in good), default=known)
    if best == -np.inf:
        return short
    values = {k: program.worth(solved[k][0]) for k in short if nearly_feasible(program, solved[k][0])}
    order = sorted(values, key=lambda k: -values[k])
    return [k for number, k in enumerate(order) if values[k] > max(best, known) or number < behind]


def nearly_feasible(program: Program, x: Vector) -> bool:
    """Whether rows are so little off that the objective tells something."""
    each = enumerate(program.problems)
    return all(np.abs(beyond_bounds(problem, program.of(x, k))).max() <= NEARLY for k, problem in each)


def next_stage(
    problem: SelectionProblem, found: list[Found], unverified: float | None
) -> tuple[SelectionProblem, Kept]:
    """The problem of the next objective, with the best value of the present one to be kept; and what that is."""
    values = [value_at(problem, z) for z, _, _ in found]
    best = max(values)
    unit = problem.objective.unit(problem.control, problem.machine.joint_units)
    kept = Kept(problem.objective.name, best, best - problem.given_up(best), unverified=unverified, unit=unit)
    found[:] = [item for item, value in zip(found, values, strict=True) if value >= kept.at_least]
    return replace(problem, kept=(*problem.kept, kept.at_least)), kept


def _is_new(problem: SelectionProblem, z: Vector, found: list[Found]) -> bool:
    return all(np.abs((z - other) / problem.scale).max() > SAME_POINT for other, _, _ in found)


def _no_solution(
    problem: SelectionProblem, attempts: list[Attempt], failures: list[tuple[Vector, Proof]]
) -> NoSolutionFound:
    kept = ", ".join(objective.name for objective in problem.objectives[: len(problem.kept)])
    among = f" as an optimum of {problem.objective.name} among those that keep {kept}" if kept else ""
    heading = f"no configuration passed the checks{among} in {counted(len(attempts), 'start')}"
    if not failures:
        outcomes = "; ".join(sorted({attempt.outcome for attempt in attempts}))
        return NoSolutionFound(f"{heading}: {outcomes}{in_the_way(problem.assumed)}", violations={}, iterate={})
    z, proof = min(failures, key=lambda item: _severity(problem, item[1]))
    rows = (*problem.constraints, *problem.own_constraints)
    units = {c.name: c.unit for c in rows} | {f"{v.name} range": v.unit for v in problem.variables}
    sizes = violations_told(proof.violations, cornerless(problem), units)
    iterate = _named(problem, z)
    where = ", ".join(f"{name} = {value:.6g}" for name, value in iterate.items())
    advice = "" if infeasible(single(problem), z) else f"; {_advice(problem)}"
    missed = "".join(f"; {sentence}" for sentence in [kept_by_none(problem)] if sentence)
    return NoSolutionFound(
        f"{heading}; the best iterate ({where}) violates {sizes}{missed}{in_the_way(problem.assumed)}{advice}",
        violations=proof.violations,
        iterate=iterate,
    )


def _advice(problem: SelectionProblem) -> str:
    """What may help where nothing could be verified."""
    one_alone = np.count_nonzero(problem.objective.alpha) == 1 and not problem.objective.has_kinks
    return ADVICE.format("" if one_alone else ", such as one w_i alone")


def _severity(problem: SelectionProblem, proof: Proof) -> tuple[float, float]:
    """How far a point is from being a solution: its largest constraint violation, then the largest of all."""
    rows = (*problem.constraints, *problem.own_constraints)
    scales = {c.name: c.scale for c in rows} | {f"{v.name} range": v.scale for v in problem.variables}
    beyond = [worst_size(size / scales[name]) for name, size in proof.violations.items() if name in scales]
    return max(beyond, default=0.0), max(map(worst_size, proof.violations.values()))
