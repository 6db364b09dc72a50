"""The picture of a workspace map: frequencies, measures, in-phase regions and margin."""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flexopt.foundation.arrays import Array
from flexopt.foundation.escapes import TITLE_MAX, mathtext
from flexopt.plotting.fields import (
    FieldPlane,
    array_of,
    draw_best,
    draw_field,
    draw_marks,
    draw_regions,
    draw_signed,
    label_plane,
)
from flexopt.plotting.sheet import SettledLayout, Sheet, picture, themed
from flexopt.plotting.units import labelled
from flexopt.robustness.residues import written_unit


def dataset_plane(dataset: Any) -> FieldPlane:
    """The axes of a map's dataset."""
    rows, columns = dataset["reachable"].dims
    if dataset.attrs["frame"].startswith("workspace"):
        labels = [f"{columns}, m (workspace frame)", f"{rows}, m (workspace frame)"]
        return FieldPlane(array_of(dataset, columns), array_of(dataset, rows), labels[0], labels[1])
    labels = [
        f"{mathtext(dataset[name].attrs['long_name'], TITLE_MAX)}, {dataset[name].attrs['units']}"
        for name in (columns, rows)
    ]
    x, y = (array_of(dataset, name) for name in (columns, rows))
    plain = [f"{label.removesuffix(', 1')}, –" if label.endswith(", 1") else label for label in labels]
    return FieldPlane(x, y, plain[0], plain[1], (_geometric(x), _geometric(y)))


def _geometric(values: Array) -> bool:
    """Whether an axis is evenly spaced in its logarithm; over a narrow range it nearly is, too, where it is even."""
    half = (values.size - 1) // 2
    low, middle, high = values[[0, half, 2 * half]].tolist()
    return low > 0 and abs(low * high - middle**2) < abs(low - 2 * middle + high) * middle


def _each(plane: FieldPlane) -> float:
    """Height of a panel, in."""
    width, height = (np.ptp(values) for values in plane.scaled)
    return 2.5 * (min(1.6, max(0.6, float(height / width))) if plane.aspect == "equal" else 0.8)


def _size(chart: Any) -> tuple[float, float]:
    panels = _panels(chart.dataset)
    columns = max(len(row) for row in panels)
    return 0.8 + 3.2 * columns, 1.1 + (0.55 + _each(dataset_plane(chart.dataset))) * len(panels)


def _laid(panels: list[list[MapPanel]], size: tuple[float, float], each: float) -> list[list[MapPanel]]:
    """Rows as columns where that makes panels larger, as on a slide, and leaves no gap before a panel."""
    lengths = [len(row) for row in panels]

    def share(rows: int, columns: int) -> float:
        return min((size[0] - 0.8) / (3.2 * columns), (size[1] - 1.1) / ((0.55 + each) * rows))

    if lengths != sorted(lengths, reverse=True) or share(lengths[0], len(panels)) <= share(len(panels), lengths[0]):
        return panels
    return [[row[k] for row in panels if k < len(row)] for k in range(lengths[0])]


def _count(chart: Any) -> int:
    return sum(map(len, _panels(chart.dataset)))


@picture("WorkspaceMap", size=_size, panels=_count)
def plot_workspace(sheet: Sheet, chart: Any, *, marks: Mapping[str, tuple[float, float]] | None = None) -> None:
    """Draw a map: a row for frequencies, w_i and in-phase regions, a column for each mode, and what concerns all.

    On a wide sheet rows are columns. On a map of the placement a star in each panel of a measure marks where that is
    best. `marks`: points of the plane to show, name -> (x, y); the map's own by default.
    """
    dataset = chart.dataset
    plane = dataset_plane(dataset)
    panels = _laid(_panels(dataset), sheet.size, _each(plane))
    shown = json.loads(dataset.attrs.get("marks", "{}")) if marks is None else marks
    columns, named = max(len(row) for row in panels), dict[str, Any]()
    for row, entries in enumerate(panels):
        for column, panel in enumerate(entries):
            place = (len(panels), columns, row * columns + column + 1)
            axes = sheet.only() if _count(chart) == 1 else sheet.figure.add_subplot(*place)
            _draw(axes, plane, panel, best=dataset.attrs["over"] == "base")
            draw_marks(axes, _placed(plane, shown))
            # Where nothing stands below a panel it has the axis' name itself.
            bottom = row == len(panels) - 1 or column >= len(panels[row + 1])
            # Beside the bar of another panel an axis without a name seems to have that bar's.
            left = column == 0 or dataset.attrs["over"] == "loop"
            label_plane(axes, plane, panel[1], left=left, bottom=bottom)
            handles, names = axes.get_legend_handles_labels()
            named |= dict(zip(names, handles, strict=True))
    if named and sheet.axes is None:
        sheet.figure.legend(list(named.values()), list(named), loc="outside lower right", ncols=3, frameon=False)
    attrs = dataset.attrs
    gain = f", kr = {float(attrs['gain']):.3g} {attrs['gain_unit']}" if "gain" in attrs else ""
    if sheet.axes is None:
        sheet.title(textwrap.fill(f"{mathtext(attrs['title'], TITLE_MAX)}{gain}", int(15 * sheet.size[0])))


@themed
def plot_quantities(chart: Any, *, marks: Mapping[str, tuple[float, float]]) -> dict[str, Figure]:
    """Each panel of a map as a picture of its own, by its title without mathematics."""
    dataset = chart.dataset
    plane, found = dataset_plane(dataset), dict[str, Figure]()
    for panel in sum(_panels(dataset), list[MapPanel]()):
        figure = Figure(figsize=(5.2, 1.3 + 1.6 * _each(plane)), layout=SettledLayout())
        axes = figure.add_subplot()
        _draw(axes, plane, panel, best=dataset.attrs["over"] == "base")
        draw_marks(axes, _placed(plane, marks))
        label_plane(axes, plane, panel[1])
        handles, names = axes.get_legend_handles_labels()
        if names:
            figure.legend(handles, names, loc="outside lower right", ncols=3, frameon=False)
        found[_plain(panel[1])] = figure
    return found


def _plain(title: str) -> str:
    return title.replace("$\\lambda_{min}(R_0 + R_0^T)$", "λmin(R0 + R0ᵀ)").replace("$", "").replace("w_", "w")


def _draw(axes: Axes, plane: FieldPlane, panel: MapPanel, *, best: bool) -> None:
    """One panel; `best`: with a star at the best place of a measure."""
    kind, _, label, values = panel
    if kind == "regions":
        draw_regions(axes, plane, values)
    elif kind == "signed":
        draw_signed(axes, plane, values, label=label)
    else:
        draw_field(axes, plane, values, label=label, clipped=kind == "clipped")
    if best and kind in ("clipped", "signed"):
        draw_best(axes, plane, values)


def _placed(plane: FieldPlane, marks: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """Points where axes that are logarithmic show them."""
    log_x, log_y = plane.logarithmic
    return {name: (float(np.log10(x)) if log_x else x, float(np.log10(y)) if log_y else y)
            for name, (x, y) in marks.items()}  # fmt: skip


MapPanel = tuple[str, str, str, Array]


def _panels(dataset: Any) -> list[list[MapPanel]]:
    """Rows of (how to draw, title, label of the colours, values)."""
    rows: list[list[MapPanel]] = []
    whole: list[MapPanel] = []
    if "w" in dataset:
        frequency, w, in_phase = (array_of(dataset, name) for name in ("frequency_hz", "w", "in_phase"))
        unit = written_unit(dataset["w"].attrs["units"])
        modes = range(len(w))
        rows.append([("field", f"mode {i + 1}: frequency", "frequency, Hz", frequency[i]) for i in modes])
        rows.append([("clipped", f"mode {i + 1}: $w_{i + 1}$", labelled(f"$w_{i + 1}$", unit), w[i]) for i in modes])
        rows.append([("regions", f"mode {i + 1}: in phase (yellow)", "", in_phase[i]) for i in modes])
        if len(w) > 1:
            whole.append(("regions", "modes 1 and 2 both in phase (yellow)", "", in_phase[0] * in_phase[1]))
        whole.append(
            (
                "clipped",
                "rigid part: $\\lambda_{min}(R_0 + R_0^T)$",
                labelled("$\\lambda_{min}$", unit),
                array_of(dataset, "rigid"),
            )
        )
    if "epsilon_max" in dataset:
        label = labelled("$\\epsilon_{max}$", "")
        whole.insert(0, ("clipped", "robust stability margin", label, array_of(dataset, "epsilon_max")))
    loop: list[MapPanel] = []
    if "decay" in dataset:
        loop.append(("signed", "sampled loop: decay, above 0 it settles", "decay, 1/s", array_of(dataset, "decay")))
        loop.append(("field", "its slowest motion", "frequency, Hz", array_of(dataset, "loop_frequency_hz")))
    if dataset.attrs["over"] == "loop":
        return [loop]
    if not whole:
        whole.append(
            ("field", "condition of the rigid-body Jacobian", labelled("cond Jv", ""), array_of(dataset, "condition"))
        )
    rows = [*rows, whole] if max(map(len, rows), default=0) != 1 else [sum(rows, list[MapPanel]()), whole]
    return [*rows, loop] if loop else rows
