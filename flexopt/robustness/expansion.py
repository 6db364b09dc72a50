"""V = Σ αi wi with its gradient and Hessian about a posture whose modes are known: what solvers call at every step.

All derivatives pass through the few numbers that everything stands on: K_p, M̄ and F = [A; B] of a_i = A φ_i and
b_i = B φ_i, together y. With G = ∂V/∂y and Y = ∂y/∂z it is ∂V/∂z = Yᵀ G and ∂²V/∂z² = Yᵀ (∂²V/∂y²) Y + ∂²(G·y)/∂z²:
the first term stands in closed form in the axes of the modes, the second is that of the machine alone. Results are
those of `flexopt.robustness.measures` to rounding, at a third of the operations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca

from flexopt.algebra.expansion import expanded_vectors
from flexopt.robustness.measures import Measures
from flexopt.robustness.residues import measure, rank_one_measure

NAMES = ["base", "posture", "p", "held", "alpha"]
# `held` is a constant to CasADi but changes with the posture: a derivative taken of such a Function would be wrong, so
# that none can be taken.
NO_DERIVATIVES: dict[str, Any] = {
    "never_inline": True,
    **dict.fromkeys(("enable_forward", "enable_reverse", "enable_jacobian", "enable_fd"), False),
}


@dataclass(frozen=True)
class Expansion:
    """Functions of base (n_b,), posture (n,), p (n_par,), `held` from `Measures.hold`, and alpha (m,).

    None of them can be differentiated by CasADi, to which `held` would be constant: ask for the next one.

    Inside, `f` is F Φ (2r, m), a_i above b_i, and `change` one of y in the axes of the modes: Φᵀ dK_p Φ, Φᵀ dM̄ Φ, dF Φ.
    """

    measures: Measures

    @cached_property
    def value(self) -> ca.Function:
        """-> V."""
        symbols, f = self._begun()
        value = self._of_modes("weighted_measures", [], lambda weighted: [weighted])
        return ca.Function("value", symbols, value.call([f, *symbols[3:]]), NAMES, ["V"], NO_DERIVATIVES)

    @cached_property
    def slope(self) -> ca.Function:
        """-> V and ∂V/∂z (n_z,)."""
        symbols, f = self._begun()
        value, by_f = self._slopes.call([f, *symbols[3:]])
        pull = self._pull.call([f, by_f, symbols[3]])[0]
        gradient = self._machine_slope.call([*symbols[:4], pull])[0]
        return ca.Function("slope", symbols, [value, gradient], NAMES, ["V", "V_z"], NO_DERIVATIVES)

    @cached_property
    def curvature(self) -> ca.Function:
        """-> ∂²V/∂z² (n_z, n_z)."""
        symbols, f = self._begun()
        by_f = self._slopes.call([f, *symbols[3:]])[1]
        pull = self._pull.call([f, by_f, symbols[3]])[0]
        of_machine, slopes = self._machine_curvature.call([*symbols[:4], pull])
        if not self._moving:
            return ca.Function("curvature", symbols, [of_machine], NAMES, ["V_zz"], NO_DERIVATIVES)
        changes = self._into_modes.map(len(self._moving)).call([slopes, symbols[3]])[0]
        bent = self._bent.map(len(self._moving)).call([changes, f, by_f, *symbols[3:]])[0]
        inside = changes.T @ bent
        spread = ca.DM.eye(of_machine.shape[0])[:, self._moving]
        hessian = of_machine + spread @ ((inside + inside.T) / 2) @ spread.T
        return ca.Function("curvature", symbols, [hessian], NAMES, ["V_zz"], NO_DERIVATIVES)

    def _begun(self) -> tuple[list[ca.MX], ca.MX]:
        """Symbols of all inputs, and f."""
        g, m = self.measures.plant.graph, self.measures.plant.n_passive
        sizes = [x.shape[0] for x in (g.base, g.posture, g.p, self.measures.held)]
        symbols = [ca.MX.sym(name, size) for name, size in zip(NAMES, [*sizes, m], strict=True)]
        return symbols, self._factors.call(symbols[:4])[0]

    # The machine: y and its derivatives by z.

    @cached_property
    def _graphs(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """K_p, M̄ (m, m) and F (2r, m)."""
        stiffness, mass, a, b = self.measures.reduced
        return stiffness, mass, ca.vertcat(a, b)

    @cached_property
    def _z(self) -> ca.SX:
        return ca.vertcat(self.measures.plant.graph.base, self.measures.plant.graph.posture)

    @cached_property
    def _softens(self) -> bool:
        """Whether K_p depends on z, as it does under gravity; else it is no part of y."""
        return bool(ca.depends_on(self._graphs[0], self._z))

    @cached_property
    def _y(self) -> ca.SX:
        return ca.veccat(*(ca.densify(graph) for graph in self._graphs[0 if self._softens else 1 :]))

    @cached_property
    def _moving(self) -> list[int]:
        """Numbers of the z that y depends on: x and y of the placement are not among them."""
        return [k for k, depends in enumerate(ca.which_depends(self._y, self._z, 1, False)) if depends]

    @cached_property
    def _factors(self) -> ca.Function:
        """(base, posture, p, held) -> f."""
        return self._of_machine("factors", [], [self._graphs[2] @ self.measures.held_parts["modes"]])

    @cached_property
    def _machine_slope(self) -> ca.Function:
        """(base, posture, p, held, G) -> ∂(G·y)/∂z (n_z,)."""
        pull = ca.SX.sym("G", self._y.shape[0])
        return self._of_machine("machine_slope", [pull], [ca.gradient(ca.dot(pull, self._y), self._z)])

    @cached_property
    def _machine_curvature(self) -> ca.Function:
        """(base, posture, p, held, G) -> ∂²(G·y)/∂z² (n_z, n_z), and the columns of Y that are not zero."""
        pull, n_z = ca.SX.sym("G", self._y.shape[0]), self._z.shape[0]
        slope = ca.gradient(ca.dot(pull, self._y), self._z)
        # In one go, because both need the derivatives of all that leads to y.
        both = ca.jacobian(ca.vertcat(slope, self._y), self._z)
        return self._of_machine("machine_curvature", [pull], [both[:n_z, :], both[n_z:, self._moving]])

    def _of_machine(self, name: str, extra: list[ca.SX], outputs: list[ca.SX]) -> ca.Function:
        g = self.measures.plant.graph
        inputs = [g.base, g.posture, g.p, self.measures.held, *extra]
        return ca.Function(name, inputs, [ca.densify(output) for output in outputs])

    # The modes: V and its derivatives by y.

    @cached_property
    def _symbols(self) -> dict[str, ca.SX]:
        """f, ∂V/∂f, α, and the parts of `change`."""
        m, r = self.measures.plant.n_passive, self.measures.plant.n_task
        sizes = {"f": (2 * r, m), "by_f": (2 * r, m), "alpha": (m, 1)}
        sizes |= {"stiffness": (m if self._softens else 0, m), "mass": (m, m), "factors": (2 * r, m)}
        return {name: ca.SX.sym(name, *size) for name, size in sizes.items()}

    @cached_property
    def _change(self) -> ca.SX:
        return ca.veccat(*(self._symbols[name] for name in ("stiffness", "mass", "factors")))

    @cached_property
    def _turned(self) -> tuple[ca.SX, ca.SX]:
        """C_1 and C_2 of the modes for `change`."""
        s, held, m = self._symbols, self.measures.held_parts, self.measures.plant.n_passive
        stiffness = s["stiffness"] if self._softens else ca.SX(m, m)
        return expanded_vectors(stiffness, s["mass"], held["omega_squared"], held["same"])

    def _of_modes(self, name: str, extra: list[ca.SX], outputs: Callable[[ca.SX], list[ca.SX]]) -> ca.Function:
        """(f, held, alpha, extra) -> `outputs` of V as a graph of f; of a shorter one where frequencies are simple."""
        s, held = self._symbols, self.measures.held_parts
        r, m = self.measures.plant.n_task, self.measures.plant.n_passive
        a, b, same, parts = s["f"][:r, :], s["f"][r:, :], held["same"], held["symmetric_parts"]
        inputs = [s["f"], self.measures.held, s["alpha"], *extra]

        def function(w: list[ca.SX]) -> ca.Function:
            weighted = ca.dot(s["alpha"], ca.vertcat(*w))
            return ca.Function(name, inputs, [ca.densify(output) for output in outputs(weighted)])

        simple = function([rank_one_measure(a[:, i], b[:, i]) for i in range(m)])
        if m == 1:
            return simple
        clustered = function([measure(a, b, same, parts, i) for i in range(m)])
        given = simple.mx_in()
        alone = ca.Function("alone", [self.measures.held], [ca.sum(ca.vec(same)) <= m + 0.5])
        chosen = ca.Function.if_else(name, simple, clustered).call([*alone.call(given[1:2]), *given])
        return ca.Function(name, given, chosen)

    @cached_property
    def _slopes(self) -> ca.Function:
        """(f, held, alpha) -> V and ∂V/∂f."""
        return self._of_modes("slopes", [], lambda weighted: [weighted, ca.gradient(weighted, self._symbols["f"])])

    @cached_property
    def _pull(self) -> ca.Function:
        """(f, ∂V/∂f, held) -> G."""
        s, phi = self._symbols, self.measures.held_parts["modes"]
        first = ca.dot(s["f"].T @ s["by_f"], self._turned[0])
        pulls = [phi @ ca.gradient(first, s[name]) @ phi.T for name in ("stiffness", "mass") if s[name].nnz()]
        pull = ca.densify(ca.veccat(*pulls, s["by_f"] @ phi.T))
        return ca.Function("pull", [s["f"], s["by_f"], self.measures.held], [pull])

    @cached_property
    def _into_modes(self) -> ca.Function:
        """(a change of y, held) -> `change`."""
        s, phi = self._symbols, self.measures.held_parts["modes"]
        parts = [phi.T @ s[name] @ phi for name in ("stiffness", "mass") if s[name].nnz()]
        change = ca.densify(ca.veccat(*parts, s["factors"] @ phi))
        return ca.Function("into_modes", [self._change, self.measures.held], [change])

    @cached_property
    def _bent(self) -> ca.Function:
        """(change, f, ∂V/∂f, held, alpha) -> (∂²V/∂y²) change, in the axes of the modes."""
        s, (first, second) = self._symbols, self._turned
        inputs = [self._change, s["f"], s["by_f"], self.measures.held]
        moved = s["factors"] + s["f"] @ first
        along = ca.SX.sym("along", *moved.shape)
        # V's terms of second degree: linear in C_2, products with C_1, and quadratic in the change of f, of which the
        # derivative is written down.
        terms = ca.dot(s["f"].T @ s["by_f"], second) + ca.dot(s["factors"].T @ s["by_f"], first) + ca.dot(along, moved)
        move = ca.Function("moved", inputs, [ca.densify(moved)])
        finish = ca.Function("terms", [*inputs, along], [ca.densify(ca.gradient(terms, self._change))])
        bend = self._of_modes(
            "second_slopes", [along], lambda weighted: [ca.jtimes(ca.gradient(weighted, s["f"]), s["f"], along)]
        )
        given = [*finish.mx_in()[:4], ca.MX.sym("alpha", *s["alpha"].shape)]
        curved = bend.call([given[1], *given[3:], *move.call(given[:4])])
        return ca.Function("bent", given, finish.call([*given[:4], *curved]))
