"""How far numbers may lie from what is kept: one table by quantity name, with the reason of each loose row.

An entry may move by `relative` of itself, plus `of_largest` of the largest entry of its quantity (or of the quantity
that `scale` names, beside it in the document), plus `absolute`.
"""

from __future__ import annotations

import re
from fnmatch import fnmatchcase
from functools import cache
from typing import NamedTuple


class Tolerance(NamedTuple):
    """How far an entry of a quantity may lie from the kept one."""

    relative: float = 1e-9
    of_largest: float = 1e-11
    absolute: float = 1e-13
    scale: str = ""
    reason: str = ""


DEFAULT = Tolerance()

# Answers of searches: an optimum is found to the root of what its value is found to, for the value is flat there.
VALUE = Tolerance(1e-6, 1e-6, 1e-12, "objective_scale", "values at an optimum: solver's 1e-8, scaled by the objective")
PLACE = Tolerance(1e-4, 1e-4, 1e-4, "", "places of an optimum: root of the solver's 1e-8, as the value is flat there")
AT_PLACE = Tolerance(1e-3, 1e-4, 1e-9, "", "computed where an optimum lies, which is known to 1e-4")
W_AT_PLACE = Tolerance(1e-3, 1e-4, 0.0, "scale", "w_i where an optimum lies, which is known to 1e-4")

# The first pattern that matches "call:quantity", indices left out, counts.
TABLE: tuple[tuple[str, Tolerance], ...] = (
    # What measures rounding is rounding itself: it may not grow a million times.
    *(
        (pattern, Tolerance(0.0, 1e6, 1e-9, "", "measures rounding: other at every order of additions"))
        for pattern in (
            "*epsilon_max*_error",
            "*_residual",
            "*rounding",
            "*stationarity",
            "*target_error",
            "*present_off",
            "*end_point_error",
            "*static_residual",
            "*damped_difference",
        )
    ),
    # --- searches
    ("certify*:upper", VALUE),
    ("certify*:value", VALUE),
    ("certify_bound:*", AT_PLACE),
    *(
        (f"{call}:{pattern}", row)
        for call in ("select*", "solve_*", "plan_base", "report", "explore_problem")
        for pattern, row in (
            (
                "*objective_scale",
                Tolerance(1e-6, reason="scale of an objective: the largest of a scan, then optimised"),
            ),
            ("*objective", VALUE),
            ("*objectives", VALUE),
            ("*worth", VALUE),
            ("*standing", VALUE),
            ("*V", VALUE),
            ("*w", W_AT_PLACE),
            ("*base", PLACE),
            ("*posture", PLACE),
            ("*end_point", PLACE),
            ("*problem.*", Tolerance(1e-6, 1e-9, reason="bounds that are assumed of the reach, which is optimised")),
            ("*", AT_PLACE),
        )
    ),
    *(
        (f"verdict*:{pattern}", row)
        for pattern, row in (
            ("*w", Tolerance(1e-3, 1e-3, 1e-8, "", "w_i where an optimum lies: zero there up to the solver")),
            ("*base", PLACE),
            ("*posture", PLACE),
            ("*", AT_PLACE),
        )
    ),
    ("nullspace_trajectory:*", Tolerance(1e-6, 1e-6, 1e-12, "", "steps of a law, each on the last one's rounding")),
    ("*gradient.*.base", Tolerance(1e-4, 1e-5, 1e-9, "", "0 but for rounding: where a machine stands changes nothing")),
    # --- eigenvalues, roots and peaks of the loop
    *(
        (
            f"{call}:*gradient.{name}.*",
            Tolerance(1e-4, 1e-5, 1e-13, "", "derivative of what a root or peak is found of"),
        )
        for call in ("outcome", "evaluate")
        for name in (
            "settling",
            "swing",
            "allowed_gain",
            "delay_margin",
            "disk_margin",
            "sensitivity_peak",
            "complementary_peak",
            "h2_norm",
            "decay",
        )
    ),
    *(
        (f"*:*{name}*", Tolerance(1e-6, 1e-6, 1e-12, "", "a root, a peak or an eigenvalue of no symmetric matrix"))
        for name in (
            "settling",
            "swing",
            "allowed_gain",
            "gain_intervals",
            "delay_margin",
            "disk_margin",
            "h2_norm",
            "sensitivity_peak",
            "complementary_peak",
            "decay",
            "drift",
            "other_",
            "self_motion",
        )
    ),
    ("outcome:*", Tolerance(1e-7, 1e-8, 1e-13, "", "eigenvalues and derivatives of a matrix that is not symmetric")),
    ("stable_region:*", Tolerance(1e-4, 1e-4, 1e-9, "", "climbs over uncertain parameters, and borders by bisection")),
    ("sensitivity:*", Tolerance(1e-6, 1e-6, 1e-12, "", "sums over a Sobol' sample of a fixed seed")),
    (
        "map_workspace:*",
        Tolerance(1e-5, 1e-5, 1e-9, "", "postures of redundant arms: an iteration leaves 1e-7 of them open"),
    ),
    ("map_loop:*", Tolerance(1e-6, 1e-7, 1e-12, "", "eigenvalues of no symmetric matrix")),
    ("stability_border:*", Tolerance(1e-5, 0.0, 0.0, "", "borders by bisection on a logarithmic grid")),
    ("sampled_loop:*", Tolerance(1e-6, 1e-8, 1e-9, "", "eigenvalues of no symmetric matrix")),
    # --- curves, runs, fits
    ("atlas:*", Tolerance(1e-5, 1e-6, 1e-9, "", "lengths along vertices that Newton's method ends at")),
    *(
        (f"{call}:*settling_time*", Tolerance(0.0, 0.0, 0.011, "", "quantised by the samples of a run"))
        for call in ("simulate*", "run_experiment", "report")
    ),
    *(
        (f"{call}:*{name}*", Tolerance(1e-3, 1e-3, 1e-6, "", "fitted to the samples of a short run"))
        for call in ("simulate*", "run_experiment")
        for name in ("growth_rate", "frequenc", "residual_oscillation")
    ),
    *(
        (f"{call}:*", Tolerance(1e-6, 1e-7, 1e-10, "", "integrated over hundreds of steps"))
        for call in ("simulate*", "run_experiment", "export_fmu")
    ),
    ("identify:*interval*", Tolerance(1e-2, 1e-2, 1e-9, "", "intervals where least squares stop")),
    ("identify:*", Tolerance(1e-3, 1e-3, 1e-9, "", "least squares stop at a relative step of 1e-8 in flat valleys")),
    ("inverse_kinematics:*", Tolerance(1e-6, 1e-7, 1e-8, "", "Newton's method stops at a residual of 1e-9 m")),
    ("export_c:*", Tolerance(1e-6, 0.0, 1e-8, "", "entries of very different size, and errors that are allowed")),
    ("explore:*", Tolerance(1e-6, 1e-9, 1e-12, "", "gains and ranges that follow from modes")),
    # --- derivatives
    *(
        (pattern, Tolerance(1e-6, 1e-8, 1e-13, "", "derivatives of eigenvectors: rounding over the gap of frequencies"))
        for pattern in ("*gradient*", "*_parameters*", "*w_z", "*w_p", "*w_posture", "*effects", "*rate", "*direction")
    ),
    # --- measures: rounding of a_i and b_i, whose product is the scale
    ("*:*w", Tolerance(1e-9, 1e-10, 0.0, "scale", "rounding of a_i and b_i, whose sizes' product is the scale")),
    ("*:*", Tolerance(1e-8, 1e-10, 1e-13, "", "rounding through an inverse Jacobian and a modal basis")),
)


@cache
def tolerance(case: str, quantity: str) -> Tolerance:
    """The tolerance of a quantity of a case."""
    plain = re.sub(r"\[\d+\]", "", quantity)
    name = f"{case.partition('-')[0]}:{plain}"
    return next((allowed for pattern, allowed in TABLE if fnmatchcase(name, pattern)), DEFAULT)
