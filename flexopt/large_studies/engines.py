"""Who computes the chunks: this machine's processes, any `concurrent.futures.Executor`, or a Dask cluster.

In: numbers of chunks. Out: what is said of each, as it is finished. Engines carry a path, a checksum and a number; they
are given a few tasks at a time, so that none of them grows with the study.
"""

from __future__ import annotations

import contextlib
import logging
import os
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from typing import Any, NamedTuple, Protocol

from flexopt.errors import Fault, FlexoptError, InputError
from flexopt.foundation.processes import in_parallel
from flexopt.large_studies.chunk import Finished

ChunkTask = Callable[[str, str, int], Finished]
OnFinished = Callable[[Finished], None]
# Tasks that an engine has at a time, for each that works: one to work on, the others on their way; so for processes.
AHEAD, TOGETHER = 4, 2
# How often an engine is asked whether it is still there, and how long it may be without workers, s.
LOOK, PATIENCE = 1.0, 30.0
ANSWER = 10.0


class EngineLost(FlexoptError):
    """Whoever computes is gone."""


class Engine(Protocol):
    """Works off numbers of chunks."""

    def __call__(self, task: ChunkTask, path: str, digest: str, numbers: Sequence[int], seen: OnFinished) -> None:
        """Call `seen` for each of the numbers."""
        ...


class Processes(NamedTuple):
    """Processes of this machine, which take each other's work where one is killed."""

    workers: int

    def __call__(self, task: ChunkTask, path: str, digest: str, numbers: Sequence[int], seen: OnFinished) -> None:
        """As `Engine`."""

        def lost(k: int, sentence: str) -> Finished:
            return Finished(numbers[k], "", (), sentence)

        # The first one is worked on here: what it builds the processes inherit, where they can be forked.
        each = partial(_numbered, task, path, digest, numbers)
        in_parallel(each, len(numbers), self.workers, lost=lost, seen=seen, ahead=TOGETHER)


def _numbered(task: ChunkTask, path: str, digest: str, numbers: Sequence[int], k: int) -> Finished:
    return task(path, digest, numbers[k])


class Elsewhere(NamedTuple):
    """Any executor.

    Attributes:
        executor: whose `submit` is called.
        slots: how many tasks it works on at a time; raises `EngineLost` where it is gone.
    """

    executor: Executor
    slots: Callable[[], int]

    def __call__(self, task: ChunkTask, path: str, digest: str, numbers: Sequence[int], seen: OnFinished) -> None:
        """As `Engine`."""
        left, pending = iter(numbers), dict[Future[Finished], int]()
        try:
            self._fill(task, path, digest, left, pending)
            asked = time.monotonic()
            while pending:
                finished, _ = wait(pending, LOOK, FIRST_COMPLETED)
                for future in finished:
                    number = pending.pop(future)
                    seen(_answer(future, number))
                if finished or time.monotonic() - asked > LOOK:
                    asked = time.monotonic()
                    self._fill(task, path, digest, left, pending)
        finally:
            for future in pending:
                future.cancel()

    def _fill(
        self, task: ChunkTask, path: str, digest: str, left: Iterator[int], pending: dict[Future[Finished], int]
    ) -> None:
        """Hand out as many tasks as are to be on their way."""
        room = AHEAD * self.slots() - len(pending)
        for _ in range(room):
            number = next(left, None)
            if number is None:
                return
            try:
                pending[self.executor.submit(task, path, digest, number)] = number
            except Exception as error:  # an engine's own, of any kind
                raise EngineLost(_said(error)) from error


def _answer(future: Future[Finished], number: int) -> Finished:
    try:
        return Finished(*future.result())
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt | SystemExit):
            raise
        raise EngineLost(f"chunk {number}: {_said(error)}") from error


def _said(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:300]}".rstrip(": ")


@contextmanager
def engine_of(executor: Executor | str | None, workers: int) -> Generator[Engine]:
    """The engine that an argument means: none processes of this machine, text a Dask scheduler's address.

    Raises:
        InputError: no scheduler answers there, or it has another version.
    """
    if executor is None:
        yield Processes(workers)
    elif isinstance(executor, str):
        with _dask_cluster(executor) as engine:
            yield engine
    else:
        yield Elsewhere(executor, lambda: workers)


@contextmanager
def _dask_cluster(address: str) -> Generator[Engine]:
    try:
        distributed: Any = import_module("distributed")
    except ImportError:
        raise _refused(address, 'needs the package distributed: pip install "flexopt[cluster]"') from None
    # What it would tell of a connection that breaks, and of how it tries again, is told here in one sentence.
    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        client = _client(distributed, address)
        try:
            yield Elsewhere(client.get_executor(pure=False), _Cluster(client, address).slots)
        finally:
            _close(client)
    finally:
        logger.setLevel(before)


def _refused(address: str, sentence: str) -> InputError:
    fault = Fault("executor", sentence, repr(address))
    return InputError(f"run_study: {fault}", [fault], "run_study")


def _client(distributed: Any, address: str) -> Any:
    try:
        client = distributed.Client(address, timeout=ANSWER, set_as_default=False, name="flexopt")
    except (OSError, TimeoutError, ValueError) as error:
        sentence = "no Dask scheduler answers there; `dask scheduler` starts one and prints its address"
        raise _refused(address, f"{sentence} ({_said(error)})") from error
    try:
        client.get_versions(check=True)
    except Exception as error:
        _close(client)
        raise _refused(address, f"scheduler, workers and this process have other versions ({_said(error)})") from error
    return client


def _close(client: Any) -> None:
    """Let a client go, also one whose scheduler is gone."""
    with contextlib.suppress(Exception):
        client.close(timeout=2)


class _Cluster:
    """How many workers a scheduler has; whether it is there."""

    def __init__(self, client: Any, address: str) -> None:
        self.client, self.address, self.seen = client, address, time.monotonic()
        self.asked, self.count = -LOOK, 0

    def slots(self) -> int:
        """Threads of its workers now."""
        if self.client.status != "running":
            raise EngineLost(f"the Dask scheduler at {self.address} is gone")
        now = time.monotonic()
        if now - self.asked >= LOOK:
            self.asked = now
            try:
                self.count = sum(self.client.nthreads().values())
            except Exception as error:
                raise EngineLost(f"the Dask scheduler at {self.address} does not answer ({_said(error)})") from error
        if self.count:
            self.seen = now
        elif now - self.seen > PATIENCE:
            raise EngineLost(f"the Dask scheduler at {self.address} has had no workers for {PATIENCE:g} s")
        # Without any, one task waits for the first.
        return max(self.count, 1)


def is_address(text: str) -> bool:
    """Whether text may be a scheduler's address."""
    return "://" in text and bool(text.partition("://")[2].strip()) and os.linesep not in text
