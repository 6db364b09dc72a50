"""The picture of an identification: every column of the log with the fit, and its residuals below.

In: an `Identification`. Out: a figure.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import textwrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from flexopt.foundation.boundary import instance
from flexopt.foundation.escapes import mathtext
from flexopt.foundation.palette import colors
from flexopt.identification.result import FittedColumn, Identification
from flexopt.plotting.sheet import Sheet, open_frame, picture

TITLE_WIDTH = 105  # characters


def _wide(found: Identification) -> int:
    return 1 if len(found.columns) == 1 else 2


def _size(found: Identification) -> tuple[float, float]:
    return 4.6 * _wide(found) + 0.4, 2.5 * -(-len(found.columns) // _wide(found)) + 1.1


@picture(
    "Identification", size=_size, check=instance(Identification, "an Identification, from flexopt.identify for example")
)
def plot_identification(sheet: Sheet, identification: Identification) -> None:
    """Draw the samples of every column and the fit, and below them the residuals with twice their root mean square."""
    found, inks = identification, colors()
    count, wide = len(found.columns), _wide(found)
    high = -(-count // wide)
    outer = sheet.figure.add_gridspec(high, wide)
    handles: list[Any] = []
    for k, column in enumerate(found.columns):
        inner = outer[k // wide, k % wide].subgridspec(2, 1, height_ratios=[2.0, 1.0], hspace=0.05)
        top = sheet.figure.add_subplot(inner[0])
        below = sheet.figure.add_subplot(inner[1], sharex=top)
        handles = [
            *top.plot(found.time, found.measured[:, k], ".", color=inks.measured, markersize=1.8, label="log"),
            *top.plot(found.time, found.fitted[:, k], color=inks.fitted, linewidth=0.7, label="fit"),
        ]
        _style(top, f"{mathtext(column.name)}, {column.unit}")
        top.tick_params(labelbottom=False)
        _draw_residuals(below, found, k, column)
        below.set_xlabel("time, s" if k + wide >= count else "")
        below.tick_params(labelbottom=k + wide >= count)
    sheet.figure.legend(handles, ["log", "fit"], loc="outside lower right", ncols=2, frameon=False, markerscale=3)
    modes = "; ".join(mode.words for mode in found.modes)
    known = len(found.values) - len(found.unidentified)
    heading = f"{mathtext(found.before.name)}: {known} of {len(found.values)} parameters identified; {modes}"
    sheet.title(textwrap.fill(heading, TITLE_WIDTH // (3 - wide)))


def _draw_residuals(axes: Axes, found: Identification, k: int, column: FittedColumn) -> None:
    residual, inks = found.residuals[:, k], colors()
    axes.plot(found.time, residual, ".", color=inks.measured, markersize=1.5)
    for sign in (-2.0, 2.0):
        axes.axhline(sign * column.residual_rms, color=inks.muted, linewidth=0.7, linestyle="--")
    top = max(4.0 * column.residual_rms, 1.05 * float(np.nanmax(np.abs(residual))))
    axes.set_ylim(-top, top)
    _style(axes, f"{'residual' if column.white else 'coloured residual'}, {column.unit}")


def _style(axes: Axes, label: str) -> None:
    axes.set_ylabel(label)
    axes.locator_params(axis="y", nbins=4)
    open_frame(axes)
