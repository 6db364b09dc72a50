"""The page of a `Report`: one HTML file that needs no other.

In: a report. Out: HTML.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from flexopt.foundation.rendering import render
from flexopt.plant import build_plant
from flexopt.study.page import Table, picture

if TYPE_CHECKING:
    from flexopt.study.problem_report import Report

CAPTIONS = {
    "selection": "The machine in the chosen and the present configuration, and its measures; 0 is best.",
    "map": "Around the chosen configuration: frequencies, w_i, in-phase regions (yellow: trace R_i > 0), the robust "
    "stability margin and the rigid part. Rings: present and chosen configuration; cross: the end-point.",
    "loops": "Nonlinear closed loops with the same gains and the same displacement at the start.",
}
# Candidates in the table; all are in the JSON document.
SHOWN = 12
# A mode is named by coordinates that hold at least so much of its strain energy.
NAMED = 0.15


def report_html(report: Report) -> str:
    """The page."""
    candidates, note = _candidates(report)
    return render(
        "study/templates/report.html",
        title=f"Report: {report.name}",
        provenance=report.provenance,
        report=report,
        pictures={n: picture(f, CAPTIONS.get(n, f"Nonlinear {n}.")) for n, f in report.figures().items()},
        sentence=f"{_sentence(report)} {report.selection.status}.",
        candidates=candidates,
        candidates_note=note,
        assumed=" ".join(f"{str(each)[:1].upper()}{str(each)[1:]}." for each in report.selection.problem.assumed),
        constraints=_constraints(report),
        coordinates=_coordinates(report),
        masses=_parameters(report, ("kg",), "mass"),
        springs=_parameters(report, ("N/m", "N m/rad", "N"), "spring"),
        modes_at_rest=[_modes(report, name) for name in report.stands],
        options=_gains(report),
        loops=_loops(report),
        borders=_borders(report),
        verdict=_verdict(report),
    )


def _number(value: float | None, digits: int = 5) -> str:
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:.{digits}g}".replace("-", "−")


def _sentence(report: Report) -> str:
    problem = report.selection.problem
    target = ", ".join(f"{row} = {_number(x)}" for row, x in zip(report.machine.task_rows, problem.target, strict=True))
    weight = ", under gravity" if problem.gravity else ""
    how = f"Objective {report.selection.objective}, Jacobian {problem.control} control{weight}:"
    return f"Target of the end-point: {target} m. {how}"


def _candidates(report: Report) -> tuple[Table, str]:
    """The table, and a remark on it."""
    selection = report.selection
    best = selection.best.evaluation
    modes = range(1, best.w.size + 1)
    header = [
        "", *_with_units(best.base_coordinates, best.base_units), *_with_units(best.joints, best.joint_units),
        *(f"w{i}" for i in modes), "ε_max", *(f"f{i}, Hz" for i in modes), "rests on",
    ]  # fmt: skip
    listed = [(str(k), c.evaluation, ", ".join(c.active)) for k, c in enumerate(selection.candidates[:SHOWN], start=1)]
    wide = [f"{k} ({len(c.continuum)} more)" for k, c in enumerate(selection.candidates[:SHOWN], 1) if c.continuum]
    if selection.initial is not None:
        listed.insert(0, ("present", selection.initial, ""))
    rows = [
        [
            name, *(_number(x) for x in (*e.base, *e.posture)), *(_number(w, 4) for w in e.w), _number(e.epsilon_max),
            *(_number(f, 4) for f in e.frequencies_hz), active,
        ]
        for name, e, active in listed
    ]  # fmt: skip
    more = len(selection.candidates) - SHOWN
    alike = f"Placements that change nothing else, as when the machine turns about the target: {', '.join(wide)}."
    notes = [f"And {more} more."] * (more > 0) + [alike] * bool(wide)
    return (header, rows), " ".join(notes)


def _with_units(names: Iterable[str], units: Iterable[str]) -> list[str]:
    return [f"{name}, {unit}" for name, unit in zip(names, units, strict=True)]


def _constraints(report: Report) -> Table:
    """Values of every constraint at the candidates."""
    shown = report.selection.candidates[:SHOWN]
    names = list(shown[0].constraints)
    if not names:
        return None
    rows: list[list[str]] = []
    for name in names:
        values = [candidate.constraints[name] for candidate in shown]
        rows.append(
            [
                name,
                _allowed(values[0].lower, values[0].upper, values[0].unit),
                *(_number(value.value) for value in values),
            ]
        )
    return ["constraint", "allowed", *(f"{k}" for k in range(1, len(shown) + 1))], rows


def _allowed(low: float, high: float, unit: str) -> str:
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


def _gains(report: Report) -> str:
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


def _verdict(report: Report) -> Table:
    """Every place's worst over what is uncertain."""
    judged = report.verdict
    if judged is None:
        return None
    header = ["place", "drive, m", "slowest decay, 1/s", "least allowed Kp", "least delay margin, ms",
              "longest settling, s", "largest turn of the base, mrad", "runs that converge, %"]  # fmt: skip
    scales = (1.0, 1.0, 1.0, 1e3, 1.0, 1e3, 100.0)
    rows = [
        [str(first), *(_number(scale * value, 4) for scale, value in zip(scales, values, strict=True))]
        for first, *values in (list(row.values()) for row in judged.table)
    ]
    return header, rows


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
