"""Lyapunov equations of one stable matrix and many right-hand sides, by Smith's doubling, in doubles or in decimals.

In: A, and Q at each call. Out: P of AᵀP + PA + Q = 0, or P = AᵀPA + Q for sampled time.
"""

from __future__ import annotations

import math
from decimal import Decimal, getcontext
from functools import cached_property
from typing import Any, cast

import numpy as np

from flexopt.compiled.extended import Exact, exact, largest, rounded
from flexopt.coprime.decimals import solve, unit
from flexopt.coprime.system import Matrix

DOUBLINGS = 80
EPS = float(np.finfo(float).eps)


class NotConverged(np.linalg.LinAlgError):
    """An equation was not solved; `hopeless` where that proves that ε_max is below 1e-12."""

    def __init__(self, reason: str, *, hopeless: bool = False) -> None:
        super().__init__(reason)
        self.hopeless = hopeless


class Lyapunov:
    """The powers C, C², C⁴, … of C = (γI + A)(γI − A)⁻¹, or of A itself in sampled time, until they vanish.

    Raises:
        NotConverged: A is not stable.

    Source: Smith, SIAM Journal on Applied Mathematics 16(1), 1968.
    """

    def __init__(self, A: Matrix, *, discrete: bool) -> None:
        finite = bool(np.all(np.isfinite(A)))
        values = np.asarray(np.linalg.eigvals(A if finite else 0 * A), dtype=np.complex128)
        if not finite or not np.all(np.abs(values) < 1 if discrete else np.real(values) < 0):
            raise NotConverged("the closed loop is not stable")
        self.discrete, self.A = discrete, A
        moduli = np.abs(values)
        mean = 0.5 * np.log2(moduli.min() * moduli.max()) if values.size else 0.0
        self.gamma = float(2.0 ** np.round(mean))
        self.powers, self.resolvent = self._powers(A)

    def _powers(self, A: Matrix) -> tuple[list[Matrix], Matrix]:
        eye, gamma = np.eye(A.shape[0]), self.gamma
        resolvent = eye if self.discrete else np.linalg.inv(gamma * eye - A)
        powers = [A if self.discrete else (gamma * eye + A) @ resolvent]
        while (size := float(np.max(np.abs(powers[-1]), initial=0.0))) > 1e-17:
            if len(powers) > DOUBLINGS or not size < 1e150:
                raise NotConverged("the closed loop decays too slowly")
            powers.append(powers[-1] @ powers[-1])
        return powers, resolvent

    def solve(self, Q: Matrix, *, transposed: bool = False) -> Matrix:
        """P (n, n); with `transposed` of AP + PAᵀ + Q = 0, or P = APAᵀ + Q."""
        return self._sum(Q, 2 * self.gamma, transposed=transposed)

    def correct(self, Q: Exact, *, transposed: bool = False) -> Exact:
        """`solve` for a Q in decimals, whose size may be beyond a double's; as good as a double."""
        return self.corrected(Q, transposed=transposed, off=0.0)[0]

    def corrected(self, Q: Exact, *, transposed: bool, off: float) -> tuple[Exact, float]:
        """`correct`, and a bound on the 2-norm of what it leaves of AᵀP + PA + Q; infinite in sampled time.

        The bound is for any A within `off` (2-norm) of the one that the powers are made of.
        """
        size = largest(Q)
        if not size > 0:
            return Q * Decimal(0), 0.0
        exponent = math.frexp(size)[1]
        by, scaled = Decimal(2) ** exponent, abs(exponent) > 600
        right = rounded(Q / by) if scaled else rounded(Q) * 2.0**-exponent
        found = self.solve(right, transposed=transposed)
        if self.discrete:
            return exact(found) * by, math.inf
        A = self.A if transposed else self.A.T
        left = A @ found
        norms = float(np.linalg.norm(found)), float(np.linalg.norm(right))
        rounding = 2 * norms[0] * (off + 8 * (len(A) + 4) * EPS * float(np.linalg.norm(A))) + 8 * EPS * norms[1]
        bound = 1.01 * (float(np.linalg.norm(left + left.T + right)) + rounding)
        if scaled:
            return exact(found) * by, float(Decimal(bound) * by)
        return exact(found * 2.0**exponent), bound * 2.0**exponent

    @cached_property
    def inverse_norm(self) -> float:
        """Bound on ‖P‖ / ‖Q‖ (2-norms) of AP + PAᵀ + Q = 0 for a stable A; infinite where there is none.

        P lies between ±2 ‖Q‖ W where A W + W Aᵀ ≤ −½ I; a quarter of that is left for A that are a little off.
        """
        if self.discrete:
            return math.inf
        W, eye = self.solve(np.eye(len(self.A)), transposed=True), np.eye(len(self.A))
        left = self.A @ W
        rounding = 16 * (len(eye) + 4) * EPS * float(np.linalg.norm(self.A) * np.linalg.norm(W))
        good = float(np.linalg.norm(left + left.T + eye)) + rounding <= 0.25
        return 2 * float(np.linalg.norm(W)) if good else math.inf

    def _sum(self, Q: Any, twice: Any, *, transposed: bool) -> Any:
        found = Q
        if not self.discrete:
            S = self.resolvent if transposed else self.resolvent.T
            found = S @ found @ S.T * twice
        for power in self.powers:
            left = power if transposed else power.T
            found = found + left @ found @ left.T
        return (found + found.T) / 2


def proven_stable(A: Matrix, *, discrete: bool) -> bool:
    """Whether a solution of its Lyapunov equation proves that A (n, n) is stable, all its rounding included."""
    try:
        W = Lyapunov(A, discrete=discrete).solve(np.eye(len(A)))
    except NotConverged:
        return False
    size, rounding = float(np.linalg.norm(A)), 16 * (len(A) + 4) * EPS * float(np.linalg.norm(W))
    left = A.T @ W @ A - W if discrete else A.T @ W + W @ A
    off = float(np.linalg.norm(left + np.eye(len(A)))) + rounding * (size**2 + 1 if discrete else size)
    return off <= 0.25 and bool(np.linalg.eigvalsh(W)[0] > len(A) * EPS * float(np.linalg.norm(W)))


class ExactLyapunov(Lyapunov):
    """The same in decimals."""

    def __init__(self, A: Exact, *, discrete: bool) -> None:
        self.exact = A
        super().__init__(rounded(A), discrete=discrete)

    def _powers(self, A: Matrix) -> tuple[list[Matrix], Matrix]:
        eye, gamma = unit(A.shape[0]), Decimal(self.gamma)
        resolvent = eye if self.discrete else solve(eye * gamma - self.exact, eye)
        powers = [self.exact if self.discrete else (eye * gamma + self.exact) @ resolvent]
        while (size := largest(powers[-1])) > 10.0 ** -getcontext().prec:
            if len(powers) > DOUBLINGS or not size < 1e150:
                raise NotConverged("the closed loop decays too slowly")
            powers.append(powers[-1] @ powers[-1])
        return cast(list[Matrix], powers), cast(Matrix, resolvent)

    def solve(self, Q: Matrix, *, transposed: bool = False) -> Matrix:
        """P, rounded."""
        return rounded(self.correct(exact(Q), transposed=transposed))

    def correct(self, Q: Exact, *, transposed: bool = False) -> Exact:
        """`solve`, in decimals throughout."""
        return self._sum(Q, Decimal(2 * self.gamma), transposed=transposed)

    def corrected(self, Q: Exact, *, transposed: bool, off: float) -> tuple[Exact, float]:  # noqa: ARG002
        """`correct`, no bound."""
        return self.correct(Q, transposed=transposed), math.inf

    @cached_property
    def inverse_norm(self) -> float:
        """No bound."""
        return math.inf
