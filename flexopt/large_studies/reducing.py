"""Reductions over chunks, one in memory at a time: least, greatest, mean over some axes, and exact quantiles."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Vector
from flexopt.large_studies.reading import StudyReader
from flexopt.large_studies.status import OK

if TYPE_CHECKING:
    import xarray as xr

WAYS = ("min", "max", "mean")
# Quantiles: a double has four such parts.
PART, PARTS = 16, 4
SIGN = np.uint64(1 << 63)


def reduced(reader: StudyReader, quantity: str, how: str, over: tuple[int, ...]) -> xr.Dataset:
    """As `StudyResult.reduce`, its arguments known to be good; `over` are numbers of axes."""
    axes, grid = reader.folder.points.axes, reader.folder.study.points == "grid"
    left = [k for k in range(len(axes)) if k not in over]
    shape = tuple(axes[k].count for k in left)
    cells = int(np.prod(shape, dtype=np.int64))
    inner = tuple(reader.sizes[dim] for dim in reader.shapes[quantity])
    rows = int(np.prod(inner, dtype=np.int64))
    worst = {"min": np.inf, "max": -np.inf, "mean": 0.0}[how]
    value, counted = np.full((rows, cells), worst), np.zeros((rows, cells), dtype=np.int64)
    at = np.full((rows, cells, len(over)), np.nan)
    for number in reader.numbers:
        columns = reader.columns(number)
        start, stop = reader.folder.points.span(number)
        cell = np.zeros(stop - start, dtype=np.int64)
        if grid and left:
            places = np.unravel_index(np.arange(start, stop), [axis.count for axis in axes])
            cell = np.ravel_multi_index([places[k] for k in left], shape)
        numbers, counts = _numbers(reader, number, quantity)
        for row in range(rows):
            sound = np.flatnonzero(counts[row])
            known, of = numbers[row, sound], cell[sound]
            before = counted[row] > 0
            counted[row] += np.bincount(of, minlength=cells)
            if how == "mean":
                value[row] += np.bincount(of, known, minlength=cells)
                continue
            (np.minimum if how == "min" else np.maximum).at(best := np.full(cells, worst), of, known)
            better = (best < value[row] if how == "min" else best > value[row]) | ((counted[row] > 0) & ~before)
            first = np.flatnonzero((known == best[of]) & better[of])[::-1]
            value[row, better] = best[better]
            # Backwards, so that of equal ones the first stays.
            at[row, of[first]] = columns[:, sound[first]][list(over)].T
    with np.errstate(invalid="ignore", divide="ignore"):
        value = value / counted if how == "mean" else np.where(counted > 0, value, np.nan)
    names, units = [axes[k].name for k in left], reader.folder.work.units[quantity]
    dims = (*reader.shapes[quantity], *names)
    whole = (*inner, *shape)
    variables: dict[str, Any] = {
        quantity: (dims, value.reshape(whole), {"units": units}), "points": (dims, counted.reshape(whole)),
    }  # fmt: skip
    if how != "mean":
        for k, axis in enumerate(over):
            unit = {"units": axes[axis].unit or "1"}
            variables[f"at.{axes[axis].name}"] = (dims, at[..., k].reshape(whole), unit)
    values = reader.folder.points.grid if grid else []
    coordinates = {axes[k].name: (axes[k].name, values[k], {"units": axes[k].unit or "1"}) for k in left}
    about = {"study": reader.folder.study.name, "how": how, "over": ", ".join(axes[k].name for k in over)}
    return import_module("xarray").Dataset(variables, coords=coordinates, attrs=about)


def quantiles_of(reader: StudyReader, quantity: str, shares: Vector) -> xr.Dataset:
    """As `StudyResult.quantiles`: the bits of the number sought, 16 in each pass, highest first.

    Doubles as whole numbers in the same order; each pass counts how those that agree in the bits known so far go on.
    """
    inner = tuple(reader.sizes[dim] for dim in reader.shapes[quantity])
    rows = int(np.prod(inner, dtype=np.int64))
    prefix = np.zeros((rows, shares.size), dtype=np.uint64)
    rank = np.zeros((rows, shares.size), dtype=np.int64)
    count = np.zeros(rows, dtype=np.int64)
    for done in range(PARTS):
        shift = np.uint64(64 - PART * (done + 1))
        bins = np.zeros((rows, shares.size, 1 << PART), dtype=np.int64)
        for number in reader.numbers:
            values, counts = _numbers(reader, number, quantity)
            for row in range(rows):
                keys = _ordered(values[row, counts[row]])
                part = ((keys >> shift) & np.uint64(0xFFFF)).astype(np.int64)
                for k in range(shares.size):
                    alike = part if not done else part[keys >> (shift + np.uint64(PART)) == prefix[row, k]]
                    bins[row, k] += np.bincount(alike, minlength=1 << PART)
        if not done:
            count = bins[:, 0].sum(axis=-1)
            rank = np.maximum(np.ceil(shares * count[:, None]).astype(np.int64), 1)
        sums = bins.cumsum(axis=-1)
        chosen = np.minimum((sums < rank[..., None]).sum(axis=-1), (1 << PART) - 1)
        at = chosen[..., None]
        before = (np.take_along_axis(sums, at, -1) - np.take_along_axis(bins, at, -1))[..., 0]
        rank, prefix = rank - before, (prefix << np.uint64(PART)) | chosen.astype(np.uint64)
    found = np.where(count[:, None] > 0, _doubles(prefix), np.nan).T.reshape(shares.size, *inner)
    dims, units = ("quantile", *reader.shapes[quantity]), reader.folder.work.units[quantity]
    variables: dict[str, Any] = {
        quantity: (dims, found, {"units": units}), "points": (reader.shapes[quantity], count.reshape(inner)),
    }  # fmt: skip
    return import_module("xarray").Dataset(variables, coords={"quantile": shares})


def _numbers(reader: StudyReader, number: int, quantity: str) -> tuple[Vector, NDArray[np.bool_]]:
    """A quantity in a chunk, (rows, N), and which of it counts: all numbers, infinite ones where the point is sound."""
    arrays = reader.arrays(number)
    values: Vector = arrays[quantity].reshape(-1, arrays["status"].size)
    return values, np.isfinite(values) | (np.isinf(values) & (arrays["status"] == OK))


def _ordered(values: Vector) -> NDArray[np.uint64]:
    """Whole numbers in the order of the doubles; both zeros are one."""
    bits = (values + 0.0).view(np.uint64)
    return np.where(bits & SIGN, ~bits, bits | SIGN)


def _doubles(keys: NDArray[np.uint64]) -> Vector:
    """The doubles of `_ordered`."""
    return np.where(keys & SIGN, keys & ~SIGN, ~keys).view(np.float64)
