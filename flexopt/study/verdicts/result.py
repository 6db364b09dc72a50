"""What a verdict says: the word, the rule, each place beside the others, as numbers and as text."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from flexopt.foundation.arrays import Document, Vector
from flexopt.foundation.boundary import path, public
from flexopt.foundation.pictures import Pictured
from flexopt.foundation.plain import listed
from flexopt.foundation.printing import Printed
from flexopt.foundation.results import Result
from flexopt.foundation.writing import write_file
from flexopt.loop.loop_motions import falling
from flexopt.loop.settings import CHOSEN, LoopSettings
from flexopt.loop.standard_move import MOVE
from flexopt.model import AnyMachine
from flexopt.model.uncertainty import Uncertainty, parameters_of
from flexopt.robustness.evaluation import in_words
from flexopt.selection.broken import broken
from flexopt.selection.outcomes.result import ChosenByLoop
from flexopt.selection.problem import elsewhere, reached
from flexopt.selection.result import unverified_told
from flexopt.study.verdicts.decision import LEAST_TOLD, RULE, Word, spoken
from flexopt.study.verdicts.drawbacks import drawbacks_of
from flexopt.study.verdicts.place_loops import Chosen, chosen_gains, found_in, problems_of, repeated
from flexopt.study.verdicts.place_verdict import PlaceVerdict
from flexopt.study.verdicts.places import (
    FALLS,
    FIRST,
    NEW_GAINS,
    NO_GAIN,
    NO_GAIN_LOOKED_AT,
    STAY,
    TOLD,
    allowed,
    gains_in_words,
    told,
)
from flexopt.study.verdicts.remarks import on_places, on_the_loop

if TYPE_CHECKING:
    from flexopt.plotting.bands import Bands
    from flexopt.selection import SelectionProblem

GROUND_ASSUMED = (
    "assumed (uncertainty): all springs may be half or twice as stiff, and all else is as the machine's file has it, "
    "for no [[uncertainty]] is given"
)
# Why a place is told of that is none of the best, if it is not the selection's first.
MOST_OFTEN = "decays faster than the present place on the most grounds"
# And of one to which the word does not send.
THOUGH_IT_BREAKS = "decays faster than the present place on many grounds, but breaks constraints"


@dataclass(frozen=True)
class Verdict(Pictured, Printed, Result):
    """Whether it pays to move.

    Attributes:
        word: `"move"`, `"stay"`, `"change gains"` or `"cannot tell"`;  sentence: it, with where to and why.
        place: which place it speaks of;  reason: why.
        drawbacks: what is worse by a tenth or more where it sends the machine, or with the gains to change to, than
            where it stands with the present ones, in the worst case, what it breaks as every place found does, and what
            the way of a plan does between its targets, in words; empty where nothing is.
        passed_over: where it sends the machine: of the nearest place with less to drive that is better than staying on
            some grounds, or where there is no staying of any, why it does not send it there, where gains are to be
            changed why not with others, either; where it stays with others, a faster place with its own; else empty.
        gains_kept: where gains are not to be changed, though others were tried: what these do at best, and by what of
            the rule that is not enough, unless the reason says it; else empty.
        measure: which uncertain number decides, a sentence, where the word is "cannot tell"; else empty.
        gains: those to change to;  with_gains: `place` with these, judged as the places are with the present ones; None
            where none are to be changed;  new_settings: `settings` with these gains, or None.
        rule: by which the word was found.
        places: the present one first, then the best of the candidates, candidate 1 where it is none of these, and where
            none of all these is better than staying on more than 5 % of the grounds, one that is, if there is any, and
            those of `exclusions` of which the sentence says that they are;
            table: a row of numbers for each;  judged: how many candidates were looked at.
        settings: of the loop, the same in every place.
        uncertainty: intervals by name;  members: how many points of them were looked at;  proven: False: bands are what
            was found among these points, and by a search from the slowest ones.
        selection: the problem's answer;  targets: (K, n_task), m.
        assumed: what the problem leaves open and the choice assumes, a sentence for each.
        present_end_point: where staying holds the end-point at each target, (K, n_task), m; None where no posture
            reaches them from there.  present_off: how far from its target, of several the farthest, m, or None: what
            is more than a centimetre off is told in words, too, and the numbers of staying are those beside the target.
        present_breaks: which constraints that were asked for staying does not keep, "breaks …"; empty where it keeps
            them.
        exclusions: by name of candidates to which the word does not send, and `"stay"` where that is no choice, for
            they break constraints, by what their loops do, on some ground or at rest beside their targets, and another
            place does not, or the present one as it stands (`present_breaks`): what each of them breaks, at the worst
            of the corners looked at, "breaks …".
        assumes_ground: whether nobody said what is uncertain, so that `uncertainty` is the usual one of springs.
        name: of the problem's file, or empty.

    Example:
        >>> len(answer.places) == len(answer.table)
        True
    """

    word: Word
    place: str
    reason: str
    measure: str
    gains: dict[str, list[float]]
    places: tuple[PlaceVerdict, ...]
    settings: LoopSettings
    uncertainty: tuple[Uncertainty, ...]
    members: int
    judged: int
    selection: Chosen = field(repr=False)
    provenance: Document = field(repr=False)
    present_breaks: str = ""
    exclusions: dict[str, str] = field(default_factory=dict[str, str])
    assumes_ground: bool = False
    passed_over: str = ""
    gains_kept: str = ""
    name: str = ""
    with_gains: PlaceVerdict | None = None

    DOCUMENT = """
    word sentence place reason drawbacks passed_over gains_kept measure gains new_settings rule targets[m]
    present_end_point[m] present_off[m] present_breaks places with_gains assumed
    settings uncertainty=_uncertainty members judged excluded exclusions proven provenance
    """

    @property
    def rule(self) -> str:
        """See the class."""
        return RULE

    @property
    def drawbacks(self) -> str:
        """See the class."""
        return drawbacks_of(self)

    @property
    def problems(self) -> tuple[SelectionProblem, ...]:
        """The configuration problem of each target."""
        return problems_of(self.selection)

    @property
    def targets(self) -> Vector:
        """See the class."""
        return np.array([problem.target for problem in self.problems])

    @property
    def present_end_point(self) -> Vector | None:
        """See the class."""
        stay = self.stay
        if stay is None:
            return None
        pairs = zip(self.problems, stay.stands, strict=True)
        return np.array([reached(problem, np.concatenate(stand)) for problem, stand in pairs])

    @property
    def present_off(self) -> float | None:
        """See the class."""
        points = self.present_end_point
        return None if points is None else float(np.linalg.norm(points - self.targets, axis=1).max())

    @property
    def present_told(self) -> str:
        """Where the present posture of one target is off it, and what it breaks, unasked, too; empty where neither."""
        problem, several = self.problems[0], len(self.problems) > 1
        if self.stay is None or several:
            return self.present_breaks
        z = np.concatenate(next(iter(self.stay.stands)))
        # What stands behind the constraints that were asked for is the loop's.
        of_loop = self.present_breaks.removeprefix(broken(problem, z, asked=True)).removeprefix("; ")
        return "; ".join(filter(None, (elsewhere(problem, z), broken(problem, z), of_loop)))

    @property
    def advice(self) -> str:
        """The word, and where to or to which gains."""
        gains = gains_in_words(self.gains, self.settings.gain_units)
        where = {"move": f" to {self.place}", "change gains": f" to {gains}, at {spoken(self.place)}"}.get(
            self.word, ""
        )
        return f"{self.word}{where}"

    @property
    def sentence(self) -> str:
        """See the class."""
        return f"{self.advice}: {self.reason}"

    @property
    def table(self) -> list[Document]:
        """See the class: name, drive (m), slowest decay (1/s), least allowed gain and delay margin (s), longest
        settling (s) and largest turn (rad) over the uncertainty, share of nonlinear runs that converge.
        """  # noqa: D205
        return [
            {
                "place": place.name,
                "drive": place.drive,
                "decay": place.decay.least,
                "allowed_gain": place.allowed_gain.least,
                "delay_margin": place.delay_margin.least,
                "settling": place.settling.greatest,
                "turn": place.swing.greatest,
                "converging": math.nan if place.runs is None else place.runs.converging,
            }
            for place in self.places
        ]

    @property
    def rows(self) -> list[PlaceVerdict]:
        """The places, and that with the gains to change to by the name of new gains."""
        return [*self.places, *([replace(self.with_gains, name=NEW_GAINS)] if self.with_gains else [])]

    @property
    def over(self) -> str:
        """What is uncertain, and how much of it was looked at, a sentence."""
        known = ", ".join(_interval(each, self.problems[0].machine) for each in self.uncertainty)
        several = f"; the worst of {len(self.problems)} targets" if len(self.problems) > 1 else ""
        runs = "" if any(place.runs for place in self.places) else "; no nonlinear run was made"
        return f"uncertain: {known}; {self.members} members and a search, not a proof{several}{runs}"

    @property
    def excluded(self) -> tuple[str, ...]:
        """Names of the `exclusions`."""
        return tuple(self.exclusions)

    @property
    def left_out(self) -> str:
        """Which candidates are not told of, and why, a sentence; empty where all are."""
        alike = [f"{name} differs from {first} in its gains alone" for name, first in repeated(self.selection).items()]
        return "; ".join(filter(None, (self._judged_told, *alike)))

    @property
    def _judged_told(self) -> str:
        """How many places were judged, and which of them are told of; empty where all are."""
        names = [place.name for place in self.places if place.name != STAY]
        if len(names) == self.judged:
            return ""
        whys = dict.fromkeys(self.exclusions, THOUGH_IT_BREAKS)
        whys[FIRST] = f"comes first by {self.selection.objective}"
        excluded = [name for name in self.excluded if name != STAY]
        kept = self.judged - len(excluded)
        first = min(TOLD, kept or self.judged)
        more = [f", and {name}, which {whys.get(name, MOST_OFTEN)}" for name in names[first:]]
        found = found_in(self.selection)
        of_all = f" of {found}" if found > self.judged else ""
        shown = f"the {TOLD} that are stable on the most grounds and, of these, decay fastest in the worst case found"
        if excluded and kept:
            keep = "those that keep the constraints"
            shown = keep if kept <= TOLD else f"of {keep} {shown}"
        breaks = [f"{name} {self.exclusions[name]}" for name in excluded if name not in names]
        told = "".join(f"; {each}" for each in breaks[:TOLD])
        more_break = f"{len(breaks) - TOLD} more break{'s' * (len(breaks) == TOLD + 1)} some"
        told += f"; and {more_break}" if len(breaks) > TOLD else ""
        return f"{self.judged}{of_all} candidates were judged; shown are {shown}{''.join(more)}{told}"

    @property
    def sought_by(self) -> str:
        """By what places were sought, where that knows no controller, a sentence; empty where it does."""
        if isinstance(self.selection, ChosenByLoop):
            return ""
        objective = self.selection.objective
        return (
            f"places were sought by {objective}, which knows no controller; objective decay asks for what this one does"
        )

    @property
    def unverified(self) -> str:
        """That a climb came further than the best of the choice, a sentence; empty where none did."""
        return unverified_told(self.selection.objective, self.selection.unverified)

    @property
    def controller(self) -> str:
        """The loop in words, with its gains."""
        return repr(self.settings).splitlines()[0]

    @property
    def handed_on(self) -> str:
        """Which gains follow from the posture or were chosen, and how other calls are given them; empty of none."""
        gains, settings = chosen_gains(self.selection), self.settings
        chosen = [name for name in gains if settings.sources.get(name) == CHOSEN]
        given = {name: [gain] for name, gain in gains.items() if name not in chosen}
        of_posture, told = settings.of_posture, list[str]()
        if given:
            own = gains_in_words(given, settings.gain_units)
            told.append(f"{FIRST} was chosen with {own}; places are compared with the gains that the loop has now")
        if chosen:
            told.append(f"{_gains(chosen)} {'were' if len(chosen) > 1 else 'was'} chosen with {FIRST}")
        if of_posture:
            where = f"{'the present place' if self.stay else FIRST}{' at target 1' * (len(self.problems) > 1)}"
            follow, others = ("follow", "others") if len(of_posture) > 1 else ("follows", "another")
            told.append(f"{_gains(of_posture)} {follow} from the posture of {where} and would be {others} elsewhere")
        if kept := [*chosen, *of_posture]:
            present = " as now" * bool(self.gains)
            told.append(f"to keep {'them' if len(kept) > 1 else 'it'}{present}: {settings.in_calls}")
        return "; ".join(told)

    @property
    def new_settings(self) -> LoopSettings | None:
        """See the class."""
        return self.settings.with_rows(self.gains) if self.gains else None

    @property
    def to_change(self) -> str:
        """How other calls are given the loop with the new gains; empty where none are to be changed."""
        return "" if self.new_settings is None else f"the loop with the new gains: {self.new_settings.in_calls}"

    @property
    def proven(self) -> bool:
        """See the class."""
        return False

    @property
    def bands(self) -> list[Bands]:
        """Decay, settling, allowed gain, delay margin and base swing of every place, as `plot` draws them."""
        from flexopt.study.verdicts.page import bands_of  # noqa: PLC0415  (matplotlib is slow to import)

        return bands_of(self)

    @property
    def heading(self) -> str:
        """The problem, or where it has no name the machine, and the word."""
        where = f" to {self.place}" if self.word == "move" else ""
        return f"{self.name or self.problems[0].machine.name}: {self.word}{where}"

    @public(path=path(".html"))
    def to_html(self, path: str | os.PathLike[str]) -> None:
        """Write a page that needs no other file: a box with the word, the bands, the table, the rule.

        Args:
            path: file to write, `.html`.

        Raises:
            WriteError: the file cannot be written.

        Example:
            >>> answer.to_html("verdict.html")
        """
        write_file(path, self._html())

    def _html(self) -> str:
        from flexopt.study.verdicts.page import verdict_html  # noqa: PLC0415

        return verdict_html(self)

    @property
    def taken(self) -> str:
        """In which posture staying is judged, where the problem does not say; empty where it does."""
        many, given = len(self.problems) > 1, self.problems[0].present_posture is not None
        if self.stay is None:
            return ""
        if many:
            # No one posture is how the arm is held.
            why = "the one that was given is not used" if given else "how the arm is held was not given"
            which = "break the least at each target and are best of these" if self.present_breaks else "are best"
            at = "" if self.present_breaks else " at each target"
            return f"the postures that {which} by {self.selection.objective}{at}: {why}"
        if given:
            return ""
        now = getattr(self.selection, "initial", None)
        other = now is not None and np.abs(now.posture - self.stay.posture).max() > LEAST_TOLD
        # See `held_now`.
        why = ", another than the choice's present one, which breaks constraints" if other else ""
        return f"a posture that reaches the target{why}: how the arm is held was not given"

    @property
    def stay(self) -> PlaceVerdict | None:
        """The present place; None where there is no staying."""
        return next((place for place in self.places if place.name == STAY), None)

    def _where(self, place: PlaceVerdict) -> str:
        machine, many = self.problems[0].machine, len(self.problems) > 1
        stands = [
            (
                in_words(machine.base_coordinates, base, machine.base_units) or "base fixed",
                in_words(machine.joints, posture, machine.joint_units),
            )
            for base, posture in place.stands
        ]
        why = f" ({self.taken})" if place.name == STAY and self.taken else ""
        first, held = stands[0]
        if not many:
            off = f" ({self.present_told})" if place.name == STAY and self.present_told else ""
            return f"{first}; {held}{why}{off}"
        lines = [f"{first}{why}"]
        if place.name == STAY and self.present_breaks:
            lines[0] += f" ({self.present_breaks})"
        for k, (placed, held) in enumerate(stands):
            moved = f"{placed}; " if k and placed != stands[k - 1][0] else ""
            slowest = " (the slowest)" if k == place.slowest_target else ""
            lines.append(f"    target {k + 1}: {moved}{held}{slowest}")
        return "\n".join(lines)

    @property
    def no_gain(self) -> str:
        """What an allowed gain that is none says, a sentence; empty where every row has one."""
        if all(place.allowed_gain.least != 0 for place in self.rows):
            return ""
        return f"{NO_GAIN}: on some ground it {NO_GAIN_LOOKED_AT}"

    @property
    def lower_gains(self) -> str:
        """What an allowed gain says of places that grow on some ground, a sentence; empty where none has one."""
        own = [place.name for place in self.rows if place.decay.least <= 0 < place.allowed_gain.least < math.inf]
        if not own:
            return ""
        return (
            f"allowed Kp of {listed(map(spoken, own))}: with the present gains it grows on some ground, and there the "
            "number is the largest lower Kp with which it decays; the least of all grounds is told, and with that, or "
            "a lower one, it may grow on another"
        )

    @property
    def assumed(self) -> list[str]:
        """See the class."""
        return [*map(str, self.problems[0].assumed), *filter(None, [self.assumed_ground])]

    @property
    def assumed_ground(self) -> str:
        """What is taken to be uncertain where nothing is said of it, a sentence; else empty."""
        return GROUND_ASSUMED if self.assumes_ground else ""

    @property
    def _uncertainty(self) -> list[dict[str, Any]]:
        return [each.model_dump(exclude_none=True) for each in self.uncertainty]

    def __repr__(self) -> str:
        unit = self.settings.gain_units[0]
        wide = max(15, len(unit) + 13)
        bends = "" if self.problems[0].gravity else ", without what the moved weight bends"
        lines = [
            f"{self.problems[0].machine.name}: {self.controller}",
            *self.settings.proposed,
            *([f"  {self.handed_on}"] if self.handed_on else []),
            f"  {self.over}",
            f"  drive of the base to the place; settling, and swing of the base, of a move by {MOVE:g} m{bends};",
            "  decay with the file's numbers, then the worst of everything:",
            f"  {'place':12} {'drive':>8} {'decay, slowest':>26} {'allowed Kp':>{wide}} {'delay margin':>13} "
            f"{'settling':>10} {'swing':>11}   nonlinear runs",
        ]
        highest, least = self.settings.highest_kp, falling(self.settings.rate)
        rows = self.rows
        lines += [_row(place, least, allowed(place.allowed_gain.least, unit, highest), wide) for place in rows]
        lines += [f"  {sentence}" for sentence in (self.left_out, self.sought_by, self.unverified) if sentence]
        grows = any(place.decay.least <= 0 for place in rows)
        late = any(math.isnan(place.settling.greatest) and place.decay.least > 0 for place in rows)
        lines += [f"  {each}" for each in (self.no_gain, self.lower_gains) if each]
        if grows or late:
            whys = ["there is none, for on some ground it grows"] * grows
            whys += ["where it decays on all, on some it does not settle in a minute"] * (grows and late)
            whys += ["on some ground it does not settle in a minute"] * (late and not grows)
            lines.append(f"  –: {'; '.join(whys)}")
        lines += [f"  {place.name}: {self._where(place)}" for place in self.places]
        lines += [f"  {sentence}" for sentence in (*on_places(self), *on_the_loop(self), *self.assumed)]
        lines.append(f"verdict: {self.sentence.replace(self.word, self.word.upper(), 1)}")
        said = (self.drawbacks, self.passed_over, self.gains_kept, self.measure, self.to_change)
        return "\n".join([*lines, *filter(None, said)])


def _gains(names: Sequence[str]) -> str:
    """Gains by their names, within a sentence."""
    return f"the gain{'s' * (len(names) > 1)} {listed(names)}"


def _interval(each: Uncertainty, machine: AnyMachine) -> str:
    if each.factor:
        return f"{each.name} times {each.factor[0]:g} to {each.factor[1]:g}"
    low, high = each.value or (0.0, 0.0)
    units = {machine.parameters[k].unit for k in parameters_of(each.of, machine)} or {"s"}
    return f"{each.name} {low:g} to {high:g} {' or '.join(sorted(units))}".rstrip()


def _row(place: PlaceVerdict, least: float, gain: str, wide: int) -> str:
    """The line of a place; up to the decay `least` it falls."""
    drive = "" if place.name == STAY else "–" if math.isnan(place.drive) else f"{place.drive:.2f} m"
    both = (place.decay.nominal, place.decay.least)
    rates = ", ".join(f"{x:+.4g}" for x in both if not x <= least)
    decay = ", ".join([*([f"{rates}/s"] if rates else []), *(FALLS for x in both if x <= least)])
    return (
        f"  {place.name:12} {drive:>8} {decay:>26} {gain:>{wide}} "
        f"{told(place.delay_margin.least, 1e3, ' ms'):>13} {told(place.settling.greatest, 1, ' s'):>10} "
        f"{told(place.swing.greatest, 1e3, ' m' + place.swing_unit):>11}   {place.shown_runs}"
    )
