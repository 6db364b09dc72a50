"""What a choice makes largest of a loop: a number of each loop, and what must stay above zero for it to reach a level.

In: the loop of each member in a configuration. Out: a measure's value, and its `Branches` at a level.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from flexopt.foundation.arrays import Vector
from flexopt.loop.loop_motions import SLOWEST_MOTIONS
from flexopt.loop.outcome import LoopPoint
from flexopt.loop.settings import LoopSettings
from flexopt.loop.uncertain import UncertainLoop

if TYPE_CHECKING:
    from flexopt.selection.outcomes.program import OutcomeProgram, ProgramPoint

SlopesByInput = Mapping[str, Vector]
# The slopes by the gains that are variables, where these are not those of the loop alone.
RATIO = "ratio"


@dataclass(frozen=True)
class Branches:
    """What must not be below zero at a configuration and a level.

    Attributes:
        values: (b,), the smallest first.
        slopes: by y (b, n_y), NaN where two multipliers meet;  by_level: (b,), ≤ 0.
    """

    values: Vector
    slopes: Vector
    by_level: Vector

    @property
    def in_order(self) -> Branches:
        """The same, the smallest first."""
        order = np.argsort(self.values, kind="stable")
        return Branches(self.values[order], self.slopes[order], self.by_level[order])


class Measure(ABC):
    """A measure of a loop, the larger the better: values are the measure, or where it shall be small its negative.

    Attributes:
        name: as of `flexopt.Outcome`;  unit: of it;  sign: −1 where it shall be small.
        lacking: why no configuration has one.
        looked: points that are looked at first;  stages: starts and steps of each round before the best go on.
    """

    name: ClassVar[str]
    unit: ClassVar[str]
    sign: ClassVar[float] = 1.0
    looked: ClassVar[int] = 300
    stages: ClassVar[tuple[tuple[int, int], ...]] = ((32, 6), (12, 10))

    def unit_of(self, settings: LoopSettings) -> str:  # noqa: ARG002
        """Of the measure in such a loop."""
        return self.unit

    of_modes: ClassVar[bool] = False
    # Whether two motions that meet are a kink of it.
    of_rates: ClassVar[bool] = False
    lacking: ClassVar[str] = "every loop grows"

    @property
    def told(self) -> str:
        """What results call it."""
        return self.name

    def asked(self, least: float) -> str:
        """What a bound of a value says, in words."""
        return f"{self.told} at {'least' if self.sign > 0 else 'most'} {self.sign * least:g}"

    @abstractmethod
    def value(self, loop: UncertainLoop, point: LoopPoint) -> float:
        """The measure of one member; −∞ where it has none."""

    def values(self, program: OutcomeProgram, ys: list[Vector], threads: int) -> list[float] | None:  # noqa: ARG002
        """The worst member's at many points, where they are quicker found at once; else None."""
        return None

    @abstractmethod
    def branches(self, at: ProgramPoint, level: float) -> Branches:
        """What must stay above zero at a place of a program, a level up."""

    def level(self, value: float, size: float) -> float:  # noqa: ARG002 - of the decay
        """What is climbed: the logarithm of the measure."""
        return math.log(value) if value > 0 else -math.inf

    def ends(self, at: ProgramPoint) -> tuple[float, float]:  # noqa: ARG002 - of most
        """Between which levels are looked for."""
        return -math.inf, math.inf


def rates_of(point: LoopPoint) -> list[float]:
    """The rates of the slowest motions, 1/s, the least first; without those that are over after some samples."""
    rates = -point.upper_poles[:SLOWEST_MOTIONS].real
    return rates[np.isfinite(rates)].tolist()


def slopes_of(point: LoopPoint, branch: int) -> dict[str, Vector]:
    """A rate's slopes by a loop's numbers, 1/s."""
    return point.gradient(point.rate(branch))
