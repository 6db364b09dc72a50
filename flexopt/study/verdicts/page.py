"""A verdict as a page and as a picture: a box with the word, and the present place beside the others, as bands.

In: a `Verdict`. Out: figures, rows of tables, HTML. Every number is the verdict's own.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from flexopt.foundation.rendering import OfNumbers, render
from flexopt.foundation.rounding import way
from flexopt.loop.loop_motions import falling
from flexopt.loop.settings import CHOSEN
from flexopt.loop.standard_move import LONGEST, MOVE
from flexopt.selection import SelectionProblem
from flexopt.study.page import PageTable, Picture, begun, coordinate, number, picture, sentence, with_minus
from flexopt.study.verdicts.decision import BETTER, percent
from flexopt.study.verdicts.drawbacks import first_gain
from flexopt.study.verdicts.places import FALLS, NEW_GAINS, STAY, allowed, told
from flexopt.study.verdicts.remarks import on_places, on_the_loop

if TYPE_CHECKING:
    from flexopt.plotting.bands import Bands
    from flexopt.study.verdicts.place_verdict import PlaceVerdict
    from flexopt.study.verdicts.result import Verdict


class Compared(NamedTuple):
    """A measure with a band: the attribute, how it is called, its unit and how many of it are an SI unit.

    `worst`: the end of the band that is told;  `none`: what NaN means;  `highest`: up to which a border was looked for;
    `falling`: up to which it stands for what falls.
    """

    attribute: str
    label: str
    unit: str
    factor: float
    worst: str
    none: str
    highest: float = math.inf
    falling: float = -math.inf


class BoxNumber(NamedTuple):
    """A number in the box: its text, and the number itself."""

    text: str
    value: float


def measures(verdict: Verdict) -> tuple[Compared, ...]:
    """Those that every place is compared by."""
    turns = verdict.places[0].swing_unit
    gain = verdict.settings.gain_units[0]
    return (
        Compared("decay", "decay", "1/s", 1.0, "least", "", falling=falling(verdict.settings.rate)),
        Compared("settling", "settling time", "s", 1.0, "greatest", f"over {LONGEST:g} s"),
        Compared("allowed_gain", "allowed Kp", gain, 1.0, "least", "none", verdict.settings.highest_kp),
        Compared("delay_margin", "delay margin", "ms", 1e3, "least", "none"),
        Compared("swing", f"base swing, move of {MOVE:g} m", f"m{turns}", 1e3, "greatest", "grows"),
    )  # fmt: skip


def bands_of(verdict: Verdict) -> list[Bands]:
    """What the picture shows."""
    from flexopt.plotting.bands import Bands, Row  # noqa: PLC0415  (matplotlib is slow to import)

    found, kp, sent = list[Bands](), verdict.settings.kp, _sent(verdict)
    borders, own = {"decay": (0.0, "grows")}, dict[tuple[str, str], float]()
    if kp.any():
        which = "chosen" if verdict.settings.sources.get("kp") == CHOSEN else "now"
        borders["allowed_gain"] = (first_gain(kp), f"Kp {which}")
    if verdict.new_settings is not None:
        own["allowed_gain", NEW_GAINS] = first_gain(verdict.new_settings.kp)
    for m in measures(verdict):
        rows = list[Row]()
        for place in verdict.rows:
            band = getattr(place, m.attribute)
            values = (band.least, band.nominal, band.greatest)
            least, nominal, greatest = (-math.inf if x <= m.falling else m.factor * x for x in values)
            border = own.get((m.attribute, place.name))
            rows.append(Row(place.name, least, nominal, greatest, _worst(place, m).text, border))
        found.append(Bands(m.label, m.unit, m.worst == "least", tuple(rows), STAY, sent, borders.get(m.attribute)))
    return found


def _sent(verdict: Verdict) -> str:
    """The row of what the word speaks of."""
    return NEW_GAINS if verdict.with_gains else verdict.place


def judged(verdict: Verdict) -> dict[str, Any]:
    """What the template of a verdict takes."""
    return {
        "verdict": verdict,
        "head": begun(verdict.advice),
        "stay": STAY,
        "sent": _sent(verdict),
        "sends": verdict.word in ("move", "change gains"),
        "reason": sentence(verdict.reason),
        "drawbacks": sentence(verdict.drawbacks),
        "passed_over": sentence(verdict.passed_over),
        "gains_kept": sentence(verdict.gains_kept),
        "measure": sentence(verdict.measure),
        "stand": _stand(verdict),
        "numbers": _numbers(verdict),
        "before": f"{_beside(verdict)[0].name}, with the gains as they are" if verdict.with_gains else "staying",
        "bands": _pictures(verdict),
        "places": _places(verdict),
        "left_out": sentence(verdict.left_out),
        "sought_by": sentence(verdict.sought_by),
        "unverified": "",
        "no_gain": sentence(verdict.no_gain),
        "lower_gains": sentence(verdict.lower_gains),
        "taken": verdict.taken and sentence(f"staying is judged in {verdict.taken}"),
        "present": verdict.present_told and sentence(f"{STAY}: {verdict.present_told}"),
        "where": _where(verdict),
        "assumed": [sentence(verdict.assumed_ground)] if verdict.assumed_ground else [],
        "on_places": [*map(sentence, on_places(verdict))],
        "on_the_loop": [*map(sentence, on_the_loop(verdict))],
        "loop": with_minus(verdict.controller),
        "handed_on": sentence(verdict.handed_on),
        "to_change": sentence(verdict.to_change),
        "hardly_served": sentence(verdict.settings.hardly_served),
        "sources": (("number", "where it is from"), list(verdict.settings.sources.items())),
        "over": sentence(verdict.over),
    }


def verdict_html(verdict: Verdict) -> str:
    """The page of a verdict alone."""
    problems = verdict.problems
    where = target_of(problems[0]) if len(problems) == 1 else f"{len(problems)} targets"
    machine = problems[0].machine.name
    name = f"{verdict.name} ({machine})" if verdict.name not in ("", machine) else machine
    title = f"Verdict: {name}, end-point at {where}"
    # A report tells both beside its choice.
    told = judged(verdict) | {"assumed": [sentence(assumption) for assumption in verdict.assumed]}
    told |= {"unverified": sentence(verdict.unverified)}
    return render("study/templates/verdict.html", title=title, provenance=verdict.provenance, judged=told, missing="")


def target_of(problem: SelectionProblem) -> str:
    """Where the end-point is to be."""
    rows = zip(problem.machine.task_rows, problem.target, strict=True)
    return ", ".join(f"{row} = {number(x)}" for row, x in rows) + " m"


def _stand(verdict: Verdict) -> list[tuple[str, BoxNumber, str]]:
    """How the machine stands and is held where the verdict sends it: names, numbers, units."""
    place = next((place for place in verdict.places if place.name == verdict.place != STAY), None)
    if place is None:
        return []
    found, stands, names = list[tuple[str, BoxNumber, str]](), _stands(place), _names(verdict)
    same = bool(np.all(place.base == place.stands[0][0]))
    for k, (at, values) in enumerate(stands):
        first = place.base.shape[-1] if same else 0
        for i, ((name, unit), x) in enumerate(zip(names, values, strict=True)):
            placed = i < place.base.shape[-1]
            # A placement for all targets is said once.
            if not (placed and same and k):
                told = f"{at}: {name}" if at and i == first else name
                found.append((told, BoxNumber(coordinate(x), x), unit))
    return found


def _names(verdict: Verdict) -> list[tuple[str, str]]:
    """Coordinates of the base and joints, with their units."""
    machine = verdict.problems[0].machine
    joints = zip(machine.joints, machine.joint_units, strict=True)
    return [*zip(machine.base_coordinates, machine.base_units, strict=True), *joints]


def _stands(place: PlaceVerdict) -> list[tuple[str, list[float]]]:
    """Which target, of several, and the numbers of `_names` there."""
    stands = [[*base.tolist(), *posture.tolist()] for base, posture in place.stands]
    return [("" if len(stands) == 1 else f"target {k}", each) for k, each in enumerate(stands, start=1)]


def _beside(verdict: Verdict) -> list[PlaceVerdict]:
    """The present place, and the one that is told of; where that has new gains, it alone stands beside what is."""
    places = [place for place in verdict.places if place.name in (STAY, verdict.place)]
    return [*places[:1], verdict.with_gains] if verdict.with_gains else places


def _numbers(verdict: Verdict) -> list[tuple[str, list[BoxNumber]]]:
    """Names, and the worst values of the present place and of the one that is told of, with its new gains."""
    places = _beside(verdict)
    if not places:
        return []
    found = [(_title(m), [_worst(place, m) for place in places]) for m in measures(verdict)]
    moved = [place for place in places if place.name != STAY]
    if moved:
        drive = moved[0].drive
        found.insert(0, ("drive", [BoxNumber(told(way(drive), 1.0, " m"), drive)]))
    return found


def _title(m: Compared) -> str:
    words = {"decay": "slowest decay", "settling": "longest settling time"}
    return words.get(m.attribute, f"{m.worst if m.worst == 'least' else 'largest'} {m.label}")


def _worst(place: PlaceVerdict, m: Compared) -> BoxNumber:
    value = getattr(getattr(place, m.attribute), m.worst)
    if value <= m.falling:
        return BoxNumber(FALLS, value)
    unit = f" {m.unit}" if m.unit else ""
    none = "grows" if m.attribute == "settling" and place.decay.least <= 0 else m.none
    text = told(value, m.factor, unit) if math.isinf(m.highest) else allowed(value, m.unit, m.highest)
    return BoxNumber(none if math.isnan(value) else with_minus(text), value)


def _pictures(verdict: Verdict) -> list[Picture]:
    from flexopt.plotting.bands import plot_band  # noqa: PLC0415

    found = list[Picture]()
    for m, bands in zip(measures(verdict), bands_of(verdict), strict=True):
        worst = "; ".join(f"{row.name} {row.worst}" for row in bands.rows)
        draw = partial(plot_band, bands)
        found.append(picture(lambda theme, draw=draw: draw(theme=theme), f"{begun(m.label)}. Worst: {worst}."))
    return found


def _places(verdict: Verdict) -> PageTable:
    """Every place's worst over what is uncertain."""
    shown = measures(verdict)
    numbers = ("drive", *map(_title, shown), "stable on", f"{BETTER} on")
    header = ["place", *map(OfNumbers, numbers), "nonlinear runs"]
    rows = [
        [
            place.name, "" if place.name == STAY else told(way(place.drive), 1.0, " m"),
            *(_worst(place, m).text for m in shown), stable_told(place.stable_share, place.decay.least),
            "" if place.name == STAY or math.isnan(place.better) else percent(place.better), place.shown_runs,
        ]
        for place in verdict.rows
    ]  # fmt: skip
    return header, rows


def stable_told(share: float, least: float) -> str:
    """Share of the members that are stable; where a search found a ground between them that grows, of these alone."""
    return f"{percent(share)} of the members" if share == 1 and least <= 0 else percent(share)


def _where(verdict: Verdict) -> PageTable:
    """Placement and posture of each."""
    header = ["place", *(OfNumbers(f"{name}, {unit}") for name, unit in _names(verdict))]
    return header, [
        [f"{place.name}{f', {at}' if at else ''}", *map(coordinate, values)]
        for place in verdict.places
        for at, values in _stands(place)
    ]
