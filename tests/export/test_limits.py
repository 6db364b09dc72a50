"""Measured joints beyond their limits and after whole turns: outputs come all the same, and say so."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

import flexopt
from flexopt.errors import InputError
from flexopt.export import export_c
from flexopt.export.sources import STATUSES, WITH_OUTPUT
from flexopt.model import tree_from_dict
from tests.export.bundle_library import BundleLibrary
from tests.export.programs import GCC, MAKE
from tests.oracles.spatial import random_tree

PARTS = ["kinematics", "controller", "levers", "measures", "nullspace", "simulator"]
MILLIRADIAN = 1e-3


def inputs_of(library: BundleLibrary, name: str, posture: np.ndarray, **changed) -> dict:
    """Inputs in the middle of their ranges, but for the posture."""
    given = {}
    for field in library.operations[name]["inputs"]:
        given[field["name"]] = np.full(field["shape"], 0.25)
    plant = flexopt.build_plant(flexopt.load(library.machine))
    rest = plant.rest(np.zeros(plant.n_base), posture, plant.parameter_values).full().ravel()
    known = {"coordinates": rest, "joint_angles": posture, "placement": np.zeros(plant.n_base), "step": 1e-3}
    return {key: (known | changed).get(key, value) for key, value in given.items()}


@pytest.fixture(scope="module", params=["double", "float"])
def library(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> BundleLibrary:
    folder = tmp_path_factory.mktemp("limits")
    machine = flexopt.load("slewing-excavator")
    return BundleLibrary(export_c(machine, folder / "b", prefix="m", parts=PARTS, real=request.param), folder)


# Slew (no limits), boom, stick, bucket, far from singular postures.
POSTURE = np.array([0.4, 0.5, -1.4, -0.5])


@pytest.mark.long
@GCC
def test_beyond_a_limit_a_torque_comes_with_a_warning(library: BundleLibrary) -> None:
    machine = flexopt.load("slewing-excavator")
    for joint in (1, 2, 3):
        for end, sign in ((0, -1), (1, 1)):
            at, outside, failed = POSTURE.copy(), POSTURE.copy(), POSTURE.copy()
            limit = machine.limits[joint][end]
            at[joint], outside[joint] = limit - sign * MILLIRADIAN, limit + sign * MILLIRADIAN
            failed[joint] = limit + sign * (np.radians(5.0) + MILLIRADIAN)
            for name in ("kinematics", "torque_transpose", "torque_inverse", "levers", "lever_rates", "measures"):
                q = {posture.tobytes(): inputs_of(library, name, posture) for posture in (at, outside, failed)}
                before, inside = library(name, **q[at.tobytes()])
                status, out = library(name, **q[outside.tobytes()])
                assert (before, status) == ("OK", "BEYOND_LIMIT")
                for key, value in out.items():
                    # Two milliradians away from each other.
                    scale = np.abs(inside[key]).max() + 1e-30
                    assert np.abs(value - inside[key]).max() <= 0.2 * scale
                status, out = library(name, **q[failed.tobytes()])
                assert status == "OUT_OF_RANGE"
                assert all(np.all(value == -7.0) for value in out.values())


@pytest.mark.long
@GCC
def test_the_error_of_w_holds_where_a_mode_leaves_the_joints_still(library: BundleLibrary) -> None:
    """Near half a turn of the slew sideways modes do not move boom, stick and bucket, and the slew hardly in one."""
    machine, single = flexopt.load("slewing-excavator"), library.real.__name__ == "c_float"
    given = inputs_of(library, "measures", POSTURE)
    for slew in (np.pi, -np.pi, np.pi + 1e-6, 0.0, 1e-7):
        for arm in ((0.72, -1.55, 0.11), (0.5, -1.4, -0.5)):
            posture = np.array([slew, *arm])
            posture = posture.astype(np.float32).astype(float) if single else posture
            status, out = library("measures", **(given | {"joint_angles": posture}))
            exact = flexopt.evaluate(machine, posture, base=given["placement"]).w
            assert status == "OK"
            # In single precision parameters are rounded, too; in double the reference is.
            allowed = out["w_error"] + (1e-4 * np.abs(exact) if single else out["w_error"])
            assert np.all(np.abs(out["w"] - exact) <= allowed), (slew, arm)


@pytest.mark.long("double-2", "float-2", "float--3", "float-100", "double--3")
@GCC
@pytest.mark.parametrize("turns", [2, -3, 100])
def test_whole_turns_of_a_free_hinge_change_nothing(library: BundleLibrary, turns: int) -> None:
    single = library.real.__name__ == "c_float"
    turned = POSTURE + np.array([2 * np.pi * turns, 0, 0, 0])
    # What the input itself loses where it is rounded.
    lost = abs(np.spacing(np.float32(turned[0]) if single else turned[0]))
    for name in ("kinematics", "torque_transpose", "torque_inverse", "levers", "measures", "nullspace_step"):
        (status, expected), (again, out) = (
            library(name, **inputs_of(library, name, posture)) for posture in (POSTURE, turned)
        )
        assert status == again == "OK"
        for key, value in out.items():
            if key == "gradient" or key == "step":
                continue  # a difference of terms that are larger than it
            scale = np.abs(expected[key]).max() + 1e-30
            share = 1e3 * lost if key.startswith("w") else 30 * lost
            assert np.abs(value - expected[key]).max() <= (share + (1e-4 if single else 1e-11)) * scale
    status, out = library("torque_inverse", **inputs_of(library, "torque_inverse", POSTURE * [1e9, 1, 1, 1]))
    assert status == "OUT_OF_RANGE"


@pytest.mark.long("float")
@GCC
def test_the_simulated_machine_turns_on(library: BundleLibrary) -> None:
    plant = flexopt.build_plant(flexopt.load("slewing-excavator"))
    turned = POSTURE + np.array([4 * np.pi, 0, 0, 0])
    results = []
    for posture in (POSTURE, turned):
        given = inputs_of(library, "machine_step", posture, rates=np.full(plant.n_coordinates, 0.1))
        status, out = library("machine_step", **given)
        assert status == "OK"
        results.append(out)
    near, far = results
    moved = far["next_coordinates"] - near["next_coordinates"]
    tolerance = 2e-6 if library.real.__name__ == "c_float" else 1e-13
    expected = np.zeros(plant.n_coordinates)
    expected[plant.n_passive] = 4 * np.pi
    np.testing.assert_allclose(moved, expected, rtol=0, atol=10 * tolerance)
    np.testing.assert_allclose(far["next_rates"], near["next_rates"], rtol=0, atol=1e3 * tolerance)


@GCC
def test_a_turned_placement_changes_nothing(library: BundleLibrary) -> None:
    for name in ("kinematics", "torque_inverse", "nullspace_step"):
        placed = [np.array([0.3, -0.2, yaw]) for yaw in (0.5, 0.5 + 8 * np.pi)]
        (status, expected), (again, out) = (
            library(name, **inputs_of(library, name, POSTURE, placement=placement)) for placement in placed
        )
        assert status == again == "OK"
        for key, value in out.items():
            scale = np.abs(expected[key]).max()
            assert (
                np.abs(value - expected[key]).max() <= (2e-3 if library.real.__name__ == "c_float" else 1e-10) * scale
            )


def test_statuses_say_which_come_with_outputs(library: BundleLibrary) -> None:
    assert library.manifest["statuses_with_output"] == list(WITH_OUTPUT) == ["OK", "BEYOND_LIMIT"]
    for name, code in library.manifest["statuses"].items():
        assert library.c.m_has_output(code) == (name in WITH_OUTPUT)
    readme = (library.folder / "README.md").read_text()
    for name in STATUSES:
        row = next(line for line in readme.splitlines() if line.startswith(f"| `M_{name}`"))
        assert row.endswith("| new |" if name in WITH_OUTPUT else "| as it was |")


@GCC
@pytest.mark.parametrize("seed", [3, 17])
def test_slides_and_hinges_have_an_allowance_each(seed: int, tmp_path: Path) -> None:
    data = random_tree(seed, rows=("x", "y", "z"), counts=(2, 5))
    for body in data["bodies"]:
        if not body["joint"].get("passive"):
            body["joint"]["limits"] = [-0.9, 0.8]
    machine = tree_from_dict(data)
    options = {"limit_allowance_deg": 2.0, "limit_allowance_m": 0.3, "prefix": "m", "parts": ["controller"]}
    library = BundleLibrary(export_c(machine, tmp_path / "b", **options), tmp_path)
    field = next(f for f in library.operations["torque_transpose"]["inputs"] if f["name"] == "joint_angles")
    allowed = np.array([np.radians(2.0) if unit == "rad" else 0.3 for unit in machine.joint_units])
    np.testing.assert_allclose(np.subtract(field["high"], field["limits"][1]), allowed, rtol=1e-12)
    np.testing.assert_allclose(np.subtract(field["limits"][0], field["low"]), allowed, rtol=1e-12)
    given = {f["name"]: np.full(f["shape"], 0.1) for f in library.operations["torque_transpose"]["inputs"]}
    for k, beyond in enumerate(allowed):
        for share, wanted in ((0.99, "BEYOND_LIMIT"), (1.01, "OUT_OF_RANGE")):
            angles = np.full(len(allowed), 0.1)
            angles[k] = 0.8 + share * beyond
            assert library("torque_transpose", **(given | {"joint_angles": angles}))[0] == wanted
    with pytest.raises(InputError, match="limit_allowance_deg") as caught:
        export_c(machine, tmp_path / "c", limit_allowance_deg=90.0, limit_allowance_m=-1.0)
    assert {fault.field for fault in caught.value.faults} == {"limit_allowance_deg", "limit_allowance_m"}


@MAKE
def test_fast_math_is_refused(tmp_path: Path) -> None:
    folder = export_c(flexopt.load("excavator"), tmp_path / "b", parts=["controller"]).folder
    for flags in ("-O2 -ffast-math", "-O2 -ffinite-math-only"):
        done = subprocess.run(
            ["make", "-C", str(folder), f"CFLAGS={flags}"], capture_output=True, text=True, check=False
        )
        assert done.returncode != 0
        assert "refusals rely on NaN" in done.stderr


@pytest.mark.long
@GCC
@pytest.mark.parametrize("machine", ["slewing-excavator", "boom-stick-bucket"])
def test_single_precision_takes_almost_all_postures(machine: str, tmp_path: Path) -> None:
    report = export_c(flexopt.load(machine), tmp_path / "b", real="float", parts=["measures"], prefix="m")
    library = BundleLibrary(report, tmp_path)
    operation = library.operations["measures"]
    assert operation["acceptance"] >= 0.95
    # The same share by the C itself, on other postures; and what it says of its error holds against `evaluate`.
    rng, taken, loaded = np.random.default_rng(5), 0, flexopt.load(machine)
    field = next(f for f in operation["inputs"] if f["name"] == "joint_angles")
    ends = np.clip(field["limits"], -np.pi, np.pi)
    count = 120
    for _ in range(count):
        posture = rng.uniform(*ends).astype(np.float32).astype(float)
        given = {f["name"]: np.zeros(f["shape"]) for f in operation["inputs"]}
        given |= {"joint_angles": posture, "weights": np.ones(field_length(operation, "weights"))}
        status, out = library("measures", **given)
        assert status in ("OK", "SINGULAR_POSTURE", "NOT_ACCURATE")
        taken += status == "OK"
        if status == "OK" and taken <= 20:
            exact = np.array(flexopt.evaluate(loaded, posture).w)
            # The parameters, too, are rounded.
            assert np.all(np.abs(out["w"] - exact) <= out["w_error"] + 1e-4 * np.abs(exact).max())
    assert abs(taken / count - operation["acceptance"]) <= 0.06


def field_length(operation: dict, name: str) -> int:
    return int(np.prod(next(f["shape"] for f in operation["inputs"] if f["name"] == name)))
