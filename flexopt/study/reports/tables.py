"""Tables of the page of a `Report`: constraints, coordinates, masses and springs, modes.

In: a report. Out: names of columns and rows of text.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from flexopt.foundation.rendering import OfNumbers
from flexopt.foundation.rounding import without_rounding
from flexopt.plant import build_plant
from flexopt.robustness.evaluation import Evaluation, unreached
from flexopt.robustness.residues import residue_unit, written_unit
from flexopt.selection import Selection
from flexopt.selection.broken import cornerless
from flexopt.selection.constraint_values import by_kind
from flexopt.selection.several import BasePlan, Stand, TargetConfiguration
from flexopt.study.page import PageTable, number, with_minus
from flexopt.study.verdicts.places import candidate_number

if TYPE_CHECKING:
    from flexopt.study.reports.result import Report

# Candidates or targets in a table of configurations, and in one of constraints; all are in the JSON document.
SHOWN, COMPARED = 12, 6
# Of a kind of constraints that has more rows than the first, those nearest to their bounds are shown.
MANY, NEAREST = 5, 3
# A mode is named by coordinates that hold at least so much of its strain energy.
NAMED = 0.15


class ConstraintTables(NamedTuple):
    """Constraints near their bounds; those farther away, and what these are called; how many columns are left out."""

    near: PageTable
    far: PageTable
    told: str
    others: str


def some(several: Stand | BasePlan, count: int) -> list[tuple[int, TargetConfiguration]]:
    """Some targets from the first to the last, the worst among them, with their indices."""
    places = several.places
    drawn = np.linspace(0, len(places) - 1, min(count, len(places))).round().astype(int).tolist()
    return [(k, places[k]) for k in sorted({*drawn, several.worst})]


def chosen_number(report: Report) -> int:
    """Of the candidate that pictures, map and loops show: that of the verdict, else the selection's best."""
    return (candidate_number(report.verdict.place) if report.verdict else None) or 1


def constraints(report: Report) -> ConstraintTables | None:
    """Values of every constraint; of a kind with many rows those near their bounds apart."""
    selection = report.about
    one = isinstance(selection, Selection)
    if isinstance(selection, Selection):
        looked = {*range(COMPARED), chosen_number(report) - 1}
        numbered = [(k, each) for k, each in enumerate(selection.candidates) if k in looked]
    else:
        numbered = some(selection, COMPARED)
    shown = [each.constraints for _, each in numbered]
    if not shown[0]:
        return None
    alike = cornerless(selection.problem if isinstance(selection, Selection) else selection.problems[0])
    chosen = chosen_number(report) - 1 if isinstance(selection, Selection) else selection.worst
    kinds, own = by_kind(shown[0], alike), next(each.constraints for k, each in numbered if k == chosen)
    near, far = list[str](), list[str]()
    for names in kinds.values():
        if len(names) > MANY:
            nearest = dict[str, str]()
            for name in sorted(names, key=lambda name: min(each[name].nearness for each in shown)):
                nearest.setdefault(alike.get(name, name), name)
            # What is nearest of all may be far where one goes.
            first = {*list(nearest.values())[:NEAREST], min(names, key=lambda name: own[name].nearness)}
            near += [name for name in names if name in first]
            far += [name for name in names if name not in first]
        else:
            near += names
    kind = "candidate" if one else "target"
    header = ["constraint", "allowed", *(OfNumbers(f"{kind} {k + 1}") for k, _ in numbered)]
    several = [name for name, names in kinds.items() if len(names) > MANY]
    corners = " or at other corners" * any(name in alike for name in far)
    told = f"{len(far)} more of {' and '.join(several)}, farther from their bounds{corners}"

    left = len(selection.candidates if one else selection.places) - len(shown)
    more = f"1 more {kind} keeps" if left == 1 else f"{left} more {kind}s keep"
    where = "; the values are in report.json" if one or selection is report.selection else ""
    others = f"{more} within them, too{where}."

    def table(names: list[str]) -> PageTable:
        rows = list[list[str]]()
        for name in names:
            values = [each[name] for each in shown]
            rows.append(
                [
                    with_minus(name),
                    values[0].allowed(number, written_unit(values[0].unit)),
                    *(number(value.shown, 4) for value in values),
                ]
            )
        return (header, rows) if rows else None

    return ConstraintTables(table(near), table(far), told, others if left else "")


def coordinates(report: Report) -> PageTable:
    """Every coordinate of the machine, passive and actuated."""
    machine, plant = report.machine, build_plant(report.machine)
    rows: list[list[str]] = []
    limits = dict(zip(machine.joints, machine.limits, strict=True))
    efforts = dict(zip(machine.joints, machine.efforts, strict=True))
    for k, (name, unit) in enumerate(zip(plant.coordinates, plant.graph.coordinate_units, strict=True)):
        low, high = limits.get(name, (math.nan, math.nan))
        bounded = math.isfinite(low) or math.isfinite(high)
        effort = number(efforts.get(name))
        rows.append(
            [
                name, unit, "passive" if k < plant.n_passive else "actuated",
                f"{number(low)} to {number(high)}" if bounded else "",
                "" if effort == "–" else f"{effort} {'N m' if unit == 'rad' else 'N'}",
            ]
        )  # fmt: skip
    return ["coordinate", "unit", "kind", "limits", OfNumbers("effort")], rows


def parameters(report: Report, units: tuple[str, ...], what: str) -> PageTable:
    """Parameters of some units; of masses their total, too."""
    rows = [
        [parameter.name, number(parameter.value, 6), parameter.unit]
        for parameter in report.machine.parameters
        if parameter.unit in units and parameter.value != 0
    ]
    if what == "mass":
        total = sum(p.value for p in report.machine.parameters if p.unit in units)
        rows.append(["total", number(total, 6), "kg"])
    return ([what, OfNumbers("value"), "unit"], rows) if rows else None


def written_residue(evaluation: Evaluation) -> str:
    """The unit of w_i, as it is printed."""
    return written_unit(residue_unit(evaluation.control, evaluation.joint_units))


def modes(report: Report, name: str) -> PageTable:
    """Modes of a configuration, and the coordinates that hold their strain energy."""
    stand = report.stands[name]
    shares, names = report.mode_shares(stand), build_plant(report.machine).coordinates
    rows: list[list[str]] = []
    hidden = unreached(stand.scale)
    for i, w in enumerate(without_rounding(stand.w, stand.scale)):
        moving = [k for k in np.argsort(-shares[:, i]) if shares[k, i] >= NAMED]
        none = bool(hidden[i])
        share = "–" if none else number(w / stand.scale[i], 4)
        phase = "–" if none else "strictly" if stand.in_phase_strict[i] else "yes" if stand.in_phase[i] else "no"
        rows.append(
            [
                str(i + 1), number(stand.frequencies_hz[i]), number(stand.damping_ratios[i], 3),
                number(0.0 if none else w), share, phase,
                ", ".join(f"{names[k]} {100 * shares[k, i]:.0f} %" for k in moving),
            ]
        )  # fmt: skip
    numbers = ("frequency, Hz", "damping ratio", f"w, {written_residue(stand)}", "w/|a||b|")
    return [f"mode, {name}", *map(OfNumbers, numbers), "in phase", "strain energy in"], rows
