"""Every machine that ships, and robots that others published: M, bias, J and the end-point against Pinocchio and MuJoCo.

The shipped machines are whatever `models/` holds. Of a spatial one both oracles are built from its validated `Tree`, and
M once more from the robot file itself, which Pinocchio reads as URDF or MuJoCo as MJCF.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import casadi as ca
import mujoco
import numpy as np
import pinocchio as pin
import pytest

from flexopt import build_plant, load
from flexopt.model import Machine
from flexopt.model.robots import robot_from_dict
from flexopt.model.robots.reading import read_description
from tests.model.robots.test_public_robots import MJCF_PATHS, URDF_PATHS
from tests.model.robots.test_readings import MujocoRobot, PinocchioRobot
from tests.oracles.mujoco_chain import mujoco_chain
from tests.oracles.pinocchio_chain import pinocchio_chain
from tests.oracles.spatial import mujoco_tree, pinocchio_tree
from tests.plant.test_dynamics import bias_scale, from_flexopt, gravity_scale
from tests.plant.test_spatial import close, column

MODELS = Path(__file__).parents[2] / "models"
SHIPPED = {path.stem: load(path.stem) for path in sorted(MODELS.glob("*.toml"))}
PLANAR = [name for name, machine in SHIPPED.items() if isinstance(machine, Machine)]
SPATIAL = [name for name in SHIPPED if name not in PLANAR]
PUBLIC = sorted(URDF_PATHS) + sorted(MJCF_PATHS)
# MuJoCo refuses inertias that are not positive.
NOT_IN_MUJOCO = {"icub.urdf"}


def test_what_is_compared():
    assert {"excavator", "boom-stick-bucket"} <= set(PLANAR)
    assert {"slewing-excavator", "truck-crane", "mobile-manipulator"} <= set(SPATIAL)
    assert len(URDF_PATHS) >= 20
    assert len(MJCF_PATHS) >= 9


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", PLANAR)
def test_shipped_planar_machine(name, seed):
    machine = SHIPPED[name]
    data = machine.model_dump(by_alias=True)
    data["base"]["stiffness"] = {d: k for d, k in data["base"]["stiffness"].items() if k is not None}
    rng, plant = np.random.default_rng(seed), build_plant(machine)
    n = plant.n_coordinates
    q, v, base = rng.uniform(-3, 3, n), rng.uniform(-2, 2, n), float(rng.uniform(-5, 5))
    ours, m = from_flexopt(plant, q, v, base), plant.n_passive
    of_bias, of_weight = bias_scale(data, v), gravity_scale(data)
    chain, peer = mujoco_chain(data, base), pinocchio_chain(data, base)
    chain.set(q, v, gravity=machine.gravity)
    for mass, effects, tip, jacobian in (
        (chain.mass(), chain.bias(), chain.end_point(), chain.jacobian()),
        (peer.mass(q), peer.nonlinear_effects(q, v), peer.end_point(q), peer.jacobian(q)),
    ):
        close(ours["M"], mass)
        close(ours["h"] + ours["g"], effects, of_bias + of_weight)
        close(ours["r"], tip)
        close(ours["J"], jacobian)
        close(ours["Jv"], jacobian[:, m:])
    close(ours["g"], peer.gravity(q), of_weight)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", SPATIAL)
def test_shipped_spatial_machine(name, seed):
    assert_both_agree(SHIPPED[name], seed)


@pytest.mark.filterwarnings("ignore::flexopt.errors.FlexoptWarning")
@pytest.mark.parametrize("name", PUBLIC)
def test_public_robot(name):
    tree = public_tree(name)
    assert_both_agree(tree, 0, with_mujoco=name not in NOT_IN_MUJOCO)


def public_tree(name):
    """The whole robot: on a base that gives in six directions, or where it is fixed its first joint passive."""
    path = URDF_PATHS.get(name) or MJCF_PATHS[name]
    robot, faults = read_description(path, name)
    assert not faults
    joints = [joint for link in robot.links for joint in link.joints]
    followers = {joint.name: 0.0 for joint in joints if joint.mimic is not None}
    moving = [joint.name for joint in joints if joint.kind != "free" and joint.name not in followers]
    root = next((link.name for link in robot.links for joint in link.joints if joint.kind == "free"), None)
    fixed = path.suffix == ".xml" and root is None
    actuated = moving[1:] if fixed else moving
    tables = {joint: {"stiffness": 0.0 if joint in actuated else 1.0} for joint in moving}
    for joint in actuated:
        tables[joint]["limits"] = [-1.0, 1.0]  # some have none, or none that leave room
    machine = {
        "name": "public", "robot": name, "actuated": actuated, "locked": followers, "joints": tables, "gravity": 9.81,
        "ignore": ["tendon"], "end_point": {"link": robot.links[-1].name, "rows": ["x", "y", "z"][: len(actuated)]},
    }  # fmt: skip
    if not fixed:
        machine |= {"base": {"stiffness": [1e5] * 6}} | ({} if root is None else {"root": root})
    return robot_from_dict(machine, folder=path.parent)


def assert_both_agree(tree, seed, *, with_mujoco=True):
    """Whatever a state gives: M, bias with weight, the rows of the end-point and their Jacobian."""
    plant, rng = build_plant(tree), np.random.default_rng(seed)
    data = tree.to_dict() | {"gravity": tree.gravity, "end_point": tree.end_point.model_dump()}
    n, m, p = plant.n_coordinates, plant.n_passive, plant.parameter_values
    assert n == len(tree.bodies)
    q, v = rng.uniform(-1.5, 1.5, n), rng.uniform(-2, 2, n)
    base = np.zeros(3)
    for i, coordinate in enumerate(tree.base_coordinates):
        base["xy".index(coordinate) if coordinate != "yaw" else 2] = rng.uniform(-1, 1)
        assert i == ["x", "y", "yaw"].index(coordinate)
    mass, jacobian = plant.mass(q, base, p).full(), plant.jacobian(q, base, p).full()
    effects = column(plant.bias(q, v, base, p)) + column(plant.gravity(q, base, p))
    tip = column(plant.end_point(q, base, p))

    peer = pinocchio_tree(data)
    expected, slope, _ = peer.task(q, base)
    close(mass, peer.mass(q))
    close(effects, peer.nonlinear_effects(q, v))
    close(column(plant.gravity(q, base, p)), peer.gravity(q), np.linalg.norm(effects))
    close(tip, expected, 1 + np.linalg.norm(expected))
    close(jacobian, slope, 1 + np.linalg.norm(slope))
    close(plant.rigid_jacobian(q, base, p).full(), slope[:, m:], 1 + np.linalg.norm(slope))
    if not with_mujoco:
        return
    chain = mujoco_tree(data)
    chain.set(q, v)
    turn, rows = pin.rpy.rpyToMatrix(0.0, 0.0, base[2]), ["xyz".index(row) for row in tree.end_point.rows]
    expected, slope = turn @ chain.end_point() + [*base[:2], 0.0], turn @ chain.jacobian()[:3]
    close(mass, chain.mass())
    close(effects, chain.nonlinear_effects())
    close(tip, expected[rows], 1 + np.linalg.norm(expected))
    close(jacobian, slope[rows], 1 + np.linalg.norm(slope))


@pytest.mark.parametrize("name", SPATIAL)
def test_shipped_robot_file_is_what_others_read(name):
    """M of the moving joints and the end-point's place, the base at rest, from the file by another reader."""
    tree, plant = SHIPPED[name], build_plant(SHIPPED[name])
    overlay = tomllib.loads((MODELS / f"{name}.toml").read_text(encoding="utf-8"))
    path, tool = MODELS / overlay["robot"], overlay["end_point"]
    rng, p, base = np.random.default_rng(0), ca.DM(plant.parameter_values), np.zeros(3)
    # Without the payload, which the robot file does not have.
    p[plant.parameter_names.index("payload.mass")] = 0.0
    own = [joint for joint in tree.coordinates if not joint.startswith("base.")]
    kept = [tree.coordinates.index(joint) for joint in own]
    for _ in range(5):
        q = np.zeros(len(tree.coordinates))
        q[kept] = rng.uniform(-1.5, 1.5, len(kept))
        values = dict(zip(own, q[kept], strict=True))
        if path.suffix == ".urdf":
            peer = PinocchioRobot(path)
            peer.at(values)
            index = peer.columns(own)
            mass, frame = peer.mass[np.ix_(index, index)], peer.frame(tool["link"])
        else:
            peer = MujocoRobot(mujoco.MjModel.from_xml_path(str(path)))
            peer.at(values)
            mass, frame = peer.mass(own), peer.site(tool["site"])
        close(plant.mass(q, base, p).full()[np.ix_(kept, kept)], mass)
        tip = (frame @ [*tool.get("offset", [0.0, 0.0, 0.0]), 1.0])[:3]
        close(column(plant.end_point(q, base, p)), tip)
