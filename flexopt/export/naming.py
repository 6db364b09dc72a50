"""Names, numbers and comments as C has them."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from flexopt.export.kernels import Real, single_constant
from flexopt.foundation.escapes import c_identifier, c_text
from flexopt.foundation.rendering import render

WIDTH = 118
PREFIX_MAX = 31
# Prefixes that make public names of names that the bundle's own sources or POSIX's headers have: `call_kinematics`,
# `N_PARAMETERS`, `R_OK`.
TAKEN_PREFIXES = frozenset({"bad", "call", "f", "kernel", "n", "null", "r", "si", "w", "x"})


def prefix_of(name: str) -> str:
    """The prefix of a machine's public names."""
    word = c_identifier(name)
    return (f"machine_{word}" if word in TAKEN_PREFIXES else word)[:PREFIX_MAX].rstrip("_")


def constants(names: Sequence[str]) -> list[str]:
    """Different names in upper case; what would coincide is numbered."""
    found, used = list[str](), set[str]()
    for name in names:
        word, count = c_identifier(name).upper(), 2
        unique = word
        while unique in used:
            unique, count = f"{word}_{count}", count + 1
        found.append(unique)
        used.add(unique)
    return found


def wrapped(text: str, indent: str = "") -> str:
    """Text broken into lines."""
    return textwrap.fill(text, WIDTH, initial_indent=indent, subsequent_indent=indent, break_long_words=False)


def comment(text: str, indent: str = "") -> str:
    """A block comment."""
    plain = c_text(text)
    single = f"{indent}/* {plain} */"
    if len(single) <= WIDTH:
        return single
    body = textwrap.fill(plain, WIDTH - 3, initial_indent=f"{indent}/* ", subsequent_indent=f"{indent} * ")
    return f"{body} */" if len(body.splitlines()[-1]) <= WIDTH - 3 else f"{body}\n{indent} */"


@dataclass(frozen=True)
class CWriter:
    """Writes the C of one bundle: its names and its precision.

    Attributes:
        prefix: of every public name.
        real: precision of every constant.
    """

    prefix: str
    real: Real

    @property
    def upper(self) -> str:
        """The prefix of macros and constants."""
        return self.prefix.upper()

    def number(self, value: float) -> str:
        """A constant of the bundle's precision."""
        digits = repr(float(value))
        if self.real == "double":
            return digits
        return f"-{single_constant(digits[1:])}" if value < 0 else single_constant(digits)

    def listed(self, values: Sequence[float], indent: str = "  ") -> str:
        """Constants between braces, as many on a line as fit."""
        body = ", ".join(self.number(v) for v in values)
        return f"{{\n{wrapped(body, indent + '  ')}\n{indent}}}"

    def render(self, file: str, /, **values: object) -> str:
        """A template of this room with its places filled; each may use `prefix`, `PREFIX`, `real` and what writes C."""
        shared = {"prefix": self.prefix, "PREFIX": self.upper, "real": self.real, "number": self.number}
        return render(f"export/templates/{file}", **shared, listed=self.listed, comment=comment, **values)
