"""What a decision's reason says beside the rule: of the present place, of gains, of places left out, what to measure.

In: a `Decision` and what it was made of. Out: the decision with more of its reason, or a sentence.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.foundation.plain import listed
from flexopt.loop.spectrum import from_sample_to_sample
from flexopt.loop.uncertain import UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox, matters_most
from flexopt.selection import SelectionProblem
from flexopt.selection.outcomes.result import ChosenByLoop
from flexopt.selection.problem import elsewhere, reached, with_angles
from flexopt.study.verdicts.broken_places import Breaks
from flexopt.study.verdicts.changed_gains import ChangedGains
from flexopt.study.verdicts.confirmation import INTEGRAL
from flexopt.study.verdicts.decision import BETTER, MOST, Decision, Place, Word, deciding, percent, spoken
from flexopt.study.verdicts.place_loops import MEMBERS, Chosen, PlaceLoops, Slowest, held_otherwise, problems_of
from flexopt.study.verdicts.place_verdict import PlaceVerdict

# With these words the machine keeps its place and its gains for now.
KEPT: tuple[Word, ...] = ("stay", "cannot tell")


def sought_by(chosen: Chosen) -> str:
    """By what places were sought, and where of all that is uncertain, within a sentence."""
    everywhere = isinstance(chosen, ChosenByLoop) and len(chosen.uncertainty)
    return f"{chosen.objective}{' in the worst case' * bool(everywhere)}"


def breaking_told(chosen: Chosen, breaks: Breaks, now: Sequence[tuple[Vector, Vector]], stay: Place) -> str:
    """That the present place breaks constraints, now or on some ground, and in which posture where none was given.

    And that it is not stable where it is not.
    """
    problem, *others = problems_of(chosen)
    given = not others and problem.present_posture is not None
    if others:
        how = "as breaks the least and is best of these" if breaks.now else "as is best"
        held = f", held {how} by {chosen.objective} at each target,"
    else:
        several = "in one of the postures that reach the target" * (not given and held_otherwise(problem))
        how = _beside_target(problem, now) if given else several
        held = f", {how}," if how else ""
    # With the file's numbers that is known.
    may = not breaks.now and not given and any(map(held_otherwise, (problem, *others)))
    others_may = "; held in another posture it may break none" * may
    others_may += ", and constraints.within of these numbers has one looked for that breaks none there" * (
        may and bool(breaks.somewhere) and breaks.sought == "all"
    )
    return f"the present place{held} {breaks.now or breaks.otherwise}{stay.grows_told}{others_may}"


def _beside_target(problem: SelectionProblem, held: Sequence[tuple[Vector, Vector]]) -> str:
    """How far the end-point is off the target of one problem, within a sentence; empty where it is there."""
    z = np.concatenate(next(iter(held)))
    off = float(np.linalg.norm(reached(problem, z) - problem.target))
    return f"the end-point {off:.3g} m off its target{with_angles(problem.machine)}" if elsewhere(problem, z) else ""


def with_new_gains(decision: Decision, confirmed: ChangedGains | None) -> Decision:
    """The decision to change gains, with what else is to be known of these."""
    if confirmed is None or decision.word != "change gains":
        return decision
    reason = "; ".join(filter(None, (decision.reason, confirmed.at_end, confirmed.staying)))
    return replace(decision, reason=reason, passed_over=confirmed.passed_over)


def with_present(
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
            seeks = ": constraints.within seeks places that keep them there" * (breaks[name].sought == "all")
            told = f"{better} breaks constraints on some{seeks}"
        else:
            told = f"{better} at rest beside its target {broken}: {INTEGRAL}, a higher Kp brings it nearer"
        if kind == "at_rest" and decision.word == "stay":
            decision = Decision("cannot tell", name, f"{told}; {decision.reason}")
        else:
            decision = replace(decision, reason=f"{decision.reason}; {told}")
    return decision


def with_alternates(decision: Decision, loops: Mapping[str, PlaceLoops], slowest: Mapping[str, Slowest]) -> Decision:
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


def to_measure(
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
        return f"most is told by measuring {which}: {what} goes with it (rank correlation {rank:+.2f})"
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
