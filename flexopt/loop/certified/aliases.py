"""What sampling adds to the response of an uncertain machine: the aliases, as a table, and bounds on what that leaves.

In: a `Characteristic`. Out: `Aliases`: 𝓔(s) of the machines with the springs and dampers of the box's middle, as a
Chebyshev series in ω, masses and dead time; how far that of any member may be from it, how large it is off the axis.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from flexopt.foundation.arrays import ComplexArray, Vector
from flexopt.loop.certified.bernstein import chebyshev, lebesgue, to_chebyshev
from flexopt.loop.members import Machines
from flexopt.loop.tangent import exponential

if TYPE_CHECKING:
    from flexopt.loop.certified.characteristic import Characteristic

# Nodes of the table in ω; an even number, as at s = 0 aliases are a difference of two poles.
TABLE = 40
# Aliases that are summed one by one, the others by an integral.
SUMMED = 24
# Sizes of the ellipses that remainders are bounded over.
ELLIPSES = (3.0, 4.5, 6.0, 8.0, 11.0, 15.0, 20.0, 27.0, 40.0, 60.0, 90.0)
# Rounding of a table's values, in units in the last place of what they are the difference of.
LOST = 64 * float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Aliases:
    """𝓔 of the machines of a box; l is the whole samples of their dead time.

    Attributes:
        of: the box.
    """

    of: Characteristic

    def both(self, s: ComplexArray, thetas: Vector) -> tuple[ComplexArray, ComplexArray]:
        """Two (N, len(s), 2r, r) of which 𝓔 z^l of members (N, k) is the difference.

        P and all its aliases, from one sample's matrices exactly, and h P.
        """
        of, period = self.of, self.of.period
        flows, drives = of.flows(thetas)
        drives = drives @ of.law.spread
        late = np.maximum(of.loop.box.numbers_at(thetas.T)[1] - of.whole * period, 0.0)
        held, _ = exponential(flows, drives, period)
        (rest, first), (_, last) = (_over(flows, drives, span) for span in (period - late, late))
        z, one = np.exp(s * period)[:, None, None], np.eye(flows.shape[-1])
        into = first[:, None] + (rest @ last)[:, None] / z
        sampled = of.law.measured @ np.linalg.solve(z * one - held[:, None], into)
        pencil = s[:, None, None] * one - flows[:, None]
        here = of.law.measured @ np.linalg.solve(pencil, np.broadcast_to(drives[:, None], into.shape).astype(complex))
        whole = np.asarray(sampled, dtype=np.complex128)
        return whole, hold(s, period, late[:, None])[..., None, None] * here

    # Bounds from norms.

    @cached_property
    def _norms(self) -> tuple[tuple[float, float, float], ...]:
        """Of M, D and K: of the corners, how far from the middle, and that where masses are those of the middle."""
        of = self.of
        corners, middle, _ = of.free
        held = of.corners.copy()
        held[:, list(of.masses)] = of.middle[list(of.masses)]
        apart = of.machines(held).seen(of.modes[0]).less(middle)
        return corners.norms, corners.less(middle).norms, apart.norms

    @cached_property
    def _drives(self) -> tuple[float, float, float]:
        """‖B E‖, ‖B_τ‖ ‖B_s E‖ and the fastest servo."""
        ports, (servo, into) = self.of.free[2], self.of.servo
        pushed = float(np.linalg.norm(ports.servo, 2) * np.linalg.norm(into, 2)) if len(servo) else 0.0
        return float(np.linalg.norm(ports.force, 2)), pushed, float(np.abs(servo).max(initial=0.0))

    @cached_property
    def _sides(self) -> tuple[Vector, Vector, Vector, Vector]:
        """Norms of c Δ, c Z, Δ b and Z b, c the rows of C, in terms of x², x and 1: (…, 3).

        Δ is how far springs and dampers of members are from the middle's, Z that of members less x².
        """
        of = self.of
        corners, middle, ports = of.free
        held = of.corners.copy()
        held[:, list(of.masses)] = of.middle[list(of.masses)]
        apart = of.machines(held).seen(of.modes[0]).less(middle)
        rest = Machines(corners.mass - np.eye(len(middle.mass)), corners.damping, corners.stiffness)
        c, b = ports.position + ports.rate, np.hstack([ports.force, ports.servo])
        rows, columns = list[Vector](), list[Vector]()
        for of_z in (apart, rest):
            each = (of_z.mass, of_z.damping, of_z.stiffness)
            rows.append(np.array([np.linalg.norm(c @ x, axis=2).max(axis=0) for x in each]).T)
            columns.append(np.array([np.linalg.norm(x @ b, 2, axis=(1, 2)).max() for x in each]))
        return rows[0], rows[1], columns[0], columns[1]

    def second(self, high: Vector) -> Vector:
        """A bound on what is left of 𝓔 z^l behind the first order in springs and dampers, ω up to `high`, (K, 2r, 1).

        C Z⁻¹ Δ Z⁻¹ Δ Z⁻¹ B for each alias, where c Z⁻¹ Δ = (c Δ − c (Z − x²) Z⁻¹ Δ) / x², and Δ Z⁻¹ b likewise.
        """
        of, (most, differ, own), (_, pushed, slow) = self.of, self._norms, self._drives
        size, real = high + of.decay, np.full(len(high), of.decay)
        x = math.tau / of.period * np.arange(1, SUMMED + 1) - size[:, None]
        c_delta, c_rest, delta_b, rest_b = self._sides
        powers = np.stack([x**2, x, np.ones_like(x)])
        moved = (1 - differ[0]) - most[1] / x - most[2] / x**2
        delta = np.tensordot(np.array(own), powers, axes=1)
        left = np.tensordot(c_delta, powers, axes=1) + np.tensordot(c_rest, powers, axes=1) * delta / (x**2 * moved)
        right = np.tensordot(delta_b, powers, axes=1) + np.tensordot(rest_b, powers, axes=1) * delta / (x**2 * moved)
        # What forces of servos are in units of those of the law.
        share = 1.0 + (pushed / max(np.linalg.norm(of.free[2].servo, 2), 1e-300) / (x - slow) if pushed else 0.0)
        term = left / x**2 * right / x**2 * share / (moved * x**2)
        r = len(of.law.force)
        term[:r] = term[:r] / x
        total = 2 * (term.sum(axis=-1) + term[..., -1] * x[..., -1] * of.period / math.tau)
        late = min(of.ends_of_dead_time[1] - of.whole * of.period, of.period)
        over = np.exp(real * of.period)
        scale = np.minimum(1 + over, size * of.period * over) * np.exp(real * late) / of.period
        sharp = np.where(np.all((moved > 0) & (x > slow), axis=1), total * scale, np.inf).T[:, :, None]
        return np.asarray(np.fmin(sharp, self.bound(size, real, apart=2)))

    def bound(self, size: Vector, real: Vector, *, apart: int = 0, stretch: float = 1.0) -> Vector:
        """A bound on |𝓔 z^l| of every member where |s| ≤ size and |Re s| ≤ real, (…, 2r, 1).

        Where `apart` on what is left of it behind so many terms of its Taylor series in springs and dampers; masses
        may be complex, and `stretch` times as far from the middle as those of the box.
        """
        ports, (most, differ, own), period = self.of.free[2], self._norms, self.of.period
        force, pushed, slow = self._drives
        x = math.tau / period * np.arange(1, SUMMED + 1) - size[..., None]
        with np.errstate(divide="ignore", invalid="ignore"):
            moved = (1 - stretch * differ[0]) - most[1] / x - most[2] / x**2
            # Each alias: |h| ≤ |1 − e^{−sT}| e^{|Re s| δ} / (x T), and ‖Z⁻¹‖ ≤ 1 / (x² · moved).
            term = (force + pushed / (x - slow)) / moved / x**2
            term = term * ((own[0] + own[1] / x + own[2] / x**2) / moved) ** apart
            # Behind the last one terms fall at least as its x⁻².
            rates = 2 * (term.sum(axis=-1) + term[..., -1] * x[..., -1] * period / math.tau)
            term = term / x
            places = 2 * (term.sum(axis=-1) + term[..., -1] * x[..., -1] * period / math.tau)
        late = min(self.of.ends_of_dead_time[1] - self.of.whole * period, period)
        # |1 − e^{−sT}|, of all aliases the same.
        over = np.exp(real * period)
        scale = np.minimum(1 + over, size * period * over) * np.exp(real * late) / period
        rows = np.linalg.norm(ports.position, axis=1), np.linalg.norm(ports.rate, axis=1)
        found = scale[..., None] * (rates[..., None] * rows[1] + places[..., None] * rows[0])
        bad = (x[..., 0] <= slow) | (moved[..., 0] <= 0)
        return np.where(bad[..., None], np.inf, found)[..., None]

    def _late_slope(self, size: Vector) -> Callable[[float], Vector]:
        """A bound on |∂𝓔/∂d| e^{sd} (len(size), 2r, 1) by how far d/T is from the real ones of the box.

        With Y = s − A it is (1 − 1/z) z^{−l} C Σ_{k≥1} B_k(x) (YT)^{k−1} / k! B, B_k Bernoulli's polynomials in
        x = δ/T, of which |B_k(x)| ≤ 4 k! / (2π)^k, for k ≥ 1 and x in [0, 1].
        """
        of, (most, differ, _) = self.of, self._norms
        ports, (force, pushed, slow) = of.free[2], self._drives
        moved = 1 - differ[0]
        base = math.sqrt(max(most[2] / moved, 1.0))
        flow = base + most[1] / moved + (1.0 + slow if len(of.servo[0]) else 0.0)
        drive = (force + pushed) / moved
        rows = np.hypot(np.linalg.norm(ports.position, axis=1) / base, np.linalg.norm(ports.rate, axis=1))
        y = (size + flow) * of.period
        part = y / math.tau

        def slope(apart: float) -> Vector:
            with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
                series = ((1 + 4 * part / (1 - part)) * np.exp(y * apart) - 1) / y
            series = np.where(part < 1, series, np.inf) * 2 * math.exp(of.decay * of.period * (of.whole + 2))
            return np.asarray((series[:, None] * rows * drive)[..., None])

        return slope

    # The table.

    @cached_property
    def table(self) -> ComplexArray:
        """Chebyshev coefficients (TABLE, …, 2r, r) of 𝓔 z^l over ω / (π/T) in [−1, 1], at the nodes of `smooth` θ."""
        return self._tabled(self.of.grid(self.of.smooth))[0]

    def _tabled(self, thetas: Vector) -> tuple[ComplexArray, Vector]:
        """The table of members (…, k), and its rounding (2r, 1)."""
        of, nodes, flat = (
            self.of,
            np.cos(np.pi * (np.arange(TABLE) + 0.5) / TABLE),
            thetas.reshape(-1, thetas.shape[-1]),
        )
        s = 1j * of.nyquist * nodes[: TABLE // 2] - of.decay
        both = self.both(s, flat)
        lost = LOST * np.max([np.abs(each).max(axis=(0, 1, 3)) for each in both], axis=0)[:, None]
        values = both[0] - both[1]
        values = np.concatenate([values, values[:, ::-1].conj()], axis=1)
        found = np.einsum("kn,dnij->kdij", to_chebyshev(nodes), values)
        return found.reshape(TABLE, *thetas.shape[:-1], *found.shape[2:]).astype(np.complex128), lost

    @property
    def _flat(self) -> ComplexArray:
        """The table with one axis of all nodes."""
        return self.table.reshape(TABLE, -1, *self.table.shape[-2:])

    def at(self, omega: Vector) -> ComplexArray:
        """𝓔 (len(omega), nodes of smooth θ, 2r, r)."""
        of = self.of
        z = np.exp((1j * omega - of.decay) * of.period) ** -of.whole
        found = np.tensordot(chebyshev(TABLE, omega / of.nyquist), self._flat, axes=1)
        return np.asarray(z[:, None, None, None] * found, dtype=np.complex128)

    def near(self, wide: Vector, tall: Vector, axis: int | None = None, ellipse: float = 1.0) -> Vector:
        """A bound on 𝓔 (K, 2r, r) of the table, ω complex: within `wide` and `tall` of real ones.

        Of θ_axis, a smooth one, in the ellipse of that size about its ends, the others real.
        """
        of, bound = self.of, self.table
        others = [i for i in of.smooth if i != axis]
        if axis is not None:
            place, nodes = 1 + of.smooth.index(axis), 1 - 2 * of.nodes(axis)
            powers = ellipse ** np.arange(len(nodes))
            bound = np.tensordot(powers, np.abs(np.tensordot(to_chebyshev(nodes), bound, axes=(1, place))), axes=1)
        largest = np.abs(bound.reshape(TABLE, -1, *self.table.shape[-2:])).max(axis=1)
        reach = 1 + wide / of.nyquist
        size = reach + np.sqrt(reach**2 - 1)
        found = np.einsum("ck,kij->cij", size[:, None] ** np.arange(TABLE), largest)
        grown = np.exp((of.decay + tall) * of.period * of.whole)[:, None, None]
        return np.asarray(found * grown * math.prod(lebesgue(of.nodes(i)) for i in others))

    # How far members are from the table.

    @cached_property
    def _differences(self) -> ComplexArray:
        """Of the tables of all corners in θ that are not smooth from that, (2^…, TABLE, nodes, 2r, r)."""
        of, found = self.of, list[ComplexArray]()
        own = [i for i in range(len(of.low)) if i not in of.smooth and of.low[i] < of.high[i]]
        for corner in product(*((of.low[i], of.high[i]) for i in own)):
            thetas = of.grid(of.smooth)
            thetas[..., own] = corner
            found.append(self._tabled(thetas)[0].reshape(self._flat.shape) - self._flat)
        return np.array(found)

    @cached_property
    def _cut(self) -> Vector:
        """A bound on what the table lacks for ω up to π/T, (2r, 1): Cauchy's, over ellipses; and its rounding."""
        of, sizes = self.of, np.linspace(1.05, 6.0, 100)
        wide, high = (sizes + 1 / sizes) / 2, (sizes - 1 / sizes) / 2
        bound = self.bound(of.decay + of.nyquist * wide, of.decay + of.nyquist * high)
        cut = 4 * bound * (sizes ** -(TABLE - 1.0) / (sizes - 1))[:, None, None]
        return np.asarray(np.nanmin(cut, axis=0) + self._tabled(of.middle)[1])

    def _smooth_cut(self, high: Vector) -> Vector:
        """The like of interpolation in the smooth θ, for ω up to `high`, (len(high), 2r, 1)."""
        of, size, real = self.of, high + self.of.decay, np.full(len(high), self.of.decay)
        found = np.zeros((len(high), 2 * len(of.law.force), 1))
        for axis in of.smooth:
            least = np.full(found.shape, np.inf)
            for ellipse in ELLIPSES:
                wide, tall = (ellipse + 1 / ellipse) / 2, (ellipse - 1 / ellipse) / 2
                if axis == of.late:
                    half = (of.high[axis] - of.low[axis]) / 2
                    turned = np.exp(of.decay * (of.high[axis] + half * wide) + size * half * tall)[:, None, None]
                    slope = self._late_slope(size)(half * wide / of.period)
                    bound = self.bound(size, real) + 2 * half * wide * slope * turned
                else:
                    bound = self.bound(size, real, stretch=wide)
                least = np.fmin(least, 4 * bound * ellipse ** -of.degrees[axis] / (ellipse - 1))
            found = found + least
        return np.asarray(found * math.prod(lebesgue(of.nodes(i)) for i in of.smooth))

    def error(self, low: Vector, high: Vector) -> Vector:
        """How far 𝓔 of any member may be from the table's, ω in cells [low, high] (K,): (K, 2r, r).

        To the first order a member is a mean of the corners, of which it is known; what is left is of second order, for
        the members and the corners.
        """
        of = self.of
        each = chebyshev(TABLE, np.stack([low, (low + high) / 2, high]) / of.nyquist)
        known = np.abs(np.tensordot(each, self._differences, axes=(2, 1))).max(axis=0)
        # Between these three, a quarter of the cell away at most.
        slopes = np.einsum("k,ckdij->cdij", np.arange(TABLE) ** 2.0, np.abs(self._differences))
        known = known + ((high - low) / 4 / of.nyquist)[:, None, None, None, None] * slopes
        found = known.max(axis=(1, 2)) * math.prod(lebesgue(of.nodes(i)) for i in of.smooth)
        second = self.second(high)
        found = found + 2 * second + 3 * self._cut + 3 * self._smooth_cut(high)
        return np.asarray(found * math.exp(of.decay * of.period * of.whole))


def _over(flows: Vector, drives: Vector, spans: Vector) -> tuple[Vector, Vector]:
    """(e^{Ah}, Γ(h)) of members over a time each."""
    return exponential(flows * spans[:, None, None], drives * spans[:, None, None], 1.0)


def hold(s: ComplexArray, period: float, late: float | Vector) -> ComplexArray:
    """(1 − e^{−sT}) / (sT) · e^{−sδ}."""
    found: ComplexArray = -np.expm1(-s * period) / (s * period) * np.exp(-s * late)
    return found
