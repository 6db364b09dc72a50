"""The constants of a tree's recursions as graphs of its parameters: inertia moved towards the ground.

In: a `KinematicTree`. Out: named constants, of which each recursion needs few. About its frame's origin a body has mass
m, first moment c and second moment S (the integral of r rᵀ dm, whose shifts and rotations are those of r rᵀ; inertia is
tr(S) 1 − S). What hangs on a hinge z and looks the same however it is turned (m, c_z, S_zz) belongs to its parent as
well as to it: it is moved there, body by body, which leaves a body on a hinge without mass (base parameters; Khalil and
Dombre, Modeling, Identification and Control of Robots, section 9.4). All of S is moved from a body on a slide. A body
that only ever turns about its own z keeps nothing of S but S_xx + S_yy.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from flexopt.model.kinematic_tree import KinematicTree
from flexopt.model.tree_quantities import snapped_rows
from flexopt.plant.tree_algebra import AXES, NOWHERE, ORIGIN, SECOND, ZERO, Moments, Triple, second_turned, turned
from flexopt.plant.tree_structure import Segment, ground_frame, segments_and_frames


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
    offsets: list[Triple] = []
    moments: list[Moments] = []
    for i, segment in enumerate(segments):
        of_parent = ground_frame(tree) if segment.parent < 0 else frames[segment.parent]
        offsets.append(turned(snapped_rows(of_parent.T), _vector(entry, f"offset{i}")))
        own, back = Moments(ZERO, ORIGIN, NOWHERE), snapped_rows(frames[i].T)
        if f"mass{i}" in entry:
            inertia = second_turned(back, _second_of(*(entry.get(f"inertia{i}.{ab}", ZERO) for ab in SECOND)))
            own = Moments(entry[f"mass{i}"], ORIGIN, inertia).moved(turned(back, _vector(entry, f"com{i}")))
        moments.append(own)
    tip = index[tree.end_point.body]
    end = turned(snapped_rows(frames[tip].T), _vector(entry, "tip"))
    moments[tip] += Moments(entry["payload"], ORIGIN, NOWHERE).moved(end)
    carried = _carried(segments, [own.mass for own in moments])
    _move_inwards(segments, offsets, moments)

    for i, (offset, own) in enumerate(zip(offsets, moments, strict=True)):
        result |= {f"offset{i}.{axis}": offset[k] for k, axis in enumerate(AXES)}
        result |= {f"m{i}": own.mass} | {f"c{i}.{axis}": own.first[k] for k, axis in enumerate(AXES)}
        result |= {f"s{i}.{ab}": own.second[ab] for ab in SECOND}
    result |= {f"tip.{axis}": end[k] for k, axis in enumerate(AXES)}
    result |= {key: graph for key, graph in entry.items() if key.startswith(("stiffness", "damping"))}
    result |= {f"rest{i}": entry.get(f"rest{i}", ZERO) for i, segment in enumerate(segments) if segment.passive}
    rotors = [entry.get(f"armature{i}", ZERO) for i in range(len(segments))]
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


def _move_inwards(segments: tuple[Segment, ...], offsets: list[Triple], moments: list[Moments]) -> None:
    for i, segment in reversed(list(enumerate(segments))):
        own = moments[i]
        if segment.slide:
            kept, moved = Moments(own.mass, own.first, NOWHERE), Moments(ZERO, ORIGIN, own.second)
        else:
            (x, y, z), zz = own.first, own.second["zz"]
            kept = Moments(ZERO, (x, y, ZERO), {**own.second, "zz": ZERO})
            turn = segment.turn
            moved = Moments(own.mass, turned(turn, (ZERO, ZERO, z)), second_turned(turn, {**NOWHERE, "zz": zz}))
        if segment.parent >= 0:
            moments[segment.parent] += moved.moved(offsets[i])
        if segment.parallel:
            kept = Moments(kept.mass, kept.first, {**NOWHERE, "xx": own.second["xx"] + own.second["yy"]})
        moments[i] = kept


def _vector(entry: Mapping[str, ca.SX], name: str) -> Triple:
    x, y, z = (entry.get(f"{name}.{axis}", ZERO) for axis in AXES)
    return x, y, z


def _second_of(xx: ca.SX, yy: ca.SX, zz: ca.SX, xy: ca.SX, xz: ca.SX, yz: ca.SX) -> dict[str, ca.SX]:
    """Second moment ½ tr(I) 1 − I."""
    diagonal = [0.5 * (yy + zz - xx), 0.5 * (xx + zz - yy), 0.5 * (xx + yy - zz)]
    return dict(zip(SECOND, (*diagonal, -xy, -xz, -yz), strict=True))
