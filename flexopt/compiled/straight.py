"""Cheaper straight-line code: what a compiler must not do on its own, because it changes the last bit.

In: the text of a function that CasADi generated from an SX graph, one operation a line. Out: the same with each
variable assigned once, and

- several divisions by one value as products with its reciprocal: a division costs as much as ten products. A quotient
  is then right to 1.5 ulp, and to fewer digits where the divisor is beyond 1e307 or below 1e-308;
- `(c?x:0) + (!c?y:0)`, CasADi's form of a choice, as one choice.

Text of another form (MX graphs) is returned as it is.
"""

from __future__ import annotations

import re
from collections import Counter

_DECLARED = re.compile(r"^  casadi_real a\d+(, a\d+)*;\n", re.MULTILINE)
_ASSIGNED = re.compile(r"^  (a\d+)=(.*);$")
_VARIABLE = re.compile(r"\ba\d+\b")
_QUOTIENT = re.compile(r"^\((.+)/(v\d+)\)$")
_SUM = re.compile(r"^\((v\d+)\+(v\d+)\)$")
_TERM = re.compile(r"^select\((v\d+),(v\d+),0\)$")


def streamlined(function: str) -> str:
    """The function's text, with fewer operations."""
    if not _DECLARED.search(function):
        return function
    lines, values = _assigned_once(_DECLARED.sub("", function))
    divisors = Counter(match[2] for value in values.values() if (match := _QUOTIENT.match(value)))
    result: list[str] = []
    inverted: set[str] = set()
    for line in lines:
        value = values.get(line)
        if value is None:
            result.append(line)
            continue
        quotient = _QUOTIENT.match(value)
        if quotient and divisors[quotient[2]] > 1:
            divisor = quotient[2]
            if divisor not in inverted:
                inverted.add(divisor)
                result.append(f"  const casadi_real r{divisor}=1./{divisor};")
            value = f"({quotient[1]}*r{divisor})"
        result.append(f"  const casadi_real {line}={_choice(value, values)};")
    return "\n".join(result)


def _assigned_once(function: str) -> tuple[list[str], dict[str, str]]:
    """Lines with fresh variables v1, v2, …; in place of an assignment the variable's name, its value in the dictionary."""
    lines: list[str] = []
    values: dict[str, str] = {}
    current: dict[str, str] = {}
    for line in function.splitlines():
        match = _ASSIGNED.match(line)
        text = _VARIABLE.sub(lambda name: current.get(name[0], name[0]), match[2] if match else line)
        if match:
            name = current[match[1]] = f"v{len(values)}"
            values[name] = text
            text = name
        lines.append(text)
    return lines, values


def _choice(value: str, values: dict[str, str]) -> str:
    """`value`, or one choice if it is the sum of a choice and its opposite."""
    terms = _SUM.match(value)
    first, second = (_TERM.match(values[terms[1]]), _TERM.match(values[terms[2]])) if terms else (None, None)
    if first and second:
        if values[second[1]] == f"(!{first[1]})":
            return f"select({first[1]},{first[2]},{second[2]})"
        if values[first[1]] == f"(!{second[1]})":
            return f"select({second[1]},{second[2]},{first[2]})"
    return value
