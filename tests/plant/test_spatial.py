"""Trees in space: every graph against Pinocchio and MuJoCo, the plane against its closed form, what files get wrong."""

from __future__ import annotations

import copy
from dataclasses import replace

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import flexopt
from flexopt import build_plant
from flexopt.errors import ModelError
from flexopt.model import machine_from_dict
from flexopt.model.tree import tree_from_dict
from flexopt.plant.graph import build_graph
from flexopt.plant.machine_motion import constant_values, motion_of, structure_of
from flexopt.plant.orientation import rotation_vector
from flexopt.plant.plant import Plant
from flexopt.plant.singular_distance import sine_squared
from flexopt.plant.tree_structure import skeleton
from tests.oracles.machines import NumpySource, Structure, draw_machine
from tests.oracles.spatial import (
    grounded,
    in_space,
    mujoco_tree,
    pinocchio_tree,
    random_tree,
    without_mass,
)

RELATIVE = 1e-11
ROWS = ("x", "roll", "y", "pitch", "z", "yaw")


def close(actual, expected, scale=None, relative=RELATIVE):
    actual, expected = np.asarray(actual), np.asarray(expected)
    assert actual.shape == expected.shape
    size = np.linalg.norm(expected) if scale is None else scale
    assert np.linalg.norm(actual - expected) <= relative * size


def column(graph):
    return np.array(ca.DM(graph)).ravel()


class Case:
    """A tree, its plant, its motion and both oracles in one state."""

    def __init__(self, data, seed):
        self.data, self.tree = data, tree_from_dict(data)
        self.plant = Plant(self.tree, build_graph(self.tree))
        rng = np.random.default_rng(seed)
        n = len(self.tree.bodies)
        self.n, self.m = n, self.plant.n_passive
        self.q, self.v, self.base = rng.uniform(-3, 3, n), rng.uniform(-2, 2, n), rng.uniform(-1, 1, 3)
        self.tau = np.concatenate([np.zeros(self.m), rng.uniform(-50, 50, n - self.m)])
        self.p = self.plant.parameter_values
        self.pinocchio = pinocchio_tree(data)

    def of(self, name):
        function = getattr(self.plant, name)
        return function(self.q, self.base, self.p).full()

    @property
    def bias(self):
        return column(self.plant.bias(self.q, self.v, self.base, self.p))

    @property
    def springs(self):
        """K (q − q_rest) + D v, the arm standing where it should."""
        rest = column(self.plant.rest(self.base, self.q[self.m :], self.p))
        stiffness, damping = self.plant.stiffness(self.p).full(), self.plant.damping(self.p).full()
        return stiffness @ (self.q - rest) + damping @ self.v

    def motion(self, structure=None):
        values = {name: ca.SX(value) for name, value in constant_values(self.tree).items()}
        # Here u counts from where q does.
        motion = motion_of(structure or replace(structure_of(self.tree), local=False), values)
        to_u = np.linalg.inv(motion.to_q.full())
        u, w = to_u @ self.q, to_u @ self.v
        angles = u[motion.n_translations :]
        along = [(ca.SX(np.cos(a)), ca.SX(np.sin(a))) for a in angles]
        return motion, ca.SX(u), ca.SX(w), along

    def acceleration(self, motion, u, w, along, *, gravity=True, base_rate=None):
        base = self.base[: len(self.tree.placement)]
        rate = np.zeros(len(base)) if base_rate is None else base_rate
        result = motion.acceleration(u, w, along, ca.SX(self.tau[self.m :]), ca.SX(base), ca.SX(rate), gravity=gravity)
        return motion.to_q.full() @ column(ca.evalf(result))


@pytest.mark.parametrize("seed", range(50))
def test_random_tree_agrees_with_pinocchio_and_mujoco(seed):
    case = Case(random_tree(seed, rows=ROWS), seed)
    q, v, oracle = case.q, case.v, case.pinocchio
    r, jacobian, _ = oracle.task(q, case.base)
    effects = oracle.nonlinear_effects(q, v)
    close(case.of("mass"), oracle.mass(q))
    close(column(case.of("gravity")), oracle.gravity(q), np.linalg.norm(effects))
    close(case.bias + column(case.of("gravity")), effects)
    close(column(case.of("end_point")), r)
    close(case.of("jacobian"), jacobian)
    close(case.of("rigid_jacobian"), jacobian[:, case.m :], np.linalg.norm(jacobian))

    chain = mujoco_tree(case.data)
    chain.set(q, v)
    close(case.of("mass"), chain.mass())
    close(case.bias + column(case.of("gravity")), chain.nonlinear_effects())
    # Position rows in inertial axes, the anchor frame turned and moved.
    x, y, yaw = case.base
    turn = pin.rpy.rpyToMatrix(0.0, 0.0, yaw)
    every = [*turn @ chain.end_point() + [x, y, 0.0]]
    rows = [i for i, row in enumerate(case.tree.end_point.rows) if row in "xyz"]
    names = [case.tree.end_point.rows[i] for i in rows]
    close(column(case.of("end_point"))[rows], [every["xyz".index(name)] for name in names], 1 + np.linalg.norm(every))
    positions = turn @ chain.jacobian()[:3]
    close(case.of("jacobian")[rows], positions[["xyz".index(name) for name in names]], np.linalg.norm(positions))

    # Forward dynamics.
    expected = chain.forward(case.tau)
    # Rounding grows with cond M; both orders of factorisation and all constants kept.
    tolerance = RELATIVE * max(1.0, np.linalg.cond(case.of("mass")) / 1e3)
    close(oracle.forward(q, v, case.tau - case.springs), expected, relative=tolerance)
    for structure in (None, skeleton(case.tree.kinematic_tree)):
        close(case.acceleration(*case.motion(structure)), expected, relative=tolerance)
    motion, u, w, along = case.motion()
    weightless = case.acceleration(motion, u, w, along, gravity=False)
    weight, mass = column(case.of("gravity")), case.of("mass")
    scale = np.linalg.norm(weight) + np.linalg.norm(mass) * np.linalg.norm(expected)
    close(mass @ (weightless - expected), weight, scale)


def test_the_random_trees_have_rotors_on_every_kind_of_joint():
    found = {
        (body["joint"]["kind"], body["joint"]["passive"])
        for seed in range(50)
        for body in random_tree(seed)["bodies"]
        if "armature" in body["joint"]
    }
    assert found == {(kind, passive) for kind in ("hinge", "slide") for passive in (True, False)}


@pytest.mark.parametrize("directions", [(0, 1, 2), (2, 0, 1)], ids=["vertical last", "vertical first"])
def test_rotors_of_ground_slides_do_not_fall(directions):
    """Gravity is left to a vertical slide only where that has no rotor; each slide's reciprocal counts its own."""
    data = grounded(3, 2, coupled=False)
    for k, axis in enumerate(directions):
        data["bodies"][k]["joint"] |= {"axis": list(np.eye(3)[axis]), "armature": 700.0 * (k + 1)}
    data["bodies"][-1]["joint"]["armature"] = 90.0
    case = Case(data, 2)
    chain = mujoco_tree(data)
    chain.set(case.q, case.v)
    close(case.of("mass"), chain.mass())
    expected = chain.forward(case.tau)
    for structure in (None, skeleton(case.tree.kinematic_tree)):
        close(case.acceleration(*case.motion(structure)), expected)


def test_what_runs_on_a_slope_below_a_vertical_slide_has_its_weight():
    """Gravity is left to a vertical slide only where none of what it stands on falls otherwise."""
    data = grounded(3, 2, coupled=False)
    for k, axis in enumerate(([0.6, 0.0, 0.8], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0])):
        data["bodies"][k]["joint"]["axis"] = axis
    data["bodies"][0] |= {"mass": 800.0, "inertia": [90.0, 80.0, 70.0, 0.0, 0.0, 0.0]}
    case = Case(data, 2)
    chain = mujoco_tree(data)
    chain.set(case.q, case.v)
    close(case.acceleration(*case.motion()), chain.forward(case.tau))


def test_a_rotor_of_zero_leaves_graph_and_parameters_as_they_were():
    data = grounded(3, 2)
    tree = tree_from_dict(data)
    with_zeros = copy.deepcopy(data)
    for body in with_zeros["bodies"]:
        body["joint"]["armature"] = 0.0
    again = tree_from_dict(with_zeros)
    assert again == tree
    assert not any("armature" in parameter.name for parameter in tree.parameters)
    data["bodies"][-1]["joint"]["armature"] = 4.0
    geared = tree_from_dict(data)
    assert [p.unit for p in geared.parameters if p.name == "a2.armature"] == ["kg m²"]
    plain, turned = build_plant(tree), build_plant(geared)
    assert turned.mass.n_instructions() - plain.mass.n_instructions() in (1, 2)  # the sum, and its parameter
    q, base = np.linspace(-0.4, 1.1, 9), np.zeros(3)
    difference = turned.mass(q, base, turned.parameter_values) - plain.mass(q, base, plain.parameter_values)
    expected = np.zeros((9, 9))
    expected[-1, -1] = 4.0
    close(difference.full(), expected, relative=1e-9)  # beside entries of 1e4


@pytest.mark.parametrize("seed", range(12))
def test_motion_gives_the_plants_quantities(seed):
    case = Case(random_tree(seed, rows=ROWS), seed)
    motion, u, w, along = case.motion()
    to_q, base = motion.to_q.full(), ca.SX(case.base)
    mass, jacobian = case.of("mass"), case.of("jacobian")
    close(column(ca.evalf(motion.end_point(u, along, base))), column(case.of("end_point")))
    rate = jacobian @ case.v
    close(column(ca.evalf(motion.end_point_rate(u, w, along, base))), rate, np.linalg.norm(jacobian))
    close(ca.evalf(motion.rigid_jacobian(u, along, base)).full(), case.of("rigid_jacobian"), np.linalg.norm(jacobian))
    weight = column(case.of("gravity"))
    close(column(ca.evalf(motion.holding_torque(u, along))), weight[case.m :], 1 + np.linalg.norm(weight))
    momentum = column(ca.evalf(motion.momentum(u, w, along)))
    close(to_q @ momentum, mass @ case.v)
    back = column(ca.evalf(motion.rates_of_momentum(u, ca.SX(momentum), along)))
    close(to_q @ back, case.v, relative=1e-12 * np.linalg.cond(mass))
    close(column(ca.evalf(motion.kinetic_energy(u, w, along))), [0.5 * case.v @ mass @ case.v])
    stretch = case.q - column(case.plant.rest(case.base, case.q[case.m :], case.p))
    energy = 0.5 * stretch @ case.plant.stiffness(case.p).full() @ stretch
    close(column(ca.evalf(motion.spring_energy(u, base))), [energy])
    nothing = ca.SX(np.zeros(3))
    for gravity in (False, True):
        force = motion.force(u, w, along, ca.SX(case.tau[case.m :]), base, nothing, gravity=gravity)
        close(to_q @ column(ca.evalf(force)), case.tau - case.springs - gravity * weight, 1e3 + np.linalg.norm(weight))


def test_potential_has_the_weight_as_its_gradient():
    case = Case(random_tree(8), 8)
    q = ca.SX.sym("q", case.n)
    motion = case.motion()[0]
    u = ca.SX(np.linalg.inv(motion.to_q.full())) @ q
    along = [(ca.cos(a), ca.sin(a)) for a in ca.vertsplit(motion.angles(u))]
    gradient = ca.Function("gradient", [q], [ca.gradient(motion.potential(u, along), q)])
    close(column(gradient(case.q)), column(case.of("gravity")))


PLANAR = [
    Structure(2, ("x", "y", "rotation"), ()),
    Structure(4, ("x", "y", "rotation"), (1,)),
    Structure(3, ("x", "y", "rotation"), ()),
]


@pytest.mark.parametrize("structure", PLANAR, ids=str)
@pytest.mark.parametrize("seed", range(4))
def test_planar_machine_gives_the_closed_forms_numbers(structure, seed):
    rng = np.random.default_rng(seed)
    machine = machine_from_dict(draw_machine(NumpySource(rng), structure))
    plane = build_plant(machine)
    case = Case(in_space(machine.model_dump(by_alias=True)), seed)
    p, q, v, base = plane.parameter_values, case.q, case.v, case.base[:1]
    case.base = base
    close(case.of("mass"), plane.mass(q, base, p).full(), relative=1e-12)
    # Sums of terms that may cancel: rounding is relative to the terms.
    heavy = float(np.linalg.norm(plane.mass(q, base, p).full()))
    close(case.bias, column(plane.bias(q, v, base, p)), heavy * (v @ v), 1e-12)
    close(column(case.of("gravity")), column(plane.gravity(q, base, p)), heavy * machine.gravity, 1e-12)
    close(column(case.of("end_point")), column(plane.end_point(q, base, p)), relative=1e-12)
    close(case.of("jacobian"), plane.jacobian(q, base, p).full(), relative=1e-12)
    posture = q[case.m :]
    close(
        case.plant.base_jacobian(base, posture, case.p).full(),
        plane.base_jacobian(base, posture, p).full(),
        relative=1e-12,
    )
    close(column(case.plant.rest(base, posture, case.p)), column(plane.rest(base, posture, p)), relative=1e-15)
    close(case.plant.stiffness(case.p).full(), plane.stiffness(p).full(), relative=0)
    close(case.plant.damping(case.p).full(), plane.damping(p).full(), relative=0)
    points = plane.skeleton(q, base, p).full()
    close(case.of("skeleton")[np.ix_([0, 2], range(3, points.shape[1] + 3))], points[:, :], relative=1e-12)
    for control in ("inverse", "transpose"):
        ours = case.plant.linearisation(control)(base, posture, case.p)
        theirs = plane.linearisation(control)(base, posture, p)
        for a, b in zip(ours, theirs, strict=True):
            close(a.full(), b.full(), relative=1e-10)  # M is solved with, and J inverted


def test_moving_anchor_pulls_on_the_slide_that_absorbs_it():
    machine = machine_from_dict(draw_machine(NumpySource(np.random.default_rng(1)), PLANAR[0]))
    case = Case(in_space(machine.model_dump(by_alias=True)), 1)
    case.base = case.base[:1]
    rate = np.array([0.7])
    motion, u, w, along = case.motion()
    accelerated = case.acceleration(motion, u, w, along, base_rate=rate) - case.acceleration(motion, u, w, along)
    damping = case.plant.damping(case.p).full()
    close(case.of("mass") @ accelerated, damping[:, 0] * rate, relative=1e-8)  # a small difference of large numbers


@pytest.mark.parametrize("coupled", [False, True])
def test_six_ground_coordinates_without_mass_between(coupled):
    case = Case(grounded(4, 3, coupled=coupled), 3)
    oracle, q, v = case.pinocchio, case.q * 0.3, case.v
    case.q = q
    close(case.of("mass"), oracle.mass(q))
    close(case.bias + column(case.of("gravity")), oracle.nonlinear_effects(q, v))
    stiffness, damping = case.plant.stiffness(case.p).full(), case.plant.damping(case.p).full()
    if coupled:
        for word, ours in (("stiffness_matrix", stiffness), ("damping_matrix", damping)):
            close(ours[:6, :6], np.array(case.data[word]["matrix"]), relative=1e-15)
            assert not ours[6:, :6].any()
    expected = oracle.forward(q, v, case.tau - case.springs)
    close(case.acceleration(*case.motion()), expected, relative=1e-11)
    if not coupled:
        chain = mujoco_tree(case.data)
        chain.set(q, v)
        close(chain.forward(case.tau), expected)
    motion, u, _, _ = case.motion()
    stretch = case.q - column(case.plant.rest(case.base, case.q[case.m :], case.p))
    close(column(ca.evalf(motion.spring_energy(u, ca.SX(case.base)))), [0.5 * stretch @ stiffness @ stretch])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_placement_moves_the_machine_whether_a_slide_absorbs_it_or_not(sign):
    data = grounded(4, 1)
    data["bodies"][0]["joint"]["axis"] = [sign, 0.0, 0.0]
    posture, base = np.array([0.4, 0.8, -1.2, -0.5]), np.array([1.5, -0.7, 0.6])
    seen = []
    for placement in (["x", "y"], ["x", "y", "yaw"]):
        case = Case(data | {"placement": placement}, 1)
        assert set(skeleton(case.tree.kinematic_tree).absorbed) == (set() if "yaw" in placement else {"x", "y"})
        here = base[: len(placement)]
        q = column(case.plant.rest(here, posture, case.p))
        r = column(case.plant.end_point(q, here, case.p))
        home = column(case.plant.end_point(column(case.plant.rest(0 * here, posture, case.p)), 0 * here, case.p))
        turn = pin.rpy.rpyToMatrix(0.0, 0.0, base[2] if "yaw" in placement else 0.0)
        close(r, turn @ home + [*base[:2], 0.0])
        drawn, unmoved = (
            case.plant.skeleton(case.plant.rest(at, posture, case.p), at, case.p).full() for at in (here, 0 * here)
        )
        close(drawn, turn @ unmoved + np.array([[*base[:2], 0.0]]).T)
        close(drawn[:, 0], [*base[:2], 0.0])
        jacobian = case.plant.base_jacobian(here, posture, case.p).full()
        close(jacobian[:, :2], np.eye(3)[:, :2])
        if "yaw" in placement:
            close(jacobian[:, 2], np.cross([0.0, 0.0, 1.0], r - [*base[:2], 0.0]))
        close(jacobian[:, len(placement) :], case.plant.rigid_jacobian(q, here, case.p).full())
        seen.append(home)
    close(seen[0], seen[1])


@pytest.mark.parametrize("seed", [4, 12, 18])
def test_massless_body_in_the_middle_of_a_tree(seed):
    data = random_tree(seed)
    end = data["end_point"]["body"]
    carriers = {body["parent"] for body in data["bodies"]}
    single = [b for b in data["bodies"] if b["name"] in carriers and b["name"] != end
              and sum(c["parent"] == b["name"] for c in data["bodies"]) == 1]  # fmt: skip
    without_mass(single[0])
    case = Case(data, seed)
    close(case.of("mass"), case.pinocchio.mass(case.q))
    close(case.bias + column(case.of("gravity")), case.pinocchio.nonlinear_effects(case.q, case.v))
    expected = case.pinocchio.forward(case.q, case.v, case.tau - case.springs)
    close(case.acceleration(*case.motion()), expected, relative=1e-11 * np.linalg.cond(case.of("mass")))


def test_parameters_are_symbols():
    first, second = Case(random_tree(10, rows=ROWS), 0), random_tree(10, rows=ROWS)
    rng = np.random.default_rng(5)
    for body in second["bodies"]:
        body["mass"] *= 1.7
        body["position"], body["com"] = list(rng.uniform(-1, 1, 3)), list(rng.uniform(-1, 1, 3))
        body["inertia"] = [2.5 * entry for entry in body["inertia"]]
    second |= {"gravity": 1.6, "payload": {"mass": 12.0}}
    other = Case(second, 0)
    assert first.plant.parameter_names == other.plant.parameter_names
    for name in ("mass", "gravity", "end_point", "jacobian"):
        ours = getattr(first.plant, name)(first.q, first.base, other.p).full()
        close(ours, other.of(name), relative=1e-13)


def test_parameters_left_out_as_zero_change_nothing_but_the_size():
    tree = tree_from_dict(grounded(4, 0))
    zeros = [parameter.name for parameter in tree.parameters if parameter.value == 0]
    whole, small = Plant(tree, build_graph(tree)), Plant(tree, build_graph(tree, zeros))
    q, v = np.linspace(-0.4, 1.1, 10), np.linspace(1, -1, 10)
    p, base = whole.parameter_values, np.zeros(3)
    close(small.mass(q, base, p).full(), whole.mass(q, base, p).full(), relative=1e-14)
    close(small.bias(q, v, base, p).full(), whole.bias(q, v, base, p).full(), relative=1e-13)
    assert small.mass.n_instructions() < 0.75 * whole.mass.n_instructions()


ANGLES = [0.0, 1e-12, 1e-6, 0.0999, 0.1001, 0.5, 1.5, 1.6, 3.0, 3.14]


@pytest.mark.parametrize("angle", ANGLES)
def test_rotation_vector_and_its_derivative(angle):
    axis = np.array([0.48, -0.6, 0.64])
    rotation = pin.exp3(angle * axis)
    w = ca.SX.sym("w", 3)
    cross = ca.vertcat(ca.horzcat(0, -w[2], w[1]), ca.horzcat(w[2], 0, -w[0]), ca.horzcat(-w[1], w[0], 0))
    # A small turn in the body's axes, to second order: R (1 + W + W²/2).
    moved = rotation_vector(ca.SX(rotation) @ (ca.SX.eye(3) + cross + cross @ cross / 2))
    f = ca.Function("f", [w], [moved, ca.jacobian(moved, w), ca.hessian(moved[0], w)[0]])
    value, jacobian, hessian = (np.array(out) for out in f(np.zeros(3)))
    # Near π the antisymmetric part, sin θ, loses digits.
    tolerance = 1e-13 / max(np.pi - angle, 0.0) if angle > 2 else 1e-13
    assert np.abs(value.ravel() - angle * axis).max() <= tolerance
    assert np.abs(jacobian - pin.Jlog3(rotation)).max() <= tolerance / max(np.pi - angle, 1e-3)
    assert np.isfinite(hessian).all()


def test_sine_squared_is_the_mean_of_the_angles_between_columns_and_vanishes_where_rank_is_lost():
    rng = np.random.default_rng(0)

    def of(columns):
        return float(sine_squared(ca.SX(columns), [ca.SX(x) for x in np.sum(columns**2, axis=0)]))

    for rows in (1, 2, 3, 6):
        columns = rng.normal(size=(rows, rows))
        # 1/l_i² over the distances from the span of the others, by the rows of the inverse.
        expected = np.sum(1 / np.sum(columns**2, axis=0)) / np.sum(np.linalg.inv(columns) ** 2)
        assert abs(of(columns) - expected) <= 1e-11
        assert abs(of(np.linalg.qr(columns)[0] * rng.uniform(0.5, 2.0, rows)) - 1) <= 1e-12
    for rows, n in ((1, 2), (2, 2), (2, 4), (3, 4), (6, 7)):
        columns = rng.normal(size=(rows, n))
        assert 0 < of(columns) <= 1 + 1e-12
        for lost in range(1, rows):
            columns[-lost] = 2 * columns[0]
            # Of two and more lost at once what is left is rounding, 1e-14, over its floor of 1e-9.
            assert abs(of(columns)) <= 1e-6


@pytest.mark.parametrize("seed", range(20))
def test_distance_from_singular_postures_is_at_most_one_and_zero_where_rank_is_lost(seed):
    case = Case(random_tree(seed, rows=("x", "y", "z")), seed)
    at = [case.base, case.q[case.m :], case.plant.parameter_values]
    value = float(case.plant.singularity_sine_squared.call(at)[0])
    rest = case.plant.rest.call(at)[0]
    smallest = np.linalg.svd(case.plant.rigid_jacobian.call([rest, at[0], at[2]])[0].full(), compute_uv=False)[-1]
    assert 0 <= value + 1e-12 <= 1 + 2e-12
    assert np.all(np.isfinite(case.plant.singularity_gradient.call(at)[0].full()))
    assert (value > 1e-12) == (smallest > 1e-6)


def test_skeleton_joins_the_tree():
    case = Case(random_tree(15), 15)
    points, joined = case.of("skeleton"), case.plant.graph.segments
    assert points.shape == (3, case.n + 2)
    assert [b for _, b in joined] == list(range(1, case.n + 2))
    close(points[:, -1], case.pinocchio.frame(case.q, case.base)[0])
    g = case.plant.graph
    rotation = ca.Function("rotation", [g.q, g.base, g.p], [g.end_rotation])(case.q, case.base, case.p).full()
    close(rotation, case.pinocchio.frame(case.q, case.base)[1])


def test_dependent_slides_are_refused():
    data = grounded(2, 0, coupled=False)
    joint = {"name": "again", "kind": "slide", "axis": [1.0, 0.0, 0.0], "passive": True, "stiffness": 1.0}
    data["bodies"].insert(0, {"name": "first", "parent": None, "joint": joint})
    data["bodies"][1]["parent"] = "first"
    data["end_point"]["rows"] = ["x", "z"]
    with pytest.raises(ModelError, match="mass matrix is singular"):
        build_plant(tree_from_dict(data))


def broken(change):
    data = copy.deepcopy(random_tree(5))
    change(data)
    return data


FAULTS = {
    "axis of no length": (lambda d: d["bodies"][0]["joint"].update(axis=[0, 0, 0]), "bodies[0] (b0).joint.axis"),
    "no rotation": (lambda d: d["bodies"][1].update(rotation=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]), "is no rotation"),
    "negative moment": (lambda d: d["bodies"][1].update(inertia=[1, 1, 1, 5, 0, 0]), "negative principal moment"),
    "negative mass": (lambda d: d["bodies"][1].update(mass=-1.0), "bodies[1] (b1).mass = -1.0"),
    "unknown parent": (lambda d: d["bodies"][3].update(parent="b9x"), "is no body's name"),
    "later parent": (lambda d: d["bodies"][0].update(parent="b3"), "comes later"),
    "joint's name twice": (lambda d: d["bodies"][1]["joint"].update(name="j0"), "taken by an earlier joint"),
    "unknown end-point": (lambda d: d["end_point"].update(body="tip"), "end_point.body = 'tip'"),
    "row twice": (lambda d: d["end_point"].update(rows=["x", "x"]), "is listed twice"),
    "no row": (lambda d: d["end_point"].update(rows=[]), "must not be empty"),
    "unknown row": (lambda d: d["end_point"].update(rows=["w"]), "end_point.rows[0]"),
    "unknown placement": (lambda d: d.update(placement=["z"]), "placement[0]"),
    "unknown key": (lambda d: d["bodies"][0].update(mas=1), "did you mean 'mass'"),
    "no body": (lambda d: d.update(bodies=[]), "at least one body is needed"),
    "kind": (lambda d: d["bodies"][0]["joint"].update(kind="ball"), "must be hinge or slide"),
    "text for a number": (lambda d: d["bodies"][0].update(position=["a", 0, 0]), "must be a number, not text"),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_fault_is_named(name):
    change, wanted = FAULTS[name]
    with pytest.raises(ModelError) as caught:
        tree_from_dict(broken(change))
    assert wanted in str(caught.value)


def test_faults_of_matrices_and_too_few_joints_come_together():
    data = grounded(2, 0)
    data["stiffness_matrix"]["matrix"][0][0] = -1.0
    data["damping_matrix"]["joints"][2] = "a0"
    data["bodies"][-1] |= {"mass": 0.0, "inertia": [0.0] * 6}
    with pytest.raises(ModelError) as caught:
        tree_from_dict(data)
    fields = {fault.field for fault in caught.value.faults}
    assert {"stiffness_matrix.matrix", "damping_matrix.joints", "bodies[7] (arm1).mass", "end_point.rows"} <= fields


@pytest.mark.parametrize("seed", [0, 5, 7])
def test_dictionary_round_trip_keeps_the_hash(seed):
    tree = tree_from_dict(random_tree(seed, rows=ROWS))
    again = tree_from_dict(tree.to_dict())
    assert again == tree
    assert again.content_hash == tree.content_hash
    assert hash(again) == hash(tree)


@pytest.mark.parametrize("rows", [["x", "z"], ["x", "y"]])
def test_a_gantry_of_slides_alone(rows) -> None:
    """No hinge turns the task's plane: two slides along its rows, on a base that gives along the first."""

    def slide(axis: str, **keys: object) -> dict[str, object]:
        return {"kind": "slide", "axis": [float(axis == row) for row in "xyz"], **keys}

    spring = {"name": "ground", "passive": True, "stiffness": 1e6, "damping": 10.0}
    bodies = [
        {"name": "rails", "joint": slide(rows[0], **spring), "mass": 500.0, "inertia": [10.0] * 3 + [0.0] * 3},
        {"name": "bridge", "parent": "rails", "joint": slide(rows[0], name="along"), "mass": 100.0,
         "inertia": [5.0] * 3 + [0.0] * 3},
        {"name": "hook", "parent": "bridge", "joint": slide(rows[1], name="across"), "mass": 20.0,
         "inertia": [1.0] * 3 + [0.0] * 3},
    ]  # fmt: skip
    end = {"body": "hook", "position": [0.1, 0.2, 0.3], "rows": rows}
    gantry = tree_from_dict({"name": "gantry", "bodies": bodies, "end_point": end, "placement": []})
    offset = [end["position"]["xyz".index(row)] for row in rows]
    plant = build_plant(gantry)
    q = plant.rest([], [0.4, -0.3], plant.parameter_values)
    reached = column(plant.end_point(q, [], plant.parameter_values))
    np.testing.assert_allclose(reached, [offset[0] + 0.4, offset[1] - 0.3], atol=1e-12)
    np.testing.assert_allclose(flexopt.inverse_kinematics(gantry, reached), [[0.4, -0.3]], atol=1e-9)
