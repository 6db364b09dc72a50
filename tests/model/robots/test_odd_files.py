"""Odd but legal files, each beside the tree it must give."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from flexopt import FlexoptWarning, ModelError
from flexopt.model.robots import robot_from_dict
from flexopt.model.tree import Tree
from tests.model.robots.files import MJCF, MJCF_MACHINE, URDF, URDF_MACHINE, changed, changed_text, read
from tests.model.robots.test_readings import MujocoRobot, assert_same, joint_values
from tests.model.robots.tree_oracle import TreeOracle

# Changes that say the same in other words.
SAME: dict[str, tuple[str, str]] = {
    "namespace of xacro": ("<robot", '<robot xmlns:xacro="http://wiki.ros.org/xacro"'),
    "comments": ("<robot", "<!-- one --><robot"),
    "long axis": ('xyz="0 -1 0"', 'xyz="0 -17.5 0"'),
    "origin of zeros": ('<axis xyz="3 0 4"/>', '<origin xyz="0 0 0" rpy="0 0 0"/><axis xyz="3 0 4"/>'),
    "axis of a fixed joint": ('<child link="bracket"/>', '<child link="bracket"/><axis xyz="0 0 0"/>'),
    "numbers in any way": ('value="900"', 'value=" 9.0e+2 "'),
    "no friction": ('damping="0.7"', 'damping="0.7" friction="0.0"'),
    "children before parents": ("", ""),
    "mesh of a collision": (
        "<visual>",
        '<collision><geometry><mesh filename="none.dae"/></geometry></collision><visual>',
    ),
    "safety controller": (
        '<axis xyz="3 0 4"/>',
        '<axis xyz="3 0 4"/><safety_controller k_velocity="1"/><calibration/>',
    ),
}


@pytest.mark.parametrize("case", SAME)
def test_urdfs_that_say_the_same(tmp_path: Path, case: str) -> None:
    text = changed_text(URDF, *SAME[case])
    if case == "children before parents":
        start, end = text.index('  <joint name="flange"'), text.index("  <material")
        head = text.index('  <link name="chassis"')
        text = text[:head] + text[start:end] + text[head:start] + text[end:]
    assert parts(read(tmp_path, text, URDF_MACHINE)) == parts(read(tmp_path, URDF, URDF_MACHINE))


def parts(tree: Tree) -> dict[str, Any]:
    """The tree without the order of its bodies."""
    data = tree.to_dict()
    return data | {"bodies": sorted(data["bodies"], key=lambda body: body["name"])}


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_encodings(tmp_path: Path, encoding: str) -> None:
    tree = read(tmp_path, URDF, URDF_MACHINE)
    tmp_path.joinpath("arm.urdf").write_bytes(URDF.encode(encoding))
    assert robot_from_dict(URDF_MACHINE, folder=tmp_path) == tree


def test_the_root_element_says_the_format(tmp_path: Path) -> None:
    machine = changed(URDF_MACHINE, {"robot": "arm.xml"})
    assert read(tmp_path, URDF, machine) == read(tmp_path, URDF, URDF_MACHINE)


WARNED: dict[str, tuple[str, str, list[str]]] = {
    "principal moments": ('izz="31"', 'izz="50"', ["arm.urdf:32: link 'boom_link' <inertial>", "3, 30, 50 kg m²", "exceeds"]),
    "negative moment of a small part": (
        'ixx="0.2" ixy="0.01"', 'ixx="-0.001" ixy="0.01"', ["link 'bracket'", "no rigid body has", "-0.0013", "one is negative: a machine is refused"],
    ),
    "dry friction": ('damping="0.7"', 'damping="0.7" friction="2"', ["arm.urdf:16: joint 'slew' <dynamics>", "dry friction 2"]),
    "links of a simulator": (
        "<material", '<gazebo><link name="tool"/><joint name="boom"/></gazebo><gazebo/><transmission name="t"/><material',
        ["arm.urdf: left out, as not part of the format: <gazebo> (2, from line 93), <transmission> (1, line 93)"],
    ),
    "left-over macros": (
        '<link name="tool"/>', '<xacro:property name="m" value="${3*4}"/><link name="tool"><xacro:inertial m="${m}"/></link>',
        ["left out", "<xacro:property> (1, line 92)", "<xacro:inertial> (1, line 92)"],
    ),
    "another program's words": (
        'damping="0.7"', 'damping="0.7" K="7000" drake:gear="3"', ["left out", "dynamics K (1, line 16), dynamics drake:gear (1, line 16)"],
    ),
    "a misspelt visual": ("<visual>", '<visual nome="a"><orgin/>', ["link 'chassis' <visual>", "'nome' is left out", "'name'?", "<orgin>"]),
    "limit without ends": (
        '<limit lower="-0.5" upper="1.4" effort="1" velocity="1"/>', '<limit effort="1" velocity="1"/>',
        ["joint 'boom' <limit>", "neither lower nor upper", "without limits"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", WARNED)
def test_odd_urdfs_are_read_with_a_warning(tmp_path: Path, case: str) -> None:
    old, new, sentences = WARNED[case]
    with pytest.warns(FlexoptWarning) as caught:
        tree = read(tmp_path, changed_text(URDF, old, new), URDF_MACHINE)
    assert len(caught) == 1
    told = caught[0].message
    assert isinstance(told, FlexoptWarning)
    assert all(any(sentence in remark for remark in told.remarks) for sentence in sentences), told.remarks
    assert caught[0].filename == __file__.replace("test_odd_files", "files")
    plain = read(tmp_path, URDF, URDF_MACHINE)
    assert tree.coordinates == plain.coordinates
    if case == "limit without ends":
        assert tree.limits == (plain.limits[0], (-np.inf, np.inf), plain.limits[2])


def test_hinges_of_many_turns(tmp_path: Path) -> None:
    """Limits as large as a file likes: none, or those of two turns that the rest of flexopt takes."""
    wide = read(tmp_path, changed_text(URDF, 'lower="-0.5" upper="1.4"', 'lower="-1e6" upper="1e6"'), URDF_MACHINE)
    assert wide.limits[1] == (-np.inf, np.inf)
    half = read(tmp_path, changed_text(URDF, 'lower="-0.5" upper="1.4"', 'lower="-0.5" upper="1e6"'), URDF_MACHINE)
    assert half.limits[1] == (-0.5, 4 * np.pi)


def test_a_link_may_be_called_what_a_parameter_is(tmp_path: Path) -> None:
    tree = read(tmp_path, URDF.replace('"stick"', '"payload"'), URDF_MACHINE)
    assert tree.bodies[-1].name == "payload.link"


@pytest.mark.parametrize("value", [0.0, 0.7])
def test_a_locked_joint_is_one_held_there(tmp_path: Path, value: float) -> None:
    """Inertia composed exactly: the mass matrix is that of the free tree, without the locked row and column."""
    locked = read(tmp_path, URDF, changed(URDF_MACHINE, {
        "actuated": ["slew", "extend"], "locked/boom": value, "end_point/rows": ["x", "y"],
    }))  # fmt: skip
    free = read(tmp_path, URDF, URDF_MACHINE)
    rng = np.random.default_rng(2)
    values = {name: float(rng.uniform(-1, 1)) for name in free.coordinates} | {"boom": value}
    names = list(locked.coordinates)
    assert "boom" not in names
    ours, theirs = TreeOracle(locked, values), TreeOracle(free, values)
    kept = [free.coordinates.index(name) for name in names]
    mass = theirs.mass_matrix(list(free.coordinates))[np.ix_(kept, kept)]
    np.testing.assert_allclose(ours.mass_matrix(names), mass, rtol=0, atol=1e-14 * np.abs(mass).max())
    np.testing.assert_allclose(ours.end_point(), theirs.end_point(), rtol=0, atol=1e-14)


def test_a_joint_is_locked_within_the_limits_of_its_table(tmp_path: Path) -> None:
    machine = changed(URDF_MACHINE, {"actuated": ["slew", "extend"], "locked/boom": 1.5, "end_point/rows": ["x", "y"]})
    with pytest.raises(ModelError, match=r"locked at 1\.5 rad, outside its limits -0\.5 to 1\.4"):
        read(tmp_path, URDF, machine)
    assert read(tmp_path, URDF, changed(machine, {"joints/boom/limits": [-0.5, 1.6]})).joints == ("slew", "extend")


def test_the_rest_can_be_locked_at_once(tmp_path: Path) -> None:
    tree = read(tmp_path, URDF, changed(URDF_MACHINE, {
        "locked": {}, "lock_others": True, "actuated": ["boom"], "end_point/rows": ["z"],
    }))  # fmt: skip
    assert tree.joints == ("boom",)
    held = read(
        tmp_path, MJCF, changed(MJCF_MACHINE, {"lock_others": True, "actuated": ["slew"], "end_point/rows": ["x"]})
    )
    moving = read(tmp_path, MJCF, MJCF_MACHINE)
    values = {"slew": 0.3, "heave": 0.0, "rock": 0.0, "lift": 0.0, "crowd": np.radians(15), "twist": 0.0}
    np.testing.assert_allclose(TreeOracle(held, values).end_point(), TreeOracle(moving, values).end_point(), atol=1e-14)


def test_a_mimic_joint_follows_a_locked_one(tmp_path: Path) -> None:
    """finger_b = −2 · 0.04 − 0.01 = −0.09 m, along y of the stick."""
    tree, bare = (read(tmp_path, text, machine) for text, machine in (
        (URDF, URDF_MACHINE),
        (changed_text(URDF, '<mimic joint="finger_a" multiplier="-2" offset="-0.01"/>', ""), changed(URDF_MACHINE, {"locked/finger_b": -0.09})),
    ))  # fmt: skip
    assert tree == bare


def test_joint_tables_go_before_the_file(tmp_path: Path) -> None:
    tree = read(tmp_path, URDF, changed(URDF_MACHINE, {
        "actuated": ["slew", "extend"], "end_point/rows": ["x", "z"],
        "joints/boom": {"stiffness": 5e5, "damping": 20.0, "rest": 0.3}, "joints/extend": {"limits": [0.1, 0.2], "damping": 4.0},
    }))  # fmt: skip
    joints = {body.joint.name: body.joint for body in tree.bodies}
    boom = joints["boom"]
    assert (boom.passive, boom.stiffness, boom.damping, boom.rest, boom.limits) == (True, 5e5, 20.0, 0.3, None)
    assert (joints["extend"].limits, joints["extend"].joint_damping) == ((0.1, 0.2), 4.0)


def test_a_machine_may_start_inside_a_robot(tmp_path: Path) -> None:
    tree = read(tmp_path, URDF, changed(URDF_MACHINE, {
        "root": "turret", "actuated": ["boom", "extend"], "end_point/rows": ["x", "z"],
    }))  # fmt: skip
    assert tree.coordinates == ("base.z", "base.pitch", "base.roll", "boom", "extend")
    assert sum(body.mass for body in tree.bodies) == pytest.approx(200 + 80 + 9 + 25 + 1 + 1.5)


def test_a_floating_joint_above_the_root_gives_way_to_the_base(tmp_path: Path) -> None:
    floating = (
        '<link name="world"/><joint name="fly" type="floating"><parent link="world"/><child link="chassis"/></joint>'
    )
    text = changed_text(URDF, '  <link name="chassis">', floating + '  <link name="chassis">')
    with pytest.raises(ModelError, match=r'joint .fly.: is free .* root = "chassis", on a .base.'):
        read(tmp_path, text, URDF_MACHINE)
    assert read(tmp_path, text, changed(URDF_MACHINE, {"root": "chassis"})) == read(tmp_path, URDF, URDF_MACHINE)


IGNORABLE: dict[str, tuple[str, str]] = {
    "equality": ("<actuator>", '<equality><joint joint1="slew"/></equality><actuator>'),
    "tendon": ("<actuator>", '<tendon><fixed stiffness="3"/></tendon><actuator>'),
    "gravcomp": ('body name="stick"', 'body name="stick" gravcomp="1"'),
}


@pytest.mark.parametrize("word", IGNORABLE)
def test_what_is_ignored_by_name(tmp_path: Path, word: str) -> None:
    text = changed_text(MJCF, *IGNORABLE[word])
    with pytest.raises(ModelError, match=f'ignore = ."{word}".'):
        read(tmp_path, text, MJCF_MACHINE)
    assert read(tmp_path, text, changed(MJCF_MACHINE, {"ignore": [word]})) == read(tmp_path, MJCF, MJCF_MACHINE)


MJCF_SAME: dict[str, tuple[str, str]] = {
    "equality that is off": ("<actuator>", '<equality><weld active="false"/></equality><actuator>'),
    "equality that its default turns off": (
        "<actuator>",
        '<default><equality active="false"/></default><equality><weld/></equality><actuator>',
    ),
    "tendon that pulls nothing": ("<actuator>", '<tendon><fixed name="t"/></tendon><actuator>'),
    "two worlds": ("  <actuator>", '  <worldbody><geom size="1"/></worldbody>\n  <actuator>'),
    "sensors, contacts and cameras": (
        "<actuator>",
        '<sensor><jointpos joint="slew"/></sensor><contact><exclude/></contact><actuator>',
    ),
    "camera": ('<geom type="box"', '<camera name="c"/><light/><geom type="box"'),
    "infinite range that is off": ('name="crowd"', 'range="0 0" limited="false" name="crowd"'),
    "range that is none": ('name="crowd"', 'range="0 0" name="crowd"'),
    "group": ('<geom type="box"', '<geom group="2" type="box"'),
    "quaternion of any length": ('quat="1 0 0.1 0"', 'quat="-20 0 -2 0"'),
    "visual": ("<option", '<visual><map znear="1"/></visual><statistic/><size/><option'),
}


@pytest.mark.parametrize("case", MJCF_SAME)
def test_mjcfs_that_say_the_same(tmp_path: Path, case: str) -> None:
    tree, plain = (read(tmp_path, text, MJCF_MACHINE) for text in (changed_text(MJCF, *MJCF_SAME[case]), MJCF))
    np.testing.assert_allclose(
        [p.value for p in tree.parameters], [p.value for p in plain.parameters], rtol=1e-13, atol=1e-13
    )
    assert [p.name for p in tree.parameters] == [p.name for p in plain.parameters]


def test_gravity_of_the_model_and_of_the_machine(tmp_path: Path) -> None:
    off = changed_text(MJCF, 'gravity="0 0 -9.7"/>', '><flag gravity="disable"/></option>')
    assert read(tmp_path, off, MJCF_MACHINE).gravity == 0.0
    sideways = changed_text(MJCF, 'gravity="0 0 -9.7"', 'gravity="1 0 -9.7"')
    assert read(tmp_path, sideways, changed(MJCF_MACHINE, {"gravity": 3.7})).gravity == 3.7
    assert read(tmp_path, changed_text(MJCF, ' gravity="0 0 -9.7"', ""), MJCF_MACHINE).gravity == 9.81


def test_the_whole_models_defaults_may_have_a_name(tmp_path: Path) -> None:
    """As in versions of MuJoCo before 4; a class of bodies around does not hold here."""
    plain = changed_text(MJCF, ' childclass="heavy"', "")
    named = changed_text(plain, "  <default>\n", '  <default class="whole">\n')
    assert read(tmp_path, named, MJCF_MACHINE) == read(tmp_path, plain, MJCF_MACHINE)


def test_gravity_that_is_off_stays_off(tmp_path: Path) -> None:
    """As where a scene's options come after those of the robot that it includes."""
    text = changed_text(MJCF, "<option", '<option><flag gravity="disable"/></option><option')
    model = mujoco.MjModel.from_xml_string(text.replace('<geom type="mesh" mesh="none" mass="0"/>', ""))
    assert model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    assert read(tmp_path, text, MJCF_MACHINE).gravity == 0.0


def test_a_site_between_two_points_is_mujocos(tmp_path: Path) -> None:
    site = '<site name="tip" type="capsule" size="0.01" fromto="0.1 0.2 0 1.1 0.3 -0.4"/>'
    text = changed_text(MJCF, '<site name="tip" pos="1.1 0 0.1" euler="0 40 0"/>', site)
    tree = read(tmp_path, text, changed(MJCF_MACHINE, {"end_point/offset": [0.0, 0.0, 0.2]}))
    model = mujoco.MjModel.from_xml_string(text.replace('<geom type="mesh" mesh="none" mass="0"/>', ""))
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.site("tip").quat)
    ours = np.array(tree.end_point.rotation)
    np.testing.assert_allclose(ours, turn.reshape(3, 3), atol=1e-12)
    np.testing.assert_allclose(tree.end_point.position, [0.6, 0.25, -0.2] + ours @ [0, 0, 0.2], atol=1e-12)


def test_a_body_without_a_name_has_none_of_the_others(tmp_path: Path) -> None:
    text = changed_text(changed_text(MJCF, 'name="chassis" pos', "pos"), 'body name="boom"', 'body name="body1"')
    tree = read(tmp_path, text, MJCF_MACHINE)
    assert [body.name for body in tree.bodies][:4] == ["body2.heave", "body2", "turret", "body1"]
    plain = read(tmp_path, MJCF, MJCF_MACHINE)
    assert [p.value for p in tree.parameters] == [p.value for p in plain.parameters]


def test_bodies_and_joints_without_names(tmp_path: Path) -> None:
    text = changed_text(changed_text(MJCF, ' name="twist"', ""), ' name="boom"', "")
    machine = changed(MJCF_MACHINE, {"actuated": ["slew", "lift", "crowd", "stick.joint2"]})
    tree = read(tmp_path, text, machine)
    assert [body.name for body in tree.bodies][-3:] == ["body3", "stick.crowd", "stick"]


# Classes within classes, a size given in part, joints and inertials within frames, inertials beside geoms.
FRAMED = """<mujoco>
  <compiler angle="degree" inertiafromgeom="{rule}"/>
  <default>
    <geom type="box" size="0.1 0.2 0.3" quat="1 0.2 0 0"/>
    <joint damping="2"/>
    <default class="outer">
      <joint stiffness="50" springref="10"/>
      <default class="inner"><joint axis="1 0 0"/><geom density="700"/></default>
    </default>
  </default>
  <worldbody>
    <body name="a" pos="0 0 1" childclass="outer">
      <frame pos="0.1 0.2 0.3" euler="20 30 40">
        <joint name="j1" class="inner" pos="0.2 0 0"/>
        <inertial pos="0.3 0 0" mass="3" diaginertia="1 2 2.5" euler="10 20 0"/>
        <geom size="0.5" euler="0 30 0"/>
        <body name="b" pos="1 0 0">
          <inertial pos="0.1 0.1 0" mass="2" fullinertia="1 2 2.5 0.1 0.2 0.3"/>
          <joint name="j2" pos="0.3 0.1 0" axis="0 1 1" stiffness="0" class="main"/>
          <joint name="j3" type="slide" axis="0 0 1" class="main" ref="0.2"/>
          <body name="c" childclass="inner"><joint name="j4" stiffness="0"/><geom/></body>
        </body>
      </frame>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("rule", ["auto", "true"])
@pytest.mark.parametrize("locked", [{}, {"j2": 0.4}, {"j3": 0.5, "j2": -0.2}])
def test_classes_frames_and_locked_joints_are_mujocos(tmp_path: Path, rule: str, locked: dict[str, float]) -> None:
    text = FRAMED.format(rule=rule)
    actuated = [name for name in ("j2", "j3", "j4") if name not in locked]
    tree = read(tmp_path, text, {
        "name": "framed", "robot": "framed.xml", "actuated": actuated, "locked": locked, "end_point": {"link": "c", "rows": ["x"]},
    })  # fmt: skip
    values = joint_values(tree, 1) | locked
    peer = MujocoRobot(mujoco.MjModel.from_xml_string(text))
    peer.at(values)
    names = list(tree.coordinates)
    oracle = TreeOracle(tree, values)
    assert_same(oracle.mass_matrix(names), peer.mass(names))
    assert_same(oracle.end_point(), peer.body("c"))
    spring = tree.passive_bodies[0].joint
    assert (spring.name, spring.stiffness, spring.damping) == ("j1", 50.0, 2.0)
    assert spring.rest == pytest.approx(np.radians(10), rel=1e-15)


def test_mimics_of_mimics(tmp_path: Path) -> None:
    """slew = 3 · finger_b + 0.5 = 3 · (−2 · 0.04 − 0.01) + 0.5 = 0.23 rad."""
    text = changed_text(
        URDF, '<child link="turret"/>', '<child link="turret"/><mimic joint="finger_b" multiplier="3" offset="0.5"/>'
    )
    machine = changed(URDF_MACHINE, {"actuated": ["boom", "extend"], "end_point/rows": ["x", "z"]})
    tree, held = read(tmp_path, text, machine), read(tmp_path, URDF, changed(machine, {"locked/slew": 0.23}))
    ours, theirs = ([p.value for p in t.parameters] for t in (tree, held))
    np.testing.assert_allclose(ours, theirs, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(tree.bodies[3].rotation, held.bodies[3].rotation, rtol=0, atol=1e-15)
