"""What choices of several configurations by what the real loop does have in common: the worst target counts.

In: a configuration problem for each target, a loop. Out: their program, and what is said of the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arrays import Document, Progress, Vector
from flexopt.foundation.documents import json_ready
from flexopt.foundation.processes import in_parallel
from flexopt.loop.evaluation import with_outcome
from flexopt.loop.settings import LoopSettings, loop_settings
from flexopt.loop.uncertain import UncertainLoop
from flexopt.model.constraints import LeastOutcomes
from flexopt.model.loop import Loop, gain_ranges
from flexopt.model.uncertainty import Uncertainty
from flexopt.selection.coupling import Coupling
from flexopt.selection.outcomes.branches import Measure
from flexopt.selection.outcomes.choice import (
    asked_of,
    box_and_corners,
    broken_of,
    climbs,
    distinct_optima,
    kept_values,
    least_values,
    measure_of,
    unfit,
)
from flexopt.selection.outcomes.climb import Climbed
from flexopt.selection.outcomes.measures import MEASURES
from flexopt.selection.outcomes.program import OutcomeProgram
from flexopt.selection.outcomes.result import asked_by_loop, asked_of_loop
from flexopt.selection.outcomes.shared import SharedProgram
from flexopt.selection.outcomes.starting import starts_from
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.several.results import ConfigurationSet, TargetConfiguration
from flexopt.selection.solve import constraint_values

# Loops that a process looks at together.
TOGETHER = 50


@dataclass(frozen=True, repr=False)
class ByLoop(ConfigurationSet):
    """Configurations that were chosen by what the loop does at the worst target.

    Attributes:
        criterion: what is sought.
        settings: of the loop, the same at every target;  loop: as it was given.
        uncertainty: what the worst case is taken over; empty: none.
        least: what the loop must do at least at every target.
    """

    criterion: Measure = field(default=MEASURES["decay"], repr=False)
    settings: LoopSettings | None = field(default=None, repr=False)
    loop: Loop | None = field(default=None, repr=False)
    uncertainty: tuple[Uncertainty, ...] = ()
    least: LeastOutcomes | None = field(default=None, repr=False)

    @property
    def objective(self) -> str:
        """What was sought."""
        return self.criterion.told

    @property
    def measure(self) -> str:
        """The same: of `flexopt.Outcome`, at every target."""
        return self.criterion.told

    @property
    def unit(self) -> str:
        """Of it."""
        return self.criterion.unit if self.settings is None else self.criterion.unit_of(self.settings)

    @property
    def gains(self) -> dict[str, float]:
        """Those that were chosen with the configurations."""
        names = {} if self.loop is None else gain_ranges(self.loop)
        return {name: float(getattr(self.settings, name)[0]) for name in names}

    @property
    def worst(self) -> int:
        """Index of the target that has the worst of it."""
        return int((self.criterion.sign * self.V).argmin())

    def loops_break(self, stand: Sequence[tuple[Vector, Vector]]) -> list[str]:
        """At each target what the loop does not do of what it must at least, base and posture there: "breaks …"."""
        bounds, settings = asked_of(self.least), self.settings
        if not bounds or settings is None:
            return [""] * len(stand)
        machine, found = self.problems[0].machine, list[str]()
        box, corners = box_and_corners(machine, self.uncertainty, self.criterion.name, settings.dead_time)
        for (base, posture), problem in zip(stand, self.problems, strict=True):
            loop = UncertainLoop(settings, base, posture, problem.gravity, box)
            broken = broken_of(least_values(bounds, loop, corners))
            found.append(f"breaks {', '.join(broken)}" if broken else "")
        return found

    def _document(self, status: str, own: dict[str, Any], targets: str) -> dict[str, Any]:
        uncertainty = [each.model_dump(exclude_none=True) for each in self.uncertainty]
        more = {"measure": self.measure, "gains": self.gains, "settings": self.settings and self.settings.to_dict()}
        more |= {"uncertainty": uncertainty}
        document = super()._document(status, own, targets)
        return document | json_ready(more | {"problem": asked_of_loop(document["problem"], self.objective)})

    def __repr__(self) -> str:
        over = ", ".join(each.name for each in self.uncertainty)
        worth = float(self.V[self.worst])
        lines = [super().__repr__(), f"  {self.measure}, the worst: {worth:.6g} {self.unit}".rstrip()]
        lines += [f"  worst over {over}"] if over else []
        lines += [f"  {name} {value:.4g}, chosen with the configurations" for name, value in self.gains.items()]
        return "\n".join([*lines, *repr(self.settings).splitlines()])


@dataclass(frozen=True)
class Asked:
    """What is asked of a loop at several targets.

    Attributes:
        call: the public function.
        loop, uncertainty, name, least: as of `outcome_selection`.
    """

    call: str
    loop: Loop
    uncertainty: tuple[Uncertainty, ...]
    name: str
    least: LeastOutcomes | None

    def stated(self, first: SelectionProblem) -> Document:
        """What was asked beside the targets, as provenance has it; `first`: the first target's problem."""
        return asked_by_loop(first, self.name, self.loop, self.uncertainty, self.least)

    def program(
        self,
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
        first = problems[0]
        machine, n_base = first.machine, len(first.machine.base_coordinates)
        settings = loop_settings(machine, self.loop, first.quantities.evaluated(z), gravity=first.gravity)
        measure, bounds = measure_of(self.name, first), asked_of(self.least)
        box, corners = box_and_corners(machine, self.uncertainty, self.name, settings.dead_time)
        faults = [*box.faults(settings.rate), *unfit(self.name, bounds, self.loop, settings, box.uncertainty)]
        raise_if_any(InputError, self.call, [Fault(f.field, f.sentence, f.value) for f in faults])
        held = UncertainLoop(settings, z[:n_base], z[n_base:], first.gravity, box)
        return SharedProgram(
            first, held, gain_ranges(self.loop), corners, measure=measure, least=bounds, problems=problems,
            coupling=coupling, steps=steps, begin=begin,
        )  # fmt: skip


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


def values_at(target: OutcomeProgram, ys: list[Vector], workers: int) -> list[float]:
    """The worst member's measure at many points of one target, in stacks or in processes."""
    values = target.measure.values(target, ys, workers)
    if values is None:
        blocks = [ys[k : k + TOGETHER] for k in range(0, len(ys), TOGETHER)]
        told = in_parallel(partial(_values, target, blocks), len(blocks), workers)
        values = [value for block in told for value in block]
    return values


def _values(target: OutcomeProgram, blocks: list[list[Vector]], number: int) -> list[float]:
    return [target.value(y) for y in blocks[number]]
