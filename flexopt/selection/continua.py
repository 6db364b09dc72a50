"""Optima that are one: the same posture on a base that may be moved without anything being lost.

In: verified optima of a problem. Out: which of them are of one continuum. The usual one is a machine in space that may
be turned about its target; a wall, a region or a cost of travel ends that.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.foundation.coordinates import turned_into
from flexopt.selection.broken import AT_END, beyond_bounds
from flexopt.selection.problem import SelectionProblem, value_at
from flexopt.selection.starts import idle_joints, violated

# Joints that differ by less, in scaled variables, are the same posture.
SAME_POSTURE = 1e-4
# What may change along the way from one to the other: of the target, constraints and w_i, relative to their scales.
ALIKE = 1e-6
# What turns a machine about a target; angles looked at, and how many how often between the best one's neighbours.
TURNING, TURNS, ZOOMED, ZOOMS = ("x", "y", "yaw"), 180, 20, 8
# How near to its rows a turned configuration is, in their scales.
ON_ROWS = 1e-9
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


def turns(problem: SelectionProblem) -> bool:
    """Whether the machine may be turned about its target: where it stands on flat ground no measure sees that."""
    names, rows = problem.machine.base_coordinates, problem.machine.task_rows
    at = [names.index(name) for name in TURNING if name in names]
    free = len(at) == len(TURNING) and bool(np.all(problem.lower[at] < problem.upper[at]))
    return free and "x" in rows and "y" in rows


def travel(problem: SelectionProblem, z: Vector) -> float:
    """How far z is from the present configuration, or from zeros, Σ ((z − now) / scale)²."""
    return float(_travels(problem, z))


def way_to(problem: SelectionProblem, z: Vector) -> Vector:
    """From the present configuration, or from zeros, to z (n_z,), m or rad, the short way round."""
    way: Vector = between(problem, _now(problem), z) * problem.scale
    return way


def _travels(problem: SelectionProblem, z: Vector) -> Vector:
    """The same of each z (…, n_z)."""
    far: Vector = np.sum(between(problem, _now(problem), z) ** 2, axis=-1)
    return far


def between(problem: SelectionProblem, z: Vector, other: Vector) -> Vector:
    """From z to the other, (…, n_z) in scaled variables, the short way round for angles without limits."""
    away, turning = other - z, problem.turning
    away[..., turning] = (away[..., turning] + math.pi) % math.tau - math.pi
    scaled: Vector = away / problem.scale
    return scaled


def _now(problem: SelectionProblem) -> Vector:
    now, n_base = np.zeros(problem.scale.size), len(problem.machine.base_coordinates)
    if problem.present_base is not None:
        now[:n_base] = problem.present_base
    if problem.present_posture is not None:
        now[n_base:] = problem.present_posture
    return now


def same(problem: SelectionProblem, z: Vector, other: Vector) -> bool:
    """Whether the two are one configuration."""
    return float(np.abs(between(problem, z, other)).max()) <= SAME_POSTURE


def nearest(problem: SelectionProblem, z: Vector, keeps: Callable[[Vector], bool] | None = None) -> Vector:
    """Of configurations that no measure tells from z the one nearest to the present one, see `travel`.

    These are z after whole turns of joints, with joints at other angles that nothing depends on, such as the roll of a
    tool about its own axis, and turned about the target; and with a base elsewhere where the task does not see it. What
    breaks a constraint is left out, and so is all where travel costs. `keeps`: whether a configuration does whatever
    else is asked.
    """
    if problem.travel is not None:
        return z
    here, now = unwound(problem, z, keeps), _now(problem)
    for k in (*range(len(problem.machine.base_coordinates)), *idle_joints(problem, here)):
        moved = here.copy()
        moved[k] = np.clip(now[k], problem.lower[k], problem.upper[k])
        here = moved if _as_good(problem, z, moved, keeps) else here
    return _turned(problem, here, keeps)


def nearest_stand(
    problems: Sequence[SelectionProblem], zs: list[Vector], keeps: Callable[[list[Vector]], bool] | None = None
) -> list[Vector]:
    """Of stands that no measure tells from zs, z (n_z,) at each target, the one nearest to the present configuration.

    Its joints are whole turns nearer, and its base stands where it does now along coordinates that no target's task
    sees. `keeps`: whether a stand does whatever else is asked.
    """
    if any(problem.travel is not None for problem in problems):
        return zs
    here, first = [unwound(problem, z) for problem, z in zip(problems, zs, strict=True)], problems[0]
    here = here if keeps is None or keeps(here) else zs
    now = _now(first)
    for k in range(len(first.machine.base_coordinates)):
        moved = [z.copy() for z in here]
        for z in moved:
            z[k] = np.clip(now[k], first.lower[k], first.upper[k])
        if all(_as_good(*each) for each in zip(problems, here, moved, strict=True)):
            here = moved if keeps is None or keeps(moved) else here
    return here


def unwound(problem: SelectionProblem, z: Vector, keeps: Callable[[Vector], bool] | None = None) -> Vector:
    """The configuration z with its joints whole turns nearer to the present ones, where travel does not cost."""
    if problem.travel is not None:
        return z
    here, now = z, _now(problem)
    for k in range(len(problem.machine.base_coordinates), z.size):
        if problem.variables[k].unit == "rad" and not problem.turning[k]:
            turned = here.copy()
            turned[k] = _whole_turns(z[k], now[k], problem.lower[k], problem.upper[k])
            here = turned if _as_good(problem, z, turned, keeps) else here
    return here


def past_stops(problem: SelectionProblem, z: Vector) -> Vector | None:
    """The configuration z with joints that rest at an end of their angles a whole turn away, where no measure tells.

    A climb that a joint's limit stopped goes on from there. None where no joint rests at one that it may be away from.
    """
    here = z.copy()
    for k in range(len(problem.machine.base_coordinates), z.size):
        ends = problem.lower[k], problem.upper[k]
        if problem.variables[k].unit == "rad" and ends[1] - ends[0] >= math.tau:
            others = [end for end in ends if abs(z[k] - end) > AT_END * problem.scale[k]]
            turned = here.copy()
            turned[k] = z[k] - math.tau if others == [ends[0]] else z[k] + math.tau
            if len(others) == 1 and _kept(problem, turned) and _alike(problem, z, turned):
                here = np.clip(turned, problem.lower, problem.upper)
    return None if np.array_equal(here, z) else here


def _whole_turns(angle: float, now: float, lower: float, upper: float) -> float:
    """The angle within its limits, whole turns away, that is nearest to the present one; of two the greater."""
    first, last = math.ceil((lower - angle) / math.tau), math.floor((upper - angle) / math.tau)
    others = [angle + math.tau * k for k in range(first, last + 1)]
    return min(others, key=lambda other: (round(abs(other - now), 5), -other), default=angle)


def _as_good(
    problem: SelectionProblem, z: Vector, other: Vector, keeps: Callable[[Vector], bool] | None = None
) -> bool:
    """Whether the other is nearer, keeps everything, and has the same measures."""
    return (
        travel(problem, other) < travel(problem, z) + ALIKE
        and bool(np.abs(beyond_bounds(problem, other)).max() <= ON_ROWS)
        and _alike(problem, z, other)
        and (keeps is None or keeps(other))
    )


def turned_about(problem: SelectionProblem, z: Vector, angles: Vector) -> Vector:
    """The configurations (n_z, N) that z becomes when it is turned about its target, where it may be; see `turns`."""
    names, rows = problem.machine.base_coordinates, problem.machine.task_rows
    at = [names.index(name) for name in TURNING]
    target = np.array([problem.target[rows.index(name)] for name in "xy"])
    way = np.exp(1j * angles) * complex(*(z[at[:2]] - target))
    places = np.repeat(z[:, None], angles.size, axis=1)
    places[at] = np.array([target[0] + way.real, target[1] + way.imag, z[at[2]] + angles])
    n_base = len(names)
    places[:n_base] = turned_into(places[:n_base], (problem.lower, problem.upper), problem.machine.base_units)
    return problem.wrapped(places.T).T


def _turned(problem: SelectionProblem, z: Vector, keeps: Callable[[Vector], bool] | None) -> Vector:
    """The configuration turned about its target to where it is nearest."""
    if not turns(problem):
        return z
    angle, span = 0.0, math.pi
    # A grid, and grids between the neighbours of the best again: the way may end at walls and bounds.
    for count in (TURNS, *(ZOOMED,) * ZOOMS):
        angles = angle + np.linspace(-span, span, count + 1)
        places = turned_about(problem, z, angles)
        inside = np.all((places >= problem.lower[:, None]) & (places <= problem.upper[:, None]), axis=0)
        kept = inside & (violated(problem, places) <= ON_ROWS)
        far = np.where(kept, _travels(problem, places.T), np.inf)
        angle, span = float(angles[int(np.argmin(far))]), 2 * span / count
    place = turned_about(problem, z, np.array([angle]))[:, 0]
    nearer = travel(problem, place) < travel(problem, z) - ALIKE
    return place if nearer and _as_good(problem, z, place, keeps) else z


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
        place[problem.machine.base_coordinates.index(name)] = value
    n_base, ends = len(problem.machine.base_coordinates), (problem.lower, problem.upper)
    place[:n_base] = turned_into(place[:n_base], ends, problem.machine.base_units)
    outside = np.maximum(ends[0] - place, place - ends[1])[:n_base]
    return None if outside.max(initial=0.0) > 0 else problem.wrapped(place)


def _alike(problem: SelectionProblem, z: Vector, other: Vector) -> bool:
    """Whether every w_i and every objective is the same."""
    one, two = (
        np.append(problem.quantities.w_at(at), [value_at(problem, at, objective) for objective in problem.objectives])
        for at in (z, other)
    )
    m = one.size - len(problem.objectives)
    sizes = np.array([problem.measure_scale] * m + list(problem.objective_scales))
    return bool(np.all(np.abs(one - two) <= ALIKE * np.maximum(sizes, np.abs(one))))


def _kept(problem: SelectionProblem, z: Vector) -> bool:
    """Whether z reaches the target and keeps the constraints."""
    return bool(np.abs(beyond_bounds(problem, z)).max() <= ALIKE)
