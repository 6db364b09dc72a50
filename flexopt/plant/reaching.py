"""Postures that put the end-point on a target, by iteration: any machine, many placements and starts at once.

In: a plant, targets, placements, starts. Out: postures, and how far off they stay. Where there is a closed form,
`inverse_kinematics.branch` is the quicker way.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.algebra.feasible import DAMPING_START, feasible_steps
from flexopt.foundation.arrays import Vector
from flexopt.model import AnyMachine
from flexopt.plant.plant import Plant, build_plant
from flexopt.plant.reach import arm_length, sampled_ranges

# Calls of `STEPS` steps at most; Newton's steps are quadratic near a solution, so that most take two or three.
ROUNDS = 6
# A target is reached to this share of a metre, position and orientation rows alike.
REACHED = 1e-10


@lru_cache(maxsize=32)
def reach_steps(machine: AnyMachine) -> ca.Function:
    """`feasible_steps` of the task at rest in z = [base, posture]; the last input is p."""
    g = build_plant(machine).graph
    task = ca.substitute(g.end_point, g.q, g.rest)
    return feasible_steps(task, ca.vertcat(g.base, g.posture), [g.p])


def joint_box(plant: Plant) -> tuple[Vector, Vector]:
    """Lower and upper ends (n,) that starts are taken from: the joint limits.

    A hinge without limits has a whole turn, a slide without them the arm's length either way.
    """
    ends = sampled_ranges(plant.machine, arm_length(plant))
    return ends[:, 0], ends[:, 1]


def solve_postures(plant: Plant, target: Vector, bases: Vector, starts: Vector) -> tuple[Vector, NDArray[np.bool_]]:
    """Postures inside the joint limits with the end-point on the target, passive joints at rest.

    Args:
        plant: the machine's plant.
        target: (n_task,) or (n_task, N), m, inertial frame.
        bases: placements (n_b, N) or (n_b,), m or rad.
        starts: postures to start from (n, N), rad or m; each leads to at most one solution.

    Returns:
        postures (n, N), rad or m, and a mask (N,) of those that reach, to `REACHED`.
    """
    postures, left = nearest_postures(plant, target, bases, starts)
    return postures, left <= REACHED


def nearest_postures(plant: Plant, target: Vector, bases: Vector, starts: Vector) -> tuple[Vector, Vector]:
    """As `solve_postures`, with the largest row of r − target, (N,), m, in place of the mask."""
    n_b, n = plant.n_base, plant.n_actuated
    low, high = (np.array(ends) for ends in zip(*plant.machine.limits, strict=True))
    count = starts.shape[1]
    bases = np.broadcast_to(bases.reshape(n_b, -1), (n_b, count))
    goals = np.broadcast_to(target.reshape(plant.n_task, -1), (plant.n_task, count))
    z = np.vstack([bases, np.clip(starts, low[:, None], high[:, None])])
    bounds = np.concatenate([np.full(n_b, -np.inf), low]), np.concatenate([np.full(n_b, np.inf), high])
    free = np.concatenate([np.zeros(n_b), np.ones(n)])
    length = arm_length(plant)
    scale = np.concatenate([np.ones(n_b), [1.0 if unit == "rad" else length for unit in plant.machine.joint_units]])
    z, left = iterate(
        reach_steps(plant.machine), z, (*bounds, free, scale), (goals, goals, np.ones(plant.n_task)),
        [plant.parameter_values], REACHED,
    )  # fmt: skip
    return z[n_b:], left


def iterate(
    steps: ca.Function,
    z: Vector,
    of_z: tuple[Vector, Vector, Vector, Vector],
    of_rows: tuple[Vector, Vector, Vector],
    others: Sequence[ca.DM | Vector],
    tolerance: float,
    rounds: int = ROUNDS,
    enough: int | None = None,
) -> tuple[Vector, Vector]:
    """Repeat `feasible_steps` for the points that are not done.

    Args:
        steps: from `feasible_steps`.
        z: starts (n, N).
        of_z: z_lower, z_upper, free, z_scale, (n,) each.
        of_rows: lower, upper, (r,) or (r, N), and scale (r,).
        others: its last inputs.
        tolerance: on the largest violation, in units of `scale`.
        rounds: calls at most.
        enough: how many points suffice; all by default.

    Returns:
        z (n, N) and the largest violation (N,), NaN where the rows are no numbers.
    """
    z = z.copy()
    left = np.full(z.shape[1], np.inf)
    damping = np.full(z.shape[1], DAMPING_START)
    waiting = cast(NDArray[np.int64], np.arange(z.shape[1]))
    for _ in range(rounds):
        if not waiting.size or (enough is not None and z.shape[1] - waiting.size >= enough):
            break
        rows = [x[:, waiting] if x.ndim == 2 else x for x in of_rows]
        out = steps.call([z[:, waiting], damping[None, waiting], *of_z, *rows, *others])
        z[:, waiting], damping[waiting], left[waiting] = out[0].full(), out[1].full().ravel(), out[2].full().ravel()
        waiting = waiting[left[waiting] > tolerance]
    return z, left
