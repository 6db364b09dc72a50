"""Certificates of the best: beside scans, the program that checks their logs, and what must not be proven.

All problems: `python -m benchmarks.certificates`.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flint import arb, arb_poly, ctx

import flexopt
from flexopt.model import machine_from_dict
from flexopt.selection.certificate import check as checking
from flexopt.selection.certificate.balls import BallSeries
from flexopt.selection.certificate.curve import RedundancyCurve
from tests.oracles.certificates import contradictions, random_case
from tests.oracles.machines import Structure, arm_at_rest, random_machine
from tests.oracles.one_machine import in_every_format
from tests.study.telescopes import telescope

TARGET = (0.0, 1.6)
SUM: dict[str, Any] = {"objective": "V", "weights": (1.0, 1.0, 1.0)}
POINTS = 20_000
# Random problems by what is special about them: stiffnesses that differ by 1e4 and five modes; a limit that the best
# rests on; rounding that takes 64 bits; next to a singular posture; a best from which the solver finds no way to step.
RANDOM = (2, 3, 17, 51, 80, 156)


@cache
def selected(**options: Any) -> flexopt.Selection:
    return flexopt.select(flexopt.load("excavator"), TARGET, **options, workers=1)


@cache
def log_of_sum() -> str:
    """Of a part of the redundancy, which has fewer cells."""
    return json.dumps(flexopt.certify(selected(**SUM, base_range=(-1.0, 0.3))).log, allow_nan=False)


def holds(certificate: flexopt.Certificate, selection: flexopt.Selection, gap: float) -> None:
    assert certificate.proven
    assert 0 <= certificate.gap <= gap * certificate.scale
    assert certificate.gap == pytest.approx(certificate.upper - certificate.value, abs=1e-15 * certificate.scale)
    # In doubles the value is one of a posture that reaches the target to 1e-10 m.
    assert certificate.value == pytest.approx(selection.best.objective, abs=1e-8 * certificate.scale)
    wrong, best = contradictions(selection, certificate, POINTS)
    assert wrong == 0
    assert best <= certificate.upper + 1e-11 * certificate.scale
    assert checking.check(json.loads(json.dumps(certificate.log, allow_nan=False))).faults == []


@pytest.mark.long("nearly straight", "in order", "sum", "edge")
@pytest.mark.parametrize(
    ("options", "gap"),
    [
        ({}, 1e-8),
        (SUM, 1e-5),
        (SUM | {"base_range": (-1.0, 0.3)}, 1e-5),
        (SUM | {"base_range": (0.2, 0.2)}, 1e-5),
        (SUM | {"singularity_margin_deg": 0.01, "control": "transpose"}, 1e-5),
        ({"objective": "w1,w2"}, 1e-8),
    ],
    ids=["w1", "sum", "edge", "fixed", "nearly straight", "in order"],
)
def test_the_article(options: dict[str, Any], gap: float) -> None:
    selection = flexopt.select(flexopt.load("excavator"), TARGET, **options, workers=1)
    certificate = flexopt.certify(selection)
    if "," in options.get("objective", ""):
        # A scan knows nothing of what is kept.
        assert certificate.proven
        assert checking.check(json.loads(json.dumps(certificate.log))).faults == []
    else:
        holds(certificate, selection, gap)


@pytest.mark.long("2", "3", "17", "51", "80")
@pytest.mark.parametrize("number", RANDOM)
def test_random_machines(number: int) -> None:
    case = random_case(number)
    selection = flexopt.select(case.machine, case.target, **case.options, workers=1)
    single = case.options["objective"] != "V"
    holds(flexopt.certify(selection), selection, 1e-8 if single else 1e-5)


@pytest.mark.long
def test_the_file_a_machine_comes_from_proves_nothing_else(tmp_path: Path) -> None:
    """TOML, URDF and MJCF: in the latter the plane is that of x and z, and the hinges turn about −y."""
    rng = np.random.default_rng(7)
    data, _ = random_machine(rng, Structure(3, ("x", "rotation"), (1,)))
    target = arm_at_rest(machine_from_dict(data), np.array([0.7, -1.1]))[1]
    told: dict[str, list[float]] = {}
    for name, machine in in_every_format(data, tmp_path).items():
        selection = flexopt.select(machine, target, objective="V", weights=[1.0] * 3, workers=1)
        certificate = flexopt.certify(selection)
        holds(certificate, selection, 1e-5)
        told[name] = [certificate.value / certificate.scale, certificate.upper / certificate.scale]
    assert np.ptp(list(told.values()), axis=0).max() < 1e-5


@pytest.mark.long
def test_a_gap_of_any_size() -> None:
    loose, tight = (flexopt.certify(selected(**SUM), gap=gap) for gap in (1e-3, 1e-10))
    assert loose.proven
    assert tight.proven
    assert tight.gap <= 1e-10 * tight.scale
    assert tight.upper <= loose.upper
    # Cells are added by a few about each maximum, not in proportion to 1 / gap.
    assert tight.cells < loose.cells + 100


@pytest.mark.long
def test_constraints_leave_cells_out() -> None:
    area = {"region": [[-1.0, 1.0]], "joint_margin": 0.3}
    selection = flexopt.select(flexopt.load("excavator"), TARGET, **SUM, constraints=area, workers=1)
    certificate = flexopt.certify(selection)
    assert certificate.proven
    assert "distance inside region" in selection.best.active
    assert "rest on constraints" in certificate.status
    left = sum(cell[3] == "constraint" for cell in certificate.log["cells"])
    (fault,) = checking.check(json.loads(json.dumps(certificate.log))).faults
    assert fault.startswith(f"{left} cells are left out for constraints")


@pytest.mark.long
@pytest.mark.parametrize("number", [0, 5, 17, 51])
def test_w_over_cells(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """V of random places in random cells, by balls of 128 bits and other formulas, lies between the bounds."""
    monkeypatch.setattr(ctx, "prec", checking.BITS)
    case = random_case(number)
    options: dict[str, Any] = case.options | {"constraints": None}
    problem = flexopt.build_selection(case.machine, case.target, **options)
    selection = flexopt.solve_selection(problem, workers=1)
    log = json.loads(json.dumps(flexopt.certify(selection).log))
    machine, rng, (lower, upper) = checking.LoggedMachine(log), np.random.default_rng(number), log["bounds"][0]
    low = rng.uniform(lower, upper, 40)
    high = np.minimum(low + (upper - lower) * 10.0 ** rng.uniform(-7, -1, low.size), upper)
    elbow = rng.choice([-1.0, 1.0], low.size)
    seen = RedundancyCurve(problem).see(low, high, elbow)
    known = [k for k in range(low.size) if not seen.outside[k] and np.isfinite(seen.high[k] - seen.low[k])]
    assert len(known) >= 5
    # The log's stiffness and joint angles of files are rounded doubles.
    rounding = 1e-12 * problem.objective_scale
    for k in known:
        for x in rng.uniform(low[k], high[k], 3):
            place = BallSeries(arb_poly([arb(x)]), arb(0))
            value = checking.objective(machine.terms(place, int(elbow[k])), arb(0), log["weights"][-1])
            assert seen.low[k] - rounding <= float(checking.span(value).mid()) <= seen.high[k] + rounding


def test_the_checker_leaves_the_precision_of_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ctx, "prec", 77)
    assert not checking.check(json.loads(log_of_sum())).faults
    assert ctx.prec == 77


def test_a_worse_configuration_is_refuted() -> None:
    selection = selected(**SUM)
    worse = replace(selection, best=selection.candidates[-1])
    certificate = flexopt.certify(worse)
    assert certificate.verdict == "refuted"
    assert certificate.better is not None
    problem = selection.problem
    value = problem.branches(problem.objective, certificate.better)[0][0]
    assert value > worse.best.objective + certificate.gap_asked
    assert np.abs(problem.rows(certificate.better)[:2] - TARGET).max() < 1e-10
    assert "refuted" in repr(certificate)


def test_what_cannot_be_decided_is_not_claimed(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a handful of cells only: the gap reached, and where it is."""
    monkeypatch.setattr("flexopt.selection.certificate.bound.MOST", 60)
    certificate = flexopt.certify(selected(**SUM), gap=1e-12)
    assert certificate.verdict == "undecided"
    assert certificate.gap > certificate.gap_asked
    assert certificate.where
    assert "could not be bounded" in certificate.status


@pytest.mark.parametrize(
    ("options", "word"),
    [({"objective": "epsilon_max"}, "ε_max"), (SUM | {"gravity": True}, "gravity")],
)
def test_what_has_no_bounds_is_refused(options: dict[str, Any], word: str) -> None:
    with pytest.raises(flexopt.InputError, match=word):
        flexopt.certify(flexopt.select(flexopt.load("excavator"), TARGET, **options, starts=1, workers=1))


def test_more_redundancy_is_refused() -> None:
    selection = flexopt.select(
        flexopt.load("boom-stick-bucket"), (6.0, 0.0), objective="V", weights=[1.0] * 3, starts=1, workers=1
    )
    with pytest.raises(flexopt.InputError, match="two actuated joints, both hinges across the plane"):
        flexopt.certify(selection)


def test_an_arm_with_a_slide_is_told_that_proofs_need_hinges() -> None:
    """Of two joints in a plane, with x alone free: what it lacks is the second hinge."""
    selection = flexopt.select(telescope(), (4.6, 0.0), objective="V", weights=[1.0] * 2, starts=1, workers=1)
    with pytest.raises(flexopt.InputError, match=r"both hinges \(extend: a slide\) across the plane of two task rows"):
        flexopt.certify(selection)


@pytest.mark.long
def test_the_command_and_the_other_program(tmp_path: Path) -> None:
    """`flexopt select --certify --proof`, then the program on the log, in processes of their own."""
    log = tmp_path / "log.json"
    command = [
        sys.executable,
        "-c",
        "from flexopt.cli import main; main()",
        "select",
        "excavator",
        "--end-point",
        "0,1.6",
    ]
    by_sum = ["--objective", "V", "--weights", "1,1,1", "--certify", "--proof", str(log), "--json"]
    done = subprocess.run([*command, *by_sum], capture_output=True, check=True)
    told = json.loads(done.stdout)["certificate"]
    assert told["verdict"] == "proven"
    assert told["gap"] <= told["gap_asked"] == 1e-5 * told["scale"]
    program = [sys.executable, "-m", "flexopt.selection.certificate.check", str(log)]
    answer = subprocess.run(program, capture_output=True, check=True, text=True, encoding="utf-8")
    assert f"proven by {told['cells']} cells: no configuration has more than" in answer.stdout
    text = json.loads(log.read_text(encoding="utf-8"))
    text["cells"].pop()
    log.write_text(json.dumps(text), encoding="utf-8")
    assert subprocess.run(program, capture_output=True, check=False).returncode == 3
    log.write_text('{"format": "another"}', encoding="utf-8")
    for path in (log, tmp_path / "none.json", ""):
        wrong = subprocess.run([*program[:3], str(path)], capture_output=True, check=False, text=True, encoding="utf-8")
        assert wrong.returncode == 2
        assert "Traceback" not in wrong.stderr
    by_margin = ["--objective", "epsilon_max", "--starts", "1", "--certify", "--json"]
    refused = subprocess.run([*command, *by_margin], capture_output=True, check=False)
    assert refused.returncode == 3
    assert json.loads(refused.stdout)["certificate"]["verdict"] == "none"
