"""Quantities over time in one pair of axes: lines, their envelopes, limits that show the run.

In: labelled samples. Out: drawn axes.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from flexopt.foundation.arrays import Vector
from flexopt.foundation.palette import colors
from flexopt.plotting.sheet import open_frame
from flexopt.simulation.behaviour import ROUNDING

STYLES = ("-", "--", "-.", ":")
# Letters that a legend has room for in a row, and what a line beside its name takes of them.
ROW, HANDLE = 48, 5
# A line has at most twice as many points: more than a column of print has dots.
BINS = 1200
# A run that ends so many times larger than it mostly was leaves its axes at the second of these multiples.
DIVERGED, SHOWN = 1e3, 5.0
# Range of the energy from which on its axis is logarithmic.
LOG_FROM = 20.0
NamedLine = tuple[str, Vector, Vector]


@dataclass(frozen=True)
class Panel:
    """What one pair of axes shows.

    Attributes:
        label: quantity and unit.
        lines: (name, time, values) each.
        rate: of their envelopes, 1/s; None: none.
        logarithmic: where that is of use.
        steps: a value holds until the next.
        colors: of a line, from its name and number; by default what stands now and what is proposed have theirs, the
            others those of the series.
    """

    label: str
    lines: tuple[NamedLine, ...]
    rate: float | None = None
    logarithmic: bool = False
    steps: bool = False
    colors: Callable[[str, int], str] | None = None


def line_color(name: str, k: int) -> str:
    """Of a line among several."""
    inks = colors()
    return {"present": inks.present, "chosen": inks.chosen}.get(name, inks.series[k % len(inks.series)])


def draw_panel(axes: Axes, panel: Panel, *, legend: bool = True) -> None:
    """Lines, envelopes, label and scale of one panel."""
    inks = colors()
    sizes = [float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values))) for _, _, values in panel.lines]
    smaller_on_top = np.argsort(np.argsort(-np.array(sizes), kind="stable"))
    for k, (name, time, values) in enumerate(panel.lines):
        color, style = (panel.colors or line_color)(name, k), STYLES[k // len(inks.series) % len(STYLES)]
        order = 2.0 + 0.01 * float(smaller_on_top[k])
        axes.plot(
            *thinned(time, values), style, color=color, linewidth=1.0, label=name, zorder=order,
            drawstyle="steps-post" if panel.steps else "default",
        )  # fmt: skip
    times = np.concatenate([time[np.isfinite(values)] for _, time, values in panel.lines])
    if times.size > 1:
        axes.set_xlim(float(times.min()), float(times.max()))
    _set_scale(axes, panel)
    if panel.rate is not None:
        # Beyond the data an envelope is cut off: it may begin far above what the transient was.
        axes.set_ylim(axes.get_ylim())
        for _, time, values in panel.lines:
            for label, curve in zip(("envelope", "_"), _envelopes(time, values, panel.rate), strict=False):
                axes.plot(*curve, "--", color=inks.muted, linewidth=0.8, label=label, zorder=4)
    axes.set_ylabel(panel.label)
    axes.locator_params(axis="x", nbins=6)
    if axes.get_yscale() == "linear":
        axes.locator_params(axis="y", nbins=5)
    open_frame(axes)
    if legend and len(panel.lines) > 1:
        columns = max(1, ROW // (max(len(name) for name, _, _ in panel.lines) + HANDLE))
        axes.legend(
            loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, frameon=False,
            borderaxespad=0.0, borderpad=0.0, handlelength=1.4, columnspacing=1.0,
        )  # fmt: skip


def draw_stack(
    figure: Figure | SubFigure, rows: Any, panels: Sequence[Panel], beside: Axes | None = None, legends: int = 100
) -> list[Axes]:
    """Panels in rows on one time axis, that `beside`, which the last one names; the first `legends` have a legend."""
    drawn: list[Axes] = []
    for row, panel in enumerate(panels):
        drawn.append(figure.add_subplot(rows[row], sharex=drawn[0] if drawn else beside))
        last = row == len(panels) - 1
        drawn[-1].tick_params(labelbottom=last)
        drawn[-1].set_xlabel("time, s" if last else "")
        draw_panel(drawn[-1], panel, legend=row < legends)
    return drawn


def _set_scale(axes: Axes, panel: Panel) -> None:
    """Limits that do not hide most of a run that flies away; logarithmic where asked for and of use."""
    sizes = [size[np.isfinite(size)] for size in (np.abs(values) for _, _, values in panel.lines)]
    sizes = [size for size in sizes if size.size]
    if not sizes:
        return
    # An energy goes with the square of the motion.
    power = 2 if panel.logarithmic else 1
    tops = [_top(size, power) for size in sizes]
    cut = max(tops) < max(float(size.max()) for size in sizes)
    # At the very start the energy may be next to nothing.
    least = min(float(np.quantile(size, 0.05)) for size in sizes)
    positive = all(bool(np.all(values[1:][np.isfinite(values[1:])] > 0)) for _, _, values in panel.lines)
    if panel.logarithmic and positive and max(tops) > LOG_FROM * least > 0:
        axes.set_yscale("log", nonpositive="mask")
        axes.set_ylim(0.5 * least, (1.0 if cut else 2.0) * max(tops))
    elif cut:
        axes.set_ylim(-max(tops), max(tops))


def _top(sizes: Vector, power: int) -> float:
    """What an axis must hold of a line: its peak, unless it comes last and is far from all before."""
    usual, most = float(np.quantile(sizes, 0.75)), float(sizes.max())
    late = int(np.argmax(sizes)) >= 0.9 * (len(sizes) - 1)
    return SHOWN**power * usual if late and most > DIVERGED**power * usual > 0 else most


def _envelopes(time: Vector, values: Vector, rate: float) -> tuple[tuple[Vector, Vector], ...]:
    """±A exp(rate t), the least that holds the second half of what is more than rounding; none where nothing moves."""
    sizes = np.where(np.isfinite(values), np.abs(values), 0.0)
    moving = np.flatnonzero(sizes > math.sqrt(ROUNDING) * sizes.max())
    half = moving[len(moving) // 2 :]
    if half.size == 0:
        return ()
    end = float(time[half[-1]])
    size = float(np.max(np.abs(values[half]) * np.exp(-rate * (time[half] - end))))
    t = np.linspace(float(time[0]), end, 200)
    # Far beyond any axis, and short of overflow.
    envelope = size * np.exp(np.minimum(rate * (t - end), 200.0))
    return (t, envelope), (t, -envelope)


def thinned(time: Vector, values: Vector) -> tuple[Vector, Vector]:
    """The samples, or the least and greatest of each of `BINS` parts, in order of time."""
    if len(values) <= 2 * BINS:
        return time, values
    edges = np.linspace(0, len(values), BINS + 1).astype(int)
    kept: list[int] = []
    for start, stop in pairwise(edges.tolist()):
        part = values[start:stop]
        finite = np.flatnonzero(np.isfinite(part))
        if finite.size == 0:
            kept.append(start)
            continue
        kept += sorted({start + int(finite[np.argmin(part[finite])]), start + int(finite[np.argmax(part[finite])])})
    return time[kept], values[kept]
