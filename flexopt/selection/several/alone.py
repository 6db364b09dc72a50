"""What each target can have alone, and the placements for all to which that leads.

In: problems. Out: verified optima of each alone; their placements, turned about their targets.

One placement for several targets is often a summit of the worst target alone, which a search among all at once meets by
chance. Where the base turns as well as it drives, such a summit is a circle of placements about its target, at a few of
which the other targets do as well.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from flexopt.errors import NoSolutionFound
from flexopt.foundation.arrays import Vector
from flexopt.model import AnyMachine
from flexopt.selection.optima import first_optima
from flexopt.selection.problem import SelectionProblem, value_at
from flexopt.selection.program import Program
from flexopt.selection.starts import starting_points

# Targets that are looked at alone, the worst of the best so far; starts of each, its optima that are kept, and the
# angles to which the placement of each is turned.
TARGETS, ALONE, KEPT, TURNED = 3, 8, 4, 18
# How much better than in the best so far a target must be alone, relative to the objective's scale.
GAIN = 1e-4


def placements_alone(program: Program, best: Vector, workers: int) -> tuple[Vector, Vector]:
    """Placements (n_b, N) at which a target alone is better than in the best so far, and its postures there (n, N)."""
    machine, values = program.first.machine, program.values(best)
    n_b = len(machine.base_coordinates)
    bases, postures = list[Vector](), list[Vector]()
    worst: list[int] = np.argsort(values, kind="stable")[:TARGETS].tolist()
    for k in worst:
        problem = program.problems[k]
        for value, z in _optima_alone(problem, workers):
            if value > values[k] + GAIN * program.size:
                bases.append(_turned_about(machine, problem.target, z[:n_b]))
                postures.append(np.repeat(z[n_b:, None], bases[-1].shape[1], axis=1))
    if not bases:
        return np.zeros((n_b, 0)), np.zeros((len(machine.joints), 0))
    return np.concatenate(bases, axis=1), np.concatenate(postures, axis=1)


def _optima_alone(problem: SelectionProblem, workers: int) -> list[tuple[float, Vector]]:
    """V and z of the best verified optima of one target alone, the best first; empty where there is none."""
    problem = replace(problem, starts=ALONE)
    try:
        problem, (found, *_) = first_optima(problem, starting_points(problem, workers), workers, None)
    except NoSolutionFound:
        return []
    ranked = sorted(((value_at(problem, z), z) for z, *_ in found), key=lambda each: -each[0])
    return ranked[:KEPT]


def _turned_about(machine: AnyMachine, target: Vector, base: Vector) -> Vector:
    """Placements (n_b, N) from which the same posture reaches the same target: turned about the vertical through it."""
    names, rows = machine.base_coordinates, machine.task_rows
    if not {"x", "y", "yaw"} <= set(names) or not {"x", "y"} <= set(rows):
        return base[:, None]
    angles = math.tau * np.arange(TURNED) / TURNED
    x, y, yaw = (names.index(name) for name in ("x", "y", "yaw"))
    point = target[[rows.index("x"), rows.index("y")]]
    away = base[[x, y]] - point
    found = np.repeat(base[:, None], TURNED, axis=1)
    found[x] = point[0] + np.cos(angles) * away[0] - np.sin(angles) * away[1]
    found[y] = point[1] + np.sin(angles) * away[0] + np.cos(angles) * away[1]
    found[yaw] = base[yaw] + angles
    return found
