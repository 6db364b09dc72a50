"""Checks of what a caller passes in: every fault is collected, then raised in one message."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arrays import Vector
from flexopt.foundation.control import Control, check_control
from flexopt.foundation.coordinates import check_placement, check_task
from flexopt.foundation.plain import counted, plain, shown
from flexopt.foundation.quantities import Quantity, coordinate_max, several

# Whatever says what its coordinates are, as every machine does: joints, their units and limits, task rows.
Coordinates = Any
T = TypeVar("T")
_UNREAD: Any = object()
# Texts tell joints to four digits after the point: by so much a limit may be rounded outwards, rad or m.
ROUNDED = 0.51e-4


class Arguments:
    """Collects the faults of one call.

    Each method returns the checked value, or a harmless stand-in after noting the fault; `done` raises `InputError`
    with every fault noted.

    Attributes:
        call: what is called.
        of: the machine that it is about, where one is known.
        error: what is raised.
        sizes: what the letters in shapes of arrays stand for.
        faults: noted so far.
    """

    def __init__(self, call: str, of: Coordinates = None, error: type[InputError] = InputError) -> None:
        self.call, self.of, self.error = call, of, error
        self.sizes: Mapping[str, int] = {}
        self.faults: list[Fault] = []

    def note(self, field: str, sentence: str, value: Any) -> None:
        """One fault more."""
        self.faults.append(Fault(field, sentence, shown(value)))

    def collect(self, field: str, read: Callable[[], T]) -> T | None:
        """What `read` makes of an argument, or None after noting the faults of the `InputError` that it raises."""
        try:
            return read()
        except InputError as error:
            prefix = f"{field}." if field else ""
            self.faults += [Fault(f"{prefix}{f.field}", f.sentence, f.value) for f in error.faults]
            self.faults += [] if error.faults else [Fault(field or "arguments", str(error))]
            return None

    def faulty(self, field: str) -> bool:
        """Whether a fault of that argument is noted."""
        parts = tuple(f"{field}{end}" for end in ". [")
        return any(fault.field == field or fault.field.startswith(parts) for fault in self.faults)

    def checked(self, field: str, value: Any, check: Callable[[Any], T], stand_in: T) -> T:
        """`check(value)`, whose `ValueError` carries the sentence."""
        try:
            return check(plain(value))
        except ValueError as error:
            self.note(field, str(error), value)
            return stand_in

    def choice(self, field: str, value: Any, valid: Sequence[T]) -> T:
        """One of a few words."""

        def check(given: Any) -> T:
            for word in valid:
                if given is word or (type(given) is type(word) and given == word):
                    return word
            raise ValueError("must be " + " or ".join(map(str, valid)))

        return self.checked(field, value, check, valid[0])

    def flag(self, field: str, value: Any) -> bool:
        """True or False."""
        return self.choice(field, value, (False, True))

    def posture(self, machine: Coordinates, value: Any, field: str = "posture") -> Vector:
        """Actuated joints (n,), rad or m, finite and inside their limits; a limit as texts round it is that limit."""
        return self._joints(machine, value, field, machine.limits, machine.beyond_stroke)

    def displacement(self, machine: Coordinates, value: Any, field: str) -> Vector:
        """Differences of the actuated joints (n,), rad or m."""
        return self._joints(machine, value, field, [(-np.inf, np.inf)] * len(machine.joints), None)

    def _joints(
        self,
        machine: Coordinates,
        value: Any,
        field: str,
        limits: Sequence[tuple[float, float]],
        beyond: Callable[[str, Any], str] | None,
    ) -> Vector:
        """A number for each actuated joint; `beyond` tells more of one that is outside its limits."""
        names, units = machine.joints, machine.joint_units
        parts = self._parts(field, value)
        if parts is not None and len(parts) != len(names):
            angles = all(unit == "rad" for unit in units)
            what = counted(len(names), "angle" if angles else "number") + (" in rad" if angles else "")
            listed = ", ".join(names if angles else (f"{n} in {u}" for n, u in zip(names, units, strict=True)))
            wanted = f"needs {what}, one for each actuated joint ({listed}), not {len(parts)}"
            self.note(field, wanted, value)
            parts = None
        checked = np.zeros(len(names))
        if parts is None:
            return checked
        for k, (name, unit, part, (low, high)) in enumerate(zip(names, units, parts, limits, strict=True)):
            most, known = coordinate_max(unit), len(self.faults)
            allowed = Quantity(unit, low=max(low, -most), high=min(high, most))
            checked[k] = self.checked(f"{field} ({name})", _on_limit(part, low, high), allowed, 0.0)
            if beyond is not None and len(self.faults) > known:
                fault = self.faults[known]
                # Of what is no number there is no more to say.
                with contextlib.suppress(InputError):
                    self.faults[known] = Fault(fault.field, f"{fault.sentence}{beyond(name, part)}", fault.value)
        return checked

    def _parts(self, field: str, value: Any) -> list[Any] | None:
        """The entries of a list, or a value alone; None after noting that it cannot be read."""
        read = self.checked(field, value, lambda v: v, _UNREAD)
        if read is _UNREAD:
            return None
        return several(read)

    def base(self, machine: Coordinates, value: Any, field: str = "base") -> Vector:
        """Placement (n_b,), m or rad."""
        names, units = machine.base_coordinates, machine.base_units
        stand_in = (0.0,) * len(names)
        return np.array(self.checked(field, value, lambda v: check_placement(v, names, units), stand_in))

    def point(self, value: Any, field: str, machine: Coordinates = None) -> Vector:
        """The machine's task (n_task,), m, inertial frame; without a machine a point (2,) of the plane."""
        rows = ("x", "y") if machine is None else machine.task_rows
        return np.array(self.checked(field, value, lambda v: check_task(v, rows), (0.0,) * len(rows)))

    def control(self, value: Any, field: str = "control") -> Control:
        """`"inverse"`, `"transpose"` or `"damped:LAMBDA"`."""
        return self.checked(field, value, check_control, "inverse")

    def done(self) -> None:
        """Raise every fault noted so far."""
        raise_if_any(self.error, self.call, self.faults)


def _on_limit(value: Any, low: float, high: float) -> Any:
    """The limit where a number is that limit as texts round it, so that what they tell can be given; else the value."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    # Compared, not subtracted: a whole number may be too large for a double.
    return min(max(value, low), high) if number and low - ROUNDED <= value <= high + ROUNDED else value
