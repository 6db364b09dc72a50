"""What one configuration gives to a program: its objectives and rows as graphs, with their derivatives by x.

In: the graphs of a configuration, which entries of x are its z, and the program's parameters. What differs between
programs of one structure (targets, scales, weights, values to be kept, constants of constraints, p) are parameters, so
that solvers serve many problems.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import casadi as ca
import numpy as np

from flexopt.algebra.layout import Layout
from flexopt.compiled import accelerate
from flexopt.foundation.kept import by_structure
from flexopt.model.own import OwnFunction
from flexopt.robustness.margin import build_margin
from flexopt.selection.nlp.configuration import ConfigurationGraphs
from flexopt.selection.nlp.coupling import Coupling
from flexopt.selection.own import OwnGraphs, OwnTerm

# Of objectives in order, of each its branches: values, or slopes by x (1, n_x).
BranchGraphs = list[list[ca.MX]]


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


def parameters_of(configuration: ConfigurationGraphs, coupling: Coupling, objectives: int) -> Layout:
    """How the parameters of a program with so many objectives lie in one vector.

    `target` (K n_task,) and `row_scale` (n_rows,): rows are (row − target) / row_scale. `z_scale` (n_z,): z = z_scale
    x. For each objective `alpha` (m,), `beta`, `size`, which V is divided by, and `cost`: with `now` (n_z,) V / size is
    less by cost |x − now|². `left` (m,): 1 for modes whose w_i is left out of second derivatives. `share` (K,) of the
    configurations; the `level` of "motion"; `gain`, c and p.
    """
    plant, count = configuration.measures.plant, coupling.count
    n_z, m = plant.n_base + plant.n_actuated, plant.n_passive
    sizes = {"target": plant.n_task * count, "row_scale": configuration.n_rows, "z_scale": n_z}
    sizes |= {"alpha": m * objectives, "beta": objectives, "size": objectives, "cost": objectives, "now": n_z}
    sizes |= {"left": m, "share": count, "level": 1, "gain": 1}
    return Layout(sizes | {"c": configuration.n_constants, "p": len(plant.parameter_names)})


class MemberGraph:
    """Configuration k of a program: its objectives and rows, and their derivatives by x."""

    def __init__(
        self,
        configuration: ConfigurationGraphs,
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

    def values(self) -> tuple[BranchGraphs, ca.MX]:
        """V / size less travel of every objective, and the rows."""
        smooth = [found[0] for found in self._of_modes("value")]
        epsilon = self.margin[0].call([*self.at, self.s["gain"]])[0] if self._kinks else None
        return self._objectives(smooth, epsilon), self._rows(self.configuration.row_values.call(self.row_inputs)[0])

    def slopes(self) -> tuple[tuple[BranchGraphs, ca.MX], tuple[BranchGraphs, ca.MX]]:
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
        return OwnGraphs(c.measures, term.own)

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

    def _objectives(self, smooth: list[ca.MX], epsilon: ca.MX | None) -> BranchGraphs:
        s, away = self.s, ca.sumsqr(self.away)
        both: BranchGraphs = [[value] for value in smooth]
        if epsilon is not None:
            both = [
                [value + s["beta"][j] * epsilon[b] for b in range(2)] if form.kinks else [value]
                for j, (form, value) in enumerate(zip(self.forms, smooth, strict=True))
            ]
        return [[value / s["size"][j] - s["cost"][j] * away for value in branches] for j, branches in enumerate(both)]

    def _branch_slopes(self, smooth: list[ca.MX]) -> BranchGraphs:
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


@by_structure
def _margin(configuration: ConfigurationGraphs, *, compiled: bool) -> tuple[ca.Function, ca.Function]:
    """`Margin.values` and `gradients`, or the compiled gradients for both, where there is a compiler."""
    c = configuration
    margin = build_margin(c.machine, c.control, c.gravity)
    if compiled:
        fast = accelerate(margin.compacted.gradients, order=0)
        if fast.is_a("External"):
            return fast, fast
    return margin.values, margin.gradients
