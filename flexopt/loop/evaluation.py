"""All that a loop does in one posture, as numbers: what `flexopt.evaluate` says of it."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from flexopt.errors import FlexoptWarning
from flexopt.foundation.arrays import BaseLike, PostureLike, Vector
from flexopt.foundation.boundary import public
from flexopt.foundation.control import Control
from flexopt.foundation.doubt import in_degrees
from flexopt.foundation.plain import listed
from flexopt.foundation.results import Result
from flexopt.foundation.rounding import without_rounding
from flexopt.loop.lag import LaggedModes
from flexopt.loop.outcome import MEASURES, LoopPoint
from flexopt.loop.settings import LoopSettings, loop_settings
from flexopt.loop.spectrum import UNBRAKED, drifting_self_motion, from_sample_to_sample, slow_self_motion
from flexopt.model import AnyMachine
from flexopt.model.loop import Loop, LoopLike, control_of, under_control
from flexopt.robustness import Evaluation, build_measures, evaluate
from flexopt.robustness.evaluation import evaluate_checked, unreached

# Oscillations beside those of the modes that are told.
OTHERS = 4
# Derivatives by measure, then by what: "base", "posture", "parameters", gains, dead time and drives.
SlopesOfMeasures = Mapping[str, Mapping[str, Vector]]


@dataclass(frozen=True)
class Outcome(Result):
    """What a loop does in one posture. m modes, ordered as those of the machine; NaN (JSON: null) where there is none.

    Attributes:
        settings: the loop's numbers, and where they come from.
        allowance, allowance_isotropic: κ_i = 4 ζ_i ω_i / |w_i|, the largest velocity gain in any direction before mode
            i grows, and 2 ζ_i ω_i / (−a_i·b_i), the same for Kv = kv I, (m,), in `settings.force_units`; infinite
            (JSON: null) where no gain does. ζ_i is with the joints' velocity servos, to first order in their damping,
            which for strong ones is more than the mode gains from them: `damping_ratios` have it exactly.
        lag, lag_reserve: ψ_i, by which the feedback of the end-point's rate is behind it at ω_i (dead time, half a
            sample, filter, servos, and that Kp acts on the position), and what is left of it before equal gains feed
            the mode, (m,), rad; negative where they do; NaN (JSON: null) of a mode that no feedback reaches.
        first_order_decay: ζ_i ω_i + Im(b_iᵀ F(jω_i) a_i) / (2 ω_i), (m,), 1/s: ζ_i with the joints' velocity servos, F
            the lagging feedback; exact for small gains, `frequencies_hz` and `damping_ratios` for all. Where
            `first_order_fails` it says nothing of this loop, nor do `allowance` and `lag_reserve`.
        w_lagged: w_i with that lag, a_i·b_i cos ψ_i − sqrt(|a_i|²|b_i|² − (a_i·b_i)² sin² ψ_i), (m,), as w.
        frequencies_hz, damping_ratios: |s|/2π and −Re s/|s| of the oscillation s that each mode has become in the
            sampled loop, (m,): the one in whose energy the springs of that mode have the largest share, all modes
            together.
        other_frequencies_hz, other_damping_ratios: of the loop's further oscillations that are slower than the fastest
            of these, in frequency or decay, the slowest decay first, (k,): of the arm under its feedback.
        decay: of the slowest motion of the sampled loop, 1/s; negative where it grows. decay_rounding: one that is
            nearer to 0 than this, 1/s, is neither growth nor decay. frequency_hz: at which that motion swings,
            |Im s|/2π, the less below |s|/2π the less it is damped. unseen: whether it is a mode that neither moves the
            end-point nor is excited by it, which decays by itself, whatever the loop.
        too_much: names of the gains that make a loop grow which changes its sign at every sample: without these, and
            no fewer, no such motion grows. Empty where it does not.
        drift: growth rates of a redundant arm's self-motion, which is no part of the decay, 1/s. drifts_below: whether
            below the least stable gains what grows is mostly that motion, which moves the end-point there.
        allowed_gain: largest stable Kp along the present ratio of the gains, NaN where no row has one; gain_intervals:
            all stable intervals of it, (k, 2), between 10⁻⁴ and 10⁴ times the present gains. Where these lie in none,
            the largest stable ones below, 0 where none is found; infinite (JSON: null) where no border is met.
        delay_margin: dead time that may be added to the end-point's measurement, s. Infinite (JSON: null) where none is
            too long; NaN of a loop that grows. Its gradient is NaN where the dead time would exceed 100 samples.
        disk_margin, sensitivity_peak, complementary_peak: α, ‖S‖∞ and ‖T‖∞, the loop broken at the law's force.
        h2_norm: root of the end-point's variance at the samples under white noise of unit intensity in every force on
            the base, m (m √s per N s and the like); NaN of a loop that grows, infinite where a row has no Kp.
        settling, swing: of the standard move, in which the end-point starts beside its target along one task row, the
            worst row: after which time |e| stays below 2 % of its start, s, NaN where it does not in a minute; and the
            base's largest turn about one of its axes, rad (of a base that cannot turn a shift, m: `swing_unit`), for
            each m of the move: without `gravity` what motion alone makes of it. An elastic root of the arm, which gives
            in a way in which the base gives already, is no part of the base. The commands show the error from the
            start, so that the first dead time does not count; the move starts where one of them changes. Without what
            drifts of it, where a `drift` is 0 or above; what dies away is part of it, however slowly.
        gradient: exact derivatives of each of these by `base`, `posture`, `parameters`, `kp`, `kv`, `ki`, `dead_time`
            and the drives' numbers; (m, size) of what there is for each mode. NaN where eigenvalues meet. By a dead
            time of whole samples those are of a longer one; of settling and swing NaN where
            two rows, or two peaks, are the worst alike.

    Example:
        >>> machine, posture = flexopt.load("excavator"), (0.0448, -2.0499)
        >>> found = flexopt.outcome(machine, posture, loop={"kp": 1e4, "kv": 1e3})
        >>> found.decay > 0, found.allowance.shape
        (True, (3,))
        >>> round(found.delay_margin, 4)  # s
        0.0193
    """

    settings: LoopSettings
    allowance: Vector
    allowance_isotropic: Vector
    lag: Vector
    lag_reserve: Vector
    first_order_decay: Vector
    w_lagged: Vector
    frequencies_hz: Vector
    damping_ratios: Vector
    other_frequencies_hz: Vector
    other_damping_ratios: Vector
    decay: float
    decay_rounding: float
    frequency_hz: float
    unseen: bool
    drift: tuple[float, ...]
    allowed_gain: float
    gain_intervals: tuple[tuple[float, float], ...]
    delay_margin: float
    disk_margin: float
    sensitivity_peak: float
    complementary_peak: float
    h2_norm: float
    settling: float
    swing: float
    swing_unit: str
    too_much: tuple[str, ...]
    drifts_below: bool
    gradient: SlopesOfMeasures

    DOCUMENT = """
    settings allowance allowance_isotropic lag[rad] lag_reserve[rad] first_order_decay[1/s] w_lagged frequencies_hz[Hz]
    damping_ratios other_frequencies_hz[Hz] other_damping_ratios
    decay[1/s] decay_rounding[1/s] frequency_hz[Hz] unseen drift[1/s] allowed_gain gain_intervals
    delay_margin[s] disk_margin sensitivity_peak complementary_peak h2_norm settling[s] swing swing_unit gradient
    """

    @property
    def mode_decay(self) -> Vector:
        """2π f ζ of the oscillation that each mode has become, exactly, (m,), 1/s; negative where it grows."""
        return math.tau * self.frequencies_hz * self.damping_ratios

    @property
    def first_order_fails(self) -> NDArray[np.bool_]:
        """Whether δ₁ = `first_order_decay` is off δ = `mode_decay` by more than the smaller of both, (m,).

        |δ₁ − δ| > min(|δ₁|, |δ|): one is more than twice the other, or they differ in sign, so that what is of higher
        order in feedback, servos and dampers outweighs the first. So it is of a mode that swings no more.
        """
        first, exact = np.abs(self.first_order_decay), np.abs(self.mode_decay)
        off = np.abs(self.first_order_decay - self.mode_decay)
        fails = off > np.minimum(first, exact) + self.decay_rounding
        return fails | (np.isnan(exact) & np.isfinite(first))

    @property
    def why_first_order_fails(self) -> str:
        """What is too strong for the first order, a part of a sentence."""
        servos = "the joints' velocity servos, " if self.settings.servo_gain else ""
        return f"{servos}the feedback or the dampers are too strong for a first order"

    @property
    def despite_reserve(self) -> str:
        """Why a mode without a reserve of lag may decay to first order."""
        own = "has of its own" + (" and from the joints' velocity servos" if self.settings.servo_gain else "")
        if self.settings.even:
            return f"the feedback takes away less damping than the mode {own}"
        return f"equal gains would take damping away; what the mode {own}, or that rows differ, lets it decay"

    @property
    def _stable(self) -> list[str]:
        """The intervals of Kp in words; an end of the search is no border."""
        lowest, highest, words = self.settings.lowest_kp, self.settings.highest_kp, list[str]()
        for low, high in self.gain_intervals:
            ends = ((low, lowest), (high, highest))
            least, most = (math.isclose(x, end, rel_tol=1e-6) for x, end in ends)
            parts = [*([] if least else [f"from {low:.4g}"]), *([] if most else [f"up to {high:.4g}"])]
            words.append(" ".join(parts) or f"wherever it was looked at, {low:.4g} to {high:.4g}")
        return words

    @property
    def _others(self) -> str:
        pairs = list(zip(self.other_frequencies_hz, self.other_damping_ratios, strict=True))
        told = [
            f"{swing_of(hertz, ratio):.4g} Hz, damping {ratio:.3g} (decay {math.tau * hertz * ratio:.4g}/s)"
            for hertz, ratio in pairs[:OTHERS]
        ]
        more = len(pairs) - OTHERS
        return "; ".join([*told, f"{more} more that decay faster"] if more > 0 else told)

    @property
    def _word(self) -> str:
        if abs(self.decay) <= self.decay_rounding:
            return f"neither decays nor grows to rounding (decay {self.decay:+.2g}/s)"
        return f"{'decays' if self.decay > 0 else 'grows'} at {abs(self.decay):.4g}/s"

    def __repr__(self) -> str:
        first, *sources = repr(self.settings).splitlines()
        unit = self.settings.force_units[1]
        kappa, wide = f"κ, {unit}", max(11, len(unit) + 3)
        head = f"  {'mode':>4} {kappa:>{wide}} {'κ, isotropic':>13} {'lag':>8} {'reserve':>8} {'1st order':>11}"
        lines = [f"loop: {first}", *sources, f"{head} {'|s|/2π':>12} {'damping':>10}"]
        for i, allowed in enumerate(self.allowance):
            lines.append(
                f"  {i + 1:4d} {allowed:{wide}.4g} {self.allowance_isotropic[i]:13.4g} {in_degrees(self.lag[i], 8, 1)} "
                f"{in_degrees(self.lag_reserve[i], 8, 1)} {self.first_order_decay[i]:+7.4g} 1/s "
                f"{_oscillation(self.frequencies_hz[i], self.damping_ratios[i])}"
            )
        fails = self.first_order_fails
        if fed := _modes((self.lag_reserve < 0) & (self.first_order_decay > 0) & ~fails):
            lines.append(f"  {fed}, decaying with a reserve below 0: {self.despite_reserve}")
        if still := _modes(np.isnan(self.frequencies_hz)):
            lines.append(f"  {still}, –: no oscillation is left of it")
        if off := _modes(fails):
            lines.append(
                f"  {off}: {self.why_first_order_fails}: 1st order is off the exact decay by more than a factor of 2, "
                "and κ and reserve tell as little; frequency and damping are exact"
            )
        if len(self.other_frequencies_hz):
            what = "further oscillations of the loop that are slow or grow, mostly of the arm under its feedback"
            lines.append(f"  {what}: {self._others}")
        why = from_sample_to_sample(self.too_much, self.settings.rate)
        lines.append(f"  sampled loop: {self._word}, {self.frequency_hz:.4g} Hz{why}")
        if rows := [str(k + 1) for k, held in enumerate(self.settings.position_held) if not held]:
            lines.append(f"  task row {listed(rows)} has no Kp or Ki: the position is free there, no part of the decay")
        lines += [f"  {unseen_told('the loop')}"] * self.unseen
        if self.settings.lets_drift:
            lines.append(f"  {UNBRAKED}")
        own_motion = (*drifting_self_motion(self.drift), *slow_self_motion(self.drift, self.decay))
        lines += [f"  {sentence}" for sentence in own_motion]
        lowest, now, highest = self.settings.lowest_kp, self.settings.first_kp, self.settings.highest_kp
        stable = ", ".join(self._stable) or f"nowhere from {lowest:.4g} to {highest:.4g}"
        most = f"above {highest:.4g}" if math.isinf(self.allowed_gain) else _told(self.allowed_gain)
        # What is stable with higher gains alone has none that may be approached from below.
        most = f"none from {lowest:.4g} to the present {now:.4g}" if self.allowed_gain == 0 else most
        unit = f" {self.settings.gain_units[0]} (stable: {stable})"
        lines.append(f"  allowed gain Kp {most}{'' if math.isnan(self.allowed_gain) else unit}")
        first = self._stable[0] if self._stable else ""
        if self.drifts_below and any(rate > 0 for rate in self.drift) and first.startswith("from"):
            below = first.removeprefix("from ").split(" ")[0]
            lines.append(f"    below {below} that drift may move the end-point, too, and is then counted as the loop's")
        margin = f"{_told(1e3 * self.delay_margin)}{' ms' if math.isfinite(self.delay_margin) else ''}"
        lines.append(
            f"  delay margin {margin}; disk margin {_told(self.disk_margin)}; "
            f"peak of S {_told(self.sensitivity_peak)}, of T {_told(self.complementary_peak)}"
        )
        if math.isnan(self.disk_margin) and self.decay > self.decay_rounding and any(rate >= 0 for rate in self.drift):
            lines.append("    –: of a self-motion that drifts there are none, nor an H2 norm")
        if math.isfinite(self.h2_norm):
            lines.append(
                f"  H2 norm from forces on the base to the end-point {self.h2_norm:.4g} m, its standard deviation "
                "under white noise of unit intensity"
            )
        if math.isfinite(self.swing):
            drifts = ", without that drift" if any(rate > 0 for rate in self.drift) else ""
            settles = (
                f"settles in {self.settling:.4g} s" if math.isfinite(self.settling) else "does not settle in a minute"
            )
            lines.append(
                f"  standard move{drifts}: {settles}; the base swings by {self.swing:.4g} {self.swing_unit} for each m"
            )
        return "\n".join(lines)


def unseen_told(whose: str) -> str:
    """That no loop changes the slowest motion there, a sentence."""
    return (
        f"the slowest motion of {whose} is one that the end-point does not show and no feedback excites: its decay is "
        "the machine's own; a base without its direction, as roll of an arm that moves in a plane, shows the others"
    )


def swing_of(hertz: float, ratio: float) -> float:
    """At how many Hz what has |s|/2π = `hertz` and −Re s/|s| = `ratio` swings: |Im s|/2π."""
    return hertz * math.sqrt(max(1.0 - ratio**2, 0.0))


def _oscillation(hertz: float, ratio: float) -> str:
    """A row's last two columns."""
    return f"{'–':>9}    {'–':>10}" if math.isnan(hertz) else f"{hertz:9.4f} Hz {ratio:10.3e}"


def _modes(which: NDArray[np.bool_]) -> str:
    """Those of them, by number; empty where there are none."""
    numbers = [str(i + 1) for i in np.flatnonzero(which).tolist()]
    return f"mode{'s' * (len(numbers) > 1)} {listed(numbers)}" if numbers else ""


def _told(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.4g}" if math.isfinite(value) else "without border"


@public()
def outcome(
    machine: AnyMachine,
    posture: PostureLike,
    *,
    base: BaseLike | None = None,
    control: Control | None = None,
    gravity: bool = False,
    loop: LoopLike | None = None,
) -> Outcome:
    """What the real controller allows and does in one posture: the `outcome` of `flexopt.evaluate`.

    The sampled loop is exact, x_{k+1} = Φ x_k with matrix exponentials between the samples, at any dead time; so are
    the derivatives.

    Args:
        machine, posture, base, control, gravity: as of `flexopt.evaluate`.
        loop: as of `flexopt.evaluate`; by default the machine's `[loop]`, or where it has none what follows from it.

    Raises:
        InputError, SingularPosture, NoSolutionFound: as `flexopt.evaluate`.

    Example:
        >>> machine = flexopt.load("excavator")
        >>> flexopt.outcome(machine, (0.0448, -2.0499), loop={"kp": 1e4, "kv": 1e3}).decay > 0
        True
    """
    asked = machine.loop or Loop() if loop is None else loop
    found = evaluate(machine, posture, base=base, control=control, gravity=gravity, loop=asked).outcome
    assert isinstance(found, Outcome)
    return found


def settings_at(
    machine: AnyMachine,
    posture: Vector,
    base: Vector | None,
    control: Control | None,
    loop: Loop | None,
    *,
    gravity: bool,
    call: str,
) -> tuple[LoopSettings, Vector]:
    """The numbers of a loop in a posture, of which those left out follow from the machine; and where its base stands.

    Args:
        machine, posture, base, control, loop, gravity: as of `outcome`.
        call: whose errors these are.
    """
    real = machine.loop or Loop() if loop is None else loop
    place = np.zeros(len(machine.base_coordinates)) if base is None else base
    chosen = control_of(control, real, machine)
    own = under_control(real, machine, chosen, call)
    with warnings.catch_warnings():
        # What it warns of are measures and margins, which nobody asked for.
        warnings.simplefilter("ignore", FlexoptWarning)
        stand = evaluate_checked(machine, posture, place, control=chosen, gain=1.0, damped=False, gravity=gravity)
    return loop_settings(machine, own, stand, gravity=gravity), place


def evaluate_loop(machine: AnyMachine, loop: Loop, stand: Evaluation, *, gravity: bool) -> Outcome:
    """What a loop that is known to be good does in a configuration that was evaluated."""
    return outcome_of(machine, loop_settings(machine, loop, stand, gravity=gravity), stand, gravity=gravity)


def with_outcome(machine: AnyMachine, stand: Evaluation, settings: LoopSettings, *, gravity: bool) -> Evaluation:
    """A configuration that was evaluated, with what a loop of these numbers does there."""
    return replace(stand, outcome=outcome_of(machine, settings, stand, gravity=gravity))


def outcome_of(machine: AnyMachine, settings: LoopSettings, stand: Evaluation, *, gravity: bool) -> Outcome:
    """What a loop of these numbers does in a configuration that was evaluated."""
    outcome = settings.outcome(machine, stand.base, stand.posture, gravity=gravity)
    of_modes: dict[str, Any]
    modes_of_loop = LaggedModes(outcome.motions)
    of_modes, gradient = modes_of_loop.at(outcome.numbers, settings.dead_time)
    hidden = unreached(stand.scale)
    unexcited = hidden | (without_rounding(stand.w, stand.scale) == 0)
    for name, modes, none in (
        ("allowance", unexcited, math.inf), ("allowance_isotropic", unexcited, math.inf),
        ("lag_reserve", hidden, math.nan),
    ):  # fmt: skip
        of_modes[name][modes] = none
        for slopes in gradient[name].values():
            slopes[modes] = np.nan
    alone = np.ones(len(stand.w), dtype=bool)
    for cluster in stand.clusters:
        alone[list(cluster)] = False
    for name in LaggedModes.NAMES:
        of_modes[name][~alone] = np.nan
        for slopes in gradient[name].values():
            slopes[~alone] = np.nan
    poles, others = outcome.poles(*_shapes(outcome))
    ratios = [outcome.damping_ratio(pole) for pole in poles.tolist()]
    each = [outcome.gradient(ratio) for ratio in ratios]
    gradient["damping_ratios"] = {by: np.array([found[by] for found in each]) for by in each[0]} if each else {}
    scalars: dict[str, Any] = {name: measure(outcome) for name, measure in MEASURES.items()}
    gradient |= {name: outcome.gradient(measured) for name, measured in scalars.items()}
    kp = float(outcome.numbers["kp"][int(np.argmax(outcome.numbers["kp"] > 0))])
    return Outcome(
        settings=settings,
        **of_modes,
        frequencies_hz=np.abs(poles) / math.tau,
        damping_ratios=np.array([ratio.value for ratio in ratios]),
        other_frequencies_hz=np.abs(others) / math.tau,
        other_damping_ratios=-others.real / np.abs(others),
        decay_rounding=outcome.loop.rounding,
        frequency_hz=outcome.loop.frequency_hz,
        unseen=modes_of_loop.is_unseen(outcome.numbers, scalars["decay"].value, outcome.loop.rounding),
        drift=outcome.loop.drift,
        swing_unit=swing_unit(outcome),
        too_much=outcome.too_much,
        drifts_below=outcome.drifts_below,
        gain_intervals=tuple((low * kp, high * kp) for low, high in outcome.gain_intervals if kp),
        gradient={name: {"parameters" if by == "p" else by: x for by, x in found.items()}
                  for name, found in gradient.items()},
        **{name: measured.value for name, measured in scalars.items()},
    )  # fmt: skip


def swing_unit(point: LoopPoint) -> str:
    """Of the base's swing in the standard move: rad, of a base that cannot turn m."""
    return "rad" if point.motions.loop.shape.base_hinges else "m"


def _shapes(outcome: LoopPoint) -> tuple[Vector, Vector, Vector]:
    """The machine's modes (n_q, m), their ω² (m,), and M there."""
    motions, of = outcome.motions, outcome.numbers
    measures = build_measures(motions.machine, motions.control, motions.gravity)
    at: dict[str, Any] = {name: of[name] for name in ("base", "posture", "p")}
    found = cast(Any, measures.values(**at))
    mass: Vector = motions.plant.mass(outcome.configuration, of["base"], of["p"]).full()
    return found["modes"].full(), found["omega_squared"].full().ravel(), mass
