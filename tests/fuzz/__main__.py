"""Draw inputs, judge them, print findings and a summary: `python -m tests.fuzz --seconds 60`."""

from __future__ import annotations

import argparse
import itertools
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.fuzz import material
from tests.fuzz.pool import GOOD, Pool, emptied
from tests.fuzz.ways import KINDS, PLANTED
from tests.fuzz.worker import kind_of


def arguments() -> argparse.Namespace:
    """Options of the command."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description="Mutated files and arguments, judged.")
    parser.add_argument("--seconds", type=float, help="stop drawing inputs after so many seconds")
    parser.add_argument("--count", type=int, help="stop after so many inputs")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", nargs="+", choices=[*KINDS, *PLANTED], default=list(KINDS), metavar="KIND")
    parser.add_argument("--only", type=int, nargs="+", metavar="K", help="judge the inputs of these numbers alone")
    parser.add_argument(
        "--workers", type=int, default=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2
    )
    parser.add_argument("--limit-seconds", type=float, default=30.0, help="what one input may take")
    parser.add_argument("--limit-mb", type=float, default=2000.0, help="what one input may hold")
    parser.add_argument("--details", action="store_true", help="print every input, and all of a finding's text")
    parser.add_argument("--material", type=Path, help="folder of the good files, made if it is missing; kept")
    return parser.parse_args()


def drawn(asked: argparse.Namespace) -> Iterator[tuple[int, str, str]]:
    """Numbers of inputs, with their kinds, until time or count is up."""
    ends = time.monotonic() + asked.seconds if asked.seconds else float("inf")
    planted = [kind for kind in asked.kind if kind in PLANTED]
    yield from ((k, "", kind) for k, kind in enumerate(planted))
    numbers: Iterator[int] = iter(asked.only) if asked.only else itertools.count()
    left = asked.count if asked.count else float("inf")
    wanted = set(asked.kind) & set(KINDS)
    for number in numbers if wanted else ():
        if time.monotonic() > ends or left <= 0:
            return
        kind = kind_of(asked.seed, number)
        if kind in wanted:
            left -= 1
            yield number, kind, ""


def main() -> int:
    """Exit code 1 where there are findings."""
    asked = arguments()
    if not (asked.seconds or asked.count or asked.only or set(asked.kind) <= set(PLANTED)):
        asked.seconds = 60.0
    folder = Path(tempfile.mkdtemp(prefix="flexopt-fuzz-"))
    good = (asked.material or folder / "material").resolve()
    try:
        if not good.exists() and set(asked.kind) & set(KINDS):
            material.build(good, asked.kind)
        began = time.monotonic()
        pool = Pool(good, asked.seed, asked.limit_seconds, 1e6 * asked.limit_mb, asked.workers)
        good.mkdir(exist_ok=True, parents=True)
        rows = list[dict[str, Any]]()
        for row in pool.judge(drawn(asked)):
            rows.append(row)
            if row["verdict"] not in GOOD or asked.details:
                # The innermost call is last in a traceback and in the stack of the main thread.
                text = row["text"] if asked.details else row["text"][-1500:]
                line = (
                    f"--seed {asked.seed} --only {row['number']}: {row['kind']}, {row['way']}: {row['verdict'].upper()}"
                )
                print(f"{line} ({row['seconds']:.1f} s)\n    " + text.rstrip().replace("\n", "\n    "), flush=True)
        return summary(rows, time.monotonic() - began)
    finally:
        emptied(folder)


def summary(rows: list[dict[str, Any]], seconds: float) -> int:
    """Counts by kind and way, the slowest, the most memory; 1 where there are findings."""
    print(
        f"\n{'kind':12} {'python':>8} {'command':>8} {'results':>8} {'refused':>8} {'findings':>8} {'mean':>8} {'slowest':>9} {'peak MB':>8}"
    )
    for kind in [kind for kind in (*KINDS, *PLANTED) if any(row["kind"] == kind for row in rows)]:
        own = [row for row in rows if row["kind"] == kind]
        ways, verdicts = Counter(row["way"].partition(" ")[0] for row in own), Counter(row["verdict"] for row in own)
        bad = len(own) - verdicts["result"] - verdicts["refused"]
        mean = sum(row["seconds"] for row in own) / len(own)
        slow, peak = max(row["seconds"] for row in own), max(row["peak"] for row in own) / 1e6
        numbers = f"{ways['python']:8} {ways['command']:8} {verdicts['result']:8} {verdicts['refused']:8} {bad:8}"
        print(f"{kind:12} {numbers} {mean:6.2f} s {slow:7.1f} s {peak:8.0f}")
    findings = [row for row in rows if row["verdict"] not in GOOD]
    counts = ", ".join(f"{n} {verdict}" for verdict, n in sorted(Counter(row["verdict"] for row in findings).items()))
    slowest, largest = (max(rows, key=lambda row, by=by: row[by], default=None) for by in ("seconds", "peak"))
    print(f"{len(rows)} inputs in {seconds:.0f} s: {len(findings)} findings" + (f" ({counts})" if counts else ""))
    if slowest is not None and largest is not None:
        print(f"slowest {slowest['seconds']:.1f} s (--only {slowest['number']}, {slowest['kind']} {slowest['way']})")
        print(
            f"most memory {largest['peak'] / 1e6:.0f} MB (--only {largest['number']}, {largest['kind']} {largest['way']})"
        )
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
