"""flexopt's docstrings, Google style with plain prose and equations, as reStructuredText that says the same."""

from __future__ import annotations

import inspect
import re
from typing import Any

import flexopt
from flexopt.model.file_model import FileModel

SECTIONS = ("Args:", "Attributes:", "Returns:", "Raises:", "Warns:", "Yields:", "Example:")
_CODE = re.compile(r"(`[^`]*`)")
_NAME = re.compile(r"`flexopt\.(\w+)`")
# Several names with one sentence, as an entry of a section.
_NAMES = re.compile(r"^    (\*{0,2}\w+(?:, \*{0,2}\w+)+): ")
_SPECIAL = re.compile(r"([*|\\]|_(?=\W|$))")


def signature_of(*given: Any) -> tuple[str, str] | None:
    """That of calls, with types as they are written; of classes that users make objects of Sphinx's, without types.

    What calls give has no signature.
    """
    _, what, _, named, *_ = given
    if what == "class":
        made = issubclass(named, (FileModel, Exception, flexopt.Constraint, flexopt.StateSpace))
        return None if made else ("", "")
    if not callable(named):  # a property
        return None
    signature = inspect.signature(named)
    told = [each for each in signature.parameters.values() if each.name not in ("self", "cls")]
    bare = str(signature.replace(parameters=told, return_annotation=inspect.Signature.empty))
    returned = signature.return_annotation
    # Annotations are text, which Python shows in quotes.
    shown = re.sub(r""": (?:'([^']*)'|"([^"]*)")""", r": \1\2", bare)
    return shown, "" if returned is inspect.Signature.empty else str(returned)


def restructured(lines: list[str]) -> None:
    """Escape what only reStructuredText takes as markup, link public names, set equations as they stand."""
    prose = _as_prose(lines)
    lines[:] = _equations(prose)


def _as_prose(lines: list[str]) -> list[str]:
    """Escaped, doctests aside, which stand at the end."""
    first = next((k for k, line in enumerate(lines) if line.strip().startswith(">>>")), len(lines))
    told = [_NAMES.sub(_one_word, line) for line in lines[:first]]
    return [*_escaped("\n".join(told)).split("\n"), *lines[first:]]


def _one_word(entry: re.Match[str]) -> str:
    """`a/b:` for `a, b:`, which would be taken for a type and a name, or told twice; lines may still break there."""
    if entry[1].partition(",")[0] in flexopt.__all__:
        return entry[0]  # errors, each of which is linked
    joined = entry[1].replace(", ", "/\u200b")
    return f"    {joined}: "


def _escaped(text: str) -> str:
    """What stands in backticks, over ends of lines, too, is left as it is; letters may follow it."""
    parts = _CODE.split(text)
    after = [*parts[2::2], ""]
    parts[::2] = [_SPECIAL.sub(r"\\\1", part) for part in parts[::2]]
    parts[1::2] = [_linked(code) + "\\ " * next_[:1].isalpha() for code, next_ in zip(parts[1::2], after, strict=False)]
    return "".join(parts)


def _linked(code: str) -> str:
    """A public name as a reference, which the build checks; other code as it stands."""
    named = _NAME.fullmatch(code)
    return f":py:obj:`flexopt.{named[1]}`" if named and named[1] in flexopt.__all__ else f"`{code}`"


def _equations(lines: list[str]) -> list[str]:
    """Indented lines after an empty one that no section holds are shown as written."""
    found: list[str] = []
    section = False
    for k, line in enumerate(lines):
        indent = len(line) - len(line.lstrip())
        if line.strip() and not indent:
            section = line.strip() in SECTIONS
        before = lines[k - 1].strip() if k else ""
        starts = bool(line.strip()) and indent and not before and not section
        if starts and not (found and _inside(found)):
            found += ["::", ""]
        found.append(line.replace("\\", "") if indent and not section and ">>>" not in line else line)
    return found


def _inside(found: list[str]) -> bool:
    """Whether the last lines are such a block already."""
    for line in reversed(found):
        if line == "::":
            return True
        if line.strip() and not line.startswith(" "):
            return False
    return False
