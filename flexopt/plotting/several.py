"""The picture of several configurations: the machine at every target, and V of each.

In: a `Stand` or a `BasePlan`. Out: a figure.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import os
import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from flexopt.foundation.boundary import instance, public
from flexopt.foundation.escapes import mathtext
from flexopt.foundation.pictures import draws
from flexopt.plotting.files import write
from flexopt.plotting.machine import draw_ground, draw_shape
from flexopt.plotting.panels import Line, Panel, draw_panel
from flexopt.plotting.scenery import draw_scenery, scenery_points
from flexopt.plotting.selection import CHOSEN, MUTED, PRESENT
from flexopt.plotting.shape import Points, Shape, View, shape_of, views
from flexopt.selection.several import BasePlan, Stand, TargetConfiguration

TITLE_WIDTH = 95  # characters
# More machines than this in one picture cannot be told apart: of a longer path some are left out.
GHOSTS = 9


@draws(Stand)
@public(stand=instance(Stand, "a Stand, from flexopt.select_stand for example"))
def plot_stand(stand: Stand, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw the machine from its one placement at every target, and V and every w_i at each.

    Args:
        stand: from `flexopt.select_stand`.
        path: file to write (`.png`, `.svg`, `.pdf`), or None.

    Raises:
        InputError: not a stand, or the file's suffix is unknown.
        WriteError: the file cannot be written.
    """
    figure, panels = _begin(stand, 2)
    numbers = np.arange(1, len(stand.places) + 1)
    colors = [CHOSEN if k == stand.worst else PRESENT for k in range(numbers.size)]
    panels[0].bar(numbers, [place.objective for place in stand.places], 0.6, color=colors)
    panels[0].set_ylabel(f"objective {stand.problems[0].name}", fontsize=8)
    panels[0].set_title("objective at each target (0 is best), the worst in orange", loc="left", fontsize=9)
    _draw_measures(panels[1], stand.places, numbers)
    for panel in panels:
        panel.set_xticks(numbers)
        panel.set_xlabel("target", fontsize=8)
    return _end(figure, stand, path)


@draws(BasePlan)
@public(plan=instance(BasePlan, "a BasePlan, from flexopt.plan_base for example"))
def plot_plan(plan: BasePlan, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw the machine at every target of its path; over time V, moving and standing still, and the placement.

    Args:
        plan: from `flexopt.plan_base`.
        path: file to write (`.png`, `.svg`, `.pdf`), or None.

    Raises:
        InputError: not a plan, or the file's suffix is unknown.
        WriteError: the file cannot be written.
    """
    e = plan.places[0].evaluation
    units = sorted(set(e.base_units))
    figure, panels = _begin(plan, 1 + len(units))
    moving: tuple[Line, ...] = (("the base moves", plan.time, plan.V),)
    if plan.still is not None:
        moving = (*moving, ("it stands still", plan.time, plan.still.V))
    draw_panel(panels[0], Panel(f"objective {plan.problems[0].name}", moving))
    panels[0].axhline(0.0, color=MUTED, linewidth=0.8, zorder=0)
    panels[0].ticklabel_format(axis="y", style="sci", scilimits=(-2, 3))
    panels[0].yaxis.get_offset_text().set(fontsize=7.5)
    for panel, unit in zip(panels[1:], units, strict=True):
        rows = [k for k, other in enumerate(e.base_units) if other == unit]
        lines: tuple[Line, ...] = tuple((e.base_coordinates[k], plan.time, plan.base[:, k]) for k in rows)
        draw_panel(panel, Panel(f"base, {unit}", lines))
    panels[-1].set_xlabel("time, s", fontsize=8)
    for line in panels[0].get_lines()[: len(moving)]:
        line.set_marker("o")
        line.set_markersize(3)
    return _end(figure, plan, path)


def _begin(result: Stand | BasePlan, count: int) -> tuple[Figure, list[Axes]]:
    """The figure with its machines drawn, and axes beside them."""
    machine, places = result.problems[0].machine, result.places
    count_drawn = min(len(places), GHOSTS)
    drawn = [round(k * (len(places) - 1) / max(1, count_drawn - 1)) for k in range(count_drawn)]
    shapes = [shape_of(machine, places[k].evaluation) for k in drawn]
    seen = views(shapes[len(drawn) // 2])
    figure = Figure(figsize=(10.5, 4.6 if len(seen) == 1 else 7.6), layout="constrained")
    grid = figure.add_gridspec(1, 2, width_ratios=[1.35, 1.0])
    left, right = grid[0].subgridspec(len(seen), 1), grid[1].subgridspec(count, 1)
    points = _target_points(places, machine.task_rows)
    for k, view in enumerate(seen):
        axes = figure.add_subplot(left[k, 0])
        _draw_machines(axes, view, result, drawn, shapes, points)
        if k == 0:
            axes.legend(loc="upper center", fontsize=7.5, framealpha=0.95, ncols=2, handlelength=1.2)
    return figure, [figure.add_subplot(right[k, 0]) for k in range(count)]


def _draw_machines(
    axes: Axes, view: View, result: Stand | BasePlan, drawn: list[int], shapes: Sequence[Shape], targets: Points
) -> None:
    """First and last of a path, or the worst of a set, in full color; the others faintly.

    `drawn`: the numbers of the targets that the shapes are of.
    """
    constraints, size = result.problems[0].asked, shapes[0].size
    moves = isinstance(result, BasePlan)
    seen = [
        view.of(np.hstack([shape.skeleton, *([] if shape.support is None else [shape.support])])) for shape in shapes
    ]
    marks = view.of(targets)
    extent = np.hstack([*seen, marks, scenery_points(view, constraints)])
    low, high = float(extent[0].min()) - 0.15 * size, float(extent[0].max()) + 0.15 * size
    bottom, top = float(extent[1].min()), float(extent[1].max())
    axes.set_aspect("equal")
    if view.upright:
        ground = float(np.mean([view.of(shape.skeleton)[1, 0] for shape in shapes]))
        draw_ground(axes, low, high, ground)
        draw_scenery(axes, view, constraints, ground)
    else:
        draw_scenery(axes, view, constraints, 0.0)
    if isinstance(result, BasePlan):
        full = {0: (CHOSEN, "at the first target"), len(shapes) - 1: (PRESENT, "at the last target")}
    else:
        full = {drawn.index(result.worst): (CHOSEN, "at the worst target")} if result.worst in drawn else {}
    for k, shape in enumerate(shapes):
        color, label = full.get(k, (CHOSEN, "_"))
        draw_shape(axes, view, shape, color, ghost=k not in full, label=label)
    axes.plot(
        marks[0], marks[1], "+", color="black", markersize=9, markeredgewidth=1.3, linestyle="-" if moves else "none",
        linewidth=0.7, zorder=6,
    )  # fmt: skip
    for k in range(marks.shape[1]) if marks.shape[1] <= GHOSTS else (0, marks.shape[1] - 1):
        axes.annotate(
            str(k + 1), (float(marks[0, k]), float(marks[1, k])), xytext=(4, 5), textcoords="offset points", fontsize=8,
            zorder=6,
        )  # fmt: skip
    axes.set_xlim(low, high)
    axes.set_ylim(bottom - 0.1 * size, top + (0.3 if view.upright else 0.1) * size)
    axes.set_xlabel(view.labels[0], fontsize=8)
    axes.set_ylabel(view.labels[1], fontsize=8)
    axes.tick_params(labelsize=7.5)


def _target_points(places: Sequence[TargetConfiguration], rows: tuple[str, ...]) -> Points:
    """The targets (d, K); of position rows that are no part of the task, where the end-point is."""
    points: NDArray[np.float64] = np.array([place.evaluation.skeleton[:, -1] for place in places]).T
    names = "xy" if points.shape[0] == 2 else "xyz"
    for k, row in enumerate(rows):
        if row in names:
            points[names.index(row)] = [place.target[k] for place in places]
    return points


def _draw_measures(axes: Axes, places: Sequence[TargetConfiguration], numbers: NDArray[np.int64]) -> None:
    """Bars of every w_i at each target."""
    w = np.array([place.evaluation.w for place in places])
    width = 0.8 / w.shape[1]
    for i in range(w.shape[1]):
        axes.bar(numbers + (i - (w.shape[1] - 1) / 2) * width, w[:, i], width, label=f"$w_{i + 1}$")
    axes.set_ylim(top=-0.2 * min(float(w.min()), 0.0) or 1.0)
    axes.legend(loc="upper center", fontsize=7.5, ncols=w.shape[1], columnspacing=1.0, handlelength=1.0)
    axes.set_ylabel("$w_i$", fontsize=8)
    axes.set_title("measures of each mode", loc="left", fontsize=9)


def _end(figure: Figure, result: Stand | BasePlan, path: str | os.PathLike[str] | None) -> Figure:
    first = result.problems[0]
    heading = (
        f"{mathtext(first.machine.name)}, Jacobian {first.control} control, objective {first.name}: {result.status}"
    )
    figure.suptitle(textwrap.fill(heading, TITLE_WIDTH), fontsize=9)
    for panel in figure.axes:
        panel.tick_params(labelsize=7.5)
        if panel.get_title(loc="left"):
            panel.ticklabel_format(axis="y", style="sci", scilimits=(-2, 3))
            panel.yaxis.get_offset_text().set(fontsize=7.5)
    write(figure, path)
    return figure
