"""The closed loop of a bundle's example: the exported controller moves the exported model of the machine to a target.

In: a `Context`. Out: a start from which that loop settles, tried here with the same Functions; None where none does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.export.context import Context
from flexopt.export.control import task_space_torque
from flexopt.export.operations import Array
from flexopt.simulation.machine_step import machine_step

RATE_HZ, DURATION_S = 200, 12
# The example ends well below the first, m for each m of the arm; tried here with room to spare.
SETTLED, TRIED = 5e-4, 2.5e-4
STEP = 0.02
STAYS = 1e-6
BANDWIDTHS = (3.0, 1.5, 6.0)
POSTURES = 12
SEED = 1


@dataclass(frozen=True)
class Start:
    """Where the loop begins, and how it is controlled.

    Attributes:
        posture: of the joints, rad.
        rest: passive coordinates there.
        kp, kv: gains of the Jacobian inverse law.
        substeps: steps of the machine in a sample of the controller.
        distance: of the target from where the end-point starts, along each axis, m.
        settled: error at the end that counts as on target, m.
    """

    posture: Array
    rest: Array
    kp: float
    kv: float
    substeps: int
    distance: float
    settled: float


def settling_start(at: Context) -> Start | None:
    """The first start, in order of the postures' robustness w, whose loop settles."""
    plant, p = at.plant, at.plant.parameter_values
    base = ca.DM.zeros(plant.n_base, 1)
    m, length = plant.n_passive, at.arm_length
    postures = at.joint_angles.draw(np.random.default_rng(SEED), 128)
    sines = plant.singularity_sine_squared.call([base, ca.DM(postures.T), p])[0].full().ravel()
    regular = postures[sines > np.median(sines)].round(4)
    worst = [float(np.min(at.measures.w.call([base, ca.DM(row), p])[0].full())) for row in regular]
    for posture in regular[np.argsort(worst)[::-1][:POSTURES]]:
        rest = plant.rest.call([base, ca.DM(posture), p])[0]
        mass: Array = plant.mass.call([rest, base, p])[0].full()
        inertia = float(np.trace(mass[m:, m:])) / plant.n_actuated
        stiffness: Array = plant.stiffness.call([p])[0].full()
        squares: NDArray[np.complex128] = np.linalg.eigvals(np.linalg.solve(mass, stiffness)).astype(complex)
        fastest = math.sqrt(np.abs(squares).max())
        substeps = max(1, math.ceil(fastest / RATE_HZ / 0.5))
        for bandwidth in BANDWIDTHS:
            kp, kv = (float(f"{gain:.4g}") for gain in (inertia * bandwidth**2, 2 * inertia * bandwidth))
            start = Start(posture, rest.full().ravel()[:m], kp, kv, substeps, STEP * length, SETTLED * length)
            if _settles(at, start, length):
                return start
    return None


def _settles(at: Context, start: Start, length: float) -> bool:
    """Whether the end-point stays near its target at the end, and the loop there is stable."""
    plant, p, base = at.plant, at.plant.parameter_values, ca.DM.zeros(at.plant.n_base, 1)
    n, m = plant.n_coordinates, plant.n_passive
    rest = ca.DM([*start.rest, *start.posture])
    target = plant.end_point.call([rest, base, p])[0] + start.distance
    x = ca.MX.sym("x", 2 * n)
    q, v = x[:n], x[n:]
    point = plant.end_point.call([q, base, p])[0]
    rate = plant.jacobian.call([q, base, p])[0] @ v
    law = task_space_torque(plant, "inverse")
    still = ca.DM.zeros(plant.n_task, 1)
    torque = law.call([base, q[m:], point, rate, target, still, start.kp, start.kv, p])[0]
    step = machine_step(at.machine)
    for _ in range(start.substeps):
        q, v = step.call([q, v, torque, base, p, 1 / RATE_HZ / start.substeps])
    sample = ca.Function("sample", [x], [ca.vertcat(q, v), ca.norm_2(target - point)], ["x"], ["x_next", "error"])
    states, errors = sample.mapaccum("samples", DURATION_S * RATE_HZ).call([ca.vertcat(rest, ca.DM.zeros(n, 1))])
    last = errors.full().ravel()[-RATE_HZ:]
    if not np.isfinite(last).all() or last.max() > TRIED * length:
        return False
    # Small errors may still grow; motions of a redundant arm on the spot have multipliers of 1.
    tangent: Array = sample.factory("tangent", ["x"], ["jac:x_next:x"]).call([states[:, -1]])[0].full()
    multipliers: NDArray[np.complex128] = np.linalg.eigvals(tangent).astype(complex)
    return bool(np.abs(multipliers).max() <= 1 + STAYS)
