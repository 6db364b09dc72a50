"""What curves of robust postures say of a machine: their robust parts, why they end, and where two of them meet.

In: a slice of a machine's postures. Out: an `Atlas`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from flexopt.foundation.arrays import Mask, Vector
from flexopt.foundation.documents import provenance
from flexopt.plant.inverse_kinematics import low_discrepancy
from flexopt.plant.singularity import CONDITION_MAX
from flexopt.robustness.atlas.fields import ROWS, LineOfMotion, Slice, SliceValues
from flexopt.robustness.atlas.rectangle import Rectangle, Whole
from flexopt.robustness.atlas.result import Atlas, EdgeCurve, RobustCurve, RobustPoint
from flexopt.robustness.atlas.tracing import ZeroCurve
from flexopt.robustness.atlas.zero_curves import Nodes, common_zeros, on_curve, zero_curves

# Points on which it is seen that a mode's a and b are parallel everywhere, and how nearly, relative to their lengths.
SAMPLES, PARALLEL = 256, 1e-12
# What a and b have beside a line, relative to their lengths: rounding.
ON_LINE = 1e-10
# The sine of the angle between a and b on curves on which they are parallel.
NEARLY = 1e-7
# In cells: how far Newton's method may go from where two curves seem to meet, and what counts as one point.
FAR, SAME = 3.0, 1e-5
# |w_i| of what counts as zero, relative to the largest on the grid.
ZERO = 1e-14
# Of |a| and |b|, relative to beside it, what counts as zero where curves turn.
GONE = 1e-6
# Relative gap of two ω² at which a curve that is lost is lost by them; condition of Jv at which by that.
MEETING, NEARLY_SINGULAR = 1e-3, 1e4
# Between how many parts of a step a·b is looked at where it comes near to zero, and how often these are divided again.
PARTS, ROUNDS = 8, 3
# How often a step is halved in which it changes sign before Newton's method takes over.
HALVINGS = 24
# Evaluations of the fields for each node, by the task's rows: those that curves take, or points, in every cell.
PER_NODE, PER_NODE_IN_SPACE = 8, 32


def survey(over: Slice, rectangle: Rectangle, cells: tuple[int, int]) -> Atlas:
    """The atlas of a slice."""
    per_node = PER_NODE if len(over.machine.task_rows) < 3 else PER_NODE_IN_SPACE
    over.expect(per_node * math.prod(cells))
    span = (rectangle.high - rectangle.low)[:, None]
    samples = over.values(rectangle.low[:, None] + span * low_discrepancy(2, SAMPLES, 0))
    over = replace(over, left_out=_everywhere(samples))
    found = [_line(samples, mode) for mode in range(over.modes) if mode not in over.left_out]
    over = replace(over, lines=tuple(line for line in found if line))
    curves, nodes = zero_curves(over, rectangle, cells, over.traced)
    return _Survey(over, rectangle, cells, nodes, curves).atlas()


def _everywhere(at: SliceValues) -> tuple[int, ...]:
    """Modes, from 0, whose a and b are parallel in every posture."""
    usual = np.nanmedian(at.scale, axis=1).max(initial=0.0) if np.any(np.isfinite(at.scale)) else 0.0
    known = np.isfinite(at.crossed)
    parallel = np.all(~known | (at.crossed <= PARALLEL * np.maximum(at.scale, usual)), axis=1) & known.any(axis=1)
    return tuple(int(k) for k in np.flatnonzero(parallel))


def _line(at: SliceValues, mode: int) -> LineOfMotion | None:
    """The line that a keeps to in every posture, if any."""
    known = np.isfinite(at.factors[mode]).all(axis=(0, 1))
    lacking = np.zeros((ROWS[1] - at.factors.shape[2], int(known.sum())))
    a, b, *columns = (np.concatenate([x[:, known], lacking]) for x in (*at.factors[mode], *at.columns))
    if a.shape[1] < len(a):
        return None
    for joint, column in enumerate(columns):
        across = np.cross(column, a, axis=0)
        axes, sizes, _ = np.linalg.svd(across, full_matrices=False)
        normal = axes[:, 0]
        # What is to be zero, and of what size it would be: a along the column, b out of the plane.
        parts = [(np.sum(column * a, axis=0), np.linalg.norm(column, axis=0) * np.linalg.norm(a, axis=0))]
        parts.append((normal @ b, np.linalg.norm(b, axis=0)))
        both = all(np.all(np.abs(part) <= ON_LINE * np.maximum(size, np.median(size))) for part, size in parts)
        if both and sizes[0] > 0 and sizes[1] <= ON_LINE * sizes[0]:
            return LineOfMotion(mode, joint, normal)
    return None


@dataclass(frozen=True)
class _Cut:
    """Where a curve on which a × b = 0 turns from robust to opposed: between which of its points, where, and why."""

    place: float
    point: Vector
    kind: str


class _Survey:
    """What the curves of a slice say of the machine."""

    def __init__(
        self, over: Slice, rectangle: Rectangle, cells: tuple[int, int], nodes: Nodes, curves: list[ZeroCurve]
    ) -> None:
        self.over, self.rectangle, self.cells, self.nodes = over, rectangle, cells, nodes
        self.cell = (rectangle.high - rectangle.low) / cells
        self.edges = [curve for curve in curves if curve.function == over.edge]
        self.vanishing: list[tuple[int, str, Vector]] = []
        crossed = [curve for curve in curves if curve.function < over.modes]
        # Of three task rows curves on which one component is zero; in planes of symmetry all of a × b is.
        self.partly = [curve for curve in crossed if over.spatial and not self._parallel(curve)]
        whole = [curve for curve in crossed if all(curve is not other for other in self.partly)]
        self.arcs = [arc for curve in whole for arc in self._arcs(curve)]
        # Where a is 0 so is w, whatever the sign of a·b beside it.
        self.arcs += [replace(c, ends=self._ends(c)) for c in curves if c.function > over.edge]

    def atlas(self) -> Atlas:
        """Everything, with the end-points."""
        over, machine = self.over, self.over.machine
        i, j = over.varies
        varied = machine.joints[i], machine.joints[j]
        largest, share, unmapped = self._grid()
        low, high = self.rectangle.low.tolist(), self.rectangle.high.tolist()
        x_range, y_range = ((a, b) for a, b in zip(low, high, strict=True))
        options: dict[str, Any] = {"control": over.control, "gravity": over.gravity, "joints": list(varied)}
        options |= {"posture": over.rest.tolist(), "base": over.base.tolist(), "cells": self.cells}
        options |= {"x_range": x_range, "y_range": y_range}
        curves = sorted((self._curve(arc) for arc in self.arcs), key=lambda c: (c.mode, *c.first))
        vanishing = [self._point((mode,), kind, point) for mode, kind, point in self.vanishing]
        return Atlas(
            machine=machine.name,
            control=over.control,
            gravity=over.gravity,
            base=over.base,
            joints=tuple(machine.joints),
            joint_units=tuple(machine.joint_units),
            rows=tuple(machine.task_rows),
            varied=varied,
            fixed=over.rest,
            x_range=x_range,
            y_range=y_range,
            periodic=self.rectangle.periodic,
            limits=np.array([machine.limits[i], machine.limits[j]]),
            cells=self.cells,
            resolution=self.cell,
            curves=tuple(curves),
            isolated=tuple(self._isolated(largest)),
            doubly_robust=tuple(self._doubly_robust(largest)),
            vanishing=tuple(sorted(vanishing, key=lambda p: (p.modes, *p.posture))),
            edges=tuple(self._all_edges()),
            singular=self._singular(),
            everywhere=tuple(k + 1 for k in over.left_out),
            w_largest=largest,
            robust_share=share,
            unmapped=unmapped,
            provenance=provenance(machine, **options),
        )

    def _grid(self) -> tuple[Vector, Vector, float]:
        """On the grid: the largest |w_i|, (m,); the share where it is zero, (m,); the share without measures."""
        at = self._at_nodes
        w = np.abs(at.w)
        with np.errstate(invalid="ignore"):
            zero = np.mean(w <= ZERO * at.scale, axis=1)
        unmapped = np.mean(~np.isfinite(at.factors).all(axis=(0, 1, 2)))
        return np.max(np.where(np.isfinite(w), w, 0.0), axis=1), zero, float(unmapped)

    @cached_property
    def _at_nodes(self) -> SliceValues:
        u, v = np.meshgrid(*self.nodes.lines, indexing="ij")
        return self.over.values(np.stack([u.ravel(), v.ravel()]))

    @cached_property
    def _longest(self) -> Vector:
        """The largest |a| and |b| on the grid, (m, 2); under inverse control of b as it is traced."""
        lengths = np.linalg.norm(self._at_nodes.factors, axis=2)
        return np.max(np.where(np.isfinite(lengths), lengths, 0.0), axis=2)

    # Curves.

    def _arcs(self, curve: ZeroCurve) -> list[ZeroCurve]:
        """The parts of a curve a × b = 0 on which a·b > 0."""
        mode, points = curve.function, self._denser(curve)
        dot, edge = self._signs(mode, points)
        cuts = self._cuts(mode, points, dot, edge)
        size, robust = points.shape[1], np.sign(dot * edge) > 0
        ends = [
            _Cut(place, points[:, k], kind)
            for place, k, kind in zip((-0.5, size - 0.5), (0, -1), self._ends(curve) or ("", ""), strict=True)
        ]
        if curve.closed:
            if not cuts:
                return [ZeroCurve(mode, points, True, ())] if robust[size // 2] else []
            # Begin and end at the first of them.
            size, turn = size - 1, math.floor(cuts[0].place) + 1
            points, robust = np.roll(points[:, :size], -turn, axis=1), np.roll(robust[:size], -turn)
            cuts = [replace(cut, place=cut.place - turn) for cut in cuts]
            cuts = [replace(c, place=c.place + size * (c.place < cuts[0].place)) for c in cuts]
            ends = [cuts[0], replace(cuts[0], place=cuts[0].place + size)]
            cuts = cuts[1:]
        arcs: list[ZeroCurve] = []
        number, so = np.arange(size, dtype=np.int64), False
        stops = [ends[0], *cuts, ends[1]]
        for start, stop in pairwise(stops):
            inside = np.flatnonzero((number > start.place) & (number < stop.place))
            # Between two cuts side by side it is not what it was before.
            so = bool(robust[inside[len(inside) // 2]]) if inside.size else not so
            if so:
                first = [] if start.place == -0.5 and not curve.closed else [start.point]
                last = [] if stop.place == size - 0.5 and not curve.closed else [stop.point]
                whole = np.column_stack([*first, *points[:, inside].T, *last])
                arcs.append(ZeroCurve(mode, whole, False, (start.kind, stop.kind)))
                turning = [cut for cut in (start, stop) if cut.kind in ("a = 0", "b = 0")]
                self.vanishing += [(mode, cut.kind[0], cut.point) for cut in turning]
        return arcs

    def _denser(self, curve: ZeroCurve) -> Vector:
        """The points of a curve, with more where a·b comes near to zero between them and may pass it and return."""
        points = curve.points
        for _ in range(ROUNDS):
            dot = self._signs(curve.function, points)[0]
            size, sign = np.abs(dot), np.sign(dot)
            least, beside = size[1:-1], np.maximum(size[:-2], size[2:])
            near = (least <= np.minimum(size[:-2], size[2:])) & (least < 2 * (beside - least))
            middle: Whole = np.flatnonzero(near & (sign[:-2] == sign[1:-1]) & (sign[2:] == sign[1:-1]))
            if not middle.size:
                break
            at: Whole = np.unique(np.concatenate([middle, middle + 1]))
            shares = np.tile(np.arange(1, PARTS) / PARTS, at.size)
            first = np.repeat(at, PARTS - 1)
            step = self.rectangle.nearest(points[:, first + 1] - points[:, first])
            between = on_curve(self.over, self.rectangle, self.cells, curve.function, points[:, first] + shares * step)
            points = np.insert(points, first + 1, between, axis=1)
        return points

    def _signs(self, mode: int, points: Vector) -> tuple[Vector, Vector]:
        """a·b as it is among the fields, and what to multiply it with for its sign."""
        values = self.over(points)[0]
        edge: Vector = values[self.over.edge]
        return values[self.over.dot(mode)], edge if self.over.turning else np.ones_like(edge)

    def _cuts(self, mode: int, points: Vector, dot: Vector, edge: Vector) -> list[_Cut]:
        """In order along the curve."""
        cuts: list[_Cut] = []
        for function, values in ((self.over.dot(mode), dot), (self.over.edge, edge)):
            at: Whole = np.flatnonzero(values[:-1] * values[1:] < 0)
            starts = self._halved(mode, function, points[:, at], points[:, at + 1], values[at])
            found, sound = self._turns(mode, function, starts)
            lengths = np.linalg.norm(self.over.values(points[:, at]).factors[mode], axis=1)
            vanished = np.linalg.norm(self.over.values(found).factors[mode], axis=1)
            for n, k in enumerate(at):
                point, kind = (found[:, n], "singular") if sound[n] else (starts[:, n], "undefined")
                if function != self.over.edge:
                    with np.errstate(all="ignore"):
                        left = vanished[:, n] / lengths[:, n]
                    kind = ("a = 0", "b = 0")[int(np.argmin(left))] if sound[n] and left.min() < GONE else "undefined"
                kind = self._reason(mode, point) if kind == "undefined" else kind
                step = self.rectangle.nearest(points[:, [k + 1]] - points[:, [k]])[:, 0] / self.cell
                along = self.rectangle.nearest((point - points[:, k])[:, None])[:, 0] / self.cell
                share = min(max(float(along @ step) / float(step @ step), 1e-9), 1 - 1e-9)
                cuts.append(_Cut(int(k) + share, point, kind))
        cuts.sort(key=lambda cut: cut.place)
        kept: list[_Cut] = []
        for cut in cuts:
            # Where a·b and det Jv change sign together it stays as it is.
            both = bool(kept) and (kept[-1].kind == "singular") != (cut.kind == "singular")
            if both and self._apart(kept[-1].point[:, None], cut.point[:, None])[0] < SAME:
                kept.pop()
            else:
                kept.append(cut)
        return kept

    def _halved(self, curve: int, function: int, first: Vector, last: Vector, value: Vector) -> Vector:
        """Points (2, N) on a curve beside those where another function changes sign between two of its points.

        The curve is where a first function is zero. Two such points may be closer to each other than the curve's own.
        """
        middle = first
        for _ in range(HALVINGS):
            chord = self.rectangle.wrapped(first + self.rectangle.nearest(last - first) / 2)
            middle = on_curve(self.over, self.rectangle, self.cells, curve, chord)
            # Where two frequencies meet curves have no direction.
            middle = np.where(self._apart(middle, chord) <= self._apart(last, first), middle, chord)
            same = self.over(middle)[0][function] * value > 0
            first, last = np.where(same, middle, first), np.where(same, last, middle)
        return middle

    def _turns(self, mode: int, function: int, starts: Vector) -> tuple[Vector, Mask]:
        """Where a × b and another function are zero, by Newton's method from points (2, N), and if it was found."""
        found, converged = common_zeros(self.over, self.rectangle, self.cells, (mode, function), starts)
        sound = converged & (self._apart(found, starts) < FAR)
        if self.over.turning and not sound.all():
            # In a plane of symmetry curves a × b = 0 cross where a·b and det Jv are zero, too, and have no slope there.
            both = self.over.dot(mode), self.over.edge
            crossing, converged = common_zeros(self.over, self.rectangle, self.cells, both, starts)
            there = ~sound & converged & (self._apart(crossing, starts) < 1.0)
            found, sound = np.where(there, crossing, found), sound | there
        return found, sound

    def _apart(self, one: Vector, other: Vector) -> Vector:
        """Distances (N,), in cells."""
        return np.linalg.norm(self.rectangle.nearest(one - other) / self.cell[:, None], axis=0)

    def _ends(self, curve: ZeroCurve) -> tuple[str, ...]:
        """Why a curve ends."""
        mode, points = self.over.mode_of(curve.function), curve.points
        both = zip(curve.ends, (points[:, 0], points[:, -1]), strict=not curve.closed)
        return tuple("limit" if end == "edge" else self._reason(mode, point) for end, point in both)

    def _reason(self, mode: int, point: Vector) -> str:
        """Why a curve cannot be followed beyond a point."""
        at = self.over.values(point[:, None])
        squares = at.frequency_hz[:, 0] ** 2
        beside = [k for k in (mode - 1, mode) if 0 <= k < squares.size - 1]
        if any(squares[k + 1] - squares[k] < MEETING * squares[k] for k in beside):
            return "equal frequencies"
        return "singular" if at.condition[0] > NEARLY_SINGULAR else "undefined"

    def _curve(self, arc: ZeroCurve) -> RobustCurve:
        at, mode = self.over.values(arc.points), self.over.mode_of(arc.function)
        scale = np.where(at.condition <= CONDITION_MAX, at.scale[mode], np.nan)
        length = float(np.sum(np.linalg.norm(self.rectangle.steps(arc.points), axis=0)))
        vanishing = "a" if arc.function > self.over.edge else ""
        frequency = at.frequency_hz[mode]
        return RobustCurve(
            mode + 1, arc.closed, arc.ends, length, vanishing, arc.points, at.end_point, frequency, scale
        )

    def _all_edges(self) -> list[EdgeCurve]:
        """Where the two joints cannot move the end-point to all sides."""
        machine, values = self.over.machine, self.over.values
        kind = "singular" if len(machine.joints) == len(machine.task_rows) else "fold"
        found = [EdgeCurve(kind, c.closed, c.points, values(c.points).end_point) for c in self.edges]
        ends = self.rectangle.low, self.rectangle.high
        for axis in (k for k in range(2) if not self.over.spatial and not self.rectangle.periodic[k]):
            for end in ends:
                side = np.empty((2, self.cells[1 - axis] + 1))
                side[axis] = end[axis]
                side[1 - axis] = np.linspace(ends[0][1 - axis], ends[1][1 - axis], side.shape[1])
                found.append(EdgeCurve("limit", False, side, values(side).end_point))
        return found

    # Points.

    def _point(self, modes: tuple[int, ...], vanishing: str, point: Vector) -> RobustPoint:
        at, posture = self.over.values(point[:, None]), self.over.postures(point[:, None])[:, 0]
        numbers = tuple(mode + 1 for mode in modes)
        return RobustPoint(
            numbers, vanishing, posture, at.w[:, 0], at.scale[:, 0], at.frequency_hz[:, 0], at.end_point[:, 0]
        )

    def _doubly_robust(self, largest: Vector) -> list[RobustPoint]:
        """Where two modes' curves meet: starts along each of the two, then Newton's method on both."""
        found: dict[tuple[int, int], list[Vector]] = {}
        for arc in self.arcs:
            values, mode = self.over(arc.points)[0], self.over.mode_of(arc.function)
            for other in sorted({each.function for each in self.arcs}):
                first, second = sorted((mode, self.over.mode_of(other)))
                if first == second:
                    continue
                starts = self._near_zeros(arc.function, other, arc.points, values[other])
                known = found.setdefault((first, second), [])
                pair = min(arc.function, other), max(arc.function, other)
                self._add_zeros(
                    pair, starts, known, lambda zero, modes=(first, second): self._robust(modes, zero, largest)
                )
        points = [self._point(pair, "", zero) for pair, zeros in found.items() for zero in zeros]
        return sorted(points, key=lambda p: (p.modes, *p.posture))

    def _add_zeros(
        self,
        pair: tuple[int, int],
        starts: Vector,
        known: list[Vector],
        counts: Callable[[Vector], bool] = lambda _: True,
    ) -> None:
        """Add to the known zeros of two functions those that count and Newton's method finds near starts, each once."""
        zeros, converged = common_zeros(self.over, self.rectangle, self.cells, pair, starts)
        for zero in zeros[:, converged & (self._apart(zeros, starts) < FAR)].T:
            new = all(self._apart(zero[:, None], other[:, None])[0] > SAME for other in known)
            if new and counts(zero):
                known.append(zero)

    def _parallel(self, curve: ZeroCurve) -> bool:
        """Whether all of a × b is zero along a curve."""
        at = self.over.values(curve.points)
        if self.over.on_line(curve.function):
            # Where Jv is singular all along it is what b is multiplied with that is zero.
            return bool(np.median(at.condition) <= CONDITION_MAX)
        with np.errstate(invalid="ignore"):
            return bool(np.all((at.crossed <= NEARLY * at.scale)[curve.function]))

    def _isolated(self, largest: Vector) -> list[RobustPoint]:
        """Where the second component of a × b is zero, too, along curves on which the first one is."""
        points: list[RobustPoint] = []
        for curve in self.partly:
            mode = curve.function
            pair = mode, self.over.second(mode)
            starts, known = self._near_zeros(*pair, curve.points, self.over(curve.points)[0][pair[1]]), list[Vector]()
            self._add_zeros(pair, starts, known, lambda zero, mode=mode: self._robust((mode,), zero, largest))
            points += [self._point((mode,), "", zero) for zero in known]
        return sorted(points, key=lambda p: (p.modes, *p.posture))

    def _near_zeros(self, curve: int, function: int, points: Vector, values: Vector) -> Vector:
        """Where values along a curve, on which the first function is zero, change sign, and where they are least."""
        at: Whole = np.flatnonzero(values[:-1] * values[1:] <= 0)
        crossing = self._halved(curve, function, points[:, at], points[:, at + 1], values[at])
        size = np.abs(values)
        least = 1 + np.flatnonzero((size[1:-1] <= size[:-2]) & (size[1:-1] <= size[2:]))
        return np.concatenate([crossing, points[:, least]], axis=1)

    def _robust(self, modes: tuple[int, ...], zero: Vector, largest: Vector) -> bool:
        """Whether these measures are zero there, also because a or b is."""
        at = self.over.values(zero[:, None])
        if not at.condition[0] <= CONDITION_MAX:
            return False
        w, scale, lengths = at.w[:, 0], at.scale[:, 0], np.linalg.norm(at.factors[..., 0], axis=2)
        gone = np.any(lengths <= GONE * self._longest, axis=1)
        return all(abs(w[k]) <= ZERO * (largest.max() if gone[k] else min(largest.max(), scale[k])) for k in modes)

    def _singular(self) -> Vector:
        """Singular postures of a redundant arm, (n, K): on the edges all other minors of Jv vanish, too."""
        over, found = self.over, list[Vector]()

        def singular(zero: Vector) -> bool:
            return bool(over.values(zero[:, None]).condition[0] > CONDITION_MAX)

        if over.rest.size and not over.spatial:
            for curve in self.edges:
                pair = over.edge, over.minor(0)
                starts = self._near_zeros(*pair, curve.points, over(curve.points)[0][pair[1]])
                self._add_zeros(pair, starts, found, singular)
        return over.postures(np.array(found).T.reshape(2, -1))
