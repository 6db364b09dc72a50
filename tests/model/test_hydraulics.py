"""Cylinders in machine files: what is read, which ranges follow from strokes, and what is refused by name."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import flexopt
from flexopt import ModelError
from flexopt.model import tree_from_dict
from flexopt.model.strokes import last_inside
from tests.model.robots.files import MJCF, MJCF_MACHINE, URDF, URDF_MACHINE, changed, changed_text, read
from tests.oracles.cylinders import digger, digger_in_space, length_in_plane
from tests.oracles.spatial import in_space

DELETED = object()


def message(data: dict[str, Any]) -> str:
    with pytest.raises(ModelError) as caught:
        flexopt.machine_from_dict(data)
    return str(caught.value)


def with_cylinder(index: int, **keys: Any) -> dict[str, Any]:
    data = digger()
    for key, value in keys.items():
        if value is DELETED:
            del data["cylinders"][index][key]
        else:
            data["cylinders"][index][key] = value
    return data


def with_rocker(**keys: Any) -> dict[str, Any]:
    data = digger()
    data["cylinders"][2]["rocker"] |= keys
    return data


def test_cylinders_come_back_as_they_were_given() -> None:
    machine = flexopt.machine_from_dict(digger())
    again = flexopt.machine_from_dict(json.loads(json.dumps(machine.to_dict())))
    assert again == machine
    assert again.content_hash == machine.content_hash
    assert machine.cylinders[1].lever_sign == -1
    assert machine.cylinders[2].rocker is not None
    assert machine.cylinders[2].rocker.rod_offset == (0.0, 0.0)
    other = flexopt.machine_from_dict(with_rocker(coupler=0.281))
    assert other.content_hash != machine.content_hash
    assert flexopt.load("excavator").cylinders == ()


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (
            with_cylinder(0, joint="bom"),
            ["cylinders[0] (boom cylinder).joint = 'bom'", "no joint's name", "boom, stick"],
        ),
        (with_cylinder(1, joint="boom"), ["cylinders[1] (stick cylinder).joint = 'boom'", "driven by 'boom cylinder'"]),
        (with_cylinder(1, name="boom cylinder"), ["cylinders[1] (boom cylinder).name", "taken by an earlier cylinder"]),
        (with_cylinder(0, name=DELETED), ["cylinders[0].name", "required"]),
        (with_cylinder(0, base_point=DELETED), ["cylinders[0] (boom cylinder).base_point", "required"]),
        (with_cylinder(0, rod_point=DELETED), ["cylinders[0] (boom cylinder)", "either rod_point or", "rocker"]),
        (with_cylinder(2, rod_point=[0.1, 0.1]), ["cylinders[2] (bucket cylinder)", "either rod_point or"]),
        (with_cylinder(0, offset=0.3), ["cylinders[0] (boom cylinder).offset = 0.3", "slide"]),
        (with_cylinder(0, rod_point=[0.1, 0.1, 0.2]), ["(boom cylinder).rod_point", "two numbers [along, left]"]),
        (with_cylinder(0, rod_point=[0.1, "a"]), ["(boom cylinder).rod_point", "left must be a number"]),
        (with_rocker(pivot=[0.1, 0.1, 0.2]), ["(bucket cylinder).rocker.pivot", "two numbers [along, left]"]),
        (with_rocker(branch=0), ["(bucket cylinder).rocker.branch = 0", "-1 or 1"]),
        (with_rocker(length=-0.3), ["rocker.length = -0.3", "greater than 0", "m"]),
        (with_rocker(rod_offset=[0.1]), ["rocker.rod_offset", "pair [along, left] in m"]),
        (with_rocker(link=1), ["rocker.link", "unknown key"]),
        (with_cylinder(0, length=[1.4, 0.7]), ["(boom cylinder).length = [1.4, 0.7]", "reversed"]),
        (with_cylinder(0, length=[0.0, 0.7]), ["(boom cylinder).length = [0.0, 0.7]", "greater than 0"]),
        (with_cylinder(0, length=[0.7, 1e5]), ["(boom cylinder).length", "10000 m"]),
        (with_cylinder(0, speed=[0.2, 0.0]), ["(boom cylinder).speed", "greater than 0", "m/s"]),
        (with_cylinder(0, speed=0.2), ["(boom cylinder).speed", "[retracting, extending] in m/s"]),
        (with_cylinder(0, speed=DELETED), ["(boom cylinder).speed", "required"]),
        (with_cylinder(0, force=[-1.0, 2.0]), ["(boom cylinder).force", "pull must lie between 0", "N"]),
        (with_cylinder(0, force=[0.0, 0.0]), ["(boom cylinder).force", "must not be zero both ways"]),
        (with_cylinder(0, lever_sign=2), ["(boom cylinder).lever_sign = 2", "-1 or 1"]),
        (with_cylinder(0, dead_band=1.0), ["(boom cylinder).dead_band = 1.0", "between 0 and 0.9"]),
        (with_cylinder(0, length=[2.0, 2.4]), ["(boom cylinder).length = [2, 2.4]", "never reached", "-1 to 0.3 rad"]),
        (with_cylinder(0, bore=0.1), ["cylinders[0] (boom cylinder).bore", "unknown key"]),
        (digger() | {"cylinders": 3}, ["cylinders = 3", "must be a list"]),
        (digger() | {"cylinders": [3]}, ["cylinders[0] = 3", "must be a table"]),
    ],
)
def test_what_is_wrong_is_named(data: dict[str, Any], expected: list[str]) -> None:
    text = message(data)
    for part in expected:
        assert part in text


def test_every_fault_is_listed() -> None:
    data = with_cylinder(0, speed=[0.2, 0.0], joint="bom")
    data["cylinders"][2]["rocker"]["branch"] = 7
    data["links"][0]["mass"] = -1.0
    with pytest.raises(ModelError) as caught:
        flexopt.machine_from_dict(data)
    fields = {fault.field for fault in caught.value.faults}
    where = "cylinders[0] (boom cylinder)"
    wanted = {f"{where}.speed", f"{where}.joint", "cylinders[2] (bucket cylinder).rocker.branch"}
    assert wanted | {"links[0] (boom).mass"} <= fields


def test_a_cylinder_of_another_machine_is_refused() -> None:
    """Its pins would be taken for 0."""
    machine = flexopt.load("boom-stick-bucket")
    other = machine.cylinders[0].model_copy(update={"name": "other"})
    with pytest.raises(flexopt.InputError, match="must be one of `cylinders`"):
        machine.travel(other)


def test_a_passive_joint_is_not_driven() -> None:
    data = digger()
    data["links"].insert(1, {"name": "knuckle", "length": 0.1, "com": 0.05, "mass": 1.0, "inertia": 1.0,
                             "passive": True, "stiffness": 1e6, "rest": 0.0})  # fmt: skip
    data["cylinders"][0]["joint"] = "knuckle"
    assert "is a passive joint" in message(data)


def without_limits(index: int) -> dict[str, Any]:
    data = digger()
    del data["links"][index]["limits"]
    return data


def angles_of_extremes(data: dict[str, Any], index: int, parent: float) -> list[float]:
    """Where a direct cylinder is longest and shortest: base point, joint and rod point in line."""
    cylinder = data["cylinders"][index]
    base = np.array(cylinder["base_point"]) - [parent, 0.0]
    rod = np.array(cylinder["rod_point"])
    folded = math.atan2(base[1], base[0]) - math.atan2(rod[1], rod[0])
    return [math.remainder(folded, 2 * math.pi), math.remainder(folded + math.pi, 2 * math.pi)]


def test_dead_centres_are_named() -> None:
    data = digger()
    shortest, longest = angles_of_extremes(data, 0, 0.5)
    data["links"][0]["limits"] = [-1.0, 2.0]
    assert -1 < longest < 2
    assert f"dead centre at {longest:.4g} rad" in message(data)
    assert "has no lever arm" in message(data)
    # A stroke that ends before it leaves one range below it and, on the other side, another.
    data["cylinders"][0]["length"] = [0.7, 1.3]
    assert "two ranges that do not meet" in message(data)
    data["links"][0]["limits"] = [-1.0, longest]
    low, high = flexopt.machine_from_dict(data).limits[0]
    assert low == -1.0
    assert high < longest
    assert length_in_plane(data["cylinders"][0], 0.5, high) == pytest.approx(1.3, abs=1e-15)
    data["cylinders"][0]["length"] = [0.7, 1.4]
    assert f"dead centre at {longest:.4g} rad" in message(data)
    data["links"][0]["limits"] = [shortest - 0.1, shortest + 0.1]
    data["cylinders"][0]["length"] = [0.5, 1.4]
    assert f"dead centre at {shortest:.4g} rad" in message(data)


def test_without_limits_the_stroke_decides() -> None:
    data = without_limits(0)
    data["cylinders"][0]["length"] = [0.8, 1.3]
    low, high = flexopt.machine_from_dict(data).limits[0]
    shortest, longest = angles_of_extremes(data, 0, 0.5)
    assert shortest < low < 0 < high < longest
    lengths = [length_in_plane(data["cylinders"][0], 0.5, q) for q in (low, high)]
    np.testing.assert_allclose(lengths, [0.8, 1.3], rtol=0, atol=1e-15 * 4)
    data["cylinders"][0]["length"] = [0.1, 1.3]
    assert f"dead centre at {shortest:.4g} rad" in message(data)
    # Base point, joint and rod point in line at 0.
    data["cylinders"][0] |= {"base_point": [0.1, 0.0], "rod_point": [0.9, 0.0]}
    assert "stands at a dead centre at 0 rad; give it limits" in message(data)


def test_linkages_that_do_not_close_are_named() -> None:
    # It closes where pivot and coupler point are between 0.03 m and 0.27 m apart.
    text = message(with_rocker(length=0.15, coupler=0.12))
    assert (
        "(bucket cylinder).rocker: the linkage does not close everywhere within the joint's limits, -2.2 to 0.7 "
        in text
    )
    ends = [float(q) for q in re.findall(r"-?\d\.\d+", text.split("it closes from ")[1])]
    assert len(ends) % 2 == 0
    edges = [q for q in ends if q not in (-2.2, 0.7)]
    assert edges
    for q in edges:
        angle, arm = q + math.atan2(0.18, -0.03), math.hypot(0.18, 0.03)
        distance = math.hypot(1.1 + arm * math.cos(angle) - 0.95, arm * math.sin(angle))
        # Four digits of the angle are printed.
        assert min(abs(distance - 0.27), abs(distance - 0.03)) < 1e-4
    assert "closes nowhere" in message(with_rocker(length=0.05, coupler=3.0))
    data = with_rocker(length=0.05, coupler=3.0)
    del data["links"][2]["limits"]
    assert "has no limits and the linkage does not close at 0 rad" in message(data)


def test_a_slide_is_as_long_as_its_offset_and_q() -> None:
    data = in_space(digger())
    stick = next(body for body in data["bodies"] if body["name"] == "stick")
    stick["joint"] |= {"kind": "slide", "limits": [-0.2, 3.0]}
    cylinder = {"name": "telescope", "joint": "stick", "offset": 0.9, "length": [1.0, 1.8], "speed": [0.2, 0.1]}
    data["cylinders"] = [cylinder]
    tree = tree_from_dict(data)
    low, high = tree.limits[tree.joints.index("stick")]
    assert (low, high) == (pytest.approx(0.1, abs=1e-15), pytest.approx(0.9, abs=1e-15))
    assert tree.parameters[-1] == ("telescope.offset", 0.9, "m")
    data["cylinders"] = [cylinder | {"length": [4.0, 5.0]}]
    with pytest.raises(
        ModelError, match=r"telescope\).length = \[4, 5\]: leaves the joint, whose limits are -0.2 to 3 m"
    ):
        tree_from_dict(data)
    data["cylinders"] = [cylinder | {"rod_point": [0.0, 0.0, 0.0]}]
    with pytest.raises(ModelError, match="belongs to the cylinder of a hinge"):
        tree_from_dict(data)


def test_faults_in_space() -> None:
    data = digger_in_space(in_space(digger()))
    data["cylinders"][0]["rod_point"] = [0.1, 0.2]
    data["cylinders"][1]["joint"] = "base.x"
    data["cylinders"][2]["rocker"]["pivot"] = [0.1, 0.2]
    with pytest.raises(ModelError) as caught:
        tree_from_dict(data)
    text = str(caught.value)
    assert "rod_point = [0.1, 0.2]: must be three numbers [x, y, z] in m" in text
    assert "rocker.pivot = [0.1, 0.2]: must be three numbers" in text
    assert "is a passive joint, which nothing drives; the actuated joints are boom, stick, bucket" in text


def mujoco_length(cylinder: dict[str, Any], q: float) -> float:
    """Of the MJCF arm's boom cylinder, by MuJoCo, sites and a tendon written into the file."""
    sites = {"turret": ("base", cylinder["base_point"]), "boom": ("rod", cylinder["rod_point"])}
    text = MJCF
    for body, (name, point) in sites.items():
        start = text.index(">", text.index(f'<body name="{body}"')) + 1
        text = f'{text[:start]}<site name="{name}" pos="{" ".join(map(repr, point))}"/>{text[start:]}'
    tendon = '<tendon><spatial name="c"><site site="base"/><site site="rod"/></spatial></tendon>'
    text = changed_text(text, "  <actuator>", f"  {tendon}<actuator>")
    text = changed_text(text, '<geom type="mesh" mesh="none" mass="0"/>', "")
    model = mujoco.MjModel.from_xml_string(text)
    state = mujoco.MjData(model)
    state.qpos[:] = np.random.default_rng(1).uniform(-0.3, 0.3, model.nq)
    state.joint("lift").qpos = q
    mujoco.mj_forward(model, state)
    return float(state.tendon("c").length[0])


def test_robot_files_take_pins_in_the_frames_of_links(tmp_path: Path) -> None:
    """The file's joint turns about an anchor beside the link's origin, from a link that is turned at zero."""
    cylinder = {"name": "boom cylinder", "joint": "lift", "base_point": [0.4, 0.1, -0.3], "rod_point": [0.9, 0.0, 0.2],
                "length": [0.95, 1.1], "speed": [0.2, 0.1]}  # fmt: skip
    tree = read(tmp_path, MJCF, changed(MJCF_MACHINE, {"cylinders": [cylinder]}))
    assert tree.joint_limits[1] == (pytest.approx(-math.pi / 6), pytest.approx(math.pi * 80 / 180))
    lengths = [mujoco_length(cylinder, q) for q in tree.limits[1]]
    np.testing.assert_allclose(lengths, [0.95, 1.1], rtol=0, atol=1e-14)
    cylinder["joint"] = "crowd"
    with pytest.raises(ModelError, match=r"boom cylinder\).joint = 'crowd': moves link 'stick' together with others"):
        read(tmp_path, MJCF, changed(MJCF_MACHINE, {"cylinders": [cylinder]}))


def test_robot_files_with_slides(tmp_path: Path) -> None:
    cylinder = {"name": "telescope", "joint": "extend", "offset": 0.4, "length": [0.5, 0.9], "speed": [0.2, 0.1]}
    tree = read(tmp_path, URDF, changed(URDF_MACHINE, {"cylinders": [cylinder]}))
    assert tree.limits[tree.joints.index("extend")] == (pytest.approx(0.1, abs=1e-15), pytest.approx(0.5, abs=1e-15))
    with pytest.raises(
        ModelError, match=r"telescope.*joint = 'extent': is no joint's name; the actuated joints are slew"
    ):
        read(tmp_path, URDF, changed(URDF_MACHINE, {"cylinders": [cylinder | {"joint": "extent"}]}))


@given(st.floats(-10, 10), st.floats(1e-6, 10), st.floats(0, 1))
def test_bisection_ends_on_the_last_double_inside(low: float, span: float, share: float) -> None:
    edge, high = low + share * span, low + span
    if edge >= high:
        return
    found = last_inside(lambda x: x <= edge, low, high)
    assert found == edge
