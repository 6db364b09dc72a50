"""Efforts, speeds, rotors, capsules and supports of both kinds of machine: what is read, and what is refused by name."""

from __future__ import annotations

import copy
import math
import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import flexopt
from flexopt import ModelError
from flexopt.errors import FlexoptWarning
from flexopt.model import AnyMachine, Tree, tree_from_dict
from flexopt.model.polygons import check_convex_polygon
from tests.model.robots import files
from tests.model.robots.files import MJCF, MJCF_MACHINE, URDF, URDF_MACHINE, changed, changed_text
from tests.model.test_reading import excavator_dict
from tests.oracles.spatial import random_tree


def read(folder: Path, text: str, machine: dict[str, Any], warns: str = "") -> Tree:
    """As `files.read`; where a warning is due, it must come."""
    if not warns:
        return files.read(folder, text, machine)
    with pytest.warns(FlexoptWarning, match=re.escape(warns)):
        return files.read(folder, text, machine)


def plane() -> dict[str, Any]:
    data = excavator_dict()
    data["links"][0] |= {"effort": 9e4, "speed": 0.5}
    data["capsules"] = [
        {"body": "base", "start": [0.0, 0.3], "end": [0.5, -0.1], "radius": 0.6},
        {"body": "stick", "start": [0.0, 0.0], "end": [0.0, 0.0], "radius": 0.2},
    ]
    data["support"] = {"span": [-1.8, 1.9]}
    return data


def space() -> dict[str, Any]:
    data = copy.deepcopy(random_tree(5))
    for body in data["bodies"]:
        body["joint"].pop("armature", None)
    drive = next(body["joint"] for body in data["bodies"] if not body["joint"]["passive"])
    drive |= {"effort": 300.0, "speed": 2.0, "armature": 0.7}
    data["capsules"] = [{"body": "b1", "start": [0.0, 0.3, 1.0], "end": [0.5, -0.1, 1.0], "radius": 0.6}]
    data["support"] = {"polygon": [[0.0, 0.0], [0.0, 2.0], [3.0, 2.0], [3.0, 0.0]]}
    return data


def test_a_planar_machine_has_them() -> None:
    machine = flexopt.machine_from_dict(plane())
    assert machine.efforts == (9e4, math.inf)
    assert machine.speeds == (0.5, math.inf)
    assert machine.support_points == ((-1.8,), (1.9,))
    assert [(c.body, c.start, c.end, c.radius) for c in machine.capsules] == [
        ("base", (0.0, 0.3), (0.5, -0.1), 0.6),
        ("stick", (0.0, 0.0), (0.0, 0.0), 0.2),
    ]


def test_a_tree_has_them() -> None:
    tree = tree_from_dict(space())
    assert sorted(tree.efforts)[0] == 300.0
    assert sorted(tree.speeds)[0] == 2.0
    assert set(tree.efforts[1:] + tree.speeds[1:]) == {math.inf}
    assert len(tree.efforts) == len(tree.speeds) == len(tree.joints)
    # Counter-clockwise, from the same first corner.
    assert tree.support_points == ((0.0, 0.0), (3.0, 0.0), (3.0, 2.0), (0.0, 2.0))
    assert [capsule.body for capsule in tree.capsules] == ["b1"]
    assert [p.value for p in tree.parameters if p.name.endswith(".armature")] == [0.7]


@pytest.mark.parametrize(
    "machine", [flexopt.machine_from_dict(plane()), tree_from_dict(space())], ids=["plane", "space"]
)
def test_the_dictionary_brings_them_back(machine: AnyMachine) -> None:
    build = flexopt.machine_from_dict if isinstance(machine, flexopt.Machine) else tree_from_dict
    again = build(machine.to_dict())
    assert again == machine
    assert again.content_hash == machine.content_hash


def test_machines_whose_capsules_are_called_otherwise_are_two() -> None:
    """Constraints name them: what is kept of one must not answer for the other."""
    data = flexopt.load("slewing-excavator").to_dict()
    *others, bucket = data["capsules"]
    red, blue = (tree_from_dict(data | {"capsules": (*others, bucket | {"label": name})}) for name in ("red", "blue"))
    assert red.content_hash == blue.content_hash
    assert red != blue
    for tree, label in ((red, "red"), (blue, "blue")):
        assert flexopt.build_plant(tree).machine.capsules[-1].label == label


def test_a_machine_without_them_has_neutral_values() -> None:
    for machine in (flexopt.load("excavator"), tree_from_dict(random_tree(5))):
        assert set(machine.efforts) == set(machine.speeds) == {math.inf}
        assert machine.capsules == machine.support_points == ()


SQUARE = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
STAR = [[math.cos(0.8 * math.pi * k), math.sin(0.8 * math.pi * k)] for k in range(5)]
PLANE_FAULTS: dict[str, tuple[tuple[Any, ...], Any, str, str]] = {
    "effort of zero": (("links", 0, "effort"), 0.0, "links[0] (boom).effort", "greater than 0"),
    "effort in words": (("links", 0, "effort"), "much", "links[0] (boom).effort", "must be a number, not text"),
    "endless speed": (("links", 0, "speed"), math.inf, "links[0] (boom).speed", "must be finite"),
    "body that is not there": (("capsules", 1, "body"), "stik", "capsules[1].body", "did you mean 'stick'?"),
    "end in space": (("capsules", 0, "end"), [0.0, 0.0, 0.0], "capsules[0].end", "two numbers [along, left] in m"),
    "end of one number": (("capsules", 0, "end"), [0.0], "capsules[0].end", "[along, left] in the plane"),
    "radius of zero": (("capsules", 0, "radius"), 0.0, "capsules[0].radius", "greater than 0"),
    "span reversed": (("support", "span"), [1.0, -1.0], "support.span", "reversed or empty"),
    "polygon in the plane": (("support",), {"polygon": SQUARE}, "support.polygon", "unknown key"),
}  # fmt: skip
SPACE_FAULTS: dict[str, tuple[tuple[Any, ...], Any, str, str]] = {
    "body that is not there": (("capsules", 0, "body"), "base", "capsules[0].body", "is no body's name"),
    "start in the plane": (("capsules", 0, "start"), [0.0, 0.0], "capsules[0].start", "three numbers [x, y, z] in m"),
    "two corners": (("support", "polygon"), SQUARE[:2], "support.polygon", "3 to 500 corners"),
    "corner in space": (("support", "polygon"), [*SQUARE, [0.0, 0.5, 0.0]], "support.polygon", "corner 4 is not"),
    "corner in words": (("support", "polygon"), [*SQUARE[:3], [0.0, "x"]], "support.polygon", "corner 3 y must be a number"),
    "dent": (("support", "polygon"), [*SQUARE, [0.5, 0.5]], "support.polygon", "is not convex"),
    "straight": (("support", "polygon"), [*SQUARE, [0.0, 0.5]], "support.polygon", "is not convex"),
    "star": (("support", "polygon"), STAR, "support.polygon", "is not simple"),
    "corner twice": (("support", "polygon"), [*SQUARE, [0.0, 1.0]], "support.polygon", "in one place"),
    "span in space": (("support",), {"span": [0.0, 1.0]}, "support.span", "unknown key"),
}  # fmt: skip


def put(data: Any, path: tuple[Any, ...], value: Any) -> None:
    for part in path[:-1]:
        data = data[part]
    data[path[-1]] = value


@pytest.mark.parametrize("case", PLANE_FAULTS)
def test_faults_in_the_plane(case: str) -> None:
    path, value, field, sentence = PLANE_FAULTS[case]
    data = plane()
    put(data, path, value)
    assert_fault(flexopt.machine_from_dict, data, field, sentence)


@pytest.mark.parametrize("case", SPACE_FAULTS)
def test_faults_in_space(case: str) -> None:
    path, value, field, sentence = SPACE_FAULTS[case]
    data = space()
    put(data, path, value)
    assert_fault(tree_from_dict, data, field, sentence)


def assert_fault(build: Any, data: dict[str, Any], field: str, sentence: str) -> None:
    with pytest.raises(ModelError) as caught:
        build(data)
    assert any(fault.field == field and sentence in fault.sentence for fault in caught.value.faults), caught.value


def test_drives_belong_to_actuated_joints() -> None:
    data = plane()
    data["links"].insert(1, data["links"][0] | {"name": "mast", "passive": True, "stiffness": 1e5})
    with pytest.raises(ModelError) as caught:
        flexopt.machine_from_dict(data)
    assert {f"links[1] (mast).{key}" for key in ("effort", "speed")} == {fault.field for fault in caught.value.faults}
    tree = space()
    index, joint = next((i, body["joint"]) for i, body in enumerate(tree["bodies"]) if body["joint"]["passive"])
    joint |= {"effort": 1.0, "speed": 1.0, "armature": 1.0}  # a rotor may sit on a spring
    with pytest.raises(ModelError) as caught:
        tree_from_dict(tree)
    assert {f"bodies[{index}] (b{index}).joint.{key}" for key in ("effort", "speed")} == {
        f.field for f in caught.value.faults
    }


@given(
    st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9)), min_size=3, max_size=12),
    st.booleans(),
    st.integers(0, 11),
)
def test_hulls_are_convex_and_come_out_counter_clockwise(
    points: list[tuple[int, int]], backwards: bool, first: int
) -> None:
    spread = np.linalg.matrix_rank(np.array(points) - points[0])
    if spread < 2:
        with pytest.raises(ValueError, match=r"convex|simple|in one place"):
            check_convex_polygon(points)
        return
    hull = [points[i] for i in ConvexHull(points).vertices]  # SciPy's are counter-clockwise
    turned = hull[first % len(hull) :] + hull[: first % len(hull)]
    given_order = turned[::-1] if backwards else turned
    expected = [turned[-1], *turned[:-1]] if backwards else turned
    assert check_convex_polygon(given_order) == tuple((float(x), float(y)) for x, y in expected)


def test_urdf_bounds_are_read_and_the_machine_file_goes_first(tmp_path: Path) -> None:
    text = changed_text(URDF, 'upper="1.4" effort="1" velocity="1"', 'upper="1.4" effort="5e4" velocity="0.6"')
    text = changed_text(text, 'upper="0.8" effort="1" velocity="1"', 'upper="0.8" effort="0" velocity="inf"')
    text = changed_text(
        text, '<dynamics damping="0.7"/>', '<dynamics damping="0.7"/><limit effort="2e4" velocity="1.79e308"/>'
    )
    machine = changed(URDF_MACHINE, {"joints/extend": {"speed": 0.3, "armature": 12.0}})
    tree = read(tmp_path, text, machine)
    assert tree.joints == ("slew", "boom", "extend")
    assert tree.efforts == (2e4, 5e4, math.inf)
    assert tree.speeds == (math.inf, 0.6, 0.3)
    assert tree.limits[0] == (-math.inf, math.inf)
    assert [(p.value, p.unit) for p in tree.parameters if p.name == "extend.armature"] == [(12.0, "kg")]


ACTUATORS: dict[str, tuple[str, float]] = {
    "force range": ('<position joint="slew" forcerange="-40 40"/>', 40.0),
    "gear": ('<general joint="slew" gear="-30 0 0" forcerange="-40 40"/>', 1200.0),
    "weaker way": ('<motor joint="slew" forcerange="-40 25"/>', 25.0),
    "control of a motor": ('<motor joint="slew" gear="150" ctrlrange="-0.4 0.4"/>', 60.0),
    "a motor as MuJoCo saves it": ('<general joint="slew" gear="150 0 0 0 0 0" gainprm="2" ctrlrange="-0.4 0.4"/>', 120.0),
    "with a bias": ('<general joint="slew" biastype="affine" biasprm="0 -9" ctrlrange="-0.4 0.4"/>', math.inf),
    "an integrator": ('<general joint="slew" dyntype="integrator" ctrlrange="-0.4 0.4"/>', math.inf),
    "control of a servo": ('<position joint="slew" ctrlrange="-0.4 0.4"/>', math.inf),
    "range that is off": ('<motor joint="slew" forcerange="-40 40" forcelimited="false"/>', math.inf),
    "one way only": ('<motor joint="slew" forcerange="0 40"/>', math.inf),
    "two of them": ('<motor joint="slew" forcerange="-4 4"/><motor joint="slew" forcerange="-4 4"/>', math.inf),
    "of another joint": ('<motor joint="lift" forcerange="-4 4"/>', math.inf),
}  # fmt: skip


@pytest.mark.parametrize("case", ACTUATORS)
def test_mjcf_actuators_bound_their_joint(tmp_path: Path, case: str) -> None:
    actuator, effort = ACTUATORS[case]
    tree = read(tmp_path, changed_text(MJCF, '<motor joint="slew"/>', actuator), MJCF_MACHINE)
    assert tree.efforts[tree.joints.index("slew")] == pytest.approx(effort)


# Actuators of which MuJoCo itself says what they give at most either way, with defaults.
DRIVEN = {
    "a motor's control": '<motor joint="slew" gear="150" ctrlrange="-0.4 0.4"/>',
    "weaker way": '<motor joint="slew" gear="-20" ctrlrange="-0.4 0.3"/>',
    "as MuJoCo saves it": '<general joint="slew" gear="150 0 0 0 0 0" gainprm="2" ctrlrange="-0.4 0.4"/>',
    "by a class": '<motor class="geared" joint="slew"/>',
    "by a class of another kind": '<general class="geared" joint="slew"/>',
    "a motor of a servo's class": '<motor class="served" joint="slew"/>',
    "force before control": '<motor joint="slew" gear="10" ctrlrange="-9 9" forcerange="-5 5"/>',
}


@pytest.mark.parametrize("case", DRIVEN)
def test_efforts_are_what_mujoco_gives_at_most(tmp_path: Path, case: str) -> None:
    given = f"""
    <default><default class="geared"><motor gear="7" ctrlrange="-3 3"/></default>
      <default class="served"><position kp="50" ctrlrange="-2 2"/></default></default>
    <worldbody><body name="chassis"><geom type="box" size="1 1 0.2" mass="90"/><joint name="heave" type="slide"/>
      <body name="arm"><joint name="slew" axis="0 0 1"/><geom type="capsule" fromto="0 0 0 1 0 0" size="0.1"/></body>
    </body></worldbody>
    <actuator>{DRIVEN[case]}</actuator>"""
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{given}</mujoco>")
    state, found = mujoco.MjData(model), list[float]()
    for sign in (-1.0, 1.0):
        state.ctrl[:] = 1e6 * sign
        mujoco.mj_forward(model, state)
        found.append(abs(float(state.qfrc_actuator[1])))
    data = {
        "name": "arm", "robot": "arm.xml", "actuated": ["slew"], "joints": {"heave": {"stiffness": 1e5}},
        "end_point": {"link": "arm", "offset": [1.0, 0.0, 0.0], "rows": ["x"]},
    }  # fmt: skip
    tree = files.read(tmp_path, f"<mujoco>{given}</mujoco>", data)
    assert tree.efforts == (pytest.approx(min(found)),)


def test_mjcf_joints_bound_themselves_and_defaults_count(tmp_path: Path) -> None:
    text = changed_text(MJCF, 'name="lift" axis', 'name="lift" actuatorfrcrange="-90 90" axis')
    text = changed_text(text, '<motor joint="slew"/>', '<motor joint="slew"/><motor joint="lift"/>')
    text = changed_text(text, '<joint damping="0.5"/>', '<joint damping="0.5"/><motor forcerange="-100 100"/>')
    tree = read(tmp_path, text, MJCF_MACHINE)
    assert dict(zip(tree.joints, tree.efforts, strict=True)) == {
        "slew": 100,
        "lift": 90,
        "crowd": math.inf,
        "twist": math.inf,
    }


def test_a_servos_default_makes_servos_of_others(tmp_path: Path) -> None:
    text = changed_text(MJCF, '<motor joint="slew"/>', '<general joint="slew" ctrlrange="-3 3"/>')
    assert 3.0 in read(tmp_path, text, MJCF_MACHINE).efforts
    served = changed_text(text, '<joint damping="0.5"/>', '<joint damping="0.5"/><position kp="50"/>')
    assert set(read(tmp_path, served, MJCF_MACHINE).efforts) == {math.inf}
    # Without its bias there is still the servo's gain.
    plain = changed_text(served, "<general", '<general biastype="none"')
    assert set(read(tmp_path, plain, MJCF_MACHINE).efforts) == {math.inf}
    assert 6.0 in read(tmp_path, changed_text(plain, "<general", '<general gainprm="2"'), MJCF_MACHINE).efforts


def test_armature_of_mjcf_is_read_overridden_or_ignored(tmp_path: Path) -> None:
    text = changed_text(MJCF, 'axis="0 -2 0"', 'axis="0 -2 0" armature="0.3"')
    text = changed_text(text, 'name="rock"', 'name="rock" armature="4"')
    tree = read(tmp_path, text, MJCF_MACHINE)
    joints = {body.joint.name: body.joint.armature for body in tree.bodies}
    assert {name: value for name, value in joints.items() if value} == {"rock": 4.0, "lift": 0.3}
    over = read(
        tmp_path, text, changed(MJCF_MACHINE, {"joints/lift": {"armature": 0.0}, "joints/twist": {"armature": 0.1}})
    )
    joints = {body.joint.name: body.joint.armature for body in over.bodies}
    assert {name: value for name, value in joints.items() if value} == {"rock": 4.0, "twist": 0.1}
    ignored = read(tmp_path, text, changed(MJCF_MACHINE, {"ignore": ["armature"]}))
    assert ignored == read(tmp_path, MJCF, MJCF_MACHINE)


def test_capsules_of_links_move_with_the_body_they_merge_into(tmp_path: Path) -> None:
    """The bracket is welded to the boom by an origin of its own; the tool hangs on the stick."""
    machine = changed(URDF_MACHINE, {
        "capsules": [
            {"link": "bracket", "start": [0.0, 0.0, 0.0], "end": [1.0, 0.0, 0.0], "radius": 0.1},
            {"link": "chassis", "start": [0.0, 0.0, 0.0], "end": [0.0, 0.0, 1.0], "radius": 0.5},
        ],
        "support": {"polygon": SQUARE},
    })  # fmt: skip
    tree = read(tmp_path, URDF, machine)
    bracket, chassis = tree.capsules
    assert (bracket.body, bracket.start) == ("boom_link", (2.0, 0.0, 0.1))
    np.testing.assert_allclose(bracket.end, [2 + math.cos(0.5), 0.0, 0.1 - math.sin(0.5)], atol=1e-15)
    # Springs act at `point` of the root link, where the base's bodies have their origin.
    point = np.array(URDF_MACHINE["base"]["point"])
    assert chassis.body == "chassis"
    assert np.linalg.norm(chassis.start) == pytest.approx(np.linalg.norm(point))
    assert math.dist(chassis.start, chassis.end) == pytest.approx(1.0)
    assert tree.support_points == tuple(map(tuple, SQUARE))


OVERLAY_FAULTS: dict[str, tuple[dict[str, Any], str, str]] = {
    "link that is not there": (
        {"capsules": [{"link": "boom_lnk", "start": [0, 0, 0], "end": [0, 0, 0], "radius": 1}]},
        "capsules[0].link", "did you mean 'boom_link'?",
    ),
    "capsule in the plane": (
        {"capsules": [{"link": "boom_link", "start": [0, 0], "end": [0, 0, 0], "radius": 1}]},
        "capsules[0].start", "three numbers",
    ),
    "body of a tree": (
        {"capsules": [{"body": "boom_link", "start": [0, 0, 0], "end": [0, 0, 0], "radius": 1}]},
        "capsules[0].body", "unknown key",
    ),
    "effort of a spring": ({"actuated": ["slew", "extend"], "joints/boom": {"stiffness": 1e5, "effort": 3.0},
                            "end_point/rows": ["x", "z"]}, "joints.boom.effort", "this one has a spring"),
    "negative armature": ({"joints/boom": {"armature": -1.0}}, "joints.boom.armature", "between 0"),
    "support with a dent": ({"support": {"polygon": [*SQUARE, [0.5, 0.5]]}}, "support.polygon", "is not convex"),
}  # fmt: skip


@pytest.mark.parametrize("case", OVERLAY_FAULTS)
def test_faults_of_machine_files(tmp_path: Path, case: str) -> None:
    changes, field, sentence = OVERLAY_FAULTS[case]
    assert_fault(lambda machine: read(tmp_path, URDF, machine), changed(URDF_MACHINE, changes), field, sentence)


def test_a_capsule_of_what_stands_on_the_ground_is_refused(tmp_path: Path) -> None:
    machine = changed(
        MJCF_MACHINE, {"capsules": [{"link": "floor", "start": [0, 0, 0], "end": [0, 0, 0], "radius": 1}]}
    )
    text = changed_text(MJCF, '<body name="chassis"', '<body name="floor"/><body name="chassis"')
    assert_fault(lambda given: read(tmp_path, text, given), machine, "capsules[0].link", "fixed to the ground")


def surface(shape: str, size: list[float]) -> np.ndarray:
    """Points (3, k) on a shape of these half-sizes, its edges and caps among them."""
    around, up = np.meshgrid(np.linspace(0, 2 * math.pi, 25), np.linspace(-1, 1, 25))
    ring, across = np.array([np.cos(around), np.sin(around)]), np.sqrt(1 - up**2)
    if shape == "box":
        corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1)
        return corners * np.array(size)[:, None]
    if shape == "cylinder":
        points = np.stack([size[0] * ring[0], size[0] * ring[1], size[1] * up])
    else:
        radii = size if shape == "ellipsoid" else [size[0]] * 3
        points = np.stack([radii[0] * across * ring[0], radii[1] * across * ring[1], radii[2] * up])
        if shape == "capsule":
            points[2] += size[1] * np.sign(up)
    return points.reshape(3, -1)


def beyond(points: np.ndarray, start: Any, end: Any, radius: float) -> float:
    """How far the farthest of points (3, k) lies outside a capsule, m."""
    a, along = np.array(start)[:, None], (np.array(end) - np.array(start))[:, None]
    length = float(np.sum(along**2)) or 1.0
    share = np.clip(np.sum((points - a) * along, axis=0) / length, 0.0, 1.0)
    return float(np.max(np.linalg.norm(points - a - share * along, axis=0))) - radius


half_sizes = st.integers(1, 20).map(lambda k: k / 10)
shapes = st.one_of(
    st.tuples(st.just("sphere"), st.tuples(half_sizes)),
    st.tuples(st.sampled_from(["cylinder", "capsule"]), st.tuples(half_sizes, half_sizes)),
    st.tuples(st.sampled_from(["box", "ellipsoid"]), st.tuples(half_sizes, half_sizes, half_sizes)),
)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*reach beyond two turns:flexopt.errors.FlexoptWarning")
@given(shapes, st.tuples(*[st.integers(-9, 9).map(lambda k: k / 5)] * 6))
def test_capsules_enclose_the_collision_geometry(
    tmp_path_factory: pytest.TempPathFactory, drawn: tuple[str, tuple[float, ...]], pose: tuple[float, ...]
) -> None:
    """Of both formats, and as tightly as is said: they touch spheres, capsules, cylinders and boxes."""
    shape, size = drawn
    folder = tmp_path_factory.mktemp("solid")
    turn = Rotation.from_euler("xyz", pose[3:])
    points = turn.as_matrix() @ surface(shape, list(size)) + np.array(pose[:3])[:, None]
    place, angles = (" ".join(map(repr, part)) for part in (pose[:3], pose[3:]))
    geom = f'<geom type="{shape}" size="{" ".join(map(repr, size))}" pos="{place}" euler="{angles}"/>'
    mjcf = changed_text(
        MJCF.replace('angle="degree"', 'angle="radian" eulerseq="XYZ"'),
        '<joint name="twist"',
        f'{geom}<joint name="twist"',
    )
    mjcf = changed_text(mjcf, '<geom type="mesh" mesh="none" mass="0"/>', "")
    mjcf = mjcf.replace("</worldbody>", '<geom type="plane" size="1 1 1"/></worldbody>')
    urdf = None
    if shape != "ellipsoid":
        tags = {"sphere": 'radius="{0!r}"', "box": 'size="{0!r} {1!r} {2!r}"'}
        sizes = [2 * half for half in size] if shape == "box" else [size[0], *(2 * half for half in size[1:])]
        attributes = tags.get(shape, 'radius="{0!r}" length="{1!r}"').format(*sizes)
        collision = (
            f'<collision><origin xyz="{place}" rpy="{angles}"/><geometry><{shape} {attributes}/></geometry></collision>'
        )
        urdf = changed_text(URDF, '<link name="stick">', f'<link name="stick">{collision}')
    for text, machine in ((mjcf, MJCF_MACHINE), (urdf, URDF_MACHINE)):
        if text is None:
            continue
        tree = read(folder, text, machine | {"capsules": "collision"})
        # The stick of the MJCF file has a capsule and a ball of its own, which come after.
        capsule = next(found for found in tree.capsules if found.body == "stick")
        outside = beyond(points, capsule.start, capsule.end, capsule.radius)
        assert outside <= 1e-12
        if shape != "ellipsoid":
            assert outside >= -1e-9 - (0.01 * max(size) if shape in ("sphere", "capsule") else 0.0)  # sampled surfaces


def test_every_body_of_a_robot_file_gets_its_capsules(tmp_path: Path) -> None:
    tree = read(
        tmp_path, MJCF, MJCF_MACHINE | {"capsules": "collision"}, warns="body 'chassis': collision geometry is a mesh"
    )
    found = [(capsule.body, capsule.radius) for capsule in tree.capsules]
    assert [body for body, _ in found] == ["chassis", "turret", "turret", "boom", "stick", "stick"]
    assert found[0] == ("chassis", pytest.approx(math.hypot(0.4, 0.2)))
    # A capsule welded to the boom by the frame it stands in; the boom's joint is 0.05 m above its origin.
    boom = tree.capsules[3]
    np.testing.assert_allclose([boom.start, boom.end], [[0, 0, -0.05], [2, 0, -0.05]], atol=1e-14)
    never = changed_text(MJCF, '<geom type="box"', '<geom contype="0" conaffinity="0" type="box"')
    tree = read(tmp_path, never, MJCF_MACHINE | {"capsules": "collision"}, warns="mesh")
    assert [capsule.body for capsule in tree.capsules] == ["turret", "turret", "boom", "stick", "stick"]


UNREAD: dict[str, tuple[str, str]] = {
    "mesh": ('<geometry><mesh filename="a.stl"/></geometry>', "link 'stick': collision geometry is a <mesh>, which is not read: write [[capsules]]"),
    "nothing": ("<geometry/>", "has no shape"),
    "no size": ('<geometry><box size="1 1"/></geometry>', "<box> has a size or an origin that needs 3 numbers"),
    "flat": ('<geometry><cylinder radius="1" length="0"/></geometry>', "<cylinder> has a size or an origin that is not positive"),
}  # fmt: skip


@pytest.mark.parametrize("case", UNREAD)
def test_collision_geometry_that_is_not_read_is_warned_of_where_it_matters(tmp_path: Path, case: str) -> None:
    geometry, sentence = UNREAD[case]
    text = changed_text(URDF, '<link name="stick">', f'<link name="stick"><collision>{geometry}</collision>')
    assert read(tmp_path, text, URDF_MACHINE).capsules == ()
    tree = read(tmp_path, text, URDF_MACHINE | {"capsules": "collision"}, warns=sentence)
    assert tree.capsules == ()


def test_another_word_for_capsules_is_refused(tmp_path: Path) -> None:
    machine = URDF_MACHINE | {"capsules": "collisions"}
    assert_fault(lambda given: read(tmp_path, URDF, given), machine, "capsules", "must be a list")
