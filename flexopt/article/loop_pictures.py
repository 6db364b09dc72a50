"""Figure 10 of the article, and the gains that its postures allow.

In: base trajectories, a map of growth rates over two gains. Out: matplotlib figures.
"""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import SymLogNorm
from matplotlib.figure import Figure

from flexopt.foundation.palette import colors
from flexopt.plotting.fields import cell_edges, draw_border, signed_colors
from flexopt.plotting.panels import Panel, draw_stack
from flexopt.plotting.scene import Actor, draw_scene, legend_above
from flexopt.plotting.shape import chain, views
from flexopt.plotting.sheet import SettledLayout, sized
from flexopt.plotting.units import labelled
from flexopt.robustness.residues import residue_unit
from flexopt.selection.nullspace.base_trajectory import BaseTrajectory
from flexopt.study.gains import GainMap

# Growth rates below this are drawn on a linear scale, above RATE_SHOWN in one colour, 1/s.
RATE_LINEAR, RATE_SHOWN = 0.01, 10.0


@sized
def plot_figure10(stopped: BaseTrajectory, climb: BaseTrajectory) -> Figure:
    """The base's way with and without a stop: the machine at its ends, base position, its rate and V over time."""
    figure = Figure(figsize=(9.6, 4.9), layout=SettledLayout())
    grid = figure.add_gridspec(3, 2, width_ratios=[1.15, 1.0])
    inks = colors()
    ends = {
        "A": (stopped.initial.skeleton, inks.present, True),
        "at the stop (B)": (stopped.final.skeleton, inks.chosen, False),
        "where the law ends": (climb.final.skeleton, inks.other, False),
    }
    axes = figure.add_subplot(grid[:, 0])
    actors = [
        Actor(chain(skeleton), color, f"{name}: {skeleton[0, 0]:.3f} m".replace("-", "−"), ghost)
        for name, (skeleton, color, ghost) in ends.items()
    ]
    draw_scene(axes, views(actors[0].shape)[0], actors, stopped.target)
    legend_above(axes, title="x of the undercarriage")
    unit = residue_unit(stopped.control, stopped.final.joint_units)
    # The shorter one last: on its way both are the same.
    both = {"no stop": climb, "stop at B": stopped}
    panels = [
        Panel("base position, m", tuple((name, t.time, t.base[:, 0]) for name, t in both.items())),
        Panel("base rate, m/s", tuple((name, t.time, t.base_rate[:, 0]) for name, t in both.items()), steps=True),
        Panel(
            labelled(f"V: {stopped.objective}", unit),
            tuple((name, t.time, t.V) for name, t in both.items()),
        ),
    ]
    first = draw_stack(figure, [grid[row, 1] for row in range(3)], panels, legends=1)[0]
    first.set_xlim(0.0, 1.02 * float(climb.time[-1]))
    figure.suptitle("Fig. 10: the base's way by nullspace augmentation")
    return figure


@sized
def plot_gains(gains: GainMap, pairs: Sequence[tuple[float, float]], *, kv: float, ratios: Sequence[float]) -> Figure:
    """Decay of the sampled linear loop over Kp and Kv for each posture, with verdicts of nonlinear runs.

    Args:
        gains: the map.
        pairs: gains (Kp, Kv) of the other figures, as stars.
        kv: held along a border.
        ratios: Kv/Kp held, s, two at most.
    """
    figure = Figure(figsize=(4.3 * len(gains.names) + 0.8, 5.0), layout=SettledLayout())
    inks, norm = colors(), SymLogNorm(RATE_LINEAR, vmin=-RATE_SHOWN, vmax=RATE_SHOWN)
    tested_kp, tested_kv = np.meshgrid(gains.tested_kp, gains.tested_kv)
    image: Any = None
    for k, name in enumerate(gains.names):
        axes = figure.add_subplot(1, len(gains.names), k + 1)
        decay, grows = -gains.growth_rate[k], np.asarray(gains.grows[k], dtype=bool)
        kp, kv_edges = (10 ** cell_edges(np.log10(values)) for values in (gains.kp, gains.kv))
        image = axes.pcolormesh(kp, kv_edges, decay, norm=norm, cmap=signed_colors(), rasterized=True)
        draw_border(axes, kp, kv_edges, decay, width=1.3)
        for mask, mark, color, label in (
            (grows, "^", inks.text, "run grows"),
            (~grows, "o", inks.page, "run converges"),
        ):
            axes.plot(
                tested_kp[mask], tested_kv[mask], mark, color=color, markersize=3.0, markeredgewidth=0.4,
                markeredgecolor=inks.text, linestyle="none", label=label,
            )  # fmt: skip
        differ = [d for d in gains.disagreements if d.stand == name]
        axes.plot(
            [d.kp for d in differ], [d.kv for d in differ], "x", color=inks.undecided, markersize=6,
            markeredgewidth=1.4, label="run and eigenvalues differ",
        )  # fmt: skip
        axes.axhline(kv, color=inks.muted, linewidth=1.0, linestyle="--", label=f"Kv = {kv:g} N m s")
        for ratio, style in zip(ratios, (":", "-."), strict=False):
            axes.plot(gains.kp, ratio * gains.kp, style, color=inks.muted, linewidth=1.1, label=f"Kv/Kp = {ratio:g} s")
        axes.plot(
            *np.array(pairs).T, "*", color=inks.emphasis, markeredgecolor=inks.edge, markersize=8, linestyle="none",
            label="gains of the other figures",
        )  # fmt: skip
        axes.set(xscale="log", yscale="log", xlim=(gains.kp[0], gains.kp[-1]), ylim=(gains.kv[0], gains.kv[-1]))
        axes.minorticks_off()
        axes.set_xlabel("Kp, N m")
        axes.set_ylabel("Kv, N m s" if k == 0 else "")
        axes.set_title(f"({'abcdefgh'[k]}) {name}")
    bar = figure.colorbar(image, ax=figure.axes, shrink=0.9, pad=0.01, extend="both")
    bar.set_label("decay of the sampled linear loop, 1/s")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, markerscale=1.2, handlelength=3.0)
    return figure
