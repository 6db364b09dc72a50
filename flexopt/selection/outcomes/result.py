"""The answer to a choice by a measure of the loop, and how it is told."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Document, Mask, Vector
from flexopt.foundation.plain import counted
from flexopt.foundation.turns import available_cores
from flexopt.loop.certified.region import LARGEST
from flexopt.loop.evaluation import Outcome, unseen_told
from flexopt.loop.settings import LoopSettings
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model.loop import Loop, gain_ranges, least_tried
from flexopt.model.uncertainty import Uncertainty
from flexopt.robustness import Evaluation
from flexopt.selection.broken import cornerless
from flexopt.selection.columns import units_of_columns
from flexopt.selection.constraint_values import resting_told
from flexopt.selection.outcomes.asked import Asked, broken_told, documents_of
from flexopt.selection.outcomes.branches import Measure
from flexopt.selection.outcomes.program import OutcomeProgram, with_slowest
from flexopt.selection.problem import SelectionProblem
from flexopt.selection.result import SHOWN, Selection, unverified_told

# Points along the redundancy whose worst members are sought.
ALONG = 24
# Of the best value, by which the present one may be less and nothing is to gain.
ALIKE = 1e-3


def asked_of_loop(document: Document, objective: str) -> Document:
    """A problem's document by what was sought: where that is the loop's, the problem's own w_i is not asked."""
    known = {each["name"]: each for each in document["objectives"]}
    objectives = [known.get(word, {"name": word, "weights": None, "scale": None}) for word in objective.split(",")]
    weights = next((each["weights"] for each in objectives if each["name"] == document["objective"]), None)
    return document | {"objective": objective, "weights": weights, "objectives": objectives}


@dataclass(frozen=True, repr=False)
class ChosenByLoop(ABC):
    """What choices by a measure of the loop have in common, of one target and of several.

    Attributes:
        asked: of the loop;  criterion: what is sought.
    """

    asked: Asked = field(repr=False, kw_only=True)
    criterion: Measure = field(repr=False, kw_only=True)

    @property
    def measure(self) -> str:
        """Its name."""
        return self.criterion.told

    @property
    def loop(self) -> Loop:
        """As it was given."""
        return self.asked.loop

    @property
    def uncertainty(self) -> tuple[Uncertainty, ...]:
        """What the worst case is taken over; empty: none."""
        return self.asked.uncertainty

    @property
    def _uncertainty(self) -> list[dict[str, Any]]:
        return documents_of(self.uncertainty)

    def _chosen(self, settings: LoopSettings) -> dict[str, float]:
        """Gains that were chosen with the configuration."""
        return {name: float(getattr(settings, name)[0]) for name in gain_ranges(self.loop)}

    @property
    @abstractmethod
    def _judged(self) -> Sequence[SelectionProblem]:
        """The problem of each target."""

    def _unseen_told(self, stand: Evaluation) -> tuple[str, ...]:
        """That no loop changes what decays slowest there, the configuration with the least; empty where one does."""
        found = stand.outcome
        assert isinstance(found, Outcome)
        return (unseen_told("the best"),) if self.measure == "decay" and found.unseen else ()

    def _least_told(self, chosen: Sequence[Mapping[str, float]]) -> tuple[str, ...]:
        """Which gains of those chosen are the least that are tried of ranges from 0."""
        ranges = gain_ranges(self.loop).items()
        told = (least_tried(f"loop.{name}", each[name], ends) for each in chosen for name, ends in ranges)
        return tuple(dict.fromkeys(filter(None, told)))

    def loops_break(self, settings: LoopSettings, stand: Sequence[tuple[Vector, Vector]]) -> list[str]:
        """At each target what a loop does not do of what it must at least, base and posture there: "breaks …"."""
        pairs = zip(self._judged, stand, strict=True)
        return [broken_told(self.asked.broken(problem, settings, *there)) for problem, there in pairs]

    def loops_rest(self, settings: LoopSettings, stand: Sequence[tuple[Vector, Vector]]) -> list[tuple[str, ...]]:
        """At each target what a loop does just so of what it must at least, base and posture there."""
        pairs = zip(self._judged, stand, strict=True)
        return [self.asked.resting(problem, settings, *there) for problem, there in pairs]


@dataclass(frozen=True, repr=False)
class OutcomeSelection(ChosenByLoop, Selection):
    """The answer to a configuration problem by what the loop does.

    Attributes:
        measure: what is largest, of `flexopt.Outcome`, of modes the least, or the stability `"radius"`; of `"settling"`
            and `"swing"` what is least. `Candidate.objective` is its value, SI, over the uncertainty its worst.
        gains: kp and kv of each candidate, those that were chosen with the configuration.
        radii: of each candidate the stability radius: how many times softer or stiffer all springs together may be
            before the loop grows, looked for up to 10; the fastest loop is often the most fragile one.
        loop: as it was given;  uncertainty: what the worst case is taken over; empty: none.
        present: the measure of the present configuration, over the uncertainty its worst; None where it has none.
        present_broken: of what the loop must do at least, and of what objectives before keep, what that of the present
            configuration does not.
        others: as of `Selection`, `unverified` in the measure's own unit; of gains that were chosen `initial` has those
            that the loop gives beside their ranges, as the machine has them now, else the best candidate's.
    """

    present: float | None = None
    present_broken: tuple[str, ...] = field(default=(), repr=False)
    radii: tuple[float, ...] = ()
    settings: tuple[LoopSettings, ...] = field(default=(), repr=False)

    _OWN = " measure gains radii uncertainty=_uncertainty"
    DOCUMENT = Selection.DOCUMENT.replace("problem ", "problem=_asked ") + _OWN

    @property
    def gains(self) -> tuple[dict[str, float], ...]:
        """See the class."""
        return tuple(map(self._chosen, self.settings))

    def along_redundancy(self) -> Vector | None:
        """The measure at the points of `problem.scan` with the gains of the best candidate, (N,).

        Over the uncertainty its least at members that are looked at, and at those that are the worst at some of the
        points and at the candidates. NaN where a loop has none of it; None of measures that are not computed of many
        loops at once.
        """
        found = self._along(self.criterion)
        return None if found is None else self.criterion.sign * np.where(np.isfinite(found), found, np.nan)

    def broken_along_redundancy(self) -> Mask:
        """See `Selection`; so does a loop that does less than it must, as far as that is computed of many at once."""
        found = super().broken_along_redundancy()
        for measure, least in self.asked.bounds:
            values = self._along(measure)
            if values is not None:
                found |= ~(values >= least)
        return found

    @cached_property
    def _known_along(self) -> dict[Measure, Vector | None]:
        """What was computed of these: a page draws its pictures for light and for dark."""
        return {}

    def _along(self, measure: Measure) -> Vector | None:
        """What a measure counts at the points of `problem.scan`, (N,); see `along_redundancy`."""
        if measure not in self._known_along:
            self._known_along[measure] = self._computed_along(measure)
        return self._known_along[measure]

    def _computed_along(self, measure: Measure) -> Vector | None:
        scan, best = self.problem.scan, self.best.evaluation
        parts = self.asked.parts(self.problem, best)
        # What the loop leaves out follows from where the choice began: it has the numbers of the best candidate's.
        parts |= {"loop": replace(parts["loop"], settings=self.settings[0]), "ranges": {}}
        parts["measure"] = measure
        program = OutcomeProgram(**parts)
        ys = list((np.vstack([scan.base, scan.posture]) / self.problem.scale[:, None]).T)
        told = [candidate.z / self.problem.scale for candidate in self.candidates]
        told += [] if self.initial is None else [self.initial.z / self.problem.scale]
        workers = available_cores()
        if measure.of_rates:
            program = with_slowest(program, told, ys[:: math.ceil(len(ys) / ALONG)], workers)
        found = measure.values(program, ys, workers)
        return None if found is None else np.asarray(found)

    @property
    def _judged(self) -> Sequence[SelectionProblem]:
        return (self.problem,)

    @property
    def objective_unit(self) -> str:
        """Of the measure."""
        return self.criterion.unit_of(self.settings[0])

    @property
    def _asked(self) -> Document:
        return asked_of_loop(self.problem.to_dict(), self.objective)

    @property
    def status(self) -> str:
        """A sentence."""
        count, ended, looked = len(self.candidates), len(self.attempts), self.criterion.looked
        optima = counted(count, "distinct local optimum", "distinct local optima")
        climbs = counted(ended, "climb")
        return (
            f"{optima} verified to first order, the {'end' if ended == 1 else 'ends'} of {climbs} from {looked} points"
        )

    @property
    def _found_how_often(self) -> NDArray[np.integer[Any]]:
        # Climbs that go to the end are chosen among others, not drawn.
        return np.zeros(0, dtype=np.int64)

    @property
    def edges(self) -> tuple[str, ...]:
        """None: the loop knows no numbers of modes."""
        return ()

    @property
    def decided_by(self) -> str:
        """Empty: candidates are ranked by the measure alone."""
        return ""

    @property
    def nothing_to_gain(self) -> str:
        """A sentence where the present configuration has as much of the measure as the best; else empty."""
        now = self.present
        if now is None or self.present_broken or not self._present_keeps_all:
            return ""
        if self.criterion.sign * (self.best.objective - now) > ALIKE * abs(self.best.objective):
            return ""
        sign = self.criterion.sign
        if sign * (now - self.best.objective) > ALIKE * abs(now):
            how = "more" if sign > 0 else "less"
            return f"the search found nothing as good as the present configuration, which has {how} {self.measure}"
        return f"nothing to gain: the present configuration has {'as much' if sign > 0 else 'as little'} {self.measure}"

    @property
    def present_told(self) -> str:
        """As of `Selection`, and what its loop breaks of the constraint `outcome`."""
        return "; ".join(filter(None, (super().present_told, broken_told(self.present_broken))))

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on the choice, those of the loop's measure."""
        unverified = unverified_told(self.measure, self.unverified)
        first = self.best.evaluation
        own = (*self._unseen_told(first), first.sag_told, *self._least_told(self.gains), *self.beyond_limits[:SHOWN])
        return tuple(sentence for sentence in (unverified, self.nothing_to_gain, *own) if sentence)

    def __repr__(self) -> str:
        best = self.best.evaluation
        names, measure = (*best.base_coordinates, *best.joints), f"{self.measure} {self.objective_unit}".strip()
        box = UncertaintyBox(self.problem.machine, self.uncertainty, self.settings[0].dead_time)
        over = f", worst over {box.judged_over}" if box.judged_over else ""
        lines = [
            f"{best.machine}: end-point at ({', '.join(f'{x:g}' for x in self.problem.target)}) m, Jacobian "
            f"{best.control} control, objective {self.objective}{over}: {self.status}",
            "  rank " + " ".join(f"{name:>9}" for name in names) + f" {measure:>16} {'radius':>7}"
            + "".join(f" {name:>10}" for name in self.gains[0]),
        ]  # fmt: skip
        each, at_corners = zip(self.candidates, self.radii, self.gains, strict=True), cornerless(self.problem)
        for rank, (candidate, radius, gains) in enumerate(each, start=1):
            e = candidate.evaluation
            numbers = " ".join(f"{x:z9.4f}" for x in (*e.base, *e.posture))
            resting = resting_told(candidate.active, at_corners)
            active = f"   rests on {', '.join(resting)}" if resting else ""
            chosen = "".join(f" {gain:10.4g}" for gain in gains.values())
            lines.append(f"  {rank:4d} {numbers} {candidate.objective:16.6g} {radius:7.3g}{chosen}{active}")
        lines.append(
            f"  in {units_of_columns(best)}; radius: by which factor all springs together may be "
            f"softer or stiffer, looked for up to {LARGEST:g}"
        )
        lines += [f"  {sentence}" for sentence in (*self.constraints_told, *self.remarks, *map(str, self.kept))]
        if self.initial is not None and self.present is not None:
            e, now = self.initial, self.present
            off = self.present_told
            there = " ".join(f"{x:z9.4f}" for x in (*e.base, *e.posture))
            settings = self.asked.present_settings(self.settings[0])
            with_gains = "".join(f" {gain:10.4g}" for gain in self._chosen(settings).values())
            lines.append(f"   now {there} {now:16.6g}{with_gains and ' ' * 8 + with_gains}{off and '   ' + off}")
        return "\n".join([*lines, *repr(self.settings[0]).splitlines()])
