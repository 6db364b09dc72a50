"""Broken and odd files, one change each: the message says where and what, or the reading is right."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexopt import FlexoptWarning, ModelError, load
from flexopt.model.robots import load_robot, robot_from_dict
from tests.model.robots.files import (
    DELETE,
    MJCF,
    MJCF_MACHINE,
    URDF,
    URDF_MACHINE,
    changed,
    changed_text,
    line_of,
    read,
)

# Name of the case: what is replaced, by what, a part of the line that the message must name (None: no line), and parts
# of the sentence.
URDF_FAULTS: dict[str, tuple[str, str, str | None, list[str]]] = {
    "zero axis": ('xyz="0 -1 0"', 'xyz="0 0 0"', '<joint name="boom"', ["joint 'boom'", "axis is zero"]),
    "three numbers": ('xyz="0 0 0.6"', 'xyz="0 0"', 'xyz="0 0"', ["joint 'slew' <origin> xyz", "3 numbers", "not 2"]),
    "commas": ('xyz="0 0 0.6"', 'xyz="0,0,0.6"', 'xyz="0,0,0.6"', ["3 numbers separated by spaces"]),
    "a word": ('rpy="0 0 0.4"', 'rpy="0 0 pi"', 'rpy="0 0 pi"', ["'pi' is no number"]),
    "not finite": ('value="900"', 'value="nan"', 'value="nan"', ["'nan' is no number"]),
    "too large": ('value="900"', 'value="1e400"', 'value="1e400"', ["'1e400' is no number between ±1e+30"]),
    "negative mass": ('value="900"', 'value="-900"', "<inertial>", ["link 'chassis' <inertial> = -900", "negative"]),
    "no mass": ('<mass value="900"/>', "", "<inertial>", ["link 'chassis'", "needs <mass> and <inertia>", "massless"]),
    "a moment left out": ('izz="120"', "", 'ixx="90"', ["link 'chassis' <inertia>", "needs the attribute izz"]),
    "joint without a type": ('type="continuous"', "", '<joint name="slew"', ["joint 'slew'", "attribute type"]),
    "unknown type": ('"continuous"', '"helical"', '<joint name="slew"', ["'helical'", "revolute, continuous", "type must be"]),
    "planar": ('"continuous"', '"planar"', '<joint name="slew"', ["joint 'slew'", "two prismatic", "revolute"]),
    "floating in the arm": ('"continuous"', '"floating"', '<joint name="slew"', ["joint 'slew'", "six degrees", "[base]"]),
    "joint without a name": ('name="slew" ', "", '<joint type="continuous"', ["joint: needs the attribute name"]),
    "no parent": ('<parent link="chassis"/>', "", '<joint name="slew"', ["joint 'slew'", "needs <parent link=…>"]),
    "parent without link": ('<parent link="chassis"/>', "<parent/>", "<parent/>", ["joint 'slew' <parent>", "link"]),
    "unknown parent": ('parent link="chassis"', 'parent link="body"', '"slew"', ["parent 'body' is no link"]),
    "unknown child": ('child link="turret"', 'child link="tower"', '"slew"', ["child 'tower' is no link"]),
    "two parents": ('child link="left"', 'child link="stick"', '"finger_a"', ["'stick'", "'extend' of line", "loops"]),
    "two roots": ("</robot>", '<link name="island"/></robot>', "<robot", ["several links", "'chassis' (line 3)", "'island'"]),
    "a circle": (
        'name="weld" type="fixed">\n    <parent link="boom_link"/>',
        'name="weld" type="fixed">\n    <parent link="tool"/>',
        '"weld"', ["'bracket', 'stick'", "circle"],
    ),
    "no links": (URDF[URDF.index("  <link") : URDF.index("</robot>")], "", "<robot", ["has no <link>"]),
    "link names": ('link name="left"', 'link name="turret"', None, ["arm.urdf:68: link 'turret': the name is taken by the link of line"]),
    "joint names": ('name="weld"', 'name="boom"', 'name="boom" type="fixed"', ["name is taken by the joint of line"]),
    "no limit": ('<limit lower="-0.5" upper="1.4" effort="1" velocity="1"/>', "", '"boom"', ["needs <limit", "continuous"]),
    "limits reversed": ('lower="-0.5"', 'lower="2"', 'lower="2"', ["joint 'boom' <limit> = 2, 1.4", "lower exceeds upper"]),
    "limits without room": ('upper="0.8"', 'upper="0"', '"extend"', ["(0 to 0 m) leave no room", "[joints.extend]"]),
    "negative damping": ('damping="0.7"', 'damping="-1"', 'damping="-1"', ["joint 'slew' <dynamics> = -1", "negative"]),
    "negative effort": ('upper="0.8" effort="1"', 'upper="0.8" effort="-1"', 'upper="0.8"', ["joint 'extend' <limit> = -1", "effort must not"]),
    "effort in words": ('upper="0.8" effort="1"', 'upper="0.8" effort="much"', 'upper="0.8"', ["<limit> effort", "'much' is no number"]),
    "mimics nobody": ('mimic joint="finger_a"', 'mimic joint="thumb"', '"finger_b"', ["mimics 'thumb'", "`locked`"]),
    "mimics itself": ('mimic joint="finger_a"', 'mimic joint="finger_b"', '"finger_b"', ["follows itself"]),
    "mimic beyond its limit": ('offset="-0.01"', 'offset="-0.2"', '"finger_b"', ["locked at -0.28 m", "-0.2 to 0"]),
    "xacro tag": ('<link name="tool"/>', '<xacro:tool/>', "<xacro:tool/>", ["is xacro", "xacro robot.urdf.xacro > robot.urdf"]),
    "xacro value": ('value="900"', 'value="${m}"', 'value="${m}"', ["is xacro"]),
    "no inertia that a body has": (
        '<mass value="25"/>\n      <inertia ixx="0.5"', '<mass value="25"/>\n      <inertia ixx="-9"',
        'link name="stick"', ["link 'stick' inertia", "negative principal moment"],
    ),
    "cut short": ("</robot>", "", None, ["arm.urdf:", "not well-formed XML"]),
    "unclosed": ('<link name="tool"/>', '<link name="tool">', "</robot>", ["not well-formed XML: mismatched tag"]),
    "entities": (
        "<robot", '<!DOCTYPE r [<!ENTITY a "b">]>\n<robot', "<!DOCTYPE", ["document type declaration (DOCTYPE) is refused"],
    ),
    "SDF": (URDF[URDF.index("<robot") :], "<sdf version='1.7'/>", "<sdf", ["<sdf>, not <robot>", "SDF to URDF"]),
    "not XML": (URDF, "solid stl", "solid", ["arm.urdf:1", "not well-formed XML"]),
    "two at once": ('xyz="0 0 0.6" rpy="0 0 0.4"', 'xyz="a 0 0" rpy="0"', '"a 0 0"', ["2 faults", "'a' is no number", "not 1"]),
}  # fmt: skip

MJCF_FAULTS: dict[str, tuple[str, str, str | None, list[str]]] = {
    "ball": ('name="slew" range="-170 170"', 'name="slew" type="ball"', '"slew"', ["joint 'slew'", "ball joint", "three hinges"]),
    "free in the arm": ('name="slew" range="-170 170"', 'name="slew" type="free"', '"slew"', ["six degrees", "[base]"]),
    "unknown type": ('type="slide"', 'type="screw"', '"heave"', ["type must be hinge or slide", "'screw'"]),
    "zero axis": ('axis="0 -2 0"', 'axis="0 0 0"', '"lift"', ["joint 'lift'", "axis is zero"]),
    "range reversed": ('range="-30 80"', 'range="80 -30"', '"lift"', ["joint 'lift' = 80 -30", "lower end below"]),
    "limited without range": ('range="-30 80"', 'limited="true"', '"lift"', ["= missing", "needs a range"]),
    "range without limited": ('autolimits="true"', 'autolimits="false"', '"slew"', ["range but not limited", "autolimits"]),
    "limited maybe": ('range="-30 80"', 'limited="maybe"', '"lift"', ["limited must be auto or true or false", "'maybe'"]),
    "springdamper": ('axis="0 -2 0"', 'springdamper="0.1 1"', '"lift"', ["springdamper", "say stiffness and damping"]),
    "polynomial spring": ('stiffness="4e5"', 'stiffness="4e5 2"', '"heave"', ["stiffness is a polynomial"]),
    "negative stiffness": ('stiffness="4e5"', 'stiffness="-4"', '"heave"', ["joint 'heave' = -4", "not be negative"]),
    "negative armature": ('axis="0 -2 0"', 'axis="0 -2 0" armature="-0.3"', '"lift"', ["joint 'lift' = -0.3", "not be negative"]),
    "gear of nothing": ('<motor joint="slew"/>', '<motor joint="slew" gear=""/>', "<motor", ["motor gear", "not 0"]),
    "no mass in inertial": ('mass="60" ', "", "<inertial", ["body 'boom' <inertial>", "attribute mass"]),
    "two tensors": ('mass="60"', 'mass="60" fullinertia="1 1 1 0 0 0"', "<inertial", ["either diaginertia or fullinertia"]),
    "mesh": ('mesh="none" mass="0"', 'mesh="none"', '<body name="chassis"', ["body 'chassis'", "mesh (line 17)", "<inertial>"]),
    "shell": ('size="0.6 0.4 0.2"', 'size="1 1 1" shellinertia="true"', '<body name="chassis"', ["shell", "<inertial>"]),
    "geom without size": ('size="0.6 0.4 0.2"', 'size="0.6 0.4"', 'size="0.6 0.4"', ["body 'chassis' <geom>", "box needs 3"]),
    "geom of no kind": ('type="box"', 'type="cone"', 'type="cone"', ["type must be sphere or capsule", "'cone'"]),
    "negative density": ('density="2000"', 'density="-1"', '<geom type="box"', ["<geom> = -1", "density must not be negative"]),
    "fromto of no length": ('fromto="0 0 0 1 0 0.1"', 'fromto="1 1 1 1 1 1"', '"1 1 1 1 1 1"', ["fromto has no length"]),
    "parallel axes": ('xyaxes="1 0 0.2 0 1 0"', 'xyaxes="1 0 0 2 0 0"', '"1 0 0 2 0 0"', ["body 'boom'", "xyaxes", "parallel"]),
    "zero quaternion": ('quat="1 0 0.1 0"', 'quat="0 0 0 0"', '"0 0 0 0"', ["quat tells no orientation"]),
    "zero zaxis": ('zaxis="0.1 0 1"', 'zaxis="0 0 0"', 'zaxis="0 0 0"', ["zaxis tells no orientation"]),
    "zero turning axis": ('axisangle="1 0 0 30"', 'axisangle="0 0 0 30"', '"0 0 0 30"', ["axisangle tells no orientation"]),
    "two orientations": ('zaxis="0.1 0 1"', 'zaxis="0 0 1" euler="0 0 0"', 'name="turret"', ["zaxis and euler"]),
    "global coordinates": ('angle="degree"', 'coordinate="global"', "<compiler", ["compiler = global", "coordinate must be local"]),
    "grads": ('angle="degree"', 'angle="grad"', "<compiler", ["angle must be degree or radian", "'grad'"]),
    "euler sequence": ('angle="degree"', 'eulerseq="xyw"', "<compiler", ["eulerseq must be three letters", "'xyw'"]),
    "unknown class": ('childclass="heavy"', 'childclass="light"', '"heave"', ["class 'light' is no <default>"]),
    "class twice": ("</default>\n  <worldbody>", '<default class="heavy"/></default>\n  <worldbody>', 'class="heavy"/>', ["twice"]),
    "default without class": ('<default class="heavy">', "<default>", "    <default>", ["default: needs the attribute class"]),
    "replicate": ('<geom type="box"', '<replicate count="3"/><geom type="box"', "<replicate", ["<replicate> is not read"]),
    "unknown section": ("<keyframe>", "<keyframes/><keyframe>", "<keyframes/>", ["mujoco: unknown element <keyframes>", "did you mean 'keyframe'?"]),
    "no body": (MJCF[MJCF.index('    <body name="chassis"') : MJCF.index("  </worldbody>")], "", "<mujoco", ["has no <body>"]),
    "body names": ('body name="stick"', 'body name="boom"', '<body name="boom" pos="2 0 0"', ["taken by the body of line"]),
    "joint names": ('name="twist"', 'name="slew"', 'name="slew" axis', ["taken by the joint of line"]),
    "equality": (
        "<actuator>", '<equality><joint joint1="slew"/></equality><actuator>', "<equality>",
        ["equality constraint", 'ignore = ["equality"]'],
    ),
    "tendon": (
        "<actuator>", '<tendon><fixed stiffness="3"/></tendon><actuator>', "<tendon>", ["tendon with stiffness", 'ignore = ["tendon"]'],
    ),
    "gravcomp": ('body name="stick"', 'body name="stick" gravcomp="1"', 'name="stick"', ["gravcomp", 'ignore = ["gravcomp"]']),
    "sideways gravity": ('gravity="0 0 -9.7"', 'gravity="1 0 -9.7"', "<option", ["option = 1 0 -9.7", "must point along -z"]),
    "springs off": ('gravity="0 0 -9.7"/>', '><flag spring="disable"/></option>', "<flag", ["spring is disabled"]),
    "flexible body": ("<actuator>", "<deformable><flex/></deformable><actuator>", "<flex/>", ["flexible bodies are not read"]),
    "include of nothing": ("<actuator>", '<include/><actuator>', "<include/>", ["include: needs the attribute file"]),
    "include that is absent": ("<actuator>", '<include file="gone.xml"/><actuator>', None, ["gone.xml: cannot be read"]),
    "include of itself": ("<actuator>", '<include file="arm.xml"/><actuator>', "<include", ["included twice, or includes itself"]),
    "neither driven nor sprung": ('stiffness="4e5"', "", '"heave"', ["neither listed in `actuated`", "[joints.heave]", "lock_others"]),
    "driven and sprung": ('axis="0 -2 0"', 'axis="0 1 0" stiffness="7"', '"lift"', ["is actuated and has a spring (7)", "stiffness = 0"]),
}  # fmt: skip

# Changes of the machine file, and parts of the message.
MACHINE_FAULTS: dict[str, tuple[dict[str, Any], list[str]]] = {
    "no robot": ({"robot": DELETE}, ["robot: is required and missing"]),
    "robot file absent": ({"robot": "none.urdf"}, ["robot = 'none.urdf'", "cannot be read (No such file"]),
    "robot is a folder": ({"robot": "."}, ["cannot be read"]),
    "no actuated": ({"actuated": DELETE}, ["actuated: is required and missing"]),
    "unknown joint": ({"actuated": ["slew", "bom", "extend"]}, ["actuated = 'bom'", "did you mean 'boom'?"]),
    "fixed joint actuated": ({"actuated": ["slew", "boom", "extend", "weld"]}, ["'weld': is no joint that moves"]),
    "listed twice": ({"actuated": ["slew", "boom", "extend", "boom"]}, ["actuated = 'boom': is listed twice"]),
    "locked and actuated": ({"locked/boom": 0.0}, ["locked.boom: is also listed as actuated"]),
    "locked beyond": ({"locked/finger_a": 0.3}, ["arm.urdf:62: joint 'finger_a'", "locked at 0.3 m", "0 to 0.1"]),
    "locked by a word": ({"locked/finger_a": "open"}, ["locked.finger_a = 'open'", "must be a number"]),
    "locked as a list": ({"locked": ["finger_a"]}, ["locked = ['finger_a']: must be a table"]),
    "mimic of a moving joint": (
        {"locked": {}, "actuated": ["slew", "boom", "extend", "finger_a"]}, ["'finger_b'", "mimics 'finger_a', which moves"],
    ),
    "unknown key": ({"actuatd": []}, ["actuatd: unknown key; did you mean 'actuated'?"]),
    "unknown table of a joint": ({"joints/bom/stiffness": 1.0}, ["joints = 'bom'", "did you mean 'boom'?"]),
    "unknown key of a joint": ({"joints/boom/stifness": 1.0}, ["joints.boom.stifness: unknown key"]),
    "limits of a sprung joint": (
        {"joints/boom": {"stiffness": 5.0, "limits": [0.0, 1.0]}, "actuated": ["slew", "extend"], "end_point/rows": ["x", "z"]},
        ["joints.boom.limits = [0.0, 1.0]", "belongs to an actuated joint"],
    ),
    "rest of a driven joint": ({"joints/boom/rest": 0.2}, ["joints.boom.rest = 0.2", "this one is actuated"]),
    "negative spring": ({"joints/boom/stiffness": -1.0}, ["joints.boom.stiffness = -1.0", "between 0 and"]),
    "unknown direction": ({"base/stiffness": {"x": 1.0, "rol": 2.0}}, ["base.stiffness", "'rol' is no direction", "'roll'?"]),
    "zero stiffness": ({"base/stiffness/z": 0.0}, ["z must be greater than 0", "N/m"]),
    "rotational unit": ({"base/stiffness/roll": -1.0}, ["roll must be greater than 0", "N m/rad"]),
    "five stiffnesses": ({"base/stiffness": [1.0] * 5}, ["table of x, y, z, roll, pitch, yaw", "six numbers", "6 × 6"]),
    "matrix not symmetric": (
        {"base/stiffness": [[float(i == j) + (i == 0) * (j == 1) for j in range(6)] for i in range(6)], "base/damping": {}},
        ["base.stiffness", "must be symmetric: [0][1] is"],
    ),
    "matrix not definite": (
        {"base/stiffness": [[1.0] * 6 for _ in range(6)], "base/damping": {}}, ["base.stiffness", "positive definite"],
    ),
    "damping matrix on a rigid direction": (
        {"base/damping": [[float(i == j) for j in range(6)] for i in range(6)]}, ["base.damping", "all six directions"],
    ),
    "damping without stiffness": ({"base/damping/x": 1.0}, ["base.damping.x: needs base.stiffness.x"]),
    "base without stiffness": ({"base/stiffness": DELETE}, ["base.stiffness: is required and missing"]),
    "base without a direction": ({"base/stiffness": {}, "base/damping": {}}, ["names no direction; leave [base] out"]),
    "nothing passive": ({"base": DELETE}, ["base: no passive coordinate", "[joints.NAME]"]),
    "no end-point": ({"end_point": DELETE}, ["end_point: is required and missing"]),
    "end-point nowhere": ({"end_point": {}}, ["end_point: needs either link", "or site"]),
    "end-point twice": ({"end_point/site": "tip"}, ["end_point: needs either link", "or site"]),
    "unknown link": ({"end_point/link": "tol"}, ["end_point.link = 'tol'", "did you mean 'tool'?"]),
    "site of a URDF": ({"end_point": {"site": "tip"}}, ["end_point.site = 'tip'", "the file has none"]),
    "end-point on the ground": ({"base": DELETE, "end_point/link": "chassis"}, ["end_point.link = 'chassis'", "fixed to the ground"]),
    "unknown row": ({"end_point/rows": ["x", "w"]}, ["end_point.rows[1]", "x, y, z, roll, pitch or yaw"]),
    "more rows than joints": ({"end_point/rows": ["x", "y", "z", "yaw"]}, ["4 task rows need at least 4 actuated joints"]),
    "unknown placement": ({"placement": ["x", "z"]}, ["placement[1]", "x, y or yaw"]),
    "unknown root": ({"root": "chasis"}, ["root = 'chasis'", "did you mean 'chassis'?"]),
    "joint above the root": ({"root": "boom_link"}, ["actuated = 'slew': is no joint below the root link"]),
    "unknown word to ignore": ({"ignore": ["friction"]}, ["ignore[0]", "armature, equality, tendon, gravcomp or unknown"]),
    "rotation that is none": ({"base/rotation": [[1.0, 0.0, 0.0]] * 3}, ["base.rotation", "is no rotation"]),
    "schema of tomorrow": ({"schema": 2}, ["schema = 2", "version 1"]),
    "both files faulty": ({"robot": "none.urdf", "gravity": -1.0}, ["2 faults", "none.urdf", "gravity = -1.0"]),
}  # fmt: skip


def assert_message(error: ModelError, parts: list[str]) -> None:
    message = str(error)
    for part in parts:
        assert part in message, message
    assert message.startswith("machine.toml")


@pytest.mark.parametrize("case", URDF_FAULTS)
def test_urdf_faults(tmp_path: Path, case: str) -> None:
    check_fault(tmp_path, URDF, URDF_MACHINE, *URDF_FAULTS[case])


@pytest.mark.parametrize("case", MJCF_FAULTS)
def test_mjcf_faults(tmp_path: Path, case: str) -> None:
    check_fault(tmp_path, MJCF, MJCF_MACHINE, *MJCF_FAULTS[case])


def check_fault(
    folder: Path, text: str, machine: dict[str, Any], old: str, new: str, line_part: str | None, parts: list[str]
) -> None:
    text = changed_text(text, old, new)
    with pytest.raises(ModelError) as caught:
        read(folder, text, machine)
    place = [] if line_part is None else [f"{machine['robot']}:{line_of(text, line_part)}"]
    assert_message(caught.value, place + parts)


@pytest.mark.parametrize("case", MACHINE_FAULTS)
def test_machine_file_faults(tmp_path: Path, case: str) -> None:
    changes, parts = MACHINE_FAULTS[case]
    tmp_path.joinpath("arm.urdf").write_text(URDF)
    machine = changed(URDF_MACHINE, changes)
    with pytest.raises(ModelError) as caught:
        robot_from_dict(machine, folder=tmp_path, origin="machine.toml")
    assert_message(caught.value, parts)


def test_a_file_of_a_machine_in_space_that_names_no_robot_is_told_that_alone(tmp_path: Path) -> None:
    """Not that it lacks what a planar machine has."""
    file = tmp_path / "machine.toml"
    file.write_text(
        """name = "arm"
        actuated = ["boom"]
        base = { stiffness = { z = 4e6, roll = 2e6 } }
        end_point = { link = "tool" }"""
    )
    with pytest.raises(ModelError) as caught:
        load(file)
    assert str(caught.value) == f"{file}: robot: is required and missing"
    # By any of its keys; a planar one that misspells `links` is none of these.
    for told in ("base.stiffness.roll = 2e6", "joints.boom.effort = 5.0", "end_point.link = 'tool'"):
        file.write_text(f'name = "arm"\n{told}')
        with pytest.raises(ModelError, match="robot: is required and missing") as caught:
            load(file)
        assert "rest_angle" not in str(caught.value)
    file.write_text('name = "arm"\n[[link]]\nlength = 1.0\n[base]\nstiffness = {z = 1e5}')
    with pytest.raises(ModelError, match="did you mean 'links'") as caught:
        load(file)
    assert "robot" not in str(caught.value)


def test_one_change_is_one_fault(tmp_path: Path) -> None:
    """What follows from a fault is not reported beside it."""
    for old, new in (('xyz="0 -1 0"', 'xyz="0 0 0"'), ('value="900"', 'value="-1"'), ('type="continuous"', 'type="x"')):
        with pytest.raises(ModelError) as caught:
            read(tmp_path, changed_text(URDF, old, new), URDF_MACHINE)
        assert len(caught.value.faults) == 1, caught.value


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        (None, ["machine.toml", "No such file"]),
        (b"name = ", ["is not valid TOML"]),
        (b"\xff\xfe", ["is not valid TOML", "UTF-8"]),
        (b"x = " + b"[" * 5000, ["is not valid TOML"]),
    ],
)
def test_machine_files_that_are_none(tmp_path: Path, content: bytes | None, parts: list[str]) -> None:
    path = tmp_path / "machine.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ModelError) as caught:
        load_robot(path)
    assert all(part in str(caught.value) for part in parts), caught.value


def test_deep_files_are_refused(tmp_path: Path) -> None:
    text = "<robot>" + "<a>" * 300 + "</a>" * 300 + "</robot>"
    with pytest.raises(ModelError, match="nested more than 200 deep"):
        read(tmp_path, text, URDF_MACHINE)
    deep = '<body><joint stiffness="1"/><geom size=".1"/>' * 190 + "</body>" * 190
    machine = changed(MJCF_MACHINE, {"actuated": [], "end_point": {"link": "body190", "rows": ["x"]}})
    with pytest.raises(ModelError, match="0"):
        read(tmp_path, f"<mujoco><worldbody>{deep}</worldbody></mujoco>", machine)


def read_or_faults(folder: Path, text: str, machine: dict[str, Any]) -> tuple[Any, ...]:
    """The bodies, or the faults; both have at least one."""
    try:
        return read(folder, text, machine).bodies
    except ModelError as error:
        return error.faults


WORDS = [
    "",
    " ",
    "0",
    "-1",
    "nan",
    "1e29",
    "1e-29",
    "-1e29",
    "0 0 0",
    "1 2 3 4",
    "a",
    "é",
    "true",
    "slew",
    "mesh",
    "boom",
]


@pytest.mark.long
@settings(max_examples=150)
@given(st.sampled_from(["urdf", "xml"]), st.integers(0, 10**6), st.sampled_from(WORDS), st.booleans())
def test_any_changed_attribute_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, kind: str, index: int, word: str, twice: bool
) -> None:
    """Every attribute in turn replaced by a word that may not fit: a tree or a `ModelError`, never another exception."""
    text, machine = (URDF, URDF_MACHINE) if kind == "urdf" else (MJCF, MJCF_MACHINE)
    for step in range(1 + twice):
        found = list(re.finditer(r'="([^"]*)"', text))
        match = found[(index + 17 * step) % len(found)]
        text = text[: match.start(1)] + word + text[match.end(1) :]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FlexoptWarning)
        result = read_or_faults(tmp_path_factory.mktemp("any"), text, machine)
    assert result


@settings(max_examples=100)
@given(st.sampled_from([URDF, MJCF]), st.integers(0, 10**6), st.integers(0, 10**6))
def test_any_removed_element_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, text: str, first: int, second: int
) -> None:
    for index in (first, second):
        found = list(re.finditer(r"<[^<>?]*/>", text))
        match = found[index % len(found)]
        text = text[: match.start()] + text[match.end() :]
    machine = URDF_MACHINE if "<robot" in text else MJCF_MACHINE
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FlexoptWarning)
        result = read_or_faults(tmp_path_factory.mktemp("any"), text, machine)
    assert result


def test_two_machines_need_a_root(tmp_path: Path) -> None:
    text = changed_text(
        MJCF, "  </worldbody>", '<body name="other"><joint name="o"/><geom size=".1"/></body></worldbody>'
    )
    machine = changed(MJCF_MACHINE, {"base": {"stiffness": {"z": 1e5}}})
    with pytest.raises(ModelError) as caught:
        read(tmp_path, text, machine)
    assert_message(caught.value, ["root: is needed: which of 'chassis', 'other' stands on [base]?"])
    assert len(caught.value.faults) == 1
    alone = read(tmp_path, text, machine | {"root": "chassis"})
    assert alone == read(tmp_path, MJCF, machine)
