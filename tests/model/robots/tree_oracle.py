"""Forward kinematics and mass matrix of a `Tree` in NumPy, from the text of its docstrings alone."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from flexopt.model.tree import Tree


class TreeOracle:
    """Poses and M(q) of a tree at the coordinates q, by joint name."""

    def __init__(self, tree: Tree, q: dict[str, float]) -> None:
        self.tree = tree
        self.poses: dict[str, np.ndarray] = {}
        self.axes: dict[str, tuple[np.ndarray, np.ndarray, str]] = {}
        self.parents: dict[str, str | None] = {}
        for body in tree.bodies:
            parent = np.eye(4) if body.parent is None else self.poses[body.parent]
            before = parent @ frame(np.array(body.rotation), np.array(body.position))
            axis, value = np.array(body.joint.axis), q[body.joint.name]
            if body.joint.kind == "hinge":
                after = before @ frame(Rotation.from_rotvec(axis * value).as_matrix(), np.zeros(3))
            else:
                after = before @ frame(np.eye(3), axis * value)
            self.poses[body.name] = after
            self.axes[body.name] = (before[:3, :3] @ axis, before[:3, 3], body.joint.kind)
            self.parents[body.name] = body.parent

    def end_point(self) -> np.ndarray:
        end = self.tree.end_point
        return self.poses[end.body] @ frame(np.array(end.rotation), np.array(end.position))

    def jacobian(self, body: str, point: np.ndarray, names: list[str]) -> np.ndarray:
        """(6, n): velocity of a point fixed to the body, then angular velocity, ground axes."""
        jacobian = np.zeros((6, len(names)))
        joint_of = {b.name: b.joint.name for b in self.tree.bodies}
        here: str | None = body
        while here is not None:
            axis, origin, kind = self.axes[here]
            column = names.index(joint_of[here])
            if kind == "hinge":
                jacobian[:3, column], jacobian[3:, column] = np.cross(axis, point - origin), axis
            else:
                jacobian[:3, column] = axis
            here = self.parents[here]
        return jacobian

    def mass_matrix(self, names: list[str]) -> np.ndarray:
        total = np.zeros((len(names), len(names)))
        for body in self.tree.bodies:
            pose = self.poses[body.name]
            com = pose[:3, :3] @ np.array(body.com) + pose[:3, 3]
            xx, yy, zz, xy, xz, yz = body.inertia
            inertia = pose[:3, :3] @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ pose[:3, :3].T
            j = self.jacobian(body.name, com, names)
            total += body.mass * j[:3].T @ j[:3] + j[3:].T @ inertia @ j[3:]
            own = names.index(body.joint.name)
            total[own, own] += body.joint.armature
        return total


def frame(rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, position
    return out
