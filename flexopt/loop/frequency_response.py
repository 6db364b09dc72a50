"""The loop broken at the law's force, over frequency: how late the force may be, and how high its response peaks.

In: one sample of a loop. Out: the times by which the force may be late until an eigenvalue of L(e^{jθ}) meets −1, and
the largest singular values of feed · I + sign · F (zI − Φ)⁻¹ Γ over the unit circle, with their derivatives.
"""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

import numpy as np

from flexopt.coprime import StateSpace
from flexopt.coprime.norms import hinf_peak
from flexopt.foundation.arrays import ComplexArray, Vector
from flexopt.foundation.roots import root
from flexopt.loop.assembly import OneSample, Slopes
from flexopt.loop.spectrum import balance

# Slowest motion that is looked at, rad in a sample, and how near to a pole in units of its damping.
SLOWEST, NEAR = 1e-5, np.concatenate([-np.geomspace(0.01, 30.0, 24), np.zeros(1), np.geomspace(0.01, 30.0, 24)])
# Between which multiples of its angle a crossing is looked for once a part of a sample is added, how often, and the
# relative change of the time that ends it.
BESIDE, ROUNDS, SETTLED = np.array([[1 - step, 1 + step] for step in (1e-3, 1e-2, 1e-1)]), 8, 1e-12
# How far the angle of a peak may be off, rad, and how often it is bettered.
POLISH, POLISHES = 1e-5, 4
# Relative distance up to which two peaks are as high.
SAME = 1e-6
# Peaks of feed · I + sign · F (zI − Φ)⁻¹ Γ, by sign and feed.
PEAKS = {"sensitivity_peak": (1.0, 1.0), "complementary_peak": (-1.0, 0.0), "disk_margin": (1.0, 0.5)}


class Crossing(NamedTuple):
    """Where an eigenvalue of L(e^{jθ}) has modulus one.

    Attributes:
        late: after which time, s, that the force is late it is −1.
        angle: θ there.
        row: which eigenvalue, by modulus.
    """

    late: float
    angle: float
    row: int


def crossings(sample: OneSample) -> list[Crossing]:
    """Times by which the law's force may be late until the loop is at a border, ascending, s, nearly.

    Where an eigenvalue λ of L(e^{jθ}) has modulus 1, λ e^{−jθΔ} = −1 after Δ samples.
    """
    poles = np.concatenate([np.linalg.eigvals(balance(m)[0]) for m in (sample.open, sample.matrix)])
    near = np.abs(np.angle(poles))[:, None] + np.abs(1 - np.abs(poles))[:, None] * NEAR
    angles = np.concatenate([np.geomspace(SLOWEST, math.pi, 500), near.ravel()])
    angles = np.unique(angles[(angles >= SLOWEST) & (angles <= math.pi)])
    response = _Response(sample)
    beyond = np.abs(response.eigenvalues(angles)) > 1
    found: list[Crossing] = []
    for k, row in np.argwhere(beyond[1:] != beyond[:-1]).tolist():
        angle = response.crossing(row, angles[k], angles[k + 1])
        late = (response.phase(row, angle) + math.pi) % math.tau / angle
        found.append(Crossing(late * sample.period, angle, row))
    return sorted(found)


def exactly(sample: OneSample, crossing: Crossing) -> float:
    """A time of `crossings` as it is: by the response of the loop with a part of a sample more.

    Whole samples more are z⁻¹ each, exactly; what a pure dead time would still lack goes to the part, until nothing
    does. Where two eigenvalues cross together that may lead to the other's time; then it stays as it was.
    """
    late, angle, row = crossing.late / sample.period, crossing.angle, crossing.row
    for _ in range(ROUNDS):
        whole = max(math.floor(late) - 1, 0)
        response = _Response(sample.later(sample.dead_time + (late - whole) * sample.period))
        ends = next((ends for ends in BESIDE * angle if response.crosses(row, *ends)), None)
        if ends is None:
            break
        angle = response.crossing(row, *ends)
        left = ((response.phase(row, angle) - angle * whole) % math.tau - math.pi) / angle
        late += left
        if abs(late - crossing.late / sample.period) > 1:
            return crossing.late
        # Before it is late at all nothing grows: it was nearly there only.
        if late < 0 or abs(left) <= SETTLED * late:
            break
    return late * sample.period


def peak_at(system: StateSpace, sign: float, feed: float) -> tuple[float, float]:
    """The largest singular value of feed · I + sign · F (zI − Φ)⁻¹ Γ over the unit circle, and at which angle, rad.

    Args:
        system: Φ, Γ and F of a loop that decays.
        sign: of the response.
        feed: what is added to it.
    """
    feeding = feed * np.eye(len(system.D))
    value, frequency = hinf_peak(StateSpace(system.A, system.B, sign * system.C, feeding, system.dt))
    return value, _polished(system, frequency * system.dt, feeding, sign)


def _polished(system: StateSpace, angle: float, feeding: Vector, sign: float) -> float:
    """The angle of a peak, of which its height tells half of the digits only: where the height has no slope."""
    before = angle - POLISH
    if not POLISH < angle < math.pi - POLISH:
        return angle

    def slope(at: float) -> float:
        z = np.exp(1j * at)
        pencil: ComplexArray = z * np.eye(len(system.A)) - system.A
        moved = np.linalg.solve(pencil, system.B.astype(complex))
        u, _, vh = np.linalg.svd(feeding + sign * system.C @ moved)
        turned = -1j * z * sign * system.C @ np.linalg.solve(pencil, moved)
        return float((u[:, 0].conj() @ turned @ vh[0].conj()).real)

    here, of_before, of_here = angle, slope(before), slope(angle)
    for _ in range(POLISHES):
        if of_here == of_before:
            break
        before, here, of_before = here, here - of_here * (here - before) / (of_here - of_before), of_here
        of_here = slope(here)
    # Where the height is no parabola nearby, as it was.
    return here if abs(here - angle) < POLISH else angle


def peak(system: StateSpace, smooth: OneSample, sign: float, feed: float) -> tuple[float, Slopes | None]:
    """A peak of `peak_at`, NaN where there is none, and its derivative by what a sample is made of.

    None where two are as high.

    Args:
        system: as there.
        smooth: the sample, as derivatives are taken of it.
        sign: as there.
        feed: as there.
    """
    value, angle = peak_at(system, sign, feed)
    if not math.isfinite(value):
        return math.nan, None
    z, identity = np.exp(1j * angle), np.eye(len(system.D))
    try:
        pencil: ComplexArray = z * np.eye(len(smooth.matrix)) - smooth.matrix
        inverse = np.linalg.solve(pencil, np.eye(len(pencil)))
    except np.linalg.LinAlgError:
        return value, None
    resolvent: ComplexArray = np.asarray(inverse, dtype=np.complex128)
    u, sizes, vh = np.linalg.svd(feed * identity + sign * smooth.force @ resolvent @ smooth.into)
    left, right = sign * u[:, 0].conj(), vh[0].conj()
    row, column = left @ smooth.force @ resolvent, resolvent @ smooth.into @ right
    if len(sizes) > 1 and sizes[0] - sizes[1] < SAME * sizes[0]:
        return value, None
    by_matrix = np.outer(row, column).real
    by_into = np.outer(row, right).real + by_matrix @ smooth.force.T
    by_force = np.outer(left, column).real + smooth.into.T @ by_matrix
    return value, smooth.all_slopes(by_matrix, by_into, by_force)


class _Response:
    """Eigenvalues of L(e^{jθ}) by modulus, the loop broken at the law's force.

    By half of the feedback, S = (I + L/2)⁻¹ = I + F (zI − Φ₀ − Γ F/2)⁻¹ Γ/2, whose eigenvalues σ give λ = 2 (1/σ − 1):
    this resolvent is finite where L is not, on an undamped pole, and where the loop is at a border, λ = −1.
    """

    def __init__(self, sample: OneSample) -> None:
        scale = balance(sample.matrix)[1]
        self.into, self.force = sample.into / scale[:, None] / 2, sample.force * scale
        self.halved = sample.open / scale[:, None] * scale + self.into @ self.force

    def eigenvalues(self, angles: Vector) -> ComplexArray:
        """At angles θ (k,), (k, r); the largest number where they are infinite."""
        z = np.exp(1j * angles)[:, None, None]
        right = np.broadcast_to(self.into, (len(z), *self.into.shape))
        fed = np.linalg.eigvals(self.force @ np.linalg.solve(z * np.eye(len(self.halved)) - self.halved, right))
        left_over = 1 + fed
        found = -2 * fed / np.where(left_over == 0, np.finfo(float).tiny, left_over)
        order = np.argsort(np.abs(found), axis=1)
        return np.asarray(np.take_along_axis(found, order, axis=1), dtype=np.complex128)

    def _one(self, row: int, angle: float) -> complex:
        return complex(self.eigenvalues(np.array([angle]))[0, row])

    def phase(self, row: int, angle: float) -> float:
        """Of one, rad."""
        return cmath.phase(self._one(row, angle))

    def crosses(self, row: int, low: float, high: float) -> bool:
        """Whether the modulus of one passes one between two angles."""
        return high <= math.pi and (abs(self._one(row, low)) > 1) != (abs(self._one(row, high)) > 1)

    def crossing(self, row: int, low: float, high: float) -> float:
        """Where it does."""
        return root(lambda angle: math.log(abs(self._one(row, angle))), low, high)
