"""What a study's folder holds: read chunk by chunk, lazily as a whole, reduced, or exported into one file."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import ArrayLike, Document, Vector
from flexopt.foundation.boundary import as_array, by, check_text, path, public, words
from flexopt.foundation.documents import provenance
from flexopt.foundation.plain import shown
from flexopt.foundation.quantities import several
from flexopt.foundation.results import Result
from flexopt.large_studies.folder import StudyFolder, open_folder, read_progress
from flexopt.large_studies.reading import StudyReader
from flexopt.large_studies.reducing import WAYS, quantiles_of, reduced
from flexopt.large_studies.status import SENTENCES

if TYPE_CHECKING:
    import xarray as xr

# Without dask so many bytes are read into memory, more are refused.
IN_MEMORY = 2**30


def _over(arguments: Arguments, field_: str, value: Any) -> Any:
    found = arguments.checked(field_, value, several, [])
    if not found or not all(isinstance(name, str) for name in found):
        arguments.note(field_, "must be names of what varies", value)
    return tuple(found)


def _shares(arguments: Arguments, field_: str, value: Any) -> Any:
    def check(given: Any) -> Vector:
        found = np.atleast_1d(as_array(given))
        if found.ndim != 1 or not found.size or not np.all((found > 0) & (found <= 1)):
            raise ValueError("must be numbers greater than 0 and at most 1")
        return found

    return arguments.checked(field_, value, check, None)


@dataclass(frozen=True)
class StudyResult(Result):
    """A study in its folder, finished or not.

    Attributes:
        folder: where it lies.
        name, compute, machine: of the study.
        points, chunks: how many there are in all.
        done: chunks that are there.
        statuses: points by what became of them, `"ok"` or why not, as far as the last run has looked.
        mended: chunks that this run found truncated or altered and computed again.
        points_per_second: of the last run, without the chunks that were there before.
        seconds_left: at that rate; None where there is none.

    Example:
        >>> result = flexopt.run_study(study, "postures", workers=1)
        >>> found = result.reduce("w", "min", over=["stiffness"])  # the worst soil for each posture
        >>> found["w"].sizes["posture.boom"], found["w"].sizes["posture.stick"], found["w"].sizes["mode"]
        (20, 30, 3)
    """

    folder: str
    name: str
    compute: str
    machine: str
    points: int
    chunks: int
    done: int
    statuses: dict[str, int]
    points_per_second: float
    mended: tuple[int, ...]
    provenance: Document
    reader: StudyReader = field(repr=False)

    DOCUMENT = """
    folder name compute machine points chunks done complete statuses mended points_per_second seconds_left[s] provenance
    """

    @property
    def complete(self) -> bool:
        """Whether all chunks are there."""
        return self.done == self.chunks

    @property
    def seconds_left(self) -> float | None:
        """For the chunks that are not there, at the rate of the last run."""
        left = self.points * (self.chunks - self.done) / max(self.chunks, 1)
        return left / self.points_per_second if self.points_per_second else None if left else 0.0

    def __repr__(self) -> str:
        lines = [f"study {self.name!r}: {self.compute} of {self.machine!r} at {self.points} points, in {self.folder!r}"]
        left = self.seconds_left
        more = "" if self.complete or left is None else f"; {left:.0f} s left at {self.points_per_second:.4g} points/s"
        lines.append(f"  {self.done} of {self.chunks} chunks are there{more}")
        lines += [f"  {count} points: {SENTENCES[word]}" for word, count in self.statuses.items() if count]
        if self.mended:
            lines.append(f"  {len(self.mended)} chunks were truncated or altered, and were computed again")
        if not self.complete:
            lines.append("  the same `flexopt study run`, or run_study, goes on from there")
        return "\n".join(lines)

    def _whole(self, call: str) -> StudyReader:
        if not self.complete:
            sentence = f"has {self.done} of {self.chunks} chunks; run the study to its end first"
            raise_if_any(InputError, call, [Fault("folder", sentence, shown(self.folder))])
        return self.reader

    def datasets(self) -> Iterator[xr.Dataset]:
        """Chunk by chunk those that are there, in order, each an xarray.Dataset over its points; one is in memory.

        Each has the quantities, `status`, where there are any `reason`s, and what varies as coordinates of `point`.

        Example:
            >>> sum(part.sizes["point"] for part in result.datasets())
            1800
        """
        for number in self.reader.numbers:
            yield self.reader.dataset(number)

    @public()
    def dataset(self) -> xr.Dataset:
        """All points as one xarray.Dataset: lazy, its arrays of dask, where dask is installed (extra `cluster`).

        Raises:
            InputError: chunks are missing, or there is no dask and more than 1 GiB.

        Example:
            >>> result.dataset()["w"].dims
            ('mode', 'point')
        """
        reader = self._whole("dataset")
        try:
            import_module("dask.array")
        except ImportError:
            size = reader.bytes_in_all
            if size > IN_MEMORY:
                sentence = (
                    f'needs dask for {size / 2**30:.1f} GiB: pip install "flexopt[cluster]"; or go through datasets()'
                )
                raise InputError(f"dataset: {sentence}", [Fault("dataset", sentence)]) from None
            return import_module("xarray").concat(list(self.datasets()), "point", combine_attrs="drop_conflicts")
        return reader.lazy()

    @public(quantity=by(check_text), how=words(*WAYS), over=_over)
    def reduce(
        self, quantity: str, how: Literal["min", "max", "mean"], over: Sequence[str] | None = None
    ) -> xr.Dataset:
        """The least, the greatest or the mean over some of what varies, streamed: one chunk is in memory at a time.

        The worst case over a soil is `"min"` over `stiffness`; the best posture for each target `"max"` over the
        joints. Points without a number do not count; infinite ones, such as a gain without a border, do.

        Args:
            quantity: its name.
            how: `"min"`, `"max"` or `"mean"`.
            over: names of what varies; all by default. Of random and Sobol points all.

        Returns:
            A Dataset over what is left: the quantity; `points`, how many counted; of `"min"` and `"max"`, for each name
            in `over`, where that was, `at.NAME` (of equal ones the first).

        Raises:
            InputError: a name is none of the study's, chunks are missing or altered.

        Example:
            >>> best = result.reduce("w", "max")
            >>> bool(best["w"][0] > -1e-5)
            True
        """
        reader = self._whole("reduce")
        return reduced(reader, self._named("reduce", quantity), how, self._axes("reduce", over))

    @public(quantity=by(check_text), shares=_shares)
    def quantiles(self, quantity: str, shares: ArrayLike) -> xr.Dataset:
        """Exact quantiles over all points, in four passes over the chunks; memory does not grow with their number.

        The quantile of share q of n numbers is the least of them that at least q n of them do not exceed. Points
        without a number do not count, infinite ones do.

        Args:
            quantity: its name.
            shares: one or several, in (0, 1].

        Raises:
            InputError: as `reduce`.

        Example:
            >>> found = result.quantiles("w", [0.05, 0.5])
            >>> found["w"].dims
            ('quantile', 'mode')
        """
        reader = self._whole("quantiles")
        return quantiles_of(reader, self._named("quantiles", quantity), np.asarray(shares))

    @public(path=path(".nc", parent=True))
    def to_netcdf(self, path: str | os.PathLike[str]) -> None:
        """All points in one netCDF 3 file, written part by part; its dimension `point` may go on without end.

        Raises:
            InputError: chunks are missing or altered; there are more than 2³¹ − 1 points.
            WriteError: it cannot be written.

        Example:
            >>> result.to_netcdf("postures.nc")
        """
        from flexopt.large_studies.exporting import write_netcdf_parts  # noqa: PLC0415

        write_netcdf_parts(self._whole("to_netcdf"), path)

    @public(path=path(parent=True))
    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """All points in one CSV file, a line each: what varies, the quantities, `status` and `reason`, in words.

        A quantity that is called as something that varies, a selection's `base.x`, is `best.base.x` there.

        Raises:
            InputError: chunks are missing or altered.
            WriteError: it cannot be written.

        Example:
            >>> result.to_csv("postures.csv")
        """
        from flexopt.large_studies.exporting import write_csv_parts  # noqa: PLC0415

        write_csv_parts(self._whole("to_csv"), path)

    def _named(self, call: str, quantity: str) -> str:
        names = list(self.reader.shapes)
        if quantity not in names:
            fault = Fault("quantity", f"is none of the study's: {', '.join(names)}", shown(quantity))
            raise_if_any(InputError, call, [fault])
        return quantity

    def _axes(self, call: str, over: Sequence[str] | None) -> tuple[int, ...]:
        names = [axis.name for axis in self.reader.folder.points.axes]
        if over is None:
            return tuple(range(len(names)))
        faults = [
            Fault("over", f"does not vary: {', '.join(names)}", shown(name)) for name in over if name not in names
        ]
        if self.reader.folder.study.points != "grid" and not faults and set(over) != set(names):
            faults = [Fault("over", "must be all that varies: these points are no grid", shown(list(over)))]
        raise_if_any(InputError, call, faults)
        return tuple(k for k, name in enumerate(names) if name in over)


@public()
def open_study(folder: str | os.PathLike[str]) -> StudyResult:
    """A study's folder as it is now, also while it is carried out: how far it is, and what it holds.

    Args:
        folder: of `flexopt.run_study`.

    Raises:
        InputError: it is none.

    Example:
        >>> flexopt.open_study("postures").complete
        True
    """
    return result_of(open_folder(folder))


def result_of(folder: StudyFolder, *, mended: tuple[int, ...] = ()) -> StudyResult:
    """What a folder holds."""
    study, machine = folder.study, folder.study.loaded_machine
    reader = StudyReader(folder)
    told = read_progress(folder.path)
    return StudyResult(
        folder=str(folder.path), name=study.name, compute=study.compute, machine=machine.name, points=study.total,
        chunks=study.chunks, done=len(reader.numbers), statuses={**told.points},
        points_per_second=told.points_per_second, mended=mended,
        provenance=provenance(machine, study=folder.digest, made_by=dict(folder.made_by)), reader=reader,
    )  # fmt: skip
