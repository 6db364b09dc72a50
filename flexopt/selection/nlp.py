"""The nonlinear program of a selection: K configurations that belong together, one or many, as IPOPT is given it.

In: the graphs of one configuration, how the K share variables, what is sought. Out: solvers with exact derivatives.
What differs between programs of one structure (targets, scales, weights, values to be kept, constants of constraints,
p) are parameters, so that solvers serve many problems.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import chain
from typing import Any, Literal

import casadi as ca
import numpy as np

from flexopt.compiled import accelerate
from flexopt.foundation.arrays import Vector
from flexopt.model.own import OwnFunction
from flexopt.robustness.margin import build_margin
from flexopt.selection.configuration import Configuration
from flexopt.selection.own import OwnGraphs, OwnTerm, own_graphs
from flexopt.selection.programs import Local, make_solver

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
# Several configurations: most starts take 10 to 30 iterations; those that wander are not worth waiting for.
COUPLED_OPTIONS: dict[str, Any] = {"max_iter": 120, "tol": 1e-9, "constr_viol_tol": 1e-10}
# Directions that move a configuration by less than this do not.
APART = 1e-9
# "weighted": max Σ share_k V_k;  "worst": max min_k V_k;  "motion": the shortest way that keeps every V_k at a level.
Goal = Literal["weighted", "worst", "motion"]
# Of objectives in order, of each its branches: values, or slopes by x (1, n_x).
Branches = list[list[ca.MX]]


@dataclass(frozen=True)
class Coupling:
    """How K configurations share the variables x: where each finds its z, and which entries are near each other.

    Attributes:
        places: for each configuration the indices in x of its z, (K, n_z).
        pairs: indices (i, j) of entries of which x_j − x_i is bounded.
    """

    places: tuple[tuple[int, ...], ...]
    pairs: tuple[tuple[int, int], ...] = ()

    @property
    def count(self) -> int:
        """Number of configurations, K."""
        return len(self.places)

    @cached_property
    def n_x(self) -> int:
        """Number of variables, the level t of "worst" left out."""
        return 1 + max(max(place) for place in self.places)

    def steps(self, n_x: int) -> Vector:
        """The matrix of the differences x_j − x_i, (pairs, n_x)."""
        matrix = np.zeros((len(self.pairs), n_x))
        for row, (i, j) in enumerate(self.pairs):
            matrix[row, i], matrix[row, j] = -1.0, 1.0
        return matrix


def own_directions(free: Vector, place: Sequence[int]) -> tuple[Vector, Vector]:
    """What directions (d, n_x) move of the entries at a place, as along @ basis: (d, e), and orthonormal, (e, n_z)."""
    own = free[:, list(place)]
    _, reach, basis = np.linalg.svd(own, full_matrices=False)
    basis = basis[reach > APART]
    return own @ basis.T, basis


def alone(n_z: int) -> Coupling:
    """The coupling of one configuration with nothing: x is its z."""
    return Coupling((tuple(range(n_z)),))


@dataclass(frozen=True)
class SolverParameters:
    """How the solver's parameters lie in one vector.

    `target` (K n_task,) and `row_scale` (n_rows,): rows are (row − target) / row_scale. `z_scale` (n_z,): z = z_scale
    x. For each objective `alpha` (m,), `beta`, `size`, which V is divided by, and `cost`: with `now` (n_z,) V / size is
    less by cost |x − now|². `left` (m,): 1 for modes whose w_i is left out of second derivatives. `share` (K,) of the
    configurations; the `level` of "motion"; `gain`, c and p.
    """

    sizes: tuple[tuple[str, int], ...]

    def packed(self, parts: Mapping[str, Any]) -> Vector:
        """The vector, from arrays by name."""
        flat = [np.asarray(parts[name], dtype=float).reshape(-1) for name, _ in self.sizes]
        assert [x.size for x in flat] == [size for _, size in self.sizes]
        return np.concatenate(flat)

    def place(self, name: str) -> slice:
        """Where a part stands in the vector."""
        names, edges = [each for each, _ in self.sizes], np.cumsum([0, *(size for _, size in self.sizes)]).tolist()
        return slice(edges[names.index(name)], edges[names.index(name) + 1])

    def symbols(self) -> tuple[ca.MX, dict[str, ca.MX]]:
        """The vector as a symbol, and its parts."""
        edges = np.cumsum([0, *(size for _, size in self.sizes)]).tolist()
        whole = ca.MX.sym("parameters", edges[-1])
        parts = ca.vertsplit(whole, edges)
        return whole, {name: part for (name, _), part in zip(self.sizes, parts, strict=True)}


@dataclass(frozen=True)
class ObjectiveForm:
    """What an objective is made of: whether any α, and whether β, is not zero; and the term of the user's own."""

    smooth: bool
    kinks: bool
    own: OwnTerm | None = None

    @property
    def branches(self) -> int:
        """How many branches it has: two where ε_max takes part."""
        return 2 if self.kinks else 1


def parameters_of(configuration: Configuration, coupling: Coupling, objectives: int) -> SolverParameters:
    """The parameters of a program with so many objectives."""
    plant, count = configuration.measures.plant, coupling.count
    n_z, m = plant.n_base + plant.n_actuated, plant.n_passive
    sizes = {"target": plant.n_task * count, "row_scale": configuration.n_rows, "z_scale": n_z}
    sizes |= {"alpha": m * objectives, "beta": objectives, "size": objectives, "cost": objectives, "now": n_z}
    sizes |= {"left": m, "share": count, "level": 1, "gain": 1}
    return SolverParameters((*sizes.items(), ("c", configuration.n_constants), ("p", len(plant.parameter_names))))


@lru_cache(maxsize=48)
def build_solver(
    configuration: Configuration,
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


@lru_cache(maxsize=48)
def build_branched(configuration: Configuration, forms: tuple[ObjectiveForm, ...], *, compiled: bool) -> Branched:
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
    configuration: Configuration,
    coupling: Coupling,
    forms: tuple[ObjectiveForm, ...],
    goal: Goal,
    *,
    compiled: bool = False,
) -> tuple[ca.MX, ca.MX, list[_Member], _Arranged]:
    """The variables x, the parameters, and what a program is made of."""
    x = ca.MX.sym("x", coupling.n_x + (goal == "worst"))
    parameters, s = parameters_of(configuration, coupling, len(forms)).symbols()
    members = [_Member(configuration, coupling, forms, s, x, k, compiled=compiled) for k in range(coupling.count)]
    return x, parameters, members, _Arranged(coupling, s, x, goal)


class _Member:
    """Configuration k of a program: its objectives and rows, and their derivatives by x."""

    def __init__(
        self,
        configuration: Configuration,
        coupling: Coupling,
        forms: tuple[ObjectiveForm, ...],
        s: Mapping[str, ca.MX],
        x: ca.MX,
        k: int,
        *,
        compiled: bool,
    ) -> None:
        measures, plant = configuration.measures, configuration.measures.plant
        place, n_task = coupling.places[k], plant.n_task
        self.configuration, self.forms, self.s = configuration, forms, s
        self.compiled = compiled
        # The sparse matrix that takes the entries of this configuration out of x; none where that is all of x.
        self.pick = (
            None
            if place == tuple(range(x.shape[0]))
            else ca.DM(
                ca.Sparsity.triplet(len(place), x.shape[0], list(range(len(place))), list(place)), np.ones(len(place))
            )
        )
        own = x if self.pick is None else self.pick @ x
        z, self.away = s["z_scale"] * own, own - s["now"]
        self.at = [z[: plant.n_base], z[plant.n_base :], s["p"]]
        self.held = measures.hold.call(self.at)[0]
        self.row_inputs = [*self.at, s["c"], configuration.held_rows(self.held)]
        self.alphas = ca.reshape(s["alpha"], plant.n_passive, len(forms))
        self.held_by_own: dict[OwnFunction, list[ca.MX]] = {}
        target = s["target"][k * n_task : (k + 1) * n_task]
        self.offset = ca.vertcat(target, ca.DM.zeros(configuration.n_rows - n_task, 1))

    def values(self) -> tuple[Branches, ca.MX]:
        """V / size less travel of every objective, and the rows."""
        smooth = [found[0] for found in self._of_modes("value")]
        epsilon = self.margin[0].call([*self.at, self.s["gain"]])[0] if self._kinks else None
        return self._objectives(smooth, epsilon), self._rows(self.configuration.row_values.call(self.row_inputs)[0])

    def slopes(self) -> tuple[tuple[Branches, ca.MX], tuple[Branches, ca.MX]]:
        """As `values`, from the calls that give the slopes, too; and the slopes by x."""
        s, found = self.s, self._of_modes("slope")
        rows, row_slopes = self.configuration.row_slopes.call(self.row_inputs)
        by_x = [
            [self._by_x((s["z_scale"] * v_z / s["size"][j] - 2 * s["cost"][j] * self.away).T) for v_z in branches]
            for j, branches in enumerate(self._branch_slopes([v_z for _, v_z in found]))
        ]
        scaled = row_slopes / ca.repmat(s["row_scale"], 1, row_slopes.shape[1])
        scaled = scaled * ca.repmat(s["z_scale"].T, row_slopes.shape[0], 1)
        return (self._objectives([v for v, _ in found], self._told[0]), self._rows(rows)), (by_x, self._by_x(scaled))

    def curvature(self, of_values: ca.MX, of_rows: ca.MX) -> ca.MX:
        """Σ of_values_j ∂²(V_j / size_j less travel) + Σ of_rows_i ∂²row_i by x, (n_x, n_x)."""
        s, configuration = self.s, self.configuration
        pulls = (1 - s["left"]) * (self.alphas @ (of_values / s["size"]))
        second = configuration.expansion.curvature.call([*self.at, self.held, pulls])[0]
        for j, form in enumerate(self.forms):
            if form.own is not None:
                bent = self._graphs(form.own).curvature.call([*self._own_inputs(form.own), s["left"]])[0]
                second += of_values[j] / s["size"][j] * bent
        second += configuration.row_curvature.call([*self.row_inputs, of_rows / s["row_scale"]])[0]
        n_z = second.shape[0]
        scaled = second * (s["z_scale"] @ s["z_scale"].T) - 2 * ca.dot(s["cost"], of_values) * ca.MX.eye(n_z)
        scaled = ca.densify(scaled)
        return scaled if self.pick is None else self.pick.T @ scaled @ self.pick

    def _of_modes(self, kind: Literal["value", "slope"]) -> list[list[ca.MX]]:
        """V without ε_max for every objective and, of kind "slope", ∂V/∂z; zeros where an objective has neither."""
        function = getattr(self.configuration.expansion, kind)
        found = list[list[ca.MX]]()
        for j, form in enumerate(self.forms):
            parts = [ca.MX.zeros(function.size1_out(k), 1) for k in range(function.n_out())]
            if form.smooth:
                parts = function.call([*self.at, self.held, self.alphas[:, j]])
            if form.own is not None:
                graphs = self._graphs(form.own)
                more = getattr(graphs, kind).call([*self._own_inputs(form.own), graphs.left()])
                parts = [part + each for part, each in zip(parts, more, strict=False)]
            found.append(parts)
        return found

    def pulls(self) -> ca.MX:
        """∂V/∂w / size of every objective, (j, m)."""
        rows = [self.alphas[:, j].T for j in range(len(self.forms))]
        for j, form in enumerate(self.forms):
            if form.own is not None:
                graphs = self._graphs(form.own)
                rows[j] += graphs.slope.call([*self._own_inputs(form.own), graphs.left()])[2].T
        return ca.vertcat(*(row / self.s["size"][j] for j, row in enumerate(rows)))

    def _graphs(self, term: OwnTerm) -> OwnGraphs:
        c = self.configuration
        return own_graphs(c.machine, c.control, c.gravity, term.own)

    def _own_inputs(self, term: OwnTerm) -> list[ca.MX]:
        """What an own Function takes but `left`; what is held is asked for once."""
        if term.own not in self.held_by_own:
            _, static = self._graphs(term).held_at(self.at)
            self.held_by_own[term.own] = [self.held, static]
        return [*self.at, *self.held_by_own[term.own], ca.MX(ca.DM(term.weights()))]

    def _by_x(self, slopes: ca.MX) -> ca.MX:
        return slopes if self.pick is None else slopes @ self.pick

    def _rows(self, rows: ca.MX) -> ca.MX:
        return (rows - self.offset) / self.s["row_scale"]

    def _objectives(self, smooth: list[ca.MX], epsilon: ca.MX | None) -> Branches:
        s, away = self.s, ca.sumsqr(self.away)
        both: Branches = [[value] for value in smooth]
        if epsilon is not None:
            both = [
                [value + s["beta"][j] * epsilon[b] for b in range(2)] if form.kinks else [value]
                for j, (form, value) in enumerate(zip(self.forms, smooth, strict=True))
            ]
        return [[value / s["size"][j] - s["cost"][j] * away for value in branches] for j, branches in enumerate(both)]

    def _branch_slopes(self, smooth: list[ca.MX]) -> Branches:
        """∂V/∂z (n_z,) of every objective and branch."""
        s, epsilon_z = self.s, self._told[1]
        if epsilon_z is None:
            return [[v_z] for v_z in smooth]
        return [
            [v_z + s["beta"][j] * epsilon_z[b, :].T for b in range(2)] if form.kinks else [v_z]
            for j, (form, v_z) in enumerate(zip(self.forms, smooth, strict=True))
        ]

    def epsilon_x(self) -> ca.MX:
        """Slopes by x of ε_max's branches and of their coupling, (3, n_x), as in `Margin.gradients`."""
        slopes, scale = self._told[1], self.s["z_scale"].T
        return ca.MX(0, scale.shape[1]) if slopes is None else self._by_x(slopes * ca.repmat(scale, 3, 1))

    def factors(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        """As `Branched.factors`."""
        expansion, scale = self.configuration.expansion, self.s["z_scale"].T
        held = expansion.parts(self.held)
        slopes = expansion.factor_slopes(self.at, held)
        return held["f"], self._by_x(slopes * ca.repmat(scale, slopes.shape[0], 1)), held["same"]

    @cached_property
    def margin(self) -> tuple[ca.Function, ca.Function]:
        """`Margin.values` and `gradients` for a solver."""
        return _margin(self.configuration, compiled=self.compiled)

    @property
    def _kinks(self) -> bool:
        return any(form.kinks for form in self.forms)

    @cached_property
    def _told(self) -> tuple[ca.MX, ca.MX] | tuple[None, None]:
        """ε_max's branches and slopes, of one call; nothing where it takes no part."""
        if not self._kinks:
            return None, None
        epsilon, slopes = self.margin[1].call([*self.at, self.s["gain"]])[:2]
        return epsilon, slopes


@lru_cache(maxsize=48)
def _margin(configuration: Configuration, *, compiled: bool) -> tuple[ca.Function, ca.Function]:
    """`Margin.values` and `gradients`, or the compiled gradients for both, where there is a compiler."""
    c = configuration
    margin = build_margin(c.machine, c.control, c.gravity)
    if compiled:
        fast = accelerate(margin.compacted.gradients, order=0)
        if fast.is_a("External"):
            return fast, fast
    return margin.values, margin.gradients


@dataclass(frozen=True)
class _Arranged:
    """Objective and constraints of a program, in order, from those of its members."""

    coupling: Coupling
    s: Mapping[str, ca.MX]
    x: ca.MX
    goal: Goal

    def values(self, members: Sequence[tuple[Branches, ca.MX]]) -> tuple[ca.MX, ca.MX]:
        """Objective f and constraints g."""
        steps = self._steps @ self.x
        level = self.x[-1] if self.goal == "worst" else self.s["level"]
        g = self._stacked(members, steps, level)
        if self.goal == "weighted":
            return -self._weighted(members), g
        return (-self.x[-1] if self.goal == "worst" else ca.sumsqr(steps) / 2), g

    def slopes(
        self, members: Sequence[tuple[tuple[Branches, ca.MX], tuple[Branches, ca.MX]]]
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

    def curvature(self, members: Sequence[_Member], objectives: int, lam_f: ca.MX, lam_g: ca.MX) -> ca.MX:
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

    def _stacked(self, members: Sequence[tuple[Branches, ca.MX]], steps: ca.MX, level: ca.MX) -> ca.MX:
        """Rows of every member, steps, the objectives to be kept, and the last one above the level."""
        parts = [rows for _, rows in members] + ([steps] if self.coupling.pairs else [])
        for kept in zip(*(values[:-1] for values, _ in members), strict=True):
            parts += chain(*kept)
        if self.goal != "weighted":
            parts += [value - level for values, _ in members for value in values[-1]]
        return ca.vertcat(*parts)

    def _weighted(self, members: Sequence[tuple[Branches, ca.MX]]) -> ca.MX:
        total = ca.MX(0)
        for k, (values, _) in enumerate(members):
            total = total + self.s["share"][k] * values[-1][0]
        return total
