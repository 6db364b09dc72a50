"""A standard move in the sampled loop for small motions: when it has settled, how far the base swings, and derivatives.

In: one sample of a loop that decays. Out: a `StandardMove`: its motion at any time, exactly also between the samples,
the largest deflections and end-point errors on the way, and what they are differentiated by.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.foundation.roots import root
from flexopt.loop.assembly import OneSample, Slopes, through_exponential
from flexopt.loop.drifting import WithoutDrift
from flexopt.loop.small_motions import Parts, SmallMotions
from flexopt.loop.spectrum import balance, without_neutral
from flexopt.loop.tangent import exponential

# Share of the error at the start that is left when a move has settled, as in `flexopt.simulate`; how long it is
# waited for, s; samples that are looked at together.
SETTLED, LONGEST, BLOCK = 0.02, 60.0, 2048
# Length of a move where numbers of it are told, m; how far off its target an end-point rests that has not settled then.
MOVE = 0.1
UNSETTLED = SETTLED * MOVE
# Share of the band below which what is left of all motions together must lie before no more is looked at, less than 1
# for what is between two places; how many times the longest wait is looked at for it.
QUIET, PATIENCE = 0.95, 3
# Share of the band by which an excursion may leave it that is none: rounding does not decide which one is the last.
TOUCH = 5e-7
# Phase, rad, of the plant's fastest oscillation between two places that are looked at, and how many in a sample.
PHASE, LOOKS = 0.3, 64
# Of the largest peak, those that the places beside them take for nearly as high are found exactly.
NEARLY = 0.9
# Share of the band from which on a peak between two places may leave it.
CLOSE = 0.998
# Relative distance of two peaks, or of two times, that are one kink; rate, of |e| per settling time, of a tangent.
SAME, FLAT = 1e-9, 1e-6


class Peak(NamedTuple):
    """A local maximum in time of what a signal is in size.

    Attributes:
        size: there: of the end-point |e|, of the base |deflection|, per m of the move.
        time: s, from the start.
        row: the task row that the move is along;  signal: 0 the end-point, then each row of the base.
    """

    size: float
    time: float
    row: int
    signal: int


class Instant(NamedTuple):
    """What a signal is at a time, with its derivatives: `rate` by the time, 1/s, and by what a sample is made of."""

    size: float
    rate: float
    slopes: Slopes


@dataclass(frozen=True)
class _Track:
    """Squares of signals (s, places) along one task row, and their rates, at so many `looks` in each sample."""

    squares: Vector
    rates: Vector
    looks: int


@dataclass(frozen=True, eq=False)
class StandardMove:
    """The end-point starts beside its target, the springs at rest, along each task row by itself; the worst is told.

    x_{k+1} = Φ x_k, and between the samples s(kT + h) = e^{Ah} s_k + Γ(h) τ_k. x_0 has the joints displaced by Jv⁺
    times the move; what is measured, filtered and on its way shows it, as at the start of `flexopt.simulate`. Where an
    arm drifts along its self-motion, x_0 is without what it has of the drift: what that makes of a signal depends on
    nothing but how long one looks.

    Attributes:
        motions: the loop's Functions.
        sample: one of it, as derivatives are taken of it.
        neutral: in how many directions it may rest elsewhere, as of `neutral_directions`.
        drifts: whether a self-motion grows in it, and nothing else.
    """

    motions: SmallMotions
    sample: OneSample
    neutral: int = 0
    drifts: bool = False

    @property
    def _period(self) -> float:
        return self.sample.period

    @cached_property
    def _to_q(self) -> Vector:
        return self.motions.loop.to_q

    @cached_property
    def _base_rows(self) -> Vector:
        """The base's turns (where nothing turns, shifts) as rows of s."""
        p, rows = self.sample.parts, self.motions.loop.shape.base_rows
        found = np.zeros((len(rows), len(p.flow)))
        found[:, : len(self._to_q)] = self._to_q[rows]
        return found

    @property
    def of_base(self) -> tuple[int, ...]:
        """Signals of the base."""
        return tuple(range(1, 1 + len(self._base_rows)))

    def _rows(self, signal: int) -> Vector:
        """What a signal is, as rows of s."""
        return self.sample.parts.measured[: self.motions.plant.n_task] if not signal else self._base_rows[[signal - 1]]

    # The start.

    @cached_property
    def _joints(self) -> tuple[Vector, Vector]:
        """Jv and its pseudo-inverse."""
        n, r, m = len(self._to_q), self.motions.plant.n_task, self.motions.plant.n_passive
        of_joints = self.sample.parts.measured[:r, :n] @ np.linalg.inv(self._to_q)[:, m:]
        return of_joints, np.asarray(np.linalg.pinv(of_joints), dtype=np.float64)

    @cached_property
    def _known(self) -> tuple[Vector, list[Vector]]:
        """Of the start: s, and [law; m] as the law sees it, a column for each task row.

        For each force that is on its way as it saw the start, oldest first, as an integral grows meanwhile; then as it
        sees what is measured next.
        """
        p, n, r = self.sample.parts, len(self._to_q), self.motions.plant.n_task
        away, s = np.zeros((n, r)), np.zeros((len(p.flow), r))
        away[self.motions.plant.n_passive :] = self._joints[1]
        s[:n] = np.linalg.solve(self._to_q, away)
        seen = np.zeros((len(p.law) + 2 * r, r))
        seen[len(p.law) :] = p.measured @ s
        if self.motions.filtered:
            # The filter has seen the start for long; it is the last of the law's states.
            seen[len(p.law) - 2 * r : len(p.law)] = seen[len(p.law) :]
        each = [seen]
        for _ in range(self.sample.waiting[0]):
            each.append(np.vstack([p.law @ each[-1], seen[len(p.law) :]]))
        return s, each

    @cached_property
    def _moved(self) -> Vector:
        """x_0 (n_x, r), a column for each task row: 1 m beside the target."""
        p, (s, (*forces, now)) = self.sample.parts, self._known
        return np.vstack([s, now[: len(p.law)], *(p.force @ seen for seen in forces)])

    @cached_property
    def _left(self) -> WithoutDrift | None:
        return WithoutDrift(self.sample.matrix, self.neutral) if self.drifts else None

    @cached_property
    def start(self) -> Vector:
        """The same without what drifts of it."""
        return self._moved if self._left is None else self._left.remains @ self._moved

    @property
    def matrix(self) -> Vector:
        """Φ (n_x, n_x), without what drifts."""
        return self.sample.matrix if self._left is None else self._left.matrix

    # Its motion.

    def _between(self, span: float) -> tuple[Vector, Vector, Vector]:
        """Γ(h), H of s(kT + h) = H x_k, and K of τ_k = K x_k."""
        p, size = self.sample.parts, len(self.matrix)
        # As a stack: these times are asked for once, and need not be kept.
        held, push = (matrix[0] for matrix in exponential(p.flow[None], p.drive[None], span))
        n, k, r = len(p.flow), len(p.law), len(p.force)
        command = np.zeros((len(p.direct), size))
        command[:, :n], command[:, n + k : n + k + r] = p.direct, p.spread
        moved = push @ command
        moved[:, :n] += held
        return push, moved, command

    def _split(self, time: float) -> tuple[int, float]:
        """Whole samples, and what follows."""
        k = int(time / self._period)
        return k, max(0.0, time - k * self._period)

    def _at(self, x: Vector, span: float, signal: int) -> tuple[Vector, Vector, Vector]:
        """State s, a signal and its rate, `span` after the sample x."""
        p, rows = self.sample.parts, self._rows(signal)
        _, moved, command = self._between(span)
        s = moved @ x
        return s, rows @ s, rows @ (p.flow @ s + p.drive @ (command @ x))

    def local(self, time: float, row: int, signal: int = 0) -> Instant:
        """A signal at a time, and its derivatives: back through all samples."""
        p, (k, span) = self.sample.parts, self._split(time)
        rows, n = self._rows(signal), len(self.sample.parts.flow)
        x: Vector = np.linalg.matrix_power(self.matrix, k) @ self.start[:, row]
        push, moved, command = self._between(span)
        s, tau = moved @ x, command @ x
        value, rate = rows @ s, rows @ (p.flow @ s + p.drive @ tau)
        size = float(np.linalg.norm(value))
        way = value / size
        pull = way @ rows
        by_matrix, by_start = _through_power(self.matrix, k, self.start[:, row], moved.T @ pull)
        if self._left is not None:
            by_matrix = self._left.through(by_matrix, np.outer(by_start, self._moved[:, row]))
            by_start = self._left.remains.T @ by_start
        slopes = self.sample.slopes(by_matrix) + self._by_start(row, by_start)
        old = x[n + len(p.law) : n + len(p.law) + len(p.force)]
        pushed = push.T @ pull
        by_push = np.outer(pull, tau)
        flow, drive = through_exponential(p.flow, p.drive, span, np.outer(pull, x[:n]), by_push)
        measured = np.zeros_like(p.measured)
        if not signal:
            measured[: len(way)] = np.outer(way, s)
        own = Parts(flow, drive, np.outer(pushed, x[:n]), np.outer(pushed, old), np.zeros_like(p.force),
                    np.zeros_like(p.law), measured)  # fmt: skip
        return Instant(size, float(way @ rate), slopes + Slopes(own, 0.0))

    def _by_start(self, row: int, by: Vector) -> Slopes:
        """From a derivative by x_0 of the move along a task row that by the parts; by the dead time there is none."""
        p, (s, (*forces, _)) = self.sample.parts, self._known
        s, n, k, r = s[:, row], len(p.flow), len(p.law), len(p.force)
        by_law, by_force, by_measured = by[n : n + k], by[n + k :].reshape(-1, r), np.zeros(2 * r)
        by_laws, by_forces = np.zeros_like(p.law), np.zeros_like(p.force)
        for seen, by_one in zip(reversed([each[:, row] for each in forces]), by_force[::-1], strict=True):
            by_laws += np.outer(by_law, seen)
            by_forces += np.outer(by_one, seen)
            by_seen = p.law.T @ by_law + p.force.T @ by_one
            by_law, by_measured = by_seen[:k], by_measured + by_seen[k:]
        if self.motions.filtered:
            by_measured = by_measured + by_law[k - 2 * r :]
        by_s = by[:n] + p.measured.T @ by_measured
        measured = np.outer(by_measured, s)
        to_u, of = np.linalg.inv(self._to_q)[:, self.motions.plant.n_passive :], len(self._to_q)
        by_inverse = np.zeros((to_u.shape[1], r))
        by_inverse[:, row] = to_u.T @ by_s[:of]
        measured[:r, :of] += _through_inverse(*self._joints, by_inverse) @ to_u.T
        rest = {name: np.zeros_like(getattr(p, name)) for name in ("flow", "drive", "direct", "spread")}
        parts = Parts(**rest, force=by_forces, law=by_laws, measured=measured)
        return Slopes(parts, 0.0)

    # What it shows.

    @property
    def _tracks(self) -> list[_Track]:
        return self._looked[0]

    @cached_property
    def _looked(self) -> tuple[list[_Track], bool]:
        """Along each task row: the squares of the signals, close enough that no oscillation slips through.

        And whether no end-point error is loud behind them: a slow one may be quiet for long and come back.
        """
        p, steps = self.sample.parts, math.ceil(LONGEST / self._period)
        fastest = float(np.abs(np.linalg.eigvals(p.flow).imag).max(initial=0.0))
        looks = min(LOOKS, max(1, math.ceil(fastest * self._period / PHASE)))
        signals = [self._rows(signal) for signal in (0, *self.of_base)]
        ends = np.cumsum([len(each) for each in signals]).tolist()
        rows, parts = np.vstack(signals), [slice(low, high) for low, high in pairwise([0, *ends])]
        shown = list[Vector]()
        for j in range(looks):
            _, moved, command = self._between(j * self._period / looks)
            shown += [rows @ moved, rows @ (p.flow @ moved + p.drive @ command)]
        count, many = self.start.shape[1], len(rows)
        block, found, begun = min(BLOCK, steps), list[Vector](), 0
        whole, first = np.linalg.matrix_power(self.matrix, block), self.start
        bound = self._bound(np.stack(shown[::2])[:, parts[0]])
        ended = late = False
        while not (ended or late) and begun < PATIENCE * steps:
            states = np.stack([_powers(self.matrix, first[:, row], block) for row in range(count)], axis=1)
            seen = (np.vstack(shown) @ states.reshape(len(states), -1)).reshape(looks, 2, many, count, block)
            value, rate = seen[:, 0], seen[:, 1]
            # (2, signals, rows, places).
            pairs = np.stack([
                np.stack([product[:, part].sum(axis=1) for part in parts]).transpose(0, 2, 3, 1)
                for product in (value**2, 2 * value * rate)
            ])  # fmt: skip
            found.append(pairs.reshape(2, len(parts), count, -1))
            behind = max(0, steps - begun) * looks
            late = bool(np.any(found[-1][0, 0, :, behind:] > SETTLED**2))
            begun += block
            first = whole @ first
            ended = bound(begun, first) < QUIET * SETTLED
        every = np.concatenate(found, axis=-1)
        return [_Track(every[0, :, row], every[1, :, row], looks) for row in range(count)], ended

    def _bound(self, shown: Vector) -> Callable[[int, Vector], float]:
        """Of |e| from the k-th sample x_k (n_x, r) on, at the places of a sample that `shown` (looks, rows, n_x) sees.

        The less of Σ_i |C v_i| |w_iᴴ x_0 / w_iᴴ v_i| |μ_i|ᵏ, which says nothing where two motions are nearly one, and
        of the root of Σ_j≥k |e_j|² = x_kᵀ W x_k, W = Φᵀ W Φ + CᵀC, which says little where the slowest decays slowly.
        """
        from scipy.linalg import eig, solve_discrete_lyapunov  # noqa: PLC0415  (loads slowly)

        balanced, scale = balance(self.matrix)
        matrix, kept = without_neutral(balanced, self.neutral)
        solved: Any = eig(matrix, left=True, right=True)
        lyapunov: Any = solve_discrete_lyapunov
        values, left, right = solved
        seen, told = shown @ (scale[:, None] * kept.T), kept / scale
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = np.abs(left.conj().T @ told @ self.start) / np.abs(np.sum(left.conj() * right, axis=0))[:, None]
            sizes = np.linalg.norm(seen @ right, axis=1).max(axis=0)[:, None] * shares
        every = seen.reshape(-1, seen.shape[-1])
        # A loop at its border has a sum of rounding alone.
        decays = np.abs(values).max() < 1 - len(matrix) * np.finfo(float).eps
        energy: Vector | None = lyapunov(matrix.T, every.T @ every) if decays else None

        def bound(k: int, x: Vector) -> float:
            with np.errstate(over="ignore", invalid="ignore"):
                remains = (np.abs(values) ** k)[:, None]
                # Forces on their way have many motions at 0, nearly one, which are gone.
                found = np.where(remains > 0, remains * sizes, 0.0).sum(axis=0)
            if energy is not None:
                state = told @ x
                found = np.fmin(found, np.sqrt(np.maximum(np.sum(state * (energy @ state), axis=0), 0.0)))
            return float(found.max())

        return bound

    def _crossing(self, row: int, signal: int, place: int, low: float, level: float | None) -> tuple[float, float]:
        """Within a place that is looked at, from `low` after its sample on, where a square falls through a level.

        Or where its rate falls through 0. Told as that time, s, and as what it is after the sample.
        """
        (k, look), looks = divmod(place, self._tracks[row].looks), self._tracks[row].looks
        x: Vector = np.linalg.matrix_power(self.matrix, k) @ self.start[:, row]

        def height(span: float) -> float:
            _, value, rate = self._at(x, span, signal)
            return 2 * float(value @ rate) if level is None else float(value @ value) - level

        high = (look + 1) * self._period / looks
        if not height(low) > 0:
            span = low
        elif not height(high) < 0:
            span = high
        else:
            span = root(height, low, high, xtol=1e-15 * self._period, rtol=1e-15)
        return k * self._period + span, span

    def _begin(self, row: int, place: int) -> float:
        """Of a place, after its sample, s."""
        looks = self._tracks[row].looks
        return place % looks * self._period / looks

    def _peak(self, row: int, signal: int, place: int) -> tuple[Peak, float]:
        """The maximum between two places that are looked at; and when it is after its sample."""
        time, span = self._crossing(row, signal, place, self._begin(row, place), None)
        x: Vector = np.linalg.matrix_power(self.matrix, place // self._tracks[row].looks) @ self.start[:, row]
        return Peak(float(np.linalg.norm(self._at(x, span, signal)[1])), time, row, signal), span

    def peaks(self, signals: tuple[int, ...], after: float = 0.0, most: int = 1) -> list[Peak]:
        """The largest peaks of some signals later than a time, over all task rows, the largest first.

        Some more than `most` of those that are nearly as high.
        """
        guessed = list[tuple[float, int, int, int]]()
        for row, track in enumerate(self._tracks):
            for signal in signals:
                step = self._period / track.looks
                places, squares = _maxima(track.squares[signal], track.rates[signal], step)
                late = (places + 1) * step > after
                chosen = np.argsort(-squares[late], kind="stable")[: 2 * most]
                guessed += [(float(squares[late][i]), row, signal, int(places[late][i])) for i in chosen]
        guessed.sort(reverse=True)
        least = NEARLY * guessed[most - 1][0] if len(guessed) >= most else 0.0
        found = [self._peak(*place)[0] for square, *place in guessed if square >= least]
        return sorted((peak for peak in found if peak.time > after), key=lambda peak: -peak.size)

    @cached_property
    def settled(self) -> list[float]:
        """Along each task row, after which time |e| stays below 2 % of its start, s; NaN where it does not in a minute.

        Or where that is not known: no excursion may follow, however late. Those that exceed the band by less than a
        half millionth of it do not count.
        """
        return [self._settled(row, track) for row, track in enumerate(self._tracks)]

    def _settled(self, row: int, track: _Track) -> float:
        squares, band = track.squares[0], SETTLED**2
        loud = np.flatnonzero(squares > band * (1 + TOUCH) ** 2)
        if not loud.size:
            return 0.0
        last = int(loud[-1])
        low = self._begin(row, last)
        places, guessed = _maxima(squares, track.rates[0], self._period / track.looks)
        for k in reversed(np.flatnonzero((places > last) & (guessed > CLOSE * band)).tolist()):
            peak, span = self._peak(row, 0, int(places[k]))
            if peak.size > SETTLED * (1 + TOUCH):
                last, low = int(places[k]), span
                break
        quiet = np.flatnonzero(squares[last + 1 :] < band)
        if not (quiet.size and self._looked[1]):
            return math.nan
        # Up to the place before all is loud, or beyond the band by what does not count.
        place = last + int(quiet[0])
        time, _ = self._crossing(row, 0, place, low if place == last else self._begin(row, place), band)
        return time if time <= LONGEST else math.nan

    def settling(self) -> tuple[float, Slopes | None]:
        """The longest of `settled`, s, and its derivative; None where another row, or another excursion, takes over.

        |e(t)| = 2 % of the start: ∂t = −∂|e| / ∂_t|e|.
        """
        times = self.settled
        if any(math.isnan(time) for time in times):
            return math.nan, None
        time, row = max(times), int(np.argmax(times))
        at = self.local(time, row)
        tie = sum(other >= time * (1 - SAME) for other in times) > 1
        touching = any(peak.size > SETTLED * (1 - 2 * TOUCH) for peak in self.peaks((0,), time * (1 + SAME)))
        if tie or touching or -at.rate * time < FLAT * SETTLED:
            return time, None
        return time, at.slopes * (-1 / at.rate)

    @cached_property
    def swung(self) -> tuple[float, Peak | None]:
        """The largest deflection of the base, and its peak; None where two are as large.

        None, too, where it is largest when it is no longer looked at.
        """
        found = self.peaks(self.of_base, most=2)
        seen = max(float(track.squares[1:].max(initial=0.0)) for track in self._tracks)
        if not found or found[0].size ** 2 < CLOSE * seen:
            return math.sqrt(seen), None
        tie = len(found) > 1 and found[1].size >= found[0].size * (1 - SAME)
        return found[0].size, None if tie else found[0]

    def swing(self) -> tuple[float, Slopes | None]:
        """As `swung`, and the derivative: that at the peak's time, which itself makes no difference."""
        size, peak = self.swung
        return size, None if peak is None else self.local(peak.time, peak.row, peak.signal).slopes


def _through_power(matrix: Vector, count: int, start: Vector, by: Vector) -> tuple[Vector, Vector]:
    """From a derivative by x_k = Φᵏ x_0 those by Φ, T_k = Σ_j Φᵀ^(k−1−j) λ x_jᵀ, and by x_0, by binary powers.

    T_2m = Φᵀᵐ T_m + T_m Φᵀᵐ and T_(m+1) = Φᵀ T_m + λ x_mᵀ.
    """
    found, power = np.zeros_like(matrix), np.eye(len(matrix))
    for bit in f"{count:b}":
        found, power = power.T @ found + found @ power.T, power @ power
        if bit == "1":
            found, power = matrix.T @ found + np.outer(by, power @ start), matrix @ power
    return found, power.T @ by


def _powers(matrix: Vector, start: Vector, count: int) -> Vector:
    """x_0, Φ x_0, … (n, count), by doubling."""
    found, whole = start[:, None], matrix
    while found.shape[1] < count:
        found = np.concatenate([found, whole @ found], axis=1)
        if found.shape[1] < count:
            whole = whole @ whole
    return found[:, :count]


def _maxima(squares: Vector, rates: Vector, step: float) -> tuple[NDArray[np.intp], Vector]:
    """Places after which, up to the next, there is a maximum, and how high the cubic through both ends makes it."""
    places = np.flatnonzero((rates[:-1] > 0) & (rates[1:] <= 0))
    low, high, rise, fall = squares[places], squares[places + 1], rates[places] * step, rates[places + 1] * step
    third, second = rise + fall - 2 * (high - low), 3 * (high - low) - 2 * rise - fall
    root = np.sqrt(np.maximum(second**2 - 3 * third * rise, 0.0))
    # Of 0 = rise + 2 second u + 3 third u², without cancellation, and no farther than the next place.
    u = rise / np.maximum(root - second, rise)
    return places, low + u * (rise + u * (second + u * third))


def _through_inverse(matrix: Vector, inverse: Vector, by: Vector) -> Vector:
    """A derivative by A from that by its pseudo-inverse P.

    Source: Golub and Pereyra, SIAM Journal on Numerical Analysis 10(2), 1973.
    """
    left, right = np.eye(len(matrix)) - matrix @ inverse, np.eye(len(inverse)) - inverse @ matrix
    found: Vector = -inverse.T @ by @ inverse.T
    return found + left @ by.T @ inverse @ inverse.T + inverse.T @ inverse @ by.T @ right
