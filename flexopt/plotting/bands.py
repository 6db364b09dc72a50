"""Pictures of bands: for each of several choices what a measure is between, over all that is uncertain.

In: names with their least, nominal and greatest values. Out: figures, one for each measure, or one for all.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flexopt.plotting.files import write
from flexopt.plotting.selection import CHOSEN, PRESENT

# Ratio of the largest to the least from which an axis is logarithmic.
LOG_FROM = 20.0
# Of what is neither the present choice nor the one that is told of.
PALE = 0.45
WIDTH = 3.9  # inches
GROWS, EDGE = "#f6dcd9", "#8a3a33"


@dataclass(frozen=True)
class Row:
    """A choice: its name, the measure's least, nominal and greatest value; what is written of its worst.

    NaN is a value that there is none of, infinite one without a border.
    """

    name: str
    least: float
    nominal: float
    greatest: float
    worst: str


@dataclass(frozen=True)
class Bands:
    """One measure of every choice.

    Attributes:
        label: quantity and unit;  more: whether more of it is better; None: neither.
        rows: the choices;  present, told: names of the present one, and of the one that is told of.
        heading: above the texts.
        border: below it the loop is not stable, and what is written there; None: there is no such value.
    """

    label: str
    more: bool | None
    rows: tuple[Row, ...]
    present: str
    told: str
    border: tuple[float, str] | None = None
    heading: str = "worst"


def plot_band(bands: Bands) -> Figure:
    """One measure."""
    figure = Figure(figsize=(WIDTH, _height(bands)), layout="constrained")
    _draw(figure.add_subplot(), bands)
    return figure


def plot_bands(
    bands: Sequence[Bands], path: str | os.PathLike[str] | None = None, *, title: str = "", columns: int = 1
) -> Figure:
    """All measures, in one column or several; `title` above them."""
    count = math.ceil(len(bands) / columns)
    size = 1.5 * WIDTH * columns, 0.4 + count * max(map(_height, bands), default=1.0)
    figure = Figure(figsize=size, layout="constrained")
    for k, each in enumerate(bands):
        _draw(figure.add_subplot(count, columns, k + 1), each)
    figure.suptitle(title, fontsize=10)
    write(figure, path)
    return figure


def _height(bands: Bands) -> float:
    return 0.85 + 0.32 * len(bands.rows)


def _draw(axes: Axes, bands: Bands) -> None:
    """A bar from least to greatest in each row, a ring at the nominal value, and the worst as text."""
    finite = [v for row in bands.rows for v in (row.least, row.nominal, row.greatest) if math.isfinite(v)]
    border = None if bands.border is None else bands.border[0]
    finite += [] if border is None else [border]
    if finite and min(finite) > 0 and max(finite) > LOG_FROM * min(finite):
        axes.set_xscale("log")
    low, high = _limits(axes, finite)
    axes.set_xlim(low, high)
    if bands.border is not None:
        axes.axvspan(low, bands.border[0], color=GROWS, linewidth=0, zorder=0)
        axes.axvline(bands.border[0], color=EDGE, linewidth=0.9, zorder=1)
        axes.annotate(
            f"{bands.border[1]} ", (bands.border[0], 1.0), xycoords=("data", "axes fraction"), ha="right", va="bottom",
            fontsize=7.5, color=EDGE,
        )  # fmt: skip
    for k, row in enumerate(bands.rows):
        color = PRESENT if row.name == bands.present else CHOSEN
        alpha = 1.0 if row.name in (bands.present, bands.told) else PALE
        if not math.isnan(row.least + row.greatest):
            ends = [min(max(v, low), high) for v in (row.least, row.greatest)]
            axes.plot(ends, [k, k], color=color, alpha=alpha, linewidth=7, solid_capstyle="butt", zorder=3)
            axes.plot(ends, [k, k], "|", color=color, alpha=alpha, markersize=11, markeredgewidth=2, zorder=3)
            if math.isinf(row.greatest):
                axes.plot([high], [k], ">", color=color, alpha=alpha, markersize=9, clip_on=False, zorder=4)
        if math.isfinite(row.nominal):
            axes.plot(
                [row.nominal], [k], "o", color="white", markeredgecolor="black", markersize=5.5, markeredgewidth=1.0,
                zorder=5,
            )  # fmt: skip
        axes.text(1.04, k, row.worst, transform=axes.get_yaxis_transform(), va="center", fontsize=8)
    axes.set_yticks(range(len(bands.rows)), [row.name for row in bands.rows])
    axes.set_ylim(len(bands.rows) - 0.4, -0.6)
    for tick, row in zip(axes.get_yticklabels(), bands.rows, strict=True):
        tick.set_fontweight("bold" if row.name == bands.told else "normal")
    better = "" if bands.more is None else f" ({'more' if bands.more else 'less'} is better)"
    axes.set_xlabel(f"{bands.label}{better}", fontsize=8.5)
    axes.text(
        1.04, -0.75, bands.heading, transform=axes.get_yaxis_transform(), va="bottom", fontsize=7.5, color="#555555"
    )
    axes.tick_params(labelsize=8)
    axes.xaxis.get_offset_text().set(fontsize=7.5)
    if not finite:
        axes.set_xticks([])
    elif axes.get_xscale() == "linear":
        axes.locator_params(axis="x", nbins=5)
    axes.grid(axis="x", color="#e3e3e3", linewidth=0.5)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _limits(axes: Axes, finite: Sequence[float]) -> tuple[float, float]:
    """Around all values, on the axis' own scale; where it is even, around 0, too."""
    if not finite:
        return 0.0, 1.0
    low, high = min(finite), max(finite)
    if axes.get_xscale() == "log":
        return low / 1.5, high * 1.5
    low, high = min(low, 0.0), max(high, 0.0)
    room = 0.06 * (high - low) or 1.0
    return low - (room if low < 0 else 0.0), high + room
