"""Pictures of machines in space: what is drawn lies where the machine is."""

import io
import math
import warnings
from itertools import product

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch, Polygon
from matplotlib.path import Path
from matplotlib.transforms import Affine2D
from PIL import Image
from shapely import LineString, MultiPoint, Point, box
from shapely import Polygon as Area

import flexopt
from flexopt.foundation.palette import colors
from flexopt.model.constraints import Constraints, read_constraints
from flexopt.model.tree import tree_from_dict
from flexopt.plant import build_plant
from flexopt.plotting.scene import Actor, draw_scene, draw_views
from flexopt.plotting.scenery import draw_scenery, name_obstacles, scenery_points
from flexopt.plotting.several import view_of_way
from flexopt.plotting.shape import Shape, View, capsule_outline, shape_at, shape_of, views
from flexopt.plotting.trajectory import deflection_panel
from tests.oracles.spatial import grounded, in_space, pinocchio_tree, random_tree
from tests.plotting.looking import faults

pytestmark = pytest.mark.filterwarnings("ignore::flexopt.errors.CompilerNotFound")
LIMITS = np.array([[-5.0, 5.0], [-5.0, 5.0]])  # of a picture, m
CAPSULES = [
    {"body": "base.rotation", "start": [-0.2, 0.3, 0.1], "end": [0.4, -0.3, 0.1], "radius": 0.25},
    {"body": "stick", "start": [0.0, 0.0, 0.0], "end": [1.0, 0.0, 0.0], "radius": 0.1},
]


@pytest.mark.long
def test_the_names_of_a_target_and_of_an_obstacle_beside_it_are_apart():
    """The target is before a wall whose middle is as high as it."""
    wall = {"name": "wall", "kind": "box", "center": [0.45, 1.7], "size": [0.3, 2.0]}
    asked = {"clearance": {"distance": 0.05, "obstacles": [wall], "bodies": ["boom"]}}
    data = flexopt.load("excavator").to_dict()
    data |= {"capsules": [{"body": "boom", "start": [0.0, 0.0], "end": [1.9, 0.0], "radius": 0.05}]}
    machine = flexopt.machine_from_dict(data)
    selection = flexopt.select(machine, (0.0, 1.6), base=0.0, starts=4, constraints=asked)
    figure = selection.plot()
    assert {"target", "wall"} <= {text.get_text() for text in figure.axes[0].texts}
    assert faults(figure) == []


@pytest.mark.parametrize("point", [[0.0, 0.0], [0.2, 1.6], [0.2, 1.0]])
def test_the_name_of_a_half_plane_that_the_target_lies_on_is_beside_the_targets(point):
    """Wherever on its border the point lies that a file gives: the name goes along the border, out of the way."""
    face = {"name": "face", "kind": "half_plane", "point": point, "normal": [-1.0, 0.0]}
    asked = {"clearance": {"distance": 0.01, "obstacles": [face], "bodies": ["boom"]}}
    data = flexopt.load("excavator").to_dict()
    data |= {"capsules": [{"body": "boom", "start": [0.0, 0.0], "end": [0.5, 0.0], "radius": 0.05}]}
    target = (point[0], 1.6 if point[1] else 0.4)
    selection = flexopt.select(
        flexopt.machine_from_dict(data), target, base=-1.0, base_range=(-3.0, -0.8), starts=2, constraints=asked,
        assume="limits",
    )  # fmt: skip
    figure = selection.plot()
    assert {"target", "face"} <= {text.get_text() for text in figure.axes[0].texts}
    assert faults(figure) == []


@pytest.fixture(scope="module")
def machine():
    """The excavator sent through space, with volumes and ground to stand on."""
    data = in_space({"gravity": 9.81} | flexopt.load("excavator").to_dict())
    return tree_from_dict(data | {"capsules": CAPSULES, "support": {"polygon": [[-1, -1], [1, -1], [1, 1], [-1, 1]]}})


@pytest.fixture(scope="module")
def selection(machine):
    constraints = {
        "region": [[[-3.5, -1.5], [2.0, -1.5], [2.0, 1.5], [-3.5, 1.5]]],
        "clearance": {
            "distance": 0.05,
            "obstacles": [
                {"kind": "sphere", "name": "tank", "center": [4.0, 0.2, 0.5], "radius": 0.5},
                {"kind": "box", "name": "hut", "center": [-6.0, 3.0, 1.0], "size": [1.0, 2.0, 2.0], "yaw": 0.5},
            ],
        },
    }
    return flexopt.select(machine, (0.0, 1.6), base=0.0, posture=[0.9929, -2.6306], constraints=constraints, starts=3)


@pytest.mark.parametrize("seed", [0, 3])
def test_capsules_follow_their_bodies(seed):
    """Ends of capsules against Pinocchio's frames, at random coordinates and placements."""
    data = random_tree(seed, counts=(2, 3))
    rng = np.random.default_rng(seed)
    last = data["bodies"][-1]["name"]
    ends = rng.uniform(-1, 1, (2, 3))
    capsule = {"body": last, "start": ends[0].tolist(), "end": ends[1].tolist(), "radius": 0.1}
    machine = tree_from_dict(data | {"capsules": [capsule]})
    # The oracle knows the end-point's frame: put that on the capsule's end.
    q, base = rng.uniform(-1, 1, 5), rng.uniform(-1, 1, 3)
    (start, end, radius), *others = shape_at(machine, q, base).capsules
    assert not others
    assert radius == 0.1
    for point, own in ((start, ends[0]), (end, ends[1])):
        data["end_point"] |= {"body": last, "position": own.tolist()}
        # The absorbed slides of the plant count from the inertial origin; a yaw leaves none, so that both count alike.
        np.testing.assert_allclose(point, pinocchio_tree(data).frame(q, base)[0], atol=1e-12)


def test_views_are_orthogonal_projections():
    machine = tree_from_dict(grounded(3, 0))
    plant = build_plant(machine)
    q = plant.rest(np.array([0.4, -0.2, 0.3]), np.array([0.9, -0.4, 0.8]), plant.parameter_values).full().ravel()
    shape = shape_at(machine, q, np.array([0.4, -0.2, 0.3]))
    side, above = views(shape)
    for view in (side, above):
        np.testing.assert_allclose(view.axes @ view.axes.T, np.eye(2), atol=1e-15)
    tip, foot = shape.skeleton[:, -1], shape.skeleton[:, 0]
    # From the side the arm is seen in its full extent; from above the placement is where it is.
    assert side.of(tip)[0] - side.of(foot)[0] == pytest.approx(math.hypot(*(tip - foot)[:2]))
    assert side.of(tip)[1] == pytest.approx(tip[2], rel=1e-15)
    np.testing.assert_allclose(above.of(foot), [0.4, -0.2], atol=1e-15)
    assert build_plant(machine).graph.segments == shape.segments
    away = np.cross(side.axes[0], side.axes[1])
    np.testing.assert_allclose(
        side.depth(np.array([tip, foot, tip + 3 * away, tip - 2 * away]).T), [0, 0, 3, -2], atol=1e-14
    )


def drawn_box(shape, view):
    """Points (2, K) round the box that a machine stands on, m."""
    axes = Figure().subplots()
    draw_scene(axes, view, [Actor(shape, "C0")], shape.skeleton[:, -1])
    (patch,) = (each for each in axes.patches if isinstance(each, FancyBboxPatch))
    return (patch.get_transform() - axes.transData).transform_path(patch.get_path()).vertices.T


def ground_line(axes):
    """Height of the ground that is drawn, m."""
    (line,) = (each for each in axes.lines if to_hex(each.get_color()) == colors().ground_line)
    return line.get_ydata()[0]


@pytest.mark.parametrize("seed", range(3))
def test_what_a_machine_stands_on_goes_with_its_springs(seed):
    """Six springs given at random: the box against the chassis' frame in Pinocchio, and no link drawn out between them."""
    rng = np.random.default_rng(seed)
    data = grounded(3, seed) | {"placement": ["x", "y", "yaw"]}
    machine = tree_from_dict(data)
    plant = build_plant(machine)
    base, posture = rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3)
    rest = plant.rest(base, posture, plant.parameter_values).full().ravel()
    sagged = rest + np.append(rng.uniform(-0.4, 0.4, 6), np.zeros(3))
    unloaded, shape = shape_at(machine, rest, base), shape_at(machine, sagged, base)
    data["end_point"] |= {"body": "chassis", "position": [0.0, 0.0, 0.0]}
    chassis = pinocchio_tree(data)
    (there, straight), (here, turned) = (chassis.frame(q, base) for q in (rest, sagged))
    side = views(unloaded)[0]
    before = drawn_box(unloaded, side)
    points = side.axes.T @ before
    away = np.cross(side.axes[0], side.axes[1])
    points += away[:, None] * (away @ unloaded.foot)
    moved = here[:, None] + turned @ straight.T @ (points - there[:, None])
    # Rounding, of some metres.
    np.testing.assert_allclose(drawn_box(shape, side), side.of(moved), atol=1e-9)
    assert shape.size == pytest.approx(unloaded.size, rel=1e-12)


def test_what_a_planar_machine_stands_on_goes_with_its_springs():
    """By the planar rotation and shift that its three coordinates are; the ground stays."""
    machine = flexopt.load("excavator")
    plant = build_plant(machine)
    base, sag = np.array([0.7]), np.array([0.1, -0.2, 0.15])
    rest = plant.rest(base, np.array([0.9929, -2.6306]), plant.parameter_values).full().ravel()
    unloaded, shape = shape_at(machine, rest, base), shape_at(machine, rest + np.append(sag, [0.0, 0.0]), base)
    (view,) = views(unloaded)
    turn = Affine2D().rotate_around(0.7, 0.0, sag[2]).translate(*sag[:2])
    expected = turn.transform(drawn_box(unloaded, view).T).T
    np.testing.assert_allclose(drawn_box(shape, view), expected, atol=1e-12)
    axes = Figure().subplots()
    draw_scene(axes, view, [Actor(shape, "C0")], shape.skeleton[:, -1])
    assert ground_line(axes) == 0.0


@pytest.mark.parametrize("word", ["assumed", "unknown", "asked", "supported"])
def test_the_ground_is_drawn_where_clearances_are_kept_from_it(word):
    """A hull that reaches 0.3 m below its frame, sagged by 0.5 m; where the target is below ground none is assumed."""
    data = grounded(3, 0) | {"placement": ["x", "y", "yaw"]}
    hull = {"body": "chassis", "start": [-1.0, 0.0, 0.2], "end": [1.0, 0.0, 0.2], "radius": 0.5}
    data |= {"capsules": [hull, {"body": "arm1", "start": [0.0] * 3, "end": [1.9, 0.0, 0.0], "radius": 0.1}]}
    if word == "supported":
        data |= {"support": {"polygon": [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]}}
    machine = tree_from_dict(data)
    asked = {"clearance": {"distance": 0.0, "ground": -0.7}} if word == "asked" else {}
    target = (3.0, 0.0, -1.0 if word == "unknown" else 1.0)
    problem = flexopt.build_selection(
        machine, target, base=(0.0, 0.0, 0.0), constraints=asked, singularity_margin_deg=0.1
    )
    told = [assumption.value for assumption in problem.assumed if assumption.name == "ground"]
    expected = {"assumed": -0.3, "unknown": -0.3, "asked": -0.7, "supported": 0.0}[word]
    np.testing.assert_allclose(told, [expected] if word in ("assumed", "supported") else [], atol=1e-12)
    q = build_plant(machine).rest(np.zeros(3), np.array([0.1, 0.9, -1.4]), build_plant(machine).parameter_values)
    q = q.full().ravel() - 0.5 * np.eye(9)[2]
    shape = shape_at(machine, q, np.zeros(3))
    panels = Figure().subplots(2)
    draw_views(panels, [Actor(shape, "C0")], np.array(target), problem.asked)
    assert ground_line(panels[0]) == pytest.approx(expected, abs=1e-12)
    low, high = panels[0].get_ylim()
    assert low < expected < high


@pytest.mark.parametrize("seed", range(4))
def test_what_the_arms_plane_cuts_of_an_obstacle_is_solid_and_all_of_it_faint(seed: int) -> None:
    """Beside points of the plane, each inside the box or the ball by its own definition."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(-3, 3)
    view = View(
        "side", np.array([[np.cos(turn), np.sin(turn), 0], [0, 0, 1]]), ("along", "z"), True, rng.normal(size=3)
    )
    center, size, yaw, radius = rng.uniform(-0.3, 0.3, 3) + view.origin, rng.uniform(1, 3, 3), rng.uniform(-3, 3), 1.2
    obstacles = [
        {"kind": "box", "center": center.tolist(), "size": size.tolist(), "yaw": yaw},
        {"kind": "sphere", "center": center.tolist(), "radius": radius},
    ]
    u, v = rng.uniform(-3, 3, (2, 4000))
    points = view.origin[:, None] + view.axes[0][:, None] * u + view.axes[1][:, None] * v
    c, s = np.cos(yaw), np.sin(yaw)
    local = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ (points - center[:, None])
    inside = (
        np.all(abs(local) <= size[:, None] / 2, axis=0),
        np.linalg.norm(points - center[:, None], axis=0) <= radius,
    )
    for obstacle, within in zip(obstacles, inside, strict=True):
        axes = Figure().subplots()
        constraints = Constraints.model_validate({"clearance": {"distance": 0.1, "obstacles": [obstacle]}})
        draw_scenery(axes, view, constraints, 0.0, "point")
        whole, cut = (each for each in axes.get_children() if isinstance(each, Circle | Polygon))
        assert (whole.get_linestyle(), cut.get_linestyle()) == ("--", "-")
        assert whole.get_alpha() < cut.get_alpha()
        # Curves are followed to a pixel.
        large = Affine2D().scale(1e4)
        drawn, around = (
            each.get_path().transformed(each.get_patch_transform() + large).contains_points(1e4 * view.of(points).T)
            for each in (cut, whole)
        )
        assert 50 < within.sum() < 3950
        # A circle's path is one of curves: 0.03 % of its radius off.
        assert np.mean(drawn != within) < 1e-3
        assert np.all(around[within])
        assert around.sum() >= drawn.sum()


def test_capsule_outline():
    start, end = np.array([0.0, 1.0]), np.array([2.0, 2.0])
    outline = capsule_outline(start, end, 0.5)
    along = (end - start) / np.linalg.norm(end - start)
    for point in outline:
        nearest = start + along * np.clip((point - start) @ along, 0, np.linalg.norm(end - start))
        assert np.linalg.norm(point - nearest) == pytest.approx(0.5)
    ball = capsule_outline(start, start, 0.5)
    np.testing.assert_allclose(np.linalg.norm(ball - start, axis=1), 0.5)


def lines(axes):
    return {line.get_label(): line.get_xydata() for line in axes.lines}


@pytest.mark.long
def test_selection_picture(selection, tmp_path):
    figure = selection.plot(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    side, above, measures, shares, ranks = figure.axes
    best, initial, machine = selection.best.evaluation, selection.initial, selection.problem.machine
    chosen = shape_of(machine, best)
    for axes, view in zip((side, above), views(chosen), strict=True):
        outlines = [patch.get_path().vertices for patch in axes.patches if hasattr(patch, "get_xy")]
        drawn = np.vstack(outlines)
        for shape in (chosen, shape_of(machine, initial)):
            tip = view.of(shape.skeleton[:, -1])
            assert np.linalg.norm(drawn - tip, axis=1).min() < 0.2
            for start, end, radius in shape.capsules:
                outline = capsule_outline(view.of(start), view.of(end), radius)
                assert any(o.shape[0] >= len(outline) and np.allclose(o[: len(outline)], outline) for o in outlines)
        target = [line.get_xydata()[0] for line in axes.lines if line.get_marker() == "+"]
        np.testing.assert_allclose(target, [view.of(best.skeleton[:, -1])], atol=1e-7)
        (low, high), (bottom, top) = axes.get_xlim(), axes.get_ylim()
        points = view.of(chosen.skeleton)
        assert low < points[0].min()
        assert points[0].max() < high
        assert bottom < points[1].min()
        assert points[1].max() < top
    # Bars: first the chosen configuration's, then the present one's.
    heights = [[bar.get_height() for bar in axes.patches] for axes in (measures, shares)]
    # What is rounding of |a||b| is drawn as 0.
    np.testing.assert_allclose(heights[0], [*best.w, *initial.w], atol=1e-13 * best.scale.max())
    np.testing.assert_allclose(heights[1], [*(best.w / best.scale), *(initial.w / initial.scale)])
    np.testing.assert_allclose(
        [point for line in ranks.lines[:2] for point in line.get_ydata()],
        [candidate.objective for candidate in (*selection.candidates[1:], selection.candidates[0])],
    )
    assert {text.get_text() for text in side.texts} >= {"tank", "hut", "target"}
    assert "the whole footprint may stand here" in above.get_legend_handles_labels()[1]


def test_scenery_in_both_views(selection):
    chosen = shape_of(selection.problem.machine, selection.best.evaluation)
    wall = {"kind": "half_plane", "point": [3.0, 1.0, 0.0], "normal": [-1.0, 0.0, 0.0]}
    ceiling = {"kind": "half_plane", "point": [0.0, 0.0, 5.0], "normal": [0.0, 0.0, -1.0]}
    tank = {"kind": "sphere", "center": [1.0, 2.0, 3.0], "radius": 0.5}
    asked = read_constraints({"clearance": {"distance": 0.1, "obstacles": [wall, ceiling, tank]},
                              "keep_out": [[[0, 0], [1, 0], [0, 1]]]})  # fmt: skip
    for view in views(chosen):
        axes = Figure().add_subplot()
        draw_scenery(axes, view, asked, 0.0, "footprint")
        circles = [patch for patch in axes.patches if patch.__class__.__name__ == "Circle"]
        np.testing.assert_allclose(circles[0].center, view.of(np.array(tank["center"])))
        # The arm works in the plane y = 0: the tank stands beside it.
        assert (circles[0].get_linestyle() == "--") == view.upright
        edges = [patch.get_path().vertices for patch in axes.patches if patch is not circles[0]]
        assert np.isclose(edges[0][:2, 0], 3.0).all()
        # Seen from above a ceiling has no edge; an area is seen from above only.
        assert len(edges) == 2
        if view.upright:
            np.testing.assert_allclose(edges[1][:2, 1], 5.0)


@pytest.mark.parametrize("slew", [-2.5, -0.7, 0.0, 0.3, 1.6, 3.0])
def test_the_side_view_is_across_the_arms_plane_wherever_on_its_vehicle_it_stands(slew):
    """Its pedestal 2 m beside the anchor point, undercarriage at rest; the label's angle is that of the plane."""
    data = flexopt.load("slewing-excavator").to_dict()
    bodies = [dict(body) for body in data["bodies"]]
    next(body for body in bodies if body["name"] == "house")["position"] = (-1.2, 1.6, 1.0)
    machine = tree_from_dict(data | {"bodies": bodies})
    base, posture = np.array([3.0, -1.0, 0.4]), np.array([slew, 0.9, -1.9, -0.4])
    plant = build_plant(machine)
    q = plant.rest(base, posture, plant.parameter_values).full().ravel()
    shape = shape_at(machine, q, base)
    side, _ = views(shape)
    arm = shape.skeleton[:, -4:]
    np.testing.assert_allclose(side.depth(arm), 0.0, atol=1e-9)
    there = math.remainder(slew + 0.4, math.tau)
    np.testing.assert_allclose(side.axes[0], [math.cos(there), math.sin(there), 0.0], atol=1e-9)
    assert f"from x by {math.degrees(there):.0f}°".replace("-", "−") in side.labels[0]


def held_at(machine, posture):
    """The machine, its coordinates with all springs at rest, and its base at the origin."""
    plant, base = build_plant(machine), np.zeros(len(machine.base_coordinates))
    return machine, plant.rest(base, posture, plant.parameter_values).full().ravel(), base


@pytest.mark.parametrize("aside", [0.0, 0.4])
@pytest.mark.parametrize("tilt", [0.0, 1e-3, 1e-2])
@pytest.mark.parametrize("slew", [-2.0, 0.5, 1.5])
def test_an_offset_or_upright_arm_is_seen_square_to_its_hinges(slew, tilt, aside):
    """Its stick some way beside its boom: hinges are points in the side view, however little of the links is level."""
    data = flexopt.load("slewing-excavator").to_dict()
    bodies = [dict(body) for body in data["bodies"]]
    stick = next(body for body in bodies if body["name"] == "stick")
    stick["position"] = (*stick["position"][:1], aside, *stick["position"][2:])
    # The boom's foot is beside the slew: upright it is where nothing is beside that.
    next(body for body in bodies if body["name"] == "boom")["position"] = (0.0, 0.0, 1.0)
    shape = shape_at(*held_at(tree_from_dict(data | {"bodies": bodies}), [slew, math.pi / 2 - tilt, 0.0, 0.0]))
    side, _ = views(shape)
    assert shape.across is not None
    np.testing.assert_allclose(side.axes[:, :2] @ shape.across, 0.0, atol=1e-9)
    # The hinges stand across the slewed house's x axis.
    np.testing.assert_allclose(np.abs(shape.across), np.abs([math.sin(slew), math.cos(slew)]), atol=1e-9)


@pytest.mark.parametrize("lift", [0.5, 12.0])
@pytest.mark.parametrize("slew", [0.0, 0.3, 2.0])
def test_a_tool_that_rolls_along_its_boom_does_not_have_it_seen_end_on(slew, lift):
    """Slew, lift, a telescope of 1 m and a hinge along it: the side view is as wide as the boom is long."""
    car = {"name": "car", "kind": "hinge", "axis": (0, 1, 0), "passive": True, "stiffness": 1e5, "damping": 1e2}
    bodies = [{"name": "car", "parent": None, "joint": car, "mass": 500.0, "com": (0, 0, 0.5),
               "inertia": (50.0, 50.0, 50.0, 0, 0, 0)}]  # fmt: skip
    for name, kind, axis, position in (
        ("slew", "hinge", (0, 0, 1), (0, 0, 1.0)), ("lift", "slide", (0, 0, 1), (0, 0, 0.5)),
        ("tele", "slide", (1, 0, 0), (0.5, 0, 0)), ("roll", "hinge", (1, 0, 0), (1.0, 0, 0)),
    ):  # fmt: skip
        joint = {"name": name, "kind": kind, "axis": axis}
        bodies.append({"name": name, "parent": bodies[-1]["name"], "joint": joint, "position": position, "mass": 20.0,
                       "com": (0.1, 0, 0), "inertia": (2.0, 2.0, 2.0, 0, 0, 0)})  # fmt: skip
    end = {"body": "roll", "position": (0.5, 0, 0), "rows": ("x", "y", "z")}
    machine = tree_from_dict({"name": "drill", "bodies": bodies, "end_point": end, "placement": ("x",)})
    shape = shape_at(*held_at(machine, [slew, lift, 1.0, 0.2]))
    side, _ = views(shape)
    assert np.ptp(side.of(shape.skeleton)[0]) == pytest.approx(3.0)


def test_an_arm_that_points_backwards_along_x_is_seen_with_x_to_the_right():
    machine = flexopt.load("slewing-excavator")
    for slew, right in ((math.pi, 1.0), (-math.pi, 1.0), (math.pi - 0.01, -1.0)):
        side, _ = views(shape_at(*held_at(machine, [slew, 0.9, -1.9, -0.4])))
        assert side.axes[0, 0] == pytest.approx(right, abs=1e-4)
        assert side.labels[0].startswith("x, m") == (right > 0)


@pytest.mark.parametrize(("away", "aside"), [(0.1, True), (2.0, False)])
def test_a_name_of_an_obstacle_does_not_lie_on_a_target(selection, away, aside):
    tank = {"kind": "sphere", "center": [1.0, 2.0, 3.0], "radius": 0.5, "name": "tank"}
    asked = read_constraints({"clearance": {"distance": 0.1, "obstacles": [tank]}})
    for view in views(shape_of(selection.problem.machine, selection.best.evaluation)):
        axes = Figure().add_subplot()
        middle = view.of(np.array(tank["center"]))
        cross = np.add(middle, [away, 0.0])
        name_obstacles(axes, view, asked, cross[:, None], LIMITS, [])
        axes.set(xlim=LIMITS[0], ylim=LIMITS[1])
        axes.figure.draw_without_rendering()
        (name,) = axes.texts
        where, (there, mark) = name.get_window_extent(), axes.transData.transform([middle, cross])
        assert not where.contains(*mark)
        assert (math.dist(there, (where.p0 + where.p1) / 2) > 1.0) == aside


@pytest.mark.parametrize("inches", [(4.5, 5.5), (6.0, 7.8), (11.0, 14.0)])
@pytest.mark.parametrize("yaw", [0.0, 0.3])
def test_a_name_of_an_obstacle_is_on_or_beside_what_is_seen_of_it_and_not_on_the_machine(inches, yaw):
    """A wall before a machine that is small beside it, and a wire above: by their corners and the machine's."""
    data = in_space({"gravity": 9.81} | flexopt.load("excavator").to_dict())
    truck = {"body": "base.rotation", "start": [-1.5, 0.0, 0.5], "end": [1.5, 0.0, 0.5], "radius": 0.5}
    support = {"polygon": [[-1.6, -0.8], [1.6, -0.8], [1.6, 0.8], [-1.6, 0.8]]}
    machine = tree_from_dict(data | {"capsules": [truck], "support": support})
    plant = build_plant(machine)
    base = np.zeros(len(machine.base_coordinates))
    q = plant.rest(base, np.array([0.9929, -2.6306]), plant.parameter_values).full().ravel()
    shape = shape_at(machine, q, base)
    walls = {"parapet": ([0.3, 0.9, 0.2], [60.0, 0.3, 1.7]), "wire": ([0.0, 0.0, 4.0], [70.0, 0.05, 0.05])}
    asked = read_constraints({"clearance": {"distance": 0.1, "obstacles": [
        {"kind": "box", "name": name, "center": at, "size": size, "yaw": yaw} for name, (at, size) in walls.items()
    ]}, "region": [[[-20, -1.5], [20, -1.5], [20, 1.5], [-20, 1.5]]]})  # fmt: skip
    figure = Figure(figsize=inches, layout="constrained")
    panels = figure.subplots(2)
    draw_views(panels, [Actor(shape, "C0")], shape.skeleton[:, -1], asked)
    assert faults(figure) == []
    turn = Affine2D().rotate(yaw)
    for axes, view in zip(panels, views(shape), strict=True):

        def pixels(points, axes=axes, view=view):
            return axes.transData.transform(view.of(points).T)

        start, end, radius = shape.capsules[0]
        pixel = np.hypot(*(axes.transData.transform((1.0, 0.0)) - axes.transData.transform((0.0, 0.0))))
        drawn = [
            LineString(pixels(np.column_stack([start, end]))).buffer(radius * pixel),
            LineString(pixels(shape.skeleton)),
        ]
        drawn += [] if view.upright else [Area(pixels(shape.support))]
        for text in axes.texts:
            where, (at, size) = text.get_window_extent(), walls[text.get_text().split(", ")[0]]
            name = box(*where.extents)
            corners = np.array(list(product((-0.5, 0.5), repeat=3))) * size
            corners[:, :2] = turn.transform(corners[:, :2])
            wall = MultiPoint(pixels(np.transpose(corners + at))).convex_hull.intersection(box(*axes.bbox.extents))
            assert name.distance(wall) < where.height / 2
            assert wall.distance(Point(axes.transData.transform(text.xy))) < 0.01
            assert not any(name.intersects(part) for part in drawn)


def test_names_of_obstacles_close_together_lie_on_no_other(selection):
    """A rack, of which several boards are seen behind each other, about a target; drawn twice, and at another size."""
    shape = shape_of(selection.problem.machine, selection.best.evaluation)
    at = np.array([4.0, 0.5, 2.0])
    boards = {"left wall": (0.0, -0.7, 0.1), "right wall": (0.2, 0.7, 0.3), "back": (0.5, 0.0, 0.0),
              "lower shelf": (0.1, 0.0, -0.6), "upper shelf": (0.1, 0.0, 0.4), "roof": (0.0, 0.1, 0.8)}  # fmt: skip
    asked = read_constraints({"clearance": {"distance": 0.1, "obstacles": [
        {"kind": "box", "name": name, "center": [*(at + away)], "size": [0.8, 0.6, 0.9]} for name, away in boards.items()
    ]}})  # fmt: skip
    for inches in ((7.0, 6.0), (12.0, 9.0)):
        figure = Figure(figsize=inches, layout="constrained")
        panels = figure.subplots(2)
        for axes, view in zip(panels, views(shape), strict=True):
            draw_scene(axes, view, [Actor(shape, "C0")], at, asked, name="target")
        assert faults(figure) == []
        drawn = {text.get_text(): text.xyann for axes in panels for text in axes.texts}
        assert faults(figure) == []
        assert drawn == {text.get_text(): text.xyann for axes in panels for text in axes.texts}


def test_names_of_a_wall_and_of_a_cable_along_it_do_not_read_as_one():
    """Seen from above there is room for both between the two: in a row they are as far apart as a name is high."""
    machine = flexopt.load("slewing-excavator")
    shape = shape_of(machine, flexopt.evaluate(machine, (0.3, -0.3, -1.2, -0.6)))
    asked = read_constraints({"clearance": {"distance": 0.1, "obstacles": [
        {"kind": "box", "name": "wall", "center": [0.0, 3.0, 1.0], "size": [30.0, 0.3, 2.0]},
        {"kind": "box", "name": "cable", "center": [0.0, 2.0, 6.0], "size": [60.0, 0.02, 0.02]},
    ]}})  # fmt: skip
    figure = Figure(figsize=(7.0, 8.0), layout="constrained")
    panels = figure.subplots(2)
    draw_views(panels, [Actor(shape, "C0")], shape.skeleton[:, -1], asked, name="target")
    assert faults(figure) == []
    wall, cable = (
        next(text.get_window_extent() for text in panels[1].texts if text.get_text() == name)
        for name in ("wall", "cable")
    )
    in_a_row = abs(wall.y0 - cable.y0) < wall.height
    assert not in_a_row or max(wall.x0, cable.x0) - min(wall.x1, cable.x1) > wall.height - 1


def test_in_a_crowd_the_machines_outlines_are_asked_only_for_places_that_may_be_the_best(selection, monkeypatch):
    """Each name has some 2 000 places, in each of two views, and is drawn twice."""
    shape, asked_of, count = shape_of(selection.problem.machine, selection.best.evaluation), Path.intersects_bbox, 20
    calls = list[int]()
    monkeypatch.setattr(Path, "intersects_bbox", lambda *given: calls.append(1) or asked_of(*given))
    around = np.random.default_rng(0).uniform(-7.0, 7.0, (count, 2)).tolist()
    asked = read_constraints({"clearance": {"distance": 0.1, "obstacles": [
        {"kind": "sphere", "name": f"tree number {k}", "center": [*at, 1.0], "radius": 1.0} for k, at in enumerate(around)
    ]}})  # fmt: skip
    figure = Figure(figsize=(6.0, 7.8), layout="constrained")
    draw_views(figure.subplots(2), [Actor(shape, "C0")], np.array([4.0, 0.5, 2.0]), asked, name="target")
    figure.savefig(io.BytesIO())
    assert 0 < len(calls) < 100 * count


@pytest.mark.long("screen")
@pytest.mark.parametrize("size", ["screen", "paper"])
def test_names_along_walls_and_of_what_stands_before_them_lie_on_no_other(size):
    """Of two walls one behind the other and two boxes before them, the higher one's name above."""
    walls = {"left trench wall": 9.5, "right trench wall": 9.9}
    boxes = {"a platform edge": (1.0, 2.0), "bracket of the signal": (1.6, 0.3)}
    obstacles = [
        {"kind": "half_plane", "name": name, "point": [x, 0.0], "normal": [-1.0, 0.0]} for name, x in walls.items()
    ]
    obstacles += [
        {"kind": "box", "name": name, "center": [9.6, y], "size": [0.3, high]} for name, (y, high) in boxes.items()
    ]
    asked = {"clearance": {"distance": 0.05, "obstacles": obstacles}}
    machine = flexopt.load("boom-stick-bucket")
    selection = flexopt.select(machine, (6.0, 2.0), base=0.0, constraints=asked, starts=2)
    figure = selection.plot(size=size)
    assert faults(figure) == []
    heights = {text.get_text(): text.get_window_extent().y0 for text in figure.axes[0].texts}
    assert heights["bracket of the signal"] > heights["a platform edge"]


def test_what_goes_on_far_beyond_the_machine_does_not_shrink_it(selection):
    """A wire of 200 m is cut off; names stand in the middle of what is seen, and those at one place are one."""
    shape = shape_of(selection.problem.machine, selection.best.evaluation)
    wire = {"kind": "box", "center": [90.0, 1.0, 6.0], "size": [200.0, 0.1, 0.1], "name": "wire"}
    plank = wire | {"center": [90.0, 1.0, 6.4], "name": "plank"}
    asked = read_constraints({"clearance": {"distance": 0.1, "obstacles": [wire, plank]}})
    for view in views(shape):
        others = view.of(shape.skeleton)
        span = np.ptp(others, axis=1).max()
        points = scenery_points(view, asked, others)
        assert np.ptp(points[0]) <= 2 * span + 1e-9
        axes = Figure().add_subplot()
        draw_scene(axes, view, [Actor(shape, "C0")], np.array([3.0, 1.0, 5.0]), asked)
        (name,) = [text for text in axes.texts if "wire" in text.get_text()]
        # What is no larger than the machine is in the picture wherever it stands.
        far = wire | {"center": [40.0, 1.0, 6.0], "size": [1.0, 1.0, 1.0], "name": "hut"}
        shown = read_constraints({"clearance": {"distance": 0.1, "obstacles": [far]}})
        assert np.ptp(scenery_points(view, shown, others), axis=1).min() == pytest.approx(1.0, rel=0.5)
        assert name.get_text() == "wire, plank"
        low, high = sorted(axes.get_xlim())
        assert low < name.xy[0] < high
        assert high - low < 8 * span


@pytest.mark.long
def test_planar_machine_with_volumes_and_obstacles():
    data = flexopt.load("excavator").to_dict()
    data |= {"capsules": [{"body": "boom", "start": [0.0, 0.0], "end": [1.9, 0.0], "radius": 0.2}]}
    data |= {"support": {"span": [-1.0, 1.2]}}
    asked = {"region": [[-2.0, 3.0]], "keep_out": [[6.0, 9.0]], "clearance": {"distance": 0.1, "obstacles": [
        {"kind": "sphere", "center": [-3.0, 1.0], "radius": 0.4}]}}  # fmt: skip
    selection = flexopt.select(flexopt.machine_from_dict(data), (0.0, 1.6), base=0.0, constraints=asked)
    axes = selection.plot().axes[0]
    best = selection.best.evaluation
    boom = best.skeleton[:, 1:3]
    along = (boom[:, 1] - boom[:, 0]) / np.linalg.norm(boom[:, 1] - boom[:, 0])
    outline = capsule_outline(boom[:, 0], boom[:, 0] + 1.9 * along, 0.2)
    assert any(np.allclose(patch.get_path().vertices[: len(outline)], outline) for patch in axes.patches
               if patch.get_path().vertices.shape[0] > len(outline))  # fmt: skip
    drawn = lines(axes)
    np.testing.assert_allclose(drawn["the whole footprint may stand here"][:, 0], [-2.0, 3.0])
    np.testing.assert_allclose(drawn["no part of the footprint may stand here"][:, 0], [6.0, 9.0])
    stands = [patch.get_path().vertices[:, 0] for patch in axes.patches if isinstance(patch, FancyBboxPatch)]
    assert any(np.allclose([x.min(), x.max()], best.base[0] + np.array([-1.0, 1.2])) for x in stands)


@pytest.fixture(scope="module")
def run(machine):
    return flexopt.simulate(machine, [0.0448, -2.0499], duration=1.0)


def test_run_in_space(run, tmp_path):
    figure = run.plot(tmp_path / "run.png")
    shown = {axes.get_ylabel(): {line.get_label(): line.get_ydata() for line in axes.lines} for axes in figure.axes}
    for k, row in enumerate(("x", "z")):
        np.testing.assert_array_equal(shown["end-point error, mm"][row], 1e3 * run.error[:, k])
    for k, label in enumerate(("base x, mm", "base y, mm", "base rotation, mrad")):
        np.testing.assert_array_equal(shown[label]["deflection"], 1e3 * run.deflection[:, k])
    assert deflection_panel({"a": run}, 1).label == "base y, mm"


@pytest.mark.long
def test_film_in_space(run, tmp_path):
    run.animate(tmp_path / "run.gif", magnify=2.0)
    image = Image.open(io.BytesIO((tmp_path / "run.gif").read_bytes()))
    assert image.n_frames == 25
    first = np.asarray(image.convert("RGB"), dtype=int)
    image.seek(3)
    later = np.asarray(image.convert("RGB"), dtype=int)
    # The machine moves in both views, and the cursor in the panels.
    changed = np.abs(later - first).max(axis=2) > 60
    height, width = changed.shape
    for part in (changed[: height // 2, : width // 2], changed[height // 2 :, : width // 2], changed[:, width // 2 :]):
        assert part.sum() > 20
    run.animate(tmp_path / "run.html", magnify=2.0)
    assert "deflections × 2" in (tmp_path / "run.html").read_text(encoding="utf-8")


def test_map_marks(machine):
    plane = {"x_range": (-1.0, 1.0), "y_range": (0.5, 2.0), "points": (4, 3), "epsilon_max": False}
    result = flexopt.map_workspace(machine, posture=[0.9, -2.0], **plane)
    figure = result.plot(marks={"chosen": (0.25, 1.5), "present": (-0.5, 1.0)})
    for axes in figure.axes:
        if axes.images:
            np.testing.assert_array_equal(lines(axes)["chosen"], [[0.25, 1.5]])
            np.testing.assert_array_equal(lines(axes)["present"], [[-0.5, 1.0]])
    e = flexopt.evaluate(machine, [0.9, -2.0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        own = result.plot()
    np.testing.assert_allclose(lines(own.axes[0])["end-point"], [e.end_point])
    labels = {axes.get_xlabel() for axes in own.axes}
    assert "x of the end-point at rest, inertial frame, m" in labels


@pytest.mark.long
def test_a_stand_says_what_its_areas_hold_for():
    """They are seen from above alone, where the machine at its targets is not named again."""
    kept = {"keep_out": [[[2.0, -2.0], [4.0, -2.0], [4.0, 2.0], [2.0, 2.0]]]}
    targets = [(0.9, -0.3, 1.0), (0.9, 0.3, 1.2)]
    machine = flexopt.load("mobile-manipulator")
    stand = flexopt.select_stand(machine, targets, base=(0.0, 0.0, 0.0), constraints=kept, starts=1, workers=1)
    side, above = stand.plot().axes[:2]
    assert "at the other targets" in [text.get_text() for text in side.get_legend().get_texts()]
    named = [text.get_text() for text in above.get_legend().get_texts()]
    assert len(named) == 1
    assert named[0].endswith("may stand here")


def test_a_way_in_an_upright_plane_is_seen_from_across_it():
    """Whichever plane, also where the arm stands upright at first; any other way from above."""
    upright = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 2.0]])

    def at(x: float, y: float) -> Shape:
        points = upright + np.array([[x], [y], [0.0]])
        return Shape(points, ((0, 1), (1, 2)), points[:, 0], (np.eye(3), np.zeros(3)))

    for along in ((1.0, 0.0), (0.0, 1.0), (0.6, 0.8)):
        view = view_of_way([at(0.0, 0.0), at(*along)])
        assert view.upright
        np.testing.assert_allclose(view.of(np.array([*along, 0.0])), [1.0, 0.0], atol=1e-12)
    assert not view_of_way([at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0)]).upright
