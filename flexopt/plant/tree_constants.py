"""The constants of a tree's recursions as graphs of its parameters: inertia moved towards the ground.

In: a `KinematicTree`. Out: named constants, of which each recursion needs few. About its frame's origin a body has mass
m, first moment c and second moment S (the integral of r rᵀ dm, whose shifts and rotations are those of r rᵀ; inertia is
tr(S) 1 − S). What hangs on a hinge z and looks the same however it is turned (m, c_z, S_zz) belongs to its parent as
well as to it: it is moved there, body by body, which leaves a body on a hinge without mass (base parameters; Khalil and
Dombre, Modeling, Identification and Control of Robots, section 9.4). All of S is moved from a body on a slide. A body
that only ever turns about its own z keeps nothing of S but S_xx + S_yy.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from flexopt.model.kinematic_tree import INERTIA_ENTRIES, KinematicTree
from flexopt.plant.tree_structure import Matrix, Segment, ground_frame, rounded, segments_and_frames

AXES = "xyz"
SECOND = INERTIA_ENTRIES


@dataclass
class _Moments:
    """Mass, first moment and second moment (3, 3) about a frame's origin."""

    mass: ca.SX
    first: ca.SX
    second: ca.SX

    def add(self, mass: ca.SX, first: ca.SX, second: ca.SX, at: ca.SX) -> None:
        """What has these moments about `at`, in the same axes."""
        self.mass += mass
        self.first += first + mass * at
        self.second += second + at @ first.T + first @ at.T + mass * at @ at.T


def constant_graphs(tree: KinematicTree, value: Mapping[str, ca.SX]) -> dict[str, ca.SX]:
    """The constants of the recursions by name, from the parameters by name.

    For body i: offset{i}.x … of its joint in the parent's frame, m{i}, c{i}.x …, s{i}.xx …; joints: stiffness{i}.{j},
    damping{i}.{j}, rest{i}, armature{i}; inverse{i}, the reciprocal of all that slide i accelerates; tip.x … in its
    body's frame; gravity; task_length.
    """
    segments, frames = segments_and_frames(tree)
    entry = {key: value[name] for key, name in tree.entries.items()}
    index = {body.name: i for i, body in enumerate(tree.bodies)}
    result: dict[str, ca.SX] = {}
    offsets: list[ca.SX] = []
    moments: list[_Moments] = []
    for i, segment in enumerate(segments):
        of_parent = ground_frame(tree) if segment.parent < 0 else frames[segment.parent]
        offsets.append(_turned(of_parent.T, _vector(entry, f"offset{i}")))
        own = _Moments(ca.SX(0), ca.SX.zeros(3, 1), ca.SX.zeros(3, 3))
        if f"mass{i}" in entry:
            at = _turned(frames[i].T, _vector(entry, f"com{i}"))
            inertia = [entry.get(f"inertia{i}.{ab}", ca.SX(0)) for ab in SECOND]
            zero = ca.SX.zeros(3, 1)
            own.add(entry[f"mass{i}"], zero, _both(frames[i].T, _second_of(inertia)), at)
        moments.append(own)
    tip = index[tree.end_point.body]
    end = _turned(frames[tip].T, _vector(entry, "tip"))
    moments[tip].add(entry["payload"], ca.SX.zeros(3, 1), ca.SX.zeros(3, 3), end)
    carried = _carried(segments, [own.mass for own in moments])
    _move_inwards(segments, offsets, moments)

    for i, (offset, own) in enumerate(zip(offsets, moments, strict=True)):
        result |= {f"offset{i}.{axis}": offset[k] for k, axis in enumerate(AXES)}
        result |= {f"m{i}": own.mass} | {f"c{i}.{axis}": own.first[k] for k, axis in enumerate(AXES)}
        result |= {f"s{i}.{ab}": own.second[AXES.index(ab[0]), AXES.index(ab[1])] for ab in SECOND}
    result |= {f"tip.{axis}": end[k] for k, axis in enumerate(AXES)}
    result |= {key: graph for key, graph in entry.items() if key.startswith(("stiffness", "damping"))}
    result |= {f"rest{i}": entry.get(f"rest{i}", ca.SX(0)) for i, segment in enumerate(segments) if segment.passive}
    rotors = [entry.get(f"armature{i}", ca.SX(0)) for i in range(len(segments))]
    result |= {f"armature{i}": rotor for i, rotor in enumerate(rotors)}
    moved = [mass + rotor for mass, rotor in zip(carried, rotors, strict=True)]
    result |= {f"inverse{i}": 1 / mass for i, mass in enumerate(moved) if segments[i].slide}
    return result | {"gravity": entry["gravity"], "task_length": ca.SX(tree.end_point.length)}


def _carried(segments: tuple[Segment, ...], masses: list[ca.SX]) -> list[ca.SX]:
    """Mass of each body and all beyond it."""
    carried = list(masses)
    for i in reversed(range(len(segments))):
        if segments[i].parent >= 0:
            carried[segments[i].parent] += carried[i]
    return carried


def _move_inwards(segments: tuple[Segment, ...], offsets: list[ca.SX], moments: list[_Moments]) -> None:
    for segment, offset, own in zip(reversed(segments), reversed(offsets), reversed(moments), strict=True):
        turn = np.array(segment.turn)
        if segment.slide:
            moved = (ca.SX(0), ca.SX.zeros(3, 1), own.second)
            own.second = ca.SX.zeros(3, 3)
        else:
            along = ca.SX(turn[:, 2])
            moved = (own.mass, along * own.first[2], along @ along.T * own.second[2, 2])
            own.mass, own.first[2], own.second[2, 2] = ca.SX(0), ca.SX(0), ca.SX(0)
        if segment.parent >= 0:
            moments[segment.parent].add(*moved, offset)
    for own, segment in zip(moments, segments, strict=True):
        if segment.parallel:
            about = own.second[0, 0] + own.second[1, 1]
            own.second = ca.SX.zeros(3, 3)
            own.second[0, 0] = about


def _vector(entry: Mapping[str, ca.SX], name: str) -> ca.SX:
    return ca.vertcat(*(entry.get(f"{name}.{axis}", ca.SX(0)) for axis in AXES))


def _turned(matrix: Matrix, vector: ca.SX) -> ca.SX:
    """Matrix · vector, zeros and ones of the matrix folded."""
    return ca.vertcat(*(_sum(entry * vector[k] for k, entry in enumerate(row) if entry) for row in rounded(matrix)))


def _both(matrix: Matrix, square: ca.SX) -> ca.SX:
    """Matrix · square · matrixᵀ."""
    left = ca.horzcat(*(_turned(matrix, square[:, k]) for k in range(3)))
    return ca.horzcat(*(_turned(matrix, left[k, :].T) for k in range(3))).T


def _second_of(inertia: list[ca.SX]) -> ca.SX:
    """Second moment ½ tr(I) 1 − I."""
    xx, yy, zz, xy, xz, yz = inertia
    diagonal = [0.5 * (yy + zz - xx), 0.5 * (xx + zz - yy), 0.5 * (xx + yy - zz)]
    return ca.vertcat(
        ca.horzcat(diagonal[0], -xy, -xz), ca.horzcat(-xy, diagonal[1], -yz), ca.horzcat(-xz, -yz, diagonal[2])
    )


def _sum(terms: Iterable[ca.SX]) -> ca.SX:
    return sum(terms, start=ca.SX(0))
