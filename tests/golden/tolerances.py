"""How far numbers may lie from what is kept: one table by quantity name, with the reason of each loose row.

An entry may move by `relative` of itself, plus `of_largest` of the largest entry of its quantity (or of the quantity
that `scale` names, beside it in the document), plus `absolute`.
"""

from __future__ import annotations

import re
from fnmatch import fnmatchcase
from functools import cache
from typing import NamedTuple


class Tolerance(NamedTuple):
    """How far an entry of a quantity may lie from the kept one."""

    relative: float = 1e-9
    of_largest: float = 1e-11
    absolute: float = 1e-13
    scale: str = ""
    reason: str = ""


DEFAULT = Tolerance()

# The first pattern that matches "call:quantity", indices left out, counts.
TABLE: tuple[tuple[str, Tolerance], ...] = ()


@cache
def tolerance(case: str, quantity: str) -> Tolerance:
    """The tolerance of a quantity of a case."""
    plain = re.sub(r"\[\d+\]", "", quantity)
    name = f"{case.partition('-')[0]}:{plain}"
    return next((allowed for pattern, allowed in TABLE if fnmatchcase(name, pattern)), DEFAULT)
