"""`flexopt simulate` and experiment files for machines in space."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flexopt
from flexopt.errors import ModelError
from tests.cli.command import Command
from tests.model.robots.files import URDF

# The robot file's efforts are 1 N m.
pytestmark = [
    pytest.mark.usefixtures("interpreted"),
    pytest.mark.filterwarnings("ignore:nothing in this run:flexopt.errors.FlexoptWarning"),
]

MACHINE = """
name = "arm on tracks"
robot = "arm.urdf"
actuated = ["slew", "boom", "extend"]
locked = { finger_a = 0.04 }
[base]
stiffness = { x = 2e6, z = 4e6, roll = 2e6, pitch = 3e6 }
damping = { x = 4e4, z = 8e4, roll = 4e4, pitch = 4e4 }
[end_point]
link = "tool"
"""
EXPERIMENT = """
schema = 1
name = "reach"
machine = "arm.toml"
[simulation]
posture = [0.2, 0.3, 0.4]
base = [1.0, -2.0, 0.5]
control = "transpose"
kp = [3e3, 3e3, 4e3]
kv = 1e3
gravity = true
duration = 3.0
offset = [0.02, -0.02, 0.01]
sensor = { delay = 0.005 }
actuator = { torque_limit = [1e5, 1e5, 1e4] }
"""


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Command:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").write_text(URDF, encoding="utf-8")
    (tmp_path / "arm.toml").write_text(MACHINE, encoding="utf-8")
    return Command(capsys, tmp_path)


def test_a_machine_and_the_same_from_an_experiment(command: Command) -> None:
    command.write("run.toml", EXPERIMENT)
    experiment = flexopt.load_experiment("run.toml")
    made = flexopt.run_experiment(experiment)
    assert made.q.shape == (601, 7)
    assert made.verdict == "converges"
    assert made.end_error < 0.2 * np.linalg.norm(made.error[0])
    np.testing.assert_array_equal(made.base[0], [1.0, -2.0, 0.5])

    document = command.json("simulate", "run.toml", "--out", "r.csv")
    for key in ("verdict", "growth_rate", "end_error", "peak_base_rotation"):
        assert document[key] == getattr(made, key)
    header = (command.folder / "r.csv").read_text(encoding="utf-8").splitlines()[0]
    assert "torque_boom_Nm,torque_extend_N,energy_J" in header

    alone = command.json(
        "simulate", "arm.toml", "--posture", "0.2,0.3,0.4", "--base", "1,-2,0.5", "--control", "transpose",
        "--kp", "3e3,3e3,4e3", "--kv", "1e3", "--gravity", "--duration", "3", "--offset", "0.02,-0.02,0.01",
    )  # fmt: skip
    assert alone["verdict"] == "converges"
    assert alone["end_error"] == pytest.approx(document["end_error"], rel=0.5)


def test_an_end_point_names_a_posture(command: Command) -> None:
    machine = flexopt.load("arm.toml")
    plant = flexopt.build_plant(machine)
    p, base = plant.parameter_values, np.array([0.0, 0.0, 0.3])
    point = plant.end_point(plant.rest(base, [0.2, 0.3, 0.4], p), base, p).full().ravel()
    made = flexopt.simulate(machine, end_point=point, base=base, duration=0.1, kp=1e4, kv=1e3)
    np.testing.assert_allclose(made.target[0], point, atol=1e-6)


@pytest.mark.long
def test_the_nullspace_law_goes_from_an_end_point_in_space(command: Command) -> None:
    """With no word on the base, which then stands at the origin."""
    gives = MACHINE.replace("x = 2e6,", "x = 2e6, y = 2e6, yaw = 3e6,")
    (command.folder / "arm.toml").write_text(gives, encoding="utf-8")
    machine = flexopt.load("arm.toml")
    plant = flexopt.build_plant(machine)
    p, base = plant.parameter_values, np.zeros(3)
    point = plant.end_point(plant.rest(base, [0.2, 0.3, 0.4], p), base, p).full().ravel().tolist()
    law = f"end_point = {point}\nduration = 0.2\nkp = 1e4\nkv = 1e3\n\n[nullspace]\nduration = 0.2\n"
    command.write("way.toml", f'name = "way"\nmachine = "arm.toml"\n\n[simulation]\n{law}')
    experiment = flexopt.load_experiment("way.toml")
    made = flexopt.run_experiment(experiment)
    np.testing.assert_allclose(made.target[0], point, atol=1e-6)
    assert np.any(made.base[-1] != made.base[0])
    still = flexopt.SimulationOptions(end_point=point, duration=0.2, kp=1e4, kv=1e3, base_path=None)
    same = flexopt.run_experiment(experiment.model_copy(update={"simulation": still}))
    np.testing.assert_array_equal(same.base, made.base)


def test_faults_of_an_experiment(command: Command) -> None:
    faulty = EXPERIMENT.replace("kv = 1e3", "kv = [1.0, 2.0]").replace("base = [1.0, -2.0, 0.5]", "base = [1.0]")
    command.write("run.toml", faulty.replace("posture = [0.2, 0.3, 0.4]", "posture = [0.2, 3.0, 0.4]"))
    with pytest.raises(ModelError) as caught:
        flexopt.load_experiment("run.toml")
    message = str(caught.value)
    for word in (
        "simulation.kv = [1.0, 2.0]",
        "3 task axes",
        "simulation.base = [1.0]",
        "simulation.posture (boom) = 3.0",
    ):
        assert word in message, message
    outcome = command("simulate", "arm.toml", "--posture", "0.2,0.3")
    assert outcome.code == 2
    assert "needs 3 numbers, one for each actuated joint" in " ".join(outcome.stderr.split())
