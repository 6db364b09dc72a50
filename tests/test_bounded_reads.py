"""What is read of others ends: pipes, devices, folders and files without end are refused in one sentence."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import flexopt
from flexopt.selection.certificate.check import Refused
from flexopt.selection.certificate.check import read as read_log
from flexopt.study.comparison import compare_saved

EXCAVATOR = flexopt.load("excavator")
READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "machine": ("m.toml", flexopt.load),
    "problem": ("p.toml", flexopt.load_problem),
    "study": ("s.toml", flexopt.load_study),
    "robot": ("r.urdf", lambda path: flexopt.load_robot(path, {})),
    "log": ("l.csv", lambda path: flexopt.identify(EXCAVATOR, path, posture=(0.5, -1.2))),
    "results": ("r.json", lambda path: compare_saved([str(path), str(path)])),
    "certificate": ("c.json", lambda path: read_log(str(path))),
    "study folder": ("study/study.json", lambda path: flexopt.open_study(path.parent)),
    "bundle": ("bundle/manifest.json", lambda path: flexopt.verify_bundle(path.parent)),
}


def without_end(path: Path) -> None:
    """A file of 4 GB that takes no room."""
    with path.open("wb") as file:
        file.truncate(4 << 30)


KINDS: dict[str, Callable[[Path], None]] = {
    "4 GB": without_end,
    "folder": Path.mkdir,
    **({} if sys.platform == "win32" else {"pipe": os.mkfifo, "device": lambda path: path.symlink_to("/dev/zero")}),
}


@pytest.mark.parametrize("kind", list(KINDS))
@pytest.mark.parametrize("reader", list(READERS))
def test_what_has_no_end_is_refused(reader: str, kind: str, tmp_path: Path) -> None:
    name, read = READERS[reader]
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    KINDS[kind](path)
    with pytest.raises((flexopt.FlexoptError, Refused)):
        read(path)


def test_numbers_of_results_that_are_no_doubles(tmp_path: Path) -> None:
    path = tmp_path / "r.json"
    document = flexopt.evaluate(EXCAVATOR, (0.9929, -2.6306)).to_dict()
    path.write_text(json.dumps(document).replace("3.039", f"{10**400}", 1))
    with pytest.raises(flexopt.InputError, match="is no JSON document"):
        compare_saved([str(path), str(path)])


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04" + b"\xff" * 100])
def test_an_fmu_or_bundle_that_is_there_needs_overwrite(content: bytes, tmp_path: Path) -> None:
    """And nothing of it is read."""
    path = tmp_path / "loop.fmu"
    path.write_bytes(content)
    run = {"kp": 1e4, "kv": 1e3, "duration": 0.05}
    with pytest.raises(flexopt.InputError, match="overwrite does"):
        flexopt.export_fmu(EXCAVATOR, path, (0.0448, -2.0499), **run)
    assert path.read_bytes() == content
    assert flexopt.export_fmu(EXCAVATOR, path, (0.0448, -2.0499), overwrite=True, **run).path == path
    flexopt.export_c(EXCAVATOR, tmp_path / "b", parts=["kinematics"])
    with pytest.raises(flexopt.InputError, match="overwrite replaces a bundle"):
        flexopt.export_c(EXCAVATOR, tmp_path / "b", parts=["kinematics"])
    flexopt.export_c(EXCAVATOR, tmp_path / "b", parts=["kinematics"], overwrite=True)
