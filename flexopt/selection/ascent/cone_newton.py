"""Newton's steps on the equations of what is active in a second-order cone program.

min vᵀ second v / 2 − v_last with lines @ v + sizes |values_i + slopes_i u| ≤ ends, v = [u, τ]. In: the program, and a
guess of what is active. Out: the solution with its multipliers to all digits, or none.

Of a cone z = c + C u with the force p and Λ, the sum of what the multipliers of rows make of its sizes, an optimum has
p = Π(p + ρ z), the nearest within |p| ≤ Λ: at |p + ρ z| ≤ Λ the tip, z = 0, where p is free; else p along p + ρ z.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np

from flexopt.foundation.arrays import Mask, Vector

# How far a solution may break rows, or have multipliers of the wrong sign: of a problem whose gradient and box are of
# order one. Singular values of a cone's slopes below this share of the largest are rounding.
TOLERANCE, DEPENDENT = 1e-10, 1e-9
# Forces below which their digits are not all known; lengths below which there is no direction.
SMALL, TINY = 1e-6, 1e-300


@dataclass(frozen=True)
class ConicProgram:
    """The program with k rows and m cones.

    Attributes:
        second: positive semidefinite, (n + 1, n + 1);  lines, ends: (k, n + 1) and (k,), lines of order one.
        sizes: ≥ 0, (k, m);  values, slopes: of the cones, (m, r) and (m, r, n), slopes of order one.
    """

    second: Vector
    lines: Vector
    ends: Vector
    sizes: Vector
    values: Vector
    slopes: Vector

    @cached_property
    def axes(self) -> tuple[Vector, Mask, Mask]:
        """Of every cone unit vectors (m, r, r), which of them C reaches, (m, r); and whether it has a tip, (m,)."""
        left, singular, _ = np.linalg.svd(self.slopes)
        reached = np.zeros(self.values.shape, dtype=np.bool_)
        reached[:, : singular.shape[1]] = singular > DEPENDENT * singular[:, :1]
        beside = (left.transpose(0, 2, 1) @ self.values[:, :, None])[:, :, 0] * ~reached
        return left, reached, (beside**2).sum(1) <= TOLERANCE**2

    def lengths(self, u: Vector) -> tuple[Vector, Vector]:
        """What cones are at u, c + C u, (m, r), and how long that is, (m,)."""
        after: Vector = self.values + self.slopes @ u
        return after, np.sqrt((after**2).sum(1))

    def pulled(self, forces: Vector) -> Vector:
        """Σ Cᵀp, (n,)."""
        return forces.ravel() @ self.slopes.reshape(forces.size, self.slopes.shape[2])


@dataclass(frozen=True)
class ConicPoint:
    """A point v with multipliers (k,) of the rows, forces (m, r) of the cones, and which rows are active."""

    v: Vector
    pulls: Vector
    forces: Vector
    active: Mask


def newton(program: ConicProgram, state: ConicPoint, steps: int) -> ConicPoint | None:
    """The solution that Newton's steps lead to, if they do."""
    v, pulls, forces, active = state.v, state.pulls, state.forces, state.active
    for _ in range(steps):
        found = _step(program, ConicPoint(v, pulls, forces, active))
        v, pulls, forces = found.v, found.pulls, found.forces
        if not np.isfinite(v.sum() + pulls.sum() + forces.sum()):
            return None
        after, lengths = program.lengths(v[:-1])
        beyond = program.lines @ v + program.sizes @ lengths - program.ends
        better = np.where(active, pulls >= -TOLERANCE, beyond > TOLERANCE)
        if (better == active).all() and _solves(program, found, after, beyond):
            return ConicPoint(v, np.maximum(pulls, 0.0), forces, active)
        active = better
        pulls = np.where(active, np.maximum(pulls, 0.0), 0.0)
    return None


def _solves(program: ConicProgram, found: ConicPoint, after: Vector, beyond: Vector) -> bool:
    """Whether a point is the solution; that inactive rows hold, and active ones pull, is known."""
    if float(np.abs(beyond[found.active]).max(initial=0.0)) > TOLERANCE:
        return False
    left = program.second @ found.v + found.pulls @ program.lines
    left[-1] -= 1.0
    if len(after):
        total = found.pulls @ program.sizes
        scale = np.maximum(total, SMALL)
        aim = found.forces / scale[:, None] + after
        wrong = found.forces / scale[:, None] - _nearest(aim, total / scale)
        if float(np.abs(wrong).max()) > TOLERANCE:
            return False
        left[:-1] += program.pulled(found.forces)
    return float(np.abs(left).max()) <= TOLERANCE


def _nearest(x: Vector, radii: Vector) -> Vector:
    """The nearest to rows of x within balls."""
    return x * (radii / np.maximum(np.sqrt((x**2).sum(1)), np.maximum(radii, TINY)))[:, None]


def _step(program: ConicProgram, state: ConicPoint) -> ConicPoint:
    """Where a step leads, the rows of `state.active` active."""
    at, size = state.active, program.lines.shape[1]
    lines, ends = program.lines[at], program.ends[at]
    n_rows = len(ends)
    unit, across, chosen, give = _directions(program, state)
    root = np.sqrt(1 - give)
    if len(unit):
        sizes = program.sizes[at]
        lines[:, :-1] += sizes @ (unit[:, None, :] @ program.slopes)[:, 0]
        # A force w across the unit, w = stiff (what is across of c + C u), is a variable as w / root.
        turned = across.transpose(0, 2, 1)
        level = root[:, None] * (turned @ program.slopes)[chosen]
        heights = root * (turned @ program.values[:, :, None])[:, :, 0][chosen]
        lines = np.concatenate([lines, np.column_stack([level, np.zeros(len(level))])])
        ends = np.concatenate([ends - sizes @ (unit * program.values).sum(1), -heights])
    n = size + len(ends)
    matrix, right = np.zeros((n, n)), np.zeros(n)
    matrix[:size, :size], matrix[size:, :size], matrix[:size, size:] = program.second, lines, lines.T
    right[size - 1], right[size:] = 1.0, ends
    matrix.ravel()[(size + n_rows) * (n + 1) :: n + 1] = -give
    x = _solution(matrix, right)
    pulls = np.zeros(at.size)
    pulls[at] = x[size : size + n_rows]
    forces = state.forces
    if len(unit):
        beside = np.zeros(chosen.shape)
        beside[chosen] = x[size + n_rows :] * root
        forces = (pulls @ program.sizes)[:, None] * unit + (across @ beside[:, :, None])[:, :, 0]
    return ConicPoint(x[:size], pulls, forces, at)


def _directions(program: ConicProgram, state: ConicPoint) -> tuple[Vector, Vector, Mask, Vector]:
    """Of every cone the unit (m, r) along which it pulls, 0 at a tip; unit vectors (m, r, r) and which are across it.

    And of these 1 / (1 + stiffness).
    """
    m, r = program.values.shape
    if not m:
        return state.forces, np.zeros((0, r, r)), np.zeros((0, r), dtype=np.bool_), np.zeros(0)
    total = state.pulls @ program.sizes
    after, lengths = program.lengths(state.v[:-1])
    aim = state.forces + total[:, None] * after
    aimed = np.sqrt((aim**2).sum(1))
    within = aimed <= total * (1 + 1e-14)
    axes, reached, has_tip = program.axes
    tip = within & has_tip & (total > 0)
    unit = np.where(within[:, None], after, aim) / np.maximum(np.where(within, lengths, aimed), TINY)[:, None]
    unit[tip] = 0.0
    # Λ / stiffness: of Π(p + Λ z); of what has no tip but is taken to be there, of its own length.
    short: Vector = np.where(within, lengths, (aimed - total) / np.maximum(total, TINY))
    give: Vector = np.where(total > 0, np.where(tip, 0.0, short) / (total + short), 1.0)
    # Reflections that take the first axis to the unit: the others are across it.
    mirror = unit.copy()
    mirror[:, 0] += np.where(unit[:, 0] < 0, -1.0, 1.0)
    flip = np.eye(r) - mirror[:, :, None] * (mirror / (1 + np.abs(unit[:, :1])))[:, None, :]
    others: Mask = np.arange(int(r)) > 0
    chosen = np.where(tip[:, None], reached, others)
    return unit, np.where(tip[:, None, None], axes, flip), chosen, np.repeat(give, r)[chosen.ravel()]


def _solution(matrix: Vector, right: Vector) -> Vector:
    """Of linear equations; the shortest that fits best where they are dependent; NaN where there is none."""
    try:
        found = cast(Vector, np.linalg.solve(matrix, right))
        if float(np.abs(matrix @ found - right).max(initial=0.0)) <= TOLERANCE / 10:
            return found
    except np.linalg.LinAlgError:
        pass
    try:
        return cast(Vector, np.linalg.lstsq(matrix, right, rcond=1e-15)[0])
    except np.linalg.LinAlgError:
        return np.full(right.size, np.nan)
