"""Which constraints a place breaks: with the file's numbers, and where in what is uncertain.

In: what was chosen, how the machine stands and is held at each target, the box of what is uncertain. Out: sentences.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import product
from typing import Literal, NamedTuple

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.foundation.plain import listed
from flexopt.loop.uncertain import FEW
from flexopt.loop.uncertainty_box import CORNERED, UncertaintyBox
from flexopt.model.uncertainty import Uncertainty, parameters_of, told_numbers
from flexopt.selection import SelectionProblem
from flexopt.selection.broken import broken, broken_held, broken_names, values_with
from flexopt.selection.constraint_values import ConstraintValue
from flexopt.selection.constraints.corners import WHERE, within_faults
from flexopt.selection.held import held_with
from flexopt.selection.outcomes.result import ChosenByLoop
from flexopt.selection.problem import own_with, rows_with
from flexopt.study.verdicts.decision import HARDLY
from flexopt.study.verdicts.place_loops import Chosen, PlaceLoops, problems_of

# A constraint is broken by about as much where by this share.
AS_MUCH = 0.99
# What moves constraints by less, of their scale, does not matter to them.
MOVED = 1e-9
# How many times what the intervals take of a constraint's room one by one they may take together.
TOGETHER = 2.0


class Breaks(NamedTuple):
    """What a place breaks of constraints, "breaks …", or nothing.

    Attributes:
        standing: of those that were asked for, with the file's numbers, of the configuration; candidates keep these.
        by_loop: what the loop that is judged does not do of what it must at least.
        somewhere: at corners of what is uncertain.
        at_rest: where feedback holds the end-point beside its target.
        barring: by which of these it is none to go to or to stay at; see `with_barring`.
        hardly: which of `somewhere` and `at_rest` it breaks by `HARDLY` at most, all of it: that is told, and bars
            nothing.
        sought: whether `constraints.within` seeks places that keep `somewhere`: not so constraints of the user's own,
            nor what is broken by numbers that move the end-point.
    """

    standing: str = ""
    by_loop: str = ""
    somewhere: str = ""
    at_rest: str = ""
    barring: str = ""
    hardly: frozenset[str] = frozenset()
    sought: Literal["all", "some", "none"] = "all"

    @property
    def now(self) -> str:
        """Without what is uncertain."""
        return "; ".join(filter(None, (self.standing, self.by_loop)))

    @property
    def otherwise(self) -> str:
        """With other numbers than the file's, within a sentence."""
        return "; ".join(filter(None, (self.somewhere, self.at_rest and f"at rest beside its target {self.at_rest}")))

    @property
    def much(self) -> str:
        """Of `by_loop` and `somewhere` what is more than hardly broken, within a sentence."""
        return "; ".join(filter(None, (self.by_loop, self.somewhere * ("somewhere" not in self.hardly))))

    @property
    def told(self) -> str:
        """All, within a sentence."""
        return "; ".join(filter(None, (self.now, self.otherwise)))


def breaks_of(chosen: Chosen, place: PlaceLoops, stand: Sequence[tuple[Vector, Vector]]) -> Breaks:
    """What a place breaks of what was asked for, (base, posture) at each target."""
    somewhere, hardly_somewhere, sought = broken_within(chosen, stand, place.box)
    at_rest, hardly_at_rest = broken_at_rest(chosen, place)
    hardly = {"somewhere": hardly_somewhere, "at_rest": hardly_at_rest}
    return Breaks(
        broken_standing(chosen, stand),
        broken_by_loop(chosen, stand, place),
        somewhere,
        at_rest,
        hardly=frozenset(kind for kind, is_so in hardly.items() if is_so),
        sought=sought,
    )


def broken_standing(chosen: Chosen, stand: Sequence[tuple[Vector, Vector]]) -> str:
    """What of the configuration alone a place breaks with the file's numbers."""
    pairs = zip(problems_of(chosen), map(np.concatenate, stand), strict=True)
    return _at_targets([broken(problem, z, asked=True) for problem, z in pairs])


def broken_by_loop(chosen: Chosen, stand: Sequence[tuple[Vector, Vector]], place: PlaceLoops) -> str:
    """What a loop does not do of what it must at least; it may have other gains than a candidate was chosen with."""
    return _at_targets(chosen.loops_break(place.settings, stand)) if isinstance(chosen, ChosenByLoop) else ""


def broken_at_rest(chosen: Chosen, place: PlaceLoops) -> tuple[str, bool]:
    """Which constraints a place breaks where feedback holds it beside its target, and where most; whether `hardly`.

    Those that were asked for, and those that are assumed, as limits of joints are, and kept with the file's numbers. A
    load or springs that the controller does not know draw it there, of a loop without an integral part.
    """
    worst = dict[str, tuple[float, ConstraintValue, str]]()
    # What dampers do is nothing of a rest.
    damps = np.array(["damping" in each.name for each in place.box.machine.parameters])
    for problem, loop in zip(problems_of(chosen), place.loops, strict=True):
        # An integral part takes it to the target.
        if not loop.gravity or loop.settings.ki.all():
            continue
        # What is broken with the file's numbers is told as that.
        standing = broken_names(problem, np.append(loop.base, loop.posture))
        for u in loop.box.corners(FEW):
            point = loop.outcome(u)
            if not (point.rests and point.loop.growth_rate <= 0 and loop.off_target(point) > 0):
                continue
            posture, p = point.configuration[problem.measures.plant.n_passive :], loop.box.numbers(u)[0]
            for name, (off, value) in broken_held(problem, loop.base, posture, p).items():
                if name not in standing and off > worst.get(name, (0.0,))[0]:
                    worst[name] = (
                        off,
                        value,
                        told_numbers(loop.box.machine, np.where(damps, loop.box.nominal, p).tolist()),
                    )
    if not worst:
        return "", False
    name, (_, value, where) = max(worst.items(), key=lambda each: each[1][0])
    more = f", and {len(worst) - 1} more" if len(worst) > 1 else ""
    hardly = all(value.beyond_allowed <= HARDLY for _, value, _ in worst.values())
    return f"breaks {name}, {value},{WHERE}{where}{more}", hardly


def _at_targets(each: Sequence[str]) -> str:
    if len(each) == 1:
        return each[0]
    return "; ".join(f"at target {k} {sentence}" for k, sentence in enumerate(each, start=1) if sentence)


def broken_within(
    chosen: Chosen, stand: Sequence[tuple[Vector, Vector]], box: UncertaintyBox
) -> tuple[str, bool, Literal["all", "some", "none"]]:
    """Which constraints a place keeps with the file's numbers and breaks at a corner; whether `hardly`, `sought`.

    Those that were asked for, and those that are assumed.
    Each at the corner, of those looked at, at which it is broken most. Choices keep those of statics, as of what joints
    hold, and the user's own, with the file's payload.
    """
    found, hardly, sought = dict[str, dict[str, dict[int, ConstraintValue | None]]](), True, set[bool]()
    for k, (problem, at) in enumerate(zip(problems_of(chosen), stand, strict=True), start=1):
        z, worst = np.concatenate(at), dict[str, _Broken]()
        if broken_names(problem, z, asked=True):
            continue
        whole, unasked = _and_within(problem, box), _unasked_broken(problem, z)
        for theta in _corners(problem, z, whole):
            for each in (one for one in _broken_at(problem, z, whole, theta) if one.name not in unasked):
                worst[each.name] = max(worst.get(each.name, each), each, key=lambda one: one.off)
        hardly &= all(most.hardly for most in worst.values())
        for name, most in worst.items():
            plain = _plainest(problem, z, whole, most)
            sought.add(_is_sought(problem, whole, plain))
            where = told_numbers(box.machine, whole.numbers_at(plain.theta)[0].tolist())
            found.setdefault(where, {}).setdefault(name, {})[k] = plain.value
    told = list[str]()
    for where, names in found.items():
        each = [
            name
            + (f" at target {listed(map(str, at))}" if 1 < len(stand) > len(at) else "")
            + "".join(f", {value}" for value in sorted(filter(None, at.values()), key=lambda x: x.least_room)[:1])
            for name, at in names.items()
        ]
        told.append(f"breaks {'; '.join(each)},{WHERE}{where}")
    return "; ".join(told), bool(told) and hardly, "some" if len(sought) > 1 else "all" if all(sought) else "none"


def _is_sought(problem: SelectionProblem, box: UncertaintyBox, most: _Broken) -> bool:
    """Whether `constraints.within` of the numbers with which something is broken has it kept."""
    own = {row.name for row in problem.own_constraints}
    of = [each for each, other in zip(box.uncertainty, most.theta != _nearest(box), strict=True) if other]
    return most.name not in own and not within_faults(problem.measures.plant, of)


def _and_within(problem: SelectionProblem, box: UncertaintyBox) -> UncertaintyBox:
    """What is uncertain, and what the intervals of `constraints.within` have of other numbers."""
    uncertain, more = {entry for entries in box.entries for entry in entries}, list[Uncertainty]()
    for each in problem.asked.within or ():
        names = [box.machine.parameters[k].name for k in parameters_of(each.of, box.machine) if k not in uncertain]
        more += [each.model_copy(update={"of": tuple(names)})] if names else []
    return UncertaintyBox(box.machine, (*box.uncertainty, *more), box.nominal_dead_time)


def _unasked_broken(problem: SelectionProblem, z: Vector) -> set[str]:
    """What a place breaks with the file's numbers of what is assumed."""
    return {*broken_names(problem, z)} - {*broken_names(problem, z, asked=True)}


class _Broken(NamedTuple):
    """What is broken at factors and values θ, and its value; none of what is no constraint, as that it stands."""

    name: str
    theta: Vector
    value: ConstraintValue | None

    @property
    def off(self) -> float:
        return math.inf if self.value is None else -self.value.least_room

    @property
    def hardly(self) -> bool:
        return self.value is not None and self.value.beyond_allowed <= HARDLY


def _broken_at(problem: SelectionProblem, z: Vector, box: UncertaintyBox, theta: Vector) -> list[_Broken]:
    p = box.numbers_at(theta)[0]
    names = broken_names(problem, z, asked=True, p=p)
    values = values_with(problem, z, p) if names else {}
    return [_Broken(name, theta, values.get(name)) for name in names]


def _plainest(problem: SelectionProblem, z: Vector, box: UncertaintyBox, most: _Broken) -> _Broken:
    """As many numbers as near the file's own as the box has them that leave it broken by about as much."""
    near, least = _nearest(box), AS_MUCH * most.off
    for k in np.flatnonzero(most.theta != near).tolist():
        theta, own = most.theta.copy(), near[k]
        theta[k] = own
        alike = (each for each in _broken_at(problem, z, box, theta) if each.name == most.name)
        most = next((each for each in alike if each.off >= least), most)
    return most


def _nearest(box: UncertaintyBox) -> Vector:
    """Factors and values (k,) as near the file's own numbers as the box has them."""
    own = [1.0 if each.value is None else float(box.nominal[[*entries]].mean()) if entries else box.nominal_dead_time
           for each, entries in zip(box.uncertainty, box.entries, strict=True)]  # fmt: skip
    return np.clip(own, *np.array([each.value or each.factor for each in box.uncertainty]).T)


def _corners(problem: SelectionProblem, z: Vector, box: UncertaintyBox) -> Iterator[Vector]:
    """Factors and values (k,) at corners of the intervals that constraints depend on.

    All corners of up to six of these. Of more, all of the six that take the most room from those constraints that may
    break, and for each of these that to which its room falls in every interval by itself.
    """
    near = _nearest(box)
    ends = np.array([each.value or each.factor or () for each in box.uncertainty])
    middle = _rooms(problem, z, box, near)

    def at(numbers: dict[int, float]) -> Vector:
        theta = near.copy()
        theta[[*numbers]] = [*numbers.values()]
        return theta

    # (k, 2, n_rows)
    rooms = np.array([[_rooms(problem, z, box, at({i: end})) for end in pair] for i, pair in enumerate(ends.tolist())])
    moves = np.where(rooms == middle, 0.0, np.abs(rooms - middle)).max(axis=(1, 2), initial=0.0)
    chosen = np.flatnonzero(moves > MOVED)
    if chosen.size > CORNERED:
        taken = np.maximum(middle - rooms[chosen].min(axis=1), 0.0)
        may_break = np.flatnonzero(middle - TOGETHER * taken.sum(axis=0) < 0)
        worst = rooms[chosen].argmin(axis=1)[:, may_break]
        for own in np.unique(worst.T, axis=0):
            yield at({i: ends[i, end] for i, end in zip(chosen.tolist(), own.tolist(), strict=True)})
        most = taken[:, may_break].max(axis=1, initial=0.0)
        chosen = chosen[np.argsort(-most, kind="stable")[:CORNERED]]
    for numbers in product(*ends[chosen].tolist()):
        yield at(dict(zip(chosen.tolist(), numbers, strict=True)))


def _rooms(problem: SelectionProblem, z: Vector, box: UncertaintyBox, theta: Vector) -> Vector:
    """Of constraints, the target and corners of `constraints.within` aside, how far each is from its bounds, in scales.

    −1/ε of what is no number: below all others, and yet one to calculate with.
    """
    p, first, n_base = box.numbers_at(theta)[0], problem.target.size, problem.measures.plant.n_base
    joints = [each for each in problem.variables[n_base:] if math.isfinite(each.lower) or math.isfinite(each.upper)]
    rows = [*problem.constraints[first:], *problem.own_constraints, *joints]
    lower, upper, scale = (np.array([getattr(row, name) for row in rows]) for name in ("lower", "upper", "scale"))
    held = dict(zip(problem.machine.joints, held_with(problem.quantities, z, p)[1].tolist(), strict=True))
    turned = [held[each.name] for each in joints]
    values = np.concatenate([rows_with(problem, z, p)[first:], own_with(problem, z, p), turned])
    rooms = np.nan_to_num(np.minimum(values - lower, upper - values) / scale, nan=-1 / np.finfo(float).eps)
    return rooms[[not getattr(row, "corner", "") for row in rows]]
