"""What orientation rows are: the sentence of header, README and FMU, read back, gives by SciPy what C computes."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import flexopt
from flexopt.export import export_c
from flexopt.export.fmu.interface import Interface
from flexopt.model import Tree, tree_from_dict
from flexopt.simulation.scenario import build_scenario, checked_options
from tests.export.bundle_library import BundleLibrary
from tests.export.programs import GCC

ROWS = ("roll", "pitch", "yaw")
AXES = {"slew": [0.0, 0.0, 1.0], "boom": [0.0, -1.0, 0.0], "wrist": [0.6, 0.0, 0.8], "tool": [1.0, 0.0, 0.0]}
REFERENCE = Rotation.from_euler("xyz", [0.2, -0.3, 0.5]).as_matrix().tolist()
OWN = Rotation.from_euler("xyz", [-0.1, 0.4, 0.7]).as_matrix().tolist()
SENTENCE = re.compile(
    r"(roll|pitch|yaw) = (\S+) m \* phi_([xyz]), .*? positive from its ([xyz]) towards its ([xyz]);.*? "
    r"R_reference: (.+?); R_end_point: the axes of (\w+)(?: times (.+?))?; columns"
)


def wrist(**end: Any) -> Tree:
    """A base that pitches, and four hinges whose bodies are not turned at 0."""
    joint: dict[str, Any] = {"name": "base.pitch", "kind": "hinge", "axis": [0.0, 1.0, 0.0], "passive": True,
                             "stiffness": 1e5, "damping": 1e2}  # fmt: skip
    body: dict[str, Any] = {"mass": 20.0, "inertia": [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]}
    bodies = [{"name": "base", "joint": joint} | body]
    for name, axis in AXES.items():
        joint = {"name": name, "kind": "hinge", "axis": axis, "joint_damping": 1.0}
        bodies.append(
            {"name": f"{name}_1", "parent": bodies[-1]["name"], "joint": joint, "position": [0.3, 0.0, 0.5]} | body
        )
    tip = {"body": "tool_1", "position": [0.4, 0.1, 0.0]} | end
    return tree_from_dict({"schema": 1, "name": "wrist", "bodies": bodies, "end_point": tip})


def turned(q: np.ndarray, yaw: float) -> np.ndarray:
    """Axes of the tool on a base that is placed at a yaw, by a chain of SciPy's rotations."""
    found = Rotation.from_rotvec([0.0, 0.0, yaw])
    for axis, angle in zip([[0.0, 1.0, 0.0], *AXES.values()], q, strict=True):
        found *= Rotation.from_rotvec(angle * np.array(axis))
    return found.as_matrix()


def by_words(text: str, q: np.ndarray, yaw: float = 0.0) -> dict[str, float]:
    """The rows as the sentences in a text tell them."""
    found: dict[str, float] = {}
    for row, length, axis, first, second, reference, body, own in SENTENCE.findall(" ".join(text.split())):
        assert body == "tool_1"
        of = np.eye(3) if reference == "the inertial axes" else np.array(json.loads(reference))
        turn = of.T @ turned(q, yaw) @ (np.array(json.loads(own)) if own else np.eye(3))
        found[row] = float(length) * Rotation.from_matrix(turn).as_rotvec()["xyz".index(axis)]
        a, b = "xyz".index(first), "xyz".index(second)
        # Of the first axis more has come to lie along the second than the other way round.
        assert np.sign(turn[b, a] - turn[a, b]) == np.sign(found[row]) != 0
    return found


@GCC
@pytest.mark.parametrize(
    "end",
    [
        {"rows": ["x", *ROWS], "length": 2.0, "reference": REFERENCE, "rotation": OWN},
        {"rows": ["z", "pitch"], "length": 0.35},
    ],
    ids=["turned", "plain"],
)
def test_header_and_readme_tell_what_c_computes(end: dict[str, Any], tmp_path: Path) -> None:
    report = export_c(wrist(**end), tmp_path / "b", parts=["kinematics", "controller"])
    library = BundleLibrary(report, tmp_path)
    header = (report.folder / "include" / "wrist_control.h").read_text()
    names = ", ".join(f"AXIS_{row.upper()}" for row in end["rows"] if row in ROWS)
    members = re.findall(
        r"/\*(?:(?!\*/).)*?\*/\s+wrist_real (?:\w*_point|\w+_rate)\[WRIST_TASK\]", header, flags=re.DOTALL
    )
    assert len(members) == 9
    assert all(f"orientation as told at {names}" in re.sub(r"\s+(\* )?", " ", member) for member in members)
    assert all(f"WRIST_{name}" in header for name in names.split(", "))
    # A comment goes on with a star.
    texts = [re.sub(r"\n \* ", " ", header), (report.folder / "README.md").read_text()]
    for q in ([0.1, 0.4, -0.6, 0.9, 0.3], [-0.2, -0.5, 0.8, -0.3, 1.1], [0.05, 1.0, 0.3, 0.2, -0.9]):
        status, out = library("kinematics", coordinates=q, placement=[0.5, -0.2, 0.3])
        assert status == "OK"
        computed = {row: x for row, x in zip(end["rows"], out["end_point"], strict=True) if row in ROWS}
        assert computed
        for text in texts:
            assert by_words(text, np.array(q), 0.3) == pytest.approx(computed, rel=0, abs=1e-10)


def test_variables_of_an_fmu_tell_it_too() -> None:
    machine = wrist(rows=["z", "pitch"], length=2.0, reference=REFERENCE)
    posture = [0.4, -0.6, 0.9, 0.3]
    scenario = build_scenario(machine, checked_options("test", machine, {"posture": posture, "kp": 1e3, "kv": 1e2}))
    made: Any = Interface(scenario, "co-simulation", None)  # type: ignore[arg-type]
    plant = flexopt.build_plant(machine)
    q = np.array([0.1, *posture])
    pitch = float(plant.end_point(q, np.zeros(plant.n_base), plant.parameter_values)[1])
    texts = {v.name: v.text for v in (*made.inputs, *made.outputs, *made.calculated)}
    for name in ("target", "end_point", "rest_end_point"):
        assert by_words(texts[f"{name}.pitch"], q) == pytest.approx({"pitch": pitch}, rel=0, abs=1e-10)
        assert texts[f"{name}.z"].endswith("z, inertial frame")


def test_without_orientation_rows_nothing_is_told(tmp_path: Path) -> None:
    folder = export_c(wrist(rows=["x", "z"], length=2.0), tmp_path / "b", parts=["kinematics", "controller"]).folder
    for text in ((folder / "include" / "wrist_control.h").read_text(), (folder / "README.md").read_text()):
        assert "orientation" not in text
        assert "rotation vector" not in text
