"""Where an oracle has no wheel the tests that need it are left out, and all others are still collected."""

from __future__ import annotations

import subprocess
import sys
import tomllib

import pytest

from tests.conftest import ROOT, WITHOUT, needs

DISTRIBUTIONS = {"pinocchio": "pin", "example_robot_data": "example-robot-data", "slycot": "slycot"}
COLLECT = """
import sys
from importlib.abc import MetaPathFinder

class Refuse(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name in {names!r}:
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, Refuse())
import tests.conftest
tests.conftest.missing = {names!r}
import pytest
sys.exit(pytest.main(["--collect-only", "-q", "-n", "0", "-p", "no:cacheprovider", "tests"]))
"""


@pytest.mark.long
def test_everything_else_is_collected() -> None:
    """Without any oracle that some platform lacks: what one of them lacks alone leaves out fewer files."""
    names = tuple(name for lacking in WITHOUT.values() for name in lacking)
    done = subprocess.run(
        [sys.executable, "-c", COLLECT.format(names=names)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-2000:]
    files = {line.partition("::")[0] for line in done.stdout.splitlines() if "::" in line}
    left_out = {str(path.relative_to(ROOT)) for path in ROOT.glob("tests/**/test_*.py") if needs(path, names)}
    for lacking in WITHOUT.values():
        alone = {path for path in left_out if needs(ROOT / path, lacking)}
        assert alone
        assert alone != left_out
    assert not files & left_out
    assert len(files) > len(left_out)


@pytest.mark.parametrize("platform", WITHOUT)
def test_markers_say_the_same(platform: str) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    marked = {
        requirement.partition(">=")[0]
        for requirement in project["optional-dependencies"]["test"]
        if requirement.endswith(f"sys_platform != '{platform}'")
    }
    assert marked == {DISTRIBUTIONS[name] for name in WITHOUT[platform]}
