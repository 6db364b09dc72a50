"""How finely a sample is integrated: the steps that a method needs for modes, dampers and servos.

In: options of a simulation, poles of the plant, fastest mode, servo and damper. Out: steps in a sample, iterations in
an implicit one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from flexopt.errors import InputError
from flexopt.foundation.arrays import Vector
from flexopt.loop.tableaus import classical, dormand_prince, stability_polynomial
from flexopt.model.simulation import IntegrationMethod, SimulationOptions

# Steps of the accurate methods, as shares of the fastest mode's radian.
ACCURATE_STEP = 0.3
# Of the fastest damper's time constant: below it plain iterations of the implicit method converge.
DAMPED_STEP = 0.5
# And above it what holds for a damper that is solved for: |R(−8)| = 0.06, so that what it brakes is at rest with it.
STRONGLY_DAMPED_STEP = 8.0
# How much of a strong damper's motion an iteration leaves: as masses change within a step it is not solved for exactly.
MASS_CHANGES = 0.05
SUBSTEPS_MAX = 1000
# Steps in a sample that are taken for a strong damper alone.
BRAKED_MAX = 16
# By so much |R| passes 1 where poles at zero are off by rounding.
ROUNDING = 1e-6


@dataclass(frozen=True)
class Fastest:
    """What is fast in a loop: the plant's poles (2 n_q,) and, 1/s, its fastest undamped mode, servo and damper."""

    poles: Vector
    mode: float
    servo: float
    damper: float


@dataclass(frozen=True)
class Stepping:
    """Integration steps in a sample, iterations of the implicit method.

    Whether dampers are strong for its steps; and whether they are so strong that Gauss's method would not follow them.
    """

    substeps: int
    iterations: int = 0
    damped: bool = False
    stiff: bool = False


def stepping(options: SimulationOptions, of: Fastest) -> Stepping:
    """How finely a sample is integrated.

    Raises:
        InputError: an explicit method is unstable with the substeps given, or more than the most are needed.
    """
    period, method = 1 / options.rate, options.integrator
    fastest, substeps = max(of.mode, of.servo), options.substeps
    need, pole = _stable_steps(method, of, period)
    if substeps is None:
        substeps = 1 if method == "rk4" else max(1, math.ceil(fastest * period / ACCURATE_STEP))
        if need > 1 and (method == "dop853" or _brakes(pole, of)):
            # At the limit itself a run would not bear that masses change along the way.
            substeps = max(substeps, min(2 * need, SUBSTEPS_MAX))
        if method == "gauss":
            # So many are paid for Gauss's method, which adds no damping; where dampers want more, Radau's has no need.
            braked = math.ceil(of.damper * period / STRONGLY_DAMPED_STEP)
            substeps = max(substeps, braked if braked <= BRAKED_MAX else 1)
    if max(substeps, need) > SUBSTEPS_MAX:
        raise InputError(
            f"simulate: rate = {options.rate:g} Hz is too slow for the {_named(pole, of)}: a sample would need more "
            f"than {SUBSTEPS_MAX} integration steps"
        )
    if substeps < need:
        others = " or ".join(f"{other!r}" for other in ("dop853", "gauss") if other != method)
        raise InputError(
            f"simulate: rate = {options.rate:g} Hz with {substeps} substep{'s'[: substeps > 1]}: {method.upper()} is "
            f"unstable for the {_named(pole, of)} (step {period / substeps:g} s); needs substeps of at least {need}, "
            f"or integrator = {others}"
        )
    if method != "gauss":
        return Stepping(substeps)
    damped = of.damper * period / substeps > DAMPED_STEP
    # Fixed-point iterations shrink the change by a quarter of the step in radians of what is fastest.
    quarter = 0.25 * (fastest if damped else max(fastest, of.damper)) * period / substeps
    shrink = min(max(quarter, MASS_CHANGES if damped else 0.0), 0.75)
    stiff = of.damper * period / substeps > STRONGLY_DAMPED_STEP
    return Stepping(substeps, max(6, math.ceil(-38.0 / math.log(shrink))), damped, stiff)


def _stable_steps(method: IntegrationMethod, of: Fastest, period: float) -> tuple[int, complex]:
    """The fewest steps in a sample from which on no pole that decays grows, and the pole that wants most of them."""
    polynomial = _polynomial(method)
    if polynomial is None:
        return 1, complex(-of.servo) if of.servo > of.mode else 1j * of.mode
    poles, counts = np.append(of.poles, -of.servo), np.arange(1, SUBSTEPS_MAX + 1)
    steps = poles[:, None] * period / counts
    grown = np.abs(np.polyval(polynomial, steps)) > np.exp(np.maximum(steps.real, 0.0)) + ROUNDING
    most = np.where(grown.any(axis=1), SUBSTEPS_MAX + 1 - np.argmax(grown[:, ::-1], axis=1), 1)
    k = int(np.argmax(most))
    return int(most[k]), complex(poles[k])


@lru_cache
def _polynomial(method: IntegrationMethod) -> Vector | None:
    """Of an explicit method."""
    tableaus = {"rk4": classical, "dop853": dormand_prince}
    return stability_polynomial(tableaus[method]()) if method in tableaus else None


def _brakes(pole: complex, of: Fastest) -> bool:
    """Whether it is a damper's pole, neither a mode's nor a servo's."""
    return pole != -of.servo and abs(pole.imag) <= ROUNDING * abs(pole)


def _named(pole: complex, of: Fastest) -> str:
    """A pole in words."""
    if _brakes(pole, of):
        return f"dampers, which brake a motion at {abs(pole):.4g} 1/s"
    servo = pole == -of.servo
    return f"{'servo of' if servo else 'mode at'} {(of.servo if servo else of.mode) / (2 * math.pi):.4g} Hz"
