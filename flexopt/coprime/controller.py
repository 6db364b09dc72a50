"""The controller that attains the largest margin.

In: a plant. Out: a proper state-space controller for negative feedback, of lower order than the plant, whose margin has
been checked.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np

from flexopt.coprime.enclosure import factor
from flexopt.coprime.feedback import ncf_margin
from flexopt.coprime.guard import guarded
from flexopt.coprime.margin import RiccatiPair, solve_pairs
from flexopt.coprime.scaling import scale_for_riccati
from flexopt.coprime.symbols import rotation, to_continuous, to_discrete, turn_controller, turn_plant
from flexopt.coprime.system import PLANT, Matrix, StateSpace, SystemLike, from_arguments
from flexopt.errors import FlexoptError, NoSolutionFound
from flexopt.foundation.arrays import MatrixLike
from flexopt.foundation.boundary import public

ATTAINED = 1e-6
CLOSE = 1e-10  # no other way is tried below this
NEGLIGIBLE = 1e-11  # a state of the balanced plant with ν below this moves the margin by less than 2ν
EQUAL = (1e-8, 1e-12, 1e-5)  # how close two ν count as one
TURNS = (0.0, 0.4, -0.7)  # rotations of the graph, rad, tried in turn


@public(checks=PLANT)
@guarded
def optimal_controller(
    A: SystemLike,
    B: MatrixLike | None = None,
    C: MatrixLike | None = None,
    D: MatrixLike | None = None,
    *,
    dt: float | None = 0.0,
) -> StateSpace:
    """K with b_{P,K} = ε_max, for u = −K y.

    At γ = 1/ε_max the central controller of Glover and McFarlane is the descriptor system

        E ẋ = (E (A + BF) + γ² Z Cᵀ(C + DF)) x + γ² Z Cᵀ y,   u = BᵀX x − Dᵀ y,   E = (1 − γ²) I + ZX,

    with singular E. In the coordinates where X = Z = diag(ν_i), E is diagonal, and its zeros (ν_i = ν_1) are solved
    for: the order is n less the multiplicity of ν_1, and less the states with ν_i = 0. A sampled plant goes through the
    bilinear transform, which keeps b_{P,K}; one with a pole at z = −1 has its graph turned first.

    Args:
        A: (n, n); or a whole system (see `state_space`) when B and C are left out.
        B: (n, m).
        C: (p, n).
        D: (p, m), zero when left out.
        dt: sampling period, s; 0 for continuous time.

    Returns:
        StateSpace with m outputs and p inputs, and the plant's dt.

    Raises:
        InputError: a matrix is not usable (all faults in one message).
        NotStabilizable: as `robust_margin`.
        NoSolutionFound: no proper controller was found whose margin is ε_max to 1e-6.

    Source: Glover and McFarlane, IEEE Transactions on Automatic Control 34(8), 1989.

    Example:
        >>> plant = ([[0, 1], [0, 0]], [[0], [1]], [[1, 0]])
        >>> controller = flexopt.optimal_controller(*plant)
        >>> round(flexopt.ncf_margin(plant, controller), 5)
        0.38268
    """
    plant = from_arguments(A, B, C, D, dt, "optimal_controller")
    epsilon = solve_pairs(scale_for_riccati(plant), "optimal_controller")[0].epsilon
    best, margin = _attempt(plant, TURNS[0], EQUAL[0])
    for angle, equal in list(product(TURNS, EQUAL))[1:]:
        if abs(margin / epsilon - 1.0) <= CLOSE:
            break
        other, reached = _attempt(plant, angle, equal)
        if abs(reached / epsilon - 1.0) < abs(margin / epsilon - 1.0):
            best, margin = other, reached
    if abs(margin / epsilon - 1.0) <= ATTAINED:
        return best
    raise NoSolutionFound(
        f"optimal_controller: no proper controller attains ε_max = {epsilon:.6g} to {ATTAINED:g}; the best one tried "
        f"gives {margin:.6g} (the optimal controller may be improper, or ε_max too small for double precision)",
        violations={"margin": 1.0 - margin / epsilon},
        iterate={"margin": margin},
    )


def _attempt(plant: StateSpace, angle: float, equal: float) -> tuple[StateSpace, float]:
    """One way to the controller, and its margin; a zero gain and 0 where it meets a singular matrix."""
    nothing = StateSpace(np.zeros((0, 0)), np.zeros((0, plant.n_outputs)), np.zeros((plant.n_inputs, 0)), plant.D.T * 0)
    Q = rotation(plant.n_outputs, plant.n_inputs, angle)
    try:
        turned = turn_plant(plant, Q) if angle else plant
        turned = to_continuous(turned) if plant.discrete else turned
        controller = _continuous(turned, equal)
        controller = to_discrete(controller, plant.dt) if plant.discrete else controller
        controller = turn_controller(controller, Q.T) if angle else controller
        if not all(np.all(np.isfinite(M)) for M in (controller.A, controller.B, controller.C, controller.D)):
            return nothing, 0.0
        return controller, ncf_margin(plant, controller)
    except (np.linalg.LinAlgError, FlexoptError):
        return nothing, 0.0


def _continuous(plant: StateSpace, equal: float) -> StateSpace:
    """The controller of a continuous plant; ν_i within `equal` of ν_1, relative, count as ν_1."""
    scaled = scale_for_riccati(plant)
    s, nu = _balanced(scaled.system, solve_pairs(scaled, "optimal_controller")[0])
    gamma2 = 1.0 + (float(nu[0]) ** 2 if nu.size else 0.0)
    A, B, C, D = s.A, s.B, s.C, s.D
    F = -np.linalg.solve(np.eye(D.shape[1]) + D.T @ D, D.T @ C + B.T * nu)
    E = nu**2 - (gamma2 - 1.0)
    drive = gamma2 * nu[:, None] * C.T
    left = E[:, None] * (A + B @ F) + drive @ (C + D @ F)
    out = B.T * nu
    first = np.abs(nu - nu[:1]) <= equal * nu[:1]
    slow = ~first
    fast = left[np.ix_(first, first)]
    solved = np.linalg.solve(fast, np.hstack([left[np.ix_(first, slow)], drive[first]]))
    via_state, via_input = solved[:, : int(slow.sum())], solved[:, int(slow.sum()) :]
    inverse = 1.0 / E[slow][:, None]
    Ak = inverse * (left[np.ix_(slow, slow)] - left[np.ix_(slow, first)] @ via_state)
    Bk = inverse * (drive[slow] - left[np.ix_(slow, first)] @ via_input)
    Ck = out[:, slow] - out[:, first] @ via_state
    Dk = -D.T - out[:, first] @ via_input
    root = math.sqrt(scaled.rate)
    return StateSpace(Ak * scaled.rate, Bk * root, -Ck * root, -Dk, 0.0)  # − : the source has positive feedback


def _balanced(s: StateSpace, pair: RiccatiPair) -> tuple[StateSpace, Matrix]:
    """The plant in coordinates where X = Z = diag(ν), ν descending, without the states of negligible ν (q,)."""
    Rx, Rz = factor(pair.X), factor(pair.Z).T
    left, values, right = np.linalg.svd(Rx @ Rz)
    keep = values > NEGLIGIBLE
    nu = values[keep]
    T = Rz @ right[keep].T / np.sqrt(nu)
    Ti = (left[:, keep] / np.sqrt(nu)).T @ Rx
    return StateSpace(Ti @ s.A @ T, Ti @ s.B, s.C @ T, s.D, s.dt), nu
