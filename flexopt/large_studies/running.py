"""A study carried out: chunks handed out, what is said of them gathered, and how to go on where it was interrupted."""

from __future__ import annotations

import contextlib
import json
import os
import time
import warnings
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from flexopt.errors import FlexoptWarning, StudyInterrupted, WriteError
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Progress
from flexopt.foundation.boundary import public
from flexopt.foundation.turns import available_cores, one_blas_thread
from flexopt.foundation.writing import write_file
from flexopt.large_studies import chunk
from flexopt.large_studies.chunk import COMPUTED, KEPT, MENDED, Finished
from flexopt.large_studies.engines import EngineLost, engine_of, is_address
from flexopt.large_studies.folder import PROGRESS, StudyFolder, begin
from flexopt.large_studies.result import StudyResult, result_of
from flexopt.large_studies.status import WORDS
from flexopt.model.study import Study

# How often the folder's summary is written, s; faults of chunks after which a study stops.
TOLD, FAULTS_MAX = 2.0, 4


def _executor(arguments: Arguments, field: str, value: Any) -> Any:
    if not (isinstance(value, Executor) or (isinstance(value, str) and is_address(value))):
        sentence = "must be a concurrent.futures.Executor, or the address of a Dask scheduler, tcp://HOST:PORT"
        arguments.note(field, sentence, value)
    return value


class _Ledger:
    """What has been said of chunks so far; some of it in a file, for whoever asks meanwhile."""

    def __init__(self, folder: StudyFolder, progress: Progress | None) -> None:
        self.folder, self.progress = folder, progress
        self.how: dict[str, int] = {KEPT: 0, COMPUTED: 0, MENDED: 0}
        self.points, self.computed = [0] * len(WORDS), 0
        self.mended, self.faults = list[int](), list[str]()
        self.began = self.told = time.monotonic()
        self.write()

    @property
    def done(self) -> int:
        """Chunks that are there."""
        return sum(self.how.values())

    def seen(self, finished: Finished) -> None:
        """One more; stops the study where going on is of no use."""
        if finished.fault:
            self.faults.append(f"chunk {finished.number}: {finished.fault}")
            if finished.disk or len(self.faults) >= FAULTS_MAX:
                raise EngineLost("; ".join(self.faults))
            return
        self.how[finished.how] += 1
        if finished.how == MENDED:
            self.mended.append(finished.number)
        self.points = [a + b for a, b in zip(self.points, finished.counts, strict=False)] or self.points
        start, stop = self.folder.points.span(finished.number)
        if finished.how != KEPT:
            self.computed += stop - start
        if self.progress is not None:
            total = self.folder.study.total
            self.progress(min(self.done * self.folder.study.chunk_points, total), total)
        if time.monotonic() - self.told > TOLD:
            self.write()

    def write(self) -> None:
        """The summary; a disk without room for it is told of elsewhere."""
        self.told = time.monotonic()
        seconds = self.told - self.began
        summary = {
            "chunks_done": self.done, "chunks_kept": self.how[KEPT], "chunks_mended": self.how[MENDED],
            "points": dict(zip(WORDS, self.points, strict=True)), "seconds": round(seconds, 3),
            "points_per_second": round(self.computed / seconds, 1) if seconds > 0 else 0.0, "process": os.getpid(),
        }  # fmt: skip
        with contextlib.suppress(WriteError):
            write_file(self.folder.path / PROGRESS, json.dumps(summary, indent=2) + "\n", durable=False)


@public(executor=_executor, turn=False)
def run_study(
    study: Study,
    folder: str | os.PathLike[str],
    *,
    executor: Executor | str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> StudyResult:
    """Carry a study out: every chunk that is not in the folder yet is computed and written there at once.

    Nothing that was finished is lost: after a kill, a full disk or Ctrl-C the same call goes on. Chunks that are there
    are read and compared with their checksums; one that was truncated or altered is computed again. The files are the
    same, byte for byte, whoever computes them and in which order. Points that fail are data: their `status` says why.

    Args:
        study: from `flexopt.Study` or `flexopt.load_study`.
        folder: that it lies in, made if missing; it may hold this study, and no other.
        executor: who computes: by default processes of this machine; any `concurrent.futures.Executor`; or the address
            of a Dask scheduler, `"tcp://HOST:PORT"` (extra `cluster`), whose workers must see the same folder.
        workers: processes, or of an executor tasks that it works on at a time; by default one for each core. A cluster
            has its own.
        progress: called with (points done, points in all).

    Raises:
        InputError: the study does not go with its machine; the folder holds another study, or was begun where numbers
            come out otherwise; no scheduler answers.
        StudyInterrupted: the disk is full, or whoever computes is gone. What is finished stays.

    Example:
        >>> result = flexopt.run_study(study, "postures", workers=1)
        >>> result.complete, result.statuses["ok"]
        (True, 1800)
    """
    with one_blas_thread():
        held = begin(Path(folder).absolute(), study)
    ledger = _Ledger(held, progress)
    numbers = range(held.study.chunks)
    try:
        with engine_of(executor, workers or available_cores()) as engine:
            engine(chunk.finish_chunk, str(held.path), held.digest, numbers, ledger.seen)
    except EngineLost as error:
        raise _interrupted(ledger, str(error)) from error
    finally:
        ledger.write()
    if ledger.faults:
        raise _interrupted(ledger, "; ".join(ledger.faults))
    if ledger.mended:
        listed = ", ".join(map(str, ledger.mended[:10])) + (", …" if len(ledger.mended) > 10 else "")
        sentence = f"study {study.name!r}: chunks {listed} were truncated or altered, and were computed again"
        warnings.warn(sentence, FlexoptWarning, stacklevel=2)
    return result_of(held, mended=tuple(ledger.mended))


def _interrupted(ledger: _Ledger, why: str) -> StudyInterrupted:
    study, path = ledger.folder.study, str(ledger.folder.path)
    sentence = (
        f"study {study.name!r} stopped after {ledger.done} of {study.chunks} chunks ({why}); these are in {path!r}, "
    )
    return StudyInterrupted(
        f"{sentence}and the same call goes on from there", folder=path, done=ledger.done, chunks=study.chunks
    )
