"""A robot file (URDF or MJCF) and its machine file in, a validated `Tree` out.

The machine file is TOML. An arm on an elastic undercarriage:

    schema = 1
    name = "arm on tracks"
    robot = "arm.urdf"                # or an MJCF file (.xml); from this file's folder
    actuated = ["slew", "boom", "stick"]
    locked = { gripper = 0.02 }       # rad or m: these joints do not move
    placement = ["x", "y", "yaw"]     # what the operator chooses, of the anchor frame; this is the default

    [base]                            # what the root link stands on; without it the root link is fixed to the ground
    stiffness = { z = 4e6, roll = 2e6, pitch = 3e6 }     # N/m, N m/rad; a direction left out is rigid
    damping = { z = 2e4, roll = 9e3 }                    # N s/m, N m s/rad; 0 where left out
    point = [0.0, 0.0, -0.4]          # where the springs act, in the root link's frame, m
    # position = [0, 0, 0.4]          # root link at rest in the anchor frame, m; from the robot file where left out
    # rotation = [0, 0, 0]            # and its roll, pitch, yaw, rad

    [joints.boom]                     # in place of what the robot file says: stiffness, damping, rest, limits,
    limits = [-0.5, 1.2]              # effort (N m or N), speed (rad/s or m/s), armature (rotor inertia, kg m² or kg)

    [joints.mast]                     # a spring makes a joint passive
    stiffness = 5e5
    damping = 300.0

    [end_point]
    link = "tool0"                    # a link (body); or  site = "tip",  a site of an MJCF file
    offset = [0.0, 0.0, 0.12]         # in its axes, m;  rotation = [0, 0, 0] its roll, pitch, yaw, rad
    rows = ["x", "y", "z"]            # and "roll", "pitch", "yaw", in m by `length`; see `EndPoint`

    [payload]
    mass = 250.0                      # kg, at the end-point

    [support]                         # what the undercarriage stands on: a convex polygon in the anchor frame, m
    polygon = [[-1.8, -1.3], [1.9, -1.3], [1.9, 1.3], [-1.8, 1.3]]

    [loop]                            # the controller that the machine has; its keys are told in `flexopt.model.loop`
    rate = 100.0

    [[uncertainty]]                   # what nobody has measured; its keys are told in `flexopt.model.uncertainty`
    of = "stiffness"
    factor = [0.5, 2.0]

    [[capsules]]                      # what a link fills: ends in the link's frame, m; any number of them
    link = "tool0"
    start = [0.0, 0.0, 0.0]
    end = [0.0, 0.0, 0.12]
    radius = 0.05

    [[cylinders]]                     # what drives a joint; its keys are told in `flexopt.model.hydraulics`
    name = "boom cylinder"            # base_point, pivot: in the frame of the link that carries the joint;
    joint = "boom"                    # rod_point, coupler_point: in that of the link that the joint moves
    base_point = [0.3, 0.0, -0.2]
    rod_point = [0.9, 0.0, 0.2]
    length = [0.7, 1.4]
    speed = [0.2, 0.15]

Further keys: `root` (the link to start from: what carries it, and other machines in the file, are left out),
`lock_others = true` (every joint that is neither actuated nor has a spring is locked where the file has it: at 0, or
`ref`), `gravity` (m/s², along −z; the MJCF file's or 9.81 where left out), and `ignore`, which reads a robot without
things that change its dynamics: `["armature", "equality", "tendon", "gravcomp"]` of MJCF, and `"unknown"`, what the
format does not know (without this word a fault, for it may be misspelt). `base.stiffness` and `base.damping` also take
six numbers (x, y, z, roll, pitch, yaw) or a symmetric 6 × 6 matrix, about `point`, in the axes of the anchor frame. The
parameters LINK.com.x, .y and .z are of the link with all that is fixed to it, from where its joint is; of the root link
from `point`, in the axes of the anchor frame. A free joint of the root link gives way to [base]; a mimic joint follows
a locked joint, and is refused where that moves. Effort and speed come from URDF's <limit effort=… velocity=…> (0 is
none), or from MJCF's `actuatorfrcrange` and the range of a joint's only actuator. `capsules = "collision"` in place of
the tables takes the capsules from the robot file: each encloses one shape of its collision geometry. Shapes that are
not read, meshes above all, are warned of. What pictures draw, shapes and files of meshes, comes from the robot file
without a key of its own: <visual> of URDF, and of MJCF the geoms of the groups 0 to 2.
"""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any, cast

from flexopt.errors import Fault, FlexoptWarning, ModelError, raise_if_any
from flexopt.foundation.boundary import path as named
from flexopt.foundation.boundary import public
from flexopt.model.file_model import FileTable, read_table, validated
from flexopt.model.files import read_toml
from flexopt.model.robots.assembly import Assembly
from flexopt.model.robots.description import Description
from flexopt.model.robots.elements import Faults, parse
from flexopt.model.robots.known import UNKNOWN
from flexopt.model.robots.mjcf import read_mjcf
from flexopt.model.robots.overlay import Overlay
from flexopt.model.robots.urdf import read_urdf
from flexopt.model.tree import Tree, tree_from_dict

# Moving and locked; `BODIES_MAX` bounds those that move.
JOINTS_MAX = 1000
# In place of [[capsules]]: those round the robot file's collision geometry.
COLLISION = "collision"


@public(error=ModelError, path=named())
def load_robot(path: str | os.PathLike[str]) -> Tree:
    """Read a spatial machine file and the robot file it names.

    Args:
        path: a TOML file in the layout above.

    Raises:
        ModelError: a file is missing or has faults; the message lists every one with file, line and element, or key.

    Warns:
        FlexoptWarning: what is readable but odd: an inertia that no rigid body has, dry friction, a medium.

    Example:
        >>> from flexopt.model.files import shipped_folder
        >>> flexopt.load_robot(shipped_folder("models") / "truck-crane.toml").joints
        ('slew', 'lift', 'knuckle', 'extend')
    """
    path = Path(path)
    return _read(read_toml(path), path.parent, str(path))


def robot_from_dict(data: FileTable, *, folder: str | os.PathLike[str], origin: str = "machine") -> Tree:
    """As `load_robot`, for a dictionary in the layout of a spatial machine file.

    Args:
        data: its tables and keys.
        folder: where the path of the robot file starts.
        origin: what the message calls the source.

    Raises:
        ModelError: lists every fault.
    """
    return _read(data, Path(folder), origin)


def _read(data: FileTable, folder: Path, origin: str) -> Tree:
    frozen = read_table(data, origin, "a spatial machine file")
    faults: list[Fault] = []
    overlay: Overlay | None = None
    robot: Description | None = None
    from_collisions = frozen.get("capsules") == COLLISION
    if from_collisions:
        del frozen["capsules"]
    try:
        overlay = validated(Overlay, frozen, origin)
        faults += overlay.faults()
    except ModelError as error:
        faults += error.faults
    name = frozen.get("robot")
    if isinstance(name, str) and name:
        try:
            ignored = cast(tuple[Any, ...], words) if isinstance(words := frozen.get("ignore"), tuple) else ()
            robot, found = read_description(folder / name, Path(name).name, strict=UNKNOWN not in ignored)
            faults += found
            faults += _many(robot)
        except ModelError as error:
            faults += error.faults or [Fault("robot", str(error), repr(name))]
    raise_if_any(ModelError, origin, faults)
    assert overlay is not None and robot is not None  # noqa: PT018
    assembly = Assembly(robot, overlay, from_collisions=from_collisions)
    raise_if_any(ModelError, origin, assembly.faults)
    try:
        tree = tree_from_dict(assembly.tree(), origin=origin)
    except ModelError as error:
        located = [assembly.located(fault) for fault in error.faults]
        raise_if_any(ModelError, origin, located)
        raise
    _warn(origin, (*robot.warnings, *assembly.warnings))
    return tree


def _many(robot: Description) -> list[Fault]:
    count = sum(len(link.joints) for link in robot.links)
    return [] if count <= JOINTS_MAX else [Fault("robot", f"has {count} joints; at most {JOINTS_MAX} are read")]


def read_description(path: Path, name: str, *, strict: bool = True) -> tuple[Description, list[Fault]]:
    """A URDF or MJCF file, whichever its root element says, and its faults.

    Args:
        path: the file.
        name: what messages call it.
        strict: whether elements and attributes that the format does not know are faults, or only warned of.

    Raises:
        ModelError: nothing of the file can be read.
    """
    root = parse(path, name)
    faults = Faults()
    if root.tag == "robot":
        return read_urdf(root, path.parent, faults, strict=strict), faults.faults
    if root.tag == "mujoco":
        return read_mjcf(root, path.parent, faults, strict=strict), faults.faults
    hint = "; convert SDF to URDF first" if root.tag == "sdf" else ""
    raise ModelError(f"{root.place}: its root element is <{root.tag}>, not <robot> (URDF) or <mujoco> (MJCF){hint}")


def _warn(origin: str, remarks: tuple[str, ...]) -> None:
    if not remarks:
        return
    first, more = remarks[0], len(remarks) - 1
    told = f"{origin}: {first}" + (f"; and {more} more (`flexopt check` tells all)" if more else "")
    warnings.warn(FlexoptWarning(told, remarks), stacklevel=4)
