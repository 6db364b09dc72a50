"""Inverse kinematics: postures that put the end-point on a target.

In: a machine or its plant, targets, placements. Out: all postures of one placement (`inverse_kinematics`), those of an
elbow of a planar arm in closed form (`branch`), and by iteration, for any machine and many placements and starts at
once, those that starts lead to (`solve_postures`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from functools import lru_cache
from typing import Any, cast

import casadi as ca
import numpy as np

from flexopt.algebra.feasible import feasible_steps, repeated, shortest_steps
from flexopt.errors import NoSolutionFound, UnreachableTarget
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import BaseLike, TargetLike, Vector
from flexopt.foundation.boundary import public
from flexopt.model import AnyMachine
from flexopt.model.choices import Elbow
from flexopt.plant.plant import Plant, build_plant
from flexopt.plant.reach import arm_length, missed, sampled_ranges, unreachable
from flexopt.plant.statics import check_held

ELBOW_SIGN: dict[Elbow, float] = {"up": -1.0, "down": 1.0}
SAMPLES = 256
# So many of these are led to a target as the machine sags, which at rest is out of reach.
NEAREST = 64
# Postures closer than this, found by iteration, are one.
SAME = 1e-6
# A target is reached to this share of a metre, position and orientation rows alike.
REACHED = 1e-10
# Rounds in which the sag of a posture settles: each leaves the share by which it changes with the posture.
SAGS = 40
# How far off a posture of a machine that sags may be, as a share of the arm, to start from.
NEARLY = 1e-3
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
    for name, sign in ELBOW_SIGN.items():
        if elbow in (None, name):
            postures, reaches = branch(plant, point, bases, unit, sign)
            reached += list(postures[:, reaches].T)
    if gravity and reached:
        settled = [_under_gravity(plant, point, placement, posture) for posture in reached]
        reached = list(into_limits(machine, np.array(settled).T).T)
    found = [posture for posture in reached if inside_limits(machine, posture[:, None])[0]]
    if not found and (gravity or (reached and free)):
        # Narrow limits may lie between the points of the sample, and the border of the reach is another as the machine
        # sags: Newton steps lead into them.
        with suppress(UnreachableTarget):
            moved = _by_iteration(plant, point, placement, gravity, seed)
            found = [posture for posture in moved if elbow is None or np.sin(posture[-1]) * ELBOW_SIGN[elbow] > 0]
    if not found:
        bent = "" if elbow is None else f" with the elbow {elbow}"
        why = f"every posture{bent} that reaches it breaks a joint limit" if reached else ""
        raise unreachable(plant, point, placement, why)
    return _distinct(found)


def _by_iteration(plant: Plant, target: Vector, base: Vector, gravity: bool, seed: int) -> list[Vector]:
    low, high = sampled_ranges(plant.machine, arm_length(plant)).T
    starts = low[:, None] + (high - low)[:, None] * low_discrepancy(plant.n_actuated, SAMPLES, seed)
    bases = np.repeat(base[:, None], SAMPLES, axis=1)
    postures, left = solve_postures(plant, target, bases, starts)
    reached, broken = list(postures[:, left <= REACHED].T), ""
    if gravity:
        settled = (_under_gravity(plant, target, base, posture) for posture in _distinct(reached, SAME))
        broken = "every posture that reaches it breaks a joint limit under gravity" if reached else ""
        reached = [posture for posture in settled if inside_limits(plant.machine, posture[:, None])[0]]
        if not reached:
            # The border of the reach is another as the machine sags: the nearest are led there.
            nearest = np.argsort(left, kind="stable")[:NEAREST]
            postures, held = solve_held(plant, target, bases[:, nearest], postures[:, nearest])
            reached, left = list(postures[:, held <= REACHED].T), np.append(left, held)
    if not reached:
        # Where springs hold no posture it is as far off as at rest.
        raise missed(plant, target, base, float(np.nanmin(left)), broken)
    turned = list(into_limits(plant.machine, _nearest_turn(plant, np.array(reached).T)).T)
    return _distinct(sorted(turned, key=lambda posture: float(np.abs(posture - (low + high) / 2).max())), SAME)


def _nearest_turn(plant: Plant, postures: Vector) -> Vector:
    """Hinges without limits (n, N) between −π and π."""
    turned = postures.copy()
    for row, (unit, limits) in enumerate(zip(plant.machine.joint_units, plant.machine.limits, strict=True)):
        if unit == "rad" and not np.isfinite(limits).any():
            turned[row] = (turned[row] + math.pi) % (2 * math.pi) - math.pi
    return turned


@lru_cache(maxsize=32)
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


def solve_held(plant: Plant, target: Vector, bases: Vector, starts: Vector) -> tuple[Vector, Vector]:
    """As `solve_postures`, with the end-point of the machine as it sags under its weight on the target.

    Each round aims at rest beside the target by what the last posture sags, which hardly changes from one to the next.
    """
    p, postures = plant.parameter_values, starts

    def sag() -> Vector:
        at_rest = plant.rest.call([bases, postures, p])[0]
        sagged = ca.vertcat(plant.deflected.call([bases, postures, p])[0], postures)
        return (plant.end_point.call([at_rest, bases, p])[0] - plant.end_point.call([sagged, bases, p])[0]).full()

    sunk, off = sag(), np.full(starts.shape[1], math.inf)
    for _ in range(SAGS):
        postures, left = solve_postures(plant, target.reshape(plant.n_task, -1) + sunk, bases, postures)
        before, sunk = sunk, sag()
        off = left + np.abs(sunk - before).max(axis=0)
        if np.all(off <= REACHED):
            break
    return postures, off


def held_on(plant: Plant, target: Vector, bases: Vector, postures: Vector) -> Vector:
    """Of postures (n, N) that reach the target at rest, those near them with which the machine as it sags does.

    Where none is found, as where it falls over, the posture as it is.
    """
    p, count = plant.parameter_values, postures.shape[1]
    targets = np.repeat(target.reshape(-1, 1), count, axis=1)
    found = plant.held.call([bases, postures, p, targets])[0].full()
    q = np.vstack([plant.deflected.call([bases, found, p])[0].full(), found])
    off = np.abs(plant.end_point.call([q, bases, p])[0].full() - targets).max(axis=0, initial=0.0)
    return np.where(off <= NEARLY * arm_length(plant), found, postures)


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


def _distinct(postures: list[Vector], tolerance: float = 1e-7) -> list[Vector]:
    """The same list without repeats (both elbows agree where the arm is straight)."""
    points, kept = np.array(postures), np.ones(len(postures), dtype=bool)
    for i in range(len(postures)):
        if kept[i]:
            kept[i + 1 :] &= np.abs(points[i + 1 :] - points[i]).max(axis=1) > tolerance
    return [posture for posture, keep in zip(postures, kept, strict=True) if keep]


def _under_gravity(plant: Plant, target: Vector, base: Vector, posture: Vector) -> Vector:
    """Newton's method from the posture at rest to the one whose deflected end-point is on the target."""
    p = plant.parameter_values

    def settled(posture: Vector) -> Vector:
        return np.concatenate([plant.deflected(base, posture, p).full().ravel(), posture])

    def linear(posture: Vector) -> tuple[Vector, Vector]:
        q = settled(posture)
        return plant.end_point(q, base, p).full().ravel() - target, plant.rigid_jacobian(q, base, p).full()

    tolerance = 1e-13 * (1 + float(np.abs(target).max()))
    posture, off = shortest_steps(linear, posture, np.ones(posture.size), tolerance, steps=20)
    check_held(plant, settled(posture), base)
    if not off < 1e-9:
        raise NoSolutionFound(
            f"inverse kinematics under gravity did not converge: the deflected end-point stays {off:.3g} m off the "
            "target; stiffer springs would help",
            violations={"target": off},
            iterate={name: float(angle) for name, angle in zip(plant.machine.joints, posture, strict=True)},
        )
    return posture
