"""Proof of a solution by functions that no solver used: feasibility, first- and second-order optimality.

In: a program, of one configuration or many, and a point. Out: what the point violates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.selection.broken import falls_within
from flexopt.selection.constraint_values import worst_size
from flexopt.selection.nlp.program import Program, margin_noise, single
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.proof.first_order import linearised, undecided
from flexopt.selection.proof.multipliers import STATIONARITY_TOLERANCE, FirstOrderModel, certified
from flexopt.selection.proof.second_order import CURVATURE_TOLERANCE, dimension_of, largest_curvature

TARGET_TOLERANCE = 1e-8
BOUND_TOLERANCE = 1e-8
FIRST_ORDER, SECOND_ORDER = "first-order optimality", "second-order optimality"
STATIONARY_NEARLY = 1e-3
# V this near to a value that no configuration exceeds, relative to its scale, is a maximum whatever its derivatives,
# which near a_i = 0 or b_i = 0 change without bound.
BEST_TOLERANCE = 1e-9
# How many times as much as ε_max's rounding may be missing of one that is kept.
NOISY = 4.0


@dataclass(frozen=True)
class Proof:
    """Residuals at a point x.

    Attributes:
        violations: constraint or bound name -> violation beyond its tolerance, in its unit.
        active: names of the bounds and constraints that hold with equality, the target's rows left out.
        target_error: |r − target|, m.
        stationarity: norm of what multipliers of the right signs leave of the objective's gradient, as in `Candidate`.
        curvature: largest curvature of the Lagrangian along the feasible directions, in the same units; positive
            where the point is no maximum.
        kinks: of every kink that the point stands on its multiplier, as a share of the largest one that an optimum has.
        unsurpassed: whether V is a value that no configuration exceeds.
        dimension: of the set of optima about the point: how many directions lead along optima as good; None where that
            is not known: where a_i and b_i vanish or sets may cross, and of stands and plans.
        pull: the largest slope, of V / size, with which an objective that is kept holds V's, at least 1: stationarity
            is told relative to it.
    """

    violations: dict[str, float]
    active: tuple[str, ...]
    target_error: float
    stationarity: float
    curvature: float
    kinks: dict[str, float]
    unsurpassed: bool
    dimension: int | None
    pull: float = 1.0

    @property
    def holds(self) -> bool:
        """Whether the point is feasible, stationary and no saddle or minimum."""
        return not self.violations


def prove(problem: SelectionProblem, z: Vector) -> Proof:
    """Check a point z = [base, posture] from the equations, in double, without IPOPT's own numbers."""
    return prove_program(single(problem), z)


def prove_program(program: Program, x: Vector) -> Proof:
    """Check a point x of a program from the equations, in double, by functions that no solver used."""
    local = linearised(program, x)
    violations = infeasible(program, x, local.g)
    multipliers, kept = certified(local)
    stationarity = float(np.linalg.norm(local.gradient - multipliers @ local.rows(kept)))
    for name, size in undecided(program, x):
        _note(violations, name, size, STATIONARITY_TOLERANCE)
    bounded = program.first.bounded_by_zero and program.goal != "motion"
    unsurpassed = bounded and -local.value <= BEST_TOLERANCE
    curvature, dimension = 0.0, dimension_of(program, x, local) if unsurpassed else None
    pull = 1.0 if unsurpassed else _pull_of_kept(program, local, multipliers, kept)
    if not unsurpassed:
        _note(violations, FIRST_ORDER, stationarity, STATIONARITY_TOLERANCE * pull)
        # Far from stationary points curvatures say nothing.
        near = stationarity <= STATIONARY_NEARLY
        curvature, dimension = largest_curvature(program, x, local, multipliers, kept) if near else (0.0, None)
        _note(violations, SECOND_ORDER, curvature, CURVATURE_TOLERANCE)
    rows, n_task = program.first.constraints, program.first.target.size
    lengths = np.array([row.scale for row in rows[:n_task]])
    of_targets = local.g[: len(rows) * program.coupling.count].reshape(-1, len(rows))[:, :n_task] * lengths
    off = float(np.sqrt(np.sum(of_targets**2, axis=1)).max())
    kinks = dict(zip((kink.name for kink in local.kinks), local.shares(multipliers, kept), strict=True))
    if program.goal != "weighted":
        dimension = None
    # Several rows may be one constraint, each on a side of a kink.
    active = tuple(dict.fromkeys((*local.names, *kinks)))
    return Proof(violations, active, off, stationarity, curvature, kinks, unsurpassed, dimension, pull)


def _note(violations: dict[str, float], name: str, size: float, tolerance: float) -> None:
    if not size <= tolerance:
        violations[name] = max(violations.get(name, 0.0), float(size), key=worst_size)


def infeasible(program: Program, x: Vector, g: Vector | None = None) -> dict[str, float]:
    """Constraints and bounds that are violated beyond their tolerances at x, in their units; g, the rows there."""
    g = linearised(program, x).g if g is None else g
    constraints, n_task = program.constraints(), program.first.target.size
    beyond = [
        float(max(row.lower - value, value - row.upper)) * row.scale for row, value in zip(constraints, g, strict=True)
    ]
    violations: dict[str, float] = {}
    each = len(program.first.constraints)
    for k, problem in enumerate(program.problems):
        for number in range(each):
            row, size = constraints[k * each + number], beyond[k * each + number]
            _note(violations, row.name, size, TARGET_TOLERANCE if number < n_task else BOUND_TOLERANCE * row.scale)
        for name, size in falls_within(problem, program.of(x, k)).items():
            _note(violations, f"{program.prefix(k)}{name}", size, 0.0)
        for variable, value in zip(problem.variables, program.of(x, k), strict=True):
            out = max(variable.lower - value, value - variable.upper)
            _note(violations, f"{program.prefix(k)}{variable.name} range", out, BOUND_TOLERANCE)
    rest = list(zip(constraints, beyond, strict=True))[each * len(program.problems) :]
    first, noise = program.first, 0.0
    pairs = zip(first.objectives[: len(first.kept)], first.objective_scales, strict=False)
    share = max((objective.beta / size for objective, size in pairs), default=0.0)
    if share > 0 and program.coupling.count == 1 and any(size > BOUND_TOLERANCE * row.scale for row, size in rest):
        noise = share * margin_noise(program.first, program.first.quantities.margin.values, program.of(x, 0))
    for row, size in rest:
        _note(violations, row.name, size, (BOUND_TOLERANCE + NOISY * noise) * row.scale)
    return violations


def _pull_of_kept(program: Program, local: FirstOrderModel, multipliers: Vector, kept: list[int]) -> float:
    """The largest slope, of V / size, with which an objective that is kept, or its kink, holds V's; at least 1.

    What may be given up is little, so that these are thousands that cancel: what is left is told relative to them.
    """
    first = len(program.first.constraints) * program.coupling.count + len(program.coupling.pairs)
    pulls = local.pulls(multipliers, kept)
    sizes = [
        abs(float(pull)) * float(np.linalg.norm(row))
        for (number, _), pull, row in zip(local.active, pulls, local.inequalities, strict=False)
        if number >= first
    ]
    sizes += [
        float(np.linalg.norm(multipliers[kink.rows] @ local.equalities[kink.rows]))
        for kink in local.kinks
        if kink.first is not None
    ]
    return max(1.0, *sizes) if sizes else 1.0
