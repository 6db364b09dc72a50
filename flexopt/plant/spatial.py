"""A tree of bodies in space: every graph of the plant, by the names and conventions of `planar.ChainGraph`.

q lists the passive coordinates first. Where a passive slide at the ground runs along x or y and the placement does not
turn, it counts from the inertial origin and `base` moves its rest value, as in the plane; every other placement
coordinate moves the anchor frame, from which q is counted, and with it the end-point. The mass matrix, h, g, K and D do
not depend on the placement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from flexopt.errors import Fault, ModelError, raise_if_any
from flexopt.model.tree import Tree
from flexopt.plant.planar import ChainGraph
from flexopt.plant.singular_distance import singularity_sine_squared
from flexopt.plant.tree_algebra import ORIGIN, ZERO
from flexopt.plant.tree_constants import constant_graphs
from flexopt.plant.tree_recursion import Recursion
from flexopt.plant.tree_structure import Skeleton, skeleton
from flexopt.plant.tree_task import end_axes, points, task

# Configurations at which the mass matrix is looked at, and the share of its diagonal that counts as singular.
PROBES, SINGULAR = 4, 1e-13


@dataclass(frozen=True)
class SpatialGraph(ChainGraph):
    """SX graphs of a tree. Shapes as in `ChainGraph`, with p task rows; r and J in m, m/rad or 1.

    Attributes:
        end_rotation: of the end-point's frame, (3, 3), inertial axes.
        segments: pairs of columns of `skeleton` (3, n_bodies + 2) to join by lines in a picture.
    """

    end_rotation: ca.SX
    segments: tuple[tuple[int, int], ...]


def build_spatial(tree: Tree, zeros: Sequence[str] = ()) -> SpatialGraph:
    """All graphs of a tree.

    Args:
        tree: from a reader or `tree_from_dict`.
        zeros: names of parameters to leave out as exactly zero; graphs are smaller and do not depend on them.

    Raises:
        ModelError: the joints are not independent: M is singular wherever the joints stand.
    """
    names = [parameter.name for parameter in tree.parameters]
    p = ca.SX.sym("p", len(names))
    value = {name: ZERO if name in zeros else p[i] for i, name in enumerate(names)}
    structure, constant = skeleton(tree), constant_graphs(tree, value)
    order, n = structure.order, len(tree.bodies)
    n_passive = n - len(structure.actuated)
    q, v = ca.SX.sym("q", n), ca.SX.sym("v", n)
    base, posture = ca.SX.sym("base", len(structure.placement)), ca.SX.sym("posture", n - n_passive)

    coordinate = [q[order.index(i)] for i in range(n)]
    rates = [v[order.index(i)] for i in range(n)]
    at = Recursion(structure, constant, [(ca.cos(angle), ca.sin(angle)) for angle in coordinate], coordinate)
    rest = [at.of(f"rest{i}") for i in order[:n_passive]]
    for name, (i, sign) in structure.absorbed.items():
        rest[order.index(i)] += sign * base[structure.placement.index(name)]
    graph = SpatialGraph(
        q=q,
        v=v,
        base=base,
        posture=posture,
        p=p,
        end_point=task(at, base),
        skeleton=ca.densify(points(at, base)),
        mass=_mass(at, order),
        bias=_by_order(at.forces(rates, ZERO), order),
        gravity=_by_order(at.forces([ZERO] * n, at.of("gravity")), order),
        stiffness=_coupled(at, "stiffness", structure.coupled_springs, order),
        damping=_coupled(at, "damping", structure.coupled_dampers, order),
        rest=ca.vertcat(*rest, posture),
        singularity_sine_squared=ZERO,
        coordinates=tree.coordinates,
        coordinate_units=tree.coordinate_units,
        n_passive=n_passive,
        end_rotation=ca.horzcat(*(ca.vertcat(*axis) for axis in end_axes(at, base))),
        segments=_segments(structure),
    )
    object.__setattr__(graph, "singularity_sine_squared", _from_singular(at, graph))
    _check_mass(tree, graph)
    return graph


def _segments(structure: Skeleton) -> tuple[tuple[int, int], ...]:
    """Ground to first bodies, body to body, last body to end-point; column 0 is the ground, 1 + i is body i."""
    joined = [(1 + segment.parent, 1 + i) for i, segment in enumerate(structure.segments)]
    return (*joined, (1 + structure.tip, 1 + len(structure.segments)))


def _mass(at: Recursion, order: list[int]) -> ca.SX:
    mass = ca.SX.zeros(at.n, at.n)
    for (i, j), entry in at.mass.items():
        a, b = order.index(i), order.index(j)
        mass[a, b] = mass[b, a] = entry
    return mass


def _coupled(at: Recursion, word: str, pairs: tuple[tuple[int, int], ...], order: list[int]) -> ca.SX:
    matrix = ca.SX.zeros(at.n, at.n)
    for i, j in pairs:
        a, b = order.index(i), order.index(j)
        matrix[a, b] = matrix[b, a] = at.of(f"{word}{i}.{j}")
    return matrix


def _by_order(by_body: list[ca.SX], order: list[int]) -> ca.SX:
    return ca.densify(ca.vertcat(*(by_body[i] for i in order)))


def _from_singular(at: Recursion, graph: SpatialGraph) -> ca.SX:
    """`singularity_sine_squared` of the arm; lengths between joints are taken with the actuated hinges at zero."""
    structure, n_passive = at.skeleton, graph.n_passive
    along = [(ca.SX(1), ZERO) if i in structure.actuated else pair for i, pair in enumerate(at.along)]
    still = Recursion(structure, at.value, along, at.displacement)
    joints = [
        (ca.vertcat(*still.point(i, ORIGIN)), ca.vertcat(*still.to_ground(i, (ZERO, ZERO, ca.SX(1)))))
        for i in range(at.n)
    ]
    tip = ca.vertcat(*still.point(structure.tip, still.vector("tip")))
    jacobian = ca.jacobian(graph.end_point, graph.q)[:, n_passive:]
    return singularity_sine_squared(structure, jacobian, joints, tip, at.of("task_length"))


def _check_mass(tree: Tree, graph: SpatialGraph) -> None:
    """M must be regular somewhere: two slides along one line without mass between them, say, are one."""
    function = ca.Function("mass", [graph.q, graph.p], [graph.mass])
    p = ca.DM([parameter.value for parameter in tree.parameters])
    generator = np.random.default_rng(0)
    best, weak = 0.0, 0
    for _ in range(PROBES):
        mass = function(generator.uniform(-1.5, 1.5, len(tree.bodies)), p).full()
        scale = np.sqrt(np.maximum(np.diag(mass), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(mass / np.outer(scale, scale))
        if values[0] >= best:
            best, weak = float(values[0]), int(np.argmax(np.abs(vectors[:, 0])))
    if best <= SINGULAR:
        sentence = "moves no inertia of its own, wherever the joints stand: the mass matrix is singular"
        raise_if_any(ModelError, tree.name, [Fault(f"joint {tree.coordinates[weak]}", sentence)])
