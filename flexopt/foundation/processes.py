"""The same task for many numbers, in several processes where that pays. IPOPT's solver MUMPS is not thread-safe.

In: a task and how many numbers. Out: its results in order, the same on any number of processes. Where processes can be
forked they inherit every graph that is built; elsewhere the task is pickled and builds its own.

A pool of `concurrent.futures` does not do: its processes outlive a parent that is killed, and one that is ended from
outside fails every number of the pool without a word of which it worked on.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import sys
import time
import warnings
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.context import BaseContext
from typing import Any, TypeVar, cast

from flexopt.errors import FlexoptError
from flexopt.foundation.arrays import Progress
from flexopt.foundation.turns import one_blas_thread

T = TypeVar("T")
Task = Callable[[int], T]
Done = Callable[[int], None]

# Work left, s, from which on processes are worth their start: forked ones start in some 10 ms, others import anew.
WORTH_FORKING, WORTH_SPAWNING = 0.1, 5.0
# Numbers that a process is given ahead.
AHEAD_MAX = 8
# How often a number is tried whose process is ended from outside.
TRIES = 2


class ProcessLost(FlexoptError):
    """A process was ended from outside, as the system does for lack of memory, and so was the one that took over."""


def in_parallel(
    task: Task[T],
    count: int,
    workers: int,
    progress: Progress | None = None,
    meanwhile: Callable[[], None] | None = None,
    lost: Callable[[int, str], T] | None = None,
    seen: Callable[[T], None] | None = None,
    *,
    at_once: bool = False,
    ahead: int = 1,
) -> list[T]:
    """[task(0), …, task(count − 1)].

    Numbers are worked off here, one by one, until it shows that processes would be worth their start; `at_once` that is
    known before, of processes that can be forked.

    Args:
        task: a function that depends on its number only; picklable where processes cannot be forked.
        count: of numbers.
        workers: processes at most, this one aside while it waits.
        progress: called with the number of results so far, and of all.
        meanwhile: called once while processes work; not where none do.
        lost: the result of a number whose processes were ended from outside, as for lack of memory, every time that it
            was tried; takes the number and a sentence. Without it that is an error.
        seen: called with each result as it comes, in any order; what it raises ends the others.
        ahead: how many numbers each process is given at a time, where this process looks after them all along.

    Raises:
        Exception: the first one, by number, that the task raised.
        ProcessLost: as above.
    """
    done: Done | None = None if progress is None else lambda number: progress(number, count)
    results: list[T] = []
    method = "fork" if sys.platform == "linux" else "spawn"
    worth = WORTH_FORKING if method == "fork" else WORTH_SPAWNING
    begin = time.perf_counter()
    with one_blas_thread():
        while len(results) < count:
            left = count - len(results)
            known = at_once and method == "fork"
            if results:
                known = (time.perf_counter() - begin) / len(results) * left > worth
            if workers > 1 and left > 1 and known and not _is_worker():
                crew = _Crew(multiprocessing.get_context(method), task)
                numbers = range(len(results), count)
                rest = _spread(crew, numbers, min(workers, left), done, meanwhile, lost, seen, ahead)
                if rest is not None:
                    return results + rest
                workers = 1
            results.append(task(len(results)))
            if seen is not None:
                seen(results[-1])
            if done is not None:
                done(len(results))
    return results


def _is_worker() -> bool:
    """Whether this process may have no children: a daemon's."""
    return bool(multiprocessing.current_process().daemon)


@dataclass
class _Crew:
    """Processes that work, each with the end of its pipe here, and the numbers that each was given and has not done."""

    context: BaseContext
    task: Task[Any]
    pairs: dict[Connection, Any] = field(default_factory=dict[Connection, Any])
    busy: dict[Connection, deque[int]] = field(default_factory=dict[Connection, deque[int]])

    def hire(self) -> bool:
        """Start one more process; false where that cannot be."""
        ours, theirs = self.context.Pipe()
        # A forked child holds the ends of all pipes so far; it must close ours to see when we do.
        held = [ours, *self.pairs] if self.context.get_start_method() == "fork" else []
        process = cast(Any, self.context).Process(target=_work, args=(self.task, theirs, held), daemon=True)
        try:
            with warnings.catch_warnings():
                # Threads that wait (an interactive shell's) do not matter to a child that never meets them.
                warnings.simplefilter("ignore", DeprecationWarning)
                process.start()
        except (OSError, RuntimeError, AttributeError, TypeError, ValueError):
            ours.close()
            return False
        finally:
            theirs.close()
        self.pairs[ours], self.busy[ours] = process, deque()
        return True

    def gone(self, connection: Connection) -> tuple[str, list[int]]:
        """How a process ended, in words, and its numbers, the one that it worked on first."""
        process, left = self.pairs.pop(connection), self.busy.pop(connection)
        connection.close()
        process.join()
        code = int(process.exitcode)
        process.close()
        return (f"signal {-code}" if code < 0 else f"exit code {code}"), list(left)

    def dismiss(self) -> None:
        """Let every process go, those that are still at work by force."""
        for connection, process in self.pairs.items():
            connection.close()
            if process.is_alive():
                process.terminate()
        for process in self.pairs.values():
            process.join()
            process.close()


def _spread(
    crew: _Crew,
    numbers: range,
    workers: int,
    done: Done | None,
    meanwhile: Callable[[], None] | None,
    lost: Callable[[int, str], T] | None,
    seen: Callable[[T], None] | None,
    ahead: int,
) -> list[T] | None:
    """Results of the numbers from `workers` processes; None where processes cannot be started."""
    try:
        while len(crew.pairs) < workers and crew.hire():
            pass
        return _collect(crew, numbers, done, meanwhile, lost, seen, ahead) if crew.pairs else None
    finally:
        crew.dismiss()


def _collect(
    crew: _Crew,
    numbers: range,
    done: Done | None,
    meanwhile: Callable[[], None] | None,
    lost: Callable[[int, str], Any] | None,
    seen: Callable[[Any], None] | None,
    ahead: int,
) -> list[Any]:
    waiting, results, tried = deque(numbers), dict[int, Any](), dict[int, int]()
    failures: dict[int, BaseException] = {}

    def feed(connection: Connection) -> None:
        if waiting and not failures:
            number = waiting.popleft()
            crew.busy[connection].append(number)
            # One that has ended shows when its answer is read.
            with contextlib.suppress(BrokenPipeError):
                connection.send(number)

    def finished(number: int, value: Any) -> None:
        results[number] = value
        if seen is not None:
            seen(value)
        if done is not None:
            done(numbers.start + len(results))

    def replace(connection: Connection) -> None:
        """Another process for one that was ended; what it worked on is tried once more, the rest goes back."""
        ending, (number, *others) = crew.gone(connection)
        waiting.extendleft(reversed(others))
        tried[number] = tried.get(number, 0) + 1
        if tried[number] < TRIES:
            waiting.appendleft(number)
        else:
            sentence = f"its process was ended from outside ({ending}) each of {TRIES} times; memory may be short"
            if lost is None:
                failures[number] = ProcessLost(f"number {number + 1}: {sentence}")
            else:
                finished(number, lost(number, sentence))
        if waiting and not failures and not crew.hire() and not crew.pairs:
            failures[waiting[0]] = ProcessLost(f"processes were ended from outside ({ending}) and none can be started")
        for free in [each for each, left in crew.busy.items() if not left]:
            feed(free)

    # Enough to do for as long as this process does not look; more than a pipe holds would stop it for good, as the
    # others wait until it reads their results.
    ahead = ahead if meanwhile is None else max(1, min(AHEAD_MAX, len(numbers) // (2 * len(crew.pairs))))
    for _ in range(ahead):
        for connection in crew.pairs:
            feed(connection)
    if meanwhile is not None:
        meanwhile()
    while any(crew.busy.values()):
        for ready in cast(list[Connection], wait([connection for connection, left in crew.busy.items() if left])):
            try:
                fine, value = ready.recv()
            except (EOFError, OSError):  # ended before its answer, or amid it
                replace(ready)
                continue
            number = crew.busy[ready].popleft()
            if fine:
                finished(number, value)
            else:
                failures[number] = value
            feed(ready)
    if failures:
        raise failures[min(failures)]
    return [results[number] for number in numbers]


def _work(task: Task[Any], connection: Connection, inherited: list[Connection]) -> None:
    """A process: results of the numbers that come in, until the pipe is closed."""
    # The parent tells when to stop; an interrupt from the keyboard reaches it, too.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    for other in inherited:
        other.close()
    # Not inherited where processes are not forked.
    with one_blas_thread():
        _answers(task, connection)


def _answers(task: Task[Any], connection: Connection) -> None:
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
