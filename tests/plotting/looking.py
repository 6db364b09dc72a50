"""What is wrong with a picture, told by Matplotlib's own boxes: texts on each other, texts cut off, axes without units."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import combinations
from typing import Any

from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

# Letters may touch each other's empty borders by so many points.
TOUCH = 1.0
UNITS = (
    "–", "m", "mm", "rad", "mrad", "s", "ms", "Hz", "1/s", "m/s", "rad/s", "N m", "kN m", "kN", "kJ", "N", "J", "kg", "N/m", "N s/m", "N m/rad",
    "N m s/rad", "1/kg", "1/(kg m²)", "mixed units", "own unit", "SI", "by rank", "by number", "m (inertial frame)",
    "m (workspace frame)", "kN m or kN", "N m or N",
)  # fmt: skip


def without_pictures(page: str) -> str:
    """A page without its pictures' own letters, in which any word of four letters stands sooner or later."""
    return re.sub(r"data:image/png;base64,[A-Za-z0-9+/=]+", "", page)


def drawn(figure: Figure) -> Any:
    """The renderer, after everything has its place; a figure is drawn once."""
    canvas = figure.canvas
    if getattr(canvas, "renderer", None) is None:
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
    return canvas.get_renderer()


def texts(figure: Figure) -> Iterator[Text]:
    """All that is visible and has letters."""

    def walk(artist: Artist) -> Iterator[Text]:
        if not artist.get_visible():
            return
        if isinstance(artist, Text) and artist.get_text().strip():
            yield artist
        for child in artist.get_children():
            yield from walk(child)

    return walk(figure)


def faults(figure: Figure) -> list[str]:
    """Pairs of texts that overlap, and texts beyond the figure's edge."""
    renderer = drawn(figure)
    touch = TOUCH * figure.dpi / 72
    boxes, hidden = [], _beyond(figure)
    for text in texts(figure):
        if getattr(text, "annotation_clip", False) and not text._check_xy(renderer):  # beyond its axes: not drawn
            continue
        if id(text) in hidden:
            continue
        boxes.append((text.get_text(), text.get_window_extent(renderer)))
    found = [
        f"{a!r} on {b!r}"
        for (a, one), (b, other) in combinations(boxes, 2)
        if min(one.x1, other.x1) - max(one.x0, other.x0) > touch
        and min(one.y1, other.y1) - max(one.y0, other.y0) > touch
    ]
    edge = figure.bbox
    found += [
        f"{name!r} cut off"
        for name, box in boxes
        if box.x0 < edge.x0 - touch or box.y0 < edge.y0 - touch or box.x1 > edge.x1 + touch or box.y1 > edge.y1 + touch
    ]
    return found


def _all_axes(figure: Figure) -> list[Any]:
    """The axes with the scales of colours beside them."""
    return [*figure.axes, *(bar for axes in figure.axes for bar in axes.child_axes)]


def _beyond(figure: Figure) -> set[int]:
    """Labels of ticks beyond the limits, which Matplotlib keeps but does not draw."""
    found = set[int]()
    for axes in _all_axes(figure):
        for axis in (axes.xaxis, axes.yaxis):
            shown = {id(tick) for tick in axis._update_ticks()}
            for tick in (*axis.majorTicks, *axis.minorTicks):
                if id(tick) not in shown:
                    found |= {id(tick.label1), id(tick.label2)}
    return found


def without_units(figure: Figure) -> list[str]:
    """Labels of axes that show numbers and do not end in a unit, a comma before it; axes that have no label at all."""
    drawn(figure)
    found = []
    for axes in _all_axes(figure):
        for name, axis in (("x", axes.xaxis), ("y", axes.yaxis)):
            numbers = any(label.get_text() for label in axis.get_ticklabels() if label.get_visible())
            if not numbers or not axis.get_visible():
                continue
            label = axis.get_label().get_text() or _shared(figure, axes, name)
            unit = re.sub(r"^\$10\^\{-?\d+\}\$ ?", "", label.rpartition(", ")[2])
            unit = f"1{unit}" if unit.startswith("/") else unit
            if not label or (unit not in UNITS and re.search(r"\b(m|rad|s|Hz)\b", unit) is None):
                found.append(f"{name} axis {label!r} of {axes.get_title() or axes.get_title('left')!r}")
    return found


def _shared(figure: Figure, axes: Any, name: str) -> str:
    """The label of the outermost panel in the same column (row), which stands for all."""
    place = axes.get_subplotspec()
    if place is None:
        return ""
    for other in figure.axes:
        spec = other.get_subplotspec()
        if spec is None or spec.get_gridspec() is not place.get_gridspec():
            continue
        same = spec.colspan == place.colspan if name == "x" else spec.rowspan == place.rowspan
        label = other.get_xlabel() if name == "x" else other.get_ylabel()
        if same and label:
            return label
    return ""
