"""Certificates of the best beside a scan of the whole redundancy and beside the program that checks their logs.

Run: python -m benchmarks.certificates [--problems N] [--points N] [--seed N] [--unchecked]

The article's problem, with its three objectives, and random planar machines (up to five passive coordinates), targets,
weights, controls, joint limits, travel costs and ranges of the base. Each best of `flexopt.select` is certified; then V
is evaluated at many placements with either elbow, by the compiled measures, and compared with the bounds of the
placement's cell and of the certificate; and the log is checked by `flexopt.selection.certificate.check`, which shares
nothing with what wrote it.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

import flexopt
from flexopt.errors import FlexoptError
from flexopt.selection.certificate.check import check
from tests.oracles.certificates import Case, contradictions, random_case

ARTICLE = ((("w1",), None), (("V",), (1.0, 1.0, 1.0)), (("w3",), None))
BAR_ONE, BAR, SECONDS = 1e-8, 1e-5, 2.0


def article() -> Iterator[Case]:
    """The article's problem."""
    for control in ("inverse", "transpose"):
        for (objective,), weights in ARTICLE:
            options = {"objective": objective, "weights": weights, "control": control}
            yield Case(f"article {objective} {control}", flexopt.load("excavator"), np.array([0.0, 1.6]), options)


def examine(case: Case, points: int, checked: bool) -> dict[str, Any] | str:
    """What became of a problem, or why there is none."""
    try:
        selection = flexopt.select(case.machine, case.target, **case.options, workers=1)
    except FlexoptError as error:
        return str(error)
    # Of the processor: all happens in one thread, and other work on the machine takes none of it.
    start = time.process_time()
    certificate = flexopt.certify(selection)
    seconds = time.process_time() - start
    wrong, best = contradictions(selection, certificate, points) if points else (0, -math.inf)
    begin = time.process_time()
    answered = checked and certificate.proven
    faults = check(json.loads(json.dumps(certificate.log, allow_nan=False))).faults if answered else []
    return {
        "verdict": certificate.verdict,
        "gap": certificate.gap / certificate.scale,
        "asked": certificate.gap_asked / certificate.scale,
        "cells": certificate.cells,
        "seconds": seconds,
        "wrong": wrong,
        "beyond": (best - certificate.value) / certificate.scale,
        "faults": faults,
        "accepted": answered and not faults,
        "checking": time.process_time() - begin,
        "status": certificate.status,
    }


def main() -> int:
    """Ends with 1 where anything contradicts, or a bar is missed."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.certificates", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--problems", type=int, default=100, help="random ones")
    parser.add_argument("--points", type=int, default=1_000_000, help="of each scan")
    parser.add_argument("--seed", type=int, default=0, help="of the first random problem")
    parser.add_argument("--unchecked", action="store_true", help="leave the logs unchecked")
    options = parser.parse_args()
    # What is imported and compiled once is no part of a certificate's time.
    flexopt.certify(flexopt.select(flexopt.load("excavator"), (0.0, 1.6), objective="w2", base_range=(0.0, 0.1)))
    found: list[dict[str, Any]] = []
    number = options.seed
    cases = list(article())
    while len(found) < len(cases) + options.problems:
        random = len(found) >= len(cases)
        case = random_case(number) if random else cases[len(found)]
        number += random
        row = examine(case, options.points, not options.unchecked)
        if isinstance(row, str):
            print(f"{case.name}: no selection: {row[:150]}", flush=True)
            if not random:
                return 1
            continue
        found.append(row)
        if row["verdict"] != "proven" or row["wrong"] or row["faults"] or row["gap"] > row["asked"]:
            print(f"{case.name}: {row['status']}; {row['wrong']} contradictions; {row['faults'][:2]}", flush=True)
    proven = [row for row in found if row["verdict"] == "proven"]
    single = [row["gap"] for row in proven if row["asked"] <= BAR_ONE]
    sums = [row["gap"] for row in proven if row["asked"] > BAR_ONE]
    times, cells = np.array([row["seconds"] for row in found]), np.array([row["cells"] for row in found])
    checking = np.array([row["checking"] for row in found])
    wrong, faults = sum(row["wrong"] for row in found), sum(len(row["faults"]) for row in found)
    print(f"problems {len(found)}: {dict(Counter(row['verdict'] for row in found))}; points each {options.points}")
    print(f"logs accepted by the other program: {sum(row['accepted'] for row in found)} of {len(found)}")
    print(f"contradictions: {wrong} by the scans, {faults} by the other program ({checking.max():.1f} s at most)")
    print(f"best of a scan beyond the best selected: {max(row['beyond'] for row in found):.2e} of the scale at most")
    print(f"gap: one w_i {max(single, default=0):.1e} (bar {BAR_ONE:g}), sums {max(sums, default=0):.1e} (bar {BAR:g})")
    print(f"cells: median {np.median(cells):.0f}, most {cells.max()}")
    print(f"seconds of one core: median {np.median(times):.2f}, most {times.max():.2f} (bar {SECONDS:g})")
    return int(bool(wrong or faults or len(proven) < len(found) or times.max() > SECONDS))


if __name__ == "__main__":
    raise SystemExit(main())
