"""The largest robust stability margin ε_max that any controller can give a plant.

In: a plant (A, B, C, D). Out: `RobustMargin` with both Riccati solutions, their residuals and how far two independent
routes agree.
"""

from __future__ import annotations

import math
import warnings as python_warnings
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from flexopt.coprime import riccati
from flexopt.coprime.guard import guarded
from flexopt.coprime.scaling import Scaled, riccati_matrices, scale_for_riccati
from flexopt.coprime.stabilizability import Escape, escaping_modes, growth, raise_escapes, still_there
from flexopt.coprime.system import PLANT, Matrix, StateSpace, from_arguments
from flexopt.errors import FlexoptWarning, NoSolutionFound
from flexopt.model.boundary import public
from flexopt.model.documents import json_ready

AGREEMENT = 1e-7
RESIDUAL_MAX = 1e-6
HOPELESS = 1e24  # λmax(XZ) beyond this puts ε_max below 1e-12, where rounding decides


@dataclass(frozen=True)
class RobustMargin:
    """ε_max = (1 + λmax(XZ))^(−1/2), between 0 and 1, and what it rests on.

    Attributes:
        epsilon_max: the largest b_{P,K} that a controller K can give.
        X: (n, n), ÃᵀX + XÃ − XGX + H = 0 (or its discrete form), caller's coordinates.
        Z: (n, n), ÃZ + ZÃᵀ − ZHZ + G = 0 (or its discrete form), caller's coordinates.
        residual_x, residual_z: residual of each equation over the sum of its terms, Frobenius norms, scaled plant.
        iterations: doublings; 0 where doubling failed.
        agreement: relative difference of ε_max between doubling and Schur vectors; None where one of them failed.
        condition: bound on the relative change of X and Z per relative change of the scaled plant.
        method: `"doubling"` or `"schur"`, the route whose residuals are smaller.
        warnings: sentences on what needs care.
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
    warnings: tuple[str, ...] = ()

    @property
    def residuals(self) -> tuple[float, float]:
        """`residual_x` and `residual_z`."""
        return self.residual_x, self.residual_z

    def __float__(self) -> float:
        return self.epsilon_max

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready document."""
        names = ("epsilon_max", "X", "Z", "residual_x", "residual_z", "iterations", "agreement", "condition", "method")
        document = {name: getattr(self, name) for name in (*names, "warnings")}
        return cast(dict[str, Any], json_ready(document))

    def __repr__(self) -> str:
        agreement = "one route only" if self.agreement is None else f"routes agree to {self.agreement:.1e}"
        lines = [
            f"RobustMargin: ε_max = {self.epsilon_max:.10g}  ({self.X.shape[0]} states, {self.method})",
            f"  residuals X {self.residual_x:.1e}, Z {self.residual_z:.1e}; {agreement}; "
            f"condition {self.condition:.1e}",
        ]
        return "\n".join([*lines, *(f"  warning: {w}" for w in self.warnings)])


@dataclass(frozen=True, eq=False)
class Pair:
    """Both Riccati solutions of a scaled plant by one route; `largest` is λmax(XZ)."""

    X: Matrix
    Z: Matrix
    residual_x: float
    residual_z: float
    largest: float
    iterations: int
    method: str

    @property
    def epsilon(self) -> float:
        """(1 + λmax(XZ))^(−1/2)."""
        return 1.0 / math.sqrt(1.0 + self.largest)


@public(**PLANT)
@guarded
def robust_margin(A: Any, B: Any = None, C: Any = None, D: Any = None, *, dt: Any = 0.0) -> RobustMargin:
    """The optimal normalized-coprime-factor margin ε_max = sup_K b_{P,K} = (1 + λmax(XZ))^(−1/2).

    With S = I + DᵀD, R = I + DDᵀ, Ã = A − B S⁻¹DᵀC, G = B S⁻¹Bᵀ and H = CᵀR⁻¹C, X and Z are the stabilizing solutions
    of ÃᵀX + XÃ − XGX + H = 0 and ÃZ + ZÃᵀ − ZHZ + G = 0, or in discrete time of X = ÃᵀX(I + GX)⁻¹Ã + H and
    Z = ÃZ(I + HZ)⁻¹Ãᵀ + G. Time and states are scaled first; doubling and Schur vectors are run independently.

    Args:
        A: (n, n); or a whole system (see `state_space`) when B and C are left out.
        B: (n, m).
        C: (p, n).
        D: (p, m), zero when left out.
        dt: sampling period, s; 0 for continuous time.

    Raises:
        InputError: a matrix is not usable (all faults in one message).
        NotStabilizable: a mode that does not decay escapes the inputs or the outputs; it is named.
        NoSolutionFound: neither route ends in a stabilizing solution.

    Warns:
        FlexoptWarning: the routes differ by more than 1e-7, or only one ended in a solution.

    Source: Glover and McFarlane, IEEE Transactions on Automatic Control 34(8), 1989; Chu, Fan and Lin, Linear Algebra
    and its Applications 396, 2005, for the doubling.
    """
    system = from_arguments(A, B, C, D, dt, "robust_margin")
    scaled = scale_for_riccati(system)
    pairs = solve_pairs(scaled, "robust_margin")
    best = pairs[0]
    agreement = abs(pairs[0].epsilon / pairs[1].epsilon - 1.0) if len(pairs) > 1 else None
    sentences = _warnings(agreement, best)
    for sentence in sentences:
        python_warnings.warn(sentence, FlexoptWarning, stacklevel=3)
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
        warnings=sentences,
    )


def solve_pairs(scaled: Scaled, call: str) -> list[Pair]:
    """The stabilizing pair by each route that found one, the smaller residual first."""
    s = scaled.system
    if s.n_states == 0:
        empty = np.zeros((0, 0))
        return [Pair(empty, empty, 0.0, 0.0, 0.0, 0, "doubling")] * 2
    escapes = escaping_modes(scaled)
    raise_escapes(call, scaled, [e for e in escapes if e.certain])
    F, G, H = riccati_matrices(s)
    pairs: list[Pair] = []
    doubled = riccati.doubling(F, G, H, discrete=s.discrete)
    if doubled is not None:
        pairs += _accept(F, G, H, doubled[0], doubled[1], s, doubled[2], "doubling")
    X = riccati.subspace(F, G, H, discrete=s.discrete)
    Z = riccati.subspace(F.T, H, G, discrete=s.discrete)
    if X is not None and Z is not None:
        pairs += _accept(F, G, H, X, Z, s, 0, "schur")
    pairs.sort(key=lambda p: (p.residual_x + p.residual_z > 1e-12, p.method != "doubling"))
    raise_escapes(call, scaled, [e for e in escapes if not pairs or _confirmed(e, s, pairs[0])])
    if not pairs:
        raise NoSolutionFound(
            f"{call}: neither doubling nor Schur vectors end in a stabilizing solution of the Riccati equations; the "
            "plant's numbers are too far apart, or it is within rounding of one that cannot be stabilised",
            violations={},
            iterate={},
        )
    return pairs


def _accept(
    F: Matrix, G: Matrix, H: Matrix, X: Matrix, Z: Matrix, s: StateSpace, iterations: int, method: str
) -> list[Pair]:
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
    return [Pair(x, z, rx, rz, largest, iterations, method)] if math.isfinite(largest) else []


def factor(X: Matrix) -> Matrix:
    """R (n, n) with RᵀR = X for a positive semidefinite X."""
    values, vectors = np.linalg.eigh(X)
    return np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T


def _confirmed(escape: Escape, s: StateSpace, pair: Pair) -> bool:
    """A doubtful mode escapes indeed when the feedback leaves it where it is, or needs gains beyond rounding."""
    F, G, H = riccati_matrices(s)
    if pair.largest > HOPELESS:
        return True
    if escape.kind == "stabilizable":
        return still_there(escape, riccati.closed_loop(F, G, pair.X, discrete=s.discrete), discrete=s.discrete)
    return still_there(escape, riccati.closed_loop(F.T, H, pair.Z, discrete=s.discrete), discrete=s.discrete)


def _warnings(agreement: float | None, best: Pair) -> tuple[str, ...]:
    if agreement is None:
        return (f"only the {best.method} route ended in a stabilizing solution: ε_max has no independent check",)
    if agreement > AGREEMENT:
        return (
            f"doubling and Schur vectors differ by {agreement:.1e} in ε_max: the plant is badly conditioned, and only "
            "the digits they share hold",
        )
    return ()
