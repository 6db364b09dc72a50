"""The end-point's task, its frame and the points to draw, as graphs.

In: a `Recursion`. Out: the task rows r, m, in the inertial frame, where the placement has put the anchor frame.
"""

from __future__ import annotations

import casadi as ca

from flexopt.plant.orientation import rotation_vector
from flexopt.plant.tree_algebra import ORIGIN, UNITS, ZERO, Triple, add, turned, turned_back
from flexopt.plant.tree_recursion import Recursion

POSITION = ("x", "y", "z")
ORIENTATION = ("roll", "pitch", "yaw")


def task(at: Recursion, base: ca.SX) -> ca.SX:
    """The rows r (p,), m: positions, and components of the rotation vector from the reference times a length."""
    rows: dict[str, ca.SX] = {}
    wanted = at.skeleton.rows
    if any(row in POSITION for row in wanted):
        rows |= dict(zip(POSITION, placed(at, at.point(at.skeleton.tip, at.vector("tip")), base), strict=True))
    if any(row in ORIENTATION for row in wanted):
        columns = [turned_back(at.skeleton.reference, column) for column in end_axes(at, base)]
        turn = rotation_vector(ca.horzcat(*(ca.vertcat(*column) for column in columns)))
        rows |= {row: at.of("task_length") * turn[k] for k, row in enumerate(ORIENTATION)}
    return ca.vertcat(*(rows[row] for row in wanted))


def end_axes(at: Recursion, base: ca.SX) -> list[Triple]:
    """Axes x, y, z of the end-point's frame in inertial axes."""
    of_body = [turned(at.skeleton.tip_rotation, unit) for unit in UNITS]
    return [in_inertial_axes(at, at.to_ground(at.skeleton.tip, axis), base) for axis in of_body]


def placed(at: Recursion, point: Triple, base: ca.SX) -> Triple:
    """A point of the anchor frame in the inertial one."""
    x, y, z = in_inertial_axes(at, point, base)
    moved = {name: base[k] for k, name in enumerate(at.skeleton.placement) if name not in at.skeleton.absorbed}
    return x + moved.get("x", ZERO), y + moved.get("y", ZERO), z


def points(at: Recursion, base: ca.SX) -> ca.SX:
    """Origins of the anchor frame and of every body's frame, then the end-point: (3, n + 2), m, inertial frame."""
    tip = placed(at, at.point(at.skeleton.tip, at.vector("tip")), base)
    return ca.horzcat(*(ca.vertcat(*point) for point in (*(origin(at, i, base) for i in range(-1, at.n)), tip)))


def origin(at: Recursion, body: int, base: ca.SX) -> Triple:
    """Of a body's frame, of −1 that of the anchor frame, in the inertial one.

    What a slide beyond it takes up of the placement is in the coordinates of what that carries alone.
    """
    way = at.skeleton.way_to(body) if body >= 0 else []
    named = dict(zip(at.skeleton.placement, ca.vertsplit(base), strict=True))
    beyond = {name: named[name] for name, (slide, _) in at.skeleton.absorbed.items() if slide not in way}
    moved = beyond.get("x", ZERO), beyond.get("y", ZERO), ZERO
    return add(placed(at, at.point(body, ORIGIN) if way else ORIGIN, base), moved)


def in_inertial_axes(at: Recursion, a: Triple, base: ca.SX) -> Triple:
    """A direction as the recursions see it in inertial axes."""
    a = turned(at.skeleton.ground, a)
    if "yaw" not in at.skeleton.placement:
        return a
    yaw = base[at.skeleton.placement.index("yaw")]
    c, s = ca.cos(yaw), ca.sin(yaw)
    return c * a[0] - s * a[1], s * a[0] + c * a[1], a[2]
