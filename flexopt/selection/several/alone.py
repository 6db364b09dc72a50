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
from flexopt.selection.continua import turned_about, turns
from flexopt.selection.nlp.program import Program
from flexopt.selection.optima import first_optima
from flexopt.selection.problem import SelectionProblem, value_at
from flexopt.selection.starts import starting_points

# Targets that are looked at alone, the worst of the best so far; starts of each, its optima that are kept, and the
# angles to which the placement of each is turned.
TARGETS, ALONE, KEPT, TURNED = 3, 8, 4, 18
# How much better than in the best so far a target must be alone, relative to the objective's scale.
GAIN = 1e-4


def placements_alone(program: Program, best: Vector, workers: int) -> tuple[Vector, Vector]:
    """Placements (n_b, N) at which a target alone is better than in the best so far, and its postures there (n, N)."""
    values, places = program.values(best), [np.zeros((program.first.scale.size, 0))]
    angles = math.tau * np.arange(TURNED) / TURNED
    worst: list[int] = np.argsort(values, kind="stable")[:TARGETS].tolist()
    for k in worst:
        problem = program.problems[k]
        for value, z in _optima_alone(problem, workers):
            if value > values[k] + GAIN * program.size:
                places.append(turned_about(problem, z, angles) if turns(problem) else z[:, None])
    bases, postures = np.split(np.concatenate(places, axis=1), [len(program.first.machine.base_coordinates)])
    return bases, postures


def _optima_alone(problem: SelectionProblem, workers: int) -> list[tuple[float, Vector]]:
    """V and z of the best verified optima of one target alone, the best first; empty where there is none."""
    problem = replace(problem, starts=ALONE)
    try:
        problem, (found, *_) = first_optima(problem, starting_points(problem, workers), workers, None)
    except NoSolutionFound:
        return []
    ranked = sorted(((value_at(problem, z), z) for z, *_ in found), key=lambda each: -each[0])
    return ranked[:KEPT]
