"""Which numbers a study's points have: a function of the study and the chunk's number alone."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.model.study import Study
from flexopt.model.study_axes import StudyAxis, study_axes


@dataclass
class StudyPoints:
    """The points of a study, chunk by chunk.

    Attributes:
        study: which.
        axes: what varies.
    """

    study: Study
    axes: tuple[StudyAxis, ...] = field(init=False)
    _sequence: Any = field(init=False, default=None, repr=False)
    _lock: threading.Lock = field(init=False, default_factory=threading.Lock, repr=False)

    def __post_init__(self) -> None:
        self.axes = study_axes(self.study)

    def span(self, chunk: int) -> tuple[int, int]:
        """First point of a chunk, and the one behind its last."""
        start = chunk * self.study.chunk_points
        return start, min(start + self.study.chunk_points, self.study.total)

    def columns(self, chunk: int) -> Vector:
        """Values of what varies (axes, N), SI, a column for each point of the chunk."""
        start, stop = self.span(chunk)
        if self.study.points == "grid":
            places = np.unravel_index(np.arange(start, stop), [axis.count for axis in self.axes])
            return np.stack([values[place] for values, place in zip(self.grid, places, strict=True)])
        if self.study.points == "random":
            drawn = np.random.default_rng([self.study.seed, chunk]).random((len(self.axes), stop - start))
        else:
            drawn = np.ascontiguousarray(self._sobol(start, stop).T)
        for axis, u in zip(self.axes, drawn, strict=True):
            u[:] = _between(axis, u)
        return drawn

    @cached_property
    def grid(self) -> list[Vector]:
        """Values along each axis of a grid; a single one is the lower end."""
        return [_between(axis, np.linspace(0.0, 1.0, axis.count)) for axis in self.axes]

    def _sobol(self, start: int, stop: int) -> Vector:
        """A part (N, axes) of the sequence; going on is quicker than going back, which begins anew."""
        from scipy.stats import qmc  # noqa: PLC0415  (loads slowly)

        with self._lock:
            sequence = self._sequence
            if sequence is None or sequence.num_generated > start:
                sequence = qmc.Sobol(len(self.axes), bits=32, seed=self.study.seed)
            if start > sequence.num_generated:
                sequence.fast_forward(start - sequence.num_generated)
            self._sequence = sequence
            # Of a first draw that is no power of two SciPy warns, whatever all chunks together are.
            first = sequence.random(1) if start == 0 else np.zeros((0, len(self.axes)))
            return np.concatenate([first, sequence.random(stop - start - len(first))])


def _between(axis: StudyAxis, u: Vector) -> Vector:
    """From [0, 1] to the ends, which 0 and 1 meet exactly."""
    if axis.log:
        values = np.exp(np.log(axis.low) + u * (np.log(axis.high) - np.log(axis.low)))
        values[u == 0.0], values[u == 1.0] = axis.low, axis.high
    else:
        values = u * (axis.high - axis.low)
        values += axis.low
        values[-1:] = np.where(u[-1:] == 1.0, axis.high, values[-1:])
    return np.clip(values, axis.low, axis.high, out=values)
