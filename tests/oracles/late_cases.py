"""Random late loops, the same for flexopt and for `late_loop`: their growth, their measures, and derivatives of these."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.verdicts import draw
from flexopt.loop.loop_motions import Measured
from flexopt.loop.outcome import LoopPoint
from flexopt.loop.small_motions import SmallMotions
from flexopt.loop.spectrum import eigenvectors
from flexopt.loop.standard_move import SETTLED
from tests.oracles.late_loop import LateLoop, NonlinearRun, directional

SEED = 15
# A nonlinear run: seconds, and the size of its start.
RUN, SMALL = 1.0, 1e-7
# Multipliers of which one may be the slowest at the next point, as growth rates, 1/s.
KINK = 1e-3


@dataclass(frozen=True)
class Case:
    """A loop, and the same for the oracle."""

    motions: SmallMotions
    numbers: Mapping[str, Any]
    dead_time: float
    oracle: LateLoop

    @property
    def outcome(self) -> LoopPoint:
        """What flexopt says of it."""
        return LoopPoint(self.motions, self.motions.numbers(self.numbers), self.dead_time)


def draw_case(number: int) -> Case:
    """The machine, posture and gains of `benchmarks.verdicts`; any dead time up to 5 samples, a servo every other time."""
    drawn, rng = draw(number), np.random.default_rng([SEED, number])
    o, machine = drawn.options, drawn.machine
    n, r, period = len(machine.joints), len(machine.task_rows), 1 / drawn.options["rate"]
    late = (int(rng.integers(0, 5)) + float(rng.uniform(0.02, 0.98))) * period
    bandwidth = 10 ** rng.uniform(0.3, 1.7, n) if rng.random() < 0.5 else None
    motions = SmallMotions(machine, o["control"], lagging=bandwidth is not None)
    kp, kv = np.full(r, o["kp"]), np.full(r, o["kv"])
    numbers = {"posture": drawn.posture, "p": motions.plant.parameter_values.full().ravel(), "kp": kp, "kv": kv}
    numbers |= {"period": [period]} | ({} if bandwidth is None else {"bandwidth_hz": bandwidth})
    return Case(motions, numbers, late, LateLoop(machine, drawn.posture, o["control"], kp, kv, period, late, bandwidth))


def nonlinear_growth(case: Case) -> float:
    """Growth of the slowest motion in a nonlinear run that starts in it, 1/s."""
    outcome, run = case.outcome, NonlinearRun(case.oracle)
    n, lag, r = run.sizes
    matrix = outcome.sample.matrix
    mu, left, right = eigenvectors(matrix, outcome.loop.multipliers[0])
    to_q, rate = outcome.motions.loop.to_q, outcome.loop.growth_rate
    start = (right / np.abs(to_q @ right[:n]).max()).real * SMALL
    away = np.concatenate([to_q @ start[:n], to_q @ start[n : 2 * n], start[2 * n : 2 * n + lag]])
    forces = list(start[2 * n + lag :].reshape(-1, r))
    # Not so long that it grows or decays out of what is small.
    samples = max(10, round(min(RUN, 3.0 / max(abs(rate), 1e-3)) / outcome.period))
    end, waiting = run(away, forces, samples)
    u, w = np.linalg.solve(to_q, end[:n]), np.linalg.solve(to_q, end[n : 2 * n])
    after = np.concatenate([u, w, end[2 * n : 2 * n + lag], *waiting])
    # A real start along a pair has both halves; the left eigenvector takes one.
    del mu
    return math.log(abs(left.conj() @ after) / abs(left.conj() @ start)) / (samples * outcome.period)


# Measures as the oracle has them: a value from the loop with some numbers changed.
Value = Callable[[LateLoop], Any]


def measured(case: Case) -> Iterator[tuple[str, Measured, Value]]:
    """Name, what flexopt says, and what the oracle computes."""
    outcome, oracle = case.outcome, case.oracle
    upper = outcome.loop.multipliers[outcome.loop.multipliers.imag >= 0]
    growth = np.log(np.abs(upper)) / outcome.period
    slowest = complex(upper[0])
    if len(growth) < 2 or growth[0] - growth[1] > KINK:
        yield "decay", outcome.decay(), lambda loop: -loop.growth(slowest)
    for s in outcome.loop.poles[:4]:
        if s.imag > 0:
            mu = complex(np.exp(s * outcome.period))
            yield "damping_ratio", outcome.damping_ratio(complex(s)), lambda loop, mu=mu: loop.damping_ratio(mu)
    allowed = outcome.allowed_gain()
    if allowed.slopes is not None:
        factor = allowed.value / float(np.asarray(oracle.kp)[0])
        yield "allowed_gain", allowed, lambda loop: loop.border("factor", factor) * gain_of(loop)
    margin = outcome.delay_margin()
    if margin.slopes is not None:
        border = case.dead_time + margin.value
        # The same side of a whole sample for all that is near.
        if abs(border / outcome.period - round(border / outcome.period)) > 1e-3:
            yield "delay_margin", margin, lambda loop: loop.border("dead_time", border) - late_of(loop)
    for name, feed, sign in (("sensitivity_peak", 2, 1), ("complementary_peak", 0, -1), ("disk_margin", 1, 1)):
        found, angle = getattr(outcome, name)(), outcome.peak_angle(name)
        if found.slopes is not None and 1e-3 < angle < math.pi - 1e-3:
            yield name, found, lambda loop, f=feed, s=sign, a=angle: peak_of(loop, a, f, s)
    norm = outcome.h2_norm()
    if norm.slopes is not None:
        yield "h2_norm", norm, h2_of
    yield from _of_move(case)


def _of_move(case: Case) -> Iterator[tuple[str, Measured, Value]]:
    """What is measured of the standard move."""
    outcome = case.outcome
    settling, swing = outcome.settling(), outcome.swing()
    if outcome.move is None:
        return
    if settling.slopes is not None:
        row = int(np.argmax(outcome.move.settled))
        yield "settling", settling, lambda loop, row=row: loop.settling(settling.value, row, SETTLED)
    peak = outcome.move.swung[1]
    if swing.slopes is not None and peak is not None:
        rows = list(case.motions.loop.shape.base_hinges) or list(range(case.motions.plant.n_passive))
        coordinate = rows[peak.signal - 1]
        yield "swing", swing, lambda loop, c=coordinate: loop.swing(peak.time, peak.row, c)


def h2_of(loop: LateLoop) -> Any:
    """The norm of the end-point's response to forces on the base."""
    return loop.h2_norm()


def gain_of(loop: LateLoop) -> Any:
    """Kp of the first row."""
    return loop.kp[0]


def late_of(loop: LateLoop) -> Any:
    """The dead time."""
    return loop.dead_time


def peak_of(loop: LateLoop, angle: float, feed: int, sign: int) -> Any:
    """A peak, or of S − I/2 its inverse, the disk margin."""
    peak = loop.peak(angle, feed, sign)
    return 1 / peak if feed == 1 else peak


def slopes_off(case: Case, rng: np.random.Generator) -> Iterator[tuple[str, str, float]]:
    """Measure, what it is differentiated by, and how far from the difference, relative to Σ |g_i d_i|."""
    at = {name: getattr(case.oracle, name) for name in ("posture", "kp", "kv", "dead_time")}
    at |= {"p": np.asarray(case.numbers["p"])}
    at |= {} if case.oracle.bandwidth_hz is None else {"bandwidth_hz": case.oracle.bandwidth_hz}
    for name, found, value in measured(case):
        gradient = case.outcome.gradient(found)
        for by, x in at.items():
            size = np.abs(np.ravel(x)) if by != "posture" else np.ones(np.size(x))
            along = rng.uniform(-1, 1, np.size(x)) * size
            terms = gradient[by] * along
            if not np.abs(terms).sum():
                continue
            truth = directional(lambda changed, v=value: v(replace(case.oracle, **changed)), {by: x}, {by: along})
            yield name, by, abs(float(terms.sum()) - truth) / float(np.abs(terms).sum())
