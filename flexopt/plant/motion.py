"""Equations of motion as a simulator wants them: what every machine's give, whatever its kind.

In: a structure and its constants. Out: graphs in coordinates u (n_q,), the slides first, then the angles of what turns.
Cosines and sines of these angles come in from outside as `Directions`, so the caller decides whether it computes them
or carries them along by small rotations. `chain_motion` and `tree_motion` build the graphs; `machine_motion` leads
from a machine to them.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, TypeVar

import casadi as ca

from flexopt.plant.tree_structure import Skeleton

CosSin = tuple[ca.SX, ca.SX]
Directions = list[CosSin]  # (cos, sin) of what turns, in the order of u
T = TypeVar("T")


@dataclass(frozen=True)
class Motion(ABC):
    """Graph builders of the equations of motion. All take and return SX.

    Shapes: u, w (n_q,) are coordinates and rates, `along` the directions of all bodies as `with_base` gives them,
    `base` (n_d,) what places the anchor frame, by `drive`: x and y count in the axes in which it stands at first.

    Attributes:
        structure: which parts exist.
        value: the constants by name, symbols or numbers; those in `structure.zeros` are ignored.
        KNOWN: constants that a controller uses, without numbers and axes.
    """

    structure: Skeleton
    value: Mapping[str, ca.SX]
    KNOWN: ClassVar[frozenset[str]]

    @property
    def known_names(self) -> list[str]:
        """Constants that a controller uses: for its Jacobian, or to carry the weight."""
        return [name for name in self.structure.constants if re.split(r"[\d.]", name)[0] in self.KNOWN]

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the task rows."""
        return self.structure.rows

    @property
    def placement(self) -> tuple[str, ...]:
        """Names of the placement coordinates."""
        return self.structure.placement

    @property
    def drive(self) -> tuple[str, ...]:
        """Names of the n_d entries of `base`: the placement, and what a motion along it drives besides."""
        return self.structure.drive

    @property
    def n(self) -> int:
        """n_q, entries of u."""
        return len(self.structure.order)

    @property
    def n_translations(self) -> int:
        """Slides, the first entries of u."""
        return sum(segment.slide for segment in self.structure.segments)

    @property
    def n_joints(self) -> int:
        """Actuated joints, the last entries of q."""
        return len(self.structure.actuated)

    @property
    def hinges(self) -> list[int]:
        """Rows of q that are passive hinges."""
        return [row for row, i in enumerate(self.structure.passive) if not self.structure.segments[i].slide]

    @property
    def base_hinges(self) -> list[int]:
        """Those of them by which the base turns."""
        return [row for row in self.hinges if self.structure.passive[row] in self.structure.base]

    @property
    def base_rows(self) -> list[int]:
        """Rows of q that say how far the base turns, of one that cannot how far it shifts; without any all passive."""
        slides = [row for row, i in enumerate(self.structure.passive) if i in self.structure.base]
        return self.base_hinges or slides or list(range(len(self.structure.passive)))

    @property
    def offset(self) -> ca.SX:
        """The constant part of q = A u + `offset`, the placement being 0."""
        return ca.SX.zeros(self.n, 1)

    def with_base(self, directions: Directions) -> Directions:
        """Directions of all bodies from those of what turns."""
        return directions

    def of(self, name: str) -> ca.SX:
        """A constant, 0 where the structure says so."""
        return ca.SX(0) if name in self.structure.zeros else self.value[name]

    @property
    @abstractmethod
    def to_q(self) -> ca.DM:
        """A (n_q, n_q) of q = A u + a constant: passive coordinates first."""

    @property
    @abstractmethod
    def absorbed(self) -> Mapping[str, tuple[int, float]]:
        """Placement coordinates along which springs carry the machine: entry of u, and sign."""

    @abstractmethod
    def known(
        self, u: ca.SX, along: Directions, design: ca.SX, pairs: Directions, model: Motion
    ) -> tuple[ca.SX, Directions]:
        """Coordinates and directions as a controller knows them: joints measured, the rest as it should be.

        Args:
            u, along: as they are.
            design: of the passive coordinates (m,), from the anchor.
            pairs: (cos, sin) of `design` at `hinges`.
            model: the controller's own motion, this one where it knows the machine.
        """

    @abstractmethod
    def passive(self, u: ca.SX, base: ca.SX) -> ca.SX:
        """Passive coordinates (m,), from the anchor."""

    @abstractmethod
    def end_point(self, u: ca.SX, along: Directions, base: ca.SX) -> ca.SX:
        """The task r (n_task,), m."""

    @abstractmethod
    def end_point_rate(self, u: ca.SX, w: ca.SX, along: Directions, base: ca.SX) -> ca.SX:
        """ṙ = J v (n_task,), m/s."""

    @abstractmethod
    def rigid_jacobian(self, u: ca.SX, along: Directions, base: ca.SX) -> ca.SX:
        """Jv (n_task, n): columns of the actuated joints."""

    @abstractmethod
    def holding_torque(self, u: ca.SX, along: Directions) -> ca.SX:
        """g_a (n,): what the actuated joints must give to carry the weight, N m or N."""

    @abstractmethod
    def potential(self, u: ca.SX, along: Directions) -> ca.SX:
        """Gravity's potential, J."""

    @abstractmethod
    def spring_energy(self, u: ca.SX, base: ca.SX) -> ca.SX:
        """½ (q − q_rest)ᵀ K (q − q_rest), J."""

    @abstractmethod
    def momentum(self, u: ca.SX, w: ca.SX, along: Directions) -> ca.SX:
        """M_u w (n_q,), conjugate to u."""

    @abstractmethod
    def rates_of_momentum(self, u: ca.SX, momentum: ca.SX, along: Directions) -> ca.SX:
        """Rates M_u⁻¹ p (n_q,)."""

    @abstractmethod
    def force(
        self, u: ca.SX, w: ca.SX, along: Directions, torque: ca.SX, base: ca.SX, base_rate: ca.SX, *, gravity: bool
    ) -> ca.SX:
        """Generalised forces on u but those of inertia, (n_q,): springs, dampers, torques, weight."""

    @abstractmethod
    def acceleration(
        self, u: ca.SX, w: ca.SX, along: Directions, torque: ca.SX, base: ca.SX, base_rate: ca.SX, *, gravity: bool
    ) -> ca.SX:
        """Second derivatives of u (n_q,).

        Args:
            u, w: coordinates and their rates.
            along: (cos, sin) of every body that turns.
            torque: of the actuated joints, (n,), N m or N.
            base, base_rate: the placement and its rate, (n_d,). What no spring absorbs moves the ground itself, whose
                own acceleration is left out.
            gravity: whether it acts.
        """

    @property
    def n_task(self) -> int:
        """Task rows."""
        return len(self.rows)

    @property
    def n_passive(self) -> int:
        """m, the first entries of q."""
        return self.n - self.n_joints

    @property
    def follows(self) -> bool:
        """Whether q counts from the anchor wherever that is driven; else absorbed coordinates count from the origin."""
        return "yaw" in self.placement

    def angles(self, u: ca.SX) -> ca.SX:
        """Angles of what turns."""
        return u[self.n_translations :]

    def kinetic_energy(self, u: ca.SX, w: ca.SX, along: Directions) -> ca.SX:
        """½ vᵀ M v, J."""
        return 0.5 * ca.dot(w, self.momentum(u, w, along))

    def kinetic_gradient(self, u: ca.SX, w: ca.SX, turning: Directions) -> ca.SX:
        """∂T/∂u at constant rates (n_q,), by the chain rule through cosines and sines; `turning` without the base's."""
        at, pairs = ca.SX.sym("u", self.n), ca.SX.sym("pairs", 2 * len(turning))
        known = [(pairs[2 * k], pairs[2 * k + 1]) for k in range(len(turning))]
        energy = self.kinetic_energy(at, w, self.with_base(known))
        both = ca.vertcat(at, pairs)
        given = ca.vertcat(u, *(entry for pair in turning for entry in pair))
        gradient = ca.substitute(ca.gradient(energy, both), both, given)
        by_pair = gradient[self.n :]
        angular = [by_pair[2 * k + 1] * c - by_pair[2 * k] * s for k, (c, s) in enumerate(turning)]
        return ca.vertcat(gradient[: self.n_translations], *angular)

    def carried(self, base: ca.SX) -> ca.SX:
        """By how much a placement moves the springs' rest, (n_q,), in u."""
        column = ca.SX.zeros(self.n, 1)
        for name, (entry, sign) in self.absorbed.items():
            column[entry] = sign * base[self.drive.index(name)]
        return column

    def relative(self, u: ca.SX, base: ca.SX) -> ca.SX:
        """Coordinates (n_q,), as u, that count from the anchor where it is, in its axes: what springs feel."""
        return u - self.carried(base)

    def relative_rates(self, u: ca.SX, w: ca.SX, base: ca.SX, base_rate: ca.SX) -> ca.SX:
        """Rates of `relative` (n_q,): what dampers feel."""
        at, placed = ca.SX.sym("u", self.n), ca.SX.sym("base", base.shape[0])
        both = ca.vertcat(at, placed)
        seed = ca.SX.sym("seed", both.shape[0])
        rate = ca.jtimes(self.relative(at, placed), both, seed)
        return ca.substitute(rate, ca.vertcat(both, seed), ca.vertcat(u, base, w, base_rate))

    def faced(self, base: ca.SX) -> ca.SX:
        """The placement by which coordinates that count from the anchor, in its axes, give inertial directions."""
        return base

    def drawn(self, base: ca.SX) -> ca.SX:
        """What the placement at first adds to q (n_q,), as u counts from there."""
        return ca.SX.zeros(self.n, 1) if self.follows else ca.SX(self.to_q) @ self.carried(base)

    def origin(self, base: ca.SX) -> ca.SX:
        """Coordinates q (n_q,) where u is 0, the base standing at first at `base`."""
        return self.offset + self.drawn(base)

    def on_rows(self, base: Sequence[T], nothing: T) -> list[T]:
        """What a placement adds to each of the task rows; `nothing` where it adds nothing."""
        shifts = {name: base[k] for k, name in enumerate(self.placement) if name in ("x", "y")}
        return [shifts.get(row, nothing) for row in self.rows]

    def standing(self, base: ca.SX) -> ca.SX:
        """The placement (n_d,) of a base that stands where it stood at first: its x and y count from there."""
        return self.driven(ca.SX.zeros(len(self.drive), 1), base)

    def driven(self, moved: ca.SX, base: ca.SX) -> ca.SX:
        """The placement (n_d,) of a base that has `moved` from `base` (n_b,) in x and y, and turned."""
        return ca.vertcat(*(base[k] if name == "yaw" else moved[k] for k, name in enumerate(self.drive)))
