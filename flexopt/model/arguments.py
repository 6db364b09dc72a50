"""Checks of what a caller passes in: every fault is collected, then raised in one message."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.model.machine import Machine
from flexopt.model.problem import CONTROLS, check_base, check_point
from flexopt.model.quantities import ANGLE_MAX, check_number

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

    def posture(self, machine: Machine, value: Any, field: str = "posture") -> Vector:
        """Angles of the actuated joints (n,), rad, finite and inside their limits."""
        names = machine.joints
        plain = _plain(value)
        parts = list(cast(Sequence[Any], plain)) if isinstance(plain, list | tuple) else [plain]
        if len(parts) != len(names):
            wanted = (
                f"needs {len(names)} angles in rad, one for each actuated joint ({', '.join(names)}), not {len(parts)}"
            )
            self.faults.append(Fault(field, wanted, shown(value)))
            return np.zeros(len(names))
        checked: list[float] = []
        for name, part, limits in zip(names, parts, machine.limits, strict=True):
            low, high = max(limits[0], -ANGLE_MAX), min(limits[1], ANGLE_MAX)
            sentence = f"{field} ({name})"
            checked.append(
                self.checked(sentence, part, lambda v, lo=low, hi=high: check_number(v, "rad", low=lo, high=hi), 0.0)
            )
        return np.array(checked)

    def base(self, value: Any, field: str = "base") -> Vector:
        """Placement (n_b,), m."""
        return np.array(self.checked(field, value, check_base, (0.0,)))

    def point(self, value: Any, field: str) -> Vector:
        """End-point (2,), m, inertial frame."""
        return np.array(self.checked(field, value, check_point, (0.0, 0.0)))

    def control(self, value: Any) -> Any:
        """`"inverse"` or `"transpose"`."""
        return self.choice("control", value, CONTROLS)

    def machine(self, value: Any) -> Machine:
        """A `Machine`; anything else cannot be checked further and raises at once."""
        if not isinstance(value, Machine):
            sentence = 'must be a Machine, from flexopt.load("excavator") for example'
            raise_if_any(InputError, self.call, [Fault("machine", sentence, shown(value))])
        return value

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
