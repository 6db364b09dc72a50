"""Workers that judge inputs, watched from outside: who takes too long or too much memory, or dies, is a finding."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.fuzz.worker import resident

ROOT = Path(__file__).resolve().parents[2]
WATCHED_EVERY = 0.05
# A worker that holds more after an input is replaced, so that what one holds is of a few inputs.
HELD_MAX = 800e6
GOOD = ("result", "refused")


@dataclass
class Pool:
    """Workers, each with a thread that gives it numbers."""

    material: Path
    seed: int
    seconds_max: float
    bytes_max: float
    workers: int
    rows: queue.Queue[dict[str, Any]] = field(default_factory=queue.Queue)

    def judge(self, inputs: Iterator[tuple[int, str, str]]) -> Iterator[dict[str, Any]]:
        """A row for each input (its number, its kind, the planted kind), as they end."""
        lock, alive = threading.Lock(), self.workers

        def serve() -> None:
            worker = _Worker(self)
            try:
                while True:
                    with lock:
                        given = next(inputs, None)
                    if given is None:
                        return
                    self.rows.put(worker.ask(*given))
            finally:
                worker.close()
                self.rows.put({})

        for _ in range(self.workers):
            threading.Thread(target=serve, daemon=True).start()
        while alive:
            row = self.rows.get()
            if row:
                yield row
            else:
                alive -= 1


class _Worker:
    def __init__(self, pool: Pool) -> None:
        self.pool, self.process, self.folder = pool, None, ""

    def _start(self) -> subprocess.Popen[str]:
        self.folder = tempfile.mkdtemp(prefix="worker-", dir=self.pool.material.parent)
        words = [
            sys.executable,
            "-m",
            "tests.fuzz.worker",
            str(self.pool.material),
            self.folder,
            str(self.pool.seed),
            str(self.pool.seconds_max),
        ]
        environment = os.environ | {
            "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "FLEXOPT_COMPILE": "0", "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg",
            "FLEXOPT_CACHE": str(self.pool.material.parent / "kernels"), "PYTHONHASHSEED": "0", "TMPDIR": self.folder,
        }  # fmt: skip
        process = subprocess.Popen(
            words, cwd=ROOT, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            text=True, start_new_session=True,
        )  # fmt: skip
        assert process.stdout is not None
        process.stdout.readline()
        return process

    def ask(self, number: int, kind: str, planted: str) -> dict[str, Any]:
        """Judge one input; the worker may not survive it."""
        self.process = process = self.process or self._start()
        assert process.stdin is not None
        assert process.stdout is not None
        answer = list[str]()
        reader = threading.Thread(target=lambda: answer.append(process.stdout.readline()), daemon=True)  # type: ignore[union-attr]
        began, seconds_max, peak = time.monotonic(), self.pool.seconds_max, 0
        with contextlib.suppress(OSError):
            process.stdin.write(f"{number} {planted}\n")
            process.stdin.flush()
        reader.start()
        stopped = ""
        while reader.is_alive() and not stopped:
            reader.join(WATCHED_EVERY)
            peak = max(peak, _held_by_group(process.pid))
            if peak > self.pool.bytes_max:
                stopped = "memory"
            elif time.monotonic() - began > seconds_max:
                stopped = "hang"
        taken = time.monotonic() - began
        row = json.loads(answer[0]) if answer and answer[0] else {}
        if stopped or not row:
            way, _, stack = Path(f"{self.folder}.stacks").read_text(encoding="utf-8", errors="replace").partition("\n")
            self.close()
            code = process.returncode
            row = {
                "number": number,
                "kind": planted or kind,
                "way": way,
                "verdict": stopped or "died",
                "seconds": taken,
                "held": 0,
            }
            row["text"] = f"{taken:.1f} s, {peak / 1e6:.0f} MB, exit code {code}\n{stack}"
        row["peak"] = max(peak, row.get("peak", 0))
        if row["verdict"] in GOOD and row["peak"] > self.pool.bytes_max:
            row["verdict"] = "memory"
        if row["held"] > HELD_MAX:
            self.close()
        return row

    def close(self) -> None:
        if self.process is not None:
            with contextlib.suppress(OSError):
                if sys.platform == "win32":
                    self.process.kill()
                else:
                    os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
            self.process = None


def _held_by_group(group: int) -> int:
    """Memory of a worker and of all processes that it started, bytes."""
    total = resident(group)[0]
    with contextlib.suppress(OSError):
        children = Path(f"/proc/{group}/task/{group}/children").read_text(encoding="ascii").split()
        total += sum(resident(child)[0] for child in children)
    return total


def emptied(folder: Path) -> None:
    """Remove what was written, whatever is in it."""
    shutil.rmtree(folder, ignore_errors=True)
