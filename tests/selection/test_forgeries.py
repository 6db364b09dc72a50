"""Logs of certificates whose claim is false, or not shown by them: none is accepted. Honest ones are.

100 honest logs of random problems: `python -m benchmarks.certificates --problems 100 --points 0`.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import flexopt
from flexopt.cli import main
from tests.oracles.certificates import random_case

Log = dict[str, Any]
FORMS: dict[str, tuple[Log, float | None]] = {
    "sum": ({"objective": "V", "weights": (1.0, 1.0, 1.0), "base_range": (-1.0, 0.3)}, None),
    "zero": ({"objective": "w1"}, None),
    "order": ({"objective": "w1,w2", "base_range": (0.1, 0.3)}, 1e-3),
    "travel": (
        {
            "objective": "V",
            "weights": (1.0, 1.0, 1.0),
            "base_range": (-0.3, 0.3),
            "constraints": {"travel": {"cost": 0.1, "base": [0.0], "posture": [0.1, 2.0]}},
        },
        None,
    ),
}


@cache
def honest(form: str) -> str:
    options, gap = FORMS[form]
    selection = flexopt.select(flexopt.load("excavator"), (0.0, 1.6), **options, workers=1)
    certificate = flexopt.certify(selection, gap=gap)
    assert certificate.proven
    return json.dumps(certificate.log, allow_nan=False)


def code(*arguments: str) -> int:
    """With which exit code the command ends."""
    try:
        main(["check", *arguments])
    except SystemExit as left:
        return int(left.code or 0)
    return 0


def hashed(log: Log) -> None:
    """The hash of the numbers that the machine has now."""
    numbers = {key: value for key, value in log["machine"].items() if key != "sha256"}
    text = json.dumps(numbers, sort_keys=True, separators=(",", ":"))
    log["machine"]["sha256"] = hashlib.sha256(text.encode()).hexdigest()


def put(place: str, value: Any, *, rehashed: bool = False) -> Callable[[Log], None]:
    """A forgery: another value, or the value times or plus something, in a place such as `machine.bodies.2.mass`."""

    def forge(log: Log) -> None:
        *way, last = [int(key) if key.lstrip("-").isdigit() else key for key in place.split(".")]
        at: Any = log
        for key in way:
            at = at[key]
        at[last] = value(at[last]) if callable(value) else value
        if rehashed:
            hashed(log)

    return forge


def by(factor: float) -> Callable[[float], float]:
    return lambda x: x * factor


def more(amount: float) -> Callable[[float], float]:
    return lambda x: x + amount


def least(log: Log) -> Any:
    """The first cell that is not left out."""
    return next(cell for cell in log["cells"] if not cell[3])


def relabelled(why: str) -> Callable[[Log], None]:
    def forge(log: Log) -> None:
        least(log)[3] = why

    return forge


def a_better_value(log: Log) -> None:
    log["value"] = log["upper"] = 0.5 * log["value"]


def a_worse_configuration(log: Log) -> None:
    """Of the other elbow: the value is not there."""
    log["configuration"][2] = -log["configuration"][2]


def every_cell_left_out(log: Log) -> None:
    for cell in log["cells"]:
        cell[3] = "margin"


def a_limit_far_away(log: Log) -> None:
    """Whole turns bring every angle into these limits."""
    log["bounds"][1] = log["bounds"][2] = [100.0, 107.0]
    log["configuration"] = [log["configuration"][0], *(x + 32 * math.pi for x in log["configuration"][1:])]
    relabelled("limit")(log)


def all_for_constraints(log: Log) -> None:
    for cell in log["cells"]:
        cell[3] = "constraint"


def unordered(log: Log) -> None:
    log["cells"].reverse()


def one_cell_twice(log: Log) -> None:
    log["cells"].insert(1, log["cells"][0])


def a_gap_between(log: Log) -> None:
    log["cells"][3][2] = math.nextafter(log["cells"][3][2], -9.0)


def without(place: str) -> Callable[[Log], None]:
    def forge(log: Log) -> None:
        del log[place]

    return forge


def a_cell_less(log: Log) -> None:
    del log["cells"][len(log["cells"]) // 3]


def half_an_elbow(log: Log) -> None:
    log["cells"] = [cell for cell in log["cells"] if cell[0] == 1]


def of_no_arm(log: Log) -> None:
    log["machine"]["end_point"]["body"] = "base"
    hashed(log)


def both_at_once(log: Log) -> None:
    log["machine"]["actuated"].reverse()
    hashed(log)


FORGERIES: dict[str, tuple[str, Callable[[Log], None]]] = {
    "scale": ("sum", put("scale", 1e6)),
    "scale of travel": ("travel", put("travel.scale.0", by(10.0))),
    "cost of travel": ("travel", put("travel.cost.0", 0.0)),
    "cost below 0": ("travel", put("travel.cost.0", by(-1.0))),
    "travel from elsewhere": ("travel", put("travel.now.0", more(0.5))),
    "travel of no scale": ("travel", put("travel.scale.1", 0.0)),
    "no travel": ("travel", put("travel", None)),
    "travel of one number": ("travel", put("travel.now", [0.0])),
    "better value": ("sum", a_better_value),
    "value": ("sum", put("value", by(0.999))),
    "value and bound": ("sum", put("upper", by(0.9))),
    "bound below value": ("sum", put("upper", by(1.01))),
    "upper is NaN": ("sum", put("upper", math.nan)),
    "upper is infinite": ("sum", put("upper", math.inf)),
    "upper is missing": ("sum", put("upper", None)),
    "gap below 0": ("sum", put("gap", -1.0)),
    "gap without end": ("sum", put("gap", 1e300)),
    "gap of anything": ("sum", put("gap", 1.0)),
    "placement": ("sum", put("configuration.0", more(1e-3))),
    "elbow": ("sum", a_worse_configuration),
    "posture": ("sum", put("configuration.1", more(1e-3))),
    "base outside": ("sum", put("bounds.0.1", by(0.1))),
    "wider": ("sum", put("bounds.0.1", more(1e-9))),
    "bounds of NaN": ("sum", put("bounds.0.0", math.nan)),
    "bounds of nothing": ("sum", put("bounds.0.0", None)),
    "bounds turned round": ("sum", lambda log: log["bounds"][0].reverse()),
    "joint limit": ("sum", put("bounds.2", [0.0, 0.1])),
    "limit far away": ("sum", a_limit_far_away),
    "margin": ("sum", put("margin", 1.5)),
    "margin of more": ("sum", put("margin", 3.0)),
    "margin below 0": ("sum", put("margin", -1.0)),
    "target": ("sum", put("target.1", more(0.01))),
    "control": ("sum", put("control", "transpose")),
    "control of no name": ("sum", put("control", "damped:nan")),
    "weights": ("sum", put("weights.0.1", 0.5)),
    "weights below 0": ("zero", put("weights.0.1", -1.0)),
    "weights of NaN": ("sum", put("weights.0.1", math.nan)),
    "weights of two": ("sum", put("weights.0", [1.0, 1.0])),
    "stiffness, old hash": ("sum", put("machine.stiffness.2.2", by(1.01))),
    "stiffness": ("sum", put("machine.stiffness.2.2", by(1.01), rehashed=True)),
    "stiffness of one side": ("sum", put("machine.stiffness.0.1", 1e6, rehashed=True)),
    "stiffness below 0": ("sum", put("machine.stiffness.2.2", by(-1.0), rehashed=True)),
    "mass, old hash": ("sum", put("machine.bodies.4.mass", by(0.99))),
    "mass": ("sum", put("machine.bodies.4.mass", by(0.99), rehashed=True)),
    "mass below 0": ("zero", put("machine.bodies.2.mass", by(-1.0), rehashed=True)),
    "payload": ("sum", put("machine.payload", 100.0, rehashed=True)),
    "inertia below 0": ("zero", put("machine.bodies.2.inertia.2", by(-9.0), rehashed=True)),
    "length, old hash": ("sum", put("machine.bodies.4.position.0", more(1e-3))),
    "length": ("sum", put("machine.bodies.4.position.0", more(1e-3), rehashed=True)),
    "axis": ("sum", put("machine.bodies.4.axis", [0.0, 1.0, 0.0], rehashed=True)),
    "axis of length 2": ("sum", put("machine.bodies.4.axis", [0.0, 0.0, 2.0], rehashed=True)),
    "rotation": ("sum", put("machine.bodies.4.rotation.0.0", 2.0, rehashed=True)),
    "a parent of itself": ("sum", put("machine.bodies.4.parent", "stick", rehashed=True)),
    "end-point on the base": ("sum", of_no_arm),
    "joints in another order": ("sum", both_at_once),
    "hash": ("sum", put("machine.sha256", "0" * 64)),
    "name, old hash": ("sum", put("machine.name", "another")),
    "kept": ("order", put("kept.0", by(0.5))),
    "kept is NaN": ("order", put("kept.0", math.nan)),
    "kept less, so cells lack": ("order", put("kept.0", by(100.0))),
    "no cells": ("sum", put("cells", [])),
    "no cells, V = 0 claimed": ("sum", lambda log: log.update(cells=[], upper=0.0, value=0.0)),
    "no cells, upper 0": ("sum", lambda log: log.update(cells=[], upper=0.0)),
    "no cells, gap to 0": ("sum", lambda log: log.update(cells=[], upper=0.0, gap=-log["value"])),
    "joint slides": ("sum", put("machine.bodies.4.kind", "slide", rehashed=True)),
    "no cells, below 0": ("zero", put("upper", -1e-9)),
    "no cells elsewhere": ("zero", put("configuration.0", more(0.2))),
    "a cell less": ("sum", a_cell_less),
    "first cell": ("sum", lambda log: log["cells"].pop(0)),
    "last cell": ("sum", lambda log: log["cells"].pop()),
    "one elbow": ("sum", half_an_elbow),
    "elbow of 0.5": ("sum", put("cells.0.0", -0.5)),
    "elbow of NaN": ("sum", put("cells.0.0", math.nan)),
    "end of NaN": ("sum", put("cells.0.2", math.nan)),
    "end of infinity": ("sum", put("cells.0.2", math.inf)),
    "gap between": ("sum", a_gap_between),
    "twice": ("sum", one_cell_twice),
    "unordered": ("sum", unordered),
    "called margin": ("sum", relabelled("margin")),
    "called reach": ("sum", relabelled("reach")),
    "called limit": ("sum", relabelled("limit")),
    "called kept": ("order", relabelled("kept")),
    "called constraint": ("sum", relabelled("constraint")),
    "called anything": ("sum", relabelled("because")),
    "all constraints": ("sum", all_for_constraints),
    "all margin": ("sum", every_cell_left_out),
    "true": ("sum", put("value", True)),
    "text": ("sum", put("value", "-1e-5")),
    "huge integer": ("sum", put("value", 10**400)),
    "huge double": ("sum", put("target.0", 1e300)),
    "no table": ("sum", put("machine", [])),
    "no list": ("sum", put("cells", {"0": 1})),
    "null": ("sum", put("machine.bodies.0", None)),
    "key missing": ("sum", without("control")),
    "key unknown": ("sum", put("trust", True)),
    "format": ("sum", put("format", "flexopt certificate 1")),
    "format is a list": ("sum", put("format", [])),
}
# One of each kind.
QUICK = {
    "scale", "upper is NaN", "gap without end", "better value", "posture", "wider", "limit far away", "margin", "mass",
    "mass, old hash", "weights below 0", "no cells, gap to 0", "no cells elsewhere", "gap between", "called margin",
    "all constraints", "true", "huge integer", "format",
}  # fmt: skip
TEXTS: dict[str, Callable[[str], str]] = {
    "key twice": lambda text: text.replace('"value":', '"upper": 1e9, "value":', 1),
    "integer of 5,000 digits": lambda text: text.replace('"gap":', f'"gap": {"9" * 5000}, "g":', 1),
    "deep": lambda _: "[" * 100_000,
    "a number": lambda _: "1",
    "nothing": lambda _: "",
    "no text": lambda _: "\udcff",
    "too long": lambda text: text + " " * (1 << 24),
    "cut off": lambda text: text[: len(text) // 2],
}


@pytest.mark.long("order", "travel")
@pytest.mark.parametrize("form", FORMS)
def test_honest_logs(form: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "proof.json"
    path.write_text(honest(form), encoding="utf-8")
    assert code(str(path), "--machine", "excavator", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["status"] == "proven"
    assert told["sha256"] == json.loads(honest(form))["machine"]["sha256"]
    assert told["value"] == pytest.approx(json.loads(honest(form))["value"], abs=1e-9 * told["scale"])
    assert code(str(path), "--machine", "boom-stick-bucket") == 3


@pytest.mark.long(*sorted(FORGERIES.keys() - QUICK))
@pytest.mark.parametrize("name", FORGERIES)
def test_forgeries(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    form, forge = FORGERIES[name]
    log = json.loads(honest(form))
    forge(log)
    path = tmp_path / "proof.json"
    path.write_text(json.dumps(log), encoding="utf-8")
    assert code(str(path)) in (2, 3)
    told = capsys.readouterr()
    assert "Traceback" not in told.out + told.err
    assert "proven by" not in told.out


@pytest.mark.parametrize("name", TEXTS)
def test_what_is_no_log(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "proof.json"
    path.write_bytes(TEXTS[name](honest("zero")).encode("utf-8", "surrogateescape"))
    assert code(str(path)) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) <= 3


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no named pipes in folders")
def test_a_pipe_is_not_waited_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(tmp_path / "proof.json")
    assert code(str(tmp_path / "proof.json")) == 2
    assert "is no file" in capsys.readouterr().err


def test_all_faults_of_shape_are_told_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = json.loads(honest("zero"))
    log |= {"value": math.nan, "gap": "much", "scale": 1.0}
    path = tmp_path / "proof.json"
    path.write_text(json.dumps(log), encoding="utf-8")
    assert code(str(path)) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert all(f"log.{name}" in told for name in ("value", "gap"))
    assert "'scale' is unknown" in told


def test_without_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def nothing(name: str) -> None:
        """Finds no module."""

    monkeypatch.setattr("flexopt.cli.checking.find_spec", nothing)
    path = tmp_path / "proof.json"
    path.write_text("{}", encoding="utf-8")
    assert code(str(path)) == 2
    assert "flexopt[certificates]" in capsys.readouterr().err


def test_a_machine_needs_a_proof(capsys: pytest.CaptureFixture[str]) -> None:
    assert code("excavator", "--machine", "excavator") == 2
    assert "PROOF.json" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.parametrize("number", [0, 5, 9, 14, 20])
def test_honest_logs_of_random_machines(number: int, tmp_path: Path) -> None:
    case = random_case(number)
    certificate = flexopt.certify(flexopt.select(case.machine, case.target, **case.options, workers=1))
    path = tmp_path / "proof.json"
    certificate.write_log(path)
    assert certificate.proven
    assert code(str(path)) == 0
