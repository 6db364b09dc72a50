"""Does it pay to move, with my controller, on ground I do not know? The present place beside those chosen.

In: a configuration problem, of one target or several, or its answer, a loop, what is uncertain. Out: a `Verdict`: for
each place what the loop does over the uncertainty, nonlinear runs, the drive that it costs; a word by a stated rule.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cache, partial
from typing import TypeVar, Unpack, cast

import numpy as np

from flexopt.errors import InputError, raise_if_any
from flexopt.foundation.arrays import Progress, TargetLike, Vector
from flexopt.foundation.boundary import Keywords, number, public, whole
from flexopt.foundation.documents import provenance
from flexopt.foundation.stages import Stages
from flexopt.loop.loop_motions import falling
from flexopt.loop.settings import loop_settings
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model import AnyMachine, Problem
from flexopt.model.constraints import AnyConstraints
from flexopt.model.loop import Loop, LoopLike, gain_ranges
from flexopt.model.problem import SelectionKeywords, SelectionOptions
from flexopt.model.uncertainty import GROUND, RangesLike
from flexopt.selection import Selection, SelectionProblem
from flexopt.selection.problem import elsewhere
from flexopt.selection.several import BasePlan, Stand
from flexopt.study.verdicts.broken_places import breaks_of, broken_at_rest, broken_by_loop
from flexopt.study.verdicts.changed_gains import GainChange, doubt_of
from flexopt.study.verdicts.chosen import UNPLACED, chosen_by, judged_problem, loop_and_ranges
from flexopt.study.verdicts.confirmation import Runs
from flexopt.study.verdicts.decision import Place, decide, may_stay, ranked
from flexopt.study.verdicts.gain_search import tried_gains
from flexopt.study.verdicts.judged_place import judged_place, judged_with_gains
from flexopt.study.verdicts.kept_gains import gains_kept
from flexopt.study.verdicts.place_loops import (
    MEMBERS,
    Chosen,
    PlaceLoops,
    Slowest,
    besides_driving,
    chosen_gains,
    configurations_of,
    drive_to,
    problems_of,
    unreached,
)
from flexopt.study.verdicts.places import FIRST, NEW_GAINS, STAY
from flexopt.study.verdicts.reasons import (
    KEPT,
    best_barred,
    breaking_told,
    sought_by,
    to_measure,
    with_alternates,
    with_barred,
    with_new_gains,
    with_present,
)
from flexopt.study.verdicts.result import Verdict
from flexopt.study.verdicts.told_places import first_places, overlooked, shares_better, with_barring

# Nonlinear runs in each place.
RUNS = 16
# How many points and runs a verdict may take.
SIZES = {"members": whole(2, 100_000), "runs": whole(0, 100_000)}
# Choosing places, decays there, runs, gains, and what the loop does in each place.
STAGES = 5
T = TypeVar("T")
_KEYWORDS = Keywords(SelectionOptions, SelectionKeywords, together=True)


@public(
    problem=judged_problem,
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
    chosen = chosen_by(problem, {"target": target, "constraints": constraints, **keywords}, loop, ranges, stages.within)
    solved = problems_of(chosen)[0]
    machine, now = solved.machine, solved.present_base
    if now is None:
        raise_if_any(InputError, "verdict", [UNPLACED])
    asked, uncertain = loop_and_ranges(problem, chosen, loop, ranges)
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
    absent = breaking_told(chosen, breaks[STAY], held[STAY], every[STAY]) if STAY in every else unreached(chosen)
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
        sought=sought_by(chosen),
    )  # fmt: skip
    kept = gains_kept(asked, sought, decision, known, doubts)
    barred = best_barred({name: shares[name] for name in others if STAY in fit and name not in fit}, breaks)
    decision = with_barred(with_alternates(with_new_gains(decision, confirmed), loops, slowest), barred, breaks)
    # What a sentence names has its row.
    told += [name for _, name, _ in barred if name not in told and decision.word in KEPT]
    decision = with_present(decision, absent if stay is None else "", chosen, held.get(STAY))
    new = confirmed if decision.word == "change gains" else None
    bands = _each([*told, *[NEW_GAINS] * bool(new)], lambda name: judged_with_gains(
        new, stands, points, drives, chosen, decays.get(STAY),
    ) if new and name == NEW_GAINS else judged_place(
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
        measure=to_measure(decision, box, points, known, stay, bands, breaks)
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


def _each(names: Collection[str], work: Callable[[str], T], tell: Progress) -> dict[str, T]:
    """What `work` makes of each name, and how many are done."""
    made = dict[str, T]()
    for name in names:
        made[name] = work(name)
        tell(len(made), len(names))
    return made


def _runs_of(members: Vector, duration: float | None, loop: PlaceLoops) -> Runs | None:
    return loop.runs(members, loop.decays(members), duration) if len(members) else None


def _tries(asked: Loop, stay: Place | None, others: Sequence[Place], unconfirmed: Mapping[str, str]) -> bool:
    """Whether other gains are looked for: ranges are given, or one may not stay with these and has nowhere to move."""
    goes = may_stay(stay, unconfirmed) is not None or decide(stay, others, None, unconfirmed).word == "move"
    return bool(gain_ranges(asked)) or not goes
