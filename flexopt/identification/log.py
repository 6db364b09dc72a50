"""A log as it was measured: columns by name, SI, each with the samples that it has.

In: a CSV file, a table of arrays or a data frame. Out: a `MeasuredLog`, or every fault of its header and its numbers.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Array, Vector
from flexopt.foundation.boundary import as_array, path
from flexopt.foundation.plain import shown
from flexopt.foundation.reading import read_bounded
from flexopt.identification.measured import TIME, Channel, quantities, read_header
from flexopt.model import AnyMachine

ROWS_MAX, COLUMNS_MAX, LETTERS_MAX, BYTES_MAX = 1_000_000, 100, 100, 250_000_000
# Cells that say that nothing was measured.
MISSING = {"", "nan", "na", "n/a", "null", "none", "-"}


@dataclass(frozen=True, eq=False)
class MeasuredLog:
    """Columns of one log.

    Attributes:
        time: (N,), s, ascending, each once.
        channels: what was measured.
        values: (N, c), SI; NaN where there is no sample.
        notes: what was found and mended, in sentences.
    """

    time: Vector
    channels: tuple[Channel, ...]
    values: Array
    notes: tuple[str, ...] = ()

    def of(self, *kinds: str) -> list[int]:
        """Which columns are of these kinds."""
        return [k for k, channel in enumerate(self.channels) if channel.kind in kinds]

    def part(self, rows: Any = slice(None), columns: Any = None, *notes: str) -> MeasuredLog:
        """Some rows and columns, with more said of it."""
        chosen = list(range(len(self.channels))) if columns is None else columns
        channels = tuple(self.channels[k] for k in chosen)
        return MeasuredLog(self.time[rows], channels, self.values[rows][:, chosen], (*self.notes, *notes))


def refused(sentence: str) -> InputError:
    """That nothing can be identified from a log, and why."""
    return InputError(f"identify: the log {sentence}", [Fault("log", sentence)])


class FrameLike(Protocol):
    """A data frame of any library: columns by name."""

    @property
    def columns(self) -> Any:
        """Their names."""
        ...

    def __getitem__(self, name: str, /) -> Any:
        """One of them."""
        ...


def read_log(arguments: Arguments, machine: AnyMachine, field: str, value: Any) -> MeasuredLog | None:
    """The log that a call was given; faults are noted."""
    return arguments.collect(field, lambda: _read(machine, value))


def _read(machine: AnyMachine, value: Any) -> MeasuredLog:
    if isinstance(value, str | os.PathLike):
        faults = Arguments("log")
        name: Any = path()(faults, "path", value)
        faults.done()
        columns = _from_file(Path(name))
    else:
        columns = _from_table(value)
    return _converted(columns, machine)


def _from_table(value: Any) -> list[tuple[str, Vector]]:
    """A mapping's columns, or a data frame's."""
    given: Any = cast(Any, dict(cast(Mapping[Any, Any], value))) if isinstance(value, Mapping) else value
    names: Any = given if isinstance(value, Mapping) else getattr(given, "columns", None)
    if names is None or not hasattr(given, "__getitem__"):
        sentence = "must be the path of a CSV file, a dictionary of arrays by name, or a data frame"
        raise InputError(f"log {sentence}", [Fault("columns", sentence, shown(value))])
    found, faults = list[tuple[str, Vector]](), list[Fault]()
    for name in list(names)[: COLUMNS_MAX + 1]:
        if not isinstance(name, str) or len(name) > LETTERS_MAX:
            faults.append(Fault("columns", f"must have names, text of at most {LETTERS_MAX} letters", shown(name)))
            continue
        try:
            cells: Any = given[name]
            column = as_array(cells.to_numpy() if hasattr(cells, "to_numpy") else cells)
            if column.ndim != 1 or column.size > ROWS_MAX:
                raise ValueError(f"must be a column of at most {ROWS_MAX:,} numbers")
            found.append((name, column))
        except ValueError as error:
            faults.append(Fault(shown(name), str(error)))
    raise_if_any(InputError, "log", faults)
    return found


def _from_file(file: Path) -> list[tuple[str, Vector]]:
    """The columns of a CSV file: its first line is the header, lines that begin with # are left out."""

    def refuse(sentence: str, where: str = "path") -> InputError:
        return InputError(f"{file.name}: {sentence}", [Fault(where, sentence, file.name)])

    if file.suffix.lower() in {".uff", ".unv"}:
        raise refuse("is a UFF file, which is not read: write time and channels as CSV")
    try:
        text = read_bounded(file, BYTES_MAX).decode("utf-8-sig")
    except OSError as error:
        raise refuse(f"cannot be read: {error.strerror or type(error).__name__}") from None
    except UnicodeDecodeError:
        raise refuse("is no text in UTF-8") from None
    written = enumerate(text.splitlines(), start=1)
    there = {k: line for k, line in written if line.strip() and not line.lstrip().startswith("#")}
    places, lines = list(there), list(there.values())
    if len(lines) < 2 or len(lines) > ROWS_MAX:
        raise refuse(f"must have a line of names and 1 to {ROWS_MAX:,} lines of numbers below it")
    between = max(";\t,", key=lines[0].count)
    decimal_comma = between != "," and not any("." in line for line in lines[1:])
    try:
        rows = list(csv.reader(lines, delimiter=between, strict=True))
    except csv.Error as error:
        raise refuse(f"is no CSV file: {error}") from None
    header, faults = [name.strip() for name in rows[0]], list[Fault]()
    if len(header) > COLUMNS_MAX or max(map(len, header)) > LETTERS_MAX:
        raise refuse(f"must have at most {COLUMNS_MAX} columns, named by at most {LETTERS_MAX} letters", "header")
    values = np.full((len(rows) - 1, len(header)), np.nan)
    for k, row in enumerate(rows[1:]):
        if len(row) != len(header):
            faults.append(Fault(f"line {places[k + 1]}", f"must have {len(header)} cells", str(len(row))))
            continue
        for j, cell in enumerate(row):
            word = cell.strip().replace(",", ".") if decimal_comma else cell.strip()
            if word.lower() in MISSING:
                continue
            try:
                values[k, j] = float(word)
            except ValueError:
                faults.append(Fault(f"line {places[k + 1]}, {header[j]}", "must be a number, or empty", shown(cell)))
    raise_if_any(InputError, file.name, faults)
    return list(zip(header, values.T, strict=True))


def _converted(columns: list[tuple[str, Vector]], machine: AnyMachine) -> MeasuredLog:
    """SI, in order of time; every fault of the headers at once."""
    known, faults = quantities(machine), list[Fault]()
    found: dict[str, tuple[Channel, Vector]] = {}
    for header, column in columns[:COLUMNS_MAX]:
        try:
            quantity, factor = read_header(header, known)
            if quantity.name in found:
                raise ValueError("is there twice")
            found[quantity.name] = (quantity, column * factor)
        except ValueError as error:
            faults.append(Fault(shown(header), str(error)))
    if len(columns) > COLUMNS_MAX:
        faults.append(Fault("columns", f"must be at most {COLUMNS_MAX}", "more"))
    if TIME not in found and not any(header.partition("[")[0].strip() in (TIME, "time") for header, _ in columns):
        faults.append(Fault("t", "is missing: the time of the samples, s, as a column 't [s]'"))
    lengths = {name: column.size for name, (_, column) in found.items()}
    if len(set(lengths.values())) > 1:
        faults.append(Fault("columns", "must be of one length", ", ".join(f"{k} {n}" for k, n in lengths.items())))
    faults += _out_of_order(found)
    raise_if_any(InputError, "log", faults)
    time = found.pop(TIME)[1]
    values = np.column_stack([column for _, column in found.values()]) if found else np.zeros((time.size, 0))
    keep, notes = _ordered(time)
    values = np.where(np.isfinite(values), values, np.nan)
    return MeasuredLog(time[keep], tuple(quantity for quantity, _ in found.values()), values[keep], notes)


def _out_of_order(found: dict[str, tuple[Channel, Vector]]) -> Iterator[Fault]:
    """Times that run backwards."""
    if TIME not in found:
        return
    time = found[TIME][1]
    time = time[np.isfinite(time)]
    back = np.flatnonzero(np.diff(time) < 0)
    if back.size:
        sentence = f"must not run backwards; after {time[back[0]]:g} s comes {time[back[0] + 1]:g} s"
        yield Fault("t", sentence, f"{back.size} times")
    elif np.any(np.abs(time) > 1e9):
        yield Fault("t", "must lie between -1e9 and 1e9 s; are these ns?", f"{np.abs(time).max():g}")


def _ordered(time: Vector) -> tuple[Any, tuple[str, ...]]:
    """Rows with a time of their own."""
    there = np.flatnonzero(np.isfinite(time))
    keep = there[np.diff(time[there], prepend=-np.inf) > 0]
    notes: list[str] = []
    if there.size < time.size:
        notes.append(f"{time.size - there.size} rows have no time and are left out")
    if keep.size < there.size:
        notes.append(f"{there.size - keep.size} rows repeat a time and are left out")
    return keep, tuple(notes)
