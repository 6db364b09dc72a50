"""Ascent of one configuration's objective where ε_max takes part: a maximum of the smaller of two branches.

In: a program's Functions, and a start. Out: a point that keeps every constraint and is never worse than the start.

Each step maximises a model (`ascent_model`) within a distance that grows where the model holds and shrinks where it
does not, and is moved back onto the constraints: points stay feasible, so that V alone tells whether a step helps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.selection.ascent_model import DIFFERENCE, ROUNDING, Branches, Point, SecondOrder, Step, best_step
from flexopt.selection.nlp import Branched
from flexopt.selection.programs import Bounds

# Distances, in scaled variables: of the first step, the greatest, and the one below which nothing is found.
FIRST, GREATEST, LEAST = 0.1, 0.5, 1e-10
# Shares of the predicted gain: below the first a step is not taken, below the second the next is shorter, above the
# third it may be longer.
POOR, FAIR, FINE = 0.1, 0.25, 0.75
# The Lagrangian's gradient at an optimum, of V / size by scaled variables: a tenth of what proofs allow.
STATIONARY = 1e-7
# How near to the rows points are, in their scales. By how much values that are kept may be short, in theirs, and below
# which of it no more steps are made towards them. Branches that differ by so many times as much are lifted together.
ON_ROWS, ON_KEPT, AT_KEPT, CORRECTIONS = 1e-11, 1e-10, 1e-13, 6
TOGETHER = 100.0
# Steps with the same second derivatives back onto a ridge, and the least curvature then, relative to the greatest.
CHORDS, STIFF = 3, 0.3
DONE, CUT_SHORT, STUCK = "Solve_Succeeded", "Maximum_Iterations_Exceeded", "Search_Direction_Becomes_Too_Small"


@dataclass(frozen=True)
class Ascent:
    """The program in x = (z − shift) / scale.

    Attributes:
        functions: from `build_branched`;  parameters: those of the solver.
        kinks: of each objective, the one that is sought last, β / size, 0 where ε_max takes no part.
        least: V / size that is kept, of each objective but the last.
        bounds: of x and of the rows.
        margin: x -> slopes of ε_max's branches, and of their coupling, by x, (3, n).
    """

    functions: Branched
    parameters: Vector
    kinks: Vector
    least: Vector
    bounds: Bounds
    margin: Callable[[Vector], Vector]

    def climbed(self, start: Vector, iterations: int) -> tuple[Vector, int, str] | None:
        """Where steps from a start lead, how many, and why they ended; None where the start leads onto no rows."""
        here, distance = self.restored(start), FIRST
        if here is None:
            return None
        step = self._step(here, np.eye(here.x.size), distance)
        for number in range(iterations):
            second = None if step is None else self._second(here, step)
            if second is None:
                return here.x, number, STUCK
            there, step, distance = self._next(second, distance)
            if there is None:
                return here.x, number, DONE if distance > LEAST else STUCK
            here = there
        return here.x, iterations, CUT_SHORT

    def at(self, x: Vector) -> Point:
        """The program at x."""
        last, g, last_x, g_x, epsilon_x = (out.full() for out in self.functions.model.call([x, self.parameters]))
        first = n_rows = self.bounds.g_lower.size
        values, slopes = np.concatenate([g, last]).ravel(), np.vstack([g_x, last_x])
        objectives: list[Branches] = []
        for kink in self.kinks:
            mine = slice(first, first + (2 if kink else 1))
            coupling = kink * epsilon_x[2:] if kink else epsilon_x[:0]
            objectives.append(Branches(values[mine], np.vstack([slopes[mine], coupling])))
            first = mine.stop
        return Point(x, values[:n_rows], slopes[:n_rows], tuple(objectives), epsilon_x)

    def restored(self, x: Vector) -> Point | None:
        """The point nearest to x, to first order, where everything holds; None where steps do not lead there."""
        for _ in range(CORRECTIONS):
            x = np.clip(x, self.bounds.x_lower, self.bounds.x_upper)
            rows, slopes = (out.full() for out in self.functions.rows.call([x, self.parameters]))
            wrong = self._beyond(rows.ravel())
            if not (np.isfinite(wrong).all() and np.isfinite(slopes).all()):
                return None
            if np.abs(wrong).max(initial=0.0) <= ON_ROWS:
                break
            x = x - self._shortest(x, slopes, wrong, self._equal | (wrong != 0))
        point = self.at(np.clip(x, self.bounds.x_lower, self.bounds.x_upper))
        best: tuple[float, Point | None] = (ON_KEPT, None)
        for _ in range(CORRECTIONS):
            if not point.is_finite:
                break
            wrong, slopes, short = self._lifting(point)
            of_rows = wrong[: point.rows.size]
            if np.abs(of_rows).max(initial=0.0) <= ON_ROWS and short <= best[0]:
                best = short, point
            if best[0] <= AT_KEPT:
                break
            chosen = np.append(self._equal | (of_rows != 0), np.full(wrong.size - of_rows.size, fill_value=True))
            x = point.x - self._shortest(point.x, slopes, wrong, chosen)
            point = self.at(np.clip(x, self.bounds.x_lower, self.bounds.x_upper))
        return best[1]

    def _lifting(self, at: Point) -> tuple[Vector, Vector, float]:
        """What rows and kept objectives are off, their slopes, and by how much the objectives are short at most.

        Near a kink both branches are lifted, and not mixed: to lift one alone may lower the other.
        """
        wrong, slopes, shortest = [self._beyond(at.rows)], [at.row_slopes], 0.0
        for branches, least in zip(at.objectives[:-1], self.least, strict=True):
            short = least - branches.smallest
            if short <= 0:
                continue
            shortest = max(shortest, short)
            together = branches.values.size > 1 and abs(branches.values[1] - branches.values[0]) <= TOGETHER * short
            slopes.append(branches.slopes if together else branches.lowest_slope[None])
            wrong.append(np.array([-short, -short, 0.0]) if together else np.array([-short]))
        return np.concatenate(wrong), np.vstack(slopes), shortest

    @cached_property
    def _moving(self) -> Vector:
        """1 for entries of x that may change, else 0."""
        return (self.bounds.x_lower < self.bounds.x_upper).astype(float)

    @cached_property
    def _equal(self) -> NDArray[np.bool_]:
        """Which rows are equations."""
        equal: NDArray[np.bool_] = self.bounds.g_lower == self.bounds.g_upper
        return equal

    def _beyond(self, rows: Vector) -> Vector:
        return np.minimum(rows - self.bounds.g_lower, 0.0) + np.maximum(rows - self.bounds.g_upper, 0.0)

    def _shortest(self, x: Vector, slopes: Vector, wrong: Vector, chosen: NDArray[np.bool_]) -> Vector:
        """The shortest change that takes `wrong` off, to first order; what would leave its bounds is held."""
        moving, step = self._moving.copy(), np.zeros(x.size)
        for _ in range(x.size):
            step = moving * np.linalg.lstsq(slopes[chosen] * moving, wrong[chosen], rcond=1e-12)[0]
            down, up = (x <= self.bounds.x_lower) & (step > 0), (x >= self.bounds.x_upper) & (step < 0)
            if not np.any(down | up):
                break
            moving[down | up] = 0.0
        return step

    def _step(self, here: Point, bend: Vector, distance: float, pulls: tuple[Vector, ...] | None = None) -> Step | None:
        return best_step(here, bend, self.bounds, self.least, distance, pulls)

    def _model(self, second: SecondOrder, distance: float) -> Step | None:
        """The step by branches of their own, where it is too short to mix them; else by coupled ones."""
        step = self._step(second.here, second.bend(coupled=False), distance)
        if step is None or all(branches.stay_apart(step.d) for branches in second.mixed.objectives):
            return step
        return self._step(second.mixed, second.bend(coupled=True), distance, second.pulls)

    def _next(self, second: SecondOrder, distance: float) -> tuple[Point | None, Step | None, float]:
        """The next point, the step that led to it, and how far the model is to be trusted; no point at the end."""
        here = second.here
        rounding = ROUNDING * (1 + abs(here.value))
        while distance > LEAST:
            step = self._model(second, distance)
            if step is None:
                distance /= 4
                continue
            inside = step.length < 0.99 * distance
            if inside and (step.length <= LEAST or (not step.coupled and step.slope <= STATIONARY)):
                return None, None, distance
            there = self._corrected(self.restored(here.x + step.d), step, distance)
            gain = -np.inf if there is None else there.value - here.value
            if there is None or gain <= max(POOR * step.gain - rounding, -rounding):
                distance = min(distance, step.length) / 4
                continue
            if gain > FINE * step.gain and not inside:
                distance = min(2 * distance, GREATEST)
            elif gain < FAIR * step.gain - rounding:
                distance = step.length / 2
            if step.gain <= rounding and not self._off(there, step) < 0.5 * self._off(here, step):
                return None, None, distance
            return there, step, distance
        return None, None, 0.0

    def _corrected(self, there: Point | None, step: Step, distance: float) -> Point | None:
        """Where the same second derivatives lead from the end of a step: back onto a ridge that is bent.

        Along the ridge, where V bends little, nearly nothing is moved.
        """
        values, vectors = np.linalg.eigh(step.bend)
        stiff = (vectors * np.maximum(values, STIFF * values[-1])) @ vectors.T
        for _ in range(CHORDS):
            again = None if there is None else self._step(there, stiff, distance, step.pulls if step.coupled else None)
            if there is None or again is None or again.gain <= POOR * step.gain:
                break
            after = self.restored(there.x + again.d)
            if after is None or after.value <= there.value:
                break
            there = after
        return there

    def _off(self, at: Point, step: Step) -> float:
        """What is left of V's gradient along the free directions, with a step's multipliers."""
        left = -step.row_pulls @ at.row_slopes
        for branches, weights in zip(at.objectives, step.pulls, strict=True):
            left = left + branches.pulled(weights)
        inside = (at.x > self.bounds.x_lower + ON_ROWS) & (at.x < self.bounds.x_upper - ON_ROWS)
        return float(np.linalg.norm(self._free(at) @ (left * inside)))

    def _free(self, at: Point) -> Vector:
        """An orthonormal basis (d, n) of the directions that equations and fixed entries leave."""
        identity = np.eye(at.x.size)
        rows = np.vstack([at.row_slopes[self._equal], identity[self._moving == 0]])
        if not rows.size:
            return identity
        _, singular, directions = np.linalg.svd(rows)
        return directions[int(np.sum(singular > 1e-9 * singular[0])) :]

    def _second(self, here: Point, step: Step) -> SecondOrder | None:
        """Second derivatives at a point, with the multipliers of a step."""
        free, pulls = self._free(here), np.array([np.trace(weights) for weights in step.pulls])
        given = [here.x, self.parameters, -pulls, step.row_pulls]
        smooth = free @ self.functions.curvature.call(given)[0].full() @ free.T
        margins = np.zeros((2, len(free), len(free)))
        if len(free) and np.any(pulls[self.kinks > 0] > 0):
            beside = [self.margin(here.x + DIFFERENCE * direction) - here.epsilon_slopes for direction in free]
            change = np.array([difference[:2] @ free.T for difference in beside]).transpose(1, 0, 2) / DIFFERENCE
            margins = (change + change.transpose(0, 2, 1)) / 2
        if not (np.isfinite(smooth).all() and np.isfinite(margins).all()):
            return None
        return SecondOrder(here, free, smooth, margins, self.kinks, step.pulls)
