"""Bodies of a tree in the making: links merged into one, and their way into the layout of `Tree`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexopt.foundation.arrays import Array, Document
from flexopt.foundation.quantities import ANGLE_MAX
from flexopt.model.robots.description import Joint
from flexopt.model.robots.elements import Element
from flexopt.model.robots.geometry import Inertial, Pose
from flexopt.model.robots.roles import Role

# Names of parameters that are no body's.
RESERVED = ("payload", "gravity", "end_point", "stiffness", "damping")


@dataclass(eq=False)
class Body:
    """A body of the tree while links are merged into it."""

    name: str
    parent: str | None
    joint: dict[str, Any]
    place: Pose
    inertial: Inertial
    link: Element | None
    joint_element: Element | None

    def to_dict(self) -> Document:
        """In the layout of `TreeBody`."""
        body = self.inertial.without_rounding()
        t = body.tensor
        return {
            "name": self.name,
            "parent": self.parent,
            "joint": self.joint,
            "position": plain(self.place.position),
            "rotation": tuple(plain(row) for row in self.place.rotation),
            "mass": float(body.mass),
            "com": plain(body.com),
            "inertia": plain(np.array([t[0, 0], t[1, 1], t[2, 2], t[0, 1], t[0, 2], t[1, 2]])),
        }


def body_name(link: str) -> str:
    """What a link's own body is called: as the link, told apart from words that the tree keeps for itself."""
    return f"{link}.link" if link in RESERVED else link


def tree_joint(joint: Joint, role: Role) -> dict[str, Any]:
    """In the layout of `TreeJoint`."""
    common: dict[str, Any] = {"name": joint.name, "kind": joint.kind, "axis": plain(joint.axis)}
    common["armature"] = role.armature
    if role.kind == "passive":
        spring = {"stiffness": role.stiffness, "damping": role.damping, "rest": role.value}
        return common | {"passive": True} | spring
    bounds = {"limits": _within_turns(joint.kind, role.limits), "effort": role.effort, "speed": role.speed}
    return common | {"joint_damping": role.damping} | bounds


def _within_turns(kind: str, limits: tuple[float, float] | None) -> tuple[float, float] | None:
    """A hinge's limits as far as two turns; None where it has none."""
    if kind != "hinge" or limits is None:
        return limits
    lower, upper = max(limits[0], -ANGLE_MAX), min(limits[1], ANGLE_MAX)
    return None if (lower, upper) == (-ANGLE_MAX, ANGLE_MAX) else (lower, upper)


def plain(values: Array) -> tuple[float, ...]:
    """An array as Python numbers."""
    return tuple(float(value) for value in values)
