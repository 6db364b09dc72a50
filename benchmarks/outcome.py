"""What the sampled loop does, beside other ways to know it. `python -m benchmarks.outcome [rates|gradients|tables] [N]`.

rates: decay rates of N random machines, postures, gains, dead times that are no multiples of the sample, and servos,
beside an exact discretisation in ball arithmetic and nonlinear runs along the slowest motion. gradients: exact
derivatives of outcome measures beside differences in ball arithmetic. tables: stable gains, ranks and decays that were
computed independently for the article's excavator. Without a word all three.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import spearmanr

import flexopt
from benchmarks.verdicts import draw, intervals
from benchmarks.verdicts import DEAD_TIMES, HELD, POSTURES
from flexopt.loop.outcome import Measured, Outcome
from flexopt.loop.small_motions import SmallMotions, small_motions
from flexopt.loop.spectrum import eigenvectors
from tests.oracles.late_loop import LateLoop, NonlinearRun, directional

SEED, CASES, GRADIENTS = 15, 500, 60
# Slower growth than this, 1/s, a nonlinear run need not tell from decay. Its run: seconds, and the size of its start.
NEAR, RUN, SMALL = 0.01, 1.0, 1e-7
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
    def outcome(self) -> Outcome:
        """What flexopt says of it."""
        return Outcome(self.motions, self.motions.numbers(self.numbers), self.dead_time)


def draw_case(number: int) -> Case:
    """The machine, posture and gains of `benchmarks.verdicts`; any dead time up to 5 samples, a servo every other time."""
    drawn, rng = draw(number), np.random.default_rng([SEED, number])
    o, machine = drawn.options, drawn.machine
    n, r, period = len(machine.joints), len(machine.task_rows), 1 / drawn.options["rate"]
    late = (int(rng.integers(0, 5)) + float(rng.uniform(0.02, 0.98))) * period
    bandwidth = 10 ** rng.uniform(0.3, 1.7, n) if rng.random() < 0.5 else None
    motions = small_motions(machine, o["control"], lagging=bandwidth is not None)
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


def rates(count: int) -> None:
    """Decay rates of random loops."""
    begun, off, runs, wrong, near = time.perf_counter(), list[float](), list[float](), list[int](), 0
    for number in range(count):
        case = draw_case(number)
        ours, other = -case.outcome.decay().value, float(case.oracle.growth())
        off.append(abs(ours - other) / max(1.0, abs(other)))
        if abs(ours) <= NEAR:
            near += 1
            continue
        shown = nonlinear_growth(case)
        runs.append(abs(shown - ours) / max(1.0, abs(ours)))
        if (shown > 0) != (ours > 0):
            wrong.append(number)
    print(f"decay rates, {count} random loops, {time.perf_counter() - begun:.0f} s")
    print(f"  beside the exact discretisation in balls: off by {max(off):.1e} at most, median {np.median(off):.1e}"
          " (1/s, relative above 1)")  # fmt: skip
    print(f"  beside {len(runs)} nonlinear runs (|growth| > {NEAR:g}/s; {near} nearer): off by {max(runs):.1e} at most, "
          f"median {np.median(runs):.1e}; other verdicts: {len(wrong)} {wrong}")  # fmt: skip


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


def gradients(count: int) -> None:
    """Derivatives of outcome measures."""
    begun, found = time.perf_counter(), dict[str, list[float]]()
    for number in range(count):
        rng = np.random.default_rng([SEED + 1, number])
        for name, by, off in slopes_off(draw_case(number), rng):
            found.setdefault(f"{name} by {by}", []).append(off)
    print(f"gradients beside differences in balls, {count} random loops, {time.perf_counter() - begun:.0f} s")
    for name, each in sorted(found.items()):
        print(f"  {name:32} {len(each):5d}  median {np.median(each):.1e}  worst {max(each):.1e}")
    every = np.concatenate(list(found.values()))
    print(f"  all: {len(every)}, above 1e-7: {int(np.sum(every > 1e-7))}, worst {every.max():.1e}")


EXCAVATOR = flexopt.load("excavator")
TARGET, STRAIGHT = (0.0, 1.6), math.radians(10.0)
LOOPS = ((1e4, 1e3, 0.0), (1e5, 2e3, 0.0), (1e5, 2e3, 0.02))


def redundancy(points: int) -> list[tuple[float, np.ndarray]]:
    """Placements and postures that reach the article's target, θ3 at least 10° from straight and from folded."""
    found: list[tuple[float, np.ndarray]] = []
    for elbow in ("up", "down"):
        for x in np.linspace(-4.0, 4.0, points):
            try:
                posture = flexopt.inverse_kinematics(EXCAVATOR, TARGET, base=x, elbow=elbow)[0]
            except flexopt.FlexoptError:
                continue
            if STRAIGHT <= abs(math.remainder(posture[1], math.tau)) <= math.pi - STRAIGHT:
                found.append((float(x), np.asarray(posture)))
    return found


def decay(posture: Any, kp: float, kv: float, dead_time: float, base: float = 0.0) -> float:
    """Of the excavator at 200 Hz, inverse control, 1/s."""
    motions = small_motions(EXCAVATOR, "inverse")
    numbers = {"base": [base], "posture": posture, "p": motions.plant.parameter_values.full(), "kp": [kp] * 2}
    numbers |= {"kv": [kv] * 2, "period": [0.005]}
    return Outcome(motions, motions.numbers(numbers), dead_time).decay().value


def ranks(points: int) -> None:
    """Rank correlation of w_1 with the decay along the redundancy, and the best decays."""
    stands = redundancy(points)
    w = flexopt.evaluate_w(EXCAVATOR, [q for _, q in stands], bases=[[x] for x, _ in stands]).w[:, 0]
    for kp, kv, late in LOOPS:
        values = np.array([decay(q, kp, kv, late, x) for x, q in stands])
        rank = spearmanr(w, values).statistic
        best = int(np.argmax(values))
        print(f"  Kp {kp:g}, Kv {kv:g}, {1e3 * late:g} ms: rank correlation {rank:.2f}; decay best {values[best]:+.4f}, "
              f"at the best w_1 {values[int(np.argmax(w))]:+.4f}; stable {int(np.sum(values > 0))} of {len(values)}")  # fmt: skip


def tables(points: int) -> None:
    """What was computed independently for the article's excavator."""
    print("Stable Kp (searched 10 … 1e9), excavator, inverse control, 200 Hz")
    print("dead time | " + " | ".join(f"{name}, Kv {kv:g}" for name in POSTURES for kv in HELD))
    for row in intervals():
        print(" | ".join(row))
    print(f"along the redundancy to y_e = {TARGET}, {points} placements")
    ranks(points)
    for late in DEAD_TIMES[2:4]:
        by_rk4 = flexopt.sampled_loop(
            EXCAVATOR, POSTURES["B"], kp=1e4, kv=1e3, sensor={"delay": late}, integrator="rk4"
        ).growth_rate
        exact = -decay(POSTURES["B"], 1e4, 1e3, late)
        print(f"  B, Kp 1e4, Kv 1e3, {1e3 * late:g} ms: growth {exact:+.5f}/s exactly, {by_rk4:+.5f}/s by RK4")
    for control in ("transpose", "inverse"):
        kappa = [flexopt.evaluate(EXCAVATOR, q, base=x, control=control, loop={"kp": 1e4, "kv": 1e3}).loop.allowance
                 for x, q in redundancy(41)]  # fmt: skip
        print(f"  κ, {control}: {np.min(kappa):.0f} to {np.max(kappa):.0f}")


def main() -> None:
    words = [word for word in sys.argv[1:] if not word.isdigit()]
    count = next((int(word) for word in sys.argv[1:] if word.isdigit()), None)
    jobs: dict[str, tuple[Callable[[int], None], int]] = {
        "rates": (rates, CASES), "gradients": (gradients, GRADIENTS), "tables": (tables, 401),
    }  # fmt: skip
    for word in words or list(jobs):
        job, usual = jobs[word]
        job(count or usual)


if __name__ == "__main__":
    main()
