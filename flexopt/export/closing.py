"""The closed loop of a bundle's examples: in which posture, and with which gains, they hold the machine.

In: a `Context`, and for the example that moves to a target whose motion it is: that of the exported model, or of a
stand-in. Out: for that example a start from which its loop settles and every call is taken without a remark, tried here
with the same Functions and the C functions' own tests, None where there is none; for the ROS 2 node what decays about
rest.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.export.context import Context
from flexopt.export.control import damps_self_motion, task_space_torque
from flexopt.export.operations import Operation
from flexopt.foundation.arrays import Array
from flexopt.loop.feedback import self_motion_damping
from flexopt.loop.machine_step import machine_step
from flexopt.loop.outcome import LoopPoint
from flexopt.loop.small_motions import SmallMotions

RATE_HZ, DURATION_S = 200, 12
# How old the ROS 2 node's inputs may be, in samples: one may be lost.
AGE_MAX = 2
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
class InverseGains:
    """Of the Jacobian inverse law, as the operation `torque_inverse` takes them.

    Attributes:
        kp, kv, nullspace_damping: the last is 0 where no self-motion is.
        inertia: mean inertia of the joints, by which the gains are chosen.
    """

    kp: float
    kv: float
    nullspace_damping: float
    inertia: float


@dataclass(frozen=True)
class Hold:
    """A posture, and gains that hold the machine in it.

    Attributes:
        posture: of the joints, rad or m.
        gains: of the controller.
        decays: whether the machine's loop about rest does there, see `steady_hold`; it may be that nothing that was
            tried makes it.
    """

    posture: Array
    gains: InverseGains
    decays: bool


@dataclass(frozen=True)
class Start(Hold):
    """Where the example's loop begins; the stand-in's joints have the inertia of the gains.

    Attributes:
        rest: passive coordinates there.
        substeps: steps of the machine in a sample of the controller.
        distance: of the target from where the end-point starts, along each axis, m.
        settled: error at the end that counts as on target, m.
    """

    rest: Array
    substeps: int
    distance: float
    settled: float


def steady_hold(at: Context) -> Hold:
    """The first posture and gains, in the order of `settling_start`, with which the machine's loop about rest decays.

    It does so at `RATE_HZ` and at the slowest rate that the node's time-out admits, each time with the end-point as it
    was a sample ago: a rate that is told from the last two measurements is half a sample old.
    """
    first: Hold | None = None
    for posture, _, mass, jv in _promising(at):
        for bandwidth in BANDWIDTHS:
            gains = _gains(at, bandwidth, mass, jv)
            hold = Hold(posture, gains, _decays(at, posture, gains))
            if hold.decays:
                return hold
            first = first or hold
    assert first is not None
    return first


def _decays(at: Context, posture: Array, gains: InverseGains) -> bool:
    """Whether the loop about rest does at both rates, the end-point's measurement one sample old."""
    plant, damped = at.plant, gains.nullspace_damping > 0
    motions = SmallMotions(at.machine, "inverse", damped=damped)
    each = np.ones(plant.n_task)
    given = {"kp": gains.kp * each, "kv": gains.kv * each, "nullspace_damping": np.array([gains.nullspace_damping])}
    given |= {"posture": posture, "p": plant.parameter_values.full()}
    rates = [
        LoopPoint(motions, motions.numbers(given | {"period": np.array([period])}), period).loop.growth_rate
        for period in (1 / RATE_HZ, AGE_MAX / RATE_HZ)
    ]
    return all(rate < 0 for rate in rates)


def _promising(at: Context) -> Iterator[tuple[Array, Array, Array, Array]]:
    """Regular postures in order of their robustness w, with q at rest, M (n_q, n_q) and Jv there."""
    plant, p, base = at.plant, at.plant.parameter_values, ca.DM.zeros(at.plant.n_base, 1)
    postures = at.joint_angles.draw(np.random.default_rng(SEED), 128)
    sines = plant.singularity_sine_squared.call([base, ca.DM(postures.T), p])[0].full().ravel()
    bar = min(max(np.median(sines), at.singularity_margin**2), sines.max())
    regular = postures[sines >= bar].round(4)
    worst = at.measures.w.call([base, ca.DM(regular.T), p])[0].full().min(axis=0)
    for posture in regular[np.argsort(worst)[::-1][:POSTURES]]:
        rest = plant.rest.call([base, ca.DM(posture), p])[0]
        mass: Array = plant.mass.call([rest, base, p])[0].full()
        jv: Array = plant.rigid_jacobian.call([rest, base, p])[0].full()
        yield posture, rest.full().ravel(), mass, jv


def _gains(at: Context, bandwidth: float, mass: Array, jv: Array, *, of_machine: bool = True) -> InverseGains:
    """Gains that give joints of the machine's mean inertia a corner of `bandwidth`, rad/s, critically damped.

    Args:
        at: what the bundle is built from.
        bandwidth: rad/s; the self-motion is damped by twice as much.
        mass, jv: M and Jv in the posture.
        of_machine: whether its own joints are held, or a stand-in's of equal inertia.
    """
    plant = at.plant
    of_joints, damping = mass[plant.n_passive :, plant.n_passive :], 0.0
    inertia = float(np.trace(of_joints)) / plant.n_actuated
    if damps_self_motion(plant, "inverse"):
        moved = of_joints if of_machine else inertia * np.eye(plant.n_actuated)
        damping = self_motion_damping(jv, moved, 2 * bandwidth)
    values = (inertia * bandwidth**2, 2 * inertia * bandwidth, damping, inertia)
    return InverseGains(*(float(f"{value:.4g}") for value in values))


def settling_start(at: Context, operations: Mapping[str, Operation]) -> Start | None:
    """The first start, in order of the postures' robustness w, whose loop settles.

    Those come first with which the machine's loop decays as the ROS 2 node's does: what settles alone may do so at the
    brink.

    Args:
        at: what the bundle is built from.
        operations: of the bundle, by name; without `machine_step` the loop is closed around a stand-in: joints of equal
            inertia on rigid ground.
    """
    plant, length, of_machine = at.plant, at.arm_length, "machine_step" in operations
    stiffness: Array = plant.stiffness.call([plant.parameter_values])[0].full()
    starts = list[Start]()
    for posture, rest, mass, jv in _promising(at):
        squares: NDArray[np.complex128] = np.linalg.eigvals(np.linalg.solve(mass, stiffness)).astype(complex)
        fastest = math.sqrt(np.abs(squares).max())
        for bandwidth in BANDWIDTHS:
            gains = _gains(at, bandwidth, mass, jv, of_machine=of_machine)
            start = Start(
                posture=posture,
                rest=rest[: plant.n_passive],
                gains=gains,
                substeps=max(1, math.ceil(fastest / RATE_HZ / 0.5)),
                distance=STEP * length,
                settled=SETTLED * length,
                decays=of_machine and _decays(at, posture, gains),
            )
            starts.append(start)
    starts.sort(key=lambda start: not start.decays)
    return next((start for start in starts if _settles(at, operations, start, length)), None)


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
        "target_rate": np.zeros_like(rate), "proportional_gain": np.full((count, 1), start.gains.kp),
        "derivative_gain": np.full((count, 1), start.gains.kv), "placement": np.zeros((count, plant.n_base)),
        "nullspace_damping": np.full((count, 1), start.gains.nullspace_damping),
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
    damper = [v[m:], start.gains.nullspace_damping] if damps_self_motion(plant, "inverse") else []
    given = [base, q[m:], point, rate, target, still, start.gains.kp, start.gains.kv, *damper, p]
    torque = task_space_torque(plant, "inverse").call(given)[0]
    if of_machine:
        step = machine_step(at.machine)
        for _ in range(start.substeps):
            q, v = step.call([q, v, torque, base, p, 1 / RATE_HZ / start.substeps])
    else:
        v = v + ca.vertcat(ca.DM.zeros(m, 1), torque) / (start.gains.inertia * RATE_HZ)
        q = q + v / RATE_HZ
    outputs = [ca.vertcat(q, v), point, rate, torque, ca.norm_2(target - point)]
    return ca.Function("sample", [x], outputs, ["x"], ["x_next", "point", "rate", "torque", "error"])
