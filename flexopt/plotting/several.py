"""The picture of several configurations: the machine at every target, and V of each.

In: a `Stand` or a `BasePlan`. Out: a figure.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from flexopt.foundation.boundary import instance
from flexopt.foundation.escapes import mathtext
from flexopt.foundation.palette import colors
from flexopt.plotting.naming import TargetNumbers
from flexopt.plotting.panels import NamedLine, Panel, draw_panel
from flexopt.plotting.scene import Actor, draw_scene, draw_views, legend_above, target_point
from flexopt.plotting.shape import Points, Shape, View, shape_of, views
from flexopt.plotting.sheet import Sheet, picture
from flexopt.plotting.units import labelled, measure_label, objective_label
from flexopt.robustness.evaluation import without_rounding
from flexopt.selection.several import BasePlan, Stand, TargetConfiguration

TITLE_WIDTH = 95  # characters
# More machines than this on top of each other cannot be told apart; a film strip has room for fewer.
GHOSTS, SHOTS, ROW = 9, 6, 3
# A machine that is no wider than this share of its size, seen from above, moves in an upright plane.
FLAT = 1e-6


def _spatial(result: Stand | BasePlan) -> bool:
    return len(result.problems[0].machine.kinematic_tree.axes) == 3


@picture(
    "Stand",
    size=lambda stand: (10.5, 7.8 if _spatial(stand) else 4.8),
    check=instance(Stand, "a Stand, from flexopt.select_stand for example"),
)
def plot_stand(sheet: Sheet, stand: Stand) -> None:
    """Draw the machine from its one placement at every target, and V and every w_i at each."""
    places, inks = stand.places, colors()
    drawn = _some(len(places), GHOSTS)
    if stand.worst not in drawn:
        drawn = sorted({*drawn, stand.worst})
    shapes = {k: shape_of(stand.problems[k].machine, places[k].evaluation) for k in drawn}
    seen = views(shapes[stand.worst])
    grid = sheet.figure.add_gridspec(1, 2, width_ratios=[1.35, 1.0])
    left, right = grid[0].subgridspec(len(seen), 1), grid[1].subgridspec(2, 1)
    actors = [Actor(shape, inks.other, ghost=True) for k, shape in shapes.items() if k != stand.worst]
    if actors:
        actors[0] = Actor(actors[0].shape, inks.other, "at the other targets", ghost=True)
    worst = "at the worst target" if stand.differs else f"at target {stand.worst + 1}"
    actors.append(Actor(shapes[stand.worst], inks.chosen, worst))
    targets = _target_points(places, stand.problems[0].machine.task_rows)
    scenes = [sheet.figure.add_subplot(left[k, 0]) for k in range(len(seen))]
    draw_views(scenes, actors, targets, stand.problems[0].asked, ncols=2)
    for axes, view in zip(scenes, seen, strict=True):
        _number(axes, view.of(targets))
    panels: list[Axes] = [sheet.figure.add_subplot(right[k, 0]) for k in range(2)]
    numbers = np.arange(1, len(places) + 1)
    shades = [inks.chosen if k == stand.worst else inks.other for k in range(numbers.size)]
    panels[0].bar(numbers, stand.shown_objective, 0.6, color=shades)
    panels[0].axhline(0.0, color=inks.muted, linewidth=0.8, zorder=0)
    if not stand.shown_objective.any():
        told = "0 at every target" if len(places) > 1 else "0 at the target"
        panels[0].annotate(told, (0.5, 0.0), (0, 6), ("axes fraction", "data"), "offset points", ha="center")
    panels[0].set_ylabel(_sought(stand))
    panels[0].set_title("objective at each target" + (", 0 is best" if stand.unit is None else ""), loc="right")
    _draw_measures(panels[1], places, numbers)
    for panel in panels:
        panel.set_xticks(numbers)
    panels[-1].set_xlabel("target, by number")
    _title(sheet, stand)


@picture(
    "BasePlan",
    size=lambda _: (10.5, 7.6),
    check=instance(BasePlan, "a BasePlan, from flexopt.plan_base for example"),
)
def plot_plan(sheet: Sheet, plan: BasePlan) -> None:
    """Draw the way as a film strip; over time V, moving and standing still, and the placement.

    Each shot shows the machine at a target of its path, faintly where it came from; of a longer path some targets.
    """
    e = plan.places[0].evaluation
    machine, shots = plan.problems[0].machine, _some(len(plan.places), SHOTS)
    shapes = [shape_of(machine, plan.places[k].evaluation) for k in shots]
    # All shots see the same plane: a machine in space from above, where its way is seen, unless it stays in a plane.
    view = view_of_way(shapes)
    rows = -(-len(shots) // ROW)
    units = sorted(set(e.base_units))
    outer = sheet.figure.add_gridspec(2, 1, height_ratios=[1.15 * rows, 1.6])
    _draw_strip(sheet, outer[0].subgridspec(rows, min(ROW, len(shots))), plan, shots, shapes, view)
    below = outer[1].subgridspec(1, 1 + len(units))
    panels = [sheet.figure.add_subplot(below[0, k]) for k in range(1 + len(units))]
    moving: tuple[NamedLine, ...] = (("the base moves", plan.time, plan.V),)
    if plan.still is not None:
        moving = (*moving, ("it stands still", plan.time, plan.still.V))
    draw_panel(panels[0], Panel(_sought(plan), moving, colors=_of_ways))
    panels[0].axhline(0.0, color=colors().muted, linewidth=0.8, zorder=0)
    # What it is between the targets is not known from these; where both are the same, both are seen.
    legend = panels[0].get_legend()
    for drawn in (panels[0].get_lines()[: len(moving)], [] if legend is None else legend.get_lines()):
        for curve, size in zip(drawn, (8, 5), strict=False):
            curve.set_marker("o")
            curve.set_linestyle("none")
            curve.set_markersize(size)
            curve.set_clip_on(False)
    for panel, unit in zip(panels[1:], units, strict=True):
        rows_of = [k for k, other in enumerate(e.base_units) if other == unit]
        lines: tuple[NamedLine, ...] = tuple(
            (mathtext(e.base_coordinates[k]), plan.time, plan.base[:, k]) for k in rows_of
        )
        names = ", ".join(name for name, _, _ in lines)
        draw_panel(panel, Panel(f"placement {names}, {unit}", lines))
    for panel in panels:
        panel.set_xlabel("time, s")
    _title(sheet, plan)


def view_of_way(shapes: Sequence[Shape]) -> View:
    """From above; of machines that stay in one upright plane across that."""
    above = np.hstack([views(shape)[-1].of(shape.skeleton) for shape in shapes])
    directions, sizes, _ = np.linalg.svd(above - above.mean(axis=1, keepdims=True))
    if sizes[1] > FLAT * shapes[0].size:
        return views(shapes[0])[-1]
    along: Points = directions[:, 0] * (1.0 if directions[:, 0].sum() > 0 else -1.0)
    return views(shapes[0], along)[0]


def _draw_strip(sheet: Sheet, grid: Any, plan: BasePlan, shots: list[int], shapes: Sequence[Shape], view: View) -> None:
    inks = colors()
    targets = _target_points(plan.places, plan.problems[0].machine.task_rows)
    first: Axes | None = None
    for number, (k, shape) in enumerate(zip(shots, shapes, strict=True)):
        axes = sheet.figure.add_subplot(grid[number // ROW, number % ROW], sharex=first, sharey=first)
        first = first or axes
        before = [Actor(shapes[number - 1], inks.other, ghost=True)] if number else []
        actors = [*before, Actor(shape, inks.chosen)]
        draw_scene(axes, view, actors, targets, plan.problems[0].asked, line=True, fill="box", among=shapes)
        here = view.of(targets[:, k])
        axes.plot(*here, "o", markersize=9, markerfacecolor="none", markeredgecolor=inks.chosen, zorder=7)
        axes.set_title(f"target {k + 1} of {len(plan.places)}, {plan.time[k]:.3g} s", loc="left")
        if number % ROW:
            axes.set_ylabel("")
            axes.tick_params(labelleft=False)
        if number + ROW < len(shots):
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)


def _sought(chosen: Stand | BasePlan) -> str:
    """The axis of what was sought."""
    if chosen.unit is None:
        return objective_label(chosen.problems[0].sought[0], chosen.places[0].evaluation)
    return labelled(f"objective {chosen.objective}", chosen.unit)


def _of_ways(name: str, _: int) -> str:
    return {"the base moves": colors().chosen, "it stands still": colors().present}[name]


def _some(count: int, most: int) -> list[int]:
    """At most so many of the numbers below `count`, evenly, first and last among them."""
    kept = min(count, most)
    return [round(k * (count - 1) / max(1, kept - 1)) for k in range(kept)]


def _number(axes: Axes, marks: Points) -> None:
    """Numbers of targets beside them; of many the first and the last."""
    count = marks.shape[1]
    numbered = range(count) if count <= GHOSTS else (0, count - 1)
    axes.add_artist(TargetNumbers(axes, marks, numbered, colors().target, colors().halo))


def _target_points(places: Sequence[TargetConfiguration], rows: tuple[str, ...]) -> Points:
    """The targets (d, K)."""
    found = [target_point(place.evaluation.skeleton[:, -1], rows, place.target) for place in places]
    points: NDArray[np.float64] = np.array(found).T
    return points


def _draw_measures(axes: Axes, places: Sequence[TargetConfiguration], numbers: NDArray[np.int64]) -> None:
    """Bars of every w_i at each target."""
    w = np.array([without_rounding(place.evaluation.w, place.evaluation.scale) for place in places])
    width = 0.8 / w.shape[1]
    series = colors().series
    for i in range(w.shape[1]):
        at = numbers + (i - (w.shape[1] - 1) / 2) * width
        axes.bar(at, w[:, i], width, color=series[i % len(series)], label=f"$w_{{{i + 1}}}$")
    legend_above(axes, "right", ncols=w.shape[1], columnspacing=0.7, handlelength=0.7, handletextpad=0.3)
    axes.set_ylabel(measure_label(places[0].evaluation))


def _title(sheet: Sheet, result: Stand | BasePlan) -> None:
    first = result.problems[0]
    heading = f"{mathtext(first.machine.name)}, Jacobian {first.control} control, "
    heading += f"objective {result.objective}: {result.status}"
    if isinstance(result, Stand) and result.number > 1:
        heading += f"; candidate {result.number}"
    sheet.title(textwrap.fill(heading, TITLE_WIDTH))
