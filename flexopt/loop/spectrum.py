"""Eigenvalues of one sample of a linear loop: what nothing holds taken out, growth rate, eigenvectors for derivatives.

In: Φ of x_{k+1} = Φ x_k. Out: `SampledLoop`, its multipliers, and of any of them the left and right eigenvectors.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexopt.errors import InputError
from flexopt.foundation.arrays import ComplexArray, Vector
from flexopt.foundation.plain import listed
from flexopt.foundation.results import Result
from flexopt.loop.structure import LoopStructure
from flexopt.plant import Plant

EXACT = "exact"
# Share of the largest singular value of Φ − 1 below which a direction stays where it is.
INVARIANT = 1e-10
# Share of its kinetic energy in the self-motion above which a motion is that.
OWN = 0.9
# From which share on that is told.
MOSTLY = 0.5
# The like of one that swings: the rest of the machine takes next to no part in it.
SWINGS_ALONE = 0.99
# Of unit eigenvectors, |yᴴx| below which two eigenvalues meet: there is no derivative.
MEETING = 1e-7
# From this share of the sampling rate on a motion has another sign at every sample.
ALTERNATES = 0.499
# What may make it do so, by name.
CAUSES = {
    "kv": "the velocity gain",
    "kp": "the position gain",
    "ki": "the integral gain",
    "nullspace_damping": "the damper of the self-motion",
}
# Steps of inverse iteration: next to an eigenvalue one or two do.
ITERATIONS = 3
# What of the unknown draws an arm off, and drives its self-motion.
OTHER_WEIGHT = "another weight than the controller carries, or other springs under it,"
# Of a loop that lets a redundant arm drift.
UNBRAKED = "the loop does not brake the arm's self-motion, no part of the decay; loop.nullspace_damping does"


def too_much(
    loop: SampledLoop, gains: Mapping[str, Any], without: Callable[[tuple[str, ...]], SampledLoop | str]
) -> tuple[str, ...]:
    """Which gains make a loop grow that changes its sign at every sample, names of `CAUSES`; none where it does not.

    The fewest without which no such motion grows; of as few those without which the loop grows least. The loop itself
    is asked, as the size of a gain does not tell whether it is too much by itself, or only beside another.

    Args:
        loop: as it is.
        gains: by name.
        without: the loop without some of them; a sentence where there is none.
    """
    if loop.growth_rate <= loop.rounding or loop.frequency_hz * loop.period < ALTERNATES:
        return ()
    present = [name for name in CAUSES if np.any(gains[name])]
    for count in range(1, len(present) + 1):
        rates = dict[tuple[str, ...], float]()
        for names in combinations(present, count):
            other = without(names)
            if isinstance(other, SampledLoop) and not other.alternates:
                rates[names] = other.growth_rate
        if rates:
            return min(rates, key=lambda names: rates[names])
    return ()


def from_sample_to_sample(names: Sequence[str], rate: float) -> str:
    """Why a loop grows that changes its sign at every sample, as `too_much` names it; empty where it does not.

    `rate`: of samples, Hz.
    """
    if not names:
        return ""
    verb = "is" if len(names) == 1 else "are"
    return f", half the sampling rate: {listed(CAUSES[name] for name in names)} {verb} too much for {rate:g} Hz"


def drifting_self_motion(drift: Sequence[float]) -> list[str]:
    """A sentence where a redundant arm's self-motion, of growth rates `drift`, 1/s, has some above zero."""
    each = [f"{1 / rate:.3g} s" for rate in sorted(drift, reverse=True) if rate > 0]
    others = f", other ways of it in {listed(each[1:])}" if each[1:] else ""
    return [f"the arm's self-motion drifts, e-fold in {each[0]}{others}"] if each else []


def slow_self_motion(drift: Sequence[float], decay: float) -> list[str]:
    """A sentence where a redundant arm's self-motion, of growth rates `drift`, dies away more slowly than the loop."""
    slowest = -max(drift, default=0.0)
    lasts = 0 < slowest < decay
    return [f"the arm's self-motion, no part of the decay, dies away at {slowest:.3g}/s"] if lasts else []


def mostly_self_motion(share: float) -> list[str]:
    """That a motion of the loop is more a redundant arm's self-motion than anything else, within a sentence."""
    # More than that, and yet the loop's: see `_drifting`.
    where = f"below {100 * OWN:g} %" if share <= OWN else "where it swings or changes sign at every sample"
    counts = f"which {where} counts as the loop's and is no drift"
    return [f"to {100 * share:.3g} % of its kinetic energy the arm's self-motion, {counts}"] if share > MOSTLY else []


def driven_self_motion(unheld: Mapping[str, float], units: Sequence[str], where: str) -> list[str]:
    """A sentence where torques and forces by joint drive a redundant arm's self-motion that no feedback holds.

    `units`: of the joints, rad or m.
    """
    if not unheld:
        return []
    name, unit = max(zip(unheld, units, strict=True), key=lambda joint: abs(unheld[joint[0]]))
    force = f"{abs(unheld[name]):.3g} {'N m' if unit == 'rad' else 'N'} of {name}"
    driven = f"{OTHER_WEIGHT} drives the arm's self-motion"
    return [f"{driven}, by up to {force}, {where}: it moves off, for feedback of the end-point does not hold it"]


def poles_of(multipliers: ArrayLike, period: float) -> ComplexArray:
    """Ln μ / T of multipliers μ (...), rad/s, imaginary parts up to the Nyquist frequency.

    Real part −∞, imaginary part 0, where μ = 0: a motion that is over after some samples.
    """
    # -0 + 0 is 0, whose angle is 0, not π.
    mu = np.asarray(multipliers, dtype=np.complex128) + 0.0
    with np.errstate(divide="ignore"):
        rates = np.log(np.abs(mu)) / period
    # Part by part: a complex quotient makes NaN of −∞.
    return rates + 1j * np.angle(mu) / period


@dataclass(frozen=True)
class SampledLoop(Result):
    """The linear loop x_{k+1} = Φ x_k about equilibrium.

    Attributes:
        multipliers: eigenvalues of Φ, largest first; what nothing holds left out.
        period: of a sample, s.
        neutral: how many eigenvalues 1 were taken out, of what nothing drives or brakes: the self-motion of a redundant
            arm, and directions without gain.
        own: eigenvalues of the self-motion where weight or damping act on it, largest first; taken out, too: an arm
            that drifts while its end-point stays is no oscillation.
        integrator: how the plant is advanced between samples: `"exact"`, or the method asked for.
        rounding: of a growth rate, 1/s: what is nearer to zero is neither growth nor decay.
        self_motion: share of its kinetic energy that the slowest motion has in the self-motion: of a drift that moves
            the base so much that it is taken for the loop's, up to 0.9; NaN where no self-motion is told apart.
    """

    multipliers: ComplexArray
    period: float
    neutral: int = 0
    own: ComplexArray = field(default_factory=lambda: np.zeros(0, dtype=np.complex128))
    integrator: str = EXACT
    rounding: float = 0.0
    self_motion: float = math.nan

    DOCUMENT = """
    stable growth_rate[1/s] frequency_hz[Hz] drift[1/s] neutral self_motion period[s] integrator rounding[1/s]
    multipliers
    """

    @property
    def drift(self) -> tuple[float, ...]:
        """Growth rates of the self-motion, those of `own`, 1/s, largest first."""
        return tuple(poles_of(self.own, self.period).real.tolist())

    @property
    def growth_rate(self) -> float:
        """Max ln|μ| / T, 1/s: below 0 the loop is stable."""
        return float(poles_of(self.multipliers[:1], self.period)[0].real)

    @property
    def poles(self) -> ComplexArray:
        """Of all multipliers, rad/s."""
        return poles_of(self.multipliers, self.period)

    @property
    def frequency_hz(self) -> float:
        """Of the pole nearest to instability, Hz."""
        return abs(float(np.angle(self.multipliers[0]))) / (2 * np.pi * self.period)

    @property
    def aperiodic(self) -> bool:
        """Whether the pole nearest to instability dies away without swinging: to e^-10 within a period."""
        return -self.growth_rate > 10 * self.frequency_hz

    @property
    def stable(self) -> bool:
        """Whether all multipliers lie inside the unit circle, by more than rounding."""
        return self.growth_rate < -self.rounding

    @property
    def alternates(self) -> bool:
        """Whether a motion grows that has another sign at every sample."""
        poles = self.poles
        turns = np.abs(poles.imag) * self.period / (2 * np.pi)
        return bool(np.any((turns >= ALTERNATES) & (poles.real > self.rounding)))

    def __repr__(self) -> str:
        known = abs(self.growth_rate) > self.rounding
        word = "stable" if self.growth_rate < 0 else "unstable"
        word = word if known else "at the border of stability, to rounding"
        how = "" if self.integrator == EXACT else f" by {self.integrator}"
        return (
            f"SampledLoop({word}{how}: decay {-self.growth_rate:+z.4g}/s at {self.frequency_hz:.4g} Hz, "
            f"{len(self.multipliers)} multipliers)"
        )


@dataclass(frozen=True)
class OwnMotion:
    """The self-motion of an arm with more joints than task rows, in a configuration.

    Attributes:
        directions: orthonormal in the joints, in all coordinates, (n_q, n − n_task).
        creeping: the like of one so slow that the loop comes to rest all along it, the base and the end-point as they
            then are, (n_q, n − n_task).
        mass: M (n_q, n_q).
        to_q: q = A u + constant, (n_q, n_q).
        joints: n, how many of the coordinates, the last, are the arm's.
    """

    directions: Vector
    creeping: Vector
    mass: Vector
    to_q: Vector
    joints: int

    @classmethod
    def at(cls, plant: Plant, q: Vector, base: Vector, p: Any, to_q: Vector) -> OwnMotion:
        """Of a machine with parameters p (n_par,), where no weight acts: joints alone move along it."""
        m = plant.n_passive
        jacobian: Vector = plant.rigid_jacobian.call([q, base, p])[0].full()
        joints = np.linalg.svd(jacobian)[2][plant.n_task :].T
        own = np.vstack([np.zeros((m, joints.shape[1])), joints])
        return cls(own, own, plant.mass.call([q, base, p])[0].full(), to_q, plant.n_actuated)

    def creeping_along(self, resting_rows: Vector) -> OwnMotion:
        """The like under a weight: the loop rests along the kernel of rows (m + n_task, n_q), if these are finite."""
        if not np.all(np.isfinite(resting_rows)):
            return self
        # Rows have units of their own.
        rows = resting_rows / np.linalg.norm(resting_rows, axis=1, keepdims=True)
        return replace(self, creeping=np.linalg.svd(rows)[2][len(rows) :].T)

    def shares(self, vectors: ComplexArray) -> Vector:
        """Which share of the kinetic energy of each eigenvector is its: as it moves alone, or as it creeps.

        Of what creeps the end-point may take a part, but the base, which the arm may tip over with, none of the share.
        """
        n, m = len(self.to_q), len(self.to_q) - self.joints
        rates = np.asarray(self.to_q @ vectors[n : 2 * n], dtype=np.complex128)
        whole = np.einsum("ik,ij,jk->k", rates.conj(), self.mass, rates).real
        parts = list[Vector]()
        for own in (self.directions, self.creeping):
            along: ComplexArray = own.T @ self.mass @ rates
            parts.append(np.einsum("ik,ik->k", along.conj(), np.linalg.solve(own.T @ self.mass @ own, along)).real)
        alone, creeping = parts
        base = np.einsum("ik,ij,jk->k", rates[:m].conj(), self.mass[:m, :m], rates[:m]).real
        part = np.fmax(alone, np.minimum(creeping, whole - base))
        return np.asarray(part / np.maximum(whole, np.finfo(float).tiny), dtype=np.float64)


def _drifting(values: ComplexArray, shares: Vector, most: int) -> NDArray[np.bool_]:
    """Which eigenvalues belong to an arm that drifts along its self-motion: its the kinetic energy.

    Weight makes the self-motion of an arm on a base that gives no longer neutral, nor does damping of it. Two real ones
    that meet become a pair, a pendulum of the self-motion: more of its energy has to be there once it swings by a
    radian before it grows or dies away by e.
    """
    swings = np.abs(np.angle(values)) > np.abs(np.log(np.abs(values) + (values == 0)))
    share = np.where(values.real <= 0, 0.0, shares)
    drifting = share > np.where(swings, SWINGS_ALONE, OWN)
    drifting[np.argsort(-share)[most:]] = False
    # Both of a pair, or none.
    return drifting & np.isin(values.conj(), values[drifting])


def neutral_directions(structure: LoopStructure, joints: int, kp: Any, ki: Any) -> int:
    """In how many directions the loop may rest elsewhere: self-motion, and task rows that no gain holds."""
    if structure.law == "none":
        return joints
    free, rows = joints - structure.n_task, structure.n_task
    if structure.law not in ("pd", "pid"):
        return free
    unheld = np.broadcast_to(kp, rows) == 0
    if structure.law == "pid":
        without = np.broadcast_to(ki, rows) == 0
        # An integral without gain keeps what it has; a row without either gain rests anywhere.
        return free + int(np.count_nonzero(without)) + int(np.count_nonzero(unheld & without))
    return free + int(np.count_nonzero(unheld))


def spectrum(
    matrix: Vector, period: float, most: int, excess: int, own: Callable[[], OwnMotion], integrator: str = EXACT
) -> SampledLoop:
    """The eigenvalues of Φ.

    Args:
        matrix: Φ (n, n).
        period: of a sample, s.
        most: see `neutral_directions`.
        excess: joints beyond the task rows.
        own: gives their self-motion, where it has to be told apart.
        integrator: see `SampledLoop`.

    Raises:
        InputError: Φ overflows.
    """
    balanced, scale = balance(matrix)
    held, kept = without_neutral(balanced, most)
    removed = len(matrix) - len(held)
    # Of these the self-motion's: other directions that rest anywhere are of integrals and rows without gain.
    neutral = max(removed - (most - excess), 0)
    if excess > 0 and neutral < 2 * excess:
        found, vectors = np.linalg.eig(held)
        shares = own().shares(np.asarray(scale[:, None] * (kept.T @ vectors), dtype=np.complex128))
    else:
        found = np.linalg.eigvals(held)
        shares = np.full(len(found), np.nan)
    rounding = 10 * len(matrix) * np.finfo(float).eps * float(np.linalg.norm(balanced))
    order = np.argsort(-np.abs(found))
    values, shares = np.asarray(found, dtype=np.complex128)[order], shares[order]
    drifts = _drifting(values, shares, 2 * excess - neutral)
    slowest = float(np.append(shares[~drifts], np.nan)[0])
    return SampledLoop(values[~drifts], period, removed, values[drifts], integrator, rounding / period, slowest)


def balance(matrix: Vector) -> tuple[Vector, Vector]:
    """D⁻¹ Φ D and the diagonal of D."""
    # Its wrapper `matrix_balance` takes as long as the eigenvalues themselves.
    from scipy.linalg.lapack import dgebal  # noqa: PLC0415  (loads slowly)

    if not np.all(np.isfinite(matrix)):
        raise InputError("the linear loop grows beyond the largest number within one sample; give lower gains")
    balanced, _, _, scale, _ = dgebal(matrix, scale=1, permute=0)
    return np.asarray(balanced, dtype=np.float64), np.asarray(scale, dtype=np.float64)


def without_neutral(matrix: Vector, most: int) -> tuple[Vector, Vector]:
    """Φ on what is left when states that stay where they are, then rates that nothing changes, are divided out.

    Both are kernels of Φ − 1, the second of what the first leaves; together a double eigenvalue 1 for each direction.

    Returns:
        The matrix U Φ Uᵀ that is left, and U, orthonormal rows.
    """
    found, basis, _ = all_without_neutral(matrix[None], most)
    return found[0], basis[0]


def all_without_neutral(matrices: Vector, most: int) -> tuple[Vector, Vector, NDArray[np.bool_]]:
    """The like of a stack (N, n, n): of those of which as much is divided out as of most, and which these are (N,)."""
    alike, bases = np.ones(len(matrices), dtype=bool), np.eye(matrices.shape[-1])
    for _ in range(2 if len(matrices) else 0):
        if not most:
            break
        size = matrices.shape[-1]
        _, sizes, rows = np.linalg.svd(matrices - np.eye(size))
        counts = np.count_nonzero(sizes[:, -most:] < INVARIANT * sizes[:, :1], axis=1)
        most = int(np.bincount(counts[alike]).argmax())
        alike &= counts == most
        kept = rows[:, : size - most]
        # Φ v = v on the kernel: in this basis the matrix is block triangular, with 1 in the lower block.
        matrices, bases = kept @ matrices @ kept.transpose(0, 2, 1), kept @ bases
    return matrices[alike], np.broadcast_to(bases, (len(alike), *bases.shape[-2:]))[alike], alike


def eigenvectors(
    matrix: Vector, value: complex, balanced_by: tuple[Vector, Vector] | None = None
) -> tuple[complex, ComplexArray, ComplexArray]:
    """The eigenvalue of Φ next to `value`, refined, and vectors y, x with yᴴ Φ = μ yᴴ, Φ x = μ x, yᴴ x = 1.

    dμ = yᴴ dΦ x. Where two eigenvalues meet there is no derivative, and y is NaN. `balanced_by`: as of `balance`, where
    it is known.
    """
    balanced, scale = balance(matrix) if balanced_by is None else balanced_by
    y, x = _unit_vectors(balanced, value)
    product = complex(np.vdot(y, x))
    if abs(product) < MEETING:
        return value, np.full_like(y, np.nan), x
    refined = complex(np.vdot(y, balanced @ x)) / product
    return refined, y / np.conj(product) / scale, scale * x


def _unit_vectors(matrix: Vector, value: complex) -> tuple[ComplexArray, ComplexArray]:
    """Left and right unit eigenvectors: by inverse iteration, and where that leaves more than rounding, by an SVD."""
    from scipy.linalg.lapack import zgetrf, zgetrs  # noqa: PLC0415  (loads slowly)

    n = len(matrix)
    shifted = matrix - value * np.eye(n)
    rounding = n * np.finfo(float).eps * float(np.linalg.norm(matrix))
    factors, pivots, _ = zgetrf(shifted)
    corner = np.diag_indices(n)
    pivot = factors[corner]
    factors[corner] = np.where(np.abs(pivot) > np.finfo(float).eps * rounding, pivot, rounding)
    found = list[ComplexArray]()
    for transposed, of in ((2, shifted.conj().T), (0, shifted)):
        vector = np.exp(1j * np.arange(n) ** 2)
        for _ in range(ITERATIONS):
            vector = zgetrs(factors, pivots, vector, trans=transposed)[0]
            vector = vector / np.linalg.norm(vector)
        if not np.linalg.norm(of @ vector) <= rounding:
            left, _, right = np.linalg.svd(shifted)
            return np.asarray(left[:, -1], dtype=np.complex128), np.asarray(right[-1].conj(), dtype=np.complex128)
        found.append(np.asarray(vector, dtype=np.complex128))
    return found[0], found[1]
