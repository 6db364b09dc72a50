"""The picture of an atlas: curves and points of robust postures over two joints, and where the end-point then is."""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from flexopt.foundation.arrays import Vector
from flexopt.foundation.escapes import TITLE_MAX, mathtext
from flexopt.foundation.palette import colors
from flexopt.plotting.sheet import Sheet, picture
from flexopt.robustness.atlas import Atlas, RobustPoint

# Lines that need no colour to be told apart.
STYLES = ("-", (0, (6, 1.6)), (0, (7, 1.6, 1.4, 1.6)), (0, (1.6, 1.2)), (0, (3, 1, 1, 1, 1, 1)), (0, (9, 2)))
MARKERS = ("*", "D", "s", "^", "v", "P")
# Style, width and name of the edges of what is reached.
EDGES = {
    "singular": ("-", 1.8, "singular postures: edge of the workspace"),
    "fold": ("-", 1.3, "edge of what the two joints reach, or a fold"),
    "limit": ("-", 1.0, "limits"),
}
# Share of an axis that is shown beyond a limit; the two parts of a sheet so narrow stand one below the other, in.
MARGIN, NARROW = 0.04, 6.0
# And beyond a whole turn, so that a curve along its end is seen beside the frame.
SEAM = 0.012
# Lines over the left part.
WRAPPED = textwrap.TextWrapper(48, break_long_words=False, break_on_hyphens=False)


@picture("Atlas", size=lambda _: (10.5, 6.2))
def plot_atlas(sheet: Sheet, atlas: Atlas) -> None:
    """Draw an atlas: its curves and points over the two joints, and where the end-point then is."""
    width, inks = sheet.size[0], colors()
    joints, task = sheet.figure.subplots(1, 2) if width >= NARROW else sheet.figure.subplots(2, 1)
    varied = [atlas.joints.index(name) for name in atlas.varied]
    _draw(joints, atlas, lambda curve: _broken(atlas, curve.points), lambda posture: posture[varied])
    _frame(joints, atlas)
    seen = [0, len(atlas.rows) - 1]
    _draw(task, atlas, lambda curve: curve.end_point[seen], None)
    task.set_aspect("equal")
    place = ", ".join(f"{value:g}" for value in atlas.base)
    task.set_title("the end-point there" + (f", base at {place}" if place else ""))
    task.set_xlabel(f"{atlas.rows[0]}, m (inertial frame)")
    task.set_ylabel(f"{atlas.rows[-1]}, m (inertial frame)")
    if not any((atlas.edges, atlas.curves, atlas.vanishing, atlas.isolated, atlas.doubly_robust)):
        task.set_visible(False)
        joints.text(0.5, 0.5, "nothing found here", transform=joints.transAxes, ha="center", color=inks.muted)
    for axes in (joints, task):
        axes.grid(color=inks.grid)
    handles, labels = joints.get_legend_handles_labels()
    columns = max(1, min(len(labels), int(width / 2.7)))
    sheet.figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)
    sheet.title(mathtext(atlas.title, TITLE_MAX))


def _draw(axes: Axes, atlas: Atlas, at: Callable[[Any], Vector], plane: Callable[[Vector], Vector] | None) -> None:
    """Edges, curves and points; `at` places a curve, `plane` postures (n, K), else they stand at the end-points."""
    named, inks = set[str](), colors()

    def once(label: str) -> str:
        return "_" if label in named or named.add(label) else label

    for edge in atlas.edges:
        style, line, label = EDGES[edge.kind]
        color = inks.muted if edge.kind == "limit" else inks.text
        axes.plot(*at(edge), linestyle=style, color=color, linewidth=line, label=once(label), zorder=1.5)
    for curve in atlas.curves:
        color, style = mode_line(curve.mode)
        label = once(f"$w_{{{curve.mode}}} = 0$")
        # Where curves lie on each other all are seen.
        width = 1.5 + 0.3 * (atlas.modes - curve.mode)
        axes.plot(*at(curve), linestyle=style, color=color, linewidth=width, label=label, zorder=2.5)

    def placed(points: Iterable[RobustPoint]) -> Vector:
        listed = list(points)
        if plane is None:
            return np.array([point.end_point[[0, -1]] for point in listed]).T
        return plane(np.array([point.posture for point in listed]).T)

    for vanishing, face in (("a", inks.page), ("b", inks.other)):
        found = [point for point in atlas.vanishing if point.vanishing == vanishing]
        if found:
            label = f"${vanishing}_i = 0$, beyond it opposed"
            axes.plot(*placed(found), "o", color=face, markeredgecolor=inks.text, markersize=4.5, label=label, zorder=4)
    for mode in sorted({point.modes[0] for point in atlas.isolated}):
        found = [point for point in atlas.isolated if point.modes == (mode,)]
        marker, label = MARKERS[(mode + 1) % len(MARKERS)], f"$w_{{{mode}}} = 0$"
        axes.plot(
            *placed(found), marker, color=mode_line(mode)[0], markeredgecolor=inks.edge, markeredgewidth=0.6,
            markersize=7, label=label, zorder=5,
        )  # fmt: skip
    pairs = sorted({point.modes for point in atlas.doubly_robust})
    for number, pair in enumerate(pairs):
        found = [point for point in atlas.doubly_robust if point.modes == pair]
        marker = MARKERS[number % len(MARKERS)]
        label = f"$w_{{{pair[0]}}} = w_{{{pair[1]}}} = 0$"
        axes.plot(
            *placed(found), marker, color=inks.emphasis, markeredgecolor=inks.edge, markeredgewidth=0.9,
            markersize=11 if marker == "*" else 6.5, label=label, zorder=5,
        )  # fmt: skip
    if plane is not None and atlas.singular.size:
        axes.plot(*plane(atlas.singular), "x", color=inks.text, markersize=6, label="singular posture", zorder=4)


def mode_line(mode: int) -> tuple[str, Any]:
    """Colour and style of the curves of a mode, counted from 1."""
    series = colors().series
    return series[(mode - 1) % len(series)], STYLES[(mode - 1) % len(STYLES)]


def _frame(axes: Axes, atlas: Atlas) -> None:
    """The plane of the two joints: ranges, and what lies beyond limits hatched."""
    ranges = np.array([atlas.x_range, atlas.y_range])
    spans = np.ptp(ranges, axis=1)
    beyond = np.where(atlas.periodic, SEAM, MARGIN)
    shown = ranges + (beyond * spans)[:, None] * [-1, 1]
    style: dict[str, Any] = {
        "label": "beyond the joints' limits",
        "facecolor": colors().grid,
        "edgecolor": colors().other,
        "hatch": "////",
        "linewidth": 0.0,
    }
    for axis, side in np.argwhere(np.isclose(atlas.limits, ranges)):
        low, high = sorted((float(ranges[axis, side]), float(shown[axis, side])))
        (axes.axhspan if axis else axes.axvspan)(low, high, **style)
        style["label"] = "_"
    axes.set_xlim(*shown[0])
    axes.set_ylim(*shown[1])
    alike = atlas.units[0] == atlas.units[1] and 0.4 <= spans[1] / spans[0] <= 2.5
    axes.set_aspect("equal" if alike else "auto")
    x, y = (f"{mathtext(name)}, {unit}" for name, unit in zip(atlas.varied, atlas.units, strict=True))
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    # Lines end between joints.
    listed = ", ".join(
        f"{name} = {value:g} {unit}".replace(" ", "\N{NO-BREAK SPACE}") for name, value, unit in atlas.held
    )
    title = "robust postures" + (f", {listed}" if listed else "")
    axes.set_title("\n".join(mathtext(line, TITLE_MAX) for line in WRAPPED.wrap(title)))


def _broken(atlas: Atlas, points: Vector) -> Vector:
    """A curve (2, K) with a gap where it leaves the plane on one side and comes in on the other."""
    low, high = np.array([atlas.x_range, atlas.y_range]).T[:, :, None]
    size = high - low
    jumps = np.array(atlas.periodic)[:, None] & (np.abs(np.diff(points, axis=1)) > size / 2)
    parts: list[Vector] = []
    start = 0
    for k in np.flatnonzero(jumps.any(axis=0)):
        # Where it leaves it is drawn on beyond the edge, and comes in from beyond it.
        shift = np.where(jumps[:, k], np.sign(points[:, k] - points[:, k + 1]), 0.0)[:, None] * size
        parts += [points[:, start : k + 1], points[:, k + 1 : k + 2] + shift, np.full((2, 1), np.nan)]
        parts.append(points[:, k : k + 1] - shift)
        start = k + 1
    return np.concatenate([*parts, points[:, start:]], axis=1)
