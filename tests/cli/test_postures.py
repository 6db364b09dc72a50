"""A configuration on the command line: what is taken where an end-point leaves the posture open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flexopt
from tests.cli.command import Command

TARGET = (5.0, 0.0, 1.0)


def test_a_redundant_arm_is_held_in_the_sampled_posture_with_the_greatest_first_measure(command: Command) -> None:
    machine = flexopt.load("slewing-excavator")
    asked = ("slewing-excavator", "--end-point", ",".join(map(str, TARGET)))
    found = command("evaluate", *asked, "--json")
    postures = flexopt.inverse_kinematics(machine, TARGET)
    p, values = flexopt.build_plant(machine).parameter_values, flexopt.build_measures(machine).values
    measures = [float(values(base=0.0, posture=posture, p=p)["w"][0]) for posture in postures]
    assert np.allclose(found.document["end_point"], TARGET, atol=1e-9)
    assert found.document["w"][0] >= max(measures) - 1e-15
    assert np.ptp(measures) > 1e-7
    assert f"of {len(postures)} postures" in found.stderr
    assert "--posture" in found.stderr
    assert command("--quiet", "evaluate", *asked).stderr == ""
    chosen = command("explain", *asked, "--json").document
    assert np.allclose(chosen["posture"], found.document["posture"], atol=1e-12)


def test_of_a_redundant_arm_in_the_plane_the_elbow_is_said_to_choose_among_the_postures(command: Command) -> None:
    told = command("evaluate", "boom-stick-bucket", "--end-point", "5,1", "--elbow", "down").stderr
    assert "reach it with the elbow down (--elbow names the other), the one with the greatest w1 is taken" in told


@pytest.mark.parametrize("asked", ["evaluate", "explain", "select", "verdict"])
def test_in_space_no_elbow_is_named(command: Command, asked: str) -> None:
    refused = command(asked, "truck-crane", "--end-point", "4.5,1,1.8", "--base", "0,0,0", "--elbow", "down")
    assert refused.code == 2
    assert refused.stderr.strip().endswith("--elbow = down: names a branch of planar arms only")


@pytest.mark.parametrize(
    "asked",
    [
        ("simulate", "truck-crane", "--posture", "0.2,0.8,-1.5,1.3", "--duration", "0.2"),
        ("simulate", "excavator", "--posture", "0.9,-2.6", "--duration", "0.2"),
        ("map", "truck-crane", "--posture", "0.2,0.8,-1.5,1.3", "--points", "3,3"),
        ("map", "excavator", "--over", "posture", "--points", "3,3"),
    ],
)
def test_beside_a_posture_no_elbow_is_named(command: Command, asked: tuple[str, ...]) -> None:
    refused = command(*asked, "--elbow", "down")
    assert refused.code == 2
    assert "--elbow = down: " in refused.stderr


def test_without_a_word_of_the_elbow_both_branches_are_looked_at(command: Command) -> None:
    """Of a redundant arm the best of all postures is taken, as the pages say."""
    asked = ("evaluate", "boom-stick-bucket", "--end-point", "5,1")
    both, up, down = (command(*asked, *more, "--json") for more in ((), ("--elbow", "up"), ("--elbow", "down")))
    assert both.document["w"][0] == max(found.document["w"][0] for found in (up, down))
    assert "with the elbow" not in both.stderr


def test_a_refusal_names_the_elbow_that_was_asked_for(command: Command) -> None:
    """The other one reaches the same end-point within the limits."""
    text = (Path(__file__).parents[2] / "models" / "excavator.toml").read_text(encoding="utf-8")
    command.write("bent.toml", text.replace('name = "stick"', 'name = "stick"\nlimits = [-3.0, 0.0]'))
    asked = ("evaluate", "bent.toml", "--end-point", "0,1.6", "--elbow")
    assert command(*asked, "up").code == 0
    refused = command(*asked, "down")
    assert refused.code == 2
    assert "every posture with the elbow down that reaches it breaks a joint limit" in refused.stderr


def test_without_words_the_command_shows_what_it_can(command: Command) -> None:
    assert command().stdout == command("--help").stdout
