"""The picture of an ensemble: how its members end over what varies, and the bands in which they run.

In: an `Ensemble`. Out: a figure.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from flexopt.foundation.arrays import Array
from flexopt.foundation.boundary import instance
from flexopt.foundation.control import RATE_GAIN_UNITS, gain_units
from flexopt.foundation.escapes import TITLE_MAX, mathtext
from flexopt.foundation.palette import colors
from flexopt.plotting.scene import legend_above
from flexopt.plotting.sheet import Sheet, picture
from flexopt.plotting.units import labelled
from flexopt.simulation.ensemble import VERDICTS, Ensemble

# Quantiles of the bands, the outer one first, and how densely they are painted.
BANDS = (((0.05, 0.95), 0.2), ((0.25, 0.75), 0.35))
# From this ratio of its ends, or of its largest and usual values, on an axis is logarithmic.
DECADES = 20.0
# Where what has no number any more is drawn: beyond every axis.
ABOVE = 1e30
BY_NUMBER = "member, by number"
NAMES = {"converges": "settles", "grows": "grows", "undecided": "undecided"}


def _timed(ensemble: Ensemble) -> bool:
    return "time" in ensemble.dataset.dims


@picture(
    "Ensemble",
    size=lambda ensemble: (8.0, 6.2) if _timed(ensemble) else (7.2, 3.8),
    panels=lambda ensemble: 3 if _timed(ensemble) else 1,
    check=instance(Ensemble, "an Ensemble, from flexopt.simulate_ensemble for example"),
)
def plot_ensemble(sheet: Sheet, ensemble: Ensemble) -> None:
    """Draw each member's decay over what varies, coloured by its verdict.

    Of an ensemble that keeps its trajectories also bands over time of the end-point error and of the energy: the
    median, and between which values half and nine tenths of the members are; of those that settle, grow and are
    undecided each their own.
    """
    if not _timed(ensemble):
        _draw_rates(sheet.only(), ensemble)
    else:
        grid = sheet.figure.add_gridspec(2, 2, height_ratios=[1.0, 1.1])
        _draw_rates(sheet.figure.add_subplot(grid[0, :]), ensemble)
        data, drawn = ensemble.dataset, list[Axes]()
        with np.errstate(over="ignore"):  # of what has grown beyond all numbers, drawn up to `ABOVE`
            error = 1e3 * np.linalg.norm(np.asarray(data["error"]), axis=-1)
        panels = (("end-point error, mm", error), ("energy, kJ", 1e-3 * np.asarray(data["energy"])))
        for k, (label, values) in enumerate(panels):
            drawn.append(sheet.figure.add_subplot(grid[1, k]))
            _draw_bands(drawn[-1], ensemble, values)
            drawn[-1].set_ylabel(label)
        drawn[0].set_title("median, half and nine tenths of the members", loc="left")
    shares = ", ".join(f"{100 * ensemble.share(word):.3g} % {NAMES[word]}" for word in VERDICTS if ensemble.share(word))
    name = mathtext(ensemble.plan.scenario.machine.name, TITLE_MAX)
    sheet.title(f"{name}: {ensemble.n_members} members, {shares}")


def _draw_rates(axes: Axes, ensemble: Ensemble) -> None:
    """The exact decay of each member's linear loop."""
    inks = colors()
    label, at = _varied(ensemble)
    decays, verdicts = -ensemble.linear_growth_rate, ensemble.verdict
    for word, marker in zip(VERDICTS, ("o", "^", "s"), strict=True):
        chosen = verdicts == word
        if chosen.any():
            axes.plot(
                at[chosen], decays[chosen], marker, color=getattr(inks, NAMES[word]), markersize=5,
                markeredgecolor=inks.edge, markeredgewidth=0.5, label=NAMES[word],
            )  # fmt: skip
    axes.axhline(0.0, color=inks.muted, linewidth=0.8, zorder=0)
    if label == BY_NUMBER:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    elif at.min() > 0 and at.max() / at.min() > DECADES:
        axes.set_xscale("log")
    axes.set_xlabel(label)
    axes.set_ylabel("decay, 1/s")
    axes.grid(visible=True)
    legend_above(axes, "right", ncols=3)


def _varied(ensemble: Ensemble) -> tuple[str, Array]:
    """What the members are drawn over: the one number in which they differ, or else their own number."""
    name, *others = ensemble.plan.varied
    if not others:
        # As they were asked for: the plan's have in them what drives brake.
        data, told = ensemble.dataset, f"varied.{name}"
        values = np.asarray(data[told if told in data else name], dtype=float)
        if values.ndim == 1:
            scenario = ensemble.plan.scenario
            units = {parameter.name: parameter.unit for parameter in scenario.machine.parameters}
            of_gains = gain_units(scenario.options.control, scenario.machine.joint_units)
            of_gains = RATE_GAIN_UNITS if scenario.loop.structure.served else of_gains
            units |= zip(("kp", "kv", "ki"), of_gains, strict=True)
            return labelled(mathtext(name), units.get(name, "SI")), values
    return BY_NUMBER, np.arange(1.0, ensemble.n_members + 1)


def _draw_bands(axes: Axes, ensemble: Ensemble, values: Array) -> None:
    """Quantiles over time of values (members, samples), each verdict by itself; what has diverged lies above all."""
    time, inks = np.asarray(ensemble.dataset["time"], dtype=float), colors()
    known = values[np.abs(values) < ABOVE]
    sizes = np.where(np.abs(values) < ABOVE, values, ABOVE)
    for word in VERDICTS:
        chosen = sizes[ensemble.verdict == word]
        if not len(chosen):
            continue
        color = getattr(inks, NAMES[word])
        for band, density in BANDS:
            axes.fill_between(time, *np.quantile(chosen, band, axis=0), color=color, alpha=density, linewidth=0.0)
        axes.plot(time, np.median(chosen, axis=0), color=color, label=NAMES[word])
    most, usual = float(known.max(initial=0.0)), float(np.median(known)) if known.size else 0.0
    axes.set_xlim(float(time[0]), float(time[-1]))
    if most > DECADES * usual > 0.0:
        axes.set_yscale("log")
        axes.set_ylim(float(np.quantile(known[known > 0], 0.02)), 1.2 * most)
    else:
        axes.set_ylim(0.0, 1.05 * most or 1.0)
    axes.set_xlabel("time, s")
    axes.grid(visible=True)
