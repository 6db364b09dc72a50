"""The same machine in Pinocchio."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from tests.oracles.lagrange import coordinate_names


@dataclass(frozen=True)
class PinocchioChain:
    model: Any
    data: Any
    order: list[int]  # index of each coordinate of q in Pinocchio's q and v
    tip: int

    def _chain(self, q: np.ndarray) -> np.ndarray:
        out = np.zeros(self.model.nv)
        out[self.order] = q
        return out

    def mass(self, q: np.ndarray) -> np.ndarray:
        full = pin.crba(self.model, self.data, self._chain(q))
        full = np.triu(full) + np.triu(full, 1).T
        return full[np.ix_(self.order, self.order)]

    def gravity(self, q: np.ndarray) -> np.ndarray:
        return pin.computeGeneralizedGravity(self.model, self.data, self._chain(q))[self.order].copy()

    def nonlinear_effects(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """h + g."""
        return pin.nonLinearEffects(self.model, self.data, self._chain(q), self._chain(v))[self.order].copy()

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        full = pin.computeFrameJacobian(
            self.model, self.data, self._chain(q), self.tip, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        return full[:2, self.order].copy()

    def end_point(self, q: np.ndarray) -> np.ndarray:
        pin.framesForwardKinematics(self.model, self.data, self._chain(q))
        return self.data.oMf[self.tip].translation[:2].copy()


def pinocchio_chain(data: dict[str, Any], base: float) -> PinocchioChain:
    model = pin.Model()
    model.gravity.linear = np.array([0.0, -data["gravity"], 0.0])
    body, springs = data["base"], data["base"]["stiffness"]
    parent, placement = 0, _shift(0.0 if "x" in springs else base)
    joints = {"x": pin.JointModelPX(), "y": pin.JointModelPY(), "rotation": pin.JointModelRZ()}
    for direction, joint in joints.items():
        if direction in springs:
            parent = model.addJoint(parent, joint, placement, f"base.{direction}")
            placement = pin.SE3.Identity()
    if "rotation" not in springs:
        cosine, sine = np.cos(body["rest_angle"]), np.sin(body["rest_angle"])
        turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        placement = placement * pin.SE3(turn, np.zeros(3))
    model.appendBodyToJoint(parent, _inertia(body), placement)
    placement = placement * _shift(body["length"])
    for link in data["links"]:
        parent = model.addJoint(parent, pin.JointModelRZ(), placement, link["name"])
        model.appendBodyToJoint(parent, _inertia(link), pin.SE3.Identity())
        placement = _shift(link["length"])
    payload = pin.Inertia(data["payload"]["mass"], np.zeros(3), np.zeros((3, 3)))
    model.appendBodyToJoint(parent, payload, placement)
    tip = model.addFrame(pin.Frame("tip", parent, placement, pin.FrameType.OP_FRAME))
    order = [model.joints[model.getJointId(name)].idx_v for name in coordinate_names(data)]
    return PinocchioChain(model, model.createData(), order, tip)


def _shift(along: float) -> Any:
    return pin.SE3(np.eye(3), np.array([along, 0.0, 0.0]))


def _inertia(body: dict[str, Any]) -> Any:
    return pin.Inertia(body["mass"], np.array([body["com"], body["com_offset"], 0.0]), np.eye(3) * body["inertia"])
