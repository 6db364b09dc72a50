"""All postures that put the end-point on a target from a given placement."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np

from flexopt.errors import NoSolutionFound
from flexopt.model import AnyMachine
from flexopt.model.arguments import Arguments, Vector
from flexopt.model.problem import ELBOWS, Elbow, check_seed
from flexopt.plant.plant import Plant, build_plant
from flexopt.plant.reach import unreachable
from flexopt.plant.statics import check_held

ELBOW_SIGN: dict[Elbow, float] = {"up": -1.0, "down": 1.0}
SAMPLES = 256
# Rounding may push |cos| past 1 by this much on the edge of the reach.
EDGE = 1e-12


def inverse_kinematics(
    machine: AnyMachine,
    target: Any,
    *,
    base: Any = 0.0,
    gravity: bool = False,
    elbow: Elbow | None = None,
    seed: int = 0,
) -> list[Vector]:
    """Postures q_a (n,) in rad with r(q) = target, passive joints at rest, inside the joint limits.

    Two actuated joints: every branch in closed form, elbow up (last joint negative) before elbow down. More: a set of
    distinct postures, both branches of the last two joints over a low-discrepancy sample of the redundancy.

    Args:
        machine: planar, from `flexopt.load`.
        target: end-point (2,), m, inertial frame.
        base: placement x, m.
        gravity: the end-point under static deflection, instead of at rest.
        elbow: keep only the branch `"up"` or `"down"` of the last two joints; both by default.
        seed: shifts the sample for three joints and more.

    Raises:
        InputError: an argument is not finite or has the wrong shape.
        UnreachableTarget: by how many metres, and from which placements it would be reachable.
    """
    arguments = Arguments("inverse_kinematics")
    machine = arguments.planar(machine)
    point, placement = arguments.point(target, "target"), arguments.base(machine, base)
    arguments.flag("gravity", gravity)
    arguments.choice("elbow", elbow, (None, *ELBOWS))
    arguments.checked("seed", seed, check_seed, 0)
    arguments.done()
    plant = build_plant(machine)
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
    for row, (low, high) in enumerate(machine.limits):
        if math.isfinite(low):
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


def _distinct(postures: list[Vector]) -> list[Vector]:
    """The same list without repeats (both elbows agree where the arm is straight)."""
    kept: list[Vector] = []
    for posture in postures:
        if all(np.abs(posture - other).max() > 1e-7 for other in kept):
            kept.append(posture)
    return kept


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
