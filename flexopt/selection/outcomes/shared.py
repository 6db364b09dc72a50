"""What a loop does at several targets, from one placement or along a way, as one program: the worst of them counts.

In: as of `program`, a problem for each target. Out: a `SharedProgram`, which climbs as any other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.loop.outcome import LoopPoint
from flexopt.loop.uncertain import UncertainLoop
from flexopt.selection.nlp.coupling import Coupling, alone, widened
from flexopt.selection.outcomes.branches import Branches
from flexopt.selection.outcomes.program import SHORT, Met, OutcomeProgram, ProgramPoint
from flexopt.selection.problem import SelectionProblem


@dataclass(frozen=True)
class SharedProgram(OutcomeProgram):
    """Maximise the measure of the worst member at the worst target.

    y = [x, ln kp, ln kv], x the configurations of all targets in scaled variables, what they share once.

    Attributes:
        problems: of every target, of one machine and one scale; `problem` is the first.
        coupling: how the targets share x, and which of its entries are steps apart.
        steps: greatest |x_j − x_i| of each of these pairs.
        begin: placement of the first target, where it is given, (n_b,), m or rad.
        met_at: of each target, as `met`.
    """

    problems: tuple[SelectionProblem, ...] = ()
    coupling: Coupling = field(default_factory=lambda: alone(1))
    steps: Vector = field(default_factory=lambda: np.zeros(0))
    begin: Vector | None = None
    met_at: tuple[tuple[Met, ...], ...] = ()

    @cached_property
    def targets(self) -> tuple[OutcomeProgram, ...]:
        """The program of each target alone."""
        own = {"problem", "met"}
        rest: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(OutcomeProgram) if f.name not in own}
        met = self.met_at or ((),) * len(self.problems)
        return tuple(OutcomeProgram(problem, **rest, met=of) for problem, of in zip(self.problems, met, strict=True))

    @cached_property
    def places(self) -> list[NDArray[np.int64]]:
        """Where each target finds its own y."""
        gains = range(self.n_z, self.n_z + len(self.ranges))
        return [np.array([*place, *gains]) for place in self.coupling.places]

    @property
    def n_z(self) -> int:
        """See `OutcomeProgram`."""
        return self.coupling.n_x

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
        if self.begin is not None:
            first = self.places[0][: self.begin.size]
            low[first] = high[first] = self.begin / self.problem.scale[: self.begin.size]
        return low, high

    def z(self, y: Vector) -> Vector:
        """The configurations of all targets, what they share once."""
        found: Vector = self._spread([target.z(y[place]) for target, place in self._each], self.n_z)
        return found

    def wrapped(self, y: Vector) -> Vector:
        """See `OutcomeProgram`; along a way, whose steps count turns, all of it by those of its beginning."""
        near = [target.wrapped(own) for target, own in self.parts(y)]
        if self.coupling.pairs:
            first, *others = (own for _, own in self.parts(y))
            near = [near[0], *(own + (near[0] - first) for own in others)]
        return self.joined(near)

    def past_stops(self, y: Vector) -> Vector | None:
        """See `OutcomeProgram`; none along a way, whose steps count turns."""
        found = [(own, target.past_stops(own)) for target, own in self.parts(y)]
        if self.coupling.pairs or all(there is None for _, there in found):
            return None
        return self.joined([own if there is None else there for own, there in found])

    @property
    def _each(self) -> list[tuple[OutcomeProgram, NDArray[np.int64]]]:
        return list(zip(self.targets, self.places, strict=True))

    def joined(self, ys: list[Vector]) -> Vector:
        """The y of one for each target."""
        found: Vector = self._spread(ys, self.n_z + len(self.ranges))
        return found

    @cached_property
    def row_bounds(self) -> tuple[Vector, Vector, Vector]:
        """See `OutcomeProgram`."""
        of_steps = -self.steps, self.steps, np.ones(self.steps.size)
        each = [*(target.row_bounds for target in self.targets), of_steps]
        lower, upper, scale = (np.concatenate(part) for part in zip(*each, strict=True))
        return lower, upper, scale

    @cached_property
    def differences(self) -> Vector:
        """The matrix of the steps, (pairs, n_y)."""
        return self.coupling.steps(self.n_z + len(self.ranges))

    @property
    def row_names(self) -> list[str]:
        """See `OutcomeProgram`."""
        found = [f"target {k + 1}: {name}" for k, target in enumerate(self.targets) for name in target.row_names]
        return [*found, *["steps between targets"] * self.steps.size]

    @property
    def names(self) -> list[str]:
        """See `OutcomeProgram`."""
        first, n = self.targets[0].names, self.problem.scale.size
        places, found = self.coupling.places, [""] * self.n_z
        for k, place in enumerate(places):
            for i, name in zip(place, first[:n], strict=True):
                shared = all(i in other for other in places)
                found[i] = name if shared else f"target {k + 1}: {name}"
        return [*found, *first[n:]]

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
        return SharedPoint(self, y)

    def rows(self, y: Vector) -> Vector:
        """See `OutcomeProgram`."""
        return np.concatenate([*(target.rows(own) for target, own in self.parts(y)), self.differences @ y])

    def row_slopes(self, y: Vector) -> Vector:
        """See `OutcomeProgram`."""
        each = [widened(target.row_slopes(y[place]), place, y.size) for target, place in self._each]
        return np.vstack([*each, self.differences])

    def meeting(self, y: Vector, level: float) -> SharedProgram | None:
        """See `OutcomeProgram`."""
        found = tuple(target.met_near(own, level) for target, own in self.parts(y))
        return replace(self, met_at=found) if any(found) else None

    def joint(self, each: list[Branches]) -> Branches:
        """The branches of every target, the smallest first."""
        values, by_level = (np.concatenate([getattr(b, name) for b in each]) for name in ("values", "by_level"))
        n_y = self.n_z + len(self.ranges)
        slopes = np.vstack([widened(b.slopes, place, n_y) for b, place in zip(each, self.places, strict=True)])
        return Branches(values, slopes, by_level).in_order


@dataclass(frozen=True, eq=False)
class SharedPoint(ProgramPoint):
    """A `SharedProgram` at one y."""

    program: SharedProgram

    @cached_property
    def parts(self) -> list[ProgramPoint]:
        """The place of each target."""
        return [target.place(own) for target, own in self.program.parts(self.y)]

    @cached_property
    def points(self) -> list[LoopPoint]:
        """Of every target."""
        return [point for part in self.parts for point in part.points]

    def branches(self, level: float) -> Branches:
        """See `ProgramPoint`."""
        return self.program.joint([part.branches(level) for part in self.parts])


@dataclass(frozen=True)
class ShortestWay(SharedProgram):
    """The shortest of the ways on which the worst member at the worst target has a least value of the measure.

    Attributes:
        kept: that value.
    """

    kept: float = 0.0

    def length(self, y: Vector) -> float:
        """Σ (x_j − x_i)² over the pairs."""
        return float(np.sum((self.differences @ y) ** 2))

    def value(self, y: Vector) -> float:
        """Minus the length; −∞ where the measure is less than it must be."""
        return -self.length(y) if super().value(y) >= self.kept - SHORT * abs(self.kept) else -math.inf

    def level(self, value: float) -> float:
        """See `OutcomeProgram`."""
        return value

    def meeting(self, y: Vector, level: float) -> SharedProgram | None:  # noqa: ARG002
        """See `OutcomeProgram`: of motions that decay as the measure must, whatever the length."""
        return super().meeting(y, self.measure.level(self.kept, self.size))

    def place(self, y: Vector) -> ProgramPoint:
        """See `OutcomeProgram`."""
        return ShortestPoint(self, y)


@dataclass(frozen=True, eq=False)
class ShortestPoint(SharedPoint):
    """A `ShortestWay` at one y."""

    program: ShortestWay

    def branches(self, level: float) -> Branches:
        """Minus the length, less the level, and what keeps the measure."""
        way = self.program
        kept = super().branches(way.measure.level(way.kept, way.size))
        values = np.append(kept.values, -way.length(self.y) - level)
        slopes = np.vstack([kept.slopes, -2 * way.differences.T @ (way.differences @ self.y)])
        return Branches(values, slopes, np.append(np.zeros(len(kept.values)), -1.0)).in_order
