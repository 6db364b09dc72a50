"""The largest robust stability margin ε_max that any controller can give a plant.

In: a plant (A, B, C, D). Out: `RobustMargin` with both Riccati solutions, a bound on the error of ε_max from their
residuals, and how far two independent routes agree.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from flexopt.compiled.extended import digits, rounded
from flexopt.coprime import riccati
from flexopt.coprime.enclosure import factor
from flexopt.coprime.extended import (
    HOPELESS,
    Equation,
    ExactPair,
    TopPairs,
    measured,
    moved_by_rounding,
    solve_pair,
    top_pairs,
)
from flexopt.coprime.guard import guarded
from flexopt.coprime.lyapunov import EPS
from flexopt.coprime.scaling import Scaled, riccati_matrices, scale_for_riccati
from flexopt.coprime.stabilizability import Escape, escaping_modes, growth, raise_escapes
from flexopt.coprime.system import PLANT, Matrix, StateSpace, SystemLike, from_arguments
from flexopt.errors import MarginNotComputed
from flexopt.foundation.arrays import MatrixLike
from flexopt.foundation.boundary import public
from flexopt.foundation.results import Result

RESIDUAL_MAX = 1e-6
# Bounds on the relative error of ε_max: up to which double precision is left at it, and with which it is still told.
GOOD, TOLD = 1e-9, 1e-6
# ε_max of the rigid plant a/s²: a controller that attains it tolerates every plant nearer than this.
RIGID_MARGIN = math.sin(math.pi / 8)
STATES_MAX = 64  # decimals take minutes beyond
DIGITS_MAX = 10  # of numbers that are shown with a bound


@dataclass(frozen=True)
class RobustMargin(Result):
    """ε_max = (1 + λmax(XZ))^(−1/2), between 0 and 1, and what it rests on.

    Attributes:
        epsilon_max: the largest b_{P,K} that a controller K can give.
        X: (n, n), ÃᵀX + XÃ − XGX + H = 0 (or its discrete form), caller's coordinates.
        Z: (n, n), ÃZ + ZÃᵀ − ZHZ + G = 0 (or its discrete form), caller's coordinates.
        residual_x, residual_z: residual of each equation over the sum of its terms, Frobenius norms, scaled plant.
        iterations: doublings; 0 where doubling failed.
        agreement: relative difference of ε_max between doubling and Schur vectors; None where one of them failed.
        condition: bound on the relative change of X and Z per relative change of the scaled plant.
        method: `"doubling"` or `"schur"`, or `"extended"` where both were refined in extended precision.
        error_bound: |ε_max − the exact one of these A, B, C, D| is at most this. It follows from the residuals, in
            extended precision, by the order of solutions of Riccati inequalities; see `flexopt.coprime.enclosure`.
        warnings: sentences on what needs care.

    Example:
        >>> margin = flexopt.robust_margin([[0, 1], [0, 0]], [[0], [1]], [[1, 0]])
        >>> margin.error_bound < 1e-9, margin.method
        (True, 'doubling')
    """

    DOCUMENT = """
    epsilon_max X Z residual_x residual_z iterations agreement condition method error_bound warnings
    """

    epsilon_max: float
    X: Matrix
    Z: Matrix
    residual_x: float
    residual_z: float
    iterations: int
    agreement: float | None
    condition: float
    method: str
    error_bound: float
    warnings: tuple[str, ...] = ()

    @property
    def residuals(self) -> tuple[float, float]:
        """`residual_x` and `residual_z`."""
        return self.residual_x, self.residual_z

    def __float__(self) -> float:
        return self.epsilon_max

    def __repr__(self) -> str:
        agreement = "one route only" if self.agreement is None else f"routes agree to {self.agreement:.1e}"
        lines = [
            f"RobustMargin: ε_max = {with_bound(self.epsilon_max, self.error_bound)}  ({self.X.shape[0]} states, "
            f"{self.method})",
            f"  residuals X {self.residual_x:.1e}, Z {self.residual_z:.1e}; {agreement}; "
            f"condition {self.condition:.1e}",
        ]
        return "\n".join([*lines, *(f"  warning: {w}" for w in self.warnings)])


def with_bound(value: float, bound: float) -> str:
    """A number with as many digits as its bound allows, and a bound that holds for the digits printed."""
    if not (math.isfinite(value) and math.isfinite(bound)):
        return f"{value:.{DIGITS_MAX}g} ± {bound:.1e}"
    places = (
        DIGITS_MAX if bound == 0 else max(1, min(DIGITS_MAX, 1 - math.floor(math.log10(bound / abs(value or 1.0)))))
    )
    text = f"{value:.{places}g}"
    total = bound + abs(float(text) - value)
    # Rounded up, so that the bound holds as printed.
    return f"{text} ± {total * 1.05 + 5e-324:.1e}"


@dataclass(frozen=True, eq=False)
class RiccatiPair:
    """Both Riccati solutions of a scaled plant by one route; `largest` is λmax(XZ), within `bound` of the exact one."""

    X: Matrix
    Z: Matrix
    residual_x: float
    residual_z: float
    largest: float
    iterations: int
    method: str
    bound: float = math.inf

    @property
    def epsilon(self) -> float:
        """(1 + λmax(XZ))^(−1/2)."""
        return 1.0 / math.sqrt(1.0 + self.largest)

    @property
    def error(self) -> float:
        """Bound on the error of `epsilon`."""
        return epsilon_error(self.largest, self.bound)


def epsilon_error(largest: float, bound: float) -> float:
    """Bound on the error of (1 + λ)^(−1/2) for λ = largest ± bound, its rounding included."""
    if not math.isfinite(bound):
        return math.inf
    low = max(largest - bound, 0.0)
    # ε' grows in size towards small λ: the mean value theorem.
    return 0.5 * bound * (1.0 + low) ** -1.5 + 4 * EPS / math.sqrt(1.0 + largest)


@public(checks=PLANT)
@guarded
def robust_margin(
    A: SystemLike,
    B: MatrixLike | None = None,
    C: MatrixLike | None = None,
    D: MatrixLike | None = None,
    *,
    dt: float | None = 0.0,
) -> RobustMargin:
    """The optimal normalized-coprime-factor margin ε_max = sup_K b_{P,K} = (1 + λmax(XZ))^(−1/2).

    With S = I + DᵀD, R = I + DDᵀ, Ã = A − B S⁻¹DᵀC, G = B S⁻¹Bᵀ and H = CᵀR⁻¹C, X and Z are the stabilizing solutions
    of ÃᵀX + XÃ − XGX + H = 0 and ÃZ + ZÃᵀ − ZHZ + G = 0, or in discrete time of X = ÃᵀX(I + GX)⁻¹Ã + H and
    Z = ÃZ(I + HZ)⁻¹Ãᵀ + G. Time and states are scaled first; doubling and Schur vectors are run independently. Where
    the bound that follows from their residuals is above 1e-9 of ε_max, Newton's method with residuals in extended
    precision goes on from them, or doubling in extended precision where neither led to a solution.

    Args:
        A: (n, n); or a whole system (see `state_space`) when B and C are left out.
        B: (n, m).
        C: (p, n).
        D: (p, m), zero when left out.
        dt: sampling period, s; 0 for continuous time.

    Raises:
        InputError: a matrix is not usable (all faults in one message).
        NotStabilizable: within rounding of each element of the plant a mode that does not decay escapes the inputs or
            the outputs (Popov–Belevitch–Hautus test; it is named). Where that is so only within rounding of the largest
            elements, it is said if in extended precision, too, the Riccati equations have no solution, or one with
            ε_max < 1e-12, or one that rounding moves by a tenth or more.
        MarginNotComputed: the bound on the error of ε_max stays above 1e-6 of it.

    Source: Glover and McFarlane, IEEE Transactions on Automatic Control 34(8), 1989; Chu, Fan and Lin, Linear Algebra
    and its Applications 396, 2005, for the doubling.

    Example:
        >>> margin = flexopt.robust_margin([[0, 1], [0, 0]], [[0], [1]], [[1, 0]])  # 1/s²
        >>> round(float(margin), 5)  # sin(π/8)
        0.38268
    """
    system = from_arguments(A, B, C, D, dt, "robust_margin")
    scaled = scale_for_riccati(system)
    pairs = solve_pairs(scaled, "robust_margin")
    best, doubles = pairs[0], [pair for pair in pairs if pair.method != "extended"]
    agreement = abs(doubles[0].epsilon / doubles[1].epsilon - 1.0) if len(doubles) > 1 else None
    F, G, H = riccati_matrices(scaled.system)
    condition = max(
        riccati.condition(F, G, H, best.X, discrete=system.discrete),
        riccati.condition(F.T, H, G, best.Z, discrete=system.discrete),
    )
    return RobustMargin(
        epsilon_max=best.epsilon,
        X=scaled.primal(best.X),
        Z=scaled.dual(best.Z),
        residual_x=best.residual_x,
        residual_z=best.residual_z,
        iterations=max(p.iterations for p in pairs),
        agreement=agreement,
        condition=condition,
        method=best.method,
        error_bound=best.error,
    )


def solve_pairs(scaled: Scaled, call: str) -> list[RiccatiPair]:
    """The pair whose ε_max is told, with its bound, and then what doubling and Schur vectors found otherwise."""
    s = scaled.system
    if s.n_states == 0:
        empty = np.zeros((0, 0))
        return [RiccatiPair(empty, empty, 0.0, 0.0, 0.0, 0, method, 0.0) for method in ("doubling", "schur")]
    found = escaping_modes(scaled)
    raise_escapes(call, scaled, [e for e in found if e.certain])
    F, G, H = riccati_matrices(s)
    pairs: list[RiccatiPair] = []
    doubled = riccati.doubling(F, G, H, discrete=s.discrete)
    if doubled is not None:
        pairs += _accept(F, G, H, doubled[0], doubled[1], s, doubled[2], "doubling")
    X = riccati.subspace(F, G, H, discrete=s.discrete)
    Z = riccati.subspace(F.T, H, G, discrete=s.discrete)
    if X is not None and Z is not None:
        pairs += _accept(F, G, H, X, Z, s, 0, "schur")
    pairs.sort(key=lambda p: (p.residual_x + p.residual_z > 1e-12, p.method != "doubling"))
    with digits():
        return _told(scaled, pairs, call, found)


def _told(scaled: Scaled, pairs: list[RiccatiPair], call: str, doubtful: list[Escape]) -> list[RiccatiPair]:
    """The pairs, before them one whose bound is good enough."""
    equation = Equation.of(scaled.system)
    bounded = [_measured(equation, pair) for pair in pairs]
    bounded.sort(key=lambda p: p.error > GOOD * p.epsilon)
    if bounded and bounded[0].error <= GOOD * bounded[0].epsilon:
        return bounded
    escapes, reason = False, f"its {scaled.system.n_states} states are too many for extended precision"
    if scaled.system.n_states <= STATES_MAX:
        try:
            exact_pair = solve_pair(equation, [(p.X, p.Z) for p in pairs])
            top = top_pairs(exact_pair)
            bounded.insert(0, of_exact(exact_pair, top))
            largest = float(top.values[0])
            escapes = largest > HOPELESS or moved_by_rounding(exact_pair, top) > 0.1 * largest
        except np.linalg.LinAlgError as error:
            escapes, reason = True, str(error)
    if escapes:
        raise_escapes(call, scaled, doubtful)
    bounded.sort(key=lambda p: p.error / p.epsilon)
    if not (bounded and bounded[0].error <= TOLD * bounded[0].epsilon):
        raise MarginNotComputed(
            f"{call}: ε_max could not be computed to {TOLD:g}, in extended precision neither ({reason}); the plant's "
            "numbers are too far apart. This says nothing about whether a controller stabilises it",
            violations={},
            iterate={},
        )
    return bounded


def _measured(equation: Equation, pair: RiccatiPair) -> RiccatiPair:
    """The pair with the bound that its residuals, computed in decimals, prove; infinite where they prove none."""
    try:
        bound = measured(equation, pair.X, pair.Z).eigenvalue_bound()
    except np.linalg.LinAlgError:
        return pair
    # λmax(XZ) itself is computed in doubles, from factors of X and Z.
    n, size = pair.X.shape[0], float(np.linalg.norm(pair.X, 2) * np.linalg.norm(pair.Z, 2))
    return replace(pair, bound=bound + 8 * n * EPS * size)


def of_exact(pair: ExactPair, top: TopPairs) -> RiccatiPair:
    """A pair in decimals as doubles, with its bound."""
    X, Z, largest = rounded(pair.x.X), rounded(pair.z.X), float(top.values[0])
    bound = pair.eigenvalue_bound() + top.residual
    return RiccatiPair(X, Z, pair.x.relative_residual, pair.z.relative_residual, largest, 0, "extended", bound)


def _accept(
    F: Matrix, G: Matrix, H: Matrix, X: Matrix, Z: Matrix, s: StateSpace, iterations: int, method: str
) -> list[RiccatiPair]:
    """The pair after Newton steps, in a list; an empty list where it is not stabilizing."""
    try:
        x, rx = riccati.refine(F, G, H, X, discrete=s.discrete)
        z, rz = riccati.refine(F.T, H, G, Z, discrete=s.discrete)
        loops = [
            riccati.closed_loop(F, G, x, discrete=s.discrete),
            riccati.closed_loop(F.T, H, z, discrete=s.discrete),
        ]
        if not (rx <= RESIDUAL_MAX and rz <= RESIDUAL_MAX):
            return []
        if any(growth(complex(v), discrete=s.discrete) >= 0 for loop in loops for v in np.linalg.eigvals(loop)):
            return []
        largest = float(np.linalg.norm(factor(x) @ factor(z).T, 2)) ** 2
    except np.linalg.LinAlgError:
        return []
    return [RiccatiPair(x, z, rx, rz, largest, iterations, method)] if math.isfinite(largest) else []
