"""The servo gain behind levers, from what the machine's drives can give.

In: a machine and a posture. Out: the gain that is taken where none is given, and what a run says where levers can ask
for next to nothing.
"""

from __future__ import annotations

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.model import AnyMachine
from flexopt.model.simulation import SimulationOptions
from flexopt.plant.hydraulics import build_hydraulics

# Below this share of the gain that the efforts call for, levers do next to nothing.
FEEBLE = 1e-2


def full_rates(machine: AnyMachine, posture: Vector) -> Vector:
    """Sizes of the joints' rates at full lever, either way (n, 2), rad/s or m/s, in the order of `joint_efforts`."""
    hydraulics = build_hydraulics(machine)
    p, n = hydraulics.plant.parameter_values, len(posture)
    ends = [hydraulics.rates(posture, np.full(n, lever), p).full().ravel() for lever in (-1.0, 1.0)]
    return np.abs(np.sort(np.array(ends).T, axis=1))


def servo_gain_of_efforts(machine: AnyMachine, posture: Vector) -> float | None:
    """Largest gain at which no full lever asks a joint for more than its effort, N m s/rad or N s/m.

    k = min effort/rate over the joints and both ways of their levers, `joint_efforts` and rates at full lever in this
    posture. None where no effort is known.
    """
    hydraulics = build_hydraulics(machine)
    efforts = np.abs(hydraulics.joint_efforts(posture, hydraulics.plant.parameter_values).full())
    rates = full_rates(machine, posture)
    known = np.isfinite(efforts) & (efforts > 0) & np.isfinite(rates) & (rates > 0)
    return float(np.min(efforts[known] / rates[known])) if np.any(known) else None


def with_servo_gain(machine: AnyMachine, options: SimulationOptions, posture: Vector) -> SimulationOptions:
    """The options with `servo_gain_of_efforts` where levers are used and no servo gain is given."""
    actuator = options.actuator
    if actuator.levers is None or "servo_gain" in actuator.model_fields_set:
        return options
    gain = servo_gain_of_efforts(machine, posture)
    if gain is None:
        return options
    return options.model_copy(update={"actuator": actuator.model_copy(update={"servo_gain": gain})})


def feeble_levers(machine: AnyMachine, options: SimulationOptions, posture: Vector) -> list[str]:
    """A sentence where full levers ask for far less than the joints can give, or where nobody knows what they can."""
    actuator = options.actuator
    if actuator.levers is None:
        return []
    wanted = servo_gain_of_efforts(machine, posture)
    if wanted is None and "servo_gain" in actuator.model_fields_set:
        return []
    if wanted is not None and actuator.servo_gain >= FEEBLE * wanted:
        return []
    torque = actuator.servo_gain * full_rates(machine, posture).max(axis=1)
    most = ", ".join(
        f"{value:.3g} {'N m' if unit == 'rad' else 'N'} of {name}"
        for name, value, unit in zip(machine.joints, torque, machine.joint_units, strict=True)
    )
    what = f"with actuator.servo_gain = {actuator.servo_gain:g} full levers ask for no more than {most}"
    if wanted is None:
        return [f"{what}; {machine.name} names no effort from which to take a gain, so give one"]
    return [f"{what}; {wanted:.4g} would ask for the effort of the first joint that reaches it"]
