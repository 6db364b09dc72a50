"""Capsules of a machine kept apart from each other: MuJoCo's distances, which pairs count, and a choice that keeps them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import flexopt
from flexopt import InputError
from flexopt.model.constraints import read_constraints
from flexopt.plant import build_plant
from flexopt.selection.constraints import build_constraints
from flexopt.selection.constraints.clearance import capsule_names
from flexopt.selection.constraints.self_clearance import meeting_pairs, overlapping_pairs
from tests.oracles.spatial import grounded, random_tree
from tests.selection.constraints.scenes import at_rest, least_by_label, listed, mujoco_scene, random_capsules


@pytest.mark.parametrize("seed", range(8))
def test_distances_are_mujocos(seed):
    rng = np.random.default_rng(seed)
    data = random_tree(seed, counts=(2, 5))
    data["capsules"] = random_capsules(rng, [body["name"] for body in data["bodies"]], 3)
    machine = flexopt.tree_from_dict(data)
    plant = build_plant(machine)
    rows = build_constraints(plant, read_constraints({"self_clearance": 0.1}))
    pairs = meeting_pairs(machine)
    assert rows.placed is False
    names = capsule_names(machine.capsules)
    labels = [f"self-clearance of {names[j]} from {names[i]}" for i, j in pairs]
    assert list(dict.fromkeys(listed(rows).labels)) == labels
    assert labels
    scene = mujoco_scene(data, data["capsules"], [], np.zeros(3))
    parents = {body["name"]: body.get("parent") for body in data["bodies"]}
    for i, j in pairs:
        one, other = machine.capsules[i].body, machine.capsules[j].body
        assert one != other
        assert parents[one] != other
        assert parents[other] != one
    scene.model.opt.ccd_tolerance, scene.model.opt.ccd_iterations = 1e-13, 1000
    for _ in range(4):
        base, posture = rng.uniform(-2, 2, 3), rng.uniform(-2, 2, plant.n_actuated)
        q = at_rest(plant, base, posture)
        scene.set(q, np.zeros_like(q))
        at = (base, posture, plant.parameter_values, rows.constants)
        values = least_by_label(rows, rows.function(*at).full().ravel())
        assert values == pytest.approx(least_by_label(rows, rows.report(*at).full().ravel()), abs=1e-14)
        for (i, j), value in zip(pairs, values.values(), strict=True):
            one, other = (scene.model.geom(f"capsule{k}").id for k in (i, j))
            expected = mujoco.mj_geomDistance(scene.model, scene.data, one, other, 1e3, None)
            assert value == pytest.approx(expected, abs=1e-9)


def test_which_pairs_of_an_excavator():
    """Not those that share a pin, nor the two tracks; what only slews against the tracks comes near them all the same."""
    rows = build_constraints(build_plant(flexopt.load("slewing-excavator")), read_constraints({"self_clearance": 0.1}))
    said = [label.removeprefix("self-clearance of ").split(" from ") for label in listed(rows).labels]
    pairs = {frozenset(who.split(" capsule")[0] for who in two) for two in said}
    expected = ["boom undercarriage", "stick undercarriage", "bucket undercarriage", "house stick", "house bucket"]
    assert pairs == {frozenset(two.split()) for two in [*expected, "boom bucket"]}
    # Two rows each.
    assert len(rows) == 2 * (4 + 2 + 2 + 2 + 2 + 2)


def test_bodies_beside_a_joint_of_several_hinges_are_neighbours():
    """A massless body between them is a part of the joint."""
    data = grounded(3, 0, coupled=False)
    data["bodies"][7] |= {"mass": 0.0, "com": [0.0] * 3, "inertia": [0.0] * 6}
    ball = {"start": [0, 0, 0], "end": [0, 0, 0], "radius": 0.1}
    named = [ball | {"body": name} for name in ("chassis", "arm0", "arm2")]
    machine = flexopt.tree_from_dict(data | {"capsules": named})
    assert meeting_pairs(machine) == ((0, 2),)


def test_what_is_lacking_is_named():
    with pytest.raises(InputError, match=r"self_clearance: needs the volumes of bodies, and excavator has none"):
        flexopt.build_selection(flexopt.load("excavator"), (0.0, 1.6), constraints={"self_clearance": 0.1})
    data = grounded(3, 0, coupled=False)
    ball = {"start": [0, 0, 0], "end": [0, 0, 0], "radius": 0.1}
    machine = flexopt.tree_from_dict(data | {"capsules": [ball | {"body": "arm0"}, ball | {"body": "arm1"}]})
    with pytest.raises(InputError, match=r"self_clearance = 0.1: needs two bodies .* its capsules are of arm0, arm1"):
        build_constraints(build_plant(machine), read_constraints({"self_clearance": 0.1}))


@pytest.mark.long
def test_a_choice_keeps_it():
    """More of it than the best has: the margin is in the result, and nothing comes nearer."""
    machine = flexopt.load("boom-stick-bucket")

    def chosen(least):
        found = flexopt.select(machine, (6.0, 5.0), constraints={"self_clearance": least}, workers=1).best
        values = [value.value for name, value in found.constraints.items() if name.startswith("self-clearance")]
        assert len(values) == len(meeting_pairs(machine))
        return min(values), found

    nearest, free = chosen(0.0)
    least = nearest + 0.2
    farther, kept = chosen(least)
    assert farther >= least - 1e-7
    assert np.abs(kept.z - free.z).max() > 0.1


def test_what_overlaps_in_every_posture_is_left_out_and_named():
    """As hulls of robot files do across a shoulder: the distance of their axes is never above that of the joints."""
    data = grounded(4, 0, coupled=False)
    ball = {"start": [0, 0, 0], "end": [0, 0, 0]}
    far = float(np.linalg.norm(np.array(data["bodies"][-2]["position"]))) + float(
        np.linalg.norm(np.array(data["bodies"][-1]["position"]))
    )
    small, large = ball | {"radius": 1e-3}, ball | {"radius": far}
    named = [small | {"body": "chassis"}, large | {"body": "arm1"}, small | {"body": "arm3"}]
    machine = flexopt.tree_from_dict(data | {"capsules": named})
    assert meeting_pairs(machine) == ((0, 1), (0, 2), (1, 2))
    assert (1, 2) in overlapping_pairs(machine)
    rows = build_constraints(build_plant(machine), read_constraints({"self_clearance": 0.001}))
    assert "self-clearance of arm3 from arm1" not in listed(rows).labels
    assert "self-clearance of arm3 from chassis" in listed(rows).labels
    target = flexopt.evaluate(machine, np.full(4, 0.3)).end_point
    problem = flexopt.build_selection(machine, target, constraints={"self_clearance": 0.001})
    [said] = [each for each in problem.assumed if each.name == "self_clearance"]
    assert "arm3 from arm1" in said.sentence
