"""Study files and folders that somebody altered: one error of flexopt's own each, and nothing written elsewhere."""

from __future__ import annotations

import copy
import hashlib
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import netcdf_file

import flexopt
from flexopt.cli import main
from tests.large_studies.studies import small

WRONG = [None, True, -1, 10**400, 1e308, "text", [], {}, [1], {"a": 1}]
STUDY = """
name = "NAME"
compute = "measures"
machine = "excavator"
posture = [0.5, -1.0]
[[vary]]
of = "stiffness"
factor = [0.5, 2.0]
count = 3
"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished") / "study"
    flexopt.run_study(small(), folder, workers=1)
    return folder


def places(table: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Ways to every value of a document, lists by their first entry."""
    for key in table if isinstance(table, dict) else [0] if isinstance(table, list) and table else []:
        yield (*way, key)
        yield from places(table[key], (*way, key))


def asked(folder: Path) -> None:
    """All that a user asks of a folder."""
    result = flexopt.open_study(folder)
    repr(result)
    result.to_dict()
    result.dataset()
    flexopt.run_study(small(), folder, workers=1)


@pytest.mark.parametrize("name", ["study.json", "progress.json"])
def test_every_place_of_a_document(name: str, finished: Path, tmp_path: Path) -> None:
    """Another value or none at every place: an error of flexopt's, or the same numbers."""
    folder, told = tmp_path / "study", json.loads((finished / name).read_text())
    shutil.copytree(finished, folder)
    whole = flexopt.open_study(finished).dataset()
    # Values deep in the machine are covered by the document's own checksum.
    for way in (way for way in places(told) if len(way) <= 2):
        for value in ["missing", *WRONG]:
            changed = copy.deepcopy(told)
            at = changed
            for key in way[:-1]:
                at = at[key]
            if value == "missing":
                del at[way[-1]]
            else:
                at[way[-1]] = value
            (folder / name).write_text(json.dumps(changed))
            try:
                asked(folder)
            except flexopt.FlexoptError:
                continue
            assert flexopt.open_study(folder).dataset().equals(whole)
    for text in ("", "{", "[" * 100_000, "\udcff", "NaN"):
        (folder / name).write_bytes(text.encode("utf-8", "surrogateescape"))
        with pytest.raises(flexopt.InputError, match=name):
            flexopt.open_study(folder)


@pytest.mark.parametrize(
    ("name", "value"),
    [("w", 123.0), ("status", 99), ("status", -1), ("w", np.inf)],
)
def test_numbers_that_a_quantity_cannot_have(name: str, value: float, finished: Path, tmp_path: Path) -> None:
    """With a checksum that fits: whoever alters a file may rename it."""
    folder = tmp_path / "study"
    shutil.copytree(finished, folder)
    path = sorted(folder.rglob("*.nc"))[0]
    with netcdf_file(path, "a", mmap=False) as file:
        file.variables[name][..., 0] = value
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    path.rename(path.with_name(f"{path.name[:8]}-{digest}.nc"))
    with pytest.raises(flexopt.InputError, match="chunk 0 holds what its study does not compute"):
        flexopt.open_study(folder).dataset()


@pytest.mark.parametrize("content", [b"", b"CDF\x01", b"CDF\x02" + b"\xff" * 200, b"\x89HDF"])
def test_chunks_that_are_no_files_of_netcdf(content: bytes, finished: Path, tmp_path: Path) -> None:
    folder = tmp_path / "study"
    shutil.copytree(finished, folder)
    path = sorted(folder.rglob("*.nc"))[0]
    path.write_bytes(content)
    path.rename(path.with_name(f"{path.name[:8]}-{hashlib.sha256(content).hexdigest()}.nc"))
    with pytest.raises(flexopt.InputError, match="chunk 0 was truncated or altered"):
        flexopt.open_study(folder).dataset()


@pytest.mark.parametrize("name", ["../../x", "/tmp/x", "a/b", "..", ".", " x", "C:x", "a\\b"])
def test_a_name_is_no_path(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    here = tmp_path / "a" / "b"
    here.mkdir(parents=True)
    monkeypatch.chdir(here)
    (here / "s.toml").write_text(STUDY.replace("NAME", name.replace("\\", "\\\\")))
    with pytest.raises(SystemExit) as left:
        main(["study", "run", "s.toml", "--workers", "1"])
    assert left.value.code == 2
    assert "must be a name, not a path" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a", "b", "s.toml"]


@pytest.mark.parametrize(
    "line", ['machine = "excavator"\n', "count = 3\n", "factor = [0.5, 2.0]\n", 'compute = "measures"\n']
)
def test_what_a_study_file_lacks_is_named(line: str, tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(STUDY.replace(line, ""))
    with pytest.raises(flexopt.ModelError, match=line.split(maxsplit=1)[0]):
        flexopt.load_study(tmp_path / "s.toml")
