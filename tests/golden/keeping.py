"""Kept numbers: read, written, compared.

A case `evaluate-excavator` is kept in `kept/evaluate.json` under its own name.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tests.golden.numbers import Kept, entries, shape_of
from tests.golden.tolerances import tolerance

FOLDER = Path(__file__).parent / "kept"


class Difference(NamedTuple):
    """A quantity that differs: kept and present value where it differs most, and how many tolerances lie between."""

    quantity: str
    kept: Any
    now: Any
    ratio: float

    def __str__(self) -> str:
        return f"{self.quantity}: kept {_short(self.kept)}, now {_short(self.now)}, {self.ratio:.3g} tolerances"


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) < 60 else f"{text[:57]}..."


def _file(case: str) -> Path:
    return FOLDER / f"{case.partition('-')[0]}.json"


@cache
def _read(path: Path) -> dict[str, Kept]:
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def kept(case: str) -> Kept | None:
    """The kept numbers of a case; None where nothing is kept."""
    return _read(_file(case)).get(case)


def keep(case: str, now: Kept) -> None:
    """Write the numbers of a case beside the others of its file."""
    everything = _read(_file(case)) | {case: now}
    lines = ",\n".join(
        f'"{name}": {{\n' + ",\n".join(f" {json.dumps(key)}: {_compact(own[key])}" for key in sorted(own)) + "\n}"
        for name, own in sorted(everything.items())
    )
    _file(case).write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")
    _read.cache_clear()


def _compact(value: Any) -> str:
    return json.dumps(value, separators=(",", ":"))


def forget(existing: set[str]) -> None:
    """Remove kept cases that no call makes any more."""
    for path in FOLDER.glob("*.json"):
        left = {case: own for case, own in _read(path).items() if case in existing}
        path.unlink()
        _read.cache_clear()
        for case, own in left.items():
            keep(case, own)


def kept_cases() -> set[str]:
    """Names of all cases that are kept."""
    return {case for path in FOLDER.glob("*.json") for case in _read(path)}


def differences(case: str, now: Kept) -> list[Difference]:
    """Quantities that lie farther from what is kept than their tolerance, the farthest first."""
    before = kept(case)
    if before is None:
        return [Difference("(case)", None, "new", np.inf)]
    found = [Difference(name, before.get(name), now.get(name), np.inf) for name in sorted(before.keys() ^ now.keys())]
    for name in before.keys() & now.keys():
        found += _compared(case, name, before, now[name])
    return sorted(found, key=lambda difference: -difference.ratio)


def _compared(case: str, name: str, before: Kept, now: Any) -> list[Difference]:
    old = before[name]
    if isinstance(old, bool) or isinstance(now, bool):
        return [] if old == now else [Difference(name, old, now, np.inf)]
    if shape_of(old) != shape_of(now):
        return [Difference(name, old, now, np.inf)]
    allowed = tolerance(case, name)
    a, b = entries(old), entries(now)
    # Kept whole before and sampled now, or not finite at other places.
    if a.shape != b.shape or not np.array_equal(a[~np.isfinite(a)], b[~np.isfinite(b)], equal_nan=True):
        return [Difference(name, old, now, np.inf)]
    finite = np.isfinite(a)
    if (finite != np.isfinite(b)).any():
        return [Difference(name, old, now, np.inf)]
    a, b = a[finite], b[finite]
    if not a.size:
        return []
    reference = entries(before[_sibling(name, allowed.scale, before)]) if allowed.scale else a
    largest = np.abs(reference[np.isfinite(reference)]).max(initial=0.0)
    room = allowed.relative * np.abs(a) + allowed.of_largest * largest + allowed.absolute
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(a == b, 0.0, np.abs(a - b) / room)
    worst = int(np.argmax(ratios))
    return [Difference(name, a[worst], b[worst], float(ratios[worst]))] if ratios[worst] > 1 else []


def _sibling(name: str, scale: str, before: Kept) -> str:
    """The quantity of that name that is nearest in the document; the quantity itself where there is none."""
    parts = name.split(".")
    for depth in range(len(parts) - 1, -1, -1):
        candidate = ".".join([*parts[:depth], scale])
        if candidate in before:
            return candidate
    return name
