"""Who draws a result: said by the room that draws, asked by results, which know nothing of pictures."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any, TypeVar

C = TypeVar("C", bound=Callable[..., Any])

# Imported when the first picture is asked for, because matplotlib is slow to import; it fills the table.
ROOM = "flexopt.plotting"
_DRAWN: dict[tuple[type, str], Callable[..., Any]] = {}


def draws(kind: type, form: str = "picture") -> Callable[[C], C]:
    """Marks the function that draws results of that class."""

    def decorate(function: C) -> C:
        _DRAWN[kind, form] = function
        return function

    return decorate


def drawn(result: object, *arguments: Any, form: str = "picture", **options: Any) -> Any:
    """What the function for that result makes of it."""
    import_module(ROOM)
    return _DRAWN[type(result), form](result, *arguments, **options)
