"""Whether chance decides what is recommended: the best configuration over several seeds, on machines in space.

Run: python -m benchmarks.recommended [--seeds N] [--machines NAME …] [--cases N] [--workers N]

Targets are those of `benchmarks.choice`, without constraints; objectives are w_1, whose optima are surfaces, and V with
all weights 1, whose optima may be turned about the target. The spread is the largest difference of any variable, in
scaled variables, unlimited angles the short way round; V of the worst and of the best seed, in units of its scale.
"""

from __future__ import annotations

import argparse
import functools
import time
from multiprocessing import get_context

import numpy as np

import flexopt
from benchmarks.choice import MACHINES, chosen
from benchmarks.timing import table
from flexopt.errors import FlexoptError

Row = tuple[str, int, str, float, float, float, float, str]


def spread(seeds: int, task: tuple[str, int, str]) -> Row:
    """Machine, case, objective; largest spread of z, least and greatest V, seconds for a seed, failures."""
    name, number, objective = task
    machine, target, options = chosen(name, number)
    m = flexopt.build_plant(machine).n_passive
    weights = [1.0] * m if objective == "V" else None
    points: list[np.ndarray] = []
    values: list[float] = []
    failed: list[str] = []
    start = time.perf_counter()
    for seed in range(seeds):
        try:
            found = flexopt.select(
                machine,
                target,
                objective=objective,
                weights=weights,
                control=options["control"],
                seed=seed,
                workers=1,
            )
        except FlexoptError as error:
            failed.append(f"seed {seed}: {error}"[:120])
            continue
        problem = found.problem
        points.append(found.best.z)
        values.append(found.best.objective / problem.objective_scale)
    seconds = (time.perf_counter() - start) / seeds
    if not points:
        return name, number, objective, np.nan, np.nan, np.nan, seconds, "; ".join(failed)
    away = np.array(points) - points[0]
    away[:, problem.turning] = (away[:, problem.turning] + np.pi) % (2 * np.pi) - np.pi
    return (
        name,
        number,
        objective,
        float(np.abs(away / problem.scale).max()),
        min(values),
        max(values),
        seconds,
        "; ".join(failed),
    )


def main() -> None:
    """Print a row for each case, and how many are within the bar."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--machines", nargs="*", default=MACHINES)
    parser.add_argument("--cases", type=int, default=1, help="targets for each machine")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    tasks = [
        (name, number, objective)
        for number in range(options.cases)
        for name in options.machines
        for objective in ("w1", "V")
    ]
    rows = [("machine", "case", "objective", "spread of z", "V, worst seed", "V, best seed", "s a seed", "failed")]
    within = 0
    with get_context("spawn").Pool(options.workers, maxtasksperchild=1) as pool:
        for name, number, objective, off, worst, best, seconds, failed in pool.imap(
            functools.partial(spread, options.seeds), tasks
        ):
            within += off <= 1e-3 and not failed
            row = (f"{off:.1e}", f"{worst:.9g}", f"{best:.9g}", f"{seconds:.1f}", failed)
            print(name, number, objective, *row, flush=True)
            rows.append((name, str(number), objective, *row))
    print(table(f"{within} of {len(tasks)} within 1e-3", rows))


if __name__ == "__main__":
    main()
