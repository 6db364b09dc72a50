"""The real controller in nonlinear runs: from a loop's numbers to options of `flexopt.simulate`.

In: a machine and `LoopSettings`. Out: options of a run, and what drives that serve rates brake the joints by.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np

from flexopt.errors import NoSolutionFound
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Vector
from flexopt.loop.evaluation import settings_at
from flexopt.loop.settings import LoopSettings
from flexopt.model import AnyMachine
from flexopt.model.loop import Loop
from flexopt.model.parameter_values import with_parameters
from flexopt.model.simulation_faults import BROUGHT_BY_TABLES, brought_twice, table_entries
from flexopt.simulation.scenario import checked_options, design_configuration

T = TypeVar("T")
# Integration steps in a sample where those that the fastest mode needs are too long.
SHORTER = (8, 64)


def run_options(machine: AnyMachine, settings: LoopSettings) -> dict[str, Any]:
    """Options of `flexopt.simulate` for this loop; see `braked_by`.

    Exact between the samples: by Gauss's method, which adds no damping.
    """
    s = settings
    # A servo gain makes torques of the rates that are asked for.
    gain = s.braking or 1.0
    actuator: dict[str, Any] = {} if s.bandwidth_hz is None else {"bandwidth_hz": s.bandwidth_hz.tolist()}
    limits = {"torque_limit": s.torque_limit, "rate_limit": s.rate_limit}
    actuator |= {name: limit.tolist() for name, limit in limits.items() if limit is not None}
    if s.drive == "velocity" and not machine.joints_without_speed:
        actuator |= {"levers": "each", "servo_gain": s.servo_gain}
    sensor: dict[str, Any] = {"delay": s.dead_time} | ({} if s.filter_hz is None else {"filter_hz": s.filter_hz})
    gains = {"kp": (gain * s.kp).tolist(), "kv": (gain * s.kv).tolist(), "ki": (gain * s.ki).tolist()}
    return gains | {
        "control": s.control, "feedback": s.feedback, "rate": s.rate, "sensor": sensor, "actuator": actuator,
        "nullspace_damping": s.nullspace_damping, "integrator": "gauss",
    }  # fmt: skip


def braked_by(machine: AnyMachine, settings: LoopSettings, *, gravity: bool) -> Vector:
    """What the joints' damping is more by, of the machine's p (n_par,): drives that serve rates brake their joints."""
    found: Vector = settings.motions(machine, gravity=gravity).drive_damping * settings.braking
    return found


def braked(machine: AnyMachine, by: Vector) -> AnyMachine:
    """The machine with so much more in its p (n_par,), see `braked_by`."""
    if not by.any():
        return machine
    own = zip(machine.parameters, by.tolist(), strict=True)
    return with_parameters(machine, {each.name: each.value + more for each, more in own if more})


def note_loop(arguments: Arguments, given: Mapping[str, Any]) -> None:
    """Note options of a call that its loop brings itself."""
    if given["loop"] is not None:
        arguments.faults += brought_twice(given)


def in_shorter_steps(run: Callable[[dict[str, Any]], T], given: dict[str, Any], real: Loop | None) -> T:
    """A run of these options; of a real loop in shorter steps where those for the modes are too long.

    Drives that serve rates brake joints so much that this may be.
    """
    own_steps = real is None or given.get("substeps") is not None
    *first, last = [{}] if own_steps else [{}, *({"substeps": steps} for steps in SHORTER)]
    for more in first:
        try:
            return run(given | more)
        except NoSolutionFound:
            continue
    return run(given | last)


def with_loop(
    machine: AnyMachine, loop: Loop, given: Mapping[str, Any], call: str
) -> tuple[AnyMachine, dict[str, Any], LoopSettings]:
    """The machine as its drives brake it, the options of a call with those of a loop, the loop's numbers."""
    told = {name: value for name, value in given.items() if value is not None}
    options = checked_options(call, machine, told)
    posture, base = (np.array(each) for each in design_configuration(machine, options))
    control = options.control if "control" in told else None
    settings, _ = settings_at(machine, posture, base, control, loop, gravity=options.gravity, call=call)
    brought = run_options(machine, settings)
    more = {name: brought[name] | table_entries(told.get(name)) for name in BROUGHT_BY_TABLES}
    machine = braked(machine, braked_by(machine, settings, gravity=options.gravity))
    return machine, brought | told | more, settings
