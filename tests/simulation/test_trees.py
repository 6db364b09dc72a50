"""Closed loops in space: a planar machine sent there, energy, ways of running, linear loop, placements, parameters."""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import flexopt
from flexopt.errors import InputError
from flexopt.loop.machine_step import machine_step
from flexopt.model import tree_from_dict
from flexopt.plant import build_plant
from flexopt.plant.machine_motion import constant_names, full_structure, motion_of, structure_of
from tests.oracles.machines import Structure
from tests.oracles.spatial import grounded, in_space, random_tree
from tests.simulation.loops import EXCAVATOR, POSTURE_B, run, scenario, stable_case
from tests.simulation.test_linear import apart, held, without_self_motion
from tests.simulation.trees import BASE

pytestmark = pytest.mark.usefixtures("interpreted")

ARM = (0.3, 0.5, -1.0, -0.6)
# Gains at which the loop of `grounded` about ARM decays.
GAINS = {"control": "transpose", "kp": 3e4, "kv": 1e4, "nullspace_damping": 2e3}
# Rounding, of loops that decay.
AGREE = 1e-11


def on_tracks(arm: int = 4, **more):
    """Six ground coordinates, damped, and some joints."""
    data = grounded(arm, 3, coupled=False) | more
    for body in data["bodies"]:
        body["joint"] |= {"damping": 1e5} if "damping" in body["joint"] else {}
    return data


TRACKS = tree_from_dict(on_tracks())


def same(plane, space, tolerance=AGREE):
    """Every sample and measure of two runs."""
    for name in ("q", "v", "end_point", "error", "torque", "energy", "deflection", "target", "base"):
        a, b = getattr(plane, name), getattr(space, name)
        assert a.shape == b.shape, name
        assert np.abs(a - b).max() <= tolerance * max(1.0, np.abs(a).max()), name
    assert plane.verdict == space.verdict
    for name in ("growth_rate", "settling_time", "overshoot", "end_error", "peak_base_rotation"):
        a, b = getattr(plane, name), getattr(space, name)
        assert (a is None) == (b is None)
        # Settling times jump from sample to sample; an error of rounding has rounding's relative error.
        assert a is None or b == pytest.approx(a, rel=1e-6, abs=1e-9), name


PARTS = {
    "inverse": {},
    "transpose": {"control": "transpose", "kp": 3e4, "kv": 3e3},
    "damped": {"control": "damped:0.1"},
    "continuous": {"hold": False},
    "gravity": {"gravity": True},
    "gravity, no compensation": {"gravity": True, "gravity_compensation": False},
    "dop853": {"integrator": "dop853", "gravity": True},
    "gauss": {"integrator": "gauss", "gravity": True},
    "pid, limits, delay, noise": {
        "feedback": "pid", "ki": 1e4, "integral_limit": 500.0, "gravity": True, "seed": 4, "substeps": 2,
        "sensor": {"noise": 1e-4, "rate_noise": 1e-3, "delay": 0.01},
        "actuator": {"torque_limit": (3e4, 2e4), "dead_band": (20.0, 10.0), "bandwidth_hz": 30.0, "rate_limit": 4e5},
    },
    "moving base and target": {
        "base_path": {"times": (0.1, 0.4), "points": ((0.5,), (0.8,))},
        "target_path": {"times": (0.1, 0.4), "points": ((2.2, 1.0), (2.3, 1.1))},
    },
}  # fmt: skip


@pytest.mark.parametrize("name", list(PARTS))
def test_the_excavator_sent_through_space(name):
    """Slides along x and z, hinges about −y: the same trajectory by other equations."""
    options = {"posture": POSTURE_B, "base": 0.5, "kp": (2e4, 3e4), "kv": (2e3, 3e3), "duration": 1.0} | PARTS[name]
    space = tree_from_dict(in_space(EXCAVATOR.model_dump(by_alias=True)))
    same(run(scenario(EXCAVATOR, **options)), run(scenario(space, **options)))


def test_the_robust_law_in_space():
    space = tree_from_dict(in_space(EXCAVATOR.model_dump(by_alias=True)))
    options = {"posture": POSTURE_B, "feedback": "robust", "duration": 1.0}
    # The Riccati solutions belong to two state-space forms of one plant, and agree to about ten digits.
    same(run(scenario(EXCAVATOR, **options)), run(scenario(space, **options)), tolerance=1e-7)


@pytest.mark.long
def test_a_redundant_planar_arm_with_flexible_joints_sent_through_space():
    case = stable_case(1, Structure(5, ("x", "y", "rotation"), (1, 3)), "inverse", samples=300, gravity=True)
    space = tree_from_dict(in_space(case.machine.model_dump(by_alias=True)))
    plane, spatial = (run(scenario(machine, **case.options)) for machine in (case.machine, space))
    # In space both flexible joints and the base's rotation are passive hinges; the first of the joints is actuated.
    same(plane, spatial)


@pytest.mark.long("gauss-4", "dop853-4", "gauss-9")
@pytest.mark.parametrize(("method", "seed"), [("dop853", 2), ("dop853", 4), ("gauss", 4), ("gauss", 9)])
def test_undamped_trees_keep_their_energy(method, seed):
    """Slides and hinges, the arm falling freely: energy of weight and springs included."""
    data = random_tree(seed, counts=(3, 3))
    for body in data["bodies"]:
        joint = body["joint"]
        joint |= {"damping": 0.0, "stiffness": 3e3} if joint["passive"] else {"joint_damping": 0.0}
    tree = tree_from_dict(data)
    assert len({body.joint.kind for body in tree.bodies}) == 2
    made = scenario(
        tree, posture=(0.3, -0.4, 0.5), feedback="none", integrator=method, gravity=True, gravity_compensation=False,
        offset=(0.2, -0.2, 0.2), duration=1.5, rate=250.0, substeps=4,
    )  # fmt: skip
    trajectory = run(made)
    plant = build_plant(tree)
    kinetic = [
        v @ plant.mass(q, np.zeros(3), plant.parameter_values).full() @ v / 2
        for q, v in zip(trajectory.q[::10], trajectory.v[::10], strict=True)
    ]
    assert np.ptp(trajectory.q, axis=0).max() > 1.0
    assert np.abs(trajectory.energy - trajectory.energy[0]).max() < 1e-9 * max(kinetic)


@pytest.mark.long("rows0-inverse")
@pytest.mark.parametrize(
    ("rows", "control"),
    [
        (("x", "y", "z"), "inverse"),
        (("x", "y", "z"), "transpose"),
        (("x", "y", "z", "yaw"), "damped:0.3"),
        (("x", "y", "z", "yaw"), "inverse"),
        (("z",), "inverse"),
        (("z",), "damped:0.3"),
    ],
)
def test_multipliers_are_those_of_the_held_linear_plant(rows, control):
    data = grounded(4, 3) | {}
    data["end_point"] |= {"rows": rows}
    tree = tree_from_dict(data)
    loop = flexopt.sampled_loop(tree, ARM, control=control, kp=2e4, kv=1e4, rate=300.0, integrator="dop853")
    # The test's own plant stands at base 0, as the loop does.
    expected = held(tree, ARM, control, 2e4, 1e4, 1 / 300, np.zeros(3))
    expected = without_self_motion(expected, 4 - len(rows))
    assert loop.multipliers.shape == expected.shape
    # The integrator's error, and eigenvalues that nearly repeat.
    assert apart(loop.multipliers, expected) < 1e-7


@pytest.mark.parametrize(
    ("damped", "control", "kp", "verdict"),
    [(True, "transpose", 1.8e5, "converges"), (False, "transpose", 1e4, "grows"), (False, "inverse", 3e5, "grows")],
)
def test_growth_rates_are_the_linear_loops(damped, control, kp, verdict):
    """Small motions: the fitted growth rate against the largest multiplier."""
    machine = TRACKS if damped else tree_from_dict(grounded(4, 3, coupled=False))
    options = {"posture": ARM, "kp": kp, "kv": kp / 4, "nullspace_damping": 2e3, "control": control}
    linear = flexopt.sampled_loop(machine, **options)
    trajectory = run(scenario(machine, **options, offset=(1e-6, -1e-6, 1e-6, -1e-6), duration=4.0))
    assert linear.stable == (verdict == "converges")
    assert trajectory.verdict == verdict
    # A fit to maxima over periods, of a mode that is not alone.
    assert trajectory.growth_rate == pytest.approx(linear.growth_rate, rel=0.05)


def test_a_border_of_a_machine_in_space(monkeypatch):
    from flexopt.loop import borders  # noqa: PLC0415

    monkeypatch.setattr(borders, "POINTS", 24)
    options = {"posture": ARM, "control": "transpose", "nullspace_damping": 2e3}
    largest = flexopt.stability_border(TRACKS, ratio=0.25, **options).largest
    assert largest is not None
    for factor, stable in ((1 - 1e-6, True), (1 + 1e-6, False)):
        kp = largest * factor
        assert flexopt.sampled_loop(TRACKS, kp=kp, kv=0.25 * kp, **options).stable == stable


def turned(yaw, points):
    c, s = math.cos(yaw), math.sin(yaw)
    return np.stack([c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1]], axis=1)


def test_a_placement_moves_the_whole_run():
    """At (x, y, yaw) everything happens as at the origin, turned and displaced."""
    options = {"posture": ARM, "duration": 0.5, "gravity": True} | GAINS
    here, there = (run(scenario(TRACKS, base=base, **options)) for base in (np.zeros(3), BASE))
    assert np.abs(here.v).max() > 0.1
    for name in ("q", "v", "torque", "deflection", "energy"):
        a, b = getattr(here, name), getattr(there, name)
        assert np.abs(a - b).max() <= AGREE * max(1.0, np.abs(a).max()), name
    np.testing.assert_allclose(there.end_point[:, :2], turned(BASE[2], here.end_point) + BASE[:2], atol=AGREE)
    np.testing.assert_allclose(there.end_point[:, 2], here.end_point[:, 2], atol=AGREE)
    np.testing.assert_allclose(there.error[:, :2], turned(BASE[2], here.error), atol=AGREE)


TIMES = (0.1, 0.3, 0.6)
DRIVE = np.array([[0.0, 0.0], [0.2, 0.1], [0.15, -0.1]])


@pytest.mark.long
@pytest.mark.parametrize("hold", [True, False])
def test_a_base_driven_in_x_and_y(hold):
    """The same machine placed by x alone, by x and y, and turned: one motion, counted from the ground or the anchor."""
    options = {"posture": ARM, "duration": 1.0, "gravity": True, "hold": hold} | GAINS
    plain = tree_from_dict(on_tracks(placement=("x", "y")))
    path = {"times": TIMES, "points": DRIVE + BASE[:2]}
    inertial = run(scenario(plain, base=BASE[:2], base_path=path, **options))

    ways = np.concatenate([turned(BASE[2], DRIVE) + BASE[:2], np.full((3, 1), BASE[2])], axis=1)
    follows = run(scenario(TRACKS, base=BASE, base_path={"times": TIMES, "points": ways}, **options))
    driven = np.stack([np.interp(inertial.time, TIMES, column) for column in DRIVE.T], axis=1)
    assert np.abs(driven).max() == pytest.approx(0.2)
    np.testing.assert_allclose(follows.q[:, :2], inertial.q[:, :2] - BASE[:2] - driven, atol=AGREE)
    np.testing.assert_allclose(follows.q[:, 2:], inertial.q[:, 2:], atol=AGREE)
    np.testing.assert_allclose(follows.deflection, inertial.deflection, atol=AGREE)
    np.testing.assert_allclose(follows.torque, inertial.torque, atol=1e3 * AGREE)
    np.testing.assert_allclose(follows.end_point[:, :2] - BASE[:2], turned(BASE[2], inertial.end_point - np.append(BASE[:2], 0.0)), atol=AGREE)  # fmt: skip
    np.testing.assert_allclose(follows.base[:, :2] - BASE[:2], turned(BASE[2], driven), atol=1e-14)
    # q and base are what the plant takes: they give the end-point, and dq/dt is v.
    plant = build_plant(TRACKS)
    for k in (0, 47, 120, 200):
        point = plant.end_point(follows.q[k], follows.base[k], plant.parameter_values).full().ravel()
        np.testing.assert_allclose(point, follows.end_point[k], atol=1e-12)
    rate = (follows.q[46, :2] - follows.q[44, :2]) / (2 * 0.005)
    np.testing.assert_allclose(rate, follows.v[45, :2], atol=2e-2)
    assert np.abs(np.diff(driven, axis=0)).max() / 0.005 > 0.5

    if not hold:
        return
    only_x = tree_from_dict(on_tracks(placement=("x",)))
    along = {"times": TIMES, "points": (DRIVE + BASE[:2])[:, :1]}
    both = {"times": TIMES, "points": DRIVE * [1, 0] + [BASE[0], 0.0]}
    alone = run(scenario(only_x, base=BASE[0], base_path=along, **options))
    together = run(scenario(plain, base=(BASE[0], 0.0), base_path=both, **options))
    np.testing.assert_allclose(alone.q, together.q, atol=AGREE)


def test_the_base_turns_by_the_largest_of_its_hinges():
    trajectory = run(scenario(TRACKS, posture=ARM, duration=0.5, **GAINS))
    hinges = trajectory.deflection[:-1, 3:6]
    assert trajectory.peak_base_rotation == pytest.approx(np.abs(hinges).max(), rel=1e-12)
    # Passive hinges beyond an actuated joint belong to the arm.
    data = grounded(4, 3, coupled=False)
    data["bodies"][-1]["joint"] |= {"passive": True, "stiffness": 1e4, "damping": 1e3, "rest": -0.6}
    arm = run(scenario(tree_from_dict(data), posture=ARM[:3], duration=0.5, **GAINS))
    assert np.abs(arm.deflection[:-1, 6]).max() > 2 * arm.peak_base_rotation
    assert arm.peak_base_rotation == pytest.approx(np.abs(arm.deflection[:-1, 3:6]).max(), rel=1e-12)
    for body in data["bodies"][:6]:
        body["joint"] |= {"kind": "slide", "axis": [0, 0, 1]} if body["name"] == "ground2" else {}
    slides = copy.deepcopy(data)
    slides["bodies"] = data["bodies"][:3] + data["bodies"][6:]
    slides["bodies"][2] |= {name: data["bodies"][5][name] for name in ("mass", "com", "inertia")}
    slides["bodies"][3] |= {"parent": "ground2"}
    stiff = scenario(tree_from_dict(slides), posture=ARM[:3], duration=0.2, rate=400.0, **GAINS)
    assert run(stiff).peak_base_rotation is None


def test_members_whose_parameters_vary():
    """A heavier payload: the machine has it, the controller does not know (its geometry is the same)."""
    options = {"posture": ARM, "duration": 0.3} | GAINS
    load, stiffness = np.array([0.0, 300.0]), np.array([4e7, 2e7])
    vary = {"payload.mass": load, "g2.stiffness": stiffness}
    ensemble = flexopt.simulate_ensemble(TRACKS, vary=vary, keep="trajectories", **options).dataset
    data = TRACKS.to_dict()
    data["payload"] = {"mass": 300.0}
    data["bodies"][2]["joint"]["stiffness"] = 2e7
    # Noise-free runs of the loop designed for each machine: with no weight their equilibria are the same.
    heavy = run(scenario(tree_from_dict(data), **options))
    light = run(scenario(TRACKS, **options))
    np.testing.assert_allclose(ensemble["q"].to_numpy()[0], light.q, atol=AGREE)
    np.testing.assert_allclose(ensemble["q"].to_numpy()[1], heavy.q, atol=AGREE)
    assert np.abs(heavy.q - light.q).max() > 1e-3


def test_a_controller_does_not_know_the_payload():
    """Under weight the arm sags by what the payload adds to the holding torque: Kp e = Jv⁻ᵀ Δg."""
    load = 200.0
    options = {"posture": ARM[:3], "gravity": True, "control": "transpose", "kp": 1e5, "kv": 3e4, "duration": 8.0}
    data = on_tracks(3)
    ensemble = flexopt.simulate_ensemble(
        tree_from_dict(data), vary={"payload.mass": np.array([load])}, keep="trajectories", offset=(0.0, 0.0, 0.0), **options
    ).dataset  # fmt: skip
    q, v = ensemble["q"].to_numpy()[0, -1], ensemble["v"].to_numpy()[0, -1]
    assert np.abs(v).max() < 1e-5
    heavy, known = build_plant(tree_from_dict(data | {"payload": {"mass": load}})), build_plant(tree_from_dict(data))
    made = scenario(tree_from_dict(data), **options)
    belief = np.concatenate([made.q_design[:6], q[6:]])
    weight = heavy.gravity(q, np.zeros(3), heavy.parameter_values).full().ravel()[6:]
    carried = known.gravity(belief, np.zeros(3), known.parameter_values).full().ravel()[6:]
    rigid = known.rigid_jacobian(belief, np.zeros(3), known.parameter_values).full()
    error = ensemble["error"].to_numpy()[0, -1]
    np.testing.assert_allclose(rigid.T @ (1e5 * error), weight - carried, rtol=1e-4, atol=1e-4 * np.abs(weight).max())
    assert np.abs(error).max() > 5e-3


@pytest.mark.parametrize("gravity", [False, True])
def test_the_machines_own_step_against_an_ode_solver(gravity):
    tree = tree_from_dict(random_tree(6, counts=(3, 3)))
    plant, n, m, base = build_plant(tree), 6, 3, BASE
    p, rng = plant.parameter_values, np.random.default_rng(0)
    torque = rng.uniform(-1, 1, n - m)
    rest = plant.rest(base, np.zeros(n - m), p).full().ravel()
    stiffness, damping = plant.stiffness(p).full(), plant.damping(p).full()

    def rate(_, x):
        q, v = x[:n], x[n:]
        force = -plant.bias(q, v, base, p).full().ravel() - stiffness @ (q - rest) - damping @ v
        force -= gravity * plant.gravity(q, base, p).full().ravel()
        force[m:] += torque
        force[m:] += (stiffness @ (q - rest))[m:]
        return np.concatenate([v, np.linalg.solve(plant.mass(q, base, p).full(), force)])

    start = np.concatenate([rest + rng.uniform(-0.05, 0.05, n), rng.uniform(-0.2, 0.2, n)])
    exact = solve_ivp(rate, (0.0, 0.1), start, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    step, misses = machine_step(tree, gravity=gravity), []
    for steps in (16, 32):
        q, v = start[:n], start[n:]
        for _ in range(steps):
            q, v = (x.full().ravel() for x in step.call([q, v, torque, base, p, 0.1 / steps]))
        misses.append(np.abs(np.concatenate([q, v]) - exact).max())
    # Fourth order, down to rounding.
    assert misses[0] < 1e-4
    assert misses[1] < max(misses[0] / 12, 1e-11)


def test_steps_with_the_loops_torques_are_the_loop():
    made = run(scenario(TRACKS, posture=ARM, base=BASE, duration=0.2, gravity=True, **GAINS))
    step, p = machine_step(TRACKS, gravity=True), build_plant(TRACKS).parameter_values
    q, v = made.q[0], made.v[0]
    for torque in made.torque[:-1]:
        q, v = (x.full().ravel() for x in step.call([q, v, torque, BASE, p, 0.005]))
    np.testing.assert_allclose(q, made.q[-1], atol=1e-11)
    np.testing.assert_allclose(v, made.v[-1], atol=1e-10)


@pytest.mark.parametrize("machine", [EXCAVATOR, TRACKS, tree_from_dict(random_tree(3))], ids=lambda m: m.name)
def test_a_structure_knows_its_constants(machine):
    for structure in (structure_of(machine), full_structure(machine)):
        motion = motion_of(structure, {})
        assert sorted(structure.constants) == sorted(constant_names(machine))
        assert set(motion.known_names) <= set(structure.constants)
        assert structure.zeros <= set(structure.constants)


def test_machines_of_one_structure_share_a_loop():
    heavier = TRACKS.to_dict() | {"payload": {"mass": 10.0}}
    loaded = tree_from_dict(heavier | {"payload": {"mass": 20.0}})
    assert scenario(tree_from_dict(heavier), posture=ARM).loop is scenario(loaded, posture=ARM).loop


# Options, then what the sentence must hold.
FAULTS = {
    "posture": ({"posture": [0.1, 0.2]}, ["posture = [0.1, 0.2]", "needs 4 angles in rad", "a0, a1, a2, a3", "not 2"]),
    "offset": ({"offset": [0.1] * 3}, ["offset = [0.1, 0.1, 0.1]", "needs 4 angles in rad", "a0, a1, a2, a3"]),
    "offset huge": ({"offset": [0.1, 50.0, 0.0, 0.0]}, ["offset (a1) = 50", "between -12.5664 and 12.5664 rad"]),
    "gains": ({"kp": [1.0, 2.0]}, ["kp = [1.0, 2.0]", "one for each of the 3 task axes"]),
    "base": ({"base": 1.0}, ["base = [1.0]", "3 numbers", "x, in m", "yaw, in rad"]),
    "yaw": ({"base": [0.0, 0.0, 100.0]}, ["base", "yaw must lie between", "rad"]),
    "target": ({"target_path": {"times": [0], "points": [[1.0, 2.0]]}}, ["target_path.points", "3 coordinates", "x, y, z"]),
    "path": ({"base_path": {"times": [0], "points": [[1.0]]}}, ["base_path.points", "3 coordinates", "x, y, yaw"]),
    "limits": ({"actuator": {"torque_limit": [1.0, 2.0]}}, ["actuator.torque_limit", "a0, a1, a2, a3"]),
    "end-point": ({"posture": None, "end_point": [1.0, 2.0, 1.0]}, ["end_point", "4 actuated joints", "give the posture"]),
    "end-point of two": ({"posture": None, "end_point": [1.0, 2.0]}, ["end_point = [1.0, 2.0]", "3 numbers x, y, z in m"]),
}  # fmt: skip


def refused(machine, **options) -> str:
    with pytest.raises(InputError) as caught:
        flexopt.simulate(machine, **({"posture": ARM, "duration": 0.1} | options))
    message = str(caught.value)
    assert "casadi" not in message.lower()
    return message


@pytest.mark.parametrize("name", list(FAULTS))
def test_one_fault(name):
    options, words = FAULTS[name]
    message = refused(TRACKS, **options)
    assert message.startswith("simulate")
    for word in words:
        assert word in message, message


def test_every_fault_at_once():
    path = {"times": [0, 0], "points": [[0, 0, 0], [1, 0, 1]]}
    message = refused(TRACKS, posture=[0.0] * 3, offset=[1.0], kv=[1.0, 1.0], base_path=path)
    for word in ("posture", "offset", "kv", "base_path.times"):
        assert word in message


def test_units_of_slides_and_bases_that_do_not_give():
    data = random_tree(3, counts=(1, 3))
    data["bodies"][0]["joint"] |= {"kind": "hinge"}
    for body in data["bodies"]:
        body["joint"] |= {} if body["joint"]["passive"] else {"kind": "slide", "limits": [-0.5, 0.5]}
    tree = tree_from_dict(data)
    message = refused(tree, posture=[0.1, 0.9, 0.0])
    assert "must lie between -0.5 and 0.5 m" in message
    message = refused(tree, posture=[0.1, 0.1])
    assert "needs 3 numbers, one for each actuated joint" in message
    path = {"times": [0, 1], "points": [[0, 0, 0], [1, 0, 0]]}
    message = refused(tree, posture=[0.1, 0.1, 0.0], base_path=path)
    assert "needs a base that gives in x; a rigid one would jerk the machine along" in message


def test_ensembles_refuse_what_a_machine_file_would():
    for name, value, word in (
        ("g0.stiffness", 0.0, "greater than 0 N/m"),
        ("chassis.inertia.xx", -1.0, "must not be negative (kg m²)"),
        ("arm1.mass", -1.0, "greater than 0 kg"),
        ("payload.mass", -1.0, "must not be negative (kg)"),
        ("kp", [[1.0, 2.0]], "(members, 3)"),
        ("offset", [[1.0, 2.0]], "(members, 4)"),
    ):
        with pytest.raises(InputError) as caught:
            flexopt.simulate_ensemble(TRACKS, ARM, vary={name: np.array([value]).reshape(-1, *np.shape(value)[1:])})
        assert word in str(caught.value), str(caught.value)
    coupled = tree_from_dict(grounded(4, 3))
    low = {"stiffness.g0.g1": np.array([-1e5]), "chassis.inertia.xy": np.array([-3.0])}
    assert flexopt.simulate_ensemble(coupled, ARM, vary=low, duration=0.01).n_members == 1


def test_weight_without_compensation_is_no_equilibrium():
    with pytest.raises(InputError, match="no equilibrium"):
        flexopt.sampled_loop(TRACKS, ARM, gravity=True, gravity_compensation=False)
    # Without self-motion: that of a redundant arm, which nothing holds, falls.
    options = {"control": "transpose", "kp": 3e4, "kv": 1e4}
    assert flexopt.sampled_loop(tree_from_dict(on_tracks(3)), ARM[:3], gravity=True, **options).stable


def test_files_name_rows_and_units(tmp_path):
    data = grounded(4, 3, coupled=False)
    data["end_point"] |= {"rows": ["x", "z", "yaw"]}
    data["bodies"][-1]["joint"] |= {"kind": "slide", "axis": [1.0, 0.0, 0.0]}
    made = run(scenario(tree_from_dict(data), posture=ARM, duration=0.05, gravity=True, nullspace_damping=1e3))
    made.to_csv(tmp_path / "r.csv")
    header = (tmp_path / "r.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert {"end_point_yaw_m", "error_z_m", "torque_a2_Nm", "torque_a3_N"} <= set(header)
    assert header[-1] == "energy_J"
    made.to_netcdf(tmp_path / "r.nc")
    assert list(made.dataset["axis"].to_numpy()) == ["x", "z", "yaw"]
    assert list(made.dataset["placement"].to_numpy()) == ["x", "y", "yaw"]
    assert made.dataset["torque"].attrs["units"] == "N m or N"
    assert made.skeleton.shape == (len(made.time), 12, 3)
    np.testing.assert_allclose(made.skeleton[:, -1, [0, 2]], made.end_point[:, :2], atol=1e-12)


def test_design_of_a_hanging_machine():
    """Under its weight with compensation the design posture is an equilibrium, coupled springs included."""
    tree = tree_from_dict(grounded(4, 3))
    made = scenario(tree, posture=ARM, gravity=True, base=BASE, offset=(0.0,) * 4, duration=0.2, **GAINS)
    still = run(made)
    assert np.abs(made.q_design[:6]).max() > 1e-4
    assert np.abs(still.v).max() < 1e-9
    assert np.abs(still.error).max() < 1e-11
    assert np.abs(still.deflection).max() < 1e-11
