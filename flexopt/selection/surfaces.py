"""Optima that are surfaces: where V = 0 no configuration has more, and of those that have as much the best is sought.

In: verified optima of a problem. Out: the same, where V = 0 moved along their surfaces, a_i parallel to b_i, to where
the worst of the other w_i is largest, or ε_max where there are no others, with the optima that each one stands for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import chain

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.foundation.processes import in_parallel
from flexopt.selection.cones import TINY
from flexopt.selection.continua import between, nearest, same, turns
from flexopt.selection.nlp.program import ASCENT_LONG, single
from flexopt.selection.objective import Objective
from flexopt.selection.optima import SAME_POINT, Found
from flexopt.selection.problem import SelectionProblem, value_at
from flexopt.selection.proof.check import prove
from flexopt.selection.proof.second_order import DEPENDENT, surface_at
from flexopt.selection.starts import worst_starts

# Points that climb along surfaces: optima, on each combination of kinks those where what is sought is largest, and
# others, for each dimension up to a number of dimensions.
OPTIMA, STARTS, MOST = 12, 16, 2
# The best sets, to which walks are tried from others.
WALKED = 4
# Charts of a surface that a climb may need.
CHARTS = 6
# A gain below this share of the scale is none.
STILL = 1e-9
# Steps of a walk from one optimum to another, the longest of them in scaled variables, and what is left after each.
WALK, STRIDE, NEARER = 100, 0.1, 0.99


@dataclass(frozen=True)
class Best:
    """An optimum, and others (k, n_z) of the same connected set that were found."""

    found: Found
    others: tuple[Vector, ...] = ()


def along_surfaces(problem: SelectionProblem, found: list[Found], workers: int) -> tuple[list[Best], int]:
    """The optima; of each connected surface V = 0 that was found its best, after all that are no surface.

    Where objectives are kept in order, or travel costs, the next objective or the cost says what is best.

    Returns:
        The optima, and from how many points besides them surfaces were climbed along.
    """
    found = [_landed(problem, item) for item in found]
    wide = [item for item in found if item[1].unsurpassed and _may_be_wide(problem, item)]
    if not wide or len(problem.sought) > 1 or problem.travel is not None:
        return [Best(item) for item in found], 0
    rest = [Best(item) for item in found if not any(item is other for other in wide)]
    stage, sought = _next(problem)
    wide = _best(sorted(wide, key=lambda item: -_value(stage, sought, item[0])))
    beyond = max(item[1].dimension or 0 for item in wide) - int(turns(problem))
    more = worst_starts(problem, STARTS * min(max(beyond, 1), MOST), workers)
    starts = [z for z, _, _ in wide] + more
    climb = partial(_climbed, problem, stage, sought, starts)
    ends = in_parallel(climb, len(starts), workers, lost=lambda number, _: (starts[number], 0))
    proved = [(z, prove(problem, z), steps) for z, steps in ends]
    good = [(number, item) for number, item in enumerate(proved) if item[1].holds and item[1].unsurpassed]
    values = {number: _value(stage, sought, item[0]) for number, item in good}
    # One that was lost on its way stays where it was.
    good += [(k, item) for k, item in enumerate(wide) if k not in values]
    values |= {k: _value(stage, sought, item[0]) for k, item in good if k not in values}
    sets: list[tuple[Found, list[Vector]]] = []
    ats: list[Vector] = []
    for number, item in sorted(good, key=lambda each: -values[each[0]]):
        near = nearest(problem, item[0])
        alike = (others for (_, others), at in zip(sets, ats, strict=True) if same(problem, near, at))
        walked = (others for best, others in sets[:WALKED] if _connected(problem, item[0], best[0]))
        home = next(chain(alike, walked), None)
        if home is None:
            sets.append((item, home := []))
            ats.append(near)
        else:
            home.append(item[0])
        if number < len(wide):
            home.append(wide[number][0])
    bests = [Best(item, tuple(_distinct(problem, item[0], others))) for item, others in sets]
    return [*rest, *bests], len(more)


def _best(ranked: list[Found]) -> list[Found]:
    """Of ranked optima the best OPTIMA on each combination of kinks: what rests on others may be another surface."""
    kept = dict[tuple[str, ...], list[Found]]()
    for item in ranked:
        kept.setdefault(tuple(item[1].kinks), []).append(item)
    return [item for items in kept.values() for item in items[:OPTIMA]]


def _landed(problem: SelectionProblem, item: Found) -> Found:
    """An optimum that rests on a kink, moved onto V = 0 where that is beside it.

    V falls in proportion to how far away it is, so that rounding of a solve alone takes it off.
    """
    z, proof, iterations = item
    if not problem.bounded_by_zero or proof.unsurpassed or not proof.kinks:
        return item
    surface = surface_at(problem, z)
    if surface is None:
        return item
    program = single(problem)
    ascent, here = program.ascent(z, parallel=surface)
    there = ascent.onto_rows(here)
    if there is None or not there[1]:
        return item
    after = program.told(there[0])
    if not same(problem, z, after):
        return item
    landed = prove(problem, after)
    return (after, landed, iterations) if landed.holds and landed.unsurpassed else item


def _may_be_wide(problem: SelectionProblem, item: Found) -> bool:
    """Whether a surface of more than turns about the target leads away; where no dimension is told one may."""
    z, proof, _ = item
    if proof.dimension is None:
        return surface_at(problem, z) is not None
    return proof.dimension > int(turns(problem))


def _next(problem: SelectionProblem) -> tuple[SelectionProblem, int]:
    """The problem of what is sought along the surface, and of how many objectives the smallest is."""
    alpha, size = problem.objective.alpha, problem.objective_scale
    m = len(alpha)
    others = [Objective(f"w{i + 1}", tuple(np.eye(m)[i].tolist()), 0.0) for i in range(m) if alpha[i] == 0]
    sizes = (size,) * len(others)
    if not others:
        others, sizes = [Objective("epsilon_max", (0.0,) * m, 1.0)], (1.0,)
    first = problem.bounding
    stage = replace(
        problem,
        objectives=(*problem.objectives[:first], *others),
        objective_scales=(*problem.objective_scales[:first], *sizes),
        kept=(*problem.kept[:first], *(-np.inf,) * (len(others) - 1)),
    )
    return stage, len(others)


def _value(stage: SelectionProblem, sought: int, z: Vector) -> float:
    return min(value_at(stage, z, objective) for objective in stage.objectives[-sought:])


def _climbed(
    problem: SelectionProblem, stage: SelectionProblem, sought: int, starts: list[Vector], number: int
) -> tuple[Vector, int]:
    """Where an ascent along the surface leads, chart after chart, and its steps; the start where it is on none."""
    z, steps, before = starts[number], 0, -np.inf
    for _ in range(CHARTS):
        surface = surface_at(problem, z)
        if surface is None:
            break
        found = single(stage).climbed(z, ASCENT_LONG, sought=sought, parallel=surface)
        if found is None:
            break
        z, steps, value = found[0], steps + found[1], _value(stage, sought, found[0])
        # Steps that end at a kink may go on from there in long ones again.
        if value <= before + STILL * stage.objective_scale and surface.fits(problem.factors(z)[0]):
            break
        before = value
    return z, steps


def _connected(problem: SelectionProblem, start: Vector, goal: Vector) -> bool:
    """Whether steps along the surface lead from one point to the other's posture, always nearer to it.

    Where they do not, the two may be connected all the same.
    """
    n_base, x, goal_x = problem.measures.plant.n_base, start, goal
    program = single(problem)
    for _ in range(WALK):
        away = between(problem, x, goal_x)
        if np.abs(away[n_base:]).max() <= SAME_POINT:
            return True
        surface = surface_at(problem, x)
        if surface is None:
            return False
        away[:n_base] = 0.0
        ascent, here = program.ascent(x, parallel=surface)
        rows = ascent.rows(here)[1][ascent.bounds.g_lower == ascent.bounds.g_upper]
        along = away - np.linalg.pinv(rows, rcond=DEPENDENT) @ (rows @ away)
        there = ascent.onto_rows(here + along * min(1.0, STRIDE / max(float(np.abs(along).max()), TINY)))
        if there is None or not there[1]:
            return False
        after = program.told(there[0])
        if np.linalg.norm(between(problem, after, goal_x)[n_base:]) > NEARER * np.linalg.norm(away):
            return False
        x = after
    return False


def _distinct(problem: SelectionProblem, z: Vector, others: list[Vector]) -> list[Vector]:
    found = [z]
    for other in others:
        if not any(same(problem, other, each) for each in found):
            found.append(other)
    return found[1:]
