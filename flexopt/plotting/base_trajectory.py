"""The picture of a base trajectory: the machine at both ends, and what happens on the way.

In: a `BaseTrajectory`. Out: a figure.
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
from flexopt.plotting.files import write
from flexopt.plotting.machine import draw_ground, draw_shape
from flexopt.plotting.panels import Line, Panel, draw_panel
from flexopt.plotting.selection import CHOSEN, PRESENT
from flexopt.plotting.shape import Points, Shape, View, shape_of, views
from flexopt.selection.base_trajectory import BaseTrajectory

TITLE_WIDTH = 100  # characters


@draws(BaseTrajectory)
@public(trajectory=instance(BaseTrajectory, "a BaseTrajectory, from flexopt.nullspace_trajectory for example"))
def plot_base_trajectory(trajectory: BaseTrajectory, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw the machine at start and end; base position, base rate and V over time; why it stops.

    Args:
        trajectory: from `flexopt.nullspace_trajectory`.
        path: file to write (`.png`, `.svg`, `.pdf`), or None.

    Raises:
        InputError: not a base trajectory, or the file's suffix is unknown.
        WriteError: the file cannot be written.
    """
    t = trajectory
    start, end = (shape_of(t.model, evaluation) for evaluation in (t.initial, t.final))
    seen = views(end)
    figure = Figure(figsize=(7.2, 4.9) if len(seen) == 1 else (10.0, 7.0), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=[1.1, 1.0])
    scenes = grid[:, 0].subgridspec(len(seen), 1)
    for k, view in enumerate(seen):
        _draw_ends(figure.add_subplot(scenes[k, 0]), view, t, start, end)
    names = tuple(f"{name}, rad" if unit == "rad" else name for name, unit in _coordinates(t))
    position: tuple[Line, ...] = tuple((name, t.time, row) for name, row in zip(names, t.base.T, strict=True))
    rate: tuple[Line, ...] = tuple((name, t.time, row) for name, row in zip(names, t.base_rate.T, strict=True))
    panels = [
        Panel("base position, m", position),
        Panel("base rate, m/s", rate, steps=True),
        Panel(f"V: {t.objective}", (("V", t.time, t.V),)),
    ]
    drawn: list[Axes] = []
    for row, panel in enumerate(panels):
        drawn.append(figure.add_subplot(grid[row, 1], sharex=drawn[0] if drawn else None))
        draw_panel(drawn[-1], panel)
        drawn[-1].set_title(f"({'bcd'[row]})", loc="left", fontsize=8, pad=2.5)
        drawn[-1].tick_params(labelbottom=row == len(panels) - 1)
    drawn[-1].set_xlabel("time, s", fontsize=8)
    drawn[-1].ticklabel_format(axis="y", style="sci", scilimits=(-2, 3))
    drawn[-1].yaxis.get_offset_text().set(fontsize=7.5)
    if t.descents:
        at = [descent.index for descent in t.descents]
        drawn[-1].plot(t.time[at], t.V[at], "v", color=CHOSEN, markersize=4, linestyle="none", label="V descends")
        drawn[-1].legend(loc="best", fontsize=7.5)
    heading = f"{mathtext(t.machine)}, Jacobian {t.control} control, objective {t.objective}: {t.status}"
    figure.suptitle(textwrap.fill(heading, TITLE_WIDTH), fontsize=9)
    write(figure, path)
    return figure


def _coordinates(t: BaseTrajectory) -> list[tuple[str, str]]:
    return list(zip(t.base_coordinates, t.model.base_units, strict=True))


def _draw_ends(axes: Axes, view: View, t: BaseTrajectory, start: Shape, end: Shape) -> None:
    """Both ends in one view."""
    target = view.of(_target_point(t, end))
    parts = [points for shape in (start, end) for points in (shape.skeleton, shape.support) if points is not None]
    points, size = np.hstack([view.of(part) for part in parts]), end.size
    low, high = float(points[0].min()) - 0.22 * size, float(points[0].max()) + 0.22 * size
    foot = float(view.of(end.skeleton)[1, 0])
    if view.upright:
        draw_ground(axes, low, high, foot - (0.035 * size if end.support is None else 0.0))
    draw_shape(axes, view, start, PRESENT, ghost=True, label="start: " + _placement(t, 0))
    draw_shape(axes, view, end, CHOSEN, label="end: " + _placement(t, -1))
    axes.plot(*target, marker="+", color="black", markersize=11, markeredgewidth=1.4, linestyle="none", zorder=6)
    axes.annotate(
        "end-point", (float(target[0]), float(target[1])), xytext=(6, 6), textcoords="offset points", fontsize=8,
        zorder=6,
    )  # fmt: skip
    axes.set_aspect("equal")
    axes.set_xlim(low, high)
    axes.set_ylim(
        float(points[1].min()) - 0.12 * size, float(points[1].max()) + (0.35 if view.upright else 0.12) * size
    )
    axes.set_xlabel(view.labels[0], fontsize=8)
    axes.set_ylabel(view.labels[1], fontsize=8)
    axes.tick_params(labelsize=7.5)
    if view.upright:
        axes.set_title("(a)", loc="left", fontsize=8, pad=2.5)
        axes.legend(
            loc="upper center", fontsize=7.5 if end.skeleton.shape[0] == 2 else 6.5, framealpha=0.95, handlelength=1.2
        )


def _target_point(t: BaseTrajectory, end: Shape) -> Points:
    """Where the end-point stays, (d,); of position rows that are no part of the task, where it ends."""
    point = end.skeleton[:, -1].copy()
    for row, value in zip(t.model.task_rows, t.target, strict=True):
        if row in "xyz"[: point.size]:
            point["xyz".index(row)] = value
    return point


def _placement(t: BaseTrajectory, k: int) -> str:
    places = ", ".join(f"{name} = {x:.2f} {unit}" for (name, unit), x in zip(_coordinates(t), t.base[k], strict=True))
    return f"{places}, V = {t.V[k]:.2e}".replace("-", "−")
