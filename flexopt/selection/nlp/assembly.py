"""What solvers are told: the nonlinear program of configurations that belong together, one or many, with derivatives.

In: the graphs of one configuration, how the K share variables, what is sought. Out: IPOPT on the whole program, with
exact derivatives; and Functions of one configuration for an ascent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import Any, Literal

import casadi as ca
import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.foundation.kept import by_structure
from flexopt.selection.nlp.configuration import ConfigurationGraphs
from flexopt.selection.nlp.coupling import Coupling, alone
from flexopt.selection.nlp.member_graph import BranchGraphs, MemberGraph, ObjectiveForm, parameters_of
from flexopt.selection.nlp.solvers import Local, make_solver

IPOPT_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "error_on_fail": False,
    # Where a point's numbers are none IPOPT shortens its step: nothing for whoever reads the terminal.
    "show_eval_warnings": False,
    "calc_lam_p": False,
    "no_nlp_grad": True,
    "ipopt": {
        "print_level": 0,
        "sb": "yes",
        "tol": 1e-10,
        "constr_viol_tol": 1e-12,
        "acceptable_iter": 0,
        "max_iter": 200,
        "mu_init": 1e-4,
        "bound_relax_factor": 0.0,
    },
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
# Several configurations: most starts take 10 to 30 iterations; those that wander are not worth waiting for.
COUPLED_OPTIONS: dict[str, Any] = {"max_iter": 120, "tol": 1e-9, "constr_viol_tol": 1e-10}
# "weighted": max Σ share_k V_k;  "worst": max min_k V_k;  "motion": the shortest way that keeps every V_k at a level.
Goal = Literal["weighted", "worst", "motion"]


@by_structure
def build_solver(
    configuration: ConfigurationGraphs,
    coupling: Coupling,
    forms: tuple[ObjectiveForm, ...],
    goal: Goal,
    *,
    quick: bool = False,
) -> ca.Function:
    """A solver in x = z / z_scale, and t last for "worst" (kept between calls).

    Constraints: the rows of every configuration, (row − target) / row_scale; x_j − x_i for the pairs; of each objective
    before the last V / size of every configuration; and of the last one V_k / size − t ("worst") or − level ("motion").
    IPOPT with exact Hessian; ε_max, which has kinks, is for an ascent alone. `quick` is for first solves of problems
    with much redundancy.
    """
    assert not any(form.kinks for form in forms), "IPOPT is told no kinks"
    x, parameters, members, arranged = _assembled(configuration, coupling, forms, goal)
    f, g = arranged.values([member.values() for member in members])
    (f_there, g_there), (gradient, jacobian) = arranged.slopes([member.slopes() for member in members])
    program, at = {"x": x, "p": parameters, "f": f, "g": g}, ["x", "p"]
    name = "selection" if coupling.count == 1 else "several"
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.shape[0])
    second = ca.triu(arranged.curvature(members, len(forms), lam_f, lam_g))
    bent = [x, parameters, lam_f, lam_g], [second], [*at, "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
    gradient = ca.densify(gradient.T)
    given = {
        "grad_f": ca.Function("grad_f", [x, parameters], [f_there, gradient], at, ["f", "grad_f_x"]),
        "jac_g": ca.Function("jac_g", [x, parameters], [g_there, jacobian], at, ["g", "jac_g_x"]),
        "hess_lag": ca.Function("hess_lag", *bent),
    }
    own = (COUPLED_OPTIONS if coupling.count > 1 else {}) | (QUICK_OPTIONS if quick else {})
    return make_solver(name, program, IPOPT_OPTIONS | given | {"ipopt": IPOPT_OPTIONS["ipopt"] | own})


@dataclass(frozen=True)
class Branched:
    """One configuration's program for an ascent, as Functions of x and the parameters of `build_solver`.

    Attributes:
        model: -> the last objective's branches (1 or 2,), the constraints before them, as `build_solver` has them, and
            the slopes of both by x, and of ε_max's branches and their coupling as in `Margin.gradients`, (3 or 0, n_x).
        rows: -> the rows and their slopes alone.
        curvature: of x, the parameters, `pulls` (of each objective) and `row_pulls` -> Σ pulls_j ∂²V_j + Σ row_pulls_i
            ∂²row_i, without ε_max.
        factors: -> f = [a_i; b_i] (2r, m), slopes of its columns (2r m, n_x), and which modes have the same
            frequency, (m, m).
        margin: (base, posture, p, kr) -> as `Margin.gradients`; none where ε_max takes no part.
        pulls: -> ∂V_j/∂w_i / size_j of each objective, (j, m), where there is an own one; else they are α / size.
    """

    model: ca.Function
    rows: ca.Function
    curvature: ca.Function
    factors: ca.Function
    margin: ca.Function | None
    pulls: ca.Function | None = None


@by_structure
def build_branched(configuration: ConfigurationGraphs, forms: tuple[ObjectiveForm, ...], *, compiled: bool) -> Branched:
    """The Functions of one configuration; `compiled`: ε_max by compiled code, where there is a compiler."""
    plant = configuration.measures.plant
    coupling = alone(plant.n_base + plant.n_actuated)
    x, parameters, (member,), _ = _assembled(configuration, coupling, forms, "weighted", compiled=compiled)
    (values, rows), (slopes, row_slopes) = member.slopes()
    outputs = {
        "last": ca.vertcat(*values[-1]),
        "g": ca.vertcat(rows, *chain(*values[:-1])),
        "last_x": ca.vertcat(*slopes[-1]),
        "g_x": ca.vertcat(row_slopes, *chain(*slopes[:-1])),
        "epsilon_x": member.epsilon_x(),
    }
    of_modes: dict[str, ca.MX] = dict(zip(("f", "f_x", "same"), member.factors(), strict=True))
    of_rows = {name: outputs[name][: configuration.n_rows, :] for name in ("g", "g_x")}
    pulls, row_pulls = ca.MX.sym("pulls", len(forms)), ca.MX.sym("row_pulls", configuration.n_rows)
    bent = member.curvature(pulls, row_pulls)
    at, names = [x, parameters], ["x", "p"]

    def function(name: str, found: Mapping[str, ca.MX]) -> ca.Function:
        return ca.Function(name, at, [ca.densify(each) for each in found.values()], names, list(found))

    second = ca.Function("curvature", [*at, pulls, row_pulls], [bent], [*names, "pulls", "row_pulls"], ["V_xx"])
    margin = member.margin[1] if any(form.kinks for form in forms) else None
    pulls_of_w = function("pulls", {"V_w": member.pulls()}) if any(form.own for form in forms) else None
    return Branched(
        function("model", outputs),
        function("rows", of_rows),
        second,
        function("factors", of_modes),
        margin,
        pulls_of_w,
    )


def told_branches(functions: Branched, parameters: Vector, x: Vector) -> Local:
    """What an ascent is told at x: the first branch, the constraints and the second branch, with slopes."""
    last, g, last_x, g_x, _ = (out.full() for out in functions.model.call([x, parameters]))
    return Local(float(last[0, 0]), last_x[0], np.vstack([g, last[1:]]).ravel(), np.vstack([g_x, last_x[1:]]))


def _assembled(
    configuration: ConfigurationGraphs,
    coupling: Coupling,
    forms: tuple[ObjectiveForm, ...],
    goal: Goal,
    *,
    compiled: bool = False,
) -> tuple[ca.MX, ca.MX, list[MemberGraph], _Arranged]:
    """The variables x, the parameters, and what a program is made of."""
    x = ca.MX.sym("x", coupling.n_x + (goal == "worst"))
    layout = parameters_of(configuration, coupling, len(forms))
    parameters = ca.MX.sym("parameters", layout.total)
    s = layout.split(parameters)
    members = [MemberGraph(configuration, coupling, forms, s, x, k, compiled=compiled) for k in range(coupling.count)]
    return x, parameters, members, _Arranged(coupling, s, x, goal)


@dataclass(frozen=True)
class _Arranged:
    """Objective and constraints of a program, in order, from those of its members."""

    coupling: Coupling
    s: Mapping[str, ca.MX]
    x: ca.MX
    goal: Goal

    def values(self, members: Sequence[tuple[BranchGraphs, ca.MX]]) -> tuple[ca.MX, ca.MX]:
        """Objective f and constraints g."""
        steps = self._steps @ self.x
        level = self.x[-1] if self.goal == "worst" else self.s["level"]
        g = self._stacked(members, steps, level)
        if self.goal == "weighted":
            return -self._weighted(members), g
        return (-self.x[-1] if self.goal == "worst" else ca.sumsqr(steps) / 2), g

    def slopes(
        self, members: Sequence[tuple[tuple[BranchGraphs, ca.MX], tuple[BranchGraphs, ca.MX]]]
    ) -> tuple[tuple[ca.MX, ca.MX], tuple[ca.MX, ca.MX]]:
        """F and g, and their slopes (1, n_x) and (n_g, n_x)."""
        by_x, n_x = [slopes for _, slopes in members], self.x.shape[0]
        last = ca.DM(ca.Sparsity.triplet(1, n_x, [0], [n_x - 1]), 1.0)
        jacobian = self._stacked(by_x, ca.MX(self._steps), ca.MX(last) if self.goal == "worst" else ca.MX(1, n_x))
        if self.goal == "weighted":
            gradient = -self._weighted(by_x)
        else:
            gradient = ca.MX(-last) if self.goal == "worst" else (self._steps.T @ (self._steps @ self.x)).T
        return self.values([values for values, _ in members]), (gradient, jacobian)

    def curvature(self, members: Sequence[MemberGraph], objectives: int, lam_f: ca.MX, lam_g: ca.MX) -> ca.MX:
        """The Lagrangian's second derivatives (n_x, n_x), of objectives of one branch."""
        count, n_rows = len(members), members[0].offset.shape[0]
        before = n_rows * count + len(self.coupling.pairs)
        second = ca.MX(self.x.shape[0], self.x.shape[0])
        for k, member in enumerate(members):
            pulls = [lam_g[before + j * count + k] for j in range(objectives - 1)]
            weighted = self.goal == "weighted"
            pulls += [-lam_f * self.s["share"][k] if weighted else lam_g[before + (objectives - 1) * count + k]]
            second += member.curvature(ca.vertcat(*pulls), lam_g[k * n_rows : (k + 1) * n_rows])
        if self.goal == "motion":
            second += lam_f * (self._steps.T @ self._steps)
        return second

    @cached_property
    def _steps(self) -> ca.DM:
        return ca.sparsify(ca.DM(self.coupling.steps(self.x.shape[0])))

    def _stacked(self, members: Sequence[tuple[BranchGraphs, ca.MX]], steps: ca.MX, level: ca.MX) -> ca.MX:
        """Rows of every member, steps, the objectives to be kept, and the last one above the level."""
        parts = [rows for _, rows in members] + ([steps] if self.coupling.pairs else [])
        for kept in zip(*(values[:-1] for values, _ in members), strict=True):
            parts += chain(*kept)
        if self.goal != "weighted":
            parts += [value - level for values, _ in members for value in values[-1]]
        return ca.vertcat(*parts)

    def _weighted(self, members: Sequence[tuple[BranchGraphs, ca.MX]]) -> ca.MX:
        total = ca.MX(0)
        for k, (values, _) in enumerate(members):
            total = total + self.s["share"][k] * values[-1][0]
        return total
