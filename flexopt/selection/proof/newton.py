"""The last steps onto an optimum, by Newton's method on the conditions that the proof asks for.

In: a program and a point near an optimum. Out: the optimum, with its proof, or the point as it was.

`polished` is for points where only conditions of optimality fail. A solver that works in doubles stops short where
multipliers are large: what an earlier objective may give up is little, so its multiplier is large, and the rounding of
ε_max's gradient times it is more than the condition allows. Here that gradient comes in extended precision.

`settled` is for proven ones: a flat optimum is stationary to the solver's tolerance far around, and where in there a
solve stopped is chance. What rounding leaves is less by orders of magnitude.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.selection.nlp.program import Program
from flexopt.selection.proof.check import FIRST_ORDER, SECOND_ORDER, STATIONARY_NEARLY, Proof, infeasible, prove_program
from flexopt.selection.proof.first_order import linearised
from flexopt.selection.proof.multipliers import STATIONARITY_TOLERANCE, FirstOrderModel, multipliers_of
from flexopt.selection.proof.second_order import CURVATURE_STEP, lagrangian_hessian

STEPS = 8
# In scaled variables; from further away the active rows are not those of the optimum.
LONGEST = 1e-2
# Steps of `settled`, of which the first leaves the error of the second derivatives and the next that of rounding; and
# how long one is, in scaled variables, that rounding makes where optima are not flat.
LAST, ROUNDING = 2, 1e-12


def polished(program: Program, x: Vector, proof: Proof) -> tuple[Vector, Proof]:
    """The point and its proof after Newton's steps, where they lead to an optimum; else as they are."""
    # Differences of ε_max's slopes are the first that rounding spoils.
    rounded = any(form.kinks for form in program.first.forms)
    left = set(proof.violations) - ({FIRST_ORDER, SECOND_ORDER} if rounded else {FIRST_ORDER})
    if left or proof.holds or not proof.stationarity <= STATIONARY_NEARLY * proof.pull:
        return x, proof
    exact = replace(program, exact=True)
    for held in (False, True) if rounded else (False,):
        found = _newton(exact, x, held=held)
        if found is not None:
            return found
    return x, proof


def _newton(exact: Program, x: Vector, *, held: bool) -> tuple[Vector, Proof] | None:
    """The optimum that Newton's steps lead to, and its proof; None where they lead to none.

    `held`: whether kinks of ε_max are kept as far away as they are: near one that is no point of the optimum, steps
    onto it lead away.
    """
    there = x
    for _ in range(STEPS):
        local = linearised(exact, there)
        multipliers, kept = multipliers_of(local)
        off = local.gradient - multipliers @ local.rows(kept)
        if not np.all(np.isfinite(off)):
            break
        if np.linalg.norm(off) <= STATIONARITY_TOLERANCE / 10:
            found = prove_program(exact, there)
            return (there, found) if found.holds else None
        bend = _Bend.at(exact, there, local, multipliers, kept)
        step = None if bend is None else bend.step(exact, there, local, kept, off, held=held)
        if step is None:
            break
        there = np.clip(there + step[: x.size] * exact.scale, *exact.bounds())
    return None


def settled(program: Program, x: Vector, proof: Proof) -> tuple[Vector, Proof]:
    """An optimum that is a point, and its proof, up to what rounding leaves; others as they are."""
    if proof.dimension != 0 or not proof.holds:
        return x, proof
    bend: _Bend | None = None
    first, best, least, there, g = proof, x, np.inf, x, np.zeros(0)
    for _ in range(LAST + 1):
        local = linearised(program, there)
        multipliers, kept = multipliers_of(local)
        off = local.gradient - multipliers @ local.rows(kept)
        bend = bend or _Bend.at(program, x, local, multipliers, kept)
        step = None if bend is None else bend.step(program, there, local, kept, off)
        if step is None:
            break
        size = float(np.max(np.abs(step)))
        if size < least:
            best, least, g = there, size, local.g
            proof = replace(first, stationarity=float(np.linalg.norm(off)))
        if least <= ROUNDING:
            break
        there = np.clip(there + step[: x.size] * program.scale, *program.bounds())
    if best is x:
        return x, first
    if np.abs((best - x) / program.scale).max() > CURVATURE_STEP:
        # So far away second derivatives are to be asked for again.
        proof = prove_program(program, best)
        return (best, proof) if proof.holds else (x, first)
    return (x, first) if infeasible(program, best, g) else (best, proof)


@dataclass(frozen=True)
class _Bend:
    """Second derivatives of a Lagrangian, (d, d), along the directions that active rows leave free, (d, n)."""

    free: Vector
    hessian: Vector

    @staticmethod
    def at(program: Program, x: Vector, local: FirstOrderModel, multipliers: Vector, kept: list[int]) -> _Bend | None:
        """Those at a point; None where it is no strict maximum along the rows."""
        _, singular, directions = np.linalg.svd(local.rows(kept))
        free = directions[int(np.sum(singular > 1e-9 * singular[0])) :]
        bent = lagrangian_hessian(program, x, free, local, multipliers, kept)
        if not np.all(np.isfinite(bent)) or (free.size and np.linalg.eigvalsh(bent)[-1] >= 0.0):
            return None
        return _Bend(free, bent)

    def step(
        self, program: Program, x: Vector, local: FirstOrderModel, kept: list[int], off: Vector, *, held: bool = False
    ) -> Vector | None:
        """Onto the active rows and, along them, to where the Lagrangian's quadratic model is largest.

        `held`: kinks of ε_max are not stepped onto.
        """
        beyond = _beyond(program, x, local, kept)
        for kink in local.kinks if held else ():
            if kink.number is None:
                beyond[kink.rows] = 0.0
        onto = -np.linalg.pinv(local.rows(kept)) @ beyond
        step = onto - self.free.T @ np.linalg.solve(self.hessian, self.free @ off)
        return step if np.abs(step).max() <= LONGEST else None


def _beyond(program: Program, x: Vector, local: FirstOrderModel, kept: list[int]) -> Vector:
    """By how much the active rows are off their bounds, in the order of `FirstOrderModel.rows`."""
    constraints = program.constraints()
    equal = [local.g[k] - constraints[k].lower for k in local.equal]
    active = [
        local.g[k] - constraints[k].lower if sense > 0 else constraints[k].upper - local.g[k]
        for k, sense in local.active
    ]
    # Then variables at their bounds, a unit vector into the range each.
    for row in local.inequalities[len(active) :, : x.size]:
        i = int(np.argmax(np.abs(row)))
        lower, upper = (bound[i] for bound in program.bounds())
        active.append(float(x[i] - lower if row[i] > 0 else upper - x[i]) / float(program.scale[i]))
    of_equalities = np.zeros(len(local.equalities))
    of_equalities[: len(equal)] = equal
    for kink in local.kinks:
        of_equalities[kink.rows] = kink.value
    return np.concatenate([of_equalities, [active[j] for j in kept]])
