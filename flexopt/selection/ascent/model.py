"""The model that an ascent climbs by: cones where an objective has kinks, and second derivatives.

In: a point with its slopes and cones, and the second derivatives there. Out: the step that maximises the model.

Objectives are smooth but for terms −size |c|, c a small vector: of w_i = a_i·b_i − |a_i||b_i| near a_i = 0 or b_i = 0,
and of ε_max, the smaller eigenvalue of a 2 × 2 matrix, (V_1 + V_2) / 2 − |((V_1 − V_2) / 2, g_12)|. A step d takes c to
c + C d: the model is a second-order cone program (`cone_program`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.selection.ascent.cone_program import Cones, best_gain
from flexopt.selection.nlp.solvers import Bounds

# Step of the differences of slopes of ε_max, in scaled variables: where they have lost half their digits, still three
# of the second derivatives are right. By how many steps' change branches are told apart.
DIFFERENCE, APART = 3e-4, 4.0
# The least curvature of a model, relative to its greatest: where V is flat, steps are short without it.
FLAT = 1e-7
# Gains below this share of V / size are rounding.
ROUNDING = 1e-13
# A force that is shorter than this share of the longest one is of a tip that the step ends on; a step goes along tips
# that are nearer than this share of it.
INSIDE, BESIDE = 1 - 1e-6, 0.03
# Singular values of a C below this share of its largest are rounding.
DEPENDENT = 1e-9
# A solution this far beyond its box is none.
BEYOND = 1.01


@dataclass(frozen=True)
class Cone:
    """The term −sizes_j |c| of every objective j.

    Attributes:
        value: c, (r,);  slopes: C = ∂c/∂x, (r, n).
        sizes: of the objectives, (k,).
        unit: the u whose −sizes_j uᵀC is part of the slope that is told of objective j: c / |c|, or of ε_max (−1, 0).
    """

    value: Vector
    slopes: Vector
    sizes: Vector
    unit: Vector

    @cached_property
    def length(self) -> float:
        """|C|: how much |c| changes at most in a step of length 1."""
        return float(np.linalg.norm(self.slopes, 2))

    @cached_property
    def distance(self) -> float:
        """How far c = 0 is, in scaled variables, to first order and at least."""
        return float(np.linalg.norm(self.value)) / self.length if self.length > 0 else np.inf

    @property
    def axes(self) -> Vector:
        """Unit vectors (k, r) of what C reaches."""
        left, singular, _ = np.linalg.svd(self.slopes, full_matrices=False)
        return left.T[singular > DEPENDENT * self.length]


@dataclass(frozen=True)
class Point:
    """A program at x (n,): rows (k,) with slopes (k, n), and its objectives, those that are sought last.

    Attributes:
        x, rows, row_slopes: see above.
        values, slopes: V / size of the objectives, (j,) and (j, n).
        cones: where they may have kinks; of modes two each, then that of ε_max where it takes part.
        alone: of each mode, whether its frequency is simple: cones of others are not looked at.
        alphas: ∂V/∂w / size of the objectives, (j, m).
        epsilon_slopes: of ε_max's branches, and of their coupling, (3, n); else (0, n).
        sought: how many objectives are: what is climbed is the smallest of them.
    """

    x: Vector
    rows: Vector
    row_slopes: Vector
    values: Vector
    slopes: Vector
    cones: tuple[Cone, ...]
    alone: NDArray[np.bool_]
    alphas: Vector
    epsilon_slopes: Vector
    sought: int = 1

    @property
    def value(self) -> float:
        """V / size of what is sought."""
        return float(self.values[-self.sought :].min())

    @property
    def is_finite(self) -> bool:
        """Whether all of it is numbers."""
        parts = [self.rows, self.row_slopes, self.values, self.slopes]
        parts += [part for cone in self.cones for part in (cone.value, cone.slopes)]
        return all(bool(np.isfinite(part).all()) for part in parts)

    @property
    def n_modes(self) -> int:
        """How many modes have cones."""
        return self.alone.size

    @property
    def margin_cone(self) -> int | None:
        """Number of the cone of ε_max."""
        return 2 * self.n_modes if len(self.cones) > 2 * self.n_modes else None

    def turned(self, epsilon_slopes: Vector) -> Vector:
        """C of the cone of ε_max at a point nearby (2, n), by the eigenvectors of this one."""
        nearby = halves(epsilon_slopes)
        return turn(nearby, halves(self.epsilon_slopes)) @ nearby

    def near(self, distance: float) -> tuple[int, ...]:
        """Numbers of the cones that steps with entries of this size may meet; of a mode's two the nearer one."""
        chosen: list[int] = []
        for i in range(self.n_modes):
            k = min((2 * i, 2 * i + 1), key=lambda number: self.cones[number].distance)
            if self.alone[i] and self.cones[k].sizes.any() and self.cones[k].distance <= distance:
                chosen.append(k)
        last = self.margin_cone
        if last is not None and self.cones[last].distance <= np.sqrt(self.x.size) * distance:
            chosen.append(last)
        return tuple(chosen)


@dataclass(frozen=True)
class Step:
    """A step d (n,) that maximises a model.

    Attributes:
        gain: what the model predicts.
        pulls: multipliers of the objectives, of those that are sought 1 together;  row_pulls: those of the rows.
        cone_pulls: of the cones by number, their p, |p| ≤ Σ pulls sizes: −pᵀ C is their part in the slope.
        bend: the model's second derivatives, sign changed, (n, n);  coupled: whether it mixes the branches of ε_max.
    """

    d: Vector
    gain: float
    pulls: Vector
    row_pulls: Vector
    cone_pulls: dict[int, Vector]
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

    def carried(self, begin: Point, end: Point) -> Step:
        """The step with its force on the cone of ε_max told by the eigenvectors at its end, where it kept to the tip.

        At a kink eigenvectors are any two of a plane: which ones a point has says nothing of those next to it.
        """
        number = end.margin_cone
        pull = None if number is None else self.cone_pulls.get(number)
        if number is None or pull is None:
            return self
        total = float(self.pulls @ end.cones[number].sizes)
        on_tip = float(np.linalg.norm(pull)) < INSIDE * total
        turned = (
            turn(halves(begin.epsilon_slopes), halves(end.epsilon_slopes)) @ pull if on_tip else np.array([-total, 0.0])
        )
        return replace(self, cone_pulls={**self.cone_pulls, number: turned})

    def left_at(self, at: Point) -> Vector:
        """What is left of V's gradient (n,) at a point, with this step's multipliers."""
        left = self.pulls @ at.slopes - self.row_pulls @ at.row_slopes
        for number, pull in self.cone_pulls.items():
            cone = at.cones[number]
            left = left + (float(self.pulls @ cone.sizes) * cone.unit - pull) @ cone.slopes
        return left


def best_step(
    bounds: Bounds,
    least: Vector,
    here: Point,
    bend: Vector,
    distance: float,
    cones: Sequence[int],
    before: Step | None,
    *,
    coupled: bool,
) -> Step | None:
    """The step that maximises V − dᵀ bend d / 2 within a distance, the rows and what is kept; None without a solution.

    Args:
        bounds: of x and of the rows.
        least: V / size that is kept, of each objective before those that are sought.
        here: where it begins.
        bend: positive definite, (n, n).
        distance: of any entry.
        cones: numbers of those that are looked at; of all others the slopes are.
        before: a step whose multipliers are tried first.
        coupled: whether the branches of ε_max mix.
    """
    chosen: dict[int, Cone] = {}
    for number in cones:
        cone = here.cones[number]
        if number == here.margin_cone and not coupled:
            cone = replace(cone, slopes=cone.slopes * np.array([[1.0], [0.0]]))
        if cone.length > 0:
            chosen[number] = cone
    r, n = max((cone.value.size for cone in chosen.values()), default=1), here.x.size
    values, slopes, units = np.zeros((len(chosen), r)), np.zeros((len(chosen), r, n)), np.zeros((len(chosen), r))
    for i, cone in enumerate(chosen.values()):
        values[i, : cone.value.size], slopes[i, : cone.value.size] = cone.value, cone.slopes
        units[i, : cone.value.size] = cone.unit
    sizes = np.array([cone.sizes for cone in chosen.values()]).reshape(len(chosen), here.values.size)
    # What the slopes that are told have of the cones, the cones have themselves.
    trunks = here.slopes + sizes.T @ (units[:, None, :] @ slopes)[:, 0]
    # What is short by less than counts is not made up for by the model.
    wanted = np.append(least, np.full(here.sought, here.value)) - here.values
    wanted = np.minimum(wanted, 0.0) - sizes.T @ (units * values).sum(1)
    n_rows = here.rows.size
    rows = np.zeros((n_rows + wanted.size, n + 1))
    rows[:n_rows, :n], rows[n_rows:, :n], rows[-here.sought :, n] = here.row_slopes, trunks, -1.0
    weights = np.zeros((len(rows), len(chosen)))
    weights[n_rows:] = sizes.T
    limits = Bounds(
        np.maximum(bounds.x_lower - here.x, -distance),
        np.minimum(bounds.x_upper - here.x, distance),
        np.concatenate([bounds.g_lower - here.rows, wanted]),
        np.concatenate([bounds.g_upper - here.rows, np.full(wanted.size, np.inf)]),
    )
    guess = None if before is None else _guess(before, chosen, units)
    found = best_gain(bend, rows, limits, Cones(values, slopes, weights), guess)
    if found is None:
        return None
    d, pulls = found.d, np.maximum(-found.multipliers[n_rows:], 0.0)
    pulls[-here.sought :] /= pulls[-here.sought :].sum() or 1.0
    gain = found.rise - float(d @ bend @ d) / 2
    if gain < -ROUNDING * (1 + abs(here.value)) or np.abs(d).max() > BEYOND * distance:
        return None
    cone_pulls = {
        number: force[: cone.value.size] for (number, cone), force in zip(chosen.items(), found.forces, strict=True)
    }
    return Step(d, max(gain, 0.0), pulls, found.multipliers[:n_rows], cone_pulls, bend, coupled)


def _guess(before: Step, cones: dict[int, Cone], units: Vector) -> tuple[Vector, Vector]:
    """Multipliers of rows and forces of cones as in a step before; of cones that were not looked at the smooth ones."""
    forces = np.zeros(units.shape)
    for i, (number, cone) in enumerate(cones.items()):
        total = float(before.pulls @ cone.sizes)
        pull = before.cone_pulls.get(number)
        forces[i] = total * units[i]
        if pull is not None:
            forces[i, : pull.size] = pull
    return np.append(before.row_pulls, -before.pulls), forces


def halves(epsilon_slopes: Vector) -> Vector:
    """C of the cone of ε_max, (2, n), from slopes of its branches and of their coupling, (3, n)."""
    return np.vstack([(epsilon_slopes[0] - epsilon_slopes[1]) / 2, epsilon_slopes[2]])


def turn(slopes: Vector, onto: Vector) -> Vector:
    """The orthogonal (2, 2) that takes slopes C nearest to others, to undo what eigenvectors turn between points."""
    product = onto @ slopes.T
    if not np.isfinite(product).all():
        return np.eye(2)
    left, _, right = np.linalg.svd(product)
    return left @ right


@dataclass(frozen=True)
class SecondOrder:
    """Second derivatives at a point along the directions that the equations leave, the rows of `free` (d, n).

    Attributes:
        here: the point.
        free: see above.
        smooth: those of the Lagrangian without ε_max and without what the cones bend, sign changed, (d, d).
        margins: those of both branches of ε_max, (2, d, d);  turning: of the c of its cone, by the eigenvectors of
            `here`, (2, d, d).
        step: the one whose multipliers count;  cones: numbers of those that are looked at.
    """

    here: Point
    free: Vector
    smooth: Vector
    margins: Vector
    turning: Vector
    step: Step
    cones: tuple[int, ...]

    def bend(self, *, coupled: bool) -> Vector:
        """Those of the Lagrangian, sign changed, made positive, (n, n); without what coupled branches bend."""
        inner = self.smooth - self._of_margin(coupled=coupled)
        inner = (inner + inner.T) / 2
        values, vectors = np.linalg.eigh(inner)
        size = max(float(np.abs(values).max(initial=0.0)), FLAT)
        if values.size and values[0] < 0:
            # Only what bends along the tips and rows that the step keeps to says how far it leads: what is made
            # positive across them would bend it, too.
            held, along = self._held_and_along
            values, vectors = np.linalg.eigh(along @ inner @ along.T)
            values = np.append(values, np.full(len(held), size))
            vectors = np.column_stack([along.T @ vectors, held.T])
        values = np.maximum(values, FLAT * size)
        across = np.eye(self.free.shape[1]) - self.free.T @ self.free
        return self.free.T @ (vectors * values) @ vectors.T @ self.free + size * across

    @cached_property
    def _held_and_along(self) -> tuple[Vector, Vector]:
        """Orthonormal bases, along `free`, of what the step keeps to and of all else: (k, d) and (d − k, d)."""
        here, step = self.here, self.step
        rows = [here.row_slopes[np.abs(step.row_pulls) > 0]]
        for number, pull in step.cone_pulls.items():
            cone = here.cones[number]
            inside = float(np.linalg.norm(pull)) < INSIDE * float(step.pulls @ cone.sizes)
            if inside or cone.distance <= BESIDE * step.length:
                rows.append(cone.axes @ self.mixed.cones[number].slopes)
        rows.append(np.eye(here.x.size)[step.d == 0])
        stacked = np.vstack(rows)
        _, singular, directions = np.linalg.svd(stacked @ self.free.T)
        rank = int(np.sum(singular > DEPENDENT * np.linalg.norm(stacked)))
        return directions[:rank], directions[rank:]

    @cached_property
    def mixed(self) -> Point:
        """The point, with g_12 as large as the second derivatives of ε_max's branches say that it mixes them.

        Off a kink g_12 depends on how the eigenvectors are taken along, which the derivatives of the branches undo.
        """
        number = self.here.margin_cone
        if number is None:
            return self.here
        cone, (gap, coupling) = self.here.cones[number], self._apart(self.here)
        size = float(coupling @ coupling)
        if gap == 0.0 or size**2 == 0.0:
            return self.here
        seen = gap * float(coupling @ (self.margins[1] - self.margins[0]) @ coupling) / (4 * size**2)
        scale = np.array([[1.0], [np.sqrt(np.clip(seen, 0.0, 1.0))]])
        cones = list(self.here.cones)
        cones[number] = replace(cone, slopes=cone.slopes * scale)
        return replace(self.here, cones=tuple(cones))

    def stays_apart(self, d: Vector) -> bool:
        """Whether a step is too short to mix the branches of ε_max."""
        number = self.mixed.margin_cone
        if number is None:
            return True
        cone = self.mixed.cones[number]
        return 2 * abs(float(cone.slopes[1] @ d)) <= -float(cone.value[0])

    def _apart(self, at: Point) -> tuple[float, Vector]:
        """By how much the branches of ε_max differ, 0 where differences mix them, and g_12 along `free`."""
        number = at.margin_cone
        if number is None:
            return 0.0, np.zeros(len(self.free))
        cone = at.cones[number]
        gap, coupling, pull = -2 * float(cone.value[0]), self.free @ cone.slopes[1], 2 * self.free @ cone.slopes[0]
        near = gap < APART * DIFFERENCE * float(np.linalg.norm(pull) + 2 * np.linalg.norm(coupling))
        return 0.0 if near else gap, coupling

    def _of_margin(self, *, coupled: bool) -> Vector:
        """Second derivatives of what the objectives take of ε_max, (d, d); of the mean and c where branches are one."""
        number = self.here.margin_cone
        if number is None:
            return np.zeros(self.smooth.shape)
        total = float(self.step.pulls @ self.here.cones[number].sizes)
        pull = self.step.cone_pulls.get(number, np.array([-total, 0.0]))
        low, high = (total - float(pull[0])) / 2, (total + float(pull[0])) / 2
        first, second = self.margins
        gap, coupling = self._apart(self.mixed)
        if gap == 0.0:
            return total * (first + second) / 2 - np.tensordot(pull, self.turning, 1)
        if not coupled:
            return low * first + high * second
        bent = 2 * np.outer(coupling, coupling) / gap
        return low * (first + bent) + high * (second - bent)
