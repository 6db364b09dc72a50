"""Which bounds and constraints a configuration breaks, and which it rests on."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.foundation.coordinates import turned_into
from flexopt.selection.constraint_values import ConstraintValue
from flexopt.selection.constraints.corners import WHERE, all_corners
from flexopt.selection.constraints.ground import NAME as GROUND
from flexopt.selection.constraints.joint_limits import JOINT_MARGIN, LIMITS
from flexopt.selection.held import EQUILIBRIUM, ON_TARGET, held_with, not_standing
from flexopt.selection.problem import SelectionProblem, own_held, own_with, rows_held, rows_with

# From shares (N,) of a way to its configurations z (n_z, N), and which of them there are (N,).
Way = Callable[[Vector], tuple[Vector, NDArray[np.bool_]]]
# How near to a bound a configuration rests on it, of its scale.
AT_END = 1e-6
# Share of a variable's or constraint's scale beyond which a bound is broken; how many are named.
BROKEN, NAMED = 1e-6, 3
# To which share of a way it is found where something is broken most.
FINE = 1e-6
# Where `base_range` lets the base stand, by coordinate.
BASE_RANGE = "base_range of "
# Names of what holds unasked: the margin that every program has, which makes a posture no worse to hold, and besides it
# limits, and what lies above the assumed ground.
SINGULAR = re.compile("^singularity margin$")
UNASKED = re.compile(f"^{LIMITS}|{SINGULAR.pattern}| {re.escape(GROUND)}$")


def broken(problem: SelectionProblem, z: Vector, *, asked: bool = False) -> str:
    """Which limits and constraints a configuration breaks, the target aside, the worst first; empty where none.

    What somebody asked for with its value; of a constraint at several corners of `constraints.within` the worst.
    `asked`: as of `broken_names`.
    """
    return _told(_worst_of(problem, [(name, z) for name in broken_names(problem, z, asked=asked)]), problem)


def broken_on(problem: SelectionProblem, way: Way, shares: Vector) -> str:
    """As `broken`, on a way: of each limit and constraint where it is broken most.

    Looked for at these shares of it, and of what is told between the neighbours of the worst of them.
    """
    zs, there = way(shares)
    most = dict[str, tuple[float, int]]()
    for k in np.flatnonzero(there).tolist():
        for name, off in _by_how_much(problem, zs[:, k], asked=False, p=None).items():
            if off > max(BROKEN, most.get(name, (0.0,))[0]):
                most[name] = off, k
    ordered = sorted(most.items(), key=lambda each: -each[1][0])
    worst = _worst_of(problem, [(name, zs[:, k]) for name, (_, k) in ordered])
    ends = np.concatenate([[0.0], shares, [1.0]])
    for name, (row, _) in [*worst.items()][:NAMED]:
        off, k = most[row]
        deepest, z = _deepest(problem, way, row, (ends[k], ends[k + 2]))
        worst[name] = row, z if deepest > off else zs[:, k]
    return _told(worst, problem)


def _deepest(problem: SelectionProblem, way: Way, row: str, span: tuple[float, float]) -> tuple[float, Vector]:
    """By how much a row is broken where a bounded search between two shares of a way ends, and its configuration."""
    from scipy.optimize import minimize_scalar  # noqa: PLC0415  (loads slowly)

    def off(share: float) -> tuple[float, Vector]:
        z, there = way(np.array([share]))
        # Where a machine does not fall over there is no row of it.
        return _by_how_much(problem, z[:, 0], asked=False, p=None).get(row, 0.0) if there[0] else 0.0, z[:, 0]

    def finite(share: float) -> float:
        # Rising with how much, infinite where a value is no number.
        return -math.atan(off(share)[0])

    return off(float(minimize_scalar(finite, bounds=span, method="bounded", options={"xatol": FINE}).x))


def _worst_of(problem: SelectionProblem, each: Sequence[tuple[str, Vector]]) -> dict[str, tuple[str, Vector]]:
    """By name without the corner of `constraints.within` the first row of that name, and its configuration."""
    worst, at_corners = dict[str, tuple[str, Vector]](), cornerless(problem)
    for row, z in each:
        worst.setdefault(at_corners.get(row, row), (row, z))
    return worst


def _told(worst: Mapping[str, tuple[str, Vector]], problem: SelectionProblem) -> str:
    if not worst:
        return ""
    p, told = problem.measures.plant.parameter_values.full().ravel(), list[str]()
    for name, (row, z) in [*worst.items()][:NAMED]:
        values = {} if UNASKED.search(name) else values_with(problem, z, p)
        value, where = values.get(row), row.removeprefix(name)
        told.append(row if value is None else f"{name}, {value}{where and ','}{where}")
    more = f" and {len(worst) - NAMED} more" if len(worst) > NAMED else ""
    return f"breaks {'; '.join(told)}{more}"


def broken_names(problem: SelectionProblem, z: Vector, *, asked: bool = False, p: Vector | None = None) -> list[str]:
    """Names of the limits and constraints that a configuration breaks, the target aside, the worst first.

    What is no number, as where a linkage does not close, is broken, too.
    `asked`: of those alone that somebody asked for: no limits, no margin from singular postures, no assumed ground.
    `p`: the machine's numbers, where they may be others, and the arm is held on its target: there limits and that
    ground count, asked for or not; corners of `constraints.within` have numbers of their own.
    """
    found = _by_how_much(problem, z, asked=asked, p=p)
    return sorted((name for name, off in found.items() if off > BROKEN), key=lambda name: -found[name])


def _by_how_much(problem: SelectionProblem, z: Vector, *, asked: bool, p: Vector | None) -> dict[str, float]:
    """How far each limit and constraint, the target aside, is beyond its bounds, in units of its scale."""
    told = _told_turns(problem, np.concatenate(held_with(problem.quantities, z, p)))
    outside: Vector = np.maximum(problem.lower - told, told - problem.upper) / problem.scale
    # Where nobody gave a range a placement's bounds are where the target is reached from: none of the machine's.
    for k, each in enumerate(problem.variables[: problem.measures.plant.n_base]):
        if not each.ranged:
            outside[k] = 0.0
    rows = np.abs(beyond_bounds(problem, z, p))[problem.target.size :]
    falls = falls_within(problem, z) if p is None else {}
    if p is not None and (falls := not_standing(problem.quantities, z, p)):
        # What else it would break is no number.
        return dict.fromkeys(falls, math.inf)
    found = [*outside, *rows, *beyond_own(problem, z, p), *falls.values()]
    away = np.nan_to_num(found, nan=np.inf, posinf=np.inf).tolist()
    names = _names_of_bounds(problem)
    names += [row.name for row in (*problem.constraints[problem.target.size :], *problem.own_constraints)]
    names += falls
    of = cornerless(problem)
    unasked = UNASKED if p is None else SINGULAR
    by_name = dict[str, float]()
    for name, off in zip(names, away, strict=True):
        if not ((asked and unasked.search(of.get(name, name))) or (p is not None and name in of)):
            # Several rows may be one constraint.
            by_name[name] = max(off, by_name.get(name, off))
    return by_name


def _told_turns(problem: SelectionProblem, z: Vector) -> Vector:
    """The same configuration with its base turned to where its bounds are: what they ask of it are no whole turns."""
    n_base, bounds = problem.measures.plant.n_base, (problem.lower, problem.upper)
    return np.append(turned_into(z[:n_base], bounds, problem.machine.base_units), z[n_base:])


def _names_of_bounds(problem: SelectionProblem) -> list[str]:
    """What keeps each variable within its bounds, by name: its limits, or what was asked for, a range or a margin."""
    n_base, kept = problem.measures.plant.n_base, LIMITS if problem.asked.joint_margin is None else JOINT_MARGIN
    placed = [BASE_RANGE if each.ranged else LIMITS for each in problem.variables[:n_base]]
    kinds = [*placed, *[kept] * (len(problem.variables) - n_base)]
    return [kind + each.name.removeprefix("base." * (kind == BASE_RANGE))
            for kind, each in zip(kinds, problem.variables, strict=True)]  # fmt: skip


def _of_variables(problem: SelectionProblem, z: Vector) -> dict[str, ConstraintValue]:
    """Where the base stands and how each joint is held, of a margin how far from its limits: see `_names_of_bounds`."""
    margin, found, told = problem.asked.joint_margin, dict[str, ConstraintValue](), _told_turns(problem, z)
    for name, each, x in zip(_names_of_bounds(problem), problem.variables, told.tolist(), strict=True):
        found[name] = ConstraintValue(x, each.lower, each.upper, each.unit)
        if name.startswith(JOINT_MARGIN) and margin is not None:
            found[name] = ConstraintValue(min(x - each.lower, each.upper - x) + margin, margin, math.inf, each.unit)
    return found


def joint_margins(problem: SelectionProblem, z: Vector) -> dict[str, ConstraintValue]:
    """Of a margin that was asked for, how far each joint that has limits is from these."""
    told = _of_variables(problem, z).items()
    return {name: value for name, value in told if name.startswith(JOINT_MARGIN) and math.isfinite(value.value)}


def cornerless(problem: SelectionProblem) -> dict[str, str]:
    """Of all that counts at corners of `constraints.within`: by its name that without the corner."""
    found = {row.name: row.name.removesuffix(row.corner) for row in problem.constraints if row.corner}
    if problem.gravity:
        wheres = [WHERE + where for where, _ in all_corners(problem.machine, problem.asked.within or ())]
        found |= {name + where: name for where in wheres for name in (EQUILIBRIUM, ON_TARGET)}
    return found


def falls_within(problem: SelectionProblem, z: Vector) -> dict[str, float]:
    """Where in `constraints.within` that is so, by name."""
    if not problem.gravity or not problem.asked.within:
        return {}
    return {
        f"{name}{WHERE}{where}": off
        for where, p in all_corners(problem.machine, problem.asked.within)
        for name, off in not_standing(problem.quantities, z, p).items()
    }


def resting(problem: SelectionProblem, z: Vector) -> list[str]:
    """Which bounds and constraints hold with equality in a configuration, the target aside."""
    drive = next((each.value for each in problem.assumed if each.name == "reach"), math.nan)
    n_base, now = problem.measures.plant.n_base, problem.present_base
    # A bound of a placement that nobody gave is no border of the site, and one that keeps a margin no end of a joint.
    away = np.abs(z[:n_base] - (np.zeros(n_base) if now is None else now)).tolist()
    by_reach = {k for k, x in enumerate(away) if abs(x - drive) <= AT_END * problem.variables[k].scale}
    kept = " less joint_margin" if problem.asked.joint_margin else ""
    found = [
        f"{variable.name} {side} bound{(' (assumed: reach)' if k in by_reach else '') if k < n_base else kept}"
        for k, (variable, x) in enumerate(zip(problem.variables, z.tolist(), strict=True))
        for side, end in (("lower", variable.lower), ("upper", variable.upper))
        if variable.lower < variable.upper and abs(x - end) <= AT_END * variable.scale
    ]
    rows, (lower, upper, scale) = problem.rows(z), problem.row_bounds
    held = (lower < upper) & (np.minimum(np.abs(rows - lower), np.abs(rows - upper)) <= AT_END * scale)
    # Several rows of one name, corners that touch a forbidden area say, are one.
    return [
        *found,
        *dict.fromkeys(row.name for row, holds in zip(problem.constraints, held.tolist(), strict=True) if holds),
    ]


def values_with(problem: SelectionProblem, z: Vector, p: Vector) -> dict[str, ConstraintValue]:
    """Of every bound and constraint, of a machine with the numbers p (n_par,), the value with the least room."""
    rows = (*problem.constraints, *problem.own_constraints)
    found = _of_variables(problem, np.concatenate(held_with(problem.quantities, z, p)))
    for row, x in zip(rows, np.append(rows_with(problem, z, p), own_with(problem, z, p)).tolist(), strict=True):
        value = ConstraintValue(x, row.lower, row.upper, row.unit)
        found[row.name] = min(found.get(row.name, value), value, key=lambda each: each.least_room)
    return found


def broken_held(
    problem: SelectionProblem, base: Vector, posture: Vector, p: Vector
) -> dict[str, tuple[float, ConstraintValue]]:
    """What a machine with the numbers p breaks whose arm is held in a posture, asked for or assumed.

    By name how far, in units of its scale, and its value.
    """
    rows = (*problem.constraints, *problem.own_constraints)
    values = np.append(rows_held(problem, base, posture, p), own_held(problem, base, posture, p))
    found = dict[str, tuple[float, ConstraintValue]]()
    for row, x in [*zip(rows, values.tolist(), strict=True)][problem.target.size :]:
        value = ConstraintValue(x, row.lower, row.upper, row.unit)
        off = -value.least_room / row.scale
        if off > BROKEN and not row.corner and not SINGULAR.search(row.name):
            found[row.name] = max(found.get(row.name, (off, value)), (off, value), key=lambda each: each[0])
    values, n_base = _of_variables(problem, np.append(base, posture)), base.size
    # How the arm is held does not move the base.
    for (name, value), variable in [*zip(values.items(), problem.variables, strict=True)][n_base:]:
        off = -value.room / variable.scale
        if off > BROKEN:
            found[name] = off, value
    return found


def beyond_bounds(problem: SelectionProblem, z: Vector, p: Vector | None = None) -> Vector:
    """By how much each constraint is above (> 0) or below its bounds at z, (n_rows,), in units of the scales."""
    rows = problem.rows(z) if p is None else rows_with(problem, z, p)
    lower, upper, scale = problem.row_bounds
    return (np.minimum(rows - lower, 0.0) + np.maximum(rows - upper, 0.0)) / scale


def beyond_own(problem: SelectionProblem, z: Vector, p: Any = None) -> Vector:
    """By how much each entry of the user's own constraints is outside its bounds, in units of its scale."""
    rows = problem.own_constraints
    low, high, scale = (np.array([getattr(row, name) for row in rows]) for name in ("lower", "upper", "scale"))
    values = own_with(problem, z, p)
    return np.maximum(np.maximum(low - values, values - high), 0.0) / scale
