"""Modes as graphs that are exact to second order about a known solution: frequencies, damping ratios, a_i, b_i, κ_i.

In: `Expansion`, whose `held` is the solution. Out: SX graphs of its symbols.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from flexopt.algebra.expansion import expanded_vectors
from flexopt.robustness.expansion import Expansion
from flexopt.robustness.residues import rank_one_measure


@dataclass(frozen=True)
class ModalGraphs:
    """Graphs of the symbols of base, posture, p and `held_parts` of an expansion; m modes, r task rows.

    Of modes that share a frequency only sums over them mean something.
    """

    expansion: Expansion

    @cached_property
    def _expanded(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """K_p and M̄ in the axes of the held modes, and what turns these into the modes."""
        held, (stiffness, mass, _) = self.expansion.held_parts, self.expansion.graphs
        modes, squares, m = held["modes"], held["omega_squared"], self.expansion.plant.n_passive
        stiffness, mass = modes.T @ stiffness @ modes, modes.T @ mass @ modes
        changes = expanded_vectors(stiffness - ca.diag(squares), mass - ca.SX.eye(m), squares, held["same"])
        return stiffness, mass, ca.SX.eye(m) + sum(changes, ca.SX(0))

    @cached_property
    def omega(self) -> ca.SX:
        """ω_i (m,), rad/s, by Rayleigh's quotients."""
        stiffness, mass, turned = self._expanded
        return ca.sqrt(ca.diag(turned.T @ stiffness @ turned) / ca.diag(turned.T @ mass @ turned))

    @cached_property
    def shapes(self) -> ca.SX:
        """φ_i (n_q, m), mass-normalised, actuated coordinates last."""
        passive = self.expansion.held_parts["modes"] @ self._expanded[2]
        return ca.vertcat(passive, self.expansion.pencil.follow @ passive)

    @cached_property
    def zeta(self) -> ca.SX:
        """φ_iᵀ D φ_i / (2 ω_i) (m,)."""
        return ca.diag(self.shapes.T @ self.expansion.point.damping @ self.shapes) / (2 * self.omega)

    @cached_property
    def factors(self) -> tuple[ca.SX, ca.SX]:
        """The columns a_i and b_i (r, m) of R_i = a_i b_iᵀ."""
        f = self.expansion.graphs[2] @ self.expansion.held_parts["modes"] @ self._expanded[2]
        r = self.expansion.plant.n_task
        return f[:r, :], f[r:, :]

    @cached_property
    def allowance(self) -> ca.SX:
        """κ_i = 4 ζ_i ω_i / |w_i| (m,), N s/m for transpose control; infinite where no velocity feedback excites it.

        With f = −Kv ṙ, Kv symmetric and positive semidefinite, mode i decays to first order as long as ‖Kv‖ < κ_i.
        """
        a, b = self.factors
        w = ca.vertcat(*(rank_one_measure(a[:, i], b[:, i]) for i in range(a.shape[1])))
        return _over(4 * self.zeta * self.omega, -w)

    @cached_property
    def allowance_isotropic(self) -> ca.SX:
        """2 ζ_i ω_i / (−a_i·b_i) (m,), the same for Kv = kv I; infinite where a_i·b_i ≥ 0."""
        a, b = self.factors
        return _over(2 * self.zeta * self.omega, -ca.sum1(a * b).T)


def _over(x: ca.SX, y: ca.SX) -> ca.SX:
    """X / y where y > 0, else infinite, with derivatives that are finite."""
    above = y > 0
    return ca.if_else(above, x / ca.if_else(above, y, 1), ca.inf)
