"""The picture of a sensitivity: for each output what every uncertain number explains, alone and in all.

In: a `Sensitivity`. Out: a figure.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import os

import numpy as np
from matplotlib.figure import Figure

from flexopt.foundation.boundary import instance, public
from flexopt.foundation.escapes import mathtext
from flexopt.foundation.pictures import draws
from flexopt.loop.sensitivity import Sensitivity
from flexopt.plotting.files import write
from flexopt.plotting.panels import COLORS

WIDE = 3


@draws(Sensitivity)
@public(sensitivity=instance(Sensitivity, "a Sensitivity, from flexopt.sensitivity"))
def plot_sensitivity(sensitivity: Sensitivity, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw first-order and total indices with their intervals, and the bounds that slopes give.

    Args:
        sensitivity: from `flexopt.sensitivity`.
        path: file to write (`.png`, `.svg`, `.pdf`), or None.

    Raises:
        InputError: not a sensitivity, or the file's suffix is unknown.
        WriteError: the file cannot be written.
    """
    found, count = sensitivity, len(sensitivity.outputs)
    columns = min(count, WIDE)
    rows = -(-count // columns)
    high = 1.1 + 0.55 * len(found.names)
    figure = Figure(figsize=(3.4 * columns + 0.6, high * rows + 0.7), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharey=True)
    at = np.arange(len(found.names))
    for k, panel in enumerate(axes.ravel()):
        if k >= count:
            panel.set_visible(False)
            continue
        for values, interval, shift, color, label in (
            (found.first[k], found.first_interval[k], -0.18, COLORS[0], "alone"),
            (found.total[k], found.total_interval[k], 0.18, COLORS[1], "in all"),
        ):
            error = np.abs(interval.T - values)
            style = {"ecolor": "#202124", "elinewidth": 0.8, "capsize": 2}
            panel.barh(at + shift, values, 0.34, color=color, xerr=error, error_kw=style, label=label)
        # Far bounds say nothing: an index is at most 1.
        shown = np.where(found.bound[k] <= 1.5, found.bound[k], np.nan)
        panel.plot(shown, at + 0.18, "|", color="#202124", markersize=13, label="at most, by slopes")
        said = mathtext(found.most[k]) if found.most[k] else "undecided"
        panel.set_title(f"{found.outputs[k]}: {said}", fontsize=9)
        panel.set_yticks(at, [mathtext(name) for name in found.names], fontsize=8)
        ends = np.stack([found.first_interval[k], found.total_interval[k]])
        panel.set_xlim(float(np.nanmin(ends, initial=0.0)) - 0.02, float(np.nanmax(ends, initial=1.0)) + 0.05)
        panel.set_xlabel("share of the variance", fontsize=8)
        panel.tick_params(labelsize=7.5)
        panel.grid(axis="x", color="#e3e3e3", linewidth=0.5)
        panel.set_axisbelow(True)
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
    axes[0, 0].invert_yaxis()
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    figure.suptitle(f"{mathtext(found.machine)}: what matters most", fontsize=10)
    write(figure, path)
    return figure
