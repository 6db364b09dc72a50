"""The map around a chosen configuration, and where configurations are in it.

In: what was selected, for one target or several. Out: a `WorkspaceMap` and the marks to draw in it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.foundation.plain import listed
from flexopt.foundation.rounding import WAY
from flexopt.model import AnyMachine
from flexopt.model.choices import Elbow
from flexopt.plant import build_plant
from flexopt.robustness import Evaluation
from flexopt.selection import Selection, SelectionProblem
from flexopt.selection.broken import broken
from flexopt.selection.places import FEASIBLE
from flexopt.selection.several import BasePlan, Stand
from flexopt.selection.several.others import other_stand
from flexopt.selection.starts import violated
from flexopt.study.maps.grid import closed_form, first_joint_at_rest
from flexopt.study.maps.workspace import map_workspace, takes_long
from flexopt.study.maps.workspace_map import WorkspaceMap
from flexopt.study.verdicts.places import FIRST, STAY, candidate_number
from flexopt.study.verdicts.result import Verdict

CHOSEN, PRESENT, WORST, SLOWEST = "chosen", "present", "worst target", "slowest target"
NONE_REACHED = "reached in a regular posture"
# Of the map along each axis, and with more than three passive coordinates.
POINTS, FEW_POINTS = 160, 48


def spoken_of(selection: Selection | Stand | BasePlan, place: str) -> Selection | Stand | BasePlan:
    """What pictures, map and loops show: the selection, its best the candidate that a verdict speaks of.

    Of a way along a path always the way.
    """
    number = candidate_number(place)
    if number in (None, 1) or isinstance(selection, BasePlan):
        return selection
    if isinstance(selection, Stand):
        return other_stand(selection, number)
    return replace(selection, best=selection.candidates[number - 1])


def problem_of(selection: Selection | Stand | BasePlan) -> SelectionProblem:
    """The problem of one target; of several that of the worst."""
    return selection.problem if isinstance(selection, Selection) else selection.problems[selection.worst]


def best_of(selection: Selection | Stand | BasePlan) -> Evaluation:
    """The chosen configuration; of several targets that of the worst."""
    if isinstance(selection, Selection):
        return selection.best.evaluation
    return selection.places[selection.worst].evaluation


def stands_of(selection: Selection | Stand | BasePlan, judged: Verdict | None) -> dict[str, Evaluation]:
    """The present configuration, where it is known, and the chosen one; of several targets that of the worst.

    Present is what a verdict judges staying in: that of the choice may break constraints, where no posture was given.
    """
    if not isinstance(selection, Selection):
        return {WORST: best_of(selection)}
    present = {} if selection.initial is None else {PRESENT: _present(selection, selection.initial, judged)}
    return present | {CHOSEN: selection.best.evaluation}


def _present(selection: Selection, initial: Evaluation, judged: Verdict | None) -> Evaluation:
    stay = None if judged is None else next((place for place in judged.places if place.name == STAY), None)
    z = initial.z if stay is None else np.concatenate(stay.stands[0])
    return initial if np.array_equal(z, initial.z) else selection.problem.quantities.evaluated(z)


def map_points(machine: AnyMachine) -> int:
    """How many along each axis by default."""
    return FEW_POINTS if takes_long(machine) else POINTS


def slowest_target(selection: Selection | Stand | BasePlan, judged: Verdict | None) -> int | None:
    """At which of several targets the loop decays slowest in the place that is shown, over what is uncertain, from 0.

    None where that is the worst one by the objective, too, or nothing is known of it.
    """
    if judged is None or isinstance(selection, Selection):
        return None
    name = judged.place if candidate_number(judged.place) and not isinstance(selection, BasePlan) else FIRST
    slowest = next((place.slowest_target for place in judged.places if place.name == name), None)
    return None if slowest == selection.worst else slowest


def surroundings(selection: Selection | Stand | BasePlan, points: int) -> WorkspaceMap | None:
    """The map that tells most: where to stand, else what the end-point can do."""
    problem, best = problem_of(selection), best_of(selection)
    machine, rows = problem.machine, problem.machine.task_rows
    given: dict[str, Any] = {"control": problem.control, "gain": problem.gain, "gravity": problem.gravity}
    given["points"] = (points, points)
    if len(machine.base_coordinates) > 1:
        end_point = problem.target.tolist()
        for axis, low, high in zip(
            ("x_range", "y_range"), problem.lower.tolist(), problem.upper.tolist(), strict=False
        ):
            given |= {axis: (low, high)} if 0 < high - low < math.inf else {}
        whole = map_workspace(machine, over="base", posture=best.posture, base=best.base, end_point=end_point, **given)
        return _allowed(whole, problem, best)
    if closed_form(machine):
        return map_workspace(machine, elbow=elbow_of(machine, best), **given)
    if len(rows) > 1:
        upright = ("x", "z") if {"x", "z"} <= set(rows) else rows[:2]
        whole = map_workspace(machine, over="end_point", rows=upright, posture=best.posture, base=best.base, **given)
        return _allowed(whole, problem, best)
    if len(machine.joints) > 1:
        return map_workspace(machine, over="posture", posture=best.posture[2:], base=best.base, **given)
    return None


def _allowed(chart: WorkspaceMap, problem: SelectionProblem, best: Evaluation) -> WorkspaceMap:
    """A followed map, blank where its posture breaks a limit, a range or a constraint of the problem.

    Of one that is blank all over the attribute `barred` says why, in words after "none of its points is".
    """
    dataset = chart.dataset
    postures = np.asarray(dataset["posture"].values).reshape(len(problem.machine.joints), -1)
    z = np.vstack([np.tile(best.base[:, None], postures.shape[1]), postures])
    planes = np.meshgrid(*(dataset[axis].values for axis in chart.axes), indexing="ij")
    for axis, plane in zip(chart.axes, planes, strict=True):
        if chart.options["over"] == "base":
            z[problem.machine.base_coordinates.index(axis.removeprefix("base_"))] = plane.ravel()
    # Across a way that is held, as rails do, it is shown how it would be.
    free = problem.lower < problem.upper
    low, high, size = (x[free, None] for x in (problem.lower, problem.upper, problem.scale))
    beyond = (np.maximum(low - z[free], z[free] - high) / size).max(axis=0)
    # Of the target nothing is asked: over end-points they are others.
    kept = np.maximum(violated(problem, z, target=False), beyond) <= FEASIBLE
    shown = {name: each.where(kept.reshape(planes[0].shape)) for name, each in dataset.items() if each.dtype == float}
    ways = held_ways(chart, problem)
    aside = f", as if {listed(ways)} were free" if ways else ""
    within = {"mapped": f"reached, regular and allowed by the problem{aside}"}
    regular = np.isfinite(np.asarray(dataset["condition"].values)).ravel()
    if not (regular & kept).any():
        at = _place_in(chart, problem.machine, best)
        within["barred"] = _barred(chart, problem, z, np.flatnonzero(regular), [at[axis] for axis in chart.axes])
    return replace(chart, dataset=dataset.assign(shown).assign_attrs(within))


def _barred(
    chart: WorkspaceMap, problem: SelectionProblem, z: Vector, among: NDArray[np.int64], best: list[float]
) -> str:
    """What the point of a map nearest to the chosen configuration breaks; points z (n_z, N), of which `among` count."""
    if not among.size:
        return NONE_REACHED
    axes = [chart.dataset[axis] for axis in chart.axes]
    points = np.stack(np.meshgrid(*(axis.values for axis in axes), indexing="ij")).reshape(2, -1)
    spans = np.ptp(points, axis=1)
    away = np.hypot(*((points[:, among].T - best) / spans).T)
    nearest = int(among[int(away.argmin())])
    # Along a way that is held the map shows how it would be.
    widened = [replace(each, lower=-math.inf, upper=math.inf) if each.lower == each.upper else each
               for each in problem.variables]  # fmt: skip
    told = broken(replace(problem, variables=tuple(widened)), z[:, nearest])
    place = zip(chart.axes[::-1], points[::-1, nearest].tolist(), axes[::-1], strict=True)
    where = ", ".join(f"{name.removeprefix('base_')} {x:z.4g} {axis.attrs['units']}" for name, x, axis in place)
    which = f"the nearest to the chosen configuration that is reached, at {where},"
    return f"allowed; {which} {told or 'is beyond its ranges'}"


def mapped(chart: WorkspaceMap) -> bool:
    """Whether a map shows anything."""
    return chart.to_dict()["mapped"] > 0


def held_ways(chart: WorkspaceMap, problem: SelectionProblem) -> list[str]:
    """Of the axes of a map over the placement those along which the problem lets the base stand in one place alone."""
    placed = zip(problem.machine.base_coordinates, problem.variables, strict=False)
    return [name for name, each in placed if each.lower == each.upper and f"base_{name}" in chart.axes]


def elbow_of(machine: AnyMachine, stand: Evaluation) -> Elbow:
    """Branch of an arm of two parallel hinges."""
    tree = machine.kinematic_tree
    rows = [tree.axes.index(row) for row in machine.task_rows]
    moved = [k for k, i in enumerate(tree.drawn) if i is not None and not tree.bodies[i].joint.passive]
    shoulder, elbow, tip = stand.skeleton[rows][:, [*moved, -1]].T
    first, second = elbow - shoulder, tip - elbow
    return "up" if first[0] * second[1] < first[1] * second[0] else "down"


def _place_in(drawn: WorkspaceMap, machine: AnyMachine, stand: Evaluation) -> dict[str, float]:
    """A configuration in the coordinates of a map."""
    rows, columns = drawn.axes
    if drawn.options["over"] == "base":
        return {f"base_{n}": float(x) for n, x in zip(stand.base_coordinates, stand.base, strict=True)}
    if drawn.options["over"] == "posture":
        return {n: float(x) for n, x in zip((columns, rows), stand.posture[:2], strict=True)}
    closed = "elbow" in drawn.options
    origin = first_joint_at_rest(build_plant(machine), stand.base) if closed else np.zeros(stand.end_point.size)
    return dict(zip(machine.task_rows, (stand.end_point - origin).tolist(), strict=True))


def marks_in(
    selection: Selection | Stand | BasePlan, drawn: WorkspaceMap, judged: Verdict | None = None
) -> dict[str, tuple[float, float]]:
    """Where the configurations are in the map's plane."""
    rows, columns = drawn.axes
    problem = problem_of(selection)
    machine = problem.machine
    marks: dict[str, tuple[float, float]] = {}
    for shown, stand in stands_of(selection, judged).items():
        name = CHOSEN if shown == WORST else shown
        if "elbow" in drawn.options:
            shown_there = drawn.options["elbow"] == elbow_of(machine, stand)
        else:
            # Over end-points the map is of the arm on the chosen one's base.
            off = np.abs(stand.base - best_of(selection).base).max(initial=0.0)
            shown_there = drawn.options["over"] != "end_point" or off <= WAY
        if shown_there:
            at = _place_in(drawn, machine, stand)
            marks[name] = at[columns], at[rows]
    target = dict(zip(machine.task_rows, problem.target.tolist(), strict=True))
    if drawn.options["over"] == "base" and all(axis.removeprefix("base_") in target for axis in drawn.axes):
        marks["end-point"] = target[columns.removeprefix("base_")], target[rows.removeprefix("base_")]
    # What lies beside the plane has no place in it.
    ends = [
        (float(drawn.dataset[axis].values.min()), float(drawn.dataset[axis].values.max())) for axis in (columns, rows)
    ]
    return {
        name: point
        for name, point in marks.items()
        if all(low <= x <= high for x, (low, high) in zip(point, ends, strict=True))
    }
