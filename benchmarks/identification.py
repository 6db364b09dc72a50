"""Identified numbers beside the truth. `python -m benchmarks.identification [--draws 100] [--seed 1] [--workers 2]`.

Machines with other springs and dampers than their files (factors up to 1.6 either way) are set swinging; SciPy
integrates them with error control. Logs last 10 s at 100 Hz, with white noise of 1 % of what each column moves at most.
How often lies the truth in the 95 % interval, how wide are they, and is any number told to be known that is not?
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from multiprocessing import get_context
from typing import Any

import numpy as np

import flexopt
from benchmarks.timing import table
from flexopt.model import AnyMachine
from flexopt.model.parameter_values import with_parameters
from flexopt.model.uncertainty import parameters_of
from tests.oracles.free_swing import FreeSwing

TOLD_EVERY = 10
SPREAD, NOISE, DURATION, RATE = 0.5, 0.01, 10.0, 100.0
# Whether the truth is inside, the interval's half-width, the value's error; of none identified, None.
Judged = tuple[bool, float, float] | None
# A claim of 1 %: the whole interval lies within 1 % of the value.
CLOSE = 0.01


@dataclass(frozen=True)
class Case:
    """A machine, how it is held, what is measured, and which stiffnesses the 1 % is asked of."""

    machine: str
    posture: tuple[float, ...]
    columns: tuple[str, ...]
    turns: tuple[str, ...]
    unknown: tuple[str, ...] = ("stiffness", "damping")


CASES = {
    "planar": Case("excavator", (0.5, -1.2), ("gyro_z", "end_point.x", "end_point.y"), ("base.stiffness.rotation",)),
    "planar, gyroscope alone": Case("excavator", (0.5, -1.2), ("gyro_z",), ("base.stiffness.rotation",)),
    "six directions": Case(
        "slewing-excavator", (0.5, 0.09, -1.2, -0.7),
        ("gyro_x", "gyro_y", "gyro_z", "end_point.x", "end_point.y", "end_point.z"),
        tuple(f"stiffness.base.{turn}.base.{turn}" for turn in ("roll", "pitch", "yaw")),
    ),
}  # fmt: skip


@dataclass
class Counts:
    """Of one parameter over all draws."""

    identified: int = 0
    inside: int = 0
    widths: list[float] = field(default_factory=list[float])
    claimed: int = 0
    broken: int = 0
    errors: list[float] = field(default_factory=list[float])


def pushed(case: Case, rng: np.random.Generator) -> tuple[AnyMachine, dict[str, float], dict[str, Any]]:
    """The machine of the file, the truth that was drawn, and its log."""
    machine = flexopt.load(case.machine)
    entries = [machine.parameters[i] for i in parameters_of(case.unknown, machine)]
    truth = {each.name: each.value * float(np.exp(rng.uniform(-SPREAD, SPREAD))) for each in entries if each.value}
    units = machine.coordinate_units[: len(machine.coordinates) - len(machine.joints)]
    displaced = [rng.choice([-1, 1]) * rng.uniform(1, 3) * (1e-3 if unit == "m" else 2e-3) for unit in units]
    swing = FreeSwing(with_parameters(machine, truth), case.posture, displaced, np.zeros(len(units)))
    log = swing.log(case.columns, np.arange(int(DURATION * RATE) + 1) / RATE, NOISE, seed=int(rng.integers(2**31)))
    return machine, truth, log


def judged(task: tuple[str, int, int]) -> dict[str, Judged]:
    """What is told of one log's parameters; of those that are identified alone."""
    name, draw, seed = task
    case = CASES[name]
    machine, truth, log = pushed(case, np.random.default_rng([seed, draw]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", flexopt.FlexoptWarning)
        result = flexopt.identify(machine, log, posture=case.posture, unknown=list(case.unknown))
    found: dict[str, Judged] = {}
    for parameter, true in truth.items():
        interval, value = result.intervals[parameter], result.values[parameter]
        if interval is None or value is None:
            found[parameter] = None
        else:
            width = max(abs(end / value - 1) for end in interval)
            found[parameter] = (interval[0] <= true <= interval[1], width, abs(value / true - 1))
    return found


def counted(logs: Iterable[dict[str, Judged]]) -> dict[str, Counts]:
    """Each parameter's counts over all draws."""
    found = defaultdict[str, Counts](Counts)
    for log in logs:
        for name, each in log.items():
            counts = found[name]
            if each is None:
                continue
            inside, width, error = each
            counts.identified += 1
            counts.inside += inside
            counts.widths.append(width)
            counts.errors.append(error)
            if width <= CLOSE:
                counts.claimed += 1
                counts.broken += error > CLOSE
    return found


def lines(case: Case, found: dict[str, Counts], draws: int) -> list[tuple[str, ...]]:
    """A row for each parameter."""
    rows: list[tuple[str, ...]] = [
        ("parameter", "identified", "truth inside", "half-width, median", "error, worst", "1 % told", "1 % broken")
    ]
    for name, counts in found.items():
        inside = f"{counts.inside}/{counts.identified}" if counts.identified else "–"
        width = f"{np.median(counts.widths):.2g}" if counts.widths else "–"
        worst = f"{max(counts.errors):.2g}" if counts.errors else "–"
        told = (f"{counts.claimed}", f"{counts.broken}") if name in case.turns else ("", "")
        rows.append((name, f"{counts.identified}/{draws}", inside, width, worst, *told))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.identification")
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--case", choices=list(CASES), action="append")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    for name in options.case or CASES:
        case, start = CASES[name], time.perf_counter()
        tasks = [(name, draw, options.seed) for draw in range(options.draws)]
        logs: list[dict[str, Judged]] = []
        with get_context("spawn").Pool(options.workers) as pool:
            for log in pool.imap_unordered(judged, tasks):
                logs.append(log)
                if len(logs) % TOLD_EVERY == 0:
                    print(f"{name}: {len(logs)} of {options.draws} draws", file=sys.stderr, flush=True)
        seconds, found = time.perf_counter() - start, counted(logs)
        print(table(f"{name}: {case.machine}, {', '.join(case.columns)}", lines(case, found, options.draws)))
        shares = [counts.inside / counts.identified for counts in found.values() if counts.identified]
        print(
            f"truth inside: {min(shares):.0%} to {max(shares):.0%} of draws; {options.workers} workers, "
            f"{seconds / options.draws:.1f} s a draw\n",
            flush=True,
        )


if __name__ == "__main__":
    main()
