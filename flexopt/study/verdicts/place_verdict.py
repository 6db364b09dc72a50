"""What is said of one place, with bands over what is uncertain, as numbers and as text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from flexopt.foundation.arrays import Vector
from flexopt.foundation.plain import listed
from flexopt.foundation.results import Result
from flexopt.selection.constraint_values import resting_told
from flexopt.selection.constraints.corners import WHERE
from flexopt.selection.constraints.joint_limits import LIMITS
from flexopt.study.verdicts.broken_places import Breaks
from flexopt.study.verdicts.confirmation import Runs

# How names of a variable's ends end.
END = " bound"


@dataclass(frozen=True)
class Band(Result):
    """A measure at the machine's own numbers, and its least and greatest among the members looked at."""

    nominal: float
    least: float
    greatest: float


@dataclass(frozen=True)
class PlaceVerdict(Result):
    """What the loop does in one place; of several targets every number is that of the worst.

    Attributes:
        name: `"stay"`, or `"candidate 1"` and so on, by rank of the selection.
        base, posture: of the machine, m or rad;  w: measures w_i there. Of K targets a row for each: (K, n_b), (K, n).
        drive, turn: from the present placement, and along a way, m and rad.
        decay: of the sampled loop, 1/s; its least is the slowest that a search with gradients found in the box, too;
            of an arm that falls, for feedback is not found to hold its weight, −710 times the rate of samples.
        stable_share: of the members.
        slowest_at: the member with the slowest decay: factors and values by name;  slowest_hz: its frequency;
            slowest_target: at which target, from 0;  unseen: whether that is a mode which neither moves the end-point
            nor is excited by any feedback: its rate is the machine's own.
        self_motion: share of its kinetic energy that the slowest motion has in a redundant arm's self-motion; NaN where
            nothing acts on that, or there is none.
        drift: the largest growth rate found of a redundant arm's self-motion, which is no part of the decay, among the
            members and by a search from there, 1/s; NaN where nothing acts on it, or there is none.
        drift_at: the member where that is: factors and values by name.
        unheld: torques, N m, and forces, N, by joint, with which a weight that the controller does not know drives a
            redundant arm's self-motion, where that is most (`unheld_at`); see `flexopt.Region`.
        rests_off: how far from its target the end-point comes to rest at most, m, among the members and corners: where
            another weight, or other springs under it, draw an arm whose feedback has no integral part; of those on
            which it does not grow, NaN where it grows, or falls, on all.
        rests_off_at: the member where that is: factors and values by name; empty where it comes to its target.
        better: share of the members on which it decays a tenth faster than in the present place.
        allowed_gain, delay_margin: as of `evaluate`; the least over the members, across the box through the worst of
            them and where a search leads from there, the greatest that of few corners; NaN where there is no border.
            Where it grows on some ground the allowed gain of that one is the largest lower one with which it decays,
            and with the least of all it may grow on another.
        settling, swing: over corners of the first intervals, where slopes lead from the worst of these, and the slowest
            member: of the standard move (see `flexopt.Outcome`), s, and the base's largest turn about one of its
            axes, rad, of a base that cannot turn its largest shift, m (`swing_unit`).
        runs: nonlinear ones; None where none were asked for.
        rests_on: at each target the bounds and constraints that hold with equality.
        breaks: what it breaks of constraints that were asked for, in words: what its loop does not do of what it must,
            as with other gains than a candidate was chosen with (of staying see `present_breaks`), and what is broken
            at corners of what is uncertain, assumed limits and ground, too, and where; empty where nothing.
        breaks_at_rest: the same where feedback without an integral part holds the end-point beside its target
            (`rests_off`), at the corners;  breaking: all of it, kind by kind.
        beyond_limits: which joints it holds beyond the limits of the machine's file, a sentence, of a choice that left
            these out; empty where none.
        cornerless: of names in `rests_on` that end with a corner of `constraints.within`, those without it.
        too_weak: which joint's weight at rest is above `loop.torque_limit`, with the file's numbers, at a corner of
            what is uncertain or in the slowest member, in words; empty where none is.
    """

    name: str
    base: Vector
    posture: Vector
    w: Vector
    drive: float
    turn: float
    decay: Band
    stable_share: float
    slowest_at: dict[str, float]
    slowest_hz: float
    slowest_target: int
    unseen: bool
    self_motion: float
    drift: float
    drift_at: dict[str, float]
    unheld: dict[str, float]
    unheld_at: dict[str, float]
    rests_off: float
    rests_off_at: dict[str, float]
    better: float
    allowed_gain: Band
    delay_margin: Band
    settling: Band
    swing: Band
    swing_unit: str
    runs: Runs | None
    rests_on: tuple[tuple[str, ...], ...]
    breaking: Breaks = field(repr=False)
    beyond_limits: str = ""
    cornerless: Mapping[str, str] = field(default_factory=dict[str, str], repr=False)
    too_weak: str = ""

    DOCUMENT = """
    name base posture w drive[m] turn[rad] decay[1/s] stable_share slowest_at slowest_hz[Hz] slowest_target unseen
    self_motion drift[1/s] drift_at unheld unheld_at rests_off[m] rests_off_at better allowed_gain delay_margin[s]
    settling[s] swing swing_unit runs rests_on breaks breaks_at_rest
    beyond_limits too_weak
    """

    @property
    def breaks(self) -> str:
        """See the class."""
        return "; ".join(filter(None, (self.breaking.by_loop, self.breaking.somewhere)))

    @property
    def breaks_at_rest(self) -> str:
        """See the class."""
        return self.breaking.at_rest

    @property
    def stands(self) -> list[tuple[Vector, Vector]]:
        """Placement and posture at each target."""
        postures = self.posture.reshape(-1, self.posture.shape[-1])
        return list(zip(self.base.reshape(len(postures), self.base.shape[-1]), postures, strict=True))

    @property
    def rest(self) -> str:
        """On which bounds and constraints it rests, a sentence; empty where on none."""
        count, at = len(self.rests_on), dict[str, list[int]]()
        for k, names in enumerate(self.rests_on, start=1):
            for name in resting_told(names, self.cornerless):
                at.setdefault(name, []).append(k)
        told = [
            name if len(where) == count else f"{name} at target {listed(map(str, where))}" for name, where in at.items()
        ]
        stopped = (
            "; runs know no end stops, so that in them a joint may go beyond its end"
            if self.runs and self._on_a_joint
            else ""
        )
        return f"{self.name} rests on {', '.join(told)}{stopped}" if told else ""

    @property
    def broken(self) -> str:
        """What it breaks where other numbers than the file's hold, a sentence; empty where nothing."""
        told = "; constraints.within of these numbers keeps constraints there, too"
        # What its loop does not do is nothing of statics.
        return (
            self.breaks
            and f"{self.name} {self.breaks}{told * (WHERE in self.breaks and self.breaking.sought != 'none')}"
        )

    @property
    def broken_at_rest(self) -> str:
        """What it breaks beside its target, a sentence; empty where nothing."""
        told = "constraints.within takes the end-point to be on its target, as an integral part brings it there"
        return self.breaks_at_rest and f"{self.name}, at rest beside its target, {self.breaks_at_rest}; {told}"

    @property
    def unconfirmed(self) -> str:
        """Why the first of the nonlinear runs that does not confirm a stable loop does not; empty where all do."""
        words = zip(self.runs.verdicts, self.runs.reasons, strict=True) if self.runs else ()
        # That a loop grows where its eigenvalues do is no news.
        return next((why for word, why in words if why and (word != "grows" or self.decay.least > 0)), "")

    @property
    def _on_a_joint(self) -> bool:
        names = {name for each in self.rests_on for name in each}
        return any((name.endswith(END) or name.startswith(LIMITS)) and not name.startswith("base.") for name in names)

    @property
    def shown_runs(self) -> str:
        """What the nonlinear runs show, in words; empty without any."""
        runs = self.runs
        if runs is None:
            return ""
        shares = (("converge", runs.converging), ("grow", runs.growing), ("undecided", runs.undecided))
        told = ", ".join(f"{100 * share:.0f} % {what}" for what, share in shares if share)
        # The base may come to rest, and the end-point not to its target.
        return f"{told} ({100 * runs.confirming:.0f} % confirm)" if runs.confirming < runs.converging else told
