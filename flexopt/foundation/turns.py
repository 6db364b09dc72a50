"""Calls from several threads take turns: one lock for the whole process.

IPOPT's linear solver MUMPS keeps its state in global variables, and CasADi makes what maps a Function over many points
when it is first asked for, without a lock. Whatever calls either, from the outside, holds `TURN`; calls inside such a
call go through. A process is forked only between turns, so that its child finds nothing half done. What computes on
several cores within its turn asks `available_cores` how many there are; BLAS has one thread in it.
"""

from __future__ import annotations

import contextlib
import functools
import os
import sys
import threading
from collections.abc import Callable, Generator
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

TURN = threading.RLock()

if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=TURN.acquire, after_in_parent=TURN.release, after_in_child=TURN.release)


def available_cores() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


# What OpenBLAS, in NumPy's and SciPy's wheels, reads when it is loaded; the first that holds a number counts.
THREADS_OF_OPENBLAS = ("OPENBLAS_NUM_THREADS", "GOTO_NUM_THREADS", "OMP_NUM_THREADS")
_limited = False


@contextlib.contextmanager
def one_blas_thread() -> Generator[None]:
    """A turn with one thread of BLAS, here and in processes that are started from it, until its end.

    Matrices here have some ten to a hundred rows. Several threads, which wait for each other by spinning, took eight
    times the processor time of one for an outcome, and more than forty times for a map of outcomes.
    """
    global _limited  # noqa: PLW0603
    with TURN:
        if _limited:
            yield
            return
        _limited = True
        try:
            with _blas(len(sys.modules)).limit(limits=1, user_api="blas"), _one_thread_of_scipy():
                yield
        finally:
            _limited = False


@functools.lru_cache(maxsize=1)
def _blas(_modules: int) -> Any:
    """What sets the threads of the libraries that are loaded; looked for again where modules were imported since."""
    # Only where something is computed: `import flexopt` does without it.
    from threadpoolctl import ThreadpoolController  # noqa: PLC0415 # pyright: ignore[reportMissingTypeStubs]

    return ThreadpoolController()


@contextlib.contextmanager
def _one_thread_of_scipy() -> Generator[None]:
    """SciPy, which loads slowly and is imported where it is needed, brings a BLAS of its own: with one thread, too.

    Afterwards it has the threads that it would have had.
    """
    if "scipy.linalg" in sys.modules:
        yield
        return
    first = THREADS_OF_OPENBLAS[0]
    asked = os.environ.get(first)
    os.environ[first] = "1"
    try:
        yield
    finally:
        os.environ.pop(first, None)
        if asked is not None:
            os.environ[first] = asked
        if "scipy.linalg" in sys.modules:
            for library in _blas(len(sys.modules)).lib_controllers:
                if library.user_api == "blas" and library.num_threads == 1:
                    library.set_num_threads(_threads_of_openblas())


def _threads_of_openblas() -> int:
    """As many as it takes by itself."""
    asked = (os.environ.get(name, "") for name in THREADS_OF_OPENBLAS)
    numbers = (int(text) for text in asked if text.isdigit())
    return min(next(filter(None, numbers), available_cores()), available_cores())


def in_turn(call: Callable[P, T]) -> Callable[P, T]:
    """The same function for several threads: one of them at a time computes, the others wait.

    To compute on several cores use processes, or the arguments `workers` and `threads` of what has them.
    """

    @functools.wraps(call)
    def waits(*args: P.args, **kwargs: P.kwargs) -> T:
        with one_blas_thread():
            return call(*args, **kwargs)

    return waits
