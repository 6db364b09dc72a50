"""A small part of `benchmarks.interrupted`: killed, too little room, a full disk, over older good files."""

from __future__ import annotations

import sys

import pytest

from flexopt.export import bundle


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("subject", ["map", "export", "compile"] if sys.platform != "win32" else [])
def test_the_older_or_the_newer_file_is_there_whole(subject: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmarks import interrupted  # noqa: PLC0415  (not on Windows)

    # Changed by the run; put back after it.
    monkeypatch.setenv("FLEXOPT_CACHE", "")
    monkeypatch.setattr(bundle, "render_bundle", bundle.render_bundle)
    assert interrupted.main(["--kills", "3", "--only", subject]) == 0
