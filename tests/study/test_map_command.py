"""`flexopt map`: options, files, streams and exit codes."""

import json

import numpy as np
import pytest
import xarray as xr

from tests.cli.command import Command

pytestmark = pytest.mark.filterwarnings("ignore::flexopt.errors.CompilerNotFound")
MAP = ("map", "excavator", "--points", "9,7")


@pytest.fixture
def command(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return Command(capsys, tmp_path)


@pytest.mark.long
def test_document_and_files(command, tmp_path):
    outcome = command(
        *MAP, "--control", "transpose", "--gain", "3e5", "--elbow", "down", "--x-range", "-2,2.5", "--y-range", "0.5,2",
        "--out", "map.nc", "--plot", "map.png", "--json",
    )  # fmt: skip
    assert outcome.code == 0, outcome.stderr
    document = outcome.document
    assert document["axes"]["x"] == {"low": -2.0, "high": 2.5, "points": 9, "unit": "m"}
    assert document["axes"]["y"] == {"low": 0.5, "high": 2.0, "points": 7, "unit": "m"}
    assert (document["control"], document["gain"], document["elbow"]) == ("transpose", 3e5, "down")
    assert outcome.stderr.splitlines()[-1].startswith("postures ")
    dataset = xr.load_dataset(tmp_path / "map.nc", engine="scipy")
    assert dataset.sizes["x"] == 9
    assert json.loads(dataset.attrs["provenance"]) == document["provenance"]
    assert (tmp_path / "map.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    np.testing.assert_allclose(document["variables"]["epsilon_max"]["max"], [dataset["epsilon_max"].max()])


def test_text_and_gravity(command):
    plain, gravity = command(*MAP), command(*MAP, "--gravity", "--over", "posture", "--x-range", "0,1")
    assert plain.code == gravity.code == 0
    assert "end" not in plain.stderr.replace("postures", "")
    assert "Jacobian inverse control over x -3.015 to 3.015 m (9 points)" in plain.stdout
    assert "angle_1 (angle of boom) 0 to 1 rad (9 points)" in gravity.stdout


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--points", "9"), "--points = [9]: must be two whole numbers"),
        (("--points", "9,x"), "--points"),
        (("--points", "9,7.5"), "--points"),
        (("--control", "both"), "--control = 'both'"),
        (("--elbow", "left"), "--elbow"),
        (("--over", "joints"), "--over"),
        (("--x-range", "1,0"), "--x-range"),
        (("--y-range", "1"), "--y-range"),
        (("--gain", "0"), "--gain"),
        (("--posture", "1"), "--posture"),
        (("--out", "map.txt"), "must end in .nc"),
        (("--out", "nowhere/map.nc"), "there is no folder"),
        (("--plot", "map.nc"), "must end in .png"),
        (("--threads", "2"), "--threads"),
    ],
)
def test_bad_options(command, options, words):
    outcome = command(*MAP, *options)
    assert outcome.code == 2
    assert words in outcome.stderr
    assert outcome.stdout == ""


def test_several_faults_in_one_message(command):
    outcome = command(*MAP, "--gain", "-1", "--elbow", "left", "--x-range", "3,1", "--json")
    assert outcome.code == 2
    faults = {fault["field"] for fault in outcome.document["error"]["faults"]}
    assert faults == {"--gain", "--elbow", "--x-range"}


def test_report_folder_that_is_a_file(command):
    command.write("report", "text")
    for folder in ("report", "report/inside"):
        outcome = command("reproduce", "--out", folder)
        assert outcome.code == 2
        assert "is no folder" in outcome.stderr
