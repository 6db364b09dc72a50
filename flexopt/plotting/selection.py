"""The picture of a selection: the machine before and after, and the measures along the redundancy."""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import os

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flexopt.plotting.machine import draw_ground, draw_machine
from flexopt.robustness.evaluation import Evaluation
from flexopt.selection.result import Selection

CHOSEN, PRESENT, MUTED = "#d95f02", "#3b6ea5", "#9aa0a6"
BRANCHES = {-1.0: ("#1b9e77", "elbow up"), 1.0: ("#7570b3", "elbow down")}
# Fraction of the scan that sets the lower end of the axes: near singular postures the measures fall without end.
WORST_SHOWN = 0.12


def plot_selection(selection: Selection, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw the machine in the chosen and the initial posture, and every w_i along the redundancy.

    Args:
        selection: from `flexopt.select`.
        path: file to write (`.png`, `.svg`, `.pdf`), or None.

    Raises:
        OSError: the file cannot be written.
    """
    count = selection.best.evaluation.w.size
    figure = Figure(figsize=(12.0, max(4.6, 1.8 * count)), layout="constrained")
    grid = figure.add_gridspec(count, 2, width_ratios=[1.0, 1.15])
    _draw_machines(figure.add_subplot(grid[:, 0]), selection)
    panels: list[Axes] = []
    for mode in range(count):
        panels.append(figure.add_subplot(grid[mode, 1], sharex=panels[0] if panels else None))
        _draw_measure(panels[-1], selection, mode)
        panels[-1].tick_params(labelbottom=mode == count - 1)
    panels[-1].set_xlabel("base position x, m")
    panels[0].set_title("measures along the redundancy (0 is best)", loc="left", fontsize=11, pad=14)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower right", ncols=5, fontsize=8.5)
    if path is not None:
        figure.savefig(path, dpi=150)
    return figure


def _draw_machines(axes: Axes, selection: Selection) -> None:
    best, initial = selection.best.evaluation, selection.initial
    shown = [best.skeleton] if initial is None else [best.skeleton, initial.skeleton]
    points = np.hstack(shown)
    size = float(np.linalg.norm(np.diff(best.skeleton, axis=1), axis=0).sum())
    low, high = float(points[0].min()) - 0.3 * size, float(points[0].max()) + 0.3 * size
    axes.set_aspect("equal")
    draw_ground(axes, low, high, float(best.skeleton[1, 0]) - 0.035 * size)
    if initial is not None:
        draw_machine(axes, initial.skeleton, PRESENT, ghost=True, label=f"present, {_line(initial)}")
    draw_machine(axes, best.skeleton, CHOSEN, label=f"chosen, {_line(best)}")
    target = selection.problem.target
    axes.plot(*target, marker="+", color="black", markersize=13, markeredgewidth=1.6, linestyle="none", zorder=6)
    axes.annotate("target", (float(target[0]), float(target[1])), xytext=(8, 8), textcoords="offset points", zorder=6)
    axes.set_xlim(low, high)
    axes.set_ylim(min(float(points[1].min()), 0.0) - 0.12 * size, float(points[1].max()) + 0.28 * size)
    axes.set_xlabel("x, m (inertial frame)")
    axes.set_ylabel("y, m")
    title = f"{best.machine}: Jacobian {best.control} control, objective {selection.problem.name}"
    axes.set_title(title, fontsize=11)
    axes.legend(loc="upper center", fontsize=8.5, framealpha=0.95)


def _line(evaluation: Evaluation) -> str:
    measures = ", ".join(f"w{i + 1} = {w:.1e}" for i, w in enumerate(evaluation.w))
    return f"x = {evaluation.base[0]:.2f} m: {measures}"


def _draw_measure(axes: Axes, selection: Selection, mode: int) -> None:
    scan, best, initial = selection.problem.scan, selection.best.evaluation, selection.initial
    for sign, (color, name) in BRANCHES.items():
        members = np.flatnonzero(scan.elbow == sign)
        if members.size == 0:
            continue
        x, w = scan.base[0, members], scan.w[mode, members]
        if scan.redundancy.shape[0] == 1 and np.ptp(x) > 0:
            cuts = np.flatnonzero(np.diff(scan.index[members]) != 1) + 1
            for k, (part_x, part_w) in enumerate(zip(np.split(x, cuts), np.split(w, cuts), strict=True)):
                axes.plot(part_x, part_w, color=color, linewidth=1.4, label=name if k == 0 else None)
        else:
            axes.plot(x, w, ".", color=color, markersize=2.5, alpha=0.5, label=name)
    others = selection.candidates[1:]
    axes.plot(
        [c.evaluation.base[0] for c in others], [c.evaluation.w[mode] for c in others], "o", color="white",
        markeredgecolor="black", markersize=4.5, linestyle="none", label="other local optima", zorder=4,
    )  # fmt: skip
    if initial is not None:
        axes.plot(initial.base[0], initial.w[mode], "s", color=PRESENT, markersize=7, label="present", zorder=5)
    axes.plot(
        best.base[0], best.w[mode], "*", color=CHOSEN, markersize=14, markeredgecolor="black", label="chosen", zorder=6
    )
    shown = [best.w[mode]] + ([initial.w[mode]] if initial is not None else [])
    floor = min(float(np.quantile(scan.w[mode], WORST_SHOWN)), *shown)
    axes.set_ylim(1.12 * floor, -0.1 * floor if floor < 0 else 1.0)
    axes.axhline(0.0, color=MUTED, linewidth=0.8, zorder=0)
    axes.set_ylabel(f"$w_{mode + 1}$")
    axes.ticklabel_format(axis="y", style="sci", scilimits=(0, 0))
    axes.set_title(f"mode {mode + 1}, {best.frequencies_hz[mode]:.2f} Hz when chosen", loc="right", fontsize=9)
