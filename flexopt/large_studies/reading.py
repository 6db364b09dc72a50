"""Chunks read again: their content compared with their checksum, their points beside them."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from flexopt.errors import Fault, InputError
from flexopt.foundation.arrays import Vector
from flexopt.large_studies.folder import StudyFolder, intact
from flexopt.large_studies.status import FLAGS, WORDS

if TYPE_CHECKING:
    import xarray as xr

ROUNDING = 1e-9
# Between which numbers a quantity lies, rounding included.
POSSIBLE = {
    "status": (0, len(WORDS) - 1), "frequency_hz": (0.0, np.inf), "scale": (0.0, np.inf), "condition": (0.999, np.inf),
    "epsilon_max": (0.0, 1.0), "disk_margin": (0.0, 2.001), "h2_norm": (0.0, np.inf), "settling": (0.0, np.inf),
    "swing": (0.0, np.inf), "finite_until": (0.0, np.inf), "settling_time": (0.0, np.inf),
}  # fmt: skip


@dataclass(frozen=True)
class StudyReader:
    """What lies in a study's folder.

    Attributes:
        folder: which.
    """

    folder: StudyFolder

    @cached_property
    def files(self) -> Mapping[int, list[Path]]:
        """Of each chunk that is there, as the folder was when it was first asked for."""
        return {number: paths for number, paths in self.folder.there().items() if number < self.folder.study.chunks}

    @property
    def numbers(self) -> list[int]:
        """Chunks that are there."""
        return sorted(self.files)

    @cached_property
    def shapes(self) -> dict[str, tuple[str, ...]]:
        """Dimensions of each quantity before those of the points."""
        return self.folder.work.shapes

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Lengths of these dimensions."""
        with self._file(self.numbers[0]) as file:
            return {name: size for name, size in file.dimensions.items() if size is not None}

    @property
    def bytes_in_all(self) -> int:
        """Of all files."""
        return sum(paths[0].stat().st_size for paths in self.files.values())

    def arrays(self, number: int) -> dict[str, NDArray[Any]]:
        """The variables of a chunk, points last.

        Raises:
            InputError: its file is gone, truncated or altered.
        """
        start, stop = self.folder.points.span(number)
        with self._file(number) as file:
            found = {name: _native(variable[:]) for name, variable in file.variables.items()}
        if found.keys() - {"reason"} != {*self.shapes, "status"} or any(
            not array.shape
            or array.shape[0 if name == "reason" else -1] != stop - start
            or not self._possible(name, array)
            for name, array in found.items()
        ):
            raise self._altered(number, "holds what its study does not compute")
        return found

    def _possible(self, name: str, array: NDArray[Any]) -> bool:
        """Whether all numbers are such as the quantity has; NaN where a point has none."""
        if array.dtype.kind not in "SfiU" or (array.dtype.kind in "SU") != (name == "reason"):
            return False
        # w = a·b − |a||b| of two and more task rows.
        signed = name == "w" and len(self.folder.study.loaded_machine.task_rows) > 1
        low, high = (-np.inf, ROUNDING) if signed else POSSIBLE.get(name, (-np.inf, np.inf))
        return name == "reason" or not np.any((array < low) | (array > high))

    def _altered(self, number: int, why: str) -> InputError:
        sentence = f"its chunk {number} {why}; run_study computes it again once its file is gone"
        path = str(self.folder.path)
        return InputError(f"study {self.folder.study.name!r} in {path!r}: {sentence}", [Fault("folder", sentence)])

    def _file(self, number: int) -> Any:
        from scipy.io import netcdf_file  # noqa: PLC0415  (loads slowly)

        content = next((found for path in self.files[number] if (found := intact(path)) is not None), None)
        try:
            return netcdf_file(io.BytesIO(content or b""), "r", mmap=False)
        except Exception:
            raise self._altered(number, "was truncated or altered") from None

    def columns(self, number: int) -> Vector:
        """What varies, (axes, N)."""
        return self.folder.points.columns(number)

    def dataset(self, number: int) -> xr.Dataset:
        """A chunk as an xarray.Dataset."""
        arrays = self.arrays(number)
        if "reason" in arrays:
            arrays["reason"] = texts(arrays["reason"])
        coordinates = dict(zip(self._axis_names, self.columns(number), strict=True))
        return self._made(arrays, coordinates)

    @property
    def _axis_names(self) -> list[str]:
        return [axis.name for axis in self.folder.points.axes]

    def _made(self, arrays: Mapping[str, Any], coordinates: Mapping[str, Any]) -> xr.Dataset:
        xr: Any = import_module("xarray")
        units = self.folder.work.units
        variables = {
            name: ((*self.shapes.get(name, ()), "point"), array, self._attributes(name, units))
            for name, array in arrays.items()
        }
        axes = {axis.name: axis.unit or "1" for axis in self.folder.points.axes}
        known = {name: ("point", values, {"units": axes[name]}) for name, values in coordinates.items()}
        about = {"study": self.folder.study.name, "sha256": self.folder.digest}
        named = {"mode": np.arange(1, self.sizes["mode"] + 1)} if "mode" in self.sizes else {}
        machine = self.folder.study.loaded_machine
        lists = {"joint": list(machine.joints), "placement": list(machine.base_coordinates)}
        named |= {name: values for name, values in lists.items() if name in self.sizes and values}
        return xr.Dataset(variables, coords=known | named, attrs=about)

    def _attributes(self, name: str, units: Mapping[str, str]) -> dict[str, Any]:
        if name == "status":
            return dict(FLAGS)
        return {"units": units[name]} if name in units else {}

    def lazy(self) -> xr.Dataset:
        """All chunks as one dataset whose arrays are read when they are asked for."""
        da: Any = import_module("dask.array")
        delayed: Any = import_module("dask").delayed
        first = self.arrays(self.numbers[0])
        spans = [self.folder.points.span(number) for number in self.numbers]

        def joined(name: str, of: Any, shape: tuple[int, ...], dtype: Any) -> Any:
            parts = [
                da.from_delayed(delayed(of)(number, name), (*shape, stop - start), dtype)
                for number, (start, stop) in zip(self.numbers, spans, strict=True)
            ]
            return da.concatenate(parts, axis=-1)

        arrays = {
            name: joined(name, self._variable, array.shape[:-1], array.dtype)
            for name, array in first.items()
            if name != "reason"
        }
        if "reason" in first:
            arrays["reason"] = joined("reason", self._variable, (), object)
        coordinates = {name: joined(name, self._coordinate, (), float) for name in self._axis_names}
        return self._made(arrays, coordinates)

    def _variable(self, number: int, name: str) -> NDArray[Any]:
        found = self.arrays(number)[name]
        return texts(found).astype(object) if name == "reason" else found

    def _coordinate(self, number: int, name: str) -> Vector:
        return self.columns(number)[self._axis_names.index(name)]


def texts(letters: NDArray[Any]) -> NDArray[Any]:
    """Words from a file's letters (N, length)."""
    return np.array([b"".join(row).rstrip(b"\0").decode(errors="ignore") for row in letters])


def _native(array: NDArray[Any]) -> NDArray[Any]:
    return array.astype(array.dtype.newbyteorder("="), copy=False) if array.dtype.kind == "f" else array
