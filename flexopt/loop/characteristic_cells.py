"""The characteristic function over cells of frequency and a box as Bernstein polynomials, with remainders.

In: a `Characteristic`, cells of ω. Out: `Cells`: control points b of a polynomial q̃ in (ω, θ) and R, so that

    |p(jω − ρ, θ) · conj p_a(jω − ρ, θ) − q̃(ω, θ)| ≤ R        for all ω of the cell and θ of the box,

p_a that of the machine whose base is locked: p turns with ω as p_a does, and what is left of the turn is what the base
does. R adds up what the interpolation in ω and in the dead time leaves (Trefethen, Approximation Theory and
Approximation Practice, theorem 8.2: from a bound of the function over an ellipse, here by Hadamard's inequality), what
aliases of other machines than the tabulated one make, and rounding.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.loop.aliases import ELLIPSES, hold
from flexopt.loop.bernstein import lebesgue, nodes_of, splitting, to_bernstein
from flexopt.loop.characteristic import Characteristic
from flexopt.loop.members import Complex, Machines, Ports

# Degree in ω; passes of scaling before Hadamard's inequality.
DEGREE = 8
SCALINGS = 12
# Share of the values that R may be; cells are halved, so often at most, where it is more for want of degrees in ω.
FINE, FINER = 1e-5, 8
# Rounding: so many unit roundoffs of the largest entry of its column in every entry of a determinant.
ROUNDING = 64 * float(np.finfo(float).eps)
# Of units, a mean that is rounding.
CANCELLED = 1e-12
# Multiples of the aliases' error that bounds are taken over.
SOME, FARTHER = 10.0, (1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8)


@dataclass(frozen=True, eq=False)
class Cells:
    """Control points and remainders of K cells of frequency over one box.

    Attributes:
        low, high: ends of ω (K,), rad/s.
        points: (K, DEGREE + 1, 1 + degree in each θ …).
        error: R (K,).
    """

    low: Vector
    high: Vector
    points: Complex
    error: Vector

    def chosen(self, which: Any) -> Cells:
        """Some of them."""
        return Cells(self.low[which], self.high[which], self.points[which], self.error[which])

    def halves(self) -> Cells:
        """The same in cells half as wide."""
        left, right = (_along(self.points, matrix, 1) for matrix in splitting(DEGREE, 0.5))
        middle, both = (self.low + self.high) / 2, np.concatenate
        return Cells(both([self.low, middle]), both([middle, self.high]), both([left, right]), both([self.error] * 2))

    def split(self, axis: int, at: float) -> tuple[Cells, Cells]:
        """The same over the two parts of the box, θ_axis split at `at` in [0, 1]."""
        degree = self.points.shape[2 + axis] - 1
        left, right = (_along(self.points, matrix, 2 + axis) for matrix in splitting(degree, at))
        return Cells(self.low, self.high, left, self.error), Cells(self.low, self.high, right, self.error)

    def joined(self, others: Sequence[Cells]) -> Cells:
        """These and others, in a row."""
        every, both = (self, *others), np.concatenate
        low, high = both([each.low for each in every]), both([each.high for each in every])
        return Cells(low, high, both([each.points for each in every]), both([each.error for each in every]))

    @property
    def exclude_zero(self) -> NDArray[np.bool_]:
        """Whether no value is zero (K,): some line has all control points on one side of it, R away at least."""
        points = self.points.reshape(len(self.points), -1)
        # Of most cells the line across the mean is one.
        mean = points.sum(axis=1)
        mean = mean / np.maximum(np.abs(mean), np.finfo(float).tiny)
        ahead = points.real * mean.real[:, None] + points.imag * mean.imag[:, None]
        found: NDArray[np.bool_] = ahead.min(axis=1, initial=np.inf) > self.error
        left = np.flatnonzero(~found)
        found[left] = _span(points[left], self.error[left]) < math.pi
        return found


def _span(points: Complex, error: Vector) -> Vector:
    """Of the angles of all values, rad (K,): infinite where control points (K, …) are within their error (K,)."""
    sizes = np.abs(points)
    least = sizes.min(axis=1, initial=np.inf) > error
    with np.errstate(divide="ignore", invalid="ignore"):
        units = points / sizes
        mean = units.sum(axis=1).conj()[:, None]
        turned = np.angle(units * mean)
        wide = np.arcsin(np.minimum(error[:, None] / sizes, 1.0))
        found = (turned + wide).max(axis=1) - (turned - wide).min(axis=1)
    # Where units cancel the mean has no angle, and they lie on no side of a line.
    least &= np.abs(mean[:, 0]) > CANCELLED * points.shape[1]
    return np.where(least & np.isfinite(found), found, np.inf)


def cells_of(of: Characteristic, low: Vector, high: Vector) -> Cells:
    """The cells [low, high] (K,) over the box of a characteristic function; of some both halves."""
    cells, cut = _cells_of(of, low, high)
    for _ in range(FINER):
        values = np.median(np.abs(cells.points.reshape(len(cut), -1)), axis=1)
        # Of halves `cut` is 2^DEGREE times smaller, and the rest is no larger.
        coarse = (cells.error > FINE * values) & (cut > cells.error / 2)
        if not coarse.any():
            break
        low, high = cells.low[coarse], cells.high[coarse]
        middle, both = (low + high) / 2, np.concatenate
        halves, of_halves = _cells_of(of, both([low, middle]), both([middle, high]))
        cells, cut = cells.chosen(~coarse).joined([halves]), both([cut[~coarse], of_halves])
    return cells


def _cells_of(of: Characteristic, low: Vector, high: Vector) -> tuple[Cells, Vector]:
    """These cells themselves, and what of R the interpolation in ω makes."""
    at = nodes_of(DEGREE, chebyshev=True)
    omega = low[:, None] + (high - low)[:, None] * at
    error = of.aliases.error(low, high)
    points, sensitivity, rounding = _values(of, omega, error)
    amplified = constant = 1.0
    for axis, nodes in [(1, at), *((2 + i, of.nodes(i)) for i in range(len(of.low)))]:
        matrix = to_bernstein(nodes)
        points = _along(points, matrix, axis)
        amplified *= float(np.abs(matrix).sum(axis=1).max())
        constant *= lebesgue(nodes)
    cut, rest = _remainders(of, low, high, error)
    return Cells(low, high, points, cut + rest + sensitivity * constant + rounding * amplified), cut


def _values(of: Characteristic, omega: Vector, error: Vector) -> tuple[Complex, Vector, Vector]:
    """Q (K, DEGREE + 1, nodes in each θ …), and the most that two errors move it there to the first order, (K,) each.

    These are an error (K, 2r, r) of the aliases, and rounding: a determinant by elimination is that of a matrix whose
    entries differ by some units of the largest in their column, or of its terms; ∂p/∂N_ij = p · [N⁻¹]_ji.
    """
    s = np.asarray(1j * omega.ravel() - of.decay, dtype=np.complex128)
    smooth, own = list(of.smooth), [i for i in range(len(of.low)) if i not in of.smooth]
    grid = of.grid([*own, *smooth])
    thetas = grid.reshape(-1, len(of.dead_times), len(of.low))
    aliases = of.aliases.at(omega.ravel())
    weights = np.repeat(error.transpose(0, 2, 1), omega.shape[1], axis=0)
    found, moved, rounded = list[Complex](), np.zeros(len(s)), list[Vector]()
    for k, (members, ports) in enumerate(of.seen(thetas)):
        each = [members.mass, members.damping, members.stiffness]
        machines = Machines(*(x[:1] for x in each)) if all(np.all(x == x[:1]) for x in each) else members
        pencil = _pencil(of, machines, ports, s, aliases)
        sign, size = np.linalg.slogdet(pencil)
        value = sign * np.exp(size)
        found.append(value)
        inverse = np.linalg.inv(pencil)
        size = np.abs(pencil).max(axis=-2)
        # Near resonance what an entry is made of is more than what is left.
        made = Machines(*(np.abs(x) for x in (machines.mass, machines.damping, machines.stiffness)))
        n, terms = len(ports.force), made.pencil(np.abs(s)).real.max(axis=-2)
        size[..., :n] = np.maximum(size[..., :n], terms)
        rounded.append((np.abs(inverse).sum(axis=-1) * size).sum(axis=-1))
        if k == 0:
            # ∂p/∂𝓔_ij = p · [Y N⁻¹ W]_ji, W the columns through which aliases enter.
            into, rows = _entrance(of), slice(*_places(of, len(ports.force))[1])
            solved = np.abs(inverse[..., rows, :] @ into)
            moved = np.abs(value) * (solved * weights[:, None, None]).sum(axis=(-2, -1))
    both = found[0] * found[1].conj()
    worst = [
        each.reshape(*omega.shape, -1).max(axis=(1, 2))
        for each in (moved * np.abs(found[1]), ROUNDING * np.abs(both) * (rounded[0] + rounded[1]))
    ]
    both = both.reshape(*omega.shape, *grid.shape[:-1])
    return np.moveaxis(both, range(2, both.ndim), [2 + i for i in (*own, *smooth)]), worst[0], worst[1]


def _places(of: Characteristic, n: int) -> list[tuple[int, int]]:
    """Where torques, forces and the law's states stand behind n coordinates."""
    t, (r, _), k = len(of.servo[0]), of.law.force.shape, len(of.law.law)
    return [(n, n + t), (n + t, n + t + r), (n + t + r, n + t + r + k)]


def _entrance(of: Characteristic) -> Vector:
    """W: what the aliases' rows are multiplied by, below the machine's coordinates and torques."""
    law, k = of.law, len(of.law.law)
    n = len(of.motions.loop.to_q) + len(of.servo[0])
    return np.vstack([np.zeros((n, law.force.shape[1] - k)), -law.force[:, k:], -law.law[:, k:]])


def _pencil(of: Characteristic, machines: Machines, ports: Ports, s: Complex, aliases: Complex) -> Complex:
    """The matrix (len(s), members, dead times, …) of `characteristic`."""
    n, law, (servo, into) = machines.mass.shape[-1], of.law, of.servo
    (_, (torque, force), (_, size)), k = _places(of, n), len(law.law)
    late = hold(s[:, None], of.period, of.dead_times)[:, None, :, None, None]
    at = s[:, None, None, None, None]
    measured = ports.position + at * ports.rate
    found = np.zeros((len(s), *machines.mass.shape[:2], size, size), dtype=complex)
    found[..., :n, :n] = machines.pencil(s)
    neutral, unbraked = of.neutral[0].shape[1], of.neutral[1]
    found[..., :n, :neutral] = at * machines.mass[..., :neutral] + machines.damping[..., :neutral]
    found[..., :n, :unbraked] = machines.mass[..., :unbraked]
    found[..., :n, n:torque] = -ports.servo
    found[..., :n, torque:force] = -late * ports.force
    found[..., n:torque, n:torque] = at * np.eye(torque - n) - servo
    found[..., n:torque, torque:force] = -late * into
    for rows, matrix in ((slice(torque, force), law.force), (slice(force, size), law.law)):
        found[..., rows, :n] = -matrix[:, k:] @ measured
        found[..., rows, :neutral] = 0.0
        found[..., rows, torque:force] = -(matrix[:, k:] @ aliases)[:, None]
        found[..., rows, force:] = -matrix[:, :k]
    found[..., torque:, torque:] += np.diag(np.repeat([1.0, 0.0], [force - torque, size - force]))
    found[..., force:, force:] += np.exp(at * of.period) * np.eye(size - force)
    return found


# Bounds.


def _remainders(of: Characteristic, low: Vector, high: Vector, error: Vector) -> tuple[Vector, Vector]:
    """Of R (K,): what interpolation in ω makes, and what that in masses and dead time and second orders do.

    Multiples of the aliases' error are let in everywhere: Cauchy's bounds in it are those of the terms of higher order,
    and of what interpolation makes of the first one.
    """
    middle, half = (low + high) / 2, (high - low) / 2
    cut, still = np.full(len(low), np.inf), np.zeros(len(low))
    for size in ELLIPSES:
        wide, tall = half * (size + 1 / size) / 2, half * (size - 1 / size) / 2
        bound = _largest(of, middle + wide, tall, of.aliases.near(wide, tall) + SOME * error)
        cut = np.fmin(cut, (1 + 1 / SOME) * 4 * bound * size**-DEGREE / (size - 1))
    aliases = of.aliases.near(still, still)
    bounds = [_largest(of, high, still, aliases + farther * error) for farther in FARTHER]
    second = np.min([b / (f * (f - 1)) for b, f in zip(bounds, FARTHER, strict=True)], axis=0)
    smooth = np.zeros(len(low))
    for axis in of.smooth:
        smooth = smooth + _smooth_remainder(of, axis, high, error)
    others = lebesgue(nodes_of(DEGREE, chebyshev=True)) * math.prod(lebesgue(of.nodes(i)) for i in of.smooth)
    return cut, second + others * smooth


def _smooth_remainder(of: Characteristic, axis: int, high: Vector, error: Vector) -> Vector:
    """What the interpolation in a smooth θ leaves (K,)."""
    size, still, found = of.decay + high, np.zeros(len(high)), np.full(len(high), np.inf)
    half = (of.high[axis] - of.low[axis]) / 2
    for ellipse in ELLIPSES:
        wide, tall = (ellipse + 1 / ellipse) / 2, (ellipse - 1 / ellipse) / 2
        near = of.aliases.near(still, still, axis, ellipse) + SOME * error
        if axis == of.late:
            turned = np.exp(of.decay * half * (1 + wide) + size * half * tall)
            bound = _largest(of, high, still, near, turned=turned)
        else:
            bound = _largest(of, high, still, near, stretch=wide)
        found = np.fmin(found, (1 + 1 / SOME) * 4 * bound * ellipse ** -of.degrees[axis] / (ellipse - 1))
    return found


def _largest(
    of: Characteristic, reach: Vector, tall: Vector, aliases: Vector, turned: Vector | float = 1.0, stretch: float = 0.0
) -> Vector:
    """A bound on q (K,) where |ω| ≤ reach, |Im ω| ≤ tall and aliases (K, 2r, r) are no larger than these.

    Where h is `turned`, and masses are complex, `stretch` times as far from the middle as those of the box.
    """
    law, (servo, into), k = of.law, of.servo, len(of.law.law)
    size, real = of.decay + reach, of.decay + tall
    z, at = np.exp(real * of.period), size[:, None, None]
    late = np.asarray(z * np.exp(real * of.dead_times.max()) * turned)[:, None, None]
    found, neutral, unbraked = np.ones(len(reach)), of.neutral[0].shape[1], of.neutral[1]
    for most, apart, ports in of.largest:
        n = len(most.mass)
        (_, (torque, force), (_, whole)) = _places(of, n)
        bound = np.zeros((len(reach), whole, whole))
        bound[:, :n, :n] = at * at * (most.mass + stretch * apart.mass) + at * most.damping + most.stiffness
        bound[:, :n, :neutral] = at * (most.mass + stretch * apart.mass)[:, :neutral] + most.damping[:, :neutral]
        bound[:, :n, :unbraked] = (most.mass + stretch * apart.mass)[:, :unbraked]
        bound[:, :n, n:torque] = np.abs(ports.servo)
        bound[:, :n, torque:force] = late * np.abs(ports.force)
        bound[:, n:torque, n:torque] = at * np.eye(torque - n) + np.abs(servo)
        bound[:, n:torque, torque:force] = late * np.abs(into)
        measured = np.abs(ports.position) + at * np.abs(ports.rate)
        for rows, matrix in ((slice(torque, force), law.force), (slice(force, whole), law.law)):
            seen = np.abs(matrix[:, k:])
            bound[:, rows, :n] = seen @ measured
            bound[:, rows, torque:force] = seen @ aliases
            bound[:, rows, force:] = np.abs(matrix[:, :k])
        bound[:, torque:force, torque:force] += np.eye(force - torque)
        bound[:, force:, force:] += z[:, None, None] * np.eye(whole - force)
        found = found * _hadamard(bound)
    return found


def _hadamard(bound: Vector) -> Vector:
    """A bound on determinants (K,) from one on the entries (K, n, n): the product of rows, columns scaled before."""
    scale = np.ones(bound.shape[:2])
    for _ in range(SCALINGS):
        scaled = bound / scale[:, None, :]
        scaled = scaled / np.linalg.norm(scaled, axis=2, keepdims=True)
        scale = scale * np.maximum(np.linalg.norm(scaled, axis=1), 1e-100)
    rows = np.linalg.norm(bound / scale[:, None, :], axis=2)
    found: Vector = np.exp(np.log(rows).sum(axis=1) + np.log(scale).sum(axis=1)) * (1 + 1e-9)
    return found


def _along(points: Complex, matrix: Vector, axis: int) -> Complex:
    """A matrix applied to one axis."""
    return np.moveaxis(np.tensordot(matrix, points, axes=(1, axis)), 0, axis)
