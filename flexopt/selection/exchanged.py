"""Where modes exchange their numbers: what tells them apart jumps where two frequencies meet.

Modes are numbered by frequency. Where two meet, w_i and w_{i+1} depend on the side that a configuration comes from, and
V jumps; the most that can be had often lies at that edge, and is not attained. There the two frequencies are kept apart
by a share so small that no machine is known to it: a constraint with slopes and proof, as those of the user's own.

In: a problem, and points where solves ended. Out: the problem with the edges that these came to as constraints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.model.own import OwnFunction, check_function
from flexopt.selection.objective import Objective
from flexopt.selection.own import OwnTerm
from flexopt.selection.problem import SelectionProblem, value_at
from flexopt.selection.starts import with_kept

# How far frequencies stay apart, as a share of the higher one; how near they are where a solve failed at an edge; what
# that share is told in.
APART, CLOSE, SCALE = 1e-4, 1e-2, 0.1
# Up to where a configuration stands at the edge, in APART.
AT_EDGE = 2.0


def kept_apart(problem: SelectionProblem, optima: Sequence[Vector], failed: Sequence[Vector]) -> SelectionProblem:
    """The problem with those frequencies kept apart that an objective tells apart and that solves came near to.

    These are solves that end at an edge as an optimum, or failed near one above all optima. The problem itself where
    there are none.
    """
    names = {objective.name for objective in problem.objectives}
    told = [pair for pair in _told_apart(problem) if _name(pair) not in names]
    best = max((value_at(problem, z) for z in optima), default=-np.inf)
    above = [z for z in failed if not value_at(problem, z) <= best]
    if not told or not (above or optima):
        return problem
    gaps = _gaps_at(problem, np.array([*optima, *above]).T)
    near = np.append(np.full(len(optima), APART), np.full(len(above), CLOSE))
    met = [pair for pair in told if np.any(gaps[pair] < near)]
    if not met:
        return problem
    m = problem.measures.plant.n_passive
    edges = [Objective(_name(pair), (0.0,) * m, 0.0, OwnTerm(_gaps(m), pair), bounds=True) for pair in met]
    apart = replace(
        problem,
        objectives=(*edges, *problem.objectives),
        objective_scales=(*[SCALE] * len(edges), *problem.objective_scales),
        kept=(*[APART] * len(edges), *problem.kept),
        bounding=problem.bounding + len(edges),
    )
    return replace(apart, scan=with_kept(apart, apart.scan))


def edges_at(problem: SelectionProblem, z: Vector) -> list[int]:
    """The pairs of modes i, i + 1 that are told apart and whose frequencies all but meet at z, by i from 0."""
    told = _told_apart(problem)
    if not told:
        return []
    gaps = _gaps_at(problem, z[:, None])[:, 0]
    return [pair for pair in told if gaps[pair] < AT_EDGE * APART]


def at_edge(problem: SelectionProblem, z: Vector, w: Vector) -> list[str]:
    """For each edge at z a sentence: what V is there with the numbers exchanged."""
    found, objective = list[str](), problem.sought[0]
    for pair in edges_at(problem, z):
        modes, alpha = f"modes {pair + 1} and {pair + 2}", objective.alpha
        sentence = f"frequencies of {modes} meet there, and are kept {APART:g} of them apart"
        if objective.own is None and len(problem.sought) == 1:
            value = value_at(problem, z, objective)
            value += (alpha[pair] - alpha[pair + 1]) * float(w[pair + 1] - w[pair])
            sentence += f": just beyond, where the two exchange numbers, {objective.name} jumps to {value:.6g}"
        found.append(sentence)
    return found


def _told_apart(problem: SelectionProblem) -> list[int]:
    """Numbers i of the modes that an objective tells from mode i + 1: what takes either takes both from their sides."""
    uses = np.zeros(problem.measures.plant.n_passive, dtype=bool)
    for objective in problem.objectives:
        uses |= objective.uses
    return np.flatnonzero(uses[:-1] | uses[1:]).tolist()


def _gaps_at(problem: SelectionProblem, z: Vector) -> Vector:
    """1 − f_i / f_{i+1} at points z (n_z, N), (m − 1, N)."""
    base, posture, _ = problem.quantities.at(z)
    return problem.quantities.of_own(OwnTerm(_gaps(problem.measures.plant.n_passive)), base, posture)


@lru_cache(maxsize=16)
def _gaps(m: int) -> OwnFunction:
    f = ca.SX.sym("frequencies", m)
    gaps = ca.Function("frequencies_apart", [f], [1 - f[:-1] / f[1:]], ["frequencies"], ["gaps"])
    return check_function(gaps)


def _name(pair: int) -> str:
    return f"frequencies of modes {pair + 1} and {pair + 2} apart"
