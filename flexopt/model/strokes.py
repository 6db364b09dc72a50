"""How far a cylinder lets its joint go: the range of q on which its length stays within the stroke.

In: a cylinder, the frame and the limits of its joint, the machine's parameters. Out: the range, and what is wrong.
Lengths come from `hydraulics.pin_to_pin`, their derivatives from the same formula at q + ih (complex step, exact to
rounding).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.errors import Fault
from flexopt.foundation.arrays import Interval, Vector
from flexopt.model.hydraulics import Cylinder, CylinderLength, JointFrame, pin_to_pin

# Angles looked at, rad: between two of them a length has at most one extremum.
STEP = math.radians(0.25)
# A lever arm shorter than this, m, is none: the joint stands at a dead centre.
DEAD_CENTRE = 1e-6
# Times longer, or shorter, than its stroke a cylinder of a wrong unit is at least.
MISTAKEN = 50.0
TINY = 1e-200


@dataclass(frozen=True)
class CylinderTravel:
    """Length, its derivative and the closing of the linkage over q, as numbers."""

    cylinder: Cylinder
    frame: JointFrame
    value: Mapping[str, float]

    def _reach(self, q: NDArray[np.complexfloating[Any, Any]] | Vector) -> CylinderLength:
        with np.errstate(invalid="ignore", divide="ignore"):
            return pin_to_pin(self.cylinder, self.frame, self.value, (q, np.cos(q), np.sin(q)))

    def lengths(self, q: Vector) -> Vector:
        """L(q), m; NaN where the linkage does not close."""
        return self._reach(q).length

    def ratios(self, q: Vector) -> Vector:
        """The lever arm dL/dq, m/rad."""
        return np.imag(self._reach(q + 1j * TINY).length) / TINY

    def closures(self, q: Vector) -> Vector:
        """Negative where the linkage does not close."""
        closure = self._reach(q).closure
        return np.ones_like(q) if closure is None else np.where(np.isfinite(closure), closure, -1.0)

    def length(self, q: float) -> float:
        """L at one q."""
        return float(self.lengths(np.array([q]))[0])

    def ratio(self, q: float) -> float:
        """dL/dq at one q."""
        return float(self.ratios(np.array([q]))[0])

    def beyond_stroke(self, q: float) -> str:
        """What is wrong with the length at q, as the end of a sentence; nothing where it is within the stroke."""
        (low, high), length, name = self.cylinder.length, self.length(q), self.cylinder.name
        if math.isnan(length):
            return f"; the linkage of {name} does not close there"
        if low <= length <= high:
            return ""
        return f"; {name} would be {length:.4g} m long, its stroke is {low:g} to {high:g} m"

    def closure(self, q: float) -> float:
        """As `closures`, at one q."""
        return float(self.closures(np.array([q]))[0])


def usable_range(travel: CylinderTravel, limits: Interval, where: str) -> tuple[Interval, list[Fault]]:
    """The range that limits and stroke leave to the joint, in rad or m; the limits themselves where there is a fault.

    A joint without limits turns, within the stroke, as far about q = 0 as the length changes one way.

    Args:
        travel: of the cylinder.
        limits: of the joint itself; infinite where it has none.
        where: what the faults call the cylinder.
    """
    stroke = travel.cylinder.length
    if travel.frame.slide:
        offset = travel.length(0.0)
        low, high = max(limits[0], stroke[0] - offset), min(limits[1], stroke[1] - offset)
        if low < high:
            return (low, high), []
        sentence = f"leaves the joint, whose limits are {_range(limits)} m, no room: its length is {offset:g} m + q"
        return limits, [Fault(f"{where}.length", sentence, _quoted(stroke))]
    limited = math.isfinite(limits[0])
    low, high = limits if limited else (-2 * math.pi, 2 * math.pi)
    grid = np.linspace(low, high, max(3, math.ceil((high - low) / STEP)))
    closing = _closing(travel, grid)
    fault = _closing_fault(closing, (low, high), limited)
    if fault is not None:
        return limits, [Fault(f"{where}.rocker", fault)]
    branches = [branch for piece in closing for branch in _branches(travel, piece)]
    if not limited:
        branches = [branch for branch in branches if branch[0] <= 0 <= branch[1]]
    if not limited and abs(travel.ratio(0.0)) < DEAD_CENTRE:
        return limits, [Fault(f"{where}.joint", "has no limits and stands at a dead centre at 0 rad; give it limits")]
    found = [part for part in (_within(travel, branch) for branch in branches) if part is not None]
    if not found:
        lengths = [travel.length(end) for branch in branches for end in branch]
        sentence = (
            f"is never reached: where the joint may go, {_range((branches[0][0], branches[-1][1]))} rad, the cylinder "
            f"is {min(lengths):.4g} to {max(lengths):.4g} m long"
        )
        if min(lengths) > MISTAKEN * stroke[1] or max(lengths) < stroke[0] / MISTAKEN:
            sentence += "; a length or a pin's point is probably in mm, not m"
        return limits, [Fault(f"{where}.length", sentence, _quoted(stroke))]
    dead = [end for part in found for end in part if abs(travel.ratio(end)) < DEAD_CENTRE]
    if dead:
        sentence = (
            f"has a dead centre at {dead[0]:.4g} rad, where the cylinder is {travel.length(dead[0]):.4g} m long and "
            "has no lever arm; limits or a stroke that end before it would do"
        )
        return limits, [Fault(f"{where}.joint", sentence, repr(travel.cylinder.joint))]
    straight = [end for part in found for end in part if not limited and any(end in piece for piece in closing)]
    if straight:
        sentence = (
            f"the linkage stretches straight at {straight[0]:.4g} rad, before the stroke ends; give the joint limits"
        )
        return limits, [Fault(f"{where}.rocker", sentence)]
    if len(found) > 1:
        listed = " and ".join(f"{_range(part)} rad" for part in found)
        sentence = f"leaves the joint two ranges that do not meet, {listed}; narrow its limits to one of them"
        return limits, [Fault(f"{where}.length", sentence, _quoted(stroke))]
    return found[0], []


def _closing(travel: CylinderTravel, grid: Vector) -> list[Interval]:
    """Pieces of the grid's range on which the linkage closes."""
    closes = travel.closures(grid) >= 0
    pieces: list[Interval] = []
    start = float(grid[0]) if closes[0] else math.nan
    for k in range(1, len(grid)):
        if closes[k] == closes[k - 1]:
            continue
        inside, outside = (grid[k], grid[k - 1]) if closes[k] else (grid[k - 1], grid[k])
        edge = last_inside(lambda q: travel.closure(q) >= 0, float(inside), float(outside))
        if closes[k]:
            start = edge
        else:
            pieces.append((start, edge))
    return [*pieces, (start, float(grid[-1]))] if closes[-1] else pieces


def _closing_fault(closing: list[Interval], limits: Interval, limited: bool) -> str | None:
    listed = " and ".join(f"{_range(piece)} rad" for piece in closing)
    where = f"it closes from {listed}" if closing else "it closes nowhere: the two circles never meet"
    if limited and closing != [limits]:
        return f"the linkage does not close everywhere within the joint's limits, {_range(limits)} rad; {where}"
    if not limited and not any(low <= 0 <= high for low, high in closing):
        return f"the joint has no limits and the linkage does not close at 0 rad; {where}; give the joint limits"
    return None


def _branches(travel: CylinderTravel, piece: Interval) -> list[Interval]:
    """Parts of a piece on which the length changes one way."""
    grid = np.linspace(*piece, max(3, math.ceil((piece[1] - piece[0]) / STEP)))
    ratios = travel.ratios(grid)
    turns = [
        last_inside(lambda q, s=ratios[k]: travel.ratio(q) * s > 0, float(grid[k]), float(grid[k + 1]))
        for k in range(len(grid) - 1)
        if ratios[k] * ratios[k + 1] < 0
    ]
    # A zero on the grid itself is a turn too, unless it is an end.
    turns += [float(grid[k]) for k in range(1, len(grid) - 1) if ratios[k] == 0]
    return list(pairwise([piece[0], *sorted(turns), piece[1]]))


def _within(travel: CylinderTravel, branch: Interval) -> Interval | None:
    """The part of a branch on which the length is within the stroke."""
    low, high = travel.cylinder.length
    short, long = sorted(branch, key=travel.length)
    if travel.length(short) >= high or travel.length(long) <= low:
        return None
    if travel.length(short) < low:
        short = last_inside(lambda q: travel.length(q) >= low, long, short)
    if travel.length(long) > high:
        long = last_inside(lambda q: travel.length(q) <= high, short, long)
    return min(short, long), max(short, long)


def last_inside(holds: Callable[[float], bool], inside: float, outside: float) -> float:
    """Where a condition that holds at `inside` and not at `outside` ends: the last double on the inside, by bisection.

    The condition is one of round-off, not of a smooth function, at its end: no faster method would be safe.
    """
    while True:
        middle = 0.5 * (inside + outside)
        if middle in (inside, outside):
            return inside
        if holds(middle):
            inside = middle
        else:
            outside = middle


def _range(pair: Interval) -> str:
    return f"{pair[0]:.4g} to {pair[1]:.4g}"


def _quoted(pair: Interval) -> str:
    return f"[{pair[0]:g}, {pair[1]:g}]"
