"""The same task for many numbers, in several processes where that pays. IPOPT's solver MUMPS is not thread-safe.

In: a task and how many numbers. Out: its results in order, the same on any number of processes. Where processes can be
forked they inherit every graph that is built; elsewhere the task is pickled and builds its own.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import time
import warnings
from collections import deque
from collections.abc import Callable
from multiprocessing.connection import Connection, wait
from multiprocessing.context import BaseContext
from typing import Any, TypeVar, cast

T = TypeVar("T")
Task = Callable[[int], T]
Done = Callable[[int], None]

# Work left, s, from which on processes are worth their start: forked ones start in some 10 ms, others import anew.
WORTH_FORKING, WORTH_SPAWNING = 0.1, 5.0
# Numbers that a process is given ahead.
AHEAD_MAX = 8


def available_cores() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_parallel(
    task: Task[T], count: int, workers: int, done: Done | None = None, meanwhile: Callable[[], None] | None = None
) -> list[T]:
    """[task(0), …, task(count − 1)].

    Numbers are worked off here, one by one, until it shows that processes would be worth their start.

    Args:
        task: a function that depends on its number only; picklable where processes cannot be forked.
        count: of numbers.
        workers: processes at most, this one aside while it waits.
        done: called with the number of results so far.
        meanwhile: called once while processes work; not where none do.

    Raises:
        Exception: the first one, by number, that the task raised.
    """
    results: list[T] = []
    method = "fork" if sys.platform == "linux" else "spawn"
    worth = WORTH_FORKING if method == "fork" else WORTH_SPAWNING
    begin = time.perf_counter()
    while len(results) < count:
        results.append(task(len(results)))
        if done is not None:
            done(len(results))
        left = count - len(results)
        slow = (time.perf_counter() - begin) / len(results) * left > worth
        if workers > 1 and left > 1 and slow and not _is_worker():
            numbers = list(range(len(results), count))
            context = multiprocessing.get_context(method)
            rest = _spread(context, task, numbers, min(workers, left), done, len(results), meanwhile)
            if rest is not None:
                return results + rest
            workers = 1
    return results


def _is_worker() -> bool:
    """Whether this process may have no children: a daemon's."""
    return bool(multiprocessing.current_process().daemon)


def _spread(
    context: BaseContext,
    task: Task[T],
    numbers: list[int],
    workers: int,
    done: Done | None,
    before: int,
    meanwhile: Callable[[], None] | None,
) -> list[T] | None:
    """Results of the numbers from `workers` processes; None where processes cannot be started."""
    pairs: list[tuple[Connection, Any]] = []
    try:
        for _ in range(workers):
            ours, theirs = context.Pipe()
            # A forked child holds the ends of all pipes so far; it must close ours to see when we do.
            held = [ours, *(connection for connection, _ in pairs)] if context.get_start_method() == "fork" else []
            process = cast(Any, context).Process(target=_work, args=(task, theirs, held), daemon=True)
            try:
                with warnings.catch_warnings():
                    # Threads that wait (an interactive shell's) do not matter to a child that never meets them.
                    warnings.simplefilter("ignore", DeprecationWarning)
                    process.start()
            except (OSError, RuntimeError, AttributeError, TypeError, ValueError):
                ours.close()
                if not pairs:
                    return None
                break
            finally:
                theirs.close()
            pairs.append((ours, process))
        return _collect(pairs, numbers, done, before, meanwhile)
    finally:
        _end(pairs)


def _collect(
    pairs: list[tuple[Connection, Any]],
    numbers: list[int],
    done: Done | None,
    before: int,
    meanwhile: Callable[[], None] | None,
) -> list[Any]:
    waiting, results = iter(numbers), dict[int, Any]()
    failures: dict[int, BaseException] = {}
    busy = {connection: deque[int]() for connection, _ in pairs}

    def feed(connection: Connection) -> None:
        number = next(waiting, None)
        if number is not None and not failures:
            busy[connection].append(number)
            # One that has ended shows when its answer is read.
            with contextlib.suppress(BrokenPipeError):
                connection.send(number)

    # Enough to do for as long as this process does not look; more than a pipe holds would stop it for good, as the
    # others wait until it reads their results.
    for _ in range(1 if meanwhile is None else max(1, min(AHEAD_MAX, len(numbers) // (2 * len(pairs))))):
        for connection, _ in pairs:
            feed(connection)
    if meanwhile is not None:
        meanwhile()
    while any(busy.values()):
        for ready in cast(list[Connection], wait([connection for connection, left in busy.items() if left])):
            number = busy[ready].popleft()
            try:
                fine, value = ready.recv()
            except (EOFError, ConnectionResetError):
                failures[number] = RuntimeError(f"a process that solved start {number + 1} ended before it was done")
                busy[ready].clear()
                continue
            if fine:
                results[number] = value
                if done is not None:
                    done(before + len(results))
            else:
                failures[number] = value
            feed(ready)
    if failures:
        raise failures[min(failures)]
    return [results[number] for number in numbers]


def _end(pairs: list[tuple[Connection, Any]]) -> None:
    """Let every process go, those that are still at work by force."""
    for connection, process in pairs:
        connection.close()
        if process.is_alive():
            process.terminate()
    for _, process in pairs:
        process.join()
        process.close()


def _work(task: Task[Any], connection: Connection, inherited: list[Connection]) -> None:
    """A process: results of the numbers that come in, until the pipe is closed."""
    # The parent tells when to stop; an interrupt from the keyboard reaches it, too.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    for other in inherited:
        other.close()
    while True:
        try:
            number = connection.recv()
        except EOFError:
            return
        try:
            answer = (True, task(number))
        except Exception as error:
            answer = (False, error)
        try:
            connection.send(answer)
        except BrokenPipeError:
            return
        except Exception as error:
            connection.send((False, RuntimeError(f"{type(error).__name__}: {error}")))
