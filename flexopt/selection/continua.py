"""Optima that are one: the same posture on a base that may be moved without anything being lost.

In: verified optima of a problem. Out: which of them are of one continuum. The usual one is a machine in space that may
be turned about its target; a wall, a region or a cost of travel ends that.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.selection.problem import SelectionProblem, beyond_bounds

# Joints that differ by less, in scaled variables, are the same posture.
SAME_POSTURE = 1e-4
# What may change along the way from one to the other: of the target, constraints and w_i, relative to their scales.
ALIKE = 1e-6
# Places looked at on the way: a few, and for what the yard allows one every so many metres.
BETWEEN, EVERY = 7, 0.1


@dataclass(frozen=True)
class AnchorPose:
    """Where the anchor frame stands: x, y, m, and yaw, rad; 0 where the placement does not name it."""

    x: float
    y: float
    yaw: float


def grouped(problem: SelectionProblem, points: list[Vector]) -> list[list[int]]:
    """Numbers of the points z (n_z,), those of one continuum together, the nearest to the present base first.

    Two are of one continuum where the joints are the same and turning the anchor frame about one point of the ground,
    or sliding it, leads from one to the other while target, every w_i, every objective and the travel's cost stay, and
    bounds and constraints are kept, as seen every 0.1 m on the way.
    """
    groups: list[list[int]] = []
    for number, z in enumerate(points):
        home = next((group for group in groups if _joined(problem, points[group[0]], z)), None)
        if home is None:
            groups.append([number])
        else:
            home.append(number)
    now = problem.present_base
    if now is None:
        return groups
    away = [float(np.linalg.norm(z[: now.size] - now)) for z in points]
    return [sorted(group, key=away.__getitem__) for group in groups]


def _joined(problem: SelectionProblem, z: Vector, other: Vector) -> bool:
    n_base = len(problem.machine.base_coordinates)
    away = np.abs((z - other) / problem.scale)[n_base:]
    if not n_base or away.max(initial=0.0) > SAME_POSTURE or not _alike(problem, z, other):
        return False
    ends = _pose(problem, z), _pose(problem, other)
    turn = (ends[1].yaw - ends[0].yaw + math.pi) % (2 * math.pi) - math.pi
    for way in (turn, turn - math.copysign(2 * math.pi, turn)) if turn else (turn,):
        few = [_configuration(problem, z, pose) for pose in _between(*ends, way, BETWEEN)]
        if not all(place is not None and _kept(problem, place) and _alike(problem, z, place) for place in few):
            continue
        closely = (_configuration(problem, z, pose) for pose in _between(*ends, way, _count(*ends, way)))
        if all(place is not None and _kept(problem, place) for place in closely):
            return True
    return False


def _pose(problem: SelectionProblem, z: Vector) -> AnchorPose:
    at = dict(zip(problem.machine.base_coordinates, z.tolist(), strict=False))
    return AnchorPose(at.get("x", 0.0), at.get("y", 0.0), at.get("yaw", 0.0))


def _count(start: AnchorPose, end: AnchorPose, turn: float) -> int:
    """How many places lie on the way, `EVERY` so many metres."""
    chord, bend = math.hypot(end.x - start.x, end.y - start.y), abs(math.sin(0.5 * turn))
    return math.ceil((chord if bend < 1e-9 else chord * abs(0.5 * turn) / bend) / EVERY)


def _between(start: AnchorPose, end: AnchorPose, turn: float, count: int) -> Iterator[AnchorPose]:
    """Poses on the way that turns by `turn` about one point; without a turn on the straight line."""
    shares = np.arange(1, count + 1) / (count + 1)
    p, q = complex(start.x, start.y), complex(end.x, end.y)
    for share in shares.tolist():
        if abs(math.sin(0.5 * turn)) < 1e-9:
            at = p + share * (q - p)
        else:
            factor = complex(math.cos(turn), math.sin(turn))
            center = (q - factor * p) / (1 - factor)
            at = center + complex(math.cos(share * turn), math.sin(share * turn)) * (p - center)
        yield AnchorPose(at.real, at.imag, start.yaw + share * turn)


def _configuration(problem: SelectionProblem, z: Vector, pose: AnchorPose) -> Vector | None:
    """The posture of z with its base at a pose; None where the placement or the bounds cannot."""
    place, at = z.copy(), vars(pose)
    for name, value in at.items():
        if name not in problem.machine.base_coordinates:
            if abs(value) > ALIKE:
                return None
            continue
        k = problem.machine.base_coordinates.index(name)
        turns = 2 * math.pi * np.array([0, -1, 1]) if name == "yaw" else np.zeros(1)
        allowed = [v for v in (value + turns).tolist() if problem.lower[k] <= v <= problem.upper[k]]
        if not allowed:
            return None
        place[k] = allowed[0]
    return problem.wrapped(place)


def _alike(problem: SelectionProblem, z: Vector, other: Vector) -> bool:
    """Whether every w_i and every objective is the same."""
    n_base, p = problem.measures.plant.n_base, problem.measures.plant.parameter_values
    one, two = (
        np.concatenate(
            [
                problem.measures.w.call([at[:n_base], at[n_base:], p])[0].full().ravel(),
                *(problem.branches(objective, at)[0][:1] for objective in problem.objectives),
            ]
        )
        for at in (z, other)
    )
    m = one.size - len(problem.objectives)
    sizes = np.array([problem.objective_scales[0]] * m + list(problem.objective_scales))
    return bool(np.all(np.abs(one - two) <= ALIKE * np.maximum(sizes, np.abs(one))))


def _kept(problem: SelectionProblem, z: Vector) -> bool:
    """Whether z reaches the target and keeps the constraints."""
    return bool(np.abs(beyond_bounds(problem, z)).max() <= ALIKE)
