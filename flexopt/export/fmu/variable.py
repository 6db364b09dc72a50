"""A variable of an FMU, and what its unit and description are made from.

In: names and units of a machine. Out: `Variable`, units, words.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from flexopt.foundation.control import Control
from flexopt.foundation.escapes import one_line

# What a joint gives, by the unit of its coordinate.
EFFORT = {"rad": ("torque", "N m"), "m": ("force", "N")}
# Parameters that are vectors or tensors of a body, and matrices over joints.
_VECTORS, _COUPLED = ("position", "com", "inertia"), ("stiffness", "damping")


@dataclass(frozen=True)
class Variable:
    """A real variable of an FMU.

    Attributes:
        name: structured.
        unit: SI, as `units.unit_of` reads it; empty where there is none.
        text: what it is.
        start: of what the master sets.
        low, high: its allowed range.
        tunable: whether it may change during a run.
        nominal: of a state, its size.
    """

    name: str
    unit: str
    text: str
    start: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    tunable: bool = False
    nominal: float = 1.0

    def __post_init__(self) -> None:
        # Names of links come from machine files; XML and FMI's flat names know no control characters.
        for field in ("name", "text"):
            value: str = getattr(self, field)
            object.__setattr__(self, field, one_line(value))


def words(name: str) -> str:
    """A parameter's name as a description."""
    first, *others = name.split(".")
    if first in _COUPLED and others:
        return f"{first} of joints {'.'.join(others)}"
    axis = f", {others.pop()}" if len(others) > 1 and others[-2] in _VECTORS else ""
    *owner, last = [first, *others]
    what = last.replace("_", " ").replace("com", "centre of mass")
    return f"{' '.join(owner)}: {what}{axis}" if owner else what


def force_unit(control: Control, joints: Sequence[str]) -> str:
    """Unit of the controller's f: N, or what Jacobian inverses make of it, N m² for hinges and N for slides."""
    found = {"m"} if control == "transpose" else set(joints)
    return " or ".join({"rad": "N m²", "m": "N"}[unit] for unit in ("rad", "m") if unit in found)


def one_unit(text: str) -> tuple[str, str]:
    """A unit as a variable has it, and what its description adds: FMI cannot tell two, of hinges and of slides."""
    return ("", f", in {text}") if " or " in text else (text, "")
