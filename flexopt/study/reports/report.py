"""Everything about one configuration problem: the machine, the choice, its surroundings, its closed loops.

In: a problem, from a file or from `build_selection`. Out: a `Report`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Any, TypeVar, cast

import numpy as np

from flexopt.errors import Fault, FlexoptError, InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Progress, TableLike
from flexopt.foundation.boundary import TABLE, public, table, whole
from flexopt.foundation.documents import provenance
from flexopt.foundation.plain import shown
from flexopt.foundation.stages import Stages
from flexopt.loop.settings import loop_settings
from flexopt.model import AnyMachine, Problem
from flexopt.model.beyond_limits import holding
from flexopt.model.loop import Loop, LoopLike, under_control
from flexopt.model.problem import judged_by
from flexopt.model.simulation import Experiment, SimulationOptions
from flexopt.model.simulation_faults import brought_twice
from flexopt.model.uncertainty import RangesLike, Uncertainty
from flexopt.robustness import Evaluation
from flexopt.selection import Selection, SelectionProblem, solve_problem, solve_selection
from flexopt.selection.several import BasePlan, Stand
from flexopt.simulation import Trajectory, simulate
from flexopt.simulation.scenario import checked_options
from flexopt.study.asked import any_problem
from flexopt.study.default_gains import default_gains
from flexopt.study.gains import BorderRow, border_row
from flexopt.study.reports.result import Report, ReportLoop
from flexopt.study.reports.surroundings import (
    SLOWEST,
    best_of,
    map_points,
    marks_in,
    problem_of,
    slowest_target,
    spoken_of,
    stands_of,
    surroundings,
)
from flexopt.study.verdicts.confirmation import long_enough
from flexopt.study.verdicts.place_loops import MEMBERS, problems_of
from flexopt.study.verdicts.result import Verdict
from flexopt.study.verdicts.verdict import RUNS, SIZES, verdict

STAGES = 5
POINTS_MAX = 1000  # of the map, along each axis
# Options of `simulate` that say where the machine stands and are the selection's to say.
PLACES = ("posture", "end_point", "elbow", "base", "control", "gravity", "base_path", "target_path")
T = TypeVar("T")


def _together(arguments: Arguments, given: Mapping[str, Any]) -> None:
    machine = arguments.of
    if machine is not None and not arguments.faulty("simulation"):
        arguments.collect("", lambda: _simulation(machine, given["experiment"], given["simulation"]))


def _other_experiment(arguments: Arguments, field: str, value: Any) -> Any:
    """Its machine is not the one of the call."""
    machine = arguments.of
    value, arguments.of = TABLE["experiment"](arguments, field, value), machine
    return value


@public(
    problem=any_problem,
    experiment=_other_experiment,
    simulation=table,
    points=whole(2, POINTS_MAX),
    members=SIZES["members"],
    runs=SIZES["runs"],
    together=_together,
)
def report(
    problem: Problem | SelectionProblem,
    *,
    experiment: Experiment | None = None,
    simulation: TableLike | None = None,
    loop: LoopLike | None = None,
    ranges: RangesLike | None = None,
    points: int | None = None,
    members: int = MEMBERS,
    runs: int = RUNS,
    progress: Progress | None = None,
) -> Report:
    """Solve a configuration problem and show the machine, the choice, a map, the closed loops and the gains.

    What cannot be computed for a machine (a closed loop whose step is too long for RK4, say) is left out and noted. Of
    several targets map, modes and closed loop are those at the worst target.

    Args:
        problem: from `flexopt.load_problem` or `flexopt.build_selection`.
        experiment: from `flexopt.load_experiment`: its controller, gains, start and run are those of the closed loops.
        simulation: arguments of `flexopt.simulate` for these, before those of the experiment; not where the machine
            stands, nor `control` and `gravity`, which are the problem's. Where neither names `kp` or `kv` they are as
            heavy as the machine in the chosen configuration (where it is beyond limits that are left out and no wider
            ones hold it, in the present one): a corner at 0.3 of its lowest mode, damped by 0.7, and halved until the
            linear loop is stable; see `flexopt.study.default_gains`. Runs of slow machines last ten periods of the
            slowest mode, where neither says a `duration`.
        loop, ranges: the real controller and what is uncertain, as of `flexopt.verdict`; by default those of the
            experiment, the problem or the machine. Where a controller is known the report says whether it pays to move,
            and the closed loops are its, with the verdict's numbers, unless `simulation` or the experiment's
            `[simulation]` say another.
        points: of the map, along each axis; 160; 48 in space, and with more than three passive coordinates.
        members, runs: of the verdict, as of `flexopt.verdict`.
        progress: called with the percentage done and 100.

    Raises:
        InputError, UnreachableTarget, NoSolutionFound: as `flexopt.solve_problem`; arguments are not usable.

    Example:
        >>> problem = flexopt.load_problem("article")
        >>> report = flexopt.report(problem, simulation={"duration": 2.0}, points=4)
        >>> sorted(report.loops)
        ['chosen', 'present']
    """
    machine = problem.loaded_machine if isinstance(problem, Problem) else problem.machine
    given = _simulation(machine, experiment, simulation)
    size = map_points(machine) if points is None else points
    stages = Stages(progress, STAGES, 100 // STAGES)
    brought = cast("Loop | None", loop) or (experiment and experiment.loop)
    known = brought or getattr(problem, "loop", None) or machine.loop
    if isinstance(problem, Problem):
        problem = judged_by(problem, brought, cast("tuple[Uncertainty, ...] | None", ranges))
        selection = solve_problem(problem, progress=stages.within)
    else:
        selection = solve_selection(problem, progress=stages.within)
    solved, notes = problem_of(selection), list[str]()
    given |= {"control": solved.control, "gravity": solved.gravity}
    stages.next()
    ground = ranges or getattr(problem, "uncertainty", None) or None
    judged, why_not = _judged(selection, known, ground, members, runs, stages.within)
    stages.next()
    about = selection if judged is None else spoken_of(selection, judged.place)
    drawn = _attempt(notes, "the map", lambda: surroundings(about, size))
    stages.next()
    stands, loops, real = stands_of(about, judged), dict[str, ReportLoop](), None
    # What is said of the controller otherwise goes before a loop that is known, of which the verdict is.
    otherwise = known is None or bool(brought_twice(given))
    slowest = None if otherwise else slowest_target(about, judged)
    if slowest is not None and not isinstance(about, Selection):
        stands[SLOWEST] = about.places[slowest].evaluation
    usual, rate = (SimulationOptions.model_fields[name].default for name in ("duration", "rate"))
    rate = given.get("rate", known.rate if known and known.rate else rate)
    longer = long_enough((float(each.frequencies_hz.min()) for each in stands.values()), rate, least=usual)
    given = ({} if longer == usual else {"duration": longer}) | given
    if otherwise:
        given = _with_gains(machine, [best_of(about), *stands.values()], given)
    else:
        first = next(iter(stands.values()))
        real = _attempt(notes, "the closed loop", lambda: _one_loop(machine, known, first, solved, judged))
    for name, stand in stands.items() if otherwise or real is not None else ():
        run = _attempt(notes, f"the closed loop, {name}", lambda s=stand: _run(machine, s, given, real))
        if run is not None:
            loops[name] = ReportLoop(run)
            notes += _undecided(name, run)
    stages.next()
    borders: list[BorderRow] = []
    for name in loops if otherwise else ():
        rows = _attempt(notes, f"the gains, {name}", lambda n=name: _borders(machine, n, stands[n], given))
        borders += rows or []
    stages.next()
    described = isinstance(problem, Problem)
    return Report(
        name=problem.name if described else f"{machine.name}: {solved.name}",
        description=problem.description if described else "",
        source=problem.source if described else "",
        machine=machine,
        selection=selection,
        map=drawn,
        marks={} if drawn is None else marks_in(about, drawn, judged),
        loops=loops,
        simulation=given,
        borders=tuple(borders),
        verdict=judged,
        no_verdict=why_not,
        notes=tuple(notes),
        provenance=provenance(machine, points=size, simulation=given, selection=selection.provenance["options"]),
    )


def _judged(
    selection: Selection | Stand | BasePlan,
    known: Loop | None,
    ground: Any,
    members: int,
    runs: int,
    progress: Progress,
) -> tuple[Verdict | None, str]:
    """Whether it pays to move, or why that cannot be said and what to give."""
    if problems_of(selection)[0].present_base is None:
        return None, (
            "Whether it pays to move depends on where the machine stands now: give that as base, in the problem's "
            "[selection] or by --base."
        )
    if known is None:
        return None, (
            "Whether it pays to move depends on the controller: give its numbers in a [loop] of the machine or the "
            "problem, or by --loop (kp=1e4, say); --loop default lets all of them follow from the machine."
        )
    try:
        return verdict(selection, loop=known, ranges=ground, members=members, runs=runs, progress=progress), ""
    except FlexoptError as error:
        return None, f"It could not be judged: {error}"


def _one_loop(
    machine: AnyMachine, known: Any, first: Evaluation, solved: SelectionProblem, judged: Verdict | None
) -> Loop:
    """The loop that the verdict judges, the same in every configuration: in each what is left out would be another."""
    if judged is not None:
        return judged.settings.fixed
    own = under_control(cast(Loop, known), machine, solved.control, "report")
    return loop_settings(machine, own, first, gravity=solved.gravity).fixed


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


def _with_gains(machine: AnyMachine, stands: Iterable[Evaluation], given: dict[str, Any]) -> dict[str, Any]:
    """The options with gains that suit the machine in the first of these that limits hold, where nobody named any."""
    if {"kp", "kv"} & given.keys() or given.get("feedback", "pd") not in ("pd", "pid"):
        return given
    rate = given.get("rate", SimulationOptions.model_fields["rate"].default)
    for stand in stands:
        # Where none hold it no loop is run, which is noted.
        with suppress(InputError):
            return default_gains(holding(machine, stand.posture), stand, rate, given) | given
    return given


def _inside(low: float, high: float) -> float:
    return float(np.clip(0.0, low, high))


def _undecided(name: str, run: Trajectory) -> list[str]:
    """A note where run and linear loop together do not say what becomes of the oscillation."""
    said = run.verdict_reason
    return [f"the closed loop, {name}: {said}"] if run.verdict == "undecided" or run.linear is None else []


def _run(machine: AnyMachine, stand: Evaluation, given: Mapping[str, Any], real: Loop | None) -> Trajectory:
    return simulate(holding(machine, stand.posture), stand.posture, base=stand.base, loop=real, **given)


def _borders(machine: AnyMachine, name: str, stand: Evaluation, given: dict[str, Any]) -> list[BorderRow]:
    """Stable Kp with Kv held, and with the ratio held, of a loop with these two gains alone, the same in all rows."""
    machine = holding(machine, stand.posture)
    options = checked_options("report", machine, given | {"posture": stand.posture})
    if options.feedback != "pd" or len(set(options.kp)) > 1 or len(set(options.kv)) > 1:
        return []
    kp, kv = float(options.kp[0]), float(options.kv[0])
    # The loop itself, whatever integrates the runs.
    rest = {n: v for n, v in given.items() if n not in ("kv", "integrator", "substeps")}
    ratios = (None, *([kv / kp] if kp > 0 else []))
    return [border_row(machine, name, stand, rest, ratio, kv) for ratio in ratios]
