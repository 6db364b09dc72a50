"""Postures beyond the limits of a machine's file: which joints they are of, and the machine with limits that hold them.

In: a machine and postures. Out: sentences; a machine. Choices that leave limits out find such postures; calls with a
posture of the user's own refuse them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arrays import Vector
from flexopt.foundation.plain import listed
from flexopt.foundation.rounding import apart
from flexopt.model.machine import AnyMachine

# Less beyond an end, rad or m, is what climbs leave.
CLIMBED_BEYOND = 1e-6


def beyond_limits(machine: AnyMachine, posture: Vector) -> list[str]:
    """Each joint that a posture (n,) holds beyond its limits or its cylinder's stroke, with what these allow."""
    each = zip(machine.joints, machine.joint_units, posture.tolist(), machine.limits, strict=True)
    return [
        f"{name} at {number(q)} {unit} ({number(low)} to {number(high)} {unit})"
        for name, unit, q, (low, high) in each
        if _beyond(q, low, high) > CLIMBED_BEYOND
        for number in [apart(q, (low, high))]
    ]


def beyond_limits_told(machine: AnyMachine, where: str, postures: Sequence[Vector]) -> str:
    """That a place, `where`, holds joints so at its targets, a sentence; empty where none is."""
    found = [beyond_limits(machine, posture) for posture in postures]
    each = [
        f"{listed(joints)}{f' at target {k}' if len(found) > 1 else ''}"
        for k, joints in enumerate(found, start=1)
        if joints
    ]
    beyond = "beyond the limits of the machine's file, which are left out (assume)"
    return f"{where} holds {'; '.join(each)}, {beyond}" if each else ""


def most_beyond(machine: AnyMachine, posture: Vector) -> dict[str, float]:
    """How far a posture (n,) is beyond the nearer limit or end of stroke, rad or m, by joint; empty where none is."""
    each = zip(machine.joints, posture.tolist(), machine.limits, strict=True)
    found = {name: _beyond(q, low, high) for name, q, (low, high) in each}
    return {name: max(by, 0.0) for name, by in found.items()} if max(found.values()) > CLIMBED_BEYOND else {}


def holding(machine: AnyMachine, posture: Vector) -> AnyMachine:
    """The machine with limits and strokes as far as a posture (n,) is beyond them; itself where it is within.

    Raises:
        InputError: a linkage does not close there, or leaves its joint no lever arm before.
    """
    ends = np.array(machine.limits)
    outside = {
        name: q
        for name, q, (low, high) in zip(machine.joints, posture.tolist(), ends.tolist(), strict=True)
        if not low <= q <= high
    }
    if not outside:
        return machine
    told = machine.model_dump(by_alias=True)
    for table in _joint_tables(told):
        if table.get("limits") and table["name"] in outside:
            table["limits"] = _wider(table["limits"], outside[table["name"]])
    for table, cylinder in zip(told["cylinders"], machine.cylinders, strict=True):
        if cylinder.joint in outside:
            table["length"] = _wider(table["length"], machine.travel(cylinder).length(outside[cylinder.joint]))
    wider = type(machine)(**told)
    faults = [
        Fault(name, f"no stroke holds it at {q:.4g} {unit}{wider.beyond_stroke(name, q) or ', beyond a dead centre'}")
        for name, unit, q, ends in zip(machine.joints, machine.joint_units, posture.tolist(), wider.limits, strict=True)
        if _beyond(q, *ends) > CLIMBED_BEYOND
    ]
    raise_if_any(InputError, machine.name, faults)
    return wider


def _beyond(q: float, low: float, high: float) -> float:
    """How far it is beyond the nearer end, negative within."""
    return max(low - q, q - high)


def _joint_tables(told: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Where a description holds its joints."""
    return told["links"] if "links" in told else [body["joint"] for body in told["bodies"]]


def _wider(ends: Sequence[float], value: float) -> list[float]:
    return [min(ends[0], value), max(ends[1], value)]
