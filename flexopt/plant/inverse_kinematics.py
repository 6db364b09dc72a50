"""All postures that put the end-point on a target from a given placement."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from flexopt.errors import NoSolutionFound
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Vector
from flexopt.foundation.boundary import public
from flexopt.model import AnyMachine
from flexopt.model.problem import Elbow
from flexopt.plant.plant import Plant, build_plant
from flexopt.plant.reach import missed, unreachable
from flexopt.plant.reaching import REACHED, joint_box, nearest_postures
from flexopt.plant.statics import check_held

ELBOW_SIGN: dict[Elbow, float] = {"up": -1.0, "down": 1.0}
SAMPLES = 256
# Postures closer than this, found by iteration, are one.
SAME = 1e-6
# Rounding may push |cos| past 1 by this much on the edge of the reach.
EDGE = 1e-12


def _branches(arguments: Arguments, given: Mapping[str, Any]) -> None:
    if given["elbow"] is not None and arguments.of is not None and not build_plant(arguments.of).closed_form:
        arguments.note("elbow", "names a branch of planar arms only", given["elbow"])


@public(together=_branches)
def inverse_kinematics(
    machine: AnyMachine,
    target: Any,
    *,
    base: Any = None,
    gravity: bool = False,
    elbow: Elbow | None = None,
    seed: int = 0,
) -> list[Vector]:
    """Postures q_a (n,) in rad or m with r(q) = target, passive joints at rest, inside the joint limits.

    A planar arm of two actuated joints: every branch in closed form, elbow up (last joint negative) before elbow down;
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
    """
    plant, point = build_plant(machine), target
    placement = np.zeros(plant.n_base) if base is None else base
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
        reached = list(_into_limits(machine, np.array(settled).T).T)
    found = [posture for posture in reached if inside_limits(machine, posture[:, None])[0]]
    if not found:
        why = "every posture that reaches it breaks a joint limit" if reached else ""
        raise unreachable(plant, point, placement, why)
    return _distinct(found)


def _by_iteration(plant: Plant, target: Vector, base: Vector, gravity: bool, seed: int) -> list[Vector]:
    low, high = joint_box(plant)
    starts = low[:, None] + (high - low)[:, None] * low_discrepancy(plant.n_actuated, SAMPLES, seed)
    bases = np.repeat(base[:, None], SAMPLES, axis=1)
    postures, left = nearest_postures(plant, target, bases, starts)
    reached = list(postures[:, left <= REACHED].T)
    if gravity and reached:
        settled = (_under_gravity(plant, target, base, posture) for posture in _distinct(reached, SAME))
        reached = [posture for posture in settled if inside_limits(plant.machine, posture[:, None])[0]]
        if not reached:
            raise missed(plant, target, base, 0.0, "every posture that reaches it breaks a joint limit under gravity")
    if not reached:
        raise missed(plant, target, base, float(left.min()))
    turned = list(_into_limits(plant.machine, _nearest_turn(plant, np.array(reached).T)).T)
    return _distinct(sorted(turned, key=lambda posture: float(np.abs(posture - (low + high) / 2).max())), SAME)


def _nearest_turn(plant: Plant, postures: Vector) -> Vector:
    """Hinges without limits (n, N) between −π and π."""
    turned = postures.copy()
    for row, (unit, limits) in enumerate(zip(plant.machine.joint_units, plant.machine.limits, strict=True)):
        if unit == "rad" and not np.isfinite(limits).any():
            turned[row] = (turned[row] + math.pi) % (2 * math.pi) - math.pi
    return turned


def branch(plant: Plant, target: Vector, bases: Vector, unit: Vector, sign: float) -> tuple[Vector, Any]:
    """One elbow branch over many placements at once.

    Args:
        plant: the machine's plant.
        target: (2,), m, inertial frame.
        bases: (n_b, N) placements.
        unit: (n − 2, N) coordinates in [0, 1] of the joints before the last two, see `planar.build_reaching`.
        sign: −1 elbow up, +1 elbow down.

    Returns:
        postures (n, N), shifted by 2π into the joint limits where possible, and a mask (N,) of those that reach.
    """
    count = bases.shape[1]
    targets, signs = np.repeat(target[:, None], count, axis=1), np.full((1, count), sign)
    out = plant.posture_at.call([targets, bases, unit, signs, plant.parameter_values])
    postures, cosine = out[0].full(), out[1].full().ravel()
    return _into_limits(plant.machine, postures), np.abs(cosine) <= 1 + EDGE


def _into_limits(machine: AnyMachine, postures: Vector) -> Vector:
    """The same postures (n, N), turned by multiples of 2π into the joint limits where that is possible."""
    turned = postures.copy()
    for row, (unit, (low, high)) in enumerate(zip(machine.joint_units, machine.limits, strict=True)):
        if unit == "rad" and math.isfinite(low):
            turns = 2 * math.pi * np.ceil((low - EDGE - postures[row]) / (2 * math.pi))
            turned[row] += np.where(postures[row] + turns <= high + EDGE, turns, 0.0)
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


def _least_squares(matrix: Vector, right: Vector) -> Vector:
    """The shortest x with A x nearest to b."""
    return cast(Vector, np.linalg.lstsq(matrix, right, rcond=None)[0])


def _under_gravity(plant: Plant, target: Vector, base: Vector, posture: Vector) -> Vector:
    """Newton's method from the posture at rest to the one whose deflected end-point is on the target."""
    error = np.full(target.size, np.inf)
    for _ in range(20):
        q_p = plant.deflected(base, posture, plant.parameter_values)
        q = np.concatenate([q_p.full().ravel(), posture])
        error = plant.end_point(q, base, plant.parameter_values).full().ravel() - target
        if not np.abs(error).max() >= 1e-13 * (1 + np.abs(target).max()):
            break
        jacobian = plant.rigid_jacobian(q, base, plant.parameter_values).full()
        posture = posture - _least_squares(jacobian, error)
    q = np.concatenate([plant.deflected(base, posture, plant.parameter_values).full().ravel(), posture])
    check_held(plant, q, base)
    off = float(np.abs(error).max())
    if not off < 1e-9:
        raise NoSolutionFound(
            f"inverse kinematics under gravity did not converge: the deflected end-point stays {off:.3g} m off the "
            "target; stiffer springs would help",
            violations={"target": off},
            iterate={name: float(angle) for name, angle in zip(plant.machine.joints, posture, strict=True)},
        )
    return posture
