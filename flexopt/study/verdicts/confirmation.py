"""Nonlinear runs of one loop on the members of what is uncertain.

In: a loop in a configuration, members. Out: an ensemble's verdicts, settling times and turns of the base.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from flexopt.errors import FlexoptWarning, InputError, NoSolutionFound
from flexopt.foundation.arrays import Vector
from flexopt.foundation.results import Result
from flexopt.foundation.rounding import apart
from flexopt.loop.levers import full_rates
from flexopt.loop.uncertain import UncertainLoop
from flexopt.model.beyond_limits import holding
from flexopt.model.simulation import on_their_way
from flexopt.plant import build_plant
from flexopt.simulation import simulate_ensemble
from flexopt.simulation.behaviour import FEWEST_WINDOWS
from flexopt.simulation.beyond import NOT_HELD, limit_below
from flexopt.simulation.ensemble import Ensemble, judged_beside
from flexopt.simulation.real_loop import SHORTER, braked, braked_by, run_options
from flexopt.simulation.run import OUTGREW

SHOWN = ("settling_time", "peak_base_rotation", "growth_rate", "start_error", "peak_error", "end_error")
# Length of a run, s: of slow machines so many periods of the slowest mode, at most this time and so many samples.
DURATION, PERIODS, LONGEST, SAMPLES = 20.0, 10, 600.0, 300_000
# Time constants after which what is left is no motion any more, 0.7 %; for so long runs wait for a slow loop, s.
AT_REST, WAITS = 5.0, 60.0
# Longer no run may be, s; shares of rounding.
DURATIONS, ALIKE = 1e4, 1e-6
UNFINISHED = "the integrator could not finish the run"
# Why a run that converges does not confirm; and more where the controller does not know the weight.
OFF = "the end-point does not come to its target: in the end it is"
SHORT = "; the run is short, "
GIVES_WAY = "the end-point comes nearer, but full levers do not hold the arm as it ends:"
INTEGRAL = "an integral part takes it to the target (loop.feedback pid with ki)"
SAGS = (
    "; the controller carries the load of the machine's file, and a heavier or lighter one draws the arm off: "
    f"{INTEGRAL}"
)
TILTS = (
    "; on these springs the base stands otherwise, so that the arm weighs otherwise on its joints than the controller "
    f"carries: {INTEGRAL}"
)
# With an integral part and drives that yield to a load.
UNTIL = (
    "; another load than the machine's file has draws the arm until the integral part has caught up: a larger "
    "loop.servo_gain, or ki, keeps it nearer"
)
# Of the weight, what is none; of what a full lever bears, what an arm that has crept onto it is off that.
ROUNDING, ON_FULL_LEVER = 1e-9, 1e-3
# What runs may show; of several the first that one of them shows.
WORST_FIRST = ("grows", "undecided", "converges")


@dataclass(frozen=True)
class Runs(Result):
    """What n nonlinear runs show.

    Attributes:
        verdicts: `"converges"`, `"grows"` or `"undecided"` of each, (n,); see `flexopt.Ensemble`.
        settling: of each, s; NaN where it does not.
        turn: largest turn of the base in each, rad.
        decay: as the run shows it, 1/s.
        nearer: whether the end-point ends no farther from its target than it began, and half as far as it ever was.
        reasons: why each does not confirm that the loop is stable and brings the end-point nearer, empty where it does.
        duration: of a run, s.

    A run that the integrator could not finish grows where the linear loop does, and is undecided elsewhere.
    """

    verdicts: tuple[str, ...]
    settling: Vector
    turn: Vector
    decay: Vector
    nearer: tuple[bool, ...]
    reasons: tuple[str, ...]
    duration: float

    DOCUMENT = "members converging confirming verdicts settling[s] turn[rad] decay[1/s] nearer reasons duration[s]"

    @property
    def members(self) -> int:
        """How many."""
        return len(self.verdicts)

    @property
    def converging(self) -> float:
        """Share of them."""
        return self._share("converges")

    @property
    def growing(self) -> float:
        """Share of those that grow."""
        return self._share("grows")

    @property
    def undecided(self) -> float:
        """Share of those of which run and eigenvalues do not say the same, or the run is too short."""
        return self._share("undecided")

    @property
    def confirming(self) -> float:
        """Share of those that converge and bring the end-point nearer."""
        return sum(not reason for reason in self.reasons) / len(self.reasons)

    def _share(self, word: str) -> float:
        return self.verdicts.count(word) / len(self.verdicts)


def long_enough(modes_hz: Iterable[float], rate: float, least: float = DURATION, decays: Iterable[float] = ()) -> float:
    """How long a run takes to show whether the slowest of these modes grows, s; and that what decays is at rest.

    For what decays more slowly than a minute shows no run waits.
    """
    slowest_hz, longest = min(modes_hz), min(LONGEST, SAMPLES / rate)
    slow = max((AT_REST / decay for decay in decays if decay * WAITS >= AT_REST), default=0.0)
    least = max(least, min(slow, SAMPLES / rate))
    # Of what is slower still no run can tell, of members with half the frequency, too.
    return max(least, min(PERIODS / slowest_hz, longest)) if slowest_hz * longest >= 2 * FEWEST_WINDOWS else least


def ends_off(runs: Runs | None) -> bool:
    """Whether there is one of these that is long enough and does not confirm, for the end-point ends too far off."""
    return runs is not None and any(OFF in why and SHORT not in why for why in runs.reasons)


def nonlinear_runs(loop: UncertainLoop, members: Vector, decays: Vector, duration: float) -> Runs:
    """Runs of the nonlinear closed loop from the start of `flexopt.simulate`, one for each member (n, k).

    `decays` (n,) are those of the linear loops.
    """
    waits = [on_their_way(loop.box.numbers(u)[1], loop.settings.rate) for u in members]
    verdicts = ["grows" if decay < 0 else "undecided" for decay in decays.tolist()]
    least = float(np.min(decays, initial=np.inf, where=decays > 0))
    found, nearer, reasons = np.full((3, len(members)), np.nan), [False] * len(members), [UNFINISHED] * len(members)
    if unheld := _unheld(loop):
        waits, reasons = [], [unheld] * len(members)
    for wait in sorted(set(waits)):
        rows = [k for k, each in enumerate(waits) if each == wait]
        for some, ensemble in _ensembles(loop, members, decays, rows, duration):
            data = {name: ensemble.dataset[name].to_numpy() for name in SHOWN}
            found[:, some] = [data["settling_time"], data["peak_base_rotation"], -data["growth_rate"]]
            # Under a weight that the controller knows wrong a redundant arm creeps, and may rest nowhere.
            beside = [
                loop.outcome(members[row]).loop if isinstance(own, str) else own
                for row, own in zip(some, ensemble.linear_loops, strict=True)
            ]
            judgements = judged_beside(ensemble, beside)
            errors = zip(*(data[f"{name}_error"] for name in ("start", "peak", "end")), strict=True)
            crept = ensemble.last_postures
            held = [loop.posture] * len(some) if crept is None else crept
            each = zip(some, judgements, beside, held, errors, strict=True)
            for row, own, linear, posture, (start, peak, end) in each:
                verdicts[row], nearer[row] = own.verdict, bool(end <= peak / 2 and end <= start)
                # That a load draws the arm away tells more than what becomes of the base meanwhile.
                confirms = own.verdict == "converges"
                whys = [] if confirms else [f"{own.verdict}: {own.reason}"]
                if not nearer[row] if confirms else end > start and decays[row] > 0:
                    short = _short(float(decays[row]) * duration, AT_REST / least)
                    # What swings for longer than a load is being taken up is none of its doing.
                    swings = isinstance(linear, str) or linear.frequency_hz > 0
                    until = UNTIL * (not swings)
                    sags = _sags(loop, members[row], posture, until) or tilts(loop, members[row], float(end))
                    # What a full lever does not bear no longer run shows.
                    off = f"{OFF} {_off_told(start, peak, end)}"
                    whys.append(f"{off}{sags if sags.startswith(',') else short + sags}")
                elif confirms and (full := _full_levers(loop, members[row], posture)):
                    whys.append(f"{GIVES_WAY}{full.removeprefix(', and')}")
                # Without a rest nothing that a run shows is about one.
                reasons[row] = too_weak(loop, members[row]) or "; ".join(whys)
    return Runs(tuple(verdicts), *found, nearer=tuple(nearer), reasons=tuple(reasons), duration=duration)


def _off_told(start: float, peak: float, end: float) -> str:
    """How far off an end-point that does not come nearer is in the end, and what would have confirmed it, m."""
    most, of = min((peak / 2, "half of its largest"), (start, "as far as it began"))
    number = apart(end, (most,))
    return f"{number(end)} m off, where at most {number(most)} m ({of}) would confirm"


def _unheld(loop: UncertainLoop) -> str:
    """Why no run holds the arm in a posture beyond its limits; empty where one does."""
    try:
        holding(loop.box.machine, loop.posture)
    except InputError as error:
        return f"no run holds the arm beyond its limits: {'; '.join(map(str, error.faults))}"
    return ""


def _short(over: float, needed: float) -> str:
    """That a run lasts only so many time constants of its slowest motion, and how long five of the place's last, s."""
    if not 0 < over < AT_REST * (1 - ALIKE):
        return ""
    step = 10.0 ** (math.floor(math.log10(needed)) - 1)
    longest = f"{math.ceil(needed / step - ALIKE) * step:g} s"
    long = f" ({AT_REST:g} of the slowest on any ground take {longest})" if needed < DURATIONS else ""
    return f"{SHORT}{over:.2g} time constants of the slowest motion{long}"


def _sags(loop: UncertainLoop, u: Vector, posture: Vector, until: str) -> str:
    """That the controller carries another weight than the member has, and what helps; empty where it has the right one.

    Full levers may not bear the difference, and without an integral part the arm hangs where its feedback does.
    `posture`: in which the run ends;  `until`: what is told of drives with one.
    """
    settings = loop.settings
    if not _unknown_load(loop, u, loop.posture).any():
        return ""
    integrates = settings.feedback == "pid" and bool(np.all(settings.ki[settings.kp > 0] > 0))
    until = until if settings.drive == "velocity" else ""
    # One that its levers did not bear may have fallen to where they do.
    full = _full_levers(loop, u, loop.posture) or _full_levers(loop, u, posture)
    return full or (until if integrates else SAGS)


def _unknown_load(loop: UncertainLoop, u: Vector, posture: Vector) -> Vector:
    """By how much more joints carry (n,) than the controller takes them to, N m or N; 0 where that is rounding."""
    plant = build_plant(loop.box.machine)
    at = plant.rest(loop.base, posture, loop.box.nominal)
    each = (plant.gravity(at, loop.base, p).full().ravel() for p in (loop.box.numbers(u)[0], loop.box.nominal))
    own, known = (weight[plant.n_passive :] for weight in each)
    more: Vector = own - known
    return more if loop.gravity and np.abs(more).max() > ROUNDING * np.abs(known).max() else np.zeros_like(more)


def tilts(loop: UncertainLoop, u: Vector, end: float) -> str:
    """That other springs alone draw the arm off by most of `end`, m, and what helps; else empty."""
    return TILTS if loop.off_target(loop.outcome(u)) > end / 2 else ""


def too_weak(loop: UncertainLoop, u: Vector | None) -> str:
    """Which joint's weight at rest its drive's torque limit does not carry, of a member as of `outcome`; else empty."""
    limit, machine = loop.settings.torque_limit, loop.box.machine
    if limit is None or not loop.gravity or not (point := loop.outcome(u)).rests:
        return ""
    plant, p = build_plant(machine), loop.box.nominal if u is None else loop.box.numbers(u)[0]
    weight = plant.gravity(point.configuration, loop.base, p).full().ravel()[plant.n_passive :]
    return limit_below(machine, weight, limit, "loop.torque_limit")


def _full_levers(loop: UncertainLoop, u: Vector, posture: Vector) -> str:
    """Which joint's full lever bears less than a load that the controller does not know; empty where all do."""
    machine, settings, more = loop.box.machine, loop.settings, _unknown_load(loop, u, posture)
    # Without a speed no lever is known to be full.
    if settings.drive != "velocity" or machine.joints_without_speed:
        return ""
    # A drive pushes against what draws it.
    rates = full_rates(machine, posture)
    bears = settings.servo_gain * np.where(more > 0, rates[:, 1], rates[:, 0])
    k = int(np.argmax(np.abs(more) / np.maximum(bears, np.finfo(np.float64).tiny)))
    if abs(more[k]) < (1 - ON_FULL_LEVER) * bears[k]:
        return ""
    unit = "N m" if machine.joint_units[k] == "rad" else "N"
    load = f"at {machine.joints[k]} the load is another than the file's by {abs(more[k]):.3g} {unit}"
    hangs = abs(more[k]) <= (1 + ON_FULL_LEVER) * bears[k]
    of_it = "all that a full lever bears" if hangs else f"of which a full lever bears {bears[k]:.3g}"
    return f", and {load}, {of_it}; a larger loop.servo_gain bears more"


def of_all(each: Sequence[Runs]) -> Runs:
    """The worst of runs of the same members at several targets: one that grows at any target grows."""
    if len(each) == 1:
        return each[0]
    words, whys = (list(zip(*(getattr(runs, name) for runs in each), strict=True)) for name in ("verdicts", "reasons"))
    verdicts = tuple(next(word for word in WORST_FIRST if word in some) for some in words)
    settling, turn = (np.array([getattr(runs, name) for runs in each]).max(axis=0) for name in ("settling", "turn"))
    decay = np.array([runs.decay for runs in each]).min(axis=0)
    nearer = tuple(map(all, zip(*(runs.nearer for runs in each), strict=True)))
    reasons = tuple(_worst_reason(*both) for both in zip(words, whys, strict=True))
    return Runs(verdicts, settling, turn, decay, nearer, reasons, each[0].duration)


def _worst_reason(words: Sequence[str], reasons: Sequence[str]) -> str:
    """Of one member at each target: why the worst of its runs does not confirm; empty where all do."""
    k = min((WORST_FIRST.index(word), not why, k) for k, (word, why) in enumerate(zip(words, reasons, strict=True)))[-1]
    return reasons[k] and f"at target {k + 1} {reasons[k]}"


def _ensembles(
    loop: UncertainLoop, members: Vector, decays: Vector, rows: list[int], duration: float
) -> Iterator[tuple[list[int], Ensemble]]:
    """Ensembles of these members, together where that can be, else one by one; not of all.

    Shorter steps are tried where the linear loop decays: what grows outgrows them as well, at 64 times the cost.
    """
    try:
        yield rows, _ensemble(loop, members[rows], duration, None)
    except NoSolutionFound:
        alone_again = (None,) if len(rows) > 1 else ()
        for row in rows:
            for substeps in SHORTER if decays[row] >= 0 else alone_again:
                try:
                    alone = _ensemble(loop, members[[row]], duration, substeps)
                except NoSolutionFound:
                    continue
                yield [row], alone
                break


def _ensemble(loop: UncertainLoop, members: Vector, duration: float, substeps: int | None) -> Ensemble:
    s, machine = loop.settings, loop.box.machine
    brakes = braked_by(machine, s, gravity=loop.gravity)
    each = [loop.box.numbers(u) for u in members]
    varied, nominal = np.array([p for p, _ in each]) + brakes, loop.box.nominal + brakes
    moved = np.flatnonzero(np.any(varied != nominal, axis=0)).tolist() or [0]
    vary = {machine.parameters[k].name: varied[:, k] for k in moved} | {"delay": [late for _, late in each]}
    with warnings.catch_warnings():
        # Here that is a verdict as others are.
        warnings.filterwarnings("ignore", f".*({OUTGREW}|{NOT_HELD})", FlexoptWarning)
        return simulate_ensemble(
            braked(holding(machine, loop.posture), brakes), loop.posture, base=loop.base, vary=vary,
            gravity=loop.gravity, substeps=substeps, duration=duration, **run_options(machine, s),
        )  # fmt: skip
