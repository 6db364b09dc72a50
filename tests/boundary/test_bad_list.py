"""Every argument of every public name refuses the bad list by a FlexoptError, or means what is written here."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

import flexopt
from tests.boundary.calls import CONSTRUCTORS, FUNCTIONS, LONG, METHODS, OBJECTS
from tests.boundary.walk import calls, signature

Rows = Mapping[str, list[dict[str, str]]]
TEXTS = ("text", "empty text", "million *", "NUL", "surrogate")
FLAGS = (
    "gravity",
    "damped",
    "baked",
    "gradient",
    "overwrite",
    "quick",
    "exact",
    "strict",
    "hold",
    "gravity_compensation",
)

# Call, argument, bad values that it takes (patterns), and what they mean there.
MEANINGS: list[tuple[str, str, tuple[str, ...], str]] = [
    *(("*", flag, ("True",), "a flag is True or False") for flag in FLAGS),
    ("map_workspace", "measures", ("True",), "a flag"),
    ("map_workspace", "epsilon_max", ("True",), "a flag"),
    ("atlas", "posture", ("empty list", "empty array"), "over both joints of two there are no others"),
    ("map_workspace", "posture", ("empty list", "empty array"), "over both joints of two there are no others"),
    ("WorkspaceMap.plot", "marks", ("empty dict",), "no marks"),
    ("*", "overrides.*", ("None",), "None leaves the file's"),
    ("*", "base_range", ("empty dict",), "no coordinate is bounded"),
    ("*", "constraints", ("empty dict", "empty list"), "nothing is kept"),
    ("Constraint", "unit", TEXTS, "any text"),
    ("*", "sensor", ("empty dict",), "the defaults of flexopt.Sensor"),
    ("*", "actuator", ("empty dict",), "the defaults of flexopt.Actuator"),
    ("*", "loop", ("empty dict",), "all of it follows from the machine"),
    ("Loop", "*", ("wrong length",), "how many there must be is the machine's to say, in flexopt.evaluate"),
    ("report", "simulation", ("empty dict",), "the defaults of flexopt.simulate"),
    ("check", "machine_or_path", ("text", "million *"), "a file that is not there is a fault in the result"),
    ("SelectionProblem.given_up", "best", ("2**63",), "a value up to 1e100"),
    ("nullspace_trajectory", "step_gain", ("2**63",), "a gain up to 1e30"),
    ("SelectionOptions", "*", ("wrong length",), "how many is the machine's and the targets' to say, in the calls"),
    ("SimulationOptions", "*", ("wrong length",), "how many there must be is the machine's to say, in the calls"),
    ("Actuator", "*", ("wrong length",), "how many joints there are is the machine's to say, in flexopt.simulate"),
    ("Path.at", "times", ("1e308", "-1e308", "2**63"), "held before the first time and after the last"),
    ("Path.at", "times", ("empty list", "empty array", "wrong length"), "any number of times"),
    ("StateSpace.at", "points", ("1e308", "-1e308", "2**63", "complex", "array of complex"), "points are complex"),
    ("StateSpace.at", "points", ("empty list", "empty array", "wrong length"), "any number of points"),
    ("StateSpace", "D", ("2**63",), "entries go up to 1e100"),
    ("*", "D", ("2**63",), "entries go up to 1e100"),
    ("*", "P", ("2**63",), "a pure gain up to 1e100"),
    ("*", "K", ("2**63",), "a pure gain up to 1e100"),
    ("*", "P[12]", ("2**63",), "a pure gain up to 1e100"),
    ("StateSpace", "D", ("None",), "no feedthrough"),
    ("*", "dt", ("None", "True", "2**63"), "None is continuous, True 1 s, a period up to 1e100 s"),
    ("evaluate_w", "*", ("nan", "inf", "-inf", "*nan*"), "a point that is not finite is marked and its w is NaN"),
    ("evaluate_w", "bases", ("1e308", "-1e308", "2**63"), "w does not depend on where a planar machine stands"),
    ("*", "origin", TEXTS, "any text may name the source in messages"),
    *((kind, key, TEXTS, "any text") for kind in CONSTRUCTORS for key in ("name", "description", "source")),
    ("Problem", "machine", TEXTS, "looked up where a file is loaded; without a machine nothing can be solved"),
    ("Experiment", "machine", TEXTS, "as of a problem"),
    ("*", "capsules", ("empty list", "empty array"), "none"),
    ("*", "visuals", ("empty list", "empty array"), "none"),
    ("*", "uncertainty", ("empty list", "empty array"), "none"),
    ("Uncertainty", "of", ("text", "text in a list", "million slashes", "array of text"), "a name, looked up in calls"),
    ("*", "cylinders", ("empty list", "empty array"), "none"),
    ("*", "payload", ("empty dict",), "no mass"),
    ("Tree", "placement", ("empty list", "empty array"), "a machine that stands where it stands"),
    ("Problem", "selection", ("empty dict",), "the defaults"),
    ("Experiment", "simulation", ("empty dict",), "the defaults; the posture may be an override"),
    ("Experiment", "nullspace", ("empty dict",), "the defaults"),
    ("*.to_csv", "path", ("text",), "a file may have any name"),
    ("*.to_netcdf", "path", ("text",), "a file may have any name"),
    (
        "Vary",
        "of",
        ("text", "NUL"),
        "looked up where the machine is known, in flexopt.run_study",
    ),
    ("Study", "machine", ("text", "million *", "NUL"), "looked up where the study is carried out"),
    ("StudyResult.quantiles", "shares", ("wrong length",), "as many as wanted"),
    ("Study", "*", ("wrong length",), "how many there must be is the machine's to say, in flexopt.run_study"),
    ("run_study", "folder", ("text",), "a folder may have any name"),
    ("Report.write", "folder", ("text",), "a folder may have any name"),
    ("export_c", "folder", ("text",), "a folder may have any name"),
]

# Classes whose objects come from functions alone, as the results of computing: nobody passes them numbers.
RESULTS = {
    "Atlas", "BasePlan", "BaseTrajectory", "Candidate", "Certificate", "Check", "Configuration", "Ensemble", "Evaluation", "Explanation", "Explorer",
    "ExportReport", "FmuReport", "Identification", "Outcome", "Region", "Report", "RobustMargin", "Selection", "SelectionProblem", "Stand", "Trajectory",
    "Sensitivity", "StudyResult", "Verdict", "Verification", "WorkspaceMap",
}  # fmt: skip
NAMES = [call.name for call in calls()]


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> Rows:
    """What the walk found, by call; a hang ends it with a traceback."""
    out = tmp_path_factory.mktemp("walk") / "rows.json"
    environment = os.environ | {"PYTHONPATH": str(Path(flexopt.__file__).parents[1]), "MPLBACKEND": "agg"}
    command = [sys.executable, "-m", "tests.boundary.walk", "--out", str(out)]
    root = Path(__file__).parents[2]
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, timeout=1200, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
    found: defaultdict[str, list[dict[str, str]]] = defaultdict(list)
    for row in json.loads(out.read_text(encoding="utf-8")):
        found[row["call"]].append(row)
    return found


def meaning(row: Mapping[str, str]) -> int | None:
    """Which of the meanings a row is."""
    for number, (call, argument, bad, _) in enumerate(MEANINGS):
        named = fnmatchcase(row["call"], call) and fnmatchcase(row["argument"], argument)
        if named and any(fnmatchcase(row["bad"], each) for each in bad):
            return number
    return None


# One test for all calls: as many tests would be dealt out to several processes, of which each walks first.
@pytest.mark.long
def test_every_argument_refuses_the_bad_list(rows: Rows) -> None:
    controls = [rows[name][0] for name in NAMES if name not in LONG]
    assert [row for row in controls if row["outcome"] != "accepted"] == [], "good calls are refused"
    taken = [row for name in NAMES for row in rows[name][name not in LONG :]]
    assert {row["call"] for row in taken} == set(NAMES)
    assert [row for row in taken if row["outcome"] == "raw"] == []
    assert [row for row in taken if row["outcome"] == "accepted" and meaning(row) is None] == []


@pytest.mark.long
def test_refusals_name_the_argument(rows: Rows) -> None:
    """One that fails for another reason, later, is no check of the argument."""
    bare = [
        (row["call"], row["argument"], row["bad"], row["message"])
        for found in rows.values()
        for row in found
        if row["outcome"] == "refused" and row["argument"] and not names(row)
    ]
    assert bare == []


def names(row: Mapping[str, str]) -> bool:
    """Whether a message names the argument, or is about the file or table that it is."""
    last = row["argument"].rpartition(".")[2]
    own = row["call"] in (
        "load",
        "load_problem",
        "load_experiment",
        "load_study",
        "load_robot",
        "machine_from_dict",
        "tree_from_dict",
    )
    own |= row["call"] == "report"  # whose `simulation` has faults of its own keys
    return last in row["message"] or own or "cannot be written" in row["message"]


@pytest.mark.long
def test_every_meaning_is_used(rows: Rows) -> None:
    used = {meaning(row) for found in rows.values() for row in found if row["outcome"] == "accepted"}
    general = {number for number, entry in enumerate(MEANINGS) if entry[3] == "any text" or entry[1] in FLAGS}
    assert [MEANINGS[number] for number in set(range(len(MEANINGS))) - used - general] == []


def test_everything_public_is_walked() -> None:
    """`calls` would not find a new name's good call; here it shows that nothing is aside."""
    classes = {name for name in flexopt.__all__ if isinstance(getattr(flexopt, name), type)}
    errors = {name for name in classes if issubclass(getattr(flexopt, name), Exception)}
    assert set(CONSTRUCTORS) | RESULTS | errors == classes
    assert set(FUNCTIONS) == set(flexopt.__all__) - classes
    assert set(OBJECTS) >= {name.partition(".")[0] for name in METHODS}
    assert sorted(flexopt.__all__) == flexopt.__all__


@pytest.mark.parametrize("name", NAMES)
def test_the_good_call_gives_every_argument(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Some write what they are given.
    monkeypatch.chdir(tmp_path)
    call = next(call for call in calls() if call.name == name)
    assert set(call.good()) == set(signature(call)), "a new argument needs a good value in tests/boundary/calls.py"
