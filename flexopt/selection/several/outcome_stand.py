"""One placement for several targets by what the real loop does at each: the worst target counts.

In: a configuration problem for each target, a loop. Out: an `OutcomeStand`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arrays import Progress, Vector
from flexopt.foundation.documents import json_ready, provenance
from flexopt.foundation.processes import in_parallel
from flexopt.loop.evaluation import with_outcome
from flexopt.loop.settings import LoopSettings, loop_settings
from flexopt.loop.uncertain import UncertainLoop, UncertaintyBox
from flexopt.model.choices import RADIUS
from flexopt.model.constraints import LeastOutcomes
from flexopt.model.loop import Loop, gain_ranges
from flexopt.model.uncertainty import GROUND, Uncertainty
from flexopt.plant.inverse_kinematics import low_discrepancy
from flexopt.selection.outcomes.branches import Measure
from flexopt.selection.outcomes.choice import (
    CORNERED,
    asked_of,
    climbs,
    distinct_optima,
    kept_values,
    measure_of,
    unfit,
)
from flexopt.selection.outcomes.measures import MEASURES
from flexopt.selection.outcomes.shared import SharedProgram
from flexopt.selection.outcomes.starting import starts_from
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.several.postures import Reached, reached_from
from flexopt.selection.several.results import Stand, TargetConfiguration
from flexopt.selection.several.targets import none_reaches_all
from flexopt.selection.solve import constraint_values

# Postures of a target that are looked at from a placement; loops that a process looks at together.
POSTURES, TOGETHER = 6, 50
SAME_BASE = 1e-4


@dataclass(frozen=True)
class OutcomeStand(Stand):
    """One placement for several targets by what the loop does; see `Stand`.

    Attributes:
        criterion: what is sought.
        settings: of the loop, the same at every target;  loop: as it was given.
        uncertainty: what the worst case is taken over; empty: none.
        unverified: as of `OutcomeSelection`.
    """

    criterion: Measure = field(default=MEASURES["decay"], repr=False)
    settings: LoopSettings | None = field(default=None, repr=False)
    loop: Loop | None = field(default=None, repr=False)
    uncertainty: tuple[Uncertainty, ...] = ()
    unverified: float | None = None

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
        return self.criterion.unit

    @property
    def gains(self) -> dict[str, float]:
        """Those that were chosen with the placement."""
        names = {} if self.loop is None else gain_ranges(self.loop)
        return {name: float(getattr(self.settings, name)[0]) for name in names}

    @property
    def worst(self) -> int:
        """Index of the target that has the worst of it."""
        return int((self.criterion.sign * self.V).argmin())

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready dictionary."""
        uncertainty = [each.model_dump(exclude_none=True) for each in self.uncertainty]
        own = {"measure": self.measure, "gains": self.gains, "settings": self.settings and self.settings.to_dict()}
        return super().to_dict() | json_ready(own | {"uncertainty": uncertainty, "unverified": self.unverified})

    def __repr__(self) -> str:
        over = ", ".join(each.name for each in self.uncertainty)
        lines = [super().__repr__(), f"  {self.measure}, the worst: {self.worth:.6g} {self.unit}".rstrip()]
        lines += [f"  worst over {over}"] if over else []
        lines += [f"  {name} {value:.4g}, chosen with the placement" for name, value in self.gains.items()]
        if self.unverified is not None:
            lines.append(
                f"  a climb that could not be verified came to {self.unverified:.6g}; more starts may settle it"
            )
        return "\n".join([*lines, *repr(self.settings).splitlines()])


def outcome_stand(
    problems: tuple[SelectionProblem, ...],
    bases: Vector,
    loop: Loop,
    uncertainty: tuple[Uncertainty, ...],
    name: str,
    least: LeastOutcomes | None,
    workers: int,
    progress: Progress | None,
) -> OutcomeStand:
    """Local optima of the worst target's measure, verified to first order; the best.

    Args:
        problems: from `build_problems`; their objective is not asked.
        bases: placements (n_b, N) that are looked at.
        loop, uncertainty, name, least: as of `outcome_selection`.
        workers, progress: as of `flexopt.select_stand`.

    Raises:
        InputError, NoSolutionFound: as `outcome_selection`.
        UnreachableTarget: from none of the placements all targets are reached.
    """
    first = problems[0]
    machine, n_base, seed = first.machine, len(first.machine.base_coordinates), first.seed
    found = [reached_from(problem, bases, seed) for problem in problems]
    allowed = [np.isfinite(reached.value) for reached in found]
    whole = np.flatnonzero(np.all([each.any(axis=1) for each in allowed], axis=0))
    if not whole.size:
        raise none_reaches_all(len(problems))
    z = found[0].z[:, whole[0], int(np.argmax(allowed[0][whole[0]]))]
    settings = loop_settings(machine, loop, first.quantities.evaluated(z), gravity=first.gravity)
    measure, bounds = measure_of(name, first), asked_of(least)
    varied = (uncertainty or GROUND) if name == RADIUS else uncertainty
    box = UncertaintyBox(machine, varied, settings.dead_time)
    faults = [*box.faults(settings.rate), *unfit(name, bounds, loop, settings, varied)]
    raise_if_any(InputError, "select_stand", [Fault(f.field, f.sentence, f.value) for f in faults])
    held = UncertainLoop(settings, z[:n_base], z[n_base:], first.gravity, box)
    corners = box.corners(CORNERED) if uncertainty and name != RADIUS else np.zeros((0, 0))
    program = SharedProgram(first, held, gain_ranges(loop), corners, measure=measure, least=bounds, problems=problems)
    looked = _looked(program, found, whole, workers)
    chosen, starts = starts_from(program, looked, workers)
    assert isinstance(chosen, SharedProgram)
    ends = climbs(chosen, starts, workers, progress)
    distinct, unverified = distinct_optima(chosen, ends)
    best = distinct[0]
    chosen_settings = chosen.at(best.y).settings
    places = list[TargetConfiguration]()
    for (target, own), value in zip(chosen.parts(best.y), chosen.values(best.y), strict=True):
        there = target.problem.quantities.evaluated(target.z(own))
        stand = with_outcome(machine, there, chosen_settings, gravity=first.gravity)
        told = constraint_values(target.problem, target.z(own)) | kept_values(target, own)
        places.append(TargetConfiguration(target.problem.target, stand, measure.sign * value, told))
    others = [(measure.sign * each.value, chosen.z(each.y)[:n_base]) for each in distinct]
    return OutcomeStand(
        places=tuple(places),
        worth=measure.sign * best.value,
        alternatives=tuple(_elsewhere(others, first.scale[:n_base])),
        stationarity=best.stationarity,
        kinks={},
        attempts=(len(starts), sum(each is not None and each.holds for each in ends)),
        problems=problems,
        provenance=provenance(machine, objective=name, targets=[p.target.tolist() for p in problems], seed=seed),
        criterion=measure,
        settings=chosen_settings,
        loop=loop,
        uncertainty=uncertainty,
        unverified=unverified,
    )


def _elsewhere(found: list[tuple[float, Vector]], scale: Vector) -> list[tuple[float, Vector]]:
    """Worth and placement of the optima after the first, those at the same place once."""
    bases, others = [found[0][1]], list[tuple[float, Vector]]()
    for worth, base in found[1:]:
        if all(np.abs((base - other) / scale).max(initial=0.0) > SAME_BASE for other in bases):
            bases.append(base)
            others.append((worth, base))
    return others


def _looked(program: SharedProgram, found: list[Reached], whole: Any, workers: int) -> list[Vector]:
    """Points y: placements that reach all targets, gains from their ranges, and the best of some postures for each."""
    count, measure, ranges = len(program.problems), program.measure, program.ranges
    unit = low_discrepancy(1 + len(ranges), max(1, measure.looked // count), program.problem.seed)
    ends = program.bounds
    gains = ends[0][program.n_z :] + unit[1:].T * (ends[1] - ends[0])[program.n_z :]
    numbers = whole[np.minimum((unit[0] * whole.size).astype(int), whole.size - 1)]
    picked = list[list[Vector]]()
    for target, reached in zip(program.targets, found, strict=True):
        ys, of = list[Vector](), list[int]()
        for i, j in enumerate(numbers.tolist()):
            postures = np.flatnonzero(np.isfinite(reached.value[j]))
            # Even numbers of those that are allowed.
            some = postures[np.linspace(0, len(postures) - 1, min(POSTURES, len(postures))).astype(int)]
            ys += [np.append(reached.z[:, j, c] / target.problem.scale, gains[i]) for c in some]
            of += [i] * len(some)
        values = measure.values(target, ys, workers)
        if values is None:
            blocks = [ys[k : k + TOGETHER] for k in range(0, len(ys), TOGETHER)]
            told = in_parallel(partial(_values, target, blocks), len(blocks), workers)
            values = [value for block in told for value in block]
        best = dict[int, tuple[float, Vector]]()
        for i, value, y in zip(of, values, ys, strict=True):
            if i not in best or value > best[i][0]:
                best[i] = value, y
        picked.append([best[i][1] for i in range(len(numbers))])
    return [program.joined([own[i] for own in picked]) for i in range(len(numbers))]


def _values(target: Any, blocks: list[list[Vector]], number: int) -> list[float]:
    return [target.value(y) for y in blocks[number]]
