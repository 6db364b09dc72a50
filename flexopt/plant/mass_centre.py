"""The centre of mass of a whole machine, its payload included, and how heavy that is on its coordinates at most.

In: a machine, the symbols of its parameters, its bodies' frames and mass matrix. Out: SX graphs.
"""

from __future__ import annotations

import casadi as ca

from flexopt.model import AnyMachine
from flexopt.plant.frames import Frames


def centre_of_mass(machine: AnyMachine, p: ca.SX, frames: Frames) -> ca.SX:
    """Σ m_j r_j / Σ m_j over every body that has mass and the payload at the end-point: (d,), m, inertial frame."""
    tree, value = machine.kinematic_tree, _by_entry(machine, p)
    moment = value["payload"] * frames.tip
    for i, origin, rotation in zip(tree.frames, frames.origins, frames.rotations, strict=True):
        if f"mass{i}" in value:
            own = ca.vertcat(*(value[f"com{i}.{axis}"] for axis in tree.axes))
            moment += value[f"mass{i}"] * (origin + rotation @ own)
    return moment / _total_mass(machine, p)


def most_weight(machine: AnyMachine, p: ca.SX, mass: ca.SX) -> ca.SX:
    """The bound g √(Σ m_j M_ii), (n_q,), N m or N, that no gravity force g_i exceeds, however the machine is turned.

    g_i = g Σ m_j ∂z_j/∂q_i, and Σ m_j (∂z_j/∂q_i)² ≤ M_ii: the inequality of Cauchy and Schwarz.
    """
    return _by_entry(machine, p)["gravity"] * ca.sqrt(_total_mass(machine, p) * ca.diag(mass))


def _total_mass(machine: AnyMachine, p: ca.SX) -> ca.SX:
    value = _by_entry(machine, p)
    return sum((value[f"mass{i}"] for i in machine.kinematic_tree.frames if f"mass{i}" in value), value["payload"])


def _by_entry(machine: AnyMachine, p: ca.SX) -> dict[str, ca.SX]:
    parameter = {parameter.name: p[k] for k, parameter in enumerate(machine.parameters)}
    return {entry: parameter[name] for entry, name in machine.kinematic_tree.entries.items()}
