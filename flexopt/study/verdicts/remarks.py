"""What is said below a verdict's numbers: of each place, and of the loop in all of them.

In: a `Verdict`. Out: sentences, the same in the text and on the page.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from flexopt.foundation.plain import listed
from flexopt.loop.evaluation import unseen_told
from flexopt.loop.loop_motions import NOWHERE_HELD, falling
from flexopt.loop.spectrum import OTHER_WEIGHT, driven_self_motion, mostly_self_motion
from flexopt.loop.standard_move import LONGEST, UNSETTLED
from flexopt.loop.uncertainty_box import member_in_words
from flexopt.selection.constraints.corners import WHERE
from flexopt.selection.problem import with_angles
from flexopt.study.verdicts.confirmation import INTEGRAL
from flexopt.study.verdicts.decision import BETWEEN, HARDLY, in_one, spoken, told_in, without_numbers
from flexopt.study.verdicts.drawbacks import NOT_WHERE_IT_GROWS, too_weak_told
from flexopt.study.verdicts.places import FALLS, STAY

if TYPE_CHECKING:
    from flexopt.study.verdicts.result import Verdict

# What has decayed by so many e-folds has settled, whatever the transient: to 2 % of a two thousandth part.
DECAYED = 11.5
# What is kept as well as it is known.
NEARLY = f", to {100 * HARDLY:.0f} % of what is allowed"
# Why a place is none to go to, by what of `Breaks` bars it.
BARRED = {
    "standing": "it breaks constraints as it stands",
    "by_loop": "in another place the loop does what it must",
    "somewhere": f"another place keeps constraints on every ground{NEARLY}, its end-point on the target",
    "at_rest": (
        f"another place, which is stable on every ground, keeps constraints at rest beside its target{NEARLY}, too"
    ),
}
# A self-motion that takes longer than this to e-fold, s, stays where it is while a machine works.
STAYS = 3600.0


def on_places(verdict: Verdict) -> list[str]:
    """Of each place: where it rests, what it goes beyond and breaks, if it is none to go to, why no run confirms it."""
    unconfirmed, found = doubts(verdict), list[str]()
    own = ", all but Functions of one's own" * any(problem.own_constraints for problem in verdict.problems)
    for place in verdict.places:
        broken = place.broken + own * (WHERE in place.breaks and place.breaking.sought != "none")
        found += [place.rest, place.beyond_limits, broken, place.broken_at_rest]
        if place.name in verdict.exclusions:
            none = "none to stay at" if place.name == STAY else "none to go to"
            found.append(f"{spoken(place.name)} is {none}: {BARRED[place.breaking.barring]}")
        found.append(unconfirmed.get(place.name, ""))
        weak = too_weak_told(place)
        found += [weak] * (weak not in verdict.drawbacks)
    return [*filter(None, found)]


def on_the_loop(verdict: Verdict) -> list[str]:
    """What the numbers of the loop do not say, or stand for."""
    said = (servo_proposed, drifts, counted, lingers, driven, rests_beside, falls, unseen, weightless)
    return [sentence for each in said if (sentence := each(verdict))]


def doubts(verdict: Verdict) -> dict[str, str]:
    """Why runs do not confirm places, a sentence by name; of those that the reason tells of it says it."""
    whys = {place.name: place.unconfirmed for place in verdict.places}
    return {
        name: f"{name}, a nonlinear run that does not confirm: {why}"
        for name, why in whys.items()
        if why
        and not (told_in(verdict.reason, why.split(BETWEEN)[0]) and re.search(rf"\b{spoken(name)}\b", verdict.reason))
    }


def servo_proposed(verdict: Verdict) -> str:
    """Where nothing can be told: that the weakest joint decides the servo gain, a sentence; else empty."""
    settings = verdict.settings
    if verdict.word != "cannot tell" or "servo_gain" not in settings.sources:
        return ""
    gain = f"the servo gain, {settings.servo_gain:.3g} {settings.damping_unit}, is what the weakest joint bears"
    return f"{gain}: with loop.servo_gain, the number of your drives, it may be told"


def drifts(verdict: Verdict) -> str:
    """That nothing brakes the arm's self-motion, or too little, a sentence; empty where that is not so."""
    slower = (each for each in verdict.places if each.drift > 0 or -each.drift < each.decay.least)
    own, told = [place for place in slower if abs(place.drift) * STAYS > 1], ""
    if own:
        first = max(own, key=lambda place: place.drift)
        how = "drifts away: it grows e-fold" if first.drift > 0 else "dies away more slowly: e-fold"
        where = f"in {spoken(first.name)} at {member_in_words(first.drift_at)}"
        of = "decay, settling and swing" if first.drift > 0 else "the decay"
        how += f" in {1 / abs(first.drift):.3g} s at worst, {where}"
        told = f"the arm's self-motion, which is no part of {of}, {how}"
    if not verdict.settings.lets_drift:
        return told and f"{told}; loop.nullspace_damping says how the controller brakes it"
    where = "in the linear loop"
    if any(place.runs for place in verdict.places):
        where = "neither in these runs nor in the linear loop"
    brakes = f"the controller does not brake the arm's self-motion, {where}; loop.nullspace_damping brakes it"
    return "; ".join(filter(None, (brakes, told)))


def counted(verdict: Verdict) -> str:
    """Of which places the slowest decay is mostly that of the self-motion, a sentence; empty where of none."""
    alike = dict[str, dict[str, str]]()
    for place in verdict.rows:
        for told in mostly_self_motion(place.self_motion):
            alike.setdefault(without_numbers(told), {})[place.name] = told
    return "; ".join(
        f"the slowest motion of {listed(map(spoken, whys))} is {in_one([*whys.values()])}" for whys in alike.values()
    )


def lingers(verdict: Verdict) -> str:
    """That a self-motion which dies away slowly keeps the end-point from settling, a sentence; empty where none."""
    fast = DECAYED / LONGEST
    late = [place.name for place in verdict.rows if math.isnan(place.settling.greatest) and place.decay.least > fast]
    if not late or all(math.isnan(place.drift) for place in verdict.rows if place.name in late):
        return ""
    does = "decay fast and yet do" if len(late) > 1 else "decays fast and yet does"
    why = "the arm's self-motion, no part of the decay, dies away slowly there and takes the end-point with it"
    return f"{listed(map(spoken, late))} {does} not settle in a minute on some ground: {why}"


def driven(verdict: Verdict) -> str:
    """That an unknown weight drives the arm's self-motion, and where most, a sentence; empty where it does not."""
    most = max(verdict.places, key=lambda place: max(map(abs, place.unheld.values()), default=0.0))
    where = f"in {spoken(most.name)} at {member_in_words(most.unheld_at)}"
    return "".join(driven_self_motion(most.unheld, verdict.settings.joint_units, where))


def rests_beside(verdict: Verdict) -> str:
    """How far beside its target the end-point rests, where a move would not have settled there; else empty."""
    off = [place for place in verdict.rows if place.rests_off >= UNSETTLED]
    if not off:
        return ""
    off.sort(key=lambda place: -place.rests_off)
    counted = [f", {NOT_WHERE_IT_GROWS}" if place.decay.least <= 0 else "" for place in off]
    counted[0] = f" at {member_in_words(off[0].rests_off_at)}{counted[0]}"
    each = ", ".join(f"{one.rests_off:.3g} m ({spoken(one.name)}{but})" for one, but in zip(off, counted, strict=True))
    angles = with_angles(verdict.problems[0].machine)
    drawn = f"{OTHER_WEIGHT} holds the end-point off its target at rest{angles}"
    told = f"{drawn}, by {each}, the most that was found"
    known = any(INTEGRAL in said for said in (verdict.reason, *doubts(verdict).values()))
    settles = any(math.isfinite(place.settling.greatest) for place in off)
    way = ["the settling time is that of the way to there"] * settles
    return "; ".join([told, *way, *([] if known else [INTEGRAL])])


def falls(verdict: Verdict) -> str:
    """That feedback is not found to hold the arm of places, a sentence; empty where it holds it."""
    least = min(place.decay.least for place in verdict.rows)
    return f"{FALLS}: on some ground {NOWHERE_HELD}" if least <= falling(verdict.settings.rate) else ""


def unseen(verdict: Verdict) -> str:
    """That the slowest motion of places is none of the controller's, a sentence; empty where it is."""
    names = [place.name for place in verdict.places if place.unseen]
    if not names:
        return ""
    which = "every place" if len(names) == len(verdict.places) else ", ".join(names)
    return unseen_told(which)


def weightless(verdict: Verdict) -> str:
    """That the weight is left out, a sentence; empty where it acts, or the machine has none."""
    problem = verdict.problems[0]
    if problem.gravity or problem.machine.gravity == 0:
        return ""
    return (
        "the weight is left out, of the linear loops and of the runs: with gravity = true in [selection], "
        "--gravity in the shell, what an unknown load draws is judged, too"
    )
