"""Checks of what a caller passes in: every fault is collected, then raised in one message."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.model.machine import AnyMachine, Machine
from flexopt.model.problem import Control, check_control, check_placement, check_task
from flexopt.model.quantities import check_number, coordinate_max

Vector = NDArray[np.float64]
T = TypeVar("T")


class Arguments:
    """Collects the faults of one call.

    Each method returns the checked value, or a harmless stand-in after noting the fault; `done` raises `InputError`
    with every fault noted.
    """

    def __init__(self, call: str) -> None:
        self.call = call
        self.faults: list[Fault] = []

    def checked(self, field: str, value: Any, check: Callable[[Any], T], stand_in: T) -> T:
        """`check(value)`, whose `ValueError` carries the sentence."""
        try:
            return check(_plain(value))
        except ValueError as error:
            self.faults.append(Fault(field, str(error), shown(value)))
            return stand_in

    def choice(self, field: str, value: Any, valid: Sequence[T]) -> T:
        """One of a few words."""
        if not any(value is v or (type(value) is type(v) and value == v) for v in valid):
            self.faults.append(Fault(field, "must be " + " or ".join(map(str, valid)), shown(value)))
            return valid[0]
        return cast(T, value)

    def flag(self, field: str, value: Any) -> bool:
        """True or False."""
        return self.choice(field, value, (False, True))

    def posture(self, machine: AnyMachine, value: Any, field: str = "posture") -> Vector:
        """Actuated joints (n,), rad or m, finite and inside their limits."""
        names, units = machine.joints, machine.joint_units
        plain = _plain(value)
        parts = list(cast(Sequence[Any], plain)) if isinstance(plain, list | tuple) else [plain]
        if len(parts) != len(names):
            angles = all(unit == "rad" for unit in units)
            what = "angles in rad" if angles else "numbers"
            listed = ", ".join(names if angles else (f"{n} in {u}" for n, u in zip(names, units, strict=True)))
            wanted = f"needs {len(names)} {what}, one for each actuated joint ({listed}), not {len(parts)}"
            self.faults.append(Fault(field, wanted, shown(value)))
            return np.zeros(len(names))
        checked: list[float] = []
        for name, unit, part, limits in zip(names, units, parts, machine.limits, strict=True):
            low, high = max(limits[0], -coordinate_max(unit)), min(limits[1], coordinate_max(unit))
            known = len(self.faults)
            checked.append(
                self.checked(
                    f"{field} ({name})",
                    part,
                    lambda v, u=unit, lo=low, hi=high: check_number(v, u, low=lo, high=hi),
                    0.0,
                )
            )
            for fault in self.faults[known:]:
                longer = f"{fault.sentence}{machine.beyond_stroke(name, _plain(part))}"
                self.faults[known] = Fault(fault.field, longer, fault.value)
        return np.array(checked)

    def displacement(self, machine: AnyMachine, value: Any, field: str) -> Vector:
        """Differences of the actuated joints (n,), rad or m."""
        names, units = machine.joints, machine.joint_units
        what = "angles in rad" if set(units) == {"rad"} else "numbers in " + ", ".join(units)
        if not isinstance(value, list | tuple) or len(cast(Sequence[Any], value)) != len(names):
            wanted = f"needs {len(names)} {what}, one for each actuated joint ({', '.join(names)})"
            self.faults.append(Fault(field, wanted, shown(value)))
            return np.zeros(len(names))
        parts = zip(names, units, cast(Sequence[Any], value), strict=True)
        return np.array(
            [
                self.checked(
                    f"{field} ({name})",
                    part,
                    lambda v, u=unit: check_number(v, u, low=-coordinate_max(u), high=coordinate_max(u)),
                    0.0,
                )
                for name, unit, part in parts
            ]
        )

    def base(self, machine: AnyMachine, value: Any, field: str = "base") -> Vector:
        """Placement (n_b,), m or rad."""
        names, units = machine.base_coordinates, machine.base_units
        stand_in = (0.0,) * len(names)
        return np.array(self.checked(field, value, lambda v: check_placement(v, names, units), stand_in))

    def point(self, value: Any, field: str, machine: AnyMachine | None = None) -> Vector:
        """The machine's task (n_task,), m, inertial frame; without a machine a point (2,) of the plane."""
        rows = ("x", "y") if machine is None else machine.task_rows
        return np.array(self.checked(field, value, lambda v: check_task(v, rows), (0.0,) * len(rows)))

    def control(self, value: Any) -> Control:
        """`"inverse"`, `"transpose"` or `"damped:LAMBDA"`."""
        return self.checked("control", value, check_control, "inverse")

    def machine(self, value: Any) -> AnyMachine:
        """A machine, planar or spatial; anything else cannot be checked further and raises at once."""
        if not isinstance(value, AnyMachine):
            sentence = 'must be a Machine, from flexopt.load("excavator") for example'
            raise_if_any(InputError, self.call, [Fault("machine", sentence, shown(value))])
        return value

    def planar(self, value: Any) -> Machine:
        """A planar machine; anything else raises at once."""
        machine = self.machine(value)
        if not isinstance(machine, Machine):
            sentence = f"is a spatial machine, and {self.call} takes planar machines only so far"
            raise InputError(
                f"{self.call}: machine {machine.name!r} {sentence}", [Fault("machine", sentence)], self.call
            )
        return machine

    def done(self) -> None:
        """Raise every fault noted so far."""
        raise_if_any(InputError, self.call, self.faults)


def shown(value: Any) -> str:
    """A value as it is quoted in a message."""
    text = repr(_plain(value))
    return text if len(text) <= 60 else text[:57] + "..."


def _plain(value: Any) -> Any:
    """NumPy scalars and arrays as Python numbers and lists."""
    if isinstance(value, np.ndarray | np.generic):
        return cast(Any, value.tolist())  # pyright: ignore[reportUnknownMemberType]
    return value
