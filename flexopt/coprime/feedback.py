"""A plant and a controller in feedback: closed loop and margin.

In: plant P, controller K and the sign of the feedback. Out: the closed-loop realisation, and b_{P,K}.
"""

from __future__ import annotations

import numpy as np

from flexopt.coprime.guard import guarded
from flexopt.coprime.norms import hinf_peak
from flexopt.coprime.system import PAIR, StateSpace, SystemLike, system_pair
from flexopt.foundation.boundary import public, words

ILL_POSED = 1e-13


@public(P=PAIR["P1"], K=PAIR["P2"], sign=words(-1, 1))
@guarded
def ncf_margin(P: SystemLike, K: SystemLike, sign: int = -1) -> float:
    """b_{P,K} = ‖[K; I](I + PK)⁻¹[I P]‖∞⁻¹ for u = −K y (sign = −1; sign = +1: u = K y), between 0 and ε_max.

    It is 0 where the loop is not internally stable or not well posed.

    Args:
        P: plant (p outputs, m inputs), anything `state_space` takes.
        K: controller (m outputs, p inputs), likewise.
        sign: −1 for negative feedback, +1 for positive.

    Raises:
        InputError: a system is not usable, sizes or sampling periods do not fit, or `sign` is neither −1 nor +1.

    Source: Vinnicombe, IEEE Transactions on Automatic Control 38(9), 1993.

    Example:
        >>> round(flexopt.ncf_margin(([[-1.0]], [[1.0]], [[1.0]]), 1.0), 4)  # 1/(s + 1) with gain 1
        0.7071
    """
    loop = closed_loop(P, K, sign)
    if loop is None:
        return 0.0
    norm = hinf_peak(loop)[0]
    return 0.0 if norm == np.inf else min(1.0, 1.0 / norm)


@guarded
def closed_loop(P: SystemLike, K: SystemLike, sign: int = -1) -> StateSpace | None:
    """T = [K; I](I + PK)⁻¹[I P] for u = −K y, or with K replaced by −K for sign = +1; None where it is not well posed.

    T maps disturbances (at the plant's output (p,), at its input (m,)) to (−u, y). Up to a factor that is co-inner, it
    is the closed loop T_zw = [K; I](I + PK)⁻¹M̃⁻¹ of normalized-coprime-factor synthesis, and has the same norm.

    Raises:
        InputError: as `ncf_margin`.
    """
    call = "ncf_margin"
    plant, controller = system_pair((P, K), ("P", "K"), call, feedback=True)
    Bk, Dk = controller.B, -sign * controller.D
    Ck = -sign * controller.C
    A, B, C, D = plant.A, plant.B, plant.C, plant.D
    p, m = D.shape
    posed = np.eye(p) + D @ Dk
    if np.linalg.svd(posed, compute_uv=False)[-1] <= ILL_POSED * (1 + np.linalg.norm(D, 2) * np.linalg.norm(Dk, 2)):
        return None
    # y = E (C x − D Ck ξ + w1 + D w2) with E = (I + D Dk)⁻¹, −u = Ck ξ + Dk y
    y_states = np.linalg.solve(posed, np.hstack([C, -D @ Ck]))
    y_inputs = np.linalg.solve(posed, np.hstack([np.eye(p), D]))
    n, nk = plant.n_states, controller.n_states
    u_states = np.hstack([np.zeros((m, n)), Ck]) + Dk @ y_states
    u_inputs = Dk @ y_inputs
    w2 = np.hstack([np.zeros((m, p)), np.eye(m)])
    A_loop = np.vstack(
        [np.hstack([A, np.zeros((n, nk))]) - B @ u_states, np.hstack([np.zeros((nk, n)), controller.A]) + Bk @ y_states]
    )
    B_loop = np.vstack([B @ (w2 - u_inputs), Bk @ y_inputs])
    return StateSpace(A_loop, B_loop, np.vstack([u_states, y_states]), np.vstack([u_inputs, y_inputs]), plant.dt)
