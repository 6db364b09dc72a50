"""The model that an ascent climbs by: branches of ε_max as eigenvalues of a matrix, and second derivatives.

In: a point with its slopes, and the second derivatives there. Out: the step that maximises the model within a box.

V ≤ uᵀ M(d) u for every unit u, with M(d) = [[V_1 + g_11·d, g_12·d], [g_12·d, V_2 + g_22·d]]: near a kink the branches
are the eigenvalues of a matrix that is linear in the step d. As many u as matter stand as rows in a quadratic program.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.selection.programs import Bounds
from flexopt.selection.quadratic import best_gain

# Step of the differences of slopes, in scaled variables: where the slopes of ε_max have lost half their digits, still
# three of the second derivatives are right. By how many steps' change branches are told apart.
DIFFERENCE, APART = 3e-4, 4.0
# The least curvature of a model, relative to its greatest: where V is flat, steps are short without it.
FLAT = 1e-7
# Unit vectors u of a pair of branches, and how near to the smaller eigenvalue they lead, as a share of what V gains.
DIRECTIONS, NEAR = 12, 1e-2
# Gains below this share of V / size are rounding.
ROUNDING = 1e-13
# A solution this far beyond its box is none.
BEYOND = 1.01


@dataclass(frozen=True)
class Branches:
    """V / size of one objective to first order: one value and slope (1, n), or two with g_12 after them, (3, n)."""

    values: Vector
    slopes: Vector

    @property
    def smallest(self) -> float:
        """The objective itself."""
        return float(self.values.min())

    @property
    def lowest_slope(self) -> Vector:
        """Its slope, (n,)."""
        return self.slopes[int(np.argmin(self.values))]

    def along(self, u: Vector) -> tuple[float, Vector]:
        """Value and slope of uᵀ M u; u (1,) or (2,)."""
        weights = _weights(np.outer(u, u))
        return float(weights[: self.values.size] @ self.values), weights @ self.slopes

    def pulled(self, weights: Vector) -> Vector:
        """Slope of tr(W M), (n,)."""
        return _weights(weights) @ self.slopes

    def lowest(self, d: Vector) -> tuple[float, Vector]:
        """The smallest eigenvalue of M(d), and its vector."""
        change = self.slopes @ d
        if self.values.size == 1:
            return float(self.values[0] + change[0]), np.ones(1)
        matrix = np.diag(self.values) + np.array([[change[0], change[2]], [change[2], change[1]]])
        values, vectors = np.linalg.eigh(matrix)
        return float(values[0]), vectors[:, 0]

    def stay_apart(self, d: Vector) -> bool:
        """Whether a step is too short to mix the branches."""
        return self.values.size == 1 or 4 * abs(float(self.slopes[2] @ d)) <= self.values[1] - self.values[0]


def _weights(matrix: Vector) -> Vector:
    """Weights of V_1, V_2 and g_12 in tr(W M)."""
    return matrix[0] if matrix.size == 1 else np.array([matrix[0, 0], matrix[1, 1], 2 * matrix[0, 1]])


@dataclass(frozen=True)
class Point:
    """A program at x (n,): rows (k,) with slopes (k, n), and its objectives, the one that is sought last.

    `epsilon_slopes` (3, n) are those of ε_max's branches, and of their coupling.
    """

    x: Vector
    rows: Vector
    row_slopes: Vector
    objectives: tuple[Branches, ...]
    epsilon_slopes: Vector

    @property
    def value(self) -> float:
        """V / size of the objective that is sought."""
        return self.objectives[-1].smallest

    @property
    def is_finite(self) -> bool:
        """Whether all of it is numbers."""
        parts = [self.rows, self.row_slopes, *(part for o in self.objectives for part in (o.values, o.slopes))]
        return all(bool(np.isfinite(part).all()) for part in parts)


@dataclass(frozen=True)
class Step:
    """A step d (n,) that maximises a model.

    Attributes:
        gain: what the model predicts.
        pulls: of each objective the matrix Σ μ u uᵀ of its multipliers;  row_pulls: those of the rows.
        bend: the model's second derivatives, sign changed, (n, n);  coupled: whether it mixes branches.
    """

    d: Vector
    gain: float
    pulls: tuple[Vector, ...]
    row_pulls: Vector
    bend: Vector
    coupled: bool

    @property
    def length(self) -> float:
        """The largest entry of d."""
        return float(np.abs(self.d).max())

    @property
    def slope(self) -> float:
        """The Lagrangian's gradient where the step begins, its largest entry."""
        return float(np.abs(self.bend @ self.d).max())


def best_step(
    here: Point, bend: Vector, bounds: Bounds, least: Vector, distance: float, pulls: tuple[Vector, ...] | None
) -> Step | None:
    """The step that maximises V − dᵀ bend d / 2 within a distance, the rows and what is kept; None without a solution.

    Args:
        here: where it begins.
        bend: positive definite, (n, n).
        bounds: of x and of the rows.
        least: V / size that is kept, of each objective but the last.
        distance: of any entry.
        pulls: where the branches' coupling is looked at those of the step before; else None.
    """
    units = [list(np.eye(branches.values.size)) for branches in here.objectives]
    for mine, weights in zip(units, pulls or (), strict=False):
        if len(mine) > 1 and np.trace(weights) > 0:
            mine += list(np.linalg.eigh(weights)[1].T)
    # What is short by less than counts is not made up for by the model.
    smallest = [branches.smallest for branches in here.objectives[:-1]]
    wanted = np.append(np.minimum(least, smallest), here.value)
    found = _limited(here, bend, bounds, wanted, distance, units)
    for _ in range(0 if pulls is None else DIRECTIONS):
        if found is None:
            break
        d, rise, multipliers = found
        lowest = [branches.lowest(d) for branches in here.objectives]
        rises = np.append(np.zeros(least.size), rise)
        # What is kept counts by as much as it costs.
        prices = [max(float(own.sum()), 1.0) for own in _own(multipliers, here, units)]
        missing = [
            j for j, (value, _) in enumerate(lowest) if value < wanted[j] + rises[j] - NEAR * abs(rise) / prices[j]
        ]
        if not missing:
            break
        for j in missing:
            units[j].append(lowest[j][1])
        found = _limited(here, bend, bounds, wanted, distance, units)
    if found is None:
        return None
    d, rise, multipliers = found
    gain = rise - float(d @ bend @ d) / 2
    if gain < -ROUNDING * (1 + abs(here.value)) or np.abs(d).max() > BEYOND * distance:
        return None
    pairs = zip(_own(multipliers, here, units), map(np.array, units), strict=True)
    weights = tuple(np.einsum("c,ci,cj->ij", mu, mine, mine) for mu, mine in pairs)
    return Step(d, max(gain, 0.0), weights, multipliers[: here.rows.size], bend, pulls is not None)


def _own(multipliers: Vector, here: Point, units: list[list[Vector]]) -> list[Vector]:
    """Of every objective the multipliers of its u, none negative."""
    edges = np.cumsum([here.rows.size, *(len(mine) for mine in units)])
    return [np.maximum(-multipliers[i:j], 0.0) for i, j in pairwise(edges.tolist())]


def _limited(
    here: Point, bend: Vector, bounds: Bounds, wanted: Vector, distance: float, units: list[list[Vector]]
) -> tuple[Vector, float, Vector] | None:
    """The step where every objective j, the last one with its rise, is at most uᵀ M u for the u in `units`[j]."""
    lower, upper = np.maximum(bounds.x_lower - here.x, -distance), np.minimum(bounds.x_upper - here.x, distance)
    rows = [np.append(slope, 0.0) for slope in here.row_slopes]
    low, high = list(bounds.g_lower - here.rows), list(bounds.g_upper - here.rows)
    for j, (branches, mine) in enumerate(zip(here.objectives, units, strict=True)):
        sought = j == len(units) - 1
        for value, slope in map(branches.along, mine):
            rows.append(np.append(slope, -1.0 if sought else 0.0))
            low.append(wanted[j] - value if sought else min(wanted[j] - value, 0.0))
            high.append(np.inf)
    return best_gain(bend, np.array(rows), Bounds(lower, upper, np.array(low), np.array(high)))


@dataclass(frozen=True)
class SecondOrder:
    """Second derivatives at a point along the directions that the equations leave, the rows of `free` (d, n).

    Attributes:
        here: the point.
        smooth: those of the Lagrangian without ε_max, sign changed, (d, d).
        margins: those of both branches, (2, d, d).
        kinks: of each objective β / size, 0 where ε_max takes no part;  pulls: as in `Step`.
    """

    here: Point
    free: Vector
    smooth: Vector
    margins: Vector
    kinks: Vector
    pulls: tuple[Vector, ...]

    def bend(self, *, coupled: bool) -> Vector:
        """Those of the Lagrangian, sign changed, made positive, (n, n); without what coupled branches bend."""
        inner = self.smooth
        for kink, branches, weights in zip(self.kinks, self.mixed.objectives, self.pulls, strict=True):
            if kink:
                inner = inner - kink * self._of_margin(branches, weights, kink, coupled=coupled)
        values, vectors = np.linalg.eigh((inner + inner.T) / 2)
        size = max(float(np.abs(values).max(initial=0.0)), FLAT)
        values = np.maximum(values, FLAT * size)
        across = np.eye(self.free.shape[1]) - self.free.T @ self.free
        return self.free.T @ (vectors * values) @ vectors.T @ self.free + size * across

    @cached_property
    def mixed(self) -> Point:
        """The point, with g_12 as large as the branches' second derivatives say that it mixes them.

        Off a kink g_12 depends on how the eigenvectors are taken along, which the derivatives of the branches undo.
        """
        pairs = zip(self.here.objectives, self.kinks, strict=True)
        return replace(self.here, objectives=tuple(self._mixed(branches, kink) for branches, kink in pairs))

    def _mixed(self, branches: Branches, kink: float) -> Branches:
        gap, turn = self._apart(branches, kink)
        size = float(turn @ turn)
        if gap == 0.0 or size**2 == 0.0:
            return branches
        seen = gap * float(turn @ (self.margins[1] - self.margins[0]) @ turn) / (4 * size**2)
        scaled = np.sqrt(np.clip(seen, 0.0, 1.0)) * branches.slopes[2:]
        return replace(branches, slopes=np.vstack([branches.slopes[:2], scaled]))

    def _apart(self, branches: Branches, kink: float) -> tuple[float, Vector]:
        """By how much the branches of ε_max differ, 0 where differences mix them, and g_12 along `free`."""
        if branches.values.size == 1:
            return 0.0, np.zeros(len(self.free))
        gap = float(branches.values[1] - branches.values[0]) / kink
        turn = self.free @ branches.slopes[2] / kink
        pull = self.free @ (branches.slopes[1] - branches.slopes[0]) / kink
        near = gap < APART * DIFFERENCE * float(np.linalg.norm(pull) + 2 * np.linalg.norm(turn))
        return 0.0 if near else gap, turn

    def _of_margin(self, branches: Branches, weights: Vector, kink: float, *, coupled: bool) -> Vector:
        """Second derivatives of tr(W M) / kink, (d, d); of the branches' mean where differences mix them."""
        first, second = self.margins
        if not coupled:
            return weights[0, 0] * first + weights[1, 1] * second
        gap, turn = self._apart(branches, kink)
        if gap == 0.0:
            return (weights[0, 0] + weights[1, 1]) * (first + second) / 2
        bent = 2 * np.outer(turn, turn) / gap
        return weights[0, 0] * (first + bent) + weights[1, 1] * (second - bent)
