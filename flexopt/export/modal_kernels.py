"""The measures w_i and the gradient of V = Σ α_i w_i for C: the graphs of `flexopt.robustness` behind calls.

In: a `Context`. Out: MX graphs made of calls of SX Functions. Written out as one expression, six modes and their
gradients are some 60,000 operations; here modes, which are alike, share their code, and derivatives pass through the
few numbers that everything stands on: K_p, M̄ and the matrices A, B of a_i = A φ_i and b_i = B φ_i. Results are those
of `flexopt.robustness.measures` to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import casadi as ca

from flexopt.algebra import called_eigen
from flexopt.export.context import Context
from flexopt.plant.control import task_to_joints
from flexopt.robustness.modes import called_modes, called_modes_near, reduced_pencil
from flexopt.robustness.residues import measure, rank_one_measure, residue_factors, summed_residue


@dataclass(frozen=True)
class HeldModes:
    """MX graphs of the modes at one posture. m modes, r task rows.

    Attributes:
        omega_squared, modes, same: as from `called_modes`.
        a, b: the factors of the residues, (r, m).
    """

    omega_squared: ca.MX
    modes: ca.MX
    same: ca.MX
    a: ca.MX
    b: ca.MX

    @property
    def packed(self) -> ca.MX:
        """All of it in one column."""
        return ca.veccat(self.omega_squared, self.modes, self.same, self.a, self.b)

    @classmethod
    def unpacked(cls, packed: ca.MX, r: int, m: int) -> HeldModes:
        """From the column of r rows and m modes."""
        shapes = [(m, 1), (m, m), (m, m), (r, m), (r, m)]
        edges = [0, *accumulate(rows * columns for rows, columns in shapes)]
        parts = ca.vertsplit(packed, edges)
        return cls(*(ca.reshape(part, *shape) for part, shape in zip(parts, shapes, strict=True)))


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
        gradient: Σ α_i ∂w_i/∂z, (n_z, 1).
    """

    omega_squared: ca.MX
    w: ca.MX
    size: ca.MX
    sine_squared: ca.MX
    terms: ca.MX
    significance: ca.MX
    gap: ca.MX
    least_gap: ca.MX
    gradient: ca.MX
    _kernels: ModalKernels
    _inputs: list[ca.MX]
    _held: HeldModes

    def gradient_sizes(self) -> ca.MX:
        """|∂w_i/∂z| of every mode, (m, 1)."""
        kernels, sizes = self._kernels, list[ca.MX]()
        for one in ca.horzsplit(ca.DM.eye(self.w.shape[0])):
            slopes = kernels.measures_of(self._held, ca.MX(one))[2:]
            sizes.append(ca.norm_2(kernels.gradient(self._inputs, self._held, slopes)))
        return ca.vertcat(*sizes)


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
    def pencil(self) -> ca.Function:
        """K_p, M̄ (m, m), A, B (r, m) alone."""
        return self.function("pencil", [], self._reduced[0])

    @cached_property
    def of_modes(self) -> ca.Function:
        """(a, b, same, α) -> w_i and |a_i||b_i| (m, 1), Σ α_i ∂w_i/∂a and Σ α_i ∂w_i/∂b (r, m)."""
        r, m = self.at.plant.n_task, self.at.plant.n_passive
        a, b, same = ca.SX.sym("a", r, m), ca.SX.sym("b", r, m), ca.SX.sym("same", m, m)
        alpha = ca.SX.sym("alpha", m)
        w = ca.vertcat(*(rank_one_measure(a[:, i], b[:, i]) for i in range(m)))
        value, sizes = ca.dot(alpha, w), _sizes(a, b)
        outputs = [w, sizes, ca.gradient(value, a), ca.gradient(value, b)]
        simple = ca.Function("of_simple_modes", [a, b, same, alpha], [ca.densify(x) for x in outputs], {"cse": True})
        if m == 1:
            return simple
        either = ca.Function.if_else("of_either_modes", simple, self._of_clustered_modes)
        alone = ca.Function("are_alone", [same], [ca.sum1(ca.sum2(same)) <= m + 0.5])
        given = [ca.MX.sym(name, *x.shape) for name, x in (("a", a), ("b", b), ("same", same), ("alpha", alpha))]
        return ca.Function("of_modes", given, either.call([alone.call(given[2:3])[0], *given]))

    @cached_property
    def _of_clustered_modes(self) -> ca.Function:
        """The same where frequencies may coincide: mode by mode, with the eigenvectors of its cluster's sum."""
        r, m = self.at.plant.n_task, self.at.plant.n_passive
        a, b, row = ca.SX.sym("a", r, m), ca.SX.sym("b", r, m), ca.SX.sym("row", 1, m)
        vectors = ca.SX.sym("vectors", r, r)
        residue = summed_residue(a, b, row, 0)
        symmetric = ca.Function("symmetric_part", [a, b, row], [residue + residue.T], {"cse": True})
        w = measure(a, b, row, vectors, 0)
        outputs = [ca.densify(x) for x in (w, ca.gradient(w, a), ca.gradient(w, b))]
        first = ca.Function("of_first_mode", [a, b, row, vectors], outputs, {"cse": True})
        sizes = ca.Function("sizes", [a, b], [_sizes(a, b)])

        given = [ca.MX.sym("a", r, m), ca.MX.sym("b", r, m), ca.MX.sym("same", m, m), ca.MX.sym("alpha", m)]
        values, slopes = list[ca.MX](), [ca.MX.zeros(r, m), ca.MX.zeros(r, m)]
        for i in range(m):
            order = [i, *(k for k in range(m) if k != i)]
            back = [order.index(k) for k in range(m)]
            turned = [given[0][:, order], given[1][:, order], given[2][i, order]]
            value, *by = first.call([*turned, called_eigen(r).call(symmetric.call(turned))[1]])
            values.append(value)
            slopes = [total + given[3][i] * part[:, back] for total, part in zip(slopes, by, strict=True)]
        return ca.Function("of_clustered_modes", given, [ca.vertcat(*values), *sizes.call(given[:2]), *slopes])

    @cached_property
    def factors(self) -> ca.Function:
        """(A, B, modes) -> a, b (r, m)."""
        r, m = self.at.plant.n_task, self.at.plant.n_passive
        a, b, modes = ca.SX.sym("A", r, m), ca.SX.sym("B", r, m), ca.SX.sym("modes", m, m)
        return ca.Function("factors", [a, b, modes], [a @ modes, b @ modes], {"cse": True})

    @cached_property
    def back(self) -> ca.Function:
        """(a, b, ω², modes, same, ∂V/∂a, ∂V/∂b) -> ∂V/∂M̄ (upper triangle, column by column), ∂V/∂A, ∂V/∂B; K_p stays.

        With V = Φᵀ dM̄ Φ the modes Φ change by Φ (C ∘ V): C_ij = −1/2 − (λ_i + λ_j) / 2 (λ_j − λ_i) across clusters and
        −1/2 inside them (Fox and Kapoor, 1968; `flexopt.algebra.perturbed_pencil`).
        """
        r, m = self.at.plant.n_task, self.at.plant.n_passive
        a, b = ca.SX.sym("a", r, m), ca.SX.sym("b", r, m)
        values, modes, same = ca.SX.sym("values", m), ca.SX.sym("modes", m, m), ca.SX.sym("same", m, m)
        slopes = [ca.SX.sym("a_bar", r, m), ca.SX.sym("b_bar", r, m)]
        rows, columns = ca.repmat(values, 1, m), ca.repmat(values.T, m, 1)
        coefficients = -0.5 - (1 - same) * (rows + columns) / (2 * (columns - rows + same))
        turned = coefficients * (a.T @ slopes[0] + b.T @ slopes[1])
        half = modes @ ((turned + turned.T) / 2)
        by_mass = [half[i, :] @ modes[j, :].T * (1 if i == j else 2) for j in range(m) for i in range(j + 1)]
        outputs = [ca.vertcat(*by_mass), *(slope @ modes.T for slope in slopes)]
        symbols = [a, b, values, modes, same, *slopes]
        return ca.Function("back", symbols, [ca.densify(x) for x in outputs], {"cse": True})

    @cached_property
    def reverse(self) -> ca.Function:
        """Inputs, ∂V/∂M̄ (as from `back`), ∂V/∂A, ∂V/∂B -> ∂V/∂z; K_p does not depend on z."""
        g, m = self.at.plant.graph, self.at.plant.n_passive
        _, mass, *factors = self._reduced[0]
        graphs = [ca.vertcat(*(mass[i, j] for j in range(m) for i in range(j + 1))), *factors]
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

    def held_modes(self, inputs: list[ca.MX], near: ca.MX) -> tuple[HeldModes, ca.MX]:
        """The modes at MX inputs, from what they were nearby; and what the next ones may start from."""
        stiffness, mass, a_of, b_of = self.pencil.call(inputs)
        *modes, z = called_modes_near(self.at.plant.n_passive).call([stiffness, mass, near])
        return self._modes(a_of, b_of, modes), z

    def _modes(self, a_of: ca.MX, b_of: ca.MX, modes: list[ca.MX]) -> HeldModes:
        return HeldModes(*modes, *self.factors.call([a_of, b_of, modes[1]]))

    def measures_of(self, held: HeldModes, alpha: ca.MX) -> list[ca.MX]:
        """What `of_modes` gives."""
        return self.of_modes.call([held.a, held.b, held.same, alpha])

    def gradient(self, inputs: list[ca.MX], held: HeldModes, slopes: list[ca.MX]) -> ca.MX:
        """∂V/∂z, (n_z, 1), from ∂V/∂a and ∂V/∂b."""
        at = [held.a, held.b, held.omega_squared, held.modes, held.same]
        return self.reverse.call([*inputs, *self.back.call([*at, *slopes])])[0]

    def graph(self, inputs: list[ca.MX], alpha: ca.MX) -> ModalGraph:
        """The graphs at MX inputs and weights."""
        found = self.reduced.call(inputs)
        held = self._modes(found[2], found[3], called_modes(self.at.plant.n_passive).call(found[:2]))
        w, size, *slopes = self.measures_of(held, alpha)
        terms, significance = self.terms.call([*found[5:], held.modes, size])
        gap, least_gap = self.gaps.call([held.omega_squared])
        return ModalGraph(
            omega_squared=held.omega_squared,
            w=w,
            size=size,
            sine_squared=found[4],
            terms=terms,
            significance=significance,
            gap=gap,
            least_gap=least_gap,
            gradient=self.gradient(inputs, held, slopes),
            _kernels=self,
            _inputs=inputs,
            _held=held,
        )


def _sizes(a: ca.SX, b: ca.SX) -> ca.SX:
    """|a_i||b_i| of every mode, (m, 1)."""
    return ca.vertcat(*(ca.norm_2(a[:, i]) * ca.norm_2(b[:, i]) for i in range(a.shape[1])))
