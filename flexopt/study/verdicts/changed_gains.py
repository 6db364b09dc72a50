"""Where other gains help, and which: the place, its loop with these, and what nonlinear runs say of it.

In: the places that one may stay in or move to, their loops with the present gains, what other gains are asked for. Out:
the place with its gains, for a `Decision`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.foundation.rounding import way
from flexopt.loop.loop_motions import falling
from flexopt.loop.uncertain import FEW
from flexopt.model.loop import Loop
from flexopt.study.verdicts.confirmation import SHORT, Runs, ends_off
from flexopt.study.verdicts.decision import (
    BETWEEN,
    BREAKS,
    FASTER,
    MOST,
    Place,
    decide,
    may_stay,
    nearer,
    passed_over,
    pays,
    sound_of,
    spoken,
)  # fmt: skip
from flexopt.study.verdicts.gain_search import (
    RESERVE,
    ROOM,
    at_ends,
    best_gains,
    lowered,
    most_raised,
    most_room,
    one_factor,
    raised,
)
from flexopt.study.verdicts.place_loops import PlaceLoops, Slowest
from flexopt.study.verdicts.places import STAY, gains_in_words

# So often gains are sought again for a member that was not among the few.
EXCHANGES = 3
# In so many places to move to other gains are refuted, or have to be raised, at most, until they do in one.
PLACES = 3
# So often the way is halved from gains that runs do not confirm, or that break something, to higher that do not.
HALVED = 2
# So many higher gains are asked of runs that refute the fastest, the highest first.
RAISED = 4


class ChangedGains(NamedTuple):
    """A place with other gains: its loop with these, nonlinear runs if any were asked for.

    `staying`: of another place than the present one, what staying with other gains does, in words; empty where runs
    refute it; `passed_over`: why it is no place with less to drive. `at_end`: see `at_ends`, `one_factor`. `breaks`:
    what it does not do of what it must at least;  breaks_at_rest: see `Breaks`. `raised`: why runs refute its fastest
    gains, where these are higher ones.
    """

    place: Place
    loop: PlaceLoops
    runs: Runs | None
    staying: str = ""
    at_end: str = ""
    breaks: str = ""
    passed_over: str = ""
    breaks_at_rest: str = ""
    raised: str = ""

    @property
    def gains(self) -> dict[str, list[float]]:
        """By name."""
        settings = self.loop.settings
        names = ("kp", "kv", *(["ki"] if settings.feedback == "pid" else []))
        return {name: getattr(settings, name).tolist() for name in names}

    @property
    def in_words(self) -> str:
        """These gains."""
        return gains_in_words(self.gains, self.loop.settings.gain_units)

    @property
    def doubt(self) -> str | None:
        """What it breaks, or else see `doubt_of`."""
        return self.breaks or doubt_of(self.runs)

    @property
    def refuted_told(self) -> str:
        """That runs refute faster gains than these, which are higher."""
        return f"nonlinear runs do not confirm faster ones there ({self.raised.split(BETWEEN)[0]})"

    @property
    def rank(self) -> int:
        """2 of a place to go to, 1 of one that breaks constraints at rest beside its target, 0 of one in doubt."""
        return 0 if self.doubt is not None else 1 if self.breaks_at_rest else 2


def doubt_of(runs: Runs | None) -> str | None:
    """Why the first of nonlinear runs that do not confirm a place does not; None where they do, or none were made."""
    return None if runs is None or runs.confirming >= MOST else next(filter(None, runs.reasons), "")


class Sought(NamedTuple):
    """What is found of other gains.

    `changed`: the place to be in with others, None where none does better than staying as it is;  fastest: every place
    with those that are best there;  standing: the present one as one would stay there, None where one would not;
    doubts: why nonlinear runs do not confirm some of these, by name.
    """

    changed: ChangedGains | None
    fastest: Mapping[str, ChangedGains]
    standing: Place | None
    doubts: Mapping[str, str]


class _Tried(NamedTuple):
    """A place with other gains, and the few members that these were sought for (n, k)."""

    place: Place
    loop: PlaceLoops
    few: Vector


@dataclass(frozen=True)
class GainChange:
    """What other gains are sought of.

    Attributes:
        asked: of the loop: gains are those of its ranges; without ranges, all gains times a factor.
        known: the places by name;  loops, slowest: of each, with the present gains.
        doubts: why nonlinear runs do not confirm a place with the present gains, by its name.
        points: members (n, k);  runs_of: nonlinear runs of a place's loop.
        breaks: of what it must do at least what a place's loop does not do;  at_rest: what a place breaks at rest
            beside its target with a loop, where that grows nowhere.
    """

    asked: Loop
    known: Mapping[str, Place]
    loops: Mapping[str, PlaceLoops]
    slowest: Mapping[str, Slowest]
    doubts: Mapping[str, str]
    points: Vector
    runs_of: Callable[[PlaceLoops], Runs | None]
    breaks: Callable[[str, PlaceLoops], str] = lambda _name, _loop: ""
    at_rest: Callable[[str, PlaceLoops], str] = lambda _name, _loop: ""

    def sought(self) -> Sought:
        """The best with other gains, and what else is known of these."""
        fastest, doubts = {name: self._fastest(name) for name in self.known}, dict[str, str]()
        each = {
            name: ChangedGains(tried.place, tried.loop, None, at_end=self._ends(tried))
            for name, tried in fastest.items()
        }
        stay = self._lowest(fastest[STAY]) if STAY in fastest and fastest[STAY].place.holds else None
        if stay is not None and stay.rank == 1:
            # It is none to stay at where another, with its own other gains, breaks nothing at rest.
            beside = {STAY: f"{stay.breaks_at_rest}, at rest beside its target"}
            standing = self._standing(None)
            elsewhere = self._best({name: fastest[name] for name in fastest if name != STAY}, None, standing, beside)
            if elsewhere is not None and elsewhere.rank == 2:
                told = f"staying with {stay.in_words} {beside[STAY]}" * (elsewhere.place.name != STAY)
                return Sought(elsewhere._replace(staying=told), each, standing, beside)
        if stay is not None and stay.doubt is not None:
            doubts[STAY] = stay.doubt
        standing = self._standing(None if stay is None or stay.doubt is not None else stay.place)
        return Sought(self._best(fastest, stay, standing, doubts), each, standing, doubts)

    def _best(
        self, fastest: Mapping[str, _Tried], stay: ChangedGains | None, standing: Place | None, doubts: dict[str, str]
    ) -> ChangedGains | None:
        """The place to be in, each with the lowest gains that do as well as its fastest; None where none does better.

        The present one, unless a move from it pays, as by `RULE`, or runs refute it and confirm another. Of places with
        less to drive whose fastest gains runs refute, one that does as well with those that they confirm; one that
        breaks constraints at rest where none of the others that are tried does better.

        Args:
            fastest: each place with its best gains.
            stay: the present one, where it is stable with others;  standing: as one would stay there, if one would.
            doubts: to which it adds why runs do not confirm places with these, by name.
        """
        places = [each.place for name, each in fastest.items() if name != STAY or stay is None]
        others = places if standing is None else [place for place in places if pays(place, standing)]
        # What a move does with the present gains is no merit of others.
        others = [place for place in others if self._changes(place)] or others
        best, tried, at_rest = list[ChangedGains](), 0, dict[str, str]()
        higher, why = {} if stay is None or not stay.raised else {STAY: stay}, dict[str, str]()
        while others and tried < PLACES:
            found = self._lowest(fastest[_nearest(others)], standing)
            if not best or found.rank >= best[0].rank:
                best = [*(best if best and found.rank == best[0].rank else []), found]
            others = [place for place in others if place.name != found.place.name]
            as_fast = found.place.slowest >= _alike(fastest[found.place.name].place.slowest)
            if found.rank == 2 and as_fast:
                break
            # Where its gains had to be raised others may be faster with theirs.
            tried += found.rank != 1
            higher |= {found.place.name: found} if found.raised else {}
            if found.doubt is not None:
                doubts[found.place.name] = found.doubt
            elif found.breaks_at_rest:
                at_rest[found.place.name] = f"{found.breaks_at_rest}, at rest beside its target"
        other = _best_of(best)
        # Where another breaks nothing there that is why it is none of these.
        doubts |= at_rest if other is not None and other.rank == 2 else {}
        if other is not None and other.doubt is None:
            as_well = _alike(fastest[other.place.name].place.slowest)
            as_well = as_well if other.place.slowest >= as_well else _alike(other.place.slowest)
            other, why = self._spared(other, as_well, standing, doubts, higher)
            if other.place.name == STAY:
                return other
            moves = [place for place in places if place.name != STAY]
            ends = {place.name: self._ends(fastest[place.name]) for place in moves}
            ends |= {
                name: BETWEEN.join([each.refuted_told, *filter(None, [why.get(name)])]) for name, each in higher.items()
            }
            moves = [higher[place.name].place if place.name in higher else place for place in moves]
            told = passed_over(other.place, standing, moves, doubts, ends)
            grows = self._grows(fastest[STAY]) if stay is None and STAY in fastest else ""
            other = other._replace(passed_over=told, staying=grows)
        if stay is None or other is None:
            return stay or other
        serves = self._changes(other.place) or not self._changes(stay.place)
        if other.doubt is not None or not (standing is None or pays(other.place, standing)):
            return stay
        if not serves:
            return stay._replace(passed_over=self._no_use(other) if other.rank == 2 and other.place.holds else "")
        told = f"staying with {stay.in_words} is stable on every ground, too: slowest decay {stay.place.slowest_told}"
        told = BETWEEN.join(filter(None, [told, stay.refuted_told * bool(stay.raised), why.get(STAY)]))
        return other._replace(staying="" if stay.doubt is not None else told)

    def _no_use(self, other: ChangedGains) -> str:
        """Why one does not go to a place that is faster with its other gains than the present one with its own."""
        place, drive = other.place, f"for a drive of {way(other.place.drive):.3g} m"
        told = f"{spoken(place.name)} with {other.in_words} is faster yet, {place.slowest_told} at worst, {drive}"
        others = [each for name, each in self.known.items() if name != STAY]
        if decide(self.known.get(STAY), others, None, self.doubts).word == "move":
            return f"{told}; as one can move with the present gains, others are for what is nearer"
        rival = max(sound_of(others, self.doubts), key=attrgetter("slowest"))
        much = f"not {100 * FASTER:.0f} % faster than {rival.name} with the present gains, {rival.slowest_told}"
        return f"{told}, but {much}"

    def _grows(self, stay: _Tried) -> str:
        """That the present place is not stable with the best other gains found for it, in words."""
        loop = ChangedGains(stay.place, stay.loop, None).in_words
        told = f"staying with {loop}, the best other ones found, is not stable on every ground: slowest decay "
        return ", and ".join(filter(None, [f"{told}{stay.place.slowest_told}", self._ends(stay)]))

    def _standing(self, changed: Place | None) -> Place | None:
        """The present place as one would stay there: with other gains where these are worth a change, else as it is.

        None where it is none to stay at, as it is or as `changed`, with gains that runs confirm.
        """
        now = may_stay(self.known.get(STAY), self.doubts)
        return changed if now is None or (changed is not None and self._changes(changed)) else now

    def _spared(
        self,
        other: ChangedGains,
        least: float,
        standing: Place | None,
        doubts: dict[str, str],
        higher: Mapping[str, ChangedGains],
    ) -> tuple[ChangedGains, dict[str, str]]:
        """Its gains where that takes the least drive, of places that runs refute with their fastest; else itself.

        And why those with higher gains do not do with these, by name.

        Args:
            other: a place whose gains runs confirm;  least: decay that does as well, 1/s.
            standing: as one would stay, where runs do not refute that.
            doubts: why they refute a place with its own gains; that it does not do with these joins it.
            higher: places with gains that had to be raised, by name.
        """
        refuted, whys = {*doubts, *higher}, dict[str, str]()
        near = [place for name, place in self.known.items() if name in refuted and nearer(place, other.place)]
        for place in sorted(near, key=lambda each: each.drive):
            loop = self.loops[place.name].with_settings(other.loop.settings)
            there, member = self._with(place.name, loop)
            why = f"its slowest decay is {there.slowest_told}{' only' * (there.holds and there.slowest < least)}"
            if place.name == STAY:
                # One that stays with gains of its own changes them for better ones, where these spare the drive.
                own = higher[STAY].place.slowest if STAY in higher else -math.inf
                worth = there.slowest > own and not (STAY in higher and pays(other.place, there))
            else:
                worth = standing is None or pays(there, standing)
            does = self._changes(there) and worth
            if there.slowest >= least and does:
                found = self._told(_Tried(there, loop, member[None]))
                if found.rank > 0 and found.rank >= other.rank:
                    return found, {}
                doubt = found.doubt or f"{found.breaks_at_rest}, at rest beside its target"
                why = f"{'it ' * doubt.startswith(BREAKS)}{doubt.split(BETWEEN)[0]}"
            with_its = f"with the gains of {other.place.name} {why}"
            if place.name in doubts:
                doubts[place.name] += f"{BETWEEN}{with_its}"
            else:
                whys[place.name] = with_its
        return other, whys

    def _changes(self, place: Place) -> bool:
        """Whether the word is to change gains, of a place with other gains."""
        stay, others = self.known.get(STAY), [each for name, each in self.known.items() if name != STAY]
        return decide(stay, others, place, self.doubts).word == "change gains"

    def _with(self, name: str, loop: PlaceLoops) -> tuple[Place, Vector]:
        """A place with a loop of other gains, and its slowest member (k,)."""
        decays = loop.decays(self.points)
        worst = loop.slowest(self.points, decays)
        place = self.known[name]._replace(decays=decays.min(axis=0), slowest=worst.decay, otherwise="")
        return place._replace(falls=worst.decay <= falling(loop.settings.rate)), worst.member

    def _fastest(self, name: str) -> _Tried:
        """A place with its best gains; of those with which it breaks nothing at rest, where it is stable with any."""
        found = self._fastest_of(name, lambda loop: not self.breaks(name, loop))
        if not (found.place.holds and self.at_rest(name, found.loop)):
            return found
        keeping = self._fastest_of(name, lambda loop: not (self.breaks(name, loop) or self.at_rest(name, loop)))
        return keeping if keeping.place.holds and not self.at_rest(name, keeping.loop) else found

    def _fastest_of(self, name: str, does: Callable[[PlaceLoops], bool]) -> _Tried:
        loop, tried = self.loops[name], list[_Tried]()
        few = np.concatenate([loop.box.corners(FEW), self.slowest[name].member[None]])
        for _ in range(EXCHANGES):
            best = best_gains(loop, self.asked, few, does)
            place, member = self._with(name, best)
            tried.append(_Tried(place, best, few))
            # With other gains another member may be the slowest: then gains are sought for it, too.
            expected = float(best.decays(few).min())
            if place.slowest >= _alike(expected):
                break
            few = np.concatenate([few, member[None]])
        return max(tried, key=lambda each: each.place.slowest)._replace(few=few)

    def _told(self, tried: _Tried) -> ChangedGains:
        """What runs say of it."""
        loop, at_end = tried.loop, "; ".join(filter(None, (self._ends(tried), one_factor(self.asked))))
        breaks, at_rest = (each(tried.place.name, loop) for each in (self.breaks, self.at_rest))
        return ChangedGains(tried.place, loop, self.runs_of(loop), at_end=at_end, breaks=breaks, breaks_at_rest=at_rest)

    def _ends(self, tried: _Tried) -> str:
        """At which ends of what is tried its gains lie, in words."""
        return at_ends(tried.loop.settings, self.asked, self.loops[tried.place.name].settings)

    def _lowest(self, fastest: _Tried, standing: Place | None = None) -> ChangedGains:
        """The lowest gains with which a place is nearly as good as with its fastest, worth it, and of its highest rank.

        Where the end-point ends too far off its target with these, the lowest higher ones with which it does not.
        `standing`: as one would stay, where a move there must be better.
        """
        (place, best, few), name = fastest, fastest.place.name

        def keeps(decay: float) -> bool:
            return decay >= _alike(place.slowest) and self._changes(place._replace(slowest=decay))

        def does(there: Place) -> bool:
            return keeps(there.slowest) and (standing is None or pays(there, standing))

        def at(factor: float) -> _Tried:
            loop = lowered(best, self.asked, factor)
            there, member = self._with(name, loop)
            return _Tried(there, loop, member[None])

        lowest, least = None, 1.0
        # What makes twice as high gains grow need not be among the few that these were sought for.
        members = np.concatenate([few, self.points])
        for _ in range(EXCHANGES if keeps(place.slowest) else 0):
            least = most_room(best, self.asked, self.loops[name].settings, members, keeps)
            # Less is not worth what the decay loses.
            if least * (1 + FASTER) > 1.0:
                break
            tried = at(least)
            if does(tried.place):
                lowest = self._told(tried)
                break
            members = np.concatenate([members, tried.few])
        if lowest is not None and lowest.rank == 2:
            return lowest
        kept, high = self._told(fastest), 1.0
        if lowest is not None and kept.rank <= lowest.rank > 0:
            return lowest
        best_rank = kept.rank
        for _ in range(HALVED if lowest is not None and best_rank > 0 else 0):
            middle = math.sqrt(least * high)
            tried = at(middle)
            if does(tried.place) and (higher := self._told(tried)).rank >= best_rank:
                kept, high = higher, middle
            else:
                least = middle
        if kept.rank > 0:
            return kept
        found = self._raised(fastest, kept, standing)
        return kept if found is None else found._replace(raised=kept.doubt or "")

    def _raised(self, fastest: _Tried, refuted: ChangedGains, standing: Place | None) -> ChangedGains | None:
        """The lowest found of higher gains than a place's fastest that are worth a change, and that runs confirm.

        None where none are, or where runs refute those for another reason than that the end-point ends too far off its
        target: under a load that the controller does not know it rests the nearer the higher Kp is.

        Args:
            fastest: the place with its fastest gains;  refuted: what runs say of it.
            standing: as one would stay, where a move there must be better.
        """
        best, name, low, found = fastest.loop, fastest.place.name, 1.0, None
        # What is short for the present gains is no reason to change them.
        if refuted.breaks or SHORT in self.doubts.get(name, "") or not ends_off(refuted.runs):
            return None
        now, members = self.loops[name].settings, np.concatenate([fastest.few, self.points])
        for room in (ROOM, RESERVE):
            highest = most_raised(best, self.asked, now, members, room, lambda loop: not self.breaks(name, loop))
            if highest <= (1 + FASTER) * low:
                continue
            high = factor = highest
            for _ in range(RAISED):
                loop = raised(best, self.asked, now, factor)
                there, member = self._with(name, loop)
                does = there.holds and self._changes(there) and (standing is None or pays(there, standing))
                told = self._told(_Tried(there, loop, member[None])) if does else None
                if told is not None and told.rank > 0 and (found is None or told.rank >= found.rank):
                    found, high = told, factor
                elif found is not None or (told is not None and _too_low(told)):
                    low = factor
                else:
                    high = factor
                if low >= high:
                    break
                factor = math.sqrt(low * high)
            # Higher ones, with less room, help alone where the highest are too low.
            if found is not None or low < highest:
                break
        return found


def _best_of(alike: Sequence[ChangedGains]) -> ChangedGains | None:
    """Of places of one rank with other gains the nearest as by `RULE`, where runs confirm them, else the first."""
    if not alike:
        return None
    name = _nearest([each.place for each in alike]) if alike[0].doubt is None else alike[0].place.name
    return next(each for each in alike if each.place.name == name)


def _too_low(told: ChangedGains) -> bool:
    """Whether runs refute gains, for the end-point ends too far off its target, and not as they grow."""
    return told.runs is not None and ends_off(told.runs) and not told.runs.growing


def _nearest(places: Sequence[Place]) -> str:
    """The name of that with the least drive among those that are nearly as good as the best."""
    least = _alike(max(place.slowest for place in places))
    return min((place for place in places if place.slowest >= least), key=lambda place: place.drive).name


def _alike(decay: float) -> float:
    """Down to which decay another counts as this one, 1/s."""
    return decay - FASTER * abs(decay)
