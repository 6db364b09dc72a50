"""Points that satisfy equations and inequalities inside bounds: the one iteration onto a target or onto constraints.

In: rows c(z), and starts. Out: points with lower ≤ c(z) ≤ upper, z inside its own bounds. Rows that are a graph are
solved for many starts at once: `feasible_steps` makes a fixed number of Levenberg–Marquardt steps on what is violated,
in which a step that does not help is not taken, but shortened, and `repeated` calls it again for the points that are
not done. Rows that are no graph (under gravity, values to be kept) go from one start: `shortest_steps`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from flexopt.algebra.dense import solve_spd
from flexopt.foundation.arrays import Vector

# Steps in one call, and calls at most: Newton's steps are quadratic near a solution, so that most take two or three.
STEPS, ROUNDS = 8, 6
DAMPING_START, DAMPING_MIN = 1e-3, 1e-12
EASIER, HARDER = 0.1, 8.0
# Longest step of any variable, in its scale.
STEP_MAX = 0.5


def feasible_steps(rows: ca.SX, z: ca.SX, others: Sequence[ca.SX]) -> ca.Function:
    """Levenberg–Marquardt steps towards lower ≤ rows(z) ≤ upper.

    Args:
        rows: c, (r, 1), a graph of z and `others`.
        z: the variables, (n, 1).
        others: further symbols of the graph.

    Returns:
        Function of z (n,), damping (1,), z_lower, z_upper (n,), free (n,) (1 or 0: held), z_scale (n,), lower, upper,
        scale (r,), and `others` in order. Outputs: z, damping, and the largest violation in units of `scale`.
    """
    n, r = z.shape[0], rows.shape[0]
    sizes = {"damping": 1, "z_lower": n, "z_upper": n, "free": n, "z_scale": n, "lower": r, "upper": r, "scale": r}
    s = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
    extra = [ca.SX.sym(f"other{k}", other.shape[0]) for k, other in enumerate(others)]
    dense = [ca.densify(x) for x in (rows, ca.jacobian(rows, z))]
    graph = ca.Function("rows", [z, *others], dense, {"cse": True})
    at = ca.SX.sym("z", n)

    def violated(value: ca.SX) -> ca.SX:
        return (ca.fmin(value - s["lower"], 0) + ca.fmax(value - s["upper"], 0)) / s["scale"]

    value, jacobian = graph.call([at, *extra])
    wrong = violated(value)
    # An inequality that holds pulls nowhere.
    counts = ca.if_else(s["lower"] == s["upper"], 1.0, ca.if_else(wrong == 0, 0.0, 1.0))
    slope = ca.diag(counts / s["scale"]) @ jacobian @ ca.diag(s["free"] * s["z_scale"])
    pull = slope.T @ wrong
    stuck = ca.logic_or(
        ca.logic_and(at <= s["z_lower"], pull > 0), ca.logic_and(at >= s["z_upper"], pull < 0)
    )  # fmt: skip
    moving = ca.if_else(stuck, 0.0, 1.0)
    gram = slope.T @ slope
    size = ca.trace(gram) / n + 1e-300
    matrix = ca.diag(moving) @ gram @ ca.diag(moving) + ca.diag(size * (1 - moving + s["damping"]))
    step = -solve_spd(matrix, moving * pull)
    step = step / ca.fmax(1, ca.mmax(ca.fabs(step)) / STEP_MAX)
    moved = ca.fmin(ca.fmax(at + s["z_scale"] * step, s["z_lower"]), s["z_upper"])
    after = violated(ca.Function("values", [z, *others], [dense[0]], {"cse": True}).call([moved, *extra])[0])
    helps = ca.sumsqr(after) < ca.sumsqr(wrong)
    easier = ca.fmax(EASIER * s["damping"], DAMPING_MIN)
    outputs = [
        ca.if_else(helps, moved, at),
        ca.if_else(helps, easier, HARDER * s["damping"]),
        ca.mmax(ca.fabs(ca.if_else(helps, after, wrong))),
    ]
    one = ca.Function("feasible_step", [at, *s.values(), *extra], outputs)

    symbols = [
        ca.MX.sym(name, one.size1_in(k)) for k, name in enumerate(["z", *s, *(f"other{k}" for k in range(len(extra)))])
    ]
    here, damping, left = symbols[0], symbols[1], ca.MX(0)
    for _ in range(STEPS):
        here, damping, left = one.call([here, damping, *symbols[2:]])
    return ca.Function("feasible_steps", symbols, [here, damping, left])


def repeated(
    steps: ca.Function,
    z: Vector,
    of_z: tuple[Vector, Vector, Vector, Vector],
    of_rows: tuple[Vector, Vector, Vector],
    others: Sequence[ca.DM | Vector],
    tolerance: float,
    rounds: int = ROUNDS,
    enough: int | None = None,
) -> tuple[Vector, Vector]:
    """Repeat `feasible_steps` for the points that are not done.

    Args:
        steps: from `feasible_steps`.
        z: starts (n, N).
        of_z: z_lower, z_upper, free, z_scale, (n,) each.
        of_rows: lower, upper, (r,) or (r, N), and scale (r,).
        others: its last inputs.
        tolerance: on the largest violation, in units of `scale`.
        rounds: calls at most.
        enough: how many points suffice; all by default.

    Returns:
        z (n, N) and the largest violation (N,). A row that is no number counts as kept.
    """
    z = z.copy()
    left = np.full(z.shape[1], np.inf)
    damping = np.full(z.shape[1], DAMPING_START)
    waiting = cast(NDArray[np.int64], np.arange(z.shape[1]))
    for _ in range(rounds):
        if not waiting.size or (enough is not None and z.shape[1] - waiting.size >= enough):
            break
        rows = [x[:, waiting] if x.ndim == 2 else x for x in of_rows]
        out = steps.call([z[:, waiting], damping[None, waiting], *of_z, *rows, *others])
        z[:, waiting], damping[waiting], left[waiting] = out[0].full(), out[1].full().ravel(), out[2].full().ravel()
        waiting = waiting[left[waiting] > tolerance]
    return z, left


def shortest_steps(
    linear: Callable[[Vector], tuple[Vector, Vector]],
    z: Vector,
    scale: Vector,
    tolerance: float,
    *,
    steps: int = 12,
    bounds: tuple[Vector, Vector] | None = None,
) -> tuple[Vector, float]:
    """Newton's method from one start, each step the shortest that the linearised rows allow: Δz = −S (A S)⁺ c.

    Args:
        linear: z -> c (r,), 0 where a row is kept, and A = ∂c/∂z (r, n).
        z: the start (n,).
        scale: diagonal of S (n,): what counts as equally far, 0 for what stays.
        tolerance: on the largest |c|.
        steps: at most.
        bounds: lower and upper ends of z, (n,) each.

    Returns:
        z, and the largest |c| there; NaN where the rows are no numbers.
    """
    for left in range(steps, -1, -1):
        off, slopes = linear(z)
        error = float(np.abs(off).max(initial=0.0))
        if not error > tolerance or not left or not np.isfinite(slopes).all():
            return z, error
        z = z - scale * cast(Vector, np.linalg.lstsq(slopes * scale, off, rcond=None)[0])
        z = z if bounds is None else np.clip(z, *bounds)
    return z, np.inf
