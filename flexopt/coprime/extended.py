"""The pair of Riccati equations beyond double precision, with a proven bound on the error.

In: a scaled plant, and approximate solutions if there are some. Out: X and Z to some thirty digits, the largest
eigenvalues of XZ with their vectors, and the adjoint Lyapunov solutions that gradients are made of.

Residuals are computed in decimals, corrections in doubles, which gains ten digits at each step; where doubles cannot
solve for the corrections, decimals do.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal, getcontext
from functools import cached_property

import numpy as np

from flexopt.compiled.extended import Exact, exact, largest, rounded
from flexopt.coprime.decimals import cholesky, solve, symmetric, symmetric_eigen, unit
from flexopt.coprime.enclosure import Enclosure, eigenvalue_bound, enclose, factor
from flexopt.coprime.lyapunov import EPS, ExactLyapunov, Lyapunov, NotConverged
from flexopt.coprime.system import Matrix, StateSpace

STEPS = 12
DOUBLINGS = 150
# Share of the digits carried to which residuals and corrections are brought.
SHARE = 0.7
# A relative residual that is good enough where the goal is not reached.
FAIR = 1e-25
# Corrections of vectors and adjoint solutions go no further than this, relative, where the bounds allow it.
ENOUGH = 1e-20
HOPELESS = 1e24  # λmax(XZ) beyond this puts ε_max below 1e-12, where rounding of the data decides
# Eigenvalues of XZ within this of one another, downwards from the first, are found together.
TOGETHER = 0.9


@dataclass(frozen=True, eq=False)
class Equation:
    """FᵀX + XF − XGX + H = 0, or X = FᵀX(I + GX)⁻¹F + H, with G = BBᵀ and H = CᵀC, in decimals."""

    F: Exact
    B: Exact
    C: Exact
    discrete: bool = False

    @classmethod
    def of(cls, s: StateSpace) -> Equation:
        """The equation of a plant, with S = I + DᵀD and R = I + DDᵀ taken into B, C and F."""
        A, B, C, D = (exact(M) for M in (s.A, s.B, s.C, s.D))
        if not np.any(s.D):
            return cls(A, B, C, s.discrete)
        S, R = cholesky(unit(D.shape[1]) + D.T @ D), cholesky(unit(D.shape[0]) + D @ D.T)
        return cls(A - B @ solve(S.T, solve(S, D.T @ C)), solve(S, B.T).T, solve(R, C), s.discrete)

    @property
    def dual(self) -> Equation:
        """The equation of Z."""
        return Equation(self.F.T, self.C.T, self.B.T, self.discrete)

    def residual(self, X: Exact) -> tuple[Exact, float]:
        """What the equation leaves over, and the size of its terms."""
        H, XB = self.C.T @ self.C, X @ self.B
        if self.discrete:
            FXB = self.F.T @ XB
            inner = unit(self.B.shape[1]) + self.B.T @ XB
            terms = [symmetric(self.F.T @ X @ self.F), -symmetric(FXB @ solve(inner, FXB.T)), -X, H]
        else:
            XF = X @ self.F
            terms = [XF + XF.T, -(XB @ XB.T), H]
        return sum(terms[1:], terms[0]), sum(largest(term) for term in terms)

    def loop(self, X: Exact) -> Exact:
        """F − GX, or (I + GX)⁻¹F."""
        BX = self.B.T @ X
        if self.discrete:
            return self.F - self.B @ solve(unit(self.B.shape[1]) + BX @ self.B, BX @ self.F)
        return self.F - self.B @ BX


@dataclass(frozen=True, eq=False)
class Solution:
    """A stabilizing X of one equation.

    Attributes:
        equation, X, loop: what it solves, itself, and its closed loop.
        lyapunov: solver of the closed loop's Lyapunov equations.
        residual, relative_residual: bounds on what is left over, 2-norm, and relative to the equation's terms.
        off: how far the loop may be from the one that `lyapunov` is made of, 2-norm.
    """

    equation: Equation
    X: Exact
    loop: Exact
    lyapunov: Lyapunov
    residual: float
    relative_residual: float

    off: float

    @cached_property
    def plain(self) -> Matrix:
        """X in doubles."""
        return rounded(self.X)

    @cached_property
    def root(self) -> Matrix:
        """R with RᵀR = X, in doubles."""
        return factor(self.plain)

    def enclosure(self) -> Enclosure:
        """Proven bounds on the exact solution; `NotConverged` where there are none."""
        e = self.equation
        return enclose(self.loop, e.B, self.residual, self.lyapunov, self.off, discrete=e.discrete)

    def adjoint(self, Q: Exact, target: float) -> tuple[Exact, float]:
        """P of A_x P + P A_xᵀ + Q = 0 for the closed loop A_x, and how far it may be off, relative.

        That is a bound from what the equation leaves over, where there is one that meets `target`, or else the last
        correction.
        """
        found, error, correction = Q * Decimal(0), Q, math.inf
        for _ in range(STEPS):
            step, left = self.lyapunov.corrected(error, transposed=True, off=self.off)
            size = largest(found + step) or 1.0
            before, correction = correction, largest(step) / size
            if not correction < 0.5 * before:
                break
            found = found + step
            if correction <= target:
                break
            if (bound := left * self.lyapunov.inverse_norm / size) <= target:
                return found, bound
            AP = self.loop @ found
            error = AP @ self.loop.T - found + Q if self.equation.discrete else AP + AP.T + Q
        return found, correction


def goal() -> float:
    """Where residuals and corrections, relative, are small enough at the precision set."""
    return 10.0 ** -(SHARE * getcontext().prec)


def newton(equation: Equation, X: Exact, *, steps: int = STEPS, in_decimals: bool = False) -> Solution:
    """Newton's method (Kleinman 1968, Hewer 1971) from a stabilizing X, as long as each step halves the residual.

    In continuous time a step E leaves Ric(X + E) = [Ric(X) + A_xᵀE + EA_x] − EGE, which is bounded in doubles: where
    that is small enough it is not computed.

    Raises:
        NotConverged: X does not stabilise.
    """
    best: Solution | None = None
    current = X
    width = float(np.linalg.norm(rounded(equation.B)))
    for count in range(steps + 1):
        residual, size = equation.residual(current)
        relative = largest(residual) / size if size > 0 else 0.0
        if best is not None and not relative < 0.5 * best.relative_residual:
            break
        loop = equation.loop(current)
        try:
            if in_decimals:
                lyapunov, off = ExactLyapunov(loop, discrete=equation.discrete), 0.0
            else:
                lyapunov = Lyapunov(rounded(loop), discrete=equation.discrete)
                off = EPS * float(np.linalg.norm(lyapunov.A))
        except NotConverged:
            if best is None:
                raise
            break
        total = max((float(sum(map(abs, row))) for row in residual.tolist()), default=0.0)
        best = Solution(equation, current, loop, lyapunov, total, relative, off)
        if relative <= goal() or count == steps:
            break
        step, left = lyapunov.corrected(residual, transposed=False, off=off)
        current = current + step
        bent = 1.01 * float(np.linalg.norm(rounded(step @ equation.B)))
        left, off = left + bent**2, off + bent * width
        if left <= goal() * size:
            return Solution(equation, current, equation.loop(current), lyapunov, left, left / size, off)
    assert best is not None
    return best


def refine(equation: Equation, X: Exact) -> Solution:
    """`newton` in doubles, and in decimals where that is not enough.

    Raises:
        NotConverged: X does not stabilise, or the residual stays above 1e-25 of the terms.
    """
    start = X
    try:
        found = newton(equation, X)
        start = found.X
        if found.relative_residual <= FAIR:
            return found
    except NotConverged:
        pass
    found = newton(equation, start, in_decimals=True)
    if not found.relative_residual <= FAIR:
        raise NotConverged("Newton's method stopped early")
    return found


def doubled(equation: Equation) -> tuple[Exact, Exact]:
    """X and Z by doubling in decimals, see `riccati.doubling`.

    The iterates H_k and G_k grow towards X and Z in the order of symmetric matrices, so λmax(H_k G_k), at least
    trace(H_k G_k)/n, is a lower bound on λmax(XZ): once it passes 1e24, ε_max < 1e-12 is proven.

    Raises:
        NotConverged: after `DOUBLINGS` steps; `hopeless` where that bound was passed.
    """
    n = equation.F.shape[0]
    a, g, h = equation.F, equation.B @ equation.B.T, equation.C.T @ equation.C
    eye = unit(n)
    if not equation.discrete:
        A, G, H = (rounded(M) for M in (a, g, h))
        moduli = np.abs(np.linalg.eigvals(np.block([[A, -G], [-H, -A.T]])))
        kept = moduli[moduli > 1e-12 * moduli.max(initial=0.0)]
        # Irregular, so that no eigenvalue of the plant is met.
        gamma = Decimal(1.371 * math.sqrt(kept.min() * kept.max()) if kept.size else 1.0)
        resolvent = solve(a - eye * gamma, eye)
        w = solve((a - eye * gamma).T + h @ resolvent @ g, eye)
        start_g, start_h = resolvent @ g @ w, w @ h @ resolvent
        a, g, h = eye + w.T * (2 * gamma), symmetric(start_g) * (2 * gamma), symmetric(start_h) * (2 * gamma)
    for _ in range(DOUBLINGS):
        solved = solve(eye + g @ h, np.concatenate([a, g], axis=1))
        wa, wg = solved[:, :n], solved[:, n:]
        more_g, more_h = symmetric(a @ wg @ a.T), symmetric(a.T @ h @ wa)
        a, g, h = a @ wa, g + more_g, h + more_h
        bound = float(np.sum(h * g)) / n
        if bound > HOPELESS:
            raise NotConverged("ε_max is below 1e-12", hopeless=True)
        if not math.isfinite(bound):
            break
        if largest(more_g) <= goal() * largest(g) and largest(more_h) <= goal() * largest(h):
            return h, g
    raise NotConverged("doubling does not converge")


@dataclass(frozen=True, eq=False)
class ExactPair:
    """Both solutions, and bounds on them."""

    x: Solution
    z: Solution
    within_x: Enclosure
    within_z: Enclosure

    @property
    def residual(self) -> float:
        """The larger relative residual."""
        return max(self.x.relative_residual, self.z.relative_residual)

    def gradient_error(self, top: TopPairs) -> float:
        """How far X, Z and the vectors may put off the adjoint solutions, relative, to first order."""
        worst = 0.0
        gap = float(abs(top.values[0] - top.values[1])) or 1e-300
        for s, within in ((self.x, self.within_x), (self.z, self.within_z)):
            X, B = s.plain, rounded(s.equation.B)
            off = within.delta * float(np.linalg.norm(within.W))
            bent = float(np.linalg.norm(within.W)) * float(np.linalg.norm(B)) ** 2
            worst += off * (bent + (1.0 + float(top.values[0]) / gap) / max(float(np.linalg.norm(X)), 1e-300))
        return worst + top.correction

    def eigenvalue_bound(self) -> float:
        """How far λmax of the exact XZ may lie from that of the product of these."""
        return eigenvalue_bound(self.x.root, self.z.root, self.within_x, self.within_z)


def measured(equation: Equation, X: Matrix, Z: Matrix) -> ExactPair:
    """Solutions in doubles as they are, with their bounds; `NotConverged` where nothing is proven."""
    return _bounded(newton(equation, exact(X), steps=0), newton(equation.dual, exact(Z), steps=0))


def solve_pair(equation: Equation, starts: Iterable[tuple[Matrix, Matrix]]) -> ExactPair:
    """The pair from the first of `starts` that leads to one, else by doubling in decimals.

    Raises:
        NotConverged: there is none about which anything could be proven.
    """
    for X, Z in starts:
        try:
            return _bounded(refine(equation, exact(X)), refine(equation.dual, exact(Z)))
        except np.linalg.LinAlgError:
            continue
    try:
        primal, dual = doubled(equation)
        return _bounded(refine(equation, primal), refine(equation.dual, dual))
    except NotConverged:
        raise
    except np.linalg.LinAlgError as error:
        raise NotConverged(str(error)) from None


def _bounded(x: Solution, z: Solution) -> ExactPair:
    return ExactPair(x, z, x.enclosure(), z.enclosure())


@dataclass(frozen=True, eq=False)
class Seeds:
    """Derivatives of an eigenvalue of XZ by F, B and C; the sums of the absolute values of their terms.

    `correction` is how far the adjoint solutions may be off, relative.
    """

    F: Exact
    B: Exact
    C: Exact
    sizes: tuple[Matrix, Matrix, Matrix]
    correction: float


def seeds(pair: ExactPair, value: Decimal, first: Exact, second: Exact, target: float) -> Seeds:
    """Derivatives of rᵀZ(XZ)r at fixed r = `first` = `second`, by two adjoint Lyapunov equations.

    With X Z r = λ r, rᵀZr = 1, l = Z r it is dλ = lᵀ dX l + λ rᵀ dZ r = tr(P_x dRic_x) + tr(P_z dRic_z) with X, Z, P
    held, where A_x P_x + P_x A_xᵀ = −l lᵀ and A_z P_z + P_z A_zᵀ = −λ r rᵀ (the discrete case likewise). For two
    vectors the symmetric part of r_1 r_2ᵀ takes the place of r rᵀ: the derivative's element off the diagonal.
    """
    x, z = pair.x, pair.z
    e, X, Z = x.equation, x.X, z.X
    both = symmetric(np.multiply.outer(first, second))
    ahead = symmetric(np.multiply.outer(Z @ first, Z @ second))
    P_x, wrong_x = x.adjoint(ahead, target)
    P_z, wrong_z = z.adjoint(both * value, target)
    XP, ZP = (X @ x.loop @ P_x, Z @ z.loop @ P_z) if e.discrete else (X @ P_x, Z @ P_z)
    if e.discrete:
        XPX, ZPZ = XP @ x.loop.T @ X, ZP @ z.loop.T @ Z
        by_b, by_c = -2 * (XPX @ e.B) + 2 * (P_z @ e.B), 2 * (e.C @ P_x) - 2 * (e.C @ ZPZ)
    else:
        by_b = -2 * (XP @ (X @ e.B)) + 2 * (P_z @ e.B)
        by_c = 2 * (e.C @ P_x) - 2 * ((e.C @ ZP) @ Z)
    x_abs, z_abs, a, b, c, d = (np.abs(M) for M in (x.plain, z.plain, *map(rounded, (P_x, P_z, e.B, e.C))))
    if e.discrete:
        x_abs, z_abs = x_abs @ np.abs(rounded(x.loop)), z_abs @ np.abs(rounded(z.loop))
    xp, zp = x_abs @ a, z_abs @ b
    sizes = 2 * (xp + zp.T), 2 * (xp @ (x_abs.T @ c) + b @ c), 2 * (d @ a + d @ zp @ z_abs.T)
    return Seeds(2 * (XP + ZP.T), by_b, by_c, sizes, max(wrong_x, wrong_z))


def moved_by_rounding(pair: ExactPair, top: TopPairs) -> float:
    """How far λmax(XZ) moves, to first order, where every element of F, B and C changes by 8 n ε of itself."""
    found = seeds(pair, top.values[0], top.vectors[:, 0], top.vectors[:, 0], goal())
    e = pair.x.equation
    products = ((found.F, e.F), (found.B, e.B), (found.C, e.C))
    return 8 * len(e.F) * EPS * sum(float(np.sum(np.abs(seed * given))) for seed, given in products)


@dataclass(frozen=True, eq=False)
class TopPairs:
    """The two largest eigenvalues of XZ and their vectors.

    Attributes:
        values: λ_1 ≥ λ_2; λ_2 = 0 where there is one state only.
        vectors: R (n, 2) as columns, RᵀZR = I; (n, 1) where there is one state only.
        residual: |XZ r_1 − λ_1 r_1| in the norm of Z: a bound on the error of λ_1.
        correction: last correction of the vectors, relative.
    """

    values: tuple[Decimal, Decimal]
    vectors: Exact
    residual: float
    correction: float


def top_pairs(pair: ExactPair, target: float | None = None) -> TopPairs:
    """By Newton steps on the span of all eigenvectors near the top, and the small problem within it.

    Where several eigenvalues nearly meet, only their span is well defined in doubles.
    """
    target = goal() if target is None else target
    X, Z, plain_x, plain_z = pair.x.X, pair.z.X, pair.x.plain, pair.z.plain
    n = X.shape[0]
    Rx, Rz = pair.x.root, pair.z.root
    left, sigma, _ = np.linalg.svd(Rx @ Rz.T)
    lambdas = sigma**2
    count = min(n, 2)
    while count < n and lambdas[count] > TOGETHER * lambdas[count - 1]:
        count += 1
    span, correction = exact(Rx.T @ left[:, :count]), math.inf
    while True:
        span, values, ZV, XZV = _ritz(X, Z, span)
        residual = XZV - span * values
        step = np.full(span.shape, Decimal(0), dtype=object)
        border = rounded(ZV / Decimal(largest(ZV)))
        scale = largest(values)
        for i in range(count):
            size = largest(residual[:, i])
            if size > 0:
                inner = (plain_x @ plain_z - float(values[i]) * np.eye(n)) / scale
                matrix = np.block([[inner, border], [border.T, np.zeros((count, count))]])
                right = np.append(rounded(residual[:, i] / Decimal(size)), np.zeros(count))
                step[:, i] = exact(np.linalg.solve(matrix, -right)[:n]) * Decimal(size / scale)
        before, correction = correction, max(largest(step[:, i]) / largest(span[:, i]) for i in range(min(2, count)))
        # The next step is how far these vectors are off.
        if correction <= target or not correction < 0.5 * before:
            break
        span = span + step
    first = residual[:, 0]
    residual_norm = float(abs(first @ (Z @ first)).sqrt())
    return TopPairs((values[0], values[1] if count > 1 else Decimal(0)), span[:, :2], residual_norm, correction)


def _ritz(X: Exact, Z: Exact, V: Exact) -> tuple[Exact, Exact, Exact, Exact]:
    """Ritz vectors of XZ within the span of V, orthonormal in Z, Ritz values, descending, and Z and XZ times them."""
    ZV = Z @ V
    XZV = X @ ZV
    L = cholesky(symmetric(V.T @ ZV))
    inner = solve(L, solve(L, symmetric(ZV.T @ XZV)).T)
    values, turn = symmetric_eigen(symmetric(inner))
    by = solve(L.T, turn)
    return V @ by, values, ZV @ by, XZV @ by
