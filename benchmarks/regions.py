"""Guaranteed regions beside sampled ones: `python -m benchmarks.regions`.

Random postures, gains and dead times of the article's excavator, 200 Hz, inverse control: what share of the stable
machines is proven to be so, how long that takes on one core, and whether any of many samples in a proven part is not as
proven. First the note's example: posture B, Kp 1e4, Kv 1e3, all factors in [½, 2].
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import flexopt
from benchmarks.score import Row
from flexopt.foundation.turns import one_blas_thread
from flexopt.loop.certified.certificate import DECAY, RegionProof, certify
from flexopt.loop.evaluation import outcome
from flexopt.loop.uncertain import UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model.uncertainty import Uncertainty

EXCAVATOR, B, RATE = flexopt.load("excavator"), (0.0448, -2.0499), 200.0
SPRINGS = [{"of": f"base.stiffness.{name}", "factor": (0.5, 2.0)} for name in ("x", "y", "rotation")]
DAMPING = {"of": "damping", "factor": (0.5, 2.0)}
PAYLOAD = {"of": "payload.mass", "value": (0.0, 100.0)}
# Boxes that may be looked at: as many as the bars of time allow.
FEW, MANY = 540, 3200
# Bars: proven share of what is stable, median time in s.
BARS = {
    "3 stiffnesses": (0.90, 0.5),
    "and damping": (0.75, 5.0),
    "and payload": (0.75, 5.0),
    "and dead time": (0.75, 5.0),
}
# What is uncertain, boxes that may be looked at, and whether the dead time is, too, by 2 ms.
KINDS: dict[str, tuple[list[dict[str, Any]], int, bool]] = {
    "3 stiffnesses": (SPRINGS, FEW, False),
    "and damping": ([*SPRINGS, DAMPING], MANY, False),
    "and payload": ([*SPRINGS, PAYLOAD], MANY, False),
    "and dead time": (SPRINGS[:2], MANY, True),
}


def uncertain(machine: Any, posture: Any, loop: dict[str, Any], ranges: list[dict[str, Any]]) -> UncertainLoop:
    """A loop over its box."""
    settings = outcome(machine, posture, loop=loop).settings
    known = tuple(Uncertainty(**each) for each in ranges)
    base, box = np.zeros(len(machine.base_coordinates)), UncertaintyBox(machine, known, settings.dead_time)
    return UncertainLoop(settings, base, np.asarray(posture, dtype=float), False, box)


def judged(loop: UncertainLoop, proof: RegionProof, samples: int, seed: int) -> tuple[int, int, int, int]:
    """How many samples are stable, and in leaves proven to be; in proven leaves, and of these not as proven."""
    u = np.random.default_rng(seed).uniform(size=(samples, len(loop.box.uncertainty)))
    decays, inside, wrong, known = loop.decays(u), 0, 0, 0
    for leaf in proof.leaves:
        if leaf.decays is None:
            continue
        here = np.all((u >= leaf.low) & (u <= leaf.high), axis=1)
        inside += int(here.sum())
        known += int(np.sum(decays[here] > 0)) if leaf.decays else 0
        wrong += int(np.sum((decays[here] > DECAY) != leaf.decays))
    stable = int(np.sum(decays > 0))
    return stable, known, inside, wrong


def drawn(rng: np.random.Generator) -> tuple[tuple[float, float], dict[str, float]]:
    """A posture and a loop."""
    posture = float(rng.uniform(-0.6, 1.6)), float(rng.uniform(-2.7, -0.3))
    kp = 10 ** rng.uniform(3, 5)
    kv = 2 * rng.uniform(0.5, 1.5) * math.sqrt(kp * 300.0)
    late = float(rng.choice([0.0, rng.uniform(0.0, 0.02)]))
    return posture, {"kp": float(kp), "kv": float(kv), "rate": RATE, "dead_time": late}


@dataclass
class Reading:
    """One kind of box over many loops.

    Attributes:
        shares: of what is stable the proven part; of loops of which any sample is stable.
        stable, known: samples that are stable, and those of them that are proven to be, of all loops together.
        times: s.
        inside, wrong: samples in proven leaves, and those that are not as proven;  refused: loops.
    """

    shares: list[float] = field(default_factory=list[float])
    times: list[float] = field(default_factory=list[float])
    stable: int = 0
    known: int = 0
    inside: int = 0
    wrong: int = 0
    refused: int = 0


def reading(name: str, count: int, samples: int) -> Reading:
    """Of so many loops, by so many samples of each."""
    (ranges, boxes, late), rng, found = KINDS[name], np.random.default_rng(0), Reading()
    for k in range(count):
        posture, loop = drawn(rng)
        span = {"of": "dead_time", "value": (loop["dead_time"], loop["dead_time"] + 0.002)}
        uncertain_loop = uncertain(EXCAVATOR, posture, loop, [*ranges, *([span] if late else [])])
        begun = time.perf_counter()
        proof = certify(uncertain_loop, boxes=boxes)
        found.times.append(time.perf_counter() - begun)
        found.refused += bool(proof.sentence)
        stable, known, inside, bad = judged(uncertain_loop, proof, samples, k)
        found.stable, found.known = found.stable + stable, found.known + known
        found.inside, found.wrong = found.inside + inside, found.wrong + bad
        if stable:
            found.shares.append(known / stable)
    return found


def told(name: str, found: Reading) -> None:
    """Its lines."""
    (least, slowest), shares = BARS[name], found.shares
    shown = "none is stable"
    if shares:
        shown = f"{found.known / found.stable:.3f}; of one loop {statistics.mean(shares):.3f} mean, "
        shown += f"{statistics.median(shares):.3f} median of {len(shares)}"
    print(f"{name}: unstable or wrong among {found.inside} samples in proven leaves | {found.wrong} | 0")
    print(f"{name}: proven share of the stable volume ({found.refused} refused) | {shown} | ≥ {least:g}")
    times = f"{statistics.median(found.times):.2f} s median, {max(found.times):.2f} s at most"
    print(f"{name}: time | {times} | ≤ {slowest:g} s", flush=True)


@one_blas_thread()
def rows(quick: bool) -> list[Row]:
    """For the score table: mean shares and median times of a few loops."""
    scores = list[Row]()
    for name, count in (("3 stiffnesses", 2 if quick else 30), ("and damping", 2 if quick else 8)):
        found, (least, slowest), what = reading(name, count, 100 if quick else 1000), BARS[name], f"regions, {name}"
        share, ran = statistics.mean(found.shares) if found.shares else 0.0, "NumPy, one thread"
        scores += [
            Row(f"{what}: share of the stable volume that is proven", share, least, True, ran),
            Row(f"{what}: time of a proof, s", statistics.median(found.times), slowest, False, ran),
            Row(f"{what}: samples that are not as proven", float(found.wrong), 0.0, False, ran),
        ]
    return scores


def note() -> None:
    """Posture B."""
    short = {"of": "dead_time", "value": (0.005, 0.01)}
    for name, ranges, late in (
        ("3 stiffnesses, 0 ms", SPRINGS, 0.0), ("and damping, 0 ms", [*SPRINGS, DAMPING], 0.0),
        ("and damping, 5 ms", [*SPRINGS, DAMPING], 0.005),
        ("x, y and dead time in [5, 10] ms", [*SPRINGS[:2], short], 0.005),
    ):  # fmt: skip
        loop = uncertain(EXCAVATOR, B, {"kp": 1e4, "kv": 1e3, "rate": RATE, "dead_time": late}, ranges)
        begun = time.perf_counter()
        proof = certify(loop, boxes=2000)
        took = time.perf_counter() - begun
        _, _, inside, wrong = judged(loop, proof, 2000, 0)
        print(f"B, {name} | {proof.boxes} boxes, {took:.2f} s, {proof.share(True):.3f} proven, "
              f"{wrong} of {inside} wrong | ", flush=True)  # fmt: skip


@one_blas_thread()
def main() -> None:
    """The table, with one thread of BLAS, as `flexopt.stable_region` has."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--loops", type=int, default=100)
    parser.add_argument("--samples", type=int, default=1000, help="of each loop")
    parser.add_argument("--rows", nargs="*", default=list(BARS))
    given = parser.parse_args()
    print("what | read | bar")
    note()
    for name in given.rows:
        told(name, reading(name, given.loops, given.samples))


if __name__ == "__main__":
    main()
