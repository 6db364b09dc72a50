"""Saved results beside each other: evaluations, selections, verdicts, runs of the closed loop, reports.

In: JSON documents, as `--json` prints and `--out` writes them. Out: a `Comparison`, as table, document and picture.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arrays import Document
from flexopt.foundation.documents import provenance
from flexopt.foundation.doubt import with_doubt
from flexopt.foundation.plain import shown
from flexopt.foundation.reading import read_bounded
from flexopt.foundation.results import Result
from flexopt.foundation.rounding import without_rounding
from flexopt.loop.loop_motions import NOWHERE_HELD, falling
from flexopt.loop.standard_move import MOVE
from flexopt.model.loop import GAINS
from flexopt.model.simulation import SimulationOptions
from flexopt.robustness.residues import residue_unit
from flexopt.study.verdicts.places import FALLS, FIRST, NO_GAIN, NO_GAIN_LOOKED_AT, STAY

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from flexopt.plotting.bands import Bands


class SavedQuantity(NamedTuple):
    """A quantity of a saved document, by keys with dots.

    `key`: where its value is;  `error`: where its error is;  `scale`: where that is whose rounding is 0;  `more`:
    whether more of it is better, None where neither is;  `turned`: whether it is shown with the other sign;
    `control`: where that is which says the unit of w_i. Of a list every entry is a quantity, numbered, or with names
    and units from the lists at `names` and `units`; of a number its unit is at `units`, or the first of a list there.
    `zero`: the word of a number that is 0 where there is none;  `rate`: where the rate of samples is of a decay that
    may stand for what falls.
    """

    key: str
    label: str
    unit: str = ""
    error: str = ""
    more: bool | None = None
    turned: bool = False
    names: str = ""
    units: str = ""
    scale: str = ""
    control: str = ""
    zero: str = ""
    rate: str = ""


# Of a file, and digits of a whole number: the largest double has 309.
BYTES_MAX, DIGITS_MAX = 250_000_000, 308
POSTURE = (
    SavedQuantity("base", "base", names="base_coordinates", units="base_units"),
    SavedQuantity("posture", "", names="joints", units="joint_units"),
    SavedQuantity("w", "w", more=True, scale="scale", control="control"),
    SavedQuantity("epsilon_max", "ε_max", error="epsilon_max_error", more=True),
    SavedQuantity("frequencies_hz", "frequency", "Hz"),
    SavedQuantity("condition", "condition of Jv", more=False),
    SavedQuantity("outcome.decay", "decay of the loop", "1/s", more=True, rate="outcome.settings.rate"),
    SavedQuantity("outcome.allowed_gain", "allowed Kp", more=True, units="outcome.settings.gain_units", zero=NO_GAIN),
    SavedQuantity("outcome.delay_margin", "delay margin", "s", more=True),
    SavedQuantity("outcome.sensitivity_peak", "peak of the sensitivity", more=False),
    SavedQuantity("outcome.settling", "settling time", "s", more=False),
    SavedQuantity("outcome.swing", "base swing, for each m", more=False, units="outcome.swing_unit"),
)
RUN = (
    SavedQuantity("verdict", "verdict"),
    SavedQuantity(
        "growth_rate", "decay of the base in the run", "1/s", error="growth_rate_error", more=True, turned=True
    ),
    SavedQuantity("linear_growth_rate", "decay of the linear loop", "1/s", more=True, turned=True),
    SavedQuantity("settling_time", "settling time", "s", more=False),
    SavedQuantity("overshoot", "overshoot", more=False),
    SavedQuantity("end_error", "end-point off at the end", "m", more=False),
    SavedQuantity("peak_base_rotation", "largest rotation of the base", "rad", more=False),
    SavedQuantity("duration", "duration", "s"),
)


def within(prefix: str, quantities: Sequence[SavedQuantity]) -> tuple[SavedQuantity, ...]:
    """These quantities of a document inside another."""
    keys = ("key", "error", "names", "units", "scale", "control", "rate")
    moved = [{key: f"{prefix}.{getattr(each, key)}" for key in keys if getattr(each, key)} for each in quantities]
    return tuple(each._replace(**keys) for each, keys in zip(quantities, moved, strict=True))


CHOICE = (
    SavedQuantity("status", "status"),
    SavedQuantity("best.objective", "objective", more=True, units="objective_unit", scale="problem.objective_scale"),
    *within("best", POSTURE),
)
# Of a place that a verdict tells of the worst over what is uncertain, as in its table.
PLACE = (
    SavedQuantity("drive", "drive", "m", more=False),
    SavedQuantity("decay.least", "slowest decay", "1/s", more=True, rate="settings.rate"),
    SavedQuantity("allowed_gain.least", "least allowed Kp", more=True, units="gain_units", zero=NO_GAIN),
    SavedQuantity("delay_margin.least", "least delay margin", "s", more=True),
    SavedQuantity("settling.greatest", "longest settling time", "s", more=False),
    SavedQuantity("swing.greatest", f"largest base swing, move of {MOVE:g} m", more=False, units="swing_units"),
)


def _of_place(key: str, label: str, quantities: Sequence[SavedQuantity]) -> list[SavedQuantity]:
    """Of one place of a verdict, whose loop is the verdict's."""
    each = zip(within(key, quantities), quantities, strict=True)
    return [moved._replace(label=f"{label}: {own.label}", rate=own.rate) for moved, own in each]


VERDICT = (
    SavedQuantity("word", "word"),
    SavedQuantity("place", "place"),
    SavedQuantity("reason", "reason"),
    SavedQuantity("new_gains.kp", "new Kp", units="new_gains.unit_kp"),
    SavedQuantity("new_gains.kv", "new Kv", units="new_gains.unit_kv"),
    SavedQuantity("new_gains.ki", "new Ki", units="new_gains.unit_ki"),
    *_of_place("staying", "staying", PLACE[1:]),
    *_of_place("pointed_to", "its place", PLACE),
)
# Of a report, beside its verdict, whose place may be another.
BEST = [each._replace(label=f"{FIRST}: {each.label}".rstrip()) for each in within("selection", CHOICE[1:])]
# Kinds of documents: keys by which they are known, and their quantities.
KINDS: dict[str, tuple[tuple[str, ...], tuple[SavedQuantity, ...]]] = {
    "report": (("selection", "no_verdict"), (*within("verdict", VERDICT), *within("selection", CHOICE[:1]), *BEST)),
    "selection": (("best", "candidates"), CHOICE),
    "verdict": (("word", "places"), VERDICT),
    "run": (("growth_rate", "settling_time"), RUN),
    "evaluation": (("w", "epsilon_max"), POSTURE),
}
# Letters of a line in the table: longer words and sentences go on in the next.
LETTERS = 40
# What runs have by default whatever else they are asked; the servo gain follows from the machine.
ALWAYS: dict[str, Any] = SimulationOptions.model_construct().model_dump(mode="json")
ALWAYS["actuator"].pop("servo_gain")


@dataclass(frozen=True)
class ComparedRow(Result):
    """One quantity in every result: values are numbers, words, or None where there is none or no border.

    `zero`: the word of a number that is 0 where there is none;  apart: whether results have it in units of their own.
    """

    label: str
    unit: str
    values: tuple[float | str | None, ...]
    errors: tuple[float | None, ...]
    more: bool | None
    zero: str = ""
    apart: bool = False

    DOCUMENT = "label unit values errors"

    def texts(self) -> list[str]:
        """The values in a table."""
        told = zip(self.values, self.errors, strict=True)
        return [self.zero if self.zero and value == 0 else _text(value, error) for value, error in told]


@dataclass(frozen=True)
class Comparison(Result):
    """Results of one kind beside each other.

    Attributes:
        kind: `"run"`, `"selection"`, …;  names: of the results.
        rows: their quantities.
        differences: what they were asked differently: (name, a text for each).
    """

    kind: str
    names: tuple[str, ...]
    rows: tuple[ComparedRow, ...]
    differences: tuple[tuple[str, tuple[str, ...]], ...]

    DOCUMENT = "kind names rows differences provenance"

    @property
    def provenance(self) -> Document:
        """The versions that compared; where each result comes from is in its own file."""
        return provenance(results=list(self.names))

    def plot(self, path: str | os.PathLike[str] | None = None, **asked: Any) -> Figure:
        """Every quantity that is a number in one unit, a ring for each result; `asked`: as of the `plot` of results."""
        from flexopt.plotting.bands import plot_comparison  # noqa: PLC0415  (matplotlib is slow to import)

        return plot_comparison(self, path, **asked)

    @property
    def bands(self) -> list[Bands]:
        """Of every quantity that is a number, in one unit."""
        return [each for each in map(self._bands, self.rows) if each is not None]

    @property
    def heading(self) -> str:
        """What is compared, and whether more of it is in the table."""
        compared = f"{self.kind}s: {', '.join(self.names)}"[:80]
        return compared + "; what has units of its own is in the table" * any(row.apart for row in self.rows)

    def _bands(self, row: ComparedRow) -> Bands | None:
        from flexopt.plotting import bands  # noqa: PLC0415

        numbers = [math.nan if not isinstance(value, float) else value for value in row.values]
        # What has several units stands on no one axis.
        if row.apart or all(map(math.isnan, numbers)):
            return None
        errors = [error or 0.0 for error in row.errors]
        told = zip(self.names, numbers, errors, row.texts(), strict=True)
        rows = tuple(bands.Row(name, value - error, value, value + error, text) for name, value, error, text in told)
        return bands.Bands(row.label, row.unit or "1", row.more, rows, self.names[0], "", heading="")

    def __repr__(self) -> str:
        lines = [("what it was asked", *self.names)] if self.differences else []
        lines += [(name, *texts) for name, texts in self.differences]
        lines += [(self.kind, *self.names), *((_named(row), *row.texts()) for row in self.rows)]
        cells = [[[name], *(wrap(text, LETTERS) or [""] for text in texts)] for name, *texts in lines]
        widths = [max(len(part) for line in cells for part in line[k]) for k in range(len(self.names) + 1)]
        rows = [list(zip_longest(*line, fillvalue="")) for line in cells]
        blocks = [
            ["  ".join(text.ljust(width) for text, width in zip(parts, widths, strict=True)).rstrip() for parts in row]
            for row in rows
        ]
        if self.differences:
            blocks.insert(len(self.differences) + 1, [""])
        told = [line for block in blocks for line in block]
        if any(value is None for row in self.rows for value in row.values):
            told.append("–: there is none, or no border was met")
        if any(NO_GAIN in row.texts() for row in self.rows if row.zero):
            told.append(f"{NO_GAIN}: the loop {NO_GAIN_LOOKED_AT}")
        if any(FALLS in row.values for row in self.rows):
            told.append(f"{FALLS}: {NOWHERE_HELD}")
        return "\n".join(told)


def compare_saved(paths: Sequence[str]) -> Comparison:
    """Results from files beside each other.

    Raises:
        InputError: fewer than two files, files that hold no result, or results of different kinds.
    """
    if len(paths) < 2:
        raise InputError("compare: needs two files or more, JSON documents of results")
    faults, read = list[Fault](), list[tuple[str, dict[str, Any]]]()
    for path in paths:
        try:
            document = json.loads(read_bounded(Path(path), BYTES_MAX), parse_int=_whole)
        except OSError as error:
            faults.append(Fault(path, f"cannot be read ({error.strerror or error})"))
        except (ValueError, RecursionError):
            faults.append(Fault(path, "is no JSON document; --json prints one, and --out FILE.json writes one"))
        else:
            kind = _kind(document)
            read.append((kind, document if kind else {}))
            if not kind:
                faults.append(Fault(path, f"holds no {', '.join(KINDS)} of flexopt"))
    raise_if_any(InputError, "compare", faults)
    kinds = [kind for kind, _ in read]
    if len(set(kinds)) > 1:
        told = ", ".join(f"{shown(path)}: {kind}" for path, kind in zip(paths, kinds, strict=True))
        raise InputError(f"compare: needs results of one kind, not {told}")
    stems = [Path(path).stem for path in paths]
    names = stems if len(set(stems)) == len(stems) else list(paths)
    if len(set(names)) < len(names):
        names = [f"{k}: {name}" for k, name in enumerate(names, start=1)]
    documents = [_with_places(document) for _, document in read]
    rows = [row for quantity in KINDS[kinds[0]][1] for row in _rows(quantity, documents)]
    return Comparison(kinds[0], tuple(names), tuple(rows), tuple(_differences(documents)))


def _whole(digits: str) -> int:
    """A whole number that is a double, too."""
    if len(digits) > DIGITS_MAX:
        raise ValueError("a number too large")
    return int(digits)


def _kind(document: Any) -> str:
    """What a document is of; empty where it is none."""
    keys = set(cast(Mapping[str, Any], document)) if isinstance(document, dict) else set[str]()
    return next((kind for kind, (marks, _) in KINDS.items() if keys >= set(marks)), "")


def _with_places(document: dict[str, Any]) -> dict[str, Any]:
    """A verdict's document, or a report's, with the places that are compared: the present and that it speaks of.

    The latter with the gains to change to, where it says so.
    """
    inner = document.get("verdict")
    if isinstance(inner, dict):
        return document | {"verdict": _with_places(cast(dict[str, Any], inner))}
    listed, added = _listed(document, "places"), dict[str, Any]()
    tables = [cast(dict[str, Any], place) for place in listed if isinstance(place, dict)]
    named = {str(place.get("name")): place for place in tables}
    gains, changed = _listed(document, "settings.gain_units"), document.get("with_gains")
    compared = {"staying": named.get(STAY), "pointed_to": named.get(str(document.get("place")))}
    if isinstance(changed, dict):
        compared["pointed_to"] = cast(dict[str, Any], changed)
        new = {name: _single(_at(document, f"gains.{name}")) for name in GAINS}
        added["new_gains"] = new | {f"unit_{name}": unit for name, unit in zip(GAINS, gains, strict=False)}
    elif document.get("place") == STAY:
        compared["pointed_to"] = None
    for key, place in compared.items():
        if place is not None:
            added[key] = place | {"gain_units": gains, "swing_units": [place.get("swing_unit")]}
    return document | added


def _at(document: Any, path: str) -> Any:
    """What stands at keys with dots; None where nothing does."""
    found = document if path else None
    for key in path.split("."):
        found = cast(dict[str, Any], found).get(key) if isinstance(found, dict) else None
    return found


def _rows(quantity: SavedQuantity, documents: Sequence[Any]) -> list[ComparedRow]:
    """A row, or of lists one for each entry; none where no document has it."""
    values = [_at(document, quantity.key) for document in documents]
    if quantity.turned:
        values = [None if number is None else -number for number in map(_number, values)]
    if quantity.rate:
        values = [_or_falls(value, _at(d, quantity.rate)) for value, d in zip(values, documents, strict=True)]
    if all(value is None for value in values):
        return []
    shared, several = _units(quantity, documents), len(_each_unit(quantity, documents)) > 1
    if not any(isinstance(value, list) for value in values):
        errors = tuple(_number(_at(document, quantity.error)) for document in documents)
        own = tuple(_value(v, _at(d, quantity.scale)) for v, d in zip(values, documents, strict=True))
        return [ComparedRow(quantity.label, shared, own, errors, quantity.more, quantity.zero, several)]
    if quantity.names:
        # Entries with units of their own have rows of their own.
        shared, several = quantity.unit, False
    longest = max(len(cast(list[Any], value)) for value in values if isinstance(value, list))
    found: dict[tuple[str, str], list[float | str | None]] = {}
    for k, (document, value) in enumerate(zip(documents, values, strict=True)):
        # One number stands for that of every row.
        entries = cast(list[Any], value) if isinstance(value, list) else [value] * longest * (value is not None)
        names, units, scales = (_listed(document, key) for key in (quantity.names, quantity.units, quantity.scale))
        for i, entry in enumerate(entries):
            own = str(names[i]) if i < len(names) else str(i + 1)
            apart = " " if quantity.label and len(quantity.label.split()[-1]) > 1 else ""
            key = f"{quantity.label}{apart}{own}", str(units[i]) if i < len(units) else shared
            # Of a configuration's numbers, which have names, 1 m or rad.
            size = scales[i] if i < len(scales) else 1.0 if names else None
            found.setdefault(key, [None] * len(documents))[k] = _value(entry, size)
    none = (None,) * len(documents)
    each = found.items()
    return [ComparedRow(label, unit, tuple(row), none, quantity.more, apart=several) for (label, unit), row in each]


def _or_falls(decay: Any, rate: Any) -> Any:
    value, sampled = _number(decay), _number(rate)
    return FALLS if value is not None and sampled is not None and value <= falling(sampled) else decay


def _units(quantity: SavedQuantity, documents: Sequence[Any]) -> str:
    """The unit of a number, or of every w_i; where documents have different ones all of them."""
    found = _each_unit(quantity, documents)
    return " or ".join(unit or "no unit" for unit in found) if any(found) else quantity.unit


def _each_unit(quantity: SavedQuantity, documents: Sequence[Any]) -> list[str]:
    """The units in which documents have it, each once."""
    found = (_unit(quantity, document) for document in documents if _at(document, quantity.key) is not None)
    return list(dict.fromkeys(found))


def _unit(quantity: SavedQuantity, document: Any) -> str:
    control, joints = _at(document, quantity.control), _listed(document, _beside(quantity.control, "joint_units"))
    if isinstance(control, str) and joints:
        return residue_unit(control, tuple(map(str, joints)))
    told = _at(document, quantity.units)
    listed = cast(list[Any], told) if isinstance(told, list) else [told or ""]
    return str(listed[0]) if listed else ""


def _beside(path: str, key: str) -> str:
    """The path of another key of the same table."""
    return f"{path.rpartition('.')[0]}.{key}".lstrip(".") if path else ""


def _listed(document: Any, path: str) -> list[Any]:
    found = _at(document, path)
    return cast(list[Any], found) if isinstance(found, list) else []


def _value(value: Any, scale: Any = None) -> float | str | None:
    number, size = _number(value), _number(scale)
    if number is None:
        return None if value is None else str(value)
    return number if size is None else float(without_rounding(number, size))


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _differences(documents: Sequence[Any]) -> list[tuple[str, tuple[str, ...]]]:
    """Machine, versions, options, and of verdicts the loop and what is uncertain, that are not the same in all."""
    flat = list[dict[str, str]]()
    placed = max(1, *(len(_listed(document, "provenance.options.base")) for document in documents))
    for document in documents:
        asked: Any = document.get("provenance") or {}
        if _kind(document) == "run" and isinstance(asked, dict):
            asked = cast(dict[str, Any], asked) | {"options": _options_of_run(document, placed)}
        flat.append(dict(_leaves(asked, "")))
    for each, document in zip(flat, documents, strict=True):
        of = document.get("verdict") if isinstance(document.get("verdict"), dict) else document
        settings = _at(of, "settings") if _listed(of, "places") else None
        if isinstance(settings, dict):
            items = cast(dict[str, Any], settings).items()
            asked = {key: value for key, value in items if key != "sources"}
            # What the verdict inside of a choice takes is not what the choice was asked.
            outer = "verdict" if _kind(document) == "selection" else ""
            each.update(_leaves({"loop": asked, "uncertain": _at(of, "uncertainty")}, outer))
    found = list[tuple[str, tuple[str, ...]]]()
    for key in dict.fromkeys(key for each in flat for key in each):
        texts = tuple(each.get(key, "–") for each in flat)
        if len(set(texts)) > 1:
            found.append((key.removeprefix("options."), texts))
    return found


def _options_of_run(document: Any, placed: int) -> dict[str, Any]:
    """What a run was asked, and what it then had by default.

    One number stands for equal gains, and for a placement of one coordinate; `placed`: how many it has. Gains are those
    of the run's own loop, with their unit where they ask for rates.
    """
    found = _completed(ALWAYS, _at(document, "provenance.options"))
    if "end_point" in found:
        found.setdefault("elbow", "up")
    served, units = _at(document, "loop.drive") == "velocity", _listed(document, "loop.gain_units")
    for k, gain in enumerate(GAINS):
        value = _single(_at(document, f"loop.{gain}") if served else found.get(gain))
        unit = units[k] if served and k < len(units) and value else ""
        found[gain] = f"{json.dumps(value)} {unit}" if unit else value
    base = found.get("base") or [0.0] * placed
    found["base"] = base if placed > 1 else _single(base)
    return found


def _completed(defaults: dict[str, Any], given: Any) -> dict[str, Any]:
    """The tables one upon the other; None is what is not given."""
    asked = cast(dict[str, Any], given) if isinstance(given, dict) else {}
    found = {key: value for key, value in (defaults | asked).items() if value is not None}
    for key, value in defaults.items():
        if isinstance(value, dict):
            found[key] = _completed(cast(dict[str, Any], value), asked.get(key))
        elif asked.get(key) is None and value is not None:
            found[key] = value
    return found


def _single(value: Any) -> Any:
    """The one number that all of a list are."""
    listed = cast(list[Any], value) if isinstance(value, list) else []
    return listed[0] if listed and all(each == listed[0] for each in listed) else cast(Any, value)


def _leaves(value: Any, outer: str) -> list[tuple[str, str]]:
    """Keys with dots and texts of what stands there."""
    if isinstance(value, dict):
        items = cast(dict[str, Any], value).items()
        return [leaf for key, each in items for leaf in _leaves(each, f"{outer}.{key}" if outer else key)]
    text: str = json.dumps(value, ensure_ascii=False)
    return [(outer, text.strip('"'))]


def _named(row: ComparedRow) -> str:
    return f"{row.label}, {row.unit}" if row.unit else row.label


def _text(value: float | str | None, error: float | None) -> str:
    if value is None:
        return "–"
    if isinstance(value, str):
        return value
    return with_doubt(value, error)
