"""The nonlinear program of several configurations that belong together.

In: the graphs of one configuration and how the configurations share variables. Out: IPOPT on all of them, with exact
sparse derivatives. What differs between programs of one structure are parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Literal

import casadi as ca
import numpy as np

from flexopt.selection.nlp import IPOPT_OPTIONS, Configuration, Parameters
from flexopt.selection.programs import make_solver

# "worst": max min_k V_k;  "weighted": max Σ share_k V_k;  "motion": the shortest way that keeps every V_k at a level.
Goal = Literal["worst", "weighted", "motion"]
# Most starts take 10 to 30 iterations; those that wander are not worth waiting for.
OPTIONS: dict[str, Any] = {"max_iter": 120, "tol": 1e-9, "constr_viol_tol": 1e-10}
Symbols = dict[str, ca.MX]


@dataclass(frozen=True)
class Joint:
    """How K configurations share the variables x: where each finds its z, and which entries are near each other.

    Attributes:
        places: for each configuration the indices in x of its z, (K, n_z).
        pairs: indices (i, j) of entries of which x_j − x_i is bounded.
    """

    places: tuple[tuple[int, ...], ...]
    pairs: tuple[tuple[int, int], ...]

    @property
    def count(self) -> int:
        """K."""
        return len(self.places)

    @cached_property
    def n_x(self) -> int:
        """Number of variables, the level t of "worst" left out."""
        return 1 + max(max(place) for place in self.places)


def layout(configuration: Configuration, joint: Joint) -> Parameters:
    """The program's parameters: of one configuration, `target` (K n_task), `share` (K) and the `level` to keep."""
    plant = configuration.measures.plant
    n_z = plant.n_base + plant.n_actuated
    sizes = {"target": plant.n_task * joint.count, "share": joint.count, "row_scale": configuration.n_rows}
    sizes |= {"z_scale": n_z, "alpha": plant.n_passive, "size": 1, "cost": 1, "now": n_z, "level": 1}
    return Parameters((*sizes.items(), ("c", configuration.n_constants), ("p", len(plant.parameter_names))))


@dataclass(frozen=True)
class _Part:
    """One configuration's share of the program: V / size less travel, its rows, derivatives by x.

    `second` is the share in the Lagrangian's second derivatives, (n_x, n_x).
    """

    value: ca.MX
    slope: ca.MX
    rows: ca.MX
    row_slopes: ca.MX
    second: ca.MX


@lru_cache(maxsize=16)
def build_joint_solver(configuration: Configuration, joint: Joint, goal: Goal) -> ca.Function:
    """IPOPT on x = z / z_scale (and t, last, for "worst"); V_k / size less the cost of travel.

    Constraints: the rows of every configuration, (row − target) / row_scale; x_j − x_i for the pairs; and V_k ≥ t
    ("worst") or V_k ≥ level ("motion"), as differences.
    """
    n_rows, count = configuration.n_rows, joint.count
    n_x = joint.n_x + (1 if goal == "worst" else 0)
    x, (parameters, s) = ca.MX.sym("x", n_x), layout(configuration, joint).symbols()
    steps = _stepping(joint, n_x)
    before = n_rows * count + len(joint.pairs)
    lam_f = ca.MX.sym("lam_f")
    lam_g = ca.MX.sym("lam_g", before + (0 if goal == "weighted" else count))

    parts: list[_Part] = []
    for k in range(count):
        of_rows = lam_g[k * n_rows : (k + 1) * n_rows] / s["row_scale"]
        of_value = -lam_f * s["share"][k] if goal == "weighted" else lam_g[before + k]
        parts.append(_part(configuration, joint, s, x, k, of_value, of_rows))
    second = ca.MX(n_x, n_x)
    for part in parts:
        second += part.second
    constraints, jacobian = [*(part.rows for part in parts), steps @ x], [*(p.row_slopes for p in parts), ca.MX(steps)]
    if goal == "weighted":
        f = -ca.dot(s["share"], ca.vertcat(*(part.value for part in parts)))
        gradient = -(s["share"].T @ ca.vertcat(*(part.slope for part in parts))).T
    else:
        last = ca.DM(ca.Sparsity.triplet(1, n_x, [0], [n_x - 1]), 1.0)
        level, of_level = (x[-1], ca.MX(last)) if goal == "worst" else (s["level"], ca.MX(1, n_x))
        constraints += [part.value - level for part in parts]
        jacobian += [part.slope - of_level for part in parts]
        f, gradient = -x[-1], ca.MX(-last.T)
        if goal == "motion":
            f, gradient = ca.sumsqr(steps @ x) / 2, steps.T @ (steps @ x)
            second += lam_f * (steps.T @ steps)
    g = ca.vertcat(*constraints)
    given = {
        "grad_f": ca.Function("grad_f", [x, parameters], [f, ca.densify(gradient)], ["x", "p"], ["f", "grad_f_x"]),
        "jac_g": ca.Function("jac_g", [x, parameters], [g, ca.vertcat(*jacobian)], ["x", "p"], ["g", "jac_g_x"]),
        "hess_lag": ca.Function(
            "hess_lag", [x, parameters, lam_f, lam_g], [ca.triu(second)],
            ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"],
        ),
    }  # fmt: skip
    options = IPOPT_OPTIONS | given | {"ipopt": IPOPT_OPTIONS["ipopt"] | OPTIONS}
    return make_solver("several", "ipopt", {"x": x, "p": parameters, "f": f, "g": g}, options)


def _part(
    configuration: Configuration, joint: Joint, s: Symbols, x: ca.MX, k: int, of_value: ca.MX, of_rows: ca.MX
) -> _Part:
    """Configuration k; `of_value` and `of_rows` (n_rows,) are the multipliers of V_k / size and of its rows."""
    measures, plant = configuration.measures, configuration.measures.plant
    n_z, n_task = plant.n_base + plant.n_actuated, plant.n_task
    pick = _picking(joint.places[k], x.shape[0])
    own = pick @ x
    z, away = s["z_scale"] * own, own - s["now"]
    at = [z[: plant.n_base], z[plant.n_base :], s["p"]]
    held = measures.called_hold.call(at)[0]
    value, slope = configuration.slope.call([*at, held, s["alpha"]])
    row_inputs = [*at, s["c"], configuration.held_rows(held)]
    rows, row_slopes = configuration.row_slopes.call(row_inputs)
    offset = ca.vertcat(s["target"][k * n_task : (k + 1) * n_task], ca.DM.zeros(configuration.n_rows - n_task, 1))

    curved = configuration.curvature.call([*at, held, s["alpha"] * of_value / s["size"]])[0]
    curved += configuration.row_curvature.call([*row_inputs, of_rows])[0]
    curved = curved * (s["z_scale"] @ s["z_scale"].T) - 2 * s["cost"] * of_value * ca.MX.eye(n_z)
    return _Part(
        value=value / s["size"] - s["cost"] * ca.sumsqr(away),
        slope=(s["z_scale"] * slope / s["size"] - 2 * s["cost"] * away).T @ pick,
        rows=(rows - offset) / s["row_scale"],
        row_slopes=(row_slopes * (1 / s["row_scale"] @ s["z_scale"].T)) @ pick,
        second=pick.T @ ca.densify(curved) @ pick,
    )


def _picking(place: tuple[int, ...], n_x: int) -> ca.DM:
    """The sparse matrix that takes the entries of one configuration out of x."""
    pattern = ca.Sparsity.triplet(len(place), n_x, list(range(len(place))), list(place))
    return ca.DM(pattern, np.ones(len(place)))


def _stepping(joint: Joint, n_x: int) -> ca.DM:
    """The sparse matrix of differences x_j − x_i."""
    matrix = ca.DM(len(joint.pairs), n_x)
    for row, (i, j) in enumerate(joint.pairs):
        matrix[row, i], matrix[row, j] = -1.0, 1.0
    return matrix
