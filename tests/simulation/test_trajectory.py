"""The result object: shapes, units, files that read back to the same numbers, a readable summary."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
import xarray as xr
from scipy.linalg import eigh

import flexopt
from flexopt import build_plant
from flexopt.errors import FlexoptWarning
from flexopt.model import machine_from_dict
from tests.oracles.closed_loop_ode import Loop
from tests.oracles.machines import NumpySource, Structure, draw_machine
from tests.simulation.loops import EXCAVATOR, POSTURE_A, POSTURE_B, stable_case

SAMPLES = 400


@pytest.fixture(scope="module")
def trajectory():
    return flexopt.simulate(EXCAVATOR, POSTURE_B, duration=2.0, base=0.3, gravity=True, seed=3)


@pytest.fixture(scope="module")
def other():
    """Another layout: base rigid in x and in rotation, a passive hinge, three joints."""
    case = stable_case(2, Structure(4, ("y",), (1,)), "transpose", samples=400)
    with pytest.warns(FlexoptWarning, match="self-motion"):
        return flexopt.simulate(case.machine, **(case.options | {"nullspace_damping": 0.0}))


def test_shapes(trajectory):
    k = SAMPLES + 1
    assert trajectory.time.shape == (k,)
    assert trajectory.time[0] == 0
    assert trajectory.time[-1] == 2.0
    assert trajectory.q.shape == trajectory.v.shape == (k, 5)
    assert trajectory.end_point.shape == trajectory.error.shape == trajectory.target.shape == (k, 2)
    assert trajectory.torque.shape == (k, 2)
    assert trajectory.energy.shape == (k,)
    assert trajectory.deflection.shape == (k, 3)
    assert trajectory.base.shape == (k, 1)
    assert trajectory.skeleton.shape == (k, 4, 2)
    assert trajectory.residual_oscillation.shape == trajectory.frequencies_hz.shape == (3,)
    assert trajectory.coordinates == build_plant(EXCAVATOR).coordinates
    assert trajectory.joints == ("boom", "stick")


def test_what_it_holds_fits_together(trajectory):
    plant, p = build_plant(EXCAVATOR), build_plant(EXCAVATOR).parameter_values
    for i in (0, 17, SAMPLES):
        q, v = trajectory.q[i], trajectory.v[i]
        point = plant.end_point(q, 0.3, p).full().ravel()
        np.testing.assert_allclose(trajectory.end_point[i], point, atol=1e-12)
        np.testing.assert_allclose(trajectory.skeleton[i], plant.skeleton(q, 0.3, p).full().T, atol=1e-12)
        kinetic = v @ plant.mass(q, 0.3, p).full() @ v / 2
        stretch = q - plant.rest(0.3, q[3:], p).full().ravel()
        springs = stretch @ plant.stiffness(p).full() @ stretch / 2
        without_weight = trajectory.energy[i] - kinetic - springs
        heights = potential(plant, q)
        assert without_weight == pytest.approx(heights, rel=1e-10)
    np.testing.assert_allclose(trajectory.error, trajectory.target - trajectory.end_point, atol=1e-13)
    np.testing.assert_array_equal(trajectory.base, np.full((SAMPLES + 1, 1), 0.3))
    loop = Loop(EXCAVATOR, np.array(POSTURE_B), base=0.3, gravity=True)
    np.testing.assert_allclose(trajectory.target[0], loop.target, atol=1e-12)
    np.testing.assert_allclose(trajectory.deflection, trajectory.q[:, :3] - loop.q_design[:3], atol=1e-12)
    assert trajectory.peak_base_rotation == pytest.approx(np.abs(trajectory.deflection[:-1, 2]).max())
    assert trajectory.end_error == pytest.approx(np.linalg.norm(trajectory.error[-1]))


def potential(plant, q):
    """Weight times height of every centre of mass, from the machine's own numbers."""
    machine, height = plant.machine, 0.0
    at, angle = np.array(q[:2]), q[2]
    bodies = [machine.base, *machine.links]
    for body, turn in zip(bodies, [0.0, *q[3:]], strict=True):
        angle = angle + turn
        height += body.mass * (at[1] + body.com * np.sin(angle) + body.com_offset * np.cos(angle))
        at = at + body.length * np.array([np.cos(angle), np.sin(angle)])
    return machine.gravity * (height + machine.payload.mass * at[1])


def test_modal_energy_of_the_last_period(trajectory):
    """½ (η̇² + ω² η²) with modes of the oracle's matrices, in the slowest mode's last period."""
    loop = Loop(EXCAVATOR, np.array(POSTURE_B), base=0.3, gravity=True)
    plant, p = build_plant(EXCAVATOR), build_plant(EXCAVATOR).parameter_values
    mass = plant.mass(loop.q_design, 0.3, p).full()
    stiffness = loop.stiffness.copy()
    stiffness[:3, :3] += plant.gravity_stiffness(loop.q_design, 0.3, p).full()
    squares, modes = eigh(stiffness, mass)
    squares, modes = squares[-3:], modes[:, -3:]
    np.testing.assert_allclose(trajectory.frequencies_hz, np.sqrt(squares) / (2 * np.pi), rtol=1e-9)
    eta, rate = (trajectory.q - loop.q_design) @ mass @ modes, trajectory.v @ mass @ modes
    energy = (rate**2 + squares * eta**2) / 2
    period = int(np.ceil(1 / trajectory.frequencies_hz[0] * 200 - 1e-9))
    # What is watched at the start of each sample stands for the sample.
    np.testing.assert_allclose(trajectory.residual_oscillation, energy[:-1][-period:].max(axis=0), rtol=1e-8)


def test_dataset(trajectory, other):
    data = trajectory.dataset
    assert dict(data.sizes) == {
        "time": SAMPLES + 1, "coordinate": 5, "axis": 2, "joint": 2, "passive": 3, "placement": 1
    }  # fmt: skip
    units = {name: data[name].attrs["units"] for name in data.data_vars}
    assert units == {
        "q": "m or rad", "v": "m/s or rad/s", "end_point": "m", "error": "m", "torque": "N m", "energy": "J",
        "deflection": "m or rad", "base": "m", "target": "m",
    }  # fmt: skip
    for name in data.data_vars:
        np.testing.assert_array_equal(data[name].values, getattr(trajectory, str(name)))
    assert data.time.attrs["units"] == "s"
    assert list(data.axis.values) == ["x", "y"]
    assert data.attrs["verdict"] == trajectory.verdict
    assert data.attrs["machine"] == "excavator"
    np.testing.assert_array_equal(data.torque.sel(joint="stick"), trajectory.torque[:, 1])
    np.testing.assert_array_equal(data.q.sel(coordinate="base.x"), trajectory.q[:, 0])
    assert dict(other.dataset.sizes) == {
        "time": 401, "coordinate": 5, "axis": 2, "joint": 3, "passive": 2, "placement": 1
    }  # fmt: skip
    assert other.peak_base_rotation is None


@pytest.mark.parametrize("name", ["trajectory", "other"])
def test_netcdf_reads_back(name, request, tmp_path):
    run = request.getfixturevalue(name)
    path = tmp_path / "run.nc"
    run.to_netcdf(path)
    with xr.open_dataset(path, engine="scipy") as read:
        for variable in run.dataset.data_vars:
            np.testing.assert_array_equal(read[variable].values, run.dataset[variable].values)
            assert read[variable].attrs["units"] == run.dataset[variable].attrs["units"]
        assert list(read.coordinate.values) == list(run.coordinates)
        assert json.loads(read.attrs["flexopt"]) == run.to_dict()


@pytest.mark.parametrize("name", ["trajectory", "other"])
def test_csv_reads_back(name, request, tmp_path):
    run = request.getfixturevalue(name)
    path = tmp_path / "run.csv"
    run.to_csv(path)
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    assert header[0] == "time_s"
    assert header[-1] == "energy_J"
    assert header[1 : 1 + len(run.coordinates)] == [f"q_{c}" for c in run.coordinates]
    assert {"end_point_x_m", "error_y_m", *(f"torque_{joint}_Nm" for joint in run.joints)} <= set(header)
    numbers = np.array(rows, dtype=float)
    # Seventeen digits: the same numbers to the last bit.
    expected = [run.time[:, None], run.q, run.v, run.end_point, run.error, run.torque, run.energy[:, None]]
    np.testing.assert_array_equal(numbers, np.concatenate(expected, axis=1))


def test_dictionary(trajectory, other):
    for run in (trajectory, other):
        document = json.loads(json.dumps(run.to_dict(), allow_nan=False))
        # The contract's keys, and more.
        assert {"verdict", "growth_rate", "settling_time", "end_error", "peak_base_rotation", "provenance"} <= set(
            document
        )
        assert document["verdict"] in ("converges", "grows", "undecided")
        assert document["duration"] == run.time[-1]
        assert document["samples"] == len(run.time)
    options = trajectory.to_dict()["provenance"]["options"]
    assert options["gravity"] is True
    assert options["base"] == [0.3]
    assert options["seed"] == 3
    assert trajectory.to_dict()["provenance"]["machine_sha256"] == EXCAVATOR.content_hash


def test_the_options_of_the_provenance_give_the_run_again(trajectory):
    options = trajectory.to_dict()["provenance"]["options"]
    again = flexopt.simulate(EXCAVATOR, **options)
    np.testing.assert_array_equal(again.q, trajectory.q)


def test_summary(trajectory, other):
    text = repr(trajectory)
    assert text.splitlines()[0].startswith("excavator, Jacobian inverse control, 2 s: the oscillation")
    assert f"{trajectory.end_error:.3e} m" in text
    assert "Hz" in text
    assert "rad" in text
    assert "warning: the controller does not brake the arm's self-motion" in repr(other)
    assert "turns by up to –" in repr(other)
    assert "nan" not in text
    assert "None" not in text


@pytest.mark.parametrize("gravity", [False, True])
@pytest.mark.parametrize("posture", [POSTURE_A, POSTURE_B], ids="AB")
def test_a_machine_at_rest_is_not_said_to_move(posture, gravity):
    """Rounding moves it by 1e-14, and that may grow: it is neither an oscillation nor an overshoot."""
    still = flexopt.simulate(EXCAVATOR, posture, offset=(0.0, 0.0), duration=5.0, gravity=gravity)
    # The run shows nothing: the eigenvalues say that A would grow if it were touched.
    assert still.run.word == "converges"
    assert still.verdict == ("undecided" if posture == POSTURE_A else "converges")
    assert "never moves the base" in still.verdict_reason
    assert still.growth_rate is None
    assert still.overshoot is None
    assert still.settling_time == 0.0
    assert still.peak_base_rotation < 1e-12
    assert still.end_error < 1e-12
    repr(still)
    json.dumps(still.to_dict(), allow_nan=False)


def test_growth_from_a_hardly_visible_start():
    """An unstable loop from a nanoradian off: the verdict and the rate are those of the linear loop."""
    tiny = flexopt.simulate(EXCAVATOR, POSTURE_A, offset=(1e-9, -1e-9), duration=30.0, integrator="dop853")
    assert tiny.verdict == "grows"
    loop = Loop(EXCAVATOR, np.array(POSTURE_A), kp=np.full(2, 1e5), kv=np.full(2, 2e3))
    assert tiny.growth_rate == pytest.approx(loop.growth_rate(0.005, "exact"), rel=3e-3)


def test_one_sample():
    short = flexopt.simulate(EXCAVATOR, POSTURE_A, duration=0.005)
    assert len(short.time) == 2
    json.dumps(short.to_dict(), allow_nan=False)
    repr(short)


def test_overshoot_and_settling_of_an_arm_on_stiff_ground():
    """An arm whose base hardly gives, transpose control with gains M̂-scaled: a second-order loop with ζ = 0.4.

    With inertia M̂ in task space, Kp = ω² (Jv M̂⁻¹ Jvᵀ)⁻¹ would decouple the axes; scalar gains on one joint's motion do so
    only for small motions along one eigenvector, which is where the start lies.
    """
    data = draw_machine(NumpySource(np.random.default_rng(6)), Structure(2, ("x",), ()), joint_damping=False)
    data["base"]["stiffness"]["x"] = 1e9
    data["base"]["mass"] = 1e6
    data["base"]["damping"] = {}
    machine = machine_from_dict(data)
    posture = np.array([0.4, 1.3])
    loop = Loop(machine, posture, control="transpose")
    m = loop.m
    mass = loop.terms(loop.q_design, 0 * loop.q_design, 0.0)[0][m:, m:]
    rigid = loop.tip(loop.q_design, 0.0)[1][:, m:]
    # M̂ q̈ = −kp JvᵀJv q − kv JvᵀJv q̇: an eigenvector of M̂⁻¹ JvᵀJv moves on its own, kv/kp alike for both.
    values, vectors = np.linalg.eig(np.linalg.solve(mass, rigid.T @ rigid))
    slow = np.argmin(values)
    omega, zeta = 5.0, 0.4
    kp = omega**2 / values[slow]
    offset = 1e-5 * vectors[:, slow] / np.linalg.norm(vectors[:, slow])
    run = flexopt.simulate(
        machine, posture, control="transpose", kp=kp, kv=2 * zeta / omega * kp, offset=offset, duration=4.0, rate=2e3,
        hold=False, integrator="rk4",
    )  # fmt: skip
    root = np.sqrt(1 - zeta**2)
    assert run.overshoot == pytest.approx(np.exp(-np.pi * zeta / root), rel=2e-3)
    t = np.linspace(0, 4, 400_001)
    e = np.exp(-zeta * omega * t) * (np.cos(root * omega * t) + zeta / root * np.sin(root * omega * t))
    settles = t[np.flatnonzero(np.abs(e) > 0.02)[-1]]
    assert run.settling_time == pytest.approx(settles, abs=2e-3)
