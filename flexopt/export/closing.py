"""The closed loop of a bundle's example: the exported controller moves a machine to a target.

In: a `Context`, and whose motion it is: that of the exported model, or of a stand-in. Out: a start from which that loop
settles and every call is taken without a remark, tried here with the same Functions and the C functions' own tests;
None where there is none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.export.context import Context
from flexopt.export.control import damps_self_motion, task_space_torque
from flexopt.export.operations import Array, Operation
from flexopt.loop.feedback import self_motion_damping
from flexopt.loop.machine_step import machine_step

RATE_HZ, DURATION_S = 200, 12
# The example ends well below the first, m for each m of the arm; tried here with room to spare.
SETTLED, TRIED = 5e-4, 2.5e-4
STEP = 0.02
STAYS = 1e-6
BANDWIDTHS = (3.0, 1.5, 6.0)
POSTURES = 12
SEED = 1
# Kept from the ends of every measured range, rad or m, and from the guards' ends: single precision goes another way by
# less.
ROOM = 1e-2


@dataclass(frozen=True)
class Start:
    """Where the loop begins, and how it is controlled.

    Attributes:
        posture: of the joints, rad or m.
        rest: passive coordinates there.
        kp, kv, nullspace_damping: gains of the Jacobian inverse law; the last is 0 where no self-motion is.
        inertia: mean inertia of the joints, by which the gains are chosen, and which the stand-in's joints have.
        substeps: steps of the machine in a sample of the controller.
        distance: of the target from where the end-point starts, along each axis, m.
        settled: error at the end that counts as on target, m.
    """

    posture: Array
    rest: Array
    kp: float
    kv: float
    nullspace_damping: float
    inertia: float
    substeps: int
    distance: float
    settled: float


def settling_start(at: Context, operations: Mapping[str, Operation]) -> Start | None:
    """The first start, in order of the postures' robustness w, whose loop settles.

    Args:
        at: what the bundle is built from.
        operations: of the bundle, by name; without `machine_step` the loop is closed around a stand-in: joints of equal
            inertia on rigid ground.
    """
    plant, p = at.plant, at.plant.parameter_values
    base = ca.DM.zeros(plant.n_base, 1)
    m, length = plant.n_passive, at.arm_length
    postures = at.joint_angles.draw(np.random.default_rng(SEED), 128)
    sines = plant.singularity_sine_squared.call([base, ca.DM(postures.T), p])[0].full().ravel()
    regular = postures[sines > np.median(sines)].round(4)
    worst = at.measures.w.call([base, ca.DM(regular.T), p])[0].full().min(axis=0)
    for posture in regular[np.argsort(worst)[::-1][:POSTURES]]:
        rest = plant.rest.call([base, ca.DM(posture), p])[0]
        mass: Array = plant.mass.call([rest, base, p])[0].full()
        inertia = float(np.trace(mass[m:, m:])) / plant.n_actuated
        stiffness: Array = plant.stiffness.call([p])[0].full()
        squares: NDArray[np.complex128] = np.linalg.eigvals(np.linalg.solve(mass, stiffness)).astype(complex)
        fastest = math.sqrt(np.abs(squares).max())
        substeps = max(1, math.ceil(fastest / RATE_HZ / 0.5))
        for bandwidth in BANDWIDTHS:
            damping = 0.0
            if damps_self_motion(plant, "inverse"):
                jv: Array = plant.rigid_jacobian.call([rest, base, p])[0].full()
                moved = mass[m:, m:] if "machine_step" in operations else inertia * np.eye(plant.n_actuated)
                damping = self_motion_damping(jv, moved, 2 * bandwidth)
            start = Start(
                posture=posture,
                rest=rest.full().ravel()[:m],
                kp=_few_digits(inertia * bandwidth**2),
                kv=_few_digits(2 * inertia * bandwidth),
                nullspace_damping=_few_digits(damping),
                inertia=_few_digits(inertia),
                substeps=substeps,
                distance=STEP * length,
                settled=SETTLED * length,
            )
            if _settles(at, operations, start, length):
                return start
    return None


def _few_digits(value: float) -> float:
    return float(f"{value:.4g}")


def _settles(at: Context, operations: Mapping[str, Operation], start: Start, length: float) -> bool:
    """Whether all goes well: small errors at the end, a stable loop there, no call refused or remarked upon."""
    plant, base = at.plant, ca.DM.zeros(at.plant.n_base, 1)
    rest = ca.DM([*start.rest, *start.posture])
    target = plant.end_point.call([rest, base, plant.parameter_values])[0] + start.distance
    sample = _sample(at, start, target, of_machine="machine_step" in operations)
    x = ca.vertcat(rest, ca.DM.zeros(rest.shape[0], 1))
    states, *others = sample.mapaccum("samples", DURATION_S * RATE_HZ).call([x])
    point, rate, torque, error = (part.full().T for part in others)
    last = error[-RATE_HZ:]
    if not np.isfinite(last).all() or last.max() > TRIED * length:
        return False
    # Small errors may still grow; motions of a redundant arm on the spot have multipliers of 1.
    tangent: Array = sample.factory("tangent", ["x"], ["jac:x_next:x"]).call([states[:, -1]])[0].full()
    multipliers: NDArray[np.complex128] = np.linalg.eigvals(tangent).astype(complex)
    if np.abs(multipliers).max() > 1 + STAYS:
        return False
    before: Array = ca.horzcat(x, states[:, :-1]).full().T
    q, v = np.split(before, 2, axis=1)
    count, m = len(q), plant.n_passive
    known = {
        "coordinates": q, "rates": v, "joint_angles": q[:, m:], "joint_rates": v[:, m:], "measured_point": point,
        "measured_rate": rate, "target_point": np.tile(target.full().T, (count, 1)), "torque": torque,
        "target_rate": np.zeros_like(rate), "proportional_gain": np.full((count, 1), start.kp),
        "derivative_gain": np.full((count, 1), start.kv), "placement": np.zeros((count, plant.n_base)),
        "nullspace_damping": np.full((count, 1), start.nullspace_damping),
        "step": np.full((count, 1), 1 / RATE_HZ / start.substeps),
    }  # fmt: skip
    called = [operations[name] for name in ("kinematics", "torque_inverse", "machine_step") if name in operations]
    return all(bool(o.takes(_rows(at, o, known, count), room=ROOM).all()) for o in called)


def _rows(at: Context, operation: Operation, known: Mapping[str, Array], count: int) -> Array:
    """The inputs of all calls of one function."""
    columns: Sequence[Array] = [known[field.name] for field in operation.inputs]
    own = [] if operation.baked else [np.tile(at.parameters.values, (count, 1))]
    return at.parameters.rounded(np.hstack([*columns, *own]))


def _sample(at: Context, start: Start, target: ca.DM, *, of_machine: bool) -> ca.Function:
    """One sample of the loop: x = [q, v] -> x_next, and the measurements, torque and error before."""
    plant, p, base = at.plant, at.plant.parameter_values, ca.DM.zeros(at.plant.n_base, 1)
    n, m = plant.n_coordinates, plant.n_passive
    x = ca.MX.sym("x", 2 * n)
    q, v = x[:n], x[n:]
    point = plant.end_point.call([q, base, p])[0]
    rate = plant.jacobian.call([q, base, p])[0] @ v
    still = ca.DM.zeros(plant.n_task, 1)
    damper = [v[m:], start.nullspace_damping] if damps_self_motion(plant, "inverse") else []
    given = [base, q[m:], point, rate, target, still, start.kp, start.kv, *damper, p]
    torque = task_space_torque(plant, "inverse").call(given)[0]
    if of_machine:
        step = machine_step(at.machine)
        for _ in range(start.substeps):
            q, v = step.call([q, v, torque, base, p, 1 / RATE_HZ / start.substeps])
    else:
        v = v + ca.vertcat(ca.DM.zeros(m, 1), torque) / (start.inertia * RATE_HZ)
        q = q + v / RATE_HZ
    outputs = [ca.vertcat(q, v), point, rate, torque, ca.norm_2(target - point)]
    return ca.Function("sample", [x], outputs, ["x"], ["x_next", "point", "rate", "torque", "error"])
