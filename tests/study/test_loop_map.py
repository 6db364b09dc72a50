"""Maps of how fast a loop decays."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import flexopt
from tests.cli.command import Command

TEXT = (Path(__file__).parents[2] / "models" / "excavator.toml").read_text(encoding="utf-8")
EXCAVATOR, B = flexopt.load("excavator"), (0.0448, -2.0499)
LOOP = {"kp": 1e4, "kv": 1e3, "dead_time": 0.02}


@pytest.fixture
def command(capsys: Any, tmp_path: Path, monkeypatch: Any) -> Command:
    monkeypatch.chdir(tmp_path)
    return Command(capsys, tmp_path)


def test_over_gain_and_dead_time_each_point_is_that_loop(tmp_path: Path) -> None:
    field = flexopt.map_loop(EXCAVATOR, B, {"kp": (1e3, 1e6), "dead_time": (0, 0.05)}, loop=LOOP, points=(7, 5))
    data = field.dataset
    assert data["decay"].dims == ("dead_time", "kp")
    np.testing.assert_allclose(data["kp"].values, np.geomspace(1e3, 1e6, 7), rtol=1e-12)
    for column, row in ((0, 0), (3, 1), (6, 4), (2, 3)):
        loop = LOOP | {"kp": float(data["kp"][column]), "dead_time": float(data["dead_time"][row])}
        alone = flexopt.outcome(EXCAVATOR, B, loop=loop)
        assert float(data["decay"][row, column]) == pytest.approx(alone.decay, rel=1e-8, abs=1e-9)
        assert float(data["loop_frequency_hz"][row, column]) == pytest.approx(alone.frequency_hz, rel=1e-6)
    text = repr(field)
    assert "one posture, boom 0.0448, stick -2.0499 rad" in text
    assert "Kv 1000 N m s, 200 Hz, dead time 0.02 s; kp and dead_time as they vary" in text
    document = field.to_dict()
    assert document["stable"] == np.mean(data["decay"].values > 0)
    assert document["best_decay"]["value"] == data["decay"].values.max()
    assert json.loads(data.attrs["marks"]) == {"present": [1e4, 0.02]}
    field.to_netcdf(tmp_path / "map.nc")
    with xr.open_dataset(tmp_path / "map.nc") as kept:
        np.testing.assert_array_equal(kept["decay"].values, data["decay"].values)
    drawn = field.plot(tmp_path / "map.png").axes
    assert [axes.get_ylabel() for axes in drawn if axes.get_title()] == 2 * ["dead time of the loop, s"]


@pytest.mark.long
def test_over_soil_and_payload_the_machine_is_another() -> None:
    vary = {"stiffness": (0.5, 2.0), "payload.mass": (0.0, 200.0)}
    field = flexopt.map_loop(EXCAVATOR, B, vary, loop=LOOP, points=(3, 3))
    for row, column in ((0, 0), (1, 2), (2, 1)):
        factor, mass = float(field.dataset["stiffness"][column]), float(field.dataset["payload.mass"][row])
        table = tomllib.loads(TEXT)
        table["base"]["stiffness"] = {name: factor * value for name, value in table["base"]["stiffness"].items()}
        other = flexopt.machine_from_dict(table | {"payload": {"mass": mass}})
        alone = flexopt.outcome(other, B, loop=LOOP)
        assert float(field.dataset["decay"][row, column]) == pytest.approx(alone.decay, rel=1e-8, abs=1e-9)


def test_under_gravity_the_controller_knows_its_own_load_alone() -> None:
    """As runs have it that find their own rest; where feedback holds no such load the map is blank."""
    crane, posture = flexopt.load("truck-crane"), (0.0, 0.9, -1.0, 1.0)
    vary = {"payload.mass": (0.0, 2000.0), "stiffness": (0.5, 1.0)}
    field = flexopt.map_loop(crane, posture, vary, gravity=True, loop="default", points=(3, 2))
    names = [each.name for each in crane.parameters if "stiffness" in each.name]
    own = {each.name: each.value for each in crane.parameters}
    for row, column in ((0, 0), (1, 2)):
        factor, mass = float(field.dataset["stiffness"][row]), float(field.dataset["payload.mass"][column])
        runs = flexopt.simulate_ensemble(
            crane, posture, loop="default", gravity=True, duration=0.05,
            vary={"payload.mass": [mass]} | {name: [factor * own[name]] for name in names},
        )  # fmt: skip
        assert float(field.dataset["decay"][row, column]) == pytest.approx(-runs.linear_growth_rate[0], rel=1e-7)
    assert "falls" not in repr(field)
    assert field.to_dict()["falls"] == 0.0
    weak = flexopt.map_loop(crane, posture, vary, gravity=True, loop={"kp": 2000.0}, points=(3, 2))
    blank = np.isnan(weak.dataset["decay"].values)
    assert 0 < blank.mean() < 1
    assert weak.to_dict()["falls"] == blank.mean()
    assert f"at {100 * blank.mean():.1f} % of them the arm falls" in repr(weak)
    # The load that it knows is held.
    assert not np.isnan(flexopt.map_loop(
        crane, posture, vary | {"payload.mass": (1199.9, 1200.1)}, gravity=True, loop={"kp": 2000.0}, points=(2, 2)
    ).dataset["decay"].values[1]).any()  # fmt: skip


@pytest.mark.long
def test_over_postures_the_loop_stays_and_what_is_left_out_is_told() -> None:
    field = flexopt.map_workspace(EXCAVATOR, over="posture", points=(6, 5), epsilon_max=False, loop={"dead_time": 0.01})
    told: dict[str, Any] = field.options["loop"]
    assert "kp" in told["sources"]
    loop = {"kp": told["kp"], "kv": told["kv"], "dead_time": 0.01, "rate": told["rate"], "drive": told["drive"]}
    seen = 0
    for row, column in np.argwhere(np.isfinite(field.array("decay"))).tolist():
        posture = field.array("posture")[:, row, column]
        alone = flexopt.outcome(EXCAVATOR, posture, loop=loop)
        assert field.array("decay")[row, column] == pytest.approx(alone.decay, rel=1e-7, abs=1e-9)
        seen += 1
    assert seen >= 10


def test_a_machine_in_space_over_placement() -> None:
    machine, posture = flexopt.load("truck-crane"), (0.2, 0.6, -1.0, 1.0)
    field = flexopt.map_loop(
        machine, posture, {"damping": (0.5, 2.0), "dead_time": (0.0, 0.1)}, loop="default", points=(3, 3)
    )
    assert np.isfinite(field.array("decay")).all()


@pytest.mark.parametrize(
    ("vary", "loop", "told"),
    [
        ({"kp": (1, 2)}, LOOP, "two names"),
        ({"kp": (2, 1), "kv": (1, 2)}, LOOP, "reversed"),
        ({"kp": (0, 1), "kv": (1, 2)}, LOOP, "greater than 0"),
        ({"kp": (1, 2), "dead_time": (0, 60)}, LOOP, "dead_time"),
        ({"kp": (1, 2), "dead_time": (0, 0.9)}, LOOP, "samples"),
        ({"kp": (1, 2), "ki": (1, 2)}, LOOP, "pid"),
        ({"kp": (1, 2), "stick.length": (1, 2)}, LOOP, "moves the end-point"),
        ({"kp": (1, 2), "stik.mass": (1, 2)}, LOOP, "stick.mass"),
        ({"stiffness": (0.5, 2), "base.stiffness.rotation": (1, 2)}, LOOP, "twice"),
    ],
)
def test_bad_axes_are_told(vary: Any, loop: Any, told: str) -> None:
    with pytest.raises(flexopt.InputError, match=told):
        flexopt.map_loop(EXCAVATOR, B, vary, loop=loop, points=(3, 3))


@pytest.mark.long
def test_the_command(command: Command, tmp_path: Path) -> None:
    given = ["map", "excavator", "--posture", "0.0448,-2.0499", "--vary", "kp=1e3,1e5", "--vary", "dead_time=0,0.02"]
    found = command(*given, "--loop", "kv=1e3", "--points", "4,3", "--json")
    assert found.document["axes"]["kp"]["points"] == 4
    whole = command("map", "excavator", "--points", "5,5", "--loop", "kp=1e4", "--plot", str(tmp_path / "map.png"))
    assert "the sampled loop is stable at" in whole.stdout
    wrong = command(*given, "--joints", "boom,stick")
    assert wrong.code == 2
    assert "--joints" in wrong.stderr


def test_gains_that_vary_are_those_of_torques_as_given_ones_are() -> None:
    """Of a machine that knows its drives, too, where nothing else is asked for; bounds of gains are of the same kind."""
    machine, posture = flexopt.load("boom-stick-bucket"), (-1.0, -1.5, -1.0)
    field = flexopt.map_loop(machine, posture, {"kp": (1e4, 1e6), "kv": (1e4, 1e5)}, points=(3, 2))
    assert "torque-served joints" in repr(field)
    for column, row in ((1, 1), (0, 0)):
        loop = {name: float(field.dataset[name][k]) for name, k in (("kp", column), ("kv", row))}
        alone = flexopt.outcome(machine, posture, loop=loop)
        assert alone.settings.drive == "torque"
        assert float(field.dataset["decay"][row, column]) == pytest.approx(alone.decay, rel=1e-8)
    ranges = {"kp_range": (1e4, 1e6), "kv_range": (1e4, 1e5)}
    assert flexopt.outcome(machine, posture, loop=ranges).settings.drive == "torque"
    late = flexopt.map_loop(machine, posture, {"dead_time": (0.0, 0.1), "stiffness": (0.5, 2.0)}, points=(3, 2))
    assert "velocity-served joints" in repr(late)
    served = flexopt.map_loop(
        machine, posture, {"kp": (0.5, 2.0), "dead_time": (0.0, 0.1)}, loop="default", points=(3, 2)
    )
    assert "velocity-served joints" in repr(served)
