"""Timing shared by the benchmarks."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable


def median_seconds(work: Callable[[], object], *, repeats: int = 15, seconds: float = 0.2) -> float:
    """Median over `repeats` of the mean time of one call; each repeat lasts about `seconds` / `repeats` and more."""
    start = time.perf_counter()
    work()
    once = max(time.perf_counter() - start, 1e-9)
    calls = max(1, round(seconds / repeats / once))
    times: list[float] = []
    for _ in range(repeats):
        start = time.perf_counter()
        for _ in range(calls):
            work()
        times.append((time.perf_counter() - start) / calls)
    return statistics.median(times)


def least_of(works: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """The least time of a call of each, over interleaved rounds: what else the machine does falls on all alike."""
    least = dict.fromkeys(works, float("inf"))
    for _ in range(rounds):
        for name, work in works.items():
            for _ in range(2):  # the second finds its data in the caches
                start = time.perf_counter()
                work()
                least[name] = min(least[name], time.perf_counter() - start)
    return least


def fresh_process(program: str, *arguments: str, environment: dict[str, str] | None = None) -> tuple[float, str]:
    """Seconds of a new Python from its start to its end, and what the program's text printed there."""
    # As on a user's machine, where modules are compiled once.
    given = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    command = [sys.executable, "-c", program, *arguments]
    begin = time.perf_counter()
    done = subprocess.run(command, env=given | (environment or {}), check=True, capture_output=True, text=True)
    return time.perf_counter() - begin, done.stdout


def table(title: str, rows: list[tuple[str, ...]]) -> str:
    """Rows of text in aligned columns; the first row is the header."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return "\n".join([title, *lines, ""])
