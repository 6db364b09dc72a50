"""Other ways to the accelerations of a tree, for comparison with `TreeMotion`: same constants, same interface.

In: as `TreeMotion`. Out: `Articulated`, the articulated-body recursion in body axes; `WorldAxes`, composite bodies and
Newton–Euler with every vector in the ground's axes (Featherstone, Rigid Body Dynamics Algorithms, chapters 5 to 7).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca

from flexopt.plant.tree_algebra import AXES, ORIGIN, SECOND, ZERO, Spin, add, cross, dot, scaled
from flexopt.plant.tree_motion import TreeMotion
from flexopt.plant.tree_recursion import Recursion

Rows = list[list[Any]]


def times(rows: Rows, a: Any) -> Any:
    return tuple(dot(tuple(row), a) for row in rows)


def transposed(rows: Rows) -> Rows:
    return [[rows[b][a] for b in range(3)] for a in range(3)]


def product(a: Rows, b: Rows) -> Rows:
    return transposed([list(times(a, tuple(row))) for row in transposed(b)])


def sum_of(a: Rows, b: Rows) -> Rows:
    return [[x + y for x, y in zip(r, s, strict=True)] for r, s in zip(a, b, strict=True)]


def crossing(a: Any) -> Rows:
    x, y, z = a
    return [[ZERO, -z, y], [z, ZERO, -x], [-y, x, ZERO]]


def symmetric(of: Any) -> Rows:
    return [[of["".join(sorted(a + b))] for b in AXES] for a in AXES]


def inertia_of(second: Any) -> Rows:
    s = symmetric(second)
    trace = s[0][0] + s[1][1] + s[2][2]
    return [[(trace if a == b else ZERO) - s[a][b] for b in range(3)] for a in range(3)]


@dataclass(frozen=True)
class Articulated(TreeMotion):
    """force = A a + B α + f, moment = Bᵀ a + D α + n for each body with all beyond it, its joints free."""

    def acceleration(self, u, w, along, torque, base, base_rate, *, gravity):
        """See `TreeMotion`."""
        at, rates = self._at(u, along), self._by_body(w)
        forces, segments = self._joint_forces(u, w, torque, base, base_rate), self.structure.segments
        omegas: list[Any] = []
        linear: list[Any] = []
        angular: list[Any] = []
        handles: list[tuple[Rows, Rows, Rows, Any, Any]] = []
        for i, segment in enumerate(segments):
            before = omegas[segment.parent] if segment.parent >= 0 else ORIGIN
            still = Spin(before, ORIGIN)
            a, alpha = times([list(row) for row in still.u], at.offset(i)), ORIGIN
            if segment.slide:
                omegas.append(before)
                a = add(a, cross(before, scaled(2 * rates[i], at.axis(i))))
            else:
                x, y, z = at.outwards(i, before)
                alpha = (y * rates[i], -x * rates[i], ZERO)
                omegas.append((x, y, z + rates[i]))
                a = at.outwards(i, a)
            linear.append(a)
            angular.append(alpha)
            spin = Spin(omegas[i], ORIGIN)
            first, second = at.first(i), at.second(i)
            mass = [[at.of(f"m{i}") if r == c else ZERO for c in range(3)] for r in range(3)]
            back = crossing(scaled(ca.SX(-1), first))
            force = times([list(row) for row in spin.u], first)
            handles.append((mass, back, inertia_of(second), force, spin.moment(second)))
        solved: list[Any] = [None] * self.n
        for i in reversed(range(self.n)):
            mass, mixed, inertia, force, moment = handles[i]
            if segments[i].slide:
                axis = at.axis(i)
                column = (times(mass, axis), times(transposed(mixed), axis))
                pivot = 1 / dot(axis, column[0])
                free = forces[i] - dot(axis, force)
            else:
                column = (tuple(mixed[r][2] for r in range(3)), tuple(inertia[r][2] for r in range(3)))
                pivot = 1 / inertia[2][2]
                free = forces[i] - moment[2]
            solved[i] = (column, pivot, free)
            parent = segments[i].parent
            if parent < 0:
                continue
            less = [[-pivot * x for x in part] for part in column]
            mass = sum_of(mass, [[x * y for y in column[0]] for x in less[0]])
            mixed = sum_of(mixed, [[x * y for y in column[1]] for x in less[0]])
            inertia = sum_of(inertia, [[x * y for y in column[1]] for x in less[1]])
            # What the joint's own acceleration takes away at zero acceleration of the body, and velocity products.
            force = add(
                add(force, scaled(pivot * free, column[0])), add(times(mass, linear[i]), times(mixed, angular[i]))
            )
            moment = add(moment, scaled(pivot * free, column[1]))
            moment = add(moment, add(times(transposed(mixed), linear[i]), times(inertia, angular[i])))
            force, moment = at.wrench_inwards(i, (force, moment))
            mass, mixed, inertia = (self._inwards(at, i, part) for part in (mass, mixed, inertia))
            # a of the child's origin is a − p × α of the parent's.
            p = crossing(at.offset(i))
            shift = product(mass, transposed(p))
            inertia = sum_of(inertia, sum_of(product(p, mixed), transposed(product(p, mixed))))
            inertia = sum_of(inertia, product(p, shift))
            old = handles[parent]
            handles[parent] = (sum_of(old[0], mass), sum_of(old[1], sum_of(mixed, shift)), sum_of(old[2], inertia),
                               add(old[3], force), add(old[4], moment))  # fmt: skip
        result: list[Any] = [ZERO] * self.n
        motions: list[Any] = []
        for i, segment in enumerate(segments):
            pull = self._gravity if gravity else ZERO
            a, alpha = motions[segment.parent] if segment.parent >= 0 else ((ZERO, ZERO, pull), ORIGIN)
            a = add(at.outwards(i, add(a, cross(alpha, at.offset(i)))), linear[i])
            alpha = add(at.outwards(i, alpha), angular[i])
            column, pivot, free = solved[i]
            result[i] = pivot * (free - dot(column[0], a) - dot(column[1], alpha))
            if segment.slide:
                a = add(a, scaled(result[i], at.axis(i)))
            else:
                alpha = (alpha[0], alpha[1], alpha[2] + result[i])
            motions.append((a, alpha))
        return self._stacked(result)

    def _inwards(self, at: Recursion, i: int, rows: Rows) -> Rows:
        half = transposed([list(at.inwards(i, tuple(row))) for row in transposed(rows)])
        return [list(at.inwards(i, tuple(row))) for row in half]


@dataclass(frozen=True)
class InWorld(Recursion):
    """A recursion whose vectors are all in the ground's axes: nothing is turned on the way."""

    @cached_property
    def axes(self) -> list[Rows]:
        """Of each body, its rotation."""
        result: list[Rows] = []
        for i, segment in enumerate(self.skeleton.segments):
            before = (
                result[segment.parent]
                if segment.parent >= 0
                else [[ca.SX(float(a == b)) for b in range(3)] for a in range(3)]
            )
            if segment.slide:
                result.append(before)
                continue
            turn = product(before, [[ca.SX(x) for x in row] for row in segment.turn])
            c, s = self.along[i]
            result.append([[c * row[0] + s * row[1], c * row[1] - s * row[0], row[2]] for row in turn])
        return result

    def axis(self, i: int) -> Any:
        """Of any joint."""
        if not self.skeleton.segments[i].slide:
            return tuple(row[2] for row in self.axes[i])
        parent = self.skeleton.segments[i].parent
        own = super().axis(i)
        return times(self.axes[parent], own) if parent >= 0 else own

    def offset(self, i: int) -> Any:
        """See `Recursion`."""
        parent, at = self.skeleton.segments[i].parent, super().vector(f"offset{i}")
        at = times(self.axes[parent], at) if parent >= 0 else at
        return add(at, scaled(self.displacement[i], self.axis(i))) if self.skeleton.segments[i].slide else at

    def of_body(self, i: int, a: Any) -> Any:  # noqa: ARG002 - as `Recursion` has it
        """Nothing to do: `axes` turns it."""
        return a

    def inwards(self, i: int, a: Any) -> Any:  # noqa: ARG002 - as `Recursion` has it
        """Nothing to do."""
        return a

    def on_joint(self, i: int, wrench: Any) -> Any:
        """See `Recursion`."""
        return dot(self.axis(i), wrench[0 if self.skeleton.segments[i].slide else 1])

    @cached_property
    def own(self) -> list[tuple[Any, Any, Any]]:
        """Mass, first and second moment of each body alone."""
        result = []
        for i in range(self.n):
            second = symmetric({ab: self.of(f"s{i}.{ab}") for ab in SECOND})
            turned = product(product(self.axes[i], second), transposed(self.axes[i]))
            second = {ab: turned[AXES.index(ab[0])][AXES.index(ab[1])] for ab in SECOND}
            result.append((self.of(f"m{i}"), times(self.axes[i], self.vector(f"c{i}")), second))
        return result

    @cached_property
    def mass(self) -> Any:
        """See `Recursion`."""
        whole = [[m, c, dict(s)] for m, c, s in self.own]
        result = {}
        for i in reversed(range(self.n)):
            m, c, s = whole[i]
            axis = self.axis(i)
            if self.skeleton.segments[i].slide:
                wrench = (scaled(m, axis), cross(c, axis))
            else:
                wrench = (cross(axis, c), times(inertia_of(s), axis))
            result[i, i], j = self.on_joint(i, wrench), i
            while self.skeleton.segments[j].parent >= 0:
                wrench, j = self.wrench_inwards(j, wrench), self.skeleton.segments[j].parent
                result[i, j] = self.on_joint(j, wrench)
            parent, p = self.skeleton.segments[i].parent, self.offset(i)
            if parent >= 0:
                up = whole[parent]
                up[0], up[1] = up[0] + m, add(up[1], add(c, scaled(m, p)))
                for ab in SECOND:
                    a, b = AXES.index(ab[0]), AXES.index(ab[1])
                    up[2][ab] = up[2][ab] + s[ab] + c[a] * p[b] + c[b] * p[a] + m * p[a] * p[b]
        return result

    def forces(self, rates: Any, gravity: Any) -> Any:
        """See `Recursion`."""
        spins: list[Spin] = []
        accelerations: list[Any] = []
        wrenches: list[Any] = []
        for i, segment in enumerate(self.skeleton.segments):
            parent = segment.parent
            before = spins[parent] if parent >= 0 else Spin(ORIGIN, ORIGIN)
            a = accelerations[parent] if parent >= 0 else (ZERO, ZERO, gravity)
            if parent >= 0:
                a = add(a, times([list(row) for row in before.u], self.offset(i)))
            along = scaled(rates[i], self.axis(i))
            if segment.slide:
                spin = before
                a = add(a, scaled(ca.SX(2), cross(before.omega, along)))
            else:
                spin = Spin(add(before.omega, along), add(before.alpha, cross(before.omega, along)))
            spins.append(spin)
            accelerations.append(a)
            m, c, s = self.own[i]
            force = add(times([list(row) for row in spin.u], c), scaled(m, a))
            wrenches.append((force, add(spin.moment(s), cross(c, a))))
        result = [ZERO] * self.n
        for i in reversed(range(self.n)):
            result[i] = self.on_joint(i, wrenches[i])
            parent = self.skeleton.segments[i].parent
            if parent >= 0:
                wrench = self.wrench_inwards(i, wrenches[i])
                wrenches[parent] = tuple(add(a, b) for a, b in zip(wrenches[parent], wrench, strict=True))
        return result


@dataclass(frozen=True)
class WorldAxes(TreeMotion):
    """`TreeMotion` over `InWorld`."""

    def _at(self, u: ca.SX, along: Any) -> Recursion:
        at = super()._at(u, along)
        return InWorld(at.skeleton, at.value, at.along, at.displacement)
