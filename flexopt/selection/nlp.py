"""One configuration as graphs, with exact derivatives, and the nonlinear program made of it.

In: a machine, a controller, the structure of its constraints. Out: `Configuration`: Functions of objective and rows at
z = [base, posture]; from these IPOPT's program. What differs between problems of one structure (target, scales,
weights, values to be kept, constants of constraints, p) are parameters, so that solvers serve many problems.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from flexopt.algebra.feasible import feasible_steps
from flexopt.foundation.arrays import Vector
from flexopt.foundation.control import Control
from flexopt.model import AnyMachine
from flexopt.robustness.expansion import Expansion
from flexopt.robustness.margin import build_margin
from flexopt.robustness.measures import Measures, build_measures
from flexopt.selection.constraints import ConstraintSet
from flexopt.selection.programs import make_solver

QUIET: dict[str, Any] = {"print_time": False, "error_on_fail": False, "calc_lam_p": False, "no_nlp_grad": True}
IPOPT_OPTIONS: dict[str, Any] = QUIET | {
    "ipopt": {
        "print_level": 0,
        "sb": "yes",
        "tol": 1e-10,
        "constr_viol_tol": 1e-12,
        "acceptable_iter": 0,
        "max_iter": 200,
        "mu_init": 1e-4,
        "bound_relax_factor": 0.0,
    }
}
# Where optima are no points but curves and surfaces, the last digits of the barrier cost more than all else: a point
# that is good to these tolerances is left to the proof, and refined where that fails. Solves that take longer are cut
# short, and resumed where they are ahead of the best.
QUICK_OPTIONS: dict[str, Any] = {
    "max_iter": 20,
    "mu_init": 1e-8,
    "first_hessian_perturbation": 1e-2,
    "acceptable_iter": 1,
    "acceptable_tol": 1e-7,
    "acceptable_dual_inf_tol": 1e-7,
    "acceptable_constr_viol_tol": 1e-10,
    "acceptable_compl_inf_tol": 1e-8,
}
SQP_OPTIONS: dict[str, Any] = QUIET | {
    "qpsol": "qrqp",
    "qpsol_options": {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False},
    "hessian_approximation": "limited-memory",
    "lbfgs_memory": 5,
    "print_header": False,
    "print_iteration": False,
    "print_status": False,
    "max_iter": 100,
    "tol_du": 1e-7,
    "tol_pr": 1e-10,
    "min_step_size": 1e-12,
}
SQP_QUICK = 30


@dataclass(frozen=True)
class Rows:
    """The constraint rows besides the target: what decides their graph, and the graph."""

    structure: Any
    function: ca.Function = field(compare=False, hash=False, repr=False)


@dataclass(frozen=True)
class Configuration:
    """Objective and constraints of one configuration. n_z = n_b + n; k constraint rows; m modes.

    Rows are those of the task r (n_task,), then the distance from singular postures, then the constraint rows:
    n_rows = n_task + 1 + k. Functions take base (n_b,), posture (n,), p (n_par,), c (the constraints' constants) and,
    where the eigenvectors or the static deflection enter, `held` from `Measures.hold`.

    Attributes:
        machine, control, gravity: as in `Measures`.
        extra: the constraint rows, or None.
    """

    machine: AnyMachine
    control: Control
    gravity: bool
    extra: Rows | None

    @property
    def measures(self) -> Measures:
        """The measures behind the objective."""
        return build_measures(self.machine, self.control, self.gravity)

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return self.row_values.size1_out(0)

    @property
    def n_constants(self) -> int:
        """Number of constants c."""
        return self.row_values.size1_in(3)

    @cached_property
    def _symbols(self) -> dict[str, ca.SX]:
        g = self.measures.plant.graph
        count = 0 if self.extra is None else self.extra.function.size1_in(3)
        return {"base": g.base, "posture": g.posture, "p": g.p, "c": ca.SX.sym("c", count), "held": self.measures.held}

    @cached_property
    def _z(self) -> ca.SX:
        return ca.vertcat(self._symbols["base"], self._symbols["posture"])

    @cached_property
    def _expansion(self) -> Expansion:
        return Expansion(self.measures)

    @cached_property
    def _rows(self) -> ca.SX:
        return self._rows_of(self.measures.graph.end_point) if self.gravity else self._rows_at_rest

    @cached_property
    def _rows_at_rest(self) -> ca.SX:
        g = self.measures.plant.graph
        return self._rows_of(ca.substitute(g.end_point, g.q, g.rest))

    def _rows_of(self, task: ca.SX) -> ca.SX:
        s, plant = self._symbols, self.measures.plant
        at = [s["base"], s["posture"], s["p"]]
        parts = [task, plant.singularity_sine_squared.call(at)[0]]
        if self.extra is not None:
            parts += self.extra.function.call([*at, s["c"]])
        return ca.densify(ca.vertcat(*parts))

    @cached_property
    def rows_at_rest(self) -> ca.Function:
        """(base, posture, p, c) -> rows (n_rows,) with the passive coordinates at rest."""
        return self._function("rows_at_rest", ("base", "posture", "p", "c"), {}, [self._rows_at_rest], ["rows"])

    @cached_property
    def feasible(self) -> ca.Function:
        """`feasible_steps` of the rows at rest in z; its last inputs are p and c."""
        return feasible_steps(self._rows_at_rest, self._z, [self._symbols["p"], self._symbols["c"]])

    @property
    def value(self) -> ca.Function:
        """(base, posture, p, held, alpha) -> V = Σ αi wi."""
        return self._expansion.value

    @property
    def slope(self) -> ca.Function:
        """(base, posture, p, held, alpha) -> V = Σ αi wi and ∂V/∂z (n_z,)."""
        return self._expansion.slope

    @property
    def curvature(self) -> ca.Function:
        """(base, posture, p, held, alpha) -> ∂²V/∂z² (n_z, n_z)."""
        return self._expansion.curvature

    @cached_property
    def row_values(self) -> ca.Function:
        """(base, posture, p, c, held) -> rows (n_rows,)."""
        return self._of_rows("row_values", {}, [self._rows], ["rows"])

    @cached_property
    def row_slopes(self) -> ca.Function:
        """(base, posture, p, c, held) -> rows (n_rows,) and ∂rows/∂z (n_rows, n_z)."""
        return self._of_rows("row_slopes", {}, [self._rows, ca.jacobian(self._rows, self._z)], ["rows", "rows_z"])

    @cached_property
    def row_curvature(self) -> ca.Function:
        """(base, posture, p, c, held, multipliers (n_rows,)) -> Σ multiplier_i ∂²row_i/∂z² (n_z, n_z)."""
        multipliers = ca.SX.sym("multipliers", self._rows.shape[0])
        total = ca.hessian(ca.dot(multipliers, self._rows), self._z)[0]
        return self._of_rows("row_curvature", {"multipliers": multipliers}, [total], ["rows_zz"])

    def held_rows(self, held: ca.MX) -> ca.MX:
        """What the rows take as `held`: nothing of it matters without gravity, so that it need not be computed."""
        return held if self.gravity else ca.MX(ca.DM.zeros(*held.shape))

    def _of_rows(self, name: str, more: Mapping[str, ca.SX], outputs: list[ca.SX], names: list[str]) -> ca.Function:
        return self._function(name, ("base", "posture", "p", "c", "held"), more, outputs, names)

    def _function(
        self, name: str, inputs: tuple[str, ...], more: Mapping[str, ca.SX], outputs: list[ca.SX], names: list[str]
    ) -> ca.Function:
        # Without `cse`: on graphs of this size it takes a second and removes few operations.
        symbols = {key: self._symbols[key] for key in inputs} | dict(more)
        dense = [ca.densify(output) for output in outputs]
        return ca.Function(name, list(symbols.values()), dense, list(symbols), names)


@lru_cache(maxsize=32)
def _configuration(machine: AnyMachine, control: Control, gravity: bool, extra: Rows | None) -> Configuration:
    return Configuration(machine, control, gravity, extra)


def build_configuration(
    machine: AnyMachine, control: Control = "inverse", gravity: bool = False, constraints: ConstraintSet | None = None
) -> Configuration:
    """The graphs of a machine's configuration (built once for each structure, and kept).

    Args:
        machine: from `flexopt.load`.
        control, gravity: as in `flexopt.evaluate`.
        constraints: from `build_constraints`; its numbers do not enter.
    """
    extra = None
    if constraints is not None and len(constraints):
        extra = Rows(constraints.structure, constraints.function)
    return _configuration(machine, control, gravity, extra)


@dataclass(frozen=True)
class Parameters:
    """How the solver's parameters lie in one vector.

    `target` (n_task,) and `row_scale` (n_rows,): rows are (row − target) / row_scale. `z_scale` (n_z,): z = z_scale x.
    For each objective `alpha` (m,), `beta` and `size`, which V is divided by. `cost` and `now` (n_z,): V / size is
    less by cost |x − now|². `gain`, c and p.
    """

    sizes: tuple[tuple[str, int], ...]

    def packed(self, parts: Mapping[str, Any]) -> Vector:
        """The vector, from arrays by name."""
        flat = [np.asarray(parts[name], dtype=float).reshape(-1) for name, _ in self.sizes]
        assert [x.size for x in flat] == [size for _, size in self.sizes]
        return np.concatenate(flat)

    def symbols(self) -> tuple[ca.MX, dict[str, ca.MX]]:
        """The vector as a symbol, and its parts."""
        edges = np.cumsum([0, *(size for _, size in self.sizes)]).tolist()
        whole = ca.MX.sym("parameters", edges[-1])
        parts = ca.vertsplit(whole, edges)
        return whole, {name: part for (name, _), part in zip(self.sizes, parts, strict=True)}


@dataclass(frozen=True)
class Form:
    """What an objective is made of: whether any α, and whether β, is not zero."""

    smooth: bool
    kinks: bool

    @property
    def branches(self) -> int:
        """How many branches it has: two where ε_max takes part."""
        return 2 if self.kinks else 1


def parameters_of(configuration: Configuration, count: int) -> Parameters:
    """The parameters of a program with `count` objectives."""
    plant = configuration.measures.plant
    n_z, m = plant.n_base + plant.n_actuated, plant.n_passive
    sizes = {"target": plant.n_task, "row_scale": configuration.n_rows, "z_scale": n_z, "alpha": m * count}
    sizes |= {"beta": count, "size": count, "cost": 1, "now": n_z, "gain": 1}
    return Parameters((*sizes.items(), ("c", configuration.n_constants), ("p", len(plant.parameter_names))))


@lru_cache(maxsize=32)
def build_solver(configuration: Configuration, forms: tuple[Form, ...], *, quick: bool = False) -> ca.Function:
    """Minimise −V in x = z / z_scale (kept between calls); the objectives before the last are constraints.

    Constraints are the rows, then the values of the objectives to keep. IPOPT with exact Hessian where everything is
    smooth. Where ε_max takes part, V is the smaller of two branches, and the largest t below both is sought (epigraph)
    by sequential quadratic programming: its subproblem sees both branches, so that a step near a kink does not depend
    on which of them is the smaller one just now. `quick` is for first solves of problems with much redundancy.
    """
    if any(form.kinks for form in forms):
        return make_solver("selection", "sqpmethod", *_sequential(configuration, forms, quick=quick))
    return make_solver("selection", "ipopt", *_interior_point(configuration, len(forms), quick=quick))


def _interior_point(
    configuration: Configuration, count: int, *, quick: bool
) -> tuple[dict[str, ca.MX], dict[str, Any]]:
    """The program and the options of IPOPT."""
    measures, plant = configuration.measures, configuration.measures.plant
    n_z, n_b, n_rows, m = plant.n_base + plant.n_actuated, plant.n_base, configuration.n_rows, plant.n_passive
    x, (parameters, s) = ca.MX.sym("x", n_z), parameters_of(configuration, count).symbols()
    z, alphas = s["z_scale"] * x, ca.reshape(s["alpha"], m, count)
    at = [z[:n_b], z[n_b:], s["p"]]
    held = measures.called_hold.call(at)[0]
    offset = ca.vertcat(s["target"], ca.DM.zeros(n_rows - plant.n_task, 1))
    row_inputs = [*at, s["c"], configuration.held_rows(held)]
    away = x - s["now"]
    travel = s["cost"] * ca.sumsqr(away)

    def program(objectives: list[ca.MX], rows: ca.MX) -> tuple[ca.MX, ca.MX]:
        values = [value / s["size"][k] - travel for k, value in enumerate(objectives)]
        return -values[-1], ca.vertcat((rows - offset) / s["row_scale"], *values[:-1])

    weighted = [[*at, held, alphas[:, k]] for k in range(count)]
    f, g = program(
        [configuration.value.call(inputs)[0] for inputs in weighted], configuration.row_values.call(row_inputs)[0]
    )
    # With derivatives the values come from the same calls.
    found = [configuration.slope.call(inputs) for inputs in weighted]
    slopes = [s["z_scale"] * v_z / s["size"][k] - 2 * s["cost"] * away for k, (_, v_z) in enumerate(found)]
    rows, row_slopes = configuration.row_slopes.call(row_inputs)
    row_slopes = row_slopes / ca.repmat(s["row_scale"], 1, n_z) * ca.repmat(s["z_scale"].T, n_rows, 1)
    jacobian = ca.vertcat(row_slopes, *(slope.T for slope in slopes[:-1]))
    f_there, g_there = program([value for value, _ in found], rows)

    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", n_rows + count - 1)
    pulls = ca.vertcat(lam_g[n_rows:], -lam_f)
    second = configuration.curvature.call([*at, held, alphas @ (pulls / s["size"])])[0]
    second += configuration.row_curvature.call([*row_inputs, lam_g[:n_rows] / s["row_scale"]])[0]
    scaled = second * (s["z_scale"] @ s["z_scale"].T) - 2 * s["cost"] * ca.sum1(pulls) * ca.MX.eye(n_z)
    given = {
        "grad_f": ca.Function("grad_f", [x, parameters], [f_there, -slopes[-1]], ["x", "p"], ["f", "grad_f_x"]),
        "jac_g": ca.Function("jac_g", [x, parameters], [g_there, jacobian], ["x", "p"], ["g", "jac_g_x"]),
        "hess_lag": ca.Function(
            "hess_lag", [x, parameters, lam_f, lam_g], [ca.triu(ca.densify(scaled))],
            ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"],
        ),
    }  # fmt: skip
    options = IPOPT_OPTIONS | given
    if quick:
        options |= {"ipopt": IPOPT_OPTIONS["ipopt"] | QUICK_OPTIONS}
    return {"x": x, "p": parameters, "f": f, "g": g}, options


def _sequential(
    configuration: Configuration, forms: tuple[Form, ...], *, quick: bool
) -> tuple[dict[str, ca.MX], dict[str, Any]]:
    """The program and the options of the sequential method."""
    measures, plant = configuration.measures, configuration.measures.plant
    n_z, n_b, m, count = plant.n_base + plant.n_actuated, plant.n_base, plant.n_passive, len(forms)
    n_rows, level = configuration.n_rows, int(forms[-1].kinks)
    x = ca.MX.sym("x", n_z + level)
    parameters, s = parameters_of(configuration, count).symbols()
    z, alphas = s["z_scale"] * x[:n_z], ca.reshape(s["alpha"], m, count)
    at = [z[:n_b], z[n_b:], s["p"]]
    away = x[:n_z] - s["now"]
    travel, of_travel = s["cost"] * ca.sumsqr(away), 2 * s["cost"] * away.T
    margin = build_margin(configuration.machine, configuration.control, configuration.gravity)
    held = measures.called_hold.call(at)[0]
    row_inputs = [*at, s["c"], configuration.held_rows(held)]
    offset = ca.vertcat(s["target"], ca.DM.zeros(n_rows - plant.n_task, 1))
    epsilon, epsilon_z = margin.values.call([*at, s["gain"]])[0], margin.gradients.call([*at, s["gain"]])[1]

    values: list[list[ca.MX]] = []
    slopes: list[list[ca.MX]] = []
    for k, form in enumerate(forms):
        smooth, smooth_z = ca.MX(0), ca.MX(1, n_z)
        if form.smooth:
            # Held modes are constants to CasADi: the slope is asked for, never derived from the value.
            smooth, by_z = configuration.slope.call([*at, held, alphas[:, k]])
            smooth_z = by_z.T
        both, both_z = [smooth], [smooth_z]
        if form.kinks:
            both = [smooth + s["beta"][k] * epsilon[j] for j in range(2)]
            both_z = [smooth_z + s["beta"][k] * epsilon_z[j, :] for j in range(2)]
        values.append([value / s["size"][k] - travel for value in both])
        slopes.append([slope * s["z_scale"].T / s["size"][k] - of_travel for slope in both_z])

    def program(rows: ca.MX) -> tuple[ca.MX, ca.MX]:
        constraints = [(rows - offset) / s["row_scale"], *(branch for kept in values[:-1] for branch in kept)]
        if level:
            constraints += [branch - x[n_z] for branch in values[-1]]
        return -x[n_z] if level else -values[-1][0], ca.vertcat(*constraints)

    f, g = program(configuration.row_values.call(row_inputs)[0])
    rows, row_slopes = configuration.row_slopes.call(row_inputs)
    jacobian = [row_slopes * (1 / s["row_scale"] @ s["z_scale"].T), *(slope for kept in slopes[:-1] for slope in kept)]
    gradient = -slopes[-1][0]
    if level:
        jacobian = [ca.horzcat(part, ca.MX.zeros(part.shape[0], 1)) for part in jacobian]
        jacobian += [ca.horzcat(slope, ca.MX(-1)) for slope in slopes[-1]]
        gradient = ca.MX(ca.DM([*[0] * n_z, -1]).T)
    f_there, g_there = program(rows)
    outputs = [f_there, ca.densify(gradient), g_there, ca.densify(ca.vertcat(*jacobian))]
    given = ca.Function("jac_fg", [x, parameters], outputs, ["x", "p"], ["f", "grad_f_x", "g", "jac_g_x"])
    options = SQP_OPTIONS | {"jac_fg": given} | ({"max_iter": SQP_QUICK} if quick else {})
    return {"x": x, "p": parameters, "f": f, "g": g}, options
