"""The end-point's inclination α = atan2(x_v, z_v), in a range or at a value.

x_v and z_v are the heights of the tips of its frame's first and last axis: in the plane α is the absolute angle of the
end-point's link, in space it turns about a horizontal axis. The row is α less the turns that put it within half a turn
of the range's middle μ,

    μ + atan2(x_v cos μ − z_v sin μ, z_v cos μ + x_v sin μ),

so that it jumps only opposite to the middle. Where the frame's second axis is vertical α is not defined; the row is
then μ, with finite derivatives.
"""

from __future__ import annotations

import math
from typing import Any

import casadi as ca

from flexopt.model.constraints import Constraints
from flexopt.plant import Plant
from flexopt.selection.constraints.kind import ConstraintKind, Group, ScaledConstraint, Scene

# Square of the sine of the angle between the second axis and the vertical below which α is not defined.
UPRIGHT = 1e-24


def _groups(_: Plant, constraints: Constraints) -> list[Group]:
    if constraints.tool_angle is None:
        return []
    low, high = constraints.tool_angle
    middle = (low + high) / 2
    return [
        Group(
            "tool_angle",
            None,
            (middle, math.cos(middle), math.sin(middle)),
            (ScaledConstraint("tool angle", "rad", low, high),),
        )
    ]


def _graph(scene: Scene, _: Any, c: ca.SX) -> list[ca.SX]:
    rotation = scene.plant.end_rotation(scene.q, scene.base, scene.p)
    x, z = rotation[-1, 0], rotation[-1, -1]
    sine, cosine = x * c[1] - z * c[2], z * c[1] + x * c[2]
    defined = sine**2 + cosine**2 > UPRIGHT
    # Whichever branch is not taken must have finite derivatives too: they are multiplied by zero.
    return [c[0] + ca.if_else(defined, ca.atan2(sine, ca.if_else(defined, cosine, 1.0)), 0.0)]


KIND = ConstraintKind(_groups, _graph)
