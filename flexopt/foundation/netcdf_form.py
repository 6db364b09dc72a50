"""A netCDF 3 file whose layout is made once and whose numbers are filled in many times, without a copy.

In: dimensions, variables and attributes. Out: the file's bytes, and arrays that lie in them. The layout is SciPy's; a
file that is made anew by it or by xarray takes as long as the numbers themselves where these come from compiled code.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Bytes by which a variable's place is found, at most and at least.
MARK, MARK_MIN = 16, 4


class NetcdfForm:
    """A file and the arrays in it. `fits` tells whether all are long enough.

    Attributes:
        content: the file as it is now.
        arrays: by name, variables and attributes, big-endian: what is written there stands in the file.
    """

    def __init__(
        self,
        variables: Mapping[str, tuple[tuple[str, ...], tuple[int, ...], str]],
        about: Mapping[str, Mapping[str, Any]],
        texts: Mapping[str, bytes],
        numbers: Mapping[str, tuple[int, str]],
    ) -> None:
        """A file of zeros.

        Args:
            variables: by name: dimensions, shape and kind of number, as NumPy writes it.
            about: by name: the variable's attributes.
            texts: attributes of the file that stay as they are.
            numbers: those that are filled in, by name: how many, and of which kind.
        """
        marked = {name: _marked(name, shape, kind) for name, (_, shape, kind) in variables.items()}
        filled = {name: _marked(name, (count,), kind) for name, (count, kind) in numbers.items()}
        dimensions = {name: of for name, (of, _, _) in variables.items()}
        self.content = bytearray(_written(dimensions, marked, about, {**texts, **filled}))
        self.arrays: dict[str, NDArray[Any]] = {}
        for name, array in (marked | filled).items():
            place = self.content.index(array.tobytes()[:MARK])
            view = np.frombuffer(self.content, array.dtype, array.size, place).reshape(array.shape)
            view[...] = 0
            self.arrays[name] = view

    @staticmethod
    def fits(variables: Mapping[str, tuple[tuple[str, ...], tuple[int, ...], str]]) -> bool:
        """Whether every variable is long enough."""
        return all(np.prod(shape) * np.dtype(kind).itemsize >= MARK_MIN for _, shape, kind in variables.values())


def netcdf_of_arrays(
    variables: Mapping[str, tuple[tuple[str, ...], NDArray[Any]]],
    about: Mapping[str, Mapping[str, Any]],
    attributes: Mapping[str, Any],
) -> bytes:
    """The like of other arrays: of text, or short ones."""
    arrays = {name: array for name, (_, array) in variables.items()}
    return _written({name: of for name, (of, _) in variables.items()}, arrays, about, attributes)


def _marked(name: str, shape: tuple[int, ...], kind: str) -> NDArray[Any]:
    """Zeros that begin as nothing else in the file does."""
    array = np.zeros(shape, np.dtype(kind).newbyteorder(">"))
    mark, place = (
        np.frombuffer(hashlib.sha256(name.encode()).digest()[:MARK], np.uint8),
        array.reshape(-1).view(np.uint8),
    )
    place[:MARK] = mark[: place.size]
    return array


def _written(
    dimensions: Mapping[str, tuple[str, ...]],
    arrays: Mapping[str, NDArray[Any]],
    about: Mapping[str, Mapping[str, Any]],
    attributes: Mapping[str, Any],
) -> bytes:
    """A file by SciPy; it holds no time stamp."""
    from scipy.io import netcdf_file  # noqa: PLC0415  (loads slowly)

    buffer = _Kept()
    with netcdf_file(buffer, "w", version=2) as file:
        for key, value in attributes.items():
            setattr(file, key, value)
        for name, array in arrays.items():
            for dimension, size in zip(dimensions[name], array.shape, strict=True):
                if dimension not in file.dimensions:
                    file.createDimension(dimension, size)
            variable = file.createVariable(name, array.dtype.newbyteorder("="), dimensions[name])
            # Bit by bit: marks are no numbers.
            variable[:] = array
            for key, value in about.get(name, {}).items():
                setattr(variable, key, value)
    return buffer.content


class _Kept(io.BytesIO):
    """What was written into it, when it is closed."""

    content = b""

    def close(self) -> None:
        """As any file, and once."""
        if not self.closed:
            self.content = self.getvalue()
        super().close()
