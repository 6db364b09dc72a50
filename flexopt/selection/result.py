"""What a selection returns: verified local optima, ranked, and how they were found."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexopt.errors import FlexoptError
from flexopt.foundation.arrays import Document, Mask, Vector
from flexopt.foundation.boundary import Bundle
from flexopt.foundation.documents import json_ready
from flexopt.foundation.pictures import Pictured
from flexopt.foundation.plain import counted
from flexopt.foundation.results import Result, Tabled
from flexopt.foundation.rounding import way
from flexopt.foundation.turns import TURN
from flexopt.model.beyond_limits import beyond_limits_told
from flexopt.model.configuration import Configuration
from flexopt.robustness.evaluation import Evaluation, unreached
from flexopt.selection.broken import beyond_bounds, beyond_own, broken, cornerless
from flexopt.selection.chances import Attempt, chance, chance_at_most, chance_told, found_how_often
from flexopt.selection.columns import column_heads, in_columns, measures_in_columns, shown_measures, units_told
from flexopt.selection.constraint_values import ConstraintValue, nearest_told, resting_told
from flexopt.selection.continua import way_to
from flexopt.selection.exchanged import at_edge
from flexopt.selection.problem import TIE_TOLERANCE, SelectionProblem, elsewhere, value_at

SHOWN = 12
# Below this share of what others have an ε_max that nobody asked for is told of.
THIN = 0.5
# What is no gain, as a share of the objective's scale.
NOTHING = 1e-4
# So far beside the best, rad or m of each joint, a mode is looked at that its optimum may hide.
BESIDE = 0.1


@dataclass(frozen=True)
class Candidate(Bundle, Tabled):
    """A local optimum that passed the independent checks; calls about one posture take it as a configuration.

    Attributes:
        configuration: machine, placement, posture, control, weight and loop for which it was chosen.
        z: [base, posture], (n_z,), m or rad.
        w: the measures w_i there, (m,).
        objective: V of the first objective, the cost of travel taken off.
        active: names of the bounds and constraints that it rests against.
        constraints: every constraint besides the target, by name.
        target_error: |r − target|, m.
        stationarity: norm of the objective's gradient along the feasible directions, relative to the problem's
            objective scale, in scaled variables.
        iterations: of IPOPT, or of the ascent that went on from there.
        kinks: where V has a kink at the candidate (a_i = 0 or b_i = 0, or eigenvalues of XZ that meet), the multiplier
            that proves it (Clarke's generalised gradient holds 0), as a share of the largest one allowed: at most 1.
        unsurpassed: whether V is 0 to rounding where no configuration has more: w_i ≤ 0 for two task rows and more.
        continuum: further placements (n_b,) found at which the same posture is the same optimum, as those of a machine
            in space that may be turned about its target: nothing changes on the way to them; see
            `flexopt.selection.continua`.
        dimension: of the set of optima as good that the candidate belongs to: 0 where it stands alone, 1 of a machine
            that may be turned about its target; None where that is not known, see
            `flexopt.selection.proof.check.Proof`.
        extent: of a connected set that several points were found of, the least and the greatest of every variable among
            them.
        representatives: some of these points, (n_z,) each, far apart. The candidate is the one of the set where the
            worst of the w_i that V leaves out is largest, or ε_max where V leaves none out.

    Example:
        >>> best = flexopt.select(flexopt.load("excavator"), (0.0, 1.6), starts=8).best
        >>> bool(best.target_error < 1e-9)
        True
    """

    configuration: Configuration
    z: Vector
    w: Vector
    objective: float
    active: tuple[str, ...]
    constraints: dict[str, ConstraintValue]
    target_error: float
    stationarity: float
    iterations: int
    kinks: dict[str, float]
    unsurpassed: bool
    evaluate: Callable[[], Evaluation] = field(repr=False, compare=False)
    continuum: tuple[tuple[float, ...], ...] = ()
    dimension: int | None = None
    extent: dict[str, tuple[float, float]] = field(default_factory=dict[str, tuple[float, float]])
    representatives: tuple[tuple[float, ...], ...] = ()

    def __repr__(self) -> str:
        z, w = (", ".join(f"{x:.{digits}g}" for x in values) for values, digits in ((self.z, 6), (self.w, 4)))
        return f"Candidate(objective {self.objective:.5g} at z = [{z}], w = [{w}])"

    def _units(self, outer: str) -> Iterator[tuple[str, str]]:
        return self.evaluation._units(outer)  # pyright: ignore[reportPrivateUsage]

    @property
    def arguments(self) -> Mapping[str, Any]:
        """The arguments of a call about this configuration, by name."""
        return self.configuration.arguments

    @property
    def evaluation(self) -> Evaluation:
        """Every measure there; computed when first asked for."""
        # The turn first, the property's own lock inside it.
        with TURN:
            return self._evaluation

    @cached_property
    def _evaluation(self) -> Evaluation:
        return self.evaluate()

    def to_dict(self) -> Document:
        """The evaluation's dictionary with the candidate's own keys.

        Example:
            >>> best.to_dict()["base_coordinates"]
            ['x']
        """
        own = {
            f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("configuration", "z", "w", "evaluate")
        }
        return self.evaluation.to_dict() | json_ready(own)


@dataclass(frozen=True)
class Kept:
    """An objective that the next ones keep: its name, the best V found, and what V must be at least.

    Of what shall be small, `"settling"` and `"swing"`, what it may be at most. A bound that is none is infinite (JSON:
    null). `unverified`: as of `Selection`;  `unit`: of the numbers, empty where they have none.
    """

    objective: str
    best: float
    at_least: float
    at_most: float = math.inf
    unverified: float | None = None
    unit: str = ""

    def __str__(self) -> str:
        told = unverified_told(self.objective, self.unverified)
        further, unit = f"; {told}" if told else "", self.unit and f" {self.unit}"
        if math.isfinite(self.at_most):
            above = f"{self.at_most - self.best:.1e} above its best"
            return f"{self.objective} kept: at most {self.at_most:.6g}{unit}, {above}{further}"
        below = f"{self.best - self.at_least:.1e} below its best"
        return f"{self.objective} kept: at least {self.at_least:.6g}{unit}, {below}{further}"


def unverified_told(objective: str, value: float | None) -> str:
    """A sentence on a climb that came further than the best; empty where there is none."""
    if value is None:
        return ""
    came = f"a climb that could not be verified came to {objective} {value:.6g}"
    return f"{came}; more starts may settle it"


@dataclass(frozen=True)
class Selection(Pictured, Result):
    """The answer to a configuration problem.

    Its picture: the machine in the chosen and the initial posture beside w along the redundancy, dotted where a
    configuration breaks a constraint.

    Attributes:
        best: the first of the candidates.
        candidates: all distinct local optima found, one of each continuum, ranked by objective; of several in order by
            the last, as all of them keep those before. Ties within 1e-9 of |a||b| go by the earlier objectives, then by
            the worst of the other w_i, then by ε_max, then by the distance from the present base if one was given.
        initial: the present configuration; where no posture was given one that reaches the target from the present
            base, if there is one.
        attempts: every start and its outcome.
        kept: of objectives in order, what those before the last keep.
        problem: what was solved.
        unverified: the best V of a climb that broke no constraint but could not be verified where it ended, where that
            is better than the best candidate's; else None. Of several objectives in order that of the last.
        climbed: points besides the starts from which surfaces V = 0 were climbed along, that bring optima of their own.

    Example:
        >>> selection = flexopt.select(flexopt.load("excavator"), (0.0, 1.6), base=0.0, starts=8)
        >>> len(selection.candidates) > 1
        True
        >>> selection.best.z.shape  # base, boom, stick
        (3,)
    """

    DOCUMENT = (
        "status converged best edges decided_by nothing_to_gain left_out beyond_limits candidates initial attempts "
        "missed_chance missed_chance_at_most unverified kept objective_unit problem provenance"
    )

    best: Candidate
    candidates: tuple[Candidate, ...]
    initial: Evaluation | None
    attempts: tuple[Attempt, ...]
    kept: tuple[Kept, ...]
    problem: SelectionProblem
    provenance: Document = field(repr=False)
    unverified: float | None = None
    climbed: int = field(default=0, repr=False)

    @property
    def converged(self) -> bool:
        """True: a selection that did not converge raises `NoSolutionFound` instead."""
        return True

    @property
    def measure(self) -> str | None:
        """Which of `flexopt.Outcome` was sought, where the objective is one of the loop; else None."""
        return None

    @property
    def objective(self) -> str:
        """Names of what was maximised, in order."""
        if self.measure is None:
            return self.problem.name
        return ",".join((*(before.objective for before in self.kept), self.measure))

    @property
    def status(self) -> str:
        """A sentence."""
        wide = sum(bool(candidate.continuum) for candidate in self.candidates)
        continua = f" ({wide} of them at several placements alike)" if wide else ""
        optima = counted(len(self.candidates), "distinct local optimum", "distinct local optima")
        more = f" and from {self.climbed} more points along surfaces {self.objective} = 0" if self.climbed else ""
        return f"{optima}{continua} verified from {counted(len(self.attempts), 'start')}{more}"

    @property
    def missed_chance(self) -> float | None:
        """Estimated chance that one more start would end at an optimum of a value that none has ended at.

        Of n starts that ended at an optimum, as many values as were found once, divided by n (Good and Turing; I. J.
        Good, Biometrika 40, 1953): what another draw would show that those before did not. Starts are spread, and those
        of further rounds lie about what was found; they are not drawn independently, and what is missed may be worse.
        So it tells whether more starts are worth their time, and no more. None where no start ended at an optimum, of a
        choice by the loop, whose climbs to the end are chosen among others, and of one degree of redundancy that was
        seen whole: there `flexopt.certify` proves what is best.
        """
        return chance(self._found_how_often)

    @property
    def missed_chance_at_most(self) -> float | None:
        """What that chance itself is no larger than, with a confidence of 95 %; None where the estimate is.

        (f₁ + z²/2 + z √(f₁ + 2 f₂ + z²/4)) / n, at most 1, of n starts that ended at an optimum, f₁ values found once
        and f₂ found twice; z = 1.645. Of independent draws the estimate is wrong by √(f₁ + 2 f₂) / n or so (W. W. Esty,
        Annals of Statistics 11, 1983). Here, as in Wilson's bound of a share, n times the chance itself stands for f₁,
        whose mean it is: so it holds for few starts, too, where that error may come out as 0. Eight starts that found
        four values twice each leave 78 % open.
        """
        return chance_at_most(self._found_how_often)

    @property
    def _found_how_often(self) -> NDArray[np.integer[Any]]:
        return found_how_often(self.problem, self.attempts)

    def broken_along_redundancy(self) -> Mask:
        """Which points of `problem.scan` break a constraint, (N,); all keep limits and the singularity margin.

        Example:
            >>> bool(selection.broken_along_redundancy().any())  # none was asked for
            False
        """
        return ~self.problem.scan.feasible

    @property
    def edges(self) -> tuple[str, ...]:
        """A sentence for every two modes whose frequencies meet at the best: V jumps where they exchange numbers."""
        return tuple(at_edge(self.problem, self.best.z, self.best.w))

    @property
    def decided_by(self) -> str:
        """A sentence on what chose the best among those whose objective is as good; empty where it stands alone.

        In order: the worst of the w_i that the objectives leave out, ε_max, the way there from the present
        configuration, or from zeros: Σ |Δz|² in scaled variables, told as the drive and the largest move of a joint.
        """
        best = self.best
        if best.dimension == 0 and not any(self._as_good(other) for other in self.candidates[1:]):
            return ""
        used = np.any([objective.uses for objective in self.problem.sought], axis=0)
        told = list[str]()
        if not used.all():
            shown = shown_measures(self.problem, best.evaluation)
            told.append(f"worst of the other w_i {shown[~used].min():.6g}")
        if best.evaluation.epsilon_max is not None and not any(o.has_kinks for o in self.problem.sought):
            told.append(f"ε_max {best.evaluation.epsilon_max:.6g}")
        told.append(way_there(self.problem, best))
        alone = not any(self._as_good(other) for other in self.candidates[1:])
        among = "the configurations of its set of optima" if alone else "those as good"
        return f"among {among}, in this order: {', '.join(told)}"

    def _as_good(self, other: Candidate) -> bool:
        """Whether another candidate has as much of every objective as the best."""
        sizes = self.problem.objective_scales[self.problem.bounding :]
        pairs = zip(self._values(other), self._values(self.best), sizes, strict=True)
        return all(value >= most - TIE_TOLERANCE * size for value, most, size in pairs)

    def _values(self, candidate: Candidate) -> list[float]:
        """What a candidate has of each objective."""
        later = self.problem.sought[1:]
        return [candidate.objective, *(value_at(self.problem, candidate.z, objective) for objective in later)]

    @property
    def objective_unit(self) -> str:
        """Of `Candidate.objective`; empty where it has none."""
        return self.problem.sought[0].unit(self.problem.control, self.problem.machine.joint_units)

    @property
    def nothing_to_gain(self) -> str:
        """A sentence where the present configuration is as good as the best, to 1e-4 of the scale, or better."""
        problem, now = self.problem, self.initial
        if now is None or len(problem.sought) > 1 or not self._present_keeps_all:
            return ""
        short = self.best.objective - value_at(problem, now.z)
        if short > NOTHING * problem.objective_scale:
            return ""
        if short < -NOTHING * problem.objective_scale:
            more = f"{-short:.3g} more {problem.name} than what is chosen"
            return f"the present configuration has {more}: where climbs from it end could not be verified"
        return f"nothing to gain: the present configuration has as much {problem.name}, to {NOTHING:g} of its scale"

    @property
    def _present_keeps_all(self) -> bool:
        """Whether there is a present configuration that reaches the target and breaks nothing."""
        problem, now = self.problem, self.initial
        if now is None:
            return False
        inside = bool(np.all((now.z >= problem.lower) & (now.z <= problem.upper)))
        away = np.concatenate([np.abs(beyond_bounds(problem, now.z)), beyond_own(problem, now.z)])
        return inside and bool(away.max() <= NOTHING)

    @property
    def present_told(self) -> str:
        """What is to be known of the present configuration: where it is, that no posture was given, what it breaks."""
        e = self.initial
        if e is None:
            return ""
        away = elsewhere(self.problem, e.z)
        if not away and self.problem.present_posture is None:
            away = "one of the postures that reach the target from there: none was given"
        return "; ".join(filter(None, (away, broken(self.problem, e.z))))

    @property
    def left_out(self) -> str:
        """A sentence where ε_max was not sought and another candidate has more than twice as much; else empty."""
        margins = [candidate.evaluation.epsilon_max or 0.0 for candidate in self.candidates[:SHOWN]]
        most = max(margins)
        if any(o.has_kinks for o in self.problem.sought) or self.best.evaluation.epsilon_max is None:
            return ""
        if margins[0] >= most * THIN:
            return ""
        return (
            f"the objective leaves ε_max out: {margins[0]:.4g} at the best, {most:.4g} at candidate "
            f"{margins.index(most) + 1}"
        )

    @property
    def unmoved(self) -> str:
        """A sentence where the end-point moves in none of the modes that are weighed, here and beside; else empty."""
        problem, weighed = self.problem, np.array(self.problem.objective.alpha) > 0
        by_modes = weighed.any() and not problem.objective.has_kinks and problem.objective.own is None
        if len(problem.sought) > 1 or not by_modes:
            return ""
        beside = self.best.z + np.where(np.arange(self.best.z.size) < len(self.best.evaluation.base), 0.0, BESIDE)
        known = [candidate.evaluation for candidate in self.candidates[:SHOWN]]
        known += [] if self.initial is None else [self.initial]
        if not all(unreached(e.scale)[weighed].all() for e in known):
            return ""
        try:
            seen = not unreached(problem.quantities.evaluated(beside).scale)[weighed].all()
        except FlexoptError:  # as where that posture is singular
            seen = True
        if seen:
            return ""
        return (
            f"in none of these does the end-point move in what {problem.name} weighs, which is 0 wherever the machine "
            "stands: another objective tells places apart"
        )

    @property
    def constraints_told(self) -> tuple[str, ...]:
        """A sentence on those asked for at the best: of each kind that nearest to its bound; none where none was."""
        told = nearest_told(self.problem.asked, [self.best.constraints], cornerless(self.problem))
        return (told,) if told else ()

    @property
    def beyond_limits(self) -> tuple[str, ...]:
        """A sentence for each candidate that holds joints beyond the limits of the machine's file, left out here."""
        each = ((f"candidate {k}", [own.evaluation.posture]) for k, own in enumerate(self.candidates, start=1))
        told = (beyond_limits_told(self.problem.machine, where, postures) for where, postures in each)
        return tuple(filter(None, told))

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on the choice: what it leaves out, by what it was decided, what it gains."""
        unverified = unverified_told(self.problem.objective.name, self.unverified)
        sag = self.best.evaluation.sag_told
        said = (unverified, *self.edges, self.decided_by, self.left_out, self.unmoved, self.nothing_to_gain, sag)
        said = (*said, *self.beyond_limits[:SHOWN])
        return tuple(sentence for sentence in said if sentence)

    @property
    def _apart(self) -> tuple[tuple[str, int], ...]:
        """Head and width of the objective's own column; none where a w_i or ε_max is sought, or several in order."""
        problem, told = self.problem, (*(f"w{i + 1}" for i in range(self.best.w.size)), "epsilon_max")
        if len(problem.sought) > 1 or (problem.name in told and problem.travel is None):
            return ()
        head = "V" if problem.name in told else problem.name
        head += "" if problem.travel is None else " − travel"
        return ((head, max(13, len(head) + 2)),)

    def _objective_in_column(self, value: float) -> str:
        shown = value if abs(value) > TIE_TOLERANCE * self.problem.objective_scale else 0.0
        return "".join(f"{shown:{width}.4e}" for _, width in self._apart)

    def __repr__(self) -> str:
        best = self.best.evaluation
        problem, at_corners = self.problem, cornerless(self.problem)
        heads = "".join(f"{head:>{width}}" for head, width in self._apart)
        heads += "".join(f"{f'w{i + 1}':>13}" for i in range(best.w.size))
        lines = [
            f"{best.machine}: end-point at ({', '.join(f'{x:g}' for x in problem.target)}) m, "
            f"Jacobian {best.control} control, objective {problem.name}: {self.status}",
            *column_heads("  rank", best, heads + f"{'ε_max':>10}"),
        ]
        for rank, candidate in enumerate(self.candidates[:SHOWN], start=1):
            e = candidate.evaluation
            numbers = in_columns(e)
            resting = resting_told(candidate.active, at_corners)
            active = f"   rests on {', '.join(resting)}" if resting else ""
            alike = f"   and {counted(len(candidate.continuum), 'placement')} alike" if candidate.continuum else ""
            wide = f"   one of a set of dimension {candidate.dimension}" if (candidate.dimension or 0) > 1 else ""
            value = self._objective_in_column(candidate.objective)
            lines.append(f"  {rank:4d} {numbers}{value}{measures_in_columns(problem, e)}{active}{wide}{alike}")
        if len(self.candidates) > SHOWN:
            lines.append(f"   ... {len(self.candidates) - SHOWN} more")
        if self.initial is not None:
            e = self.initial
            off = self.present_told
            value = self._objective_in_column(value_at(problem, e.z)) if self._apart else ""
            lines.append(f"   now {in_columns(e)}{value}{measures_in_columns(problem, e)}{off and '   ' + off}")
        lines.append(f"  {units_told(best)}")
        lines += [f"  {sentence}" for sentence in (*self.constraints_told, *map(str, self.kept))]
        if self.best.unsurpassed and not self.kept:
            lines.append(f"  no configuration has a larger {problem.name}: 0 is the most there is")
        counts = self._found_how_often
        if counts.size and not self.best.unsurpassed:
            lines.append(f"  {chance_told(counts, len(self.attempts))}")
        lines += [f"  {sentence}" for sentence in self.remarks]
        lines += [f"  {assumption}" for assumption in problem.assumed]
        return "\n".join(lines)


def way_there(problem: SelectionProblem, best: Candidate) -> str:
    """From the present configuration, or zeros where it is not given: the base's drive, the joint that moves most."""
    e, moved = best.evaluation, np.abs(way_to(problem, best.z))
    n, told = len(e.base_coordinates), list[str]()
    for word, what, units, away, one, now in (
        ("base", "placement", e.base_units, moved[:n], np.linalg.norm, problem.present_base),
        ("joints up to", "posture", e.joint_units, moved[n:], np.max, problem.present_posture),
    ):
        parts = {unit: away[[own == unit for own in units]] for unit in dict.fromkeys(units)}
        lengths = " and ".join(f"{way(float(one(x))):.3g} {unit}" for unit, x in parts.items())
        origin = f" from zeros, as no present {what} is given" if now is None else ""
        told += [f"{word} {lengths}{origin}"] * bool(parts)
    return f"way there: {'; '.join(told)}"
