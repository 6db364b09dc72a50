"""Curves on which smooth functions of two coordinates vanish, all of them in a rectangle, and points where two vanish.

In: functions with exact slopes, a rectangle, and a number of cells. Out: curves as points in order along them.

A curve is known where it crosses a line of the grid between two nodes of different sign. From each crossing it is
continued through the cell beside it, predictor along the tangent, corrector by Newton's method across it, until it
leaves the cell: at a crossing known by then, or at a new one. So all curves advance at once, close where they return,
and join as they run and not as a grid sees them. A loop inside a cell has an extremum of the function inside: where the
least of its size among nodes beside each other has another sign nearby, lines are added through that point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexopt.foundation.arrays import Mask, Vector
from flexopt.robustness.atlas.rectangle import INSET, CellFields, Fields, Rectangle, ValuesAndSlopes, Whole
from flexopt.robustness.atlas.tracing import CONVERGED, CORRECTIONS, ROUNDING, SAME, STEP, Tracing, ZeroCurve

NEWTON_MAX = 40
NEAR = 1e-6
# In cells: how far chords of a curve may be from it. Points of pieces that may repeat a part of another curve.
CHORD, REPEATED = 0.03, 40
# In cells: between lines of the grid, so that crossings with two of them are told apart.
LEAST_CELL = 10 * SAME
# Rounds of added lines.
ROUNDS = 3


@dataclass(frozen=True)
class Nodes:
    """The functions on the grid.

    Attributes:
        lines: where the lines stand along both coordinates; of a periodic one the last is the first, a period on.
        values: (k, n_u, n_v) at all nodes.
    """

    lines: ValuesAndSlopes
    values: Vector


def zero_curves(
    fields: Fields, rectangle: Rectangle, cells: tuple[int, int], functions: int
) -> tuple[list[ZeroCurve], Nodes]:
    """The curves on which the first `functions` of the fields vanish, and the values at the nodes."""
    scaled = CellFields(fields, rectangle, cells)
    lines = scaled.lines()
    values = scaled.at_nodes(lines)
    for _ in range(ROUNDS):
        hidden = _hidden(scaled, lines, values, functions)
        if not hidden.shape[1]:
            break
        lines = _with_more(lines[0], hidden[0]), _with_more(lines[1], hidden[1])
        values = scaled.at_nodes(lines)
    curves = _without_repeats(Tracing(scaled, lines, values, functions).curves(), rectangle, scaled.size)
    u, v = (low + line * size for low, line, size in zip(rectangle.low, lines, scaled.size, strict=True))
    return curves, Nodes((u, v), values)


def _with_more(lines: Vector, more: Vector) -> Vector:
    """Lines in order, and those of some more that are not so near to another that crossings with both are the same."""
    for line in more:
        if np.abs(lines - line).min() > LEAST_CELL:
            lines = np.sort(np.append(lines, line))
    return lines


def _without_repeats(curves: list[ZeroCurve], rectangle: Rectangle, cell: Vector) -> list[ZeroCurve]:
    """Without pieces that begin and end on another curve: where one touches a line, a step may pass over it or not."""

    def repeats(piece: ZeroCurve, other: ZeroCurve) -> bool:
        if other is piece or other.function != piece.function or other.points.shape[1] <= piece.points.shape[1]:
            return False
        way = rectangle.steps(other.points) / cell[:, None]
        for point in piece.points.T:
            gone = rectangle.nearest(point[:, None] - other.points[:, :-1]) / cell[:, None]
            share = np.clip(np.sum(gone * way, axis=0) / np.maximum(np.sum(way**2, axis=0), 1e-300), 0.0, 1.0)
            if np.linalg.norm(gone - share * way, axis=0).min() > CHORD:
                return False
        return True

    lost = [curve for curve in curves if curve.ends == ("lost", "lost") and curve.points.shape[1] <= REPEATED]
    again = [id(piece) for piece in lost if any(repeats(piece, other) for other in curves)]
    return [curve for curve in curves if id(curve) not in again]


def common_zeros(
    fields: Fields, rectangle: Rectangle, cells: tuple[int, int], pair: tuple[int, int], starts: Vector
) -> tuple[Vector, Mask]:
    """Newton's method on two of the fields from points (2, N): where it ends, inside the rectangle, and if it has."""
    scaled = CellFields(fields, rectangle, cells)
    x = scaled.inwards(starts)
    change = np.full(x.shape[1], np.inf)
    for _ in range(NEWTON_MAX):
        value, slope = scaled(x)
        step = -_solved(slope[list(pair)], value[list(pair)])
        change = np.linalg.norm(step, axis=0)
        with np.errstate(invalid="ignore"):
            x = x + step * np.minimum(1.0, STEP / np.maximum(change, 1e-300))
        if np.all(change[np.isfinite(change)] < ROUNDING):
            break
    found = rectangle.wrapped(scaled.outwards(x))
    inside = (found >= rectangle.low[:, None]) & (found <= rectangle.high[:, None])
    return found, (change < CONVERGED) & np.all(inside, axis=0)


def on_curve(fields: Fields, rectangle: Rectangle, cells: tuple[int, int], function: int, points: Vector) -> Vector:
    """Points (2, N) beside a curve on which one of the fields vanishes, moved across it onto it."""
    scaled, which = CellFields(fields, rectangle, cells), np.full(points.shape[1], function, dtype=np.int64)
    x, last = scaled.inwards(points), False
    for _ in range(CORRECTIONS):
        value, slope = scaled.one(x, which)
        with np.errstate(all="ignore"):
            back = value * slope / np.sum(slope**2, axis=0)
        # Where there is no slope it stays.
        back = np.where(np.isfinite(back), back, 0.0)
        x = x - back
        if last:
            break
        # Newton's method squares what is left: after the next step it is rounding.
        last = not np.any(np.abs(back) > NEAR)
    return rectangle.wrapped(scaled.outwards(x))


def _solved(slope: Vector, value: Vector) -> Vector:
    """Solutions (2, N) of 2 × 2 systems (2, 2, N) with right sides (2, N); not finite where a matrix is singular."""
    (a, b), (c, d) = slope
    x, y = value
    with np.errstate(all="ignore"):
        return np.stack([d * x - b * y, a * y - c * x]) / (a * d - b * c)


def _hidden(scaled: CellFields, lines: ValuesAndSlopes, values: Vector, functions: int) -> Vector:
    """Points (2, N) of another sign than all nodes about them: extrema inside loops that no line crosses."""
    function, i, j = _least(values[:functions], scaled.rectangle.periodic)
    if not function.size:
        return np.zeros((2, 0))
    x = np.stack([lines[0][i], lines[1][j]])
    start, sign = x.copy(), np.sign(values[function, i, j])
    flipped = np.zeros(function.size, dtype=bool)
    probe = 1e-5
    for _ in range(8):
        value, slope = scaled.one(x, function)
        flipped |= sign * value < 0
        bent = [scaled.one(x + probe * e[:, None], function)[1] - slope for e in np.eye(2)]
        hessian = sign * np.stack(bent, axis=1) / probe
        hessian = (hessian + hessian.transpose(1, 0, 2)).transpose(2, 0, 1) / 2
        usable = np.all(np.isfinite(hessian), axis=(1, 2)) & np.all(np.isfinite(slope), axis=0) & ~flipped
        curvature, axes = np.linalg.eigh(np.where(usable[:, None, None], hessian, np.eye(2)))
        along = np.einsum("nij,in->nj", axes, np.where(usable, sign * slope, 0.0))
        step = -np.einsum("nij,nj->in", axes, along / np.maximum(np.abs(curvature), 1e-12))
        step *= np.minimum(1.0, STEP / np.maximum(np.linalg.norm(step, axis=0), 1e-300))
        x = np.clip(x + step, start - 1.0, start + 1.0)
        for axis in range(2):
            if not scaled.rectangle.periodic[axis]:
                x[axis] = np.clip(x[axis], INSET, scaled.cells[axis] - INSET)
    found = x[:, flipped]
    for axis in range(2):
        if scaled.rectangle.periodic[axis]:
            found[axis] = lines[axis][0] + np.mod(found[axis] - lines[axis][0], scaled.cells[axis])
    return found


def _least(values: Vector, periodic: tuple[bool, bool]) -> tuple[Whole, Whole, Whole]:
    """Nodes (function, i, j) that are least in size among their neighbours, all of one sign."""
    size = np.abs(values)
    inside = values[:, : -1 if periodic[0] else None, : -1 if periodic[1] else None]
    padded, sizes = inside, np.abs(inside)
    for axis, closes in zip((1, 2), periodic, strict=True):
        width = [(0, 0)] * 3
        width[axis] = (1, 1)
        mode = "wrap" if closes else "edge"
        padded, sizes = np.pad(padded, width, mode=mode), np.pad(sizes, width, mode=mode)
    rows, columns = inside.shape[1:]
    least = np.isfinite(inside)
    for a in range(3):
        for b in range(3):
            beside = np.s_[:, a : a + rows, b : b + columns]
            least &= (sizes[beside] >= size[:, :rows, :columns]) & (padded[beside] * inside > 0)
    function, i, j = np.nonzero(least)
    return function, i, j
