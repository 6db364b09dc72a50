"""The places that a verdict compares: how the machine stands and is held at each target, and its loops there.

In: what was chosen, a loop, what is uncertain. Out: configurations by place, and what the loops of one place do: of
several targets the worst counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from flexopt.errors import NoSolutionFound, UnreachableTarget
from flexopt.foundation.arrays import Vector
from flexopt.loop.beside_decay import BesideDecay
from flexopt.loop.settings import LoopSettings
from flexopt.loop.uncertain import UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.plant.inverse_kinematics import told_once
from flexopt.robustness import Evaluation
from flexopt.selection import Selection, SelectionProblem
from flexopt.selection.broken import broken, resting
from flexopt.selection.continua import SAME_POSTURE, same, unwound, way_to
from flexopt.selection.nlp.program import single
from flexopt.selection.optima import finished
from flexopt.selection.outcomes.result import ChosenByLoop, OutcomeSelection
from flexopt.selection.places import FEASIBLE
from flexopt.selection.problem import elsewhere, value_at
from flexopt.selection.several import BasePlan, Stand
from flexopt.selection.several.by_loop import ByLoop
from flexopt.selection.several.outcome_stand import held_by_loop
from flexopt.selection.several.postures import Reached, reached_from, within_limits, without_constraints
from flexopt.selection.starts import apart, idle_joints, violated
from flexopt.study.verdicts.confirmation import Runs, long_enough, nonlinear_runs, of_all
from flexopt.study.verdicts.decision import LEAST_TOLD, UNREACHED
from flexopt.study.verdicts.places import STAY

Chosen = Selection | Stand | BasePlan
# One for each target, in order.
Configurations = tuple[Evaluation, ...]
# Members that decays are computed of.
MEMBERS = 64
# Candidates of which the best are told of.
LOOKED = 12
# So many times the usual number of postures is looked at where a placement is given.
FINER = 6
# From so many of these the objective is climbed.
CLIMBED = 16


class Slowest(NamedTuple):
    """The least decay found over the uncertainty, 1/s, the member u (k,), and the index of the target."""

    decay: float
    member: Vector
    target: int


@dataclass(frozen=True)
class PlaceLoops:
    """The loop in one place: one `UncertainLoop` for each of K targets, all with the same numbers.

    Attributes:
        loops: these.
        modes_hz: frequency of the base's slowest mode at each target.
    """

    loops: tuple[UncertainLoop, ...]
    modes_hz: tuple[float, ...]

    @classmethod
    def at(cls, settings: LoopSettings, stand: Configurations, box: UncertaintyBox, *, gravity: bool) -> PlaceLoops:
        """In this configuration at each target."""
        loops = tuple(UncertainLoop(settings, each.base, each.posture, gravity, box) for each in stand)
        return cls(loops, tuple(float(each.frequencies_hz.min()) for each in stand))

    @property
    def settings(self) -> LoopSettings:
        """Of the loop."""
        return self.loops[0].settings

    @property
    def box(self) -> UncertaintyBox:
        """What is not known."""
        return self.loops[0].box

    def with_settings(self, settings: LoopSettings) -> PlaceLoops:
        """The same with other gains."""
        return replace(self, loops=tuple(replace(loop, settings=settings) for loop in self.loops))

    def decays(self, members: Vector) -> Vector:
        """Of every member (n, k) at every target, 1/s, (K, n)."""
        return np.array([loop.decays(members) for loop in self.loops])

    def slowest(self, members: Vector, decays: Vector) -> Slowest:
        """The least decay found in the box: searched from the slowest members of each target, of decays (K, n)."""
        found = [loop.slowest(members, own) for loop, own in zip(self.loops, decays, strict=True)]
        first = min(range(len(found)), key=lambda k: found[k][0])
        return Slowest(*found[first], first)

    def beside_decay(self, members: Vector) -> BesideDecay:
        """What the members (n, k) do besides at the targets, the worst of them."""
        return BesideDecay.worst([BesideDecay.of(loop, members) for loop in self.loops])

    def runs(self, members: Vector, decays: Vector, duration: float | None) -> Runs:
        """Nonlinear runs of the members (n, k), with decays (K, n), s; of each the worst target's."""
        long = duration or long_enough(self.modes_hz, self.settings.rate, decays=decays.ravel().tolist())
        return of_all([nonlinear_runs(loop, members, own, long) for loop, own in zip(self.loops, decays, strict=True)])


def problems_of(chosen: Chosen) -> tuple[SelectionProblem, ...]:
    """The problem of each target."""
    return (chosen.problem,) if isinstance(chosen, Selection) else chosen.problems


def chosen_gains(chosen: Chosen) -> dict[str, float]:
    """Those that were chosen with the best configuration: the machine would have them."""
    if isinstance(chosen, OutcomeSelection):
        return dict(chosen.gains[0])
    return chosen.gains if isinstance(chosen, ByLoop) else {}


def resting_at(chosen: Chosen, settings: LoopSettings, stand: Sequence[tuple[Vector, Vector]]) -> list[tuple[str, ...]]:
    """Which bounds and constraints a place holds with equality, (base, posture) at each target."""
    pairs = zip(problems_of(chosen), map(np.concatenate, stand), strict=True)
    found = [tuple(resting(problem, z)) for problem, z in pairs]
    of_loop = chosen.loops_rest(settings, stand) if isinstance(chosen, ChosenByLoop) else [()] * len(found)
    return [(*own, *more) for own, more in zip(found, of_loop, strict=True)]


def configurations_of(chosen: Chosen) -> dict[str, Configurations]:
    """By place: the present one first, where every target is reached from it, then those that were found, best first.

    Of targets for one placement the candidates are the placements found, of a path the way along it and the best
    placement that stands still. One that stands as an earlier one does is no place of its own.
    """
    stay, again = _present(chosen), repeated(chosen)
    if isinstance(chosen, Selection):
        found = [(each.evaluation,) for each in chosen.candidates[:LOOKED]]
    else:
        problems, others = chosen.problems, list[Configurations]()
        now = problems[0].present_base
        if isinstance(chosen, Stand):
            more = zip(chosen.alternatives[: LOOKED - 1], chosen.alternative_postures, strict=False)
            others += [_evaluated(problems, [np.append(base, q) for q in each]) for (_, base), each in more]
        elif chosen.still is not None and not (now is not None and np.array_equal(chosen.still.base, now)):
            others.append(_evaluated(problems, [np.append(chosen.still.base, q) for q in chosen.still.posture]))
        found = [tuple(place.evaluation for place in chosen.places), *others]
    named = {name: each for k, each in enumerate(found, start=1) if (name := f"candidate {k}") not in again}
    return named if stay is None else {STAY: stay} | named


def repeated(chosen: Chosen) -> dict[str, str]:
    """Candidates that differ in their gains alone from an earlier one, and that one, by name."""
    if not isinstance(chosen, OutcomeSelection):
        return {}
    z, found = [each.z for each in chosen.candidates[:LOOKED]], dict[str, str]()
    for k, own in enumerate(z):
        first = next(i for i, other in enumerate(z) if same(chosen.problem, other, own))
        if first < k:
            found[f"candidate {k + 1}"] = f"candidate {first + 1}"
    return found


def found_in(chosen: Chosen) -> int:
    """How many candidates an answer has."""
    if isinstance(chosen, Selection):
        return len(chosen.candidates)
    return 1 + (len(chosen.alternatives) if isinstance(chosen, Stand) else chosen.still is not None)


def _present(chosen: Chosen) -> Configurations | None:
    if isinstance(chosen, Selection):
        problem, now = chosen.problem, chosen.initial
        # Held beside a target that is reached from nowhere there it is no staying, either.
        if now is None or (elsewhere(problem, now.z) and held_from([problem], now.base, allowed=False) is None):
            return None
        return (held_now(problem, now),)
    now = chosen.problems[0].present_base
    if now is None:
        return None
    by_loop = _best_by_loop(chosen, now) if isinstance(chosen, ByLoop) else None
    return by_loop or held_from(chosen.problems, now, allowed=False)


def held_at(stand: Stand, number: int) -> Evaluation | None:
    """How the arm is held at one target from the present placement; None where it is not reached, or there is none."""
    problem, now = stand.problems[number], stand.problems[number].present_base
    if now is None:
        return None
    by_loop = _best_by_loop(stand, now) if isinstance(stand, ByLoop) else None
    if by_loop is not None:
        return by_loop[number]
    found = held_from([problem], now, allowed=False)
    return None if found is None else found[0]


def _best_by_loop(chosen: ByLoop, base: Vector) -> Configurations | None:
    """How the arm is held at each target from one placement for the measure asked, with its loop there, if it is."""
    held = (_standing_at(problem, base) for problem in chosen.problems)
    problems = tuple(replace(problem, starts=problem.starts or CLIMBED) for problem in held)
    try:
        asked = replace(chosen.asked, loop=chosen.asked.present_settings(chosen.settings).fixed)
        found = held_by_loop(problems, base, asked)
    except (NoSolutionFound, UnreachableTarget):
        return None
    return _evaluated(chosen.problems, found)


def unreached(chosen: Chosen) -> str:
    """Why there is no staying: which targets are out of reach from the present placement."""
    problems = problems_of(chosen)
    now = problems[0].present_base
    if now is None or len(problems) == 1:
        return UNREACHED.format("the target")
    reach = [np.isfinite(_reached(_standing_at(problem, now)).violation).any() for problem in problems]
    off = [f"{k}" for k, reached in enumerate(reach, start=1) if not reached]
    several = f"targets {', '.join(off[:-1])} and {off[-1]}" if len(off) > 1 else "the targets"
    return UNREACHED.format(f"target {off[0]}" if len(off) == 1 else several)


def held_now(problem: SelectionProblem, now: Evaluation) -> Evaluation:
    """How the arm is held now: where nobody said so, and one way breaks something, an allowed one if any.

    So it does where it reaches below the ground that is assumed. Where the base stands is given.
    """
    if problem.present_posture is not None or not broken(_standing_at(problem, now.base), now.z):
        return now
    return (held_from([problem], now.base) or (now,))[0]


def held_otherwise(problem: SelectionProblem) -> bool:
    """Whether more than one posture reaches the target from where it stands now; of those that are allowed, if any."""
    now = problem.present_base
    if now is None:
        return False
    reached = _reached(_standing_at(problem, now))
    allowed = np.isfinite(reached.value[0])
    z = reached.z[:, 0, allowed if allowed.any() else np.isfinite(reached.violation[0])]
    # A roll of the tool that nothing depends on is no other posture.
    for each in z.T:
        each[idle_joints(problem, each, constrained=True)] = 0.0
    plant = problem.measures.plant
    postures = list(z[plant.n_base :].T)
    return len(told_once(plant, postures, problem.target, now, SAME_POSTURE, gravity=problem.gravity)) > 1


def held_from(problems: Sequence[SelectionProblem], base: Vector, *, allowed: bool = True) -> Configurations | None:
    """How the arm is held at each target from one placement (n_b,); None where one is not reached within the limits.

    The allowed posture with the greatest objective, or where none is allowed, and `allowed` is False, that with the
    greatest of those which break the constraints the least.
    """
    found = list[Vector]()
    for still in [_standing_at(problem, base) for problem in problems]:
        reached = _reached(still)
        worth, off = reached.value[0], reached.violation[0]
        if np.isfinite(worth).any():
            best = np.argsort(-worth, kind="stable")[: int(np.isfinite(worth).sum())]
            found.append(_best_held(still, reached.z[:, 0, best]))
        elif not allowed and np.isfinite(off).any():
            found.append(_least_broken(still, reached.z[:, 0], off))
        else:
            return None
    return _evaluated(problems, [unwound(problem, z) for problem, z in zip(problems, found, strict=True)])


def _reached(still: SelectionProblem) -> Reached:
    """Postures from the placement that a problem holds: any that are allowed, else those within the joints' limits."""
    base = still.lower[: still.measures.plant.n_base]
    reached = reached_from(still, base[:, None], still.seed, FINER)
    return reached if np.isfinite(reached.value).any() else within_limits(still, reached)


def _least_broken(still: SelectionProblem, z: Vector, off: Vector) -> Vector:
    """The best of postures z (n_z, N) that break the constraints the least, by `off` (N,), and of climbs from there."""
    bare, alike = without_constraints(still), np.flatnonzero(off <= off.min() + FEASIBLE)
    values = [value_at(bare, z[:, k]) for k in alike]
    best = z[:, alike[np.argsort(-np.nan_to_num(values, nan=-np.inf), kind="stable")]]
    climbed = _best_held(bare, best)
    return climbed if violated(still, climbed[:, None])[0] <= off.min() + FEASIBLE else best[:, 0]


def _best_held(still: SelectionProblem, z: Vector) -> Vector:
    """The best to which climbs lead from z (n_z, N), best first, the base held; z[:, 0] where none is better."""
    if still.measures.plant.n_actuated <= still.target.size:
        return z[:, 0]
    ends = [finished(single(still), start) for start in apart(still, z, CLIMBED, 1)]
    proven = [there for there, proof, *_ in ends if proof is not None and proof.holds]
    return max([z[:, 0], *proven], key=partial(value_at, still))


def _standing_at(problem: SelectionProblem, base: Vector) -> SelectionProblem:
    """The problem with its base held in a placement (n_b,)."""
    free = problem.variables
    held = [replace(each, lower=x, upper=x) for each, x in zip(free[: base.size], base.tolist(), strict=True)]
    return replace(problem, variables=(*held, *free[base.size :]))


def _evaluated(problems: Sequence[SelectionProblem], zs: Sequence[Vector]) -> Configurations:
    return tuple(problem.quantities.evaluated(z) for problem, z in zip(problems, zs, strict=True))


def drive_to(configurations: Configurations, now: Vector) -> tuple[float, float]:
    """How far the base goes from where it stands now (n_b,) to the first target's placement and on, m and rad."""
    names = configurations[0].base_coordinates
    length, turn = 0.0, 0.0
    for before, after in pairwise([now, *(each.base for each in configurations)]):
        away = dict(zip(names, (after - before).tolist(), strict=True))
        turn += abs(math.remainder(away.pop("yaw", 0.0), math.tau))
        length += math.hypot(*away.values())
    return length, turn


def besides_driving(problem: SelectionProblem, turn: float, there: Configurations) -> str:
    """What a move takes besides the drive, in words: the base's turn, rad, the largest turn and slide of a joint.

    Of the joints where it is known how the arm is held now, and of one target alone: postures at several are as far
    from each other as the targets.
    """
    told = [f"a turn of the base by {turn:.3g} rad"] if turn >= LEAST_TOLD else []
    if problem.present_posture is None or len(there) != 1:
        return ", ".join(told)
    machine, away = problem.machine, way_to(problem, there[0].z)[there[0].base.size :].tolist()
    moved = [each for each in zip(machine.joints, machine.joint_units, away, strict=True) if abs(each[2]) >= LEAST_TOLD]
    units = dict.fromkeys(unit for _, unit, _ in moved)
    # A turn is not to be compared with a slide.
    most = [max((each for each in moved if each[1] == unit), key=lambda each: abs(each[2])) for unit in units]
    told += [f"{name} by {way:+.3g} {unit}" for name, unit, way in most]
    return ", ".join([*told, *["other joints less"] * (len(moved) > len(most))])
