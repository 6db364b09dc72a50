"""A base that is driven along a path: what the machine's structure must have for it, and what forbids it.

In: a machine, a closed loop's options. Out: the structure, placements as `Motion` takes them, faults.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from flexopt.errors import Fault
from flexopt.foundation.arrays import Vector
from flexopt.foundation.plain import listed
from flexopt.loop.rest import in_base_axes
from flexopt.model import AnyMachine
from flexopt.model.simulation import SimulationOptions, placement_of
from flexopt.plant.machine_motion import motion_of, structure_of
from flexopt.plant.motion import Motion
from flexopt.plant.tree_structure import TURN, Skeleton


def moved(motion: Motion, points: Vector, base: Vector) -> Vector:
    """Placements (K, n_b) as `Motion` takes them, (K, n_d): from `base`, x and y in the axes in which it stands."""
    away = dict(zip(motion.placement, (points - base).T, strict=True))
    if "yaw" in away:
        yaw, nothing = float(base[motion.placement.index("yaw")]), np.zeros(len(points))
        cosine, sine = np.full_like(nothing, math.cos(yaw)), np.full_like(nothing, math.sin(yaw))
        away = in_base_axes(away, cosine, sine, nothing) | {TURN: away["yaw"]}
    columns: Vector = np.stack([away[name] for name in motion.drive], axis=1)
    return columns


def driven_structure(machine: AnyMachine, options: SimulationOptions) -> Skeleton:
    """The machine's structure, and what a base path drives besides its placement."""
    structure, path = structure_of(machine), options.base_path
    if path is None or "yaw" not in structure.placement:
        return structure
    placement, base = structure.placement, np.array(placement_of(options, machine))
    k = placement.index("yaw")
    turns = bool(np.any(np.array(path.points)[:, k] != base[k]))
    across = tuple(name for name in ("x", "y") if name not in placement) if turns or base[k] else ()
    return replace(structure, also=across + (TURN,) * turns)


def path_faults(machine: AnyMachine, options: SimulationOptions) -> list[Fault]:
    """Base paths that would jerk the machine along."""
    path, base = options.base_path, np.array(placement_of(options, machine))
    if path is None or not len(base) or any(len(point) != len(base) for point in path.points):
        return []
    structure = driven_structure(machine, options)
    motion, points = motion_of(structure, {}), np.array(path.points)
    # Where the anchor frame is turned, a rounding error is left over of what cancels.
    rounding = 1e-12 * (1.0 + float(np.abs(points).max()))
    driven = np.any(np.abs(moved(motion, points, base)) > rounding, axis=0)
    turns = TURN in motion.drive
    rigid = [
        name
        for name, goes in zip(motion.drive, driven, strict=True)
        if name in ("x", "y") and name not in motion.absorbed and (goes or turns)
    ]
    found: list[Fault] = []
    if turns:
        rigid += ["yaw"] if structure.turned_hinge is None else []
        carriers = [*structure.leading_slides, *(structure.turned_hinge or ())[:1]]
        joints = [machine.kinematic_tree.bodies[int(i)].joint for i in carriers]
        geared = [joint for joint in joints if joint.armature]
        if geared:
            named = ", ".join(joint.name for joint in geared)
            found.append(Fault("base_path.points", f"cannot turn a base whose joints {named} have an armature"))
    if rigid:
        sentence = f"needs a base that gives in {listed(rigid)}; a rigid one would jerk the machine along"
        order = ": slides along x and y with springs, then a vertical hinge with one" if turns else ""
        found.append(Fault("base_path", sentence + order))
    return found
