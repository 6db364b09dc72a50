"""Numbers of a document by quantity name, in the form in which they are kept.

In: dictionaries of plain data, arrays, CasADi matrices. Out: one flat dictionary of numbers, truth values and lists of
numbers; text, None and empty lists are left out. Numbers have 12 significant digits. A long array is kept as its shape,
its Euclidean norm and every k-th entry.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

DIGITS = 12
# Entries of an array that is kept whole, and of the sample of a longer array.
MAX_WHOLE, SAMPLE = 40, 12
# Provenance, and text keyed by machine and version.
NEVER = frozenset({"provenance", "sources", "schema"})

Kept = dict[str, Any]


def numbers(document: Any, *, drop: Iterable[str] = ()) -> Kept:
    """Flatten a document; keys named in `drop` are left out at every depth."""
    found: Kept = {}
    _flatten(document, "", NEVER | set(drop), found)
    return found


def _flatten(value: Any, name: str, drop: frozenset[str], found: Kept) -> None:
    if isinstance(value, Mapping):
        for key, entry in value.items():
            if key not in drop:
                _flatten(entry, f"{name}.{key}" if name else str(key), drop, found)
    elif isinstance(value, bool | np.bool_):
        found[name] = bool(value)
    elif isinstance(value, str) or value is None:
        return
    elif (array := _array(value)) is not None:
        if array.size:
            found[name] = _stored(array)
    else:
        for index, entry in enumerate(value):
            _flatten(entry, f"{name}[{index}]", drop, found)


def _array(value: Any) -> np.ndarray[Any, Any] | None:
    """The array of a number or of nested lists of numbers, None as NaN; None where there is anything else inside."""
    if hasattr(value, "full"):
        value = value.full()
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        return value
    if isinstance(value, Sequence | np.ndarray) and any(isinstance(entry, Mapping | str) for entry in value):
        return None
    if isinstance(value, Sequence) and value and all(entry is None for entry in value):
        return np.zeros(0)
    try:
        complex_or_real = np.asarray(value)
        if complex_or_real.dtype.kind == "c":
            return np.stack([complex_or_real.real, complex_or_real.imag], axis=-1)
        return np.asarray(value, dtype=bool if complex_or_real.dtype.kind == "b" else float)
    except (TypeError, ValueError):
        return None


def _stored(array: np.ndarray[Any, Any]) -> Any:
    if array.dtype.kind == "b":
        return array.tolist() if array.size <= MAX_WHOLE else {"shape": list(array.shape), "true": int(array.sum())}
    if array.size <= MAX_WHOLE:
        return _rounded(array.astype(float).tolist())
    flat = array.astype(float).ravel()
    stride = -(-flat.size // SAMPLE)
    finite = flat[np.isfinite(flat)]
    return {
        "shape": list(array.shape),
        "finite": int(finite.size),
        "norm": _rounded(float(np.linalg.norm(finite))),
        "sample": _rounded(flat[::stride].tolist()),
    }


def _rounded(value: Any) -> Any:
    if isinstance(value, list):
        return [_rounded(entry) for entry in value]
    if np.isnan(value):
        return None
    if np.isinf(value):
        return "inf" if value > 0 else "-inf"
    short = float(f"{value:.{DIGITS}g}")
    return int(short) if short.is_integer() and abs(short) < 1e6 else short


def entries(value: Any) -> np.ndarray[Any, Any]:
    """The entries of a kept quantity as floats, a long array's norm and sample."""
    if isinstance(value, Mapping):
        return np.concatenate([entries(value[key]) for key in sorted(value)])
    flat: list[float] = []
    _collect(value, flat)
    return np.array(flat)


def _collect(value: Any, flat: list[float]) -> None:
    if isinstance(value, list):
        for entry in value:
            _collect(entry, flat)
    else:
        flat.append(np.nan if value is None else float(value))


def shape_of(value: Any) -> Any:
    """Shape of a kept quantity, whether it is kept whole or as a sample."""
    if isinstance(value, Mapping):
        return value["shape"], value.get("finite")
    return [len(value), *([] if not value else [shape_of(entry) for entry in value])] if isinstance(value, list) else []
