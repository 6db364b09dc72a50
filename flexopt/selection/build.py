"""From arguments to a configuration problem: everything checked, bounds and scales set, the redundancy looked at."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple, Unpack, cast

import numpy as np

from flexopt.errors import Fault, ImplausibleMachine, InputError, UnreachableTarget, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Interval, TargetLike, Vector
from flexopt.foundation.boundary import Keywords, public
from flexopt.foundation.control import control_damping
from flexopt.foundation.coordinates import turned_into
from flexopt.foundation.warned import warn_user
from flexopt.model import AnyMachine
from flexopt.model.choices import EVERYTHING, assumes
from flexopt.model.constraints import AnyConstraints, Constraints
from flexopt.model.loop import control_of
from flexopt.model.own import OBJECTIVES
from flexopt.model.plausibility import WITHIN, distant_ranges
from flexopt.model.problem import SelectionKeywords, SelectionOptions
from flexopt.plant import Plant, build_plant
from flexopt.plant.inverse_kinematics import SAMPLES, low_discrepancy
from flexopt.plant.reach import arm_length, clipped, missed, outer_reach, reach, sampled_ranges, unreachable
from flexopt.plant.singularity import unmoved_told
from flexopt.plant.statics import not_held
from flexopt.selection.assumed import assumed, standing
from flexopt.selection.constraints import build_constraints, constraint_faults
from flexopt.selection.constraints.kind import ScaledConstraint
from flexopt.selection.objective import (
    MARGIN,
    Objective,
    Quantities,
    own_constraints,
    quantities,
    read_objectives,
)
from flexopt.selection.places import placed
from flexopt.selection.problem import DecisionVariable, SelectionProblem, StartRegion, TravelCost
from flexopt.selection.scan import Scan, empty_scan, scan_redundancy
from flexopt.selection.starts import STARTS, sample_configurations, with_kept

Ranges = dict[str, tuple[float, float]]
FREE = (-math.inf, math.inf)
# The sample that scales come from.
FIRST_SEED = 0
# Points of it at which own Functions are looked at.
SEEN = 16
UNDEFINED = "is not a finite number at any configuration that reaches the target inside limits and margin"


class _Asked(NamedTuple):
    """What several arguments say together."""

    objectives: tuple[Objective, ...]
    own: tuple[tuple[Objective, float], ...]
    constraints: Constraints
    limits: Vector
    now: Vector | None


def ask(arguments: Arguments, given: Mapping[str, Any]) -> _Asked | None:
    """What the arguments of a selection say together; notes what does not fit."""
    machine = arguments.of
    if machine is None:
        return None
    base, posture = given["base"], given["posture"]
    if posture is not None and base is None and machine.base_coordinates and not arguments.faulty("base"):
        arguments.note("posture", "needs base, too: where the machine stands now", posture)
    objectives: tuple[Objective, ...] = ()
    if given["objective"] is not None:
        objectives = read_objectives(arguments, machine, given["objective"], given["weights"])
    gravity = given.get("gravity") is True
    constraints = given["constraints"] or Constraints()
    # What an options object leaves out is assumed; a distance to the limits asks for them, 0 as any.
    free = not assumes(given.get("assume") or EVERYTHING, "limits") and constraints.joint_margin is None
    margin = constraints.joint_margin or 0.0
    limits = np.tile(FREE, (len(machine.joints), 1)) if free else _joint_limits(arguments, machine, margin)
    asked = _suiting(arguments, machine, constraints, limits, gravity=gravity)
    own = own_constraints(arguments, machine, asked)
    return _Asked(objectives, own, asked, limits, _present(arguments, machine, asked, base, posture))


def only_notes(arguments: Arguments, given: Mapping[str, Any]) -> None:
    """Note what arguments of a selection do not fit together, and tell of numbers that are hardly meant."""
    read = ask(arguments, given)
    if read is not None and arguments.of is not None and not arguments.faults:
        for finding in distant_ranges(arguments.of, read.constraints.within or (), WITHIN):
            warn_user(str(finding), ImplausibleMachine)


@public("select", together=only_notes, keywords=Keywords(SelectionOptions, SelectionKeywords), objective=OBJECTIVES)
def build_selection(
    machine: AnyMachine,
    target: TargetLike,
    *,
    constraints: AnyConstraints | None = None,
    options: SelectionOptions | None = None,  # noqa: ARG001 - its fields come as keywords
    **keywords: Unpack[SelectionKeywords],
) -> SelectionProblem:
    """Set up the choice of placement and posture for a target of the end-point.

    Args:
        machine: from `flexopt.load`.
        target: a number for each row of the task (n_task,), m, inertial frame.
        constraints: what else a configuration must keep, in the layout of a problem file's table [constraints]; or a
            list of `casadi.Function`s, every entry of which is at least 0, of `flexopt.Constraint`s, and of that table.
        options: how to choose, see `SelectionOptions`;  keywords: its fields, in place of its: objective, weights,
            control, gravity, gain, base, posture, base_range, elbow, singularity_margin_deg, starts, seed, assume,
            slack.

    Raises:
        InputError: arguments of wrong shape, not finite or out of range, all in one message.
        UnreachableTarget: no placement in the range reaches the target inside limits and margin.

    Example:
        >>> problem = flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6), objective="w1")
        >>> [variable.name for variable in problem.variables]
        ['base.x', 'boom', 'stick']
    """
    point = cast(Vector, target)
    return build_one(machine, point, constraints, SelectionOptions.model_construct(**keywords), point[None, :])


def build_one(
    machine: AnyMachine,
    target: Vector,
    constraints: AnyConstraints | None,
    asked: SelectionOptions,
    targets: Vector,
) -> SelectionProblem:
    """As `build_selection`, for checked arguments: one of the `targets` (K, n_task) that are reached by one choice."""
    read = ask(Arguments("select", machine), vars(asked) | {"constraints": constraints})
    assert read is not None  # the machine is one
    objectives, own, kept, limits, travel_now = read
    names, units = machine.base_coordinates, machine.base_units
    # Checked, and so plain.
    posture, ranges = cast("Vector | None", asked.posture), cast(Ranges, asked.base_range or {})
    present, travel_now = (_faced(machine, placement, ranges) for placement in (asked.base, travel_now))
    ranged = frozenset(ranges)
    margin = math.radians(asked.singularity_margin_deg)

    control = control_of(asked.control, None, machine)
    functions = quantities(machine, control, asked.gravity, asked.gain)
    plant = functions.measures.plant
    # A damped control bears what is singular, its margin does not.
    if (control_damping(control) is None or margin > 0) and (never := unmoved_told(plant)):
        raise_if_any(InputError, "select", [Fault("machine", never, machine.name)])
    told = present if travel_now is None else travel_now[: len(names)]
    now = standing(plant, told)
    beside = assumed(plant, asked.assume, targets, kept, now, ranged, given=told is not None)
    rows = build_constraints(plant, kept, beside.ground, gravity=asked.gravity, limits=limits)
    constraint_set = rows if len(rows) else None
    ranges, sampled, intervals = _placements(plant, target, ranges, margin, now, beside.drive, gravity=asked.gravity)
    length = outer_reach(plant)[1]
    lengths = {"m": length or 1.0, "rad": 1.0}
    variables = [
        DecisionVariable(f"base.{name}", unit, *ranges[name], lengths[unit], ranged=name in ranged)
        for name, unit in zip(names, units, strict=True)
    ]
    variables += [
        DecisionVariable(name, unit, float(low), float(high), 1.0 if unit == "rad" else arm_length(plant))
        for name, unit, (low, high) in zip(machine.joints, machine.joint_units, limits, strict=True)
    ]
    bounds = [
        ScaledConstraint(f"target {row}", "m", value, value, length or 1.0)
        for row, value in zip(machine.task_rows, target.tolist(), strict=True)
    ]
    bounds.append(ScaledConstraint(MARGIN, "sin²", math.sin(margin) ** 2, math.inf, 1.0))
    bounds += rows.rows
    problem = SelectionProblem(
        machine=machine,
        target=target,
        objectives=(*(objective for objective, _ in own), *objectives),
        kept=tuple(least for _, least in own),
        slack=asked.slack,
        control=control,
        gravity=asked.gravity,
        gain=asked.gain,
        variables=tuple(variables),
        constraints=tuple(bounds),
        constraint_set=constraint_set,
        asked=kept,
        assumed=beside.named,
        travel=None if travel_now is None or kept.travel is None else TravelCost(kept.travel.cost, travel_now),
        objective_scales=(1.0,) * (len(own) + len(objectives)),
        scan=empty_scan(plant, reached=False),
        region=_region(machine, arm_length(plant), sampled, limits),
        # A machine that stands where it stands is there now.
        present_base=present if names else np.zeros(0),
        present_posture=posture,
        elbow=asked.elbow,
        singularity_margin=margin,
        starts=asked.starts,
        seed=asked.seed,
        bounding=len(own),
    )

    def looked(seed: int, areas: Constraints) -> tuple[Scan, float]:
        def moved() -> tuple[Scan, float]:
            return sample_configurations(replace(problem, seed=seed), asked.starts or STARTS, areas)

        if not plant.closed_form:
            return moved()
        sine_squared = math.sin(margin) ** 2
        scan = scan_redundancy(
            functions, target, intervals, objectives[0], sine_squared, limits, constraint_set, seed, areas
        )
        if scan.size or not (scan.reached or asked.gravity):
            return scan, 0.0
        # Narrow limits may lie between the points of a scan, and the border of the reach is another as the machine
        # sags: Newton steps lead into them.
        between, off = moved()
        sines = plant.singularity_sine_squared(between.base, between.posture, plant.parameter_values).full()
        if np.any(sines >= sine_squared):
            return between, off
        # What is reached with springs unloaded may not be as the machine sags.
        return replace(scan, reached=between.reached or (scan.reached and not asked.gravity)), off

    scan, off = looked(asked.seed, kept)
    if scan.size == 0:
        raise _nothing_found(functions, target, ranges, margin, scan, off)
    # What travel costs is in these units: no matter of chance, nor of areas that the machine may stand in.
    usual = scan if asked.seed == FIRST_SEED and not placed(kept) else looked(FIRST_SEED, Constraints())[0]
    usual = usual if usual.size else scan
    _confirm_own(functions, problem.objectives, usual)
    sizes = [_typical(functions, objective, usual) for objective in problem.objectives]
    sizes[: len(own)] = [max(size, abs(least)) for size, (_, least) in zip(sizes, own, strict=False)]
    problem = replace(problem, objective_scales=tuple(size or 1.0 for size in sizes))
    return replace(problem, scan=with_kept(problem, scan))


def _typical(functions: Quantities, objective: Objective, scan: Scan) -> float:
    """What V is divided by: typical Σ |∂V/∂w_i| |a_i||b_i|, and β; of own ones how much they vary, if that is more."""
    if objective.own is None:
        return float(np.median(objective.alpha @ scan.factor)) + objective.beta
    pulls = np.abs(functions.pulls(objective, scan.base, scan.posture)) * scan.factor
    values = functions.smooth(objective, scan.base, scan.posture, scan.w)
    values, sizes = values[np.isfinite(values)], pulls.sum(axis=0)
    if not values.size:
        return 0.0
    varies = float(np.median(np.abs(values - np.median(values))))
    return max(varies, float(np.median(sizes[np.isfinite(sizes)]))) or float(np.abs(values).max())


def _confirm_own(functions: Quantities, objectives: tuple[Objective, ...], scan: Scan) -> None:
    """Refuse own Functions that are no numbers anywhere, and those that bring wrong derivatives with them."""
    faults: list[Fault] = []
    for objective in objectives:
        if objective.own is not None:
            field = f"constraints ({objective.name})" if objective.bounds else "objective"
            values = functions.smooth(objective, scan.base, scan.posture, scan.w)
            wrong = functions.own(objective.own).wrong_slopes(scan.base[:, :SEEN], scan.posture[:, :SEEN])
            if not np.isfinite(values).any():
                wrong = UNDEFINED
            faults += [] if wrong is None else [Fault(field, wrong)]
    raise_if_any(InputError, "select", faults)


def _suiting(
    arguments: Arguments, machine: AnyMachine, asked: Constraints, limits: Vector, *, gravity: bool
) -> Constraints:
    """The constraints, as far as they suit the machine; faults go to `arguments`."""
    faults = constraint_faults(build_plant(machine), asked, gravity=gravity, limits=limits)
    if asked.outcome is not None:
        sentence = "is for flexopt.select, select_stand and plan_base, or flexopt select: it wants a loop"
        faults.append(Fault("outcome", sentence))
    arguments.faults += [Fault(f"constraints.{f.field}", f.sentence, f.value) for f in faults]
    return Constraints(travel=asked.travel, own=asked.own) if faults else asked


def _joint_limits(arguments: Arguments, machine: AnyMachine, joint_margin: float) -> Vector:
    """Limits (n, 2) with the margin taken off both ends."""
    limits = np.array(machine.limits).reshape(-1, 2) + np.array([joint_margin, -joint_margin])
    for name, unit, (low, high) in zip(machine.joints, machine.joint_units, machine.limits, strict=True):
        if high - low < 2 * joint_margin:
            sentence = f"leaves nothing of the joint {name}, whose limits are {low:g} to {high:g} {unit}"
            arguments.faults.append(Fault("constraints.joint_margin", sentence, f"{joint_margin:g}"))
    return limits


def _present(
    arguments: Arguments, machine: AnyMachine, asked: Constraints, base: Vector | None, posture: Vector | None
) -> Vector | None:
    """The configuration z that travel counts from: its own, else that of the call."""
    if asked.travel is None:
        return None
    where = "constraints.travel."
    if asked.travel.base is not None:
        base = arguments.base(machine, asked.travel.base, f"{where}base")
    if asked.travel.posture is not None:
        posture = arguments.posture(machine, asked.travel.posture, f"{where}posture")
    if base is None and not machine.base_coordinates:
        base = np.zeros(0)
    for name, value in (("base", base), ("posture", posture)):
        if value is None and not arguments.faulty(name):
            sentence = f"is required: the cost of travel counts from the present {name}; give it here, or as {name} "
            sentence += "of the call or of [selection]"
            arguments.faults.append(Fault(f"{where}{name}", sentence))
    return None if base is None or posture is None else np.concatenate([base, posture])


def _placements(
    plant: Plant,
    target: Vector,
    given: Ranges,
    margin: float,
    present: Vector | None,
    drive: float | None,
    *,
    gravity: bool,
) -> tuple[Ranges, Ranges, list[Interval]]:
    """Bounds of the placement coordinates, ranges to sample them in, and in the plane the parts that reach."""
    machine = plant.machine
    if plant.closed_form:
        annulus = reach(plant, margin)
        intervals = annulus.base_intervals(target)
        if not intervals and not gravity:
            raise unreachable(plant, target, None, margin=margin)
        # Beyond the margin's own ends, so that the margin and not the range is what stops the base.
        about = float(target[0] - annulus.center[0])
        whole = reach(plant).base_intervals(target) or [(about - annulus.outer, about + annulus.outer)]
        (name,) = machine.base_coordinates
        far = _sag(plant) if gravity else 0.0
        span, wider = (
            given.get(name, _driven((whole[0][0] - more, whole[-1][1] + more), present, 0, drive))
            for more in (0.0, far)
        )
        return {name: wider}, {name: span}, clipped(intervals, span)
    center, outer = outer_reach(plant)
    rows = machine.task_rows
    rise = float(target[rows.index("z")] - center[2]) if "z" in rows else 0.0
    if abs(rise) > outer and not gravity:
        off, side = abs(rise) - outer, "above" if rise > 0 else "below"
        why = f"it lies {off:.4g} m or more {side} what the arm reaches, stretched out, wherever the base stands"
        raise missed(plant, target, None, off, why)
    # The anchor is within this of the target, seen from above, however the base is turned.
    far = (math.sqrt(outer**2 - rise**2) if abs(rise) < outer else outer) + math.hypot(center[0], center[1])
    more = _sag(plant) if gravity else 0.0
    bounds, sampled = Ranges(), Ranges()
    for k, name in enumerate(machine.base_coordinates):
        if name == "yaw":
            bounds[name] = given.get(name, FREE)
            sampled[name] = given.get(name, (-math.pi, math.pi))
            continue
        about = float(target[rows.index(name)]) if name in rows else 0.0 if present is None else float(present[k])
        sampled[name] = given.get(name, _driven((about - far, about + far), present, k, drive))
        bounds[name] = given.get(name, _driven((about - far - more, about + far + more), present, k, drive))
    return bounds, sampled, []


def _sag(plant: Plant) -> float:
    """By how much more the base may have to move for its end-point to sag onto a target, m.

    Twice the most of a sample, at most the arm's length: postures at the border of the reach sag more than those of it.
    """
    length = arm_length(plant)
    low, high = sampled_ranges(plant.machine, length).T
    postures = low[:, None] + (high - low)[:, None] * low_discrepancy(plant.n_actuated, SAMPLES, FIRST_SEED)
    bases, p = np.zeros((plant.n_base, SAMPLES)), plant.parameter_values
    sagged = np.vstack([plant.deflected.call([bases, postures, p])[0].full(), postures])
    at_rest = plant.rest.call([bases, postures, p])[0].full()
    ends = [plant.end_point.call([q, bases, p])[0].full() for q in (at_rest, sagged)]
    # What falls over has no number.
    return min(2 * float(np.nan_to_num(np.linalg.norm(ends[1] - ends[0], axis=0)).max()), length)


def _faced(machine: AnyMachine, now: Any, ranges: Ranges) -> Vector | None:
    """A present placement, or configuration, told by the whole turns of its base that its ranges allow."""
    if now is None:
        return None
    n_base, ends = len(machine.base_coordinates), [ranges.get(name, FREE) for name in machine.base_coordinates]
    lower, upper = np.array(ends).reshape(-1, 2).T
    return np.append(turned_into(now[:n_base], (lower, upper), machine.base_units), now[n_base:])


def _driven(span: Interval, present: Vector | None, k: int, drive: float | None) -> Interval:
    """The part of a range of placement coordinate k that is no farther than `drive` from the present one."""
    if present is None or drive is None:
        return span
    return max(span[0], float(present[k]) - drive), min(span[1], float(present[k]) + drive)


def _region(machine: AnyMachine, length: float, sampled: Ranges, limits: Vector) -> StartRegion:
    """Where configurations are looked for; `limits` (n, 2) are those of the joints."""
    inside = np.clip(sampled_ranges(machine, length), limits[:, :1], limits[:, 1:])
    ranges = np.vstack([np.array([sampled[name] for name in machine.base_coordinates]).reshape(-1, 2), inside])
    return StartRegion(ranges[:, 0], ranges[:, 1])


def _nothing_found(
    functions: Quantities, target: Vector, ranges: Ranges, margin: float, scan: Scan, off: float
) -> Exception:
    """The error when no point of the redundancy was left."""
    plant = functions.measures.plant
    if scan.unsound or math.isinf(off):
        return not_held()
    if scan.undefined:
        return InputError(f"select: objective {UNDEFINED}", [Fault("objective", UNDEFINED)], "select")
    if not plant.closed_form:
        return missed(plant, target, None, off)
    sagging = off if functions.measures.gravity else None
    return _why_unreachable(plant, target, ranges[plant.machine.base_coordinates[0]], margin, scan.reached, sagging)


def _why_unreachable(
    plant: Plant,
    target: Vector,
    base_range: tuple[float, float],
    margin: float,
    reached: bool,
    sagging: float | None,
) -> UnreachableTarget:
    if reached:
        why = (
            "every posture that reaches it breaks a joint limit or comes closer than "
            f"{math.degrees(margin):.4g}° to a singular posture"
        )
        return unreachable(plant, target, None, why, margin, sagging)
    annulus = reach(plant, margin)
    nearest = min(
        (np.array([np.clip(x, *base_range)]) for span in annulus.base_intervals(target) for x in span),
        key=lambda b: annulus.miss(target, b),
        default=np.array([np.clip(target[0] - annulus.center[0], *base_range)]),
    )
    return unreachable(plant, target, nearest if sagging is None else None, margin=margin, sagging=sagging)
