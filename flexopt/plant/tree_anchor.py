"""A tree's anchor frame that turns about the vertical while slides and a hinge carry the machine.

In: coordinates u that count in the axes in which the anchor frame stood at first. Out: the same in the axes in which
it stands now. A machine on springs in x, y and yaw is carried along by them alone: its inertia knows nothing of the
anchor, whose rates may jump.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from flexopt.plant.tree_algebra import ZERO, Scalar, Triple, about_z, add, reversed_turn

SignedEntry = tuple[int, float]  # of u, and its sign


@dataclass(frozen=True)
class TurningAnchor:
    """An anchor frame turned by ψ = `turn` since it stood at first.

    With o where the vertical hinge stands in the anchor frame while no slide is displaced, s the slides' displacement
    and p where the anchor has come to, the hinge is at p + R(ψ) (o + s); slides of u count that place from o. The hinge
    of u turns by ψ more than against the anchor.

    Attributes:
        x, y, hinge: the slides and the hinge.
        undisplaced: o, m.
        turn: ψ, rad.
    """

    x: SignedEntry
    y: SignedEntry
    hinge: SignedEntry
    undisplaced: Triple
    turn: Scalar

    def relative(self, moved: ca.SX) -> ca.SX:
        """Coordinates as the anchor sees them, from those of u less p: R(ψ)ᵀ (o + u − p) − o."""
        back = reversed_turn((ca.cos(self.turn), ca.sin(self.turn)))
        seen = about_z(back, add(self._level(moved), self.undisplaced))
        column = ca.SX(moved)
        for (entry, sign), part, origin in zip((self.x, self.y), seen, self.undisplaced, strict=False):
            column[entry] = sign * (part - origin)
        entry, sign = self.hinge
        column[entry] -= sign * self.turn
        return column

    def _level(self, column: ca.SX) -> Triple:
        (x, along_x), (y, along_y) = self.x, self.y
        return along_x * column[x], along_y * column[y], ZERO
