"""A whole study as one file, written part by part: netCDF, whose dimension of points may go on, or CSV."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import numpy as np

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.documents import netcdf_bytes
from flexopt.foundation.writing import write_parts
from flexopt.large_studies.reading import StudyReader
from flexopt.large_studies.status import REASON_MAX, WORDS

# Of the number of records in the format's header.
RECORDS_MAX, PLACE = 2**31 - 1, 4


def write_netcdf_parts(reader: StudyReader, path: str | os.PathLike[str]) -> None:
    """One netCDF 3 file: its header from xarray, its records from the chunks as they are."""
    total = reader.folder.study.total
    if total > RECORDS_MAX:
        fault = Fault(
            "points", f"a netCDF 3 file holds at most {RECORDS_MAX} points; go through datasets()", str(total)
        )
        raise_if_any(InputError, "to_netcdf", [fault])
    write_parts(path, _records(reader, total))


def _records(reader: StudyReader, total: int) -> Iterator[bytes]:
    first = _by_point(reader.dataset(reader.numbers[0]))
    one = first.isel(point=slice(0, 1))
    one.encoding["unlimited_dims"] = {"point"}
    layout = _layout(one)
    head = netcdf_bytes(one)
    head = head[: len(head) - layout.itemsize]
    yield head[:PLACE] + struct.pack(">i", total) + head[PLACE + 4 :]
    for number in reader.numbers:
        part = first if number == reader.numbers[0] else _by_point(reader.dataset(number))
        records = np.zeros(part.sizes["point"], dtype=layout)
        for name in _of_points(part):
            records[name] = part[name].values
        yield records.tobytes()


def _by_point(dataset: Any) -> Any:
    """Points first, as records have them; reasons all as long."""
    if "reason" in dataset:
        dataset["reason"] = (
            "point",
            np.array([text.encode()[:REASON_MAX] for text in dataset["reason"].values], f"S{REASON_MAX}"),
        )
    return dataset.transpose("point", ...)


def _of_points(dataset: Any) -> list[str]:
    """Variables that have a value for each point, in the order of the file: xarray writes coordinates last."""
    return [name for name in (*dataset.data_vars, *dataset.coords) if "point" in dataset[name].dims]


def _layout(dataset: Any) -> np.dtype[Any]:
    """A record: each variable's values of one point, big-endian, filled up to four bytes."""
    fields: list[Any] = []
    for name in _of_points(dataset):
        array = dataset[name].values
        dtype = array.dtype.newbyteorder(">")
        fields.append((name, dtype, array.shape[1:]))
        size = dtype.itemsize * int(np.prod(array.shape[1:], dtype=int))
        if size % 4:
            fields.append((f"filling of {name}", f"V{4 - size % 4}"))
    return np.dtype(fields)


def write_csv_parts(reader: StudyReader, path: str | os.PathLike[str]) -> None:
    """One CSV file, a line for each point."""
    write_parts(path, _lines(reader))


def _lines(reader: StudyReader) -> Iterator[bytes]:
    pd: Any = import_module("pandas")  # slow to import; xarray needs it, too
    for number in reader.numbers:
        dataset = reader.dataset(number)
        columns: dict[str, Any] = {axis.name: dataset[axis.name].values for axis in reader.folder.points.axes}
        for name, dims in reader.shapes.items():
            array = dataset[name].values
            for at in np.ndindex(*array.shape[:-1]):
                labels = [str(dataset[dim].values[i]) for dim, i in zip(dims, at, strict=True)]
                column = ".".join([name, *labels])
                # A selection's answer is called as the present placement that varies.
                columns[f"best.{column}" if column in columns else column] = array[at]
        columns["status"] = np.array(WORDS)[dataset["status"].values]
        if "reason" in dataset:
            columns["reason"] = dataset["reason"].values
        yield (
            pd.DataFrame(columns).to_csv(index=False, header=number == reader.numbers[0], lineterminator="\n").encode()
        )
