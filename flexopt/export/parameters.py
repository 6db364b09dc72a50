"""The machine's parameters as inputs of C functions: allowed ranges, and how they are drawn.

In: parameters of a machine, planar or spatial. Out: `Parameters`.
"""

from __future__ import annotations

from collections.abc import Sequence

from flexopt.export.operations import Parameters
from flexopt.model.machine import Parameter
from flexopt.model.parameter_ranges import parameter_range

# How far a parameter that is 0 is drawn from it.
_AWAY_FROM_ZERO = {"m": 0.02, "rad": 0.02}


def machine_parameters(listed: Sequence[Parameter], *, single: bool) -> Parameters:
    """A machine's parameters with ranges; `single`: rounded to single precision."""
    low, high = zip(*(parameter_range(p) for p in listed), strict=True)
    names, values, units = zip(*listed, strict=True)
    spread = tuple(0.2 * abs(p.value) if p.value else _AWAY_FROM_ZERO.get(p.unit, 0.0) for p in listed)
    return Parameters(names, units, values, low, high, spread, single)
