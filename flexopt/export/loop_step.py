"""One sample of the machine's real controller as an operation: law, filter, integral and limits of a `[loop]`.

In: a `Context` with a loop. Out: an operation whose law is that of simulated runs; its states come in and go out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from flexopt.export.context import Context, sine_squared, unit_list
from flexopt.export.control import GAIN_MAX, RATE_MAX, WEIGHT, force_units, position, speed, torque_unit
from flexopt.export.operations import Field, Operation
from flexopt.foundation.control import control_method
from flexopt.loop.feedback import FeedbackLaw, joint_torque, low_pass, nullspace_torque
from flexopt.loop.settings import LoopSettings
from flexopt.plant.control import task_to_joints


@dataclass(frozen=True)
class _Law:
    """The law of a sample: what goes in, and what comes out, as graphs."""

    at: Context
    loop: LoopSettings

    @property
    def integral(self) -> bool:
        return self.loop.feedback == "pid"

    @property
    def served(self) -> bool:
        """Whether joints are asked for rates."""
        return self.loop.drive == "velocity"

    @property
    def damped(self) -> bool:
        plant = self.at.plant
        return self.loop.nullspace_damping > 0 and plant.n_actuated > plant.n_task

    @property
    def keeps(self) -> bool:
        """Whether it has states, which go out and come in again."""
        return self.integral or self.loop.filter_hz is not None

    @property
    def force_unit(self) -> str:
        """Of f: a rate of the end-point where joints are asked for rates."""
        return "m/s" if self.served else "N" if self.loop.control == "transpose" else force_units(self.at)

    def inputs(self) -> list[tuple[Field, ca.SX]]:
        """Measurements, target, and the states that the last call gave."""
        at, r, field = self.at, self.at.plant.n_task, self.at.field
        found = [(at.joint_angles, at.plant.graph.posture)]
        found += [(position(at, "measured_point", "end-point r, measured"), ca.SX.sym("r", r)),
                  (speed(at, "measured_rate", "its rate, measured"), ca.SX.sym("r_rate", r)),
                  (position(at, "target_point", "where the end-point shall be"), ca.SX.sym("target", r)),
                  (speed(at, "target_rate", "its rate"), ca.SX.sym("target_rate", r))]  # fmt: skip
        if self.loop.filter_hz is not None:
            text = "as the last call gave it, at first as measured"
            found += [(position(at, "filtered_point", f"filtered end-point, {text}"), ca.SX.sym("kept", r)),
                      (speed(at, "filtered_rate", f"its rate, {text}"), ca.SX.sym("kept_rate", r))]  # fmt: skip
        if self.integral:
            size = float(max(self.loop.kp)) or 1.0
            about = field("integral", "TASK", self.force_unit, "part of f, as the last call gave it, at first 0",
                          low=-GAIN_MAX, high=GAIN_MAX, sample=(-0.1 * size, 0.1 * size))  # fmt: skip
            found.append((about, ca.SX.sym("i", r)))
        if self.damped:
            of_joints = unit_list(at.machine.joint_units, "{}/s")
            found.append((field("joint_rates", "JOINTS", of_joints, "rates of the actuated joints, measured",
                                low=-RATE_MAX, high=RATE_MAX, sample=(-0.5, 0.5)),
                          ca.SX.sym("rates", at.plant.n_actuated)))  # fmt: skip
        return found

    def outputs(self, of: Mapping[str, ca.SX]) -> list[tuple[Field, ca.SX, ca.SX]]:
        """What joints are asked for, and the states of the next call, each with a bound of its terms."""
        at, loop, field, units = self.at, self.loop, self.at.field, self.at.machine.joint_units
        plant, g, period = at.plant, at.plant.graph, 1 / loop.rate
        point, rate, found = of["measured_point"], of["measured_rate"], list[tuple[Field, ca.SX, ca.SX]]()
        if loop.filter_hz is not None:
            corner = ca.SX(2 * ca.pi * loop.filter_hz)
            for name, unit, now in (("point", "m", point), ("rate", "m/s", rate)):
                before = of[f"filtered_{name}"]
                next_one = low_pass(now, before, corner, period)
                point, rate = (next_one, rate) if name == "point" else (point, next_one)
                about = field(f"next_filtered_{name}", "TASK", unit, f"filtered_{name} of the next call",
                              scale=f"|measured_{name}| + |filtered_{name}|")  # fmt: skip
                found.append((about, next_one, ca.norm_2(now) + ca.norm_2(before)))
        law = FeedbackLaw("pid" if self.integral else "pd", plant.n_task, 0, sampled=True)
        gains = {name: ca.SX(getattr(loop, name)) for name in ("kp", "kv", "ki")} | {"integral_limit": ca.SX(GAIN_MAX)}
        e, e_rate, states = of["target_point"] - point, of["target_rate"] - rate, of.get("integral", ca.SX(0, 1))
        force = law.force(e, e_rate, states, gains)
        # Of the measured numbers themselves: differences of large ones have lost the digits that these had.
        far = ca.norm_2(of["target_point"]) + ca.norm_2(of["measured_point"]) + ca.norm_2(point)
        fast = ca.norm_2(of["target_rate"]) + ca.norm_2(of["measured_rate"]) + ca.norm_2(rate)
        largest = {name: float(max(getattr(loop, name))) for name in ("kp", "kv", "ki")}
        size = largest["kp"] * far + largest["kv"] * fast + ca.norm_2(states)
        if self.integral:
            about = field("next_integral", "TASK", self.force_unit, "integral of the next call",
                          scale="|integral| + Ki T (|target_point| + |measured_point|)")  # fmt: skip
            found.append((about, law.successor(e, states, ca.SX(period), gains),
                          ca.norm_2(states) + largest["ki"] * period * far))  # fmt: skip
        jv = plant.rigid_jacobian(plant.rest(g.base, g.posture, g.p), g.base, g.p)
        asked = joint_torque(jv, force, loop.control)
        size = ca.norm_fro(task_to_joints(jv, loop.control, ca.SX.eye(plant.n_task))) * size
        if self.damped:
            damping = loop.nullspace_damping / ((loop.servo_gain or 1.0) if self.served else 1.0)
            asked += nullspace_torque(jv, of["joint_rates"], ca.SX(damping))
            size += damping * ca.norm_2(of["joint_rates"])
        if not self.served and loop.torque_limit is not None:
            limit = ca.SX(loop.torque_limit)
            asked = ca.fmax(-limit, ca.fmin(limit, asked))
        scale = "|J| (Kp (|target_point| + |measured_point|) + Kv (|target_rate| + |measured_rate|) + |integral|)"
        name, unit, text = ("joint_rate_command", unit_list(units, "{}/s"), "rates to ask the drives for") \
            if self.served else ("torque", torque_unit(at), "of the actuated joints")  # fmt: skip
        return [(field(name, "JOINTS", unit, text, scale=scale), asked, size), *found]


def loop_step(at: Context) -> tuple[Operation, ...]:
    """The controller of the loop; none where none was given."""
    if at.loop is None:
        return ()
    law = _Law(at, at.loop)
    inputs = law.inputs()
    outputs = law.outputs({field.name: symbol for field, symbol in inputs})
    guards = [(at.regular(), sine_squared(at))] if at.loop.control == "inverse" else []
    return (at.operation("loop_step", _about(at.loop, law), inputs, outputs, guards),)


def _about(loop: LoopSettings, law: _Law) -> str:
    method = control_method(loop.control)
    matrix = {"transpose": "Jv^T", "inverse": "Jv^+"}.get(method, "Jv^T (Jv Jv^T + lambda^2 I)^-1")
    asked = "joint_rate_command" if law.served else "torque"
    integral = " + integral" if law.integral else ""
    text = (
        f"One sample of the controller of [loop], to be called {loop.rate:g} times a second: {asked} = {matrix} f with "
        f"f = Kp (target_point - measured_point) + Kv (target_rate - measured_rate){integral}, Kp {_listed(loop.kp)}, "
        f"Kv {_listed(loop.kv)}"
    )
    if law.integral:
        text += f"; integral advances by Ki (target_point - measured_point) / {loop.rate:g}, Ki {_listed(loop.ki)}"
    if loop.filter_hz is not None:
        text += f"; measurements run through a low-pass of first order with the corner {loop.filter_hz:g} Hz before"
    if law.damped:
        text += f"; a damper on the self-motion is added, {loop.nullspace_damping:g} {loop.damping_unit}"
        text += f", divided by the drives' servo gain, {loop.servo_gain:g} {loop.damping_unit}" if law.served else ""
    if not law.served and loop.torque_limit is not None:
        text += f"; torques within {_listed(loop.torque_limit)}, not counting what is added to carry the arm's weight"
    wait = f"for a dead time of {loop.dead_time:g} s" if loop.dead_time else "without dead time"
    late = "the damper among them" if law.damped else "which Jv asks for"
    text += (
        ". These numbers are constants of the code. Jv at the measured joints, passive coordinates at rest. Its "
        f"margins hold {wait} from the end-point's measurement to the command; joints, {late}, are measured without. "
        "It keeps no state"
    )
    text += (
        ": what is called next_ is handed in at the next call." if law.keeps else ", and needs none of the last call."
    )
    text += "" if law.served else WEIGHT
    if loop.lets_drift:
        text += (
            " The arm has more joints than task rows, and nothing here brakes its self-motion, which may drift: "
            "nullspace_damping of [loop] does."
        )
    return text


def _listed(values: Any) -> str:
    """One number where all are the same."""
    listed = [f"{x:.6g}" for x in values]
    return listed[0] if len(set(listed)) == 1 else f"[{', '.join(listed)}]"
