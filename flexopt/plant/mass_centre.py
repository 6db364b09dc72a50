"""The centre of mass of a whole machine, its payload included.

In: a machine, the symbols of its parameters and its bodies' frames. Out: an SX graph.
"""

from __future__ import annotations

import casadi as ca

from flexopt.model import AnyMachine
from flexopt.plant.frames import Frames


def centre_of_mass(machine: AnyMachine, p: ca.SX, frames: Frames) -> ca.SX:
    """Σ m_j r_j / Σ m_j over every body that has mass and the payload at the end-point: (d,), m, inertial frame."""
    tree = machine.kinematic_tree
    parameter = {parameter.name: p[k] for k, parameter in enumerate(machine.parameters)}
    value = {entry: parameter[name] for entry, name in tree.entries.items()}
    total = value["payload"]
    moment = total * frames.tip
    for i, origin, rotation in zip(tree.frames, frames.origins, frames.rotations, strict=True):
        if f"mass{i}" in value:
            mass, own = value[f"mass{i}"], ca.vertcat(*(value[f"com{i}.{axis}"] for axis in tree.axes))
            total += mass
            moment += mass * (origin + rotation @ own)
    return moment / total
