"""Tells who waits how much of a piece of work is done."""

from __future__ import annotations

from flexopt.foundation.arrays import Progress


class Stages:
    """Counts stages, of a number that is known before, each of as many `parts` as can be told of it.

    Attributes:
        total: how many parts there are;  done: how many are behind.
    """

    def __init__(self, progress: Progress | None, stages: int, parts: int = 1) -> None:
        self._progress, self._parts, self._behind = progress, parts, 0
        self.total, self.done = stages * parts, 0

    def next(self) -> None:
        """One more stage is done."""
        self._behind += 1
        self.reach(self._behind * self._parts)

    def within(self, done: int, total: int) -> None:
        """So much of the present stage is done."""
        self.reach((self._behind + done / max(total, 1)) * self._parts)

    def reach(self, done: float) -> None:
        """So many parts are done, never fewer than before."""
        done = min(max(int(done), self.done), self.total)
        if self._progress is not None and done > self.done:
            self._progress(done, self.total)
        self.done = done
