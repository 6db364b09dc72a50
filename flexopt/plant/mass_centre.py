"""The centre of mass of a whole machine, its payload included.

In: a machine, the symbols of its parameters and its bodies' frames. Out: an SX graph.
"""

from __future__ import annotations

import casadi as ca

from flexopt.model import AnyMachine
from flexopt.plant.frames import Frames


def centre_of_mass(machine: AnyMachine, p: ca.SX, frames: Frames) -> ca.SX:
    """Σ m_j r_j / Σ m_j over every body that has mass and the payload at the end-point: (d,), m, inertial frame."""
    value = {parameter.name: p[k] for k, parameter in enumerate(machine.parameters)}
    total = value["payload.mass"]
    moment = total * frames.tip
    words = ("com", "com_offset") if frames.dimension == 2 else ("com.x", "com.y", "com.z")
    for name, origin, rotation in zip(frames.names, frames.origins, frames.rotations, strict=True):
        if f"{name}.mass" in value:
            mass, own = value[f"{name}.mass"], ca.vertcat(*(value[f"{name}.{word}"] for word in words))
            total += mass
            moment += mass * (origin + rotation @ own)
    return moment / total
