"""One of the configurations that an ascent moves: its objectives and rows, with slopes and second derivatives.

In: its Functions, and which entries of x are its z. Out: numbers at x; slopes are by these entries.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.selection.cones import Parallel, smooth_slope, split_factors
from flexopt.selection.nlp.assembly import Branched
from flexopt.selection.nlp.coupling import widened

# Step of the differences of what the cones leave of w_i, in scaled variables.
BESIDE = 1e-5


@dataclass(frozen=True)
class ConfigurationPoint:
    """A configuration at x.

    Attributes:
        rows, row_slopes: (k,) and (k, n_z).
        values, slopes: V / size of the objectives, of ε_max the lower branch, (j,) and (j, n_z).
        gap: by how much the branches of ε_max differ;  epsilon_slopes: theirs and of their coupling, (3 or 0, n_z).
        alphas: ∂V/∂w / size of the objectives, (j, m).
    """

    rows: Vector
    row_slopes: Vector
    values: Vector
    slopes: Vector
    gap: float
    epsilon_slopes: Vector
    alphas: Vector


@dataclass(frozen=True)
class AscentMember:
    """A configuration of an ascent.

    Attributes:
        functions: from `build_branched`;  place: which entries of x its z is, (n_z,).
        parameters: those of its solver.
        alphas: of each objective, those that are sought last, α / size, (j, m).
        without: numbers of modes -> the parameters with these left out of second derivatives.
        kinks: of each objective β / size, 0 where ε_max takes no part, (j,).
        margin: x -> slopes of ε_max's branches, and of their coupling, (3, n_z).
        parallel: further rows, after those of the functions.
    """

    functions: Branched
    place: tuple[int, ...]
    parameters: Vector
    alphas: Vector
    without: Callable[[list[int]], Vector]
    kinks: Vector
    margin: Callable[[Vector], Vector]
    parallel: Parallel | None = None

    @cached_property
    def n_rows(self) -> int:
        """How many rows it has."""
        return self.functions.rows.size1_out(0) + (0 if self.parallel is None else self.parallel.upper.size)

    def at(self, x: Vector) -> ConfigurationPoint:
        """The configuration at x."""
        last, g, last_x, g_x, epsilon_x = self._called(self.functions.model, x)
        n_rows, gap = self.functions.rows.size1_out(0), 0.0
        values, slopes = np.concatenate([g, last]).ravel(), np.vstack([g_x, last_x])
        lowest, first = list[int](), n_rows
        for kink in self.kinks:
            lowest.append(first)
            gap = float(values[first + 1] - values[first]) / kink if kink else gap
            first += 2 if kink else 1
        rows, row_slopes = values[:n_rows], slopes[:n_rows]
        if self.parallel is not None:
            f, f_z, _ = self.factors(x)
            rows = np.append(rows, self.parallel.values(f))
            row_slopes = np.vstack([row_slopes, self.parallel.slopes(f, f_z)])
        return ConfigurationPoint(rows, row_slopes, values[lowest], slopes[lowest], gap, epsilon_x, self._pulls(x))

    def rows(self, x: Vector) -> tuple[Vector, Vector]:
        """All rows at x, and their slopes."""
        rows, slopes = self._called(self.functions.rows, x)
        if self.parallel is None:
            return rows.ravel(), slopes
        f, f_z, _ = self.factors(x)
        return np.append(rows, self.parallel.values(f)), np.vstack([slopes, self.parallel.slopes(f, f_z)])

    def factors(self, x: Vector) -> tuple[Vector, Vector, Vector]:
        """As `split_factors`, and of every mode how many have its frequency."""
        f, f_z, same = self._called(self.functions.factors, x)
        return *split_factors(f, f_z), same.sum(axis=0)

    def bend(
        self, x: Vector, basis: Vector, pulls: Vector, row_pulls: Vector, held: Mapping[int, tuple[float, Vector]]
    ) -> Vector:
        """Second derivatives of Σ row_pulls_i row_i − Σ pulls_j V_j along a basis (d, n_z), (d, d), without ε_max.

        `held`, as in `smooth_slope`: of the modes whose cones are looked at only what is smooth counts.
        """
        own = self.functions.rows.size1_out(0)
        parameters = self.without([number // 2 for number in held]) if held else self.parameters
        given = [x[list(self.place)], parameters, -pulls, row_pulls[:own]]
        total = basis @ self.functions.curvature.call(given)[0].full() @ basis.T
        parallel = self.parallel
        if parallel is not None:
            of_parallel = row_pulls[own:]
            total = total + self._bend_of(lambda f, f_z: of_parallel @ parallel.slopes(f, f_z), x, basis)
        if held:
            total = total - self._bend_of(lambda f, f_z: smooth_slope(f, f_z, held), x, basis)
        return total

    def _bend_of(self, slope: Callable[[Vector, Vector], Vector], x: Vector, basis: Vector) -> Vector:
        """Second derivatives along a basis, (d, d), of what has a slope (n_z,) that a_i and b_i and theirs tell."""
        ways = widened(BESIDE * basis, self.place, x.size)
        beside = [slope(*self.factors(x + way)[:2]) - slope(*self.factors(x - way)[:2]) for way in ways]
        change = np.array(beside).reshape(basis.shape) @ basis.T / (2 * BESIDE)
        return (change + change.T) / 2

    def _pulls(self, x: Vector) -> Vector:
        """∂V/∂w / size of each objective, (j, m): α, and what own objectives add at x."""
        return self.alphas if self.functions.pulls is None else self._called(self.functions.pulls, x)[0]

    def _called(self, function: ca.Function, x: Vector) -> list[Vector]:
        return [out.full() for out in function.call([x[list(self.place)], self.parameters])]
