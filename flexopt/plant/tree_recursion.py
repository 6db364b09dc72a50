"""Recursions over a tree of bodies: kinematics, mass matrix, forces of inertia and weight.

In: a `Skeleton`, its constants by name, q and rates as graphs, and (cos q, sin q) of every hinge from outside. Out:
graphs by body. The mass matrix comes from composite bodies, forces from Newton and Euler's equations (Featherstone,
Rigid Body Dynamics Algorithms, chapters 5 and 6), written for the moments of `tree_constants`: with U = [α]× + [ω]×²
a body's inertia gives the force U c + m a and the moment Σ r × U r dm + c × a. Vectors are in the axes of the first
body of a row of parallel hinges, which may be a row of one: inside a row nothing is turned but each body's constants.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from flexopt.plant.tree_algebra import (
    ORIGIN,
    SECOND,
    ZERO,
    Moments,
    Pair,
    Scalar,
    Spin,
    Triple,
    Wrench,
    about_z,
    add,
    cross,
    dot,
    reversed_turn,
    scaled,
    second_about_z,
    second_turned,
    times,
    turned,
    turned_back,
)
from flexopt.plant.tree_structure import Skeleton


@dataclass(frozen=True, eq=False)
class Recursion:
    """A tree in one configuration.

    Attributes:
        skeleton: its structure.
        value: the constants by name; those in `skeleton.zeros` are ignored.
        along: of each body, (cos q, sin q) of its hinge; of slides anything.
        displacement: of each body, q of its slide; of hinges anything.
        angles: of each body, q of its hinge, where sums of these may be taken; else directions are multiplied.
    """

    skeleton: Skeleton
    value: Mapping[str, ca.SX]
    along: Sequence[Pair]
    displacement: Sequence[Scalar]
    angles: Sequence[Scalar] = ()

    @property
    def n(self) -> int:
        """Number of bodies and of joints."""
        return len(self.skeleton.segments)

    def of(self, name: str) -> Scalar:
        """A constant, 0 where the structure says so."""
        return ZERO if name in self.skeleton.zeros or name not in self.value else self.value[name]

    def vector(self, name: str) -> Triple:
        """A constant with three components."""
        return self.of(f"{name}.x"), self.of(f"{name}.y"), self.of(f"{name}.z")

    @cached_property
    def headings(self) -> list[Pair | None]:
        """Of each body, (cos, sin) of its turn about z since the first body of its row; None where there is none."""
        result: list[Pair | None] = []
        for i, segment in enumerate(self.skeleton.segments):
            before = result[segment.parent] if segment.parent >= 0 else None
            if segment.slide:
                result.append(before)
            elif not segment.in_row:
                result.append(None)
            elif self.angles:
                angle = self._turn(i)
                result.append((ca.cos(angle), ca.sin(angle)))
            else:
                c, s = self.along[i]
                turn = (c, s) if before is None else (c * before[0] - s * before[1], s * before[0] + c * before[1])
                result.append(turn)
        return result

    def _turn(self, i: int) -> Scalar:
        """Angle of a body about z since the first body of its row."""
        angle = ZERO
        while i >= 0 and (self.skeleton.segments[i].slide or self.skeleton.segments[i].in_row):
            angle, i = (
                angle + (ZERO if self.skeleton.segments[i].slide else self.angles[i]),
                self.skeleton.segments[i].parent,
            )
        return angle

    def _heading(self, i: int) -> Pair | None:
        return self.headings[i] if i >= 0 else None

    def of_body(self, i: int, a: Triple) -> Triple:
        """From the body's own axes to those of its row; −1 is the ground."""
        return about_z(self._heading(i), a)

    def direction(self, i: int) -> Triple:
        """Of a joint's axis, in its body's own axes."""
        x, y, z = self.skeleton.segments[i].axis
        return ca.SX(x), ca.SX(y), ca.SX(z)

    def axis(self, i: int) -> Triple:
        """Of a slide."""
        return self.of_body(self.skeleton.segments[i].parent, self.direction(i))

    def offset(self, i: int) -> Triple:
        """Of the body's origin from its parent's, in the parent's row."""
        at = self.of_body(self.skeleton.segments[i].parent, self.vector(f"offset{i}"))
        return add(at, scaled(self.displacement[i], self.axis(i))) if self.skeleton.segments[i].slide else at

    def first(self, i: int) -> Triple:
        """First moment of the body alone."""
        return self.of_body(i, self.vector(f"c{i}"))

    def second(self, i: int) -> Mapping[str, Scalar]:
        """Second moment of the body alone."""
        own = {ab: self.of(f"s{i}.{ab}") for ab in SECOND}
        return own if self.skeleton.segments[i].parallel else second_about_z(self._heading(i), own)

    def inwards(self, i: int, a: Triple) -> Triple:
        """From the axes of the body's row to those of its parent's."""
        segment = self.skeleton.segments[i]
        if segment.slide or segment.in_row:
            return a
        return self.of_body(segment.parent, turned(segment.turn, about_z(self.along[i], a)))

    def outwards(self, i: int, a: Triple) -> Triple:
        """The reverse of `inwards`."""
        segment = self.skeleton.segments[i]
        if segment.slide or segment.in_row:
            return a
        back = turned_back(segment.turn, about_z(reversed_turn(self._heading(segment.parent)), a))
        return about_z(reversed_turn(self.along[i]), back)

    def wrench_inwards(self, i: int, wrench: Wrench) -> Wrench:
        """A wrench on the body as one on its parent."""
        force = self.inwards(i, wrench[0])
        return force, add(self.inwards(i, wrench[1]), cross(self.offset(i), force))

    def on_joint(self, i: int, wrench: Wrench) -> Scalar:
        """What of a wrench acts along the joint's motion."""
        return dot(self.axis(i), wrench[0]) if self.skeleton.segments[i].slide else wrench[1][2]

    def to_ground(self, i: int, a: Triple) -> Triple:
        """From a body's own axes to the ground's."""
        return self.step(i, i, a)

    def point(self, i: int, at: Triple) -> Triple:
        """Where a point of a body lies in the ground's frame."""
        return self.step(-1, i, at)

    def step(self, start: int, i: int, at: Triple) -> Triple:
        """From the origin of a body to a point of one that it carries, in the ground's axes."""
        at = self.of_body(i, at)
        while i != start:
            at, i = add(self.offset(i), self.inwards(i, at)), self.skeleton.segments[i].parent
        while i >= 0:
            at, i = self.inwards(i, at), self.skeleton.segments[i].parent
        return at

    @cached_property
    def composites(self) -> list[Moments]:
        """Each body with all beyond it, about its origin, in the axes of its row."""
        result = [Moments(self.of(f"m{i}"), self.first(i), self.second(i)) for i in range(self.n)]
        for i in reversed(range(self.n)):
            parent, of = self.skeleton.segments[i].parent, result[i]
            if parent >= 0:
                turned_in = Moments(of.mass, self.inwards(i, of.first), self._second_inwards(i, of.second))
                result[parent] += turned_in.moved(self.offset(i))
        return result

    def _second_inwards(self, i: int, second: Mapping[str, Scalar]) -> Mapping[str, Scalar]:
        segment = self.skeleton.segments[i]
        if segment.slide or segment.in_row:
            return second
        back = second_turned(segment.turn, second_about_z(self.along[i], second))
        return second_about_z(self._heading(segment.parent), back)

    @cached_property
    def mass(self) -> dict[tuple[int, int], Scalar]:
        """Entries (i, j) of the mass matrix, j = i or an ancestor of i; all others are zero."""
        result: dict[tuple[int, int], Scalar] = {}
        for i, segment in enumerate(self.skeleton.segments):
            of = self.composites[i]
            if segment.slide:
                force = scaled(of.mass, self.axis(i))
                wrench = (force, cross(of.first, self.axis(i)))
            else:
                (x, y, _), s = of.first, of.second
                wrench = ((-y, x, ZERO), (-s["xz"], -s["yz"], s["xx"] + s["yy"]))
            result[i, i] = self.on_joint(i, wrench) + self.of(f"armature{i}")
            j = i
            while self.skeleton.segments[j].parent >= 0:
                wrench, j = self.wrench_inwards(j, wrench), self.skeleton.segments[j].parent
                result[i, j] = self.on_joint(j, wrench)
        return result

    def spins(self, rates: Sequence[Scalar]) -> list[Spin]:
        """How the bodies turn while their joints do not accelerate."""
        result: list[Spin] = []
        for i, segment in enumerate(self.skeleton.segments):
            before = result[segment.parent] if segment.parent >= 0 else Spin(ORIGIN, ORIGIN)
            if segment.slide:
                result.append(before)
                continue
            x, y, z = self.outwards(i, before.omega)
            ax, ay, az = self.outwards(i, before.alpha)
            w = rates[i]
            result.append(Spin((x, y, z + w), (ax + y * w, ay - x * w, az)))
        return result

    def forces(self, rates: Sequence[Scalar], gravity: Scalar) -> list[Scalar]:
        """What the joints must give so that none accelerates, h + g, by body."""
        spins, up = self.spins(rates), self.skeleton.up
        fall = (gravity if up == 0 else ZERO, gravity if up == 1 else ZERO, gravity if up == 2 else ZERO)
        accelerations: list[Triple] = []
        wrenches: list[Wrench] = []
        for i, segment in enumerate(self.skeleton.segments):
            parent, spin = segment.parent, spins[i]
            before = accelerations[parent] if parent >= 0 else fall
            if parent >= 0:
                at = self.offset(i)
                before = add(before, times(spins[parent].u, at))
                if segment.slide:
                    along = scaled(2 * rates[i], self.axis(i))
                    before = add(before, cross(spins[parent].omega, along))
            here = self.outwards(i, before)
            accelerations.append(here)
            first, mass = self.first(i), self.of(f"m{i}")
            force = add(times(spin.u, first), scaled(mass, here))
            wrenches.append((force, add(spin.moment(self.second(i)), cross(first, here))))
        result: list[Scalar] = [ZERO] * self.n
        for i in reversed(range(self.n)):
            result[i] = self.on_joint(i, wrenches[i])
            parent = self.skeleton.segments[i].parent
            if parent >= 0:
                force, moment = self.wrench_inwards(i, wrenches[i])
                wrenches[parent] = (add(wrenches[parent][0], force), add(wrenches[parent][1], moment))
        return result
