"""What a master may set besides the machine's parameters: posture, start, controller, sensors, actuators.

In: a `Scenario` and the structure of the FMU's loop. Out: groups of variables, named as the loop's constants where they
become such.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from flexopt.export.fmu.variable import EFFORT, Variable, force_unit, one_unit
from flexopt.foundation.control import damping_unit, gain_units
from flexopt.foundation.quantities import JOINT_DAMPING, coordinate_max
from flexopt.loop.structure import LoopStructure
from flexopt.model.loop import BANDWIDTH, LOOP_GAIN, SERVO_GAIN, TORQUE
from flexopt.model.simulation import NOISE, RATE_NOISE
from flexopt.simulation.scenario import Scenario

Groups = dict[str, list[Variable]]


def settings(scenario: Scenario, structure: LoopStructure) -> Groups:
    """Entries of a after the machine's parameters but those of the placement."""
    return (
        _start(scenario)
        | _controller(scenario, structure)
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


def _controller(scenario: Scenario, structure: LoopStructure) -> Groups:
    options, machine, found = scenario.options, scenario.machine, Groups()
    rows, joints = machine.task_rows, machine.joint_units
    names = (("kp", "proportional"), ("kv", "derivative"), ("ki", "integral"))
    told = zip(names, gain_units(options.control, joints), strict=True)
    for (name, text), units in list(told)[: {"pd": 2, "pid": 3}.get(structure.law, 0)]:
        unit, more = one_unit(units)
        found[name] = [
            Variable(f"controller.{name}.{row}", unit, f"{text} gain, axis {row}{more}", value, *LOOP_GAIN.range, True)
            for row, value in zip(rows, spread(getattr(options, name), len(rows)), strict=True)
        ]
    if structure.law == "pid":
        unit, more = one_unit(force_unit(options.control, joints))
        text, limit = f"largest integral part of the force, each axis{more}", options.integral_limit
        found["integral_limit"] = [Variable("controller.integral_limit", unit, text, limit, *LOOP_GAIN.range, True)]
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
        text = f"torque or force of a joint rate behind the levers{more}"
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
