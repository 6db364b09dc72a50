"""Allowed ranges of a machine's parameters by their names, as in a machine file."""

from __future__ import annotations

from flexopt.foundation.quantities import ANGLE_MAX, COORDINATE_MAX, LENGTH_MAX
from flexopt.model.machine import Parameter

# Smallest positive normal number in single precision: what must be greater than 0 is at least this.
POSITIVE = 1.1754944e-38
STIFFNESS_MAX, DAMPING_MAX, MASS_MAX, INERTIA_MAX = 1e15, 1e12, 1e9, 1e15

# By the last word of a name, as in a machine file.
_RANGES = {
    "length": (POSITIVE, LENGTH_MAX), "com": (-LENGTH_MAX, LENGTH_MAX), "com_offset": (-LENGTH_MAX, LENGTH_MAX),
    "mass": (POSITIVE, MASS_MAX), "inertia": (POSITIVE, INERTIA_MAX), "armature": (0.0, INERTIA_MAX),
    "stiffness": (POSITIVE, STIFFNESS_MAX), "damping": (0.0, DAMPING_MAX), "joint_damping": (0.0, DAMPING_MAX),
    "rest_angle": (-ANGLE_MAX, ANGLE_MAX), "gravity": (0.0, 1e3),
}  # fmt: skip
# By the last word but one, of vectors and matrices.
_ENTRIES = {"position": LENGTH_MAX, "com": LENGTH_MAX, "inertia": INERTIA_MAX}
_COUPLED = {"stiffness": STIFFNESS_MAX, "damping": DAMPING_MAX}
_BY_UNIT = {"m": COORDINATE_MAX, "rad": ANGLE_MAX}


def parameter_range(parameter: Parameter) -> tuple[float, float]:
    """Allowed range of a machine's parameter, as in a machine file."""
    *others, last = parameter.name.split(".")
    owner = others[-1] if others else ""
    if last in _RANGES:
        low, high = _RANGES[last]
        # A body may have inertia and no mass; then, and always in these, 0 is a value like others.
        may_vanish = parameter.value == 0 or parameter.name in {"base.length", "payload.mass"}
        return (min(low, 0.0) if may_vanish else low), high
    if others[:1] == ["base"] and owner in _COUPLED:
        return _RANGES[owner]
    if owner in _ENTRIES and last in {"xx", "yy", "zz"}:
        return 0.0, _ENTRIES[owner]
    # Entries of vectors and of coupled springs, rest values, and whatever else may have either sign.
    limit = _ENTRIES.get(owner) or _COUPLED.get(parameter.name.split(".")[0]) or _BY_UNIT.get(parameter.unit, 1e15)
    return -limit, limit
