"""Blocks of Python and shell on the pages, and in README.md, run from top to bottom in an empty folder."""

from __future__ import annotations

import doctest
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from PIL import Image

import flexopt

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted({*(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "howto").glob("*.md"), ROOT / "README.md"})
BLOCK = re.compile(r"^(<!-- .* -->\n)?```(python|sh|toml|xml|c)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# The first line of a file that a page shows names it.
NAMED = re.compile(r"^(?:#|<!--|/\*) ([\w.-]+\.(?:toml|urdf|c))\b")
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
pytestmark = pytest.mark.skipif(shutil.which("bash") is None, reason="the blocks are those of a POSIX shell")


class Block(NamedTuple):
    kind: str
    text: str
    line: int


def blocks(text: str) -> Iterator[Block]:
    """Those of a page, but those that .ci/run runs: a comment before them marks them."""
    for found in BLOCK.finditer(text):
        if found[1] is None:
            yield Block(found[2], found[3], text[: found.start()].count("\n") + 1)


def run(block: Block, names: dict[str, Any]) -> None:
    file = NAMED.match(block.text)
    if block.kind == "sh":
        places = [str(Path(sys.executable).parent), os.environ["PATH"]]
        environment = os.environ | {"PATH": os.pathsep.join(places), "PYTHONPATH": str(ROOT)}
        command = ["bash", "-euo", "pipefail", "-c", block.text]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"line {block.line}: {block.text}\n{done.stdout}{done.stderr}"
    elif block.kind == "python" and ">>>" in block.text:
        said: list[str] = []
        test = doctest.DocTestParser().get_doctest(block.text, names, "block", None, block.line)
        doctest.DocTestRunner(optionflags=FLAGS, verbose=False).run(test, out=said.append, clear_globs=False)
        names |= test.globs
        assert not said, "".join(said)
    elif block.kind == "python":
        exec(compile(block.text, f"line {block.line}", "exec"), names)
    elif file:
        Path(file[1]).write_text(block.text, encoding="utf-8")


def test_there_are_pages() -> None:
    found = {path.stem for path in PAGES}
    assert found >= {"index", "tutorial", "own-machine", "robot-file", "own-objective", "posture-to-c", "unknown-soil"}
    counted = [block.kind for path in PAGES for block in blocks(path.read_text(encoding="utf-8"))]
    assert counted.count("python") > 20
    assert counted.count("sh") > 8


def test_a_block_that_fails_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    page = "```toml\n# m.toml\nname = 1\n```\n\n```python\n>>> 1 + 1\n3\n```\n\n```sh\nfalse | true\n```\n"
    first, second, third = blocks(page)
    run(first, {})
    assert (tmp_path / "m.toml").exists()
    for block in (second, third):
        with pytest.raises(AssertionError):
            run(block, {})
    with pytest.raises(ZeroDivisionError):
        run(Block("python", "1 / 0", 1), {})
    assert list(blocks("<!-- tests -->\n```sh\nfalse\n```\n")) == []


@pytest.mark.long(
    "closed-loop",
    "comparing-runs",
    "explorer",
    "machines-in-space",
    "own-machine",
    "pictures",
    "posture-to-c",
    "problem-file",
    "real-controller",
    "report",
    "robot-file",
    "studies",
    "unknown-soil",
    "tutorial",
    "README",
)
@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_the_blocks_of_a_page_run(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "page"}
    for block in blocks(path.read_text(encoding="utf-8")):
        run(block, names)


def test_the_readmes_picture_is_what_its_command_draws(tmp_path: Path) -> None:
    """Eyes would see more than a mean; it sees another axis, another line, other numbers in the legend."""
    flexopt.solve_problem(flexopt.load_problem("article")).plot(tmp_path / "article.png")

    def small(path: Path) -> np.ndarray:
        # Of letters and lines what remains where Matplotlib sets them a point apart.
        return np.asarray(Image.open(path).convert("L").resize((210, 112), Image.Resampling.BOX), dtype=float)

    drawn, kept = small(tmp_path / "article.png"), small(ROOT / "docs" / "article.png")
    assert np.abs(drawn - kept).mean() < 0.5  # of 255; another axis of one panel is 1.5 off
