"""Solve a configuration problem from every peak of its scan, verify, rank."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from flexopt.errors import FlexoptError, NoSolutionFound
from flexopt.model import AnyMachine, Problem
from flexopt.model.arguments import Vector
from flexopt.model.documents import provenance
from flexopt.model.problem import SINGULARITY_MARGIN_DEG, Control, Elbow
from flexopt.plant.inverse_kinematics import inverse_kinematics
from flexopt.robustness.evaluation import Evaluation, evaluate_checked
from flexopt.selection.check import Proof, prove
from flexopt.selection.problem import SelectionProblem, build_selection
from flexopt.selection.result import Attempt, Candidate, Selection
from flexopt.selection.scan import peaks

# Objectives closer than this, relative to the problem's scale, rank as equal; IPOPT reaches an optimum at w = 0 to
# about the square of its step tolerance, far below.
TIE_TOLERANCE = 1e-9
SAME_POINT = 1e-4
# Enough for every peak of a curve; the redundancy of longer arms has maxima without end.
STARTS_DEFAULT = 64
# What an earlier objective may give up for a later one, relative to its scale: two postures with w that close to 0 are
# equally robust.
KEPT_SLACK = 1e-4

Progress = Callable[[int, int], None]
# A point, its proof, and IPOPT's iterations.
Found = tuple[Vector, Proof, int]


def select(
    machine: AnyMachine,
    target: Any,
    *,
    objective: str = "w1",
    control: Control = "inverse",
    weights: Sequence[float] | None = None,
    gravity: bool = False,
    gain: float = 5e5,
    base: Any = None,
    base_range: tuple[float, float] | None = None,
    elbow: Elbow = "up",
    singularity_margin_deg: float = SINGULARITY_MARGIN_DEG,
    starts: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Selection:
    """Choose placement and posture: `build_selection` and `solve_selection` in one.

    Args:
        machine, target, objective, control, weights, gravity, gain, base, base_range, elbow, singularity_margin_deg,
            starts, seed: as in `flexopt.build_selection`.
        progress: called with (starts done, starts in all).

    Raises:
        InputError, UnreachableTarget: as `build_selection`.
        NoSolutionFound: as `solve_selection`.
    """
    problem = build_selection(
        machine,
        target,
        objective=objective,
        control=control,
        weights=weights,
        gravity=gravity,
        gain=gain,
        base=base,
        base_range=base_range,
        elbow=elbow,
        singularity_margin_deg=singularity_margin_deg,
        starts=starts,
        seed=seed,
    )
    return solve_selection(problem, progress=progress)


def solve_problem(problem: Problem, *, progress: Progress | None = None) -> Selection:
    """Solve a problem file's problem (`flexopt.load_problem`).

    Raises:
        InputError, UnreachableTarget, NoSolutionFound: as `select`.
    """
    return select(**problem.select_arguments(), progress=progress)


def solve_selection(problem: SelectionProblem, *, progress: Progress | None = None) -> Selection:
    """Local optima of a configuration problem, each from a peak of the scan, each verified independently.

    Args:
        problem: from `flexopt.build_selection`.
        progress: called with (starts done, starts in all).

    Raises:
        NoSolutionFound: no start led to a point that passes the checks; names the violated constraints, their sizes
            and the best iterate.
    """
    indices = peaks(problem.scan)[: problem.starts or STARTS_DEFAULT]
    starts = [np.concatenate([problem.scan.base[:, k], problem.scan.posture[:, k]]) for k in indices]
    found, attempts = _optima(problem, starts, progress)
    while len(problem.kept) + 1 < len(problem.objectives):
        problem = _next_stage(problem, found)
        found, more = _optima(problem, [z for z, _, _ in found], None)
        attempts += more
    candidates = sorted((_candidate(problem, *item) for item in found), key=lambda c: _rank(problem, c))
    options = {"target": problem.target.tolist(), "objective": problem.name, "control": problem.control}
    options |= {"weights": [objective.weights.tolist() for objective in problem.objectives]}
    options |= {"gravity": problem.gravity, "gain": problem.gain, "seed": problem.seed}
    return Selection(
        best=candidates[0],
        candidates=tuple(candidates),
        initial=_initial(problem),
        attempts=tuple(attempts),
        problem=problem,
        provenance=provenance(problem.machine, **options),
    )


def _optima(
    problem: SelectionProblem, starts: list[Vector], progress: Progress | None
) -> tuple[list[Found], list[Attempt]]:
    """Distinct verified optima from the starts, and what became of each start."""
    found: list[Found] = []
    failures: list[tuple[Vector, Proof]] = []
    attempts: list[Attempt] = []
    for number, start in enumerate(starts):
        z, iterations, status = _run_solver(problem, start)
        outcome = f"solver: {status}"
        if np.all(np.isfinite(z)):
            proof = prove(problem, z)
            if not proof.holds:
                failures.append((z, proof))
                outcome = f"{outcome}; fails {', '.join(proof.violations)}"
            # At a kink the solver's own stopping test may fail where the proof, which knows of both branches, holds.
            elif status == "Solve_Succeeded" or problem.objective.has_kinks:
                new = _is_new(problem, z, found)
                outcome = "a new local optimum" if new else "a local optimum found before"
                if new:
                    found.append((z, proof, iterations))
        attempts.append(Attempt(tuple(start.tolist()), outcome))
        if progress is not None:
            progress(number + 1, len(starts))
    if not found:
        raise _no_solution(problem, attempts, failures)
    return found, attempts


def _next_stage(problem: SelectionProblem, found: list[Found]) -> SelectionProblem:
    """The problem of the next objective, with the best value of the present one to be kept."""
    n_base = problem.measures.plant.n_base
    values = [problem.quantities.branches(problem.objective, z[:n_base], z[n_base:])[0][0] for z, _, _ in found]
    keep = float(max(values)) - KEPT_SLACK * problem.objective_scale
    good = [item for item, value in zip(found, values, strict=True) if value >= keep]
    found[:] = good
    return replace(problem, kept=(*problem.kept, keep))


def _run_solver(problem: SelectionProblem, start: Vector) -> tuple[Vector, int, str]:
    """One solve from z = start: the point reached, iterations, and the solver's own status."""
    solver, p = problem.solver(), problem.measures.plant.parameter_values.full().ravel()
    margin, (shift, target_shift) = problem.constraints[-1], problem.shift
    objective, n_base = problem.objective, problem.measures.plant.n_base
    x0, lower, upper = ((bound - shift) / problem.scale for bound in (start, problem.lower, problem.upper))
    fixed, bounded = [np.zeros(problem.target.size)], [np.zeros(problem.target.size)]
    fixed.append(np.array([margin.lower]))
    bounded.append(np.array([margin.upper]))
    for earlier, kept, size in zip(problem.objectives, problem.kept, problem.objective_scales, strict=False):
        branches = 2 if earlier.has_kinks else 1
        fixed.append(np.full(branches, kept / size))
        bounded.append(np.full(branches, np.inf))
    if objective.has_kinks:
        value = problem.quantities.branches(objective, start[:n_base], start[n_base:])[0][0] / problem.objective_scale
        x0, lower, upper = np.append(x0, value), np.append(lower, -np.inf), np.append(upper, np.inf)
        fixed.append(np.zeros(2))
        bounded.append(np.full(2, np.inf))
    result = solver(
        x0=x0,
        p=np.concatenate([problem.target - target_shift, p]),
        lbx=lower,
        ubx=upper,
        lbg=np.concatenate(fixed),
        ubg=np.concatenate(bounded),
    )
    statistics: dict[str, Any] = solver.stats()
    z = result["x"].full().ravel()[: problem.scale.size] * problem.scale + shift
    turns = ~np.isfinite(problem.lower) & ~np.isfinite(problem.upper)
    z[turns] = (z[turns] + math.pi) % (2 * math.pi) - math.pi
    return np.clip(z, problem.lower, problem.upper), int(statistics["iter_count"]), str(statistics["return_status"])


def _is_new(problem: SelectionProblem, z: Vector, found: list[Found]) -> bool:
    return all(np.abs((z - other) / problem.scale).max() > SAME_POINT for other, _, _ in found)


def _candidate(problem: SelectionProblem, z: Vector, proof: Proof, iterations: int) -> Candidate:
    evaluation = _evaluated(problem, z)
    return Candidate(
        evaluation=evaluation,
        objective=problem.objectives[0].value(evaluation.w, evaluation.epsilon_max),
        active=proof.active,
        target_error=proof.target_error,
        stationarity=proof.stationarity,
        iterations=iterations,
    )


def _evaluated(problem: SelectionProblem, z: Vector) -> Evaluation:
    n_base = problem.measures.plant.n_base
    return evaluate_checked(
        problem.machine,
        z[n_base:],
        z[:n_base],
        control=problem.control,
        gain=problem.gain,
        damped=False,
        gravity=problem.gravity,
    )


def _rank(problem: SelectionProblem, candidate: Candidate) -> tuple[float, ...]:
    """Sorting key, smallest first: the objectives in order, the worst of the w_i in none of them, ε_max, distance."""
    e = candidate.evaluation
    key: list[float] = []
    first = problem.objective_scales[0]
    for number, (objective, size) in enumerate(zip(problem.objectives, problem.objective_scales, strict=True)):
        # An objective that was kept has been kept to within the slack.
        quantum = (KEPT_SLACK if number < len(problem.kept) else TIE_TOLERANCE) * size
        key.append(-round(objective.value(e.w, e.epsilon_max) / quantum))
    used = np.any([np.array(objective.alpha) > 0 for objective in problem.objectives], axis=0)
    others = [w for w, taken in zip(e.w, used, strict=True) if not taken] or [0.0]
    epsilon = 0.0 if e.epsilon_max is None else e.epsilon_max
    distance = 0.0 if problem.present_base is None else float(np.linalg.norm(e.base - problem.present_base))
    return (*key, -round(min(others) / (TIE_TOLERANCE * first)), -round(epsilon / TIE_TOLERANCE), distance)


def _initial(problem: SelectionProblem) -> Evaluation | None:
    """The posture at the present base on the elbow branch asked for, where it reaches and is regular."""
    if problem.present_base is None:
        return None
    try:
        postures = inverse_kinematics(
            problem.machine,
            problem.target,
            base=problem.present_base,
            gravity=problem.gravity,
            elbow=problem.elbow,
            seed=problem.seed,
        )
        return _evaluated(problem, np.concatenate([problem.present_base, postures[0]]))
    except FlexoptError:
        return None


def _no_solution(
    problem: SelectionProblem, attempts: list[Attempt], failures: list[tuple[Vector, Proof]]
) -> NoSolutionFound:
    heading = f"no configuration passed the checks in {len(attempts)} starts"
    if not failures:
        outcomes = "; ".join(sorted({attempt.outcome for attempt in attempts}))
        return NoSolutionFound(f"{heading}: {outcomes}", violations={}, iterate={})
    z, proof = min(failures, key=lambda item: max(item[1].violations.values()))
    units = {c.name: c.unit for c in problem.constraints} | {f"{v.name} range": v.unit for v in problem.variables}
    sizes = "; ".join(f"{name} by {size:.3g} {units.get(name, '')}".rstrip() for name, size in proof.violations.items())
    iterate = dict(zip((v.name for v in problem.variables), z.tolist(), strict=True))
    where = ", ".join(f"{name} = {value:.6g}" for name, value in iterate.items())
    return NoSolutionFound(
        f"{heading}; the best iterate ({where}) violates {sizes}", violations=proof.violations, iterate=iterate
    )
