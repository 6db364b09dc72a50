"""How a machine's measures move with placement, posture and parameters: the one way to their derivatives.

All of it passes through the few numbers that the modes stand on: K_p, M̄ and F = [A; B] of a_i = A φ_i and b_i = B φ_i,
together y. With G = ∂V/∂y and Y = ∂y/∂z it is ∂V/∂z = Yᵀ G and ∂²V/∂z² = Yᵀ (∂²V/∂y²) Y + ∂²(G·y)/∂z²: derivatives by
y stand in closed form in the axes of the modes (`mode_terms`), those of y are the machine's alone. The solutions of the
iterations (static deflection, modes) enter as a vector `held`, about which everything is exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Any

import casadi as ca

from flexopt.foundation.control import Control
from flexopt.foundation.kept import Structural, structural_property
from flexopt.plant import Plant
from flexopt.plant.plant import OperatingPoint
from flexopt.robustness.mode_terms import ModeTerms, mode_terms
from flexopt.robustness.modes import ReducedPencil, reduced_pencil
from flexopt.robustness.residues import residue_factors

NAMES = ["base", "posture", "p", "held", "alpha"]
# `held` is a constant to CasADi but changes with the posture: a derivative taken of such a Function would be wrong, so
# that none can be taken.
NO_DERIVATIVES: dict[str, Any] = {
    "never_inline": True,
    **dict.fromkeys(("enable_forward", "enable_reverse", "enable_jacobian", "enable_fd"), False),
}


# The parts of `held` as graphs, SX or MX, by name.
HeldGraphs = dict[str, Any]


@dataclass(frozen=True)
class Expansion(Structural):
    """Functions of base (n_b,), posture (n,), p (n_par,), `held`, and alpha (m,), the weights of V = Σ αi wi.

    `held` is, one below the other, the static deflection (under gravity), ω², Φ, clusters, and f = F Φ (2r, m), a_i
    above b_i. No Function can be differentiated by CasADi, to which it would be constant: ask for the next one.

    Attributes:
        plant, control, gravity: as in `Measures`.
        placed: whether base is an input; else it is 0.
        baked: whether p is no input, but the machine's own.
        compact: whether equal parts of graphs are looked for, which takes time: for C.
    """

    plant: Plant
    control: Control
    gravity: bool
    placed: bool = True
    baked: bool = False
    compact: bool = False

    @property
    def has_own_numbers(self) -> bool:
        """Whether p is baked in."""
        return self.baked

    @structural_property
    def held_parts(self) -> dict[str, ca.SX]:
        """Symbols of the parts of `held`, by name."""
        m, r = self.plant.n_passive, self.plant.n_task
        shapes = {"deflection": (m if self.gravity else 0, 1), "omega_squared": (m, 1), "modes": (m, m)}
        return {name: ca.SX.sym(name, *shape) for name, shape in (shapes | {"same": (m, m), "f": (2 * r, m)}).items()}

    @structural_property
    def held(self) -> ca.SX:
        """All of them as one vector symbol."""
        return ca.veccat(*self.held_parts.values())

    def parts(self, held: Any) -> HeldGraphs:
        """The parts of a given `held`."""
        edges = [0, *accumulate(part.numel() for part in self.held_parts.values())]
        names, symbols = self.held_parts.keys(), self.held_parts.values()
        split: list[Any] = [held[i:j] for i, j in pairwise(edges)]
        return {name: ca.reshape(x, *symbol.shape) for name, symbol, x in zip(names, symbols, split, strict=True)}

    def hold(self, at: Sequence[Any], modes: ca.Function) -> tuple[HeldGraphs, list[Any]]:
        """The parts of `held` at graphs of the inputs (of base, posture and p), and what else `modes` gives."""
        deflection = self.deflection(at)
        return self.solved(deflection, self.reduced.call([*at, *deflection]), modes)

    def deflection(self, at: Sequence[Any]) -> list[Any]:
        """The static deflection (m,) as a graph, in a list; an empty one without gravity."""
        return self._deflected.call(list(at)) if self.gravity else []

    def solved(self, deflection: list[Any], y: Sequence[Any], modes: ca.Function) -> tuple[HeldGraphs, list[Any]]:
        """`hold` from graphs of K_p, M̄ and F; `modes` is (K_p, M̄) -> ω², Φ, clusters, and more."""
        stiffness, mass, factors = y
        omega_squared, shapes, same, *more = modes.call([stiffness, mass])
        f = self.terms.factors.call([factors, shapes])[0]
        held = zip(self.held_parts, [*(deflection or [type(f)(0, 1)]), omega_squared, shapes, same, f], strict=True)
        return dict(held), more

    def slopes(self, held: HeldGraphs, alpha: Any) -> list[Any]:
        """The w_i (m,) and ∂V/∂f (2r, m) as graphs."""
        return self.terms.slopes.call([held["f"], held["same"], alpha])

    def sizes(self, held: HeldGraphs) -> Any:
        """|a_i||b_i| (m,) as a graph."""
        return self.terms.sizes.call([held["f"]])[0]

    # The machine: y and its derivatives.

    @structural_property
    def inputs(self) -> dict[str, ca.SX]:
        """Inputs of the machine's Functions by name."""
        g = self.plant.graph
        given = ({"base": g.base} if self.placed else {}) | {"posture": g.posture}
        given |= {} if self.baked else {"p": g.p}
        return given | ({"deflection": self.held_parts["deflection"]} if self.gravity else {})

    def _at(self, at: Sequence[Any], held: HeldGraphs) -> list[Any]:
        return [*at, held["deflection"]] if self.gravity else list(at)

    def of_machine(self, name: str, extra: Sequence[ca.SX], outputs: Sequence[ca.SX]) -> ca.Function:
        """A Function of the inputs and `extra`, constants in the place of what is no input."""
        return self._of(name, [*self.inputs.values(), *extra], outputs)

    def _of(self, name: str, symbols: list[ca.SX], outputs: Sequence[ca.SX]) -> ca.Function:
        g, dense = self.plant.graph, [ca.densify(output) for output in outputs]
        fixed = [] if self.placed else [(g.base, ca.SX.zeros(self.plant.n_base, 1))]
        fixed += [(g.p, ca.SX(self.plant.parameter_values))] if self.baked else []
        for symbol, constant in fixed:
            dense = ca.substitute(dense, [symbol], [constant])
        return ca.Function(name, symbols, dense, {"cse": self.compact})

    @structural_property
    def _deflected(self) -> ca.Function:
        g = self.plant.graph
        given = [x for name, x in self.inputs.items() if name != "deflection"]
        return self._of("deflected", given, [self.plant.deflected(g.base, g.posture, g.p)])

    @structural_property
    def point(self) -> OperatingPoint:
        """The plant about the deflection."""
        g = self.plant.graph
        return self.plant.operating_point(g.base, g.posture, g.p, self.inputs.get("deflection"))

    @structural_property
    def pencil(self) -> ReducedPencil:
        """The pencil there."""
        return reduced_pencil(self.point, self.plant.n_passive)

    @structural_property
    def graphs(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """K_p, M̄ (m, m) and F (2r, m)."""
        pencil = self.pencil
        return pencil.stiffness, pencil.mass, residue_factors(self.point, pencil, self.control)

    @structural_property
    def reduced(self) -> ca.Function:
        """-> K_p, M̄ (m, m) and F (2r, m)."""
        return self.of_machine("reduced", [], self.graphs)

    @structural_property
    def _z(self) -> ca.SX:
        return ca.vertcat(self.plant.graph.base, self.plant.graph.posture)

    def _terms_by(self, x: ca.SX) -> tuple[ModeTerms, ca.SX]:
        """Functions of the modes, and y, as far as it may depend on x: K_p moves under gravity and with p."""
        stiff = bool(ca.depends_on(self.graphs[0], x))
        terms = mode_terms(self.plant.n_task, self.plant.n_passive, stiff=stiff)
        return terms, terms.y(*self.graphs)

    @property
    def terms(self) -> ModeTerms:
        """Functions of the modes."""
        return self._y_terms[0]

    @structural_property
    def _y_terms(self) -> tuple[ModeTerms, ca.SX]:
        return self._terms_by(self._z)

    @structural_property
    def _moving(self) -> list[int]:
        """Numbers of the z that y depends on: x and y of the placement are not among them."""
        return [k for k, depends in enumerate(ca.which_depends(self._y_terms[1], self._z, 1, False)) if depends]

    @structural_property
    def _machine_slope(self) -> ca.Function:
        """(inputs, G) -> ∂(G·y)/∂z (n_z,)."""
        y = self._y_terms[1]
        pull = ca.SX.sym("G", y.shape[0])
        return self.of_machine("machine_slope", [pull], [ca.gradient(ca.dot(pull, y), self._z)])

    @structural_property
    def _machine_curvature(self) -> ca.Function:
        """(inputs, G) -> ∂(G·y)/∂z (n_z,), ∂²(G·y)/∂z² (n_z, n_z), and the columns of Y that are not zero."""
        y, n_z = self._y_terms[1], self._z.shape[0]
        pull = ca.SX.sym("G", y.shape[0])
        slope = ca.gradient(ca.dot(pull, y), self._z)
        # In one go, because both need the derivatives of all that leads to y.
        both = ca.jacobian(ca.vertcat(slope, y), self._z)
        return self.of_machine("machine_curvature", [pull], [slope, both[:n_z, :], both[n_z:, self._moving]])

    @structural_property
    def _machine_jacobian(self) -> ca.Function:
        """(inputs) -> the columns of Y that are not zero."""
        return self.of_machine("machine_jacobian", [], [ca.jacobian(self._y_terms[1], self._z)[:, self._moving]])

    @structural_property
    def _spread(self) -> ca.Function:
        """(second derivatives by z, by the moving z) -> their sum, symmetric."""
        n_z, k = self._z.shape[0], len(self._moving)
        total, inside, spread = ca.SX.sym("total", n_z, n_z), ca.SX.sym("inside", k, k), ca.SX.eye(n_z)[:, self._moving]
        return ca.Function("spread", [total, inside], [total + spread @ ((inside + inside.T) / 2) @ spread.T])

    # Both together.

    def gradient(self, at: Sequence[Any], held: HeldGraphs, by_f: Any) -> Any:
        """∂V/∂z (n_z,) as a graph, from ∂V/∂f."""
        pull = self.terms.pull.call([*self._modes(held), by_f])
        return self._machine_slope.call([*self._at(at, held), *pull])[0]

    def hessian(self, at: Sequence[Any], held: HeldGraphs, by_f: Any, alpha: Any) -> tuple[Any, Any]:
        """∂V/∂z (n_z,) and ∂²V/∂z² (n_z, n_z) as graphs, from ∂V/∂f and α."""
        omega_squared, shapes, same, f = modes = self._modes(held)
        pull = self.terms.pull.call([*modes, by_f])
        gradient, hessian, slopes = self._machine_curvature.call([*self._at(at, held), *pull])
        if self._moving:
            into = [self.terms.into_modes.call([column, shapes])[0] for column in ca.horzsplit(slopes)]
            bent = [self.terms.bent.call([change, omega_squared, same, f, by_f, alpha])[0] for change in into]
            (hessian,) = self._spread.call([hessian, ca.horzcat(*into).T @ ca.horzcat(*bent)])
        return gradient, hessian

    def jacobian(self, x: ca.SX, at: Sequence[Any], held: HeldGraphs) -> Any:
        """∂w/∂x (m, n_x) as a graph, for symbols x of base, posture and p."""
        (terms, y), m = self._terms_by(x), self.plant.n_passive
        modes, by_f = self._modes(held), [self.slopes(held, one)[1] for one in ca.horzsplit(ca.DM.eye(m))]
        pulls = ca.horzcat(*(terms.pull.call([*modes, each])[0] for each in by_f))
        pull = ca.SX.sym("G", *pulls.shape)
        # Forwards by few x, backwards from fewer modes.
        slopes = pull.T @ ca.jacobian(y, x) if x.shape[0] < m else ca.jtimes(y, x, pull, True).T
        return self.of_machine("machine_slopes", [pull], [slopes]).call([*self._at(at, held), pulls])[0]

    def factor_slopes(self, at: Sequence[Any], held: HeldGraphs) -> Any:
        """∂f/∂z (2r m, n_z) as a graph, f column by column."""
        omega_squared, shapes, same, f = self._modes(held)
        columns = [ca.MX.zeros(f.numel(), 1) for _ in range(self._z.shape[0])]
        found = self._machine_jacobian.call(self._at(at, held))[0]
        for k, column in zip(self._moving, ca.horzsplit(found), strict=True):
            (into,) = self.terms.into_modes.call([column, shapes])
            (change,) = self.terms.moved.call([into, omega_squared, same, f])
            columns[k] = ca.MX(ca.vec(change))
        return ca.horzcat(*columns)

    def _modes(self, held: HeldGraphs) -> list[Any]:
        return [held[name] for name in ("omega_squared", "modes", "same", "f")]

    def _begun(self) -> tuple[list[ca.MX], HeldGraphs, ca.MX, ca.MX]:
        """Symbols of all inputs; the parts of held; V and ∂V/∂f."""
        g = self.plant.graph
        sizes = [x.shape[0] for x in (g.base, g.posture, g.p, self.held)]
        *at, held, alpha = symbols = [ca.MX.sym(*x) for x in zip(NAMES, [*sizes, self.plant.n_passive], strict=True)]
        parts = self.parts(held)
        w, by_f = self.slopes(parts, alpha)
        # 1 wherever the machine stands. Without it CasADi would not see that V depends on z, and give 0 for a
        # derivative instead of refusing it.
        here = ca.fmax(1, ca.cos(ca.sum(ca.vertcat(*at[:2]))))
        return symbols, parts, here * ca.dot(alpha, w), by_f

    @structural_property
    def value(self) -> ca.Function:
        """-> V."""
        symbols, _, value, _ = self._begun()
        return _function("value", symbols, {"V": value})

    @structural_property
    def slope(self) -> ca.Function:
        """-> V and ∂V/∂z (n_z,)."""
        symbols, parts, value, by_f = self._begun()
        return _function("slope", symbols, {"V": value, "V_z": self.gradient(symbols[:3], parts, by_f)})

    @structural_property
    def curvature(self) -> ca.Function:
        """-> ∂²V/∂z² (n_z, n_z)."""
        symbols, parts, _, by_f = self._begun()
        return _function("curvature", symbols, {"V_zz": self.hessian(symbols[:3], parts, by_f, symbols[-1])[1]})


def _function(name: str, symbols: list[ca.MX], outputs: dict[str, ca.MX]) -> ca.Function:
    # A symbol without entries, as of a machine without placement, has no name.
    return ca.Function(name, symbols, list(outputs.values()), NAMES, list(outputs), NO_DERIVATIVES)
