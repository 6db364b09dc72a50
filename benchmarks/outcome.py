"""What the sampled loop does, beside other ways: `python -m benchmarks.outcome [rates|gradients|tables|maps] [N]`.

rates: decay rates of N random machines, postures, gains, dead times that are no multiples of the sample, and servos,
beside an exact discretisation in ball arithmetic and nonlinear runs along the slowest motion. gradients: exact
derivatives of outcome measures beside differences in ball arithmetic. tables: stable gains, ranks and decays that were
computed independently for the article's excavator. maps: time of a map of decays over N × N postures with 20 ms of
dead time, and some of its points one by one. Without a word all four.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.stats import spearmanr

import flexopt
from benchmarks.verdicts import DEAD_TIMES, HELD, POSTURES, intervals
from flexopt.foundation.turns import available_cores
from flexopt.loop.outcome import LoopPoint
from flexopt.loop.small_motions import SmallMotions
from tests.oracles.late_cases import SEED, draw_case, nonlinear_growth, slopes_off

CASES, GRADIENTS = 500, 60
# Slower growth than this, 1/s, a nonlinear run need not tell from decay.
NEAR = 0.01


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
    print(f"  beside {len(runs)} nonlinear runs (beyond {NEAR:g}/s; {near} within): off by {max(runs):.1e} at most, "
          f"median {np.median(runs):.1e}; other verdicts: {len(wrong)} {wrong}")  # fmt: skip


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
    motions = SmallMotions(EXCAVATOR, "inverse")
    numbers = {"base": [base], "posture": posture, "p": motions.plant.parameter_values.full(), "kp": [kp] * 2}
    numbers |= {"kv": [kv] * 2, "period": [0.005]}
    return LoopPoint(motions, motions.numbers(numbers), dead_time).decay().value


def ranks(points: int) -> None:
    """Rank correlation of w_1 with the decay along the redundancy, and the best decays."""
    stands = redundancy(points)
    w = np.array([flexopt.evaluate(EXCAVATOR, q, base=x).w[0] for x, q in stands])
    for kp, kv, late in LOOPS:
        values = np.array([decay(q, kp, kv, late, x) for x, q in stands])
        rank = spearmanr(w, values).statistic
        # w_1 touches 0 in several places, which are all best.
        touched = [k for k in range(1, len(w) - 1) if w[k] >= max(w[k - 1], w[k + 1]) and w[k] > -1e-7]
        rank = f"rank correlation {rank:.2f}; best decay {values.max():+.4f}"
        where = ", ".join(f"{values[k]:+.4f}" for k in touched)
        stable = f"stable {int(np.sum(values > 0))} of {len(values)}"
        print(f"  Kp {kp:g}, Kv {kv:g}, {1e3 * late:g} ms: {rank}; {stable}; where w_1 touches 0: {where}")


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
    digger, heavy = flexopt.load("slewing-excavator"), {"kp": 3e6, "kv": 6e5}
    staying = flexopt.evaluate(digger, (0.2, 0.5, -1.2, -0.5), loop=heavy).outcome
    assert isinstance(staying, flexopt.Outcome)
    print(f"  slewing excavator as it stands, Kp 3e6, Kv 6e5: decay {staying.decay:.3f}/s")


def maps(points: int) -> None:
    """Decays over postures."""
    loop = {"kp": 1e4, "kv": 1e3, "dead_time": 0.02}
    for name, rest in (("excavator", None), ("boom-stick-bucket", (0.3,))):
        machine, given = flexopt.load(name), {"over": "posture", "posture": rest, "points": (points, points)}
        flexopt.map_workspace(machine, **given, measures=False, epsilon_max=False, loop=loop)
        begun = time.perf_counter()
        flexopt.map_workspace(machine, **given, measures=False, epsilon_max=False)
        middle = time.perf_counter()
        found = flexopt.map_workspace(machine, **given, measures=False, epsilon_max=False, loop=loop)
        whole, alone = time.perf_counter() - middle, middle - begun
        rate, postures = found.array("decay"), found.array("posture")
        places = np.argwhere(np.isfinite(rate))
        chosen = np.random.default_rng(0).choice(len(places), 20, replace=False)
        off = [
            abs(flexopt.outcome(machine, postures[:, i, j], loop=loop).decay - rate[i, j]) for i, j in places[chosen]
        ]
        states = 2 * (len(machine.kinematic_tree.bodies))
        stable = f"{100 * found.to_dict()['stable']:.1f} %"
        print(f"map of decays, {name}, {states} states and {round(0.02 * 200)} samples on their way: {len(places)} of "
              f"{points}² postures in {whole:.2f} s ({alone:.2f} s without the loop), {available_cores()} threads; "
              f"stable: {stable}; 20 points one by one off by at most {max(off):.1e}/s")  # fmt: skip


def main() -> None:
    words = [word for word in sys.argv[1:] if not word.isdigit()]
    count = next((int(word) for word in sys.argv[1:] if word.isdigit()), None)
    jobs: dict[str, tuple[Callable[[int], None], int]] = {
        "rates": (rates, CASES), "gradients": (gradients, GRADIENTS), "tables": (tables, 401),
        "maps": (maps, 200),
    }  # fmt: skip
    for word in words or list(jobs):
        job, usual = jobs[word]
        job(count or usual)


if __name__ == "__main__":
    main()
