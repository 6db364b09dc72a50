"""FMUs of machines in space. As in `test_fmu`, FMPy is the importer and `flexopt.simulate` the reference.

References are computed by CasADi's virtual machine, and most libraries are built without optimisation, which is quick.
"""

from __future__ import annotations

import json
import subprocess
import warnings
import zipfile
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from click.testing import CliRunner
from fmpy.validation import validate_fmu
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

import flexopt
from flexopt.cli.bundles import export_command
from flexopt.compiled import compilers
from flexopt.errors import FlexoptWarning, InputError, NoSolutionFound, SingularPosture
from flexopt.export.fmu import FmuReport, package
from flexopt.export.fmu import settings as settable
from flexopt.export.fmu.model import FmuModel
from flexopt.export.fmu.variable import force_unit, words
from flexopt.foundation.control import gain_units
from flexopt.model import Tree, tree_from_dict
from flexopt.simulation import run as simulation
from flexopt.simulation.scenario import build_scenario, checked_options
from tests.export.fmu_library import (
    TOLERANCE,
    VERSIONS,
    WARNINGS,
    check_setup,
    difference,
    opened,
    reference,
    run,
    shown,
    sources,
    worst,
)
from tests.oracles.spatial import random_tree

SLEWING, CRANE, MOBILE = (flexopt.load(name) for name in ("slewing-excavator", "truck-crane", "mobile-manipulator"))
REACH = {"slewing-excavator": [0.3, 0.6, -1.2, -0.8], "truck-crane": [0.4, 0.9, -0.7, 0.8]}
# Gains with which the loops converge.
SLOW: dict[str, Any] = {"kp": 1e6, "kv": 5e5, "nullspace_damping": 1e5}
CRANED: dict[str, Any] = {"kp": 3e5, "kv": 2e5, "nullspace_damping": 3e4}


def six_rows() -> Tree:
    """A task of position and orientation; nothing absorbs the placement, which is a parameter."""
    data = MOBILE.to_dict()
    rows = {"rows": ["x", "y", "z", "roll", "pitch", "yaw"], "length": 0.5}
    return tree_from_dict(data | {"name": "six rows", "end_point": data["end_point"] | rows})


def on_rails() -> Tree:
    """Gives along x alone, against it, and cannot be turned: of its placement x is an input and y a parameter."""
    body: dict[str, Any] = {"mass": 300.0, "com": [0.1, 0.0, 0.4], "inertia": [40.0, 50.0, 60.0, 1.0, -2.0, 3.0]}
    cart = {"name": "cart", "joint": {"name": "spring", "kind": "slide", "axis": [-1.0, 0.0, 0.0], "passive": True,
                                      "stiffness": 2e5, "damping": 4e3}}  # fmt: skip
    mast = {"name": "mast", "parent": "cart", "position": [0.0, 0.0, 0.5],
            "joint": {"name": "turn", "kind": "hinge", "axis": [0.0, 0.0, 1.0], "joint_damping": 30.0}}  # fmt: skip
    arm = {"name": "arm", "parent": "mast", "position": [0.3, 0.0, 0.8],
           "joint": {"name": "push", "kind": "slide", "axis": [1.0, 0.0, 0.0], "armature": 20.0}}  # fmt: skip
    end = {"body": "arm", "position": [1.0, 0.1, 0.0], "rows": ["x", "y"]}
    bodies = [cart | body, mast | body, arm | body]
    return tree_from_dict({"name": "on rails", "bodies": bodies, "end_point": end, "placement": ["x", "y"]})


SIX, RAILS = six_rows(), on_rails()
EVERYTHING: dict[str, Any] = {
    "feedback": "pid", "ki": 1e4, "integral_limit": 2e4, "gravity": True, "base": [1.0, 2.0, -0.5],
    "actuator": {"bandwidth_hz": 15.0, "torque_limit": [2e5, 2e5, 2e5, 5e4], "dead_band": 5.0, "rate_limit": 2e6},
    "sensor": {"delay": 0.01, "resolution": 1e-5, "rate_resolution": 1e-5},
}  # fmt: skip
CASES: dict[str, tuple[Tree, dict[str, Any]]] = {
    "slewing excavator": (SLEWING, {**SLOW, "base": [1.0, -2.0, 0.7], "version": "3.0"}),
    "everything": (CRANE, {**CRANED, **EVERYTHING, "kp": (3e5, 2e5, 3e5), "duration": 1.0}),
    "levers, damped": (SLEWING, {**SLOW, "control": "damped:0.5", "duration": 1.0, "gravity": True,
                                 "actuator": {"levers": "uniform", "servo_gain": 1e5}}),
    "robust": (CRANE, {"feedback": "robust", "nullspace_damping": 3e4, "duration": 1.0, "version": "3.0"}),
    "six rows": (SIX, {"posture": [0.3, -1.2, 1.4, -0.6, -1.2, 0.2], "kp": 100.0, "kv": 20.0, "gravity": True,
                       "base": [1.0, 2.0, 0.5], "duration": 2.0}),
    "on rails, gauss": (RAILS, {"posture": [0.4, 0.3], "kp": 3e3, "kv": 1e3, "integrator": "gauss", "duration": 2.0,
                                "base": [0.5, -0.5], "version": "3.0"}),
}  # fmt: skip


LEVEL_FOR = package.level_for


@pytest.fixture(autouse=True, scope="module")
def quick() -> Iterator[None]:
    """Runs by CasADi's virtual machine; a library all the same, without optimisation."""
    compiler = compilers.find_compiler()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FLEXOPT_COMPILE", "0")
        for name in ("_runner", "_baked_runner", "_singularity"):
            patch.setattr(simulation, name, lru_cache(getattr(simulation, name).__wrapped__))
        patch.setattr(package, "find_compiler", lambda: compiler)
        patch.setattr(package, "level_for", lambda _: ("-O0",))
        yield


@pytest.fixture(scope="module")
def crane(quick: None, tmp_path_factory: pytest.TempPathFactory) -> FmuReport:
    return export(tmp_path_factory.mktemp("fmu"), duration=0.1, **CRANED, actuator={"torque_limit": 1e6})


def export(folder: Path, machine: Tree = CRANE, name: str = "model", **options: Any) -> FmuReport:
    posture = REACH.get(machine.name)
    return flexopt.export_fmu(machine, folder / f"{name}.fmu", **{"posture": posture, **options})


# The robust law asks the slew for more than its effort.
@pytest.mark.long
@pytest.mark.filterwarnings("ignore:nothing in this run:flexopt.errors.FlexoptWarning")
@pytest.mark.parametrize("case", CASES)
def test_loops_are_those_of_simulate(tmp_path: Path, case: str) -> None:
    machine, options = CASES[case]
    made = export(tmp_path, machine, **options)
    assert validate_fmu(str(made.path)) == []
    given = {"posture": REACH.get(machine.name), "duration": 10.0} | options
    version = given.pop("version", "2.0")
    assert made.version == version
    expected = shown(flexopt.simulate(machine, **given))
    assert set(made.outputs) == set(expected)
    result = run(made, stop_time=given["duration"])
    assert worst(result, expected, made.outputs) < TOLERANCE
    assert worst(result, reference(made), made.outputs) < TOLERANCE


def test_an_optimised_library_agrees_as_well(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(package, "level_for", LEVEL_FOR)
    made = export(tmp_path, RAILS, posture=[0.4, 0.3], kp=3e3, kv=1e3)
    assert worst(run(made, stop_time=10.0), reference(made), made.outputs) < TOLERANCE


@pytest.mark.long
def test_model_exchange_agrees_as_far_as_cvode_is_accurate(tmp_path: Path) -> None:
    options = CRANED | {"base": [0.5, 1.0, -0.3], "duration": 1.0, "kind": "model-exchange", "version": "3.0"}
    made = export(tmp_path, CRANE, **options)
    assert validate_fmu(str(made.path)) == []
    placed = [n for n in made.outputs if n.startswith(("q.", "end_point"))]
    for tolerance, allowed in ((1e-9, 1e-8), (1e-12, 1e-11)):
        # CVode's global error; rates and torques are larger numbers of faster motion.
        result = run(made, stop_time=1.0, solver="CVode", relative_tolerance=tolerance)
        assert worst(result, reference(made), placed) < allowed / 10
        assert worst(result, reference(made), made.outputs) < 10 * allowed


@pytest.mark.long
def test_model_exchange_with_states_of_actuators_and_law(tmp_path: Path) -> None:
    options = {name: value for name, value in EVERYTHING.items() if name != "sensor"}
    options |= {"actuator": {"bandwidth_hz": 15.0}, "duration": 0.5, "kind": "model-exchange"}
    made = export(tmp_path, **CRANED, **options)
    names = [v.name for v in fmpy.read_model_description(str(made.path)).modelVariables]
    states = [n for n in names if n.startswith("state.")]
    assert [n for n in states if "_rate" not in n][-7:] == [
        *(f"state.torque.{j}" for j in ("slew", "lift", "knuckle", "extend")), *(f"state.law[{k}]" for k in (1, 2, 3))
    ]  # fmt: skip
    result = run(made, stop_time=0.5, solver="CVode", relative_tolerance=1e-12)
    placed = [n for n in made.outputs if n.startswith(("q.", "end_point"))]
    assert worst(result, reference(made), placed) < 1e-11


@pytest.mark.long
def test_paths_of_a_turned_base_and_of_the_target_are_inputs(tmp_path: Path) -> None:
    start = flexopt.simulate(CRANE, REACH["truck-crane"], base=[1.0, 2.0, 0.8], duration=0.1, **CRANED).target[0]
    end = np.add(start, [0.1, -0.05, 0.1])
    paths = {
        "base_path": {"times": [0.2, 1.2], "points": [[1.0, 2.0, 0.8], [0.9, 2.2, 0.8]]},
        "target_path": {"times": [0.5, 1.5], "points": [start.tolist(), end.tolist()]},
    }
    made = export(tmp_path, **CRANED, base=[1.0, 2.0, 0.8], duration=2.0, **paths)
    assert [n for n in made.inputs if n.startswith("placement")] == [
        "placement.x", "placement.y", "placement.x_rate", "placement.y_rate"
    ]  # fmt: skip
    assert "placement.yaw" in made.parameters
    table = reference(made)
    result = run(made, stop_time=2.0, input=table[["time", *made.inputs]])
    assert float(np.ptp(table["q.base.x"])) > 1e-4
    # Outputs that hold a rate show that of the step which ends, the reference that of the one which begins; coordinates of
    # a base that may be turned count from where it is driven.
    names = [n for n in made.outputs if not n.startswith(("torque", "v.base"))]
    assert worst(result, table, names) < TOLERANCE


def test_a_placement_that_gives_in_one_direction(tmp_path: Path) -> None:
    path = {"times": [0.2, 1.2], "points": [[0.5, -0.5], [0.8, -0.5]]}
    options = {"posture": [0.4, 0.3], "kp": 3e3, "kv": 1e3, "base": [0.5, -0.5], "duration": 2.0}
    made = export(tmp_path, RAILS, base_path=path, **options)
    assert made.inputs[:2] == ("placement.x", "placement.x_rate")
    assert "placement.y" in made.parameters
    table = reference(made)
    result = run(made, stop_time=2.0, input=table[["time", *made.inputs]])
    # A slide against x: it ends 0.3 m behind where it began.
    np.testing.assert_allclose(table["q.spring"][[0, -1]], [-0.5, -0.8], atol=0.01)
    assert worst(result, table, [n for n in made.outputs if not n.startswith("torque")]) < TOLERANCE


@pytest.mark.long
def test_changed_parameters_are_a_changed_machine(tmp_path: Path) -> None:
    made = export(tmp_path, base=[0.1, 0.2, 0.3], duration=2.0, gravity=True, **CRANED)
    data = CRANE.to_dict()
    springs = [list(row) for row in data["stiffness_matrix"]["matrix"]]
    springs[0][0] *= 1.2
    springs[2][4] = springs[4][2] = springs[2][4] * 0.7
    jib = next(body for body in data["bodies"] if body["name"] == "jib")
    moved = jib | {"position": tuple(np.add(jib["position"], [0.1, 0.0, -0.05])), "mass": jib["mass"] * 1.3}
    moved["inertia"] = tuple(np.add(jib["inertia"], [0.0, 5.0, 5.0, 0.1, 0.2, 0.3]))
    bodies = [moved if body is jib else body for body in data["bodies"]]
    matrix = data["stiffness_matrix"] | {"matrix": springs}
    changed = tree_from_dict(data | {"bodies": bodies, "stiffness_matrix": matrix, "payload": {"mass": 700.0}})
    before = {p.name: p.value for p in CRANE.parameters}
    values = {f"machine.{p.name}": p.value for p in changed.parameters if p.value != before[p.name]}
    assert len(values) == 11
    options: dict[str, Any] = {**CRANED, "kp": (2e5, 3e5, 2.5e5), "offset": [0.02, 0.03, -0.02, 0.04], "gravity": True}
    posture = [0.1, 0.8, -0.6, 1.0]
    trajectory = flexopt.simulate(changed, posture, base=[-0.4, 0.6, 1.1], duration=2.0, **options)
    for group, numbers in (("posture", posture), ("start_offset", options["offset"])):
        values |= {f"{group}.{joint}": value for joint, value in zip(CRANE.joints, numbers, strict=True)}
    values |= {f"controller.kp.{row}": value for row, value in zip("xyz", options["kp"], strict=True)}
    values |= {f"placement.{name}": value for name, value in zip(("x", "y", "yaw"), (-0.4, 0.6, 1.1), strict=True)}
    with opened(made, tmp_path) as slave:
        slave.set_many(values)
        point = slave.real(*(f"rest_end_point.{row}" for row in "xyz"))
    np.testing.assert_allclose(point, trajectory.target[0], rtol=0, atol=1e-13)
    values |= {f"target.{row}": value for row, value in zip("xyz", point, strict=True)}
    result = run(made, stop_time=2.0, start_values=values)
    assert worst(result, shown(trajectory), made.outputs) < TOLERANCE


@pytest.mark.long
def test_parameters_that_fit_no_machine_are_refused(crane: FmuReport, tmp_path: Path) -> None:
    for values, sentence in (
        ({"posture.lift": 0.0, "posture.knuckle": 0.0}, ""),  # the telescope still moves it
        ({"machine.stiffness.base.x.base.y": 1e9}, "stiffness matrix of the springs is not positive definite"),
        ({"machine.damping.base.x.base.y": 1e9}, "damping matrix is not positive semidefinite"),
        ({"machine.jib.inertia.xy": 1e6}, "negative principal moment"),
        ({"machine.stiffness.base.x.base.x": 1e12}, "RK4 is unstable"),
    ):
        with opened(crane, tmp_path) as slave:
            slave.set_many(values)
            if sentence:
                slave.refuses(sentence, slave.start)
            else:
                slave.start()
    with opened(crane, tmp_path) as slave:
        slave.refuses("posture.extend = -1 must lie between 0 and 3.2", slave.set_many, {"posture.extend": -1.0})
        slave.refuses("placement.yaw must be finite", slave.set_many, {"placement.yaw": float("nan")})
        slave.start()
        slave.refuses("parameter placement.yaw must not change now", slave.set_many, {"placement.yaw": 0.1})
    singular = export(tmp_path, SIX, name="six", **{**CASES["six rows"][1], "duration": 0.1})
    with opened(singular, tmp_path) as slave:
        slave.set_many({"posture.elbow": 0.0})
        slave.refuses("singular: the joints do not move all 6 task rows", slave.start)


@pytest.mark.long
def test_the_description_holds_the_machine(crane: FmuReport, tmp_path: Path) -> None:
    description = fmpy.read_model_description(str(crane.path))
    units = {v.name: v.unit for v in description.modelVariables}
    assert {name: units[name] for name in (
        "q.base.x", "q.base.roll", "v.extend", "v.slew", "torque.slew", "torque.extend", "posture.extend", "posture.lift",
        "actuator.torque_limit.extend", "actuator.torque_limit.lift", "start_offset.extend", "placement.yaw",
        "placement.x_rate", "machine.jib.inertia.xx", "machine.stiffness.base.z.base.pitch", "controller.kp.x",
        "machine.stiffness.base.x.base.x", "machine.stiffness.base.roll.base.roll", "machine.damping.base.z.base.pitch",
        "machine.extend.joint_damping", "target.z", "deflection.base.z", "deflection.base.yaw", "energy",
    )} == {
        "q.base.x": "m", "q.base.roll": "rad", "v.extend": "m/s", "v.slew": "rad/s", "torque.slew": "N.m",
        "torque.extend": "N", "posture.extend": "m", "posture.lift": "rad", "actuator.torque_limit.extend": "N",
        "actuator.torque_limit.lift": "N.m", "start_offset.extend": "m", "placement.yaw": "rad", "placement.x_rate": "m/s",
        "machine.jib.inertia.xx": "kg.m2", "machine.stiffness.base.z.base.pitch": "N", "controller.kp.x": None,
        "machine.stiffness.base.x.base.x": "N/m", "machine.stiffness.base.roll.base.roll": "N.m/rad",
        "machine.damping.base.z.base.pitch": "N.s", "machine.extend.joint_damping": "N.s/m", "target.z": "m",
        "deflection.base.z": "m", "deflection.base.yaw": "rad", "energy": "J",
    }  # fmt: skip
    pins = {name for cylinder in SLEWING.cylinders for name in cylinder.numbers()}
    assert pins
    for machine, report in ((CRANE, crane), (SLEWING, export(tmp_path, SLEWING, "slewing", duration=0.1, **SLOW))):
        variables = {v.name: v for v in fmpy.read_model_description(str(report.path)).modelVariables}
        for parameter in machine.parameters:
            if parameter.name in pins:
                assert f"machine.{parameter.name}" not in variables
            else:
                assert float(variables[f"machine.{parameter.name}"].start) == parameter.value
        for variable in variables.values():
            assert variable.description
            if variable.causality in {"parameter", "input"}:
                assert float(variable.min) <= float(variable.start) <= float(variable.max), variable.name


def test_a_parameter_says_what_it_is() -> None:
    texts = {
        "jib.com.x": "jib: centre of mass, x",
        "base.x.position.z": "base x: position, z",
        "jib.inertia.xy": "jib: inertia, xy",
        "stiffness.base.x.base.yaw": "stiffness of joints base.x.base.yaw",
        "base.stiffness.x": "base stiffness: x",
        "boom.com_offset": "boom: centre of mass offset",
        "gravity": "gravity",
    }
    assert {name: words(name) for name in texts} == texts


def test_noise_is_an_input(tmp_path: Path) -> None:
    options: dict[str, Any] = {"posture": [0.4, 0.3], "kp": 3e3, "kv": 1e3, "duration": 1.0}
    options |= {"sensor": {"noise": 1e-3, "rate_noise": 1e-2}}
    made = export(tmp_path, RAILS, **options)
    names = ["sensor.noise.x", "sensor.noise.y", "sensor.noise.x_rate", "sensor.noise.y_rate"]
    assert list(made.inputs[-4:]) == names
    given = np.zeros(201, dtype=[(n, "f8") for n in ("time", *names)])
    given["time"] = np.arange(201) * 0.005
    drawn = np.random.default_rng(5).standard_normal((201, 4)) * [1e-3, 1e-3, 1e-2, 1e-2]
    for name, column in zip(names, drawn.T, strict=True):
        given[name] = column
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FlexoptWarning)  # noise keeps the base moving
        noisy = shown(flexopt.simulate(RAILS, seed=5, **options))
    placed = [n for n in made.outputs if n.startswith(("q.", "v.", "end_point"))]
    assert worst(run(made, stop_time=1.0, input=given), noisy, placed) < TOLERANCE


@pytest.mark.parametrize(
    ("control", "joints", "force"),
    [("inverse", ["rad", "rad"], "N m²"), ("damped:0.1", ["m", "m"], "N"), ("inverse", ["m", "rad"], "N m² or N"),
     ("transpose", ["rad", "m"], "N")],
)  # fmt: skip
def test_units_of_forces(control: str, joints: list[str], force: str) -> None:
    assert force_unit(control, joints) == force


@pytest.mark.parametrize(
    ("control", "kp", "unit", "more"),
    [("inverse", "N m or N/m", None, ", in N m or N/m"), ("transpose", "N/m", "N/m", "")],
)
def test_gains_of_a_crane_are_told_with_their_units(control: str, kp: str, unit: str | None, more: str) -> None:
    """Of hinges and a telescope: as the loop's own text tells them; FMI knows no unit that is two."""
    asked = {"posture": REACH["truck-crane"], "control": control, "feedback": "pid", "nullspace_damping": 1e3}
    scenario = build_scenario(CRANE, checked_options("test", CRANE, asked))
    found = {v.name: v for group in settable.settings(scenario, scenario.loop.structure).values() for v in group}
    assert gain_units(control, CRANE.joint_units)[0] == kp
    assert found["controller.kp.x"].unit == (unit or "")
    assert found["controller.kp.x"].text == f"proportional gain, axis x{more}"
    for v in found.values():
        assert v.unit or ", in N" in v.text, v


@pytest.mark.long
def test_unknowns_depend_on_what_the_description_says_and_on_nothing_else(tmp_path: Path) -> None:
    """By differences of the model's own Functions at random states and inputs."""
    given = {**CRANED, "gravity": True, "duration": 0.05, "base": [0.3, 0.1, 0.4], "integrator": "rk4"}
    both = [export(tmp_path, name=v, kind="model-exchange", version=v, **given) for v in VERSIONS]
    description, other = (fmpy.read_model_description(str(made.path)) for made in both)
    given |= {"posture": REACH["truck-crane"], "hold": False}
    model: Any = FmuModel(build_scenario(CRANE, checked_options("test", CRANE, given)), "model-exchange",
                          flexopt.simulate(CRANE, **given))  # fmt: skip
    rng = np.random.default_rng(1)
    c = model.setup.call([[v.start for v in (*model.parameters, *model.inputs[: len(model.moving)])]])[0].full().ravel()
    x, i = rng.normal(size=len(model.states)), rng.normal(size=len(model.inputs))
    names = [[v.name for v in model.states], [v.name for v in model.inputs]]
    for function, unknowns in ((model.show, description.outputs), (model.rates, description.derivatives)):
        before = function(x, i, c).full().ravel()
        seen = [set[str]() for _ in before]
        for k, (point, labels) in enumerate(zip((x, i), names, strict=True)):
            for at, name in enumerate(labels):
                moved = [x.copy(), i.copy()]
                moved[k][at] += 0.1
                after = function(*moved, c).full().ravel()
                for row in np.flatnonzero(before != after):
                    seen[row].add(name)
                assert point[at] != moved[k][at]
        for unknown, found in zip(unknowns, seen, strict=True):
            said = {v.name for v in unknown.dependencies}
            assert found <= said, unknown.variable.name
    # Rates are states alone; positions know neither target nor anchor; the error knows where the target is.
    of = {u.variable.name: {v.name for v in u.dependencies} for u in (*description.outputs, *description.derivatives)}
    assert of["der(state.base.x)"] == {"state.base.x_rate"}
    assert not any(name.startswith("target") for name in of["end_point.z"])
    assert [name for name in of["error.y"] if name.startswith("target")] == ["target.y"]
    assert {"target.x", "target.x_rate"} <= of["torque.extend"]
    same = {u.variable.name: {v.name for v in u.dependencies} for u in (*other.outputs, *other.derivatives)}
    assert same == of
    unknowns = {u.variable.name for u in description.initialUnknowns}
    calculated = {v.name for v in description.modelVariables if v.initial == "calculated"}
    assert unknowns == calculated
    assert {"state.base.x", "der(state.extend_rate)", "torque.lift", "rest_end_point.z"} <= unknowns


@pytest.mark.long
@settings(max_examples=6, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 10**6), st.booleans())
def test_setup_is_what_a_scenario_computes(seed: int, gravity: bool) -> None:
    rng = np.random.default_rng(seed)
    rows = [("x", "y", "z", "roll", "pitch", "yaw"), ("x", "z"), ("y", "pitch", "z")][seed % 3]
    machine = tree_from_dict(random_tree(seed, rows=rows))
    given = {"posture": rng.uniform(-1, 1, len(machine.joints)), "gravity": gravity, "base": rng.uniform(-2, 2, 3)}
    given |= {"actuator": {"bandwidth_hz": 5.0}, "sensor": {"delay": 0.01}, "substeps": 500}
    try:
        scenario = build_scenario(machine, checked_options("test", machine, given))
    except (InputError, SingularPosture, NoSolutionFound):
        assume(False)  # the springs do not hold it, or the posture is singular
    check_setup(scenario, 5.0)


@pytest.mark.long
@pytest.mark.needs("gcc", "clang")
@pytest.mark.parametrize("kind", ["co-simulation", "model-exchange"])
def test_the_sources_compile_without_a_warning(tmp_path: Path, kind: str) -> None:
    options = CASES["six rows"][1] | {"integrator": "rk4", "duration": 0.02, "kind": kind}
    made = export(tmp_path, SIX, **options)
    text = str(sources(made, tmp_path))
    for compiler in ("gcc", "clang"):
        command = [compiler, *WARNINGS, "-fsyntax-only", text]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[:3000]


def test_every_fault_of_a_call_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        export(
            tmp_path,
            posture=[0.4, 0.9, -0.7, 9.0],
            base=[1.0, 2.0],
            kp=[1.0, 2.0],
            actuator={"torque_limit": [1.0, 2.0]},
        )
    for part in ("extend", "m", "base", "yaw", "kp", "3 task axes", "actuator.torque_limit"):
        assert part in str(caught.value)
    turning = {"times": [0.0, 1.0], "points": [[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]}
    with pytest.raises(InputError, match=r"base_path: drives yaw, which the FMU cannot"):
        export(tmp_path, base_path=turning)
    # Rails that may be turned: x alone is no input, so a reference that drives it could not be reproduced.
    turned = tree_from_dict(RAILS.to_dict() | {"placement": ["x", "y", "yaw"]})
    path = {"times": [0.0, 1.0], "points": [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]}
    with pytest.raises(InputError, match=r"base_path: drives x, which the FMU cannot"):
        export(tmp_path, turned, posture=[0.4, 0.3], base_path=path)
    with pytest.raises(SingularPosture):
        export(tmp_path, SIX, **{**CASES["six rows"][1], "posture": [0.3, -1.2, 0.0, -0.6, -1.2, 0.2]})
    with pytest.raises(InputError, match="machine"):
        flexopt.export_fmu("truck-crane", tmp_path / "model.fmu", REACH["truck-crane"])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_the_command_line(tmp_path: Path) -> None:
    path = str(tmp_path / "model.fmu")
    arguments = ["truck-crane", "--fmu", path, "--posture", "0.4,0.9,-0.7,0.8", "--base", "1,2,0.5", "--kp", "3e5",
                 "--kv", "2e5", "--duration", "0.1", "--json"]  # fmt: skip
    done = CliRunner().invoke(export_command, arguments)
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    with pytest.warns(FlexoptWarning, match="does not brake the arm's self-motion"):
        made = export(tmp_path, name="twin", base=[1.0, 2.0, 0.5], kp=3e5, kv=2e5, duration=0.1)
    assert made.token == document["token"]
    for wrong, named in ((["--base", "1,2"], "--base"), (["--posture", "0.4,0.9,-0.7,9"], "extend")):
        refused = CliRunner().invoke(export_command, [*arguments, *wrong])
        assert isinstance(refused.exception, InputError)
        assert named in str(refused.exception)
    with zipfile.ZipFile(path) as archive:
        page = archive.read("documentation/index.html").decode()
    assert all(name in page for name in (*made.parameters, *made.inputs, *made.outputs))
    assert difference(run(made, stop_time=0.1), reference(made), ["energy"])["energy"] < TOLERANCE


def test_what_is_wrong_with_the_reference_is_told(tmp_path: Path) -> None:
    """Gains of another machine: the run leaves the finite numbers, and what is written says so."""
    posture = (0.6768, -2.1671, -1.7273, -1.3848, 1.4950, 0.0)
    with warnings.catch_warnings(record=True):
        warnings.simplefilter("always")
        report = flexopt.export_fmu(MOBILE, tmp_path / "wild.fmu", posture, duration=0.5)
        run = flexopt.simulate(MOBILE, posture, duration=0.5)
    assert run.verdict == "grows"
    assert report.warnings[0].startswith("the loop grows: ")
    assert report.warnings[1:] == run.warnings
    assert all(f"warning: {sentence}" in repr(report) for sentence in report.warnings)
    assert report.to_dict()["warnings"] == list(report.warnings)
