"""The picture of a sensitivity: for each output what every uncertain number explains, alone and in all.

In: a `Sensitivity`. Out: a figure.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from flexopt.foundation.escapes import mathtext
from flexopt.foundation.palette import colors
from flexopt.loop.sensitivity import Sensitivity
from flexopt.plotting.sheet import Sheet, open_frame, picture
from flexopt.plotting.units import labelled

WIDE = 3
# Of the bars' whiskers; on sheets narrower than this, in, the legend has two rows.
INTERVAL, NARROW = "95 % interval", 6.0


def _grid(found: Sensitivity) -> tuple[int, int]:
    columns = min(len(found.outputs), WIDE)
    return -(-len(found.outputs) // columns), columns


def _size(found: Sensitivity) -> tuple[float, float]:
    rows, columns = _grid(found)
    return 3.6 * columns + 1.2, (1.1 + 0.55 * len(found.names)) * rows + 0.9


@picture("Sensitivity", size=_size, panels=lambda found: len(found.outputs))
def plot_sensitivity(sheet: Sheet, found: Sensitivity) -> None:
    """Draw first-order and total indices with their intervals, and the bounds that slopes give."""
    count, (rows, columns), inks = len(found.outputs), _grid(found), colors()
    at, panels, halo = np.arange(len(found.names)), list[Axes](), withStroke(linewidth=2.4, foreground=inks.halo)
    for k in range(count):
        panel = sheet.only() if count == 1 else sheet.figure.add_subplot(rows, columns, k + 1)
        panels.append(panel)
        for values, interval, shift, color, label in (
            (found.first[k], found.first_interval[k], -0.18, inks.series[0], "alone"),
            (found.total[k], found.total_interval[k], 0.18, inks.series[2], "in all"),
        ):
            error = np.abs(interval.T - values)
            style = {"ecolor": inks.text, "elinewidth": 0.8, "capsize": 2}
            bars = panel.barh(at + shift, values, 0.34, color=color, xerr=error, error_kw=style, label=label)
            # Half of a whisker lies on its bar, which is about as dark.
            _, caps, lines = bars.errorbar.lines  # pyright: ignore[reportOptionalMemberAccess]
            for part in (*caps, *lines):
                part.set_path_effects([halo])
        # Far bounds say nothing: an index is at most 1.
        shown = np.where(found.bound[k] <= 1.5, found.bound[k], np.nan)
        panel.plot(
            shown, at + 0.18, "|", color=inks.text, markersize=13, path_effects=[halo], label="at most, by slopes"
        )
        panel.set_title(f"{found.outputs[k]}: {mathtext(found.said[k])}")
        panel.set_yticks([])
        if k % columns == 0:
            for place, name in enumerate(found.names):
                across = panel.get_yaxis_transform()
                panel.text(-0.03, place, mathtext(name), transform=across, va="center", ha="right", fontsize="small")
        ends = np.stack([found.first_interval[k], found.total_interval[k]])
        panel.set_xlim(float(np.nanmin(ends, initial=0.0)) - 0.02, float(np.nanmax(ends, initial=1.0)) + 0.05)
        panel.set_xlabel(labelled("share of the variance", ""))
        panel.set_ylim(len(found.names) - 0.4, -0.6)
        open_frame(panel, "x")
    if sheet.axes is None:
        # One name for the whiskers of both kinds of bars.
        panels[0].errorbar([], [], xerr=[], fmt="none", ecolor=inks.text, elinewidth=0.8, capsize=2, label=INTERVAL)
        handles, labels = panels[0].get_legend_handles_labels()
        columns = 4 if sheet.size[0] >= NARROW else 2
        sheet.figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)
    sheet.title(f"{mathtext(found.machine)}: what matters most")
