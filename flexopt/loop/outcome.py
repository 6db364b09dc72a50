"""What a loop does in one configuration: how fast it decays, which gains and dead times it bears, how robust it is.

In: the loop for small motions at numbers. Out: measures of the exact sampled loop, each with its exact derivative by
placement, posture, parameters, gains and dead time: through eigenvectors and singular vectors, and `assembly`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from flexopt.coprime import StateSpace
from flexopt.foundation.arrays import ComplexArray, Mask, Vector
from flexopt.foundation.roots import border
from flexopt.loop.assembly import OneSample, Slopes
from flexopt.loop.borders import HIGH, LOW, POINTS, highest_stable, stable_intervals
from flexopt.loop.disturbance import Disturbed
from flexopt.loop.frequency_response import PEAKS, SETTLED, crossings, exactly, peak, peak_at
from flexopt.loop.small_motions import AT_REST, BY, DEAD_TIME, Parts, SmallMotions
from flexopt.loop.spectrum import (
    MOSTLY,
    OwnMotion,
    SampledLoop,
    balance,
    eigenvectors,
    neutral_directions,
    poles_of,
    spectrum,
    too_much,
    without_neutral,
)
from flexopt.loop.standard_move import StandardMove
from flexopt.model.loop import DELAY_MAX, GAINS

# In a sample: of an undamped motion that the loop does not see this much decay may be rounding.
UNDAMPED = 1e3 * float(np.finfo(float).eps)
# Looks at longer dead times in a sample, and how many at most up to where the loop may be at a border.
CLOSE, LOOKS = 4, 16
# How far on either side of a border, in samples, eigenvalues say that it is one.
ASIDE = 1e-3
# Relative distance up to which an eigenvalue is one of those that are known.
SAME = 1e-6
# Motions of a loop that count, the slowest first: at an optimum several are as slow.
SLOWEST_MOTIONS = 6
# How often a dead time at a border is bettered.
POLISHES = 4


class Measured(NamedTuple):
    """A measure and its derivative; NaN and None where it is not defined.

    Attributes:
        value: of it.
        slopes: its derivative by what a sample is made of.
        more: what is to be added to a derivative by one of `INPUTS`.
        by: the derivative itself, by each of `INPUTS` and by the dead time, where it is none of the loop's samples.
    """

    value: float
    slopes: Slopes | None = None
    more: Mapping[str, Vector] | None = None
    by: Mapping[str, Vector] | None = None

    def times(self, factor: float) -> Measured:
        """The measure times a number."""
        slopes = None if self.slopes is None else self.slopes * factor
        more, by = (
            None if given is None else {name: factor * slope for name, slope in given.items()}
            for given in (self.more, self.by)
        )
        return Measured(factor * self.value, slopes, more, by)


UNDEFINED = Measured(math.nan)
# Multiplier of a machine that feedback holds nowhere: the largest number, for it falls, at no rate.
FALLS = np.array([complex(np.finfo(np.float64).max)])
# And what that says.
NOWHERE_HELD = "the feedback is not found to hold the weight, which the controller does not know, anywhere near"
# Share of what a joint carries below which friction holds what drives a self-motion.
FELT = 0.01
# Share of what a joint can carry at most below which that is rounding, of a slew that carries nothing, too: that leaves
# some 1e-15, times the condition of Jv squared.
CANCELLED = 1e-6
# So far below a border of stability it is looked at what grows there.
NEAR = 0.01
# Share of the energy of an oscillation that a mode's springs have at least where the mode has become it: a third to a
# half of its own, some 1e-4 of another's.
STRAINS = 0.01


def falling(rate: float) -> float:
    """The slowest decay, 1/s, up to which one at a rate of samples, Hz, is that of `FALLS`, but for rounding."""
    return -0.999 * math.log(np.finfo(np.float64).max) * rate


@dataclass(frozen=True, eq=False)
class LoopPoint:
    """A loop at numbers.

    Attributes:
        motions: its Functions.
        numbers: their inputs, from `SmallMotions.numbers`.
        dead_time: from the end-point's measurement to the command, s.
    """

    motions: SmallMotions
    numbers: Mapping[str, Vector]
    dead_time: float

    @property
    def period(self) -> float:
        """Of a sample, s."""
        return float(self.numbers["period"][0])

    @cached_property
    def parts(self) -> Parts:
        """The linear loop about rest."""
        return self.motions.parts(self.numbers)

    @cached_property
    def sample(self) -> OneSample:
        """One sample of it."""
        return OneSample(self.parts, self.period, self.dead_time)

    @cached_property
    def smooth(self) -> OneSample:
        """The same, as derivatives are taken of it."""
        return OneSample(self.parts, self.period, self.dead_time, differentiable=True)

    @property
    def _excess(self) -> int:
        return self.motions.plant.n_actuated - self.motions.plant.n_task

    @property
    def _neutral(self) -> int:
        plant = self.motions.plant
        return neutral_directions(self.motions.structure, plant.n_actuated, self.numbers["kp"], self.numbers["ki"])

    @cached_property
    def _at_rest(self) -> list[Vector]:
        given = [self.numbers[name] for name in (*AT_REST, "held")]
        return [found.full().ravel() for found in self.motions.configuration.call(given)]

    @property
    def configuration(self) -> Vector:
        """All coordinates at rest (n_q,)."""
        return self._at_rest[0]

    @property
    def posture(self) -> Vector:
        """Of the actuated joints at rest (n,)."""
        return self.configuration[self.motions.plant.n_passive :]

    @property
    def end_point(self) -> Vector:
        """Where the end-point is at rest (n_task,), m."""
        return self.motions.plant.end_point(self.configuration, self.numbers["base"], self.numbers["p"]).full().ravel()

    @property
    def unheld(self) -> Vector:
        """What drives a redundant arm's self-motion (n,), N m or N: of a weight that the controller does not know.

        No feedback of the end-point holds it. 0 of joints at which it is below `CANCELLED` of what they can carry.
        """
        if not (self._excess and self.motions.own_model and self.rests):
            return np.zeros(self.motions.plant.n_actuated)
        _, unheld, _, most = self._at_rest
        return np.where(np.abs(unheld) > CANCELLED * most, unheld, 0.0)

    @property
    def felt(self) -> Mask:
        """Which joints `unheld` moves, (n,): not below `FELT` of what they carry, which friction holds."""
        unheld = np.abs(self.unheld)
        return unheld > FELT * np.abs(self._at_rest[2]) if unheld.any() else unheld > 0

    @cached_property
    def _own(self) -> OwnMotion:
        of, motions = self.numbers, self.motions
        found = OwnMotion.at(motions.plant, self.configuration, of["base"], of["p"], motions.loop.to_q)
        return found.creeping_along(self._resting_rows(1.0)) if motions.gravity else found

    def _resting_rows(self, times: float) -> Vector:
        """Rows along whose kernel it creeps where it rests, with all gains so many times what they are."""
        of, motions = self.numbers, self.motions
        known = motions.plant.parameter_values if motions.own_model else of["p"]
        gains = (times * gain for gain in motions.into_forces(of))
        at = [self.configuration, of["base"], of["held"][: motions.plant.n_passive], known, of["p"], *gains]
        return motions.rows_at_rest.call(at)[0].full()

    def _own_with(self, times: float) -> OwnMotion:
        """The self-motion with all gains so many times what they are."""
        return self._own.creeping_along(self._resting_rows(times)) if self.motions.gravity else self._own

    def spectrum_of(self, matrix: Vector, times: float = 1.0) -> SampledLoop:
        """Eigenvalues of a Φ of this loop, with all gains so many times what they are."""
        return spectrum(
            matrix,
            self.period,
            self._neutral,
            self._excess,
            lambda: self._own if times == 1.0 else self._own_with(times),
        )

    @cached_property
    def _hangs(self) -> bool:
        """Whether the weight, which its controller does not know, draws it the farther off the lower its gains are."""
        return self.motions.own_model and bool(np.any((self.numbers["kp"] > 0) & (self.numbers["ki"] == 0)))

    def with_gains(self, factor: float) -> LoopPoint:
        """The loop with all gains times a factor, where it rests then."""
        changed = {name: factor * self.numbers[name] for name in GAINS}
        given = {name: value for name, value in self.numbers.items() if name != "held"}
        return replace(self, numbers=self.motions.numbers(given | changed))

    def _times(self, factor: float) -> SampledLoop:
        """The loop with all gains times a factor."""
        return self.with_gains(factor).loop if self._hangs or not self.rests else self._about_here(factor)

    def _about_here(self, factor: float) -> SampledLoop:
        """The same about where it rests now."""
        return self.spectrum_of(self.sample.open + factor * self.sample.into @ self.sample.force, factor)

    @property
    def rests(self) -> bool:
        """Whether feedback holds the machine somewhere, whose weight its controller need not know; else it falls."""
        return not self.motions.own_model or bool(np.isfinite(self.numbers["held"]).all())

    @cached_property
    def loop(self) -> SampledLoop:
        """Eigenvalues of Φ, what nothing holds left out; of a machine that falls `FALLS`."""
        return self.spectrum_of(self.sample.matrix) if self.rests else SampledLoop(FALLS, self.period)

    @cached_property
    def too_much(self) -> tuple[str, ...]:
        """Gains that make it grow from sample to sample; see `spectrum.too_much`."""

        def without(names: tuple[str, ...]) -> SampledLoop:
            return replace(self, numbers={**self.numbers, **{name: 0 * self.numbers[name] for name in names}}).loop

        return too_much(self.loop, self.numbers, without)

    def gradient(self, measure: Measured) -> dict[str, Vector]:
        """The derivative of a measure by each of `INPUTS` and by the dead time; NaN where there is none."""
        if measure.by is not None:
            return {**measure.by}
        if measure.slopes is None:
            return {name: np.full(len(self.numbers.get(name, [math.nan])), np.nan) for name in BY}
        found = self.slopes_by(measure.slopes)
        return found | {name: found[name] + more for name, more in (measure.more or {}).items()}

    def slopes_by(self, slopes: Slopes) -> dict[str, Vector]:
        """A derivative by each of `INPUTS` and by the dead time, from that by what a sample is made of."""
        return self.motions.gradient(self.numbers, slopes.parts) | {DEAD_TIME: np.array([slopes.dead_time])}

    # Eigenvalues.

    @cached_property
    def _balanced(self) -> tuple[Vector, Vector]:
        return balance(self.smooth.matrix)

    def _by_multiplier(self, value: complex, weight: Callable[[complex], complex], factor: float = 1.0) -> Any:
        """The refined μ of Φ₀ + factor · Γ F, its vectors, and ∂Re(weight(μ) μ)/∂Φ."""
        if factor == 1.0:
            refined, y, x = eigenvectors(self.smooth.matrix, value, self._balanced)
        else:
            matrix = self.smooth.open + factor * self.smooth.into @ self.smooth.force
            refined, y, x = eigenvectors(matrix, value)
        return refined, np.outer(y.conj(), weight(refined) * x).real

    @property
    def upper(self) -> ComplexArray:
        """One multiplier of each motion, by size, the slowest first."""
        return self.loop.multipliers[self.loop.multipliers.imag >= 0].astype(complex)

    @property
    def upper_poles(self) -> ComplexArray:
        """Those of `upper`, rad/s; see `poles_of`."""
        return poles_of(self.upper, self.period)

    def rate(self, branch: int = 0) -> Measured:
        """−ln|μ| / T, 1/s, of the multipliers (one of each pair) by size, the slowest first: how fast it decays.

        Infinite, without a derivative, where μ = 0.
        """
        if branch >= len(self.upper):
            return UNDEFINED
        if not self.rests:
            return Measured(-self.loop.growth_rate)
        if not self.upper[branch]:
            return Measured(math.inf)
        mu, by_matrix = self._by_multiplier(self.upper[branch], lambda mu: -1 / (mu * self.period))
        slopes = self.smooth.slopes(by_matrix) if np.all(np.isfinite(by_matrix)) else None
        return Measured(-math.log(abs(mu)) / self.period, slopes)

    def frequency(self, branch: int) -> Measured:
        """Arg μ / T, rad/s, of the multipliers (one of each pair) by size, the slowest first."""
        mu, by_matrix = self._by_multiplier(self.upper[branch], lambda mu: -1j / (mu * self.period))
        slopes = self.smooth.slopes(by_matrix) if np.all(np.isfinite(by_matrix)) else None
        return Measured(float(np.angle(mu)) / self.period, slopes)

    @property
    def _drifts(self) -> bool:
        return any(rate >= 0 for rate in self.loop.drift)

    def drift(self) -> Measured:
        """The largest growth rate of a redundant arm's self-motion, 1/s; NaN where nothing acts on it, or none is."""
        if not self.loop.drift:
            return UNDEFINED
        mu, by_matrix = self._by_multiplier(self.loop.own[0], lambda mu: 1 / (mu * self.period))
        slopes = self.smooth.slopes(by_matrix) if np.all(np.isfinite(by_matrix)) else None
        return Measured(math.log(abs(mu)) / self.period, slopes)

    def decay(self) -> Measured:
        """How fast the loop's slowest motion decays, 1/s; negative where it grows."""
        return self.rate()

    def poles(self, modes: Vector, omega_squared: Vector, mass: Vector) -> tuple[ComplexArray, ComplexArray]:
        """Ln μ / T, rad/s, of the oscillation that each mode φ_i (n_q, m) has become (NaN: none), and of others.

        Oscillations s with shapes q are given to modes so that the shares of the modes' springs in their energy,
        e_i / (Σ_j e_j + |s|² qᴴ M q) with e_i = ω_i² |φ_iᵀ M q|², sum up to the most: a fast motion of servos, which
        hardly strains the springs, is not taken for a mode, and one with a share below `STRAINS` for none. The others,
        (k,), the slowest decay first, are those that are slower than the fastest of the modes, in frequency or decay.

        Args:
            modes: φ (n_q, m), φᵀ M φ = 1.
            omega_squared: ω_i² (m,), rad²/s².
            mass: M (n_q, n_q).
        """
        from scipy.optimize import linear_sum_assignment  # noqa: PLC0415  (loads slowly)

        balanced, scale = balance(self.sample.matrix)
        values, vectors = (np.asarray(x, dtype=np.complex128) for x in np.linalg.eig(balanced))
        n = len(mass)
        # An oscillation above half the sampling rate is seen as a real multiplier below zero.
        known = np.array([np.min(np.abs(self.loop.multipliers - value)) <= SAME for value in values])
        chosen = np.flatnonzero(known & (values.imag >= 0) & ((values.imag > 0) | (values.real < 0)))
        poles = poles_of(values[chosen], self.period)
        shapes = self.motions.loop.to_q @ (scale[:, None] * vectors)[:n, chosen]
        moving = np.abs(poles) ** 2 * np.einsum("ik,ij,jk->k", shapes.conj(), mass, shapes).real
        strained = omega_squared[:, None] * np.abs(modes.T @ mass @ shapes) ** 2
        shares = strained / np.maximum(strained.sum(axis=0) + moving, np.finfo(float).tiny)
        of_mode, of_pole = linear_sum_assignment(-shares)
        # A mode that swings no more, as an overdamped one, is left with one that is not its own.
        own = shares[of_mode, of_pole] > STRAINS
        of_mode, of_pole = of_mode[own], of_pole[own]
        found = np.full(modes.shape[1], complex(math.nan, math.nan))
        found[of_mode] = poles[of_pole]
        others = np.delete(poles, of_pole)
        fastest = max(np.abs(poles[of_pole]).max(initial=0.0), math.sqrt(omega_squared.max(initial=0.0)))
        shortest = np.max(-poles[of_pole].real, initial=0.0)
        others = others[(np.abs(others) < fastest) | (-others.real < shortest)]
        return found, others[np.argsort(-others.real)]

    def damping_ratio(self, pole: complex) -> Measured:
        """−Re s/|s| of a pole s = ln μ / T."""
        if not np.isfinite(pole):
            return UNDEFINED

        def weight(mu: complex) -> complex:
            s = complex(np.log(mu)) / self.period
            return (-1 / abs(s) + s.real * s.conjugate() / abs(s) ** 3) / (mu * self.period)

        mu, by_matrix = self._by_multiplier(complex(np.exp(pole * self.period)), weight)
        s = complex(np.log(mu)) / self.period
        slopes = self.smooth.slopes(by_matrix) if np.all(np.isfinite(by_matrix)) else None
        return Measured(-s.real / abs(s), slopes)

    # Gains and dead times that it bears.

    def growth_at(self, exponent: float) -> float:
        """Growth rate with all gains times 10^exponent, 1/s."""
        return self._times(10.0**exponent).growth_rate

    @cached_property
    def gain_intervals(self) -> tuple[tuple[float, float], ...]:
        """(lower, upper) of the factors, 10^LOW to 10^HIGH, times which all gains together leave the loop stable.

        About where it rests with the present gains.
        """
        if not self.rests:
            return ()
        known, (balanced, scale) = None, balance(self.sample.matrix)
        _, kept = without_neutral(balanced, self._neutral)
        if not (self._excess and self.motions.structure.gravity):
            # One batch: what is left of a self-motion that no weight drives decays whatever the gains.
            exponents = np.linspace(LOW, HIGH, POINTS)
            opened = self.sample.open / scale[:, None] * scale
            each = opened + 10.0 ** exponents[:, None, None] * (balanced - opened)
            radius = np.abs(np.linalg.eigvals(kept @ each @ kept.T)).max(axis=1)
            known = poles_of(radius, self.period).real.tolist()
        return stable_intervals(lambda x: self._about_here(10.0**x).growth_rate, UNDAMPED / self.period, known)

    @property
    def drifts_below(self) -> bool:
        """Whether below the least gains that leave it stable what grows is mostly a self-motion, one that drifts."""
        if not (self._drifts and self.gain_intervals):
            return False
        grows = self._about_here(self.gain_intervals[0][0] * (1 - NEAR))
        return grows.growth_rate > 0 and grows.self_motion > MOSTLY

    def allowed_gain(self) -> Measured:
        """The largest Kp along the present ratio of all gains, in its unit: of the first row that has one.

        The upper end of the interval in which the present gains lie; where they lie in none the largest one below, 0
        where none is found; infinite where no border is met; NaN where no row has one. An arm whose weight its
        controller does not know rests elsewhere with other gains: then it is that of the loop about that rest.
        """
        kp = self.numbers["kp"]
        row = int(np.argmax(kp > 0))
        if not kp[row]:
            return UNDEFINED
        if self._hangs:
            return self._allowed_where_it_rests(row)
        below = [(low, high) for low, high in self.gain_intervals if low <= 1.0]
        if not below:
            return Measured(0.0)
        factor = below[-1][1]
        if factor >= 10**HIGH:
            return Measured(math.inf)
        value = self._times(factor).multipliers[0]
        _, by_matrix = self._by_multiplier(value, lambda mu: 1 / mu, factor)
        by_factor = float(np.sum(by_matrix * (self.smooth.into @ self.smooth.force)))
        more = np.zeros_like(kp)
        more[row] = factor
        if not math.isfinite(by_factor) or by_factor == 0:
            return Measured(factor * float(kp[row]))
        slopes = self.smooth.slopes(by_matrix, factor) * (-float(kp[row]) / by_factor)
        return Measured(factor * float(kp[row]), slopes, {"kp": more})

    def _allowed_where_it_rests(self, row: int) -> Measured:
        """`allowed_gain` of a loop that rests elsewhere with other gains."""
        factor = highest_stable(self.growth_at, UNDAMPED / self.period)
        if not 0 < factor < 10**HIGH:
            return Measured(math.inf if factor else 0.0)
        there, kp = self.with_gains(factor), float(self.numbers["kp"][row])
        slowest = there.rate()
        slopes = there.gradient(slowest)
        by_factor = sum(float(slopes[name] @ self.numbers[name]) for name in GAINS)
        if slowest.slopes is None or not math.isfinite(by_factor) or by_factor == 0:
            return Measured(factor * kp)
        by = {name: -kp / by_factor * slope for name, slope in slopes.items()}
        by |= {name: factor * by[name] for name in GAINS}
        by["kp"][row] += factor
        return Measured(factor * kp, by=by)

    def delay_margin(self, below: float = math.inf) -> Measured:
        """Dead time that may be added before the loop grows, s; NaN where it does already, infinite where at none.

        Infinite, too, where it is seen to be no less than `below`.

        Where it may be the frequency response says, to the error of a dead time that is taken as a pure one; where it
        is exactly, up to a dead time of 100 samples the eigenvalues, beyond the frequency response again, without a
        derivative.
        """

        def growth(more: float) -> float:
            return self.spectrum_of(self.sample.later(self.dead_time + more).matrix).growth_rate

        if not self.loop.stable:
            return UNDEFINED
        most = DELAY_MAX * self.period - self.dead_time
        met = crossings(self.sample)
        within = [crossing for crossing in met if 0 < crossing.late < most]
        late = [crossing.late for crossing in within]
        # A loop that holds has to pass the first of these to grow; where they are nearly is off by less than a sample.
        early = [crossing for crossing in within if crossing.late < late[0] + 2 * self.period]
        first = min((exactly(self.sample, crossing) for crossing in early), default=math.inf)
        aside = self.period * ASIDE
        if below <= first - aside and below < most and growth(below) < 0:
            return Measured(math.inf)
        if aside < first < most - aside and growth(first - aside) < 0 <= growth(first + aside):
            found, slopes = self._polished_border(first)
            if abs(found - first) <= aside:
                return self._border(found, slopes)
        before = 0.0
        for more in _between([0.0, *late, most], self.period / CLOSE) if late else []:
            if growth(more) >= 0:
                found = border(growth, before, more, xtol=1e-13 * self.period, rtol=1e-14)
                return self._border(found, LoopPoint(self.motions, self.numbers, self.dead_time + found).rate().slopes)
            before = more
            if before >= below:
                return Measured(math.inf)
        # A sample before the end, too: where it is nearly may lie on the other side.
        beyond = (exactly(self.sample, crossing) for crossing in met if crossing.late >= most - self.period)
        return Measured(next((more for more in beyond if more >= most), math.inf))

    def _polished_border(self, more: float) -> tuple[float, Slopes | None]:
        """A dead time more near a border as the eigenvalues have it, by Newton's steps, and the decay's slopes there.

        NaN where these lead nowhere.
        """
        for _ in range(POLISHES):
            slowest = LoopPoint(self.motions, self.numbers, self.dead_time + more).rate()
            if slowest.slopes is None or not slowest.slopes.dead_time:
                break
            step = slowest.value / slowest.slopes.dead_time
            if abs(step) <= SETTLED * (self.dead_time + more):
                return more, slowest.slopes
            more -= step
        return math.nan, None

    @staticmethod
    def _border(found: float, slopes: Slopes | None) -> Measured:
        """A margin with its derivative, from that of the decay there: the dead time at the border stays."""
        by = None if slopes is None else slopes * (-1 / slopes.dead_time)
        return Measured(found, by and Slopes(by.parts, -1.0))

    # Peaks over frequency, the loop broken at the law's force.

    @cached_property
    def _reduced(self) -> StateSpace | None:
        """From a force beside the law's to that of the law, what nothing holds left out; None of a loop that grows."""
        if not self.loop.stable or self._drifts:
            return None
        sample = self.sample
        balanced, scale = balance(sample.matrix)
        matrix, kept = without_neutral(balanced, self._neutral)
        into, force = kept @ (sample.into / scale[:, None]), (sample.force * scale) @ kept.T
        return StateSpace(matrix, into, force, np.zeros((len(force), len(force))), self.period)

    def peak_angle(self, name: str) -> float:
        """Where a measure in `PEAKS` is attained, rad in a sample; NaN where there is none."""
        return math.nan if self._reduced is None else peak_at(self._reduced, *PEAKS[name])[1]

    def _peak(self, name: str) -> Measured:
        return UNDEFINED if self._reduced is None else Measured(*peak(self._reduced, self.smooth, *PEAKS[name]))

    def sensitivity_peak(self) -> Measured:
        """‖S‖∞ of S = (I + L)⁻¹."""
        return self._peak("sensitivity_peak")

    def complementary_peak(self) -> Measured:
        """‖T‖∞ of T = L (I + L)⁻¹ = I − S."""
        return self._peak("complementary_peak")

    def disk_margin(self) -> Measured:
        """α = 1 / ‖S − I/2‖∞, at most 2: gains may vary by (2 − α)/(2 + α) … (2 + α)/(2 − α), phases by 2 atan(α/2).

        In all task rows at once and whatever they do to each other, which is more than each by itself.

        Source: Seiler, Packard and Gahinet, IEEE Control Systems Magazine 40(5), 2020.
        """
        highest = self._peak("disk_margin")
        if not math.isfinite(highest.value):
            return UNDEFINED
        return Measured(1 / highest.value, highest.slopes and highest.slopes * (-1 / highest.value**2))

    # Forces on the base.

    @cached_property
    def disturbed(self) -> Disturbed | None:
        """The loop with noise on its base; None of one that grows."""
        if self._reduced is None:
            return None
        balanced, scale = balance(self.smooth.matrix)
        _, kept = without_neutral(balanced, self._neutral)
        of = [self.numbers[name] for name in (*AT_REST, "held")]
        return Disturbed(self.smooth, self.motions.disturbance.call(of)[0].full(), kept, scale)

    def h2_norm(self) -> Measured:
        """Root of the end-point's variance at the samples under white noise of unit intensity on every base force, m.

        E[d(t) d(t′)ᵀ] = I δ(t − t′) of the forces d on the passive coordinates, N or N m: the H2 norm from them to the
        end-point, m √s per N s and the like. NaN of a loop that grows, stands so near the border that rounding decides
        the norm, or whose self-motion grows; infinite where a task row has no gain Kp. What nothing holds and the
        end-point does not see, self-motion, is divided out.

        Source: Chen and Francis, Optimal Sampled-Data Control Systems, 1995, for what comes in within a sample.
        """
        found = self.disturbed
        if found is None:
            return UNDEFINED
        if not math.isfinite(found.norm):
            return Measured(found.norm)
        slopes, by_into = found.slopes()
        of = [self.numbers[name] for name in (*AT_REST, "held")]
        parts = self.motions.disturbance_slopes.call([*of, by_into])
        more = {name: part.full().ravel() for name, part in zip(AT_REST, parts, strict=True)}
        return Measured(found.norm, slopes, more)

    # The standard move.

    @cached_property
    def move(self) -> StandardMove | None:
        """Its motion, without what drifts of it along a self-motion; None of a loop that grows."""
        if not self.loop.stable:
            return None
        return StandardMove(self.motions, self.smooth, self._neutral, self._drifts)

    def settling(self) -> Measured:
        """After which time of the standard move |e| stays below 2 % of its start, s, exactly, between samples too.

        Of the task rows the longest; NaN of a loop that grows, and where it does not within a minute. Of a self-motion
        that drifts, which has no end, nothing counts (see `StandardMove`), nor does it in the swing. It jumps where
        an excursion begins to leave the band; there, and where two rows take as long, it has no derivative.
        """
        return UNDEFINED if self.move is None else Measured(*self.move.settling())

    def swing(self) -> Measured:
        """The base's largest turn about one of its axes for each m of the standard move, rad.

        NaN of a loop that grows. Of a base that cannot turn the deflection of a passive coordinate, m or rad. No
        derivative where two peaks are as large.
        """
        return UNDEFINED if self.move is None else Measured(*self.move.swing())


def _between(times: list[float], step: float) -> list[float]:
    """The times but the first, with a few between them, `step` apart or more, and after the last but one."""
    found: list[float] = []
    for before, after in pairwise(times):
        count = min(LOOKS, max(2, math.ceil((after - before) / step)))
        found += np.linspace(before, after, count + 1)[1:].tolist()
    return found


# Measures by name, each one number.
MEASURES: dict[str, Callable[[LoopPoint], Measured]] = {
    "decay": LoopPoint.decay,
    "allowed_gain": LoopPoint.allowed_gain,
    "delay_margin": LoopPoint.delay_margin,
    "disk_margin": LoopPoint.disk_margin,
    "h2_norm": LoopPoint.h2_norm,
    "sensitivity_peak": LoopPoint.sensitivity_peak,
    "complementary_peak": LoopPoint.complementary_peak,
    "settling": LoopPoint.settling,
    "swing": LoopPoint.swing,
}
