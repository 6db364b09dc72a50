"""Where every body of a machine is: origin and axes of its frame, and the end-point's, in inertial axes.

In: a machine and its graph. Out: `Frames`, SX graphs of q, base and p. The frames are those of the machine file: in the
plane a body's axes run along it and to its left, from the joint that carries it (the base's: from the ground point).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from flexopt.model import AnyMachine
from flexopt.model.tree_quantities import snapped_rows
from flexopt.plant.graph import MachineGraph
from flexopt.plant.tree_algebra import UNITS, turned_back
from flexopt.plant.tree_structure import segments_and_frames
from flexopt.plant.tree_task import in_inertial_axes, origin, placed


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames of bodies as SX graphs of q, base and p; d = 2 in the plane, 3 in space.

    Attributes:
        names: of the bodies, from the base outwards.
        origins: (d,) of each, m, inertial frame.
        rotations: (d, d) of each: columns are the body's axes in inertial ones.
        tip: the end-point, (d,), m;  tip_rotation: of its frame, (d, d). In the plane its axes are the last body's.
    """

    names: tuple[str, ...]
    origins: tuple[ca.SX, ...]
    rotations: tuple[ca.SX, ...]
    tip: ca.SX
    tip_rotation: ca.SX

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in space."""
        return self.tip.shape[0]


def build_frames(machine: AnyMachine, graph: MachineGraph) -> Frames:
    """The frames of a machine whose graph this is."""
    tree, at = machine.kinematic_tree, graph.at
    _, own = segments_and_frames(tree)
    axes = ["xyz".index(axis) for axis in tree.axes]
    origins: list[ca.SX] = []
    rotations: list[ca.SX] = []
    for i in tree.frames:
        origins.append(ca.vertcat(*origin(at, i, graph.base))[axes])
        # The recursion's frame of a body is its own choice; `own` leads from it to the machine file's.
        directions = [turned_back(snapped_rows(own[i]), UNITS[k]) for k in axes]
        inertial = [in_inertial_axes(at, at.to_ground(i, direction), graph.base) for direction in directions]
        rotations.append(ca.horzcat(*(ca.vertcat(*axis) for axis in inertial))[axes, :])
    tip = placed(at, at.point(at.skeleton.tip, at.vector("tip")), graph.base)
    return Frames(
        names=tuple(tree.bodies[i].name for i in tree.frames),
        origins=tuple(origins),
        rotations=tuple(rotations),
        tip=ca.vertcat(*tip)[axes],
        tip_rotation=graph.end_rotation[axes, axes],
    )
