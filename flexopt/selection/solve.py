"""Solve a configuration problem: its optima, one of each continuum, ranked."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, Unpack

import numpy as np

from flexopt.errors import FlexoptError
from flexopt.foundation.arrays import Vector
from flexopt.foundation.boundary import Keywords, instance, public
from flexopt.foundation.documents import provenance
from flexopt.foundation.turns import available_cores
from flexopt.model import AnyMachine
from flexopt.model.constraints import Constraints
from flexopt.model.problem import SelectionKeywords, SelectionOptions
from flexopt.plant.inverse_kinematics import inverse_kinematics
from flexopt.robustness.evaluation import Evaluation
from flexopt.robustness.plausibility import warn_implausible
from flexopt.selection.build import build_selection, only_notes
from flexopt.selection.continua import grouped
from flexopt.selection.optima import Found, Progress, first_optima, later_optima, next_stage
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.result import Candidate, ConstraintValue, Kept, Selection
from flexopt.selection.starts import starting_points

# Objectives closer than this, relative to the problem's scale, rank as equal; IPOPT reaches an optimum at w = 0 to
# about the square of its step tolerance, far below.
TIE_TOLERANCE = 1e-9


@public(together=only_notes, keywords=Keywords(SelectionOptions, SelectionKeywords))
def select(
    machine: AnyMachine,
    target: Any,
    *,
    constraints: Constraints | Mapping[str, Any] | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
    options: SelectionOptions | None = None,  # noqa: ARG001 - its fields come as keywords
    **keywords: Unpack[SelectionKeywords],
) -> Selection:
    """Choose placement and posture: `build_selection` and `solve_selection` in one.

    Args:
        machine, target, constraints, options, keywords: as in `flexopt.build_selection`.
        workers: as in `flexopt.solve_selection`.
        progress: called with (starts done, starts in all).

    Raises:
        InputError, UnreachableTarget: as `build_selection`.
        NoSolutionFound: as `solve_selection`.
    """
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
    """
    warn_implausible(problem.machine)
    count = workers or available_cores()
    found, attempts = first_optima(problem, starting_points(problem), count, progress)
    kept: list[Kept] = []
    while len(problem.kept) + 1 < len(problem.objectives):
        problem, now = next_stage(problem, found)
        kept.append(now)
        found, more = later_optima(problem, [z for z, _, _ in found], count)
        attempts += more
    groups = grouped(problem, [z for z, _, _ in found])
    candidates = _ranked(problem, [_candidate(problem, [found[k] for k in group]) for group in groups])
    # What may still be wrong with it shows here, not when it is first asked for.
    assert candidates[0].evaluation is not None
    options = {"target": problem.target.tolist(), "objective": problem.name, "control": problem.control}
    options |= {"weights": [objective.weights.tolist() for objective in problem.objectives]}
    options |= {"gravity": problem.gravity, "gain": problem.gain, "seed": problem.seed, "slack": problem.slack}
    return Selection(
        best=candidates[0],
        candidates=tuple(candidates),
        initial=_initial(problem),
        attempts=tuple(attempts),
        kept=tuple(kept),
        problem=problem,
        provenance=provenance(problem.machine, **options),
    )


def _candidate(problem: SelectionProblem, group: list[Found]) -> Candidate:
    """The first of a continuum, and where the base stands in the others."""
    (z, proof, iterations), *others = group
    n_base, p = problem.measures.plant.n_base, problem.measures.plant.parameter_values
    return Candidate(
        z=z,
        w=problem.measures.w.call([z[:n_base], z[n_base:], p])[0].full().ravel(),
        objective=float(problem.branches(problem.objectives[0], z)[0][0]),
        active=proof.active,
        constraints=constraint_values(problem, z),
        target_error=proof.target_error,
        stationarity=proof.stationarity,
        iterations=iterations,
        kinks=proof.kinks,
        unsurpassed=proof.unsurpassed,
        evaluate=partial(problem.quantities.evaluated, z),
        continuum=tuple(tuple(other[:n_base].tolist()) for other, _, _ in others),
    )


def constraint_values(problem: SelectionProblem, z: Vector) -> dict[str, ConstraintValue]:
    """Every constraint besides the target: its value and bounds."""
    plant, n_task = problem.measures.plant, problem.target.size
    at = [z[: plant.n_base], z[plant.n_base :], plant.parameter_values]
    values = [float(plant.singularity_sine_squared.call(at)[0])]
    if problem.constraint_set is not None:
        reported = problem.constraint_set.report.call([*at, problem.constraint_set.constants])[0]
        values += reported.full().ravel().tolist()
    return {
        constraint.name: ConstraintValue(value, constraint.lower, constraint.upper, constraint.unit)
        for constraint, value in zip(problem.constraints[n_task:], values, strict=True)
    }


def _ranked(problem: SelectionProblem, candidates: list[Candidate]) -> list[Candidate]:
    """Best first: the last objective, those before, the worst of the w_i in none of them, ε_max, distance.

    ε_max is asked for where it decides only: it costs more than all else about a candidate.
    """
    keys = [_rank(problem, candidate) for candidate in candidates]
    decided = {key for key in keys if keys.count(key) == 1}
    last = [(0.0, 0.0) if key in decided else _tie(problem, c) for key, c in zip(keys, candidates, strict=True)]
    order = sorted(range(len(candidates)), key=lambda k: (keys[k], last[k]))
    return [candidates[k] for k in order]


def _rank(problem: SelectionProblem, candidate: Candidate) -> tuple[float, ...]:
    """Sorting key, smallest first: the last objective, those that all keep, the worst of the w_i in none of them."""
    key: list[float] = []
    for objective, size in zip(reversed(problem.objectives), reversed(problem.objective_scales), strict=True):
        key.append(-round(float(problem.branches(objective, candidate.z)[0][0]) / (TIE_TOLERANCE * size)))
    used = np.any([np.array(objective.alpha) > 0 for objective in problem.objectives], axis=0)
    others = [w for w, taken in zip(candidate.w, used, strict=True) if not taken] or [0.0]
    return (*key, -round(min(others) / (TIE_TOLERANCE * problem.objective_scales[0])))


def _tie(problem: SelectionProblem, candidate: Candidate) -> tuple[float, float]:
    """What decides between equals: ε_max, then the distance from the present base."""
    e = candidate.evaluation
    epsilon = 0.0 if e.epsilon_max is None else e.epsilon_max
    distance = 0.0 if problem.present_base is None else float(np.linalg.norm(e.base - problem.present_base))
    return -round(epsilon / TIE_TOLERANCE), distance


def _initial(problem: SelectionProblem) -> Evaluation | None:
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
