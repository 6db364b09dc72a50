"""Shipped planar machines and random ones written as TOML, URDF and MJCF: how far apart any result is.

    python -m benchmarks.one_machine [COUNT]

It evaluates, selects, simulates, maps and exports every machine from each file (`tests.oracles.one_machine`) and prints
the largest relative differences; COUNT random machines, 30 by default. Where an optimum is so flat that rounding alone
moves it, its z is told relative to that.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from flexopt import load
from tests.oracles.one_machine import differences, random_dict

SHIPPED = ("excavator", "boom-stick-bucket")


def main(count: int) -> None:
    """Print a line for each machine and the largest difference of all."""
    machines = [load(name).to_dict() for name in SHIPPED] + [random_dict(seed) for seed in range(count)]
    worst = 0.0
    for seed, data in enumerate(machines):
        with tempfile.TemporaryDirectory() as folder:
            found = differences(data, Path(folder), seed=seed)
        name, value = max(found.items(), key=lambda entry: entry[1])
        worst = max(worst, value)
        print(f"{data['name']:<32} {len(found)} results, at most {value:.1e} apart ({name})", flush=True)
    print(f"{len(machines)} machines, at most {worst:.1e}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 30)
