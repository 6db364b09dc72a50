"""A program to first order at a point: what is active there, and on which kinks it stands.

In: a program, of one configuration or many, and a point. Out: what multipliers are sought of (`multipliers`).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.selection.ascent.model import Cone, halves
from flexopt.selection.cones import SHARED, mode_cones, name_of
from flexopt.selection.nlp.coupling import widened
from flexopt.selection.nlp.program import Linearisation, Program
from flexopt.selection.objective import KINK
from flexopt.selection.problem import value_at
from flexopt.selection.proof.multipliers import FirstOrderModel, Kink

ACTIVE_TOLERANCE = 1e-6
KINK_NAME = "kink of ε_max"
# Branches meet where, to first order, they do within this distance, in scaled variables; a_i or b_i is zero within TIP.
MEETS, TIP = 1e-3, 1e-6


def linearised(program: Program, x: Vector) -> FirstOrderModel:
    """The program at x, with what is active there."""
    members = program.linear(x)
    level = float(min(member.values[-1][0] for member in members))
    local = program.local(x, members, level)
    equal: list[int] = []
    active: list[tuple[int, float]] = []
    rows: list[Vector] = []
    names: list[str] = []
    for k, (constraint, value) in enumerate(zip(program.constraints(), local.g, strict=True)):
        if constraint.lower == constraint.upper:
            equal.append(k)
            continue
        sense = 1.0 if value - constraint.lower <= ACTIVE_TOLERANCE else -1.0
        if sense > 0 or constraint.upper - value <= ACTIVE_TOLERANCE:
            active.append((k, sense))
            rows.append(sense * local.jacobian[k])
            names.append(constraint.name)
    gradient = -local.gradient
    corners, kinks = list[Vector](), list[Kink]()
    n_objectives = len(members[0].values)
    held = len(program.first.constraints) * program.coupling.count + len(program.coupling.pairs)
    wanted = [(k, tip) for k, member in enumerate(members) for tip in _tips(program, k, x, member)]
    for k, (j, name, cone, number, alpha) in wanted:
        first, share = None, 1.0
        wide = widened(cone.slopes, program.coupling.places[k], local.gradient.size)
        if j < n_objectives - 1 or program.goal != "weighted":
            row_number = held + j * program.coupling.count + k
            first = next((row for row, (active_number, _) in enumerate(active) if active_number == row_number), None)
            if first is None:
                continue
            rows[first] = rows[first] + cone.unit @ wide
        else:
            share = float(program.share[k])
            gradient = gradient + share * cone.unit @ wide
        begin = len(equal) + sum(len(corner) for corner in corners)
        corners.append(share * cone.axes @ wide)
        rows_of = slice(begin, begin + len(corners[-1]))
        full = program.prefix(k) + (name if j == n_objectives - 1 else f"{name} that is kept")
        value = share * cone.axes @ cone.value
        kinks.append(Kink(full, rows_of, first, k, number, cone.axes, share * alpha, j, value))

    identity, moving = np.eye(local.gradient.size), np.ones(local.gradient.size)
    fixed: list[Vector] = []
    for i, (name, lower, upper) in enumerate(zip(program.names, *program.bounds(), strict=True)):
        if lower == upper or i in program.fixed:
            fixed.append(identity[i])
            moving[i] = 0.0
            continue
        for away, sense, side in ((x[i] - lower, 1.0, "lower"), (upper - x[i], -1.0, "upper")):
            if away <= ACTIVE_TOLERANCE * program.scale[i]:
                rows.append(sense * identity[i])
                names.append(f"{name} {side} bound")
                moving[i] = 0.0
    return FirstOrderModel(
        level=level,
        value=-local.f,
        gradient=gradient,
        g=local.g,
        equal=equal,
        active=active,
        equalities=np.vstack([local.jacobian[equal], *corners, *fixed]),
        inequalities=np.array(rows).reshape(-1, local.gradient.size),
        names=tuple(names),
        moving=moving,
        kinks=tuple(kinks),
    )


def _tips(
    program: Program, k: int, x: Vector, member: Linearisation
) -> Iterator[tuple[int, str, Cone, int | None, float]]:
    """Of a configuration's objectives the cones at whose tips x stands, by its z / scale and in units of V / size.

    Of each j, name, −|c|, number, α / size.
    """
    for j, (values, slopes) in enumerate(zip(member.values, member.slopes, strict=True)):
        if len(values) < 2:
            continue
        apart = float(np.hypot(np.linalg.norm(slopes[1] - slopes[0]), 2 * np.linalg.norm(slopes[2])))
        if values[1] - values[0] <= min(KINK, MEETS * apart):
            value = np.array([(values[0] - values[1]) / 2, 0.0])
            yield j, KINK_NAME, Cone(value, halves(slopes), np.ones(1), np.array([-1.0, 0.0])), None, 0.0
    alphas = _pulls_of_w(program, k, x)
    if not alphas.any():
        return
    f, f_z, same = program.problems[k].factors(program.of(x, k))
    for number, cone in enumerate(mode_cones(f, f_z * program.first.scale, alphas)):
        for j, size in enumerate(cone.sizes.tolist()):
            if size > 0 and same[number // 2] < SHARED and cone.distance <= TIP:
                scaled = Cone(size * cone.value, size * cone.slopes, np.ones(1), cone.unit)
                alpha = float(alphas[j, number // 2])
                yield j, f"kink of w{number // 2 + 1}: {name_of(number)}", scaled, number, alpha


def _pulls_of_w(program: Program, k: int, x: Vector) -> Vector:
    """∂V_j/∂w_i / size of configuration k's objectives up to the one being solved, (j, m)."""
    problem = program.problems[k]
    base, posture, _ = problem.quantities.at(program.of(x, k))
    pulls = [problem.quantities.pulls(o, base, posture).ravel() for o in problem.objectives[: len(problem.kept) + 1]]
    return np.array(pulls) / np.array(program.first.objective_scales[: len(pulls)])[:, None]


def undecided(program: Program, x: Vector) -> Iterator[tuple[str, float]]:
    """What own objectives and constraints make of x that first and second derivatives do not tell, and its size.

    A pull at w_i below 0 turns its kink over: V rises from there in two directions. Frequencies have no slopes where
    two are one.
    """
    first, least = program.first, (*program.first.kept, -np.inf)
    if all(objective.own is None for objective in first.objectives[: len(least)]):
        return
    for k, problem in enumerate(program.problems):
        z = program.of(x, k)
        own = np.zeros((len(least), 1), dtype=bool)
        for j, (objective, kept) in enumerate(zip(problem.objectives, least, strict=False)):
            if objective.own is None:
                continue
            # What is kept and has more than it needs does not matter.
            value, size = value_at(problem, z, objective), first.objective_scales[j]
            own[j] = kept == -np.inf or not value > kept + ACTIVE_TOLERANCE * size
        (f, f_z, same), alphas = problem.factors(z), _pulls_of_w(program, k, x)
        for objective, matters in zip(problem.objectives, own[:, 0], strict=False):
            one = bool(matters) and same.max() > SHARED
            if one and objective.own is not None and problem.quantities.own(objective.own).takes_frequencies:
                yield f"frequencies of {objective.name} that are one", np.inf
        for number, cone in enumerate(mode_cones(f, f_z * first.scale, np.maximum(-alphas, 0.0) * own)):
            if cone.sizes.any() and (cone.distance <= TIP or same[number // 2] > SHARED):
                yield f"kink of w{number // 2 + 1}, on which V falls with it", float(cone.sizes.max()) * cone.length
