"""A Dask scheduler and its workers as processes of this machine, on the loopback interface alone."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class LocalCluster:
    """Processes that are ended with it.

    Attributes:
        address: of the scheduler.
        scheduler, workers: processes.
        folder: for what workers write.
    """

    address: str
    scheduler: subprocess.Popen[str]
    folder: Path
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def hire(self) -> None:
        """One more worker, of one thread."""
        options = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(self.folder)]
        command = [sys.executable, "-m", "dask", "worker", self.address, *options]
        self.workers.append(
            subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=_environment())
        )


def _environment() -> dict[str, str]:
    return os.environ | {"PYTHONWARNINGS": "ignore", "PYTHONUNBUFFERED": "1"}


@contextmanager
def local_cluster(workers: int) -> Generator[LocalCluster]:
    """A scheduler on a free port of 127.0.0.1, and so many workers."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        command = [sys.executable, "-m", "dask", "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
        scheduler = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=_environment(), cwd=folder
        )
        assert scheduler.stderr is not None
        address = next(found[0] for line in scheduler.stderr if (found := re.search(r"tcp://127[\d.]+:\d+", line)))
        cluster = LocalCluster(address, scheduler, Path(folder))
        try:
            for _ in range(workers):
                cluster.hire()
            yield cluster
        finally:
            for process in (*cluster.workers, scheduler):
                with contextlib.suppress(ProcessLookupError):
                    process.kill()
                process.wait()
            scheduler.stderr.close()
