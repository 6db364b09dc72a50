"""A result as a document: its keys and units are said once, for JSON and for tables in notebooks.

In: objects of classes derived from `Result`. Out: dictionaries of plain data; rows of a table.
"""

from __future__ import annotations

import re
from abc import ABC, ABCMeta, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import fields
from functools import lru_cache
from itertools import groupby
from operator import attrgetter
from typing import Any, ClassVar, NamedTuple, cast

import numpy as np

from flexopt.foundation.arrays import Document
from flexopt.foundation.documents import json_ready
from flexopt.foundation.offered import PLUMBING
from flexopt.foundation.rendering import render

# Longer arrays are shown by their shape.
ENTRIES_SHOWN = 12
LETTERS_SHOWN = 200
# A gap between two columns of a table.
COLUMNS = re.compile(r"\S {2,}\S")


class Key(NamedTuple):
    """A key of a document, its parts outermost first; the attribute behind it; the unit, empty where there is none."""

    path: tuple[str, ...]
    attribute: str
    unit: str


class _Offered(ABCMeta):
    """Notebooks complete an object by its class's names, too."""

    def __dir__(cls) -> list[str]:
        return sorted({*super().__dir__()} - PLUMBING)


class Tabled(ABC, metaclass=_Offered):
    """What shows itself in a notebook: what it says of itself as text, and its document as a table."""

    def __dir__(self) -> list[str]:
        """What completes in a notebook."""
        return sorted({*super().__dir__()} - PLUMBING)

    @abstractmethod
    def to_dict(self) -> Document:
        """JSON-ready dictionary.

        Example:
            >>> flexopt.evaluate(flexopt.load("excavator"), (0.9929, -2.6306)).to_dict()["machine"]
            'excavator'
        """

    def _units(self, outer: str) -> Iterator[tuple[str, str]]:  # noqa: ARG002 - of those that know some
        """Names as the table has them, with their units."""
        return iter(())

    def _repr_html_(self) -> str:
        units = dict(self._units(""))
        rows = [(name, text, units.get(name, "")) for name, text in _rows(self.to_dict(), "")]
        # What is short lists the document's keys, as the table does.
        summary = [] if type(self).__repr__ is Result.shortly else repr(self).splitlines()
        # Lines of tables scroll, sentences go on in the next line.
        blocks = [
            (wide, list(lines)) for wide, lines in groupby(summary, key=lambda x: bool(COLUMNS.search(x.strip())))
        ]
        return render("foundation/templates/result.html", title=type(self).__name__, rows=rows, blocks=blocks)


class Result(Tabled):
    """What a call found.

    Attributes:
        DOCUMENT: the keys of its document in order, separated by white space: `key` of the attribute of that name or
            `key=attribute`, both with dots for what lies inside, and `[unit]` behind them where there is one. Where it
            is empty, every field.
    """

    DOCUMENT: ClassVar[str] = ""

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if "__repr__" not in cls.__dict__:
            # In place of the one that dataclasses make, which prints whole arrays.
            cls.__repr__ = Result.shortly

    def shortly(self) -> str:
        """Its class and the first of its keys on one line: what `repr` is where a class has none of its own."""
        told = type(self).__name__ + "("
        for k, (path, attribute, unit) in enumerate(self.document_keys()):
            value = attrgetter(attribute)(self)
            inside = isinstance(value, Result | dict)
            text = type(cast(object, value)).__name__ if inside else _text(json_ready(value))
            part = f"{', ' if k else ''}{'.'.join(path)}={text}{' ' + unit if unit else ''}"
            if len(told) + len(part) > LETTERS_SHOWN:
                return f"{told}, …)"
            told += "" if path == ("provenance",) else part
        return f"{told})"

    @classmethod
    def document_keys(cls) -> tuple[Key, ...]:
        """The keys of its document; every field where `DOCUMENT` says none."""
        return _keys(cls.DOCUMENT or " ".join(field.name for field in fields(cast(Any, cls))))

    def document(self) -> Document:
        """Values by their keys, arrays and results as they are."""
        found: dict[str, Any] = {}
        for (*outer, last), attribute, _ in self.document_keys():
            inside = found
            for part in outer:
                inside = inside.setdefault(part, {})
            inside[last] = attrgetter(attribute)(self)
        return found

    def to_dict(self) -> Document:
        """JSON-ready dictionary (keys as in the command line's `--json`).

        Example:
            >>> evaluation = flexopt.evaluate(flexopt.load("excavator"), (0.9929, -2.6306))
            >>> evaluation.to_dict()["joints"]
            ['boom', 'stick']
        """
        return cast(dict[str, Any], json_ready(self.document()))

    def _units(self, outer: str) -> Iterator[tuple[str, str]]:
        """Names as the table has them, with their units."""
        for path, attribute, unit in self.document_keys():
            name, value = outer + ".".join(path), attrgetter(attribute)(self)
            yield name, unit
            if isinstance(value, Result):
                yield from value._units(f"{name}.")


@lru_cache
def _keys(document: str) -> tuple[Key, ...]:
    found: list[Key] = []
    for word in document.split():
        named, _, unit = word.removesuffix("]").partition("[")
        key, _, attribute = named.partition("=")
        found.append(Key(tuple(key.split(".")), attribute or key, unit.replace("_", " ")))
    return tuple(found)


def _rows(document: Mapping[str, Any], outer: str) -> Iterator[tuple[str, str]]:
    """Names with their values as text; what is inside tables comes by itself, provenance not at all."""
    for key, value in document.items():
        if key == "provenance":
            continue
        if isinstance(value, dict) and value:
            yield from _rows(cast(dict[str, Any], value), f"{outer}{key}.")
        else:
            yield f"{outer}{key}", _text(value)


def _text(value: Any) -> str:
    """A value of a document as a cell shows it."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if not isinstance(value, list):
        return "–" if value is None else str(value)[:LETTERS_SHOWN]
    parts = cast(list[Any], value)
    if any(isinstance(part, dict) for part in parts):
        return f"{len(parts)} of them"
    sizes = np.shape(parts) if _is_regular(parts) else (len(parts),)
    if np.prod(sizes, dtype=int) > ENTRIES_SHOWN:
        return " × ".join(map(str, sizes)) + " entries"
    return "[" + ", ".join(map(_text, parts)) + "]"


def _is_regular(parts: list[Any]) -> bool:
    """Whether these are rows of as many entries each."""
    return len({len(cast(list[Any], part)) if isinstance(part, list) else -1 for part in parts}) == 1
