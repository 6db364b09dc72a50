"""Solve a configuration problem from every peak of its scan, verify, rank."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from flexopt.errors import FlexoptError, NoSolutionFound
from flexopt.model import Machine, Problem
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

Progress = Callable[[int, int], None]


def select(
    machine: Machine,
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
    starts = peaks(problem.scan)[: problem.starts or STARTS_DEFAULT]
    found: list[tuple[Vector, Proof, int]] = []
    failures: list[tuple[Vector, Proof]] = []
    attempts: list[Attempt] = []
    for number, index in enumerate(starts):
        start = np.concatenate([problem.scan.base[:, index], problem.scan.posture[:, index]])
        z, iterations, status = _run_ipopt(problem, start)
        outcome = f"IPOPT: {status}"
        if np.all(np.isfinite(z)):
            proof = prove(problem, z)
            if not proof.holds:
                failures.append((z, proof))
                outcome = f"{outcome}; fails {', '.join(proof.violations)}"
            elif status in ("Solve_Succeeded", "Solved_To_Acceptable_Level"):
                new = _is_new(problem, z, found)
                outcome = "a new local optimum" if new else "a local optimum found before"
                if new:
                    found.append((z, proof, iterations))
        attempts.append(Attempt(tuple(start.tolist()), outcome))
        if progress is not None:
            progress(number + 1, len(starts))
    if not found:
        raise _no_solution(problem, attempts, failures)
    candidates = sorted((_candidate(problem, *item) for item in found), key=lambda c: _rank(problem, c))
    options = {"target": problem.target.tolist(), "objective": problem.objective, "control": problem.control}
    options |= {"weights": problem.weights.tolist(), "gravity": problem.gravity, "seed": problem.seed}
    return Selection(
        best=candidates[0],
        candidates=tuple(candidates),
        initial=_initial(problem),
        attempts=tuple(attempts),
        problem=problem,
        provenance=provenance(problem.machine, **options),
    )


def _run_ipopt(problem: SelectionProblem, start: Vector) -> tuple[Vector, int, str]:
    """One solve from z = start: the point reached, iterations, and IPOPT's own status."""
    solver, p = problem.solver(), problem.measures.plant.parameter_values.full().ravel()
    margin, (shift, target_shift) = problem.constraints[-1], problem.shift
    zeros = np.zeros(problem.target.size)
    result = solver(
        x0=(start - shift) / problem.scale,
        p=np.concatenate([problem.target - target_shift, p]),
        lbx=(problem.lower - shift) / problem.scale,
        ubx=(problem.upper - shift) / problem.scale,
        lbg=np.append(zeros, margin.lower),
        ubg=np.append(zeros, margin.upper),
    )
    statistics: dict[str, Any] = solver.stats()
    z = result["x"].full().ravel() * problem.scale + shift
    turns = ~np.isfinite(problem.lower) & ~np.isfinite(problem.upper)
    z[turns] = (z[turns] + math.pi) % (2 * math.pi) - math.pi
    return np.clip(z, problem.lower, problem.upper), int(statistics["iter_count"]), str(statistics["return_status"])


def _is_new(problem: SelectionProblem, z: Vector, found: list[tuple[Vector, Proof, int]]) -> bool:
    return all(np.abs((z - other) / problem.scale).max() > SAME_POINT for other, _, _ in found)


def _candidate(problem: SelectionProblem, z: Vector, proof: Proof, iterations: int) -> Candidate:
    evaluation = _evaluated(problem, z)
    return Candidate(
        evaluation=evaluation,
        objective=float(problem.weights @ evaluation.w),
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


def _rank(problem: SelectionProblem, candidate: Candidate) -> tuple[float, float, float]:
    """Sorting key, smallest first: objective, worst of the other w_i, distance from the present base."""
    quantum = TIE_TOLERANCE * problem.objective_scale
    e = candidate.evaluation
    others = [w for w, weight in zip(e.w, problem.weights, strict=True) if weight == 0] or [0.0]
    distance = 0.0 if problem.present_base is None else float(np.linalg.norm(e.base - problem.present_base))
    return -round(candidate.objective / quantum), -round(min(others) / quantum), distance


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
