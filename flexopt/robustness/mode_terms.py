"""How every w_i, and V = Σ αi wi, move with what modes stand on: derivatives in closed form, knowing no machine.

In: numbers of modes and task rows. Out: Functions of a known solution of K_p φ_i = ω_i² M̄ φ_i: ω², Φ, clusters, and
f = F Φ (2r, m), a_i above b_i. What moves is y = [K_p; M̄; F], of symmetric matrices the upper triangle, column by
column. Modes of simple frequencies are summed in one expression; where frequencies repeat mode by mode, by the
eigenvectors of each cluster's sum, which are held like the modes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca

from flexopt.algebra import called_eigen
from flexopt.algebra.expansion import expanded_vectors
from flexopt.robustness.residues import measure, rank_one_measure, summed_residue


@dataclass(frozen=True)
class ModeTerms:
    """Functions of m modes and r task rows; made by `mode_terms`.

    Inputs: f, `same` (m, m) of clusters, alpha (m,), modes Φ (m, m), omega_squared (m,).

    Attributes:
        r, m: see above.
        stiff: whether K_p is a part of y: where it does not move it is left out.
    """

    r: int
    m: int
    stiff: bool

    def y(self, stiffness: ca.SX, mass: ca.SX, factors: ca.SX) -> ca.SX:
        """From K_p, M̄ (m, m) and F (2r, m) y (n_y,)."""
        symmetric = [stiffness, mass] if self.stiff else [mass]
        return ca.vertcat(*(x[i, j] for x in symmetric for i, j in self._triangle), ca.vec(ca.densify(factors)))

    @cached_property
    def _triangle(self) -> list[tuple[int, int]]:
        return [(i, j) for j in range(self.m) for i in range(j + 1)]

    @cached_property
    def _symbols(self) -> dict[str, ca.SX]:
        r, m = self.r, self.m
        n_y = (len(self._triangle) * (1 + self.stiff)) + 2 * r * m
        shapes = {"f": (2 * r, m), "same": (m, m), "alpha": (m, 1), "omega_squared": (m, 1), "modes": (m, m)}
        shapes |= {"by_f": (2 * r, m), "along": (2 * r, m), "change": (n_y, 1)}
        return {name: ca.SX.sym(name, *shape) for name, shape in shapes.items()}

    def _split(self, y: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Changes of K_p, M̄ and F from one of y."""
        parts: list[ca.SX] = []
        for k in range(1 + self.stiff):
            matrix = ca.SX(self.m, self.m)
            for (i, j), entry in zip(self._triangle, ca.vertsplit(y[k * len(self._triangle) :]), strict=False):
                matrix[i, j] = matrix[j, i] = entry
            parts.append(matrix)
        factors = ca.reshape(y[-2 * self.r * self.m :], 2 * self.r, self.m)
        return parts[0] if self.stiff else ca.SX(self.m, self.m), parts[-1], factors

    @cached_property
    def _in_axes(self) -> ca.SX:
        """Φᵀ dK_p Φ, Φᵀ dM̄ Φ and dF Φ from a change of y, packed alike."""
        phi = self._symbols["modes"]
        stiffness, mass, factors = self._split(self._symbols["change"])
        return self.y(phi.T @ (stiffness @ phi), phi.T @ (mass @ phi), factors @ phi)

    def _function(self, name: str, inputs: tuple[str, ...], output: ca.SX) -> ca.Function:
        return ca.Function(name, [self._symbols[each] for each in inputs], [ca.densify(output)])

    @cached_property
    def factors(self) -> ca.Function:
        """(F, Φ) -> f."""
        f, modes = self._symbols["f"], self._symbols["modes"]
        return ca.Function("factors", [f, modes], [f @ modes])

    @cached_property
    def sizes(self) -> ca.Function:
        """(f) -> |a_i||b_i|, (m,)."""
        f, r = self._symbols["f"], self.r
        return self._function("sizes", ("f",), ca.sqrt(ca.sum1(f[:r, :] ** 2) * ca.sum1(f[r:, :] ** 2)).T)

    @cached_property
    def slopes(self) -> ca.Function:
        """(f, same, alpha) -> w (m,) and ∂V/∂f (2r, m)."""
        return self._of_modes("slopes", [], lambda value: ca.gradient(value, self._symbols["f"]))

    @cached_property
    def second_slopes(self) -> ca.Function:
        """(f, same, alpha, along (2r, m)) -> w (m,) and (∂²V/∂f²) along (2r, m)."""
        f, along = self._symbols["f"], self._symbols["along"]
        return self._of_modes("second_slopes", [along], lambda value: ca.jtimes(ca.gradient(value, f), f, along))

    def _of_modes(self, name: str, more: list[ca.SX], derivative: Callable[[ca.SX], ca.SX]) -> ca.Function:
        """(f, same, alpha, more) -> w and a derivative of V shaped like f."""
        f, same, alpha = (self._symbols[each] for each in ("f", "same", "alpha"))
        a, b, m, options = f[: self.r, :], f[self.r :, :], self.m, {"cse": True}
        w = ca.vertcat(*(rank_one_measure(a[:, i], b[:, i]) for i in range(m)))
        outputs = [w, ca.densify(derivative(ca.dot(alpha, w)))]
        simple = ca.Function(f"simple_{name}", [f, same, alpha, *more], outputs, options)
        if m == 1:
            return simple
        row, vectors = ca.SX.sym("row", 1, m), ca.SX.sym("vectors", self.r, self.r)
        residue, first = summed_residue(a, b, row), measure(a, b, row, vectors)
        symmetric = ca.Function("symmetric_part", [f, row], [residue + residue.T], options)
        outputs = [first, ca.densify(derivative(first))]
        of_first = ca.Function(f"first_{name}", [f, row, vectors, *more], outputs, options)
        given = simple.mx_in()
        values, total = list[ca.MX](), ca.MX.zeros(*f.shape)
        for i in range(m):
            order = [i, *(k for k in range(m) if k != i)]
            turned = [given[0][:, order], given[1][i, order]]
            vectors_i = called_eigen(self.r).call(symmetric.call(turned))[1]
            value, by = of_first.call([*turned, vectors_i, *(x[:, order] for x in given[3:])])
            values.append(value)
            total += given[2][i] * by[:, [order.index(k) for k in range(m)]]
        clustered = ca.Function(f"clustered_{name}", given, [ca.vertcat(*values), total])
        alone = ca.Function("alone", [same], [ca.sum(ca.vec(same)) <= m + 0.5])
        chosen = ca.Function.if_else(name, simple, clustered).call([*alone.call(given[1:2]), *given])
        return ca.Function(name, given, chosen)

    @cached_property
    def pull(self) -> ca.Function:
        """(omega_squared, modes, same, f, ∂V/∂f) -> ∂V/∂y (n_y,)."""
        s = self._symbols
        stiffness, mass, factors = self._split(s["change"])
        first, _ = expanded_vectors(stiffness, mass, s["omega_squared"], s["same"])
        in_axes = ca.gradient(ca.dot(s["by_f"], factors + s["f"] @ first), s["change"])
        by_y = ca.jtimes(self._in_axes, s["change"], in_axes, True)
        return self._function("pull", ("omega_squared", "modes", "same", "f", "by_f"), by_y)

    @cached_property
    def into_modes(self) -> ca.Function:
        """(a change of y, modes) -> it in the axes of the modes, (n_y,), as `bent` takes it."""
        return self._function("into_modes", ("change", "modes"), self._in_axes)

    @cached_property
    def moved(self) -> ca.Function:
        """(change, omega_squared, same, f), the change in the axes of the modes -> how f changes, (2r, m)."""
        s = self._symbols
        stiffness, mass, factors = self._split(s["change"])
        first, _ = expanded_vectors(stiffness, mass, s["omega_squared"], s["same"])
        return self._function("moved", ("change", "omega_squared", "same", "f"), factors + s["f"] @ first)

    @cached_property
    def bent(self) -> ca.Function:
        """(change, omega_squared, same, f, ∂V/∂f, alpha) -> (∂²V/∂y²) change, in the axes of the modes."""
        s, names = self._symbols, ("change", "omega_squared", "same", "f", "by_f")
        stiffness, mass, factors = self._split(s["change"])
        first, second = expanded_vectors(stiffness, mass, s["omega_squared"], s["same"])
        moved = factors + s["f"] @ first
        # V's terms of second degree: linear in C_2, products with C_1, and quadratic in the change of f, of which the
        # derivative is written down.
        terms = ca.dot(s["f"].T @ s["by_f"], second) + ca.dot(factors.T @ s["by_f"], first) + ca.dot(s["along"], moved)
        finish = self._function("terms", (*names, "along"), ca.gradient(terms, s["change"]))
        given: list[Any] = [*finish.mx_in()[: len(names)], ca.MX.sym("alpha", self.m)]
        along = self.second_slopes.call([given[3], given[2], given[5], *self.moved.call(given[:4])])[1]
        return ca.Function("bent", given, finish.call([*given[:5], along]))


@lru_cache(maxsize=64)
def mode_terms(r: int, m: int, *, stiff: bool) -> ModeTerms:
    """The Functions of so many rows and modes (made once, and kept)."""
    return ModeTerms(r, m, stiff)
