"""Why gains are not to be changed, though the loop has ranges for others: what these do at best.

In: a decision, the places with the present gains and with others. Out: a sentence.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from flexopt.foundation.plain import listed
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
from flexopt.study.verdicts.gain_search import RESERVE
from flexopt.study.verdicts.places import STAY


def gains_kept(
    ranges: Collection[str],
    sought: Sought | None,
    decision: Decision,
    known: Mapping[str, Place],
    unconfirmed: Mapping[str, str],
) -> str:
    """What was tried of other gains, and by what of `RULE` none are told to be changed to, a sentence.

    Empty where they are, where the decision says it itself, or there are no ranges.

    Args:
        ranges: names of the gains that have some.
        sought: what is found of others; None where none were tried.
        decision: what is told.
        known: places with the present gains, by name.
        unconfirmed: why runs do not confirm these, by name.
    """
    if not ranges or decision.word == "change gains":
        return ""
    which = listed(f"{name}_range" for name in ranges)
    if sought is None:
        return f"of the gains within {which} no others were tried, for every place that was judged breaks constraints"
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
            return f"other gains within {which} spare no drive: no place is nearer than {decision.place}"
    best = max(tried, key=lambda each: each.place.slowest)
    rival = max(had, key=lambda place: place.slowest, default=None)
    what = f"with gains that hold {100 * (RESERVE - 1):.0f} % higher, too, where any do, " * best.place.holds
    what += f"the best slowest decay found is {best.place.slowest_told}, at {spoken(best.place.name)} "
    what += f"with {best.in_words}"
    what += f" ({best.at_end})" * bool(best.at_end)
    what += "" if rival is None else f", against {rival.slowest_told} at {spoken(rival.name)} with the present ones"
    of = f"of other gains within {which}"
    if not best.place.holds:
        where = "a nearer place" if decision.word == "move" else "a place"
        return f"{of} none keeps {where} stable on every ground: {what}"
    if rival is not None and decision.word == "move" and best.place.slowest < rival.slowest:
        return f"{of} none does as well in a nearer place: {what}"
    if rival is not None and decision.word != "move" and not _much_faster(best.place, rival):
        return f"{of} none decays {100 * FASTER:.0f} % faster in the worst case than what there is: {what}"
    return f"{of} none is told to be changed to: {what}{_but(best, sought, staying)}"


def _much_faster(one: Place, other: Place) -> bool:
    return bool(faster(np.array(one.slowest), np.array(other.slowest)))


def _but(best: ChangedGains, sought: Sought, staying: Place | None) -> str:
    """What speaks against gains with which a place decays fast enough, the end of a sentence."""
    doubt, standing = sought.doubts.get(best.place.name), sought.standing
    if doubt is not None:
        return f", but it {doubt}" if doubt.startswith(BREAKS) else f", but nonlinear runs do not confirm it ({doubt})"
    share = 1.0 if standing is None else best.place.better_than(standing)
    if share < MOST:
        how = "as it is" if standing is staying else "with others"
        return f", but it {BETTER} than staying {how} on {percent(share)} of the grounds only"
    return ", but what was tried there does not meet the rule"
