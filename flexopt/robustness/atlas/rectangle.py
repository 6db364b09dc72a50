"""A rectangle of two coordinates, which may close on themselves, and functions on it measured in cells of a grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector

Whole = NDArray[np.int64]
ValuesAndSlopes = tuple[Vector, Vector]
# Points (2, N) -> values (k, N) and slopes (k, 2, N); not finite where there are none.
Fields = Callable[[Vector], ValuesAndSlopes]

# Lines stand this share of a cell off the round numbers at which machines are singular or symmetric.
SHIFT = 0.381966
# Off the edge of a rectangle, in cells, where functions have no value there.
INSET = 1e-8
# Values that are nothing, relative to the largest of their function.
NOISE = 1e-14


@dataclass(frozen=True)
class Rectangle:
    """Where curves are looked for: corners (2,), and in which coordinates it closes on itself."""

    low: Vector
    high: Vector
    periodic: tuple[bool, bool]

    def wrapped(self, points: Vector) -> Vector:
        """Points (2, N) inside it, whole periods away."""
        low, size = self.low[:, None], (self.high - self.low)[:, None]
        turned = low + np.mod(points - low, size)
        return np.where(np.array(self.periodic)[:, None], np.where(turned >= low + size, low, turned), points)

    def steps(self, points: Vector) -> Vector:
        """From each point (2, N) to the next, the short way round, (2, N − 1)."""
        return self.nearest(np.diff(points, axis=1))

    def nearest(self, differences: Vector) -> Vector:
        """Differences (2, N) the short way round."""
        size = (self.high - self.low)[:, None]
        return np.where(
            np.array(self.periodic)[:, None], differences - size * np.round(differences / size), differences
        )


class CellFields:
    """The fields in coordinates in which the cells are one wide and the rectangle begins at 0."""

    def __init__(self, fields: Fields, rectangle: Rectangle, cells: tuple[int, int]) -> None:
        self.fields, self.rectangle, self.cells = fields, rectangle, np.array(cells, dtype=float)
        self.size = (rectangle.high - rectangle.low) / self.cells

    def outwards(self, x: Vector) -> Vector:
        """Points (2, N) of the rectangle."""
        return self.rectangle.low[:, None] + x * self.size[:, None]

    def inwards(self, z: Vector) -> Vector:
        """And back."""
        return (z - self.rectangle.low[:, None]) / self.size[:, None]

    def __call__(self, x: Vector) -> ValuesAndSlopes:
        """Values (k, N) and slopes (k, 2, N)."""
        values, slopes = self.fields(self.outwards(x))
        return values, slopes * self.size[:, None]

    def one(self, x: Vector, function: Whole) -> ValuesAndSlopes:
        """Value (N,) and slope (2, N) of one function for each point."""
        if not x.shape[1]:
            return np.zeros(0), np.zeros((2, 0))
        values, slopes = self(x)
        number: Whole = np.arange(x.shape[1], dtype=np.int64)
        return values[function, number], slopes[function, :, number].T

    def lines(self) -> ValuesAndSlopes:
        """Where the lines of the grid stand along each coordinate."""
        both: list[Vector] = []
        for periodic, count in zip(self.rectangle.periodic, self.cells, strict=True):
            inner = [k + SHIFT for k in range(int(count))]
            both.append(np.array([*inner, inner[0] + count] if periodic else [0.0, *inner, count]))
        return both[0], both[1]

    def at_nodes(self, lines: ValuesAndSlopes) -> Vector:
        """Values (k, n_u, n_v)."""
        # Where an edge of the rectangle has no values, as at a singular posture, they come from beside it.
        beside = [np.clip(line, INSET, count - INSET) for line, count in zip(lines, self.cells, strict=True)]
        used = [
            line if periodic else inner
            for line, inner, periodic in zip(lines, beside, self.rectangle.periodic, strict=True)
        ]
        u, v = np.meshgrid(*used, indexing="ij")
        values = self(np.stack([u.ravel(), v.ravel()]))[0]
        size = np.where(np.isfinite(values), np.abs(values), 0.0)
        # Of a function that is zero over a whole region signs are rounding.
        nothing = size <= NOISE * size.max(axis=1, keepdims=True)
        return np.where(nothing, np.nan, values).reshape(-1, *u.shape)
