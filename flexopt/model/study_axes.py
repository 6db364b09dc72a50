"""What varies in a study, as it is computed with: coordinates and entries of p, their ends; and what does not fit.

In: a `Study`, which holds its machine. Out: `StudyAxis` objects, or one `InputError` with every fault.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.coordinates import check_placement
from flexopt.foundation.nearest import hint_or_list
from flexopt.foundation.quantities import COORDINATE, Quantity
from flexopt.model.loop import DEAD_TIME, GAINS, LOOP_GAINS, loop_faults
from flexopt.model.machine import AnyMachine
from flexopt.model.problem import Problem
from flexopt.model.simulation import Experiment
from flexopt.model.simulation_faults import loop_of_runs
from flexopt.model.study import Study, Vary
from flexopt.model.uncertainty import LATE, Uncertainty, kind_of, parameters_of, uncertainty_faults

# What may vary, beside parameters of the machine, by what is computed.
MAY_VARY: dict[str, tuple[str, ...]] = {
    "measures": ("posture", "base"),
    "outcome": ("posture", "base", *GAINS, LATE),
    "selection": ("target", "base"),
    "simulation": ("posture", "base", *GAINS),
}


@dataclass(frozen=True)
class StudyAxis:
    """One thing that varies, as it is computed with.

    Attributes:
        name, unit: of it.
        kind: `"posture"`, `"base"`, `"target"`, a gain, `"dead_time"` or `"parameters"`.
        entries: which coordinate, or which entries of the machine's p.
        factor: whether these are multiplied.
        low, high: ends;  count: of a grid, else 0;  log: whether spaced evenly in the logarithm.
    """

    name: str
    unit: str
    kind: str
    entries: tuple[int, ...]
    factor: bool
    low: float
    high: float
    count: int
    log: bool


def study_axes(study: Study) -> tuple[StudyAxis, ...]:
    """What varies, as it is computed with.

    Raises:
        InputError: something does not go with the machine.
    """
    found = [_axis(study, k, each) for k, each in enumerate(study.vary)]
    faults = [fault for _, of_axis in found for fault in of_axis] + _fixed_faults(study, [axis for axis, _ in found])
    raise_if_any(InputError, f"study {study.name!r}", faults)
    return tuple(cast(StudyAxis, axis) for axis, _ in found)


def _axis(study: Study, k: int, each: Vary) -> tuple[StudyAxis | None, list[Fault]]:
    """One thing that varies, or what is wrong with it."""
    machine, field = study.loaded_machine, f"vary[{k}] ({each.of})"
    word, _, name = each.of.partition(".")
    ends = each.value or each.factor or (0.0, 1.0)
    log = each.scale == "log" or (each.scale is None and each.factor is not None)
    rest: Any = (each.factor is not None, *ends, each.count or 0, log)
    places = {
        "posture": (machine.joints, machine.joint_units),
        "base": (machine.base_coordinates, machine.base_units),
        "target": (machine.task_rows, ("m",) * len(machine.task_rows)),
    }
    if word == "base" and name not in machine.base_coordinates:
        del places[word]  # planar machines have parameters of such names
    if word in places or each.of in (*GAINS, LATE):
        kind = word if word in places else each.of
        if kind not in MAY_VARY[study.compute]:
            also = f"{', '.join(MAY_VARY[study.compute])} and parameters vary"
            return None, [Fault(f"{field}.of", f"does not vary with compute = {study.compute!r}: {also}", each.of)]
        if each.factor is not None:
            return None, [Fault(f"{field}.factor", "goes with parameters; give value, (lower, upper)")]
    if word in places:
        names, units = places[word]
        if name not in names:
            return None, [Fault(f"{field}.of", f"{machine.name} has none such{hint_or_list(name, list(names))}", name)]
        i = names.index(name)
        allowed = _allowed(machine, word, i, units[i])
        return _checked(field, each, allowed, StudyAxis(each.of, units[i], word, (i,), *rest))
    if each.of in (*GAINS, LATE):
        unit = "s" if each.of == LATE else ""
        return _checked(field, each, LOOP_GAINS.get(each.of, DEAD_TIME), StudyAxis(each.of, unit, each.of, (), *rest))
    return _of_parameters(machine, field, each, rest)


def _of_parameters(machine: AnyMachine, field: str, each: Vary, rest: Any) -> tuple[StudyAxis | None, list[Fault]]:
    way = "factor" if each.factor is not None else "value"
    if kind_of(each.of) == "factor" and way == "value":
        return None, [Fault(f"{field}.value", "stands for several parameters; give factor, (lower, upper)")]
    try:
        told = Uncertainty(of=(each.of,), **{way: each.factor or each.value})
    except InputError as error:
        return None, [Fault(f"{field}.{fault.field}", fault.sentence, fault.value) for fault in error.faults]
    faults = uncertainty_faults([told], machine, field)
    if faults:
        return None, [Fault(f.field.replace("[0]", ""), f.sentence, f.value) for f in faults]
    entries = parameters_of((each.of,), machine)
    unit = "" if way == "factor" else machine.parameters[entries[0]].unit
    return StudyAxis(each.of, unit, "parameters", entries, *rest), []


def _allowed(machine: AnyMachine, word: str, i: int, unit: str) -> Quantity:
    """What a coordinate may be: of a joint within its limits."""
    most = COORDINATE[unit].high
    low, high = machine.limits[i] if word == "posture" else (-most, most)
    return Quantity(unit, low=max(low, -most), high=min(high, most))


def _checked(field: str, each: Vary, allowed: Quantity, axis: StudyAxis) -> tuple[StudyAxis | None, list[Fault]]:
    """The axis, or which of its ends is outside."""
    try:
        for end in each.value or ():
            allowed(end)
    except ValueError as error:
        return None, [Fault(f"{field}.value", str(error), str(list(each.value or ())))]
    return axis, []


def _fixed_faults(study: Study, axes: Sequence[StudyAxis | None]) -> list[Fault]:
    """What is wrong with what does not vary, or with the axes together."""
    machine, faults = study.loaded_machine, list[Fault]()
    varied = {(axis.kind, axis.entries[0]) for axis in axes if axis is not None and axis.kind == "posture"}
    still = [joint for i, joint in enumerate(machine.joints) if ("posture", i) not in varied]
    known = all(axis is not None for axis in axes)
    if study.compute in ("measures", "outcome") and study.posture is None and still and known:
        sentence = (
            f"is needed, {len(machine.joints)} numbers: {', '.join(still)} of {', '.join(machine.joints)} do not vary"
        )
        faults.append(Fault("posture", sentence))
    for name, names, units in (
        ("posture", machine.joints, machine.joint_units), ("base", machine.base_coordinates, machine.base_units),
    ):  # fmt: skip
        try:
            if getattr(study, name) is not None:
                check_placement(
                    list(getattr(study, name)), names, units, what="held" if name == "posture" else "placed"
                )
        except ValueError as error:
            faults.append(Fault(name, str(error), str(list(getattr(study, name)))))
    valued = [axis for axis in axes if axis is not None and axis.kind == "parameters" and not axis.factor]
    for axis in valued:
        others = [b for b in axes if b is not None and b is not axis and b.kind == "parameters"]
        if any(set(axis.entries) & set(other.entries) for other in others):
            faults.append(Fault("vary", "concerns a parameter that another entry concerns, too", axis.name))
    if "epsilon_max" in study.kept and study.compute == "measures" and any(a and a.kind == "parameters" for a in axes):
        faults.append(Fault("quantities", "epsilon_max goes with the machine's own parameters: let none vary"))
    subject, loop = study.subject, study.loop or machine.loop
    feedback = loop and loop.feedback
    if study.compute == "outcome":
        faults += [] if loop is None else loop_faults(loop, machine, "loop.")
    elif isinstance(subject, Experiment):
        feedback = (loop_of_runs(subject) or subject.simulation).feedback
    if any(a and a.kind == "ki" for a in axes) and feedback != "pid":
        faults.append(Fault("vary (ki)", "needs a loop with feedback = 'pid'"))
    return faults + (_problem_faults(subject) if isinstance(subject, Problem) else [])


def _problem_faults(problem: Problem) -> list[Fault]:
    """What of a configuration problem a study has no place for."""
    faults = list[Fault]()
    if problem.target.kind != "end_point":
        faults.append(Fault("problem", "must have one end-point as its target", problem.name))
    if not isinstance(problem.selection.objective, str):
        faults.append(Fault("problem", "has an own Function as its objective, which no file holds"))
    if problem.constraints is not None and problem.constraints.own:
        faults.append(Fault("problem", "has own Functions among its constraints, which no file holds"))
    return faults
