"""Chains of parallel hinges in space as files may have them: any vertical plane, sense, zero pose, rest and offset.

What is chosen by structure, the motion in absolute angles and reaching in closed form, against the plant's recursions,
which Pinocchio and MuJoCo check on such chains too.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from flexopt import build_plant, evaluate, inverse_kinematics
from flexopt.model.tree import tree_from_dict
from flexopt.plant.machine_motion import constant_values, motion_of, structure_of
from tests.oracles.machines import NumpySource, Structure, draw_machine
from tests.oracles.spatial import in_space, pinocchio_tree

# x and z become the plane's axes.
PLANES = {"xz": np.eye(3), "yz": Rotation.from_euler("z", 90, degrees=True).as_matrix()}
STRUCTURES = [Structure(2, (), ()), Structure(3, (), (1,)), Structure(4, (), (0,))]


def odd_chain(seed: int, structure: Structure, plane: str) -> dict:
    """A planar machine in space whose joints turn either way, bodies tilted, slides reversed, everything offset."""
    rng = np.random.default_rng(seed)
    drawn = draw_machine(NumpySource(rng), Structure(structure[0], ("x", "y", "rotation"), structure[2]))
    data, turn = in_space(drawn), PLANES[plane]
    for number, body in enumerate(data["bodies"]):
        joint, tilt = body["joint"], Rotation.from_euler("y", rng.uniform(-2.0, 2.0)).as_matrix()
        if number < 2:
            tilt, joint["rest"] = np.eye(3), rng.uniform(-0.1, 0.1)
        at = np.add(body.get("position", [0.0, 0.0, 0.0]), [0.0, *rng.uniform(-0.3, 0.3, 2)])
        body["position"] = (turn @ at).tolist()
        body["rotation"] = (turn @ tilt @ turn.T).tolist()
        joint["axis"] = (turn @ joint["axis"] * rng.choice([-1.0, 1.0])).tolist()
        if "com" in body:
            body["com"] = (turn @ np.add(body["com"], [0.0, 0.2, 0.0])).tolist()
            tensor = turn @ np.diag(body["inertia"][:3]) @ turn.T
            body["inertia"] = [*np.diag(tensor).tolist(), tensor[0, 1], tensor[0, 2], tensor[1, 2]]
    tip = np.add(data["end_point"]["position"], [0.0, 0.4, 0.2])
    data["end_point"] |= {"position": (turn @ tip).tolist(), "rows": list(plane)}
    return data | {"placement": [plane[0]]}


def close(actual, expected, scale=1.0, relative=1e-11):
    actual, expected = np.asarray(actual, float), np.asarray(expected, float)
    assert actual.shape == expected.shape
    assert np.linalg.norm(actual - expected) <= relative * max(scale, float(np.linalg.norm(expected)))


def numbers(graph):
    return ca.evalf(graph).full().ravel()


CASES = [(seed, structure, plane) for seed in range(2) for structure in STRUCTURES for plane in PLANES]


@pytest.mark.parametrize(("seed", "structure", "plane"), CASES, ids=str)
def test_motion_in_absolute_angles(seed, structure, plane):
    data = odd_chain(seed, structure, plane)
    machine = tree_from_dict(data)
    plant, rng = build_plant(machine), np.random.default_rng(seed)
    p, m, n = plant.parameter_values, plant.n_passive, plant.n_coordinates
    q, v, base, tau = rng.uniform(-2, 2, n), rng.uniform(-2, 2, n), rng.uniform(-1, 1, 1), rng.uniform(-50, 50, n - m)
    mass, weight = plant.mass(q, base, p).full(), plant.gravity(q, base, p).full().ravel()
    heavy = np.linalg.norm(mass)
    oracle = pinocchio_tree(data)
    close(mass, oracle.mass(q))
    close(weight + plant.bias(q, v, base, p).full().ravel(), oracle.nonlinear_effects(q, v), heavy * (v @ v))

    values = {name: ca.SX(value) for name, value in constant_values(machine).items()}
    motion = motion_of(structure_of(machine), values)
    assert motion.structure.chain
    to_q = motion.to_q.full()
    u, w = np.linalg.solve(to_q, q - numbers(motion.offset)), np.linalg.solve(to_q, v)
    along = motion.with_base([(ca.SX(np.cos(a)), ca.SX(np.sin(a))) for a in u[motion.n_translations :]])
    at, rates, anchor = ca.SX(u), ca.SX(w), ca.SX(base)
    rest = plant.rest(base, q[m:], p).full().ravel()
    stretch, still = q - rest, ca.SX(np.zeros(1))
    stiffness, damping = plant.stiffness(p).full(), plant.damping(p).full()
    springs, full_tau = stiffness @ stretch + damping @ v, np.concatenate([np.zeros(m), tau])
    jacobian = plant.jacobian(q, base, p).full()
    close(numbers(motion.end_point(at, along, anchor)), plant.end_point(q, base, p).full().ravel())
    close(numbers(motion.end_point_rate(at, rates, along, anchor)), jacobian @ v, 10.0)
    close(ca.evalf(motion.rigid_jacobian(at, along, anchor)).full(), jacobian[:, m:])
    close(numbers(motion.holding_torque(at, along)), weight[m:], heavy)
    close(numbers(motion.passive(at, anchor)) - plant.rest(0.0, q[m:], p).full().ravel()[:m], stretch[:m])
    close(numbers(motion.spring_energy(at, anchor)), [0.5 * stretch @ stiffness @ stretch])
    momentum = numbers(motion.momentum(at, rates, along))
    close(momentum, to_q.T @ mass @ v, heavy)
    close(numbers(motion.rates_of_momentum(at, ca.SX(momentum), along)), w, 1e-3 * np.linalg.cond(mass))
    for gravity in (False, True):
        given = (at, rates, along, ca.SX(tau), anchor, still)
        forces = full_tau - springs - gravity * weight
        close(numbers(motion.force(*given, gravity=gravity)), to_q.T @ forces, np.linalg.norm(springs))
        acceleration = to_q @ numbers(motion.acceleration(*given, gravity=gravity))
        terms = mass @ acceleration + plant.bias(q, v, base, p).full().ravel() - forces
        close(terms, np.zeros(n), heavy * np.linalg.norm(acceleration))

    # A controller that measures what is there knows it as it is.
    deflected = numbers(motion.passive(at, anchor))
    pairs = [(ca.SX(np.cos(deflected[row])), ca.SX(np.sin(deflected[row]))) for row in motion.hinges]
    _, seen = motion.known(at, along, ca.SX(deflected), pairs, motion)
    close(
        np.array([numbers(part) for pair in seen for part in pair]), [numbers(part) for pair in along for part in pair]
    )


@pytest.mark.parametrize(("seed", "structure", "plane"), CASES, ids=str)
def test_reaching_in_closed_form(seed, structure, plane):
    machine = tree_from_dict(odd_chain(seed, structure, plane))
    plant, rng = build_plant(machine), np.random.default_rng(seed)
    p, base = plant.parameter_values, rng.uniform(-1, 1, 1)
    assert plant.closed_form
    posture = rng.uniform(-2, 2, plant.n_actuated)
    target = plant.end_point(plant.rest(base, posture, p), base, p).full().ravel()
    graph = plant.graph.at.skeleton
    way = [1 + i for i in graph.actuated_way]
    rows = ["xyz".index(row) for row in plane]
    signs = {"up": -1.0, "down": 1.0}
    for elbow, sign in signs.items():
        for found in inverse_kinematics(machine, target, base=base, elbow=elbow)[:6]:
            q = plant.rest(base, found, p)
            close(plant.end_point(q, base, p).full().ravel(), target, relative=1e-10)
            joints = plant.skeleton(q, base, p).full()[rows][:, [*way[-2:], -1]]
            (ax, az), (bx, bz) = np.diff(joints, axis=1).T
            assert sign * (ax * bz - az * bx) >= -1e-9
    # sin² of the angles between all pairs of segments, weighted by their lengths.
    q = plant.rest(base, posture, p)
    points = plant.skeleton(q, base, p).full()[rows][:, [*way, -1]]
    segments = np.diff(points, axis=1).T
    pairs = [(a, b) for i, a in enumerate(segments) for b in segments[i + 1 :]]
    crossed = sum((a[0] * b[1] - a[1] * b[0]) ** 2 for a, b in pairs) / sum((a @ a) * (b @ b) for a, b in pairs)
    close(plant.singularity_sine_squared(base, posture, p).full().ravel(), [crossed])
    assert np.all(np.isfinite(evaluate(machine, posture, base=base).w))
