"""A small part of `benchmarks.interrupted`: killed, too little room, a full disk, over older good files."""

from __future__ import annotations

import sys

import pytest


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("subject", ["map", "export", "compile"] if sys.platform != "win32" else [])
def test_the_older_or_the_newer_file_is_there_whole(subject: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmarks import interrupted  # noqa: PLC0415  (not on Windows)

    monkeypatch.setenv("FLEXOPT_CACHE", "")  # changed by the run; put back after it
    assert interrupted.main(["--kills", "3", "--only", subject]) == 0
