"""Ascent of objectives that may have kinks: of ε_max, and of w_i where a_i = 0 or b_i = 0.

In: configurations that share variables, one or many, and a start. Out: a point that keeps every constraint and is never
worse than the start.

Each step maximises a model (`model`) within a distance that grows where the model holds and shrinks where it
does not, and is moved back onto the constraints: points stay feasible, so that V alone tells whether a step helps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.selection.ascent.member import AscentMember
from flexopt.selection.ascent.model import (
    DIFFERENCE,
    ROUNDING,
    Cone,
    Point,
    SecondOrder,
    Step,
    best_step,
    halves,
)
from flexopt.selection.cones import SHARED, TINY, mode_cones
from flexopt.selection.nlp.coupling import own_directions, widened
from flexopt.selection.nlp.solvers import Bounds

# Distances, in scaled variables: of the first step, the greatest, and the one below which nothing is found.
FIRST, GREATEST, LEAST = 0.1, 0.5, 1e-10
# Of the first one where its program has no solution that is told to enough digits.
SHORTEST = 1e-4
# Shares of the predicted gain: below the first a step is not taken, below the second the next is shorter, above the
# third it may be longer.
POOR, FAIR, FINE = 0.1, 0.25, 0.75
# The Lagrangian's gradient at an optimum, of V / size by scaled variables: a tenth of what proofs allow.
STATIONARY = 1e-7
# How near to the rows points are, in their scales. By how much values that are kept may be short, in theirs, and below
# which of it no more steps are made towards them. Branches that differ by so many times as much are lifted together.
ON_ROWS, ON_KEPT, AT_KEPT, CORRECTIONS, LIFTS = 1e-11, 1e-10, 1e-13, 6, 24
TOGETHER = 100.0
# Steps with the same second derivatives back onto a ridge, and the least curvature then, relative to the greatest.
CHORDS, STIFF = 3, 0.3
# Multipliers of ε_max, as a share of those where it alone is sought, from which on its differences are central.
DEAR = 10.0
# Cones up to so many steps away are looked at, and how many times as long as the one before a step is taken to be.
REACH, AHEAD = 2.0, 3.0
DONE, CUT_SHORT, STUCK = "Solve_Succeeded", "Maximum_Iterations_Exceeded", "Search_Direction_Becomes_Too_Small"


@dataclass(frozen=True)
class Ascent:
    """The program in x = (z − shift) / scale.

    With V_jk / size of every objective j of configuration k, what is kept and what is sought are the sums
    Σ mix_ojk V_jk / size; or −|steps x|² / 2 is sought.

    Attributes:
        members: the configurations; ε_max takes part where there is one.
        mix: ≥ 0, of what is kept, then of what is sought, (o, j, k).
        least: what is kept is at least.
        bounds: of x and of the rows: those of every configuration, then steps @ x.
        steps: (s, n);  shortest: whether the last of what is sought is −|steps x|² / 2, its mix 0.
        noise: rounding error of what is kept: what is short by less is not short.
        sought: how many are sought: the smallest of them is climbed.
    """

    members: tuple[AscentMember, ...]
    mix: Vector
    least: Vector
    bounds: Bounds
    steps: Vector
    shortest: bool = False
    noise: float = 0.0
    sought: int = 1

    def climbed(self, start: Vector, iterations: int) -> tuple[Vector, int, str] | None:
        """Where steps from a start lead, how many, and why they ended; None where the start leads onto no rows."""
        here, distance = self.restored(start, LIFTS), FIRST
        if here is None:
            return None
        step = None
        while step is None and distance > SHORTEST:
            step = self._step(here, np.eye(here.x.size), distance, here.near(REACH * distance), None, coupled=False)
            distance = distance if step is not None else distance / 4
        for number in range(iterations):
            second = None if step is None else self._second(here, step, distance)
            if second is None:
                return here.x, number, STUCK
            there, step, distance = self._next(second, distance)
            if there is None:
                return here.x, number, DONE if distance > LEAST else STUCK
            here = there
        return here.x, iterations, CUT_SHORT

    def at(self, x: Vector) -> Point:
        """The program at x."""
        points = [member.at(x) for member in self.members]
        parts = list(zip(self.members, points, strict=True))
        values = np.einsum("ojk,kj->o", self.mix, np.array([point.values for point in points]))
        told = np.array([self._wide(member, point.slopes) for member, point in parts])
        slopes = np.einsum("ojk,kjn->on", self.mix, told)
        along = self.steps @ x
        if self.shortest:
            values[-1] -= float(along @ along) / 2
            slopes[-1] -= self.steps.T @ along
        modes, alone = list[Cone](), np.zeros(0, dtype=np.bool_)
        alphas = np.hstack([self.mix[:, :, k] @ point.alphas for k, point in enumerate(points)])
        if alphas.any():
            f, f_x, same = self._factors(x)
            # A pull below 0 turns a cone over: of that there is nothing to climb on.
            sizes = [self.mix[:, :, k] @ np.maximum(point.alphas, 0.0) for k, point in enumerate(points)]
            modes = mode_cones(f, f_x, np.hstack(sizes))
            alone = same[: len(modes) // 2] < SHARED
        epsilon_x = self._wide(self.members[0], points[0].epsilon_slopes)
        return Point(
            x=x,
            rows=np.concatenate([*(point.rows for point in points), along]),
            row_slopes=np.vstack([*(self._wide(member, point.row_slopes) for member, point in parts), self.steps]),
            values=values,
            slopes=slopes,
            cones=(*modes, *self._margin_cone(points[0].gap, epsilon_x)),
            alone=alone,
            alphas=alphas,
            epsilon_slopes=epsilon_x,
            sought=self.sought,
        )

    def _wide(self, member: AscentMember, slopes: Vector) -> Vector:
        """Slopes (…, n) by x of those by a configuration's own entries."""
        return widened(slopes, member.place, self.bounds.x_lower.size)

    def rows(self, x: Vector) -> tuple[Vector, Vector]:
        """All rows at x, and their slopes."""
        found = [member.rows(x) for member in self.members]
        slopes = [self._wide(member, own) for member, (_, own) in zip(self.members, found, strict=True)]
        return np.concatenate([*(rows for rows, _ in found), self.steps @ x]), np.vstack([*slopes, self.steps])

    def _factors(self, x: Vector) -> tuple[Vector, Vector, Vector]:
        """As `AscentMember.factors`, modes of all configurations in a row."""
        found = [member.factors(x) for member in self.members]
        f, f_z, same = zip(*found, strict=True)
        wide = [self._wide(member, own) for member, own in zip(self.members, f_z, strict=True)]
        return np.concatenate(f), np.concatenate(wide), np.concatenate(same)

    @cached_property
    def _kinks(self) -> Vector:
        """What of ε_max is kept and sought, (o,)."""
        mixed: Vector = self.mix[:, :, 0] @ self.members[0].kinks
        return mixed

    def _margin_cone(self, gap: float, epsilon_x: Vector) -> list[Cone]:
        """−β |((V_1 − V_2) / 2, g_12)|, in a list; none where ε_max takes no part."""
        if not self._kinks.any():
            return []
        return [Cone(np.array([-gap / 2, 0.0]), halves(epsilon_x), self._kinks, np.array([-1.0, 0.0]))]

    def onto_rows(self, x: Vector) -> tuple[Vector, bool] | None:
        """The point nearest to x, to first order, on the rows, and whether they hold there; None without slopes."""
        x = np.clip(x, self.bounds.x_lower, self.bounds.x_upper)
        for _ in range(CORRECTIONS):
            rows, slopes = self.rows(x)
            wrong = self._beyond(rows)
            if not (np.isfinite(wrong).all() and np.isfinite(slopes).all()):
                return None
            if np.abs(wrong).max(initial=0.0) <= ON_ROWS:
                return x, True
            x = x - self._shortest(x, slopes, wrong, self._equal | (wrong != 0))
            x = np.clip(x, self.bounds.x_lower, self.bounds.x_upper)
        return x, False

    def restored(self, x: Vector, lifts: int = CORRECTIONS) -> Point | None:
        """The point nearest to x, to first order, where everything holds; None where steps do not lead there.

        `lifts`: steps at most towards what is kept; each takes off three quarters of what is short next to a maximum.
        """
        found = self.onto_rows(x)
        if found is None:
            return None
        point = self.at(found[0])
        best: tuple[float, Point | None] = (max(ON_KEPT, 2 * self.noise), None)
        for _ in range(lifts):
            if not point.is_finite:
                break
            wrong, slopes, short = self._lifting(point)
            of_rows = wrong[: point.rows.size]
            if np.abs(of_rows).max(initial=0.0) <= ON_ROWS and short <= best[0]:
                best = short, point
            if best[1] is not None and best[0] <= max(AT_KEPT, self.noise):
                break
            chosen = np.append(self._equal | (of_rows != 0), np.full(wrong.size - of_rows.size, fill_value=True))
            x = point.x - self._shortest(point.x, slopes, wrong, chosen)
            point = self.at(np.clip(x, self.bounds.x_lower, self.bounds.x_upper))
        return best[1]

    def _lifting(self, at: Point) -> tuple[Vector, Vector, float]:
        """What rows and kept objectives are off, their slopes, and by how much the objectives are short at most.

        Near a kink c is held: to lift one of two branches alone may lower the other.
        """
        wrong, slopes, shortest = [self._beyond(at.rows)], [at.row_slopes], 0.0
        for j, short in enumerate(self.least - at.values[: self.least.size]):
            if short <= 0:
                continue
            shortest = max(shortest, float(short))
            slopes.append(at.slopes[j : j + 1])
            wrong.append(np.array([-short]))
            for cone in at.cones:
                if 0 < 2 * cone.sizes[j] * np.linalg.norm(cone.value) <= TOGETHER * short:
                    slopes.append(cone.slopes)
                    wrong.append(np.zeros(cone.value.size))
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

    @property
    def _step(self) -> Callable[..., Step | None]:
        return partial(best_step, self.bounds, self.least)

    def _model(self, second: SecondOrder, distance: float) -> Step | None:
        """The step by ε_max's branches of their own, where it is too short to mix them; else by coupled ones."""
        before, cones = second.step, second.cones
        step = self._step(second.here, second.bend(coupled=False), distance, cones, before, coupled=False)
        if step is None or second.stays_apart(step.d):
            return step
        return self._step(second.mixed, second.bend(coupled=True), distance, cones, before, coupled=True)

    def _next(self, second: SecondOrder, distance: float) -> tuple[Point | None, Step | None, float]:
        """The next point, the step that led to it, and how far the model is to be trusted; no point at the end."""
        here = second.here
        kept = float(second.step.pulls[: self.least.size].sum())
        rounding = ROUNDING * (1 + abs(here.value)) + self.noise * kept
        while distance > LEAST:
            step = self._model(second, distance)
            if step is None:
                distance /= 4
                continue
            inside = step.length < 0.99 * distance
            if inside and (step.length <= LEAST or max(step.slope, step.gain / step.length) <= STATIONARY):
                return None, None, distance
            there = self._corrected(self.restored(here.x + step.d), step, distance, second.cones)
            gain = -np.inf if there is None else there.value - here.value
            if there is None or gain <= max(POOR * step.gain - rounding, -rounding):
                distance = min(distance, step.length) / 4
                continue
            if gain > FINE * step.gain and not inside:
                distance = min(2 * distance, GREATEST)
            elif gain < FAIR * step.gain - rounding:
                distance = step.length / 2
            carried = step.carried(here, there)
            if step.gain <= rounding and not self._off(there, carried) < 0.5 * self._off(here, step):
                return None, None, distance
            return there, carried, distance
        return None, None, 0.0

    def _corrected(self, there: Point | None, step: Step, distance: float, cones: tuple[int, ...]) -> Point | None:
        """Where the same second derivatives lead from the end of a step: back onto a ridge that is bent.

        Along the ridge, where V bends little, nearly nothing is moved.
        """
        values, vectors = np.linalg.eigh(step.bend)
        stiff = (vectors * np.maximum(values, STIFF * values[-1])) @ vectors.T
        for _ in range(CHORDS):
            if there is None:
                break
            again = self._step(there, stiff, distance, cones, step, coupled=step.coupled)
            if again is None or again.gain <= POOR * step.gain:
                break
            after = self.restored(there.x + again.d)
            if after is None or after.value <= there.value:
                break
            there = after
        return there

    def _off(self, at: Point, step: Step) -> float:
        """What is left of V's gradient along the free directions, with a step's multipliers."""
        inside = (at.x > self.bounds.x_lower + ON_ROWS) & (at.x < self.bounds.x_upper - ON_ROWS)
        return float(np.linalg.norm(self._free(at) @ (step.left_at(at) * inside)))

    def _free(self, at: Point) -> Vector:
        """An orthonormal basis (d, n) of the directions that equations and fixed entries leave."""
        identity = np.eye(at.x.size)
        rows = np.vstack([at.row_slopes[self._equal], identity[self._moving == 0]])
        if not rows.size:
            return identity
        _, singular, directions = np.linalg.svd(rows)
        return directions[int(np.sum(singular > 1e-9 * singular[0])) :]

    def _second(self, here: Point, step: Step, distance: float) -> SecondOrder | None:
        """Second derivatives at a point, with the multipliers of a step, for steps up to a distance.

        Where steps are short only cones nearby count: what w_i bend without them is less like V.
        """
        free, cones = self._free(here), here.near(REACH * min(distance, AHEAD * step.length))
        held, each, first = self._held(here, step, cones), 2 * here.n_modes // len(self.members), 0
        smooth = np.zeros((len(free), len(free)))
        for k, member in enumerate(self.members):
            along, basis = own_directions(free, member.place)
            of_rows, first = step.row_pulls[first : first + member.n_rows], first + member.n_rows
            own = {number - k * each: pull for number, pull in held.items() if number // each == k}
            bent = member.bend(here.x, basis, step.pulls @ self.mix[:, :, k], of_rows, own)
            smooth += along @ bent @ along.T
        if self.shortest:
            ways = free @ self.steps.T
            smooth += float(step.pulls[-1]) * ways @ ways.T
        margins, turning = np.zeros((2, len(free), len(free))), np.zeros((2, len(free), len(free)))
        pull = float(step.pulls @ self._kinks)
        if len(free) and pull > 0:
            margin = self.members[0].margin
            ahead = np.array([margin(here.x + DIFFERENCE * way) for way in free])
            # What is kept may have multipliers of thousands, which the error of one-sided differences is multiplied by.
            central = pull > DEAR * float(self._kinks.max())
            behind = np.array([margin(here.x - DIFFERENCE * way) if central else here.epsilon_slopes for way in free])
            if not (np.isfinite(ahead).all() and np.isfinite(behind).all()):
                return None
            apart = DIFFERENCE * (2 if central else 1)
            margins = _symmetric((ahead - behind)[:, :2] @ free.T / apart)
            change = np.array([here.turned(end) - here.turned(begin) for end, begin in zip(ahead, behind, strict=True)])
            turning = _symmetric(change @ free.T / apart)
        if not np.isfinite(smooth).all():
            return None
        return SecondOrder(here, free, smooth, margins, turning, step, cones)

    def _held(self, here: Point, step: Step, cones: tuple[int, ...]) -> dict[int, tuple[float, Vector]]:
        """What `smooth_slope` holds of modes whose cones are looked at, ν as a step pulls it."""
        held: dict[int, tuple[float, Vector]] = {}
        for number in cones:
            if number < 2 * here.n_modes:
                cone, size = here.cones[number], float(np.linalg.norm(here.cones[number ^ 1].value))
                pull = step.cone_pulls.get(number, float(step.pulls @ cone.sizes) * cone.unit)
                held[number] = float(step.pulls @ here.alphas[:, number // 2]), pull / max(size, TINY)
        return held


def _symmetric(change: Vector) -> Vector:
    """Second derivatives (k, d, d) from changes (d, k, d) of k slopes along d ways."""
    return (change.transpose(1, 0, 2) + change.transpose(1, 2, 0)) / 2
