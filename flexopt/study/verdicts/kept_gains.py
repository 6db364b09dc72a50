"""Why gains are not to be changed, though others were tried: what these do at best.

In: a decision, the places with the present gains and with others. Out: a sentence.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flexopt.model.loop import Loop, gain_ranges
from flexopt.study.verdicts.changed_gains import ChangedGains, Sought
from flexopt.study.verdicts.decision import (
    BETTER,
    BREAKS,
    FASTER,
    MOST,
    Decision,
    Place,
    faster,
    may_stay,
    nearer,
    percent,
    sound_of,
    spoken,
)  # fmt: skip
from flexopt.study.verdicts.gain_search import RESERVE, gains_looked_at
from flexopt.study.verdicts.places import STAY


def gains_kept(
    asked: Loop,
    sought: Sought | None,
    decision: Decision,
    known: Mapping[str, Place],
    unconfirmed: Mapping[str, str],
) -> str:
    """What was tried of other gains, and by what of `RULE` none are told to be changed to, a sentence.

    Empty where they are, where the decision says it itself, or others were neither tried nor asked for.

    Args:
        asked: of the loop.
        sought: what is found of others; None where none were tried.
        decision: what is told.
        known: places with the present gains, by name.
        unconfirmed: why runs do not confirm these, by name.
    """
    if decision.word == "change gains":
        return ""
    of = f"of {gains_looked_at(asked)}"
    if sought is None:
        return f"{of} none were tried, for every place that was judged breaks constraints" * bool(gain_ranges(asked))
    told = sought.changed
    if told is not None and told.doubt is not None and told.in_words in decision.reason:
        return ""
    staying, others = may_stay(known.get(STAY), unconfirmed), [place for name, place in known.items() if name != STAY]
    tried = list(sought.fastest.values())
    had = [*([] if staying is None else [staying]), *sound_of(others, unconfirmed)]
    if decision.word == "move":
        had = [known[decision.place]]
        tried = [each for each in tried if nearer(each.place, had[0])]
        if not tried:
            return f"{gains_looked_at(asked)} spare no drive: no place is nearer than {decision.place}"
    best = max(tried, key=lambda each: each.place.slowest)
    rival = max(had, key=lambda place: place.slowest, default=None)
    what = f"with gains that hold {100 * (RESERVE - 1):.0f} % higher, too, where any do, " * best.place.holds
    what += f"the best slowest decay found is {best.place.slowest_told}, at {spoken(best.place.name)} "
    what += f"with {best.in_words}"
    what += f" ({best.at_end})" * bool(best.at_end)
    what += "" if rival is None else f", against {rival.slowest_told} at {spoken(rival.name)} with the present ones"
    if not best.place.holds:
        where = "a nearer place" if decision.word == "move" else "a place"
        return f"{of} none keeps {where} stable on every ground: {what}"
    if rival is not None and decision.word == "move" and best.place.slowest < rival.slowest:
        return f"{of} none does as well in a nearer place: {what}"
    if rival is not None and decision.word != "move" and not _much_faster(best.place, rival):
        what = f"{of} none decays {100 * FASTER:.0f} % faster in the worst case than what there is: {what}"
    else:
        what = f"{of} none is told to be changed to: {what}{_but(best, sought, staying)}"
    stay = sought.fastest.get(STAY)
    if decision.word == "cannot tell" and staying is None and stay is not None and stay is not best:
        what += _staying(stay, sought.doubts.get(STAY)) * stay.place.holds
    return what


def _staying(stay: ChangedGains, doubt: str | None) -> str:
    """What the present place does with its best other gains, the end of a sentence."""
    told = (
        f"; the present place is stable on every ground with {stay.in_words}: slowest decay {stay.place.slowest_told}"
    )
    return told if doubt is None else f"{told}{_doubted(doubt)}"


def _doubted(doubt: str) -> str:
    return f", but it {doubt}" if doubt.startswith(BREAKS) else f", but nonlinear runs do not confirm it ({doubt})"


def _much_faster(one: Place, other: Place) -> bool:
    return bool(faster(np.array(one.slowest), np.array(other.slowest)))


def _but(best: ChangedGains, sought: Sought, staying: Place | None) -> str:
    """What speaks against gains with which a place decays fast enough, the end of a sentence."""
    doubt, standing = sought.doubts.get(best.place.name), sought.standing
    if doubt is not None:
        return _doubted(doubt)
    share = 1.0 if standing is None else best.place.better_than(standing)
    if share < MOST:
        how = "as it is" if standing is staying else "with others"
        return f", but it {BETTER} than staying {how} on {percent(share)} of the grounds only"
    return ", but what was tried there does not meet the rule"
