"""What scripts rely on: keys and types of the JSON documents, spelling of options, streams, files and exit codes."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import warnings
import xml.etree.ElementTree as ET
from importlib.metadata import version
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import flexopt
from flexopt.cli.analysis import select_command
from flexopt.cli.commands import COMMANDS
from flexopt.foundation.documents import build_version
from flexopt.selection.nlp.program import Program
from tests.cli.command import MACHINE, PROBLEM, THIRD_LINK, Command, strict_json, toml

ROOT = Path(__file__).parents[2]
EVALUATE = ("evaluate", "excavator", "--posture", "0.9929,-2.6306")
SELECT = ("select", "excavator", "--end-point", "0,1.6")
EVALUATE_KEYS = {
    "machine": str,
    "control": str,
    "base": list,
    "base_coordinates": list,
    "posture": list,
    "joints": list,
    "end_point": list,
    "frequencies_hz": list,
    "damping_ratios": list,
    "w": list,
    "rigid": float,
    "in_phase": list,
    "in_phase_strict": list,
    "epsilon_max": float,
    "gain": float,
    "gradient": dict,
    "provenance": dict,
}


def check_evaluation(document: dict[str, Any], *, modes: int, joints: list[str]) -> None:
    types = {key: type(document.get(key, KeyError)) for key in EVALUATE_KEYS}
    assert types == EVALUATE_KEYS
    assert document["base_coordinates"] == ["x"]
    assert document["joints"] == joints
    assert document["gradient"]["variables"] == ["x", *joints]
    assert len(document["gradient"]["epsilon_max"]) == len(document["gradient"]["variables"])
    assert np.shape(document["gradient"]["w"]) == (modes, 1 + len(joints))
    lengths = {"base": 1, "posture": len(joints), "end_point": 2}
    lengths |= dict.fromkeys(("frequencies_hz", "damping_ratios", "w", "in_phase", "in_phase_strict"), modes)
    assert {key: len(document[key]) for key in lengths} == lengths
    for key in ("base", "posture", "end_point", "frequencies_hz", "damping_ratios", "w"):
        assert all(type(number) is float for number in document[key])
    for key in ("in_phase", "in_phase_strict"):
        assert all(type(answer) is bool for answer in document[key])


def test_evaluate_document(command: Command) -> None:
    document = command.json(*EVALUATE, "--base", "0.25", "--gain", "4e5")
    check_evaluation(document, modes=3, joints=["boom", "stick"])
    assert document["machine"] == "excavator"
    assert document["control"] == "inverse"
    assert document["base"] == [0.25]
    assert document["posture"] == [0.9929, -2.6306]
    assert document["gain"] == 4e5


def test_evaluate_document_of_a_longer_arm_on_a_simpler_base(command: Command) -> None:
    patch = THIRD_LINK | {"base.stiffness.x": None, "base.stiffness.y": None}
    command.write("machine.toml", toml(MACHINE, patch))
    document = command.json("evaluate", "machine.toml", "--posture", "1,-1,-0.5", "--control", "transpose")
    check_evaluation(document, modes=1, joints=["boom", "stick", "bucket"])
    assert document["control"] == "transpose"


def test_numbers_of_a_document_agree_with_each_other(command: Command) -> None:
    document = command.json(*EVALUATE)
    residues = np.array(document["residues"]["R"])
    symmetric = residues + residues.transpose(0, 2, 1)
    np.testing.assert_allclose(document["w"], np.linalg.eigvalsh(symmetric)[:, 0], rtol=1e-6)
    rigid = np.array(document["residues"]["R0"])
    assert document["rigid"] == pytest.approx(np.linalg.eigvalsh(rigid + rigid.T)[0], rel=1e-9)
    assert document["in_phase"] == [bool(np.trace(residue) > 0) for residue in residues]
    assert document["in_phase_strict"] == [bool(np.all(np.diag(residue) >= 0)) for residue in residues]
    assert document["frequencies_hz"] == sorted(document["frequencies_hz"])
    # Wherever the base stands, the machine is the same.
    np.testing.assert_allclose(np.array(document["gradient"]["w"])[:, 0], 0.0, atol=1e-18)


def test_provenance(command: Command) -> None:
    provenance = command.json(*EVALUATE, "--gravity", "--damped")["provenance"]
    assert provenance["machine"] == "excavator"
    assert provenance["machine_sha256"] == flexopt.load("excavator").content_hash
    assert provenance["casadi"] == version("casadi")
    assert provenance["flexopt"] == build_version()
    assert provenance["options"]["gravity"] is True
    assert provenance["options"]["damped"] is True


def test_switches_change_the_numbers(command: Command) -> None:
    plain = command.json(*EVALUATE)
    gravity = command.json(*EVALUATE, "--gravity")
    damped = command.json(*EVALUATE, "--damped")
    assert plain["static_deflection"] == [0.0, 0.0, 0.0]
    # The vertical spring carries all the weight, the horizontal one none.
    weight = (5291.5 + 766.6 + 458.2) * 9.81
    assert gravity["static_deflection"][:2] == pytest.approx([0.0, -weight / 4e7], rel=1e-9, abs=1e-12)
    assert gravity["static_deflection"][2] < -1e-3
    assert plain["w"] != gravity["w"]
    assert plain["damped"] is None
    np.testing.assert_allclose(damped["w"], plain["w"], rtol=1e-3)
    assert len(damped["damped"]["poles"]) == 3


@pytest.mark.parametrize(
    "arguments",
    [
        EVALUATE,
        SELECT,
        ("select", "article"),
        ("doctor",),
        ("new", "machine.toml", "--yes"),
        ("region", "excavator", "--posture", "0.04,-2.05", "--loop", "kp=1e4", "--loop", "kv=1e3", "--boxes", "0"),
    ],
    ids=["evaluate", "select", "select-problem", "doctor", "new", "region"],
)
def test_every_document_stands_alone_and_has_provenance(command: Command, arguments: tuple[str, ...]) -> None:
    document = command.json(*arguments)
    assert "casadi" in document["provenance"]


def test_what_warns_while_a_result_is_shown_is_told_as_all_warnings_are(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As evaluations that are made then, of modes that share a frequency; in text the result has them."""
    shown = flexopt.Selection.to_dict

    def to_dict(self: flexopt.Selection) -> Any:
        warnings.warn("told late", flexopt.FlexoptWarning, stacklevel=2)
        return shown(self)

    monkeypatch.setattr(flexopt.Selection, "to_dict", to_dict)
    words = ("select", "excavator", "--end-point", "0,1.6", "--base", "0", "--starts", "2")
    assert command(*words).message == ""
    assert command(*words, "--json").message == "flexopt: warning: told late\n"
    assert command("-q", *words, "--json").stderr == ""


@pytest.mark.long
def test_missing_numbers_are_null(command: Command) -> None:
    # Two equal springs under a base a trillion times heavier than its arm: equal poles, whose gradient does not exist.
    patch = {"base.stiffness.rotation": None, "base.mass": "1e9", "base.inertia": "1e12"}
    patch |= {f"links[{i}].{key}": "1e-3" for i in (0, 1) for key in ("mass", "inertia")}
    command.write("machine.toml", toml(MACHINE, patch))
    arguments = ("evaluate", "machine.toml", "--posture", "1,-2", "--damped")
    as_json, plain = command(*arguments, "--json"), command(*arguments)
    document = as_json.document
    assert document["clusters"] == [[0, 1]]
    assert document["gradient"]["w"] == [[None] * 3] * 2
    # An arm that hardly moves the base cannot damp its modes either.
    assert document["epsilon_max"] is None
    assert document["gradient"]["epsilon_max"] == [None] * 3
    assert as_json.message.startswith("flexopt: warning: modes 1 and 2 share the frequency")
    printed = [line.removeprefix("flexopt: warning: ") for line in as_json.message.splitlines()]
    assert printed == document["warnings"]
    assert "warning: modes 1 and 2 share the frequency" in plain.stdout
    assert plain.message == ""
    for outcome in (as_json, plain):
        assert outcome.stderr.count("not plausible (`flexopt check` tells all)") == 1


def test_infinite_bounds_are_null(command: Command) -> None:
    document = command.json(*SELECT)
    variables = {variable["name"]: variable for variable in document["problem"]["variables"]}
    assert (variables["boom"]["lower"], variables["boom"]["upper"]) == (None, None)
    assert variables["base.x"]["lower"] < variables["base.x"]["upper"]


def test_select_document(command: Command) -> None:
    document = command.json(*SELECT)
    assert document["converged"] is True
    assert isinstance(document["status"], str)
    assert document["best"] == document["candidates"][0]
    assert document["problem"]["target"] == [0.0, 1.6]
    assert document["problem"]["objective"] == "w1"
    assert document["provenance"]["machine_sha256"] == flexopt.load("excavator").content_hash
    assert len(document["candidates"]) > 1
    for candidate in document["candidates"]:
        check_evaluation(candidate, modes=3, joints=["boom", "stick"])
        np.testing.assert_allclose(candidate["end_point"], [0.0, 1.6], atol=1e-8)
        assert candidate["objective"] == candidate["w"][0]
    places = {(round(c["base"][0], 3), *np.round(c["posture"], 3)) for c in document["candidates"]}
    assert len(places) == len(document["candidates"])


def test_candidates_rank_best_first(command: Command) -> None:
    document = command.json(*SELECT, "--objective", "V", "--weights", "1,2,0.5")
    objectives = [candidate["objective"] for candidate in document["candidates"]]
    assert len(objectives) > 2
    # Ties, here 1e-9 of the objective's scale, may rank by other measures.
    assert np.all(np.diff(objectives) <= 2e-9 * document["problem"]["objective_scale"])
    for candidate in document["candidates"]:
        assert candidate["objective"] == pytest.approx(np.dot([1, 2, 0.5], candidate["w"]), rel=1e-12)


def test_evaluate_confirms_the_best_candidate(command: Command) -> None:
    best = command.json(*SELECT, "--objective", "w2")["best"]
    base, posture = repr(best["base"][0]), ",".join(map(repr, best["posture"]))
    again = command.json("evaluate", "excavator", "--base", base, "--posture", posture)
    shared = again.keys() - {"provenance"}
    assert {key: again[key] for key in shared} == {key: best[key] for key in shared}


OVERRIDES = [
    (("--control", "transpose"), ("problem", "control"), "transpose"),
    (("--end-point", "-0.5,1.5"), ("problem", "target"), [-0.5, 1.5]),
    (("--objective", "w2"), ("problem", "weights"), [0.0, 1.0, 0.0]),
    (("--objective", "V", "--weights", "1,2,3"), ("problem", "weights"), [1.0, 2.0, 3.0]),
    (("--base", "-0.5"), ("problem", "present_base"), [-0.5]),
    (("--base", "-0.5"), ("initial", "base"), [-0.5]),
    (("--base-range", "-1.5,0"), ("problem", "variables", 0, "lower"), -1.5),
    (("--singularity-margin-deg", "20"), ("problem", "singularity_margin"), pytest.approx(np.radians(20))),
    (("--starts", "2"), ("problem", "starts"), 2),
    (("--seed", "7"), ("problem", "seed"), 7),
    (("--gain", "4e5"), ("best", "gain"), 4e5),
    (("--gravity",), ("problem", "gravity"), True),
]


@pytest.mark.long("options0-path0-transpose")
@pytest.mark.parametrize(("options", "path", "expected"), OVERRIDES, ids=lambda value: None)
def test_options_override_the_problem_file(
    command: Command, options: tuple[str, ...], path: tuple[Any, ...], expected: Any
) -> None:
    def at(document: Any) -> Any:
        for key in path:
            document = document[key]
        return document

    assert at(command.json("select", "article")) != expected
    assert at(command.json("select", "article", *options)) == expected


def test_elbow_overrides_the_problem_file(command: Command) -> None:
    assert command.json("select", "article")["initial"]["posture"][1] < 0
    assert command.json("select", "article", "--elbow", "down")["initial"]["posture"][1] > 0


def test_one_mode_in_place_of_the_problem_files_weighted_sum(command: Command) -> None:
    entries = {"selection.objective": '"V"', "selection.weights": "[1, 1, 1]"}
    command.write("problem.toml", toml(PROBLEM, entries))
    assert command.json("select", "problem.toml")["problem"]["weights"] == [1, 1, 1]
    assert command.json("select", "problem.toml", "--objective", "w3")["problem"]["weights"] == [0, 0, 1]
    assert command.json("select", "problem.toml", "--weights", "0,1,2")["problem"]["weights"] == [0, 1, 2]


def test_machine_path_starts_from_the_problem_file(command: Command) -> None:
    command.write("work", None)
    command.write("work/machine.toml", toml(MACHINE, {}))
    command.write("work/problem.toml", toml(PROBLEM, {"machine": '"machine.toml"'}))
    assert command.json("select", "work/problem.toml")["best"]["machine"] == "digger"


def test_name_and_path_of_a_machine_give_the_same_numbers(command: Command) -> None:
    by_name = command.json(*EVALUATE)
    shutil.copy(ROOT / "models" / "excavator.toml", command.folder / "mine.toml")
    for path in (str(ROOT / "models" / "excavator.toml"), "mine.toml", "./mine.toml"):
        assert command.json("evaluate", path, *EVALUATE[2:]) == by_name


def test_name_and_path_of_a_problem_give_the_same_numbers(command: Command) -> None:
    by_name = command.json("select", "article")
    assert command.json("select", str(ROOT / "problems" / "article.toml")) == by_name


@pytest.mark.parametrize(
    ("options", "key", "expected"),
    [
        (("--posture", "-0.5,1.2"), "posture", [-0.5, 1.2]),
        (("--posture=-0.5,1.2",), "posture", [-0.5, 1.2]),
        (("--posture", "-.5,-1e0"), "posture", [-0.5, -1.0]),
        (("--posture", " -0.5 , 1.2 "), "posture", [-0.5, 1.2]),
        (("--end-point", "-1,1.5"), "end_point", [-1.0, 1.5]),
        (("--posture", "1,-2", "--base", "-1.5"), "base", [-1.5]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else None,
)
def test_values_with_a_leading_minus(
    command: Command, options: tuple[str, ...], key: str, expected: list[float]
) -> None:
    assert command.json("evaluate", "excavator", *options)[key] == pytest.approx(expected, abs=1e-12)


def test_select_takes_values_with_a_leading_minus(command: Command) -> None:
    document = command.json("select", "excavator", "--end-point", "-1,1.5", "--base-range", "-3,-1", "--base", "-2")
    assert document["problem"]["target"] == [-1.0, 1.5]
    assert -3 <= document["best"]["base"][0] <= -1
    assert document["problem"]["present_base"] == [-2.0]


def test_elbows_reach_the_same_point(command: Command) -> None:
    target = ("evaluate", "excavator", "--end-point", "0.3,1.7", "--base", "0.2")
    up, down = command.json(*target, "--elbow", "up"), command.json(*target, "--elbow", "down")
    assert up["posture"][1] < 0 < down["posture"][1]
    for document in (up, down):
        assert document["end_point"] == pytest.approx([0.3, 1.7], abs=1e-12)
    assert command.json(*target) == up


def test_end_point_under_gravity_is_the_deflected_one(command: Command) -> None:
    target = ("evaluate", "excavator", "--end-point", "0,1.6")
    sagging, stiff = command.json(*target, "--gravity"), command.json(*target)
    assert sagging["end_point"] == pytest.approx([0.0, 1.6], abs=1e-9)
    assert np.abs(np.subtract(sagging["posture"], stiff["posture"])).max() > 1e-4


def test_the_sag_is_told_once(command: Command) -> None:
    for words in (SELECT, ("evaluate", *SELECT[1:])):
        assert command(*words, "--gravity").stdout.count("sag under the weight") == 1


def test_out_writes_the_document_of_json(command: Command) -> None:
    document = command.json(*SELECT, "--out", "choice.json")
    assert strict_json((command.folder / "choice.json").read_text(encoding="utf-8")) == document
    command(*SELECT, "--objective", "w2", "--out", "choice.json")
    written = strict_json((command.folder / "choice.json").read_text(encoding="utf-8"))
    assert written["problem"]["objective"] == "w2"


@pytest.mark.long
def test_pictures_are_what_their_names_say(command: Command) -> None:
    for name in ("choice.png", "choice.svg", "choice.PDF"):
        assert command(*SELECT, "--plot", name).code == 0
    assert (command.folder / "choice.png").read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    assert (command.folder / "choice.PDF").read_bytes().startswith(b"%PDF-")
    root = ET.fromstring((command.folder / "choice.svg").read_text(encoding="utf-8"))
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert len(list(root.iter())) > 50


def test_progress_goes_to_standard_error(command: Command) -> None:
    for options in ((), ("--json",)):
        outcome = command(*SELECT, *options)
        assert outcome.code == 0
        assert outcome.stderr == "starts 8/8\n"
        assert "starts 8/8" not in outcome.stdout


@pytest.mark.long
def test_the_last_line_of_progress_counts_what_the_text_counts(command: Command) -> None:
    """A second objective brings starts of its own; a pipe gets one line."""
    told = command(*SELECT, "--objective", "w1,epsilon_max")
    count = told.stdout.split(" verified from ")[1].split(" starts")[0]
    assert int(count) > 8
    assert told.stderr == f"starts {count}/{count}\n"


def test_text_names_the_choice(command: Command) -> None:
    best = command.json("select", "article")["best"]
    outcome = command("select", "article")
    sentence = f"Stand at x = {best['base'][0]:.4f} m and hold boom {best['posture'][0]:.4f} rad"
    assert sentence in outcome.stdout


def test_text_of_evaluate_lists_every_mode(command: Command) -> None:
    document, outcome = command.json(*EVALUATE), command(*EVALUATE)
    assert outcome.stderr == ""
    for frequency, w in zip(document["frequencies_hz"], document["w"], strict=True):
        assert f"{frequency:.4f} Hz" in outcome.stdout
        assert f"{w:.5e}" in outcome.stdout


def test_failed_solve_tells_constraint_and_iterate(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    def lose(self: Program, start: np.ndarray, **how: float) -> tuple[np.ndarray, int, str]:
        return start + np.array([0.1, 0.0, 0.0]), 200, "Maximum_Iterations_Exceeded"

    monkeypatch.setattr(Program, "solve", lose)
    monkeypatch.setattr(Program, "climbed", lambda *_: None)
    outcome = command(*SELECT, "--json", "--out", "choice.json")
    assert outcome.code == 3
    error = outcome.document["error"]
    assert error["type"] == "NoSolutionFound"
    assert error["violations"]["target x"] == pytest.approx(0.1)
    assert set(error["iterate"]) == {"base.x", "boom", "stick"}
    assert "target x by 0.1 m" in outcome.message
    assert not (command.folder / "choice.json").exists()


def test_unreachable_target_tells_the_miss_and_the_placements(command: Command) -> None:
    error = command("evaluate", "excavator", "--end-point", "5,1", "--json").document["error"]
    assert error["type"] == "UnreachableTarget"
    low, high = error["base_intervals"][0]
    assert command("evaluate", "excavator", "--end-point", "5,1", "--base", repr(low + 1e-6)).code == 0
    assert command("evaluate", "excavator", "--end-point", "5,1", "--base", repr(low - 1e-6)).code == 2
    # The arm's own length tells the miss: shoulder at (0.1733, 0.5126) m, reach 3.015 m.
    assert error["miss"] == pytest.approx(np.hypot(5 - 0.541 * np.cos(1.2451), 1 - 0.541 * np.sin(1.2451)) - 3.015)
    assert low < high


def test_doctor(command: Command) -> None:
    document = command.json("doctor")
    assert document["healthy"] is True
    checks = {check["name"]: check for check in document["checks"]}
    assert "excavator" in checks["models"]["finding"]
    assert "article" in checks["problems"]["finding"]
    assert ca.__version__ in checks["packages"]["finding"]


def test_doctor_fails_on_a_broken_shipped_machine(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    command.write("models", None)
    command.write("models/broken.toml", toml(MACHINE, {"base.mass": "-1.0"}))
    monkeypatch.setattr("flexopt.model.files.PACKAGE", command.folder)
    outcome = command("doctor", "--json")
    assert outcome.code == 3
    assert outcome.document["healthy"] is False
    finding = next(c["finding"] for c in outcome.document["checks"] if c["name"] == "models")
    assert "base.mass = -1.0" in finding


@pytest.mark.parametrize("arguments", [(), *[(name,) for name in COMMANDS]], ids=lambda a: a[0] if a else "flexopt")
def test_help(command: Command, arguments: tuple[str, ...]) -> None:
    outcome = command(*arguments, "--help")
    assert outcome.code == 0
    assert outcome.stderr == ""
    assert command(*arguments, "-h") == outcome


def test_version(command: Command) -> None:
    outcome = command("--version")
    assert outcome.code == 0
    assert outcome.stdout.strip() == f"flexopt, version {build_version()}"
    assert flexopt.__version__ == version("flexopt")


@pytest.mark.parametrize("encoding", ["cp1252", "ascii"])
def test_output_to_a_terminal_without_greek(encoding: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", "from flexopt.cli import main; main()", *EVALUATE],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT), "PYTHONIOENCODING": encoding},
        capture_output=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr.decode("utf-8", "replace")[-300:]
    assert b"excavator" in done.stdout


def test_every_option_of_a_selection_is_one_of_the_command() -> None:
    known = {parameter.name for parameter in select_command.params}
    assert set(flexopt.SelectionOptions.of("end_point")) <= known
