"""The quantities of a spatial machine as validated types: vectors, rotations, inertias, matrices over joints."""

from __future__ import annotations

import math
from typing import Annotated, Any, cast

import numpy as np

from flexopt.foundation.quantities import ANGLE_MAX, COORDINATE_MAX, LENGTH_MAX, check_number, check_numbers, checked

Vector3 = tuple[float, float, float]
Matrix3 = tuple[Vector3, Vector3, Vector3]
# Entries of axes and rotations this near to 0 or ±1 are meant to be it; cos(π/2) is 6e-17.
SNAP = 1e-14
# How far a rotation matrix may be from orthogonal: it is then made orthogonal.
ORTHOGONAL = 1e-6
# Smallest eigenvalue of an inertia as a share of the largest: a rod without thickness, rounded, is legal.
INERTIA_ROUNDING = 1e-9
SYMMETRY = 1e-9
STIFFNESS_MAX, DAMPING_MAX, INERTIA_MAX = 1e15, 1e12, 1e15


def _list(value: Any, count: int, what: str) -> list[Any]:
    if not isinstance(value, list | tuple) or len(cast(list[Any], value)) != count:
        raise ValueError(f"must be {what}")
    return list(cast(list[Any], value))


def _snapped(value: float) -> float:
    nearest = float(round(value))
    return nearest + 0.0 if abs(value - nearest) < SNAP else value


def check_point(value: Any) -> Vector3:
    """Three coordinates, m."""
    x, y, z = check_numbers(
        _list(value, 3, "three numbers [x, y, z] in m"), ["x", "y", "z"], "m", low=-LENGTH_MAX, high=LENGTH_MAX
    )
    return x, y, z


def check_axis(value: Any) -> Vector3:
    """A direction, scaled to length 1."""
    parts = check_numbers(
        _list(value, 3, "three numbers [x, y, z]"), ["x", "y", "z"], "", low=-LENGTH_MAX, high=LENGTH_MAX
    )
    length = math.hypot(*parts)
    if length < 1e-9:
        raise ValueError("must point somewhere: its length is 0")
    if abs(length - 1) > SNAP:  # so that a direction that was scaled once stays as it is
        parts = tuple(part / length for part in parts)
    x, y, z = (_snapped(part) for part in parts)
    return x, y, z


def check_rotation(value: Any) -> Matrix3:
    """A rotation matrix by rows, or (roll, pitch, yaw) in rad."""
    what = "three rows of a rotation matrix, or three numbers [roll, pitch, yaw] in rad"
    rows = _list(value, 3, what)
    if not any(isinstance(row, list | tuple) for row in rows):
        names = ["roll", "pitch", "yaw"]
        matrix = _from_angles(*check_numbers(rows, names, "rad", low=-ANGLE_MAX, high=ANGLE_MAX))
    else:
        entries = [check_numbers(_list(row, 3, what), ["x", "y", "z"], "", low=-2.0, high=2.0) for row in rows]
        matrix = np.array(entries)
        if np.abs(matrix @ matrix.T - np.eye(3)).max() > ORTHOGONAL or np.linalg.det(matrix) < 0:
            raise ValueError("is no rotation: its rows must be at right angles, of length 1 and right-handed")
        left, _, right = np.linalg.svd(matrix)
        exact = left @ right
        matrix = matrix if np.abs(exact - matrix).max() < SNAP else exact
    return snapped_rows(matrix)


def snapped_rows(matrix: np.ndarray[Any, np.dtype[np.float64]]) -> Matrix3:
    """A matrix by rows, what is meant to be 0 or ±1 exactly that."""
    rounded = [[_snapped(float(entry)) for entry in row] for row in matrix]
    return cast(Matrix3, tuple(tuple(row) for row in rounded))


def axes_about(axis: Vector3) -> Matrix3:
    """Rows of a right-handed frame, the third along `axis`; the first is along x if it can be, else near it."""
    along = np.array(axis)
    first = np.array([0.0, 1.0, 0.0]) if abs(along[0]) > 0.9 else np.array([1.0, 0.0, 0.0])
    first = first - along * (first @ along)
    first /= np.linalg.norm(first)
    return snapped_rows(np.stack([first, np.cross(along, first), along]))


def _from_angles(roll: float, pitch: float, yaw: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a), math.sin(a)) for a in (roll, pitch, yaw))
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def check_inertia(value: Any) -> tuple[float, float, float, float, float, float]:
    """Six entries of an inertia tensor that is not negative."""
    names = ["xx", "yy", "zz", "xy", "xz", "yz"]
    parts = check_numbers(
        _list(value, 6, "six numbers [xx, yy, zz, xy, xz, yz] in kg m²"),
        names,
        "kg m²",
        low=-INERTIA_MAX,
        high=INERTIA_MAX,
    )
    xx, yy, zz, xy, xz, yz = parts
    eigenvalues = np.linalg.eigvalsh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    if eigenvalues[0] < -INERTIA_ROUNDING * max(eigenvalues[-1], 0.0):
        raise ValueError(f"is no inertia: it has a negative principal moment, {eigenvalues[0]:.3g} kg m²")
    return xx, yy, zz, xy, xz, yz


def check_square(value: Any) -> tuple[tuple[float, ...], ...]:
    """A symmetric matrix by rows."""
    count = len(cast(list[Any], value)) if isinstance(value, list | tuple) else 0
    what = "rows of a square matrix"
    rows: list[tuple[float, ...]] = []
    for index, row in enumerate(_list(value, count or 1, what)):
        names = [f"[{index}][{j}]" for j in range(count)]
        rows.append(check_numbers(_list(row, count, what), names, "SI units", low=-STIFFNESS_MAX, high=STIFFNESS_MAX))
    matrix = np.array(rows)
    scale = np.sqrt(np.abs(np.outer(np.diag(matrix), np.diag(matrix))))
    if (np.abs(matrix - matrix.T) > SYMMETRY * scale).any():
        raise ValueError("must be symmetric")
    return tuple(tuple(float(x) + 0.0 for x in row) for row in (matrix + matrix.T) / 2)


def check_limits(value: Any) -> tuple[float, float]:
    """Lower and upper limit; the joint's kind bounds them further."""
    lower, upper = check_numbers(
        _list(value, 2, "a pair [lower, upper]"), ["lower end", "upper end"], "rad or m",
        low=-COORDINATE_MAX, high=COORDINATE_MAX,
    )  # fmt: skip
    if upper <= lower:
        raise ValueError("is reversed or empty: the lower end must be below the upper end")
    return lower, upper


def check_stiffness_value(value: Any) -> float:
    """N m/rad or N/m."""
    return check_number(value, "N m/rad or N/m", above=0.0, high=STIFFNESS_MAX)


def check_damping_value(value: Any) -> float:
    """N m s/rad or N s/m."""
    return check_number(value, "N m s/rad or N s/m", low=0.0, high=DAMPING_MAX)


def check_rest_value(value: Any) -> float:
    """Rad or m; the joint's kind bounds it further."""
    return check_number(value, "rad or m", low=-COORDINATE_MAX, high=COORDINATE_MAX)


Point = Annotated[Vector3, checked(check_point)]
Axis = Annotated[Vector3, checked(check_axis)]
Rotation = Annotated[Matrix3, checked(check_rotation)]
InertiaSix = Annotated[tuple[float, float, float, float, float, float], checked(check_inertia)]
Square = Annotated[tuple[tuple[float, ...], ...], checked(check_square)]
Pair = Annotated[tuple[float, float], checked(check_limits)]
