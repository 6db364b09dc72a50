"""The picture of an explanation: for each mode how the end-point moves and is pushed, and what to move which way.

In: an `Explanation`. Out: a figure.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from flexopt.foundation.escapes import mathtext
from flexopt.foundation.palette import colors
from flexopt.foundation.plain import listed
from flexopt.model.kinematic_tree import ORIENTATION_ROWS
from flexopt.plotting.scene import Actor, draw_scene
from flexopt.plotting.shape import Points, Shape, View, shape_of, views
from flexopt.plotting.sheet import Sheet, picture
from flexopt.robustness.residues import residue_unit, written_unit

# Length of an arrow, share of the machine's size; a line's letters where there is nothing to move.
ARROW, LETTERS = 0.2, 38
ROW, BARS = 2.5, 0.28  # in
# More modes than this may stand in two columns.
MANY = 3


def _seen(found: Any) -> int:
    return len(found.model.kinematic_tree.axes) - 1


def _sizes(found: Any) -> list[tuple[float, float]]:
    """All modes one below the other; of many on a wide sheet two beside each other."""
    row = max(ROW, 1.2 + BARS * len(found.variables))
    across, down = 4.2 + 3.6 * _seen(found), len(found.moves)
    return [(n * across, row * math.ceil(down / n) + 0.6) for n in ((1, 2) if down > MANY else (1,))]


@picture("Explanation", size=_sizes)
def plot_explanation(sheet: Sheet, found: Any) -> None:
    """Draw for each mode a and b at the end-point, and what raises w_i most while the end-point stays."""
    shape = shape_of(found.model, found.evaluation)
    seen = views(shape)
    count, wide = len(found.moves), len(seen) + 1
    rows = math.ceil(count / (sheet.way + 1))
    grid = sheet.figure.add_gridspec(rows, wide * (sheet.way + 1))
    drawn = list[list[Axes]]()
    for i in range(count):
        row, left = i % rows, wide * (i // rows)
        scenes = [sheet.figure.add_subplot(grid[row, left + k]) for k in range(len(seen))]
        for axes, view in zip(scenes, seen, strict=True):
            _draw_arrows(axes, view, shape, found, i)
            if row < rows - 1 and i < count - 1:
                axes.set_xlabel("")
                axes.tick_params(labelbottom=False)
        scenes[0].set_title(_named(found, i), loc="left")
        if i == 0:
            handles = scenes[0].get_legend_handles_labels()
            sheet.figure.legend(*handles, loc="outside lower center", ncols=2, frameon=False)
        _draw_move(sheet.figure.add_subplot(grid[row, left + len(seen)]), found, i, "\n" if sheet.way else " ")
        drawn.append(scenes)
    for column in zip(*drawn, strict=True):
        _align(column)
    of = found.evaluation
    turned = [row for row in found.model.task_rows if row in ORIENTATION_ROWS]
    unseen = f"; angles count {listed(turned)}, too, of which arrows show nothing" if turned else ""
    sheet.title(f"{mathtext(of.machine)}, Jacobian {mathtext(of.control)} control: why, mode by mode{unseen}")


def _align(column: Sequence[Axes]) -> None:
    """The same limits in scenes one below the other, which share the lowest one's numbers."""
    x, y = (np.array([limits(axes) for axes in column]) for limits in (Axes.get_xlim, Axes.get_ylim))
    for axes in column:
        # Equal scales are made with regard to the data.
        axes.update_datalim([(x.min(), y.min()), (x.max(), y.max())])
        axes.set_xlim(x.min(), x.max(), auto=True)
        axes.set_ylim(y.min(), y.max(), auto=True)


def _named(found: Any, i: int) -> str:
    angle = found.angle[i]
    apart = "" if math.isnan(angle) else f", a and b {math.degrees(angle):.3g}° apart"
    return f"mode {i + 1}: {found.evaluation.frequencies_hz[i]:.4g} Hz{apart}"


def _draw_arrows(axes: Axes, view: View, shape: Shape, found: Any, i: int) -> None:
    """The machine, and at its end-point the directions of a_i and b_i."""
    inks, tip = colors(), shape.skeleton[:, -1]
    draw_scene(axes, view, [Actor(shape, inks.present)], tip)
    rows = found.model.task_rows
    ends = [view.of(tip)]
    for name, vector, color, width in (
        ("a: the end-point moves so", found.a[:, i], inks.series[1], 3.2),
        ("b: feedback pushes it so", found.b[:, i], inks.series[2], 1.4),
    ):
        along = _in_space(vector, rows, tip.size)
        if along is None:
            continue
        start, end = view.of(tip), view.of(tip + ARROW * shape.size * along)
        ends.append(end)
        style: Any = {"arrowstyle": "-|>", "color": color, "lw": width, "shrinkA": 0.0, "shrinkB": 0.0}
        axes.annotate(
            "", (float(end[0]), float(end[1])), (float(start[0]), float(start[1])), arrowprops=style, zorder=8,
            annotation_clip=False,
        )  # fmt: skip
        axes.plot([], [], color=color, linewidth=width, label=name)
    low, high = np.min(ends, axis=0), np.max(ends, axis=0)
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    axes.update_datalim([low, high])
    axes.set_xlim(min(left, low[0]), max(right, high[0]), auto=True)
    axes.set_ylim(min(bottom, low[1]), max(top, high[1]), auto=True)


def _in_space(vector: Points, rows: tuple[str, ...], d: int) -> Points | None:
    """A direction of the task, of length 1 in all its rows, as far as it moves a point; None where there is none."""
    length = float(np.linalg.norm(vector))
    if not length > 0:
        return None
    along: Points = np.zeros(d)
    for row, part in zip(rows, vector, strict=True):
        if row in "xyz"[:d]:
            along["xyz".index(row)] = part / length
    return along


def _draw_move(axes: Axes, found: Any, i: int, between: str) -> None:
    """How far each coordinate goes for each unit of that which moves most; or why there is nothing to move.

    `between`: what parts the number from its unit.
    """
    move, inks = found.moves[i], colors()
    if move.variable is None:
        axes.set(xticks=[], yticks=[], frame_on=False)
        told = textwrap.fill(f"nothing to move: {move.why}", LETTERS)
        axes.text(0.0, 0.5, told, transform=axes.transAxes, va="center", fontsize="small")
        return
    names, at = found.variables, np.arange(len(found.variables))
    shades = [inks.chosen if name == move.variable else inks.other for name in names]
    axes.barh(at, move.direction, 0.6, color=shades)
    axes.axvline(0.0, color=inks.muted, linewidth=0.8)
    axes.set_yticks(at, [mathtext(name) for name in names])
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xlabel(
        f"for each {move.unit} of {mathtext(move.variable)}, {' and '.join(sorted(set(found.variable_units)))}"
    )
    unit = written_unit(residue_unit(found.evaluation.control, found.evaluation.joint_units))
    rate = f"{move.rate:.3g}".replace("-", "−")
    axes.set_title(f"raises $w_{{{i + 1}}}$ by {rate}{between}{unit} per {move.unit}", loc="left")
    axes.grid(axis="x")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
