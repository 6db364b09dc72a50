"""Machines where they stand, with their targets and what is around them, in one view.

In: shapes with the colours of what they are, targets, constraints. Out: drawn axes, limits and labels.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes

from flexopt.foundation.palette import colors
from flexopt.model.constraints import Constraints
from flexopt.plotting.machine import draw_ground, draw_shape, draw_target, undercarriage
from flexopt.plotting.scenery import draw_scenery, held, name_obstacles, named_points, scenery_points
from flexopt.plotting.shape import Points, Shape, View, views

# Room about what is drawn, share of the machine's size.
ROOM = 0.1
# Shares of the picture: width and height of a target's name and its distance from the target, width of other names.
NAME, APART, OTHER = (0.13, 0.045), 0.015, 0.14
# Sides of the target on which its name may stand, the usual one first; points of a link that it keeps away from.
SIDES, SAMPLES = ((1, 1), (-1, 1), (1, -1), (-1, -1)), 65


@dataclass(frozen=True)
class Actor:
    """A machine of a scene: its shape, its colour, its name in the legend, whether it is drawn faintly."""

    shape: Shape
    color: str
    label: str = ""
    ghost: bool = False


def draw_scene(
    axes: Axes,
    view: View,
    actors: Sequence[Actor],
    targets: Points,
    constraints: Constraints | None = None,
    *,
    name: str = "",
    line: bool = False,
    fill: Literal["datalim", "box"] = "datalim",
    among: Iterable[Shape] = (),
) -> None:
    """Ground, surroundings, machines and targets; the same scale on both axes.

    Args:
        axes: to draw on.
        view: one of `views(shape)`.
        actors: the machines, what lies behind first.
        targets: one (d,) or several (d, K), m.
        constraints: whose obstacles and areas are drawn.
        name: of the target.
        line: whether the targets are a path.
        fill: whether the limits give way to the frame, or the frame to the limits.
        among: shapes that the limits hold, too.
    """
    shape = actors[-1].shape
    marks = view.of(np.reshape(targets, (targets.shape[0], -1)))
    points = [marks, *(_outer(view, each) for each in (*among, *(actor.shape for actor in actors)))]
    if constraints is not None:
        points.append(scenery_points(view, constraints, np.hstack(points)))
    extent, room = np.hstack(points), ROOM * shape.size
    ground = _ground(shape, constraints)
    if view.upright:
        draw_ground(axes, ground)
        # One far below is not in the picture.
        low = max(ground - room / 2, float(extent[1].min() - np.ptp(extent, axis=1).max()))
        extent = np.hstack([extent, [[extent[0, 0]], [low]]])
    limits = np.column_stack([extent.min(axis=1) - room, extent.max(axis=1) + room])
    whole = float(np.ptp(limits, axis=1).max())
    if constraints is not None:
        holds = held(constraints, shape)
        draw_scenery(axes, view, constraints, ground, holds)
        if holds == "point" and (constraints.region or constraints.keep_out) and not view.upright:
            _draw_anchors(axes, view, actors)
    before = len(axes.patches)
    for actor in actors:
        draw_shape(axes, view, actor.shape, actor.color, ghost=actor.ghost, label=actor.label)
    if constraints is not None:
        name_obstacles(axes, view, constraints, marks, limits, axes.patches[before:])
    side = SIDES[0]
    if name:
        side = _free_side(marks[:, 0], whole, _written_on(view, actors, named_points(view, constraints, limits), whole))
        corner = np.array(side) * (APART + np.array(NAME)) * whole
        extent = np.hstack([extent, marks[:, :1] + corner[:, None]])
    draw_target(axes, marks, name, line=line, side=side)
    axes.set_aspect("equal", adjustable=fill)
    low, high = extent.min(axis=1) - room, extent.max(axis=1) + room
    # Matplotlib may widen what is set as if by itself, and shrinks it no further than to what it knows as data.
    axes.update_datalim([low, high])
    axes.set_xlim(float(low[0]), float(high[0]), auto=fill == "datalim")
    axes.set_ylim(float(low[1]), float(high[1]), auto=fill == "datalim")
    axes.set_xlabel(view.labels[0])
    axes.set_ylabel(view.labels[1])


def draw_views(
    panels: Sequence[Axes],
    actors: Sequence[Actor],
    targets: Points,
    constraints: Constraints | None = None,
    *,
    name: str = "",
    **settings: Any,
) -> None:
    """`draw_scene` in every view of the last machine, one for each pair of axes; the first has its names above it."""
    for k, (axes, view) in enumerate(zip(panels, views(actors[-1].shape), strict=True)):
        shown = actors if k == 0 else [replace(actor, label="") for actor in actors]
        draw_scene(axes, view, shown, targets, constraints, name=name)
        legend_above(axes, **settings)


def legend_above(axes: Axes, side: Literal["left", "right"] = "left", **settings: Any) -> None:
    """Names of what is drawn, above the axes, where nothing is drawn; the axis' power of ten stands on the left."""
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        place: Any = {"loc": f"lower {side}", "bbox_to_anchor": (float(side == "right"), 1.0)}
        axes.legend(handles, labels, **place, frameon=False, borderaxespad=0.2, **settings)


def target_point(tip: Points, rows: Sequence[str], target: Sequence[float] | Points) -> Points:
    """Where the end-point shall be, (d,); of position rows that are no part of the task, where it is."""
    point = tip.copy()
    for row, value in zip(rows, target, strict=True):
        if row in "xyz"[: point.size]:
            point["xyz".index(row)] = value
    return point


def _written_on(view: View, actors: Sequence[Actor], named: Points, whole: float) -> Points:
    """Points (2, K) that a name shall not lie on: of the links, and of names in a picture of the size `whole`."""
    shares, found = np.linspace(0.0, 1.0, SAMPLES), list[Points]()
    for shape in (actor.shape for actor in actors):
        seen = view.of(shape.skeleton)
        found += [seen[:, [i]] + shares * (seen[:, [j]] - seen[:, [i]]) for i, j in shape.segments]
    across = np.array([[OTHER * whole / 2], [0.0]])
    found += [point[:, None] + (2 * shares - 1) * across for point in named.T]
    return np.hstack(found)


def _free_side(mark: Points, whole: float, taken: Points) -> tuple[int, int]:
    """On which side of a target (2,) its name is farthest from points (2, K); the usual side where it makes none."""
    clear, low, size = list[float](), APART * whole, np.array(NAME)[:, None] * whole
    for side in SIDES:
        across = (taken - mark[:, None]) * np.array(side)[:, None]
        beyond = across - np.clip(across, low, low + size)
        # A link that ends at the target is as near to names on all sides that it does not pass.
        clear.append(round(min(float(np.hypot(*beyond).min(initial=np.inf)) / low, 2.0**0.5), 6))
    return SIDES[int(np.argmax(clear))]


def _ground(shape: Shape, constraints: Constraints | None) -> float:
    """Height of the ground that clearances are kept from, or else of that on which the machine stands, m."""
    asked = None if constraints is None or constraints.clearance is None else constraints.clearance.ground
    return float(shape.foot[-1]) if asked is None else asked


def _draw_anchors(axes: Axes, view: View, actors: Sequence[Actor]) -> None:
    """The points that the areas of the placement are meant for."""
    for actor in actors:
        x, y = view.of(actor.shape.foot)
        axes.plot(
            x, y, "o", markersize=10, markerfacecolor="none", markeredgecolor=colors().allowed, markeredgewidth=1.6,
            zorder=5,
        )  # fmt: skip


def _outer(view: View, shape: Shape) -> Points:
    """Points (2, K) that hold a machine: skeleton, capsules, what it stands on."""
    found = [view.of(shape.skeleton)]
    for start, end, radius in shape.capsules:
        ends = view.of(np.column_stack([start, end]))
        found += [ends - radius, ends + radius]
    if shape.support is not None:
        found.append(view.of(shape.support))
    if view.upright:
        box, moved = undercarriage(view, shape)
        found.append(moved.transform(box.corners()).T)
    return np.hstack(found)
