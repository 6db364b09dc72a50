"""Where w_i = a_i·b_i − |a_i||b_i| has kinks, and where it is 0: from a_i and b_i with their slopes.

−|a_i||b_i| is a cone about a_i = 0 and about b_i = 0. Out: cones of objectives; what is left of w_i that is smooth at a
tip; and the equations of a_i parallel to b_i, or of one that stays 0, which make w_i = 0 a surface.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.selection.ascent.model import Cone

# Lengths below which there is no direction.
TINY = 1e-300
SIDES = "ab"
# Modes whose frequency fewer have stand alone: w_i of others is no product of two lengths.
SHARED = 1.5
# Cosines: to which a_i and b_i may turn in a chart of a surface, and from which on another chart is made.
TURNED, STRAIGHT = 0.3, 0.5
# A step, in scaled variables: lengths are taken to be no less than what it changes them by.
NEAR = 1e-2


def split_factors(f: Vector, slopes: Vector) -> tuple[Vector, Vector]:
    """F = [a_i; b_i] (2r, m) and slopes of its columns (2r m, n), as (m, 2, r) and (m, 2, r, n): a first, then b."""
    m = f.shape[1]
    return f.T.reshape(m, 2, -1), slopes.reshape(m, 2, -1, slopes.shape[1])


def mode_cones(f: Vector, slopes: Vector, alphas: Vector) -> list[Cone]:
    """Of every mode the cone of a_i, −α_i |b_i| |a_i|, and that of b_i; none with a single task row.

    Args:
        f, slopes: from `split_factors`.
        alphas: α of every objective, (j, m).
    """
    if f.shape[2] < 2:
        return []
    lengths = np.linalg.norm(f, axis=2)
    # As the graphs of w_i have it.
    units = f / np.sqrt(lengths**2 + TINY)[:, :, None]
    return [
        Cone(f[i, side], slopes[i, side], alpha * lengths[i, 1 - side], units[i, side])
        for i, alpha in enumerate(alphas.T)
        for side in range(2)
    ]


def name_of(number: int) -> str:
    """What is zero at the tip of the cone of this number in `mode_cones`."""
    return f"{SIDES[number % 2]}{number // 2 + 1} = 0"


def smooth_slope(f: Vector, slopes: Vector, held: Mapping[int, tuple[float, Vector]]) -> Vector:
    """The slope (n,) of Σ α (c·o − |o| ν·c) over some cones: w_i with the direction of its kink held.

    Args:
        f, slopes: from `split_factors`.
        held: by number of the cone α, and α ν (r,); c is what is zero at its tip, o the other one.
    """
    total = np.zeros(slopes.shape[-1])
    for number, (alpha, pull) in held.items():
        i, side = divmod(number, 2)
        tip, other = f[i, side], f[i, 1 - side]
        length = float(np.linalg.norm(other))
        total = total + (alpha * other - length * pull) @ slopes[i, side]
        total = total + (alpha * tip - (float(pull @ tip) / max(length, TINY)) * other) @ slopes[i, 1 - side]
    return total


def farther(f: Vector, slopes: Vector) -> int:
    """Which of a_i and b_i, 0 or 1, is farther from 0 as steps go; f (2, r) and slopes (2, r, n) are of one mode."""
    return int(np.argmax(np.linalg.norm(f, axis=1) / np.maximum(np.linalg.norm(slopes, 2, axis=(1, 2)), TINY)))


@dataclass(frozen=True)
class Parallel:
    """a_i parallel to b_i, for some modes: ((û·a)(e_k·b) − (e_k·a)(û·b)) / (α β) = 0, û·c ≥ TURNED |c|, c = a, b.

    w_i is a maximum there, so that its own slope tells nothing of the surface w_i = 0; the slopes of these do. û is the
    direction of a_i or b_i at the point x₀ that the chart is made at, of the one that is farther from 0: where the
    other is 0 the surface has an edge. e_k (r − 1,) are unit vectors across it: all r would depend on each other. The
    inequalities keep out what else the equations allow, a_i against b_i and both across û.

    Where the other one, c, stays 0 along fewer than r equations, these are the chart: e_k·c / γ = 0. They are no edge,
    but a surface that has the rest on both its sides, a_i along b_i on one of them and against it on the other.

    Attributes:
        modes: numbers i.
        sides: of each 0 where û is of a_i, 1 where it is of b_i.
        axes: [û; e_1; …] of each, (r, r), or the e_k alone, (k, r).
        lengths: α, β of each: |a₀| and |b₀|, or what they change by in a step NEAR.
        resting: of each whether it is a chart of c = 0.
    """

    modes: tuple[int, ...]
    sides: tuple[int, ...]
    axes: tuple[Vector, ...]
    lengths: tuple[tuple[float, float], ...]
    resting: tuple[bool, ...]

    @staticmethod
    def at(f: Vector, slopes: Vector, modes: tuple[int, ...], resting: Mapping[int, Vector] | None = None) -> Parallel:
        """The chart at a point; f and slopes, by scaled variables, are from `split_factors`.

        `resting`: by mode the e_k (k, r) of what stays 0.
        """
        zero = resting or {}
        sides, axes, lengths = list[int](), list[Vector](), list[tuple[float, float]]()
        for i in modes:
            size, reach = np.linalg.norm(f[i], axis=1), np.linalg.norm(slopes[i], 2, axis=(1, 2))
            side = farther(f[i], slopes[i])
            _, _, across = np.linalg.svd(f[i, side][None, :])
            sides.append(side)
            axes.append(zero[i] if i in zero else np.vstack([f[i, side] / size[side], across[1:]]))
            alpha, beta = np.maximum(size, NEAR * reach).tolist()
            lengths.append((alpha, beta))
        return Parallel(modes, tuple(sides), tuple(axes), tuple(lengths), tuple(i in zero for i in modes))

    @property
    def equations(self) -> int:
        """How many of the rows are equations; these come first."""
        return sum(len(axes) - (not resting) for axes, resting in zip(self.axes, self.resting, strict=True))

    @property
    def upper(self) -> Vector:
        """Upper bounds of the rows; the lower ones are 0."""
        return np.append(np.zeros(self.equations), np.full(2 * self.resting.count(False), np.inf))

    def values(self, f: Vector) -> Vector:
        """The rows; f is from `split_factors`."""
        equations, sides = list[Vector](), list[float]()
        for i, side, axes, lengths, resting in self._modes():
            if resting:
                equations.append(axes @ f[i, 1 - side] / lengths[1 - side])
                continue
            a, b = axes @ f[i, 0], axes @ f[i, 1]
            equations.append((a[0] * b[1:] - a[1:] * b[0]) / (lengths[0] * lengths[1]))
            for c, size in zip((a, b), lengths, strict=True):
                sides.append((c[0] - TURNED * float(np.linalg.norm(c))) / size)
        return np.concatenate([*equations, sides])

    def slopes(self, f: Vector, slopes: Vector) -> Vector:
        """Their slopes by x, (rows, n)."""
        equations, sides = list[Vector](), list[Vector]()
        for i, side, axes, lengths, resting in self._modes():
            if resting:
                equations.append(axes @ slopes[i, 1 - side] / lengths[1 - side])
                continue
            (a, b), (a_x, b_x) = (axes @ f[i, side] for side in range(2)), (axes @ slopes[i, side] for side in range(2))
            rows = np.outer(b[1:], a_x[0]) + a[0] * b_x[1:] - b[0] * a_x[1:] - np.outer(a[1:], b_x[0])
            equations.append(rows / (lengths[0] * lengths[1]))
            for c, c_x, size in zip((a, b), (a_x, b_x), lengths, strict=True):
                sides.append((c_x[0] - TURNED * c @ c_x / max(float(np.linalg.norm(c)), TINY)) / size)
        return np.vstack([*equations, *sides])

    def fits(self, f: Vector) -> bool:
        """Whether the chart is still good: û's vector has kept its direction, far from where it must not leave it."""
        return all(
            resting or float(axes[0] @ f[i, side]) > STRAIGHT * float(np.linalg.norm(f[i, side]))
            for i, side, axes, _, resting in self._modes()
        )

    def _modes(self) -> Iterator[tuple[int, int, Vector, tuple[float, float], bool]]:
        return zip(self.modes, self.sides, self.axes, self.lengths, self.resting, strict=True)
