"""Laws, sensors and actuators one by one, and all at once, against the same loop written out in NumPy."""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import cont2discrete

import flexopt
from flexopt import build_plant, optimal_controller
from flexopt.model import machine_from_dict
from flexopt.simulation import Actuator, Path, Sensor
from tests.oracles.closed_loop_ode import Loop
from tests.oracles.machines import Structure
from tests.simulation.loops import EXCAVATOR, POSTURE_A, POSTURE_B, Case, run, scenario, stable_case

pytestmark = pytest.mark.usefixtures("interpreted")

HZ = 2 * math.pi
OFFSET = (0.04, -0.06)
# Gains at which the excavator's loop about posture B decays.
GAINS = {"kp": (2e4, 3e4), "kv": (2e3, 3e3)}
# Two programs that do the same differ by rounding alone, which a decaying loop forgets.
AGREE = 1e-11


def both(options: dict, words: dict, *, machine=EXCAVATOR, posture=POSTURE_B, offset=OFFSET, samples=200, rate=200.0):
    """The trajectory of `simulate` and the states of the oracle."""
    gains = {} if "feedback" in options and options["feedback"] in ("robust", "none") else GAINS
    made = scenario(
        machine, **({"posture": posture, "offset": offset, "rate": rate, "duration": samples / rate} | gains | options)
    )
    trajectory = run(made)
    arrays = {name: np.array(value) for name, value in gains.items()}
    loop = Loop(machine, np.array(posture), **(arrays | words))
    np.testing.assert_allclose(loop.q_design, made.q_design, atol=1e-13)
    steps = {"substeps": made.loop.structure.substeps, "after": made.loop.structure.after}
    states = loop.run(offset, period=1 / rate, samples=samples, hold=made.options.hold, **steps)
    return trajectory, states, loop


def agree(trajectory, states, loop, tolerance=AGREE):
    n = trajectory.q.shape[1]
    size = max(1.0, np.abs(states).max())
    assert np.abs(trajectory.q - states[:, :n]).max() <= tolerance * size
    assert np.abs(trajectory.v - states[:, n:]).max() <= tolerance * size
    if loop.torques:
        torques = np.array(loop.torques)
        assert np.abs(trajectory.torque[:-1] - torques).max() <= 10 * tolerance * np.abs(torques).max()


def noise(seed: int, samples: int, size: float, rate_size: float) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((samples, 4)) * [size, size, rate_size, rate_size]


LIMITS = (600.0, 400.0)
PARTS = {
    "inverse": ({}, {}),
    "transpose": ({"control": "transpose", "kp": 3e4, "kv": 3e3}, {"control": "transpose", "kp": 3e4, "kv": 3e3}),
    "damped": ({"control": "damped:0.4"}, {"control": "damped:0.4"}),
    "damped, continuous": ({"control": "damped:0.4", "hold": False}, {"control": "damped:0.4"}),
    "continuous": ({"hold": False}, {}),
    "no controller": ({"feedback": "none"}, {"open": True}),
    "pid": (
        {"feedback": "pid", "ki": (4e4, 2e4)},
        {"ki": np.array([4e4, 2e4])},
    ),
    "pid, integral limited": (
        {"feedback": "pid", "ki": 4e4, "integral_limit": 150.0},
        {"ki": 4e4, "integral_limit": 150.0},
    ),
    "pid, continuous": ({"feedback": "pid", "ki": 4e4, "hold": False}, {"ki": 4e4}),
    "pid, continuous, integral limited": (
        {"feedback": "pid", "ki": 4e4, "integral_limit": 150.0, "hold": False},
        {"ki": 4e4, "integral_limit": 150.0},
    ),
    "delay of one sample": ({"sensor": {"delay": 0.005}}, {"delay": 1}),
    "delay of three": ({"sensor": Sensor(delay=0.015)}, {"delay": 3}),
    "delay of a part of a sample": ({"sensor": {"delay": 0.0012}}, {"delay": 1, "early": 0.0012}),
    "delay between samples": ({"sensor": {"delay": 0.0133}, "substeps": 4}, {"delay": 3, "early": 0.0033}),
    "filter": ({"sensor": {"filter_hz": 8.0}}, {"filter": HZ * 8.0}),
    "filter after a delay": ({"sensor": {"filter_hz": 8.0, "delay": 0.01}}, {"filter": HZ * 8.0, "delay": 2}),
    "quantised position": ({"sensor": {"resolution": 2e-3}}, {"resolution": 2e-3}),
    "quantised rate": ({"sensor": {"rate_resolution": 0.01}}, {"rate_resolution": 0.01}),
    "noise": (
        {"sensor": {"noise": 1e-3, "rate_noise": 5e-3}, "seed": 12},
        {"noise": noise(12, 200, 1e-3, 5e-3)},
    ),
    "torque limit": ({"actuator": {"torque_limit": LIMITS}}, {"torque_limit": np.array(LIMITS)}),
    "dead band": ({"actuator": {"dead_band": 150.0}}, {"dead_band": 150.0}),
    "servo": ({"actuator": {"bandwidth_hz": (12.0, 20.0)}}, {"bandwidth": HZ * np.array([12.0, 20.0])}),
    "servo, rate limited": (
        {"actuator": Actuator(bandwidth_hz=20.0, rate_limit=3e4)},
        {"bandwidth": HZ * 20.0, "rate_limit": 3e4},
    ),
    "servo, continuous": ({"actuator": {"bandwidth_hz": 15.0}, "hold": False}, {"bandwidth": HZ * 15.0}),
    "gravity": ({"gravity": True}, {"gravity": True}),
    "gravity, no compensation": (
        {"gravity": True, "gravity_compensation": False},
        {"gravity": True, "compensated": False},
    ),
    "gravity and servo": (
        {"gravity": True, "actuator": {"bandwidth_hz": 15.0}},
        {"gravity": True, "bandwidth": HZ * 15.0},
    ),
    "everything, between samples": (
        {
            "feedback": "pid", "ki": 1e4, "gravity": True, "seed": 4, "base": 0.5, "substeps": 2,
            "sensor": {"noise": 1e-4, "resolution": 1e-4, "filter_hz": 30.0, "delay": 0.0085},
            "actuator": {"dead_band": (20.0, 10.0), "bandwidth_hz": 30.0},
        },
        {
            "ki": 1e4, "gravity": True, "base": 0.5, "delay": 2, "early": 0.0035, "resolution": 1e-4,
            "filter": HZ * 30.0, "noise": noise(4, 200, 1e-4, 0.0), "dead_band": np.array([20.0, 10.0]),
            "bandwidth": HZ * 30.0,
        },
    ),
    "everything": (
        {
            "feedback": "pid", "ki": 1e4, "integral_limit": 500.0, "gravity": True, "seed": 4, "base": 0.5, "substeps": 2,
            "sensor": {"noise": 1e-4, "rate_noise": 1e-3, "resolution": 1e-4, "rate_resolution": 1e-3, "delay": 0.01},
            "actuator": {"torque_limit": (3e4, 2e4), "dead_band": (20.0, 10.0), "bandwidth_hz": 30.0, "rate_limit": 4e5},
        },
        {
            "ki": 1e4, "integral_limit": 500.0, "gravity": True, "base": 0.5, "delay": 2, "resolution": 1e-4,
            "rate_resolution": 1e-3, "noise": noise(4, 200, 1e-4, 1e-3), "torque_limit": np.array([3e4, 2e4]),
            "dead_band": np.array([20.0, 10.0]), "bandwidth": HZ * 30.0, "rate_limit": 4e5,
        },
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", list(PARTS))
def test_each_part_on_the_excavator(name):
    options, words = PARTS[name]
    agree(*both(options, words))


def test_parts_act_as_their_names_say():
    """Each part changes the run that it is given to, so that the comparison above compares something."""
    plain = run(scenario(EXCAVATOR, posture=POSTURE_B, offset=OFFSET, duration=1.0, **GAINS))
    for name, (options, _) in PARTS.items():
        if name == "inverse":
            continue
        made = scenario(EXCAVATOR, **({"posture": POSTURE_B, "offset": OFFSET, "duration": 1.0} | GAINS | options))
        assert np.abs(run(made).q - plain.q).max() > 1e-5, name


@pytest.mark.parametrize(
    ("structure", "control"),
    [
        (Structure(3, ("x", "rotation"), (1,)), "inverse"),
        (Structure(3, ("x", "rotation"), (1,)), "transpose"),
        (Structure(4, ("y",), (0,)), "inverse"),
        (Structure(3, (), (0,)), "transpose"),
    ],
    ids=str,
)
def test_parts_of_random_machines(structure, control):
    """Servo, delay, compensation, torque limit and self-motion damper on machines with passive hinges in the arm."""
    case: Case = stable_case(7, structure, control, samples=150, gravity=True)
    o = case.options
    base = {name: o[name] for name in ("base", "control", "kp", "kv")}
    damping = o.get("nullspace_damping", 0.0)
    plain = run(case.scenario)
    limit = 0.6 * np.abs(plain.torque).max(axis=0)
    bandwidth = 0.2 * o["rate"]
    options = base | {
        "gravity": True, "nullspace_damping": damping, "sensor": {"delay": 1 / o["rate"]},
        "actuator": {"torque_limit": limit, "bandwidth_hz": bandwidth},
    }  # fmt: skip
    words = base | {
        "gravity": True, "nullspace_damping": damping, "delay": 1, "torque_limit": limit, "bandwidth": HZ * bandwidth
    }  # fmt: skip
    trajectory, states, loop = both(
        options, words, machine=case.machine, posture=o["posture"], offset=o["offset"], samples=150, rate=o["rate"]
    )
    agree(trajectory, states, loop)


PATH_TIMES = (0.1, 0.4, 0.9)


@pytest.mark.parametrize("hold", [True, False])
def test_moving_base_and_moving_target(hold):
    start = np.array(scenario(EXCAVATOR, posture=POSTURE_B).target)
    base_points = np.array([0.2, 0.5, 0.3])
    target_points = np.add(start, [0.2, 0.0]) + np.array([[0.0, 0.0], [0.25, 0.1], [0.1, -0.1]])

    def base_path(t):
        return np.interp(t, PATH_TIMES, base_points)

    def target_path(t):
        return np.array([np.interp(t, PATH_TIMES, column) for column in target_points.T])

    options = {
        "base": 0.2, "base_path": {"times": PATH_TIMES, "points": base_points[:, None]},
        "target_path": Path(times=PATH_TIMES, points=target_points.tolist()), "hold": hold,
    }  # fmt: skip
    words = {"base": 0.2, "base_path": base_path, "target_path": target_path}
    trajectory, states, loop = both(options, words, samples=300)
    agree(trajectory, states, loop)
    np.testing.assert_allclose(trajectory.base[:, 0], base_path(trajectory.time), atol=1e-14)
    np.testing.assert_allclose(trajectory.target, [target_path(t) for t in trajectory.time], atol=1e-14)
    np.testing.assert_allclose(trajectory.error, trajectory.target - trajectory.end_point, atol=1e-13)


def test_a_driven_base_carries_the_machine_and_leaves_the_end_point():
    """Driven by 0.3 m in 6 s and held, the machine stands where the base is, the end-point where it was."""
    path = {"times": [0.0, 6.0], "points": [[0.0], [0.3]]}
    made = scenario(EXCAVATOR, posture=POSTURE_B, offset=(0.0, 0.0), base_path=path, duration=14.0, kp=1e5, kv=2e4)
    trajectory = run(made)
    assert trajectory.q[-1, 0] == pytest.approx(0.3, abs=1e-3)
    assert np.linalg.norm(trajectory.end_point[-1] - made.target) < 1e-3
    # While it is driven the end-point stays near: the controller holds it against the ground's motion.
    assert np.linalg.norm(trajectory.error, axis=1).max() < 0.02


@pytest.mark.parametrize("control", ["inverse", "transpose"])
@pytest.mark.parametrize("hold", [True, False])
def test_the_robust_law_is_the_optimal_controller(hold, control):
    """f = kr K e with K from the plant's own matrices, discretised by SciPy where it is sampled."""
    gain, period = 3e5, 0.005
    loop = Loop(EXCAVATOR, np.array(POSTURE_A), control=control)
    a, b, c = loop.matrices()
    if hold:
        a, b, *_ = cont2discrete((a, b, c, np.zeros((2, 2))), period)
    law = optimal_controller(a, gain * b, c, dt=period if hold else 0.0)
    words = {"control": control, "law": (law.A, law.B, gain * law.C, gain * law.D)}
    options = {"control": control, "feedback": "robust", "gain": gain, "hold": hold}
    trajectory, states, oracle = both(options, words, posture=POSTURE_A)
    # The Riccati solutions belong to two state-space forms of one plant, and agree to about ten digits.
    agree(trajectory, states, oracle, tolerance=1e-8)


@pytest.mark.parametrize("bandwidth", [5.0, 25.0])
def test_the_servo_is_a_first_order_lag(bandwidth):
    """A command that sticks to its limit L: τ = L (1 − exp(−2π f t))."""
    made = scenario(
        EXCAVATOR, posture=POSTURE_B, kp=1e8, kv=0.0, duration=0.2, integrator="dop853", substeps=4,
        actuator={"torque_limit": (90.0, 60.0), "bandwidth_hz": bandwidth},
    )  # fmt: skip
    trajectory = run(made)
    sign = np.sign(trajectory.torque[-1])
    expected = np.outer(1 - np.exp(-HZ * bandwidth * trajectory.time), [90.0, 60.0]) * sign
    np.testing.assert_allclose(trajectory.torque, expected, atol=1e-9)


def test_the_servo_at_its_rate_limit():
    """A ramp until ω (L − τ) falls to the limit r, on a sample; from there the lag."""
    omega, limit, at = HZ * 10.0, 90.0, 0.1
    rate = limit / (at + 1 / omega)
    made = scenario(
        EXCAVATOR, posture=POSTURE_B, kp=1e8, kv=0.0, duration=0.25, integrator="dop853", substeps=4,
        actuator={"torque_limit": limit, "bandwidth_hz": 10.0, "rate_limit": rate},
    )  # fmt: skip
    trajectory = run(made)
    t = trajectory.time
    lagging = limit - (limit - rate * at) * np.exp(-omega * (t - at))
    expected = np.where(t <= at, rate * t, lagging)[:, None] * np.sign(trajectory.torque[-1])
    np.testing.assert_allclose(trajectory.torque, expected, atol=1e-7)
    assert np.abs(np.diff(trajectory.torque, axis=0)).max() <= rate * 0.005 * (1 + 1e-9)


def test_limits_hold_everywhere():
    for actuator in ({"torque_limit": (500.0, 300.0)}, {"torque_limit": (500.0, 300.0), "bandwidth_hz": 30.0}):
        made = scenario(EXCAVATOR, posture=POSTURE_A, duration=3.0, kp=1e6, kv=1e4, actuator=actuator)
        torque = np.abs(run(made).torque)
        assert np.all(torque <= np.array([500.0, 300.0]) * (1 + 1e-12))
        assert np.all(torque.max(axis=0) > np.array([490.0, 290.0]))


def test_inside_the_dead_band_nothing_happens():
    made = scenario(EXCAVATOR, posture=POSTURE_B, duration=0.5, actuator={"dead_band": 1e9}, **GAINS)
    free = scenario(EXCAVATOR, posture=POSTURE_B, duration=0.5, feedback="none")
    trajectory = run(made)
    assert np.all(trajectory.torque == 0)
    np.testing.assert_array_equal(trajectory.q, run(free).q)


def test_noise_is_the_seeds_alone():
    options = {"posture": POSTURE_B, "duration": 0.5, "sensor": {"noise": 1e-3, "rate_noise": 1e-2}} | GAINS
    first, again = (run(scenario(EXCAVATOR, **options, seed=5)) for _ in range(2))
    other = run(scenario(EXCAVATOR, **options, seed=6))
    for name in ("q", "v", "torque", "energy"):
        assert getattr(first, name).tobytes() == getattr(again, name).tobytes()
        assert getattr(first, name).tobytes() != getattr(other, name).tobytes()
    made = scenario(EXCAVATOR, **(options | {"duration": 100.0}))
    signals = made.signals()
    np.testing.assert_allclose(signals.std(axis=0), [1e-3, 1e-3, 1e-2, 1e-2], rtol=0.03)


def test_what_is_quantised_lies_on_the_grid():
    """Seen through the torque of a proportional law in one axis: only so many values."""
    made = scenario(
        EXCAVATOR, posture=POSTURE_B, duration=1.0, kp=(3e4, 0.0), kv=0.0, control="transpose",
        sensor={"resolution": 0.01},
    )  # fmt: skip
    trajectory = run(made)
    plant, p = build_plant(EXCAVATOR), build_plant(EXCAVATOR).parameter_values
    believed = trajectory.q.copy()
    believed[:, :3] = made.q_design[:3]
    rigid = np.array([plant.rigid_jacobian(q, 0.0, p).full() for q in believed])
    error = np.array(
        [np.linalg.lstsq(j.T, tau, rcond=None)[0][0] / 3e4 for j, tau in zip(rigid, trajectory.torque, strict=False)]
    )
    seen = (made.target[0] - error) / 0.01
    np.testing.assert_allclose(seen, np.round(seen), atol=1e-7)
    assert len(set(np.round(seen))) > 4
    assert np.all(np.abs(seen * 0.01 - trajectory.end_point[:, 0]) <= 0.005 + 1e-9)


@pytest.mark.parametrize(
    "structure", [Structure(3, ("x", "y", "rotation"), ()), Structure(4, ("rotation",), ())], ids=str
)
def test_the_nullspace_damper(structure):
    """It brakes the self-motion of redundant arms, and pushes nothing at the end-point."""
    case = stable_case(3, structure, "inverse", samples=1500)
    o, data = dict(case.options), copy.deepcopy(case.data)
    for link in data["links"]:
        link.pop("joint_damping", None)
    machine = machine_from_dict(data)
    damped = scenario(machine, **o)
    free = scenario(machine, **(o | {"nullspace_damping": 0.0}))
    plant, m = build_plant(machine), len(damped.q_design) - structure[0]
    p = plant.parameter_values

    # The damper's own torque at random states: −d (I − Jv⁺ Jv) q̇, so that Jv τ, and with it the force, is zero.
    rng = np.random.default_rng(0)
    n = len(damped.q_design)
    rows = damped.loop.outputs.name_out().index("torque")
    for _ in range(5):
        q, v = damped.q_design + 0.3 * rng.uniform(-1, 1, n), rng.uniform(-1, 1, n)
        torques = []
        for made in (damped, free):
            x = made.start.copy()
            x[:n] = made.start[:n] + np.linalg.solve(
                made.loop.to_q, q - made.q_design - np.r_[np.zeros(m), o["offset"]]
            )
            x[n : 2 * n] = np.linalg.solve(made.loop.to_q, v)
            torques.append(made.loop.outputs(x, [], made.constants)[rows].full().ravel())
        believed = np.concatenate([damped.q_design[:m], q[m:]])
        rigid = plant.rigid_jacobian(believed, o["base"], p).full()
        own = torques[0] - torques[1]
        size = np.abs(torques).max()
        expected = -o["nullspace_damping"] * (np.eye(n - m) - np.linalg.pinv(rigid) @ rigid) @ v[m:]
        np.testing.assert_allclose(own, expected, atol=1e-11 * size)
        assert np.abs(rigid @ own).max() <= 1e-11 * size * np.linalg.norm(rigid)

    # A start with self-motion: it stays without the damper, and goes with it.
    rigid = plant.rigid_jacobian(damped.q_design, o["base"], p).full()
    direction = np.linalg.svd(rigid)[2][-1]
    left = []
    for made in (damped, free):
        x = made.start.copy()
        x[n : 2 * n] = np.linalg.solve(made.loop.to_q, np.concatenate([np.zeros(m), 0.2 * direction]))
        trajectory = run(replace(made, start=x))
        q, v = trajectory.q[-1], trajectory.v[-1]
        rigid_now = plant.rigid_jacobian(np.concatenate([damped.q_design[:m], q[m:]]), o["base"], p).full()
        left.append(np.linalg.norm((np.eye(n - m) - np.linalg.pinv(rigid_now) @ rigid_now) @ v[m:]))
    assert left[0] < 1e-3
    assert left[1] > 20 * left[0]


@pytest.mark.parametrize("posture", [POSTURE_A, POSTURE_B], ids="AB")
@pytest.mark.parametrize(
    "options", [{}, {"actuator": {"bandwidth_hz": 20.0}}, {"integrator": "gauss"}, {"sensor": {"delay": 0.01}}], ids=str
)
def test_a_machine_that_hangs_in_its_springs_stays_there(posture, options):
    """Under its weight, from equilibrium, 10 s."""
    made = scenario(
        EXCAVATOR, posture=posture, gravity=True, offset=(0.0, 0.0), kp=1e4, kv=1e3, duration=10.0, **options
    )
    # Torque at the undeflected base over its stiffness, −3.3 and −16.2 mrad, and what the lean adds to it.
    first_order = {POSTURE_A: -3.33e-3, POSTURE_B: -16.2e-3}[posture]
    assert made.q_design[2] - EXCAVATOR.base.rest_angle == pytest.approx(first_order, rel=0.06)
    np.testing.assert_allclose(made.q_design, Loop(EXCAVATOR, np.array(posture), gravity=True).q_design, atol=1e-13)
    trajectory = run(made)
    assert np.abs(trajectory.q - made.q_design).max() < 1e-9
    assert np.abs(trajectory.v).max() < 1e-9
    assert np.abs(trajectory.error).max() < 1e-9
    assert np.abs(trajectory.deflection).max() < 1e-9
    # The joints carry the arm's weight.
    plant = build_plant(EXCAVATOR)
    weight = plant.gravity(made.q_design, 0.0, plant.parameter_values).full().ravel()[3:]
    np.testing.assert_allclose(trajectory.torque, np.broadcast_to(weight, trajectory.torque.shape), rtol=1e-9)


def test_public_call_takes_tables_and_objects_alike():
    tables = {
        "sensor": {"delay": 0.01},
        "actuator": {"torque_limit": 2e4},
        "target_path": {"times": [0, 1], "points": [[2.0, 1.0], [2.1, 1.0]]},
    }
    objects = {"sensor": Sensor(delay=0.01), "actuator": Actuator(torque_limit=2e4), "target_path": Path(times=(0, 1), points=((2.0, 1.0), (2.1, 1.0)))}  # fmt: skip
    arrays = tables | {"target_path": {"times": np.array([0.0, 1.0]), "points": np.array([[2.0, 1.0], [2.1, 1.0]])}}
    runs = [flexopt.simulate(EXCAVATOR, POSTURE_B, duration=0.2, **given) for given in (tables, objects, arrays)]
    for other in runs[1:]:
        np.testing.assert_array_equal(runs[0].q, other.q)
