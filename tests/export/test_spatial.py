"""Bundles of machines in space: numbers against Pinocchio, NumPy and `evaluate`; what is written and refused."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import flexopt
from flexopt.errors import InputError
from flexopt.export import PARTS, export_c
from flexopt.export.bundle import machine_of
from flexopt.export.context import build_context
from flexopt.model import Tree, shipped_names, tree_from_dict
from flexopt.model.machine import Parameter
from flexopt.model.parameter_ranges import parameter_range
from tests.export.bundle_library import BundleLibrary
from tests.export.emulated.examining import examine_board, examine_host
from tests.export.emulated.faulty import near
from tests.export.programs import GCC, HOST, TARGET
from tests.oracles.spatial import grounded, pinocchio_tree, random_tree

ZEROS = np.zeros(3)


@pytest.mark.long
@GCC
def test_c_agrees_with_pinocchio_numpy_and_evaluate(tmp_path: Path) -> None:
    data = grounded(4, 1)
    machine, oracle = tree_from_dict(data), pinocchio_tree(data)
    parts = ["kinematics", "controller", "measures", "nullspace", "margin", "simulator"]
    library = BundleLibrary(export_c(machine, tmp_path / "b", prefix="m", parts=parts), tmp_path)
    rng = np.random.default_rng(3)
    for posture in ([0.4, -0.6, 1.3, -0.5], [-1.2, 0.3, 0.9, 0.7]):
        base = rng.uniform(-2, 2, 3)
        q = np.concatenate([rng.uniform(-0.1, 0.1, 6), posture])
        r, jacobian, _ = oracle.task(q, base)
        status, out = library("kinematics", coordinates=q, placement=base)
        assert status == "OK"
        np.testing.assert_allclose(out["end_point"], r, rtol=0, atol=1e-13 * 10)
        turned = placed_jacobian(oracle, q, base)
        np.testing.assert_allclose(out["jacobian"], turned, rtol=0, atol=1e-13 * np.linalg.norm(jacobian))
        np.testing.assert_array_equal(out["jacobian"][:, 6:], out["rigid_jacobian"])

        rest = np.concatenate([np.zeros(6), posture])
        jv, point = placed_jacobian(oracle, rest, base)[:, 6:], oracle.task(rest, base)[0]
        measured, target, rate, target_rate = rng.uniform(-1, 1, (4, 3))
        force = 3e3 * (target - measured) + 200.0 * (target_rate - rate)
        inputs = {
            "joint_angles": posture, "measured_point": measured, "measured_rate": rate, "target_point": target,
            "target_rate": target_rate, "proportional_gain": 3e3, "derivative_gain": 200.0, "placement": base,
            "joint_rates": rng.uniform(-1, 1, 4), "nullspace_damping": 70.0,
        }  # fmt: skip
        damper = -70.0 * (np.eye(4) - np.linalg.pinv(jv) @ jv) @ inputs["joint_rates"]
        for law, matrix in (("transpose", jv.T), ("inverse", np.linalg.pinv(jv))):
            status, out = library(f"torque_{law}", **inputs)
            assert status == "OK"
            size = np.linalg.norm(matrix) * np.linalg.norm(force) + 70.0 * np.linalg.norm(inputs["joint_rates"])
            torque = matrix @ force + (damper if law == "inverse" else 0.0)
            np.testing.assert_allclose(out["torque"], torque, rtol=0, atol=1e-13 * size)

        evaluation = flexopt.evaluate(machine, posture, base=base)
        weights, at = rng.uniform(0, 1, 6), {"joint_angles": posture, "placement": base}
        status, out = library("measures", weights=weights, **at)
        assert status == "OK"
        np.testing.assert_allclose(out["angular_frequency"] / (2 * np.pi), evaluation.frequencies_hz, rtol=1e-12)
        assert np.all(np.abs(out["w"] - evaluation.w) <= 1e-11 * evaluation.scale)
        gradient = weights @ evaluation.gradient.w
        np.testing.assert_allclose(out["gradient"], gradient, rtol=0, atol=1e-10 * np.linalg.norm(gradient))

        status, step = library("nullspace_step", weights=weights, step_gain=2.0, **at)
        assert status == "OK"
        arm = point - np.array([*base[:2], 0.0])
        whole = np.hstack([np.eye(3)[:, :2], [[-arm[1]], [arm[0]], [0.0]], jv])
        projected = 2.0 * (np.eye(7) - np.linalg.pinv(whole) @ whole) @ gradient
        np.testing.assert_allclose(step["step"], projected, rtol=0, atol=1e-10 * np.linalg.norm(gradient))

        status, out = library("robust_margin", servo_gain=5e5, **at)
        assert status == "OK"
        assert out["epsilon_max"] == pytest.approx(evaluation.epsilon_max, abs=1e-9)

        v, torque, h = rng.uniform(-0.2, 0.2, 10), rng.uniform(-1e4, 1e4, 4), 1e-3
        inputs = {"coordinates": q, "rates": v, "torque": torque, "placement": ZEROS, "step": h}
        status, out = library("machine_step", **inputs)
        assert status == "OK"
        next_q, next_v = one_step(data, q, v, torque, h)
        np.testing.assert_allclose(out["next_coordinates"], next_q, rtol=0, atol=1e-13)
        np.testing.assert_allclose(out["next_rates"], next_v, rtol=0, atol=1e-11)


@GCC
def test_heights_alone_need_no_placement(tmp_path: Path) -> None:
    """They do not depend on where the base stands, as the points between do, of which errors are a share."""
    data = random_tree(17, rows=("z",), counts=(2, 1))
    library = BundleLibrary(export_c(tree_from_dict(data), tmp_path / "b", prefix="m", parts=["kinematics"]), tmp_path)
    q = np.array([0.1, -0.2, 0.3])
    status, out = library("kinematics", coordinates=q)
    r, jacobian, _ = pinocchio_tree(data).task(q, np.array([2.0, -1.0, 0.5]))
    assert status == "OK"
    np.testing.assert_allclose(out["end_point"], r, rtol=0, atol=1e-12)
    np.testing.assert_allclose(out["jacobian"], jacobian, rtol=0, atol=1e-12)


def placed_jacobian(oracle, q: np.ndarray, base: np.ndarray) -> np.ndarray:
    """The oracle's Jacobian is that of the anchor frame; the placement turns it."""
    c, s = np.cos(base[2]), np.sin(base[2])
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ oracle.task(q, ZEROS)[1]


def one_step(data, q, v, torque, h) -> tuple[np.ndarray, np.ndarray]:
    """Classical RK4 of M v̇ + h + K q + D v = [0; τ] by Pinocchio's forward dynamics, without weight."""
    oracle = pinocchio_tree(data | {"gravity": 0.0})
    stiffness, damping = np.zeros((10, 10)), np.zeros((10, 10))
    stiffness[:6, :6], damping[:6, :6] = (np.array(data[f"{k}_matrix"]["matrix"]) for k in ("stiffness", "damping"))
    force = np.concatenate([np.zeros(6), torque])

    def rate(x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[10:], oracle.forward(x[:10], x[10:], force - stiffness @ x[:10] - damping @ x[10:])])

    x = np.concatenate([q, v])
    k1 = rate(x)
    k2 = rate(x + h / 2 * k1)
    k3 = rate(x + h / 2 * k2)
    k4 = rate(x + h * k3)
    after = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return after[:10], after[10:]


@pytest.mark.long
@GCC
def test_what_cannot_be_computed_is_refused(tmp_path: Path) -> None:
    machine = tree_from_dict(grounded(4, 1))
    library = BundleLibrary(export_c(machine, tmp_path / "b", parts=["controller", "nullspace"]), tmp_path)
    inputs = {
        "joint_angles": [0.5, 0.3, 1.5, 0.5], "measured_point": ZEROS, "measured_rate": ZEROS, "target_point": ZEROS,
        "target_rate": ZEROS, "proportional_gain": 1.0, "derivative_gain": 1.0, "placement": [1.0, 2.0, 0.3],
        "weights": np.ones(6), "step_gain": 1.0, "joint_rates": np.zeros(4), "nullspace_damping": 0.0,
    }  # fmt: skip

    def call(name: str, parameters: list[float] | None = None, **changed) -> str:
        wanted = {field["name"] for field in library.operations[name]["inputs"]}
        given = {key: value for key, value in (inputs | changed).items() if key in wanted}
        status, out = library(name, parameters=parameters, **given)
        assert status == "OK" or all(np.all(value == -7.0) for value in out.values())
        return status

    assert call("torque_inverse") == call("nullspace_step") == "OK"
    # The end-point above the slewing axis: slewing does not move it.
    above = end_point_over_the_axis(machine)
    assert (
        call("torque_inverse", joint_angles=above) == call("nullspace_step", joint_angles=above) == "SINGULAR_POSTURE"
    )
    assert call("torque_transpose", joint_angles=above) == "OK"
    assert call("torque_inverse", joint_angles=[0.5, 1e7, 1.5, 0.5]) == "OUT_OF_RANGE"
    assert call("nullspace_step", placement=[0.0, 0.0, 1e7]) == "OUT_OF_RANGE"
    assert call("nullspace_step", placement=[0.0, np.nan, 0.0]) == "NOT_FINITE"
    names = [parameter.name for parameter in machine.parameters]
    for name, value, status in (
        ("arm2.mass", -1.0, "OUT_OF_RANGE"),
        ("arm1.com.z", np.inf, "NOT_FINITE"),
        ("stiffness.g0.g0", -4e7, "NUMERICAL_FAILURE"),  # no modes without a stable rest
    ):
        changed = list(library.defaults)
        changed[names.index(name)] = value
        assert call("nullspace_step", parameters=changed) == status


def end_point_over_the_axis(machine) -> list[float]:
    """A posture with the end-point on the slewing axis, by bisection on the boom."""
    plant = flexopt.build_plant(machine)

    def away(boom: float) -> float:
        q = plant.rest(ZEROS, [0.0, boom, 0.3, 0.2], plant.parameter_values)
        return float(plant.end_point(q, ZEROS, plant.parameter_values)[0])

    low, high = 0.0, 2.5
    assert away(low) > 0 > away(high)
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if away(middle) > 0 else (low, middle)
    return [0.0, low, 0.3, 0.2]


@pytest.mark.long
@GCC
@pytest.mark.parametrize("placement", [[], ["yaw"]])
def test_placements_slides_and_orientation_rows(placement: list[str], tmp_path: Path) -> None:
    rows = ("x", "y", "z", "roll", "pitch", "yaw")
    data = random_tree(17, rows=rows, counts=(2, 7)) | {"placement": placement}
    machine, oracle = tree_from_dict(data), pinocchio_tree(data)
    library = BundleLibrary(export_c(machine, tmp_path / "b", parts=["kinematics", "controller"]), tmp_path)
    header = (tmp_path / "b" / "include" / "tree17_control.h").read_text()
    assert all(f"TREE17_AXIS_{row.upper()}" in header for row in rows)
    assert ("TREE17_PLACEMENT_YAW" in header) == bool(placement)
    units = re.search(r"Actuated joints.*?\}", header, flags=re.DOTALL)
    assert units is not None
    assert [f"/* {unit} */" for unit in machine.joint_units] == re.findall(r"/\* (?:m|rad) \*/", units[0])
    rng = np.random.default_rng(2)
    for _ in range(5):
        q, yaw = rng.uniform(-1, 1, 9), rng.uniform(-0.3, 0.3)
        base = np.array([0.0, 0.0, yaw if placement else 0.0])
        r, _, angle = oracle.task(q, base)
        if angle > 3.0:
            continue
        status, out = library("kinematics", coordinates=q, **({"placement": [yaw]} if placement else {}))
        assert status == "OK"
        np.testing.assert_allclose(out["end_point"], r, rtol=0, atol=1e-12)


def test_nothing_is_left_out(tmp_path: Path) -> None:
    machine = flexopt.load("slewing-excavator")
    report = export_c(machine, tmp_path / "a", parts=["kinematics"])
    assert set(report.manifest["left_out"]) == {"loop"}
    assert not any(PARTS[part].refusal(machine) for part in PARTS)
    bound = tree_from_dict(grounded(3, 1) | {"placement": []})
    assert {part for part in PARTS if PARTS[part].refusal(bound)} == {"levers"}
    with pytest.raises(InputError, match="a cylinder or a speed"):
        export_c(bound, tmp_path / "b", parts=["levers"])


def test_the_manifest_carries_the_machine(tmp_path: Path) -> None:
    machine = flexopt.load("slewing-excavator")
    report = export_c(machine, tmp_path / "b", parts=["kinematics"])
    assert machine_of(report.manifest) == machine
    assert machine_of(report.manifest).content_hash == report.manifest["machine_sha256"]
    assert flexopt.load("excavator") == machine_of({"machine": flexopt.load("excavator").to_dict()})


@pytest.mark.parametrize("name", shipped_names("models"))
def test_a_machines_own_parameters_are_allowed(name: str) -> None:
    options = {"control": "inverse", "gain": 1.0, "single": False, "baked": False, "singularity_margin_deg": 1.0}
    parameters = build_context(flexopt.load(name), **options).parameters
    own = np.array(parameters.values)
    assert np.all((own >= parameters.low) & (own <= parameters.high))
    drawn = parameters.draw(np.random.default_rng(0), 200)
    assert np.all((drawn >= parameters.low) & (drawn <= parameters.high))
    assert near(parameters, drawn).all()
    lengths = np.array([unit == "m" for unit in parameters.units])
    assert np.all(np.ptp(drawn, axis=0)[lengths] > 0)


@pytest.mark.parametrize(
    ("name", "value", "unit", "low", "high"),
    [
        ("a.b.mass", 3.0, "kg", 1.1754944e-38, 1e9),
        ("a.b.mass", 0.0, "kg", 0.0, 1e9),
        ("payload.mass", 3.0, "kg", 0.0, 1e9),
        ("b.inertia.xx", 3.0, "kg m²", 0.0, 1e15),
        ("b.inertia.xy", 3.0, "kg m²", -1e15, 1e15),
        ("base.x.rest", 0.0, "m", -1e6, 1e6),
        ("base.yaw.rest", 0.0, "rad", -4 * np.pi, 4 * np.pi),
        ("base.stiffness.x", 1.0, "N/m", 1.1754944e-38, 1e15),
        ("stiffness.base.x.base.y", 1.0, "N/m", -1e15, 1e15),
        ("damping.base.x.base.y", 1.0, "N s/m", -1e12, 1e12),
        ("b.position.z", 0.0, "m", -1e4, 1e4),
    ],
)
def test_ranges_of_parameters(name: str, value: float, unit: str, low: float, high: float) -> None:
    assert parameter_range(Parameter(name, value, unit)) == (low, high)


# Two passive joints, placed by x, y and yaw: C of a small share of what a tracked machine's has. The host compiles it
# nine times, so it has the fewest driven joints.
def small_tree(actuated: int, rows: tuple[str, ...]) -> Tree:
    return tree_from_dict(random_tree(17, rows=rows, counts=(2, actuated)))


@pytest.mark.long
@HOST
@pytest.mark.parametrize(
    ("real", "parts"),
    [("double", ["kinematics", "controller", "measures"]), ("float", ["kinematics", "simulator"])],
    ids=["double", "float"],
)
def test_everything_holds_on_the_host(real, parts: list[str], tmp_path: Path) -> None:
    """Rates of 1e36 m/s after a step are beyond what single precision has a way to: a refusal is right, too."""
    report = export_c(small_tree(2, ("x", "z")), tmp_path / "b", real=real, parts=parts)
    examine_host(report, tmp_path / "scratch", 200, 2_000)


@pytest.mark.long
@TARGET
@pytest.mark.parametrize(
    ("make", "parts"),
    [
        (lambda: flexopt.load("slewing-excavator"), ["kinematics", "controller", "levers"]),
        (
            lambda: small_tree(4, ("x", "y", "z")),
            ["kinematics", "controller", "measures", "nullspace", "margin", "simulator"],
        ),
    ],
    ids=["slewing excavator", "small tree"],
)
def test_everything_holds_on_an_emulated_processor(make, parts: list[str], tmp_path: Path) -> None:
    folder = export_c(make(), tmp_path / "b", parts=parts).folder
    examine_board(folder, tmp_path / "scratch", "cortex-m7", 60)
