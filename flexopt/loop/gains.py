"""Gains that suit a machine as heavy as this one, from its rigid arm and its lowest mode.

In: a machine in a configuration. Out: Kp, Kv and the damping of an arm's self-motion, as `flexopt.simulate` takes them.
"""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.foundation.control import Control
from flexopt.loop.feedback import self_motion_damping
from flexopt.model import AnyMachine
from flexopt.plant import build_plant
from flexopt.plant.control import task_to_joints
from flexopt.plant.singularity import check_regular
from flexopt.robustness import Evaluation

# Of the closed loop on a rigid base: corner over the lowest flexible mode's, damping ratio, and the corner's largest
# angle in a sample, rad.
SHARE, DAMPING_RATIO, ANGLE = 0.3, 0.7, 0.25


def rigid_gains(machine: AnyMachine, stand: Evaluation, rate: float, share: float = 1.0) -> dict[str, float]:
    """`kp`, `kv` and, where joints are redundant, `nullspace_damping` for a machine as heavy as this one.

    On a rigid base the end-point obeys r̈ = A f, f = Kp e + Kv ė, with A = Jv M_a⁻¹ T and T the map of the control from
    f to the joints. The corner ω is 0.3 of the lowest flexible mode's, and at most 0.25 rad in a sample; with
    μ = det(A)^(−1/p), the geometric mean of the p axes' inertia,

        Kp = μ ω²,  Kv = 2 ζ μ ω,  ζ = 0.7,

    and a self-motion is damped by 2 ζ ω / λmax(Nᵀ M_a⁻¹ N), N an orthonormal basis of Jv's null space.

    Args:
        machine: the machine.
        stand: its configuration, and control.
        rate: of the samples, Hz.
        share: of the corner that is taken.
    """
    plant = build_plant(machine)
    q: Vector = plant.rest(stand.base, stand.posture, plant.parameter_values).full().ravel()
    q[: plant.n_passive] += stand.static_deflection
    return rigid_gains_at(machine, q, stand.base, stand.control, float(np.min(stand.frequencies_hz)), rate, share)


def rigid_gains_at(
    machine: AnyMachine, q: Vector, base: Vector, control: Control, lowest: float, rate: float, share: float = 1.0
) -> dict[str, float]:
    """The same at coordinates q (n_q,), where the lowest flexible mode has `lowest` Hz.

    Raises:
        SingularPosture: no gain suits an arm that no joint moves along an axis, where a damped control bears to be.
    """
    plant = build_plant(machine)
    check_regular(plant, q, base, otherwise="give kp and kv in [loop], which are proposed for a regular one only")
    p, n = plant.parameter_values, plant.n_actuated
    mass: Vector = plant.mass(q, base, p).full()[-n:, -n:]
    mobility: Vector = np.asarray(np.linalg.inv(mass), dtype=np.float64)
    jv: Vector = plant.rigid_jacobian(q, base, p).full()
    rows = len(jv)
    mapped: Vector = ca.evalf(task_to_joints(ca.SX(jv), control, ca.SX.eye(rows))).full()
    inertia = abs(float(np.linalg.det(jv @ mobility @ mapped))) ** (-1 / rows)
    corner = share * min(SHARE * 2 * math.pi * lowest, ANGLE * rate)
    damping = 2 * DAMPING_RATIO * corner
    gains = {"kp": inertia * corner**2, "kv": damping * inertia}
    if n > rows:
        gains["nullspace_damping"] = self_motion_damping(jv, mass, damping)
    return {name: float(f"{value:.4g}") for name, value in gains.items()}
