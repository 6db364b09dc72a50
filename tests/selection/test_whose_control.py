"""A choice is under the control that was asked for, else under that of the loop, of the call or the machine."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexopt
from tests.cli.command import MACHINE, THIRD_LINK, Command, toml

TARGETS = [(0.0, 1.6), (0.2, 1.4)]
FEW: dict[str, Any] = {"starts": 1, "workers": 1}


def transposed() -> flexopt.Machine:
    machine = flexopt.load("excavator")
    return machine.model_copy(update={"loop": flexopt.Loop(control="transpose", kp=1e4, kv=1e3)})


@pytest.mark.parametrize(
    ("told", "control"),
    [
        ({}, "transpose"),
        ({"control": "inverse"}, "inverse"),
        ({"options": flexopt.SelectionOptions(control="inverse")}, "inverse"),
        ({"objective": "decay"}, "transpose"),
        ({"objective": "decay", "loop": {"kp": 1e4, "kv": 1e3}}, "inverse"),
        ({"objective": "decay", "loop": {"control": "damped:0.1"}}, "damped:0.1"),
    ],
    ids=["machine", "keyword", "options", "by its loop", "a loop", "its control"],
)
def test_a_choice_is_under_the_control_of_the_loop(told: dict[str, Any], control: str) -> None:
    machine = transposed()
    assert flexopt.select(machine, TARGETS[0], **told, **FEW).problem.control == control
    assert flexopt.select_stand(machine, TARGETS, **told, **FEW).problems[0].control == control
    if "objective" not in told:
        assert flexopt.build_selection(machine, TARGETS[0], **told).control == control
        assert flexopt.plan_base(machine, TARGETS, **told, **FEW).problems[0].control == control


def test_a_verdict_has_the_loops_control_or_refuses_before_places_are_sought(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few: dict[str, Any] = {"starts": 1, "members": 2, "runs": 0, "base": 0.0}
    assert flexopt.verdict(transposed(), TARGETS[0], **few).settings.control == "transpose"
    head = 'schema = 1\nname = "dig"\nmachine = "excavator"\ntarget.end_point = [0.0, 1.6]\n'
    told, loop = f"{head}[selection]\nbase = [0.0]\nstarts = 1\n", '[loop]\ncontrol = "transpose"\n'
    (tmp_path / "dig.toml").write_text(told + loop, encoding="utf-8")
    problem = flexopt.load_problem(tmp_path / "dig.toml")
    assert flexopt.verdict(problem, members=2, runs=0).settings.control == "transpose"
    assert flexopt.solve_problem(problem).problem.control == "transpose"  # type: ignore[union-attr]
    (tmp_path / "other.toml").write_text(f'{told}control = "inverse"\n{loop}', encoding="utf-8")
    other = flexopt.load_problem(tmp_path / "other.toml")
    for name in ("select", "solve_selection", "solve_problem"):
        monkeypatch.setattr(f"flexopt.study.verdicts.chosen.{name}", None)
    for asked in (
        lambda: flexopt.verdict(other),
        lambda: flexopt.verdict(transposed(), TARGETS[0], control="inverse", **few),
        lambda: flexopt.verdict(flexopt.build_selection(transposed(), TARGETS[0], control="inverse", base=0.0)),
    ):
        with pytest.raises(flexopt.InputError, match="control that is asked for, inverse"):
            asked()


@pytest.mark.parametrize(
    ("told", "control"),
    [({}, "transpose"), ({"control": "inverse"}, "inverse"), ({"control": "damped:0.1"}, "damped:0.1")],
    ids=["machine", "inverse", "damped"],
)
def test_maps_atlas_and_nullspace_law_are_under_the_control_of_the_loop(told: dict[str, Any], control: str) -> None:
    """As those of a machine without a loop of which the control is asked for."""
    machine, plain = transposed(), flexopt.load("excavator")
    few: dict[str, Any] = {"points": (4, 4), "epsilon_max": False}
    own, asked = flexopt.map_workspace(machine, **told, **few), flexopt.map_workspace(plain, control=control, **few)
    assert own.options["control"] == control
    np.testing.assert_array_equal(own.array("w"), asked.array("w"))
    part: dict[str, Any] = {"x_range": (0.5, 1.5), "y_range": (-2.5, -1.0), "cells": (16, 16)}
    found, other = flexopt.atlas(machine, **told, **part), flexopt.atlas(plain, control=control, **part)
    assert [curve.points.tolist() for curve in found.curves] == [curve.points.tolist() for curve in other.curves]
    ways = [
        flexopt.nullspace_trajectory(each, (0.9929, -2.6306), duration=0.1, **more)
        for each, more in ((machine, told), (plain, {"control": control}))
    ]
    np.testing.assert_array_equal(ways[0].base, ways[1].base)
    np.testing.assert_array_equal(ways[0].V, ways[1].V)


def test_a_map_with_a_loop_has_its_control() -> None:
    few: dict[str, Any] = {"points": (4, 4), "epsilon_max": False}
    machine = transposed()
    for loop, control in (
        ({"kp": 1e4, "kv": 1e3}, "inverse"),
        ({"kp": 1e4, "kv": 1e3, "control": "transpose"}, "transpose"),
        ("default", "inverse"),
    ):
        assert flexopt.map_workspace(machine, loop=loop, **few).options["control"] == control
    with pytest.raises(flexopt.InputError, match="is not the control of the map, inverse"):
        flexopt.map_workspace(machine, loop={"control": "transpose"}, control="inverse", **few)


def test_commands_are_under_the_control_of_the_files_loop(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether its gains are given or not."""
    monkeypatch.chdir(tmp_path)
    own = toml(MACHINE, {"loop.control": '"transpose"', "loop.kp": "1e4"})
    (tmp_path / "machine.toml").write_text(own, encoding="utf-8")
    command = Command(capsys, tmp_path)
    for more in ((), ("--loop", "kp=2e4")):
        told = command("map", "machine.toml", "--points", "4,4", *more)
        assert told.code == 0, told.stderr
        assert "Jacobian transpose control" in told.stdout


def test_of_a_redundant_arms_postures_the_best_under_the_loops_control_is_taken(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    own = toml(MACHINE | THIRD_LINK, {"loop.control": '"transpose"'})
    (tmp_path / "machine.toml").write_text(own, encoding="utf-8")
    command = Command(capsys, tmp_path)

    def posture(*more: str) -> list[float]:
        return command.json("evaluate", "machine.toml", "--end-point", "0,1.6", *more)["posture"]

    assert posture() == posture("--loop", "kp=1e4") == posture("--loop", "control=transpose")
    assert posture("--loop", "default") == posture("--control", "inverse", "--loop", "default") != posture()
