"""The start of a sample: what is measured, which torques are asked for, and what is watched.

In: states, signals and constants of a loop as graphs. Out: the command, the discrete states' successors, monitors.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from flexopt.algebra import apply_pseudo_inverse
from flexopt.plant.motion import Directions, Motion, Pair
from flexopt.simulation.directions import Frame
from flexopt.simulation.feedback import FeedbackLaw, joint_torque
from flexopt.simulation.structure import MODEL, N_TASK, Layout, LoopStructure


@dataclass(frozen=True)
class Layouts:
    """How the loop's vectors are laid out, and its law."""

    law: FeedbackLaw
    states: Layout
    signals: Layout
    constants: Layout


class Part:
    """What sampling and integration share: the motion with its constants, base and target at a time."""

    def __init__(self, structure: LoopStructure, layouts: Layouts, e: ca.SX, c: ca.SX) -> None:
        self.s, self.law = structure, layouts.law
        self.of = layouts.constants.split(c)
        self.e = layouts.signals.split(e)
        self.motion = Motion(self.s.motion, self.of)
        own = {name.removeprefix(MODEL): value for name, value in self.of.items() if name.startswith(MODEL)}
        self.model = Motion(self.s.motion, self.of | own)

    def base_at(self, t: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Anchor and its rate at a time after the start of the sample, x from where the base stood at first."""
        if self.s.moving_base:
            return self.e["base"] + t * self.e["base_rate"], self.e["base_rate"]
        return ca.SX(0), ca.SX(0)

    def target_at(self, t: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Target and its rate, the like."""
        if self.s.moving_target:
            return self.e["target"] + t * self.e["target_rate"], self.e["target_rate"]
        return self.of["target"], ca.SX.zeros(N_TASK, 1)

    def known_directions(self, along: Directions) -> Directions:
        """Directions as the controller knows them: joints measured, passive hinges at their design angles.

        A body's direction is turned back by the deflections of all hinges before it, products of the pairs at hand.
        """
        design, result = self.of["design_directions"], Directions()
        back: Pair | None = None
        for k, pair in enumerate(along):
            if k in self.motion.hinges:
                i = self.motion.hinges.index(k)
                own = _between(pair, along[k - 1]) if k else pair
                own = _between(own, (design[2 * i], design[2 * i + 1]))
                back = own if back is None else _together(own, back)
            result.append(pair if back is None else _between(pair, back))
        return result

    def torque_for(self, force: ca.SX, w: ca.SX, known: Directions) -> ca.SX:
        """Joint torques of a force at the end-point, with what gravity compensation and nullspace damper add."""
        jacobian = self.model.rigid_jacobian(known)
        n = jacobian.shape[1]
        torque = ca.SX.zeros(n, 1) if self.s.law == "none" else joint_torque(jacobian, force, self.s.control)
        if self.s.compensated:
            torque += self.model.holding_torque(known)
        if self.s.nullspace_damped and n > N_TASK:
            rates = (ca.SX(self.motion.to_q) @ w)[-n:]
            torque -= self.of["nullspace_damping"] * (rates - apply_pseudo_inverse(jacobian, jacobian @ rates))
        if self.s.limited:
            limit = self.of["torque_limit"]
            torque = ca.fmax(-limit, ca.fmin(limit, torque))
        return torque

    def torque_rate(self, command: ca.SX, torque: ca.SX) -> ca.SX:
        """Of lagging actuators."""
        rate = self.of["bandwidth"] * (command - torque)
        if self.s.rate_limited:
            limit = self.of["rate_limit"]
            rate = ca.fmax(-limit, ca.fmin(limit, rate))
        return rate

    def through_dead_band(self, command: ca.SX) -> ca.SX:
        """What the actuators make of a command inside and outside their dead band."""
        if not self.s.dead_band:
            return command
        band = self.of["dead_band"]
        return command - ca.fmax(-band, ca.fmin(band, command))


class Sample(Part):
    """The loop at the start of a sample."""

    def __init__(self, structure: LoopStructure, layouts: Layouts, x: ca.SX, e: ca.SX, c: ca.SX, frame: Frame) -> None:
        super().__init__(structure, layouts, e, c)
        self.x = layouts.states.split(x)
        self.along = self.motion.with_base(frame.start.pairs)
        self.base, _ = self.base_at(ca.SX(0))
        self.target, self.target_rate = self.target_at(ca.SX(0))
        self.measured = self._measured()

    def _measured(self) -> ca.SX:
        """What the controller gets to see now: end-point and its rate."""
        u, w = self.x["u"], self.x["w"]
        fresh = ca.vertcat(self.motion.end_point(u, self.along, self.base), self.motion.end_point_rate(w, self.along))
        if self.s.noisy:
            fresh += self.e["noise"]
        if self.s.quantised:
            # A resolution of zero means none.
            size = ca.vertcat(self.of["resolution"], self.of["rate_resolution"])
            rounded = size * ca.floor(fresh / ca.if_else(size > 0, size, 1) + 0.5)
            fresh = ca.if_else(size > 0, rounded, fresh)
        self.fresh = fresh
        return self.x["queue"][: 2 * N_TASK] if self.s.delay else fresh

    @property
    def error(self) -> tuple[ca.SX, ca.SX]:
        """End-point error and its rate as measured."""
        return self.target - self.measured[:N_TASK], self.target_rate - self.measured[N_TASK:]

    def command(self) -> ca.SX:
        """Joint torques asked for, dead band of the actuators included."""
        e, e_rate = self.error
        force = self.law.force(e, e_rate, self.x["law"], self.of)
        known = self.known_directions(self.along)
        return self.through_dead_band(self.torque_for(force, self.x["w"], known))

    def applied(self, command: ca.SX) -> ca.SX:
        """Torques that act."""
        return self.x["torque"] if self.s.lagging else command

    def successors(self) -> tuple[ca.SX, ca.SX]:
        """States of a sampled law and of the queue at the next sample."""
        period = self.s.substeps * self.of["h"]
        e, _ = self.error
        law = self.law.successor(e, self.x["law"], period, self.of) if self.s.sampled else ca.SX.zeros(0, 1)
        queue = ca.vertcat(self.x["queue"][2 * N_TASK :], self.fresh) if self.s.delay else ca.SX.zeros(0, 1)
        return law, queue

    @property
    def deflection(self) -> ca.SX:
        """Passive coordinates less their design values (n_p,)."""
        motion, u = self.motion, self.x["u"]
        anchors = [self.base if direction == "x" else ca.SX(0) for direction in self.s.motion.translations]
        passive = ca.vertcat(u[: motion.n_translations] - ca.vertcat(*anchors), motion.hinge_angles(u))
        return passive - self.of["design"]

    def monitor(self) -> ca.SX:
        """What a run is judged by: squared end-point error, squared base rotation, energy of each flexible mode.

        ½ (η̇_i² + ω_i² η_i²), η = Φᵀ M (q − q_design), J: of small motions about the design posture.
        """
        e = self.target - self.motion.end_point(self.x["u"], self.along, self.base)
        n_moving = self.motion.n_translations
        rotation = self.deflection[n_moving] ** 2 if self.s.motion.rotation else ca.SX(0)
        away = self.x["u"] - self.of["u_design"]
        if "x" in self.s.motion.translations:
            away[0] -= self.base
        projection = ca.reshape(self.of["modes"], self.of["omega_squared"].shape[0], self.motion.n)
        eta, rate = projection @ away, projection @ self.x["w"]
        energy = 0.5 * (rate**2 + self.of["omega_squared"] * eta**2)
        return ca.vertcat(ca.dot(e, e), rotation, energy)


def _between(a: Pair, b: Pair) -> Pair:
    """Cosine and sine of α − β."""
    return a[0] * b[0] + a[1] * b[1], a[1] * b[0] - a[0] * b[1]


def _together(a: Pair, b: Pair) -> Pair:
    """Cosine and sine of α + β."""
    return a[0] * b[0] - a[1] * b[1], a[1] * b[0] + a[0] * b[1]
