"""What of a machine is to be identified: names to entries of p, and what a factor of each one multiplies.

In: a machine, names as of `flexopt.Uncertainty`. Out: entries of p and their reference values, or faults.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Vector
from flexopt.foundation.nearest import hint_or_list
from flexopt.foundation.quantities import several
from flexopt.model import AnyMachine
from flexopt.model.uncertainty import DAMPERS, LATE, SPRINGS, parameters_of
from flexopt.plant import build_plant

UNKNOWN_MAX = 40
# Where the file has no damping, or no load: this damping ratio of the coordinate alone, this share of the mass.
DAMPING, LOAD = 0.02, 0.01


def read_unknown(arguments: Arguments, machine: AnyMachine, field: str, value: Any) -> tuple[str, ...] | None:
    """Names of parameters of the machine; faults are noted."""
    given: Any = arguments.checked(field, value, lambda v: v, None)
    words = several(given) if given is not None else []
    if not words or not all(isinstance(word, str) and 0 < len(word) <= 200 for word in words):
        if not arguments.faulty(field):
            arguments.note(field, "must be names of parameters, 'stiffness' or 'damping'", value)
        return None
    found = list[str]()
    for word in words:
        entries = parameters_of((word,), machine)
        if word == LATE:
            arguments.note(field, "cannot be seen in a free swing, which has no loop; take it from a step", word)
        elif not entries:
            names = [SPRINGS, DAMPERS, *(parameter.name for parameter in machine.parameters)]
            arguments.note(field, f"{machine.name} has none such{hint_or_list(word, names, most=8)}", word)
        several_meant = len(entries) > 1
        for i in entries:
            parameter = machine.parameters[i]
            if parameter.name in found or (several_meant and i not in _references(machine)):
                continue
            if i not in _references(machine):
                arguments.note(field, f"is {parameter.value:g}: a factor of it cannot be identified", parameter.name)
            found.append(parameter.name)
    if len(found) > UNKNOWN_MAX:
        arguments.note(field, f"must be at most {UNKNOWN_MAX} parameters", str(len(found)))
    return tuple(found)


def references(machine: AnyMachine, names: Sequence[str]) -> tuple[tuple[int, ...], Vector]:
    """Entries of p, and what factors of them multiply."""
    at = {parameter.name: i for i, parameter in enumerate(machine.parameters)}
    entries = tuple(at[name] for name in names)
    known = _references(machine)
    return entries, np.array([known[i] for i in entries])


def _references(machine: AnyMachine) -> dict[int, float]:
    """Of every parameter that a factor of can be identified, what is multiplied: its own value, or a usual one."""
    plant, at = build_plant(machine), {parameter.name: i for i, parameter in enumerate(machine.parameters)}
    found = {i: parameter.value for i, parameter in enumerate(machine.parameters) if parameter.value}
    p = plant.parameter_values
    posture = [0.5 * (max(low, -1.0) + min(high, 1.0)) for low, high in machine.limits]
    q = plant.rest.call([ca.DM.zeros(plant.n_base), ca.DM(posture), p])[0]
    mass = plant.mass.call([q, ca.DM.zeros(plant.n_base), p])[0].full()
    springs, entries = plant.stiffness.call([p])[0].full(), machine.kinematic_tree.entries
    order = {body.joint.name: i for i, body in enumerate(machine.kinematic_tree.bodies)}
    for k, coordinate in enumerate(machine.coordinates[: plant.n_passive]):
        i = order[coordinate]
        damper = at.get(entries.get(f"damping{i}.{i}", ""))
        if damper is not None and damper not in found:
            found[damper] = 2.0 * DAMPING * math.sqrt(springs[k, k] * mass[k, k])
    load = at.get(entries.get("payload", ""))
    if load is not None and load not in found:
        bodies = {f"mass{i}" for i in range(len(machine.kinematic_tree.bodies))}
        found[load] = LOAD * sum(machine.parameters[at[entries[key]]].value for key in bodies & set(entries))
    return found
