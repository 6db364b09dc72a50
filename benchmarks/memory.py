"""Peak memory of long runs over many machines: `python -m benchmarks.memory [--machines N] [--outcomes N]`.

The first process evaluates random machines, planar and spatial, mixed with the shipped machines with other numbers.
The second one computes outcomes of the mobile manipulator with other masses. Each prints its peak resident memory and
the time of a call.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import flexopt
from benchmarks.score import Row
from tests.oracles.machines import random_machine
from tests.oracles.spatial import random_tree

MACHINES, OUTCOMES, LIMIT = 1000, 300, 400.0
SHIPPED = ("excavator", "boom-stick-bucket", "mobile-manipulator", "slewing-excavator", "truck-crane")


def with_other_masses(machine: flexopt.Machine | flexopt.Tree, rng: np.random.Generator) -> Any:
    """A machine with other masses: the payload's, and all bodies' by one factor."""
    data, factor = machine.to_dict(), float(rng.uniform(0.8, 1.25))
    for body in [*data.get("bodies", ()), *data.get("links", ()), *([data["base"]] if "links" in data else [])]:
        for name in ("mass", "inertia"):
            if name in body:
                body[name] = np.multiply(body[name], factor).tolist()
    data["payload"] = {"mass": float(rng.uniform(0.1, 5.0))}
    return flexopt.tree_from_dict(data) if "bodies" in data else flexopt.machine_from_dict(data)


def machines(count: int) -> Iterator[Any]:
    """Random planar and spatial machines, and the shipped ones with other masses, in turn."""
    rng = np.random.default_rng(0)
    shipped = [flexopt.load(name) for name in SHIPPED]
    for number in range(count):
        match number % 3:
            case 0:
                yield random_machine(rng)[1]
            case 1:
                yield flexopt.tree_from_dict(random_tree(number))
            case _:
                yield with_other_masses(shipped[number // 3 % len(shipped)], rng)


def posture_of(machine: Any) -> np.ndarray:
    """A posture between the joint limits, not in their middle."""
    low, high = np.clip(machine.limits, -2.0, 2.0).T
    return low + np.linspace(0.55, 0.7, len(low)) * (high - low)


def evaluations(count: int) -> int:
    """Evaluate that many machines; return how many had no answer."""
    refused = 0
    for machine in machines(count):
        try:
            flexopt.evaluate(machine, posture_of(machine))
        except flexopt.FlexoptError:
            refused += 1
    return refused


def outcomes(count: int) -> int:
    """Outcomes of the mobile manipulator with other masses."""
    rng, shipped, refused = np.random.default_rng(0), flexopt.load("mobile-manipulator"), 0
    for _ in range(count):
        try:
            str(flexopt.outcome(with_other_masses(shipped, rng), posture_of(shipped)))
        except flexopt.FlexoptError:
            refused += 1
    return refused


def peak() -> float:
    """The largest resident memory of this process so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)


RUNS: dict[str, Callable[[int], int]] = {"evaluations": evaluations, "outcomes": outcomes}


def measured(run: str, count: int) -> tuple[float, float, int]:
    """Peak memory, MB, seconds of a call and refusals, in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.memory", "--run", run, str(count)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    memory, seconds, refused = done.stdout.split()[-3:]
    return float(memory), float(seconds), int(refused)


def rows(quick: bool) -> list[Row]:
    """Rows of the score table."""
    counts = {"evaluations": 30, "outcomes": 5} if quick else {"evaluations": MACHINES, "outcomes": OUTCOMES}
    return [
        Row(f"peak memory of {run}, each of another machine, MB", measured(run, count)[0], LIMIT, False, str(count))
        for run, count in counts.items()
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.memory", description=__doc__.splitlines()[0])
    parser.add_argument("--machines", type=int, default=MACHINES)
    parser.add_argument("--outcomes", type=int, default=OUTCOMES)
    parser.add_argument("--run", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.run:
        run, count = options.run[0], int(options.run[1])
        begun = time.perf_counter()
        refused = RUNS[run](count)
        print(peak(), (time.perf_counter() - begun) / count, refused)
        return
    for run, count in (("evaluations", options.machines), ("outcomes", options.outcomes)):
        memory, seconds, refused = measured(run, count)
        print(f"{count} {run}: {memory:.0f} MB at most (bar {LIMIT:g}), {seconds:.3f} s each, {refused} refused")


if __name__ == "__main__":
    main()
