"""A coarse look at the whole redundancy where it has a closed form: the measures there, and their peaks.

The configurations that reach a target form curves (one degree of redundancy) or surfaces. They are parametrised by the
placement and a coordinate for each joint before the last two, on a grid (one degree) or a low-discrepancy sample
(more); the postures follow in closed form, one branch for each elbow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Interval, Vector
from flexopt.model.constraints import Constraints
from flexopt.plant import Plant
from flexopt.plant.inverse_kinematics import ELBOW_SIGN, branch, held_on, low_discrepancy
from flexopt.plant.reach import arm_length
from flexopt.selection.constraints import ConstraintSet
from flexopt.selection.objective import Objective, Quantities
from flexopt.selection.places import FEASIBLE, places_left_out

# Points a branch. Local maxima of the excavator's w1 stand 0.1 m apart and more; the grid resolves a few millimetres.
GRID_POINTS = 1001
SAMPLE_POINTS = 2048
GRID_POINTS_MIN = 65
NEIGHBOURS_PER_DEGREE = 3
# Postures of a placement in an area that the sample left out.
POSTURES_EACH = 4
NOWHERE: Vector = np.zeros((1, 0))
# Of the arm's length, by which a posture that is held on its target may miss it.
HELD = 1e-8
# Rounding on the very edge of the margin.
EDGE = 1e-10


@dataclass(frozen=True)
class Scan:
    """Points of the redundancy, N in all; only those that reach the target inside limits and margin are kept.

    Attributes:
        redundancy: coordinates in the unit cube, (d, N).
        elbow: −1 (up) or +1 (down), (N,); 0 where the points do not come in branches.
        base: placements (n_b, N), m.
        posture: (n, N), rad.
        w: measures (m, N), of the posture at rest.
        factor: |a_i||b_i|, (m, N).
        epsilon: ε_max (N,) where the objective needs it, else NaN.
        objective: V (N,).
        index: number of the grid point, (N,); neighbours on a curve differ by one.
        violation: of the other constraints, the largest in units of their scales, (N,).
        reached: whether any point reached the target at all, limits and margin left aside.
        unsound: whether a point was dropped because its measures are no numbers (under gravity: it falls over).
        undefined: whether one was because an own objective is none there.
    """

    redundancy: Vector
    elbow: Vector
    base: Vector
    posture: Vector
    w: Vector
    factor: Vector
    epsilon: Vector
    objective: Vector
    index: NDArray[np.int64]
    violation: Vector
    reached: bool
    unsound: bool
    undefined: bool = False

    @property
    def size(self) -> int:
        """Number of points, N."""
        return self.objective.size

    @property
    def z(self) -> Vector:
        """[base, posture] of every point, (n_z, N)."""
        return np.vstack([self.base, self.posture])

    @property
    def feasible(self) -> NDArray[np.bool_]:
        """Which points keep the other constraints, (N,)."""
        return self.violation <= FEASIBLE


def empty_scan(plant: Plant, *, reached: bool) -> Scan:
    """A scan that kept no point."""
    n, m, n_b = plant.n_actuated, plant.n_passive, plant.n_base
    none: Vector = np.zeros(0)
    return Scan(
        redundancy=np.zeros((0, 0)),
        elbow=none,
        base=np.zeros((n_b, 0)),
        posture=np.zeros((n, 0)),
        w=np.zeros((m, 0)),
        factor=np.zeros((m, 0)),
        epsilon=none,
        objective=none,
        index=np.zeros(0, dtype=np.int64),
        violation=none,
        reached=reached,
        unsound=False,
    )


def scanned(
    functions: Quantities,
    objective: Objective,
    redundancy: Vector,
    elbow: Vector,
    base: Vector,
    posture: Vector,
    index: NDArray[np.int64],
    violation: Vector,
) -> Scan:
    """A scan of points that reach the target, those left out whose measures are no numbers."""
    w, factor = (
        x.full() for x in functions.measures.w.call([base, posture, functions.measures.plant.parameter_values])[:2]
    )
    value = functions.smooth(objective, base, posture, w)
    defined = np.isfinite(value)
    epsilon = np.full(value.size, np.nan)
    if objective.has_kinks:
        epsilon = functions.epsilon_max(base, posture)
        value = value + objective.beta * epsilon
    measured = np.all(np.isfinite(w), axis=0)
    measured &= np.isfinite(value) | ~defined
    sound = measured & defined
    return Scan(
        redundancy=redundancy[:, sound],
        elbow=elbow[sound],
        base=base[:, sound],
        posture=posture[:, sound],
        w=w[:, sound],
        factor=factor[:, sound],
        epsilon=epsilon[sound],
        objective=value[sound],
        index=index[sound].astype(np.int64),
        violation=violation[sound],
        reached=True,
        unsound=not bool(measured.all()),
        undefined=not bool(defined[measured].all()),
    )


def scan_redundancy(
    functions: Quantities,
    target: Vector,
    intervals: list[Interval],
    objective: Objective,
    sine_squared_min: float,
    limits: Vector,
    constraint_set: ConstraintSet | None,
    seed: int,
    areas: Constraints,
) -> Scan:
    """Evaluate the measures over all configurations that reach `target` with the base in `intervals`.

    `limits` (n, 2) are those of the joints; `areas` that the sample leaves out are looked at, too.
    """
    plant = functions.measures.plant
    p = plant.parameter_values
    leading = plant.n_actuated - 2
    unit, bases, joints, numbers = _sample(intervals, leading, seed)
    more = [places_left_out(plant, areas, np.array([a]), np.array([b]), bases, seed) for a, b in intervals]
    if any(places.size for places in more):
        unit, bases, joints, numbers = _sample(intervals, leading, seed, np.concatenate(more, axis=1))

    kept: list[tuple[NDArray[Any], ...]] = []
    reached, misses = False, math.inf
    for sign in ELBOW_SIGN.values() if bases.size else ():
        postures, reaches = branch(plant, target, bases, joints, sign)
        reached = reached or bool(reaches.any())
        if functions.measures.gravity:
            postures[:, reaches], off = held_on(plant, target, bases[:, reaches], postures[:, reaches])
            misses = min(misses, float(off.min(initial=math.inf)))
        sines = plant.singularity_sine_squared(bases, postures, p).full().ravel()
        good: NDArray[np.int64] = np.flatnonzero(
            reaches & _inside(limits, postures) & (sines >= sine_squared_min - EDGE)
        )
        if good.size:
            kept.append((unit[:, good], np.full(good.size, sign), bases[:, good], postures[:, good], numbers[good]))
    if not kept:
        return empty_scan(plant, reached=reached)
    redundancy, elbow, base, posture, index = (np.concatenate(parts, axis=-1) for parts in zip(*kept, strict=True))
    if functions.measures.gravity and misses > HELD * arm_length(plant):
        # Where it reaches with springs unloaded alone.
        return empty_scan(plant, reached=False)
    violation = _violation(constraint_set, base, posture, p)
    return scanned(functions, objective, redundancy, elbow, base, posture, index, violation)


def _inside(limits: Vector, postures: Vector) -> NDArray[np.bool_]:
    low, high = limits.T[:, :, None]
    return cast(NDArray[np.bool_], np.all((postures >= low - EDGE) & (postures <= high + EDGE), axis=0))


def _violation(constraint_set: ConstraintSet | None, bases: Vector, postures: Vector, p: ca.DM) -> Vector:
    count: int = postures.shape[1]
    if constraint_set is None or not count:
        return np.zeros(count)
    rows = constraint_set.function.call([bases, postures, p, constraint_set.constants])[0].full().T
    lower, upper, scale = np.array([(row.lower, row.upper, row.scale) for row in constraint_set.rows]).T
    beyond = np.maximum(lower - rows, rows - upper) / scale
    return cast(Vector, np.maximum(beyond, 0.0).max(axis=1))


def _sample(
    intervals: list[Interval], leading: int, seed: int, more: Vector = NOWHERE
) -> tuple[Vector, Vector, Vector, NDArray[np.int64]]:
    """Unit coordinates (d, N), placements (1, N), unit coordinates of the arm (n − 2, N), and grid numbers (N,).

    `more`: placements (1, M) inside the intervals that are among them.
    """
    moves = any(high > low for low, high in intervals)
    degrees = leading + (1 if moves else 0)
    if not intervals:
        return np.zeros((degrees, 0)), np.zeros((1, 0)), np.zeros((leading, 0)), np.zeros(0, dtype=np.int64)
    if degrees == 1 and moves:
        unit, bases, numbers = _curve(intervals, more[0])
        return unit, bases, np.zeros((0, numbers.size)), numbers
    count = SAMPLE_POINTS if degrees > 1 else GRID_POINTS if degrees else 1
    unit = low_discrepancy(degrees, count, seed) if degrees > 1 else np.linspace(0.0, 1.0, count)[None, :][:degrees]
    bases = _placements(intervals, unit[0] if moves else np.zeros(count))
    if more.size:
        beside = np.repeat(more, POSTURES_EACH, axis=1)
        bases, along = np.concatenate([bases, beside], axis=1), _along(intervals, beside[0])
        count += beside.size
        unit = np.concatenate([unit, [along, *low_discrepancy(leading, beside.size, seed)]], axis=1)
    return unit, bases, unit[degrees - leading :], np.arange(count, dtype=np.int64)


def _curve(intervals: list[Interval], more: Vector) -> tuple[Vector, Vector, NDArray[np.int64]]:
    """Unit coordinate (1, N), placements (1, N) and numbers (N,) along the intervals, denser at their ends.

    Near the ends the arm straightens and its posture changes with the square root of the placement; a cosine makes the
    steps of the posture even. Numbers of neighbours differ by one, those of separate intervals by more. `more`:
    placements (M,) that are among them.
    """
    total = sum(high - low for low, high in intervals)
    placements: list[Vector] = []
    numbers: list[NDArray[np.int64]] = []
    first = 0
    for low, high in intervals:
        count = max(GRID_POINTS_MIN, round(GRID_POINTS * (high - low) / total))
        grid = (low + high) / 2 - (high - low) / 2 * np.cos(np.linspace(0.0, math.pi, count))
        among = more[(more >= low) & (more <= high)]
        if among.size:
            grid = np.unique(np.concatenate([grid, among]))
            count = grid.size
        placements.append(grid)
        numbers.append(np.arange(first, first + count, dtype=np.int64))
        first += count + 1
    along, number = np.concatenate(placements), np.concatenate(numbers)
    return (number / number[-1])[None, :], along[None, :], number


def _placements(intervals: list[Interval], unit: Vector) -> Vector:
    """Placements (1, N) that fill the intervals evenly, for coordinates in [0, 1]."""
    ends = np.array(intervals)
    edges: Vector = np.concatenate([[0.0], np.cumsum(ends[:, 1] - ends[:, 0])])
    along = unit * edges[-1]
    part = cast(NDArray[np.int64], np.digitize(along, edges[1:-1]))
    return (ends[part, 0] + along - edges[part])[None, :]


def _along(intervals: list[Interval], placements: Vector) -> Vector:
    """The coordinates in [0, 1] of placements (N,), see `_placements`."""
    lengths = [np.clip(placements - low, 0.0, high - low) for low, high in intervals]
    along: Vector = np.sum(lengths, axis=0) / sum(high - low for low, high in intervals)
    return along


def peaks(scan: Scan, score: Vector | None = None, among: NDArray[np.bool_] | None = None) -> NDArray[np.int64]:
    """Indices of the scan's local maxima, best first: no neighbour on the same branch is better.

    Args:
        scan: the points.
        score: what is compared, (N,), the objective by default.
        among: mask of the points that count, (N,), all by default.
    """
    found: list[int] = []
    score = scan.objective if score is None else score
    for sign in np.unique(scan.elbow):
        members = np.flatnonzero((scan.elbow == sign) & (True if among is None else among))
        if not members.size:
            continue
        values = score[members]
        if scan.redundancy.shape[0] == 0:
            is_peak = np.ones(members.size, dtype=bool)
        elif scan.redundancy.shape[0] == 1:
            is_peak = _curve_peaks(scan.index[members], values)
        else:
            is_peak = _surface_peaks(scan.redundancy[:, members], values)
        found += members[is_peak].tolist()
    order = np.argsort(-score[found], kind="stable")
    return np.array(found, dtype=np.int64)[order]


def _curve_peaks(index: NDArray[np.int64], values: Vector) -> NDArray[np.bool_]:
    """Peaks along a curve whose points are neighbours where their grid numbers differ by one."""
    linked = np.diff(index) == 1
    rises = np.diff(values) > 0
    left = np.concatenate([[True], ~linked | rises])
    right = np.concatenate([~linked | ~rises, [True]])
    return left & right


def _surface_peaks(points: Vector, values: Vector) -> NDArray[np.bool_]:
    """Peaks among scattered points: better than the nearest few."""
    from scipy.spatial import KDTree  # noqa: PLC0415  (slow to import, needed for redundant arms only)

    degrees, count = points.shape
    neighbours = min(count, 1 + NEIGHBOURS_PER_DEGREE * degrees)
    near = KDTree(points.T).query(points.T, k=neighbours)[1].reshape(count, neighbours)
    return values >= values[near].max(axis=1)
