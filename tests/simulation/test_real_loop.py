"""`flexopt.simulate(loop=…)`: the run's linear loop beside that of `flexopt.outcome`, which is put together elsewhere."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.cli import main
from flexopt.errors import InputError, ModelError
from flexopt.model.files import shipped_names
from flexopt.model.parameter_values import with_parameters
from flexopt.model.simulation_faults import BROUGHT, BROUGHT_BY_TABLES
from flexopt.plant import build_plant

POSTURE = (0.0448, -2.0499)
LOOPS = {
    "torque": {"kp": 1e4, "kv": 1e3, "dead_time": 0.02},
    "pid": {"feedback": "pid", "kp": 1e4, "kv": 1e3, "ki": 1e3, "filter_hz": 40.0, "dead_time": 0.005},
    "servo": {"kp": 5e3, "kv": 1e3, "bandwidth_hz": 12.0, "rate_limit": 1e6, "dead_time": 0.01},
    "rates": {"kp": 0.7, "kv": 0.1, "drive": "velocity", "servo_gain": 2e5, "rate": 100.0, "dead_time": 0.03},
}


@pytest.mark.parametrize(("name", "gravity"), [("torque", True), ("pid", False), ("servo", True), ("rates", False)])
def test_decays_as_the_loop_for_small_motions(name: str, *, gravity: bool) -> None:
    loop = LOOPS[name]
    machine = flexopt.load("excavator")
    run = flexopt.simulate(machine, POSTURE, loop=loop, duration=0.2, gravity=gravity)
    told = flexopt.outcome(machine, POSTURE, loop=loop, gravity=gravity)
    # Two eigenvalue problems of some ten states.
    assert run.linear_growth_rate == pytest.approx(-told.decay, abs=1e-9)
    assert run.loop is not None
    np.testing.assert_array_equal(run.loop.kp, told.settings.kp)


@pytest.mark.long("boom-stick-bucket", "mobile-manipulator", "slewing-excavator", "truck-crane")
@pytest.mark.filterwarnings("ignore:the controller does not brake:flexopt.FlexoptWarning")
@pytest.mark.parametrize("name", shipped_names("models"))
def test_every_machine_with_what_follows_from_it(name: str) -> None:
    machine = flexopt.load(name)
    rng = np.random.default_rng(3)
    limits = np.clip(np.array(machine.limits), -2.5, 2.5)
    plant = build_plant(machine)
    tried = limits[:, :1] + (limits[:, 1:] - limits[:, :1]) * rng.uniform(0.2, 0.8, (len(limits), 200))
    base = np.zeros((plant.n_base, tried.shape[1]))
    margin = plant.singularity_sine_squared(base, tried, plant.parameter_values).full().ravel()
    posture = tried[:, int(np.nanargmax(margin))]
    run = flexopt.simulate(machine, posture, loop="default", duration=0.1)
    told = flexopt.outcome(machine, posture, loop="default")
    assert run.linear_growth_rate == pytest.approx(-told.decay, abs=1e-8)
    assert "dead_time: none is given" in repr(run)


def test_a_slowest_motion_that_does_not_swing_is_told_as_such() -> None:
    """Drives that serve rates let the end-point creep to its target at kp, which no mode of the base does."""
    machine = flexopt.load("excavator")
    creeps = flexopt.simulate(machine, POSTURE, loop=LOOPS["rates"] | {"kp": 0.02}, duration=0.2)
    assert creeps.linear is not None
    assert creeps.linear.frequency_hz == pytest.approx(0.0, abs=1e-6)
    assert creeps.linear.growth_rate == pytest.approx(-0.02, rel=0.1)
    assert "/s of the linear loop, a motion without oscillation)" in repr(creeps)
    swings = flexopt.simulate(machine, POSTURE, loop=LOOPS["torque"], duration=0.2)
    assert "/s of the linear loop)" in repr(swings)


@pytest.mark.long
@pytest.mark.parametrize(("drive", "drifts"), [("torque", True), ("velocity", False)])
def test_drives_that_follow_rates_hold_the_self_motion(drive: str, *, drifts: bool) -> None:
    """A warning speaks of it where, set going, it goes on: not where it has ended after a second."""
    machine, posture = flexopt.load("truck-crane"), np.array([0.4, 0.9, -0.7, 0.8])
    plant, loop = build_plant(machine), {"drive": drive}
    p, base = plant.parameter_values, np.zeros(plant.n_base)
    own = np.linalg.svd(plant.rigid_jacobian(plant.rest(base, posture, p), base, p).full())[2][-1]
    start = {"offset": [[0.0] * 4], "rates": [[0.0] * plant.n_passive + (0.01 * own).tolist()]}
    going = flexopt.simulate_ensemble(machine, posture, vary=start, loop=loop, duration=1.0, keep="trajectories")
    left = abs(going.dataset["v"].to_numpy()[0, -1, plant.n_passive :] @ own)
    assert left > 5e-3 if drifts else left < 1e-4
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run = flexopt.simulate(machine, posture, loop=loop, duration=0.1)
    assert any("does not brake the arm's self-motion" in each for each in run.warnings) == drifts


@pytest.mark.parametrize("dead_time", [0.0004, 0.013, 0.0298])
def test_dead_times_lie_anywhere_between_samples(dead_time: float) -> None:
    """The nonlinear run ends as the exact linear loop says; half a sample more would be another."""
    machine, loop = flexopt.load("excavator"), {"kp": 1e4, "kv": 1e3, "dead_time": dead_time, "rate": 50.0}
    run = flexopt.simulate(machine, POSTURE, loop=loop, duration=60.0, offset=(1e-3, -1e-3))
    found = flexopt.outcome(machine, POSTURE, loop=loop)
    assert run.linear_growth_rate == pytest.approx(-found.decay, abs=1e-9)
    other = flexopt.outcome(machine, POSTURE, loop=loop | {"dead_time": dead_time + 0.01})
    # What faster motions leave in 60 s.
    assert abs(run.growth_rate + found.decay) < 0.1 * abs(other.decay - found.decay)


def test_steps_suit_drives_that_brake_hard() -> None:
    """Servos that brake their joints within a millisecond, in samples of 50 ms: steps and iterations follow."""
    machine, loop = flexopt.load("excavator"), {"drive": "velocity", "servo_gain": 2e5, "rate": 20.0, "kp": 1.0}
    run = flexopt.simulate(machine, POSTURE, loop=loop, duration=2.0)
    found = flexopt.outcome(machine, POSTURE, loop=loop)
    assert run.linear_growth_rate == pytest.approx(-found.decay, abs=1e-9)
    assert run.verdict == "converges"


def test_the_target_may_be_given_instead() -> None:
    machine, loop = flexopt.load("excavator"), LOOPS["torque"]
    there = flexopt.evaluate(machine, POSTURE).end_point
    run = flexopt.simulate(machine, end_point=there, elbow="up", loop=loop, duration=0.1)
    found = flexopt.simulate(machine, run.q[0, -2:] - [0.05, -0.05], loop=loop, duration=0.1)
    np.testing.assert_allclose(run.q, found.q, atol=1e-9)


def test_what_the_loop_brings_is_given_once() -> None:
    tables = {name: dict.fromkeys(keys, 1.0) for name, keys in BROUGHT_BY_TABLES.items()}
    tables["actuator"]["levers"] = "each"
    options = {"feedback": "pd", "kp": 1.0, "kv": 1.0, "ki": 0.0, "rate": 100.0, "hold": True}
    options |= {"nullspace_damping": 0.0, "gain": 1.0}
    with pytest.raises(flexopt.InputError) as error:
        flexopt.simulate(flexopt.load("excavator"), POSTURE, loop="default", **options, **tables)
    for name in (*BROUGHT, *(f"{table}.{key}" for table, keys in BROUGHT_BY_TABLES.items() for key in keys)):
        assert f"{name}: a loop is given, which says this itself" in str(error.value)


def test_noise_and_dead_bands_go_with_a_loop() -> None:
    machine, noisy = flexopt.load("excavator"), flexopt.Sensor(noise=1e-4)
    with pytest.warns(flexopt.FlexoptWarning, match="noise"):
        run = flexopt.simulate(
            machine, POSTURE, loop=LOOPS["servo"], sensor=noisy, actuator={"dead_band": 10.0}, duration=0.1
        )
    assert run.linear_growth_rate == pytest.approx(
        -flexopt.outcome(machine, POSTURE, loop=LOOPS["servo"]).decay, abs=1e-9
    )


def test_another_control_than_the_loops_is_refused() -> None:
    with pytest.raises(flexopt.InputError, match="control that is asked for"):
        flexopt.simulate(flexopt.load("excavator"), POSTURE, control="inverse", loop={"control": "transpose"})


@pytest.mark.long
def test_an_fmu_holds_the_same_loop(tmp_path: Path) -> None:
    machine, loop = flexopt.load("excavator"), LOOPS["servo"]
    report = flexopt.export_fmu(machine, tmp_path / "loop.fmu", POSTURE, loop=loop, duration=0.2)
    run = flexopt.simulate(machine, POSTURE, loop=loop, duration=0.2)
    told = np.genfromtxt(report.reference, delimiter=",", names=True)
    shown = [name for name in told.dtype.names if name.startswith("end_point")]
    found = np.array([told[name] for name in shown]).T
    np.testing.assert_allclose(found, run.end_point, atol=1e-9)
    with pytest.raises(flexopt.InputError, match="co-simulation"):
        flexopt.export_fmu(machine, tmp_path / "x.fmu", POSTURE, loop=loop, kind="model-exchange")


FILE = """
name = "late"
machine = "excavator"

[simulation]
posture = [0.0448, -2.0499]
duration = 0.5
{more}

[loop]
kp = 1e4
kv = 1e3
dead_time = 0.01
"""


def test_an_experiment_with_a_loop(tmp_path, capsys):
    """The same run as with the argument, in Python and by the command; another loop takes its place."""
    (tmp_path / "late.toml").write_text(FILE.format(more=""))
    experiment = flexopt.load_experiment(tmp_path / "late.toml")
    loop = {"kp": 1e4, "kv": 1e3, "dead_time": 0.01}
    excavator, own = flexopt.load("excavator"), {"duration": 0.5}
    expected = flexopt.simulate(excavator, (0.0448, -2.0499), loop=loop, **own)
    np.testing.assert_array_equal(flexopt.run_experiment(experiment).q, expected.q)
    main(["simulate", str(tmp_path / "late.toml"), "--json"])
    assert json.loads(capsys.readouterr().out)["end_error"] == expected.end_error
    other = flexopt.simulate(excavator, (0.0448, -2.0499), loop=loop | {"dead_time": 0.02}, **own)
    np.testing.assert_array_equal(flexopt.run_experiment(experiment, loop=loop | {"dead_time": 0.02}).q, other.q)
    main(["simulate", str(tmp_path / "late.toml"), "--json", "--loop", "dead_time=0.02"])
    assert json.loads(capsys.readouterr().out)["end_error"] == other.end_error


def test_an_experiment_that_says_twice_what_its_loop_is(tmp_path):
    text = FILE.format(more="kp = 2e4\nsensor = { delay = 0.01 }").replace("dead_time = 0.01", "rate_limit = 1.0")
    (tmp_path / "twice.toml").write_text(text)
    with pytest.raises(ModelError, match="a loop is given, which says this itself") as caught:
        flexopt.load_experiment(tmp_path / "twice.toml")
    fields = [fault.field for fault in caught.value.faults]
    assert fields == ["simulation.kp", "simulation.sensor.delay", "loop.rate_limit"]
    experiment = flexopt.load_experiment("article-a")
    with pytest.raises(InputError, match="kp: a loop is given, which says this itself"):
        flexopt.run_experiment(experiment, loop={"kp": 1e4, "kv": 1e3})


@pytest.mark.long
def test_the_loops_of_a_report_are_those_of_its_verdict():
    """Where a controller is known and nothing else is said."""
    problem = flexopt.load_problem("article")
    made = flexopt.report(problem, loop={"kp": 1e4, "kv": 1e3}, simulation={"duration": 0.5}, points=6)
    assert set(made.loops) == {"present", "chosen"}
    assert all(loop.run.loop.kp.tolist() == [1e4, 1e4] for loop in made.loops.values())
    assert made.borders == ()
    other = flexopt.report(problem, loop={"kp": 1e4, "kv": 1e3}, simulation={"duration": 0.5, "kp": 2e4}, points=6)
    assert all(loop.run.loop is None for loop in other.loops.values())


def with_own_loop(**loop: float) -> flexopt.Machine:
    machine = flexopt.machine_from_dict(flexopt.load("excavator").to_dict() | {"loop": loop})
    assert isinstance(machine, flexopt.Machine)
    return machine


def test_a_machine_with_a_loop_of_its_own_is_run_with_it() -> None:
    own = {"kp": 1e4, "kv": 1e3, "rate": 100.0, "dead_time": 0.02}
    machine = with_own_loop(**own)
    run = flexopt.simulate(machine, POSTURE, duration=0.1)
    assert run.loop is not None
    assert run.linear_growth_rate == pytest.approx(-flexopt.evaluate(machine, POSTURE).outcome.decay, abs=1e-9)
    np.testing.assert_array_equal(run.q, flexopt.simulate(machine, POSTURE, duration=0.1, loop=own).q)
    # Gains that are given stand for themselves, as on a machine without one.
    given = flexopt.simulate(machine, POSTURE, duration=0.1, kp=1e5, kv=2e3)
    assert given.loop is None
    np.testing.assert_array_equal(given.q, flexopt.simulate(flexopt.load("excavator"), POSTURE, duration=0.1).q)


def test_an_experiment_falls_back_on_the_loop_of_its_machine(tmp_path: Path) -> None:
    shipped = (Path(__file__).parents[2] / "models" / "excavator.toml").read_text(encoding="utf-8")
    own = "\n[loop]\nkp = 1e4\nkv = 1e3\ndead_time = 0.01\n"
    (tmp_path / "m.toml").write_text(shipped + own, encoding="utf-8")
    machine = flexopt.load(tmp_path / "m.toml")
    text = 'name = "e"\nmachine = "m.toml"\n[simulation]\nposture = [0.0448, -2.0499]\nduration = 0.1\n'
    (tmp_path / "e.toml").write_text(text)
    run = flexopt.run_experiment(flexopt.load_experiment(tmp_path / "e.toml"))
    np.testing.assert_array_equal(run.q, flexopt.simulate(machine, POSTURE, duration=0.1).q)
    assert run.loop is not None


@pytest.mark.long("torque")
@pytest.mark.parametrize("name", ["torque", "rates"])
def test_members_of_an_ensemble_are_runs_with_the_loop(name: str) -> None:
    """Also where what varies is the damping that drives add to: the loop is then that of the changed machine."""
    loop = LOOPS[name] | {"dead_time": 0.01}
    machine = flexopt.load("excavator")
    offsets = [[0.01, -0.02], [-0.005, 0.01]]
    together = flexopt.simulate_ensemble(
        machine, POSTURE, vary={"offset": offsets}, loop=loop, duration=0.3, keep="trajectories"
    )
    for k, offset in enumerate(offsets):
        alone = flexopt.simulate(machine, POSTURE, loop=loop, duration=0.3, offset=offset)
        np.testing.assert_allclose(together.dataset["q"].to_numpy()[k], alone.q, rtol=0, atol=1e-10)
        assert together.linear_growth_rate[k] == pytest.approx(alone.linear_growth_rate, rel=1e-9)
    varied = {"boom.joint_damping": [0.0, 4e3], "payload.mass": [0.0, 150.0]}
    several = flexopt.simulate_ensemble(machine, POSTURE, vary=varied, loop=loop, duration=0.1)
    for k, (damping, mass) in enumerate(zip(*varied.values(), strict=True)):
        changed = with_parameters(machine, {"boom.joint_damping": damping, "payload.mass": mass})
        told = flexopt.outcome(changed, POSTURE, loop=loop)
        assert several.linear_growth_rate[k] == pytest.approx(-told.decay, abs=1e-8)
    np.testing.assert_array_equal(several.dataset["boom.joint_damping"], varied["boom.joint_damping"])


def test_gains_that_vary_are_those_of_the_loop() -> None:
    """Of drives that serve rates 1/s, as the loop's own."""
    machine, loop = flexopt.load("excavator"), {"drive": "velocity", "servo_gain": 2e5, "kv": 0.0}
    several = flexopt.simulate_ensemble(machine, POSTURE, vary={"kp": [1.0, 2.0]}, loop=loop, duration=0.1)
    for k, kp in enumerate((1.0, 2.0)):
        alone = flexopt.simulate(machine, POSTURE, loop=loop | {"kp": kp}, duration=0.1)
        assert several.linear_growth_rate[k] == pytest.approx(alone.linear_growth_rate, rel=1e-9)
        assert float(several.dataset["end_error"][k]) == pytest.approx(alone.end_error, rel=1e-9)
    np.testing.assert_array_equal(several.dataset["kp"], [1.0, 2.0])


def test_an_ensemble_falls_back_on_the_loop_of_its_machine() -> None:
    machine = with_own_loop(**LOOPS["torque"])
    vary = {"payload.mass": [0.0, 100.0]}
    own = flexopt.simulate_ensemble(machine, POSTURE, vary=vary, duration=0.2)
    given = flexopt.simulate_ensemble(flexopt.load("excavator"), POSTURE, vary=vary, loop=LOOPS["torque"], duration=0.2)
    np.testing.assert_array_equal(own.linear_growth_rate, given.linear_growth_rate)
    # Gains that vary are the whole controller, as of `simulate`.
    gains = flexopt.simulate_ensemble(machine, POSTURE, vary={"kp": [1e4]}, kv=1e3, duration=0.2)
    assert gains.linear_growth_rate[0] == flexopt.simulate(machine, POSTURE, kp=1e4, kv=1e3).linear_growth_rate


@pytest.mark.parametrize("drive", ["torque", "velocity"])
def test_torques_account_for_the_energy(drive: str) -> None:
    """What the drives give and the dampers take is what the energy changes by: torques are those that act.

    Of drives that serve rates the servo's braking is a part of them, most of it once the joints move.
    """
    machine = flexopt.load("excavator")
    plant = build_plant(machine)
    loop = {"rate": 2e4, "nullspace_damping": 0.0} | (
        {"drive": "velocity", "servo_gain": 2e5, "kp": 3.0} if drive == "velocity" else {"kp": 1e4, "kv": 1e3}
    )
    run = flexopt.simulate(machine, POSTURE, loop=loop, duration=0.2)
    members = {"offset": [[0.05, 0.05]]}
    same = flexopt.simulate_ensemble(machine, POSTURE, vary=members, loop=loop, duration=0.2, keep="trajectories")
    damping = plant.damping(plant.parameter_values).full()
    for time, v, torque, energy in (
        (run.time, run.v, run.torque, run.energy),
        (run.time, *(same.dataset[name].to_numpy()[0] for name in ("v", "torque", "energy"))),
    ):
        power = np.sum(torque * v[:, plant.n_passive :], axis=1) - np.einsum("ki,ij,kj->k", v, damping, v)
        # Commands are held for a sample of 50 µs; powers go up to some kW.
        gained = np.concatenate([[0.0], np.cumsum(np.diff(time) * (power[1:] + power[:-1]) / 2)])
        np.testing.assert_allclose(gained, energy - energy[0], atol=2e-3 * np.ptp(energy))
        assert np.ptp(energy) > 5.0


@pytest.mark.parametrize("given", [{"drive": "velocity", "servo_gain": 2e5}, {"servo_gain": 2e5}])
def test_limits_of_torques_go_with_drives_of_torques(given: dict[str, object]) -> None:
    """A servo brakes by its torque, too: a limit of what its rates ask for alone would not be one of the drive."""
    limits = {"torque_limit": 500.0, "rate_limit": 1e5, "bandwidth_hz": 10.0}
    with pytest.raises(InputError) as error:
        flexopt.simulate(flexopt.load("excavator"), POSTURE, loop=given | limits)
    told = [fault.field.rpartition(".")[2] for fault in error.value.faults if 'drive = "torque"' in fault.sentence]
    assert told == ["torque_limit", "rate_limit"]
    flexopt.simulate(flexopt.load("excavator"), POSTURE, loop=limits, duration=0.1)


def test_limits_go_with_what_the_control_makes_of_the_drive() -> None:
    """A machine that names efforts and speeds has drives of rates unless it is told otherwise; a transpose wants torques."""
    machine, posture = flexopt.load("boom-stick-bucket"), [-1.354, -1.5032, -0.2305]
    limits = {"torque_limit": 1e5}
    with pytest.raises(InputError, match="efforts and speeds in the file make it velocity"):
        flexopt.simulate(machine, posture, loop=limits, duration=0.05)
    for given in ({"control": "transpose"}, {"loop": {"drive": "torque"}}):
        asked = {"loop": limits | given.get("loop", {})} | {k: v for k, v in given.items() if k != "loop"}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            run = flexopt.simulate(machine, posture, duration=0.05, **asked)
        assert np.abs(run.torque).max() <= 1e5
    flexopt.machine_from_dict(machine.to_dict() | {"loop": limits})


def test_a_run_is_of_the_machine_that_was_given(tmp_path: Path) -> None:
    """However its drives brake it, so that runs with other gains are compared as those of one machine."""
    machine, posture = flexopt.load("excavator"), (0.0448, -2.0499)
    asked: dict[str, Any] = {"loop": {"drive": "velocity", "servo_gain": 2e5}, "duration": 0.1}
    run = flexopt.simulate(machine, posture, **asked)
    ensemble = flexopt.simulate_ensemble(machine, posture, vary={"payload.mass": [0.0, 10.0]}, **asked)
    fmu = flexopt.export_fmu(machine, tmp_path / "loop.fmu", posture, **asked)
    told = flexopt.evaluate(machine, posture).provenance["machine_sha256"]
    assert told == machine.content_hash
    assert {each.provenance["machine_sha256"] for each in (run, ensemble, fmu)} == {told}
