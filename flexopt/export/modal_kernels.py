"""The measures w_i and the gradient of V = Σ α_i w_i for C: the graphs of `flexopt.robustness` behind calls.

In: a `Context`. Out: MX graphs made of calls of SX Functions. Written out as one expression, six modes and their
gradients are some 60,000 operations; here modes, which are alike, share their code, and derivatives pass through the
few numbers that everything stands on: K_p, M̄ and the matrices A, B of a_i = A φ_i and b_i = B φ_i. Results are those
of `flexopt.robustness.measures` to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from flexopt.algebra import called_eigen
from flexopt.export.context import Context
from flexopt.plant.control import task_to_joints
from flexopt.robustness.modes import ReducedPencil, called_modes, continue_modes, reduced_pencil
from flexopt.robustness.residues import measure, residue_factors, summed_residue


@dataclass(frozen=True)
class ModalGraph:
    """MX graphs at one posture. m modes, r task rows, n_z variables z = [placement; joints].

    Attributes:
        omega_squared, w, size: of every mode, (m, 1); size is |a_i||b_i|.
        sine_squared: distance from singular postures.
        terms: size of what |a_i||b_i| is summed from, (m, 1).
        significance: smallest |a_i||b_i| relative to that.
        gap: distance of ω_i² from its nearest neighbour relative to their mean, at most 1, (m, 1): rounding errors of
            the modes are divided by it.
        least_gap: the smallest of them.
    """

    omega_squared: ca.MX
    w: ca.MX
    size: ca.MX
    sine_squared: ca.MX
    terms: ca.MX
    significance: ca.MX
    gap: ca.MX
    least_gap: ca.MX
    _kernels: ModalKernels
    _inputs: list[ca.MX]
    _reduced: list[ca.MX]
    _modes: list[ca.MX]
    _slopes: list[list[ca.MX]]

    def gradient(self, alpha: ca.MX) -> ca.MX:
        """Σ α_i ∂w_i/∂z, (n_z, 1)."""
        weighted = [sum(alpha[i] * slope[k] for i, slope in enumerate(self._slopes)) for k in (0, 1)]
        adjoints = self._kernels.back.call([*self._reduced, *self._modes, *weighted])
        return self._kernels.reverse.call([*self._inputs, *adjoints])[0]

    def gradient_sizes(self) -> ca.MX:
        """|∂w_i/∂z| of every mode, (m, 1)."""
        one = ca.DM.eye(self.w.shape[0])
        return ca.vertcat(*(ca.norm_2(self.gradient(ca.MX(one[:, i]))) for i in range(self.w.shape[0])))


@dataclass(frozen=True)
class ModalKernels:
    """The Functions that are called. Inputs: placement where it matters, joints, parameters unless they are baked."""

    at: Context

    @cached_property
    def symbols(self) -> list[ca.SX]:
        """Inputs of every Function of the machine."""
        g = self.at.plant.graph
        return [*([g.base] if self.at.placement_matters else []), g.posture, *([] if self.at.baked else [g.p])]

    @cached_property
    def _reduced(self) -> tuple[list[ca.SX], list[ca.SX]]:
        """Graphs of K_p, M̄, A, B; and of what guards and scales need: sine², follow, lengths of columns."""
        at, plant, g = self.at, self.at.plant, self.at.plant.graph
        m = plant.n_passive
        point = plant.operating_point(g.base, g.posture, g.p)
        pencil = reduced_pencil(point, m)
        a, b = residue_factors(point, pencil, ca.SX.eye(m), at.control)
        sine = ca.substitute(g.singularity_sine_squared, g.q, g.rest)
        into = task_to_joints(point.rigid_jacobian, at.control, ca.SX.eye(plant.n_task)).T
        lengths = [ca.sqrt(ca.sum1(matrix**2)) for matrix in (point.jacobian, into)]
        return [pencil.stiffness, pencil.mass, a, b], [sine, pencil.follow, *lengths]

    @cached_property
    def reduced(self) -> ca.Function:
        """K_p, M̄ (m, m), A, B (r, m); sine²; follow (n, m), lengths of the columns of J and of what forces pass."""
        graphs, others = self._reduced
        return self.function("reduced", [], [*graphs, *others])

    @cached_property
    def of_mode(self) -> ca.Function:
        """(a, b, row, vectors) -> w_i, |a_i||b_i|, ∂w_i/∂a, ∂w_i/∂b, mode i in the first column of each."""
        r, m = self.at.plant.n_task, self.at.plant.n_passive
        a, b, row = ca.SX.sym("a", r, m), ca.SX.sym("b", r, m), ca.SX.sym("row", 1, m)
        vectors = ca.SX.sym("vectors", r, r)
        w = measure(a, b, row, vectors, 0)
        size = ca.norm_2(a[:, 0]) * ca.norm_2(b[:, 0])
        outputs = [w, size, ca.gradient(w, a), ca.gradient(w, b)]
        return ca.Function("of_mode", [a, b, row, vectors], [ca.densify(x) for x in outputs], {"cse": True})

    @cached_property
    def symmetric_part(self) -> ca.Function:
        """(a, b, row) -> R_i + R_iᵀ, summed over the cluster of the mode in the first column."""
        r, m = self.at.plant.n_task, self.at.plant.n_passive
        a, b, row = ca.SX.sym("a", r, m), ca.SX.sym("b", r, m), ca.SX.sym("row", 1, m)
        residue = summed_residue(a, b, row, 0)
        return ca.Function("symmetric_part", [a, b, row], [residue + residue.T], {"cse": True})

    @cached_property
    def factors(self) -> ca.Function:
        """(A, B, modes) -> a, b (r, m)."""
        r, m = self.at.plant.n_task, self.at.plant.n_passive
        a, b, modes = ca.SX.sym("A", r, m), ca.SX.sym("B", r, m), ca.SX.sym("modes", m, m)
        return ca.Function("factors", [a, b, modes], [a @ modes, b @ modes], {"cse": True})

    @cached_property
    def back(self) -> ca.Function:
        """(K, M̄, A, B, ω², modes, same, ∂V/∂a, ∂V/∂b) -> ∂V/∂M̄, ∂V/∂A, ∂V/∂B."""
        r, m = self.at.plant.n_task, self.at.plant.n_passive
        stiffness, mass = ca.SX.sym("K", m, m), ca.SX.sym("M", m, m)
        a, b = ca.SX.sym("A", r, m), ca.SX.sym("B", r, m)
        held = [ca.SX.sym("values", m), ca.SX.sym("modes", m, m), ca.SX.sym("same", m, m)]
        slopes = [ca.SX.sym("a_bar", r, m), ca.SX.sym("b_bar", r, m)]
        pencil = ReducedPencil(stiffness, mass, ca.SX(0, 0), ca.SX(0, 0))
        _, modes = continue_modes(pencil, *held, order=1)
        value = ca.dot(slopes[0], a @ modes) + ca.dot(slopes[1], b @ modes)
        # At the solution itself the modes are those held, and errors of rounding need no correction.
        outputs = [ca.densify(ca.gradient(value, x)) for x in (mass, a, b)]
        return ca.Function("back", [stiffness, mass, a, b, *held, *slopes], outputs, {"cse": True})

    @cached_property
    def reverse(self) -> ca.Function:
        """Inputs, ∂V/∂M̄, ∂V/∂A, ∂V/∂B -> ∂V/∂z; K_p does not depend on z."""
        g = self.at.plant.graph
        graphs = self._reduced[0][1:]
        slopes = [ca.SX.sym(f"slope{k}", *graph.shape) for k, graph in enumerate(graphs)]
        value = sum((ca.dot(slope, graph) for slope, graph in zip(slopes, graphs, strict=True)), start=ca.SX(0))
        return self.function("reverse", slopes, [ca.gradient(value, ca.vertcat(g.base, g.posture))])

    @cached_property
    def terms(self) -> ca.Function:
        """(follow, lengths of columns, modes, sizes) -> terms (m, 1), smallest size relative to its terms."""
        plant = self.at.plant
        m, n = plant.n_passive, plant.n_actuated
        follow, modes, sizes = ca.SX.sym("follow", n, m), ca.SX.sym("modes", m, m), ca.SX.sym("sizes", m)
        out, into = ca.SX.sym("out", 1, m + n), ca.SX.sym("into", 1, n)
        joints = ca.fabs(follow @ modes)
        terms = ((out @ ca.vertcat(ca.fabs(modes), joints)) * (into @ joints)).T
        return ca.Function("terms", [follow, out, into, modes, sizes], [terms, ca.mmin(sizes / terms)], {"cse": True})

    @cached_property
    def gaps(self) -> ca.Function:
        """(ω²) -> gap of every mode (m, 1), the smallest."""
        values = ca.SX.sym("values", self.at.plant.n_passive)
        m, far = values.shape[0], ca.SX(1)
        between = [2 * (values[i + 1] - values[i]) / (values[i + 1] + values[i]) for i in range(m - 1)]
        sides = zip([far, *between], [*between, far], strict=True)
        gap = ca.vertcat(*(ca.fmin(ca.fmin(below, above), far) for below, above in sides))
        return ca.Function("gaps", [values], [gap, ca.mmin(gap)], {"cse": True})

    def function(self, name: str, extra: list[ca.SX], graphs: list[ca.SX]) -> ca.Function:
        """A Function of the inputs and `extra`, constants in their place where they are none."""
        at, g = self.at, self.at.plant.graph
        fixed = [] if at.placement_matters else [(g.base, ca.SX.zeros(at.plant.n_base, 1))]
        fixed += [(g.p, ca.SX(at.plant.parameter_values))] if at.baked else []
        if fixed:
            graphs = ca.substitute(graphs, [symbol for symbol, _ in fixed], [constant for _, constant in fixed])
        return ca.Function(name, [*self.symbols, *extra], [ca.densify(graph) for graph in graphs], {"cse": True})

    def graph(self, inputs: list[ca.MX]) -> ModalGraph:
        """The graphs at MX inputs."""
        m, r = self.at.plant.n_passive, self.at.plant.n_task
        found = self.reduced.call(inputs)
        reduced, sine, spread = found[:4], found[4], found[5:]
        modes = called_modes(m).call(reduced[:2])
        a, b = self.factors.call([*reduced[2:], modes[1]])
        w, sizes, slopes = list[ca.MX](), list[ca.MX](), list[list[ca.MX]]()
        for i in range(m):
            order = [i, *(k for k in range(m) if k != i)]
            back = [order.index(k) for k in range(m)]
            turned = [a[:, order], b[:, order], modes[2][i, order]]
            vectors = called_eigen(r).call(self.symmetric_part.call(turned))[1]
            value, size, by_a, by_b = self.of_mode.call([*turned, vectors])
            w.append(value)
            sizes.append(size)
            slopes.append([by_a[:, back], by_b[:, back]])
        size = ca.vertcat(*sizes)
        terms, significance = self.terms.call([*spread, modes[1], size])
        gap, least_gap = self.gaps.call(modes[:1])
        return ModalGraph(
            omega_squared=modes[0],
            w=ca.vertcat(*w),
            size=size,
            sine_squared=sine,
            terms=terms,
            significance=significance,
            gap=gap,
            least_gap=least_gap,
            _kernels=self,
            _inputs=inputs,
            _reduced=reduced,
            _modes=modes,
            _slopes=slopes,
        )
