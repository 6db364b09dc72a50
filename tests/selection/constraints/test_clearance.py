"""Clearance of whole machines: MuJoCo's distances in random scenes, derivatives, and that an optimiser finds its way out."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from flexopt.model import load, machine_from_dict
from flexopt.model.constraints import read_constraints
from flexopt.model.tree import tree_from_dict
from flexopt.plant import build_plant
from flexopt.selection.constraints import build_constraints
from tests.model.robots.files import URDF, URDF_MACHINE, changed_text, read
from tests.oracles.machines import NumpySource, Structure, draw_machine
from tests.oracles.spatial import in_space, random_tree
from tests.selection.constraints.scenes import (
    at_rest,
    distance,
    least_by_label,
    listed,
    mujoco_scene,
    random_capsules,
    random_obstacles,
)

# Of capsules from boxes, whose distance MuJoCo finds iteratively; the others come to rounding.
TOLERANCE = {"box": 1e-10, "sphere": 1e-12, "half_plane": 1e-12, "ground": 1e-12}


def values_by_row(plant, rows, base, posture) -> dict[str, float]:
    """As a solver sees them and, which must be the same, as people do."""
    at = (base, posture, plant.parameter_values, rows.constants)
    values, told = (least_by_label(rows, graph(*at).full().ravel()) for graph in (rows.function, rows.report))
    assert values == pytest.approx(told, abs=1e-13)
    return values


def least(values: dict[str, float], who: str, name: str) -> float:
    """Of the rows of a capsule and an obstacle: there may be one for each end."""
    parts = [f"clearance of {who}{part} from {name}" for part in ("", " (start)", " (end)")]
    found = [values[part] for part in parts if part in values]
    assert len(found) in (1, 2)
    return min(found)


def names_of(capsules) -> list[str]:
    bodies = [capsule["body"] for capsule in capsules]
    return [
        body if bodies.count(body) == 1 else f"{body} capsule {bodies[: k + 1].count(body)}"
        for k, body in enumerate(bodies)
    ]


def compare(chain, capsules, obstacles, values) -> int:
    """Every capsule and obstacle against MuJoCo; how many overlap but for their axes."""
    overlapping = 0
    for k, who in enumerate(names_of(capsules)):
        for i, obstacle in enumerate(obstacles):
            ours = least(values, who, obstacle.get("name", f"obstacle {i + 1}"))
            if obstacle["kind"] == "box" and ours <= -capsules[k]["radius"]:
                continue  # the axis itself is inside: MuJoCo gives the depth of one contact
            assert abs(ours - distance(chain, k, i)) <= TOLERANCE[obstacle["kind"]], (who, obstacle)
            overlapping += ours < 0
    return overlapping


@pytest.mark.long
def test_trees_among_obstacles():
    overlapping = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        data = random_tree(seed)
        data["placement"] = [("x", "y", "yaw"), ("x", "yaw"), ("yaw",)][seed % 3]
        data["capsules"] = random_capsules(rng, [body["name"] for body in data["bodies"]], 3)
        plant = build_plant(tree_from_dict(data))
        obstacles = random_obstacles(rng, 3, 3.0)
        rows = build_constraints(plant, read_constraints({"clearance": {"distance": 0.1, "obstacles": obstacles}}))
        base = rng.uniform(-2, 2, plant.n_base)
        whole = [dict(zip(data["placement"], base, strict=True)).get(name, 0.0) for name in ("x", "y", "yaw")]
        chain = mujoco_scene(data, data["capsules"], obstacles, np.array(whole))
        for _ in range(8):
            posture = rng.uniform(-2, 2, plant.n_actuated)
            q = at_rest(plant, base, posture)
            chain.set(q, np.zeros_like(q))
            overlapping += compare(chain, data["capsules"], obstacles, values_by_row(plant, rows, base, posture))
    assert overlapping > 100


@pytest.mark.long
def test_chains_among_obstacles():
    """The same machine in space: discs become balls, rectangles long boxes across the plane."""
    overlapping = 0
    for seed in range(15):
        rng = np.random.default_rng(seed)
        data = draw_machine(NumpySource(rng), Structure(2 + seed % 3, ("x", "y", "rotation"), ()))
        data["capsules"] = random_capsules(rng, ["base", *(link["name"] for link in data["links"])], 2)
        plant = build_plant(machine_from_dict(data))
        flat = random_obstacles(rng, 2, 3.0)
        ground = float(rng.uniform(-1, 1))
        asked = {"distance": 0.1, "obstacles": flat, "ground": ground}
        rows = build_constraints(plant, read_constraints({"clearance": asked}))
        assert not any("base" in label and "ground" in label for label in listed(rows).labels)
        base, posture = rng.uniform(-1, 1, 1), rng.uniform(-3, 3, plant.n_actuated)
        tree = in_space(data)
        capsules = [standing(one, "start", "end") for one in data["capsules"]]
        for one in capsules:
            one["body"] = "base.rotation" if one["body"] == "base" else one["body"]
        obstacles = [standing(one, "center", "point", "normal", "size") | {"upright": True} for one in flat]
        obstacles.append({"kind": "half_plane", "point": [0, 0, ground], "normal": [0, 0, 1]})
        obstacles[1]["size"][1] = 50.0
        chain = mujoco_scene(tree, capsules, obstacles, np.zeros(3))
        space = build_plant(tree_from_dict(tree))
        q = at_rest(space, base, posture)  # the slide along x carries the placement
        chain.set(q, np.zeros_like(q))
        values = values_by_row(plant, rows, base, posture)
        overlapping += compare(chain, data["capsules"], obstacles[:-1], values)
        for k, (who, capsule) in enumerate(zip(names_of(data["capsules"]), data["capsules"], strict=True)):
            if capsule["body"] != "base":
                assert abs(least(values, who, "ground") - distance(chain, k, 3)) <= TOLERANCE["ground"]
    assert overlapping > 20


def standing(entry, *keys):
    """(x, y) of the plane as (x, 0, z)."""
    lifted = {key: [entry[key][0], 0.0, entry[key][1]] for key in keys if key in entry}
    return {**entry, **lifted}


@pytest.mark.parametrize("seed", range(6))
def test_derivatives(seed):
    rng = np.random.default_rng(seed)
    data = random_tree(seed)
    data["capsules"] = random_capsules(rng, [data["bodies"][-1]["name"]], 3)
    plant = build_plant(tree_from_dict(data))
    asked = {"distance": 0.0, "ground": 0.0, "obstacles": random_obstacles(rng, 3, 2.0)}
    rows = build_constraints(plant, read_constraints({"clearance": asked}))
    b, q = ca.SX.sym("b", plant.n_base), ca.SX.sym("q", plant.n_actuated)
    g = rows.function(b, q, plant.parameter_values, rows.constants)
    z = ca.vertcat(b, q)
    function = ca.Function("g", [z], [g, ca.jacobian(g, z)])
    errors = []
    for _ in range(20):
        at = rng.uniform(-2, 2, z.shape[0])
        jacobian, steps = function(at)[1].full(), 1e-6 * np.eye(at.size)
        numeric = [(function(at + e)[0].full() - function(at - e)[0].full()).ravel() / 2e-6 for e in steps]
        errors.append(np.abs(jacobian - np.array(numeric).T).max())
    # One or two of so many rows and points may lie within a step of a kink.
    assert np.quantile(errors, 0.9) <= 1e-7


def excavator(**more):
    data = load("excavator").to_dict()
    data["capsules"] = [
        {"body": "boom", "start": [0, 0], "end": [1.918, 0], "radius": 0.2},
        {"body": "stick", "start": [0, 0], "end": [1.097, 0], "radius": 0.15},
    ]
    return build_plant(machine_from_dict(data | more))


def test_an_optimiser_leaves_an_obstacle():
    """From postures whose axes cross a box or a disc, the nearest posture that is clear."""
    plant = excavator()
    obstacles = [
        {"kind": "box", "name": "wall", "center": [1.2, 1.2], "size": [0.4, 1.5], "yaw": 0.2},
        {"kind": "sphere", "name": "tank", "center": [-1.5, 1.0], "radius": 0.4},
    ]
    rows = build_constraints(
        plant, read_constraints({"clearance": {"distance": 0.1, "ground": 0.0, "obstacles": obstacles}})
    )
    q = ca.MX.sym("q", 2)
    g = rows.function(0.0, q, plant.parameter_values, rows.constants)
    options = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}}
    start = ca.MX.sym("start", 2)
    solver = ca.nlpsol("s", "ipopt", {"x": q, "p": start, "f": ca.sumsqr(q - start), "g": g}, options)
    crossing = 0
    for at in ([1.4, -0.3], [0.0, 0.5], [-0.5, 0.0], [-0.6, -0.5]):
        before = rows.function(0.0, at, plant.parameter_values, rows.constants).full().ravel()
        crossing += before.min() < -0.2
        found = solver(x0=at, p=at, lbg=listed(rows).lower, ubg=listed(rows).upper)
        assert solver.stats()["success"]
        assert found["g"].full().min() >= 0.1 - 1e-7
    assert crossing >= 2


def test_labels_bounds_and_constants():
    plant = excavator()
    asked = {
        "distance": 0.2,
        "bodies": ["stick"],
        "ground": -0.5,
        "obstacles": [{"kind": "sphere", "center": [2, 1], "radius": 1}],
    }
    rows = build_constraints(plant, read_constraints({"clearance": asked}))
    assert listed(rows).labels == (
        "clearance of stick (start) from ground",
        "clearance of stick (end) from ground",
        "clearance of stick from obstacle 1",
    )
    assert listed(rows).units == ("m",) * 3
    assert (listed(rows).lower == 0.2).all()
    assert np.isinf(listed(rows).upper).all()
    assert (listed(rows).scales == 1.0).all()
    assert rows.constants.full().ravel().tolist() == [-0.5, 2.0, 1.0, 1.0]


def test_a_capsule_of_a_welded_link_is_called_as_that_link(tmp_path):
    """`bracket` is welded to `boom_link`, whose body both are; `boom_link` itself keeps its name."""
    ends = {"start": [0.0, 0.0, 0.0], "end": [0.4, 0.0, 0.0], "radius": 0.1}
    links = ["chassis", "boom_link", "bracket", "bracket"]
    machine = URDF_MACHINE | {"capsules": [ends | {"link": link} for link in links]}
    tree = read(tmp_path, URDF, machine)
    assert [capsule.body for capsule in tree.capsules] == ["chassis", "boom_link", "boom_link", "boom_link"]
    names = [f"bracket capsule {k}" for k in (1, 2)]

    def rows(**asked):
        return listed(build_constraints(build_plant(tree), read_constraints(asked))).labels

    clear = {"distance": 0.1, "ground": 0.0}
    of = {
        word: tuple(f"clearance of {name} ({end}) from ground" for name in kept for end in ("start", "end"))
        for word, kept in (("boom_link", ["boom_link", *names]), ("bracket", names))
    }
    assert rows(clearance=clear) == of["boom_link"]
    # By the body all that is part of it keeps clear, by the link what is on that alone.
    for word, expected in of.items():
        assert rows(clearance=clear | {"bodies": [word]}) == expected
    apart = tuple(f"self-clearance of {name} from chassis" for name in ["boom_link", *names] for _ in range(2))
    assert rows(self_clearance=0.1) == apart
    assert "label" not in tree.to_dict()["capsules"][1]
    boxed = changed_text(
        URDF,
        '<link name="bracket">',
        '<link name="bracket"><collision><geometry><sphere radius="0.2"/></geometry></collision>',
    )
    assert [capsule.called for capsule in read(tmp_path, boxed, URDF_MACHINE | {"capsules": "collision"}).capsules] == [
        "bracket"
    ]
