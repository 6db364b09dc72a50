"""The score table: every ratio with a bar, what it is, what it was when it was last recorded, and what ran.

Run: python -m benchmarks [--quick] [--record] [MODULE …]

Every module runs in a process of its own, one after the other. `--record` rewrites this processor's part of
`record.json`, which is kept with the sources; nothing else does. Where there is none of this processor, another's
stands beside the scores, and the table says so. `--quick` takes few repetitions: it shows that everything runs, and
its numbers mean little. Ends with 1 where a module failed, and without `--quick` where a bar is missed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from dataclasses import asdict
from importlib import import_module
from typing import Any

from benchmarks.score import HERE, Row, modules, this_machine
from benchmarks.timing import table

RECORD = HERE / "record.json"
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def rows_of(module: str, *, quick: bool) -> list[Row] | str:
    """Its rows, or what went wrong."""
    command = [sys.executable, "-m", "benchmarks", "--rows", module, *(["--quick"] if quick else [])]
    done = subprocess.run(
        command, cwd=HERE.parent, env=os.environ | ONE_THREAD, capture_output=True, text=True, check=False
    )
    if done.returncode:
        return (done.stderr.strip().splitlines() or ["no output"])[-1]
    return [Row(**row) for row in json.loads(done.stdout.splitlines()[-1])]


def line(row: Row, recorded: dict[str, float]) -> tuple[str, ...]:
    """A row as text."""
    bar = "" if row.bar is None else f"{'≥' if row.at_least else '≤'} {row.bar:g}"
    before = f"{recorded[row.what]:.2f}" if row.what in recorded else "–"
    return row.what, f"{row.value:.2f}", bar, "" if row.bar is None else "yes" if row.met else "NO", before, row.ran


def _alike(one: dict[str, str], other: dict[str, str]) -> bool:
    """Whether two machines have the same processor."""
    return all(one[key] == other[key] for key in ("processor", "vectors"))


def main() -> int:
    """Run, print, record."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__.splitlines()[0])
    parser.add_argument("module", nargs="*", help="all that have rows, by default")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--rows", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.rows:
        found = import_module(options.rows).rows(options.quick)
        print(json.dumps([asdict(row) for row in found]))
        return 0
    if options.quick and options.record:
        parser.error("--quick is not for the record")
    known, others = modules()
    chosen = [name for name in known if not options.module or name.split(".")[1] in options.module]
    kept: list[dict[str, Any]] = json.loads(RECORD.read_text(encoding="utf-8")) if RECORD.exists() else []
    machine = this_machine()
    own = next((of for of in kept if _alike(of["machine"], machine)), None)
    beside = own or (kept[-1] if kept else {"machine": {}, "rows": {}})
    recorded = {what: row["value"] for what, row in beside["rows"].items()}
    lines: list[tuple[str, ...]] = [("what", "now", "bar", "met", "record", "what ran")]
    every, failed = list[Row](), False
    for name in chosen:
        found = rows_of(name, quick=options.quick)
        if isinstance(found, str):
            failed = True
            lines.append((name, "failed", "", "", "", found))
            continue
        every += found
        lines += [line(row, recorded) for row in found]
    print(table(f"Scores on {machine['processor']}, {machine['vectors']}", lines))
    if options.quick:
        print("quick: shows that all run; too few points and rounds for the ratios to be compared with their bars")
    if kept:
        print(f"the record is of {beside['machine']['processor']}, {beside['machine']['vectors']}", end="")
        print("" if own else ": another, whose ratios may be others")
    print("without rows here, each by its own command:", ", ".join(f"python -m {name}" for name in others))
    if options.record and not failed:
        rows = (own or {"rows": {}})["rows"] | {
            row.what: {"value": round(row.value, 3), "ran": row.ran} for row in every
        }
        merged = [of for of in kept if of is not own] + [{"machine": machine, "rows": rows}]
        RECORD.write_text(json.dumps(merged, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    return int(failed or (not options.quick and not all(row.met for row in every)))


if __name__ == "__main__":
    sys.exit(main())
