"""What choices of several configurations by what the real loop does have in common: the worst target counts.

In: a configuration problem for each target, a loop. Out: their program, and what is said of the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from flexopt.foundation.arrays import Progress, Vector
from flexopt.foundation.documents import json_ready
from flexopt.loop.evaluation import with_outcome
from flexopt.loop.settings import LoopSettings
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.selection.nlp.coupling import Coupling
from flexopt.selection.outcomes.asked import Asked
from flexopt.selection.outcomes.choice import climbs, distinct_optima, kept_values
from flexopt.selection.outcomes.climb import Climbed
from flexopt.selection.outcomes.result import ChosenByLoop, asked_of_loop
from flexopt.selection.outcomes.shared import SharedProgram
from flexopt.selection.outcomes.starting import starts_from
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.several.postures import Reached, reached_from
from flexopt.selection.several.results import ConfigurationSet, TargetConfiguration
from flexopt.selection.solve import constraint_values

# Placements to stand still in, none near a better one, that are looked at again, and with how many times the usual
# postures.
STANDS, FINER = 6, 6
# Configurations that are looked at: as many times the points that a measure looks at, together, but not fewer for a
# target than so many.
NODES, FEWEST = 4, 60


@dataclass(frozen=True, repr=False)
class ByLoop(ChosenByLoop, ConfigurationSet):
    """Configurations that were chosen by what the loop does at the worst target.

    Attributes:
        settings: of the loop, the same at every target.
    """

    settings: LoopSettings = field(repr=False, kw_only=True)

    @property
    def objective(self) -> str:
        """What was sought: of `flexopt.Outcome`, at every target."""
        return self.measure

    @property
    def unit(self) -> str:
        """Of it."""
        return self.criterion.unit_of(self.settings)

    @property
    def gains(self) -> dict[str, float]:
        """Those that were chosen with the configurations."""
        return self._chosen(self.settings)

    @property
    def worst(self) -> int:
        """Index of the target that has the worst of it."""
        return int((self.criterion.sign * self.V).argmin())

    @property
    def remarks(self) -> tuple[str, ...]:
        """As of `ConfigurationSet`, and what no loop changes at the worst target."""
        unseen = self._unseen_told(self.places[self.worst].evaluation)
        return (*super().remarks, *unseen, *self._least_told([self.gains]))

    @property
    def _judged(self) -> Sequence[SelectionProblem]:
        return self.problems

    def _document(self, status: str, own: dict[str, Any], targets: str) -> dict[str, Any]:
        more = {"measure": self.measure, "gains": self.gains, "settings": self.settings.to_dict()}
        more |= {"uncertainty": self._uncertainty}
        document = super()._document(status, own, targets)
        return document | json_ready(more | {"problem": asked_of_loop(document["problem"], self.objective)})

    def __repr__(self) -> str:
        over = UncertaintyBox(self._judged[0].machine, self.uncertainty, self.settings.dead_time).judged_over
        worth = float(self.V[self.worst])
        lines = [super().__repr__(), f"  {self.measure}, the worst: {worth:.6g} {self.unit}".rstrip()]
        lines += [f"  worst over {over}"] if over else []
        lines += [f"  {name} {value:.4g}, chosen with the configurations" for name, value in self.gains.items()]
        return "\n".join([*lines, *repr(self.settings).splitlines()])


def shared_program(
    asked: Asked,
    problems: tuple[SelectionProblem, ...],
    coupling: Coupling,
    steps: Vector,
    z: Vector,
    begin: Vector | None = None,
) -> SharedProgram:
    """The program of these problems; what the loop leaves out follows from a configuration z of the first.

    Raises:
        InputError: what is uncertain, or asked for, does not go with the loop.
    """
    parts = asked.parts(problems[0], problems[0].quantities.evaluated(z))
    return SharedProgram(**parts, problems=problems, coupling=coupling, steps=steps, begin=begin)


def reached_finer(problems: Sequence[SelectionProblem], bases: Vector) -> list[Reached]:
    """What is reached of each target from few placements (n_b, N), by a finer sample of postures than from many.

    A redundant arm's best posture may be narrower than the spacing of a few.
    """
    return [reached_from(problem, bases, problem.seed, FINER) for problem in problems]


def most_looked(program: SharedProgram, gains: int = 1) -> int:
    """Configurations of a target that are looked at with each of so many gains."""
    return max(FEWEST, NODES * program.measure.looked // (len(program.problems) * gains))


class Climbs(NamedTuple):
    """Where climbs of a program led: it with the size of its values, verified optima, the best first, and how many.

    `unverified`: as of `distinct_optima`;  attempts: starts, and how many led to a verified optimum.
    """

    program: SharedProgram
    optima: list[Climbed]
    unverified: float | None
    attempts: tuple[int, int]


def climbs_from(program: SharedProgram, looked: list[Vector], workers: int, progress: Progress | None = None) -> Climbs:
    """Climbs from the best of the points y that are looked at."""
    chosen, starts = starts_from(program, looked, workers)
    assert isinstance(chosen, SharedProgram)
    ends = climbs(chosen, starts, workers, progress)
    verified = sum(each is not None and each.holds for each in ends)
    return Climbs(chosen, *distinct_optima(chosen, ends), (len(starts), verified))


def places_by_loop(program: SharedProgram, y: Vector) -> tuple[TargetConfiguration, ...]:
    """The configuration of every target at y, with what the loop does there."""
    settings, places = program.at(y).settings, list[TargetConfiguration]()
    for (target, own), value in zip(program.parts(y), program.values(y), strict=True):
        problem, z = target.problem, target.z(own)
        there = with_outcome(problem.machine, problem.quantities.evaluated(z), settings, gravity=problem.gravity)
        told = constraint_values(problem, z) | kept_values(target, own)
        places.append(TargetConfiguration(problem.target, there, program.measure.sign * value, told))
    return tuple(places)
