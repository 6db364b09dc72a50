"""FMUs: FMPy validates and simulates them; what they compute is what `flexopt.simulate` computes.

FMPy is the importer in all tests; its CVode integrates model exchange.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import warnings
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
from click.testing import CliRunner
from fmpy.validation import validate_fmu
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import flexopt
from flexopt.cli.bundles import export_command
from flexopt.compiled import compilers
from flexopt.errors import CompilerNotFound, InputError, NoSolutionFound, SingularPosture
from flexopt.export.fmu import FmuReport, package
from flexopt.export.fmu.units import unit_of
from flexopt.model import Machine, machine_from_dict
from flexopt.model.parameter_values import with_parameters
from flexopt.simulation.scenario import build_scenario, checked_options
from tests.export.fmu_library import (
    TOLERANCE,
    VERSIONS,
    WARNINGS,
    Slave,
    check_setup,
    opened,
    reference,
    run,
    shown,
    sources,
    worst,
)
from tests.oracles.machines import random_machine, regular_posture, seeds

EXCAVATOR = flexopt.load("excavator")
POSTURE = [0.0448, -2.0499]  # the article's B, where the loop converges


def three_joints() -> Machine:
    """Three actuated joints on a base that cannot turn."""
    data = EXCAVATOR.to_dict()
    bucket = {"name": "bucket", "length": 0.6, "com": 0.3, "com_offset": 0.05, "mass": 150.0, "inertia": 9.0}
    base = data["base"] | {"stiffness": {"x": 4e6, "y": 6e6}, "damping": {"x": 5e3, "y": 5e3}}
    links = [*data["links"], bucket | {"joint_damping": 20.0}]
    return machine_from_dict(data | {"name": "three joints", "base": base, "links": links})


def flexible_joint() -> Machine:
    """A passive hinge in the arm, on a base that only turns, so that the placement is a parameter."""
    data = EXCAVATOR.to_dict()
    wrist = {"name": "wrist", "length": 0.4, "com": 0.2, "mass": 60.0, "inertia": 2.0}
    wrist |= {"passive": True, "stiffness": 2e5, "damping": 30.0, "rest": 0.2}
    base = data["base"] | {"stiffness": {"rotation": 1.112e6}, "damping": {"rotation": 2e3}}
    return machine_from_dict(data | {"name": "2-wrist", "base": base, "links": [*data["links"], wrist]})


THREE, WRIST = three_joints(), flexible_joint()
EVERYTHING: dict[str, Any] = {
    "feedback": "pid", "ki": 1e4, "kp": (1e5, 8e4), "integral_limit": 2e4, "gravity": True, "base": 0.4,
    "actuator": {"bandwidth_hz": 15.0, "torque_limit": 6e4, "dead_band": 5.0, "rate_limit": 2e6},
    "sensor": {"delay": 0.01, "resolution": 1e-5, "rate_resolution": 1e-5},
}  # fmt: skip
CASES: dict[str, tuple[Machine, dict[str, Any]]] = {
    "excavator": (EXCAVATOR, {"posture": POSTURE}),
    "everything": (EXCAVATOR, {"posture": POSTURE, **EVERYTHING, "duration": 4.0}),
    "robust": (EXCAVATOR, {"posture": POSTURE, "feedback": "robust", "duration": 4.0}),
    "transpose, gauss": (EXCAVATOR, {"posture": [1.1, -1.2], "control": "transpose", "kp": 2e4, "integrator": "gauss",
                                     "kv": 4e3, "duration": 2.0}),
    "continuous, dop853": (EXCAVATOR, {"posture": POSTURE, "hold": False, "integrator": "dop853", "duration": 2.0}),
    "three joints": (THREE, {"posture": [0.3, -1.1, -0.7], "nullspace_damping": 2e3, "rate": 500.0, "duration": 4.0}),
    "wrist": (WRIST, {"posture": [0.2, -1.4], "base": -1.5, "gravity": True, "substeps": 4, "duration": 4.0}),
    "delay between samples": (EXCAVATOR, {"posture": POSTURE, "kp": 1e4, "kv": 1e3, "sensor": {"delay": 0.0133},
                                          "duration": 2.0}),
}  # fmt: skip


def export(folder: Path, machine: Machine = EXCAVATOR, name: str = "model", **options: Any) -> FmuReport:
    return flexopt.export_fmu(machine, folder / f"{name}.fmu", **{"posture": POSTURE, **options})


@pytest.fixture(autouse=True, scope="module")
def quick() -> Iterator[None]:
    """Libraries without optimisation: they compute the same, and most of the time here is the compiler's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(package, "level_for", lambda _: ("-O0",))
        yield


@pytest.fixture(scope="module")
def folder(quick: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fmu")


@pytest.fixture(scope="module", params=VERSIONS)
def report(folder: Path, request: pytest.FixtureRequest) -> FmuReport:
    return export(folder, name=f"excavator-{request.param}", version=request.param)


@pytest.mark.long("2.0-model-exchange", "2.0-co-simulation", "3.0-model-exchange")
@pytest.mark.parametrize("kind", ["co-simulation", "model-exchange"])
@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_finds_no_problem(tmp_path: Path, version: str, kind: str) -> None:
    """With a passive joint in the arm and a placement that is a parameter; other loops where they are compared."""
    wrist = export(tmp_path, WRIST, name="wrist", version=version, kind=kind, duration=0.1, posture=[0.2, -1.4])
    assert validate_fmu(str(wrist.path)) == []


def test_ten_seconds_are_those_of_simulate(report: FmuReport) -> None:
    assert validate_fmu(str(report.path)) == []
    expected = shown(flexopt.simulate(EXCAVATOR, POSTURE))
    result = run(report, stop_time=10.0)
    assert len(result) == 2001
    assert set(report.outputs) == set(expected)
    assert worst(result, expected, report.outputs) < TOLERANCE
    assert worst(result, reference(report), report.outputs) < TOLERANCE


# The versions differ in what is around the loop: that is in both, with everything in it, other loops in turns.
@pytest.mark.long(
    "everything-3.0",
    "continuous, dop853-2.0",
    "robust-2.0",
    "transpose, gauss-3.0",
    "three joints-3.0",
    "wrist-2.0",
    "everything-2.0",
)
@pytest.mark.parametrize(
    ("case", "version"),
    [*((case, VERSIONS[k % 2]) for k, case in enumerate(CASES)), ("everything", VERSIONS[0])],
)
def test_other_loops_are_those_of_simulate(tmp_path: Path, case: str, version: str) -> None:
    machine, options = CASES[case]
    made = export(tmp_path, machine, version=version, **options)
    duration = options.get("duration", 10.0)
    expected = shown(flexopt.simulate(machine, **options))
    result = run(made, stop_time=duration)
    assert validate_fmu(str(made.path)) == []
    # Where measurements are rounded, a rounding error may pass a step of the sensor: none does here.
    assert worst(result, expected, made.outputs) < TOLERANCE


@pytest.mark.long
@pytest.mark.parametrize("version", VERSIONS)
def test_model_exchange_agrees_as_far_as_cvode_is_accurate(tmp_path: Path, version: str) -> None:
    made = export(tmp_path, version=version, kind="model-exchange", duration=10.0)
    assert validate_fmu(str(made.path)) == []
    expected = shown(flexopt.simulate(EXCAVATOR, POSTURE, hold=False, integrator="dop853"))
    errors = []
    for tolerance in (1e-9, 1e-12):
        result = run(made, stop_time=10.0, solver="CVode", relative_tolerance=tolerance)
        errors.append(worst(result, expected, [n for n in made.outputs if n.startswith(("q.", "end_point"))]))
    # CVode's global error: some 20 times its tolerance after 10 s of lightly damped oscillation.
    assert errors[1] < 1e-10
    assert errors[1] < errors[0] / 100


@pytest.mark.long
def test_model_exchange_with_states_of_actuators_and_law(tmp_path: Path) -> None:
    options = {k: v for k, v in EVERYTHING.items() if k != "sensor"}
    options["actuator"] = {"bandwidth_hz": 15.0}
    made = export(tmp_path, kind="model-exchange", duration=3.0, **options)
    assert validate_fmu(str(made.path)) == []
    expected = shown(flexopt.simulate(EXCAVATOR, POSTURE, hold=False, integrator="dop853", duration=3.0, **options))
    result = run(made, stop_time=3.0, solver="CVode", relative_tolerance=1e-12)
    assert worst(result, expected, [n for n in made.outputs if n.startswith(("q.", "end_point"))]) < 1e-10


@pytest.mark.long("2.0")
def test_changed_parameters_are_a_changed_machine(report: FmuReport, folder: Path) -> None:
    data = EXCAVATOR.to_dict()
    stick = data["links"][1] | {"length": 1.2, "com_offset": 0.03, "joint_damping": 15.0}
    base = data["base"] | {"stiffness": data["base"]["stiffness"] | {"rotation": 9e5}, "rest_angle": 1.2}
    changed = machine_from_dict(data | {"payload": {"mass": 300.0}, "base": base, "links": [data["links"][0], stick]})
    posture = [0.1, -1.9]
    options = {"kp": (5e4, 6e4), "kv": 3e3, "offset": (0.02, 0.03), "base": -0.7, "duration": 5.0}
    trajectory = flexopt.simulate(changed, posture, **options)
    values = {
        "machine.payload.mass": 300.0, "machine.stick.length": 1.2, "machine.stick.com_offset": 0.03,
        "machine.stick.joint_damping": 15.0, "machine.base.stiffness.rotation": 9e5, "machine.base.rest_angle": 1.2,
        "posture.boom": 0.1, "posture.stick": -1.9, "start_offset.boom": 0.02, "start_offset.stick": 0.03,
        "controller.kp.x": 5e4, "controller.kp.y": 6e4, "controller.kv.x": 3e3, "controller.kv.y": 3e3,
        "placement.x": -0.7,
    }  # fmt: skip
    with opened(report, folder) as slave:
        slave.set_many(values)
        point = slave.real("rest_end_point.x", "rest_end_point.y")
        np.testing.assert_allclose(point, trajectory.target[0], rtol=0, atol=1e-14)
    start = values | {"target.x": point[0], "target.y": point[1]}
    result = run(report, stop_time=5.0, start_values=start)
    assert worst(result, shown(trajectory), report.outputs) < TOLERANCE


def test_static_deflection_follows_the_payload(tmp_path: Path) -> None:
    made = export(tmp_path, gravity=True, duration=1.0)
    loaded = machine_from_dict(EXCAVATOR.to_dict() | {"payload": {"mass": 500.0}})
    trajectory = flexopt.simulate(loaded, POSTURE, gravity=True, duration=1.0)
    target = dict(zip(("target.x", "target.y"), trajectory.target[0], strict=True))
    result = run(made, stop_time=1.0, start_values={"machine.payload.mass": 500.0, **target})
    assert worst(result, shown(trajectory), made.outputs) < TOLERANCE


def test_gains_change_during_a_run(report: FmuReport, folder: Path) -> None:
    with opened(report, folder) as slave:
        slave.start()
        slave.step(0.0, 0.1)
        before = slave.real("torque.boom", "error.x", "error.y")
        state = slave.real(*report.outputs[:10])
        slave.set_many({f"controller.{g}.{axis}": 0.0 for g in ("kp", "kv") for axis in "xy"})
        after = slave.real("torque.boom", "error.x", "error.y")
        assert before[0] != 0.0
        assert after == [0.0, *before[1:]]
        assert slave.real(*report.outputs[:10]) == state
        slave.refuses("machine.payload.mass must not change now", slave.set, machine__payload__mass=1.0)


def described(report: FmuReport) -> tuple[str, dict[str, str], str]:
    """The model's description, that of each variable, and the page in one line."""
    model = fmpy.read_model_description(str(report.path))
    with zipfile.ZipFile(report.path) as archive:
        page = archive.read("documentation/index.html").decode()
    return model.description, {v.name: v.description for v in model.modelVariables}, " ".join(page.split())


@pytest.mark.long("boom-stick-bucket")
@pytest.mark.parametrize("name", ["excavator", "boom-stick-bucket"])
def test_another_servo_gain_is_set_as_the_page_says(tmp_path: Path, name: str) -> None:
    """As `flexopt.simulate` runs the velocity-served loop with twice the servo gain; only levers have a limit, too."""
    machine, posture = flexopt.load(name), POSTURE if name == "excavator" else [-1.354, -1.5032, -0.2305]
    loop, gain, own = {"drive": "velocity", "kp": 1.5, "kv": 0.1}, 3e4, 50.0
    machine = with_parameters(machine, {f"{joint}.joint_damping": own for joint in machine.joints})
    levers, start = name != "excavator", {"offset": [0.02] * len(posture), "duration": 0.5}
    loop |= {"nullspace_damping": 500.0} if levers else {}
    report = flexopt.export_fmu(machine, tmp_path / "m.fmu", posture, loop=loop | {"servo_gain": gain}, **start)
    text, texts, page = described(report)
    sentence = "joints are velocity-served: Kp 1.5 1/s, Kv 0.1, servo gain 30000 N m s/rad"
    assert sentence in text
    assert sentence in page
    assert texts["controller.kp.x"].endswith("axis x; servo gain times Kp of the velocity-served loop")
    dampings = [f"machine.{joint}.joint_damping" for joint in machine.joints]
    for damping in dampings:
        told = "; 50 of it is the joint's own, whatever is set, and the rest the servo's braking: 30000 N m s/rad"
        assert texts[damping].endswith(told)
        assert f"<code>{damping}</code>" in page
    assert ("actuator.servo_gain" in texts) == levers
    assert ("No levers limit the command" in page) != levers
    changed = dict.fromkeys(dampings, 2 * gain + own)
    changed |= {f"controller.{k}.{row}": 2 * gain * loop[k] for k in ("kp", "kv") for row in machine.task_rows}
    changed |= {"actuator.servo_gain": 2 * gain} if levers else {}
    expected = flexopt.simulate(machine, posture, loop=loop | {"servo_gain": 2 * gain}, **start)
    assert worst(run(report, start_values=changed), shown(expected), report.outputs) < TOLERANCE


def test_a_loop_in_torques_says_nothing_of_servos(report: FmuReport) -> None:
    text, texts, page = described(report)
    assert not any("servo" in each for each in (text, page, *texts.values()))


@pytest.mark.long("2.0")
@pytest.mark.parametrize("version", VERSIONS)
def test_paths_of_base_and_target_are_inputs(tmp_path: Path, version: str) -> None:
    paths = {
        "base_path": {"times": [0.5, 2.5], "points": [[0.0], [-0.4]]},
        "target_path": {"times": [1.0, 2.0, 3.0], "points": [[1.5, 1.6], [1.45, 1.7], [1.45, 1.7]]},
    }
    made = export(tmp_path, version=version, duration=4.0, **paths)
    table = reference(made)
    given = table[["time", *made.inputs]]
    result = run(made, stop_time=4.0, input=given)
    assert float(np.abs(table["q.base.x"][-1])) > 0.3
    # Outputs that hold a rate show that of the step which ends, the reference that of the one which begins.
    names = [n for n in made.outputs if not n.startswith("torque")]
    assert worst(result, table, names) < TOLERANCE


def test_steps_of_several_samples_and_parts_of_one(report: FmuReport, folder: Path) -> None:
    expected = run(report, stop_time=0.3)
    names = [n for n in report.outputs if n.startswith(("q.", "v."))]
    with opened(report, folder) as slave:
        slave.start()
        t, samples = 0.0, []
        for size in (0.02, 0.005, 0.002, 0.002, 0.001, 0.0125, 0.0075):
            slave.step(t, size)
            t += size
            samples.append((int(t / 0.005 + 0.01), slave.real(*names)))
        assert [k for k, _ in samples] == [4, 5, 5, 5, 6, 8, 10]
        for k, values in samples:
            assert values == [expected[n][k] for n in names]


def test_inputs_set_inside_a_sample_wait_for_the_next(report: FmuReport, folder: Path) -> None:
    names = report.outputs[:10]
    with opened(report, folder) as late, opened(report, folder) as plain:
        for slave in (late, plain):
            slave.start()
            slave.step(0.0, 0.002)
        late.set(target__x=2.0)
        for slave in (late, plain):
            slave.step(0.002, 0.003)
        assert late.real(*names) == plain.real(*names)
        for slave in (late, plain):
            slave.step(0.005, 0.005)
        assert late.real(*names) != plain.real(*names)


def test_a_moving_target_moves_on_through_a_long_step(report: FmuReport, folder: Path) -> None:
    names = report.outputs[:14]
    with opened(report, folder) as coarse, opened(report, folder) as fine:
        target = fine.real("target.x")[0]
        for slave in (coarse, fine):
            slave.set(target__x_rate=0.1)
            slave.start()
        coarse.step(0.0, 0.1)
        for k in range(20):
            fine.set(target__x=target + 0.1 * 0.005 * k)
            fine.step(0.005 * k, 0.005)
        np.testing.assert_allclose(coarse.real(*names), fine.real(*names), rtol=0, atol=1e-12)
        # Without a new value the next step starts again from the one that was set.
        assert coarse.real("target.x") == [target]


def test_instances_do_not_share_anything(report: FmuReport, folder: Path) -> None:
    expected = run(report, stop_time=0.5)
    heavy = run(report, stop_time=0.5, start_values={"machine.payload.mass": 400.0})
    with opened(report, folder) as one, opened(report, folder) as two:
        two.set(machine__payload__mass=400.0)
        one.start()
        two.start()
        for k in range(100):
            one.step(k * 0.005, 0.005)
            two.step(k * 0.005, 0.005)
        assert one.real(*report.outputs) == [expected[n][-1] for n in report.outputs]
        assert two.real(*report.outputs) == [heavy[n][-1] for n in report.outputs]
    assert worst(expected, heavy, report.outputs) > 1e-3


def test_states_are_kept_restored_and_serialised(report: FmuReport, folder: Path) -> None:
    state = "FMUstate" if report.version == "2.0" else "FMUState"
    with opened(report, folder) as slave, opened(report, folder) as other:
        fmu = slave.fmu
        get, put, free = (getattr(fmu, f"{word}{state}") for word in ("get", "set", "free"))
        slave.start()
        slave.step(0.0, 0.102)  # inside a sample
        slave.set(target__x=1.4)
        saved = get()
        data = getattr(fmu, f"serialize{state}")(saved)

        def onwards(one: Slave) -> list[float]:
            one.step(0.102, 0.2)
            return one.real(*report.outputs, "target.x")

        first = onwards(slave)
        put(saved)
        assert onwards(slave) == first
        free(saved)
        deserialise = "deSerialize" if report.version == "2.0" else "deserialize"
        copy = getattr(other.fmu, f"{deserialise}{state}")(data)
        getattr(other.fmu, f"set{state}")(copy)
        getattr(other.fmu, f"free{state}")(copy)
        assert onwards(other) == first
        slave.refuses("it is no state of this model", getattr(fmu, f"{deserialise}{state}"), b"\0" * len(data))
        slave.refuses("bytes", getattr(fmu, f"{deserialise}{state}"), data[:-1])


def test_reset_starts_anew(report: FmuReport, folder: Path) -> None:
    with opened(report, folder) as slave:
        slave.set(machine__payload__mass=50.0, controller__kp__x=1.0)
        slave.start(3.0)
        slave.step(3.0, 0.1)
        slave.fmu.terminate()
        slave.refuses("must not be called now", slave.step, 3.1, 0.1)
        slave.fmu.reset()
        assert slave.real("machine.payload.mass", "controller.kp.x") == [0.0, 1e5]
        slave.start()
        slave.step(0.0, 0.5)
        expected = run(report, stop_time=0.5)
        assert slave.real(*report.outputs) == [expected[n][-1] for n in report.outputs]


def test_bad_values_are_refused_and_leave_everything(report: FmuReport, folder: Path) -> None:
    with opened(report, folder) as slave:
        before = slave.real(*report.parameters, *report.inputs)
        for name in (*report.parameters, *report.inputs):
            for value in (float("nan"), float("inf"), -float("inf")):
                slave.refuses(f"{name} must be finite", slave.set_many, {name: value})
        slave.refuses("machine.boom.mass = 0 must lie between", slave.set, machine__boom__mass=0.0)
        slave.refuses("posture.stick = 100", slave.set, posture__stick=100.0)
        slave.refuses("controller.kp.x = -1", slave.set, controller__kp__x=-1.0)
        slave.refuses("target.y = 1e+300", slave.set, target__x=1.0, target__y=1e300)
        slave.refuses("is no parameter and no input", slave.set, energy=1.0)
        slave.refuses("is no parameter and no input", slave.set, time=1.0)
        slave.references["nothing"] = 10_000
        slave.refuses("10000 is no parameter", slave.set, nothing=1.0)
        slave.refuses("10000 is not known", slave.real, "nothing")
        assert slave.real(*report.parameters, *report.inputs) == before


def test_bad_calls_are_refused(report: FmuReport, folder: Path) -> None:
    with opened(report, folder) as slave:
        slave.refuses("must not be called now", slave.step, 0.0, 0.005)
        slave.refuses("must not be called now", slave.fmu.exitInitializationMode)
        slave.refuses("start time must be finite", slave.start, float("nan"))
    with opened(report, folder) as slave:
        slave.start()
        slave.refuses("must not be called now", slave.fmu.enterInitializationMode)
        state = slave.real(*report.outputs)
        for at, size, words in (
            (0.0, 0.0, "greater than 0"),
            (0.0, -0.005, "greater than 0"),
            (0.0, float("nan"), "greater than 0"),
            (float("inf"), 0.005, "greater than 0"),
            (1.0, 0.005, "begins at 1 s, but the model stands at 0 s"),
            (0.0, 1e300, "samples"),
        ):
            slave.refuses(words, slave.step, at, size)
        assert slave.real(*report.outputs) == state
        unknown = {"2.0": ("getInteger", "type Real"), "3.0": ("getInt32", "type Float64")}[report.version]
        slave.refuses(unknown[1], getattr(slave.fmu, unknown[0]), [0])


@pytest.mark.long("2.0")
def test_parameters_that_fit_no_machine_are_refused(report: FmuReport, folder: Path, tmp_path: Path) -> None:
    with opened(report, folder) as slave:
        slave.set(posture__stick=0.0)
        slave.refuses("singular", slave.start)
    with opened(report, folder) as slave:
        slave.set(machine__base__stiffness__x=1e9)
        slave.refuses("RK4 is unstable", slave.start)
    with opened(report, folder) as slave:
        slave.set(machine__stick__joint_damping=1e8)
        slave.refuses("RK4 is unstable", slave.start)
    weak = export(tmp_path, gravity=True, duration=0.1, version=report.version)
    with opened(weak, tmp_path) as slave:
        slave.set(machine__base__stiffness__rotation=1e3)
        slave.refuses("springs do not hold the machine", slave.start)


def test_a_loop_that_diverges_ends_with_an_error(report: FmuReport, folder: Path) -> None:
    with opened(report, folder) as slave:
        slave.set(controller__kp__x=1e9, controller__kp__y=1e9)
        slave.start()
        slave.refuses("leaves the finite numbers", slave.step, 0.0, 10.0)
        assert np.all(np.isfinite(slave.real(*report.outputs[:10])))


def test_a_foreign_token_is_refused(report: FmuReport, folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(Exception, match=r"[Ii]nstantiate"), opened(report, folder, token="{0}"):
        pass


def test_the_description_holds_the_machine(report: FmuReport) -> None:
    description = fmpy.read_model_description(str(report.path))
    variables = {v.name: v for v in description.modelVariables}
    for parameter in EXCAVATOR.parameters:
        variable = variables[f"machine.{parameter.name}"]
        assert float(variable.start) == parameter.value
        assert variable.unit == unit_of(parameter.unit).name
    for variable in description.modelVariables:
        assert variable.description
        if variable.causality in {"parameter", "input"}:
            assert float(variable.min) <= float(variable.start) <= float(variable.max)
    assert float(description.defaultExperiment.stepSize) == 0.005
    assert float(description.defaultExperiment.stopTime) == 10.0
    dependencies = {u.variable.name: {v.name for v in u.dependencies} for u in description.outputs}
    # A held controller: positions come from the states alone, the error has the target, the torque also its rate.
    assert dependencies["q.boom"] == set()
    assert dependencies["error.x"] == {"target.x"}
    assert {"target.x", "target.y", "target.x_rate", "target.y_rate"} <= dependencies["torque.boom"]
    units = {u.name: u.baseUnit for u in description.unitDefinitions}
    stiffness = units["N.m/rad"]
    assert (stiffness.kg, stiffness.m, stiffness.s, stiffness.rad) == (1, 2, -2, -1)


@pytest.mark.parametrize(
    ("text", "name", "exponents"),
    [
        ("kg m²", "kg.m2", {"kg": 1, "m": 2}),
        ("N m s/rad", "N.m.s/rad", {"kg": 1, "m": 2, "s": -1, "rad": -1}),
        ("N/(m s)", "N/(m.s)", {"kg": 1, "s": -3}),
        ("m/s²", "m/s2", {"m": 1, "s": -2}),
        ("Hz", "Hz", {"s": -1}),
    ],
)
def test_units(text: str, name: str, exponents: dict[str, int]) -> None:
    unit = unit_of(text)
    assert (unit.name, unit.exponents) == (name, exponents)


def test_an_unknown_unit_is_no_unit() -> None:
    with pytest.raises(ValueError, match="'furlong' is not known"):
        unit_of("furlong/s")


@pytest.mark.long("3.0-co-simulation", "2.0-co-simulation")
@pytest.mark.needs("gcc", "clang")
@pytest.mark.parametrize("kind", ["co-simulation", "model-exchange"])
@pytest.mark.parametrize("version", VERSIONS)
def test_the_sources_compile_without_a_warning(tmp_path: Path, version: str, kind: str) -> None:
    made = export(tmp_path, version=version, kind=kind, duration=0.1)
    text = sources(made, tmp_path)
    for compiler in ("clang", "gcc"):
        command = [compiler, *WARNINGS, "-O1", "-c", str(text), "-o", str(tmp_path / "fmu.o")]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[:3000]
    # No state outside the instances: nothing that is written, initialised or not.
    sizes = subprocess.run(["size", "-A", str(tmp_path / "fmu.o")], capture_output=True, text=True, check=True).stdout
    written = {
        line.split()[0]: int(line.split()[1]) for line in sizes.splitlines() if line.startswith((".data", ".bss"))
    }
    assert not any(size for name, size in written.items() if not name.startswith(".data.rel.ro"))
    names = subprocess.run(["nm", "-u", str(tmp_path / "fmu.o")], capture_output=True, text=True, check=True).stdout
    needed = set(names.split()) - {"U"}
    allocation = {"malloc", "calloc", "realloc", "free"} & needed
    # FMI 2 allocates by the master's callbacks; FMI 3 has none, so instances and kept states come from calloc.
    assert allocation == (set() if version == "2.0" else {"calloc", "free"})


MAIN_2 = r"""
#include "fmu.c"
#include <assert.h>
static void said(void *e, fmi2String n, fmi2Status s, fmi2String c, fmi2String f, ...) { (void)e,(void)n,(void)s,(void)c,(void)f; }
int main(void) {
  fmi2CallbackFunctions calls = {said, calloc, free, NULL, NULL};
  for (int round = 0; round < 3; round++) {
    fmi2FMUstate state = NULL;
    fmi2ValueReference vr = FIRST_OUTPUT;
    double y, t = 0.0;
    fmi2Component c = fmi2Instantiate("one", fmi2CoSimulation, MODEL_TOKEN, NULL, &calls, 0, 1);
    assert(fmi2Instantiate(NULL, fmi2CoSimulation, MODEL_TOKEN, NULL, &calls, 0, 1) == NULL);
    assert(fmi2Instantiate("one", fmi2ModelExchange, MODEL_TOKEN, NULL, &calls, 0, 1) == NULL);
    assert(fmi2Instantiate("one", fmi2CoSimulation, MODEL_TOKEN, NULL, NULL, 0, 1) == NULL);
    assert(fmi2SetupExperiment(c, 0, 0, 0, 0, 0) == fmi2OK && fmi2EnterInitializationMode(c) == fmi2OK);
    assert(fmi2GetReal(c, NULL, 1, &y) == fmi2Error && fmi2SetReal(c, &vr, 1, NULL) == fmi2Error);
    assert(fmi2GetReal(c, NULL, 0, NULL) == fmi2OK && fmi2GetReal(NULL, &vr, 1, &y) == fmi2Error);
    assert(fmi2ExitInitializationMode(c) == fmi2OK);
    for (int k = 0; k < 100; k++, t += 0.005) {
      assert(fmi2DoStep(c, t, 0.005, 1) == fmi2OK && fmi2GetReal(c, &vr, 1, &y) == fmi2OK);
      assert(fmi2GetFMUstate(c, &state) == fmi2OK);
    }
    assert(fmi2SetFMUstate(c, NULL) == fmi2Error && fmi2SetFMUstate(c, state) == fmi2OK);
    assert(fmi2FreeFMUstate(c, &state) == fmi2OK && state == NULL && fmi2FreeFMUstate(c, &state) == fmi2OK);
    assert(fmi2Terminate(c) == fmi2OK);
    fmi2FreeInstance(c);
    fmi2FreeInstance(NULL);
  }
  return 0;
}
"""
MAIN_3 = r"""
#include "fmu.c"
#include <assert.h>
#define NEW(name, token) fmi3InstantiateCoSimulation(name, token, NULL, 0, 1, 0, 0, NULL, 0, NULL, NULL, NULL)
int main(void) {
  for (int round = 0; round < 3; round++) {
    fmi3FMUState state = NULL;
    fmi3ValueReference vr = FIRST_OUTPUT;
    double y, t = 0.0, last;
    bool a, b, d;
    fmi3Instance c = NEW("one", MODEL_TOKEN);
    assert(NEW(NULL, MODEL_TOKEN) == NULL && NEW("one", NULL) == NULL && NEW("one", "{}") == NULL);
    assert(fmi3EnterInitializationMode(c, 0, 0, 0, 0, 0) == fmi3OK);
    assert(fmi3GetFloat64(c, NULL, 1, &y, 1) == fmi3Error && fmi3GetFloat64(c, &vr, 1, &y, 2) == fmi3Error);
    assert(fmi3GetFloat64(NULL, &vr, 1, &y, 1) == fmi3Error && fmi3EnterEventMode(c) == fmi3Error);
    assert(fmi3ExitInitializationMode(c) == fmi3OK);
    assert(fmi3DoStep(c, t, 0.005, 1, NULL, &b, &d, &last) == fmi3Error);
    for (int k = 0; k < 100; k++, t += 0.005) {
      assert(fmi3DoStep(c, t, 0.005, 1, &a, &b, &d, &last) == fmi3OK && fmi3GetFloat64(c, &vr, 1, &y, 1) == fmi3OK);
      assert(fmi3GetFMUState(c, &state) == fmi3OK);
    }
    assert(fmi3SetFMUState(c, NULL) == fmi3Error && fmi3SetFMUState(c, state) == fmi3OK);
    assert(fmi3FreeFMUState(c, &state) == fmi3OK && state == NULL && fmi3FreeFMUState(c, &state) == fmi3OK);
    assert(fmi3Terminate(c) == fmi3OK);
    fmi3FreeInstance(c);
    fmi3FreeInstance(NULL);
  }
  return 0;
}
"""


def test_no_leak_and_no_undefined_behaviour(report: FmuReport, tmp_path: Path) -> None:
    if shutil.which("gcc") is None:
        pytest.skip("no gcc")
    sources(report, tmp_path)
    (tmp_path / "main.c").write_text(MAIN_2 if report.version == "2.0" else MAIN_3)
    flags = ["-std=c99", "-O0", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    command = ["gcc", *flags, str(tmp_path / "main.c"), "-o", str(tmp_path / "main"), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[:3000]
    ran = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr[:3000]
    assert ran.stderr == ""


def test_equal_models_have_equal_bytes(tmp_path: Path) -> None:
    one, two = (export(tmp_path, name=name, duration=0.5) for name in ("one", "two"))
    assert one.path.read_bytes() == two.path.read_bytes()
    other = export(tmp_path, name="other", duration=0.5, kp=9e4)
    assert other.token != one.token


def test_what_is_there_is_replaced_when_that_is_asked_for(tmp_path: Path) -> None:
    export(tmp_path, duration=0.5)
    again = export(tmp_path, duration=0.5, kp=9e4, overwrite=True)
    assert fmpy.read_model_description(str(again.path)).guid == again.token
    for name in ("text.fmu", "new_reference.csv"):
        (tmp_path / name).write_text("mine")
        with pytest.raises(InputError, match="overwrite does"):
            export(tmp_path, name=name.partition(".")[0].removesuffix("_reference"))
        assert (tmp_path / name).read_text() == "mine"


def test_every_fault_of_a_call_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        flexopt.export_fmu(
            EXCAVATOR,
            tmp_path / "missing" / "model.fmu",
            POSTURE,
            version="1.0",
            kind="model-exchange",
            hold=True,
            seed=3,
        )
    for words in ("version", "2.0 or 3.0", "hold", "seed", "there is no folder"):
        assert words in str(caught.value)
    with pytest.raises(InputError, match=r"must end in \.fmu"):
        flexopt.export_fmu(EXCAVATOR, tmp_path / "model.zip", POSTURE)
    with pytest.raises(InputError, match="kp"):
        export(tmp_path, kp=-1.0)
    with pytest.raises(SingularPosture):
        export(tmp_path, posture=[0.1, 0.0])
    with pytest.raises(InputError, match="sampled controller"):
        export(tmp_path, kind="model-exchange", sensor={"delay": 0.01})
    assert list(tmp_path.iterdir()) == []


def test_without_a_compiler_the_sources_remain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flexopt.export.fmu.package.find_compiler", lambda: None)
    with pytest.warns(CompilerNotFound, match="sources alone") as caught:
        made = export(tmp_path, duration=0.5, version="3.0")
    assert Path(caught[0].filename).parent == Path(__file__).parent
    assert made.platforms == ()
    assert not any(name.startswith("binaries/") for name in made.files)
    with zipfile.ZipFile(made.path) as archive:
        build = ElementTree.fromstring(archive.read("sources/buildDescription.xml"))
        assert [e.get("name") for e in build.iter("SourceFile")] == ["fmu.c"]
        assert "sources/fmu.c" in archive.namelist()
    assert validate_fmu(str(made.path)) == []


def test_the_library_runs_on_any_processor_of_its_kind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments: list[list[str]] = []
    real = compilers._run
    monkeypatch.setattr(compilers, "_run", lambda a, *rest: (arguments.append(a), real(a, *rest))[1])
    export(tmp_path, duration=0.5)
    built = [a for a in arguments if any(str(part).endswith("source.c") for part in a)]
    assert built
    assert not any("native" in part for part in built[-1])


@pytest.mark.long
def test_noise_is_an_input(tmp_path: Path) -> None:
    made = export(tmp_path, duration=1.0, sensor={"noise": 1e-3, "rate_noise": 1e-2})
    names = ["sensor.noise.x", "sensor.noise.y", "sensor.noise.x_rate", "sensor.noise.y_rate"]
    assert [n for n in made.inputs if "noise" in n] == names
    quiet = shown(flexopt.simulate(EXCAVATOR, POSTURE, duration=1.0))
    assert worst(run(made, stop_time=1.0), quiet, made.outputs) < TOLERANCE
    scenario_noise = np.random.default_rng(5).standard_normal((201, 4)) * [1e-3, 1e-3, 1e-2, 1e-2]
    given = np.zeros(201, dtype=[(n, "f8") for n in ("time", *names)])
    given["time"] = np.arange(201) * 0.005
    for name, column in zip(names, scenario_noise.T, strict=True):
        given[name] = column
    options: dict[str, Any] = {"sensor": {"noise": 1e-3, "rate_noise": 1e-2}, "seed": 5, "duration": 1.0}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", flexopt.FlexoptWarning)  # noise keeps the base moving
        noisy = shown(flexopt.simulate(EXCAVATOR, POSTURE, **options))
    result = run(made, stop_time=1.0, input=given)
    assert worst(result, noisy, [n for n in made.outputs if n.startswith(("q.", "v.", "end_point"))]) < TOLERANCE


def test_the_report_is_ready_for_json(report: FmuReport) -> None:
    document = report.to_dict()
    assert document["path"] == str(report.path)
    assert document["token"] == fmpy.read_model_description(str(report.path)).guid
    assert document["provenance"]["machine"] == "excavator"
    assert report.version in repr(report)
    with zipfile.ZipFile(report.path) as archive:
        assert sorted(archive.namelist()) == sorted(report.files)
        assert archive.read("resources/reference.csv") == report.reference.read_bytes()
        page = archive.read("documentation/index.html").decode()
    assert all(name in page for name in (*report.parameters, *report.inputs, *report.outputs))
    assert "$" not in page


@pytest.mark.long
@settings(max_examples=12)
@given(seeds, st.booleans())
def test_setup_is_what_a_scenario_computes(seed: int, gravity: bool) -> None:
    rng = np.random.default_rng(seed)
    _, machine = random_machine(rng)
    posture = regular_posture(rng, machine)
    given = {"posture": posture, "gravity": gravity, "base": rng.uniform(-2, 2), "substeps": 500}
    options = checked_options("test", machine, given | {"actuator": {"bandwidth_hz": 5.0}, "sensor": {"delay": 0.01}})
    try:
        scenario = build_scenario(machine, options)
    except (InputError, SingularPosture, NoSolutionFound):
        assume(False)  # the springs do not hold it, or the posture is singular
    check_setup(scenario, 5.0)


@pytest.mark.long
def test_any_name_of_a_link_will_do(tmp_path: Path) -> None:
    data = EXCAVATOR.to_dict()
    links = [link | {"name": name} for link, name in zip(data["links"], ['a "b", <c>&\t*/', "Löffel 2"], strict=True)]
    machine = machine_from_dict(data | {"name": "ä\u0001*/ \\", "links": links})
    for version in VERSIONS:
        made = export(tmp_path, machine, version=version, duration=0.1)
        assert validate_fmu(str(made.path)) == []
        assert worst(run(made, stop_time=0.1), reference(made), ["energy", "q.Löffel 2"]) < TOLERANCE


def test_the_command_line(tmp_path: Path) -> None:
    path = str(tmp_path / "model.fmu")
    arguments = [
        "excavator",
        "--fmu",
        path,
        "--fmi",
        "3.0",
        "--posture",
        "0.0448,-2.0499",
        "--kp",
        "9e4",
        "--duration",
        "1",
        "--json",
    ]
    done = CliRunner().invoke(export_command, arguments)
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert document["version"] == "3.0"
    made = export(tmp_path, name="twin", version="3.0", kp=9e4, duration=1.0)
    assert made.token == document["token"]
    for wrong, words in ((["--kp", "x"], "--kp"), (["--kind", "both"], "--kind"), (["--duration", "-1"], "--duration")):
        refused = CliRunner().invoke(export_command, [*arguments, *wrong])
        assert isinstance(refused.exception, InputError)
        assert words in str(refused.exception)
    refused = CliRunner().invoke(export_command, ["excavator", "--fmu", path])
    assert "needs --posture" in str(refused.exception)
    for mixed in (["--fmu", path, "--out", "b", "--baked"], ["--out", "b", "--kp", "3"]):
        refused = CliRunner().invoke(export_command, ["excavator", *mixed])
        assert isinstance(refused.exception, InputError)
        assert all(name in str(refused.exception) for name in mixed[2::2])
        assert not Path("b").exists()


@pytest.mark.long
def test_self_motion_that_servos_hold_is_no_alarm(tmp_path: Path) -> None:
    """As `flexopt.simulate` of the same loop, which says nothing of it; where the drives give torques it does."""
    machine, posture = flexopt.load("boom-stick-bucket"), [-1.354, -1.5032, -0.2305]
    for drive, alarms in (("velocity", False), ("torque", True)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            report = flexopt.export_fmu(
                machine, tmp_path / f"{drive}.fmu", posture, loop={"drive": drive}, duration=0.1
            )
        assert any("does not brake the arm's self-motion" in each for each in report.warnings) == alarms
