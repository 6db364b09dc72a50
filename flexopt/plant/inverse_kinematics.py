"""Inverse kinematics: postures that put the end-point on a target.

In: a machine or its plant, targets, placements. Out: all postures of one placement (`inverse_kinematics`), those of an
elbow of a planar arm in closed form (`branch`), and by iteration, for any machine and many placements and starts at
once, those that starts lead to, with springs unloaded (`solve_postures`) or as it sags (`solve_held`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.algebra.feasible import feasible_steps, repeated
from flexopt.errors import UnreachableTarget
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import BaseLike, TargetLike, Vector
from flexopt.foundation.boundary import public
from flexopt.foundation.kept import by_structure
from flexopt.model import AnyMachine
from flexopt.model.choices import Elbow
from flexopt.plant.plant import Plant, build_plant
from flexopt.plant.reach import arm_length, missed, reach, sampled_ranges, unreachable
from flexopt.plant.statics import holding, not_held

ELBOW_SIGN: dict[Elbow, float] = {"up": -1.0, "down": 1.0}
SAMPLES = 256
# So many of these, the nearest, are led to a target as the machine sags.
NEAREST = 64
# Postures closer than this, found by iteration, are one; closer than these, in hinges and in slides as a share of the
# arm, where what lies between them is on the target, too: so far apart steps leave an arm that is straight.
SAME, ALIKE = 1e-6, (1e-2, 1e-4)
# A target is reached to this share of a metre, position and orientation rows alike.
REACHED = 1e-10
# A row of springs in units of what so much gives way, m or rad: rather is the end-point off than that they do not hold.
HOLD = 0.1
# Least distance from the border of the reach, as a share of it, at which an elbow is bent enough to say which it is.
INSIDE = 1e-3
# How far off a posture of a machine that sags may be, as a share of the arm, to start from.
NEARLY = 1e-3
# How far beside a straight arm others are started from, rad, and as a share of its length.
BESIDE = 0.3
# Rounding may push |cos| past 1 by this much on the edge of the reach.
EDGE = 1e-12


def _branches(arguments: Arguments, given: Mapping[str, Any]) -> None:
    if given["elbow"] is not None and arguments.of is not None and not build_plant(arguments.of).closed_form:
        arguments.note("elbow", "names a branch of planar arms only", given["elbow"])


@public(together=_branches)
def inverse_kinematics(
    machine: AnyMachine,
    target: TargetLike,
    *,
    base: BaseLike | None = None,
    gravity: bool = False,
    elbow: Elbow | None = None,
    seed: int = 0,
) -> list[Vector]:
    """Postures q_a (n,) in rad or m with r(q) = target, passive joints at rest, inside the joint limits.

    A planar arm of two actuated hinges: every branch in closed form, elbow up (last joint negative) before elbow down;
    of more: a set of distinct postures, both branches of the last two joints over a low-discrepancy sample of the
    redundancy. Other machines: the distinct ends of damped Newton steps from a low-discrepancy sample of the joint
    ranges, the nearest to the middle of the ranges (0 of a joint without limits) first: with as many joints as task
    rows every branch that a sample leads to, with more joints a sample of the self-motion.

    Args:
        machine: from `flexopt.load`.
        target: the task (n_task,), m, inertial frame.
        base: placement (n_b,), m or rad: of a planar machine x alone; the origin by default.
        gravity: the end-point under static deflection, instead of at rest.
        elbow: keep only the branch `"up"` or `"down"` of a planar arm's last two joints; both by default.
        seed: shifts the sample.

    Raises:
        InputError: an argument is not finite or has the wrong shape.
        UnreachableTarget: by how many metres, and for planar machines from which placements it would be reachable.

    Example:
        >>> machine = flexopt.load("excavator")
        >>> [posture.round(3).tolist() for posture in flexopt.inverse_kinematics(machine, (0.0, 1.6))]
        [[0.993, -2.63], [-0.026, 2.63]]
    """
    plant, point = build_plant(machine), cast(Vector, target)
    placement = np.zeros(plant.n_base) if base is None else cast(Vector, base)
    if not plant.closed_form:
        return _by_iteration(plant, point, placement, gravity, seed)
    free = plant.n_actuated - 2
    unit = low_discrepancy(free, SAMPLES, seed) if free else np.zeros((0, 1))
    bases = np.repeat(placement[:, None], unit.shape[1], axis=1)
    reached: list[Vector] = []
    starts = inside_reach(plant, point, placement[:, None])[0] if gravity else point
    for name, sign in ELBOW_SIGN.items():
        if elbow in (None, name):
            postures, reaches = branch(plant, starts, bases, unit, sign)
            reached += list(postures[:, reaches].T)
    sagging, why = None, ""
    if gravity:
        starts = np.array(reached).reshape(-1, plant.n_actuated).T
        # Weight on soft springs may bend an arm that is nearly straight the other way.
        more = NEAREST // starts.shape[1] if starts.size else 0
        reached, sagging = _settled(plant, point, placement, _with_others(plant, starts, np.tile(starts, more), seed))
    found = [posture for posture in reached if inside_limits(machine, posture[:, None])[0]]
    if not found and (gravity or (reached and free)):
        # Narrow limits may lie between the points of the sample: Newton steps lead into them.
        try:
            found = _by_iteration(plant, point, placement, gravity, seed)
        except UnreachableTarget as nearer:
            sagging = min(sagging, nearer.miss) if sagging is not None else None
    if found and (gravity or elbow is not None):
        # Steps from far off, too, may bend it the other way.
        bends = plant.elbow.call([placement, np.array(found).T, plant.parameter_values])[0].full().ravel()
        order: list[int] = np.argsort(bends > SAME, kind="stable").tolist()
        sign = 0.0 if elbow is None else ELBOW_SIGN[elbow]
        found = [found[k] for k in order if sign * bends[k] >= -SAME]
        why = "" if found else f"no posture that was found to reach it has the elbow {elbow}"
    if not found:
        if reached and not gravity:
            bent = "" if elbow is None else f" with the elbow {elbow}"
            why = f"every posture{bent} that reaches it breaks a joint limit"
        raise unreachable(plant, point, placement, why, sagging=sagging)
    return told_once(plant, found, point, placement, gravity=True) if gravity else distinct(plant, found, 1e-7)


def inside_reach(plant: Plant, target: Vector, bases: Vector) -> tuple[Vector, Vector]:
    """The points (2, N) nearest to a target at which a planar arm is bent, springs unloaded; how far off they are, m.

    Each elbow sags from there to the target of placements (1, N).
    """
    annulus = reach(plant)
    center = annulus.center[:, None] + np.vstack([bases, np.zeros_like(bases)])
    away, least = target[:, None] - center, min(INSIDE * annulus.outer, (annulus.outer - annulus.inner) / 4)
    distance = np.hypot(*away)
    inside = np.clip(distance, annulus.inner + least, annulus.outer - least)
    along = np.where(distance > 0, away / np.where(distance > 0, distance, 1.0), [[1.0], [0.0]])
    off = np.abs(distance - inside)
    return np.where(off > 0, center + along * inside, target[:, None]), off


def _by_iteration(plant: Plant, target: Vector, base: Vector, gravity: bool, seed: int) -> list[Vector]:
    low, high = sampled_ranges(plant.machine, arm_length(plant)).T
    starts = low[:, None] + (high - low)[:, None] * low_discrepancy(plant.n_actuated, SAMPLES, seed)
    bases = np.repeat(base[:, None], SAMPLES, axis=1)
    postures, left = solve_postures(plant, target, bases, starts)
    reached = list(postures[:, left <= REACHED].T)
    off = float(np.nanmin(left))
    if gravity:
        if reached:
            reached, off = _settled(plant, target, base, np.array(distinct(plant, reached, SAME)).T)
        if not reached:
            # The border of the reach is another as the machine sags.
            z, limits = np.vstack([bases, postures]), _limits(plant)
            _, held, miss = led_from_nearest(plant, target, z, left, seed, limits, standing=True)
            reached, off = _on_target(plant, held[plant.n_base :], miss)
    if not reached:
        raise missed(plant, target, base, off)
    turned = list(into_limits(plant.machine, _nearest_turn(plant, np.array(reached).T)).T)
    middle = (low + high) / 2
    nearest = sorted(turned, key=lambda posture: float(np.abs(posture - middle).max()))
    return told_once(plant, nearest, target, base, gravity=gravity)


def _nearest_turn(plant: Plant, postures: Vector) -> Vector:
    """Hinges without limits (n, N) between −π and π."""
    turned = postures.copy()
    for row, (unit, limits) in enumerate(zip(plant.machine.joint_units, plant.machine.limits, strict=True)):
        if unit == "rad" and not np.isfinite(limits).any():
            turned[row] = (turned[row] + math.pi) % (2 * math.pi) - math.pi
    return turned


@by_structure
def reach_steps(machine: AnyMachine) -> ca.Function:
    """`feasible_steps` of the task at rest in z = [base, posture]; the last input is p."""
    g = build_plant(machine).graph
    task = ca.substitute(g.end_point, g.q, g.rest)
    return feasible_steps(task, ca.vertcat(g.base, g.posture), [g.p])


def solve_postures(plant: Plant, target: Vector, bases: Vector, starts: Vector) -> tuple[Vector, Vector]:
    """Postures inside the joint limits with the end-point on the target, passive joints at rest.

    Args:
        plant: the machine's plant.
        target: (n_task,) or (n_task, N), m, inertial frame.
        bases: placements (n_b, N) or (n_b,), m or rad.
        starts: postures to start from (n, N), rad or m; each leads to at most one solution.

    Returns:
        postures (n, N), rad or m, and the largest row of r − target, (N,), m: at most `REACHED` where it is reached.
    """
    n_b, n = plant.n_base, plant.n_actuated
    low, high = (np.array(ends) for ends in zip(*plant.machine.limits, strict=True))
    count = starts.shape[1]
    bases = np.broadcast_to(bases.reshape(n_b, -1) if n_b else np.zeros((0, 1)), (n_b, count))
    goals = np.broadcast_to(target.reshape(plant.n_task, -1), (plant.n_task, count))
    z = np.vstack([bases, np.clip(starts, low[:, None], high[:, None])])
    bounds = np.concatenate([np.full(n_b, -np.inf), low]), np.concatenate([np.full(n_b, np.inf), high])
    free = np.concatenate([np.zeros(n_b), np.ones(n)])
    length = arm_length(plant)
    scale = np.concatenate([np.ones(n_b), [1.0 if unit == "rad" else length for unit in plant.machine.joint_units]])
    z, left = repeated(
        reach_steps(plant.machine), z, (*bounds, free, scale), (goals, goals, np.ones(plant.n_task)),
        [plant.parameter_values], REACHED,
    )  # fmt: skip
    return z[n_b:], left


@by_structure
def held_steps(machine: AnyMachine) -> ca.Function:
    """`feasible_steps` of what springs and weight leave over and of the task in z = [base, q]; the last input is p."""
    plant = build_plant(machine)
    g = plant.graph
    return feasible_steps(plant.held_rows, ca.vertcat(g.base, g.q), [g.p])


def solve_held(plant: Plant, target: Vector, bases: Vector, starts: Vector) -> tuple[Vector, Vector]:
    """As `solve_postures`, with the end-point of the machine as it sags under its weight on the target."""
    z, off = held_within(plant, target, np.vstack([bases, starts]), _limits(plant), standing=True)
    return z[plant.n_base :], off


def _limits(plant: Plant) -> tuple[Vector, Vector]:
    """Ends of [base, posture], (n_b + n,) each: the joints' limits."""
    low, high = (np.array(ends) for ends in zip(*plant.machine.limits, strict=True))
    return np.append(np.full(plant.n_base, -np.inf), low), np.append(np.full(plant.n_base, np.inf), high)


def held_within(
    plant: Plant, target: Vector, z: Vector, ends: tuple[Vector, Vector], *, standing: bool = False
) -> tuple[Vector, Vector]:
    """Points z = [base, posture], (n_b + n, N), moved within ends to where the machine as it sags is on its target.

    Steps move base and arm and let the springs give way at once. How far off a point is, is told of where the springs
    hold the machine then: infinite where they do not. `standing`: the base stays.
    """
    p, m, n_b = plant.parameter_values, plant.n_passive, plant.n_base
    low, high = ends
    z = np.clip(z, low[:, None], high[:, None])
    bases, starts = z[:n_b], z[n_b:]
    goals = np.broadcast_to(target.reshape(plant.n_task, -1), (plant.n_task, z.shape[1]))
    rest = plant.rest.call([bases, starts, p])[0].full()[:m]
    sagged = plant.deflected.call([bases, starts, p])[0].full()
    q_p = cast(Vector, np.where(np.isfinite(sagged), sagged, rest))
    free = (low < high).astype(float)
    free[: n_b * standing] = 0.0
    free, low, high = (
        np.insert(of_z, n_b, np.full(m, given)) for of_z, given in ((free, 1), (low, -np.inf), (high, np.inf))
    )
    length = arm_length(plant)
    units = [*plant.machine.base_units, *plant.graph.coordinate_units]
    scale = np.array([1.0 if unit == "rad" else length for unit in units])
    springs = HOLD * np.diag(plant.stiffness.call([p])[0].full())[:m]
    rows = np.vstack([np.zeros((m, goals.shape[1])), goals])
    of_rows = rows, rows, np.append(np.where(springs > 0, springs, 1.0), np.ones(plant.n_task))
    of_z = low, high, free, scale
    found = repeated(held_steps(plant.machine), np.vstack([bases, q_p, starts]), of_z, of_rows, [p], REACHED)[0]
    found = np.delete(found, np.s_[n_b : n_b + m], axis=0)
    return found, sagging_off(plant, goals, found[:n_b], found[n_b:])


def led_from_nearest(
    plant: Plant,
    target: Vector,
    z: Vector,
    left: Vector,
    seed: int,
    ends: tuple[Vector, Vector],
    *,
    standing: bool = False,
) -> tuple[NDArray[np.int64], Vector, Vector]:
    """As `held_within`, from the nearest of points z (n_b + n, N) that are off their target, at rest, by `left` (N,).

    From a straight arm steps lead to one side alone: others beside each are led, too. Where none reaches the target and
    springs hold few of them, that is why, and all count as held by none.

    Returns:
        From which of the points each comes (k,), points (n_b + n, k), and how far off they are, (k,), m.
    """
    chosen = np.tile(np.argsort(np.nan_to_num(left, nan=math.inf), kind="stable")[:NEAREST], 2)
    nearest = z[plant.n_base :, chosen[: chosen.size // 2]]
    starts = np.vstack([z[: plant.n_base, chosen], _with_others(plant, nearest, nearest, seed)])
    held, off = held_within(plant, target, starts, ends, standing=standing)
    return chosen, held, np.full(off.size, math.inf) if _mostly_falls(off) else off


def _with_others(plant: Plant, postures: Vector, these: Vector, seed: int) -> Vector:
    """Postures (n, N), and behind them others beside these (n, M)."""
    length = arm_length(plant)
    scale = np.array([1.0 if unit == "rad" else length for unit in plant.machine.joint_units])
    aside = np.random.default_rng(seed).standard_normal(these.shape)
    return np.hstack([postures, these + BESIDE * scale[:, None] * aside])


def _mostly_falls(off: Vector) -> bool:
    return bool(np.min(off, initial=math.inf) > REACHED and np.mean(np.isinf(off)) > 0.5)


def sagging_off(plant: Plant, target: Vector, bases: Vector, postures: Vector) -> Vector:
    """How far off its target, (n_task,) or (n_task, N), the end-point of the machine as it sags is, (N,), m.

    Infinite where no springs hold it.
    """
    p = plant.parameter_values
    q = np.vstack([plant.deflected.call([bases, postures, p])[0].full(), postures])
    off = np.abs(plant.end_point.call([q, bases, p])[0].full() - target.reshape(plant.n_task, -1)).max(axis=0)
    return np.where(np.isfinite(off) & holding(plant, q, bases), off, math.inf)


def _settled(plant: Plant, target: Vector, base: Vector, starts: Vector) -> tuple[list[Vector], float]:
    """Postures of the machine as it sags that starts (n, N) lead to, and how far off the nearest is, m."""
    return _on_target(plant, *solve_held(plant, target, np.repeat(base[:, None], starts.shape[1], axis=1), starts))


def _on_target(plant: Plant, postures: Vector, off: Vector) -> tuple[list[Vector], float]:
    """Those of postures (n, N) that are off by nothing, and how far off the nearest is, m.

    Raises:
        InputError: the springs hold few, and none there.
    """
    if _mostly_falls(off):
        raise not_held()
    return list(into_limits(plant.machine, postures[:, off <= REACHED]).T), float(off.min())


def held_on(plant: Plant, target: Vector, bases: Vector, postures: Vector) -> tuple[Vector, Vector]:
    """Of postures (n, N) that reach the target at rest, those near them with which the machine as it sags does.

    Where none is found, as where it falls over, the posture as it is. And how far off they then are, (N,), m: infinite
    where none is found.
    """
    p, count = plant.parameter_values, postures.shape[1]
    targets = np.repeat(target.reshape(-1, 1), count, axis=1)
    found = plant.held.call([bases, postures, p, targets])[0].full()
    off = sagging_off(plant, targets, bases, found)
    near = off <= NEARLY * arm_length(plant)
    return np.where(near, found, postures), np.where(near, off, math.inf)


def branch(plant: Plant, target: Vector, bases: Vector, unit: Vector, sign: float) -> tuple[Vector, Any]:
    """One elbow branch over many placements at once.

    Args:
        plant: the machine's plant.
        target: (2,) or (2, N), m, inertial frame.
        bases: (n_b, N) placements.
        unit: (n − 2, N) coordinates in [0, 1] of the joints before the last two, see `InverseKinematicsGraph`.
        sign: −1 elbow up, +1 elbow down.

    Returns:
        postures (n, N), shifted by 2π into the joint limits where possible, and a mask (N,) of those that reach.
    """
    count = bases.shape[1]
    targets, signs = np.broadcast_to(target.reshape(2, -1), (2, count)), np.full((1, count), sign)
    out = plant.posture_at.call([targets, bases, unit, signs, plant.parameter_values])
    postures, cosine = out[0].full(), out[1].full().ravel()
    return into_limits(plant.machine, postures), np.abs(cosine) <= 1 + EDGE


def into_limits(machine: AnyMachine, postures: Vector) -> Vector:
    """The same postures (n, N), turned by multiples of 2π into the joint limits where they can be, to their middle."""
    turned = postures.copy()
    for row, (unit, (low, high)) in enumerate(zip(machine.joint_units, machine.limits, strict=True)):
        if unit == "rad" and math.isfinite(low):
            turns = 2 * math.pi * np.rint((0.5 * (low + high) - postures[row]) / (2 * math.pi))
            inside = (postures[row] + turns >= low - EDGE) & (postures[row] + turns <= high + EDGE)
            turned[row] += np.where(inside, turns, 0.0)
    return turned


def inside_limits(machine: AnyMachine, postures: Vector) -> Any:
    """Mask (N,) of the postures (n, N) that keep every joint limit."""
    low, high = np.array(machine.limits).T[:, :, None]
    return np.all((postures >= low - EDGE) & (postures <= high + EDGE), axis=0)


def low_discrepancy(dimensions: int, count: int, seed: int) -> Vector:
    """(dimensions, count) points in the unit cube: Kronecker's sequence on the generalised golden ratio.

    The ratio g solves g^(d+1) = g + 1 and the steps are g^−1 … g^−d, which fill the cube evenly for every count.
    """
    ratio = 2.0
    for _ in range(64):
        ratio = (1 + ratio) ** (1 / (dimensions + 1))
    steps = ratio ** -np.arange(1, dimensions + 1)
    shift = np.random.default_rng(seed).random(dimensions)
    return (shift[:, None] + steps[:, None] * np.arange(count)) % 1.0


def told_once(
    plant: Plant, postures: list[Vector], target: Vector, base: Vector, tolerance: float = SAME, *, gravity: bool
) -> list[Vector]:
    """Postures that steps led to one target from one placement, each once."""

    def on_target(some: Vector) -> NDArray[np.bool_]:
        bases, p = np.repeat(base[:, None], some.shape[1], axis=1), plant.parameter_values
        if gravity:
            off = sagging_off(plant, target, bases, some)
        else:
            q = plant.rest.call([bases, some, p])[0]
            off = np.abs(plant.end_point.call([q, bases, p])[0].full() - target[:, None]).max(axis=0)
        # Where either end is off by `REACHED`, to one side each.
        return off <= 2 * REACHED

    return distinct(plant, postures, tolerance, on_target)


def distinct(
    plant: Plant,
    postures: list[Vector],
    tolerance: float,
    on_target: Callable[[Vector], NDArray[np.bool_]] | None = None,
) -> list[Vector]:
    """The list without repeats, by whole turns of hinges that can make them, too (a straight arm's elbows agree).

    `on_target`: of postures (n, N); with it two that are `ALIKE` are one where what lies between them is on it.
    """
    points, kept, units = np.array(postures), np.ones(len(postures), dtype=bool), plant.machine.joint_units
    # Slides of a small machine are short.
    scale = np.array([1.0 if unit == "rad" else min(1.0, arm_length(plant)) for unit in units])
    alike = np.array([ALIKE[unit != "rad"] for unit in units])
    limits = zip(units, plant.machine.limits, strict=True)
    turn = np.array(
        [math.tau if unit == "rad" and high - low >= math.tau else math.inf for unit, (low, high) in limits]
    )
    for i in range(len(postures)):
        if kept[i]:
            apart = points[i + 1 :] - points[i]
            apart -= np.where(np.isfinite(turn), turn, 0.0) * np.rint(apart / turn)
            far = np.abs(apart / scale)
            kept[i + 1 :] &= far.max(axis=1) > tolerance
            near = np.flatnonzero(kept[i + 1 :] & np.all(far <= alike, axis=1))
            if on_target is not None and near.size:
                one = on_target((points[i] + apart[near] / 2).T)
                kept[i + 1 + near[one]] = False
    return [posture for posture, keep in zip(postures, kept, strict=True) if keep]
