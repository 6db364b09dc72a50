"""One configuration as graphs, with exact derivatives: what every selection's program is made of.

In: a machine, a controller, the structure of its constraints. Out: `ConfigurationGraphs`: Functions of objective and
rows at z = [base, posture]. What differs between problems of one structure (constants of constraints, p) are arguments.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca

from flexopt.algebra.feasible import feasible_steps
from flexopt.foundation.control import Control
from flexopt.foundation.kept import Structural, structural_property
from flexopt.model import AnyMachine
from flexopt.robustness.expansion import Expansion
from flexopt.robustness.measures import Measures, build_measures
from flexopt.selection.constraints import ConstraintSet
from flexopt.selection.constraints.kind import Scene


@dataclass(frozen=True)
class ConstraintRows:
    """The constraint rows besides the target: what decides their graph, and the graph."""

    structure: Any
    function: ca.Function = field(compare=False, hash=False, repr=False)


@dataclass(frozen=True)
class ConfigurationGraphs(Structural):
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
    extra: ConstraintRows | None

    @cached_property
    def measures(self) -> Measures:
        """The measures behind the objective, asked for once: built anew, they would be of other symbols."""
        return build_measures(self.machine, self.control, self.gravity)

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return self.row_values.size1_out(0)

    @property
    def n_constants(self) -> int:
        """Number of constants c."""
        return self.row_values.size1_in(3)

    @structural_property
    def _symbols(self) -> dict[str, ca.SX]:
        g = self.measures.plant.graph
        count = 0 if self.extra is None else self.extra.function.size1_in(3)
        inputs = {"base": g.base, "posture": g.posture, "p": g.p}
        return inputs | {"c": ca.SX.sym("c", count), "held": self.expansion.held}

    @structural_property
    def _z(self) -> ca.SX:
        return ca.vertcat(self._symbols["base"], self._symbols["posture"])

    @cached_property
    def expansion(self) -> Expansion:
        """V = Σ αi wi with its derivatives by z, from (base, posture, p, held, alpha)."""
        return self.measures.expansion

    @structural_property
    def _rows(self) -> ca.SX:
        return self._rows_of(self.measures.expansion.point.end_point) if self.gravity else self._rows_alone

    @structural_property
    def _rows_alone(self) -> ca.SX:
        plant = self.measures.plant
        g = plant.graph
        scene = Scene(plant, g.base, g.posture, g.p, self.gravity)
        return self._rows_of(ca.substitute(g.end_point, g.q, scene.q))

    def _rows_of(self, task: ca.SX) -> ca.SX:
        s, plant = self._symbols, self.measures.plant
        at = [s["base"], s["posture"], s["p"]]
        parts = [task, plant.singularity_sine_squared.call(at)[0]]
        if self.extra is not None:
            parts += self.extra.function.call([*at, s["c"]])
        return ca.densify(ca.vertcat(*parts))

    @structural_property
    def rows_alone(self) -> ca.Function:
        """(base, posture, p, c) -> rows (n_rows,), the deflection found with them."""
        return self._function("rows_alone", ("base", "posture", "p", "c"), {}, [self._rows_alone], ["rows"])

    @structural_property
    def feasible(self) -> ca.Function:
        """`feasible_steps` of `rows_alone` in z; its last inputs are p and c."""
        return feasible_steps(self._rows_alone, self._z, [self._symbols["p"], self._symbols["c"]])

    @structural_property
    def row_values(self) -> ca.Function:
        """(base, posture, p, c, held) -> rows (n_rows,)."""
        return self._of_rows("row_values", {}, [self._rows], ["rows"])

    @structural_property
    def row_slopes(self) -> ca.Function:
        """(base, posture, p, c, held) -> rows (n_rows,) and ∂rows/∂z (n_rows, n_z)."""
        return self._of_rows("row_slopes", {}, [self._rows, ca.jacobian(self._rows, self._z)], ["rows", "rows_z"])

    @structural_property
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


def build_configuration(
    machine: AnyMachine, control: Control = "inverse", gravity: bool = False, constraints: ConstraintSet | None = None
) -> ConfigurationGraphs:
    """The graphs of a machine's configuration (built once for each structure, and kept).

    Args:
        machine: from `flexopt.load`.
        control, gravity: as in `flexopt.evaluate`.
        constraints: from `build_constraints`; its numbers do not enter.
    """
    extra = None
    if constraints is not None and len(constraints):
        extra = ConstraintRows(constraints.structure, constraints.function)
    return ConfigurationGraphs(machine, control, gravity, extra)
