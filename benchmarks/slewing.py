"""Selection for a slewing excavator with every kind of constraint: time, and how good 32 starts are.

Run: python -m benchmarks.slewing [samples of the reference, 2000 by default]

The problem is problems/pipe-laying.toml: placement x, y, yaw and four joints, six compliant directions. Seconds
are wall seconds and processor seconds of this process and its children. The first call of a fresh process builds every
graph; later calls, here with another target, find them. The gap is that of the best objectives, relative to the
problem's scale of |a||b|, to what `benchmarks.choice` finds without slopes. Nothing of a machine is kept on disk: a
first call builds everything, every time.
"""

from __future__ import annotations

import json
import os
import statistics
import sys
import time
from typing import Any

import flexopt
from benchmarks.choice import PARENTS, SAMPLES, STEPS, Other
from benchmarks.timing import fresh_process, table

REPEATS = 5
PROCESSES = 3
FIRST = """
import json, os, time
import flexopt
arguments = flexopt.load_problem("pipe-laying").select_arguments()
begin, before = time.perf_counter(), sum(os.times()[:4])
problem = flexopt.build_selection(**arguments)
built = time.perf_counter()
flexopt.solve_selection(problem)
print(json.dumps([built - begin, time.perf_counter() - built, sum(os.times()[:4]) - before]))
"""


def used() -> float:
    """Processor seconds of this process and its children that ended."""
    return sum(os.times()[:4])


def timed(arguments: dict[str, Any]) -> tuple[float, float, flexopt.Selection]:
    begin, before = time.perf_counter(), used()
    selection = flexopt.select(**arguments)
    return time.perf_counter() - begin, used() - before, selection


def first() -> tuple[float, float, float]:
    """Wall seconds of `build_selection` and of `solve_selection` in a fresh process, processor seconds of both."""
    build, solve, processor = json.loads(fresh_process(FIRST)[1])
    return build, solve, processor


def main() -> None:
    """Print the tables."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else SAMPLES
    firsts = [first() for _ in range(PROCESSES)]
    first_build, first_solve, first_used = min(firsts, key=lambda seconds: seconds[0] + seconds[1])
    arguments = flexopt.load_problem("pipe-laying").select_arguments()
    _, _, selection = timed(arguments)
    x, y, z = arguments["target"]
    runs = [timed(arguments | {"target": (x + 0.1 * k, y, z)})[:2] for k in range(1, REPEATS + 1)]
    alone = [timed(arguments | {"target": (x + 0.1 * k, y, z), "workers": 1})[:2] for k in range(1, REPEATS + 1)]
    median = [statistics.median(column) for column in zip(*runs, strict=True)]
    single = [statistics.median(column) for column in zip(*alone, strict=True)]
    rows = [
        ("what", "wall s", "processor s"),
        ("first build_selection of a process (graphs of plant, measures, constraints)", f"{first_build:.2f}", ""),
        ("first solve_selection (graphs of the solver, of the proof, of ε_max)", f"{first_solve:.2f}", ""),
        ("both: first select of a process", f"{first_build + first_solve:.2f}", f"{first_used:.2f}"),
        ("later select, another target (bar: 1 s)", f"{median[0]:.2f}", f"{median[1]:.2f}"),
        ("the same with workers=1", f"{single[0]:.2f}", f"{single[1]:.2f}"),
    ]
    print(table(f"32 starts, {len(selection.problem.constraints)} rows, {os.cpu_count()} cores", rows))

    scale = selection.problem.objective_scale
    best = Other(selection.problem, 1).best(count, PARENTS, STEPS)[0] / scale
    lines = [("seed", "best of 32 starts", "gap (bar: 1e-4)", "verified optima")]
    for seed in range(10):
        other = flexopt.select(**arguments | {"seed": seed})
        value = other.best.objective / scale
        lines.append((str(seed), f"{value:.5f}", f"{best - value:.1e}", str(len(other.candidates))))
    print(table(f"Best objective / |a||b|; best of {count} samples, improved: {best:.5f}", lines))


if __name__ == "__main__":
    main()
