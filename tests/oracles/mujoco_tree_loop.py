"""A sampled closed loop in space: MuJoCo's Runge–Kutta integrates, Pinocchio's kinematics measure, the command is held."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from tests.oracles.spatial import mujoco_tree, pinocchio_tree


def mujoco_tree_run(
    data: dict[str, Any],
    q_design: np.ndarray,
    start: np.ndarray,
    *,
    base: np.ndarray,
    control: str,
    kp: np.ndarray,
    kv: np.ndarray,
    period: float,
    steps: int,
    gravity: bool = False,
    compensated: bool = False,
    nullspace_damping: float = 0.0,
    torque_limit: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and rates (steps + 1, n_q) from rest at `start`; the target is the end-point at `q_design`.

    The placement (x, y, yaw) moves the anchor frame, from which q counts.
    """
    tree, known = mujoco_tree(data), pinocchio_tree(data)
    n = sum(not body["joint"].get("passive", False) for body in data["bodies"])
    m = len(q_design) - n
    tree.model.opt.integrator, tree.model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, period
    tree.model.opt.gravity = [0.0, 0.0, -data["gravity"] if gravity else 0.0]
    target = known.task(q_design, base)[0]
    tree.set(start, np.zeros(m + n))
    q, v = [start.copy()], [np.zeros(m + n)]
    for _ in range(steps):
        at, rates = tree.data.qpos[tree.order], tree.data.qvel[tree.order]
        point, jacobian, _ = known.task(at, base)
        force = kp * (target - point) - kv * (jacobian @ rates)
        # The controller's picture: measured joints on a base that stands where it should.
        belief = np.concatenate([q_design[:m], at[m:]])
        rigid = known.task(belief, base)[1][:, m:]
        torque = rigid.T @ force if control == "transpose" else np.linalg.pinv(rigid) @ force
        if compensated:
            torque = torque + known.gravity(belief)[m:]
        if nullspace_damping:
            joints = rates[m:]
            torque = torque - nullspace_damping * (joints - np.linalg.pinv(rigid) @ (rigid @ joints))
        if torque_limit is not None:
            torque = np.clip(torque, -torque_limit, torque_limit)
        tree.data.qfrc_applied[tree.order] = np.concatenate([np.zeros(m), torque])
        mujoco.mj_step(tree.model, tree.data)
        q.append(tree.data.qpos[tree.order].copy())
        v.append(tree.data.qvel[tree.order].copy())
    return np.array(q), np.array(v)
