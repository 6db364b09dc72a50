"""The last steps onto an optimum, by Newton's method on the conditions that the proof asks for.

In: a program and a point near an optimum, where only the first-order condition fails. Out: a point where it holds, with
its proof, or the point as it was. A solver that works in doubles stops short where multipliers are large: what an
earlier objective may give up is little, so its multiplier is large, and the rounding of ε_max's gradient times it is
more than the condition allows. Here that gradient comes in extended precision.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.selection.check import FIRST_ORDER, STATIONARY_NEARLY, Proof, prove_program
from flexopt.selection.first_order import linearised
from flexopt.selection.multipliers import STATIONARITY_TOLERANCE, FirstOrderModel, multipliers_of
from flexopt.selection.program import Program
from flexopt.selection.second_order import lagrangian_hessian

STEPS = 8
# In scaled variables; from further away the active rows are not those of the optimum.
LONGEST = 1e-2


def polished(program: Program, x: Vector, proof: Proof) -> tuple[Vector, Proof]:
    """The point and its proof after Newton's steps, where they lead to an optimum; else as they are."""
    if list(proof.violations) != [FIRST_ORDER] or not proof.stationarity <= STATIONARY_NEARLY:
        return x, proof
    exact, there = replace(program, exact=True), x
    for _ in range(STEPS):
        local = linearised(exact, there)
        multipliers, kept = multipliers_of(local)
        off = local.gradient - multipliers @ local.rows(kept)
        if not np.all(np.isfinite(off)):
            break
        if np.linalg.norm(off) <= STATIONARITY_TOLERANCE / 10:
            found = prove_program(exact, there)
            return (there, found) if found.holds else (x, proof)
        step = _step(exact, there, local, multipliers, kept, off)
        if step is None:
            break
        there = np.clip(there + step[: x.size] * exact.scale, *exact.bounds())
    return x, proof


def _step(
    program: Program, x: Vector, local: FirstOrderModel, multipliers: Vector, kept: list[int], off: Vector
) -> Vector | None:
    """Onto the active rows and, along them, to where the Lagrangian's quadratic model is largest."""
    rows = local.rows(kept)
    _, singular, directions = np.linalg.svd(rows)
    free = directions[int(np.sum(singular > 1e-9 * singular[0])) :]
    bent = lagrangian_hessian(program, x, free, local.weights(multipliers, kept), local.held(multipliers, kept))
    if not np.all(np.isfinite(bent)) or (free.size and np.linalg.eigvalsh(bent)[-1] >= 0.0):
        return None
    step = -np.linalg.pinv(rows) @ _beyond(program, local, kept) - free.T @ np.linalg.solve(bent, free @ off)
    return step if np.abs(step).max() <= LONGEST else None


def _beyond(program: Program, local: FirstOrderModel, kept: list[int]) -> Vector:
    """By how much the active rows are off their bounds, in the order of `FirstOrderModel.rows`."""
    constraints = program.constraints()
    equal = [local.g[k] - constraints[k].lower for k in local.equal]
    active = [
        local.g[k] - constraints[k].lower if sense > 0 else constraints[k].upper - local.g[k]
        for k, sense in local.active
    ]
    others = len(local.equalities) - len(equal)
    return np.array([*equal, *[0.0] * others, *(active[j] if j < len(active) else 0.0 for j in kept)])
