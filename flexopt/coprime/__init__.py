"""Normalized coprime factors: how much uncertainty a loop tolerates, and how far apart two plants are for feedback.

In: linear plants and controllers, continuous or sampled, as matrices or as other libraries' system objects. Out: the
optimal margin ε_max and the controller that attains it, the margin b_{P,K} of a given controller, the H∞ norm, the gap
and the ν-gap.
"""

from typing import TYPE_CHECKING

from flexopt.foundation.later import later

if TYPE_CHECKING:
    from flexopt.coprime.controller import optimal_controller as optimal_controller
    from flexopt.coprime.feedback import closed_loop as closed_loop
    from flexopt.coprime.feedback import ncf_margin as ncf_margin
    from flexopt.coprime.gaps import gap as gap
    from flexopt.coprime.gaps import nu_gap as nu_gap
    from flexopt.coprime.margin import RobustMargin as RobustMargin
    from flexopt.coprime.margin import robust_margin as robust_margin
    from flexopt.coprime.norms import hinf_norm as hinf_norm
    from flexopt.coprime.norms import hinf_peak as hinf_peak
    from flexopt.coprime.system import StateSpace as StateSpace
    from flexopt.coprime.system import state_space as state_space

__getattr__ = later(
    __name__,
    controller="optimal_controller",
    feedback="closed_loop ncf_margin",
    gaps="gap nu_gap",
    margin="RobustMargin robust_margin",
    norms="hinf_norm hinf_peak",
    system="StateSpace state_space",
)
