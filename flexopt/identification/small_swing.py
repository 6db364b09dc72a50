"""The start of a fit: the machine's modes brought onto the poles of the log, then its small motions onto the samples.

In: a `HeldSwing`, a log, its poles. Out: θ and the initial state from which the nonlinear fit finds its optimum, and
columns that look as if their unit were told wrongly. About rest the motion is y = C exp(A(θ) t) x0 + offset: linear in
x0 and the offsets, which are eliminated (variable projection; Golub and Pereyra 1973).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from flexopt.errors import NoSolutionFound
from flexopt.foundation.arrays import Array, ComplexArray, Vector
from flexopt.identification.log import MeasuredLog
from flexopt.identification.measured import MISTAKEN
from flexopt.identification.poles import Poles
from flexopt.identification.swing import HeldSwing, eigen, oscillations
from flexopt.plant.reach import outer_reach

# Nothing known beyond the file: its numbers are right within a factor of e³, in standard deviations.
PRIOR = 3.0
# Logarithms of a common factor of the springs from which modes are matched; more starts are scattered about them.
COMMON, SCATTERED, SCATTER, SEED = (0.0, 0.7, -0.7, 1.4, -1.4, 2.1, -2.1), 7, 0.7, 5
# How often pairs of modes and poles are chosen anew; how many starts are followed, how many rows they look at; θ nearer
# to each other than this are one.
ROUNDS, FOLLOWED, ROWS, SAME = 5, 5, 500, 0.05
# The first stretch of the log, in periods of its slowest pole, and how much longer each next one is.
PERIODS, LONGER = 2.5, 3.0
# A column is of another unit where it is so near to that factor, and its shape so near to what it should be.
NEAR, ALIKE = 0.25, 0.9
# Sums of squares that are nearly the least.
NEARLY, LOOSELY = 1.2, 4.0
# Evaluations that bring a start to its end; sums of squares, of the noise, that are further apart are told apart.
TO_THE_END, BEYOND = 40, 60.0
# How often other θ with the same poles are looked for, and how far apart searches start.
SEARCHES, APART = 64, 1.2
# Evaluations of such a search, and poles that are nearly the same: their sizes, in logarithms, and angles, rad. Dampers
# that are not negative may not bring them nearer; whether the log goes with them is asked then.
MATCHING, SAME_SIZE, SAME_ANGLE = 30, 0.02, 0.1
# A base hardly tilts by more either way, rad; by which share of the arm's reach nothing moves.
TILT, FAR = 0.05, 0.1
THETA_MAX = 12.0
# An accelerometer that sits so many times farther away than the arm reaches sits on no such machine.
AWAY = 3.0
# From where on an accelerometer shows its weight, and from where on it shows it in another direction, shares of it.
SHOWN, TURNED = 0.5, 0.35
# By which θ moves for slopes by differences: half of the digits are left.
STEP = math.sqrt(np.finfo(float).eps)
# What a θ raises in which the machine has no small motions: its springs do not hold it, or its modes are out of bounds.
NO_SWING = (NoSolutionFound, np.linalg.LinAlgError, ArithmeticError, RuntimeError)


@dataclass(frozen=True, eq=False)
class SmallSwing:
    """Small motions beside a log.

    Attributes:
        swing: whose.
        time: (N,), s;  values: (N, c), NaN where there is no sample;  sigma: (c,) what a deviation is counted in.
    """

    swing: HeldSwing
    time: Vector
    values: Array
    sigma: Vector

    def until(self, end: float, rows: int = ROWS) -> SmallSwing:
        """The log's beginning, so many samples of it at most."""
        count = int(np.count_nonzero(self.time <= self.time[0] + end))
        # Drawn, because an even choice would fold fast modes onto slow ones.
        drawn: Any = np.random.default_rng(SEED).choice(count, min(rows, count), replace=False)
        chosen = np.unique(np.concatenate([[0], drawn, [count - 1]]))
        return SmallSwing(self.swing, self.time[chosen], self.values[chosen], self.sigma)

    def basis(self, theta: Vector) -> Array:
        """C exp(A t), (N, c, 2m); not finite where its modes are out of bounds."""
        a, c, _ = self.swing.linear(theta)
        roots, v = eigen(a)
        return np.einsum("cj,nj,jk->nck", c @ v, oscillations(roots, self.time), np.linalg.inv(v)).real

    def fitted(self, theta: Vector, columns: Sequence[int] | None = None) -> tuple[Vector, Vector, Array]:
        """Residuals in multiples of sigma, the deviation x0 from rest, and what it gives in all columns (N, c).

        `columns` are those that x0 is found from.

        Raises:
            NoSolutionFound: the springs do not hold the machine.
            LinAlgError: it has no small motions in numbers.
        """
        basis = self.basis(theta)
        if not np.all(np.isfinite(basis)):
            raise np.linalg.LinAlgError("small motions beyond the range of numbers")
        there = np.isfinite(self.values)
        used = [k for k in (range(len(self.sigma)) if columns is None else columns) if there[:, k].any()]
        if not used:
            raise np.linalg.LinAlgError("no samples to find small motions from")
        left, right = list[Array](), list[Vector]()
        for k in used:
            rows, column = basis[there[:, k], k], self.values[there[:, k], k]
            left.append((rows - rows.mean(axis=0)) / self.sigma[k])
            right.append((column - column.mean()) / self.sigma[k])
        matrix, wanted = np.concatenate(left), np.concatenate(right)
        x0: Any = np.linalg.lstsq(matrix, wanted, rcond=1e-12)[0]
        return wanted - matrix @ x0, x0, basis @ x0

    def improved(self, theta: Vector, evaluations: int = 12) -> tuple[Vector, float]:
        """θ nearer to these samples, and the mean square of what is left."""
        from scipy.optimize import least_squares  # noqa: PLC0415  (loads slowly)

        size = int(np.isfinite(self.values).sum())
        bad = np.full(size + theta.size, 1e3)

        def residuals(at: Vector) -> Vector:
            try:
                found = np.concatenate([self.fitted(at)[0], at / PRIOR])
            except NO_SWING:
                return bad
            return found if np.all(np.isfinite(found)) else bad

        found: Any = least_squares(
            residuals, np.clip(theta, -THETA_MAX, THETA_MAX), method="trf", x_scale="jac", max_nfev=evaluations
        )  # fmt: skip
        return found.x, float(2 * found.cost / size)


def small_modes(swing: HeldSwing, theta: Vector) -> tuple[ComplexArray, ComplexArray]:
    """Eigenvalues (m,) with positive imaginary part, 1/s, slowest first, and what the columns see of each (c, m)."""
    roots, v, _ = swing.modes(theta)
    return roots, swing.linear(theta)[1] @ v


def assurance(a: ComplexArray, b: ComplexArray) -> Array:
    """Modal assurance of shapes (c, k) and (c, l), columns scaled: (k, l) in 0 … 1."""
    inner = np.abs(a.conj().T @ b) ** 2
    return inner / np.maximum(np.outer((np.abs(a) ** 2).sum(0), (np.abs(b) ** 2).sum(0)), 1e-300)


def of_roots(
    swing: HeldSwing, residuals: Callable[[ComplexArray, Vector], Vector]
) -> tuple[Callable[[Vector], Vector], Callable[[Vector], Array]]:
    """Residuals of the eigenvalues with θ and of θ, as functions of θ: their value, and their slopes by differences.

    All steps are one call: called one by one, Python would take most of the time.
    """

    def values(thetas: Array) -> Array:
        return np.array([residuals(*each) for each in zip(swing.roots_of(thetas), thetas, strict=True)])

    def slopes(at: Vector) -> Array:
        moved = at + np.diag(STEP * np.maximum(1.0, np.abs(at)))
        here, *there = values(np.vstack([at, moved]))
        return (np.array(there) - here).T / (np.diag(moved) - at)

    return lambda at: values(at[None])[0], slopes


def matched(swing: HeldSwing, poles: Poles, scale: Vector, theta: Vector) -> Vector:
    """θ by which modes come near to the poles, each to one."""
    from scipy.optimize import least_squares, linear_sum_assignment  # noqa: PLC0415  (loads slowly)

    weight = np.minimum(1.0, poles.strength / poles.strength.max() * 3.0)
    for _ in range(ROUNDS):
        try:
            roots, shapes = small_modes(swing, theta)
        except NoSolutionFound:
            return theta
        if not roots.size:
            return theta
        apart = np.abs(np.log(np.abs(poles.values))[:, None] - np.log(np.abs(roots))[None])
        cost = weight[:, None] * (3.0 * apart + 1.0 - assurance(poles.shapes / scale[:, None], shapes / scale[:, None]))
        data, model = linear_sum_assignment(cost)

        def residuals(
            modes: ComplexArray, at: Vector, data: NDArray[Any] = data, model: NDArray[Any] = model
        ) -> Vector:
            if modes.size <= model.max():
                return np.full(2 * data.size + at.size, 10.0)
            wanted, now = poles.values[data], modes[model]
            decay = np.log(np.maximum(-now.real, 1e-9) / np.maximum(-wanted.real, 1e-3 * np.abs(wanted)))
            pulls = [np.log(np.abs(now) / np.abs(wanted)), 0.1 * np.clip(decay, -5.0, 5.0)]
            return np.concatenate([*(weight[data] * pull for pull in pulls), 0.02 / PRIOR * at])

        value, slopes = of_roots(swing, residuals)
        found: Any = least_squares(value, theta, slopes, max_nfev=4)
        moved, theta = float(np.abs(found.x - theta).max()), np.clip(found.x, -THETA_MAX, THETA_MAX)
        if moved < 1e-3:
            break
    return theta


def starts(count: int, springs: Sequence[int]) -> list[Vector]:
    """θ from which modes are matched."""
    rng, found = np.random.default_rng(SEED), list[Vector]()
    for k in range(len(COMMON) + SCATTERED):
        theta = np.zeros(count)
        theta[list(springs)] = COMMON[k % len(COMMON)]
        found.append(theta if k < len(COMMON) else theta + SCATTER * rng.standard_normal(count))
    return found


def near_starts(small: SmallSwing, poles: Poles, springs: Sequence[int]) -> tuple[list[Vector], SmallSwing]:
    """Some θ whose modes go with the poles and with the log's beginning, the best first, and that beginning."""
    swing, count = small.swing, len(small.swing.names)
    slowest = float(np.abs(poles.values).min()) if poles.values.size else 2 * math.pi
    beginning = small.until(PERIODS * 2 * math.pi / slowest)
    ranked = list[tuple[float, int, Vector]]()
    for k, start in enumerate(starts(count, springs)):
        theta = matched(swing, poles, small.sigma, start) if poles.values.size else start
        try:
            left = beginning.fitted(theta)[0]
        except NO_SWING:
            continue
        if np.all(np.isfinite(left)):
            ranked.append((float(left @ left), k, theta))
    ranked.sort(key=lambda each: each[:2])
    chosen = _different([theta for _, _, theta in ranked], springs)[:FOLLOWED]
    followed = sorted((beginning.improved(theta) for theta in chosen), key=lambda each: each[1])
    return _different([theta for theta, _ in followed], springs) or [np.zeros(count)], beginning


def _different(thetas: Sequence[Vector], springs: Sequence[int]) -> list[Vector]:
    """Those that differ from all before in some spring, or where no spring is unknown in anything."""
    kept, seen = list[Vector](), list(springs) or slice(None)
    for theta in thetas:
        if not any(np.abs(theta - other)[seen].max() < SAME for other in kept):
            kept.append(theta)
    return kept


def grown(
    small: SmallSwing,
    thetas: Sequence[Vector],
    beginning: SmallSwing,
    springs: Sequence[int],
    told: Callable[[float], None],
) -> list[tuple[Vector, Vector]]:
    """θ and x0 (deviation from rest) fitted to ever longer stretches, up to the whole log.

    The best first, then those others that fit nearly as well: few columns may not tell which mode is which. `told` is
    told which share of this is done.
    """
    whole = float(small.time[-1] - small.time[0])
    found = list[tuple[Vector, float]]()
    for k, start in enumerate(thetas, start=1):
        theta, left, end = start, math.inf, float(beginning.time[-1] - beginning.time[0])
        while end < whole or not math.isfinite(left):
            end = min(whole, LONGER * end)
            theta, left = small.until(end).improved(theta)
        found.append((theta, left))
        told(k / (len(thetas) + 1))
    found.sort(key=lambda each: each[1])
    all_of_it = small.until(whole)
    for other in same_poles(small.swing, found[0][0], springs):
        left = all_of_it.fitted(other)[0]
        if float(left @ left) <= LOOSELY * found[0][1] * left.size:
            found.append(all_of_it.improved(other))
    found.sort(key=lambda each: each[1])
    near = _different([theta for theta, left in found if left <= NEARLY * found[0][1]], springs)
    if len(near) > 1:
        # What only looks alike because it is on its way is brought to its end.
        found = sorted((all_of_it.improved(theta, TO_THE_END) for theta in near), key=lambda each: each[1])
    most = found[0][1] * (1.0 + BEYOND / np.count_nonzero(np.isfinite(all_of_it.values)))
    alike = [theta for theta, left in found if left <= most]
    return [(theta, all_of_it.fitted(theta)[1]) for theta in _different(alike, springs)[:FOLLOWED]]


def same_poles(swing: HeldSwing, theta: Vector, springs: Sequence[int]) -> list[Vector]:
    """Other θ with which the machine has nearly the poles that it has with this one, as far as a search finds them."""
    from scipy.optimize import least_squares  # noqa: PLC0415  (loads slowly)

    wanted, rng = swing.roots(theta), np.random.default_rng(SEED)
    seen = list(springs) or list(range(theta.size))

    found = list[Vector]()
    for _ in range(SEARCHES if wanted.size > 1 else 0):
        start = theta.copy()
        start[seen] += rng.normal(0.0, APART, len(seen))

        def residuals(roots: ComplexArray, at: Vector, start: Vector = start) -> Vector:
            if roots.size != wanted.size:
                return np.full(2 * wanted.size + at.size, 10.0)
            apart: ComplexArray = np.log(roots / wanted)
            return np.concatenate([apart.real, apart.imag, 1e-4 * (at - start)])

        value, slopes = of_roots(swing, residuals)
        solved: Any = least_squares(value, start, slopes, max_nfev=MATCHING)
        size, angle = np.abs(solved.fun[: 2 * wanted.size]).reshape(2, -1).max(axis=1)
        if size < SAME_SIZE and angle < SAME_ANGLE:
            found.append(solved.x)
    return _different([theta, *found], springs)[1:]


def unit_doubts(beginning: SmallSwing, theta: Vector) -> dict[int, str]:
    """Columns that are, by a factor between units, other than the rest of the log says, with the sentence."""
    channels, found = beginning.swing.channels, dict[int, str]()
    groups: dict[str, list[int]] = {}
    for k, channel in enumerate(channels):
        groups.setdefault(channel.kind if channel.kind != "coordinate" else channel.kind + channel.unit, []).append(k)
    for group in groups.values():
        others = [k for k in range(len(channels)) if k not in group]
        if not others:
            continue
        try:
            told = beginning.fitted(theta, others)[2]
        except NO_SWING:
            continue
        for k in group:
            there = np.isfinite(beginning.values[:, k])
            if not there.any():
                continue
            x, y = (part[there, k] - part[there, k].mean() for part in (told, beginning.values))
            size = math.sqrt(float(x @ x) * float(y @ y))
            if not size or float(x @ y) / size < ALIKE:
                continue
            gain = math.sqrt(float(y @ y) / float(x @ x))
            for factor, unit in MISTAKEN[channels[k].unit]:
                if abs(math.log(gain / factor)) < NEAR:
                    found[k] = (
                        f"{channels[k].name} is {gain:.3g} times what the other columns say: is it in {unit}, not "
                        f"{channels[k].unit}? It is left out of the fit"
                    )
    return found


def axis_doubts(swing: HeldSwing, log: MeasuredLog) -> list[str]:
    """Whether the accelerometer shows the weight where the machine at rest, with the file's springs, does not."""
    there, file = log.of("acceleration"), np.zeros(len(swing.names))
    g = float(swing.parameters(file)[swing.plant.parameter_names.index("gravity")])
    if not there or not g:
        return []
    try:
        told: Vector = swing.outputs.call([swing.rest(file), file])[0].full().ravel()
    except NoSolutionFound:
        return []
    shown, meant = cast(Vector, np.nanmean(log.values[:, there], axis=0)), told[there]
    if np.linalg.norm(shown) < SHOWN * g or np.linalg.norm(shown - meant) < TURNED * g:
        return []
    names = ", ".join(log.channels[k].name for k in there)
    now, then = (", ".join(f"{x:.3g}" for x in each.round(2).tolist()) for each in (shown, meant))
    way = ": x along it to the arm's first joint, y to its left" if len(swing.imu) == 2 else ""
    return [
        f"the accelerometer shows {names} of {now} m/s² on the whole, where this machine at rest shows {then} m/s²: "
        f"are its axes those of the body that carries the arm{way}?"
    ]


def place_doubts(swing: HeldSwing) -> list[str]:
    """Whether the accelerometer sits beyond the machine."""
    far, reach = float(np.linalg.norm(swing.imu)), outer_reach(swing.plant)[1]
    if far <= AWAY * reach or not any(channel.kind == "acceleration" for channel in swing.channels):
        return []
    return [f"imu is {far:.3g} m from the body's origin, of an arm that reaches {reach:.3g} m: is it in mm, not m?"]


def size_doubts(small: SmallSwing, poles: Poles) -> list[str]:
    """Columns in which the base would tilt, or something move, by more than any base lets it."""
    found, reach = list[str](), outer_reach(small.swing.plant)[1]
    if not poles.values.size:
        return found
    for k, channel in enumerate(small.swing.channels):
        size = np.abs(poles.shapes[k])
        if channel.unit == "m" and (way := float(np.sum(size))) > FAR * reach:
            found.append(
                f"{channel.name} would move by {way:.3g} m either way, of an arm that reaches {reach:.3g} m: is it in "
                "mm, not m?"
            )
        if channel.unit not in ("rad/s", "rad"):
            continue
        angle = float(np.sum(size / np.abs(poles.values)) if channel.unit == "rad/s" else np.sum(size))
        if angle > TILT:
            meant = "deg/s, not rad/s" if channel.unit == "rad/s" else "deg, not rad"
            found.append(
                f"{channel.name} would tilt the base by {math.degrees(angle):.0f} degrees either way: is it in {meant}?"
            )
    return found
