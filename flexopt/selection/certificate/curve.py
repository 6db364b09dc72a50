"""The configurations of one degree of redundancy as Taylor models over the placement x, an elbow each.

In: a selection's problem; cells [x_low, x_high] with their elbow. Out: which of them hold no configuration that keeps
what is asked, and the objectives over the others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from flexopt.compiled.taylor import PRECISE, FloatArray, TaylorFunction, TaylorModel, matrix, taylor
from flexopt.selection.certificate.modes import enclosed_measures
from flexopt.selection.problem import SelectionProblem

TURN = 2 * math.pi
# How far outside bounds and margins, in units of their scales, what is left out lies at least.
EDGE = 1e-10
# Why a cell is left out.
OUT_OF_REACH, TOO_STRAIGHT, LIMIT, CONSTRAINT, NOT_KEPT = "reach", "margin", "limit", "constraint", "kept"


@dataclass(frozen=True)
class CellBounds:
    """What is known of N cells.

    Attributes:
        outside: why no configuration of the cell is allowed, "" where some may be.
        low, high: bounds on the objective, ±∞ where nothing is known.
    """

    outside: list[str]
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True)
class RedundancyCurve:
    """The redundancy of a problem: a closed form, two actuated joints, the base moving along x."""

    problem: SelectionProblem

    @cached_property
    def _graphs(self) -> tuple[TaylorFunction, TaylorFunction]:
        """(x, elbow, target, p, c) -> the cosine of the elbow; posture, K_p, M̄, F, constraint rows."""
        measures, extra = self.problem.measures, self.problem.constraint_set
        plant = measures.plant
        x, elbow, target, p = (
            ca.SX.sym(n, k) for n, k in zip("xetp", (1, 1, 2, len(plant.parameter_names)), strict=True)
        )
        c = ca.SX.sym("c", self.problem.constants.size)
        posture, cosine = plant.posture_at.call([target, x, ca.SX(0, 1), elbow, p])
        outputs = [posture, *measures.expansion.reduced.call([x, posture, p])]
        if extra is not None:
            outputs += extra.function.call([x, posture, p, c])
        at = [x, elbow, target, p, c]
        return taylor(ca.Function("elbow", at, [cosine])), taylor(ca.Function("curve", at, outputs, {"cse": True}))

    @cached_property
    def _constants(self) -> list[list[TaylorModel]]:
        problem = self.problem
        numbers = problem.target, problem.measures.plant.parameter_values.full().ravel(), problem.constants
        return [[TaylorModel.constant(float(value)) for value in each] for each in numbers]

    @np.errstate(all="ignore")
    def see(self, low: FloatArray, high: FloatArray, elbow: FloatArray, *, precise: bool = False) -> CellBounds:
        """What is known of the cells [low, high] of x, m, with elbows −1 or +1, (N,) each; `precise`: in `PRECISE`."""
        problem, n = self.problem, low.size
        kind = PRECISE if precise else np.float64
        x = TaylorModel.of_cells(low.astype(kind), high.astype(kind))
        turned = TaylorModel(elbow[None, :], np.zeros(n))
        reach, graph = self._graphs
        (cosine,) = reach([x], [turned], *self._constants)[0]
        least, most = (np.broadcast_to(bound, (n,)) for bound in cosine.bounds)
        straight = math.sqrt(problem.constraints[2].lower)
        beyond = (least > 1 + EDGE) | (most < -1 - EDGE)
        # |cos θ| at least so near to 1, that sin θ is below that of the margin.
        farthest = np.maximum(np.maximum(least, -most), 0.0)
        close = 1.0 - farthest**2 < straight**2 - EDGE
        outside = np.where(beyond, OUT_OF_REACH, np.where(close, TOO_STRAIGHT, "")).astype(object)
        lows, highs = np.full(n, -np.inf), np.full(n, np.inf)
        inside = np.flatnonzero(outside == "")
        if inside.size:
            why, lows[inside], highs[inside] = self._see_inside(x.at(inside), turned.at(inside), graph)
            outside[inside] = why
        return CellBounds([str(word) for word in outside], lows, highs)

    def _see_inside(
        self, x: TaylorModel, elbow: TaylorModel, graph: TaylorFunction
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        problem = self.problem
        m, n = problem.measures.plant.n_passive, x.c.shape[1]
        posture, stiffness, mass, factors, *rows = graph([x], [elbow], *self._constants)
        outside = np.full(n, "", dtype=object)
        turns = [self._turns(k, angle, outside) for k, angle in enumerate(posture)]
        if rows:
            self._constrain(rows[0], outside)
        w = enclosed_measures(matrix(stiffness, m), matrix(mass, m), matrix(factors, len(factors) // m))
        travel = self._travel(x, posture, turns)
        bounds = (np.full(n, -np.inf), np.full(n, np.inf))
        for j, objective in enumerate(problem.objectives[: len(problem.kept) + 1]):
            value = TaylorModel.constant(0.0)
            for alpha, each in zip(objective.alpha, w, strict=True):
                if alpha:
                    value = value + each.scaled(alpha)
            if travel is not None:
                value = value - travel.scaled(problem.objective_scales[j])
            bounds = tuple(np.broadcast_to(bound, (n,)) for bound in value.bounds)
            if j < len(problem.kept):
                short = bounds[1] < problem.kept[j] - EDGE * problem.objective_scales[j]
                outside[short & (outside == "")] = NOT_KEPT
        low, high = bounds
        # No w_i is positive, and travel costs something.
        high = np.minimum(high, 0.0) if problem.bounded_by_zero else high
        known = np.isfinite(low) & np.isfinite(high) & ~np.isnan(low)
        return outside, np.where(known, low, -np.inf), np.where(known, high, np.inf)

    def _turns(self, k: int, angle: TaylorModel, outside: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Whole turns that bring joint k of a cell's postures into its limits: the least and the largest number."""
        variable = self.problem.variables[1 + k]
        low, high = (np.broadcast_to(bound, outside.shape) for bound in angle.bounds)
        first = np.ceil((variable.lower - EDGE - high) / TURN - 1e-12)
        last = np.floor((variable.upper + EDGE - low) / TURN + 1e-12)
        outside[(first > last) & (outside == "")] = LIMIT
        return first, last

    def _constrain(self, rows: list[TaylorModel], outside: FloatArray) -> None:
        """Mark the cells that break a constraint throughout."""
        extra = self.problem.constraint_set
        assert extra is not None  # there are rows
        for row, asked in zip(rows, extra.rows, strict=True):
            low, high = row.bounds
            beyond = (high < asked.lower - EDGE * asked.scale) | (low > asked.upper + EDGE * asked.scale)
            broken = np.broadcast_to(beyond, outside.shape)
            outside[broken & (outside == "")] = CONSTRAINT

    def _travel(
        self, x: TaylorModel, posture: list[TaylorModel], turns: list[tuple[FloatArray, FloatArray]]
    ) -> TaylorModel | None:
        """Cost · Σ ((z − z_now) / scale)², each joint on the turn where that is least."""
        problem = self.problem
        if problem.travel is None:
            return None
        total = TaylorModel.constant(0.0)
        for k, (z, now, scale) in enumerate(zip([x, *posture], problem.travel.now, problem.scale, strict=True)):
            away = z - TaylorModel.constant(float(now))
            if k and problem.variables[k].unit == "rad":
                away = _least_turn(away, *turns[k - 1])
            share = away.over(float(scale))
            total = total + share * share
        return total.scaled(problem.travel.cost)


def _least_turn(away: TaylorModel, first: FloatArray, last: FloatArray) -> TaylorModel:
    """What an angle is away, on the whole turn between `first` and `last` where that is nearest to 0."""
    nearest = np.minimum(np.maximum(-np.rint(away.c[0] / TURN), first), last)
    shift = TaylorModel((TURN * nearest)[None, :], 4e-16 * TURN * np.abs(nearest))
    turned = away + shift
    low, high = turned.bounds
    most = np.maximum(np.abs(low), np.abs(high))
    # On another turn it may be nearer in part of the cell: then only how near at most is known.
    unsure = (most > math.pi) & (last > first)
    least = np.minimum(np.where((low <= 0) & (high >= 0), 0.0, np.minimum(np.abs(low), np.abs(high))), TURN - most)
    hull = TaylorModel.between(np.maximum(least, 0.0) - 1e-12, most)
    c = np.where(unsure, 0.0, turned.c)
    c[0] += np.where(unsure, hull.c[0], 0.0)
    return TaylorModel(c, np.where(unsure, hull.r, turned.r))
