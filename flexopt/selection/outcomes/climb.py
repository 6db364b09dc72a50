"""From a start to a local optimum of a loop's decay, and the proof that it is stationary.

In: an `OutcomeProgram` and a start y. Out: `Climbed`. The smallest of several smooth branches is climbed as an epigraph
by sequential quadratic programming; derivatives are exact, and curvature is gathered from them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.selection.nonnegative import nonnegative_least_squares
from flexopt.selection.outcomes.program import Branches, OutcomeProgram
from flexopt.selection.starts import FEASIBLE

# Steps at most, how exactly t is sought, and how often the search begins anew from where it came to.
STEPS, EXACT, AGAIN = 60, 1e-12, 3
# Steps onto the rows.
CORRECTIONS = 12
# Branches and rows that are active: distances, in units of their sizes.
ACTIVE, ON_ROW = 1e-6, 1e-7
# Norm of the Lagrangian's gradient, in scaled variables, below which a point is stationary.
STATIONARY = 1e-4


@dataclass(frozen=True)
class Climbed:
    """Where a climb ended.

    Attributes:
        y: the point;  value: the decay of the slowest member, 1/s.
        stationarity: norm of what multipliers leave of the gradient.
        active: names of the rows and bounds that it rests against;  steps: of the climb.
    """

    y: Vector
    value: float
    stationarity: float
    active: tuple[str, ...]
    steps: int

    @property
    def holds(self) -> bool:
        """Whether it is stationary to first order; it is on the rows."""
        return self.stationarity <= STATIONARY and math.isfinite(self.value)


def climbed(program: OutcomeProgram, start: Vector) -> Climbed | None:
    """The local optimum that a start leads to; None where it leads off the rows."""
    best, steps = start, 0
    for _ in range(AGAIN):
        before = program.value(best)
        found, more = _search(program, best, STEPS)
        steps += more
        there = onto_rows(program, found)
        if there is None or program.value(there) <= before:
            break
        gained = program.value(there) - before
        best = there
        if gained <= ACTIVE * program.size:
            break
    there = onto_rows(program, best)
    if there is None:
        return None
    stationarity, active = first_order(program, there)
    return Climbed(there, program.value(there), stationarity, active, steps)


def ahead(program: OutcomeProgram, start: Vector, steps: int) -> tuple[Vector, float]:
    """Where a few steps lead, and the value there; the start where they lead to nothing better."""
    there, before = onto_rows(program, _search(program, start, steps)[0]), program.value(start)
    if there is None or not (value := program.value(there)) > before:
        return start, before
    return there, value


def onto_rows(program: OutcomeProgram, y: Vector) -> Vector | None:
    """The point moved onto the rows by the shortest steps; None where that fails.

    By the rows themselves, which under gravity know the deflection.
    """
    lower, upper, scale = program.problem.row_bounds
    equal = lower == upper
    low, high = np.where(equal, 0.0, lower / scale), np.where(equal, 0.0, upper / scale)
    y = np.clip(y, *program.bounds)
    for _ in range(CORRECTIONS):
        rows = program.rows(y)
        beyond = np.minimum(rows - low, 0.0) + np.maximum(rows - high, 0.0)
        if not np.all(np.isfinite(beyond)):
            return None
        if float(np.abs(beyond).max(initial=0.0)) <= FEASIBLE / 100:
            return y
        wrong = equal | (beyond != 0)
        moving = (program.bounds[0] < program.bounds[1]).astype(float)
        step = moving * np.linalg.lstsq(program.row_slopes(y)[wrong] * moving, beyond[wrong], rcond=1e-12)[0]
        y = np.clip(y - step, *program.bounds)
    return None


def _search(program: OutcomeProgram, start: Vector, steps: int) -> tuple[Vector, int]:
    """Sequential quadratic programming in [y, t]: max t with every branch at least t."""
    from scipy.optimize import minimize  # noqa: PLC0415  (loads slowly)

    known: dict[bytes, tuple[Branches, Vector, Vector]] = {}

    def told(x: Vector) -> tuple[Branches, Vector, Vector]:
        y = np.clip(x[:-1], *program.bounds)
        key = y.tobytes()
        if key not in known:
            found = program.branches(y)
            # Where two multipliers meet there is no slope; a search may go on from there, a proof may not.
            known[key] = replace(found, slopes=np.nan_to_num(found.slopes)), program.rows(y), program.row_slopes(y)
        return known[key]

    lower, upper, scale = program.problem.row_bounds
    equal = lower == upper
    count, free = len(told(np.append(start, 0.0))[0].values), ~equal

    def branches(x: Vector) -> Vector:
        values = told(x)[0].values
        return np.pad(values, (0, max(0, count - len(values))), mode="edge")[:count] - x[-1]

    def branch_slopes(x: Vector) -> Vector:
        slopes = told(x)[0].slopes
        slopes = np.pad(slopes, ((0, max(0, count - len(slopes))), (0, 0)), mode="edge")[:count]
        return np.column_stack([slopes, np.full(count, -1.0)])

    def inequalities(x: Vector) -> Vector:
        rows = told(x)[1][free]
        return np.concatenate([_finite(rows - (lower / scale)[free]), _finite((upper / scale)[free] - rows)])

    def inequality_slopes(x: Vector) -> Vector:
        slopes = np.column_stack([told(x)[2][free], np.zeros(int(free.sum()))])
        return np.vstack([slopes, -slopes])

    def equations(x: Vector) -> Vector:
        return told(x)[1][equal]

    def equation_slopes(x: Vector) -> Vector:
        slopes = told(x)[2][equal]
        return np.column_stack([slopes, np.zeros(len(slopes))])

    def below(x: Vector) -> float:
        return -float(x[-1])

    def down_always(_: Vector) -> Vector:
        return down

    first = np.append(start, told(np.append(start, 0.0))[0].values[0])
    down = np.zeros(first.size)
    down[-1] = -1.0
    constraints: list[dict[str, Any]] = [
        {"type": "eq", "fun": equations, "jac": equation_slopes},
        {"type": "ineq", "fun": branches, "jac": branch_slopes},
        {"type": "ineq", "fun": inequalities, "jac": inequality_slopes},
    ]
    ends = [(low if np.isfinite(low) else None, high if np.isfinite(high) else None)
            for low, high in zip(*program.bounds, strict=True)]  # fmt: skip
    solve: Any = minimize
    found: Any = solve(
        below, first, jac=down_always, method="SLSQP", bounds=[*ends, (None, None)],
        constraints=constraints, options={"maxiter": steps, "ftol": EXACT},
    )  # fmt: skip
    y = np.asarray(found.x[:-1], dtype=np.float64)
    return (y if np.all(np.isfinite(y)) else start), int(found.nit)


def _finite(distances: Vector) -> Vector:
    """Distances to bounds; where there is none, one that never matters."""
    return np.where(np.isfinite(distances), distances, 1.0)


def first_order(program: OutcomeProgram, y: Vector) -> tuple[float, tuple[str, ...]]:
    """Norm of what multipliers of the right signs leave of the gradient; names of what is active.

    0 = Σ λ_k g_k + Σ μ_i a_i, λ, μ ≥ 0, Σ λ = 1, over the branches g_k that are least and the active rows a_i. Infinite
    where a least branch has no slope.
    """
    branches, rows, slopes = program.branches(y), program.rows(y), program.row_slopes(y)
    least = branches.slopes[branches.values <= branches.values[0] + ACTIVE * max(1.0, abs(branches.values[0]))]
    if not np.all(np.isfinite(least)):
        return math.inf, ()
    lower, upper, scale = program.problem.row_bounds
    columns, names = list[Vector](), list[str]()
    for number, constraint in enumerate(program.problem.constraints):
        if lower[number] == upper[number]:
            columns += [slopes[number], -slopes[number]]
            continue
        for sign, end in ((1.0, lower[number]), (-1.0, upper[number])):
            if abs(rows[number] - end / scale[number]) <= ON_ROW:
                columns.append(sign * slopes[number])
                names.append(constraint.name)
    of_gains = [f"loop.{name}" for name in program.ranges]
    variables = [*(variable.name for variable in program.problem.variables), *of_gains]
    for i, (name, low, high) in enumerate(zip(variables, *program.bounds, strict=True)):
        for sign, end, side in ((1.0, low, "lower"), (-1.0, high, "upper")):
            if abs(y[i] - end) <= ON_ROW:
                column = np.zeros(y.size)
                column[i] = sign
                columns.append(column)
                if low != high:
                    names.append(f"{name} {side} bound")
    # The last row asks for Σ λ = 1, with a weight that leaves nothing of it open.
    weight = 1e3 * max(1.0, float(np.abs(least).max(initial=0.0)))
    matrix = np.zeros((y.size + 1, len(least) + len(columns)))
    matrix[:-1] = np.array([*least, *columns]).T
    matrix[-1, : len(least)] = weight
    right = np.zeros(y.size + 1)
    right[-1] = weight
    multipliers = nonnegative_least_squares(matrix, right)
    return float(np.linalg.norm((matrix @ multipliers - right)[:-1])), tuple(names)
