"""Everything about one configuration problem: the machine, the choice, its surroundings, its closed loops.

In: a problem, from a file or from `build_selection`. Out: a `Report`, which writes an HTML file and its numbers.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from flexopt.errors import Fault, FlexoptError, InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Vector
from flexopt.foundation.boundary import instance, public, table, whole
from flexopt.foundation.documents import json_ready, provenance
from flexopt.foundation.plain import shown
from flexopt.foundation.results import Tabled
from flexopt.model import AnyMachine, Problem
from flexopt.model.loop import Loop
from flexopt.model.simulation import Experiment, SimulationOptions
from flexopt.model.simulation_faults import brought_twice
from flexopt.model.uncertainty import Uncertainty
from flexopt.plant import build_plant
from flexopt.robustness import Evaluation, build_measures
from flexopt.selection import Selection, SelectionProblem, select, solve_selection
from flexopt.simulation import SampledLoop, Trajectory, simulate
from flexopt.simulation.experiment import HELD
from flexopt.simulation.scenario import checked_options
from flexopt.study.asked import reported
from flexopt.study.default_gains import default_gains
from flexopt.study.gains import BorderRow, border_row
from flexopt.study.move_verdict import verdict
from flexopt.study.points import Progress
from flexopt.study.surroundings import map_points, marks_in, stands_of, surroundings
from flexopt.study.verdict_result import Verdict
from flexopt.study.workspace_map import WorkspaceMap

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STAGES = 5
POINTS_MAX = 1000  # of the map, along each axis
# Options of `simulate` that say where the machine stands and are the selection's to say.
PLACES = ("posture", "end_point", "elbow", "base", "control", "gravity", "base_path", "target_path")
T = TypeVar("T")


@dataclass(frozen=True)
class ReportLoop(Tabled):
    """The closed loop in one configuration: the nonlinear run, and the poles of the sampled linear loop."""

    run: Trajectory

    @property
    def linear(self) -> SampledLoop | None:
        """The linear loop, exact between the samples; None where there is none."""
        return self.run.linear

    def to_dict(self) -> dict[str, Any]:
        """Numbers: growth rates in 1/s, frequency in Hz."""
        linear = self.linear and {"growth_rate": self.linear.growth_rate, "frequency_hz": self.linear.frequency_hz}
        return {"run": self.run.to_dict(), "linear": linear}


@dataclass(frozen=True)
class Report(Tabled):
    """Everything that `flexopt report` shows.

    Attributes:
        name, description, source: of the problem.
        machine: the machine.
        selection: the chosen configuration, further candidates, the present one, and the problem.
        map: around the chosen configuration: over the placement where that has two coordinates, else over end-points
            (or over two joints, where the task has one row); None where there is none.
        marks: present and chosen configuration as points of the map, name -> (x, y).
        loops: name of a configuration (`"present"`, `"chosen"`) -> closed loop; the same gains in each.
        simulation: options of these.
        borders: gains Kp that each configuration allows.
        verdict: whether it pays to move, where a real controller is known and a present placement; else None.
        notes: what could not be computed, sentences.
        provenance: machine, versions and options.

    Example:
        >>> report.selection.status
        '8 distinct local optima verified from 8 starts'
    """

    name: str
    description: str
    source: str
    machine: AnyMachine
    selection: Selection = field(repr=False)
    map: WorkspaceMap | None = field(repr=False)
    marks: dict[str, tuple[float, float]]
    loops: dict[str, ReportLoop] = field(repr=False)
    simulation: dict[str, Any]
    borders: tuple[BorderRow, ...]
    verdict: Verdict | None
    notes: tuple[str, ...]
    provenance: dict[str, Any] = field(repr=False)

    @property
    def stands(self) -> dict[str, Evaluation]:
        """Configurations by name, the present one first where it is known."""
        return stands_of(self.selection)

    @public(stand=instance(Evaluation, "an Evaluation, such as those of `stands`"))
    def mode_shares(self, stand: Evaluation) -> Vector:
        """Share of each passive coordinate in the strain energy of each mode, (n_passive, modes): columns add to 1.

        φ_k (K φ)_k / φᵀ K φ; where springs are coupled a share may be negative.

        Example:
            >>> report.mode_shares(report.stands["chosen"]).sum(axis=0).round(6)
            array([1., 1., 1.])
        """
        measures = build_measures(self.machine, stand.control, self.selection.problem.gravity)
        plant = measures.plant
        m, p = plant.n_passive, plant.parameter_values
        modes = measures.values(base=stand.base, posture=stand.posture, p=p)["modes"].full()[:m]
        energy = modes * (plant.stiffness(p).full()[:m, :m] @ modes)
        shares: Vector = energy / energy.sum(axis=0)
        return shares

    def figures(self) -> dict[str, Figure]:
        """Pictures by name: `selection`, `map`, `loops` (several runs side by side), and each run as `run …`.

        Example:
            >>> sorted(report.figures())[:3]
            ['loops', 'map', 'run chosen']
        """
        from flexopt.plotting import plot_trajectories  # noqa: PLC0415  (matplotlib is slow to import)

        found = {"selection": self.selection.plot()}
        if self.map is not None:
            found["map"] = self.map.plot(marks=self.marks)
        runs = {name: loop.run for name, loop in self.loops.items()}
        if len(runs) > 1:
            found["loops"] = plot_trajectories(runs)
        return found | {f"run {name}": run.plot() for name, run in runs.items()}

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready dictionary.

        Keys: `name`, `description`, `source`, `machine` (its `parameters` with units among the rest), `selection` (as
        of `flexopt.select`: `best`, `candidates`, `initial`, `problem`), `constraints` (as given), `mode_shares`
        (configuration -> coordinates × modes), `map` (as of `flexopt.map_workspace`), `loops` (configuration -> `run`,
        `linear`), `simulation`, `gains` (as of `flexopt reproduce`), `verdict` (as of `flexopt.verdict`), `notes`,
        `provenance`.

        Example:
            >>> report.to_dict()["name"]
            'article'
        """
        return cast(
            dict[str, Any],
            json_ready(
                {
                    "name": self.name,
                    "description": self.description,
                    "source": self.source,
                    "machine": machine_document(self.machine),
                    "selection": self.selection.to_dict(),
                    "constraints": self.selection.problem.asked.model_dump(exclude_none=True),
                    "mode_shares": {name: self.mode_shares(stand) for name, stand in self.stands.items()},
                    "map": self.map and self.map.to_dict() | {"marks": self.marks},
                    "loops": {name: loop.to_dict() for name, loop in self.loops.items()},
                    "simulation": self.simulation,
                    "gains": [row.to_dict() for row in self.borders],
                    "verdict": self.verdict and self.verdict.to_dict(),
                    "notes": self.notes,
                    "provenance": self.provenance,
                }
            ),
        )

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
        from flexopt.study.problem_page import report_html  # noqa: PLC0415

        return write_files(Path(folder), report_html(self), self.to_dict())

    def __repr__(self) -> str:
        lines = [f"Report on {self.name!r}", repr(self.selection)]
        for name, loop in self.loops.items():
            lines += [f"{name}: {loop.run!r}"]
        lines += [f"  {row.stand}, {row.held}, {row.integrator}: Kp {row.text}" for row in self.borders]
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
        "capsules": [capsule.model_dump() for capsule in machine.capsules],
        "parameters": [parameter._asdict() for parameter in machine.parameters],
    }


def _together(arguments: Arguments, given: Mapping[str, Any]) -> None:
    machine = arguments.of
    if machine is not None and not arguments.faulty("simulation"):
        arguments.collect("", lambda: _simulation(machine, given["experiment"], given["simulation"]))


def _other_experiment(arguments: Arguments, field: str, value: Any) -> Any:
    """Its machine is not the one of the call."""
    machine = arguments.of
    value, arguments.of = HELD(arguments, field, value), machine
    return value


@public(
    problem=reported,
    experiment=_other_experiment,
    simulation=table,
    points=whole(2, POINTS_MAX),
    together=_together,
)
def report(
    problem: Problem | SelectionProblem,
    *,
    experiment: Experiment | None = None,
    simulation: Mapping[str, Any] | None = None,
    loop: Loop | Mapping[str, Any] | str | None = None,
    ranges: Mapping[str, Any] | Sequence[Uncertainty | Mapping[str, Any]] | None = None,
    points: int | None = None,
    progress: Progress | None = None,
) -> Report:
    """Solve a configuration problem and show the machine, the choice, a map, the closed loops and the gains.

    What cannot be computed for a machine (a closed loop whose step is too long for RK4, say) is left out and noted.

    Args:
        problem: from `flexopt.load_problem` or `flexopt.build_selection`.
        experiment: from `flexopt.load_experiment`: its controller, gains, start and run are those of the closed loops.
        simulation: arguments of `flexopt.simulate` for these, before those of the experiment; not where the machine
            stands, nor `control` and `gravity`, which are the problem's. Where neither names `kp` or `kv` they are as
            heavy as the machine in the chosen configuration: a corner at 0.3 of its lowest mode, damped by 0.7, and
            halved until the linear loop is stable; see `flexopt.study.default_gains`.
        loop, ranges: the real controller and what is uncertain, as of `flexopt.verdict`; by default those of the
            experiment, the problem or the machine. Where a controller is known the report says whether it pays to move,
            and the closed loops are its, unless `simulation` or the experiment's `[simulation]` say another.
        points: of the map, along each axis; 160, or with more than three passive coordinates 48.
        progress: called with the number of stages done and of all.

    Raises:
        InputError, UnreachableTarget, NoSolutionFound: as `flexopt.select`; arguments are not usable.

    Example:
        >>> problem = flexopt.load_problem("article")
        >>> report = flexopt.report(problem, simulation={"duration": 2.0}, points=8)
        >>> sorted(report.loops)
        ['chosen', 'present']
    """
    machine = problem.loaded_machine if isinstance(problem, Problem) else problem.machine
    given = _simulation(machine, experiment, simulation)
    size = map_points(machine) if points is None else points
    stages = _Stages(progress)
    selection = select(**problem.select_arguments()) if isinstance(problem, Problem) else solve_selection(problem)
    solved, notes = selection.problem, list[str]()
    given |= {"control": solved.control, "gravity": solved.gravity}
    known = loop or (experiment and experiment.loop) or getattr(problem, "loop", None) or machine.loop
    # What is said of the controller otherwise goes before a loop that is known.
    real = None if brought_twice(given) else cast("Loop | None", known)
    stages.next()
    drawn = _attempt(notes, "the map", lambda: surroundings(selection, size))
    stages.next()
    if real is None:
        given = _with_gains(machine, selection.best.evaluation, given)
    stands, loops = stands_of(selection), dict[str, ReportLoop]()
    for name, stand in stands.items():
        run = _attempt(notes, f"the closed loop, {name}", lambda s=stand: _run(machine, s, given, real))
        if run is not None:
            loops[name] = ReportLoop(run)
            notes += _undecided(name, run)
    stages.next()
    borders: list[BorderRow] = []
    for name in loops if real is None else ():
        rows = _attempt(notes, f"the gains, {name}", lambda n=name: _borders(machine, n, stands[n], given))
        borders += rows or []
    stages.next()
    judged = None
    if known is not None and solved.present_base is not None:
        ground = ranges or getattr(problem, "uncertainty", None) or None
        judged = _attempt(notes, "the verdict", lambda: verdict(selection, loop=known, ranges=ground))
    stages.next()
    described = isinstance(problem, Problem)
    return Report(
        name=problem.name if described else f"{machine.name}: {selection.objective}",
        description=problem.description if described else "",
        source=problem.source if described else "",
        machine=machine,
        selection=selection,
        map=drawn,
        marks={} if drawn is None else marks_in(selection, drawn),
        loops=loops,
        simulation=given,
        borders=tuple(borders),
        verdict=judged,
        notes=tuple(notes),
        provenance=provenance(machine, points=size, simulation=given),
    )


class _Stages:
    """Tells how many stages are done."""

    def __init__(self, progress: Progress | None) -> None:
        self.progress, self.done = progress, 0

    def next(self) -> None:
        self.done += 1
        if self.progress is not None:
            self.progress(self.done, STAGES)


def _attempt(notes: list[str], what: str, compute: Callable[[], T]) -> T | None:
    """The result, or None and a note that says why there is none."""
    try:
        return compute()
    except FlexoptError as error:
        notes.append(f"{what}: {error}")
        return None


def _simulation(
    machine: AnyMachine, experiment: Experiment | None, simulation: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Options of the closed loops, checked."""
    given: dict[str, Any] = {}
    if experiment is not None:
        options = experiment.simulation
        given = {name: getattr(options, name) for name in options.model_fields_set if name not in PLACES}
        if len(experiment.loaded_machine.joints) != len(machine.joints):
            given.pop("offset", None)
    own = dict(simulation or {})
    faults = [
        Fault(f"simulation.{name}", "is the problem's to say", shown(own[name])) for name in PLACES if name in own
    ]
    raise_if_any(InputError, "report", faults)
    given |= {name: value for name, value in own.items() if value is not None}
    # Faults come before the work; the posture is not known yet.
    checked_options("report", machine, given | {"posture": [_inside(*limits) for limits in machine.limits]})
    return given


def _with_gains(machine: AnyMachine, stand: Evaluation, given: dict[str, Any]) -> dict[str, Any]:
    """The options with gains that suit the machine, where nobody named any."""
    if {"kp", "kv"} & given.keys() or given.get("feedback", "pd") not in ("pd", "pid"):
        return given
    rate = given.get("rate", SimulationOptions.model_fields["rate"].default)
    return default_gains(machine, stand, rate, given) | given


def _inside(low: float, high: float) -> float:
    return float(np.clip(0.0, low, high))


def _undecided(name: str, run: Trajectory) -> list[str]:
    """A note where run and linear loop together do not say what becomes of the oscillation."""
    said = run.verdict_reason
    return [f"the closed loop, {name}: {said}"] if run.verdict == "undecided" or run.linear is None else []


def _run(machine: AnyMachine, stand: Evaluation, given: Mapping[str, Any], real: Loop | None) -> Trajectory:
    return simulate(machine, stand.posture, base=stand.base, loop=real, **given)


def _borders(machine: AnyMachine, name: str, stand: Evaluation, given: dict[str, Any]) -> list[BorderRow]:
    """Stable Kp with Kv held, and with the ratio held, of a loop with these two gains alone."""
    options = checked_options("report", machine, given | {"posture": stand.posture})
    if options.feedback != "pd":
        return []
    kp, kv = float(options.kp[0]), float(options.kv[0])
    # The loop itself, whatever integrates the runs.
    rest = {n: v for n, v in given.items() if n not in ("kp", "kv", "integrator", "substeps")}
    ratios = (None, *([kv / kp] if kp > 0 else []))
    return [border_row(machine, name, stand, rest, ratio, kv) for ratio in ratios]
