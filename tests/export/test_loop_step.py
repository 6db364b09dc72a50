"""The part `loop` of a bundle: its C asks for what the simulated controller of the same `[loop]` asks for."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.errors import FlexoptWarning, InputError
from flexopt.export.bundle import library_of
from tests.export.bundle_library import BundleLibrary

B = (0.0448, -2.0499)
LOOPS: dict[str, tuple[str, Any, dict[str, Any]]] = {
    "limits and dead time": ("excavator", B, {"kp": [1e4, 2e4], "kv": 1e3, "dead_time": 0.01, "torque_limit": 60.0}),
    "integral and filter": ("excavator", B, {"kp": 1e4, "kv": 1e3, "feedback": "pid", "ki": 3e3, "filter_hz": 20.0}),
    "transpose": ("excavator", B, {"kp": 2e3, "kv": 3e2, "control": "transpose"}),
    "damped": ("excavator", B, {"kp": 1e4, "kv": 1e3, "control": "damped:0.3"}),
    "self-motion": ("boom-stick-bucket", (-1.0, -1.2, -0.6), {"kp": 1e6, "kv": 3e5, "nullspace_damping": 2e4}),
    "rates": ("slewing-excavator", (0.2, 0.5, -1.2, -0.5), {"drive": "velocity", "kp": 0.5, "nullspace_damping": 1e4}),
}


@pytest.mark.long("damped", "self-motion", "rates", "limits and dead time", "integral and filter")
@pytest.mark.needs("gcc")
@pytest.mark.parametrize("name", list(LOOPS))
def test_c_asks_for_what_the_simulation_does(name: str, tmp_path: Path) -> None:
    """Sample by sample along a nonlinear run, states of the law handed on."""
    shipped, posture, loop = LOOPS[name]
    machine = flexopt.load(shipped)
    report = flexopt.export_c(machine, tmp_path / "bundle", parts=["kinematics"], loop=loop, posture=posture)
    assert report.parts["loop"] == (f"{report.prefix}_loop_step",)
    source = flexopt.outcome(machine, posture, loop=loop).settings.sources.get("drive")
    assert f"\n  loop: {repr(flexopt.outcome(machine, posture, loop=loop).settings).splitlines()[0]}" in repr(report)
    assert source is None or f" ({source})\n" in repr(report)
    run = flexopt.simulate(machine, posture, loop=loop, duration=0.5)
    c, settings, plant = BundleLibrary(report, tmp_path), run.loop, flexopt.build_plant(machine)
    p, rate = plant.parameter_values, []
    for q, v in zip(run.q, run.v, strict=True):
        rate.append((plant.jacobian.call([q, run.base[0], p])[0].full() @ v).ravel())
    late = round(settings.dead_time * settings.rate)
    states: dict[str, Any] = {"integral": 0.0 * run.target[0]}
    states |= {"filtered_point": run.end_point[0], "filtered_rate": rate[0]}
    inputs = {field["name"] for field in c.operations["loop_step"]["inputs"]}
    asked = []
    for k in range(len(run.time)):
        seen = max(k - late, 0)
        given = {"joint_angles": run.q[k, run.n_passive :], "joint_rates": run.v[k, run.n_passive :]} | states
        given |= {"measured_point": run.end_point[seen], "measured_rate": rate[seen], "placement": run.base[0]}
        given |= {"target_point": run.target[k], "target_rate": 0 * run.target[k]}
        status, out = c("loop_step", **{name: x for name, x in given.items() if name in inputs})
        assert status == "OK"
        states = {key.removeprefix("next_"): value for key, value in out.items() if key.startswith("next_")} or states
        served = settings.drive == "velocity"
        # What a servo makes of the rate asked for: its torque acts on what the joint lacks of it.
        away = out["joint_rate_command"] - run.v[k, run.n_passive :] if served else None
        asked.append(out["torque"] if away is None else settings.servo_gain * away)
    # The last sample's torque acts on nothing any more.
    size = np.abs(run.torque).max()
    np.testing.assert_allclose(np.array(asked)[:-1], run.torque[:-1], rtol=0, atol=1e-9 * size)
    if name == "limits and dead time":
        assert np.isclose(np.abs(run.torque), 60.0).any()


def test_what_a_bundle_says_of_its_loop(tmp_path: Path) -> None:
    """Numbers in README.md and manifest.json, from which the same library is built again."""
    excavator, loop = flexopt.load("excavator"), {"kp": 1e4, "kv": 1e3, "dead_time": 0.01}
    report = flexopt.export_c(excavator, tmp_path, parts=["controller"], loop=loop, posture=B)
    told = json.loads((tmp_path / "manifest.json").read_text())["options"]["loop"]
    found = flexopt.outcome(excavator, B, loop=loop)
    assert told["decay"] == found.decay
    assert told["settings"]["dead_time"] == 0.01
    text = (tmp_path / "README.md").read_text()
    assert f"{found.decay:.4g}/s" in text
    assert f"{1e3 * found.delay_margin:.4g} ms more" in text.replace("\n", " ")
    assert "decays at" in repr(report)
    assert "excavator_loop_step(&in, &parameters, &out" in text
    again = library_of(report.manifest)
    names = [operation.name for operation in again.all_operations]
    assert names == ["torque_transpose", "torque_inverse", "loop_step"]
    assert again.header(report.bundle_sha256) == (tmp_path / "include" / "excavator_control.h").read_text()


@pytest.mark.long("rates")
@pytest.mark.parametrize("name", list(LOOPS))
def test_states_are_spoken_of_where_there_are_some(name: str, tmp_path: Path) -> None:
    shipped, posture, loop = LOOPS[name]
    flexopt.export_c(flexopt.load(shipped), tmp_path, parts=["loop"], loop=loop, posture=posture)
    text = (tmp_path / "README.md").read_text()
    assert ("hand in at the next call" in text.replace("\n", " ")) == (name == "integral and filter")
    assert ("what is called next_ is handed in" in text) == (name == "integral and filter")


@pytest.mark.long
def test_a_self_motion_that_nothing_brakes_is_told(tmp_path: Path) -> None:
    machine, posture = flexopt.load("boom-stick-bucket"), (-1.0, -1.2, -0.6)
    loop = {"kp": 1e6, "kv": 3e5}
    served = {"drive": "velocity", "kp": 0.5}
    for folder, told, options in (
        ("free", True, loop),
        ("braked", False, loop | {"nullspace_damping": 2e4}),
        ("served", False, served),
    ):
        flexopt.export_c(machine, tmp_path / folder, parts=["loop"], loop=options, posture=posture)
        text = (tmp_path / folder / "README.md").read_text()
        assert ("nothing here brakes its self-motion" in text) == told


def test_the_unit_of_the_force_is_that_of_the_joints(tmp_path: Path) -> None:
    """An arm with a telescope has two: of its hinges and of its slides."""
    for name, sentence in (
        ("excavator", "f is in N m^2: Jv^+ is in rad/m ("),
        ("truck-crane", "f is in N m^2 for hinges and N for slides: Jv^+ is in rad/m of hinges and m/m of slides"),
    ):
        report = flexopt.export_c(flexopt.load(name), tmp_path / name, parts=["controller"])
        assert sentence in (report.folder / "README.md").read_text()


def written(report: flexopt.ExportReport, path: str) -> str:
    """The text of a file of a bundle, comments and lines run on."""
    return " ".join(re.sub(r"\n *\* ", " ", (report.folder / path).read_text()).split())


@pytest.mark.long
def test_a_torque_says_that_the_weight_is_not_in_it(tmp_path: Path) -> None:
    machine, posture = flexopt.load("truck-crane"), (0.46, 0.86, -1.31, 3.0)
    of_torques = flexopt.export_c(
        machine, tmp_path / "torque", parts=["controller"], posture=posture, loop={"kp": 2e5, "kv": 1e5}
    )
    of_rates = flexopt.export_c(machine, tmp_path / "rate", parts=["loop"], posture=posture, loop={"drive": "velocity"})
    sentence = "The torque does not carry the arm's weight"
    for path in ("README.md", "include/truck_crane_control.h"):
        assert written(of_torques, path).count(sentence) == 3
        assert sentence not in written(of_rates, path)
    text = (of_rates.folder / "README.md").read_text()
    assert "without dead time from the end-point's measurement to the command" in text
    assert "dead time of 0 s" not in text
    assert "\n\n## When something is wrong\n" in text


@pytest.mark.long
def test_ranges_and_units_of_every_member_stand_in_the_header(tmp_path: Path) -> None:
    """Those of joints that differ, of the integral, and of the damper."""
    loop = {"feedback": "pid", "kp": 2e5, "kv": 1e5, "ki": 2e4, "nullspace_damping": 1e4}
    report = flexopt.export_c(
        flexopt.load("truck-crane"), tmp_path, parts=["loop"], posture=(0.46, 0.86, -1.31, 3.0), loop=loop
    )
    header = written(report, "include/truck_crane_control.h")
    assert "from [-3.57727, -0.347266, -2.70727, -0.05] to [3.57727, 1.48727, 0.177266, 3.25]" in header
    assert "/* N m^2 for hinges and N for slides; part of f, as the last call gave it, at first 0" in header
    assert "a damper on the self-motion is added, 10000 N m s/rad or N s/m" in header
    assert "damper of the self-motion 1e+04 N m s/rad or N s/m" in written(report, "README.md")


def test_the_gain_that_a_loop_bears_is_told_where_it_is_stable(tmp_path: Path) -> None:
    excavator, loop = flexopt.load("excavator"), {"kp": 1e4, "kv": 1e3}
    stable = flexopt.export_c(excavator, tmp_path / "b", parts=["loop"], loop=loop, posture=B)
    assert "may grow until Kp is 2.911e+04 N m;" in written(stable, "README.md")
    without = flexopt.export_c(excavator, tmp_path / "c", parts=["loop"], loop={"kp": 0.0, "kv": 1e3}, posture=B)
    assert "It has no Kp of which a border could be told;" in written(without, "README.md")
    with pytest.warns(FlexoptWarning, match="the loop grows at") as caught:
        grows = flexopt.export_c(excavator, tmp_path / "a", parts=["loop"], loop=loop, posture=(0.992, -2.63))
    assert caught[0].filename == __file__
    assert "may grow until" not in written(grows, "README.md")
    assert "It is not for this posture: `flexopt evaluate`" in written(grows, "README.md")


def test_what_does_not_go_together(tmp_path: Path) -> None:
    excavator, loop = flexopt.load("excavator"), {"kp": 1e4, "kv": 1e3}
    with pytest.raises(InputError, match="parts = 'loop': it needs a loop") as caught:
        flexopt.export_c(excavator, tmp_path, parts=["loop"], posture=B)
    assert [fault.field for fault in caught.value.faults] == ["parts", "posture"]
    with pytest.raises(InputError, match="posture: is needed with loop"):
        flexopt.export_c(excavator, tmp_path, loop=loop)


@pytest.mark.long
def test_with_a_posture_the_loop_of_the_machine_is_exported(tmp_path: Path) -> None:
    loop = {"kp": 1e4, "kv": 1e3, "dead_time": 0.01}
    own = flexopt.machine_from_dict(flexopt.load("excavator").to_dict() | {"loop": loop})
    report = flexopt.export_c(own, tmp_path / "own", parts=["controller"], posture=B)
    assert report.manifest["options"]["loop"]["settings"]["dead_time"] == 0.01
    asked = flexopt.export_c(own, tmp_path / "asked", parts=["controller"], posture=B, loop=loop)
    assert report.bundle_sha256 == asked.bundle_sha256
    assert "loop" not in flexopt.export_c(own, tmp_path / "without", parts=["controller"]).parts


def test_a_faulty_loop_is_not_missed_as_well(tmp_path: Path) -> None:
    asked: dict[str, Any] = {"parts": ["loop"], "posture": (0.9929, -2.6306)}
    for loop, field in (({"ki": 1e4}, "loop"), ({"drive": "nonsense"}, "loop.drive")):
        with pytest.raises(InputError) as caught:
            flexopt.export_c(flexopt.load("excavator"), tmp_path / "c", loop=loop, **asked)
        assert [fault.field.split(".")[0] for fault in caught.value.faults] == ["loop"], field
