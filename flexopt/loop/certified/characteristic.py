"""The characteristic function of the exact sampled loop over a box of uncertain numbers, with bounds on all it leaves.

In: a loop whose machine is uncertain. Out: `Characteristic`: p(s, θ), the determinant of

    [ Z(s, θ)   −B_τ       −h(s) B E        0      ]     Z = s² M + s D + K,   h = (1 − e^{−sT}) / (sT) · e^{−sd}
    [ 0         s − A_τ    −h(s) B_s E      0      ]     z = e^{sT}
    [ −F_m C    0          1 − F_m 𝓔(s)     −F_l   ]     𝓔(s) = Σ_{n≠0} h(s + jnω_s) P(s + jnω_s)
    [ −L_m C    0          −L_m 𝓔(s)        z − L_l]     P(s) = C Z⁻¹ (B + B_τ (s − A_τ)⁻¹ B_s) E: force to measured

(τ: torques of servos; F, L: the sampled law). For |Im s| ≤ π/T it vanishes where e^{sT} is an eigenvalue of one sample
and nowhere else, as no eigenvalue of A lies above half the sampling rate. Only Z takes in springs, dampers and masses,
each to the first degree, so p is a polynomial in each, of the rank that it has in Z. The aliases 𝓔 are smooth: a table
for the middle of the box, and a bound on how far those of the others differ.

Self-motions N of a redundant arm are neither held nor measured, K N = 0, C N = 0: their columns are s (s M + D) N and
zeros, and are divided by s, by s² where D N = 0, so that p no longer vanishes with s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import casadi as ca
import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.loop.certified.aliases import Aliases
from flexopt.loop.certified.bernstein import nodes_of
from flexopt.loop.members import Machines, Ports
from flexopt.loop.small_motions import Parts, SmallMotions
from flexopt.loop.spectrum import OwnMotion
from flexopt.loop.uncertain import UncertainLoop
from flexopt.model.uncertainty import LATE

# Relative difference of what counts as the same number; a change, and a singular value, that are rounding: of degrees
# too many cost time, too few would be wrong.
SAME, NOTHING = 1e-9, 1e-13
# Members at the nodes of all θ together, more of which cost more than a proof is worth.
NODES = 600
# Of what a self-motion is held or measured by, relative to the largest, that is none.
NEUTRAL = 1e-12
# Degrees that the dead time and masses are interpolated with, the latter by how much they change M.
LATE_DEGREE, MASS_DEGREES = 12, ((0.25, 12), (0.1, 9), (0.03, 7), (-1.0, 5))


class NotCovered(Exception):
    """Why nothing is proven of this loop, in a sentence."""


@dataclass(frozen=True, eq=False)
class Characteristic:
    """p(s, θ) of a loop over a box of θ, which are factors and values themselves, not logarithms.

    Attributes:
        loop: the loop; of its box the names and what they concern.
        low, high: ends of θ (k,).
        decay: ρ, 1/s, of s = jω − ρ.
        around: that of a box around this one, which was checked: machines are of first degree in each θ between its
            corners.
    """

    loop: UncertainLoop
    low: Vector
    high: Vector
    decay: float
    around: Characteristic | None = None

    # What it is made of.

    @cached_property
    def late(self) -> int | None:
        """Which θ is the dead time."""
        found = [i for i, each in enumerate(self.loop.box.uncertainty) if each.of == (LATE,)]
        return found[0] if found else None

    @cached_property
    def motions(self) -> SmallMotions:
        """The loop's Functions."""
        return self.loop.settings.motions(self.loop.box.machine, gravity=self.loop.gravity)

    @property
    def period(self) -> float:
        """Of a sample, s."""
        return 1 / self.loop.settings.rate

    @property
    def nyquist(self) -> float:
        """Half the sampling rate, rad/s."""
        return math.pi / self.period

    @cached_property
    def middle(self) -> Vector:
        """The machine whose aliases are tabulated."""
        return (self.low + self.high) / 2

    @cached_property
    def whole(self) -> int:
        """Whole samples of dead time, everywhere in the box."""
        low, high = self.ends_of_dead_time
        found = math.floor(low / self.period + SAME)
        if high > (found + 1 + SAME) * self.period:
            raise NotCovered("the dead time is known to less than a sample only")
        return found

    @property
    def ends_of_dead_time(self) -> tuple[float, float]:
        """Of the dead time, s."""
        if self.late is None:
            return self.loop.box.nominal_dead_time, self.loop.box.nominal_dead_time
        return float(self.low[self.late]), float(self.high[self.late])

    def parts(self, theta: Vector) -> Parts:
        """The linear loop of a member."""
        if self.around is not None:
            flows, drives = self.around.flows(theta[None])
            return replace(self.around.law, flow=flows[0], drive=drives[0])
        place = {"base": self.loop.base, "posture": self.loop.posture, "p": self.loop.box.numbers_at(theta)[0]}
        return self.motions.parts(self.motions.numbers(self.loop.settings.numbers | place))

    def flows(self, thetas: Vector) -> tuple[Vector, Vector]:
        """A and B (N, …) of members (N, k), from what the machine is at the corners."""
        if self.around is not None:
            return self.around.flows(thetas)
        to_q, law, n = self.motions.loop.to_q, self.law, len(self.motions.loop.to_q)
        of, forces = self.machines(thetas), self._matrices[1].mass @ to_q
        flows, drives = np.tile(law.flow, (len(thetas), 1, 1)), np.tile(law.drive, (len(thetas), 1, 1))
        inverse = np.linalg.inv(of.mass @ to_q)
        flows[:, n : 2 * n, :n] = -inverse @ of.stiffness @ to_q
        flows[:, n : 2 * n, n : 2 * n] = -inverse @ of.damping @ to_q
        flows[:, n : 2 * n, 2 * n :] = inverse @ forces @ law.flow[n : 2 * n, 2 * n :]
        drives[:, n : 2 * n] = inverse @ forces @ law.drive[n : 2 * n]
        return flows, drives

    @cached_property
    def law(self) -> Parts:
        """Parts of the middle: what is not the machine is the same for all."""
        return self.parts(self.middle)

    @cached_property
    def _matrices(self) -> tuple[Machines, Machines]:
        """At the corners and in the middle, by the plant."""
        plant, place = self.motions.plant, (self.loop.base, self.loop.posture)
        gain, found = self.loop.settings.servo_gain or 0.0, list[list[Vector]]()
        for theta in [*self.corners, self.middle]:
            p = self.loop.box.numbers_at(theta)[0]
            q = plant.rest.call([*place, p])[0]
            damping = plant.damping.call([p + gain * self.motions.drive_damping])[0]
            each = plant.mass.call([q, place[0], p])[0], damping, plant.stiffness.call([p])[0]
            found.append([x.full() for x in each])
        stacked = [np.array(x) for x in zip(*found, strict=True)]
        return Machines(*(x[:-1] for x in stacked)), Machines(*(x[-1] for x in stacked))

    def machines(self, thetas: Vector) -> Machines:
        """Of members (…, k), in the machine's own coordinates: of first degree in each θ, which `check` verifies."""
        if self.around is not None:
            return self.around.machines(thetas)
        width = self.high - self.low
        part = np.where(width > 0, (thetas - self.low) / np.where(width > 0, width, 1.0), 0.0)
        weights = np.ones((*thetas.shape[:-1], 1))
        for i in range(len(width)):
            both = np.stack([1 - part[..., i], part[..., i]], axis=-1)
            weights = (weights[..., :, None] * both[..., None, :]).reshape(*thetas.shape[:-1], -1)
        corners = self._matrices[0]
        return Machines(*(np.tensordot(weights, x, axes=1) for x in (corners.mass, corners.damping, corners.stiffness)))

    @cached_property
    def modes(self) -> tuple[Vector, Vector]:
        """Coordinates q = Φ η of the middle, all free, and with the passive ones locked."""
        from scipy.linalg import eigh  # noqa: PLC0415  (loads slowly)

        of, m = self.machines(self.middle), self.motions.plant.n_passive
        free = np.asarray(eigh(of.stiffness, of.mass)[1])
        locked = np.zeros((len(free), len(free) - m))
        locked[m:] = np.linalg.inv(np.linalg.cholesky(of.mass[m:, m:])).T
        # Turned among what no spring holds, so that the self-motions come first.
        return self._led_by_neutral(free, of.mass), self._led_by_neutral(locked, of.mass)

    def _led_by_neutral(self, by: Vector, mass: Vector) -> Vector:
        directions = self.neutral[0]
        return by @ np.linalg.qr(by.T @ mass @ directions, mode="complete")[0] if directions.size else by

    @cached_property
    def neutral(self) -> tuple[Vector, int]:
        """Self-motions N (n_q, e) that nothing holds or measures, and how many of them, the first, nothing brakes."""
        plant, place, p = self.motions.plant, self.loop.base, self.loop.box.numbers_at(self.middle)[0]
        if self.around is not None or plant.n_actuated <= plant.n_task:
            return (
                (np.zeros((plant.n_passive + plant.n_actuated, 0)), 0) if self.around is None else self.around.neutral
            )
        to_q, corners = self.motions.loop.to_q, self._matrices[0]
        q = plant.rest.call([place, self.loop.posture, p])[0].full().ravel()
        found, n = OwnMotion.at(plant, q, place, p, to_q).directions, len(to_q)
        measured = [self.law.measured[:, k : k + n] @ np.linalg.inv(to_q) for k in (0, n)]
        found = found @ _unseen([*measured, *corners.stiffness], found)
        braked = _unseen(list(corners.damping), found)
        others = np.linalg.svd(braked.T)[2][braked.shape[1] :].T
        return found @ np.hstack([braked, others]), braked.shape[1]

    @cached_property
    def corners(self) -> Vector:
        """Of the box, (2^k, k)."""
        return np.array(list(product(*zip(self.low.tolist(), self.high.tolist(), strict=True))))

    @cached_property
    def _seen(self) -> list[tuple[Machines, Machines, Ports]]:
        """The corners, the middle and the ports of the machine that is free, and of that whose base is locked."""
        law, to_q = self.law, self.motions.loop.to_q
        n, corners, middle = len(to_q), self.machines(self.corners), self.machines(self.middle)
        found = list[tuple[Machines, Machines, Ports]]()
        for by in self.modes:
            into = by.T @ middle.mass @ to_q
            measured = (
                law.measured[:, :n] @ np.linalg.solve(to_q, by),
                law.measured[:, n : 2 * n] @ np.linalg.solve(to_q, by),
            )
            ports = Ports(into @ law.drive[n : 2 * n] @ law.spread, into @ law.flow[n : 2 * n, 2 * n :], *measured)
            found.append((corners.seen(by), middle.seen(by), ports))
        return found

    @cached_property
    def servo(self) -> tuple[Vector, Vector]:
        """A_τ and B_s E."""
        n = 2 * len(self.motions.loop.to_q)
        return self.law.flow[n:, n:], self.law.drive[n:] @ self.law.spread

    @property
    def free(self) -> tuple[Machines, Machines, Ports]:
        """Corners, middle and ports, nothing locked."""
        return self._seen[0]

    def seen(self, thetas: Vector) -> list[tuple[Machines, Ports]]:
        """Members (…, k) free, and with the base locked."""
        each = self.machines(thetas)
        return [(each.seen(by), ports) for by, (_, _, ports) in zip(self.modes, self._seen, strict=True)]

    @cached_property
    def largest(self) -> list[tuple[Machines, Machines, Ports]]:
        """Bounds on the entries of all members, and how far they are from the middle, free and locked."""
        return [(corners.largest, corners.less(middle).largest, ports) for corners, middle, ports in self._seen]

    def places(self, n: int) -> list[tuple[int, int]]:
        """Where torques, forces and the law's states stand behind n coordinates."""
        t, (r, _), k = len(self.servo[0]), self.law.force.shape, len(self.law.law)
        return [(n, n + t), (n + t, n + t + r), (n + t + r, n + t + r + k)]

    @cached_property
    def size(self) -> int:
        """Rows of the matrix."""
        return self.places(len(self.motions.loop.to_q))[-1][1]

    # What it does not cover.

    def check(self) -> None:
        """Whether p is what the loop's eigenvalues are zeros of.

        Raises:
            NotCovered: it is not.
        """
        settings, law, n = self.loop.settings, self.law, len(self.motions.loop.to_q)
        unheld = settings.ki == 0 if settings.feedback == "pid" else settings.kp == 0
        for sentence, fault in (
            ("weight bends the rest position, which depends on the springs", self.loop.gravity),
            ("a direction without gain is neutral", bool(np.any(unheld))),
            ("a damper of the self-motion acts beside the dead time", bool(np.any(law.direct))),
            ("its drives feel the machine", bool(np.any(law.flow[2 * n :, : 2 * n]))),
            ("torques are measured", bool(np.any(law.measured[:, 2 * n :]))),
        ):
            if fault:
                raise NotCovered(sentence)
        self._check_affine()
        known, there = self.machines(self.middle), self._matrices[1]
        to_q = self.motions.loop.to_q
        for theta in (self.low, self.high):
            other, of = self.parts(theta), self.machines(theta)
            pairs = [(getattr(law, x), getattr(other, x)) for x in ("spread", "force", "law", "measured")]
            flow, drive = (to_q.T @ of.mass @ to_q @ x[n : 2 * n] for x in (other.flow, other.drive))
            pairs += [(there.mass, known.mass), (there.damping, known.damping), (there.stiffness, known.stiffness)]
            pairs += [(flow[:, :n], -to_q.T @ of.stiffness @ to_q), (flow[:, n : 2 * n], -to_q.T @ of.damping @ to_q)]
            drives = to_q.T @ self.machines(self.middle).mass @ to_q @ law.drive[n : 2 * n]
            pairs += [(drive, drives), (other.flow[2 * n :, 2 * n :], law.flow[2 * n :, 2 * n :])]
            if any(np.any(np.abs(a - b) > SAME * np.abs(a).max(initial=SAME)) for a, b in pairs if a.size):
                raise NotCovered("what is uncertain changes what is measured, or asked of the joints")
        if not self.fastest < self.nyquist - self.decay:
            known = f"of up to {self.fastest / math.tau:.3g} Hz, as bounds tell" if math.isfinite(self.fastest) else ""
            raise NotCovered(f"the machine may have modes above half the sampling rate ({known or 'payloads differ'})")
        _ = self.whole
        if (nodes := math.prod(degree + 1 for degree in self.degrees)) > NODES:
            raise NotCovered(f"so much is uncertain at once that a proof would take long ({nodes} machines a part)")

    def _check_affine(self) -> None:
        """Whether mass, damping and stiffness are of first degree in each θ, by their graphs."""
        plant, box = self.motions.plant, self.loop.box
        g = plant.graph
        q = plant.rest(g.base, g.posture, g.p)
        matrices = ca.veccat(plant.mass(q, g.base, g.p), plant.damping(g.p), plant.stiffness(g.p))
        for each, entries in zip(box.uncertainty, box.entries, strict=True):
            factor, p = ca.SX.sym("factor"), ca.SX(g.p)
            for i in entries if each.of != (LATE,) else ():
                p[i] = factor * g.p[i] if each.value is None else factor
            slopes = ca.jacobian(ca.substitute(matrices, g.p, p), factor)
            if ca.depends_on(slopes, factor):
                raise NotCovered(f"the machine is not of first degree in {each.name}")

    @cached_property
    def fastest(self) -> float:
        """A bound on what members of the box oscillate with by themselves, rad/s; infinite where nothing is known."""
        corners, middle, _ = self._seen[0]
        moved, damping, stiffness = 1 - corners.less(middle).norms[0], *corners.norms[1:]
        servo = float(np.abs(self.servo[0]).max(initial=0.0))
        if moved <= 0:
            return math.inf
        return max(servo, (damping + math.sqrt(damping**2 + 4 * moved * stiffness)) / (2 * moved))

    # Degrees and nodes.

    @cached_property
    def _swings(self) -> list[Machines | None]:
        """What each θ does to the machine from one end to the other, at all corners; None of the dead time."""
        found = list[Machines | None]()
        for i in range(len(self.low)):
            ends = self.corners.copy(), self.corners.copy()
            ends[0][:, i], ends[1][:, i] = self.low[i], self.high[i]
            found.append(None if i == self.late else self.machines(ends[1]).less(self.machines(ends[0])))
        return found

    @cached_property
    def masses(self) -> tuple[int, ...]:
        """Which θ are, or multiply, masses."""
        whole = self.machines(self.corners).mass
        return tuple(i for i, x in enumerate(self._swings) if x is not None and np.any(_changed(x.mass, whole)))

    @cached_property
    def smooth(self) -> tuple[int, ...]:
        """Which θ are interpolated: masses and the dead time, in which aliases are no polynomials."""
        return tuple(sorted({*self.masses, *(() if self.late is None else (self.late,))}))

    @cached_property
    def degrees(self) -> tuple[int, ...]:
        """Of p times the conjugate of the locked machine's, in each θ: exactly, of smooth ones as interpolated."""
        found = list[int]()
        for i, swing in enumerate(self._swings):
            if swing is None:
                found.append(LATE_DEGREE)
                continue
            if i in self.masses:
                size = swing.seen(self.modes[0]).norms[0]
                found.append(next(degree for least, degree in MASS_DEGREES if size > least))
                continue
            # In the machine's own coordinates, where what does not change is zero; with the base locked, its joints'.
            m, whole = self.motions.plant.n_passive, self.machines(self.corners)
            blocks = _changed(swing.damping, whole.damping), _changed(swing.stiffness, whole.stiffness)
            found.append(sum(_rank(np.concatenate([x[:, k:, k:] for x in blocks])) for k in (0, m)))
        return tuple(found)

    def nodes(self, axis: int) -> Vector:
        """Of a θ in its interval, as parts of it in [0, 1]."""
        return nodes_of(self.degrees[axis], chebyshev=axis in self.smooth)

    def grid(self, axes: Sequence[int]) -> Vector:
        """All members at the nodes of some θ, the others in the middle, (…, k) with an axis for each."""
        ticks = [self.low[i] + (self.high[i] - self.low[i]) * self.nodes(i) for i in axes]
        found = np.tile(self.middle, (*(len(x) for x in ticks), 1))
        if axes:
            found[..., list(axes)] = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1)
        return found

    @cached_property
    def dead_times(self) -> Vector:
        """At the nodes of all smooth θ together."""
        thetas = self.grid(self.smooth).reshape(-1, len(self.low))
        return np.full(len(thetas), self.ends_of_dead_time[0]) if self.late is None else thetas[:, self.late]

    @cached_property
    def aliases(self) -> Aliases:
        """What sampling adds."""
        return Aliases(self)


def _unseen(matrices: Sequence[Vector], directions: Vector) -> Vector:
    """Orthonormal combinations of directions (n, e) that all of some matrices take to nothing, (e, …)."""
    sizes = [float(np.abs(x).max(initial=0.0)) for x in matrices]
    if not any(sizes):
        return np.eye(directions.shape[1])
    seen = np.vstack([x @ directions / size for x, size in zip(matrices, sizes, strict=True) if size])
    _, values, rows = np.linalg.svd(seen)
    found: Vector = rows[int(np.sum(values > NEUTRAL)) :].T
    return found


def _changed(swing: Vector, whole: Vector) -> Vector:
    """What a θ changes, without what is rounding, from entries (…, n, n) at all corners."""
    found: Vector = np.where(np.abs(swing) > NOTHING * np.abs(whole).max(axis=0), swing, 0.0)
    return found


def _rank(matrices: Vector) -> int:
    """Of matrices (N, n, n) side by side, each row and column in its own unit."""
    row = matrices.transpose(1, 0, 2).reshape(matrices.shape[1], -1)
    for axis in (1, 0):
        size = np.abs(row).max(axis=axis, keepdims=True, initial=0.0)
        row = row / np.where(size > 0, size, 1.0)
    return int(np.linalg.matrix_rank(row, tol=NOTHING)) if row.size else 0
