"""How finely a sample is integrated: the steps that a method needs for the fastest mode, servo and damper.

In: options of a simulation, the fastest mode, servo and damper. Out: steps in a sample, iterations in an implicit one.
"""

from __future__ import annotations

import math

from flexopt.errors import InputError
from flexopt.model.simulation import SimulationOptions

# Steps of the accurate methods, as shares of the fastest mode's radian.
ACCURATE_STEP = 0.3
# And of the fastest damper's time constant, so that the implicit method's iterations converge.
DAMPED_STEP = 0.5
# Where RK4 leaves the imaginary axis: |R(iy)| > 1 beyond √8.
RK4_LIMIT = math.sqrt(8.0)
# And where it leaves the negative real axis: |R(−y)| > 1 beyond.
RK4_REAL_LIMIT = 2.785
SUBSTEPS_MAX = 1000


def stepping(options: SimulationOptions, mode: float, servo: float, damper: float) -> tuple[int, int]:
    """Integration steps in a sample, and iterations of the implicit method.

    Args:
        options: of the simulation.
        mode: the fastest one, rad/s.
        servo: the fastest one of the drives, 1/s.
        damper: how fast the strongest dampers brake what they hold, 1/s.
    """
    period = 1 / options.rate
    fastest, substeps = max(mode, servo), options.substeps
    what = f"mode at {mode / (2 * math.pi):.4g} Hz" if mode >= servo else f"servo of {servo / (2 * math.pi):.4g} Hz"
    if substeps is None:
        substeps = 1 if options.integrator == "rk4" else max(1, math.ceil(fastest * period / ACCURATE_STEP))
        if options.integrator == "gauss":
            # Where even the most are too few the run tells it.
            substeps = max(substeps, min(math.ceil(damper * period / DAMPED_STEP), SUBSTEPS_MAX))
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
    # Fixed-point iterations shrink the change by a quarter of the step in radians of what is fastest.
    shrink = min(0.25 * max(fastest, damper) * period / substeps, 0.75)
    return substeps, max(6, math.ceil(-38.0 / math.log(shrink))) if options.integrator == "gauss" else 0
