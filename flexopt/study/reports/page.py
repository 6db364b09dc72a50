"""The page of a `Report`: one HTML file that needs no other.

In: a report. Out: HTML.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from flexopt.foundation.arrays import Vector
from flexopt.foundation.doubt import with_doubt
from flexopt.foundation.plain import counted, listed
from flexopt.foundation.rendering import OfNumbers, render
from flexopt.foundation.rounding import without_rounding
from flexopt.robustness import Evaluation
from flexopt.selection import Selection
from flexopt.selection.columns import shown_measures
from flexopt.selection.problem import elsewhere
from flexopt.selection.several import BasePlan, Stand
from flexopt.study.page import (
    PageTable,
    Picture,
    begun,
    coordinate,
    number,
    picture,
    pictures,
    run_figures,
    sentence,
    with_minus,
)
from flexopt.study.reports.surroundings import (
    CHOSEN,
    NONE_REACHED,
    PRESENT,
    SLOWEST,
    held_ways,
    mapped,
    problem_of,
    slowest_target,
)
from flexopt.study.reports.tables import (
    SHOWN,
    chosen_number,
    constraints,
    coordinates,
    modes,
    parameters,
    some,
    written_residue,
)
from flexopt.study.verdicts.page import judged, target_of

if TYPE_CHECKING:
    from flexopt.study.reports.result import Report

CAPTIONS = {
    "selection": "The machine in the chosen configuration{present}, and its measures; of w_i 0 is best.",
    "several": "The machine at its targets, and its measures; of w_i 0 is best.",
    "loops": "Nonlinear closed loops with the same gains and the joints displaced alike at the start.",
}
MAP_CAPTION = (
    "Frequencies, w_i, in-phase regions (yellow: trace R_i > 0), the robust stability margin and the rigid part."
)
MARKS = {
    CHOSEN: "star: the chosen configuration",
    PRESENT: "ring: the present one",
    "end-point": "cross: the end-point",
}
FOLLOWED = (
    " From the chosen configuration on each posture is the one nearest to its neighbour's. Where none is drawn it does "
    "not reach, or breaks a limit, a range or a constraint of the problem; another posture may still do."
)
OTHER_POSTURES = " Another posture at such a point may still do."
NOWHERE = "No map is drawn: none of its {points} points is {why}."


def report_html(report: Report) -> str:
    """The page."""
    placed, note = _placed(report)
    several = not isinstance(report.selection, Selection)
    return render(
        "study/templates/report.html",
        title=f"Report: {report.name}",
        provenance=report.provenance,
        report=report,
        judged=report.verdict and judged(report.verdict),
        pictures={
            "selection": picture(
                lambda theme: report.about.plot(theme=theme),
                f"{_caption(report)} {_shown(report)}",
            )
        },
        notes=[with_minus(note) for note in report.notes],
        missing=with_minus(report.no_verdict),
        sentence=_sentence(report),
        placed=placed,
        placed_note=note,
        measured=_measured(report),
        said=" ".join(sentence(str(each)) for each in (*_remarks(report), *report.problem.assumed)),
        constraints=constraints(report),
        panels=_panels(report),
        frame="" if report.map is None else sentence(str(report.map.dataset.attrs["frame"])),
        map_caption=_map_caption(report),
        around="at the worst target" if several else "of the chosen configuration",
        loops=_loops(report),
        loops_note=" ".join([_shown(report), *_stay(report), *_slowest(report), *_warned(report)]),
        runs=_runs(report),
        options=_options(report),
        borders=_borders(report),
        modes_at_rest=[modes(report, name) for name in report.stands],
        coordinates=coordinates(report),
        masses=parameters(report, ("kg",), "mass"),
        springs=parameters(report, ("N/m", "N m/rad", "N"), "spring"),
    )


def _caption(report: Report) -> str:
    """What the picture of the choice shows."""
    about = report.about
    if not isinstance(about, Selection):
        return CAPTIONS["several"]
    now = about.initial
    off = "" if now is None else elsewhere(about.problem, now.z)
    present = "" if now is None else f" and in the present one{f' ({off})' if off else ''}"
    return CAPTIONS["selection"].format(present=present)


def _map_caption(report: Report) -> str:
    """What the panels show, the marks that are in them, and which postures they are of; else why there are none."""
    if report.map is not None and not mapped(report.map):
        attrs, points = report.map.dataset.attrs, report.map.to_dict()["points"]
        other = OTHER_POSTURES if "end_point" in report.map.options else ""
        return with_minus(NOWHERE.format(points=points, why=attrs.get("barred", NONE_REACHED)) + other)
    marks = [words for name, words in MARKS.items() if name in report.marks]
    followed = report.map is not None and "end_point" in report.map.options
    told = MAP_CAPTION + (f" {begun('; '.join(marks))}." if marks else "") + (FOLLOWED if followed else "")
    ways = held_ways(report.map, problem_of(report.selection)) if report.map is not None else []
    told += f" The base is held along {listed(ways)}: there the map shows how it would be." if ways else ""
    return told


def _panels(report: Report) -> dict[str, Picture]:
    """Each quantity of the map; none where it shows nothing."""
    from flexopt.plotting.workspace import plot_quantities  # noqa: PLC0415  (matplotlib is slow to import)

    if report.map is None or not mapped(report.map):
        return {}
    found = pictures(lambda theme: plot_quantities(report.map, marks=report.marks, theme=theme))
    return {name: each._replace(caption=f"{begun(name)}.") for name, each in found.items()}


def _runs(report: Report) -> dict[str, Picture]:
    """The runs beside each other, and each of them."""
    runs = {name: loop.run for name, loop in report.loops.items()}
    return {
        "side by side" if name == "loops" else name.removeprefix("run "): each._replace(
            caption=CAPTIONS.get(name, f"Nonlinear {name}.")
        )
        for name, each in pictures(lambda theme: run_figures(runs, theme=theme)).items()
    }


def _warned(report: Report) -> list[str]:
    """What the runs warn of: each sentence once, of which configurations it is."""
    of = dict[str, list[str]]()
    for name, loop in report.loops.items():
        for warning in loop.run.warnings:
            of.setdefault(warning, []).append(name)
    return [sentence(f"{listed(names)}: {warning}") for warning, names in of.items()]


def _sentence(report: Report) -> str:
    problem = report.problem
    weight = ", under gravity" if problem.gravity else ""
    how = f"Jacobian {problem.control} control{weight}:"
    several = report.selection
    if not isinstance(several, Selection):
        what = f"{len(several.places)} targets of the end-point. Objective {several.objective}"
        return f"{what}, {how} {several.status}. {_gained(several)}"
    return f"Target of the end-point: {target_of(problem)}. Objective {several.objective}, {how} {several.status}."


def _remarks(report: Report) -> tuple[str, ...]:
    """Sentences on the choice; of another stand those on it, after what more starts may find."""
    selection, about = report.selection, report.about
    if isinstance(selection, Stand) and isinstance(about, Stand) and about is not selection:
        return (*filter(None, [selection.left_open]), *about.remarks)
    if isinstance(selection, Selection) and selection.remarks and chosen_number(report) != 1:
        return (f"of candidate 1: {'; '.join(selection.remarks)}",)
    return selection.remarks


def _gained(several: Stand | BasePlan) -> str:
    """What the base's way or its one placement is worth."""
    if isinstance(several, Stand):
        unit = f" {several.unit}" if several.unit else ""
        others = counted(len(several.alternatives), "other local optimum", "other local optima")
        return f"Candidate 1 is worth {number(several.worth)}{unit}; {others}."
    still = "no single placement reaches them all"
    if several.still is not None:
        still = f"{number(several.standing)} where the base stands still"
    return (
        f"The smallest objective is {number(several.worth)} ({still}), and between the targets "
        f"{number(several.between[0])}. The base travels {number(several.travelled[0], 4)} m and turns "
        f"{number(several.travelled[1], 4)} rad."
    )


class _Listed(NamedTuple):
    """A configuration in the tables: its name, its numbers, what is to be said of it."""

    name: str
    evaluation: Evaluation
    remark: str


def _listed(report: Report) -> list[_Listed]:
    """The present configuration and the candidates, or the configuration at each target."""
    selection = report.about
    if not isinstance(selection, Selection):
        name, unit = selection.column, f" {selection.unit or ''}".rstrip()
        return [
            _Listed(
                f"target {k + 1}",
                place.evaluation,
                f"{name} {number(selection.shown_objective[k], 4)}{unit}"
                + (", the worst" * (selection.differs and k == selection.worst)),
            )
            for k, place in some(selection, SHOWN)
        ]
    present = [] if selection.initial is None else [_Listed("present", selection.initial, "")]
    remarks, chosen = {1: " (best by the objective)"}, chosen_number(report)
    if chosen > 1:
        remarks[chosen] = " (drawn as chosen: the verdict's)"
    return present + [
        _Listed(f"candidate {k}{remarks.get(k, '')}", each.evaluation, ", ".join(each.active))
        for k, each in enumerate(selection.candidates, start=1)
        if k <= SHOWN or k == chosen
    ]


def _placed(report: Report) -> tuple[PageTable, str]:
    """Where each configuration stands and how it is held, and a remark."""
    listed, selection = _listed(report), report.about
    first = listed[0].evaluation
    names = [*_with_units(first.base_coordinates, first.base_units), *_with_units(first.joints, first.joint_units)]
    said = any(each.remark for each in listed)
    last = "rests on" if isinstance(selection, Selection) else "objective"
    rows = [
        [each.name, *(coordinate(x) for x in (*each.evaluation.base, *each.evaluation.posture)), *[each.remark] * said]
        for each in listed
    ]
    if not isinstance(selection, Selection):
        more, wide = len(selection.places) - len(listed), list[str]()
    else:
        more = len(selection.candidates) + (selection.initial is not None) - len(listed)
        wide = [f"{k} ({len(c.continuum)} more)" for k, c in enumerate(selection.candidates[:SHOWN], 1) if c.continuum]
    notes = [f"And {more} more."] * (more > 0)
    if not isinstance(selection, Selection):
        told = selection.unused_posture
    else:
        told = selection.present_told and f"present: {selection.present_told}"
    notes += [sentence(told)] * bool(told)
    if wide:
        notes.append(
            f"Placements that change nothing else, as when the machine turns about the target: {', '.join(wide)}."
        )
    return (["", *map(OfNumbers, names), *[last] * said], rows), " ".join(notes)


def _measured(report: Report) -> PageTable:
    """Measures and frequencies of each."""
    listed = _listed(report)
    modes = range(1, listed[0].evaluation.w.size + 1)
    unit, selection = written_residue(listed[0].evaluation), report.selection

    def shown(e: Evaluation) -> Vector:
        return (
            shown_measures(selection.problem, e) if isinstance(selection, Selection) else without_rounding(e.w, e.scale)
        )

    numbers = (*(f"w{i}, {unit}" for i in modes), "ε_max", *(f"f{i}, Hz" for i in modes))
    return ["", *map(OfNumbers, numbers)], [
        [
            name,
            *(number(w, 4) for w in shown(e)),
            number(e.epsilon_max),
            *(number(f, 4) for f in e.frequencies_hz),
        ]
        for name, e, _ in listed
    ]


def _with_units(names: Iterable[str], units: Iterable[str]) -> list[str]:
    return [f"{name}, {unit}" for name, unit in zip(names, units, strict=True)]


def _shown(report: Report) -> str:
    """Which configuration pictures, map and loops show as the chosen one, or of which target they are."""
    chosen, objective, about = chosen_number(report), report.selection.objective, report.about
    at = "" if isinstance(about, Selection) else f"At target {about.worst + 1}, the worst by {objective}, "
    if isinstance(about, BasePlan):
        another = " The verdict is about another, candidate 2: the best placement that stands still."
        return f"{at}along the way of the base.{another * (chosen > 1)}"
    if isinstance(about, Stand) and chosen == 1:
        return f"{at}the base standing where it is best by that."
    if chosen == 1:
        return f"Chosen: candidate 1, which has the best {objective}."
    if report.verdict is not None and report.verdict.word == "cannot tell":
        told = f"Drawn as chosen: candidate {chosen}, of which the verdict cannot tell whether it pays to move there"
    else:
        told = f"Chosen: candidate {chosen}, which the verdict is about"
    at = at and f" {at.removesuffix(', ')}."
    return f"{told}; candidate 1 has the best {objective}.{at}"


def _stay(report: Report) -> list[str]:
    """How the arm is held in the present loop where that is not how the choice has it."""
    initial = report.selection.initial if isinstance(report.selection, Selection) else None
    now = report.stands.get(PRESENT, initial)
    other = initial is not None and now is not None and initial.z.tolist() != now.z.tolist()
    return ["Present: in the posture that staying is judged in."] if other else []


def _slowest(report: Report) -> list[str]:
    """At which other target there is a closed loop, and why."""
    slowest = slowest_target(report.about, report.verdict)
    if slowest is None or SLOWEST not in report.loops:
        return []
    return [f"Over what is uncertain the loop decays slowest at target {slowest + 1}; it is run there, too."]


def _options(report: Report) -> str:
    given = report.simulation
    told = ", ".join(f"{name} = {_told(value)}" for name, value in given.items())
    real = next((loop.run.loop for loop in report.loops.values() if loop.run.loop is not None), None)
    controller = "" if real is None else f"Controller: {with_minus(repr(real).splitlines()[0])}. "
    others = "all others" if real is None else "all that the controller does not say"
    return (
        f"{controller}Options of flexopt.simulate: {told}; {others} are its defaults." if told else controller.strip()
    )


def _told(value: Any) -> str:
    if isinstance(value, list | tuple):
        parts = [_told(part) for part in cast(list[Any], value)]
        return parts[0] if len(parts) == 1 else f"({', '.join(parts)})"
    if hasattr(value, "model_dump"):
        return str(value.model_dump(exclude_defaults=True))
    return number(value, 6) if isinstance(value, float) else str(value)


def _loops(report: Report) -> PageTable:
    rows: list[list[str]] = []
    for name, loop in report.loops.items():
        run, linear = loop.run, loop.linear
        poles = "–" if linear is None else f"{number(-linear.growth_rate, 4)} at {number(linear.frequency_hz, 4)} Hz"
        decay = "–" if run.growth_rate is None else with_minus(with_doubt(-run.growth_rate, run.growth_rate_error))
        turn = "–" if run.peak_base_rotation is None else number(1e3 * run.peak_base_rotation, 4)
        off = "–" if run.end_error is None else number(1e3 * run.end_error, 4)
        rows.append(
            [
                name, run.verdict, decay, poles, number(run.settling_time, 4), turn, off,
                f"{run.time[-1]:g}",
            ]
        )  # fmt: skip
    header = [
        "configuration", "verdict", "decay of the base in the run, 1/s (± standard error)",
        "decay of the linear loop, 1/s",
        OfNumbers("settles in, s"), OfNumbers("largest base rotation, mrad"),
        OfNumbers("end-point at the end, mm off"), OfNumbers("duration, s"),
    ]  # fmt: skip
    return (header, rows) if rows else None


def _borders(report: Report) -> PageTable:
    rows = [
        [
            row.stand,
            row.held,
            row.integrator,
            row.text,
            "" if row.frequency_hz is None else number(row.frequency_hz, 4),
        ]
        for row in report.borders
    ]
    header = ["configuration", "held", "integrator", f"stable Kp, {report.gain_unit}", OfNumbers("then grows, Hz")]
    return (header, rows) if rows else None
