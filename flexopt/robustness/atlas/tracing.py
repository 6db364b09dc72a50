"""Curves on which functions vanish, continued from crossing to crossing of a grid's lines, all of them at once.

In: functions, lines of a grid and the values at its nodes. Out: curves as points in order along them.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np

from flexopt.foundation.arrays import Mask, Vector
from flexopt.robustness.atlas.rectangle import CellFields, ValuesAndSlopes, Whole

CellIndex = tuple[int, int]

# In cells: the longest step, the shortest, where Newton's method has converged, what counts as one point.
STEP, LEAST_STEP, CONVERGED, SAME = 0.35, 1e-5, 1e-9, 1e-6
# Of coordinates that are numbers of cells.
ROUNDING = 1e-12
# Cosine of the largest turn of a tangent in a step.
TURN = 0.94
# In cells: branches of a curve that pass each other more closely than this count as crossing there.
CROSSING = 1e-4
CORRECTIONS, STEPS_MAX, ROOT_MAX = 6, 400, 60
# A function that changes sign and does not become this small, relative to the ends of the edge, jumps.
JUMP = 1e-5


@dataclass(frozen=True)
class ZeroCurve:
    """One curve.

    Attributes:
        function: number of the function that vanishes.
        points: (2, K) in order along it, inside the rectangle; of a closed one the last is the first.
        closed: whether it returns to where it began.
        ends: why it ends: "edge" of the rectangle, or "lost" where the function has no value or jumps; empty if closed.
            Of a robust part, why it is robust no further.
    """

    function: int
    points: Vector
    closed: bool
    ends: tuple[str, ...]


@dataclass
class _Piece:
    """A curve's way through one cell: points (2, K), and the crossings at its ends, −1 where it is lost."""

    points: Vector
    start: int
    end: int


@dataclass
class _Crossings:
    """Crossings of curves and lines of the grid, in order of their numbers.

    Attributes:
        function: whose curve.
        axis: the coordinate that varies along the edge.
        cell: index of the edge along that coordinate.
        line: index of the line it lies on.
        x: (2,) scaled; of a periodic coordinate the last line stands for none, it is the first.
        slope: (2,) of the function there.
        along: by (function, axis, cell, line) those on one edge.
    """

    function: list[int] = field(default_factory=list[int])
    axis: list[int] = field(default_factory=list[int])
    cell: list[int] = field(default_factory=list[int])
    line: list[int] = field(default_factory=list[int])
    x: list[Vector] = field(default_factory=list[Vector])
    slope: list[Vector] = field(default_factory=list[Vector])
    along: dict[tuple[int, int, int, int], list[int]] = field(
        default_factory=dict[tuple[int, int, int, int], list[int]]
    )

    def number(self, function: int, axis: int, cell: int, line: int, x: Vector) -> int:
        """The number of a crossing, a new one where it is not known."""
        edge = function, axis, cell, line
        for known in self.along.setdefault(edge, []):
            if abs(self.x[known][axis] - x[axis]) < SAME:
                return known
        for values, value in zip((self.function, self.axis, self.cell, self.line), edge, strict=True):
            values.append(value)
        self.x.append(x)
        self.along[edge].append(len(self.x) - 1)
        return len(self.x) - 1


class Tracing:
    """All curves of a grid, advanced together from crossing to crossing."""

    def __init__(self, scaled: CellFields, lines: ValuesAndSlopes, values: Vector, functions: int) -> None:
        self.scaled, self.lines, self.periodic = scaled, lines, scaled.rectangle.periodic
        self.count = tuple(line.size - 1 for line in lines)
        self.crossings = _Crossings()
        self.pieces: list[_Piece] = []
        # By crossing and the cell beside it: the piece through that cell.
        self.linked: dict[tuple[int, CellIndex], int] = {}
        for axis in range(2):
            self._seed(values[:functions], axis)

    def _seed(self, values: Vector, axis: int) -> None:
        """Crossings of all edges along a coordinate whose ends differ in sign."""
        if self.periodic[1 - axis]:
            values = np.delete(values, -1, axis=2 - axis)
        ends = np.delete(values, -1, axis=1 + axis), np.delete(values, 0, axis=1 + axis)
        with np.errstate(invalid="ignore"):
            function, *index = np.nonzero((ends[0] < 0) & (ends[1] >= 0) | (ends[0] >= 0) & (ends[1] < 0))
        if not function.size:
            return
        cell, line = index[axis], index[1 - axis]
        low, high = self.lines[axis][cell], self.lines[axis][cell + 1]
        fixed = self.lines[1 - axis][line]
        first, last = (end[function, *index] for end in ends)
        root, sound = self._roots(function, axis, fixed, low, high, first, last)
        for k in np.flatnonzero(sound):
            x = np.empty(2)
            x[axis], x[1 - axis] = root[k], fixed[k]
            self.crossings.number(int(function[k]), axis, int(cell[k]), int(line[k]), x)

    def _roots(
        self, function: Whole, axis: int, fixed: Vector, low: Vector, high: Vector, first: Vector, last: Vector
    ) -> tuple[Vector, Mask]:
        """Roots (N,) between `low` and `high` along a coordinate, by Newton's method in the bracket; if they are."""
        size = np.maximum(np.abs(first), np.abs(last))
        x = low + (high - low) * np.abs(first) / (np.abs(first) + np.abs(last))
        value, active = np.full(function.size, np.inf), np.arange(function.size, dtype=np.int64)
        for _ in range(ROOT_MAX):
            points = np.empty((2, active.size))
            points[axis], points[1 - axis] = x[active], fixed[active]
            at, slope = self.scaled.one(points, function[active])
            value[active] = at
            left = at * np.sign(first[active]) > 0
            low[active], high[active] = np.where(left, x[active], low[active]), np.where(left, high[active], x[active])
            with np.errstate(all="ignore"):
                new = x[active] - at / slope[axis]
            # At the root itself rounding may put the next step outside of the bracket.
            there = np.abs(new - x[active]) < ROUNDING
            outside = ~there & ~((new > low[active]) & (new < high[active]))
            new = np.where(outside, (low[active] + high[active]) / 2, new)
            moved = np.abs(new - x[active])
            x[active] = new
            active = active[~there & (moved > ROUNDING) & np.isfinite(at)]
            if not active.size:
                break
        return x, np.abs(value) <= JUMP * size

    def curves(self) -> list[ZeroCurve]:
        """Every curve, from end to end or round."""
        while True:
            # Forwards first: where another curve arrives there is no need to go backwards.
            halves = self._open(forwards=True) or self._open(forwards=False)
            if not halves:
                return self._joined()
            self._advance(halves)

    def _open(self, *, forwards: bool) -> list[tuple[int, CellIndex]]:
        """Crossings with a cell beside them whose piece is not known; forwards: greater values are to the left."""
        known = self.crossings
        fresh = np.arange(len(known.slope), len(known.x))
        if fresh.size:
            at = np.stack([known.x[k] for k in fresh], axis=1)
            known.slope += list(self.scaled.one(at, np.array([known.function[k] for k in fresh]))[1].T)
        found: list[tuple[int, CellIndex]] = []
        for k, (axis, slope) in enumerate(zip(known.axis, known.slope, strict=True)):
            # The tangent is (−∂g/∂v, ∂g/∂u).
            ahead = (slope[0] if axis == 0 else -slope[1]) > 0
            for up in (True, False):
                cell = self._beside(k, up)
                if cell is not None and (k, cell) not in self.linked and (ahead == up or not forwards):
                    found.append((k, cell))
        return found

    def _beside(self, number: int, up: bool) -> CellIndex | None:
        """The cell on one side of the line that a crossing lies on; None outside the rectangle."""
        axis, line = self.crossings.axis[number], self.crossings.line[number]
        across = line if up else line - 1
        if self.periodic[1 - axis]:
            across %= self.count[1 - axis]
        elif not 0 <= across < self.count[1 - axis]:
            return None
        cell = self.crossings.cell[number]
        return (cell, across) if axis == 0 else (across, cell)

    def _advance(self, halves: list[tuple[int, CellIndex]]) -> None:
        """Continue curves from crossings through the cells beside them."""
        known = self.crossings
        low = np.array([[self.lines[0][i], self.lines[1][j]] for _, (i, j) in halves]).T
        high = np.array([[self.lines[0][i + 1], self.lines[1][j + 1]] for _, (i, j) in halves]).T
        x, into = np.array([known.x[k] for k, _ in halves]).T, np.zeros_like(low)
        for n, (k, _) in enumerate(halves):
            axis = 1 - known.axis[k]
            # A crossing on the first line of a periodic coordinate lies on the last one, too.
            if abs(x[axis, n] - low[axis, n]) < SAME:
                into[axis, n] = 1.0
            else:
                into[axis, n], x[axis, n] = -1.0, high[axis, n]
        function = np.array([known.function[k] for k, _ in halves])
        for n, (points, exit_axis) in enumerate(self._through(function, x, low, high, into)):
            start, cell = halves[n]
            end = -1 if exit_axis is None else self._arrived(int(function[n]), points[:, -1], exit_axis, cell)
            other = self.linked.get((end, cell))
            if other is not None and {self.pieces[other].start, self.pieces[other].end} == {start, end}:
                self.linked[start, cell] = other
                continue
            self.pieces.append(_Piece(points, start, end))
            self.linked[start, cell] = len(self.pieces) - 1
            if end >= 0:
                self.linked[end, cell] = len(self.pieces) - 1

    def _arrived(self, function: int, x: Vector, axis: int, cell: CellIndex) -> int:
        """The number of the crossing at which a curve leaves a cell through a line across a coordinate."""
        line = cell[axis] + int(abs(x[axis] - self.lines[axis][cell[axis]]) > SAME)
        if self.periodic[axis] and line == self.count[axis]:
            line = 0
        x = x.copy()
        x[axis] = self.lines[axis][line]
        return self.crossings.number(function, 1 - axis, cell[1 - axis], line, x)

    def _through(
        self, function: Whole, x: Vector, low: Vector, high: Vector, into: Vector
    ) -> list[tuple[Vector, int | None]]:
        """From points (2, N) on the edges of cells: points up to where each curve leaves its cell, and how.

        That is the coordinate across whose line it does; None where it is lost.
        """
        here, tangent = x.copy(), _tangent(self.scaled.one(x, function)[1])
        # 1 where greater values are to the left on the way, else −1.
        side = np.where(np.sum(tangent * into, axis=0) < 0, -1.0, 1.0)
        tangent *= side
        step, active = np.full(function.size, STEP), np.arange(function.size, dtype=np.int64)
        paths: list[list[Vector]] = [[x[:, n]] for n in range(function.size)]
        left: list[int | None] = [None] * function.size
        for _ in range(STEPS_MAX):
            if not active.size:
                break
            new, ahead, same, sound = self._corrected(
                function[active], here[:, active], tangent[:, active], side[active], step[active]
            )
            box = low[:, active], high[:, active]
            outside = sound & np.any((new <= box[0]) | (new >= box[1]), axis=0)
            end, axis = self._exit(function[active], here[:, active], new, *box, outside)
            # Not where it came in.
            axis[(axis >= 0) & (np.abs(end - x[:, active]).max(axis=0) < SAME)] = -1
            sound &= ~outside | (axis >= 0)
            going, gone = np.flatnonzero(sound & ~outside), np.flatnonzero(axis >= 0)
            for n in going.tolist():
                paths[int(active[n])].append(new[:, n])
            for n in gone.tolist():
                paths[int(active[n])].append(end[:, n])
                left[int(active[n])] = int(axis[n])
            here[:, active[going]], tangent[:, active[going]] = new[:, going], ahead[:, going]
            side[active[going]] = same[going]
            step[active] = np.where(sound, np.minimum(STEP, 1.5 * step[active]), step[active] / 2)
            active = active[(axis < 0) & (step[active] > LEAST_STEP)]
        return [(np.array(path).T, axis) for path, axis in zip(paths, left, strict=True)]

    def _corrected(
        self, function: Whole, here: Vector, tangent: Vector, side: Vector, step: Vector
    ) -> tuple[Vector, Vector, Vector, Mask]:
        """A step along the tangents and back onto the curves: points, tangents and sides there, and if it was good."""
        guess = here + step * tangent
        new, change = guess.copy(), np.full(function.size, np.inf)
        slope = np.zeros_like(new)
        for _ in range(CORRECTIONS):
            value, slope = self.scaled.one(new, function)
            with np.errstate(all="ignore"):
                back = -value * slope / np.sum(slope**2, axis=0)
            new, change = new + back, np.linalg.norm(back, axis=0)
            if not np.any(change > CONVERGED):
                break
        ahead = _tangent(slope)
        turn = np.sum(ahead * tangent, axis=0)
        same = np.where(turn < 0, -1.0, 1.0)
        with np.errstate(invalid="ignore"):
            sound = (change <= CONVERGED) & (np.linalg.norm(new - guess, axis=0) <= step / 2) & (np.abs(turn) >= TURN)
            # Greater values on the other side: another branch of the curve, or beyond a point where two branches cross.
            sound &= (same == side) | (step <= CROSSING)
        return np.where(sound, new, here), ahead * same, same, sound

    def _exit(
        self, function: Whole, start: Vector, end: Vector, low: Vector, high: Vector, wanted: Mask
    ) -> tuple[Vector, Whole]:
        """Where curves between two points of theirs leave their cells: points, and the coordinate, −1 where not."""
        found, which, earliest = end.copy(), np.full(function.size, -1, dtype=np.int64), np.full(function.size, np.inf)
        for axis in range(2):
            numbers: Whole = np.flatnonzero(wanted & ((end[axis] >= high[axis]) | (end[axis] <= low[axis])))
            if not numbers.size:
                continue
            a, b = start[:, numbers], end[:, numbers]
            line = np.minimum(np.maximum(b[axis], low[axis, numbers]), high[axis, numbers])
            with np.errstate(all="ignore"):
                share: Vector = (line - a[axis]) / (b[axis] - a[axis])
            x, change = a + share * (b - a), np.full(numbers.size, np.inf)
            x[axis] = line
            guess = x[1 - axis].copy()
            for _ in range(CORRECTIONS + 4):
                value, slope = self.scaled.one(x, function[numbers])
                with np.errstate(all="ignore"):
                    change = -value / slope[1 - axis]
                x[1 - axis] += change
                if not np.any(np.abs(change) > ROUNDING):
                    break
            with np.errstate(invalid="ignore"):
                y, ends = x[1 - axis], (low[1 - axis, numbers], high[1 - axis, numbers])
                inside = (y >= ends[0] - CONVERGED) & (y <= ends[1] + CONVERGED) & (share < earliest[numbers])
                chosen = inside & (np.abs(change) <= CONVERGED) & (np.abs(y - guess) <= STEP)
            at = numbers[chosen]
            found[:, at], which[at], earliest[at] = x[:, chosen], axis, share[chosen]
        return found, which

    def _joined(self) -> list[ZeroCurve]:
        """Pieces put together at their crossings."""
        at: defaultdict[int, list[int]] = defaultdict(list)
        for number, piece in enumerate(self.pieces):
            for end in {piece.start, piece.end} - {-1}:
                at[end].append(number)
        left = dict.fromkeys(range(len(self.pieces)))
        return [self._walked(first, at, left) for first in range(len(self.pieces)) if first in left]

    def _walked(self, first: int, at: dict[int, list[int]], left: dict[int, None]) -> ZeroCurve:
        """The curve that goes through a piece; its pieces are taken away."""
        piece = self.pieces[first]
        del left[first]
        chain, start = [piece.points], piece.start
        end = self._extended(chain, piece.end, start, at, left)
        closed = end >= 0 and end == start
        if not closed:
            chain = [points[:, ::-1] for points in reversed(chain)]
            start, end = end, self._extended(chain, start, -1, at, left)
        whole = np.concatenate([chain[0], *(points[:, 1:] for points in chain[1:])], axis=1)
        ends = () if closed else tuple("edge" if e >= 0 and self._at_edge(e) else "lost" for e in (start, end))
        rectangle = self.scaled.rectangle
        # A limit is met to the last bit.
        placed = rectangle.wrapped(self.scaled.outwards(whole))
        placed = np.clip(placed, rectangle.low[:, None], rectangle.high[:, None])
        placed[:, -1] = placed[:, 0] if closed else placed[:, -1]
        return ZeroCurve(self.crossings.function[piece.start], placed, closed, ends)

    def _extended(
        self, chain: list[Vector], node: int, stop: int, at: dict[int, list[int]], left: dict[int, None]
    ) -> int:
        """Put to a chain of pieces those that follow from a crossing on, up to another; where they end."""
        while node not in (-1, stop):
            following = [k for k in at[node] if k in left]
            if not following:
                break
            piece = self.pieces[following[0]]
            del left[following[0]]
            forwards = piece.start == node
            chain.append(piece.points if forwards else piece.points[:, ::-1])
            node = piece.end if forwards else piece.start
        return node

    def _at_edge(self, number: int) -> bool:
        return None in (self._beside(number, True), self._beside(number, False))


def _tangent(slope: Vector) -> Vector:
    """Unit vectors (2, N) along curves of equal value."""
    with np.errstate(all="ignore"):
        return np.stack([-slope[1], slope[0]]) / np.linalg.norm(slope, axis=0)
