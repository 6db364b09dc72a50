"""Every other kind of constraint on machines in the plane and in space: MuJoCo, Pinocchio, Shapely and NumPy."""

from __future__ import annotations

import math
from itertools import combinations

import casadi as ca
import mujoco
import numpy as np
import pytest
import shapely

from flexopt.algebra import determinant
from flexopt.errors import InputError, ModelError
from flexopt.model import load, machine_from_dict
from flexopt.model.constraints import read_constraints
from flexopt.model.tree import tree_from_dict
from flexopt.plant import build_plant
from flexopt.selection.constraints import build_constraints, constraint_faults
from flexopt.selection.constraints.convex_pieces import convex_pieces, pockets
from tests.oracles.machines import random_machine
from tests.oracles.mujoco_chain import mujoco_chain
from tests.oracles.spatial import grounded, mujoco_tree, pinocchio_tree, random_tree
from tests.selection.constraints.scenes import at_rest, listed, random_capsules, random_obstacles
from tests.selection.constraints.test_polygon_distance import comb, star


def of(plant, table, base, posture):
    """The rows of a table, their values for a solver and their values for people."""
    rows = build_constraints(plant, read_constraints(table))
    arguments = (base, posture, plant.parameter_values, rows.constants)
    return rows, rows.function(*arguments).full().ravel(), rows.report(*arguments).full().ravel()


def excavator(**more):
    return build_plant(machine_from_dict(load("excavator").to_dict() | more))


@pytest.mark.parametrize("n", range(1, 7))
def test_determinants(n):
    symbol = ca.SX.sym("a", n, n)
    function = ca.Function("det", [symbol], [determinant(symbol)])
    matrix = np.random.default_rng(n).normal(size=(n, n))
    assert float(function(matrix)) == pytest.approx(np.linalg.det(matrix), rel=1e-12)


@pytest.mark.parametrize("seed", range(12))
def test_manipulability_is_the_product_of_singular_values(seed):
    rng = np.random.default_rng(seed)
    rows = ("x", "y", "z", "roll", "pitch", "yaw")[: 1 + seed % 6]
    data = random_tree(seed, rows=rows, counts=(2, len(rows) + seed % 2))
    plant = build_plant(tree_from_dict(data))
    base, posture = rng.uniform(-2, 2, 3), rng.uniform(-2, 2, plant.n_actuated)
    _, jacobian, _ = pinocchio_tree(data).task(at_rest(plant, base, posture), base)
    expected = np.prod(np.linalg.svd(jacobian[:, plant.n_passive :], compute_uv=False))
    found, g, reported = of(plant, {"manipulability": 0.25}, base, posture)
    assert reported[0] == pytest.approx(expected, rel=1e-9)
    # Both forms meet the bound at once.
    assert g[0] == pytest.approx(expected**2 / 0.25, rel=1e-9)
    assert listed(found).lower.tolist() == [0.25]


def test_manipulability_at_a_singular_posture():
    plant = excavator()
    rows = build_constraints(plant, read_constraints({"manipulability": 0.5}))
    assert listed(rows).units == ("m^2",)
    q = ca.SX.sym("q", 2)
    g = rows.function(0.0, q, plant.parameter_values, rows.constants)
    function = ca.Function("g", [q], [g, *ca.hessian(g, q)])
    assert all(np.isfinite(part.full()).all() for part in function.call([ca.DM([0.3, 0.0])]))


@pytest.mark.parametrize("seed", range(12))
def test_tip_over_margin_in_space(seed):
    """The least row is the distance of MuJoCo's centre of mass from the polygon's outline, in the anchor frame."""
    rng = np.random.default_rng(seed)
    data = random_tree(seed) if seed % 2 else grounded(3, seed, coupled=False)
    data["placement"] = [("x", "y", "yaw"), ("x", "y"), ("yaw", "x")][seed % 3]
    angles = np.sort(rng.uniform(0, 2 * math.pi, 5))
    polygon = (4 * np.stack([np.cos(angles), np.sin(angles)], axis=1)).tolist()
    data["support"] = {"polygon": polygon}
    plant = build_plant(tree_from_dict(data))
    base, posture = rng.uniform(-2, 2, plant.n_base), rng.uniform(-2, 2, plant.n_actuated)
    chain = mujoco_tree(data)
    q = at_rest(plant, 0 * base, posture)
    chain.set(q, np.zeros_like(q))
    mujoco.mj_comPos(chain.model, chain.data)
    centre, outline = shapely.Point(chain.data.subtree_com[0][:2]), shapely.Polygon(polygon)
    rows, g, _ = of(plant, {"tip_over_margin": 0.4}, base, posture)
    assert len(rows) == 5
    assert (listed(rows).lower == 0.4).all()
    assert (g.min() > 0) == outline.contains(centre)
    if g.min() > 0:
        assert g.min() == pytest.approx(outline.exterior.distance(centre), abs=1e-12)
    else:  # outside, beside an edge or at a corner: the distance from a line is no more than that from the polygon
        assert -g.min() <= outline.distance(centre) + 1e-12
    assert g == pytest.approx([distance_from_line(centre, a, b) for a, b in edges(polygon)], abs=1e-12)


def edges(polygon):
    return list(zip(polygon, [*polygon[1:], polygon[0]], strict=True))


def distance_from_line(point, a, b):
    (ax, ay), (bx, by) = a, b
    return ((bx - ax) * (point.y - ay) - (by - ay) * (point.x - ax)) / math.hypot(bx - ax, by - ay)


@pytest.mark.parametrize("seed", range(8))
def test_tip_over_margin_and_holding_in_the_plane(seed):
    rng = np.random.default_rng(seed)
    data, _ = random_machine(rng)
    data["support"] = {"span": [-2.0, 2.5]}
    for link in data["links"]:
        if not link.get("passive"):
            link["effort"] = float(rng.uniform(1e3, 1e4))
    plant = build_plant(machine_from_dict(data))
    base, posture = 1.3, rng.uniform(-3, 3, plant.n_actuated)
    q = at_rest(plant, base, posture)
    chain = mujoco_chain(data, base)
    chain.set(q, np.zeros_like(q), gravity=data["gravity"])
    rows, g, _ = of(plant, {"tip_over_margin": 0.3, "holding": 0.7}, base, posture)
    x = chain.data.subtree_com[0][0] - base
    assert listed(rows).labels[:2] == ("tip-over margin from x = -2", "tip-over margin from x = 2.5")
    assert g[:2] == pytest.approx([x + 2.0, 2.5 - x], abs=1e-12)
    torque = chain.bias()[plant.n_passive :]
    assert g[2:] == pytest.approx(torque, rel=1e-10, abs=1e-10 * np.abs(torque).max())
    efforts = [link["effort"] for link in data["links"] if not link.get("passive")]
    assert listed(rows).upper[2:] == pytest.approx([0.7 * effort for effort in efforts])
    assert listed(rows).lower[2:] == pytest.approx([-0.7 * effort for effort in efforts])
    assert listed(rows).scales[2:].tolist() == efforts


@pytest.mark.parametrize("seed", range(8))
def test_holding_in_space(seed):
    rng = np.random.default_rng(seed)
    data = random_tree(seed, rows=("x",), counts=(2, 5))
    driven = [body for body in data["bodies"] if not body["joint"].get("passive")]
    for body in driven[1:]:
        body["joint"]["effort"] = 50.0
    plant = build_plant(tree_from_dict(data))
    base, posture = rng.uniform(-1, 1, 3), rng.uniform(-2, 2, plant.n_actuated)
    rows, g, _ = of(plant, {"holding": 1.0}, base, posture)
    weight = pinocchio_tree(data).gravity(at_rest(plant, base, posture))
    # The joint without an effort gives no row.
    assert g == pytest.approx(weight[plant.n_passive + 1 :], rel=1e-10, abs=1e-9)
    units = {"hinge": "N m", "slide": "N"}
    assert listed(rows).units == tuple(units[body["joint"]["kind"]] for body in driven[1:])
    assert listed(rows).labels == tuple(f"holding of {body['joint']['name']}" for body in driven[1:])


@pytest.mark.parametrize(("low", "high"), [(-2.0, -1.0), (3.0, 3.5), (-0.2, 0.2), (-7.0, -6.0), (0.1, 6.2), (1.0, 1.0)])
def test_tool_angle_does_not_care_for_turns(low, high):
    plant = excavator()
    rest = load("excavator").base.rest_angle
    for angle in np.linspace(-9, 9, 181):
        rows, g, _ = of(plant, {"tool_angle": [low, high]}, 0.0, [0.4, angle - rest - 0.4])
        assert (g[0] - angle) / (2 * math.pi) == pytest.approx(round((g[0] - angle) / (2 * math.pi)), abs=1e-12)
        turns = [angle + 2 * math.pi * k for k in range(-4, 5)]
        allowed = any(low <= turned <= high for turned in turns)
        if min(abs(turned - end) for turned in turns for end in (low, high)) > 1e-9:
            assert (listed(rows).lower[0] <= g[0] <= listed(rows).upper[0]) == allowed
    assert (listed(rows).lower[0], listed(rows).upper[0], listed(rows).units[0]) == (low, high, "rad")


def test_tool_angle_is_a_straight_line_in_the_joints():
    plant = excavator()
    rows = build_constraints(plant, read_constraints({"tool_angle": 3.0}))
    q = ca.SX.sym("q", 2)
    slope = ca.Function("s", [q], [ca.jacobian(rows.function(0.0, q, plant.parameter_values, rows.constants), q)])
    for posture in ([0.0, 0.0], [3.0, -1.2451], [1.0, 2.0]):
        assert np.abs(slope(posture).full() - 1).max() <= 1e-14


@pytest.mark.parametrize("seed", range(8))
def test_tool_angle_in_space(seed):
    rng = np.random.default_rng(seed)
    data = random_tree(seed)
    plant = build_plant(tree_from_dict(data))
    base, posture = rng.uniform(-2, 2, 3), rng.uniform(-2, 2, plant.n_actuated)
    _, rotation = pinocchio_tree(data).frame(at_rest(plant, base, posture), base)
    expected = math.atan2(rotation[2, 0], rotation[2, 2])
    _, g, _ = of(plant, {"tool_angle": [-0.1, 0.1]}, base, posture)
    assert g[0] == pytest.approx(expected, abs=1e-12)


def test_tool_angle_with_the_second_axis_vertical():
    """A hinge about a horizontal axis turns it upright: the row has a value and derivatives."""
    data = grounded(1, 0, coupled=False)
    data["bodies"][-1]["joint"]["axis"] = [1.0, 0.0, 0.0]
    data["end_point"]["rows"] = ["z"]
    plant = build_plant(tree_from_dict(data))
    rows = build_constraints(plant, read_constraints({"tool_angle": [0.5, 1.0]}))
    q = ca.SX.sym("q", 1)
    g = rows.function(np.zeros(3), q, plant.parameter_values, rows.constants)
    function = ca.Function("g", [q], [g, *ca.hessian(g, q)])
    for angle in (math.pi / 2, -math.pi / 2, 0.3):
        assert all(np.isfinite(part.full()).all() for part in function.call([ca.DM(angle)]))
    assert float(function(math.pi / 2)[0]) == 0.75


@pytest.mark.long
def test_areas_in_space():
    data = grounded(3, 0, coupled=False)
    plant = build_plant(tree_from_dict(data))
    first, second = [[0, 0], [4, 0], [4, 3], [2, 1], [0, 3]], [[6, 0], [6, 2], [8, 2], [8, 0]]
    hole = [[1, 0.2], [2, 0.2], [1.5, 0.6]]
    rng = np.random.default_rng(0)
    one, other, out = (shapely.Polygon(corners) for corners in (first, second, hole))
    for _ in range(200):
        base = [*rng.uniform([-1, -1], [9, 4]), rng.uniform(-3, 3)]
        rows, g, reported = of(plant, {"region": [first, second], "keep_out": [hole]}, base, np.zeros(3))
        at = shapely.Point(base[:2])
        expected = [max(signed(one, at), signed(other, at)), -signed(out, at)]
        for name, value in zip(dict.fromkeys(listed(rows).labels), expected, strict=True):
            of_name = np.array(listed(rows).labels) == name
            assert reported[of_name] == pytest.approx(value, abs=1e-12)
            assert (g[of_name].min() >= 0) == (value >= 0)
    assert set(listed(rows).labels) == {"distance inside region", "distance from keep_out[0]"}
    assert (listed(rows).lower == 0).all()


def placed(corners, base):
    x, y, yaw = base
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    return shapely.Polygon(np.array(corners) @ turn.T + [x, y])


@pytest.mark.long("2", "4", "5", "0", "3", "6", "7")
@pytest.mark.parametrize("seed", range(8))
def test_the_whole_footprint_in_and_off_areas(seed):
    """Of random supports and areas, convex or not: Shapely's `contains` and distances."""
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0, 2 * math.pi, 3 + seed % 3))
    while np.diff([*angles, angles[0] + 2 * math.pi]).max() > 3:
        angles = np.sort(rng.uniform(0, 2 * math.pi, 3 + seed % 3))
    support = (rng.uniform(0.2, 0.8) * np.stack([np.cos(angles), np.sin(angles)], axis=1)).tolist()
    areas = [star(rng, n) for n in (3, 7, 12)] + [comb(2)]
    plant = build_plant(tree_from_dict(grounded(3, 0, coupled=False) | {"support": {"polygon": support}}))
    asked = [({"region": [area]}, {"keep_out": [area]}) for area in areas]
    built = [[build_constraints(plant, read_constraints(table)) for table in pair] for pair in asked]
    found = np.zeros(3, dtype=int)
    for area, (inside, outside) in zip(areas, built, strict=True):
        polygon, middle = shapely.Polygon(area), np.mean(area, axis=0)
        for _ in range(80):
            base = [*(middle + rng.uniform(-2, 2, 2)), rng.uniform(-3, 3)]
            foot = placed(support, base)
            given = (base, np.zeros(3), plant.parameter_values)
            within, off = (rows.report(*given, rows.constants).full().min() for rows in (inside, outside))
            for rows, value in ((inside, within), (outside, off)):
                assert (rows.function(*given, rows.constants).full().min() >= 0) == (value >= 0)
            if polygon.contains(foot):
                assert within == pytest.approx(polygon.exterior.distance(foot), abs=1e-12)
            else:
                assert within < 0
            if polygon.disjoint(foot):
                assert off == pytest.approx(polygon.distance(foot), abs=1e-12)
            else:
                assert off < 0
            found += [polygon.contains(foot), polygon.disjoint(foot), 1]
    assert 0 < found[0] < found[2]
    assert 0 < found[1] < found[2]


def test_a_footprint_in_one_of_several_areas():
    """Each corner may not lie in another one: the best of the areas counts."""
    support = [[-1, -0.5], [1, -0.5], [1, 0.5], [-1, 0.5]]
    plant = build_plant(tree_from_dict(grounded(3, 0, coupled=False) | {"support": {"polygon": support}}))
    two = [[[0, 0], [3, 0], [3, 3], [0, 3]], [[3.1, 0], [9, 0], [9, 3], [3.1, 3]]]
    for base, expected in [((1.5, 1.5, 0.0), 0.5), ((3.05, 1.5, 0.0), -1.05), ((6.0, 1.0, math.pi / 2), 0.0)]:
        rows, g, reported = of(plant, {"region": two}, base, np.zeros(3))
        assert set(listed(rows).labels) == {"distance inside region"}
        assert reported[0] == pytest.approx(expected, abs=1e-12)
        assert g[0] == pytest.approx(expected, abs=1e-12)


def turned(corners, angle, away):
    c, s = math.cos(angle), math.sin(angle)
    return (np.array(corners) @ np.array([[c, s], [-s, c]]) + away).tolist()


def test_between_the_convex_pieces_of_an_area_a_point_is_in_it():
    """On their cuts it is off each of them, and still where it may not be: Shapely's word."""
    plant = build_plant(tree_from_dict(grounded(3, 0, coupled=False)))
    shape = [[-9, -9], [9, -9], [9, 0], [0, 0], [0, 9], [-9, 9]]
    open_above = [[0, 0], [9, 0], [9, 9], [7, 9], [7, 3], [2, 3], [2, 9], [0, 9]]
    for corners, pieces, kind in (
        (shape, convex_pieces(shape), "keep_out"),
        (open_above, pockets(open_above), "region"),
    ):
        rows, polygon = build_constraints(plant, read_constraints({kind: [corners]})), shapely.Polygon(corners)
        ends = [(np.array(a), np.array(b)) for piece in pieces for a, b in combinations(piece, 2)]
        seen = set()
        for a, b in ends:
            for share in (0.3, 0.5):
                at = a + share * (b - a)
                g = rows.function([*at, 0.4], np.zeros(3), plant.parameter_values, rows.constants).full().min()
                value = signed(polygon, shapely.Point(at)) * (1 if kind == "region" else -1)
                if abs(value) > 1e-9:
                    assert (g >= 0) == (value > 0)
                    seen.add(value > 0)
        assert False in seen


# Its left edge as one, with a corner in the middle that decimals put a little off the line, and far from the origin.
LEFTS = [([], 0.0), ([[0.0, 3.1], [0.0, 1.3]], 0.0), ([[-1e-16, 2.0]], 0.0), ([], 5e5)]


@pytest.mark.parametrize(("left", "far"), LEFTS, ids=["plain", "straight", "nearly straight", "far"])
@pytest.mark.parametrize("seed", range(4))
def test_rows_tell_both_sides_of_a_kink(seed, left, far):
    """Flush with an edge, in or off an area, and in a corner: one-sided slopes of Shapely's distances."""
    rng = np.random.default_rng(seed)
    support, area = [[-1, -0.5], [1, -0.5], [1, 0.5], [-1, 0.5]], [[0, 0], [5, 0], [6, 2], [5, 4], [0, 4], *left]
    angle, away = rng.uniform(-3, 3), rng.uniform(-2, 2, 2) + far
    area, slid, apart = turned(area, angle, away), rng.uniform(-0.4, 4.4), rng.uniform(0.01, 0.3)
    plant = build_plant(tree_from_dict(grounded(3, 0, coupled=False) | {"support": {"polygon": support}}))
    polygon = shapely.Polygon(area)
    for table, place in (
        # Its rear towards the area's left edge; the ends of where they face each other belong to either.
        ({"keep_out": [area]}, (-apart - 1, slid, 0.0)),
        ({"keep_out": [area]}, (slid, -apart - 0.5, math.pi)),
        ({"region": [area]}, (1 + apart, 0.5 + apart, 0.0)),
        ({"region": [area]}, (3.0, 0.5 + apart, math.pi)),
        ({"region": [area], "holds": "point"}, (apart, apart, 0.0)),
    ):
        base = np.array([*(turned([place[:2]], angle, away)[0]), place[2] + angle])
        rows = build_constraints(plant, read_constraints(table))
        x = ca.SX.sym("x", 3)
        g = rows.function(x, np.zeros(3), plant.parameter_values, rows.constants)
        value, slopes = (part.full() for part in ca.Function("g", [x], [g, ca.jacobian(g, x)]).call([ca.DM(base)]))
        least, rounding = value.min(), 1e-15 * (1 + far)
        assert least == pytest.approx(apart, abs=1e-12 + rounding)
        active = slopes[value.ravel() <= least + 1e-9 + 10 * rounding]

        def exact(at, table=table):
            held = shapely.Point(at[:2]) if "holds" in table else placed(support, at)
            return polygon.distance(held) if "keep_out" in table else polygon.exterior.distance(held)

        for way in rng.normal(size=(20, 3)):
            # Second derivatives are at most some 1 / apart.
            step = 1e-6 if far == 0 else 1e-4
            change = (exact(base + step * way) - exact(base)) / step
            assert change == pytest.approx((active @ way).min(), abs=1e-3 if far == 0 else 0.05)


def test_the_word_for_a_point():
    support = [[-1, -0.5], [1, -0.5], [1, 0.5], [-1, 0.5]]
    data = grounded(3, 0, coupled=False)
    plant = build_plant(tree_from_dict(data | {"support": {"polygon": support}}))
    area = [[0, 0], [4, 0], [4, 4], [0, 4]]
    table = {"region": [area], "keep_out": [area]}
    bare = build_plant(tree_from_dict(data))
    for machine, more in ((plant, {"holds": "point"}), (bare, {}), (bare, {"holds": "point"})):
        rows, g, _ = of(machine, table | more, (1.0, 2.0, 0.3), np.zeros(3))
        # Of a region the two nearest edges.
        assert listed(rows).labels == ("distance inside region",) * 2 + ("distance from keep_out[0]",)
        assert g == pytest.approx([1.0, 2.0, -1.0], abs=1e-15)
    rows, g, _ = of(plant, table, (1.0, 2.0, 0.0), np.zeros(3))
    assert listed(rows).labels[0] == "distance inside region of corner (-1, -0.5)"
    assert g == pytest.approx([0.0, 1.5, 1.5, 2.0, 1.5, 2.0, 0.0, 1.5, -2.0, -2.0], abs=1e-15)
    with pytest.raises(InputError, match=r"holds = 'footprint': needs what the undercarriage stands on"):
        build_constraints(bare, read_constraints(table | {"holds": "footprint"}))
    with pytest.raises(ModelError, match="holds = 'feet'"):
        read_constraints({"holds": "feet"})


def test_the_footprint_in_the_plane():
    plant = excavator(support={"span": [-1.0, 2.0]})
    table = {"region": [[-2.0, 4.0]], "keep_out": [[6.0, 7.0]]}
    for x, inside, outside in [
        (0.0, 1.0, 4.0),
        (-1.5, -0.5, 5.5),
        (3.0, -1.0, 1.0),
        (7.5, -5.5, -0.5),
        (9.0, -7.0, 1.0),
    ]:
        rows, g, _ = of(plant, table, x, [0.1, 0.2])
        assert g == pytest.approx([inside, outside], abs=1e-15)
        assert of(plant, table | {"holds": "point"}, x, [0.1, 0.2])[1][0] == pytest.approx(min(x + 2, 4 - x))
    assert listed(rows).labels == ("distance inside region", "distance from keep_out[0]")


def signed(polygon, point):
    distance = polygon.exterior.distance(point)
    return distance if polygon.contains(point) else -distance


def test_a_direction_without_placement_stays_at_the_anchor():
    data = grounded(3, 0, coupled=False) | {"placement": ["y"]}
    plant = build_plant(tree_from_dict(data))
    _, g, _ = of(plant, {"region": [[[-1, 0], [1, 0], [1, 4], [-1, 4]]]}, [3.5], np.zeros(3))
    assert g[0] == pytest.approx(0.5, abs=1e-15)


def test_areas_in_the_plane():
    plant = excavator()
    for x, inside, outside in [(-2.0, -1.0, 3.0), (-0.5, 0.5, 1.5), (2.5, -0.5, -0.5), (3.5, 0.5, 0.5)]:
        _, g, _ = of(plant, {"region": [[-1.0, 2.0], [3.0, 5.0]], "keep_out": [[1.0, 3.0]]}, x, [0.1, 0.2])
        assert g.tolist() == [inside, outside]


def everything(d: int):
    rng = np.random.default_rng(4)
    polygon = [[-4, -4], [4, -4], [4, 4], [0, 1], [-4, 4]]
    table = {"manipulability": 0.1, "tip_over_margin": 0.1, "holding": 0.5, "tool_angle": [0.1, 0.5]}
    table["self_clearance"] = 0.1
    table["clearance"] = {"distance": 0.1, "ground": 0.0, "obstacles": random_obstacles(rng, d, 2.0)}
    return table | {"region": [[-4, 4]] if d == 2 else [polygon], "keep_out": [[1, 2]] if d == 2 else [polygon]}


def full_machines():
    rng = np.random.default_rng(5)
    flat = load("excavator").to_dict() | {"support": {"span": [-1.8, 1.9]}}
    flat["capsules"] = random_capsules(rng, ["base", "boom", "stick"], 2)
    flat["links"] = [link | {"effort": 1e5} for link in flat["links"]]
    space = grounded(4, 0) | {"support": {"polygon": [[-2, -1], [2, -1], [2, 1], [-2, 1]]}}
    space["capsules"] = random_capsules(rng, ["chassis", "arm0", "arm2", "arm3"], 3)
    for body in space["bodies"][6:]:
        body["joint"]["effort"] = 1e5
    return {2: machine_from_dict(flat), 3: tree_from_dict(space)}


@pytest.mark.parametrize("d", [2, 3])
def test_derivatives_of_all_rows_together(d):
    plant = build_plant(full_machines()[d])
    rows = build_constraints(plant, read_constraints(everything(d)))
    z = ca.SX.sym("z", plant.n_base + plant.n_actuated)
    g = rows.function(z[: plant.n_base], z[plant.n_base :], plant.parameter_values, rows.constants)
    scaled = g / listed(rows).scales
    function = ca.Function("g", [z], [scaled, ca.jacobian(scaled, z)])
    hessian = ca.Function("h", [z], [ca.hessian(ca.sum1(scaled), z)[0]])
    rng = np.random.default_rng(0)
    errors = []
    for _ in range(40):
        at = rng.uniform(-1.5, 1.5, z.shape[0])
        numeric = [(function(at + e)[0] - function(at - e)[0]).full().ravel() / 2e-6 for e in 1e-6 * np.eye(at.size)]
        jacobian = function(at)[1].full()
        errors.append((np.abs(jacobian - np.array(numeric).T).max(axis=1) / (1 + np.abs(jacobian).max(axis=1))).max())
    assert np.quantile(errors, 0.9) <= 1e-7
    for at in (np.zeros(z.shape[0]), np.round(rng.uniform(-1, 1, z.shape[0])), np.full(z.shape[0], math.pi / 2)):
        assert np.isfinite(function(at)[1].full()).all()
        assert np.isfinite(hessian(at).full()).all()


def test_problems_of_one_structure_share_their_functions():
    plant = build_plant(full_machines()[3])
    table = everything(3)
    one = build_constraints(plant, read_constraints(table))
    table["clearance"]["obstacles"][0] |= {"center": [9.0, 0.0, 0.0], "name": "silo"}
    other = build_constraints(plant, read_constraints(table | {"manipulability": 0.2, "tool_angle": [0.3, 0.9]}))
    assert one.function is other.function
    assert one.report is other.report
    assert one.structure == other.structure
    assert one.constants.full().tolist() != other.constants.full().tolist()
    assert any("silo" in label for label in listed(other).labels)
    less = build_constraints(plant, read_constraints({"manipulability": 0.2}))
    assert less.function is not one.function
    assert hash(less.structure) is not None


def test_nothing_asked_for_gives_no_rows():
    plant = excavator()
    rows = build_constraints(plant, read_constraints({"joint_margin": 0.1, "travel": {"cost": 0.1}}))
    assert len(rows) == 0
    assert rows.function(0.0, [0.0, 0.0], plant.parameter_values, rows.constants).shape == (0, 1)


def test_what_a_machine_lacks_is_named_all_at_once():
    table = {"tip_over_margin": 0.1, "holding": 0.5, "clearance": {"distance": 0.1, "ground": 0.0}}
    with pytest.raises(InputError) as caught:
        build_constraints(excavator(), read_constraints(table | {"region": [[[0, 0], [1, 0], [0, 1]]]}))
    sentences = {fault.field: fault.sentence for fault in caught.value.faults}
    assert sorted(sentences) == ["clearance", "holding", "region[0]", "tip_over_margin"]
    assert "[[capsules]]" in sentences["clearance"]
    assert "effort (N m or N)" in sentences["holding"]
    assert "boom, stick" in sentences["holding"]
    assert "[support] span = [rear, front]" in sentences["tip_over_margin"]
    assert "an interval [lower, upper] of x" in sentences["region[0]"]
    tree = build_plant(tree_from_dict(grounded(3, 0) | {"placement": ["yaw"]}))
    faults = {f.field: f.sentence for f in constraint_faults(tree, read_constraints(table | {"region": [[0, 1]]}))}
    assert "polygon = [[x, y], …]" in faults["tip_over_margin"]
    assert "is not placed by x or y" in faults["region"]


def test_bodies_and_obstacles_that_do_not_suit():
    machines = full_machines()
    asked = {
        "distance": 0.1,
        "bodies": ["bom", "chassis"],
        "obstacles": [{"kind": "sphere", "center": [1, 2, 3], "radius": 1}],
    }
    with pytest.raises(InputError) as caught:
        build_constraints(build_plant(machines[2]), read_constraints({"clearance": asked}))
    text = str(caught.value)
    assert "did you mean 'boom'?" in text
    assert "clearance.obstacles[0].center = [1.0, 2.0, 3.0]: must be two numbers [x, y]" in text
    assert "excavator has no body of that name; valid here: base, boom, stick" in text
    # A machine file in space stands around a robot file, and calls it a link.
    with pytest.raises(InputError, match=r"link = 'arm1' to the machine file"):
        build_constraints(build_plant(machines[3]), read_constraints({"clearance": asked | {"bodies": ["arm1"]}}))
    with pytest.raises(InputError, match="give ground"):
        build_constraints(build_plant(machines[3]), read_constraints({"clearance": {"distance": 0.1}}))


def test_no_two_obstacles_are_called_alike():
    """What has no name is called by its number, and the ground the ground: one would hide the other in results."""
    plant = build_plant(full_machines()[2])
    ball = {"kind": "sphere", "center": [8, 5], "radius": 0.5}
    for more, obstacles in (
        ({}, [ball, ball | {"name": "obstacle 1"}]),
        ({"ground": 0.0}, [ball | {"name": "ground"}]),
    ):
        asked = read_constraints({"clearance": {"distance": 0.1, "obstacles": obstacles} | more})
        with pytest.raises(InputError, match=r"clearance.obstacles = '\S+.*names must differ"):
            build_constraints(plant, asked)
    apart = {"distance": 0.1, "ground": -1.0, "obstacles": [ball, ball, ball | {"name": "pole"}]}
    rows = build_constraints(plant, read_constraints({"clearance": apart}))
    assert len(set(listed(rows).labels)) == len(listed(rows).labels)
