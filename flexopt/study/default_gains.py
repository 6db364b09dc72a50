"""Gains that suit a machine, for closed loops of which nobody said more.

In: a machine in a configuration. Out: Kp, Kv and the damping of an arm's self-motion, as `flexopt.simulate` takes them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from flexopt.errors import FlexoptError
from flexopt.foundation.arrays import Vector
from flexopt.loop.feedback import self_motion_damping
from flexopt.model import AnyMachine
from flexopt.plant import build_plant
from flexopt.plant.control import task_to_joints
from flexopt.robustness import Evaluation
from flexopt.simulation import sampled_loop

# Of the closed loop on a rigid base: corner over the lowest flexible mode's, damping ratio, and the corner's largest
# angle in a sample, rad.
SHARE, DAMPING_RATIO, ANGLE = 0.3, 0.7, 0.25
# How often the corner is halved in search of a stable loop.
HALVINGS = 6


def default_gains(
    machine: AnyMachine, stand: Evaluation, rate: float, loop: Mapping[str, Any] | None = None
) -> dict[str, float]:
    """`rigid_gains` with the highest corner, halved again and again, whose sampled linear loop is stable, exactly.

    Where none of them is (no PD control may be, in a posture), those of the highest corner.

    Args:
        machine: the machine.
        stand: its configuration, and control.
        rate: of the samples, Hz.
        loop: further options of `flexopt.sampled_loop`: sensor, actuator and the like.
    """
    options: dict[str, Any] = {"control": stand.control, "rate": rate} | dict(loop or {})
    options = {name: value for name, value in options.items() if name not in ("integrator", "substeps")}
    for halving in range(HALVINGS + 1):
        gains = rigid_gains(machine, stand, rate, 0.5**halving)
        here: dict[str, Any] = gains | options | {"base": stand.base}
        try:
            stable = sampled_loop(machine, stand.posture, **here).stable
        except FlexoptError:
            break
        if stable:
            return gains
    return rigid_gains(machine, stand, rate)


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
    p, n = plant.parameter_values, plant.n_actuated
    q: Vector = plant.rest(stand.base, stand.posture, p).full().ravel()
    q[: plant.n_passive] += stand.static_deflection
    mass: Vector = plant.mass(q, stand.base, p).full()[-n:, -n:]
    mobility: Vector = np.asarray(np.linalg.inv(mass), dtype=np.float64)
    jv: Vector = plant.rigid_jacobian(q, stand.base, p).full()
    rows = len(jv)
    mapped: Vector = ca.evalf(task_to_joints(ca.SX(jv), stand.control, ca.SX.eye(rows))).full()
    inertia = abs(float(np.linalg.det(jv @ mobility @ mapped))) ** (-1 / rows)
    corner = share * min(SHARE * 2 * math.pi * float(np.min(stand.frequencies_hz)), ANGLE * rate)
    damping = 2 * DAMPING_RATIO * corner
    gains = {"kp": inertia * corner**2, "kv": damping * inertia}
    if n > rows:
        gains["nullspace_damping"] = self_motion_damping(jv, mass, damping)
    return {name: float(f"{value:.4g}") for name, value in gains.items()}
