"""Files that are far larger, deeper or more tangled than any machine: one clear error, and the reading ends."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from flexopt import ModelError, load, load_experiment, load_problem, machine_from_dict, tree_from_dict
from flexopt.errors import FAULTS_SHOWN
from flexopt.model.robots import load_robot, robot_from_dict

BASE = """name = "a"
[base]
length = 1.0
com = 0.5
mass = 100.0
inertia = 10.0
rest_angle = 1.0
stiffness = { x = 1e5 }
"""
LINK = '[[links]]\nname = "l%d"\nlength = 1.0\ncom = 0.5\nmass = 1.0\ninertia = 0.1\n'
ARM = BASE + LINK % 1 + LINK % 2

TOML: dict[str, tuple[str, str]] = {
    "empty links": (BASE + "[[links]]\n" * 4000, "links: has 4000 tables; at most 250 are read"),
    "links": (BASE + "".join(LINK % i for i in range(1000)), "links: has 1000 tables"),
    "empty cylinders": (ARM + "[[cylinders]]\n" * 4000, "cylinders: has 4000 tables; at most 1000"),
    "keys": ("".join(f"k{i} = {i}\n" for i in range(20_000)), "file: has 20000 keys; at most 1000"),
    "a megabyte": ('name = "' + "x" * 1_000_000 + '"', "larger than 500 kB"),
    "a long key": ("a." * 100_000 + "a = 1", "a key of more than 30 words"),
    "a long table name": ("[" + "a." * 900 + "a]", "a key of more than 30 words"),
    "deep lists": ("a = " + "[" * 300 + "]" * 300, "a: tables or lists are nested more than 30 deep"),
    "deep tables": ("a = " + "{a=" * 300 + "1" + "}" * 300, "nested more than 30 deep"),
    "deeper lists": ("a = " + "[" * 50_000, "is not valid TOML"),
    "tables in tables": ("".join(f"[a.b{i}.c]\n" for i in range(5000)), "a: has 5000 keys"),
    "a list for a name": ("name = [" + "1," * 200_000 + "]", "name = [1, 1, "),
}


@pytest.mark.parametrize("case", TOML)
@pytest.mark.parametrize("read", [load, load_problem, load_experiment, load_robot])
def test_machine_and_problem_files(tmp_path: Path, case: str, read: Callable[[Path], object]) -> None:
    text, sentence = TOML[case]
    path = tmp_path / "file.toml"
    path.write_text(("[simulation]\n" if read is load_experiment else "") + text)
    with pytest.raises(ModelError) as caught:
        read(path)
    assert len(str(caught.value)) < 20_000
    if read is load:
        assert sentence in str(caught.value)


def test_long_words_are_no_long_keys(tmp_path: Path) -> None:
    """Text with many dots, lists of many numbers and long words are read as what they are."""
    path = tmp_path / "file.toml"
    path.write_text(f'description = "{"." * 5000} {"x" * 300_000} {"1.5 " * 1000}"\n' + ARM)
    assert load(path).joints == ("l1", "l2")


def test_dictionaries_that_hold_themselves() -> None:
    loop: dict[str, object] = {"name": "a"}
    loop["base"] = loop
    deep: object = 1
    for _ in range(5000):
        deep = [deep]
    for data in (loop, {"name": "a", "bodies": deep}, {"links": [{}] * 4000}):
        for read in (machine_from_dict, tree_from_dict, lambda d: robot_from_dict(d, folder=".")):
            with pytest.raises(ModelError) as caught:
                read(data)
            assert len(str(caught.value)) < 5000


LINK_XML = '<link name="l%d"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
JOINT_XML = '<joint name="j%d" type="continuous"><parent link="l%d"/><child link="l%d"/></joint>'
MACHINE = {
    "name": "a",
    "robot": "arm.xml",
    "actuated": ["j1"],
    "lock_others": True,
    "end_point": {"link": "l1", "rows": ["x"]},
}


def chain(count: int) -> str:
    links = "".join(LINK_XML % i for i in range(count + 1))
    return f"<robot>{links}{''.join(JOINT_XML % (i, i - 1, i) for i in range(1, count + 1))}</robot>"


def deep(*tags: str) -> str:
    return "".join(f"<{tag}>" for tag in tags) + "".join(f"</{tag}>" for tag in reversed(tags))


XML: dict[str, tuple[Callable[[], str], str]] = {
    "joints": (lambda: chain(4000), "robot: has 4000 joints; at most 1000 are read"),
    "bodies": (
        lambda: "<mujoco><worldbody>" + "".join(f'<body><joint name="j{i}"/></body>' for i in range(3000)) + "</worldbody></mujoco>",
        "has 3000 joints",
    ),
    "elements": (lambda: "<robot>" + '<link name="a"/>' * 300_000 + "</robot>", "more than 200000 elements"),
    "repeated names": (lambda: "<robot>" + '<link name="a"/>' * 50_000 + "</robot>", f"and {49_999 - FAULTS_SHOWN} more"),
    "unknown elements": (lambda: "<robot><link>" + "<inertail/>" * 50_000 + "</link></robot>", "more than 1000 words that are unknown"),
    "attributes": (lambda: "<robot " + " ".join(f'a{i}="1"' for i in range(50_000)) + "/>", "50000 attributes; at most 200"),
    "a long name": (lambda: f'<robot><link name="{"a" * 1_000_000}"><b/></link></robot>', "link 'aaaa"),
    "a long number": (lambda: '<robot><link name="a"><inertial><mass value="' + "1 " * 500_000 + '"/></inertial></link></robot>', "needs <mass> and"),
    "depth": (lambda: deep(*["robot"] * 5000), "nested more than 200 deep"),
    "size": (lambda: "<robot>" + " " * 16_000_000 + "</robot>", "larger than 16000 kB"),
    "entities": (
        lambda: '<!DOCTYPE r [<!ENTITY a "b">' + "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 30)) + "]><robot>&a29;</robot>",
        "document type declaration",
    ),
    "an outer entity": (lambda: '<!DOCTYPE r SYSTEM "file:///etc/passwd"><robot/>', "document type declaration"),
}  # fmt: skip


@pytest.mark.parametrize("case", XML)
def test_robot_files(tmp_path: Path, case: str) -> None:
    text, sentence = XML[case]
    tmp_path.joinpath("arm.xml").write_text(text())
    with pytest.raises(ModelError) as caught:
        robot_from_dict(MACHINE, folder=tmp_path)
    assert sentence in str(caught.value)
    assert len(str(caught.value)) < 20_000


def test_as_many_joints_as_are_read(tmp_path: Path) -> None:
    tmp_path.joinpath("arm.xml").write_text(chain(1000))
    with pytest.raises(ModelError, match="no passive coordinate"):
        robot_from_dict(MACHINE, folder=tmp_path)


BODY = '<worldbody><body name="l1"><joint name="j1"/><geom size="1"/></body></worldbody>'


def includes(folder: Path, root: str, **files: str) -> str:
    """What the reading of a model with these files says."""
    for name, inner in {"arm": root, **files}.items():
        folder.joinpath(f"{name}.xml").write_text(f"<mujoco>{inner}</mujoco>")
    with pytest.raises(ModelError) as caught:
        robot_from_dict(MACHINE, folder=folder)
    return str(caught.value)


@pytest.mark.parametrize("spelt", ["./arm.xml", "../{here}/arm.xml", "sub/../arm.xml", "link.xml"])
def test_a_file_that_includes_itself_however_it_is_spelt(tmp_path: Path, spelt: str) -> None:
    tmp_path.joinpath("sub").mkdir()
    tmp_path.joinpath("link.xml").symlink_to(tmp_path / "arm.xml")
    message = includes(tmp_path, f'<include file="{spelt.format(here=tmp_path.name)}"/>{BODY}')
    assert "is included twice, or includes itself" in message
    assert message.count("\n") == 0


def test_includes_that_double(tmp_path: Path) -> None:
    """Thirty files, each of which includes the next one twice in two spellings: 2³⁰ readings, if it were not noticed."""
    both = '<include file="f{0}.xml"/><include file="./f{0}.xml"/>'
    message = includes(tmp_path, both.format(1), **{f"f{i}": both.format(i + 1) for i in range(1, 30)}, f30="")
    assert message.count("is included twice") == 30


@pytest.mark.long
def test_many_includes(tmp_path: Path) -> None:
    for i in range(600):
        tmp_path.joinpath(f"f{i}.xml").write_text(f'<mujoco><include file="f{i + 1}.xml"/></mujoco>')
    assert "includes more than 500 files" in includes(tmp_path, '<include file="f0.xml"/>')
    inner = deep(*["body"] * 90).replace("<body></body>", '<include file="f%d.xml"/>')
    files = {f"f{i}": inner % (i + 1) for i in range(30)}
    assert "nested more than 200 deep, with included files" in includes(tmp_path, '<include file="f0.xml"/>', **files)
    big = '<body name="a"/>' * 90_000
    message = includes(
        tmp_path, '<include file="f0.xml"/><include file="f1.xml"/><include file="f2.xml"/>', f0=big, f1=big, f2=big
    )
    assert "with the included files the model has more than 200000 elements" in message


def test_what_cannot_be_included(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.xml")
    assert "pipe.xml: cannot be read (it is no file)" in includes(tmp_path, '<include file="pipe.xml"/>')
    assert "cannot be read" in includes(tmp_path, '<include file="gone.xml"/>')
    assert "cannot be read" in includes(tmp_path, f'<include file="{"x" * 5000}"/>')
