"""`flexopt atlas`: options, files, streams and exit codes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import xarray as xr

from tests.cli.command import Command

pytestmark = pytest.mark.filterwarnings("ignore::flexopt.errors.CompilerNotFound")
PART = ("atlas", "excavator", "--x-range", "0.5,1.5", "--y-range", "-2,-1", "--cells", "16,16")


@pytest.fixture
def command(capsys: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Command:
    monkeypatch.chdir(tmp_path)
    return Command(capsys, tmp_path)


def test_document_and_files(command: Command, tmp_path: Path) -> None:
    outcome = command(*PART, "--out", "atlas.nc", "--plot", "atlas.png", "--json")
    assert outcome.code == 0, outcome.stderr
    document = outcome.document
    assert (document["machine"], document["control"], document["cells"]) == ("excavator", "inverse", [16, 16])
    assert document["x_range"] == [0.5, 1.5]
    assert document["varied"] == document["joints"] == ["boom", "stick"]
    (point,) = document["doubly_robust"]
    assert point["modes"] == [1, 2]
    assert point["posture"] == pytest.approx([0.992, -1.4056], abs=1e-4)
    dataset = xr.load_dataset(tmp_path / "atlas.nc", engine="scipy")
    assert dataset["point_posture"].values[:, 0].tolist() == point["posture"]
    assert json.loads(dataset.attrs["provenance"]) == document["provenance"]
    assert (tmp_path / "atlas.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    command(*PART, "--out", "atlas.json")
    assert json.loads((tmp_path / "atlas.json").read_text(encoding="utf-8")) == document


def test_text(command: Command) -> None:
    plain, other = command(*PART), command(*PART, "--control", "transpose", "--gravity")
    assert plain.code == other.code == 0
    assert plain.stderr == other.stderr == ""
    assert "excavator: robust postures under Jacobian inverse control, boom 0.5 to 1.5 rad" in plain.stdout
    assert "w1 = w2 = 0 at (0.9920, -1.4056)" in plain.stdout
    assert "smaller loops may be missed" in plain.stdout
    assert "no posture in which two measures are zero" in other.stdout


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--cells", "9"), "--cells = [9]: must be two whole numbers"),
        (("--cells", "9,x"), "--cells"),
        (("--control", "both"), "--control = 'both'"),
        (("--joints", "boom,crowd"), "'crowd' not among the actuated joints: boom, stick"),
        (("--posture", "1"), "--posture"),
        (("--base", "1,2"), "--base"),
        (("--x-range", "1,0"), "--x-range"),
        (("--y-range", "0,9"), "more than a turn of stick"),
        (("--out", "atlas.txt"), "must end in .nc or .json"),
        (("--plot", "nowhere/atlas.png"), "no folder"),
    ],
)
def test_bad_options(command: Command, options: tuple[str, ...], words: str) -> None:
    outcome = command(*PART, *options)
    assert outcome.code == 2
    assert words in outcome.stderr
    assert outcome.stdout == ""


@pytest.mark.long
def test_machines_in_space_have_points(command: Command) -> None:
    slew = ("atlas", "slewing-excavator", "--x-range", "1.2,2", "--y-range", "-0.2,0.3", "--cells", "16,16")
    outcome = command(*slew, "--posture=-1.2,-0.5", "--plot", "atlas.png")
    assert outcome.code == 0, outcome.stderr
    assert "mode 1: w1 = 0 at 1 posture: (1.6486, 0.0573, -1.2000, -0.5000)" in outcome.stdout
    missing = command(*slew)
    assert missing.code == 2
    assert "needs 2 angles in rad, for the joints that do not vary (stick, bucket)" in missing.stderr


def test_what_is_missing_is_named_as_an_option(command: Command) -> None:
    outcome = command("atlas", "boom-stick-bucket")
    assert outcome.code == 2
    assert "--posture: needs 1" in outcome.stderr
    assert "None" not in outcome.stderr
