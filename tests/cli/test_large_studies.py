"""`flexopt study` and `flexopt sensitivity`."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import xarray as xr

import flexopt
from flexopt.cli.large_studies import _interruptible
from tests.cli.command import Command
from tests.large_studies.studies import files

STUDY = """
schema = 1
name = "soils"
machine = "excavator"
compute = "measures"
chunk = 50
posture = [0.5, -1.0]

[[vary]]
of = "posture.boom"
value = [0.1, 1.4]
count = 40

[[vary]]
of = "stiffness"
factor = [0.5, 2.0]
count = 5
"""


@pytest.fixture
def study(command: Command) -> Path:
    path = command.folder / "soils.toml"
    path.write_text(STUDY)
    return path


def test_run_status_export(command: Command, study: Path) -> None:
    out, whole = command.folder / "soils", command.folder / "soils.nc"
    ran = command.json("study", "run", str(study), "--out", str(out), "--workers", "1")
    assert (ran["complete"], ran["done"], ran["statuses"]["ok"]) == (True, 4, 200)
    assert command.json("study", "export", str(out), "--out", str(whole))["points"] == 200
    with xr.open_dataset(whole) as found:
        assert found.sizes["point"] == 200
    assert command("study", "export", str(out), "--out", str(command.folder / "soils.csv")).code == 0
    # Again: nothing is left to do.
    assert command("study", "run", str(study), "--out", str(out)).code == 0


def test_what_is_wrong_is_named(command: Command, study: Path) -> None:
    study.write_text(STUDY.replace("posture.boom", "posture.bom").replace("count = 5", "count = 0"))
    refused = command("study", "run", str(study))
    assert refused.code == 2
    assert "vary[1].count = 0: must be a whole number" in refused.stderr
    study.write_text(STUDY.replace("posture.boom", "posture.bom"))
    refused = command("study", "run", str(study))
    assert "did you mean 'boom'" in refused.stderr
    assert command("study", "run", "article").code == 2
    assert "is a study" in command("select", "excavator-study").stderr
    assert "no study.json" in command("study", "status", str(command.folder)).stderr
    assert "must end in .nc or .csv" in command("study", "export", str(command.folder), "--out", "x.txt").stderr


@pytest.mark.long("2")
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_says_how_to_go_on(number: int, tmp_path: Path) -> None:
    text = STUDY.replace('machine = "excavator"', 'problem = "article"').replace('"measures"', '"selection"')
    text = text.replace("posture = [0.5, -1.0]\n", "").replace("chunk = 50", "chunk = 1")
    text = text.replace("posture.boom", "target.x").replace("[0.1, 1.4]", "[-0.2, 0.2]")
    (tmp_path / "slow.toml").write_text(text)
    command = [
        sys.executable,
        "-c",
        "from flexopt.cli import main; main()",
        "study",
        "run",
        "slow.toml",
        "--workers",
        "2",
    ]
    environment = os.environ | {"PYTHONPATH": str(Path(flexopt.__file__).parents[1])}
    with subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True) as process:
        end = time.monotonic() + 60
        while not list(tmp_path.rglob("*.nc")) and time.monotonic() < end:
            time.sleep(0.02)
        process.send_signal(number)
        _, said = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "of 200 chunks are in 'soils', and the same command goes on from there" in said
    assert "Traceback" not in said
    assert files(tmp_path / "soils")


def test_a_signal_that_python_drops_is_remembered() -> None:
    """As what is raised while it forks."""
    with _interruptible() as check:
        check()
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            check()


def test_sensitivity(command: Command) -> None:
    picture = command.folder / "what.png"
    found = command.json(
        "sensitivity", "excavator", "--posture", "0.9929,-2.6306", "--ranges", "payload.mass=0,500", "--ranges",
        "stiffness=0.5,2", "--samples", "64", "--plot", str(picture),
    )  # fmt: skip
    assert found["most"] == ["payload.mass"] * 3
    assert picture.stat().st_size > 10_000
    assert json.dumps(found["total"])
    assert command("sensitivity", "excavator", "--posture", "1,-2", "--samples", "100").code == 2
