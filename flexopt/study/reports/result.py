"""The result of `report`: everything about one configuration problem, as numbers, pictures and a page.

In: the parts, computed. Out: a `Report`, which writes an HTML file and its numbers, and a PDF.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexopt.foundation.arrays import Document, Vector
from flexopt.foundation.boundary import instance, public
from flexopt.foundation.control import gain_units
from flexopt.foundation.palette import Theme
from flexopt.foundation.printing import Printed
from flexopt.foundation.results import Result, Tabled
from flexopt.model import AnyMachine
from flexopt.plant import build_plant
from flexopt.robustness import Evaluation, build_measures
from flexopt.selection import Selection, SelectionProblem
from flexopt.selection.several import BasePlan, Stand
from flexopt.simulation import SampledLoop, Trajectory
from flexopt.study.gains import BorderRow
from flexopt.study.maps.workspace_map import WorkspaceMap
from flexopt.study.reports.surroundings import problem_of, spoken_of, stands_of
from flexopt.study.verdicts.result import Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class ReportLoop(Tabled):
    """The closed loop in one configuration: the nonlinear run, and the poles of the sampled linear loop."""

    run: Trajectory

    @property
    def linear(self) -> SampledLoop | None:
        """The linear loop, exact between the samples; None where there is none."""
        return self.run.linear

    def to_dict(self) -> Document:
        """Numbers: growth rates in 1/s, frequency in Hz."""
        linear = self.linear and {"growth_rate": self.linear.growth_rate, "frequency_hz": self.linear.frequency_hz}
        return {"run": self.run.to_dict(), "linear": linear}


@dataclass(frozen=True)
class Report(Printed, Result):
    """Everything that `flexopt report` shows.

    Attributes:
        name, description, source: of the problem.
        machine: the machine.
        selection: the chosen configuration, further candidates, the present one, and the problem; of several targets
            a `Stand` or a `BasePlan`, and maps, loops and modes are those at the worst target.
        map: around the chosen configuration: over the placement where that has two coordinates, else over end-points
            (or over two joints, where the task has one row); where its postures are followed blank where they break a
            constraint; None where there is none.
        marks: present and chosen configuration in the map's coordinates, name -> (x, y).
        loops: name of a configuration (`"present"`, `"chosen"`, of several targets `"worst target"` by the objective
            and, where that is another, `"slowest target"` by the verdict, unless options say of another controller
            than its) -> closed loop; the same gains in each. Present is as staying is judged. Chosen, here and around
            the map, is the candidate that the verdict speaks of, else the selection's best.
        simulation: options of these.
        borders: gains Kp that each configuration allows.
        verdict: whether it pays to move, where a real controller is known and a present placement; else None.
        no_verdict: why there is none, and what to give; empty where there is one.
        notes: what could not be computed, sentences.
        provenance: machine, versions and options.

    The keys of its document are those names, but `machine` (its `parameters` with units among the rest), `selection`
    (as of `flexopt.select`: `best`, `candidates`, `initial`, `problem`; or of `flexopt.select_stand`,
    `flexopt.plan_base`), `constraints` (as given), `mode_shares` (configuration -> coordinates × modes), `map` (as of
    `flexopt.map_workspace`), `loops` (configuration -> `run`, `linear`), `gains` (as of `flexopt reproduce`) and
    `verdict` (as of `flexopt.verdict`).

    Example:
        >>> report.selection.status
        '8 distinct local optima verified from 8 starts'
    """

    DOCUMENT = (
        "name description source machine=_machine selection constraints=_constraints mode_shares=_shares map=_map "
        "loops simulation gains=borders verdict no_verdict notes provenance"
    )

    name: str
    description: str
    source: str
    machine: AnyMachine
    selection: Selection | Stand | BasePlan = field(repr=False)
    map: WorkspaceMap | None = field(repr=False)
    marks: dict[str, tuple[float, float]]
    loops: dict[str, ReportLoop] = field(repr=False)
    simulation: Document
    borders: tuple[BorderRow, ...]
    verdict: Verdict | None
    no_verdict: str
    notes: tuple[str, ...]
    provenance: Document = field(repr=False)

    @property
    def problem(self) -> SelectionProblem:
        """The configuration problem; of several targets that of the worst."""
        return problem_of(self.about)

    @property
    def stands(self) -> dict[str, Evaluation]:
        """Configurations by name, the present one first where it is known."""
        return stands_of(self.about, self.verdict)

    @cached_property
    def about(self) -> Selection | Stand | BasePlan:
        """The selection, its best the candidate that the verdict speaks of, where it speaks of one."""
        return self.selection if self.verdict is None else spoken_of(self.selection, self.verdict.place)

    @public(stand=instance(Evaluation, "an Evaluation, such as those of `stands`"))
    def mode_shares(self, stand: Evaluation) -> Vector:
        """Share of each passive coordinate in the strain energy of each mode, (n_passive, modes): columns add to 1.

        φ_k (K φ)_k / φᵀ K φ; where springs are coupled a share may be negative.

        Example:
            >>> report.mode_shares(report.stands["chosen"]).sum(axis=0).round(6)
            array([1., 1., 1.])
        """
        measures = build_measures(self.machine, stand.control, self.problem.gravity)
        plant = measures.plant
        m, p = plant.n_passive, plant.parameter_values
        modes = measures.values(base=stand.base, posture=stand.posture, p=p)["modes"].full()[:m]
        energy = modes * (plant.stiffness(p).full()[:m, :m] @ modes)
        shares: Vector = energy / energy.sum(axis=0)
        return shares

    @public()
    def figures(self, *, theme: Theme = "light") -> dict[str, Figure]:
        """Pictures by name: `selection`, `map`, `loops` (several runs side by side), and each run as `run …`.

        Args:
            theme: `"light"` or `"dark"` ground.

        Example:
            >>> sorted(report.figures())[:3]
            ['loops', 'map', 'run chosen']
        """
        from flexopt.study.page import run_figures  # noqa: PLC0415

        found = {"selection": self.about.plot(theme=theme)}
        if self.map is not None:
            found["map"] = self.map.plot(marks=self.marks, theme=theme)
        return found | run_figures({name: loop.run for name, loop in self.loops.items()}, theme=theme)

    @property
    def _machine(self) -> Document:
        return machine_document(self.machine)

    @property
    def _constraints(self) -> Document:
        return self.problem.asked.model_dump(exclude_none=True)

    @property
    def _shares(self) -> dict[str, Vector]:
        return {name: self.mode_shares(stand) for name, stand in self.stands.items()}

    @property
    def _map(self) -> Document | None:
        return self.map and self.map.to_dict() | {"marks": self.marks}

    @public()
    def write(self, folder: str | os.PathLike[str]) -> tuple[Path, Path]:
        """Write `report.html` and `report.json` into a folder, made if missing; nothing else in it is touched.

        Raises:
            WriteError: a file cannot be written.

        Example:
            >>> [path.name for path in report.write("report")]
            ['report.html', 'report.json']
        """
        from flexopt.study.page import write_files  # noqa: PLC0415  (imports what only reports need)

        return write_files(Path(folder), self._html(), self.to_dict())

    def _html(self) -> str:
        from flexopt.study.reports.page import report_html  # noqa: PLC0415  (imports what only reports need)

        return report_html(self)

    @property
    def gain_unit(self) -> str:
        """Of the gains Kp in `borders`."""
        return gain_units(self.problem.control, self.machine.joint_units)[0]

    def __repr__(self) -> str:
        lines = [f"Report on {self.name!r}", repr(self.selection)]
        for name, loop in self.loops.items():
            lines += [f"{name}: {loop.run!r}"]
        kp = f"Kp, {self.gain_unit}"
        lines += [f"  {row.stand}, {row.held}, {row.integrator}: {kp}, {row.text}" for row in self.borders]
        lines += [] if self.verdict is None else repr(self.verdict).splitlines()
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])


def machine_document(machine: AnyMachine) -> dict[str, Any]:
    """What there is to say about a machine."""
    plant = build_plant(machine)
    return {
        "name": machine.name,
        "description": machine.description,
        "source": machine.source,
        "sha256": machine.content_hash,
        "coordinates": plant.coordinates,
        "coordinate_units": plant.graph.coordinate_units,
        "n_passive": plant.n_passive,
        "joints": machine.joints,
        "limits": machine.limits,
        "efforts": machine.efforts,
        "speeds": machine.speeds,
        "base_coordinates": machine.base_coordinates,
        "task_rows": machine.task_rows,
        "support": machine.support_points,
        "capsules": [capsule.model_dump(exclude_defaults=True) for capsule in machine.capsules],
        "parameters": [parameter._asdict() for parameter in machine.parameters],
    }
