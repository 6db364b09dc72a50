"""Configurations chosen by their decay, with gains, beside differential evolution: `python -m benchmarks.codesign`.

The article's excavator and target, inverse control, 200 Hz, gains Kp 10 … 1e7 and Kv 1 … 1e5, dead times of 0, 5, 20
and 50 ms: with the machine's own numbers, and in the worst case over one factor of all springs and one of the
rotational one, each ½ to 2. The reference evolves placement and gains in zones of each elbow, without a derivative.
"""

from __future__ import annotations

import argparse
import math
import time
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution

import flexopt
from flexopt.loop.outcome import LoopPoint
from flexopt.loop.small_motions import SmallMotions

EXCAVATOR, TARGET, RATE = flexopt.load("excavator"), (0.0, 1.6), 200.0
KP, KV, DEAD_TIMES = (10.0, 1e7), (1.0, 1e5), (0.0, 0.005, 0.02, 0.05)
STRAIGHT = math.radians(10.0)
ZONES, REACH, UNREACHED = 8, 3.4, -100.0
# Of a worst case the reference looks at the corners, the middles of the edges and the middle.
FACTORS = (0.5, 1.0, 2.0)
TOGETHER, ROTATION = "stiffness", "base.stiffness.rotation"


def decay(base: float, elbow: str, kp: float, kv: float, late: float, *, worst: bool) -> float:
    """Of the loop, the least over the factors; −100 where the target is out of reach or the arm too straight."""
    try:
        posture = flexopt.inverse_kinematics(EXCAVATOR, TARGET, base=base, elbow=elbow)[0]
    except flexopt.FlexoptError:
        return UNREACHED
    if not STRAIGHT <= abs(math.remainder(float(posture[1]), math.tau)) <= math.pi - STRAIGHT:
        return UNREACHED
    motions = SmallMotions(EXCAVATOR, "inverse")
    names, nominal = motions.plant.parameter_names, motions.plant.parameter_values.full().ravel()
    springs = [k for k, name in enumerate(names) if name.startswith("base.stiffness")]
    values = list[float]()
    for common in FACTORS if worst else (1.0,):
        for rotation in FACTORS if worst else (1.0,):
            p = nominal.copy()
            p[springs] *= common
            p[names.index(ROTATION)] *= rotation
            numbers: Any = {"base": [base], "posture": posture, "p": p, "kp": [kp] * 2, "kv": [kv] * 2}
            given = motions.numbers(numbers | {"period": [1 / RATE]})
            values.append(-LoopPoint(motions, given, late).loop.growth_rate)
    return min(values)


def evolved(late: float, *, worst: bool, generations: int) -> float:
    """The best decay that differential evolution finds in any zone."""
    best, edges = UNREACHED, np.linspace(-REACH, REACH, ZONES + 1)
    for elbow in ("up", "down"):
        for k, (low, high) in enumerate(pairwise(edges.tolist())):
            found: Any = differential_evolution(
                lambda x, elbow=elbow: -decay(x[0], elbow, math.exp(x[1]), math.exp(x[2]), late, worst=worst),
                [(low, high), tuple(np.log(KP)), tuple(np.log(KV))],
                maxiter=generations, popsize=10, tol=1e-8, rng=k, polish=False,
            )  # fmt: skip
            best = max(best, -float(found.fun))
    return best


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dead-times", type=float, nargs="*", default=list(DEAD_TIMES), help="s")
    parser.add_argument("--generations", type=int, default=60, help="of the reference, in each zone")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--cases", nargs="*", default=["nominal", "worst"])
    given = parser.parse_args()
    print("case, dead time | ours, 1/s | evolved, 1/s | short by | time | Kp | Kv")
    for case in given.cases:
        worst = case == "worst"
        ranges = [{"of": name, "factor": FACTORS[::2]} for name in (TOGETHER, ROTATION)]
        for late in given.dead_times:
            loop = {"kp_range": KP, "kv_range": KV, "dead_time": late, "rate": RATE}
            begun = time.perf_counter()
            found: Any = flexopt.select(
                EXCAVATOR, TARGET, objective="decay", loop=loop, ranges=ranges if worst else None,
                workers=given.workers,
            )  # fmt: skip
            took, gains, ours = time.perf_counter() - begun, found.gains[0], found.best.objective
            other = evolved(late, worst=worst, generations=given.generations)
            print(f"{case}, {1e3 * late:g} ms | {ours:.6g} | {other:.6g} | {(other - ours) / abs(other):+.2%} | "
                  f"{took:.1f} s | {gains['kp']:.4g} | {gains['kv']:.4g}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
