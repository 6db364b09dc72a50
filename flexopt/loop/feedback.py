"""Task-space feedback laws f(e, ė) as graphs: what the controller's states do and which force it asks for.

In: end-point error e = r_d − r and its rate (n_task,), the law's own states and constants. Out: f (n_task,) and the
states' derivative (continuous) or successor (sampled). The gains are constants of the loop, so one graph serves all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.algebra import apply_pseudo_inverse
from flexopt.foundation.control import Control
from flexopt.plant.control import task_to_joints

Law = Literal["pd", "pid", "state_space", "none"]


def joint_torque(jacobian: ca.SX, force: ca.SX, control: Control, damping: ca.SX | None = None) -> ca.SX:
    """τ_a = Jvᵀ f (transpose), Jv⁺ f (inverse) or J⁺_λ f (damped), (n,); article, section 3.2, and `plant.control`.

    Args:
        jacobian: Jv (n_task, n).
        force: f (n_task,).
        control: which.
        damping: λ in place of the control's own.
    """
    if control == "inverse" and jacobian.shape == (2, 2):
        a, b, c, d = jacobian[0, 0], jacobian[0, 1], jacobian[1, 0], jacobian[1, 1]
        twice = 2 / (a * d - b * c)  # CasADi would turn a product with 1/det back into two divisions
        half = 0.5 * force
        return twice * ca.vertcat(d * half[0] - b * half[1], a * half[1] - c * half[0])
    return task_to_joints(jacobian, control, force, damping)


def nullspace_torque(jacobian: ca.SX, rates: ca.SX, damping: ca.SX) -> ca.SX:
    """−d (I − Jv⁺ Jv) q̇, (n,): a damper on the self-motion of an arm with more joints than task rows.

    Args:
        jacobian: Jv (n_task, n), n > n_task.
        rates: q̇ (n,).
        damping: d, N m s/rad or N s/m.
    """
    return -damping * (rates - apply_pseudo_inverse(jacobian, jacobian @ rates))


def low_pass(now: ca.SX, before: ca.SX, corner: ca.SX, period: ca.SX | float) -> ca.SX:
    """The low-pass ẏ = ω (m − y) over one sample, m held: y at its end.

    Args:
        now: m.
        before: y at the start.
        corner: ω, rad/s.
        period: of the sample, s.
    """
    return now + ca.exp(-corner * period) * (before - now)


def self_motion_damping(jacobian: NDArray[np.float64], mass: NDArray[np.float64], decay: float) -> float:
    """D with which the fastest self-motion decays like exp(−decay t): decay / λmax(Nᵀ M_a⁻¹ N), N the null space of Jv.

    Args:
        jacobian: Jv (n_task, n), n > n_task.
        mass: M_a (n, n) of the joints.
        decay: of the fastest, 1/s.
    """
    free: NDArray[np.float64] = np.linalg.svd(jacobian)[2][len(jacobian) :]
    return decay / float(np.linalg.eigvalsh(free @ np.linalg.inv(mass) @ free.T)[-1])


@dataclass(frozen=True)
class FeedbackLaw:
    """Which law, and how many task rows and controller states it has.

    Attributes:
        law: `"pd"`: f = Kp e + Kv ė; `"pid"`: f = Kp e + Kv ė + i, i̇ = Ki e, |i| ≤ integral_limit; `"state_space"`:
            ż = A z + B e, f = C z + D e; `"none"`: f = 0.
        n_task: task rows.
        order: states of the state-space law.
        sampled: states step from sample to sample (A, B, C, D then belong to the sampled law).
    """

    law: Law
    n_task: int
    order: int
    sampled: bool

    @property
    def n_states(self) -> int:
        """States of the law."""
        return {"pid": self.n_task, "state_space": self.order}.get(self.law, 0)

    @property
    def constants(self) -> dict[str, int]:
        """Names and sizes of what the law needs to know; matrices by columns."""
        r, n = self.n_task, self.order
        if self.law == "none":
            return {}
        if self.law == "state_space":
            return {"A": n * n, "B": n * r, "C": r * n, "D": r * r}
        gains = {"kp": r, "kv": r}
        return gains | {"ki": r, "integral_limit": 1} if self.law == "pid" else gains

    def force(self, e: ca.SX, e_rate: ca.SX, states: ca.SX, of: Mapping[str, ca.SX]) -> ca.SX:
        """f, N (transpose control) or as the inverse control scales it."""
        if self.law == "none":
            return ca.SX.zeros(self.n_task, 1)
        if self.law == "state_space":
            r, n = self.n_task, self.order
            return ca.reshape(of["C"], r, n) @ states + ca.reshape(of["D"], r, r) @ e
        force = of["kp"] * e + of["kv"] * e_rate
        return force + states if self.law == "pid" else force

    def derivative(self, e: ca.SX, states: ca.SX, of: Mapping[str, ca.SX]) -> ca.SX:
        """Rate of the states, or for a sampled state-space law their successors."""
        if self.law == "state_space":
            r, n = self.n_task, self.order
            return ca.reshape(of["A"], n, n) @ states + ca.reshape(of["B"], n, r) @ e
        if self.law == "pid":
            rate, limit = of["ki"] * e, of["integral_limit"]
            # The integral stands still where it would leave its limit.
            outward = (ca.fabs(states) >= limit) * (states * rate > 0)
            return ca.if_else(outward, 0, rate)
        return ca.SX.zeros(0, 1)

    def successor(self, e: ca.SX, states: ca.SX, period: ca.SX, of: Mapping[str, ca.SX]) -> ca.SX:
        """States at the next sample."""
        if self.law == "state_space":
            return self.derivative(e, states, of)
        if self.law == "pid":
            limit = of["integral_limit"]
            return ca.fmax(-limit, ca.fmin(limit, states + period * of["ki"] * e))
        return states
