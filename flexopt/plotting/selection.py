"""The picture of a selection: the machine before and after, and its measures."""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flexopt.foundation.boundary import instance, public
from flexopt.foundation.escapes import mathtext
from flexopt.foundation.pictures import draws
from flexopt.plotting.files import write
from flexopt.plotting.machine import draw_ground, draw_shape
from flexopt.plotting.scenery import AREAS, draw_scenery, scenery_points
from flexopt.plotting.shape import Points, Shape, View, shape_of, views
from flexopt.robustness.evaluation import Evaluation
from flexopt.selection.result import Selection

CHOSEN, PRESENT, MUTED = "#d95f02", "#3b6ea5", "#9aa0a6"
BRANCHES = {-1.0: ("#1b9e77", "elbow up"), 1.0: ("#7570b3", "elbow down")}
# Fraction of the scan that sets the lower end of the axes: near singular postures the measures fall without end.
WORST_SHOWN = 0.12


@draws(Selection)
@public(selection=instance(Selection, "a Selection, from flexopt.select for example"))
def plot_selection(selection: Selection, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw the machine in the chosen and the present configuration, and its measures.

    A planar machine is drawn beside every w_i along the redundancy. One in space is drawn from the side, across the
    chosen arm's main direction, and from above, beside the w_i of the present configuration and of all candidates.
    Capsules, support, obstacles and areas of the placement are drawn where there are any.

    Args:
        selection: from `flexopt.select`.
        path: file to write (`.png`, `.svg`, `.pdf`), or None.

    Raises:
        WriteError: the file cannot be written.
    """
    planar = selection.best.evaluation.skeleton.shape[0] == 2
    count = selection.best.evaluation.w.size
    height = max(4.6, 1.8 * count) if planar else 8.6
    figure = Figure(figsize=(12.0, height), layout="constrained")
    if planar:
        grid = figure.add_gridspec(count, 2, width_ratios=[1.0, 1.15])
        draw_configurations([figure.add_subplot(grid[:, 0])], selection)
        _draw_along_redundancy([figure.add_subplot(grid[mode, 1]) for mode in range(count)], selection)
    else:
        grid = figure.add_gridspec(3, 2, width_ratios=[1.25, 1.0])
        seen = grid[:, 0].subgridspec(2, 1)
        draw_configurations([figure.add_subplot(seen[k, 0]) for k in range(2)], selection)
        draw_candidates([figure.add_subplot(grid[k, 1]) for k in range(3)], selection)
    write(figure, path, dpi=150)
    return figure


def _draw_along_redundancy(panels: list[Axes], selection: Selection) -> None:
    for mode, panel in enumerate(panels):
        if mode:
            panel.sharex(panels[0])
        _draw_measure(panel, selection, mode)
        panel.tick_params(labelbottom=mode == len(panels) - 1)
    panels[-1].set_xlabel("base position x, m")
    panels[0].set_title("measures along the redundancy (0 is best)", loc="left", fontsize=11, pad=14)
    figure = panels[0].get_figure()
    assert isinstance(figure, Figure)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower right", ncols=5, fontsize=8.5)


def draw_configurations(axes: Sequence[Axes], selection: Selection) -> None:
    """The chosen and the present configuration with the target, one pair of axes for each view of the machine."""
    best, initial, machine = selection.best.evaluation, selection.initial, selection.problem.machine
    chosen = shape_of(machine, best)
    present = None if initial is None else shape_of(machine, initial)
    title = f"{mathtext(best.machine)}: Jacobian {best.control} control, objective {selection.objective}"
    for k, (panel, view) in enumerate(zip(axes, views(chosen), strict=True)):
        panel.set_aspect("equal")
        _draw_view(panel, view, selection, chosen, present)
        if present is not None and initial is not None:
            draw_shape(panel, view, present, PRESENT, ghost=True, label=f"present, {_line(initial)}")
        draw_shape(panel, view, chosen, CHOSEN, label=f"chosen, {_line(best)}")
        panel.set_xlabel(view.labels[0])
        panel.set_ylabel(view.labels[1])
        if k == 0:
            panel.set_title(title, fontsize=11)
            panel.legend(loc="upper center", fontsize=8.5, framealpha=0.95)
        else:
            handles, labels = panel.get_legend_handles_labels()
            areas = [(h, name) for h, name in zip(handles, labels, strict=True) if name in AREAS]
            if areas:
                panel.legend(*zip(*areas, strict=True), loc="best", fontsize=8.5, framealpha=0.95)


def _draw_view(axes: Axes, view: View, selection: Selection, chosen: Shape, present: Shape | None) -> None:
    """Ground, scenery, target and limits."""
    best = selection.best.evaluation
    constraints = selection.problem.asked
    planar = chosen.skeleton.shape[0] == 2
    shown = [chosen] if present is None else [chosen, present]
    points = np.hstack([view.of(shape.skeleton) for shape in shown])
    size = float(np.linalg.norm(np.diff(best.skeleton, axis=1), axis=0).sum()) if planar else chosen.size
    ground = float(view.of(best.skeleton)[1, 0]) - (0.035 * size if chosen.support is None else 0.0)
    extent = np.hstack([points, *(view.of(_outer(shape)) for shape in shown), scenery_points(view, constraints)])
    low, high = float(extent[0].min()) - 0.3 * size, float(extent[0].max()) + 0.3 * size
    bottom, top = float(extent[1].min()), float(extent[1].max())
    if view.upright:
        draw_ground(axes, low, high, ground)
        bottom = min(bottom, 0.0) if planar else bottom
    draw_scenery(axes, view, constraints, ground)
    target = view.of(_target_point(selection))
    axes.plot(*target, marker="+", color="black", markersize=13, markeredgewidth=1.6, linestyle="none", zorder=6)
    axes.annotate("target", (float(target[0]), float(target[1])), xytext=(8, 8), textcoords="offset points", zorder=6)
    axes.set_xlim(low, high)
    axes.set_ylim(bottom - 0.12 * size, top + (0.28 if view.upright else 0.12) * size)


def _outer(shape: Shape) -> Points:
    """Points of capsules and support."""
    found = [shape.skeleton[:, :0]]
    for start, end, radius in shape.capsules:
        ends = np.column_stack([start, end])
        found += [ends - radius, ends + radius]
    if shape.support is not None:
        found.append(shape.support)
    return np.hstack(found)


def _target_point(selection: Selection) -> Points:
    """Where the end-point shall be, (d,); of position rows that are no part of the task, where it is when chosen."""
    best, problem = selection.best.evaluation, selection.problem
    point = best.skeleton[:, -1].copy()
    for row, value in zip(problem.machine.task_rows, problem.target, strict=True):
        if row in "xyz"[: point.size]:
            point["xyz".index(row)] = value
    return point


def _line(evaluation: Evaluation) -> str:
    measures = ", ".join(f"w{i + 1} = {w:.1e}" for i, w in enumerate(evaluation.w))
    if evaluation.skeleton.shape[0] == 2:
        return f"x = {evaluation.base[0]:.2f} m: {measures}"
    places = zip(evaluation.base_coordinates, evaluation.base, evaluation.base_units, strict=True)
    placed = ", ".join(f"{name} = {value:.2f} {unit}" for name, value, unit in places)
    margin = "" if evaluation.epsilon_max is None else f"$\\epsilon_{{max}}$ = {evaluation.epsilon_max:.4f}"
    return ": ".join(text for text in (placed, margin) if text).replace("-", "−")


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


def draw_candidates(panels: Sequence[Axes], selection: Selection) -> None:
    """Bars of w_i and of w_i/|a_i||b_i|, present and chosen, other candidates as dots; and all objectives."""
    best, initial = selection.best.evaluation, selection.initial
    modes = np.arange(best.w.size)
    labels = [f"{k + 1}\n{hz:.2f} Hz" for k, hz in enumerate(best.frequencies_hz)]
    others = [candidate.evaluation for candidate in selection.candidates[1:]]
    for panel, share in zip(panels[:2], (False, True), strict=True):
        shown = [(0.0 if initial is None else 0.2, best, CHOSEN, "chosen")]
        shown += [] if initial is None else [(-0.2, initial, PRESENT, "present")]
        for offset, evaluation, color, name in shown:
            panel.bar(modes + offset, _shares(evaluation) if share else evaluation.w, 0.38, color=color, label=name)
        for k, other in enumerate(others):
            values = _shares(other) if share else other.w
            panel.plot(
                modes + shown[0][0], values, "o", color="white", markeredgecolor="black", markersize=3.5,
                linestyle="none", label="other local optima" if k == 0 else "_", zorder=4,
            )  # fmt: skip
        panel.set_xticks(modes, labels, fontsize=8)
        panel.axhline(0.0, color=MUTED, linewidth=0.8, zorder=0)
        panel.set_ylabel("$w_i / |a_i||b_i|$" if share else "$w_i$")
    floor = min(float(e.w.min()) for e in (best, *([initial] if initial is not None else [])))
    panels[0].set_ylim(1.12 * floor, -0.05 * floor if floor < 0 else 1.0)
    panels[0].ticklabel_format(axis="y", style="sci", scilimits=(0, 0))
    panels[0].set_title("measures of each mode (0 is best)", loc="left", fontsize=11)
    panels[0].legend(fontsize=8.5, loc="best")
    panels[1].set_xlabel("mode, frequency when chosen")
    _draw_ranks(panels[2], selection)


def _shares(evaluation: Evaluation) -> Points:
    """The measures w_i / |a_i||b_i|, from −2 to 0; 0 where the mode is not reached at all."""
    scale = evaluation.scale
    shares: Points = np.divide(evaluation.w, scale, out=np.zeros_like(scale), where=scale > 0)
    return shares


def _draw_ranks(axes: Axes, selection: Selection) -> None:
    ranks = np.arange(1, len(selection.candidates) + 1)
    values = np.array([candidate.objective for candidate in selection.candidates])
    axes.plot(ranks[1:], values[1:], "o", color="white", markeredgecolor="black", markersize=4.5, linestyle="none")
    axes.plot(ranks[0], values[0], "*", color=CHOSEN, markersize=14, markeredgecolor="black")
    first = selection.problem.sought[0]
    if selection.initial is not None and first.own is None:
        axes.axhline(first.value(selection.initial.w, selection.initial.epsilon_max), color=PRESENT, linewidth=1.4)
    axes.set_xlabel("candidate, by rank")
    axes.set_ylabel(f"objective {selection.problem.sought[0].name}")
    axes.locator_params(axis="x", integer=True)
