"""The picture of a workspace map: frequencies, measures, in-phase regions and margin."""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flexopt.foundation.escapes import TITLE_MAX, mathtext
from flexopt.plotting.fields import FieldPlane, Values, draw_field, draw_marks, draw_regions, draw_signed, label_plane
from flexopt.plotting.files import write

# Up to where ratios of an axis are equal.
EVEN = 1e-9


def dataset_plane(dataset: Any) -> FieldPlane:
    """The axes of a map's dataset."""
    rows, columns = dataset["reachable"].dims
    if dataset.attrs["frame"].startswith("workspace"):
        labels = [f"{columns}, m (workspace frame)", f"{rows}, m (workspace frame)"]
        return FieldPlane(_array(dataset, columns), _array(dataset, rows), labels[0], labels[1])
    labels = [
        f"{mathtext(dataset[name].attrs['long_name'], TITLE_MAX)}, {dataset[name].attrs['units']}"
        for name in (columns, rows)
    ]
    x, y = (_array(dataset, name) for name in (columns, rows))
    plain = [label.removesuffix(", 1") for label in labels]
    return FieldPlane(x, y, plain[0], plain[1], (_geometric(x), _geometric(y)))


def _geometric(values: Values) -> bool:
    """Whether an axis is evenly spaced in its logarithm."""
    return bool(values[0] > 0 and values.size > 2 and abs(values[0] * values[2] / values[1] ** 2 - 1) < EVEN)


def plot_workspace(
    dataset: Any,
    path: str | os.PathLike[str] | None = None,
    *,
    marks: Mapping[str, tuple[float, float]] | None = None,
) -> Figure:
    """Draw a map: a row for frequencies, w_i and in-phase regions, a column for each mode, and what concerns all.

    Args:
        dataset: the xarray.Dataset of a `WorkspaceMap`.
        path: file to write (`.png`, `.svg`, `.pdf`), or None.
        marks: points of the plane to show, name -> (x, y); the dataset's own by default.

    Raises:
        WriteError: the file cannot be written.
    """
    plane, panels = dataset_plane(dataset), _panels(dataset)
    shown = json.loads(dataset.attrs.get("marks", "{}")) if marks is None else marks
    columns = max(len(row) for row in panels)
    each = _height(plane)
    figure = Figure(figsize=(1.0 + 3.9 * columns, 0.8 + (0.45 + each) * len(panels)), layout="constrained")
    for row, entries in enumerate(panels):
        for column, panel in enumerate(entries):
            axes = figure.add_subplot(len(panels), columns, row * columns + column + 1)
            _draw(axes, plane, panel)
            draw_marks(axes, _placed(plane, shown))
            label_plane(axes, plane, panel[1], left=column == 0, bottom=row == len(panels) - 1)
    if shown:
        figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower right", ncols=3, fontsize=8.5)
    gain = f", kr = {float(dataset.attrs['gain']):.3g}" if "gain" in dataset.attrs else ""
    figure.suptitle(f"{mathtext(dataset.attrs['title'], TITLE_MAX)}{gain}", fontsize=11)
    write(figure, path, dpi=150)
    return figure


def plot_quantities(dataset: Any, *, marks: Mapping[str, tuple[float, float]]) -> dict[str, Figure]:
    """Each panel of a map as a picture of its own, by its title without mathematics."""
    plane, found = dataset_plane(dataset), dict[str, Figure]()
    for panel in sum(_panels(dataset), list[Panel]()):
        figure = Figure(figsize=(5.2, 1.3 + 1.3 * _height(plane)), layout="constrained")
        axes = figure.add_subplot()
        _draw(axes, plane, panel)
        draw_marks(axes, _placed(plane, marks))
        label_plane(axes, plane, panel[1])
        if marks:
            figure.legend(*axes.get_legend_handles_labels(), loc="outside lower right", ncols=3, fontsize=8.5)
        found[_plain(panel[1])] = figure
    return found


def _plain(title: str) -> str:
    return title.replace("$\\lambda_{min}(R_0 + R_0^T)$", "λmin(R0 + R0ᵀ)").replace("$", "").replace("w_", "w")


def _height(plane: FieldPlane) -> float:
    """Of a panel, inches, beside a width of 3."""
    width, height = (np.ptp(values) for values in plane.scaled)
    return 3.0 * (min(2.0, max(0.6, height / width)) if plane.aspect == "equal" else 0.8)


def _draw(axes: Axes, plane: FieldPlane, panel: Panel) -> None:
    kind, _, label, values = panel
    if kind == "regions":
        draw_regions(axes, plane, values)
    elif kind == "signed":
        draw_signed(axes, plane, values, label=label)
    else:
        draw_field(axes, plane, values, label=label, clipped=kind == "clipped")


def _placed(plane: FieldPlane, marks: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """Points where axes that are logarithmic show them."""
    log_x, log_y = plane.logarithmic
    return {name: (float(np.log10(x)) if log_x else x, float(np.log10(y)) if log_y else y)
            for name, (x, y) in marks.items()}  # fmt: skip


Panel = tuple[str, str, str, Values]


def _panels(dataset: Any) -> list[list[Panel]]:
    """Rows of (how to draw, title, label of the colours, values)."""
    rows: list[list[Panel]] = []
    whole: list[Panel] = []
    if "w" in dataset:
        frequency, w, in_phase = (_array(dataset, name) for name in ("frequency_hz", "w", "in_phase"))
        unit = dataset["w"].attrs["units"].replace("m2", "m²")
        modes = range(len(w))
        rows.append([("field", f"mode {i + 1}: frequency", "Hz", frequency[i]) for i in modes])
        rows.append([("clipped", f"mode {i + 1}: $w_{i + 1}$", unit, w[i]) for i in modes])
        rows.append([("regions", f"mode {i + 1}: in phase (yellow)", "", in_phase[i]) for i in modes])
        if len(w) > 1:
            whole.append(("regions", "modes 1 and 2 both in phase (yellow)", "", in_phase[0] * in_phase[1]))
        whole.append(("clipped", "rigid part: $\\lambda_{min}(R_0 + R_0^T)$", unit, _array(dataset, "rigid")))
    if "epsilon_max" in dataset:
        whole.insert(0, ("clipped", "robust stability margin", "$\\epsilon_{max}$", _array(dataset, "epsilon_max")))
    loop: list[Panel] = []
    if "decay" in dataset:
        loop.append(("signed", "sampled loop: decay (green: stable)", "1/s", _array(dataset, "decay")))
        loop.append(("field", "its slowest motion", "Hz", _array(dataset, "loop_frequency_hz")))
    if dataset.attrs["over"] == "loop":
        return [loop]
    if not whole:
        whole.append(("field", "condition of the rigid-body Jacobian", "cond Jv", _array(dataset, "condition")))
    rows = [*rows, whole] if max(map(len, rows), default=0) != 1 else [sum(rows, list[Panel]()), whole]
    return [*rows, loop] if loop else rows


def _array(dataset: Any, name: str) -> Values:
    return np.asarray(dataset[name].values, dtype=float)
