"""The map from forces at the end-point to joint commands: what "control" means, in one place.

In: Jv (r, n) and a control as `flexopt.foundation.control.check_control` gives it. Out: graphs of the map Jvᵀ
(transpose), Jv⁺ (inverse) or J⁺_λ = Jvᵀ (Jv Jvᵀ + λ² I)⁻¹ (damped), and of its transposed.

Source: article, section 3.2; the damped inverse: Nakamura and Hanafusa, Journal of Dynamic Systems, Measurement, and
Control 108(3), 1986; Wampler, IEEE Transactions on Systems, Man, and Cybernetics 16(1), 1986.
"""

from __future__ import annotations

import casadi as ca

from flexopt.algebra import (
    apply_damped_inverse,
    apply_damped_inverse_transposed,
    apply_pseudo_inverse,
    apply_pseudo_inverse_transposed,
)
from flexopt.foundation.control import Control, control_damping


def task_to_joints(jv: ca.SX, control: Control, right: ca.SX, damping: ca.SX | None = None) -> ca.SX:
    """Jvᵀ B, Jv⁺ B or J⁺_λ B, (n, k), for B (r, k); λ is the control's own unless `damping` is given."""
    if control == "transpose":
        return jv.T @ right
    size = _damping(control, damping)
    return apply_pseudo_inverse(jv, right) if size is None else apply_damped_inverse(jv, size, right)


def task_to_joints_transposed(jv: ca.SX, control: Control, right: ca.SX) -> ca.SX:
    """Jv B, (Jv⁺)ᵀ B or (J⁺_λ)ᵀ B, (r, k), for B (n, k)."""
    if control == "transpose":
        return jv @ right
    size = _damping(control, None)
    if size is None:
        return apply_pseudo_inverse_transposed(jv, right)
    return apply_damped_inverse_transposed(jv, size, right)


def _damping(control: Control, given: ca.SX | None) -> ca.SX | None:
    own = control_damping(control) if given is None else None
    return given if own is None else ca.SX(own)
