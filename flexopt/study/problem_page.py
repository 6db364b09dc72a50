"""The page of a `Report`: one HTML file that needs no other.

In: a report. Out: HTML.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from flexopt.foundation.rendering import render
from flexopt.plant import build_plant
from flexopt.robustness import Evaluation
from flexopt.selection import Selection
from flexopt.selection.result import ConstraintValue
from flexopt.study.page import Picture, Table, picture
from flexopt.study.verdict_page import judged
from flexopt.study.verdict_result import STAY

if TYPE_CHECKING:
    from flexopt.study.report_result import Report

CAPTIONS = {
    "selection": "The machine in the chosen and the present configuration, and its measures; 0 is best.",
    "several": "The machine at its targets, and its measures; 0 is best.",
    "loops": "Nonlinear closed loops with the same gains and the same displacement at the start.",
}
MAP_CAPTION = (
    "Frequencies, w_i, in-phase regions (yellow: trace R_i > 0), the robust stability margin and the rigid part. Star "
    "and ring: chosen and present configuration; cross: the end-point."
)
# Candidates or targets in a table of configurations, and in one of constraints; all are in the JSON document.
SHOWN, COMPARED = 12, 6
# Of a kind of constraints that has more rows than the first, those nearest to their bounds are shown.
MANY, NEAREST = 5, 3
# A mode is named by coordinates that hold at least so much of its strain energy.
NAMED = 0.15


class Constraints(NamedTuple):
    """Constraints near their bounds; those farther away, and what these are called."""

    near: Table
    far: Table
    told: str


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
        pictures={"selection": picture(report.selection.plot(), CAPTIONS["several" if several else "selection"])},
        sentence=f"{_sentence(report)} {report.selection.status}.",
        placed=placed,
        placed_note=note,
        measured=_measured(report),
        assumed=" ".join(f"{str(each)[:1].upper()}{str(each)[1:]}." for each in report.problem.assumed),
        constraints=_constraints(report),
        panels=_panels(report),
        map_caption=MAP_CAPTION,
        around="at the worst target" if several else "of the chosen configuration",
        loops=_loops(report),
        loops_note=_loops_note(report),
        runs=_runs(report),
        options=_options(report),
        borders=_borders(report),
        modes_at_rest=[_modes(report, name) for name in report.stands],
        coordinates=_coordinates(report),
        masses=_parameters(report, ("kg",), "mass"),
        springs=_parameters(report, ("N/m", "N m/rad", "N"), "spring"),
    )


def _panels(report: Report) -> dict[str, Picture]:
    """Each quantity of the map."""
    from flexopt.plotting.workspace import plot_quantities  # noqa: PLC0415  (matplotlib is slow to import)

    if report.map is None:
        return {}
    figures = plot_quantities(report.map.dataset, marks=report.marks)
    return {name: picture(figure, f"{name[0].upper()}{name[1:]}.") for name, figure in figures.items()}


def _runs(report: Report) -> dict[str, Picture]:
    """The runs beside each other, and each of them."""
    figures = {n: f for n, f in report.figures().items() if n == "loops" or n.startswith("run ")}
    return {
        "side by side" if name == "loops" else name.removeprefix("run "): picture(
            figure, CAPTIONS.get(name, f"Nonlinear {name}.")
        )
        for name, figure in figures.items()
    }


def _number(value: float | None, digits: int = 5) -> str:
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:.{digits}g}".replace("-", "−")


def _sentence(report: Report) -> str:
    problem, rows = report.problem, report.machine.task_rows
    weight = ", under gravity" if problem.gravity else ""
    how = f"Jacobian {problem.control} control{weight}:"
    if not isinstance(report.selection, Selection):
        return f"{len(report.selection.places)} targets of the end-point. Objective {problem.name}, {how}"
    target = ", ".join(f"{row} = {_number(x)}" for row, x in zip(rows, problem.target, strict=True))
    return f"Target of the end-point: {target} m. Objective {report.selection.objective}, {how}"


class _Listed(NamedTuple):
    """A configuration in the tables: its name, its numbers, what is to be said of it."""

    name: str
    evaluation: Evaluation
    remark: str


def _listed(report: Report) -> list[_Listed]:
    """The present configuration and the candidates, or the configuration at each target."""
    selection = report.selection
    if not isinstance(selection, Selection):
        return [
            _Listed(
                f"target {k + 1}",
                place.evaluation,
                f"V {_number(place.objective, 4)}" + (", the worst" * (k == selection.worst)),
            )
            for k, place in enumerate(selection.places[:SHOWN])
        ]
    present = [] if selection.initial is None else [_Listed("present", selection.initial, "")]
    return present + [
        _Listed(f"candidate {k}" + (" (chosen)" * (k == 1)), each.evaluation, ", ".join(each.active))
        for k, each in enumerate(selection.candidates[:SHOWN], start=1)
    ]


def _placed(report: Report) -> tuple[Table, str]:
    """Where each configuration stands and how it is held, and a remark."""
    listed, selection = _listed(report), report.selection
    first = listed[0].evaluation
    names = [*_with_units(first.base_coordinates, first.base_units), *_with_units(first.joints, first.joint_units)]
    said = any(each.remark for each in listed)
    last = "rests on" if isinstance(selection, Selection) else "objective"
    rows = [
        [each.name, *(_number(x) for x in (*each.evaluation.base, *each.evaluation.posture)), *[each.remark] * said]
        for each in listed
    ]
    if not isinstance(selection, Selection):
        more, wide = len(selection.places) - SHOWN, list[str]()
    else:
        more = len(selection.candidates) - SHOWN
        wide = [f"{k} ({len(c.continuum)} more)" for k, c in enumerate(selection.candidates[:SHOWN], 1) if c.continuum]
    notes = [f"And {more} more."] * (more > 0)
    if wide:
        notes.append(
            f"Placements that change nothing else, as when the machine turns about the target: {', '.join(wide)}."
        )
    return (["", *names, *[last] * said], rows), " ".join(notes)


def _measured(report: Report) -> Table:
    """Measures and frequencies of each."""
    listed = _listed(report)
    modes = range(1, listed[0].evaluation.w.size + 1)
    header = ["", *(f"w{i}" for i in modes), "ε_max", *(f"f{i}, Hz" for i in modes)]
    return header, [
        [
            name, *(_number(w, 4) for w in e.w), _number(e.epsilon_max), *(_number(f, 4) for f in e.frequencies_hz),
        ]
        for name, e, _ in listed
    ]  # fmt: skip


def _with_units(names: Iterable[str], units: Iterable[str]) -> list[str]:
    return [f"{name}, {unit}" for name, unit in zip(names, units, strict=True)]


def _constraints(report: Report) -> Constraints | None:
    """Values of every constraint; of a kind with many rows those near their bounds apart."""
    selection = report.selection
    one = isinstance(selection, Selection)
    shown = (selection.candidates if one else selection.places)[:COMPARED]
    if not shown[0].constraints:
        return None
    kinds: dict[str, list[str]] = {}
    for name in shown[0].constraints:
        kinds.setdefault(re.split(" of | from |, ", name)[0], []).append(name)
    near, far = list[str](), list[str]()
    for names in kinds.values():
        if len(names) > MANY:
            names = sorted(names, key=lambda name: min(_room(each.constraints[name]) for each in shown))  # noqa: PLW2901
            near, far = near + names[:NEAREST], far + names[NEAREST:]
        else:
            near += names
    header = ["constraint", "allowed", *(f"{'candidate' if one else 'target'} {k}" for k in range(1, len(shown) + 1))]
    several = [name for name, names in kinds.items() if len(names) > MANY]
    told = f"{len(far)} more of {' and '.join(several)}, farther from their bounds"

    def table(names: list[str]) -> Table:
        rows = list[list[str]]()
        for name in names:
            values = [each.constraints[name] for each in shown]
            rows.append([name, _allowed(values[0]), *(_number(value.value, 4) for value in values)])
        return (header, rows) if rows else None

    return Constraints(table(near), table(far), told)


def _room(value: ConstraintValue) -> float:
    """How far it is from its nearer bound."""
    return min(value.value - value.lower, value.upper - value.value)


def _allowed(value: ConstraintValue) -> str:
    low, high, unit = value.lower, value.upper, value.unit
    if math.isfinite(low) and math.isfinite(high):
        return f"{_number(low)} to {_number(high)} {unit}" if low < high else f"{_number(low)} {unit}"
    return f"at least {_number(low)} {unit}" if math.isfinite(low) else f"at most {_number(high)} {unit}"


def _coordinates(report: Report) -> Table:
    machine, plant = report.machine, build_plant(report.machine)
    rows: list[list[str]] = []
    limits = dict(zip(machine.joints, machine.limits, strict=True))
    efforts = dict(zip(machine.joints, machine.efforts, strict=True))
    for k, (name, unit) in enumerate(zip(plant.coordinates, plant.graph.coordinate_units, strict=True)):
        low, high = limits.get(name, (math.nan, math.nan))
        bounded = math.isfinite(low) or math.isfinite(high)
        effort = _number(efforts.get(name))
        rows.append(
            [
                name, unit, "passive" if k < plant.n_passive else "actuated",
                f"{_number(low)} to {_number(high)}" if bounded else "",
                "" if effort == "–" else f"{effort} {'N m' if unit == 'rad' else 'N'}",
            ]
        )  # fmt: skip
    return ["coordinate", "unit", "kind", "limits", "effort"], rows


def _parameters(report: Report, units: tuple[str, ...], what: str) -> Table:
    rows = [
        [parameter.name, _number(parameter.value, 6), parameter.unit]
        for parameter in report.machine.parameters
        if parameter.unit in units and parameter.value != 0
    ]
    if what == "mass":
        total = sum(p.value for p in report.machine.parameters if p.unit in units)
        rows.append(["total", _number(total, 6), "kg"])
    return ([what, "value", "unit"], rows) if rows else None


def _modes(report: Report, name: str) -> Table:
    stand = report.stands[name]
    shares, names = report.mode_shares(stand), build_plant(report.machine).coordinates
    rows: list[list[str]] = []
    for i, w in enumerate(stand.w):
        moving = [k for k in np.argsort(-shares[:, i]) if shares[k, i] >= NAMED]
        share = w / stand.scale[i] if stand.scale[i] > 0 else 0.0
        phase = "strictly" if stand.in_phase_strict[i] else "yes" if stand.in_phase[i] else "no"
        rows.append(
            [
                str(i + 1), _number(stand.frequencies_hz[i]), _number(stand.damping_ratios[i], 3), _number(w),
                _number(share, 4), phase, ", ".join(f"{names[k]} {100 * shares[k, i]:.0f} %" for k in moving),
            ]
        )  # fmt: skip
    header = [f"mode, {name}", "frequency, Hz", "damping ratio", "w", "w/|a||b|", "in phase", "strain energy in"]
    return header, rows


def _loops_note(report: Report) -> str:
    """Which configurations these are."""
    if not isinstance(report.selection, Selection):
        return "At the target with the smallest V, the base standing where it is chosen to stand there."
    best = f"Chosen: candidate 1, which has the best {report.selection.objective}"
    if report.verdict is not None and report.verdict.place not in ("", STAY, "candidate 1"):
        best += f"; the verdict looks at what the controller makes of each, and is about {report.verdict.place}"
    return f"{best}."


def _options(report: Report) -> str:
    given = report.simulation
    told = ", ".join(f"{name} = {_told(value)}" for name, value in given.items())
    return f"Options of flexopt.simulate: {told}; all others are its defaults." if told else ""


def _told(value: Any) -> str:
    if isinstance(value, list | tuple):
        parts = [_told(part) for part in cast(list[Any], value)]
        return parts[0] if len(parts) == 1 else f"({', '.join(parts)})"
    if hasattr(value, "model_dump"):
        return str(value.model_dump(exclude_defaults=True))
    return _number(value, 6) if isinstance(value, float) else str(value)


def _loops(report: Report) -> Table:
    rows: list[list[str]] = []
    for name, loop in report.loops.items():
        run, linear = loop.run, loop.linear
        poles = "–" if linear is None else f"{_number(linear.growth_rate, 4)} at {_number(linear.frequency_hz, 4)} Hz"
        turn = "–" if run.peak_base_rotation is None else _number(1e3 * run.peak_base_rotation, 4)
        off = "–" if run.end_error is None else _number(1e3 * run.end_error, 4)
        rows.append(
            [
                name, run.verdict, _number(run.growth_rate, 4), poles, _number(run.settling_time, 4), turn, off,
                f"{run.time[-1]:g}",
            ]
        )  # fmt: skip
    header = ["configuration", "verdict", "growth rate of the run, 1/s", "linear loop, 1/s", "settles in, s",
              "largest base rotation, mrad", "end-point at the end, mm off", "duration, s"]  # fmt: skip
    return (header, rows) if rows else None


def _borders(report: Report) -> Table:
    rows = [
        [
            row.stand,
            row.held,
            row.integrator,
            row.text,
            "" if row.frequency_hz is None else _number(row.frequency_hz, 4),
        ]
        for row in report.borders
    ]
    return (["configuration", "held", "integrator", "stable Kp", "then grows, Hz"], rows) if rows else None
