"""The picture of an identification: every column of the log with the fit, and its residuals below.

In: an `Identification`. Out: a figure.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import os
import textwrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flexopt.foundation.boundary import instance, public
from flexopt.foundation.escapes import mathtext
from flexopt.foundation.pictures import draws
from flexopt.identification.result import FittedColumn, Identification
from flexopt.plotting.files import write
from flexopt.plotting.panels import COLORS

TITLE_WIDTH = 110  # characters
MEASURED, FITTED = "#9aa0a6", COLORS[0]


@draws(Identification)
@public(identification=instance(Identification, "an Identification, from flexopt.identify for example"))
def plot_identification(identification: Identification, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw the samples of every column and the fit, and below them the residuals with twice their root mean square.

    Args:
        identification: from `flexopt.identify`.
        path: file to write (`.png`, `.svg`, `.pdf`), or None.

    Raises:
        InputError: not an identification, or the file's suffix is unknown.
        WriteError: the file cannot be written.
    """
    found = identification
    count = len(found.columns)
    wide = 1 if count == 1 else 2
    high = -(-count // wide)
    figure = Figure(figsize=(4.4 * wide + 0.4, 2.5 * high + 0.8), layout="constrained")
    outer = figure.add_gridspec(high, wide)
    for k, column in enumerate(found.columns):
        inner = outer[k // wide, k % wide].subgridspec(2, 1, height_ratios=[2.0, 1.0], hspace=0.05)
        top = figure.add_subplot(inner[0])
        below = figure.add_subplot(inner[1], sharex=top)
        top.plot(found.time, found.measured[:, k], ".", color=MEASURED, markersize=1.8, label="log")
        top.plot(found.time, found.fitted[:, k], color=FITTED, linewidth=0.7, label="fit")
        _style(top, f"{mathtext(column.name)}, {column.unit}")
        top.tick_params(labelbottom=False)
        if k == 0:
            top.legend(loc="upper right", ncols=2, fontsize=7.5, frameon=False, markerscale=3)
        _draw_residuals(below, found, k, column)
        if k // wide == high - 1 or k + wide >= count:
            below.set_xlabel("time, s", fontsize=8)
    modes = "; ".join(mode.words for mode in found.modes)
    known = len(found.values) - len(found.unidentified)
    heading = f"{mathtext(found.before.name)}: {known} of {len(found.values)} parameters identified. {modes}"
    figure.suptitle(textwrap.fill(heading, TITLE_WIDTH if wide == 2 else TITLE_WIDTH // 2), fontsize=8.5)
    write(figure, path)
    return figure


def _draw_residuals(axes: Axes, found: Identification, k: int, column: FittedColumn) -> None:
    residual = found.residuals[:, k]
    axes.plot(found.time, residual, ".", color=COLORS[1], markersize=1.5)
    for sign in (-2.0, 2.0):
        axes.axhline(sign * column.residual_rms, color="#5f6368", linewidth=0.7, linestyle="--")
    top = max(4.0 * column.residual_rms, 1.05 * float(np.nanmax(np.abs(residual))))
    axes.set_ylim(-top, top)
    _style(axes, "residual" if column.white else "residual, not white")


def _style(axes: Axes, label: str) -> None:
    axes.set_ylabel(label, fontsize=8)
    axes.tick_params(labelsize=7)
    axes.grid(color="#e3e3e3", linewidth=0.5)
    axes.set_axisbelow(True)
    axes.ticklabel_format(axis="y", style="sci", scilimits=(-3, 4))
    axes.yaxis.get_offset_text().set(fontsize=7)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
