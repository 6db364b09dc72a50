"""The measures w_i and the gradient of V = Σ α_i w_i for C: the graphs of `flexopt.robustness.expansion` behind calls.

In: a `Context`. Out: MX graphs made of calls of SX Functions. Written out as one expression, six modes and their
gradients are some 60,000 operations; here modes, which are alike, share their code.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from flexopt.export.context import Context
from flexopt.plant.control import task_to_joints
from flexopt.robustness.expansion import Expansion
from flexopt.robustness.modes import called_modes


@dataclass(frozen=True)
class ModalGraph:
    """MX graphs at one posture. m modes, r task rows, n_z variables z = [placement; joints].

    Attributes:
        omega_squared, w, size: of every mode, (m, 1); size is |a_i||b_i|.
        sine_squared: distance from singular postures.
        terms: size of what |a_i||b_i| is summed from, (m, 1);  parts: also of what the joints' motion is summed from.
        significance: smallest |a_i||b_i| relative to that.
        gap: distance of ω_i² from its nearest neighbour relative to their mean, at most 1, (m, 1): rounding errors of
            the modes are divided by it.
        least_gap: the smallest of them.
        gradient: Σ α_i ∂w_i/∂z, (n_z, 1).
        gradient_sizes: |∂w_i/∂z| of every mode, (m, 1).
    """

    omega_squared: ca.MX
    w: ca.MX
    size: ca.MX
    sine_squared: ca.MX
    terms: ca.MX
    parts: ca.MX
    significance: ca.MX
    gap: ca.MX
    least_gap: ca.MX
    gradient: ca.MX
    gradient_sizes: ca.MX


@dataclass(frozen=True)
class ModalKernels:
    """The Functions that are called. Inputs: placement where it matters, joints, parameters unless they are baked."""

    at: Context

    @cached_property
    def expansion(self) -> Expansion:
        """What they are made of."""
        at = self.at
        return Expansion(at.plant, at.control, gravity=False, placed=at.placement_matters, baked=at.baked, compact=True)

    @cached_property
    def reduced(self) -> ca.Function:
        """K_p, M̄ (m, m), F (2r, m); sine²; follow (n, m), lengths of the columns of J and of what forces pass."""
        plant, g, expansion = self.at.plant, self.at.plant.graph, self.expansion
        sine = ca.substitute(g.singularity_sine_squared, g.q, g.rest)
        into = task_to_joints(expansion.point.rigid_jacobian, self.at.control, ca.SX.eye(plant.n_task)).T
        lengths = [ca.sqrt(ca.sum1(matrix**2)) for matrix in (expansion.point.jacobian, into)]
        return expansion.of_machine("reduced", [], [*expansion.graphs, sine, expansion.pencil.follow, *lengths])

    @cached_property
    def terms(self) -> ca.Function:
        """(follow, lengths of columns, modes, sizes) -> terms (m, 1), smallest size relative to them, parts (m, 1).

        The joints' motion in a mode may itself be a difference that vanishes, which terms do not show, but parts do.
        """
        plant = self.at.plant
        m, n = plant.n_passive, plant.n_actuated
        follow, modes, sizes = ca.SX.sym("follow", n, m), ca.SX.sym("modes", m, m), ca.SX.sym("sizes", m)
        out, into = ca.SX.sym("out", 1, m + n), ca.SX.sym("into", 1, n)
        moved = ca.fabs(modes)
        terms, parts = (
            ((out @ ca.vertcat(moved, joints)) * (into @ joints)).T
            for joints in (ca.fabs(follow @ modes), ca.fabs(follow) @ moved)
        )
        outputs = [terms, ca.mmin(sizes / terms), parts]
        return ca.Function("terms", [follow, out, into, modes, sizes], outputs, {"cse": True})

    @cached_property
    def gaps(self) -> ca.Function:
        """(ω²) -> gap of every mode (m, 1), the smallest."""
        values = ca.SX.sym("values", self.at.plant.n_passive)
        m, far = values.shape[0], ca.SX(1)
        between = [2 * (values[i + 1] - values[i]) / (values[i + 1] + values[i]) for i in range(m - 1)]
        sides = zip([far, *between], [*between, far], strict=True)
        gap = ca.vertcat(*(ca.fmin(ca.fmin(below, above), far) for below, above in sides))
        return ca.Function("gaps", [values], [gap, ca.mmin(gap)], {"cse": True})

    def graph(self, inputs: list[ca.MX], alpha: ca.MX) -> ModalGraph:
        """The graphs at MX inputs and weights."""
        expansion, m = self.expansion, self.at.plant.n_passive
        stiffness, mass, factors, sine_squared, *found = self.reduced.call(inputs)
        held, _ = expansion.solved([], [stiffness, mass, factors], called_modes(m))
        size = expansion.sizes(held)
        w, by_f = expansion.slopes(held, alpha)
        of_terms, of_gaps = list[ca.MX]([*found, held["modes"], size]), list[ca.MX]([held["omega_squared"]])
        (terms, significance, parts), (gap, least_gap) = self.terms.call(of_terms), self.gaps.call(of_gaps)
        by_mode = [expansion.slopes(held, one)[1] for one in ca.horzsplit(ca.DM.eye(m))]
        sizes = [ca.norm_2(ca.MX(expansion.gradient(inputs, held, each))) for each in by_mode]
        return ModalGraph(
            omega_squared=held["omega_squared"],
            w=w,
            size=size,
            sine_squared=sine_squared,
            terms=terms,
            parts=parts,
            significance=significance,
            gap=gap,
            least_gap=least_gap,
            gradient=expansion.gradient(inputs, held, by_f),
            gradient_sizes=ca.vertcat(*sizes),
        )
