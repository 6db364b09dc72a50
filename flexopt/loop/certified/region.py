"""How far the machine may be from its numbers before a loop grows: the largest box of factors that is stable.

In: a machine in a posture, its loop, ranges of what is uncertain. Out: a `Region`: what was found by looking and by a
search with exact gradients, and where zero exclusion over boxes proves it, a guarantee.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np

from flexopt.errors import InputError, raise_if_any
from flexopt.foundation.arrays import BaseLike, Document, PostureLike, Progress, Vector
from flexopt.foundation.boundary import public, whole
from flexopt.foundation.control import Control
from flexopt.foundation.documents import provenance
from flexopt.foundation.plain import listed
from flexopt.foundation.results import Result
from flexopt.foundation.stages import Stages
from flexopt.loop.beside_decay import BesideDecay
from flexopt.loop.certified.certificate import BOXES, DECAY, RegionProof, certified_radius, certify
from flexopt.loop.evaluation import settings_at
from flexopt.loop.loop_motions import NOWHERE_HELD, falling
from flexopt.loop.outcome import LoopPoint
from flexopt.loop.settings import LoopSettings
from flexopt.loop.spectrum import (
    OTHER_WEIGHT,
    UNBRAKED,
    drifting_self_motion,
    driven_self_motion,
    mostly_self_motion,
    slow_self_motion,
)
from flexopt.loop.standard_move import UNSETTLED
from flexopt.loop.uncertain import MEMBERS, UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox, member_in_words
from flexopt.model import AnyMachine
from flexopt.model.beyond_limits import most_beyond
from flexopt.model.loop import Loop, LoopLike
from flexopt.model.uncertainty import GROUND, RangesLike, Uncertainty

# Largest factor that a radius is looked for up to, how exactly (of its logarithm), and points looked at in each box.
LARGEST, EXACT, POINTS = 10.0, 1e-3, 64
# How often the box that a guaranteed radius is looked for in is halved, as long as a smaller one may prove more.
TRIES = 4


@dataclass(frozen=True)
class Region(Result):
    """Whether a loop is stable over all that is uncertain, and how much more it would bear.

    Attributes:
        stable: whether the loop decays everywhere: False where at a point it does not; None where none was found, and
            the boxes looked at prove nothing either; True where it is guaranteed, and of what the proof does not speak
            of (`rests_on` says why) where no point looked at grows.
        guaranteed: whether it is proven that the exact sampled loop decays, faster than 1e-6/s, everywhere in the
            ranges: see `rests_on`.
        rests_on: what the word stands on, a sentence.
        certified: share of the ranges (of the logarithms of factors) in which that is proven.
        boxes: how many parts of the ranges the proof looked at.
        points: how many points were looked at.
        decay: the slowest found within the ranges, 1/s; negative where the loop grows.
        critical: where that is: factors and values by name;  frequency_hz: of the slowest motion there.
        radius: the largest s found, 10 at most, so that nothing looked at grows with every factor within [1/s, s], what
            has values at its nominal one; NaN where no range is a factor, 1 where the nominal loop grows.
        radius_guaranteed: the largest s, at most `radius`, up to which that is proven; 1 where nothing is.
        radius_critical: the factors at which it grows first, just outside; empty where it never does, and where the
            nominal loop grows.
        drift: the largest growth rate found within the ranges, 1/s, of a redundant arm's self-motion, which is no part
            of decay, radius or proof; NaN where nothing acts on it, or there is none.
        drift_critical: where that is, as `critical`.
        unheld: torques, N m, and forces, N, by joint, with which a weight that the controller does not know drives a
            redundant arm's self-motion, where that is most (`unheld_at`): no feedback of the end-point holds them, and
            the arm moves off. 0 of a joint of which it is nowhere 1 % of what that carries, empty where it is of none.
        rests_off: how far beside its target feedback holds the end-point at rest, m, at most, of what was found
            (`rests_off_at`), not counting where the loop grows: it is looked at about there; NaN where no member looked
            at comes to rest.
        rests_beyond: how far joints are beyond their limits there, rad or m, by joint, where one is the farthest of
            what was found (`rests_beyond_at`), 0 of those within; empty where all are.
        self_motion, radius_self_motion: share of its kinetic energy that the slowest motion has in the arm's
            self-motion, at `critical` and at `radius_critical`: of most a drift of the arm that is taken for the loop's
            as it moves the base; NaN where nothing acts on the self-motion, or there is none.
        settings: the loop's numbers, and where those come from that were not given.
        provenance: machine, versions and options, the posture and the ranges among them.

    Example:
        >>> machine, posture = flexopt.load("excavator"), (0.0448, -2.0499)
        >>> region = flexopt.stable_region(machine, posture, loop={"kp": 1e4, "kv": 1e3})
        >>> region.guaranteed, region.radius > 2
        (True, True)
    """

    stable: bool | None
    guaranteed: bool
    rests_on: str
    certified: float
    boxes: int
    points: int
    decay: float
    critical: Mapping[str, float]
    frequency_hz: float
    radius: float
    radius_guaranteed: float
    radius_critical: Mapping[str, float]
    drift: float
    drift_critical: Mapping[str, float]
    unheld: Mapping[str, float]
    unheld_at: Mapping[str, float]
    rests_off: float
    rests_off_at: Mapping[str, float]
    rests_beyond: Mapping[str, float]
    rests_beyond_at: Mapping[str, float]
    self_motion: float
    radius_self_motion: float
    settings: LoopSettings
    provenance: Document = field(repr=False)

    DOCUMENT = """
    stable guaranteed rests_on certified boxes points decay[1/s] critical frequency_hz[Hz] radius radius_guaranteed
    radius_critical drift[1/s] drift_critical unheld unheld_at rests_off[m] rests_off_at rests_beyond rests_beyond_at
    self_motion radius_self_motion settings provenance
    """

    def __repr__(self) -> str:
        word = {True: "stable", False: "not stable", None: "undecided"}[self.stable]
        verb = "decays" if self.decay > 0 else "grows"
        how = f"{verb} at {abs(self.decay):.4g}/s" if self.decay else "does not decay"
        lines = [f"{word}, {'guaranteed' if self.guaranteed else 'not guaranteed'}: {self.rests_on}"]
        where = member_in_words(self.critical) + _told_own(self.self_motion)
        lines.append(f"  slowest found: {how}, {self.frequency_hz:.4g} Hz, at {where}")
        if self.decay <= falling(self.settings.rate):
            lines.append(f"  that rate stands for an arm that falls: there {NOWHERE_HELD}")
        if self.stable is None:
            lines.append("  more `boxes` than it was allowed let the proof go on, in the shell --boxes")
        if not math.isnan(self.radius):
            first = member_in_words(self.radius_critical)
            ends = "as it is in the file it does not decay"
            ends = f"none grows up to {self.radius:.4g}" if self.radius > 1 else ends
            own = _told_own(self.radius_self_motion)
            ends = f"grows just outside {self.radius:.4g}, at {first}{own}" if first else ends
            proven = self.radius_guaranteed
            bound = f"guaranteed up to a factor of {proven:.4g}" if proven > 1 else "no factor is guaranteed"
            lines.append(f"  radius, of the factors alone, all else as in the file: {bound}; {ends}")
        lines += [f"  {sentence}" for sentence in self._drifts]
        resting = "" if self.decay > 0 else ", not counting where it grows"
        if self.rests_off >= UNSETTLED:
            off = f"{self.rests_off:.3g} m off its target at rest, at {member_in_words(self.rests_off_at)}"
            most = f"the most that was found{resting}: the loop is that about there"
            lines.append(f"  {OTHER_WEIGHT} holds the end-point {off}, {most}")
        if self.rests_beyond:
            each = zip(self.rests_beyond.items(), self.settings.joint_units, strict=True)
            by = listed(f"{name} by {by:.3g} {unit}" for (name, by), unit in each if by > 0)
            where = member_in_words(self.rests_beyond_at)
            most = f"the most that was found{resting}; no stop is in the loop"
            lines.append(f"  beyond its limits at rest: {by}, at {where}, {most}")
        loop = repr(self.settings).splitlines()[0]
        return "\n".join([*lines, f"  loop: {loop}", *self.settings.proposed])

    @property
    def _drifts(self) -> list[str]:
        """What is told of the self-motion: that nothing brakes it, and how it drifts or lasts at worst."""
        own = [self.drift]
        worst = (*drifting_self_motion(own), *slow_self_motion(own, self.decay))
        where = f"the worst found, at {member_in_words(self.drift_critical)}; no part of the radius"
        driven = driven_self_motion(self.unheld, self.settings.joint_units, f"at {member_in_words(self.unheld_at)}")
        return [UNBRAKED] * self.settings.lets_drift + [f"{each}, {where}" for each in worst] + driven


def _told_own(share: float) -> str:
    return "".join(f" ({told})" for told in mostly_self_motion(share))


@public(points=whole(2, 1_000_000), boxes=whole(0, 1_000_000))
def stable_region(
    machine: AnyMachine,
    posture: PostureLike,
    *,
    base: BaseLike | None = None,
    control: Control | None = None,
    gravity: bool = False,
    loop: LoopLike | None = None,
    ranges: RangesLike | None = None,
    points: int = POINTS,
    boxes: int = BOXES,
    progress: Progress | None = None,
) -> Region:
    """Whether a loop stays stable over what is uncertain, the least stable point, and the radius of stability.

    Args:
        machine, posture, base, control, gravity, loop: as of `flexopt.outcome`.
        ranges: what is uncertain, as of `flexopt.verdict`; by default the machine's `[[uncertainty]]`, or where there
            is none one factor ½ to 2 of all springs.
        points: how many are looked at in each box, corners first, besides the searches from the slowest of them.
        boxes: about how many parts of the ranges the proof may look at, and of each of the boxes, four at most, that
            a guaranteed radius is looked for in; 0: none.
        progress: called with how many of these parts are done, and of all that may be looked at.

    The proof excludes zeros of the characteristic function of the exact sampled loop from e^{(jω − ρ)T}, ρ = 1e-6/s, by
    the control points of Bernstein polynomials in ω and all that is uncertain, with bounds on what interpolation and
    aliases leave and rounding inflated, 64 units of the largest entry of each column; it is no interval arithmetic
    throughout. It speaks of springs, dampers, masses and dead time, with filters, servos and integrals, and of
    redundant arms; not of weight, of a damper of the self-motion, nor of machines with modes above half the sampling
    rate.

    Raises:
        InputError, SingularPosture, NoSolutionFound: as `flexopt.outcome`.

    Example:
        >>> machine = flexopt.load("excavator")
        >>> found = flexopt.stable_region(machine, (0.0448, -2.0499), loop={"kp": 1e4, "kv": 1e3})
        >>> found.stable, found.guaranteed
        (True, True)
    """
    known = cast("tuple[Uncertainty, ...]", ranges or machine.uncertainty or GROUND)
    asked, held, placed = cast("Loop | None", loop), cast(Vector, posture), cast("Vector | None", base)
    settings, where = settings_at(machine, held, placed, control, asked, gravity=gravity, call="stable_region")
    box = UncertaintyBox(machine, known, settings.dead_time)
    raise_if_any(InputError, "stable_region", box.faults(settings.rate))
    whole_box = UncertainLoop(settings, where, held, gravity, box)
    stages = Stages(progress, (1 + TRIES) * boxes)
    slowest, at, looked = _slowest(whole_box, points)
    proof = certify(whole_box, boxes=boxes, told=stages.reach) if slowest > DECAY and boxes else None
    growing = [leaf for leaf in proof.leaves if leaf.decays is False] if proof else []
    for leaf in growing:
        here = (leaf.low + leaf.high) / 2
        decay = -whole_box.outcome(here).loop.growth_rate
        slowest, at = min((slowest, at), (decay, here), key=lambda each: each[0])
    radius, first, own, more = _radius(whole_box, points)
    stages.reach(boxes)
    radius_guaranteed = _radius_guaranteed(whole_box, radius, boxes, stages)
    few = np.vstack([box.members(points)[:MEMBERS], at])
    resting = [whole_box.outcome(u) for u in few] if gravity else []
    beside = BesideDecay.of(whole_box, few, resting)
    rests_beyond, rests_beyond_at = _beyond_limits(box, few, resting)
    last = whole_box.outcome(at).loop
    stages.reach(stages.total)
    guaranteed = proof is not None and proof.share(None) == 0 and not growing
    return Region(
        stable=_word(slowest, proof, guaranteed=guaranteed),
        guaranteed=guaranteed,
        rests_on=_rests_on(proof, looked, slowest, guaranteed=guaranteed),
        certified=proof.share(True) if proof else 0.0,
        boxes=proof.boxes if proof else 0,
        points=looked + more,
        decay=slowest,
        critical=box.told(at),
        frequency_hz=last.frequency_hz,
        radius=radius,
        radius_guaranteed=radius_guaranteed,
        radius_critical=first,
        drift=beside.drift,
        drift_critical=beside.drift_at,
        unheld=beside.unheld,
        unheld_at=beside.unheld_at,
        rests_off=beside.rests_off,
        rests_off_at=beside.rests_off_at,
        rests_beyond=rests_beyond,
        rests_beyond_at=rests_beyond_at,
        self_motion=last.self_motion,
        radius_self_motion=own,
        settings=settings,
        provenance=provenance(
            machine,
            base=where,
            posture=held,
            control=settings.control,
            gravity=gravity,
            loop=asked and asked.model_dump(exclude_unset=True),
            ranges=[each.model_dump(exclude_none=True) for each in known],
            points=points,
            boxes=boxes,
        ),
    )


def _beyond_limits(
    box: UncertaintyBox, members: Vector, points: Sequence[LoopPoint]
) -> tuple[dict[str, float], dict[str, float]]:
    """How far joints rest beyond their limits in that of members (n, k) where one is the farthest, and what it is.

    `points`: the loop of each; none without weight, for then the arm rests where it is held.
    """
    # What grows comes to no rest.
    resting = [k for k, point in enumerate(points) if point.loop.growth_rate <= point.loop.rounding]
    each = {k: most_beyond(box.machine, points[k].posture) for k in resting}
    most = max(each, key=lambda k: max(each[k].values(), default=0.0), default=None)
    return (each[most], box.told(members[most])) if most is not None and each[most] else ({}, {})


def _word(slowest: float, proof: RegionProof | None, *, guaranteed: bool) -> bool | None:
    if slowest <= 0:
        return False
    return True if guaranteed or proof is None or proof.sentence else None


def _rests_on(proof: RegionProof | None, looked: int, slowest: float, *, guaranteed: bool) -> str:
    if slowest <= 0:
        return "a point that grows" if slowest < 0 else "a point that neither grows nor decays, to rounding"
    if proof is None:
        return f"sampled at {looked} points, no proof was asked for or possible"
    if proof.sentence:
        return f"sampled at {looked} points; no proof: {proof.sentence}"
    how = f"zero exclusion over {proof.boxes} boxes, {proof.cells} cells of frequency"
    if guaranteed:
        return f"decays faster than {DECAY:g}/s by {how}, the exact sampled loop, rounding inflated"
    return f"sampled at {looked} points, none grows; {how} prove {proof.share(True):.1%} of the ranges"


def _radius_guaranteed(loop: UncertainLoop, radius: float, boxes: int, stages: Stages) -> float:
    """The largest proven radius up to that which was found; 1 where nothing is."""
    if math.isnan(radius) or radius <= 1 or not boxes:
        return radius if math.isnan(radius) else 1.0
    size, best = math.log(radius), 1.0
    for k in range(TRIES):
        # Over smaller boxes less is left open.
        if math.exp(size) <= best:
            break
        begun = (1 + k) * boxes

        def told(spent: float, begun: float = begun) -> None:
            stages.reach(begun + spent)

        best = max(best, certified_radius(_scaled(loop, size), size, boxes=boxes, told=told))
        size /= 2
    return min(best, radius)


def _scaled(loop: UncertainLoop, size: float) -> UncertainLoop:
    """The loop with every factor within e^±size, what has values at its nominal one."""
    ends, factors = (math.exp(-size), math.exp(size)), [x for x in loop.box.uncertainty if x.factor is not None]
    scaled = tuple(each.model_copy(update={"factor": ends}) for each in factors)
    return replace(loop, box=replace(loop.box, uncertainty=scaled))


def _slowest(loop: UncertainLoop, points: int) -> tuple[float, Vector, int]:
    """The slowest decay found in the box, where, and how many points were looked at."""
    members = loop.box.members(points)
    found, at = loop.slowest(members, loop.decays(members))
    return found, at, len(members)


def stability_radius(loop: UncertainLoop, points: int = POINTS) -> float:
    """Radius of a loop's factors, as of `Region`."""
    return _radius(loop, points)[0]


def _radius(loop: UncertainLoop, points: int) -> tuple[float, dict[str, float], float, int]:
    """Radius, the factors just outside at which it grows, `radius_self_motion`, how many points were looked at."""
    factors = tuple(each for each in loop.box.uncertainty if each.factor is not None)
    if not factors:
        return math.nan, {}, math.nan, 0
    if not loop.outcome().loop.stable:
        return 1.0, {}, math.nan, 1

    low, high, looked, first, own = 0.0, math.log(LARGEST), 0, dict[str, float](), math.nan
    tried = high
    while high - low > EXACT:
        here = _scaled(loop, tried)
        decay, at, count = _slowest(here, points)
        looked += count
        if decay > 0:
            low = tried
            if tried == high:
                break
        else:
            high, first, own = tried, here.box.told(at), here.outcome(at).loop.self_motion
        tried = (low + high) / 2
    return min(math.exp(low), LARGEST), first, own, looked
