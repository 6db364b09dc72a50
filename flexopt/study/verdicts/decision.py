"""The word of a verdict by its stated rule: move, stay, change gains, cannot tell.

In: decays of the present configuration and of others, on the same members of what is uncertain. Out: the word, and why.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.foundation.plain import listed
from flexopt.foundation.rounding import way
from flexopt.study.verdicts.places import STAY

Word = Literal["move", "stay", "change gains", "cannot tell"]
# By which share of its decay one is faster than the other, and in which share of the members it must be.
FASTER, MOST = 0.1, 0.95
# What is broken with other numbers than the file's, on the target or at rest beside it, by no more than this share of
# what is allowed takes no place out: weights and springs, and by them what joints carry, are not known to that.
HARDLY = 0.01
# Members of either sign that tell grounds apart.
SEVERAL = 3
# A turn or a shift below it is none, rad or m.
LEAST_TOLD = 1e-3
# Of a decay, by which two are one: mirrored places differ by rounding.
ALIKE = 1e-6
# Between what a run shows and what helps, in why it does not confirm.
BETWEEN = "; "
# Of several places so many lists of numbers, each in their order, are still read.
LISTS = 2
NUMBER = re.compile(r"[-+±]?\d[\d.e+-]*")
NUMBERS = re.compile(rf"{NUMBER.pattern}(?:(?:, | and ){NUMBER.pattern})*")
# How it begins that a place does not do what it must at least.
BREAKS = "breaks "
# What "better" is, in every sentence.
BETTER = f"decays at least {100 * FASTER:.0f} % faster"

RULE = (
    f"One place is better than another on a ground where it {BETTER}, or decays and the other grows. MOVE: a place is "
    f"stable on every ground looked at, better than the present one on {100 * MOST:.0f} % of them and in its worst "
    f"case, and {100 * MOST:.0f} % of the nonlinear runs confirm it: the base's oscillation decays, and the end-point "
    "ends no farther from its target than it began, and at most half as far as it ever was. CHANGE GAINS: other gains "
    "that were tried do in a place what no move does with the present gains (where one can be made, as much as it with "
    "less to drive), by the slowest decay of all grounds alone, or no place is stable on every ground and other gains "
    "make one so, or runs refute a present place that is stable, and no move with the present gains is better than "
    "staying with others; runs confirm it; they are tried where the loop has ranges for them, or where the present "
    "place is not stable on every ground, or not confirmed, and there is none to move to. The place is the present "
    "one, unless another of these, each with its own other gains, the present one with those that it has where others "
    "are not worth a change, is better by the rule of MOVE; where runs refute a place with its own, those that they "
    "confirm in another are tried in it, too. Of others one that breaks constraints at rest beside its target is the "
    "last, and so are gains with which a place does. The fastest that are found, of those with which it holds with a "
    "tenth higher ones, too, where some do, are lowered together until it does not grow with twice as high ones, while "
    f"the slowest decay is within {100 * FASTER:.0f} % of the best, worth the change, and runs confirm it; where the "
    "end-point of runs that are long enough ends too far off its target with the fastest, they are raised together to "
    "the lowest found, worth the change, that runs confirm. STAY: the present place is stable on every ground, runs "
    f"confirm it, and no other is better on more than {100 * (1 - MOST):.0f} % of them, one that is passed over for "
    "what it breaks at rest beside its target counted, too, for a choice seeks no places that keep constraints there. "
    "CANNOT TELL: all else. A present place that breaks constraints that were asked for is none to stay at, unless it "
    "is what the loop does in no place found, and is not among those compared, nor is one from which the arm does not "
    "reach a target within its limits; nor is one that breaks constraints at a corner of what is uncertain, where "
    "another place keeps them with the end-point on the target, or there at rest beside its target, where another that "
    f"is stable on every ground does not; what is broken by {100 * HARDLY:.0f} % of what is allowed or less in one of "
    "these two ways counts as kept in it, for weights and springs are not known to that. Where no nonlinear runs were "
    "asked for, they need not confirm. Of several places to move to it is that with the least drive among those whose "
    f"slowest decay is within {100 * FASTER:.0f} % of the best, and of drives within {100 * FASTER:.0f} % and "
    f"{1e3 * LEAST_TOLD:.0f} mm of the least, and turns of the base on its way within {100 * FASTER:.0f} % and "
    f"{1e3 * LEAST_TOLD:.0f} mrad of the least of these, the fastest."
)  # fmt: skip


# Those found, where others are none to move to.
KEEPING = " that keeps the constraints"
# Why there is no staying, usually.
UNREACHED = "from the present placement the arm does not reach {} within its limits"


class Place(NamedTuple):
    """One configuration: name, decays (n,) on the members and the slowest that was found at all, 1/s; what it takes.

    `drive` of the base, m; `otherwise`: what moves besides, in words; `turn` of the base, rad; `falls`: whether
    feedback is not found to hold it where it decays least.
    """

    name: str
    decays: Vector
    slowest: float
    drive: float
    otherwise: str = ""
    turn: float = 0.0
    falls: bool = False

    @property
    def slowest_told(self) -> str:
        """Its slowest decay, in words."""
        return "none (the arm falls)" if self.falls else f"{self.slowest:.3g}/s"

    @property
    def grows_told(self) -> str:
        """That it is not stable, and its slowest decay, to follow why it is none to stay at; empty where it is."""
        return "" if self.holds else f"; nor is it stable on every ground: slowest decay {self.slowest_told}"

    @property
    def holds(self) -> bool:
        """Whether it is stable wherever that was looked at."""
        return self.slowest > 0

    def better_than(self, other: Place) -> float:
        """Share of the members on which it decays faster, by a tenth."""
        return float(np.mean(faster(self.decays, other.decays)))


@dataclass(frozen=True)
class Decision:
    """The word, the place that it speaks of, and the reason in a sentence; and why no nearer one."""

    word: Word
    place: str
    reason: str
    passed_over: str = ""


def faster(one: Vector, other: Vector) -> NDArray[np.bool_]:
    """Where the one decays faster, by a tenth of the other's rate; whatever decays is faster than what grows."""
    return (one - other > FASTER * np.abs(other)) | ((one > 0) & (other <= 0))


def ranked(decays: Mapping[str, Vector]) -> list[str]:
    """Names of places, the best first: stable on the most grounds, then in the worst case."""
    return sorted(decays, key=lambda name: (np.mean(decays[name] > 0), np.min(decays[name])), reverse=True)


def decide(
    stay: Place | None,
    others: Sequence[Place],
    changed: Place | None = None,
    unconfirmed: Mapping[str, str] = MappingProxyType({}),
    *,
    tried: str = "",
    refuted: Place | None = None,
    doubt: str = "",
    gains: str = "",
    absent: str = UNREACHED.format("the target"),
    most: float = 0.0,
    barred: bool = False,
    sought: str = "",
) -> Decision:
    """The word by `RULE`.

    Args:
        stay: the present configuration; None where there is no staying.
        others: to which one may move.
        changed: the best place with other gains, where runs confirm it.
        unconfirmed: why nonlinear runs do not confirm a place, by its name.
        tried: which other gains were, in words; empty for none.
        refuted: the best place with other gains, where runs do not confirm it;  doubt: why the first of them does not.
        gains: these other gains, in words.
        absent: why there is no staying.
        most: share of the members on which a place is better than staying, of all that were judged.
        barred: whether some that were found are not among these, for they break constraints.
        sought: by what places were sought, in words; empty: that is not told.
    """
    found = f"no place found{sought and f' by {sought}'}{KEEPING * barred}"
    sound = sound_of(others, unconfirmed)
    best = _best([place for place in sound if stay is None or pays(place, stay)])
    staying = may_stay(stay, unconfirmed)
    every = [*([] if stay is None else [stay]), *others]
    doubted = [place.name for place in every if place.holds and place.name in unconfirmed]
    if changed is not None and changed.holds and _spares(changed, staying, best, sound, doubted=STAY in doubted):
        doubts = {name: unconfirmed[name] for name in doubted}
        return Decision("change gains", changed.name, _why_gains(changed, stay, best, sound, doubts, found))
    if best is not None:
        reason = f"{absent}; slowest decay there {best.slowest_told}"
        if stay is not None:
            reason = f"{BETTER} on {percent(best.better_than(stay))} of the grounds"
            if not stay.holds:
                reason = "stable on every ground, which the present place is not"
            reason += f"; slowest decay {best.slowest_told} instead of {stay.slowest_told}"
        takes = ", ".join(filter(None, [f"a drive of {way(best.drive):.3g} m", best.otherwise]))
        return Decision("move", best.name, f"{reason}, for {takes}", passed_over(best, stay, others, unconfirmed))
    if staying is not None:
        share, rival = _rival(staying, others)
        if share <= 1 - MOST:
            most = max(share, most)
            where = f"more than {percent(most)} of the grounds" if most else "any ground"
            reason = f"{found} {BETTER} on {where}"
            return Decision("stay", staying.name, f"{reason}; slowest decay here {staying.slowest_told}")
        return Decision("cannot tell", rival.name, _why_not(rival, share, unconfirmed))
    if stay is not None and sound:
        first = _near(_slowest_alike(sound))
        share = first.better_than(stay)
        where = f"on {percent(share)} of the grounds only" if share else "on none that was looked at"
        reason = f"{first.name} is stable on every ground, and the present place is not, but {BETTER} {where}"
        if stay.holds:
            reason = f"nonlinear runs do not confirm the present place{_because(unconfirmed[stay.name])}, and "
            reason += f"{first.name}, which they confirm, {BETTER} {where}"
        does = ""
        if refuted is not None and _spares(refuted, staying, None, sound, doubted=STAY in doubted):
            more = faster(np.array(refuted.slowest), np.array(max(place.slowest for place in sound)))
            does = f"{BETTER} in the worst case" if more else "is stable on every ground, too"
        return Decision("cannot tell", first.name, reason + _no_gains(tried, refuted, does, doubt, gains))
    if doubted:
        reason = f"nonlinear runs do not confirm {_doubted(doubted, unconfirmed)}"
        if refuted is not None and refuted.holds:
            whys = {without_numbers(part) for name in doubted for part in unconfirmed[name].split(BETWEEN)}
            other = BETWEEN.join(part for part in doubt.split(BETWEEN) if without_numbers(part) not in whys)
            reason += f"; nor {spoken(refuted.name)} with other gains{_named(gains)}{other and f': {other}'}"
        return Decision("cannot tell", doubted[0], reason)
    with_others = f", nor with {tried}" if tried else ""
    if refuted is not None and refuted.holds:
        with_others = _no_gains(tried, refuted, "is", doubt, gains)
    reason = f"{found} is stable on every ground with the present gains{with_others}"
    return Decision("cannot tell", "", reason)


def _no_gains(tried: str, refuted: Place | None, does: str, doubt: str, gains: str) -> str:
    """What a place does with other gains by the linear loop, and why runs do not confirm it; else that none help."""
    if refuted is None or not does:
        return f"; no gains worth a change are found with {tried}" * bool(tried)
    but = f"nonlinear runs do not confirm that{doubt and f': {doubt}'}"
    if doubt.startswith(BREAKS):
        but = f"then it {doubt}"
    return f"; with other gains{_named(gains)} {spoken(refuted.name)} {does}, but {but}"


def _named(gains: str) -> str:
    return f" ({gains})" * bool(gains)


def spoken(place: str) -> str:
    """The name of a place within a sentence."""
    return "the present place" if place == STAY else place


def deciding(decision: Decision, known: Mapping[str, Place], stay: Place | None) -> tuple[str, Vector]:
    """What decides where the word is "cannot tell", in words, and as numbers (n,) on the members, by sign."""
    place = known[decision.place or ranked({name: each.decays for name, each in known.items()})[0]]
    grows = int(np.count_nonzero(place.decays <= 0))
    if not place.holds and min(grows, place.decays.size - grows) < SEVERAL:  # so few that chance alone parts them
        return f"how far {spoken(place.name)} is from growing", place.decays - place.decays.mean()
    if not place.holds:
        # It cannot be had, whatever is gained elsewhere: what tells the grounds apart on which it grows decides.
        return f"whether {spoken(place.name)} is stable", np.where(place.decays > 0, 1.0, -1.0)
    if stay is None or place.name == stay.name:
        return f"the decay at {spoken(place.name)}", place.decays
    # By how much orders the many grounds on which little is gained or lost, too, which would outvote the others.
    return f"whether {place.name} {BETTER}", np.where(faster(place.decays, stay.decays), 1.0, -1.0)


def _because(why: str) -> str:
    return why and f" ({why})"


def without_numbers(why: str) -> str:
    """What tells kinds of texts apart."""
    return NUMBER.sub("", why)


def _doubted(names: Sequence[str], unconfirmed: Mapping[str, str]) -> str:
    """Places that runs do not confirm, each with why; what is why of several, but for a number, stands once."""
    alike = dict[str, list[str]]()
    for name in names:
        alike.setdefault(without_numbers(unconfirmed[name]), []).append(name)
    if len(alike) == 1 and (why := in_one([unconfirmed[name] for name in names])):
        return listed(map(spoken, names)) + _because(why)
    parts = [unconfirmed[name].split(BETWEEN) for name in names]
    least, common = min(map(len, parts)), 0
    while common < least - 1 and len({each[-1 - common] for each in parts}) == 1:
        common += 1
    heads = {name: BETWEEN.join(each[: len(each) - common]) for name, each in zip(names, parts, strict=True)}
    each = (
        "; nor ".join(_doubted(group, heads) for group in alike.values())
        if 1 < len(alike) < len(names)
        else listed(f"{spoken(name)}{_because(head)}" for name, head in heads.items())
    )
    return BETWEEN.join([each, *parts[0][len(parts[0]) - common :]])


def in_one(whys: Sequence[str]) -> str:
    """Texts alike but for numbers as one, with the numbers of all where no more than `LISTS` differ; else nothing."""
    each = [NUMBER.findall(why) for why in whys]
    differ = [k for k, numbers in enumerate(zip(*each, strict=True)) if len(set(numbers)) > 1]
    if len(differ) > LISTS:
        return ""
    # One for each, in their order, though some may be the same.
    told = [listed(numbers) if k in differ else numbers[0]
            for k, numbers in enumerate(zip(*each, strict=True))]  # fmt: skip
    texts = NUMBER.split(whys[0])
    return "".join(text + number for text, number in zip(texts, [*told, ""], strict=True))


def told_in(reason: str, why: str) -> bool:
    """Whether a reason tells why, be it with the numbers of others beside its own, as `in_one` does."""
    told, numbers = NUMBERS.sub("", reason), NUMBER.findall(reason)
    return NUMBERS.sub("", why) in told and set(NUMBER.findall(why)) <= set(numbers)


def _why_not(rival: Place, share: float, unconfirmed: Mapping[str, str]) -> str:
    """Why a place that is better on many grounds is none to move to."""
    reason = f"{rival.name} {BETTER} on {percent(share)} of the grounds"
    if not rival.holds:
        return f"{reason}, but not stable on every one"
    if rival.name in unconfirmed:
        return f"{reason}, but nonlinear runs do not confirm it{_because(unconfirmed[rival.name])}"
    return f"{reason}, but not in its worst case" if share >= MOST else f"{reason} only"


def passed_over(
    best: Place,
    stay: Place | None,
    others: Sequence[Place],
    unconfirmed: Mapping[str, str],
    ends: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """Of the nearest place with less to drive that is better than staying on some grounds, why it is not moved to.

    `ends`: where all these are with other gains, at which end of those that were tried each has its own, in words.
    """
    near = [place for place in others if nearer(place, best)]
    some = [place for place in near if stay is None or place.better_than(stay) > 1 - MOST]
    place = min(some, key=attrgetter("drive"), default=None)
    if place is None:
        return ""
    end = ends.get(place.name, "")
    if not place.holds:
        why = "is not stable on every ground"
    elif stay is not None and place.better_than(stay) < MOST:
        why = f"{BETTER} on {percent(place.better_than(stay))} of the grounds only"
    elif place.name in unconfirmed:
        doubt = unconfirmed[place.name]
        why = f"it {doubt}" if doubt.startswith(BREAKS) else f"nonlinear runs do not confirm it{_because(doubt)}"
        # What runs refute may have been lowered from there.
        end = ""
    elif stay is not None and not pays(place, stay):
        why = "not in its worst case"
    else:
        why = f"its slowest decay is {place.slowest_told} only"
    tried = ", with the gains that were tried," * bool(ends)
    return BETWEEN.join(filter(None, [f"{place.name} is nearer, {way(place.drive):.3g} m away, but{tried} {why}", end]))


def percent(share: float) -> str:
    """A share with so many digits that it is told on its own side of what the rule goes by, and of none and all."""

    def side(x: float) -> tuple[bool, ...]:
        return x > 0, x > 1 - MOST, x >= MOST, x >= 1

    told = (f"{100 * share:.{digits}f}" for digits in range(17))
    return f"{next(each for each in told if side(float(each) / 100) == side(share))} %"


def pays(place: Place, stay: Place) -> bool:
    """Whether a move from the present place to another is worth it, as by `RULE`."""
    return place.better_than(stay) >= MOST and bool(faster(np.array(place.slowest), np.array(stay.slowest)))


def _rival(stay: Place, others: Sequence[Place]) -> tuple[float, Place]:
    """The place that is better on the most members, then in the worst case; its share. Of alike ones the nearer."""
    shares = [place.better_than(stay) for place in others]
    if not shares:
        return 0.0, stay
    most = max(shares)
    first = [place for place, share in zip(others, shares, strict=True) if share == most]
    return most, _near(_slowest_alike(first))


def _slowest_alike(places: Sequence[Place]) -> list[Place]:
    """Those whose slowest decay is the largest, to rounding."""
    most = max(place.slowest for place in places)
    least = most - ALIKE * abs(most) if np.isfinite(most) else most
    return [place for place in places if not place.slowest < least]


def _near(places: Sequence[Place]) -> Place:
    """That with the least drive; of drives that are one to `FASTER` that with the least turn; of these the fastest."""
    for takes in (attrgetter("drive"), attrgetter("turn")):
        most = (1 + FASTER) * min(map(takes, places)) + LEAST_TOLD
        places = [place for place in places if not takes(place) > most]
    # Mirrored places differ by rounding.
    return min(_slowest_alike(places), key=lambda place: (len(place.name), place.name))


def nearer(place: Place, other: Place) -> bool:
    """Whether it has less to drive, by more than what is one."""
    return place.drive < (1 - FASTER) * other.drive - LEAST_TOLD


def _best(moves: Sequence[Place]) -> Place | None:
    """The least drive among those whose slowest decay is within a tenth of the best."""
    if not moves:
        return None
    most = max(place.slowest for place in moves)
    return _near([place for place in moves if place.slowest >= (1 - FASTER) * most])


def sound_of(others: Sequence[Place], unconfirmed: Mapping[str, str]) -> list[Place]:
    """Those that are stable, and not refuted by runs."""
    return [place for place in others if place.holds and place.name not in unconfirmed]


def may_stay(stay: Place | None, unconfirmed: Mapping[str, str]) -> Place | None:
    """The present place, if it is one to stay at: stable, and not refuted by runs."""
    return stay if stay is not None and stay.holds and stay.name not in unconfirmed else None


def _spares(
    changed: Place, staying: Place | None, best: Place | None, sound: Sequence[Place], *, doubted: bool
) -> bool:
    """Whether other gains are worth more than what can be had with these, in any place that runs confirm.

    `doubted`: whether runs refute the present place with these, though it is stable.
    """
    if best is not None:
        return changed.slowest >= best.slowest and nearer(changed, best)
    # Where runs refute a stable present place, gains that they confirm there need not be faster than what is elsewhere.
    if changed.name == STAY and doubted:
        return not any(pays(place, changed) for place in sound)
    had = [place.slowest for place in (*sound, *([] if staying is None else [staying]))]
    return not had or bool(faster(np.array(changed.slowest), np.array(max(had))))


def _why_gains(
    changed: Place,
    stay: Place | None,
    best: Place | None,
    sound: Sequence[Place],
    doubts: Mapping[str, str],
    found: str,
) -> str:
    reason = f"with the new gains the slowest decay at {spoken(changed.name)} is {changed.slowest_told}"
    if best is not None:
        more = faster(np.array(changed.slowest), np.array(best.slowest))
        much = "more than" if more else "as much as"
        return f"{reason}, {much} {best.name} has with the present ones, {best.slowest_told}"
    staying = may_stay(stay, doubts)
    had = [*([] if staying is None else [staying]), *sound]
    if had and stay is not None and stay.holds:
        first = max(had, key=lambda place: place.slowest)
        where = " where nonlinear runs confirm it" * bool(doubts)
        told = f"{reason}, with the present ones {first.slowest_told} at most{where}, at {spoken(first.name)}"
        return told + (f"; they do not confirm {_doubted([*doubts], doubts)}" if doubts else "")
    if sound and stay is not None:
        rival = max(sound, key=lambda place: place.better_than(stay))
        share = f"{BETTER} than the present place on {percent(rival.better_than(stay))} of them only"
        return f"{reason}; with the present ones {rival.name} is stable on every ground, too, but {share}"
    if doubts:
        one, whys = len(doubts) == 1, set(doubts.values())
        stable = f"{listed(map(spoken, doubts))} {'is' if one else 'are'} stable on every ground, too"
        them = "it" if one else "them"
        them = f"{them}{_because(whys.pop())}" if len(whys) == 1 else _doubted([*doubts], doubts)
        return f"{reason}; with the present ones {stable}, but nonlinear runs do not confirm {them}"
    return f"{reason}; with the present ones {found} is stable on every ground"
