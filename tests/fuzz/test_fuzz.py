"""The fuzzer finds what is planted, makes an input again by its number, and finds nothing in some real inputs."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from random import Random

import pytest

from tests.conftest import ROOT
from tests.fuzz import material
from tests.fuzz.ways import KINDS, PLANTED, Input
from tests.fuzz.worker import judge, kind_of, make

# Files that people write; the others are made by flexopt, which takes longer.
TEXTS = ("machine", "overlay", "urdf", "mjcf", "problem", "experiment", "study", "arguments")


def fuzz(*words: str) -> subprocess.CompletedProcess[str]:
    """The command."""
    return subprocess.run(
        [sys.executable, "-m", "tests.fuzz", *words], cwd=ROOT, capture_output=True, text=True, check=False
    )


def test_what_is_planted_is_found() -> None:
    done = fuzz("--kind", *PLANTED, "--limit-seconds", "3", "--limit-mb", "600")
    assert done.returncode == 1, done.stderr
    found = dict(re.findall(r"^--seed 1 --only \d: planted-(\w+), .*: ([A-Z ]+) \(", done.stdout, re.MULTILINE))
    wanted = {"raw": "RAW ERROR", "hang": "HANG", "hog": "MEMORY", "abort": "DIED", "warning": "FOREIGN WARNING"}
    assert found == wanted, done.stdout
    assert "ZeroDivisionError: planted" in done.stdout
    assert "in _hang" in done.stdout
    assert "5 inputs" in done.stdout


def test_nothing_is_found() -> None:
    done = fuzz("--kind", *TEXTS, "--count", "60", "--seed", "11")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "60 inputs" in done.stdout
    assert "0 findings" in done.stdout


@pytest.mark.long
def test_nothing_is_found_in_any_kind() -> None:
    done = fuzz("--count", "600", "--seed", "11")
    assert done.returncode == 0, done.stdout + done.stderr
    assert set(KINDS) <= set(re.findall(r"^(\w+) ", done.stdout, re.MULTILINE))


def test_every_kind_is_drawn() -> None:
    assert {kind_of(11, number) for number in range(600)} == set(KINDS)


@pytest.mark.long("proof", "bundle", "saved", "folder", "cache")
@pytest.mark.parametrize("name", [name for name, kind in KINDS.items() if kind.files and name != "fmu"])
def test_what_is_not_mutated_is_taken(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the first way of each kind, so that mutations are of what can be read. An FMU that is there may be refused."""
    material.build(tmp_path, [name])
    specimens = sorted((tmp_path / name).iterdir())
    assert specimens
    for specimen in specimens:
        monkeypatch.chdir(specimen)
        main = next(
            (path.name for path in sorted(specimen.glob("main.*")) if name != "urdf" or path.suffix == ".toml"), ""
        )
        _, way = next(iter(KINDS[name].api.values()))
        assert judge(Input(Random(1), main), way)[0] == "result", specimen


def test_an_input_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same bytes, names and ways, and mostly other ones for another seed."""
    good = tmp_path / "material"
    material.build(good, ())

    def made(seed: int, folder: Path) -> list[tuple[str, str, bytes]]:
        found: list[tuple[str, str, bytes]] = []
        for number in range(40):
            name = TEXTS[number % 7]
            work = folder / str(number)
            work.mkdir(parents=True)
            monkeypatch.chdir(work)
            given, told, _ = make(good, KINDS[name], name, Random(f"{seed}/{number}"))
            regular = Path(given.path).is_file() and not Path(given.path).is_symlink() and "hole" not in told
            found.append((told, given.path, Path(given.path).read_bytes() if regular else b""))
        return found

    first, again, other = made(1, tmp_path / "a"), made(1, tmp_path / "b"), made(2, tmp_path / "c")
    assert first == again
    assert sum(one != two for one, two in zip(first, other, strict=True)) > 30
