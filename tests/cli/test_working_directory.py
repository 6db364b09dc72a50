"""Commands obey nothing that lies in the working directory and was not named: options of solvers, settings of pictures."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

# Written where it is read; a solver's log, a foreign library, and options that end the solve.
IPOPT = "output_file planted.log\nhsllib ./foreign.so\nlinear_solver ma27\nmax_iter 0\n"
MATPLOTLIB = "text.usetex: True\nfont.size: 40\nbackend: planted\nno such key: 1\n"
PLANTED = {
    "ipopt.opt": IPOPT,
    "matplotlibrc": MATPLOTLIB,
    "excavator": "planted",
    "article": "planted",
    "foreign.so": "",
}
COMMANDS = {
    "select": ["select", "article", "--starts", "2", "--plot", "choice.png"],
    "verdict": ["verdict", "article", "--loop", "kp=1e4", "--loop", "kv=1e3", "--members", "2", "--runs", "0"],
    "report": ["report", "article", "--out", "page"],
    "doctor": ["doctor"],
}  # fmt: skip
# Runs a command and says which files of the working directory were opened to be read, in this process.
RUNNER = """
import json, os, sys
here, opened = os.getcwd(), set()
def seen(event, arguments):
    if event == "open" and isinstance(arguments[0], str) and not (arguments[1] or "r").strip("rbt"):
        path = os.path.abspath(arguments[0])
        if os.path.dirname(path) == here:
            opened.add(os.path.basename(path))
sys.addaudithook(seen)
from flexopt.cli import main
try:
    main(sys.argv[2:])
finally:
    with open(sys.argv[1], "w") as file:
        json.dump(sorted(opened), file)
"""


@pytest.mark.long("report")
@pytest.mark.parametrize("name", list(COMMANDS))
def test_nothing_is_read_unasked(name: str, tmp_path: Path) -> None:
    runner, told, here = tmp_path / "runner.py", tmp_path / "opened.json", tmp_path / "here"
    here.mkdir()
    runner.write_text(RUNNER, encoding="utf-8")
    for planted, text in PLANTED.items():
        (here / planted).write_text(text, encoding="utf-8")
    command = [sys.executable, str(runner), str(told), *COMMANDS[name]]
    ran = subprocess.run(command, cwd=here, capture_output=True, text=True, encoding="utf-8", check=False)
    assert ran.returncode == 0, ran.stderr
    assert "planted" not in ran.stderr
    assert not set(json.loads(told.read_text(encoding="utf-8"))) & set(PLANTED)
    assert {path.name for path in here.iterdir()} - set(PLANTED) <= {"choice.png", "page"}
    assert all((here / planted).read_text(encoding="utf-8") == text for planted, text in PLANTED.items())


@pytest.mark.parametrize("room", ["plotting.machine", "article.pictures", "article.loop_pictures"])
def test_pictures_are_imported_apart(room: str, tmp_path: Path) -> None:
    """Matplotlib complains of settings that it reads and does not know."""
    (tmp_path / "matplotlibrc").write_text(MATPLOTLIB, encoding="utf-8")
    command = [sys.executable, "-c", f"import flexopt.{room}, matplotlib as m; assert not m.rcParams['text.usetex']"]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, encoding="utf-8", check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
