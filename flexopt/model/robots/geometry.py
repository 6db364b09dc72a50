"""Rotations in the ways robot files write them, poses, and rigid-body inertias with their composition.

A rotation matrix R takes components in the body's axes to components in the parent's axes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from flexopt.foundation.arrays import Array

# A moment of inertia below this is none, kg m²; negative ones this small, or this share of the largest, are rounding.
NO_MOMENT = 1e-15
MOMENT_ROUNDING = 1e-9


def about(axis: Array, angle: float) -> Array:
    """Rotation by `angle` (rad) about the unit vector `axis` (3,): I + sin a S + (1 − cos a) S²."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross


def from_rpy(angles: Array) -> Array:
    """Rz(yaw) Ry(pitch) Rx(roll), rad."""
    return from_euler(angles, "XYZ")


def from_euler(angles: Array, sequence: str) -> Array:
    """Three turns (rad) in sequence: lower-case letters about axes that turn along, upper-case about fixed ones."""
    rotation = np.eye(3)
    for letter, angle in zip(sequence, angles, strict=True):
        turn = about(np.eye(3)["xyz".index(letter.lower())], float(angle))
        rotation = rotation @ turn if letter.islower() else turn @ rotation
    return rotation


def from_quaternion(quaternion: Array) -> Array:
    """From (w, x, y, z) of any length but 0."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def from_z_axis(direction: Array) -> Array:
    """The smallest rotation that takes the z axis to `direction`; half a turn about x where that is −z."""
    unit = direction / np.linalg.norm(direction)
    axis = np.cross([0.0, 0.0, 1.0], unit)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-10:
        return np.eye(3) if unit[2] > 0 else np.diag([1.0, -1.0, -1.0])
    return about(axis / sine, math.atan2(sine, float(unit[2])))


def from_xy_axes(x: Array, y: Array) -> Array:
    """Axes with x along the first vector, y in the plane of both; not a number where they are parallel."""
    first = x / np.linalg.norm(x)
    rest = y - first * float(first @ y)
    length = float(np.linalg.norm(rest))
    second = rest / (length if length > 1e-9 * float(np.linalg.norm(y)) else np.nan)
    return np.column_stack([first, second, np.cross(first, second)])


def _zeros() -> Array:
    return np.zeros(3)


def _unturned() -> Array:
    return np.eye(3)


@dataclass(frozen=True, eq=False)
class Pose:
    """A frame in another: origin `position` (3,), m, and axes `rotation` (3, 3)."""

    position: Array = field(default_factory=_zeros)
    rotation: Array = field(default_factory=_unturned)

    def __matmul__(self, inner: Pose) -> Pose:
        """The frame `inner`, given in this one, in this one's parent."""
        return Pose(self.position + self.rotation @ inner.position, self.rotation @ inner.rotation)


def shift(vector: Sequence[float] | Array) -> Pose:
    """A frame that is moved and not turned."""
    return Pose(np.array(vector, dtype=float))


def square_zeros() -> Array:
    """No inertia."""
    return np.zeros((3, 3))


@dataclass(frozen=True, eq=False)
class Inertial:
    """Mass (kg), centre of mass (3,), m, and inertia tensor about it (3, 3), kg m², in some frame's axes."""

    mass: float = 0.0
    com: Array = field(default_factory=_zeros)
    tensor: Array = field(default_factory=square_zeros)

    def seen_from(self, pose: Pose) -> Inertial:
        """The same, in the frame in which `pose` gives this one's."""
        turned = pose.rotation @ self.tensor @ pose.rotation.T
        return Inertial(self.mass, pose.position + pose.rotation @ self.com, (turned + turned.T) / 2)

    def __add__(self, other: Inertial) -> Inertial:
        """Both as one rigid body: I = I₁ + I₂ + m₁m₂/(m₁+m₂) (|d|² 1 − d dᵀ), d between the centres of mass."""
        mass = self.mass + other.mass
        if mass == 0:
            return Inertial(0.0, self.com, self.tensor + other.tensor)
        com = (self.mass * self.com + other.mass * other.com) / mass
        d = self.com - other.com
        apart = self.mass * other.mass / mass * (float(d @ d) * np.eye(3) - np.outer(d, d))
        return Inertial(mass, com, self.tensor + other.tensor + apart)

    def scaled(self, factor: float) -> Inertial:
        """Of the same shape with another density."""
        return Inertial(self.mass * factor, self.com, self.tensor * factor)

    def without_rounding(self) -> Inertial:
        """The same with principal moments that are negative by rounding set to 0."""
        moments, axes = np.linalg.eigh(self.tensor)
        if moments[0] >= 0 or moments[0] < -MOMENT_ROUNDING * abs(moments[2]) - NO_MOMENT:
            return self
        return Inertial(self.mass, self.com, axes @ np.diag(np.maximum(moments, 0.0)) @ axes.T)

    @property
    def principal_moments(self) -> Array:
        """Eigenvalues of the tensor (3,), ascending, kg m²."""
        return np.linalg.eigvalsh(self.tensor).astype(np.float64)
