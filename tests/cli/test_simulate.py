"""`flexopt simulate`: keys, files, exit codes, experiment files."""

from __future__ import annotations

import inspect
import json
from pathlib import Path

import pytest
import xarray as xr

import flexopt
from flexopt.cli import main
from flexopt.cli.bundles import export_command
from flexopt.cli.simulation import ELSEWHERE, simulate_arguments, simulate_command
from flexopt.errors import ModelError
from flexopt.model.files import shipped_folder, shipped_names
from flexopt.model.simulation import Actuator, Sensor, SimulationOptions
from tests.cli.command import MACHINE, Command, toml

POSTURE = ("simulate", "excavator", "--posture", "0.0448,-2.0499")
EXPERIMENT = """
schema = 1
name = "e"
machine = "excavator"
[simulation]
posture = [0.0448, -2.0499]
duration = 1.0
"""


@pytest.mark.long
def test_what_brakes_self_motion_is_spelt_as_the_command_takes_it(command: Command) -> None:
    asked = ("simulate", "boom-stick-bucket", "--posture=-0.6,-1.2,-0.5", "--duration", "0.1")
    plain = command(*asked, "--kp", "1e4", "--kv", "1e3").stdout
    assert "; --nullspace-damping brakes it" in plain
    real = command(*asked, "--loop", "kp=1e4", "--loop", "kv=1e3").stdout
    assert "; --loop nullspace_damping=C brakes it" in real
    document = command(*asked, "--kp", "1e4", "--kv", "1e3", "--json").document
    assert any("; nullspace_damping brakes it" in warning for warning in document["warnings"])


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


@pytest.mark.long
def test_text_and_files(command: Command) -> None:
    gains = "--kp", "1e5", "--kv", "2e3"
    outcome = command(*POSTURE, *gains, "--duration", "1", "--out", "r.nc", "--plot", "r.png", "--animate", "r.gif")
    assert outcome.code == 0, outcome.stderr
    assert "data: r.nc" in outcome.stdout
    assert outcome.stderr == ""
    for name in ("r.nc", "r.png", "r.gif"):
        assert (command.folder / name).stat().st_size > 1000
    with xr.open_dataset(command.folder / "r.nc") as data:
        assert data.sizes["time"] == 201
    assert command(*POSTURE, "--duration", "1", "--out", "r.csv").code == 0
    assert len((command.folder / "r.csv").read_text().splitlines()) == 202


def test_gains_that_nobody_gave_are_told_of(command: Command) -> None:
    said = "no gains are given, so those of the reproduced article are taken"
    assert said in command(*POSTURE, "--duration", "1").stderr
    for given in (("--kp", "1e5"), ("--loop", "default")):
        assert said not in command(*POSTURE, *given, "--duration", "1").stderr
    assert command("--quiet", *POSTURE, "--duration", "1").stderr == ""


@pytest.mark.long
def test_what_is_told_to_give_instead_is_taken(command: Command) -> None:
    """An FMU for model exchange takes no sampled loop, and whoever is told so is not sent there."""
    asked = ("export", "excavator", "--fmu", "me.fmu", "--kind", "model-exchange", "--posture", "0.0448,-2.0499")
    told = command(*asked, "--duration", "0.1").stderr
    assert told.endswith("are taken; --kp and --kv take others\n")
    assert command(*asked, "--kp", "1e5", "--kv", "1e4", "--duration", "0.1").stderr == ""
    refused = command(*asked, "--loop", "default")
    assert refused.code == 2
    assert "--loop" in refused.stderr
    assert "with model-exchange give kp and kv" in refused.stderr


@pytest.mark.long
def test_the_loop_of_a_machine_file_is_run(command: Command) -> None:
    command.write("m.toml", toml(MACHINE, {"loop.kp": "1e4", "loop.kv": "1e3", "loop.dead_time": "0.01"}))
    asked = ("simulate", "m.toml", "--posture", "0.0448,-2.0499", "--duration", "1")
    run = command(*asked)
    assert "Kp 1e+04 N m, Kv 1000 N m s" in run.stdout
    assert run.stderr == ""
    beside = "in place of the file's whole [loop], rate, dead time and filter included"
    assert f"{beside}, and the gains are those of the reproduced article" in command(*asked, "--rate", "100").stderr
    assert f"{beside}; --loop KEY=VALUE replaces" in command(*asked, "--kp", "2e4").stderr


def test_a_film_on_dark_ground(command: Command) -> None:
    asked = (*POSTURE, "--duration", "1", "--theme", "dark")
    assert command(*asked, "--animate", "r.html").code == 0
    assert "color-scheme: dark; --page" in (command.folder / "r.html").read_text(encoding="utf-8")
    assert "--theme" in command(*asked).stderr


def test_divergence_is_an_answer_and_valid_json(command: Command) -> None:
    document = command.json(*POSTURE, "--kp", "1e12")
    assert document["verdict"] == "grows"
    assert document["end_error"] is None
    assert any("finite" in sentence for sentence in document["warnings"])


def test_every_argument_of_simulate_is_an_option_or_named_as_none(command: Command) -> None:
    """Nothing that a warning or an error names is out of the command's reach without the help saying so."""
    arguments = set(inspect.signature(flexopt.simulate).parameters) - {"machine", "options", "loop"}
    assert set(SimulationOptions.model_fields) == arguments
    spelled = {"hold": "continuous", "gravity_compensation": "uncompensated"}
    known = {parameter.name for parameter in simulate_command.params}
    missing = {name for name in arguments if spelled.get(name, name) not in known}
    assert missing == set(ELSEWHERE)
    text = " ".join(command("simulate", "--help").stdout.split())
    for name in (*ELSEWHERE, *Sensor.model_fields, *Actuator.model_fields):
        assert name in text
    everything = {p.name: None for p in simulate_command.params} | {
        "sensor": ("delay=0",),
        "actuator": ("dead_band=1",),
    }
    given = {
        "posture": "1", "end_point": "1,2", "elbow": "up", "base": "0", "control": "inverse", "feedback": "pd",
        "kp": "1", "kv": "1", "ki": "1", "integral_limit": "1", "gain": "1", "offset": "1", "duration": "1", "rate": "1",
        "continuous": True, "integrator": "rk4", "substeps": "1", "gravity": True, "uncompensated": True,
        "nullspace_damping": "1", "seed": "1",
    }  # fmt: skip
    # What the options say arrives at the call.
    assert set(simulate_arguments(everything | given)) == arguments - set(ELSEWHERE)


def test_an_fmu_takes_what_simulate_takes() -> None:
    """All but what is of one run: its noise and its files."""
    of_fmu = {parameter.name for parameter in export_command.params}
    of_simulate = {parameter.name for parameter in simulate_command.params}
    assert of_simulate - of_fmu == {"seed", "plot", "size", "theme", "animate"}


@pytest.mark.long
def test_tables_of_sensor_and_actuator(command: Command) -> None:
    options = ("--duration", "0.5", "--sensor", "delay=0.02", "--sensor", "noise=1e-4", "--actuator")
    document = command.json(*POSTURE, *options, "torque_limit=1e5,2e5")
    given = document["provenance"]["options"]
    assert given["sensor"] == {"delay": 0.02, "noise": 1e-4}
    assert given["actuator"] == {"torque_limit": [1e5, 2e5]}
    # In an experiment an entry takes the place of the file's; the others stay.
    command.write("e.toml", EXPERIMENT + "[simulation.sensor]\ndelay = 0.01\nnoise = 1e-3\n")
    changed = command.json("simulate", "e.toml", "--sensor", "delay=0.02")["provenance"]["options"]["sensor"]
    assert changed == {"delay": 0.02, "noise": 1e-3}
    for wrong, words in (("delay", "NAME=VALUE"), ("dely=1", "did you mean 'delay'"), ("delay=x", "--sensor delay")):
        outcome = command(*POSTURE, "--sensor", wrong)
        assert outcome.code == 2
        assert words in outcome.stderr
    assert command(*POSTURE, "--sensor", "delay=0", "--sensor", "delay=1").code == 2


@pytest.mark.long
def test_verdicts_that_a_run_alone_gets_wrong(command: Command) -> None:
    """A slow mode that ten seconds do not show; an arm that drifts along its self-motion and settles in 2.2 s."""
    slow = (
        "simulate",
        "excavator",
        "--posture",
        "0.992,-1.4056",
        "--kp",
        "1e3",
        "--kv",
        "2e3",
        "--sensor",
        "delay=0.02",
    )
    document = command.json(*slow)
    assert (document["run_verdict"], document["verdict"]) == ("converges", "undecided")
    assert document["linear_growth_rate"] > 0
    assert "linear loop grows" in document["verdict_reason"]
    assert command.json(*slow, "--duration", "60")["verdict"] == "grows"
    drifting = ("simulate", "slewing-excavator", "--posture", "0.2,0.5,-1.2,-0.5", "--kp", "3e6", "--kv", "6e5")
    document = command.json(*drifting)
    assert document["verdict"] == "converges"
    assert document["settling_time"] < 2.5
    assert document["self_motion_rate"] > 0.01
    assert any("nullspace_damping" in sentence for sentence in document["warnings"])
    braked = command.json(*drifting, "--nullspace-damping", "1e4")
    assert braked["verdict"] == "converges"
    assert braked["self_motion_rate"] < 1e-6
    # The slew's drive could not give what these gains ask for.
    (warning,) = braked["warnings"]
    assert "slew took up to" in warning
    assert warning.endswith("actuator.torque_limit lets drives saturate")


@pytest.mark.long("article-move")
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


def test_a_saved_document_is_what_json_prints_and_can_be_compared(command: Command) -> None:
    run = (*POSTURE, "--kp", "1e4", "--kv", "1e3", "--duration", "1")
    printed = command(*run, "--out", "a.json", "--json").document
    written = json.loads((command.folder / "a.json").read_text(encoding="utf-8"))
    assert written == {key: value for key, value in printed.items() if key != "files"}
    assert command("compare", "a.json", "a.json").code == 0


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
        ((*POSTURE, "--out", "r.txt"), ".nc or .csv or .json"),
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
        ("sensor = { delay = 3.0 }", "simulation.sensor.delay"),
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


def test_loop(command: Command) -> None:
    document = command.json(*POSTURE, "--loop", "kp=1e4", "--loop", "kv=1e3", "--loop", "dead_time=0.02")
    run = flexopt.simulate(flexopt.load("excavator"), [0.0448, -2.0499], loop={"kp": 1e4, "kv": 1e3, "dead_time": 0.02})
    assert document["linear_growth_rate"] == run.linear_growth_rate
    assert document["loop"]["dead_time"] == 0.02
    both = command(*POSTURE, "--loop", "kp=1e4", "--kp", "1e4")
    assert both.code == 2
    assert "--kp: a loop is given, which says this itself" in both.stderr
    (command.folder / "e.toml").write_text(EXPERIMENT)
    loop = {"kp": 1e4, "kv": 1e3}
    own = flexopt.run_experiment(flexopt.load_experiment(command.folder / "e.toml"), loop=loop)
    document = command.json("simulate", "e.toml", "--loop", "kp=1e4", "--loop", "kv=1e3")
    assert document["linear_growth_rate"] == own.linear_growth_rate
