"""Matrices of the machines of a box, and where they are driven and measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexopt.foundation.arrays import ComplexArray, Vector


@dataclass(frozen=True, eq=False)
class Machines:
    """M, D, K (…, n, n) of members of a box, in any coordinates."""

    mass: Vector
    damping: Vector
    stiffness: Vector

    def pencil(self, s: ComplexArray) -> ComplexArray:
        """Z (len(s), …, n, n)."""
        at = s.reshape(-1, *(1,) * self.mass.ndim)
        found: ComplexArray = at * at * self.mass + at * self.damping + self.stiffness
        return found

    @property
    def largest(self) -> Machines:
        """A bound on the entries of M, D and K of all members between these, (n, n) each."""
        n = self.mass.shape[-1]
        return Machines(*(np.abs(x).reshape(-1, n, n).max(axis=0) for x in (self.mass, self.damping, self.stiffness)))

    def less(self, other: Machines) -> Machines:
        """The difference."""
        return Machines(self.mass - other.mass, self.damping - other.damping, self.stiffness - other.stiffness)

    @property
    def norms(self) -> tuple[float, float, float]:
        """The largest of ‖M‖, ‖D‖ and ‖K‖: those of all members between these are no larger."""
        m, d, k = (float(np.linalg.norm(x, 2, axis=(-2, -1)).max()) for x in (self.mass, self.damping, self.stiffness))
        return m, d, k

    def seen(self, by: Vector) -> Machines:
        """In other coordinates, q = `by` η; fewer of them where the others are locked."""
        return Machines(*(by.T @ x @ by for x in (self.mass, self.damping, self.stiffness)))


@dataclass(frozen=True, eq=False)
class Ports:
    """How a machine is driven and measured, in the coordinates of `Machines`: B E, B_τ, C of positions and of rates."""

    force: Vector
    servo: Vector
    position: Vector
    rate: Vector
