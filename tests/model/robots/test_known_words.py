"""Words that a robot file's format does not know: every slip of the pen is a fault with the word that was meant."""

from __future__ import annotations

import re
import warnings
from importlib.metadata import version
from pathlib import Path

import mujoco
import pytest

from flexopt import FlexoptWarning, ModelError
from flexopt.model.robots.known import Known, known_elements
from flexopt.model.robots.reading import read_description
from tests.model.robots.files import MJCF, MJCF_MACHINE, URDF, URDF_MACHINE, changed, changed_text, line_of, read
from tests.model.robots.test_public_robots import installed

# What versions of MuJoCo since 2.3 had and 4.0 has no more, and what its printed schema leaves out.
RETIRED = {
    "camera orthographic", "compiler convexhull", "compiler exactmeshinertia", "contact internal", "option apirate",
    "option collision", "option mpr_iterations", "option mpr_tolerance", "flag passive", "flag sensornoise",
}  # fmt: skip
# Of the test files' visual, material and keyframe.
UNREAD = {"rgba", "filename", "qpos"}
OUTSIDE_THE_SCHEMA = {"frame", "replicate", "composite"}


def printed_schema() -> dict[str, set[str]]:
    """MuJoCo's own: the path of each element and its attributes."""
    found: dict[str, set[str]] = {}
    path: list[str] = []
    for line in mujoco.mj_printSchema(False, False).splitlines():
        entry = re.match(r"( *)(?:\(world\))?(\w+) +\([!*?R]\)(.*)", line)
        if entry:
            path = [*path[: len(entry[1]) // 3], entry[2]]
            found["/".join(path)] = set()
        found["/".join(path)] |= set((entry[3] if entry else line).split())
    return found


def our_schema(element: Known, path: str, within: tuple[Known, ...] = ()) -> dict[str, set[str]]:
    found = {path: element.attributes}
    for tag, child in element.children.items():
        if child not in within:
            found |= our_schema(child, f"{path}/{tag}", (*within, element))
    return found


def test_the_table_of_mjcf_is_mujocos() -> None:
    """Every element and attribute of the installed version; and of the newest, none beside them but retired ones."""
    theirs = {re.sub("^mujoco/body", "mujoco/worldbody", path): words for path, words in printed_schema().items()}
    theirs |= {path.replace("worldbody", "worldbody/body"): w for path, w in theirs.items() if "worldbody" in path}
    ours = our_schema(known_elements("mjcf"), "mujoco")
    assert len(theirs) > 150
    missing = {path: words - ours.get(path, set()) for path, words in theirs.items() if words - ours.get(path, set())}
    assert not missing
    assert set(theirs) <= set(ours)
    if int(version("mujoco").split(".")[0]) >= 4:
        for path, words in ours.items():
            if not OUTSIDE_THE_SCHEMA & set(path.split("/")) and not re.search("default/default|body/body", path):
                assert {f"{path.split('/')[-1]} {word}" for word in words - theirs[path]} <= RETIRED, path


@pytest.mark.long
def test_the_table_of_urdf_knows_every_published_word() -> None:
    """All URDF files of the package are read as they were: the only fault is of the one that holds no robot."""
    paths = installed("example-robot-data", lambda path: path.suffix == ".urdf")
    paths += installed("gymnasium", lambda path: path.suffix == ".xml")
    assert len(paths) > 80
    faults: list[str] = []
    for path in paths:
        robot, found = read_description(path, path.name)
        faults += [str(fault) for fault in found]
        assert not any("unknown" in warning for warning in robot.warnings)
    assert faults == ["ur3.urdf:6: robot: has no <link>"]


@pytest.mark.parametrize(
    ("old", "new", "place", "parts"),
    [
        ('<mass value="900"/>', '<mas value="900"/>', "<mas ", ["link 'chassis' <inertial>", "unknown element <mas>", "'mass'?"]),
        ('lower="-0.5"', 'lover="-0.5"', "lover", ["joint 'boom' <limit>", "unknown attribute 'lover'", "did you mean 'lower'?"]),
        ("<inertial>", "<inertail>", "<inertail>", ["link 'chassis'", "<inertail>", "did you mean 'inertial'?"]),
        ('<link name="tool"/>', '<lnk name="tool"/>', "<lnk", ["robot 'arm'", "<lnk>", "did you mean 'link'?"]),
        ('damping="0.7"', 'dampnig="0.7"', "dampnig", ["joint 'slew' <dynamics>", "'damping'?"]),
        ('rpy="0 0 0.4"', 'rotation="0 0 0.4"', "rotation", ["joint 'slew' <origin>", "there are quat_xyzw, rpy", 'ignore = ["unknown"]']),
    ],
)  # fmt: skip
def test_slips_in_urdf(tmp_path: Path, old: str, new: str, place: str, parts: list[str]) -> None:
    text = changed_text(URDF, old, new)
    if new == "<inertail>":
        text = changed_text(text, "</inertial>", "</inertail>")
    with pytest.raises(ModelError) as caught:
        read(tmp_path, text, URDF_MACHINE)
    assert len(caught.value.faults) == 1, caught.value
    assert all(part in str(caught.value) for part in [f"arm.urdf:{line_of(text, place)}", *parts]), caught.value


@pytest.mark.parametrize("name", ["urdf", "mjcf"])
def test_every_attribute_misspelt_is_a_fault_beside_all_others(tmp_path: Path, name: str) -> None:
    """Two letters of each attribute of the file swapped, alone and all at once: each is named with its line."""
    text, machine = (URDF, URDF_MACHINE) if name == "urdf" else (MJCF, MJCF_MACHINE)
    text = text.replace('<material name="paint">', "<material>").replace('<key name="home" ', "<key ")
    body = text.index("<robot" if name == "urdf" else "<mujoco")
    found = [m for m in re.finditer(r" (\w{2,})=", text) if m.start() > body and m[1] not in UNREAD]
    assert len(found) > 60

    def slip(word: str) -> str:
        return word[:-2] + word[-1] + word[-2] if word[-1] != word[-2] else word + "x"

    for match in found:
        wrong = text[: match.start(1)] + slip(match[1]) + text[match.end(1) :]
        with pytest.raises(ModelError) as caught:
            read(tmp_path, wrong, machine)
        assert len(caught.value.faults) <= 2  # a name that is missing is a fault of its own
        place = f":{text[: match.start()].count(chr(10)) + 1}: "
        assert any(place in f.field and slip(match[1]) in f.sentence for f in caught.value.faults), caught.value
    for match in reversed(found):
        text = text[: match.start(1)] + slip(match[1]) + text[match.end(1) :]
    with pytest.raises(ModelError) as caught:
        read(tmp_path, text, machine)
    assert sum("unknown attribute" in fault.sentence for fault in caught.value.faults) == len(found)


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ('mass="60"', 'mas="60"', ["body 'boom' <inertial>", "unknown attribute 'mas'", "did you mean 'mass'?"]),
        ('range="-30 80"', 'rnage="-30 80"', ["joint 'lift'", "did you mean 'range'?"]),
        ('<joint damping="3"/>', '<joint dampng="3"/>', ["default <joint>", "did you mean 'damping'?"]),
        ('<geom type="box"', '<goem type="box"', ["body 'chassis'", "unknown element <goem>", "did you mean 'geom'?"]),
        ('<motor joint="slew"/>', '<motor joint="slew" gaer="7"/>', ["<motor>", "'gear'?"]),
    ],
)  # fmt: skip
def test_slips_in_mjcf(tmp_path: Path, old: str, new: str, parts: list[str]) -> None:
    text = changed_text(MJCF, old, new)
    with pytest.raises(ModelError) as caught:
        read(tmp_path, text, MJCF_MACHINE)
    assert len(caught.value.faults) == 1, caught.value
    assert all(part in str(caught.value) for part in [f"arm.xml:{line_of(text, new)}", *parts]), caught.value


def test_mujoco_refuses_what_is_unknown_to_us(tmp_path: Path) -> None:
    for old, new in (
        ('mass="60"', 'mas="60"'),
        ('range="-30 80"', 'rnage="-30 80"'),
        ("<keyframe>", "<keyframe><kye/>"),
    ):
        tmp_path.joinpath("arm.xml").write_text(changed_text(MJCF, old, new))
        with pytest.raises(ValueError, match="rror"):
            mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))


def test_unknown_words_may_be_ignored_by_name(tmp_path: Path) -> None:
    text = changed_text(URDF, '<mass value="900"/>', '<mass value="900" vendor="x"/><colour/>')
    with pytest.raises(ModelError, match="2 faults"):
        read(tmp_path, text, URDF_MACHINE)
    with pytest.warns(FlexoptWarning, match=r"unknown attribute 'vendor' is left out; and 1 more") as caught:
        tree = read(tmp_path, text, changed(URDF_MACHINE, {"ignore": ["unknown"]}))
    told = caught[0].message
    assert isinstance(told, FlexoptWarning)
    assert "unknown element <colour>" in told.remarks[1]
    assert tree == read(tmp_path, URDF, URDF_MACHINE)


def test_orientations_as_quaternions(tmp_path: Path) -> None:
    """URDF 1.2: rpy 0 0 0.4 is the quaternion (0, 0, sin 0.2, cos 0.2)."""
    text = changed_text(URDF, 'rpy="0 0 0.4"', 'quat_xyzw="0 0 0.19866933079506122 0.9800665778412416"')
    ours, plain = read(tmp_path, text, URDF_MACHINE), read(tmp_path, URDF, URDF_MACHINE)
    for body, other in zip(ours.bodies, plain.bodies, strict=True):
        for row, wanted in zip(body.rotation, other.rotation, strict=True):
            assert row == pytest.approx(wanted, abs=1e-15)
    for wrong, sentence in (("0 0 0 0", "tells no orientation"), ('0 0 0 1" rpy="0 0 1', "one orientation is enough")):
        with pytest.raises(ModelError, match=sentence):
            read(tmp_path, changed_text(URDF, 'rpy="0 0 0.4"', f'quat_xyzw="{wrong}"'), URDF_MACHINE)


def test_shipped_robots_have_no_unknown_word() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for path in sorted((Path(__file__).parents[3] / "models" / "robots").iterdir()):
            robot, faults = read_description(path, path.name)
            assert not faults
            assert not robot.warnings
