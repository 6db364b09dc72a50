"""Long tests are left out by default, and run alone or with the others where that is asked for."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from argparse import ArgumentTypeError
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.long_tests import ASTRAY, part

EXAMPLE = """
import pytest

@pytest.mark.long
def test_scan():
    pass

@pytest.mark.long("b", "d")
@pytest.mark.parametrize("name", ["a", "b", "c"])
def test_machine(name):
    pass

def test_plain(pytestconfig):
    from tests.long_tests import ASTRAY
    assert list(pytestconfig.stash[ASTRAY].values()) == [{"d"}]
"""
QUICK = {"test_machine[a]", "test_machine[c]", "test_plain"}
LONG = {"test_scan", "test_machine[b]"}


def run(folder: Path, *options: str, test: str = "") -> str:
    """What pytest says of the example in a folder."""
    file = folder / "test_example.py"
    file.write_text(EXAMPLE, encoding="utf-8")
    options = ("--rootdir", str(folder), "-c", os.devnull, "-q", "-p", "no:cacheprovider", *options, f"{file}{test}")
    command = [sys.executable, "-m", "pytest", "-p", "tests.long_tests", *options]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def collected(folder: Path, *options: str, test: str = "") -> set[str]:
    return set(re.findall(r"::(\S+)", run(folder, "--collect-only", *options, test=test)))


@pytest.mark.long("options0-expected0", "options1-expected1")
@pytest.mark.parametrize(
    ("options", "expected"),
    [((), QUICK), (("--tests", "long"), LONG), (("--tests", "all"), QUICK | LONG)],
)
def test_each_half(options: tuple[str, ...], expected: set[str], tmp_path: Path) -> None:
    assert collected(tmp_path, *options) == expected


@pytest.mark.long
def test_what_is_named_by_its_address_runs(tmp_path: Path) -> None:
    assert collected(tmp_path, test="::test_scan") == {"test_scan"}


@pytest.mark.long
def test_parts_are_all_long_tests_each_once(tmp_path: Path) -> None:
    parts = [collected(tmp_path, "--tests", "all", "--part", f"{k}/3") for k in (1, 2, 3)]
    assert [each & QUICK for each in parts] == [QUICK] * 3
    assert sorted(test for each in parts for test in each & LONG) == sorted(LONG)


@pytest.mark.parametrize("text", ["0/4", "5/4", "1", "a/b", "1/0"])
def test_what_is_no_part(text: str) -> None:
    with pytest.raises(ArgumentTypeError, match="1 ≤ K ≤ N"):
        part(text)


def test_a_case_that_is_not_there_is_found(tmp_path: Path) -> None:
    assert "3 passed" in run(tmp_path)


def test_marks_name_cases_that_are_there(pytestconfig: pytest.Config) -> None:
    assert pytestconfig.stash[ASTRAY] == {}
