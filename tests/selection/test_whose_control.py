"""A choice is under the control that was asked for, else under that of the loop, of the call or the machine."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import flexopt

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
        monkeypatch.setattr(f"flexopt.study.verdicts.verdict.{name}", None)
    for asked in (
        lambda: flexopt.verdict(other),
        lambda: flexopt.verdict(transposed(), TARGETS[0], control="inverse", **few),
        lambda: flexopt.verdict(flexopt.build_selection(transposed(), TARGETS[0], control="inverse", base=0.0)),
    ):
        with pytest.raises(flexopt.InputError, match="control that is asked for, inverse"):
            asked()
