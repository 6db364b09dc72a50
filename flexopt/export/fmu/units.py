"""Unit texts as FMI wants them: a name without blanks and superscripts, and exponents of the base units."""

from __future__ import annotations

import re
from dataclasses import dataclass

BASE_UNITS = ("kg", "m", "s", "rad")
_DERIVED = {"N": {"kg": 1, "m": 1, "s": -2}, "J": {"kg": 1, "m": 2, "s": -2}, "Hz": {"s": -1}}
_POWERS = {"²": 2, "³": 3}


@dataclass(frozen=True)
class Unit:
    """A unit.

    Attributes:
        name: `"N.m.s/rad"`.
        exponents: of the base units, zeros left out.
    """

    name: str
    exponents: dict[str, int]


def unit_of(text: str) -> Unit:
    """The unit that a text such as `"N m s/rad"` names; several factors below the slash stand in brackets.

    Raises:
        ValueError: a factor is no unit that is known.
    """
    above, _, below = text.partition("/")
    exponents: dict[str, int] = {}
    names: list[str] = []
    for side, sign in ((above, 1), (below.strip("()"), -1)):
        factors: list[str] = []
        for word in side.split():
            match = re.fullmatch(r"([A-Za-z]+)([²³]?)", word)
            base = match and ({match[1]: 1} if match[1] in BASE_UNITS else _DERIVED.get(match[1]))
            if match is None or base is None:
                raise ValueError(f"{text!r} is no unit: {word!r} is not known")
            power = _POWERS.get(match[2], 1)
            factors.append(match[1] + (str(power) if power > 1 else ""))
            for name, exponent in base.items():
                exponents[name] = exponents.get(name, 0) + sign * power * exponent
        names.append(".".join(factors))
    upper, lower = names
    name = upper or "1"
    if lower:
        name += f"/({lower})" if "." in lower else f"/{lower}"
    return Unit(name, {name: exponent for name, exponent in exponents.items() if exponent})
