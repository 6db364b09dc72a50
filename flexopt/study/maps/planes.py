"""What varies over a map and what is held: the arguments of `map_workspace`, checked.

In: a machine and what a caller passes. Out: a `Plane`, from which the grid is made.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flexopt.errors import Fault
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Interval, Vector
from flexopt.foundation.boundary import ArgumentCheck, by
from flexopt.foundation.plain import counted, shown
from flexopt.foundation.quantities import COORDINATE, Quantity, coordinate_max, entries, pair, several
from flexopt.model import AnyMachine
from flexopt.model.choices import Elbow
from flexopt.plant import build_plant
from flexopt.robustness.evaluation import in_words
from flexopt.study.maps.grid import (
    AxisPair,
    Grid,
    Over,
    closed_form,
    end_point_at,
    end_point_grid,
    followed_grid,
    joint_ranges,
    placement_ranges,
    posture_grid,
    reach_ranges,
    task_ranges,
)

# Argument -> the maps that it belongs to; of end-points those that are followed.
BELONGS: dict[str, tuple[Over, ...]] = {
    "joints": ("posture",),
    "rows": ("end_point",),
    "coordinates": ("base",),
    "end_point": ("end_point", "base"),
}


def two_counts(what: str, least: int, most: int) -> ArgumentCheck:
    """How many of something there are along x and along y."""

    def check(value: Any) -> tuple[int, int]:
        parts = entries(value)
        whole = [part for part in parts if type(part) is int and least <= part <= most]
        if len(parts) != 2 or len(whole) != 2:
            raise ValueError(f"must be two whole numbers between {least} and {most}: {what} along x and along y")
        return whole[0], whole[1]

    return by(check)


@dataclass
class Plane:
    """A map's plane.

    Attributes:
        over: what varies.
        followed: whether postures are found by following them from `posture`.
        varies: indices of the two joints, task rows or placement coordinates along x and y.
        names: their names.
        posture: reference (n,), or over the posture the joints that do not vary (n − 2,).
        end_point: (n_task,), m, where it is held or partly held.
        base: placement (n_b,).
        ranges: along x and y.
        rows: names of the task rows;  placed: names and units of the placement's coordinates.
        gravity: whether end-points are those of the machine as it sags.
    """

    over: Over
    followed: bool
    varies: AxisPair = (0, 1)
    names: tuple[str, str] = ("x", "y")
    posture: Vector = field(default_factory=lambda: np.zeros(0))
    end_point: Vector = field(default_factory=lambda: np.zeros(0))
    base: Vector = field(default_factory=lambda: np.zeros(0))
    ranges: tuple[Interval, Interval] = ((0.0, 1.0), (0.0, 1.0))
    rows: tuple[str, ...] = ()
    placed: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
    gravity: bool = False

    def grid(
        self, machine: AnyMachine, points: tuple[int, int], elbow: Elbow, told: Callable[[int], None] = lambda _: None
    ) -> Grid:
        """Postures and placements at every point; `told` is called with how many postures are followed."""
        if self.over == "posture":
            return posture_grid(machine, *self.ranges, points, self.varies, self.posture, self.base)
        if self.followed:
            at = self.end_point, self.base, self.posture
            return followed_grid(machine, self.over, self.ranges, points, self.varies, *at, told, gravity=self.gravity)
        return end_point_grid(machine, *self.ranges, points, elbow, gravity=self.gravity)

    def options(self, elbow: Elbow) -> dict[str, Any]:
        """What a map's options and provenance say of it."""
        if self.over == "end_point" and not self.followed:
            return {"elbow": elbow}
        word = {"posture": "joints", "end_point": "rows", "base": "coordinates"}[self.over]
        said: dict[str, Any] = {"posture": self.posture.tolist(), word: list(self.names), "base": self.base.tolist()}
        return said | ({"end_point": self.end_point.tolist()} if self.followed else {})

    @property
    def marks(self) -> dict[str, tuple[float, float]]:
        """Points of the plane to show: name -> (x, y)."""
        if not self.followed:
            return {}
        i, j = self.varies
        if self.over == "end_point":
            return {"end-point": (float(self.end_point[i]), float(self.end_point[j]))}
        found = {"reference": (float(self.base[i]), float(self.base[j]))}
        if set(self.names) <= set(self.rows):
            at = [float(self.end_point[self.rows.index(name)]) for name in self.names]
            found["end-point"] = (at[0], at[1])
        return found

    @property
    def frame(self) -> str:
        """In which frame the axes are."""
        if self.over == "posture":
            return "joint angles, relative, counter-clockwise positive"
        if self.over == "base":
            sags = ", as the machine sags" if self.gravity else ""
            return f"placement in the inertial frame, end-point held at {_listed(self.end_point)} m{sags}"
        sags = "; the end-point is that of the machine as it sags" if self.gravity else ""
        if self.followed:
            names, units = self.placed
            based = f", with the base at {in_words(names, self.base, units)}" if names else ""
            held = [f"{row} {x:.4g}" for row, x in zip(self.rows, self.end_point, strict=True) if row not in self.names]
            along = f", the end-point held at {', '.join(held)} m" if held else ""
            return f"inertial{based}{along}{sags}"
        return f"workspace: axes of the inertial frame, origin at the first joint at rest, base at 0{sags}"


def read_plane(arguments: Arguments, machine: AnyMachine, over: Over | None, given: dict[str, Any]) -> Plane:
    """Check what belongs to a map's plane.

    Args:
        arguments: of the call; notes the faults.
        machine: the machine.
        over: what varies; None where it is not usable.
        given: joints, rows, coordinates, posture, end_point, base, x_range, y_range as they were passed, and gravity.
    """
    direct = over == "end_point" and given["posture"] is None and closed_form(machine)
    followed = over != "posture" and over is not None and not direct
    plane = Plane(over or "end_point", followed, base=np.zeros(len(machine.base_coordinates)), rows=machine.task_rows)
    plane.placed, plane.gravity = (machine.base_coordinates, machine.base_units), given["gravity"]
    if over is None:
        return plane
    for name, maps in BELONGS.items():
        if given[name] is not None and (over not in maps or (over == "end_point" and not followed)):
            sentence = "goes with over = " + " or ".join(f"'{each}'" for each in maps)
            _note(arguments, name, sentence + (" where postures are followed" if over in maps else ""), given[name])
    if given["base"] is not None:
        if over == "end_point" and not followed:
            _note(arguments, "base", "does not matter here: the workspace frame moves with the base", given["base"])
        plane.base = arguments.base(machine, given["base"])
    _read_varying(arguments, machine, plane, given)
    if over == "posture":
        plane.posture = _other_joints(arguments, machine, plane.varies, given["posture"])
    elif followed:
        _read_reference(arguments, machine, plane, given)
    _read_ranges(arguments, machine, plane, given)
    return plane


def _note(arguments: Arguments, name: str, sentence: str, value: Any) -> None:
    arguments.faults.append(Fault(name, sentence, shown(value)))


def _listed(values: Vector) -> str:
    return "(" + ", ".join(f"{value:z.4g}" for value in values) + ")"


def _read_varying(arguments: Arguments, machine: AnyMachine, plane: Plane, given: dict[str, Any]) -> None:
    """The two that vary."""
    word, what, names = {
        "posture": ("joints", "actuated joints", machine.joints),
        "end_point": ("rows", "task rows", machine.task_rows),
        "base": ("coordinates", "placement coordinates", machine.base_coordinates),
    }[plane.over]
    if len(names) < 2:
        listed = f" ({', '.join(names)})" if names else ""
        instead = "; flexopt.select looks through all places of the base" if plane.over == "base" else ""
        _note(arguments, "over", f"needs two {what}, not {len(names)}{listed}{instead}", plane.over)
        return

    def check(value: Any) -> AxisPair:
        chosen = several(value)
        if len(chosen) != 2 or not all(isinstance(name, str) for name in chosen):
            raise ValueError(f"must be two names of {what}: {', '.join(names)}")
        unknown = [repr(name) for name in chosen if name not in names]
        if unknown:
            raise ValueError(f"{' and '.join(unknown)} not among the {what}: {', '.join(names)}")
        if chosen[0] == chosen[1]:
            raise ValueError(f"names the same one twice; two of {', '.join(names)} are wanted")
        return names.index(chosen[0]), names.index(chosen[1])

    if given[word] is not None:
        plane.varies = arguments.checked(word, given[word], check, (0, 1))
    plane.names = names[plane.varies[0]], names[plane.varies[1]]


def _other_joints(arguments: Arguments, machine: AnyMachine, varies: AxisPair, posture: Any) -> Vector:
    """The joints that do not vary."""
    names = machine.joints
    if len(names) < 2:
        return np.zeros(0)
    others = [k for k in range(len(names)) if k not in varies]
    if posture is None and not others:
        return np.zeros(0)
    given = arguments.checked("posture", posture, lambda v: v, None)
    if arguments.faulty("posture"):
        return np.zeros(len(others))
    values = [] if given is None else several(given)
    if len(values) != len(others):
        rest = ", ".join(names[k] for k in others)
        what, units = ("angle", "rad") if set(machine.joint_units) == {"rad"} else ("number", "rad or m")
        sentence = f"needs {counted(len(others), what)} in {units}, for the joints that do not vary ({rest or 'none'})"
        _note(arguments, "posture", sentence, posture)
        return np.zeros(len(others))
    # The two that vary stand where no fault is found.
    whole = [max(low, -coordinate_max(u)) for (low, _), u in zip(machine.limits, machine.joint_units, strict=True)]
    for k, value in zip(others, values, strict=True):
        whole[k] = value
    return arguments.posture(machine, whole)[others]


def _read_reference(arguments: Arguments, machine: AnyMachine, plane: Plane, given: dict[str, Any]) -> None:
    """The posture to start from and the end-point."""
    names = machine.joints
    if given["posture"] is None:
        if plane.over == "base":
            sentence = (
                f"is missing: {len(names)} numbers ({', '.join(names)}), the posture from which others are followed"
            )
            arguments.faults.append(Fault("posture", sentence))
            return
        wanted = "an end-point does not name one posture; give the posture to start from, or map over the posture"
        if build_plant(machine).closed_form:
            wanted = f"needs two actuated joints, not {len(names)} ({', '.join(names)}): {wanted}"
        _note(arguments, "over", wanted, plane.over)
        return
    noted = len(arguments.faults)
    plane.posture = arguments.posture(machine, given["posture"])
    if given["end_point"] is not None:
        plane.end_point = arguments.point(given["end_point"], "end_point", machine)
    elif len(arguments.faults) == noted:
        plane.end_point = end_point_at(build_plant(machine), plane.base, plane.posture, gravity=plane.gravity)


def _read_ranges(arguments: Arguments, machine: AnyMachine, plane: Plane, given: dict[str, Any]) -> None:
    """Ranges along x and y; where other faults stand the defaults are left aside."""
    unit_of = {"posture": machine.joint_units, "base": machine.base_units}.get(plane.over, ("m",) * 6)
    if max(plane.varies) >= len(unit_of):
        return
    units = [unit_of[k] for k in plane.varies]
    defaults = plane.ranges if arguments.faults else _default_ranges(machine, plane)
    read: list[Interval] = []
    for name, unit, default in zip(("x_range", "y_range"), units, defaults, strict=True):

        def check(value: Any, quantity: Quantity = COORDINATE[unit]) -> Interval:
            try:
                return pair(quantity)(value)
            except ValueError as error:
                raise ValueError(f"{error}; both ends {quantity.allowed}") from None

        read.append(default if given[name] is None else arguments.checked(name, given[name], check, default))
    plane.ranges = read[0], read[1]


def _default_ranges(machine: AnyMachine, plane: Plane) -> tuple[Interval, Interval]:
    if plane.over == "end_point" and not plane.followed:
        return reach_ranges(machine)
    if plane.over == "posture":
        every = joint_ranges(machine)
    elif plane.over == "end_point":
        every = task_ranges(build_plant(machine), plane.base)
    else:
        every = placement_ranges(build_plant(machine), plane.end_point, plane.base, plane.varies)
    return every[plane.varies[0]], every[plane.varies[1]]
