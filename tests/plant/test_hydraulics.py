"""Cylinders against loop equations solved by SciPy, MuJoCo's tendons and virtual work; levers against their inverse."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import flexopt
from flexopt import InputError
from flexopt.model import AnyMachine, Tree, tree_from_dict
from flexopt.plant import Hydraulics, build_hydraulics
from tests.oracles.cylinders import DIGGER, Data, digger, digger_in_space, length_in_plane, length_in_space
from tests.oracles.machines import seeds
from tests.oracles.spatial import in_space, pin_quaternion, random_tree, rotation_of

LENGTHS = {"boom": 0.5, "stick": 2.0, "bucket": 1.1}  # of the bodies that carry the joints


def hydraulics() -> tuple[AnyMachine, Hydraulics, Any]:
    data = digger()
    machine = flexopt.machine_from_dict(data)
    found = build_hydraulics(machine)
    return machine, found, found.plant.parameter_values


def postures(machine: AnyMachine, count: int, seed: int = 0) -> np.ndarray:
    low, high = np.array(machine.limits).T
    return np.random.default_rng(seed).uniform(low, high, (count, len(low)))


def driven_tree(seed: int) -> Data:
    """A random tree with a cylinder of random pins on every actuated hinge, and one on every actuated slide."""
    rng, data = np.random.default_rng(seed), random_tree(seed)
    data["cylinders"] = []
    for body in data["bodies"]:
        joint = body["joint"]
        if joint["passive"]:
            continue
        cylinder = {"name": f"{joint['name']} cylinder", "joint": joint["name"], "speed": [1.0, 1.0]}
        if joint["kind"] == "slide":
            cylinder |= {"offset": 2.0, "length": [1.0, 3.0]}
        else:
            at = np.array(body["position"])
            cylinder |= {"base_point": list(at + rng.uniform(-1, 1, 3)), "rod_point": list(rng.uniform(-1, 1, 3))}
            cylinder["length"] = [1e-3, 100.0]
            middle = rng.uniform(-3, 3)
            joint["limits"] = [middle - 1e-2, middle + 1e-2]
        data["cylinders"].append(cylinder)
    return data


def with_rocker(seed: int) -> tuple[Data, Data, Tree]:
    """The first random hinge in space with a random four-bar linkage that closes: tree's data, hinge's body, tree."""
    rng = np.random.default_rng(seed)
    while True:
        data = random_tree(int(rng.integers(2**31)))
        hinges = [b for b in data["bodies"] if not b["joint"]["passive"] and b["joint"]["kind"] == "hinge"]
        if not hinges:
            continue
        body = hinges[0]
        at, middle = np.array(body["position"]), float(rng.uniform(-3, 3))
        rocker = {
            "pivot": list(at + rng.uniform(-0.5, 0.5, 3)), "length": float(rng.uniform(0.3, 1.0)),
            "coupler": float(rng.uniform(0.6, 1.4)), "coupler_point": list(rng.uniform(-0.5, 0.5, 3)),
            "branch": int(rng.choice([-1, 1])), "rod_offset": list(rng.uniform(-0.2, 0.2, 2)),
        }  # fmt: skip
        body["joint"]["limits"] = [middle - 0.05, middle + 0.05]
        cylinder = {"name": "c", "joint": body["joint"]["name"], "rocker": rocker}
        cylinder |= {"base_point": list(at + rng.uniform(-2, 2, 3)), "length": [1e-3, 100.0], "speed": [1.0, 1.0]}
        data["cylinders"] = [cylinder]
        try:
            return data, body, tree_from_dict(data)
        except flexopt.ModelError as error:
            assert [fault.field.split(".")[1] for fault in error.faults] in (["rocker"], ["joint"])  # noqa: PT017


def test_lengths_are_those_of_the_loop_equations() -> None:
    machine, found, p = hydraulics()
    for posture in postures(machine, 40):
        expected = [
            length_in_plane(cylinder, LENGTHS[cylinder["joint"]], q)
            for cylinder, q in zip(DIGGER["cylinders"], posture, strict=True)
        ]
        np.testing.assert_allclose(
            found.lengths(posture=posture, p=p)["L"].full().ravel(), expected, rtol=0, atol=2e-14
        )


@pytest.mark.parametrize("seed", range(12))
def test_linkages_in_space_close(seed: int) -> None:
    data, body, tree = with_rocker(seed)
    found = build_hydraulics(tree)
    joint = found.joints[0]
    for q in np.linspace(*tree.limits[joint], 5):
        posture = np.where(np.arange(len(tree.joints)) == joint, q, 0.3)
        length = float(found.lengths(posture, found.plant.parameter_values))
        # Near the ends of a linkage a rounding error is seen through a square root.
        assert length == pytest.approx(length_in_space(data["cylinders"][0], body, q), abs=1e-12)


def test_plane_and_space_agree() -> None:
    machine, found, p = hydraulics()
    tree = tree_from_dict(digger_in_space(in_space(digger())))
    twin = build_hydraulics(tree)
    np.testing.assert_allclose(tree.limits, machine.limits, rtol=0, atol=1e-14)
    assert tree.joints == machine.joints
    for posture in postures(machine, 10):
        for a, b in ((found.lengths, twin.lengths), (found.ratios, twin.ratios)):
            there = b(posture, twin.plant.parameter_values).full()
            np.testing.assert_allclose(a(posture, p).full(), there, rtol=0, atol=1e-14)


def tendons(data: Data) -> tuple[Any, Any]:
    """The tree in MuJoCo, with a tendon between the pins of every direct cylinder."""
    spec = mujoco.MjSpec()
    spec.compiler.degree, spec.compiler.balanceinertia = False, True
    made: dict[str | None, Any] = {None: spec.worldbody}
    for body in data["bodies"]:
        joint = body["joint"]
        own = made[body["parent"]].add_body(
            name=body["name"], pos=body["position"], quat=pin_quaternion(rotation_of(body))
        )
        own.explicitinertial, own.mass, own.inertia = True, 1.0, [1.0, 1.0, 1.0]
        kind = mujoco.mjtJoint.mjJNT_HINGE if joint["kind"] == "hinge" else mujoco.mjtJoint.mjJNT_SLIDE
        own.add_joint(name=joint["name"], type=kind, axis=joint["axis"])
        made[body["name"]] = own
        for cylinder in data["cylinders"]:
            if cylinder["joint"] == joint["name"] and "rod_point" in cylinder:
                name = cylinder["name"]
                made[body["parent"]].add_site(name=f"{name} base", pos=cylinder["base_point"])
                own.add_site(name=f"{name} rod", pos=cylinder["rod_point"])
                tendon = spec.add_tendon(name=name)
                tendon.wrap_site(f"{name} base")
                tendon.wrap_site(f"{name} rod")
    model = spec.compile()
    return model, mujoco.MjData(model)


@settings(max_examples=10)
@given(seeds)
def test_direct_cylinders_are_mujocos_tendons(seed: int) -> None:
    data = driven_tree(seed)
    try:
        tree = tree_from_dict(data)
    except flexopt.ModelError as error:
        assume("dead centre" not in str(error))
        raise
    found = build_hydraulics(tree)
    names, p = tree.joints, found.plant.parameter_values
    model, state = tendons(data)
    rng = np.random.default_rng(seed)
    limits = np.clip(np.array(tree.limits), -3, 3)
    posture, rates = rng.uniform(*limits.T), rng.normal(size=len(names))
    for name, q, rate in zip(names, posture, rates, strict=True):
        state.joint(name).qpos, state.joint(name).qvel = q, rate
    mujoco.mj_forward(model, state)
    lengths = found.lengths(posture, p).full().ravel()
    moved = found.ratios(posture, p).full() @ rates
    for cylinder, length, rate in zip(tree.cylinders, lengths, moved, strict=True):
        joint = names.index(cylinder.joint)
        if cylinder.rod_point is None:
            assert (length, rate) == (pytest.approx(2.0 + posture[joint], abs=1e-15), rates[joint])
        else:
            assert length == pytest.approx(float(state.tendon(cylinder.name).length[0]), abs=1e-13)
            # MuJoCo's tendon rates are those of points that are many rotations away from the ground.
            assert rate == pytest.approx(float(state.tendon(cylinder.name).velocity[0]), abs=1e-12 / length)


def test_forces_do_the_joints_work() -> None:
    """A constant force F along a path: F (L_1 − L_0) = ∫ τ dq, τ the torque that F makes; Gauss and Legendre, 40 points."""
    machine, found, p = hydraulics()
    nodes, weights = np.polynomial.legendre.leggauss(40)
    start, end = postures(machine, 2)
    force = np.array([3e4, -2e4, 1e4])
    work = np.zeros(3)
    for node, weight in zip(nodes, weights, strict=True):
        posture = start + (end - start) * (node + 1) / 2
        torque = np.diag(found.ratios(posture, p).full()) * force
        again = found.forces(posture=posture, torque=torque, p=p)["force"].full().ravel()
        np.testing.assert_allclose(again, force, rtol=1e-14)
        work += weight / 2 * torque * (end - start)
    moved = (found.lengths(end, p) - found.lengths(start, p)).full().ravel()
    np.testing.assert_allclose(work, force * moved, rtol=1e-11)


def test_held_weight_is_the_slope_of_potential_energy() -> None:
    """dV = F dL: the force that holds the arm, from the masses' heights alone."""
    machine = flexopt.machine_from_dict(digger())
    posture = np.array([0.1, -1.2, -0.5])
    evaluation = flexopt.evaluate(machine, posture)

    def potential(angles: np.ndarray) -> float:
        angle, height, total = 1.2, 0.5 * math.sin(1.2), 0.0
        for link, q in zip(DIGGER["links"], angles, strict=True):
            angle += q
            total += 9.81 * link["mass"] * (height + link["com"] * math.sin(angle))
            height += link["length"] * math.sin(angle)
        return total

    document = evaluation.to_dict()["cylinders"]
    assert [entry["name"] for entry in document] == [c["name"] for c in DIGGER["cylinders"]]
    for k, entry in enumerate(document):
        assert set(entry) == {"name", "joint", "length", "stroke", "ratio", "force"}
        cylinder, step = DIGGER["cylinders"][k], 1e-4 * np.eye(3)[k]
        lengths = [length_in_plane(cylinder, LENGTHS[entry["joint"]], (posture + s * step)[k]) for s in (-1, 0, 1)]
        assert entry["length"] == pytest.approx(lengths[1], abs=1e-14)
        assert entry["stroke"] == cylinder["length"]
        # Central differences of step 1e-4: their own error is of the order of 1e-8.
        assert entry["ratio"] == pytest.approx((lengths[2] - lengths[0]) / 2e-4, rel=1e-6)
        rise = potential(posture + step) - potential(posture - step)
        assert entry["force"] == pytest.approx(rise / (lengths[2] - lengths[0]), rel=1e-6)
    assert "cylinders" not in flexopt.evaluate(flexopt.load("excavator"), [0.9, -1.4]).to_dict()
    assert "stick cylinder" in repr(evaluation)


def test_limits_are_where_the_stroke_ends() -> None:
    data = digger()
    data["cylinders"][1]["length"] = [0.98, 1.3]
    machine = flexopt.machine_from_dict(data)
    low, high = machine.limits[1]
    assert -2.6 < low < high < -0.6
    assert machine.joint_limits[1] == (-2.6, -0.6)
    ends = [length_in_plane(data["cylinders"][1], 2.0, q) for q in (low, high)]
    np.testing.assert_allclose(ends, [1.3, 0.98], rtol=0, atol=1e-15 * 4)
    flexopt.evaluate(machine, [0.0, low, 0.0])
    with pytest.raises(InputError, match=r"posture \(stick\) = -2.3: must lie between .* stick cylinder would be 1.43"):
        flexopt.evaluate(machine, [0.0, -2.3, 0.0])
    with pytest.raises(InputError, match=r"its stroke is 0\.98 to 1.3 m"):
        flexopt.evaluate(machine, [0.0, -2.3, 0.0])


rates_drawn = st.lists(st.floats(-2, 2, allow_subnormal=False), min_size=3, max_size=3).map(np.array)


@given(seeds, rates_drawn)
def test_levers_and_rates_are_inverse(seed: int, rates: np.ndarray) -> None:
    machine, found, p = hydraulics()
    posture = postures(machine, 1, seed)[0]
    lever = found.lever(posture=posture, rates=rates, p=p)["lever"].full().ravel()
    again = found.rates(posture=posture, lever=lever, p=p)["rates"].full().ravel()
    moved = found.ratios(posture, p).full() @ rates
    signs = np.array([1.0, -1.0, 1.0])
    shares = np.where(moved < 0, moved / [0.2, 0.25, 0.3], moved / [0.15, 0.18, 0.2])
    dead = np.array([0.0, 0.1, 0.0])
    resting = (np.abs(shares) < 1e-9) & (dead > 0)
    # The dead band's 0.1 is added and taken away.
    np.testing.assert_allclose(again, np.where(resting, 0.0, rates), rtol=1e-14, atol=1e-15)
    dead[resting] = 0.0
    signs[resting] *= 0.9
    np.testing.assert_allclose(lever, signs * (np.sign(shares) * dead + (1 - dead) * shares), rtol=1e-14, atol=0)


@given(seeds, st.lists(st.floats(-1, 1), min_size=3, max_size=3).map(np.array))
def test_rates_and_levers_are_inverse_outside_the_dead_band(seed: int, lever: np.ndarray) -> None:
    machine, found, p = hydraulics()
    posture = postures(machine, 1, seed)[0]
    rates = found.rates(posture, lever, p)
    again = found.lever(posture, rates, p).full().ravel()
    idle = np.array([0.0, 0.1, 0.0])
    expected = np.where(np.abs(lever) <= idle, 0.0, lever)
    np.testing.assert_allclose(again, expected, rtol=1e-14, atol=1e-15)


@pytest.mark.long
@given(seeds, rates_drawn)
def test_uniform_saturation_keeps_the_end_points_direction(seed: int, rates: np.ndarray) -> None:
    machine, found, p = hydraulics()
    plant = found.plant
    posture = postures(machine, 1, seed)[0]
    free = found.lever(posture, rates, p).full().ravel()
    lever = found.lever_map("uniform")(posture, rates, p).full().ravel()
    got = found.rates(posture, lever, p).full().ravel()
    jv = plant.rigid_jacobian(plant.rest(0, posture, p), 0, p).full()
    wanted, moved = jv @ rates, jv @ got
    assert np.abs(lever).max() <= 1 + 1e-15
    if np.abs(free).max() <= 1:
        np.testing.assert_allclose(lever, free, rtol=1e-15, atol=0)
    else:
        assert np.abs(lever).max() == pytest.approx(1.0, abs=1e-15)
    # A share loses digits to the dead band's 0.1, and one below 1e-9 is rest: an absolute error beside the relative one.
    small = 1e-9 if 0 < np.abs(free[1]) < 0.1 else 1e-14
    size, rounding = np.linalg.norm(wanted), np.linalg.norm(jv) * (1e-14 * np.linalg.norm(rates) + small)
    assert abs(wanted[0] * moved[1] - wanted[1] * moved[0]) <= rounding * size
    assert wanted @ moved >= -rounding * size
    each = found.lever_map("each")(posture, rates, p).full().ravel()
    np.testing.assert_allclose(each, np.clip(free, -1, 1), rtol=1e-15, atol=0)


def test_efforts_follow_the_posture() -> None:
    data = digger()
    data["links"][2]["effort"] = 777.0
    machine = flexopt.machine_from_dict(data)
    found = build_hydraulics(machine)
    p = found.plant.parameter_values
    for posture in postures(machine, 5):
        arms = np.diag(found.ratios(posture, p).full())
        efforts = found.joint_efforts(posture=posture, p=p)["efforts"].full()
        assert arms[0] > 0 > arms[1]
        np.testing.assert_allclose(efforts[0], [-5e4 * arms[0], 9e4 * arms[0]], rtol=1e-15)
        np.testing.assert_allclose(efforts[1], [7e4 * arms[1], -4e4 * arms[1]], rtol=1e-15)
        np.testing.assert_array_equal(efforts[2], [-777.0, 777.0])
        # At full push the cylinder's force is its greatest.
        force = found.forces(posture, [efforts[0, 1], efforts[1, 0], 0.0], p).full().ravel()
        np.testing.assert_allclose(force[:2], [9e4, 7e4], rtol=1e-15)


def test_motors_take_the_joints_speeds() -> None:
    data = digger()
    del data["cylinders"][0]
    machine = flexopt.machine_from_dict(data)
    with pytest.raises(InputError, match="joint boom: has neither a cylinder nor a speed"):
        build_hydraulics(machine).lever  # noqa: B018
    data["links"][0]["speed"] = 0.4
    machine = flexopt.machine_from_dict(data)
    found = build_hydraulics(machine)
    p, posture = found.plant.parameter_values, [0.0, -1.0, 0.0]
    lever = found.lever(posture, [-0.1, 0.0, 0.0], p).full().ravel()
    np.testing.assert_array_equal(lever, [-0.25, 0.0, 0.0])
    np.testing.assert_allclose(found.rates(posture, [0.5, 0.0, 0.0], p).full().ravel(), [0.2, 0.0, 0.0], rtol=1e-15)
    assert found.lengths(posture, p).shape == (2, 1)
    assert found.ratios(posture, p).shape == (2, 3)


def test_pins_are_parameters() -> None:
    """∂L/∂pin of a direct cylinder is the unit vector along it."""
    machine, found, p = hydraulics()
    names = found.plant.parameter_names
    posture = np.array([0.2, -1.0, 0.1])
    turn = np.array([math.cos(0.2), math.sin(0.2)])
    rod = np.array([0.5 + 0.95 * turn[0] - 0.25 * turn[1], 0.95 * turn[1] + 0.25 * turn[0]])
    unit = (np.array([0.45, -0.35]) - rod) / np.linalg.norm(np.array([0.45, -0.35]) - rod)
    jacobian = found.lengths.jacobian()
    out = jacobian(posture, p, found.lengths(posture, p))[1].full()
    for axis, expected in zip("xy", unit, strict=True):
        column = names.index(f"boom cylinder.base_point.{axis}")
        assert out[0, column] == pytest.approx(expected, abs=1e-14)
    assert machine.parameters[names.index("bucket cylinder.rocker.coupler")] == (
        "bucket cylinder.rocker.coupler", 0.28, "m",
    )  # fmt: skip


def test_a_forgotten_input_shows() -> None:
    _, found, p = hydraulics()
    assert np.isnan(found.lever(posture=[0.0, -1.0, 0.0], p=p)["lever"].full()).all()


def test_the_shipped_excavators_drives_belong_together() -> None:
    """Strokes of the data sheet end beyond the limits; efforts are those of the cylinders at their best arm or below."""
    plane, space = flexopt.load("boom-stick-bucket"), flexopt.load("slewing-excavator")
    lengths = []
    for machine in (plane, space):
        assert machine.limits == machine.joint_limits
        assert [round(c.length[1] - c.length[0], 9) for c in machine.cylinders] == [1.26, 1.504, 1.104]
        found = build_hydraulics(machine)
        p, n = found.plant.parameter_values, len(machine.joints)
        low, high = np.array(machine.limits)[-3:].T
        arms = []
        for share in np.linspace(0, 1, 41):
            posture = np.concatenate([np.zeros(n - 3), low + share * (high - low)])
            arms.append(np.abs(found.ratios(posture, p).full()[:, -3:]).max(axis=1))
            lengths.append(found.lengths(posture, p).full().ravel())
        pushes = np.array([cylinder.force[1] for cylinder in machine.cylinders])
        best = np.max(arms, axis=0) * pushes / machine.efforts[-3:]
        assert np.all((best > 0.95) & (best < 1.2))
        # Full speed at the best arm is the joint's, whichever way is slower.
        speeds = np.array([min(cylinder.speed) for cylinder in machine.cylinders]) / np.max(arms, axis=0)
        assert np.all(np.abs(speeds / machine.speeds[-3:] - 1) < 0.15)
    # The planar boom counts from a base at 1.4631 rad, the one in space from the horizontal; pins are rounded to mm.
    half = len(lengths) // 2
    np.testing.assert_allclose(lengths[:half], lengths[half:], rtol=0, atol=2e-3)


@pytest.mark.long
def test_selected_postures_keep_the_strokes() -> None:
    data = digger()
    free = flexopt.machine_from_dict(data)
    data["cylinders"][0]["length"] = [1.1, 1.2]
    machine = flexopt.machine_from_dict(data)
    plant = flexopt.build_plant(machine)
    p, posture = plant.parameter_values, np.array([-0.1, -1.1, -0.3])
    point = plant.end_point(plant.rest(0.0, posture, p), 0.0, p).full().ravel()
    outside = 0
    for one in (machine, free):
        chosen = flexopt.select(one, point, base_range=[-1.0, 1.0], starts=4, seed=0)
        # A curve of optima is one candidate, which others stand beside.
        found = [z for c in chosen.candidates for z in (c.z, *c.representatives)]
        lengths = [float(build_hydraulics(machine).lengths(z[1:], p)[0]) for z in found]
        outside = sum(not 1.1 - 1e-7 <= length <= 1.2 + 1e-7 for length in lengths)
        assert lengths
        assert outside == 0 or one is free
    assert outside
