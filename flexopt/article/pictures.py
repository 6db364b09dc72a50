"""Figures 5 to 8 of the article in its arrangement, and the distance of the rigid plant from the full one.

In: datasets of workspace maps, curves along a height, a sweep of gaps, arms as points. Out: matplotlib figures.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flexopt.article.curves import Curve
from flexopt.article.gaps import GapSweep
from flexopt.foundation.arrays import Array
from flexopt.foundation.palette import colors
from flexopt.plotting.fields import LOWEST_SHOWN, array_of, draw_arms, draw_field, draw_regions, label_plane
from flexopt.plotting.sheet import SettledLayout, sized
from flexopt.plotting.units import labelled
from flexopt.plotting.workspace import dataset_plane
from flexopt.robustness.residues import residue_unit, written_unit

Arms = Mapping[str, Array]
# What an upright name may take up, of the width of a curve.
NAMED = 0.1


def _branch(dataset: Any) -> str:
    """Which of the two postures of each end-point a map is of, for a title."""
    return f", elbow {dataset.attrs['elbow']}"


@sized
def plot_figure5(inverse: Any, arms: Arms) -> Figure:
    """In-phase regions of modes 1 to 3, and the first two together (their intersection)."""
    plane, in_phase = dataset_plane(inverse), array_of(inverse, "in_phase")
    figure = Figure(figsize=(9.0, 9.0), layout=SettledLayout())
    panels = [*in_phase[:3], in_phase[0] * in_phase[1]]
    titles = ["(a) mode 1", "(b) mode 2", "(c) mode 3", "(d) modes 1 and 2 (intersection)"]
    for k, (title, values) in enumerate(zip(titles, panels, strict=True)):
        axes = figure.add_subplot(2, 2, k + 1)
        draw_regions(axes, plane, values)
        draw_arms(axes, arms)
        label_plane(axes, plane, title, left=k % 2 == 0, bottom=k > 1)
    figure.suptitle(f"Fig. 5: in phase (yellow) and out of phase (blue), Jacobian inverse control{_branch(inverse)}")
    return figure


@sized
def plot_figure6(transpose: Any, inverse: Any, arms: Arms) -> Figure:
    """ε_max over the workspace."""
    figure = Figure(figsize=(11.0, 4.9), layout=SettledLayout())
    for k, (title, dataset) in enumerate((("(a) Jacobian transpose", transpose), ("(b) Jacobian inverse", inverse))):
        axes, plane = figure.add_subplot(1, 2, k + 1), dataset_plane(dataset)
        draw_field(axes, plane, array_of(dataset, "epsilon_max"), label=labelled("$\\epsilon_{max}$", ""), clipped=True)
        draw_arms(axes, arms)
        gain = f"kr = {dataset.attrs['gain']:.4g} {dataset.attrs['gain_unit']}"
        label_plane(axes, plane, f"{title}, {gain}", left=k == 0)
    figure.suptitle(f"Fig. 6: $\\epsilon_{{max}}$ over the workspace{_branch(inverse)}")
    return figure


@sized
def plot_figure7(transpose: Any, inverse: Any) -> Figure:
    """w_i over the workspace: a row for each control, a column for each mode."""
    figure = Figure(figsize=(13.0, 7.6), layout=SettledLayout())
    for row, (control, dataset) in enumerate((("transpose", transpose), ("inverse", inverse))):
        plane, w, frequency = dataset_plane(dataset), array_of(dataset, "w"), array_of(dataset, "frequency_hz")
        unit = dataset["w"].attrs["units"]
        for mode in range(len(w)):
            axes = figure.add_subplot(2, len(w), row * len(w) + mode + 1)
            draw_field(axes, plane, w[mode], label=labelled("$w_i$", unit), clipped=True)
            letter = "abcdefghij"[row * len(w) + mode]
            title = f"({letter}) {control}: $w_{mode + 1}$, mean {np.nanmean(frequency[mode]):.4f} Hz"
            label_plane(axes, plane, title, left=mode == 0, bottom=row == 1)
    shown = "(0 is best; the lowest twentieth in one colour)"
    figure.suptitle(f"Fig. 7: $w_i$ over the workspace{_branch(inverse)} {shown}")
    return figure


@sized
def plot_figure8(transpose: Curve, inverse: Curve, marks: Mapping[str, float]) -> Figure:
    """ε_max and w_1 along one height, with the end-points `marks` (name -> x, m) as thin lines."""
    inks = colors()
    epsilon_color, w_color = inks.series[0], inks.series[1]
    figure = Figure(figsize=(12.5, 4.6), layout=SettledLayout())
    for k, (title, curve) in enumerate((("(a) Jacobian transpose", transpose), ("(b) Jacobian inverse", inverse))):
        left = figure.add_subplot(1, 2, k + 1)
        right = left.twinx()
        _along(left, curve, curve.epsilon_max, epsilon_color, "$\\epsilon_{max}$", "-")
        _along(right, curve, curve.w[0], w_color, "$w_1$", "--")
        right.ticklabel_format(axis="y", style="sci", scilimits=(0, 0))
        left.set_ylabel("$\\epsilon_{max}$, –", color=epsilon_color)
        right.set_ylabel(f"$w_1$, {written_unit(residue_unit(curve.control, ('rad',)))}", color=w_color)
        left.set_xlabel(f"x of the end-point, m (workspace frame, y = {curve.y:g} m)")
        left.set_title(title)
        left.axhline(np.sin(np.pi / 8), color=colors().muted, linewidth=0.8, linestyle=":", zorder=0)
        room = NAMED * float(np.ptp(curve.x))
        for name, x in marks.items():
            left.axvline(x, color=inks.mark, linewidth=0.9, alpha=0.75, zorder=0)
            # On its left where on its right the next line is.
            before = any(0 < other - x < room for other in marks.values())
            left.annotate(
                name, (x, 0.02), xycoords=("data", "axes fraction"), xytext=(-3 if before else 3, 0),
                textcoords="offset points", color=inks.mark, rotation=90, va="bottom", ha="right" if before else "left",
            )  # fmt: skip
    # Below both panels: in them curves and marks are everywhere.
    lines = [axes.lines[0] for axes in figure.axes[:2]]
    figure.legend(lines, [str(line.get_label()) for line in lines], loc="outside lower center", ncols=2)
    figure.suptitle("Fig. 8: measures along $y_d$, elbow up (dotted: sin π/8)")
    return figure


def _along(axes: Axes, curve: Curve, values: Array, color: str, label: str, style: str) -> None:
    """A curve, broken where the arm does not reach; its axis leaves out the lowest few points."""
    steps = np.diff(curve.x)
    broken = np.insert(values.astype(float), np.flatnonzero(steps > 2 * np.median(steps)) + 1, np.nan)
    x = np.insert(curve.x.astype(float), np.flatnonzero(steps > 2 * np.median(steps)) + 1, np.nan)
    axes.plot(x, broken, style, color=color, linewidth=1.7, label=label)
    shown = values[curve.regular & np.isfinite(values)]
    low, high = float(np.quantile(shown, LOWEST_SHOWN)), float(shown.max())
    axes.set_ylim(low - 0.12 * (high - low), high + 0.08 * (high - low))


@sized
def plot_gaps(sweep: GapSweep) -> Figure:
    """ν-gap between rigid and full plant, and ε_max, as the damping grows; robust postures and others."""
    figure = Figure(figsize=(12.0, 4.6), layout=SettledLayout())
    panels: Sequence[tuple[str, Array]] = (("ν-gap to the rigid plant", sweep.nu_gap),
                                           ("$\\epsilon_{max}$", sweep.epsilon_max))  # fmt: skip
    for k, (label, values) in enumerate(panels):
        axes = figure.add_subplot(1, 2, k + 1)
        for name, row in zip(sweep.names, values, strict=True):
            special = not name.startswith("optimum")
            axes.semilogx(
                sweep.factors, row, "-o" if special else "-", linewidth=1.8 if special else 1.0,
                markersize=4.5, label=name if special or name.endswith(" 1") else None,
                color=None if special else colors().other if not name.endswith(" 1") else colors().text,
            )  # fmt: skip
        axes.axhline(np.sin(np.pi / 8), color=colors().muted, linewidth=1.0, linestyle=":", zorder=0)
        axes.set_xlabel("factor of the machine's damping, –")
        axes.set_ylabel(f"{label}, –")
        axes.grid(alpha=0.25)
    figure.axes[0].legend(title="grey: further optima of $w_1$")
    figure.suptitle("Rigid plant kr R0/s² against the full one (dotted: sin π/8)")
    return figure
