"""Inverse kinematics in closed form, of an arm whose structure allows it: parallel hinges, two task rows across them.

In: a machine's graph, of whatever file. Out: its postures on a target, and how far the arm reaches, as graphs.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca

from flexopt.algebra import safe_norm
from flexopt.plant.chain_constants import sum_of
from flexopt.plant.graph import MachineGraph
from flexopt.plant.tree_algebra import ORIGIN
from flexopt.plant.tree_structure import Skeleton
from flexopt.plant.tree_task import placed


@dataclass(frozen=True, eq=False)
class InverseKinematicsGraph:
    """Closed-form inverse kinematics and the arm's segments, as SX graphs.

    Attributes:
        target: (2,); elbow: −1 or +1; unit: (n − 2,) free coordinates in [0, 1].
        posture: (n,).
        cos_elbow: beyond ±1 where the target is out of reach.
        bend: of the elbow, of any posture of the graph, rad.
        first_joint_point, segment_lengths: where the arm starts at rest (2,), and the lengths between its joints (n,).
    """

    target: ca.SX
    unit: ca.SX
    elbow: ca.SX
    posture: ca.SX
    cos_elbow: ca.SX
    bend: ca.SX
    first_joint_point: ca.SX
    segment_lengths: ca.SX


def has_closed_form(structure: Skeleton) -> bool:
    """Whether `build_inverse_kinematics` applies.

    The task has two position rows in the order of the axes, the placement moves along the first of them, and every
    joint on the way to the end-point is a hinge across their plane or a passive slide; all actuated joints are there.
    """
    way = structure.way_to(structure.tip)
    if structure.placement != structure.rows[:1] or any(structure.segments[i].slide for i in structure.actuated):
        return False
    return 2 <= len(structure.actuated) == len(structure.actuated_way) and structure.is_across(way)


def build_inverse_kinematics(graph: MachineGraph) -> InverseKinematicsGraph:
    """Postures that put the end-point on a target, passive joints at rest; angles turn row 1 to row 2.

    The last two segments close the chain: with d the vector from their first joint to the target, the cosine of the
    elbow is (|d|² − L1² − L2²) / (2 L1 L2), its sign `elbow` (−1: "up", +1: "down"). Each segment of length l before
    them is turned by ψ from the direction to the target, at distance d; what remains of the arm reaches from there if

        (d² + l² − outer²) / (2 d l) ≤ cos ψ ≤ (d² + l² − inner²) / (2 d l),

    and its unit coordinate runs through exactly those ψ, from −ψ_max over ±ψ_min to ψ_max. So every unit coordinate
    gives a posture wherever there is one.
    """
    at = graph.at
    joints, structure = at.skeleton.actuated, at.skeleton
    rows = ["xyz".index(row) for row in structure.rows]
    n = len(joints)
    target, elbow, unit = ca.SX.sym("target", 2), ca.SX.sym("elbow"), ca.SX.sym("unit", n - 2)
    places = [ca.vertcat(*placed(at, at.point(i, ORIGIN), graph.base))[rows] for i in joints]
    moving = ca.horzcat(*places, graph.end_point)
    straight = ca.substitute(ca.substitute(moving, graph.q, graph.rest), graph.posture, ca.SX.zeros(n, 1))
    corners = ca.horzsplit(straight)
    segments = [end - start for start, end in pairwise(corners)]
    lengths = [ca.norm_2(segment) for segment in segments]
    # Direction of each segment with all joints at 0; the joints before it add their angles.
    bearings = [ca.atan2(segment[1], segment[0]) for segment in segments]
    senses = [structure.sense_across(i) for i in joints]

    angles: list[ca.SX] = []
    turned, point = ca.SX(0), corners[0]
    for k in range(n - 2):
        away = target - point
        distance = safe_norm(away)
        rest = lengths[k + 1 :]
        outer = sum_of(rest)
        inner = ca.fmax(0, 2 * functools.reduce(ca.fmax, rest) - outer)
        both = distance**2 + lengths[k] ** 2
        least = _acos((both - inner**2) / (2 * distance * lengths[k]))
        most = _acos((both - outer**2) / (2 * distance * lengths[k]))
        side = 2 * unit[k] - 1
        turn = ca.if_else(side < 0, -1.0, 1.0) * (least + (most - least) * ca.fabs(side))
        absolute = ca.atan2(away[1], away[0]) + turn
        angles.append(absolute - bearings[k] - turned)
        turned = turned + angles[-1]
        point = point + lengths[k] * _e(absolute)
    away = target - point
    l1, l2 = lengths[-2:]
    cos_elbow = (ca.dot(away, away) - l1**2 - l2**2) / (2 * l1 * l2)
    bend = elbow * _acos(cos_elbow)
    absolute = ca.atan2(away[1], away[0]) - ca.atan2(l2 * ca.sin(bend), l1 + l2 * ca.cos(bend))
    angles += [absolute - bearings[-2] - turned, bend - (bearings[-1] - bearings[-2])]
    return InverseKinematicsGraph(
        target=target,
        unit=unit,
        elbow=elbow,
        posture=ca.vertcat(
            *(sense * ca.atan2(ca.sin(angle), ca.cos(angle)) for sense, angle in zip(senses, angles, strict=True))
        ),
        cos_elbow=cos_elbow,
        bend=senses[-1] * graph.posture[-1] + bearings[-1] - bearings[-2],
        first_joint_point=corners[0],
        segment_lengths=ca.vertcat(*lengths),
    )


def _acos(cosine: ca.SX) -> ca.SX:
    return ca.acos(ca.fmax(-1, ca.fmin(1, cosine)))


def _e(angle: ca.SX) -> ca.SX:
    return ca.vertcat(ca.cos(angle), ca.sin(angle))
