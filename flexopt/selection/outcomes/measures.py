"""The measures of a loop that a choice can make largest, by name.

In: as of `branches`. Out: `MEASURES`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.loop.lag import LaggedModes
from flexopt.loop.loop_motions import SLOWEST_MOTIONS, Measured
from flexopt.loop.many import decays
from flexopt.loop.outcome import LoopPoint
from flexopt.loop.settings import LoopSettings
from flexopt.loop.small_motions import DEAD_TIME
from flexopt.loop.uncertain import UncertainLoop
from flexopt.model.choices import ALLOWANCE, DECAY
from flexopt.selection.outcomes.borders import AllowedGain, DelayMargin, Radius
from flexopt.selection.outcomes.branches import Branches, Measure, rates_of, slopes_of
from flexopt.selection.outcomes.moves import Settling, Swing
from flexopt.selection.problem import SelectionProblem

# Branches of the decay that are further above the least one than this share of its size are left out.
FAR = 1.0

if TYPE_CHECKING:
    from flexopt.selection.outcomes.program import OutcomeProgram, ProgramPoint


class Decay(Measure):
    """How fast the slowest motion decays, 1/s."""

    name, unit = DECAY, "1/s"
    looked, stages = 1500, ((96, 6), (24, 10))
    of_rates = True

    def value(self, loop: UncertainLoop, point: LoopPoint) -> float:  # noqa: ARG002
        """See the class."""
        return rates_of(point)[0]

    def values(self, program: OutcomeProgram, ys: list[Vector], threads: int) -> list[float] | None:
        """In stacks of loops."""
        loops = [program.at(y) for y in ys]
        columns = {"base": [loop.base for loop in loops], "posture": [loop.posture for loop in loops]}
        columns |= {name: [getattr(loop.settings, name) for loop in loops] for name in program.ranges}
        varied = {name: np.ascontiguousarray(np.array(column).T) for name, column in columns.items()}
        box, found = program.loop.box, np.full(len(ys), math.inf)
        for u in (None, *program.members):
            p, late = (box.nominal, box.nominal_dead_time) if u is None else box.numbers(u)
            given = varied | {"p": p[:, None], DEAD_TIME: np.full((1, len(ys)), late)}
            told = decays(
                box.machine, program.loop.settings, given,
                gravity=program.loop.gravity, own_model=u is not None, threads=threads,
            )  # fmt: skip
            found = np.minimum(found, np.where(np.isfinite(told.decay), told.decay, -math.inf))
        return found.tolist()

    def level(self, value: float, size: float) -> float:
        """A share of its size."""
        return value / size

    def branches(self, at: ProgramPoint, level: float) -> Branches:
        """The slowest rates of all members, less the level."""
        values, slopes = at.once("rates", lambda: self._rates(at))
        return Branches(values - level, slopes, np.full(len(values), -1.0))

    def _rates(self, at: ProgramPoint) -> tuple[Vector, Vector]:
        each = list[tuple[float, LoopPoint, Measured | int]]()
        for number, point in enumerate(at.points):
            met = at.met.get(number)
            apart = () if met is None else met.branches
            each += [(value, point, k) for k, value in enumerate(rates_of(point)) if k not in apart]
            if met is not None:
                each.append((met.mean.value, point, met.mean))
        each.sort(key=lambda entry: entry[0])
        near = [entry for entry in each[:SLOWEST_MOTIONS] if entry[0] <= each[0][0] + FAR * at.size]
        slopes = [at.by_y(slopes_of(point, k) if isinstance(k, int) else point.gradient(k)) for _, point, k in near]
        return np.array([value for value, _, _ in near]) / at.size, np.array(slopes) / at.size


@dataclass(frozen=True)
class OfModes(Measure):
    """A w_i, ε_max or a weighted sum of them: the objective of a problem, of the machine's own numbers.

    Of ε_max each branch, the least of which it is.
    """

    problem: SelectionProblem
    name: ClassVar[str] = "V"
    unit: ClassVar[str] = ""
    looked: ClassVar[int] = 1500
    stages: ClassVar[tuple[tuple[int, int], ...]] = ((96, 6), (24, 10))
    of_modes: ClassVar[bool] = True

    @property
    def told(self) -> str:
        """See the class."""
        return self.problem.name

    def unit_of(self, settings: LoopSettings) -> str:  # noqa: ARG002
        """See the class."""
        return self.problem.objective.unit(self.problem.control, self.problem.machine.joint_units)

    def value(self, loop: UncertainLoop, point: LoopPoint) -> float:  # noqa: ARG002
        """See the class."""
        z = np.concatenate([loop.base, loop.posture])
        value = float(self.problem.branches(self.problem.objective, z)[0].min())
        return value if math.isfinite(value) else -math.inf

    def level(self, value: float, size: float) -> float:  # noqa: ARG002
        """A share of the objective's scale."""
        return value / self.problem.objective_scale

    def branches(self, at: ProgramPoint, level: float) -> Branches:
        """V with each branch, less the level."""
        z = np.concatenate([at.loop.base, at.loop.posture])
        values, slopes = at.once(f"modes of {self.told}", lambda: self.problem.branches(self.problem.objective, z))
        count, order = len(values), np.argsort(values)
        wide = np.zeros((count, at.count))
        wide[:, : z.size] = slopes[order] * self.problem.scale / self.problem.objective_scale
        return Branches(values[order] / self.problem.objective_scale - level, wide, np.full(count, -1.0))


class Allowance(Measure):
    """The least allowance over the modes, 4 ζ_i ω_i / |w_i|, a gain Kv of a force."""

    name, unit = ALLOWANCE, ""

    def unit_of(self, settings: LoopSettings) -> str:
        """See the class."""
        return settings.force_units[1]

    def value(self, loop: UncertainLoop, point: LoopPoint) -> float:  # noqa: ARG002
        """See the class."""
        found = float(np.min(_allowances(point)[0]))
        return found if found > 0 else -math.inf

    def branches(self, at: ProgramPoint, level: float) -> Branches:
        """Ln κ_i of all members, less the level."""
        values, slopes = at.once("allowances", lambda: self._told(at))
        return Branches(values - level, slopes, np.full(len(values), -1.0))

    def _told(self, at: ProgramPoint) -> tuple[Vector, Vector]:
        found = list[tuple[float, Vector]]()
        for point in at.points:
            values, slopes = _allowances(point)
            for i in np.flatnonzero(np.isfinite(values) & (values > 0)).tolist():
                by = {name: column[i] / values[i] for name, column in slopes.items()}
                found.append((math.log(values[i]), at.by_y(by)))
        found.sort(key=lambda entry: entry[0])
        return np.array([value for value, _ in found]), np.array([slope for _, slope in found])


def _allowances(point: LoopPoint) -> tuple[Vector, dict[str, Vector]]:
    """κ_i, infinite where nothing excites a mode, and their slopes."""
    values, slopes = LaggedModes(point.motions).at(point.numbers, point.dead_time)
    return values[ALLOWANCE], slopes[ALLOWANCE]


MEASURES: dict[str, Measure] = {
    measure.name: measure
    for measure in (Decay(), AllowedGain(), DelayMargin(), Allowance(), Radius(), Settling(), Swing())
}
