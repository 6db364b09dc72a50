"""What nobody should pass: the bad list, made anew for every call but for what takes long to make."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from decimal import Decimal
from functools import cache
from typing import Any

import numpy as np


class Raises:
    """An object whose every conversion raises."""

    def _raise(self, *_: object) -> Any:
        raise ZeroDivisionError("an object of somebody else")

    __len__ = __float__ = __int__ = __index__ = __complex__ = __iter__ = __getitem__ = __array__ = _raise
    __fspath__ = __bool__ = __eq__ = __lt__ = __abs__ = __repr__ = __str__ = _raise
    __hash__ = object.__hash__


class RaisingList(list[Any]):
    """A list that cannot be looked at."""

    def __len__(self) -> int:
        raise ZeroDivisionError("a list of somebody else")

    def __iter__(self) -> Iterator[Any]:
        raise ZeroDivisionError("a list of somebody else")


def own_list() -> list[Any]:
    """A list that contains itself, twice, so that a walk through it branches."""
    found: list[Any] = [1.0]
    found += [found, found]
    return found


def own_dict() -> dict[str, Any]:
    found: dict[str, Any] = {}
    found |= {"x": found, "kind": found}
    return found


@cache
def deep() -> list[Any]:
    found: list[Any] = [1.0]
    for _ in range(5000):
        found = [found]
    return found


def wide() -> list[Any]:
    """A few lists that are 2⁶⁰ when written out."""
    found: list[Any] = [1.0]
    for _ in range(60):
        found = [found, found]
    return found


def objects() -> Any:
    found = np.empty(2, dtype=object)
    found[0], found[1] = None, Raises()
    return found


BAD: dict[str, Callable[[], Any]] = {
    "None": lambda: None,
    "nan": lambda: float("nan"),
    "inf": lambda: float("inf"),
    "-inf": lambda: -float("inf"),
    "1e308": lambda: 1e308,
    "-1e308": lambda: -1e308,
    "2**63": lambda: 2**63,
    "10**400": lambda: 10**400,
    "10**5000": lambda: 10**5000,
    "complex": lambda: 1j,
    "True": lambda: True,
    "text": lambda: "nothing of the kind",
    "empty text": lambda: "",
    "empty list": list,
    "empty dict": dict,
    "empty array": lambda: np.zeros(0),
    "ragged": lambda: [[1.0, 2.0], [3.0]],
    "wrong length": lambda: [0.1] * 17,
    "nan in a list": lambda: [0.1, float("nan")],
    "10**400 in a list": lambda: [0.1, 10**400],
    "text in a list": lambda: ["a", "b"],
    "None in a list": lambda: [None, None],
    "million letters": lambda: "x" * 1_000_000,
    "million slashes": lambda: "/" * 1_000_000,
    "NUL": lambda: "a\0b",
    "surrogate": lambda: "a\ud800b",
    "contains itself": own_list,
    "dict contains itself": own_dict,
    "dict of numbers": lambda: {1: 2.0},
    "deep": deep,
    "wide": wide,
    "bytes": lambda: b"bytes",
    "set": lambda: {1.0, 2.0},
    "class": lambda: int,
    "object": object,
    "raises": Raises,
    "raising list": RaisingList,
    "raises in a list": lambda: [Raises(), Raises()],
    "Decimal": lambda: Decimal(1),
    "array of text": lambda: np.array(["a", "b"]),
    "array of complex": lambda: np.array([1j, 1.0]),
    "array of objects": objects,
    "array of bool": lambda: np.array([True, False]),
    "array of dates": lambda: np.array(["2020-01-01", "2020-01-02"], dtype="datetime64[D]"),
    "array of nan": lambda: np.array([np.nan, 1.0]),
    "masked": lambda: np.ma.array([1.0, 2.0], mask=[True, False]),
    "array of many dimensions": lambda: np.zeros((2, 1, 2, 1, 2)),
}
