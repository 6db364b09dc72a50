"""What a run takes of the machine beyond what its file says it can: joint limits, efforts and speeds.

In: a run's joints, their rates and torques; its limits and the weight at rest. Out: a sentence. No end stop is
modelled, and drives saturate only where the run's options say so.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from flexopt.compiled.threaded import Interpreter
from flexopt.foundation.arrays import Vector
from flexopt.foundation.control import limit_unit
from flexopt.foundation.kept import by_structure
from flexopt.model import AnyMachine
from flexopt.plant.hydraulics import build_hydraulics

# Beyond is what is so by more than rounding, of the larger end of a range.
ROUNDING = 1e-9
NOT_HELD = "the arm is not held"


def limit_below(machine: AnyMachine, weight: Vector, limit: ArrayLike, name: str, band: ArrayLike | None = None) -> str:
    """That drives (n,) give less than what holds the arm at rest (n,), in words; empty where none does.

    `limit`: of the command, called `name`;  `band`: the dead band by which drives give less than that, if any.
    """
    most = np.broadcast_to(np.asarray(limit, dtype=np.float64), weight.shape)
    gives = most if band is None else np.maximum(0.0, most - np.asarray(band, dtype=np.float64))
    short = np.abs(weight) - gives
    if short.max() <= 0:
        return ""
    # That of which the least share is borne, and of alike ones that which lacks the most.
    k = max(np.flatnonzero(short > 0).tolist(), key=lambda i: (-gives[i] / abs(weight[i]), short[i]))
    unit, less = limit_unit([machine.joint_units[k]]), " less the dead band" * (band is not None)
    bears = f"{machine.joints[k]} bears {abs(weight[k]):.4g} {unit} at rest, and {name}{less} gives it"
    return f"{NOT_HELD}: {bears} {gives[k]:.4g} {unit}"


def beyond_the_machine(
    machine: AnyMachine, joints: Vector, rates: Vector, torques: Vector, remedy: str
) -> tuple[str, ...]:
    """Which joints and cylinders go beyond limits, efforts or speeds, and how far, in a sentence; none where none does.

    Args:
        machine: of the run.
        joints, rates, torques: at each sample, (n, K).
        remedy: the option that lets drives saturate; empty where it is given.
    """
    speeds = np.array(machine.speeds)
    reached = _farthest(joints, *np.array(machine.limits).T[:, :, None])
    taken = _farthest(torques, *np.moveaxis(_efforts(machine, joints), -1, 0))
    moved = _farthest(rates, -speeds[:, None], speeds[:, None])
    told = list[str]()
    for i, (joint, unit) in enumerate(zip(machine.joints, machine.joint_units, strict=True)):
        found = [f"came to {value:.4g} {unit} (limit {end:.4g})" for value, end in reached[i]]
        force = "N m" if unit == "rad" else "N"
        found += [f"took up to {abs(value):.4g} {force} (effort {abs(end):.4g})" for value, end in taken[i]]
        found += [f"moved at up to {abs(value):.4g} {unit}/s (speed {abs(end):.4g})" for value, end in moved[i]]
        told += [f"{joint} {' and '.join(found)}"] * bool(found)
    for cylinder, found in zip(machine.cylinders, _farthest(*_cylinder_rates(machine, joints, rates)), strict=True):
        told += [f"{cylinder.name} moved at up to {abs(v):.4g} m/s (speed {abs(end):.4g})" for v, end in found]
    if not told:
        return ()
    hint = f"; {remedy} lets drives saturate" if remedy and any(taken) else ""
    return (f"nothing in this run holds a joint within its limits, or a drive: {', '.join(told)}{hint}",)


def _farthest(values: Vector, least: Vector, most: Vector) -> list[list[tuple[float, float]]]:
    """Of each row (n, K) the value that is farthest outside its range, and the end that it passed; none inside."""
    least, most = np.broadcast_to(least, values.shape), np.broadcast_to(most, values.shape)
    size = np.maximum(*(np.where(np.isfinite(end), np.abs(end), 0.0) for end in (least, most)))
    past = np.maximum(values - most, least - values) - ROUNDING * size
    past = np.where(np.isfinite(past), past, -math.inf)
    found = list[list[tuple[float, float]]]()
    for row, k in enumerate(np.argmax(past, axis=1).tolist()):
        value, end = values[row, k], (most if values[row, k] > most[row, k] else least)[row, k]
        found.append([(float(value), float(end))] if past[row, k] > 0 else [])
    return found


def _cylinder_rates(machine: AnyMachine, joints: Vector, rates: Vector) -> tuple[Vector, Vector, Vector]:
    """Of each cylinder at each sample its rate (n_c, K), m/s, and what it retracts and extends by at most (n_c, 1)."""
    if not machine.cylinders:
        return np.zeros((0, 1)), np.zeros((0, 1)), np.zeros((0, 1))
    hydraulics = build_hydraulics(machine)
    ratios = _ratios(machine)(joints, hydraulics.plant.parameter_values.full().ravel())[0]
    # (n, n_c, K): casadi stacks columns.
    each = ratios.reshape(len(joints), len(machine.cylinders), -1)
    speeds = np.array([cylinder.speed for cylinder in machine.cylinders])
    return np.einsum("jck,jk->ck", each, rates), -speeds[:, :1], speeds[:, 1:]


@by_structure
def _ratios(machine: AnyMachine) -> Interpreter:
    return Interpreter(build_hydraulics(machine).ratios)


def _efforts(machine: AnyMachine, joints: Vector) -> Vector:
    """Least and greatest torque or force of each joint at each sample, (n, K, 2)."""
    given = np.array(machine.efforts)
    if not any(cylinder.force for cylinder in machine.cylinders):
        return np.array([-given, given]).T[:, None]
    values = _joint_efforts(machine)(joints, build_hydraulics(machine).plant.parameter_values.full().ravel())[0]
    n = len(given)
    return np.stack([values[:n], values[n:]], axis=-1)


@by_structure
def _joint_efforts(machine: AnyMachine) -> Interpreter:
    return Interpreter(build_hydraulics(machine).joint_efforts)
