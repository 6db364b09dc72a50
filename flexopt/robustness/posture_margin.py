"""ε_max of single postures and its gradient, as numbers with bounds on their errors.

In: a `Margin`, a posture, the servo gain. Out: `PostureMargin`. The plant is evaluated in decimals from the machine's
numbers; its Riccati equations are solved in doubles and refined in decimals (`flexopt.coprime.extended`), and so are
the adjoint Lyapunov equations of the gradient, which is one reverse sweep through the plant's graph, in decimals
as well.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from decimal import Decimal, getcontext

import numpy as np
from numpy.typing import NDArray

from flexopt.compiled.extended import Evaluated, Exact, digits, exact, extended, largest, rounded
from flexopt.coprime import StateSpace, riccati
from flexopt.coprime.decimals import null_space, refined_mode, solve, times, unit
from flexopt.coprime.extended import (
    ENOUGH,
    HOPELESS,
    Equation,
    ExactPair,
    Seeds,
    TopPairs,
    goal,
    seeds,
    solve_pair,
    top_pairs,
)
from flexopt.coprime.lyapunov import NotConverged
from flexopt.coprime.margin import TOLD, epsilon_error
from flexopt.coprime.scaling import Scaled, scale_for_riccati
from flexopt.coprime.stabilizability import REACH, Escape, escaping_modes, pole_text
from flexopt.coprime.system import Matrix
from flexopt.foundation.arrays import Vector
from flexopt.robustness.margin import Margin

# Eigenvalues this close, relative in ε, may be at a kink: on its two sides the gradient belongs to different branches.
# They are where the branches meet within this distance, m or rad, by their slopes, or are equal to rounding: where the
# rigid part rules, both come close to its own ε_max and never meet.
KINK_TOLERANCE, KINK_DISTANCE, EQUAL = 1e-7, 1e-4, 1e-13
# A gradient whose bound is beyond this share of its largest element is not told.
GRADIENT_TOLERANCE = 1e-7
DIGITS = (50, 100)
# Pivots that are so small beside others are zeros that rounding has touched.
RANK = Decimal(10) ** -30
# How close doubles must be to that for it to be looked at in decimals.
CLOSE = 1e-7


@dataclass(frozen=True)
class PostureMargin:
    """ε_max of one posture, as numbers.

    Attributes:
        epsilon_max: None where no feedback of the end-point stabilises the plant, or where it could not be computed.
        error: bound on |ε_max − the exact one|: what the residuals prove, and to first order what evaluating the plant
            from the machine's numbers in double precision would change. NaN without ε_max.
        unstabilizable: whether ε_max is None because it is proven to be below 1e-12.
        second: (1 + λ_2)^(−1/2) of the next eigenvalue of X Z: ε_max has a kink where the two meet.
        z: ∂ε_max/∂[base, posture], (n_b + n,);  p: ∂ε_max/∂p, (n_par,);  kr: ∂ε_max/∂kr. NaN where not told.
        z_error, p_error, kr_error: bounds on their errors, to first order.
        kink: rows g_11, g_22, g_12 of `Margin.gradients`, (3, n_b + n), where the two branches meet; else None.
        residual: largest relative Riccati residual.
        warning: a sentence, or empty.
    """

    epsilon_max: float | None
    error: float
    unstabilizable: bool
    second: float
    z: Vector
    p: Vector
    kr: float
    z_error: Vector
    p_error: Vector
    kr_error: float
    kink: Vector | None
    residual: float
    warning: str

    @property
    def status(self) -> str:
        """`"computed"`, `"not stabilizable"` or `"not computed"`."""
        if self.epsilon_max is not None:
            return "computed"
        return "not stabilizable" if self.unstabilizable else "not computed"


def prepare_margin(margin: Margin) -> None:
    """Build the graphs of `evaluate_margin` now, so that it need not."""
    assert margin.hold is not None
    assert margin.coordinates is not None
    extended(margin.plant_at)


def evaluate_margin(
    margin: Margin, base: Vector, posture: Vector, kr: float, *, gradient: bool = True, finest: bool = False
) -> PostureMargin:
    """ε_max, and its derivatives unless they are not wanted, at one posture.

    `finest`: all digits at once, in place of few first and more where their bounds are too large.
    """
    sentence, hopeless = "", False
    for count in DIGITS[-1:] if finest else DIGITS:
        with digits(count):
            try:
                return _evaluated(margin, base, posture, kr, gradient=gradient, finest=finest)
            except NotConverged as error:
                sentence, hopeless = str(error), error.hopeless
            except np.linalg.LinAlgError as error:
                sentence = str(error)
        if hopeless:
            break
    if hopeless:
        sentence = "ε_max: no feedback of the end-point stabilises the plant (" + sentence + ")"
    else:
        sentence = f"ε_max could not be computed, in extended precision neither ({sentence})"
    unknown, z, p = float("nan"), np.full(base.size + posture.size, np.nan), np.full(_n_p(margin), np.nan)
    return PostureMargin(None, unknown, hopeless, unknown, z, p, unknown, z, p, unknown, None, unknown, sentence)


def _n_p(margin: Margin) -> int:
    return len(margin.plant.parameter_names)


@dataclass(frozen=True, eq=False)
class _Unseen:
    """States that nothing depends on: A R = 0 and C R = 0 for R = [−W; I] in the columns (P, F).

    They are the free motion of an arm with more joints than task rows, where joint damping leaves some of it undamped;
    like the whole of it in an arm without joint damping they are left out. ξ = Q x with Q = [I, W] has A_r = Q A_P,
    B_r = Q B, C_r = C_P. W moves with A and C: dW = L [dA; dC] R for a left inverse L of [A_P; C_P].
    """

    plant: Equation
    kept: list[int]
    left_out: list[int]
    W: Exact

    @property
    def onto_kept(self) -> Exact:
        """Q (n − k, n)."""
        Q = np.full((len(self.kept), len(self.plant.F)), Decimal(0), dtype=object)
        Q[:, self.kept], Q[:, self.left_out] = unit(len(self.kept)), self.W
        return Q

    @property
    def reduced(self) -> Equation:
        """The plant without them."""
        if not self.left_out:
            return self.plant
        e, Q = self.plant, self.onto_kept
        return Equation(Q @ e.F[:, self.kept], Q @ e.B, e.C[:, self.kept])

    def whole(self, F: Exact, B: Exact, C: Exact) -> tuple[Exact, Exact, Exact]:
        """Derivatives by the whole plant's A, B, C from those by the reduced one's."""
        if not self.left_out:
            return F, B, C
        e, Q, n = self.plant, self.onto_kept, len(self.plant.F)
        seen = np.concatenate([e.F, e.C])[:, self.kept]
        R = np.full((n, len(self.left_out)), Decimal(0), dtype=object)
        R[self.kept], R[self.left_out] = -self.W, unit(len(self.left_out))
        of_w = F @ e.F[np.ix_(self.left_out, self.kept)].T + B @ e.B[self.left_out].T
        both = seen @ solve(seen.T @ seen, of_w) @ R.T
        by_f, by_c = both[:n].copy(), both[n:].copy()
        by_f[:, self.kept] += Q.T @ F
        by_c[:, self.kept] += C
        return by_f, Q.T @ B, by_c


@dataclass(frozen=True, eq=False)
class _ScaledPlant:
    """The plant in physical units as evaluated, and its equation for x = T ξ, t = τ/rate, unseen states left out."""

    evaluated: Evaluated
    unseen: _Unseen
    equation: Equation
    forward: Exact
    backward: Exact
    rate: Decimal
    kr: Decimal

    def to_physical(self, found: Seeds) -> list[Exact]:
        """Derivatives by the physical A, B and C."""
        F, B, C = self.unseen.whole(found.F, found.B, found.C)
        by_a = times(times(F, self.forward.T).T, self.backward).T / self.rate
        return [by_a, self.backward.T @ B * (self.kr / self.rate), C @ self.forward.T]

    def sizes(self, found: Seeds) -> list[Matrix]:
        """Bounds on the terms that those derivatives are sums of; of what `unseen` adds, itself."""
        of_f, of_b, of_c = (np.abs(rounded(M)) for M in self.unseen.whole(found.F, found.B, found.C))
        kept, (by_f, by_b, by_c) = self.unseen.kept, found.sizes
        if self.unseen.left_out:
            Q = np.abs(rounded(self.unseen.onto_kept))
            by_f, by_b = Q.T @ by_f, Q.T @ by_b
        of_f[:, kept] += by_f
        of_b += by_b
        of_c[:, kept] += by_c
        back, forth = np.abs(rounded(self.backward)).T, np.abs(rounded(self.forward)).T
        return [back @ of_f @ forth / float(self.rate), back @ of_b * float(abs(self.kr) / self.rate), of_c @ forth]


def _scaled(margin: Margin, base: Vector, posture: Vector, kr: float) -> _ScaledPlant:
    """The plant in decimals; modal coordinates balanced as in `Margin.hold`, of which only T is taken, not T⁻¹."""
    p = margin.plant.parameter_values.full().ravel()
    held = margin.hold.call([base, posture, p, kr])[0]
    deflection, rate, forward = (x.full() for x in margin.coordinates.call([held]))
    evaluated = extended(margin.plant_at)(*(exact(x) for x in (base, posture, p, deflection.ravel())))
    A, B, C = evaluated.outputs
    if not all(x.is_finite() for M in (A, B, C) for x in M.ravel()):
        raise NotConverged("the joints do not move all task rows", hopeless=True)
    if not (np.all(np.isfinite(forward)) and np.linalg.cond(forward) < 1e14 and rate[0, 0] > 0):
        s = StateSpace(rounded(A), rounded(B) * kr, rounded(C), np.zeros((C.shape[0], B.shape[1])))
        scaled = scale_for_riccati(s)
        forward, rate = np.diag(scaled.states), np.array([[scaled.rate]])
    T, speed, gain = exact(forward), Decimal(float(rate[0, 0])), Decimal(kr)
    back = solve(T, unit(len(T)))
    whole = Equation(times(back, times(A, T)) / speed, back @ B * (gain / speed), C @ T)
    unseen = _Unseen(whole, list(range(len(T))), [], np.zeros((len(T), 0), dtype=object))
    if margin.keeps_joint_rates:
        kept, left_out, W = null_space(np.concatenate([whole.F, whole.C]), RANK)
        unseen = _Unseen(whole, kept, left_out, W) if left_out else unseen
    return _ScaledPlant(evaluated, unseen, unseen.reduced, T, back, speed, gain)


def _starts(equation: Equation) -> Iterator[tuple[Matrix, Matrix]]:
    """Approximate solutions in doubles, the quickest way first."""
    F, B, C = (rounded(M) for M in (equation.F, equation.B, equation.C))
    G, H = B @ B.T, C.T @ C
    doubled = riccati.doubling(F, G, H, discrete=False)
    if doubled is not None:
        yield doubled[:2]
    X, Z = riccati.subspace(F, G, H, discrete=False), riccati.subspace(F.T, H, G, discrete=False)
    if X is not None and Z is not None:
        yield X, Z


def _evaluated(
    margin: Margin, base: Vector, posture: Vector, kr: float, *, gradient: bool, finest: bool
) -> PostureMargin:
    plant = _scaled(margin, base, posture, kr)
    try:
        pair = solve_pair(plant.equation, _starts(plant.equation))
        top = top_pairs(pair, goal() if finest else ENOUGH)
    except NotConverged as error:
        escapes = _escapes(plant)
        if error.hopeless or any(e.certain for e in escapes):
            raise NotConverged(_named(plant, escapes) or str(error), hopeless=True) from None
        raise
    if top.values[0] > HOPELESS:
        raise NotConverged(_named(plant, _escapes(plant)) or "ε_max is below 1e-12", hopeless=True)
    if finest:
        return _told(margin, plant, pair, top, goal(), gradient=gradient)
    try:
        return _told(margin, plant, pair, top, ENOUGH, gradient=gradient)
    except NotConverged:
        return _told(margin, plant, pair, top_pairs(pair, goal()), goal(), gradient=gradient)


def _told(
    margin: Margin, plant: _ScaledPlant, pair: ExactPair, top: TopPairs, target: float, *, gradient: bool
) -> PostureMargin:
    """Numbers and bounds from a pair; `NotConverged` where those are not small enough."""
    top_value = float(top.values[0])
    found = seeds(pair, top.values[0], top.vectors[:, 0], top.vectors[:, 0], target)
    by_input, moved = plant.evaluated.gradient(plant.to_physical(found))
    epsilon = 1.0 / math.sqrt(1.0 + top_value)
    proven = pair.eigenvalue_bound() + top.residual
    if not epsilon_error(top_value, proven) <= TOLD * epsilon:
        raise NotConverged(f"the bound on its error is {epsilon_error(top_value, proven):.1e}")
    error = epsilon_error(top_value, proven + moved)
    second = 1.0 / math.sqrt(1.0 + float(top.values[1]))
    n_z, n_p = margin.plant.n_base + margin.plant.n_actuated, _n_p(margin)
    unknown = np.full(n_z + n_p + 1, np.nan)
    rows, errors, kink, sentence = unknown, unknown, None, ""
    if gradient:
        rows, errors = _row(plant, pair, top, found, by_input, top.values[0])
        if second - epsilon <= KINK_TOLERANCE * epsilon:
            branches = np.vstack([rows, *_others(plant, pair, top)])[:, :n_z]
            kink = branches if _meet(second - epsilon, epsilon, branches) else None
        if kink is not None:
            sentence = "ε_max has a kink here: the two largest eigenvalues of XZ meet, and each has its own gradient"
        elif not _good(rows[:n_z], errors[:n_z], 1.0) or not _good(
            rows[n_z:], errors[n_z:], np.append(margin.plant.parameter_values.full().ravel(), float(plant.kr))
        ):
            if target == ENOUGH or getcontext().prec < DIGITS[-1]:
                raise NotConverged("the bound on its gradient's error is too large")
            rows, errors = unknown, unknown
            sentence = "the gradient of ε_max could not be computed to 1e-7"
    z, p, by_kr = rows[:n_z], rows[n_z : n_z + n_p], float(rows[-1])
    z_error, p_error, kr_error = errors[:n_z], errors[n_z : n_z + n_p], float(errors[-1])
    return PostureMargin(
        epsilon, error, False, second, z, p, by_kr, z_error, p_error, kr_error, kink, pair.residual, sentence
    )


def _meet(gap: float, epsilon: float, branches: Vector) -> bool:
    """Whether two values so far apart meet nearby: g_11 − g_22 and 2 g_12 close the gap."""
    first, second, mixed = branches
    slope = float(np.hypot(np.linalg.norm(first - second), 2 * np.linalg.norm(mixed)))
    return gap <= max(KINK_DISTANCE * slope, EQUAL * epsilon)


def _good(rows: Vector, errors: Vector, by: Vector | float) -> bool:
    """Whether each error is small beside the largest derivative, both per relative change `by`."""
    size = float(np.max(np.abs(rows * by), initial=0.0))
    return bool(np.all(np.abs(errors * by) <= GRADIENT_TOLERANCE * size + 1e-15))


def _row(
    plant: _ScaledPlant, pair: ExactPair, top: TopPairs, found: Seeds, by_input: list[Exact], value: Decimal
) -> tuple[Vector, Vector]:
    """∂ε/∂[base, posture, p, kr] from the derivatives of λ, and bounds on their errors."""
    factor = -((1 + value) ** Decimal("-1.5")) / 2
    by_kr = np.sum(found.B * plant.equation.B) / plant.kr
    row = rounded(np.concatenate([*by_input[:3], [by_kr]]) * factor)
    # The last summand: rounding of the decimals themselves, thousands of operations long.
    relative = 10 * (found.correction + pair.gradient_error(top)) + 10.0 ** (8 - getcontext().prec)
    spread = plant.evaluated.influence(plant.sizes(found))
    of_kr = float(np.sum(found.sizes[1] * np.abs(rounded(plant.equation.B)))) / float(abs(plant.kr))
    off = np.concatenate([*spread[:3], [of_kr]]) * relative * float(abs(factor))
    return row, off + np.abs(row) * 2.0**-52


def _others(plant: _ScaledPlant, pair: ExactPair, top: TopPairs) -> list[Vector]:
    """The second and the mixed branch's rows, g_22 and g_12."""
    rows: list[Vector] = []
    for value, (i, j) in ((top.values[1], (1, 1)), ((top.values[0] + top.values[1]) / 2, (0, 1))):
        found = seeds(pair, value, top.vectors[:, i], top.vectors[:, j], goal())
        by_input, _ = plant.evaluated.gradient(plant.to_physical(found))
        rows.append(_row(plant, pair, top, found, by_input, value)[0])
    return rows


def _scaled_system(plant: _ScaledPlant) -> Scaled:
    e = plant.equation
    F, B, C = (rounded(M) for M in (e.F, e.B, e.C))
    return Scaled(StateSpace(F, B, C, np.zeros((C.shape[0], B.shape[1]))), np.ones(len(F)), float(plant.rate))


def _escapes(plant: _ScaledPlant) -> list[Escape]:
    """Modes that do not decay and escape, within rounding, the inputs or the outputs.

    Certain are those at exactly 0 where A with B beside it, or C below it, has lost rank, and the simple ones of which
    nothing arrives at B or C and whose real part is not negative, all to thirty digits.
    """
    e, scaled = plant.equation, _scaled_system(plant)
    found = [replace(escape, certain=False) for escape in escaping_modes(scaled)]
    n = len(e.F)
    for kind, A, B in (("stabilizable", e.F, e.B), ("detectable", e.F.T, e.C.T)):
        if len(null_space(np.concatenate([A, B], axis=1), RANK)[0]) < n:
            found.insert(0, Escape(0j, 0.0, 0.0, kind, certain=True))
        values, vectors = np.linalg.eig(rounded(A.T))
        size = float(np.max(np.abs(values)))
        for value, vector in zip(values, vectors.T, strict=True):
            reached = np.linalg.norm(vector @ rounded(B)) <= CLOSE * np.linalg.norm(rounded(B))
            if value.imag > 0 and value.real >= -CLOSE * size and reached:
                found = _confirmed(A, B, complex(value), vector.astype(complex), kind) + found
    return found


def _confirmed(A: Exact, B: Exact, value: complex, vector: NDArray[np.complex128], kind: str) -> list[Escape]:
    """The mode, if in decimals, too, it does not decay and B does not reach it."""
    try:
        mode, left = refined_mode(A.T, value, vector)
    except np.linalg.LinAlgError:
        return []
    arrives = left.left(B.T)
    escapes = max(largest(arrives.re), largest(arrives.im)) <= float(RANK) * largest(B)
    pole = complex(float(mode.re[0]), float(mode.im[0]))
    if not (escapes and pole.real >= -float(RANK) * abs(pole) and abs(pole - value) <= CLOSE * abs(value)):
        return []
    pole = complex(0.0, pole.imag) if abs(pole.real) < abs(pole) * CLOSE else pole
    return [Escape(pole, 0.0, 0.0, kind, certain=True)]


def _named(plant: _ScaledPlant, escapes: list[Escape]) -> str:
    """The modes that escape as text, those in doubt only where none is certain; empty where there are none."""
    scaled = _scaled_system(plant)
    modes = [
        f"mode = {pole_text(scaled.pole(escape.mode), discrete=False)}: does not decay and {REACH[escape.kind]}"
        for escape in [e for e in escapes if e.certain] or escapes
        if escape.mode.imag >= 0
    ]
    return "; ".join(dict.fromkeys(modes))
