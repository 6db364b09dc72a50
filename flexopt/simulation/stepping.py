"""How finely a sample is integrated: the steps that a method needs for the fastest mode and servo.

In: options of the simulation, the fastest mode and servo. Out: steps in a sample, and iterations of an implicit step.
"""

from __future__ import annotations

import math

from flexopt.errors import InputError
from flexopt.model.simulation import SimulationOptions

# Steps of the accurate methods, as shares of the fastest mode's radian.
ACCURATE_STEP = 0.3
# Where RK4 leaves the imaginary axis: |R(iy)| > 1 beyond √8.
RK4_LIMIT = math.sqrt(8.0)
# And where it leaves the negative real axis: |R(−y)| > 1 beyond.
RK4_REAL_LIMIT = 2.785
SUBSTEPS_MAX = 1000


def stepping(options: SimulationOptions, mode: float, servo: float) -> tuple[int, int]:
    """Integration steps in a sample, and iterations of the implicit method; the fastest mode and servo in rad/s."""
    period = 1 / options.rate
    fastest, substeps = max(mode, servo), options.substeps
    what = f"mode at {mode / (2 * math.pi):.4g} Hz" if mode >= servo else f"servo of {servo / (2 * math.pi):.4g} Hz"
    if substeps is None:
        substeps = 1 if options.integrator == "rk4" else max(1, math.ceil(fastest * period / ACCURATE_STEP))
    reach = fastest * period / substeps
    need = max(math.ceil(mode * period / RK4_LIMIT), math.ceil(servo * period / RK4_REAL_LIMIT))
    if options.integrator == "rk4" and substeps < need <= SUBSTEPS_MAX:
        raise InputError(
            f"simulate: rate = {options.rate:g} Hz with {substeps} substeps: RK4 is unstable for the {what} "
            f"(step {period / substeps:g} s); needs substeps of at least {need}, or integrator = 'dop853' or 'gauss'"
        )
    if substeps > SUBSTEPS_MAX or need > SUBSTEPS_MAX:
        raise InputError(
            f"simulate: rate = {options.rate:g} Hz is too slow for the {what}: a sample would need more than "
            f"{SUBSTEPS_MAX} integration steps"
        )
    # Fixed-point iterations shrink the change by a quarter of the step in radians of the fastest mode.
    shrink = min(0.25 * reach, 0.75)
    return substeps, max(6, math.ceil(-38.0 / math.log(shrink))) if options.integrator == "gauss" else 0
