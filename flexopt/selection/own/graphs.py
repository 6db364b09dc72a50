"""An own Function as one of placement, posture and parameters: values, exact slopes and second derivatives.

By the chain rule: U = cᵀ f(u), u the quantities that f names, among them w. ∂U/∂z = Σ f_i ∂u_i/∂z, with f_w the pulls
at w: where w_i has a kink, f_w is what its cone weighs. Derivatives of f are CasADi's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from flexopt.foundation.arrays import Vector
from flexopt.foundation.kept import Structural, structural_property
from flexopt.model.own import OwnFunction
from flexopt.plant.statics import left_over
from flexopt.robustness.expansion import NO_DERIVATIVES
from flexopt.robustness.measures import SOLVE_TOLERANCE, Measures
from flexopt.selection.own.quantities import KnownQuantity, Sight, known_quantities
from flexopt.selection.own.reading import wrong_slopes

# Inputs of the Functions: `held` is that of `Expansion`, `static` the static deflection where gravity is left out of
# the measures, c (k,) weighs the entries of f, and `left` (m,) has 1 where a mode's pull is left out of derivatives.
INPUTS = ("base", "posture", "p", "held", "static", "c", "left")


@dataclass(frozen=True)
class OwnGraphs(Structural):
    """An own Function f (k,) for a machine. m modes, z = [base, posture].

    No Function can be differentiated by CasADi, to which what is held would be constant: ask for the next one.

    Attributes:
        measures: of the machine, controller and gravity option.
        own: f.
    """

    measures: Measures
    own: OwnFunction

    @structural_property
    def quantities(self) -> tuple[KnownQuantity, ...]:
        """What f takes, in its order."""
        known = known_quantities(self.measures.plant.machine)
        return tuple(known[name] for name in self.own.function.name_in())

    @property
    def size(self) -> int:
        """Number of entries of f, k."""
        return int(self.own.function.numel_out(0))

    @property
    def takes_w(self) -> bool:
        """Whether any w_i takes part."""
        return any(quantity.modes for quantity in self.quantities)

    @property
    def takes_frequencies(self) -> bool:
        """Whether frequencies do, which have no derivatives of their own where two are equal."""
        return any(quantity.modal and not quantity.modes for quantity in self.quantities)

    @property
    def _z(self) -> ca.SX:
        return ca.vertcat(*self.measures.inputs[:2])

    @structural_property
    def _own_static(self) -> bool:
        return not self.measures.gravity and any(quantity.static for quantity in self.quantities)

    @structural_property
    def static(self) -> ca.Function:
        """(base, posture, p) -> static deflection (m,), where it is needed and `held` has none; no derivative.

        NaN where the machine does not stand.
        """
        plant, at = self.measures.plant, self.measures.inputs
        base, posture, p = at
        found = ca.SX(0, 1)
        if self._own_static:
            m, found = plant.n_passive, plant.deflected(base, posture, p)
            point = plant.operating_point(base, posture, p, found)
            pivots = ca.ldl(ca.densify(point.stiffness[:m, :m]))[0]
            settled = left_over(plant, point.q, point.static_residual) <= SOLVE_TOLERANCE
            stands = ca.logic_and(settled, ca.mmin(pivots) > 0)
            found = ca.if_else(stands, found, ca.SX.nan(m, 1))
        options = {"is_diff_out": [False], "never_inline": True}
        return ca.Function("static", at, [found], list(INPUTS[:3]), ["static"], options)

    @structural_property
    def _explicit(self) -> tuple[list[ca.SX], ca.SX]:
        """Symbols of base, posture, p, held and static; and the quantities but w as one graph of them."""
        expansion = self.measures.expansion
        own = ca.SX.sym("static", self.static.size1_out(0))
        sight = Sight(self.measures, expansion.held_parts["deflection"] if self.measures.gravity else own)
        parts = [ca.vec(ca.densify(each.graph(sight))) for each in self.quantities if each.graph is not None]
        return [*self.measures.inputs, expansion.held, own], ca.vertcat(ca.SX(0, 1), *parts)

    def _inner(self, name: str, more: Sequence[ca.SX], output: ca.SX) -> ca.Function:
        return ca.Function(name, [*self._explicit[0], *more], [ca.densify(output)], {"cse": True})

    @structural_property
    def _inner_value(self) -> ca.Function:
        return self._inner("quantities", [], self._explicit[1])

    @structural_property
    def _inner_slope(self) -> ca.Function:
        return self._inner("quantity_slopes", [], ca.jacobian(self._explicit[1], self._z))

    @structural_property
    def _inner_curvature(self) -> ca.Function:
        pull = ca.SX.sym("pull", self._explicit[1].shape[0])
        bent = ca.hessian(ca.dot(pull, self._explicit[1]), self._z)[0]
        return self._inner("quantity_curvature", [pull], bent)

    @structural_property
    def _w_slope(self) -> ca.Function:
        """(base, posture, p, held) -> ∂w/∂z (m, n_z)."""
        expansion, held = self.measures.expansion, ca.MX.sym("held", self.measures.expansion.held.shape[0])
        at = [ca.MX.sym(name, x.shape[0]) for name, x in zip(INPUTS, self.measures.inputs, strict=False)]
        slopes: ca.MX = expansion.jacobian(self._z, at, expansion.parts(held))
        return ca.Function("w_slopes", [*at, held], [ca.densify(slopes)])

    # The Function itself, of the quantities but w as one vector, and of w.

    @structural_property
    def _outer(self) -> tuple[ca.MX, ca.MX, ca.MX, ca.MX]:
        """Symbols of the quantities, u, of w and of c; and f as a graph of u and w."""
        m = self.measures.plant.n_passive if self.takes_w else 0
        u, w, c = ca.MX.sym("u", self._explicit[1].shape[0]), ca.MX.sym("w", m), ca.MX.sym("c", self.size)
        f: ca.MX = self.own.function.call(self._split(u, w))[0]
        return u, w, c, ca.vec(ca.densify(f))

    def _split(self, u: Any, w: Any) -> list[Any]:
        """The inputs of f, in its order."""
        given, first = list[Any](), 0
        for quantity in self.quantities:
            given.append(w[list(quantity.modes), :] if quantity.modes else u[first : first + quantity.size, :])
            first += 0 if quantity.modes else quantity.size
        return given

    @structural_property
    def _outer_value(self) -> ca.Function:
        """(u, w, c) -> f (k,)."""
        u, w, c, f = self._outer
        return _quick("own", [u, w, c], [f])

    @structural_property
    def _outer_slope(self) -> ca.Function:
        """(u, w, c) -> cᵀ f, its slopes by u and by w."""
        u, w, c, f = self._outer
        total = ca.dot(c, f)
        slopes = [ca.densify(ca.gradient(total, u)), ca.densify(ca.gradient(total, w))]
        return _quick("own_slopes", [u, w, c], [total, *slopes])

    @structural_property
    def _outer_curvature(self) -> ca.Function:
        """(u and w, c) -> second derivatives of cᵀ f by both, one below the other."""
        u, w, c, f = self._outer
        both = ca.MX.sym("both", u.shape[0] + w.shape[0])
        values = ca.Function("f", [u, w, c], [f]).call([both[: u.shape[0]], both[u.shape[0] :], c])[0]
        second = ca.hessian(ca.dot(c, values), both)[0]
        return _quick("own_curvature", [both, c], [ca.densify(second)])

    # Both together.

    @structural_property
    def _begun(self) -> tuple[dict[str, ca.MX], ca.MX, ca.MX]:
        """Symbols of all inputs by name; u and w as graphs of them."""
        m, sizes = self.measures.plant.n_passive, [x.shape[0] for x in self._explicit[0]]
        s = {name: ca.MX.sym(name, size) for name, size in zip(INPUTS, [*sizes, self.size, m], strict=True)}
        at = [s[name] for name in INPUTS[:5]]
        return s, self._inner_value.call(at)[0], self._w(s)

    def _w(self, s: dict[str, ca.MX]) -> ca.MX:
        expansion = self.measures.expansion
        if not self.takes_w:
            return ca.MX(0, 1)
        return expansion.slopes(expansion.parts(s["held"]), ca.DM.ones(self.measures.plant.n_passive))[0]

    def _pulls(self) -> list[Any]:
        s, u, w = self._begun
        return list[Any](self._outer_slope.call([u, w, s["c"]]))

    @structural_property
    def values(self) -> ca.Function:
        """-> f (k,)."""
        s, u, w = self._begun
        return _function("own_values", s, {"f": self._outer_value.call([u, w, s["c"]])[0]})

    @structural_property
    def value(self) -> ca.Function:
        """-> U."""
        s, _, _ = self._begun
        return _function("own_value", s, {"U": self._pulls()[0]})

    @structural_property
    def slope(self) -> ca.Function:
        """-> U, ∂U/∂z (n_z,), and the pulls f_w (m,)."""
        s, _, _ = self._begun
        value, by_u, by_w = self._pulls()
        at = [s[name] for name in INPUTS[:5]]
        slope = self._inner_slope.call(at)[0].T @ by_u
        pulls = ca.MX.zeros(self.measures.plant.n_passive, 1)
        if self.takes_w:
            pulls = by_w
            slope += self.measures.expansion.slope.call([*at[:4], pulls * (1 - s["left"])])[1]
        return _function("own_slope", s, {"U": value, "U_z": slope, "U_w": pulls})

    @structural_property
    def curvature(self) -> ca.Function:
        """-> ∂²U/∂z² (n_z, n_z)."""
        s, u, w = self._begun
        _, by_u, by_w = self._pulls()
        at = [s[name] for name in INPUTS[:5]]
        rows: list[ca.MX] = list[Any](self._inner_slope.call(at))
        second: Any = self._inner_curvature.call([*at, by_u])[0]
        if self.takes_w:
            second += self.measures.expansion.curvature.call([*at[:4], by_w * (1 - s["left"])])[0]
            rows += list[Any](self._w_slope.call(at[:4]))
        slopes = ca.vertcat(*rows)
        bent: Any = self._outer_curvature.call([ca.vertcat(u, w), s["c"]])[0]
        return _function("own_curvature", s, {"U_zz": second + slopes.T @ bent @ slopes})

    # The same of placement and posture alone: the iterations are in it.

    def _whole(self, function: ca.Function) -> ca.Function:
        s = {name: x for name, x in self._begun[0].items() if name not in INPUTS[3:5]}
        at, names = [s[name] for name in INPUTS[:3]], list(s)
        inputs = [*at, *self.held_at(at), s["c"], s["left"]]
        return ca.Function(f"{function.name()}_at", list(s.values()), function.call(inputs), names, function.name_out())

    def wrong_slopes(self, bases: Vector, postures: Vector) -> str | None:
        """A sentence where derivatives that f brings are not those of its values, at points (n_b, N), (n, N)."""
        s, u, w = self._begun
        both = self._whole(_function("quantities", s, {"u": u, "w": w}))
        found = both.call([bases, postures, self.measures.plant.parameter_values, [1.0] * self.size, self.left()])
        return wrong_slopes(self.own, [x.full() for x in self._split(*found)])

    def left(self, term: OwnTerm | None = None) -> list[float]:
        """The mask of what a term leaves out, (m,)."""
        left = () if term is None else term.left
        return [float(i in left) for i in range(self.measures.plant.n_passive)]

    def held_at(self, at: Sequence[Any]) -> list[Any]:
        """`held` and `static` at base, posture and p."""
        needed = self.measures.gravity or any(quantity.modal for quantity in self.quantities)
        held = self.measures.hold.call(list(at))[0] if needed else ca.DM.zeros(*self._explicit[0][3].shape)
        return [held, self.static.call(list(at))[0]]

    @structural_property
    def values_at(self) -> ca.Function:
        """(base, posture, p, c, left) -> f (k,)."""
        return self._whole(self.values)

    @structural_property
    def slope_at(self) -> ca.Function:
        """(base, posture, p, c, left) -> U, ∂U/∂z (n_z,), and the pulls f_w (m,)."""
        return self._whole(self.slope)


@dataclass(frozen=True)
class OwnTerm:
    """U = sign · f_row, a term of an objective.

    Attributes:
        own: f;  row: its entry;  sign: 1 or −1.
        left: numbers of the modes whose pull is left out of derivatives.
    """

    own: OwnFunction
    row: int = 0
    sign: float = 1.0
    left: tuple[int, ...] = field(default=())

    def weights(self) -> list[float]:
        """The c of `OwnGraphs`."""
        return [self.sign if k == self.row else 0.0 for k in range(int(self.own.function.numel_out(0)))]


def _quick(name: str, symbols: list[ca.MX], outputs: list[ca.MX]) -> ca.Function:
    """A Function, written out where CasADi can: not where it calls what has no graph, such as an interpolant."""
    function = ca.Function(name, symbols, outputs)
    try:
        return function.expand()
    except RuntimeError:
        return function


def _function(name: str, symbols: dict[str, ca.MX], outputs: dict[str, Any]) -> ca.Function:
    # Without this CasADi would not see that what is held depends on z, and give 0 for a derivative.
    here = ca.fmax(1, ca.cos(ca.sum(ca.vertcat(symbols["base"], symbols["posture"]))))
    dense: list[ca.MX] = [ca.densify(here * output) for output in outputs.values()]
    return ca.Function(name, list(symbols.values()), dense, list(symbols), list(outputs), NO_DERIVATIVES)
