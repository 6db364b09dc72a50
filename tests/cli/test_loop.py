"""`flexopt evaluate --loop`: the real controller from the command line, and from a machine file's [loop]."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import flexopt
from tests.cli.command import Command

WORDS = ("evaluate", "excavator", "--posture", "0.0448,-2.0499")
GIVEN = ("--loop", "kp=1e4", "--loop", "kv=1e3,1e3", "--loop", "dead_time=0.0031")


def test_values_are_those_of_python(command: Command) -> None:
    loop = command(*WORDS, *GIVEN, "--json").document["outcome"]
    found = flexopt.evaluate(
        flexopt.load("excavator"), (0.0448, -2.0499), loop={"kp": 1e4, "kv": 1e3, "dead_time": 0.0031}
    )
    assert loop == found.to_dict()["outcome"]
    assert "outcome" not in command(*WORDS, "--json").document


def test_all_from_the_machine(command: Command) -> None:
    assert "suits the arm's masses" in command(*WORDS, "--loop", "default").stdout


def test_options_on_top_of_a_file(command: Command) -> None:
    machine = flexopt.load("excavator")
    text = "\n".join(["[loop]", "kp = 1e4", "kv = 1e3", "rate = 100.0"])
    source = Path(__file__).parents[2] / "models" / "excavator.toml"
    (command.folder / "own.toml").write_text(source.read_text(encoding="utf-8") + text, encoding="utf-8")
    words = ("evaluate", "own.toml", *WORDS[2:], "--json")
    assert command(*words).document["outcome"]["settings"]["rate"] == 100.0
    mixed = command(*words, "--loop", "rate=200").document["outcome"]["settings"]
    assert (mixed["rate"], mixed["kp"]) == (200.0, [1e4] * len(machine.task_rows))
    assert "as in the article" in command(*words[:-1], "--loop", "default").stdout
    # A table in a call is the whole loop.
    whole = flexopt.outcome(flexopt.load(command.folder / "own.toml"), (0.0448, -2.0499), loop={"rate": 200.0})
    assert {"kp", "kv"} <= set(whole.settings.sources)


@pytest.mark.long("decay", "w1")
@pytest.mark.parametrize("objective", ["w1", "decay"])
def test_a_choice_and_its_verdict_leave_the_files_loop_out_when_asked(command: Command, objective: str) -> None:
    """`--loop default` alone says nothing of the loop, and is not as if it were not there."""
    source = (Path(__file__).parents[2] / "models" / "excavator.toml").read_text(encoding="utf-8")
    (command.folder / "own.toml").write_text(
        f"{source}\n[loop]\nkp = 1e4\nkv = 1e3\ndead_time = 0.01\n", encoding="utf-8"
    )
    words = ("own.toml", "--end-point", "0,1.6", "--base", "0", "--objective", objective, "--loop", "default", "--json")
    few = ("--starts", "1") if objective == "w1" else ("--starts", "1", "--ranges", "stiffness=0.9,1.1")
    chosen = command("select", *words, *few).document["verdict"]["settings"]
    judged = command("verdict", *words, "--members", "2", "--runs", "0").document["settings"]
    assert (chosen["dead_time"], judged["dead_time"]) == (0.0, 0.0)
    assert chosen["kp"] != [1e4, 1e4]


def test_what_of_the_file_does_not_go_with_an_option_is_told_with_the_way_out(command: Command) -> None:
    source = (Path(__file__).parents[2] / "models" / "excavator.toml").read_text(encoding="utf-8")
    served = '\n[loop]\ndrive = "velocity"\nservo_gain = 2e5\n'
    (command.folder / "own.toml").write_text(source + served, encoding="utf-8")
    words = ("evaluate", "own.toml", *WORDS[2:], "--loop", "drive=torque", "--loop", "kp=1e4")
    refused = command(*words)
    assert refused.code == 2
    assert "evaluate: servo_gain = 200000: goes with drive" in refused.stderr
    assert "it is the file's own: --loop default leaves the file's [loop] out" in refused.stderr
    assert command(*words, "--loop", "default").code == 0
    # A gain that is none is left out by itself.
    (command.folder / "own.toml").write_text(
        f'{source}\n[loop]\nfeedback = "pid"\nkp = 1e4\nki = 3e3\n', encoding="utf-8"
    )
    plain = ("evaluate", "own.toml", *WORDS[2:], "--loop", "feedback=pd")
    assert "--loop ki=0 takes it out, --loop default leaves" in command(*plain).stderr
    assert command(*plain, "--loop", "ki=0").code == 0
    # Of one that is to be given with other drives 0 would be no loop.
    (command.folder / "own.toml").write_text(f'{source}\n[loop]\nfeedback = "pd"\nkp = 1e4\n', encoding="utf-8")
    other = command("evaluate", "own.toml", *WORDS[2:], "--loop", "drive=velocity").stderr
    assert "kp = 10000" in other
    assert "takes it out" not in other
    # What was typed is told by its option.
    (command.folder / "own.toml").write_text(source + served, encoding="utf-8")
    assert "--loop servo_gain" in command(*words, "--loop", "servo_gain=3").stderr


def test_gains_of_the_file_are_not_taken_for_drives_of_the_other_kind(command: Command) -> None:
    """Their numbers are in other units."""
    source = (Path(__file__).parents[2] / "models" / "excavator.toml").read_text(encoding="utf-8")
    (command.folder / "own.toml").write_text(source + "\n[loop]\nkp = 1e5\nkv_range = [1e3, 1e4]\n", encoding="utf-8")
    words = ("evaluate", "own.toml", *WORDS[2:])
    refused = command(*words, "--loop", "drive=velocity", "--loop", "servo_gain=2e5")
    assert refused.code == 2
    assert "kp = 100000.0: is for torque-served joints; for velocity-served ones it has another unit" in refused.stderr
    assert "kv_range = [1000.0, 10000.0]: is for torque-served joints" in refused.stderr
    assert command(*words, "--loop", "drive=torque").code == 0


def test_what_is_no_option(command: Command) -> None:
    for given, sentence in ((("kp",), "NAME=VALUE"), (("kp=1", "kp=2"), "given twice"), (("kz=1",), "unknown key")):
        refused = command(*WORDS, *(part for entry in given for part in ("--loop", entry)))
        assert refused.code == 2
        assert sentence in refused.stderr


@pytest.mark.long
def test_a_choice_by_what_the_loop_bears(command: Command) -> None:
    shown = command.json(
        "select",
        "excavator",
        "--end-point",
        "0,1.6",
        "--objective",
        "allowance",
        "--loop",
        "kp=1e4",
        "--loop",
        "kv=1e3",
    )
    assert shown["measure"] == "allowance"
    assert shown["best"]["outcome"]["allowance"]
    assert min(shown["best"]["outcome"]["allowance"]) == pytest.approx(shown["best"]["objective"], rel=1e-9)


@pytest.mark.long
def test_least_outcomes_of_a_file(command: Command) -> None:
    (command.folder / "own.toml").write_text(
        'name = "own"\nmachine = "excavator"\n[target]\nend_point = [0.0, 1.6]\n[loop]\nkp = 1e4\nkv = 1e3\n'
        "dead_time = 0.02\n[constraints.outcome]\ndecay = 0.05\n"
    )
    shown = command.json("select", "own.toml")
    assert shown["best"]["constraints"]["decay"]["value"] >= 0.05
    assert shown["measure"] == "w1"


@pytest.mark.long
def test_an_option_asks_for_another_objective_than_the_file(command: Command) -> None:
    """By the loop where the file asks for none of it, and not by it where the file does; the loop is the file's."""
    text = (
        'name = "own"\nmachine = "excavator"\n[target]\nend_point = [0.0, 1.6]\n[selection]\nstarts = 2\n'
        'objective = "{}"\n[loop]\nkp = 1e4\nkv = 1e3\n[[uncertainty]]\nof = "stiffness"\nfactor = [0.5, 2.0]\n'
    )
    found = list[Any]()
    for own, option in (("decay", "w1"), ("w1", "w1"), ("w1", "decay"), ("decay", "decay")):
        (command.folder / "own.toml").write_text(text.format(own))
        found.append(command.json("select", "own.toml", "--objective", option)["best"])
    assert found[0]["objective"] == found[1]["objective"]
    assert found[2]["objective"] == found[3]["objective"] != found[0]["objective"]
