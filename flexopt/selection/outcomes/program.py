"""What a loop does as a program in the configuration and, where ranges are given, in its gains.

In: a problem, a loop, members of what is uncertain. Out: values and slopes of the objective's branches, of which the
smallest counts, and of the rows, in scaled variables y = [z / scale, ln kp, ln kv].
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.loop.outcome import LoopPoint
from flexopt.loop.uncertain import UncertainLoop
from flexopt.model.loop import logarithms
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.program import row_gradients

# Multipliers of a loop whose decay counts, the slowest first: at an optimum several are as slow.
BRANCHES = 6
# Branches that are further above the least one than this share of the scale are left out.
FAR = 1.0


@dataclass(frozen=True)
class Branches:
    """The objective at y: values of its branches (b,), the smallest first, and slopes (b, n_y), NaN where two meet."""

    values: Vector
    slopes: Vector


@dataclass(frozen=True)
class OutcomeProgram:
    """Maximise the decay of the slowest member: the smallest of the rates of several multipliers of each.

    Attributes:
        problem: its rows and bounds; its own objective is not asked.
        loop: with its numbers, at any configuration.
        ranges: of gains that are variables, kp or kv: (lower, upper).
        members: points of what is uncertain, (n, k); none: the nominal machine alone.
        size: what decays are divided by, 1/s.
    """

    problem: SelectionProblem
    loop: UncertainLoop
    ranges: dict[str, tuple[float, float]]
    members: Vector
    size: float = 1.0

    @property
    def n_z(self) -> int:
        """Entries of z; the gains follow in y."""
        return self.problem.scale.size

    @cached_property
    def bounds(self) -> tuple[Vector, Vector]:
        """Of y."""
        ends = np.array([logarithms(ends) for ends in self.ranges.values()]).reshape(-1, 2)
        scale = self.problem.scale
        return np.append(self.problem.lower / scale, ends[:, 0]), np.append(self.problem.upper / scale, ends[:, 1])

    def z(self, y: Vector) -> Vector:
        """The configuration."""
        return y[: self.n_z] * self.problem.scale

    def gains(self, y: Vector) -> dict[str, float]:
        """Those that are variables."""
        return dict(zip(self.ranges, np.exp(y[self.n_z :]).tolist(), strict=True))

    def at(self, y: Vector) -> UncertainLoop:
        """The loop in the configuration, with the gains."""
        z, n_base = self.z(y), len(self.problem.machine.base_coordinates)
        rows = self.problem.target.size
        gains = {name: np.full(rows, value) for name, value in self.gains(y).items()}
        settings = self.loop.settings
        if gains:
            sources = {**settings.sources, **dict.fromkeys(gains, "chosen with the configuration")}
            settings = replace(settings, **gains, sources=sources)
        return replace(self.loop, settings=settings, base=z[:n_base], posture=z[n_base:])

    def points(self, y: Vector) -> list[LoopPoint]:
        """The loop of every member there, the nominal one first."""
        loop = self.at(y)
        return [loop.outcome(), *(loop.outcome(u) for u in self.members)]

    def value(self, y: Vector) -> float:
        """The slowest member's decay, 1/s."""
        return min(self._values(point)[0] for point in self.points(y))

    def branches(self, y: Vector) -> Branches:
        """The rates at y over all members, those near the least one, divided by the size."""
        points = self.points(y)
        each = [(value, point, k) for point in points for k, value in enumerate(self._values(point))]
        each.sort(key=lambda entry: entry[0])
        near = [entry for entry in each[:BRANCHES] if entry[0] <= each[0][0] + FAR * self.size]
        slopes = [self._slope(point, k, y) for _, point, k in near]
        return Branches(np.array([value for value, _, _ in near]) / self.size, np.array(slopes) / self.size)

    def _values(self, point: LoopPoint) -> list[float]:
        """The rates of the slowest multipliers at a member, 1/s, the least first."""
        upper = point.loop.multipliers[point.loop.multipliers.imag >= 0][:BRANCHES]
        rates: list[float] = (-np.log(np.abs(upper)) / point.period).tolist()
        return rates

    def _slope(self, point: LoopPoint, branch: int, y: Vector) -> Vector:
        """A rate's slope by y, 1/s."""
        by = point.gradient(point.rate(branch))
        of_gains = [float(by[name].sum()) * gain for name, gain in self.gains(y).items()]
        of_z = np.concatenate([by["base"], by["posture"]]) * self.problem.scale
        return np.append(of_z, of_gains)

    def rows(self, y: Vector) -> Vector:
        """Values of the problem's rows, in their scales: 0 for the target's."""
        lower, upper, scale = self.problem.row_bounds
        return (self.problem.rows(self.z(y)) - np.where(lower == upper, lower, 0.0)) / scale

    def row_slopes(self, y: Vector) -> Vector:
        """Their slopes, (n_rows, n_y)."""
        found = row_gradients(self.problem, self.z(y)) / self.problem.row_bounds[2][:, None] * self.problem.scale
        return np.hstack([found, np.zeros((len(found), len(self.ranges)))])
