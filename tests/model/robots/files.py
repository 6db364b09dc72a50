"""A small machine in both formats, and how tests change it by one line and read it again."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

from flexopt.model.robots import robot_from_dict
from flexopt.model.tree import Tree

URDF = """<?xml version="1.0"?>
<robot name="arm">
  <link name="chassis">
    <inertial>
      <origin xyz="0.1 0 0.3" rpy="0.1 0.2 0.3"/>
      <mass value="900"/>
      <inertia ixx="90" ixy="2" ixz="-3" iyy="110" iyz="1" izz="120"/>
    </inertial>
    <visual><geometry><mesh filename="package://nowhere/chassis.stl"/></geometry></visual>
  </link>
  <joint name="slew" type="continuous">
    <parent link="chassis"/>
    <child link="turret"/>
    <origin xyz="0 0 0.6" rpy="0 0 0.4"/>
    <axis xyz="0 0 1"/>
    <dynamics damping="0.7"/>
  </joint>
  <link name="turret">
    <inertial>
      <mass value="200"/>
      <inertia ixx="20" ixy="0" ixz="0" iyy="18" iyz="0" izz="22"/>
    </inertial>
  </link>
  <joint name="boom" type="revolute">
    <parent link="turret"/>
    <child link="boom_link"/>
    <origin xyz="0.3 0.1 0.2" rpy="-0.2 0.1 0"/>
    <axis xyz="0 -1 0"/>
    <limit lower="-0.5" upper="1.4" effort="1" velocity="1"/>
  </joint>
  <link name="boom_link">
    <inertial>
      <origin xyz="1 0 0"/>
      <mass value="80"/>
      <inertia ixx="3" ixy="0" ixz="0" iyy="30" iyz="0" izz="31"/>
    </inertial>
  </link>
  <joint name="weld" type="fixed">
    <parent link="boom_link"/>
    <child link="bracket"/>
    <origin xyz="2 0 0.1" rpy="0 0.5 0"/>
  </joint>
  <link name="bracket">
    <inertial>
      <origin xyz="0 0.1 0"/>
      <mass value="9"/>
      <inertia ixx="0.2" ixy="0.01" ixz="0" iyy="0.3" iyz="0" izz="0.4"/>
    </inertial>
  </link>
  <joint name="extend" type="prismatic">
    <parent link="bracket"/>
    <child link="stick"/>
    <axis xyz="3 0 4"/>
    <limit lower="0" upper="0.8" effort="1" velocity="1"/>
  </joint>
  <link name="stick">
    <inertial>
      <mass value="25"/>
      <inertia ixx="0.5" ixy="0" ixz="0" iyy="2" iyz="0" izz="2"/>
    </inertial>
  </link>
  <joint name="finger_a" type="prismatic">
    <parent link="stick"/>
    <child link="left"/>
    <axis xyz="0 1 0"/>
    <limit lower="0" upper="0.1" effort="1" velocity="1"/>
  </joint>
  <link name="left">
    <inertial>
      <mass value="1"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>
    </inertial>
  </link>
  <joint name="finger_b" type="prismatic">
    <parent link="stick"/>
    <child link="right"/>
    <axis xyz="0 1 0"/>
    <limit lower="-0.2" upper="0" effort="1" velocity="1"/>
    <mimic joint="finger_a" multiplier="-2" offset="-0.01"/>
  </joint>
  <link name="right">
    <inertial>
      <mass value="1.5"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>
    </inertial>
  </link>
  <joint name="flange" type="fixed">
    <parent link="stick"/>
    <child link="tool"/>
    <origin xyz="0.9 0 0" rpy="0 1 0.5"/>
  </joint>
  <link name="tool"/>
  <material name="paint"><color rgba="1 1 0 1"/></material>
</robot>
"""

MJCF = """<mujoco model="arm">
  <compiler angle="degree" autolimits="true"/>
  <option gravity="0 0 -9.7"/>
  <default>
    <joint damping="0.5"/>
    <default class="heavy">
      <geom density="2000"/>
      <joint damping="3"/>
    </default>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="9 9 1"/>
    <body name="chassis" pos="0.1 0.2 0.3" euler="5 -10 20" childclass="heavy">
      <joint name="heave" type="slide" axis="0 0 1" stiffness="4e5" springref="0.02" ref="0.1"/>
      <joint name="rock" axis="1 1 0" pos="0.1 0 -0.2" stiffness="3e4" springref="-3" ref="7"/>
      <geom type="box" size="0.6 0.4 0.2"/>
      <geom type="mesh" mesh="none" mass="0"/>
      <body name="turret" pos="0 0 0.5" zaxis="0.1 0 1">
        <joint name="slew" range="-170 170" damping="1.5"/>
        <geom type="cylinder" size="0.3 0.1" axisangle="1 0 0 30"/>
        <frame pos="0 0.1 0" euler="0 0 30">
          <geom type="ellipsoid" size="0.1 0.2 0.3" mass="4"/>
          <body name="boom" pos="0.3 0 0.1" xyaxes="1 0 0.2 0 1 0">
            <joint name="lift" axis="0 -2 0" pos="0 0 0.05" range="-30 80"/>
            <inertial pos="1 0 0" mass="60" diaginertia="2 25 26" quat="1 0.1 0 0"/>
            <geom type="capsule" fromto="0 0 0 2 0 0" size="0.1"/>
            <body name="stick" pos="2 0 0" quat="1 0 0.1 0">
              <joint name="crowd" axis="0 1 0" ref="15"/>
              <joint name="twist" axis="1 0 0"/>
              <geom type="capsule" fromto="0 0 0 1 0 0.1" size="0.05"/>
              <geom type="sphere" size="0.1" pos="1 0 0.1"/>
              <site name="tip" pos="1.1 0 0.1" euler="0 40 0"/>
            </body>
          </body>
        </frame>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="slew"/>
  </actuator>
  <keyframe>
    <key name="home" qpos="0 0 0 0 0 0"/>
  </keyframe>
</mujoco>
"""

URDF_MACHINE: dict[str, Any] = {
    "name": "arm on tracks",
    "robot": "arm.urdf",
    "actuated": ["slew", "boom", "extend"],
    "locked": {"finger_a": 0.04},
    "base": {
        "stiffness": {"z": 4e6, "roll": 2e6, "pitch": 3e6},
        "damping": {"z": 2e4},
        "point": [0.1, 0.2, -0.4],
        "position": [0.0, 0.0, 0.5],
        "rotation": [0.0, 0.1, 0.2],
    },
    "end_point": {"link": "tool", "offset": [0.0, 0.0, 0.1]},
}
MJCF_MACHINE: dict[str, Any] = {
    "name": "arm",
    "robot": "arm.xml",
    "actuated": ["slew", "lift", "crowd", "twist"],
    "end_point": {"site": "tip"},
}

DELETE = object()


def changed_text(text: str, old: str, new: str) -> str:
    """`text` with one place changed, which must be there."""
    assert old in text, old
    return text.replace(old, new, 1)


def changed(data: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """`data` with values at dotted paths replaced or deleted."""
    data = copy.deepcopy(data)
    for path, value in changes.items():
        here: Any = data
        *before, last = path.split("/")
        for key in before:
            here = here.setdefault(key, {})
        if value is DELETE:
            del here[last]
        else:
            here[last] = value
    return data


def read(folder: Path, text: str, machine: dict[str, Any]) -> Tree:
    """Write the robot file and read the machine around it."""
    folder.joinpath(machine["robot"]).write_text(text, encoding="utf-8")
    return robot_from_dict(machine, folder=folder, origin="machine.toml")


def line_of(text: str, part: str) -> int:
    """The line of the file in which `part` stands first."""
    return text[: text.index(part)].count("\n") + 1
