"""The picture of a base trajectory: the machine at both ends, and what happens on the way.

In: a `BaseTrajectory`. Out: a figure.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import textwrap

from flexopt.foundation.boundary import instance
from flexopt.foundation.escapes import mathtext
from flexopt.foundation.palette import colors
from flexopt.plotting.panels import NamedLine, Panel, draw_stack
from flexopt.plotting.scene import Actor, draw_views, target_point
from flexopt.plotting.shape import shape_of, views
from flexopt.plotting.sheet import Sheet, picture
from flexopt.plotting.units import labelled
from flexopt.robustness.residues import residue_unit
from flexopt.selection.nullspace.base_trajectory import BaseTrajectory

TITLE_WIDTH = 95  # characters


@picture(
    "BaseTrajectory",
    size=lambda t: (9.0, 5.2) if len(t.model.kinematic_tree.axes) == 2 else (10.5, 7.6),
    check=instance(BaseTrajectory, "a BaseTrajectory, from flexopt.nullspace_trajectory for example"),
)
def plot_base_trajectory(sheet: Sheet, trajectory: BaseTrajectory) -> None:
    """Draw the machine at start and end; base position, base rate and V over time; why it stops."""
    t, inks = trajectory, colors()
    start, end = (shape_of(t.model, evaluation) for evaluation in (t.initial, t.final))
    actors = [
        Actor(start, inks.present, f"start: {_placement(t, 0)}", ghost=True),
        Actor(end, inks.chosen, f"end: {_placement(t, -1)}"),
    ]
    target = target_point(end.skeleton[:, -1], t.model.task_rows, t.target)
    seen = views(end)
    coordinates = list(zip(map(mathtext, t.base_coordinates), t.model.base_units, strict=True))
    units = sorted({unit for _, unit in coordinates})
    grid = sheet.figure.add_gridspec(1, 2, width_ratios=[1.1, 1.0])
    scenes, right = grid[0].subgridspec(len(seen), 1), grid[1].subgridspec(2 * len(units) + 1, 1)
    draw_views([sheet.figure.add_subplot(scenes[k, 0]) for k in range(len(seen))], actors, target, name="end-point")
    panels: list[Panel] = []
    for rows, per, steps in ((t.base.T, "", False), (t.base_rate.T, "/s", True)):
        for unit in units:
            lines: tuple[NamedLine, ...] = tuple(
                (name, t.time, row) for (name, of), row in zip(coordinates, rows, strict=True) if of == unit
            )
            what = "base rate" if per else "base position"
            panels.append(Panel(f"{what}, {unit}{per}", lines, steps=steps))
    unit = "" if t.objective == "epsilon_max" else residue_unit(t.control, t.final.joint_units)
    panels.append(Panel(labelled(f"V: {mathtext(t.objective)}", unit), (("V", t.time, t.V),)))
    last = draw_stack(sheet.figure, right, panels)[-1]
    if t.descents:
        at = [descent.index for descent in t.descents]
        last.plot(t.time[at], t.V[at], "v", color=inks.grows, markersize=4, linestyle="none", label="V descends")
        handles, labels = last.get_legend_handles_labels()
        last.legend(handles[-1:], labels[-1:], loc="lower right")
    heading = f"{mathtext(t.machine)}, Jacobian {t.control} control, objective {t.objective}: {t.status}"
    sheet.title(textwrap.fill(heading, TITLE_WIDTH))


def _placement(t: BaseTrajectory, k: int) -> str:
    named = zip(t.base_coordinates, t.model.base_units, t.base[k], strict=True)
    places = ", ".join(f"{mathtext(name)} = {x:z.2f} {unit}" for name, unit, x in named)
    return f"{places}, V = {t.V[k]:.2e}".replace("-", "−")
