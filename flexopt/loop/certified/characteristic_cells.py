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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import ComplexArray, Vector
from flexopt.loop.certified.aliases import hold
from flexopt.loop.certified.bernstein import lebesgue, nodes_of, splitting, to_bernstein
from flexopt.loop.certified.characteristic import Characteristic
from flexopt.loop.certified.characteristic_bounds import TINY, remainders
from flexopt.loop.members import Machines, Ports

# Degree in ω.
DEGREE = 8
# Share of the values that R may be; cells are halved, so often at most, where it is more for want of degrees in ω.
FINE, FINER = 1e-5, 8
# Rounding: so many unit roundoffs of the largest entry of its column in every entry of a determinant.
ROUNDING = 64 * float(np.finfo(float).eps)
# Of what else R is, a bound on rounding that needs none closer.
FAINT = 0.05


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
    points: ComplexArray
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

    def _ends(self, but: int | None = None) -> ComplexArray:
        """Control points that are values: at the ends of ω and of every θ, of one at all nodes."""
        ends = [slice(None, None, max(n - 1, 1)) for n in self.points.shape[1:]]
        if but is not None:
            ends[1 + but] = slice(None)
        return self.points[(slice(None), *ends)]

    def open_halves(self, splits: Mapping[int, float]) -> dict[int, int]:
        """By θ_axis: split there, in how many cells of both parts of the box values at the ends leave zero open."""
        parts = list[ComplexArray]()
        for axis, at in splits.items():
            lines, degree = self._ends(axis), self.points.shape[2 + axis] - 1
            middle = np.moveaxis(lines, 2 + axis, -1) @ splitting(degree, at)[0][-1]
            parts += [np.stack([middle, lines.take(end, axis=2 + axis)], axis=1) for end in (0, -1)]
        ends = np.concatenate([part.reshape(len(part), -1) for part in parts])
        parted = _parted(ends, np.tile(self.error, len(parts))).reshape(len(splits), -1)
        return dict(zip(splits, np.sum(~parted, axis=1).tolist(), strict=True))

    def open_by_remainders(self, least: float) -> float:
        """Share of the cells that would leave zero out without remainders; 0 where it is less than `least`."""
        nothing = np.zeros_like(self.error)
        # Corners alone cost little, and leave zero out in every cell where all control points do.
        if np.mean(_parted(self._ends().reshape(len(self.points), -1), nothing)) < least:
            return 0.0
        return float(np.mean(replace(self, error=nothing).exclude_zero))

    @property
    def exclude_zero(self) -> NDArray[np.bool_]:
        """Whether no value is zero (K,): some line has all control points on one side of it, R away at least."""
        # Where no line parts the corners from zero none does all points.
        found = _parted(self._ends().reshape(len(self.points), -1), self.error)
        left = np.flatnonzero(found)
        found[left] = _parted(self.points[left].reshape(len(left), math.prod(self.points.shape[1:])), self.error[left])
        return found


def _parted(points: ComplexArray, error: Vector) -> NDArray[np.bool_]:
    """Whether some line through zero has all points (K, …) on one side, their error (K,) away at least."""
    # Of most cells the line across the mean is one.
    ahead, mean = _ahead(points, points.sum(axis=1))
    found: NDArray[np.bool_] = ahead.min(axis=1, initial=np.inf) > error
    left = np.flatnonzero(~found)
    if len(left):
        between, open_angle = _between(points[left], mean[left], error[left])
        left, between = left[open_angle], between[open_angle]
        found[left] = _ahead(points[left], between)[0].min(axis=1, initial=np.inf) > error[left]
    return found


def _ahead(points: ComplexArray, direction: ComplexArray) -> tuple[Vector, ComplexArray]:
    """How far points (K, …) are in a direction (K,), and that with the length of one."""
    direction = direction / np.maximum(np.abs(direction), TINY)
    return points.real * direction.real[:, None] + points.imag * direction.imag[:, None], direction


def _between(points: ComplexArray, mean: ComplexArray, error: Vector) -> tuple[ComplexArray, NDArray[np.bool_]]:
    """The direction (K,) halfway between the outermost of discs about points (K, …), and whether it can part them."""
    turned = points * mean.conj()[:, None]
    angle = np.arctan2(turned.imag, turned.real)
    # Half the angle that a disc fills.
    half = np.arcsin(np.minimum(error[:, None] / np.maximum(np.abs(points), TINY), 1.0))
    first, last = (angle - half).min(axis=1, initial=0.0), (angle + half).max(axis=1, initial=0.0)
    middle = (first + last) / 2
    return mean * (np.cos(middle) + 1j * np.sin(middle)), last - first < np.pi


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
    # Where nothing bounds the aliases nothing is excluded, and no infinity is to meet a zero on the way.
    bounded: NDArray[np.bool_] = np.asarray(np.isfinite(error).all(axis=(1, 2)))
    error = np.where(bounded[:, None, None], error, 0.0)
    cut, rest = remainders(of, DEGREE, low, high, error)
    axes = [(1, at), *((2 + i, of.nodes(i)) for i in range(len(of.low)))]
    matrices = {axis: to_bernstein(nodes) for axis, nodes in axes}
    amplified = math.prod(float(np.abs(matrix).sum(axis=1).max()) for matrix in matrices.values())
    constant = math.prod(lebesgue(nodes) for _, nodes in axes)
    points, sensitivity, rounding = _values(of, omega, error, FAINT * (cut + rest) / amplified)
    for axis, matrix in matrices.items():
        points = _along(points, matrix, axis)
    total = np.where(bounded, cut + rest + sensitivity * constant + rounding * amplified, np.inf)
    return Cells(low, high, points, total), cut


def _values(of: Characteristic, omega: Vector, error: Vector, faint: Vector) -> tuple[ComplexArray, Vector, Vector]:
    """Q (K, DEGREE + 1, nodes in each θ …), and the most that two errors move it there to the first order, (K,) each.

    These are an error (K, 2r, r) of the aliases, and rounding: a determinant by elimination is that of a matrix whose
    entries differ by some units of the largest in their column, or of its terms; ∂p/∂N_ij = p · [N⁻¹]_ji. Below
    `faint` (K,) it is a bound that is not sharp.
    """
    s = np.asarray(1j * omega.ravel() - of.decay, dtype=np.complex128)
    smooth, own = list(of.smooth), [i for i in range(len(of.low)) if i not in of.smooth]
    grid = of.grid([*own, *smooth])
    thetas = grid.reshape(-1, len(of.dead_times), len(of.low))
    aliases = of.aliases.at(omega.ravel())
    weights = np.repeat(error.transpose(0, 2, 1), omega.shape[1], axis=0)
    found, pencils, sizes = list[ComplexArray](), list[ComplexArray](), list[Vector]()
    for members, ports in of.seen(thetas):
        each = [members.mass, members.damping, members.stiffness]
        machines = Machines(*(x[:1] for x in each)) if all(np.all(x == x[:1]) for x in each) else members
        pencil = _pencil(of, machines, ports, s, aliases)
        sign, size = np.linalg.slogdet(pencil)
        found.append(sign * np.exp(size))
        pencils.append(pencil)
        sizes.append(_sizes(machines, pencil, s))
    # ∂p/∂𝓔_ij = p · [Y N⁻¹ W]_ji, W the columns through which aliases enter.
    n = len(of.motions.loop.to_q)
    solved = np.linalg.solve(pencils[0], _entrance(of).astype(complex))[..., slice(*of.places(n)[1]), :]
    moved = np.abs(found[0]) * (np.abs(solved) * weights[:, None, None]).sum(axis=(-2, -1))

    both, cells = found[0] * found[1].conj(), (*omega.shape, -1)
    sensitivity = (moved * np.abs(found[1])).reshape(cells).max(axis=(1, 2))
    lost = [_lost(pencils[k], sizes[k]) * np.abs(found[1 - k]) for k in (0, 1)]
    rounding = ROUNDING * (lost[0] + lost[1]).reshape(cells).max(axis=(1, 2))
    # A bound on cofactors where it is enough, themselves where it is not.
    more = rounding > faint + FAINT * sensitivity
    for k in (0, 1) if more.any() else ():
        which = np.repeat(more, omega.shape[1])
        inverse = np.abs(np.linalg.inv(pencils[k][which])).sum(axis=-1)
        lost[k][which] = (inverse * sizes[k][which]).sum(axis=-1) * np.abs(both[which])
    rounding = ROUNDING * (lost[0] + lost[1]).reshape(cells).max(axis=(1, 2))
    both = both.reshape(*omega.shape, *grid.shape[:-1])
    return np.moveaxis(both, range(2, both.ndim), [2 + i for i in (*own, *smooth)]), sensitivity, rounding


def _sizes(machines: Machines, pencil: ComplexArray, s: ComplexArray) -> Vector:
    """Of columns (…, n): the largest entry, or what it is made of where near resonance that is more."""
    found = np.abs(pencil).max(axis=-2)
    at, n = np.abs(s).reshape(-1, *(1,) * (machines.mass.ndim - 1)), machines.mass.shape[-1]
    mass, damping, stiffness = (np.abs(x).max(axis=-2) for x in (machines.mass, machines.damping, machines.stiffness))
    found[..., :n] = np.maximum(found[..., :n], at * at * mass + at * damping + stiffness)
    return found


def _lost(pencil: ComplexArray, sizes: Vector) -> Vector:
    """A bound on Σ_ij sizes_j |cofactor_ij| (…,): a cofactor is at most the product of the other columns' lengths."""
    squares: Vector = pencil.real**2 + pencil.imag**2
    rows: Vector = np.sqrt(squares.sum(axis=-1).reshape(-1, squares.shape[-1]).max(axis=0))
    columns: Vector = np.sqrt(rows**-2.0 @ squares)
    of_rows = float(np.prod(rows) * np.linalg.norm(1 / rows))
    found: Vector = of_rows * np.prod(columns, axis=-1) * (sizes / columns).sum(axis=-1)
    return found


def _entrance(of: Characteristic) -> Vector:
    """W: what the aliases' rows are multiplied by, below the machine's coordinates and torques."""
    law, k = of.law, len(of.law.law)
    n = len(of.motions.loop.to_q) + len(of.servo[0])
    return np.vstack([np.zeros((n, law.force.shape[1] - k)), -law.force[:, k:], -law.law[:, k:]])


def _pencil(
    of: Characteristic, machines: Machines, ports: Ports, s: ComplexArray, aliases: ComplexArray
) -> ComplexArray:
    """The matrix (len(s), members, dead times, …) of `characteristic`."""
    n, law, (servo, into) = machines.mass.shape[-1], of.law, of.servo
    (_, (torque, force), (_, size)), k = of.places(n), len(law.law)
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


def _along(points: ComplexArray, matrix: Vector, axis: int) -> ComplexArray:
    """A matrix applied to one axis."""
    shape = points.shape
    rows = points.reshape(math.prod(shape[:axis]), shape[axis], math.prod(shape[axis + 1 :]))
    return (matrix @ rows).reshape(*shape[:axis], len(matrix), *shape[axis + 1 :])
