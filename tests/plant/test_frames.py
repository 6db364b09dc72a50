"""Frames of bodies and the centre of mass: MuJoCo in space, a tree of the same machine in the plane."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from flexopt.model import machine_from_dict
from flexopt.model.tree import tree_from_dict
from flexopt.plant import build_plant
from tests.oracles.machines import NumpySource, draw_machine, draw_structure
from tests.oracles.mujoco_chain import mujoco_chain
from tests.oracles.spatial import grounded, in_space, mujoco_tree, random_tree


def frames(plant, q, base):
    origins, rotations = plant.body_frames(q, base, plant.parameter_values)
    d = plant.frames.dimension
    rotations = rotations.full()
    return origins.full(), [rotations[:, k * d : (k + 1) * d] for k in range(origins.shape[1])]


def centre(plant, q, base):
    return plant.centre_of_mass(q, base, plant.parameter_values).full().ravel()


def placed(base):
    x, y, yaw = base
    return pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, yaw), np.array([x, y, 0.0]))


@pytest.mark.parametrize("seed", range(30))
def test_trees_agree_with_mujoco(seed):
    data = random_tree(seed) if seed else grounded(4, 0, coupled=False)
    if seed % 3 == 0:
        data["end_point"]["rows"] = data["end_point"]["rows"][:1]
    tree = tree_from_dict(data)
    plant, chain = build_plant(tree), mujoco_tree(data)
    rng = np.random.default_rng(seed)
    q, base = rng.uniform(-2, 2, plant.n_coordinates), rng.uniform(-3, 3, 3)
    chain.set(q, np.zeros_like(q))
    anchor = placed(base)
    origins, rotations = frames(plant, q, base)
    assert plant.frames.names == tuple(body["name"] for body in data["bodies"])
    for k, body in enumerate(data["bodies"]):
        if body.get("mass"):  # MuJoCo merges bodies without mass
            there = chain.data.body(f"body {body['name']}")
            frame = anchor * pin.SE3(there.xmat.reshape(3, 3), there.xpos)
            assert np.abs(origins[:, k] - frame.translation).max() <= 1e-13
            assert np.abs(rotations[k] - frame.rotation).max() <= 1e-13
    mujoco.mj_comPos(chain.model, chain.data)
    expected = anchor.act(chain.data.subtree_com[0])
    assert np.abs(centre(plant, q, base) - expected).max() <= 1e-13
    end = plant.end_rotation(q, base, plant.parameter_values).full()
    tip = chain.data.site("tip").xmat.reshape(3, 3)
    assert np.abs(end - anchor.rotation @ tip).max() <= 1e-13


@pytest.mark.parametrize("seed", range(20))
def test_chains_agree_with_mujoco(seed):
    source = NumpySource(np.random.default_rng(seed))
    data = draw_machine(source, draw_structure(source))
    machine = machine_from_dict(data)
    plant, base = build_plant(machine), 0.7
    chain = mujoco_chain(data, base)
    q = np.random.default_rng(seed).uniform(-2, 2, plant.n_coordinates)
    chain.set(q, np.zeros_like(q))
    origins, rotations = frames(plant, q, base)
    assert plant.frames.names == ("base", *(link["name"] for link in data["links"]))
    for k in range(len(plant.frames.names)):
        assert np.abs(origins[:, k] - chain.data.xpos[k + 1][:2]).max() <= 1e-13
        assert np.abs(rotations[k] - chain.data.xmat[k + 1].reshape(3, 3)[:2, :2]).max() <= 1e-13
    assert np.abs(centre(plant, q, base) - chain.data.subtree_com[0][:2]).max() <= 1e-13
    end = plant.end_rotation(q, base, plant.parameter_values).full()
    assert np.abs(end - rotations[-1]).max() == 0


def test_the_plane_is_the_plane_in_space():
    source = NumpySource(np.random.default_rng(3))
    structure = draw_structure(source)
    while len(structure[1]) < 3:
        structure = draw_structure(source)
    data = draw_machine(source, structure)
    flat, space = build_plant(machine_from_dict(data)), build_plant(tree_from_dict(in_space(data)))
    q = source.rng.uniform(-2, 2, flat.n_coordinates)
    order = [flat.coordinates.index(name) for name in space.coordinates]
    assert np.abs(centre(space, q[order], 0.0)[[0, 2]] - centre(flat, q, 0.0)).max() <= 1e-13
    c, s = flat.end_rotation(q, 0.0, flat.parameter_values).full()[:, 0]
    turned = space.end_rotation(q[order], 0.0, space.parameter_values).full()
    assert math.atan2(turned[2, 0], turned[2, 2]) == pytest.approx(math.atan2(s, c), abs=1e-13)
