"""What a master may set besides the machine's parameters: posture, start, controller, sensors, actuators.

In: a `Scenario`, the structure of the FMU's loop, what drives serve. Out: groups of variables, named as the loop's
constants where they become such.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flexopt.export.fmu.variable import EFFORT, Variable, force_unit, one_unit
from flexopt.foundation.control import damping_unit, gain_units
from flexopt.foundation.quantities import JOINT_DAMPING, coordinate_max
from flexopt.loop.settings import LoopSettings
from flexopt.loop.structure import LoopStructure
from flexopt.model.loop import BANDWIDTH, KP, SERVO_GAIN, TORQUE
from flexopt.model.simulation import NOISE, RATE_NOISE
from flexopt.simulation.scenario import Scenario

Groups = dict[str, list[Variable]]


@dataclass(frozen=True)
class Served:
    """What an FMU of a velocity-served loop says: its loop is written in torques, without servos.

    Attributes:
        settings: the loop.
        braked: parameters that hold the servos' braking besides the joints' own damping, by name the latter.
    """

    settings: LoopSettings
    braked: Mapping[str, float]

    @property
    def servo_gain(self) -> str:
        """With its unit."""
        return f"{self.settings.servo_gain or 1.0:.6g} {self.settings.damping_unit}"

    @property
    def gains(self) -> str:
        """The gains that ask for rates, with their units, of each axis where they differ."""
        names = ("kp", "kv", "ki") if self.settings.feedback == "pid" else ("kp", "kv")
        told: list[str] = []
        for name, unit in zip(names, self.settings.gain_units, strict=False):
            values = [f"{value:.6g}" for value in getattr(self.settings, name).tolist()]
            numbers = values[0] if len(set(values)) == 1 else f"({', '.join(values)})"
            told.append(f"{name.capitalize()} {numbers} {unit}".rstrip())
        return ", ".join(told)

    @property
    def sentence(self) -> str:
        """What kind of loop it is."""
        return f"joints are velocity-served: {self.gains}, servo gain {self.servo_gain}"

    def of_parameter(self, name: str) -> str:
        """What the description of a machine's parameter adds."""
        if name not in self.braked:
            return ""
        own = f"{self.braked[name]:g} of it is the joint's own, whatever is set, and the rest the servo's braking"
        return f"; {own}: {self.servo_gain}"


def settings(scenario: Scenario, structure: LoopStructure, served: Served | None = None) -> Groups:
    """Entries of a after the machine's parameters but those of the placement."""
    return (
        _start(scenario)
        | _controller(scenario, structure, served)
        | _sensor(scenario, structure)
        | _actuator(scenario, structure)
    )


def _start(scenario: Scenario) -> Groups:
    machine, what = scenario.machine, {"rad": "angle", "m": "displacement"}
    joints = list(zip(machine.joints, machine.joint_units, strict=True))
    limits = [(coordinate_max(unit), low, high) for (_, unit), (low, high) in zip(joints, machine.limits, strict=True)]
    posture = [
        Variable(f"posture.{joint}", unit, f"{joint}: {what[unit]} about which the controller works", value,
                 max(low, -most), min(high, most))
        for (joint, unit), value, (most, low, high) in zip(joints, scenario.posture.tolist(), limits, strict=True)
    ]  # fmt: skip
    offset = [
        Variable(f"start_offset.{joint}", unit, f"{joint}: displacement at the start", value, -most, most)
        for (joint, unit), value, (most, _, _) in zip(joints, scenario.offset.tolist(), limits, strict=True)
    ]
    return {"posture": posture, "offset": offset}


def _controller(scenario: Scenario, structure: LoopStructure, served: Served | None) -> Groups:
    options, machine, found = scenario.options, scenario.machine, Groups()
    rows, joints = machine.task_rows, machine.joint_units
    names = (("kp", "proportional"), ("kv", "derivative"), ("ki", "integral"))
    told = zip(names, gain_units(options.control, joints), strict=True)
    for (name, text), units in list(told)[: {"pd": 2, "pid": 3}.get(structure.law, 0)]:
        unit, more = one_unit(units)
        more += f"; servo gain times {name.capitalize()} of the velocity-served loop" if served else ""
        found[name] = [
            Variable(f"controller.{name}.{row}", unit, f"{text} gain, axis {row}{more}", value, *KP.range, True)
            for row, value in zip(rows, spread(getattr(options, name), len(rows)), strict=True)
        ]
    if structure.law == "pid":
        unit, more = one_unit(force_unit(options.control, joints))
        text, limit = f"largest integral part of the force, each axis{more}", options.integral_limit
        found["integral_limit"] = [Variable("controller.integral_limit", unit, text, limit, *KP.range, True)]
    if structure.nullspace_damped:
        unit, more = one_unit(damping_unit(joints))
        text, value = f"damping of the arm's self-motion{more}", options.nullspace_damping
        found["nullspace_damping"] = [
            Variable("controller.nullspace_damping", unit, text, value, *JOINT_DAMPING.range, True)
        ]
    return found


def _sensor(scenario: Scenario, structure: LoopStructure) -> Groups:
    found = Groups()
    for name, quantity, what in (("resolution", NOISE, "position"), ("rate_resolution", RATE_NOISE, "rate")):
        if structure.quantised:
            text = f"step to which the measured {what} is rounded; 0: not rounded"
            value = float(getattr(scenario.options.sensor, name))
            found[name] = [Variable(f"sensor.{name}", quantity.unit, text, value, *quantity.range, True)]
    corner = scenario.options.sensor.filter_hz
    if corner is not None:
        text = "corner of the low-pass that the measurement runs through"
        found["filter_hz"] = [Variable("sensor.filter", "Hz", text, corner, *BANDWIDTH.range, True)]
    return found


def _actuator(scenario: Scenario, structure: LoopStructure) -> Groups:
    actuator, machine, found = scenario.options.actuator, scenario.machine, Groups()
    for name, per, text in (
        ("torque_limit", "", "largest {} asked for"),
        ("dead_band", "", "command below which nothing happens"),
        ("rate_limit", "/s", "largest rate of the {}"),
    ):
        values = getattr(actuator, name)
        if values is not None:
            found[name] = [
                Variable(f"actuator.{name}.{joint}", f"{EFFORT[unit][1]}{per}",
                         f"{joint}: {text.format(EFFORT[unit][0])}", value, *TORQUE.range, True)
                for joint, unit, value in _of_joints(machine.joints, machine.joint_units, values)
            ]  # fmt: skip
    if structure.hydraulic is not None:
        unit, more = one_unit(damping_unit(machine.joint_units))
        text = f"limit of the command: this times a joint's rate at full lever; no gain of the loop{more}"
        found["servo_gain"] = [
            Variable("actuator.servo_gain", unit, text, actuator.servo_gain, 1e-9, SERVO_GAIN.high, True)
        ]
    if actuator.bandwidth_hz is not None:
        found["bandwidth_hz"] = [
            Variable(
                f"actuator.bandwidth.{joint}", "Hz", f"{joint}: bandwidth of the servo", value, *BANDWIDTH.range, True
            )
            for joint, _, value in _of_joints(machine.joints, machine.joint_units, actuator.bandwidth_hz)
        ]
    return found


def _of_joints(joints: Sequence[str], units: Sequence[str], values: Any) -> list[tuple[str, str, float]]:
    return list(zip(joints, units, spread(values, len(joints)), strict=True))


def spread(values: Sequence[float], count: int) -> list[float]:
    """One number for each of `count`, from one for all or one for each."""
    return [float(value) for value in (tuple(values) * count if len(values) == 1 else values)]
