"""One chunk: computed, written with its checksum, read again; a function of the study and the chunk's number alone.

In: the folder and a number. Out: a file of netCDF, and a few words about it. Only these words go back to whoever asked.
"""

from __future__ import annotations

import contextlib
import io
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexopt.errors import FlexoptError, WriteError
from flexopt.foundation.netcdf_form import netcdf_of_arrays
from flexopt.foundation.turns import one_blas_thread
from flexopt.foundation.writing import make_folder, write_file
from flexopt.large_studies.folder import ATTRIBUTES, StudyFolder, check_alike, intact, open_folder
from flexopt.large_studies.status import REASON_MAX, WORDS

KEPT, COMPUTED, MENDED = "kept", "computed", "computed again"


class Finished(NamedTuple):
    """What is said of a chunk. Plain, so that any engine can carry it.

    Attributes:
        number: of the chunk.
        how: it was there already, was computed, or computed again since its file was truncated or altered.
        counts: points by status.
        fault: why there is no chunk, else empty.
        disk: whether that is the disk's fault.
    """

    number: int
    how: str
    counts: tuple[int, ...]
    fault: str = ""
    disk: bool = False


@lru_cache(maxsize=4)
def _opened(path: str, digest: str) -> StudyFolder:
    """A study as this process computes it, made ready once."""
    folder = open_folder(path)
    if folder.digest != digest:
        raise FlexoptError(f"{path!r} holds another study now")
    check_alike(folder)
    return folder


def finish_chunk(path: str, digest: str, number: int) -> Finished:
    """See that the chunk of that number is in the folder, whole.

    Whatever goes wrong is told, not raised: errors do not travel well between processes.
    """
    with one_blas_thread():
        try:
            return _finished(_opened(path, digest), number)
        except WriteError as error:
            return Finished(number, "", (), str(error), disk=True)
        except MemoryError:
            return Finished(number, "", (), "there is not enough memory; a smaller chunk needs less")
        except FlexoptError as error:
            return Finished(number, "", (), " ".join(str(error).split()))
        except Exception as error:
            return Finished(number, "", (), f"{type(error).__name__}: {error}")


def nothing(path: str, digest: str, number: int) -> Finished:  # noqa: ARG001 - in the place of `finish_chunk`
    """No work at all: what engines cost by themselves; see `benchmarks/studies.py`."""
    return Finished(number, COMPUTED, ())


def _finished(folder: StudyFolder, number: int) -> Finished:
    older = folder.files_of(number)
    for path in older:
        content = intact(path)
        if content is not None:
            return Finished(number, KEPT, counts_in(content))
    content = content_of(folder, number)
    make_folder(folder.place(number))
    # Whether it is whole shows its checksum, not the disk's word: nobody waits for that.
    file = folder.file(number, content)
    write_file(file, content, durable=False)
    for path in older:
        if path != file:
            with contextlib.suppress(OSError):
                path.unlink()
    return Finished(number, MENDED if older else COMPUTED, counts_in(content))


def content_of(folder: StudyFolder, number: int) -> bytes | bytearray:
    """A chunk's file: the quantities, `status`, and where points are computed one by one `reason`.

    It is valid until the next one of this process is made.
    """
    start, stop = folder.points.span(number)
    columns, numbers = folder.points.columns(number), {"chunk": [number], "first_point": [start]}
    form = folder.form(stop - start)
    if form is not None:
        status = form.arrays["status"]
        folder.work.fill(columns, form.arrays, status)
        for name, value in (numbers | {"points_by_status": _counted(status)}).items():
            form.arrays[name][:] = value
        return form.content
    values, status, reasons = folder.work(columns)
    variables: dict[str, Any] = {name: ((*folder.work.shapes[name], "point"), array) for name, array in values.items()}
    variables["status"] = ("point",), status
    if reasons:
        letters = np.array([reason.encode() for reason in reasons], f"S{REASON_MAX}")
        variables["reason"] = ("point", "letter"), letters.view("S1").reshape(len(reasons), -1)
    filled = {name: np.array(value, ATTRIBUTES[name][1]) for name, value in numbers.items()}
    filled["points_by_status"] = _counted(status)
    return netcdf_of_arrays(variables, folder.about, folder.texts | filled)


def _counted(status: NDArray[np.int8]) -> NDArray[np.int32]:
    return np.array([np.count_nonzero(status == k) for k in range(len(WORDS))], np.int32)


def counts_in(content: bytes | bytearray) -> tuple[int, ...]:
    """Points by status, which the file says of itself."""
    from scipy.io import netcdf_file  # noqa: PLC0415  (loads slowly)

    with netcdf_file(io.BytesIO(content), "r", mmap=False) as file:
        told: Any = file
        return tuple(np.atleast_1d(told.points_by_status).tolist())
