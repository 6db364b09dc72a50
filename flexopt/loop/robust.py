"""The task-space controller that attains ε_max in a posture, as a feedback law for the simulation.

In: a machine, a posture, the servo gain kr. Out: a `StateSpace` from the end-point error e to the force f. Sampled laws
are designed for the plant as the hold makes it, so the hold's delay is part of the design.
"""

from __future__ import annotations

from flexopt.coprime import StateSpace, optimal_controller
from flexopt.foundation.control import Control
from flexopt.foundation.kept import by_machine
from flexopt.loop.tangent import exponential
from flexopt.model import AnyMachine
from flexopt.robustness.margin import build_margin


@by_machine
def robust_law(
    machine: AnyMachine,
    posture: tuple[float, ...],
    base: tuple[float, ...],
    control: Control,
    gravity: bool,
    gain: float,
    period: float,
) -> StateSpace:
    """F = kr K e, with K the optimal controller of kr P (Appendix A), continuous for a `period` of 0, s.

    Raises:
        NotStabilizable, NoSolutionFound: as `flexopt.optimal_controller`.
    """
    margin = build_margin(machine, control, gravity)
    a, b, c = (x.full() for x in margin.physical_plant.call([base, posture, margin.plant.parameter_values]))
    if period:
        a, b = exponential(a, b, period)
    law = optimal_controller(a, gain * b, c, dt=period)
    return StateSpace(law.A, law.B, gain * law.C, gain * law.D, law.dt)
