"""Pictures of bands: for each of several choices what a measure is between, over all that is uncertain.

In: names with their least, nominal and greatest values. Out: figures, one for each measure, or one for all.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.markers import CARETLEFT

from flexopt.foundation.escapes import TITLE_MAX, mathtext
from flexopt.foundation.palette import colors
from flexopt.plotting.sheet import SettledLayout, Sheet, open_frame, picture, themed
from flexopt.plotting.ticks import DECADES, between_powers, digits_of, shown
from flexopt.plotting.units import labelled

# Ratio of the largest to the least from which an axis is logarithmic.
LOG_FROM = 20.0
WIDTH = 3.9  # inches
# Panels of a verdict beside each other: below each other, or in rows on a sheet that is wider than high.
COLUMNS = (1, 2, 3)
LETTERS = 12  # of a title, on an inch
TOP = -0.6  # of a panel: half a row and a little above its first
BELOW = 0.25  # of what an axis shows, where bars go on below it
VEIL = 0.16  # of the colour of what grows, over where it does


@dataclass(frozen=True)
class Row:
    """A choice: its name, the measure's least, nominal and greatest value; what is written of its worst.

    NaN is a value that there is none of, +∞ one without a border, −∞ one below any axis, at whose end `worst` stands,
    too. `border`: its own, in place of that of all.
    """

    name: str
    least: float
    nominal: float
    greatest: float
    worst: str
    border: float | None = None


@dataclass(frozen=True)
class Bands:
    """One measure of every choice.

    Attributes:
        label: quantity;  unit: its unit, empty where it is the gains' own.
        more: whether more of it is better; None: neither.
        rows: the choices;  present, told: names of the present one, and of the one that is told of.
        heading: above the texts.
        border: below it the loop is not stable, and what is written there; None: there is no such value.
    """

    label: str
    unit: str
    more: bool | None
    rows: tuple[Row, ...]
    present: str
    told: str
    border: tuple[float, str] | None = None
    heading: str = "worst"


@themed
def plot_band(bands: Bands) -> Figure:
    """One measure."""
    figure = Figure(figsize=(WIDTH, _height(bands)), layout=SettledLayout())
    _draw(figure.add_subplot(), bands)
    return figure


@picture("Verdict", size=lambda answer: [_size(answer, n) for n in COLUMNS], panels=lambda answer: len(answer.bands))
def plot_verdict(sheet: Sheet, answer: Any) -> None:
    """Decay, settling, allowed gain, delay margin and base swing of every place, as bands over what is uncertain."""
    _draw_all(sheet, answer, COLUMNS[sheet.way])


@picture("", size=lambda comparison: _size(comparison, 2))
def plot_comparison(sheet: Sheet, comparison: Any) -> None:
    """Every quantity that is a number in one unit, a ring for each result, with its error where one is known."""
    _draw_all(sheet, comparison, 2)


def _size(result: Any, columns: int) -> tuple[float, float]:
    count = math.ceil(len(result.bands) / columns)
    return 1.5 * WIDTH * columns, 0.5 + count * max(map(_height, result.bands), default=1.0)


def _draw_all(sheet: Sheet, result: Any, columns: int) -> None:
    count = math.ceil(len(result.bands) / columns)
    for k, each in enumerate(result.bands):
        _draw(sheet.only() if len(result.bands) == 1 else sheet.figure.add_subplot(count, columns, k + 1), each)
    sheet.title(textwrap.fill(mathtext(result.heading, TITLE_MAX), int(LETTERS * sheet.size[0])))


def _height(bands: Bands) -> float:
    return 0.85 + 0.32 * len(bands.rows)


def _draw(axes: Axes, bands: Bands) -> None:
    """A bar from least to greatest in each row, a ring at the nominal value, and the worst as text."""
    inks = colors()
    values = [v for row in bands.rows for v in (row.least, row.nominal, row.greatest)]
    finite, borders = [v for v in values if math.isfinite(v)], _borders(bands)
    beyond, measured = -math.inf in values, bool(finite)
    finite += [at for at, _, _ in borders]
    if finite and min(finite) > 0 and max(finite) > LOG_FROM * min(finite):
        axes.set_xscale("log")
    low, high = _limits(axes, finite, beyond=beyond)
    axes.set_xlim(low, high)
    for at, first, last in borders:
        axes.fill_betweenx([first, last], low, at, color=inks.grows, alpha=VEIL, linewidth=0, zorder=0)
        axes.plot([at, at], [first, last], color=inks.grows, linewidth=0.9, zorder=1)
    if bands.border is not None:
        axes.annotate(
            f"{bands.border[1]} ", (bands.border[0], 1.0), xycoords=("data", "axes fraction"), ha="right", va="bottom",
            fontsize="x-small", color=inks.grows,
        )  # fmt: skip
    for k, row in enumerate(bands.rows):
        told = inks.chosen if row.name == bands.told else inks.other
        color = inks.present if row.name == bands.present else told
        _draw_bar(axes, k, row, color)
        weight = "bold" if row.name == bands.told else "normal"
        across = axes.get_yaxis_transform()
        axes.text(-0.03, k, row.name, transform=across, va="center", ha="right", fontsize="small", fontweight=weight)
        # Two units, of hinges and slides, are long, and stand below the axis.
        worst = row.worst.removesuffix(f" {bands.unit}") if " or " in bands.unit else row.worst
        axes.text(1.04, k, worst, transform=across, va="center", fontsize="small")
    axes.set_yticks([])
    axes.set_ylim(_bottom(bands), TOP)
    # A power of ten stands beside the axis: under its end it met the label of a narrow panel.
    axes.xaxis.get_offset_text().set_horizontalalignment("left")
    if bands.heading:
        axes.text(
            1.04, -0.75, bands.heading, transform=axes.get_yaxis_transform(), va="bottom", fontsize="x-small",
            color=inks.muted,
        )  # fmt: skip
    if not finite:
        axes.set_xticks([])
    elif beyond and not measured:
        axes.set_xticks([at for at, _, _ in borders])
    elif axes.get_xscale() == "linear":
        axes.locator_params(axis="x", nbins=5)
    elif high < DECADES * low:
        steps = between_powers(low, high, most=4)
        axes.set_xticks(steps)
        axes.set_xticks([], minor=True)
        axes.xaxis.set_major_formatter(lambda value, _: shown(value, digits_of(steps)))
    formatter = axes.xaxis.get_major_formatter()
    formatter.set_locs(axes.get_xticks().tolist())
    better, unit = "" if bands.more is None else f" ({'more' if bands.more else 'less'} is better)", bands.unit or "SI"
    # Two units are long, and a power of ten needs room beside the label: the rest is a line of its own.
    apart = bool(better) and (" or " in unit or bool(formatter.get_offset()))
    label = f"{labelled(bands.label, unit)}\n{better.strip()}" if apart else labelled(f"{bands.label}{better}", unit)
    axes.set_xlabel(label)
    open_frame(axes, "x")


def _draw_bar(axes: Axes, k: int, row: Row, color: str) -> None:
    """The bar in a row and its ring; what goes on beyond the axis has no end on it."""
    inks, (low, high) = colors(), axes.get_xlim()
    if not math.isnan(row.least) and not math.isnan(row.greatest):
        ends = [min(max(v, low), high) for v in (row.least, row.greatest)]
        inside = [end for end, v in zip(ends, (row.least, row.greatest), strict=True) if v != -math.inf]
        axes.plot(ends, [k, k], color=color, linewidth=7, solid_capstyle="butt", zorder=3)
        axes.plot(inside, [k] * len(inside), "|", color=color, markersize=11, markeredgewidth=2, zorder=3)
        if row.greatest == math.inf:
            axes.plot([high], [k], ">", color=color, markersize=9, clip_on=False, zorder=4)
        if row.least == -math.inf:
            axes.annotate(
                row.worst, (low, k), (3.0, 5.5), textcoords="offset points", va="bottom", fontsize="x-small", zorder=6
            )
        if row.greatest == -math.inf:
            axes.plot([low], [k], marker=CARETLEFT, color=color, markersize=11, zorder=4)
    if math.isfinite(row.nominal):
        axes.plot(
            [row.nominal], [k], "o", color=inks.page, markeredgecolor=inks.text, markersize=5.5,
            markeredgewidth=1.0, zorder=5,
        )  # fmt: skip


def _borders(bands: Bands) -> list[tuple[float, float, float]]:
    """Borders, and from where to where down the picture each is that of rows below each other."""
    if bands.border is None:
        return []
    common, found, done, first = bands.border[0], list[tuple[float, float, float]](), 0, TOP
    for at, rows in groupby(common if row.border is None else row.border for row in bands.rows):
        done += len([*rows])
        last = done - 0.5 if done < len(bands.rows) else _bottom(bands)
        found.append((at, first, last))
        first = last
    return found


def _bottom(bands: Bands) -> float:
    return len(bands.rows) - 0.4


def _limits(axes: Axes, finite: Sequence[float], *, beyond: bool) -> tuple[float, float]:
    """Around all values, on the axis' own scale; where it is even, around 0, too; `beyond`: with room below them."""
    if not finite:
        return 0.0, 1.0
    low, high = min(finite), max(finite)
    if axes.get_xscale() == "log":
        return low / 1.5, high * 1.5
    low, high = min(low, 0.0), max(high, 0.0)
    room = 0.06 * (high - low) or 1.0
    below = BELOW * (high - low) or 1.0
    return low - (below if beyond else room if low < 0 else 0.0), high + room
