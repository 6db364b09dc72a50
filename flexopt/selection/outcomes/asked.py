"""What is asked of a loop, at one target or several: a measure, what it must do at least, over what is uncertain.

In: arguments of a call. Out: `Asked`; what a program takes of it, and what of it a loop in a configuration breaks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arrays import Document, Vector
from flexopt.loop.settings import LoopSettings, loop_settings
from flexopt.loop.uncertain import FEW, UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model import AnyMachine
from flexopt.model.choices import ALLOWANCE, ALLOWED_GAIN, RADIUS
from flexopt.model.constraints import LeastOutcomes
from flexopt.model.loop import Loop, gain_ranges, under_control
from flexopt.model.uncertainty import GROUND, Uncertainty
from flexopt.robustness import Evaluation
from flexopt.selection.constraint_values import ConstraintValue
from flexopt.selection.outcomes.branches import Measure
from flexopt.selection.outcomes.measures import MEASURES, OfModes
from flexopt.selection.outcomes.program import worst_of
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.solve import least_of

# How near to what it must be at least a measure is just that, as a share of it.
JUST = 1e-6
# Of that, by which a member of what is uncertain may do less: tables show four digits.
LESS = 1e-5
MeasureBounds = tuple[tuple[Measure, float], ...]


@dataclass(frozen=True)
class Asked:
    """What is asked of a loop.

    Attributes:
        call: the public function.
        loop: known to be good for the machine; gains that it gives ranges of are chosen, too.
        uncertainty: over which the least counts; empty: the machine's own numbers. Of the radius its factors; empty:
            one of all springs.
        name: of the measure; none of `OUTCOMES`: the problem's own objective.
        least: what the loop must do at least.
    """

    call: str
    loop: Loop
    uncertainty: tuple[Uncertainty, ...]
    name: str
    least: LeastOutcomes | None

    @staticmethod
    def of(call: str, problem: SelectionProblem, loop: Any, ranges: Any, name: str, constraints: Any) -> Asked:
        """From a call's arguments, by default the machine's; a radius, one of several in order, too, has all springs.

        Raises:
            InputError: the loop does not fit the machine or the control.
        """
        machine, least = problem.machine, least_of(constraints)
        own = under_control(loop or machine.loop or Loop(), machine, problem.control, call)
        radius = RADIUS in name.split(",") or (least is not None and least.radius is not None)
        return Asked(call, own, ranges or (() if radius else machine.uncertainty), name, least)

    @property
    def bounds(self) -> MeasureBounds:
        """What the loop must do at least, as measures count."""
        return tuple((MEASURES[word], MEASURES[word].sign * x) for word, x in self.least or () if x is not None)

    def stated(self, problem: SelectionProblem) -> Document:
        """What was asked beside targets, as provenance has it; what the loop must do at least no problem holds."""
        stated = problem.stated
        if self.least is not None:
            stated["constraints"] |= {"outcome": self.least.model_dump(exclude_none=True)}
        asked = {"objective": self.name, "loop": self.loop.model_dump(exclude_unset=True)}
        return stated | asked | {"ranges": documents_of(self.uncertainty)}

    def parts(self, problem: SelectionProblem, stand: Evaluation, bounds: MeasureBounds = ()) -> dict[str, Any]:
        """What an `OutcomeProgram` takes of it; what the loop leaves out follows from a configuration that stands.

        `bounds`: of further measures.

        Raises:
            InputError: what is uncertain, or asked for, does not go with the loop or the measure.
        """
        settings = loop_settings(problem.machine, self.loop, stand, gravity=problem.gravity)
        box, corners = self._box_and_corners(problem.machine, settings.dead_time)
        bounds = (*self.bounds, *bounds)
        faults = [*box.faults(settings.rate), *self._unfit(bounds, settings, box.uncertainty)]
        raise_if_any(InputError, self.call, faults)
        return {
            "problem": problem,
            "loop": UncertainLoop(settings, stand.base, stand.posture, problem.gravity, box),
            "ranges": gain_ranges(self.loop),
            "members": corners,
            "measure": measure_of(self.name, problem),
            "least": bounds,
        }

    def present_settings(self, settings: LoopSettings) -> LoopSettings:
        """The loop as it is now: that of a candidate, with those gains that are given beside ranges of theirs."""
        given = {name: getattr(self.loop, name) for name in gain_ranges(self.loop)}
        gains = {name: np.broadcast_to(own, settings.kp.size) for name, own in given.items() if own is not None}
        sources = {name: source for name, source in settings.sources.items() if name not in gains}
        return replace(settings, **gains, sources=sources)

    def broken(
        self,
        problem: SelectionProblem,
        settings: LoopSettings,
        base: Vector,
        posture: Vector,
        bounds: MeasureBounds = (),
    ) -> tuple[str, ...]:
        """What a loop in a configuration does not do of what it must at least, or of further bounds, in words."""
        kept = self._kept(problem, settings, base, posture, bounds)
        # What a loop that grows has no number of counts as broken.
        return tuple(_said(name, value) for name, value in kept.items() if not value.room >= -LESS * _end(value))

    def resting(
        self, problem: SelectionProblem, settings: LoopSettings, base: Vector, posture: Vector
    ) -> tuple[str, ...]:
        """What of it a loop in a configuration does just so."""
        kept = self._kept(problem, settings, base, posture)
        return tuple(name for name, value in kept.items() if abs(value.room) <= JUST * _end(value))

    def _kept(
        self,
        problem: SelectionProblem,
        settings: LoopSettings,
        base: Vector,
        posture: Vector,
        bounds: MeasureBounds = (),
    ) -> dict[str, ConstraintValue]:
        bounds = (*self.bounds, *bounds)
        if not bounds:
            return {}
        box, corners = self._box_and_corners(problem.machine, settings.dead_time)
        loop = UncertainLoop(settings, base, posture, problem.gravity, box)
        return least_values(bounds, loop, worst=len(corners) > 0)

    def _box_and_corners(self, machine: AnyMachine, dead_time: float) -> tuple[UncertaintyBox, Vector]:
        """What is not known, of the radius its factors; the members (n, k) over which the measure is the worst."""
        radius = self.name == RADIUS
        box = UncertaintyBox(machine, (self.uncertainty or GROUND) if radius else self.uncertainty, dead_time)
        return box, box.corners(FEW) if self.uncertainty and not radius else np.zeros((0, 0))

    def _unfit(self, bounds: MeasureBounds, settings: LoopSettings, varied: tuple[Uncertainty, ...]) -> list[Fault]:
        """What measures cannot be had of."""
        found, asked = list[Fault](), {self.name, *(measure.name for measure, _ in bounds)}
        if RADIUS in asked - {self.name} and varied:
            found.append(Fault("ranges", "do not go with a least radius, which is that of all springs"))
        if ALLOWED_GAIN in asked and not settings.kp.any():
            found.append(Fault("loop.kp", "is 0, and allowed_gain asks for the largest Kp"))
        if self.name == ALLOWANCE and gain_ranges(self.loop):
            found.append(Fault("loop", "has ranges of gains, which the objective allowance does not depend on"))
        if self.name == RADIUS:
            found += [
                Fault("ranges", "must be factors for the objective radius", each.name)
                for each in varied
                if each.factor is None
            ]
        return found


def measure_of(name: str, problem: SelectionProblem) -> Measure:
    """What a word asks for: a measure of the loop, or the problem's own objective."""
    return MEASURES[name] if name in MEASURES else OfModes(problem)


def _end(value: ConstraintValue) -> float:
    """The size of the bound."""
    return min(abs(value.lower), abs(value.upper))


def _said(name: str, value: ConstraintValue) -> str:
    if math.isfinite(value.value):
        return f"{name} {value}"
    return f"{name}, of which there is none where it grows ({value.allowed('{:z.4g}'.format, value.unit)})"


def broken_told(broken: Sequence[str]) -> str:
    """What is broken as a sentence: "breaks …", or nothing."""
    return f"breaks {', '.join(broken)}" if broken else ""


def documents_of(uncertainty: Sequence[Uncertainty]) -> list[dict[str, Any]]:
    """What is uncertain, as documents have it."""
    return [each.model_dump(exclude_none=True) for each in uncertainty]


def least_values(bounds: MeasureBounds, loop: UncertainLoop, *, worst: bool) -> dict[str, ConstraintValue]:
    """What a loop does of what it must at least; `worst`: over what is uncertain the worst found."""
    point, found = loop.outcome(), dict[str, ConstraintValue]()
    for measure, least in bounds:
        value = measure.value(loop, point)
        value = measure.sign * (min(value, worst_of(loop, measure)[0]) if worst else value)
        ends = (least, math.inf) if measure.sign > 0 else (-math.inf, -least)
        found[measure.told] = ConstraintValue(value, *ends, measure.unit_of(loop.settings))
    return found
