"""`flexopt new`: what it writes loads, passes the check, evaluates where it says, and swings as was asked for."""

from __future__ import annotations

import io
import re
import shlex
import tomllib
import warnings
from pathlib import Path

import numpy as np
import pinocchio
import pytest
from scipy.linalg import eigh

import flexopt
from flexopt.foundation.rendering import render
from flexopt.plant import build_plant
from flexopt.study.new_files.machine import gains_told
from flexopt.study.new_files.robot_chain import read_chain
from tests.cli.command import Command
from tests.model.robots.files import MJCF, URDF
from tests.model.robots.test_public_robots import MJCF_PATHS, URDF_PATHS

ROOT = Path(__file__).parents[2]
PUBLIC = URDF_PATHS | MJCF_PATHS
ROBOTS = ROOT / "models" / "robots"


def followed(command: Command, *arguments: str):
    """The document of a call, after the steps that it names next were taken; and the evaluation."""
    document = command.json("new", *arguments, "--yes")
    check, evaluate = (shlex.split(step)[1:] for step in document["next"])
    checked = command(*check, "--json")
    assert checked.code == 0, checked.stdout
    assert checked.document["faults"] == []
    evaluation = command(*evaluate, "--json")
    assert evaluation.code == 0, evaluation.stderr
    return document, evaluation.document


def test_a_machine_of_proposals_alone(command: Command) -> None:
    document, evaluation = followed(command)
    assert document["file"] == "machine.toml"
    assert command("check", "machine.toml").stdout.strip() == "machine 'machine': nothing to mend"
    machine = flexopt.load("machine.toml")
    # One angle is from the horizontal; those of joints are relative to the body before, which the question says, too.
    written = Path("machine.toml").read_text(encoding="utf-8").splitlines()
    assert all("rest_angle" in line for line in written if "from the horizontal" in line)
    assert re.search(r"Of the joints,\s+rad,\s+relative\s+to\s+the\s+body\s+before", command("new", "--help").stdout)
    assert held_swing(machine, document["posture"]) == (pytest.approx(2.0, rel=1e-5), pytest.approx(0.02, rel=1e-5))
    assert evaluation["frequencies_hz"][0] >= 2.0
    printed = command("new", "--yes", "--force").stdout
    assert all(step in printed for step in document["next"])


@pytest.mark.parametrize("links", [2, 3, 5, 8])
def test_the_posture_to_look_at_first_is_above_the_ground(command: Command, links: int) -> None:
    document, evaluation = followed(command, "mine.toml", "--links", str(links))
    machine = flexopt.load("mine.toml")
    heights = machine.base.length + np.append(0.0, np.cumsum(
        [link.length * np.sin(np.pi / 2 + turn)
         for link, turn in zip(machine.links, np.cumsum(document["posture"]), strict=True)]
    ))  # fmt: skip
    assert heights.min() > 0
    assert evaluation["end_point"][1] == pytest.approx(heights[-1], abs=1e-6)


def held_swing(machine: flexopt.Machine | flexopt.Tree, posture: list[float]) -> tuple[float, float]:
    """Frequency, Hz, and damping ratio of the slowest motion of the base in M_pp ẍ + D_pp ẋ + K_pp x = 0."""
    plant, p = build_plant(machine), build_plant(machine).parameter_values
    m, base = plant.n_passive, np.zeros(plant.n_base)
    mass = plant.mass(plant.rest(base, posture, p), base, p).full()[:m, :m]
    values, shapes = eigh(plant.stiffness(p).full()[:m, :m], mass)
    omega, first = np.sqrt(values[0]), shapes[:, 0]
    return omega / (2 * np.pi), first @ plant.damping(p).full()[:m, :m] @ first / (2 * omega)


@pytest.mark.parametrize("seed", range(3))
def test_a_planar_machine_is_what_was_said(command: Command, seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 5))
    lengths, masses = np.round(rng.uniform(0.5, 3, n), 3), np.round(rng.uniform(50, 900, n), 1)
    limits = [(round(-2 - rng.random(), 2), round(rng.random(), 2)) for _ in range(n)]
    gives = ("rotation", "x,rotation", "x,y,rotation")[seed]
    frequency, ratio = round(rng.uniform(0.5, 5), 3), round(rng.uniform(0.01, 0.2), 3)
    given = {
        "--name": "rig #1 \"é\"", "--links": n, "--lengths": ",".join(map(str, lengths)),
        "--masses": ",".join(map(str, masses)), "--limits": ";".join(f"{a},{b}" for a, b in limits),
        "--base-length": 0.4, "--base-mass": 4000, "--gives": gives, "--frequency": frequency, "--ratio": ratio,
    }  # fmt: skip
    options = [str(part) for pair in given.items() for part in pair]
    document, evaluation = followed(command, "mine.toml", *options)
    machine = flexopt.load("mine.toml")
    assert held_swing(machine, document["posture"]) == (
        pytest.approx(frequency, rel=1e-5),
        pytest.approx(ratio, rel=1e-4),
    )
    assert evaluation["frequencies_hz"][0] >= frequency
    assert machine.name == document["machine"] == 'rig #1 "é"'
    assert [link.length for link in machine.links] == list(lengths)
    assert [link.mass for link in machine.links] == list(masses)
    np.testing.assert_allclose([link.inertia for link in machine.links], masses * lengths**2 / 12, rtol=1e-5)
    assert [link.limits for link in machine.links] == limits
    assert ",".join(machine.free_base_directions) == gives
    assert all(low < q < high for q, (low, high) in zip(document["posture"], limits, strict=True))


def test_springs_that_are_known_stay_as_they_are(command: Command) -> None:
    given = ("--gives", "x,rotation", "--stiffness", "3e6,2e6", "--damping", "10,20", "--inertias", "300,50")
    followed(command, "mine.toml", *given)
    machine = flexopt.load("mine.toml")
    assert (machine.base.stiffness.x, machine.base.stiffness.y, machine.base.stiffness.rotation) == (3e6, None, 2e6)
    assert (machine.base.damping.x, machine.base.damping.rotation) == (10, 20)
    assert [link.inertia for link in machine.links] == [300, 50]
    text = Path("mine.toml").read_text(encoding="utf-8")
    assert "slender rod" not in text
    assert "arm held" not in text


@pytest.mark.long("humanoid.xml", "so101.urdf", "kinova.urdf")
@pytest.mark.parametrize(
    "robot",
    [ROBOTS / "slewing-excavator.urdf", ROBOTS / "mobile-manipulator.xml", "arm.urdf", "arm.xml", "so101.urdf", "kinova.urdf",
     "reacher.xml", "humanoid.xml"],
    ids=lambda robot: Path(robot).name,
)  # fmt: skip
def test_a_robot_file_becomes_a_machine(command: Command, robot: Path | str) -> None:
    written = {"arm.urdf": URDF, "arm.xml": MJCF}
    path = Path(robot)
    if robot in written:
        command.write(path.name, written[path.name])
    elif isinstance(robot, str):
        if path.name not in PUBLIC:
            pytest.skip("not installed")
        path = PUBLIC[path.name]
    (command.folder / "work").mkdir()
    document, evaluation = followed(command, "work/own.toml", "--from", str(path))
    data = tomllib.loads(Path("work/own.toml").read_text(encoding="utf-8"))
    assert data["actuated"] == document["joints"]
    text = Path("work/own.toml").read_text(encoding="utf-8")
    for joint in data["actuated"]:
        assert f"#   {joint}: " in text
    if "so that the machine, its arm held, swings at 2 Hz" in text:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", flexopt.FlexoptWarning)  # of what the format does not have
            machine = flexopt.load("work/own.toml")
        swing = held_swing(machine, document["posture"])
        assert swing[0] == pytest.approx(2.0, rel=1e-5)
        assert evaluation["frequencies_hz"][0] >= 2.0
        if "so that the machine, its arm held, has the damping ratio" in text:
            assert swing[1] == pytest.approx(0.02, rel=1e-3)
    assert ("base" in data) == (path.name not in {"mobile-manipulator.xml", "arm.xml"})


@pytest.mark.long
def test_what_nobody_said_is_marked_as_proposed_and_nothing_else(command: Command) -> None:
    command.write("arm.urdf", URDF)

    def marked(*options: str) -> list[str]:
        assert command("new", "own.toml", "--from", "arm.urdf", "--yes", "--force", *options).code == 0
        lines = Path("own.toml").read_text(encoding="utf-8").splitlines()
        return [line.split()[0] for line in lines if "(proposed: " in line]

    proposals = marked()
    assert proposals == ["actuated", "stiffness", "damping", "link", "offset"]
    assert marked("--frequency", "1.3", "--ratio", "0.04") == ["actuated", "link", "offset"]
    assert marked("--actuated", "slew,boom,extend", "--tip", "stick") == ["stiffness", "damping", "offset"]
    assert command("new", "flat.toml", "--yes").code == 0
    flat = Path("flat.toml").read_text(encoding="utf-8")
    assert "(proposed: so that the machine, its arm held, swings at 2 Hz" in flat


def test_a_grippers_finger_is_no_end_point(command: Command) -> None:
    """Of `arm.urdf` a finger has the most joints before it; what the springs carry stands above them."""
    command.write("arm.urdf", URDF)
    followed(command, "own.toml", "--from", "arm.urdf")
    text = Path("own.toml").read_text(encoding="utf-8")
    assert tomllib.loads(text)["actuated"] == ["slew", "boom", "extend"]
    assert tomllib.loads(text)["end_point"]["link"] not in {"left", "right"}
    assert "The springs carry the root link, chassis, 900 kg." in text


def test_an_end_that_its_own_joint_does_not_move_is_put_at_the_links_far_end(command: Command) -> None:
    """The arm of the documentation: its last link's origin lies on the joint's axis, its centre of mass 0.5 m from it."""
    page = (Path(__file__).parents[2] / "docs" / "howto" / "robot-file.md").read_text(encoding="utf-8")
    command.write("arm.urdf", page.split("```xml\n")[1].split("```")[0])
    followed(command, "arm.toml", "--from", "arm.urdf")
    machine = flexopt.load("arm.toml")
    assert machine.task_rows == ("x", "y", "z")
    stretched = flexopt.evaluate(machine, (0.0, 0.0, -0.1)).end_point
    # Joints at 0, 1.3 m of the upper arm, twice 0.5 m of the fore arm.
    np.testing.assert_allclose(stretched[:2], [1.3 + np.cos(-0.1), 0.0], atol=1e-9)
    assert "twice as far as its centre of mass" in Path("arm.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(("axis", "offset"), [("0 -1 0", [0.5, 0.0, 0.0]), ("1 0 0", [0.0, 0.0, 0.0])])
def test_the_far_end_is_proposed_where_the_others_could_do_without_it(
    command: Command, axis: str, offset: list[float]
) -> None:
    """A third hinge in the plane: its link's far end; a wrist that rolls about its own axis has none."""
    body = "<link name='{}'><inertial><origin xyz='0.25 0 0'/><mass value='9'/><inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/></inertial></link>"
    hinge = (
        "<joint name='{}' type='revolute'><parent link='{}'/><child link='{}'/><origin xyz='0.5 0 0'/><axis xyz='{}'/>"
        "<limit lower='-2' upper='2' effort='9' velocity='1'/></joint>"
    )
    names, axes = ("cart", "upper", "fore", "tool"), ("0 -1 0", "0 -1 0", axis)
    joints = (hinge.format(f"j{k}", names[k], names[k + 1], axes[k]) for k in range(3))
    command.write("arm.urdf", f"<robot name='arm'>{''.join(map(body.format, names))}{''.join(joints)}</robot>")
    followed(command, "arm.toml", "--from", "arm.urdf")
    assert tomllib.loads(Path("arm.toml").read_text(encoding="utf-8"))["end_point"]["offset"] == offset


@pytest.mark.parametrize(
    ("axis", "rows", "placement"),
    [("0 1 0", ("x", "z"), ("x",)), ("1 0 0", ("y", "z"), ("y",)), ("0 0 1", ("x", "y"), ("x", "y", "yaw"))],
)
def test_an_arm_in_a_plane_is_placed_in_it(
    command: Command, axis: str, rows: tuple[str, ...], placement: tuple[str, ...]
) -> None:
    """Two hinges about one axis: wherever the machine may be put, the end-point stays in its plane."""
    turned = f"<axis xyz='{axis}'/><limit lower='-2' upper='2' effort='9' velocity='1'/>"
    inertial = "<inertial><origin xyz='0.3 0.3 0.3'/><mass value='9'/><inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/></inertial>"
    links = (
        "".join(f"<link name='{name}'>{inertial}</link>" for name in ("cart", "upper", "fore")) + "<link name='tip'/>"
    )
    joints = "".join(
        f"<joint name='{name}' type='{kind}'><parent link='{parent}'/><child link='{child}'/>"
        f"<origin xyz='0.6 0.6 0.6'/>{turned if kind == 'revolute' else ''}</joint>"
        for name, kind, parent, child in (
            ("shoulder", "revolute", "cart", "upper"), ("elbow", "revolute", "upper", "fore"), ("tool", "fixed", "fore", "tip"),
        )
    )  # fmt: skip
    robot = f"<robot name='arm'>{links}{joints}</robot>"
    command.write("arm.urdf", robot)
    followed(command, "arm.toml", "--from", "arm.urdf")
    machine = flexopt.load("arm.toml")
    assert (machine.task_rows, machine.base_coordinates) == (rows, placement)
    assert command("check", "arm.toml").stdout.strip().endswith("nothing to mend")
    text = Path("arm.toml").read_text(encoding="utf-8")
    line = next(line for line in text.splitlines() if line.startswith("placement"))
    command.write("astray.toml", text.replace(line, 'placement = ["x", "y", "yaw"]'))
    told = command("check", "astray.toml").stdout
    assert ("what is chosen may lie beside the target" in told) == (len(placement) == 1)
    if len(placement) == 1:
        assert f"placement = {list(placement)}, or " in told
        for turn in (1e-5, 0.3):  # rad about z: how a file rounds its angles, and an arm aside of its vehicle
            name = f"turned-{turn}.urdf"
            command.write(
                name, robot.replace("xyz='0.6 0.6 0.6'/><axis", f"xyz='0.6 0.6 0.6' rpy='0 0 {turn}'/><axis", 1)
            )
            command.write("turned.toml", text.replace("arm.urdf", name))
            told = command("check", "turned.toml").stdout
            assert ("may lie beside the target" in told) == ("changes by 0.309 m" in told) == (turn > 0.1)  # tan 0.3


@pytest.mark.parametrize(
    ("kind", "axis", "turn", "rows", "told"),
    [
        ("prismatic", "1 0 0", 0.3, ["x"], "0.309"),  # a line
        ("prismatic", "1 0 0", 0.0, ["x"], ""),
        ("prismatic", "0 0 1", 0.3, ["z"], ""),
        ("revolute", "0 1 0", 0.3, ["x"], "0.309"),
        ("revolute", "0 0 1", 0.3, ["x"], ""),  # a plane of which both are a part
    ],
)
def test_a_single_joint_aside_of_its_placement(
    command: Command, kind: str, axis: str, turn: float, rows: list[str], told: str
) -> None:
    inertial = "<inertial><mass value='9'/><inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/></inertial>"
    links = "".join(f"<link name='{name}'>{inertial}</link>" for name in ("cart", "arm")) + "<link name='tip'/>"
    joint = f"<joint name='a' type='{kind}'><parent link='cart'/><child link='arm'/><origin rpy='0 0 {turn}'/><axis xyz='{axis}'/>"
    joint += (
        "<limit lower='-1' upper='1' effort='9' velocity='1'/></joint><joint name='b' type='fixed'><parent link='arm'/>"
    )
    joint += "<child link='tip'/><origin xyz='0.6 0 0.4'/></joint>"
    command.write("arm.urdf", f"<robot name='arm'>{links}{joint}</robot>")
    command.write(
        "arm.toml",
        f"schema = 1\nname = 'arm'\nrobot = 'arm.urdf'\nactuated = ['a']\nplacement = ['x']\n[base]\nstiffness = "
        f"{{ z = 2e4, pitch = 9e3 }}\n[end_point]\nlink = 'tip'\nrows = {rows}\n",
    )
    found = command("check", "arm.toml").stdout
    assert (f"the end-point's y, which is no task row, changes by {told} m" in found) == bool(told), found
    assert ("may lie beside the target" in found) == bool(told)


def test_what_the_springs_carry_is_all_that_does_not_move_on_them(command: Command) -> None:
    """By Pinocchio, which holds the joints that are not driven."""
    inertial = "<inertial><mass value='{}'/><inertia ixx='9' ixy='0' ixz='0' iyy='9' iyz='0' izz='9'/></inertial>"
    parts = "<link name='footprint'/>"
    for name, kind, parent, mass in (
        ("below", "fixed", "footprint", None), ("ballast", "fixed", "chassis", 120), ("mast", "revolute", "ballast", 30),
        ("lamp", "fixed", "mast", 4),
    ):  # fmt: skip
        child = "chassis" if mass is None else name
        limits = "<axis xyz='0 0 1'/><limit lower='-1' upper='1' effort='1' velocity='1'/>" if kind != "fixed" else ""
        parts += (
            f"<joint name='to_{name}' type='{kind}'><parent link='{parent}'/><child link='{child}'/>{limits}</joint>"
        )
        parts += "" if mass is None else f"<link name='{name}'>{inertial.format(mass)}</link>"
    text = URDF.replace("</robot>", f"{parts}</robot>")
    command.write("arm.urdf", text)
    assert command("new", "own.toml", "--from", "arm.urdf", "--yes").code == 0
    written = Path("own.toml").read_text(encoding="utf-8")
    whole = pinocchio.buildModelFromXML(text)
    held = [whole.getJointId(x) for x in whole.names[1:] if x not in tomllib.loads(written)["actuated"]]
    carried = pinocchio.buildReducedModel(whole, held, pinocchio.neutral(whole)).inertias[0].mass
    assert carried == pytest.approx(900 + 120 + 30 + 4)
    assert f"The springs carry the root link, footprint, and what does not move on it, {carried:g} kg." in written


@pytest.mark.long
def test_a_site_is_the_end_point(command: Command) -> None:
    """Of several on the last link that which is named after a tool, or the one that --tip names."""
    command.write("arm.xml", MJCF)
    followed(command, "own.toml", "--from", "arm.xml")
    data = tomllib.loads(Path("own.toml").read_text(encoding="utf-8"))
    assert (data["end_point"]["site"], "link" in data["end_point"]) == ("tip", False)
    more = '<site name="camera"/><site name="tool_center" pos="0.2 0 0"/><site name="tip"'
    command.write("more.xml", MJCF.replace('<site name="tip"', more))
    followed(command, "more.toml", "--from", "more.xml")
    assert tomllib.loads(Path("more.toml").read_text(encoding="utf-8"))["end_point"]["site"] == "tool_center"
    followed(command, "asked.toml", "--from", "more.xml", "--tip", "camera")
    assert tomllib.loads(Path("asked.toml").read_text(encoding="utf-8"))["end_point"]["site"] == "camera"
    followed(command, "link.toml", "--from", "more.xml", "--tip", "stick")
    assert tomllib.loads(Path("link.toml").read_text(encoding="utf-8"))["end_point"]["link"] == "stick"


def hand(joints: str) -> str:
    """A vehicle with a mast, an arm of two joints and a head on the mast, and a hand of these joints behind a palm."""
    body = '<inertial><mass value="{}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    masses = {
        "vehicle": 90,
        "mast": 9,
        "head": 2,
        "upper": 5,
        "fore": 4,
        "palm": 0.5,
        "one": 0.1,
        "two": 0.1,
        "tip": 0.1,
    }
    links = "".join(f'<link name="{name}">{body.format(mass)}</link>' for name, mass in masses.items())

    def joint(name: str, kind: str, parent: str, child: str, x: float) -> str:
        limit = '<axis xyz="0 1 0"/><limit lower="-1" upper="1.2" effort="9" velocity="1"/>' * (kind != "fixed")
        return (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{x} 0 0.3"/>{limit}</joint>'
        )

    of_hand = {
        "parted": [("a", "revolute", "palm", "one"), ("b", "revolute", "palm", "two"), ("c", "revolute", "one", "tip")],
        "named": [("gripper", "revolute", "palm", "one"), ("b", "fixed", "one", "two"), ("c", "fixed", "one", "tip")],
    }
    parts = [
        joint("lift", "prismatic", "vehicle", "mast", 0.0), joint("nod", "revolute", "mast", "head", 0.1),
        joint("shoulder", "revolute", "mast", "upper", 0.2), joint("elbow", "revolute", "upper", "fore", 0.6),
        joint("mount", "fixed", "fore", "palm", 0.5),
        *(joint(*each, 0.0).replace('xyz="0.0 0 0.3"', 'xyz="0.04 0 0"') for each in of_hand[joints]),
    ]  # fmt: skip
    return f'<robot name="carrier">{links}{"".join(parts)}</robot>'


@pytest.mark.long
@pytest.mark.parametrize(("joints", "behind"), [("parted", ["a", "b", "c"]), ("named", ["gripper"])])
def test_a_hand_is_no_part_of_the_arm(command: Command, joints: str, behind: list[str]) -> None:
    """Fingers part from a palm, or a joint is named after them; what stands beside the arm far from its end is none."""
    command.write("carrier.urdf", hand(joints))
    followed(command, "own.toml", "--from", "carrier.urdf")
    text = Path("own.toml").read_text(encoding="utf-8")
    data = tomllib.loads(text)
    assert data["end_point"]["link"] == "palm"
    assert data["actuated"] == ["lift", "shoulder", "elbow"]
    left_out = text.partition("its joints are left out: ")[2].partition(")")[0]
    assert set(left_out.split(", ")) == set(behind)
    told = command("new", "other.toml", "--from", "carrier.urdf", "--yes").stdout
    assert f"link palm: {len(behind)} joint{'s' * (len(behind) > 1)} behind it" in told
    # Who names a link gets it.
    followed(command, "tip.toml", "--from", "carrier.urdf", "--tip", "one")
    asked = tomllib.loads(Path("tip.toml").read_text(encoding="utf-8"))
    assert asked["actuated"][-1] == behind[0]


def fixed_hand(frames: dict[str, tuple[str, float, float]]) -> str:
    """An arm of two hinges about z with two fingers fixed to its wrist beside the axis of the last, and frames there.

    `frames`: name -> link that it is fixed to, its place along z, m, and mass, kg.
    """

    def link(name: str, mass: float) -> str:
        inertia = '<inertia ixx="{0}" iyy="{0}" izz="{0}" ixy="0" ixz="0" iyz="0"/>'.format(0.1 * mass)
        return f'<link name="{name}"><inertial><mass value="{mass}"/>{inertia}</inertial></link>'

    def joint(child: str, parent: str, place: tuple[float, float, float], kind: str = "fixed") -> str:
        limit = '<axis xyz="0 0 1"/><limit lower="-1" upper="1.2" effort="9" velocity="1"/>' * (kind != "fixed")
        return (
            f'<joint name="to_{child}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{place[0]} {place[1]} {place[2]}"/>{limit}</joint>'
        )

    masses = {"vehicle": 90, "upper": 5, "wrist": 1, "left": 0.01, "left_end": 0.01, "right": 0.01, "right_end": 0.01}
    parts = [link(name, mass) for name, mass in masses.items()]
    parts += [joint("upper", "vehicle", (0.2, 0, 0.5), "revolute"), joint("wrist", "upper", (0.6, 0, 0), "revolute")]
    for side, y in (("left", 0.04), ("right", -0.04)):
        parts += [joint(side, "wrist", (0.1, y, 0.1)), joint(f"{side}_end", side, (0.05, 0, 0))]
    parts += [link(name, mass) + joint(name, on, (0, 0, z)) for name, (on, z, mass) in frames.items()]
    return f'<robot name="stiff hand">{"".join(parts)}</robot>'


@pytest.mark.long
@pytest.mark.parametrize(
    ("frames", "chosen", "why"),
    [
        ({}, "wrist", "like branches are fixed to it, as fingers of a hand; one of them ends in left_end"),
        ({"tool0": ("wrist", 0.0, 0.0)}, "tool0", "a mere frame fixed to wrist, as a tool's"),
        ({"centre": ("wrist", 0.2, 0.001)}, "centre", "a mere frame fixed to wrist, as a tool's"),
        # Neither a camera, nor a frame on a finger, nor what weighs as much as one.
        ({"tool_camera": ("wrist", 0.2, 0.0), "tip": ("left_end", 0.0, 0.0)}, "wrist", "as fingers of a hand"),
        ({"weight": ("wrist", 0.2, 0.5)}, "wrist", "as fingers of a hand"),
    ],
)
def test_a_finger_that_is_fixed_is_no_end_point(
    command: Command, frames: dict[str, tuple[str, float, float]], chosen: str, why: str
) -> None:
    """Of what is fixed to the last body a tool's frame is it, else the palm; a finger where it is asked for."""
    command.write("hand.urdf", fixed_hand(frames))
    followed(command, "own.toml", "--from", "hand.urdf")
    text = Path("own.toml").read_text(encoding="utf-8")
    assert tomllib.loads(text)["end_point"]["link"] == chosen
    assert f"(proposed: {why}" in text or f"{why}; one of them ends in" in text
    told = command("new", "other.toml", "--from", "hand.urdf", "--yes").stdout
    assert f"The end-point is link {chosen}: " in told
    assert why in " ".join(told.split())
    followed(command, "tip.toml", "--from", "hand.urdf", "--tip", "left_end")
    assert tomllib.loads(Path("tip.toml").read_text(encoding="utf-8"))["end_point"]["link"] == "left_end"


@pytest.mark.parametrize(("frames", "chosen"), [
    ([("ee_link", 0.3), ("tool0", 0.3)], "tool0"),
    # Elsewhere than at the tip: a flange, or what hangs beside it.
    ([("gripper_tip", 0.3), ("tool_changer", 0.1)], "gripper_tip"),
    ([("bucket_tooth", 0.5), ("toolbox", 0.1)], "bucket_tooth"),
])  # fmt: skip
def test_of_frames_at_the_tip_the_tools_is_proposed(
    frames: list[tuple[str, float]], chosen: str, tmp_path: Path
) -> None:
    inertial = '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    limit = '<limit lower="-2" upper="2" effort="9" velocity="1"/>'
    text = f'<robot name="r"><link name="foot">{inertial}</link><link name="arm">{inertial}</link>'
    text += (
        f'<joint name="lift" type="revolute"><parent link="foot"/><child link="arm"/><axis xyz="0 1 0"/>{limit}</joint>'
    )
    for name, x in frames:
        text += f'<link name="{name}"/><joint name="to_{name}" type="fixed"><parent link="arm"/><child link="{name}"/>'
        text += f'<origin xyz="{x} 0 0"/></joint>'
    (tmp_path / "arm.urdf").write_text(f"{text}</robot>", encoding="utf-8")
    assert read_chain(tmp_path / "arm.urdf", None, None).end == chosen


@pytest.mark.parametrize(
    ("robot", "chosen"),
    [("kinova.urdf", "j2s6s200_end_effector"), ("panda.urdf", "panda_hand_tcp"), ("pr2.urdf", "r_gripper_tool_frame"),
     ("ur5_robot.urdf", "tool0"), ("talos_full_v2.urdf", "gripper_left_base_link"), ("go2.urdf", "FL_foot")],
)  # fmt: skip
def test_where_public_robots_have_their_tools(robot: str, chosen: str) -> None:
    if robot not in PUBLIC:
        pytest.skip("not installed")
    assert read_chain(PUBLIC[robot], None, None).end == chosen


def test_joints_and_end_point_of_a_robot_can_be_chosen(command: Command) -> None:
    command.write("arm.urdf", URDF)
    followed(command, "own.toml", "--from", "arm.urdf", "--tip", "tool", "--actuated", "slew,boom,extend", "--gives", "z,pitch",
             "--stiffness", "4e6,3e6")  # fmt: skip
    data = tomllib.loads(Path("own.toml").read_text(encoding="utf-8"))
    assert data["end_point"]["link"] == "tool"
    assert data["base"]["stiffness"] == {"z": 4e6, "pitch": 3e6}
    # Coupled fingers stand still.
    assert "finger_b" in data["locked"]
    # What is commented out can be taken as it stands.
    text = Path("own.toml").read_text(encoding="utf-8")
    assert text.index("# capsules =") < text.index("\n[")
    taken = tomllib.loads(text.replace("# capsules =", "capsules ="))
    assert taken == data | {"capsules": "collision"}


@pytest.mark.long
def test_the_loop_that_can_be_taken_suits_the_machine(command: Command) -> None:
    """Of its units as of its size: as it stands in the file it is stable where that says; a robot's is no digger's."""

    def taken(*arguments: str) -> tuple[flexopt.Loop, str, flexopt.Outcome]:
        posture = command.json("new", "own.toml", "--yes", "--force", *arguments)["posture"]
        text = Path("own.toml").read_text(encoding="utf-8")
        block = text[text.index("# [loop]") :].split("\n\n")[0]
        command.write("own.toml", text.replace(block, re.sub(r"(?m)^# ", "", block)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", flexopt.FlexoptWarning)
            machine = flexopt.load("own.toml")
            assert machine.loop is not None
            return machine.loop, block, flexopt.outcome(machine, posture)

    flat, block, done = taken()
    assert done.decay > 0
    assert 'N m under control = "inverse", the default; N/m, another number, under "transpose"' in block
    assert 'N m s under control = "inverse", the default; N s/m' in block
    command.write("small.urdf", fixed_hand({}).replace('"90"', '"9"'))
    small, block, done = taken("--from", "small.urdf")
    assert done.decay > 0
    assert small.kp is not None
    assert flat.kp is not None
    assert small.kp[0] < flat.kp[0] / 10
    slides = (
        fixed_hand({}).replace('"revolute"', '"prismatic"').replace('<axis xyz="0 0 1"/>', '<axis xyz="1 0 0"/>', 1)
    )
    command.write("slides.urdf", slides)
    _, block, _ = taken("--from", "slides.urdf")
    assert '# N/m under control = "inverse", the default (' in block


def test_no_gains_are_proposed_where_no_loop_is_stable(command: Command) -> None:
    """In a singular posture nothing says how heavy the arm is."""
    assert command("new", "own.toml", "--yes").code == 0
    gains = gains_told(flexopt.load("own.toml"), (0.3, 0.0))
    assert (gains["kp"], gains["kv"]) == ("", "")
    block = render("study/templates/loop.toml", gains=gains)
    assert not re.search(r"(?m)^# k[pv] =", block)
    assert '(kp is in N m under control = "inverse"' in block


def test_nothing_is_written_over(command: Command) -> None:
    command.write("mine.toml", "mine")
    outcome = command("new", "mine.toml", "--yes")
    assert outcome.code == 2
    assert "--force" in outcome.stderr
    assert Path("mine.toml").read_text(encoding="utf-8") == "mine"
    assert command("new", "mine.toml", "--yes", "--force").code == 0
    assert flexopt.load("mine.toml").name == "mine"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--masses", "1,2,3", "--lengths", "1,-2", "--ratio", "x"), ("--masses", "2 numbers", "--lengths", "greater than 0", "m", "--ratio")),
        (("--links", "1"), ("--links", "from 2 to 8")),
        (("--limits", "1,0;0,1"), ("--limits", "below the upper end")),
        (("--gives", "x,z"), ("--gives", "x,y,rotation")),
        (("--stiffness", "1,1,1", "--frequency", "2"), ("--frequency", "told already")),
        (("--tip", "tool"), ("--tip", "goes with --from")),
        (("--from", "arm.urdf", "--links", "3"), ("--links", "without --from")),
        (("--from", "arm.urdf", "--tip", "toll"), ("--tip", "did you mean 'tool'")),
        (("--from", "arm.urdf", "--actuated", "slew,bom"), ("--actuated", "did you mean 'boom'")),
        (("--from", "nothing.urdf"), ("nothing.urdf",)),
        (("mine.json",), ("mine.json", ".toml")),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else None,
)  # fmt: skip
def test_bad_answers_are_named_together(command: Command, arguments: tuple[str, ...], words: tuple[str, ...]) -> None:
    command.write("arm.urdf", URDF)
    outcome = command("new", *arguments, "--yes")
    assert outcome.code == 2
    assert outcome.stdout == ""
    assert "Traceback" not in outcome.stderr
    for word in words:
        assert word in outcome.stderr
    assert not list(command.folder.glob("*.toml"))


def test_numbers_of_links_say_how_many_there_are(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where questions are still to be asked, of which the number of links is one."""
    document, _ = followed(command, "mine.toml", "--lengths", "2,1.2,0.6")
    assert len(document["joints"]) == 3
    monkeypatch.setattr("sys.stdin", io.StringIO("\n" * 20))
    outcome = command("new", "other.toml", "--masses", "400,200,100", "--json")
    assert outcome.code == 0, outcome.stderr
    assert [link.mass for link in flexopt.load("other.toml").links] == [400.0, 200.0, 100.0]


def test_what_was_given_is_not_called_proposed(command: Command) -> None:
    """Though it is the number that would have been."""
    given = ("--frequency", "2", "--ratio", "0.02", "--inertias", "133.333,24", "--base-inertia", "900")
    followed(command, "given.toml", "--lengths", "2,1.2", "--masses", "400,200", "--base-mass", "3600", *given)
    told = [line for line in Path("given.toml").read_text(encoding="utf-8").splitlines() if "(proposed: " in line]
    assert told
    assert all("half its length" in line for line in told)
    followed(command, "bare.toml", "--lengths", "2,1.2", "--masses", "400,200", "--base-mass", "3600")
    bare = Path("bare.toml").read_text(encoding="utf-8")
    for words in ("proposed: so that", "proposed: a slender rod", "proposed: radius of gyration"):
        assert words in bare


def test_questions_are_asked_again_until_the_answer_can_be_used(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    typed = ["digger", "3", "1,2", "2,1.5,1", "", "", "", "-1", "0.6", "", "", "rotation", "", "", "3", "0.05"]
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(typed) + "\n"))
    outcome = command("new", "--json")
    assert outcome.code == 0, outcome.stderr
    assert outcome.document["machine"] == "digger"
    assert "must be 3 numbers with commas between them, not 2" in outcome.stderr
    assert "must lie between 0 and 10000 m" in outcome.stderr
    machine = flexopt.load("digger.toml")
    assert [link.length for link in machine.links] == [2.0, 1.5, 1.0]
    assert machine.base.length == 0.6
    swing = held_swing(machine, outcome.document["posture"])
    assert swing == (pytest.approx(3.0, rel=1e-5), pytest.approx(0.05, rel=1e-4))


@pytest.mark.parametrize("arguments", [(), ("--from", "arm.urdf", "--out", "own.toml")])
def test_where_input_ends_it_is_told_what_answers(
    command: Command, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...]
) -> None:
    command.write("arm.urdf", URDF)
    for typed, question, option in (("", "'Name of the machine'", "--name"), ("digger\n", "", "--")):
        monkeypatch.setattr("sys.stdin", io.StringIO(typed))
        outcome = command("new", *arguments)
        assert outcome.code == 2
        (told,) = [line for line in outcome.stderr.splitlines() if "has no answer" in line]
        assert question in told
        assert f"; {option}" in told
        assert "--yes" in told
        assert [path.name for path in command.folder.iterdir()] == ["arm.urdf"]


def test_questions_can_be_left(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr("click.termui.visible_prompt_func", interrupted)
    assert command("new").code == 130
    assert not list(command.folder.iterdir())


@pytest.mark.long
def test_springs_proposed_for_a_small_machine_carry_it(command: Command) -> None:
    """At 2 Hz any machine sinks by 6 cm, which is much where it reaches 40 cm."""
    command.write("arm.urdf", small(hand("named"), 0.25))
    for name, arguments in (("robot", ("--from", "arm.urdf")), ("planar", ("--lengths", "0.2,0.15", "--masses", "1,0.6",
                            "--base-length", "0.05", "--base-mass", "3"))):  # fmt: skip
        followed(command, f"{name}.toml", *arguments)
        assert [finding for finding in flexopt.check(f"{name}.toml").findings if "stiffness" in finding.field] == []
        swing = float(re.search(r"swings at ([\d.]+) Hz", Path(f"{name}.toml").read_text(encoding="utf-8"))[1])
        assert 3 < swing < 6
    followed(command, "large.toml")
    assert "swings at 2 Hz" in Path("large.toml").read_text(encoding="utf-8")
    followed(command, "asked.toml", "--from", "arm.urdf", "--frequency", "2")
    assert "swings at 2 Hz" in Path("asked.toml").read_text(encoding="utf-8")


def small(robot: str, share: float) -> str:
    """The same with every length a share of what it was."""

    def shrunk(found: re.Match[str]) -> str:
        return f'xyz="{" ".join(f"{share * float(x):g}" for x in found[1].split())}"'

    return re.sub(r'(?<=<origin )xyz="([^"]*)"', shrunk, robot)


def test_a_joint_that_follows_an_actuated_one_is_said_to_be_held(command: Command) -> None:
    """A boom's parallelogram keeps its tool upright in the robot file; the machine that is written has no such joint."""
    follower = """
  <link name="upright"><inertial><origin xyz="0.3 0 0"/><mass value="80"/>
    <inertia ixx="4" iyy="9" izz="9" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="upright" type="revolute"><parent link="tool"/><child link="upright"/><origin xyz="1 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1e5" velocity="1"/>
    <mimic joint="boom" multiplier="-1"/></joint>
</robot>"""
    command.write("arm.urdf", URDF.replace("</robot>", follower))
    made = command("new", "own.toml", "--from", "arm.urdf", "--yes")
    assert made.code == 0
    assert "In the machine upright, which follows boom, is held: a coupling is not modelled." in made.stdout
    assert "upright, which follows boom, is held" in (command.folder / "own.toml").read_text(encoding="utf-8")


def test_no_turn_out_of_its_plane_is_proposed_of_an_arm_that_moves_in_one(command: Command) -> None:
    """Its end-point would not show it; of one that slews it does."""
    command.write("digger.urdf", (ROBOTS / "slewing-excavator.urdf").read_text(encoding="utf-8"))
    for actuated, proposed in (("slew,boom,stick,bucket", "z,roll,pitch"), ("boom,stick,bucket", "z,pitch")):
        made = command("new", "own.toml", "--from", "digger.urdf", "--actuated", actuated, "--yes", "--force")
        assert made.code == 0, made.stderr
        table = tomllib.loads((command.folder / "own.toml").read_text(encoding="utf-8"))["base"]
        assert ",".join(table["stiffness"]) == proposed


def test_joints_that_are_asked_for_say_which_arm_it_is(command: Command) -> None:
    """Of a robot with two arms alike the end-point is on the one whose joints are to be driven."""
    arm = """
      <link name="{0}1"><inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="{0}_lift" type="revolute"><parent link="trunk"/><child link="{0}1"/><axis xyz="0 1 0"/>
        <limit lower="-1" upper="1" effort="9" velocity="1"/></joint>
      <link name="{0}2"><inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="{0}_fold" type="revolute"><parent link="{0}1"/><child link="{0}2"/><origin xyz="1 0 0"/><axis xyz="0 1 0"/>
        <limit lower="-1" upper="1" effort="9" velocity="1"/></joint>"""
    trunk = """<link name="trunk"><inertial><mass value="9"/>
      <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
    two = command.folder / "two.urdf"
    two.write_text(f'<robot name="two">{trunk}{arm.format("l")}{arm.format("r")}</robot>', encoding="utf-8")
    for side in "lr":
        assert read_chain(two, None, [f"{side}_lift", f"{side}_fold"]).end == f"{side}2"


STUCK = """<robot name="stuck">
  <link name="carrier"><inertial><origin xyz="0 0 0.3"/><mass value="900"/>
    <inertia ixx="90" iyy="90" izz="120" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="boom"><inertial><origin xyz="0.6 0 0"/><mass value="80"/>
    <inertia ixx="1" iyy="10" izz="10" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tube"><inertial><origin xyz="0.5 0 0"/><mass value="50"/>
    <inertia ixx="1" iyy="5" izz="5" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="lift" type="revolute"><parent link="carrier"/><child link="boom"/><origin xyz="0 0 0.6"/>
    <axis xyz="0 -1 0"/><limit lower="0" upper="0" effort="0" velocity="0"/></joint>
  <joint name="extend" type="prismatic"><parent link="boom"/><child link="tube"/><origin xyz="1.3 0 0"/>
    <axis xyz="1 0 0"/><limit lower="0.2" upper="0.2" effort="0" velocity="0"/></joint>
</robot>"""


def test_joints_whose_limits_leave_no_room_are_named_and_get_some(command: Command) -> None:
    """As pinocchio reads them; by what messages say a machine comes of it."""
    Path("stuck.urdf").write_text(STUCK, encoding="utf-8")
    model = pinocchio.buildModelFromUrdf("stuck.urdf")
    assert model.lowerPositionLimit == pytest.approx(model.upperPositionLimit)
    called = command("new", "--from", "stuck.urdf", "--out", "arm.toml", "--yes")
    assert called.code != 0
    message = " ".join(called.stderr.split())
    assert "the limits leave no room, of lift (0 to 0 rad), extend (0.2 to 0.2 m); --actuated lift,extend" in message
    assert not Path("arm.toml").exists()
    found = flexopt.check("stuck.urdf")
    assert (found.faults, len(found.warnings)) == ((), 2)
    assert "joint 'extend': its limits (0.2 to 0.2 m) leave no room; to drive it say others in" in found.warnings[1]
    followed(command, "arm.toml", "--from", "stuck.urdf", "--actuated", "lift,extend")
    arm = flexopt.load("arm.toml")
    reach = float(sum(np.linalg.norm(placed.translation) for placed in model.jointPlacements[1:]))
    assert arm.joints == ("lift", "extend")
    assert arm.limits == (pytest.approx((-3.14, 3.14)), pytest.approx((-reach, reach), rel=1e-5))
    written = Path("arm.toml").read_text(encoding="utf-8")
    assert written.count("# rad (proposed: those of the robot file, 0 to 0 rad, leave no room)") == 1
    # Of one that has room nothing is proposed, and a joint that is not asked for stays where it is.
    Path("half.urdf").write_text(STUCK.replace('lower="0" upper="0"', 'lower="-1" upper="1"'), encoding="utf-8")
    followed(command, "half.toml", "--from", "half.urdf")
    half = flexopt.load("half.toml")
    assert (half.joints, half.limits) == (("lift",), ((-1.0, 1.0),))
    written = Path("half.toml").read_text(encoding="utf-8")
    assert "leave no room" not in written
    assert "all on the way to the end-point with room between their limits; not extend (0.2 to 0.2 m)" in written
    # Names are quoted for the option, for the shell, and for the file.
    Path("named.urdf").write_text(STUCK.replace('name="lift"', 'name="lift, 1.a"'), encoding="utf-8")
    message = " ".join(command("new", "--from", "named.urdf", "--out", "named.toml", "--yes").stderr.split())
    given = re.search(r"--actuated (.*) writes a file", message)
    assert given is not None
    (names,) = shlex.split(given[1])
    assert '[joints."lift, 1.a"]' in flexopt.check("named.urdf").warnings[0]
    followed(command, "named.toml", "--from", "named.urdf", "--actuated", names)
    assert tomllib.loads(Path("named.toml").read_text(encoding="utf-8"))["joints"].keys() == {"lift, 1.a", "extend"}
