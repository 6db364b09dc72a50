"""Where every body of a machine is: origin and axes of its frame, and the end-point's, in inertial axes.

In: a machine and its graph. Out: `Frames`, SX graphs of q, base and p. The frames are those of the machine file: in the
plane a body's axes run along it and to its left, from the joint that carries it (the base's: from the ground point).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from flexopt.model import AnyMachine, Machine, Tree
from flexopt.plant.planar import ChainGraph
from flexopt.plant.spatial import SpatialGraph
from flexopt.plant.tree_algebra import ORIGIN, ZERO, Vector, turned_back
from flexopt.plant.tree_constants import constant_graphs
from flexopt.plant.tree_recursion import Recursion
from flexopt.plant.tree_structure import rounded, segments_and_frames, skeleton
from flexopt.plant.tree_task import in_inertial_axes, placed


@dataclass(frozen=True)
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


def build_frames(machine: AnyMachine, graph: ChainGraph) -> Frames:
    """The frames of a machine whose graph this is."""
    if isinstance(machine, Tree):
        assert isinstance(graph, SpatialGraph)
        return _of_tree(machine, graph)
    assert isinstance(machine, Machine)
    return _of_chain(machine, graph)


def _of_chain(machine: Machine, graph: ChainGraph) -> Frames:
    names = [parameter.name for parameter in machine.parameters]
    of_q = {name: graph.q[k] for k, name in enumerate(graph.coordinates)}
    angle = of_q.get("base.rotation", graph.p[names.index("base.rest_angle")])
    rotations = [_rotation(angle)]
    for link in machine.links:
        angle += of_q[link.name]
        rotations.append(_rotation(angle))
    return Frames(
        names=("base", *(link.name for link in machine.links)),
        origins=tuple(graph.skeleton[:, k] for k in range(len(rotations))),
        rotations=tuple(rotations),
        tip=graph.end_point,
        tip_rotation=rotations[-1],
    )


def _rotation(angle: ca.SX) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(c, -s), ca.horzcat(s, c))


def _of_tree(tree: Tree, graph: SpatialGraph) -> Frames:
    structure = skeleton(tree)
    value = {parameter.name: graph.p[k] for k, parameter in enumerate(tree.parameters)}
    coordinate = [graph.q[structure.order.index(i)] for i in range(len(tree.bodies))]
    along = [(ca.cos(angle), ca.sin(angle)) for angle in coordinate]
    at = Recursion(structure, constant_graphs(tree, value), along, coordinate)
    _, own = segments_and_frames(tree)
    origins: list[ca.SX] = []
    rotations: list[ca.SX] = []
    for i in range(len(tree.bodies)):
        origins.append(ca.vertcat(*placed(at, at.point(i, ORIGIN), graph.base)))
        # The recursion's frame of a body is its own choice; `own` leads from it to the machine file's.
        axes = [turned_back(rounded(own[i]), _unit(k)) for k in range(3)]
        inertial = [in_inertial_axes(at, at.to_ground(i, axis), graph.base) for axis in axes]
        rotations.append(ca.horzcat(*(ca.vertcat(*axis) for axis in inertial)))
    return Frames(
        names=tuple(body.name for body in tree.bodies),
        origins=tuple(origins),
        rotations=tuple(rotations),
        tip=ca.vertcat(*placed(at, at.point(structure.tip, at.vector("tip")), graph.base)),
        tip_rotation=graph.end_rotation,
    )


def _unit(k: int) -> Vector:
    axis = [ZERO] * 3
    axis[k] = ca.SX(1)
    return axis[0], axis[1], axis[2]
