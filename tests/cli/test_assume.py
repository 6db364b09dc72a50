"""What `flexopt select` assumes is said, in words and in the document, and left out by a word of option or file."""

from __future__ import annotations

import pytest

from tests.cli.command import Command

PROBLEM = """
schema = 1
name = "load"
machine = "boom-stick-bucket"
[target]
end_point = [7.0, 1.0]
[selection]
base = 0.0
starts = 1
assume = "limits, reach"
"""
MACHINE = ("select", "boom-stick-bucket", "--end-point", "7,1", "--base", "0", "--starts", "1", "--workers", "1")


def names(document: dict) -> list[str]:
    return [each["name"] for each in document["problem"]["assumed"]]


@pytest.mark.long
def test_the_option(command: Command) -> None:
    said = command(*MACHINE).stdout
    assert "assumed (ground): boom, stick stay above the ground, whose height is 0 m" in said
    assert "assumed (reach): the base moves by no more than" in said
    document = command.json(*MACHINE)
    assert names(document) == ["ground", "limits", "reach", "self_clearance"]
    assert document["problem"]["assumed"][0]["value"] == 0.0
    assert any("assumed ground" in name for name in document["best"]["constraints"])
    nothing = command.json(*MACHINE, "--assume", "nothing")
    assert names(nothing) == ["self_clearance"]
    assert nothing["best"]["constraints"].keys() == {"singularity margin"}


@pytest.mark.long
def test_a_file(command: Command) -> None:
    command.write("load.toml", PROBLEM)
    assert names(command.json("select", "load.toml", "--workers", "1")) == ["limits", "reach", "self_clearance"]
    # An option goes before the file.
    assert names(command.json("select", "load.toml", "--workers", "1", "--assume", "ground")) == [
        "ground",
        "self_clearance",
    ]
    command.write("wrong.toml", PROBLEM.replace("limits, reach", "the ground"))
    outcome = command("select", "wrong.toml")
    assert outcome.code == 2
    assert "selection.assume = 'the ground': must be everything, nothing, or some of ground, limits" in outcome.stderr
    outcome = command(*MACHINE, "--assume", "all")
    assert outcome.code == 2
    assert "--assume = 'all': must be everything, nothing, or some of ground, limits" in outcome.stderr
