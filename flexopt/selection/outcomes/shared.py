"""What a loop does at several targets that one placement serves, as one program: the worst of them counts.

In: as of `program`, a problem for each target. Out: a `SharedProgram`, which climbs as any other.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.loop.outcome import LoopPoint
from flexopt.loop.uncertain import UncertainLoop
from flexopt.selection.outcomes.branches import Branches
from flexopt.selection.outcomes.program import OutcomeProgram, ProgramPoint
from flexopt.selection.problem import SelectionProblem


@dataclass(frozen=True)
class SharedProgram(OutcomeProgram):
    """Maximise the measure of the worst member at the worst target.

    y = [base, posture of the first target, of the second, …] in scaled variables, then [ln kp, ln kv].

    Attributes:
        problems: of every target, of one machine and one scale; `problem` is the first.
    """

    problems: tuple[SelectionProblem, ...] = ()

    @cached_property
    def targets(self) -> tuple[OutcomeProgram, ...]:
        """The program of each target alone."""
        rest: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(OutcomeProgram) if f.name != "problem"}
        return tuple(OutcomeProgram(problem, **rest) for problem in self.problems)

    @cached_property
    def places(self) -> list[NDArray[np.int64]]:
        """Where each target finds its own y."""
        n_b = len(self.problem.machine.base_coordinates)
        n, gains = self.problem.scale.size - n_b, len(self.ranges)
        return [np.array([*range(n_b), *range(n_b + k * n, n_b + (k + 1) * n), *range(self.n_z, self.n_z + gains)])
                for k in range(len(self.problems))]  # fmt: skip

    @property
    def n_z(self) -> int:
        """See `OutcomeProgram`."""
        n_b = len(self.problem.machine.base_coordinates)
        return n_b + len(self.problems) * (self.problem.scale.size - n_b)

    def _spread(self, each: Any, size: int) -> Any:
        """Entries of every target's z in their places, those of the placement from the last."""
        found = np.empty(size, dtype=np.asarray(each[0]).dtype)
        for place, own in zip(self.places, each, strict=True):
            found[place[: len(own)]] = own
        return found

    @cached_property
    def bounds(self) -> tuple[Vector, Vector]:
        """See `OutcomeProgram`."""
        size = self.n_z + len(self.ranges)
        low, high = np.full(size, -np.inf), np.full(size, np.inf)
        for place, target in zip(self.places, self.targets, strict=True):
            low[place] = np.maximum(low[place], target.bounds[0])
            high[place] = np.minimum(high[place], target.bounds[1])
        return low, high

    def z(self, y: Vector) -> Vector:
        """The placement, then the posture of every target."""
        found: Vector = self._spread([target.z(y[place]) for target, place in self._each], self.n_z)
        return found

    @property
    def _each(self) -> list[tuple[OutcomeProgram, NDArray[np.int64]]]:
        return list(zip(self.targets, self.places, strict=True))

    def joined(self, ys: list[Vector]) -> Vector:
        """The y of one for each target."""
        found: Vector = self._spread(ys, self.n_z + len(self.ranges))
        return found

    @property
    def row_bounds(self) -> tuple[Vector, Vector, Vector]:
        """See `OutcomeProgram`."""
        return self._row_bounds

    @cached_property
    def _row_bounds(self) -> tuple[Vector, Vector, Vector]:
        lower, upper, scale = (np.concatenate(each) for each in zip(*(t.row_bounds for t in self.targets), strict=True))
        return lower, upper, scale

    @property
    def row_names(self) -> list[str]:
        """See `OutcomeProgram`."""
        return [f"target {k + 1}: {name}" for k, target in enumerate(self.targets) for name in target.row_names]

    @property
    def names(self) -> list[str]:
        """See `OutcomeProgram`."""
        n_b, first = len(self.problem.machine.base_coordinates), self.targets[0].names
        n = self.problem.scale.size
        own = [f"target {k + 1}: {name}" for k in range(len(self.problems)) for name in first[n_b:n]]
        return [*first[:n_b], *own, *first[n:]]

    @property
    def turning(self) -> NDArray[np.bool_]:
        """See `OutcomeProgram`."""
        found: NDArray[np.bool_] = self._spread([target.turning for target in self.targets], self.n_z)
        return found

    def parts(self, y: Vector) -> list[tuple[OutcomeProgram, Vector]]:
        """See `OutcomeProgram`."""
        return [(target, y[place]) for target, place in self._each]

    def at(self, y: Vector) -> UncertainLoop:
        """The loop at the first target."""
        return self.targets[0].at(y[self.places[0]])

    def points(self, y: Vector) -> list[LoopPoint]:
        """The loops of every target."""
        return [point for target, own in self.parts(y) for point in target.points(own)]

    def values(self, y: Vector) -> list[float]:
        """The measure at each target."""
        return [target.value(own) for target, own in self.parts(y)]

    def value(self, y: Vector) -> float:
        """The worst of them."""
        return min(self.values(y))

    def place(self, y: Vector) -> ProgramPoint:
        """See `OutcomeProgram`."""
        return SharedPoint(self, y, shared=self)

    def rows(self, y: Vector) -> Vector:
        """See `OutcomeProgram`."""
        return np.concatenate([target.rows(own) for target, own in self.parts(y)])

    def row_slopes(self, y: Vector) -> Vector:
        """See `OutcomeProgram`."""
        return np.vstack([self._wide(target.row_slopes(y[place]), place) for target, place in self._each])

    def _wide(self, slopes: Vector, place: NDArray[np.int64]) -> Vector:
        """Slopes by a target's y as those by all."""
        found = np.zeros((len(slopes), self.n_z + len(self.ranges)))
        found[:, place] = slopes
        return found

    def joint(self, each: list[Branches]) -> Branches:
        """The branches of every target, the smallest first."""
        values, by_level = (np.concatenate([getattr(b, name) for b in each]) for name in ("values", "by_level"))
        slopes = np.vstack([self._wide(b.slopes, place) for b, place in zip(each, self.places, strict=True)])
        order = np.argsort(values, kind="stable")
        return Branches(values[order], slopes[order], by_level[order])


@dataclass(frozen=True, eq=False)
class SharedPoint(ProgramPoint):
    """A `SharedProgram` at one y."""

    shared: SharedProgram | None = None

    @cached_property
    def _parts(self) -> list[ProgramPoint]:
        assert self.shared is not None
        return [target.place(own) for target, own in self.shared.parts(self.y)]

    @cached_property
    def points(self) -> list[LoopPoint]:
        """Of every target."""
        return [point for part in self._parts for point in part.points]

    def branches(self, level: float) -> Branches:
        """See `ProgramPoint`."""
        assert self.shared is not None
        return self.shared.joint([part.branches(level) for part in self._parts])
