"""Who draws a result: said by the room that draws, asked by results, which know nothing of pictures."""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeVar

from flexopt.foundation.boundary import public

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
    kind = next(kind for kind in type(result).__mro__ if (kind, form) in _DRAWN)
    return _DRAWN[kind, form](result, *arguments, **options)


class Pictured:
    """A result with one picture; its own class says what is on it."""

    @public()
    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Draw it; what the picture shows, the class says.

        Args:
            path: file to write, `.png`, `.svg` or `.pdf`; none by default.

        Returns:
            A matplotlib Figure.

        Example:
            >>> run = flexopt.simulate(flexopt.load("excavator"), (0.9929, -2.6306), duration=1.0)
            >>> figure = run.plot("run.png")
        """
        return drawn(self, path)
