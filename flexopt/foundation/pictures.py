"""Who draws a result: said by the room that draws, asked by results, which know nothing of pictures."""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast

from flexopt.foundation.arguments import Arguments
from flexopt.foundation.boundary import TABLE, anything, by, public, words
from flexopt.foundation.palette import THEMES, Theme

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

C = TypeVar("C", bound=Callable[..., Any])

# Imported when the first picture is asked for, because matplotlib is slow to import; it fills the table.
ROOM = "flexopt.plotting"
_DRAWN: dict[tuple[str, str], Callable[..., Any]] = {}

# Named sizes of pictures, or a width and a height within these, in.
Size = Literal["screen", "paper", "slide"] | tuple[float, float]
SIZES = ("screen", "paper", "slide")
INCHES = (2.0, 60.0)


def check_size(value: Any) -> Size:
    """One of the named sizes, or (width, height)."""
    if isinstance(value, str) and value in SIZES:
        return cast(Size, value)
    if isinstance(value, list | tuple) and len(cast(list[Any], value)) == 2:
        given = cast(list[Any], value)
        if all(type(x) in (int, float) and INCHES[0] <= x <= INCHES[1] for x in given):
            return float(given[0]), float(given[1])
    listed = ", ".join(f'"{word}"' for word in SIZES)
    raise ValueError(f"must be one of {listed}, or (width, height), each {INCHES[0]:g} to {INCHES[1]:g} in")


def picture_place(arguments: Arguments, field: str, value: Any) -> Any:
    """An Axes of the plane, or a figure that is empty."""
    from matplotlib.axes import Axes  # noqa: PLC0415  (slow to import)
    from matplotlib.figure import FigureBase  # noqa: PLC0415

    if isinstance(value, FigureBase):
        if value.axes or value.subfigs:
            arguments.note(field, "must be an empty Figure or SubFigure: this one has axes or parts already", value)
    elif not isinstance(value, Axes):
        arguments.note(field, "must be a matplotlib Axes, Figure or SubFigure", value)
    elif value.name != "rectilinear":
        arguments.note(field, "must have plain axes, not a projection", value.name)
    return value


TABLE.update(ax=picture_place, size=by(check_size), theme=words(*THEMES))


def draws(kind: str, form: str = "picture") -> Callable[[C], C]:
    """Marks the function that draws results of the class of that name; names are unique over the package."""

    def decorate(function: C) -> C:
        _DRAWN[kind, form] = function
        return function

    return decorate


def drawers() -> dict[tuple[str, str], Callable[..., Any]]:
    """All of them: (class, form) -> function."""
    import_module(ROOM)
    return dict(_DRAWN)


def drawn(result: object, *arguments: Any, form: str = "picture", **options: Any) -> Any:
    """What the function for that result makes of it."""
    table = drawers()
    kind = next(kind.__name__ for kind in type(result).__mro__ if (kind.__name__, form) in table)
    return table[kind, form](result, *arguments, **options)


class Pictured:
    """A result with one picture; its own class says what is on it."""

    # Who draws checks them, all together with what the picture of this result is like.
    @public(path=anything, ax=anything, size=anything, theme=anything)
    def plot(
        self,
        path: str | os.PathLike[str] | None = None,
        *,
        ax: Axes | Figure | SubFigure | None = None,
        size: Size = "screen",
        theme: Theme = "light",
    ) -> Figure:
        """Draw it; what the picture shows, the class says.

        Args:
            path: file to write, `.png`, `.svg` or `.pdf`; none by default.
            ax: what to draw on in place of a new figure: for a picture of one panel an Axes, for any an empty Figure or
                SubFigure, best one with `layout="constrained"`.
            size: `"screen"`, as large as its content asks for; `"paper"`, as wide as a page of two columns, 7.16 in, at
                300 dots per inch; `"slide"`, 16:9, 1920 × 1080 dots; or (width, height), in. Letters shrink with it.
            theme: `"light"` or `"dark"` ground.

        Returns:
            A matplotlib Figure, of `ax` the one that it belongs to.

        Raises:
            InputError: unusable arguments, or an Axes for several panels.
            WriteError: the file cannot be written.

        Example:
            >>> run = flexopt.simulate(flexopt.load("excavator"), (0.9929, -2.6306), duration=1.0)
            >>> figure = run.plot("run.png", size="slide", theme="dark")
        """
        return drawn(self, path, ax=ax, size=size, theme=theme)
