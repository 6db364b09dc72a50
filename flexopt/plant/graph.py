"""A machine's equations as graphs: a tree of bodies, in space or in a plane.

q lists the passive coordinates first. Where a passive slide at the ground runs along x or y and the placement does not
turn, it counts from the inertial origin and `base` moves its rest value; every other placement coordinate moves the
anchor frame, from which q is counted, and with it the end-point. The mass matrix, h, g, K and D do not depend on the
placement.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from flexopt.errors import Fault, ModelError, raise_if_any
from flexopt.foundation.arrays import Array, spread
from flexopt.model import AnyMachine
from flexopt.model.kinematic_tree import KinematicTree
from flexopt.plant.singular_distance import ArmLine, singularity_sine_squared
from flexopt.plant.tree_algebra import ORIGIN, ZERO
from flexopt.plant.tree_constants import constant_graphs
from flexopt.plant.tree_recursion import Recursion
from flexopt.plant.tree_structure import skeleton
from flexopt.plant.tree_task import end_axes, in_inertial_axes, points, task

# Configurations at which the mass matrix is looked at, and the share of its diagonal that counts as singular.
PROBES, SINGULAR = 4, 1e-13


@dataclass(frozen=True, eq=False)
class MachineGraph:
    """SX graphs of a machine, each built when it is first asked for; r and J in m, m/rad or 1.

    Shapes: n_q coordinates, n_p of them passive, n_b placement coordinates, p task rows, d axes (2 in a plane).

    Attributes:
        q, v, base, posture, p: the symbols.
        tree: the machine as bodies and joints.
        at: the recursions at q, from which everything comes.
    """

    q: ca.SX
    v: ca.SX
    base: ca.SX
    posture: ca.SX
    p: ca.SX
    coordinates: tuple[str, ...]
    coordinate_units: tuple[str, ...]
    tree: KinematicTree
    at: Recursion

    @property
    def n_passive(self) -> int:
        """Number of passive coordinates."""
        return len(self.at.skeleton.passive)

    @cached_property
    def end_point(self) -> ca.SX:
        """R (p,)."""
        return task(self.at, self.base)

    @cached_property
    def end_rotation(self) -> ca.SX:
        """Of the end-point's frame, (3, 3), inertial axes."""
        return ca.horzcat(*(ca.vertcat(*axis) for axis in end_axes(self.at, self.base)))

    @cached_property
    def skeleton(self) -> ca.SX:
        """Points to draw, a column each, (d, n_points)."""
        drawn = [1 + i for i in (*self._drawn, self.at.n)]
        return ca.densify(points(self.at, self.base)[["xyz".index(axis) for axis in self.tree.axes], drawn])

    @cached_property
    def segments(self) -> tuple[tuple[int, int], ...]:
        """Pairs of columns of `skeleton` to join by lines in a picture: each body with the nearest drawn one before."""
        kept, bodies, joined = self._drawn, self.at.skeleton.segments, list[tuple[int, int]]()
        for i in kept[1:]:
            before = bodies[i].parent
            while before not in kept:
                before = bodies[before].parent
            joined.append((kept.index(before), kept.index(i)))
        return (*joined, (kept.index(self.at.skeleton.tip), len(kept)))

    @property
    def _drawn(self) -> list[int]:
        return [-1 if i is None else i for i in self.tree.drawn]

    @cached_property
    def mass(self) -> ca.SX:
        """M (n_q, n_q)."""
        return self._by_joints(self.at.mass)

    @cached_property
    def bias(self) -> ca.SX:
        """H (n_q,)."""
        order = self.at.skeleton.order
        rates = [self.v[order.index(i)] if i in order else ZERO for i in range(self.at.n)]
        return self._by_order(self.at.forces(rates, ZERO))

    @cached_property
    def gravity(self) -> ca.SX:
        """G (n_q,)."""
        return self._by_order(self.at.forces([ZERO] * self.at.n, self.at.of("gravity")))

    @cached_property
    def stiffness(self) -> ca.SX:
        """K (n_q, n_q)."""
        pairs = self.at.skeleton.coupled_springs
        return self._by_joints({(i, j): self.at.of(f"stiffness{i}.{j}") for i, j in pairs})

    @cached_property
    def damping(self) -> ca.SX:
        """D (n_q, n_q)."""
        pairs = self.at.skeleton.coupled_dampers
        return self._by_joints({(i, j): self.at.of(f"damping{i}.{j}") for i, j in pairs})

    @cached_property
    def rest(self) -> ca.SX:
        """Q at rest (n_q,), of base, posture and p."""
        structure = self.at.skeleton
        rest = [self.at.of(f"rest{i}") for i in structure.passive]
        for name, (i, sign) in structure.absorbed.items():
            rest[structure.order.index(i)] += sign * self.base[structure.placement.index(name)]
        return ca.vertcat(*rest, self.posture)

    @cached_property
    def singularity_sine_squared(self) -> ca.SX:
        """Distance of the arm from singular postures, see `singular_distance`."""
        at, structure, way = self.at, self.at.skeleton, self.at.skeleton.actuated_way
        if len(way) < len(structure.rows):
            return ZERO
        # Lengths do not depend on how the arm stands, nor on what carries it.
        carried = structure.way_to(way[0])
        along = [
            (ca.SX(1), ZERO) if i in structure.actuated or i in carried else (ca.cos(q), ca.sin(q))
            for i, q in enumerate(at.displacement)
        ]
        displacement = [ZERO if i in carried else part for i, part in enumerate(at.displacement)]
        still = Recursion(structure, at.value, along, displacement)

        def line(of: Recursion, base: ca.SX) -> ArmLine:
            ends = [(i, ORIGIN) for i in way[1:]] + [(structure.tip, of.vector("tip"))]
            steps = [of.step(i, *end) for i, end in zip(way, ends, strict=True)]
            axes = [of.to_ground(i, of.direction(i)) for i in way]
            inertial = [[ca.vertcat(*in_inertial_axes(of, each, base)) for each in parts] for parts in (steps, axes)]
            return ArmLine(*inertial)

        nowhere = ca.SX.zeros(self.base.shape[0], 1)
        joints, length = self.q[self.n_passive :], at.of("task_length")
        lines = line(at, self.base), line(still, nowhere)
        return singularity_sine_squared(structure, *lines, self.end_point, joints, length)

    def _by_joints(self, entries: Mapping[tuple[int, int], ca.SX]) -> ca.SX:
        """A symmetric matrix from its entries by bodies; those of joints that are no coordinates are left out."""
        order = self.at.skeleton.order
        matrix = ca.SX.zeros(len(order), len(order))
        for (i, j), entry in entries.items():
            if i in order and j in order:
                a, b = order.index(i), order.index(j)
                matrix[a, b] = matrix[b, a] = entry
        return matrix

    def _by_order(self, by_body: list[ca.SX]) -> ca.SX:
        return ca.densify(ca.vertcat(*(by_body[i] for i in self.at.skeleton.order)))


def build_graph(machine: AnyMachine, zeros: Sequence[str] = ()) -> MachineGraph:
    """All graphs of a machine.

    Args:
        machine: from a reader, `machine_from_dict` or `tree_from_dict`.
        zeros: names of parameters to leave out as exactly zero; graphs are smaller and do not depend on them.
    """
    tree = machine.kinematic_tree
    names = [parameter.name for parameter in machine.parameters]
    p = ca.SX.sym("p", len(names))
    value = {name: ZERO if name in zeros else p[i] for i, name in enumerate(names)}
    structure, constant = skeleton(tree), constant_graphs(tree, value)
    order = structure.order
    q, v = ca.SX.sym("q", len(order)), ca.SX.sym("v", len(order))
    base = ca.SX.sym("base", len(structure.placement))
    posture = ca.SX.sym("posture", len(order) - len(structure.passive))
    coordinate = [q[order.index(i)] if i in order else constant[f"rest{i}"] for i in range(len(tree.bodies))]
    along = [(ca.cos(angle), ca.sin(angle)) for angle in coordinate]
    at = Recursion(structure, constant, along, coordinate, coordinate)
    return MachineGraph(q, v, base, posture, p, machine.coordinates, machine.coordinate_units, tree, at)


def check_mass(machine: AnyMachine, mass_at: ca.Function) -> None:
    """Refuse a mass matrix that is singular everywhere: of two slides along one line without mass between them, say.

    Raises:
        ModelError: the joints are not independent.
    """
    p = ca.DM([parameter.value for parameter in machine.parameters])
    best, weak, base = 0.0, 0, ca.DM.zeros(mass_at.size1_in(1))
    for share in spread(PROBES, mass_at.size1_in(0)):
        mass: Array = mass_at.call([ca.DM(3.0 * share - 1.5), base, p])[0].full()
        scale = np.sqrt(np.maximum(np.diag(mass), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(mass / np.outer(scale, scale))
        if values[0] >= best:
            best, weak = float(values[0]), int(np.argmax(np.abs(vectors[:, 0])))
    if best <= SINGULAR:
        sentence = "moves no inertia of its own, wherever the joints stand: the mass matrix is singular"
        raise_if_any(ModelError, machine.name, [Fault(f"joint {machine.coordinates[weak]}", sentence)])
