"""A tree's equations of motion as a simulator wants them: few operations, no trigonometry of their own.

Coordinates u (n_q,): displacements of the slides, then angles of the hinges, each in the order of the bodies, to which
the directions belong. The mass matrix is factored body by body (no zero of a branched tree is filled in), or, where the
base slides, beginning with its translations, whose pivots are constants; gravity is then left to a slide that is
vertical.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from flexopt.plant.motion import Directions, Motion
from flexopt.plant.tree_algebra import ORIGIN, ZERO, add, solve_symmetric
from flexopt.plant.tree_anchor import TurningAnchor
from flexopt.plant.tree_recursion import Recursion
from flexopt.plant.tree_structure import TURN
from flexopt.plant.tree_task import task


@dataclass(frozen=True)
class TreeMotion(Motion):
    """See `Motion`."""

    KNOWN = frozenset(("offset", "c", "m", "tip", "gravity", "task_length"))

    @cached_property
    def bodies(self) -> list[int]:
        """Body of each entry of u."""
        slides = [i for i, segment in enumerate(self.structure.segments) if segment.slide]
        return slides + [i for i, segment in enumerate(self.structure.segments) if not segment.slide]

    @property
    def absorbed(self) -> dict[str, tuple[int, float]]:
        """See `Motion`."""
        return {name: (self.bodies.index(i), sign) for name, (i, sign) in self.structure.absorbed.items()}

    @property
    def to_q(self) -> ca.DM:
        """A (n_q, n_q) of q = A u: passive coordinates first."""
        rows = ca.DM.zeros(self.n, self.n)
        for row, body in enumerate(self.structure.order):
            rows[row, self.bodies.index(body)] = 1
        return rows

    def known(
        self,
        u: ca.SX,
        along: Directions,
        design: ca.SX,
        pairs: Directions,
        model: Motion,  # noqa: ARG002 - chains' only
    ) -> tuple[ca.SX, Directions]:
        """See `Motion`."""
        coordinates, directions, hinges = self._by_body(u), list(along), self.hinges
        for row, i in enumerate(self.structure.passive):
            coordinates[i] = design[row]
            if row in hinges:
                directions[self.bodies.index(i) - self.n_translations] = pairs[hinges.index(row)]
        return self._stacked(coordinates), directions

    def passive(self, u: ca.SX, base: ca.SX) -> ca.SX:
        """See `Motion`."""
        coordinates = self._by_body(self.relative(u, base))
        return ca.vertcat(*(coordinates[i] for i in self.structure.passive))

    def relative(self, u: ca.SX, base: ca.SX) -> ca.SX:
        """See `Motion`."""
        moved, anchor = super().relative(u, base), self._anchor(base)
        return moved if anchor is None else anchor.relative(moved)

    def faced(self, base: ca.SX) -> ca.SX:
        """See `Motion`."""
        if TURN not in self.drive:
            return base
        yaw, turn = (base[self.drive.index(name)] for name in ("yaw", TURN))
        return ca.vertcat(*(yaw + turn if name == "yaw" else base[k] for k, name in enumerate(self.drive)))

    def end_point(self, u: ca.SX, along: Directions, base: ca.SX) -> ca.SX:
        """The task r (p,), m."""
        return task(self._at(u, along), base)

    def end_point_rate(self, u: ca.SX, w: ca.SX, along: Directions, base: ca.SX) -> ca.SX:
        """ṙ = J v (p,), m/s, the placement standing still."""
        r, at, pairs = self._task_of_symbols(len(along), base)
        n_slides = self.n_translations
        turning = [w[n_slides + k] * part for k, (c, s) in enumerate(along) for part in (-s, c)]
        symbols = ca.vertcat(at[:n_slides], pairs)
        # By the chain rule through cosines and sines; `seed` stands in for its values, which may hold symbols of u.
        seed = ca.SX.sym("seed", symbols.shape[0])
        rate = ca.jtimes(r, symbols, seed)
        given = ca.vertcat(u, *(entry for pair in along for entry in pair), w[:n_slides], *turning)
        return ca.substitute(rate, ca.vertcat(at, pairs, seed), given)

    def rigid_jacobian(self, u: ca.SX, along: Directions, base: ca.SX) -> ca.SX:
        """Jv (p, n): columns of the actuated joints."""
        r, at, pairs = self._task_of_symbols(len(along), base)
        columns: list[ca.SX] = []
        for body in self.structure.actuated:
            k = self.bodies.index(body)
            if k < self.n_translations:
                columns.append(ca.jacobian(r, at[k]))
            else:
                c, s = 2 * (k - self.n_translations), 2 * (k - self.n_translations) + 1
                columns.append(ca.jtimes(r, ca.vertcat(pairs[c], pairs[s]), ca.vertcat(-pairs[s], pairs[c])))
        given = ca.vertcat(u, *(entry for pair in along for entry in pair))
        return ca.substitute(ca.densify(ca.horzcat(*columns)), ca.vertcat(at, pairs), given)

    def holding_torque(self, u: ca.SX, along: Directions) -> ca.SX:
        """g_a (n,): what the actuated joints must give to carry the weight."""
        weight = self._at(u, along).forces([ZERO] * self.n, self.of("gravity"))
        return ca.vertcat(*(weight[i] for i in self.structure.actuated))

    def potential(self, u: ca.SX, along: Directions) -> ca.SX:
        """Gravity's potential, J."""
        at, total, up = self._at(u, along), ZERO, self.structure.up
        for i in range(self.n):
            mass, first = at.of(f"m{i}"), at.vector(f"c{i}")
            total += mass * at.point(i, ORIGIN)[up] + at.to_ground(i, first)[up]
        return self.of("gravity") * total

    def spring_energy(self, u: ca.SX, base: ca.SX) -> ca.SX:
        """½ (q − q_rest)ᵀ K (q − q_rest), J."""
        stretch = self._stretch(u, base)
        pulls = self._coupled("stiffness", stretch)
        return 0.5 * sum((stretch[i] * pull for i, pull in pulls.items()), start=ZERO)

    def momentum(self, u: ca.SX, w: ca.SX, along: Directions) -> ca.SX:
        """M_u w (n_q,), conjugate to u."""
        rates, momentum = self._by_body(w), [ZERO] * self.n
        for (i, j), entry in self._at(u, along).mass.items():
            momentum[i] += entry * rates[j]
            if i != j:
                momentum[j] += entry * rates[i]
        return self._stacked(momentum)

    def rates_of_momentum(self, u: ca.SX, momentum: ca.SX, along: Directions) -> ca.SX:
        """Rates M_u⁻¹ p (n_q,)."""
        return self._stacked(self._solved(self._at(u, along), self._by_body(momentum)))

    def force(
        self, u: ca.SX, w: ca.SX, along: Directions, torque: ca.SX, base: ca.SX, base_rate: ca.SX, *, gravity: bool
    ) -> ca.SX:
        """Generalised forces on u but those of inertia, (n_q,): springs, dampers, torques, weight."""
        forces = self._joint_forces(u, w, torque, base, base_rate)
        if gravity:
            weight = self._at(u, along).forces([ZERO] * self.n, self.of("gravity"))
            forces = [force - part for force, part in zip(forces, weight, strict=True)]
        return self._stacked(forces)

    def acceleration(
        self, u: ca.SX, w: ca.SX, along: Directions, torque: ca.SX, base: ca.SX, base_rate: ca.SX, *, gravity: bool
    ) -> ca.SX:
        """See `Motion`."""
        at = self._at(u, along)
        falling = self._falling(at) if gravity else None
        pull = self.of("gravity") if gravity and falling is None else ZERO
        inertia = at.forces(self._by_body(w), pull)
        right = [
            force - part for force, part in zip(self._joint_forces(u, w, torque, base, base_rate), inertia, strict=True)
        ]
        result = self._solved(at, right)
        if falling is not None:
            result[falling] -= self.structure.segments[falling].axis[self.structure.up] * self.of("gravity")
        return self._stacked(result)

    def _falling(self, at: Recursion) -> int | None:
        """The vertical slide with which all that has weight falls alike; None where something else would hold it."""
        up, segments = self.structure.up, self.structure.segments
        # What a level slide alone carries falls nowhere.
        first = next((i for i in self.structure.leading_slides if segments[i].axis[up]), None)
        vertical = first is not None and abs(segments[first].axis[up]) == 1
        return first if vertical and at.of(f"armature{first}").is_zero() else None

    def _by_body(self, column: ca.SX) -> list[ca.SX]:
        result = [ZERO] * self.n
        for row, body in enumerate(self.bodies):
            result[body] = column[row]
        return result

    def _stacked(self, by_body: list[ca.SX]) -> ca.SX:
        return ca.vertcat(*(by_body[body] for body in self.bodies))

    def _at(self, u: ca.SX, along: Directions) -> Recursion:
        pairs = [(ca.SX(1), ZERO)] * self.n
        for body, pair in zip(self.bodies[self.n_translations :], along, strict=True):
            pairs[body] = pair
        return Recursion(self.structure, self.value, pairs, self._by_body(u))

    def _task_of_symbols(self, n_hinges: int, base: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """R (p,) of symbols: displacements (n_q,), and (cos, sin) of each hinge, stacked."""
        at, pairs = ca.SX.sym("u", self.n), ca.SX.sym("pairs", 2 * n_hinges)
        known = [(pairs[2 * k], pairs[2 * k + 1]) for k in range(n_hinges)]
        return self.end_point(at, known, base), at, pairs

    def _stretch(self, u: ca.SX, base: ca.SX) -> list[ca.SX]:
        """Of each joint, its displacement from rest."""
        at = Recursion(self.structure, self.value, [], [])
        return [part - at.of(f"rest{i}") for i, part in enumerate(self._by_body(self.relative(u, base)))]

    def _coupled(self, word: str, stretch: list[ca.SX]) -> dict[int, ca.SX]:
        """K or D times a displacement or a rate."""
        at = Recursion(self.structure, self.value, [], [])
        pairs = self.structure.coupled_springs if word == "stiffness" else self.structure.coupled_dampers
        result: dict[int, ca.SX] = {}
        for i, j in pairs:
            entry = at.of(f"{word}{i}.{j}")
            result[i] = result.get(i, ZERO) + entry * stretch[j]
            if i != j:
                result[j] = result.get(j, ZERO) + entry * stretch[i]
        return result

    def _joint_forces(self, u: ca.SX, w: ca.SX, torque: ca.SX, base: ca.SX, base_rate: ca.SX) -> list[ca.SX]:
        forces = [ZERO] * self.n
        for k, i in enumerate(self.structure.actuated):
            forces[i] = torque[k]
        for pulls in (
            self._coupled("stiffness", self._stretch(u, base)),
            self._coupled("damping", self._by_body(self.relative_rates(u, w, base, base_rate))),
        ):
            for i, pull in pulls.items():
                forces[i] = forces[i] - pull
        return forces if TURN not in self.drive else self._by_body(self._on_driven(self._stacked(forces), base))

    def _on_driven(self, forces: ca.SX, base: ca.SX) -> ca.SX:
        """Forces on u from those on the coordinates that the anchor sees: virtual work."""
        at = ca.SX.sym("u", self.n)
        return ca.densify(ca.jtimes(self.relative(at, base), at, forces, True))

    def _anchor(self, base: ca.SX) -> TurningAnchor | None:
        """The anchor frame where it turns during a motion."""
        hinge = self.structure.turned_hinge
        if TURN not in self.drive or hinge is None:
            return None
        at, undisplaced = Recursion(self.structure, self.value, [], []), ORIGIN
        for i in (*self.structure.leading_slides, hinge[0]):
            undisplaced = add(undisplaced, at.vector(f"offset{i}"))
        x, y = self.absorbed["x"], self.absorbed["y"]
        return TurningAnchor(x, y, (self.bodies.index(hinge[0]), hinge[1]), undisplaced, base[self.drive.index(TURN)])

    def _solved(self, at: Recursion, right: list[ca.SX]) -> list[ca.SX]:
        leading = self.structure.leading_slides
        known = {i: at.of(f"inverse{i}") for i in leading}
        outwards = leading + [i for i in range(self.n) if i not in leading]
        parents = [segment.parent for segment in self.structure.segments]
        chain = parents == list(range(-1, self.n - 1))
        return solve_symmetric(at.mass, right, outwards if chain else outwards[::-1], known if chain else {})
