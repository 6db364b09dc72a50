"""The kernels against the rooms they come from and against formulas; the C library called from Python by ctypes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

import flexopt
from flexopt.export import export_c
from flexopt.export.context import build_context
from flexopt.export.modal import margin
from flexopt.robustness.margin import build_margin
from tests.export.bundle_library import BundleLibrary
from tests.export.programs import GCC
from tests.oracles.controls import task_map
from tests.oracles.machines import Structure, arm_at_rest, random_machine

pytestmark = GCC

PARTS_TESTED = ["kinematics", "controller", "measures", "nullspace", "margin"]
REDUNDANT = Structure(4, ("x", "rotation"), (1,))


def excavator() -> flexopt.Machine:
    return flexopt.load("excavator")


def redundant() -> flexopt.Machine:
    """Three actuated joints, a flexible one, a rigid direction of the base."""
    return random_machine(np.random.default_rng(4), REDUNDANT, joint_damping=False)[1]


def rigid_jacobian(machine: flexopt.Machine, posture: np.ndarray) -> np.ndarray:
    """Column i is the vector from joint i to the end-point, turned by 90°."""
    joints, tip = arm_at_rest(machine, posture)
    away = tip - joints
    return np.array([-away[:, 1], away[:, 0]])


# Each bundle has the transposed and the inverse law; what `control` changes are the measures, by way of one matrix.
@pytest.mark.long
@pytest.mark.parametrize(
    ("make", "control"), [(redundant, "inverse"), (redundant, "damped:0.25"), (excavator, "transpose")]
)
def test_c_agrees_with_formulas_and_with_evaluate(make, control: str, tmp_path: Path) -> None:
    machine = make()
    library = BundleLibrary(
        export_c(machine, tmp_path / "b", control=control, prefix="m", parts=PARTS_TESTED), tmp_path
    )
    rng = np.random.default_rng(3)
    plant = flexopt.build_plant(machine)
    n, m, tested = plant.n_actuated, plant.n_passive, 0
    for _ in range(8):
        posture = rng.uniform(-1.5, 1.5, n)
        if float(plant.singularity_sine_squared(0, posture, plant.parameter_values)) < 0.05:
            continue
        tested += 1
        jv = rigid_jacobian(machine, posture)
        point, target, rate, target_rate = rng.uniform(-1, 1, (4, 2))
        force = 3e3 * (target - point) + 200.0 * (target_rate - rate)
        inputs = {
            "joint_angles": posture, "measured_point": point, "measured_rate": rate, "target_point": target,
            "target_rate": target_rate, "proportional_gain": 3e3, "derivative_gain": 200.0,
            "joint_rates": rng.uniform(-1, 1, n), "nullspace_damping": 70.0,
        }  # fmt: skip
        damper = -70.0 * (np.eye(n) - np.linalg.pinv(jv) @ jv) @ inputs["joint_rates"]
        laws = {"transpose": "transpose", "inverse": "inverse", control.partition(":")[0]: control}
        for law, meant in laws.items():
            matrix = task_map(jv, meant)
            status, out = library(f"torque_{law}", **inputs)
            assert status == "OK"
            size = np.linalg.norm(matrix) * np.linalg.norm(force) + 70.0 * np.linalg.norm(inputs["joint_rates"])
            torque = matrix @ force + (damper if law == "inverse" else 0.0)
            np.testing.assert_allclose(out["torque"], torque, rtol=0, atol=1e-13 * size)

        rest = plant.rest(0, posture, plant.parameter_values).full().ravel()
        status, out = library("kinematics", coordinates=rest)
        assert status == "OK"
        np.testing.assert_allclose(out["rigid_jacobian"], jv, rtol=0, atol=1e-13 * np.linalg.norm(jv))
        np.testing.assert_allclose(out["end_point"], arm_at_rest(machine, posture)[1], rtol=0, atol=1e-13 * 10)
        assert out["jacobian"].shape == (2, plant.n_coordinates)
        np.testing.assert_array_equal(out["jacobian"][:, m:], out["rigid_jacobian"])

        weights = rng.uniform(0, 1, m)
        evaluation = flexopt.evaluate(machine, posture, control=control)
        status, out = library("measures", joint_angles=posture, weights=weights)
        assert status == "OK"
        np.testing.assert_allclose(out["angular_frequency"] / (2 * np.pi), evaluation.frequencies_hz, rtol=1e-12)
        assert np.all(np.abs(out["w"] - evaluation.w) <= 1e-11 * evaluation.scale)
        gradient = weights @ evaluation.gradient.w
        np.testing.assert_allclose(out["gradient"], gradient, rtol=0, atol=1e-10 * (1e-9 + np.linalg.norm(gradient)))

        status, step = library("nullspace_step", joint_angles=posture, weights=weights, step_gain=2.0)
        assert status == "OK"
        base_jacobian = np.hstack([[[1.0], [0.0]], jv])
        projected = 2.0 * (np.eye(n + 1) - np.linalg.pinv(base_jacobian) @ base_jacobian) @ gradient
        np.testing.assert_allclose(step["step"], projected, rtol=0, atol=1e-11 * np.linalg.norm(gradient))

        status, out = library("robust_margin", joint_angles=posture, servo_gain=5e5)
        assert status == "OK"
        # Two forms of the same plant; conditions of some 1e4 leave ten digits.
        assert out["epsilon_max"] == pytest.approx(evaluation.epsilon_max, abs=1e-9)
    assert tested >= 4


def test_end_point_states_do_not_change_the_margin() -> None:
    machine = redundant()
    context = build_context(
        machine, control="inverse", gain=1e4, single=False, baked=False, singularity_margin_deg=10.0
    )  # fmt: skip
    (operation,) = margin(context)
    samples = operation.draw(context.parameters, 40, 3)
    original = build_margin(machine)
    n = context.plant.n_actuated
    for row, value in zip(samples.inputs, samples.outputs[:, 0], strict=True):
        epsilon = original.values.call([0, row[:n], row[n + 1 :], row[n]])[0]
        assert value == pytest.approx(float(epsilon[0]), abs=1e-8)


def epsilon_by_scipy(a: np.ndarray, b: np.ndarray, c: np.ndarray, kr: float) -> float:
    """ε_max of (A, k_r B, C) by SciPy's Riccati solver, in a time in which the gain at high frequencies is near one."""
    rate, unit = np.sqrt(kr * np.linalg.norm(c @ a @ b)), np.eye(b.shape[1])
    # Half of the states are positions: those count in the unit of time, too.
    half = a.shape[0] // 2
    size = np.repeat([rate, 1.0], [half, a.shape[0] - half])
    a, b = a / size[:, None] * size / rate, kr * b / size[:, None] / rate
    balance = np.sqrt(np.linalg.norm(b) / np.linalg.norm(c))
    b, c = b / balance, c * balance
    x = scipy.linalg.solve_continuous_are(a, b, c.T @ c, unit)
    z = scipy.linalg.solve_continuous_are(a.T, c.T, b @ b.T, unit)
    return float((1 + np.linalg.eigvals(x @ z).real.max()) ** -0.5)


@pytest.mark.long
def test_single_precision_tells_where_a_large_servo_gain_takes_its_digits(tmp_path: Path) -> None:
    machine = flexopt.load("mobile-manipulator")
    library = BundleLibrary(export_c(machine, tmp_path / "b", real="float", prefix="m", parts=["margin"]), tmp_path)
    plant, rng = flexopt.build_plant(machine), np.random.default_rng(2)
    p, still = plant.parameter_values, np.zeros(plant.n_base)
    physical, postures = build_margin(machine).physical_plant, list[np.ndarray]()
    while len(postures) < 12:
        posture = np.float32(rng.uniform(-1.5, 1.5, plant.n_actuated)).astype(float)
        if float(plant.singularity_sine_squared(still, posture, p)) > 0.1:
            postures.append(posture)
    answered: dict[float, int] = {}
    for kr in (1e0, 1e4, 5e5, 1e7, 1e9, 1e11, 1e13, 1e15):
        gain = float(np.float32(kr))
        for posture in postures:
            status, out = library("robust_margin", joint_angles=posture, servo_gain=gain, placement=still)
            assert status in ("OK", "NOT_ACCURATE")
            if status == "OK":
                answered[kr] = answered.get(kr, 0) + 1
                a, b, c = (x.full() for x in physical.call([still, posture, p]))
                assert out["epsilon_max"] == pytest.approx(epsilon_by_scipy(a, b, c, gain), abs=1e-4)
    # Nothing is refused where all digits that are promised are there.
    assert all(answered[kr] == len(postures) for kr in (1e0, 1e4, 5e5, 1e7))


def test_parameters_at_run_time_and_refusals(tmp_path: Path) -> None:
    machine = excavator()
    library = BundleLibrary(export_c(machine, tmp_path / "b", parts=["measures", "controller"]), tmp_path)
    posture, weights = [0.9, -1.4], [1.0, 0.0, 0.0]
    names = [parameter.name for parameter in machine.parameters]
    loaded = list(library.defaults)
    loaded[names.index("payload.mass")] = 500.0
    data = machine.to_dict() | {"payload": {"mass": 500.0}}
    expected = flexopt.evaluate(flexopt.machine_from_dict(data), posture).w
    status, out = library("measures", parameters=loaded, joint_angles=posture, weights=weights)
    assert status == "OK"
    np.testing.assert_allclose(out["w"], expected, rtol=1e-9)
    assert abs(out["w"][0] / flexopt.evaluate(machine, posture).w[0] - 1) > 1e-2

    refused = {
        "NOT_FINITE": {"joint_angles": [np.nan, -1.4]},
        "OUT_OF_RANGE": {"joint_angles": [0.9, -1e7]},
        "SINGULAR_POSTURE": {"joint_angles": [0.9, 0.001]},
    }
    for wanted, inputs in refused.items():
        status, out = library("measures", **({"weights": weights} | inputs))
        assert status == wanted
        assert all(np.all(value == -7.0) for value in out.values())
    loaded[names.index("boom.mass")] = -1.0
    status, out = library("measures", parameters=loaded, joint_angles=posture, weights=weights)
    assert status == "OUT_OF_RANGE"
    assert np.all(out["w"] == -7.0)


def test_baked_equals_run_time_parameters(tmp_path: Path) -> None:
    machine, rng = redundant(), np.random.default_rng(0)
    pair = [
        BundleLibrary(export_c(machine, tmp_path / f"b{baked}", parts=["controller"], baked=baked, prefix=f"m{k}"), tmp_path)
        for k, baked in enumerate((False, True))
    ]  # fmt: skip
    for _ in range(20):
        posture, points = rng.uniform(-1.5, 1.5, 3), rng.uniform(-1, 1, (4, 2))
        keys = ("measured_point", "measured_rate", "target_point", "target_rate")
        inputs = {"joint_angles": posture, "proportional_gain": 1e3, "derivative_gain": 10.0}
        inputs |= dict(zip(keys, points, strict=True))
        (one, a), (other, b) = (library("torque_transpose", **inputs) for library in pair)
        assert one == other == "OK"
        np.testing.assert_allclose(a["torque"], b["torque"], rtol=1e-12, atol=1e-9)


def test_the_machines_step_is_the_simulation(tmp_path: Path) -> None:
    machine, posture = excavator(), [0.0448, -2.0499]
    library = BundleLibrary(export_c(machine, tmp_path / "b", parts=["simulator"]), tmp_path)
    run = flexopt.simulate(machine, posture, base=2.5, duration=1.0)
    q, v = run.q[0], run.v[0]
    for torque in run.torque[:-1]:
        inputs = {"coordinates": q, "rates": v, "torque": torque, "placement": [2.5], "step": 0.005}
        status, out = library("machine_step", **inputs)
        assert status == "OK"
        q, v = out["next_coordinates"], out["next_rates"]
    np.testing.assert_allclose(q, run.q[-1], rtol=0, atol=1e-11)
    np.testing.assert_allclose(v, run.v[-1], rtol=0, atol=1e-10)
    assert library("machine_step", **(inputs | {"step": 0.2}))[0] == "OUT_OF_RANGE"
    assert library("machine_step", **(inputs | {"step": 0.0}))[0] == "OUT_OF_RANGE"
    assert library("machine_step", **(inputs | {"rates": v * np.nan}))[0] == "NOT_FINITE"
