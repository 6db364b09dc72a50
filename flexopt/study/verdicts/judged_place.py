"""One place judged: its loops' measures over what is uncertain, as bands.

In: a place's loops, its decays over the members, its runs. Out: a `PlaceVerdict`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.loop.evaluation import swing_unit
from flexopt.loop.lag import LaggedModes
from flexopt.loop.standard_move import MOVE
from flexopt.loop.uncertain import FEW, SENSES, UncertainLoop
from flexopt.loop.uncertainty_box import member_in_words
from flexopt.model.beyond_limits import beyond_limits_told
from flexopt.model.choices import ALLOWED_GAIN, DELAY_MARGIN, SETTLING, SWING
from flexopt.selection.broken import cornerless
from flexopt.study.verdicts.broken_places import Breaks, breaks_of
from flexopt.study.verdicts.changed_gains import ChangedGains
from flexopt.study.verdicts.confirmation import Runs, too_weak
from flexopt.study.verdicts.decision import faster, spoken
from flexopt.study.verdicts.place_loops import (
    MEMBERS,
    Chosen,
    Configurations,
    PlaceLoops,
    Slowest,
    problems_of,
    resting_at,
)
from flexopt.study.verdicts.place_verdict import Band, PlaceVerdict


def judged_place(
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
    """A place, with its decays on the members `points` (K, k), at the worst target of each, and what is known of it."""
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
        too_weak=_too_weak(place, members),
    )


def judged_with_gains(
    changed: ChangedGains,
    stands: Mapping[str, Configurations],
    points: Vector,
    drives: Mapping[str, tuple[float, float]],
    chosen: Chosen,
    stay: Vector | None,
) -> PlaceVerdict:
    """The place with other gains, judged as the others are with the present ones.

    `stay`: decays (n,) of the present place with these; None where there is none.
    """
    loop, name = changed.loop, changed.place.name
    decays = loop.decays(points)
    slowest, worst = loop.slowest(points, decays), decays.min(axis=0)
    held = [(each.base, each.posture) for each in stands[name]]
    breaks = breaks_of(chosen, loop, held)
    better = math.nan if stay is None else float(np.mean(faster(worst, stay)))
    return judged_place(
        name, stands[name], loop, points, worst, better, slowest, drives[name], changed.runs, chosen, breaks
    )


def _too_weak(place: PlaceLoops, members: Sequence[Vector | None]) -> str:
    """At which target and of which of these members a torque limit does not carry the weight; empty where of none."""
    for k, loop in enumerate(place.loops, start=1):
        for u in members:
            if told := too_weak(loop, u):
                at = f", at target {k}" * (len(place.loops) > 1)
                return f"{told}{at}" + ("" if u is None else f", at {member_in_words(place.box.told(u))}")
    return ""


def _is_unseen(loop: UncertainLoop, slowest: Slowest) -> bool:
    """Whether the slowest motion is a mode that neither moves the end-point nor is excited by it, whatever the loop."""
    point = loop.outcome(slowest.member)
    return LaggedModes(point.motions).is_unseen(point.numbers, slowest.decay, point.loop.rounding)


def _rows(each: Sequence[Vector]) -> Vector:
    """Of one target the numbers themselves, of several a row for each."""
    return each[0] if len(each) == 1 else np.array(each)
