"""Allowed ranges of a machine's parameters by their names, as in a machine file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from flexopt.foundation.quantities import (
    ACCELERATION,
    ANGLE,
    ARMATURE,
    COORDINATE,
    INERTIA,
    JOINT_DAMPING,
    JOINT_STIFFNESS,
    LENGTH,
    MASS,
    OFFSET,
)

if TYPE_CHECKING:
    from flexopt.model.machine import Parameter

# By the last word of a name, as in a machine file.
_QUANTITIES = {
    "length": LENGTH, "com": OFFSET, "com_offset": OFFSET, "mass": MASS, "inertia": INERTIA, "armature": ARMATURE,
    "stiffness": JOINT_STIFFNESS, "damping": JOINT_DAMPING, "joint_damping": JOINT_DAMPING, "rest_angle": ANGLE,
    "gravity": ACCELERATION, "offset": OFFSET, "coupler": LENGTH,
}  # fmt: skip
# By the last word but one, of vectors and matrices.
_PLACES = ("position", "com", "base_point", "rod_point", "pivot", "coupler_point", "rod_offset")
_ENTRIES = {"inertia": INERTIA, **dict.fromkeys(_PLACES, OFFSET)}
_COUPLED = {"stiffness": JOINT_STIFFNESS, "damping": JOINT_DAMPING}


def parameter_range(parameter: Parameter) -> tuple[float, float]:
    """Allowed range of a machine's parameter, as in a machine file."""
    *others, last = parameter.name.split(".")
    owner = others[-1] if others else ""
    if last in _QUANTITIES:
        low, high = _QUANTITIES[last].range
        # A body may have inertia and no mass; then, and always in these, 0 is a value like others.
        may_vanish = parameter.value == 0 or parameter.name in {"base.length", "payload.mass"}
        return (min(low, 0.0) if may_vanish else low), high
    if others[:1] == ["base"] and owner in _COUPLED:
        return _COUPLED[owner].range
    if owner in _ENTRIES and last in {"xx", "yy", "zz"}:
        return 0.0, _ENTRIES[owner].high
    # Entries of vectors and of coupled springs, rest values, and whatever else may have either sign.
    known = _ENTRIES.get(owner) or _COUPLED.get(parameter.name.split(".")[0]) or COORDINATE.get(parameter.unit)
    limit = 1e15 if known is None else known.high
    return -limit, limit
