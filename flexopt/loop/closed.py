"""The closed loop of a machine and its task-space controller as graphs: one sample of it, and what it shows.

In: a `LoopStructure`, which says what parts the loop has. Out: named Functions `step`, its `fast` twin with carried
directions and their `refresh`, and `outputs`. Every number (machine, gains, limits, target) is an entry of one vector
of constants c, so loops of one structure share their compiled code; `baked` folds them in.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.algebra.layout import Layout
from flexopt.foundation.kept import by_structure
from flexopt.loop.directions import Carried, Computed, stacked
from flexopt.loop.feedback import FeedbackLaw
from flexopt.loop.flow import Flow
from flexopt.loop.integrators import State, classical_step, explicit_step, implicit_step
from flexopt.loop.sample import Layouts, Sample, SampleModel
from flexopt.loop.structure import LoopStructure, constant_sizes, signal_sizes, state_sizes
from flexopt.loop.tableaus import dormand_prince, gauss, radau
from flexopt.plant.machine_motion import motion_of
from flexopt.plant.motion import Motion


@dataclass(frozen=True)
class ClosedLoop:
    """Graphs of one loop. x are its states, e its signals, c its constants; see `states`, `signals`, `constants`.

    Inside, x is measured from where the base stands at first, so that nothing is lost far from the origin.
    """

    structure: LoopStructure

    @cached_property
    def law(self) -> FeedbackLaw:
        """The feedback law."""
        s = self.structure
        return FeedbackLaw(s.law, s.n_task, s.order, s.sampled)

    @cached_property
    def layouts(self) -> Layouts:
        """How x, e and c are laid out."""
        return Layouts(self.law, self.states, self.signals, self.constants)

    @cached_property
    def shape(self) -> Motion:
        """The equations of motion without numbers."""
        return motion_of(self.structure.motion, {})

    @cached_property
    def constants(self) -> Layout:
        """Layout of c."""
        return Layout(constant_sizes(self.structure, self.law))

    @cached_property
    def states(self) -> Layout:
        """Layout of x."""
        return Layout(state_sizes(self.structure, self.law))

    @cached_property
    def signals(self) -> Layout:
        """Layout of e."""
        return Layout(signal_sizes(self.structure))

    @cached_property
    def to_q(self) -> NDArray[np.float64]:
        """A (n_q, n_q) of q = A u + constant."""
        found = self.shape.to_q.full()
        found.setflags(write=False)
        return found

    @cached_property
    def directions(self) -> int:
        """Entries of d: cosine and sine of every body that turns."""
        return 2 * (self.shape.n - self.shape.n_translations)

    @cached_property
    def step(self) -> ca.Function:
        """One sample. Inputs x, e, c; outputs x_next and monitor.

        The monitor holds, of a watched loop, `Sample.monitor` at the sample's start, and of the implicit method, last,
        the square of the relative change that its iterations left.
        """
        return self._stepped("step", carried=False)

    @cached_property
    def fast(self) -> ca.Function | None:
        """The same with carried directions d; its output turn is at most 1 where it holds.

        Inputs x, d, e, c; outputs x_next, d_next, monitor, turn. None for the implicit method.
        """
        return None if self.structure.method == "gauss" else self._stepped("fast_step", carried=True)

    @cached_property
    def refresh(self) -> ca.Function:
        """Directions d of a state. Inputs x, c."""
        x, c = ca.SX.sym("x", self.states.total), ca.SX.sym("c", self.constants.total)
        angles = self.shape.angles(self.states.split(x)["u"])
        return ca.Function("refresh", [x, c], [stacked(Computed(angles).start.pairs)], ["x", "c"], ["d"])

    @cached_property
    def outputs(self) -> ca.Function:
        """What a state shows. Inputs x, e, c.

        Outputs q, v (n_q,); end_point, error = r_d − r, error_rate (n_task,), m; torque (n,) of the joints, N m or N;
        energy, J: kinetic, springs and weight; deflection (n_p,): passive coordinates less their design values;
        monitor: see `Sample.monitor`.
        """
        x, e, c = self._symbols()
        at = Sample(self.structure, self.layouts, x, e, c, Computed(self.shape.angles(self.states.split(x)["u"])))
        u, w = at.x["u"], at.x["w"]
        motion, a = at.motion, ca.SX(self.shape.to_q)
        point, nothing = motion.end_point(u, at.along, at.base), ca.SX(0)
        place = ca.vertcat(*motion.on_rows(ca.vertsplit(at.of["base"]), nothing))
        rate = motion.end_point_rate(u, w, at.along, at.base)
        energy = motion.kinetic_energy(u, w, at.along) + motion.spring_energy(u, at.base)
        if self.structure.gravity:
            energy += motion.potential(u, at.along)
        if motion.follows:
            u, w = motion.relative(u, at.base), motion.relative_rates(u, w, at.base, at.base_rate)
        outputs = {
            "q": a @ u + motion.origin(at.of["base"]), "v": a @ w, "end_point": point + place,
            "error": at.target - point, "error_rate": at.target_rate - rate, "torque": at.given(a @ w),
            "energy": energy, "deflection": at.deflection, "monitor": at.monitor(),
        }  # fmt: skip
        dense = [ca.densify(value) for value in outputs.values()]
        return ca.Function("outputs", [x, e, c], dense, ["x", "e", "c"], list(outputs), {"cse": True})

    def _symbols(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        sizes = (("x", self.states), ("e", self.signals), ("c", self.constants))
        x, e, c = (ca.SX.sym(name, layout.total) for name, layout in sizes)
        return x, e, c

    def _frame(self, x: ca.SX, d: ca.SX | None) -> Computed | Carried:
        return Computed(self.shape.angles(self.states.split(x)["u"])) if d is None else Carried(d)

    def _sampling(self, *, carried: bool) -> ca.Function:
        """The start of a sample: command to hold, what the discrete states become, monitor."""
        x, e, c = self._symbols()
        d = ca.SX.sym("d", self.directions if carried else 0)
        frame = self._frame(x, d if carried else None)
        at = Sample(self.structure, self.layouts, x, e, c, frame)
        command = at.command() if self.structure.sampled else ca.SX.zeros(0, 1)
        law, queue = at.successors()
        turn = frame.turn if isinstance(frame, Carried) else ca.SX(0)
        monitor = at.monitor() if self.structure.watched else ca.SX.zeros(0, 1)
        outputs = [ca.densify(value) for value in (command, law, queue, monitor, turn)]
        names = ["command", "law", "queue", "monitor", "turn"]
        return ca.Function("sampling", [x, d, e, c], outputs, ["x", "d", "e", "c"], names, {"cse": not self._short})

    def _substep(self, *, carried: bool) -> ca.Function:
        """One integration step by an explicit method. Inputs s = [u, w, z], d, command, t, h, e, c."""
        s, d, command, t, h, e, c = self._substep_symbols(carried=carried)
        state = self.state(s)
        frame: Computed | Carried = Carried(d) if carried else Computed(self.shape.angles(state.u))
        flow = Flow(self.structure, self.layouts, command, e, c)
        if self.structure.method == "rk4":
            after, heading = classical_step(flow, h, t, state, frame)
        else:
            after, heading = explicit_step(flow, dormand_prince(), h, t, state, frame)
        turned = stacked(heading.pairs) if carried else d
        turn = frame.turn if isinstance(frame, Carried) else ca.SX(0)
        inputs, outputs = [s, d, command, t, h, e, c], [after.column, turned, turn]
        names = ["s", "d", "command", "t", "h", "e", "c"]
        return ca.Function("substep", inputs, outputs, names, ["s_next", "d_next", "turn"], {"cse": not self._short})

    def _measuring(self) -> ca.Function:
        """The newest measurement of a sample. Inputs s, t, e, c."""
        s, _, _, t, _, e, c = self._substep_symbols(carried=False)
        state, model = self.state(s), SampleModel(self.structure, self.layouts, e, c)
        along = model.motion.with_base(Computed(self.shape.angles(state.u)).start.pairs)
        measured = ca.densify(model.measurement(t, state.u, state.w, along))
        return ca.Function("measuring", [s, t, e, c], [measured], ["s", "t", "e", "c"], ["measured"], {"cse": True})

    def _gauss(self) -> tuple[ca.Function, ca.Function, ca.Function]:
        """Start, iteration and end of an implicit integration step."""
        s, _, command, t, h, e, c = self._substep_symbols(carried=False)
        flow = Flow(self.structure, self.layouts, command, e, c)
        tableau = radau() if self.structure.stiff else gauss()
        parts = implicit_step(flow, tableau, h, t, self.state(s), damped=self.structure.damped)
        inputs, names, cse = [s, command, t, h, e, c], ["s", "command", "t", "h", "e", "c"], {"cse": True}
        iterated, known = [parts.unknowns, parts.known, *inputs], ["k", "factors", *names]
        end = parts.finish.column
        return (
            ca.Function("stages", inputs, [parts.start, parts.factors], names, ["k", "factors"], cse),
            ca.Function("iteration", iterated, [parts.iterate], known, ["k_next"], cse),
            ca.Function("end", iterated, [end, parts.residual], known, ["s_next", "residual"], cse),
        )

    def _substep_symbols(self, *, carried: bool) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]:
        _, e, c = self._symbols()
        s = ca.SX.sym("s", self.n_continuous)
        d = ca.SX.sym("d", self.directions if carried else 0)
        command = ca.SX.sym("command", self.shape.n_joints if self.structure.sampled else 0)
        return s, d, command, ca.SX.sym("t"), ca.SX.sym("h"), e, c

    @property
    def n_continuous(self) -> int:
        """Entries of the state s = [u, w, z] between samples."""
        sizes = self.states.sizes
        return sizes["u"] + sizes["w"] + sizes["torque"] + (0 if self.structure.sampled else sizes["law"])

    def state(self, s: ca.SX) -> State:
        """The parts of s."""
        n = self.shape.n
        return State(s[:n], s[n : 2 * n], s[2 * n :])

    @property
    def _short(self) -> bool:
        """Whether a sample becomes one graph, whose common parts are then found at once."""
        return self.structure.substeps == 1 and self.structure.method == "rk4"

    def _times(self, c: ca.MX) -> tuple[list[ca.MX], list[ca.MX]]:
        """When each integration step of a sample begins, and its length, s: the newest measurement falls between."""
        s, h = self.structure, c[self.constants.slices["h"]]
        if not s.after:
            return [i * h for i in range(s.substeps)], [h] * s.substeps
        early, before = c[self.constants.slices["early"]], s.substeps - s.after
        first, last = (s.substeps * h - early) / before, early / s.after
        begins = [i * first for i in range(before)] + [before * first + i * last for i in range(s.after)]
        return begins, [first] * before + [last] * s.after

    def _stepped(self, name: str, *, carried: bool) -> ca.Function:
        """Sampling and integration together: calls in a row, made one SX graph where that is short."""
        s = self.structure
        x, e, c = (
            ca.MX.sym(letter, layout.total)
            for letter, layout in zip("xec", (self.states, self.signals, self.constants), strict=True)
        )
        d = ca.MX.sym("d", self.directions if carried else 0)
        command, law, queue, monitor, turn = self._sampling(carried=carried)(x, d, e, c)
        state, turned, residual = x[: self.n_continuous], d, ca.MX(0)
        times, steps = self._times(c)
        parts = self._gauss() if s.method == "gauss" else None
        substep = None if parts else self._substep(carried=carried)
        for i, (t, h) in enumerate(zip(times, steps, strict=True)):
            if s.after and i == s.substeps - s.after:
                queue = ca.vertcat(queue[: -2 * s.n_task], self._measuring()(state, t, e, c))
            if parts:
                start, iterate, finish = parts
                k, factors = start(state, command, t, h, e, c)
                for _ in range(s.iterations):
                    k = iterate(k, factors, state, command, t, h, e, c)
                state, rest = finish(k, factors, state, command, t, h, e, c)
                residual = ca.fmax(residual, rest)
            elif substep:
                state, turned, more = substep(state, turned, command, t, h, e, c)
                turn = ca.fmax(turn, more) if carried else turn
        x_next = ca.vertcat(state, law, queue) if s.sampled else ca.vertcat(state, queue)
        monitor = ca.vertcat(monitor, residual) if s.method == "gauss" else monitor
        inputs, names = ([x, d, e, c], ["x", "d", "e", "c"]) if carried else ([x, e, c], ["x", "e", "c"])
        outputs, results = [x_next, monitor], ["x_next", "monitor"]
        if carried:
            outputs, results = [x_next, turned, monitor, turn], ["x_next", "d_next", "monitor", "turn"]
        whole = ca.Function(name, inputs, outputs, names, results)
        return whole.expand(name, {"cse": True}) if self._short else whole


@by_structure
def closed_loop(structure: LoopStructure) -> ClosedLoop:
    """The graphs of a structure, kept."""
    return ClosedLoop(structure)


def baked(function: ca.Function, constants: NDArray[np.float64]) -> ca.Function:
    """A loop's Function with its constants folded in; its input c is left, empty."""
    inputs = [ca.SX.sym(name, function.size1_in(name)) for name in function.name_in()]
    given = [ca.SX(constants) if name == "c" else x for name, x in zip(function.name_in(), inputs, strict=True)]
    left = [ca.SX(0, 1) if name == "c" else x for name, x in zip(function.name_in(), inputs, strict=True)]
    outputs = function.call(given)
    return ca.Function(function.name(), left, outputs, function.name_in(), function.name_out(), {"cse": True})
