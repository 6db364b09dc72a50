"""A sampled closed loop in MuJoCo: its own kinematics measure, its Runge–Kutta integrates, the command is held."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from tests.oracles.mujoco_chain import mujoco_chain


def mujoco_run(
    data: dict[str, Any],
    q_design: np.ndarray,
    start: np.ndarray,
    *,
    base: float,
    control: str,
    kp: np.ndarray,
    kv: np.ndarray,
    period: float,
    steps: int,
    gravity: bool = False,
    compensated: bool = False,
    nullspace_damping: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and rates (steps + 1, n_q) from rest at `start`; the target is the end-point at `q_design`."""
    chain, known = mujoco_chain(data, base), mujoco_chain(data, base)
    n = sum(not link.get("passive") for link in data["links"])
    m = len(q_design) - n
    chain.model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    chain.model.opt.timestep = period
    weight = data["gravity"] if gravity else 0.0
    known.set(q_design, np.zeros(m + n), gravity=weight)
    target = known.end_point()
    chain.set(start, np.zeros(m + n), gravity=weight)

    q, v = [start.copy()], [np.zeros(m + n)]
    for _ in range(steps):
        mujoco.mj_forward(chain.model, chain.data)
        rates = chain.data.qvel[chain.order]
        force = kp * (target - chain.end_point()) - kv * (chain.jacobian() @ rates)
        # The controller's picture: measured joints on a base that stands where it should.
        belief = np.concatenate([q_design[:m], chain.data.qpos[chain.order][m:]])
        known.set(belief, np.zeros(m + n), gravity=weight)
        rigid = known.jacobian()[:, m:]
        torque = rigid.T @ force if control == "transpose" else np.linalg.pinv(rigid) @ force
        if compensated:
            torque = torque + known.bias()[m:]
        if nullspace_damping:
            joints = rates[m:]
            torque = torque - nullspace_damping * (joints - np.linalg.pinv(rigid) @ (rigid @ joints))
        applied = np.zeros(m + n)
        applied[m:] = torque
        chain.data.qfrc_applied[chain.order] = applied
        mujoco.mj_step(chain.model, chain.data)
        q.append(chain.data.qpos[chain.order].copy())
        v.append(chain.data.qvel[chain.order].copy())
    return np.array(q), np.array(v)
