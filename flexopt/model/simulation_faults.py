"""What does not fit together in the options of a simulation, or not its machine."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from pydantic import BaseModel

from flexopt.errors import Fault
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.coordinates import check_task
from flexopt.foundation.quantities import milliseconds_hint
from flexopt.model.loop import DELAY_MAX, KP, Loop, length_faults, loop_faults
from flexopt.model.machine import AnyMachine
from flexopt.model.simulation import (
    PART_OF_SAMPLE,
    SAMPLES_MAX,
    Experiment,
    Path,
    Sensor,
    SimulationOptions,
    shape_faults,
)

# Options of a run that a loop brings itself, and which of its tables'.
BROUGHT = ("feedback", "kp", "kv", "ki", "rate", "hold", "nullspace_damping", "gain")
BROUGHT_BY_TABLES = {
    "sensor": ("delay", "filter_hz"),
    "actuator": ("torque_limit", "rate_limit", "bandwidth_hz", "levers", "servo_gain"),
}


def simulation_faults(options: SimulationOptions, machine: AnyMachine) -> list[Fault]:
    """What does not fit together, or not this machine."""
    found = _posture_faults(options, machine) + _controller_faults(options, machine) + _time_faults(options)
    for name, path, names in (
        ("base_path", options.base_path, machine.base_coordinates),
        ("target_path", options.target_path, machine.task_rows),
    ):
        found += [] if path is None else _path_faults(path, name, names)
    return found


def _posture_faults(options: SimulationOptions, machine: AnyMachine) -> list[Fault]:
    n, rows, noted = len(machine.joints), machine.task_rows, Arguments("")
    if (options.posture is None) == (options.end_point is None):
        noted.faults.append(Fault("posture, end_point", "give one of the two"))
    if options.end_point is not None:
        point = list(options.end_point)
        noted.checked("end_point", point, lambda v: check_task(v, rows), ())
        if n > len(rows):
            sentence = (
                f"does not name one posture of {n} actuated joints; give the posture: `flexopt select` finds some"
            )
            noted.faults.append(Fault("end_point", sentence, str(point)))
    if options.posture is not None:
        noted.posture(machine, list(options.posture))
    if options.offset is not None:
        noted.displacement(machine, list(options.offset), "offset")
    if options.base is not None:
        noted.base(machine, list(options.base))
    return noted.faults


def _controller_faults(options: SimulationOptions, machine: AnyMachine) -> list[Fault]:
    found = length_faults(options, machine) + length_faults(options.actuator, machine, "actuator.")
    if options.actuator.rate_limit is not None and options.actuator.bandwidth_hz is None:
        sentence = "needs actuator.bandwidth_hz: it limits how fast the servo's torque changes"
        found.append(Fault("actuator.rate_limit", sentence))
    if options.feedback != "pid":
        for name, value, unused in (
            ("ki", list(options.ki), any(options.ki)),
            ("integral_limit", f"{options.integral_limit:g}", options.integral_limit < KP.high),
        ):
            found += [Fault(name, 'goes with feedback = "pid"', str(value))] * unused
    return found + _lever_faults(options, machine)


def _lever_faults(options: SimulationOptions, machine: AnyMachine) -> list[Fault]:
    if options.actuator.levers is None:
        return []
    found: list[Fault] = []
    if options.control == "transpose":
        sentence = 'set joint rates, and Jacobian transpose control asks for torques; use control = "inverse"'
        found.append(Fault("actuator.levers", sentence, repr(options.actuator.levers)))
    missing = machine.joints_without_speed
    if missing:
        sentence = f"need a cylinder or a speed of every joint; {machine.name} has none for {', '.join(missing)}"
        found.append(Fault("actuator.levers", sentence, repr(options.actuator.levers)))
    return found


def _time_faults(options: SimulationOptions) -> list[Fault]:
    found: list[Fault] = []
    samples, waits = options.duration * options.rate, options.sensor.delay * options.rate
    if not 0.5 <= samples <= SAMPLES_MAX:
        sentence = f"must give between 1 and {SAMPLES_MAX} samples"
        sentence += "; is the rate the period in s?" if samples < 1 and options.rate < 1 else ""
        found.append(Fault("duration, rate", sentence, f"{options.duration:g} s at {options.rate:g} Hz, {samples:g}"))
    if waits > DELAY_MAX + PART_OF_SAMPLE:
        hint = milliseconds_hint(options.sensor.delay)
        sentence = f"must be at most {DELAY_MAX} samples of {1 / options.rate:g} s{hint}"
        found.append(Fault("sensor.delay", sentence, f"{options.sensor.delay:g}"))
    if not options.hold and options.sensor != Sensor():
        sentence = "noise, resolution, delay and filter belong to a sampled controller: give hold = true"
        found.append(Fault("sensor", sentence))
    return found


def _path_faults(path: Path, name: str, names: tuple[str, ...]) -> list[Fault]:
    """What does not fit together; `names` of a point's coordinates."""
    found = shape_faults(path, f"{name}.")
    if not names:
        found.append(Fault(name, "has nothing to move: the machine has no placement coordinates"))
    elif any(len(point) != len(names) for point in path.points):
        sentence = f"must have {len(names)} coordinates each, in m or rad: {', '.join(names)}"
        found.append(Fault(f"{name}.points", sentence))
    return found


def brought_twice(given: Mapping[str, Any]) -> list[Fault]:
    """Options of a run that its `[loop]` brings itself."""
    sentence = "a loop is given, which says this itself: give it there, or leave the loop out"
    found = [Fault(name, sentence) for name in BROUGHT if given.get(name) is not None]
    for table, names in BROUGHT_BY_TABLES.items():
        own = table_entries(given.get(table))
        found += [Fault(f"{table}.{name}", sentence) for name in names if name in own]
    return found


def own_loop(machine: AnyMachine, given: Mapping[str, Any]) -> Loop | None:
    """The machine's own `[loop]`, where no option of a run says of the loop; else None."""
    return None if brought_twice(given) else machine.loop


def loop_of_runs(experiment: Experiment) -> Loop | None:
    """The `[loop]` of an experiment's runs: its own, or its machine's; None where its options say of the loop."""
    options = experiment.simulation
    given = {name: getattr(options, name) for name in options.model_fields_set}
    return experiment.loop or own_loop(experiment.loaded_machine, given)


def table_entries(table: Any) -> dict[str, Any]:
    """What a call gives of a table."""
    if isinstance(table, BaseModel):
        return table.model_dump(exclude_unset=True)
    return dict(cast("Mapping[str, Any]", table)) if isinstance(table, Mapping) else {}


def experiment_faults(experiment: Experiment, machine: AnyMachine) -> list[Fault]:
    """What does not go together in an experiment's file, or not with its machine."""
    options, found = experiment.simulation, simulation_faults(experiment.simulation, machine)
    if experiment.loop is not None:
        found += brought_twice({name: getattr(options, name) for name in options.model_fields_set})
    found = [Fault(f"simulation.{fault.field}", fault.sentence, fault.value) for fault in found]
    return found if experiment.loop is None else found + loop_faults(experiment.loop, machine, "loop.")
