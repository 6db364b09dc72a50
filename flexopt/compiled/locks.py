"""Locks between processes that end with the process that has them.

In: the path of a file, which is made. Out: a context in which no other process has it. Where the system has no such
locks every process gets it at once.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Generator
from pathlib import Path

if sys.platform != "win32":
    import fcntl

_PAUSE = 0.02


@contextlib.contextmanager
def lock(path: Path, *, seconds: float, shared: bool = False, remove: bool = False) -> Generator[None]:
    """Hold the lock on a file.

    Args:
        path: the file; its folder exists.
        seconds: to wait for it at most.
        shared: with others who share it, too.
        remove: the file at the end.

    Raises:
        OSError: the file cannot be opened, or the lock was not to be had in time.
    """
    if sys.platform == "win32":
        yield
        return
    handle = _held(path, shared, time.monotonic() + seconds)
    try:
        yield
    finally:
        # Children that were forked meanwhile have the file open, too, so that closing it does not suffice.
        with contextlib.suppress(OSError):
            if remove:
                path.unlink()
            fcntl.flock(handle, fcntl.LOCK_UN)
        os.close(handle)


if sys.platform != "win32":

    def _held(path: Path, shared: bool, deadline: float) -> int:
        """An open file with its lock."""
        kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
        while True:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
            try:
                while True:
                    try:
                        fcntl.flock(handle, kind | fcntl.LOCK_NB)
                        break
                    except BlockingIOError:
                        if time.monotonic() > deadline:
                            raise
                        time.sleep(_PAUSE)
                # The one before may have removed the file while this process waited for it.
                with contextlib.suppress(FileNotFoundError):
                    if os.path.samestat(os.fstat(handle), path.stat()):
                        return handle
            except BaseException:
                os.close(handle)
                raise
            os.close(handle)
