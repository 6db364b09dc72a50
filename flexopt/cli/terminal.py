"""How text reaches the terminal: how much of it, in which colours, and no wider than it is.

Files and pipes get what there is, without colours, in lines as long as they are.
"""

from __future__ import annotations

import os
import re
import shutil
import textwrap
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, TextIO

Colour = Literal["red", "yellow", "bold"]
CODES: dict[Colour, str] = {"red": "31", "yellow": "33", "bold": "1"}
# Below this width nothing is folded any more.
WIDTH_MIN = 30
GAP = re.compile(r"\S {2,}\S")
INDENT = re.compile(r"\s*")


@dataclass
class Voice:
    """What of the group's options concerns all output, and what tells, of seconds so far, how far the command is.

    `warned`: sentences of warnings that were told.
    """

    quiet: bool = False
    verbose: bool = False
    colour: bool = True
    progress: Callable[[float], None] | None = None
    warned: set[str] = field(default_factory=set[str])


VOICE = Voice()


def coloured(stream: TextIO) -> bool:
    """Whether a stream shows colours: a terminal that can, unless --no-color or NO_COLOR (no-color.org) forbids it."""
    allowed = VOICE.colour and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"
    return allowed and stream.isatty()


def painted(text: str, colour: Colour | None, stream: TextIO) -> str:
    """Text in a colour where the stream shows any."""
    return text if colour is None or not coloured(stream) else f"\x1b[{CODES[colour]}m{text}\x1b[0m"


def fitted(text: str, stream: TextIO) -> str:
    """Text folded to the terminal's width: sentences between words, tables between columns."""
    return text if not stream.isatty() else folded(text, shutil.get_terminal_size().columns)


def folded(text: str, width: int) -> str:
    """Text in lines of that width: sentences go on indented, further columns of a table below with its first again."""
    if width < WIDTH_MIN:
        return text
    lines, done = text.split("\n"), list[str]()
    while lines:
        table: list[str] = []
        while lines and GAP.search(lines[0].strip()):
            table.append(lines.pop(0))
        if table:
            done += _columns(table, width) if max(map(len, table)) > width else table
        else:
            done += _sentence(lines.pop(0), width)
    return "\n".join(done)


def _sentence(line: str, width: int) -> list[str]:
    if len(line) <= width:
        return [line]
    found = INDENT.match(line)
    indent = found[0] if found else ""
    words = textwrap.TextWrapper(
        width, initial_indent=indent, subsequent_indent=f"{indent}    ", break_long_words=False, break_on_hyphens=False
    )
    return words.wrap(line.strip())


def _columns(table: list[str], width: int) -> list[str]:
    """A table in parts, one below the other; lines alone where no gap goes through all."""
    longest = max(map(len, table))
    padded = [line.ljust(longest) for line in table]
    gutters = [k for k in range(2, longest) if all(line[k - 2 : k] == "  " for line in padded)]
    # What a line is about stands before every part of it, and parts without anything are left out.
    first = next((k for k in gutters if any(line[:k].strip() for line in padded)), 0)
    first = first if first <= width // 3 else 0
    parts: list[list[str]] = []
    start = 0
    while longest - start > (room := width - (first or 4 if parts else 0)):
        ends = [k for k in gutters if start < k <= start + room and any(line[start:k].strip() for line in padded)]
        if not ends and not parts:
            return [part for line in table for part in _sentence(line, width)]
        if not ends:
            break  # words behind the numbers, which no gap goes through: they go on in lines of their own
        parts.append([line[start : ends[-1]] for line in padded])
        start = ends[-1]
    parts.append([line[start:] for line in padded])
    lines = [*parts[0]]
    for part in parts[1:]:
        for line, rest in zip(padded, part, strict=True):
            if rest.strip() or not first:
                before = line[:first] or "    "
                told = [rest] if len(before + rest.rstrip()) <= width else textwrap.wrap(rest, width - len(before))
                lines += [(before if k == 0 else " " * len(before)) + words for k, words in enumerate(told)]
    return [line.rstrip() for line in lines]
