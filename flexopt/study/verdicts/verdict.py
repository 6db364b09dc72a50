"""Does it pay to move, with my controller, on ground I do not know? The present place beside those chosen.

In: a configuration problem, of one target or several, or its answer, a loop, what is uncertain. Out: a `Verdict`: for
each place what the loop does over the uncertainty, nonlinear runs, the drive that it costs; a word by a stated rule.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any, TypeVar, Unpack, cast

import numpy as np

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Progress, TargetLike, Vector
from flexopt.foundation.boundary import Keywords, number, public, whole
from flexopt.foundation.control import Control
from flexopt.foundation.documents import provenance
from flexopt.foundation.plain import listed, shown
from flexopt.foundation.stages import Stages
from flexopt.loop.evaluation import swing_unit
from flexopt.loop.lag import lagged_modes
from flexopt.loop.outcome import falling
from flexopt.loop.settings import loop_settings
from flexopt.loop.spectrum import from_sample_to_sample
from flexopt.loop.standard_move import MOVE
from flexopt.loop.uncertain import FEW, SENSES, UncertainLoop, UncertaintyBox, matters_most
from flexopt.model import AnyMachine, Problem
from flexopt.model.beyond_limits import beyond_limits_told
from flexopt.model.choices import ALLOWED_GAIN, DELAY_MARGIN, SETTLING, SWING, asks_for_loop
from flexopt.model.constraints import AnyConstraints
from flexopt.model.loop import Loop, LoopLike, control_of, gain_ranges, under_control
from flexopt.model.problem import SelectionKeywords, SelectionOptions, judged_by
from flexopt.model.uncertainty import GROUND, RangesLike, Uncertainty
from flexopt.selection import Selection, SelectionProblem, select, solve_problem, solve_selection
from flexopt.selection.broken import cornerless
from flexopt.selection.outcomes.result import ChosenByLoop
from flexopt.selection.problem import elsewhere, reached, with_angles
from flexopt.selection.several import BasePlan, Stand
from flexopt.study.asked import any_problem
from flexopt.study.verdicts.broken_places import Breaks, breaks_of, broken_at_rest, broken_by_loop
from flexopt.study.verdicts.changed_gains import ChangedGains, GainChange, doubt_of
from flexopt.study.verdicts.confirmation import INTEGRAL, Runs
from flexopt.study.verdicts.decision import (
    BETTER,
    MOST,
    Decision,
    Place,
    Word,
    decide,
    deciding,
    may_stay,
    percent,
    ranked,
    spoken,
)
from flexopt.study.verdicts.gain_search import tried_gains
from flexopt.study.verdicts.kept_gains import gains_kept
from flexopt.study.verdicts.place_loops import (
    Chosen,
    Configurations,
    PlaceLoops,
    Slowest,
    besides_driving,
    chosen_gains,
    configurations_of,
    drive_to,
    problems_of,
    resting_at,
    unreached,
)
from flexopt.study.verdicts.place_verdict import Band, PlaceVerdict
from flexopt.study.verdicts.places import FIRST, NEW_GAINS, STAY
from flexopt.study.verdicts.result import Verdict
from flexopt.study.verdicts.told_places import first_places, overlooked, shares_better, with_barring

# Members that decays are computed of, and nonlinear runs.
MEMBERS, RUNS = 64, 16
# How many points and runs a verdict may take.
SIZES = {"members": whole(2, 100_000), "runs": whole(0, 100_000)}
# Choosing places, decays there, runs, gains, and what the loop does in each place.
STAGES = 5
# With these words the machine keeps its place and its gains for now.
KEPT: tuple[Word, ...] = ("stay", "cannot tell")
UNPLACED = Fault("base", "is needed: where the machine stands now, from which it may pay to move")
T = TypeVar("T")


def _judged(arguments: Arguments, field: str, value: Any) -> Any:
    """A problem as for a report, its answer, or a machine."""
    if isinstance(value, AnyMachine):
        arguments.of = value
    elif isinstance(value, Selection | Stand | BasePlan):
        arguments.of = problems_of(value)[0].machine
    else:
        return any_problem(arguments, field, value)
    return value


_KEYWORDS = Keywords(SelectionOptions, SelectionKeywords, together=True)


@public(
    problem=_judged,
    members=SIZES["members"],
    runs=SIZES["runs"],
    duration=number("s", above=0.0, high=1e4),
    keywords=_KEYWORDS,
)
def verdict(
    problem: Problem | SelectionProblem | Selection | Stand | BasePlan | AnyMachine,
    target: TargetLike | None = None,
    *,
    constraints: AnyConstraints | None = None,
    loop: LoopLike | None = None,
    ranges: RangesLike | None = None,
    members: int = MEMBERS,
    runs: int = RUNS,
    duration: float | None = None,
    progress: Progress | None = None,
    options: SelectionOptions | None = None,  # noqa: ARG001 - its fields come as keywords
    **keywords: Unpack[SelectionKeywords],
) -> Verdict:
    """Whether it pays to move: the present place beside the best that were found, over what is uncertain.

    Of several targets every number is that of the worst one. Along a path each target's configuration is judged as if
    the machine stood in it: candidate 1 is the way, candidate 2 the best placement that stands still.

    Args:
        problem: from `flexopt.load_problem` or `flexopt.build_selection`, with the present placement as `base`; an
            answer of `flexopt.select`, `select_stand` or `plan_base`; or a machine, with a target.
        target, constraints, options, keywords: of a machine, as in `flexopt.build_selection`.
        loop: the real controller, as of `flexopt.evaluate`; by default the problem's or machine's `[loop]`, or where
            there is none what follows from the machine. It is the same in every place; what it leaves out follows from
            the present one. A choice by what the loop does, or with constraints on that, is by this loop, and by these
            `ranges`; an answer was chosen before.
        ranges: what is uncertain: a table from names to (lower, upper), of `"stiffness"` and `"damping"` factors of all
            springs or dampers of passive coordinates, of `"dead_time"` s, of parameters in their own unit; or
            `flexopt.Uncertainty`s. By default the problem's or machine's `[[uncertainty]]`, or where there is none one
            factor ½ to 2 of all springs.
        members: how many points of the uncertainty decays are computed of; all corners of up to six ranges at least.
        runs: how many of them are run nonlinearly in each place, too; 0 for none, which then need not confirm.
        duration: of a run, s; by default 20, in a place where that is longer ten periods of the slowest mode, ten
            minutes or 300,000 samples at most, and five time constants of the loop's slowest motion, where a minute
            holds them.
        progress: called with the percentage done and 100: a fifth each for places, decays, runs, other gains, and
            what the loop does in each place.

    Raises:
        InputError: arguments are not usable; the problem has no present placement.
        UnreachableTarget, NoSolutionFound: as `flexopt.select`.

    Example:
        >>> machine = flexopt.load("excavator")
        >>> loop = {"kp": 1e4, "kv": 1e3}
        >>> few = {"starts": 4, "members": 4, "runs": 1, "duration": 5.0}  # quick; leave them out
        >>> answer = flexopt.verdict(machine, (0.0, 1.6), base=0.0, loop=loop, **few)
        >>> answer.word
        'move'
    """
    stages = Stages(progress, STAGES, 100 // STAGES)
    chosen = _chosen(problem, {"target": target, "constraints": constraints, **keywords}, loop, ranges, stages.within)
    solved = problems_of(chosen)[0]
    machine, now = solved.machine, solved.present_base
    if now is None:
        raise_if_any(InputError, "verdict", [UNPLACED])
    asked, uncertain = _real(problem, chosen, loop, ranges)
    stages.next()
    stands = configurations_of(chosen)
    settings = loop_settings(machine, asked, next(iter(stands.values()))[0], gravity=solved.gravity).with_chosen({
        name: gain for name, gain in chosen_gains(chosen).items() if getattr(asked, name) is None
    })  # fmt: skip
    box = UncertaintyBox(machine, uncertain, settings.dead_time)
    raise_if_any(InputError, "verdict", box.faults(settings.rate))
    points = box.members(members, solved.seed, runs)
    loops = {name: PlaceLoops.at(settings, stand, box, gravity=solved.gravity) for name, stand in stands.items()}
    each = _each(loops, lambda name: loops[name].decays(points), lambda done, of: stages.within(done, 2 * of))
    decays: dict[str, Vector] = {name: own.min(axis=0) for name, own in each.items()}
    others = [name for name in ranked(decays) if name != STAY]
    held = {name: [(each.base, each.posture) for each in stand] for name, stand in stands.items()}

    @cache
    def search(name: str) -> Slowest:
        return loops[name].slowest(points, each[name])

    breaks = with_barring(
        {name: breaks_of(chosen, loops[name], at) for name, at in held.items()},
        lambda name: decays[name].min() > 0 and search(name).decay > 0,
        lambda name: name != STAY or not any(map(elsewhere, problems_of(chosen), map(np.concatenate, held[name]))),
    )
    fit = [name for name, broken in breaks.items() if not broken.barring]
    told = list(dict.fromkeys(name for name in (STAY, *first_places(
        [name for name in others if name in fit] or others, decays, lambda name: search(name).decay
    ), FIRST) if name in stands))  # fmt: skip
    shares = shares_better(decays)
    fit_shares = {name: share for name, share in shares.items() if name in fit}
    told += overlooked(fit_shares, [name for name in told if name in fit])
    slowest = _each(told, search, lambda done, of: stages.within(of + done, 2 * of))
    drives = {name: drive_to(stand, cast(Vector, now)) for name, stand in stands.items()}
    stages.next()
    shown = _each(
        told if runs else [],
        lambda name: loops[name].runs(points[:runs], each[name][:, :runs], duration),
        stages.within,
    )
    stages.next()
    every = {
        name: Place(name, decays[name], slowest[name].decay, drives[name][0],
                    besides_driving(solved, drives[name][1], stands[name]), drives[name][1],
                    slowest[name].decay <= falling(settings.rate))
        for name in told
    }  # fmt: skip
    known = {name: place for name, place in every.items() if name in fit}
    absent = _breaking(chosen, breaks[STAY], held[STAY], every[STAY]) if STAY in every else unreached(chosen)
    stay, rest = known.get(STAY), [place for name, place in known.items() if name != STAY]
    doubts = {name: why for name, run in shown.items() if (why := doubt_of(run)) is not None}
    tried = tried_gains(asked) if known and _tries(asked, stay, rest, doubts) else ""
    sought = (
        GainChange(
            asked,
            known,
            loops,
            slowest,
            doubts,
            points,
            partial(_runs_of, points[:runs], duration),
            lambda name, loop: broken_by_loop(chosen, held[name], loop),
            lambda _, loop: _much_at_rest(chosen, loop),
        ).sought()
        if tried
        else None
    )
    changed = sought and sought.changed
    confirmed, refuted = (changed, None) if changed and changed.doubt is None else (None, changed)
    stages.next()
    decision = decide(
        stay, rest, confirmed and confirmed.place, doubts, tried=tried, refuted=refuted and refuted.place,
        doubt=(refuted and refuted.doubt) or "", gains=changed.in_words if changed else "",
        absent=absent,
        most=max(fit_shares.values(), default=0.0), barred=any(name not in fit for name in others),
        sought=_sought(chosen),
    )  # fmt: skip
    kept = gains_kept(gain_ranges(asked), sought, decision, known, doubts)
    barred = best_barred({name: shares[name] for name in others if STAY in fit and name not in fit}, breaks)
    decision = with_barred(_with_alternates(_of_gains(decision, confirmed), loops, slowest), barred, breaks)
    # What a sentence names has its row.
    told += [name for _, name, _ in barred if name not in told and decision.word in KEPT]
    decision = _with_present(decision, absent if stay is None else "", chosen, held.get(STAY))
    new = confirmed if decision.word == "change gains" else None
    bands = _each([*told, *[NEW_GAINS] * bool(new)], lambda name: _with_gains(
        new, stands, points, drives, chosen,
    ) if new and name == NEW_GAINS else _place(
        name, stands[name], loops[name], points, decays[name], shares.get(name, math.nan), search(name), drives[name],
        shown.get(name) or _runs_of(points[:runs], duration, loops[name]), chosen,
        # `present_breaks` tells what staying does not do with the present loop.
        breaks[name]._replace(by_loop="") if name == STAY else breaks[name],
    ), stages.within)  # fmt: skip
    stages.next()
    return Verdict(
        word=decision.word,
        place=decision.place,
        reason=decision.reason,
        passed_over=decision.passed_over,
        gains_kept=kept,
        measure=_measure(decision, box, points, known, stay, bands, breaks)
        if decision.word == "cannot tell" and known and decision.place in {"", *known}
        else "",
        gains=new.gains if new else {},
        with_gains=bands.pop(NEW_GAINS, None),
        places=tuple(bands.values()),
        settings=settings,
        uncertainty=uncertain,
        assumes_ground=uncertain is GROUND,
        members=len(points),
        judged=len(others),
        selection=chosen,
        provenance=provenance(
            machine,
            members=members,
            runs=runs,
            duration=duration,
            gain_ranges=gain_ranges(asked),
            selection=chosen.provenance["options"],
        ),
        exclusions={name: breaks[name].told for name in stands if name not in fit},
        present_breaks=breaks[STAY].now if STAY in breaks else "",
        name=problem.name if isinstance(problem, Problem) else "",
    )


def _much_at_rest(chosen: Chosen, place: PlaceLoops) -> str:
    """What a place breaks at rest beside its target; empty where that is hardly anything."""
    told, hardly = broken_at_rest(chosen, place)
    return "" if hardly else told


def _sought(chosen: Chosen) -> str:
    """By what places were sought, and where of all that is uncertain, within a sentence."""
    everywhere = isinstance(chosen, ChosenByLoop) and len(chosen.uncertainty)
    return f"{chosen.objective}{' in the worst case' * bool(everywhere)}"


def _each(names: Collection[str], work: Callable[[str], T], tell: Progress) -> dict[str, T]:
    """What `work` makes of each name, and how many are done."""
    made = dict[str, T]()
    for name in names:
        made[name] = work(name)
        tell(len(made), len(names))
    return made


def _breaking(chosen: Chosen, breaks: Breaks, now: Sequence[tuple[Vector, Vector]], stay: Place) -> str:
    """That the present place breaks constraints, now or on some ground, and in which posture where none was given.

    And that it is not stable where it is not.
    """
    problem, *others = problems_of(chosen)
    given = not others and problem.present_posture is not None
    if others:
        how = "as breaks the least and is best of these" if breaks.now else "as is best"
        held = f", held {how} by {chosen.objective} at each target,"
    else:
        how = _beside_target(problem, now) if given else "in one of the postures that reach the target"
        held = f", {how}," if how else ""
    # With the file's numbers that is known.
    others_may = "; in other postures it may keep that" * (not breaks.now and not given)
    return f"the present place{held} {breaks.now or breaks.otherwise}{others_may}{stay.grows_told}"


def _beside_target(problem: SelectionProblem, held: Sequence[tuple[Vector, Vector]]) -> str:
    """How far the end-point is off the target of one problem, within a sentence; empty where it is there."""
    z = np.concatenate(next(iter(held)))
    off = float(np.linalg.norm(reached(problem, z) - problem.target))
    return f"the end-point {off:.3g} m off its target{with_angles(problem.machine)}" if elsewhere(problem, z) else ""


def _of_gains(decision: Decision, confirmed: ChangedGains | None) -> Decision:
    """The decision to change gains, with what else is to be known of these."""
    if confirmed is None or decision.word != "change gains":
        return decision
    reason = "; ".join(filter(None, (decision.reason, confirmed.at_end, confirmed.staying)))
    return replace(decision, reason=reason, passed_over=confirmed.passed_over)


def _with_present(
    decision: Decision, absent: str, chosen: Chosen, held: Sequence[tuple[Vector, Vector]] | None
) -> Decision:
    """The decision, with why there is no staying, or that staying is judged beside the target."""
    if absent:
        return decision if decision.word == "move" else replace(decision, reason=f"{absent}; {decision.reason}")
    problem, *others = problems_of(chosen)
    beside = "" if held is None or others else _beside_target(problem, held)
    if not beside:
        return decision
    beside = f"staying is judged as the arm is held now, {beside}"
    return replace(decision, reason=f"{decision.reason}; {beside}; without a posture it is judged at the target")


def best_barred(shares: Mapping[str, float], breaks: Mapping[str, Breaks]) -> list[tuple[str, str, float]]:
    """The best of the places that break constraints on some ground, and of those that do so at rest alone.

    Kind, name and share of the grounds on which it is better than the present place, where these are many.

    Args:
        shares: of places that are none to go to.
        breaks: what each place breaks, and by which of it it is none.
    """
    found = list[tuple[str, str, float]]()
    for kind in ("somewhere", "at_rest"):
        of_kind = {name: share for name, share in shares.items() if breaks[name].barring == kind}
        name = max(of_kind, key=lambda each: of_kind[each], default="")
        found += [(kind, name, of_kind[name])] if name and of_kind[name] > 1 - MOST else []
    return found


def with_barred(decision: Decision, barred: Sequence[tuple[str, str, float]], breaks: Mapping[str, Breaks]) -> Decision:
    """The decision to stay, or that it cannot be told, with the places of `best_barred`.

    Where one that breaks constraints at rest beside its target alone is better on many grounds it cannot be told
    whether to stay: no choice seeks places that keep them there.
    """
    for kind, name, share in barred if decision.word in KEPT else ():
        better, broken = f"{name} {BETTER} on {percent(share)} of the grounds, but", breaks[name].at_rest
        if kind == "somewhere":
            told = f"{better} breaks constraints on some: constraints.within seeks places that keep them there"
        else:
            told = f"{better} at rest beside its target {broken}: {INTEGRAL}, a higher Kp brings it nearer"
        if kind == "at_rest" and decision.word == "stay":
            decision = Decision("cannot tell", name, f"{told}; {decision.reason}")
        else:
            decision = replace(decision, reason=f"{decision.reason}; {told}")
    return decision


def _runs_of(members: Vector, duration: float | None, loop: PlaceLoops) -> Runs | None:
    return loop.runs(members, loop.decays(members), duration) if len(members) else None


def _chosen(problem: Any, asked: dict[str, Any], loop: Any, ranges: Any, progress: Progress) -> Chosen:
    """The problem's answer, or that of a machine with a target; what is sought of the loop is sought of the one judged.

    `asked`: target, constraints and options of a machine.
    """
    given = {name: value for name, value in asked.items() if value is not None}
    if isinstance(problem, AnyMachine):
        missing = [Fault("target", "is needed of a machine")] if "target" not in given else []
        # Before places are sought, which takes its time.
        if problem.base_coordinates and "base" not in given and "options" not in given:
            missing.append(UNPLACED)
        raise_if_any(InputError, "verdict", missing)
        given["control"] = control_of(given.get("control"), loop, problem)
        _judging(loop, problem, given["control"])
        if asks_for_loop(given.get("objective"), given.get("constraints")):
            given |= {"loop": loop, "ranges": ranges}
        return select(problem, **given, progress=progress)
    sentence = "goes with a machine; the problem brings its own"
    faults = [Fault(name, sentence, shown(value)) for name, value in given.items()]
    raise_if_any(InputError, "verdict", faults)
    if isinstance(problem, SelectionProblem):
        raise_if_any(InputError, "verdict", [UNPLACED] if problem.present_base is None else [])
        _judging(loop, problem.machine, problem.control)
        return solve_selection(problem, progress=progress)
    if isinstance(problem, Problem):
        placed = problem.selection.base is not None or not problem.loaded_machine.base_coordinates
        raise_if_any(InputError, "verdict", [] if placed else [UNPLACED])
        real = judged_by(problem, loop, ranges)
        _judging(real.loop, real.loaded_machine, real.select_arguments()["control"])
        return solve_problem(real, progress=progress)
    return cast(Chosen, problem)


def _judging(loop: Loop | None, machine: AnyMachine, control: Control) -> Loop:
    """The loop that judges, by default the machine's, with the control of the choice; refused where it has another."""
    return under_control(loop or machine.loop or Loop(), machine, control, "verdict")


def _real(problem: Any, chosen: Chosen, loop: Any, ranges: Any) -> tuple[Loop, tuple[Uncertainty, ...]]:
    """The loop with the problem's control, and what is uncertain; both from where they are first given."""
    first = problems_of(chosen)[0]
    machine, control = first.machine, first.control
    own = _judging(loop or getattr(problem, "loop", None), machine, control)
    return own, ranges or getattr(problem, "uncertainty", None) or machine.uncertainty or GROUND


def _tries(asked: Loop, stay: Place | None, others: Sequence[Place], unconfirmed: Mapping[str, str]) -> bool:
    """Whether other gains are looked for: ranges are given, or one may not stay with these and has nowhere to move."""
    goes = may_stay(stay, unconfirmed) is not None or decide(stay, others, None, unconfirmed).word == "move"
    return bool(gain_ranges(asked)) or not goes


def _with_alternates(decision: Decision, loops: Mapping[str, PlaceLoops], slowest: Mapping[str, Slowest]) -> Decision:
    """The decision, with why the present loop grows where it changes its sign at every sample."""
    if decision.word not in ("change gains", "cannot tell"):
        return decision
    why = {name: told for name, at in slowest.items() if (told := _alternates(loops[name].loops[at.target], at))}
    if not why:
        return decision
    # In all places it has one cause, as a rule.
    where = "" if len(why) == len(slowest) else f" at {listed(map(spoken, why))}"
    told = f"with the present gains it grows{where} at {next(iter(why.values()))}"
    return replace(decision, reason=f"{decision.reason}; {told}")


def _alternates(loop: UncertainLoop, slowest: Slowest) -> str:
    """Why its slowest member changes its sign at every sample; empty where it does not."""
    slow = loop.outcome(slowest.member)
    why = from_sample_to_sample(slow.too_much, loop.settings.rate)
    return why and f"{slow.loop.frequency_hz:.4g} Hz{why}"


def _with_gains(
    changed: ChangedGains,
    stands: Mapping[str, Configurations],
    points: Vector,
    drives: Mapping[str, tuple[float, float]],
    chosen: Chosen,
) -> PlaceVerdict:
    """The place with other gains, judged as the others are with the present ones."""
    loop, name = changed.loop, changed.place.name
    decays = loop.decays(points)
    slowest, worst = loop.slowest(points, decays), decays.min(axis=0)
    held = [(each.base, each.posture) for each in stands[name]]
    breaks = breaks_of(chosen, loop, held)
    return _place(
        name, stands[name], loop, points, worst, math.nan, slowest, drives[name], changed.runs, chosen, breaks
    )


def _place(
    name: str,
    stands: Configurations,
    place: PlaceLoops,
    points: Vector,
    decays: Vector,
    better: float,
    slowest: Slowest,
    drive: tuple[float, float],
    runs: Runs | None,
    chosen: Chosen,
    breaks: Breaks,
) -> PlaceVerdict:
    corners = place.box.corners(FEW)
    members = [None, *corners, slowest.member]
    looked = [[(loop.outcome(u), u) for u in members] for loop in place.loops]
    nominal = min(few[0][0].decay().value for few in looked)
    # Where ranges do not hold the file's own numbers, these are none of the worst.
    own = 0 if place.box.holds_nominal else 1
    held = [(each.base, each.posture) for each in stands]
    singly = np.unique(np.vstack([points[:MEMBERS], corners, slowest.member]), axis=0)

    def band(measure: str, factor: float = 1.0) -> Band:
        sense, each, further = SENSES[measure], list[list[float]](), list[float]()
        for loop, few in zip(place.loops, looked, strict=True):
            known = sense * float(
                np.min(sense * np.array([sense * math.inf, *further, *np.ravel([values[own:] for values in each])]))
            )
            values, more = loop.worst(measure, few[own:], points, slowest.member, known)
            each.append([*(getattr(at, measure)().value for at, _ in few[:own]), *values])
            further += [value for value, _ in more]
        # Of each member the worst target's; NaN where it is none: of a loop that grows there is no margin.
        told = sense * np.min(sense * np.array(each), axis=0)
        every = np.append(told[own:], further)
        ends = (every.min(), told[own:].max()) if sense > 0 else (told[own:].min(), every.max())
        return Band(*(factor * float(value) for value in (told[0], *ends)))

    return PlaceVerdict(
        name=name,
        base=_rows([each.base for each in stands]),
        posture=_rows([each.posture for each in stands]),
        w=_rows([each.w for each in stands]),
        drive=drive[0],
        turn=drive[1],
        decay=Band(nominal, slowest.decay, max([float(decays.max()), *([] if own else [nominal])])),
        stable_share=float(np.mean(decays > 0)),
        slowest_at=place.box.told(slowest.member),
        slowest_hz=looked[slowest.target][-1][0].loop.frequency_hz,
        slowest_target=slowest.target,
        **place.beside_decay(singly)._asdict(),
        better=better,
        allowed_gain=band(ALLOWED_GAIN),
        delay_margin=band(DELAY_MARGIN),
        settling=band(SETTLING),
        swing=band(SWING, factor=MOVE),
        swing_unit=swing_unit(looked[0][0][0]),
        runs=runs,
        unseen=_is_unseen(place.loops[slowest.target], slowest),
        self_motion=looked[slowest.target][-1][0].loop.self_motion,
        rests_on=tuple(resting_at(chosen, place.settings, held)),
        breaking=breaks,
        beyond_limits=beyond_limits_told(place.box.machine, spoken(name), [posture for _, posture in held]),
        cornerless=cornerless(problems_of(chosen)[0]),
    )


def _is_unseen(loop: UncertainLoop, slowest: Slowest) -> bool:
    """Whether the slowest motion is a mode that neither moves the end-point nor is excited by it, whatever the loop."""
    point = loop.outcome(slowest.member)
    return lagged_modes(point.motions).is_unseen(point.numbers, slowest.decay, point.loop.rounding)


def _rows(each: Sequence[Vector]) -> Vector:
    """Of one target the numbers themselves, of several a row for each."""
    return each[0] if len(each) == 1 else np.array(each)


def _measure(
    decision: Decision, box: UncertaintyBox, points: Vector, known: Mapping[str, Place], stay: Place | None,
    bands: Mapping[str, PlaceVerdict], breaks: Mapping[str, Breaks],
) -> str:  # fmt: skip
    """Which uncertain number decides."""
    if not decision.place and all((place.decays <= 0).all() for place in known.values()):
        what = "the least" if any(breaks[name].told for name in known) else "nothing"
        others = f" that breaks {what}" * (len(bands) > len(known))
        grows = f"every place{others} grows on all {len(points)} grounds looked at"
        name = max(known, key=lambda name: bands[name].decay.nominal)
        if box.holds_nominal and (nominal := bands[name].decay.nominal) > 0:
            file = f"with the numbers of the file {spoken(name)} decays at {nominal:.3g}/s"
            return f"to tell, measure {listed(box.names)}: {file}, though with others {grows}"
        return f"nothing to measure: with the present gains {grows}"
    what, values = deciding(decision, known, stay)
    if len(box.names) == 1 and values.min() < 0 < values.max():
        return f"to tell, measure {box.names[0]}, of which alone {what} depends"
    # What has one sign everywhere no measurement changes.
    which, rank = matters_most(box, points, values.tolist()) if values.min() < 0 < values.max() else ("", 0.0)
    if which:
        return f"to tell, measure {which}: {what} goes with it (rank correlation {rank:+.2f})"
    if not rank:
        return ""
    less, more = points[values < 0], points[values > 0]
    parts = np.flatnonzero((less.min(axis=0) > more.max(axis=0)) | (more.min(axis=0) > less.max(axis=0)))
    if parts.size == 1:
        name = box.names[int(parts[0])]
        return f"to tell, measure {name}, which alone parts the {len(points)} grounds looked at by {what}"
    seen = f"on the {len(points)} grounds looked at {what} is not seen to follow one of the uncertain numbers alone"
    few = f"; on as many as the usual {MEMBERS} members it may be" * (len(points) < MEMBERS)
    return f"no single measurement is seen to tell: {seen}{few}"
