"""The fuzzer finds what is planted, repeats an input by its number, and finds nothing in some seconds of real inputs."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.fuzz import material, ways


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("fuzz") / "material"
    material.build(folder)
    return folder


def fuzz(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "tests.fuzz", *words], cwd=ROOT, capture_output=True, text=True, check=False
    )


def test_what_is_planted_is_found() -> None:
    done = fuzz("--kind", *ways.PLANTED, "--limit-seconds", "3", "--limit-mb", "600")
    assert done.returncode == 1, done.stderr
    found = dict(re.findall(r"^--seed 1 --only \d: planted-(\w+), .*: ([A-Z ]+) \(", done.stdout, re.MULTILINE))
    assert found == {"raw": "RAW ERROR", "hang": "HANG", "hog": "MEMORY", "abort": "DIED", "warning": "FOREIGN WARNING"}
    assert "ZeroDivisionError: planted" in done.stdout
    assert "in _hang" in done.stdout
    assert "5 inputs" in done.stdout
