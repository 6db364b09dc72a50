"""Every shipped machine in both precisions: its bundle builds, tests itself and runs its example by its own README."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

import flexopt
from benchmarks.bundles import ended, examine
from flexopt.cli import main
from flexopt.export import PARTS, export_c
from flexopt.export.bundle import build_library
from flexopt.export.closing import settling_start, steady_hold
from flexopt.export.context import build_context
from flexopt.export.control import controller, kinematics
from flexopt.export.project import Project
from flexopt.export.simulator import simulator
from flexopt.model import AnyMachine, shipped_names, tree_from_dict
from tests.export.programs import MAKE
from tests.oracles.spatial import random_tree

# Without the parts whose C takes long to compile; `python -m benchmarks.bundles` does the whole.
LIGHT = ["kinematics", "controller", "simulator"]


@pytest.mark.long(
    "mobile-manipulator-double",
    "boom-stick-bucket-float",
    "mobile-manipulator-float",
    "slewing-excavator-double",
    "slewing-excavator-float",
    "truck-crane-double",
    "truck-crane-float",
    "boom-stick-bucket-double",
)
@MAKE
@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("name", shipped_names("models"))
def test_self_test_and_example_end_well(name: str, real, tmp_path: Path) -> None:
    folder = export_c(flexopt.load(name), tmp_path / "b", real=real, parts=LIGHT).folder
    command = ["make", "-s", "-C", str(folder), "CFLAGS=-O0", "test"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert "all passed" in done.stdout
    assert re.search(r"^on target$", done.stdout, flags=re.MULTILINE)


@pytest.mark.long
@pytest.mark.needs("gcc", "make", "cmake")
def test_the_command_follows_the_readme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows, fine = examine(["boom-stick-bucket"], ["float"], ["gcc"], ["kinematics", "controller"])
    assert fine
    assert rows[1][:6] == ("boom-stick-bucket", "float", "0", "gcc", "0", "0")
    report = export_c(flexopt.load("excavator"), tmp_path / "b", parts=["kinematics"])
    vectors = report.folder / "test" / "excavator_vectors.h"
    vectors.write_text(re.sub(r"= \{\n *-?\d", "= {9", vectors.read_text(), count=1))
    assert all(result != "0" for result in ended(report, "gcc", tmp_path))


@pytest.mark.parametrize("stand_in", [False, True])
@pytest.mark.parametrize("name", ["boom-stick-bucket", "slewing-excavator"])
def test_the_example_of_a_redundant_arm_damps_its_self_motion(name: str, stand_in: bool) -> None:
    machine = flexopt.load(name)
    at = build_context(machine, control="inverse", gain=1.0, single=False, baked=False, singularity_margin_deg=1.0)
    operations = {o.name: o for o in (*kinematics(at), *controller(at), *(() if stand_in else simulator(at)))}
    start = settling_start(at, operations)
    assert start is not None
    assert start.gains.nullspace_damping > 0
    low, high = np.array(machine.limits).T
    assert np.all((start.posture > low) & (start.posture < high))


@pytest.mark.parametrize("name", shipped_names("models"))
def test_the_example_holds_the_machine_as_the_ros2_node_does(name: str) -> None:
    """Whose loop decays, see below: one that settles alone may be at the brink of growing."""
    at = build_context(
        flexopt.load(name), control="inverse", gain=1.0, single=False, baked=False, singularity_margin_deg=10.0
    )
    start = settling_start(at, {o.name: o for o in (*kinematics(at), *controller(at), *simulator(at))})
    hold = steady_hold(at)
    assert start is not None
    assert start.decays
    assert hold.decays
    assert start.posture.tolist() == hold.posture.tolist()
    assert start.gains == hold.gains


def around(machine: AnyMachine, parts: list[str]) -> dict[str, str]:
    """The texts around a library, by their paths."""
    options = {"control": "inverse", "gain": 1.0, "baked": False, "singularity_margin_deg": 1.0}
    return Project(build_library(machine, parts, real="double", prefix="case", **options), "0" * 64).files()


@pytest.mark.parametrize("name", shipped_names("models"))
def test_the_ros2_node_holds_the_machine_at_the_rate_that_it_states(name: str) -> None:
    """By `flexopt.outcome`, and with as old a measurement as the time-out lets through, at the slowest rate that does."""
    machine = flexopt.load(name)
    text = around(machine, ["controller"])["examples/ros2_node.cpp"]
    given = {
        key: float(x) for key, x in re.findall(r'declare_parameter\("(\w+_(?:gain|damping))", ([-+.e\d]+)\)', text)
    }
    rate = float(re.search(r"kRate = (\d+);", text)[1])
    samples = float(re.search(r"kTimeout = (\d+) / kRate;", text)[1])
    assert f"for {rate:g} of them a second" in text
    assert f"the time-out of {samples:g} samples" in text
    begins = re.search(r"start = \{\{(.*?)\}\}", text)[1]
    posture = [float(x) for x in begins.split(", ")]
    redundant = len(machine.joints) > len(machine.task_rows)
    assert ("nullspace_damping" in given) == redundant
    constructed = re.search(r"Controller controller\((.*)\);", text)[1]
    assert [float(x) for x in constructed.split(", ")] == list(given.values())
    loop = {"drive": "torque", "kp": given["proportional_gain"], "kv": given["derivative_gain"]}
    loop |= {"nullspace_damping": given["nullspace_damping"]} if redundant else {}
    for period, dead_time in ((1 / rate, 0.0), (1 / rate, samples / rate), (samples / rate, samples / rate)):
        found = flexopt.outcome(machine, posture, loop=loop | {"rate": 1 / period, "dead_time": dead_time})
        assert found.decay > 0, (period, dead_time)


@pytest.mark.parametrize(
    ("rows", "taken"), [(("x", "z"), "m.point.x, m.point.z"), (("z",), "m.point.z"), (("x", "z", "pitch"), "")]
)
def test_the_ros2_node_takes_the_rows_of_the_task(rows: tuple[str, ...], taken: str) -> None:
    """A point has no orientation: of a task that has one there is no node, and none is spoken of."""
    texts = around(tree_from_dict(random_tree(17, rows=rows, counts=(2, 3))), ["controller"])
    node = texts.get("examples/ros2_node.cpp", "")
    assert bool(node) == ("ros2_node.cpp" in texts["README.md"]) == bool(taken)
    if taken:
        assert f"return {{{{{taken}}}}};" in node


def test_the_example_of_a_slide_speaks_of_forces() -> None:
    machine = tree_from_dict(random_tree(9, rows=("x", "z", "pitch"), counts=(2, 3)))
    assert machine.joint_units == ("m", "rad", "rad")
    text = around(machine, ["kinematics", "controller"])["examples/main.c"]
    assert "force of the first joint %.6g N\\n" in text
    assert "/* kg or kg m^2, of each joint of the stand-in" in text


def test_the_readme_says_what_the_example_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """An arm that can hardly move has no start from which its loop settles."""
    monkeypatch.setattr("flexopt.export.closing.POSTURES", 1)
    data = flexopt.load("excavator").to_dict()
    data["links"][0]["limits"], data["links"][1]["limits"] = [0.9, 0.95], [-1.6, -1.55]
    texts = around(flexopt.machine_from_dict(data), ["kinematics", "controller"])
    assert "Calls every function of the bundle once" in texts["examples/main.c"]
    assert "calls each function once" in texts["README.md"]


def test_help_names_all_parts(capsys: pytest.CaptureFixture[str]) -> None:
    main(["export", "--help"])
    said = " ".join(capsys.readouterr().out.split())
    for name, part in PARTS.items():
        assert f"{name} ({part.title})" in said
