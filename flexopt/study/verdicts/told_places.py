"""Which places a verdict may send to, and which of them it tells of.

In: what each place breaks, its decays over the members. Out: names of places.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.study.verdicts.broken_places import Breaks
from flexopt.study.verdicts.decision import MOST, faster
from flexopt.study.verdicts.places import STAY, TOLD


def with_barring(
    breaks: Mapping[str, Breaks], holds: Callable[[str], bool], reaches: Callable[[str], bool]
) -> dict[str, Breaks]:
    """What each place breaks, and by which of it it is none to move to or to stay at: others break nothing of the kind.

    None that breaks something as it stands is one. Of the others those whose loops do what they must are, where there
    is one; of these those that break nothing on any ground; of these those that break nothing beside their targets,
    where one of them `holds`, which is to say whether it is stable wherever that was looked at: what grows is nowhere
    at rest. What is broken `hardly`, on a ground or at rest, is nothing there. One that does not reach its target, as
    where the arm is held now, keeps nothing in another's stead.
    """
    found = {name: "standing" for name, each in breaks.items() if each.standing}
    for kind in ("by_loop", "somewhere", "at_rest"):
        broken = {name: kind for name, each in breaks.items() if name not in found and _broken(each, kind)}
        keeping = [name for name in breaks if name not in found | broken and reaches(name)]
        if broken and (any(map(holds, keeping)) if kind == "at_rest" else keeping):
            found |= broken
    return {name: each._replace(barring=found.get(name, "")) for name, each in breaks.items()}


def _broken(breaks: Breaks, kind: str) -> bool:
    return bool(getattr(breaks, kind)) and kind not in breaks.hardly


def shares_better(decays: Mapping[str, Vector]) -> dict[str, float]:
    """On which share of the grounds each place is better than the present one; empty where there is none."""
    stay = decays.get(STAY)
    return {} if stay is None else {name: float(np.mean(faster(own, stay))) for name, own in decays.items()}


def first_places(names: Sequence[str], decays: Mapping[str, Vector], slowest: Callable[[str], float]) -> list[str]:
    """The `TOLD` places that are stable on the most grounds and, of these, decay fastest in the worst case found.

    They come ranked by their decays on the members, of which the least is no less than what a search finds: it is asked
    of one after the other until none behind may be better.
    """
    found = dict[str, tuple[float, float]]()
    for name in names:
        share = float(np.mean(decays[name] > 0))
        best = sorted(found.values(), reverse=True)[:TOLD]
        if len(best) == TOLD and (share, float(decays[name].min())) <= best[-1]:
            break
        found[name] = share, slowest(name)
    return sorted(found, key=lambda name: found[name], reverse=True)[:TOLD]


def overlooked(shares: Mapping[str, float], told: Sequence[str]) -> list[str]:
    """The place that is better than the present one on the most grounds, where those told of are so on too few.

    These are stable on the most grounds; what speaks against staying may be another, which grows on some.
    """
    if not shares:
        return []
    first = max(shares, key=lambda name: shares[name])
    return [first] if shares[first] > 1 - MOST >= max(shares[name] for name in told) else []
