"""Robot descriptions that others published, installed from the registry, against Pinocchio and MuJoCo."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from importlib.metadata import files
from pathlib import Path

import mujoco
import numpy as np
import pytest

from flexopt import ModelError
from flexopt.errors import FlexoptWarning
from flexopt.model.robots import robot_from_dict
from flexopt.model.robots.reading import read_description
from tests.model.robots.test_readings import MujocoRobot, PinocchioRobot, assert_same, joint_values
from tests.model.robots.tree_oracle import TreeOracle

# Arms, hands, legged machines, mobile manipulators, some with 20 and more joints, mimic joints, slightly odd inertias.
URDFS = {
    "ur5_robot.urdf", "ur10_robot.urdf", "panda.urdf", "kinova.urdf", "xarm7.urdf", "z1.urdf", "so101.urdf", "tiago.urdf",
    "tiago_pro.urdf", "baxter.urdf", "talos_full_v2.urdf", "icub.urdf", "go2.urdf", "b1-z1.urdf", "allegro_left_hand.urdf",
    "pr2.urdf", "human.urdf", "double_pendulum_continuous.urdf", "anymal-kinova.urdf", "simple_humanoid.urdf",
}  # fmt: skip
MJCFS = {
    "ant.xml", "half_cheetah.xml", "hopper.xml", "humanoid.xml", "inverted_double_pendulum.xml", "pusher_v5.xml",
    "reacher.xml", "swimmer.xml", "walker2d_v5.xml",
}  # fmt: skip


def installed(package: str, wanted: Callable[[Path], bool]) -> list[Path]:
    """Files of an installed distribution, found without importing it."""
    found = {Path(str(file.locate())) for file in files(package) or () if wanted(Path(str(file)))}
    return sorted(found, key=lambda path: path.name)


def by_name(paths: list[Path]) -> dict[str, Path]:
    return {path.name: path for path in paths}


URDF_PATHS = by_name(installed("example-robot-data", lambda path: path.name in URDFS))
MJCF_PATHS = by_name(installed("gymnasium", lambda path: path.name in MJCFS and "assets" in path.parts))


def test_the_packages_have_what_is_tested() -> None:
    assert set(URDF_PATHS) == URDFS
    assert set(MJCF_PATHS) == MJCFS


@pytest.mark.filterwarnings("ignore::flexopt.errors.FlexoptWarning")
@pytest.mark.parametrize("name", sorted(URDFS))
def test_a_public_urdf_is_pinocchios(name: str) -> None:
    """On a base that gives in all six directions: Pinocchio's free flyer, at rest."""
    path = URDF_PATHS[name]
    robot, faults = read_description(path, name)
    assert not faults
    joints = [joint for link in robot.links for joint in link.joints]
    actuated = [joint.name for joint in joints if joint.mimic is None]
    mimics = {joint.name: 0.0 for joint in joints if joint.mimic is not None}
    machine = {
        "name": "public", "robot": name, "actuated": actuated, "locked": mimics, "base": {"stiffness": [1e5] * 6},
        "joints": {joint.name: {"limits": [-1, 1]} for joint in joints},
        "end_point": {"link": robot.links[-1].name, "rows": ["x"]},
    }  # fmt: skip
    tree = robot_from_dict(machine, folder=path.parent)
    base = [f"base.{direction}" for direction in ("x", "y", "z", "roll", "pitch", "yaw")]
    peer = PinocchioRobot(path, free=True)
    for seed in range(2):
        values = joint_values(tree, seed) | dict.fromkeys(base, 0.0)
        peer.at({joint: values[joint] for joint in actuated} | mimics)
        oracle = TreeOracle(tree, values)
        index = [*range(6), *peer.columns(actuated)]
        assert_same(oracle.mass_matrix([*base, *actuated]), peer.mass[np.ix_(index, index)])
        assert_same(oracle.end_point(), peer.frame(robot.links[-1].name))
        moving = {body.joint.name for body in tree.bodies}
        assert moving == {*base, *actuated}


@pytest.mark.filterwarnings("ignore::flexopt.errors.FlexoptWarning")
@pytest.mark.parametrize("name", sorted(MJCFS))
def test_a_public_mjcf_is_mujocos(name: str) -> None:
    path = MJCF_PATHS[name]
    robot, faults = read_description(path, name)
    assert not faults
    joints = [joint for link in robot.links for joint in link.joints]
    free = next((link.name for link in robot.links for joint in link.joints if joint.kind == "free"), None)
    named = [joint.name for joint in joints if joint.kind != "free"]
    actuated = named if free else named[1:]
    machine = {
        "name": "public", "robot": name, "actuated": actuated, "ignore": ["tendon"], "gravity": 9.81,
        "joints": {joint: {"stiffness": 0.0 if joint in actuated else 1.0} for joint in named},
        "end_point": {"link": robot.links[-1].name, "rows": ["x"]},
    }  # fmt: skip
    if free:
        machine |= {"base": {"stiffness": [1e5] * 6}, "root": free}
    tree = robot_from_dict(machine, folder=path.parent)
    peer = MujocoRobot(mujoco.MjModel.from_xml_path(str(path)))
    for seed in range(2):
        values = {name: 0.0 if name.startswith("base.") else v for name, v in joint_values(tree, seed).items()}
        peer.at({name: value for name, value in values.items() if not name.startswith("base.")})
        oracle = TreeOracle(tree, values)
        ours = oracle.mass_matrix(list(tree.coordinates))
        moving = [tree.coordinates.index(joint) for joint in named]
        assert_same(ours[np.ix_(moving, moving)], peer.mass(named))
        assert_same(oracle.end_point(), peer.body(peer.model.nbody - 1))
        total = peer.model.body_subtreemass[peer.model.body(free or robot.links[0].name).id]
        if free:
            assert sum(body.mass for body in tree.bodies) == pytest.approx(total, rel=1e-12)


@pytest.mark.long
def test_every_published_file_is_read_or_refused_with_a_place() -> None:
    """All 70 URDF files of the package: one of a tree, or faults that each name file and line or a key."""
    read, refused = 0, list[str]()
    paths = installed("example-robot-data", lambda path: path.suffix == ".urdf")
    assert len(paths) > 60
    for path in paths:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FlexoptWarning)
            robot, faults = read_description(path, path.name)
            assert all(path.name in fault.field for fault in faults)
            if faults:
                continue
            joints = [joint for link in robot.links for joint in link.joints if joint.kind != "free"]
            machine = {
                "name": "public", "robot": path.name, "lock_others": True, "base": {"stiffness": [1.0] * 6},
                "actuated": [joint.name for joint in joints if joint.mimic is None],
                "locked": {joint.name: joint.limits[0] if joint.limits else 0.0 for joint in joints if joint.mimic},
                "end_point": {"link": robot.links[-1].name, "rows": ["x"]},
            }  # fmt: skip
            try:
                robot_from_dict(machine, folder=path.parent)
                read += 1
            except ModelError as error:
                refused += [fault.field for fault in error.faults]
    assert read >= 55
    assert all(".urdf:" in field or field == "end_point.rows" for field in refused)
