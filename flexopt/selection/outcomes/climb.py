"""From a start to a local optimum of a loop's measure, and the proof that it is stationary.

In: an `OutcomeProgram` and a start y. Out: `Climbed`. The smallest of several smooth branches is climbed as an epigraph
by sequential quadratic programming: the largest level at which none is below zero. Derivatives are exact, and curvature
is gathered from them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.selection.broken import falls_within
from flexopt.selection.outcomes.branches import Branches
from flexopt.selection.outcomes.program import MEETING, OutcomeProgram, ProgramPoint
from flexopt.selection.places import FEASIBLE
from flexopt.selection.proof.check import prove
from flexopt.selection.proof.nonnegative import nonnegative_least_squares

# Steps at most, how exactly t is sought, and how often the search begins anew from where it came to.
STEPS, EXACT, AGAIN = 60, 1e-12, 3
# Steps onto the rows.
CORRECTIONS = 12
# Linear programs at most, and their trust radii, in scaled variables: the first and the least.
TRIES, RADIUS, LEAST_RADIUS = 60, 0.1, 1e-8
# Branches and rows that are active: distances, in units of their sizes.
ACTIVE, ON_ROW = 1e-6, 1e-7
# Norm of the Lagrangian's gradient, in scaled variables, below which a point is stationary.
STATIONARY = 1e-4


@dataclass(frozen=True)
class Climbed:
    """Where a climb ended.

    Attributes:
        y: the point;  value: the measure of the worst member.
        stationarity: norm of what multipliers leave of the gradient.
        active: names of the rows and bounds that it rests against;  steps: of the climb.
        members: of what is uncertain, (n, k), those that it is an optimum for; None where none were added.
        undone: whether others of what is uncertain have less there.
    """

    y: Vector
    value: float
    stationarity: float
    active: tuple[str, ...]
    steps: int
    members: Vector | None = None
    undone: bool = False

    @property
    def holds(self) -> bool:
        """Whether it is stationary to first order; it is on the rows."""
        return self.stationarity <= STATIONARY and math.isfinite(self.value) and not self.undone


def climbed(program: OutcomeProgram, start: Vector) -> Climbed | None:
    """The local optimum that a start leads to; None where it leads off the rows, or to where the machine falls over.

    Where the search stops at none, two motions may meet there; else steps that never lead down go on.
    """
    found = proven_of_modes(program, start) or _climbed(program, start)
    falls = found is not None and any(falls_within(part.problem, part.z(y)) for part, y in program.parts(found.y))
    return None if falls else found


def _climbed(program: OutcomeProgram, start: Vector) -> Climbed | None:
    found = _searched(program, start)
    if found is None or found.holds:
        return found
    if (proven := proven_of_modes(program, found.y, found.steps)) is not None:
        return proven
    met = _met(program, found)
    if met is not None:
        return met
    raised = _raised(program, found)
    return raised if raised is found or raised.holds else _met(program, raised) or raised


def proven_of_modes(program: OutcomeProgram, y: Vector, steps: int = 0) -> Climbed | None:
    """The point where the modes alone prove it an optimum, and what is kept has room or no configuration has more.

    On kinks of w_i, as where a mode does not move the end-point, branches have no slopes to tell that. None of several
    targets, and where that is not so.
    """
    if not program.measure.of_modes or len(program.parts(y)) > 1 or not math.isfinite(value := program.value(y)):
        return None
    proof = prove(program.problem, program.z(y))
    found = program.branches(y, program.level(value))
    room = found.values[found.by_level == 0]
    if not (proof.holds and (proof.unsurpassed or np.all(room > ACTIVE))):
        return None
    return Climbed(y, value, 0.0 if proof.unsurpassed else proof.stationarity, proof.active, steps)


def _raised(program: OutcomeProgram, found: Climbed) -> Climbed:
    """Where steps that never lead down, and searches from there, lead from where a search stopped."""
    for _ in range(AGAIN):
        if found.holds:
            break
        there, steps = _by_steps(program, found.y, found.value)
        again = _searched(program, there) if steps else None
        if again is None or program.level(again.value) - program.level(found.value) <= ACTIVE:
            break
        found = replace(again, steps=found.steps + steps + again.steps)
    return found


def _searched(program: OutcomeProgram, start: Vector) -> Climbed | None:
    """Where searches one after the other lead, as long as they lead up."""
    best, steps, value = start, 0, program.value(start)
    for _ in range(AGAIN if math.isfinite(value) else 0):
        found, more = _search(program, best, value, STEPS)
        steps += more
        there = onto_rows(program, found)
        after = -math.inf if there is None else program.value(there)
        if there is None or after <= value:
            break
        gained = program.level(after) - program.level(value)
        best, value = there, after
        if gained <= ACTIVE:
            break
    there = onto_rows(program, best)
    if there is None:
        return None
    value = program.value(there)
    return Climbed(there, value, *first_order(program, there, value), steps)


def _by_steps(program: OutcomeProgram, y: Vector, value: float) -> tuple[Vector, int]:
    """Where linear programs within a trust radius lead, each step taken only where the measure rises; and how many.

    Slower than `_search`, but branches whose slopes change abruptly do not mislead it.
    """
    from scipy.optimize import linprog  # noqa: PLC0415  (loads slowly)

    equal, low, high = _row_ends(program)
    radius, taken = RADIUS, 0
    for _ in range(TRIES if math.isfinite(value) else 0):
        level = program.level(value)
        found, rows, slopes = program.branches(y, level), program.rows(y), program.row_slopes(y)
        known = np.isfinite(found.slopes).all(axis=1)
        wide = np.column_stack([slopes, np.zeros(len(slopes))])
        above, below = ~equal & np.isfinite(low), ~equal & np.isfinite(high)
        limits = np.vstack([
            -np.column_stack([found.slopes, found.by_level])[known], -wide[above], wide[below],
        ])  # fmt: skip
        room = np.concatenate([found.values[known], (rows - low)[above], (high - rows)[below]])
        ends = np.column_stack(program.bounds) - y[:, None]
        while radius > LEAST_RADIUS:
            step: Any = linprog(
                np.append(np.zeros(y.size), -1.0), A_ub=limits, b_ub=np.maximum(room, 0.0), A_eq=wide[equal],
                b_eq=-rows[equal], bounds=[*np.clip(ends, -radius, radius).tolist(), (0.0, None)], method="highs",
            )  # fmt: skip
            promised = float(step.x[-1]) if step.status == 0 else 0.0
            if promised <= ACTIVE / 10:
                return y, taken
            there = onto_rows(program, y + step.x[:-1])
            after = -math.inf if there is None else program.value(there)
            gained = program.level(after) - level
            if there is not None and gained > promised / 10:
                y, value, taken = there, after, taken + 1
                radius *= 2.0 if gained > promised / 2 else 1.0
                break
            radius /= 3
        else:
            break
    return y, taken


def _met(program: OutcomeProgram, found: Climbed) -> Climbed | None:
    """Where two motions meet, near to where a climb ended that has no proof; None where that is none either.

    Of rates m ± Re √d neither has a slope there. Where d is real and not above zero both are m: that is climbed. With
    d = 0 the multiplier of Im d = 0 may have any sign, that of Re d ≤ 0 must not be below zero.

    Source: Burke and Overton, Mathematical Programming 90(2), 2001.
    """
    level = program.level(found.value)
    joined = program.meeting(found.y, level) if program.measure.of_rates and math.isfinite(level) else None
    if joined is None:
        return None
    there = onto_rows(joined, found.y)
    end = None if there is None else _searched(joined, there)
    if end is None:
        return None
    end = _raised(joined, end)
    if program.level(end.value) < level - ACTIVE:
        return None
    # Motions that decay alike and do not meet are told apart.
    if sum(name.endswith(MEETING) for name in end.active) < sum(name.endswith(MEETING) for name in joined.row_names):
        stationarity, active = first_order(program, end.y, end.value)
        end = replace(end, stationarity=stationarity, active=active)
    return replace(end, steps=found.steps + end.steps) if end.holds else None


def ahead(program: OutcomeProgram, start: Vector, steps: int) -> tuple[Vector, float]:
    """Where a few steps lead, and the value there; the start where they lead to nothing better."""
    before = program.value(start)
    if not math.isfinite(before):
        return start, before
    there = onto_rows(program, _search(program, start, before, steps)[0])
    if there is None or not (value := program.value(there)) > before:
        return start, before
    return there, value


def _row_ends(program: OutcomeProgram) -> tuple[NDArray[np.bool_], Vector, Vector]:
    """Which rows are equations, and between what each lies as `rows` counts, 0 for these."""
    lower, upper, scale = program.row_bounds
    equal = lower == upper
    return equal, np.where(equal, 0.0, lower / scale), np.where(equal, 0.0, upper / scale)


def onto_rows(program: OutcomeProgram, y: Vector) -> Vector | None:
    """The point moved onto the rows by the shortest steps; None where that fails.

    By the rows themselves, which under gravity know the deflection.
    """
    equal, low, high = _row_ends(program)
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


def _search(program: OutcomeProgram, start: Vector, value: float, steps: int) -> tuple[Vector, int]:
    """Sequential quadratic programming in [y, t]: the largest level t at which no branch is below zero."""
    from scipy.optimize import minimize  # noqa: PLC0415  (loads slowly)

    known: dict[bytes, Branches] = {}
    places: dict[bytes, tuple[ProgramPoint, Vector, Vector]] = {}

    def place(x: Vector) -> tuple[ProgramPoint, Vector, Vector]:
        y = np.clip(x[:-1], *program.bounds)
        key = y.tobytes()
        if key not in places:
            places[key] = program.place(y), program.rows(y), program.row_slopes(y)
        return places[key]

    def told(x: Vector) -> Branches:
        key = x.tobytes()
        if key not in known:
            found = place(x)[0].branches(float(x[-1]))
            # Where two multipliers meet there is no slope; a search may go on from there, a proof may not.
            known[key] = replace(found, slopes=np.nan_to_num(found.slopes), by_level=np.nan_to_num(found.by_level))
        return known[key]

    equal, least, most = _row_ends(program)
    first = np.append(start, program.level(value))
    count, free = len(told(first).values), ~equal

    def branches(x: Vector) -> Vector:
        values = told(x).values
        return np.pad(values, (0, max(0, count - len(values))), mode="edge")[:count]

    def branch_slopes(x: Vector) -> Vector:
        found = told(x)
        slopes = np.column_stack([found.slopes, found.by_level])
        return np.pad(slopes, ((0, max(0, count - len(slopes))), (0, 0)), mode="edge")[:count]

    def inequalities(x: Vector) -> Vector:
        rows = place(x)[1][free]
        return np.concatenate([_finite(rows - least[free]), _finite(most[free] - rows)])

    def inequality_slopes(x: Vector) -> Vector:
        slopes = np.column_stack([place(x)[2][free], np.zeros(int(free.sum()))])
        return np.vstack([slopes, -slopes])

    def equations(x: Vector) -> Vector:
        return place(x)[1][equal]

    def equation_slopes(x: Vector) -> Vector:
        slopes = place(x)[2][equal]
        return np.column_stack([slopes, np.zeros(len(slopes))])

    def below(x: Vector) -> float:
        return -float(x[-1])

    def down_always(_: Vector) -> Vector:
        return down

    down = np.zeros(first.size)
    down[-1] = -1.0
    constraints: list[dict[str, Any]] = [
        {"type": "eq", "fun": equations, "jac": equation_slopes},
        {"type": "ineq", "fun": branches, "jac": branch_slopes},
        {"type": "ineq", "fun": inequalities, "jac": inequality_slopes},
    ]
    ends = [(low if np.isfinite(low) else None, high if np.isfinite(high) else None)
            for low, high in zip(*program.bounds, strict=True)]  # fmt: skip
    low, high = (end if math.isfinite(end) else None for end in program.measure.ends(place(first)[0]))
    solve: Any = minimize
    found: Any = solve(
        below, first, jac=down_always, method="SLSQP", bounds=[*ends, (low, high)],
        constraints=constraints, options={"maxiter": steps, "ftol": EXACT},
    )  # fmt: skip
    y = np.asarray(found.x[:-1], dtype=np.float64)
    return (y if np.all(np.isfinite(y)) else start), int(found.nit)


def _finite(distances: Vector) -> Vector:
    """Distances to bounds; where there is none, one that never matters."""
    return np.where(np.isfinite(distances), distances, 1.0)


def first_order(program: OutcomeProgram, y: Vector, value: float) -> tuple[float, tuple[str, ...]]:
    """Norm of what multipliers of the right signs leave of the gradient; names of what is active.

    0 = Σ λ_k g_k + Σ μ_i a_i, λ, μ ≥ 0, −Σ λ_k ∂_t = 1, over the branches that are least, with slopes g_k by y and
    ∂_t by the level, and the active rows a_i. Infinite where a least branch has no slope.
    """
    if not math.isfinite(value):
        return math.inf, ()
    branches, rows, slopes = program.branches(y, program.level(value)), program.rows(y), program.row_slopes(y)
    chosen = branches.values <= branches.values[0] + ACTIVE
    least, by_level = branches.slopes[chosen], branches.by_level[chosen]
    if not (np.all(np.isfinite(least)) and np.all(np.isfinite(by_level))):
        return math.inf, ()
    equal, lowest, highest = _row_ends(program)
    columns, names = list[Vector](), list[str]()
    for number, row_name in enumerate(program.row_names):
        if equal[number]:
            columns += [slopes[number], -slopes[number]]
            continue
        for sign, end in ((1.0, lowest[number]), (-1.0, highest[number])):
            if abs(rows[number] - end) <= ON_ROW:
                columns.append(sign * slopes[number])
                names.append(row_name)
    for i, (name, low, high) in enumerate(zip(program.names, *program.bounds, strict=True)):
        for sign, end, side in ((1.0, low, "lower"), (-1.0, high, "upper")):
            if abs(y[i] - end) <= ON_ROW:
                column = np.zeros(y.size)
                column[i] = sign
                columns.append(column)
                if low != high:
                    names.append(f"{name} {side} bound")
    return _left_open(least, by_level, columns), tuple(names)


def _left_open(least: Vector, by_level: Vector, columns: list[Vector]) -> float:
    """Norm of what nonnegative multipliers of branches (k, n) and rows leave of the gradient.

    Infinite where no branch that is least falls with the level: there it is not the level that is reached.
    """
    # The last row asks for −Σ λ_k ∂_t = 1, with a weight that leaves nothing of it open.
    weight = 1e3 * max(1.0, float(np.abs(least).max(initial=0.0)))
    matrix = np.zeros((least.shape[1] + 1, len(least) + len(columns)))
    matrix[:-1] = np.array([*least, *columns]).T
    matrix[-1, : len(least)] = -weight * by_level
    right = np.zeros(len(matrix))
    right[-1] = weight
    multipliers = nonnegative_least_squares(matrix, right)
    left = matrix @ multipliers - right
    return math.inf if abs(left[-1]) > weight / 2 else float(np.linalg.norm(left[:-1]))
