"""The start of a sample: what is measured, which torques are asked for, and what is watched.

In: states, signals and constants of a loop as graphs. Out: the command, the discrete states' successors, monitors.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import casadi as ca

from flexopt.algebra.layout import Layout
from flexopt.loop.directions import TurningFrame, paired
from flexopt.loop.feedback import FeedbackLaw, joint_torque, low_pass, nullspace_torque
from flexopt.loop.structure import JACOBIAN_DAMPING, MODEL, LoopStructure
from flexopt.model import AnyMachine
from flexopt.plant.hydraulics import Saturation, build_hydraulics
from flexopt.plant.machine_motion import motion_of
from flexopt.plant.motion import Directions


@dataclass(frozen=True)
class Layouts:
    """How the loop's vectors are laid out, and its law."""

    law: FeedbackLaw
    states: Layout
    signals: Layout
    constants: Layout


class SampleModel:
    """What sampling and integration share: the motion with its constants, base and target at a time."""

    def __init__(self, structure: LoopStructure, layouts: Layouts, e: ca.SX, c: ca.SX) -> None:
        self.s, self.law = structure, layouts.law
        self.of = layouts.constants.split(c)
        self.e = layouts.signals.split(e)
        self.motion = motion_of(self.s.motion, self.of)
        own = {name.removeprefix(MODEL): value for name, value in self.of.items() if name.startswith(MODEL)}
        self.model = motion_of(self.s.motion, self.of | own) if own else self.motion

    def base_at(self, t: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Placement and its rate at a time after the start of the sample; x and y count from where it was at first."""
        start, still = self.of["base"], ca.SX.zeros(len(self.motion.drive), 1)
        if self.s.moving_base:
            rate = self.e["base_rate"]
            return self.motion.driven(self.e["base"] + t * rate, start), self.motion.driven(rate, still)
        return self.motion.standing(start), still

    def target_at(self, t: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Target and its rate, the like."""
        if self.s.moving_target:
            return self.e["target"] + t * self.e["target_rate"], self.e["target_rate"]
        return self.of["target"], ca.SX.zeros(self.s.n_task, 1)

    @property
    def period(self) -> ca.SX:
        """Of a sample, s."""
        return self.s.substeps * self.of["h"]

    def measurement(self, t: ca.SX, u: ca.SX, w: ca.SX, along: Directions) -> ca.SX:
        """What sensors tell at a time after the start of the sample: the end-point and its rate."""
        base, _ = self.base_at(t)
        fresh = ca.vertcat(self.motion.end_point(u, along, base), self.motion.end_point_rate(u, w, along, base))
        if self.s.noisy:
            fresh += self.e["noise"]
        if self.s.quantised:
            # A resolution of zero means none.
            size = ca.vertcat(self.of["resolution"], self.of["rate_resolution"])
            rounded = size * ca.floor(fresh / ca.if_else(size > 0, size, 1) + 0.5)
            fresh = ca.if_else(size > 0, rounded, fresh)
        return fresh

    def torque_for(self, force: ca.SX, u: ca.SX, w: ca.SX, along: Directions, base: ca.SX) -> ca.SX:
        """Joint torques of a force at the end-point, with what gravity compensation and nullspace damper add.

        The controller measures the joints and takes passive coordinates for what they are by design.
        """
        pairs = paired(self.of["design_directions"])
        at, known = self.motion.known(u, along, self.of["design"], pairs, self.model)
        jacobian = self.model.rigid_jacobian(at, known, self.motion.faced(base))
        n = jacobian.shape[1]
        torque = ca.SX.zeros(n, 1)
        if self.s.law != "none":
            torque = joint_torque(jacobian, force, self.s.control, self.of.get(JACOBIAN_DAMPING))
        if self.s.nullspace_damped and n > self.s.n_task:
            rates = (ca.SX(self.motion.to_q) @ w)[-n:]
            torque += nullspace_torque(jacobian, rates, self.of["nullspace_damping"])
        if self.s.hydraulic is not None and self.s.levers is not None:
            torque = self._through_levers(torque, self.s.hydraulic, self.s.levers, u)
        if self.s.compensated:
            torque += self.model.holding_torque(at, known)
        if self.s.limited:
            limit = self.of["torque_limit"]
            torque = ca.fmax(-limit, ca.fmin(limit, torque))
        return torque

    def _through_levers(self, torque: ca.SX, machine: AnyMachine, saturation: Saturation, u: ca.SX) -> ca.SX:
        """What the levers leave of the joint rates torque/servo_gain, as torques."""
        q = ca.SX(self.motion.to_q) @ u + self.motion.origin(self.of["base"])
        hydraulics, gain = build_hydraulics(machine), self.of["servo_gain"]
        posture, p = q[-torque.shape[0] :], hydraulics.plant.parameter_values
        return gain * hydraulics.driven(saturation)(posture, torque / gain, p)

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


class Sample(SampleModel):
    """The loop at the start of a sample."""

    def __init__(
        self, structure: LoopStructure, layouts: Layouts, x: ca.SX, e: ca.SX, c: ca.SX, frame: TurningFrame
    ) -> None:
        super().__init__(structure, layouts, e, c)
        self.x = layouts.states.split(x)
        self.along = self.motion.with_base(frame.start.pairs)
        self.base, self.base_rate = self.base_at(ca.SX(0))
        self.target, self.target_rate = self.target_at(ca.SX(0))
        self.measured = self._measured()

    def _measured(self) -> ca.SX:
        """What the controller gets to see now: end-point and its rate."""
        self.fresh = self.measurement(ca.SX(0), self.x["u"], self.x["w"], self.along)
        arrived = self.x["queue"][: 2 * self.s.n_task] if self.s.delay else self.fresh
        if not self.s.filtered:
            return arrived
        return low_pass(arrived, self.x["filter"], self.of["filter"], self.period)

    @property
    def error(self) -> tuple[ca.SX, ca.SX]:
        """End-point error and its rate as measured."""
        r = self.s.n_task
        return self.target - self.measured[:r], self.target_rate - self.measured[r:]

    def force(self) -> ca.SX:
        """What the law asks for at the end-point."""
        return self.law.force(*self.error, self.x["law"], self.of)

    def command(self, force: ca.SX | None = None) -> ca.SX:
        """Joint torques asked for, dead band of the actuators included; of the law's force, or of another."""
        asked = self.force() if force is None else force
        return self.through_dead_band(self.torque_for(asked, self.x["u"], self.x["w"], self.along, self.base))

    def applied(self, command: ca.SX) -> ca.SX:
        """Torques that act."""
        return self.x["torque"] if self.s.lagging else command

    def given(self, rates: ca.SX) -> ca.SX:
        """Torques (n,) that the drives give at these rates (n_q,): those that act, less what drives brake by."""
        acting = self.applied(self.command())
        return acting - self.of["braking"] * rates[-acting.shape[0] :] if self.s.served else acting

    def successors(self) -> tuple[ca.SX, ca.SX]:
        """States of a sampled law and its filter, and of the queue, at the next sample."""
        e, _ = self.error
        law = self.law.successor(e, self.x["law"], self.period, self.of) if self.s.sampled else ca.SX.zeros(0, 1)
        law = ca.vertcat(law, self.measured) if self.s.filtered else law
        queue = ca.vertcat(self.x["queue"][2 * self.s.n_task :], self.fresh) if self.s.delay else ca.SX.zeros(0, 1)
        return law, queue

    @property
    def deflection(self) -> ca.SX:
        """Passive coordinates less their design values (n_p,)."""
        return self.motion.passive(self.x["u"], self.base) - self.of["design"]

    def monitor(self) -> ca.SX:
        """What a run is judged by: squared end-point error, squared base rotation, energy of each flexible mode.

        The base's rotation is the largest deflection of a hinge by which the base turns (`Motion.base_hinges`);
        energies are ½ (η̇_i² + ω_i² η_i²), η = Φᵀ M (q − q_design), J: of small motions about the design posture. Where
        the base comes to rest elsewhere (`LoopStructure.bends`) it is bent without oscillation; the kinetic part,
        ½ η̇_i², then stands alone, and after it comes the elastic one.
        """
        e = self.target - self.motion.end_point(self.x["u"], self.along, self.base)
        deflection, turns = self.deflection, self.motion.base_hinges
        rotation = reduce(ca.fmax, (deflection[row] ** 2 for row in turns)) if turns else ca.SX(0)
        u, w = self.x["u"], self.x["w"]
        away = self.motion.relative(u, self.base) - self.of["u_design"]
        projection = ca.reshape(self.of["modes"], self.of["omega_squared"].shape[0], self.motion.n)
        eta, rate = projection @ away, projection @ self.motion.relative_rates(u, w, self.base, self.base_rate)
        twice = [rate**2, self.of["omega_squared"] * eta**2]
        energy = [0.5 * part for part in (twice if self.s.bends else [twice[0] + twice[1]])]
        return ca.vertcat(ca.dot(e, e), rotation, *energy)
