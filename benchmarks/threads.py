"""Calls from several threads at once: none crashes, and each gives what it gives alone.

Run: python -m benchmarks.threads [--threads N] [--times N]

Every kind of call runs in a process of its own, all its threads released at once, so that a crash is a row of the table
and not the end of the run; the last row mixes the kinds.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from itertools import cycle, islice

import numpy as np

import flexopt
from benchmarks.timing import table

POSTURE, TARGET = (0.99, -1.4), (0.0, 1.6)


@cache
def _machine() -> flexopt.Machine:
    machine = flexopt.load("excavator")
    assert isinstance(machine, flexopt.Machine)
    return machine


def _select() -> str:
    best = flexopt.select(_machine(), TARGET, workers=1).best
    return repr((best.z.tolist(), best.evaluation.epsilon_max))


def _select_by_margin() -> str:
    return repr(flexopt.select(_machine(), TARGET, objective="epsilon_max", workers=1).best.z.tolist())


def _select_in_processes() -> str:
    return repr(flexopt.select(_machine(), TARGET, objective="w2", workers=2).best.z.tolist())


def _evaluate() -> str:
    return str(flexopt.evaluate(_machine(), POSTURE).to_dict())


def _simulate() -> str:
    run = flexopt.simulate(_machine(), POSTURE, duration=1.0)
    return repr([np.asarray(run.end_point).tobytes(), run.verdict])


def _inverse_kinematics() -> str:
    return repr([p.tobytes() for p in flexopt.inverse_kinematics(_machine(), TARGET, base=1.5)])


def _stability_border() -> str:
    return repr(flexopt.stability_border(_machine(), POSTURE))


CALLS: dict[str, Callable[[], str]] = {
    "select": _select,
    "select, ε_max": _select_by_margin,
    "select, two processes": _select_in_processes,
    "evaluate": _evaluate,
    "simulate": _simulate,
    "inverse_kinematics": _inverse_kinematics,
    "stability_border": _stability_border,
}
MIXED = "all of them, mixed"


def differing(name: str, threads: int, times: int) -> tuple[int, int]:
    """How many of the calls gave something else than a call alone, and how many there were.

    The threads come first, so that they meet graphs that are not built.
    """
    calls = list(CALLS.items()) if name == MIXED else [(name, CALLS[name])]
    results: list[tuple[str, str]] = []
    ready = threading.Barrier(threads)

    def work(number: int) -> None:
        ready.wait()
        for each, call in islice(cycle(calls[number % len(calls) :] + calls[: number % len(calls)]), times):
            try:
                results.append((each, call()))
            except Exception as error:
                results.append((each, repr(error)))

    workers = [threading.Thread(target=work, args=(number,)) for number in range(threads)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    alone = {each: call() for each, call in calls}
    return sum(result != alone[each] for each, result in results), len(results)


def rows(threads: int, times: int) -> Iterator[tuple[str, ...]]:
    """A row for each kind of call."""
    for name in (*CALLS, MIXED):
        code = f"from benchmarks.threads import differing; print(*differing({name!r}, {threads}, {times}))"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        wrong = total = "–"
        with suppress(ValueError):
            wrong, total = done.stdout.split()
        ended = "0" if done.returncode == 0 else f"{done.returncode}: {done.stderr.strip().splitlines()[-1:]}"
        yield name, total, wrong, ended


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--threads", type=int, default=4)
    parser.add_argument("--times", type=int, default=50)
    options = parser.parse_args()
    head = ("call", "calls", "other than alone", "the process ended with")
    found = list(rows(options.threads, options.times))
    print(table(f"{options.threads} threads, {options.times} calls each", [head, *found]))
    if any(wrong != "0" or ended != "0" for _, _, wrong, ended in found):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
