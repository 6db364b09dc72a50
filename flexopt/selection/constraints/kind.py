"""What a kind of constraint is: its rows as numbers, its graph, and what a machine must have for it.

In: a plant and validated `Constraints`. Out: `Group`s, whose rows go below each other in one Function.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca

from flexopt.errors import Fault
from flexopt.model.constraints import Constraints
from flexopt.plant import Plant

# From rest: a sag of 0.1 rad is then off by less than rounding, each step about squaring what it is off by.
SAGS = 4


@dataclass(frozen=True)
class ScaledConstraint:
    """A constraint lower ≤ c(z) ≤ upper, in `unit`; c is divided by `scale` before a solver sees it.

    `corner`: at which other numbers of the machine's, as it stands at the end of the name; empty with its own.
    """

    name: str
    unit: str
    lower: float
    upper: float
    scale: float = 1.0
    corner: str = ""


@dataclass(frozen=True)
class Group:
    """Some rows of one kind.

    Attributes:
        kind: a key of `KINDS`.
        shape: with `kind` and the number of constants all that decides the graph; hashable.
        constants: numbers that enter the graph as symbols.
        rows: in the order in which the graph gives them.
    """

    kind: str
    shape: Any
    constants: tuple[float, ...]
    rows: tuple[ScaledConstraint, ...]

    @property
    def structure(self) -> tuple[str, Any, int]:
        """What decides the graph."""
        return self.kind, self.shape, len(self.constants)


@dataclass(frozen=True)
class Scene:
    """A machine that stands still as SX graphs, each made when first asked for.

    Attributes:
        plant: the machine's plant.
        base, posture, p: the symbols that all is a graph of.
        gravity: whether it sags under its weight.
        hangs: the passive coordinates where it does, (m,), where they are known.
    """

    plant: Plant
    base: ca.SX
    posture: ca.SX
    p: ca.SX
    gravity: bool = False
    hangs: ca.SX | None = None

    @cached_property
    def q(self) -> ca.SX:
        """Coordinates (n_q,): the passive ones undeflected, or under gravity after `SAGS` steps of Newton's method."""
        at = [self.base, self.posture, self.p]
        q = self.plant.rest(*at)
        if not self.gravity:
            return q
        if self.hangs is not None:
            return ca.vertcat(self.hangs, self.posture)
        passive = q[: self.plant.n_passive]
        for _ in range(SAGS):
            passive = self.plant.static_step(passive, *at)
        return ca.vertcat(passive, self.posture)

    def with_numbers(self, p: ca.SX) -> Scene:
        """The machine with the numbers p; where it sags, the arm held so that its end-point stays where it is."""
        if not self.gravity:
            return replace(self, p=p)
        there = self.plant.end_point(self.q, self.base, self.p)
        posture, hangs = self.plant.held.call([self.base, self.posture, p, there])
        return replace(self, p=p, posture=posture, hangs=hangs)

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in space; the last coordinate is the height."""
        return self.plant.frames.dimension

    @cached_property
    def _frames(self) -> tuple[ca.SX, ca.SX]:
        origins, rotations = self.plant.body_frames.call([self.q, self.base, self.p])
        return origins, rotations

    def point(self, body: str, at: tuple[float, ...]) -> ca.SX:
        """Where a point of a body lies, (d,), m, inertial frame; `at` in the body's axes."""
        d, k = self.dimension, self.plant.frames.names.index(body)
        origins, rotations = self._frames
        return origins[:, k] + rotations[:, k * d : (k + 1) * d] @ ca.DM(list(at))

    @cached_property
    def anchor(self) -> ca.SX:
        """Where the anchor frame stands on the ground, (d − 1,), m, inertial frame."""
        coordinates = {name: self.base[k] for k, name in enumerate(self.plant.machine.base_coordinates)}
        return ca.vertcat(*(coordinates.get(name, ca.SX(0)) for name in "xy"[: self.dimension - 1]))

    @cached_property
    def _yaw(self) -> tuple[ca.SX, ca.SX] | None:
        """Cosine and sine of the anchor frame's turn about the vertical; None where it has none."""
        if "yaw" not in self.plant.machine.base_coordinates:
            return None
        yaw = self.base[self.plant.machine.base_coordinates.index("yaw")]
        return ca.cos(yaw), ca.sin(yaw)

    @cached_property
    def footprint(self) -> list[ca.SX]:
        """Corners of the support, (d − 1,) each, m, inertial frame."""
        corners = [ca.SX(ca.DM(list(corner))) for corner in self.plant.machine.support_points]
        if self._yaw is not None:
            c, s = self._yaw
            corners = [ca.vertcat(c * at[0] - s * at[1], s * at[0] + c * at[1]) for at in corners]
        return [self.anchor + corner for corner in corners]

    def from_anchor(self, point: ca.SX) -> ca.SX:
        """A point's horizontal position in the anchor frame, (d − 1,), m."""
        away = point[: self.dimension - 1] - self.anchor
        if self._yaw is None:
            return away
        c, s = self._yaw
        return ca.vertcat(c * away[0] + s * away[1], c * away[1] - s * away[0])


def lacks_support(plant: Plant) -> str:
    """Why a kind cannot be had that needs what a machine stands on."""
    wanted = "[support] span = [rear, front]" if plant.frames.dimension == 2 else "[support] polygon = [[x, y], …]"
    return (
        f"needs what the undercarriage stands on, and {plant.machine.name} has none: add {wanted} (m, anchor frame) to "
        "the machine file"
    )


def _no_faults(_: Plant, __: Constraints) -> list[Fault]:
    return []


@dataclass(frozen=True)
class ConstraintKind:
    """One kind of constraint.

    Attributes:
        groups: its rows, none where it is not asked for; only called without faults.
        graph: the rows of a group of that shape, from the symbols of its constants.
        faults: what stands in the way of it for a machine; none where it is not asked for.
        report: the same rows in a form for people, where it differs: same unit and bounds.
    """

    groups: Callable[[Plant, Constraints], list[Group]]
    graph: Callable[[Scene, Any, ca.SX], list[ca.SX]]
    faults: Callable[[Plant, Constraints], list[Fault]] = _no_faults
    report: Callable[[Scene, Any, ca.SX], list[ca.SX]] | None = None
