"""The same robot files read by Pinocchio and MuJoCo: masses, frames and mass matrices of what is read here."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from flexopt.model.robots import load_robot, reading, robot_from_dict
from flexopt.model.robots.reading import read_description
from flexopt.model.tree import Tree
from tests.model.robots.files import MJCF, MJCF_MACHINE, URDF, URDF_MACHINE, changed, changed_text, read
from tests.model.robots.tree_oracle import TreeOracle, frame

# Rounding of a few dozen products; every comparison below is of numbers of order 1 or relative.
EXACT = 1e-12


class PinocchioRobot:
    """A URDF in Pinocchio at joint values by name; its root link fixed, or free and at `base`."""

    def __init__(self, path: Path, *, free: bool = False) -> None:
        self.free = free
        self.model = (
            pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer()) if free else pin.buildModelFromUrdf(str(path))
        )
        self.data = self.model.createData()

    def at(self, values: dict[str, float], base: np.ndarray | None = None) -> None:
        q = pin.neutral(self.model)
        if base is not None:
            q[:7] = [*base[:3, 3], *Rotation.from_matrix(base[:3, :3]).as_quat()]
        for name, value in values.items():
            joint = self.model.joints[self.model.getJointId(name)]
            q[joint.idx_q : joint.idx_q + joint.nq] = [math.cos(value), math.sin(value)] if joint.nq == 2 else [value]
        pin.framesForwardKinematics(self.model, self.data, q)
        self.mass = pin.crba(self.model, self.data, q)
        self.mass = np.triu(self.mass) + np.triu(self.mass, 1).T

    def frame(self, name: str) -> np.ndarray:
        return self.data.oMf[self.model.getFrameId(name)].homogeneous

    def columns(self, names: list[str]) -> list[int]:
        return [self.model.joints[self.model.getJointId(name)].idx_v for name in names]


class MujocoRobot:
    """A model in MuJoCo at joint values by name."""

    def __init__(self, model: Any) -> None:
        self.model, self.data = model, mujoco.MjData(model)

    def at(self, values: dict[str, float]) -> None:
        for name, value in values.items():
            self.data.qpos[self.model.joint(name).qposadr[0]] = value
        mujoco.mj_forward(self.model, self.data)

    def mass(self, names: list[str]) -> np.ndarray:
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, full)
        index = [int(self.model.joint(name).dofadr[0]) for name in names]
        return full[np.ix_(index, index)]

    def body(self, name: str | int) -> np.ndarray:
        body = self.data.body(name)
        return frame(body.xmat.reshape(3, 3), body.xpos)

    def site(self, name: str) -> np.ndarray:
        site = self.data.site(name)
        return frame(site.xmat.reshape(3, 3), site.xpos)


def joint_values(tree: Tree, seed: int) -> dict[str, float]:
    rng = np.random.default_rng(seed)
    return {body.joint.name: float(rng.uniform(-1, 1)) for body in tree.bodies}


def assert_same(ours: np.ndarray, theirs: np.ndarray) -> None:
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=EXACT * np.abs(theirs).max())


@pytest.mark.parametrize("seed", range(5))
def test_urdf_on_a_compliant_base_is_pinocchios(tmp_path: Path, seed: int) -> None:
    """The base's coordinates move a free flyer: B maps their rates to its twist, and M must be Bᵀ M B."""
    tree = read(tmp_path, URDF, URDF_MACHINE)
    values = joint_values(tree, seed)
    names = [body.joint.name for body in tree.bodies]
    oracle = TreeOracle(tree, values)
    assert tree.coordinates == ("base.z", "base.pitch", "base.roll", "slew", "boom", "extend")

    base = URDF_MACHINE["base"]
    rest = frame(Rotation.from_euler("xyz", base["rotation"]).as_matrix(), np.array(base["position"]))
    point = rest[:3, :3] @ np.array(base["point"]) + rest[:3, 3]
    turn = Rotation.from_euler("xyz", [values["base.roll"], values["base.pitch"], 0.0]).as_matrix()
    moved = (
        frame(np.eye(3), point + np.array([0, 0, values["base.z"]]))
        @ frame(turn, np.zeros(3))
        @ frame(np.eye(3), -point)
        @ rest
    )
    peer = PinocchioRobot(tmp_path / "arm.urdf", free=True)
    locked = {"finger_a": 0.04, "finger_b": -0.09}
    peer.at({name: value for name, value in values.items() if not name.startswith("base.")} | locked, moved)

    assert_same(oracle.poses["chassis"] @ frame(rest[:3, :3], rest[:3, 3] - point), peer.frame("chassis"))
    assert_same(oracle.end_point(), peer.frame("tool") @ frame(np.eye(3), np.array([0, 0, 0.1])))
    assert sum(body.mass for body in tree.bodies) == pytest.approx(pin.computeTotalMass(peer.model), rel=EXACT)
    twist = oracle.jacobian("chassis", moved[:3, 3], names)
    twist = np.vstack([moved[:3, :3].T @ twist[:3], moved[:3, :3].T @ twist[3:]])
    moving = ["slew", "boom", "extend"]
    all_rates = np.zeros((peer.model.nv, len(names)))
    all_rates[:6] = twist
    for name, column in zip(moving, peer.columns(moving), strict=True):
        all_rates[column] = 0.0
        all_rates[column, names.index(name)] = 1.0
    assert_same(oracle.mass_matrix(names), all_rates.T @ peer.mass @ all_rates)


def test_urdf_joints_carry_what_the_file_says(tmp_path: Path) -> None:
    tree = read(tmp_path, URDF, URDF_MACHINE)
    joints = {body.joint.name: body.joint for body in tree.bodies}
    assert [body.name for body in tree.bodies] == [
        "chassis.z",
        "chassis.pitch",
        "chassis",
        "turret",
        "boom_link",
        "stick",
    ]
    assert (joints["slew"].limits, joints["slew"].joint_damping) == (None, 0.7)
    assert joints["boom"].limits == (-0.5, 1.4)
    assert joints["extend"].kind == "slide"
    np.testing.assert_allclose(joints["extend"].axis, [0.6, 0, 0.8], rtol=1e-15)
    assert joints["base.z"].stiffness == 4e6
    assert (joints["base.z"].damping, joints["base.roll"].damping) == (2e4, 0.0)
    assert tree.gravity == 9.81


@pytest.mark.parametrize("seed", range(5))
def test_mjcf_is_mujocos(tmp_path: Path, seed: int) -> None:
    tree = read(tmp_path, MJCF, MJCF_MACHINE)
    values = joint_values(tree, seed)
    oracle = TreeOracle(tree, values)
    # A mesh that is absent has no mass and no say here; MuJoCo wants the file.
    peer = MujocoRobot(mujoco.MjModel.from_xml_string(MJCF.replace('<geom type="mesh" mesh="none" mass="0"/>', "")))
    peer.at(values)
    names = list(tree.coordinates)
    assert_same(oracle.end_point(), peer.site("tip"))
    assert sum(body.mass for body in tree.bodies) == pytest.approx(peer.model.body_mass.sum(), rel=EXACT)
    assert_same(oracle.mass_matrix(names), peer.mass(names))
    for body in tree.bodies:
        joint = peer.model.joint(body.joint.name)
        assert (body.joint.kind == "slide") == (joint.type[0] == mujoco.mjtJoint.mjJNT_SLIDE)
        assert_same(oracle.axes[body.name][0], peer.data.joint(body.joint.name).xaxis)
        if body.joint.passive:
            assert body.joint.stiffness == joint.stiffness[0]
            assert body.joint.rest == pytest.approx(peer.model.qpos_spring[joint.qposadr[0]], rel=EXACT)
        elif joint.limited[0]:
            assert_same(np.array(body.joint.limits), joint.range)
        damping = body.joint.damping if body.joint.passive else body.joint.joint_damping
        assert damping == peer.model.dof_damping[joint.dofadr[0]]
    assert tree.gravity == 9.7
    assert tree.joints == ("slew", "lift", "crowd", "twist")


# Compiler settings, and the changes of the text that let each one matter.
COMPILERS: dict[str, dict[str, str]] = {
    'angle="radian"': {},
    'eulerseq="zyx"': {},
    'eulerseq="XYZ"': {},
    'eulerseq="ZyX"': {},
    'inertiafromgeom="true"': {},
    'boundmass="30" boundinertia="4"': {},
    'balanceinertia="true"': {'diaginertia="2 25 26"': 'diaginertia="2 9 26"'},
    'inertiagrouprange="1 2"': {'mass="4"': 'mass="4" group="2"', 'type="cyl': 'group="1" type="cyl'},
}


@pytest.mark.filterwarnings("ignore:.*(principal moments|reach beyond two turns):flexopt.errors.FlexoptWarning")
@pytest.mark.parametrize("compiler", COMPILERS)
def test_mjcf_compiler_settings_are_mujocos(tmp_path: Path, compiler: str) -> None:
    text = changed_text(MJCF, 'angle="degree" autolimits="true"', compiler)
    text = text.replace('<geom type="mesh" mesh="none" mass="0"/>', '<geom size="0.1" group="1"/>')
    text = changed_text(
        text, '<joint name="twist" axis="1 0 0"/>', '<joint name="twist" axis="1 0 0"/><geom size=".1" group="1"/>'
    )
    for old, new in COMPILERS[compiler].items():
        text = changed_text(text, old, new)
    tree = read(tmp_path, text, MJCF_MACHINE)
    values = joint_values(tree, 1)
    peer = MujocoRobot(mujoco.MjModel.from_xml_string(text))
    peer.at(values)
    oracle, names = TreeOracle(tree, values), list(tree.coordinates)
    assert_same(oracle.end_point(), peer.site("tip"))
    assert_same(oracle.mass_matrix(names), peer.mass(names))


def test_settotalmass_scales_every_body(tmp_path: Path) -> None:
    text = changed_text(MJCF, 'angle="degree"', 'angle="degree" settotalmass="7"')
    plain, scaled = read(tmp_path, MJCF, MJCF_MACHINE), read(tmp_path, text, MJCF_MACHINE)
    assert sum(body.mass for body in scaled.bodies) == pytest.approx(7, rel=EXACT)
    ratio = scaled.bodies[-1].mass / plain.bodies[-1].mass
    np.testing.assert_allclose(scaled.bodies[-2].inertia, np.array(plain.bodies[-2].inertia) * ratio, rtol=1e-12)


def test_a_root_joint_stands_on_the_base(tmp_path: Path) -> None:
    """`[base]` under a body that has joints of its own: as if MuJoCo had the slides and hinges there."""
    machine = changed(MJCF_MACHINE, {"base": {"stiffness": [1e5, 2e5, 3e5, 4e4, 5e4, 6e4], "point": [0.3, 0, -0.2]}})
    tree = read(tmp_path, MJCF, machine)
    chassis = next(body for body in tree.bodies if body.joint.name == "base.x")
    values = joint_values(tree, 3)
    text = MJCF.replace('<geom type="mesh" mesh="none" mass="0"/>', "")
    x, y, z = chassis.position
    stand = "".join(
        f'<joint name="base.{d}" type="{kind}" axis="{axis}" pos="{x!r} {y!r} {z!r}" damping="0"/>'
        for d, kind, axis in [
            ("x", "slide", "1 0 0"), ("y", "slide", "0 1 0"), ("z", "slide", "0 0 1"),
            ("yaw", "hinge", "0 0 1"), ("pitch", "hinge", "0 1 0"), ("roll", "hinge", "1 0 0"),
        ]
    )  # fmt: skip
    inertial = '<inertial pos="0 0 0" mass="1e-12" diaginertia="1e-12 1e-12 1e-12"/>'
    text = changed_text(text, '<body name="chassis"', f'<body name="stand">{stand}{inertial}<body name="chassis"')
    text = changed_text(text, "  </worldbody>", "</body></worldbody>")
    peer = MujocoRobot(mujoco.MjModel.from_xml_string(text))
    peer.at(values)
    oracle, names = TreeOracle(tree, values), list(tree.coordinates)
    assert_same(oracle.end_point(), peer.site("tip"))
    # The stand must weigh something for MuJoCo: 1e-12 kg beside 500.
    assert_same(oracle.mass_matrix(names), peer.mass(names))
    mounted = np.array([0.1, 0.2, 0.3]) + Rotation.from_euler("XYZ", [5, -10, 20], degrees=True).as_matrix() @ [
        0.3,
        0,
        -0.2,
    ]
    np.testing.assert_allclose(chassis.position, mounted, rtol=1e-12)


def test_a_free_root_gives_way_to_the_base(tmp_path: Path) -> None:
    machine = changed(MJCF_MACHINE, {"base": {"stiffness": {"z": 1e5}}})
    start, end = MJCF.index('      <joint name="heave"'), MJCF.index('      <geom type="box"')
    for free in ("<freejoint/>", '<joint type="free" class="main"/>'):
        tree = read(tmp_path, MJCF[:start] + free + MJCF[end:], machine)
        assert tree == read(tmp_path, MJCF[:start] + MJCF[end:], machine)
        assert tree.coordinates[0] == "base.z"


def test_full_matrices_of_the_base(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6))
    stiffness, damping = 1e5 * (root @ root.T + np.eye(6)), 1e2 * (root @ root.T)
    data = changed(URDF_MACHINE, {"base/stiffness": stiffness.tolist(), "base/damping": damping.tolist()})
    tree = read(tmp_path, URDF, data)
    assert tree.stiffness_matrix is not None
    assert tree.damping_matrix is not None
    assert tree.stiffness_matrix.joints == ("base.x", "base.y", "base.z", "base.roll", "base.pitch", "base.yaw")
    np.testing.assert_allclose(tree.stiffness_matrix.matrix, stiffness, rtol=1e-14)
    np.testing.assert_allclose(tree.damping_matrix.matrix, damping, rtol=1e-14, atol=1e-12)
    six = read(tmp_path, URDF, changed(URDF_MACHINE, {"base/stiffness": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]}))
    assert {b.joint.name: b.joint.stiffness for b in six.passive_bodies}["base.yaw"] == 6.0


def test_includes_are_spliced(tmp_path: Path) -> None:
    start, end = MJCF.index("  <default>"), MJCF.index("  <worldbody>")
    tmp_path.joinpath("parts").mkdir()
    tmp_path.joinpath("parts/defaults.xml").write_text(f"<mujocoinclude>{MJCF[start:end]}</mujocoinclude>")
    text = MJCF[:start] + '<include file="parts/defaults.xml"/>' + MJCF[end:]
    assert read(tmp_path, text, MJCF_MACHINE) == read(tmp_path, MJCF, MJCF_MACHINE)


def test_the_example_of_the_docstring_is_read(tmp_path: Path) -> None:
    """The TOML in the docstring of `reading`, with the robot it describes."""
    assert reading.__doc__ is not None
    lines = [line for line in reading.__doc__.splitlines() if not line or line.startswith("    ")]
    tmp_path.joinpath("machine.toml").write_text("\n".join(line[4:] for line in lines), encoding="utf-8")
    text = URDF.replace('name="finger_a"', 'name="gripper"').replace('joint="finger_a"', 'joint="gripper"')
    text = text.replace('name="extend" type="prismatic"', 'name="stick" type="prismatic"')
    text = text.replace('name="tool"', 'name="tool0"').replace('link="tool"', 'link="tool0"')
    mast = '<joint name="mast" type="continuous"><parent link="turret"/><child link="top"/></joint><link name="top">'
    text = changed_text(
        text,
        "</robot>",
        mast
        + '<inertial><mass value="3"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link></robot>',
    )
    tmp_path.joinpath("arm.urdf").write_text(text, encoding="utf-8")
    tree = load_robot(tmp_path / "machine.toml")
    assert tree.coordinates == ("base.z", "base.pitch", "base.roll", "mast", "slew", "boom", "stick")
    assert tree.limits[1] == (-0.5, 1.2)
    assert tree.payload.mass == 250.0
    assert tomllib.loads(tmp_path.joinpath("machine.toml").read_text())["end_point"]["offset"] == list(
        tree_offset(tree)
    )


def tree_offset(tree: Tree) -> tuple[float, ...]:
    """The end-point's offset in the axes of the tool, which hangs on the stick."""
    end = tree.end_point
    flange = frame(Rotation.from_euler("xyz", [0, 1, 0.5]).as_matrix(), np.array([0.9, 0, 0]))
    inner = np.linalg.inv(flange) @ frame(np.array(end.rotation), np.array(end.position))
    return tuple(float(x) for x in inner[:3, 3].round(14) + 0.0)


numbers = st.integers(-20, 20).map(lambda k: k / 10)
vectors = st.tuples(numbers, numbers, numbers)
axes = vectors.filter(lambda v: math.hypot(*v) > 0.3)


@st.composite
def bodies(draw: st.DrawFn) -> dict[str, Any]:
    """One link of a random tree: any pose, a rod-like or round inertia, one of the kinds of joint."""
    a, b = draw(st.integers(1, 9)), draw(st.integers(1, 9))
    return {
        "parent": draw(st.integers(0, 100)),
        "kind": draw(st.sampled_from(["revolute", "continuous", "prismatic", "fixed"])),
        "xyz": draw(vectors), "rpy": draw(vectors), "axis": draw(axes), "anchor": draw(vectors),
        "com": draw(vectors), "turn": draw(vectors), "mass": draw(st.integers(1, 50)) / 3,
        "moments": (a / 7, b / 7, (a + b) / 7 * 0.9 + 0.1 / 7),
        "ref": draw(numbers), "spring": draw(st.sampled_from([0, 0, 5])), "second": draw(st.booleans()),
    }  # fmt: skip


def words(values: Any) -> str:
    return " ".join(repr(float(v)) for v in values)


@given(st.lists(bodies(), min_size=2, max_size=8), st.integers(0, 10**6))
@settings(max_examples=40)
def test_random_urdfs_are_pinocchios(
    tmp_path_factory: pytest.TempPathFactory, links: list[dict[str, Any]], seed: int
) -> None:
    folder = tmp_path_factory.mktemp("urdf")
    text = '<robot name="random"><link name="l0"/>'
    for i, link in enumerate(links, start=1):
        xx, yy, zz = link["moments"]
        text += (
            f'<joint name="j{i}" type="{link["kind"]}"><parent link="l{link["parent"] % i}"/><child link="l{i}"/>'
            f'<origin xyz="{words(link["xyz"])}" rpy="{words(link["rpy"])}"/><axis xyz="{words(link["axis"])}"/>'
            f'<limit lower="-1" upper="1" effort="1" velocity="1"/></joint><link name="l{i}"><inertial>'
            f'<origin xyz="{words(link["com"])}" rpy="{words(link["turn"])}"/><mass value="{link["mass"]!r}"/>'
            f'<inertia ixx="{xx!r}" ixy="0" ixz="0" iyy="{yy!r}" iyz="0" izz="{zz!r}"/></inertial></link>'
        )
    moving = [f"j{i}" for i, link in enumerate(links, start=1) if link["kind"] != "fixed"]
    folder.joinpath("random.urdf").write_text(text + "</robot>")
    last = len(links)
    machine = {
        "name": "random", "robot": "random.urdf", "root": "l0", "actuated": moving, "base": {"stiffness": {"x": 1.0}},
        "end_point": {"link": f"l{last}", "rows": ["x"]},
    }  # fmt: skip
    assume(moving)
    tree = robot_from_dict(machine, folder=folder)
    values = joint_values(tree, seed) | {"base.x": 0.0}
    oracle, peer = TreeOracle(tree, values), PinocchioRobot(folder / "random.urdf")
    peer.at({name: values[name] for name in moving})
    index = peer.columns(moving)
    assert_same(oracle.mass_matrix(["base.x", *moving])[1:, 1:], peer.mass[np.ix_(index, index)])
    assert_same(oracle.end_point(), peer.frame(f"l{last}"))


@pytest.mark.long
@given(st.lists(bodies(), min_size=1, max_size=6), st.integers(0, 10**6))
@settings(max_examples=40)
def test_random_mjcfs_are_mujocos(
    tmp_path_factory: pytest.TempPathFactory, links: list[dict[str, Any]], seed: int
) -> None:
    folder = tmp_path_factory.mktemp("mjcf")
    children: dict[int, list[int]] = {i: [] for i in range(len(links) + 1)}
    for i, link in enumerate(links, start=1):
        children[link["parent"] % i].append(i)

    def body(i: int) -> str:
        link = links[i - 1]
        kind = {"prismatic": "slide"}.get(link["kind"], "hinge")
        joint = (
            f'<joint name="j{i}" type="{kind}" axis="{words(link["axis"])}" pos="{words(link["anchor"])}" '
            f'ref="{link["ref"]!r}" springref="{link["ref"] / 2!r}" stiffness="{link["spring"]}" armature="0.1"/>'
        )
        second = f'<joint name="k{i}" axis="{words(link["com"][::-1])}" pos="{words(link["xyz"])}" ref="0.3"/>'
        both = (
            ""
            if link["kind"] == "fixed"
            else joint + (second if link["second"] and math.hypot(*link["com"]) > 0.3 else "")
        )
        inner = "".join(body(k) for k in children[i])
        return (
            f'<body name="b{i}" pos="{words(link["xyz"])}" euler="{words(link["rpy"])}">{both}<inertial pos="{words(link["com"])}" '
            f'euler="{words(link["turn"])}" mass="{link["mass"]!r}" diaginertia="{words(link["moments"])}"/>{inner}</body>'
        )

    text = (
        '<mujoco><compiler angle="radian"/><worldbody>'
        + "".join(body(k) for k in children[0])
        + "</worldbody></mujoco>"
    )
    folder.joinpath("random.xml").write_text(text)
    description, faults = read_description(folder / "random.xml", "random.xml")
    assert not faults
    joints = [joint for link in description.links for joint in link.joints]
    actuated = [joint.name for joint in joints if not joint.stiffness]
    carrier = {link.name: bool(link.joints) for link in description.links}
    moved = [link.name for link in description.links if link.joints or (link.parent and carrier[link.parent])]
    assume(actuated and len(actuated) < len(joints) and moved)
    machine = {
        "name": "random", "robot": "random.xml", "actuated": actuated,
        "end_point": {"link": moved[-1], "rows": ["x"]},
    }  # fmt: skip
    tree = robot_from_dict(machine, folder=folder)
    values = joint_values(tree, seed)
    oracle, peer = TreeOracle(tree, values), MujocoRobot(mujoco.MjModel.from_xml_string(text))
    peer.at(values)
    names = list(tree.coordinates)
    assert_same(oracle.mass_matrix(names), peer.mass(names))
    assert_same(oracle.end_point(), peer.body(moved[-1]))
