"""The quantities of a spatial machine as validated types: vectors, rotations, inertias, matrices over joints."""

from __future__ import annotations

import math
from typing import Annotated, Any, cast

import numpy as np

from flexopt.foundation.arrays import Array
from flexopt.foundation.quantities import (
    ANGLE,
    INERTIA_ENTRY,
    JOINT_STIFFNESS,
    JOINT_VALUE,
    LENGTH_MAX,
    OFFSET,
    Quantity,
    a_list,
    accepting,
    each_named,
    entries,
    pair,
    vector,
)

Vector3 = tuple[float, float, float]
Matrix3 = tuple[Vector3, Vector3, Vector3]
UNTURNED: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
# Entries of axes and rotations this near to 0 or ±1 are meant to be it; cos(π/2) is 6e-17.
SNAP = 1e-14
# How far a rotation matrix may be from orthogonal: it is then made orthogonal.
ORTHOGONAL = 1e-6
# Smallest eigenvalue of an inertia as a share of the largest: a rod without thickness, rounded, is legal.
INERTIA_ROUNDING = 1e-9
SYMMETRY = 1e-9


def _snapped(value: float) -> float:
    nearest = float(round(value))
    return nearest + 0.0 if abs(value - nearest) < SNAP else value


_DIRECTION = vector("three numbers [x, y, z]", Quantity("", low=-LENGTH_MAX, high=LENGTH_MAX), "xyz")
_ROTATION = "three rows of a rotation matrix, or three numbers [roll, pitch, yaw] in rad"
_ANGLES = vector(_ROTATION, ANGLE, ("roll", "pitch", "yaw"))
_ROW = vector(_ROTATION, Quantity("", low=-2.0, high=2.0), "xyz")
_INERTIA = vector("six numbers [xx, yy, zz, xy, xz, yz] in kg m²", INERTIA_ENTRY, ("xx", "yy", "zz", "xy", "xz", "yz"))
_ENTRY = Quantity("SI units", low=-JOINT_STIFFNESS.high, high=JOINT_STIFFNESS.high)


@accepting(_DIRECTION.accepts or {})
def check_axis(value: Any) -> Vector3:
    """A direction, scaled to length 1."""
    x, y, z = (_snapped(part) for part in scaled_direction(_DIRECTION(value)))
    return x, y, z


def scaled_direction(parts: tuple[float, ...]) -> tuple[float, ...]:
    """A direction, scaled to length 1; one that was scaled once stays as it is.

    Raises:
        ValueError: it points nowhere.
    """
    length = math.hypot(*parts)
    if length < 1e-9:
        raise ValueError("must point somewhere: its length is 0")
    return parts if abs(length - 1) <= SNAP else tuple(part / length for part in parts)


@accepting({"anyOf": [_ANGLES.accepts, a_list(_ROW.accepts or {}, 3, 3)]})
def check_rotation(value: Any) -> Matrix3:
    """A rotation matrix by rows, or (roll, pitch, yaw) in rad."""
    rows = entries(value)
    if len(rows) != 3 or not any(isinstance(row, list | tuple) for row in rows):
        matrix = _from_angles(*_ANGLES(value))
    else:
        matrix = np.array([_ROW(row) for row in rows])
        if np.abs(matrix @ matrix.T - np.eye(3)).max() > ORTHOGONAL or np.linalg.det(matrix) < 0:
            raise ValueError("is no rotation: its rows must be at right angles, of length 1 and right-handed")
        left, _, right = np.linalg.svd(matrix)
        exact = left @ right
        matrix = matrix if np.abs(exact - matrix).max() < SNAP else exact
    return snapped_rows(matrix)


@accepting(a_list(_DIRECTION.accepts or {}, 3, 3))
def check_matrix(value: Any) -> Matrix3:
    """A matrix (3, 3) by rows."""
    rows = entries(value)
    if len(rows) != 3:
        raise ValueError("must be three rows of three numbers")
    first, second, third = (_DIRECTION(row) for row in rows)
    return cast(Matrix3, (first, second, third))


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


def symmetric(xx: float, yy: float, zz: float, xy: float = 0.0, xz: float = 0.0, yz: float = 0.0) -> Array:
    """The matrix (3, 3) of six entries."""
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@accepting(_INERTIA.accepts or {})
def check_inertia(value: Any) -> tuple[float, float, float, float, float, float]:
    """Six entries of an inertia tensor that is not negative."""
    xx, yy, zz, xy, xz, yz = _INERTIA(value)
    eigenvalues = np.linalg.eigvalsh(symmetric(xx, yy, zz, xy, xz, yz))
    if eigenvalues[0] < -INERTIA_ROUNDING * max(eigenvalues[-1], 0.0):
        raise ValueError(f"is no inertia: it has a negative principal moment, {eigenvalues[0]:.3g} kg m²")
    return xx, yy, zz, xy, xz, yz


@accepting(a_list(a_list(_ENTRY.accepts or {}, 1), 1))
def check_square(value: Any) -> tuple[tuple[float, ...], ...]:
    """A symmetric matrix by rows."""
    rows = [entries(row) for row in entries(value)]
    if not rows or any(len(row) != len(rows) for row in rows):
        raise ValueError("must be rows of a square matrix")
    names = [[f"[{i}][{j}]" for j in range(len(rows))] for i in range(len(rows))]
    matrix = np.array([each_named(_ENTRY, row, words) for row, words in zip(rows, names, strict=True)])
    scale = np.sqrt(np.abs(np.outer(np.diag(matrix), np.diag(matrix))))
    off = np.abs(matrix - matrix.T) - SYMMETRY * scale
    if (off > 0).any():
        i, j = sorted(map(int, np.unravel_index(np.argmax(off), off.shape)))
        raise ValueError(f"must be symmetric: [{i}][{j}] is {matrix[i, j]:g}, [{j}][{i}] is {matrix[j, i]:g}")
    return tuple(tuple(float(x) + 0.0 for x in row) for row in (matrix + matrix.T) / 2)


Point3 = Annotated[Vector3, vector("three numbers [x, y, z] in m", OFFSET, "xyz")]
JointAxis = Annotated[Vector3, check_axis]
Rotation = Annotated[Matrix3, check_rotation]
InertiaSix = Annotated[tuple[float, float, float, float, float, float], check_inertia]
Square = Annotated[tuple[tuple[float, ...], ...], check_square]
JointInterval = Annotated[tuple[float, float], pair(JOINT_VALUE)]
