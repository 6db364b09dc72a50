"""The simulator's equations of motion against Plant's M, h, g, K, D, Lagrange's equations and MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings

from flexopt import build_plant, load
from flexopt.model import machine_from_dict
from flexopt.plant.chain_motion import ChainMotion
from flexopt.plant.machine_motion import constant_names, constant_values, constants, full_structure, structure_of
from tests.oracles.lagrange import lagrange
from tests.oracles.machines import NumpySource, Structure, draw_machine, machines, seeds
from tests.oracles.mujoco_chain import mujoco_chain

# As a share of the sum of the sizes of the terms: what a backward stable solution leaves.
RELATIVE = 1e-12
# Every way in which translations, the base's rotation and passive hinges inside the arm come together.
STRUCTURES = [
    Structure(2, ("x", "y", "rotation"), ()),
    Structure(2, ("x", "y"), ()),
    Structure(2, ("x",), ()),
    Structure(2, ("y",), ()),
    Structure(2, ("rotation",), ()),
    Structure(3, ("x", "rotation"), (0,)),
    Structure(3, ("y", "rotation"), (1,)),
    Structure(4, ("x", "y"), (0,)),
    Structure(4, ("x",), (0, 3)),
    Structure(4, (), (0, 2)),
    Structure(4, (), (1,)),
    Structure(5, ("x", "y", "rotation"), (1, 4)),
    Structure(5, ("x", "y", "rotation"), ()),
]


@dataclass
class Case:
    """Both descriptions of one machine in one state, `base` and its rate included."""

    data: dict
    machine: object
    rng: np.random.Generator

    def __post_init__(self):
        self.plant = build_plant(self.machine)
        self.p, m = self.plant.parameter_values, self.plant.n_passive
        n = self.plant.n_coordinates
        self.m, self.n = m, n
        rng = self.rng
        self.q, self.v = rng.uniform(-3, 3, n), rng.uniform(-2, 2, n)
        self.base, self.base_rate = float(rng.uniform(-2, 2)), float(rng.uniform(-1, 1))
        self.motion = self.motion_of(structure_of(self.machine))
        self.to_q = self.motion.to_q.full()
        self.u = np.linalg.solve(self.to_q, self.q - numbers(self.motion.offset))
        self.w = np.linalg.solve(self.to_q, self.v)
        self.along = self.directions(self.motion, self.u)
        self.mass = self.plant.mass(self.q, self.base, self.p).full()
        self.gravity = self.plant.gravity(self.q, self.base, self.p).full().ravel()
        self.bias = self.plant.bias(self.q, self.v, self.base, self.p).full().ravel()
        self.rest = self.plant.rest(self.base, np.zeros(n - m), self.p).full().ravel()
        self.rest[m:] = self.q[m:]
        self.spring = self.plant.stiffness(self.p).full() @ (self.q - self.rest)
        relative = self.v.copy()
        if "x" in self.machine.free_base_directions:
            relative[0] -= self.base_rate
        self.damper = self.plant.damping(self.p).full() @ relative
        size = float(np.abs(self.bias).max() + np.abs(self.gravity).max() + np.abs(self.spring).max())
        self.tau = rng.uniform(-1, 1, n - m) * size
        self.full_tau = np.concatenate([np.zeros(m), self.tau])

    def motion_of(self, structure):
        return ChainMotion(structure, {name: ca.SX(value) for name, value in constant_values(self.machine).items()})

    def directions(self, motion, u):
        angles = numbers(motion.angles(ca.SX(u)))
        return motion.with_base([(ca.SX(np.cos(a)), ca.SX(np.sin(a))) for a in angles])

    def acceleration(self, motion, gravity):
        return numbers(
            motion.acceleration(
                ca.SX(self.u), ca.SX(self.w), self.along, ca.SX(self.tau), ca.SX(self.base), ca.SX(self.base_rate),
                gravity=gravity,
            )
        )  # fmt: skip


def numbers(graph) -> np.ndarray:
    return ca.evalf(graph).full().ravel()


def case_of(structure, seed, **options) -> Case:
    rng = np.random.default_rng(seed)
    data = draw_machine(NumpySource(rng), structure, **options)
    return Case(data, machine_from_dict(data), rng)


def close(actual, expected, scale, relative=RELATIVE):
    actual, expected = np.asarray(actual), np.asarray(expected)
    assert actual.shape == expected.shape
    assert np.linalg.norm(actual - expected) <= relative * scale


def check_acceleration(case: Case, motion: ChainMotion) -> None:
    for gravity in (False, True):
        acceleration = case.to_q @ case.acceleration(motion, gravity)
        terms = [case.mass @ acceleration, case.bias, case.spring, case.damper, case.gravity * gravity, -case.full_tau]
        # M v̇ + h + g + K (q − q_rest) + D v = τ, in absolute angles, where each sum of rows is a row again.
        rows = [case.to_q.T @ term for term in terms]
        scale = np.abs(case.mass) @ np.abs(acceleration)
        close(sum(rows), np.zeros(case.n), sum(np.linalg.norm(row) for row in rows) + np.linalg.norm(scale))


def check_everything(case: Case) -> None:
    motion, u, w, along = case.motion, ca.SX(case.u), ca.SX(case.w), case.along
    base, tall = ca.SX(case.base), np.linalg.norm(case.mass)
    check_acceleration(case, motion)

    # Momenta are conjugate to u: p_u = Aᵀ M A w.
    momentum = numbers(motion.momentum(u, w, along))
    size = tall * np.linalg.norm(case.v)
    close(momentum, case.to_q.T @ case.mass @ case.v, size)
    rates = numbers(motion.rates_of_momentum(u, ca.SX(momentum), along))
    close(case.to_q.T @ case.mass @ case.to_q @ rates, momentum, size)
    kinetic = numbers(motion.kinetic_energy(u, w, along))
    close(kinetic, [case.v @ case.mass @ case.v / 2], tall * case.v @ case.v)

    stretch = case.q - case.rest
    energy = stretch @ case.plant.stiffness(case.p).full() @ stretch / 2
    close(numbers(motion.spring_energy(u, base)), [energy], energy)

    reach = case.machine.base.length + sum(link.length for link in case.machine.links)
    far = reach + np.abs(case.q).max() + abs(case.base)
    point = case.plant.end_point(case.q, case.base, case.p).full().ravel()
    close(numbers(motion.end_point(u, along, base)), point, far)
    jacobian = case.plant.jacobian(case.q, case.base, case.p).full()
    close(numbers(motion.end_point_rate(u, w, along, base)), jacobian @ case.v, far * np.linalg.norm(case.v) * case.n)
    rigid = ca.evalf(motion.rigid_jacobian(u, along, base)).full()
    close(rigid, case.plant.rigid_jacobian(case.q, case.base, case.p).full(), far)
    weight = np.linalg.norm(case.gravity) + case.machine.gravity * tall
    close(numbers(motion.holding_torque(u, along)), case.gravity[case.m :], weight)

    for gravity in (False, True):
        force = motion.force(u, w, along, ca.SX(case.tau), base, ca.SX(case.base_rate), gravity=gravity)
        terms = [case.full_tau, -case.spring, -case.damper, -case.gravity * gravity]
        close(numbers(force), case.to_q.T @ sum(terms), sum(np.linalg.norm(term) for term in terms))

    # The potential's slope is g: by automatic differentiation, as nothing else does it.
    symbol = ca.SX.sym("u", case.n)
    angles = motion.angles(symbol)
    symbolic = motion.with_base([(ca.cos(angles[k]), ca.sin(angles[k])) for k in range(angles.shape[0])])
    slope = ca.gradient(motion.potential(symbol, symbolic), symbol)
    close(numbers(ca.substitute(slope, symbol, u)), case.to_q.T @ case.gravity, weight)


@pytest.mark.parametrize("structure", STRUCTURES, ids=str)
@pytest.mark.parametrize("seed", range(2))
def test_every_builder_agrees_with_the_plant(structure, seed):
    check_everything(case_of(structure, seed))


@pytest.mark.long
@settings(derandomize=True, max_examples=12)
@given(drawn=machines(), seed=seeds)
def test_every_builder_of_any_machine(drawn, seed):
    check_everything(Case(*drawn, np.random.default_rng(seed)))


def test_the_excavator():
    machine = load("excavator")
    rng = np.random.default_rng(0)
    for _ in range(5):
        check_everything(Case({}, machine, rng))


@pytest.mark.parametrize("structure", STRUCTURES, ids=str)
def test_acceleration_agrees_with_mujoco(structure):
    case = case_of(structure, 100)
    # MuJoCo's anchors stand still.
    case.base_rate = 0.0
    chain = mujoco_chain(case.data, case.base)
    for gravity in (False, True):
        chain.data.qfrc_applied[chain.order] = case.full_tau
        chain.set(case.q, case.v, gravity=case.data["gravity"] * gravity)
        expected = chain.data.qacc[chain.order].copy()
        actual = case.to_q @ case.acceleration(case.motion, gravity)
        # Two solutions of one linear system differ by its condition number times rounding.
        root = np.sqrt(np.diag(case.mass))
        condition = np.linalg.cond(case.mass / np.outer(root, root))
        close(root * actual, root * expected, np.linalg.norm(root * expected), 1e-13 * condition)


@pytest.mark.parametrize("structure", STRUCTURES, ids=str)
def test_acceleration_agrees_with_lagrange(structure):
    case = case_of(structure, 7)
    oracle = lagrange(case.data)
    mass, bias, gravity, *_ = (x.full() for x in oracle.dynamics(case.q, case.v, case.base))
    acceleration = case.to_q @ case.acceleration(case.motion, gravity=True)
    terms = [mass @ acceleration, bias.ravel(), gravity.ravel(), case.spring, case.damper, -case.full_tau]
    close(sum(terms), np.zeros(case.n), sum(np.linalg.norm(term) for term in terms))


@pytest.mark.parametrize("structure", STRUCTURES, ids=str)
def test_constants_left_out_change_nothing(structure):
    """A machine without offsets, payload, dampers and gravity, by the graph that says so and by the whole one."""
    rng = np.random.default_rng(11)
    data = draw_machine(NumpySource(rng), structure, damping_ratio=0.0, joint_damping=False)
    data["gravity"] = 0.0
    for body in (data["base"], *data["links"]):
        body["com_offset"] = 0.0
    data["payload"]["mass"] = 0.0
    case = Case(data, machine_from_dict(data), rng)
    sparse, whole = structure_of(case.machine), full_structure(case.machine)
    assert {f"b{k}" for k in range(1 + len(data["links"]))} | {"gravity"} <= sparse.zeros
    assert not {name for name in whole.zeros if not name.startswith(("lateral", "origin", "rest_"))}
    full = case.motion_of(whole)
    actual, expected = case.acceleration(case.motion, True), case.acceleration(full, True)
    close(actual, expected, np.linalg.norm(expected), 1e-14 * np.linalg.cond(case.mass))
    check_everything(case)


def test_constants_follow_the_parameters():
    """`constants` at the parameters of another machine of the same structure are that machine's own."""
    structure = Structure(3, ("x", "y", "rotation"), (1,))
    first, second = (case_of(structure, seed).machine for seed in (1, 2))
    function = constants(first)
    moved = function(ca.DM([parameter.value for parameter in second.parameters]))
    own = constant_values(second)
    assert constant_names(first) == tuple(own)
    np.testing.assert_array_equal(moved.full().ravel(), list(own.values()))


def test_structure_names_what_exists():
    case = case_of(Structure(4, ("y", "rotation"), (0, 3)), 3)
    structure = structure_of(case.machine)
    assert structure.chain
    assert case.motion.translations == [("y", 1.0)]
    assert case.motion.first == 0
    assert case.motion.hinged == [0, 1, 4]
    assert case.motion.hinges == [1, 2, 3]
    assert case.motion.joints == [2, 3]
    assert case.motion.n == case.n == 6


def test_free_flight_keeps_momentum():
    """With springs and weight away, the horizontal momentum of the whole machine has no rate."""
    data = draw_machine(NumpySource(np.random.default_rng(5)), Structure(3, ("x", "y", "rotation"), ()))
    data["base"]["damping"] = {}
    case = Case(data, machine_from_dict(data), np.random.default_rng(6))
    # Stand in the springs' rest position, so that the base's springs do not pull.
    anchored = case.u.copy()
    anchored[:2] = case.base, 0.0
    case.u = anchored
    case.base_rate = 0.0
    acceleration = case.acceleration(case.motion, gravity=False)
    model = mujoco_chain(data, case.base)
    q = case.to_q @ anchored + numbers(case.motion.offset)
    model.set(q, case.v)
    mujoco.mj_subtreeVel(model.model, model.data)
    total = sum(body["mass"] for body in (data["base"], *data["links"])) + data["payload"]["mass"]
    velocity = model.data.subtree_linvel[0, :2]
    momentum = numbers(case.motion.momentum(ca.SX(case.u), ca.SX(case.w), case.along))[:2]
    np.testing.assert_allclose(momentum, total * velocity, rtol=1e-12)
    u, w = ca.SX.sym("u", case.n), ca.SX.sym("w", case.n)
    angles = case.motion.angles(u)
    along = case.motion.with_base([(ca.cos(angles[k]), ca.sin(angles[k])) for k in range(angles.shape[0])])
    linear = case.motion.momentum(u, w, along)[:2]
    rate = ca.jtimes(linear, ca.vertcat(u, w), ca.vertcat(ca.SX(case.w), ca.SX(acceleration)))
    found = ca.Function("rate", [u, w], [rate])(anchored, case.w).full().ravel()
    assert np.linalg.norm(found) <= 1e-12 * np.linalg.norm(case.mass) * np.linalg.norm(acceleration)
