"""The article computed again: Table 2, Figs. 5 to 12, mean frequencies, its claims and its contradictions.

In: nothing but the shipped machine. Out: a `Reproduction`, which writes a report (an HTML file) and its numbers (JSON).
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from flexopt.article import findings, loop_findings
from flexopt.article.closed_loops import ClosedLoops, article_stands, close_loops
from flexopt.article.curves import Curve, curve
from flexopt.article.findings import DOUBTED, ArticleFinding
from flexopt.article.gaps import GapSweep, sweep_gaps
from flexopt.article.tables import (
    PRINTED_WORKSPACE,
    TARGET,
    WORKSPACE_B_OF_MEASURES,
    ArticleTable,
    article_machine,
    reproduce_table2,
    workspace_posture,
)
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Document, Progress, Vector
from flexopt.foundation.control import CONTROLS, Control
from flexopt.foundation.documents import provenance
from flexopt.foundation.palette import THEMES, Theme
from flexopt.foundation.pictures import Size, check_size
from flexopt.foundation.results import Result
from flexopt.foundation.stages import Stages
from flexopt.foundation.turns import in_turn
from flexopt.foundation.writing import make_folder
from flexopt.model import AnyMachine
from flexopt.model.choices import ELBOWS
from flexopt.plant import build_plant
from flexopt.selection import Selection, select
from flexopt.study.gains import KV_HELD, RATIOS, GainMap, map_gains
from flexopt.study.maps.points import evaluate_points
from flexopt.study.maps.workspace import map_workspace
from flexopt.study.maps.workspace_map import WorkspaceMap

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FigureForm = Literal["pdf", "svg", "png"]
FORMS = get_args(FigureForm)
PRINTED_FREQUENCIES = (3.0872, 13.1392, 22.4394)
RANDOM_POSTURES = 20_000
GRID_STEP = 0.05
STAGES = 9


@dataclass(frozen=True)
class MeanFrequencies:
    """Mean frequencies over the workspace, Hz.

    Attributes:
        printed: caption of Fig. 7.
        means: way of averaging -> (m,).
    """

    printed: tuple[float, ...]
    means: dict[str, Vector]

    @property
    def deviation(self) -> dict[str, Vector]:
        """(computed − printed) / printed."""
        printed = np.array(self.printed)
        return {name: (values - printed) / printed for name, values in self.means.items()}


@dataclass(frozen=True)
class Reproduction(Result):
    """Everything that `flexopt reproduce` shows.

    Attributes:
        table: Table 2, with the inferred servo gain.
        frequencies: mean frequencies.
        maps: control -> workspace map, elbow up, with the inferred gain.
        curves: along y_d, by (control, elbow).
        contradictions: printed statements that the numbers contradict, or not.
        claims: claims in words.
        gaps: rigid against full plant.
        selection: local optima of w_1, Jacobian inverse control.
        loops: closed loops, Figs. 9 to 12.
        gains: which gains A, B and the optimised posture allow.
        arms: postures A and B of Table 2 as points in the workspace frame, (2, k), m.
        provenance: machine, versions and options.
    """

    DOCUMENT = """
    table2.rows=table.rows table2.inferred_gain=table.inferred table2.note=table.note
    mean_frequencies_hz.printed=frequencies.printed mean_frequencies_hz.computed=frequencies.means
    mean_frequencies_hz.deviation=frequencies.deviation maps contradictions claims closed_loops=loops gains gaps
    provenance
    """

    table: ArticleTable
    frequencies: MeanFrequencies
    maps: dict[Control, WorkspaceMap] = field(repr=False)
    curves: dict[tuple[str, str], Curve] = field(repr=False)
    contradictions: tuple[ArticleFinding, ...]
    claims: tuple[ArticleFinding, ...]
    gaps: GapSweep
    selection: Selection = field(repr=False)
    loops: ClosedLoops = field(repr=False)
    gains: GainMap = field(repr=False)
    arms: dict[str, Vector] = field(repr=False)
    provenance: Document = field(repr=False)

    def figures(self, *, theme: Theme = "light", size: Size = "screen") -> dict[str, Figure]:
        """The article's figures by name, on light or dark ground, of a size as in `plot` of results."""
        from flexopt.article import loop_pictures as draw_loops  # noqa: PLC0415
        from flexopt.article import pictures as draw  # noqa: PLC0415  (matplotlib is slow to import)
        from flexopt.plotting import plot_trajectories  # noqa: PLC0415

        transpose, inverse = (self.maps[c].dataset for c in ("transpose", "inverse"))
        marks = {"A": PRINTED_WORKSPACE["A"][0], "B, printed point": PRINTED_WORKSPACE["B"][0]}
        marks["B, point of its measures"] = WORKSPACE_B_OF_MEASURES[0]
        curves = self.curves["transpose", "up"], self.curves["inverse", "up"]
        look: dict[str, Any] = {"theme": theme, "size": size}
        runs = {
            "figure9": (self.loops.figure9, "Fig. 9: the closed loop at postures A and B of Table 2"),
            "figures11and12": (self.loops.adjustment, "Figs. 11 and 12: with and without the way of Fig. 10"),
        }
        of_runs = {name: plot_trajectories(each, **look) for name, (each, _) in runs.items()}
        for name, (_, title) in runs.items():
            of_runs[name].legends[0].set_title(title)
        return {
            "figure5": draw.plot_figure5(inverse, self.arms, **look),
            "figure6": draw.plot_figure6(transpose, inverse, self.arms, **look),
            "figure7": draw.plot_figure7(transpose, inverse, **look),
            "figure8": draw.plot_figure8(*curves, marks, **look),
            "figure9": of_runs["figure9"],
            "figure10": draw_loops.plot_figure10(self.loops.stopped, self.loops.climb, **look),
            "figures11and12": of_runs["figures11and12"],
            "gains": draw_loops.plot_gains(self.gains, self.loops.pairs, kv=KV_HELD, ratios=RATIOS, **look),
            "gaps": draw.plot_gaps(self.gaps, **look),
        }

    def write(self, folder: str | os.PathLike[str]) -> tuple[Path, Path]:
        """Write `report.html` and `report.json` into a folder, made if missing; nothing else in it is touched.

        Raises:
            WriteError: a file cannot be written.
        """
        from flexopt.article.page import report_html  # noqa: PLC0415  (imports what only reports need)
        from flexopt.study.page import write_files  # noqa: PLC0415

        return write_files(Path(folder), report_html(self), self.to_dict())

    def write_figures(
        self,
        folder: str | os.PathLike[str],
        *,
        form: FigureForm = "pdf",
        theme: Theme = "light",
        size: Size = "screen",
    ) -> tuple[Path, ...]:
        """Write every figure as a file of its own, `figure5.pdf` and so on, into a folder, made if missing.

        Raises:
            InputError: form, theme or size is none of these.
            WriteError: a file cannot be written.
        """
        from flexopt.plotting.sheet import DOTS, write  # noqa: PLC0415

        arguments = Arguments("write_figures")
        arguments.choice("form", form, FORMS)
        arguments.choice("theme", theme, THEMES)
        size = arguments.checked("size", size, check_size, size)
        arguments.done()
        drawn = self.figures(theme=theme, size=size)
        make_folder(folder)
        figures = {Path(folder) / f"{name}.{form}": figure for name, figure in drawn.items()}
        for file, figure in figures.items():
            write(figure, file, dpi=DOTS.get(size, DOTS["paper"]))
        return tuple(figures)

    def __repr__(self) -> str:
        lines = [repr(self.table), "", f"Mean frequencies, Hz: printed {_row(self.frequencies.printed)}"]
        for name, values in self.frequencies.means.items():
            off = ", ".join(f"{100 * d:+.2f} %" for d in self.frequencies.deviation[name])
            lines.append(f"  {name}: {_row(values)}  ({off})")
        for title, group in ((DOUBTED, self.contradictions), ("Other claims in words", self.claims)):
            lines += ["", title]
            lines += [f"  {'holds' if f.holds else 'fails'}: “{f.quote}” ({f.where}). {f.sentence}" for f in group]
        lines += ["", "Closed loops", f"  {self.loops.sentence}", f"  {self.gains.sentence}"]
        lines += ["  Kp, N m, for which the sampled linear loop is stable, by what integrates it (Kv in N m s):"]
        lines += [f"  {row.stand}, {row.held}, {row.integrator}: {row.text}" for row in self.gains.borders]
        return "\n".join([*lines, "", "The gap metric", f"  {self.gaps.sentence}"])


def _row(values: Any) -> str:
    return ", ".join(f"{value:.4f}" for value in values)


@in_turn
def reproduce(*, points: tuple[int, int] = (400, 400), progress: Progress | None = None) -> Reproduction:
    """Compute everything.

    Args:
        points: of the workspace maps, along x and y.
        progress: called with the number of stages done and of all.
    """
    stages = Stages(progress, STAGES)
    machine = article_machine()
    table = reproduce_table2()
    gain = table.inferred.kr
    stages.next()
    maps: dict[Control, WorkspaceMap] = {}
    for control in CONTROLS:
        maps[control] = map_workspace(machine, control=control, gain=gain, points=points)
        stages.next()
    frequencies = mean_frequencies(machine, maps["inverse"])
    height = PRINTED_WORKSPACE["A"][1]
    curves = {
        (control, elbow): curve(machine, height, control=control, elbow=elbow, gain=gain)
        for control in CONTROLS
        for elbow in ELBOWS
    }
    stages.next()
    selection = select(machine, TARGET, base=0.0)
    random = _random_postures(machine)
    rigid = {
        control: evaluate_points(machine, random, control=control, epsilon_max=False).rigid for control in CONTROLS
    }
    stages.next()
    named = _named_postures(machine)
    optima = {f"optimum {k + 1}": c.evaluation.posture for k, c in enumerate(selection.candidates)}
    gaps = sweep_gaps(machine, named | optima, gain=gain)
    stages.next()
    stands = article_stands(machine, selection, gain)
    loops = close_loops(machine, stands)
    stages.next()
    gain_map = map_gains(machine, stands, loops.stated)
    stages.next()
    lines = tuple(curves.values())
    at_b = {name: q for name, q in named.items() if name.startswith("B")}
    contradictions = (
        findings.posture_b(table),
        findings.below_maximum(lines, maps["inverse"]),
        findings.union(maps["inverse"]),
        findings.semidefinite(table, maps["inverse"], maps["transpose"]),
        findings.gain_independent(machine, named, gain),
        findings.concave(lines),
        findings.b_is_optimal(machine, at_b, curves["inverse", "up"]),
        loop_findings.stable_at_high_margin(gain_map),
        loop_findings.integration_step(loops, gain_map),
    )
    claims = (
        findings.same_shape(tuple(curves[control, "up"] for control in CONTROLS)),
        findings.many_in_phase(maps["inverse"]),
        findings.passive(selection, rigid),
        findings.features((maps["transpose"], maps["inverse"])),
        loop_findings.better_convergence(loops),
        loop_findings.stability_by_moving(loops),
        loop_findings.motion_excites(loops),
        loop_findings.higher_gain(loops, gain_map),
        loop_findings.robust_controller(loops, gain_map),
    )
    stages.next()
    arms = {name: _arm(machine, workspace_posture(machine, PRINTED_WORKSPACE[name])) for name in ("A", "B")}
    where = provenance(machine, points=points, gain=gain, random_postures=RANDOM_POSTURES, seed=0)
    return Reproduction(
        table, frequencies, maps, curves, contradictions, claims, gaps, selection, loops, gain_map, arms, where
    )


def mean_frequencies(machine: AnyMachine, inverse: WorkspaceMap) -> MeanFrequencies:
    """Averages over the area and over the joint angles: the article does not say which it takes."""
    steps = round(3.0 / GRID_STEP)
    edge = (-steps * GRID_STEP, steps * GRID_STEP)
    count = (2 * steps + 1, 2 * steps + 1)
    coarse = map_workspace(machine, points=count, x_range=edge, y_range=edge, epsilon_max=False)
    angles = map_workspace(machine, over="posture", points=(181, 180), epsilon_max=False)

    def mean(values: Vector) -> Vector:
        return np.nanmean(values.reshape(values.shape[0], -1), axis=1)

    size = inverse.array("condition").shape
    return MeanFrequencies(
        PRINTED_FREQUENCIES,
        {
            f"over the area, {GRID_STEP * 100:g} cm grid": mean(coarse.array("frequency_hz")),
            f"over the area, {size[1]} × {size[0]} points": mean(inverse.array("frequency_hz")),
            "over the joint angles": mean(angles.array("frequency_hz")),
        },
    )


def _named_postures(machine: AnyMachine) -> dict[str, Vector]:
    return {
        "A": workspace_posture(machine, PRINTED_WORKSPACE["A"]),
        "B, printed point": workspace_posture(machine, PRINTED_WORKSPACE["B"]),
        "B, point of its measures": workspace_posture(machine, WORKSPACE_B_OF_MEASURES),
    }


def _random_postures(machine: AnyMachine) -> Vector:
    """Even over the joint angles, (n, RANDOM_POSTURES), rad."""
    return np.random.default_rng(0).uniform(-np.pi, np.pi, (len(machine.joints), RANDOM_POSTURES))


def _arm(machine: AnyMachine, posture: Vector) -> Vector:
    """Joints and end-point in the workspace frame, (2, n + 1), m."""
    plant = build_plant(machine)
    p, base = plant.parameter_values, np.zeros(plant.n_base)
    points = plant.skeleton(q=plant.rest(base, posture, p), base=base, p=p)["points"].full()
    arm = points[:, -(len(machine.joints) + 1) :]
    return arm - arm[:, :1]
