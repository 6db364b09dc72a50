"""The folder of a study: its document, and where its chunks lie; who may go on with it.

In: a study and a folder. Out: `study.json`, which says all that a chunk depends on, and the paths of chunks. Whoever
computes reads it from there: messages between processes stay small, and state lies in files alone.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from flexopt.compiled import find_compiler
from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.documents import build_version, package_version
from flexopt.foundation.netcdf_form import NetcdfForm
from flexopt.foundation.reading import read_bounded
from flexopt.foundation.writing import make_folder, write_file
from flexopt.large_studies.points import StudyPoints
from flexopt.large_studies.status import FLAGS, WORDS
from flexopt.model.study import Study
from flexopt.model.study_axes import study_axes
from flexopt.model.study_file import described, study_of

DOCUMENT, CHUNKS, PROGRESS = "study.json", "chunks", "progress.json"
# Files of a folder: each file that is written looks through its own once, see `foundation/writing.py`.
TOGETHER = 256
NAME = re.compile(r"(\d{8,})-([0-9a-f]{64})\.nc")
# Bytes of the document and of a chunk, at most.
DOCUMENT_MAX, CHUNK_BYTES_MAX = 16_000_000, 2_000_000_000
# Points whose numbers, to the last bit, tell whether two processes compute alike.
PROBED = 64
# Numbers that a chunk's file says of itself: how many, and of which kind.
ATTRIBUTES = {"chunk": (1, "i4"), "first_point": (1, "f8"), "points_by_status": (len(WORDS), "i4")}
PACKAGES = ("flexopt", "casadi", "numpy", "scipy")


def work_of(study: Study, points: StudyPoints) -> Any:
    """What computes a chunk of a study from its columns."""
    # Each kind loads what it needs alone.
    if study.compute in ("measures", "outcome"):
        from flexopt.large_studies.together import ManyMeasures, ManyOutcomes  # noqa: PLC0415

        return (ManyMeasures if study.compute == "measures" else ManyOutcomes)(study, points.axes)
    from flexopt.large_studies.singly import ManySelections, ManySimulations  # noqa: PLC0415

    return (ManySelections if study.compute == "selection" else ManySimulations)(study, points.axes)


@dataclass(frozen=True)
class StudyFolder:
    """A folder and the study that it holds.

    Attributes:
        path: of the folder.
        study: which.
        made_by: versions, whether code is compiled, and the checksum of a few numbers, when it was begun.
    """

    path: Path
    study: Study
    made_by: Mapping[str, Any]

    @cached_property
    def points(self) -> StudyPoints:
        """The numbers of its points."""
        return StudyPoints(self.study)

    @cached_property
    def work(self) -> Any:
        """What computes a chunk."""
        return work_of(self.study, self.points)

    @cached_property
    def digest(self) -> str:
        """Of the study, without who made it."""
        return digest_of(self.study)

    @property
    def about(self) -> dict[str, dict[str, Any]]:
        """Attributes of the variables in a chunk's file."""
        return {name: {"units": unit} for name, unit in self.work.units.items()} | {"status": FLAGS}

    @property
    def texts(self) -> dict[str, bytes]:
        """Attributes of the file."""
        return {"study": self.study.name.encode(), "sha256": self.digest.encode()}

    def form(self, count: int) -> NetcdfForm | None:
        """What a chunk of so many points is filled into; None of one that is made anew each time."""
        variables = None if not hasattr(self.work, "fill") else self.work.variables(count)
        if variables is None or not NetcdfForm.fits(variables):
            return None
        if count not in self.forms:
            self.forms.clear()  # there are two sizes, of which the last chunk has its own
            self.forms[count] = NetcdfForm(variables, self.about, self.texts, ATTRIBUTES)
        return self.forms[count]

    @cached_property
    def forms(self) -> dict[int, NetcdfForm]:
        """The last one, by its number of points."""
        return {}

    def place(self, number: int) -> Path:
        """The folder of a chunk."""
        return self.path / CHUNKS / f"{number // TOGETHER:06d}"

    def file(self, number: int, content: bytes | bytearray) -> Path:
        """The file of a chunk, whose name has the SHA-256 of its content."""
        return self.place(number) / f"{number:08d}-{hashlib.sha256(content).hexdigest()}.nc"

    def there(self) -> dict[int, list[Path]]:
        """Files of chunks by their numbers, unread."""
        found: dict[int, list[Path]] = {}
        for group in sorted(_entries(self.path / CHUNKS)):
            for path in sorted(_entries(group)):
                named = NAME.fullmatch(path.name)
                if named and self.place(int(named[1])) == group:
                    found.setdefault(int(named[1]), []).append(path)
        return found

    def files_of(self, number: int) -> list[Path]:
        """Files of one chunk, unread."""
        return [path for path in sorted(_entries(self.place(number))) if path.name.startswith(f"{number:08d}-")]


def _entries(folder: Path) -> list[Path]:
    try:
        return [Path(entry.path) for entry in os.scandir(folder)]
    except (FileNotFoundError, NotADirectoryError):
        return []


def digest_of(study: Study) -> str:
    """SHA-256 of all that a study says, its machine included."""
    return hashlib.sha256(json.dumps(described(study), sort_keys=True).encode()).hexdigest()


def intact(path: Path) -> bytes | None:
    """What a chunk's file holds; None where it is gone, or not what its name says."""
    named = NAME.fullmatch(path.name)
    try:
        content = read_bounded(path, CHUNK_BYTES_MAX)
    except OSError:
        return None
    return content if named and hashlib.sha256(content).hexdigest() == named[2] else None


def fingerprint(folder: StudyFolder) -> dict[str, Any]:
    """What decides about the last bits: builds, compiled or not, and for compiled ones the bits of a few numbers."""
    found: dict[str, Any] = {name: package_version(name) for name in PACKAGES} | {"flexopt": build_version()}
    found["compiled"] = find_compiler() is not None
    if folder.study.compute == "measures":
        columns = folder.points.columns(0)[:, :PROBED]
        values, _, _ = folder.work(columns)
        found["bits"] = f"{zlib.crc32(b''.join(np.ascontiguousarray(values[name]).tobytes() for name in values)):08x}"
    return found


def begin(path: str | os.PathLike[str], study: Study) -> StudyFolder:
    """The folder of a study: a new one, or one that holds the same study and can go on here.

    Raises:
        InputError: it holds another study, other files, or was begun where numbers come out otherwise; something of
            the study does not go with its machine.
        WriteError: it cannot be written.
    """
    folder = Path(path)
    if (folder / DOCUMENT).exists():
        found = open_folder(folder)
        faults = _differences(described(found.study), described(study))
        raise_if_any(InputError, f"run_study: folder = {str(path)!r} holds another study", faults)
        check_alike(found)
        return found
    others = [entry.name for entry in _entries(folder) if not entry.name.startswith(".")]
    if others or (folder.exists() and not folder.is_dir()):
        listed = ", ".join(sorted(others)[:3]) or "it is a file"
        fault = Fault("folder", f"must be a new or empty folder, or that of this study; there is {listed}", str(path))
        raise_if_any(InputError, "run_study", [fault])
    study_axes(study)  # what does not go with its machine is told before anything is written
    fresh = StudyFolder(folder, study, {})
    made_by = fingerprint(fresh)
    text = json.dumps(described(study) | {"layout": 1, "sha256": fresh.digest, "made_by": made_by}, indent=2)
    make_folder(folder)
    write_file(folder / DOCUMENT, text + "\n")
    return StudyFolder(folder, study, made_by)


def open_folder(path: str | os.PathLike[str]) -> StudyFolder:
    """The folder of a study that was begun.

    Raises:
        InputError: there is none, or its document was changed.
    """
    try:
        told = _Document.model_validate_json(read_bounded(Path(path) / DOCUMENT, DOCUMENT_MAX))
        study = study_of(told.model_dump(exclude_none=True))
    except FileNotFoundError:
        raise _refused(path, f"is no folder of a study: it has no {DOCUMENT}") from None
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else " ".join(str(error).split())
        raise _refused(path, f"its {DOCUMENT} cannot be read ({str(why)[:200]})") from None
    if told.sha256 != digest_of(study):
        raise _refused(path, f"its {DOCUMENT} was changed, or comes from another version")
    return StudyFolder(Path(path), study, told.made_by)


class _Document(BaseModel):
    """What the document says: a study with its subject, and who began it."""

    model_config = ConfigDict(extra="forbid", strict=True)

    layout: Literal[1]
    sha256: str
    made_by: dict[str, str | bool]
    kind: Literal["Machine", "Tree"]
    study: dict[str, Any]
    machine: dict[str, Any]
    subject: dict[str, Any] | None = None


class StudyProgress(BaseModel):
    """How far the study was when it was last told: points by their status, and the rate."""

    model_config = ConfigDict(extra="ignore", strict=True, allow_inf_nan=False)

    points: dict[str, Annotated[int, Field(ge=0)]]
    points_per_second: Annotated[float, Field(ge=0)]


def read_progress(path: Path) -> StudyProgress:
    """Read how far a study is; nothing is known where there is no such file yet.

    Raises:
        InputError: the file was altered.
    """
    try:
        found = StudyProgress.model_validate_json(read_bounded(path / PROGRESS, DOCUMENT_MAX))
        if found.points.keys() != {*WORDS}:
            raise ValueError
        return found
    except FileNotFoundError:
        return StudyProgress(points=dict.fromkeys(WORDS, 0), points_per_second=0.0)
    except (OSError, ValueError):
        raise _refused(path, f"its {PROGRESS} cannot be read; without it the study goes on") from None


def _refused(path: str | os.PathLike[str], sentence: str) -> InputError:
    return InputError(f"folder = {os.fspath(path)!r}: {sentence}", [Fault("folder", sentence)])


def check_alike(folder: StudyFolder) -> None:
    """Raise where this process would compute other bits than the one that began the study."""
    here = fingerprint(folder)
    differ = [
        f"{name} {folder.made_by.get(name)} there, {here.get(name)} here"
        for name in sorted({*here, *folder.made_by})
        if here.get(name) != folder.made_by.get(name)
    ]
    if differ:
        sentence = f"was begun where numbers come out otherwise ({'; '.join(differ)}), and results would mix"
        fault = Fault("folder", f"{sentence}; use the same versions and kind of processor, or a new folder")
        raise_if_any(InputError, f"study {folder.study.name!r}", [fault])


def _differences(there: Mapping[str, Any], here: Mapping[str, Any], outer: str = "") -> list[Fault]:
    """Keys whose values differ, with both."""
    faults: list[Fault] = []
    for key in sorted({*there, *here}):
        one: Any = there.get(key)
        two: Any = here.get(key)
        if isinstance(one, Mapping) and isinstance(two, Mapping):
            faults += _differences(cast(Any, one), cast(Any, two), f"{outer}{key}.")
        elif one != two:
            told = [_short(one), _short(two)]
            faults.append(Fault(f"{outer}{key}".removeprefix("study."), f"is {told[0]} in the folder, not {told[1]}"))
    return faults


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
