"""Points that satisfy equations and inequalities inside bounds, as a Function of the start: damped Newton steps.

In: rows c(z) as a graph. Out: a Function that moves z towards lower ≤ c(z) ≤ upper with z inside its own bounds, by a
fixed number of Levenberg–Marquardt steps on what is violated; a step that does not help is not taken, but shortened.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from flexopt.algebra.dense import solve_spd

# Steps in one call; callers repeat it for the points that are not done.
STEPS = 8
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
