"""The sheet that a picture is drawn on: its size, its letters and its colours, in one place for all pictures.

In: a function that draws a result on a `Sheet`. Out: the public function behind `plot`, with the one signature
`(result, path, *, ax, size, theme)`, which the result's `plot` finds.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import io
import os
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, FigureBase, SubFigure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.rcsetup import cycler
from matplotlib.ticker import ScalarFormatter

from flexopt.foundation.arguments import Arguments
from flexopt.foundation.boundary import ArgumentCheck, anything, public
from flexopt.foundation.palette import Palette, Theme, painted_in
from flexopt.foundation.pictures import Size, draws
from flexopt.foundation.writing import write_file

# Points that letters have on a sheet of a picture's own size, and their range on others.
LETTERS, SMALLEST, LARGEST = 9.5, 6.0, 14.0
# Width of a page of two columns and its greatest height, and of a slide, in; dots per inch of files.
PAGE, SLIDE = (7.16, 9.4), (10.0, 5.625)
# How much higher than in proportion the sheet of a page is where maps stand in rows.
ROOM = 1.12
DOTS: dict[Any, float] = {"paper": 300.0, "slide": 192.0}
DOTS_OTHERWISE = 150.0
# How often axes are placed at most: where the first cuts something, the second or third do not.
LAYOUTS = 3

Draw = Callable[..., None]
T = TypeVar("T")
Inches = tuple[float, float]


@dataclass
class Sheet:
    """What there is to draw on.

    Attributes:
        figure: the figure or the part of one; axes: the caller's own, in place of all of it.
        palette: its colours.
        size: width and height, in;  way: which of the picture's arrangements it has most room for.
    """

    figure: Figure | SubFigure
    axes: Axes | None
    palette: Palette
    size: Inches
    way: int = 0

    def only(self) -> Axes:
        """The axes of a picture that has one panel."""
        return self.axes or self.figure.add_subplot()

    def title(self, text: str) -> None:
        """Of the whole picture."""
        if self.axes is not None:
            self.axes.set_title(text)
        else:
            self.figure.suptitle(text)


def picture(
    kind: str,
    *,
    size: Callable[[Any], Inches | list[Inches]],
    panels: Callable[[Any], int] = lambda _: 2,
    check: ArgumentCheck = anything,
) -> Callable[[Draw], Callable[..., Figure]]:
    """Makes the public function of a function that draws.

    Args:
        kind: name of the class whose results are drawn; empty: of none alone.
        size: width and height that a result asks for, in; of a picture that can be arranged in several ways those of
            each, its usual one first.
        panels: how many pairs of axes the picture of a result has.
        check: of the result.
    """
    natural = size

    def decorate(draw: Draw) -> Callable[..., Figure]:
        def fits(arguments: Arguments, given: Mapping[str, Any]) -> None:
            ax = given["ax"]
            if ax is not None and given["size"] not in (None, "screen"):
                arguments.note("size", "does not go with ax, whose figure has its own", given["size"])
            if isinstance(ax, Axes) and given["result"] is not None and panels(given["result"]) > 1:
                sentence = "must be an empty Figure or SubFigure: this picture has several panels, not one"
                arguments.note("ax", sentence, ax)

        @public("plot" if kind else draw.__name__, together=fits, result=check, options=anything)
        def plot(
            result: Any,
            path: str | os.PathLike[str] | None = None,
            *,
            ax: Axes | Figure | SubFigure | None = None,
            size: Size = "screen",
            theme: Theme = "light",
            **options: Any,
        ) -> Figure:
            asked = natural(result)
            ways = asked if isinstance(asked, list) else [asked]
            inches = _inches(size, ways[0]) if ax is None else _given(ax)
            way = max(range(len(ways)), key=lambda k: _share(inches, ways[k]))
            letters = _letters_of(ax) if isinstance(ax, Axes) else _letters(inches, ways[way])
            with styled(theme, letters) as palette:
                sheet = _sheet(ax, inches, palette, way)
                draw(sheet, result, **options)
                _finish(sheet)
                whole = sheet.figure.figure
                write(whole, path, dpi=DOTS.get(size, DOTS_OTHERWISE))
            return whole

        plot.__doc__, plot.__name__, plot.__qualname__ = draw.__doc__, draw.__name__, draw.__qualname__
        plot.__module__ = draw.__module__
        return draws(kind)(plot) if kind else plot

    return decorate


class PlainTicks(ScalarFormatter):
    """Numbers beside ticks in plain letters; the power of ten of an axis stays mathematics.

    Matplotlib sets both as mathematics, which looks the same and takes a fifth of the time of a picture.
    """

    def __call__(self, x: float, pos: int | None = None) -> str:
        """A number's text."""
        return super().__call__(x, pos).removeprefix(r"$\mathdefault{").removesuffix("}$")


def open_frame(axes: Axes, axis: Literal["both", "x"] = "both") -> None:
    """A grid at the numbers of these axes, and no sides but those that have numbers or a name."""
    axes.grid(visible=True, axis=axis)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def plain_numbers(figure: Figure | SubFigure, only: Axes | None = None) -> None:
    """`PlainTicks`, with the same settings, where axes, all or some, have Matplotlib's own."""
    waiting: list[Any] = [only] if only is not None else list(figure.axes)
    while waiting:
        axes = waiting.pop()
        waiting += axes.child_axes
        for axis in (axes.xaxis, axes.yaxis):
            for which in ("major", "minor"):
                given = getattr(axis, f"get_{which}_formatter")()
                if type(given) is ScalarFormatter:
                    plain = PlainTicks()
                    vars(plain).update(vars(given))
                    getattr(axis, f"set_{which}_formatter")(plain)


@contextmanager
def styled(theme: Theme = "light", letters: float = LETTERS) -> Generator[Palette]:
    """Draw as all pictures here are drawn, whatever settings Matplotlib has read; afterwards these count again."""
    with painted_in(theme) as palette, cast(Any, matplotlib).rc_context():
        matplotlib.rcdefaults()
        cast(Any, matplotlib.rcParams).update(_settings(palette, letters))
        yield palette


def themed(draw: Callable[..., T]) -> Callable[..., T]:
    """A function that draws figures of its own, with one more keyword: `theme`, the ground that it draws them on."""

    @wraps(draw)
    def drawn(*arguments: Any, theme: Theme = "light", letters: float = LETTERS, **options: Any) -> T:
        with styled(theme, letters):
            made = draw(*arguments, **options)
            for figure in made.values() if isinstance(made, dict) else [made]:
                plain_numbers(cast(Any, figure))
            return made

    return drawn


def sized(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """As `themed`, of one figure, with one more keyword: `size`, of the sheet that it is drawn on."""
    drawn = themed(draw)

    @wraps(draw)
    def fitting(*arguments: Any, size: Size = "screen", **options: Any) -> Figure:
        figure = drawn(*arguments, **options)
        width, height = figure.get_size_inches()
        asked = float(width), float(height)
        inches = _inches(size, asked)
        if size == "paper":
            # Maps in rows keep their proportions; letters that do not shrink as much need some more height.
            inches = inches[0], min(inches[1], ROOM * asked[1] * inches[0] / asked[0])
        if inches != asked:
            figure = drawn(*arguments, letters=_letters(inches, asked), **options)
            figure.set_size_inches(inches)
        return figure

    return fitting


class SettledLayout(ConstrainedLayoutEngine):
    """The constrained layout, again where it cuts something: axes that keep their proportions shrink after it."""

    def execute(self, fig: Figure) -> None:
        """Place axes."""
        kept = [axes for axes in fig.axes if axes.get_aspect() != "auto"]
        # Axes that change their limits in place of their box would do so again.
        often = bool(kept) and not any(_gives_way(axes) for axes in kept)
        for _ in range(LAYOUTS if often else 1):
            super().execute(fig)
            if not often or not _is_cut(fig):
                return


def _is_cut(figure: Figure) -> bool:
    """Whether axes, with all that belongs to them, reach over the sheet's edge."""
    renderer, whole = cast(Any, figure)._get_renderer(), figure.bbox
    boxes = [axes.get_tightbbox(renderer) for axes in figure.axes if axes.get_visible()]
    return any(
        min(box.x0 - whole.x0, box.y0 - whole.y0, whole.x1 - box.x1, whole.y1 - box.y1) < 0 for box in boxes if box
    )


def placed_as(figure: Figure, drawn: Figure) -> None:
    """Axes and titles where they are in a figure that has been drawn and has the same contents, in other colours.

    Looking for their places takes Matplotlib as long as drawing does.
    """
    if not isinstance(drawn.get_layout_engine(), ConstrainedLayoutEngine) or drawn.subfigs:
        return
    figure.set_layout_engine("none")
    for axes, other in zip(figure.axes, drawn.axes, strict=True):
        axes.set_position(other.get_position(original=True))
        axes.set_anchor(cast(Any, other.get_anchor()))
        axes.set_box_aspect(other.get_box_aspect())
        if _gives_way(other):
            axes.set(xlim=other.get_xlim(), ylim=other.get_ylim())
    for name in ("_suptitle", "_supxlabel", "_supylabel"):
        text = getattr(drawn, name)
        if text is not None:
            getattr(figure, name).set_position(text.get_position())


def write(figure: Figure, path: str | os.PathLike[str] | None, *, dpi: float = 200) -> None:
    """Write a figure where asked; the path's ending, which the boundary has checked, chooses the format."""
    if path is None:
        return
    buffer, kind = io.BytesIO(), Path(path).suffix[1:].lower()
    with _laid_out(figure, dpi) if kind == "png" else nullcontext():
        figure.savefig(buffer, format=kind, dpi=dpi)
    write_file(path, buffer.getvalue())


class ShownFigure(Figure):
    """A figure that a notebook shows, also one that never said `%matplotlib inline`."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        with _laid_out(self, self.dpi):
            self.savefig(buffer, format="png", dpi=self.dpi)
        return buffer.getvalue()


@contextmanager
def _laid_out(figure: Figure, dpi: float) -> Generator[None]:
    """Within it axes stay where they belong in a file of points; `savefig` would draw all of it to find that out."""
    engine, canvas, dots = figure.get_layout_engine(), figure.canvas, figure.dpi
    if engine is None or not figure.axes:
        yield
        return
    try:
        figure.set_dpi(dpi)
        FigureCanvasAgg(figure)
        engine.execute(figure)
        figure.set_layout_engine("none")
        yield
    finally:
        figure.set_layout_engine(engine)
        figure.set_dpi(dots)
        figure.set_canvas(canvas)


def _inches(size: Size, asked: Inches) -> Inches:
    if isinstance(size, tuple):
        return size
    if size == "slide":
        return SLIDE
    if size == "paper":
        return PAGE[0], min(PAGE[1], asked[1] * max(0.85, min(1.0, PAGE[0] / asked[0])))
    return asked


def _given(ax: Axes | Figure | SubFigure) -> Inches:
    """What a caller's axes or figure has."""
    box = ax.bbox
    dpi = cast(Any, ax if isinstance(ax, FigureBase) else ax.get_figure()).dpi
    return max(0.1, box.width / dpi), max(0.1, box.height / dpi)


def _letters(inches: Inches, asked: Inches) -> float:
    """So large that a picture has room on another sheet as it has on its own."""
    return min(LARGEST, max(SMALLEST, LETTERS * _share(inches, asked)))


def _letters_of(ax: Axes) -> float:
    """As large as those that a caller's axes have beside them already."""
    return min(LARGEST, max(SMALLEST, float(ax.xaxis.label.get_fontsize())))


def _share(inches: Inches, asked: Inches) -> float:
    return min(inches[0] / asked[0], inches[1] / asked[1])


def _sheet(ax: Axes | Figure | SubFigure | None, inches: Inches, palette: Palette, way: int = 0) -> Sheet:
    if isinstance(ax, Axes):
        ax.set_facecolor(palette.page)
        return Sheet(cast(Any, ax.get_figure()), ax, palette, inches, way)
    if ax is not None:
        ax.set_facecolor(palette.page)
        return Sheet(ax, None, palette, inches, way)
    return Sheet(ShownFigure(figsize=inches, layout=SettledLayout()), None, palette, inches, way)


def _settings(palette: Palette, letters: float) -> dict[str, Any]:
    """Matplotlib's own, for as long as a picture is drawn."""
    thin = 0.8 * letters / LETTERS
    return {
        "font.size": letters, "axes.titlesize": "medium", "figure.titlesize": "medium", "axes.labelsize": "small",
        "xtick.labelsize": "small", "ytick.labelsize": "small", "legend.fontsize": "small",
        "legend.title_fontsize": "small", "text.color": palette.text, "axes.labelcolor": palette.text,
        "axes.titlecolor": palette.text, "xtick.color": palette.muted, "ytick.color": palette.muted,
        "xtick.labelcolor": palette.text, "ytick.labelcolor": palette.text, "axes.edgecolor": palette.muted,
        "axes.facecolor": palette.page, "figure.facecolor": palette.page, "savefig.facecolor": "auto",
        "figure.edgecolor": palette.page, "legend.facecolor": palette.page, "legend.edgecolor": palette.line,
        "legend.framealpha": 0.9, "legend.handlelength": 1.4, "legend.borderaxespad": 0.4, "grid.color": palette.grid,
        "grid.linewidth": 0.6 * thin, "axes.linewidth": thin, "xtick.major.width": thin, "ytick.major.width": thin,
        "lines.linewidth": 1.4 * thin, "axes.axisbelow": True, "axes.prop_cycle": cycler(color=list(palette.series)),
        "hatch.color": palette.muted, "axes.titlepad": 4.0, "axes.labelpad": 2.5, "axes.unicode_minus": True,
        "axes.formatter.limits": (-3, 4), "axes.formatter.use_mathtext": True, "svg.fonttype": "path",
    }  # fmt: skip


def _finish(sheet: Sheet) -> None:
    """Axes keep their colours where Matplotlib makes ticks later, or has made them before."""
    palette = sheet.palette
    plain_numbers(sheet.figure, sheet.axes)
    if sheet.axes is not None:
        _title_above_legend(sheet.axes, sheet.figure.figure)
    for axes in [sheet.axes] if sheet.axes is not None else sheet.figure.axes:
        axes.tick_params(which="both", color=palette.muted, labelcolor=palette.text)
        if sheet.axes is not None:
            width = cast(Any, matplotlib).rcParams["grid.linewidth"]
            axes.tick_params(which="both", grid_color=palette.grid, grid_linewidth=width)
        for spine in axes.spines.values():
            spine.set_edgecolor(palette.muted)
        for text in (axes.xaxis.label, axes.yaxis.label):
            if sheet.axes is not None:
                text.set_color(palette.text)
        for axis in (axes.xaxis, axes.yaxis):
            axis.get_offset_text().set(color=palette.text, fontsize="small")
    if any(_gives_way(axes) for axes in sheet.figure.axes):
        # Limits that give way to the frame change the numbers beside it, and these the frame.
        sheet.figure.figure.draw_without_rendering()


def _title_above_legend(axes: Axes, figure: Figure) -> None:
    """Where one pair of axes is all there is, the picture's title would lie on the names above the axes."""
    legend = axes.get_legend()
    if legend is None or not axes.get_title():
        return
    figure.draw_without_rendering()
    names, frame = legend.get_window_extent(), axes.get_window_extent()
    if names.y0 >= frame.y1:
        pad = (names.y1 - frame.y1) * 72.0 / figure.dpi + matplotlib.rcParams["axes.titlepad"]
        axes.set_title(axes.get_title(), pad=pad)


def _gives_way(axes: Axes) -> bool:
    """Whether limits are as wide as the frame lets them be."""
    return axes.get_adjustable() == "datalim" and axes.get_aspect() != "auto"
