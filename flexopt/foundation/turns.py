"""Calls from several threads take turns: one lock for the whole process.

IPOPT's linear solver MUMPS keeps its state in global variables, and CasADi makes what maps a Function over many points
when it is first asked for, without a lock. Whatever calls either, from the outside, holds `TURN`; calls inside such a
call go through. A process is forked only between turns, so that its child finds nothing half done. What computes on
several cores within its turn asks `available_cores` how many there are.
"""

from __future__ import annotations

import functools
import os
import threading
from collections.abc import Callable
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

TURN = threading.RLock()

if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=TURN.acquire, after_in_parent=TURN.release, after_in_child=TURN.release)


def available_cores() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_turn(call: Callable[P, T]) -> Callable[P, T]:
    """The same function for several threads: one of them at a time computes, the others wait.

    To compute on several cores use processes, or the arguments `workers` and `threads` of what has them.
    """

    @functools.wraps(call)
    def waits(*args: P.args, **kwargs: P.kwargs) -> T:
        with TURN:
            return call(*args, **kwargs)

    return waits
