"""Compiled code at work in threads of its own, while this one can be interrupted."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

# From so many evaluations of a Function on, code runs in a thread of its own: below, a start is what takes longest.
LONG = 20_000
# How often it is looked whether the code is done, s: an interrupt comes through between.
PATIENCE = 0.1


def awaited(calls: Sequence[Callable[[], int]], evaluations: int) -> list[int]:
    """Return what each call returns, the calls side by side.

    An interrupt is raised at once. The calls then go on unseen, on arrays that they hold; they end with the process.

    Args:
        calls: of compiled code, which ctypes runs without the interpreter's lock.
        evaluations: of Functions in all.
    """
    if len(calls) == 1 and evaluations < LONG:
        return [calls[0]()]
    found, done = [0] * len(calls), [threading.Event() for _ in calls]

    def work(k: int) -> None:
        try:
            found[k] = calls[k]()
        finally:
            done[k].set()

    for k in range(len(calls)):
        threading.Thread(target=work, args=(k,), daemon=True).start()
    for each in done:
        while not each.wait(PATIENCE):
            pass
    return found
