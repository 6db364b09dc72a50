"""The verdict on a run: what it shows, beside the eigenvalues of the linear loop about the place where it ends.

In: measures of a run, and the loop that was run. Out: one word and the sentence that says why. A run alone can be too
short for a slow mode, and its integrator can damp a mode by itself; eigenvalues alone know small motions only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from flexopt.errors import FlexoptError
from flexopt.foundation.arrays import Vector
from flexopt.foundation.doubt import with_doubt
from flexopt.foundation.kept import by_machine
from flexopt.loop.loop_motions import NOWHERE_HELD, falling
from flexopt.loop.spectrum import CAUSES, from_sample_to_sample, too_much
from flexopt.loop.tangent import Tangent, at_rest
from flexopt.model import AnyMachine
from flexopt.model.simulation import Actuator, SimulationOptions
from flexopt.plant import build_plant
from flexopt.simulation.behaviour import ROUNDING, Grounds, Shown
from flexopt.simulation.beyond import limit_below
from flexopt.simulation.linear import SampledLoop, bare_scenario, coordinates, loop_about, self_motion, where_held
from flexopt.simulation.scenario import Scenario

LoopVerdict = Literal["converges", "grows", "undecided"]
# Damping ratio below which a loop's swing goes on for periods.
LASTING = 0.1
# By how much, ln of amplitudes, one of two motions is gone beside the other; what a beat makes of a slope (`beating`).
BOTH, BEAT = 3.0, 0.5 / math.sqrt(2)
# A run grows as the self-motion drifts, to this factor.
DRAWN = 3.0
# By which share an arm's self-motion must grow within a run to be told of.
CREEPS = 0.01
# ln of amplitudes by which what begins as rounding comes to be the largest.
OUT_OF_ROUNDING = -math.log(ROUNDING) / 2
NO_REST = "near its end the loop rests nowhere"


@dataclass(frozen=True)
class Judgement:
    """A verdict and what it rests on.

    Attributes:
        verdict: `"converges"` or `"grows"` where run and eigenvalues say the same, else `"undecided"`.
        reason: both, in a sentence.
    """

    verdict: LoopVerdict
    reason: str


@dataclass(frozen=True)
class Arrived:
    """Where a redundant arm came to along its self-motion.

    Attributes:
        joint: the one that moved most, and by how much, in words.
        linear: the linear loop about rest there.
    """

    joint: str
    linear: SampledLoop


class Ran(Protocol):
    """The loop that was run, of which a reason asks what sets run and eigenvalues apart."""

    @property
    def too_weak(self) -> str:
        """Which drive's `torque_limit` is below the weight where the loop rests without it; empty where none is."""
        ...

    @property
    def integrator(self) -> str:
        """Of the run."""
        ...

    def integrated(self) -> float | None:
        """Growth rate of the linear loop as the run's integrator makes it, 1/s; None where it is not to be had."""
        ...

    def arrived(self) -> Arrived | None:
        """Where the arm came to; None of an arm that has no self-motion, and where no rest is near the run's end."""
        ...


@dataclass(frozen=True)
class Ended:
    """The loop that was run, and where it came to.

    Attributes:
        machine, options: of the run, checked.
        x: states at its end.
        e: signals there where base or target were moved; else None: it goes on about its design.
        table: of a file, in which the limits of its drives are.
    """

    machine: AnyMachine
    options: SimulationOptions
    x: Vector | None = None
    e: Vector | None = None
    table: str = "actuator"

    @property
    def too_weak(self) -> str:
        """See `Ran`."""
        if not may_be_too_weak(self.options):
            return ""
        try:
            bare = bare_scenario(self.machine, self.options, paths=self.e is not None)
        except FlexoptError:
            return ""
        total = bare.loop.signals.total
        x, e = (bare.resting, np.zeros(total)) if self.e is None else (self.x, self.e[:total])
        return "" if x is None else too_weak(bare, x, e, self.options.actuator, self.table)

    @property
    def integrator(self) -> str:
        """See `Ran`."""
        return self.options.integrator

    def linear(self, without: tuple[str, ...] = ()) -> SampledLoop | str:
        """The linear loop about rest, exact between the samples; a sentence where there is none.

        `without`: names of gains that are left out.
        """
        if self.e is None or self.x is None:
            return _about_design(self.machine, _essential(self.options), without)  # pyright: ignore[reportArgumentType]
        try:
            bare = bare_scenario(self.machine, self.options, paths=True)
            return about(_without(bare, without), self.x, self.e[: bare.loop.signals.total])
        except FlexoptError as error:
            return str(error)

    def integrated(self) -> float | None:
        """See `Ran`."""
        moved = self.e is not None and self.x is not None
        try:
            bare = bare_scenario(self.machine, self.options, exact=False, paths=moved)
        except FlexoptError:
            return None
        total = bare.loop.signals.total
        if self.e is not None and self.x is not None:
            return growth_about(bare, self.x, self.e[:total])
        return growth_about(bare, bare.resting, np.zeros(total))

    def arrived(self) -> Arrived | None:
        """See `Ran`."""
        if self.e is not None or self.x is None:
            return None
        try:
            bare = bare_scenario(self.machine, self.options)
        except FlexoptError:
            return None
        return arrived_at(bare, self.x, np.zeros(bare.loop.signals.total))


def grounds_of(scenario: Scenario) -> Grounds:
    """What its runs are judged by: where the arm drifts also the slowest swing of its loop about the design.

    A swing that is damped more is over within a period or two.
    """
    found = scenario.grounds
    linear = Ended(scenario.machine, scenario.options).linear() if found.bends else ""
    if isinstance(linear, str):
        return found
    poles = linear.poles
    swings = np.abs(poles.imag[(poles.imag > 0) & (-poles.real < LASTING * np.abs(poles))]) / (2 * math.pi)
    return replace(found, swing_hz=min([found.slowest_hz, *swings.tolist()]))


def _essential(options: SimulationOptions) -> SimulationOptions:
    """The options without those that the linear loop does not depend on."""
    start = {"duration": 10.0, "offset": None, "seed": 0, "baked": False, "integrator": "rk4", "substeps": None}
    return options.model_copy(update=start)


@by_machine
def _about_design(machine: AnyMachine, options: SimulationOptions, without: tuple[str, ...]) -> SampledLoop | str:
    try:
        bare = bare_scenario(machine, options)
        return about(_without(bare, without), bare.resting, np.zeros(bare.loop.signals.total))
    except FlexoptError as error:
        return str(error)


def _without(scenario: Scenario, names: tuple[str, ...]) -> Scenario:
    """The scenario with these constants zero."""
    zeros = {name: np.zeros_like(scenario.parts[name], dtype=np.float64) for name in names}
    return replace(scenario, parts={**scenario.parts, **zeros})


def about(scenario: Scenario, x: Vector, e: Vector) -> SampledLoop | str:
    """The linear loop about the rest that is found from a state."""
    found = _rest(scenario, x, e)
    try:
        return NO_REST if found is None else loop_about(scenario, found[0], e, found[1])
    except FlexoptError as error:
        return str(error)


def may_be_too_weak(options: SimulationOptions) -> bool:
    """Whether drives are limited that bear a weight."""
    return options.gravity and options.actuator.torque_limit is not None


def too_weak(scenario: Scenario, x: Vector, e: Vector, actuator: Actuator, table: str) -> str:
    """Which drive gives less than the weight in the rest found from a state, else in that state; empty where none."""
    found, s = _rest(scenario, x, e), scenario
    if not np.all(np.isfinite(x)) or actuator.torque_limit is None:
        return ""
    plant, q = build_plant(s.machine), coordinates(s, x if found is None else found[0])
    weight: Vector = plant.gravity.call([q, s.base, s.p])[0].full().ravel()[plant.n_passive :]
    return limit_below(s.machine, weight, actuator.torque_limit, f"{table}.torque_limit", actuator.dead_band)


def growth_about(scenario: Scenario, x: Vector, e: Vector) -> float | None:
    """Growth rate of the like, 1/s; None where there is none."""
    found = _rest(scenario, x, e)
    try:
        return None if found is None else loop_about(scenario, found[0], e, found[1]).growth_rate
    except FlexoptError:
        return None


def arrived_at(scenario: Scenario, x: Vector, e: Vector) -> Arrived | None:
    """Where a redundant arm's run that ends in a state x came to beside the rest of its design; see `Ran`."""
    s, m = scenario, len(scenario.q_design) - len(scenario.posture)
    if s.loop.shape.n_joints <= s.loop.shape.n_task:
        return None
    held = where_held(s)
    design, rest = None if held is None else _rest(s, held, e), _rest(s, x, e)
    if design is None or rest is None:
        return None
    moved = (coordinates(s, rest[0]) - coordinates(s, design[0]))[m:]
    k = int(np.argmax(np.abs(moved)))
    try:
        linear = loop_about(s, rest[0], e, rest[1])
    except FlexoptError:
        return None
    return Arrived(f"{s.machine.joints[k]} by {moved[k]:+.3g} {s.machine.joint_units[k]}", linear)


def _rest(scenario: Scenario, x: Vector, e: Vector) -> tuple[Vector, Tangent] | None:
    """The state of rest that is found from another, and the linear loop there."""
    if not np.all(np.isfinite(x)):
        return None
    return at_rest(scenario.loop.structure, x, e, scenario.constants, self_motion(scenario, x))


def judge(
    run: Shown,
    linear: SampledLoop | str,
    ended: Ended | None = None,
    *,
    rests: bool = False,
    ran: Ran | None = None,
) -> Judgement:
    """The verdict; with `ended` or `ran` the reason can name what hides what the loop does.

    `rests`: whether the loop is that about where the run comes to rest, which another load may draw away.
    """
    found = _judged(run, linear, ended, rests, ran)
    who = ended if ran is None else ran
    weak = "" if who is None else who.too_weak
    if not weak:
        return found
    # Nothing that the base does while the arm falls is about a rest.
    word: LoopVerdict = "undecided" if found.verdict == "converges" else found.verdict
    return Judgement(word, f"{found.reason}; {weak}")


def _judged(run: Shown, linear: SampledLoop | str, ended: Ended | None, rests: bool, ran: Ran | None) -> Judgement:
    run = replace(run, error=math.hypot(run.error, beating(linear, run.duration)))
    said = f"the run of {run.duration:g} s {_words(run)}"
    if isinstance(linear, str):
        # Alone, a decay must be larger than what it may be off by.
        sure = run.significant and (run.word == "grows" or not abs(run.rate) <= run.error)
        word: LoopVerdict = run.word if sure and not run.short else "undecided"
        return Judgement(word, f"{said}; there are no eigenvalues beside it: {linear}")
    rate, known = linear.growth_rate, abs(linear.growth_rate) > linear.rounding
    eigenvalues: LoopVerdict = ("grows" if rate > 0 else "converges") if known else "undecided"
    verb = {"grows": "grows", "converges": "decays", "undecided": "neither grows nor decays"}[eigenvalues]
    why = alternating(linear, ended)
    there = " about the rest that it comes to" if rests or (ended is not None and ended.e is not None) else ""
    how = f"{verb} (decay {-rate:+z.4g}/s at {linear.frequency_hz:.4g} Hz{why})"
    falls = -rate <= falling(1 / linear.period)
    if falls:
        how = f"falls: {NOWHERE_HELD}"
    other = f"the linear loop{there} {how}"
    creeps = [own for own in linear.drift[:1] if own * run.duration > CREEPS]
    other += "".join(f", the arm's self-motion drifts (decay {-own:+.3g}/s)" for own in creeps)
    if run.short and not (run.ended < run.duration and eigenvalues == "grows"):
        needed = f"four periods of the slowest mode, {run.slowest_hz:.4g} Hz, undisturbed"
        return Judgement("undecided", f"{said}, too short to tell: it takes {needed}; {other}")
    away = max(linear.drift, default=0.0) * run.duration
    if eigenvalues == run.word == "converges" and away > 1:
        return Judgement("undecided", f"{said}; {other}: within the run the arm leaves its posture along it")
    if eigenvalues == run.word:
        return Judgement(run.word, f"{said}; {other}")
    if eigenvalues == "undecided":
        return Judgement("undecided", f"{said}, but {other}, to rounding")
    if falls:
        return Judgement("undecided", f"{said}, but {other}")
    return Judgement("undecided", f"{said}, but {other}: {_why(run, linear, ended if ran is None else ran)}")


def beating(linear: SampledLoop | str, duration: float) -> float:
    """What the slope of an amplitude may be off by, 1/s, where motions beat more slowly than half the run lasts.

    A beat of Δω, of which a fit sees a part, tilts the logarithm ln|1 + r e^{jΔω t}| of two amplitudes 1 and r by
    Δω r/√2 in the mean over phases: r = 1/2 is taken. Of motions that are both there when the fit begins.
    """
    if isinstance(linear, str):
        return 0.0
    poles = linear.poles
    swings = poles[(poles.imag > 0) & np.isfinite(poles)]
    if not swings.size:
        return 0.0
    there = swings[(swings.real.max() - swings.real) * duration / 2 < BOTH]
    beats = np.abs(there.imag[:, None] - there.imag[None, :])
    return BEAT * float(np.max(beats, initial=0.0, where=beats * duration / 2 < 2 * math.pi))


def alternating(linear: SampledLoop, ended: Ended | None) -> str:
    """What makes the loop grow where it changes its sign at every sample; empty where it does not."""
    if ended is None or ended.options.feedback == "robust":
        return ""
    names = too_much(linear, ended.options.model_dump(include=set(CAUSES)), ended.linear)
    return from_sample_to_sample(names, 1 / linear.period)


def _why(run: Shown, linear: SampledLoop, ran: Ran | None) -> str:
    """What sets run and eigenvalues apart."""
    rate = linear.growth_rate
    if rate < 0 < run.rate < DRAWN * max(linear.drift, default=0.0):
        return "the arm's self-motion, which the controller does not hold, takes the base with it"
    own = None if ran is None else ran.integrated()
    # As slow as the self-motion drifts it is that, and none of the loop's.
    tells = own is not None and abs(own) > max(linear.rounding, DRAWN * max(linear.drift, default=0.0))
    if own is not None and ran is not None and tells and (own > 0) != (rate > 0):
        return f"the integrator {ran.integrator} makes the decay {-own:+.4g}/s; more substeps or another show the loop"
    arrived = None if ran is None else ran.arrived()
    there = 0.0 if arrived is None else arrived.linear.growth_rate
    if arrived is not None and there * rate < 0 and abs(there) > arrived.linear.rounding:
        verb = "grows" if there > 0 else "decays"
        there_told = f"about which the linear loop {verb} (decay {-there:+.4g}/s)"
        return f"along its self-motion the arm ends in another posture, {arrived.joint}, {there_told}"
    # However little of a motion there is at first, it would have shown by then, or gone.
    long = run.ended < run.duration or abs(rate) * run.duration > OUT_OF_ROUNDING
    whys = ["too large for a linear loop"] if long else ["too short to show it", "too large for a linear loop"]
    if own is None and rate > 0:
        whys.append("damped by its own integrator")
    if long and rate > 0:
        whys.append("without any of that motion")
    # Drives that follow rates brake it, and leave one eigenvalue 1 of each of its directions instead of two.
    if rate < 0 and linear.neutral and not linear.drift:
        whys.append("drawn along by the arm's self-motion, which nothing brakes")
    listed = ", ".join(whys[:-1])
    return f"the run is {listed and f'{listed}, or '}{whys[-1]}"


def _words(run: Shown) -> str:
    if run.ended < run.duration:
        return f"grows out of the finite numbers at {run.ended:.4g} s"
    if math.isnan(run.rate):
        return "never moves the base"
    if run.levelled:
        return f"grows to {run.grown:.2g} times its first amplitude, hardly further in its second half"
    if run.word == "grows":
        verb = "grows" if run.rate > 0 else "does not clearly decay"
    else:
        verb = "decays" if run.rate < 0 else "does not clearly grow"
    if abs(run.rate) < run.error:
        verb = "neither clearly grows nor decays"
    return f"{verb} (decay {with_doubt(-run.rate, run.error, 4, '+')}/s)"
