"""Quantities over a plane: coloured fields, in-phase regions, and postures drawn over them."""

# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LinearSegmentedColormap, ListedColormap, Normalize, TwoSlopeNorm, to_rgb
from matplotlib.image import AxesImage
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator

from flexopt.foundation.arrays import Array
from flexopt.foundation.palette import colors
from flexopt.plotting.ticks import DECADES, between_powers, digits_of, shown

# Near singular postures the measures fall without end: colours and axes start at this fraction of the points.
LOWEST_SHOWN = 0.05
# Share of a field by which its values differ from rounding alone.
SAME = 1e-9
# Share of a field's range by which its greatest value may miss a bound of 0 that the colours then end at.
MISSED = 0.01
# How far from an end-point its name stands, as a share of a field's width.
BESIDE = 0.08


@dataclass(frozen=True)
class FieldPlane:
    """The axes of a field: values (n_x,), (n_y,), and their labels."""

    x: Array
    y: Array
    x_label: str
    y_label: str
    logarithmic: tuple[bool, bool] = (False, False)

    @property
    def scaled(self) -> tuple[Array, Array]:
        """The axes evenly spaced: in the logarithm (of 10) where one is logarithmic."""
        x, y = (np.log10(v) if log else v for v, log in zip((self.x, self.y), self.logarithmic, strict=True))
        return x, y

    @property
    def edges(self) -> tuple[Array, Array]:
        """Edges of the points' cells on the scaled axes, (n_x + 1,), (n_y + 1,)."""
        x, y = map(cell_edges, self.scaled)
        return x, y

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Edges of the outermost points' cells."""
        (left, *_, right), (low, *_, high) = (edges.tolist() for edges in self.edges)
        return left, right, low, high

    @property
    def aspect(self) -> Literal["equal", "auto"]:
        """The same scale on both axes, unless that made a ribbon."""
        if any(self.logarithmic):
            return "auto"
        return "equal" if 0.25 <= float(np.ptp(self.y) / np.ptp(self.x)) <= 4.0 else "auto"


def array_of(dataset: Any, name: str) -> Array:
    """A variable of a map's dataset."""
    return np.asarray(dataset[name].values, dtype=float)


def cell_edges(values: Array) -> Array:
    """Edges (n + 1,) of the cells of evenly spaced values (n,)."""
    half = float(values[-1] - values[0]) / (values.size - 1) / 2
    return np.linspace(float(values[0]) - half, float(values[-1]) + half, values.size + 1, dtype=np.float64)


def signed_colors() -> LinearSegmentedColormap:
    """From what grows to what settles, dark where it does so fast; the two meet in no common colour."""
    inks = colors()
    light = [_mixed(ink, inks.page, 0.72) for ink in (inks.grows, inks.settles)]
    stops = [(0.0, inks.grows), (0.5, light[0]), (0.5, light[1]), (1.0, inks.settles)]
    return LinearSegmentedColormap.from_list("signed", stops)


def _mixed(color: str, other: str, share: float) -> tuple[float, float, float]:
    a, b = np.array(to_rgb(color)), np.array(to_rgb(other))
    red, green, blue = ((1 - share) * a + share * b).tolist()
    return red, green, blue


def draw_field(axes: Axes, plane: FieldPlane, values: Array, *, label: str, clipped: bool = False) -> None:
    """A field (n_y, n_x) with its colour bar, unless all is NaN, which stays white; what is the same has one colour.

    Args:
        axes: to draw on.
        plane: the axes.
        values: the field.
        label: of the colour bar.
        clipped: let the colours begin at the lowest twentieth of the values, marked by an arrow.
    """
    finite = values[np.isfinite(values)]
    low, high = float(np.quantile(finite, LOWEST_SHOWN)) if clipped and finite.size else None, None
    if finite.size and np.ptp(finite) <= SAME * np.max(np.abs(finite)):
        middle = float(np.mean(finite))
        low, high, clipped = *sorted((0.9 * middle, 1.1 * middle or 1.0)), False
    elif finite.size and -MISSED * np.ptp(finite) < finite.max() < 0:
        high = 0.0
    image = axes.imshow(
        values, extent=plane.extent, origin="lower", interpolation="nearest", aspect=plane.aspect, cmap="viridis",
        vmin=low, vmax=high,
    )  # fmt: skip
    if finite.size:
        _bar(axes, image, label, extend="min" if clipped else "neither")


def _scaled(label: str, bar: Colorbar, image: AxesImage) -> str:
    """A bar's label with the power of ten before its unit, its numbers scaled: over the bar a power meets the title."""
    largest = max(map(abs, image.get_clim()))
    if type(image.norm) is not Normalize or not largest > 0 or 1e-2 <= largest < 1e4:
        return label
    power = math.floor(math.log10(largest))

    def scaled(x: float, _: int | None) -> str:
        return f"{x / 10.0**power:.6g}".replace("-", "\N{MINUS SIGN}")

    bar.formatter = FuncFormatter(scaled)
    name, comma, unit = label.rpartition(", ")
    factor = f"$10^{{{power}}}$"
    return name + comma + (factor + unit[1:] if unit.startswith("1/") else f"{factor} {unit}")


def _bar(axes: Axes, image: AxesImage, label: str, *, extend: Literal["neither", "both", "min", "max"]) -> Colorbar:
    """The scale of colours beside axes, as high as these."""
    figure = axes.get_figure()
    assert figure is not None
    bar = figure.colorbar(image, cax=axes.inset_axes((1.03, 0.0, 0.05, 1.0)), extend=extend)
    bar.set_label(_scaled(label, bar, image))
    bar.outline.set_edgecolor(colors().line)  # pyright: ignore[reportCallIssue]
    return bar


def draw_signed(axes: Axes, plane: FieldPlane, values: Array, *, label: str) -> None:
    """A field whose sign decides, with its border: above 0 it settles, below it grows; NaN grey."""
    finite = values[np.isfinite(values)]
    above, below = finite[finite > 0], -finite[finite < 0]
    low, high = (float(np.quantile(part, 1 - LOWEST_SHOWN)) if part.size else 1e-3 for part in (below, above))
    axes.set_facecolor(colors().line)
    image = axes.imshow(
        values, extent=plane.extent, origin="lower", interpolation="nearest", aspect=plane.aspect, cmap=signed_colors(),
        norm=TwoSlopeNorm(0.0, -low, high),
    )  # fmt: skip
    draw_border(axes, *plane.edges, values, width=0.8)
    if not finite.size:
        return
    # Of a field on one side of 0 the bar shows that side alone.
    extend = "both" if above.size and below.size else "min" if below.size else "max"
    bar = _bar(axes, image, label, extend=extend)
    ends = -low if below.size else 0.0, high if above.size or not below.size else 0.0
    bar.set_ticks([tick for tick in (-low, -low / 2, 0.0, high / 2, high) if ends[0] <= tick <= ends[1]])
    bar.ax.set_ylim(*ends)
    bar.ax.yaxis.set_major_formatter(lambda value, _: shown(value, 2))


def draw_border(axes: Axes, x: Array, y: Array, values: Array, *, width: float) -> None:
    """A line along the edges x (n_x + 1,), y (n_y + 1,) between cells that settle, values (n_y, n_x) above 0, and grow.

    A contour would be off by half a cell: decay bends where another motion becomes the slowest, often at the border.
    """
    known, settles = np.isfinite(values), values > 0
    beside = known[:, 1:] & known[:, :-1] & (settles[:, 1:] != settles[:, :-1])
    upon = known[1:] & known[:-1] & (settles[1:] != settles[:-1])
    upright = [[(x[j + 1], y[i]), (x[j + 1], y[i + 1])] for i, j in np.argwhere(beside)]
    flat = [[(x[j], y[i + 1]), (x[j + 1], y[i + 1])] for i, j in np.argwhere(upon)]
    lines = LineCollection(upright + flat, colors=colors().text, linewidths=width, capstyle="projecting")
    axes.add_collection(lines, autolim=False)


def draw_regions(axes: Axes, plane: FieldPlane, values: Array) -> None:
    """In-phase points (1) yellow, the others (0) blue, what is not mapped (NaN) bare."""
    axes.imshow(
        values, extent=plane.extent, origin="lower", interpolation="nearest", aspect=plane.aspect, vmin=0.0, vmax=1.0,
        cmap=ListedColormap([colors().out_of_phase, colors().in_phase]),
    )  # fmt: skip


def label_plane(axes: Axes, plane: FieldPlane, title: str, *, left: bool = True, bottom: bool = True) -> None:
    """Title and labels; those of inner panels are left out."""
    axes.set_title(title)
    axes.set_xlabel(plane.x_label if bottom else "")
    axes.set_ylabel(plane.y_label if left else "")
    # Numbers beside each other take more room than below each other.
    sides = zip((axes.xaxis, axes.yaxis), plane.logarithmic, (plane.x, plane.y), (4, 7), strict=True)
    for axis, log, values, most in sides:
        if log and values.max() < DECADES * values.min():
            steps = between_powers(float(values.min()), float(values.max()), most)
            axis.set_major_locator(FixedLocator(np.log10(steps).tolist()))
            digits = digits_of(steps)
            axis.set_major_formatter(lambda value, _, digits=digits: shown(10**value, digits))
        elif log:
            axis.set_major_locator(MaxNLocator(4, integer=True))
            axis.set_major_formatter(lambda value, _: f"$10^{{{value:g}}}$")
        else:
            axis.set_major_locator(MaxNLocator(5))


def draw_marks(axes: Axes, marks: Mapping[str, tuple[float, float]]) -> None:
    """Named points: what is chosen a star, the end-point a cross, others rings."""
    inks = colors()
    for name, point in marks.items():
        marker, size = {"chosen": ("*", 10.0), "end-point": ("+", 9.0)}.get(name, ("o", 5.5))
        shared = marker == "o" and any(other == point for others, other in marks.items() if others != name)
        # Round what stands at the same place.
        size, face = (13.0, "none") if shared else (size, "white")
        axes.plot(
            *point, marker=marker, markerfacecolor=face, markersize=size, markeredgecolor=inks.mark,
            markeredgewidth=1.2, linestyle="none", label=name, zorder=5,
        )  # fmt: skip


def draw_best(axes: Axes, plane: FieldPlane, values: Array) -> None:
    """A star where a field (n_y, n_x) is largest; none where it is the same everywhere."""
    finite = values[np.isfinite(values)]
    if not finite.size or np.ptp(finite) <= SAME * np.max(np.abs(finite)):
        return
    row, column = np.unravel_index(int(np.nanargmax(values)), values.shape)
    x, y = plane.scaled
    axes.plot(
        x[column], y[row], "*", color="black", markeredgecolor="white", markersize=16, markeredgewidth=0.8,
        linestyle="none", label="best place of this panel", zorder=4,
    )  # fmt: skip


def draw_arms(axes: Axes, arms: Mapping[str, Array]) -> None:
    """Arms (2, joints and end-point) over a field, each with its name beside the end-point, off all of them."""
    inks, links = colors(), [(arm[:, k], arm[:, k + 1]) for arm in arms.values() for k in range(arm.shape[1] - 1)]
    away = BESIDE * abs(float(np.diff(axes.get_xlim())[0]))
    for name, arm in arms.items():
        # Beyond the last link, or as little turned from there as leaves room.
        last = (arm[:, -1] - arm[:, -2]) / max(float(np.linalg.norm(arm[:, -1] - arm[:, -2])), 1e-12)
        turns = sorted(np.linspace(-np.pi, np.pi, 24, endpoint=False).tolist(), key=abs)
        ways = [np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]]) @ last for t in turns]
        rooms = [min(_apart(arm[:, -1] + away * way, *link) for link in links) for way in ways]
        free = [way for way, room in zip(ways, rooms, strict=True) if room >= 0.95 * away]
        way = free[0] if free else ways[int(np.argmax(rooms))]
        axes.plot(arm[0], arm[1], "-", color="white", linewidth=3.4, solid_capstyle="round", zorder=4)
        axes.plot(
            arm[0], arm[1], "-o", color=inks.mark, linewidth=1.9, markersize=4.0, markeredgecolor="white",
            markeredgewidth=0.6, label=f"posture {name}", zorder=5,
        )  # fmt: skip
        axes.annotate(
            name, (float(arm[0, -1]), float(arm[1, -1])), xytext=(13.0 * float(way[0]), 13.0 * float(way[1])),
            textcoords="offset points", fontsize=9.5, fontweight="bold", color=inks.mark, zorder=6, ha="center",
            va="center",
            bbox={"boxstyle": "round,pad=0.12", "facecolor": inks.page, "edgecolor": "none", "alpha": 0.85},
        )  # fmt: skip


def _apart(point: Array, start: Array, end: Array) -> float:
    """Distance of a point from a line's length."""
    along = end - start
    share = float(np.clip((point - start) @ along / max(float(along @ along), 1e-300), 0.0, 1.0))
    return float(np.linalg.norm(start + share * along - point))
