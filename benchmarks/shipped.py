"""Times and values of two shipped problems over seeds: `python -m benchmarks.shipped`.

The article's problem and `pipe-laying`, whose best configuration stands on a kink of some w_i: V over the objective's
scale, and the whole `select`, graphs built before.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import flexopt

PROBLEMS = ("article", "pipe-laying")


def solved(name: str, seed: int) -> tuple[float, float]:
    """V / scale and seconds."""
    arguments = flexopt.load_problem(name).select_arguments() | {"seed": seed}
    begun = time.perf_counter()
    found = flexopt.select(**arguments)
    return found.best.objective / found.problem.objective_scale, time.perf_counter() - begun


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    count = parser.parse_args().seeds
    for name in PROBLEMS:
        solved(name, 0)
        values, seconds = np.array([solved(name, seed) for seed in range(count)]).T
        print(f"{name}, {count} seeds: V / scale {values.min():.9f} to {values.max():.9f}; "
              f"seed 0 {seconds[0]:.3f} s, mean {seconds.mean():.3f} s, most {seconds.max():.3f} s")  # fmt: skip


if __name__ == "__main__":
    main()
