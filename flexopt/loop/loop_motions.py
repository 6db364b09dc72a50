"""The motions of a loop in one configuration: where it rests, its eigenvalues, how fast each decays and swings.

In: the loop for small motions at numbers. Out: multipliers of the exact sampled loop, what nothing holds left out, and
rates and frequencies with their exact derivatives by placement, posture, parameters, gains and dead time: through
eigenvectors, and `assembly`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np

from flexopt.foundation.arrays import ComplexArray, Vector
from flexopt.loop.assembly import OneSample, Slopes
from flexopt.loop.small_motions import AT_REST, BY, DEAD_TIME, Parts, SmallMotions
from flexopt.loop.spectrum import (
    OwnMotion,
    SampledLoop,
    balance,
    eigenvectors,
    neutral_directions,
    poles_of,
    spectrum,
    too_much,
)
from flexopt.model.loop import GAINS

# Relative distance up to which an eigenvalue is one of those that are known.
SAME = 1e-6
# Im s / |s| up to which a pole is no oscillation: by rounding a double real one, as of a filter in two rows, has 1e-8,
# a triple one 1e-5.
SWINGS = 1e-3
# Motions of a loop that count, the slowest first: at an optimum several are as slow.
SLOWEST_MOTIONS = 6


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
# Share of what a joint can carry at most below which that is rounding, of a slew that carries nothing, too: that leaves
# some 1e-15, times the condition of Jv squared.
CANCELLED = 1e-6
# Share of the energy of an oscillation that a mode's springs have at least where the mode has become it: a third to a
# half of its own, some 1e-4 of another's.
STRAINS = 0.01


def falling(rate: float) -> float:
    """The slowest decay, 1/s, up to which one at a rate of samples, Hz, is that of `FALLS`, but for rounding."""
    return -0.999 * math.log(np.finfo(np.float64).max) * rate


@dataclass(frozen=True, eq=False)
class LoopMotions:
    """A loop at numbers: where it rests, and its motions about there.

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
        if not self._may_be_driven:
            return np.zeros(self.motions.plant.n_actuated)
        _, unheld, _, most = self._at_rest
        return np.where(np.abs(unheld) > CANCELLED * most, unheld, 0.0)

    @property
    def carried(self) -> Vector:
        """What the joints carry at rest (n,), N m or N; zeros where nothing can be `unheld`."""
        return np.abs(self._at_rest[2]) if self._may_be_driven else np.zeros(self.motions.plant.n_actuated)

    @property
    def _may_be_driven(self) -> bool:
        return bool(self._excess and self.motions.own_model and self.rests)

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

    def with_gains(self, factor: float) -> Self:
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
        known = np.array([np.min(np.abs(self.loop.multipliers - value)) <= SAME for value in values])
        every = poles_of(values, self.period)
        # An oscillation above half the sampling rate is seen as a real multiplier below zero: Im s = π/T.
        chosen = np.flatnonzero(known & (values.imag >= 0) & (every.imag > SWINGS * np.abs(every)))
        poles = every[chosen]
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
