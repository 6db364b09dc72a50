"""The picture of a selection: the machine before and after, and its measures."""

# pyright: reportUnknownMemberType=false
# (the stubs of matplotlib leave keyword arguments untyped)
from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import MaxNLocator

from flexopt.foundation.arrays import Mask
from flexopt.foundation.boundary import instance
from flexopt.foundation.escapes import mathtext
from flexopt.foundation.palette import colors
from flexopt.plotting.scene import Actor, draw_views, legend_above, target_point
from flexopt.plotting.shape import Points, shape_of
from flexopt.plotting.sheet import Sheet, picture
from flexopt.plotting.units import labelled, measure_label, objective_label
from flexopt.robustness.evaluation import Evaluation, unreached, without_rounding
from flexopt.selection.outcomes.result import OutcomeSelection
from flexopt.selection.result import NOTHING, Candidate, Selection

BRANCHES = {-1.0: (0, "elbow up"), 1.0: (1, "elbow down")}
# Fraction of the scan that sets the lower end of the axes: near singular postures the measures fall without end.
WORST_SHOWN = 0.12
# What breaks a constraint: of curves, and of single points.
BROKEN: dict[str, Any] = {"linestyle": ":", "linewidth": 1.0}
BROKEN_POINTS: dict[str, Any] = {"linestyle": "none", "marker": "x", "markersize": 1.4, "alpha": 0.3, "zorder": 1.8}


def _planar(selection: Selection) -> bool:
    return selection.best.evaluation.skeleton.shape[0] == 2


def _size(selection: Selection) -> tuple[float, float]:
    return (10.5, max(4.6, 1.6 * _panels(selection) + 0.8)) if _planar(selection) else (10.5, 8.2)


def _panels(selection: Selection) -> int:
    """Of a planar machine: one for every mode, and one for an objective that these do not tell."""
    return selection.best.evaluation.w.size + _is_another(selection)


def _is_another(selection: Selection) -> bool:
    """Whether the first objective is none of the w_i and ε_max."""
    return isinstance(selection, OutcomeSelection) or selection.problem.sought[0].own is not None


@picture("Selection", size=_size, check=instance(Selection, "a Selection, from flexopt.select for example"))
def plot_selection(sheet: Sheet, selection: Selection) -> None:
    """Draw the machine in the chosen and the present configuration, and its measures.

    A planar machine is drawn beside every w_i along the redundancy, and beside what the loop does or an own objective
    is, where one was asked for; dotted where a configuration breaks a constraint. One in space is drawn from the side,
    across the chosen arm's upright plane, and from above, beside the w_i of the present configuration and of all
    candidates.
    Capsules, support, obstacles and areas of the placement are drawn where there are any.
    """
    figure = sheet.figure
    if _planar(selection):
        count = _panels(selection)
        grid = figure.add_gridspec(count, 2, width_ratios=[1.0, 1.15])
        draw_configurations([figure.add_subplot(grid[:, 0])], selection)
        _draw_along_redundancy(figure, [figure.add_subplot(grid[row, 1]) for row in range(count)], selection)
    else:
        grid = figure.add_gridspec(3, 2, width_ratios=[1.25, 1.0])
        seen = grid[:, 0].subgridspec(2, 1)
        draw_configurations([figure.add_subplot(seen[k, 0]) for k in range(2)], selection)
        draw_candidates([figure.add_subplot(grid[k, 1]) for k in range(3)], selection)
    best = selection.best.evaluation
    other = "".join(f"; candidate {k}" for k, c in enumerate(selection.candidates[1:], 2) if c is selection.best)
    sheet.title(f"{mathtext(best.machine)}: Jacobian {best.control} control, objective {selection.objective}{other}")


def _draw_along_redundancy(figure: Figure | SubFigure, panels: list[Axes], selection: Selection) -> None:
    e, broken = selection.best.evaluation, selection.broken_along_redundancy()
    for row, panel in enumerate(panels):
        if row:
            panel.sharex(panels[0])
        if row < e.w.size:
            _draw_measure(panel, selection, row, broken)
        else:
            _draw_objective(panel, selection, broken)
        panel.tick_params(labelbottom=row == len(panels) - 1)
    panels[-1].set_xlabel(f"placement {mathtext(e.base_coordinates[0])}, {e.base_units[0]}")
    named: dict[str, Artist] = {}
    for panel in panels:
        named = dict(zip(*reversed(panel.get_legend_handles_labels()), strict=True)) | named
    figure.legend([*named.values()], [*named], loc="outside lower right", ncols=6, frameon=False)


def draw_configurations(axes: Sequence[Axes], selection: Selection) -> None:
    """The chosen and the present configuration with the target, one pair of axes for each view of the machine."""
    best, initial, problem = selection.best.evaluation, selection.initial, selection.problem
    actors = [Actor(shape_of(problem.machine, best), colors().chosen, f"chosen: {_line(best)}")]
    if initial is not None:
        present = Actor(shape_of(problem.machine, initial), colors().present, f"present: {_line(initial)}", ghost=True)
        actors.insert(0, present)
    target = target_point(best.skeleton[:, -1], problem.machine.task_rows, problem.target)
    draw_views(axes, actors, target, problem.asked, name="target")


def _line(evaluation: Evaluation) -> str:
    places = zip(evaluation.base_coordinates, evaluation.base, evaluation.base_units, strict=True)
    placed = ", ".join(f"{mathtext(name)} = {value:z.2f} {unit}" for name, value, unit in places)
    said = placed or "no placement"
    if evaluation.skeleton.shape[0] == 2:
        shown = without_rounding(evaluation.w, evaluation.scale)
        said += ": " + ", ".join(f"$w_{i + 1}$ = {f'{w:.1e}' if w else 0}" for i, w in enumerate(shown))
    elif evaluation.epsilon_max is not None:
        said += f": $\\epsilon_{{max}}$ = {evaluation.epsilon_max:.4f}"
    return said.replace("-", "−")


def _draw_scan(axes: Axes, selection: Selection, values: Points, broken: Mask) -> None:
    """Values (N,) at the points of the scan over their placements: a curve for each branch, else dots."""
    scan, breaks = selection.problem.scan, dict[str, Any]()
    for sign, (number, name) in BRANCHES.items():
        members = np.flatnonzero(scan.elbow == sign)
        if members.size == 0:
            continue
        color, curves = colors().series[number], scan.redundancy.shape[0] == 1 and np.ptp(scan.base[0, members]) > 0
        cuts: list[int] = (np.flatnonzero(np.diff(scan.index[members]) != 1) + 1).tolist() if curves else []
        kind: dict[str, Any] = {} if curves else {"linestyle": "none", "marker": ".", "markersize": 2.5, "alpha": 0.5}
        for k, part in enumerate(np.split(members, cuts)):
            x, y, off = scan.base[0, part], values[part], broken[part]
            axes.plot(x, np.where(off, np.nan, y), color=color, label=name if k == 0 else None, **kind)
            if off.any():
                breaks = BROKEN if curves else BROKEN_POINTS
                # Up to where the curve is whole again.
                near = np.convolve(off, [1, 1, 1], "same") > 0 if curves else off
                axes.plot(x, np.where(near, y, np.nan), color=color, **breaks)
    if breaks:
        axes.plot([], [], color=colors().text, label="breaks a constraint", **breaks)


def _others(selection: Selection) -> list[Candidate]:
    """The candidates but the chosen one, which a verdict may prefer to the first."""
    return [candidate for candidate in selection.candidates if candidate is not selection.best]


def _draw_measure(axes: Axes, selection: Selection, mode: int, broken: Mask) -> None:
    scan, best, initial, inks = selection.problem.scan, selection.best.evaluation, selection.initial, colors()
    _draw_scan(axes, selection, scan.w[mode], broken)
    drawn = [best] if initial is None else [best, initial]
    floor = min(float(np.quantile(scan.w[mode], WORST_SHOWN)), *(e.w[mode] for e in drawn))
    bottom = 1.12 * floor
    others = [(c.evaluation.base[0], c.evaluation.w[mode]) for c in _others(selection)]
    # One that is far worse would leave nothing to be seen of all the others.
    for marker, name, shown in (
        ("o", "other local optima", [at for at in others if at[1] >= bottom]),
        ("v", "further below", [(x, 1.07 * floor) for x, w in others if w < bottom]),
    ):
        axes.plot(
            *np.array(shown).reshape(-1, 2).T, marker, color=inks.page, markeredgecolor=inks.other, markersize=4.5,
            linestyle="none", label=name if shown else "_", zorder=4,
        )  # fmt: skip
    _mark(axes, selection, best.w[mode], None if initial is None else initial.w[mode])
    axes.set_ylim(bottom, -0.1 * floor if floor < 0 else 1.0)
    axes.axhline(0.0, color=inks.muted, linewidth=0.8, zorder=0)
    axes.set_ylabel(measure_label(best, str(mode + 1)))
    axes.locator_params(axis="y", nbins=5)
    axes.set_title(f"mode {mode + 1}, {best.frequencies_hz[mode]:.2f} Hz when chosen; 0 is best", loc="right")


def _mark(axes: Axes, selection: Selection, chosen: float, present: float | None) -> None:
    """The values of the chosen and the present configuration over their placements."""
    best, initial, inks = selection.best.evaluation, selection.initial, colors()
    if initial is not None and present is not None:
        axes.plot(initial.base[0], present, "s", color=inks.present, markersize=7, label="present", zorder=5)
    axes.plot(
        best.base[0], chosen, "*", color=inks.chosen, markersize=14, markeredgecolor=inks.edge, label="chosen", zorder=6
    )


def _draw_objective(axes: Axes, selection: Selection, broken: Mask) -> None:
    """The objective of all candidates, and of the present configuration, over their placements."""
    others = _others(selection)
    present, label = _objective_now(selection)
    at = np.array([(other.evaluation.base[0], other.objective) for other in others]).reshape(-1, 2)
    axes.plot(
        *at.T, "o", color=colors().page, markeredgecolor=colors().other, markersize=4.5, linestyle="none",
        label="other local optima" if others else "_", zorder=4,
    )  # fmt: skip
    _mark(axes, selection, selection.best.objective, present)
    along = selection.along_redundancy() if isinstance(selection, OutcomeSelection) else None
    if along is not None and not np.isnan(along).all():
        low, high = np.nanquantile(along, [WORST_SHOWN, 1.0])
        told = [each.objective for each in selection.candidates] + ([] if present is None else [present])
        low, high = min(low, *told), max(high, *told)
        axes.set_ylim(low - 0.1 * (high - low), high + 0.1 * (high - low))
        _draw_scan(axes, selection, along, broken)
        if low < 0 < high:
            axes.axhline(0.0, color=colors().muted, linewidth=0.8, zorder=0)
    else:
        axes.margins(y=0.2)
    axes.set_ylabel(label)
    axes.locator_params(axis="y", nbins=5)
    over = isinstance(selection, OutcomeSelection) and selection.uncertainty
    axes.set_title("what was sought, the worst found" if over else "what was sought", loc="right")


def draw_candidates(panels: Sequence[Axes], selection: Selection) -> None:
    """Bars of w_i and of w_i/|a_i||b_i|, present and chosen, other candidates as dots; and all objectives."""
    best, initial, inks = selection.best.evaluation, selection.initial, colors()
    modes = np.arange(best.w.size)
    labels = [f"{k + 1}\n{hz:.2f}" for k, hz in enumerate(best.frequencies_hz)]
    others = [candidate.evaluation for candidate in _others(selection)]
    for panel, share in zip(panels[:2], (False, True), strict=True):
        shown = [(0.0 if initial is None else 0.2, best, inks.chosen, "chosen")]
        shown += [] if initial is None else [(-0.2, initial, inks.present, "present")]
        for offset, evaluation, color, name in shown:
            w = without_rounding(evaluation.w, evaluation.scale)
            panel.bar(modes + offset, _shares(evaluation) if share else w, 0.38, color=color, label=name)
        for k, other in enumerate(others):
            values = _shares(other) if share else other.w
            panel.plot(
                modes + shown[0][0], values, "o", color=inks.page, markeredgecolor=inks.other, markersize=3.5,
                linestyle="none", label="other local optima" if k == 0 else "_", zorder=4,
            )  # fmt: skip
        panel.set_xticks(modes, labels if share else [""] * modes.size)
        # A mode without a share has no bar in one of them; the labels are of both.
        panel.set_xlim(-0.6, modes.size - 0.4)
        panel.axhline(0.0, color=inks.muted, linewidth=0.8, zorder=0)
        panel.set_ylabel(labelled("$w_i / |a_i||b_i|$", "") if share else measure_label(best))
    floor = min(float(e.w.min()) for e in (best, *others, *([initial] if initial is not None else [])))
    panels[0].set_ylim(1.12 * floor, -0.05 * floor if floor < 0 else 1.0)
    panels[0].set_title("measures of each mode, 0 is best", loc="right")
    legend_above(panels[1], "right", ncols=3)
    panels[1].set_xlabel("mode, and its frequency when chosen, Hz")
    _draw_ranks(panels[2], selection)


def _shares(evaluation: Evaluation) -> Points:
    """The measures w_i / |a_i||b_i|, from −2 to 0; nothing where the mode is not reached, as in the table."""
    scale, reached = evaluation.scale, ~unreached(evaluation.scale)
    shares: Points = np.divide(evaluation.w, scale, out=np.full_like(scale, np.nan), where=reached)
    return shares


def _draw_ranks(axes: Axes, selection: Selection) -> None:
    ranked, inks = list(enumerate(selection.candidates, start=1)), colors()
    others = [(rank, each.objective) for rank, each in ranked if each is not selection.best]
    chosen = [(rank, each.objective) for rank, each in ranked if each is selection.best]
    for shown, marker, size, color, edge in (
        (others, "o", 4.5, inks.page, inks.other), (chosen, "*", 14.0, inks.chosen, inks.edge),
    ):  # fmt: skip
        at = np.array(shown).reshape(-1, 2).T
        axes.plot(*at, marker, color=color, markeredgecolor=edge, markersize=size, linestyle="none")
    now, label = _objective_now(selection)
    problem, initial = selection.problem, selection.initial
    if problem.travel is not None and not isinstance(selection, OutcomeSelection):
        label = label.replace(",", " less travel,", 1)
        if now is not None and initial is not None:
            now -= float(problem.travel_cost(problem.sought[0], initial.z[None])[0][0])
    if now is not None:
        axes.axhline(now, color=inks.present)
    axes.set_xlabel("candidate, by rank")
    axes.set_ylabel(label)
    # Of one candidate, too, there is no rank between two.
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axes.set_xlim(0.5, max(len(ranked), 1) + 0.5)
    if not isinstance(selection, OutcomeSelection):
        # No finer than what counts as equal, or rounding would look like a difference.
        low, high = axes.get_ylim()
        short = max(0.0, NOTHING * problem.first_scale - (high - low))
        axes.set_ylim(low - short / 2, high + short / 2)


def _objective_now(selection: Selection) -> tuple[float | None, str]:
    """The objective of the present configuration, where there is one, and what an axis of it says."""
    first, initial = selection.problem.sought[0], selection.initial
    if isinstance(selection, OutcomeSelection):
        unit = selection.criterion.unit_of(selection.settings[0])
        return selection.present, labelled(f"objective {mathtext(selection.measure)}", unit)
    now = None if initial is None or first.own is not None else first.value(initial.w, initial.epsilon_max)
    return now, objective_label(first, selection.best.evaluation)
