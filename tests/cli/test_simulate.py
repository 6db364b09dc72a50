"""`flexopt simulate`: keys, files, exit codes, experiment files."""

from __future__ import annotations

from pathlib import Path

import pytest
import xarray as xr

import flexopt
from flexopt.cli import main
from flexopt.errors import ModelError
from flexopt.model.files import shipped_folder, shipped_names
from tests.cli.command import Command

POSTURE = ("simulate", "excavator", "--posture", "0.0448,-2.0499")
EXPERIMENT = """
schema = 1
name = "e"
machine = "excavator"
[simulation]
posture = [0.0448, -2.0499]
duration = 1.0
"""


def test_document(command: Command) -> None:
    document = command.json(
        *POSTURE, "--kp", "1e5", "--kv", "2e3", "--duration", "10", "--rate", "200", "--offset", "0.05,-0.05"
    )
    run = flexopt.simulate(flexopt.load("excavator"), [0.0448, -2.0499])
    assert document["verdict"] == "converges"
    assert document["files"] == {}
    for key in ("growth_rate", "end_error", "peak_base_rotation", "settling_time"):
        assert document[key] == getattr(run, key)
    assert document["provenance"]["options"]["kp"] == [1e5]


def test_text_and_files(command: Command) -> None:
    outcome = command(*POSTURE, "--duration", "1", "--out", "r.nc", "--plot", "r.png", "--animate", "r.gif")
    assert outcome.code == 0, outcome.stderr
    assert "data: r.nc" in outcome.stdout
    assert outcome.stderr == ""
    for name in ("r.nc", "r.png", "r.gif"):
        assert (command.folder / name).stat().st_size > 1000
    with xr.open_dataset(command.folder / "r.nc") as data:
        assert data.sizes["time"] == 201
    assert command(*POSTURE, "--duration", "1", "--out", "r.csv").code == 0
    assert len((command.folder / "r.csv").read_text().splitlines()) == 202


def test_divergence_is_an_answer_and_valid_json(command: Command) -> None:
    document = command.json(*POSTURE, "--kp", "1e12")
    assert document["verdict"] == "grows"
    assert document["end_error"] is None
    assert any("finite" in sentence for sentence in document["warnings"])


@pytest.mark.parametrize(
    "name",
    [
        name
        for name in shipped_names("problems")
        if "[simulation]" in (shipped_folder("problems") / f"{name}.toml").read_text()
    ],
)
def test_shipped_experiments(command: Command, name: str) -> None:
    verdict = command.json("simulate", name)["verdict"]
    assert verdict == ("grows" if name == "article-a" else "converges")


def test_options_override_an_experiment(command: Command) -> None:
    command.write("e.toml", EXPERIMENT)
    assert command.json("simulate", "e.toml")["duration"] == 1.0
    document = command.json("simulate", "e.toml", "--duration", "0.5", "--end-point", "1,1.5", "--elbow", "down")
    assert document["duration"] == 0.5
    assert document["provenance"]["options"]["end_point"] == [1.0, 1.5]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("simulate", "excavator"), "--posture or --end-point"),
        ((*POSTURE, "--kp", "much"), "--kp"),
        ((*POSTURE, "--kp", "nan"), "must be finite"),
        ((*POSTURE, "--rate", "0"), "Hz"),
        ((*POSTURE, "--duration", "-1"), "--duration"),
        ((*POSTURE, "--offset", "1"), "2 angles"),
        ((*POSTURE, "--feedback", "pi"), "pd, pid, robust or none"),
        ((*POSTURE, "--integrator", "euler"), "rk4, dop853 or gauss"),
        ((*POSTURE, "--end-point", "1,1"), "give one of the two"),
        ((*POSTURE, "--out", "r.txt"), ".nc or .csv"),
        ((*POSTURE, "--animate", "r.mp4"), ".gif or .html"),
        ((*POSTURE, "--rate", "5"), "substeps"),
        (("simulate", "excavator", "--posture", "0.5,0"), "singular"),
        (("simulate", "excavator", "--end-point", "9,9"), "reach"),
        (("simulate", "article"), "configuration problem, not an experiment"),
        (("select", "article-a"), "experiment"),
    ],
    ids=lambda value: " ".join(value[-2:]) if isinstance(value, tuple) else "",
)
def test_bad_input(command: Command, arguments: tuple[str, ...], message: str) -> None:
    outcome = command(*arguments)
    assert outcome.code == 2
    assert message in outcome.stderr
    assert "Traceback" not in outcome.stderr
    assert outcome.stdout == ""


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("kp = -1", "simulation.kp"),
        ("kpp = 1", "did you mean 'kp'"),
        ("sensor = { delay = 0.003 }", "simulation.sensor.delay"),
        ("actuator = { rate_limit = 5 }", "bandwidth_hz"),
        ("offset = [1.0]", "simulation.offset"),
        ("base_path = { times = [0, 1], points = [[0.0]] }", "simulation.base_path"),
    ],
)
def test_faults_of_an_experiment(tmp_path: Path, line: str, message: str) -> None:
    path = tmp_path / "e.toml"
    path.write_text(EXPERIMENT + line + "\n")
    with pytest.raises(ModelError) as caught:
        flexopt.load_experiment(path)
    assert message in str(caught.value)
    assert "e.toml" in str(caught.value)


def test_paths_and_the_law_do_not_both_move_the_base(tmp_path: Path) -> None:
    path = tmp_path / "e.toml"
    path.write_text(EXPERIMENT + "base_path = { times = [0, 1], points = [[0.0], [0.1]] }\n[nullspace]\n")
    with pytest.raises(SystemExit) as left:
        main(["simulate", str(path)])
    assert left.value.code == 2
