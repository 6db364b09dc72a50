"""A machine's equations as graphs: a tree of bodies, in space or in a plane.

q lists the passive coordinates first. Where a passive slide at the ground runs along x or y and the placement does not
turn, it counts from the inertial origin and `base` moves its rest value; every other placement coordinate moves the
anchor frame, from which q is counted, and with it the end-point. The mass matrix, h, g, K and D do not depend on the
placement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from flexopt.errors import Fault, ModelError, raise_if_any
from flexopt.model import AnyMachine
from flexopt.model.kinematic_tree import KinematicTree
from flexopt.plant.singular_distance import ArmLine, singularity_sine_squared
from flexopt.plant.tree_algebra import ORIGIN, ZERO
from flexopt.plant.tree_constants import constant_graphs
from flexopt.plant.tree_recursion import Recursion
from flexopt.plant.tree_structure import Skeleton, skeleton
from flexopt.plant.tree_task import end_axes, in_inertial_axes, points, task

# Configurations at which the mass matrix is looked at, and the share of its diagonal that counts as singular.
PROBES, SINGULAR = 4, 1e-13


@dataclass(frozen=True)
class MachineGraph:
    """SX graphs of a machine; r and J in m, m/rad or 1.

    Shapes: n_q coordinates, n_p of them passive, n_b placement coordinates, p task rows, d axes (2 in a plane).

    Attributes:
        end_rotation: of the end-point's frame, (3, 3), inertial axes.
        segments: pairs of columns of `skeleton` (d, n_points) to join by lines in a picture.
        at: the recursions at q, from which everything comes.
    """

    q: ca.SX
    v: ca.SX
    base: ca.SX
    posture: ca.SX
    p: ca.SX
    end_point: ca.SX
    skeleton: ca.SX
    mass: ca.SX
    bias: ca.SX
    gravity: ca.SX
    stiffness: ca.SX
    damping: ca.SX
    rest: ca.SX
    singularity_sine_squared: ca.SX
    coordinates: tuple[str, ...]
    coordinate_units: tuple[str, ...]
    n_passive: int
    end_rotation: ca.SX
    segments: tuple[tuple[int, int], ...]
    at: Recursion


def build_graph(machine: AnyMachine, zeros: Sequence[str] = ()) -> MachineGraph:
    """All graphs of a machine.

    Args:
        machine: from a reader, `machine_from_dict` or `tree_from_dict`.
        zeros: names of parameters to leave out as exactly zero; graphs are smaller and do not depend on them.

    Raises:
        ModelError: the joints are not independent: M is singular wherever the joints stand.
    """
    tree = machine.kinematic_tree
    names = [parameter.name for parameter in machine.parameters]
    p = ca.SX.sym("p", len(names))
    value = {name: ZERO if name in zeros else p[i] for i, name in enumerate(names)}
    structure, constant = skeleton(tree), constant_graphs(tree, value)
    order, n_passive = structure.order, len(structure.passive)
    q, v = ca.SX.sym("q", len(order)), ca.SX.sym("v", len(order))
    base, posture = ca.SX.sym("base", len(structure.placement)), ca.SX.sym("posture", len(order) - n_passive)

    coordinate = [q[order.index(i)] if i in order else constant[f"rest{i}"] for i in range(len(tree.bodies))]
    rates = [v[order.index(i)] if i in order else ZERO for i in range(len(tree.bodies))]
    at = Recursion(
        structure, constant, [(ca.cos(angle), ca.sin(angle)) for angle in coordinate], coordinate, coordinate
    )
    rest = [at.of(f"rest{i}") for i in order[:n_passive]]
    for name, (i, sign) in structure.absorbed.items():
        rest[order.index(i)] += sign * base[structure.placement.index(name)]
    drawn, segments = _drawing(tree, structure)
    axes = ["xyz".index(axis) for axis in tree.axes]
    graph = MachineGraph(
        q=q,
        v=v,
        base=base,
        posture=posture,
        p=p,
        end_point=task(at, base),
        skeleton=ca.densify(points(at, base)[axes, drawn]),
        mass=_mass(at, order),
        bias=_by_order(at.forces(rates, ZERO), order),
        gravity=_by_order(at.forces([ZERO] * at.n, at.of("gravity")), order),
        stiffness=_coupled(at, "stiffness", structure.coupled_springs, order),
        damping=_coupled(at, "damping", structure.coupled_dampers, order),
        rest=ca.vertcat(*rest, posture),
        singularity_sine_squared=ZERO,
        coordinates=machine.coordinates,
        coordinate_units=machine.coordinate_units,
        n_passive=n_passive,
        end_rotation=ca.horzcat(*(ca.vertcat(*axis) for axis in end_axes(at, base))),
        segments=segments,
        at=at,
    )
    graph = replace(graph, singularity_sine_squared=_from_singular(at, graph))
    _check_mass(machine, graph)
    return graph


def _drawing(tree: KinematicTree, structure: Skeleton) -> tuple[list[int], tuple[tuple[int, int], ...]]:
    """Columns of `points` to draw, and the pairs of these to join: each body with the nearest drawn one before it."""
    kept = [-1 if i is None else i for i in tree.drawn]
    joined: list[tuple[int, int]] = []
    for i in kept[1:]:
        before = structure.segments[i].parent
        while before not in kept:
            before = structure.segments[before].parent
        joined.append((kept.index(before), kept.index(i)))
    return [1 + i for i in (*kept, structure.n)], (*joined, (kept.index(structure.tip), len(kept)))


def _mass(at: Recursion, order: list[int]) -> ca.SX:
    mass = ca.SX.zeros(len(order), len(order))
    for (i, j), entry in at.mass.items():
        if i not in order or j not in order:
            continue
        a, b = order.index(i), order.index(j)
        mass[a, b] = mass[b, a] = entry
    return mass


def _coupled(at: Recursion, word: str, pairs: tuple[tuple[int, int], ...], order: list[int]) -> ca.SX:
    matrix = ca.SX.zeros(len(order), len(order))
    for i, j in pairs:
        a, b = order.index(i), order.index(j)
        matrix[a, b] = matrix[b, a] = at.of(f"{word}{i}.{j}")
    return matrix


def _by_order(by_body: list[ca.SX], order: list[int]) -> ca.SX:
    return ca.densify(ca.vertcat(*(by_body[i] for i in order)))


def _from_singular(at: Recursion, graph: MachineGraph) -> ca.SX:
    """`singularity_sine_squared` of the arm."""
    structure, way = at.skeleton, at.skeleton.actuated_way
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
        inertial = [[ca.vertcat(*in_inertial_axes(of, each, base)) for each in vectors] for vectors in (steps, axes)]
        return ArmLine(*inertial)

    nowhere = ca.SX.zeros(graph.base.shape[0], 1)
    joints = graph.q[graph.n_passive :]
    return singularity_sine_squared(
        structure, line(at, graph.base), line(still, nowhere), graph.end_point, joints, at.of("task_length")
    )


def _check_mass(machine: AnyMachine, graph: MachineGraph) -> None:
    """M must be regular somewhere: two slides along one line without mass between them, say, are one."""
    function = ca.Function("mass", [graph.q, graph.p], [graph.mass])
    p = ca.DM([parameter.value for parameter in machine.parameters])
    generator = np.random.default_rng(0)
    best, weak = 0.0, 0
    for _ in range(PROBES):
        mass = function(generator.uniform(-1.5, 1.5, graph.q.shape[0]), p).full()
        scale = np.sqrt(np.maximum(np.diag(mass), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(mass / np.outer(scale, scale))
        if values[0] >= best:
            best, weak = float(values[0]), int(np.argmax(np.abs(vectors[:, 0])))
    if best <= SINGULAR:
        sentence = "moves no inertia of its own, wherever the joints stand: the mass matrix is singular"
        raise_if_any(ModelError, machine.name, [Fault(f"joint {graph.coordinates[weak]}", sentence)])
