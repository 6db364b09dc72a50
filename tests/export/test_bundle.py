"""What is written, what is refused, and that an existing folder is never lost."""

from __future__ import annotations

import json
import math
import re
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import flexopt
from flexopt.cli.commands import cli
from flexopt.errors import ExportError, InputError
from flexopt.export import PARTS, ExportReport, export_c
from flexopt.export.context import SINGLE_MARGIN_DEG
from flexopt.export.naming import TAKEN_PREFIXES
from tests.export.programs import GCC, MAKE
from tests.oracles.machines import Structure, random_machine

SMALL = ["kinematics", "controller"]


@pytest.fixture(scope="module")
def machine() -> flexopt.Machine:
    return flexopt.load("excavator")


@pytest.fixture(scope="module")
def whole(machine: flexopt.Machine, tmp_path_factory: pytest.TempPathFactory) -> ExportReport:
    """With every part that the excavator allows; left as it is."""
    return export_c(machine, tmp_path_factory.mktemp("whole") / "bundle")


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.long
def test_the_folder_names_its_origin(machine: flexopt.Machine, whole: ExportReport) -> None:
    report = whole
    manifest = json.loads((report.folder / "manifest.json").read_text())
    header = (report.folder / "include" / "excavator_control.h").read_text()
    assert set(manifest["parts"]) == set(report.parts) == set(PARTS) - set(report.left_out)
    assert set(report.left_out) == {"levers", "loop"}
    assert manifest["machine_sha256"] == machine.content_hash
    assert machine.content_hash in header
    assert report.bundle_sha256 == manifest["bundle_sha256"]
    assert report.bundle_sha256 in header
    assert set(contents(report.folder)) == set(report.files)
    for name in [o for group in report.parts.values() for o in group]:
        assert re.search(rf"\b{name}\(", header)
        assert name in (report.folder / "README.md").read_text()


@pytest.mark.long
def test_the_same_machine_gives_the_same_bytes(whole: ExportReport, tmp_path: Path) -> None:
    again = export_c(flexopt.load("excavator"), tmp_path / "b").folder
    assert contents(whole.folder) == contents(again)


def test_an_option_changes_the_hash(machine: flexopt.Machine, tmp_path: Path) -> None:
    hashes = {
        export_c(machine, tmp_path / str(k), parts=SMALL, **options).bundle_sha256
        for k, options in enumerate([{}, {"real": "float"}, {"baked": True}, {"singularity_margin_deg": 2.0}])
    }
    assert len(hashes) == 4


def test_single_precision_says_where_it_keeps_farther_from_singular_postures(
    machine: flexopt.Machine, tmp_path: Path
) -> None:
    """The README of single precision alone, where less is asked for; what it says are the tests of the functions."""

    def bundle(**options: Any) -> tuple[dict[str, float], str]:
        report = export_c(machine, tmp_path / "b", parts=["controller", "measures"], overwrite=True, **options)
        operations = [o for part in report.manifest["parts"].values() for o in part["operations"]]
        least = {o["c_name"]: g["minimum"] for o in operations for g in o["guards"] if g["name"] == "sine_squared"}
        return least, " ".join((report.folder / "README.md").read_text().split())

    least, readme = bundle(real="float", singularity_margin_deg=5.0)
    sentence = "refuses what is nearer than 10 degrees to singular postures, whatever less is asked for (here 5)"
    assert f"`SINGULAR_POSTURE`: `excavator_measures` {sentence}" in readme
    sines = {name: math.degrees(math.asin(math.sqrt(value))) for name, value in least.items()}
    assert sines == pytest.approx({"excavator_torque_inverse": 5.0, "excavator_measures": 10.0})
    assert SINGLE_MARGIN_DEG == 10.0
    for options in ({"real": "double"}, {"real": "float", "singularity_margin_deg": 10.5}):
        least, readme = bundle(**options)
        assert len(set(least.values())) == 1
        assert "whatever less" not in readme
    # Through the group: a command that is called alone keeps other names of its help.
    said = CliRunner().invoke(cli, ["export", "--help"]).output
    assert f"keep {SINGLE_MARGIN_DEG:g} at least" in " ".join(said.split())
    docs = Path(__file__).parents[2] / "docs" / "howto" / "posture-to-c.md"
    assert f"nearer than {SINGLE_MARGIN_DEG:g}° to singular" in docs.read_text(encoding="utf-8")


@pytest.mark.needs("gcc", "clang", "make")
def test_another_compiler_makes_every_object_again(machine: flexopt.Machine, tmp_path: Path) -> None:
    folder = str(export_c(machine, tmp_path / "bundle", parts=["kinematics"]).folder)

    def compiled(*options: str) -> str:
        return subprocess.run(
            ["make", "-C", folder, *options], capture_output=True, text=True, check=True
        ).stdout  # fmt: skip

    assert "gcc -std=c99" in compiled("CC=gcc")
    assert "-std=c99" not in compiled("CC=gcc")
    again = compiled("CC=clang")
    assert again.count("clang -std=c99") == again.count("-std=c99") == 4


def test_a_bundle_is_replaced_with_what_make_left(machine: flexopt.Machine, tmp_path: Path) -> None:
    folder = export_c(machine, tmp_path / "b", parts=SMALL).folder
    for name in ("selftest", ".compiled"):
        (folder / name).write_text("built")
    (folder / "src" / "excavator_common.o").write_text("built")
    export_c(machine, folder, parts=["kinematics"], overwrite=True)
    assert not (folder / "src" / "excavator_controller.c").exists()
    assert not any((folder / name).exists() for name in ("selftest", ".compiled"))
    assert list(tmp_path.iterdir()) == [folder]


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda f: (f / "notes.txt").write_text("mine"), "notes.txt"),
        (lambda f: (f / "manifest.json").unlink(), "something else"),
        (lambda f: (f / "manifest.json").write_text("{}"), "no bundle"),
    ],
)
def test_nothing_of_the_users_is_lost(machine: flexopt.Machine, tmp_path: Path, spoil, sentence: str) -> None:
    folder = export_c(machine, tmp_path / "b", parts=SMALL).folder
    spoil(folder)
    before = contents(folder)
    for overwrite, told in ((False, "overwrite replaces a bundle"), (True, sentence)):
        with pytest.raises(InputError, match=told):
            export_c(machine, folder, parts=SMALL, overwrite=overwrite)
    assert contents(folder) == before


def test_overwrite_replaces_edited_files_but_no_foreign_ones(machine: flexopt.Machine, tmp_path: Path) -> None:
    folder = export_c(machine, tmp_path / "b", parts=SMALL).folder
    fresh = contents(folder)
    (folder / "README.md").write_text("mine")
    export_c(machine, folder, parts=SMALL, overwrite=True)
    assert contents(folder) == fresh
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"notes\.txt"):
        export_c(machine, folder, parts=SMALL, overwrite=True)


def test_every_fault_is_named_at_once(machine: flexopt.Machine, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        export_c(
            machine, tmp_path / "b", parts=["kinematics", "telepathy"], real="half", control="magic", gain=-1.0,
            baked="yes", singularity_margin_deg=0.0, prefix="9 lives",
        )  # fmt: skip
    named = {fault.field for fault in caught.value.faults}
    assert named == {"parts", "real", "control", "gain", "baked", "singularity_margin_deg", "prefix"}
    assert not (tmp_path / "b").exists()


def test_a_file_in_the_way_is_named(machine: flexopt.Machine, tmp_path: Path) -> None:
    (tmp_path / "b").write_text("mine")
    with pytest.raises(InputError, match="is a file"):
        export_c(machine, tmp_path / "b", parts=SMALL)
    assert (tmp_path / "b").read_text() == "mine"


# Headers that the bundle's sources and their users include.
HEADERS = (
    "errno", "float", "inttypes", "limits", "locale", "math", "signal", "stdbool", "stddef", "stdint", "stdio", "stdlib",
    "string", "time", "unistd", "fcntl", "pthread", "semaphore", "sys/types", "sys/stat", "sys/socket", "termios",
)  # fmt: skip


def identifiers(path: Path) -> set[str]:
    """Of a C file, without comments and strings."""
    text = re.sub(r'(?s)/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\])*"', " ", path.read_text(encoding="utf-8"))
    return set(re.findall(r"[A-Za-z_]\w*", text))


@GCC
@pytest.mark.long
def test_no_prefix_makes_names_that_c_has_already(
    whole: ExportReport, machine: flexopt.Machine, tmp_path: Path
) -> None:
    own = f"{whole.prefix}_"
    files = [p for p in whole.folder.rglob("*") if p.suffix in (".c", ".h", ".cpp")]
    public = {w for p in whole.folder.glob("include/*.h") for w in identifiers(p) if w.lower().startswith(own)}
    headers = "".join(f"#include <{name}.h>\n" for name in HEADERS)
    listed = subprocess.run(["gcc", "-E", "-dM", "-"], input=headers, capture_output=True, text=True, check=True).stdout
    others = {w for p in files for w in identifiers(p)} | set(re.findall(r"#define (\w+)", listed))
    ends = {name[len(own) - 1 :] for name in public}
    # What would stand before the end of a public name, were it a prefix.
    found = {
        word[:k].lower()
        for word in others
        if not word.lower().startswith(own)
        for k in range(1, len(word))
        if word[k:] in ends and re.fullmatch(r"[a-z][a-z0-9_]*|[A-Z][A-Z0-9_]*", word[:k])
    }
    assert found <= TAKEN_PREFIXES, "others are taken, too"
    for name in sorted(TAKEN_PREFIXES):
        named = flexopt.machine_from_dict(machine.to_dict() | {"name": name})
        assert export_c(named, tmp_path / name, parts=["kinematics"]).prefix == f"machine_{name}"
        with pytest.raises(InputError, match="prefix"):
            export_c(machine, tmp_path / f"{name}2", parts=["kinematics"], prefix=name)


@MAKE
@pytest.mark.parametrize("real", ["double", "float"])
def test_the_example_closes_the_loop_around_the_machine(machine: flexopt.Machine, tmp_path: Path, real: str) -> None:
    parts = ["kinematics", "controller", "simulator"]
    folder = export_c(machine, tmp_path / "b", real=real, parts=parts).folder
    said = subprocess.run(["make", "-s", "-C", str(folder), "test"], capture_output=True, text=True, check=True).stdout
    errors = [float(error) for error in re.findall(r"end-point (\S+) m from its target", said)]
    assert errors[0] > 0.05
    assert max(errors[-4:]) < 1e-3
    assert "on target" in said
    assert "NOT" not in said


@MAKE
@pytest.mark.parametrize("real", ["double", "float"])
def test_the_stand_in_comes_to_rest_on_its_target(machine: flexopt.Machine, tmp_path: Path, real: str) -> None:
    """In single precision, too: the arm's small steps are not lost in the rounding of its angles."""
    folder = export_c(machine, tmp_path / "b", real=real, parts=["kinematics", "controller"]).folder
    options = "CFLAGS=-std=c99 -Wall -Wdouble-promotion -Werror"
    subprocess.run(["make", "-s", "-C", str(folder), options, "example"], capture_output=True, check=True)
    said = subprocess.run([str(folder / "example")], capture_output=True, text=True, check=True).stdout
    errors = [float(error) for error in re.findall(r"end-point (\S+) m from its target", said)]
    assert errors[0] > 0.05
    # What a float resolves at two metres.
    assert errors[-1] < 2.4e-7


def test_a_part_that_is_unknown_is_refused_with_those_that_there_are(machine: flexopt.Machine, tmp_path: Path) -> None:
    """The posture optimiser was one."""
    with pytest.raises(InputError, match=f"must be some of {', '.join(PARTS)}, not 'optimiser'"):
        export_c(machine, tmp_path / "b", parts=["kinematics", "optimiser"])


def test_what_a_machine_does_not_allow_is_left_out(
    machine: flexopt.Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for part in set(PARTS) - {"kinematics"}:
        monkeypatch.setitem(PARTS, part, replace(PARTS[part], refusal=lambda machine: f"{machine.name} is too small"))
    with pytest.raises(InputError, match="excavator is too small") as caught:
        export_c(machine, tmp_path / "b", parts=["kinematics", "margin"])
    assert [fault.value for fault in caught.value.faults] == ["'margin'"]
    assert not (tmp_path / "b").exists()
    report = export_c(machine, tmp_path / "b")
    assert list(report.parts) == ["kinematics"]
    assert report.left_out == report.to_dict()["left_out"]
    assert report.left_out["margin"] in repr(report)


@pytest.mark.long
def test_a_part_that_would_refuse_everything_is_not_written(tmp_path: Path) -> None:
    # A redundant arm with friction in some joints: a rate stays that neither decays nor is reached.
    rng = np.random.default_rng(1)
    data, _ = random_machine(rng, Structure(4, ("rotation",), ()))
    for index, link in enumerate(data["links"]):
        link["joint_damping"] = 10.0 if index == 0 else 0.0
    machine = flexopt.machine_from_dict(data)
    with pytest.raises(ExportError, match=r"robust_margin.*leave its part out"):
        export_c(machine, tmp_path / "b")
    assert not (tmp_path / "b").exists()
    export_c(machine, tmp_path / "b", parts=[part for part in PARTS if part not in ("margin", "levers", "loop")])


def test_coordinates_that_hold_the_placement_say_so(machine: flexopt.Machine, tmp_path: Path) -> None:
    """Of a machine in space passive coordinates count from the placement, which is an input beside them."""

    def told(of: flexopt.Machine | flexopt.Tree, folder: str) -> str:
        report = flexopt.export_c(of, tmp_path / folder, parts=["kinematics"])
        header = (report.folder / "include" / f"{report.prefix}_control.h").read_text(encoding="utf-8")
        before = header[: header.index("coordinates[")]
        return " ".join(before[before.rindex("/*") :].replace("\n   *", " ").split())

    planar = told(machine, "planar")
    assert planar.count("; base.x in the inertial frame: at rest where the base is placed") == 1
    assert planar.count("; base.rotation at rest 1.2451") == 1
    spatial = flexopt.load("mobile-manipulator")
    assert isinstance(spatial, flexopt.Tree)
    assert "inertial frame" not in told(spatial, "spatial")
    assert "at rest" not in told(spatial, "again")
