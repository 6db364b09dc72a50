"""Tells who waits how much of a piece of work is done."""

from __future__ import annotations

from flexopt.foundation.arrays import Progress


class Stages:
    """Counts stages, of a number that is known before.

    Attributes:
        total: how many there are;  done: how many are behind.
    """

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self.total, self.done = progress, total, 0

    def next(self) -> None:
        """One more is done."""
        self.reach(self.done + 1)

    def reach(self, done: float) -> None:
        """So many are done, never fewer than before."""
        done = min(max(int(done), self.done), self.total)
        if self._progress is not None and done > self.done:
            self._progress(done, self.total)
        self.done = done
