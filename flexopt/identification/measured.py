"""What a log may hold: one table of measured quantities and of the units that headers may name.

In: a machine, the headers of a log. Out: a `Channel` for each column, or what is wrong with the header.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from flexopt.foundation.nearest import hint_or_list
from flexopt.model import AnyMachine

TIME = "t"
_RATE = ".rate"
_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
_TURNS = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "°": math.pi / 180}
_LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "µm": 1e-6, "um": 1e-6}
_FORCES = {"m/s²": 1.0, "m/s^2": 1.0, "m/s2": 1.0, "mm/s²": 1e-3, "mm/s^2": 1e-3, "g": 9.80665}
# By the SI unit that a quantity is computed in: units that a header may have, and what one of them is.
UNITS: dict[str, dict[str, float]] = {
    "s": _TIMES,
    "rad": _TURNS,
    "m": _LENGTHS,
    "rad/s": {f"{unit}/s": factor for unit, factor in _TURNS.items()} | {"rpm": math.pi / 30},
    "m/s": {f"{unit}/s": factor for unit, factor in _LENGTHS.items()},
    "m/s²": _FORCES,
}
# Factors by which a column is off where its unit was told wrongly, and what it then is instead of what it says.
MISTAKEN = {
    "rad": ((180 / math.pi, "deg"), (1e3, "mrad")),
    "rad/s": ((180 / math.pi, "deg/s"), (1e3, "mrad/s")),
    "m": ((1e3, "mm"),),
    "m/s": ((1e3, "mm/s"),),
    "m/s²": ((1 / 9.80665, "g"), (1e3, "mm/s²")),
}
KINDS = ("time", "joint", "coordinate", "rate", "gyro", "acceleration", "end_point")


@dataclass(frozen=True)
class Channel:
    """One quantity that a log may hold.

    Attributes:
        name: as in headers.
        kind: one of `KINDS`.
        index: which coordinate, joint or axis.
        unit: SI.
    """

    name: str
    kind: str
    index: int
    unit: str


def imu_body(machine: AnyMachine) -> str | None:
    """The body that carries the arm, on which an inertial measurement unit sits; None where it stands on the ground."""
    tree = machine.kinematic_tree
    parent = next(body.parent for body in tree.bodies if not body.joint.passive)
    return parent if parent in {tree.bodies[i].name for i in tree.frames} else None


def quantities(machine: AnyMachine) -> dict[str, Channel]:
    """Everything that a log of that machine may hold, by name."""
    return {each.name: each for each in _quantities(machine)}


def _quantities(machine: AnyMachine) -> Iterator[Channel]:
    tree = machine.kinematic_tree
    yield Channel(TIME, "time", 0, "s")
    passive = len(tree.passive)
    for k, (name, unit) in enumerate(zip(machine.coordinates, machine.coordinate_units, strict=True)):
        if k < passive:
            yield Channel(name, "coordinate", k, unit)
            yield Channel(f"{name}{_RATE}", "rate", k, f"{unit}/s")
        else:
            yield Channel(name, "joint", k - passive, unit)
    if imu_body(machine) is not None:
        spatial = len(tree.axes) == 3
        for k, axis in enumerate("xyz" if spatial else "z"):
            yield Channel(f"gyro_{axis}", "gyro", k, "rad/s")
        for k, axis in enumerate("xyz" if spatial else "xy"):
            yield Channel(f"acc_{axis}", "acceleration", k, "m/s²")
    for k, axis in enumerate(tree.axes):
        yield Channel(f"end_point.{axis}", "end_point", k, "m")


def read_header(header: str, known: dict[str, Channel]) -> tuple[Channel, float]:
    """The quantity that a header names, and the factor that makes SI of its column.

    Raises:
        ValueError: unknown name or unit; the sentence says the nearest known.
    """
    name, bracket, rest = header.partition("[")
    name, unit = name.strip(), rest.partition("]")[0].strip()
    name = TIME if name == "time" and "time" not in known else name
    if name not in known:
        raise ValueError(f"is no measured quantity of this machine{hint_or_list(name, known)}")
    quantity = known[name]
    if not bracket:
        return quantity, 1.0
    units = UNITS[quantity.unit]
    if unit not in units:
        raise ValueError(f"has no unit {unit!r}{hint_or_list(unit, units, 'units here: ')}")
    return quantity, units[unit]
