"""The same machine in MuJoCo: slides and hinges with stiffness, damping and springref, no contacts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from tests.oracles.lagrange import coordinate_names


@dataclass(frozen=True)
class MujocoChain:
    model: Any
    data: Any
    order: list[int]  # address of each coordinate of q in MuJoCo's qpos and qvel, which follow the chain

    def set(self, q: np.ndarray, v: np.ndarray, *, gravity: float = 0.0) -> None:
        self.model.opt.gravity[:] = [0.0, -gravity, 0.0]
        self.data.qpos[self.order], self.data.qvel[self.order] = q, v
        mujoco.mj_forward(self.model, self.data)

    def mass(self) -> np.ndarray:
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, full)
        return full[np.ix_(self.order, self.order)]

    def bias(self) -> np.ndarray:
        return self.data.qfrc_bias[self.order].copy()

    def end_point(self) -> np.ndarray:
        return self.data.site("tip").xpos[:2].copy()

    def jacobian(self) -> np.ndarray:
        full = np.zeros((3, self.model.nv))
        mujoco.mj_jacSite(self.model, self.data, full, None, self.model.site("tip").id)
        return full[:2, self.order]

    def inverse(self, q: np.ndarray, v: np.ndarray, acceleration: np.ndarray, *, gravity: float) -> np.ndarray:
        """M v̇ + h + g + K (q − q_rest) + D v."""
        self.set(q, v, gravity=gravity)
        self.data.qacc[self.order] = acceleration
        mujoco.mj_inverse(self.model, self.data)
        return self.data.qfrc_inverse[self.order].copy()


def mujoco_chain(data: dict[str, Any], base: float) -> MujocoChain:
    body, springs, dampers = data["base"], data["base"]["stiffness"], data["base"].get("damping", {})
    x = 0.0 if "x" in springs else base
    angle = 0.0 if "rotation" in springs else body["rest_angle"]
    # MuJoCo states a joint's axis in the frame of its body, which is turned where rotation is rigid.
    c, s = math.cos(angle), math.sin(angle)
    axes = {
        "x": ("slide", f"{c!r} {-s!r} 0", base),
        "y": ("slide", f"{s!r} {c!r} 0", 0.0),
        "rotation": ("hinge", "0 0 1", body["rest_angle"]),
    }
    joints = "".join(
        f'<joint name="base.{d}" type="{kind}" axis="{axis}" stiffness="{springs[d]!r}" damping="{dampers.get(d, 0.0)!r}" '
        f'springref="{rest!r}"/>'
        for d, (kind, axis, rest) in axes.items()
        if d in springs
    )
    opened = f'<body pos="{x!r} 0 0" axisangle="0 0 1 {angle!r}">{joints}{_inertial(body)}'
    at = body["length"]
    for link in data["links"]:
        spring = ""
        if link.get("passive"):
            spring = f'stiffness="{link["stiffness"]!r}" springref="{link["rest"]!r}" '
        damping = link.get("damping", 0.0) + link.get("joint_damping", 0.0)
        opened += (
            f'<body pos="{at!r} 0 0"><joint name="{link["name"]}" type="hinge" axis="0 0 1" {spring}'
            f'damping="{damping!r}"/>{_inertial(link)}'
        )
        at = link["length"]
    opened += f'<site name="tip" pos="{at!r} 0 0"/>'
    if data["payload"]["mass"] > 0:
        opened += f'<body pos="{at!r} 0 0"><inertial pos="0 0 0" mass="{data["payload"]["mass"]!r}" diaginertia="0 0 0"/></body>'
    closed = "</body>" * (1 + len(data["links"]))
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian" balanceinertia="false"/><option><flag contact="disable"/></option>'
        f"<worldbody>{opened}{closed}</worldbody></mujoco>"
    )
    order = [int(model.joint(name).dofadr[0]) for name in coordinate_names(data)]
    return MujocoChain(model, mujoco.MjData(model), order)


def _inertial(body: dict[str, Any]) -> str:
    inertia = " ".join([repr(body["inertia"])] * 3)
    return f'<inertial pos="{body["com"]!r} {body["com_offset"]!r} 0" mass="{body["mass"]!r}" diaginertia="{inertia}"/>'
