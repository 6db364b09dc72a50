"""Runge–Kutta coefficients."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flexopt.foundation.arrays import Array


@dataclass(frozen=True)
class Tableau:
    """A Runge–Kutta method: stages k_i = f(t + c_i h, x + h Σ_j a_ij k_j), step x + h Σ_i b_i k_i.

    Attributes:
        a (s, s), b (s,), c (s,): the coefficients.
    """

    a: Array
    b: Array
    c: Array


def stability_polynomial(tableau: Tableau) -> Array:
    """R of an explicit method, x after a step of ẋ = λ x as R(h λ) times x, its highest power first."""
    coefficients, stage = [1.0], np.ones(len(tableau.b))
    for _ in tableau.b:
        coefficients.append(float(tableau.b @ stage))
        stage = tableau.a @ stage
    return np.array(coefficients[::-1])


def classical() -> Tableau:
    """Kutta's fourth-order method (1901)."""
    a = np.diag([0.5, 0.5, 1.0], -1)
    return Tableau(a, np.array([1.0, 2.0, 2.0, 1.0]) / 6, np.array([0.0, 0.5, 0.5, 1.0]))


def gauss(stages: int = 3) -> Tableau:
    """Gauss–Legendre collocation of order 2s: symmetric, symplectic, |R(iω)| = 1 (Butcher 1964)."""
    nodes, weights = np.polynomial.legendre.leggauss(stages)
    c = (nodes + 1) / 2
    return Tableau(_collocation(c), weights / 2, c)


def radau() -> Tableau:
    """Radau IIA of three stages, order 5: R(−∞) = 0, 1 − |R(iω)| of order ω⁶ (Hairer and Wanner 1996, IV.5)."""
    root = math.sqrt(6)
    a = _collocation(np.array([(4 - root) / 10, (4 + root) / 10, 1.0]))
    return Tableau(a, a[-1], a.sum(axis=1))


def _collocation(c: Array) -> Array:
    """A of the method whose polynomial satisfies the equation at the nodes c."""
    powers = np.vander(c, len(c), increasing=True)
    integrals = np.stack([c ** (k + 1) / (k + 1) for k in range(len(c))], axis=1)
    return np.asarray(integrals @ np.linalg.inv(powers), dtype=np.float64)


def dormand_prince() -> Tableau:
    """The eighth-order formula of DOP853, fixed step (Hairer, Nørsett, Wanner 1993); SciPy's coefficients."""
    from scipy.integrate import DOP853  # noqa: PLC0415  (loads in 0.2 s)

    n = DOP853.n_stages
    return Tableau(np.array(DOP853.A)[:n, :n], np.array(DOP853.B), np.array(DOP853.C)[:n])
