"""Between the samples: the right-hand sides of the loop for the integrators.

In: signals and constants of a loop, and the command that is held. Out: the graph builders of a `VectorField`.
"""

from __future__ import annotations

import casadi as ca

from flexopt.foundation.kept import by_structure
from flexopt.loop.directions import paired, stacked
from flexopt.loop.integrators import State
from flexopt.loop.sample import Layouts, SampleModel
from flexopt.loop.structure import LoopStructure
from flexopt.plant.machine_motion import motion_of
from flexopt.plant.motion import Directions


class Flow(SampleModel):
    """The loop between samples: the right-hand sides for the integrators."""

    def __init__(self, structure: LoopStructure, layouts: Layouts, command: ca.SX, e: ca.SX, c: ca.SX) -> None:
        super().__init__(structure, layouts, e, c)
        self._layouts, self._held = layouts, command
        self._given = [command, e, c]

    @property
    def n_translations(self) -> int:
        """See `VectorField`."""
        return self.motion.n_translations

    def rates(self, t: ca.SX, state: State, along: Directions) -> State:
        """See `VectorField`."""
        if not self.s.sampled:
            return self.rates_of(t, state, along)
        # A called Function is inlined many times faster than the graph is built anew.
        accelerations, z_rate = _held_rates(self.s, self._layouts)(
            t, state.u, state.w, state.z, stacked(along), *self._given
        )
        return State(state.w, accelerations, z_rate)

    def momentum(self, u: ca.SX, w: ca.SX, along: Directions) -> ca.SX:
        """See `VectorField`."""
        return self.motion.momentum(u, w, self.motion.with_base(along))

    def rates_of_momentum(self, u: ca.SX, momentum: ca.SX, along: Directions) -> ca.SX:
        """See `VectorField`."""
        return self.motion.rates_of_momentum(u, momentum, self.motion.with_base(along))

    def damping(self, u: ca.SX, along: Directions) -> ca.SX:
        """See `VectorField`."""
        w, whole = ca.SX.sym("w", self.motion.n), self.motion.with_base(along)
        base, base_rate = self.base_at(ca.SX(0))
        no_torque, still = ca.SX.zeros(self.motion.n_joints, 1), ca.SX.zeros(*base_rate.shape)
        force = self.motion.force(u, w, whole, no_torque, base, still, gravity=False)
        # Forces of inertia are of second order in w.
        return -ca.substitute(ca.jacobian(force, w), w, ca.SX.zeros(self.motion.n, 1))

    def momentum_rates(self, t: ca.SX, state: State, along: Directions) -> State:
        """See `VectorField`."""
        whole = self.motion.with_base(along)
        base, base_rate = self.base_at(t)
        command = self._command(t, state, whole)
        force = self.motion.force(
            state.u, state.w, whole, self._acting(state, command), base, base_rate, gravity=self.s.gravity
        )
        force += self.motion.kinetic_gradient(state.u, state.w, along)
        return State(state.w, force, self._z_rate(t, state, whole, command))

    def rates_of(self, t: ca.SX, state: State, along: Directions) -> State:
        """Rates from the graph itself."""
        whole = self.motion.with_base(along)
        base, base_rate = self.base_at(t)
        command = self._command(t, state, whole)
        acceleration = self.motion.acceleration(
            state.u, state.w, whole, self._acting(state, command), base, base_rate, gravity=self.s.gravity
        )
        return State(state.w, acceleration, self._z_rate(t, state, whole, command))

    def _acting(self, state: State, command: ca.SX) -> ca.SX:
        """Joint torques that act."""
        return state.z[: self.motion.n_joints] if self.s.lagging else command

    def _z_rate(self, t: ca.SX, state: State, whole: Directions, command: ca.SX) -> ca.SX:
        """Of lagging torques, and of a continuous law's states."""
        n = self.motion.n_joints if self.s.lagging else 0
        lag = self.torque_rate(command, state.z[:n]) if self.s.lagging else ca.SX.zeros(0, 1)
        if self.s.sampled:
            return lag
        return ca.vertcat(lag, self.law.derivative(self._error(t, state, whole)[0], state.z[n:], self.of))

    def _error(self, t: ca.SX, state: State, whole: Directions) -> tuple[ca.SX, ca.SX]:
        (target, target_rate), (base, _) = self.target_at(t), self.base_at(t)
        point = self.motion.end_point(state.u, whole, base)
        return target - point, target_rate - self.motion.end_point_rate(state.u, state.w, whole, base)

    def _command(self, t: ca.SX, state: State, whole: Directions) -> ca.SX:
        if self.s.sampled:
            return self._held
        n = self.motion.n_joints if self.s.lagging else 0
        e, e_rate = self._error(t, state, whole)
        force = self.law.force(e, e_rate, state.z[n:], self.of)
        torque = self.torque_for(force, state.u, state.w, whole, self.base_at(t)[0])
        return self.through_dead_band(torque)


@by_structure
def _held_rates(structure: LoopStructure, layouts: Layouts) -> ca.Function:
    """Accelerations and rates of z while the command is held; the same for computed and carried directions."""
    shape, symbol = motion_of(structure.motion, {}), ca.SX.sym
    joints = shape.n_joints
    t, u, w = symbol("t"), symbol("u", shape.n), symbol("w", shape.n)
    z = symbol("z", joints if structure.lagging else 0)
    pairs = symbol("pairs", 2 * (shape.n - shape.n_translations))
    command, e, c = symbol("command", joints), symbol("e", layouts.signals.total), symbol("c", layouts.constants.total)
    flow = Flow(structure, layouts, command, e, c)
    result = flow.rates_of(t, State(u, w, z), paired(pairs))
    inputs, names = [t, u, w, z, pairs, command, e, c], ["t", "u", "w", "z", "pairs", "command", "e", "c"]
    return ca.Function("rates", inputs, [result.w, result.z], names, ["w_rate", "z_rate"])
