"""Where pictures draw meshes and shapes of robot files: against MuJoCo and Pinocchio, in random configurations."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh

import flexopt
from flexopt.model.robots import robot_from_dict
from flexopt.model.robots.visuals import located
from flexopt.model.tables import Visual
from flexopt.model.tree import Tree
from flexopt.plant import build_plant
from tests.model.robots.files import URDF, URDF_MACHINE, changed_text, read

# A body without symmetry, so that no turn or mirror image of it can pass for it.
WEDGE = trimesh.Trimesh(
    [[0, 0, 0], [1, 0, 0], [0, 0.5, 0], [0, 0, 0.3], [1.2, 0.1, 0.9]],
    [[0, 2, 1], [0, 1, 4], [0, 4, 3], [0, 3, 2], [1, 2, 4], [2, 3, 4]],
)

MJCF = """
<mujoco model="drawn">
  <compiler meshdir="parts" angle="radian"/>
  <default><mesh scale="0.5 0.6 0.7"/><default class="hidden"><geom group="3"/></default></default>
  <asset>
    <mesh file="wedge.stl"/>
    <mesh name="turned" file="wedge.stl" scale="2 -0.5 1" refpos="0.1 0.2 0.3" refquat="0.9 0.1 -0.3 0.2"/>
  </asset>
  <worldbody>
    <body name="post" pos="0.1 0.2 0.5" euler="0.1 0.2 0.3">
      <joint name="sway" axis="0 1 0" stiffness="1e5" damping="10"/>
      <inertial pos="0 0 0.1" mass="50" diaginertia="3 3 3"/>
      <geom name="wedge" type="mesh" mesh="wedge" pos="0.3 0 0.1" euler="0 0.4 0"/>
      <geom class="hidden" type="box" size="1 1 1"/>
      <geom type="box" size="1 1 1" rgba="1 0 0 0"/>
      <frame pos="0 0.1 0" euler="0 0 0.5"><geom name="turned" type="mesh" mesh="turned" pos="0 0 0.4"/></frame>
      <body name="plate" pos="0 0 0.6" euler="0.3 0 0">
        <geom name="box" type="box" size="0.1 0.2 0.3" pos="0.1 0 0"/>
        <body name="arm" pos="0.2 0 0.1">
          <joint name="lift" axis="0 -1 0"/>
          <geom name="bar" type="cylinder" size="0.1" fromto="0 0 0 1 0.2 0.1"/>
          <geom name="egg" type="ellipsoid" size="0.1 0.2 0.3" pos="1 0 0" euler="0.2 0.3 0.4"/>
          <body name="fore" pos="1 0.2 0.1">
            <joint name="fold" axis="0 -1 0"/>
            <geom name="pill" type="capsule" size="0.05 0.3" pos="0 0 0.3" euler="0.5 0 0"/>
            <geom name="ball" size="0.12" pos="0 0 0.7"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
MJCF_MACHINE: dict[str, Any] = {
    "name": "drawn", "robot": "robot.xml", "actuated": ["lift", "fold"],
    "end_point": {"link": "fore", "offset": [0.0, 0.0, 0.7], "rows": ["x", "z"]},
}  # fmt: skip


def frames(tree: Tree, q: np.ndarray) -> dict[str | None, tuple[np.ndarray, np.ndarray]]:
    """Origin and rotation of each body, and of the anchor frame, which stands at the inertial one."""
    plant = build_plant(tree)
    found = plant.body_frames(q=q, base=np.zeros(plant.n_base), p=plant.parameter_values)
    origins, rotations = found["origins"].full(), found["rotations"].full()
    each: dict[str | None, Any] = {
        name: (origins[:, k], rotations[:, 3 * k : 3 * k + 3]) for k, name in enumerate(plant.frames.names)
    }
    return each | {None: (np.zeros(3), np.eye(3))}


def in_space(visual: Visual, of: Any) -> tuple[np.ndarray, np.ndarray]:
    """Position and matrix of a visual in inertial axes."""
    origin, rotation = of[visual.body]
    return origin + rotation @ np.array(visual.position), rotation @ np.array(visual.matrix)


@pytest.mark.parametrize("seed", range(5))
def test_mjcf_against_mujoco(tmp_path: Path, seed: int) -> None:
    (tmp_path / "parts").mkdir()
    WEDGE.export(tmp_path / "parts" / "wedge.stl")
    (tmp_path / "robot.xml").write_text(MJCF)
    tree = robot_from_dict(MJCF_MACHINE, folder=tmp_path)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    data = mujoco.MjData(model)
    data.qpos = np.random.default_rng(seed).uniform(-1, 1, 3)
    mujoco.mj_kinematics(model, data)
    of = frames(tree, data.qpos)
    drawn = [in_space(visual, of) for visual in tree.visuals]
    assert [(v.shape, v.why) for v in tree.visuals] == [
        (shape, "") for shape in ("mesh", "mesh", "box", "cylinder", "sphere", "cylinder", "sphere", "sphere", "sphere")
    ]
    assert tree.visuals[2].body == "post"  # what it is welded to
    names = ["wedge", "turned", "box", "bar", "egg", "pill", None, None, "ball"]
    for name, visual, (position, matrix) in zip(names, tree.visuals, drawn, strict=True):
        if name is None:
            continue
        geom = model.geom(name).id
        place, turn, size = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3), model.geom_size[geom]
        if visual.shape == "mesh":
            assert visual.file == str((tmp_path / "parts" / "wedge.stl").resolve())
            k = model.geom_dataid[geom]
            corners = model.mesh_vert[model.mesh_vertadr[k] :][: model.mesh_vertnum[k]] @ turn.T + place
            found = WEDGE.vertices @ matrix.T + position
            apart = np.linalg.norm(corners[:, None] - found[None], axis=2)
            assert apart.min(axis=0).max() < 1e-6
            assert apart.min(axis=1).max() < 1e-6
            continue
        half = {"bar": [size[0], size[0], size[1]], "pill": [size[0], size[0], size[1]], "ball": [size[0]] * 3}
        np.testing.assert_allclose(position, place, atol=1e-12)
        expected = turn @ np.diag(half.get(name, size))
        if visual.shape == "box":
            np.testing.assert_allclose(matrix, expected, atol=1e-12)
        else:  # round: it may be turned about its axis, and lie with either end first
            np.testing.assert_allclose(matrix @ matrix.T, expected @ expected.T, atol=1e-12)
    pill = model.geom("pill").id
    for end, (position, matrix) in zip((-1, 1), drawn[6:8], strict=True):
        along = data.geom_xmat[pill].reshape(3, 3)[:, 2] * model.geom_size[pill][1]
        np.testing.assert_allclose(position, data.geom_xpos[pill] + end * along, atol=1e-12)
        np.testing.assert_allclose(matrix @ matrix.T, 0.05**2 * np.eye(3), atol=1e-12)


DRAWN = """<visual><origin xyz="0.1 0.2 0.3" rpy="0.4 0.5 0.6"/>
    <geometry><mesh filename="package://arm_parts/parts/wedge.stl" scale="0.5 -1 2"/></geometry></visual>
  <visual><origin rpy="0 0.5 0"/><geometry><box size="0.2 0.4 0.6"/></geometry></visual>
  <visual><origin xyz="0 0 1"/><geometry><cylinder radius="0.1" length="0.8"/></geometry></visual>
  <visual><geometry><sphere radius="0.3"/></geometry></visual>"""


@pytest.mark.skipif(sys.platform == "win32", reason="Pinocchio has no wheels for Windows")
@pytest.mark.parametrize("link", ["turret", "bracket"])
def test_urdf_against_pinocchio(tmp_path: Path, link: str) -> None:
    """The bracket is welded to the boom: what is drawn of it moves with the boom's body."""
    import pinocchio  # noqa: PLC0415

    package = tmp_path / "arm_parts"
    (package / "parts").mkdir(parents=True)
    (package / "urdf").mkdir()
    WEDGE.export(package / "parts" / "wedge.stl")
    text = changed_text(URDF, f'<link name="{link}">', f'<link name="{link}">{DRAWN}')
    # A ball that is not turned tells where the root link stands in its body, whose frame is that of the springs.
    text = changed_text(text, '<mesh filename="package://nowhere/chassis.stl"/>', '<sphere radius="1"/>')
    tree = read(package / "urdf", text, URDF_MACHINE)
    assert [visual.body for visual in tree.visuals] == ["chassis"] + 4 * ["turret" if link == "turret" else "boom_link"]
    file = next((package / "urdf").glob("*.urdf"))
    model = pinocchio.buildModelFromUrdf(str(file))
    shown = pinocchio.buildGeomFromUrdf(model, str(file), pinocchio.GeometryType.VISUAL, package_dirs=[str(tmp_path)])
    data, known = model.createData(), shown.createData()
    q = pinocchio.neutral(model)
    pinocchio.forwardKinematics(model, data, q)
    pinocchio.updateGeometryPlacements(model, data, shown, known)
    # Relative to the root link, which stands on the base's springs.
    plant = build_plant(tree)
    of = frames(tree, np.zeros(plant.n_coordinates))
    origin, axes = in_space(tree.visuals[0], of)
    halves = {"box": (0.1, 0.2, 0.3), "cylinder": (0.1, 0.1, 0.4), "sphere": (0.3, 0.3, 0.3), "mesh": (0.5, -1.0, 2.0)}
    assert len(shown.geometryObjects) == len(tree.visuals) == 5
    for k, visual in [*enumerate(tree.visuals)][1:]:
        position, matrix = in_space(visual, of)
        place, turn = known.oMg[k].translation, known.oMg[k].rotation
        np.testing.assert_allclose(axes.T @ (position - origin), place, atol=1e-12)
        np.testing.assert_allclose(axes.T @ matrix, turn @ np.diag(halves[visual.shape]), atol=1e-12)
        if visual.shape == "mesh":
            assert np.array_equal(shown.geometryObjects[k].meshScale, halves["mesh"])
            assert Path(shown.geometryObjects[k].meshPath).samefile(visual.file)


@pytest.mark.parametrize(
    "name",
    [
        "package://arm_parts/meshes/a.stl",
        "package://elsewhere/meshes/a.stl",
        "../meshes/a.stl",
        "model://arm_parts/meshes/a.stl",
    ],
)
def test_paths_are_found(tmp_path: Path, name: str) -> None:
    """Relative ones, and packages that the robot file lies in, whatever their folder's name is."""
    folder, file = tmp_path / "arm_parts" / "urdf", tmp_path / "arm_parts" / "meshes" / "a.stl"
    for path in (folder, file.parent):
        path.mkdir(parents=True)
    file.touch()
    assert Path(located(name, folder)).samefile(file)


def test_paths_in_ros_and_of_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install, work = tmp_path / "install", tmp_path / "src"
    shared, checkout = install / "share" / "one" / "a.stl", work / "two" / "b.stl"
    for file in (shared, checkout):
        file.parent.mkdir(parents=True)
        file.touch()
    here = tmp_path / "here"
    here.mkdir()
    assert located("package://one/a.stl", here) == "package://one/a.stl"
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(install))
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(work))
    assert Path(located("package://one/a.stl", here)).samefile(shared)
    assert Path(located("package://two/b.stl", here)).samefile(checkout)
    assert Path(located(shared.as_uri(), here)).samefile(shared)
    for name in ("file:///nowhere.stl", "https://host/a.stl", "a\0b.stl", "x" * 5000, "package://", "file://"):
        assert located(name, here) == name


ODD = {
    "no shape": ("<geometry/>", "has no shape"),
    "no file": ("<geometry><mesh/></geometry>", "<mesh> names no file"),
    "flat": ('<geometry><cylinder radius="0" length="1"/></geometry>', "has a size that is not positive"),
    "no numbers": ('<geometry><box size="a b c"/></geometry>', "is no number"),
    "far": ('<origin xyz="1e9 0 0"/><geometry><sphere radius="1"/></geometry>', "reaches beyond 10000 m"),
}  # fmt: skip


@pytest.mark.parametrize("case", ODD)
def test_what_cannot_be_drawn_is_no_fault_and_says_why(tmp_path: Path, case: str) -> None:
    geometry, sentence = ODD[case]
    text = changed_text(URDF, '<link name="turret">', f'<link name="turret"><visual>{geometry}</visual>')
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tree = read(tmp_path, text, URDF_MACHINE)
    (visual,) = [visual for visual in tree.visuals if visual.body == "turret"]
    assert sentence in visual.why


def test_looks_change_no_machine(tmp_path: Path) -> None:
    """Neither its hash, by which what is computed of it is kept, nor a number; a dictionary keeps them."""
    bare = read(tmp_path, URDF.replace("<visual>", "<!--").replace("</visual>", "-->"), URDF_MACHINE)
    tree = read(tmp_path, URDF, URDF_MACHINE)
    assert (len(bare.visuals), len(tree.visuals)) == (0, 1)
    assert tree.content_hash == bare.content_hash
    again = flexopt.tree_from_dict(tree.to_dict())
    assert again.visuals == tree.visuals
    with pytest.raises(flexopt.ModelError, match=r"visuals\[0\]\.body.*did you mean 'turret'"):
        flexopt.tree_from_dict(tree.to_dict() | {"visuals": [{"body": "turet", "shape": "box"}]})
    with pytest.raises(flexopt.ModelError, match=r"(?s)visuals\[0\]\.shape.*visuals\[0\]\.matrix"):
        flexopt.tree_from_dict(tree.to_dict() | {"visuals": [{"shape": "torus", "matrix": [1, 2]}]})
