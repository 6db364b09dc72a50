"""What choosing several configurations together returns."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.coprime.margin import RIGID_MARGIN
from flexopt.foundation.arrays import Document, Vector
from flexopt.foundation.documents import json_ready
from flexopt.foundation.pictures import Pictured
from flexopt.foundation.plain import counted, listed
from flexopt.foundation.results import Tabled
from flexopt.model.beyond_limits import beyond_limits_told
from flexopt.model.simulation import Path
from flexopt.robustness.evaluation import EXCITES, Evaluation, excites_rigid, most_sag_told
from flexopt.robustness.residues import residue_unit, unit_in_words
from flexopt.selection.broken import cornerless, resting
from flexopt.selection.chances import chance, chance_at_most, chance_told, how_often
from flexopt.selection.columns import column_heads, in_columns, in_margin, shown_measures, units_told
from flexopt.selection.constraint_values import ConstraintValue, nearest_told
from flexopt.selection.problem import TIE_TOLERANCE, SelectionProblem
from flexopt.selection.result import NOTHING, THIN, unverified_told

# What the shortest way may give up, relative to the objective's scale.
KEPT = 1e-4


@dataclass(frozen=True)
class TargetConfiguration(Tabled):
    """The configuration at one target.

    Attributes:
        target: (n_task,), m, inertial frame.
        evaluation: every measure there.
        objective: V, the cost of travel taken off.
        constraints: label -> value and bounds.
    """

    target: Vector
    evaluation: Evaluation
    objective: float
    constraints: dict[str, ConstraintValue] = field(repr=False)

    def _units(self, outer: str) -> Iterator[tuple[str, str]]:
        return self.evaluation._units(outer)  # pyright: ignore[reportPrivateUsage]

    def to_dict(self) -> Document:
        """The evaluation's dictionary with the place's own keys."""
        own = {"target": self.target, "objective": self.objective, "constraints": self.constraints}
        return self.evaluation.to_dict() | json_ready(own)


@dataclass(frozen=True)
class ConfigurationSet(Tabled):
    """Configurations of K targets that were chosen together.

    Attributes:
        places: one for each target, in order.
        stationarity: of the solution, relative to the objective's scale.
        kinks: where w_i have kinks at the solution (a_i = 0 or b_i = 0 at a target), the multipliers that prove it, as
            in `flexopt.selection.result.Candidate`.
        attempts: starts, and how many led to a verified optimum;  beside: how many of these starts nobody asked for,
            as of a plan standing still and postures carried along.
        further: verified optima of climbs from points that were seen to be better than where the starts led, and of a
            stand in space from what its worst targets can have alone.
        problems: the configuration problem of each target.
        unverified: what the best climb was worth that broke no constraint but could not be verified where it ended,
            where that is better than what was chosen; else None.
    """

    places: tuple[TargetConfiguration, ...]
    stationarity: float
    kinks: dict[str, float]
    attempts: tuple[int, int]
    problems: tuple[SelectionProblem, ...] = field(repr=False)
    provenance: Document = field(repr=False)
    unverified: float | None = field(default=None, kw_only=True)
    beside: int = field(default=0, kw_only=True)
    further: int = field(default=0, kw_only=True)

    @property
    def converged(self) -> bool:
        """True: what did not converge raises `NoSolutionFound` instead."""
        return True

    @property
    def objective(self) -> str:
        """Name of what was sought."""
        return self.problems[0].name

    @property
    def column(self) -> str:
        """What its numbers stand under: its name, of several in order V."""
        return "V" if "," in self.objective else self.objective

    @property
    def unit(self) -> str | None:
        """Of it, where it is none of the modes'."""
        return None

    @property
    def V(self) -> Vector:  # noqa: N802 - the article's letter
        """The objective at each target, (K,)."""
        return np.array([place.objective for place in self.places])

    @property
    def shown_objective(self) -> Vector:
        """V (K,) as tables and pictures show it: 0 where it ranks as equal to the best that w_i can be."""
        scale = 0.0 if self.unit is not None else self.problems[0].first_scale
        shown: Vector = np.where(np.abs(self.V) > TIE_TOLERANCE * scale, self.V, 0.0)
        return shown

    @property
    def differs(self) -> bool:
        """Whether the targets differ in the objective, as tables show it."""
        return len({f"{value:.4e}" for value in self.shown_objective}) > 1

    @property
    def not_passive(self) -> str:
        """A sentence on targets where λmin(R_0 + R_0ᵀ) is negative; empty where there is none."""
        found = {
            k + 1: place.evaluation.rigid for k, place in enumerate(self.places) if excites_rigid(place.evaluation)
        }
        if not found:
            return ""
        e, least = self.places[0].evaluation, min(found.values())
        unit = residue_unit(e.control, e.joint_units)
        where = "every target" if len(found) == len(self.places) > 1 else _numbered(list(found))
        least_told = f"{'' if len(found) == 1 else 'down to '}{least:.5e} {unit_in_words(unit)}"
        return f"rigid part: λmin(R0 + R0ᵀ) is negative at {where}, {least_told}: {EXCITES}"

    @property
    def as_good(self) -> str:
        """A sentence where others that were found are as good; empty where that is not told."""
        return ""

    @property
    def left_open(self) -> str:
        """A sentence on what more starts may find; empty where that is not told."""
        return ""

    @property
    def beyond_limits(self) -> str:
        """Which joints are held beyond the limits of the machine's file, left out here, a sentence; empty of none."""
        postures = [place.evaluation.posture for place in self.places]
        return beyond_limits_told(self.problems[0].machine, "the choice", postures)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on the choice: what it leaves open and out, what is as good."""
        unverified = unverified_told(self.objective, self.unverified)
        sag = most_sag_told([place.evaluation for place in self.places])
        said = (unverified, self.left_open, self.as_good, self.not_passive, self.left_out, self.unweighted, sag)
        said = (*said, self.beyond_limits)
        return tuple(sentence for sentence in said if sentence)

    @property
    def _targets(self) -> str:
        return counted(len(self.places), "target")

    @property
    def worst(self) -> int:
        """Index of the target with the smallest V."""
        return int(self.V.argmin())

    def _found(self, what: str) -> str:
        tried, done = self.attempts
        beside = f" ({self.beside} of them standing still, or carrying postures along)" if self.beside else ""
        further = f", and {counted(self.further, 'further climb')}" if self.further else ""
        return f"{done} of {counted(tried, 'start')}{beside} led to a verified {what} {self._targets}{further}"

    def _document(self, status: str, own: dict[str, Any], targets: str) -> dict[str, Any]:
        """What both kinds say, around their own keys; `targets` is what the problem calls them."""
        document = {"status": status, "converged": self.converged}
        document |= own | {"worst": self.worst, "places": [place.to_dict() for place in self.places]}
        document |= {"base_coordinates": self.places[0].evaluation.base_coordinates}
        document |= {"stationarity": self.stationarity, "kinks": self.kinks, "unverified": self.unverified}
        document |= {"beyond_limits": self.beyond_limits, "provenance": self.provenance}
        problem = self.problems[0].to_dict() | {targets: [place.target for place in self.places]}
        return json_ready(document | {"problem": problem})

    def _lines(self, what: str, status: str) -> list[str]:
        """A heading, and a line for each target."""
        first = self.problems[0]
        how = f"Jacobian {first.control} control, objective {self.objective}: {status}"
        kept = nearest_told(first.asked, [place.constraints for place in self.places], cornerless(first))
        named = [f"  {assumption}" for assumption in first.assumed]
        named += [f"  {self.unused_posture}"] * bool(self.unused_posture)
        return [
            f"{first.machine.name}: {what}, {how}",
            *self._table(),
            *(f"  {sentence}" for sentence in (*filter(None, [kept]), *self.remarks)),
            *named,
        ]

    def _table(self) -> list[str]:
        """A line for each target: where it stands, what was sought, every w_i, ε_max."""
        e, name = self.places[0].evaluation, self.column
        measures = [f"w{i + 1}" for i in range(e.w.size)]
        # Of one w_i alone its own column tells it, but where a cost of travel is taken off.
        apart = name not in measures or self.problems[0].travel is not None
        heads = [*([name if name not in measures else "V"] if apart else []), *measures]
        lines = column_heads("  target", e, "".join(f"{head:>13}" for head in heads) + f"{'ε_max':>10}")
        count = len(self.places)
        shown = range(count) if count <= SHOWN else np.linspace(0, count - 1, SHOWN).astype(int)
        for k in sorted({*(int(i) for i in shown), self.worst}):
            told = "   the worst" if k == self.worst and self.differs else ""
            e, problem = self.places[k].evaluation, self.problems[k]
            values = [*([self.shown_objective[k]] if apart else []), *shown_measures(problem, e)]
            lines += [f"  {k + 1:6d} {in_columns(e)}{''.join(f'{x:13.4e}' for x in values)}{in_margin(e)}{told}"]
        return [*lines, f"  {units_told(e)}"]

    @property
    def unused_posture(self) -> str:
        """A sentence where a present posture was given that decides nothing; else empty."""
        first = self.problems[0]
        if first.present_posture is None or first.travel is not None:
            return ""
        return "posture: decides nothing, as each target has its own; a cost of travel alone counts from it"

    @property
    def left_out(self) -> str:
        """A sentence where a target has less than half of a rigid plant's ε_max, which is never sought; else empty."""
        known = [(e.epsilon_max, k) for k, e in enumerate(place.evaluation for place in self.places) if e.epsilon_max]
        least, k = min(known, default=(RIGID_MARGIN, 0))
        if least >= THIN * RIGID_MARGIN:
            return ""
        return (
            f"the objective leaves ε_max out: {least:.4g} at target {k + 1}, of {RIGID_MARGIN:.4g} of a rigid machine"
        )

    @property
    def unweighted(self) -> str:
        """A sentence where equal gains excite a mode that the sought w_i leave out; else empty."""
        sought = self.problems[0].sought
        used = np.any([each.uses for each in sought], axis=0)
        if self.unit is not None or any(each.has_kinks for each in sought) or not used.any() or used.all():
            return ""
        e = [place.evaluation for place in self.places]
        # Below -|a||b| a and b point into different halves of space.
        bad = [(x.w[i], i, k) for k, x in enumerate(e) for i in np.flatnonzero(~used) if x.w[i] < -x.scale[i]]
        if not bad or len(e[0].end_point) == 1:
            return ""
        w, i, k = min(bad)
        unit = residue_unit(e[0].control, e[0].joint_units)
        return (
            f"the objective leaves w{i + 1} out: {w:.4e} {unit_in_words(unit)} at target {k + 1}, "
            f"where equal gains take damping from mode {i + 1}; V with weights counts every mode"
        )


@dataclass(frozen=True)
class Stand(Pictured, ConfigurationSet):
    """One placement for several targets, and a posture for each; see `ConfigurationSet`.

    Its picture: the machine at every target, and V and w at each.

    Attributes:
        worth: what was maximised: the worst V, or Σ share_k V_k.
        alternatives: worth and placement of the other local optima found, best first; of those, and of this, that are
            worth the same the one nearest to the present placement comes first.
        alternative_postures: of each of these the posture at every target (K, n), rad or m.
        ends: worth of where each start led that led to a verified optimum; empty of a choice by the loop, whose climbs
            are chosen, not drawn.
        number: which of the placements found it is, the best being 1.

    Example:
        >>> machine = flexopt.load("excavator")
        >>> stand = flexopt.select_stand(machine, [(0.0, 1.6), (0.2, 1.4)], starts=2, workers=1)
        >>> bool(stand.worth == stand.V.min())
        True
    """

    worth: float
    alternatives: tuple[tuple[float, Vector], ...]
    alternative_postures: tuple[Vector, ...]
    ends: tuple[float, ...] = field(default=(), kw_only=True)
    number: int = field(default=1, repr=False, kw_only=True)

    @property
    def missed_chance(self) -> float | None:
        """As `flexopt.selection.Selection.missed_chance`; None also of a choice by the loop."""
        return chance(self._found_how_often)

    @property
    def missed_chance_at_most(self) -> float | None:
        """As `flexopt.selection.Selection.missed_chance_at_most`; None also of a choice by the loop."""
        return chance_at_most(self._found_how_often)

    @property
    def _found_how_often(self) -> NDArray[np.integer[Any]]:
        return how_often(self.problems[0], self.ends)

    @property
    def left_open(self) -> str:
        """How likely more starts lead to another optimum, and what others were found; empty of a choice by the loop."""
        counts = self._found_how_often
        # Where none is better its stationarity is 0.
        if not counts.size or self.stationarity == 0.0:
            return ""
        told = chance_told(counts, self.attempts[0])
        if not self.alternatives:
            return told
        others = counted(len(self.alternatives), "other placement")
        return f"{told}; {others} found, the next best worth {self.alternatives[0][0]:.4e}"

    @property
    def base(self) -> Vector:
        """The placement (n_b,), m or rad."""
        return self.places[0].evaluation.base

    @property
    def as_good(self) -> str:
        """A sentence where other placements found are as good, to 1e-4 of the objective's scale; else empty."""
        size = abs(self.worth) if self.unit is not None else self.problems[0].objective_scale
        near = NOTHING * float(size)
        equal = [
            base for worth, base in self.alternatives if math.isclose(worth, self.worth, rel_tol=0.0, abs_tol=near)
        ]
        away = [np.abs(base - self.base) for base in equal]
        if not away:
            return ""
        units = np.array(self.places[0].evaluation.base_units)
        lengths = list[str]()
        for unit in dict.fromkeys(units.tolist()):
            far = np.linalg.norm(np.array(away)[:, units == unit], axis=1).round(4)
            least, most = f"{far.min():.3g}", f"{far.max():.3g}"
            lengths.append(f"{least} {unit}" if least == most else f"{least} to {most} {unit}")
        found = f"{counted(len(away), 'other placement')} found {'is' if len(away) == 1 else 'are'} as good"
        alike = f"{found}, to {NOTHING:g} of the objective's scale, {' and '.join(lengths)} from this one"
        return f"a choice among equals: {alike}"

    @property
    def status(self) -> str:
        """A sentence."""
        return self._found("placement for" if self.base.size else "posture at each of")

    def to_dict(self) -> Document:
        """JSON-ready dictionary.

        Example:
            >>> stand.to_dict()["converged"]
            True
        """
        others = [
            {"worth": worth, "base": base, "posture": posture}
            for (worth, base), posture in zip(self.alternatives, self.alternative_postures, strict=True)
        ]
        own = {"base": self.base, "worth": self.worth, "alternatives": others}
        own |= {"missed_chance": self.missed_chance, "missed_chance_at_most": self.missed_chance_at_most}
        return self._document(self.status, own, "targets")

    def __repr__(self) -> str:
        e = self.places[0].evaluation
        placed = zip(e.base_coordinates, self.base, e.base_units, strict=True)
        base = ", ".join(f"{name} = {x:z.4f} {unit}" for name, x, unit in placed)
        held = [resting(problem, place.evaluation.z) for problem, place in zip(self.problems, self.places, strict=True)]
        shared = {name: None for name in held[0] if name.startswith("base.")}
        rests = [f"  the placement rests on {', '.join(shared)}"] if shared else []
        for k, names in enumerate(held, start=1):
            own = ", ".join(name for name in names if name not in shared)
            rests += [f"  target {k} rests on {own}"] if own else []
        what = f"{self._targets} from {base}" if base else self._targets
        return "\n".join([*self._lines(what, self.status), *rests])


# What helps where a way breaks something between its targets.
BETWEEN_TARGETS = "limits and constraints are kept at the targets alone: more of them on the way keep them there, too"


@dataclass(frozen=True)
class FixedPlacement:
    """The best that a base can do that stands still while the end-point goes along its path of K targets.

    The joints keep their rates.

    Attributes:
        base: the placement (n_b,), m or rad.
        posture: actuated joints at each target (K, n), rad or m.
        V: the objective at each, (K,).
    """

    base: Vector
    posture: Vector
    V: Vector

    @staticmethod
    def of(n_base: int, zs: list[Vector], values: Vector) -> FixedPlacement:
        """From configurations [base, posture]."""
        return FixedPlacement(zs[0][:n_base], np.array([z[n_base:] for z in zs]), values)


@dataclass(frozen=True)
class BasePlan(Pictured, ConfigurationSet):
    """A motion of base and arm along a path of targets that keeps the worst V as high as possible.

    Its picture: the machine at every target; over time V, moving and standing still, and the placement.

    See `ConfigurationSet`.

    Attributes:
        time: when each target is due, (K,), s.
        still: the best single placement, or the given start; None where it does not reach all targets. It may be better
            by 1e-4 of the objective's scale: among ways that are as good to within that the one is taken on which base
            and joints together move least, Σ |Δz|² in scaled variables.
        between: the smallest V between the targets, where base and end-point move along straight lines, and the time
            at which it is met;  −∞ where the end-point cannot be kept on its line, or V is no number.
        broken_between: what of limits and constraints, which hold at the targets, is broken at 63 points of each of
            these lines, in words, with the most that is found beside the worst of them; none where nothing is seen to
            be. A target on such a line keeps them there, too.
        travelled: length of the base's way, m, (first in the plane of the ground), and its turning, rad.

    Example:
        >>> bool(plan.V.min() >= plan.still.V.min())
        True
    """

    time: Vector
    still: FixedPlacement | None
    between: tuple[float, float]
    broken_between: tuple[str, ...]
    travelled: tuple[float, float]

    @property
    def worth(self) -> float:
        """What the worst target has."""
        return float(self.V[self.worst])

    @property
    def standing(self) -> float:
        """The worst V of the base that stands still, −∞ where none reaches all targets at the joints' rates."""
        return -np.inf if self.still is None else float(self.still.V.min())

    @property
    def base(self) -> Vector:
        """Placements (K, n_b), m or rad."""
        return np.array([place.evaluation.base for place in self.places])

    @property
    def posture(self) -> Vector:
        """Actuated joints (K, n), rad or m."""
        return np.array([place.evaluation.posture for place in self.places])

    @property
    def base_path(self) -> Path:
        """The base's motion as `flexopt.simulate` takes it."""
        return _path(self.time, self.base)

    @property
    def target_path(self) -> Path:
        """The end-point's motion as `flexopt.simulate` takes it."""
        return _path(self.time, np.array([place.target for place in self.places]))

    @property
    def remarks(self) -> tuple[str, ...]:
        """As of `ConfigurationSet`, and what is broken between the targets."""
        helps = (BETWEEN_TARGETS,) if self.broken_between else ()
        return (*super().remarks, *self.broken_between, *helps)

    @property
    def status(self) -> str:
        """A sentence."""
        return self._found("way along")

    @property
    def _ways(self) -> str:
        """The worst of the way beside standing still, and between its targets."""
        still = (
            "no placement reaches them all at these rates"
            if self.still is None
            else f"{self.standing:.4e} standing still"
        )
        if self.still is not None and self.worth < self.standing:
            still += (
                f"; both count as best to {KEPT:g} of the objective's scale: base and joints together move least so"
            )
        return f"worst V {self.worth:.4e} ({still}); between the targets at least {self.between[0]:.4e}"

    def to_dict(self) -> Document:
        """JSON-ready dictionary.

        Example:
            >>> plan.to_dict()["converged"]
            True
        """
        own = {"time": self.time, "base": self.base, "posture": self.posture, "V": self.V, "worth": self.worth}
        own |= {"standing": self.standing, "still": self.still and vars(self.still)}
        own |= {"between": {"V": self.between[0], "time": self.between[1], "breaks": self.broken_between}}
        own |= {"travelled": {"m": self.travelled[0], "rad": self.travelled[1]}}
        return self._document(self.status, own, "path")

    def __repr__(self) -> str:
        lines = [
            *self._lines(f"a way of the base along {self._targets} in {self.time[-1]:.4g} s", self.status),
            f"  {self._ways}",
            f"  the base travels {self.travelled[0]:.4g} m and turns {self.travelled[1]:.4g} rad",
        ]
        return "\n".join(lines)


SHOWN = 12


def _numbered(targets: list[int]) -> str:
    return f"target{'s' * (len(targets) > 1)} {listed(map(str, targets))}"


def _path(time: Vector, points: Vector) -> Path:
    return Path.model_validate({"times": time.tolist(), "points": tuple(points.tolist())})
