"""An interior method for the second-order cone programs of `cone_newton`.

Primal and dual, with the scaling of Nesterov and Todd and the predictor and corrector of Mehrotra, after
L. Vandenberghe, "The CVXOPT linear and quadratic cone program solvers" (2010).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import cast

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.selection.ascent.cone_newton import ConicPoint, ConicProgram

# Iterations at most; the share of the way to the boundary that a step goes; the error at which it ends.
ITERATIONS, SHORT, KNOWN, LOST = 60, 0.99, 1e-13, 1e3


def interior(program: ConicProgram) -> Iterator[tuple[float, float, ConicPoint]]:
    """The mean complementarity, the error of the conditions of an optimum, and the point, of each iteration.

    Variables x are v and the height h_i ≥ |c_i + C_i u| of each cone; slacks are those of rows, and [h_i, c_i + C_i u].
    """
    (m, r), k = program.values.shape, len(program.ends)
    equations = _Equations(program)
    tops = np.zeros((m, r + 1))
    tops[:, 0] = 1.0
    starts = equations.starts
    x, y, s = np.zeros(len(equations.second)), np.ones(k), np.maximum(program.ends, 1.0)
    z, t = tops, starts + tops * (1 + np.sqrt((starts**2).sum(1)))[:, None]
    best = np.inf
    for _ in range(ITERATIONS):
        off = equations.off(x, y, s, z, t)
        gap = (float(s @ y) + float((t * z).sum())) / (k + m)
        error = max(gap, float(np.abs(off).max()))
        best = min(best, error)
        if not error <= LOST * best:
            return
        yield gap, error, ConicPoint(x[: program.lines.shape[1]], y, -z[:, 1:], y > s)
        if error <= KNOWN:
            return
        if min(_sizes(t).min(initial=1.0), _sizes(z).min(initial=1.0)) <= 0:
            return
        scaling = _Scaling(t, z)
        equations.scale(s / y, scaling.squared)
        # Straight to the solution first; then with what that misses, towards the middle by as much as it fell short.
        share, products, of_rows = 1.0, np.zeros(t.shape), np.zeros(k)
        try:
            for last in (False, True):
                aims = s * y + of_rows, scaling.apply(scaling.middle + scaling.divided(products))
                dx, dy, ds, dz, dt = equations.step(off, aims[0] / y, aims[1])
                down, up = scaling.unapply(dt), scaling.apply(dz)
                share = min(_share(s, ds), _share(y, dy), scaling.share(down), scaling.share(up))
                if not last:
                    centre = gap * (1 - share) ** 3
                    of_rows, products = ds * dy - centre, _product(down, up) - centre * tops
        except np.linalg.LinAlgError:
            return
        share = min(1.0, SHORT * share)
        x, y, s, z, t = x + share * dx, y + share * dy, s + share * ds, z + share * dz, t + share * dt


class _Equations:
    """second x + cost + Gᵀ[y, z] = 0 and G x + [s, t] = [ends, starts], G of rows and of cones one below the other.

    Not brought down to x: near a solution that would lose the digits of y and z.
    """

    def __init__(self, program: ConicProgram) -> None:
        """For every step towards the solution of one program."""
        size, (m, r) = program.lines.shape[1], program.values.shape
        self.k, self.n = len(program.ends), size + m
        self.second, self.cost = np.zeros((self.n, self.n)), np.zeros(self.n)
        self.second[:size, :size], self.cost[size - 1] = program.second, -1.0
        cones, self.starts = np.zeros((m, r + 1, self.n)), np.zeros((m, r + 1))
        cones[np.arange(m), 0, size + np.arange(m)] = -1.0
        cones[:, 1:, : size - 1], self.starts[:, 1:] = -program.slopes, program.values
        lines = np.concatenate([program.lines, program.sizes], axis=1)
        self.rows = np.concatenate([lines, cones.reshape(m * (r + 1), self.n)])
        self.ends = np.concatenate([program.ends, self.starts.ravel()])
        self.at: NDArray[np.intp] = np.arange(m * (r + 1), dtype=np.intp).reshape(m, r + 1) + (self.n + self.k)
        whole = self.n + len(self.rows)
        self.matrix = np.zeros((whole, whole))
        self.matrix[: self.n, : self.n] = self.second
        self.matrix[self.n :, : self.n], self.matrix[: self.n, self.n :] = self.rows, self.rows.T

    def off(self, x: Vector, y: Vector, s: Vector, z: Vector, t: Vector) -> Vector:
        """By how much the equations do not hold."""
        dual = self.second @ x + self.cost + np.concatenate([y, z.ravel()]) @ self.rows
        return np.concatenate([dual, self.rows @ x + np.concatenate([s, t.ravel()]) - self.ends])

    def scale(self, of_rows: Vector, of_cones: Vector) -> None:
        """Take s to change by −of_rows times y's change, (k,), and t by −of_cones times z's, (m, r + 1, r + 1)."""
        rows = self.n + np.arange(self.k)
        self.matrix[rows, rows] = -of_rows
        self.matrix[self.at[:, :, None], self.at[:, None, :]] = -of_cones

    def step(self, off: Vector, of_rows: Vector, of_cones: Vector) -> tuple[Vector, Vector, Vector, Vector, Vector]:
        """Changes of x, y, s, z and t, those of s and t less by these than what changes of y and z make of them."""
        right = -off
        right[self.n :] += np.concatenate([of_rows, of_cones.ravel()])
        found = cast(Vector, np.linalg.solve(self.matrix, right))
        x, forces = found[: self.n], found[self.n :]
        slacks, shape = -off[self.n :] - self.rows @ x, of_cones.shape
        k = self.k
        return x, forces[:k], slacks[:k], forces[k:].reshape(shape), slacks[k:].reshape(shape)


class _Scaling:
    """W = η [[w_0, w_1ᵀ], [w_1, 1 + w_1 w_1ᵀ / (1 + w_0)]] of every cone with W z = W⁻¹ t = λ; w_0² − |w_1|² = 1."""

    def __init__(self, t: Vector, z: Vector) -> None:
        """Of slacks and multipliers inside the cones, (m, r + 1)."""
        self.signs = -np.ones(t.shape[1])
        self.signs[0] = 1.0
        size_t, size_z = _sizes(t), _sizes(z)
        of_t, of_z = t / size_t[:, None], z / size_z[:, None]
        half = np.sqrt((1 + (of_t * of_z).sum(1)) / 2)
        self.mean = (of_t + self.signs * of_z) / (2 * half)[:, None]
        self.size = np.sqrt(size_t / size_z)
        self.back = self.signs * self.mean
        self.middle = self.apply(z)
        self.middle_size = np.sqrt(size_t * size_z)

    def apply(self, x: Vector) -> Vector:
        """W x."""
        return self._turned(self.mean, x) * self.size[:, None]

    def unapply(self, x: Vector) -> Vector:
        """W⁻¹ x."""
        return self._turned(self.back, x) / self.size[:, None]

    @property
    def squared(self) -> Vector:
        """W² = η² (2 w wᵀ − J), J = diag(1, −1, …)."""
        whole = 2 * self.mean[:, :, None] * self.mean[:, None, :] - np.diag(self.signs)
        return whole * (self.size**2)[:, None, None]

    def divided(self, x: Vector) -> Vector:
        """The w with λ ∘ w = x."""
        first, rest = self.middle[:, 0], self.middle[:, 1:]
        out = np.empty_like(x)
        out[:, 0] = (first * x[:, 0] - (rest * x[:, 1:]).sum(1)) / self.middle_size**2
        out[:, 1:] = (x[:, 1:] - out[:, :1] * rest) / first[:, None]
        return out

    def share(self, change: Vector) -> float:
        """The largest share of a change of λ, at most 1, that stays in the cones."""
        if not change.size:
            return 1.0
        of_size = self.middle / self.middle_size[:, None]
        first = (of_size * self.signs * change).sum(1)
        rest = change[:, 1:] - ((first + change[:, 0]) / (of_size[:, 0] + 1))[:, None] * of_size[:, 1:]
        worst = float(((np.sqrt((rest**2).sum(1)) - first) / self.middle_size).max())
        return min(1.0, 1.0 / worst) if worst > 0 else 1.0

    @staticmethod
    def _turned(by: Vector, x: Vector) -> Vector:
        out = np.empty_like(x)
        out[:, 0] = (by * x).sum(1)
        part = (by[:, 1:] * x[:, 1:]).sum(1) / (1 + by[:, 0]) + x[:, 0]
        out[:, 1:] = x[:, 1:] + part[:, None] * by[:, 1:]
        return out


def _sizes(x: Vector) -> Vector:
    """√(x_0² − |x_1|²) of every cone, 0 outside."""
    rest = np.sqrt((x[:, 1:] ** 2).sum(1))
    return np.sqrt(np.maximum(x[:, 0] - rest, 0.0) * (x[:, 0] + rest))


def _product(x: Vector, y: Vector) -> Vector:
    """Products x ∘ y of every cone."""
    out = x[:, :1] * y + y[:, :1] * x
    out[:, 0] = (x * y).sum(1)
    return out


def _share(values: Vector, change: Vector) -> float:
    """The largest share of a change, at most 1, that leaves all values positive."""
    worst = float((-change / values).max(initial=0.0))
    return min(1.0, 1.0 / worst) if worst > 0 else 1.0
