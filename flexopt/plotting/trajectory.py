"""Pictures of closed-loop runs: one in full, or several side by side.

In: trajectories. Out: figures of end-point error (mm), the base's deflections (mm, mrad), torques and energy, in
thousands (kN m, kJ) where there are such.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from numpy.typing import NDArray

from flexopt.errors import Fault
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.boundary import instance
from flexopt.foundation.doubt import with_doubt
from flexopt.foundation.escapes import LEGEND_MAX, mathtext
from flexopt.plant import build_plant
from flexopt.plotting.panels import Panel, draw_stack
from flexopt.plotting.sheet import Sheet, picture
from flexopt.simulation.trajectory import Trajectory

# N m, N or J below which thousands would be small fractions.
SMALL = 100.0


def _size(t: Trajectory) -> tuple[float, float]:
    return 7.2, 0.9 + 1.45 * max(3, t.n_passive)


@picture("Trajectory", size=_size, check=instance(Trajectory, "a Trajectory, from flexopt.simulate for example"))
def plot_trajectory(sheet: Sheet, trajectory: Trajectory) -> None:
    """Draw a run over time: end-point error, torques and energy; each passive coordinate with its envelope.

    Envelopes are ±A exp(−d t), d the decay, A the least that holds the second half of the run, from which d was
    found. A run that diverges is drawn up to the last number, on axes that show what came before. Of long runs the
    extremes of every 1,200th part are drawn.
    """
    t = trajectory
    prefix, size = _prefix(t.torque)
    torques = Panel(
        _torque_label(t, prefix),
        tuple((mathtext(j, LEGEND_MAX), t.time, size * row) for j, row in zip(t.joints, t.torque.T, strict=True)),
    )
    more, of_energy = _prefix(t.energy)
    energy = Panel(f"energy, {more}J", (("energy", t.time, of_energy * t.energy),), logarithmic=True)
    deflections = [deflection_panel({"deflection": t}, k, _known_rate(t)) for k in range(t.n_passive)]
    left, right = [error_panel(t), torques, energy], deflections
    drawn = _draw_columns(sheet.figure, left, right)
    if right and drawn[len(left)].lines[1:]:
        drawn[len(left)].set_title(r"dashed: $\pm A\,e^{-\mathrm{decay}\;t}$", loc="right")
    sheet.title(title(t))


def _runs(arguments: Arguments, field: str, runs: Any) -> Any:
    """A mapping name -> Trajectory whose passive coordinates agree."""
    if not isinstance(runs, Mapping) or not runs:
        arguments.note(field, "must be a dictionary with at least one entry, name -> Trajectory", runs)
        return None
    passive: dict[str, tuple[str, ...]] = {}
    for name, run in cast(Mapping[Any, Any], runs).items():
        if isinstance(run, Trajectory):
            passive[str(name)] = run.coordinates[: run.n_passive]
        else:
            arguments.note(str(name), "must be a Trajectory, from flexopt.simulate for example", run)
    expected = next(iter(passive.values()), ())
    arguments.faults += [
        Fault(name, f"must have the passive coordinates of the first run ({', '.join(expected)})", ", ".join(its))
        for name, its in passive.items()
        if its != expected
    ]
    return cast(Any, runs)


def _size_of_runs(runs: Mapping[str, Trajectory]) -> tuple[float, float]:
    first = next(iter(runs.values()))
    return 7.2, 0.9 + 0.3 * len(runs) + 1.4 * max(len(first.model.task_rows), first.n_passive)


@picture("", size=_size_of_runs, check=_runs)
def plot_trajectories(sheet: Sheet, trajectories: Mapping[str, Trajectory]) -> None:
    """Draw several runs on the same axes: end-point error on the left, the base's oscillation on the right.

    The first argument: name -> run; the runs have the same passive coordinates.
    """
    first = next(iter(trajectories.values()))
    left = [
        Panel(f"error {axis}, mm", tuple((name, t.time, 1e3 * t.error[:, k]) for name, t in trajectories.items()))
        for k, axis in enumerate(first.model.task_rows)
    ]
    right = [deflection_panel(trajectories, k) for k in range(first.n_passive)]
    panels = _draw_columns(sheet.figure, left, right, legends=0)
    handles = panels[0].get_lines()[: len(trajectories)]
    labels = [f"{mathtext(name)}: {outcome(t)}" for name, t in trajectories.items()]
    sheet.figure.legend(handles, labels, loc="outside upper center", ncols=1 if len(labels) > 2 else 2)


def title(trajectory: Trajectory) -> str:
    """The run and its outcome."""
    t = trajectory
    finite = np.flatnonzero(np.isfinite(t.energy))
    until = f", no number after {t.time[finite[-1]]:.3g} s" if 0 < finite.size < t.time.size else ""
    return f"{mathtext(t.machine)}, Jacobian {t.control} control: {outcome(t)}{until}"


def outcome(trajectory: Trajectory) -> str:
    """Verdict and decay."""
    rate, error = trajectory.growth_rate, trajectory.growth_rate_error
    if rate is None:
        return trajectory.verdict
    number = with_doubt(-rate, error, 3, "+").replace("-", "−")
    return f"{trajectory.verdict}, decay {number} s$^{{-1}}$"


def _known_rate(trajectory: Trajectory) -> float | None:
    """The growth rate where at least its sign is known."""
    rate, error = trajectory.growth_rate, trajectory.growth_rate_error
    return rate if rate is None or error is None or abs(rate) > error else None


def _torque_label(trajectory: Trajectory, prefix: str) -> str:
    units = list(dict.fromkeys(trajectory.torque_units))
    word = " or ".join("torque" if unit == "N m" else "force" for unit in units)
    return f"{word}, {' or '.join(f'{prefix}{unit}' for unit in units)}"


def _prefix(values: NDArray[np.float64]) -> tuple[str, float]:
    """Of a unit in which these are seen as numbers of some digits, and what they are multiplied by."""
    most = float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))
    return ("", 1.0) if most < SMALL else ("k", 1e-3)


def error_panel(trajectory: Trajectory) -> Panel:
    """End-point error of every axis."""
    axes = zip(trajectory.model.task_rows, trajectory.error.T, strict=True)
    return Panel("end-point error, mm", tuple((axis, trajectory.time, 1e3 * row) for axis, row in axes))


def deflection_panel(runs: Mapping[str, Trajectory], k: int, rate: float | None = None) -> Panel:
    """Passive coordinate k of every run."""
    first = next(iter(runs.values()))
    coordinate = first.coordinates[k]
    kind = "rotation" if coordinate == "base.rotation" else coordinate.removeprefix("base.")
    unit = "m" + build_plant(first.model).graph.coordinate_units[k]
    name = f"base {kind}" if coordinate.startswith("base.") else kind
    lines = tuple((mathtext(run), t.time, 1e3 * t.deflection[:, k]) for run, t in runs.items())
    return Panel(f"{mathtext(name, LEGEND_MAX)}, {unit}", lines, rate)


def _draw_columns(figure: Figure | SubFigure, *columns: Sequence[Panel], legends: int = 100) -> list[Axes]:
    """Columns of panels that share their time axis, each column as high as the figure."""
    grid = figure.add_gridspec(1, len(columns))
    drawn: list[Axes] = []
    for column, panels in enumerate(columns):
        rows = grid[column].subgridspec(max(1, len(panels)), 1)
        drawn += draw_stack(figure, rows, panels, drawn[0] if drawn else None, legends)
    return drawn
