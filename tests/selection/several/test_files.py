"""Problems with several targets in files: read, solved as the calls solve them, refused with every fault named."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt import BasePlan, ModelError, Stand, evaluate, load_problem, plan_base, select_stand, solve_problem
from tests.cli.command import Command
from tests.cli.conftest import command as command  # noqa: PLC0414  (a fixture)

HEAD = 'name = "p"\nmachine = "excavator"\n'
STATIONS = "[target]\nend_points = [[0.0, 1.6], [0.3, 1.2]]\n"
PATH = "[target]\npath = [[0.0, 1.6], [0.3, 1.6], [0.6, 1.6]]\n"


def written(folder: Path, text: str) -> Path:
    file = folder / "p.toml"
    file.write_text(HEAD + text, encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def trench() -> BasePlan:
    plan = solve_problem(load_problem("trench"), workers=1)
    assert isinstance(plan, BasePlan)
    return plan


@pytest.mark.long
def test_trench(trench: BasePlan) -> None:
    machine = flexopt.load("boom-stick-bucket")
    path = np.column_stack([np.linspace(8.5, 5.5, 7), np.full(7, -1.5)])
    for place, target in zip(trench.places, path, strict=True):
        e = evaluate(machine, place.evaluation.posture, base=place.evaluation.base)
        assert np.abs(e.end_point - target).max() < 1e-8
        assert place.objective == pytest.approx(e.w.sum(), rel=1e-9)
        # The links of a planar machine turn against each other: the bucket's angle is the sum.
        assert -2.9 - 1e-8 <= 1.4631 + e.posture.sum() <= -0.5 + 1e-8
        limits = np.array(machine.limits)
        assert np.all(e.posture >= limits[:, 0] + 0.03 - 1e-8)
        assert np.all(e.posture <= limits[:, 1] - 0.03 + 1e-8)
    assert trench.time.tolist() == pytest.approx(np.linspace(0, 24, 7).tolist())
    assert np.abs(np.diff(trench.base[:, 0])).max() <= 0.05 * 4.0 + 1e-7
    # The rate binds, and creeping is worth a quarter of what standing still loses.
    assert trench.travelled[0] == pytest.approx(1.2, abs=1e-3)
    assert trench.worth > 0.75 * trench.standing


@pytest.mark.long
def test_stations() -> None:
    problem = load_problem("stations")
    stand = solve_problem(problem.model_copy(update={"selection": problem.selection.model_copy(update={"starts": 6})}))
    assert isinstance(stand, Stand)
    machine = flexopt.load("slewing-excavator")
    for place, target in zip(stand.places, problem.target.end_points or (), strict=True):
        e = evaluate(machine, place.evaluation.posture, base=stand.base)
        assert np.abs(e.end_point - target).max() < 1e-8
        assert place.objective == pytest.approx(e.w.sum(), rel=1e-9)
    assert stand.worth == min(place.objective for place in stand.places)
    for low, high, x in ((-4, 3, stand.base[0]), (-4, 5, stand.base[1]), (-0.8, 0.8, stand.base[2])):
        assert low - 1e-8 <= x <= high + 1e-8


@pytest.mark.long
def test_file_is_the_call(tmp_path: Path) -> None:
    options = '[selection]\nobjective = "w2"\ncombine = "weighted"\nshares = [1.0, 3.0]\n'
    file = written(tmp_path, STATIONS + options)
    machine = flexopt.load("excavator")
    stand = solve_problem(load_problem(file), workers=1)
    same = select_stand(machine, [[0.0, 1.6], [0.3, 1.2]], objective="w2", combine="weighted", shares=[1, 3], workers=1)
    assert stand.to_dict() == same.to_dict()

    motion = "[motion]\ntimes = [0.0, 1.0, 3.0]\nmax_base_rate = 0.1\nmax_joint_rate = [1.0, 2.0]\nstart = -1.8\n"
    file = written(tmp_path, PATH + motion + '[selection]\nobjective = "w2"\n')
    plan = solve_problem(load_problem(file), workers=1)
    assert isinstance(plan, BasePlan)
    same = plan_base(
        machine, [[0.0, 1.6], [0.3, 1.6], [0.6, 1.6]], times=[0, 1, 3], max_base_rate=0.1, max_joint_rate=[1, 2],
        start=[-1.8], objective="w2", workers=1,
    )  # fmt: skip
    assert plan.to_dict() == same.to_dict()
    assert plan.base[0, 0] == -1.8


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[target]\n", ["target: needs exactly one of end_point, end_points and path"]),
        (STATIONS + "end_point = [0.0, 1.6]\n", ["target: needs exactly one", "not end_point and end_points"]),
        (STATIONS + "[motion]\nduration = 3.0\n", ["motion: goes with a path"]),
        (PATH + "[motion]\nspeed = 3.0\n", ["motion.speed: unknown key"]),
        (PATH + "[motion]\nduration = -3.0\n", ["motion.duration = -3.0", "s"]),
        (PATH + '[motion]\nmax_base_rate = "fast"\n', ["motion.max_base_rate", "number"]),
        (PATH + "[selection]\nelbow = 'up'\nshares = [1.0]\n", ["selection.elbow: goes with target.end_point", "shares"]),
        (STATIONS + "[selection]\ngain = 1e5\n", ["selection.gain: goes with target.end_point"]),
        (STATIONS + "[selection]\ncombine = 'best'\n", ["selection.combine = 'best'", "worst"]),
        ("[target]\npath = [[0.0, 1.6]]\n", ["target.path", "list of 2 to 1000"]),
        ("[target]\nend_points = [[0.0, 'a'], [nan, 1.0]]\n", ["target 1", "target 2"]),
    ],
)  # fmt: skip
def test_faults_of_a_file(tmp_path: Path, text: str, words: list[str]) -> None:
    with pytest.raises(ModelError) as caught:
        load_problem(written(tmp_path, text))
    for word in words:
        assert word in str(caught.value)


@pytest.mark.long
def test_command_line(command: Command) -> None:
    command.write("p.toml", HEAD + STATIONS + '[selection]\nobjective = "w2"\n')
    document = command.json("select", "p.toml", "--starts", "3", "--workers", "1", "--plot", "p.png", "--out", "p.json")
    assert document["converged"] is True
    assert len(document["places"]) == 2
    assert document["base_coordinates"] == ["x"]
    assert json.loads((command.folder / "p.json").read_text(encoding="utf-8")) == document
    assert (command.folder / "p.png").stat().st_size > 10_000
    text = command("select", "p.toml", "--starts", "3", "--objective", "w1")
    assert text.code == 0
    assert "2 targets from x =" in text.stdout

    command.write("path.toml", HEAD + PATH)
    document = command.json("select", "path.toml", "--workers", "1")
    assert document["worth"] >= document["standing"]
    assert len(document["time"]) == len(document["V"]) == 3
    assert document["still"]["base"]


def test_options_of_a_single_target_are_refused(command: Command) -> None:
    command.write("p.toml", HEAD + STATIONS)
    outcome = command("select", "p.toml", "--end-point", "0,1.6", "--elbow", "up", "--gain", "1e5")
    assert outcome.code == 2
    for name in ("--end-point", "--elbow", "--gain"):
        assert f"{name}" in outcome.message
    assert "p has target.end_points" in outcome.message


@pytest.mark.long
def test_pictures(trench: BasePlan, tmp_path: Path) -> None:
    figure = trench.plot(tmp_path / "trench.svg")
    assert (tmp_path / "trench.svg").stat().st_size > 10_000
    lines: list[Any] = [line for axes in figure.axes for line in axes.get_lines()]
    drawn = [line for line in lines if np.array_equal(np.asarray(line.get_ydata(), dtype=float), trench.V)]
    assert len(drawn) == 1
    assert trench.still is not None
    still = [line for line in lines if np.array_equal(np.asarray(line.get_ydata(), dtype=float), trench.still.V)]
    assert len(still) == 1
    stand = select_stand(
        flexopt.load("slewing-excavator"), [[6.0, -1.0, 1.0], [6.0, 2.0, 1.0]], objective="w2", starts=1, workers=1
    )
    figure = stand.plot(tmp_path / "stand.png")
    heights = [patch.get_height() for axes in figure.axes for patch in axes.patches if hasattr(patch, "get_height")]
    for shown in stand.shown_objective:
        assert any(math.isclose(height, shown, rel_tol=1e-12, abs_tol=1e-30) for height in heights)
    # w_2 is 0 to rounding, and so is what is drawn of it.
    assert np.abs(stand.V).max() < 1e-15 * stand.problems[0].first_scale
    assert not stand.shown_objective.any()
    with pytest.raises(flexopt.InputError, match=r"stand\.xyz"):
        stand.plot(tmp_path / "stand.xyz")
