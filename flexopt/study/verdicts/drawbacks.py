"""What is worse where a verdict sends the machine, or with the gains to change to, in words.

In: a `Verdict`. Out: sentences. Every number is the verdict's own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from flexopt.loop.standard_move import MOVE, UNSETTLED
from flexopt.selection.constraints.corners import WHERE
from flexopt.selection.several import BasePlan
from flexopt.simulation.beyond import NOT_HELD
from flexopt.study.verdicts.decision import BETTER, FASTER, MOST, percent, spoken
from flexopt.study.verdicts.place_verdict import PlaceVerdict
from flexopt.study.verdicts.places import FIRST, STAY

if TYPE_CHECKING:
    from flexopt.study.verdicts.result import Verdict

# From how far off its target on a place is told to rest there where there is nothing to compare it with, m.
FAR_OFF = 0.01
# Of what grows there is no rest.
NOT_WHERE_IT_GROWS = "not counting where it grows"
# What is broken by no more than `HARDLY`.
SO_LITTLE = "which counts as kept, for weights and springs are not known to so little"


def drawbacks_of(verdict: Verdict) -> str:
    """See `Verdict`; empty where there are none."""
    stay, now = verdict.stay, next((place for place in verdict.places if place.name == verdict.place), None)
    there = verdict.with_gains or now
    if verdict.word == "cannot tell" or there is None:
        return ""
    no_better = _no_better(verdict, there)
    way = verdict.selection.broken_between if isinstance(verdict.selection, BasePlan) and verdict.place == FIRST else ()
    rest = f"at rest beside its target {spoken(there.name)} {there.breaks_at_rest}" if there.breaks_at_rest else ""
    rest += f", {SO_LITTLE}" * ("at_rest" in there.breaking.hardly)
    no_better = "; ".join(filter(None, (no_better, rest, too_weak_told(there), *way)))
    stay = now if verdict.with_gains and stay is None else stay
    if stay is None or verdict.word not in ("move", "change gains"):
        return no_better
    how, found = "with the new gains it" if verdict.with_gains else "it", _worse(verdict, there, stay)
    beside = ", beside the present ones where it stands" * (verdict.with_gains is not None and verdict.place != STAY)
    parts = [f"{', '.join(found)} there{beside * (verdict.stay is not None)}"] if found else []
    # Where it grows on all grounds there is no less to compare with.
    if math.isnan(stay.rests_off) and there.rests_off >= FAR_OFF:
        parts.append(f"comes to rest {there.rests_off:.3g} m off the target{' there' * (not found)}")
    told = f"in the worst case {how} {', and '.join(parts)}" if parts else ""
    few = verdict.with_gains is not None and stay.decay.least > 0 and there.better < MOST
    than = f"than where it stands with the present ones on {percent(there.better)} of the grounds only"
    return "; ".join(filter(None, (f"with the new gains it {BETTER} {than}" * few, told, no_better)))


def too_weak_told(place: PlaceVerdict) -> str:
    """That no drive holds the arm in a place, within a sentence; empty where one does, and where runs tell it."""
    of_runs = place.runs is not None and any(NOT_HELD in why for why in place.runs.reasons)
    return f"in {spoken(place.name)} {place.too_weak}" if place.too_weak and not of_runs else ""


def _worse(verdict: Verdict, there: PlaceVerdict, stay: PlaceVerdict) -> list[str]:
    """What is worse there than with the present gains where the machine stands, each within a sentence."""
    bears, unit, highest = "bears Kp up to {}", verdict.settings.gain_units[0], verdict.settings.highest_kp
    if verdict.with_gains:
        # Of other gains it is the room above them that counts.
        kp = verdict.settings.kp.tolist()
        bears, unit, highest = "bears {}", "times its gains", highest / first_gain(kp)
        there, stay = _in_gains(there, verdict.gains["kp"]), _in_gains(stay, kp)
    compared = (
        ("decays at {}", "decay", "least", 1.0, "1/s", ""),
        ("settles in {}", "settling", "greatest", 1.0, "s", ""),
        (f"moves the base by {{}} in a move of {MOVE:g} m", "swing", "greatest", 1e3, f"m{there.swing_unit}", ""),
        (bears, "allowed_gain", "least", 1.0, unit, f"above {highest:.4g}"),
        ("bears {} more of dead time", "delay_margin", "least", 1e3, "ms", "any number of"),
    )
    found = list[str]()
    for words, measure, worst, factor, unit, endless in compared:
        value, before = (getattr(getattr(place, measure), worst) for place in (there, stay))
        sense = 1.0 if worst == "greatest" else -1.0
        # Whatever has a border is worse than what has none.
        much = FASTER * abs(before) if math.isfinite(before) else 0.0
        if sense * value > sense * before + much:
            instead = endless if math.isinf(before) else f"{factor * before:.4g}"
            found.append(words.format(f"{factor * value:.4g} instead of {instead} {unit}"))
        elif measure == "settling" and math.isnan(value) and not math.isnan(before):
            found.append(f"does not settle in a minute instead of in {before:.4g} s")
    if there.rests_off >= UNSETTLED and there.rests_off >= (1 + FASTER) * stay.rests_off:
        stands = "where it stands" if verdict.stay else "with the present ones"
        grows = f" ({stands}, {NOT_WHERE_IT_GROWS})" if stay.decay.least <= 0 else ""
        instead = f"instead of {stay.rests_off:.3g} m{grows}"
        found.append(f"comes to rest {there.rests_off:.3g} {instead} off the target")
    return found


def _no_better(verdict: Verdict, there: PlaceVerdict) -> str:
    """What the place of the word breaks, as all others do with the present gains, or hardly; empty where nothing."""
    name, breaking, by_gains = spoken(there.name), there.breaking, ""
    breaks, hardly = breaking.much, "somewhere" in breaking.hardly
    if verdict.with_gains:
        # What is broken on some ground whatever the gains is another matter.
        by_gains, breaks = breaking.by_loop, breaking.somewhere * (not hardly)
    elif there.name == STAY:
        breaks = breaks or verdict.present_breaks
    # Else another place would keep them with its end-point on the target, and this one would be none to move to.
    where = " on some ground" if WHERE in breaks else " with the present gains"
    stay = None if there.name == STAY else verdict.stay
    kept = stay is not None and not (stay.breaking.much or verdict.present_breaks)
    every = breaks and f"every place found{' to move to' * kept} breaks constraints{where}: {name} {breaks}"
    by_gains = by_gains and f"with the new gains {name} {by_gains}"
    return "; ".join(filter(None, (by_gains, every, f"{name} {breaking.somewhere}, {SO_LITTLE}" * hardly)))


def first_gain(kp: Iterable[float]) -> float:
    """That of the first row that has one, of which an allowed gain is."""
    return next((float(x) for x in kp if x > 0), 1.0)


def _in_gains(place: PlaceVerdict, kp: Sequence[float]) -> PlaceVerdict:
    """The place with its least allowed gain in times its own."""
    band = place.allowed_gain
    return replace(place, allowed_gain=replace(band, least=band.least / first_gain(kp)))
