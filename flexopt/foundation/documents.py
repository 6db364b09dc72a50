"""What every JSON document shares: provenance, and plain numbers with null for what is not finite."""

from __future__ import annotations

import hashlib
import math
import os
import sys
from collections.abc import Mapping
from dataclasses import is_dataclass
from enum import Enum
from functools import cache
from pathlib import Path, PurePath
from typing import Any, cast

import numpy as np

from flexopt.foundation.arrays import Document
from flexopt.foundation.boundary import path, public
from flexopt.foundation.writing import AnyPath, write_file


def package_version(name: str) -> str:
    """Version of a package: its module's `__version__`, else what was installed; `"unknown"` where it is neither."""
    told = vars(sys.modules[name]).get("__version__") if name in sys.modules else None
    if told is not None:
        return str(told)
    # It reads archives and e-mail, which takes a fifth as long as numpy, casadi and pydantic together.
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415

    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"


@cache
def build_version() -> str:
    """Version of flexopt and the build: the first digits of the SHA-256 of all that the package consists of.

    Machines and problems lie elsewhere in a checkout, and have hashes of their own.
    """
    package, found = Path(__file__).parents[1], hashlib.sha256()
    files = {file.relative_to(package).as_posix(): file for file in package.rglob("*") if file.is_file()}
    for name, file in sorted(files.items()):
        if not {"__pycache__", "models", "problems"} & set(name.split("/")):
            found.update(name.encode() + b"\0" + file.read_bytes().replace(b"\r\n", b"\n"))
    return f"{package_version('flexopt')}+{found.hexdigest()[:12]}"


def provenance(machine: Any = None, **options: Any) -> Document:
    """Name and content hash of a machine (None where none is concerned), builds, and the options of the call."""
    return {
        "machine": machine and machine.name,
        "machine_sha256": machine and machine.content_hash,
        "flexopt": build_version(),
        "casadi": package_version("casadi"),
        "options": options,
    }


def write_netcdf(path: AnyPath, dataset: Any) -> None:
    """Write an xarray.Dataset as a netCDF 3 file, which needs nothing but SciPy to be written or read.

    Raises:
        WriteError: the file cannot be written.
    """
    write_file(path, netcdf_bytes(dataset))


def netcdf_bytes(dataset: Any) -> bytes:
    """An xarray.Dataset as the content of a netCDF 3 file; it holds no time stamp."""
    return bytes(dataset.to_netcdf(engine="scipy", format="NETCDF3_64BIT"))


def json_ready(value: Any) -> Any:
    """Plain lists, numbers and text: NaN and infinity become None, complex numbers pairs, objects their fields."""
    if isinstance(value, np.ndarray | np.generic):
        return json_ready(value.tolist())  # pyright: ignore[reportUnknownMemberType]
    if isinstance(value, Mapping):
        return {str(k): json_ready(v) for k, v in cast(Mapping[Any, Any], value).items()}
    if isinstance(value, list | tuple):
        return [json_ready(v) for v in cast(list[Any], value)]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, complex):
        return json_ready([value.real, value.imag])
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, Enum):
        return value.name.lower()
    told: Any = getattr(value, "to_dict", None)
    if told is not None:
        return json_ready(told())
    if is_dataclass(value):
        return json_ready(vars(value))
    return value


class Gridded:
    """A result that has its numbers as an xarray.Dataset, `dataset`."""

    @public(path=path(".nc"))
    def to_netcdf(self, path: str | os.PathLike[str]) -> None:
        """Write `dataset` as a netCDF 3 file, which needs nothing but SciPy to be written or read.

        Raises:
            InputError: the name does not end in `.nc`.
            WriteError: the file cannot be written.

        Example:
            >>> chart.to_netcdf("map.nc")
        """
        write_netcdf(path, cast(Any, self).dataset)
