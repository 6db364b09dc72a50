"""What a caller passes as plain Python: NumPy's numbers and arrays, and any object at all, read without a raw error."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import PurePath
from typing import Any, cast

import numpy as np

# More lists and tables than this, deeper ones, or the same ones more often, are nothing that anybody means.
PARTS_MAX, DEPTH_MAX, REPEATS_MAX = 1_000_000, 64, 10_000
SHOWN = 60
# Read as they are, before anything else is asked: most parts of long lists are these.
NUMBERS_AND_TEXTS = frozenset((type(None), bool, int, float, str))


class Unreadable:
    """Stands where a part of a table could not be read; `sentence` says why."""

    def __init__(self, sentence: str) -> None:
        self.sentence = sentence

    def __repr__(self) -> str:
        return f"<{self.sentence}>"


def plain(value: Any) -> Any:
    """Numbers, lists, tuples and dictionaries of Python's own from those and NumPy's, all the way down; else `value`.

    Raises:
        ValueError: it contains itself, is too deep or too large, or cannot be read; the sentence says which.
    """
    if value is None or isinstance(value, bool | int | float | str):
        return cast(Any, value).item() if isinstance(value, np.generic) else value
    reader = _Reader()
    read = reader.read(value)
    if reader.sentences:
        raise ValueError(reader.sentences[0])
    return read


def plain_table(value: Any) -> Any:
    """As `plain`, with lists as tuples, as frozen tables hold them, and `Unreadable` in place of what is."""
    return _Reader(tuples=True).read(value)


class _TooMuchError(Exception):
    """Of lists and tables."""


class _Reader:
    """Remembers in what it is, counts, and notes what it cannot read."""

    def __init__(self, *, tuples: bool = False, most: int = PARTS_MAX) -> None:
        self.tuples, self.most = tuples, most
        self.inside, self.parts = set[int](), 0
        # Of every list and table: itself, so that its id stays its own; of lists what they read as, at which depth, in
        # how many parts. One that is met again is not read again; tables are, so that each is a table of its own.
        self.seen: dict[int, tuple[Any, Any, int, int]] = {}
        self.sentences: list[str] = []

    def read(self, value: Any) -> Any:
        try:
            return self._read(value)
        except _TooMuchError:
            # The whole part of the outermost table goes, and the others stay.
            if len(self.inside) > 1:
                raise
            self.parts = 0
            return self._unreadable("holds too many lists and tables, or too deep ones")
        except Exception as error:  # noqa: BLE001, RUF100  # a foreign object's own methods raise whatever they like
            return self._unreadable(f"cannot be read ({type(error).__name__})")

    def _unreadable(self, sentence: str) -> Unreadable:
        self.sentences.append(sentence)
        return Unreadable(sentence)

    def _read(self, value: Any) -> Any:
        if type(value) in NUMBERS_AND_TEXTS:
            return value
        if isinstance(value, (np.ndarray, np.generic)):
            array = cast(Any, value)
            value = array.tolist()
            if isinstance(value, np.floating):  # extended precision
                return float(cast(Any, value))
            if array.dtype.kind != "O":
                return _tuples(value) if self.tuples else value
        table = type(value) is not list and isinstance(cast(object, value), Mapping)
        # Named tuples and the like are objects of their own.
        if not table and not isinstance(value, list) and type(value) is not tuple:
            return value
        value = cast(Any, value)
        own = id(value)
        if own in self.inside:
            return self._unreadable("contains itself")
        _, known, depth, size = self.seen.get(own, (None, None, -1, 1))
        again, before = len(self.inside) <= depth, self.parts
        self.parts += size if again else 1
        self.seen.setdefault(own, (value, None, -1, 1))
        if len(self.inside) == DEPTH_MAX or self.parts > min(self.most, len(self.seen) + REPEATS_MAX):
            raise _TooMuchError
        if again:
            return known
        self.inside.add(own)
        try:
            found = self._table(dict(value)) if table else self._list(value)
        finally:
            self.inside.remove(own)
        if not table:
            self.seen[own] = value, found, len(self.inside), self.parts - before
        return found

    def _list(self, value: Any) -> Any:
        parts = [part if type(part) in NUMBERS_AND_TEXTS else self.read(part) for part in value]
        return parts if isinstance(value, list) and not self.tuples else tuple(parts)

    def _table(self, table: dict[Any, Any]) -> Any:
        for key in table:
            if not isinstance(key, str):
                return self._unreadable(f"has a key that is no text: {shown(key)}")
        return {key: self.read(part) for key, part in table.items()}


def _tuples(value: Any) -> Any:
    """An array's lists as tuples."""
    return tuple(map(_tuples, cast(list[Any], value))) if isinstance(value, list) else value


def counted(count: int, one: str, many: str = "") -> str:
    """A number and what it counts: "1 start", "2 starts"; `many` where that is more than an s behind."""
    return f"{count} {one if count == 1 else many or one + 's'}"


def shown(value: Any) -> str:
    """A value as it is quoted in a message; of a long path its end."""
    if isinstance(value, PurePath):
        text = repr(str(value))
        return text if len(text) <= SHOWN else "'..." + text[4 - SHOWN :]
    try:
        start: Any = cast(Any, value)[:SHOWN] if isinstance(value, list | tuple | np.ndarray) else value
        text = repr(_Reader(most=10 * SHOWN).read(start))
    except Exception:  # noqa: BLE001, RUF100  # whatever it is, the message about it must come out
        text = f"<{type(cast(object, value)).__name__}>"
    return text if len(text) <= SHOWN else text[: SHOWN - 3] + "..."


def listed(names: Iterable[str]) -> str:
    """Names in a sentence: a, b and c."""
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last
