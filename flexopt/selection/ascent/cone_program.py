"""The program of one step: the largest smallest of linear functions less lengths |c + C d|, less a quadratic form.

A second-order cone program. Newton's steps on the equations of what is active tell the solution to all digits, from a
guess or from where an interior method leads (`cone_interior`). Not CasADi's: its solvers take no cones, and lose the
digits where curvatures differ by 1e7.

In: matrices. Out: the solution and multipliers. Pure NumPy; knows nothing of selections.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexopt.foundation.arrays import Mask, Vector
from flexopt.selection.ascent.cone_interior import interior
from flexopt.selection.ascent.cone_newton import TOLERANCE, ConicPoint, ConicProgram, newton
from flexopt.selection.nlp.solvers import Bounds

# Singular values of equations below this share of the largest are rounding.
DEPENDENT = 1e-12
# No entry of u is larger than so many √n: d and `first` are within the bounds of d, the largest of which u is 1 at.
FARTHEST = 2.0
# The mean complementarity from which on what is active is told from an interior point, and how much it falls before
# that is tried again.
NEAR, NEARER = 1e-3, 0.01
# Newton's steps from a guess, and from an interior point.
FIRST, AFTER = 12, 6


@dataclass(frozen=True)
class Cones:
    """Lengths |values_i + slopes_i d| of i = 1 … m: rows k count them with −sizes_ki ≤ 0.

    Attributes:
        values: (m, r);  slopes: (m, r, n);  sizes: (k, m).
    """

    values: Vector
    slopes: Vector
    sizes: Vector


@dataclass(frozen=True)
class Gain:
    """The d (n,) and rise t that are best, multipliers (k,) of the rows, and the forces (m, r) of the cones.

    The Lagrangian's gradient is −bend d − rowsᵀ multipliers − Σ slopes_iᵀ forces_i; |forces_i| ≤ Λ_i, the sum of what
    the rows' multipliers, positive at upper bounds and negative at lower ones, make of sizes.
    """

    d: Vector
    rise: float
    multipliers: Vector
    forces: Vector


def best_gain(
    bend: Vector, rows: Vector, bounds: Bounds, cones: Cones | None = None, guess: tuple[Vector, Vector] | None = None
) -> Gain | None:
    """The d and t of max t − dᵀ bend d / 2 within bounds of d and of rows @ [d, t] − sizes |c + C d|.

    None where no solution is found.

    Args:
        bend: positive semidefinite, (n, n).
        rows: (k, n + 1), the last column for t, which rows bound from above.
        bounds: of d, finite and about 0, and of the rows; of those with cones only the lower ones.
        cones: see above.
        guess: multipliers and forces of a program like this one.
    """
    n = bend.shape[0]
    if cones is None:
        cones = Cones(np.zeros((0, 1)), np.zeros((0, 1, n)), np.zeros((len(rows), 0)))
    scaled = _Scaled(bend, rows, bounds, cones)
    start = _start(scaled.program) if guess is None else scaled.told(guess) or _start(scaled.program)
    # Of what contradicts itself the multipliers grow without bound.
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        found = _solved(scaled.program, start)
    return None if found is None else scaled.undone(found)


class _Scaled:
    """The program in [u, τ], all of order one: d = first + ahead u, t = gain τ; cones by how far they move.

    Equations and fixed entries are left out of it, and rows that nothing within the bounds of d reaches.
    """

    def __init__(self, bend: Vector, rows: Vector, bounds: Bounds, cones: Cones) -> None:
        """Of what `best_gain` is asked for."""
        self.bend, self.rows, self.cones, n = bend, rows, cones, bend.shape[0]
        equal, fixed = bounds.g_lower >= bounds.g_upper, bounds.x_lower >= bounds.x_upper
        self.equal = np.flatnonzero(equal)
        identity = np.eye(n)
        equations = np.concatenate([rows[equal, :n], identity[fixed]])
        self.first, free, self.inverse = np.zeros(n), identity, np.zeros((n, 0))
        if len(equations):
            left, singular, directions = np.linalg.svd(equations)
            rank = int(np.sum(singular > DEPENDENT * singular[0]))
            self.inverse = (directions[:rank].T / singular[:rank]) @ left[:, :rank].T
            self.first = self.inverse @ np.concatenate([bounds.g_lower[equal], bounds.x_lower[fixed]])
            free = directions[rank:]
        room = np.maximum(-bounds.x_lower, bounds.x_upper)
        self.ahead = (float(room.max(initial=0.0)) or 1.0) * free.T
        slopes = cones.slopes @ self.ahead
        self.spans = np.sqrt((slopes**2).sum((1, 2)))
        self.spans[self.spans == 0] = 1.0
        sought, lines, sizes = rows[:, n] != 0, rows[:, :n] @ self.ahead, cones.sizes * self.spans
        reached = np.sqrt((lines[sought] ** 2).sum(1)) + sizes[sought].sum(1)
        self.gain = float(reached.max(initial=0.0)) or 1.0
        always = sought | cones.sizes.any(1)
        sides, ends = self._sides(bounds, np.column_stack([lines, self.gain * rows[:, n]]), always, equal, fixed)
        # Of the lower sides those of rows come before those of d.
        weights = np.zeros((len(sides), len(sizes.T)))
        lower = self.below[self.below < len(rows)]
        weights[len(self.above) : len(self.above) + len(lower)] = sizes[lower]
        self.lengths = np.sqrt((sides**2).sum(1)) + weights.sum(1)
        self.lengths[self.lengths == 0] = 1.0
        second = np.zeros((sides.shape[1], sides.shape[1]))
        second[:-1, :-1] = self.ahead.T @ bend @ self.ahead / self.gain
        self.program = ConicProgram(
            second,
            sides / self.lengths[:, None],
            ends / self.lengths,
            weights / self.lengths[:, None],
            (cones.values + cones.slopes @ self.first) / self.spans[:, None],
            slopes / self.spans[:, None, None],
        )

    def _sides(self, bounds: Bounds, lines: Vector, always: Mask, equal: Mask, fixed: Mask) -> tuple[Vector, Vector]:
        """Of rows and then of d what is bounded from above, and by what; upper sides first.

        What equations hold is moved by rounding alone, which must not be scaled up: it is not reached.
        """
        n = len(self.first)
        every = np.concatenate([lines, np.column_stack([self.ahead, np.zeros(n)])])
        moved = np.concatenate([self.rows[:, :n] @ self.first, self.first])
        low, high = np.concatenate([bounds.g_lower, bounds.x_lower]), np.concatenate([bounds.g_upper, bounds.x_upper])
        reach = FARTHEST * np.sqrt(n) * np.linalg.norm(every, axis=1)
        reach[: len(always)][always] = np.inf
        limited = ~np.concatenate([equal, fixed])
        self.above = np.flatnonzero(limited & np.isfinite(high) & (high - moved <= reach))
        self.below = np.flatnonzero(limited & np.isfinite(low) & (moved - low <= reach))
        ends = np.concatenate([(high - moved)[self.above], (moved - low)[self.below]])
        return np.concatenate([every[self.above], -every[self.below]]), ends

    def told(self, guess: tuple[Vector, Vector]) -> ConicPoint | None:
        """Multipliers and forces as a state; none where nothing pulls at t."""
        multipliers = np.append(guess[0], np.zeros(len(self.first)))
        told = np.concatenate([multipliers[self.above], -multipliers[self.below]])
        pulls: Vector = np.maximum(told, 0.0) * self.lengths / self.gain
        if not np.any(pulls * self.program.lines[:, -1] > 0):
            return None
        forces = guess[1] * (self.spans / self.gain)[:, None]
        return ConicPoint(np.zeros(len(self.program.second)), pulls, forces, pulls > 0)

    def undone(self, found: ConicPoint) -> Gain:
        """A solution in d and t, with the multipliers of equations too."""
        d: Vector = self.first + self.ahead @ found.v[:-1]
        pulls, k, n = found.pulls * self.gain / self.lengths, len(self.rows), d.size
        multipliers = np.zeros(k + n)
        multipliers[self.above] += pulls[: len(self.above)]
        multipliers[self.below] -= pulls[len(self.above) :]
        forces = found.forces * (self.gain / self.spans)[:, None]
        if len(self.equal):
            left = self.bend @ d + multipliers[:k] @ self.rows[:, :n] + multipliers[k:]
            left = left + (forces[:, :, None] * self.cones.slopes).sum((0, 1))
            multipliers[self.equal] = -(left @ self.inverse)[: len(self.equal)]
        return Gain(d, self.gain * float(found.v[-1]), multipliers[:k], forces)


def _start(program: ConicProgram) -> ConicPoint:
    """A first guess: most often one row bounds t, the one that is lowest at first, and no other matters."""
    v = np.zeros(program.lines.shape[1])
    after, lengths = program.lengths(v[:-1])
    slack = program.ends - program.sizes @ lengths
    bounding = np.flatnonzero(program.lines[:, -1] > 0)
    lowest = int(bounding[np.argmin(slack[bounding] / program.lines[bounding, -1])])
    active = np.arange(slack.size) == lowest
    pulls = active / program.lines[lowest, -1]
    forces = after * ((pulls @ program.sizes) / np.where(lengths > 0, lengths, 1.0))[:, None]
    return ConicPoint(v, pulls, forces, active)


def _solved(program: ConicProgram, start: ConicPoint) -> ConicPoint | None:
    """By Newton's steps from a guess; else from interior points; else the interior point itself, where it is exact."""
    found = newton(program, start, FIRST)
    if found is not None:
        return found
    best, least, tried = None, TOLERANCE, NEAR
    for gap, error, state in interior(program):
        if gap < tried:
            tried = NEARER * gap
            found = newton(program, state, AFTER)
            if found is not None:
                return found
        if error <= least:
            best, least = state, error
    return best
